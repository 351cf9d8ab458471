//! Why the controller started: the cause of the reset and, after a failure, the report of the previous run.

/// Why the processor was reset.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ResetCause {
    /// Power was switched on.
    Power,
    /// The reset pin.
    Pin,
    /// The firmware requested it.
    Software,
    /// The supply voltage dropped and recovered.
    BrownOut,
    /// The watchdog was not fed, because a task was stuck.
    Watchdog,
    /// Any other cause.
    Other,
}

/// How the firmware failed before the reset.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum CrashKind {
    /// A check in the firmware failed (Rust panic).
    Panic,
    /// The processor rejected an instruction or an address.
    Fault,
    /// The stack exceeded its memory.
    StackOverflow,
    /// A task was stuck.
    Stuck,
    /// The supply voltage dropped.
    Voltage,
    /// The external clock failed.
    Clock,
    /// The board cannot be used as it is. The firmware has found this at its start; the firmware itself has not failed.
    Board,
}

impl CrashKind {
    /// All kinds. The index of a kind is its number in a recording, and in the report in RAM that survives a reset.
    pub const ALL: [CrashKind; 7] = [
        CrashKind::Panic,
        CrashKind::Fault,
        CrashKind::StackOverflow,
        CrashKind::Stuck,
        CrashKind::Voltage,
        CrashKind::Clock,
        CrashKind::Board,
    ];
}

/// Report of the failure before the reset.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Crash {
    /// Kind of failure.
    pub kind: CrashKind,
    /// Location in the firmware, or the name of the task; printable ASCII.
    pub text: heapless::Vec<u8, 120>,
    /// Machine position in micrometres, as last recorded by the control task.
    pub place: [i32; 3],
    /// N word of the running line (0 = none), as last recorded by the control task.
    pub line: u32,
    /// Time at which `place` and `line` were recorded: microseconds since power-up (wrapping).
    pub moment: u32,
}

/// Information about the reset before this start.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Restart {
    /// Cause reported by the processor.
    pub cause: ResetCause,
    /// Report of the failure, if the firmware failed.
    pub crash: Option<Crash>,
    /// There is a recording from before the reset.
    pub is_recorded: bool,
}

impl Restart {
    /// Power was switched on, and nothing is known about the previous run.
    pub const POWER: Restart = Restart { cause: ResetCause::Power, crash: None, is_recorded: false };

    /// Returns whether a failure, and not a person, stopped the machine.
    pub fn is_failure(&self) -> bool {
        self.crash.is_some() || matches!(self.cause, ResetCause::Watchdog | ResetCause::BrownOut)
    }
}
