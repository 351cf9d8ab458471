//! Look-ahead planner. `Planner` is a ring of blocks. For each block, its reverse pass finds the maximum entry speed
//! from which the machine can stop within the rest of the queue. With a jerk limit, the pass finds anchors (ends of
//! ramps) instead.
//!
//! ```text
//!   v²   ___                 corner limits      |
//!       /   \___      _____                      entry2 of each block: the reverse pass,
//!      /        \    /     \                     v²(entry) = min(corner, v²(exit) + 2·a·length)
//!     /          \__/       \____ 0
//! ```
//! There is no forward pass: the running block accelerates from its actual speed. If it cannot reach a planned entry
//! speed, the machine is simply slower there. So holds, overrides and late blocks never require the queue to be
//! repaired. A new block changes earlier entries only as far as the old end of the queue limited them; the pass stops
//! at the first unchanged entry.
//!
//! The pass is postponed until the planner needs an entry speed that the pass could change. The cap of an entry is the
//! lowest of its corner and nominal speeds. An entry at its cap cannot rise, nor can the entries before it. These
//! entries are settled: they are final, whatever is appended. So in a long queue one pass serves many new blocks.
//!
//! With a jerk limit, the pass plans ramps instead of blocks. A ramp has an acceleration of 0 only at its two ends,
//! and can extend over hundreds of blocks. The reverse pass finds anchors, the entries at which ramps end:
//!
//! ```text
//!        cap of the entries: corner and nominal speeds             speed
//!   ─────o─┐                                        o────────────  o  anchor: planned speed, no acceleration
//!          └─┐                              ┌───────┘              .  entry on the way to an anchor: how far it is,
//!            │ .  .                         │ .                       and the tightest bounds on the way
//!            │       .                     _o
//!            │         '  .           _ '                          Seen backwards, the ramp before an anchor rises
//!            └────────────── o ────o                               by its length formula until it meets the next cap.
//! ```
//! * An entry whose cap exceeds the maximum speed of any ramp to the anchor (v² + 2·a·distance, as without a jerk
//!   limit) does not limit the ramp.
//! * Any other entry lowers the ceiling of the ramp, the maximum speed with which the ramp can begin.
//! * The pass walks back from an anchor. The next anchor is the first entry from which the distance suffices to slow
//!   down from the ceiling.
//!
//! The pass computes only the speeds of anchors. So a ramp can start anywhere within a block, and from any state of
//! motion, without changes to the queue.

use super::block::{Block, OverrideFactors, Ramp};
use super::curvature::Bend;
use super::jerk::{Bounds, PathState, ramp_distance, ramp_speed};
use super::jerk_anchors::{Stretch, Target, Way};
use super::reverse_pass::{Lowered, Walk};
use super::trapezoid::{greater, lesser, square_root};
use crate::lent::Lent;
use core::ops::Range;

/// Predicted speed of a machine that is faster than a lowered override allows. The machine brakes with the acceleration
/// that bends leave. While it brakes, it passes entries of blocks, and the planner allows the predicted speed at these
/// entries. A lower speed there would make the machine brake with all of its acceleration, including the part that
/// bends need.
#[derive(Clone, Copy, Debug)]
struct Fall {
    speed2: f32,
    /// Distance that the machine still travels before it begins to brake, mm.
    delay: f32,
    /// Speed² at which the machine begins to brake.
    top2: f32,
}

impl Fall {
    const NONE: Self = Self { speed2: 0.0, delay: 0.0, top2: 0.0 };

    /// Creates the prediction for a machine in this state of motion, in `block`. With a jerk limit, the machine first
    /// reduces its acceleration to 0 and then builds up the deceleration; `delay` is the distance of both together.
    fn from<const N: usize>(state: PathState, block: &Block<N>) -> Self {
        let (top, ahead) = state.summit(block.jerk);
        let top = greater(top, state.speed);
        let delay = greater(ahead, 0.0) + top * block.acceleration_at(top * top) / block.jerk;
        Self { speed2: top * top, delay, top2: top * top }
    }

    /// Brakes over the distance `way`, mm, in a block. In a bend, more deceleration becomes available as the speed
    /// falls, but with a jerk limit the machine may not build it up as fast. So with a jerk limit, only the
    /// deceleration that the bend leaves at `top2` is used.
    fn over<const N: usize>(&mut self, block: &Block<N>, way: f32, jerk_limited: bool) {
        let braked = greater(way - self.delay, 0.0);
        self.delay = greater(self.delay - way, 0.0);
        if self.speed2 > 0.0 {
            let acceleration = block.acceleration_at(if jerk_limited { self.top2 } else { self.speed2 });
            self.speed2 = greater(self.speed2 - 2.0 * acceleration * braked, 0.0);
        }
    }
}

