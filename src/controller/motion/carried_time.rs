//! A move can be so short that no motor makes a step. Such a move makes no block: its length is added to the next
//! block ([`super::path_end`]). This file adds the time of the move to that block, too.
//!
//! If the moves without a step and the block's own move all have the same feed, the block keeps this feed. Otherwise
//! (another F, a rotary axis that turns more or less, inverse time), the block gets the speed at which it takes the
//! total time of all its moves.

use super::Speed;
use super::trapezoid::{greater, lesser};

/// Moves without a step add their time to the feed move after them. They add at most this time, s, or the feed move's
/// own duration, whichever is longer.
const MOST_SLOWED_S: f32 = 0.05;

/// Programmed time of the moves that have made no step since the last block. Their length is carried over to the next
/// block, and so is this time. Meaningless while no length is carried over.
#[derive(Clone, Copy, Debug)]
pub(super) struct CarriedTime {
    /// Duration of the moves without a step, s. Negative: the last block was longer than its moves, and this much of
    /// its time is to be subtracted from the next block. NaN: unknown, because a rapid is among the moves.
    seconds: f32,
    /// Feed that all moves without a step have in common, mm/s; 0: their feeds differ, or one of them is a rapid.
    feed: f32,
}

/// Length of a block, and of the moves that it consists of: its own move, and earlier moves that made no step.
#[derive(Clone, Copy, Debug)]
pub(super) struct BlockWay {
    /// Length of the block's own move, mm.
    pub own: f32,
    /// Total length of the preceding moves without a step, mm. Negative: the last block was longer than its moves by
    /// this amount.
    pub carried: f32,
    /// Length of the block, mm. Greater than `own` + `carried` if this sum would be too short for the block's steps.
    pub length: f32,
}

/// Returns the duration (s) and the feed (mm/s) of a move of length `own`; NaN and 0 for a rapid.
fn time_and_feed(speed: Speed, own: f32) -> (f32, f32) {
    match speed {
        Speed::Rapid => (f32::NAN, 0.0),
        Speed::Feed(feed) => (own / feed, feed),
        Speed::Duration(seconds) => (seconds, own / seconds),
    }
}

impl CarriedTime {
    pub(super) const NONE: Self = Self { seconds: 0.0, feed: 0.0 };

    /// Adds a move of length `own`, mm, that makes no step. `carried`: length, mm, that was carried over before this
    /// move; 0 begins a new sum.
    pub(super) fn add(&mut self, speed: Speed, own: f32, carried: f32) {
        let (seconds, feed) = time_and_feed(speed, own);
        if carried == 0.0 {
            *self = Self { seconds, feed };
        } else {
            self.seconds += seconds;
            self.feed = if self.feed == feed { feed } else { 0.0 };
        }
    }

    /// Returns the speed of a block. `speed`: speed of the block's own move. If the block is longer than its moves,
    /// the time for the excess length is carried over to the next block as a negative time.
    #[inline]
    pub(super) fn take(&mut self, speed: Speed, way: BlockWay) -> Speed {
        let BlockWay { own, carried, length } = way;
        let (alone, feed) = time_and_feed(speed, own);
        let extra = length - (own + carried);
        let before = if carried == 0.0 { Self { seconds: 0.0, feed } } else { *self };
        *self = Self { seconds: -extra / feed, feed };
        let seconds = match speed {
            Speed::Feed(_) if before.feed != feed && !before.seconds.is_nan() => {
                // `before.seconds` is negative if the last block was longer than its moves. The bound `least` keeps
                // the present block from becoming faster than its feed.
                let (least, most) = (lesser(carried / feed, 0.0), greater(alone, MOST_SLOWED_S));
                alone + greater(lesser(before.seconds, most), least) + extra / feed
            }
            Speed::Duration(_) => {
                // A move with a duration takes this duration even if its block is longer, so no negative time is
                // carried over.
                *self = Self::NONE;
                alone + greater(before.seconds, 0.0)
            }
            _ => return speed,
        };
        Speed::Feed(length / seconds)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const FAST: Speed = Speed::Feed(10.0);
    const SLOW: Speed = Speed::Feed(1.0);

    fn way(own: f32, carried: f32, length: f32) -> BlockWay {
        BlockWay { own, carried, length }
    }

    #[track_caller]
    fn assert_near(found: Speed, mm_per_s: f32) {
        let Speed::Feed(feed) = found else { panic!("no feed: {found:?}") };
        assert!((feed / mm_per_s - 1.0).abs() < 1e-3, "{feed} mm/s");
    }

    #[test]
    fn moves_of_one_feed_keep_it() {
        let mut time = CarriedTime::NONE;
        time.add(FAST, 0.004, 0.0);
        time.add(FAST, 0.004, 0.004);
        assert_eq!(time.take(FAST, way(0.004, 0.008, 0.02)), FAST);
        assert_eq!(time.take(FAST, way(0.02, -0.008, 0.012)), FAST);
        assert_eq!(time.take(SLOW, way(1.0, 0.0, 1.0)), SLOW);
    }

    #[test]
    fn each_length_takes_its_own_time() {
        let mut time = CarriedTime::NONE;
        time.add(SLOW, 0.004, 0.0);
        // The carried length takes 4 ms, the block's own move 1 ms.
        assert_near(time.take(FAST, way(0.01, 0.004, 0.014)), 0.014 / (0.001 + 0.004));
        time.add(Speed::Duration(0.5), 0.004, 0.0);
        assert_near(time.take(Speed::Duration(0.25), way(0.01, 0.004, 0.014)), 0.014 / 0.75);
    }

    #[test]
    fn a_long_move_is_slowed_down_but_little() {
        let mut time = CarriedTime::NONE;
        time.add(Speed::Feed(0.001), 0.004, 0.0);
        assert_near(time.take(FAST, way(10.0, 0.004, 10.004)), 10.004 / 2.0);
    }

    #[test]
    fn none_is_faster_for_a_block_that_was_longer() {
        let mut time = CarriedTime::NONE;
        assert_eq!(time.take(SLOW, way(0.001, 0.0, 0.006)), SLOW);
        assert_near(time.take(FAST, way(0.02, -0.005, 0.015)), 10.0);
    }

    #[test]
    fn a_rapid_is_as_fast_as_what_follows() {
        let mut time = CarriedTime::NONE;
        time.add(Speed::Rapid, 0.004, 0.0);
        assert_eq!(time.take(FAST, way(0.01, 0.004, 0.014)), FAST);
        time.add(FAST, 0.004, 0.0);
        assert_eq!(time.take(Speed::Rapid, way(0.01, 0.004, 0.014)), Speed::Rapid);
    }
}
