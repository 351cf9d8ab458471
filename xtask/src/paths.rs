//! How cargo builds what is released: without the paths of the machine, so that the same sources give the same bytes
//! wherever they lie, and what runs on boards with the flags of its profile.
//!
//! rustc is told to write a fixed name instead of each folder that differs from machine to machine: the workspace, cargo's
//! copies of dependencies, and the sources of the standard library.

use crate::{Failure, TARGET, boards, cargo, root};
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

/// What images that are built for speed are compiled with besides: instructions in the order that is best for the processor
/// of all boards, and a limit of how costly a function may be, by LLVM's measure, to be inlined without `#[inline]`. Its own
/// limit is about twice that: it makes images larger and hardly any path faster (docs/cost.md, "Small parts").
const FOR_SPEED: [&str; 2] = ["-Ctarget-cpu=cortex-m4", "-Cllvm-args=-inline-threshold=120"];

/// The same limit for images that are built for size, below the compiler's own for those, too.
const FOR_SIZE: [&str; 1] = ["-Cllvm-args=-inline-threshold=30"];

/// Cargo, in the workspace, for what is released. `RUSTFLAGS` of the environment do not reach such a build.
pub fn cargo_without_paths() -> Result<Command, Failure> {
    cargo_with(&[])
}

/// A command of cargo on what runs on boards, with a profile of theirs.
pub fn cargo_for_boards(command: &str, profile: &str) -> Result<Command, Failure> {
    cargo_for(command, profile, TARGET)
}

/// The same for another target, whose processor is its own.
pub fn cargo_for(command: &str, profile: &str, target: &str) -> Result<Command, Failure> {
    let flags: &[&str] = if profile == boards::FAST { &FOR_SPEED } else { &FOR_SIZE };
    let flags: Vec<&str> =
        flags.iter().filter(|flag| target == TARGET || !flag.starts_with("-Ctarget-cpu")).copied().collect();
    let mut cargo = cargo_with(&flags)?;
    cargo.args([command, "--profile", profile, "--target", target]);
    Ok(cargo)
}

fn cargo_with(more: &[&str]) -> Result<Command, Failure> {
    let names = names(&root(), &cargo_home()?, &Compiler::found()?)?;
    let flags: Vec<String> =
        names.map(|(from, to)| flag(&from, &to)).chain(more.iter().map(ToString::to_string)).collect();
    let mut cargo = cargo();
    // What separates flags there.
    cargo.env("CARGO_ENCODED_RUSTFLAGS", flags.join("\x1f"));
    Ok(cargo)
}

/// The compiler that cargo uses.
pub struct Compiler {
    /// Its version.
    pub version: String,
    /// The target that it builds for unless it is told another one.
    pub host: String,
    /// The commit of its sources.
    commit: String,
    sysroot: PathBuf,
}

impl Compiler {
    /// Asks the compiler.
    pub fn found() -> Result<Compiler, Failure> {
        let about = ask(&["--version", "--verbose"])?;
        let value = |name: &str| {
            let found = about.lines().find_map(|line| line.strip_prefix(name)?.strip_prefix(": "));
            found.map(str::to_owned).ok_or_else(|| format!("rustc does not say its {name}"))
        };
        let (version, host, commit) = (value("release")?, value("host")?, value("commit-hash")?);
        Ok(Compiler { version, host, commit, sysroot: ask(&["--print", "sysroot"])?.trim().into() })
    }
}

/// What rustc answers.
fn ask(arguments: &[&str]) -> Result<String, Failure> {
    let mut rustc = Command::new(std::env::var_os("RUSTC").unwrap_or_else(|| "rustc".into()));
    let output = rustc.current_dir(root()).args(arguments).output();
    let output = output.map_err(|error| format!("rustc cannot be started: {error}"))?;
    if !output.status.success() {
        return Err(format!("rustc failed: {}", String::from_utf8_lossy(&output.stderr)));
    }
    String::from_utf8(output.stdout).map_err(|error| format!("rustc: {error}"))
}

/// Cargo's own folder.
pub fn cargo_home() -> Result<PathBuf, Failure> {
    let home = || Some(std::env::home_dir()?.join(".cargo"));
    std::env::var_os("CARGO_HOME").map(PathBuf::from).or_else(home).ok_or_else(|| "no CARGO_HOME and no HOME".into())
}

/// The folders that rustc may meet, each with the name that is written instead.
fn names(
    workspace: &Path,
    cargo_home: &Path,
    compiler: &Compiler,
) -> Result<impl Iterator<Item = (PathBuf, String)> + use<>, Failure> {
    // One folder for each registry, by a name that depends on how it is reached. Xtask has dependencies of its own, so what
    // it needs is there.
    let registries = cargo_home.join("registry/src");
    let entries = fs::read_dir(&registries).map_err(|error| format!("{}: {error}", registries.display()))?;
    let mut sources: Vec<PathBuf> = entries.flatten().map(|entry| entry.path()).collect();
    sources.sort();
    let library = (compiler.sysroot.join("lib/rustlib/src/rust"), format!("/rustc/{}", compiler.commit));
    let registries = sources.into_iter().map(|source| (source, "/registry".to_owned()));
    let all = [(workspace.to_owned(), "/oxmill".to_owned()), library].into_iter().chain(registries);
    // A folder behind a symbolic link is met under both of its names: compilers run in it by its real one.
    Ok(all.flat_map(|(from, to)| {
        let real = from.canonicalize().ok().filter(|real| *real != from);
        [Some((from, to.clone())), real.map(|real| (real, to))].into_iter().flatten()
    }))
}

/// The argument for rustc.
fn flag(from: &Path, to: &str) -> String {
    format!("--remap-path-prefix={}={to}", from.display())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_registry_is_renamed() {
        let home = std::env::temp_dir().join(format!("oxmill-cargo-home-{}", std::process::id()));
        fs::create_dir_all(&home).unwrap();
        let home = home.canonicalize().unwrap();
        for name in ["registry-one", "registry-two"] {
            fs::create_dir_all(home.join("registry/src").join(name)).unwrap();
        }
        let compiler =
            Compiler { version: "1".into(), host: "h".into(), commit: "abc".into(), sysroot: "/toolchain".into() };
        let flags: Vec<String> =
            names(Path::new("/tree"), &home, &compiler).unwrap().map(|(from, to)| flag(&from, &to)).collect();
        #[cfg(unix)]
        {
            let link = home.join("link");
            std::os::unix::fs::symlink(&home, &link).unwrap();
            let linked: Vec<PathBuf> =
                names(Path::new("/tree"), &link, &compiler).unwrap().map(|(from, _)| from).collect();
            for home in [&link, &home] {
                assert!(linked.contains(&home.join("registry/src/registry-one")), "{linked:?}");
            }
        }
        fs::remove_dir_all(&home).unwrap();
        let registry = |name: &str| flag(&home.join("registry/src").join(name), "/registry");
        assert_eq!(
            flags,
            [
                "--remap-path-prefix=/tree=/oxmill".to_owned(),
                "--remap-path-prefix=/toolchain/lib/rustlib/src/rust=/rustc/abc".to_owned(),
                registry("registry-one"),
                registry("registry-two"),
            ]
        );
        assert!(names(Path::new("/tree"), &home, &compiler).is_err(), "no registry to be renamed");
    }
}
