//! Contents of a recording: its entries ([`Noted`]), the state of a machine at rest from which a replay can begin
//! ([`Standing`]), and the items that `$REC` lists ([`Recorded`]).

use super::crash::CrashKind;
use super::store::Record;
use crate::units::Coordinate;

/// State of a machine at rest from which a replay can begin: no program is in progress, all outputs are off, all
/// overrides are at 100 %, and no offsets are active except stored ones.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Standing {
    /// Step counter of each axis: net steps since power-up (wrapping).
    pub counters: heapless::Vec<i32, { Standing::AXES }>,
    /// Programmed machine position, not rounded to steps.
    pub place: heapless::Vec<Coordinate, { Standing::AXES }>,
    /// Whether the position is trusted.
    pub trusted: bool,
    /// Locked without an alarm, as after power-up with homing.
    pub locked: bool,
    /// G20 is active. `words` are in millimetres even then.
    pub inches: bool,
    /// Number of the tool in the spindle.
    pub tool: u32,
    /// Inputs that are active, as in [`input`](super::input).
    pub active: u32,
    /// Modal state as a line of G-code.
    pub words: heapless::Vec<u8, 64>,
}

impl Standing {
    /// Maximum number of axes of a machine.
    pub const AXES: usize = 6;
}

/// A report of the step task, as recorded.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[allow(missing_docs, reason = "see `StepEvent`")]
pub enum Stopping {
    AtRest,
    Moving,
    Probed,
    Underrun,
    Miscounted,
}

impl Stopping {
    /// All reports. A report's index is its number in a recording.
    pub const ALL: [Stopping; 5] =
        [Stopping::AtRest, Stopping::Moving, Stopping::Probed, Stopping::Underrun, Stopping::Miscounted];
}

/// An entry of a recording.
#[derive(Clone, Debug, PartialEq, Eq)]
#[allow(clippy::large_enum_variant, reason = "one at a time, on the stack")]
pub enum Noted {
    /// Power was switched on.
    PowerUp,
    /// Bytes of a line: all of them, or a part of a long line. The time of the entry is the time at which the line
    /// ended.
    Host(heapless::Vec<u8, { Noted::HOST_BYTES }>),
    /// More bytes were already waiting when the controller took the end of the previous line. This is recorded because
    /// the machine can treat a line differently if another line waits.
    More,
    /// A realtime command, by its byte.
    Command(u8),
    /// The inputs have changed. Both words are as in [`input`](super::input).
    Inputs {
        /// Active inputs.
        active: u32,
        /// Inputs that have stopped motion since the previous entry of this kind. They may be inactive again.
        tripped: u32,
    },
    /// A report of the step task, with the step counter of each axis.
    Step(Stopping, heapless::Vec<i32, { Standing::AXES }>),
    /// The answer of the settings store to a change: `true` if the change was stored.
    Stored(bool),
    /// A host has opened the port.
    Connected,
    /// A host has disconnected.
    Disconnected,
    /// Bytes from the host were lost at this point.
    Damaged,
    /// The unfinished line is void: see [`HOST_CHANGED`](super::HOST_CHANGED).
    Cut,
    /// The machine has come to rest.
    Rest {
        /// Step counter of each axis.
        counters: heapless::Vec<i32, { Standing::AXES }>,
        /// Hash of all blocks since the last stop.
        blocks: u32,
    },
    /// The machine is at rest, in a state from which a replay can begin.
    Standing {
        /// State of the machine at rest.
        standing: Standing,
        /// Hash of all blocks since the last stop.
        blocks: u32,
    },
    /// The recorded run of the firmware has ended, for example by a failure.
    Ended {
        /// Kind of failure, if known.
        crash: Option<CrashKind>,
        /// Machine position in micrometres at the end: see [`Crash::place`](super::Crash::place).
        place: [i32; 3],
        /// N word of the line that ran at the end, 0 = none: see [`Crash::line`](super::Crash::line).
        line: u32,
    },
}

impl Noted {
    /// Maximum number of bytes of a line in an entry. A longer line is divided into several entries.
    pub const HOST_BYTES: usize = 60;
    /// Recorded if no crash is known, in place of the number of a [`CrashKind`].
    pub const NO_CRASH: u8 = u8::MAX;
}

/// An item of the listing that `$REC` sends.
#[derive(Clone, Debug, PartialEq, Eq)]
#[allow(clippy::large_enum_variant, reason = "one at a time, on the stack")]
pub enum Recorded {
    /// The first item: the board that made the recording.
    Board {
        /// Name of the board.
        name: &'static str,
        /// Frequency of the step clock, in ticks per second.
        step_clock_hz: u32,
    },
    /// A record of the settings store.
    Record(Record),
    /// Start time of the recording, in microseconds since power-up.
    Begin(u64),
    /// An entry and its time.
    Noted(u64, Noted),
    /// The last item: the recording has no more entries.
    End,
}
