//! Determines the present state of the outputs: coolant, drivers, digital outputs, and direction and power of the
//! spindle (with the overrides applied). The controller compares this state with the one last sent, and sends the
//! difference. Also determines whether the spindle is up to speed.

pub(crate) mod given;

use crate::dispatch::Controller;
use crate::error::Alarm;
use crate::gcode::MotionMode;
use crate::machine::accessories::{Accessories, SpinUp};
use crate::machine::realtime_override::Overrides;
use crate::machine::spindle::SpindleRange;
use crate::messages::{Coolant, SlowOutputs, SpindleDirection, Wiring};
use crate::settings::Key;
use crate::states::State;
use crate::states::stops::orders::StopReason;
use crate::units::Instant;

impl<const N: usize> Controller<N> {
    /// Returns whether the spindle has spun up: the spin-up time, which ends at `until`, has passed, and the spindle is
    /// up to speed. If the spindle is still too slow at `until`, it gets the time of `$916` in addition. If it is too
    /// slow after that, too, this function orders an alarm.
    pub(crate) fn has_spun_up(&mut self, until: Instant) -> bool {
        if self.m.now >= until && self.has_no_speed_to_reach() {
            return true;
        }
        let spun_up = self.m.accessories.spun_up(until, self.m.now, self.m.inputs.signals().at_speed, &self.m.settings);
        if spun_up == SpinUp::Late {
            self.m.stops.order(StopReason::Alarm(Alarm::SpindleSpeed));
        }
        spun_up == SpinUp::UpToSpeed
    }

    /// Returns whether the spindle has no power, for example at S0, so that there is no speed to wait for.
    fn has_no_speed_to_reach(&self) -> bool {
        self.resting_power() == 0
    }

    /// Returns whether the spindle is up to speed, judged by the at-speed input and the settings. A spindle without
    /// power counts as up to speed.
    pub(crate) fn has_speed(&self) -> bool {
        self.has_no_speed_to_reach()
            || self.m.accessories.is_at_speed(self.m.inputs.signals().at_speed, &self.m.settings)
    }

    /// Carries out a waiting change of a digital output (M62, M63) if the motion that it waits for has started. In
    /// alarm and sleep, switches all outputs off.
    pub(crate) fn settle_outputs(&mut self) {
        if self.m.accessories.digital().is_waiting() {
            let mark = self.m.motion.begun_mark();
            self.m.accessories.digital_mut().begun(mark);
        }
        if self.state.is_alarm() || matches!(self.state, State::Sleep(_)) {
            self.switch_outputs_off();
        }
    }

    fn switch_outputs_off(&mut self) {
        let mark = self.m.motion.begun_mark();
        self.m.accessories.digital_mut().switch_off(mark);
        self.m.motion.set_mark(mark);
    }

    /// Drops the waiting changes of digital outputs (M62, M63), because the job has been aborted or has ended.
    pub(crate) fn forget_waiting_outputs(&mut self) {
        let mark = self.m.motion.begun_mark();
        self.m.accessories.digital_mut().forget_waiting(mark);
        self.m.motion.set_mark(mark);
    }

    /// Returns the time at which [`Controller::has_spun_up`] must be called again if no input changes.
    pub(crate) fn next_look_at_spindle(&self, until: Instant) -> Instant {
        Accessories::next_look(until, self.m.now, &self.m.settings)
    }

    /// Switches spindle and coolant off. Also changes the modal state, because the next line starts from it and would
    /// otherwise switch spindle and coolant on again.
    pub(crate) fn switch_off(&mut self) {
        self.m.accessories.switch_off();
        self.m.interpreter.set_accessories(SpindleDirection::Off, Coolant::default());
    }

    /// Returns the power of the spindle output while no segment sets it; 0 while the spindle is off or suspended.
    pub(crate) fn resting_power(&self) -> u16 {
        if self.m.accessories.spindle_output() == SpindleDirection::Off { 0 } else { self.turning_power() }
    }

