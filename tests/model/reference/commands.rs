//! How the reference model reacts to realtime commands and input pins.

use super::super::action::{self, Pin};
use super::{Mode, Model, SLACK, Span, Work};

impl Model {
    pub(super) fn command(&mut self, byte: u8, also: &mut Vec<Model>) {
        match byte {
            action::RESET => self.reset(also),
            action::STOP => self.stop(also),
            action::HOLD => self.hold(),
            action::START => self.start(also),
            action::DOOR => self.door_opens(also),
            action::JOG_CANCEL => {
                self.end_jogs(true);
                if self.mode == Mode::Jog {
                    self.brake();
                }
            }
            action::SPINDLE_STOP if self.mode == Mode::Hold && self.spindle => {
                if self.braking.is_some() {
                    self.stops_at_rest = true;
                } else if self.spindle_stopped {
                    self.restore_spindle();
                } else {
                    self.spindle_stopped = true;
                }
            }
            // Oxmill: single block can be toggled at any time. Grbl's dialect ignores this command.
            action::SINGLE_BLOCK if !self.setup.grbl => self.toggle_single_block(also),
            action::FLOOD_TOGGLE if matches!(self.mode, Mode::Free | Mode::Hold) => self.flood = !self.flood,
            // Oxmill: overrides also act in an alarm that only a reset ends.
            _ => self.override_speed(byte),
        }
    }

    /// Toggles single block (0x89). If it goes off while the motion of a line is in progress, this line is answered
    /// at once, and no pause follows.
    pub(super) fn toggle_single_block(&mut self, also: &mut Vec<Model>) {
        self.single_block = !self.single_block;
        self.say(if self.single_block { "[MSG:Single block on]" } else { "[MSG:Single block off]" });
        if self.mode == Mode::Free {
            self.end_single_block();
            self.read(also);
        }
    }

    pub(super) fn end_single_block(&mut self) {
        if !self.single_block && self.work == Some(Work::SingleBlock) {
            self.work = None;
            self.say("ok");
        }
    }

    pub(super) fn override_speed(&mut self, byte: u8) {
        let [feed, rapid, spindle] = &mut self.overrides;
        let before = [*feed, *rapid];
        match byte {
            action::FEED_100 => *feed = 100,
            action::FEED_UP => *feed = (*feed + 10).min(200),
            action::FEED_DOWN => *feed = (*feed - 10).max(10),
            action::FEED_UP_FINE => *feed = (*feed + 1).min(200),
            action::FEED_DOWN_FINE => *feed = (*feed - 1).max(10),
            action::RAPID_100 => *rapid = 100,
            action::RAPID_50 => *rapid = 50,
            action::RAPID_25 => *rapid = 25,
            action::SPINDLE_100 => *spindle = 100,
            action::SPINDLE_UP => *spindle = (*spindle + 10).min(200),
            action::SPINDLE_DOWN => *spindle = (*spindle - 10).max(10),
            action::SPINDLE_UP_FINE => *spindle = (*spindle + 1).min(200),
            action::SPINDLE_DOWN_FINE => *spindle = (*spindle - 1).max(10),
            _ => {}
        }
        let ratio = |i: usize| f64::from(before[i]) / f64::from(self.overrides[i]);
        self.slow_down(ratio(0).min(ratio(1)).min(1.0), ratio(0).max(ratio(1)).max(1.0));
    }

    /// Multiplies the remaining time of a motion by a factor between `least` and `most`, because an override has
    /// changed. Jogs are not affected.
    pub(super) fn slow_down(&mut self, least: f64, most: f64) {
        let Some(motion) = self.motion.as_mut().filter(|_| self.mode != Mode::Jog && least != most) else { return };
        let now = if motion.held { Span::at(0.0) } else { self.now };
        let ramp = 2.0 * motion.speed / action::ACCELERATION;
        let left = Span { from: motion.time.from - now.to, to: motion.time.to - now.from };
        motion.time = now.plus(Span { from: (left.from * least - ramp).max(0.0), to: left.to * most + ramp + SLACK });
        motion.speed *= most.max(1.0 / least);
    }

    /// Handles 0x19, a command of Oxmill that Grbl's dialect ignores. The machine brakes and drops the job. Position
    /// and modal state are kept.
    pub(super) fn stop(&mut self, also: &mut Vec<Model>) {
        if self.setup.grbl {
            return;
        }
        self.drop_lines();
        match self.mode {
            Mode::Free | Mode::Jog | Mode::Hold => {
                self.brake();
                self.mode = Mode::Stop;
                if self.braking.is_none() {
                    self.rest(also);
                }
            }
            Mode::Home(_) => self.fail_homing(6, also),
            Mode::Door { .. } => {
                // The line in progress is not dropped: it is answered when the door state ends.
                self.work = self.work.take().map(|_| Work::Pause);
                if self.braking.is_some() {
                    self.forgets = true;
                } else {
                    self.forget_motion();
                }
            }
            _ => {}
        }
    }

    pub(super) fn pin(&mut self, pin: Pin, on: bool, also: &mut Vec<Model>) {
        self.pins[pin.index()] = on;
        if !on {
            return;
        }
        match pin {
            Pin::Door => self.door_opens(also),
            Pin::Reset => self.reset(also),
            Pin::Hold => self.hold(),
            Pin::Start => self.start(also),
            Pin::EmergencyStop => self.fault(101, also),
            Pin::DriverFault => self.fault(102, also),
            Pin::Limit(axis) => {
                if matches!(self.mode, Mode::Home(_)) {
                    self.switch_touched(axis);
                } else if self.setup.hard_limits && !matches!(self.mode, Mode::Alarm | Mode::Critical) {
                    self.fault(1, also);
                }
            }
        }
    }
}
