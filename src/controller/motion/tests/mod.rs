//! The rooms of motion against each other and against oracles that share no code with them.

mod arcs;
mod jobs;
mod rig;
mod steps;
mod stops;