    #[inline(never)]
    fn turning_power(&self) -> u16 {
        if self.is_dark_at_rest() {
            return 0;
        }
        let percent = self.acting_overrides().spindle;
        self.m.accessories.resting_power(
            &self.m.settings,
            percent,
            || self.burns_at_rest(),
            || self.m.motion.running_power(),
        )
    }

    /// Returns whether a laser must be off at rest, whatever the program says. This is so in a jog, in a hold, and in
    /// every other state except normal operation and check mode. Grbl's dialect has no such rule.
    fn is_dark_at_rest(&self) -> bool {
        let is_dark = self.m.settings.is_on(Key::Laser) && self.m.settings.is_on(Key::Dialect);
        is_dark && !matches!(self.state, State::Normal | State::Check)
    }

    /// Returns the power of a segment under the present override. The override is applied when a segment is sent to the
    /// step task, so it also affects queued moves.
    pub(crate) fn overridden_power(&self, power: u16) -> u16 {
        match self.acting_overrides().spindle {
            100 => power,
            percent => SpindleRange::of(&self.m.settings).overridden(power, percent),
        }
    }

    /// Returns the operator's overrides, except those that the program disables (M49).
    fn acting_overrides(&self) -> Overrides {
        let held = self.m.interpreter.acting_modal().overrides_held;
        self.m.accessories.overrides().acting(held.feed, held.spindle)
    }

    /// Passes the feed and rapid overrides to `motion`, as factors: 1.0 for 100 %. They also affect moves in
    /// progress.
    pub(crate) fn apply_overrides(&mut self) {
        let acting = self.acting_overrides();
        self.m.motion.set_overrides(f32::from(acting.feed) / 100.0, f32::from(acting.rapid) / 100.0);
    }

    /// Returns the present direction and speed (rpm) of the spindle. Without power the direction is `Off`.
    pub(crate) fn spindle_now(&self) -> (SpindleDirection, f32) {
        let from_segments =
            self.m.settings.is_on(Key::Laser) && !self.m.motion.is_at_rest() && !self.m.accessories.is_suspended();
        let power = if from_segments { self.overridden_power(self.m.motion.power()) } else { self.resting_power() };
        let direction = if power == 0 { SpindleDirection::Off } else { self.m.accessories.spindle() };
        (direction, SpindleRange::of(&self.m.settings).speed_of(power))
    }

    /// Returns whether a laser with constant power (M3) stays on between feed motions. This is so if the active motion
    /// mode is a feed motion, such as G1, and not, for example, G0.
    pub(crate) fn burns_at_rest(&self) -> bool {
        matches!(
            self.m.interpreter.acting_modal().motion,
            MotionMode::Linear | MotionMode::ArcClockwise | MotionMode::ArcCounterClockwise | MotionMode::Spline(_)
        )
    }

    pub(crate) fn changed_pins(&mut self) -> Option<SlowOutputs> {
        let pins = SlowOutputs {
            spindle: self.m.accessories.spindle_output(),
            power: self.resting_power(),
            power_from_segments: self.m.settings.is_on(Key::Laser) && !self.m.accessories.is_suspended(),
            coolant: self.m.accessories.coolant(),
            drivers: self.m.drivers.are_on(self.m.settings.whole(Key::IdleDelay)) && !self.drivers_held_off(),
            digital: self.m.accessories.digital().levels(),
        };
        self.m.pins.changed(pins)
    }

    pub(crate) fn changed_wiring(&mut self) -> Option<Wiring> {
        self.m.pins.changed_wiring(&self.m.settings, self.m.inputs.wiring(), matches!(self.state, State::Homing(_)))
    }

    /// Returns whether the motors must have no current, regardless of `$1`: in sleep and, with `$913`, after an
    /// emergency stop or a driver fault until its alarm has been acknowledged.
    fn drivers_held_off(&self) -> bool {
        matches!(self.state, State::Sleep(_))
            || matches!(self.state.alarm(), Some(Alarm::EmergencyStop | Alarm::DriverFault))
                && self.m.settings.is_on(Key::EmergencyDriversOff)
    }
}
