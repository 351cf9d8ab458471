//! The homing state: carries out the orders (move, wait) of [`cycle`]. When a switch closes, the step task is stopped.
//! At the end the position is set, and the startup lines run.

mod cycle;

use crate::axes::{Axis, AxisMask};
use crate::dispatch::Controller;
use crate::error::Error;
use crate::messages::GangedMotors;
use crate::motion::Speed;
use crate::parts::Machine;
use crate::settings::{AxisKey, Key};
use crate::states::{Next, State};
use crate::units::{Coordinate, Duration, Instant, per_second};
use crate::work::probe::seek;
use crate::work::task::{Answer, Task};
use cycle::{HomingCycle, HomingSettings, Order};

/// What homing is waiting for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Wait {
    /// The end of a move, or the closing of one of these switches.
    Motion(AxisMask),
    /// A stop of the step task, because a switch has closed. Also used if homing has nothing to wait for, so that the
    /// next order can follow at once.
    Stop,
    /// This point in time.
    Until(Instant),
}

/// The data of the homing state: the cycle, and the event that it waits for.
#[derive(Clone, Debug)]
pub(crate) struct Homing<const N: usize> {
    cycle: HomingCycle<N>,
    wait: Wait,
}

impl<const N: usize> Homing<N> {
    /// Starts homing of the axes of all cycles, or only of the axis `only`. Carries out the first order of the cycle,
    /// and returns the homing state together with what follows from that order.
    pub(crate) fn begin(only: Option<Axis>, m: &mut Machine<N>) -> Result<(Self, Next), Error> {
        let cycles = m.settings.homing_cycles().0.map(AxisMask);
        if only.is_none() && cycles.iter().all(|cycle| cycle.is_empty()) {
            return Err(Error::HomingDisabled);
        }
        if m.settings.is_on(Key::Laser) {
            // A laser with constant power (M3) would burn one point wherever homing waits, and where it ends.
            m.stop_spindle();
        }
        let settings = HomingSettings {
            cycles,
            passes: m.settings.whole(Key::HomingPasses),
            squared: squared_axis(m),
            to_negative: AxisMask(m.settings.whole(Key::HomingDirection) as u8),
            seek_rate: per_second(m.settings.value(Key::HomingSeek)),
            locate_rate: per_second(m.settings.value(Key::HomingLocate)),
            pull_off: m.settings.value(Key::HomingPullOff),
            debounce: Duration::millis(u64::from(m.settings.whole(Key::HomingDebounce))),
            travel: m.settings.axes(AxisKey::Travel),
            zero_at_pull_off: m.settings.is_on(Key::ZeroAtPullOff),
        };
        let mut homing = Self { cycle: HomingCycle::new(settings, only), wait: Wait::Stop };
        let order = homing.cycle.begin(m.switches());
        let next = homing.carry_out(order, m);
        Ok((homing, next))
    }

    /// Returns the time at which [`Homing::advance`] has to be called again; `None` if homing does not wait for a time.
    pub(crate) fn wakeup(&self) -> Option<Instant> {
        match self.wait {
            Wait::Until(moment) => Some(moment),
            _ => None,
        }
    }

    /// Carries out the next order of the cycle if the event that homing waits for has happened. Call it only while no
    /// stop of the step task is pending.
    pub(crate) fn advance(&mut self, m: &mut Machine<N>) -> Next {
        let over = match self.wait {
            Wait::Motion(_) => m.motion.is_idle(),
            Wait::Stop => true,
            Wait::Until(moment) => m.now >= moment,
        };
        if !over {
            return Next::Wait;
        }
        let order = self.cycle.next(m.switches());
        self.carry_out(order, m)
    }

    /// Returns whether one of the closed `switches` ends the current move. If so, homing waits for the stop of the step
    /// task.
    pub(crate) fn is_reached(&mut self, switches: AxisMask) -> bool {
        let reached = matches!(self.wait, Wait::Motion(watch) if watch.0 & switches.0 != 0);
        if reached {
            self.wait = Wait::Stop;
        }
        reached
    }

    fn carry_out(&mut self, order: Order<N>, m: &mut Machine<N>) -> Next {
        self.wait = match order {
            Order::Move { by, rate, watch, motors } => {
                m.pins.drive(motors);
                let here = m.motion.machine_position();
                let target = here.zip(&by, |from, by| (from + Coordinate::from_mm_f32(by)).limited());
                m.motion.line(&seek(target, Speed::Feed(rate), 0));
                m.start_motion();
                Wait::Motion(watch)
            }
            Order::Wait(time) => Wait::Until(m.now + time),
            Order::Reached(axes, home) => {
                let mut position = m.motion.machine_position();
                for axis in Axis::of_machine::<N>().filter(|axis| axes.has(*axis)) {
                    if let Some(home) = home.get(axis) {
                        position.set(axis, home);
                    }
                }
                m.motion.set_machine_position(&position);
                Wait::Stop
            }
            Order::Done(axes) => {
                m.reference.mark_homed(axes, m.settings.homing_cycles().iter().copied());
                m.pins.drive(GangedMotors::Both);
                m.interpreter.set_position(m.motion.machine_position());
                m.interpreter.end_cycles();
                return Next::Homed;
            }
            Order::Failed(alarm) => return Next::HomingFailed(alarm),
        };
        Next::Stay
    }
}

/// Returns the axis that homing squares, and the maximum distance (mm) that one of its motors may move alone. The
/// distance is a share of the travel (`$347`), within limits (`$348`, `$349`).
fn squared_axis<const N: usize>(m: &Machine<N>) -> Option<(Axis, f32)> {
    let axis = m.settings.ganged_axis().filter(|_| m.settings.is_on(Key::GangedSwitch))?;
    let share = m.settings.value(Key::SquaringShare) / 100.0 * m.settings.axes(AxisKey::Travel).get(axis)?;
    let (least, most) = (m.settings.value(Key::SquaringLeast), m.settings.value(Key::SquaringMost));
    let at_least = if share > least { share } else { least };
    Some((axis, if at_least < most { at_least } else { most }))
}

impl<const N: usize> Controller<N> {
    /// Acts on the result of [`Homing::begin`] or [`Homing::advance`]. Returns false if homing is still waiting.
    pub(crate) fn follow(&mut self, next: Next) -> bool {
        match next {
            Next::Wait => return false,
            Next::Stay => {}
            Next::Homed => {
                self.enter(State::Normal);
                self.m.start_idle_delay();
                self.task = Task::Startup(0, Some(Answer::Host));
            }
            Next::HomingFailed(alarm) => self.fail_homing(alarm),
        }
        true
    }
}
