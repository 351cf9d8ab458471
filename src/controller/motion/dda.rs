//! The DDA of the step generator (Bresenham's algorithm): which axes step at a tick. `step_axes` computes one tick,
//! `steps_into` many ticks in a row.
//!
//! One threshold serves all axes. A tick takes each axis' own rate (times the units the tick advances) off what is left
//! until its next step; an axis with less than that left steps and gets the threshold added. On a line the rate is the axis'
//! steps, and all begin with half the threshold, so each stays within half a step of the straight line, and after the whole
//! block all have half of it again:
//!
//! ```text
//!  what is left of Y for (X, Y) = (10, 3), threshold 10, in steps of X      1 2 3 4 5 6 7 8 9 10
//!                                                                       Y     ^       ^     ^
//! ```
//! Rate and threshold of a block, and those of a chord that begins between steps, are those of `measure`.

use core::sync::atomic::{Ordering, compiler_fence};

/// Axes of a step task at most.
const MOST_AXES: usize = 4;

/// One tick: each axis counts down to its next step by its increment. The axes that step, bit 0 for X.
#[inline(always)]
pub(super) fn step_axes<const N: usize>(left: &mut [u32; N], increments: &[u32; N], threshold: u32) -> u8 {
    let mut minus_steps = 0_i32;
    let threshold = threshold as i32;
    // The last axis first: each doubles the bits of those before it.
    for (left, increment) in left.iter_mut().zip(increments).rev() {
        // Both are at most the threshold, which is at most 2^30, and some parts of a step more, or are as little below 0.
        // So the sign says whether the axis steps, and without a branch: all bits of `stepping` are those of a sign. No
        // axis steps twice in a tick, which advances a step of the dominant axis at most, and begins at a multiple of
        // what it advances: with as many steps it makes one in each of these, wherever its ends are, and with less its
        // true way is shorter, too.
        let rest = left.wrapping_sub(*increment) as i32;
        let stepping = rest >> 31;
        *left = rest.wrapping_add(threshold & stepping) as u32;
        minus_steps = minus_steps.wrapping_mul(2).wrapping_add(stepping);
        // One axis after the other: all at once they need more registers than an interrupt gets for nothing.
        compiler_fence(Ordering::SeqCst);
    }
    minus_steps.wrapping_neg() as u8
}

/// Whether an axis steps at the next tick.
#[inline(always)]
pub(super) fn steps_next<const N: usize>(left: &[u32; N], increments: &[u32; N]) -> bool {
    // As in `step_axes`.
    left.iter().zip(increments).any(|(left, increment)| (left.wrapping_sub(*increment) as i32) < 0)
}

/// As many ticks in a row as there are words: for each the word of the axes that step. An axis that steps at each of them (the
/// dominant one, when a tick is a whole step) needs no countdown, one that never steps neither: the loop counts for as many axes
/// as are left.
#[inline(always)]
pub(super) fn steps_into<const N: usize, const WORDS: usize>(
    left: &mut [u32; N],
    increments: &[u32; N],
    threshold: u32,
    table: &[u32; WORDS],
    words: &mut [u32],
) {
    const { assert!(N <= MOST_AXES && WORDS == 1 << N, "a word for each combination of axes") };
    let mut always = 0_usize;
    // Shifted in, the last axis first, and not written to a place that is counted: so they stay in registers.
    let mut counting = [Countdown::NONE; MOST_AXES];
    let mut count = 0_usize;
    for (axis, (left, increment)) in left.iter().zip(increments).enumerate().rev() {
        if *increment == threshold {
            always |= 1 << axis;
        } else if *increment != 0 {
            let [a, b, c, _] = counting;
            counting = [Countdown { axis, left: *left, increment: *increment }, a, b, c];
            count += 1;
        }
    }
    let [a, b, c, d] = counting;
    match count {
        0 => words.fill(table.get(always % WORDS).copied().unwrap_or(0)),
        // For one counting axis a loop of its own would save little: the other one takes nothing off.
        1 | 2 => count_down::<_, 2, 4, _>(left, [a, b], always, threshold, table, words),
        4 if N > 3 => count_down::<_, 4, 16, _>(left, [a, b, c, d], always, threshold, table, words),
        _ => count_down::<_, 3, 8, _>(left, [a, b, c], always, threshold, table, words),
    }
}

/// An axis that counts down to its next step: what is left until then, and its increment.
#[derive(Clone, Copy)]
struct Countdown {
    axis: usize,
    left: u32,
    increment: u32,
}

impl Countdown {
    /// No axis.
    const NONE: Self = Self { axis: MOST_AXES, left: 0, increment: 0 };
}

/// The countdown of `K` axes over as many ticks as there are words: for each the word of the axes that step, those that
/// `always` do among them.
#[inline(always)]
fn count_down<const N: usize, const K: usize, const OF_THEM: usize, const WORDS: usize>(
    left: &mut [u32; N],
    mut axes: [Countdown; K],
    always: usize,
    threshold: u32,
    table: &[u32; WORDS],
    words: &mut [u32],
) {
    const { assert!(OF_THEM == 1 << K, "a word for each combination of them") };
    // Of their steps, one bit each in their order: the word with all axes.
    let of_steps: [u32; OF_THEM] = core::array::from_fn(|steps| {
        let all = axes.iter().enumerate().filter(|(bit, _)| steps >> bit & 1 != 0);
        let stepping = all.fold(always, |stepping, (_, of)| stepping | 1 << of.axis);
        table.get(stepping % WORDS).copied().unwrap_or(0)
    });
    for word in words {
        let mut steps = 0_usize;
        for (bit, of) in axes.iter_mut().enumerate() {
            // As in `step_axes`: the sign says whether the axis steps.
            of.left = of.left.wrapping_sub(of.increment);
            if (of.left as i32) < 0 {
                of.left = of.left.wrapping_add(threshold);
                steps |= 1 << bit;
            }
        }
        *word = of_steps.get(steps % OF_THEM).copied().unwrap_or(0);
    }
    for of in axes {
        if let Some(left) = left.get_mut(of.axis) {
            *left = of.left;
        }
    }
}
