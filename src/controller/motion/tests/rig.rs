//! Test rig ([`Rig`]): feeds messages of `Motion` to a `Stepper`, records each tick, and checks speed and acceleration.

use super::super::on_heap;
use super::super::planner::Planner;
use super::super::{Arc, Curvature, Motion, MotionSettings, Move, Speed, Stepper, Tolerance};
use crate::axes::{Arrangement, PerAxis};
use crate::messages::{AxisSteps, Observed, SEGMENTS_DEPTH, Segment, StepEvent, ToStep};
use crate::units::{Coordinate, DECIMAL_ONE, StepsPerMm};
use std::collections::VecDeque;

pub fn planner(blocks: usize) -> Box<Planner<3>> {
    let memory = on_heap(blocks);
    Box::new(Planner::new(memory.blocks, memory.groups))
}

/// A tick that advances along the path.
#[derive(Clone, Copy, Debug)]
pub struct Record {
    /// Time of the tick, step-clock ticks.
    pub time: u64,
    /// Time since the previous record, step-clock ticks. Waits in between are included.
    pub interval: u64,
    pub steps: u8,
    /// Direction levels that were output before this tick.
    pub directions: u8,
    /// Distance along the path that the tick advances, mm.
    pub path: f64,
    pub level: u8,
    /// Nominal speed of the block, mm/s.
    pub nominal: f64,
    /// Acceleration of the block, mm/s².
    pub acceleration: f64,
    pub block: usize,
}

#[derive(Clone, Copy, Debug)]
pub struct BlockFacts {
    pub units: u32,
    pub length: f64,
    pub nominal: f64,
    pub acceleration: f64,
    pub steps: [u32; 3],
}

pub struct Rig<const N: usize, const B: usize> {
    pub motion: Motion<N>,
    pub stepper: Stepper<N>,
    pub queue: VecDeque<ToStep>,
    shadow: VecDeque<(Segment, usize)>,
    current: Option<(Segment, usize)>,
    pub blocks: Vec<BlockFacts>,
    pub moves: VecDeque<Move<N>>,
    /// If set, the moves are chords of this arc.
    pub arc: Option<Arc<N>>,
    /// If not empty, the moves are chords with these curvatures.
    pub bends: VecDeque<Curvature>,
    pub time: u64,
    due: u32,
    waited: u64,
    directions: u8,
    pub position: [i64; N],
    pub trace: Vec<Record>,
    pub hz: u32,
    pub events: Vec<StepEvent<N>>,
    /// `false`: no more messages are fetched from `motion`, so the stepper's queue runs dry.
    pub feeding: bool,
    pub waits: usize,
    pub segments: usize,
    pub last_flags: usize,
    /// Length of the segments of the current block queued so far, in units (1/16 step of the dominant axis).
    units: u32,
}

pub fn settings(spm: f32, rate: f32, acceleration: f32) -> MotionSettings<3> {
    MotionSettings {
        arrangement: Arrangement::Cartesian,
        steps_per_mm: PerAxis::all(StepsPerMm::new(spm).unwrap()),
        max_rate: PerAxis::all(rate),
        least_feed: 0.0,
        acceleration: PerAxis::all(acceleration),
        jerk: PerAxis::all(0.0),
        backlash: PerAxis::all(0.0),
        junction_deviation: 0.01,
        curve_share: 1.0,
        arc_tolerance: 0.002,
        step_clock_hz: 96_000_000,
    }
}

pub fn mm(value: f64) -> Coordinate {
    Coordinate((value * DECIMAL_ONE as f64).round() as i64)
}

pub fn to<const N: usize>(target: [f64; N], speed: Speed) -> Move<N> {
    Move {
        target: PerAxis(target.map(mm)),
        speed,
        power: 1000,
        scale_power: false,
        line_number: 0,
        no_feed_override: false,
        digit: 0.001,
        tolerance: Tolerance::EXACT,
    }
}

impl<const N: usize, const B: usize> Rig<N, B> {
    pub fn new(settings: MotionSettings<N>) -> Self {
        Self {
            motion: Motion::new(settings, on_heap(B)),
            stepper: Stepper::new(),
            queue: VecDeque::new(),
            shadow: VecDeque::new(),
            current: None,
            blocks: Vec::new(),
            moves: VecDeque::new(),
            arc: None,
            bends: VecDeque::new(),
            time: 0,
            due: 0,
            waited: 0,
            directions: 0,
            position: [0; N],
            trace: Vec::new(),
            hz: settings.step_clock_hz,
            events: Vec::new(),
            feeding: true,
            waits: 0,
            segments: 0,
            last_flags: 0,
            units: 0,
        }
    }

    pub fn observed(&self) -> Observed {
        Observed {
            segments_begun: self.stepper.segments_begun(),
            step_idle: self.stepper.is_idle() && self.queue.is_empty(),
            rx_free: 0,
            received: 1,
            activity: 0,
        }
    }

