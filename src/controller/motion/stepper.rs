//! The step generator (`Stepper`), one `Tick` per call: which axes step, the directions, and the time to the next tick.
//! It runs the current block and segment, and takes over the next ones without a gap; it stops at once when told to,
//! and brakes at a probe's contact.
//!
//! It promises: never a step without a segment; a queue that runs dry stops the pulses at once and is reported; after a
//! stop nothing moves until the matching `Resume`; the position is exact at any tick. It leaves which axis steps at a tick to `dda`,
//! what a block is to `course`, the acceleration to `planner` and `segment`, pulse widths and direction set-up to the task that
//! writes the pins.
//!
//! What a tick costs bounds the step rate of a machine. So what can be computed when a message is loaded is computed
//! there, and a tick within a segment touches the first words of the state only and divides nothing.

use super::course::{Contact, Course};
use super::dda;
use crate::axes::{LINEAR, PerAxis};
use crate::messages::{AxisSteps, INTERVAL_FRACTION_BITS, Segment, StepEvent, ToStep};

/// Finest smoothing: a tick advances one unit.
pub const MAX_LEVEL: u8 = 4;
/// Places of an interval's lowest bit in the fraction of [`Stepper::moment`].
const FRACTION_SHIFT: u32 = 32 - INTERVAL_FRACTION_BITS;
/// Interval, in fixed point, at which braking ends: some milliseconds for a tick are a crawl, and sums stay in 32 bits.
const LONGEST_BRAKING: f32 = (1_u32 << 30) as f32;

/// What to do at a tick.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Tick {
    /// Axes to step now, bit 0 for X.
    pub steps: u8,
    /// Direction levels for the *next* step (bit set = negative), to be written once this pulse has ended. They change
    /// with the first tick of a segment only.
    pub directions: u8,
    /// Step-clock ticks to the next one; 0 = at rest.
    pub interval: u32,
    /// A segment has begun with this tick, and its power and directions hold from now on.
    pub begins: bool,
    /// The queue ran dry at speed; the report is at [`Stepper::underrun_event`].
    pub underrun: bool,
}

/// A segment, ready to run.
#[derive(Clone, Copy, Debug)]
#[repr(C)]
struct Piece<const N: usize> {
    /// What a tick takes off.
    increments: [u32; N],
    /// Ticks until one that does more than to step.
    plain_ticks: u32,
    /// Ticks left after these, none of which is plain: while the probe is waited for all, otherwise the last. No tick left
    /// = at rest.
    rare_ticks: u32,
    /// In fixed point, to the next tick, and its change from tick to tick.
    interval: u32,
    ramp: i32,
    /// Units that a tick advances.
    units_per_tick: u32,
    /// Units of the block at the end of the segment.
    end_units: u32,
    power: u16,
    last: bool,
    new_block: bool,
}

/// State of the step task. The order is that of use: a tick within a segment needs the first part only.
#[derive(Clone, Debug)]
#[repr(C)]
pub struct Stepper<const N: usize> {
    /// What is left until the next step of each axis: 0 to `threshold` - 1.
    left: [u32; N],
    piece: Piece<N>,
    /// Of the current block.
    threshold: u32,
    directions: u8,
    /// Which of `courses` is that of the current block; the other is that of the next.
    odd: bool,
    /// Moment of the next tick, 32 bits of step-clock ticks before 32 of their fraction.
    moment: u64,
    /// A state of the probe is waited for.
    is_watching: bool,
    /// The state it is to have.
    watched: bool,

    begun: u32,
    is_next: bool,
    /// The probe has been seen at the last tick, and where that was has not been noted yet.
    unnoted: bool,
    next_piece: Piece<N>,
    courses: [Course<N>; 2],
    /// Parts of the axes of the block that is being told of.
    steps_by_axis: [AxisSteps; N],
    /// Those of A, B and C have been told; else these stand still.
    is_rest_told: bool,
    gate_shut: bool,
    stops: u16,
    /// How to brake at a contact: units per square of a clock.
    braking: f32,
    /// Braking after a contact.
    brakes: bool,
    /// Where the probe has been seen.
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
    /// At rest, at position 0, gate open.
    pub const fn new() -> Self {
        Self {
            left: [0; N],
            piece: Piece::REST,
            threshold: 0,
            directions: 0,
            odd: false,
            moment: 0,
            is_watching: false,
            watched: false,
            begun: 0,
            is_next: false,
            unnoted: false,
            next_piece: Piece::REST,
            courses: [Course::NOWHERE; 2],
            steps_by_axis: [AxisSteps::on_steps(0); N],
            is_rest_told: false,
            gate_shut: false,
            stops: 0,
            braking: 0.0,
            brakes: false,
            touched: Contact::START,
        }
    }

