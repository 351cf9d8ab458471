//! The time: `Clock::now` in microseconds, counted from the board's `clock_ticks` with `seen`. And the alarm clock of
//! `control`: `set_alarm` for a moment, at most the `LONGEST_SLEEP` ahead, kept in the atomics `ALARM_AT` and
//! `ALARM_SET`; the input task asks `alarm` whether it is time.
//!
//! The board counts ticks in 32 bits; `control` is the only one that asks for the time and sees to it that it asks often
//! enough to notice every wrap. The alarm is looked at by the sampling of the inputs, so it needs no timer of its own
//! and is late by at most one sample.

use crate::boards;
use core::sync::atomic::{AtomicBool, AtomicU32, Ordering};
use oxmill_controller::units::{Duration, Instant};

/// Longest time between two questions: far below the wrap of the fastest board clock (25 MHz: 171 s).
const LONGEST_SLEEP: Duration = Duration::from_ticks(10_000_000);

const NOW: Duration = Duration::from_ticks(0);

static ALARM_AT: AtomicU32 = AtomicU32::new(0);
static ALARM_SET: AtomicBool = AtomicBool::new(false);

/// The time since power-up.
pub struct Clock {
    /// Ticks at the last question, and those of them that do not make a microsecond.
    seen: u32,
    rest: u32,
    micros: u64,
}

impl Clock {
    /// Begins at 0.
    pub fn new() -> Clock {
        Clock { seen: boards::clock_ticks(), rest: 0, micros: 0 }
    }

    /// The time.
    pub fn now(&mut self) -> Instant {
        let ticks = boards::clock_ticks();
        // In 32 bits, by a constant: no division.
        let passed = ticks.wrapping_sub(self.seen).wrapping_add(self.rest);
        self.seen = ticks;
        let micros = passed / boards::CLOCK_TICKS_PER_US;
        self.rest = passed - micros * boards::CLOCK_TICKS_PER_US;
        self.micros += u64::from(micros);
        Instant::from_ticks(self.micros)
    }

    /// Sets the alarm; without a moment it still goes off before the counter wraps.
    pub fn set_alarm(&mut self, at: Option<Instant>) {
        let now = self.now();
        let sleep = at.map_or(LONGEST_SLEEP, |at| at.checked_duration_since(now).unwrap_or(NOW).min(LONGEST_SLEEP));
        let ticks = (sleep.ticks() * u64::from(boards::CLOCK_TICKS_PER_US)) as u32;
        ALARM_SET.store(false, Ordering::Relaxed);
        ALARM_AT.store(self.seen.wrapping_add(ticks), Ordering::Relaxed);
        ALARM_SET.store(true, Ordering::Release);
    }
}

/// Whether the alarm has gone off; true once. For `inputs`, which preempts `control`.
pub fn alarm() -> bool {
    let off = ALARM_SET.load(Ordering::Acquire)
        && boards::clock_ticks().wrapping_sub(ALARM_AT.load(Ordering::Relaxed)) as i32 >= 0;
    if off {
        ALARM_SET.store(false, Ordering::Relaxed);
    }
    off
}
