//! `oxmill man`: writes the manual pages, one for the program and one for each command, from the help texts of the
//! command line.

use crate::command_line::CommandLine;
use crate::files;
use anyhow::{Context, Result};
use clap::CommandFactory;
use clap_mangen::Man;
use std::path::Path;
use std::{fs, io, iter};

/// Writes all pages to standard output, one after the other, or each to a file in `folder`, which is created.
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
    let (mut pages, mut text) = (iter::once(&program).chain(program.get_subcommands()), Vec::new());
    let written = pages.try_for_each(|page| Man::new(page.clone()).render(&mut text));
    written.and_then(|()| files::print(io::stdout(), &text)).context("cannot write the manual")
}
