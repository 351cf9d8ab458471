//! Communication with the host: received lines, `$` commands and realtime commands; answers and listings; stored
//! records.

mod answers;
mod commands;
mod dispatch_line;
mod grblhal;
mod grblhal_fields;
mod listings;
mod realtime;
mod replay_state;
pub(crate) mod settings_lock;
pub(crate) mod stored;
