//! The modules of the firmware: RTIC tasks that run the controller of `oxmill-controller`.
//!
//! ```text
//!  priority 4  step     step timer     ◀─segments─┬─▶ events       pulses, directions, laser
//!  priority 3  inputs   SysTick        ─signals─▶                  switches and their stops, alarm clock, UART bytes
//!  priority 3  uart     UART           ─bytes─▶ ◀─bytes─           on a board whose UART has no DMA
//!  priority 2  serial   DMA, USB       ─realtime, lines─▶ ◀─replies─  links to the hosts
//!  priority 1  control  software task  the controller makes all decisions here
//!  priority 0  idle                    sleeps
//! ```
//! `main.rs` binds the tasks to their vectors; their code is here. No other task has the priority of `step`, and only
//! the handlers that end the program have a higher one. Each channel has one sender and one receiver.
//! `oxmill_controller::messages` describes what happens when a channel is full. A channel call takes 50 to 130
//! instructions and masks interrupts for at most 25 cycles (`cargo xtask count`).
#![no_std]

pub use oxmill_boards as boards;
pub use oxmill_step_task::{shared, step_timer};

mod clock;
pub mod control;
mod copy;
pub mod failure;
pub mod inputs;
pub mod last_words;
mod outputs;
mod pin_table;
pub mod serial;
mod settings_store;
pub mod stack;
pub mod startup;
mod watchdog;

/// The controller with as many axes as this board has.
pub type BoardController = oxmill_controller::Controller<{ boards::AXES }>;
