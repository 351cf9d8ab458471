//! What the controller is doing at present: a line of G-code, a listing, startup lines, or storing a record. While
//! there is such a task, no further line is taken. A task also records who gets the answer. In names, "held" lines are
//! the stored lines of a subroutine, loop or macro.

use crate::protocol::system::Described;
use crate::units::{Duration, Instant};

/// What the controller is doing at present.
#[derive(Clone, Copy, Debug)]
// `repr(u8)` makes the tag (the number of the variant) a byte of its own. The tag is read before each output, so that
// must be fast.
#[repr(u8)]
pub(crate) enum Task {
    /// No task. The next line can be taken.
    None,
    /// The startup line with index `.0` runs next. `.1`: who gets an answer after the last startup line; `None` if
    /// nobody.
    Startup(usize, Option<Answer>),
    /// The controller runs the next stored line of a subroutine, loop or macro, for this caller.
    Held(Caller),
    /// An answer of many lines, and the index of its next line.
    Listing(Listing, usize),
    /// A record is being stored. The answer follows when it is stored.
    Storing(Answer),
    /// A line would leave the travel (soft limits). Motion is braking, and at rest the alarm follows.
    SoftLimit(Answer),
    /// A new jog has arrived while the previous, cancelled jog is still braking. The new jog waits. `LineIntake` keeps
    /// its text.
    JogWaits,
    /// The board restarts at the time `at`, which is late enough for the answer to reach the host. A reset, a hold, the
    /// door and every alarm cancel the restart.
    Rebooting {
        /// `true`: into the boot loader of the chip (`$DFU`).
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
    /// The startup line with index `.0`: its echo is sent with an `ok`, and the next startup line begins. `.1`: `true`
    /// if the host waits for an answer until the last startup line has been run.
    Startup(usize, bool),
    /// The host, which has set the startup line with this index (`$N`). The text of that line is stored after the line
    /// has run without error.
    Validation(usize),
    /// Nobody yet, because the line is a stored line of a subroutine, loop or macro. The caller gets an answer after
    /// the last stored line.
    Held(Caller),
    /// The host, which has changed the setting with this number.
    Setting(u16),
    /// The host. After the answer, the controller is initialised (`$RST`).
    Restart,
}

impl Answer {
    /// Returns whether the line belongs to the host's program: the host has sent the line itself, or has called the
    /// subroutine, loop or macro that contains the line.
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

/// A line of G-code in execution, with the data of all stages.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Job {
    pub(crate) answer: Answer,
    pub(crate) stage: Stage,
    pub(crate) jog: bool,
    /// Level that the input of M66 had at the last check.
    pub(crate) input_before: bool,
    /// Feed of the remaining chords (straight pieces of an arc or curve), mm/s.
    pub(crate) chord_feed: f32,
    /// Time until which the stage waits.
    pub(crate) until: Instant,
    /// Remaining time of a dwell (G4) or of the wait of M66, stored when a hold suspends the line.
    left: Duration,
    /// How long the spindle takes to spin up or down after this line has switched it.
    pub(crate) spindle_delay: Duration,
}

impl Job {
    /// Creates the job of a line that has not been started.
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

    /// Returns how much longer the stage waits. While a hold suspends the stage, this time does not run down.
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

/// Progress of a line. A stage has no data of its own: its data is in the [`Job`]. So a stage is a single byte, which
/// is cheap to pass on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Stage {
    /// All motion that was queued before this line has to end first. (Grbl calls this buffer synchronize, and LinuxCNC
    /// queue buster.)
    Drain,
    /// The operator puts another tool into the spindle. The command `~` ends the stage.
    ToolChange,
    /// The spindle spins down until [`Job::until`], before a tool change that measures the tool.
    SpinningDown,
    /// A tool change that measures the tool. `LineInWork` holds its progress.
    Measuring,
    /// Sets modal state, spindle and coolant.
    Apply,
    /// A changed coordinate system is being stored.
    Storing,
    /// G4, until [`Job::until`].
    Dwell,
    /// The spindle spins up until [`Job::until`]. If the machine has an at-speed input and this input is not active by
    /// then, the stage waits longer.
    SpinningUp,
    /// G4, suspended by a hold.
    DwellSuspended,
    /// M66, until [`Job::until`] at most.
    Input,
    /// M66, suspended by a hold.
    InputSuspended,
    /// Queues the intermediate point of G28 or G30.
    Via,
    /// Starts the motion of the line, after the intermediate point if there is one.
    Target,
    /// The probe moves.
    Probing,
    /// Queues the remaining chords of the line's curve.
    Chords,
    /// Queues the move from the milled circle back to its centre (G12, G13).
    Back,
    /// Motion has to end before the program pauses or ends.
    Flow,
    /// The program is paused. The command `~` ends the pause.
    Paused,
    /// The program is paused within a canned cycle. The command `~` ends the pause.
    CyclePaused,
    /// The line has been executed; its answer follows.
    Done,
}

impl Task {
    pub(crate) fn is_none(&self) -> bool {
        matches!(self, Task::None)
    }

    /// Returns whether the task belongs to a program or a jog. A listing, a store and a restart do not: they only take
    /// time.
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

    /// Returns the time for which the task waits; `None` if the task does not wait for a time. `late`: converts the end
    /// of the spin-up time to the time at which the spindle must be checked next.
    pub(crate) fn wakeup(&self, late: impl Fn(Instant) -> Instant) -> Option<Instant> {
        match self {
            Task::Job(Job { stage: Stage::SpinningUp, until, .. }) => Some(late(*until)),
            Task::Job(Job { stage: Stage::Dwell | Stage::SpinningDown | Stage::Input, until, .. }) => Some(*until),
            Task::Rebooting { at, .. } => Some(*at),
            _ => None,
        }
    }

    /// Returns whether a line is in the stage [`Stage::SpinningUp`].
    pub(crate) fn is_spinning_up(&self) -> bool {
        matches!(self, Task::Job(Job { stage: Stage::SpinningUp, .. }))
    }

    /// Returns whether a line has switched the spindle and must still wait until the spindle is up to speed or at rest.
    /// During G4 on the same line, this is also true.
    pub(crate) fn waits_for_spindle(&self) -> bool {
        match self {
            Task::Job(Job { stage: Stage::SpinningUp, .. }) => true,
            Task::Job(Job { stage: Stage::Storing | Stage::Dwell | Stage::DwellSuspended, spindle_delay, .. }) => {
                !spindle_delay.is_zero()
            }
            _ => false,
        }
    }

    /// Suspends a dwell or M66 because of a hold. [`Task::resume`] continues it with the remaining time.
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

    /// Drops the task. Returns whether the host still waits for an answer to the line that began the task. The restart
    /// after `$RST` is kept, because without it the defaults would not take effect.
    pub(crate) fn abandon(&mut self) -> bool {
        if let Task::Storing(Answer::Restart) = self {
            return false;
        }
        let answers = self.answers_host();
        *self = Task::None;
        answers
    }

    /// Ends a jog that waits for room in the look-ahead. The host still gets an answer to the jog.
    pub(crate) fn forget_jog(&mut self) {
        if let Task::Job(job) = self
            && job.jog
        {
            job.stage = Stage::Done;
        }
    }
}

/// An answer of many lines. The controller sends one line at a time, when there is room.
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
    /// `$I` with `$900=3` (the dialect of grblHAL). The answer names the inputs that the board has. So the listing
    /// requests a view of the pins and waits for it.
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
