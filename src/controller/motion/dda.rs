//! The DDA (Bresenham's algorithm) of the step generator: which axes step at a tick. Each axis counts down what is left
//! until its next step by its increment, and gets the threshold added when it is stepping: `step_axes` for one tick,
//! `steps_into` for many ticks in a row, as words out of a table; axes that step always or never need no countdown.
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
//!
//! Names: In it are `steps_next`, `count_down`, `MOST_AXES`, and the table `of_steps` of `WORDS` words.

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
    let mut counting = [(0_usize, 0_u32, 0_u32); MOST_AXES];
    let mut count = 0_usize;
    for (axis, (left, increment)) in left.iter().zip(increments).enumerate() {
        if *increment == threshold {
            always |= 1 << axis;
        } else if *increment != 0
            && let Some(slot) = counting.get_mut(count)
        {
            *slot = (axis, *left, *increment);
            count += 1;
        }
    }
    // Of the steps of the counting axes, one bit each in their order: the word with all axes.
    let of_counting: [u32; WORDS] = core::array::from_fn(|steps| {
        let all = counting.iter().enumerate().take(count);
        let axes = all.fold(always, |axes, (bit, (axis, ..))| axes | (steps >> bit & 1) << axis);
        table.get(axes % WORDS).copied().unwrap_or(0)
    });
    let [a, b, c, d] = counting.map(|(_, left, increment)| (left, increment));
    let counted = match count {
        0 => {
            words.fill(table.get(always % WORDS).copied().unwrap_or(0));
            return;
        }
        // For one counting axis a loop of its own would save little: the other one takes nothing off.
        1 | 2 => count_down([a, b], threshold, &of_counting, words),
        4 if N > 3 => count_down([a, b, c, d], threshold, &of_counting, words),
        _ => count_down([a, b, c], threshold, &of_counting, words),
    };
    for ((axis, ..), new) in counting.iter().zip(counted).take(count) {
        if let Some(left) = left.get_mut(*axis) {
            *left = new;
        }
    }
}

/// The countdown of `K` axes, each with what is left until its next step and with its increment, over as many ticks as there
/// are words: for each the word of the axes that step. What is left of each axis after them.
#[inline(always)]
fn count_down<const K: usize, const WORDS: usize>(
    axes: [(u32, u32); K],
    threshold: u32,
    of_steps: &[u32; WORDS],
    words: &mut [u32],
) -> [u32; MOST_AXES] {
    let mut axes = axes;
    for word in words {
        let mut steps = 0_usize;
        for (bit, (left, increment)) in axes.iter_mut().enumerate() {
            // As in `step_axes`: the sign says whether the axis steps.
            *left = left.wrapping_sub(*increment);
            if (*left as i32) < 0 {
                *left = left.wrapping_add(threshold);
                steps |= 1 << bit;
            }
        }
        *word = of_steps.get(steps % WORDS).copied().unwrap_or(0);
    }
    let mut left = [0; MOST_AXES];
    for (slot, (new, _)) in left.iter_mut().zip(axes) {
        *slot = new;
    }
    left
}
