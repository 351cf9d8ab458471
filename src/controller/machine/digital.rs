//! Digital outputs of programs (M62 to M65). Changes that wait for the next motion are kept in groups, and each group
//! acts when a block with its mark begins.
//!
//! A group collects the changes that were requested between two motions. Each block of motion carries a mark: the count
//! of groups that come before it. When a block begins, the groups up to its mark are due.
//!
//! Example: in `M62 P0`, `M62 P1`, `G1 X1`, `M63 P0`, `G1 X2`, the first two changes form group 1 and the third is
//! group 2. The block to X1 has mark 1, so P0 and P1 switch on when it begins. The block to X2 has mark 2, so P0
//! switches off when it begins.

/// Maximum number of groups. A group is the changes that wait for the same motion. If all groups are in use, a line
/// that needs another one waits until a motion begins and its group becomes free.
const GROUPS: usize = 8;
/// Number of bits of a mark, the number that ties a group of changes to a block of motion. Marks wrap at 32. Their
/// range must be more than twice `GROUPS`, so that the mark of an earlier block is never taken for that of a later one.
const MARK_BITS: u32 = 5;
const MARKS: u8 = (1 << MARK_BITS) - 1;

/// Changes of outputs that are made together, when the same motion begins.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
struct DueTogether {
    /// Outputs that change.
    mask: u8,
    /// Outputs of `mask` that switch on. The other outputs of `mask` switch off.
    on: u8,
}

/// The digital outputs of programs, and the changes that wait for a motion.
#[derive(Clone, Copy, Debug)]
pub struct DigitalOutputs {
    levels: u8,
    /// Mark of the last group whose changes have been made or dropped.
    done: u8,
    /// Groups of changes that wait for a motion, in the order of the motions. The first `count` are in use.
    waiting: [DueTogether; GROUPS],
    count: u8,
    /// Whether the last group can still grow, because no motion has been queued since it was started.
    open: bool,
}

impl DigitalOutputs {
    /// All outputs off.
    pub const OFF: Self =
        Self { levels: 0, done: 0, waiting: [DueTogether { mask: 0, on: 0 }; GROUPS], count: 0, open: false };

    /// Returns the levels of the outputs, bit 0 for P0.
    pub fn levels(&self) -> u8 {
        self.levels
    }

    /// Returns whether a change waits for a motion.
    pub fn is_waiting(&self) -> bool {
        self.count > 0
    }

    /// Changes an output now.
    pub fn set(&mut self, number: u32, on: bool) {
        self.apply(DueTogether::of(number, on));
    }

    /// Returns whether another change can be kept until the next motion. `idle`: no motion is queued.
    pub fn has_room(&self, idle: bool) -> bool {
        self.open || idle || usize::from(self.count) < GROUPS
    }

    /// Changes an output when the next motion begins. Returns the mark that the blocks queued after this call must
    /// carry. When the first of them begins, the change is made. `idle`: no motion is queued.
    pub fn set_with_motion(&mut self, number: u32, on: bool, idle: bool) -> u8 {
        let change = DueTogether::of(number, on);
        // If no motion is queued, all groups wait for the next motion. So the change can be added to the last group.
        let joins = self.count > 0 && (self.open || idle);
        if !joins && usize::from(self.count) < GROUPS {
            self.count += 1;
            if let Some(group) = self.last() {
                *group = DueTogether::default();
            }
        }
        if let Some(group) = self.last() {
            group.mask |= change.mask;
            group.on = group.on & !change.mask | change.on;
        }
        self.open = true;
        self.newest()
    }

    fn last(&mut self) -> Option<&mut DueTogether> {
        self.waiting.get_mut(usize::from(self.count).checked_sub(1)?)
    }

    fn newest(&self) -> u8 {
        (self.done + self.count) & MARKS
    }

    /// Closes the last group when a motion has been queued: a later change waits for the next motion, so it starts a
    /// new group.
    pub fn motion_follows(&mut self) {
        self.open = false;
    }

