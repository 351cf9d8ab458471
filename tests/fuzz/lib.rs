//! What reads what others have written, each as a function of some bytes that must hold for all of them.
//!
//! A target panics when a promise is broken. `cargo xtask fuzz` lets libFuzzer look for such bytes, led by the code that
//! they reach; `corpus/` has a small set that reaches most of it, and what has once broken a promise. `cargo test` runs all
//! of it.

pub mod hosts;
pub mod lines;
pub mod session;
pub mod steps;
pub mod stored;

/// All targets: name, and what it does with its bytes.
pub const TARGETS: [(&str, fn(&[u8])); 5] = [
    ("lines", lines::run),
    ("session", session::run),
    ("stored", stored::run),
    ("steps", steps::run),
    ("hosts", hosts::run),
];

/// The target of this name.
pub fn target(name: &str) -> Option<fn(&[u8])> {
    TARGETS.iter().find(|(known, _)| *known == name).map(|(_, run)| *run)
}
