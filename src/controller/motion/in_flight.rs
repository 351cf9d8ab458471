//! Ring of the segments handed to the step task: end position, speed, time, line number and power of each. Of the
//! segments that have begun, only the last two are kept. The one begun last gives the reported position and speed.

use crate::axes::PerAxis;
use crate::lent::Lent;
use crate::messages::SEGMENTS_DEPTH;

/// Number of segments that are kept after they have begun: the one begun last and the one before it.
pub(super) const BEGUN: usize = 2;
/// Size of the ring. It has room for the segments in the queue to the step task, for the begun ones, and for 4 more:
/// those that the step task has prefetched or executes ahead of time, and those on their way to it.
pub(super) const RING: usize = SEGMENTS_DEPTH + 4 + BEGUN;

/// Record of a segment in flight, as needed for reports.
#[derive(Clone, Copy, Debug)]
pub struct InFlightSegment<const N: usize> {
    /// Tool position at the end of the segment, in machine steps.
    pub position: PerAxis<i32, N>,
    /// Steps by which each motor leads the tool at the end of the segment (backlash compensation).
    pub lead: [i32; N],
    /// Average speed, mm/s.
    pub speed: f32,
    /// Duration in step-clock ticks.
    pub clocks: u32,
    pub line_number: u32,
    pub power: u16,
    /// Number from 0 to 31 that `Motion::set_mark` has set for the segment's block, to time a change of outputs.
    pub mark: u8,
}

impl<const N: usize> InFlightSegment<N> {
    /// Fallback for an index outside the ring, which does not occur; also the initial contents of the ring.
    pub(super) const NONE: Self = Self::still(PerAxis([0; N]), [0; N]);

    const fn still(position: PerAxis<i32, N>, lead: [i32; N]) -> Self {
        Self { position, lead, speed: 0.0, clocks: 0, line_number: 0, power: 0, mark: 0 }
    }

    /// Returns the motors' machine steps at the end of the segment.
    pub(super) fn motors(&self) -> PerAxis<i32, N> {
        self.position.zip(&PerAxis(self.lead), i32::wrapping_add)
    }
}

/// Ring of records: of the segments that have not begun, and of the last two that have begun.
#[derive(Debug)]
#[cfg_attr(feature = "alloc", derive(Clone))]
pub(super) struct SegmentsInFlight<const N: usize> {
    /// The slots from `first` on hold the segments that have not begun. The two slots before `first` hold the last two
    /// that have begun.
    ring: Lent<[InFlightSegment<N>]>,
    first: usize,
    len: usize,
    /// Total duration of the segments that have not begun, in step-clock ticks.
    queued: u32,
    /// Number of begun segments that have been applied to the ring. If the step task's count of begun segments
    /// differs, the segment at `first` has begun.
    begun: u32,
    /// Whether a segment has begun since the step task was last at rest.
    moves: bool,
}

impl<const N: usize> SegmentsInFlight<N> {
    /// Creates a record without segments in flight, at position 0. The ring must have [`BEGUN`] more slots than the
    /// maximum number of segments in flight.
    pub(super) fn new(ring: Lent<[InFlightSegment<N>]>) -> Self {
        Self { ring, first: 0, len: 0, queued: 0, begun: 0, moves: false }
    }

    #[inline]
    pub(super) fn is_full(&self) -> bool {
        self.len + BEGUN >= self.ring.len()
    }

    /// Exchanges the rings of two motions. Both must be at rest; each keeps its own begun segments.
    pub(super) fn exchange_ring(&mut self, other: &mut Self) {
        debug_assert!(self.is_empty() && other.is_empty());
        let begun = [(*self.before(), *self.current()), (*other.before(), *other.current())];
        core::mem::swap(&mut self.ring, &mut other.ring);
        for (own, (before, current)) in [self, other].into_iter().zip(begun) {
            (own.first, own.len, own.queued) = (0, 0, 0);
            for (many, segment) in [(2, before), (1, current)] {
                let slot = own.slot(many);
                if let Some(begun) = own.ring.get_mut(slot) {
                    *begun = segment;
                }
            }
        }
    }

    pub(super) fn is_empty(&self) -> bool {
        self.len == 0
    }

    pub(super) fn moves(&self) -> bool {
        self.moves
    }

    /// Returns the total duration of the segments that have not begun, in step-clock ticks.
    #[inline]
    pub(super) fn queued(&self) -> u32 {
        self.queued
    }

    /// Returns the segment begun last.
    pub(super) fn current(&self) -> &InFlightSegment<N> {
        self.begun_before(1)
    }

    /// Returns the segment before the one begun last.
    pub(super) fn before(&self) -> &InFlightSegment<N> {
        self.begun_before(2)
    }

    fn begun_before(&self, many: usize) -> &InFlightSegment<N> {
        self.ring.get(self.slot(many)).unwrap_or(&InFlightSegment::NONE)
    }

    /// Returns the slot that is `many` slots before `first`.
    #[inline]
    fn slot(&self, many: usize) -> usize {
        if self.first >= many { self.first - many } else { self.first + self.ring.len() - many }
    }

    pub(super) fn push(&mut self, record: InFlightSegment<N>) {
        let index = self.first + self.len;
        let index = if index >= self.ring.len() { index - self.ring.len() } else { index };
        if let Some(slot) = self.ring.get_mut(index) {
            *slot = record;
            self.len += 1;
            self.queued = self.queued.saturating_add(record.clocks);
        }
    }

    /// Updates the ring from `begun`, the step task's count of begun segments. `idle`: `true` if the step task is at
    /// rest. If it is at rest and no segment is in flight, the reported speed, power and line number become 0.
    #[inline]
    pub(super) fn observe(&mut self, begun: u32, idle: bool) {
        while self.len > 0 && self.begun != begun {
            let clocks = self.ring.get(self.first).map_or(0, |record| record.clocks);
            self.queued = self.queued.saturating_sub(clocks);
            self.first = if self.first + 1 >= self.ring.len() { 0 } else { self.first + 1 };
            self.len -= 1;
            self.begun = self.begun.wrapping_add(1);
            self.moves = true;
        }
        if self.len == 0 {
            // Nothing is in flight, so adopt the step task's count of begun segments. The count does not change any
            // more: even after a stop, the step task begins no segment while its gate is closed.
            self.begun = begun;
            if !idle {
                return;
            }
            self.moves = false;
            let last = self.slot(1);
            if let Some(current) = self.ring.get_mut(last) {
                current.speed = 0.0;
                current.power = 0;
                current.line_number = 0;
            }
        }
    }

    /// Clears all segments in flight. The machine rests with the tool at `position` (steps), and the motors lead it by
    /// `lead` steps.
    pub(super) fn forget(&mut self, position: PerAxis<i32, N>, lead: [i32; N]) {
        self.len = 0;
        self.queued = 0;
        self.moves = false;
        let mark = self.current().mark;
        for slot in [self.slot(1), self.slot(2)] {
            if let Some(begun) = self.ring.get_mut(slot) {
                *begun = InFlightSegment { mark, ..InFlightSegment::still(position, lead) };
            }
        }
    }
}
