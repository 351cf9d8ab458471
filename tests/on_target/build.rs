//! Passes the board's linker scripts to the linker.

fn main() {
    // The suite `controller` needs a large stack (84 KiB), and also the storage of a controller. The boards with an
    // F401 have no space for both, so they do not run this suite (xtask/src/suites.rs). Their other suites need a
    // smaller stack (32 KiB).
    let is_f401 = ["BLACKPILL_F401", "NUCLEO_F401RE"]
        .iter()
        .any(|board| std::env::var_os(format!("CARGO_FEATURE_{board}")).is_some());
    oxmill_images::link(&["tests", "bins"], if is_f401 { 32 } else { 84 });
}