    /// Makes the changes that wait for this block or an earlier one. Call it when a block with this `mark` has begun.
    pub fn begun(&mut self, mark: u8) {
        let due = mark.wrapping_sub(self.done) & MARKS;
        if due > self.count {
            return;
        }
        for _ in 0..due {
            self.apply(self.waiting[0]);
            self.waiting.rotate_left(1);
        }
        self.count -= due;
        self.done = mark & MARKS;
        self.open &= self.count > 0;
    }

    fn apply(&mut self, group: DueTogether) {
        self.levels = self.levels & !group.mask | group.on;
    }

    /// Makes the changes whose motion has begun and drops the others, because the queued motion was dropped. `mark`:
    /// the mark of the block that began last. Blocks queued after this call carry the same mark until the next change.
    pub fn forget_waiting(&mut self, mark: u8) {
        self.begun(mark);
        self.count = 0;
        self.open = false;
        self.done = mark & MARKS;
    }

    /// Drops the waiting changes as [`DigitalOutputs::forget_waiting`] does, and switches all outputs off.
    pub fn switch_off(&mut self, mark: u8) {
        self.forget_waiting(mark);
        self.levels = 0;
    }
}

impl DueTogether {
    fn of(number: u32, on: bool) -> DueTogether {
        let mask = 1u8.checked_shl(number).unwrap_or(0);
        DueTogether { mask, on: if on { mask } else { 0 } }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_change_waits_for_its_motion() {
        let mut outputs = DigitalOutputs::OFF;
        let first = outputs.set_with_motion(1, true, true);
        assert_eq!(outputs.set_with_motion(0, true, false), first, "the same motion");
        outputs.motion_follows();
        let second = outputs.set_with_motion(1, false, false);
        assert_eq!((outputs.levels(), second), (0, first + 1));
        outputs.begun(0);
        assert_eq!(outputs.levels(), 0);
        outputs.begun(first);
        assert_eq!(outputs.levels(), 0b11);
        outputs.set(2, true);
        outputs.begun(second);
        assert_eq!((outputs.levels(), outputs.is_waiting()), (0b101, false));
        outputs.begun(second);
        assert_eq!(outputs.levels(), 0b101);
    }

    #[test]
    fn a_motion_that_was_not_seen_is_made_good() {
        let mut outputs = DigitalOutputs::OFF;
        outputs.set_with_motion(0, true, true);
        outputs.motion_follows();
        let last = outputs.set_with_motion(0, false, false);
        outputs.begun(last);
        assert_eq!((outputs.levels(), outputs.is_waiting()), (0, false));
    }

    #[test]
    fn there_is_room_as_long_as_motion_can_make_some() {
        let mut outputs = DigitalOutputs::OFF;
        for _ in 0..GROUPS {
            assert!(outputs.has_room(false));
            outputs.set_with_motion(0, true, false);
            outputs.motion_follows();
        }
        assert!(!outputs.has_room(false) && outputs.has_room(true));
        let mark = outputs.set_with_motion(3, true, true);
        outputs.begun(mark);
        assert_eq!((outputs.levels(), outputs.is_waiting()), (0b1001, false));
    }

    #[test]
    fn what_is_forgotten_does_not_come_with_a_later_motion() {
        let mut outputs = DigitalOutputs::OFF;
        for round in 0..100 {
            let mark = outputs.newest();
            outputs.set_with_motion(0, true, false);
            outputs.motion_follows();
            outputs.set_with_motion(1, true, false);
            outputs.motion_follows();
            outputs.forget_waiting(mark);
            outputs.begun(mark);
            assert_eq!((outputs.levels(), outputs.is_waiting()), (0, false), "{round}");
            let next = outputs.set_with_motion(2, true, false);
            outputs.begun(mark);
            assert_eq!(outputs.levels(), 0);
            outputs.begun(next);
            assert_eq!(outputs.levels(), 0b100);
            outputs.switch_off(next);
        }
    }
}
