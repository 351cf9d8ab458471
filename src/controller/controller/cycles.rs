//! Homing and probing are carried out: moves that an input ends.

use super::execute::{Answer, Task};
use super::inputs::Stopped;
use super::{Controller, StopReason};
use crate::axes::{Axis, AxisMask, PerAxis};
use crate::error::{Alarm, Error};
use crate::machine::homing::{Homing, HomingSettings, Order};
use crate::machine::state::Mode;
use crate::messages::{GangedMotors, ToStep};
use crate::motion::{Move, Speed};
use crate::protocol::report;
use crate::settings::{AxisKey, Key};
use crate::units::{Coordinate, Duration, Instant, per_second};

/// What a homing cycle is waiting for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum HomingWait {
    /// The end of a move, or one of these switches.
    Motion(AxisMask),
    /// The stop that a switch has asked for.
    Stop,
    /// A moment.
    Until(Instant),
}

/// How far a probe is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Probing {
    /// Moving, no contact yet.
    Seeking,
    /// Contact has been made; the step task brakes.
    Braking,
    /// Contact has been made, and the machine is at rest.
    Touched,
}

impl<const N: usize, const BLOCKS: usize> Controller<N, BLOCKS> {
    // Homing

    pub(super) fn begin_homing(&mut self, only: Option<Axis>) -> Result<(), Error> {
        if self.signals.door {
            return Err(Error::DoorOpen);
        }
        if let Some((_, error)) = self.emergency_now() {
            return Err(error);
        }
        if let Some(error) = self.motion_locked() {
            return Err(error);
        }
        if only.is_none() && self.settings.axes(AxisKey::HomingCycle).iter().all(|cycle| *cycle == 0.0) {
            return Err(Error::HomingDisabled);
        }
        let cycles = self.settings.axes(AxisKey::HomingCycle).0.map(|mask| AxisMask(mask as u8));
        let settings = HomingSettings {
            cycles,
            passes: self.settings.whole(Key::HomingPasses),
            squared: self.squared_axis(),
            to_negative: AxisMask(self.settings.whole(Key::HomingDirection) as u8),
            seek_rate: per_second(self.settings.value(Key::HomingSeek)),
            locate_rate: per_second(self.settings.value(Key::HomingLocate)),
            pull_off: self.settings.value(Key::HomingPullOff),
            debounce: Duration::millis(u64::from(self.settings.whole(Key::HomingDebounce))),
            travel: self.settings.axes(AxisKey::Travel),
        };
        let mut homing = Homing::new(settings, only);
        let order = homing.begin(self.switches());
        self.alarm = None;
        self.mode = Mode::Home;
        self.carry_out(homing, order);
        Ok(())
    }

    /// The axis that homing squares, and how far one of its motors may go alone: a share of the travel within bounds.
    fn squared_axis(&self) -> Option<(Axis, f32)> {
        let axis = self.settings.ganged_axis().filter(|_| self.settings.is_on(Key::GangedSwitch))?;
        let share = self.settings.value(Key::SquaringShare) / 100.0 * self.settings.axes(AxisKey::Travel).get(axis)?;
        let (least, most) = (self.settings.value(Key::SquaringLeast), self.settings.value(Key::SquaringMost));
        let at_least = if share > least { share } else { least };
        Some((axis, if at_least < most { at_least } else { most }))
    }

    fn switches(&self) -> AxisMask {
        AxisMask(self.signals.limits)
    }

    fn carry_out(&mut self, homing: Homing<N>, order: Order<N>) {
        match order {
            Order::Move { by, rate, watch, motors } => {
                self.ganged_motors = motors;
                let here = self.motion.machine_position();
                let target = here.zip(&by, |from, by| (from + Coordinate::from_mm_f32(by)).limited());
                self.motion.line(&seek(target, Speed::Feed(rate), 0));
                self.start_motion();
                self.task = Task::Homing(homing, HomingWait::Motion(watch));
            }
            Order::Wait(time) => self.task = Task::Homing(homing, HomingWait::Until(self.now + time)),
            Order::Done(axes, places) => {
                let mut place = self.motion.machine_position();
                for axis in Axis::of_machine::<N>().filter(|axis| axes.has(*axis)) {
                    if let Some(home) = places.get(axis) {
                        place.set(axis, home);
                    }
                }
                let cycles = self.settings.axes(AxisKey::HomingCycle);
                self.reference.homed(axes, cycles.iter().map(|cycle| *cycle as u8));
                self.ganged_motors = GangedMotors::Both;
                self.motion.set_machine_position(&place);
                self.interpreter.set_position(self.motion.machine_position());
                self.mode = Mode::Normal;
                self.start_idle_delay();
                self.task = Task::Startup(0, Some(Answer::Host));
            }
            Order::Failed(alarm) => self.fail_homing(alarm),
        }
    }

