//! Stores resets, feed holds and door commands for which the command queue has no room. Only commands from a link that
//! cannot make its host wait (a plain UART) are stored. The serial task adds them, and `control` takes them in order.
//! None of these commands is lost.

use crate::messages::Realtime;

/// Resets, feed holds and door commands for which the command queue had no room. While one of them is stored here, the
/// serial task puts no further command into the queue. So the stored commands act after all commands queued before
/// them, and before all commands received later.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct DeferredCommands(pub u32);

impl DeferredCommands {
    const DOOR: u32 = 1 << 16;
    const HOLD: u32 = 1 << 17;
    /// Mask of the bits that count the stored resets. For each of them, the serial task has also requested a stop of
    /// the step task. The count stays below 65,536: because of the watchdog, `control` takes the resets at least
    /// every half second. In that time, a UART receives 50,000 bytes at 1,000,000 baud.
    const RESETS: u32 = 0xFFFF;

    /// Returns these commands with `command` added, or `None` if `command` may be lost without harm. At most one hold
    /// and one door command are kept, and a reset removes both. 0x19 and a jog cancel are kept as resets, because
    /// each of them opens an epoch, too. Later line bytes are marked with that epoch (see
    /// [`LineByte`](crate::messages::LineByte)).
    pub fn with(self, command: Realtime) -> Option<DeferredCommands> {
        match command {
            Realtime::FeedHold => Some(DeferredCommands(self.0 | Self::HOLD)),
            Realtime::SafetyDoor => Some(DeferredCommands(self.0 | Self::DOOR)),
            _ if command.opens_epoch() => Some(DeferredCommands((self.0 & Self::RESETS) + 1)),
            _ => None,
        }
    }

    /// Removes and returns the next command. Resets come first, because any hold or door command that is still kept
    /// arrived after them. The order between hold and door command does not matter.
    pub fn pop(&mut self) -> Option<Realtime> {
        if self.0 & Self::RESETS != 0 {
            self.0 -= 1;
            return Some(Realtime::Reset);
        }
        for (mark, command) in [(Self::DOOR, Realtime::SafetyDoor), (Self::HOLD, Realtime::FeedHold)] {
            if self.0 & mark != 0 {
                self.0 &= !mark;
                return Some(command);
            }
        }
        None
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn deferred_commands_keep_their_order() {
        use Realtime::{CycleStart, FeedHold, JogCancel, Reset, SafetyDoor, Stop};
        let order = |commands: &[Realtime]| {
            let add = |all: DeferredCommands, command: &Realtime| all.with(*command).unwrap_or(all);
            let mut all = commands.iter().fold(DeferredCommands::default(), add);
            core::iter::from_fn(|| all.pop()).collect::<Vec<_>>()
        };
        assert_eq!(order(&[FeedHold, SafetyDoor]), [SafetyDoor, FeedHold]);
        assert_eq!(order(&[FeedHold, Reset]), [Reset], "void by it");
        assert_eq!(order(&[Reset, FeedHold]), [Reset, FeedHold], "and not undone by it");
        assert_eq!(order(&[Reset, SafetyDoor, JogCancel, Stop, FeedHold]), [Reset, Reset, Reset, FeedHold]);
        assert_eq!(order(&[CycleStart]), []);
        assert_eq!(order(&[Reset; 6000]).len(), 6000);
    }
}
