//! What the tree has for each target, run: the corpus, and what has shown a fault. Beside the library, which would be compiled
//! once more for tests in it.

/// The inputs of the tree, which once reached something that no other does.
fn replay(name: &str) {
    let run = oxmill_fuzz::target(name).expect("a target");
    let text = |folder| std::fs::read_to_string(format!("{}/{folder}/{name}.txt", env!("CARGO_MANIFEST_DIR")));
    let inputs = oxmill_test_support::unpack(&text("corpus").expect("a corpus"));
    assert!(inputs.len() > 10, "{name}: {} inputs", inputs.len());
    let finds = text("finds").unwrap_or_default();
    inputs.iter().chain(&oxmill_test_support::unpack(&finds)).for_each(|input| run(input));
}

/// A test for each, so that they run side by side.
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
            assert_eq!(names.len(), oxmill_fuzz::TARGETS.len());
            assert!(names_in("finds").iter().all(|find| names.contains(&find.as_str())));
        }
    };
}
replays!(lines, programs, session, stored, steps, hosts, events, settings, usb);
