//! Bytes in, text out: what crosses the serial line, and nothing of what it means to the machine. Only the list of the
//! room's modules.
//!
//! [`realtime`] picks commands out of the byte stream, [`link`] brings both into their queues ([`line_queue`] with several bytes in a message, [`owed`] those commands for which there is no room) from the host that has the machine (`floor`), [`remark`] tells text from commands, [`mod@line`] makes filtered lines, [`line_intake`]
//! knows which of their bytes still count, [`checked_line`] whether a line is what was sent, [`heartbeat`] whether anything comes at all, [`system`] reads `$`
//! lines, [`text`] prints numbers, [`report`] prints every answer that a host can get, [`descriptions`] those that put numbers into words, [`replies`] keeps them until they are sent, [`coalescing`] says which are sent together.

pub mod checked_line;
pub mod coalescing;
pub mod descriptions;
mod floor;
pub mod heartbeat;
pub mod line;
pub mod line_intake;
pub mod line_queue;
pub mod link;
pub mod owed;
pub mod realtime;
pub mod recorded;
pub mod remark;
pub mod replies;
pub mod report;
pub mod system;
pub mod text;
