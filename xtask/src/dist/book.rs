//! The book of a release: a self-contained copy of `docs/`, as HTML if mdBook is installed.

use super::archive::{self, Entry};
use super::{Failure, read, root, write};
use crate::{run, tree};
use std::fs;
use std::path::Path;
use std::process::Command;

/// Required version of mdBook; other versions produce different pages.
const MDBOOK: &str = "0.5.4";

/// The folder in the book for linked files from outside `docs/`.
const FILES: &str = "files";

/// Returns the kind of book, which becomes a part of its file name, and its files: `book` with HTML pages, or
/// `book-markdown` with Markdown pages on a machine without mdBook.
pub fn make() -> Result<(&'static str, Vec<Entry>), Failure> {
    let pages = root().join("target/book-pages");
    prepare(&pages)?;
    let install = format!("`cargo install --locked mdbook --version {MDBOOK}`");
    match mdbook() {
        Some(version) if version == MDBOOK => {
            let html = root().join("target/book");
            run(Command::new("mdbook").arg("build").arg(&pages).arg("--dest-dir").arg(&html))?;
            Ok(("book", archive::tree(&html)?))
        }
        Some(version) => Err(format!("the book is made by mdBook {MDBOOK}, and this is {version}: {install}")),
        None => {
            println!("no mdBook ({install}): the book is packed as Markdown, not as HTML");
            Ok(("book-markdown", archive::tree(&pages)?))
        }
    }
}

/// Returns the version of the installed mdBook, such as `0.5.4`; `None` if mdBook is not installed.
fn mdbook() -> Option<String> {
    let told = Command::new("mdbook").arg("--version").output().ok()?.stdout;
    Some(String::from_utf8_lossy(&told).trim().trim_start_matches("mdbook v").to_owned())
}

/// Writes the pages to a folder, with the files from outside `docs/` that they link to.
fn prepare(folder: &Path) -> Result<(), Failure> {
    tree::copy(&root().join("docs"), folder)?;
    let entries = fs::read_dir(folder).map_err(|error| format!("{}: {error}", folder.display()))?;
    let pages = entries.flatten().map(|entry| entry.path());
    for page in pages.filter(|path| path.extension().is_some_and(|ending| ending == "md")) {
        let (text, files) = inward(&String::from_utf8_lossy(&read(&page)?));
        write(&page, text.as_bytes())?;
        for file in files {
            let to = folder.join(FILES).join(&file);
            let made = to.parent().map_or(Ok(()), fs::create_dir_all);
            made.map_err(|error| format!("{}: {error}", to.display()))?;
            write(&to, &read(&root().join(&file))?)?;
        }
    }
    Ok(())
}

/// Changes the links of a page that lead out of `docs/`, so that they lead to copies in the book. Returns the changed
/// page, and the paths of the files to copy, relative to the workspace. A link to a Markdown file is replaced by the
/// file's name, because the links within that file would be broken in the book.
fn inward(page: &str) -> (String, Vec<String>) {
    let (mut text, mut files, mut rest) = (String::new(), Vec::new(), page);
    while let Some((before, from)) = rest.split_once("](../") {
        let (target, after) = from.split_once(')').unwrap_or((from, ""));
        text += before;
        let file = target.split('#').next().unwrap_or_default();
        if file.ends_with(".md") {
            if let Some(opening) = text.rfind('[') {
                text.remove(opening);
            }
            text += &format!(" (`{file}` of the sources)");
        } else {
            text += &format!("]({FILES}/{target})");
            files.push(file.to_owned());
        }
        rest = after;
    }
    (text + rest, files)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn links_out_of_the_book_lead_into_it() {
        let (text, files) = inward("A [x](../a/b.nc), [y](../R.md#part) and [z](c.md); [w](../d.rs#L1).");
        assert_eq!(text, "A [x](files/a/b.nc), y (`R.md` of the sources) and [z](c.md); [w](files/d.rs#L1).");
        assert_eq!(files, ["a/b.nc", "d.rs"]);
    }

    #[test]
    fn every_link_of_the_released_pages_leads_to_a_file_beside_them() {
        let folder = root().join("target/tmp/book-pages");
        fs::create_dir_all(&folder).unwrap();
        prepare(&folder).unwrap();
        let folder = folder.canonicalize().unwrap();
        let mut seen = 0;
        for page in fs::read_dir(&folder).unwrap().map(|entry| entry.unwrap().path()) {
            if page.extension().is_none_or(|ending| ending != "md") {
                continue;
            }
            let text = fs::read_to_string(&page).unwrap();
            let targets = text.split("](").skip(1).filter_map(|rest| rest.split([')', '#']).next());
            for target in targets.filter(|target| !target.contains("://") && !target.is_empty()) {
                let file = folder.join(target).canonicalize();
                let inside = file.is_ok_and(|file| file.starts_with(&folder));
                assert!(inside, "{} links to {target}", page.display());
                seen += 1;
            }
        }
        assert!(seen > 60, "{seen} links");
    }
}
