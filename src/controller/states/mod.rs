//! The states of the machine, and the table of the allowed transitions between them. A state holds the data that only
//! it needs ([`Homing`], [`Door`], [`Hold`], the alarm of a lock); data that outlives a state belongs to
//! [`Machine`](crate::parts::Machine). Only [`Controller::enter`] enters a state. While a state lasts, its data may
//! change.
//!
//! ```text
//!            $X, $H ok                 !, M0                      ~
//!  Alarm ───────────────▶ Normal ───────────────▶ Hold ───────────────▶ Normal
//!    ▲                    │ ▲ │ ▲                  │  door, 0x84
//!    │ reset in motion,   │ │ │ └── $C, reset ── Check
//!    │ underrun, probe    │ │ └───── $J= ──────▶ Jog ── at rest, 0x85, ! ──▶ Normal
//!    └────────────────────┘ └─ restored ── Door ◀── 0x84, door pin
//!   Braking (0x19, a refused line with $901, a fault): brakes, then Normal, Alarm, Critical or Door
//!                  Sleep ◀── $SLP (only a reset leaves it, to Alarm)
//!               Critical ◀── limit, emergency stop, other faults (only a reset leaves it, to Alarm)
//! ```
//! `Idle` and `Run` are both [`State::Normal`]. Only `motion` records whether something moves, so state and motion
//! cannot disagree.

mod after_reset;
pub(crate) mod door;
mod hold;
pub(crate) mod homing;
pub(crate) mod stops;

use crate::dispatch::Controller;
use crate::error::Alarm;
use crate::work::task::Task;
pub(crate) use door::Door;
pub(crate) use hold::Hold;
pub(crate) use homing::Homing;

/// What the machine is doing.
#[allow(clippy::large_enum_variant, reason = "there is one, in a static place; boxes do not exist here")]
#[derive(Clone, Debug)]
// `repr(u8)` makes the tag (the number of the variant) a byte of its own. The tag is read before each output, so it
// must not be hidden in the data of a variant.
#[repr(u8)]
pub(crate) enum State<const N: usize> {
    /// Program lines are executed.
    Normal,
    /// A jog is moving.
    Jog {
        /// Braking because of 0x85 or `!`. The rest of the jog is dropped once the machine is at rest.
        cancelling: bool,
    },
    /// Feed hold: braking or at rest; only `~` resumes.
    Hold(Hold),
    /// The homing cycle runs.
    Homing(Homing<N>),
    /// Braking. Once the machine is at rest, everything queued is dropped.
    Braking {
        /// What the machine does once it is at rest.
        then: AfterBraking,
    },
    /// The safety door is open, or something acts like an open door: see [`Door`].
    Door(Door),
    /// Locked until `$X`, `$H` or a reset: by an alarm, or (`None`) because the machine has not been homed or checked.
    Alarm(Option<Alarm>),
    /// Locked by an alarm that only a reset ends: a hard or soft limit, an emergency stop, a driver fault, a lost
    /// spindle speed, or a lost host for which the machine has stopped at once.
    Critical(Alarm),
    /// Lines are checked and not executed.
    Check,
    /// Everything is off until a reset. Holds the alarm that locked the machine before, if any.
    Sleep(Option<Alarm>),
}

/// Result of [`Homing::begin`] or [`Homing::advance`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Next {
    /// The event that homing waits for has not happened yet.
    Wait,
    /// Homing continues.
    Stay,
    /// All requested axes are homed. The machine becomes idle, and the startup lines run.
    Homed,
    /// Homing failed. The machine is locked as after a reset.
    HomingFailed(Alarm),
}

/// What happens after a controlled stop, once the machine is at rest.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum AfterBraking {
    /// The job is dropped, and the next line is read.
    Continue,
    /// The machine locks itself, because a line was refused.
    Lock,
    /// This alarm is raised.
    Alarm(Alarm),
    /// The tool is parked, then this alarm is raised.
    Retract(Alarm),
}

