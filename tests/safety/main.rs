//! The machine in danger: homing, probing, stops at any moment, settings that cannot run, and whatever anybody types.

mod anything;
mod bench;
mod combined;
mod disturbed;
mod emergency;
mod homing;
mod injection;
mod jogs;
mod probing;
mod program_pins;
mod remarks;
mod restore;
mod states;
mod tool_setter;
mod uncounted;
