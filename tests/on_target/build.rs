//! Tells the linker about the board.

fn main() {
    // The suite `controller` builds whole controllers as local variables, two at a time. On the F401RE, which has 96 KiB of RAM, the
    // others are all that fit: there it is not run (xtask/src/suites.rs).
    let stack_kib = if std::env::var_os("CARGO_FEATURE_NUCLEO_F401RE").is_some() { 80 } else { 88 };
    oxmill_images::link(&["tests", "bins"], stack_kib);
}
