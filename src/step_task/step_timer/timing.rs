//! Times of the step task in ticks of the step clock, derived from the board's profile. For example: the delay before
//! the first tick of a motion, how far ahead events are generated, and how late a motion can still be resumed.

use crate::boards::{CORE_HZ, PROFILE, RUN_CYCLES};

/// Step-clock ticks per microsecond.
pub const TICKS_PER_US: u32 = PROFILE.step_clock_hz / 1_000_000;

/// Converts CPU cycles to step-clock ticks, rounded up.
const fn in_ticks(cycles: u32) -> u32 {
    cycles.div_ceil(CORE_HZ / 1_000_000 / TICKS_PER_US)
}

/// Time from the first segment after rest to its first tick. The first segments of an abrupt start take about 50 us
/// each, which is less than the step task needs to prepare the next segment. So several segments must be ready before
/// the first begins.
pub const START_TICKS: u32 = 2_000 * TICKS_PER_US;
/// How long in advance events are generated, if the queue of events has room.
pub const HORIZON_TICKS: u32 = 300 * TICKS_PER_US;
/// Time before a motion's first tick at which the generation of its events begins. An abrupt start has many short
/// segments, so each of the first runs begins a segment and generates few events.
pub const PREPARE_TICKS: u32 = 450 * TICKS_PER_US;
/// Minimum number of queued events, even if fewer would last for [`HORIZON_TICKS`].
pub const LEAST_EVENTS: usize = 4;
/// Maximum number of events that a run of the step task generates. A longer run would delay everything else, including
/// a stop from the serial line.
pub const MOST_EVENTS: usize = 32;
/// Maximum duration of a run of the step task that generates events, from its reading of the clock to its last event.
pub const RUN_TICKS: u32 = in_ticks(RUN_CYCLES);
/// Maximum duration of the start of the output.
pub const BEGIN_TICKS: u32 = in_ticks(1_500);
/// A run of the step task starts the output of a motion if it finds at most this much time left before the first tick:
/// enough for two runs, a pause between them, and the start itself.
pub const IN_TIME_TICKS: u32 = 2 * RUN_TICKS + BEGIN_TICKS + PAUSE_TICKS;
/// Additional time for a motion that starts from rest: its output is started when this time plus `IN_TIME_TICKS` is
/// left, because masked interrupts can delay the run of the step task that starts the output.
pub const SPARE_TICKS: u32 = 100 * TICKS_PER_US;
/// Minimum pause after a run of the step task until its next scheduled run. Other tasks run in this pause.
pub const PAUSE_TICKS: u32 = RUN_TICKS / 4;
/// Time until the next attempt to send a report, if the machine is at rest and the queue to `control` had no room.
pub const RETRY_TICKS: u32 = 1_000 * TICKS_PER_US;
/// Time from the end of the last pulse of a motion until the event of this pulse counts as output.
pub const OUT_TICKS: u32 = 2 * TICKS_PER_US;
/// After late events, the motion is resumed only if its next tick is late by at most the time of this many steps.
/// Meanwhile no steps come, but the motors continue to turn. With eight or more microsteps per full step, they stay
/// less than a full step ahead of their magnetic field.
pub const MOST_LATE_STEPS: u32 = 8;
