//! The step task of the firmware (`step_timer`), and what tasks share with it (`shared`): a room of its own, so that it
//! is compiled for speed where the rest of an image is compiled for size.
#![no_std]

pub use oxmill_boards as boards;

pub mod shared;
pub mod step_timer;
