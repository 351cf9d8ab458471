//! The speed curve within a block: speed squared over the distance left, with edges of constant acceleration. Tells
//! whether the block accelerates, cruises or brakes next, and the exact time of a piece of it.
//!
//! ```text
//!  v²   nominal² ________________
//!             /                  \      each edge rises or falls by 2·a per unit of distance;
//!            /                    \     the falling one is fixed to the block's end, so it cannot drift
//!  now²     /                      \  exit²
//! ```
//! Distances in units (1/16 step of the dominant axis), speeds in units/s. A speed above the curve (after an override)
//! falls by 2·a per unit until it meets it, over the end of the block if it must.

/// The one square root of the controller: IEEE, so the same on every machine.
pub(super) use oxmill_sqrt::square_root;

/// The lesser of two numbers. `f32::min` is a call of a library function on a Cortex-M4, this three instructions.
#[inline]
pub(super) fn lesser(a: f32, b: f32) -> f32 {
    if a < b { a } else { b }
}

/// The greater of two numbers.
#[inline]
pub(super) fn greater(a: f32, b: f32) -> f32 {
    if a > b { a } else { b }
}

/// A quotient that is seldom asked for. A compiler that is not told so divides first, in 14 cycles, and asks then.
#[inline]
pub(super) fn quotient(a: f32, b: f32) -> f32 {
    core::hint::cold_path();
    a / b
}

/// Speeds² closer than this (relative) are the same: some 30 roundings of an `f32`.
const SAME: f32 = 4.0e-6;
/// A speed² above the falling edge by this factor is not there by rounding: it has been made lower since.
pub(super) const OFF_CURVE: f32 = 1.001;
/// A piece meets at most: brake to nominal, cruise, brake; or accelerate, cruise, brake. The rest is for roundings.
const MOST_PHASES: u32 = 8;

/// What bounds the speed in the rest of a block.
#[derive(Clone, Copy, Debug)]
pub(super) struct Trapezoid {
    pub acceleration: f32,
    pub nominal2: f32,
    pub exit2: f32,
}

/// A speed and its square, kept together because either costs a multiplication or a root.
#[derive(Clone, Copy, Debug)]
pub(super) struct Pace {
    pub speed: f32,
    pub speed2: f32,
}

impl Pace {
    pub(super) const REST: Self = Self { speed: 0.0, speed2: 0.0 };

    /// The same speed in units that are `factor` times smaller.
    pub(super) fn scaled(self, factor: f32) -> Self {
        Self { speed: self.speed * factor, speed2: self.speed2 * factor * factor }
    }
}

/// A stretch with one acceleration.
#[derive(Clone, Copy, Debug)]
pub(super) struct TrapezoidPhase {
    /// +1, 0 or -1 times the acceleration.
    pub sign: f32,
    /// Distance until it ends.
    pub length: f32,
    /// Speed² at that end.
    end2: f32,
}

impl Trapezoid {
    /// The phase at a speed² with `left` units to the end of the block.
    #[inline]
    pub(super) fn phase(&self, speed2: f32, left: f32) -> TrapezoidPhase {
        let slope = 2.0 * self.acceleration;
        let brake2 = self.exit2 + slope * left;
        if speed2 >= brake2 * (1.0 - SAME) {
            // On the falling edge; or above it, when it is left at the end of the block with what speed remains.
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
        // Where the rising edge meets the falling one it is half as high above the lower of the two as they are apart.
        let meet2 = 0.5 * (brake2 - speed2);
        if meet2 < missing2 {
            TrapezoidPhase { sign: 1.0, length: meet2 / slope, end2: speed2 + meet2 }
        } else {
            TrapezoidPhase { sign: 1.0, length: missing2 / slope, end2: self.nominal2 }
        }
    }

    /// Advances by `distance` of the `left` units, beginning in `phase`: seconds and the pace after it. Exact also from and to
    /// rest.
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

    /// The same beyond the first phase: from what that took, and the pace at its end.
    // By itself: few segments come here, and all would save more registers for it.
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

    /// Advances by a piece of a phase, or the whole of it.
    #[inline(always)]
    fn within(&self, from: Pace, phase: TrapezoidPhase, piece: f32, whole: bool) -> (f32, Pace) {
        let slope = 2.0 * self.acceleration;
        let speed2 = if whole {
            phase.end2
        } else if phase.sign < 0.0 {
            // Measured from the phase's end, where it must arrive exactly.
            phase.end2 + slope * (phase.length - piece)
        } else {
            from.speed2 + phase.sign * slope * piece
        };
        let speed = square_root(speed2);
        let sum = from.speed + speed;
        let mut time = 0.0;
        if piece > 0.0 {
            // The second form is for a rest that rounding made of a crawl.
            time = if sum > 0.0 { 2.0 * piece / sum } else { square_root(2.0 * piece / self.acceleration) };
        }
        (time, Pace { speed, speed2 })
    }
}
