//! Measures how far and how fast the tool went, on the blocks and segments that the step task executed: distances,
//! times, and peaks of speed and acceleration that rounding to steps cannot explain. Also takes samples for the
//! drawing.
//!
//! A segment says how many units of its block it advances and in how many ticks of the step clock, and a block how many
//! steps each axis takes. Nothing here is done per step.
//!
//! The ends of a block are rounded to steps, so the length of a short one is known badly: half a step at each end is 4 %
//! of 25 steps. Speeds and accelerations are therefore taken over windows that reach across blocks, of one to
//! `LONGEST_WINDOW` segments, and each is lessened by what rounding may have added to it. What remains has been
//! reached for certain.

use crate::boards::AXES;
use crate::machine::linear;
use crate::marks::Mark;
use crate::path::{Drawing, Sample};
use crate::tool_times::Times;
use oxmill_controller::axes::Arrangement;
use oxmill_controller::messages::{AxisSteps, INTERVAL_FRACTION_BITS, Segment, ToStep, UNITS_PER_STEP};
use std::collections::VecDeque;

/// Shortest window that acceleration is measured on, in seconds. Below it the rounding of ticks is too large a part.
const SHORTEST: f64 = 0.0002;
/// Segments of the longest window.
const LONGEST_WINDOW: usize = 1024;
/// What rounding may add to a speed that is taken as it is, as a part of it.
const SPEED_TOLERANCE: f64 = 0.005;
/// The same for an acceleration.
const ACCELERATION_TOLERANCE: f64 = 0.02;
/// The same for a speed in a drawing. It is seldom reached, and a longer window would blur what follows a short block.
const DRAWN_TOLERANCE: f64 = 0.06;
/// How far the end of a block may be from the step that it is rounded to, in steps. The planner rounds the time of a block
/// as far.
const ROUNDING: f64 = 0.5;
/// How wrong the place of an arc's chord may be, whose ends are told in parts of a step.
const TOLD: f64 = 0.5 / AxisSteps::PARTS as f64;
/// Blocks shorter than this many steps say little of the length of their path: some are measured together.
const SHORT: f64 = 4.0;
/// From so many steps on, what rounding across the path adds to the length is left out of account: less than 0.01 %.
const LONG: f64 = 32.0;
/// So many steps of short blocks are measured together.
const TOGETHER: f64 = 12.0;
/// Two neighbouring windows are on a line if they are longer than the way from end to end by this part at most: then
/// they turn by less than 0.13 rad.
const STRAIGHT: f64 = 0.002;

/// What a job did, in mm and s.
///
/// Peaks are means over windows of some segments, less what the rounding to steps may have added. Where blocks are long
/// the window is a single segment.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Measured {
    /// Length of the path.
    pub distance: f64,
    /// Length of its rapids.
    pub rapid_distance: f64,
    /// Greatest path speed.
    pub speed: f64,
    /// Greatest change of path speed per time: that of ramps. What curves and corners take across the path is no part of
    /// it.
    pub acceleration: f64,
    /// Greatest speed of each axis.
    pub axis_speed: [f64; AXES],
    /// The greatest part that each axis had in a ramp: the change of path speed per time, by the direction of the path.
    pub axis_acceleration: [f64; AXES],
}

/// A block on its way to the step task.
#[derive(Clone, Copy, Debug)]
struct Coming {
    steps_by_axis: [AxisSteps; AXES],
    /// Axes that go to negative.
    directions: u8,
    /// Units of it that had been done before it was left for a detour.
    entered: u32,
    /// What it belongs to, if moves are marked.
    mark: Mark,
}

#[derive(Clone, Copy, Debug, Default)]
struct Block {
    start: [f64; AXES],
    delta: [f64; AXES],
    units: f64,
    length: f64,
    /// What rounding adds to the length on average: it moves the ends across the path, too. And how wrong that may be.
    excess: f64,
    doubt: f64,
    /// How far the ends may be from where they are told to be, along the path.
    error: f64,
    /// Below [`SHORT`].
    short: bool,
    number: u64,
    mark: Mark,
}

impl Block {
    /// The place when so much of it is done.
    fn place(&self, part: f64) -> [f64; AXES] {
        std::array::from_fn(|axis| self.start[axis] + self.delta[axis] * part)
    }
}

/// Short blocks that are measured together.
#[derive(Clone, Copy, Debug, Default)]
struct Pending {
    from: [f64; AXES],
    to: [f64; AXES],
    length: f64,
    rapid: bool,
}

