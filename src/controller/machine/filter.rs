//! Debounces 32 inputs at once. A level changes after eight samples in a row that differ from it; a shorter change is
//! rejected. Used by the inputs task.

/// Samples per second that the inputs task takes. A change passes the filter after 8 samples, which is 0.4 ms.
pub const SAMPLE_HZ: u32 = 20_000;

/// Up to 32 inputs, each with a counter of the samples that contradict its level. The counters are stored bit-sliced:
/// bit n of `count[k]` is bit k of the counter of input n, so a dozen instructions count for all inputs at once.
#[derive(Clone, Copy, Debug, Default)]
pub struct Filter {
    level: u32,
    count: [u32; 3],
    rejected: u32,
}

impl Filter {
    /// Returns a filter with all inputs inactive.
    pub const fn new() -> Filter {
        Filter { level: 0, count: [0; 3], rejected: 0 }
    }

    /// Takes a sample of all inputs, one bit each, and returns their filtered levels.
    pub fn sample(&mut self, raw: u32) -> u32 {
        let differs = raw ^ self.level;
        let [a, b, c] = self.count;
        // If the counter of an input is 7 and the input differs again, this is the eighth sample in a row that differs
        // from the level.
        let enough = a & b & c & differs;
        let carry = a & b;
        self.rejected = (a | b | c) & !differs;
        self.count = [!a & differs & !enough, (b ^ a) & differs & !enough, (c ^ carry) & differs & !enough];
        self.level ^= enough;
        self.level
    }

    /// Returns the inputs whose change was too short (noise, or the bounce of a contact) and ended with the last
    /// sample.
    pub fn rejected(&self) -> u32 {
        self.rejected
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn eight_samples_change_a_level_and_seven_do_not() {
        let mut filter = Filter::new();
        for _ in 0..7 {
            assert_eq!(filter.sample(0b101), 0);
        }
        assert_eq!(filter.sample(0b001), 0b001);
        for _ in 0..7 {
            assert_eq!(filter.sample(0b100), 0b001);
        }
        assert_eq!(filter.sample(0b100), 0b100);
    }

    #[test]
    fn a_change_too_short_is_rejected_once() {
        let mut filter = Filter::new();
        let rejected: Vec<u32> = [0, 1, 1, 0, 0, 1, 0]
            .map(|raw| {
                filter.sample(raw);
                filter.rejected()
            })
            .to_vec();
        assert_eq!(rejected, [0, 0, 0, 1, 0, 0, 1]);
        for _ in 0..9 {
            filter.sample(1);
            assert_eq!(filter.rejected(), 0, "this one lasts");
        }
    }

    /// Compares the bit-sliced counters with one plain counter for each input.
    #[test]
    fn agrees_with_plain_counters() {
        let mut filter = Filter::new();
        let (mut level, mut count) = (0_u32, [0; 32]);
        let mut noise = 0x1234_5678_u32;
        for _ in 0..100_000 {
            noise ^= noise << 13;
            noise ^= noise >> 17;
            noise ^= noise << 5;
            let raw = noise & noise.rotate_left(11) | 0x00F0;
            for (n, count) in count.iter_mut().enumerate() {
                *count = if (raw ^ level) >> n & 1 == 0 { 0 } else { *count + 1 };
                if *count == 8 {
                    level ^= 1 << n;
                    *count = 0;
                }
            }
            assert_eq!(filter.sample(raw), level);
        }
    }
}
