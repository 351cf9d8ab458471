//! The way out of motion: announces the running block, cuts its segments, and hands them over as long as less than
//! [`QUEUED_TIME_MS`] is in flight. Brakes to a stop in a hold. A tick that is far away is waited for in short pieces,
//! so that a hold is never late.

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

/// Milliseconds of motion handed to the step task in advance (the segment buffer): enough for a control task that is late, and the latency of a hold.
pub const QUEUED_TIME_MS: u32 = 16;
/// Ticks farther away than this are waited for in pieces of [`WAIT_MS`], so that a hold needs not wait for them.
const FAR_MS: u32 = 4;
const WAIT_MS: u32 = 1;
/// Where motion comes to rest with less than this queued, what follows waits until the step task is at rest, and so begins
/// with what gathers before a start. Its first segments are shorter than a small processor takes to prepare them: were they to
/// follow at once, they would have to be there in time.
const JOIN_MS: u32 = 2;
/// With less than this queued of a motion that continues, segments come before lines: more than a line takes, and the segments of
/// a stop from there.
const SHORT_MS: u32 = 8;
/// Length of the segment that tells the step task to rest when there is nothing to brake, in microseconds.
const REST_US: u32 = 20;

/// What is done with the queue.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum FeedState {
    /// Nothing is handed over: not started, or the queue has run empty.
    Idle,
    /// Segments are handed over.
    Running,
    /// They brake to a stop.
    Braking,
    /// Stopped by a hold; nothing is handed over.
    Held,
}

/// A single tick that is far away, and how much of its time is left (fixed point).
#[derive(Clone, Copy, Debug)]
struct LongTick {
    cut: Cut,
    time: u64,
}

/// For a clock slower than a microsecond. `Ord::max` is not for constants.
const fn at_least_one(clocks: u32) -> u32 {
    if clocks == 0 { 1 } else { clocks }
}

/// The running block, and what has been handed over to the segment buffer.
#[derive(Debug)]
#[cfg_attr(feature = "alloc", derive(Clone))]
#[repr(C)]
pub(super) struct SegmentSource<const N: usize> {
    state: FeedState,
    /// What has been handed over ends at rest.
    rest: bool,
    /// How the machine moves at the end of that.
    pub(super) motion: PathMotion,
    pub(super) running: Running<N>,
    /// The motors at the start of the running block, and where they last stood still.
    block_start: Motors<N>,
    last_rest: Motors<N>,
    long_tick: Option<LongTick>,
    step_clock_hz: u32,
    /// The same for shorter times, without a division.
    clocks_per_ms: u32,
    clocks_per_us: u32,
    pacer: Pacer,
    pub(super) in_flight: SegmentsInFlight<N>,
}

impl<const N: usize> SegmentSource<N> {
    /// At rest with nothing to do.
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

    /// Takes over the step clock.
    pub(super) fn configure(&mut self, step_clock_hz: u32) {
        self.step_clock_hz = step_clock_hz.max(10_000);
        self.clocks_per_ms = self.step_clock_hz / 1000;
        self.clocks_per_us = at_least_one(self.step_clock_hz / 1_000_000);
        self.pacer = Pacer::new(self.step_clock_hz);
    }

    /// Ticks of the step timer per second.
    pub(super) fn step_clock_hz(&self) -> u32 {
        self.step_clock_hz
    }

    /// Time of what has been handed over and not begun, in microseconds.
    #[inline]
    pub(super) fn queued_us(&self) -> u32 {
        self.in_flight.queued() / self.clocks_per_us
    }

    /// Whether that is at least so many microseconds, a second at most, without a division.
    #[inline]
    pub(super) fn holds_time(&self, us: u32) -> bool {
        // In a microsecond there are 4294 clocks at most, for in a second they fit 32 bits.
        self.in_flight.queued() >= us.wrapping_mul(self.clocks_per_us)
    }

    /// The running block is forgotten; the machine rests with the motors here.
    pub(super) fn restart(&mut self, motors: Motors<N>) {
        self.running.stage = BlockStage::Nothing;
        self.long_tick = None;
        self.motion.stop();
        self.rest = true;
        self.block_start = motors;
        self.last_rest = motors;
    }

    /// Begins to hand over what is queued, unless a hold is in force.
    #[inline]
    pub(super) fn start(&mut self) {
        if self.state == FeedState::Idle {
            self.state = FeedState::Running;
        }
    }

    /// Brakes to a stop.
    pub(super) fn hold(&mut self) {
        if matches!(self.state, FeedState::Idle | FeedState::Running) {
            self.state = if self.rest { FeedState::Held } else { FeedState::Braking };
        }
    }

    /// Ends a hold; there are blocks or not.
    pub(super) fn resume(&mut self, any: bool) {
        self.state = if any { FeedState::Running } else { FeedState::Idle };
    }

    /// Hands over nothing before it is started; no hold is in force.
    #[inline]
    pub(super) fn stop(&mut self) {
        self.state = FeedState::Idle;
    }

    /// The queue has run empty. A hold stays in force.
    #[inline]
    pub(super) fn run_out(&mut self) {
        if self.state == FeedState::Running {
            self.state = FeedState::Idle;
        }
    }

    /// Whether a hold is in force and what was handed over ends at rest.
    pub(super) fn is_held(&self) -> bool {
        self.state == FeedState::Held
    }

    /// Whether segments are handed over.
    #[inline]
    pub(super) fn is_on(&self) -> bool {
        matches!(self.state, FeedState::Running | FeedState::Braking)
    }

    /// Whether what has been handed over ends at rest.
    #[inline]
    pub(super) fn ends_at_rest(&self) -> bool {
        self.rest
    }

