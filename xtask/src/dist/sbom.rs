//! Bills of materials (SBOM) in CycloneDX 1.5 JSON: what is linked into a file, with licence and checksum of each crate.
//!
//! Made from `cargo tree` (which crates are linked, for this target and these features), `cargo metadata` (what they are) and
//! the lock files. No time and no random number is in them: the same sources give the same bytes.

use super::{Failure, VERSION, read, write};
use crate::paths::Compiler;
use crate::{TARGET, cargo, root, web};
use serde_json::{Value, json};
use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

/// What a bill is about.
pub struct Sbom {
    /// The name of what is made.
    name: String,
    /// Its kind, as CycloneDX has it.
    kind: &'static str,
    package: &'static str,
    target: String,
    features: Option<String>,
    /// Packages of npm that are bundled.
    npm: bool,
}

impl Sbom {
    /// The image of a board.
    pub fn of_board(board: &str) -> Sbom {
        let (package, features) = ("oxmill-firmware", Some(board.to_owned()));
        Sbom { name: board.into(), kind: "firmware", package, target: TARGET.into(), features, npm: false }
    }

    /// The program for a host.
    pub fn of_program(target: &str) -> Sbom {
        let (name, package) = ("oxmill".into(), "oxmill");
        Sbom { name, kind: "application", package, target: target.into(), features: None, npm: false }
    }

    /// The page and the module in it.
    pub fn of_page() -> Sbom {
        let (name, package) = ("oxmill.html".into(), "oxmill-web");
        Sbom { name, kind: "application", package, target: web::MODULE.into(), features: None, npm: true }
    }

    /// Writes it.
    pub fn write(&self, compiler: &Compiler, path: &Path) -> Result<(), Failure> {
        let metadata: Value = parsed(&told(&["metadata", "--locked", "--format-version", "1"])?)?;
        let lock: toml::Table = text(&root().join("Cargo.lock"))?.parse().map_err(|e| format!("Cargo.lock: {e}"))?;
        let mut crates = Crates::new(&metadata, &lock)?;
        crates.keep(&linked(&self.tree()?));
        let npm = if self.npm { npm(&parsed(&text(&web::page().join("package-lock.json"))?)?) } else { Vec::new() };
        let bill = self.bill(&crates, npm, &compiler.version)?;
        let json = serde_json::to_string_pretty(&bill).map_err(|error| error.to_string())?;
        write(path, format!("{json}\n").as_bytes())
    }

    /// All crates that are linked, as cargo lists them.
    fn tree(&self) -> Result<String, Failure> {
        let mut arguments = vec!["tree", "--locked", "--package", self.package, "--target", &self.target];
        arguments.extend(["--edges", "normal,no-proc-macro", "--prefix", "none", "--format", "{p}"]);
        if let Some(features) = &self.features {
            arguments.extend(["--features", features]);
        }
        told(&arguments)
    }

    fn bill(&self, crates: &Crates, npm: Vec<Value>, rust: &str) -> Result<Value, Failure> {
        let root = format!("{}@{VERSION}", self.package);
        let own = |component: &Value| component["bom-ref"] == root.as_str();
        let mut components = crates.components()?;
        if !components.iter().any(own) {
            return Err(format!("cargo does not list {root}"));
        }
        components.retain(|component| !own(component));
        components.push(json!({
            "type": "library", "bom-ref": format!("rust-std@{rust}"), "name": "rust-std", "version": rust,
            "description": "The standard library of Rust, as the compiler brings it",
            "licenses": [{ "expression": "MIT OR Apache-2.0" }],
        }));
        components.extend(npm);
        Ok(json!({
            "$schema": "http://cyclonedx.org/schema/bom-1.5.schema.json",
            "bomFormat": "CycloneDX", "specVersion": "1.5", "version": 1,
            "metadata": {
                "component": {
                    "type": self.kind, "bom-ref": root, "name": self.name, "version": VERSION,
                    "licenses": [{ "expression": "MIT OR Apache-2.0" }],
                    "properties": [{ "name": "oxmill:target", "value": self.target }],
                },
                "tools": { "components": [{ "type": "application", "name": "rustc", "version": rust }] },
            },
            "components": components,
            "dependencies": crates.dependencies(),
        }))
    }
}

