//! `oxmill board`: shows and checks pin tables of boards, and writes them into images of the firmware.

use crate::command_line::BoardCommand;
use crate::files;
use crate::job::{self, Ending};
use anyhow::{Context, Result, anyhow};
use oxmill_tables::{BOARDS, Board, image_file};
use std::fs;
use std::io::{self, Read};
use std::path::Path;

/// Runs `oxmill board`: lists, shows or checks pin tables, or writes one into an image. A table with faults gives
/// [`Ending::Faulty`].
pub fn run(command: &BoardCommand) -> Result<Ending> {
    match command {
        BoardCommand::List => list(),
        BoardCommand::Show { name } => show(name),
        BoardCommand::Check { table } => Ok(read(table)?.map_or(Ending::Faulty, |board| {
            files::eprint_line(&format!(
                "{}: no fault in {} pins for the image {}",
                board.name,
                board.pins.len(),
                board.image.name
            ));
            Ending::Good
        })),
        BoardCommand::Write { image, table, output } => {
            let Some(board) = read(table)? else { return Ok(Ending::Faulty) };
            let bytes = fs::read(image).with_context(|| format!("cannot read {}", image.display()))?;
            let changed =
                image_file::write(&bytes, &board.table()).map_err(|why| anyhow!("{}: {why}", image.display()))?;
            let output = output.as_ref().unwrap_or(image);
            job::output(output, "image")?.write(&changed)?;
            files::eprint_line(&format!("{} has the pins of {} now", output.display(), board.name));
            Ok(Ending::Good)
        }
    }
}

fn list() -> Result<Ending> {
    let boards = BOARDS.iter().filter_map(|(name, _)| Board::named(name));
    let text: String =
        boards.map(|board| format!("{:<23} {:<11}  {}\n", board.name, board.chip.name, board.title)).collect();
    files::print(io::stdout(), text.as_bytes()).context("cannot write the list")?;
    Ok(Ending::Good)
}

fn show(name: &str) -> Result<Ending> {
    let Some((_, text)) = BOARDS.iter().find(|(own, _)| *own == name) else {
        let names: Vec<&str> = BOARDS.iter().map(|(name, _)| *name).collect();
        return Err(anyhow!("there is no board {name}; there are {}", names.join(", ")));
    };
    files::print(io::stdout(), text.as_bytes()).context("cannot write the table")?;
    Ok(Ending::Good)
}

/// Reads a pin table from a file, or from standard input if the path is `-`. If the table has faults, prints them and
/// returns `None`.
fn read(path: &Path) -> Result<Option<Board>> {
    let mut bytes = Vec::new();
    let result = match path.as_os_str() == "-" {
        true => io::stdin().read_to_end(&mut bytes).map(|_| ()),
        false => fs::read(path).map(|read| bytes = read),
    };
    result.with_context(|| format!("cannot read {}", path.display()))?;
    let text = String::from_utf8(bytes).map_err(|_| anyhow!("{} is no text", path.display()))?;
    match Board::parse(&text) {
        Ok(board) => Ok(Some(board)),
        Err(faults) => {
            for fault in faults {
                let place = if fault.line > 0 { format!(":{}", fault.line) } else { String::new() };
                files::eprint_line(&format!("{}{place}: {}", path.display(), fault.text));
            }
            Ok(None)
        }
    }
}
