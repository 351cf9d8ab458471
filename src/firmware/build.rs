//! The build script of the firmware: has `oxmill_images::link` tell the linker about the board.

fn main() {
    // The conversations in QEMU come to 6.9 KiB (`cargo xtask converse`), the cases of the virtual boards to 7.6.
    let is_small = std::env::var_os("CARGO_FEATURE_BLACKPILL_F401").is_some();
    oxmill_images::link(&["bins"], if is_small { 15 } else { 16 });
}
