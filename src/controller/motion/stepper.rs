//! The step generator (`Stepper`). Each call of `tick` returns one `Tick`: which axes step, the directions, and the
//! time to the next tick; `plain_ticks` computes many ticks at once. The stepper runs the current block and segment and
//! continues with the next ones without a gap. It stops immediately on request, and brakes at a probe's contact.
//!
//! Guarantees:
//! * No step without a segment.
//! * A queue that runs dry stops the pulses at once and is reported.
//! * After a stop nothing moves until the matching `Resume`.
//! * The position is exact at any tick.
//!
//! Done elsewhere: `dda` decides which axes step at a tick, `course` represents a block, and `contact` watches the
//! probe. `planner` and `segment` determine the acceleration. The task that writes the pins handles pulse widths and
//! direction set-up.
//!
//! The cost of a tick limits the machine's step rate. Therefore as much as possible is computed when a message is
//! loaded; a tick within a segment needs only the first words of the state, and no division.

use super::contact::{Contact, ProbeLatch, braked_interval};
use super::course::Course;
use super::dda;
use crate::axes::{LINEAR, PerAxis};
use crate::messages::{AxisSteps, INTERVAL_FRACTION_BITS, Segment, StepEvent, ToStep};

/// Finest AMASS smoothing level: a tick advances one unit (1/16 step of the axis with the most steps).
pub const MAX_LEVEL: u8 = 4;
/// Shift from the fraction bits of an interval to the 32 fraction bits of [`Stepper::moment`].
const FRACTION_SHIFT: u32 = 32 - INTERVAL_FRACTION_BITS;

/// What the step task must do at one tick of the step timer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Tick {
    /// Axes to step now, bit 0 for X.
    pub steps: u8,
    /// Direction levels for the *next* step (bit set = negative), to be written once this pulse has ended. They change
    /// only with the first tick of a segment.
    pub directions: u8,
    /// Step-clock ticks to the next tick; 0 = at rest.
    pub interval: u32,
    /// A segment begins with this tick; its power and directions apply from now on.
    pub begins: bool,
    /// The queue ran dry at speed; [`Stepper::underrun_event`] returns the report.
    pub underrun: bool,
}

/// A segment as the stepper executes it: the current one, or the next one, which is loaded ahead.
#[derive(Clone, Copy, Debug)]
#[repr(C)]
struct Piece<const N: usize> {
    /// For each axis, the amount by which a tick reduces the countdown to the next step (`Stepper::left`).
    increments: [u32; N],
    /// Number of remaining ticks that do nothing but step.
    plain_ticks: u32,
    /// Number of remaining ticks after the plain ones, which may do more than step: the last tick of the segment, or
    /// all of its ticks while a probe is watched. If no tick remains, the machine is at rest.
    rare_ticks: u32,
    /// Interval to the next tick: step-clock ticks with [`INTERVAL_FRACTION_BITS`] fraction bits.
    interval: u32,
    /// Change of `interval` from one tick to the next, in the same fixed point.
    ramp: i32,
    /// Number of units that a tick advances along the block. A unit is 1/16 step of the axis with the most steps.
    units_per_tick: u32,
    /// Progress at the end of the segment, in units from the start of the block.
    end_units: u32,
    power: u16,
    last: bool,
    new_block: bool,
}

/// State of the step generator. Fields are in order of use: a tick within a segment needs only the first ones.
#[derive(Clone, Debug)]
#[repr(C)]
pub struct Stepper<const N: usize> {
    /// Countdown of each axis to its next step (`dda`): 0 to `threshold` - 1.
    left: [u32; N],
    piece: Piece<N>,
    /// Added to the countdown of an axis when the axis steps; each block has its own value.
    threshold: u32,
    directions: u8,
    /// Which of the two `courses` is the current block: `false`: the first, `true`: the second. The other one is the
    /// next block.
    odd: bool,
    /// Time of the next tick: step-clock ticks in the upper 32 bits, their fraction in the lower 32 bits.
    moment: u64,
    latch: ProbeLatch,

