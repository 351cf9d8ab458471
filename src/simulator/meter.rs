//! How far and how fast the tool went, measured on the blocks and segments that the step task executed.
//!
//! A segment says how many units of its block it advances and in how many ticks of the step clock, and a block how many
//! steps each axis takes: so path speed is known without the noise that counting steps in a window would have. Nothing
//! here is done per step.

use crate::boards::AXES;
use crate::path::{Drawing, Sample};
use oxmill_controller::axes::Arrangement;
use oxmill_controller::messages::{INTERVAL_FRACTION_BITS, Segment, ToStep, UNITS_PER_STEP};
use std::collections::VecDeque;

/// Shortest segment that acceleration is measured on, in seconds. Below it the rounding of ticks is too large a part.
const SHORTEST: f64 = 0.0002;
/// Fewest steps of its dominant axis from which a move's length in steps is taken for its length: its ends are whole
/// steps, so that below 3 % of it may be rounding. Shorter moves are measured several together, and their acceleration
/// is not measured.
const LONG: f64 = 32.0;

/// What a job did, in mm and s.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Measured {
    /// Length of the path.
    pub distance: f64,
    /// Length of its rapids.
    pub rapid_distance: f64,
    /// Greatest path speed, mean over a segment (or over some short moves).
    pub speed: f64,
    /// Greatest change of path speed between neighbouring segments of a straight move, mm/s².
    pub acceleration: f64,
    /// The same for each axis.
    pub axis_speed: [f64; AXES],
    /// The same for each axis.
    pub axis_acceleration: [f64; AXES],
}

/// Unsigned steps of each axis, and the axes that go to negative.
type BlockSteps = ([u32; AXES], u8);

#[derive(Clone, Copy, Debug, Default)]
struct Block {
    start: [f64; AXES],
    delta: [f64; AXES],
    unit: [f64; AXES],
    units: f64,
    steps: f64,
    length: f64,
}

/// Short moves that are measured together.
#[derive(Clone, Copy, Debug, Default)]
struct Window {
    length: f64,
    time: f64,
    steps: f64,
}

