//! Blocks on their way out: cut into segments, announced and handed over to the step task.

use super::block::{RAPID, SCALE_POWER};
use super::flight::Record;
use super::measure::Measure;
use super::profile::{Curve, OFF_CURVE, Pace, greater, lesser};
use super::segment::{self, Cut};
use super::{Announce, AnyMotion, Far, Hold, Motors, Running};
use crate::messages::{Leg, Observed, Segment, ToStep, UNITS_PER_STEP};

/// Step time handed to the step task in advance: enough for a control task that is late, and the latency of a hold.
pub const QUEUED_TIME_MS: u32 = 16;
/// Ticks farther away than this are waited for in pieces of [`WAIT_MS`], so that a hold needs not wait for them.
const FAR_MS: u32 = 4;
const WAIT_MS: u32 = 1;
/// Length of the segment that tells the step task to rest when there is nothing to brake, in microseconds.
const REST_US: u32 = 20;
/// A crawl in which a unit takes longer than this many seconds stops where it is if it can within the unit.
const CRAWL_S: f32 = 0.001;

impl<const N: usize> AnyMotion<N> {
    /// The next message for the step task. `None`: nothing to do, not started, or enough time is queued.
    pub fn next(&mut self, observed: &Observed) -> Option<ToStep> {
        self.observe(observed);
        self.next_message()
    }

    /// The same with nothing observed anew.
    #[inline]
    pub fn next_message(&mut self) -> Option<ToStep> {
        if !self.feed.started || self.feed.hold == Hold::Held || self.flight.is_full() {
            return None;
        }
        if self.flight.queued() >= self.step_clock_hz / 1000 * QUEUED_TIME_MS {
            return None;
        }
        self.continue_long_move();
        if !self.feed.running.active && !self.begin_block() {
            self.feed.started = false;
            return None;
        }
        match self.feed.running.announce {
            Announce::Rest => {
                self.feed.running.announce = Announce::Block;
                let mut legs = [Leg::default(); 3];
                for (out, own) in legs.iter_mut().zip(self.feed.running.legs.iter().skip(3)) {
                    *out = *own;
                }
                Some(ToStep::BlockRest { legs })
            }
            Announce::Block => {
                self.feed.running.announce =
                    if self.feed.running.done > 0 { Announce::Reenter } else { Announce::Nothing };
                let mut legs = [Leg::default(); 3];
                for (out, own) in legs.iter_mut().zip(self.feed.running.legs.iter()) {
                    *out = *own;
                }
                Some(ToStep::Block { legs, directions: self.feed.running.directions })
            }
            Announce::Reenter => {
                self.feed.running.announce = Announce::Nothing;
                Some(ToStep::Reenter { units: self.feed.running.done })
            }
            Announce::Nothing => Some(ToStep::Segment(self.segment())),
        }
    }

    /// Takes the first block of the queue to pieces; `false` without one.
    pub(super) fn begin_block(&mut self) -> bool {
        let Some(block) = self.planner.first() else { return false };
        let measure = Measure::of(&block.legs);
        let scale = measure.total as f32 / block.length;
        let nominal = block.nominal(self.overrides) * scale;
        self.feed.running = Running {
            active: true,
            announce: if N > 3 { Announce::Rest } else { Announce::Block },
            fresh: true,
            legs: block.legs,
            directions: block.directions,
            flags: block.flags,
            power: block.power,
            line_number: block.line_number,
            threshold: measure.threshold,
            rates: block.legs.map(|leg| measure.rate(leg)),
            credits: block.legs.map(|leg| measure.credit(leg)),
            total: measure.total,
            done: 0,
            scale,
            acceleration: block.acceleration * scale,
            nominal2: nominal * nominal,
            programmed: if block.flags & RAPID != 0 { block.limit } else { block.programmed },
        };
        if self.feed.pace.speed2 <= 0.0 {
            self.feed.stood = self.feed.start;
        }
        self.feed.pace = self.feed.pace.scaled(scale);
        // Round a corner other axes feel it.
        self.feed.pull = greater(lesser(self.feed.pull, block.acceleration), -block.acceleration);
        true
    }

    fn segment(&mut self) -> Segment {
        let clocks_per_ms = self.step_clock_hz / 1000;
        let far_fixed = u64::from(self.pacer.whole(FAR_MS * clocks_per_ms));
        if self.feed.far.is_none() {
            let cut = if self.planner.jerk_limited {
                self.smooth_cut()
            } else {
                self.curve().map(|(curve, left)| segment::cut(&curve, self.feed.running.done, left, self.feed.pace))
            };
            let Some(cut) = cut else { return self.rest_here() };
            let time = self.pacer.fixed(cut.seconds);
            if cut.ticks > 1 || time <= far_fixed {
                let time = u32::try_from(time).unwrap_or(u32::MAX);
                return self.emit(&cut, time);
            }
            self.feed.far = Some(Far { cut, time });
        }
        let Some(far) = &mut self.feed.far else { return self.rest_here() };
        if self.feed.hold == Hold::Ramp {
            return self.rest_here();
        }
        let cut = far.cut;
        if far.time > far_fixed {
            let wait = WAIT_MS * clocks_per_ms;
            let wait_fixed = self.pacer.whole(wait);
            far.time -= u64::from(wait_fixed);
            self.feed.rest = false;
            let motors = self.prepared();
            return self.hand_over(&cut, &motors, Segment::FLAG_WAIT, wait_fixed, 0, 1, wait);
        }
        let time = far.time as u32;
        self.feed.far = None;
        self.emit(&cut, time)
    }

