//! Reads the sources and checks which parts of the code depend on which others. A forbidden dependency fails a test.

mod docs;
mod shape;
mod source;
mod walls;

use oxmill_controller::error::{Alarm, Error};
use std::collections::BTreeSet;
use std::fs;
use std::path::{Path, PathBuf};

/// The rooms (top-level modules) of the controller, each with the rooms that it may use. A new room must be added here.
const ROOMS: &[(&str, &[&str])] = &[
    ("units", &[]),
    ("axes", &[]),
    ("error", &[]),
    ("digest", &[]),
    ("image", &[]),
    ("lent", &[]),
    ("number", &["units"]),
    ("step_rates", &[]),
    ("step_timing", &["step_rates"]),
    ("messages", &["axes", "units"]),
    ("settings", &["units", "axes", "error", "image", "number", "step_rates"]),
    ("protocol", &["units", "axes", "error", "image", "messages", "number", "settings"]),
    ("gcode", &["units", "axes", "error", "image", "lent", "messages", "number"]),
    ("motion", &["units", "axes", "error", "image", "lent", "messages"]),
    ("machine", &["units", "axes", "error", "messages", "settings", "motion"]),
    ("dispatch", ALL),
    ("parts", ALL),
    ("memory", ALL),
    ("view", ALL),
    ("states", ALL),
    ("work", ALL),
    ("host", ALL),
    ("inputs", ALL),
    ("outputs", ALL),
    ("pump", &["dispatch", "messages", "units"]),
    ("recorder", &["dispatch", "messages", "protocol", "units"]),
];

/// The rooms that carry out the received input and change `Controller` and `Machine`. Module `shape` checks the calls
/// between the files of these rooms.
const CORE: &[&str] = &["dispatch", "parts", "memory", "view", "states", "work", "host", "inputs", "outputs"];

/// The rooms that a room of [`CORE`] may use.
const ALL: &[&str] = &[
    "units",
    "axes",
    "error",
    "digest",
    "image",
    "number",
    "step_rates",
    "messages",
    "settings",
    "protocol",
    "gcode",
    "motion",
    "machine",
    "lent",
    "memory",
    "dispatch",
    "parts",
    "view",
    "states",
    "work",
    "host",
    "inputs",
    "outputs",
];

/// External crates that the controller may use.
const CONTROLLER_CRATES: &[&str] = &["crc", "fugit", "heapless", "libm", "oxmill-sqrt"];

fn root() -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR"))
}

/// Returns all Rust files below a folder, with their paths relative to it. Skips folders and files named `tests`,
/// because the rules do not apply to tests; [`faults`] checks that tests are compiled only in test builds.
fn sources(folder: &Path) -> Vec<(PathBuf, String)> {
    let mut found = source::all(folder);
    found.retain(|(file, _)| {
        let mut folders = file.parent().into_iter().flat_map(Path::components);
        file.file_name().is_some_and(|n| n != "tests.rs") && folders.all(|f| f.as_os_str() != "tests")
    });
    assert!(!found.is_empty(), "no sources in {}", folder.display());
    found
}

/// Returns the module path of a file: `protocol/text.rs` is [protocol, text], `gcode/mod.rs` is [gcode].
fn module_of(file: &Path) -> Vec<String> {
    let mut parts: Vec<String> =
        file.with_extension("").components().map(|c| c.as_os_str().to_string_lossy().into_owned()).collect();
    if parts.last().is_some_and(|last| last == "mod" || last == "lib") {
        parts.pop();
    }
    parts
}

/// Resolves `path` from the root of the crate and returns its first name. This is a room (a top-level module of the
/// controller), or another name that the root has. `path` is as a file writes it. `module` is the module of this file:
/// `self` and `super` start there. Returns `None` if the path does not start with `crate`, `self` or `super`.
fn room_of(path: &[String], module: &[String]) -> Option<String> {
    let mut base = module.to_vec();
    let mut rest = path;
    match rest.first()?.as_str() {
        "crate" => base.clear(),
        "self" => {}
        "super" => {}
        _ => return None,
    }
    while let Some(first) = rest.first() {
        match first.as_str() {
            "super" => {
                base.pop();
            }
            "crate" | "self" => {}
            _ => break,
        }
        rest = &rest[1..];
    }
    base.extend(rest.iter().cloned());
    base.first().cloned()
}

