//! The input task: samples the simulated pins through the boards' own filter. A pin is low if a hand or a closed
//! contact pulls it. Reports changes to the controller, and stops the step task if an armed input becomes active.

use crate::clock::Clock;
use crate::fittings::Fittings;
use oxmill_controller::machine::signals::{Inputs, SETTLING};
use oxmill_controller::messages::{Sensed, Signals, Wiring, input};

/// The pins and the filter behind them.
#[derive(Clone)]
pub struct InputTask {
    /// Levels that a hand has put on the pins, and those of the machine's own contacts at the last sample.
    hand: Signals,
    contacts: Signals,
    /// Samples since the contacts last changed.
    steady: u8,
    /// When the next sample is due, in ticks; `None` while nothing can change.
    sample_due: Option<u64>,
    inputs: Inputs,
    /// Changes of each input that the filter has rejected.
    noise: [u16; input::COUNT],
    /// What the controller was told of last.
    told: Option<Sensed>,
}

impl Default for InputTask {
    fn default() -> Self {
        InputTask {
            hand: Signals::default(),
            contacts: Signals::default(),
            steady: 0,
            sample_due: None,
            inputs: Inputs::new(),
            noise: [0; input::COUNT],
            told: None,
        }
    }
}

impl InputTask {
    /// Levels that a hand has put on the pins.
    pub fn hand(&self) -> Signals {
        self.hand
    }

    /// Moves pins by hand; whether they have changed.
    pub fn set_hand(&mut self, signals: Signals) -> bool {
        std::mem::replace(&mut self.hand, signals) != signals
    }

    /// Pins that are low: those that a hand has put to 1, and closed contacts.
    pub fn low(&self) -> u32 {
        self.hand.word() | self.contacts.word()
    }

    /// When the next sample is due.
    pub fn sample_due(&self) -> Option<u64> {
        self.sample_due
    }

    /// A contact has moved: a sample is due, unless one is already.
    pub fn sample_at(&mut self, ticks: u64) {
        self.sample_due.get_or_insert(ticks);
    }

    /// One sample with the machine's contacts as they are now; the next follows while the filter or a contact has not
    /// settled. Whether the step task has to be stopped.
    pub fn sample_contacts(&mut self, fittings: &mut Fittings, clock: &Clock, period: u64) -> bool {
        let now = clock.instant().ticks();
        let contacts = fittings.sample(now);
        self.steady = if contacts == self.contacts { self.steady.saturating_add(1) } else { 1 };
        self.contacts = contacts;
        let settled = self.steady >= SETTLING && !fittings.chatter(now);
        self.sample_due = (!settled).then(|| clock.now() + period);
        self.sample(self.low())
    }

    /// A sample; whether an armed input stops the step task here and now.
    pub fn sample(&mut self, low: u32) -> bool {
        let stops = self.inputs.sample(low);
        let rejected = self.inputs.rejected();
        for (bit, count) in self.noise.iter_mut().enumerate() {
            *count = count.saturating_add((rejected >> bit & 1) as u16);
        }
        stops
    }

    /// As many samples as the filter wants; how many of them stop the step task. Not while contacts have not settled at
    /// power-up, for the first that the controller hears of the inputs has them in it.
    pub fn settle(&mut self) -> usize {
        if self.inputs.sensed().is_none() && self.sample_due.is_some() {
            return 0;
        }
        (0..SETTLING).filter(|_| self.sample(self.low())).count()
    }

    /// Polarity and arming.
    pub fn wire(&mut self, wiring: &Wiring) {
        self.inputs.wire(wiring);
    }

    /// The inputs, if they have changed since the controller was told.
    pub fn next_change(&mut self) -> Option<Sensed> {
        let sensed = self.inputs.sensed().filter(|sensed| self.told != Some(*sensed))?;
        self.inputs.told();
        self.told = self.inputs.sensed();
        Some(sensed)
    }

    /// Changes of each input that the filter has rejected.
    pub fn noise(&self) -> [u16; input::COUNT] {
        self.noise
    }

    /// Forgets them.
    pub fn clear_noise(&mut self) {
        self.noise = [0; input::COUNT];
    }
}