/// Number of groups into which the slots of the ring are divided. The planner stores a summary of each group's blocks,
/// because for each segment it must check all blocks on which the machine would reduce its acceleration to 0. These can
/// be hundreds of blocks. With 512 blocks, a group has 16. At most two groups (the first and the last) are then checked
/// block by block, the others as a whole.
pub(super) const GROUPS: usize = 32;

/// The ring of blocks. A place counts from the first block (0), a slot is an index of the ring. While the first block
/// is running, its entry speed has no effect.
#[derive(Debug)]
#[cfg_attr(feature = "alloc", derive(Clone))]
#[repr(C)]
pub(super) struct Planner<const N: usize> {
    first: usize,
    len: usize,
    /// `true` if the first block is running, or will be entered at a speed that is already fixed. Such a block must
    /// not change.
    entered: bool,
    /// Place of the first block whose limits have changed since the last reverse pass; `usize::MAX`: none.
    changed: usize,
    /// Place of the last settled entry; 0: none is known. This entry and those before it are final, whatever is
    /// appended. Only without a jerk limit.
    settled: usize,
    /// Blocks whose limits were lowered by bends since the last reverse pass. Recorded only while [`Planner::settle`]
    /// skips that pass, to check whether the settled entries are still final.
    lowered: Lowered,
    /// `true` if any axis has a jerk limit. The planner then finds anchors instead of the entry speed of each block.
    pub jerk_limited: bool,
    /// `true` if the planned speed at some entries exceeds what the overrides allow. That happens if the overrides were
    /// lowered while the machine was faster than they allow now: the machine has to slow down first ([`Fall`]).
    pub raised: bool,
    blocks: Lent<[Block<N>]>,
    /// One summary for each group of neighbouring slots ([`GROUPS`]). It is valid only if all blocks of the group are
    /// in the queue. Only with a jerk limit.
    groups: Lent<[Stretch]>,
}

impl<const N: usize> Planner<N> {
    #[inline(always)]
    pub(super) fn new(blocks: Lent<[Block<N>]>, groups: Lent<[Stretch]>) -> Self {
        Self {
            first: 0,
            len: 0,
            entered: false,
            changed: usize::MAX,
            settled: 0,
            lowered: Lowered::NONE,
            groups,
            jerk_limited: false,
            raised: false,
            blocks,
        }
    }

    #[inline]
    pub(super) fn capacity(&self) -> usize {
        self.blocks.len()
    }

    /// Returns the number of slots in a group of the ring ([`GROUPS`]); the last group may have fewer.
    #[inline]
    fn group(&self) -> usize {
        self.blocks.len().div_ceil(GROUPS)
    }

    #[inline]
    pub(super) fn len(&self) -> usize {
        self.len
    }

    #[inline]
    pub(super) fn free(&self) -> usize {
        self.blocks.len() - self.len
    }

    #[inline]
    fn slot(&self, place: usize) -> usize {
        let index = self.first + place;
        if index >= self.blocks.len() { index - self.blocks.len() } else { index }
    }

    /// Returns the slots of `count` blocks from `place` on as two ranges, because the blocks can continue at the start
    /// of the ring. Each range comes with the place of its first block.
    #[inline]
    fn slots(&self, place: usize, count: usize) -> [(usize, Range<usize>); 2] {
        let slot = self.slot(place);
        let before_wrap = count.min(self.blocks.len() - slot);
        [(place, slot..slot + before_wrap), (place + before_wrap, 0..count - before_wrap)]
    }

    pub(super) fn first(&self) -> Option<&Block<N>> {
        if self.len == 0 { None } else { self.blocks.get(self.first) }
    }

    /// Returns the planned exit speed² of the first block, which is the entry speed² of the second; 0 without a second.
    #[inline]
    pub(super) fn exit2(&self) -> f32 {
        let Some(next) = self.block(1) else { return 0.0 };
        if next.ramp.distance > 0.0 {
            // The entry lies within a ramp to an anchor, so the exit speed must not exceed what this ramp allows. With
            // a jerk limit, the caller uses the exit speed only if the machine can stop within one step. Even then, the
            // machine can be too fast for the next block, if that block moves an axis with a much lower jerk limit.
            let reach = ramp_speed(square_root(next.entry2), next.ramp.distance, next.ramp.bounds());
            return lesser(reach * reach, next.ramp.ceiling2);
        }
        next.entry2
    }

