//! What the machine decides: protocol, G-code, planning, stepping. No hardware, no clock, no queues.
#![cfg_attr(not(test), no_std)]
#![forbid(unsafe_code)]
#![cfg_attr(not(test), deny(clippy::unwrap_used, clippy::expect_used, clippy::panic, clippy::indexing_slicing))]

pub mod axes;
pub mod digest;
pub mod error;
pub mod gcode;
pub mod messages;
pub mod units;
