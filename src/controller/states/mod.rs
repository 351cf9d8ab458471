//! The states of the machine and the table of which may follow which. A state keeps what it alone needs ([`Homing`],
//! [`Door`], [`Hold`], the alarm of a lock); whatever outlives a state belongs to [`Machine`](crate::parts::Machine).
//! [`Controller::enter`] is the only place that enters a state; what a state keeps changes within it.
//!
//! ```text
//!            $X, $H ok                 !, M0                      ~
//!  Alarm ───────────────▶ Normal ───────────────▶ Hold ───────────────▶ Normal
//!    ▲                    │ ▲ │ ▲                  │  door, 0x84
//!    │ reset in motion,   │ │ │ └── $C, reset ── Check
//!    │ limit, underrun    │ │ └───── $J= ──────▶ Jog ── at rest, 0x85, ! ──▶ Normal
//!    └────────────────────┘ └─ restored ── Door ◀── 0x84, door pin
//!   Braking (0x19, a refused line with $901, a fault): brakes, then Normal, Alarm or Critical
//!                  Sleep ◀── $SLP (only a reset leaves it, to Alarm)
//! ```
//! `Idle` and `Run` are both [`State::Normal`]: whether something moves is asked of `motion`, so the two cannot disagree.

pub(crate) mod door;
mod hold;
pub(crate) mod homing;
mod locked;
pub(crate) mod stops;

use crate::dispatch::Controller;
use crate::error::Alarm;
pub(crate) use door::Door;
pub(crate) use hold::Hold;
pub(crate) use homing::Homing;

/// What the machine is doing.
#[allow(clippy::large_enum_variant, reason = "there is one, in a static place; boxes do not exist here")]
#[derive(Clone, Debug)]
// The tag is asked for before each output: a byte of its own, not folded into the data of a mode.
#[repr(u8)]
pub(crate) enum State<const N: usize> {
    /// Program lines are executed.
    Normal,
    /// A jog is moving. `cancelling`: it is braking and will be forgotten.
    Jog {
        /// Braking because of 0x85 or `!`.
        cancelling: bool,
    },
    /// Feed hold: braking or at rest; only `~` resumes.
    Hold(Hold),
    /// The homing cycle runs.
    Homing(Homing<N>),
    /// Braking; then everything queued is forgotten.
    Braking {
        /// What follows at rest.
        then: AfterBraking,
    },
    /// Safety door.
    Door(Door),
    /// Locked until `$X`, `$H` or a reset; by an alarm, or because the machine has not been homed or looked at.
    Alarm(Option<Alarm>),
    /// Locked by a hard or soft limit or an emergency: only a reset helps.
    Critical(Alarm),
    /// Lines are checked and not executed.
    Check,
    /// Everything is off until a reset; with the alarm that it was locked by.
    Sleep(Option<Alarm>),
}

/// What a state makes of what it has been asked to do.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Next {
    /// What it waits for is not over.
    Wait,
    /// It goes on.
    Stay,
    /// All axes that were to be homed are: Idle, and the startup lines run.
    Homed,
    /// Locked, as after a reset.
    HomingFailed(Alarm),
}

/// What follows a controlled stop, at rest.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum AfterBraking {
    /// The next line.
    Continue,
    /// The machine locks itself, because a line was refused.
    Lock,
    /// An alarm.
    Alarm(Alarm),
    /// The tool is parked, then an alarm.
    Retract(Alarm),
}

impl AfterBraking {
    /// The alarm that comes.
    pub fn alarm(self) -> Option<Alarm> {
        match self {
            AfterBraking::Alarm(alarm) | AfterBraking::Retract(alarm) => Some(alarm),
            AfterBraking::Continue | AfterBraking::Lock => None,
        }
    }
}

impl<const N: usize> State<N> {
    /// Whether one may follow the other: the table of the states. `tests/safety/states.rs` says at which event.
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

    /// Whether what is under way waits: motion, a dwell, the lines behind it.
    pub fn is_suspended(&self) -> bool {
        matches!(self, State::Hold(_) | State::Braking { .. } | State::Door(_) | State::Sleep(_) | State::Critical(_))
    }

    /// Whether a door has been closed, and the machine is on its way back to the job.
    pub fn is_resuming(&self) -> bool {
        matches!(self, State::Door(door) if door.phase.is_resuming())
    }

    /// Whether a received line may be read.
    #[inline]
    pub fn takes_lines(&self) -> bool {
        matches!(self, State::Normal | State::Jog { .. } | State::Alarm(_) | State::Check)
    }

    /// Whether nothing but a reset helps, with which all lines received before it are void.
    pub fn waits_for_reset(&self) -> bool {
        matches!(self, State::Sleep(_) | State::Critical(_))
    }

    /// Whether the machine is locked.
    pub fn is_alarm(&self) -> bool {
        matches!(self, State::Alarm(_) | State::Critical(_))
    }

    /// The alarm that holds, if any.
    pub fn alarm(&self) -> Option<Alarm> {
        match self {
            State::Alarm(alarm) | State::Sleep(alarm) => *alarm,
            State::Critical(alarm) => Some(*alarm),
            _ => None,
        }
    }

    /// The state as `?` names it. `at_rest`: nothing moves; `running`: a program's motion is under way; `door_open`: the
    /// door input is active.
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
    /// The only place in which another state is entered.
    pub(crate) fn enter(&mut self, next: State<N>) {
        debug_assert!(self.state.may_become(&next), "{:?} to {:?}", self.state, next);
        self.state = next;
    }
}
