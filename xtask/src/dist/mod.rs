//! `cargo xtask dist`: makes all files of a release in `target/dist`, with checksums and bills of materials (lists of
//! the linked packages).

mod archive;
mod book;
mod reproducible;
mod sbom;

use crate::paths::{Compiler, cargo_without_paths};
use crate::{Failure, boards, image, root, run, web};
use archive::Entry;
use sbom::Sbom;
use sha2::{Digest, Sha256};
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

pub use reproducible::check;

/// Version of the release. All packages of the workspace have the same version as xtask.
const VERSION: &str = env!("CARGO_PKG_VERSION");
/// Text files that are packed beside the program.
const TEXTS: [&str; 4] = ["README.md", "CHANGELOG.md", "LICENSE-APACHE", "LICENSE-MIT"];
const PAGE: &str = "oxmill.html";
/// File of the web site that lists the firmware images on the site. The build of the page writes an empty list, which
/// [`make_page`] replaces.
const SITE_IMAGES: &str = "firmware.json";
const PROGRAM: &str = if cfg!(windows) { "oxmill.exe" } else { "oxmill" };

/// A part of a release: the files of one board, the program, the web page with its site, or the book.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Part {
    Board(&'static str),
    Program,
    Page,
    Book,
}

impl Part {
    /// Returns the parts with these names; `boards` stands for all boards. Without names, returns all parts.
    fn named(names: &[&str]) -> Result<Vec<Part>, Failure> {
        // Without QEMU's board, which cannot be flashed.
        let boards = || boards::with_hardware().map(Part::Board);
        let mut parts = Vec::new();
        for name in if names.is_empty() { &["boards", "program", "page", "book"] } else { names } {
            match *name {
                "boards" => parts.extend(boards()),
                "program" => parts.push(Part::Program),
                "page" => parts.push(Part::Page),
                "book" => parts.push(Part::Book),
                name => match boards().find(|part| matches!(part, Part::Board(board) if *board == name)) {
                    Some(board) => parts.push(board),
                    None => return Err(format!("there is no part `{name}` of a release")),
                },
            }
        }
        Ok(parts)
    }

    fn make(self, folder: &Path, compiler: &Compiler) -> Result<(), Failure> {
        match self {
            Part::Board(board) => make_board(board, folder, compiler),
            Part::Program => make_program(folder, compiler),
            Part::Page => make_page(folder, compiler),
            Part::Book => make_book(folder),
        }
    }
}

fn folder() -> PathBuf {
    root().join("target/dist")
}

/// Rejects a tag that does not match this version.
pub fn tagged(tag: &str) -> Result<(), Failure> {
    if tag.strip_prefix('v') == Some(VERSION) {
        Ok(())
    } else {
        Err(format!("the tag `{tag}` is not that of version {VERSION}, v{VERSION}"))
    }
}

/// `cargo xtask dist`: makes the named parts, or all parts if `names` is empty. Deletes the files of earlier runs.
pub fn make(names: &[&str]) -> Result<(), Failure> {
    let mut parts = Part::named(names)?;
    // The page is made last, because its site includes the images of the boards.
    parts.sort_by_key(|part| *part == Part::Page);
    let compiler = Compiler::found()?;
    let folder = folder();
    if folder.exists() {
        fs::remove_dir_all(&folder).map_err(|error| format!("{}: {error}", folder.display()))?;
    }
    fs::create_dir_all(&folder).map_err(|error| format!("{}: {error}", folder.display()))?;
    parts.iter().try_for_each(|part| part.make(&folder, &compiler))?;
    let made = files(&folder)?;
    // Several computers with different systems make the parts of one release. So each writes its own list of checksums,
    // named after its system.
    write(&folder.join(format!("SHA256SUMS-{}.txt", compiler.host)), sums(&made).as_bytes())?;
    println!("{} files and their checksums in {}", made.len(), folder.display());
    Ok(())
}

fn make_board(board: &'static str, folder: &Path, compiler: &Compiler) -> Result<(), Failure> {
    let image = image::build(board)?;
    println!("{image}");
    for from in [&image.path].into_iter().chain(&image.files) {
        let to = folder.join(from.file_name().unwrap_or_default());
        fs::copy(from, &to).map_err(|error| format!("{}: {error}", to.display()))?;
        if to.extension().is_some_and(|ending| ending == "dfu") {
            check_suffix(&to)?;
        }
    }
    Sbom::of_board(board).write(compiler, &folder.join(format!("{board}.cdx.json")))
}