    begun: u32,
    is_next: bool,
    next_piece: Piece<N>,
    courses: [Course<N>; 2],
    /// Steps of each axis in the next block, as received so far by [`ToStep::BlockRest`] and [`ToStep::Block`].
    steps_by_axis: [AxisSteps; N],
    /// Whether [`ToStep::BlockRest`], with the steps of A, B and C, has been received for the next block. Without it,
    /// these axes do not move in that block.
    has_rotary_steps: bool,
    /// Whether messages are discarded until the matching [`ToStep::Resume`].
    gate_shut: bool,
    stops: u16,
    /// Deceleration at a contact, units per squared step-clock tick.
    braking: f32,
    /// Whether the machine is braking after a contact.
    brakes: bool,
    /// Block and progress at the probe's contact, from which the position there is computed.
    touched: Contact<N>,
}

impl<const N: usize> Piece<N> {
    const REST: Self = Self {
        increments: [0; N],
        plain_ticks: 0,
        rare_ticks: 0,
        interval: 0,
        ramp: 0,
        units_per_tick: 0,
        end_units: 0,
        power: 0,
        last: true,
        new_block: false,
    };

    #[inline]
    fn ticks(&self) -> u32 {
        self.plain_ticks.wrapping_add(self.rare_ticks)
    }
}

impl<const N: usize> Default for Stepper<N> {
    fn default() -> Self {
        Self::new()
    }
}

impl<const N: usize> Stepper<N> {
    /// Creates a stepper at rest, at position 0. It accepts messages: its gate is open.
    pub const fn new() -> Self {
        Self {
            left: [0; N],
            piece: Piece::REST,
            threshold: 0,
            directions: 0,
            odd: false,
            moment: 0,
            latch: ProbeLatch::OFF,
            begun: 0,
            is_next: false,
            next_piece: Piece::REST,
            courses: [Course::NOWHERE; 2],
            steps_by_axis: [AxisSteps::on_steps(0); N],
            has_rotary_steps: false,
            gate_shut: false,
            stops: 0,
            braking: 0.0,
            brakes: false,
            touched: Contact::START,
        }
    }

    /// Returns whether one more message can be loaded: `true` as long as the next segment has not been loaded. The
    /// step task loads messages while this is `true`, then calls [`Stepper::tick`]. The first segment of a block
    /// takes two or more messages, any other segment one.
    #[inline]
    pub fn has_room(&self) -> bool {
        !self.is_next || self.latch.is_unnoted
    }

    /// Loads a message. Call only while [`Stepper::has_room`] returns `true`.
    #[inline]
    pub fn load(&mut self, message: ToStep) {
        if self.latch.is_unnoted {
            self.note_touch();
        }
        if self.gate_shut {
            if let ToStep::Resume { stops } = message {
                self.gate_shut = stops != self.stops;
            }
            return;
        }
        match message {
            ToStep::Segment(segment) => self.load_segment(&segment),
            ToStep::Block { steps_by_axis, directions } => {
                for (own, new) in self.steps_by_axis.iter_mut().zip(steps_by_axis) {
                    *own = new;
                }
                for own in self.steps_by_axis.iter_mut().skip(LINEAR).filter(|_| !self.has_rotary_steps) {
                    *own = AxisSteps::on_steps(0);
                }
                self.has_rotary_steps = false;
                self.load_block(directions);
            }
            ToStep::BlockRest { steps_by_axis } => {
                for (own, new) in self.steps_by_axis.iter_mut().skip(LINEAR).zip(steps_by_axis) {
                    *own = new;
                }
                self.has_rotary_steps = true;
            }
            ToStep::Reenter { units } => {
                if let Some(next) = self.course_mut(true) {
                    next.entered = units;
                }
            }
            ToStep::Watch { probe, braking } => {
                self.latch.watch(probe);
                self.braking = braking;
                if self.latch.is_watching {
                    self.look_at_all();
                }
            }
            ToStep::Resume { .. } => {}
        }
    }

    /// Returns the current block, or the next one if `next`.
    #[inline(always)]
    fn course(&self, next: bool) -> &Course<N> {
        self.courses.get(usize::from(self.odd != next)).unwrap_or(&Course::NOWHERE)
    }