    pub(super) fn clear(&mut self) {
        self.first = 0;
        self.len = 0;
        self.changed = usize::MAX;
        self.settled = 0;
        self.lowered = Lowered::NONE;
        self.entered = false;
    }

    /// Marks the first block as running and returns it.
    #[inline]
    pub(super) fn begin(&mut self) -> Option<&Block<N>> {
        self.entered = self.len > 0;
        self.first()
    }

    /// Removes the first block. `moving`: `true` if the machine enters the next block at speed, `false` if it starts
    /// from rest.
    #[inline]
    pub(super) fn pop(&mut self, moving: bool) {
        if self.len > 0 {
            self.first = self.slot(1);
            self.len -= 1;
            self.settled = self.settled.saturating_sub(1);
            if self.changed != usize::MAX {
                self.changed = self.changed.saturating_sub(1);
                self.lowered.pop();
            }
        }
        self.entered = moving;
    }

    /// Returns whether the first block is running or will be entered at a speed that is already fixed.
    #[inline]
    pub(super) fn is_entered(&self) -> bool {
        self.entered
    }

    pub(super) fn last(&self) -> Option<&Block<N>> {
        self.block(self.len.checked_sub(1)?)
    }

    /// Removes the last block, which must not be running. The caller must append another one.
    pub(super) fn take_back(&mut self) {
        self.len = self.len.saturating_sub(1);
        // If `entry2` is 0, no reverse pass has reached this block yet, so no settled entry depends on it.
        if self.blocks.get(self.slot(self.len)).is_some_and(|block| block.entry2 > 0.0) {
            self.settled = 0;
        }
    }

    /// Appends a block whose `corner2` is set; returns `false` if the ring is full. Call [`Planner::plan`] afterwards.
    pub(super) fn push(&mut self, mut block: Block<N>, overrides: OverrideFactors) -> bool {
        if self.len >= self.blocks.len() {
            return false;
        }
        let previous = match self.len {
            0 => 0.0,
            len => self.blocks.get(self.slot(len - 1)).map_or(0.0, |before| before.nominal(overrides)),
        };
        let nominal = lesser(block.nominal(overrides), previous);
        block.max_entry2 = lesser(block.corner2, nominal * nominal);
        let slot = self.slot(self.len);
        if let Some(place) = self.blocks.get_mut(slot) {
            *place = block;
            self.changed = self.changed.min(self.len);
            self.len += 1;
        }
        true
    }

    /// Lowers the corner speeds of blocks that turn out to lie on a bend, and the acceleration that is left along the
    /// path there. If the machine is already too fast for the bend, it brakes too late. This happens only if the queue
    /// is shorter than the path that shows the bend.
    #[inline(never)]
    pub(super) fn limit(&mut self, bend: &Bend) {
        let newest = self.len.saturating_sub(1);
        if let Some((nearest, farthest)) = bend.once {
            // A slow entry in the range of `once` makes the limit unnecessary. If some blocks of the range have left
            // the queue, it is not known whether one of them was slow, so no limit is set.
            let Some(first) = newest.checked_sub(farthest).filter(|first| *first > 0) else { return };
            let is_slow = |place| self.block(place).is_some_and(|block| block.corner2 <= bend.speed2);
            if (first..=newest - nearest).any(is_slow) {
                return;
            }
        }
        let from = newest.saturating_sub(bend.farthest).max(1);
        let count = self.len.saturating_sub(bend.nearest).saturating_sub(from);
        let mut lowered = Lowered::NONE;
        for (from, slots) in self.slots(from, count) {
            if let Some(blocks) = self.blocks.get_mut(slots) {
                lowered.lower(blocks, from, bend);
            }
        }
        if lowered.first != usize::MAX {
            // `lowered` is needed only if there are settled entries and all changes come after them. Only then does
            // [`Planner::settle`] skip the pass over the changed blocks. With a jerk limit no entry is settled.
            if self.settled < self.changed && self.settled > 0 {
                self.lowered = self.lowered.and(lowered);
            }
            self.changed = self.changed.min(lowered.first);
        }
    }

