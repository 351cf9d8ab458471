//! What the documents say of the code: files that exist, functions that are in them, rooms that are in the table.

use crate::{root, source};
use std::collections::BTreeMap;
use std::fs;
use std::path::Path;

fn document(name: &str) -> String {
    fs::read_to_string(root().join("docs").join(name)).unwrap_or_else(|error| panic!("docs/{name}: {error}"))
}

/// The rows of all tables, as cells.
fn rows(text: &str) -> impl Iterator<Item = Vec<&str>> {
    text.lines()
        .filter(|line| line.starts_with('|') && !line.starts_with("|---"))
        .map(|line| line.trim_start_matches('|').trim_end_matches('|').split('|').map(str::trim).collect())
}

/// What stands between backticks.
fn quoted(text: &str) -> impl Iterator<Item = &str> {
    text.split('`').skip(1).step_by(2)
}

/// Names of the functions of a file, also of those that a macro makes.
fn functions(file: &str) -> Vec<String> {
    let text = fs::read_to_string(root().join(file)).unwrap_or_else(|error| panic!("{file}: {error}"));
    let tokens = source::lex(&source::bare(&text));
    tokens.windows(2).filter(|pair| pair[0].text == "fn").map(|pair| pair[1].text.clone()).collect()
}

#[test]
fn the_journey_passes_functions_that_exist() {
    let text = document("journey.md");
    let mut stations = 0;
    for cells in rows(&text).filter(|cells| cells[0] != "file") {
        let [file, names, _] = cells[..] else { panic!("three cells: {cells:?}") };
        for file in quoted(file) {
            let found = functions(file);
            for name in quoted(names) {
                assert!(found.iter().any(|f| f == name), "docs/journey.md: {file} has no function `{name}`");
                stations += 1;
            }
        }
    }
    assert!(stations > 50, "{stations}");
}

/// Paths in backticks lead to something.
#[test]
fn paths_in_documents_exist() {
    let mut seen = 0;
    for name in
        ["cost.md", "glossary.md", "how-it-works.md", "journey.md", "limits.md", "motion.md", "storage.md", "tests.md"]
    {
        let text = document(name);
        for path in quoted(&text).filter(|text| !text.contains([' ', '*', '<', '$', '{'])) {
            let is_path = ["src/", "boards/", "tests/", "docs/", "xtask/"].iter().any(|room| path.starts_with(room));
            if is_path {
                assert!(root().join(path.trim_end_matches('/')).exists(), "docs/{name} names `{path}`");
                seen += 1;
            }
        }
    }
    assert!(seen > 60, "{seen}");
}

/// Each row of the glossary has its five cells, and no term two rows.
#[test]
fn the_glossary_has_each_term_once() {
    let text = document("glossary.md");
    let mut terms: Vec<&str> = Vec::new();
    for cells in rows(&text).filter(|cells| cells[0] != "our term") {
        assert_eq!(cells.len(), 5, "{cells:?}");
        assert!(!cells[2].is_empty() && quoted(cells[4]).count() > 0, "{cells:?}");
        terms.extend(cells[0].split(", "));
    }
    terms.sort_unstable();
    let twice: Vec<&[&str]> = terms.windows(2).filter(|pair| pair[0] == pair[1]).collect();
    assert!(twice.is_empty() && terms.len() > 40, "{twice:?}");
}

