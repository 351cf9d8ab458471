//! Measures the motion of the tool: distances, times, and peak speeds and accelerations. Uses the blocks and segments
//! that the step task executed. Also takes samples for the drawing.
//!
//! A block is a straight move and gives the steps of each axis. A segment is a part of a block: it gives how many units
//! the machine advances in the block, and how long that takes. One step of the axis with the most steps has
//! `UNITS_PER_STEP` units. Nothing here is computed per step.
//!
//! The ends of a block are rounded to steps, so the length of a short block is uncertain: in a block of 25 steps, half
//! a step at each end is 4 %. Speeds and accelerations are therefore averaged over windows of one to `LONGEST_WINDOW`
//! segments, across blocks, and reduced by what rounding may have added. The remaining value was certainly reached.

use crate::boards::AXES;
use crate::machine::linear;
use crate::marks::Mark;
use crate::path::{Drawing, Sample};
use crate::tool_times::Times;
use oxmill_controller::axes::Arrangement;
use oxmill_controller::messages::{AxisSteps, INTERVAL_FRACTION_BITS, Segment, ToStep, UNITS_PER_STEP};
use std::collections::VecDeque;

/// Minimum window for measuring acceleration, in seconds. In shorter windows the rounding of ticks has too much
/// influence.
const SHORTEST: f64 = 0.0002;
/// Number of segments in the longest window.
const LONGEST_WINDOW: usize = 1024;
/// Acceptable rounding error of a peak speed, as a fraction of the speed. If the error is larger, the part of it above
/// this fraction is subtracted from the speed (see [`certain`]).
const SPEED_TOLERANCE: f64 = 0.005;
/// Acceptable rounding error of a peak acceleration, as a fraction of the acceleration; used like [`SPEED_TOLERANCE`].
const ACCELERATION_TOLERANCE: f64 = 0.02;
/// Acceptable rounding error of a speed in a drawing, as a fraction of the speed. The error is mostly smaller. A lower
/// value would need longer windows, which would blur the motion after a short block.
const DRAWN_TOLERANCE: f64 = 0.06;
/// Maximum rounding error of each end of a block, in steps: an end is at most half a step from the whole step to which
/// it is rounded. The time that the planner gives to a block is rounded to the same degree.
const ROUNDING: f64 = 0.5;
/// Like [`ROUNDING`], for the pieces of an arc: the controller gives their ends in sevenths of a step.
const ARC_ROUNDING: f64 = 0.5 / AxisSteps::PARTS as f64;
/// In blocks shorter than this many steps, rounding makes the length too uncertain: several blocks are measured
/// together.
const SHORT: f64 = 4.0;
/// Rounding to steps also moves the ends of a block sideways, which makes the block longer. In blocks of at least this
/// many steps, the added length is below 0.01 % and is not subtracted.
const LONG: f64 = 32.0;
/// Consecutive short blocks are measured together until they have this many steps.
const TOGETHER: f64 = 12.0;
/// Two neighbouring windows count as one straight line if the sum of their lengths exceeds the direct distance between
/// the outer ends by at most this fraction. For windows of equal length, the direction then changes by less than 0.13
/// rad.
const STRAIGHT: f64 = 0.002;

/// Results of a job, in mm and s.
///
/// Peaks are averages over windows of several segments, reduced by what rounding to steps may have added. In long
/// blocks the window is a single segment.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Measured {
    /// Length of the path.
    pub distance: f64,
    /// Length of the rapids in the path.
    pub rapid_distance: f64,
    /// Maximum path speed.
    pub speed: f64,
    /// Maximum change of path speed per time, as on ramps. Excludes the acceleration across the path in curves and
    /// corners.
    pub acceleration: f64,
    /// Maximum speed of each axis, in mm/s.
    pub axis_speed: [f64; AXES],
    /// Maximum acceleration of each axis on ramps: the change of path speed per time, times the share of the axis in
    /// the path's direction. Example: on a diagonal in X and Y, each axis has 0.71 of the path's acceleration.
    pub axis_acceleration: [f64; AXES],
}

/// A block that was loaded into the step task but has not started.
#[derive(Clone, Copy, Debug)]
struct Coming {
    steps_by_axis: [AxisSteps; AXES],
    /// Bit mask of the axes that move in the negative direction.
    directions: u8,
    /// Number of units of the block that were executed before an interruption. The block continues after these units.
    /// A new block has 0.
    entered: u32,
    /// The line and tool of the block, if `Simulator::mark_moves` was called.
    mark: Mark,
}

