//! All message types between tasks, one file per pair of tasks, and the depths of their queues.
//!
//! ```text
//!  serial ──realtime──▶ control ──segments──▶ step        stops: a sticky mark that `step` checks first
//!  serial ──lines─────▶ control ◀──events──── step
//!  inputs ──signals───▶ control ──replies───▶ serial      (armed inputs set the mark, too)
//! ```
//! A stop of the step task does not wait in a queue: it is requested by a mark that stays set until `step` has stopped.
//! The comment at each depth says what happens when the queue is full.

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

/// Depth of the queue serial -> control for realtime commands. `control` empties it in each turn of its loop. At
/// 115,200 baud, the queue holds 5 ms of input, even if the host sends only commands. Full: the link waits if it can.
/// On a plain UART, resets, holds and the door are kept as marks (`protocol::deferred::DeferredCommands`), and other
/// commands are reported as lost.
pub const REALTIME_DEPTH: usize = 64;
/// Number of line bytes that fit between serial and control, as reported by `Bf:`. Full: reception is paused if the
/// link has back-pressure (USB, QEMU; see `protocol::link`). On a plain UART the byte is dropped, and the next byte is
/// marked ([`LineByte::damaged`]).
pub const LINES_DEPTH: usize = 255;
/// Depth of the queue serial -> control for line bytes, in messages ([`LineBytes`]). [`LINES_DEPTH`] bytes always fit
/// (see `protocol::byte_channel`). In the worst case, a jog cancel after each line cuts the messages short. Then each
/// message has 8 bytes: the shortest jog, `$J=X1F9`, with its line end. One more slot is for a message that is about
/// to be sent.
pub const LINE_MESSAGES: usize = LINES_DEPTH.div_ceil(8) + MOST_PARTIAL + 1;
/// Maximum number of messages that are sent before they are full, counted since the queue was last empty. Messages that
/// a new epoch (see [`LineByte`]) cuts short do not count.
pub const MOST_PARTIAL: usize = 4;
/// Depth of control -> step. Full: `control` keeps the message until the step task has made room. Normally the queue is
/// not full, because `control` limits the queued time (see `QUEUED_TIME_MS` in `motion`).
pub const SEGMENTS_DEPTH: usize = 64;
/// Depth of step -> control. A stop, an underrun and a probe contact take one entry each; `control` empties the queue
/// each time it runs. Full: the step task keeps the event and sends it when it runs next.
pub const EVENTS_DEPTH: usize = 4;
/// Depth of control -> serial, in chunks. Full: `control` keeps its text; a slow host delays only its own answers.
pub const REPLIES_DEPTH: usize = 32;
/// Depth of inputs -> control. Full: a newer state replaces the unsent one, because messages contain levels, not edges.
/// Stops caused by inputs are counted ([`Sensed::trips`]), so no stop is lost.
pub const SIGNALS_DEPTH: usize = 8;
