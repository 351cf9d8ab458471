//! What the controller is in the middle of: a line of G-code, a listing, startup lines, a store. While there is a task,
//! no further line is taken. A task also knows who gets the answer.

use crate::protocol::system::Described;
use crate::units::{Duration, Instant};

/// What the controller is in the middle of. While there is one, no further line is taken.
#[derive(Clone, Copy, Debug)]
// As with `State`: the tag is asked for before each output.
#[repr(u8)]
pub(crate) enum Task {
    /// Nothing: the next line may come.
    None,
    /// The startup line of this number is next; when all have been run, someone may get an answer.
    Startup(usize, Option<Answer>),
    /// The next line of held text is to be run, for whom.
    Held(Caller),
    /// An answer of many lines; the number is the next of them.
    Listing(Listing, usize),
    /// A record is being stored; then the answer is given.
    Storing(Answer),
    /// Motion has to end before the soft-limit alarm.
    SoftLimit(Answer),
    /// A received jog waits for the cancelled one before it to stop; `LineIntake` has its text.
    JogWaits,
    /// A line of G-code: the `LineInWork`.
    Job(Job),
}

/// Who is waiting for `ok`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Answer {
    /// The host.
    Host,
    /// A startup line that is being run; `.1` says whether the host waits for the last of them.
    Startup(usize, bool),
    /// The host, for a startup line that is stored once it has been run without error; its text waits in the controller.
    Validation(usize),
    /// Whoever has called the held text, once that has come to its end.
    Held(Caller),
    /// The host, for the setting of this number.
    Setting(u16),
    /// The host, and then the controller is initialised (`$RST`).
    Restart,
}

/// Whose line runs held text; who is waiting for its end as in [`Answer`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Caller {
    /// The host's.
    Host,
    /// A startup line.
    Startup(usize, bool),
    /// A startup line that is to be stored.
    Validation(usize),
}

impl Caller {
    /// Who gets the answer.
    pub(crate) fn answer(self) -> Answer {
        match self {
            Caller::Host => Answer::Host,
            Caller::Startup(index, host_waits) => Answer::Startup(index, host_waits),
            Caller::Validation(index) => Answer::Validation(index),
        }
    }
}

/// A line under way.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Job {
    pub(crate) answer: Answer,
    pub(crate) stage: Stage,
    pub(crate) jog: bool,
    /// The input that M66 waits for was so when it was looked at last.
    pub(crate) input_before: bool,
    /// Feed of the chords that are still to come, mm/s.
    pub(crate) chord_feed: f32,
    /// Until when a stage waits, and with how much left when a hold has suspended it.
    pub(crate) until: Instant,
    left: Duration,
    /// How long the spindle takes to turn, or to come to rest, after this line has switched it.
    pub(crate) spindle_delay: Duration,
}

impl Job {
    /// Nothing is done yet.
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

    /// How much longer the stage waits, or would if nothing had suspended it.
    pub(crate) fn left(&self, now: Instant) -> Duration {
        match self.stage {
            Stage::DwellSuspended | Stage::InputSuspended => self.left,
            _ => self.until.checked_duration_since(now).unwrap_or(Duration::from_ticks(0)),
        }
    }

    /// The stage that waits until a moment.
    pub(crate) fn wait(&mut self, stage: Stage, until: Instant) -> Stage {
        self.until = until;
        stage
    }
}

/// How far a line is. What a stage waits for is in the [`Job`]: stages are passed on at each step of each line, as a byte.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Stage {
    /// Motion that was queued before has to end first: a buffer synchronise in Grbl, a queue buster in LinuxCNC.
    Drain,
    /// Another tool is being put into the spindle: ends with `~`.
    ToolChange,
    /// The spindle comes to rest for a tool change with measuring, until a moment.
    SpinningDown,
    /// A tool change with measuring: `LineInWork` knows how far it is.
    Measuring,
    /// New modal state, spindle, coolant.
    Apply,
    /// A changed coordinate system is being stored.
    Storing,
    /// G4 until a moment.
    Dwell,
    /// Spindle on: it has turned long enough at this moment, and tells that it is up to speed.
    SpinningUp,
    /// G4 continues when the hold ends.
    DwellSuspended,
    /// M66 until a moment at most.
    Input,
    /// The same, which continues when the hold ends.
    InputSuspended,
    /// G28, G30: the intermediate point.
    Via,
    /// The motion itself.
    Target,
    /// The probe moves.
    Probing,
    /// Chords of the line's curve that are still to come.
    Chords,
    /// Motion has to end before the program pauses or ends.
    Flow,
    /// Paused: ends with `~`.
    Paused,
    /// Paused within a canned cycle.
    CyclePaused,
    /// To be answered.
    Done,
}

impl Task {
    pub(crate) fn is_none(&self) -> bool {
        matches!(self, Task::None)
    }

    /// Whether it belongs to a job, and is no answer that takes its time.
    pub(crate) fn is_program(&self) -> bool {
        !matches!(self, Task::None | Task::Listing(..) | Task::Storing(_))
    }

    /// Whether a reset owes the host an `ok` for it.
    pub(crate) fn answers_host(&self) -> bool {
        match self {
            Task::Job(Job { answer, .. }) | Task::Storing(answer) | Task::SoftLimit(answer) => {
                !matches!(answer, Answer::Startup(_, false) | Answer::Held(Caller::Startup(_, false)))
            }
            Task::Held(caller) => !matches!(caller, Caller::Startup(_, false)),
            Task::Listing(..) | Task::JogWaits => true,
            Task::Startup(_, answer) => answer.is_some(),
            Task::None => false,
        }
    }

    /// `late`: when a spindle is too late that should have turned long enough at a moment.
    pub(crate) fn wakeup(&self, late: impl Fn(Instant) -> Instant) -> Option<Instant> {
        match self {
            Task::Job(Job { stage: Stage::SpinningUp, until, .. }) => Some(late(*until)),
            Task::Job(Job { stage: Stage::Dwell | Stage::SpinningDown | Stage::Input, until, .. }) => Some(*until),
            _ => None,
        }
    }

    /// Whether a spindle is given the time to come up to speed.
    pub(crate) fn is_spinning_up(&self) -> bool {
        matches!(self, Task::Job(Job { stage: Stage::SpinningUp, .. }))
    }

    /// Whether a line has switched the spindle, and waits until it turns or rests.
    pub(crate) fn waits_for_spindle(&self) -> bool {
        match self {
            Task::Job(Job { stage: Stage::SpinningUp, .. }) => true,
            Task::Job(Job { stage: Stage::Storing | Stage::Dwell | Stage::DwellSuspended, spindle_delay, .. }) => {
                !spindle_delay.is_zero()
            }
            _ => false,
        }
    }

    /// A hold stops the clock of a dwell.
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

    /// What was under way cannot be carried out any more. Whether the host waits for an answer. Defaults that are restored
    /// already still act, with a restart.
    pub(crate) fn abandon(&mut self) -> bool {
        if let Task::Storing(Answer::Restart) = self {
            return false;
        }
        let answers = self.answers_host();
        *self = Task::None;
        answers
    }

    /// A jog that waits for room is not carried out any more; its answer is still given.
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
    /// `$ES` and the like
    Descriptions(Described),
    /// `$REC`
    Recording(Ask),
}

/// How far a piece of a recording is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Ask {
    /// To be asked for once there is room for it.
    Wanted,
    /// To be asked for now.
    Due,
    /// Asked for.
    Asked,
}
