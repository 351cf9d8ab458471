//! Checks the shape of the code. Calls and imports between the files of a room (a top-level module of the controller)
//! have no cycles. Each type name occurs once per crate.

use crate::source::{self, Item};
use crate::{CORE, module_of, root, sources};
use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

/// Type names that occur several times in a crate, with the number of occurrences. A part of the controller can be left
/// out of a build. A stub with the same type names then stands in for it.
const SAME_NAMES: &[(&str, usize)] = &[
    ("src/controller Computed", 2),
    ("src/controller ComputedMemory", 2),
    ("src/controller ComputedStorage", 2),
    ("src/controller Page", 2),
    ("src/controller Recorder", 2),
];

/// Crates that are part of an image or the simulator.
const CRATES: [&str; 8] =
    ["boards", "src/controller", "src/firmware", "src/sqrt", "src/simulator", "src/step_task", "src/store", "src/web"];

/// Compares figures with a limit. `listed` has the known figures above the limit, and must be exact. So the test fails
/// in three cases: a figure above the limit is not listed, it differs from the listed one, or a listed figure is within
/// the limit.
fn judge(what: &str, found: &BTreeMap<String, usize>, limit: usize, listed: &[(&str, usize)]) {
    let mut faults = Vec::new();
    for (name, figure) in found.iter().filter(|(_, figure)| **figure > limit) {
        match listed.iter().find(|(listed, _)| listed == name) {
            None => faults.push(format!("{name}: {figure} {what}, of {limit} at most")),
            Some((_, before)) if figure != before => faults.push(format!("{name}: {figure} {what}, {before} listed")),
            Some(_) => {}
        }
    }
    for (name, _) in listed {
        if found.get(*name).is_none_or(|figure| *figure <= limit) {
            faults.push(format!("{name} is within {limit} {what}: take it out of the list"));
        }
    }
    assert!(faults.is_empty(), "{}", faults.join("\n"));
}

/// Returns the items of all files of a folder.
fn items(folder: &str) -> Vec<(String, Vec<Item>)> {
    let read = |(file, text): &(std::path::PathBuf, String)| {
        (file.to_string_lossy().into_owned(), source::items(&source::lex(&source::bare(text))))
    };
    sources(&root().join(folder)).iter().map(read).collect()
}

/// Returns the controller's files by room (top-level module). A file at the root is a room of its own. All rooms of
/// [`CORE`] count as one room.
fn rooms() -> BTreeMap<String, Vec<(String, String)>> {
    let mut rooms: BTreeMap<String, Vec<(String, String)>> = BTreeMap::new();
    for (file, text) in sources(&root().join("src/controller")) {
        let Some(room) = module_of(&file).first().cloned() else { continue };
        let room = if CORE.contains(&room.as_str()) { "core".to_owned() } else { room };
        rooms.entry(room).or_default().push((file.to_string_lossy().into_owned(), text));
    }
    rooms
}

/// Returns the number of nodes of a graph that lie on a cycle.
fn circles(graph: &BTreeMap<String, BTreeSet<String>>) -> usize {
    let reach = |from: &String| {
        let mut seen = BTreeSet::new();
        let mut next: Vec<&String> = graph.get(from).into_iter().flatten().collect();
        while let Some(file) = next.pop() {
            if seen.insert(file.clone()) {
                next.extend(graph.get(file).into_iter().flatten());
            }
        }
        seen
    };
    let reached: BTreeMap<&String, BTreeSet<String>> = graph.keys().map(|file| (file, reach(file))).collect();
    let on: Vec<_> = reached.iter().filter(|(file, there)| there.contains(**file)).map(|(file, _)| file).collect();
    if !on.is_empty() {
        // Print the files: the failing assertion shows only their number.
        println!("on a circle: {on:?}");
    }
    on.len()
}

#[test]
fn calls_between_the_files_of_a_room_go_one_way() {
    let mut found = BTreeMap::new();
    for (room, files) in rooms() {
        let mut methods: BTreeMap<(String, String), String> = BTreeMap::new();
        let read: Vec<(&String, Vec<Item>)> =
            files.iter().map(|(file, text)| (file, source::items(&source::lex(&source::bare(text))))).collect();
        // A `none.rs` is a stub with the same functions as the module that it replaces.
        for (file, items) in read.iter().filter(|(file, _)| !file.ends_with("none.rs")) {
            for item in items.iter().filter(|item| item.kind == "impl") {
                for name in item.functions() {
                    methods.insert((item.name.clone(), name), (*file).clone());
                }
            }
        }
        let mut graph: BTreeMap<String, BTreeSet<String>> = BTreeMap::new();
        for (file, items) in &read {
            for item in items.iter().filter(|item| item.kind == "impl") {
                for call in source::calls_of_self(&item.body) {
                    if let Some(other) = methods.get(&(item.name.clone(), call)).filter(|other| other != file) {
                        graph.entry((*file).clone()).or_default().insert(other.clone());
                    }
                }
            }
        }
        found.insert(room, circles(&graph));
    }
    judge("files on a circle of calls", &found, 0, &[]);
}

