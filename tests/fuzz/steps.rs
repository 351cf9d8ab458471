//! Fuzz target: messages to the step generator. Blocks have any numbers of steps and are cut into any segments that a
//! planner can produce. Messages arrive early or late, with stops in between.
//!
//! Invariants:
//! - No axis makes more than one step per tick.
//! - The reported position agrees with the steps made.
//! - A complete block makes exactly its steps.
//! - After a stop or an underrun nothing moves until motion is resumed.

use super::work::at_most;
use arbitrary::{Arbitrary, Unstructured};
use oxmill_controller::Stepper;
use oxmill_controller::messages::{AxisSteps, Segment, StepEvent, ToStep, UNITS_PER_STEP};
use std::collections::VecDeque;

const AXES: usize = 3;
/// After so many ticks of the step generator, no more actions are carried out.
const MOST_TICKS: u32 = 20_000;

#[derive(Arbitrary)]
enum Action {
    Block { steps: [u16; AXES], ends: [u8; AXES], directions: u8, cuts: Vec<Cut> },
    Load(u8),
    Tick(u8),
    Stop,
    Resume,
}

/// Describes how a segment is cut from the rest of a block.
#[derive(Arbitrary)]
struct Cut {
    level: u8,
    ticks: u8,
    interval: u32,
    ramp: i16,
    wait: bool,
    last: bool,
}

/// Maximum number of control-flow edges in a tick; the highest count when this was chosen: 8.
const MOST_WORK: u64 = 32;

struct Run {
    stepper: Stepper<AXES>,
    queue: VecDeque<ToStep>,
    /// Net steps made.
    counted: [i32; AXES],
    /// End position of the queued blocks.
    planned: [i32; AXES],
    ticks: u32,
    /// Number of stops so far, while a stop or an underrun blocks motion. `None` while motion is allowed.
    shut: Option<u16>,
}

/// Runs the target on one input; panics if an invariant is violated.
pub fn run(data: &[u8]) {
    let mut run = Run {
        stepper: Stepper::new(),
        queue: VecDeque::new(),
        counted: [0; AXES],
        planned: [0; AXES],
        ticks: 0,
        shut: None,
    };
    let mut input = Unstructured::new(data);
    while !input.is_empty() && run.ticks < MOST_TICKS {
        match input.arbitrary() {
            Ok(Action::Block { steps, ends, directions, cuts }) => run.block(steps, ends, directions, cuts),
            Ok(Action::Load(count)) => (0..count).for_each(|_| run.load()),
            Ok(Action::Tick(count)) => (0..=count).for_each(|_| run.tick()),
            Ok(Action::Stop) => run.stop(),
            Ok(Action::Resume) => run.resume(),
            Err(_) => break,
        }
    }
    run.finish();
}

impl Run {
    fn block(&mut self, steps: [u16; AXES], ends: [u8; AXES], directions: u8, cuts: Vec<Cut>) {
        if self.shut.is_some() {
            return;
        }
        let steps = steps.map(|steps| u32::from(steps % 600));
        let dominant = steps.into_iter().max().unwrap_or(0);
        if dominant == 0 {
            return;
        }
        let part = |bits: u8| i32::from(bits % 7) - AxisSteps::FARTHEST;
        let mut steps_by_axis = [AxisSteps::on_steps(0); AXES];
        for ((axis_steps, steps), ends) in steps_by_axis.iter_mut().zip(steps).zip(ends) {
            *axis_steps = if ends & 1 == 0 {
                AxisSteps::on_steps(steps)
            } else {
                AxisSteps::with_ends(steps, part(ends >> 1), part(ends >> 4))
            };
        }
        let directions = directions & 7;
        for (axis, (planned, steps)) in self.planned.iter_mut().zip(steps).enumerate() {
            *planned += if directions >> axis & 1 != 0 { -(steps as i32) } else { steps as i32 };
        }
        self.queue.push_back(ToStep::Block { steps_by_axis, directions });
        let total = dominant * UNITS_PER_STEP;
        let mut units = 0;
        let mut flags = Segment::FLAG_NEW_BLOCK;
        for cut in &cuts {
            let per_tick = self.units_per_tick(units, cut.level);
            let most = (total - units) / per_tick;
            if cut.wait {
                self.segment(cut, 4, u16::from(cut.ticks) + 1, flags | Segment::FLAG_WAIT);
            } else if most > 0 {
                let ticks = (u32::from(cut.ticks) + 1).min(most);
                units += ticks * per_tick;
                self.segment(cut, level_of(per_tick), ticks as u16, flags);
            } else {
                break;
            }
            flags = 0;
        }
        // Send the rest of the block, in segments with as few ticks per step as possible.
        let rest =
            Cut { level: 0, ticks: 0, interval: 1 << 20, ramp: 0, wait: false, last: cuts.len().is_multiple_of(2) };
        while units < total {
            let per_tick = self.units_per_tick(units, 0);
            let next = if per_tick == UNITS_PER_STEP { total } else { units + per_tick };
            self.segment(&rest, level_of(per_tick), ((next - units) / per_tick) as u16, flags);
            units = next;
            flags = 0;
        }
    }