    /// Queues moves as long as there is room, and fills the queue to the step task with messages.
    pub fn pump(&mut self) {
        loop {
            while let Some(m) = self.moves.front() {
                let bend = self.arc.as_ref().map(Arc::curvature).or(self.bends.front().copied());
                let taken = match bend {
                    Some(bend) => self.motion.chord(m, bend),
                    None => self.motion.line(m),
                };
                if !taken {
                    break;
                }
                self.moves.pop_front();
                self.bends.pop_front();
            }
            if !self.feeding || self.queue.len() >= SEGMENTS_DEPTH {
                return;
            }
            let observed = self.observed();
            let Some(message) = self.motion.next(&observed) else { return };
            match message {
                ToStep::Block { steps_by_axis, .. } => {
                    let run = &self.motion.source.running;
                    self.blocks.push(BlockFacts {
                        units: run.total,
                        length: f64::from(run.total) / f64::from(run.scale),
                        nominal: f64::from(run.nominal2).sqrt() / f64::from(run.scale),
                        acceleration: f64::from(run.acceleration / run.scale),
                        steps: steps_by_axis.map(AxisSteps::steps),
                    });
                }
                ToStep::Segment(segment) => {
                    assert!(segment.ticks > 0);
                    assert!(segment.interval >= 1 << 12 && u64::from(segment.interval) < 1 << 32);
                    let end = i64::from(segment.interval) + i64::from(segment.ramp) * (i64::from(segment.ticks) - 1);
                    assert!(end >= 1 << 12, "{segment:?}");
                    self.segments += 1;
                    if segment.flags & Segment::FLAG_NEW_BLOCK != 0 {
                        self.units = 0;
                    }
                    if segment.flags & Segment::FLAG_WAIT == 0 {
                        let grain = 16 >> segment.level;
                        assert_eq!(self.units % grain, 0, "a coarse tick between its places");
                        self.units += grain * u32::from(segment.ticks);
                    }
                    if segment.flags & Segment::FLAG_WAIT != 0 {
                        self.waits += 1;
                    }
                    if segment.flags & Segment::FLAG_LAST != 0 {
                        self.last_flags += 1;
                    }
                    self.shadow.push_back((segment, self.blocks.len() - 1));
                }
                _ => {}
            }
            self.queue.push_back(message);
        }
    }

    /// Executes one tick of the step timer; returns `false` at rest.
    pub fn tick(&mut self) -> bool {
        while self.stepper.has_room() {
            let Some(message) = self.queue.pop_front() else { break };
            self.stepper.load(message);
        }
        if self.stepper.is_idle() {
            return false;
        }
        self.time += u64::from(self.due);
        let begun = self.stepper.segments_begun();
        let tick = self.stepper.tick();
        if let Some((segment, block)) = self.current {
            let facts = self.blocks[block];
            let units = if segment.flags & Segment::FLAG_WAIT != 0 { 0 } else { 16 >> segment.level };
            self.waited += u64::from(self.due);
            if units == 0 {
                assert_eq!(tick.steps, 0, "a step while waiting");
            }
            let interval = self.waited;
            self.trace.push(Record {
                time: self.time,
                interval,
                steps: tick.steps,
                directions: self.directions,
                path: f64::from(units) / f64::from(facts.units) * facts.length,
                level: segment.level,
                nominal: facts.nominal,
                acceleration: facts.acceleration,
                block,
            });
            if units == 0 {
                self.trace.pop();
            } else {
                self.waited = 0;
            }
        } else {
            assert_eq!(tick.steps, 0, "a step without a segment");
        }
        for axis in 0..N {
            if tick.steps >> axis & 1 != 0 {
                self.position[axis] += if self.directions >> axis & 1 != 0 { -1 } else { 1 };
            }
        }
        assert_eq!(self.stepper.position().0.map(i64::from), self.position, "counter and pulses differ");
        if self.stepper.segments_begun() != begun {
            self.current = self.shadow.pop_front();
        } else if tick.interval == 0 {
            self.current = None;
        }
        if tick.underrun {
            let event = self.stepper.underrun_event();
            self.after_stop(event);
        }
        self.directions = tick.directions;
        self.due = tick.interval;
        tick.interval != 0
    }

    fn after_stop(&mut self, event: StepEvent<N>) {
        self.events.push(event);
        self.current = None;
        self.due = 0;
    }

    /// Stops the step task at once. `motion` is told of the stop when the returned event is passed to
    /// [`Rig::handle_stop`].
    pub fn stop(&mut self) -> StepEvent<N> {
        let event = self.stepper.stop([0; N]);
        self.after_stop(event);
        event
    }

