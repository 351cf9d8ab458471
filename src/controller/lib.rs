//! The controller of a CNC mill that speaks Grbl 1.1: protocol, G-code, planning and stepping.
//!
//! The crate contains no hardware access, clock, queues or waiting: [`Controller::event`] takes bytes, levels and the
//! time, and [`Controller::output`] returns the next thing to do. So the same code, bit for bit, runs in the firmware
//! on a board and in the simulator on a desk.
//!
//! The journey of `G1 X10 F500`:
//! 1. `protocol::realtime` passes its bytes on (a `?` between them would be answered at once);
//! 2. `protocol::line_filter` collects them, without blanks, as `G1X10F500`;
//! 3. `gcode` reads words, checks them against each other and the modal state, and returns an action: feed, target;
//! 4. `work` waits for room in the look-ahead, applies the new modal state and hands the move to `motion`;
//! 5. `motion::planner` makes a block of whole motor steps and fits its speeds to those of its neighbours;
//! 6. `host` answers `ok`;
//! 7. `motion::segment` cuts the block into segments of about a millisecond, each with evenly changing tick intervals;
//! 8. the pump carries the segments, about 16 ms ahead, to the step task;
//! 9. `motion::stepper` decides at each tick which motors step and when the next tick comes;
//! 10. the step task outputs these steps on the step pins; in the simulator it writes them into a trace.
#![cfg_attr(not(test), no_std)]
#![forbid(unsafe_code)]
// `Lent` is a reference on a board and a box on a PC (feature `alloc`); only the box needs the explicit borrow.
#![cfg_attr(not(feature = "alloc"), allow(clippy::needless_borrow))]
#![cfg_attr(
    not(test),
    deny(clippy::unwrap_used, clippy::expect_used, clippy::panic, clippy::indexing_slicing, clippy::unreachable)
)]

#[cfg(feature = "alloc")]
extern crate alloc;

pub mod axes;
pub mod digest;
pub mod error;
mod image;
pub mod lent;
pub mod memory;
pub mod messages;
pub mod units;

pub mod number;
pub mod settings;

pub mod gcode;
pub mod machine;
pub mod motion;
pub mod protocol;

mod dispatch;
mod host;
mod inputs;
mod outputs;
mod parts;
pub mod pump;
#[cfg(feature = "full")]
pub mod recorder;
#[cfg(not(feature = "full"))]
#[path = "recorder/none.rs"]
pub mod recorder;
mod states;
mod step_rates;
mod step_timing;
mod view;
mod work;
pub use dispatch::{Controller, Profile};
pub use messages::ResetCause;
pub use motion::stepper::{Stepper, Tick};
pub use protocol::byte_channel::{LineReader, LineSender};
pub use protocol::coalescing::Coalescing;
pub use protocol::deferred::DeferredCommands;
pub use protocol::host_arbiter::HostArbiter;
pub use protocol::link::Link;
pub use protocol::queues::Queues;
pub use protocol::realtime::Received;
pub use step_rates::StepRates;
pub use step_timing::{StepTiming, later, sooner};
