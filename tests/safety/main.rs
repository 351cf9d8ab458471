//! Hazardous situations: homing, probing, stops at any time, unusable settings, and arbitrary input.

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
