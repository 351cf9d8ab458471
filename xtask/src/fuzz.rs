//! Coverage-guided fuzzing with libFuzzer: builds `tests/fuzz` with the compiler's coverage counters, which every Rust
//! compiler has.
//!
//! Inputs with new coverage are kept in `target/fuzz/corpus`, those that violate an invariant in `target/fuzz/found`.

use crate::{Failure, cargo, root, run};
use oxmill_test_support::{pack, unpack};
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::Mutex;

/// Compiler flags for the fuzz targets. A compiler pass adds a counter to each edge (a way from one piece of code to
/// the next), and libFuzzer reads these counters. The pass also adds a call to each edge: `tests/fuzz/work.c` counts
/// these calls, so that a target can limit its work.
const COVERAGE: &str = "-Cpasses=sancov-module -Cllvm-args=-sanitizer-coverage-level=4 \
    -Cllvm-args=-sanitizer-coverage-inline-8bit-counters -Cllvm-args=-sanitizer-coverage-pc-table \
    -Cllvm-args=-sanitizer-coverage-trace-pc -Clink-arg=-Wl,--wrap=__sanitizer_cov_trace_pc -Ccodegen-units=1";
/// Optional flags: record the values on both sides of each comparison. With them libFuzzer finds values that random
/// inputs would miss, but recording takes two thirds of the run time.
const COMPARISONS: &str = " -Cllvm-args=-sanitizer-coverage-trace-compares";
/// Minimum number of edges that a working target reaches; with fewer the run fails.
const LEAST_EDGES: u64 = 100;
/// Maximum input length, bytes, in a search that is limited by time.
const LONGEST: u64 = 2048;
/// For a search that is limited by the number of executions. For each target: its share of all executions, in per
/// mille, and its maximum input length, bytes. A faster target has a larger share. Inputs are short, so that each
/// execution takes little time.
const SHARES: [(&str, u64, u64); 9] = [
    ("hosts", 320, 96),
    ("lines", 240, 128),
    ("usb", 220, 96),
    ("steps", 150, 128),
    ("stored", 50, 128),
    ("programs", 12, 192),
    ("events", 5, 384),
    ("settings", 1, 192),
    ("session", 2, 192),
];

/// Limit of a search: a time or a number of executions.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Amount {
    /// Number of seconds for all targets together, with [`COMPARISONS`] recorded.
    Seconds(u64),
    /// Number of executions for all targets together, without [`COMPARISONS`].
    Executions(u64),
    /// Number of executions, as in `Executions`, and the seed of the random numbers. Each search starts only from the
    /// corpora in `tests/fuzz`, so the run is the same on every machine.
    Repeated(u64, u64),
}

impl Amount {
    /// Returns libFuzzer's options for the part of the time or executions that `target` gets. `workers`: number of
    /// targets that run at the same time.
    fn options(self, target: &str, targets: &[&str], workers: u64) -> Vec<String> {
        match self {
            Amount::Seconds(seconds) => {
                let each = (seconds * workers / targets.len() as u64).max(1);
                vec![format!("-max_total_time={each}"), format!("-max_len={LONGEST}"), "-use_value_profile=1".into()]
            }
            Amount::Executions(all) | Amount::Repeated(all, _) => {
                let share = |target: &str| SHARES.iter().find(|(name, ..)| *name == target);
                let whole: u64 = targets.iter().filter_map(|target| share(target)).map(|(_, parts, _)| parts).sum();
                let (_, parts, longest) = share(target).copied().unwrap_or((target, 1, LONGEST));
                let mut options = vec![format!("-runs={}", all * parts / whole.max(1)), format!("-max_len={longest}")];
                if let Amount::Repeated(_, seed) = self {
                    options.push(format!("-seed={seed}"));
                }
                options
            }
        }
    }
}

