//! The build script of the firmware: has `oxmill_images::link` tell the linker about the board.

fn main() {
    // The conversations in QEMU come to 6.9 KiB (`cargo xtask converse`).
    oxmill_images::link(&["bins"], 16);
}
