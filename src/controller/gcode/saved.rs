//! Modal states saved by M70 and M73, one for each level of subroutine calls. M72 restores the state, M71 forgets it,
//! and a call that began with M73 restores it when it returns.

use super::modal::Modal;
use crate::axes::PerAxis;
use crate::image::FULL_IMAGE;
use crate::lent::Lent;
use crate::units::Coordinate;

/// So many states are saved at once: without subroutines one.
const MOST: usize = if FULL_IMAGE { 8 } else { 1 };
/// The call of a state that is to be restored has returned already.
const RETURNED: u8 = u8::MAX;

/// A saved state.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Saved<const N: usize> {
    pub modal: Modal,
    pub tool_length: PerAxis<Coordinate, N>,
    pub g92_acts: bool,
    /// What the spindle held. Of another tool the length is not restored.
    pub spindle_tool: u32,
    /// The length of the tool has been measured since, so that what was saved of it is no longer true.
    pub is_measured_anew: bool,
    /// Calls under way when it was saved.
    pub level: u8,
    /// M73: it is restored at the end of its call.
    pub until_return: bool,
    /// M71: not unless another takes its place.
    pub is_forgotten: bool,
}

/// Room for them.
pub(super) type SavedList<const N: usize> = heapless::Vec<Saved<N>, MOST>;

/// All saved states, at most one of each level of calls.
#[cfg_attr(feature = "alloc", derive(Clone))]
#[derive(Debug, PartialEq)]
pub(super) struct SavedStates<const N: usize>(Lent<SavedList<N>>);

impl<const N: usize> SavedStates<N> {
    pub fn new(room: Lent<SavedList<N>>) -> Self {
        Self(room)
    }

    /// Whether M72 has nothing to restore.
    pub fn is_empty(&self) -> bool {
        self.0.iter().all(|saved| saved.is_forgotten)
    }

    /// What M72 restores at a level of calls; of a call that has returned its own.
    pub fn of(&self, level: u8) -> Option<&Saved<N>> {
        let at = |level| self.saved_at(level).filter(|saved| !saved.is_forgotten);
        at(RETURNED).or_else(|| at(level))
    }

    fn saved_at(&self, level: u8) -> Option<&Saved<N>> {
        self.0.iter().find(|saved| saved.level == level)
    }

    /// Whether a state of this level can be saved.
    pub fn has_room(&self, level: u8) -> bool {
        !self.0.is_full() || self.saved_at(level).is_some()
    }

    /// Takes the place of what was saved at the same level; M73 stays in force.
    pub fn save(&mut self, mut saved: Saved<N>) {
        saved.until_return |= self.saved_at(saved.level).is_some_and(|before| before.until_return);
        self.0.retain(|before| before.level != saved.level);
        let _ = self.0.push(saved);
    }

    /// The tool in the spindle has been measured.
    pub fn tool_measured(&mut self) {
        self.0.iter_mut().for_each(|saved| saved.is_measured_anew = true);
    }

    /// M71.
    pub fn forget(&mut self, level: u8) {
        if let Some(saved) = self.0.iter_mut().find(|saved| saved.level == level) {
            saved.is_forgotten = true;
        }
    }

    /// Calls have ended, back to this level. Whether M73 wants a state restored.
    #[cfg_attr(not(feature = "full"), allow(dead_code, reason = "there are no calls"))]
    pub fn leave(&mut self, level: u8) -> bool {
        let mut restores = false;
        self.0.retain_mut(|saved| {
            let leaves = saved.level > level;
            let restored = leaves && saved.until_return && !saved.is_forgotten;
            if restored {
                saved.level = RETURNED;
                restores = true;
            }
            !leaves || restored
        });
        restores
    }

    /// Calls are given up, or have returned with what they wanted restored.
    pub fn abandon(&mut self, level: u8) {
        self.0.retain(|saved| saved.level <= level);
    }

    /// Forgets all.
    pub fn clear(&mut self) {
        self.0.clear();
    }
}
