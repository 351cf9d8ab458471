//! The serial protocol: bytes in, text out. What a line means to the machine is decided elsewhere.
//!
//! * [`link`] takes the bytes of a host: [`realtime`] finds commands, [`remark`] tells them from text, and a host may have to
//!   wait for the machine. [`owed`] keeps commands for which there is no room.
//! * [`byte_channel`] carries bytes of lines to the control task. [`intake`] drops those that count no more, [`line_filter`] makes
//!   lines of the others, [`line_checksum`] checks them, and [`heartbeat`] notices a silent host.
//! * [`system`] reads `$` lines.
//! * [`report`] prints replies with [`text`], [`descriptions`] those in words, [`recording`] those of `$REC`. [`replies`] keeps them
//!   until they are sent, and [`coalescing`] says which are sent together.

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
