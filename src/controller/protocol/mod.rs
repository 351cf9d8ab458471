//! The serial protocol: bytes in, text out. What a line means to the machine is decided elsewhere.
//!
//! [`realtime`] picks commands out of the byte stream, [`link`] brings both into their queues ([`byte_channel`] with several bytes in a message, [`owed`] those commands for which there is no room) from the host that has the machine (`floor`), [`remark`] tells text from commands, [`line_filter`] makes filtered lines, [`intake`]
//! knows which of their bytes still count, [`line_checksum`] whether a line is what was sent, [`heartbeat`] whether anything comes at all, [`system`] reads `$`
//! lines, [`text`] prints numbers, [`report`] prints every answer that a host can get, [`descriptions`] those that put numbers into words, [`replies`] keeps them until they are sent, [`coalescing`] says which are sent together.

pub mod byte_channel;
pub mod coalescing;
pub mod descriptions;
mod floor;
pub mod heartbeat;
pub mod intake;
pub mod line_checksum;
pub mod line_filter;
pub mod link;
pub mod owed;
pub mod realtime;
pub mod recording;
pub mod remark;
pub mod replies;
pub mod report;
pub mod system;
pub mod text;