#[derive(Clone, Copy, Debug, Default)]
struct Block {
    start: [f64; AXES],
    delta: [f64; AXES],
    units: f64,
    length: f64,
    /// Average length, in mm, that rounding adds to the block by moving its ends sideways.
    excess: f64,
    /// Uncertainty of `length - excess`, in mm, that the sideways rounding causes.
    doubt: f64,
    /// Maximum distance by which rounding moves each end of the block along the path, in mm.
    error: f64,
    /// Whether the block is shorter than [`SHORT`] steps.
    short: bool,
    number: u64,
    mark: Mark,
}

impl Block {
    /// Returns the position when the fraction `part` of the block is done.
    fn place(&self, part: f64) -> [f64; AXES] {
        std::array::from_fn(|axis| self.start[axis] + self.delta[axis] * part)
    }
}

/// Consecutive short blocks that are measured together.
#[derive(Clone, Copy, Debug, Default)]
struct Pending {
    from: [f64; AXES],
    to: [f64; AXES],
    length: f64,
    rapid: bool,
}

/// The end of a segment: a time, and the way and the position reached at that time.
#[derive(Clone, Copy, Debug)]
struct Node {
    time: f64,
    /// Length of the path since the machine was last at rest, in mm, without the `excess` of the blocks.
    way: f64,
    /// Uncertainty of `way`: sum of the `doubt` of the blocks since the machine was last at rest.
    doubt: f64,
    place: [f64; AXES],
    error: f64,
    /// Serial number of the block that the segment belongs to.
    block: u64,
    /// Uncertainty of the block's length, as a fraction of the length.
    wrong: f64,
}

/// Distance and time between two nodes (ends of segments).
#[derive(Clone, Copy, Debug)]
struct Way {
    time: f64,
    length: f64,
    /// Uncertainty of the length, in mm.
    error: f64,
}

impl Way {
    fn speed(self) -> f64 {
        self.length / self.time
    }

    /// Returns the uncertainty of the length as a fraction of the length: 0.01 is 1 %.
    fn wrong(self) -> f64 {
        if self.length > 0.0 { self.error / self.length } else { f64::INFINITY }
    }
}

impl Node {
    /// Returns the length of the path from this node to a later one, and the time between them.
    fn along(&self, to: &Node) -> Way {
        let (time, length) = (to.time - self.time, to.way - self.way);
        let error =
            if self.block == to.block { length * to.wrong } else { self.error + to.error + (to.doubt - self.doubt) };
        Way { time, length, error }
    }

    /// Returns the straight distance from this node to a later one, and the time between them. The path is at least as
    /// long.
    fn straight(&self, to: &Node) -> Way {
        Way { time: to.time - self.time, length: distance(&self.place, &to.place), error: self.error + to.error }
    }
}

fn distance(a: &[f64; AXES], b: &[f64; AXES]) -> f64 {
    a.iter().zip(b).map(|(a, b)| (b - a) * (b - a)).sum::<f64>().sqrt()
}

/// Returns `value` minus the part of `error` that exceeds `value * tolerance`, at least 0. Example: 100 with an error
/// of 3 and a tolerance of 0.02 becomes 99.
fn certain(value: f64, error: f64, tolerance: f64) -> f64 {
    (value - (error - value * tolerance).max(0.0)).max(0.0)
}

/// The meter: receives the segments of the step task one by one, and sums up what they do.
#[derive(Clone, Debug)]
pub struct Meter {
    /// `true` if the next sample for the drawing is the first of its block.
    fresh: bool,
    hz: f64,
    steps_per_mm: [f64; AXES],
    arrangement: Arrangement,
    /// Steps of A, B and C of the next block, which arrive before that block. `None` if all of them are 0.
    rest: Option<[AxisSteps; 3]>,
    next_block: Option<Coming>,
    upcoming: VecDeque<(Segment, Option<Coming>)>,
    block: Block,
    units_done: f64,
    waited: f64,
    /// The most recent segment ends, enough for two neighbouring windows of the longest kind. Cleared when the machine
    /// comes to rest.
    nodes: VecDeque<Node>,
    /// Number of segments since power-up.
    segments: usize,
    /// Number of segments since the last change between rapids and feeds.
    alike: usize,
    rapid: bool,
    /// Short blocks whose length has not been counted yet.
    pending: Pending,
    measured: Measured,
    times: Times,
    drawing: Option<Drawing>,
}

impl Meter {
    /// Creates a meter for a step clock of `hz` ticks per second.
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

