//! Checks the pages of `docs/`: generated pages are current, links are valid, commands exist and print what the pages
//! show, and pictures are current. `OXMILL_WRITE_DOCS=1 cargo test --test book` writes everything that is generated.

mod boards;
mod commands;
mod conversations;
mod drawings;
mod loader;
mod measured;
mod pictures;
mod wiring;
mod words;

use oxmill_controller::error::{Alarm, Error};
use oxmill_controller::settings::{PER_AXIS, SCALARS, Settings};
use oxmill_simulator::advice;
use std::collections::BTreeSet;
use std::fmt::Write;
use std::fs;
use std::path::{Path, PathBuf};
use std::sync::{Mutex, PoisonError};

const ERRORS_HEAD: &str = "# Errors and alarms

After this page you know what `error:N` or `ALARM:N` means, and what helps. `oxmill check JOB` and the page in the browser show these texts for each rejected
line of a job. Numbers below 39 are those of Grbl 1.1h; most numbers from 39 to 83 are those of grblHAL. This page is made from the tables in
`src/controller/error.rs` and `src/simulator/advice.rs`.
";

fn root() -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR"))
}

fn read(path: &Path) -> String {
    fs::read_to_string(path).unwrap_or_else(|error| panic!("{}: {error}", path.display()))
}

/// Returns the Markdown files of a folder.
fn pages(folder: &str) -> Vec<PathBuf> {
    let mut found: Vec<PathBuf> = fs::read_dir(root().join(folder))
        .expect("a folder")
        .map(|entry| entry.expect("an entry").path())
        .filter(|path| path.extension().is_some_and(|extension| extension == "md"))
        .collect();
    found.sort();
    found
}

/// Held while a page is read and written, so that tests do not write at the same time.
static PAGES: Mutex<()> = Mutex::new(());

/// Returns `true` if generated pages are to be written instead of compared (`OXMILL_WRITE_DOCS`).
fn writes() -> bool {
    std::env::var_os("OXMILL_WRITE_DOCS").is_some()
}

/// Fails if a page differs from the text that `make` returns for it. With `OXMILL_WRITE_DOCS`, writes that text to the
/// page instead.
fn keep(page: &Path, make: impl FnOnce(&str) -> String) {
    let _alone = PAGES.lock().unwrap_or_else(PoisonError::into_inner);
    let text = fs::read_to_string(page).unwrap_or_default();
    let now = make(&text);
    if writes() {
        if now != text {
            fs::write(page, now).expect("the page is written");
        }
        return;
    }
    let differs = text.lines().chain(["(its end)"]).zip(now.lines().chain(["(its end)"])).find(|(is, made)| is != made);
    assert!(
        now == text,
        "{} is out of date: OXMILL_WRITE_DOCS=1 cargo test --test book\nit has     {}\ninstead of {}",
        page.display(),
        differs.map_or("", |(is, _)| is),
        differs.map_or("", |(_, made)| made)
    );
}

/// Returns the text with the table between the marks `<!-- made: name -->` and `<!-- end -->` replaced.
fn with_table(text: &str, name: &str, table: &str) -> String {
    let (begin, end) = (format!("<!-- made: {name} -->\n"), "<!-- end -->");
    let (before, rest) = text.split_once(&begin).unwrap_or_else(|| panic!("no `made: {name}`"));
    let (_, after) = rest.split_once(end).expect("the end of what is made");
    format!("{before}{begin}{table}{end}{after}")
}

/// Returns the text after the fence if the line opens or closes a fenced block. A block in a list is indented.
fn fence(line: &str) -> Option<&str> {
    line.trim_start().strip_prefix("```")
}

/// Returns the fenced blocks of a page. Each has the text after its opening fence, and its lines without the
/// indentation of that fence.
fn fences(text: &str) -> Vec<(String, Vec<String>)> {
    let mut found: Vec<(String, Vec<String>)> = Vec::new();
    let mut open = None;
    for line in text.lines() {
        match (fence(line), open) {
            (Some(_), Some(_)) => open = None,
            (Some(kind), None) => {
                open = Some(&line[..line.len() - line.trim_start().len()]);
                found.push((kind.to_owned(), Vec::new()));
            }
            (None, Some(indent)) => {
                let line = line.strip_prefix(indent).unwrap_or(line);
                found.last_mut().expect("a fence").1.push(line.to_owned());
            }
            (None, None) => {}
        }
    }
    found
}

