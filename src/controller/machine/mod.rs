//! The parts of the machine besides motion: spindle and coolant, drivers, inputs, overrides, and whether the position
//! can be trusted (its reference). They do not depend on the controller's states, on G-code lines or on the host.

pub mod accessories;
pub mod digital;
pub mod drivers;
pub mod filter;
pub mod realtime_override;
pub mod reference;
pub mod signals;
pub mod spindle;
pub mod step_supply;
