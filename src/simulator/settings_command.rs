//! The command `settings import`: reads the settings file of another controller, prints what each entry becomes, and
//! writes the settings.

use crate::command_line::ImportSettings;
use crate::files::{self, Role};
use crate::job::{Ending, output};
use crate::settings_import::{Import, import as import_text};
use anyhow::{Context, Result, anyhow};
use std::io::{self, Read};
use std::path::Path;

/// Maximum width, in characters, of the column of the report that shows the entries of the file.
const WIDEST: usize = 50;

/// Imports the file that the options name. Returns [`Ending::Faulty`] if an entry of the file is not taken.
///
/// # Errors
/// If the file cannot be read, is of no known form, or if the settings cannot be written.
pub fn import(options: &ImportSettings) -> Result<Ending> {
    let name = options.file.display();
    let input = Role { path: &options.file, name: "the file to import", written: false };
    let outputs = options.output.iter().map(|path| Role { path, name: "--output", written: true });
    files::check_apart(&[input].into_iter().chain(outputs).collect::<Vec<_>>())?;
    let text = read(&options.file).with_context(|| format!("cannot read {name}"))?;
    let import = import_text(&text).map_err(|why| anyhow!("cannot import {name}: {why}"))?;
    match &options.output {
        Some(path) if import.taken.is_empty() => {
            files::eprint_line(&format!("oxmill: {} is not written: there is no setting for it", path.display()));
        }
        Some(path) => output(path, "settings")?.write(import.assignments().as_bytes())?,
        None => {}
    }
    let report = if options.json { json(&import)? } else { report(&import) };
    files::print(io::stdout(), report.as_bytes()).context("cannot write the result")?;
    Ok(if import.left.is_empty() { Ending::Good } else { Ending::Faulty })
}

fn read(path: &Path) -> io::Result<String> {
    let (reader, _) = files::open_text(path)?;
    let mut bytes = Vec::new();
    reader.take(files::TEXT as u64 + 1).read_to_end(&mut bytes)?;
    if bytes.len() > files::TEXT {
        return Err(io::Error::other(format!("it has more than {} bytes", files::TEXT)));
    }
    Ok(String::from_utf8_lossy(&bytes).into_owned())
}

fn json(import: &Import) -> Result<String> {
    Ok(serde_json::to_string_pretty(import)? + "\n")
}

/// Returns the report for people: the entries in the order of the file.
fn report(import: &Import) -> String {
    let entries = import.taken.iter().map(|taken| &taken.from).chain(import.left.iter().map(|left| &left.text));
    let width = entries.map(|entry| entry.chars().count()).max().unwrap_or_default().min(WIDEST);
    let (taken, left) = (import.taken.len(), import.left.len());
    let entries = if left == 1 { "entry is" } else { "entries are" };
    let settings = if taken == 1 { "setting" } else { "settings" };
    let mut text = format!("{}: {taken} {settings}, {left} {entries} not taken\n", import.what);
    let mut rows: Vec<(usize, String)> = Vec::new();
    for taken in &import.taken {
        let unit = if taken.unit.is_empty() { String::new() } else { format!(", {}", taken.unit) };
        let setting = format!("${}={}", taken.number, taken.value);
        rows.push((taken.line, format!("  {:width$}  {setting:14} {}{unit}\n", taken.from, taken.name)));
    }
    for left in &import.left {
        rows.push((left.line, format!("  {:width$}  not taken: {}\n", left.text, left.why)));
    }
    rows.sort_by_key(|(line, _)| *line);
    text.extend(rows.into_iter().map(|(_, row)| row));
    text
}
