//! The pages of `docs/`: those that are made from tables of the firmware are current, links lead somewhere, commands exist.

use oxmill_controller::error::{Alarm, Error};
use oxmill_simulator::advice;
use std::collections::BTreeSet;
use std::fmt::Write;
use std::fs;
use std::path::{Path, PathBuf};

const ERRORS_HEAD: &str = "# Errors and alarms

After this page you know what `error:N` or `ALARM:N` means, and what helps. `oxmill check JOB` and the page in the browser say the same for each refused
line of a job. Numbers below 39 are those of Grbl 1.1h; most of those from 39 to 83 are grblHAL's. This page is made from the tables in
`src/controller/error.rs` and `src/simulator/advice.rs`.
";

fn root() -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR"))
}

fn read(path: &Path) -> String {
    fs::read_to_string(path).unwrap_or_else(|error| panic!("{}: {error}", path.display()))
}

/// The Markdown files of a folder.
fn pages(folder: &str) -> Vec<PathBuf> {
    let mut found: Vec<PathBuf> = fs::read_dir(root().join(folder))
        .expect("a folder")
        .map(|entry| entry.expect("an entry").path())
        .filter(|path| path.extension().is_some_and(|extension| extension == "md"))
        .collect();
    found.sort();
    found
}

fn all_pages() -> Vec<PathBuf> {
    [pages(""), pages("docs"), pages("examples")].concat()
}

#[test]
fn the_page_of_errors_is_the_tables() {
    let mut page = ERRORS_HEAD.to_owned();
    page += "\n## Errors\n\n| error | meaning | what helps |\n|---|---|---|\n";
    for error in Error::ALL {
        let _ = writeln!(page, "| {} | {} | {} |", error.code(), error.text(), advice::for_error(*error));
    }
    page += "\n## Alarms\n\nAn alarm locks the machine until `$X`, `$H` or a reset.\n\n| alarm | meaning | what helps |\n|---|---|---|\n";
    for alarm in Alarm::ALL {
        let _ = writeln!(page, "| {} | {} | {} |", alarm.code(), alarm.text(), advice::for_alarm(*alarm));
    }
    let path = root().join("docs/errors.md");
    if std::env::var_os("OXMILL_WRITE_DOCS").is_some() {
        fs::write(&path, &page).expect("docs/errors.md is written");
    }
    assert!(read(&path) == page, "docs/errors.md is out of date: run this test with OXMILL_WRITE_DOCS=1");
}

/// Targets of the links of a page, without those to other sites.
fn links(text: &str) -> Vec<String> {
    let targets = text.split("](").skip(1).filter_map(|rest| rest.split_once(')')).map(|(target, _)| target.to_owned());
    targets.filter(|target| !target.contains("://") && !target.contains(' ')).collect()
}

/// The name of a heading in a link: as forges and mdBook make it.
fn anchor(heading: &str) -> String {
    let plain = heading.trim_start_matches('#').trim().to_lowercase();
    plain
        .chars()
        .filter(|c| c.is_alphanumeric() || " -_".contains(*c))
        .map(|c| if c == ' ' { '-' } else { c })
        .collect()
}

#[test]
fn links_lead_to_files_and_headings_that_exist() {
    let mut seen = 0;
    for page in all_pages() {
        for link in links(&read(&page)) {
            let (file, heading) = link.split_once('#').unwrap_or((&link, ""));
            let target = if file.is_empty() { page.clone() } else { page.parent().expect("a folder").join(file) };
            assert!(target.exists(), "{} links to {link}", page.display());
            if !heading.is_empty() && target.extension().is_some_and(|extension| extension == "md") {
                let text = read(&target);
                let found = text.lines().filter(|line| line.starts_with('#')).any(|line| anchor(line) == heading);
                assert!(found, "{} links to {link}: there is no such heading", page.display());
            }
            seen += 1;
        }
    }
    assert!(seen > 60, "{seen} links");
}

#[test]
fn every_page_is_in_the_summary_once() {
    let listed = links(&read(&root().join("docs/SUMMARY.md")));
    let unique: BTreeSet<&String> = listed.iter().collect();
    assert_eq!(unique.len(), listed.len());
    for page in pages("docs") {
        let name = page.file_name().expect("a name").to_string_lossy().into_owned();
        assert!(name == "SUMMARY.md" || listed.contains(&name), "docs/SUMMARY.md has no {name}");
    }
}

#[test]
fn commands_of_the_pages_exist() {
    let xtask = read(&root().join("xtask/src/main.rs"));
    let program = read(&root().join("src/simulator/command_line.rs")).to_lowercase();
    let mut seen = 0;
    for page in all_pages() {
        let text = read(&page);
        let mut check = |prefix: &str, exists: &dyn Fn(&str) -> bool| {
            for rest in text.split(prefix).skip(1) {
                let word: String =
                    rest.chars().take_while(|c| c.is_ascii_lowercase() || "-_0123456789".contains(*c)).collect();
                assert!(word.is_empty() || exists(&word), "{}: `{prefix}{word}` does not exist", page.display());
                seen += 1;
            }
        };
        check("`cargo xtask ", &|word| xtask.contains(&format!("[\"{word}\"")));
        check("`oxmill ", &|word| {
            program.contains(&format!("    {word}("))
                || program.contains(&format!("    {word} {{"))
                || program.contains(&format!("    {word},"))
        });
    }
    assert!(seen > 20, "{seen} commands");
}
