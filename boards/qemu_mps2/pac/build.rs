//! Puts `device.x`, the defaults of the interrupt vectors, on the linker's search path.

use std::{env, fs, path::PathBuf};

fn main() {
    println!("cargo:rerun-if-changed=build.rs");
    println!("cargo:rerun-if-changed=device.x");
    let out = PathBuf::from(env::var_os("OUT_DIR").expect("cargo sets OUT_DIR"));
    fs::copy("device.x", out.join("device.x")).expect("device.x stands beside this file");
    println!("cargo:rustc-link-search={}", out.display());
}