/// What cargo answers.
fn told(arguments: &[&str]) -> Result<String, Failure> {
    let output = cargo().args(arguments).output().map_err(|error| format!("cargo: {error}"))?;
    if !output.status.success() {
        return Err(format!("cargo {}: {}", arguments[0], String::from_utf8_lossy(&output.stderr)));
    }
    String::from_utf8(output.stdout).map_err(|error| error.to_string())
}

fn text(path: &Path) -> Result<String, Failure> {
    String::from_utf8(read(path)?).map_err(|error| format!("{}: {error}", path.display()))
}

fn parsed(text: &str) -> Result<Value, Failure> {
    serde_json::from_str(text).map_err(|error| error.to_string())
}

/// Name and version of a crate: `heapless@0.9.1`.
type Name = String;

/// Names of the crates in the lines of `cargo tree`: `heapless v0.9.1 (*)`.
fn linked(tree: &str) -> BTreeSet<Name> {
    let name = |line: &str| {
        let mut words = line.split_whitespace();
        Some(format!("{}@{}", words.next()?, words.next()?.strip_prefix('v')?))
    };
    tree.lines().filter_map(name).collect()
}

/// What is known of crates.
struct Crates {
    packages: BTreeMap<Name, Value>,
    needs: BTreeMap<Name, BTreeSet<Name>>,
    checksums: BTreeMap<Name, String>,
}

impl Crates {
    /// All crates of the lock file.
    fn new(metadata: &Value, lock: &toml::Table) -> Result<Crates, Failure> {
        let list = |value: &Value| value.as_array().cloned().unwrap_or_default();
        let word = |value: &Value| value.as_str().unwrap_or_default().to_owned();
        let mut packages = BTreeMap::new();
        let mut names = BTreeMap::new();
        for package in list(&metadata["packages"]) {
            let name = format!("{}@{}", word(&package["name"]), word(&package["version"]));
            names.insert(word(&package["id"]), name.clone());
            packages.insert(name, package);
        }
        let named = |id: &Value| names.get(&word(id)).cloned().ok_or_else(|| format!("cargo does not describe {id}"));
        let mut needs = BTreeMap::new();
        for node in list(&metadata["resolve"]["nodes"]) {
            let linked = |dep: &&Value| list(&dep["dep_kinds"]).iter().any(|kind| kind["kind"].is_null());
            let deps = list(&node["deps"]);
            let used: Result<_, Failure> = deps.iter().filter(linked).map(|dep| named(&dep["pkg"])).collect();
            needs.insert(named(&node["id"])?, used?);
        }
        let mut checksums = BTreeMap::new();
        for package in lock.get("package").and_then(toml::Value::as_array).into_iter().flatten() {
            let word = |key: &str| package.get(key).and_then(toml::Value::as_str);
            if let (Some(name), Some(version), Some(sum)) = (word("name"), word("version"), word("checksum")) {
                checksums.insert(format!("{name}@{version}"), sum.to_owned());
            }
        }
        Ok(Crates { packages, needs, checksums })
    }

    /// Forgets all others.
    fn keep(&mut self, names: &BTreeSet<Name>) {
        self.packages.retain(|name, _| names.contains(name));
        self.needs.retain(|name, _| names.contains(name));
        for needed in self.needs.values_mut() {
            needed.retain(|name| names.contains(name));
        }
    }

    fn components(&self) -> Result<Vec<Value>, Failure> {
        let component = |(name, package): (&Name, &Value)| {
            let licence = package["license"].as_str().ok_or_else(|| format!("{name} does not say its licence"))?;
            let mut component = json!({
                "type": "library", "bom-ref": name, "name": package["name"], "version": package["version"],
                // An old way to write it.
                "licenses": [{ "expression": licence.replace('/', " OR ") }],
            });
            // Crates of the workspace are in no registry.
            if !package["source"].is_null() {
                let sum = self.checksums.get(name).ok_or_else(|| format!("Cargo.lock has no checksum of {name}"))?;
                component["purl"] = json!(format!("pkg:cargo/{name}"));
                component["hashes"] = json!([{ "alg": "SHA-256", "content": sum }]);
            }
            Ok(component)
        };
        self.packages.iter().map(component).collect()
    }

