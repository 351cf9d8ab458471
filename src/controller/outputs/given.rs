//! The outputs and the wiring as they were given out last, so that only changes are sent. Also notes whether anything
//! has happened since: while nothing has, the controller skips this check.

use crate::axes::AxisMask;
use crate::inputs::levels;
use crate::messages::{GangedMotors, InputWiring, SlowOutputs, SpindleDirection, Wiring};
use crate::settings::{Key, Settings};

/// Levels and wiring as they were given out last.
#[derive(Clone, Debug)]
pub(crate) struct Pins {
    /// Motors of the ganged axis that take their steps: one alone in squaring.
    ganged_motors: GangedMotors,
    /// Nothing has happened since that could change them.
    calm: bool,
    levels: Option<SlowOutputs>,
    wiring: Option<Wiring>,
    /// What that was made of.
    source: Option<WiringSource>,
}

/// All that [`Wiring`] depends on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct WiringSource {
    settings: u32,
    inputs: InputWiring,
    homing: bool,
    ganged_motors: GangedMotors,
}

impl Pins {
    /// Nothing has been given out.
    pub(crate) const UNKNOWN: Pins =
        Pins { ganged_motors: GangedMotors::Both, calm: false, levels: None, wiring: None, source: None };

    /// Whether nothing has happened since they were given out that could change them.
    #[inline]
    pub(crate) fn are_calm(&self) -> bool {
        self.calm
    }

    /// They are as they were given out, and only motion is under way.
    #[inline]
    pub(crate) fn calm_down(&mut self) {
        self.calm = true;
    }

    /// Something has happened: an event, a piece of a line, a driver switched on.
    #[inline]
    pub(crate) fn disturb(&mut self) {
        self.calm = false;
    }

    /// Motors of the ganged axis that take their steps from now on.
    pub(crate) fn drive(&mut self, motors: GangedMotors) {
        self.ganged_motors = motors;
    }

    /// Whether spindle and laser are known to be off.
    pub(crate) fn are_off(&self) -> bool {
        self.levels.is_some_and(|levels| levels.spindle == SpindleDirection::Off && levels.power == 0)
    }

    /// Levels of the slow outputs, if they are not those given out last.
    pub(crate) fn changed(&mut self, levels: SlowOutputs) -> Option<SlowOutputs> {
        (self.levels != Some(levels)).then(|| {
            self.levels = Some(levels);
            levels
        })
    }

    /// The wiring, if it is not that given out last.
    #[inline]
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
