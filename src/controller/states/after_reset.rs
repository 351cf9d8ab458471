//! The machine after power-up, a reset or an alarm. Every power-up and reset ends here: the host is greeted, inputs are
//! checked, and the startup lines begin unless the machine is locked. Also here: locking the machine, and passing
//! changed settings on to motion and inputs.

use crate::dispatch::Controller;
use crate::error::Alarm;
use crate::gcode::Dialect;
use crate::inputs::levels;
use crate::messages::GangedMotors;
use crate::motion::MotionSettings;
use crate::protocol::reply_texts;
use crate::settings::{AxisKey, Key, Settings};
use crate::states::State;
use crate::units::{StepsPerMm, per_second};
use crate::view::dialect;
use crate::work::line::Message;
use crate::work::task::Task;

impl<const N: usize> Controller<N> {
    /// Completes a power-up, a reset or a failed homing: resets accessories, overrides and replies, greets the host,
    /// and checks the inputs. If the machine is not locked, also starts the startup lines.
    pub(crate) fn initialise(&mut self) {
        self.m.pins.drive(GangedMotors::Both);
        let mark = self.m.motion.begun_mark();
        self.m.accessories.reset(mark);
        self.m.motion.set_mark(mark);
        self.m.motion.set_overrides(1.0, 1.0);
        self.reconfigure();
        self.m.interpreter.set_position(self.m.motion.machine_position());
        self.m.probe.forget_result();
        self.line.reset();
        self.line.keep_message(Message::new());
        self.m.lines.heartbeat_mut().set_gone(false);
        self.m.replies.reset();
        self.greet();
        if self.m.inputs.signals().limits & levels::hard_limits(&self.m.settings) != 0 {
            self.enter(State::Alarm(self.state.alarm()));
            self.say(|out| reply_texts::message(out, "Check Limits"));
        }
        if let Some((alarm, _)) = self.m.inputs.emergency() {
            self.lock(alarm);
            let still = match alarm {
                Alarm::EmergencyStop => "Emergency stop is active",
                _ => "Driver fault is active",
            };
            if self.dialect() != Dialect::Grbl {
                self.say(|out| reply_texts::message(out, still));
            }
        }
        if let State::Alarm(_) = self.state {
            self.tell_lock();
        } else {
            if self.m.inputs.signals().door {
                self.open_door();
            }
            self.task = Task::Startup(0, None);
        }
    }

    /// Reports the alarm, and locks the machine until `$X`, `$H` or a reset.
    pub(crate) fn lock(&mut self, alarm: Alarm) {
        self.tell_alarm(alarm);
        self.enter(State::Alarm(Some(alarm)));
    }

    /// Ends a failed homing: reports the alarm, answers the command, and continues as after a reset.
    pub(crate) fn fail_homing(&mut self, alarm: Alarm) {
        self.m.motion.discard();
        self.m.reference.lose();
        self.lock(alarm);
        self.task = Task::None;
        self.say_ok();
        self.m.interpreter.reset();
        self.initialise();
    }

    /// Passes changed settings to the parts that keep values derived from them. Call only at rest.
    pub(crate) fn reconfigure(&mut self) {
        self.m.inputs.configure(&self.m.settings);
        self.m.interpreter.set_axes(self.m.settings.axes_in_use());
        let step_clock_hz = self.m.motion.settings().step_clock_hz;
        self.m.motion.configure(motion_settings(&self.m.settings, step_clock_hz));
    }
}

/// Minimum feed in Grbl's dialect, mm/min: Grbl raises slower feeds to it.
const GRBL_LEAST_FEED: f32 = 1.0;

/// Converts the settings to the units of motion. If motion cannot compute with a resolution, 1 step/mm takes its
/// place. Motion is locked until that setting is corrected (`Settings::unrunnable`).
fn motion_settings<const N: usize>(settings: &Settings<N>, step_clock_hz: u32) -> MotionSettings<N> {
    MotionSettings {
        arrangement: settings.arrangement(),
        steps_per_mm: settings.axes(AxisKey::Resolution).map(|v| StepsPerMm::new(v).unwrap_or(StepsPerMm::ONE)),
        max_rate: settings.axes(AxisKey::MaxRate).map(per_second),
        least_feed: if dialect(settings) == Dialect::Grbl { per_second(GRBL_LEAST_FEED) } else { 0.0 },
        acceleration: settings.axes(AxisKey::Acceleration),
        jerk: settings.axes(AxisKey::Jerk),
        backlash: settings.axes(AxisKey::Backlash),
        junction_deviation: settings.value(Key::JunctionDeviation),
        curve_share: settings.value(Key::CurveAcceleration) * 0.01,
        arc_tolerance: settings.value(Key::ArcTolerance),
        step_clock_hz,
    }
}
