//! Tests of the motion modules together. Results are compared with each other, and with reference computations that
//! share no code with these modules.

#![allow(clippy::needless_range_loop, reason = "axis numbers index several arrays at once")]

mod arcs;
#[cfg(feature = "full")]
mod blends;
mod bounds;
mod deferred_pass;
mod jobs;
mod joins;
mod ramps;
mod rig;
mod single_moves;
#[cfg(feature = "full")]
mod splines;
mod steps;
mod stops;