    /// Tells `motion` the position of a stop, and queues the `Resume` for it, as the control task does.
    pub fn handle_stop(&mut self, event: StepEvent<N>) {
        let (StepEvent::Stopped { stops, position, .. } | StepEvent::Underrun { stops, position }) = event else {
            return;
        };
        self.motion.stopped(&position);
        self.queue.push_back(ToStep::Resume { stops });
    }

    /// Discards the queued messages, as the stepper does while its gate is shut. Also discards the rig's records of the
    /// segments in these messages.
    pub fn flush(&mut self) {
        self.queue.clear();
        self.shadow.clear();
    }

    /// Runs until rest, at most `limit` ticks. Returns whether rest was reached.
    pub fn run_ticks(&mut self, limit: usize) -> bool {
        for _ in 0..limit {
            self.pump();
            if !self.tick() && self.queue.is_empty() {
                self.pump();
                if self.queue.is_empty() {
                    return true;
                }
            }
        }
        false
    }

    /// Starts the moves, and runs until all of them are done and the machine is at rest.
    pub fn run(&mut self) {
        for _ in 0..1_000_000 {
            self.pump();
            self.motion.start();
            assert!(self.run_ticks(200_000_000), "does not come to rest");
            let observed = self.observed();
            self.motion.observe(&observed);
            if self.moves.is_empty() && self.motion.is_idle() {
                return;
            }
        }
        panic!("does not finish");
    }

    pub fn seconds(&self) -> f64 {
        self.time as f64 / f64::from(self.hz)
    }

    /// Checks speed and acceleration along the path, computed from the tick intervals.
    ///
    /// The speed of each tick is its path divided by its interval; the tolerance is 1 %. For the acceleration, ticks
    /// are gathered in windows of at least 2 ms and 8 ticks. The acceleration is the difference of the mean speeds of
    /// neighbouring windows, divided by the time between their middles; the tolerance is 1.5 %. Half a percent of
    /// this is for the segment at the top of a ramp: it ends on a whole step after the ramp, and its intervals change
    /// linearly.
    pub fn check_limits(&self) {
        let hz = f64::from(self.hz);
        for record in &self.trace {
            let interval = record.interval as f64 / hz;
            // The tolerance is 1 % plus one clock tick, because a time is rounded to a whole tick.
            assert!(
                record.path <= record.nominal * (interval * 1.01 + 1.0 / hz) + 1e-9,
                "too fast: {} of {} mm/s at {record:?}",
                record.path / interval,
                record.nominal
            );
        }
        self.check_acceleration(false);
    }

    /// Checks the acceleration as in [`Rig::check_limits`]. `cut_short`: `true` if there were overrides or holds at
    /// very low speed. Such an override or hold can drop a pending tick of one unit, or make it earlier. In this case
    /// the check also accepts a jump of the speed, as large as the acceleration allows within one unit.
    pub fn check_acceleration(&self, cut_short: bool) {
        let hz = f64::from(self.hz);
        let mut window: Option<(f64, f64, f64)> = None; // middle, speed, acceleration limit
        let (mut path, mut time, mut ticks, mut limit, mut begin, mut unit) = (0.0, 0.0, 0, 0.0_f64, None, 0.0_f64);
        let mut step = 0.0_f64;
        for record in &self.trace {
            let interval = record.interval as f64 / hz;
            let start = *begin.get_or_insert(record.time as f64 / hz - interval);
            path += record.path;
            time += interval;
            ticks += 1;
            limit = limit.max(record.acceleration);
            unit = unit.max(record.path / f64::from(16 >> record.level));
            step = step.max(record.path * f64::from(1 << record.level));
            if time >= 0.002 && ticks >= 8 {
                let speed = path / time;
                let middle = start + time / 2.0;
                if let Some((before, old, old_limit)) = window {
                    let most = limit.max(old_limit);
                    let seen = (speed - old).abs() / (middle - before);
                    // The error of the acceleration if the duration of a window of 2 ms is wrong by one clock tick.
                    let rounding = speed.max(old) / (0.002 * hz) / (middle - before);
                    let short = if cut_short { (2.0 * most * unit).sqrt() / (middle - before) } else { 0.0 };
                    // A phase of the speed curve (accelerating, cruising or braking) ends on a whole step. So its last
                    // segment also contains the start of the next phase, with another acceleration. For example, a
                    // segment lasts the time T. Its speed is constant for the time t, and then changes with the
                    // acceleration a. The segment's first speed is then wrong by a·t·(T - t)/2T, at most a·T/8.
                    let edge = most * (step / speed / 2.0).min(0.002 / 8.0) / (middle - before);
                    assert!(
                        seen <= most * 1.015 + rounding * 2.0 + short + edge,
                        "acceleration {seen} of {most} at {record:?}"
                    );
                }
                window = Some((middle, speed, limit));
                (path, time, ticks, limit, begin, unit, step) = (0.0, 0.0, 0, 0.0, None, 0.0, 0.0);
            }
        }
    }
}
