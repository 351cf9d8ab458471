//! G-code: turns the text of one line into either one [`Action`] or an error. This file lists the modules and defines
//! [`Dialect`], which decides what the words mean.
//!
//! ```text
//!  bytes ──parse──▶ Parsed ──check──▶ Action ──commit──▶ modal state, offsets, program position
//!         (words,            (meaning, in the             (only when the caller
//!          groups)            order of Grbl)               carries the line out)
//! ```
//! Guarantees:
//! * The check of a line does not change modal state, offsets or position. So a refused line leaves them as they were.
//! * Every byte sequence is either accepted or refused, without panic or overflow.
//! * Positions are integers, so rounding errors do not add up.
//!
//! Not done here: filtering bytes and limiting the length of lines (`protocol`), executing actions (`controller`),
//! dividing arcs into chords and choosing speeds (`motion`), checking travel limits.

mod action;
mod arc;
mod check;
mod code;
mod comment;
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
mod memory;
mod modal;
mod offsets;
mod parse;
mod program_end;
mod program_number;
#[cfg(feature = "reasons")]
mod refusal;
#[cfg(not(feature = "reasons"))]
#[path = "refusal/none.rs"]
mod refusal;
mod rotation;
mod saved;
mod scaling;
mod state;
mod tools;
mod values;
mod word;

pub use action::{Action, ArcMove, Feed, Flow, InputWait, MotionCommand, Notice, NurbsMove, ProgramPins, SplineMove};
pub use comment::{AS_WRITTEN, WITH_VALUES, split_comment};
pub use computed::HeldLine;
#[cfg(feature = "alloc")]
pub use computed::LEAST_HELD;
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
pub use rotation::{Angle, Rotation};
pub use scaling::Scaling;
pub use state::{Interpreter, ProgramPlace};
pub use tools::{TOOLS, Tool, ToolTable, asks_for_tool};
pub use word::{Group, group_of};

/// Whether this build explains what is wrong with a refused line.
pub const REASONS: bool = cfg!(feature = "reasons");

/// Explanation of what is wrong with a refused line; takes no memory in a build without reasons.
pub type Reason = heapless::Vec<u8, { if REASONS { 128 } else { 0 } }>;

/// The CNC control for which a program is written. It decides what the words mean.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Dialect {
    /// As Grbl 1.1h, without the extensions: only the first eight digits of a number count, there are six coordinate
    /// systems, T is forgotten after its line, and the words M7, M56, G90.1 and P for the turns of an arc do not exist.
    /// While G80 is active, axis words are refused even if another command of the line uses them.
    Grbl,
    /// All words of Grbl with Grbl's meaning, and further words.
    #[default]
    Oxmill,
    /// As Oxmill, with two exceptions. Axis words after G80 move the axes in the mode of the most recent G0 or G1. If
    /// the end point of an arc is off the circle, the arc ends where the line from the centre through that point
    /// crosses the circle.
    Seed,
}
