//! `cargo xtask dist --check`: makes the files of a release twice. The second time, cargo runs in a copy of the tree on
//! another path, with another `CARGO_HOME`. All files must have the same bytes both times.

use super::{Failure, files, folder, make, root};
use crate::paths::cargo_home;
use crate::{TREE, run, tree};
use std::fs;
use std::path::Path;
use std::process::Command;

/// Parts of the tree that builds do not use.
const LEFT_OUT: [&str; 2] = ["target", ".git"];

/// Makes the named parts of a release twice, or all parts if `names` is empty. Fails if a byte differs.
pub fn check(names: &[&str]) -> Result<(), Failure> {
    make(names)?;
    // The copy lies below the tree itself. Its path begins with the path of the tree, but has another length.
    let second = root().join("target/reproducible");
    let (copy, home) = (second.join("on/another/path"), second.join("another-cargo-home"));
    if second.exists() {
        fs::remove_dir_all(&second).map_err(|error| format!("{}: {error}", second.display()))?;
    }
    copy_tree(&copy)?;
    link_home(&cargo_home()?, &home)?;
    println!("once more, in {}", copy.display());
    let program = std::env::current_exe().map_err(|error| error.to_string())?;
    run(Command::new(program).arg("dist").args(names).env(TREE, &copy).env("CARGO_HOME", &home))?;
    let (here, there) = (files(&folder())?, files(&copy.join("target/dist"))?);
    let differing = differences(&here, &there);
    if !differing.is_empty() {
        return Err(format!("two builds on two paths differ:\n{}", differing.join("\n")));
    }
    fs::remove_dir_all(&second).map_err(|error| format!("{}: {error}", second.display()))?;
    println!("two builds on two paths: {} files, the same bytes", here.len());
    Ok(())
}

fn copy_tree(to: &Path) -> Result<(), Failure> {
    fs::create_dir_all(to).map_err(|error| format!("{}: {error}", to.display()))?;
    for entry in fs::read_dir(root()).map_err(|error| error.to_string())?.flatten() {
        let name = entry.file_name();
        if !LEFT_OUT.iter().any(|left_out| name == *left_out) {
            tree::copy(&entry.path(), &to.join(name))?;
        }
    }
    Ok(())
}

/// Makes another cargo folder that shares the downloads and the configuration of the first one by symbolic links.
#[cfg(unix)]
fn link_home(home: &Path, to: &Path) -> Result<(), Failure> {
    fs::create_dir_all(to).map_err(|error| format!("{}: {error}", to.display()))?;
    for name in ["registry", "git", "config.toml"] {
        if home.join(name).exists() {
            let linked = std::os::unix::fs::symlink(home.join(name), to.join(name));
            linked.map_err(|error| format!("{}: {error}", to.join(name).display()))?;
        }
    }
    Ok(())
}

#[cfg(not(unix))]
fn link_home(_: &Path, _: &Path) -> Result<(), Failure> {
    Err("`dist --check` needs the symbolic links of Unix".into())
}

/// Returns a message for each file that only one side has, and for each file whose bytes differ.
fn differences(here: &[(String, Vec<u8>)], there: &[(String, Vec<u8>)]) -> Vec<String> {
    let missing = |these: &[(String, Vec<u8>)], name: &str| !these.iter().any(|(other, _)| other == name);
    let alone = here
        .iter()
        .filter(|(name, _)| missing(there, name))
        .chain(there.iter().filter(|(name, _)| missing(here, name)));
    let mut found: Vec<String> = alone.map(|(name, _)| format!("{name} is made by one of them only")).collect();
    for (name, bytes) in here {
        if let Some((_, others)) = there.iter().find(|(other, _)| other == name)
            && bytes != others
        {
            let at = bytes.iter().zip(others).take_while(|(a, b)| a == b).count();
            found.push(format!("{name}, {} and {} bytes, from byte {at} on", bytes.len(), others.len()));
        }
    }
    found
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_difference_is_told() {
        let file = |name: &str, bytes: &[u8]| (name.to_owned(), bytes.to_vec());
        let here = [file("a", b"same"), file("b", b"once"), file("c", b"only here")];
        assert_eq!(differences(&here, &here), Vec::<String>::new());
        let there = [file("a", b"same"), file("b", b"once more"), file("d", b"")];
        let found = differences(&here, &there);
        assert_eq!(found.len(), 3, "{found:?}");
        assert!(found[2].contains("from byte 4 on"), "{found:?}");
    }
}
