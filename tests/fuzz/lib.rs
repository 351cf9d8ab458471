//! What reads what others have written, each as a function of some bytes that must hold for all of them.
//!
//! A target panics when a promise is broken. `cargo xtask fuzz` lets libFuzzer look for such bytes, led by the code that
//! they reach; `corpus/` has a small set that reaches most of it (an input a line, escaped), `finds/` what has shown a fault that
//! was mended. `cargo test` runs all of it.

mod board;
pub mod events;
pub mod hosts;
pub mod lines;
pub mod programs;
pub mod session;
pub mod settings;
pub mod steps;
pub mod stored;
pub mod usb;
pub mod work;

/// A target: its name, and what it does with its bytes.
pub type Target = (&'static str, fn(&[u8]));

/// All targets.
pub const TARGETS: [Target; 9] = [
    ("lines", lines::run),
    ("programs", programs::run),
    ("session", session::run),
    ("stored", stored::run),
    ("steps", steps::run),
    ("hosts", hosts::run),
    ("events", events::run),
    ("settings", settings::run),
    ("usb", usb::run),
];

/// The target of this name.
pub fn target(name: &str) -> Option<fn(&[u8])> {
    TARGETS.iter().find(|(known, _)| *known == name).map(|(_, run)| *run)
}
