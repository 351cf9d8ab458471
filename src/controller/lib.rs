//! What the machine decides: planning and stepping, and the types that cross between tasks. No hardware, no clock, no
//! queues: time and events come in as arguments, answers go out as plain data.

#![cfg_attr(not(test), no_std)]
#![forbid(unsafe_code)]
#![cfg_attr(not(test), deny(clippy::unwrap_used, clippy::expect_used, clippy::panic, clippy::indexing_slicing))]

pub mod axes;
pub mod digest;
pub mod error;
pub mod messages;
pub mod motion;
pub mod units;