    /// Checks the settled entries after bends have lowered blocks (places `first` to `end`) since the last pass.
    /// Settled entries are final only as long as no entry after them falls. Recomputes the entry speeds from place
    /// `end` back to the last settled entry, as far as they change. If the last settled entry falls below its cap
    /// (maximum entry speed), or a block has become steep ([`Block::is_steep`]), no entry counts as settled any more.
    #[inline(never)]
    fn lower_settled(&mut self, first: usize, end: usize) {
        let mut exit2 = self.block(end).map_or(0.0, |next| next.entry2);
        for (from, slots) in self.slots(self.settled, end.saturating_sub(self.settled)).into_iter().rev() {
            let Some(blocks) = self.blocks.get_mut(slots) else { return };
            let mut place = from + blocks.len();
            for block in blocks.iter_mut().rev() {
                place -= 1;
                let reach2 = block.braking_entry2(exit2);
                if block.is_steep() || (place == self.settled && !block.is_surely_capped(reach2)) {
                    self.settled = 0;
                    self.changed = self.changed.min(place);
                    return;
                }
                exit2 = lesser(block.max_entry2, reach2);
                // Stop at an unchanged entry, but only before place `first`. From `first` to `end` limits were
                // lowered, so an entry before an unchanged one can still change there.
                if place < first && block.entry2 == exit2 {
                    return;
                }
                block.entry2 = exit2;
            }
        }
    }

    /// Plans the blocks that were appended or limited since the last pass: immediately with a jerk limit, otherwise
    /// when [`Planner::settle`] needs the result.
    pub(super) fn plan(&mut self) {
        if self.jerk_limited {
            let changed = self.reverse_pass_to_anchors();
            self.sum_up(changed);
            self.changed = usize::MAX;
        }
    }

    /// Updates the exit speed of the first block after blocks were appended or limited. Runs the postponed reverse
    /// pass, unless settled entries make it unnecessary. Only without a jerk limit.
    #[inline]
    pub(super) fn settle(&mut self) {
        if self.changed == usize::MAX {
            return;
        }
        let Lowered { first, planned_end } = self.lowered;
        if first != usize::MAX {
            self.lowered = Lowered::NONE;
            if self.settled < self.changed && self.settled > 0 {
                self.lower_settled(first, planned_end);
            }
        }
        if self.settled == 0 || self.changed <= self.settled {
            self.reverse_pass();
            self.changed = usize::MAX;
        }
    }

    /// Applies new feed and rapid overrides to all blocks. `state`: the machine's speed and acceleration in the first
    /// block; `left`: distance from there to the end of this block, mm.
    pub(super) fn replan(&mut self, overrides: OverrideFactors, state: PathState, left: f32) {
        let mut fall = self.first().map_or(Fall::NONE, |first| Fall::from(state, first));
        let mut previous = f32::INFINITY;
        self.raised = false;
        for place in 0..self.len {
            let slot = self.slot(place);
            let Some(block) = self.blocks.get_mut(slot) else { return };
            let nominal = block.nominal(overrides);
            let least = lesser(nominal, previous);
            let fallen2 = lesser(fall.speed2, block.max_entry2);
            block.max_entry2 = lesser(block.corner2, greater(least * least, fallen2));
            previous = nominal;
            if place > 0 {
                self.raised |= block.max_entry2 > least * least;
                fall.speed2 = lesser(fall.speed2, block.max_entry2);
            }
            fall.over(block, if place > 0 { block.length } else { left }, self.jerk_limited);
            if fall.speed2 <= nominal * nominal {
                fall.speed2 = 0.0;
            }
        }
        self.changed = 0;
        self.plan();
    }

    /// The reverse pass. Walks from the end of the queue towards the running block: over all blocks that have changed,
    /// and further while entry speeds change. Finds the last settled entry.
    #[inline(never)]
    fn reverse_pass(&mut self) {
        let wrapped = (self.first + self.len).saturating_sub(self.blocks.len());
        let upper = self.len - wrapped;
        let Some((low, high)) = self.blocks.split_at_mut_checked(self.first) else { return };
        // The first block is excluded, because it can be running.
        let (Some(low), Some(high)) = (low.get_mut(..wrapped), high.get_mut(1..upper)) else { return };
        let mut walk = Walk { exit2: 0.0, searching: true, settled: 0 };
        if walk.back(low, upper, self.changed) {
            walk.back(high, 1, self.changed);
        }
        self.settled = walk.settled;
    }