/// Checks the suffix (signature and checksum) of a `.dfu` file with `dfu-suffix`, a program of dfu-util.
fn check_suffix(path: &Path) -> Result<(), Failure> {
    let checked = Command::new("dfu-suffix").arg("--check").arg(path).output();
    let checked = checked.map_err(|error| format!("dfu-suffix, part of Debian's package dfu-util: {error}"))?;
    if checked.status.success() {
        return Ok(());
    }
    Err(format!("dfu-util refuses {}: {}", path.display(), String::from_utf8_lossy(&checked.stderr)))
}

fn make_program(folder: &Path, compiler: &Compiler) -> Result<(), Failure> {
    run(cargo_without_paths()?.args(["build", "--release", "--locked", "--package", "oxmill"]))?;
    web::build()?;
    let page = read(&root().join("target/web").join(PAGE))?;
    let entries = beside_program(read(&root().join("target/release").join(PROGRAM))?, page)?;
    let name = program_name(&compiler.host);
    write(&folder.join(format!("{name}.tar.gz")), &archive::packed(&name, entries)?)?;
    Sbom::of_program(&compiler.host).write(compiler, &folder.join(format!("{name}.cdx.json")))
}

/// Returns the contents of the program's archive: program, page (which `serve --web` looks for beside the program), and
/// texts.
fn beside_program(program: Vec<u8>, page: Vec<u8>) -> Result<Vec<Entry>, Failure> {
    let mut entries = vec![Entry::program(PROGRAM, program), Entry::text(PAGE, page)];
    for text in TEXTS {
        entries.push(Entry::text(text, read(&root().join(text))?));
    }
    Ok(entries)
}

/// Returns the name of the program's archive, in the form that `cargo binstall` expects.
fn program_name(target: &str) -> String {
    format!("oxmill-{VERSION}-{target}")
}

fn make_page(folder: &Path, compiler: &Compiler) -> Result<(), Failure> {
    web::build()?;
    for name in [PAGE, "oxmill.wasm"] {
        write(&folder.join(name), &read(&root().join("target/web").join(name))?)?;
    }
    let name = format!("oxmill-{VERSION}-site");
    let mut site = archive::tree(&root().join("target/web/site"))?;
    let images = site_images(boards::with_hardware().map(boards::described), folder)?;
    site.retain(|entry| images.iter().all(|image| image.name() != entry.name()));
    site.extend(images);
    write(&folder.join(format!("{name}.tar.gz")), &archive::packed(&name, site)?)?;
    Sbom::of_page().write(compiler, &folder.join("oxmill-page.cdx.json"))
}

/// Returns the files that the site carries: the image of each board with USB, if `folder` has it, and the list of these
/// images. A browser can load only these, because it reaches the boot loader in the chip's ROM through the USB socket.
fn site_images(
    boards: impl Iterator<Item = Result<oxmill_tables::Board, Failure>>,
    folder: &Path,
) -> Result<Vec<Entry>, Failure> {
    let (mut entries, mut list) = (Vec::new(), Vec::new());
    for board in boards {
        let board = board?;
        let path = folder.join(format!("{}.dfu", board.name));
        if board.image.has_usb && path.exists() {
            let file = format!("firmware/{}.dfu", board.name);
            entries.push(Entry::text(&file, read(&path)?));
            list.push(serde_json::json!({ "board": board.name, "title": board.title }));
        }
    }
    println!("the site carries the images of {} boards", list.len());
    let list = serde_json::to_vec_pretty(&list).map_err(|error| error.to_string())?;
    entries.push(Entry::text(SITE_IMAGES, list));
    Ok(entries)
}

fn make_book(folder: &Path) -> Result<(), Failure> {
    let (kind, entries) = book::make()?;
    let name = format!("oxmill-{VERSION}-{kind}");
    write(&folder.join(format!("{name}.tar.gz")), &archive::packed(&name, entries)?)
}