/// The end of a segment.
#[derive(Clone, Copy, Debug)]
struct Node {
    time: f64,
    /// Way to here along the path, without the excess.
    way: f64,
    /// Sum of the doubt.
    doubt: f64,
    place: [f64; AXES],
    error: f64,
    /// Number of its block, and how wrong the block's length may be, as a part of it.
    block: u64,
    wrong: f64,
}

/// What is known of the way between two nodes.
#[derive(Clone, Copy, Debug)]
struct Way {
    time: f64,
    length: f64,
    /// How wrong the length may be, in mm.
    error: f64,
}

impl Way {
    fn speed(self) -> f64 {
        self.length / self.time
    }

    /// How wrong the length may be, as a part of it.
    fn wrong(self) -> f64 {
        if self.length > 0.0 { self.error / self.length } else { f64::INFINITY }
    }
}

impl Node {
    /// Along the path.
    fn along(&self, to: &Node) -> Way {
        let (time, length) = (to.time - self.time, to.way - self.way);
        let error =
            if self.block == to.block { length * to.wrong } else { self.error + to.error + (to.doubt - self.doubt) };
        Way { time, length, error }
    }

    /// In a straight line: the shortest that the way can have been.
    fn straight(&self, to: &Node) -> Way {
        Way { time: to.time - self.time, length: distance(&self.place, &to.place), error: self.error + to.error }
    }
}

fn distance(a: &[f64; AXES], b: &[f64; AXES]) -> f64 {
    a.iter().zip(b).map(|(a, b)| (b - a) * (b - a)).sum::<f64>().sqrt()
}

/// A measured value without what may be error, if that is more than a tolerated part of it.
fn certain(value: f64, error: f64, tolerance: f64) -> f64 {
    (value - (error - value * tolerance).max(0.0)).max(0.0)
}

/// Follows the step task segment by segment.
#[derive(Clone, Debug)]
pub struct Meter {
    /// The next sample is the first of its block.
    fresh: bool,
    hz: f64,
    steps_per_mm: [f64; AXES],
    arrangement: Arrangement,
    /// What has been told of A, B and C in the block that follows.
    rest: Option<[AxisSteps; 3]>,
    next_block: Option<Coming>,
    upcoming: VecDeque<(Segment, Option<Coming>)>,
    block: Block,
    units_done: f64,
    waited: f64,
    /// Ends of the last segments since rest.
    nodes: VecDeque<Node>,
    /// Segments since power-up, and those since the last change between rapids and feeds.
    segments: usize,
    alike: usize,
    rapid: bool,
    /// Short blocks whose length is not yet counted.
    pending: Pending,
    measured: Measured,
    times: Times,
    drawing: Option<Drawing>,
}

impl Meter {
    /// A meter for a step clock of `hz`.
    pub fn new(hz: u32) -> Self {
        Self {
            fresh: true,
            hz: f64::from(hz.max(1)),
            steps_per_mm: [1.0; AXES],
            arrangement: Arrangement::Cartesian,
            rest: None,
            next_block: None,
            upcoming: VecDeque::new(),
            block: Block::default(),
            units_done: 0.0,
            waited: 0.0,
            nodes: VecDeque::with_capacity(2 * LONGEST_WINDOW + 2),
            segments: 0,
            alike: 0,
            rapid: false,
            pending: Pending::default(),
            measured: Measured::default(),
            times: Times::default(),
            drawing: None,
        }
    }

    /// What a step is worth from the next block on.
    pub fn set_resolution(&mut self, steps_per_mm: [f64; AXES], arrangement: Arrangement) {
        self.steps_per_mm = steps_per_mm;
        self.arrangement = arrangement;
    }

    /// The place of the tool in mm when the motors stand at these steps.
    pub fn millimetres(&self, steps: [i32; AXES]) -> [f64; AXES] {
        self.place_of(steps.map(f64::from))
    }

    /// Steps of the motors at a place of the carriages in mm, to the nearest.
    pub fn steps_of(&self, places: [f64; AXES]) -> [i32; AXES] {
        let mut motors = places;
        if self.arrangement == Arrangement::CoreXy {
            let [x, y, ..] = places;
            (motors[0], motors[1]) = (x + y, x - y);
        }
        std::array::from_fn(|motor| (motors[motor] * self.steps_per_mm[motor]).round() as i32)
    }

    /// So many steps in mm: 0 with a resolution of 0, which locks motion, as in the controller's reports.
    fn way(&self, axis: usize, steps: f64) -> f64 {
        let per_mm = self.steps_per_mm[axis];
        if per_mm > 0.0 { steps / per_mm } else { 0.0 }
    }

