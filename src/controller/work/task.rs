//! The current task of the controller: a line of G-code, a listing, startup lines, or storing a record. While there is
//! a task, no further line is taken. A task also records who gets its answer. "Held" lines are the stored lines of a
//! subroutine, loop or macro.

use crate::protocol::system::Described;
use crate::units::{Duration, Instant};

/// The current task of the controller. While there is one, no further line is taken.
#[derive(Clone, Copy, Debug)]
// A tag of one byte, for the same reason as in `State`: it is read before each output.
#[repr(u8)]
pub(crate) enum Task {
    /// No task. The next line can be taken.
    None,
    /// The startup line with this index is next. After the last startup line, the answer is sent, unless it is `None`.
    Startup(usize, Option<Answer>),
    /// The controller runs the next stored line of a subroutine, loop or macro, for this caller.
    Held(Caller),
    /// An answer of many lines, and the index of its next line.
    Listing(Listing, usize),
    /// A record is being stored. The answer follows when it is stored.
    Storing(Answer),
    /// Motion is braking. The alarm for a soft limit follows at rest.
    SoftLimit(Answer),
    /// A received jog waits until the cancelled jog before it has stopped. `LineIntake` keeps the text of the waiting
    /// jog.
    JogWaits,
    /// The board restarts at this time: late enough that the answer has reached the host. A reset, a hold, the door and
    /// every alarm cancel it.
    Rebooting {
        /// Into the boot loader of the chip.
        into_loader: bool,
        at: Instant,
    },
    /// A line of G-code is being executed. Its data is in `LineInWork`.
    Job(Job),
}

/// Receiver of the answer (`ok`) to a line.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Answer {
    /// The host.
    Host,
    /// The startup line with index `.0`: its echo is sent with an `ok`, and the next startup line begins. `.1`: whether
    /// the host waits for an answer until the last startup line has been run.
    Startup(usize, bool),
    /// The host, which has set the startup line with this index (`$N`). Its text is kept, and stored once the line has
    /// run without error.
    Validation(usize),
    /// Nobody yet, because the line is a stored line of a subroutine, loop or macro. The caller is answered once the
    /// last stored line has been run.
    Held(Caller),
    /// The host, which has changed the setting with this number.
    Setting(u16),
    /// The host. After the answer, the controller is initialised (`$RST`).
    Restart,
}

impl Answer {
    /// Returns whether the line belongs to the host's program. Either the host has sent the line, or the host has
    /// called the subroutine, loop or macro that contains it.
    pub(crate) fn is_of_program(self) -> bool {
        matches!(self, Answer::Host | Answer::Held(Caller::Host))
    }
}

/// Whose line has called a subroutine, loop or macro. The fields are those of [`Answer`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Caller {
    /// A line that the host has sent.
    Host,
    /// A startup line.
    Startup(usize, bool),
    /// A startup line that is stored if it runs without error.
    Validation(usize),
}

impl Caller {
    /// Returns who gets the answer once the last line of the subroutine, loop or macro has been run.
    pub(crate) fn answer(self) -> Answer {
        match self {
            Caller::Host => Answer::Host,
            Caller::Startup(index, host_waits) => Answer::Startup(index, host_waits),
            Caller::Validation(index) => Answer::Validation(index),
        }
    }
}

/// A line in execution.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Job {
    pub(crate) answer: Answer,
    pub(crate) stage: Stage,
    pub(crate) jog: bool,
    /// Level of M66's input at the last check.
    pub(crate) input_before: bool,
    /// Feed of the chords that are still to come, mm/s.
    pub(crate) chord_feed: f32,
    /// Time until which the stage waits.
    pub(crate) until: Instant,
    /// Time that was left of a dwell or of the wait of M66 when a hold suspended it.
    left: Duration,
    /// How long the spindle takes to spin up or down after this line has switched it.
    pub(crate) spindle_delay: Duration,
}

impl Job {
    /// Returns a line of which nothing has been done yet.
    pub(crate) fn new(answer: Answer, stage: Stage, jog: bool) -> Self {
        Self {
            answer,
            stage,
            jog,
            input_before: false,
            chord_feed: 0.0,
            until: Instant::from_ticks(0),
            left: Duration::from_ticks(0),
            spindle_delay: Duration::from_ticks(0),
        }
    }

    /// Returns how much longer the stage waits. For a suspended stage, returns the time that was left when it was
    /// suspended.
    pub(crate) fn left(&self, now: Instant) -> Duration {
        match self.stage {
            Stage::DwellSuspended | Stage::InputSuspended => self.left,
            _ => self.until.checked_duration_since(now).unwrap_or(Duration::from_ticks(0)),
        }
    }

    /// Sets `until` and returns the stage that waits for it.
    pub(crate) fn wait(&mut self, stage: Stage, until: Instant) -> Stage {
        self.until = until;
        stage
    }
}