    /// The reverse pass with a jerk limit. Walks back as far as anchors change, and finds the anchors. For each entry
    /// between two anchors, sets the ramp to the next anchor. Returns the lowest place that the pass reached.
    #[inline(never)]
    fn reverse_pass_to_anchors(&mut self) -> usize {
        let mut way = Way::to(0.0);
        let mut place = self.len;
        while place > 1 {
            place -= 1;
            let slot = self.slot(place);
            self.end_at_border(place, &mut way);
            let Some(block) = self.blocks.get(slot) else { break };
            let own = block.bounds().rounded_down();
            let (length, cap2) = (block.length, block.max_entry2);
            way.distance += length;
            way.bounds = way.bounds.and(own);
            let reach2 = way.speed * way.speed + 2.0 * way.bounds.acceleration * way.distance;
            if lesser(cap2, way.ceiling2) < reach2 {
                way.ceiling2 = lesser(cap2, way.ceiling2);
                let ceiling = square_root(way.ceiling2);
                if ramp_distance(ceiling, way.speed, way.bounds) <= way.distance {
                    way = Way::to(ceiling);
                }
            }
            let Some(block) = self.blocks.get_mut(slot) else { break };
            let entry2 = way.speed * way.speed;
            if way.distance > 0.0 {
                block.ramp = Ramp::new(way.distance, way.ceiling2, way.bounds);
            } else if place < self.changed && block.entry2 == entry2 && block.ramp == Ramp::ANCHOR {
                break;
            } else {
                block.ramp = Ramp::ANCHOR;
            }
            block.entry2 = entry2;
        }
        // An additional anchor at the end of the running block can shorten the ramp, too.
        self.end_at_border(place.saturating_sub(1), &mut way);
        place
    }

    /// Makes the end of the block at `place` an anchor if this shortens the ramp. Checks it only if the block's bounds
    /// differ from `way.bounds`, the tightest bounds on the way to the next anchor.
    #[inline]
    fn end_at_border(&mut self, place: usize, way: &mut Way) {
        let Some(block) = self.block(place) else { return };
        let own = block.bounds().rounded_down();
        if way.distance > 0.0
            && way.differs(own)
            && let Some(speed) = way.better_anchor(own, block.max_entry2)
        {
            *way = Way::to(speed);
            let slot = self.slot(place + 1);
            if let Some(next) = self.blocks.get_mut(slot) {
                (next.entry2, next.ramp) = (speed * speed, Ramp::ANCHOR);
            }
        }
    }

    /// Updates the summary of each group of slots that has blocks at place `from` or later.
    fn sum_up(&mut self, from: usize) {
        let group_len = self.group();
        let within = self.slot(from) % group_len;
        let mut place = from;
        if let Some(start) = from.checked_sub(within) {
            place = start;
        } else {
            // The first blocks of this group have left the queue, so its summary is not used any more. Skip the group.
            place += self.group_size(self.slot(from) - within) - within;
        }
        while place < self.len {
            let slot = self.slot(place);
            let size = self.group_size(slot);
            let (Some(blocks), Some(group)) =
                (self.blocks.get(slot..slot + size), self.groups.get_mut(slot / group_len))
            else {
                return;
            };
            if place + size > self.len {
                return;
            }
            *group = blocks.iter().fold(Stretch::NONE, Stretch::and);
            place += size;
        }
    }

    /// Returns the number of slots in the group of the ring that begins at a slot.
    #[inline]
    fn group_size(&self, slot: usize) -> usize {
        self.group().min(self.blocks.len() - slot)
    }

    /// Returns a summary of the blocks from a place on, and the number of these blocks. The summary covers a whole
    /// group of the ring if the group begins at the place and is shorter than `distance`, mm. Otherwise it covers one
    /// block.
    #[inline]
    fn stretch(&self, place: usize, distance: f32) -> Option<(Stretch, usize)> {
        let slot = self.slot(place);
        let size = self.group_size(slot);
        if slot.is_multiple_of(self.group())
            && size > 1
            && place + size <= self.len
            && let Some(group) = self.groups.get(slot / self.group())
            && group.length < distance
        {
            return Some((*group, size));
        }
        self.block(place).map(|block| (Stretch::NONE.and(block), 1))
    }

    #[inline]
    pub(super) fn block(&self, place: usize) -> Option<&Block<N>> {
        if place < self.len { self.blocks.get(self.slot(place)) } else { None }
    }

