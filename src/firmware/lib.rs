//! The firmware's modules: the controller of `oxmill-controller`, pumped by tasks of RTIC.
//!
//! ```text
//!  priority 4  step     step timer     ◀─segments─┬─▶ events       pulses, directions, beam
//!  priority 3  inputs   SysTick        ─signals─▶                  switches and their stops, alarm clock of `control`, bytes of the UART
//!  priority 3  uart     UART           ─bytes─▶ ◀─bytes─           on a board whose UART has no DMA
//!  priority 2  serial   DMA, USB       ─realtime, lines─▶ ◀─replies─  links to the hosts
//!  priority 1  control  software task  everything is decided here, by the controller
//!  priority 0  idle                    sleeps
//! ```
//! The tasks are bound to their vectors in `main.rs`; what they do is here. Nothing shares the priority of `step`, and nothing is above it but
//! the handlers that end the program. Each channel has one sender and one receiver; what happens when one is full is written at its depth in `oxmill_controller::messages`. A channel
//! call takes 50 to 130 instructions and masks interrupts for 25 cycles of them at most (`cargo xtask count`).
#![no_std]

pub use oxmill_boards as boards;
pub use oxmill_step_task::{shared, step_timer};

mod clock;
pub mod control;
mod copy;
pub mod failure;
mod flash;
pub mod inputs;
pub mod last_words;
mod outputs;
pub mod serial;
pub mod stack;
pub mod startup;
mod watchdog;
