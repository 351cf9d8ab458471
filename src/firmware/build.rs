//! Build script of the firmware: passes the board's linker options to the linker, with `oxmill_images::link`.

fn main() {
    // 16 KiB of stack. The largest use in the QEMU sessions is 6.9 KiB (`cargo xtask converse`).
    oxmill_images::link(&["bins"], 16);
}
