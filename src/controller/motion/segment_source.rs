//! The output side of motion ([`SegmentSource`]): announces the running block, cuts it into segments, and hands them
//! over to the step task while less than [`QUEUED_TIME_MS`] is in flight. Brakes to a stop in a hold. A long interval
//! before a tick is divided into short waits, so that a hold is never late.

use super::backlash::{Backlash, Motors};
use super::block::{Block, OverrideFactors};
use super::in_flight::{InFlightSegment, SegmentsInFlight};
use super::jerk::PathState;
use super::jerk_segment;
use super::planner::Planner;
use super::running::{BlockStage, PathMotion, Running};
use super::segment::{self, Cut, Pacer};
use super::trapezoid::{Pace, greater, lesser, square_root};
use crate::lent::Lent;
use crate::messages::{Segment, ToStep, UNITS_PER_STEP};

/// Milliseconds of motion handed to the step task in advance (the segment buffer). This time bridges delays of the
/// control task. It is also the latency of a hold.
pub const QUEUED_TIME_MS: u32 = 16;
/// Intervals longer than this, ms, are divided into waits of [`WAIT_MS`], so that a hold need not wait for the tick.
const FAR_MS: u32 = 4;
/// Duration of each wait that a long interval is divided into, ms.
const WAIT_MS: u32 = 1;
/// Minimum time, ms, of a finished motion that must still be queued when the next motion starts. If less is queued, the
/// next motion waits until the step task is at rest. It then starts with several segments queued. Without this pause,
/// its first segments would be late, because they are shorter than the time in which a small processor prepares them.
const JOIN_MS: u32 = 2;
/// While motion continues and less than this time is queued, ms, making segments takes precedence over executing
/// program lines. The time is long enough to execute one line and then to make the segments of a stop.
const SHORT_MS: u32 = 8;
/// Duration of the segment that puts the step task to rest when there is nothing to brake, in microseconds.
const REST_US: u32 = 20;

/// State of the output side: whether segments are handed over to the step task, and whether a hold is in force.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum FeedState {
    /// Nothing is handed over: not started, or the queue has run empty.
    Idle,
    /// Segments are handed over.
    Running,
    /// Segments that brake to a stop are handed over.
    Braking,
    /// Stopped by a hold; nothing is handed over.
    Held,
}

/// A single tick with a long interval, and the part of this interval that has not been handed over yet (fixed point).
#[derive(Clone, Copy, Debug)]
struct LongTick {
    cut: Cut,
    time: u64,
}

/// Returns `clocks`, but at least 1, because a step clock below 1 MHz would give 0. (`Ord::max` is not `const`.)
const fn at_least_one(clocks: u32) -> u32 {
    if clocks == 0 { 1 } else { clocks }
}

/// The running block, and the segments handed over to the segment buffer.
#[derive(Debug)]
#[cfg_attr(feature = "alloc", derive(Clone))]
#[repr(C)]
pub(super) struct SegmentSource<const N: usize> {
    state: FeedState,
    /// Whether the last handed-over segment ends at rest.
    rest: bool,
    /// State of motion at the end of the last handed-over segment.
    pub(super) motion: PathMotion,
    pub(super) running: Running<N>,
    /// Position and lead of the motors at the start of the running block.
    block_start: Motors<N>,
    /// Position and lead of the motors where the machine was last at rest.
    last_rest: Motors<N>,
    long_tick: Option<LongTick>,
    step_clock_hz: u32,
    /// Step-clock ticks per millisecond and per microsecond, kept to avoid divisions.
    clocks_per_ms: u32,
    clocks_per_us: u32,
    pacer: Pacer,
    pub(super) in_flight: SegmentsInFlight<N>,
}

