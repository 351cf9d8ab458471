//! Checked lines (`$LC=ON`): each line has a number, a length and a CRC-32, for links that damage, drop, duplicate or
//! delay bytes. A damaged line is refused, and the reply contains the number of the line that is expected next. So each
//! line is executed exactly as sent, in order and once.
//!
//! ```text
//!  : NNN LL CCCCCCCC text LF
//!  │  │  │     └ CRC-32 (IEEE 802.3) of number, length and text as they are on the line
//!  │  │  └ bytes of the text on the line, modulo 256
//!  │  └ number of the line, modulo 4096: 0 for the first after `$LC=ON`
//!  └ marks a checked line
//! ```
//! **Sessions.** After `$LC=ON` a host may append four letters of its choice. With letters, the CRC covers the letters,
//! the full line number in eight digits, the length and the text. The CRC detects any burst of up to 32 bits. The
//! following two kinds of lines differ from the expected line only in such a burst, so they are always refused:
//! * a line with the same full number from another session: only the four letters differ;
//! * a line that is 4096 numbers old, if its number has the same first digit as the expected number (always below line
//!   2^28): the last three of the eight digits are the same, too, so only the four digits between can differ.
//!
//! In a session without letters, a line that is 4096 numbers old can pass, because the CRC covers only the last three
//! digits of the line number.
//!
//! **Letters.** N, L and C are hexadecimal digits, written as the letters `ABDGHKNPSUVZcefi`. Any two of these differ
//! in two or more bits. Each of them also differs in two or more bits from a line end and from every realtime command
//! except `?`. So one damaged bit cannot turn a letter into another letter, a line end or such a command. For the same
//! reason text is in capitals, and small letters replace the characters that are one bit away from such a command
//! (`SUBSTITUTES`): `8` is one bit away from 0x18, and `1` from `!`.
//!
//! **Detected errors.**
//! * One or two damaged bits are always detected. If a byte becomes a command or is dropped, the length is wrong. If a
//!   byte becomes a line end, both parts of the line are refused.
//! * As long as each byte remains a byte of its line, up to four damaged bits are detected (in texts of up to 250
//!   bytes), and bursts of up to 32 bits within the text.
//! * Of all other errors, one in 4,000 million passes.
//!
//! **Answers** have the same form and contain the number of the line that is expected next. They confirm all lines
//! before that number, so a lost answer does no harm. Only the expected line is executed. A line that was already
//! taken, or an empty line (a query), is answered `known`; any other line is answered [`Error::DamagedLine`]. After a
//! line was refused for its content, no line is executed until `$LC=ON` starts again, and each answer is that error.
//!
//! Checking ends with `$LC=OFF`, with another dialect and with another host. `$LC=ON` and `$LC=OFF` may be sent as
//! plain lines. A reset and a stop also end checking. After them, the bytes up to the next line end are refused. Two
//! damaged bits can turn a byte of a line into a reset or stop, so these bytes may be the rest of that line.

use super::text::{END, Text, put};
use crate::error::Error;

/// The letters that stand for the hexadecimal digits 0 to 15 in the header of a line.
const DIGITS: &[u8; 16] = b"ABDGHKNPSUVZcefi";
/// Small letters that replace characters in the text of a line: the letter, then the character for which it stands.
const SUBSTITUTES: [(u8, u8); 10] = [
    (b's', b' '),
    (b'h', b'#'),
    (b'p', b'%'),
    (b'd', b')'),
    (b'l', b'1'),
    (b'b', b'8'),
    (b'g', b'9'),
    (b't', b'>'),
    (b'x', b'X'),
    (b'y', b'Y'),
];

// Number of letters of each field in the header of a line: line number, length and CRC.
const NUMBER: usize = 3;
const LENGTH: usize = 2;
const SUM: usize = 8;
// Index of the first byte after each field of the header. The colon has index 0.
const NUMBER_END: u16 = 1 + NUMBER as u16;
const LENGTH_END: u16 = NUMBER_END + LENGTH as u16;
const HEADER_END: u16 = LENGTH_END + SUM as u16;

