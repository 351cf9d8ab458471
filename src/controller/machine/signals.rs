//! From pin levels to input signals: applies polarity and filter to each sample, and reports changes. When an armed
//! input (such as a limit switch or the emergency stop) becomes active, the step task is stopped at once. The inputs
//! task does this work, so a busy controller delays no stop.
//!
//! ```text
//!  pin ──▶ polarity ──▶ filter ──┬──▶ Sensed ──▶ control
//!                                └── armed? ──▶ stop of the step task, at once
//! ```

use super::filter::Filter;
use crate::messages::{InputWiring, Sensed, Signals, Wiring};

/// Number of samples after which the filter's levels are valid.
pub const SETTLING: u8 = 8;

/// The filtered inputs, and the stops of the step task that armed inputs have caused.
#[derive(Clone, Debug)]
pub struct Inputs {
    filter: Filter,
    /// The wiring of the inputs, with their polarity; `None` until `control` has sent it. Without the wiring, the
    /// meaning of the levels is unknown.
    wiring: Option<InputWiring>,
    /// Number of samples still to take until the filter's levels are valid.
    settling: u8,
    armed: u32,
    sensed: Sensed,
    active: u32,
    /// `sensed` may differ from what was last sent to `control`.
    changed: bool,
}

impl Default for Inputs {
    fn default() -> Self {
        Self::new()
    }
}

impl Inputs {
    /// Creates the inputs with unknown levels. No input stops the step task until [`Inputs::wire`] has set polarity and
    /// arming.
    pub const fn new() -> Self {
        Inputs {
            filter: Filter::new(),
            wiring: None,
            settling: SETTLING,
            armed: 0,
            sensed: Sensed { signals: Signals::NONE, trips: 0, tripped: 0 },
            active: 0,
            changed: true,
        }
    }

    /// Sets which pin level makes each input active, and which inputs stop the step task when they become active.
    pub fn wire(&mut self, wiring: &Wiring) {
        self.wiring = Some(wiring.inputs);
        self.armed = wiring.armed;
    }

    /// Takes a sample of the pins; a bit is set while its pin is low. Returns whether the step task must be stopped.
    pub fn sample(&mut self, low: u32) -> bool {
        let Some(wiring) = self.wiring else { return false };
        self.settling = self.settling.saturating_sub(1);
        let active = self.filter.sample(low ^ wiring.inverted);
        self.take_levels(active)
    }

    /// Stores filtered levels. Returns whether an armed input (hard limit, emergency stop) has become active, so that
    /// the step task must be stopped at once.
    fn take_levels(&mut self, active: u32) -> bool {
        let changed = active ^ self.active;
        if changed == 0 {
            return false;
        }
        self.active = active;
        self.changed = true;
        self.sensed.signals = Signals::of_word(active);
        let tripped = changed & active & self.armed;
        if tripped != 0 {
            self.sensed.trips = self.sensed.trips.wrapping_add(1);
            self.sensed.tripped |= tripped;
        }
        tripped != 0
    }

    /// Returns the inputs whose change the filter has rejected at the latest sample: see [`Filter::rejected`].
    pub fn rejected(&self) -> u32 {
        self.filter.rejected()
    }

    /// Returns the state of the inputs for `control`; `None` until the levels are known.
    pub fn sensed(&self) -> Option<Sensed> {
        (self.settling == 0).then_some(self.sensed)
    }

    /// Returns whether [`Inputs::sensed`] may have changed since the last [`Inputs::mark_sent`]. Called for each
    /// sample; usually `false`.
    pub fn has_changed(&self) -> bool {
        self.changed
    }

    /// Marks [`Inputs::sensed`] as sent to `control`, and clears its `tripped`.
    pub fn mark_sent(&mut self) {
        self.sensed.tripped = 0;
        self.changed = false;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::messages::input;

    fn armed(armed: u32, inverted: u32) -> Inputs {
        let mut inputs = Inputs::new();
        inputs.armed = armed;
        inputs.wiring = Some(InputWiring { inverted, ..InputWiring::PULL_UPS });
        inputs
    }

    #[test]
    fn an_armed_input_trips_once_and_is_remembered_until_it_was_told() {
        let mut inputs = armed(0b001, 0);
        let mut held = |low| (0..SETTLING).filter(|_| inputs.sample(low)).count();
        assert_eq!([0b010, 0b011, 0b011, 0].map(&mut held), [0, 1, 0, 0]);
        assert_eq!(inputs.sensed(), Some(Sensed { signals: Signals::NONE, trips: 1, tripped: 0b001 }));
        inputs.mark_sent();
        assert_eq!(inputs.sensed(), Some(Sensed { signals: Signals::NONE, trips: 1, tripped: 0 }));
    }

    #[test]
    fn the_filter_comes_before_the_trip() {
        let mut inputs = armed(1 << input::EMERGENCY_STOP, 1 << input::EMERGENCY_STOP);
        let tripped: Vec<bool> = (0..9).map(|_| inputs.sample(0)).collect();
        assert_eq!(tripped.iter().position(|t| *t), Some(7));
        assert!(inputs.sensed().unwrap().signals.emergency_stop);
    }

    #[test]
    fn nothing_is_known_before_the_polarity_is() {
        let mut inputs = Inputs::new();
        assert!((0..100).all(|_| !inputs.sample(0b001) && inputs.sensed().is_none()));
        // The switch is normally closed, and it is closed now: not active.
        inputs.wiring = Some(InputWiring { inverted: 0b001, ..InputWiring::PULL_UPS });
        inputs.armed = 0b001;
        let known: Vec<bool> = (0..8).map(|_| !inputs.sample(0b001) && inputs.sensed().is_some()).collect();
        assert_eq!(known.iter().position(|known| *known), Some(7));
        assert_eq!(inputs.sensed(), Some(Sensed::default()));
    }

    #[test]
    fn words_and_names_agree() {
        for bit in 0..input::COUNT {
            let word = 1 << bit;
            assert_eq!(Signals::of_word(word).word(), word);
        }
    }
}
