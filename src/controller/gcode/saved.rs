//! Modal states saved by M70 and M73, at most one for each level of subroutine calls. M72 restores the state of its
//! level, and M71 forgets it. A state saved by M73 is also restored when its call returns.

use super::modal::Modal;
use crate::axes::PerAxis;
use crate::image::FULL_IMAGE;
use crate::lent::Lent;
use crate::units::Coordinate;

/// Maximum number of saved states. A build without subroutines needs only one.
const MOST: usize = if FULL_IMAGE { 8 } else { 1 };
/// Replaces the level of a saved state after the call in which the state was saved has returned. The M72 that runs
/// next restores this state.
const RETURNED: u8 = u8::MAX;

/// A state that M70 or M73 has saved.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Saved<const N: usize> {
    pub modal: Modal,
    pub tool_length: PerAxis<Coordinate, N>,
    pub g92_acts: bool,
    /// The tool in the spindle when the state was saved. If another tool is in the spindle now, the saved tool length
    /// is not restored.
    pub spindle_tool: u32,
    /// Whether a tool has been measured since the state was saved, so that the saved length is outdated.
    pub is_measured_anew: bool,
    /// Number of active subroutine calls when the state was saved.
    pub level: u8,
    /// Whether M73 has saved the state: the return from its call then restores the state, without an M72 in the
    /// program.
    pub until_return: bool,
    /// Whether M71 has discarded the state, so that it is never restored. The entry remains in the list until another
    /// state is saved at its level.
    pub is_forgotten: bool,
}

/// Memory for the saved states, at most `MOST`.
pub(super) type SavedList<const N: usize> = heapless::Vec<Saved<N>, MOST>;

/// All saved states, at most one per level of subroutine calls.
#[cfg_attr(feature = "alloc", derive(Clone))]
#[derive(Debug, PartialEq)]
pub(super) struct SavedStates<const N: usize>(Lent<SavedList<N>>);

impl<const N: usize> SavedStates<N> {
    pub fn new(room: Lent<SavedList<N>>) -> Self {
        Self(room)
    }

    /// Returns whether nothing is saved that M72 could restore, at any level.
    pub fn is_empty(&self) -> bool {
        self.0.iter().all(|saved| saved.is_forgotten)
    }

    /// Returns the state that M72 restores at this level of calls. If a call has just returned and M73 has saved a
    /// state in it, returns that state.
    pub fn of(&self, level: u8) -> Option<&Saved<N>> {
        let at = |level| self.saved_at(level).filter(|saved| !saved.is_forgotten);
        at(RETURNED).or_else(|| at(level))
    }

    fn saved_at(&self, level: u8) -> Option<&Saved<N>> {
        self.0.iter().find(|saved| saved.level == level)
    }

    /// Returns whether a state of this level can be saved.
    pub fn has_room(&self, level: u8) -> bool {
        !self.0.is_full() || self.saved_at(level).is_some()
    }

    /// Saves a state, which replaces the state that was saved at the same level. If M73 saved the old state, the end
    /// of the call restores the new one.
    pub fn save(&mut self, mut saved: Saved<N>) {
        saved.until_return |= self.saved_at(saved.level).is_some_and(|before| before.until_return);
        self.0.retain(|before| before.level != saved.level);
        let _ = self.0.push(saved);
    }

    /// Marks the tool length of all saved states as outdated. Call this when the tool in the spindle has been measured.
    pub fn tool_measured(&mut self) {
        self.0.iter_mut().for_each(|saved| saved.is_measured_anew = true);
    }

    /// Executes M71: forgets the state of a level.
    pub fn forget(&mut self, level: u8) {
        if let Some(saved) = self.0.iter_mut().find(|saved| saved.level == level) {
            saved.is_forgotten = true;
        }
    }

    /// Drops the states of all calls that are nested deeper than `level`, because these calls end. Returns `true` if
    /// M73 has saved a state in one of them. This state stays, and the caller has to run M72, which restores it.
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

    /// Drops the states of all calls nested deeper than `level`. Called when these calls were aborted, or when M72 has
    /// restored the state of a call that has returned.
    pub fn abandon(&mut self, level: u8) {
        self.0.retain(|saved| saved.level <= level);
    }

    pub fn clear(&mut self) {
        self.0.clear();
    }
}