impl<const N: usize> SegmentSource<N> {
    /// Creates a source at rest, with nothing to hand over.
    pub(super) fn new(step_clock_hz: u32, ring: Lent<[InFlightSegment<N>]>) -> Self {
        Self {
            state: FeedState::Idle,
            rest: true,
            motion: PathMotion::REST,
            running: Running::NONE,
            block_start: Motors::ZERO,
            last_rest: Motors::ZERO,
            long_tick: None,
            step_clock_hz,
            clocks_per_ms: step_clock_hz / 1000,
            clocks_per_us: at_least_one(step_clock_hz / 1_000_000),
            pacer: Pacer::new(step_clock_hz),
            in_flight: SegmentsInFlight::new(ring),
        }
    }

    /// Sets the step clock's frequency (at least 10 kHz).
    pub(super) fn configure(&mut self, step_clock_hz: u32) {
        self.step_clock_hz = step_clock_hz.max(10_000);
        self.clocks_per_ms = self.step_clock_hz / 1000;
        self.clocks_per_us = at_least_one(self.step_clock_hz / 1_000_000);
        self.pacer = Pacer::new(self.step_clock_hz);
    }

    pub(super) fn step_clock_hz(&self) -> u32 {
        self.step_clock_hz
    }

    /// Returns the duration of the segments that the step task has not begun yet, in microseconds.
    #[inline]
    pub(super) fn queued_us(&self) -> u32 {
        self.in_flight.queued() / self.clocks_per_us
    }

    /// Returns whether the segments that the step task has not begun yet take at least `us` microseconds (at most 1 s).
    /// Needs no division.
    #[inline]
    pub(super) fn holds_time(&self, us: u32) -> bool {
        // The product fits 32 bits for up to 1 s, because `step_clock_hz` does.
        self.in_flight.queued() >= us.wrapping_mul(self.clocks_per_us)
    }

    /// Discards the running block; the machine is at rest with the motors at `motors`.
    pub(super) fn restart(&mut self, motors: Motors<N>) {
        self.running.stage = BlockStage::Nothing;
        self.long_tick = None;
        self.motion.stop();
        self.rest = true;
        self.block_start = motors;
        self.last_rest = motors;
    }

    /// Starts to hand segments over to the step task, unless a hold is in force.
    #[inline]
    pub(super) fn start(&mut self) {
        if self.state == FeedState::Idle {
            self.state = FeedState::Running;
        }
    }

    /// Begins a hold: brakes to a stop.
    pub(super) fn hold(&mut self) {
        if matches!(self.state, FeedState::Idle | FeedState::Running) {
            self.state = if self.rest { FeedState::Held } else { FeedState::Braking };
        }
    }

    /// Ends a hold. `any`: `true` if there are moves left. Then segments are handed over again at once, otherwise only
    /// after the next start.
    pub(super) fn resume(&mut self, any: bool) {
        self.state = if any { FeedState::Running } else { FeedState::Idle };
    }

    /// Hands over no more segments until the next start. Also ends a hold.
    #[inline]
    pub(super) fn stop(&mut self) {
        self.state = FeedState::Idle;
    }

    /// Call when the queue has run empty: no more segments are handed over until the next start. A hold stays in force.
    #[inline]
    pub(super) fn run_out(&mut self) {
        if self.state == FeedState::Running {
            self.state = FeedState::Idle;
        }
    }

    /// Returns whether a hold is in force and the last handed-over segment ends at rest.
    pub(super) fn is_held(&self) -> bool {
        self.state == FeedState::Held
    }

    /// Returns whether segments are handed over: motion is started, and not stopped by a hold.
    #[inline]
    pub(super) fn is_on(&self) -> bool {
        matches!(self.state, FeedState::Running | FeedState::Braking)
    }

    /// Returns whether the last handed-over segment ends at rest, so that there is no deadline for the next one.
    #[inline]
    pub(super) fn ends_at_rest(&self) -> bool {
        self.rest
    }

    /// Returns `true` if another message should be handed over to the step task. Conditions: motion is started, the
    /// machine is not stopped by a hold, and the segment buffer is not full.
    #[inline]
    pub(super) fn wants_more(&self) -> bool {
        self.is_on() && !self.in_flight.is_full() && self.in_flight.queued() < self.clocks_per_ms * QUEUED_TIME_MS
    }

