//! Checks the documents against the code: the files, functions and modules that they name exist.

use crate::{root, source};
use std::fs;

fn document(name: &str) -> String {
    fs::read_to_string(root().join("docs").join(name)).unwrap_or_else(|error| panic!("docs/{name}: {error}"))
}

/// Returns the rows of all tables, as cells.
fn rows(text: &str) -> impl Iterator<Item = Vec<&str>> {
    text.lines()
        .filter(|line| line.starts_with('|') && !line.starts_with("|---"))
        .map(|line| line.trim_start_matches('|').trim_end_matches('|').split('|').map(str::trim).collect())
}

/// Returns the texts between backticks.
fn quoted(text: &str) -> impl Iterator<Item = &str> {
    text.split('`').skip(1).step_by(2)
}

/// Returns the names of the functions of a file, including those that a macro makes.
fn functions(file: &str) -> Vec<String> {
    let text = fs::read_to_string(root().join(file)).unwrap_or_else(|error| panic!("{file}: {error}"));
    let tokens = source::lex(&source::bare(&text));
    tokens.windows(2).filter(|pair| pair[0] == "fn").map(|pair| pair[1].clone()).collect()
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

/// Each row of the glossary has five cells, and no term has two rows.
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
            let is_room = path.is_dir() && folder == "src/controller" || path.join("main.rs").exists();
            let has_code = is_room && name != "tests";
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

/// A test file that `main.rs` does not declare as a module would not be compiled, without any message.
#[test]
fn every_file_of_tests_is_in_its_program() {
    let folder = root().join("src/controller/tests");
    let program = fs::read_to_string(folder.join("main.rs")).expect("the program");
    let mut seen = 0;
    for entry in fs::read_dir(&folder).unwrap() {
        let name = entry.unwrap().file_name().to_string_lossy().into_owned();
        if let Some(name) = name.strip_suffix(".rs").filter(|name| *name != "main") {
            assert!(program.contains(&format!("mod {name};")), "src/controller/tests/main.rs does not name `{name}`");
            seen += 1;
        }
    }
    assert!(seen > 15, "{seen}");
}
