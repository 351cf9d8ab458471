//! Commands for the firmware: build it, flash it, run it in QEMU, test it, count instructions.
//!
//! The aliases `cargo fw`, `cargo flash-board`, `cargo qemu` and `cargo test-target` call this program.

mod boards;
mod count;
mod dfuse;
mod dist;
mod elf;
mod flashable;
mod fuzz;
mod image;
mod jobs;
mod live;
mod mutants;
mod package;
mod paths;
mod programs;
mod python;
mod qemu;
mod reach;
mod recordings;
mod rs274;
mod script;
mod sizes;
mod soak;
mod suites;
mod thumb;
mod tree;
mod virtual_board;
mod web;
mod witness;

use std::path::{Path, PathBuf};
use std::process::{Command, ExitCode};

/// Rust target of every board.
const TARGET: &str = "thumbv7em-none-eabihf";
/// Name of the board that QEMU emulates. It has no pin table.
const QEMU_BOARD: &str = "qemu_mps2";

const USAGE: &str = "\
usage:
  cargo xtask quick [NAME]   after a change: format, lints and unit tests of the controller, the store and the simulator; with NAME
                             only tests whose names contain it
  cargo fw BOARD             release build; prints the ELF file and its sizes, checks the image, and writes .hex and .dfu
  cargo flash-board BOARD    flash and log through a probe (needs cargo-embed, part of probe-rs-tools)
  cargo qemu [--job FILE]    the firmware on QEMU, serial on a TCP port that it prints; or one job from RAM
  cargo test-target [BOARD]  suites and firmware tests on QEMU; with a board, the suites on it through a probe;
                             with `--no-run` at the end the suites are only built
  cargo xtask bench-board BOARD  the suites on a board, then its pulses, measured over wires: docs/bench.md; also called `loopback`
  cargo xtask recordings [N..]  the recorded conversations on QEMU alone; or only some groups
  cargo xtask jobs           whole jobs through the firmware on QEMU alone, compared with the simulator
  cargo xtask converse       the conversations with the firmware on QEMU alone
  cargo xtask job NAME       writes a program of examples/ or a job of the benchmark to standard output
  cargo xtask bench [FILE..] job times, also of your own files: the table of docs/motion.md
  cargo xtask virtual [BOARD [CASE..]]  the unmodified STM32 images on an emulated STM32F4, every edge time-stamped (needs Python 3);
                             `--profile` behind a case: where its cycles went; `--reading NAME`: with the second reading of a fact that the
                             manuals leave open
  cargo xtask witness [--faults]  the firmware on an emulator by other hands, belief by belief; with `--faults` wrong ones, which have to be
                             seen (needs Python 3)
  cargo xtask soak qemu|BOARD [--minutes N|--seconds N] [--wall N] [--seed N]  a job with holds, overrides, resets and hosts that come and go, so
                             long in machine time, in QEMU or on a virtual board: every step accounted for, and the deepest stack
  cargo xtask web            the page, target/web/oxmill.html (needs Node.js and the target wasm32-unknown-unknown);
                             `--test [NAME..]` tries it in headless Chromium (needs Debian's package chromium);
                             `--pictures` takes the screenshots of the README
  cargo xtask mutants [NAME..]  named faults of motion, link and filter, each of which the tests have to see; some minutes
  cargo xtask count [small]  what a tick, a block, a segment, a line cost, in instructions and estimated cycles, on QEMU;
                             `small`: in images that are built for size
  cargo xtask fuzz [--seconds N|--minutes N|--hours N|--executions N [--seed S]] [TARGET..]  coverage-guided fuzzing of tests/fuzz, 300 s for all targets
                             together, or so many executions of inputs that are short;
                             `fuzz --list` names the targets, `fuzz minimise` keeps in the tree what reaches most (needs a C++ compiler)
  cargo xtask dist [--tag TAG] [--check] [PART..]  what a release has, in target/dist: docs/release.md. PART is a board, `boards`,
                             `program`, `page` or `book`, all if none is named; `--check` builds it on two paths and compares
  cargo xtask package        the crates as `cargo package` makes them, and what is in each; `package --build` builds from them
  cargo xtask rs274 [N [SEED]]  N random programs (10,000) through Oxmill's interpreter and LinuxCNC's, compared
  cargo xtask rs274 files FOLDER...  the .ngc programs below these folders, whole, in the same way
  cargo xtask count profile ROW  in which functions a row of it (`line`, `text`, ...) spends them
boards: ";

/// Environment variable that names the board whose pin table the firmware's build script puts into the image.
const BOARD: &str = "OXMILL_BOARD";

/// Error message for the user.
type Failure = String;

fn main() -> ExitCode {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let words: Vec<&str> = arguments.iter().map(String::as_str).collect();
    let done = match words[..] {
        ["quick", ref names @ ..] => quick(names),
        ["fw", board] => known(board).and_then(|board| image::build(board).map(|image| println!("{image}"))),
        ["flash-board", board] => known(board).and_then(flash),
        ["qemu"] => qemu::serve(),
        ["qemu", "--job", file] => jobs::show(Path::new(file)),
        ["test-target"] => on_qemu(),
        ["test-target", QEMU_BOARD] => on_qemu(),
        ["test-target", "--no-run"] => suites::build(QEMU_BOARD),
        ["test-target", board, "--no-run"] => known(board).and_then(suites::build),
        ["test-target", board] => known(board).and_then(suites::on_board),
        ["bench-board" | "loopback", board] => known(board).and_then(suites::bench),
        ["recordings", ref groups @ ..] => recordings::replay_all(groups),
        ["converse"] => live::all(),
        ["jobs"] => jobs::compare_all(),
        ["job", name] => generate(name),
        ["virtual"] => virtual_board::check(None, &[]),
        ["virtual", board, ref cases @ ..] => virtual_board::check(Some(board), cases),
        ["witness"] => witness::witness(&[]),
        ["witness", "--faults"] => witness::witness(&["--faults"]),
        ["soak", ref arguments @ ..] => soak::run(arguments),
        ["web"] => web::build(),
        ["web", "--test", ref names @ ..] => web::test(names),
        ["web", "--pictures"] => web::pictures(),
        ["mutants", ref names @ ..] => mutants::run(names),
        ["fuzz", ref arguments @ ..] => fuzz::fuzz(arguments),
        ["dist", "--check", ref parts @ ..] => dist::check(parts),
        ["dist", "--tag", tag, "--check", ref parts @ ..] => dist::tagged(tag).and_then(|()| dist::check(parts)),
        ["dist", "--tag", tag, ref parts @ ..] => dist::tagged(tag).and_then(|()| dist::make(parts)),
        ["dist", ref parts @ ..] => dist::make(parts),
        ["package"] => package::list(),
        ["package", "--build"] => package::build(),
        ["rs274", ref arguments @ ..] => rs274::run(arguments),
        ["count"] => count::count(boards::FAST),
        ["count", "small"] => count::count(boards::profile(boards::SMALL[0])),
        ["count", "profile", row] => count::profile(row),
        ["bench", ref files @ ..] => bench(files),
        _ => {
            eprintln!("{USAGE}{}", board_names());
            return ExitCode::from(2);
        }
    };
    match done {
        Ok(()) => ExitCode::SUCCESS,
        Err(why) => {
            eprintln!("{why}");
            ExitCode::FAILURE
        }
    }
}

/// Checks a change: the format, and the lints and unit tests of the packages that change most. Takes less than a minute
/// if their dependencies have been built. `names` is empty or has one text: then only tests whose names contain it run.
fn quick(names: &[&str]) -> Result<(), Failure> {
    let rooms = ["--package=oxmill-controller", "--package=oxmill-store", "--package=oxmill-simulator"];
    run(cargo().args(["fmt", "--all", "--check"]))?;
    run(cargo().args(["clippy", "--quiet", "--lib"]).args(rooms).args(["--", "-D", "warnings"]))?;
    run(cargo().args(["test", "--quiet", "--lib"]).args(rooms).args(names))
}

/// `cargo test-target`: runs all tests of the firmware on QEMU.
fn on_qemu() -> Result<(), Failure> {
    suites::on_qemu()?;
    live::all()?;
    recordings::replay_all(&[])?;
    jobs::compare_all()
}

fn board_names() -> String {
    boards::names().collect::<Vec<_>>().join(", ")
}

/// Returns `board` if there is a board of this name, otherwise an error with the names of all boards.
fn known(board: &str) -> Result<&str, Failure> {
    if boards::names().any(|name| name == board) {
        Ok(board)
    } else {
        Err(format!("there is no board `{board}`; there are {}", board_names()))
    }
}

/// Runs the benchmark in the workspace; `files` are relative to the current folder.
fn bench(files: &[&str]) -> Result<(), Failure> {
    let files: Result<Vec<PathBuf>, _> = files.iter().map(std::path::absolute).collect();
    let files = files.map_err(|error| error.to_string())?;
    run(cargo().args(["bench", "--quiet", "--locked", "--bench", "motion", "--"]).args(files))
}

/// Writes the program of `examples/` or the job of the benchmark with this name to standard output.
fn generate(name: &str) -> Result<(), Failure> {
    match programs::generate(name, &mut std::io::stdout().lock()) {
        Ok(true) => Ok(()),
        Ok(false) => {
            let names = [programs::NAMES, programs::bench::NAMES].concat().join(", ");
            Err(format!("there is no program `{name}`; there are {names}"))
        }
        Err(error) => Err(format!("the program could not be written: {error}")),
    }
}

/// Environment variable with the path of a copy of the tree, set by `dist --check`. This program then works in the
/// copy.
const TREE: &str = "OXMILL_TREE";

/// Returns the root folder of the workspace, or of the copy that [`TREE`] names.
fn root() -> PathBuf {
    if let Some(tree) = std::env::var_os(TREE) {
        return tree.into();
    }
    Path::new(env!("CARGO_MANIFEST_DIR")).parent().expect("xtask lies in the workspace").to_owned()
}

/// Returns a cargo command that runs in the workspace and always builds into `target`, whatever the environment says.
/// This program looks for the results in `target`. If cargo built elsewhere, this program would take the results of an
/// earlier build for new ones.
fn cargo() -> Command {
    let mut cargo = Command::new(std::env::var_os("CARGO").unwrap_or_else(|| "cargo".into()));
    cargo.current_dir(root()).env("CARGO_TARGET_DIR", root().join("target")).env_remove("CARGO_BUILD_TARGET");
    cargo
}

fn run(command: &mut Command) -> Result<(), Failure> {
    let name = command.get_program().to_string_lossy().into_owned();
    match command.status() {
        Ok(status) if status.success() => Ok(()),
        Ok(status) => Err(format!("`{name}` failed: {status}")),
        Err(error) => Err(format!("`{name}` cannot be started: {error}")),
    }
}

/// Returns `true` if a program can be started with `--version`, with any exit status.
fn exists(program: &str) -> bool {
    Command::new(program).arg("--version").output().is_ok()
}

fn flash(board: &str) -> Result<(), Failure> {
    println!("{}", image::build(board)?);
    if !exists("cargo-embed") {
        return Err("cargo-embed is missing: `cargo install --locked probe-rs-tools`".into());
    }
    let mut embed = paths::cargo_for_boards("embed", boards::profile(board))?;
    embed.env(BOARD, board);
    run(embed.args(["--package", "oxmill-firmware", "--features", boards::image(board), board]))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cargo_builds_where_the_files_are_looked_for() {
        let cargo = cargo();
        let value = |name: &str| cargo.get_envs().find(|(key, _)| *key == name).map(|(_, value)| value);
        assert_eq!(value("CARGO_TARGET_DIR"), Some(Some(root().join("target").as_os_str())));
        assert_eq!(value("CARGO_BUILD_TARGET"), Some(None));
    }
}