    fn dependencies(&self) -> Vec<Value> {
        self.needs.iter().map(|(name, needed)| json!({ "ref": name, "dependsOn": needed })).collect()
    }
}

/// Packages of npm that are more than tools: those that a bundle may have in it.
fn npm(lock: &Value) -> Vec<Value> {
    let packages = lock["packages"].as_object().into_iter().flatten();
    let bundled = packages.filter(|(path, package)| !path.is_empty() && package["dev"] != true);
    let component = |(path, package): (&String, &Value)| {
        let name = path.rsplit("node_modules/").next().unwrap_or_default();
        let version = package["version"].as_str().unwrap_or_default();
        json!({
            "type": "library", "bom-ref": format!("npm:{name}@{version}"), "name": name, "version": version,
            "licenses": [{ "expression": package["license"] }],
            "purl": format!("pkg:npm/{}@{version}", name.replace('@', "%40")),
        })
    };
    bundled.map(component).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn crates(keep: &[&str]) -> Crates {
        let metadata = json!({
            "packages": [
                { "id": "p 1", "name": "program", "version": "1.0.0", "license": "MIT", "source": null },
                { "id": "l 2", "name": "library", "version": "2.0.0", "license": "MIT/Apache-2.0", "source": "registry" },
                { "id": "t 3", "name": "tool", "version": "3.0.0", "license": "MIT", "source": "registry" },
            ],
            "resolve": { "nodes": [
                { "id": "p 1", "deps": [
                    { "pkg": "l 2", "dep_kinds": [{ "kind": null }] }, { "pkg": "t 3", "dep_kinds": [{ "kind": "build" }] },
                ] },
                { "id": "l 2", "deps": [] }, { "id": "t 3", "deps": [] },
            ] },
        });
        let lock = "[[package]]\nname = \"library\"\nversion = \"2.0.0\"\nchecksum = \"abcd\"\n".parse().unwrap();
        let mut crates = Crates::new(&metadata, &lock).unwrap();
        crates.keep(&keep.iter().map(|name| (*name).to_owned()).collect());
        crates
    }

    #[test]
    fn a_bill_has_what_is_linked_and_nothing_else() {
        let crates = crates(&["program@1.0.0", "library@2.0.0"]);
        let components = crates.components().unwrap();
        assert_eq!(components.len(), 2);
        assert_eq!(components[0]["purl"], "pkg:cargo/library@2.0.0");
        assert_eq!(components[0]["hashes"][0]["content"], "abcd");
        assert_eq!(components[0]["licenses"][0]["expression"], "MIT OR Apache-2.0");
        assert!(components[1]["purl"].is_null() && components[1]["hashes"].is_null());
        let needs = crates.dependencies();
        assert_eq!(needs[1], json!({ "ref": "program@1.0.0", "dependsOn": ["library@2.0.0"] }));
    }

    #[test]
    fn a_crate_of_a_registry_without_checksum_is_refused() {
        assert!(crates(&["tool@3.0.0"]).components().unwrap_err().contains("checksum"));
    }

    #[test]
    fn lines_of_cargo_tree() {
        let tree = "heapless v0.9.1\noxmill-sqrt v0.2.0 (/somewhere/src/sqrt)\nheapless v0.9.1 (*)\n\n";
        assert_eq!(linked(tree), ["heapless@0.9.1", "oxmill-sqrt@0.2.0"].map(str::to_owned).into());
    }

    #[test]
    fn tools_of_npm_are_no_part_of_the_page() {
        let tool = json!({ "version": "1.0.0", "dev": true, "license": "MIT" });
        let bundled = json!({ "version": "2.0.0", "license": "ISC" });
        let lock = json!({ "packages": { "": {}, "node_modules/tool": tool, "node_modules/@a/b": bundled } });
        let found = npm(&lock);
        assert_eq!(found.len(), 1);
        assert_eq!(found[0]["purl"], "pkg:npm/%40a/b@2.0.0");
    }

    /// The boards differ in what is linked: USB is not for the Nucleos.
    #[test]
    fn the_features_of_a_board_are_seen() {
        let has_usb =
            |board: &str| linked(&Sbom::of_board(board).tree().unwrap()).iter().any(|n| n.starts_with("usb-device@"));
        assert!(has_usb("blackpill_f411") && !has_usb("nucleo_f446re"));
    }
}
