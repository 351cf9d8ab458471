//! `oxmill man`: writes the manual pages, one for the program and one for each command, from the help texts of the
//! command line.

use crate::command_line::CommandLine;
use crate::files;
use anyhow::{Context, Result};
use clap::{Command, CommandFactory};
use clap_mangen::Man;
use std::path::Path;
use std::{fs, io, iter};

/// Writes all manual pages to standard output, one after the other, or each to a file in `folder`, which is created.
///
/// # Errors
/// If they cannot be written.
pub fn write(folder: Option<&Path>) -> Result<()> {
    if let Some(folder) = folder {
        let written =
            fs::create_dir_all(folder).and_then(|()| clap_mangen::generate_to(CommandLine::command(), folder));
        return written.with_context(|| format!("cannot write the manual pages to {}", folder.display()));
    }
    let mut program = CommandLine::command().disable_help_subcommand(true);
    program.build();
    let mut text = Vec::new();
    let written = pages(&program).into_iter().try_for_each(|page| Man::new(page.clone()).render(&mut text));
    written.and_then(|()| files::print(io::stdout(), &text)).context("cannot write the manual")
}

/// Returns a command and the commands within it, at any depth.
fn pages(command: &Command) -> Vec<&Command> {
    let within = command.get_subcommands().filter(|command| command.get_name() != "help").flat_map(pages);
    iter::once(command).chain(within).collect()
}
