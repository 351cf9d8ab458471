//! Facts about the firmware's images, for build scripts and `xtask`: the list of images, and the linker script and
//! cargo profile of each. An image is one build of the firmware. Several boards can share an image.
//!
//! Linker arguments are set here and not by `rustflags` in cargo's configuration, because a variable `RUSTFLAGS` in the
//! environment would silently replace `rustflags`. Without the linker script, the image would be empty.

use std::{env, fs, path::PathBuf};

/// Names of all images. Each is also the name of a cargo feature of the packages that link an image. Boards that
/// differ only in their pins share an image (`boards/tables`).
pub const IMAGES: [&str; 9] = [
    "blackpill_f411",
    "blackpill_f401",
    "nucleo_f446re",
    "nucleo_f411re",
    "nucleo_f401re",
    "control_f407",
    "control_f446",
    "control_f412",
    "qemu_mps2",
];

/// Images that are built for size, because their flash is too small for an image built for speed.
pub const SMALL: [&str; 3] = ["blackpill_f401", "control_f407", "control_f446"];

/// The cargo profile that compiles for speed.
pub const FAST: &str = "firmware";

/// Returns the cargo profile of an image.
pub fn profile(image: &str) -> &'static str {
    if SMALL.contains(&image) { "firmware-small" } else { FAST }
}

/// Returns the linker script `chip.x` of an image, or `None` for an unknown image.
pub fn chip(image: &str) -> Option<&'static str> {
    Some(match image {
        "blackpill_f411" => include_str!("chips/blackpill_f411.x"),
        "blackpill_f401" => include_str!("chips/blackpill_f401.x"),
        "nucleo_f446re" => include_str!("chips/nucleo_f446re.x"),
        "nucleo_f411re" => include_str!("chips/nucleo_f411re.x"),
        "nucleo_f401re" => include_str!("chips/nucleo_f401re.x"),
        "control_f407" => include_str!("chips/control_f407.x"),
        "control_f446" => include_str!("chips/control_f446.x"),
        "control_f412" => include_str!("chips/control_f412.x"),
        "qemu_mps2" => include_str!("chips/qemu_mps2.x"),
        _ => return None,
    })
}

/// Returns the image that the cargo features choose, or `None` if the build is for a PC. Call only in a build script:
/// the features come from the environment variables that cargo sets there.
///
/// # Panics
///
/// Panics if the features do not choose exactly one image.
pub fn chosen() -> Option<&'static str> {
    if env::var("CARGO_CFG_TARGET_OS").as_deref() != Ok("none") {
        return None;
    }
    let is_chosen = |image: &&str| env::var_os(format!("CARGO_FEATURE_{}", image.to_uppercase())).is_some();
    let chosen: Vec<&str> = IMAGES.into_iter().filter(is_chosen).collect();
    let [image] = chosen[..] else { panic!("choose exactly one of the features {IMAGES:?}, not {chosen:?}") };
    Some(image)
}

/// Writes the linker scripts of the chosen image into the search path of the linker, and passes them to the linker.
/// Call only in a build script. `kinds`: the kinds of cargo targets that get the scripts, such as `bins` (each is the
/// KIND of a `cargo:rustc-link-arg-KIND`). `stack_kib`: size of the stack, KiB.
///
/// In this workspace the linker runs in the root folder and finds the original `memory.x` there first. The copy
/// written here is for a workspace that was made from the packaged crates alone.
pub fn link(kinds: &[&str], stack_kib: u32) {
    println!("cargo:rerun-if-changed=build.rs");
    let Some(image) = chosen() else { return };
    let out = PathBuf::from(env::var_os("OUT_DIR").expect("cargo sets OUT_DIR"));
    let stack = format!("STACK_SIZE = {stack_kib}K;\n");
    let scripts = [
        ("memory.x", include_str!("memory.x")),
        ("chip.x", chip(image).expect("each image has a chip")),
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
