//! Hashes (FNV-1a) of a step stream: one over its step events with their times, one over the events in their order,
//! without times. Two machines with the same steps at the same times have the same hashes. The simulator computes the
//! hashes from its trace; an emulated board without step pins computes them from the words that it would have written
//! to the pins.

/// Running digest over (time, step bits, direction bits) of each step event.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Digest {
    time: u64,
    order: u64,
}

// Offset basis and prime of 64-bit FNV-1a (Fowler, Noll, Vo), here applied to whole words instead of bytes.
const BASIS: u64 = 0xCBF2_9CE4_8422_2325;
const PRIME: u64 = 0x0000_0100_0000_01B3;

impl Default for Digest {
    fn default() -> Self {
        Self::new()
    }
}

impl Digest {
    /// Returns the digest before the first step event.
    pub const fn new() -> Self {
        Self { time: BASIS, order: BASIS }
    }

    /// Adds a step event. `ticks`: for how long the step task has been busy so far, in ticks of the step clock; pauses
    /// between motions do not count. `steps` and `directions` have bit 0 for X.
    pub fn add(&mut self, ticks: u64, steps: u8, directions: u8) {
        let bits = u64::from(steps) | u64::from(directions) << 8;
        self.time = (self.time ^ ticks).wrapping_mul(PRIME);
        self.time = (self.time ^ bits).wrapping_mul(PRIME);
        self.order = (self.order ^ bits).wrapping_mul(PRIME);
    }

    /// Returns the digest over the time, step bits and direction bits of all events.
    pub fn time_hash(&self) -> u64 {
        self.time
    }

    /// Returns the digest over the step and direction bits in their order, without the times.
    pub fn order_hash(&self) -> u64 {
        self.order
    }
}
