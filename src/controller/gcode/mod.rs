//! G-code: the text of one line becomes one [`Action`], or an error and nothing at all. The list of the room's
//! modules, and the `Dialect` (Grbl, Oxmill, seed) in which words are meant.
//!
//! ```text
//!  bytes ──parse──▶ Parsed ──check──▶ Action ──commit──▶ modal state, offsets, program position
//!         (words,            (meaning, in the             (only when the caller
//!          groups)            order of Grbl)               carries the line out)
//! ```
//! Promises: a refused line changes nothing, and checking changes nothing either; every byte sequence gets an answer
//! without panic or overflow; places are exact integers, so nothing drifts. Leaves to others: filtering and the line's
//! length (`protocol`), carrying out what a line means (`controller`), the shape of arcs and speeds (`motion`), travel
//! limits.

mod action;
mod arc;
mod check;
mod code;
#[cfg(feature = "full")]
mod computed;
#[cfg(not(feature = "full"))]
#[path = "computed/none.rs"]
mod computed;
mod continuation;
mod control_points;
mod cycle;
mod direction;
mod interpreter;
mod jog;
mod m_words;
mod memory;
mod modal;
mod offsets;
mod parse;
mod program_end;
#[cfg(feature = "reasons")]
mod refusal;
#[cfg(not(feature = "reasons"))]
#[path = "refusal/none.rs"]
mod refusal;
mod remark;
mod rotation;
mod saved;
mod scaling;
mod state;
mod tools;
mod values;
mod word;

pub use action::{Action, ArcMove, Feed, Flow, InputWait, MotionCommand, Notice, NurbsMove, ProgramPins, SplineMove};
pub use computed::HeldLine;
pub use cycle::{Cycle, CycleStep, CycleWords};
pub use direction::{Direction, Held};
pub use memory::ProgramMemory;
#[cfg(not(feature = "alloc"))]
pub use memory::ProgramStorage;
pub use modal::{
    ArcDistance, CoordinateSystem, CycleKind, Distance, FeedMode, Modal, MotionMode, OverridesHeld, PathControl,
    PathTolerance, Plane, PlaneAxes, ProbeMode, SplineKind, Units,
};
pub use offsets::{Offsets, StoredOffset};
pub use remark::{AS_WRITTEN, WITH_VALUES, split_remark};
pub use rotation::{Angle, Rotation};
pub use scaling::Scaling;
pub use state::Interpreter;
pub use tools::{TOOLS, Tool, ToolTable, asks_for_tool};
pub use word::{Group, group_of};

/// Whether this build says what is wrong with a refused line.
pub const REASONS: bool = cfg!(feature = "reasons");

/// What is wrong with a refused line; no memory where nothing is said.
pub type Reason = heapless::Vec<u8, { if REASONS { 128 } else { 0 } }>;

/// Whose meaning a program's words have.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Dialect {
    /// As Grbl 1.1h, even where more is known: eight digits, six coordinate systems, T forgotten after its line, axis
    /// words refused under a modal G80, and no M7, M56, G90.1 or turns of an arc.
    Grbl,
    /// Grbl's meaning of all that Grbl knows, and more words.
    #[default]
    Oxmill,
    /// As Oxmill, but G80 beside a motion word only cancels, axis words after G80 move by the last G0 or G1, and an
    /// arc whose end point lies off its circle ends where the ray from the centre to that point crosses the circle.
    Seed,
}
