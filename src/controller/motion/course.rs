//! The block that the step generator is running: rates, threshold and length in units, and where each axis began
//! between two steps. Also keeps a copy for the position at which a probe touched.
//!
//! No position is counted: it follows from the units that the block has advanced and from what is left until each axis' next step,
//! exactly, so that a tick costs nothing for it. The arithmetic is that of `measure`.

use super::measure::{Measure, advance, inverse, parts_beyond, signed_add, steps_and_rest};
use crate::axes::PerAxis;
use crate::messages::AxisSteps;
use core::sync::atomic::{Ordering, compiler_fence};

/// A block, ready to run.
#[derive(Clone, Copy, Debug)]
#[repr(C)]
pub(super) struct Course<const N: usize> {
    /// How far the true start of each axis is beyond the rounded one, in parts of the threshold.
    pub(super) beyond: [u32; N],
    /// What a unit takes off.
    pub(super) rates: [u32; N],
    pub(super) threshold: u32,
    /// Units of the whole block.
    pub(super) total: u32,
    /// Units at which it is entered; 0 = at its start.
    pub(super) entered: u32,
    pub(super) directions: u8,
    /// Position at the start of the block and at its end.
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

    /// What is left until the next step of each axis at the start: half a step but for what is done of it.
    #[inline(always)]
    fn first(&self) -> [u32; N] {
        self.beyond.map(|beyond| (self.threshold / 2).wrapping_sub(beyond))
    }

    /// Net steps. Steps taken × threshold = rate × units + left - what was left first, to the last bit; so the quotient
    /// needs no division: below 2^32 it is the product with the inverse of the threshold's odd part.
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

    /// At rest at a position.
    pub(super) const fn rest_at(base: [i32; N]) -> Self {
        Self { base, end: base, ..Self::NOWHERE }
    }

    /// Makes it the block of these axes, from this position. [`Course::finish`] does the rest.
    #[inline(always)]
    pub(super) fn load(&mut self, steps_by_axis: &[AxisSteps; N], directions: u8, base: [i32; N]) {
        self.entered = 0;
        self.directions = directions;
        self.base = base;
        for (bit, ((end, base), axis_steps)) in self.end.iter_mut().zip(base).zip(steps_by_axis).enumerate() {
            *end = signed_add(base, axis_steps.steps(), directions >> bit & 1 != 0);
        }
        // One after the other, as in `dda::step_axes`.
        compiler_fence(Ordering::SeqCst);
        let measure = Measure::of(steps_by_axis);
        self.threshold = measure.threshold;
        self.total = measure.total;
        for (rate, axis_steps) in self.rates.iter_mut().zip(steps_by_axis) {
            *rate = measure.rate(*axis_steps);
        }
    }

    /// What is left of [`Course::load`], so that no message takes too long.
    #[inline(always)]
    pub(super) fn finish(&mut self, steps_by_axis: &[AxisSteps; N]) {
        for (beyond, axis_steps) in self.beyond.iter_mut().zip(steps_by_axis) {
            *beyond = parts_beyond(self.total, *axis_steps);
        }
    }

    /// Begins at this position instead: the block before was left before its end.
    pub(super) fn begin_from(&mut self, position: [i32; N]) {
        for ((base, end), position) in self.base.iter_mut().zip(self.end.iter_mut()).zip(position) {
            *end = end.wrapping_sub(*base).wrapping_add(position);
            *base = position;
        }
    }

    /// Brings all axes to where they were when the block was left at the units at which it is entered.
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

    /// At rest: these net steps have not come out, so the position is that without them.
    pub(super) fn take_back(&mut self, undone: [i32; N]) {
        for ((base, end), undone) in self.base.iter_mut().zip(self.end.iter_mut()).zip(undone) {
            *base = base.wrapping_sub(undone);
            *end = *base;
        }
    }
}

/// All that a position follows from, so that no tick has to count and a probe's tick not to compute.
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
