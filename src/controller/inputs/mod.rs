//! The inputs: their levels as the controller uses them, and the reactions to their changes.

pub(crate) mod levels;
mod pin_changes;
