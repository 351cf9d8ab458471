//! The segments that have been handed to the step task, in a ring: end position, speed, time, line number and power of
//! each. Those that have begun are removed; the last of them gives the position and speed that are reported.

use crate::axes::PerAxis;
use crate::lent::Lent;
use crate::messages::SEGMENTS_DEPTH;

/// The segment begun last and the one before it.
pub(super) const BEGUN: usize = 2;
/// The queue to the step task, its prefetched segment, some that it has made ahead of their time or that are on their way, and
/// the ones begun.
pub(super) const RING: usize = SEGMENTS_DEPTH + 4 + BEGUN;

/// A segment in words of the machine.
#[derive(Clone, Copy, Debug)]
pub struct InFlightSegment<const N: usize> {
    /// Machine steps of the tool at its end, and how far the motors lead it.
    pub position: PerAxis<i32, N>,
    pub lead: [i32; N],
    /// mm/s.
    pub speed: f32,
    /// Its time in step-clock ticks.
    pub clocks: u32,
    pub line_number: u32,
    pub power: u16,
    /// That of its block.
    pub mark: u8,
}

impl<const N: usize> InFlightSegment<N> {
    /// Where an index would be out of the ring, which none is.
    pub(super) const NONE: Self = Self::still(PerAxis([0; N]), [0; N]);

    const fn still(position: PerAxis<i32, N>, lead: [i32; N]) -> Self {
        Self { position, lead, speed: 0.0, clocks: 0, line_number: 0, power: 0, mark: 0 }
    }

    /// Machine steps of the motors at its end.
    pub(super) fn motors(&self) -> PerAxis<i32, N> {
        self.position.zip(&PerAxis(self.lead), i32::wrapping_add)
    }
}

/// The records of segments not begun, and that of the one begun last.
#[derive(Debug)]
#[cfg_attr(feature = "alloc", derive(Clone))]
pub(super) struct SegmentsInFlight<const N: usize> {
    /// A ring buffer. In the two slots before `first` are the segment begun last and the one before it.
    ring: Lent<[InFlightSegment<N>]>,
    first: usize,
    len: usize,
    /// Time of all records in the ring.
    queued: u32,
    /// Count of the step task at which the first record of the ring is still to begin.
    begun: u32,
    /// A segment has begun since the step task was last at rest.
    moves: bool,
}

impl<const N: usize> SegmentsInFlight<N> {
    /// At position 0. The ring has room for [`BEGUN`] segments more than can be in flight.
    pub(super) fn new(ring: Lent<[InFlightSegment<N>]>) -> Self {
        Self { ring, first: 0, len: 0, queued: 0, begun: 0, moves: false }
    }

    #[inline]
    pub(super) fn is_full(&self) -> bool {
        self.len + BEGUN >= self.ring.len()
    }

    /// Two motions exchange their rings; both are at rest.
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

    /// Whether a segment has begun since the step task was last at rest.
    pub(super) fn moves(&self) -> bool {
        self.moves
    }

    /// Step-clock ticks handed over and not begun.
    #[inline]
    pub(super) fn queued(&self) -> u32 {
        self.queued
    }

    /// The segment begun last.
    pub(super) fn current(&self) -> &InFlightSegment<N> {
        self.begun_before(1)
    }

    /// What had been done before the segment begun last.
    pub(super) fn before(&self) -> &InFlightSegment<N> {
        self.begun_before(2)
    }

    fn begun_before(&self, many: usize) -> &InFlightSegment<N> {
        self.ring.get(self.slot(many)).unwrap_or(&InFlightSegment::NONE)
    }

    /// The slot so many before the first.
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

    /// Takes over how many segments have begun.
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
            // After a stop the step task begins nothing before the gate is opened, so the count cannot be too old here.
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

    /// Everything handed over is gone; the machine rests at `position`.
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
