//! Cuts the next segment out of a block's speed curve: a number of ticks with evenly changing intervals, at the AMASS
//! level that suits the speed. What the fixed-point intervals cannot hold is carried over to the next segment.
//!
//! A segment lasts 1 ms at most, 2 ms where the speed stays or hardly changes (or one tick, if that takes longer), has whole
//! ticks, and ends where a phase of the curve ends. Its intervals change evenly from tick to tick; their sum is the exact time of the curve, and what the fixed point
//! cannot hold goes into the next segment, so no time is lost or gained.

use super::stepper::MAX_LEVEL;
use super::trapezoid::{Pace, Trapezoid, lesser};
use crate::messages::{INTERVAL_FRACTION_BITS, UNITS_PER_STEP};

/// Longest segment of several ticks, in seconds, while the speed changes: how far its even change of the interval may stray from
/// the curve, and how coarsely dynamic laser power follows the speed.
const SEGMENT_TIME: f32 = 0.001;
/// The same where speed and power stay or hardly change: how long a hold or an override may wait for its end, and how far ahead
/// the reported position may be.
const STEADY_TIME: f32 = 0.002;
/// Acceleration by speed, 1/s, up to which speed hardly changes: by 1 % in that time, and the acceleration of the even change of
/// the interval, which goes with the cube of the speed, is 1.5 % off at its ends.
const STEADY: f32 = 5.0;
/// Ticks per second below which smoothing makes them finer: the stepping of a slow axis then jitters by 125 us at most.
const SMOOTH_RATE: f32 = 8000.0;
/// That speed in units/s, at ticks of a whole step.
const COARSEST: f32 = SMOOTH_RATE * UNITS_PER_STEP as f32;
/// Share of speed²/acceleration that one segment may cover: its speed then changes by a tenth, and evenly
/// changing intervals follow the curve within 0.3 % (the intervals of a longer piece bend).
const EVEN: f32 = 0.1;
/// Phases shorter than this many units end on the nearest tick, longer ones on the next whole step.
const WHOLE_STEPS: u32 = 4 * UNITS_PER_STEP;

/// A speed in units/s that no machine comes near.
const ENDLESS: f32 = 1.0e18;

/// A piece of a block.
#[derive(Clone, Copy, Debug)]
pub(super) struct Cut {
    pub units: u32,
    pub level: u8,
    pub ticks: u32,
    pub seconds: f32,
    /// Speed at its end, in units/s.
    pub end: Pace,
    /// Change of the interval from tick to tick, in seconds.
    pub ramp: f32,
    /// Acceleration at its end, mm/s²; only with a jerk limit.
    pub acceleration: f32,
}

/// Speed in units/s above which a level is not needed.
#[inline]
fn amass_level_speed(level: u8) -> f32 {
    // Half of a number has an exponent that is less by one: no conversion and no division.
    f32::from_bits(COARSEST.to_bits() - (u32::from(level) << 23))
}

/// The AMASS level of a segment: the coarsest one whose ticks are fast enough.
#[inline]
fn amass_level_for(speed: f32) -> u8 {
    // Positive numbers are ordered as their bits are.
    let below = COARSEST.to_bits() as i32 - speed.to_bits() as i32;
    (((below - 1) >> 23) + 1).clamp(0, i32::from(MAX_LEVEL)) as u8
}

/// Units of a tick of this level `done` units after the start of a block, or as many as the place and the `left` units
/// allow; and how many units such ticks may go.
#[inline(always)]
fn grain(level: u8, done: u32, left: u32) -> (u32, u32) {
    // A coarser tick begins at its own multiples only: until there, ticks as fine as the place allows.
    let mut grain = UNITS_PER_STEP >> level;
    let mut limit = left;
    let astray = done & (grain - 1);
    if astray != 0 {
        limit = limit.min(grain - astray);
        grain = 1 << done.trailing_zeros();
    }
    while grain > limit {
        grain >>= 1;
    }
    (grain, limit)
}

/// A piece of about a millisecond: units of a tick, and how many ticks.
#[derive(Clone, Copy, Debug)]
pub(super) struct SegmentSize {
    pub grain: u32,
    pub ticks: u32,
}

