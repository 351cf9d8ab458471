//! Memory for the large parts of a controller: motion with its look-ahead, the interpreter, queued replies and stored
//! texts, 20 to 70 KB in all. The caller provides the memory for as long as the program runs. The parts are built one
//! after the other, so the stack never holds more than one of them.

use crate::dispatch::Profile;
use crate::gcode::Interpreter;
use crate::host::stored::Records;
use crate::lent::Lent;
use crate::motion::Motion;
use crate::protocol::reply_queue::Replies;

/// The large parts of one controller with `N` axes, newly built.
#[derive(Debug)]
pub struct Memory<const N: usize> {
    pub(crate) motion: Lent<Motion<N>>,
    pub(crate) parking: Lent<Motion<N>>,
    pub(crate) interpreter: Lent<Interpreter<N>>,
    pub(crate) replies: Lent<Replies>,
    pub(crate) records: Lent<Records>,
}

#[cfg(feature = "alloc")]
impl<const N: usize> Memory<N> {
    /// Allocates the parts on the heap. `blocks`: length of the look-ahead, in blocks. `held`: bytes for stored lines
    /// (subroutines, loops, macros and held programs).
    pub fn on_heap(profile: &Profile, blocks: usize, held: usize) -> Self {
        let motion = |memory| Lent::new(Motion::unconfigured(profile.step_clock_hz, memory));
        Self {
            motion: motion(crate::motion::on_heap(blocks)),
            parking: motion(crate::motion::on_heap_for_single_moves()),
            interpreter: Lent::new(Interpreter::new(crate::gcode::ProgramMemory::on_heap(held))),
            replies: Lent::new(Replies::new()),
            records: Lent::new(Records::new(profile.has_store)),
        }
    }
}

/// Static memory for the large parts of the controller on a board. `BLOCKS`: length of the look-ahead, in blocks.
/// `HELD`: bytes for stored lines (subroutines, loops, macros and held programs).
#[cfg(not(feature = "alloc"))]
pub use on_board::Storage;

#[cfg(not(feature = "alloc"))]
mod on_board {
    use super::*;
    use crate::gcode::ProgramStorage;
    use crate::motion::{MotionStorage, SingleMoveStorage};
    use core::mem::MaybeUninit;

    /// Static memory for the large parts of the controller on a board. `BLOCKS`: length of the look-ahead, in blocks.
    /// `HELD`: bytes for stored lines (subroutines, loops, macros and held programs).
    #[derive(Debug)]
    pub struct Storage<const N: usize, const BLOCKS: usize, const HELD: usize> {
        job: MotionStorage<N, BLOCKS>,
        parked: SingleMoveStorage<N>,
        program: ProgramStorage<N, HELD>,
        motion: MaybeUninit<Motion<N>>,
        parking: MaybeUninit<Motion<N>>,
        interpreter: MaybeUninit<Interpreter<N>>,
        replies: MaybeUninit<Replies>,
        records: MaybeUninit<Records>,
    }

    impl<const N: usize, const BLOCKS: usize, const HELD: usize> Storage<N, BLOCKS, HELD> {
        /// All bytes are 0 or uninitialised, so a static `Storage` needs no flash (`cargo fw` checks the size of
        /// `.data`).
        pub const EMPTY: Self = Self {
            job: MotionStorage::EMPTY,
            parked: SingleMoveStorage::EMPTY,
            program: ProgramStorage::EMPTY,
            motion: MaybeUninit::uninit(),
            parking: MaybeUninit::uninit(),
            interpreter: MaybeUninit::uninit(),
            replies: MaybeUninit::uninit(),
            records: MaybeUninit::uninit(),
        };

        /// Builds the parts in this storage, and returns `'static` references to them.
        #[inline(never)]
        pub fn lend(&'static mut self, profile: &Profile) -> Memory<N> {
            let clock = profile.step_clock_hz;
            Memory {
                motion: in_place(&mut self.motion, || Motion::unconfigured(clock, self.job.lend())),
                parking: in_place(&mut self.parking, || Motion::unconfigured(clock, self.parked.lend())),
                interpreter: in_place(&mut self.interpreter, || Interpreter::new(self.program.lend())),
                replies: in_place(&mut self.replies, Replies::new),
                records: in_place(&mut self.records, || Records::new(profile.has_store)),
            }
        }
    }

    /// Builds a part in its storage. Not inlined, so that the stack used by one part is free again before the next is
    /// built.
    #[inline(never)]
    fn in_place<T>(place: &'static mut MaybeUninit<T>, new: impl FnOnce() -> T) -> &'static mut T {
        place.write(new())
    }
}