    /// Sets the resolution and kinematics from the next block on.
    pub fn set_resolution(&mut self, steps_per_mm: [f64; AXES], arrangement: Arrangement) {
        self.steps_per_mm = steps_per_mm;
        self.arrangement = arrangement;
    }

    /// Returns the tool position in mm for motor positions in steps.
    pub fn millimetres(&self, steps: [i32; AXES]) -> [f64; AXES] {
        self.place_of(steps.map(f64::from))
    }

    /// Returns the motor positions for a position of the carriages in mm, rounded to steps.
    pub fn steps_of(&self, places: [f64; AXES]) -> [i32; AXES] {
        let mut motors = places;
        if self.arrangement == Arrangement::CoreXy {
            let [x, y, ..] = places;
            (motors[0], motors[1]) = (x + y, x - y);
        }
        std::array::from_fn(|motor| (motors[motor] * self.steps_per_mm[motor]).round() as i32)
    }

    /// Converts steps to mm. Returns 0 for a resolution of 0 (which locks motion), as in the controller's reports.
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

    /// Converts carriage positions as counted by [`crate::machine::Machine::extents`] to mm.
    pub fn carriages_mm(&self, counts: [i32; AXES]) -> [f64; AXES] {
        let mut places: [f64; AXES] = std::array::from_fn(|axis| self.way(axis, f64::from(counts[axis])));
        if self.arrangement == Arrangement::CoreXy {
            let [x, y, ..] = places;
            (places[0], places[1]) = (0.5 * x, 0.5 * y);
        }
        places
    }

    /// Collects samples for `drawing` from now on, in addition to the measurements.
    pub fn draw(&mut self, drawing: Drawing) {
        self.drawing = Some(drawing);
    }

    /// The drawing collected so far; `None` if [`Meter::draw`] was not called.
    pub fn drawing(&self) -> Option<&Drawing> {
        self.drawing.as_ref()
    }

    /// Removes and returns the collected drawing; `None` if [`Meter::draw`] was not called. Collecting ends.
    pub fn take_drawing(&mut self) -> Option<Drawing> {
        self.drawing.take()
    }

    /// Results since power-up or the last [`Meter::restart`].
    pub fn measured(&self) -> Measured {
        self.measured
    }

    /// Times since power-up or the last [`Meter::restart`].
    pub fn times(&self) -> &Times {
        &self.times
    }

    /// The times of [`Meter::times`], for the simulator, which adds dwells and spindle delays.
    pub fn times_mut(&mut self) -> &mut Times {
        &mut self.times
    }

    /// Sets all results and times to zero.
    pub fn restart(&mut self) {
        self.measured = Measured::default();
        self.times = Times::default();
    }

