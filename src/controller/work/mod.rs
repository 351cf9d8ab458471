//! A line of G-code is carried out, stage by stage: its move, arc, cycle, tool change, probe cycle, and outputs.

mod cycle;
mod limits;
pub(crate) mod line;
mod moves;
mod pins;
pub(crate) mod probe;
mod stages;
pub(crate) mod task;
pub(crate) mod tool_change;
