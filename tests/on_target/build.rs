//! Tells the linker about the board.

#[path = "../../boards/build.rs"]
#[allow(dead_code, reason = "profiles are for xtask")]
mod boards;

fn main() {
    // The suites build whole controllers as local variables, two at a time.
    boards::link("../..", &["tests", "bins"], 80);
}
