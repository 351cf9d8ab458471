//! Facts about the boards' images, for build scripts and `xtask`: the list of boards, each one's linker script and
//! cargo profile.
//!
//! Linker arguments are set here and not by `rustflags` in cargo's configuration, because a variable `RUSTFLAGS` in the
//! environment would silently replace `rustflags`, and the image would be empty.

use std::{env, fs, path::PathBuf};

/// All boards. Each is also a feature of the packages that link an image.
pub const BOARDS: [&str; 6] =
    ["blackpill_f411", "blackpill_f401", "nucleo_f446re", "nucleo_f411re", "nucleo_f401re", "qemu_mps2"];

/// Boards whose flash is too small for an image built for speed. Their image is built for size.
pub const SMALL: [&str; 1] = ["blackpill_f401"];

/// The cargo profile that compiles for speed.
pub const FAST: &str = "firmware";

/// Returns the cargo profile of a board's image.
pub fn profile(board: &str) -> &'static str {
    if SMALL.contains(&board) { "firmware-small" } else { FAST }
}

/// Returns the linker script `chip.x` of a board's chip, or `None` for an unknown board.
pub fn chip(board: &str) -> Option<&'static str> {
    Some(match board {
        "blackpill_f411" => include_str!("chips/blackpill_f411.x"),
        "blackpill_f401" => include_str!("chips/blackpill_f401.x"),
        "nucleo_f446re" => include_str!("chips/nucleo_f446re.x"),
        "nucleo_f411re" => include_str!("chips/nucleo_f411re.x"),
        "nucleo_f401re" => include_str!("chips/nucleo_f401re.x"),
        "qemu_mps2" => include_str!("chips/qemu_mps2.x"),
        _ => return None,
    })
}

/// For build scripts: writes the linker scripts of the chosen board into the linker's search path and passes them to
/// the linker. `kinds` are the kinds of target in `cargo:rustc-link-arg-KIND`, `stack_kib` is the stack size in KiB. In
/// this workspace, the linker runs in the workspace's folder and finds the original `memory.x` there first. The copy
/// written here is for a workspace that was made from the packaged crates alone.
pub fn link(kinds: &[&str], stack_kib: u32) {
    println!("cargo:rerun-if-changed=build.rs");
    if env::var("CARGO_CFG_TARGET_OS").as_deref() != Ok("none") {
        return;
    }
    let chosen: Vec<&str> =
        BOARDS.into_iter().filter(|b| env::var_os(format!("CARGO_FEATURE_{}", b.to_uppercase())).is_some()).collect();
    let [board] = chosen[..] else { panic!("choose exactly one board feature of {BOARDS:?}, not {chosen:?}") };
    let out = PathBuf::from(env::var_os("OUT_DIR").expect("cargo sets OUT_DIR"));
    let stack = format!("STACK_SIZE = {stack_kib}K;\n");
    let scripts = [
        ("memory.x", include_str!("memory.x")),
        ("chip.x", chip(board).expect("each board has a chip")),
        ("stack.x", &stack),
    ];
    for (name, text) in scripts {
        fs::write(out.join(name), text).expect("cargo's OUT_DIR can be written");
    }
    println!("cargo:rustc-link-search={}", out.display());
    for kind in kinds {
        for argument in ["--nmagic", "--enable-non-contiguous-regions", "-Tlink.x", "-Tdefmt.x"] {
            println!("cargo:rustc-link-arg-{kind}={argument}");
        }
    }
}
