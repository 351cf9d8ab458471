//! The time of moves that are too short for a step. Their length is carried over to the next block
//! ([`super::path_end`]), which has to take their time as well.
//!
//! With one feed along the path, the time is that length at this feed. Where feeds differ (another F, a rotary axis
//! that turns more or less, inverse time), the block gets the speed at which it takes the time of all its moves.

use super::Speed;
use super::trapezoid::{greater, lesser};

/// A move at a feed is slowed down for moves without a step before it by so much, or by as long as it takes itself, s.
const MOST_SLOWED_S: f32 = 0.05;

/// What a carried length is meant to take. Where there is none it says nothing.
#[derive(Clone, Copy, Debug)]
pub(super) struct CarriedTime {
    /// Unknown (NaN) with rapids.
    seconds: f32,
    /// The feed of all of it, mm/s; 0: of several.
    feed: f32,
}

/// A block, the length of its move and what was carried over to it.
#[derive(Clone, Copy, Debug)]
pub(super) struct BlockWay {
    /// Length of its move alone, mm.
    pub own: f32,
    /// Carried over to it; below 0: length that the last block was given too much.
    pub carried: f32,
    /// Of the block, which is longer than both where that would be too little for its steps.
    pub length: f32,
}

/// Seconds of a move of this length, and mm/s.
fn time_and_feed(speed: Speed, own: f32) -> (f32, f32) {
    match speed {
        Speed::Rapid => (f32::NAN, 0.0),
        Speed::Feed(feed) => (own / feed, feed),
        Speed::Duration(seconds) => (seconds, own / seconds),
    }
}

impl CarriedTime {
    pub(super) const NONE: Self = Self { seconds: 0.0, feed: 0.0 };

    /// A move of this length makes no step, and so much has been carried before.
    pub(super) fn add(&mut self, speed: Speed, own: f32, carried: f32) {
        let (seconds, feed) = time_and_feed(speed, own);
        if carried == 0.0 {
            *self = Self { seconds, feed };
        } else {
            self.seconds += seconds;
            self.feed = if self.feed == feed { feed } else { 0.0 };
        }
    }

    /// The speed of a block, where its move is of this speed. What the block is too long is carried on.
    #[inline]
    pub(super) fn take(&mut self, speed: Speed, way: BlockWay) -> Speed {
        let BlockWay { own, carried, length } = way;
        let (alone, feed) = time_and_feed(speed, own);
        let extra = length - (own + carried);
        let before = if carried == 0.0 { Self { seconds: 0.0, feed } } else { *self };
        *self = Self { seconds: -extra / feed, feed };
        let seconds = match speed {
            Speed::Feed(_) if before.feed != feed && !before.seconds.is_nan() => {
                // Nor is it faster than its feed for what the last block was longer.
                let (least, most) = (lesser(carried / feed, 0.0), greater(alone, MOST_SLOWED_S));
                alone + greater(lesser(before.seconds, most), least) + extra / feed
            }
            Speed::Duration(_) => {
                // Its time is that of the move, however long it is.
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
        // 4 ms and 1 ms.
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
