//! A host inside the machine: it plays a `Script` from PSRAM that says what is sent to the firmware, and what has to be
//! waited for in virtual time: answers, a delay, or a report that says Idle.
//!
//! A host outside lives in real time, and where the machine is when its byte arrives depends on what else the processor
//! does. This one sends its bytes at the same instruction in every run. It looks at the board whenever nothing else is to
//! be done, at least at every SysTick.
//!
//! | code | operands (little-endian) | |
//! |---|---|---|
//! | `S` | length `u16`, bytes | sends all of them at once |
//! | `A` | count `u32` | waits for so many answers (`ok`, `error:`) since the last `R`, at most two minutes |
//! | `W` | milliseconds `u32` | waits |
//! | `I` | milliseconds `u32` | asks `?` with pauses of so much until the answer is `<Idle`, at most 4000 times |
//! | `R` | | a record ends: tells the test stand how many bytes have been said so far |
//! | `N` | | a record ends: tells that, the machine time, the steps of the motors and the stack |
//! | `E` | milliseconds `u32` | the script ends here if the machine has run for so long |
//!
//! At its end the report of the test stand follows, and QEMU ends.

use super::clock_ticks;
use core::cell::{Cell, RefCell};
use cortex_m::peripheral::NVIC;
use critical_section::Mutex;
use mps2_pac::Interrupt;

/// Ticks of the step clock in a millisecond.
const TICKS_PER_MS: u32 = 25_000;
/// Longest wait for answers.
const PATIENCE: u32 = 120_000 * TICKS_PER_MS;
/// Most questions in a wait for Idle.
const MOST_QUESTIONS: u32 = 4_000;
/// Bytes of a line's beginning that tell what it is.
const HEAD: usize = 6;

/// Bytes that wait to be received.
static WAITING: Mutex<Cell<&'static [u8]>> = Mutex::new(Cell::new(&[]));

/// The next byte that the script sends.
pub fn receive() -> Option<u8> {
    critical_section::with(|cs| {
        let waiting = WAITING.borrow(cs);
        let (byte, rest) = waiting.get().split_first()?;
        waiting.set(rest);
        Some(*byte)
    })
}

fn send(bytes: &'static [u8]) {
    critical_section::with(|cs| WAITING.borrow(cs).set(bytes));
    NVIC::pend(Interrupt::UART0_RX);
}

/// What the firmware has said.
struct Said {
    bytes: u32,
    head: [u8; HEAD],
    length: usize,
    answers: u32,
    reports: u32,
    idle: bool,
}

static SAID: Mutex<RefCell<Said>> =
    Mutex::new(RefCell::new(Said { bytes: 0, head: [0; HEAD], length: 0, answers: 0, reports: 0, idle: false }));

/// A byte that the firmware says.
pub fn hear(byte: u8) {
    critical_section::with(|cs| {
        let said = &mut *SAID.borrow_ref_mut(cs);
        said.bytes += 1;
        match byte {
            b'\r' => {}
            b'\n' => {
                let line = &said.head[..said.length.min(HEAD)];
                if line == b"ok" || line == b"error:" {
                    said.answers += 1;
                }
                if line.first() == Some(&b'<') {
                    said.reports += 1;
                    said.idle = line.starts_with(b"<Idle");
                }
                said.length = 0;
            }
            byte => {
                if let Some(place) = said.head.get_mut(said.length) {
                    *place = byte;
                }
                said.length += 1;
            }
        }
    });
}

/// What is being waited for.
#[derive(Clone, Copy)]
enum Wait {
    Nothing,
    Answers { count: u32, since: u32 },
    Until { since: u32, ticks: u32 },
    Report { before: u32, pause: u32, step: usize },
}

/// A script and how far it has been followed.
pub struct Script {
    text: &'static [u8],
    next: usize,
    wait: Wait,
    answers_before: u32,
    /// Asked since the record began.
    questions: u32,
    /// The step clock when it was looked at last, and its ticks since the start of the script.
    looked: u32,
    ticks: u64,
}

/// What the test stand has to do for the script.
pub enum Wanted {
    /// Nothing now.
    Nothing,
    /// To tell how many bytes have been said.
    Mark(u32),
    /// The same, with the time in ms since the script began, and all else that the test stand knows.
    Note(u32, u64),
    /// The script is at its end.
    End,
}

impl Script {
    /// At its beginning.
    pub fn new(text: &'static [u8]) -> Script {
        Script { text, next: 0, wait: Wait::Nothing, answers_before: 0, questions: 0, looked: clock_ticks(), ticks: 0 }
    }

    /// Advances as far as it can, at most to the end of a record.
    pub fn go_on(&mut self) -> Wanted {
        // The clock wraps after minutes; it is looked at much more often.
        let now = clock_ticks();
        self.ticks += u64::from(now.wrapping_sub(self.looked));
        self.looked = now;
        loop {
            let (bytes, answers, reports, idle) = critical_section::with(|cs| {
                let said = SAID.borrow_ref(cs);
                (said.bytes, said.answers, said.reports, said.idle)
            });
            match self.wait {
                Wait::Nothing => {}
                Wait::Answers { count, since }
                    if answers.wrapping_sub(self.answers_before) >= count
                        || clock_ticks().wrapping_sub(since) >= PATIENCE => {}
                Wait::Until { since, ticks } if clock_ticks().wrapping_sub(since) >= ticks => {}
                Wait::Report { before, pause, step } if reports != before => {
                    if !idle && self.questions < MOST_QUESTIONS {
                        // The same step once more.
                        self.next = step;
                        self.wait = Wait::Until { since: clock_ticks(), ticks: pause * TICKS_PER_MS };
                        continue;
                    }
                }
                _ => return Wanted::Nothing,
            }
            self.wait = Wait::Nothing;
            let step = self.next;
            if step >= self.text.len() {
                return Wanted::End;
            }
            match self.take(1) as u8 {
                b'S' => {
                    let length = self.take(2) as usize;
                    send(&self.text[self.next..self.next + length]);
                    self.next += length;
                }
                b'A' => self.wait = Wait::Answers { count: self.take(4), since: clock_ticks() },
                b'W' => self.wait = Wait::Until { since: clock_ticks(), ticks: self.take(4) * TICKS_PER_MS },
                b'I' => {
                    let pause = self.take(4);
                    self.wait = Wait::Report { before: reports, pause, step };
                    self.questions += 1;
                    send(b"?");
                }
                b'R' => {
                    self.answers_before = answers;
                    self.questions = 0;
                    return Wanted::Mark(bytes);
                }
                b'N' => {
                    self.answers_before = answers;
                    self.questions = 0;
                    return Wanted::Note(bytes, self.milliseconds());
                }
                b'E' => {
                    let least = u64::from(self.take(4));
                    if self.milliseconds() >= least {
                        return Wanted::End;
                    }
                }
                code => panic!("a script with the code {code}"),
            }
        }
    }

    fn milliseconds(&self) -> u64 {
        self.ticks / u64::from(TICKS_PER_MS)
    }

    /// A number of so many bytes, the lowest first.
    fn take(&mut self, bytes: usize) -> u32 {
        let number = &self.text[self.next..self.next + bytes];
        self.next += bytes;
        number.iter().rev().fold(0, |value, byte| value << 8 | u32::from(*byte))
    }
}