/// Returns the rules that a file of the controller violates.
fn faults(file: &Path, text: &str) -> Vec<String> {
    // `extern crate alloc;` is allowed: on hosts, the controller's memory comes from the heap.
    let text = source::bare(text).replace("extern crate alloc;", "");
    let module = module_of(file);
    let mut faults = Vec::new();
    // `bare` has removed all items with `#[cfg(test)]`. So a `mod tests` that is left has no such attribute.
    if source::words(&text).zip(source::words(&text).skip(1)).any(|(a, b)| a == "mod" && b == "tests") {
        faults.push("has `mod tests` without #[cfg(test)] right before it".to_string());
    }
    for word in source::words(&text) {
        if ["f64", "mul_add", "unsafe", "extern"].contains(&word.as_str()) {
            faults.push(format!("says `{word}`"));
        }
    }
    let Some(room) = module.first() else {
        return faults;
    };
    let Some((_, allowed)) = ROOMS.iter().find(|(name, _)| name == room) else {
        return vec![format!("room `{room}` is not in the table of rooms")];
    };
    for path in source::paths(&text) {
        if path[0] == "std" || path[0] == "alloc" && room != "lent" {
            faults.push(format!("uses `{}`", path.join("::")));
        }
        // `room_of` resolves `super` from the module of the file. Within an inline module this would be wrong, but only
        // tests have inline modules. A path to a re-export in the crate's root, such as `crate::Profile`, is rejected,
        // because it hides the room of the name.
        if let Some(other) = room_of(&path, &module)
            && other != *room
            && !allowed.contains(&other.as_str())
        {
            faults.push(format!("`{room}` uses `{other}`: {}", path.join("::")));
        }
    }
    faults
}

fn report(folder: &Path, faults: impl Fn(&Path, &str) -> Vec<String>) {
    let found: Vec<String> = sources(folder)
        .iter()
        .flat_map(|(file, text)| {
            faults(file, text).into_iter().map(|f| format!("{}: {f}", folder.join(file).display())).collect::<Vec<_>>()
        })
        .collect();
    assert!(found.is_empty(), "{}", found.join("\n"));
}

#[test]
fn rooms_of_the_controller_keep_their_directions() {
    report(&root().join("src/controller"), faults);
}

#[test]
fn every_room_of_the_table_exists() {
    let existing: BTreeSet<String> =
        sources(&root().join("src/controller")).iter().filter_map(|(f, _)| module_of(f).first().cloned()).collect();
    for (room, _) in ROOMS {
        assert!(existing.contains(*room), "no room `{room}`");
    }
}

#[test]
fn the_controller_is_no_std_without_unsafe_and_cannot_panic_by_lint() {
    let text = source::bare(&fs::read_to_string(root().join("src/controller/lib.rs")).unwrap());
    let dense: String = text.split_whitespace().collect();
    assert!(dense.contains("#![no_std]") || dense.contains("#![cfg_attr(not(test),no_std)]"), "std");
    assert!(dense.contains("forbid(unsafe_code)"), "unsafe");
    for lint in ["unwrap_used", "expect_used", "panic", "indexing_slicing"] {
        assert!(dense.contains(&format!("clippy::{lint}")), "{lint}");
    }
}

/// Returns the names of the `[dependencies]` of a manifest.
fn dependencies(manifest: &str) -> Vec<String> {
    let mut inside = false;
    let mut found = Vec::new();
    for line in manifest.lines().map(str::trim) {
        if line.starts_with('[') {
            inside = line == "[dependencies]";
            // Dependencies can also be in other tables: a dependency in one of its own (`[dependencies.x]`), and those
            // of a single target in a table of this target.
            if let Some(name) = line.trim_matches(['[', ']']).split("dependencies.").nth(1)
                && !line.contains("dev-dependencies")
            {
                found.push(name.to_string());
            }
            if line.starts_with("[target") && line.ends_with("dependencies]") && !line.contains("dev-dependencies") {
                inside = true;
            }
        } else if inside && !line.is_empty() && !line.starts_with('#') {
            found.push(line.split(['=', '.', ' ']).next().unwrap_or_default().to_string());
        }
    }
    found
}