/// Number of bytes before the text of an answer with checksum: colon, line number, length and CRC.
pub const ANSWER_HEADER: usize = HEADER_END as usize;

/// Line numbers are written modulo this number.
const NUMBERS: u16 = 1 << (4 * NUMBER);
/// Number of digits of the full line number. In a session with letters, the CRC covers all of these digits, although
/// the line itself contains only the last three.
const WHOLE_NUMBER: usize = 8;
/// Number of letters that a host may append to `$LC=ON`.
const SESSION: usize = 4;

/// Result of checking a completed line.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Verdict {
    /// The line may be executed: it is the expected one, or checksums are off.
    Valid,
    /// The line is not executed, but answered `known`: it is empty, or it was received before.
    Known,
    /// The line is refused: it is damaged, it is not the expected one, or an earlier line was refused for its
    /// content.
    Damaged,
}

/// Returns whether `letters` are valid after `$LC=ON`: they are the letters of a session, or empty.
pub fn is_session(letters: &[u8]) -> bool {
    letters.is_empty() || letters.len() == SESSION && letters.iter().all(u8::is_ascii_uppercase)
}

/// A session: the lines after one `$LC=ON`.
#[derive(Clone, Copy, Debug)]
struct Session {
    /// CRC after the session's letters. The CRC of each line continues from here.
    start: Crc,
    /// The session has letters, so the CRC covers the line number in eight digits and not only its last three digits.
    is_named: bool,
}

impl Session {
    const NONE: Self = Self { start: Crc::START, is_named: false };

    fn of(letters: &[u8]) -> Self {
        let mut start = Crc::START;
        letters.iter().for_each(|letter| start.add(*letter));
        Self { start, is_named: !letters.is_empty() }
    }

    /// Returns the CRC over the session's letters and the digits of a line number.
    fn check(&self, number: u32) -> Crc {
        let mut crc = self.start;
        let mut letters = Text::new();
        digits(&mut letters, number, if self.is_named { WHOLE_NUMBER } else { NUMBER });
        letters.iter().for_each(|letter| crc.add(*letter));
        crc
    }
}

/// Checks lines byte by byte, and tracks which line is expected.
#[derive(Clone, Debug)]
pub struct LineChecksum {
    /// Number of the expected line; `None` while checksums are off.
    wanted: Option<u32>,
    session: Session,
    /// A reset or stop has switched checksums off: everything up to the next line end is refused.
    aborted: bool,
    /// Error of a line that passed the checksum but was refused for its content. All later lines get this error, too.
    failed: Option<Error>,
    /// Number of bytes of the current line received so far, including its header.
    place: u16,
    /// The line begins with a colon, all its digits are valid, and no byte was lost.
    is_whole: bool,
    number: u16,
    length: u8,
    sum: u32,
    crc: Crc,
}

impl LineChecksum {
    /// Checksums are off, and lines are accepted without them.
    pub const OFF: Self = Self {
        wanted: None,
        session: Session::NONE,
        aborted: false,
        failed: None,
        place: 0,
        is_whole: true,
        number: 0,
        length: 0,
        sum: 0,
        crc: Crc::START,
    };

    /// Switches checksums on. The first line has the number 0. `session`: the four letters after `$LC=ON`, or empty.
    pub fn begin(&mut self, session: &[u8]) {
        *self = Self { wanted: Some(0), session: Session::of(session), ..Self::OFF };
    }

    /// Switches checksums off. Returns whether they were on.
    pub fn end(&mut self) -> bool {
        core::mem::replace(self, Self::OFF).wanted.is_some()
    }

    /// Switches checksums off because of a reset or a stop. Everything up to the next line end is refused, because a
    /// damaged byte of a line may have become the reset or stop. Returns whether checksums were on.
    pub fn abort(&mut self) -> bool {
        let was_on = self.is_on();
        *self = Self { aborted: was_on || self.aborted, ..Self::OFF };
        was_on
    }

