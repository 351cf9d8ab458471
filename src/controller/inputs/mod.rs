//! Input pins: what they mean, and what follows a change.

pub(crate) mod levels;
mod pin_changes;