    /// Returns `true` if the next motion must wait until the step task is at rest. That is so if the last motion ends
    /// at rest and less than [`JOIN_MS`] of it is still queued.
    #[inline]
    pub(super) fn waits_for_rest(&self) -> bool {
        self.rest && self.in_flight.moves() && self.in_flight.queued() < self.clocks_per_ms * JOIN_MS
    }

    /// Returns `true` if the step task may soon run out of segments: a motion is in progress, and the segments that the
    /// step task has not begun yet take only a short time ([`SHORT_MS`]).
    #[inline]
    pub(super) fn is_short_of_segments(&self) -> bool {
        let has_begun = self.in_flight.moves() || !self.in_flight.is_empty();
        has_begun
            && self.in_flight.queued() < self.clocks_per_ms * SHORT_MS
            && !self.in_flight.is_full()
            && !self.ends_at_rest()
    }

    /// Returns speed and acceleration along the path at the end of the last handed-over segment, and the distance from
    /// there to the end of the first block, mm.
    pub(super) fn path_state(&self, first: Option<&Block<N>>) -> (PathState, f32) {
        let millimetre = if self.running.is_active() { 1.0 / self.running.scale } else { 1.0 };
        let left = match first {
            Some(first) if !self.running.is_active() => first.length,
            _ => self.running.left() as f32 * millimetre,
        };
        let state = PathState { speed: self.motion.pace.speed * millimetre, acceleration: self.motion.acceleration };
        (state, left)
    }

    /// Changes the nominal speed of the running block, mm/s.
    pub(super) fn set_nominal(&mut self, nominal: f32) {
        let nominal = nominal * self.running.scale;
        let nominal2 = nominal * nominal;
        if nominal2 == self.running.nominal2 {
            return;
        }
        self.running.nominal2 = nominal2;
        // A pending tick on a jerk-limited ramp keeps its time.
        if let Some(long) = &mut self.long_tick
            && long.cut.acceleration == 0.0
        {
            // The time of the pending tick is scaled, as if the speed had changed at once. This jump of the speed
            // affects only a sixteenth of a step.
            let speed = long.cut.units as f32 / long.cut.seconds;
            let changed = square_root(nominal2.min(speed * speed + 2.0 * self.running.acceleration));
            long.time = (long.time as f32 * (speed / changed)) as u64;
            long.cut.seconds = long.cut.units as f32 / changed;
            if long.cut.end.speed2 > nominal2 {
                long.cut.end = Pace { speed: nominal, speed2: nominal2 };
            }
        }
    }

    /// Returns the position and lead of the motors at the end of the last handed-over segment.
    pub(super) fn motors(&self, backlash: &Backlash<N>) -> Motors<N> {
        if self.running.is_active() { self.motors_in_block(backlash) } else { self.block_start }
    }

    /// Like [`SegmentSource::motors`], within a block.
    #[inline(always)]
    fn motors_in_block(&self, backlash: &Backlash<N>) -> Motors<N> {
        let steps = self.running.steps_from(&self.block_start.steps);
        if backlash.is_on() {
            return backlash.followed(&self.block_start, steps);
        }
        Motors { steps, lead: self.block_start.lead }
    }

    /// Returns the position and lead of the motors at the start of the running block; without one, at the end of the
    /// last block.
    pub(super) fn block_start(&self) -> &Motors<N> {
        &self.block_start
    }

    pub(super) fn last_rest(&self) -> &Motors<N> {
        &self.last_rest
    }

    /// Returns the next message for the step task. Without a block, returns `None`, ends a hold, and hands over nothing
    /// more until the next start.
    #[inline]
    pub(super) fn next_message(
        &mut self,
        planner: &mut Planner<N>,
        overrides: OverrideFactors,
        backlash: &Backlash<N>,
    ) -> Option<ToStep> {
        if !self.running.is_active() && !self.begin_block(planner, overrides) {
            self.stop();
            return None;
        }
        let announcement = self.running.announce();
        announcement.or_else(|| Some(ToStep::Segment(self.segment(planner, backlash))))
    }