    #[inline(always)]
    fn course_mut(&mut self, next: bool) -> Option<&mut Course<N>> {
        self.courses.get_mut(usize::from(self.odd != next))
    }

    #[inline]
    fn load_block(&mut self, directions: u8) {
        let steps_by_axis = self.steps_by_axis;
        // If the current block is left before its end, `begin_block` corrects this start position.
        let base = self.course(false).end;
        if let Some(next) = self.course_mut(true) {
            next.load(&steps_by_axis, directions, base);
        }
    }

    #[inline]
    fn load_segment(&mut self, segment: &Segment) {
        let new_block = segment.flags & Segment::FLAG_NEW_BLOCK != 0;
        if new_block {
            let steps_by_axis = self.steps_by_axis;
            if let Some(next) = self.course_mut(true) {
                next.finish(&steps_by_axis);
            }
        }
        let course = self.course(new_block);
        let units = if new_block { course.entered } else { self.piece.end_units };
        let mut increments = [0; N];
        let mut units_per_tick = 0;
        if segment.flags & Segment::FLAG_WAIT == 0 {
            let shift = MAX_LEVEL - segment.level.min(MAX_LEVEL);
            increments = course.rates.map(|rate| rate << shift);
            units_per_tick = 1 << shift;
            debug_assert!(units & (units_per_tick - 1) == 0, "a tick of {units_per_tick} units begins at {units}");
        }
        let ticks = u32::from(segment.ticks.max(1));
        self.next_piece = Piece {
            increments,
            plain_ticks: ticks.wrapping_sub(1),
            rare_ticks: 1,
            interval: segment.interval,
            ramp: segment.ramp,
            units_per_tick,
            end_units: units.wrapping_add(ticks.wrapping_mul(units_per_tick)),
            power: segment.power,
            last: segment.flags & Segment::FLAG_LAST != 0,
            new_block,
        };
        self.is_next = true;
    }

    /// Executes the next tick. From rest, the first tick makes no step and gives the interval to the first tick that
    /// steps.
    #[inline]
    pub fn tick(&mut self) -> Tick {
        if self.latch.is_unnoted {
            self.note_touch();
        }
        let steps = dda::step_axes(&mut self.left, &self.piece.increments, self.threshold);
        match self.piece.plain_ticks.checked_sub(1) {
            Some(left) => {
                self.piece.plain_ticks = left;
                self.set_out(steps)
            }
            None => self.rare_tick(steps),
        }
    }

    /// Executes plain ticks (which do nothing but step) until `words` or `moments` is full, or the segment has no
    /// more of them. Returns their number. Writes one element per tick: the time into `moments`, and into `words` the
    /// entry of `table` for the axes that step (bit 0 of the index for X).
    ///
    /// All steps are computed before all times, so that the state of each loop stays in registers. The stepper's state
    /// afterwards is the same as after that many calls of [`Stepper::tick`].
    #[inline(always)]
    pub fn plain_ticks<const WORDS: usize>(
        &mut self,
        table: &[u32; WORDS],
        words: &mut [u32],
        moments: &mut [u32],
    ) -> usize {
        let count = words.len().min(moments.len()).min(self.piece.plain_ticks as usize);
        let (Some(words), Some(moments)) = (words.get_mut(..count), moments.get_mut(..count)) else { return 0 };
        self.piece.plain_ticks = self.piece.plain_ticks.wrapping_sub(count as u32);
        dda::steps_into(&mut self.left, &self.piece.increments, self.threshold, table, words);
        self.moments_into(moments);
        count
    }

    #[inline(always)]
    fn moments_into(&mut self, moments: &mut [u32]) {
        // With as many fraction bits in the interval as in the moment, each tick takes only two 64-bit additions.
        let (mut moment, ramp) = (self.moment, i64::from(self.piece.ramp) << FRACTION_SHIFT);
        let mut interval = u64::from(self.piece.interval) << FRACTION_SHIFT;
        for at in moments {
            *at = (moment >> 32) as u32;
            moment = moment.wrapping_add(interval);
            interval = interval.wrapping_add_signed(ramp);
        }
        (self.moment, self.piece.interval) = (moment, (interval >> FRACTION_SHIFT) as u32);
    }