impl SegmentSize {
    /// The piece that a machine of this pace and acceleration (units, seconds) goes next.
    #[inline]
    pub(super) fn next(pace: Pace, acceleration: f32, done: u32, left: u32) -> Self {
        let level = amass_level_for(pace.speed);
        let mut reach = (pace.speed + 0.5 * acceleration * SEGMENT_TIME) * SEGMENT_TIME;
        let steepness = acceleration.abs();
        if steepness * SEGMENT_TIME > 1.0e-6 * pace.speed {
            reach = lesser(reach, EVEN * pace.speed2 / steepness);
            let edge = match acceleration > 0.0 {
                true if level > 0 => amass_level_speed(level - 1),
                false if level < MAX_LEVEL => amass_level_speed(level),
                _ => f32::INFINITY,
            };
            reach = lesser(reach, (edge * edge - pace.speed2).abs() / (2.0 * steepness));
        }
        let (grain, limit) = grain(level, done, left);
        let mut units = if reach > 0.0 { reach as u32 } else { 0 };
        if units >= UNITS_PER_STEP && units < limit {
            units = ((done + units) & !(UNITS_PER_STEP - 1)) - done;
        }
        let most = (limit / grain).min(u32::from(u16::MAX));
        Self { grain, ticks: (units / grain).clamp(1, most) }
    }

    /// The piece as it is gone from one speed to another (units/s) in so many seconds.
    #[inline]
    pub(super) fn cut(self, speed: f32, end: Pace, seconds: f32) -> Cut {
        let Self { grain, ticks } = self;
        let mut ramp = 0.0;
        if ticks > 1 && speed > 0.0 && end.speed > 0.0 {
            ramp = grain as f32 * (speed - end.speed) / (speed * end.speed) / ticks as f32;
        }
        let level = (UNITS_PER_STEP / grain).trailing_zeros() as u8;
        Cut { units: ticks * grain, level, ticks, seconds, end, ramp, acceleration: 0.0 }
    }
}

/// The next piece, `left` (> 0) units before the end of the curve, `done` units after the start of the block.
#[inline(always)]
pub(super) fn cut(curve: &Trapezoid, done: u32, left: u32, pace: Pace, scales_power: bool) -> Cut {
    let Pace { speed, speed2 } = pace;
    let phase = curve.phase(speed2, left as f32);
    let mut level = amass_level_for(speed);
    let steady = phase.sign == 0.0 || curve.acceleration <= STEADY * speed;
    let time = if steady && !scales_power { STEADY_TIME } else { SEGMENT_TIME };
    let change = phase.sign * curve.acceleration * time;
    // A braking that ends within the time: all of it.
    let mut reach = if speed + change > 0.0 { (speed + 0.5 * change) * time } else { speed * time };
    if phase.sign != 0.0 {
        // The speed at which the level ends. Twice the acceleration times the way is the change of speed².
        let edge = if phase.sign > 0.0 {
            if level > 0 { amass_level_speed(level - 1) } else { ENDLESS }
        } else if level < MAX_LEVEL {
            amass_level_speed(level)
        } else {
            0.0
        };
        let change2 = lesser(EVEN * speed2, 0.5 * (edge * edge - speed2).abs());
        reach = lesser(reach, change2 / curve.acceleration);
    }

    let (grain, limit) = grain(level, done, left);
    level = (UNITS_PER_STEP / grain).trailing_zeros() as u8;

    // What is left on a whole step reaches into the ramp behind it, and the change is spread over the segment: a short one.
    if phase.sign == 0.0 && phase.length <= reach && phase.length + (UNITS_PER_STEP as f32) < left as f32 {
        reach = lesser(reach, speed * SEGMENT_TIME);
    }
    let units = if phase.length <= reach {
        // A phase of some steps is left on a whole step, a shorter one at the tick.
        let length = phase.length as u32;
        let round = if length >= WHOLE_STEPS { UNITS_PER_STEP } else { grain };
        let end = done + length;
        ((end & !(round - 1)) + round) - done
    } else {
        let units = reach as u32;
        if units >= UNITS_PER_STEP { ((done + units) & !(UNITS_PER_STEP - 1)) - done } else { units }
    };
    let most = (limit / grain).min(u32::from(u16::MAX));
    let ticks = (units / grain).clamp(1, most);
    let units = ticks * grain;

    let (seconds, end) = curve.advance(pace, phase, left as f32, units as f32);
    let mut ramp = 0.0;
    if ticks > 1 && phase.sign != 0.0 && speed > 0.0 && end.speed > 0.0 {
        // The interval is grain / speed at either end of the segment.
        ramp = grain as f32 * (speed - end.speed) / (speed * end.speed) / ticks as f32;
    }
    Cut { units, level, ticks, seconds, end, ramp, acceleration: 0.0 }
}

