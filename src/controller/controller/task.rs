//! What the controller is in the middle of, and who waits for its end.

use crate::protocol::system::Described;
use crate::units::{Duration, Instant};

/// What the controller is in the middle of. While there is one, no further line is taken.
#[derive(Clone, Copy, Debug)]
// As with `Mode`: the tag is asked for before each output.
#[repr(u8)]
pub(super) enum Task {
    /// Nothing: the next line may come.
    None,
    /// The startup line of this number is next; when all have been run, someone may get an answer.
    Startup(usize, Option<Answer>),
    /// The next line of held text is to be run.
    Held,
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
pub(super) enum Answer {
    /// The host.
    Host,
    /// A startup line that is being run; `.1` says whether the host waits for the last of them.
    Startup(usize, bool),
    /// The host, for a startup line that is stored once it has been run without error; its text waits in the controller.
    Validation(usize),
    /// The host, once the held text has come to its end.
    Held,
    /// The host, for the setting of this number.
    Setting(u16),
    /// The host, and then the controller is initialised (`$RST`).
    Restart,
}

/// A line under way.
#[derive(Clone, Copy, Debug)]
pub(super) struct Job {
    pub(super) answer: Answer,
    pub(super) stage: Stage,
    pub(super) jog: bool,
    /// How long the spindle takes to turn, or to come to rest, after this line has switched it.
    pub(super) spindle_delay: Duration,
}

#[derive(Clone, Copy, Debug)]
#[repr(u8)]
pub(super) enum Stage {
    /// Motion that was queued before has to end first.
    Drain,
    /// Another tool is being put into the spindle: ends with `~`.
    ToolChange,
    /// The spindle comes to rest for a tool change with measuring, until a moment.
    SpinningDown(Instant),
    /// A tool change with measuring: `LineInWork` knows how far it is.
    Measuring,
    /// New modal state, spindle, coolant.
    Apply,
    /// A changed coordinate system is being stored.
    Storing,
    /// G4 until a moment.
    Dwell(Instant),
    /// Spindle on: it has turned long enough at this moment, and tells that it is up to speed.
    SpinningUp(Instant),
    /// G4 with this much left when the hold ends.
    DwellSuspended(Duration),
    /// M66 until a moment at most; the input was so when it was looked at last.
    Input(Instant, bool),
    /// The same with this much left when the hold ends.
    InputSuspended(Duration, bool),
    /// G28, G30: the intermediate point.
    Via,
    /// The motion itself.
    Target,
    /// The probe moves.
    Probing,
    /// Chords of the line's curve that are still to come, at this feed.
    Chords(f32),
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
    pub(super) fn is_none(&self) -> bool {
        matches!(self, Task::None)
    }

    /// Whether it belongs to a job, and is no answer that takes its time.
    pub(super) fn is_program(&self) -> bool {
        !matches!(self, Task::None | Task::Listing(..) | Task::Storing(_))
    }

    /// Whether a reset owes the host an `ok` for it.
    pub(super) fn answers_host(&self) -> bool {
        match self {
            Task::Job(Job { answer, .. }) | Task::Storing(answer) | Task::SoftLimit(answer) => {
                !matches!(answer, Answer::Startup(_, false))
            }
            Task::Held | Task::Listing(..) | Task::JogWaits => true,
            Task::Startup(_, answer) => answer.is_some(),
            Task::None => false,
        }
    }

    /// `late`: when a spindle is too late that should have turned long enough at a moment.
    pub(super) fn wakeup(&self, late: impl Fn(Instant) -> Instant) -> Option<Instant> {
        match self {
            Task::Job(Job { stage: Stage::SpinningUp(until), .. }) => Some(late(*until)),
            Task::Job(Job {
                stage: Stage::Dwell(until) | Stage::SpinningDown(until) | Stage::Input(until, _), ..
            }) => Some(*until),
            _ => None,
        }
    }

    /// Whether a spindle is given the time to come up to speed.
    pub(super) fn is_spinning_up(&self) -> bool {
        matches!(self, Task::Job(Job { stage: Stage::SpinningUp(_), .. }))
    }

    /// A hold stops the clock of a dwell.
    pub(super) fn suspend(&mut self, now: Instant) {
        if let Task::Job(job) = self
            && let Stage::Dwell(until) = job.stage
        {
            job.stage = Stage::DwellSuspended(left(until, now));
        }
        if let Task::Job(job) = self
            && let Stage::Input(until, before) = job.stage
        {
            job.stage = Stage::InputSuspended(left(until, now), before);
        }
    }

    pub(super) fn resume(&mut self, now: Instant) {
        if let Task::Job(job) = self
            && let Stage::DwellSuspended(left) = job.stage
        {
            job.stage = Stage::Dwell(now + left);
        }
        if let Task::Job(job) = self
            && let Stage::InputSuspended(left, before) = job.stage
        {
            job.stage = Stage::Input(now + left, before);
        }
    }

    /// What was under way cannot be carried out any more. Whether the host waits for an answer.
    pub(super) fn abandon(&mut self) -> bool {
        let answers = self.answers_host();
        *self = Task::None;
        answers
    }

    /// A jog that waits for room is not carried out any more; its answer is still given.
    pub(super) fn forget_jog(&mut self) {
        if let Task::Job(job) = self
            && job.jog
        {
            job.stage = Stage::Done;
        }
    }
}

fn left(until: Instant, now: Instant) -> Duration {
    until.checked_duration_since(now).unwrap_or(Duration::from_ticks(0))
}

/// An answer of many lines.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Listing {
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
pub(super) enum Ask {
    /// To be asked for once there is room for it.
    Wanted,
    /// To be asked for now.
    Due,
    /// Asked for.
    Asked,
}
