//! Communication with the host: received lines, `$` commands and realtime commands; answers and listings; stored
//! records.

mod answers;
mod commands;
mod dispatch_line;
mod listings;
mod realtime;
pub(crate) mod settings_lock;
mod standing;
pub(crate) mod stored;