    fn place_of(&self, steps: [f64; AXES]) -> [f64; AXES] {
        let mut places: [f64; AXES] = std::array::from_fn(|motor| self.way(motor, steps[motor]));
        if self.arrangement == Arrangement::CoreXy {
            let [a, b, ..] = places;
            (places[0], places[1]) = (0.5 * (a + b), 0.5 * (a - b));
        }
        places
    }

    /// The place in mm of carriages as [`crate::machine::Machine::extents`] counts them.
    pub fn carriages_mm(&self, counts: [i32; AXES]) -> [f64; AXES] {
        let mut places: [f64; AXES] = std::array::from_fn(|axis| self.way(axis, f64::from(counts[axis])));
        if self.arrangement == Arrangement::CoreXy {
            let [x, y, ..] = places;
            (places[0], places[1]) = (0.5 * x, 0.5 * y);
        }
        places
    }

    /// Also collects what a drawing needs.
    pub fn draw(&mut self, drawing: Drawing) {
        self.drawing = Some(drawing);
    }

    /// What has been collected for a drawing.
    pub fn drawing(&self) -> Option<&Drawing> {
        self.drawing.as_ref()
    }

    /// The collected drawing.
    pub fn take_drawing(&mut self) -> Option<Drawing> {
        self.drawing.take()
    }

    /// What was measured since power-up or the last [`Meter::restart`].
    pub fn measured(&self) -> Measured {
        self.measured
    }

    /// Times since power-up or the last [`Meter::restart`].
    pub fn times(&self) -> &Times {
        &self.times
    }

    /// The same, to have waits added.
    pub fn times_mut(&mut self) -> &mut Times {
        &mut self.times
    }

    /// Restarts the measurement.
    pub fn restart(&mut self) {
        self.measured = Measured::default();
        self.times = Times::default();
    }

    /// A message was loaded into the step task. `mark` is what its move belongs to, if moves are marked.
    pub fn loaded(&mut self, message: &ToStep, mark: Mark) {
        match message {
            ToStep::BlockRest { steps_by_axis } => self.rest = Some(*steps_by_axis),
            ToStep::Block { steps_by_axis, directions } => {
                let mut all = [AxisSteps::default(); AXES];
                let rest = self.rest.take().unwrap_or_default();
                for (own, told) in all.iter_mut().zip(steps_by_axis.iter().chain(&rest)) {
                    *own = *told;
                }
                self.next_block = Some(Coming { steps_by_axis: all, directions: *directions, entered: 0, mark });
            }
            ToStep::Reenter { units } => {
                if let Some(block) = &mut self.next_block {
                    block.entered = *units;
                }
            }
            ToStep::Segment(segment) => {
                let block = if segment.flags & Segment::FLAG_NEW_BLOCK != 0 { self.next_block.take() } else { None };
                self.upcoming.push_back((*segment, block));
            }
            _ => {}
        }
    }

    /// The step task stopped and forgot what it had.
    pub fn stopped(&mut self, seconds: f64) {
        self.upcoming.clear();
        self.next_block = None;
        self.at_rest(seconds);
    }

    /// The step task came to rest.
    pub fn at_rest(&mut self, seconds: f64) {
        self.nodes.clear();
        self.count_pending();
        self.waited = 0.0;
        if let Some(drawing) = &mut self.drawing {
            drawing.rest(seconds);
        }
    }