impl AfterBraking {
    /// Returns the alarm that follows, if any.
    pub fn alarm(self) -> Option<Alarm> {
        match self {
            AfterBraking::Alarm(alarm) | AfterBraking::Retract(alarm) => Some(alarm),
            AfterBraking::Continue | AfterBraking::Lock => None,
        }
    }
}

impl<const N: usize> State<N> {
    /// Returns whether `next` may follow this state. `tests/safety/states.rs` lists the events.
    pub(crate) fn may_become(&self, next: &Self) -> bool {
        use State::{Alarm, Braking, Check, Critical, Door, Hold, Homing, Jog, Normal, Sleep};
        match (self, next) {
            // A stop, a fault and a reset end every state.
            (_, Alarm(_)) => true,
            (Critical(_) | Sleep(_), Normal) => false,
            (_, Critical(_) | Normal) => true,
            (Normal, Jog { .. } | Hold(_) | Homing(_) | Braking { .. } | Door(_) | Check) => true,
            (Jog { .. }, Jog { .. } | Braking { .. } | Door(_)) => true,
            (Hold(_), Hold(_) | Braking { .. } | Door(_)) => true,
            (Braking { .. }, Braking { .. } | Door(_)) => true,
            (Door(_), Door(_) | Braking { .. } | Sleep(_)) => true,
            (Alarm(_), Homing(_) | Sleep(_)) => true,
            _ => false,
        }
    }

    /// Returns whether the current work (motion, a dwell, the lines still to come) is suspended.
    pub fn is_suspended(&self) -> bool {
        matches!(self, State::Hold(_) | State::Braking { .. } | State::Door(_) | State::Sleep(_) | State::Critical(_))
    }

    /// Returns whether `~` was received at a closed door, and the machine is on its way back to the job.
    pub fn is_resuming(&self) -> bool {
        matches!(self, State::Door(door) if door.phase.is_resuming())
    }

    /// Returns whether received lines are read in this state.
    pub fn takes_lines(&self) -> bool {
        matches!(self, State::Normal | State::Jog { .. } | State::Alarm(_) | State::Check)
    }

    /// Returns whether only a reset ends this state. Lines received before that reset will be dropped.
    pub fn waits_for_reset(&self) -> bool {
        matches!(self, State::Sleep(_) | State::Critical(_))
    }

    /// Returns whether the machine is locked.
    pub fn is_alarm(&self) -> bool {
        matches!(self, State::Alarm(_) | State::Critical(_))
    }

    /// Returns the active alarm, if any.
    pub fn alarm(&self) -> Option<Alarm> {
        match self {
            State::Alarm(alarm) | State::Sleep(alarm) => *alarm,
            State::Critical(alarm) => Some(*alarm),
            _ => None,
        }
    }

    /// Returns the state's name in the report for `?`. `at_rest`: nothing moves; `running`: a program's motion is in
    /// progress; `door_open`: the door input is active.
    pub fn name(&self, at_rest: bool, running: bool, door_open: bool) -> &'static str {
        match self {
            State::Normal if running => "Run",
            State::Normal => "Idle",
            State::Jog { .. } => "Jog",
            State::Hold(_) if at_rest => "Hold:0",
            State::Hold(_) => "Hold:1",
            State::Homing(_) => "Home",
            State::Braking { .. } => "Hold:1",
            State::Door(door) => door.phase.name(door_open),
            State::Alarm(_) | State::Critical(_) => "Alarm",
            State::Check => "Check",
            State::Sleep(_) => "Sleep",
        }
    }
}

impl<const N: usize> Controller<N> {
    /// Enters a state. No other function changes the state.
    pub(crate) fn enter(&mut self, next: State<N>) {
        debug_assert!(self.state.may_become(&next), "{:?} to {:?}", self.state, next);
        if self.state.is_suspended() {
            // Lines had to wait in the suspended state. So the time in that state does not count as silence of the
            // host.
            self.m.last_line_at = self.m.now;
        }
        // A change of state (a hold, a door, an alarm) cancels a pending restart (`$REBOOT`, `$DFU`): the host must
        // send the command again.
        if matches!(self.task, Task::Rebooting { .. }) {
            self.task = Task::None;
        }
        self.state = next;
    }
}
