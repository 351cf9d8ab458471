//! The times that the step task keeps, in ticks of the step clock: from the first segment to its first tick, how far
//! ahead events are made, what a run takes, and how late a motion may be resumed. All follow from the board's profile.

use crate::boards::{CORE_HZ, PROFILE, RUN_CYCLES};

/// Step-clock ticks in a microsecond.
pub const TICKS_PER_US: u32 = PROFILE.step_clock_hz / 1_000_000;

/// Cycles of the core in step-clock ticks, rounded up.
const fn in_ticks(cycles: u32) -> u32 {
    cycles.div_ceil(CORE_HZ / 1_000_000 / TICKS_PER_US)
}

/// From the first segment after a rest to its first tick: the first segments of a hard start last some 50 us each, less than
/// it takes to prepare the next, so that some must be there before the first begins.
pub const START_TICKS: u32 = 2_000 * TICKS_PER_US;
/// How far ahead events are made, where there is room.
pub const HORIZON_TICKS: u32 = 300 * TICKS_PER_US;
/// How long before its first tick the events of a motion begin to be made: a hard start has so many segments that each of the
/// first runs begins one and makes few events.
pub const PREPARE_TICKS: u32 = 450 * TICKS_PER_US;
/// No fewer events than these are ahead, however long they last.
pub const LEAST_EVENTS: usize = 4;
/// Most events of a run: the longer it takes, the later everything else, a stop that comes by the serial line among it.
pub const MOST_EVENTS: usize = 32;
/// More than a run takes from its look at the time to its last event.
pub const RUN_TICKS: u32 = in_ticks(RUN_CYCLES);
/// More than it takes to begin.
pub const BEGIN_TICKS: u32 = in_ticks(1_500);
/// How long before the first moment events are begun at the latest: two more runs and what it takes.
pub const IN_TIME_TICKS: u32 = 2 * RUN_TICKS + BEGIN_TICKS + PAUSE_TICKS;
/// So much earlier from rest, for interrupts may be masked meanwhile.
pub const SPARE_TICKS: u32 = 100 * TICKS_PER_US;
/// From the end of a run to the next that it asks for at least: time for other tasks.
pub const PAUSE_TICKS: u32 = RUN_TICKS / 4;
/// How soon to try again to report to `control`, when nothing else calls.
pub const RETRY_TICKS: u32 = 1_000 * TICKS_PER_US;
/// From the last event of a motion to where it is seen that it is out, beside its pulse.
pub const OUT_TICKS: u32 = 2 * TICKS_PER_US;
/// A motion whose events came too late is resumed if its next tick is put off by no more than the time of so many steps: motors run
/// on meanwhile, and with eight microsteps or more to a full step they are not a full step ahead of the field then.
pub const MOST_LATE_STEPS: u32 = 8;
