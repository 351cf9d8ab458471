//! Pins, answers and reports: what the outside gets to see.

use super::{Controller, Damage, REPLY_RESERVE, StopReason, WiringSource, motion_settings};
use crate::axes::AxisMask;
use crate::error::Alarm;
use crate::gcode::{Dialect, MotionMode};
use crate::machine::spindle::SpindleRange;
use crate::machine::state::Mode;
use crate::messages::{Chunk, InputWiring, SECOND_SWITCH, Signals, SlowOutputs, SpindleDirection, Wiring, input};
use crate::protocol::report;
use crate::protocol::text::Text;
use crate::settings::{Key, Settings};
use crate::units::{Instant, per_minute};

impl<const N: usize, const BLOCKS: usize> Controller<N, BLOCKS> {
    pub(super) fn dialect(&self) -> Dialect {
        dialect(&self.settings)
    }

    pub(super) fn spindle_range(&self) -> SpindleRange {
        SpindleRange {
            maximum: self.settings.value(Key::SpindleMaximum),
            minimum: self.settings.value(Key::SpindleMinimum),
        }
    }

    /// Whether a cut has to wait for the input that tells of the spindle's speed (`$915`).
    pub(super) fn must_tell_speed(&self) -> bool {
        self.settings.whole(Key::AtSpeed) != 0
            && !self.settings.is_on(Key::Laser)
            && self.spindle != SpindleDirection::Off
    }

    /// Whether the spindle turns as it should, as far as anybody can tell.
    pub(super) fn is_at_speed(&self) -> bool {
        !self.must_tell_speed() || self.signals.at_speed == (self.settings.whole(Key::AtSpeed) == 1)
    }

    /// Whether a spindle that should have turned long enough at a moment has, and is up to speed. If it is not within
    /// `$916` after that moment, an alarm is on its way.
    pub(super) fn has_spun_up(&mut self, until: Instant) -> bool {
        if self.now < until {
            return false;
        }
        let at_speed = self.is_at_speed();
        if !at_speed && self.now >= until + self.settings.seconds(Key::AtSpeedWithin) {
            self.order_stop(StopReason::Alarm(Alarm::SpindleSpeed));
        }
        at_speed
    }

    /// When [`Controller::has_spun_up`] has to be asked again, if no input changes.
    pub(super) fn next_look_at_spindle(&self, until: Instant) -> Instant {
        if self.now < until { until } else { until + self.settings.seconds(Key::AtSpeedWithin) }
    }

    /// Power of the spindle while nothing moves. A laser with constant power (M3) stays on between feed motions; one
    /// with scaled power (M4) is off at no speed.
    #[inline]
    pub(super) fn resting_power(&self) -> u16 {
        if self.spindle == SpindleDirection::Off || self.spindle_stopped { 0 } else { self.turning_power() }
    }

    #[inline(never)]
    fn turning_power(&self) -> u16 {
        let laser = self.settings.is_on(Key::Laser);
        if laser && (self.spindle != SpindleDirection::Clockwise || !self.burns_at_rest()) {
            return 0;
        }
        self.spindle_range().output(self.programmed_speed(), self.overrides.spindle).0
    }

    /// S of the move under way. Without one, and for a laser, whose power the segments carry, that of the last line.
    fn programmed_speed(&self) -> f32 {
        if self.settings.is_on(Key::Laser) {
            return self.spindle_speed;
        }
        let range = self.spindle_range();
        match self.motion.running_power() {
            Some(power) if power != range.output(self.spindle_speed, 100).0 => range.speed_of(power),
            _ => self.spindle_speed,
        }
    }

    /// A segment's power under the override of this moment: queued moves feel it too.
    pub(super) fn overridden_power(&self, power: u16) -> u16 {
        match self.overrides.spindle {
            100 => power,
            percent => {
                let range = self.spindle_range();
                range.output(range.speed_of(power), percent).0
            }
        }
    }

    /// Direction and speed of the spindle as it turns now; a spindle without power does not turn.
    pub(super) fn spindle_now(&self) -> (SpindleDirection, f32) {
        let from_segments = self.settings.is_on(Key::Laser) && !self.motion.is_at_rest() && !self.spindle_stopped;
        let power = if from_segments { self.overridden_power(self.motion.power()) } else { self.resting_power() };
        let direction = if power == 0 { SpindleDirection::Off } else { self.spindle };
        (direction, self.spindle_range().speed_of(power))
    }

    /// A laser with constant power (M3) stays on between feed motions.
    pub(super) fn burns_at_rest(&self) -> bool {
        matches!(
            self.interpreter.modal().motion,
            MotionMode::Linear | MotionMode::ArcClockwise | MotionMode::ArcCounterClockwise
        )
    }

