//! What reads what others have written, each as a function of some bytes that must hold for all of them.
//!
//! A target panics when a promise is broken. `cargo xtask fuzz` lets libFuzzer look for such bytes, led by the code that
//! they reach; `corpus/` has a small set that reaches most of it (an input a line, escaped). `cargo test` runs all of it.

pub mod hosts;
pub mod lines;
pub mod session;
pub mod steps;
pub mod stored;

/// A target: its name, and what it does with its bytes.
pub type Target = (&'static str, fn(&[u8]));

/// All targets.
pub const TARGETS: [Target; 5] = [
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

#[cfg(test)]
mod tests {
    /// The inputs of the tree, which once reached something that no other does.
    fn replay(name: &str, text: &str) {
        let run = super::target(name).expect("a target");
        let inputs = oxmill_test_support::unpack(text);
        assert!(inputs.len() > 10, "{name}: {} inputs", inputs.len());
        inputs.iter().for_each(|input| run(input));
    }

    #[test]
    fn lines() {
        replay("lines", include_str!("corpus/lines.txt"));
    }

    #[test]
    fn session() {
        replay("session", include_str!("corpus/session.txt"));
    }

    #[test]
    fn stored() {
        replay("stored", include_str!("corpus/stored.txt"));
    }

    #[test]
    fn steps() {
        replay("steps", include_str!("corpus/steps.txt"));
    }

    #[test]
    fn hosts() {
        replay("hosts", include_str!("corpus/hosts.txt"));
    }
}
