//! Bills of materials (SBOM) in CycloneDX 1.5 JSON: the crates linked into a file, each with licence and checksum.
//!
//! The bills are made from `cargo tree` (the linked crates for this target and these features, and their dependencies),
//! `cargo metadata` (properties of the crates) and the lock files. A bill contains no time and no random number, so the
//! same sources give the same bytes.

use super::{Failure, VERSION, read, write};
use crate::paths::Compiler;
use crate::{TARGET, cargo, root, web};
use serde_json::{Value, json};
use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

/// What a bill of materials describes: a file or image, and how cargo builds it.
pub struct Sbom {
    name: String,
    /// CycloneDX component type: `firmware` or `application`.
    kind: &'static str,
    package: &'static str,
    target: String,
    features: Option<String>,
    /// `true` for the web page, which contains npm packages.
    npm: bool,
}

impl Sbom {
    pub fn of_board(board: &str) -> Sbom {
        let (package, features) = ("oxmill-firmware", Some(crate::boards::image(board).to_owned()));
        Sbom { name: board.into(), kind: "firmware", package, target: TARGET.into(), features, npm: false }
    }

    /// Returns what to list for the program `oxmill`. `target`: its Rust target, such as `x86_64-unknown-linux-gnu`.
    pub fn of_program(target: &str) -> Sbom {
        let (name, package) = ("oxmill".into(), "oxmill");
        Sbom { name, kind: "application", package, target: target.into(), features: None, npm: false }
    }

    /// Returns what to list for the web page: the crates of the WebAssembly module in it, and the npm packages.
    pub fn of_page() -> Sbom {
        let (name, package) = ("oxmill.html".into(), "oxmill-web");
        Sbom { name, kind: "application", package, target: web::MODULE.into(), features: None, npm: true }
    }

    pub fn write(&self, compiler: &Compiler, path: &Path) -> Result<(), Failure> {
        let bill = self.bill(&compiler.version)?;
        let json = serde_json::to_string_pretty(&bill).map_err(|error| error.to_string())?;
        write(path, format!("{json}\n").as_bytes())
    }

    /// Returns the output of `cargo tree`: all linked crates, one per line. A crate follows the crate that needs it,
    /// and its depth in the tree stands before its name: `2heapless v0.9.1`.
    fn tree(&self) -> Result<String, Failure> {
        let mut arguments = vec!["tree", "--locked", "--package", self.package, "--target", &self.target];
        arguments.extend(["--edges", "normal,no-proc-macro", "--prefix", "depth", "--no-dedupe", "--format", "{p}"]);
        if let Some(features) = &self.features {
            arguments.extend(["--features", features]);
        }
        told(&arguments)
    }

    fn crates(&self) -> Result<Crates, Failure> {
        // With all features, because the metadata would otherwise lack the crates that only a board's feature needs.
        let metadata = parsed(&told(&["metadata", "--locked", "--all-features", "--format-version", "1"])?)?;
        let lock: toml::Table = text(&root().join("Cargo.lock"))?.parse().map_err(|e| format!("Cargo.lock: {e}"))?;
        Crates::new(&metadata, &lock, linked(&self.tree()?)?)
    }

