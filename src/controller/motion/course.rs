//! The block that the step generator is running ([`Course`]). The length of a block is counted in units: 16 units for
//! each step of the axis with the most steps. Each axis has a countdown to its next step, which falls by the axis'
//! rate with each unit (see `dda`).
//!
//! The position is not updated at each tick, because that would take time. When a position is needed, it is computed
//! exactly from the units that the block has advanced and from each axis' countdown. `measure` explains the
//! arithmetic.

use super::measure::{Measure, advance, inverse, parts_beyond, signed_add, steps_and_rest};
use crate::axes::PerAxis;
use crate::messages::AxisSteps;
use core::sync::atomic::{Ordering, compiler_fence};

/// The running block of the step generator, or the next one.
#[derive(Clone, Copy, Debug)]
#[repr(C)]
pub(super) struct Course<const N: usize> {
    /// Offset of each axis' exact start from the nearest full step, in parts of a step: a full step has `threshold`
    /// parts. Negative numbers are wrapped.
    pub(super) beyond: [u32; N],
    /// For each axis, how much its countdown to the next step falls with each unit; a whole step is `threshold`.
    pub(super) rates: [u32; N],
    pub(super) threshold: u32,
    /// Length of the block in units: 16 for each step of the axis with the most steps.
    pub(super) total: u32,
    /// Units of the block that were complete when other moves (such as parking) interrupted it. The block continues
    /// after these units; 0: it begins at its start.
    pub(super) entered: u32,
    pub(super) directions: u8,
    /// Position at the start of the block.
    pub(super) base: [i32; N],
    pub(super) end: [i32; N],
}

impl<const N: usize> Course<N> {
    pub(super) const NOWHERE: Self = Self {
        beyond: [0; N],
        rates: [0; N],
        threshold: 0,
        total: 0,
        entered: 0,
        directions: 0,
        base: [0; N],
        end: [0; N],
    };

    /// Returns each axis' countdown to its next step at the start of the block: half a step, less the offset of the
    /// exact start. A whole step is `threshold`.
    #[inline(always)]
    fn first(&self) -> [u32; N] {
        self.beyond.map(|beyond| (self.threshold / 2).wrapping_sub(beyond))
    }

    /// Returns the position after `units` of the block. `left`: each axis' countdown to its next step at that point.
    ///
    /// The number of steps n that an axis has taken satisfies n · threshold = rate · units + `left` - `first`, where
    /// `first` is the countdown at the start of the block. So n is the right side divided by the threshold. The
    /// division leaves no remainder, and n is below 2^32. Therefore the code needs no division: it shifts right by the
    /// trailing zeros of the threshold, then multiplies by the inverse of the threshold's odd part, modulo 2^32.
    #[inline(never)]
    pub(super) fn position(&self, left: &[u32; N], units: u32) -> PerAxis<i32, N> {
        let Course { rates, threshold, directions, base, .. } = self;
        let mut position = *base;
        if *threshold == 0 {
            return PerAxis(position);
        }
        let even = threshold.trailing_zeros();
        let inverse = inverse(threshold >> even);
        let lefts = left.iter().zip(self.first());
        for (bit, (value, (rate, (left, first)))) in position.iter_mut().zip(rates.iter().zip(lefts)).enumerate() {
            let sum = advance(*rate, units).wrapping_add(u64::from(*left));
            let whole = sum.wrapping_sub(u64::from(first));
            let taken = ((whole >> even) as u32).wrapping_mul(inverse);
            *value = signed_add(*value, taken, directions >> bit & 1 != 0);
        }
        PerAxis(position)
    }

    /// Returns a block without steps, for a machine that rests at the position `base`.
    pub(super) const fn rest_at(base: [i32; N]) -> Self {
        Self { base, end: base, ..Self::NOWHERE }
    }

    /// Loads a block that starts at position `base`. [`Course::finish`] completes it.
    #[inline(always)]
    pub(super) fn load(&mut self, steps_by_axis: &[AxisSteps; N], directions: u8, base: [i32; N]) {
        self.entered = 0;
        self.directions = directions;
        self.base = base;
        for (bit, ((end, base), axis_steps)) in self.end.iter_mut().zip(base).zip(steps_by_axis).enumerate() {
            *end = signed_add(base, axis_steps.steps(), directions >> bit & 1 != 0);
        }
        // Makes the compiler finish this loop before the next one: interleaved, the two loops would need more
        // registers than the hardware saves on an interrupt.
        compiler_fence(Ordering::SeqCst);
        let measure = Measure::of(steps_by_axis);
        self.threshold = measure.threshold;
        self.total = measure.total;
        for (rate, axis_steps) in self.rates.iter_mut().zip(steps_by_axis) {
            *rate = measure.rate(*axis_steps);
        }
    }

    /// Completes [`Course::load`]. The stepper calls `load` for the block's message and `finish` for its first segment,
    /// so that neither message takes too long.
    #[inline(always)]
    pub(super) fn finish(&mut self, steps_by_axis: &[AxisSteps; N]) {
        for (beyond, axis_steps) in self.beyond.iter_mut().zip(steps_by_axis) {
            *beyond = parts_beyond(self.total, *axis_steps);
        }
    }

    /// Shifts the start and the end of the block, so that it starts at `position`. Needed if the previous block was
    /// left before its end.
    pub(super) fn begin_from(&mut self, position: [i32; N]) {
        for ((base, end), position) in self.base.iter_mut().zip(self.end.iter_mut()).zip(position) {
            *end = end.wrapping_sub(*base).wrapping_add(position);
            *base = position;
        }
    }

    /// Prepares a block to continue after `entered` units, where other moves interrupted it. Sets `left` to each axis'
    /// countdown to its next step at that point. Shifts the start and the end of the block so that the present
    /// position of the machine is the point after `entered` units.
    #[cold]
    pub(super) fn enter_midst(&mut self, left: &mut [u32; N]) {
        let Course { rates, threshold, entered, directions, .. } = *self;
        let first = self.first();
        let axes = self.base.iter_mut().zip(self.end.iter_mut()).zip(rates.iter().zip(first));
        for (bit, (left, ((base, end), (rate, first)))) in left.iter_mut().zip(axes).enumerate() {
            let (taken, rest) = steps_and_rest(*rate, first, threshold, entered);
            *left = rest;
            for place in [base, end] {
                *place = signed_add(*place, taken, directions >> bit & 1 == 0);
            }
        }
    }

    /// Corrects the position after a stop: subtracts net steps that were counted, but were not output to the motors.
    /// Call only at rest.
    pub(super) fn take_back(&mut self, undone: [i32; N]) {
        for ((base, end), undone) in self.base.iter_mut().zip(self.end.iter_mut()).zip(undone) {
            *base = base.wrapping_sub(undone);
            *end = *base;
        }
    }
}
