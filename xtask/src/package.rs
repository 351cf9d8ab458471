//! `cargo xtask package`: the crates as `cargo package` packs them. No crate may need files from outside its folder.

use crate::{Failure, TARGET, cargo, root, run, web};
use flate2::read::GzDecoder;
use std::fs;
use std::path::{Path, PathBuf};

/// Packages that are used only within this workspace and not published.
const OWN: [&str; 4] = ["xtask", "oxmill-fuzz", "oxmill-test-support", "oxmill-on-target"];

/// The board whose image is built from the packages.
const BOARD: &str = "blackpill_f411";

/// Paths that no package may contain.
const UNWANTED: [&str; 5] = ["target/", "node_modules/", "docs/", ".ci/", ".github/"];

/// Manifest of a workspace that consists of the packages alone. A line for each package is added below
/// `[patch.crates-io]`, so that packages use each other from this workspace and not from a registry.
const MANIFEST: &str = "[workspace]\nmembers = [\"*\"]\nresolver = \"3\"\n\n\
                        [profile.release]\nopt-level = \"s\"\nlto = \"fat\"\ncodegen-units = 1\n\n[patch.crates-io]\n";

/// Packs all crates and prints their numbers of files.
pub fn list() -> Result<(), Failure> {
    for (package, files) in packed()? {
        println!("{}: {} files", package.display(), files.len());
    }
    Ok(())
}

/// Packs all crates, unpacks them into a workspace of their own, and builds the program, the WebAssembly module and an
/// STM32 image in it.
pub fn build() -> Result<(), Failure> {
    let folder = root().join("target/packaged");
    // Only the packages of an earlier run are deleted; its build results stay. The workspace gets a copy of the lock
    // file.
    let failed = |error: std::io::Error| format!("{}: {error}", folder.display());
    let packages = folder.join("packages");
    if packages.exists() {
        fs::remove_dir_all(&packages).map_err(failed)?;
    }
    fs::create_dir_all(&packages).map_err(failed)?;
    let mut manifest = MANIFEST.to_owned();
    for (package, _) in packed()? {
        archive(&package)?.unpack(&packages).map_err(failed)?;
        let folder = package.file_stem().unwrap_or_default().to_string_lossy().into_owned();
        let name = folder.rsplit_once('-').map_or(&*folder, |(name, _)| name);
        manifest += &format!("{name} = {{ path = \"{folder}\" }}\n");
    }
    fs::write(packages.join("Cargo.toml"), manifest).map_err(failed)?;
    fs::copy(root().join("Cargo.lock"), packages.join("Cargo.lock")).map_err(failed)?;
    let cargo = |arguments: &[&str]| {
        run(cargo().current_dir(&packages).env("CARGO_TARGET_DIR", folder.join("target")).args(arguments))
    };
    cargo(&["build", "--package", "oxmill"])?;
    cargo(&["build", "--release", "--package", "oxmill-web", "--target", web::MODULE])?;
    cargo(&["build", "--release", "--package", "oxmill-firmware", "--target", TARGET, "--features", BOARD])
}

/// Packs all crates; returns each archive with the names of its files.
fn packed() -> Result<Vec<(PathBuf, Vec<String>)>, Failure> {
    let folder = root().join("target/package");
    if folder.exists() {
        fs::remove_dir_all(&folder).map_err(|error| format!("{}: {error}", folder.display()))?;
    }
    let mut package = cargo();
    // The crates are not in a registry, so cargo cannot resolve their dependencies on each other there: they are
    // neither built (`--no-verify`) nor packed with a lock file.
    package.args(["package", "--quiet", "--workspace", "--no-verify", "--exclude-lockfile", "--allow-dirty"]);
    run(package.args(OWN.iter().flat_map(|name| ["--exclude", name])))?;
    let entries = fs::read_dir(&folder).map_err(|error| format!("{}: {error}", folder.display()))?;
    let mut packages: Vec<PathBuf> = entries.flatten().map(|entry| entry.path()).collect();
    packages.retain(|path| path.extension().is_some_and(|ending| ending == "crate"));
    packages.sort();
    packages.into_iter().map(|package| names(&package).map(|names| (package, names))).collect()
}

/// Returns the names of the files in a package. Fails if the package has no manifest or no source, or has one of
/// [`UNWANTED`].
fn names(package: &Path) -> Result<Vec<String>, Failure> {
    let failed = |error: std::io::Error| format!("{}: {error}", package.display());
    let mut names = Vec::new();
    for entry in archive(package)?.entries().map_err(failed)? {
        let entry = entry.map_err(failed)?;
        let path = entry.path().map_err(failed)?;
        names.push(path.components().skip(1).collect::<PathBuf>().to_string_lossy().into_owned());
    }
    match fault(&names) {
        Some(why) => Err(format!("{} {why}", package.display())),
        None => Ok(names),
    }
}

/// Returns what is wrong with the files of a package; `None` if nothing is.
fn fault(names: &[String]) -> Option<String> {
    let has = |end: &str| names.iter().any(|name| name.ends_with(end));
    if !has("Cargo.toml") || !has(".rs") {
        return Some("has no manifest or no source".into());
    }
    let unwanted =
        |name: &&String| UNWANTED.iter().any(|folder| name.starts_with(folder) || name.contains(&format!("/{folder}")));
    names.iter().find(unwanted).map(|name| format!("has {name}"))
}

fn archive(package: &Path) -> Result<tar::Archive<GzDecoder<fs::File>>, Failure> {
    let file = fs::File::open(package).map_err(|error| format!("{}: {error}", package.display()))?;
    Ok(tar::Archive::new(GzDecoder::new(file)))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn unwanted_files_are_seen() {
        let names = |names: &[&str]| names.iter().map(|name| (*name).to_owned()).collect::<Vec<_>>();
        assert_eq!(fault(&names(&["Cargo.toml", "lib.rs"])), None);
        assert!(fault(&names(&["Cargo.toml"])).is_some());
        assert!(fault(&names(&["lib.rs"])).is_some());
        assert!(
            fault(&names(&["Cargo.toml", "lib.rs", "page/node_modules/x/index.js"])).unwrap().contains("node_modules")
        );
        assert!(fault(&names(&["Cargo.toml", "lib.rs", "docs/x.md"])).is_some());
    }
}