    /// Checks whether a machine is allowed to be in this state, `left` mm before the end of the first block. First
    /// condition: the machine can reduce its acceleration to 0, or continue to brake, and still meet all later
    /// anchors. Second condition: its speed is at most `nominal` (mm/s) when its acceleration is 0.
    ///
    /// If the two conditions are fulfilled, returns the lowest acceleration bound, mm/s², over the distance in which
    /// the machine reduces its acceleration to 0. Otherwise returns `None`.
    pub(super) fn allows(&self, state: PathState, left: f32, nominal: f32) -> Option<f32> {
        let first = self.first()?;
        if state.acceleration < 0.0 {
            let target = self.target(0, left, first.bounds());
            let (valley, _) = state.valley(first.jerk);
            return (valley <= nominal && target.is_met(state)).then_some(first.acceleration);
        }
        let Bounds { mut acceleration, mut jerk } = first.bounds();
        let mut own = first.bounds();
        let (mut summit, mut ahead) = state.summit(jerk);
        if summit > nominal {
            return None;
        }
        let mut place = 0;
        let mut end = left;
        while ahead > end {
            let (stretch, blocks) = self.stretch(place + 1, ahead - end)?;
            place += blocks;
            own = stretch.bounds;
            acceleration = lesser(acceleration, own.acceleration);
            if own.jerk < jerk {
                jerk = own.jerk;
                (summit, ahead) = state.summit(jerk);
            }
            if summit * summit > stretch.slowest2 {
                return None;
            }
            end += stretch.length;
        }
        let stands = PathState { speed: summit, acceleration: 0.0 };
        self.target(place, end - ahead, own).is_met(stands).then_some(acceleration)
    }

    /// Returns the next anchor for a ramp that begins `left` mm before the end of the block at a place. `own`: bounds
    /// up to the end of that block.
    #[inline]
    pub(super) fn target(&self, place: usize, left: f32, own: Bounds) -> Target {
        let Some(next) = self.block(place + 1) else {
            return Target { speed: 0.0, distance: left, ceiling: f32::INFINITY, bounds: own };
        };
        Target {
            speed: square_root(next.entry2),
            distance: left + next.ramp.distance,
            ceiling: square_root(next.ramp.ceiling2),
            bounds: next.ramp.bounds().and(own),
        }
    }

    /// Returns the tightest bounds of the blocks within `distance`, mm. `left`: how much of this distance is in the
    /// first block, mm. `speed2`: maximum speed² of the machine within the distance.
    pub(super) fn bounds_within(&self, distance: f32, left: f32, speed2: f32) -> Bounds {
        let Some(first) = self.first() else { return Bounds::NONE };
        let (mut straight_acceleration, mut curve, mut jerk) = (first.acceleration, first.curve, first.jerk);
        let (mut place, mut end) = (0, left);
        while distance > end {
            let Some((stretch, blocks)) = self.stretch(place + 1, distance - end) else { break };
            place += blocks;
            straight_acceleration = lesser(straight_acceleration, stretch.straight_acceleration);
            curve = curve.and(stretch.curve);
            jerk = lesser(jerk, stretch.bounds.jerk);
            end += stretch.length;
        }
        Bounds { acceleration: curve.left(straight_acceleration, speed2), jerk }
    }
}

#[cfg(test)]
impl<const N: usize> Planner<N> {
    /// Asserts that the exit of the first block and all settled entries equal the result of one pass over all blocks.
    /// With a jerk limit: that all entries equal a complete new plan, and that the group summaries match the blocks.
    pub(super) fn assert_consistent(&self) {
        let mut copy = self.clone();
        if self.jerk_limited {
            copy.changed = 0;
            copy.plan();
            self.assert_anchors(&copy);
            return;
        }
        copy.settle();
        let mut entry2 = 0.0;
        for place in (1..copy.len).rev() {
            let block = copy.block(place).unwrap();
            entry2 = block.entry_before(entry2);
            if place == 1 || place <= copy.settled {
                assert_eq!(block.entry2.to_bits(), entry2.to_bits(), "entry {place} of {}", copy.len);
            }
        }
    }

    fn assert_anchors(&self, fresh: &Planner<N>) {
        let own = self;
        for place in 1..own.len {
            let (block, other) = (own.block(place).unwrap(), fresh.block(place).unwrap());
            assert_eq!((block.entry2, block.ramp), (other.entry2, other.ramp), "entry {place} of {}", own.len);
            let (stretch, blocks) = own.stretch(place, f32::INFINITY).unwrap();
            let single = (place..place + blocks).map(|at| own.block(at).unwrap());
            assert_eq!(stretch, single.fold(Stretch::NONE, Stretch::and), "{blocks} blocks at {place}");
        }
    }
}