    /// The step task began the next segment at `seconds`; `position` is where the machine is.
    pub fn begin(&mut self, seconds: f64, position: [i32; AXES]) {
        let Some((segment, block)) = self.upcoming.pop_front() else { return };
        if let Some(block) = block {
            self.new_block(block, position);
            // Held until something of the block is drawn: its first segment may be a wait.
            self.fresh = true;
        }
        let ticks = f64::from(segment.ticks);
        let fixed = ticks * f64::from(segment.interval) + f64::from(segment.ramp) * ticks * (ticks - 1.0) / 2.0;
        let time = fixed / f64::from(1_u32 << INTERVAL_FRACTION_BITS) / self.hz;
        if segment.flags & Segment::FLAG_WAIT != 0 {
            self.waited += time;
            return;
        }
        if self.block.units <= 0.0 {
            return;
        }
        let units = ticks * f64::from(UNITS_PER_STEP >> segment.level);
        let part = units / self.block.units;
        let length = part * (self.block.length - self.block.excess);
        // Waits belong to the step that they put off.
        let waited = std::mem::take(&mut self.waited);
        let time = time + waited;
        let rapid = segment.flags & Segment::FLAG_RAPID != 0;
        let times = self.times.of(self.block.mark.tool);
        *if rapid { &mut times.rapid_s } else { &mut times.feed_s } += time;
        self.times.add_to_line(self.block.mark.line, time);
        if self.nodes.is_empty() {
            self.nodes.push_back(self.node(0.0, 0.0, 0.0, self.units_done / self.block.units));
        }
        let before = self.units_done / self.block.units;
        self.units_done += units;
        let done = (self.units_done / self.block.units).min(1.0);
        self.add_distance(length, [before, done], rapid);
        if let Some(last) = self.nodes.back() {
            let node = self.node(last.time + time, last.way + length, last.doubt + part * self.block.doubt, done);
            if self.nodes.len() > 2 * LONGEST_WINDOW {
                self.nodes.pop_front();
            }
            self.nodes.push_back(node);
        }
        self.segments += 1;
        self.alike = if rapid == self.rapid { self.alike + 1 } else { 1 };
        self.rapid = rapid;
        self.peak_speed();
        self.peak_acceleration();
        if self.drawing.is_some() {
            self.draw_segment(seconds - waited, time, rapid, done);
        }
    }

    /// Counts a piece of the block. A path in pieces of a step or two is a staircase, longer than the path that it
    /// follows, so some of them are counted together, as a straight line.
    fn add_distance(&mut self, length: f64, parts: [f64; 2], rapid: bool) {
        if !self.block.short || rapid != self.pending.rapid {
            self.count_pending();
        }
        let block = &self.block;
        if !block.short {
            self.measured.distance += length;
            self.measured.rapid_distance += if rapid { length } else { 0.0 };
            return;
        }
        if self.pending.length <= 0.0 {
            self.pending = Pending { from: block.place(parts[0]), rapid, ..Pending::default() };
        }
        self.pending.length += length;
        self.pending.to = block.place(parts[1]);
        if self.pending.length > TOGETHER * 2.0 * block.error {
            self.count_pending();
        }
    }

    fn count_pending(&mut self) {
        let Pending { from, to, length, rapid } = std::mem::take(&mut self.pending);
        let straight = distance(&from, &to);
        // Much shorter: the path turns there.
        let length = if straight >= length * 0.7 { straight } else { length };
        self.measured.distance += length;
        self.measured.rapid_distance += if rapid { length } else { 0.0 };
    }

    fn node(&self, time: f64, way: f64, doubt: f64, done: f64) -> Node {
        let block = &self.block;
        Node {
            time,
            way,
            doubt,
            place: block.place(done),
            error: block.error,
            block: block.number,
            wrong: if block.length > 0.0 { 2.0 * block.error / block.length } else { 0.0 },
        }
    }

    /// The last node, and the one before it by so many segments.
    fn window(&self, segments: usize) -> Option<(&Node, &Node)> {
        let last = self.nodes.len().checked_sub(1)?;
        Some((self.nodes.get(last.checked_sub(segments)?)?, self.nodes.get(last)?))
    }

    fn draw_segment(&mut self, seconds: f64, time: f64, rapid: bool, done: f64) {
        // The shortest window that is good enough for the eye, or else the longest.
        let mut known = None;
        for segments in scales().take_while(|segments| *segments <= self.alike) {
            let Some((from, to)) = self.window(segments) else { break };
            let (along, straight) = (from.along(to), from.straight(to));
            let way = if straight.wrong() < along.wrong() && straight.length > along.length { straight } else { along };
            if way.time > 0.0 {
                known = Some(way);
                if way.wrong() <= DRAWN_TOLERANCE {
                    break;
                }
            }
        }
        let (speed, window) = known.map_or((0.0, time), |way| (way.speed(), way.time));
        let sample = Sample {
            seconds,
            time,
            speed,
            known_at: seconds + time - window / 2.0,
            rapid,
            from: linear(self.block.start),
            to: linear(self.block.place(done)),
            new_block: std::mem::take(&mut self.fresh),
            mark: self.block.mark,
        };
        if let Some(drawing) = &mut self.drawing {
            drawing.add(sample);
        }
    }

