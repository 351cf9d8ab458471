//! Tells the linker about the board.

fn main() {
    // The suite `controller` needs the storage of a controller beside the stack. The F401s have no room for that: there it
    // is not run (xtask/src/suites.rs), and the others do with less.
    let is_f401 = ["BLACKPILL_F401", "NUCLEO_F401RE"]
        .iter()
        .any(|board| std::env::var_os(format!("CARGO_FEATURE_{board}")).is_some());
    oxmill_images::link(&["tests", "bins"], if is_f401 { 32 } else { 84 });
}