#[test]
fn the_controller_builds_on_nothing_with_hardware_queues_or_clocks() {
    let manifest = fs::read_to_string(root().join("src/controller/Cargo.toml")).unwrap();
    let found = dependencies(&manifest);
    assert!(!found.is_empty());
    for name in found {
        assert!(CONTROLLER_CRATES.contains(&name.as_str()), "the controller depends on `{name}`");
    }
}

fn simulator_faults(_: &Path, text: &str) -> Vec<String> {
    let text = source::bare(text);
    let mut faults: Vec<String> =
        source::words(&text).filter(|w| w == "unsafe").map(|_| "says `unsafe`".to_string()).collect();
    // The simulator runs on any host: crates for the hardware are forbidden.
    for path in source::paths(&text) {
        if ["rtic", "rtic_sync", "cortex_m", "stm32f4xx_hal", "defmt"].contains(&path[0].as_str()) {
            faults.push(format!("uses `{}`", path.join("::")));
        }
    }
    faults
}

#[test]
fn the_simulator_is_safe_and_knows_no_hardware() {
    report(&root().join("src/simulator"), simulator_faults);
    let text = source::bare(&fs::read_to_string(root().join("src/simulator/lib.rs")).unwrap());
    assert!(text.contains("forbid(unsafe_code)"));
}

/// Returns the rules that a file of the boards violates. Of the controller, boards may use only four things: the
/// profile, the step rates, the reset cause, and the digest of the steps, which boards without pins compute. Boards
/// must not use RTIC or the simulator.
fn board_faults(_: &Path, text: &str) -> Vec<String> {
    let mut faults = Vec::new();
    for path in source::paths(&source::bare(text)) {
        let known = match path[0].as_str() {
            "oxmill_controller" => {
                matches!(path.get(1).map(String::as_str), Some("Profile" | "StepRates" | "digest" | "ResetCause"))
            }
            // Boards may use the channels of `rtic_sync`, to pass received bytes to a task, but not RTIC itself.
            "rtic" | "oxmill_simulator" => false,
            _ => true,
        };
        if !known {
            faults.push(format!("uses `{}`", path.join("::")));
        }
    }
    faults
}

#[test]
fn boards_know_pins_only() {
    report(&root().join("boards"), board_faults);
}

/// A function that computes the address of a register from the number of a port could reach any register. So `read` and
/// `write` of registers must not be visible outside of `boards/stm32f4`.
#[test]
fn registers_are_reached_from_their_folder_only() {
    let text = source::bare(&fs::read_to_string(root().join("boards/stm32f4/registers.rs")).unwrap());
    let public: Vec<&str> = text.lines().filter(|line| line.trim_start().starts_with("pub fn ")).collect();
    assert!(public.is_empty(), "public: {public:?}");
    assert!(text.contains("pub(super) fn write(") && text.contains("pub(super) fn read("));
}

/// `docs/errors.md` lists all errors and alarms of the code. So the controller must report each of them somewhere.
#[test]
fn each_error_and_alarm_is_given_somewhere() {
    let texts: String = sources(&root().join("src/controller"))
        .iter()
        .map(|(_, text)| source::bare(text))
        .collect::<Vec<_>>()
        .join("\n");
    let given: BTreeSet<String> = source::lex(&texts)
        .windows(4)
        .filter(|tokens| matches!(tokens[0].as_str(), "Error" | "Alarm"))
        .filter_map(|tokens| tokens[1..].iter().find(|token| *token != ":" && *token != "::"))
        .cloned()
        .collect();
    let errors = Error::ALL.iter().map(|error| format!("{error:?}"));
    let alarms = Alarm::ALL.iter().map(|alarm| format!("{alarm:?}"));
    let never: Vec<String> = errors.chain(alarms).filter(|name| !given.contains(name)).collect();
    assert!(never.is_empty(), "nobody gives {never:?}");
}

#[test]
fn controller_knows_no_firmware_simulator_or_board() {
    report(&root().join("src/controller"), |_, text| {
        source::paths(&source::bare(text))
            .into_iter()
            .filter(|p| {
                p[0].starts_with("oxmill") && p[0] != "oxmill_sqrt"
                    || ["rtic", "rtic_sync", "cortex_m", "defmt"].contains(&p[0].as_str())
            })
            .map(|p| format!("uses `{}`", p.join("::")))
            .collect()
    });
}

mod the_reader_itself {
    use super::*;