/// Returns name and contents of all files of a folder, sorted; the folder must contain no folders.
fn files(folder: &Path) -> Result<Vec<(String, Vec<u8>)>, Failure> {
    let entries = fs::read_dir(folder).map_err(|error| format!("{}: {error}", folder.display()))?;
    let mut paths: Vec<PathBuf> = entries.flatten().map(|entry| entry.path()).collect();
    paths.sort();
    let name = |path: &Path| path.file_name().unwrap_or_default().to_string_lossy().into_owned();
    paths.iter().map(|path| Ok((name(path), read(path)?))).collect()
}

/// Returns checksums in the format of `sha256sum --check`.
fn sums(files: &[(String, Vec<u8>)]) -> String {
    files.iter().map(|(name, bytes)| format!("{}  {name}\n", hex(&Sha256::digest(bytes)))).collect()
}

fn hex(bytes: &[u8]) -> String {
    bytes.iter().map(|byte| format!("{byte:02x}")).collect()
}

fn read(path: &Path) -> Result<Vec<u8>, Failure> {
    fs::read(path).map_err(|error| format!("{}: {error}", path.display()))
}

fn write(path: &Path, bytes: &[u8]) -> Result<(), Failure> {
    fs::write(path, bytes).map_err(|error| format!("{}: {error}", path.display()))
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::{BTreeMap, BTreeSet};
    use std::io::Read;

    #[test]
    fn parts_have_names() {
        let all = Part::named(&[]).unwrap();
        assert_eq!(all.len(), boards::with_hardware().count() + 3);
        assert_eq!(Part::named(&["book", "nucleo_f446re"]).unwrap(), [Part::Book, Part::Board("nucleo_f446re")]);
        assert!(Part::named(&[crate::QEMU_BOARD]).is_err());
        assert!(Part::named(&["rest"]).is_err());
    }

    #[test]
    fn only_the_tag_of_this_version_is_taken() {
        tagged(&format!("v{VERSION}")).unwrap();
        for other in [VERSION, "v0.0.1", "main", ""] {
            assert!(tagged(other).is_err(), "{other}");
        }
    }

    /// The checksum of "abc" is an example of FIPS 180-4.
    #[test]
    fn checksums_are_those_of_sha256sum() {
        let sum = "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad";
        assert_eq!(sums(&[("a.hex".into(), b"abc".to_vec())]), format!("{sum}  a.hex\n"));
    }

    #[test]
    fn binstall_looks_for_the_archive_that_is_made() {
        let manifest: toml::Table = fs::read_to_string(root().join("Cargo.toml")).unwrap().parse().unwrap();
        let binstall = &manifest["package"]["metadata"]["binstall"];
        let filled = |key: &str| {
            let text = binstall[key].as_str().unwrap().replace("{ version }", VERSION).replace("{ target }", "TARGET");
            text.replace("{ bin }", "oxmill").replace("{ binary-ext }", ".exe")
        };
        let name = program_name("TARGET");
        assert!(filled("pkg-url").ends_with(&format!("/v{VERSION}/{name}.tar.gz")), "{}", filled("pkg-url"));
        assert_eq!(filled("bin-dir"), format!("{name}/oxmill.exe"));
        assert_eq!(binstall["pkg-fmt"].as_str(), Some("tgz"));
    }

    /// `serve --web` looks for the page in the folder of the program.
    #[test]
    fn the_page_is_beside_the_program() {
        let packed = archive::packed("oxmill", beside_program(b"run".to_vec(), b"page".to_vec()).unwrap()).unwrap();
        let mut archive = tar::Archive::new(flate2::read::GzDecoder::new(&packed[..]));
        let mut texts = BTreeMap::new();
        for entry in archive.entries().unwrap() {
            let mut entry = entry.unwrap();
            let (name, mut text) = (entry.path().unwrap().to_string_lossy().into_owned(), String::new());
            entry.read_to_string(&mut text).unwrap();
            texts.insert(name, text);
        }
        assert_eq!((&*texts[&format!("oxmill/{PROGRAM}")], &*texts["oxmill/oxmill.html"]), ("run", "page"));
        assert!(texts["oxmill/LICENSE-MIT"].contains("MIT License"), "{:?}", texts.keys());
    }

    /// The Nucleo's USB socket belongs to its debug probe, so its image is left out. The folder has no image of the
    /// F401.
    #[test]
    fn the_site_carries_the_images_that_a_browser_can_load() {
        let folder = root().join("target/xtask-test-site-images");
        fs::create_dir_all(&folder).unwrap();
        for board in ["blackpill_f411", "nucleo_f446re"] {
            write(&folder.join(format!("{board}.dfu")), board.as_bytes()).unwrap();
        }
        let boards = ["nucleo_f446re", "blackpill_f411", "blackpill_f401"].map(boards::described);
        let packed = archive::packed("site", site_images(boards.into_iter(), &folder).unwrap()).unwrap();
        let mut archive = tar::Archive::new(flate2::read::GzDecoder::new(&packed[..]));
        let mut files = BTreeMap::new();
        for entry in archive.entries().unwrap() {
            let (mut entry, mut text) = (entry.unwrap(), String::new());
            entry.read_to_string(&mut text).unwrap();
            files.insert(entry.path().unwrap().to_string_lossy().into_owned(), text);
        }
        let list: serde_json::Value = serde_json::from_str(&files[&format!("site/{SITE_IMAGES}")]).unwrap();
        let title = boards::described("blackpill_f411").unwrap().title;
        let wanted = serde_json::json!([{ "board": "blackpill_f411", "title": title }]);
        assert_eq!(list, wanted);
        assert_eq!(files["site/firmware/blackpill_f411.dfu"], "blackpill_f411");
        assert_eq!(files.len(), 2);
        fs::remove_dir_all(&folder).unwrap();
    }

    #[test]
    fn the_changelog_has_this_version() {
        let text = fs::read_to_string(root().join("CHANGELOG.md")).unwrap();
        assert!(text.lines().any(|line| line.starts_with(&format!("## {VERSION} - "))));
    }

    /// All commands that the workflows run.
    const CALLED: [&str; 14] = [
        "bash .ci/run",
        "cargo xtask dist program",
        "cargo xtask dist --tag \"$GITHUB_REF_NAME\" program",
        "cargo xtask dist --tag \"$GITHUB_REF_NAME\" --check",
        "cargo install --locked cargo-deny --version 0.20.2",
        "cargo install --locked mdbook --version 0.5.4 --no-default-features --features search",
        "rustup target add thumbv7em-none-eabihf wasm32-unknown-unknown",
        "rustup toolchain install 1.95.0 --profile minimal --target wasm32-unknown-unknown",
        "apt-get update && apt-get install --yes --no-install-recommends dfu-util nodejs npm",
        "gh release create \"$GITHUB_REF_NAME\" --draft --verify-tag --title \"Oxmill $GITHUB_REF_NAME\" \
         --notes \"What is new - CHANGELOG.md. How to check and flash it - docs/release.md.\" dist/*",
        "gh release download \"$GITHUB_REF_NAME\" --pattern \"oxmill-*-site.tar.gz\" --pattern \"oxmill-*-book.tar.gz\"",
        "mkdir --parents site/book",
        "tar --extract --file oxmill-*-site.tar.gz --directory site --strip-components 1",
        "tar --extract --file oxmill-*-book.tar.gz --directory site/book --strip-components 1",
    ];

    /// A workflow runs only commands that a person can run by hand, too. Every action is pinned to a commit, so its
    /// code cannot change.
    #[test]
    fn workflows_call_only_what_can_be_called_by_hand() {
        let mut called = BTreeSet::new();
        for entry in fs::read_dir(root().join(".github/workflows")).unwrap().flatten() {
            let (path, text) = (entry.path(), fs::read_to_string(entry.path()).unwrap());
            assert!(text.contains("\npermissions:\n  contents: read\n"), "{}", path.display());
            for line in text.lines().map(|line| line.trim().trim_start_matches("- ")) {
                if let Some(command) = line.strip_prefix("run: ") {
                    assert!(CALLED.contains(&command), "{}: {command}", path.display());
                    called.insert(command.to_owned());
                } else if let Some(action) = line.strip_prefix("uses: ") {
                    let commit = action.split(['@', ' ']).nth(1).unwrap_or_default();
                    let pinned = commit.len() == 40 && commit.chars().all(|c| c.is_ascii_hexdigit());
                    assert!(pinned, "{}: {action} is not pinned", path.display());
                }
            }
        }
        assert_eq!(called, CALLED.map(str::to_owned).into());
    }
}
