//! Keeps the noise of switches and long wires away from the controller: a level changes after eight samples in a row
//! that contradict it.

/// Up to 16 inputs, each with a counter of the samples that contradict its level. The counters stand upright: bit n of
/// `count[k]` is bit k of the counter of input n, so all are counted at once in a dozen instructions.
#[derive(Clone, Copy, Debug, Default)]
pub struct Filter {
    level: u16,
    count: [u16; 3],
}

impl Filter {
    /// All inputs inactive.
    pub const fn new() -> Filter {
        Filter { level: 0, count: [0; 3] }
    }

    /// Takes a sample and gives the filtered levels.
    pub fn sample(&mut self, raw: u16) -> u16 {
        let differs = raw ^ self.level;
        let [a, b, c] = self.count;
        // Seven samples have differed before, and this one does too.
        let enough = a & b & c & differs;
        let carry = a & b;
        self.count = [!a & differs & !enough, (b ^ a) & differs & !enough, (c ^ carry) & differs & !enough];
        self.level ^= enough;
        self.level
    }
}