/// Parses the arguments. Returns the amount, 300 s if none is given, and the names of the targets, empty for all
/// targets.
fn wanted<'a>(arguments: &'a [&'a str]) -> Result<(Amount, &'a [&'a str]), Failure> {
    let time = |count: &str, seconds: u64| number(count).map(|count| Amount::Seconds(count.saturating_mul(seconds)));
    Ok(match arguments {
        ["--hours", hours, targets @ ..] => (time(hours, 3600)?, targets),
        ["--minutes", minutes, targets @ ..] => (time(minutes, 60)?, targets),
        ["--seconds", seconds, targets @ ..] => (time(seconds, 1)?, targets),
        ["--executions", executions, "--seed", seed, targets @ ..] => {
            (Amount::Repeated(number(executions)?, number(seed)?), targets)
        }
        ["--executions", executions, targets @ ..] => (Amount::Executions(number(executions)?), targets),
        targets => (Amount::Seconds(300), targets),
    })
}

/// `cargo xtask fuzz [--seconds N|--minutes N|--hours N|--executions N [--seed S]] [TARGET..]`, `--list` or `minimise`.
pub fn fuzz(arguments: &[&str]) -> Result<(), Failure> {
    let all = all_targets()?;
    let all: Vec<&str> = all.iter().map(String::as_str).collect();
    let (amount, targets) = match arguments {
        ["--list"] => {
            println!("{}", all.join("\n"));
            return Ok(());
        }
        ["minimise"] => return minimise(),
        arguments => wanted(arguments)?,
    };
    let targets = if targets.is_empty() { &all[..] } else { targets };
    if let Some(unknown) = targets.iter().find(|target| !all.contains(target)) {
        return Err(format!("there is no target `{unknown}`; there are {}", all.join(", ")));
    }
    let program = build(matches!(amount, Amount::Seconds(_)))?;
    for target in targets {
        replay(&program, target)?;
    }
    let workers = std::thread::available_parallelism().map_or(1, usize::from).min(targets.len());
    let left = Mutex::new(targets.iter());
    let rows = Mutex::new(Vec::new());
    std::thread::scope(|scope| {
        for _ in 0..workers {
            scope.spawn(|| {
                while let Some(target) = next(&left) {
                    let row = one(&program, target, amount, &amount.options(target, targets, workers as u64));
                    rows.lock().expect("no thread panics").push((*target, row));
                }
            });
        }
    });
    report(rows.into_inner().expect("no thread panics"))
}

/// First runs the inputs in `tests/fuzz`, in full length, because a search truncates long inputs. In this build, a
/// target also fails if one call does more work than is allowed. Then runs the inputs that earlier searches left in
/// `target/fuzz/found`. If such an input still fails, its fault has not been corrected; if it passes, it is deleted.
fn replay(program: &Path, target: &str) -> Result<(), Failure> {
    let mut inputs = files(&seeds(target)?)?;
    inputs.extend(files(&finds(target)?)?);
    let output = Command::new(program).env("OXMILL_FUZZ_TARGET", target).arg("-timeout=20").args(&inputs).output();
    let output = output.map_err(|error| error.to_string())?;
    if !output.status.success() {
        return Err(format!("{target} fails on inputs of the tree:\n{}", String::from_utf8_lossy(&output.stderr)));
    }
    for path in files(&folder("found", target)?)? {
        let output = Command::new(program).env("OXMILL_FUZZ_TARGET", target).arg("-timeout=20").arg(&path).output();
        let output = output.map_err(|error| error.to_string())?;
        if !output.status.success() {
            let text = String::from_utf8_lossy(&output.stderr);
            return Err(format!("{target} still fails on {}:\n{text}", path.display()));
        }
        fs::remove_file(&path).map_err(|error| format!("{}: {error}", path.display()))?;
    }
    Ok(())
}

fn next<'a>(left: &Mutex<std::slice::Iter<'a, &'a str>>) -> Option<&'a &'a str> {
    left.lock().expect("no thread panics").next()
}

fn number(text: &str) -> Result<u64, Failure> {
    text.parse().map_err(|_| format!("`{text}` is not a whole number"))
}

/// The result of the search on one target.
struct Row {
    executions: u64,
    /// Number of edges reached, from `cov:` in libFuzzer's output.
    edges: u64,
    /// Number of features reached, from `ft:` in libFuzzer's output. A feature is, for example, an edge with the
    /// magnitude of its count. libFuzzer keeps an input that reaches a new feature.
    features: u64,
    found: Vec<PathBuf>,
    /// Lines of the target's output that report a panic or an error of libFuzzer.
    said: String,
}

fn report(rows: Vec<(&str, Result<Row, Failure>)>) -> Result<(), Failure> {
    println!("| target | executions | edges | features | finds |\n|---|---|---|---|---|");
    let (mut executions, mut failures) = (0, Vec::new());
    for (target, row) in rows {
        let row = match row {
            Ok(row) => row,
            Err(failure) => {
                failures.push(failure);
                continue;
            }
        };
        if row.executions == 0 || row.edges < LEAST_EDGES {
            failures.push(format!("{target}: {} executions reach {} edges", row.executions, row.edges));
        }
        executions += row.executions;
        println!("| {target} | {} | {} | {} | {} |", row.executions, row.edges, row.features, row.found.len());
        for path in row.found {
            failures.push(format!("{target}: {}\n{}", path.display(), row.said));
        }
    }
    println!("{executions} executions");
    if failures.is_empty() { Ok(()) } else { Err(failures.join("\n")) }
}

