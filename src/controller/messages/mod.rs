//! All types that cross between tasks, one file for each pair of tasks, and the depths of the queues between them.
//!
//! ```text
//!  serial ──realtime──▶ control ──segments──▶ step        stops: a sticky mark that `step` looks at first
//!  serial ──lines─────▶ control ◀──events──── step
//!  inputs ──signals───▶ control ──replies───▶ serial      (armed inputs raise it, too)
//! ```
//! What happens when a queue is full is written at its depth.

mod controller;
mod crash;
mod host;
mod inputs;
mod outputs;
mod recording;
mod step;
mod store;

pub use controller::{Event, Observed, Output, Room};
pub use crash::{Crash, CrashKind, ResetCause, Restart};
pub use host::{Chunk, HOST_CHANGED, LineByte, LineBytes, Realtime};
pub use inputs::{PinView, SECOND_SWITCH, Sensed, Signals, input};
pub use outputs::{Coolant, GangedMotors, InputWiring, SlowOutputs, SpindleDirection, Wiring};
pub use recording::{Noted, Recorded, Standing, Stopping};
pub use step::{AxisSteps, INTERVAL_FRACTION_BITS, Segment, StepEvent, ToStep, UNITS_PER_STEP};
pub use store::{Record, STORE_DAMAGED, Store};

/// Depth of serial -> control, realtime commands. `control` drains it in each turn, and 5 ms of nothing but commands at
/// 115200 baud fit. Full: the link waits where it can; on a plain UART resets, holds and the door are kept as marks
/// (`protocol::owed::Owed`), other commands are reported as lost.
pub const REALTIME_DEPTH: usize = 64;
/// Bytes of lines that fit between serial and control; what `Bf:` counts. Full: receive is paused where the link has
/// back-pressure (USB, QEMU; see `protocol::link`); on a plain UART the byte is dropped and the next one says so ([`LineByte::damaged`]).
pub const LINES_DEPTH: usize = 255;
/// Depth of serial -> control, in messages of such bytes. They fit however they arrive (see `protocol::byte_channel`), also with a
/// jog cancel behind each line: the shortest jog, `$J=X1F9` with its end, has 8 bytes. One more may be on its way out.
pub const LINE_MESSAGES: usize = LINES_DEPTH.div_ceil(8) + MOST_PARTIAL + 1;
/// So many messages are sent before they are full, since the queue was last seen empty, besides those that an epoch ends.
pub const MOST_PARTIAL: usize = 4;
/// Depth of control -> step. Full: `control` keeps the message for its next turn. Time, not this depth, is what
/// normally bounds it (see `QUEUED_TIME_MS` in `motion`).
pub const SEGMENTS_DEPTH: usize = 64;
/// Depth of step -> control. One entry for each stop, underrun or probe contact; `control` drains it in each turn. Full:
/// the step task keeps the event and sends it at its next entry.
pub const EVENTS_DEPTH: usize = 4;
/// Depth of control -> serial, in chunks. Full: `control` keeps its text; a slow host slows its own answers only.
pub const REPLIES_DEPTH: usize = 32;
/// Depth of inputs -> control. Full: the newest state replaces what could not be sent, as levels and not edges cross; the
/// stops that inputs have asked for are counted ([`Sensed::trips`]), so none of them is forgotten.
pub const SIGNALS_DEPTH: usize = 8;
