//! Builds the WebAssembly module and the web page that contains it, and tests both in a browser.

use crate::paths::cargo_without_paths;
use crate::{Failure, cargo, exists, image, root, run};
use std::fs;
use std::path::PathBuf;
use std::process::Command;

/// Name of the npm program: a script on Windows.
const NPM: &str = if cfg!(windows) { "npm.cmd" } else { "npm" };

/// Board whose image the tests of the page load.
const LOADED: &str = "blackpill_f411";

/// Rust target of the WebAssembly module.
pub const MODULE: &str = "wasm32-unknown-unknown";

/// Builds the module and the page into `target/web`.
pub fn build() -> Result<(), Failure> {
    module()?;
    tools()?;
    run(in_page(NPM).args(["run", "--silent", "types"]))?;
    run(in_page(NPM).args(["run", "--silent", "build"]))?;
    println!("{}", root().join("target/web/oxmill.html").display());
    Ok(())
}

/// Tests the page in a browser, together with the program of this host. `names` are the tests to run; all if empty.
pub fn test(names: &[&str]) -> Result<(), Failure> {
    build()?;
    run(cargo().args(["build", "--quiet", "--locked", "--release", "--package", "oxmill"]))?;
    // An existing image may come from an earlier state of the tree. It needs only the present form of pin tables.
    if !root().join("target/boards").join(format!("{LOADED}.dfu")).exists() {
        image::build(LOADED)?;
    }
    run(in_page("node").arg("tests/run.mjs").args(names))
}

/// Takes the screenshots of the README (`docs/pictures/*.png`).
pub fn pictures() -> Result<(), Failure> {
    build()?;
    run(in_page("node").arg("tests/pictures.mjs"))
}

/// Builds the WebAssembly module and copies it to `target/web/oxmill.wasm`.
fn module() -> Result<(), Failure> {
    let built = run(cargo_without_paths()?.args([
        "build",
        "--quiet",
        "--locked",
        "--package",
        "oxmill-web",
        "--profile",
        "web",
        "--target",
        MODULE,
    ]));
    built.map_err(|why| format!("{why}\nif the target is missing: rustup target add {MODULE}"))?;
    let folder = root().join("target/web");
    let from = root().join("target").join(MODULE).join("web/oxmill_web.wasm");
    let failed = |error: std::io::Error| format!("{}: {error}", from.display());
    fs::create_dir_all(&folder).map_err(failed)?;
    fs::copy(&from, folder.join("oxmill.wasm")).map_err(failed)?;
    Ok(())
}

/// Installs the page's npm packages in the versions of `package-lock.json`. Does this only if that file is newer than
/// the last installation, or if there was no installation.
fn tools() -> Result<(), Failure> {
    if !exists(NPM) {
        return Err("Node.js with npm is missing: the page is written in TypeScript".into());
    }
    let (lock, installed) = (page().join("package-lock.json"), page().join("node_modules/.package-lock.json"));
    let time = |path: &PathBuf| fs::metadata(path).and_then(|about| about.modified()).ok();
    if time(&installed).is_some_and(|done| time(&lock).is_some_and(|wanted| wanted <= done)) {
        return Ok(());
    }
    run(in_page(NPM).args(["ci", "--silent", "--ignore-scripts"]))
}

pub fn page() -> PathBuf {
    root().join("src/web/page")
}

fn in_page(program: &str) -> Command {
    let mut command = Command::new(program);
    command.current_dir(page());
    command
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::Value;

    fn parsed(name: &str) -> Value {
        serde_json::from_str(&fs::read_to_string(page().join(name)).unwrap()).unwrap()
    }

    /// Returns the lowest major version in the last part of a range: 18 for `>=18`, 10 for `6.* || >= 10.*`.
    fn lowest_major(range: &str) -> u32 {
        let last = range.rsplit("||").next().unwrap_or_default();
        let last = last.trim_start_matches(|c: char| !c.is_ascii_digit());
        last.split(|c: char| !c.is_ascii_digit()).next().and_then(|digits| digits.parse().ok()).unwrap_or(0)
    }

    /// `.ci/run` compares the installed Node.js with the version in `package.json`, so that version must be the one
    /// that the page's tools need.
    #[test]
    fn the_page_asks_for_the_node_that_its_tools_need() {
        assert_eq!(["*", ">=18", "6.* || >= 10.*", ">= 10.17.0", "^20.1"].map(lowest_major), [0, 18, 10, 10, 20]);
        let lock = parsed("package-lock.json");
        let tools = lock["packages"].as_object().unwrap().iter().filter(|(path, _)| !path.is_empty());
        let needed = tools.filter_map(|(_, tool)| tool["engines"]["node"].as_str()).map(lowest_major).max().unwrap();
        assert_eq!(parsed("package.json")["engines"]["node"], format!(">={needed}"));
        assert_eq!(lock["packages"][""]["engines"], parsed("package.json")["engines"]);
    }
}