fn folder(name: &str, target: &str) -> Result<PathBuf, Failure> {
    let path = root().join("target/fuzz").join(name).join(target);
    fs::create_dir_all(&path).map_err(|error| format!("{}: {error}", path.display()))?;
    Ok(path)
}

/// Returns the folder `target/fuzz/NAME/TARGET`, after deleting the files of earlier runs in it.
fn emptied(name: &str, target: &str) -> Result<PathBuf, Failure> {
    let folder = folder(name, target)?;
    for path in files(&folder)? {
        fs::remove_file(&path).map_err(|error| format!("{}: {error}", path.display()))?;
    }
    Ok(folder)
}

/// Returns the names of all targets: each has a corpus in the tree.
fn all_targets() -> Result<Vec<String>, Failure> {
    let corpora = files(&root().join("tests/fuzz/corpus"))?;
    let mut names: Vec<String> =
        corpora.iter().filter_map(|path| Some(path.file_stem()?.to_str()?.to_string())).collect();
    names.sort();
    Ok(names)
}

fn kept(target: &str) -> PathBuf {
    root().join("tests/fuzz/corpus").join(format!("{target}.txt"))
}

/// Builds the program that has all fuzz targets, and returns its path. `with_comparisons` adds the flags
/// [`COMPARISONS`].
fn build(with_comparisons: bool) -> Result<PathBuf, Failure> {
    let folder = root().join(if with_comparisons { "target/fuzz/build" } else { "target/fuzz/fast" });
    let host = host()?;
    run(cargo()
        .args([
            "build",
            "--quiet",
            "--locked",
            "--release",
            "--package",
            "oxmill-fuzz",
            "--features",
            "libfuzzer",
            "--target",
            &host,
        ])
        .env("CARGO_TARGET_DIR", &folder)
        .env("CARGO_PROFILE_RELEASE_DEBUG_ASSERTIONS", "true")
        .env("CARGO_PROFILE_RELEASE_OVERFLOW_CHECKS", "true")
        .env("RUSTFLAGS", [COVERAGE, if with_comparisons { COMPARISONS } else { "" }].concat()))?;
    Ok(folder.join(host).join("release/fuzz"))
}

/// Returns the compiler's default target, which is passed to cargo as `--target`. With `--target`, cargo does not apply
/// `RUSTFLAGS` to build scripts. So the build scripts get no coverage counters.
fn host() -> Result<String, Failure> {
    let output = Command::new("rustc").arg("-vV").output().map_err(|error| format!("rustc: {error}"))?;
    let text = String::from_utf8_lossy(&output.stdout);
    let host = text.lines().find_map(|line| line.strip_prefix("host: "));
    host.map(str::to_string).ok_or_else(|| format!("rustc names no host: {text}"))
}

/// Unpacks the corpus in `tests/fuzz/corpus` into one file per input; returns their folder.
fn seeds(target: &str) -> Result<PathBuf, Failure> {
    let text = fs::read_to_string(kept(target)).map_err(|error| format!("{}: {error}", kept(target).display()))?;
    unpacked("seeds", target, &text)
}

/// Unpacks the inputs in `tests/fuzz/finds`; returns their folder. Each input once showed a fault, which has been
/// corrected. Most targets have none. `minimise` leaves the inputs unchanged.
fn finds(target: &str) -> Result<PathBuf, Failure> {
    let path = root().join("tests/fuzz/finds").join(format!("{target}.txt"));
    let text = if path.exists() { fs::read_to_string(&path) } else { Ok(String::new()) };
    unpacked("finds", target, &text.map_err(|error| format!("{}: {error}", path.display()))?)
}

fn unpacked(name: &str, target: &str, text: &str) -> Result<PathBuf, Failure> {
    let folder = emptied(name, target)?;
    for (number, input) in unpack(text).iter().enumerate() {
        fs::write(folder.join(number.to_string()), input).map_err(|error| error.to_string())?;
    }
    Ok(folder)
}