    pub(super) fn changed_pins(&mut self) -> Option<SlowOutputs> {
        let pins = SlowOutputs {
            spindle: if self.spindle_stopped { SpindleDirection::Off } else { self.spindle },
            power: self.resting_power(),
            power_from_segments: self.settings.is_on(Key::Laser) && !self.spindle_stopped,
            coolant: self.coolant,
            drivers: self.drivers.are_on(self.settings.whole(Key::IdleDelay)) && !self.drivers_held_off(),
        };
        (self.pins_sent != Some(pins)).then(|| {
            self.pins_sent = Some(pins);
            pins
        })
    }

    #[inline]
    pub(super) fn changed_wiring(&mut self) -> Option<Wiring> {
        let source = WiringSource {
            settings: self.settings.revision(),
            inputs: self.input_wiring,
            homing: self.mode == Mode::Home,
            ganged_motors: self.ganged_motors,
        };
        if self.wiring_source == Some(source) {
            return None;
        }
        self.wiring_source = Some(source);
        self.new_wiring()
    }

    #[inline(never)]
    fn new_wiring(&mut self) -> Option<Wiring> {
        let s = &self.settings;
        let wiring = Wiring {
            pulse_us: s.whole(Key::StepPulse) as u8,
            direction_setup_us: s.whole(Key::DirectionSetup) as u8,
            step_invert: s.whole(Key::StepInvert) as u8,
            direction_invert: s.whole(Key::DirectionInvert) as u8,
            enable_invert: s.is_on(Key::EnableInvert),
            pwm_hz: s.whole(Key::SpindlePwm),
            probe_invert: s.is_on(Key::ProbeInvert),
            inputs: self.input_wiring,
            armed: self.armed_inputs(),
            ganged: s.ganged_axis().map_or(0, |axis| AxisMask::NONE.with(axis).0),
            ganged_invert: s.is_on(Key::GangedInvert),
            ganged_motors: self.ganged_motors,
        };
        (self.wiring_sent != Some(wiring)).then(|| {
            self.wiring_sent = Some(wiring);
            wiring
        })
    }

    /// `$913`: no current in the motors until the emergency has been acknowledged.
    fn drivers_held_off(&self) -> bool {
        matches!(self.alarm, Some(Alarm::EmergencyStop | Alarm::DriverFault))
            && self.settings.is_on(Key::EmergencyDriversOff)
    }

    /// Inputs that stop the step task themselves: not the switches that homing looks for.
    fn armed_inputs(&self) -> u16 {
        let limits = self.settings.is_on(Key::HardLimits) && self.mode != Mode::Home;
        let second = if self.settings.is_on(Key::GangedSwitch) { SECOND_SWITCH } else { 0 };
        let switches = if limits { u16::from(limits_of::<N>() | second) } else { 0 };
        switches | 1 << input::RESET | 1 << input::EMERGENCY_STOP | 1 << input::DRIVER_FAULT
    }

    /// Polarity and resistors of the inputs, from the settings.
    fn wired_inputs(&self) -> InputWiring {
        let s = &self.settings;
        let probe = |key| u16::from(s.is_on(key)) << input::PROBE;
        let limits = |key| s.whole(key) as u16 & u16::from(limits_of::<N>() | SECOND_SWITCH);
        let control = |key| control_word(s.whole(key));
        let all_limits = if s.is_on(Key::LimitInvert) { u16::from(limits_of::<N>() | SECOND_SWITCH) } else { 0 };
        InputWiring {
            inverted: all_limits ^ limits(Key::LimitInvertEach) | probe(Key::ProbeInvert) | control(Key::ControlInvert),
            no_pull_up: limits(Key::LimitNoPullUp) | probe(Key::ProbeNoPullUp) | control(Key::ControlNoPullUp),
            pull_down: limits(Key::LimitPullDown) | probe(Key::ProbePullDown) | control(Key::ControlPullDown),
        }
    }

    pub(super) fn has_reply_room(&self) -> bool {
        self.replies.capacity() - self.replies.len() >= REPLY_RESERVE
    }

    /// Makes a piece of answer. There is always room: whoever can wait asks `has_reply_room` first, and what cannot (an
    /// alarm, a message) is short. Only a flood of resets makes more; what then finds no room is left out as a whole.
    pub(super) fn say(&mut self, make: impl FnOnce(&mut Text)) {
        let mut text = Text::new();
        make(&mut text);
        self.queue_reply(&text);
    }

