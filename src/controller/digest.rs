//! Two hashes (FNV-1a) of the step events of a machine, to compare machines. One covers the events and their times,
//! the other only the events in their order. The simulator computes the hashes from its trace. An emulated board
//! without step pins computes them from the words that it would have written to the pins.

/// The two hashes of the step events so far.
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

    /// Adds a step event. `ticks`: time for which the step task has run so far, without the pauses between motions, in
    /// ticks of the step clock. `steps`, `directions`: step bits and direction bits of the event, bit 0 for X.
    pub fn add(&mut self, ticks: u64, steps: u8, directions: u8) {
        let bits = u64::from(steps) | u64::from(directions) << 8;
        self.time = (self.time ^ ticks).wrapping_mul(PRIME);
        self.time = (self.time ^ bits).wrapping_mul(PRIME);
        self.order = (self.order ^ bits).wrapping_mul(PRIME);
    }

    /// Returns the hash of the events and their times.
    pub fn time_hash(&self) -> u64 {
        self.time
    }

    /// Returns the hash of the events in their order, without the times.
    pub fn order_hash(&self) -> u64 {
        self.order
    }
}
