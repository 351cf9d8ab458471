//! Checks the dependencies between crates, and that no file is compiled into two crates.

use crate::{dependencies, root, source, sources};
use std::fs;

/// The dependencies between the crates of this workspace: for each crate, the crates that it uses. It must use all of
/// these and no others of the workspace. Crates from outside the workspace are not restricted here.
const CRATES: &[(&str, &[&str])] = &[
    ("boards", &["oxmill-controller", "oxmill-store"]),
    ("boards/images", &[]),
    ("boards/tables", &["oxmill-boards"]),
    ("src/controller", &["oxmill-sqrt"]),
    ("src/firmware", &["oxmill-boards", "oxmill-controller", "oxmill-step-task", "oxmill-store"]),
    ("src/sqrt", &[]),
    ("src/simulator", &["oxmill-boards", "oxmill-controller", "oxmill-store", "oxmill-tables"]),
    ("src/step_task", &["oxmill-boards", "oxmill-controller"]),
    ("src/store", &["oxmill-controller"]),
    ("src/web", &["oxmill-controller", "oxmill-simulator", "oxmill-tables"]),
];

#[test]
fn crates_build_on_those_below_them() {
    for (folder, allowed) in CRATES {
        let manifest = fs::read_to_string(root().join(folder).join("Cargo.toml")).unwrap();
        let found = dependencies(&manifest);
        for name in found.iter().filter(|name| name.starts_with("oxmill")) {
            assert!(allowed.contains(&name.as_str()), "{folder} builds on `{name}`");
        }
        for name in *allowed {
            assert!(found.iter().any(|n| n == name), "{folder} does not build on `{name}` any more");
        }
    }
}

/// The firmware must have no conditions on features: the contract of the boards hides the differences between boards.
#[test]
fn no_condition_of_the_firmware_names_a_board() {
    let mut read = 0;
    for (file, text) in sources(&root().join("src/firmware")) {
        read += 1;
        let text = source::bare(&text);
        let conditions = ["cfg(feature", "cfg(any", "cfg(all", "cfg(not", "cfg!(", "cfg_attr("];
        let dense: String = text.split_whitespace().collect();
        for condition in conditions {
            assert!(!dense.contains(condition), "src/firmware/{}: {condition}", file.display());
        }
    }
    assert!(read > 10);
}

/// Conditions in the boards' crate name the feature of a chip, not of a board. So a new board with a known chip needs
/// no change to them.
#[test]
fn only_the_choice_of_a_board_names_one_in_a_condition() {
    let files = sources(&root().join("boards"));
    assert!(files.len() > 15);
    for (file, text) in files.iter().filter(|(file, _)| file.as_os_str() != "lib.rs") {
        let dense: String = text.split_whitespace().collect();
        for board in oxmill_images::IMAGES {
            assert!(!dense.contains(&format!("feature=\"{board}\"")), "boards/{}: {board}", file.display());
        }
    }
}

/// Parts of the standard library that the simulator's library uses only with the feature `program`.
const OF_THE_HOST: &[&[&str]] = &[
    &["std", "fs"],
    &["std", "net"],
    &["std", "thread"],
    &["std", "process"],
    &["std", "env"],
    &["std", "time", "Instant"],
];

#[test]
fn the_simulator_as_a_library_has_no_files_threads_or_clock() {
    let folder = root().join("src/simulator");
    let library = source::bare(&fs::read_to_string(folder.join("lib.rs")).unwrap());
    let (mut parts, mut gated) = (Vec::new(), Vec::new());
    let mut condition = false;
    for line in library.lines().map(str::trim) {
        if let Some(name) = line.trim_start_matches("pub ").strip_prefix("mod ").and_then(|rest| rest.strip_suffix(';'))
        {
            if condition { &mut gated } else { &mut parts }.push(name.to_owned());
        }
        // Any `cfg(feature = "...")` counts, because `bare` has blanked the name of the feature.
        condition = line.starts_with("#[cfg(feature");
    }
    assert!(parts.len() > 12 && gated.contains(&"server".to_owned()), "{parts:?} {gated:?}");
    for part in parts {
        let text = source::bare(&fs::read_to_string(folder.join(format!("{part}.rs"))).unwrap());
        for path in source::paths(&text) {
            let uses = |of: &&[&str]| path.iter().map(String::as_str).collect::<Vec<_>>().starts_with(of);
            assert!(!OF_THE_HOST.iter().any(uses), "src/simulator/{part}.rs uses {}", path.join("::"));
            assert!(path[0] != "crate" || !gated.contains(&path[1]), "{part} needs the program: {}", path.join("::"));
        }
    }
}

/// Files that are compiled outside their own folder, with the reason.
const INCLUDED: &[(&str, &str, &str)] = &[
    ("src/controller/gcode/mod.rs", "computed/none.rs", "stands in for its folder"),
    ("src/controller/gcode/mod.rs", "refusal/none.rs", "stands in for its folder"),
    ("src/controller/lib.rs", "recorder/none.rs", "stands in for its folder"),
    ("src/store/tests.rs", "damage_tests.rs", "tests of one module in three files"),
    ("src/store/tests.rs", "failure_tests.rs", "tests of one module in three files"),
    ("tests/bench/motion.rs", "../../xtask/src/programs/mod.rs", "the same programs as `cargo xtask job`"),
    ("tests/machine/examples.rs", "../../xtask/src/programs/mod.rs", "the same programs as `cargo xtask job`"),
    ("tests/on_target/src/count.rs", "../../../src/step_task/shared.rs", "the step task for registers in memory"),
    (
        "tests/on_target/src/count.rs",
        "../../../src/step_task/step_timer/mod.rs",
        "the step task for registers in memory",
    ),
    ("xtask/src/recordings.rs", "../../tests/recordings/differences.rs", "one list of differences for both runs"),
    ("xtask/src/recordings.rs", "../../tests/recordings/record.rs", "one reader of the recordings"),
    ("xtask/src/recordings.rs", "../../tests/recordings/rules.rs", "one list of rules for both runs"),
];

#[test]
fn files_are_compiled_where_they_lie() {
    let mut found = Vec::new();
    for folder in ["boards", "src", "tests", "xtask"] {
        for (file, text) in source::all(&root().join(folder)) {
            let paths = text.lines().filter_map(|line| line.trim().strip_prefix("#[path = \"")?.strip_suffix("\"]"));
            found.extend(paths.map(|path| (format!("{folder}/{}", file.display()), path.to_owned())));
        }
    }
    for (file, path) in &found {
        let known = INCLUDED.iter().any(|(f, p, _)| f == file && p == path);
        assert!(known, "{file} includes {path}: let the crate be used instead, or give the reason in INCLUDED");
    }
    for (file, path, why) in INCLUDED {
        let exists = found.iter().any(|(f, p)| f == file && p == path);
        assert!(exists, "{file} does not include {path} any more ({why}): take it out of INCLUDED");
    }
}
