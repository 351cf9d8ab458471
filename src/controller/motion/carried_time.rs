//! Carries over the time of moves that are too short for a step. Their length is carried over to the next block
//! ([`super::path_end`]), so their time must be, too.
//!
//! If all of these moves and the block's own move have the same feed, the block keeps this feed. If feeds differ
//! (another F, a rotary axis that turns more or less, inverse time), the block gets the speed at which it takes the
//! total time of all its moves.

use super::Speed;
use super::trapezoid::{greater, lesser};

/// Maximum time by which preceding moves without a step prolong a feed move, s. If the feed move itself takes longer
/// than this, it is prolonged by its own duration at most.
const MOST_SLOWED_S: f32 = 0.05;

/// The programmed time of moves without a step whose length is carried over to the next block. Meaningless while no
/// length is carried over.
#[derive(Clone, Copy, Debug)]
pub(super) struct CarriedTime {
    /// Duration of these moves, s; negative if the last block was longer than its moves; NaN (unknown) if there are
    /// rapids among them.
    seconds: f32,
    /// The common feed of the carried length, mm/s; 0: several feeds, or rapids.
    feed: f32,
}

/// The lengths of a block, of its own move, and of the moves carried over to it.
#[derive(Clone, Copy, Debug)]
pub(super) struct BlockWay {
    /// Length of the block's own move, mm.
    pub own: f32,
    /// Length carried over to the block, mm: that of preceding moves without a step. If negative, it is the length that
    /// the last block had in excess of its moves.
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

    /// Adds a move of length `own` that makes no step. `carried`: length carried over before this move.
    pub(super) fn add(&mut self, speed: Speed, own: f32, carried: f32) {
        let (seconds, feed) = time_and_feed(speed, own);
        if carried == 0.0 {
            *self = Self { seconds, feed };
        } else {
            self.seconds += seconds;
            self.feed = if self.feed == feed { feed } else { 0.0 };
        }
    }

    /// Returns the speed of a block whose own move has `speed`. If the block is longer than its moves, the time for the
    /// excess length is carried over to the next block as a negative time.
    #[inline]
    pub(super) fn take(&mut self, speed: Speed, way: BlockWay) -> Speed {
        let BlockWay { own, carried, length } = way;
        let (alone, feed) = time_and_feed(speed, own);
        let extra = length - (own + carried);
        let before = if carried == 0.0 { Self { seconds: 0.0, feed } } else { *self };
        *self = Self { seconds: -extra / feed, feed };
        let seconds = match speed {
            Speed::Feed(_) if before.feed != feed && !before.seconds.is_nan() => {
                // If the last block was too long, the negative time does not make this block faster than its feed.
                let (least, most) = (lesser(carried / feed, 0.0), greater(alone, MOST_SLOWED_S));
                alone + greater(lesser(before.seconds, most), least) + extra / feed
            }
            Speed::Duration(_) => {
                // The block takes the duration of its move, whatever its length, so nothing is carried over.
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