#[test]
fn imports_between_the_files_of_a_room_go_one_way() {
    let mut found = BTreeMap::new();
    for (room, files) in rooms() {
        let by_module: BTreeMap<Vec<String>, &String> =
            files.iter().map(|(file, _)| (module_of(Path::new(file)), file)).collect();
        let exported: BTreeMap<Vec<String>, Vec<String>> =
            files.iter().flat_map(|(file, text)| re_exports(&module_of(Path::new(file)), text)).collect();
        let mut graph: BTreeMap<String, BTreeSet<String>> = BTreeMap::new();
        for (file, text) in &files {
            let module = module_of(Path::new(file));
            for path in source::paths(&source::bare(text)) {
                let is_child =
                    |name: &String| by_module.contains_key(&[&module[..], std::slice::from_ref(name)].concat());
                let Some(full) = full_path(&path, &module, is_child) else { continue };
                let full = exported.get(&full).unwrap_or(&full);
                // The path leads to the file whose module is the longest prefix of the path. Ignore paths to the
                // room's root: all files of a room share the types there.
                let target = (2..=full.len()).rev().find_map(|n| by_module.get(&full[..n]));
                if let Some(other) = target.filter(|other| **other != file) {
                    graph.entry(file.clone()).or_default().insert((*other).clone());
                }
            }
        }
        assert!(room != "motion" || graph.len() > 5, "imports are found");
        found.insert(room, circles(&graph));
    }
    judge("files on a circle of imports", &found, 0, &[]);
}

/// Returns the names that a module re-exports. Each is a pair: its path in this module, and its original path.
fn re_exports(module: &[String], text: &str) -> Vec<(Vec<String>, Vec<String>)> {
    let bare = source::bare(text);
    let uses = bare.split(';').filter_map(|item| item.trim().rsplit_once("pub use ").map(|(_, tree)| tree.to_owned()));
    let paths = uses.flat_map(|tree| source::paths(&format!("use {tree};")));
    paths
        .filter(|path| path.len() > 1 && !["crate", "super"].contains(&path[0].as_str()))
        .map(|path| {
            let name = path.last().cloned().into_iter();
            let from = path.iter().filter(|word| *word != "self").cloned();
            (module.iter().cloned().chain(name).collect(), module.iter().cloned().chain(from).collect())
        })
        .collect()
}

/// Returns a path as written in `module`, resolved from the root of the crate; `None` if it leads to another crate.
/// `is_child`: `true` for the name of a child module of `module`.
fn full_path(path: &[String], module: &[String], is_child: impl Fn(&String) -> bool) -> Option<Vec<String>> {
    let mut base = module.to_vec();
    let mut rest = path;
    match rest.first()?.as_str() {
        "crate" => base.clear(),
        "super" | "self" => {}
        _ if is_child(rest.first()?) => {}
        _ => return None,
    }
    while let Some(first) = rest.first().filter(|word| ["super", "crate", "self"].contains(&word.as_str())) {
        if first == "super" {
            base.pop();
        }
        rest = &rest[1..];
    }
    base.extend(rest.iter().cloned());
    Some(base)
}

#[test]
fn a_crate_has_each_type_name_once() {
    let mut found: BTreeMap<String, usize> = BTreeMap::new();
    // The boards are excluded: their contract demands the same type names from each board.
    for folder in CRATES.into_iter().filter(|folder| *folder != "boards") {
        for (_, items) in items(folder) {
            for item in items.iter().filter(|item| ["struct", "enum", "trait"].contains(&item.kind.as_str())) {
                // Do not count a type that a macro declares as `$name`: its name is known only where the macro is
                // used.
                if item.name != "$" {
                    *found.entry(format!("{folder} {}", item.name)).or_default() += 1;
                }
            }
        }
    }
    assert!(found.len() > 100);
    judge("types of this name", &found, 1, SAME_NAMES);
}

mod the_shape_itself {
    use super::*;

    fn tokens(text: &str) -> Vec<String> {
        source::lex(&source::bare(text))
    }

    #[test]
    fn finds_items_functions_and_calls() {
        let text = "pub struct A<const N: usize> {\n  #[allow(x)]\n  pub a: [u8; N],\n  b: fn(x: u8) -> B<C>,\n}\n\
                    impl<const N: usize> A<N> {\n  pub const fn f(&self, a: [u8; 2])\n  -> u8 {\n    0\n  }\n  fn g(&mut self) { self.f(); }\n}\n\
                    impl Trait for B {}\nfn free() {}\nstruct Unit;\nenum E { A { x: u8 } }";
        let items = source::items(&tokens(text));
        let kinds: Vec<(&str, &str)> = items.iter().map(|item| (item.kind.as_str(), item.name.as_str())).collect();
        assert_eq!(
            kinds,
            [("struct", "A"), ("impl", "A"), ("impl", "B"), ("fn", "free"), ("struct", "Unit"), ("enum", "E")]
        );
        assert_eq!(items[1].functions(), ["f", "g"]);
        assert_eq!(source::calls_of_self(&items[1].body), ["f"]);
    }

    #[test]
    fn finds_circles() {
        let edge = |from: &str, to: &str| (from.to_owned(), BTreeSet::from([to.to_owned()]));
        let graph = BTreeMap::from([edge("a", "b"), edge("b", "c"), edge("c", "b"), edge("d", "a")]);
        assert_eq!(circles(&graph), 2);
    }

    #[test]
    fn judges_in_both_directions() {
        let found = BTreeMap::from([("a".to_owned(), 5)]);
        judge("x", &found, 5, &[]);
        judge("x", &found, 3, &[("a", 5)]);
        for (limit, listed) in
            [(3, &[][..]), (3, &[("a", 4)][..]), (3, &[("a", 6)][..]), (5, &[("a", 5)][..]), (9, &[("gone", 5)][..])]
        {
            assert!(std::panic::catch_unwind(|| judge("x", &found, limit, listed)).is_err());
        }
    }
}