    // Once, and not in each of the forty places that say something.
    #[inline(never)]
    fn queue_reply(&mut self, text: &[u8]) {
        // The next host would take the answer to a line of one that has gone for one of its own.
        let unheard = self.hosts_gone != self.lines.hosts_cut() && !self.echoed && report::is_answer(text);
        if unheard || self.replies.capacity() - self.replies.len() < text.len() {
            return;
        }
        self.echoed = text.last() == Some(&b':');
        for byte in text {
            let _ = self.replies.push_back(*byte);
        }
    }

    /// The welcome line. What a host is told once, it may not have heard before.
    pub(super) fn greet(&mut self) {
        if self.is_store_damaged() {
            self.damage = Damage::Untold;
        }
        self.say(report::welcome);
        self.tell_failure();
        self.settings_lock.host_greeted();
    }

    /// At each welcome line until the host has asked for the record: nobody may have listened to the first one.
    fn tell_failure(&mut self) {
        if self.restart.is_failure() && !self.restart_told {
            let restart = self.restart.clone();
            self.say(|out| report::failure(out, &restart));
        }
    }

    pub(super) fn reply_chunk(&mut self) -> Option<Chunk> {
        let mut chunk = Chunk { len: 0, bytes: [0; 15] };
        for slot in &mut chunk.bytes {
            let Some(byte) = self.replies.pop_front() else { break };
            *slot = byte;
            chunk.len += 1;
        }
        (chunk.len > 0).then_some(chunk)
    }

    /// The report that a `?` has asked for, if there is room for it.
    pub(super) fn answer_status(&mut self) {
        if self.status_due && self.has_reply_room() {
            self.status_due = false;
            self.report_status();
        }
    }

    #[inline(never)]
    fn report_status(&mut self) {
        let busy = self.running
            || matches!(self.mode, Mode::Hold | Mode::Stopping { .. } | Mode::Jog { .. } | Mode::Door(_) | Mode::Home);
        let (show_offset, show_overrides) = self.rare_fields.next(busy);
        let mask = self.settings.whole(Key::StatusReport);
        let (spindle, speed) = self.spindle_now();
        let grbl = self.dialect() == Dialect::Grbl;
        let line = self.motion.line_number();
        let status = report::Status {
            state: self.mode.name(self.motion.is_at_rest(), self.running, self.signals.door),
            machine: self.machine_position(),
            offset: self.interpreter.work_offset(),
            show_machine: mask & 1 != 0,
            buffer: (mask & 2 != 0).then_some((self.motion.free_blocks(), self.observed.rx_free)),
            line: (line > 0 && !grbl).then_some(line),
            feed: per_minute(self.motion.speed().max(self.detour.speed())),
            speed,
            pins: self.shown_signals(),
            show_offset,
            overrides: show_overrides.then_some((
                [self.overrides.feed, self.overrides.rapid, self.overrides.spindle],
                spindle,
                self.coolant,
            )),
        };
        let inches = self.settings.is_on(Key::ReportInches);
        self.say(|out| report::status(out, &status, inches));
    }

    /// The inputs as a report shows them.
    fn shown_signals(&self) -> Signals {
        Signals { limits: self.axes_of_switches(self.signals.limits), ..self.signals }
    }

    /// A switch at a second motor is one of its axis.
    pub(super) fn axes_of_switches(&self, switches: u8) -> u8 {
        match self.settings.ganged_axis() {
            Some(axis) if switches & SECOND_SWITCH != 0 => switches & !SECOND_SWITCH | AxisMask::NONE.with(axis).0,
            _ => switches & !SECOND_SWITCH,
        }
    }

    /// Hands changed settings to the rooms that keep numbers derived from them. Only at rest.
    pub(super) fn reconfigure(&mut self) {
        self.signals = self.fitted(self.pins);
        self.input_wiring = self.wired_inputs();
        self.motion.configure(motion_settings(&self.settings, &self.profile));
    }
}

/// Bits of the limit switches of the axes, without that of a second motor.
const fn limits_of<const N: usize>() -> u8 {
    (1 << N) - 1
}

/// The control inputs of a mask in grblHAL's order as a word of [`input`].
fn control_word(mask: u32) -> u16 {
    let bit = |from: u32, to: u32| (mask >> from & 1) << to;
    let word = bit(0, input::RESET)
        | bit(1, input::HOLD)
        | bit(2, input::START)
        | bit(3, input::DOOR)
        | bit(6, input::EMERGENCY_STOP)
        | bit(8, input::DRIVER_FAULT);
    word as u16
}

/// What the host is spoken to in.
pub(super) fn dialect<const N: usize>(settings: &Settings<N>) -> Dialect {
    match settings.whole(Key::Dialect) {
        0 => Dialect::Grbl,
        2 => Dialect::Seed,
        _ => Dialect::Oxmill,
    }
}