fn one(program: &Path, target: &str, amount: Amount, options: &[String]) -> Result<Row, Failure> {
    let found = folder("found", target)?;
    let before = files(&found)?;
    let mut command = Command::new(program);
    command.env("OXMILL_FUZZ_TARGET", target).args(["-print_final_stats=1", "-timeout=20"]).args(options);
    command.arg(format!("-artifact_prefix={}/", found.display()));
    if matches!(target, "lines" | "programs" | "session" | "events" | "settings") {
        command.arg(format!("-dict={}", root().join("tests/fuzz/gcode.dict").display()));
    }
    let seeds = seeds(target)?;
    if matches!(amount, Amount::Repeated(..)) {
        // Sorted by name: the order of directory entries differs between machines.
        let mut paths = files(&seeds)?;
        paths.sort();
        let names: Vec<String> = paths.iter().map(|path| path.display().to_string()).collect();
        let list = folder("lists", target)?.join("seeds");
        fs::write(&list, names.join(",")).map_err(|error| format!("{}: {error}", list.display()))?;
        command.arg(format!("-seed_inputs=@{}", list.display()));
    } else {
        command.arg(folder("corpus", target)?).arg(seeds);
    }
    let output = command.output().map_err(|error| error.to_string())?;
    let text = String::from_utf8_lossy(&output.stderr);
    let executions = text.lines().find_map(|line| line.strip_prefix("stat::number_of_executed_units:"));
    let found: Vec<PathBuf> = files(&found)?.into_iter().filter(|path| !before.contains(path)).collect();
    let said: Vec<&str> = text.lines().filter(|line| line.contains("panicked") || line.starts_with("==")).collect();
    if !output.status.success() && found.is_empty() {
        return Err(format!("{target} ended without a find: {text}"));
    }
    Ok(Row {
        executions: executions.and_then(|count| count.trim().parse().ok()).unwrap_or(0),
        edges: last_of(&text, "cov:"),
        features: last_of(&text, "ft:"),
        found,
        said: said.join("\n"),
    })
}

/// Returns the last number after a word in libFuzzer's progress output.
fn last_of(text: &str, word: &str) -> u64 {
    let words: Vec<&str> = text.split_whitespace().collect();
    words.windows(2).rev().find(|pair| pair[0] == word).and_then(|pair| pair[1].parse().ok()).unwrap_or(0)
}

fn files(folder: &Path) -> Result<Vec<PathBuf>, Failure> {
    let entries = fs::read_dir(folder).map_err(|error| format!("{}: {error}", folder.display()))?;
    Ok(entries.filter_map(|entry| Some(entry.ok()?.path())).collect())
}

/// Replaces each corpus in `tests/fuzz/corpus` by a small set of inputs. The set reaches the same code as all present
/// inputs together: the corpus, the finds, and the inputs that earlier searches added to `target/fuzz/corpus`.
fn minimise() -> Result<(), Failure> {
    let program = build(false)?;
    for target in &all_targets()? {
        let small = emptied("small", target)?;
        run(Command::new(&program)
            .env("OXMILL_FUZZ_TARGET", target)
            .args(["-set_cover_merge=1", "-max_len=512"])
            .args([&small, &folder("corpus", target)?, &seeds(target)?, &finds(target)?]))?;
        let mut inputs: Vec<Vec<u8>> = files(&small)?.iter().filter_map(|path| fs::read(path).ok()).collect();
        inputs.sort_by(|a, b| (a.len(), a).cmp(&(b.len(), b)));
        fs::write(kept(target), pack(&inputs)).map_err(|error| error.to_string())?;
        println!("{target}: {} inputs", inputs.len());
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_target_has_its_share() {
        let mut shares: Vec<String> = SHARES.iter().map(|(name, ..)| name.to_string()).collect();
        shares.sort();
        assert_eq!(all_targets().expect("corpora"), shares);
        let names: Vec<&str> = shares.iter().map(String::as_str).collect();
        let options = Amount::Executions(1_000_000).options("lines", &names, 2);
        assert_eq!(options, ["-runs=240000", "-max_len=128"]);
        assert_eq!(Amount::Executions(1_000).options("usb", &["usb"], 2)[0], "-runs=1000");
        assert_eq!(Amount::Repeated(1_000, 7).options("usb", &["usb"], 2)[2], "-seed=7");
    }

    #[test]
    fn understands_how_much_is_wanted() {
        assert_eq!(wanted(&["--minutes", "3"]), Ok((Amount::Seconds(180), &[][..])));
        assert_eq!(wanted(&["--hours", "2", "usb"]), Ok((Amount::Seconds(7200), &["usb"][..])));
        assert_eq!(wanted(&["--seconds", "5", "usb"]), Ok((Amount::Seconds(5), &["usb"][..])));
        assert_eq!(wanted(&["--executions", "9", "--seed", "1"]), Ok((Amount::Repeated(9, 1), &[][..])));
        assert_eq!(wanted(&["lines"]), Ok((Amount::Seconds(300), &["lines"][..])));
        assert!(wanted(&["--minutes", "x"]).is_err());
        assert_eq!(fuzz(&["--list"]), Ok(()));
    }

    #[test]
    fn reads_what_libfuzzer_says() {
        let text = "#2\tINITED cov: 5 ft: 6\n#99\tNEW    cov: 1200 ft: 3400 corp: 7/9b\nstat::x: 1";
        assert_eq!((last_of(text, "cov:"), last_of(text, "ft:"), last_of(text, "absent:")), (1200, 3400, 0));
    }
}
