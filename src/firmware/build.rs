//! Tells the linker about the board.

#[path = "../../boards/build.rs"]
mod boards;

fn main() {
    boards::link("../..", "bins");
}