    /// Returns whether checksums are on.
    #[inline]
    pub fn is_on(&self) -> bool {
        self.wanted.is_some()
    }

    /// Returns whether `finish` has to check the line: checksums are on, or a reset or stop has just switched them off.
    #[inline]
    pub fn looks_at_end(&self) -> bool {
        self.is_on() || self.aborted
    }

    /// Returns whether bytes of a line have arrived, including those of its header.
    pub fn has_begun(&self) -> bool {
        self.place > 0
    }

    /// Discards the bytes of the current line. The session and the expected number stay.
    pub fn clear(&mut self) {
        let Self { wanted, session, aborted, failed, .. } = *self;
        *self = Self { wanted, session, aborted, failed, ..Self::OFF };
    }

    /// Records that bytes of the line were lost, so that the line will be refused.
    pub fn damage(&mut self) {
        self.is_whole = false;
    }

    /// Records that the last completed line was refused for its content. Does nothing while checksums are off, or if
    /// the error is [`Error::DamagedLine`], which is no error of the content.
    pub fn fail(&mut self, error: Error) {
        if self.is_on() && error != Error::DamagedLine {
            self.failed = Some(error);
        }
    }

    /// Returns the error of the line that passed the checksum but was refused for its content; `None` if there was no
    /// such line. Every later line gets this error.
    pub fn failed(&self) -> Option<Error> {
        self.failed
    }

    /// Takes a byte of a line other than its end. Returns the character that the byte stands for, or `None` for a byte
    /// of the header (colon, line number, length and CRC). While checksums are off, returns the byte itself.
    #[inline]
    pub fn take(&mut self, byte: u8) -> Option<u8> {
        if self.is_on() { self.take_checked(byte) } else { Some(byte) }
    }

    #[inline(never)]
    fn take_checked(&mut self, byte: u8) -> Option<u8> {
        let place = self.place;
        self.place = place.saturating_add(1);
        match place {
            0 => {
                self.number = 0;
                self.sum = 0;
                self.length = 0;
                self.is_whole &= byte == b':';
                return (byte != b':').then_some(byte);
            }
            _ if !self.is_whole => return Some(byte),
            1..NUMBER_END => {
                self.number = self.number << 4 | u16::from(self.digit(byte));
                if self.place == NUMBER_END {
                    self.crc = self.session.check(self.wanted.unwrap_or(0).wrapping_sub(self.behind().into()));
                }
                return None;
            }
            NUMBER_END..LENGTH_END => self.length = self.length << 4 | self.digit(byte),
            LENGTH_END..HEADER_END => {
                self.sum = self.sum << 4 | u32::from(self.digit(byte));
                return None;
            }
            _ => {}
        }
        self.crc.add(byte);
        if place < HEADER_END {
            return None;
        }
        let meant = SUBSTITUTES.iter().find(|(letter, _)| *letter == byte);
        Some(meant.map_or(byte, |(_, character)| *character))
    }

    /// Returns the expected number minus the number of this line, modulo 4096: 0 for the expected line, 1 for the
    /// line before it.
    fn behind(&self) -> u16 {
        (self.wanted.unwrap_or(0) as u16).wrapping_sub(self.number) % NUMBERS
    }

    /// Returns the value of a digit. An invalid digit marks the line as damaged.
    fn digit(&mut self, letter: u8) -> u8 {
        let value = DIGITS.iter().position(|digit| *digit == letter);
        self.is_whole &= value.is_some();
        value.unwrap_or(0) as u8
    }

    /// Checks number, length and CRC of a line at its end. `text`: the line as the line filter returns it. If the
    /// line is valid, the next line becomes the expected one.
    #[inline]
    pub fn finish(&mut self, text: &[u8]) -> Verdict {
        if self.looks_at_end() { self.finish_checked(text) } else { Verdict::Valid }
    }

