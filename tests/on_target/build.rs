//! Passes the board's linker scripts to the linker.

fn main() {
    // The suite `controller` needs the storage of a controller in addition to the stack. The F401s have no space for
    // it: that suite is not run on them (xtask/src/suites.rs), and the others need a smaller stack.
    let is_f401 = ["BLACKPILL_F401", "NUCLEO_F401RE"]
        .iter()
        .any(|board| std::env::var_os(format!("CARGO_FEATURE_{board}")).is_some());
    oxmill_images::link(&["tests", "bins"], if is_f401 { 32 } else { 84 });
}
