//! Tells the linker about the board.

#[path = "../../boards/build.rs"]
#[allow(dead_code, reason = "profiles are for xtask")]
mod boards;

fn main() {
    // The suites build whole controllers as local variables, two at a time, and more where instructions are counted, which
    // is done in QEMU.
    let stack_kib = if std::env::var_os("CARGO_FEATURE_QEMU_MPS2").is_some() { 84 } else { 80 };
    boards::link("../..", &["tests", "bins"], stack_kib);
}
