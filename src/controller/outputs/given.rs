//! The outputs and the wiring as they were last sent. The controller compares the present state with them and sends
//! only changes. It skips the comparison if no event since the last one could have changed the outputs.

use crate::axes::AxisMask;
use crate::inputs::levels;
use crate::messages::{GangedMotors, InputWiring, SlowOutputs, SpindleDirection, Wiring};
use crate::settings::{Key, Settings};

/// The slow outputs (spindle, coolant, drivers, digital outputs) and the wiring (polarities, pulse length) that the
/// controller has last sent to the pump.
#[derive(Clone, Debug)]
pub(crate) struct Pins {
    /// Which motors of the ganged axis (the axis with two motors) receive its steps; only one of them while the axis is
    /// squared.
    ganged_motors: GangedMotors,
    /// No event since the last comparison could have changed the outputs, so the next comparison can be skipped.
    calm: bool,
    levels: Option<SlowOutputs>,
    wiring: Option<Wiring>,
    /// Values from which `wiring` was made.
    source: Option<WiringSource>,
}

/// All values that [`Wiring`] depends on; `settings` is the revision of all settings. If none of them has changed,
/// the wiring need not be computed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct WiringSource {
    settings: u32,
    inputs: InputWiring,
    homing: bool,
    ganged_motors: GangedMotors,
}

impl Pins {
    /// The value at power-up: neither outputs nor wiring have been sent.
    pub(crate) const UNKNOWN: Pins =
        Pins { ganged_motors: GangedMotors::Both, calm: false, levels: None, wiring: None, source: None };

    /// Returns whether the comparison of the outputs can be skipped, because no event since the last one could have
    /// changed them.
    pub(crate) fn are_calm(&self) -> bool {
        self.calm
    }

    /// Skips the comparison of the outputs from now on, until [`Pins::disturb`] is called. Called when all changes
    /// have been sent and the machine only moves, because motion alone does not change these outputs.
    pub(crate) fn calm_down(&mut self) {
        self.calm = true;
    }

    /// Makes the controller compare the outputs with those last sent. Called after an event that could have changed
    /// them, such as a message, a part of a line, or a driver that was switched on.
    pub(crate) fn disturb(&mut self) {
        self.calm = false;
    }

    /// Selects the motors of the ganged axis that receive its steps.
    pub(crate) fn drive(&mut self, motors: GangedMotors) {
        self.ganged_motors = motors;
    }

    /// Returns whether the levels last sent switch spindle and laser off; `false` if none have been sent yet.
    pub(crate) fn are_off(&self) -> bool {
        self.levels.is_some_and(|levels| levels.spindle == SpindleDirection::Off && levels.power == 0)
    }

    /// Returns the levels of the slow outputs if they differ from those last sent, and records them as sent;
    /// otherwise `None`.
    pub(crate) fn changed(&mut self, levels: SlowOutputs) -> Option<SlowOutputs> {
        (self.levels != Some(levels)).then(|| {
            self.levels = Some(levels);
            levels
        })
    }

    /// Returns the wiring (polarities, pulse length, armed inputs and so on) if it differs from the one last sent, and
    /// records it as sent; otherwise `None`.
    pub(crate) fn changed_wiring<const N: usize>(
        &mut self,
        settings: &Settings<N>,
        inputs: InputWiring,
        homing: bool,
    ) -> Option<Wiring> {
        let source = WiringSource { settings: settings.revision(), inputs, homing, ganged_motors: self.ganged_motors };
        if self.source == Some(source) {
            return None;
        }
        self.source = Some(source);
        self.new_wiring(settings, &source)
    }

    #[inline(never)]
    fn new_wiring<const N: usize>(&mut self, s: &Settings<N>, source: &WiringSource) -> Option<Wiring> {
        let wiring = Wiring {
            pulse_tenths: s.step_pulse_tenths(),
            direction_setup_us: s.whole(Key::DirectionSetup) as u8,
            step_invert: s.whole(Key::StepInvert) as u8,
            direction_invert: s.whole(Key::DirectionInvert) as u8,
            enable_invert: s.is_on(Key::EnableInvert),
            pwm_hz: s.whole(Key::SpindlePwm),
            probe_invert: s.is_on(Key::ProbeInvert),
            inputs: source.inputs,
            armed: levels::armed(s, source.homing),
            ganged: s.ganged_axis().map_or(0, |axis| AxisMask::NONE.with(axis).0),
            ganged_invert: s.is_on(Key::GangedInvert),
            ganged_motors: source.ganged_motors,
        };
        (self.wiring != Some(wiring)).then(|| {
            self.wiring = Some(wiring);
            wiring
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_wiring_is_given_out_when_it_changes() {
        let mut pins = Pins::UNKNOWN;
        let mut settings = Settings::<3>::default();
        let changed = |pins: &mut Pins, settings: &Settings<3>| {
            pins.changed_wiring(settings, InputWiring::PULL_UPS, false).is_some()
        };
        assert!(changed(&mut pins, &settings));
        assert!(!changed(&mut pins, &settings));
        settings.set(Key::IdleDelay.number(), crate::units::Decimal::ZERO).unwrap();
        assert!(!changed(&mut pins, &settings), "it is no part of the wiring");
        pins.drive(GangedMotors::First);
        assert!(changed(&mut pins, &settings));
        assert!(pins.changed_wiring(&settings, InputWiring { pull_down: 1, ..InputWiring::PULL_UPS }, false).is_some());
    }

    #[test]
    fn levels_are_unknown_until_they_were_given_out() {
        let mut pins = Pins::UNKNOWN;
        assert!(!pins.are_off());
        let off = SlowOutputs {
            spindle: SpindleDirection::Off,
            power: 0,
            power_from_segments: false,
            coolant: crate::messages::Coolant::default(),
            drivers: false,
            digital: 0,
        };
        assert_eq!((pins.changed(off), pins.changed(off)), (Some(off), None));
        assert!(pins.are_off());
        pins.changed(SlowOutputs { power: 1, ..off });
        assert!(!pins.are_off());
    }
}
