//! Memory of the interpreter's large parts: held text and parameters, tool table, saved states, control points. On
//! boards it is static, in programs on a PC it is on the heap (see `crate::memory`).

use super::computed::ComputedMemory;
#[cfg(not(feature = "alloc"))]
use super::computed::ComputedStorage;
use super::control_points::PointList;
use super::saved::SavedList;
use super::tools::ToolTable;
use crate::image::FULL_IMAGE;
use crate::lent::Lent;

/// Memory of one interpreter: references to static storage on boards, boxes in programs on a PC.
#[derive(Debug)]
pub struct ProgramMemory<const N: usize> {
    pub(super) computed: ComputedMemory,
    pub(super) tools: Lent<ToolTable<N>>,
    pub(super) saved: Lent<SavedList<N>>,
    pub(super) control_points: [Lent<PointList>; FULL_IMAGE as usize],
}

/// Static storage for the memory of one interpreter on a board. `HELD`: number of bytes for the held text (the recorded
/// lines of subroutines, loops and macros).
#[derive(Debug)]
#[cfg(not(feature = "alloc"))]
pub struct ProgramStorage<const N: usize, const HELD: usize> {
    computed: ComputedStorage<HELD>,
    tools: ToolTable<N>,
    saved: SavedList<N>,
    control_points: [PointList; FULL_IMAGE as usize],
}

#[cfg(not(feature = "alloc"))]
impl<const N: usize, const HELD: usize> ProgramStorage<N, HELD> {
    /// Empty memory; all bytes are 0.
    pub const EMPTY: Self = Self {
        computed: ComputedStorage::EMPTY,
        tools: ToolTable::EMPTY,
        saved: SavedList::new(),
        control_points: [const { PointList::new() }; FULL_IMAGE as usize],
    };

    /// Returns references to this storage, for one interpreter. They stay valid for the whole run time.
    pub fn lend(&'static mut self) -> ProgramMemory<N> {
        ProgramMemory {
            computed: self.computed.lend(),
            tools: &mut self.tools,
            saved: &mut self.saved,
            control_points: self.control_points.each_mut(),
        }
    }
}

#[cfg(feature = "alloc")]
impl<const N: usize> ProgramMemory<N> {
    /// Allocates the memory on the heap, with `held` bytes for held text.
    pub fn on_heap(held: usize) -> Self {
        Self {
            computed: ComputedMemory::on_heap(held),
            tools: Lent::new(ToolTable::EMPTY),
            saved: Lent::new(SavedList::new()),
            control_points: core::array::from_fn(|_| Lent::new(PointList::new())),
        }
    }
}
