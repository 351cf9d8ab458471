//! Tests of the whole machine: bytes in, pulses out.

mod conversations;
mod estimator;
mod examples;
mod host;
mod kinematics;
mod motion_properties;
mod oracle;
mod rig;
mod seed;
mod stream;