#[test]
fn fences_in_lists_are_seen() {
    let page = "* A list:\n\n  ```sh\n  oxmill run a.nc\n    b\n  ```\n\n```text\n  c\n```\n";
    let lines = |lines: &[&str]| lines.iter().map(|line| (*line).to_owned()).collect::<Vec<_>>();
    let wanted = [("sh".to_owned(), lines(&["oxmill run a.nc", "  b"])), ("text".to_owned(), lines(&["  c"]))];
    assert_eq!(fences(page), wanted);
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
    page += "\n## Alarms\n\nAn alarm locks the machine until `$X` or `$H`. If its row says so, send a reset first.\n\n| alarm | meaning | what helps |\n|---|---|---|\n";
    for alarm in Alarm::ALL {
        let _ = writeln!(page, "| {} | {} | {} |", alarm.code(), alarm.text(), advice::for_alarm(*alarm));
    }
    keep(&root().join("docs/errors.md"), |_| page);
}

/// Returns the targets of a page's links, without those to other sites.
fn links(text: &str) -> Vec<String> {
    let targets = text.split("](").skip(1).filter_map(|rest| rest.split_once(')')).map(|(target, _)| target.to_owned());
    targets.filter(|target| !target.contains("://") && !target.contains(' ')).collect()
}

/// Returns the anchor of a heading, as forges and mdBook make it.
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

/// The first paragraph of a page says what its reader will know or be able to do after it.
#[test]
fn every_page_opens_with_what_its_reader_can_do_then() {
    for page in pages("docs").iter().filter(|page| !page.ends_with("SUMMARY.md")) {
        let text = read(page);
        let mut lines = text.lines().filter(|line| !line.is_empty());
        assert!(lines.next().is_some_and(|title| title.starts_with("# ")), "{} has no title", page.display());
        let first = lines.next().unwrap_or_default();
        assert!(first.starts_with("After this page you "), "{} opens with: {first}", page.display());
    }
}

#[test]
fn settings_that_pages_for_newcomers_name_exist() {
    let settings = Settings::<3>::default();
    let known: BTreeSet<u16> =
        (0..Settings::<3>::LINES).filter_map(|line| settings.row(line)).map(|row| row.1).collect();
    let mut seen = 0;
    for name in ["boards", "first-cut", "set-up", "tuning", "coming-from", "troubleshooting", "senders"] {
        // Skip the first column of tables: it can have the setting numbers of other controllers.
        let text = read(&root().join(format!("docs/{name}.md")));
        let own: String = text
            .lines()
            .map(|line| line.strip_prefix("| ").and_then(|row| row.split_once(" | ")).map_or(line, |(_, cells)| cells))
            .collect();
        for rest in own.split('$').skip(1) {
            let digits: String = rest.chars().take_while(char::is_ascii_digit).collect();
            let Ok(number) = digits.parse() else { continue };
            assert!(known.contains(&number), "{name}: ${number}");
            seen += 1;
        }
    }
    assert!(seen > 200, "{seen} settings");
}

/// Returns the setting numbers in a cell: `$1`, `$26` and `$100` to `$102`.
fn settings_of(cell: &str) -> Vec<u16> {
    let mut found: Vec<u16> = Vec::new();
    for (number, before) in cell.split("`$").skip(1).zip(cell.split("`$")) {
        let Ok(number) = number.split('`').next().unwrap_or_default().parse() else { continue };
        let last = found.last().copied().filter(|_| before.ends_with("` to "));
        found.extend(last.map_or(number, |last| last + 1)..=number);
    }
    found
}

/// The page for users of Grbl treats each setting of Grbl, in the first column of its tables.
#[test]
fn each_setting_of_grbl_is_treated_for_those_who_come_from_it() {
    let page = read(&root().join("docs/coming-from.md"));
    let section = page.split("## From Grbl 1.1").nth(1).and_then(|rest| rest.split("\n## ").next()).expect("a section");
    let cells = section.lines().filter(|line| line.starts_with('|')).filter_map(|line| line.split('|').nth(1));
    let mut treated: Vec<u16> = cells.flat_map(settings_of).collect();
    treated.sort_unstable();
    let scalars = SCALARS.iter().filter(|entry| entry.grbl).map(|entry| entry.number);
    let per_axis = PER_AXIS.iter().filter(|entry| entry.grbl).flat_map(|entry| entry.number..entry.number + 3);
    let of_grbl: Vec<u16> = scalars.chain(per_axis).collect();
    assert_eq!(of_grbl.len(), 34);
    assert_eq!(treated, of_grbl);
}
