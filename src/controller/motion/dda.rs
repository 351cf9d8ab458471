//! The DDA (digital differential analyser, here Bresenham's algorithm) of the step generator: which axes step at a
//! tick. `step_axes` computes one tick, `steps_into` many ticks in a row.
//!
//! Each axis has a countdown to its next step. A tick reduces the countdown by the axis' rate times the units that the
//! tick advances. (A unit is 1/16 step of the dominant axis, the one with the most steps.) If the countdown becomes
//! negative, the axis steps, and the threshold, which is the same for all axes, is added to the countdown.
//!
//! On a line, an axis' rate is its number of steps, and all countdowns begin with half the threshold. So each axis
//! stays within half a step of the straight line, and each countdown also ends with half the threshold:
//!
//! ```text
//!  steps of Y for (X, Y) = (10, 3), threshold 10, in steps of X             1 2 3 4 5 6 7 8 9 10
//!                                                                       Y     ^       ^     ^
//! ```
//! `measure` defines the rate and threshold of a block, even for a chord that begins between two steps.

use core::sync::atomic::{Ordering, compiler_fence};

/// Maximum number of axes that [`steps_into`] can step.
const MOST_AXES: usize = 4;

/// Executes one tick: reduces each axis' countdown `left` by its increment. Returns the axes that step as a mask, bit
/// 0 for X.
#[inline(always)]
pub(super) fn step_axes<const N: usize>(left: &mut [u32; N], increments: &[u32; N], threshold: u32) -> u8 {
    let mut minus_steps = 0_i32;
    let threshold = threshold as i32;
    // Begins with the last axis. Each pass of the loop shifts the bits of the axes handled before up by one, so the
    // first axis ends in bit 0.
    for (left, increment) in left.iter_mut().zip(increments).rev() {
        // `left` and `increment` are between 0 and the threshold (at most 2^30), or a few parts of a step outside this
        // range. So the sign of `rest` shows whether the axis steps. `stepping` has all bits set if the axis steps,
        // otherwise none; this mask avoids a branch.
        //
        // No axis steps twice in a tick. A tick advances the dominant axis by at most one step, and begins at a
        // multiple of its own size in units. Another axis can have as many steps as the dominant one, with its exact
        // start and end between two steps. Even that axis makes at most one step in a tick. An axis with fewer steps
        // travels less.
        let rest = left.wrapping_sub(*increment) as i32;
        let stepping = rest >> 31;
        *left = rest.wrapping_add(threshold & stepping) as u32;
        minus_steps = minus_steps.wrapping_mul(2).wrapping_add(stepping);
        // Makes the compiler finish one axis before the next: interleaved, the axes would need more registers than the
        // hardware saves on an interrupt.
        compiler_fence(Ordering::SeqCst);
    }
    minus_steps.wrapping_neg() as u8
}

/// Returns whether any axis steps at the next tick.
#[inline(always)]
pub(super) fn steps_next<const N: usize>(left: &[u32; N], increments: &[u32; N]) -> bool {
    // The sign of the difference shows whether the axis steps, as in `step_axes`.
    left.iter().zip(increments).any(|(left, increment)| (left.wrapping_sub(*increment) as i32) < 0)
}

/// Executes one tick per element of `words`. Sets the element to the entry of `table` that belongs to the axes that
/// step. Two kinds of axes need no countdown: those that step at each tick (the dominant axis, if a tick is a whole
/// step) and those that never step. The loop counts down only the other axes.
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
    // Inserts each axis at the front of the array, the last axis first. No index is computed, so the array stays in
    // registers.
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
        // A separate loop for one counting axis would save little. With one axis, the second countdown is `NONE`, which
        // subtracts nothing.
        1 | 2 => count_down::<_, 2, 4, _>(left, [a, b], always, threshold, table, words),
        4 if N > 3 => count_down::<_, 4, 16, _>(left, [a, b, c, d], always, threshold, table, words),
        _ => count_down::<_, 3, 8, _>(left, [a, b, c], always, threshold, table, words),
    }
}

/// The countdown of one axis to its next step: each tick reduces `left` by `increment`.
#[derive(Clone, Copy)]
struct Countdown {
    axis: usize,
    left: u32,
    increment: u32,
}

impl Countdown {
    /// An unused countdown, which never steps.
    const NONE: Self = Self { axis: MOST_AXES, left: 0, increment: 0 };
}

/// Executes one tick per element of `words`: counts down `K` axes. Sets the element to the entry of `table` that
/// belongs to the axes that step. The axes in the mask `always` step at each tick.
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
    // One word for each combination of axes that step: bit k of the index stands for the axis with number k in `axes`.
    // Each word also includes the axes in `always`.
    let of_steps: [u32; OF_THEM] = core::array::from_fn(|steps| {
        let all = axes.iter().enumerate().filter(|(bit, _)| steps >> bit & 1 != 0);
        let stepping = all.fold(always, |stepping, (_, of)| stepping | 1 << of.axis);
        table.get(stepping % WORDS).copied().unwrap_or(0)
    });
    for word in words {
        let mut steps = 0_usize;
        for (bit, of) in axes.iter_mut().enumerate() {
            // As in `step_axes`: the sign shows whether the axis steps.
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
