//! Fuzz targets for all code that parses data from outside. Each target is a function of some bytes; its invariants
//! must hold for any bytes.
//!
//! A target panics when an invariant is violated. `cargo xtask fuzz` lets libFuzzer look for bytes that cause this,
//! guided by code coverage. `corpus/` has a small set of inputs that reaches most of the code. `finds/` has inputs that
//! once showed a fault; these faults have been corrected. Their files have one input per line, escaped. `cargo test`
//! runs all of them.

mod board;
pub mod events;
pub mod hosts;
pub mod lines;
pub mod programs;
pub mod session;
pub mod settings;
pub mod steps;
pub mod stored;
pub mod usb;
pub mod work;

/// The name of a target, as in `OXMILL_FUZZ_TARGET`, and its function.
pub type Target = (&'static str, fn(&[u8]));

/// The fuzz targets. Each has a corpus of the same name.
pub const TARGETS: [Target; 9] = [
    ("lines", lines::run),
    ("programs", programs::run),
    ("session", session::run),
    ("stored", stored::run),
    ("steps", steps::run),
    ("hosts", hosts::run),
    ("events", events::run),
    ("settings", settings::run),
    ("usb", usb::run),
];

/// Returns the function of the target with this name; `None` if there is no such target.
pub fn target(name: &str) -> Option<fn(&[u8])> {
    TARGETS.iter().find(|(known, _)| *known == name).map(|(_, run)| *run)
}

#[cfg(test)]
mod tests {
    /// Runs a target on its inputs in `corpus` and `finds`. The target panics if an invariant is violated.
    fn replay(name: &str) {
        let run = super::target(name).expect("a target");
        let text = |folder| std::fs::read_to_string(format!("{}/{folder}/{name}.txt", env!("CARGO_MANIFEST_DIR")));
        let inputs = oxmill_test_support::unpack(&text("corpus").expect("a corpus"));
        assert!(inputs.len() > 10, "{name}: {} inputs", inputs.len());
        let finds = text("finds").unwrap_or_default();
        inputs.iter().chain(&oxmill_test_support::unpack(&finds)).for_each(|input| run(input));
    }

    /// One test per target, so that the tests run in parallel.
    macro_rules! replays {
        ($($name:ident),*) => {
            $(#[test] fn $name() { replay(stringify!($name)); })*

            #[test]
            fn every_target_has_its_corpus() {
                let names_in = |folder| {
                    let files = std::fs::read_dir(format!("{}/{folder}", env!("CARGO_MANIFEST_DIR"))).expect("a folder");
                    let name = |file: std::io::Result<std::fs::DirEntry>| file.expect("a file").file_name().into_string();
                    let mut names: Vec<_> = files.map(|file| name(file).expect("a name")).collect();
                    names.sort();
                    names
                };
                let mut names = vec![$(concat!(stringify!($name), ".txt")),*];
                names.sort();
                assert_eq!(names_in("corpus"), names);
                assert_eq!(names.len(), super::TARGETS.len());
                assert!(names_in("finds").iter().all(|find| names.contains(&find.as_str())));
            }
        };
    }

    /// Runs the corpus of `settings` in the dialect of grblHAL (`$900=3`). The corpus is older than this dialect, so
    /// none of its inputs chooses the dialect itself.
    #[test]
    fn settings_in_the_dialect_of_grblhal() {
        let text = std::fs::read_to_string(concat!(env!("CARGO_MANIFEST_DIR"), "/corpus/settings.txt"));
        for mut input in oxmill_test_support::unpack(&text.expect("a corpus")) {
            if let Some(first) = input.first_mut() {
                *first = super::settings::OF_GRBLHAL;
            }
            super::settings::run(&input);
        }
    }

    replays!(lines, programs, session, stored, steps, hosts, events, settings, usb);
}