    fn bill(&self, rust: &str) -> Result<Value, Failure> {
        let crates = self.crates()?;
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
        if self.npm {
            components.extend(npm(&parsed(&text(&web::page().join("package-lock.json"))?)?));
        }
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

/// Runs cargo with these arguments and returns its standard output. If cargo fails, its standard error becomes the
/// error.
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

/// Returns the text of a value, empty if it is not a string.
fn word(value: &Value) -> &str {
    value.as_str().unwrap_or_default()
}

/// Name and version of a crate: `heapless@0.9.1`.
type Name = String;

/// Returns the dependencies of each crate. `tree`: lines of `cargo tree`. `2heapless v0.9.1` is two levels below the
/// root, so the crate that needs it is the last crate of depth 1 before it.
fn linked(tree: &str) -> Result<BTreeMap<Name, BTreeSet<Name>>, Failure> {
    let mut needs = BTreeMap::<Name, BTreeSet<Name>>::new();
    let mut above: Vec<Name> = Vec::new();
    for line in tree.lines() {
        let (depth, name) = placed(line).ok_or_else(|| format!("`cargo tree` is not understood: {line}"))?;
        above.truncate(depth);
        if let Some(parent) = above.last() {
            needs.entry(parent.clone()).or_default().insert(name.clone());
        }
        needs.entry(name.clone()).or_default();
        above.push(name);
    }
    Ok(needs)
}

/// Returns depth and name of the crate in a line of `cargo tree`: 2 and `heapless@0.9.1` for `2heapless v0.9.1`. `None`
/// if the line has another form.
fn placed(line: &str) -> Option<(usize, Name)> {
    let (depth, package) = line.split_at(line.find(|c: char| !c.is_ascii_digit())?);
    let mut words = package.split(' ');
    Some((depth.parse().ok()?, format!("{}@{}", words.next()?, words.next()?.strip_prefix('v')?)))
}

/// The linked crates: their metadata and dependencies by name and version, and the checksums of `Cargo.lock`.
struct Crates {
    packages: BTreeMap<Name, Value>,
    needs: BTreeMap<Name, BTreeSet<Name>>,
    checksums: BTreeMap<Name, String>,
}

impl Crates {
    fn new(metadata: &Value, lock: &toml::Table, needs: BTreeMap<Name, BTreeSet<Name>>) -> Result<Crates, Failure> {
        let all = metadata["packages"].as_array().into_iter().flatten();
        let named = |package: &Value| format!("{}@{}", word(&package["name"]), word(&package["version"]));
        let mut all: BTreeMap<Name, Value> = all.map(|package| (named(package), package.clone())).collect();
        let mut packages = BTreeMap::new();
        for name in needs.keys() {
            let package = all.remove(name).ok_or_else(|| format!("cargo links {name}, and does not describe it"))?;
            packages.insert(name.clone(), package);
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

    fn components(&self) -> Result<Vec<Value>, Failure> {
        let component = |(name, package): (&Name, &Value)| {
            let licence = package["license"].as_str().ok_or_else(|| format!("{name} does not say its licence"))?;
            let mut component = json!({
                "type": "library", "bom-ref": name, "name": package["name"], "version": package["version"],
                // Some manifests have the old separator `/` between licences instead of `OR`.
                "licenses": [{ "expression": licence.replace('/', " OR ") }],
            });
            // Crates of the workspace are not in a registry, so they have no checksum and no package-url.
            if !package["source"].is_null() {
                let sum = self.checksums.get(name).ok_or_else(|| format!("Cargo.lock has no checksum of {name}"))?;
                component["purl"] = json!(purl("cargo", word(&package["name"]), word(&package["version"])));
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

/// Returns the package-url of a package, such as `pkg:npm/%40a/b@2.0.0`. A slash separates namespace and name. All
/// characters except letters, digits, `.`, `-`, `_` and `~` are percent-encoded.
fn purl(kind: &str, name: &str, version: &str) -> String {
    let encoded = |text: &str| -> String {
        let plain = |byte: u8| byte.is_ascii_alphanumeric() || b".-_~".contains(&byte);
        text.bytes()
            .map(|byte| if plain(byte) { char::from(byte).to_string() } else { format!("%{byte:02X}") })
            .collect()
    };
    let name: Vec<String> = name.split('/').map(encoded).collect();
    format!("pkg:{kind}/{}@{}", name.join("/"), encoded(version))
}

/// Returns the npm packages that may be part of a bundle, without development tools.
fn npm(lock: &Value) -> Vec<Value> {
    let packages = lock["packages"].as_object().into_iter().flatten();
    let bundled = packages.filter(|(path, package)| !path.is_empty() && package["dev"] != true);
    let component = |(path, package): (&String, &Value)| {
        let name = path.rsplit("node_modules/").next().unwrap_or_default();
        let version = word(&package["version"]);
        json!({
            "type": "library", "bom-ref": format!("npm:{name}@{version}"), "name": name, "version": version,
            "licenses": [{ "expression": package["license"] }],
            "purl": purl("npm", name, version),
        })
    };
    bundled.map(component).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn crates(tree: &str) -> Result<Crates, Failure> {
        let metadata = json!({ "packages": [
            { "name": "program", "version": "1.0.0", "license": "MIT", "source": null },
            { "name": "library", "version": "2.0.0", "license": "MIT/Apache-2.0", "source": "registry" },
            { "name": "tool", "version": "3.0.0", "license": "MIT", "source": "registry" },
        ] });
        let lock = "[[package]]\nname = \"library\"\nversion = \"2.0.0\"\nchecksum = \"abcd\"\n".parse().unwrap();
        Crates::new(&metadata, &lock, linked(tree)?)
    }

    #[test]
    fn a_bill_has_what_is_linked_and_nothing_else() {
        let crates = crates("0program v1.0.0 (/somewhere)\n1library v2.0.0\n").unwrap();
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
        assert!(crates("0tool v3.0.0").unwrap().components().unwrap_err().contains("checksum"));
    }

    #[test]
    fn a_crate_that_nothing_is_known_of_is_refused() {
        let tree = "0program v1.0.0 (/somewhere)\n1stranger v4.0.0\n";
        assert!(crates(tree).err().unwrap().contains("stranger@4.0.0"));
    }

    #[test]
    fn lines_of_cargo_tree() {
        let tree = "0p v0.2.0 (/somewhere/p)\n1a v1.0.0\n2b v2.0.0\n3c v3.0.0\n1c v3.0.0\n1d v4.0.0\n2c v3.0.0\n";
        let needs = [
            ("p@0.2.0", vec!["a@1.0.0", "c@3.0.0", "d@4.0.0"]),
            ("a@1.0.0", vec!["b@2.0.0"]),
            ("b@2.0.0", vec!["c@3.0.0"]),
            ("c@3.0.0", vec![]),
            ("d@4.0.0", vec!["c@3.0.0"]),
        ];
        let owned =
            |(name, needed): (&str, Vec<&str>)| (name.to_owned(), needed.into_iter().map(str::to_owned).collect());
        assert_eq!(linked(tree).unwrap(), needs.into_iter().map(owned).collect());
        for strange in ["heapless v0.9.1", "1heapless", "1heapless 0.9.1", ""] {
            assert!(linked(&format!("{strange}\n")).is_err(), "{strange}");
        }
    }

    #[test]
    fn addresses_of_packages_are_encoded() {
        assert_eq!(purl("cargo", "wasi", "0.9.12+spec-1.1.0"), "pkg:cargo/wasi@0.9.12%2Bspec-1.1.0");
        assert_eq!(purl("npm", "@a/b_c.d~e", "1.0.0-rc.1"), "pkg:npm/%40a/b_c.d~e@1.0.0-rc.1");
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

    /// Returns two sets of crate names: the components of a bill, and the dependencies of the crate `needing`.
    fn of_bill(sbom: &Sbom, needing: &str) -> (BTreeSet<String>, BTreeSet<String>) {
        let bill = sbom.bill("1.0.0").unwrap();
        let list = |value: &Value| value.as_array().unwrap().clone();
        let name = |reference: &Value| reference.as_str().unwrap().rsplit_once('@').unwrap().0.to_owned();
        let needed = list(&bill["dependencies"]).into_iter().filter(|entry| name(&entry["ref"]) == needing);
        let needed = needed.flat_map(|entry| list(&entry["dependsOn"])).map(|needed| name(&needed));
        (list(&bill["components"]).iter().map(|component| name(&component["bom-ref"])).collect(), needed.collect())
    }

    /// The linked crates differ between boards: the Nucleos have no USB.
    #[test]
    fn a_bill_of_a_board_has_what_its_feature_links() {
        let (black_pill, needed) = of_bill(&Sbom::of_board("blackpill_f411"), "oxmill-boards");
        let (nucleo, needed_there) = of_bill(&Sbom::of_board("nucleo_f446re"), "oxmill-boards");
        for name in ["stm32f4xx-hal", "stm32f4", "cortex-m-rt", "oxmill-controller", "rust-std"] {
            assert!(black_pill.contains(name) && nucleo.contains(name), "{name}");
        }
        for name in ["usb-device", "usbd-serial"] {
            assert!(black_pill.contains(name) && needed.contains(name), "{name}");
            assert!(!nucleo.contains(name) && !needed_there.contains(name), "{name}");
        }
        // A crate that only QEMU's board links must not be listed.
        assert!(!black_pill.iter().chain(&needed).any(|name| name.contains("mps2")));
    }

    #[test]
    fn every_part_has_a_bill() {
        let boards = crate::boards::with_hardware().map(Sbom::of_board);
        let host = Compiler::found().unwrap().host;
        for sbom in boards.chain([Sbom::of_program(&host), Sbom::of_page()]) {
            let bill = sbom.bill("1.0.0").unwrap();
            let all = bill["components"].as_array().unwrap();
            let known: Vec<&Value> =
                all.iter().chain([&bill["metadata"]["component"]]).map(|c| &c["bom-ref"]).collect();
            let needs = bill["dependencies"].as_array().unwrap();
            assert!(needs.len() > 5, "{}: {}", sbom.name, needs.len());
            for need in needs {
                assert!(known.contains(&&need["ref"]), "{need}");
                assert!(need["dependsOn"].as_array().unwrap().iter().all(|name| known.contains(&name)), "{need}");
            }
        }
    }
}
