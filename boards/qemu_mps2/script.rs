//! A host inside the machine. It executes a `Script` from PSRAM: the script sends bytes to the firmware, and waits in
//! virtual time for answers, for a delay to pass, or for an Idle status report.
//!
//! A host outside the machine runs in real time, so its bytes would arrive at different instructions in each run. This
//! host sends its bytes at the same instruction in every run. Whenever the processor is idle, and at least at every
//! SysTick, this host checks whether its wait is over.
//!
//! | code | operands (little-endian) | |
//! |---|---|---|
//! | `S` | length `u16`, bytes | sends all bytes at once |
//! | `A` | count `u32` | waits for `count` answers (`ok`, `error:`) since the last `R` or `N`, at most two minutes |
//! | `W` | milliseconds `u32` | waits |
//! | `I` | milliseconds `u32` | sends `?`, with pauses of this length, until the answer is `<Idle`; at most 4000 `?` |
//! | `R` | | ends a record (section of the script); the test stand gets the number of bytes sent by the firmware |
//! | `N` | | like `R`, but also reports the machine time, the motors' steps and the stack use |
//! | `E` | milliseconds `u32` | ends the script if the machine has run for at least this time |
//!
//! At the end of the script, the report of the steps is sent to the test stand, and QEMU exits.

use super::clock_ticks;
use core::cell::{Cell, RefCell};
use cortex_m::peripheral::NVIC;
use critical_section::Mutex;
use mps2_pac::Interrupt;

/// Ticks of the step clock in a millisecond.
const TICKS_PER_MS: u32 = 25_000;
/// Timeout of a wait for answers (`A`), in ticks of the step clock.
const PATIENCE: u32 = 120_000 * TICKS_PER_MS;
/// Maximum number of `?` in one record (section of the script) while waiting for Idle.
const MOST_QUESTIONS: u32 = 4_000;
/// Number of bytes kept from the beginning of a line, enough to identify its kind.
const HEAD: usize = 6;

/// Bytes of the script that the firmware has not received yet.
static WAITING: Mutex<Cell<&'static [u8]>> = Mutex::new(Cell::new(&[]));

/// Takes the next byte that the script has sent and the firmware has not received; `None` if there is none.
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

/// Counts of what the firmware has sent.
struct Said {
    bytes: u32,
    /// First bytes of the present line.
    head: [u8; HEAD],
    /// Length of the present line.
    length: usize,
    /// Number of answers: lines that are `ok` or begin with `error:`.
    answers: u32,
    /// Number of status reports.
    reports: u32,
    /// Whether the last status report was an Idle report.
    idle: bool,
}

static SAID: Mutex<RefCell<Said>> =
    Mutex::new(RefCell::new(Said { bytes: 0, head: [0; HEAD], length: 0, answers: 0, reports: 0, idle: false }));

/// Counts a byte that the firmware sends. At the end of a line, checks whether it was an answer or a status report.
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

/// What the script waits for before its next step. `since` is the start of the wait, and `ticks` is the length of the
/// wait, in ticks of the step clock. The rest belongs to a `Report`. `before` is the number of status reports before
/// the `?`. `pause` is the time until the next `?`, in milliseconds. `step` is the index in the script at which the
/// step with this `?` begins.
#[derive(Clone, Copy)]
enum Wait {
    Nothing,
    Answers { count: u32, since: u32 },
    Until { since: u32, ticks: u32 },
    Report { before: u32, pause: u32, step: usize },
}

/// A script and the progress in it.
pub struct Script {
    text: &'static [u8],
    next: usize,
    wait: Wait,
    /// Value of `Said::answers` when the present record (section of the script) began.
    answers_before: u32,
    /// Number of `?` sent in the present record (section of the script).
    questions: u32,
    /// Value of the step clock at the last call of [`Script::go_on`]; before the first call, at the start of the
    /// script.
    looked: u32,
    /// Ticks of the step clock since the start of the script.
    ticks: u64,
}

/// What the caller of [`Script::go_on`] must do for the script.
pub enum Wanted {
    /// Nothing: the script is waiting.
    Nothing,
    /// Report the number of bytes that the firmware has sent.
    Mark(u32),
    /// Report the number of bytes that the firmware has sent, the time in ms since the start of the script, the motors'
    /// steps and the stack.
    Note(u32, u64),
    /// The script has ended.
    End,
}

impl Script {
    /// Starts a script.
    pub fn new(text: &'static [u8]) -> Script {
        Script { text, next: 0, wait: Wait::Nothing, answers_before: 0, questions: 0, looked: clock_ticks(), ticks: 0 }
    }

    /// Executes the script until it has to wait, or to the end of a record (section of the script).
    pub fn go_on(&mut self) -> Wanted {
        // The step clock wraps every 172 s, so add up differences. This function is called much more often than that.
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
                        // Repeat this step, which sends `?`, after the pause.
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

    /// Takes a little-endian number of `bytes` bytes from the script.
    fn take(&mut self, bytes: usize) -> u32 {
        let number = &self.text[self.next..self.next + bytes];
        self.next += bytes;
        number.iter().rev().fold(0, |value, byte| value << 8 | u32::from(*byte))
    }
}