    fn peak_speed(&mut self) {
        let mut measured = self.measured;
        for segments in due_scales(self.segments) {
            let Some((from, to)) = self.window(segments) else { break };
            let along = from.along(to);
            if along.time <= 0.0 {
                continue;
            }
            if along.length + along.error > measured.speed * along.time {
                for way in [along, from.straight(to)] {
                    measured.speed = measured.speed.max(certain(way.length, way.error, SPEED_TOLERANCE) / way.time);
                }
            }
            for axis in 0..AXES {
                let length = (to.place[axis] - from.place[axis]).abs();
                if length <= measured.axis_speed[axis] * along.time {
                    continue;
                }
                let error = 2.0 * ROUNDING * self.coarseness(axis);
                let whole = self.block.delta[axis].abs();
                let error = if from.block == to.block && whole > 0.0 { error * length / whole } else { error };
                let speed = certain(length, error, SPEED_TOLERANCE) / along.time;
                measured.axis_speed[axis] = measured.axis_speed[axis].max(speed);
            }
            // A longer window has no greater mean.
            if along.wrong() <= SPEED_TOLERANCE {
                break;
            }
        }
        self.measured = measured;
    }

    fn peak_acceleration(&mut self) {
        let mut measured = self.measured;
        for segments in due_scales(self.segments) {
            let (Some((middle, to)), Some((from, _))) = (self.window(segments), self.window(2 * segments)) else {
                break;
            };
            let (first, second) = (from.along(middle), middle.along(to));
            if first.time.min(second.time) < SHORTEST {
                continue;
            }
            let (mut acceleration, mut error) = change(first, second);
            let way = to.way - from.way;
            let part =
                |axis: usize| if way > 0.0 { ((to.place[axis] - from.place[axis]).abs() / way).min(1.0) } else { 0.0 };
            let parts: [f64; AXES] = std::array::from_fn(part);
            let mut peaks = parts.iter().zip(measured.axis_acceleration);
            if acceleration <= measured.acceleration && peaks.all(|(part, peak)| acceleration * part <= peak) {
                // A longer window has no greater mean; but short blocks may hide it.
                if error <= acceleration * ACCELERATION_TOLERANCE {
                    break;
                }
                continue;
            }
            if from.block == to.block {
                error = acceleration * to.wrong;
            } else {
                // On a line the places tell the length better than a sum of short blocks.
                let (one, two, all) = (from.straight(middle), middle.straight(to), from.straight(to));
                let sum = one.length + two.length;
                if sum - all.length <= sum * STRAIGHT && sum >= (first.length + second.length) * 0.9 {
                    let (other, other_error) = change(one, two);
                    if other_error < error {
                        (acceleration, error) = (other, other_error);
                    }
                }
            }
            let least = certain(acceleration, error, ACCELERATION_TOLERANCE);
            measured.acceleration = measured.acceleration.max(least);
            for (peak, part) in measured.axis_acceleration.iter_mut().zip(parts) {
                *peak = peak.max(least * part);
            }
            if error <= acceleration * ACCELERATION_TOLERANCE {
                break;
            }
        }
        self.measured = measured;
    }

    /// How far a step of each motor moves an axis together, in mm.
    fn coarseness(&self, axis: usize) -> f64 {
        let other = 1 - axis.min(1);
        match self.arrangement {
            Arrangement::CoreXy if axis < 2 => 0.5 / self.steps_per_mm[axis] + 0.5 / self.steps_per_mm[other],
            _ => 1.0 / self.steps_per_mm[axis],
        }
    }

