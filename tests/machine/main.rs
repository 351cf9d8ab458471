//! Tests of the whole machine: bytes in, pulses out.

mod backlash;
mod conversations;
mod crumbs;
mod estimator;
mod examples;
mod host;
mod jerk;
mod jerk_in_use;
mod joined;
mod kinematics;
mod known_jobs;
mod motion_properties;
mod oracle;
mod resets;
mod rig;
mod seed;
mod stream;