    /// The speed curve of the running block and how many units are left of it; `None` for a stop at this very place.
    #[inline]
    pub(super) fn curve(&self) -> Option<(Curve, u32)> {
        let run = &self.feed.running;
        let left = run.total - run.done;
        let planned2 = self.planner.exit2();
        let acceleration = self.acceleration_towards(planned2);
        if self.feed.hold != Hold::Ramp {
            let exit2 = planned2 * (run.scale * run.scale);
            let curve = Curve { acceleration, nominal2: run.nominal2, exit2 };
            return Some((curve, left));
        }
        if self.feed.pace.speed2 <= 0.0 {
            return None;
        }
        let way = self.feed.pace.speed2 / (2.0 * acceleration);
        if way < 1.0 && self.feed.pace.speed * CRAWL_S < 2.0 {
            return None;
        }
        if way >= left as f32 {
            // All of this block brakes, and the next one goes on with what speed is left.
            let exit2 = (self.feed.pace.speed2 - 2.0 * acceleration * left as f32).max(0.0);
            let curve = Curve { acceleration, nominal2: self.feed.pace.speed2, exit2 };
            return Some((curve, left));
        }
        // The stop is at a whole unit, with a deceleration that is lower by as little as that needs.
        let mut stop = way as u32;
        if (stop as f32) < way {
            stop += 1;
        }
        let stop = stop.clamp(1, left);
        let curve = Curve {
            acceleration: self.feed.pace.speed2 / (2.0 * stop as f32),
            nominal2: self.feed.pace.speed2,
            exit2: 0.0,
        };
        Some((curve, stop))
    }

    /// The running block's acceleration, in units/s²: in a bend what it leaves at the lower of the present speed and the
    /// planned exit speed², as the reverse pass has counted on. A machine that is too fast for that exit, because the bend
    /// was seen when the blocks behind had counted on all of the acceleration, brakes as hard as it needs.
    #[inline]
    fn acceleration_towards(&self, exit2: f32) -> f32 {
        let run = &self.feed.running;
        match self.planner.first() {
            Some(block) if !block.curve.is_none() => {
                let speed2 = self.feed.pace.speed2 / (run.scale * run.scale);
                let planned = block.acceleration_at(lesser(speed2, exit2)) * run.scale;
                let (exit2, twice_left) = (exit2 * run.scale * run.scale, 2.0 * (run.total - run.done) as f32);
                if self.feed.pace.speed2 <= (exit2 + planned * twice_left) * OFF_CURVE {
                    return planned;
                }
                lesser((self.feed.pace.speed2 - exit2) / twice_left, run.acceleration)
            }
            _ => run.acceleration,
        }
    }

    /// A segment that moves nothing and lets the step task rest.
    #[inline(never)]
    fn rest_here(&mut self) -> Segment {
        self.feed.far = None;
        self.feed.pace = Pace::REST;
        self.feed.pull = 0.0;
        self.feed.rest = true;
        self.feed.hold = Hold::Held;
        let clocks = (self.step_clock_hz / 1_000_000).max(1) * REST_US;
        let still = Cut { units: 0, level: 0, ticks: 1, seconds: 1.0, end: Pace::REST, ramp: 0.0, acceleration: 0.0 };
        let interval = self.pacer.whole(clocks);
        let motors = self.prepared();
        self.hand_over(&still, &motors, Segment::FLAG_WAIT | Segment::FLAG_LAST, interval, 0, 1, clocks)
    }

    /// Hands over a cut with its time, and goes on to the next block after the last.
    fn emit(&mut self, cut: &Cut, time: u32) -> Segment {
        let intervals = self.pacer.intervals(time, cut.ticks, cut.ramp);
        self.feed.running.done += cut.units;
        self.feed.pace = cut.end;
        self.feed.pull = cut.acceleration;
        let ends = self.feed.running.done >= self.feed.running.total;
        let mut flags = 0;
        if ends && self.planner.len() < 2 {
            // Never faster than what stops within a step, or the plan has been left.
            debug_assert!(
                cut.end.speed2 <= 2.0 * self.feed.running.acceleration * UNITS_PER_STEP as f32,
                "at the end of the queue at {} mm/s",
                cut.end.speed / self.feed.running.scale
            );
            self.feed.pace = Pace::REST;
        }
        self.feed.rest = self.feed.pace.speed2 <= 0.0;
        if self.feed.rest {
            flags = Segment::FLAG_LAST;
            self.feed.pull = 0.0;
            if self.feed.hold == Hold::Ramp {
                self.feed.hold = Hold::Held;
            }
        }
        let motors = self.prepared();
        let ticks = cut.ticks as u16;
        let segment = self.hand_over(cut, &motors, flags, intervals.interval, intervals.ramp, ticks, intervals.clocks);
        if ends {
            self.feed.start = motors;
            self.feed.running.active = false;
            self.planner.pop();
            self.feed.pace = self.feed.pace.scaled(1.0 / self.feed.running.scale);
            if self.planner.len() == 0 && self.long.is_none() && self.backlash.is_on() {
                self.finish_taking_up(&motors);
            }
            if self.planner.len() == 0 && self.long.is_none() {
                self.feed.started = false;
            }
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
        let run = &self.feed.running;
        let speed = cut.units as f32 / (cut.seconds * run.scale);
        let mut power = run.power;
        if run.flags & SCALE_POWER != 0 {
            power = (f32::from(power) * (speed / run.programmed)) as u16;
        }
        let record =
            Record { position: motors.tool(), lead: motors.lead, speed, clocks, line_number: run.line_number, power };
        let rapid = if run.flags & RAPID != 0 { Segment::FLAG_RAPID } else { 0 };
        let fresh = if run.fresh { Segment::FLAG_NEW_BLOCK } else { 0 };
        self.feed.running.fresh = false;
        self.flight.push(record);
        Segment { interval, ramp, ticks, power, level: cut.level, flags: flags | fresh | rapid }
    }
}
