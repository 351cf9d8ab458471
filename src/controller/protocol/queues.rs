//! Defines the trait [`Queues`]: what a link needs from the serial task to pass bytes of a host on to the control
//! task.

use crate::messages::{LineByte, Realtime};

/// The queues to the control task, and the other functions that a link needs from the serial task.
pub trait Queues {
    /// Queues a command. Returns whether there was room.
    fn realtime(&mut self, command: Realtime) -> bool;
    /// Queues a byte of a line. Returns whether there was room.
    fn line(&mut self, byte: LineByte) -> bool;
    /// Queues bytes of lines, all received in `epoch`, from the first one on while there is room. Returns how many
    /// were queued.
    #[inline]
    fn text(&mut self, epoch: u16, bytes: &[u8]) -> usize {
        let left = bytes.iter().position(|byte| !self.line(LineByte { byte: *byte, epoch, damaged: false }));
        left.unwrap_or(bytes.len())
    }
    /// Returns whether the link being read can make its host wait. If it can, a command that finds no room waits in
    /// the link. If it cannot, that command is lost, and the link goes on with the next one.
    fn waits(&self) -> bool;
    /// Returns whether everything that any host has sent is done and answered.
    fn is_free(&self) -> bool;
    /// Stops the step task for a reset. Called before the reset is queued, and before the active host changes.
    fn stop(&mut self);
    /// Counts a byte that is neither part of a line nor a command. The byte only shows that the host is alive.
    fn ignored(&mut self) {}
    /// Returns whether multi-byte characters in comments are text. In Grbl's dialect they are not: each byte from 0x80
    /// up is a command or ignored.
    fn reads_characters(&self) -> bool;
    /// Returns whether hosts are answered like grblHAL (`$900=3`), which has more realtime commands.
    fn speaks_grblhal(&self) -> bool {
        false
    }
}
