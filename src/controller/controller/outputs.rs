//! What the outputs are to be now: power and direction of the spindle under the acting overrides, at rest and in
//! segments, whether a laser burns at rest, whether the spindle has spun up; digital outputs that wait for a motion's
//! mark; drivers held off in an emergency. Collected as `SlowOutputs` (`changed_pins`). `begun_mark`, `changed_wiring`,
//! `next_look` and `settle_outputs` follow the motion.
//!
//! Names: In it are `spindle_now`, `turning_power`, `overridden_power`, `resting_power`, `burns_at_rest`,
//! `has_spun_up`, `next_look_at_spindle`, `apply_overrides`, `switch_off`, `stop_spindle`, `switch_outputs_off`,
//! `drivers_held_off`, `forget_waiting_outputs`; `Key::Laser`, `Key::IdleDelay`, `Alarm::SpindleSpeed`.

use super::Controller;
use crate::error::Alarm;
use crate::gcode::MotionMode;
use crate::machine::accessories::{Accessories, SpinUp};
use crate::machine::realtime_override::Overrides;
use crate::machine::spindle::SpindleRange;
use crate::machine::state::Mode;
use crate::machine::stops::StopReason;
use crate::messages::{Coolant, SlowOutputs, SpindleDirection, Wiring};
use crate::settings::Key;
use crate::units::Instant;

impl<const N: usize> Controller<N> {
    /// Whether a spindle that should have turned long enough at a moment has, and is up to speed. If it is not within
    /// `$916` after that moment, an alarm is on its way.
    pub(super) fn has_spun_up(&mut self, until: Instant) -> bool {
        if self.now >= until && self.has_no_speed_to_reach() {
            return true;
        }
        let spun_up = self.accessories.spun_up(until, self.now, self.inputs.signals().at_speed, &self.settings);
        if spun_up == SpinUp::Late {
            self.stops.order(StopReason::Alarm(Alarm::SpindleSpeed));
        }
        spun_up == SpinUp::UpToSpeed
    }

    /// Whether the spindle is on with S0: it tells of no speed.
    fn has_no_speed_to_reach(&self) -> bool {
        self.resting_power() == 0
    }

    /// Whether a spindle that was switched on again in this hold is not up to speed yet.
    pub(super) fn is_spinning_up(&self) -> bool {
        let at_speed = self.has_no_speed_to_reach()
            || self.accessories.is_at_speed(self.inputs.signals().at_speed, &self.settings);
        self.accessories.turns_at().is_some_and(|at| self.now < at || !at_speed)
    }

    /// Outputs follow the motion that has begun; they are off where the machine is locked.
    #[inline]
    pub(super) fn settle_outputs(&mut self) {
        if self.accessories.digital().is_waiting() {
            let mark = self.motion.begun_mark();
            self.accessories.digital_mut().begun(mark);
        }
        if self.mode.is_alarm() || matches!(self.mode, Mode::Sleep(_)) {
            self.switch_outputs_off();
        }
    }

    fn switch_outputs_off(&mut self) {
        let mark = self.motion.begun_mark();
        self.accessories.digital_mut().switch_off(mark);
        self.motion.set_mark(mark);
    }

    /// The job is forgotten, or has come to its end: what waits for a motion is forgotten with it.
    pub(super) fn forget_waiting_outputs(&mut self) {
        let mark = self.motion.begun_mark();
        self.accessories.digital_mut().forget_waiting(mark);
        self.motion.set_mark(mark);
    }

    /// When [`Controller::has_spun_up`] has to be asked again, if no input changes.
    pub(super) fn next_look_at_spindle(&self, until: Instant) -> Instant {
        Accessories::next_look(until, self.now, &self.settings)
    }

    /// Spindle and coolant, whose state the next line inherits.
    pub(super) fn switch_off(&mut self) {
        self.accessories.switch_off();
        self.interpreter.set_accessories(SpindleDirection::Off, Coolant::default());
    }

    /// M5 without a word of the program, if the spindle is on: the next line inherits it.
    pub(super) fn stop_spindle(&mut self) {
        if self.accessories.is_on() {
            self.accessories.stop_spindle();
            self.interpreter.set_accessories(SpindleDirection::Off, self.accessories.coolant());
            self.replies.overrides_changed();
        }
    }

    /// Power of the spindle while nothing moves.
    #[inline]
    pub(super) fn resting_power(&self) -> u16 {
        if self.accessories.spindle_output() == SpindleDirection::Off { 0 } else { self.turning_power() }
    }

    #[inline(never)]
    fn turning_power(&self) -> u16 {
        let percent = self.acting_overrides().spindle;
        self.accessories.resting_power(&self.settings, percent, || self.burns_at_rest(), || self.motion.running_power())
    }

    /// A segment's power under the override of this moment: queued moves feel it too.
    #[inline]
    pub(super) fn overridden_power(&self, power: u16) -> u16 {
        match self.acting_overrides().spindle {
            100 => power,
            percent => SpindleRange::of(&self.settings).overridden(power, percent),
        }
    }

    /// The operator's overrides, as far as the program does not hold them off (M49).
    fn acting_overrides(&self) -> Overrides {
        let held = self.interpreter.acting_modal().overrides_held;
        self.accessories.overrides().acting(held.feed, held.spindle)
    }

    /// The moves under way take the overrides over.
    pub(super) fn apply_overrides(&mut self) {
        let acting = self.acting_overrides();
        self.motion.set_overrides(f32::from(acting.feed) / 100.0, f32::from(acting.rapid) / 100.0);
    }

    /// Direction and speed of the spindle as it turns now; a spindle without power does not turn.
    pub(super) fn spindle_now(&self) -> (SpindleDirection, f32) {
        let from_segments =
            self.settings.is_on(Key::Laser) && !self.motion.is_at_rest() && !self.accessories.is_suspended();
        let power = if from_segments { self.overridden_power(self.motion.power()) } else { self.resting_power() };
        let direction = if power == 0 { SpindleDirection::Off } else { self.accessories.spindle() };
        (direction, SpindleRange::of(&self.settings).speed_of(power))
    }

    /// A laser with constant power (M3) stays on between feed motions.
    pub(super) fn burns_at_rest(&self) -> bool {
        matches!(
            self.interpreter.acting_modal().motion,
            MotionMode::Linear | MotionMode::ArcClockwise | MotionMode::ArcCounterClockwise | MotionMode::Spline(_)
        )
    }

    pub(super) fn changed_pins(&mut self) -> Option<SlowOutputs> {
        let pins = SlowOutputs {
            spindle: self.accessories.spindle_output(),
            power: self.resting_power(),
            power_from_segments: self.settings.is_on(Key::Laser) && !self.accessories.is_suspended(),
            coolant: self.accessories.coolant(),
            drivers: self.drivers.are_on(self.settings.whole(Key::IdleDelay)) && !self.drivers_held_off(),
            digital: self.accessories.digital().levels(),
        };
        self.pins.changed(pins)
    }

    #[inline]
    pub(super) fn changed_wiring(&mut self) -> Option<Wiring> {
        self.pins.changed_wiring(&self.settings, self.inputs.wiring(), matches!(self.mode, Mode::Home(_)))
    }

    /// No current in the motors, whatever `$1` says: in sleep, and with `$913` until the emergency has been acknowledged.
    fn drivers_held_off(&self) -> bool {
        matches!(self.mode, Mode::Sleep(_))
            || matches!(self.mode.alarm(), Some(Alarm::EmergencyStop | Alarm::DriverFault))
                && self.settings.is_on(Key::EmergencyDriversOff)
    }
}
