//! Cuts the next segment out of a block's speed curve. A segment is a number of ticks whose intervals change linearly.
//! As in Grbl, its AMASS level determines how fine the ticks are, and depends on the speed: at level n, a step of the
//! dominant axis (the one with the most steps) takes 2^n ticks.
//!
//! A segment has whole ticks. The curve has the phases accelerate, cruise and brake. A segment can end within the phase
//! in which it begins. Otherwise it ends at the first tick or whole step after the end of this phase. It lasts at most
//! 1 ms. The limit is 2 ms if the speed is constant or nearly so and the power does not follow the speed. A single tick
//! can last longer.
//!
//! The sum of the intervals is the exact time of the curve. The remainder that the fixed-point intervals cannot
//! represent is carried over to the next segment, so no time is lost or gained.

use super::stepper::MAX_LEVEL;
use super::trapezoid::{Pace, Trapezoid, lesser};
use crate::messages::{INTERVAL_FRACTION_BITS, UNITS_PER_STEP};

/// Maximum duration of a segment of several ticks while the speed changes, s. It limits how far the ticks, whose
/// intervals change linearly, deviate from the speed curve. It also limits how coarsely dynamic laser power follows
/// the speed.
const SEGMENT_TIME: f32 = 0.001;
/// Maximum duration of a segment while the speed is constant or nearly so and the power does not follow it, s. Limits
/// the delay of a hold or an override, and how far ahead the reported position can be.
const STEADY_TIME: f32 = 0.002;
/// Ratio of acceleration to speed, 1/s, up to which the speed counts as nearly constant: it changes by 1 % within
/// [`STEADY_TIME`]. With linearly changing intervals, the acceleration of the ticks is proportional to the cube of the
/// speed. So the acceleration is 1.5 % off at either end of the segment.
const STEADY: f32 = 5.0;
/// Ticks per second below which smoothing makes ticks finer, so that the steps of a slow axis jitter by at most 125 us.
const SMOOTH_RATE: f32 = 8000.0;
/// Speed in units/s at which ticks of a whole step have the rate [`SMOOTH_RATE`].
const COARSEST: f32 = SMOOTH_RATE * UNITS_PER_STEP as f32;
/// Maximum length of a segment as a share of speed²/acceleration. Over this length the speed changes by a tenth, and
/// ticks whose intervals change linearly follow the speed curve within 0.3 %. In a longer segment they would deviate
/// more.
const EVEN: f32 = 0.1;
/// Phases shorter than this many units end on the next tick, longer ones on the next whole step.
const WHOLE_STEPS: u32 = 4 * UNITS_PER_STEP;

/// A speed in units/s far beyond any machine's.
const ENDLESS: f32 = 1.0e18;

/// A piece of a block that becomes one segment: length in units, AMASS level, ticks, duration, and state at the end.
#[derive(Clone, Copy, Debug)]
pub(super) struct Cut {
    pub units: u32,
    pub level: u8,
    pub ticks: u32,
    pub seconds: f32,
    /// Speed at the end of the piece, in units/s.
    pub end: Pace,
    /// Change of the interval from tick to tick, in seconds.
    pub ramp: f32,
    /// Acceleration at the end of the piece, mm/s²; only with a jerk limit.
    pub acceleration: f32,
}

/// Returns the minimum speed, in units/s, at which `level` suffices: [`COARSEST`] / 2^level.
#[inline]
fn amass_level_speed(level: u8) -> f32 {
    // Halving a number lowers its exponent by one: this needs neither a conversion nor a division.
    f32::from_bits(COARSEST.to_bits() - (u32::from(level) << 23))
}

/// Returns the AMASS level of a segment: the coarsest one with at least [`SMOOTH_RATE`] ticks per second, or else the
/// finest one.
#[inline]
fn amass_level_for(speed: f32) -> u8 {
    // Positive numbers are ordered like their bits.
    let below = COARSEST.to_bits() as i32 - speed.to_bits() as i32;
    (((below - 1) >> 23) + 1).clamp(0, i32::from(MAX_LEVEL)) as u8
}

