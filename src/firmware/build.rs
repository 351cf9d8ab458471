//! Tells the linker about the board.

#[path = "../../boards/build.rs"]
#[allow(dead_code, reason = "profiles are for xtask")]
mod boards;

fn main() {
    // The conversations in QEMU come to 6.9 KiB (`cargo xtask converse`).
    boards::link("../..", &["bins"], 16);
}
