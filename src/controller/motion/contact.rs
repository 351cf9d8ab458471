//! A probe's contact: the latch that the step generator reads at each tick ([`ProbeLatch`]), the state at the contact
//! ([`Contact`]), and the deceleration after it. `Stepper` in `stepper.rs` uses all three.

use super::course::Course;
use crate::axes::PerAxis;
use crate::messages::INTERVAL_FRACTION_BITS;

/// Upper limit of the tick interval during braking, in fixed point (2^18 step-clock ticks, a few milliseconds). If the
/// next interval would reach this limit, the motion is negligibly slow and braking ends. The limit also keeps sums of
/// intervals within 32 bits.
const LONGEST_BRAKING: f32 = (1_u32 << 30) as f32;

/// Catches the first contact of a watched probe.
#[derive(Clone, Copy, Debug)]
#[repr(C)]
pub(super) struct ProbeLatch {
    pub(super) is_watching: bool,
    /// The probe state that counts as contact; `true`: active.
    watched: bool,
    /// Whether a contact was seen at the previous tick, and the stepper has not processed it yet.
    pub(super) is_unnoted: bool,
}

impl ProbeLatch {
    pub(super) const OFF: Self = Self { is_watching: false, watched: false, is_unnoted: false };

    /// Begins to watch for a state of the probe (`true`: active) that counts as contact; `None` ends watching.
    #[inline(always)]
    pub(super) fn watch(&mut self, probe: Option<bool>) {
        self.is_watching = probe.is_some();
        self.watched = probe == Some(true);
    }

    /// Returns `true` at the first tick at which the probe has the watched state, and then ends watching. `active`:
    /// state of the probe at this tick.
    #[inline(always)]
    pub(super) fn detect(&mut self, active: bool) -> bool {
        let touched = self.is_watching && self.watched == active;
        if touched {
            self.is_watching = false;
            self.is_unnoted = true;
        }
        touched
    }
}

/// Copy of the running block and its progress, made when the probe makes contact. The position is computed from the
/// copy later, so that this tick takes little time.
#[derive(Clone, Copy, Debug)]
#[repr(C)]
pub(super) struct Contact<const N: usize> {
    pub(super) course: Course<N>,
    pub(super) left: [u32; N],
    pub(super) units: u32,
}

impl<const N: usize> Contact<N> {
    pub(super) const START: Self = Self { course: Course::NOWHERE, left: [0; N], units: 0 };

    pub(super) fn position(&self) -> PerAxis<i32, N> {
        self.course.position(&self.left, self.units)
    }
}

/// Returns the interval of the next tick while the machine brakes after a contact; `None` when braking is complete.
/// Intervals are fixed-point numbers of step-clock ticks. `interval`: interval of the present tick; `braking`:
/// deceleration in units per squared step-clock tick.
///
/// A tick that advances u units in the interval T has the speed v = u/T. With the deceleration a (`braking`), v² falls
/// by 2·a·u from tick to tick. So the next interval is T / √(1 - 2k), where k = a·T²/u. The code uses the first terms
/// of the series of this formula. The ramp ends with the tick that would reduce v² to 0.
#[inline(always)]
pub(super) fn braked_interval(interval: u32, units_per_tick: u32, braking: f32) -> Option<u32> {
    let ticks = interval as f32 / (1 << INTERVAL_FRACTION_BITS) as f32;
    let k = braking * ticks * ticks / units_per_tick as f32;
    let next = interval as f32 * (1.0 + k * (1.0 + k * (1.5 + k * 2.5)));
    // A tick that advances no units is a wait. It occurs only in a very slow motion. There `k` is infinite or NaN, so
    // the motion stops at once.
    (k < 0.5 && next < LONGEST_BRAKING).then_some(next as u32)
}
