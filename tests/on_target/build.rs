//! Tells the linker about the board.

fn main() {
    // The suites build whole controllers as local variables, two at a time, and more where instructions are counted, which
    // is done in QEMU.
    oxmill_images::link(&["tests", "bins"], 88);
}
