//! The controller on a desktop computer: the same code as on the board, with a virtual clock and a simulated machine
//! whose steps are recorded. This file declares the modules and the program's `main`.
//!
//! The feature `program` adds the command-line program: among others, `run` simulates a job and reports what the
//! machine did, and `serve` is a Grbl device for senders. Without this feature the library uses no files, threads,
//! system clock or drawing, and runs on any processor. The output of [`Simulator`] depends only on its input and on the
//! virtual time of each input. The module [`check`] runs whole jobs in a [`Simulator`].
//!
//! ```no_run
//! use oxmill_simulator::{Options, Simulator};
//! let mut mill = Simulator::new(Options::default());
//! assert!(mill.take_output().contains("Grbl 1.1h"));
//! mill.send("G21 G91 G1 X1 F100\n");
//! mill.run_until_idle();
//! assert_eq!(mill.take_output(), "ok\r\n");
//! assert_eq!(mill.machine_position(), [1.0, 0.0, 0.0]);
//! ```
#![forbid(unsafe_code)]

pub mod advice;
#[cfg(feature = "program")]
pub mod board_replay;
pub mod check;
#[cfg(feature = "program")]
mod clients;
pub mod clock;
mod column;
#[cfg(feature = "program")]
pub mod command_line;
pub mod explain;
pub mod file_kind;
#[cfg(feature = "program")]
pub mod files;
pub mod fittings;
#[cfg(feature = "program")]
mod flash_file;
pub mod homed;
pub mod host_link;
mod import_dump;
mod import_fluidnc;
mod import_list;
pub mod input_task;
#[cfg(feature = "program")]
pub mod job;
pub mod machine;
#[cfg(feature = "program")]
mod manual;
pub mod marks;
pub mod meter;
#[cfg(feature = "program")]
mod no_browser;
pub mod path;
#[cfg(feature = "program")]
mod pin_tables;
pub mod pins;
#[cfg(feature = "program")]
pub mod plot;
pub mod power_up;
mod prologue;
#[cfg(unix)]
#[cfg(feature = "program")]
mod pty_link;
mod pump;
mod realtime_bytes;
#[cfg(feature = "program")]
pub mod recording;
pub mod resume;
#[cfg(feature = "program")]
pub mod server;
#[cfg(feature = "program")]
mod settings_command;
pub mod settings_import;
#[cfg(feature = "program")]
pub mod short_report;
pub mod simulator;
mod small_board;
pub mod step_task;
pub mod store;
pub mod streaming;
pub mod summary;
#[cfg(feature = "program")]
mod tcp_link;
pub mod text;
pub mod tool_times;
pub mod trace;
#[cfg(feature = "program")]
mod web_link;

pub use fittings::Fittings;
pub use oxmill_boards::profiles as boards;
pub use simulator::{Options, Simulator};
pub use store::Store;
pub use text::JobText;

#[cfg(feature = "program")]
use anyhow::Context;
#[cfg(feature = "program")]
use clap::{CommandFactory, Parser};
#[cfg(feature = "program")]
use command_line::{Command, CommandLine};
#[cfg(feature = "program")]
use job::Ending;
#[cfg(feature = "program")]
use std::process::ExitCode;

/// Parses the command line and runs its command. Converts the result to the exit status, which
/// [`command_line::EXIT_STATUS`] explains.
#[cfg(feature = "program")]
pub fn main() -> ExitCode {
    let result = match CommandLine::parse().command {
        Command::Run(options) => job::run(&options),
        Command::Check(options) => job::check(options),
        Command::Plot(options) => job::plot(options),
        Command::Replay(options) => job::replay(&options),
        Command::Resume(options) => job::resume(&options),
        Command::Settings(command_line::SettingsCommand::Import(options)) => settings_command::import(&options),
        Command::Board(command) => pin_tables::run(&command),
        Command::Completions { shell } => {
            let mut script = Vec::new();
            clap_complete::generate(shell, &mut CommandLine::command(), "oxmill", &mut script);
            files::print(std::io::stdout(), &script).context("cannot write the completions").map(|()| Ending::Good)
        }
        Command::Man { out } => manual::write(out.as_deref()).map(|()| Ending::Good),
        Command::Serve(options) => server::serve(&options).map(|()| Ending::Good),
    };
    match result {
        Ok(Ending::Good) => ExitCode::SUCCESS,
        Ok(Ending::Faulty) => ExitCode::from(1),
        Ok(Ending::OtherSteps) => ExitCode::from(3),
        Err(error) => {
            files::eprint_line(&format!("oxmill: {error:#}"));
            ExitCode::from(2)
        }
    }
}
