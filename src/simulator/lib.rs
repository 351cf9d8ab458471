//! The controller on a desk: the same code as on the board, with a virtual clock and a traced machine around it.
//!
//! `run` sends a job through it and says what the machine did; `serve` is a Grbl device for senders. In process,
//! [`Simulator`] is both, for tests: what it does is a function of what is sent to it and when in virtual time.
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

pub mod clock;
pub mod command_line;
pub mod files;
pub mod fittings;
pub mod host_link;
pub mod input_task;
pub mod job;
pub mod machine;
pub mod meter;
pub mod path;
pub mod pins;
pub mod plot;
mod pump;
pub mod server;
pub mod simulator;
pub mod step_task;
pub mod store;
pub mod summary;
pub mod text;
pub mod trace;

pub use fittings::Fittings;
pub use oxmill_boards::profiles as boards;
pub use simulator::{Options, Simulator};
pub use store::Store;
pub use text::JobText;

use clap::Parser;
use command_line::{Command, CommandLine};
use std::process::ExitCode;

/// The program. 0: all went well; 1: the job had errors or ended in an alarm; 2: it could not be begun, or a file could not
/// be read to its end or written.
pub fn main() -> ExitCode {
    let result = match CommandLine::parse().command {
        Command::Run(options) => job::run(&options),
        Command::Serve(options) => server::serve(&options).map(|()| true),
    };
    match result {
        Ok(true) => ExitCode::SUCCESS,
        Ok(false) => ExitCode::from(1),
        Err(error) => {
            eprintln!("oxmill: {error:#}");
            ExitCode::from(2)
        }
    }
}
