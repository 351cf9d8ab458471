//! Carries out a line of G-code, stage by stage: its moves, cycles, probing, tool change, outputs and program flow.

mod cycle;
mod limits;
pub(crate) mod line;
mod moves;
mod pins;
pub(crate) mod probe;
mod stages;
pub(crate) mod task;
pub(crate) mod tool_change;
