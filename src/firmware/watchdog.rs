//! Checks that every task still runs. Ten times per second, `Supervisor` sets a mark for each of the tasks step, serial
//! and control, and calls the task, which clears its mark. It feeds the hardware watchdog only if all of them have
//! cleared their marks. A mark that is still set at five checks in a row is a failure.
//!
//! ```text
//!  step, serial, control ──each run clears its mark──┐
//!  inputs, every 100 ms: all cleared? feed; set the marks again and call the tasks
//!  `serial` or `control` stuck for half a second: outputs safe, record, reset      another task: the hardware resets
//! ```
//! A task in an endless loop blocks the tasks of lower priority. If that task is `serial` or `control`, the supervisor
//! still runs (`inputs` has a higher priority) and detects the failure. If it is another task, the hardware watchdog
//! resets the board after its own timeout. Time is counted in samples of `inputs`, so a stalled processor (an erase of
//! flash) does not count as a stuck task.

use crate::boards::{self, SAMPLE_HZ, Watchdog};
use crate::failure;
use crate::shared::{ASKED, STEP, STEP_ASKED, Wake};
use core::sync::atomic::Ordering;
use oxmill_controller::messages::CrashKind;

/// Number of samples between two checks: 100 ms.
const PERIOD: u32 = SAMPLE_HZ / 10;
/// Number of failed checks in a row after which a task counts as stuck.
const PATIENCE: u32 = 5;

/// Checks the other tasks and feeds the hardware watchdog; part of the task `inputs`.
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

    /// Counts a sample of `inputs`, and checks the tasks when 100 ms have passed.
    #[inline]
    pub fn sample(&mut self, wake: &mut Wake) {
        self.samples += 1;
        if self.samples >= PERIOD {
            self.samples = 0;
            self.ask(wake);
        }
    }

    fn ask(&mut self, wake: &mut Wake) {
        let stuck = if STEP.needs_message.load(Ordering::Relaxed) == STEP_ASKED {
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
        STEP.needs_message.store(STEP_ASKED, Ordering::Relaxed);
        boards::call_step();
        // Set the flag of a task before calling the task. In the opposite order, the task could run before its flag is
        // set, and the flag would remain set.
        ASKED.serial.store(true, Ordering::Relaxed);
        boards::call_serial();
        ASKED.control.store(true, Ordering::Relaxed);
        wake.write(());
    }
}