/// Follows the step task segment by segment.
#[derive(Clone, Debug)]
pub struct Meter {
    /// The next sample is the first of its block.
    fresh: bool,
    hz: f64,
    steps_per_mm: [f64; AXES],
    arrangement: Arrangement,
    next_block: Option<BlockSteps>,
    upcoming: VecDeque<(Segment, Option<BlockSteps>)>,
    block: Block,
    units_done: f64,
    waited: f64,
    /// Mean speed and length in time of the segment before, of the same block.
    before: Option<(f64, f64)>,
    window: Window,
    /// Mean speed of the last window.
    window_speed: Option<f64>,
    measured: Measured,
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
            next_block: None,
            upcoming: VecDeque::new(),
            block: Block::default(),
            units_done: 0.0,
            waited: 0.0,
            before: None,
            window: Window::default(),
            window_speed: None,
            measured: Measured::default(),
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
        let [a, b, z] = std::array::from_fn(|motor| f64::from(steps[motor]) / self.steps_per_mm[motor]);
        match self.arrangement {
            Arrangement::Cartesian => [a, b, z],
            Arrangement::CoreXy => [0.5 * (a + b), 0.5 * (a - b), z],
        }
    }

    /// The place in mm of carriages as [`crate::machine::Machine::extents`] counts them.
    pub fn carriages_mm(&self, counts: [i32; AXES]) -> [f64; AXES] {
        let [x, y, z] = std::array::from_fn(|axis| f64::from(counts[axis]) / self.steps_per_mm[axis]);
        match self.arrangement {
            Arrangement::Cartesian => [x, y, z],
            Arrangement::CoreXy => [0.5 * x, 0.5 * y, z],
        }
    }

    /// Also collects what a drawing needs.
    pub fn draw(&mut self, drawing: Drawing) {
        self.drawing = Some(drawing);
    }

    /// The collected drawing.
    pub fn take_drawing(&mut self) -> Option<Drawing> {
        self.drawing.take()
    }

    /// What was measured since power-up or the last [`Meter::restart`].
    pub fn measured(&self) -> Measured {
        self.measured
    }

    /// Measures anew.
    pub fn restart(&mut self) {
        self.measured = Measured::default();
    }

    /// A message was loaded into the step task.
    pub fn loaded(&mut self, message: &ToStep) {
        match message {
            ToStep::Block { legs, directions } => {
                self.next_block = Some((std::array::from_fn(|axis| legs[axis].steps()), *directions));
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
        self.before = None;
        self.waited = 0.0;
        if self.window.time > 0.0 {
            let speed = self.close_window();
            self.peak_speed(speed);
        }
        self.window_speed = None;
        if let Some(drawing) = &mut self.drawing {
            drawing.rest(seconds);
        }
    }

    /// The step task began the next segment at `seconds`; `position` is where the machine is.
    pub fn begin(&mut self, seconds: f64, position: [i32; AXES]) {
        let Some((segment, block)) = self.upcoming.pop_front() else { return };
        if let Some((steps, directions)) = block {
            self.new_block(steps, directions, position);
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
        let length = units / self.block.units * self.block.length;
        // Waits belong to the step that they put off.
        let waited = std::mem::take(&mut self.waited);
        let time = time + waited;
        let rapid = segment.flags & Segment::FLAG_RAPID != 0;
        self.units_done += units;
        self.measured.distance += length;
        self.measured.rapid_distance += if rapid { length } else { 0.0 };
        let speed = if self.block.steps >= LONG {
            self.window = Window::default();
            self.window_speed = None;
            let speed = if time > 0.0 { length / time } else { 0.0 };
            self.peak_speed(speed);
            self.peak_acceleration(speed, time);
            speed
        } else {
            self.window.length += length;
            self.window.time += time;
            self.window.steps += units / f64::from(UNITS_PER_STEP);
            if self.window.steps >= LONG {
                let speed = self.close_window();
                self.peak_speed(speed);
                speed
            } else {
                self.window_speed.unwrap_or(self.window.length / self.window.time)
            }
        };
        if let Some(drawing) = &mut self.drawing {
            let done = (self.units_done / self.block.units).min(1.0);
            drawing.add(Sample {
                seconds: seconds - waited,
                time,
                speed,
                rapid,
                from: self.block.start,
                to: std::array::from_fn(|axis| self.block.start[axis] + self.block.delta[axis] * done),
                new_block: std::mem::take(&mut self.fresh),
            });
        }
    }

    fn close_window(&mut self) -> f64 {
        let window = std::mem::take(&mut self.window);
        let speed = window.length / window.time;
        self.window_speed = Some(speed);
        speed
    }

    fn peak_speed(&mut self, speed: f64) {
        self.measured.speed = self.measured.speed.max(speed);
        for (peak, unit) in self.measured.axis_speed.iter_mut().zip(self.block.unit) {
            *peak = peak.max(speed * unit);
        }
    }

    fn peak_acceleration(&mut self, speed: f64, time: f64) {
        if let Some((before, time_before)) = self.before
            && time.min(time_before) >= SHORTEST
        {
            let acceleration = (speed - before).abs() * 2.0 / (time + time_before);
            self.measured.acceleration = self.measured.acceleration.max(acceleration);
            for (peak, unit) in self.measured.axis_acceleration.iter_mut().zip(self.block.unit) {
                *peak = peak.max(acceleration * unit);
            }
        }
        self.before = Some((speed, time));
    }

    fn new_block(&mut self, steps: [u32; AXES], directions: u8, position: [i32; AXES]) {
        let start = self.millimetres(position);
        let motors = std::array::from_fn(|motor| {
            let steps = steps[motor] as i32;
            if directions & (1 << motor) != 0 { -steps } else { steps }
        });
        let delta = self.millimetres(motors);
        let length = delta.iter().map(|d| d * d).sum::<f64>().sqrt();
        let unit = delta.map(|d| if length > 0.0 { d.abs() / length } else { 0.0 });
        let dominant = steps.iter().copied().max().unwrap_or(0);
        let steps = f64::from(dominant);
        self.block = Block { start, delta, unit, units: steps * f64::from(UNITS_PER_STEP), steps, length };
        self.units_done = 0.0;
        self.before = None;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use oxmill_controller::messages::Leg;

    fn segment(interval: u32, ticks: u16, flags: u8) -> ToStep {
        let interval = interval << INTERVAL_FRACTION_BITS;
        ToStep::Segment(Segment { interval, ramp: 0, ticks, power: 0, level: 0, flags })
    }

    #[test]
    fn distance_and_speed_come_from_the_segments() {
        let mut meter = Meter::new(1_000_000);
        meter.set_resolution([100.0, 100.0, 400.0], Arrangement::Cartesian);
        // 3 mm and -4 mm: 5 mm in 400 ticks. 100 ticks of 2 ms, then 300 of 1 ms.
        for message in [
            ToStep::Block { legs: [300, 400, 0].map(Leg::on_steps), directions: 0b010 },
            segment(2000, 100, Segment::FLAG_NEW_BLOCK),
            segment(1000, 300, Segment::FLAG_LAST),
        ] {
            meter.loaded(&message);
        }
        meter.begin(0.0, [0, 0, 0]);
        meter.begin(0.2, [75, -100, 0]);
        let m = meter.measured();
        assert!((m.distance - 5.0).abs() < 1e-9);
        assert!((m.speed - 12.5).abs() < 1e-9);
        assert!((m.axis_speed[1] - 10.0).abs() < 1e-9);
        assert!((m.acceleration - 6.25 / 0.25).abs() < 1e-9);
    }

    #[test]
    fn waiting_slows_the_next_segment() {
        let mut meter = Meter::new(1_000_000);
        meter.loaded(&ToStep::Block { legs: [1, 0, 0].map(Leg::on_steps), directions: 0 });
        meter.loaded(&segment(500_000, 1, Segment::FLAG_NEW_BLOCK | Segment::FLAG_WAIT));
        meter.loaded(&segment(500_000, 1, Segment::FLAG_LAST));
        meter.begin(0.0, [0; AXES]);
        meter.begin(0.5, [0; AXES]);
        meter.at_rest(1.0);
        assert!((meter.measured().speed - 1.0).abs() < 1e-9);
    }
}