    /// Returns whether the next tick is plain and [`Stepper::plain_ticks`] can execute it.
    #[inline(always)]
    pub fn has_plain(&self) -> bool {
        self.piece.plain_ticks != 0
    }

    /// Returns the minimum and maximum interval between the remaining ticks of the segment, in step-clock ticks rounded
    /// down.
    #[inline]
    pub fn intervals(&self) -> (u32, u32) {
        let Piece { interval, ramp, .. } = self.piece;
        // Wrapping 32-bit arithmetic is exact here, because each interval fits 32 bits.
        let last = interval.wrapping_add((ramp as u32).wrapping_mul(self.piece.ticks().wrapping_sub(1)));
        let (least, greatest) = if last < interval { (last, interval) } else { (interval, last) };
        (least >> INTERVAL_FRACTION_BITS, greatest >> INTERVAL_FRACTION_BITS)
    }

    /// Returns the minimum time between two steps in the segment, in step-clock ticks, for the axis with the most
    /// steps. (At AMASS levels above 0, one step takes several [`Tick`]s.)
    #[inline]
    pub fn step_interval(&self) -> u32 {
        let (least, _) = self.intervals();
        let level =
            u32::from(MAX_LEVEL).wrapping_sub(self.piece.units_per_tick.trailing_zeros().min(u32::from(MAX_LEVEL)));
        least.wrapping_shl(level)
    }

    /// Returns whether the next tick would be an underrun: it ends a segment, and the segment that must follow has not
    /// been loaded.
    #[inline]
    pub fn lacks_segment(&self) -> bool {
        self.piece.ticks() == 1 && !self.is_next && !self.piece.last && !self.brakes && !self.latch.is_unnoted
    }

    /// Completes a tick that is not plain, once its steps are computed: the last tick of a segment, a tick from or to
    /// rest, or any tick while a probe is watched.
    #[inline(always)]
    fn rare_tick(&mut self, steps: u8) -> Tick {
        if self.piece.rare_ticks > 1 {
            self.piece.rare_ticks = self.piece.rare_ticks.wrapping_sub(1);
            return self.set_out(steps);
        }
        if self.is_next {
            self.begin_segment();
            return Tick { begins: true, ..self.set_out(steps) };
        }
        self.piece.rare_ticks = 0;
        if self.brakes && self.brake() {
            return self.set_out(steps);
        }
        let underrun = self.run_out();
        Tick { steps, directions: self.directions, interval: 0, begins: false, underrun }
    }

    /// Returns the [`Tick`] for the present tick, with the interval to the next one. Advances `moment` to the next
    /// tick.
    #[inline(always)]
    fn set_out(&mut self, steps: u8) -> Tick {
        let now = self.moment();
        let interval = self.piece.interval;
        self.moment = self.moment.wrapping_add(u64::from(interval) << FRACTION_SHIFT);
        self.piece.interval = interval.wrapping_add_signed(self.piece.ramp);
        let interval = self.moment().wrapping_sub(now);
        Tick { steps, directions: self.directions, interval, begins: false, underrun: false }
    }

    /// Returns the spindle or laser power of the current segment, 0 to 65535.
    #[inline]
    pub fn power(&self) -> u16 {
        self.piece.power
    }

    /// Returns the directions of the next step, as in [`Tick::directions`].
    #[inline]
    pub fn directions(&self) -> u8 {
        self.directions
    }

    /// Returns whether the next tick is the last of its segment, or the first from rest. Such a tick begins the
    /// prefetched segment.
    #[inline(always)]
    pub fn ends_segment(&self) -> bool {
        self.piece.ticks() <= 1
    }

    /// Returns whether any axis steps at the next tick. A tick without steps makes no pulse, so it need not wait for
    /// the pause after the previous pulse.
    #[inline]
    pub fn steps_next(&self) -> bool {
        dda::steps_next(&self.left, &self.piece.increments)
    }

