//! Homing is carried out: each `Order` of `machine/homing.rs` becomes a motion of one motor, or of both motors of a
//! squared axis; a switch that closes stops it; at the end the position is set and the startup lines run.
//!
//! Names: Homing is carried out: `HomingSettings` are made from `$22` to `$27`, each `Order` of `machine/homing.rs`
//! (move, wait, reached, done, failed) becomes a motion of one or both motors of a squared axis, a switch that closes stops it,
//! and at the end the position is set and the startup lines run. In it are `begin_homing`, `advance_homing`,
//! `carry_out`, `homing_waits`, `home_switch`, `squared_axis`. Keys are `HomingSeek`, `HomingLocate`, `HomingDebounce`,
//! `HomingPullOff`, `HomingPasses`, `HomingDirection`, `GangedSwitch`, `SquaringShare`, `SquaringLeast` and
//! `SquaringMost`; `HomingDisabled` and `DoorOpen` refuse, `StopReason::Switch` stops.

use super::Controller;
use super::probing::seek;
use super::stops::Stopped;
use super::task::{Answer, Task};
use crate::axes::{Axis, AxisMask};
use crate::error::Error;
use crate::machine::homing::{Homing, HomingRun, HomingSettings, HomingWait, Order};
use crate::machine::state::Mode;
use crate::machine::stops::StopReason;
use crate::messages::GangedMotors;
use crate::motion::Speed;
use crate::settings::{AxisKey, Key};
use crate::units::{Coordinate, Duration, per_second};

impl<const N: usize> Controller<N> {
    pub(super) fn begin_homing(&mut self, only: Option<Axis>) -> Result<(), Error> {
        if self.inputs.signals().door {
            return Err(Error::DoorOpen);
        }
        if let Some((_, error)) = self.inputs.emergency() {
            return Err(error);
        }
        if let Some(error) = self.motion_locked() {
            return Err(error);
        }
        let cycles = self.settings.homing_cycles().0.map(AxisMask);
        if only.is_none() && cycles.iter().all(|cycle| cycle.is_empty()) {
            return Err(Error::HomingDisabled);
        }
        if self.settings.is_on(Key::Laser) {
            // A beam of constant power (M3) would burn wherever homing waits, and at its end.
            self.stop_spindle();
        }
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
        self.mode = Mode::Home(HomingRun::new(homing));
        self.carry_out(order);
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
        AxisMask(self.inputs.signals().limits)
    }

    fn carry_out(&mut self, order: Order<N>) {
        match order {
            Order::Move { by, rate, watch, motors } => {
                self.pins.drive(motors);
                let here = self.motion.machine_position();
                let target = here.zip(&by, |from, by| (from + Coordinate::from_mm_f32(by)).limited());
                self.motion.line(&seek(target, Speed::Feed(rate), 0));
                self.start_motion();
                self.homing_waits(HomingWait::Motion(watch));
            }
            Order::Wait(time) => self.homing_waits(HomingWait::Until(self.now + time)),
            Order::Reached(axes, home) => {
                let mut position = self.motion.machine_position();
                for axis in Axis::of_machine::<N>().filter(|axis| axes.has(*axis)) {
                    if let Some(home) = home.get(axis) {
                        position.set(axis, home);
                    }
                }
                self.motion.set_machine_position(&position);
                self.homing_waits(HomingWait::Stop);
            }
            Order::Done(axes) => {
                self.reference.homed(axes, self.settings.homing_cycles().iter().copied());
                self.pins.drive(GangedMotors::Both);
                self.interpreter.set_position(self.motion.machine_position());
                self.interpreter.end_cycles();
                self.mode = Mode::Normal;
                self.start_idle_delay();
                self.task = Task::Startup(0, Some(Answer::Host));
            }
            Order::Failed(alarm) => self.fail_homing(alarm),
        }
    }

    fn homing_waits(&mut self, wait: HomingWait) {
        if let Mode::Home(homing) = &mut self.mode {
            homing.wait_for(wait);
        }
    }

    /// The next order, if what homing waits for is over. Whether it is.
    #[inline(never)]
    pub(super) fn advance_homing(&mut self) -> bool {
        let switches = self.switches();
        let Mode::Home(homing) = &mut self.mode else { return false };
        let order = homing.next(self.motion.is_idle(), self.now, switches);
        let over = order.is_some();
        if let Some(order) = order {
            self.carry_out(order);
        }
        over
    }

    /// Limit switches have changed: one that homing waits for ends its move.
    pub(super) fn home_switch(&mut self, stopped: &mut Stopped) {
        let switches = self.switches();
        if let Mode::Home(homing) = &mut self.mode
            && homing.is_reached(switches)
        {
            self.stop_for(StopReason::Switch, stopped);
        }
    }
}