    /// Whether there is room for one more message. The step task loads as long as this holds and messages are there, then
    /// calls [`Stepper::tick`]: a new block needs two or three messages, all other segments one.
    #[inline]
    pub fn wants(&self) -> bool {
        !self.is_next || self.unnoted
    }

    /// Takes a message; only while [`Stepper::wants`].
    #[inline]
    pub fn load(&mut self, message: ToStep) {
        if self.unnoted {
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
                for own in self.steps_by_axis.iter_mut().skip(LINEAR).filter(|_| !self.is_rest_told) {
                    *own = AxisSteps::on_steps(0);
                }
                self.is_rest_told = false;
                self.load_block(directions);
            }
            ToStep::BlockRest { steps_by_axis } => {
                for (own, new) in self.steps_by_axis.iter_mut().skip(LINEAR).zip(steps_by_axis) {
                    *own = new;
                }
                self.is_rest_told = true;
            }
            ToStep::Reenter { units } => {
                if let Some(next) = self.course_mut(true) {
                    next.entered = units;
                }
            }
            ToStep::Watch { probe, braking } => {
                self.is_watching = probe.is_some();
                self.watched = probe == Some(true);
                self.braking = braking;
                if self.is_watching {
                    self.look_at_all();
                }
            }
            ToStep::Resume { .. } => {}
        }
    }

    /// The course of the current block, or that of the next.
    #[inline(always)]
    fn course(&self, next: bool) -> &Course<N> {
        self.courses.get(usize::from(self.odd != next)).unwrap_or(&Course::NOWHERE)
    }

    /// The same to be changed.
    #[inline(always)]
    fn course_mut(&mut self, next: bool) -> Option<&mut Course<N>> {
        self.courses.get_mut(usize::from(self.odd != next))
    }

    #[inline]
    fn load_block(&mut self, directions: u8) {
        let steps_by_axis = self.steps_by_axis;
        // One that is left before its end is seen to in `begin_block`.
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

    /// The next tick; from rest the first makes no step and gives the interval to the one that does.
    #[inline]
    pub fn tick(&mut self) -> Tick {
        if self.unnoted {
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

    /// Plain ticks in a row, as many as there is room for or as the segment has left: for each its steps, as the entry of
    /// `table` that belongs to them (bit 0 for X), and its moment. How many.
    ///
    /// All steps come first and then all moments, so that the state of each loop stays in registers. What follows is as
    /// if [`Stepper::tick`] had been called as often.
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
        // The interval with as many fraction bits as the moment has, so that two sums of 64 bits are all there is for each.
        let (mut moment, ramp) = (self.moment, i64::from(self.piece.ramp) << FRACTION_SHIFT);
        let mut interval = u64::from(self.piece.interval) << FRACTION_SHIFT;
        for at in moments {
            *at = (moment >> 32) as u32;
            moment = moment.wrapping_add(interval);
            interval = interval.wrapping_add_signed(ramp);
        }
        (self.moment, self.piece.interval) = (moment, (interval >> FRACTION_SHIFT) as u32);
    }

    /// Whether the next tick is one for [`Stepper::plain_ticks`].
    #[inline(always)]
    pub fn has_plain(&self) -> bool {
        self.piece.plain_ticks != 0
    }

    /// The least and the greatest interval, in whole step-clock ticks rounded down, between the ticks of the segment from
    /// the next tick on.
    #[inline]
    pub fn intervals(&self) -> (u32, u32) {
        let Piece { interval, ramp, .. } = self.piece;
        // Exact in 32 bits, as each interval is.
        let last = interval.wrapping_add((ramp as u32).wrapping_mul(self.piece.ticks().wrapping_sub(1)));
        let (least, greatest) = if last < interval { (last, interval) } else { (interval, last) };
        (least >> INTERVAL_FRACTION_BITS, greatest >> INTERVAL_FRACTION_BITS)
    }

    /// The least time from one step of the fastest axis to its next one in the segment, in step-clock ticks: several ticks at low rates.
    #[inline]
    pub fn step_interval(&self) -> u32 {
        let (least, _) = self.intervals();
        let level =
            u32::from(MAX_LEVEL).wrapping_sub(self.piece.units_per_tick.trailing_zeros().min(u32::from(MAX_LEVEL)));
        least.wrapping_shl(level)
    }

    /// Whether the next tick ends a segment that another one is to follow, and that one is not here yet: the tick would be
    /// an underrun.
    #[inline]
    pub fn lacks_segment(&self) -> bool {
        self.piece.ticks() == 1 && !self.is_next && !self.piece.last && !self.brakes && !self.unnoted
    }

    /// What a tick does after its steps with which a segment may end or motion begin or end, or at which the probe is waited for.
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

    /// Sets the moment of the next tick.
    #[inline(always)]
    fn set_out(&mut self, steps: u8) -> Tick {
        let now = self.moment();
        let interval = self.piece.interval;
        self.moment = self.moment.wrapping_add(u64::from(interval) << FRACTION_SHIFT);
        self.piece.interval = interval.wrapping_add_signed(self.piece.ramp);
        let interval = self.moment().wrapping_sub(now);
        Tick { steps, directions: self.directions, interval, begins: false, underrun: false }
    }

    /// Spindle or laser power of the segment.
    #[inline]
    pub fn power(&self) -> u16 {
        self.piece.power
    }

    /// Directions of the next step, as in [`Tick::directions`].
    #[inline]
    pub fn directions(&self) -> u8 {
        self.directions
    }

    /// Whether the next tick is the last of its segment, or begins to move: it takes up what has been fetched.
    #[inline(always)]
    pub fn ends_segment(&self) -> bool {
        self.piece.ticks() <= 1
    }

    /// Whether an axis steps at the next tick.
    #[inline]
    pub fn steps_next(&self) -> bool {
        dda::steps_next(&self.left, &self.piece.increments)
    }

    /// The moment of the next tick, on the step clock (wrapping); that of the last one at rest.
    #[inline(always)]
    pub fn moment(&self) -> u32 {
        (self.moment >> 32) as u32
    }

    /// Sets the moment of the next tick: of the first after a rest, or of one that is put off, with all that come after it. The
    /// fraction of a clock tick stays.
    pub fn begin_at(&mut self, moment: u32) {
        self.moment = u64::from(moment) << 32 | u64::from(self.moment as u32);
    }

    /// No segment has followed: rest, and whether it is a fault.
    #[cold]
    fn run_out(&mut self) -> bool {
        let underrun = !self.piece.last;
        if underrun {
            self.shut();
        }
        self.piece.increments = [0; N];
        underrun
    }

    /// Makes the prefetched segment the current one.
    #[inline(always)]
    fn begin_segment(&mut self) {
        self.is_next = false;
        if self.next_piece.new_block {
            self.begin_block();
        }
        self.piece = self.next_piece;
        self.begun = self.begun.wrapping_add(1);
        if self.is_watching {
            self.look_at_all();
        }
    }

    /// The probe is waited for: no tick is plain.
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
        // The fields themselves and not `Course::first`: built for size, an array in between is copied three times.
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

    /// The block before was left before its end, for a detour.
    #[cold]
    fn leave_midst(&mut self) {
        // With this tick its segment has ended.
        self.piece.rare_ticks = 0;
        let position = self.position().0;
        if let Some(next) = self.course_mut(true) {
            next.begin_from(position);
        }
    }

    /// Units of the block advanced by now.
    fn units(&self) -> u32 {
        self.piece.end_units.wrapping_sub(self.piece.ticks().wrapping_mul(self.piece.units_per_tick))
    }

    /// Stops at once, forgets everything and shuts the gate until [`ToStep::Resume`] with this count of stops.
    ///
    /// `undone` are the net steps of ticks that have been made ahead of their time and will not come out: the position is
    /// that without them.
    pub fn stop(&mut self, undone: [i32; N]) -> StepEvent<N> {
        let moving = self.piece.ticks() != 0 || undone.iter().any(|steps| *steps != 0);
        self.shut();
        self.take_back(undone);
        StepEvent::Stopped { stops: self.stops, moving, position: self.position() }
    }

    /// So many segments, those begun last, have not come out.
    pub fn take_back_segments(&mut self, undone: u32) {
        self.begun = self.begun.wrapping_sub(undone);
    }

    /// After a stop or an underrun: these net steps have not come out, so the position is that without them.
    pub fn take_back(&mut self, undone: [i32; N]) {
        if let Some(course) = self.course_mut(false) {
            course.take_back(undone);
        }
    }

    /// The report that belongs to a [`Tick::underrun`].
    pub fn underrun_event(&self) -> StepEvent<N> {
        StepEvent::Underrun { stops: self.stops, position: self.position() }
    }

    /// Whether [`Stepper::probe`] is to be called after each tick.
    #[inline]
    pub fn is_watching(&self) -> bool {
        self.is_watching
    }

    /// Looks at the probe; whether it has the awaited state for the first time. Then the place is latched, what is queued is
    /// void, and braking begins with the next tick; the report is at [`Stepper::probed_event`].
    #[inline]
    pub fn probe(&mut self, active: bool) -> bool {
        let touched = self.is_watching && self.watched == active;
        if touched {
            self.is_watching = false;
            self.unnoted = true;
        }
        touched
    }

    /// Keeps the place of the contact, throws away what is queued, and begins to brake. The tick that sees the contact has
    /// no time for that. Every call that would change something, or would tell of the gate, comes by here first.
    #[cold]
    fn note_touch(&mut self) {
        self.unnoted = false;
        self.touched = self.contact();
        self.gate_shut = true;
        self.is_next = false;
        self.piece.last = true;
        self.brakes = self.piece.rare_ticks != 0;
        if self.brakes {
            // The tick that is under way is the last of its segment.
            self.piece.end_units = self.units().wrapping_add(self.piece.units_per_tick);
            self.piece.rare_ticks = 1;
            self.piece.ramp = 0;
        }
    }

    /// Begins the next tick of a ramp down; `false` when there is nothing left to brake.
    ///
    /// A tick of `u` units at the interval T is a speed v = u/T, and v² falls by 2·a·u from tick to tick: with k = a·T²/u
    /// the next interval is T / sqrt(1 - 2k), of which the first terms of the series are taken. The last tick of the ramp
    /// is the one that would take all of v².
    #[cold]
    fn brake(&mut self) -> bool {
        let interval = self.piece.interval as f32 / (1 << INTERVAL_FRACTION_BITS) as f32;
        let k = self.braking * interval * interval / self.piece.units_per_tick as f32;
        let next = self.piece.interval as f32 * (1.0 + k * (1.0 + k * (1.5 + k * 2.5)));
        let ends = self.piece.end_units >= self.course(false).total;
        // Not a number where the tick advances no units: a crawl, which stops where it is.
        self.brakes = !ends && k < 0.5 && next < LONGEST_BRAKING;
        if self.brakes {
            self.piece.end_units = self.piece.end_units.wrapping_add(self.piece.units_per_tick);
            self.piece.interval = next as u32;
            self.piece.rare_ticks = 1;
        }
        self.brakes
    }

    /// The report that belongs to [`Stepper::probe`].
    pub fn probed_event(&mut self) -> StepEvent<N> {
        if self.unnoted {
            self.note_touch();
        }
        StepEvent::Probed { position: self.touched.position() }
    }

    #[cold]
    fn shut(&mut self) {
        if self.unnoted {
            self.note_touch();
        }
        self.is_watching = false;
        self.brakes = false;
        self.is_rest_told = false;
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

    /// Whether a stop has not been answered yet.
    #[inline]
    pub fn is_shut(&self) -> bool {
        self.gate_shut || self.unnoted
    }

    /// Whether a segment runs.
    #[inline(always)]
    pub fn is_moving(&self) -> bool {
        self.piece.ticks() != 0
    }

    /// Whether there is nothing left to do.
    #[inline]
    pub fn is_idle(&self) -> bool {
        self.piece.ticks() == 0 && (!self.is_next || self.unnoted)
    }

    /// Segments begun since power-up (wrapping).
    #[inline]
    pub fn segments_begun(&self) -> u32 {
        self.begun
    }

    /// Net steps of each axis since power-up (wrapping), all steps of the ticks so far included.
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