/// Returns the units per tick at `level`, and how many units can be covered with ticks of this size. The ticks are
/// finer than the level if the position (`done` units after the start of the block) or the `left` units require it.
#[inline(always)]
fn grain(level: u8, done: u32, left: u32) -> (u32, u32) {
    // A tick must begin at a multiple of its size. Up to the next multiple, ticks are only as coarse as the position
    // allows.
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

/// Size of a segment of about a millisecond: `grain` units per tick, and number of ticks.
#[derive(Clone, Copy, Debug)]
pub(super) struct SegmentSize {
    pub grain: u32,
    pub ticks: u32,
}

impl SegmentSize {
    /// Returns the size of the next segment for a machine with this pace (units/s) and acceleration (units/s²), `done`
    /// units after the start of the block and `left` units before its end.
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

    /// Returns a segment of this size in which the speed changes from `speed` to `end` (units/s) within `seconds`.
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

/// Returns the next segment of the block. It begins `left` (> 0) units before the end of the speed curve and `done`
/// units after the start of the block.
#[inline(always)]
pub(super) fn cut(curve: &Trapezoid, done: u32, left: u32, pace: Pace, scales_power: bool) -> Cut {
    let Pace { speed, speed2 } = pace;
    let phase = curve.phase(speed2, left as f32);
    let mut level = amass_level_for(speed);
    let steady = phase.sign == 0.0 || curve.acceleration <= STEADY * speed;
    let time = if steady && !scales_power { STEADY_TIME } else { SEGMENT_TIME };
    let change = phase.sign * curve.acceleration * time;
    // If the machine would come to rest within the time, reach far enough to include all of the braking.
    let mut reach = if speed + change > 0.0 { (speed + 0.5 * change) * time } else { speed * time };
    if phase.sign != 0.0 {
        // `edge` is the speed at which the AMASS level changes. The change of speed² is twice the acceleration times
        // the distance.
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

    // If a cruise is extended to a whole step, it reaches into the ramp after it. The change of speed is then spread
    // over the whole segment, so keep the segment short.
    if phase.sign == 0.0 && phase.length <= reach && phase.length + (UNITS_PER_STEP as f32) < left as f32 {
        reach = lesser(reach, speed * SEGMENT_TIME);
    }
    let units = if phase.length <= reach {
        // A phase of several steps ends on a whole step, a shorter one on a tick.
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

/// Intervals of the ticks of one segment, in fixed point: the first interval, and its change from tick to tick.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Intervals {
    pub interval: u32,
    pub ramp: i32,
    /// Duration of the segment in whole step-clock ticks; summed up to the queued time.
    pub clocks: u32,
}

/// Converts times to step-clock ticks, and keeps the remainder that the intervals of the previous segment could not
/// represent.
#[derive(Clone, Copy, Debug)]
pub(super) struct Pacer {
    /// Step-clock ticks per second, in the fixed point of intervals.
    per_second: f32,
    remainder: u32,
}

/// One step-clock tick in fixed point: the minimum interval.
const ONE: u32 = 1 << INTERVAL_FRACTION_BITS;

impl Pacer {
    pub(super) const fn new(step_clock_hz: u32) -> Self {
        Self { per_second: step_clock_hz as f32 * ONE as f32, remainder: 0 }
    }

    /// Converts seconds to step-clock ticks in fixed point. The result saturates if the time is too long: more than a
    /// year at 100 MHz.
    #[inline]
    pub(super) fn fixed(&self, seconds: f32) -> u64 {
        let time = seconds * self.per_second;
        // The 32-bit conversion is one instruction, the wide one a function.
        if time < 4.0e9 { u64::from(time as u32) } else { time as u64 }
    }

    /// Converts whole step-clock ticks to fixed point.
    #[inline]
    pub(super) fn whole(&self, clocks: u32) -> u32 {
        clocks.saturating_mul(ONE)
    }

    /// Distributes a time (fixed point) over at most 65535 ticks whose intervals change by `ramp` seconds from tick to
    /// tick. The time fits 32 bits: 4 ms at 100 MHz have 31 bits.
    #[inline]
    pub(super) fn intervals(&mut self, time: u32, ticks: u32, ramp: f32) -> Intervals {
        let least = ticks.saturating_mul(ONE);
        let total = time.saturating_add(self.remainder).max(least);
        let ramp = self.ramp(ramp, total, ticks);
        // The sum over the ticks is ticks × interval + ramp × ticks × (ticks - 1) / 2. The product of two neighbouring
        // numbers is even, so the division is exact.
        let rise = i64::from(ramp) * i64::from(ticks.wrapping_mul(ticks - 1) / 2);
        let flat = (i64::from(total) - rise).max(0) as u64;
        let (interval, remainder) = match u32::try_from(flat) {
            Ok(flat) => (flat / ticks, flat % ticks),
            Err(_) => ((flat / u64::from(ticks)) as u32, (flat % u64::from(ticks)) as u32),
        };
        self.remainder = remainder;
        Intervals { interval, ramp, clocks: total >> INTERVAL_FRACTION_BITS }
    }

    /// Converts a change of the interval from seconds to fixed point. Limits it, so that the intervals of a segment
    /// differ by less than three quarters of their average.
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
