//! Why the controller started: the cause of the reset and, after a failure, what the program before it reported.

/// Why the processor was reset.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ResetCause {
    /// Power came on.
    Power,
    /// The reset pin.
    Pin,
    /// The program asked for it.
    Software,
    /// The supply sank and rose again.
    BrownOut,
    /// The watchdog was not fed: a task stood still.
    Watchdog,
    /// None of these.
    Other,
}

/// What brought the program before the reset to its end.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum CrashKind {
    /// A check in the program failed.
    Panic,
    /// The processor refused an instruction or an address.
    Fault,
    /// The stack ran out of its memory.
    StackOverflow,
    /// A task stood still.
    Stuck,
    /// The supply sank.
    Voltage,
    /// The external clock failed.
    Clock,
}

impl CrashKind {
    /// All of them, in the order of their numbers in RAM that outlives a reset.
    pub const ALL: [CrashKind; 6] = [
        CrashKind::Panic,
        CrashKind::Fault,
        CrashKind::StackOverflow,
        CrashKind::Stuck,
        CrashKind::Voltage,
        CrashKind::Clock,
    ];
}

/// The last words of the program before the reset.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Crash {
    /// What happened.
    pub kind: CrashKind,
    /// Where, or which task; printable ASCII.
    pub text: heapless::Vec<u8, 120>,
    /// Machine position, micrometres, and N word (0 = none) of what was running, as the control task saw them last.
    pub place: [i32; 3],
    /// See `place`.
    pub line: u32,
    /// When that was: microseconds since power-up (wrapping).
    pub moment: u32,
}

/// How this start came about.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Restart {
    /// What the processor says.
    pub cause: ResetCause,
    /// What the program before it has left, if it came to a bad end.
    pub crash: Option<Crash>,
    /// There is a recording of what came in before it.
    pub is_recorded: bool,
}

impl Restart {
    /// Power came on, and nothing is known of before.
    pub const POWER: Restart = Restart { cause: ResetCause::Power, crash: None, is_recorded: false };

    /// Whether the machine was stopped by a failure and not by somebody.
    pub fn is_failure(&self) -> bool {
        self.crash.is_some() || matches!(self.cause, ResetCause::Watchdog | ResetCause::BrownOut)
    }
}