    /// Whether a message is wanted: something is handed over, and there is not enough of it in the segment buffer.
    #[inline]
    pub(super) fn wants_more(&self) -> bool {
        self.is_on() && !self.in_flight.is_full() && self.in_flight.queued() < self.clocks_per_ms * QUEUED_TIME_MS
    }

    /// Whether what follows a rest waits until the step task has come to it: too little is queued up to there.
    #[inline]
    pub(super) fn waits_for_rest(&self) -> bool {
        self.rest && self.in_flight.moves() && self.in_flight.queued() < self.clocks_per_ms * JOIN_MS
    }

    /// Whether a motion continues for which little time has been handed over.
    #[inline]
    pub(super) fn is_short_of_segments(&self) -> bool {
        let has_begun = self.in_flight.moves() || !self.in_flight.is_empty();
        has_begun
            && self.in_flight.queued() < self.clocks_per_ms * SHORT_MS
            && !self.in_flight.is_full()
            && !self.ends_at_rest()
    }

    /// The state of motion on the path, and how much of the first block is left, mm.
    pub(super) fn path_state(&self, first: Option<&Block<N>>) -> (PathState, f32) {
        let millimetre = if self.running.is_active() { 1.0 / self.running.scale } else { 1.0 };
        let left = match first {
            Some(first) if !self.running.is_active() => first.length,
            _ => self.running.left() as f32 * millimetre,
        };
        let state = PathState { speed: self.motion.pace.speed * millimetre, acceleration: self.motion.acceleration };
        (state, left)
    }

    /// Takes over the nominal speed of the running block, mm/s.
    pub(super) fn set_nominal(&mut self, nominal: f32) {
        let nominal = nominal * self.running.scale;
        let nominal2 = nominal * nominal;
        if nominal2 == self.running.nominal2 {
            return;
        }
        self.running.nominal2 = nominal2;
        // A tick on a ramp with bounded jerk is not hurried.
        if let Some(long) = &mut self.long_tick
            && long.cut.acceleration == 0.0
        {
            // The tick that is waited for comes sooner or later in proportion, as if the speed had changed at once: it is
            // a sixteenth of a step.
            let speed = long.cut.units as f32 / long.cut.seconds;
            let changed = square_root(nominal2.min(speed * speed + 2.0 * self.running.acceleration));
            long.time = (long.time as f32 * (speed / changed)) as u64;
            long.cut.seconds = long.cut.units as f32 / changed;
            if long.cut.end.speed2 > nominal2 {
                long.cut.end = Pace { speed: nominal, speed2: nominal2 };
            }
        }
    }

    /// The motors at the end of what has been handed over.
    pub(super) fn motors(&self, backlash: &Backlash<N>) -> Motors<N> {
        if self.running.is_active() { self.motors_in_block(backlash) } else { self.block_start }
    }

    /// The same within a block.
    #[inline(always)]
    fn motors_in_block(&self, backlash: &Backlash<N>) -> Motors<N> {
        let steps = self.running.steps_from(&self.block_start.steps);
        if backlash.is_on() {
            return backlash.followed(&self.block_start, steps);
        }
        Motors { steps, lead: self.block_start.lead }
    }

    /// The motors where the last block ended.
    pub(super) fn block_start(&self) -> &Motors<N> {
        &self.block_start
    }

    /// The motors where they last stood still.
    pub(super) fn last_rest(&self) -> &Motors<N> {
        &self.last_rest
    }

    /// The next message for the step task; `None` without a block.
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

    /// Begins the first block of the queue; `false` without one.
    pub(super) fn begin_block(&mut self, planner: &mut Planner<N>, overrides: OverrideFactors) -> bool {
        let Some(block) = planner.begin() else { return false };
        self.running = Running::of(block, overrides);
        if self.motion.pace.speed2 <= 0.0 {
            self.last_rest = self.block_start;
        }
        self.motion.pace = self.motion.pace.scaled(self.running.scale);
        // Round a corner other axes feel it.
        self.motion.acceleration = greater(lesser(self.motion.acceleration, block.acceleration), -block.acceleration);
        true
    }

    /// The next segment of the running block: a piece of it, or of the time until a tick that is far away, or that tick.
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

    /// Time of a tick that is far away, in fixed point.
    #[inline]
    fn far(&self) -> u64 {
        u64::from(self.pacer.whole(self.clocks_per_ms * FAR_MS))
    }

    /// The next piece of the running block; `None` for a stop at this very position.
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

    /// A part of the time until a tick that is far away.
    #[inline(never)]
    fn wait(&mut self, cut: Cut, time: u64, backlash: &Backlash<N>) -> Segment {
        let wait = self.clocks_per_ms * WAIT_MS;
        let wait_fixed = self.pacer.whole(wait);
        self.long_tick = Some(LongTick { cut, time: time - u64::from(wait_fixed) });
        self.rest = false;
        let motors = self.motors(backlash);
        self.hand_over(&cut, &motors, Segment::FLAG_WAIT, wait_fixed, 0, 1, wait)
    }

    /// A segment that moves nothing and lets the step task rest.
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

    /// Hands over a cut with its time. After the last one of a block the next block is the first.
    #[inline]
    fn emit(&mut self, cut: &Cut, time: u32, planner: &mut Planner<N>, backlash: &Backlash<N>) -> Segment {
        let intervals = self.pacer.intervals(time, cut.ticks, cut.ramp);
        self.running.done += cut.units;
        self.motion.pace = cut.end;
        self.motion.acceleration = cut.acceleration;
        let ends = self.running.is_done();
        let mut flags = 0;
        if ends && planner.len() < 2 {
            // Never faster than what stops within a step, or the plan has been left.
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

    /// Notes a segment that is on its way, and makes its message.
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