/// Intervals of one segment.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Intervals {
    pub interval: u32,
    pub ramp: i32,
    /// Whole step-clock ticks, for accounts of queued time.
    pub clocks: u32,
}

/// The step clock, and the remainder that the last segment could not hold.
#[derive(Clone, Copy, Debug)]
pub(super) struct Pacer {
    /// Fixed-point units of an interval in a second.
    per_second: f32,
    remainder: u32,
}

/// One clock tick, the least interval.
const ONE: u32 = 1 << INTERVAL_FRACTION_BITS;

impl Pacer {
    pub(super) const fn new(step_clock_hz: u32) -> Self {
        Self { per_second: step_clock_hz as f32 * ONE as f32, remainder: 0 }
    }

    /// Seconds in fixed point. Saturates (at centuries).
    #[inline]
    pub(super) fn fixed(&self, seconds: f32) -> u64 {
        let time = seconds * self.per_second;
        // The 32-bit conversion is one instruction, the wide one a function.
        if time < 4.0e9 { u64::from(time as u32) } else { time as u64 }
    }

    /// Whole step-clock ticks in fixed point.
    #[inline]
    pub(super) fn whole(&self, clocks: u32) -> u32 {
        clocks.saturating_mul(ONE)
    }

    /// Spreads a time over 65535 ticks at most with an even change. At 4 ms and 100 MHz the time has 31 bits.
    #[inline]
    pub(super) fn intervals(&mut self, time: u32, ticks: u32, ramp: f32) -> Intervals {
        let least = ticks.saturating_mul(ONE);
        let total = time.saturating_add(self.remainder).max(least);
        let ramp = self.ramp(ramp, total, ticks);
        // Sum over the ticks: ticks × interval + ramp × ticks × (ticks - 1) / 2, a product that is even.
        let rise = i64::from(ramp) * i64::from(ticks.wrapping_mul(ticks - 1) / 2);
        let flat = (i64::from(total) - rise).max(0) as u64;
        let (interval, remainder) = match u32::try_from(flat) {
            Ok(flat) => (flat / ticks, flat % ticks),
            Err(_) => ((flat / u64::from(ticks)) as u32, (flat % u64::from(ticks)) as u32),
        };
        self.remainder = remainder;
        Intervals { interval, ramp, clocks: total >> INTERVAL_FRACTION_BITS }
    }

    /// A change of the interval, in seconds, in fixed point. Whatever the curve says, the shortest tick keeps a quarter of the
    /// average.
    #[inline]
    fn ramp(&self, ramp: f32, total: u32, ticks: u32) -> i32 {
        let ramp = (ramp * self.per_second) as i32;
        if ramp == 0 {
            return 0;
        }
        let average = total / ticks;
        let steepest = (average - average / 4).saturating_sub(ONE).checked_div(ticks - 1).unwrap_or(0);
        let steepest = steepest.min(i32::MAX as u32) as i32;
        ramp.clamp(-steepest, steepest)
    }
}

#[cfg(test)]
mod tests {
    use super::{COARSEST, MAX_LEVEL, ONE, Pacer, amass_level_for, amass_level_speed};

    #[test]
    fn a_level_ends_at_its_speed() {
        for level in 0..MAX_LEVEL {
            let edge = amass_level_speed(level);
            assert_eq!(edge, COARSEST / f32::from(1_u8 << level));
            assert_eq!((amass_level_for(edge), amass_level_for(edge.next_down())), (level, level + 1));
        }
        assert_eq!([f32::MAX, f32::MIN_POSITIVE, 0.0].map(amass_level_for), [0, MAX_LEVEL, MAX_LEVEL]);
    }

    #[test]
    fn no_part_of_a_tick_is_lost() {
        let mut pacer = Pacer::new(96_000_000);
        let (mut asked, mut given) = (0_u64, 0_u64);
        for k in 1..20_000_u32 {
            let ticks = k % 37 + 1;
            let time = ticks * (2000 + k % 911) * ONE / 7 + k % 4099;
            asked += u64::from(time);
            let slope = (k as f32 * 0.7 - 7000.0) / 96.0e9;
            let made = pacer.intervals(time, ticks, slope);
            for tick in 0..i64::from(ticks) {
                let interval = i64::from(made.interval) + i64::from(made.ramp) * tick;
                assert!(interval >= i64::from(ONE));
                given += interval as u64;
            }
            assert_eq!(asked, given + u64::from(pacer.remainder));
            assert!(pacer.remainder < 37);
        }
    }
}
