//! Configures cargo for releases: paths of the build computer do not get into the results, so the same sources give the
//! same bytes in any folder. Builds for boards also get the compiler flags for their cargo profile (built for speed or
//! for size).
//!
//! rustc replaces each machine-dependent folder by a fixed name: the workspace, cargo's copies of dependencies, and the
//! sources of the standard library.

use crate::{Failure, TARGET, boards, cargo, root};
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

/// Compiler flags for images built for speed. `target-cpu`: schedules instructions for the processor of all boards.
/// `inline-threshold`: maximum cost, by LLVM's measure, of a function that is inlined without `#[inline]`. LLVM's
/// default threshold is about twice as high; with it, images are larger and hardly any path is faster (docs/cost.md,
/// "Small parts").
const FOR_SPEED: [&str; 2] = ["-Ctarget-cpu=cortex-m4", "-Cllvm-args=-inline-threshold=120"];

/// Limits inlining in images built for size. The limit is below the compiler's default for such builds.
const FOR_SIZE: [&str; 1] = ["-Cllvm-args=-inline-threshold=30"];

/// Returns a cargo command for release files, in the workspace. `RUSTFLAGS` of the environment do not affect it.
pub fn cargo_without_paths() -> Result<Command, Failure> {
    cargo_with(&[])
}

/// Returns a cargo command for code that runs on boards, with one of their profiles.
pub fn cargo_for_boards(command: &str, profile: &str) -> Result<Command, Failure> {
    cargo_for(command, profile, TARGET)
}

/// Like [`cargo_for_boards`], for another target and without the flags for the boards' processor.
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
    // In this variable the byte 0x1F separates the flags.
    cargo.env("CARGO_ENCODED_RUSTFLAGS", flags.join("\x1f"));
    Ok(cargo)
}

/// The compiler that cargo uses.
pub struct Compiler {
    /// Version of the compiler, such as `1.95.0`.
    pub version: String,
    /// Target of the compiler if none is given, such as `x86_64-unknown-linux-gnu`.
    pub host: String,
    /// Git commit of the compiler's sources. The path of the standard library is replaced by `/rustc/COMMIT`.
    commit: String,
    sysroot: PathBuf,
}

impl Compiler {
    /// Runs rustc to read its version, default target, commit and installation folder.
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

/// Runs rustc with these arguments and returns its standard output.
fn ask(arguments: &[&str]) -> Result<String, Failure> {
    let mut rustc = Command::new(std::env::var_os("RUSTC").unwrap_or_else(|| "rustc".into()));
    let output = rustc.current_dir(root()).args(arguments).output();
    let output = output.map_err(|error| format!("rustc cannot be started: {error}"))?;
    if !output.status.success() {
        return Err(format!("rustc failed: {}", String::from_utf8_lossy(&output.stderr)));
    }
    String::from_utf8(output.stdout).map_err(|error| format!("rustc: {error}"))
}

/// Returns cargo's own folder: `CARGO_HOME`, or `.cargo` in the home folder.
pub fn cargo_home() -> Result<PathBuf, Failure> {
    let home = || Some(std::env::home_dir()?.join(".cargo"));
    std::env::var_os("CARGO_HOME").map(PathBuf::from).or_else(home).ok_or_else(|| "no CARGO_HOME and no HOME".into())
}

/// Returns the folders whose paths can get into a build's results, each with the name that replaces it.
fn names(
    workspace: &Path,
    cargo_home: &Path,
    compiler: &Compiler,
) -> Result<impl Iterator<Item = (PathBuf, String)> + use<>, Failure> {
    // Each registry has its own folder, whose name depends on how cargo accesses the registry. The folders of the
    // registries in use exist, because xtask itself has dependencies.
    let registries = cargo_home.join("registry/src");
    let entries = fs::read_dir(&registries).map_err(|error| format!("{}: {error}", registries.display()))?;
    let mut sources: Vec<PathBuf> = entries.flatten().map(|entry| entry.path()).collect();
    sources.sort();
    let library = (compiler.sysroot.join("lib/rustlib/src/rust"), format!("/rustc/{}", compiler.commit));
    let registries = sources.into_iter().map(|source| (source, "/registry".to_owned()));
    let all = [(workspace.to_owned(), "/oxmill".to_owned()), library].into_iter().chain(registries);
    // A folder that is reached through a symbolic link has two names. Builds can contain both, because compilers run in
    // the folder under its real name.
    Ok(all.flat_map(|(from, to)| {
        let real = from.canonicalize().ok().filter(|real| *real != from);
        [Some((from, to.clone())), real.map(|real| (real, to))].into_iter().flatten()
    }))
}

/// Returns rustc's argument that replaces the folder `from` by the name `to`.
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
