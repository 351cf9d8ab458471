//! Tests of the whole machine: bytes in, pulses out.

mod axis_speeds;
mod backlash;
mod blended;
mod conversations;
mod crumbs;
mod curves;
mod estimator;
mod examples;
mod host;
mod jerk;
mod jerk_in_use;
mod joined;
mod kinematics;
mod known_jobs;
mod motion_properties;
mod optimum;
mod oracle;
mod programs;
mod reactions;
mod resets;
mod rig;
mod rotary;
mod seed;
mod splines;
mod stream;
mod turns;