    fn found(file: &str, text: &str) -> Vec<String> {
        faults(Path::new(file), text)
    }

    #[test]
    fn finds_forbidden_directions_in_every_form() {
        for (file, text) in [
            ("gcode/check.rs", "use crate::motion::Move;"),
            ("gcode/check.rs", "use crate::{axes::Axis, motion::{Move, Speed}};"),
            ("gcode/check.rs", "use crate::motion as m;"),
            ("gcode/check.rs", "fn f() { let m = crate::motion::Move::new(); }"),
            ("gcode/check.rs", "use super::super::protocol::line_filter;"),
            ("gcode/mod.rs", "use super::protocol;"),
            ("gcode/mod.rs", "pub use super::{units::Decimal, controller::Controller};"),
            ("units.rs", "use crate::axes::Axis;"),
            ("motion/planner.rs", "use crate::settings::Settings;"),
            ("machine/hold.rs", "use crate::gcode::Action;"),
            ("messages/host.rs", "use crate::protocol::text;"),
            ("protocol/reply_texts.rs", "struct A(crate::motion::Motion);"),
            ("protocol/reply_texts.rs", "use crate::Stepper;"),
        ] {
            assert!(!found(file, text).is_empty(), "{file}: {text}");
        }
    }

    #[test]
    fn finds_forbidden_words() {
        for text in [
            "fn f(x: f64) {}",
            "let y = x.mul_add(a, b);",
            "unsafe { core::hint::unreachable_unchecked() }",
            "use std::vec::Vec;",
            "let x = std::f32::consts::PI;",
            "extern crate std;",
            "mod tests;",
        ] {
            assert!(!found("motion/planner.rs", text).is_empty(), "{text}");
        }
        assert!(!simulator_faults(Path::new("lib.rs"), "unsafe fn f() {}").is_empty());
        assert!(!board_faults(Path::new("mod.rs"), "use oxmill_controller::{Profile, Controller};").is_empty());
        assert!(!board_faults(Path::new("mod.rs"), "use rtic::Monotonic;").is_empty());
    }

    #[test]
    fn takes_no_offence_at_comments_strings_tests_and_allowed_directions() {
        for (file, text) in [
            ("gcode/check.rs", "// use crate::motion::Move; f64 unsafe\n/* std::vec /* nested */ f64 */"),
            ("gcode/check.rs", "const A: &str = \"unsafe f64 crate::motion::Move\";"),
            ("gcode/check.rs", "const A: &str = r#\"crate::motion::\"Move\" f64\"#; const B: &[u8] = br\"f64\";"),
            ("gcode/check.rs", "const Q: char = '\"'; const R: u8 = b'\\''; // f64\nfn f<'a>(x: &'a str) {}"),
            ("gcode/check.rs", "#[cfg(test)]\nmod tests { use std::vec::Vec; fn f(x: f64) { { } } }"),
            ("gcode/check.rs", "#[cfg(test)]\nuse std::vec::Vec;\nfn g() {}"),
            ("gcode/check.rs", "use super::modal::Modal; use super::{word, arc::Vector};"),
            ("machine/jog.rs", "use crate::motion::Move;"),
            ("work/stages.rs", "use crate::{gcode, motion, protocol, machine, settings};"),
        ] {
            assert_eq!(found(file, text), Vec::<String>::new(), "{file}: {text}");
        }
    }

    #[test]
    fn sees_what_follows_a_test_module() {
        let text = "#[cfg(test)]\nmod tests { fn f() {} }\nuse crate::motion::Move;";
        assert_eq!(found("gcode/check.rs", text).len(), 1);
    }

    #[test]
    fn refuses_rooms_that_are_not_in_the_table() {
        assert_eq!(found("helpers/mod.rs", "").len(), 1);
    }

    #[test]
    fn reads_dependencies_of_a_manifest() {
        let manifest = "[package]\nname = \"x\"\n[dependencies]\nlibm.workspace = true\nrtic = \"2\"\n\
                        [dev-dependencies]\nproptest = \"1\"\n[dependencies.defmt]\nversion = \"1\"\n\
                        [target.'cfg(target_os = \"none\")'.dependencies]\ncortex-m = \"0.7\"\n";
        assert_eq!(dependencies(manifest), ["libm", "rtic", "defmt", "cortex-m"]);
    }
}
