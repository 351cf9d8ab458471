//! The speed curve within a block: speed squared over the remaining distance, with edges of constant acceleration.
//! Determines whether the block accelerates, cruises or brakes next, and the exact duration of a piece of it.
//!
//! ```text
//!  v²   nominal² ________________
//!             /                  \      each edge rises or falls by 2·a per unit of distance;
//!            /                    \     the falling one is fixed to the block's end, so it cannot drift
//!  now²     /                      \  exit²
//! ```
//! Distances are in units (1/16 step of the dominant axis), speeds in units/s. A speed² above the curve (after an
//! override) drops by 2·a per unit of distance until it meets the curve, if necessary beyond the end of the block.

/// The square root that the whole controller uses: IEEE, so the result is the same on every machine.
pub(super) use oxmill_sqrt::square_root;

/// Returns the lesser of two numbers in three instructions. (`f32::min` calls a library function on a Cortex-M4.)
#[inline]
pub(super) fn lesser(a: f32, b: f32) -> f32 {
    if a < b { a } else { b }
}

#[inline]
pub(super) fn greater(a: f32, b: f32) -> f32 {
    if a > b { a } else { b }
}

/// Returns a / b. Call it in a branch that is rarely taken. Without the hint `cold_path`, the compiler would divide
/// before it tests the condition of the branch, and a division takes 14 cycles.
#[inline]
pub(super) fn quotient(a: f32, b: f32) -> f32 {
    core::hint::cold_path();
    a / b
}

/// Relative difference below which two speeds² count as the same: about 30 rounding errors of an `f32`.
const SAME: f32 = 4.0e-6;
/// The falling edge of the curve is the speed² from which the machine can just brake to the exit speed. If a speed² is
/// higher than this factor times the falling edge, rounding is not the cause. The exit speed or the acceleration has
/// been lowered meanwhile.
pub(super) const OFF_CURVE: f32 = 1.001;
/// Maximum number of phases in a piece. In theory there are at most three: brake to nominal or accelerate, cruise,
/// brake. The others are a margin for rounding.
const MOST_PHASES: u32 = 8;

/// Speed limits for the rest of a block: the acceleration in units/s², and the squares of nominal and exit speed.
#[derive(Clone, Copy, Debug)]
pub(super) struct Trapezoid {
    pub acceleration: f32,
    pub nominal2: f32,
    pub exit2: f32,
}

/// A speed and its square, kept together to save multiplications and square roots.
#[derive(Clone, Copy, Debug)]
pub(super) struct Pace {
    pub speed: f32,
    pub speed2: f32,
}

impl Pace {
    pub(super) const REST: Self = Self { speed: 0.0, speed2: 0.0 };

    /// Returns the same speed in units that are `factor` times smaller.
    pub(super) fn scaled(self, factor: f32) -> Self {
        Self { speed: self.speed * factor, speed2: self.speed2 * factor * factor }
    }
}

/// A part of the curve with constant acceleration.
#[derive(Clone, Copy, Debug)]
pub(super) struct TrapezoidPhase {
    /// Sign of the acceleration: +1, 0 or -1.
    pub sign: f32,
    /// Distance from the current position to the end of the phase, units.
    pub length: f32,
    /// Speed² at the end of the phase.
    end2: f32,
}

impl Trapezoid {
    /// Returns the phase at a speed² with `left` units to the end of the block.
    #[inline]
    pub(super) fn phase(&self, speed2: f32, left: f32) -> TrapezoidPhase {
        let slope = 2.0 * self.acceleration;
        let brake2 = self.exit2 + slope * left;
        if speed2 >= brake2 * (1.0 - SAME) {
            // The speed² is on the falling edge or above it, so the machine brakes. From the edge, it reaches the exit
            // speed. From above the edge, the block ends with the speed that remains.
            let end2 = if speed2 > brake2 * OFF_CURVE { speed2 - slope * left } else { self.exit2 };
            return TrapezoidPhase { sign: -1.0, length: left, end2: greater(end2, self.exit2) };
        }
        let missing2 = self.nominal2 - speed2;
        if missing2 < -SAME * speed2 {
            return TrapezoidPhase { sign: -1.0, length: -missing2 / slope, end2: self.nominal2 };
        }
        if missing2 <= SAME * speed2 {
            return TrapezoidPhase { sign: 0.0, length: (brake2 - self.nominal2) / slope, end2: self.nominal2 };
        }
        // Both edges have the same slope, so they meet half way between the present speed² and the speed² of the
        // falling edge here.
        let meet2 = 0.5 * (brake2 - speed2);
        if meet2 < missing2 {
            TrapezoidPhase { sign: 1.0, length: meet2 / slope, end2: speed2 + meet2 }
        } else {
            TrapezoidPhase { sign: 1.0, length: missing2 / slope, end2: self.nominal2 }
        }
    }

    /// Advances by `distance` units. `from`: pace (speed and its square) at the start. `phase`: phase of the curve at
    /// the start. `left`: units from the start to the end of the block. Returns the time in seconds and the pace at
    /// the end. Both are exact, even from rest or to rest.
    #[inline(always)]
    pub(super) fn advance(&self, from: Pace, phase: TrapezoidPhase, left: f32, distance: f32) -> (f32, Pace) {
        let whole = phase.length <= distance;
        let piece = if whole { phase.length } else { distance };
        let (time, pace) = self.within(from, phase, piece, whole);
        if !whole || distance - piece <= 0.0 {
            return (time, pace);
        }
        self.advance_on((time, pace), left - piece, distance - piece)
    }

    /// Continues [`Trapezoid::advance`] after the first phase, from its time and the pace at its end.
    // Not inlined: few segments need this, and inlined code would make every segment save more registers.
    #[inline(never)]
    fn advance_on(self, (mut time, mut pace): (f32, Pace), mut left: f32, mut distance: f32) -> (f32, Pace) {
        for _ in 1..MOST_PHASES {
            let phase = self.phase(pace.speed2, left);
            let whole = phase.length <= distance;
            let piece = if whole { phase.length } else { distance };
            let (more, end) = self.within(pace, phase, piece, whole);
            time += more;
            pace = end;
            left -= piece;
            distance -= piece;
            if !whole || distance <= 0.0 {
                return (time, pace);
            }
        }
        if pace.speed > 0.0 {
            time += distance / pace.speed;
        }
        (time, pace)
    }

    /// Advances by a piece of a phase, or by the whole phase. Returns the time in seconds and the pace afterwards.
    #[inline(always)]
    fn within(&self, from: Pace, phase: TrapezoidPhase, piece: f32, whole: bool) -> (f32, Pace) {
        let slope = 2.0 * self.acceleration;
        let speed2 = if whole {
            phase.end2
        } else if phase.sign < 0.0 {
            // Computed from the end of the phase backwards, because the speed at the end must be exact.
            phase.end2 + slope * (phase.length - piece)
        } else {
            from.speed2 + phase.sign * slope * piece
        };
        let speed = square_root(speed2);
        let sum = from.speed + speed;
        let mut time = 0.0;
        if piece > 0.0 {
            // The square root gives the time if both speeds are so low that they were rounded to 0.
            time = if sum > 0.0 { 2.0 * piece / sum } else { square_root(2.0 * piece / self.acceleration) };
        }
        (time, Pace { speed, speed2 })
    }
}