#[test]
fn every_room_has_a_sentence() {
    let text = document("how-it-works.md");
    let table = text.split("## All rooms").nth(1).and_then(|rest| rest.split("\n## ").next()).unwrap();
    let listed: Vec<&str> = rows(table).flat_map(|cells| quoted(cells[0]).collect::<Vec<_>>()).collect();
    let mut rooms: Vec<String> = ["src/sqrt", "src/store", "src/firmware", "xtask"].map(str::to_owned).to_vec();
    let folders = ["src/controller", "tests"];
    for folder in folders {
        for entry in fs::read_dir(root().join(folder)).unwrap() {
            let path = entry.unwrap().path();
            let name = path.file_name().unwrap().to_string_lossy().into_owned();
            let has_code =
                path.is_dir() && folder == "src/controller" && name != "tests" || path.join("main.rs").exists();
            let is_file = folder == "src/controller" && name.ends_with(".rs") && name != "lib.rs";
            if has_code || is_file {
                rooms.push(format!("{folder}/{name}"));
            }
        }
    }
    for room in &rooms {
        assert!(listed.contains(&room.as_str()), "docs/how-it-works.md has no row for `{room}`");
    }
    assert!(rooms.len() > 18, "{rooms:?}");
}

/// Folders whose files docs/files.md lists.
const LISTED: [&str; 2] = ["boards", "src"];

/// Files that docs/files.md lists, by the end of their names, and how the comment at their head begins.
const KINDS: [(&str, &str); 5] = [("css", "/*"), ("html", "<!--"), ("mjs", "//"), ("rs", "//!"), ("ts", "//")];

/// What begins the paragraph of a file's head that has the names to look for in it.
const NAMES: &str = "Names: ";

/// Two paragraphs of the comment at a file's head: the first, what the file is about, and the names to look for in it, if
/// there are any.
fn head_of(file: &Path, text: &str) -> (String, String) {
    let (_, mark) = KINDS.iter().find(|(kind, _)| file.extension().is_some_and(|e| e == *kind)).unwrap();
    let lines = text.lines().skip_while(|line| line.starts_with("<!doctype")).map_while(|line| line.strip_prefix(mark));
    let lines: Vec<&str> = lines.map(|line| line.trim_end_matches("*/").trim_end_matches("-->").trim()).collect();
    let mut paragraphs = lines.split(|line| line.is_empty()).map(|lines| lines.join(" ").replace('|', "\\|"));
    let about = paragraphs.next().unwrap_or_default();
    let names = paragraphs.find_map(|text| text.strip_prefix(NAMES).map(str::to_owned)).unwrap_or_default();
    (about, names)
}

/// docs/files.md has each file with its own first words; `OXMILL_FILES=accept` writes it.
#[test]
fn every_file_is_listed_with_its_own_words() {
    let mut text = String::from(
        "# Every file\n\nAfter this page you know where to look. What each file of `src/` and `boards/` is about, in its own first words, and names to look for in it. A test keeps this page true;\n\
         `OXMILL_FILES=accept cargo test --test architecture listed` writes it.\n\n\
         Where `src/controller/machine` and `src/controller/controller` have files of one name, the first is a state machine that gives orders and\n\
         never sees the controller; the second carries the orders out.\n",
    );
    let mut folders: BTreeMap<String, Vec<(String, String, String)>> = BTreeMap::new();
    for top in LISTED {
        for (file, source) in source::of_kinds(&root().join(top), &KINDS.map(|(kind, _)| kind)) {
            let path = format!("{top}/{}", file.display());
            let (about, names) = head_of(&file, &source);
            assert!(!about.is_empty(), "{path} does not say what it is about");
            let (folder, name) = path.rsplit_once('/').unwrap();
            folders.entry(folder.to_owned()).or_default().push((name.to_owned(), about, names));
        }
    }
    for (folder, files) in &folders {
        text += &format!("\n## {folder}\n\n| file | what it is about | names in it |\n|---|---|---|\n");
        for (name, about, names) in files {
            text += &format!("| `{name}` | {about} | {names} |\n");
        }
    }
    let page = root().join("docs/files.md");
    if std::env::var("OXMILL_FILES").is_ok_and(|value| value == "accept") {
        fs::write(&page, &text).unwrap();
    }
    let written = fs::read_to_string(&page).unwrap_or_default();
    assert!(written == text, "docs/files.md is not current: OXMILL_FILES=accept cargo test --test architecture listed");
}