    #[inline(never)]
    fn finish_checked(&mut self, text: &[u8]) -> Verdict {
        let Some(wanted) = self.wanted else {
            return if core::mem::take(&mut self.aborted) { Verdict::Damaged } else { Verdict::Valid };
        };
        let line = self.clone();
        self.clear();
        if line.place == 0 && line.is_whole {
            return Verdict::Known;
        }
        // `$LC=ON` and `$LC=OFF` may be plain lines, so that a host that does not use checksums can switch them off.
        let begins = text.strip_prefix(b"$LC=ON").is_some_and(is_session);
        if (begins || text == b"$LC=OFF") && line.place == text.len() as u16 {
            return Verdict::Valid;
        }
        let length = line.place.wrapping_sub(HEADER_END);
        let is_whole = line.is_whole && line.place >= HEADER_END && length as u8 == line.length;
        if !is_whole || line.crc.value() != line.sum {
            return Verdict::Damaged;
        }
        let behind = line.behind();
        if behind == 0 && self.failed.is_none() {
            self.wanted = Some(wanted.wrapping_add(1));
            return Verdict::Valid;
        }
        if (1..=NUMBERS / 2).contains(&behind) { Verdict::Known } else { Verdict::Damaged }
    }

    /// Returns the answer `text` with a checksum and the number of the expected line added; `None` while checksums
    /// are off.
    pub fn answer(&self, text: &[u8]) -> Option<Text> {
        let number = self.wanted?;
        let text = text.strip_suffix(END).unwrap_or(text);
        let mut out = Text::new();
        put(&mut out, b":");
        digits(&mut out, number, NUMBER);
        digits(&mut out, text.len() as u32, LENGTH);
        let mut crc = self.session.check(number);
        out.iter().skip(NUMBER_END.into()).chain(text).for_each(|byte| crc.add(*byte));
        digits(&mut out, crc.value(), SUM);
        put(&mut out, text);
        put(&mut out, END);
        Some(out)
    }
}

/// Appends the last `count` hexadecimal digits of a value.
fn digits(out: &mut Text, value: u32, count: usize) {
    for place in (0..count).rev() {
        let digit = DIGITS.get((value >> (4 * place) & 15) as usize).unwrap_or(&b' ');
        put(out, &[*digit]);
    }
}

/// CRC-32 of IEEE 802.3, computed without a table, and without the final inversion (`JAMCRC`): so further bytes can
/// be added to a result.
const JAMCRC: crc::Crc<u32, crc::NoTable> = crc::Crc::<u32, crc::NoTable>::new(&crc::CRC_32_JAMCRC);

/// The CRC of the bytes so far, before the final inversion.
#[derive(Clone, Copy, Debug)]
struct Crc(u32);

impl Crc {
    const START: Self = Self(u32::MAX);

    #[inline]
    fn add(&mut self, byte: u8) {
        // The `crc` crate expects the bits of the initial value in reverse order.
        let mut digest = JAMCRC.digest_with_initial(self.0.reverse_bits());
        digest.update(&[byte]);
        self.0 = digest.finalize();
    }

