//! The operator's overrides of feed, rapids and spindle, in percent. Realtime commands change them. A program can
//! disable the overrides of feed and spindle (M48 to M51).

use crate::messages::Realtime;

/// The three overrides in percent.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Overrides {
    /// Override of programmed feeds, 10 to 200.
    pub feed: u8,
    /// Override of rapids: 100, 50 or 25.
    pub rapid: u8,
    /// Override of the programmed spindle speed, 10 to 200.
    pub spindle: u8,
}

/// Limits of the feed override and of the spindle override in percent, as in Grbl.
const RANGE: core::ops::RangeInclusive<i16> = 10..=200;

impl Default for Overrides {
    fn default() -> Self {
        Self::NONE
    }
}

fn stepped(percent: u8, by: i16) -> u8 {
    (i16::from(percent) + by).clamp(*RANGE.start(), *RANGE.end()) as u8
}

impl Overrides {
    /// Everything as programmed.
    pub const NONE: Overrides = Overrides { feed: 100, rapid: 100, spindle: 100 };

    /// Returns the overrides in force. `feed_held`, `spindle_held`: `true` if the program has disabled this override
    /// (M49 to M51), so that it counts as 100 %.
    #[must_use]
    pub fn acting(mut self, feed_held: bool, spindle_held: bool) -> Overrides {
        if feed_held {
            self.feed = 100;
        }
        if spindle_held {
            self.spindle = 100;
        }
        self
    }

    /// Returns the overrides after one realtime command. Commands that are not for overrides change nothing.
    #[must_use]
    pub fn after(mut self, command: Realtime) -> Overrides {
        match command {
            Realtime::FeedReset => self.feed = 100,
            Realtime::FeedUp10 => self.feed = stepped(self.feed, 10),
            Realtime::FeedDown10 => self.feed = stepped(self.feed, -10),
            Realtime::FeedUp1 => self.feed = stepped(self.feed, 1),
            Realtime::FeedDown1 => self.feed = stepped(self.feed, -1),
            Realtime::RapidFull => self.rapid = 100,
            Realtime::RapidHalf => self.rapid = 50,
            Realtime::RapidQuarter => self.rapid = 25,
            Realtime::SpindleReset => self.spindle = 100,
            Realtime::SpindleUp10 => self.spindle = stepped(self.spindle, 10),
            Realtime::SpindleDown10 => self.spindle = stepped(self.spindle, -10),
            Realtime::SpindleUp1 => self.spindle = stepped(self.spindle, 1),
            Realtime::SpindleDown1 => self.spindle = stepped(self.spindle, -1),
            _ => {}
        }
        self
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn presses_add_up_within_the_range() {
        let mut o = Overrides::default();
        for _ in 0..30 {
            o = o.after(Realtime::FeedUp10);
        }
        assert_eq!(o.feed, 200);
        for _ in 0..300 {
            o = o.after(Realtime::FeedDown1);
        }
        assert_eq!(o.feed, 10);
        assert_eq!(o.after(Realtime::RapidQuarter).rapid, 25);
        assert_eq!(o.after(Realtime::Status), o);
    }
}
