//! What the machine is doing, apart from moving along a path: its state, its overrides, its spindle, its drivers. Only
//! the list of the room's modules.

pub mod accessories;
pub mod digital;
pub mod drivers;
pub mod filter;
pub mod realtime_override;
pub mod reference;
pub mod signals;
pub mod spindle;
pub mod step_supply;
