//! What the host sends and what it is told: lines, `$` commands, realtime commands; answers, listings, and what is stored.

mod answers;
mod commands;
mod dispatch_line;
mod listings;
mod realtime;
pub(crate) mod settings_lock;
mod standing;
pub(crate) mod stored;