    /// Call for each message that is loaded into the step task. `mark` is the line and tool of its move, if
    /// `Simulator::mark_moves` was called.
    pub fn loaded(&mut self, message: &ToStep, mark: Mark) {
        match message {
            ToStep::BlockRest { steps_by_axis } => self.rest = Some(*steps_by_axis),
            ToStep::Block { steps_by_axis, directions } => {
                let mut all = [AxisSteps::default(); AXES];
                let rest = self.rest.take().unwrap_or_default();
                for (own, received) in all.iter_mut().zip(steps_by_axis.iter().chain(&rest)) {
                    *own = *received;
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

    /// Call when the step task has stopped and cleared its queue, at `seconds` of virtual time.
    pub fn stopped(&mut self, seconds: f64) {
        self.upcoming.clear();
        self.next_block = None;
        self.at_rest(seconds);
    }

    /// Call when the step task has come to rest, at `seconds` of virtual time.
    pub fn at_rest(&mut self, seconds: f64) {
        self.nodes.clear();
        self.count_pending();
        self.waited = 0.0;
        if let Some(drawing) = &mut self.drawing {
            drawing.rest(seconds);
        }
    }

    /// Call when the step task has started the next segment, at `seconds` of virtual time and at the motor positions
    /// `position`.
    pub fn begin(&mut self, seconds: f64, position: [i32; AXES]) {
        let Some((segment, block)) = self.upcoming.pop_front() else { return };
        if let Some(block) = block {
            self.new_block(block, position);
            // `fresh` stays set until a segment of the block is drawn, because the first segment can be a mere pause.
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
        // Pauses before a segment (`FLAG_WAIT`) make it slower, so they count as time of the segment.
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

    /// Adds a segment of `length` mm to the measured distances. `parts`: the fractions of its block at which the
    /// segment begins and ends. Blocks shorter than [`SHORT`] steps form a staircase, which is longer than the
    /// programmed path. So consecutive short blocks are counted as one straight line.
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
        // If the straight line is much shorter than the sum of the blocks, the path turns within them: count the sum.
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

    /// Returns the two ends of the window over the last `segments` segments; `None` if there are not so many.
    fn window(&self, segments: usize) -> Option<(&Node, &Node)> {
        let last = self.nodes.len().checked_sub(1)?;
        Some((self.nodes.get(last.checked_sub(segments)?)?, self.nodes.get(last)?))
    }

    fn draw_segment(&mut self, seconds: f64, time: f64, rapid: bool, done: f64) {
        // Use the shortest window that is accurate enough for a drawing. If none is, use the longest.
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
            // This window is accurate enough. A longer window consists of windows of this length, so its mean speed
            // cannot exceed their maximum.
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
                // No new peak. If this window is accurate enough, stop: longer windows consist of windows of this
                // length and show no higher value. Otherwise try a longer window, because rounding in short blocks can
                // hide an acceleration in this one.
                if error <= acceleration * ACCELERATION_TOLERANCE {
                    break;
                }
                continue;
            }
            if from.block == to.block {
                error = acceleration * to.wrong;
            } else {
                // On a straight line the positions give a more accurate length than the sum of short blocks.
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

    /// Returns how far an axis moves at most if each of its motors makes one step, in mm.
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
        // `AxisSteps` gives the fraction of a step at each end of the block. A positive fraction points in the motor's
        // direction of motion or, if the motor makes no step, in the positive direction.
        let way = |motor: usize| if steps_by_axis[motor].steps() == 0 { 1.0 } else { sign(motor) };
        let in_steps = |parts: i32| f64::from(parts) / f64::from(AxisSteps::PARTS);
        let delta = self.place_of(std::array::from_fn(|motor| {
            let axis_steps = steps_by_axis[motor];
            sign(motor) * f64::from(axis_steps.steps()) + way(motor) * in_steps(axis_steps.end() - axis_steps.start())
        }));
        let length = delta.iter().map(|d| d * d).sum::<f64>().sqrt();
        let unit = delta.map(|d| if length > 0.0 { d / length } else { 0.0 });
        // For each motor: the distance, in mm, by which a step moves the tool along the path.
        let steps: [f64; AXES] = std::array::from_fn(|motor| {
            let moved = self.place_of(std::array::from_fn(|other| if other == motor { 1.0 } else { 0.0 }));
            (0..AXES).map(|axis| moved[axis] * unit[axis]).sum::<f64>().abs()
        });
        let error = ROUNDING * steps.iter().sum::<f64>();
        let step = steps.iter().copied().fold(0.0, f64::max);
        let short = length < SHORT * step;
        // Rounding moves each end sideways by a distance between -r and r, where r is `across` in mm. All these
        // distances are equally likely. So the mean square of the sideways offset d between both ends is 2/3 r^2. The
        // offset makes a block of length L longer by d^2 / 2L, on average by r^2 / 3L.
        let across = step
            * if steps_by_axis.iter().all(|axis_steps| axis_steps.is_on_steps()) { ROUNDING } else { ARC_ROUNDING };
        let excess = if length < LONG * step { (across * across / (3.0 * length)).min(length * 0.1) } else { 0.0 };
        let doubt = if short { length * 0.3 } else { excess };
        let units = f64::from(steps_by_axis.iter().map(|axis_steps| axis_steps.steps()).max().unwrap_or(0))
            * f64::from(UNITS_PER_STEP);
        let start = match entered {
            0 => self.place_of(std::array::from_fn(|motor| {
                f64::from(position[motor]) + way(motor) * in_steps(steps_by_axis[motor].start())
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

/// Returns the lengths of the averaging windows, in segments: 1, 2, 4 and so on up to `LONGEST_WINDOW`.
fn scales() -> impl Iterator<Item = usize> {
    std::iter::successors(Some(1), |segments| Some(segments * 2)).take_while(|segments| *segments <= LONGEST_WINDOW)
}

/// Returns the lengths of the windows that are evaluated after segment number `segments`. Long windows are evaluated
/// less often: a window of 16 segments only after every fourth segment.
fn due_scales(segments: usize) -> impl Iterator<Item = usize> {
    scales().filter(move |scale| segments.is_multiple_of((scale / 4).max(1)))
}

/// Returns the acceleration between two consecutive windows, from their mean speeds, and its uncertainty, in mm/s².
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
        // X moves 3 mm and Y -4 mm, so the path is 5 mm: 100 ticks of 2 ms, then 300 ticks of 1 ms.
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
