//! Checks that the commands in the pages exist, with their arguments.

use crate::{all_pages, fence, fences, read, root};
use clap::Parser;
use clap::error::ErrorKind;
use oxmill_simulator::command_line::CommandLine;
use oxmill_tables::BOARDS;

/// Cargo's own commands that the pages use.
const OF_CARGO: [&str; 9] = ["bench", "binstall", "build", "clippy", "deny", "install", "mutants", "package", "test"];
/// Programs that the pages use, other than `oxmill`, `cargo`, and the interpreters of scripts (bash, node, python).
const OF_OTHERS: [&str; 9] = ["dfu-util", "git", "ls", "mdbook", "printf", "rustup", "stty", "timeout", "wait"];

/// A command that a page shows or names, split into words.
struct Command<'a> {
    words: Vec<&'a str>,
    /// `true` if the page shows the command as a line to type. `false` if the text only names the command: then
    /// arguments can be missing.
    whole: bool,
}

/// Parses a command line, without prompt, variables, comments and redirections.
fn command(line: &str, whole: bool) -> Command<'_> {
    let line = line.split(" #").next().unwrap_or_default().split(['>', '|']).next().unwrap_or_default();
    let is_variable = |word: &&str| word.contains('=') && word.starts_with(|c: char| c.is_ascii_uppercase());
    let words = line.trim_start_matches("$ ").split_whitespace().skip_while(is_variable);
    Command { words: words.filter(|word| !word.starts_with(['…', '[']) && *word != "...").collect(), whole }
}

/// Passes each command of a page to `seen`: the lines of shell fences, and the commands named in the text.
fn commands(text: &str, mut seen: impl FnMut(Command<'_>)) {
    for (_, lines) in fences(text).iter().filter(|(kind, _)| kind == "sh") {
        lines
            .iter()
            .filter(|line| !line.is_empty() && !line.starts_with('#'))
            .for_each(|line| seen(command(line, true)));
    }
    for (_, lines) in fences(text).iter().filter(|(kind, _)| kind == "console") {
        lines.iter().filter(|line| line.starts_with("$ ")).for_each(|line| seen(command(line, true)));
    }
    let mut in_fence = false;
    for line in text.lines() {
        in_fence ^= fence(line).is_some();
        let named = line.split('`').skip(1).step_by(2).map(|words| command(words, false));
        let programs = ["oxmill", "cargo", "bash", "python", "python3"];
        named
            .filter(|named| !in_fence && named.words.len() > 1 && programs.contains(&named.words[0]))
            .for_each(&mut seen);
    }
}

/// Returns an example value for a placeholder, such as `1` for `PORT`. Other words stay as they are.
fn filled_in(word: &str) -> String {
    match word {
        "N" | "PORT" | "OPERATIONS" => "1",
        "NAME" | "BOARD" => "blackpill_f411",
        "SHELL" => "bash",
        "ADDR:PORT" => "127.0.0.1:0",
        _ => word,
    }
    .to_owned()
}

/// Returns what is wrong with a command line of `oxmill`.
fn fault_of_oxmill(words: &[&str], whole: bool) -> Option<String> {
    let words: Vec<String> = words.iter().map(|word| filled_in(word)).collect();
    let error = CommandLine::try_parse_from(words).err()?;
    // A command that a page only names (`whole` is false) may lack arguments.
    let is_short = matches!(
        error.kind(),
        ErrorKind::MissingRequiredArgument
            | ErrorKind::InvalidValue
            | ErrorKind::DisplayHelpOnMissingArgumentOrSubcommand
    );
    (whole || !is_short).then(|| error.to_string())
}

fn fault_of_test(words: &[&str]) -> Option<String> {
    let names = words.windows(2).filter(|pair| pair[0] == "--test").map(|pair| pair[1]);
    let exists = |name: &str| {
        ["tests/NAME.rs", "tests/NAME/main.rs"].iter().any(|at| root().join(at.replace("NAME", name)).exists())
    };
    names.filter(|name| *name != "NAME").find(|name| !exists(name)).map(|name| format!("there is no test `{name}`"))
}

/// Returns an error for the first option that no file of `xtask` contains.
fn fault_of_flags(words: &[&str]) -> Option<String> {
    let files =
        std::fs::read_dir(root().join("xtask/src")).expect("xtask").map(|entry| entry.expect("an entry").path());
    let sources: String = files.filter(|path| path.is_file()).map(|path| read(&path)).collect();
    let unknown = words.iter().find(|word| word.starts_with("--") && !sources.contains(&format!("\"{word}\"")));
    unknown.map(|word| format!("no task knows {word}"))
}

/// Returns what is wrong with a command line of `cargo`. The line has at least two words.
fn fault_of_cargo(words: &[&str], whole: bool) -> Option<String> {
    let aliases = read(&root().join(".cargo/config.toml"));
    let tasks = read(&root().join("xtask/src/main.rs"));
    let task = |name: &str| {
        let is_task = tasks.contains(&format!("[\"{name}\""));
        if is_task { fault_of_flags(words) } else { Some(format!("there is no task `{name}`")) }
    };
    match words {
        ["run", "--release", "--", rest @ ..] => fault_of_oxmill(&[&["oxmill"], rest].concat(), whole),
        ["xtask", name, ..] => task(name),
        ["test", rest @ ..] => fault_of_test(rest),
        ["fw" | "flash-board", board, ..] if *board != "BOARD" && !BOARDS.iter().any(|(name, _)| name == board) => {
            Some(format!("there is no board `{board}`"))
        }
        [name, ..] if aliases.contains(&format!("{name} = \"xtask {name}\"")) => task(name),
        [name, ..] => (!OF_CARGO.contains(name)).then(|| format!("there is no `cargo {name}`")),
        [] => None,
    }
}

fn fault(command: &Command) -> Option<String> {
    match command.words[..] {
        ["oxmill", ..] => fault_of_oxmill(&command.words, command.whole),
        ["cargo", ref words @ ..] => fault_of_cargo(words, command.whole),
        ["bash" | "node" | "python" | "python3", file, ..] => {
            (!root().join(file).exists()).then(|| format!("there is no file `{file}`"))
        }
        [program, ..] => (!OF_OTHERS.contains(&program)).then(|| format!("there is no program `{program}`")),
        [] => None,
    }
}

#[test]
fn commands_of_the_pages_exist() {
    let mut seen = [0, 0];
    for page in all_pages() {
        commands(&read(&page), |command| {
            let fault = fault(&command);
            assert!(fault.is_none(), "{}: {}: {}", page.display(), command.words.join(" "), fault.unwrap_or_default());
            seen[usize::from(command.whole)] += 1;
        });
    }
    assert!(seen[0] > 60 && seen[1] > 20, "{seen:?} commands");
}

/// Checks the check itself: it must find these faults.
#[test]
fn commands_that_do_not_exist_are_seen() {
    for line in [
        "oxmill chekc a.nc",
        "oxmill run a.nc --polt a.svg",
        "cargo run --release -- serve",
        "cargo xtask benhc",
        "cargo test-target nucleo_f446re --no-rnu",
        "cargo fw blackpill_f412",
        "cargo flash blackpill_f411",
        "cargo test --test boook",
        "python3 tests/senders/none.py",
        "oxmil run a.nc",
    ] {
        assert!(fault(&command(line, true)).is_some(), "{line}");
    }
}