    /// Begins the first block of the queue; returns `false` without one.
    pub(super) fn begin_block(&mut self, planner: &mut Planner<N>, overrides: OverrideFactors) -> bool {
        let Some(block) = planner.begin() else { return false };
        self.running = Running::of(block, overrides);
        if self.motion.pace.speed2 <= 0.0 {
            self.last_rest = self.block_start;
        }
        self.motion.pace = self.motion.pace.scaled(self.running.scale);
        // After a corner the acceleration acts on other axes, so the new block's limit applies.
        self.motion.acceleration = greater(lesser(self.motion.acceleration, block.acceleration), -block.acceleration);
        true
    }

    /// Returns the next segment of the running block: a piece of it, part of the wait for a pending tick, or that tick.
    #[inline]
    fn segment(&mut self, planner: &mut Planner<N>, backlash: &Backlash<N>) -> Segment {
        let braking = self.state == FeedState::Braking;
        let (cut, time) = match self.long_tick {
            Some(LongTick { cut, time }) => (cut, time),
            None => {
                let Some(cut) = self.next_cut(braking, planner) else { return self.rest_here(backlash) };
                (cut, self.pacer.fixed(cut.seconds))
            }
        };
        if cut.ticks == 1 && (time > self.far() || self.long_tick.is_some()) {
            if braking {
                return self.rest_here(backlash);
            }
            if time > self.far() {
                return self.wait(cut, time, backlash);
            }
            self.long_tick = None;
        }
        self.emit(&cut, u32::try_from(time).unwrap_or(u32::MAX), planner, backlash)
    }

    /// Returns the interval above which the wait for a tick is divided into parts, in fixed point.
    #[inline]
    fn far(&self) -> u64 {
        u64::from(self.pacer.whole(self.clocks_per_ms * FAR_MS))
    }

    /// Returns the next piece of the running block; `None` for an immediate stop.
    #[inline]
    fn next_cut(&mut self, braking: bool, planner: &mut Planner<N>) -> Option<Cut> {
        if planner.jerk_limited {
            return jerk_segment::next_cut(&self.running, &mut self.motion, braking, planner);
        }
        planner.settle();
        let (run, pace) = (&self.running, self.motion.pace);
        run.trapezoid(pace, braking, planner)
            .map(|(curve, left)| segment::cut(&curve, run.done, left, pace, run.scales_power()))
    }

    /// Returns a segment without steps that lasts for a part of the time until a pending tick. Keeps the rest of this
    /// time in `long_tick`.
    #[inline(never)]
    fn wait(&mut self, cut: Cut, time: u64, backlash: &Backlash<N>) -> Segment {
        let wait = self.clocks_per_ms * WAIT_MS;
        let wait_fixed = self.pacer.whole(wait);
        self.long_tick = Some(LongTick { cut, time: time - u64::from(wait_fixed) });
        self.rest = false;
        let motors = self.motors(backlash);
        self.hand_over(&cut, &motors, Segment::FLAG_WAIT, wait_fixed, 0, 1, wait)
    }

    /// Returns a segment that moves nothing and puts the step task to rest; with this segment the hold is complete.
    #[inline(never)]
    fn rest_here(&mut self, backlash: &Backlash<N>) -> Segment {
        self.long_tick = None;
        self.motion.stop();
        self.rest = true;
        self.state = FeedState::Held;
        let clocks = self.clocks_per_us * REST_US;
        let still = Cut { units: 0, level: 0, ticks: 1, seconds: 1.0, end: Pace::REST, ramp: 0.0, acceleration: 0.0 };
        let interval = self.pacer.whole(clocks);
        let motors = self.motors(backlash);
        self.hand_over(&still, &motors, Segment::FLAG_WAIT | Segment::FLAG_LAST, interval, 0, 1, clocks)
    }

