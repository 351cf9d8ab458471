//! The time in microseconds, and the alarm clock of `control`.
//!
//! The board's tick counter has 32 bits. Only `control` reads this time, and often enough to notice each wrap of the
//! counter. The alarm needs no timer of its own: `inputs` checks it at each sample of the input pins. So it is late by
//! at most one sample.

use crate::boards;
use oxmill_controller::units::{Duration, Instant};
use rtic_sync::signal::{SignalReader, SignalWriter};

/// Maximum time, in us, between two readings of the clock. The fastest board clock (25 MHz) wraps after 171 s.
const LONGEST_SLEEP: Duration = Duration::from_ticks(10_000_000);

const NOW: Duration = Duration::from_ticks(0);

/// Counts the microseconds since power-up, with the board's tick counter.
pub struct Clock {
    /// Value of the board's tick counter when the time was last read.
    seen: u32,
    /// Ticks at the last reading that did not make a whole microsecond. The next reading adds them.
    rest: u32,
    /// Microseconds since power-up at the last reading.
    micros: u64,
    alarm: SignalWriter<'static, u32>,
}

impl Clock {
    /// Creates a clock that starts at 0. `alarm`: passes the time of the alarm, in ticks, to [`Alarm`].
    pub fn new(alarm: SignalWriter<'static, u32>) -> Clock {
        Clock { seen: boards::clock_ticks(), rest: 0, micros: 0, alarm }
    }

    /// Returns the time since power-up, and adds the ticks since the last call to it.
    pub fn now(&mut self) -> Instant {
        let ticks = boards::clock_ticks();
        // Compute in 32 bits, because the compiler then turns the division by a constant into a multiplication.
        let passed = ticks.wrapping_sub(self.seen).wrapping_add(self.rest);
        self.seen = ticks;
        let micros = passed / boards::CLOCK_TICKS_PER_US;
        self.rest = passed - micros * boards::CLOCK_TICKS_PER_US;
        self.micros += u64::from(micros);
        Instant::from_ticks(self.micros)
    }

    /// Sets the alarm to the time `at`. If `at` is `None` or further away than `LONGEST_SLEEP`, the alarm goes off
    /// after `LONGEST_SLEEP`, so that each wrap of the counter is noticed.
    pub fn set_alarm(&mut self, at: Option<Instant>) {
        let now = self.now();
        let sleep = at.map_or(LONGEST_SLEEP, |at| at.checked_duration_since(now).unwrap_or(NOW).min(LONGEST_SLEEP));
        let ticks = (sleep.ticks() * u64::from(boards::CLOCK_TICKS_PER_US)) as u32;
        self.alarm.write(self.seen.wrapping_add(ticks));
    }
}

/// The alarm of `control`, which `inputs` checks at each sample.
pub struct Alarm {
    set: SignalReader<'static, u32>,
    at: Option<u32>,
}

impl Alarm {
    /// Creates an alarm that is not set. `set`: receives the tick count of each new alarm from [`Clock::set_alarm`].
    pub fn new(set: SignalReader<'static, u32>) -> Alarm {
        Alarm { set, at: None }
    }

    /// Returns whether the alarm has gone off. Returns true only once for each alarm.
    #[inline(always)]
    pub fn goes_off(&mut self) -> bool {
        self.at = self.set.try_read().or(self.at);
        let is_due = self.at.is_some_and(|at| boards::clock_ticks().wrapping_sub(at) as i32 >= 0);
        if is_due {
            self.at = None;
        }
        is_due
    }
}