    fn new_block(&mut self, block: Coming, position: [i32; AXES]) {
        let Coming { steps_by_axis, directions, entered, mark } = block;
        let sign = |motor: usize| if directions & (1 << motor) != 0 { -1.0 } else { 1.0 };
        // The ends are told in the direction of motion, and to positive where there is no motion.
        let way = |motor: usize| if steps_by_axis[motor].steps() == 0 { 1.0 } else { sign(motor) };
        let told = |parts: i32| f64::from(parts) / f64::from(AxisSteps::PARTS);
        let delta = self.place_of(std::array::from_fn(|motor| {
            let axis_steps = steps_by_axis[motor];
            sign(motor) * f64::from(axis_steps.steps()) + way(motor) * told(axis_steps.end() - axis_steps.start())
        }));
        let length = delta.iter().map(|d| d * d).sum::<f64>().sqrt();
        let unit = delta.map(|d| if length > 0.0 { d / length } else { 0.0 });
        // How much a step of each motor moves the tool along the path.
        let steps: [f64; AXES] = std::array::from_fn(|motor| {
            let moved = self.place_of(std::array::from_fn(|other| if other == motor { 1.0 } else { 0.0 }));
            (0..AXES).map(|axis| moved[axis] * unit[axis]).sum::<f64>().abs()
        });
        let error = ROUNDING * steps.iter().sum::<f64>();
        let step = steps.iter().copied().fold(0.0, f64::max);
        let short = length < SHORT * step;
        // Two ends, each even over a range of 2 r across the path, are apart by r² 2/3 in the mean square.
        let across =
            step * if steps_by_axis.iter().all(|axis_steps| axis_steps.is_on_steps()) { ROUNDING } else { TOLD };
        let excess = if length < LONG * step { (across * across / (3.0 * length)).min(length * 0.1) } else { 0.0 };
        let doubt = if short { length * 0.3 } else { excess };
        let units = f64::from(steps_by_axis.iter().map(|axis_steps| axis_steps.steps()).max().unwrap_or(0))
            * f64::from(UNITS_PER_STEP);
        let start = match entered {
            0 => self.place_of(std::array::from_fn(|motor| {
                f64::from(position[motor]) + way(motor) * told(steps_by_axis[motor].start())
            })),
            entered => {
                let here = self.millimetres(position);
                std::array::from_fn(|axis| here[axis] - delta[axis] * f64::from(entered) / units)
            }
        };
        let number = self.block.number + 1;
        self.block = Block { start, delta, units, length, excess, doubt, error, short, number, mark };
        self.units_done = f64::from(entered);
    }
}

/// Lengths of windows, in segments.
fn scales() -> impl Iterator<Item = usize> {
    std::iter::successors(Some(1), |segments| Some(segments * 2)).take_while(|segments| *segments <= LONGEST_WINDOW)
}

/// Lengths of the windows to look at after so many segments: a long one four times in its length.
fn due_scales(segments: usize) -> impl Iterator<Item = usize> {
    scales().filter(move |scale| segments.is_multiple_of((scale / 4).max(1)))
}

/// Change of speed per time between two neighbouring ways, and how wrong it may be.
fn change(first: Way, second: Way) -> (f64, f64) {
    let per = 2.0 / (first.time + second.time);
    ((second.speed() - first.speed()).abs() * per, (first.error / first.time + second.error / second.time) * per)
}

#[cfg(test)]
mod tests {
    use super::*;
    use oxmill_controller::messages::AxisSteps;

    fn segment(interval: u32, ticks: u16, flags: u8) -> ToStep {
        let interval = interval << INTERVAL_FRACTION_BITS;
        ToStep::Segment(Segment { interval, ramp: 0, ticks, power: 0, level: 0, flags })
    }

    #[test]
    fn distance_and_speed_come_from_the_segments() {
        let mut meter = Meter::new(1_000_000);
        meter.set_resolution([100.0, 100.0, 400.0, 1.0], Arrangement::Cartesian);
        // 3 mm and -4 mm: 5 mm in 400 ticks. 100 ticks of 2 ms, then 300 of 1 ms.
        for message in [
            ToStep::Block { steps_by_axis: [300, 400, 0].map(AxisSteps::on_steps), directions: 0b010 },
            segment(2000, 100, Segment::FLAG_NEW_BLOCK),
            segment(1000, 300, Segment::FLAG_LAST),
        ] {
            meter.loaded(&message, Mark::default());
        }
        meter.begin(0.0, [0; AXES]);
        meter.begin(0.2, [75, -100, 0, 0]);
        let m = meter.measured();
        assert!((m.distance - 5.0).abs() < 1e-9);
        assert!((m.speed - 12.5).abs() < 1e-9);
        assert!((m.axis_speed[1] - 10.0).abs() < 1e-9);
        assert!((m.acceleration - 6.25 / 0.25).abs() < 1e-9);
    }

    #[test]
    fn waiting_slows_the_next_segment() {
        let mut meter = Meter::new(1_000_000);
        meter.loaded(
            &ToStep::Block { steps_by_axis: [1000, 0, 0].map(AxisSteps::on_steps), directions: 0 },
            Mark::default(),
        );
        meter.loaded(&segment(500_000, 1000, Segment::FLAG_NEW_BLOCK | Segment::FLAG_WAIT), Mark::default());
        meter.loaded(&segment(500_000, 1000, Segment::FLAG_LAST), Mark::default());
        meter.begin(0.0, [0; AXES]);
        meter.begin(500.0, [0; AXES]);
        meter.at_rest(1000.0);
        assert!((meter.measured().speed - 1.0).abs() < 1e-9);
    }
}