/// Progress of a line. A stage has no data of its own, so that it stays a single byte that is cheap to pass on; its
/// data is in the [`Job`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Stage {
    /// Motion queued before the line has to end first (in Grbl: buffer synchronize; in LinuxCNC: queue buster).
    Drain,
    /// The operator puts another tool into the spindle. Ends with `~`.
    ToolChange,
    /// The spindle spins down, until [`Job::until`], for a tool change that measures the tool.
    SpinningDown,
    /// A tool change that measures the tool. `LineInWork` holds its progress.
    Measuring,
    /// Sets modal state, spindle and coolant.
    Apply,
    /// A changed coordinate system is being stored.
    Storing,
    /// G4, until [`Job::until`].
    Dwell,
    /// The spindle spins up until [`Job::until`], and longer if its input does not report by then that it is up to
    /// speed.
    SpinningUp,
    /// G4, suspended by a hold.
    DwellSuspended,
    /// M66, until [`Job::until`] at most.
    Input,
    /// M66, suspended by a hold.
    InputSuspended,
    /// Queues the intermediate point of G28 or G30.
    Via,
    /// Starts the motion itself.
    Target,
    /// The probe moves.
    Probing,
    /// Queues the remaining chords of the line's curve.
    Chords,
    /// Queues the way back to the centre of G12 and G13.
    Back,
    /// Motion has to end before the program pauses or ends.
    Flow,
    /// The program is paused. Ends with `~`.
    Paused,
    /// The program is paused within a canned cycle. Ends with `~`.
    CyclePaused,
    /// The line has been executed; its answer follows.
    Done,
}

impl Task {
    pub(crate) fn is_none(&self) -> bool {
        matches!(self, Task::None)
    }

    /// Returns whether the task is part of a program, not just an answer that takes time.
    pub(crate) fn is_program(&self) -> bool {
        !matches!(self, Task::None | Task::Listing(..) | Task::Storing(_) | Task::Rebooting { .. })
    }

    /// Returns whether a reset has to send the host an `ok` for the task.
    pub(crate) fn answers_host(&self) -> bool {
        match self {
            Task::Job(Job { answer, .. }) | Task::Storing(answer) | Task::SoftLimit(answer) => {
                !matches!(answer, Answer::Startup(_, false) | Answer::Held(Caller::Startup(_, false)))
            }
            Task::Held(caller) => !matches!(caller, Caller::Startup(_, false)),
            Task::Listing(..) | Task::JogWaits => true,
            Task::Startup(_, answer) => answer.is_some(),
            Task::None | Task::Rebooting { .. } => false,
        }
    }

    /// Returns the time at which the task can continue, if it waits for a time. `late`: returns when to check the
    /// spindle next, given the end of its spin-up time.
    pub(crate) fn wakeup(&self, late: impl Fn(Instant) -> Instant) -> Option<Instant> {
        match self {
            Task::Job(Job { stage: Stage::SpinningUp, until, .. }) => Some(late(*until)),
            Task::Job(Job { stage: Stage::Dwell | Stage::SpinningDown | Stage::Input, until, .. }) => Some(*until),
            Task::Rebooting { at, .. } => Some(*at),
            _ => None,
        }
    }

    /// Returns whether a line waits for the spindle to come up to speed.
    pub(crate) fn is_spinning_up(&self) -> bool {
        matches!(self, Task::Job(Job { stage: Stage::SpinningUp, .. }))
    }

    /// Returns whether a line has switched the spindle, and waits until it is up to speed or at rest.
    pub(crate) fn waits_for_spindle(&self) -> bool {
        match self {
            Task::Job(Job { stage: Stage::SpinningUp, .. }) => true,
            Task::Job(Job { stage: Stage::Storing | Stage::Dwell | Stage::DwellSuspended, spindle_delay, .. }) => {
                !spindle_delay.is_zero()
            }
            _ => false,
        }
    }

    /// Stops the clock of a dwell or of M66 because of a hold.
    pub(crate) fn suspend(&mut self, now: Instant) {
        let Task::Job(job) = self else { return };
        let left = job.left(now);
        job.stage = match job.stage {
            Stage::Dwell => Stage::DwellSuspended,
            Stage::Input => Stage::InputSuspended,
            _ => return,
        };
        job.left = left;
    }

    pub(crate) fn resume(&mut self, now: Instant) {
        let Task::Job(job) = self else { return };
        job.stage = match job.stage {
            Stage::DwellSuspended => Stage::Dwell,
            Stage::InputSuspended => Stage::Input,
            _ => return,
        };
        job.until = now + job.left;
    }

    /// Drops the task. Returns whether the host still waits for an answer to the line that began it. A restart after
    /// restoring the defaults is not dropped, because without it the defaults would not take effect.
    pub(crate) fn abandon(&mut self) -> bool {
        if let Task::Storing(Answer::Restart) = self {
            return false;
        }
        let answers = self.answers_host();
        *self = Task::None;
        answers
    }

    /// Ends a jog that waits for room in the look-ahead. It is still answered.
    pub(crate) fn forget_jog(&mut self) {
        if let Task::Job(job) = self
            && job.jog
        {
            job.stage = Stage::Done;
        }
    }
}

/// An answer of many lines.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Listing {
    /// `$$`
    Settings,
    /// `$#`
    Parameters,
    /// `$N`
    StartupLines,
    /// `$M`
    Macros,
    /// `$PINS`
    Pins,
    /// `$I` with `$900=3`, which needs the view of the pins
    Identity,
    /// `$ES` and the like
    Descriptions(Described),
    /// `$REC`
    Recording(Ask),
}

/// Progress of the request for the next item of the `$REC` listing.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Ask {
    /// The controller requests the next item when there is room for its text.
    Wanted,
    /// There is room for the text, and the controller requests the item now.
    Due,
    /// The item has been requested from the recorder and has not arrived yet.
    Asked,
}