    fn value(self) -> u32 {
        !self.0
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::messages::{LineByte, Realtime};
    use crate::protocol::intake::LineIntake;
    use crate::protocol::line_filter::{LENGTH as LONGEST, LineRules, Pushed};
    use crate::protocol::realtime::{Received, command};
    use proptest::prelude::*;

    fn crc(bytes: impl IntoIterator<Item = u8>) -> u32 {
        let mut crc = Crc::START;
        bytes.into_iter().for_each(|byte| crc.add(byte));
        crc.value()
    }

    /// Returns a line with checksum, without letters of a session, as a host sends it. Has no line end.
    fn line(number: u16, text: &str) -> Vec<u8> {
        line_of("", number.into(), text)
    }

    /// Returns a line with checksum as a host sends it, without line end. `session`: the four letters after `$LC=ON`,
    /// or empty.
    fn line_of(session: &str, number: u32, text: &str) -> Vec<u8> {
        let letter = |character: u8| SUBSTITUTES.iter().find(|(_, c)| *c == character).map_or(character, |(l, _)| *l);
        let text: Vec<u8> = text.bytes().map(letter).collect();
        let letters = |value: u32, count: usize| {
            let mut letters = Text::new();
            digits(&mut letters, value, count);
            letters.to_vec()
        };
        let (number, whole) = (letters(number, NUMBER), letters(number, 8));
        let length = letters(text.len() as u32, super::LENGTH);
        let before = if session.is_empty() { number.clone() } else { [session.as_bytes(), &whole].concat() };
        let sum = letters(crc([before, length.clone(), text.clone()].concat()), SUM);
        [b":", number.as_slice(), &length, &sum, &text].concat()
    }

    /// A host whose bytes pass through the same code as on a board: realtime commands are picked out, and the rest goes
    /// to the intake.
    struct Host {
        intake: LineIntake,
        epoch: u16,
        taken: Vec<String>,
        commands: Vec<Realtime>,
        answers: Vec<Verdict>,
    }

    impl Host {
        fn new() -> Self {
            Self::of("")
        }

        fn of(session: &str) -> Self {
            let mut intake = LineIntake::new();
            intake.begin_check(session.as_bytes());
            Self { intake, epoch: 0, taken: Vec::new(), commands: Vec::new(), answers: Vec::new() }
        }

        fn send(&mut self, bytes: &[u8]) -> &mut Self {
            let rules = || LineRules {
                length: LONGEST,
                merge_crlf: true,
                nested_comments: false,
                expressions: true,
                block_delete: false,
            };
            for byte in bytes {
                let byte = match Received::of(*byte) {
                    Received::Realtime(command) => {
                        self.commands.push(command);
                        self.epoch += u16::from(command.opens_epoch());
                        match command {
                            Realtime::Reset | Realtime::Stop => {
                                self.intake.reset();
                                self.intake.abort_check();
                            }
                            Realtime::JogCancel => self.intake.cancel_jogs(),
                            _ => {}
                        }
                        continue;
                    }
                    Received::Line(byte) => LineByte { byte, epoch: self.epoch, damaged: false },
                    Received::Nothing => continue,
                };
                if self.intake.take_plain(byte) {
                    continue;
                }
                let taken = self.intake.take(byte, rules);
                if taken.pushed == Pushed::More {
                    continue;
                }
                self.answers.push(taken.verdict);
                if taken.verdict == Verdict::Valid {
                    assert_eq!(taken.pushed, Pushed::Complete);
                    self.taken.push(String::from_utf8(self.intake.text().to_vec()).unwrap());
                }
                self.intake.clear();
            }
            self
        }

        fn line(&mut self, number: u16, text: &str) -> &mut Self {
            self.line_of("", number.into(), text)
        }

        fn line_of(&mut self, session: &str, number: u32, text: &str) -> &mut Self {
            self.send(&[line_of(session, number, text).as_slice(), b"\n"].concat())
        }
    }

    use Verdict::{Damaged, Known, Valid};

    #[test]
    fn lines_run_in_their_order_and_once() {
        let mut host = Host::new();
        host.line(0, "G0 X1").line(1, "G1X18Y-9.1F800").line(1, "G1X18Y-9.1F800").line(0, "G0 X1");
        host.line(3, "M5").line(2, "M3").line(4, "M8").line(3, "").line(4, "#1=[1 GT 8]%");
        assert_eq!(host.taken, ["G0X1", "G1X18Y-9.1F800", "M3", "", "#1=[1GT8]%"]);
        assert_eq!(host.answers, [Valid, Valid, Known, Known, Damaged, Valid, Damaged, Valid, Valid]);
    }

    #[test]
    fn numbers_wrap() {
        let mut host = Host::new();
        for round in 0..3 {
            for number in 0..NUMBERS {
                host.line(number, &format!("N{number}")).line(number, &format!("N{number}"));
                assert_eq!(host.taken.len(), usize::from(number) + 1 + round * usize::from(NUMBERS));
            }
        }
    }

    /// A line of an earlier round of 4096 numbers, or of another session, is refused, however late it arrives.
    #[test]
    fn no_line_of_another_session_or_round_passes() {
        let mut host = Host::of("QKXW");
        let mut lines: u32 = 0;
        let mut go_on = |host: &mut Host, to: u32| {
            for number in lines..to {
                host.line_of("QKXW", number, "G91G1X1");
            }
            lines = to;
            assert_eq!(host.taken.len(), to as usize);
        };
        for late in [0, 1, 2047, 2048, 4095] {
            go_on(&mut host, 4096 + late);
            host.answers.clear();
            host.line_of("QKXW", late, "G91G1X1").line_of("QKXX", 4096 + late, "G91G1X1").line(late as u16, "G91G1X1");
            assert_eq!(host.answers, [Damaged; 3], "{late}");
            assert_eq!(host.taken.len(), 4096 + late as usize, "{late}");
        }
        go_on(&mut host, 70_000);
        host.line_of("QKXW", 69_999, "G91G1X1").line_of("QKXW", 70_000 - 65_536, "G91G1X1");
        assert_eq!(host.answers[host.answers.len() - 2..], [Known, Damaged]);
        // A line of this session is refused in the next session.
        host.send(b"$LC=ONABCD\n");
        host.intake.begin_check(b"ABCD");
        host.answers.clear();
        host.line_of("QKXW", 0, "G91G1X1").line_of("ABCD", 0, "G90");
        assert_eq!((&host.answers[..], host.taken.last().map(String::as_str)), (&[Damaged, Valid][..], Some("G90")));
    }

    #[test]
    fn a_session_has_four_letters_or_none() {
        for (text, is) in
            [("", true), ("QKXW", true), ("QKX", false), ("QKXWA", false), ("QK1W", false), ("qkxw", false)]
        {
            assert_eq!(is_session(text.as_bytes()), is, "{text}");
        }
        // `$LC=ON` and `$LC=OFF` are accepted without a checksum, so that a host that sends plain lines can switch
        // checksums off. `$LC=ONAB` is refused, because the letters after `ON` must be four, or be left out.
        let mut host = Host::of("QKXW");
        host.send(b"$LC=ON\n$LC=ONABCD\n$LC=OFF\n$LC=ONAB\n");
        assert_eq!(host.answers, [Valid, Valid, Valid, Damaged]);
    }

    #[test]
    fn a_plain_line_is_refused_and_an_empty_one_is_a_question() {
        let mut host = Host::new();
        host.send(b"G0X1\n\n\r\n$LC=OFFX\n $LC=OFF\n;\n");
        assert_eq!(host.answers, [Damaged, Known, Known, Damaged, Damaged, Damaged]);
        host.send(b"$LC=OFF\n$lc=on\n");
        assert_eq!(host.taken, ["$LC=OFF", "$LC=ON"]);
        // A CR before the header of a line and an LF after the header are not a CR LF. So the LF ends line 0, which has
        // no text.
        host.send(b"\r").line(0, "").line(1, "M5");
        assert_eq!(host.taken, ["$LC=OFF", "$LC=ON", "", "M5"]);
    }

    #[test]
    fn nothing_runs_behind_a_line_that_was_refused() {
        let mut host = Host::new();
        host.line(0, "G0X1").line(1, "G0XX");
        host.intake.fail(Error::BadNumber);
        host.intake.fail(Error::DamagedLine);
        host.line(2, "G0X2").line(1, "G0XX").send(b"\n");
        assert_eq!(host.answers, [Valid, Valid, Damaged, Known, Known]);
        assert_eq!(host.intake.failed(), Some(Error::BadNumber));
        host.intake.begin_check(b"");
        host.line(0, "G0X3");
        assert_eq!((host.taken.last().map(String::as_str), host.intake.failed()), (Some("G0X3"), None));
    }

    #[test]
    fn answers_have_the_form_of_lines() {
        let mut check = LineChecksum::OFF;
        assert_eq!(check.answer(b"ok\r\n"), None);
        check.begin(b"");
        let answer = check.answer(b"error:20\r\n").unwrap();
        // The CRC in this answer was computed with Python's `binascii.crc32`.
        assert_eq!(answer.as_slice(), b":AAAASPHeiNeGNerror:20\r\n");
        assert_eq!(crc(*b"123456789"), 0xCBF4_3926, "the check value of CRC-32");
    }

    /// Returns whether one damaged bit can turn a byte into a command that moves, stops or switches anything.
    fn is_near_a_command(byte: u8) -> bool {
        (0..8).any(|bit| command(byte ^ (1 << bit)).is_some_and(|command| command != Realtime::Status))
    }

    #[test]
    fn one_damaged_bit_makes_no_command_of_a_byte() {
        let capitals: String = (b' '..=b'_').filter(|c| command(*c).is_none() && *c != b'^').map(char::from).collect();
        let written = line(0x5A5, &capitals);
        for byte in written.iter().chain(DIGITS) {
            assert!(!is_near_a_command(*byte), "{}", char::from(*byte));
        }
        for (_, character) in SUBSTITUTES {
            assert!(is_near_a_command(character), "{} needs no other letter", char::from(character));
        }
        for (n, one) in DIGITS.iter().enumerate() {
            let is_near = |byte: u8, ends: &[u8]| ends.iter().any(|end| (end ^ byte).count_ones() < 2);
            assert!(!is_near(*one, &DIGITS[n + 1..]) && !is_near(*one, b"\r\n"), "{}", char::from(*one));
        }
    }

    /// One or two damaged bits anywhere in a line, including its end, never let a wrong line pass.
    #[test]
    fn no_two_damaged_bits_pass() {
        let first = [line(0, "G1X-98.1J2"), b"\n".to_vec()].concat();
        let second = [line(1, "M5"), b"\n".to_vec()].concat();
        let bits = first.len() * 8;
        for one in 0..bits {
            for other in one..bits {
                let mut damaged = first.clone();
                damaged[one / 8] ^= 1 << (one % 8);
                if other != one {
                    damaged[other / 8] ^= 1 << (other % 8);
                }
                let mut host = Host::new();
                host.send(&damaged).send(&second);
                let is_reset = host.commands.iter().any(|command| matches!(command, Realtime::Reset | Realtime::Stop));
                if is_reset {
                    // The rest of the line is refused. After that, checksums are off, so a line that begins with a
                    // colon is an error.
                    assert!(host.taken.iter().all(|text| text.starts_with(':')), "{one} {other}: {:?}", host.taken);
                    continue;
                }
                assert_eq!(host.taken, [""; 0], "bits {one} and {other}");
                let acts = host.commands.iter().any(|command| *command != Realtime::Status);
                assert!(other != one || !acts, "bit {one}: {:?}", host.commands);
                // When the host sends both lines again, they are executed.
                host.send(b"\n").send(&first).send(&second);
                let again: Vec<&str> = host.taken.iter().map(String::as_str).collect();
                assert_eq!(again, ["G1X-98.1J2", "M5"], "bits {one} and {other}");
            }
        }
    }

    /// Up to four damaged bits are detected. The sum is written in letters that differ from each other in two or more
    /// bits. So two damaged bits are needed to change one digit of the sum, and then only two bits remain for the
    /// covered bytes (number, length and text). The test shows that one or two damaged bits in the covered bytes change
    /// more than one digit of the sum. It also shows that three or four such bits always change the sum.
    #[test]
    fn no_four_damaged_bits_pass() {
        const COVERED: usize = NUMBER + super::LENGTH + 250;
        let zeros = crc([0; COVERED]);
        let single: Vec<u32> = (0..COVERED * 8)
            .map(|bit| crc((0..COVERED).map(|n| if n == bit / 8 { 1 << (bit % 8) } else { 0 })) ^ zeros)
            .collect();
        let in_one_digit = |difference: u32| (0..8).any(|digit| difference & !(15 << (4 * digit)) == 0);
        let mut all = single.clone();
        for (n, one) in single.iter().enumerate() {
            all.extend(single[..n].iter().map(|other| one ^ other));
        }
        assert!(!all.iter().any(|difference| in_one_digit(*difference)));
        // `all` contains the differences that one or two damaged bits cause. All of them are distinct, so no two of
        // them cancel out. Therefore three or four damaged bits always cause a difference, too.
        let count = all.len();
        all.sort_unstable();
        all.dedup();
        assert_eq!(all.len(), count);
    }

    proptest! {
        /// A line of one session is never valid in another. The letters of the two sessions differ, and for the CRC
        /// that is a burst of at most 32 bits, which it always detects.
        #[test]
        fn no_line_of_another_session_passes(
            [session, other] in prop::array::uniform2("[A-Z]{4}"), text in "[A-Z0-9.]{0,60}", number in 0..3_u32,
        ) {
            prop_assume!(session != other);
            let mut host = Host::of(&session);
            for number in 0..number {
                host.line_of(&session, number, "M5");
            }
            host.answers.clear();
            host.line_of(&other, number, &text).line_of("", number, &text).line_of(&session, number, &text);
            prop_assert_eq!(&host.answers, &[Damaged, Damaged, Valid]);
        }

        #[test]
        fn no_burst_passes(text in "[A-Z0-9.]{8,250}", at in 0..1968_usize, length in 1..=32_usize, burst: u32) {
            let mut written = line(0, &text);
            let first = HEADER_END as usize * 8;
            let at = first + at % (written.len() * 8 - first - length);
            for bit in (0..length).filter(|bit| *bit == 0 || *bit == length - 1 || burst >> bit & 1 != 0) {
                written[(at + bit) / 8] ^= 1 << ((at + bit) % 8);
            }
            let mut check = LineChecksum::OFF;
            check.begin(b"");
            for byte in written {
                check.take(byte);
            }
            prop_assert_eq!(check.finish(b"text"), Damaged);
        }

        /// Whatever arrives, only lines that were sent are executed, in order and each once.
        #[test]
        fn nothing_else_runs(
            order in prop::collection::vec(0..6_u16, 1..40),
            edits in prop::collection::vec((0..400_usize, 0..3_u8, prop::sample::select(b"ABDGHKNPSUVZcefi:lb08GXZ.-\n".to_vec())), 0..6),
        ) {
            let texts = ["G1X1.98", "G0Y-8", "G91", "G1Z-0.25F100", "G90", "M5"];
            let mut bytes: Vec<u8> =
                order.iter().flat_map(|n| [line(*n, texts[usize::from(*n)]).as_slice(), b"\n"].concat()).collect();
            for (at, kind, byte) in edits {
                let at = at % bytes.len();
                match kind {
                    0 if bytes.len() > 1 => {
                        bytes.remove(at);
                    }
                    1 => bytes.insert(at, byte),
                    _ => bytes[at] = byte,
                }
            }
            let mut host = Host::new();
            host.send(&bytes);
            prop_assert!(host.taken.len() <= texts.len());
            prop_assert_eq!(&host.taken[..], &texts[..host.taken.len()]);
        }
    }

    /// If a byte of a line has become a reset, the rest of the line is not executed.
    #[test]
    fn nothing_runs_behind_a_reset_in_mid_line() {
        for reset in [0x18, 0x19] {
            let mut damaged = line(7, "G1X20Z-5");
            for at in 0..damaged.len() {
                let byte = core::mem::replace(&mut damaged[at], reset);
                let mut host = Host::new();
                host.line(0, "G90").send(&damaged).send(b"\nG4P1\n");
                assert_eq!(
                    (&host.taken[..], &host.answers[..]),
                    (&["G90".into(), "G4P1".into()][..], &[Valid, Damaged, Valid][..])
                );
                damaged[at] = byte;
            }
        }
        // The reset button is pressed while the text of the line is still to be received.
        let mut host = Host::new();
        let whole = line(7, "G0Z-5");
        host.send(&whole[..14]);
        host.intake.drop_received(0);
        host.intake.abort_check();
        host.intake.clear();
        host.send(&whole[14..]).send(b"\nG4P1\n");
        assert_eq!((&host.taken[..], &host.answers[..]), (&["G4P1".into()][..], &[Damaged, Valid][..]));
    }
}
