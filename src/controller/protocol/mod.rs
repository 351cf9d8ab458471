//! The serial protocol: turns received bytes into lines and commands, and replies into text. Lines are executed
//! elsewhere.
//!
//! * [`link`] takes the bytes of one host. [`realtime`] finds commands, and [`comment`] distinguishes them from the
//!   text of comments. [`host_arbiter`] decides which of two hosts is the active one. While a queue ([`queues`]) is
//!   full, a link holds bytes if its host can wait; [`deferred`] keeps commands of a link that cannot wait.
//! * [`byte_channel`] carries bytes of lines to the control task. [`intake`] drops bytes that are no longer valid,
//!   [`line_filter`] makes lines of the other bytes, [`line_checksum`] checks the lines, and [`heartbeat`] notices a
//!   silent host.
//! * [`system`] parses `$` lines.
//! * [`reply_texts`] and [`status_report`] print replies with [`text`]. [`descriptions`] prints settings and errors in
//!   words, and [`recording`] prints `$REC`. [`reply_queue`] keeps replies until they are sent, and [`coalescing`]
//!   groups them into messages.

mod active_host;
pub mod byte_channel;
pub mod coalescing;
pub mod comment;
pub mod deferred;
pub mod descriptions;
pub mod grblhal;
pub mod heartbeat;
pub mod host_arbiter;
pub mod intake;
pub mod line_checksum;
pub mod line_filter;
pub mod link;
pub mod queues;
pub mod realtime;
pub mod recording;
pub mod reply_queue;
pub mod reply_texts;
pub mod status_report;
pub mod system;
pub mod text;
