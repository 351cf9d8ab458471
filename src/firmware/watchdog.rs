//! `Supervisor` sees to it that every task still does its work: it asks step, serial and control ten times a second
//! (`PERIOD`), and feeds the hardware `Watchdog` only when all have answered. A task `unanswered` for longer than
//! `PATIENCE` is `stuck`, which is a failure. `ASKED`, `STEP_ASKED` and `wants` are loaded and stored `Relaxed`.
//!
//! ```text
//!  step, serial, control ──each run wipes its mark out──┐
//!  inputs, every 100 ms: all wiped? feed; mark again and call them
//!  half a second without `control`: outputs safe, record, reset       one of the others, or `inputs` itself: the hardware
//! ```
//! A task that hangs in an endless loop keeps those of lower priority from running: `control` is caught here, the others
//! by the hardware, after its own time. Time is counted in samples of `inputs`, so that a processor that stood still (an
//! erase of flash) blames no task.

use crate::boards::{self, SAMPLE_HZ, Watchdog};
use crate::failure;
use crate::shared::{ASKED, STEP, STEP_ASKED, Wake};
use core::sync::atomic::Ordering;
use oxmill_controller::messages::CrashKind;

/// Samples between two questions: 100 ms.
const PERIOD: u32 = SAMPLE_HZ / 10;
/// Questions that may go unanswered one after the other.
const PATIENCE: u32 = 5;

/// What `inputs` owns of it.
pub struct Supervisor {
    watchdog: Watchdog,
    samples: u32,
    unanswered: u32,
}

impl Supervisor {
    /// Starts the hardware watchdog, which cannot be stopped again.
    pub fn new(mut watchdog: Watchdog) -> Supervisor {
        watchdog.start();
        Supervisor { watchdog, samples: 0, unanswered: 0 }
    }

    /// One sample of `inputs` has passed.
    #[inline]
    pub fn sample(&mut self, wake: &mut Wake) {
        self.samples += 1;
        if self.samples >= PERIOD {
            self.samples = 0;
            self.ask(wake);
        }
    }

    fn ask(&mut self, wake: &mut Wake) {
        let stuck = if STEP.wants.load(Ordering::Relaxed) == STEP_ASKED {
            Some("step")
        } else if ASKED.serial.load(Ordering::Relaxed) {
            Some("serial")
        } else if ASKED.control.load(Ordering::Relaxed) {
            Some("control")
        } else {
            None
        };
        match stuck {
            None => {
                self.unanswered = 0;
                self.watchdog.feed();
            }
            Some(task) => {
                self.unanswered += 1;
                if self.unanswered >= PATIENCE {
                    failure::fail(CrashKind::Stuck, format_args!("{task}"));
                }
            }
        }
        STEP.wants.store(STEP_ASKED, Ordering::Relaxed);
        boards::call_step();
        // The other order would mark one that has answered already.
        ASKED.serial.store(true, Ordering::Relaxed);
        boards::call_serial();
        ASKED.control.store(true, Ordering::Relaxed);
        wake.write(());
    }
}
