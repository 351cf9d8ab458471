//! Checks the pictures that the simulator draws. A page with such a picture has the command that draws it, and the
//! picture must be current.

use crate::measured::oxmill;
use crate::{all_pages, links, read, root, writes};
use std::collections::BTreeSet;
use std::fs;
use std::path::Path;

const COMMANDS: [&str; 2] = ["`oxmill plot ", "`cargo run --release -- plot "];

/// Returns the arguments of the `oxmill` commands that draw pictures of `docs/`.
fn drawing_commands(text: &str) -> Vec<Vec<String>> {
    let named = COMMANDS.iter().flat_map(|begin| text.split(begin).skip(1)).filter_map(|rest| rest.split_once('`'));
    let words =
        named.map(|(words, _)| ["plot"].into_iter().chain(words.split_whitespace()).map(str::to_owned).collect());
    words.filter(|words: &Vec<String>| words.last().is_some_and(|file| file.starts_with("docs/"))).collect()
}

/// Draws a picture into a temporary file and fails if it differs from the stored one. With `OXMILL_WRITE_DOCS`,
/// overwrites the stored picture instead.
fn draw(words: &[String]) {
    let (own, command) = words.split_last().expect("words");
    let own = root().join(own);
    let other = Path::new(env!("CARGO_TARGET_TMPDIR")).join(own.file_name().expect("a name"));
    let target = if writes() { &own } else { &other };
    let command: Vec<&str> = command.iter().map(String::as_str).chain(target.to_str()).collect();
    oxmill(&command);
    let [is, made] =
        [&own, target].map(|file| fs::read(file).unwrap_or_else(|error| panic!("{}: {error}", file.display())));
    assert!(is == made, "{} is out of date: OXMILL_WRITE_DOCS=1 cargo test --test book", own.display());
}

#[test]
fn pictures_are_what_the_simulator_draws() {
    let mut drawn = BTreeSet::new();
    for page in all_pages() {
        for words in drawing_commands(&read(&page)) {
            if drawn.insert(words.last().cloned().expect("a file")) {
                draw(&words);
            }
        }
    }
    let mut shown = BTreeSet::new();
    for page in all_pages() {
        for link in links(&read(&page)).iter().filter(|link| link.ends_with(".svg")) {
            let file = page.parent().expect("a folder").join(link).canonicalize().expect("a picture");
            shown.insert(file.strip_prefix(root()).expect("a picture of the tree").to_string_lossy().into_owned());
        }
    }
    drawn.extend(crate::drawings::paths());
    assert_eq!(shown, drawn, "pictures that are shown, and those that a command or the book's test draws");
    assert!(shown.len() > 4, "{shown:?}");
}

/// Screenshots differ between browsers. So this test only checks that each is a picture and is shown on a page. The
/// tests of the browser page check its contents.
#[test]
fn photographs_of_the_page_are_pictures_that_are_shown() {
    let shown: BTreeSet<String> =
        all_pages().iter().flat_map(|page| links(&read(page))).filter(|link| link.ends_with(".png")).collect();
    let mut seen = 0;
    for entry in fs::read_dir(root().join("docs/pictures")).expect("docs/pictures") {
        let path = entry.expect("an entry").path();
        if path.extension().is_some_and(|extension| extension == "png") {
            let name = path.file_name().expect("a name").to_string_lossy().into_owned();
            assert!(fs::read(&path).expect("a file").starts_with(b"\x89PNG"), "{name}");
            assert!(shown.iter().any(|link| link.ends_with(&name)), "no page shows {name}");
            seen += 1;
        }
    }
    assert!(seen > 1, "{seen}");
}