    /// Returns how many path units ([`UNITS_PER_STEP`] make a step) the path advances in one tick of a segment.
    /// `units`: path units before the segment. `level` gives the maximum. The result is this maximum, halved until
    /// `units` is a multiple of it.
    fn units_per_tick(&self, units: u32, level: u8) -> u32 {
        let mut per_tick = UNITS_PER_STEP >> (level % 5);
        while !units.is_multiple_of(per_tick) {
            per_tick /= 2;
        }
        per_tick
    }

    fn segment(&mut self, cut: &Cut, level: u8, ticks: u16, flags: u8) {
        let last = if cut.last { Segment::FLAG_LAST } else { 0 };
        let (interval, ramp) = (cut.interval | 1 << 12, i32::from(cut.ramp));
        self.queue.push_back(ToStep::Segment(Segment { interval, ramp, ticks, power: 0, level, flags: flags | last }));
    }

    fn load(&mut self) {
        if self.stepper.has_room()
            && let Some(message) = self.queue.pop_front()
        {
            self.stepper.load(message);
        }
    }

    fn tick(&mut self) {
        self.ticks += 1;
        let directions = self.stepper.directions();
        let tick = at_most(MOST_WORK, || self.stepper.tick());
        assert!(tick.steps < 1 << AXES, "steps of axes that are not there");
        assert!(self.shut.is_none() || tick.steps == 0, "a step before the machine is resumed");
        for axis in 0..AXES {
            if tick.steps >> axis & 1 != 0 {
                self.counted[axis] += if directions >> axis & 1 != 0 { -1 } else { 1 };
            }
        }
        if tick.underrun {
            let StepEvent::Underrun { stops, position } = self.stepper.underrun_event() else { unreachable!() };
            assert_eq!(position.0, self.counted, "the position of an underrun");
            self.shut = Some(stops);
        }
    }

    fn stop(&mut self) {
        let StepEvent::Stopped { stops, position, .. } = self.stepper.stop([0; 3]) else { unreachable!() };
        assert_eq!(position.0, self.counted, "the position of a stop");
        self.shut = Some(stops);
    }

    /// Resumes after a stop or an underrun: drops the queue; the next block starts where the steps ended.
    fn resume(&mut self) {
        let Some(stops) = self.shut.take() else { return };
        self.queue.clear();
        self.planned = self.counted;
        self.stepper.load(ToStep::Resume { stops });
    }

    /// Resumes, then runs all queued messages, and checks that the blocks have made exactly their steps.
    fn finish(&mut self) {
        self.resume();
        while self.ticks < 4 * MOST_TICKS && (!self.queue.is_empty() || !self.stepper.is_idle()) {
            for _ in 0..4 {
                self.load();
            }
            self.tick();
        }
        if self.queue.is_empty() && self.stepper.is_idle() {
            assert_eq!(self.counted, self.planned, "a block makes just its steps");
        }
    }
}

fn level_of(per_tick: u32) -> u8 {
    (UNITS_PER_STEP / per_tick).trailing_zeros() as u8
}
