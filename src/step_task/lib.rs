//! The step task of the firmware (`step_timer`), and the data that all tasks share (`shared`). This is a separate
//! crate, so that it is compiled for speed even in images whose other crates are compiled for size.
#![no_std]

pub use oxmill_boards as boards;

pub mod shared;
pub mod step_timer;
