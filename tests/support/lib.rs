//! What several suites of tests share: random numbers that can be had again, and the numbers of a report.

pub mod program;

/// A generator of pseudo-random numbers (xorshift, Marsaglia 2003): a seed other than 0 always gives the same ones.
pub struct Random(pub u64);

impl Random {
    fn bits(&mut self) -> u64 {
        self.0 ^= self.0 << 13;
        self.0 ^= self.0 >> 7;
        self.0 ^= self.0 << 17;
        self.0
    }

    /// 0 to `end` - 1.
    pub fn below(&mut self, end: u64) -> u64 {
        (self.bits() >> 11) % end
    }

    /// One of them.
    pub fn of<'a>(&mut self, choices: &[&'a str]) -> &'a str {
        choices[self.below(choices.len() as u64) as usize]
    }
}

/// The numbers behind `name:` in a report, one for each axis; `None` if there is no such field.
///
/// # Panics
/// On anything but numbers there, and if there are fewer.
pub fn numbers<const N: usize>(report: &str, name: &str) -> Option<[f64; N]> {
    let field =
        report.split(['<', '>', '[', ']', '|']).find_map(|field| field.strip_prefix(name)?.strip_prefix(':'))?;
    let mut values = field.split([':', ',']).map(|n| n.parse().expect("a number"));
    Some(std::array::from_fn(|_| values.next().expect("a number for each axis")))
}

/// The inputs of a corpus: a line of a file for each, escaped as [`u8::escape_ascii`] does.
///
/// # Panics
/// On an escape that is none.
pub fn unpack(text: &str) -> Vec<Vec<u8>> {
    text.lines()
        .map(|line| unescape(line).unwrap_or_else(|| panic!("{line:?} is not escaped as it should be")))
        .collect()
}

/// The reverse of [`unpack`].
pub fn pack(inputs: &[Vec<u8>]) -> String {
    inputs.iter().map(|input| format!("{}\n", input.escape_ascii())).collect()
}

fn unescape(line: &str) -> Option<Vec<u8>> {
    let mut bytes = line.bytes();
    let mut input = Vec::new();
    while let Some(byte) = bytes.next() {
        input.push(match byte {
            b'\\' => match bytes.next()? {
                b't' => b'\t',
                b'r' => b'\r',
                b'n' => b'\n',
                b'x' => {
                    let digits = [bytes.next()?, bytes.next()?];
                    u8::from_str_radix(std::str::from_utf8(&digits).ok()?, 16).ok()?
                }
                escaped @ (b'\\' | b'\'' | b'"') => escaped,
                _ => return None,
            },
            byte => byte,
        });
    }
    Some(input)
}

#[test]
fn any_input_is_packed_and_unpacked() {
    let inputs = vec![Vec::new(), (0..=255).collect(), b"G1 X1\n".to_vec()];
    assert_eq!(unpack(&pack(&inputs)), inputs);
}