    /// Returns the time of the next tick on the step clock (wrapping); at rest, the time of the last tick.
    #[inline(always)]
    pub fn moment(&self) -> u32 {
        (self.moment >> 32) as u32
    }

    /// Sets the time of the next tick. Call for the first tick from rest, and for a tick that is late: all later ticks
    /// are then late by the same time. Keeps the fraction of a clock tick.
    pub fn begin_at(&mut self, moment: u32) {
        self.moment = u64::from(moment) << 32 | u64::from(self.moment as u32);
    }

    /// Ends motion because no segment has followed. If the last segment does not end at rest, this is a fault
    /// (underrun): shuts the gate, so that messages are discarded, and returns `true`.
    #[cold]
    fn run_out(&mut self) -> bool {
        let underrun = !self.piece.last;
        if underrun {
            self.shut();
        }
        self.piece.increments = [0; N];
        underrun
    }

    #[inline(always)]
    fn begin_segment(&mut self) {
        self.is_next = false;
        if self.next_piece.new_block {
            self.begin_block();
        }
        self.piece = self.next_piece;
        self.begun = self.begun.wrapping_add(1);
        if self.latch.is_watching {
            self.look_at_all();
        }
    }

    /// Turns all remaining ticks of the segment into rare ticks. Rare ticks are executed one by one, so the probe can
    /// be checked after each.
    #[inline]
    fn look_at_all(&mut self) {
        self.piece.rare_ticks = self.piece.ticks();
        self.piece.plain_ticks = 0;
    }

    #[inline(always)]
    fn begin_block(&mut self) {
        if self.piece.end_units != self.course(false).total {
            self.leave_midst();
        }
        self.odd = !self.odd;
        // Does not call `Course::first`: when built for size, the compiler would copy the returned array three times.
        let course = self.courses.get(usize::from(self.odd)).unwrap_or(&Course::NOWHERE);
        let Course { beyond, threshold, entered, directions, .. } = course;
        for (left, beyond) in self.left.iter_mut().zip(beyond) {
            *left = (threshold / 2).wrapping_sub(*beyond);
        }
        (self.threshold, self.directions) = (*threshold, *directions);
        if *entered != 0 {
            let mut left = self.left;
            if let Some(course) = self.course_mut(false) {
                course.enter_midst(&mut left);
            }
            self.left = left;
        }
    }

    /// Makes the next block start at the current position. Called if the current block is left before its end, for
    /// other moves.
    #[cold]
    fn leave_midst(&mut self) {
        // The current segment ends with this tick, so none of its ticks are left.
        self.piece.rare_ticks = 0;
        let position = self.position().0;
        if let Some(next) = self.course_mut(true) {
            next.begin_from(position);
        }
    }

    /// Returns how many units of the current block have been executed.
    fn units(&self) -> u32 {
        self.piece.end_units.wrapping_sub(self.piece.ticks().wrapping_mul(self.piece.units_per_tick))
    }

    /// Stops immediately and discards everything. Further messages are discarded, too, until a [`ToStep::Resume`]
    /// arrives that has the same count of stops as the returned event.
    ///
    /// `undone`: net steps of ticks that were generated ahead of time and will not be output. They are subtracted from
    /// the position.
    pub fn stop(&mut self, undone: [i32; N]) -> StepEvent<N> {
        let moving = self.piece.ticks() != 0 || undone.iter().any(|steps| *steps != 0);
        self.shut();
        self.take_back(undone);
        StepEvent::Stopped { stops: self.stops, moving, position: self.position() }
    }

    /// Subtracts segments from the count of begun ones, because their ticks were not output.
    pub fn take_back_segments(&mut self, undone: u32) {
        self.begun = self.begun.wrapping_sub(undone);
    }

    /// Corrects the position after a stop or underrun: subtracts net steps that were counted, but were not output to
    /// the motors.
    pub fn take_back(&mut self, undone: [i32; N]) {
        if let Some(course) = self.course_mut(false) {
            course.take_back(undone);
        }
    }

