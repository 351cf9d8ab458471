//! The entries of a recording, the state from which it can be replayed, and the pieces in which `$REC` lists it.

use super::crash::CrashKind;
use super::store::Record;
use crate::units::Coordinate;

/// The state of a machine at rest from which what follows can be played again: nothing is open in the program, nothing is
/// switched on, no offset holds but those that are stored, and no override.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Standing {
    /// Step counter of each axis: net steps since power-up (wrapping).
    pub counters: heapless::Vec<i32, { Standing::AXES }>,
    /// The machine position, as programmed.
    pub place: heapless::Vec<Coordinate, { Standing::AXES }>,
    /// Whether that is true, as far as can be known.
    pub trusted: bool,
    /// Locked without an alarm, as after power-up with homing.
    pub locked: bool,
    /// G20; the words are in millimetres.
    pub inches: bool,
    /// The tool in the spindle.
    pub tool: u32,
    /// Inputs that are active, as in [`input`](super::input).
    pub active: u32,
    /// What stays in force, as a line of G-code.
    pub words: heapless::Vec<u8, 64>,
}

impl Standing {
    /// Axes that a machine can have.
    pub const AXES: usize = 6;
}

/// What the step task has reported, as it is recorded.
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
    /// All of them, in the order of their numbers.
    pub const ALL: [Stopping; 5] =
        [Stopping::AtRest, Stopping::Moving, Stopping::Probed, Stopping::Underrun, Stopping::Miscounted];
}

/// An entry of a recording.
#[derive(Clone, Debug, PartialEq, Eq)]
#[allow(clippy::large_enum_variant, reason = "one at a time, on the stack")]
pub enum Noted {
    /// Power came on.
    PowerUp,
    /// Bytes of lines, at the end of the last of them.
    Host(heapless::Vec<u8, { Noted::HOST_BYTES }>),
    /// More bytes waited behind the line before.
    More,
    /// A realtime command, by its byte.
    Command(u8),
    /// Inputs that are active, and those that have stopped motion meanwhile; words as in [`input`](super::input).
    Inputs {
        /// Active.
        active: u32,
        /// Were active for a moment at least.
        tripped: u32,
    },
    /// The step task has reported, with its counters.
    Step(Stopping, heapless::Vec<i32, { Standing::AXES }>),
    /// The store has answered.
    Stored(bool),
    /// A host has opened the port.
    Connected,
    /// A host has gone.
    Disconnected,
    /// Bytes were lost here.
    Damaged,
    /// The rest of a line is void: see [`HOST_CHANGED`](super::HOST_CHANGED).
    Cut,
    /// The machine has come to rest.
    Rest {
        /// Step counters.
        counters: heapless::Vec<i32, { Standing::AXES }>,
        /// Hash of all blocks since the last stop.
        blocks: u32,
    },
    /// A state from which a replay can begin.
    Standing {
        /// The state.
        standing: Standing,
        /// As in [`Noted::Rest`].
        blocks: u32,
    },
    /// The program has ended.
    Ended {
        /// How; nothing if that is not known.
        crash: Option<CrashKind>,
        /// See [`Crash::place`](super::Crash::place).
        place: [i32; 3],
        /// See [`Crash::place`](super::Crash::place).
        line: u32,
    },
}

impl Noted {
    /// Bytes of the host in an entry. A longer line has several.
    pub const HOST_BYTES: usize = 60;
    /// In place of the number of a [`CrashKind`].
    pub const NO_CRASH: u8 = u8::MAX;
}

/// A piece of a recording that is listed.
#[derive(Clone, Debug, PartialEq, Eq)]
#[allow(clippy::large_enum_variant, reason = "one at a time, on the stack")]
pub enum Recorded {
    /// What comes first.
    Board {
        /// Name.
        name: &'static str,
        /// Ticks of the step clock in a second.
        step_clock_hz: u32,
    },
    /// A stored record.
    Record(Record),
    /// Where it begins, microseconds since power-up.
    Begin(u64),
    /// An entry and its time.
    Noted(u64, Noted),
    /// There is no more.
    End,
}