    /// Hands over a piece with its time. If the piece is the last one of the block, removes the block from the queue.
    /// If the piece ends at rest during a hold, the hold is complete.
    #[inline]
    fn emit(&mut self, cut: &Cut, time: u32, planner: &mut Planner<N>, backlash: &Backlash<N>) -> Segment {
        let intervals = self.pacer.intervals(time, cut.ticks, cut.ramp);
        self.running.done += cut.units;
        self.motion.pace = cut.end;
        self.motion.acceleration = cut.acceleration;
        let ends = self.running.is_done();
        let mut flags = 0;
        if ends && planner.len() < 2 {
            // At the end of the queue the machine must be able to stop within one step; otherwise it is faster than
            // planned.
            debug_assert!(
                cut.end.speed2 <= 2.0 * self.running.acceleration * UNITS_PER_STEP as f32,
                "at the end of the queue at {} mm/s",
                cut.end.speed / self.running.scale
            );
            self.motion.pace = Pace::REST;
        }
        self.rest = self.motion.pace.speed2 <= 0.0;
        if self.rest {
            flags = Segment::FLAG_LAST;
            self.motion.acceleration = 0.0;
            if self.state == FeedState::Braking {
                self.state = FeedState::Held;
            }
        }
        let motors = self.motors_in_block(backlash);
        let ticks = cut.ticks as u16;
        let segment = self.hand_over(cut, &motors, flags, intervals.interval, intervals.ramp, ticks, intervals.clocks);
        if ends {
            self.block_start = motors;
            self.running.stage = BlockStage::Nothing;
            self.motion.pace = self.motion.pace.scaled(1.0 / self.running.scale);
            planner.pop(self.motion.pace.speed2 > 0.0);
        }
        segment
    }

    /// Records a segment as in flight and returns its message.
    #[allow(clippy::too_many_arguments, reason = "what a segment and its record consist of")]
    #[inline]
    fn hand_over(
        &mut self,
        cut: &Cut,
        motors: &Motors<N>,
        flags: u8,
        interval: u32,
        ramp: i32,
        ticks: u16,
        clocks: u32,
    ) -> Segment {
        let run = &self.running;
        let speed = cut.units as f32 / (cut.seconds * run.scale);
        let power = run.power_at(speed);
        let line_number = run.line_number;
        let mark = run.mark();
        let sent =
            InFlightSegment { position: motors.tool(), lead: motors.lead, speed, clocks, line_number, power, mark };
        let rapid = if run.is_rapid() { Segment::FLAG_RAPID } else { 0 };
        let fresh = if run.stage == BlockStage::FirstSegment { Segment::FLAG_NEW_BLOCK } else { 0 };
        self.running.stage = BlockStage::Segments;
        self.in_flight.push(sent);
        Segment { interval, ramp, ticks, power, level: cut.level, flags: flags | fresh | rapid }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_hold_at_rest_is_held_at_once_and_only_resume_ends_it() {
        let mut feed = SegmentSource::<3>::new(1_000_000, crate::motion::on_heap(1).ring);
        assert!(!feed.is_on() && !feed.is_held());
        feed.hold();
        assert!(feed.is_held() && !feed.wants_more());
        feed.start();
        feed.run_out();
        assert!(feed.is_held());
        feed.resume(true);
        assert!(feed.is_on() && feed.wants_more());
        feed.run_out();
        assert!(!feed.is_on() && !feed.is_held());
    }

    #[test]
    fn a_hold_in_motion_brakes_first() {
        let mut feed = SegmentSource::<3>::new(1_000_000, crate::motion::on_heap(1).ring);
        feed.start();
        feed.rest = false;
        feed.hold();
        assert!(feed.is_on() && !feed.is_held());
        assert_eq!(feed.state, FeedState::Braking);
        feed.hold();
        assert_eq!(feed.state, FeedState::Braking);
        feed.resume(true);
        assert_eq!(feed.state, FeedState::Running);
    }

    #[test]
    fn a_resume_without_blocks_starts_nothing() {
        let mut feed = SegmentSource::<3>::new(1_000_000, crate::motion::on_heap(1).ring);
        feed.hold();
        feed.resume(false);
        assert!(!feed.is_on() && !feed.is_held());
    }
}