    /// Returns the report after a tick with [`Tick::underrun`]: the count of stops and the position.
    pub fn underrun_event(&self) -> StepEvent<N> {
        StepEvent::Underrun { stops: self.stops, position: self.position() }
    }

    /// Returns whether [`Stepper::probe`] must be called after each tick.
    #[inline]
    pub fn is_watching(&self) -> bool {
        self.latch.is_watching
    }

    /// Checks the probe. `active`: its present state. Returns whether the probe has the watched state for the first
    /// time. If so, the position is latched, the queue is discarded, and braking begins with the next tick.
    /// [`Stepper::probed_event`] returns the report.
    #[inline]
    pub fn probe(&mut self, active: bool) -> bool {
        self.latch.detect(active)
    }

    /// Saves the state at the contact, discards the queue, shuts the gate, and starts to brake. The tick that detects
    /// the contact has no time for this. So this is done first in the next call of a function that loads a message,
    /// executes a tick, stops, or reports the contact.
    #[cold]
    fn note_touch(&mut self) {
        self.latch.is_unnoted = false;
        self.touched = self.contact();
        self.gate_shut = true;
        self.is_next = false;
        self.piece.last = true;
        self.brakes = self.piece.rare_ticks != 0;
        if self.brakes {
            // Make the current tick the last one of its segment.
            self.piece.end_units = self.units().wrapping_add(self.piece.units_per_tick);
            self.piece.rare_ticks = 1;
            self.piece.ramp = 0;
        }
    }

    /// Prepares the next tick of the deceleration after a contact. Returns `false` when braking is complete.
    #[cold]
    fn brake(&mut self) -> bool {
        let next = braked_interval(self.piece.interval, self.piece.units_per_tick, self.braking);
        let ends = self.piece.end_units >= self.course(false).total;
        self.brakes = !ends && next.is_some();
        if let Some(next) = next.filter(|_| !ends) {
            self.piece.end_units = self.piece.end_units.wrapping_add(self.piece.units_per_tick);
            self.piece.interval = next;
            self.piece.rare_ticks = 1;
        }
        self.brakes
    }

    /// Returns the report of a contact found by [`Stepper::probe`], with the position at the contact.
    pub fn probed_event(&mut self) -> StepEvent<N> {
        if self.latch.is_unnoted {
            self.note_touch();
        }
        StepEvent::Probed { position: self.touched.position() }
    }

    #[cold]
    fn shut(&mut self) {
        if self.latch.is_unnoted {
            self.note_touch();
        }
        self.latch.is_watching = false;
        self.brakes = false;
        self.has_rotary_steps = false;
        let base = self.position().0;
        if let Some(course) = self.course_mut(false) {
            *course = Course::rest_at(base);
        }
        self.threshold = 0;
        self.left = [0; N];
        self.piece = Piece::REST;
        self.moment = u64::from(self.moment()) << 32;
        self.is_next = false;
        self.gate_shut = true;
        self.stops = self.stops.wrapping_add(1);
    }

    /// Returns whether messages are discarded: after a stop, an underrun or a contact, until the matching
    /// [`ToStep::Resume`].
    #[inline]
    pub fn is_shut(&self) -> bool {
        self.gate_shut || self.latch.is_unnoted
    }

    /// Returns whether a segment is running, including one that only waits and makes no steps.
    #[inline(always)]
    pub fn is_moving(&self) -> bool {
        self.piece.ticks() != 0
    }

    /// Returns whether no segment is running or prefetched.
    #[inline]
    pub fn is_idle(&self) -> bool {
        self.piece.ticks() == 0 && (!self.is_next || self.latch.is_unnoted)
    }

    /// Returns the number of segments begun since power-up (wrapping).
    #[inline]
    pub fn segments_begun(&self) -> u32 {
        self.begun
    }

    /// Returns the net steps of each axis since power-up (wrapping), including all ticks so far.
    pub fn position(&self) -> PerAxis<i32, N> {
        self.course(false).position(&self.left, self.units())
    }

    #[inline(always)]
    fn contact(&self) -> Contact<N> {
        Contact { course: *self.course(false), left: self.left, units: self.units() }
    }
}

#[cfg(test)]
mod tests;