    /// Homing has ended in an alarm: announced, answered, and then as after a reset.
    pub(super) fn fail_homing(&mut self, alarm: Alarm) {
        self.motion.discard();
        self.reference.lose();
        self.raise(alarm);
        self.task = Task::None;
        self.say(report::ok);
        self.mode = Mode::Alarm;
        self.interpreter.reset();
        self.initialise();
    }

    #[inline(never)]
    pub(super) fn go_on_homing(&mut self, mut homing: Homing<N>, wait: HomingWait) -> bool {
        let over = match wait {
            HomingWait::Motion(_) => self.motion.is_idle(),
            HomingWait::Stop => self.stop.awaited.is_none(),
            HomingWait::Until(moment) => self.now >= moment,
        };
        if over {
            let order = homing.next(self.switches());
            self.carry_out(homing, order);
        } else {
            self.task = Task::Homing(homing, wait);
        }
        over
    }

    /// A switch has closed while homing waits for it.
    pub(super) fn home_switch(&mut self, stopped: &mut Stopped) {
        if let Task::Homing(_, wait) = &mut self.task
            && let HomingWait::Motion(watch) = *wait
            && watch.0 & self.signals.limits != 0
        {
            *wait = HomingWait::Stop;
            self.stop_for(StopReason::Switch, stopped);
        }
    }

    // Probing

    /// Begins a probe at rest. Whether there is one to wait for; if not, the line is to be answered.
    #[inline(never)]
    pub(super) fn begin_probe(
        &mut self,
        target: &PerAxis<Coordinate, N>,
        speed: Speed,
        away: bool,
        line_number: u32,
    ) -> bool {
        if self.signals.probe != away {
            // It would have to change to what it is.
            self.raise(Alarm::ProbeInitialState);
            self.mode = Mode::Alarm;
            self.interpreter.set_position(self.motion.machine_position());
            return false;
        }
        self.motion.line(&seek(*target, speed, line_number));
        self.probe_watch = Some(ToStep::Watch { probe: Some(!away), braking: self.motion.braking() });
        self.start_motion();
        true
    }

    /// The step task has seen the contact, at these steps.
    pub(super) fn probe_contact(&mut self, counter: &PerAxis<i32, N>) {
        if self.probing == Some(Probing::Seeking) {
            self.probing = Some(Probing::Braking);
            self.probed = self.motion.position_of_counter(counter);
        }
    }

    /// Once the step task has braked it is asked where it is, and opened again.
    pub(super) fn settle_probe(&mut self) {
        if self.probing == Some(Probing::Braking) && self.observed.step_idle && self.stop.awaited.is_none() {
            self.order_stop(StopReason::Contact);
        }
    }

    /// Whether the probe is over; then it has been reported.
    #[inline(never)]
    pub(super) fn end_probe(&mut self, must_touch: bool) -> bool {
        let touched = match self.probing {
            Some(Probing::Touched) => true,
            Some(Probing::Seeking) if self.motion.is_idle() => false,
            _ => return false,
        };
        self.probing = None;
        self.probe_watch = Some(WATCH_ENDS);
        self.motion.discard();
        self.running = false;
        let here = self.motion.machine_position();
        self.interpreter.set_position(here);
        self.probe_succeeded = touched;
        if !touched && must_touch {
            self.raise(Alarm::ProbeNoContact);
            self.mode = Mode::Alarm;
        } else if !touched {
            self.probed = here;
        }
        let (place, inches) = (self.probed, self.settings.is_on(Key::ReportInches));
        self.say(|out| report::probe(out, &place, touched, inches));
        true
    }
}

/// The probe is of no interest any more.
pub(super) const WATCH_ENDS: ToStep = ToStep::Watch { probe: None, braking: 0.0 };

/// A move that the operator's overrides leave alone.
fn seek<const N: usize>(target: PerAxis<Coordinate, N>, speed: Speed, line_number: u32) -> Move<N> {
    Move { target, speed, power: 0, scale_power: false, line_number, no_feed_override: true, digit: 0.0 }
}
