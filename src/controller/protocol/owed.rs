//! Realtime commands of a link that cannot wait, for which there was no room in the queue: resets, feed holds and door
//! commands. The serial task adds to them, and `control` takes them in order. None of these commands is lost.

use crate::messages::Realtime;

/// Commands of a link that cannot wait for which there was no room, and which must not be lost. While there are any,
/// nothing else is queued, so that they come after all that is queued and before all that is not.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Owed(pub u32);

impl Owed {
    const DOOR: u32 = 1 << 16;
    const HOLD: u32 = 1 << 17;
    /// A count: each has been counted as a stop, too. Half a second, the longest that `control` may take, holds 6000 bytes.
    const RESETS: u32 = 0xFFFF;

    /// With one more, if it will be obeyed: a reset, which voids the holds before it; a hold and a door, once each; 0x19 and
    /// a jog cancel as a reset, for the epochs of all later lines count on them. The others are lost.
    pub fn with(self, command: Realtime) -> Option<Owed> {
        match command {
            Realtime::FeedHold => Some(Owed(self.0 | Self::HOLD)),
            Realtime::SafetyDoor => Some(Owed(self.0 | Self::DOOR)),
            _ if command.opens_epoch() => Some(Owed((self.0 & Self::RESETS) + 1)),
            _ => None,
        }
    }

    /// Takes the next of them, in their order. Of a hold and a door it does not matter which comes first.
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
    fn what_is_owed_keeps_its_order() {
        use Realtime::{CycleStart, FeedHold, JogCancel, Reset, SafetyDoor, Stop};
        let owed = |commands: &[Realtime]| {
            let add = |owed: Owed, command: &Realtime| owed.with(*command).unwrap_or(owed);
            let mut all = commands.iter().fold(Owed::default(), add);
            core::iter::from_fn(|| all.pop()).collect::<Vec<_>>()
        };
        assert_eq!(owed(&[FeedHold, SafetyDoor]), [SafetyDoor, FeedHold]);
        assert_eq!(owed(&[FeedHold, Reset]), [Reset], "void by it");
        assert_eq!(owed(&[Reset, FeedHold]), [Reset, FeedHold], "and not undone by it");
        assert_eq!(owed(&[Reset, SafetyDoor, JogCancel, Stop, FeedHold]), [Reset, Reset, Reset, FeedHold]);
        assert_eq!(owed(&[CycleStart]), []);
        assert_eq!(owed(&[Reset; 6000]).len(), 6000);
    }
}
