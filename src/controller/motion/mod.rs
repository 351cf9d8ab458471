//! Motion: turns straight moves into messages for the step task. [`Motion`] queues moves, starts, holds and resumes
//! them, and reports position and speed. The controller has one `Motion` for the job, and a small one for parking.
//!
//! ```text
//!  Move ─ kinematics ─▶ block ─▶ planner (look-ahead) ─▶ segment ─▶ ToStep … the step task: stepper
//!  curve ─ chords ┘                 entry speeds        cut from the trapezoid of the running block
//!  ╰────────────── queue ──────────────────────╯ ╰────────── segment_source ──────────╯
//! ```
//! `queue` is the input side: the blocks and the end of the path. `enqueue` appends blocks there, and `short_moves`
//! joins short moves into one block. `segment_source` is the output side: the running block, the segments in flight,
//! and the state of motion at the end of the last segment handed over to the step task. `queue` does not depend on
//! `segment_source`; this file connects them.
//!
//! Guarantees:
//! * Rounding errors do not add up: a chain of moves ends on the step nearest to its programmed end.
//! * No axis exceeds its rate and acceleration.
//! * The planned path ends at rest, however few blocks are queued.
//! * In a hold, braking begins as soon as the segments already handed over have run (about [`QUEUED_TIME_MS`]).
//!
//! G-code, replies and machine states are handled elsewhere; the caller decides when motion starts.

pub mod arc;
mod axis_limits;
mod backlash;
mod blend;
mod block;
mod carried_time;
mod contact;
mod course;
mod curvature;
mod curve;
mod dda;
mod enqueue;
mod extent;
mod in_flight;
mod jerk;
mod jerk_anchors;
mod jerk_segment;
mod join;
mod junction;
mod kinematics;
mod measure;
mod nurbs;
mod path_end;
mod planner;
mod queue;
mod reverse_pass;
mod rounding;
mod running;
mod segment;
mod segment_source;
mod short_moves;
mod spline;
pub mod stepper;
mod trapezoid;

pub use arc::{Arc, ArcGeometry, Curvature};
pub use blend::Tolerance;
pub use curve::Curve;
pub use extent::extent;
pub use nurbs::{Nurbs, NurbsGeometry};
pub use segment_source::QUEUED_TIME_MS;
pub use spline::{Spline, SplineGeometry};
pub use stepper::{Stepper, Tick};

use crate::axes::{Arrangement, PerAxis};
use crate::lent::Lent;
use crate::messages::{Observed, ToStep, UNITS_PER_STEP};
use crate::units::{Coordinate, StepsPerMm};
use axis_limits::bounded;
use backlash::Motors;
pub use block::Block;
use block::{MARK_SHIFT, NO_OVERRIDE, OverrideFactors};
use curvature::{Chain, Scale};
use in_flight::{BEGUN, InFlightSegment, RING};
use jerk_anchors::Stretch;
use planner::GROUPS;
use queue::{MoveQueue, Numbering};
use segment_source::SegmentSource;

/// Lower bound of the feed and rapid overrides, as a factor (1 = as programmed).
const LEAST_OVERRIDE: f32 = 0.001;
/// Upper bound of the feed and rapid overrides, as a factor.
const GREATEST_OVERRIDE: f32 = 100.0;

/// Settings of the machine that motion depends on.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MotionSettings<const N: usize> {
    /// How the motors move the tool: Cartesian or CoreXY.
    pub arrangement: Arrangement,
    /// Steps of each motor per millimetre; with CoreXY, per millimetre of its belt.
    pub steps_per_mm: PerAxis<StepsPerMm, N>,
    /// Maximum speed of each axis, mm/s.
    pub max_rate: PerAxis<f32, N>,
    /// Minimum speed of a feed move before overrides, mm/s; 0 = none.
    pub least_feed: f32,
    /// Maximum acceleration of each axis, mm/s².
    pub acceleration: PerAxis<f32, N>,
    /// Maximum jerk of each axis, mm/s³; 0 = unlimited. If all are 0, ramps have constant acceleration.
    pub jerk: PerAxis<f32, N>,
    /// Junction deviation (`$11`), mm: distance of a corner from the imaginary arc that rounds it. It determines the
    /// speed at the corner.
    pub junction_deviation: f32,
    /// Acceleration allowed in curves as a share of `acceleration`; 1 = all of it.
    pub curve_share: f32,
    /// Backlash of each motor's drive, mm; 0 = none. At most 10,000 steps are compensated.
    pub backlash: PerAxis<f32, N>,
    /// Maximum distance between a chord and its arc, mm.
    pub arc_tolerance: f32,
    /// Ticks per second of the step timer, at least 10,000.
    pub step_clock_hz: u32,
}

/// Programmed speed of a move, before overrides.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Speed {
    /// As fast as the axes allow.
    Rapid,
    /// Speed along the path, mm/s.
    Feed(f32),
    /// Duration of the whole move, seconds.
    Duration(f32),
}

/// A straight move to be queued.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Move<const N: usize> {
    /// End point, in machine coordinates within [`Coordinate::LIMIT`].
    pub target: PerAxis<Coordinate, N>,
    /// Speed or duration of the move, before overrides.
    pub speed: Speed,
    /// Spindle or laser power, 0 to 65535; sent with each segment.
    pub power: u16,
    /// `true` if power is scaled by actual / programmed speed (M4 of a laser).
    pub scale_power: bool,
    /// N word for reports, 0 = none.
    pub line_number: u32,
    /// Whether overrides have no effect on the move (jog, homing, probing).
    pub no_feed_override: bool,
    /// Resolution of the program's coordinates (value of their last decimal place), mm; 0 = exact.
    pub digit: f32,
    /// How far the tool is allowed to deviate from the path.
    pub tolerance: Tolerance,
}

/// Queues moves and turns them into messages for the step task. See the module documentation.
#[derive(Debug)]
#[cfg_attr(feature = "alloc", derive(Clone))]
#[repr(C)]
pub struct Motion<const N: usize> {
    step_idle: bool,
    /// Machine position in steps at which the step counters are 0.
    origin: PerAxis<i32, N>,
    settings: MotionSettings<N>,
    source: SegmentSource<N>,
    queue: MoveQueue<N>,
}

/// Memory for one [`Motion`]: blocks, their summaries, segments in flight, and the scales on which curvature is
/// measured.
#[derive(Debug)]
pub struct MotionMemory<const N: usize> {
    blocks: Lent<[Block<N>]>,
    groups: Lent<[Stretch]>,
    ring: Lent<[InFlightSegment<N>]>,
    scales: Lent<[Scale<N>]>,
}

/// Static storage for a [`MotionMemory`]. Its initial contents are all 0, so that they take no flash.
#[derive(Debug)]
#[cfg(not(feature = "alloc"))]
pub struct MotionStorage<const N: usize, const BLOCKS: usize> {
    blocks: [Block<N>; BLOCKS],
    groups: [Stretch; GROUPS],
    ring: [InFlightSegment<N>; RING],
    scales: [Scale<N>; curvature::SCALES],
}

#[cfg(not(feature = "alloc"))]
impl<const N: usize, const BLOCKS: usize> MotionStorage<N, BLOCKS> {
    /// Initial contents, all 0.
    pub const EMPTY: Self = Self {
        blocks: [Block::NONE; BLOCKS],
        groups: [Stretch::BLANK; GROUPS],
        ring: [InFlightSegment::NONE; RING],
        scales: Chain::SCALES,
    };

    /// Returns the memory for one [`Motion`]. The storage stays borrowed from then on.
    pub fn lend(&'static mut self) -> MotionMemory<N> {
        MotionMemory {
            blocks: &mut self.blocks,
            groups: &mut self.groups,
            ring: &mut self.ring,
            scales: &mut self.scales,
        }
    }
}

/// Number of blocks of a motion for single moves: one for the move, and one for backlash compensation.
const SINGLE_MOVE_BLOCKS: usize = 2;

/// Storage for a [`Motion`] that runs single straight moves, each from rest to rest. To move, this `Motion` borrows a
/// ring of segments in flight from another `Motion`, which rests meanwhile ([`Motion::lend_ring`]).
#[derive(Debug)]
#[cfg(not(feature = "alloc"))]
pub struct SingleMoveStorage<const N: usize> {
    blocks: [Block<N>; SINGLE_MOVE_BLOCKS],
    ring: [InFlightSegment<N>; BEGUN],
}

#[cfg(not(feature = "alloc"))]
impl<const N: usize> SingleMoveStorage<N> {
    /// Initial contents, all 0.
    pub const EMPTY: Self = Self { blocks: [Block::NONE; SINGLE_MOVE_BLOCKS], ring: [InFlightSegment::NONE; BEGUN] };

    /// Returns the memory for one [`Motion`]. The storage stays borrowed from then on.
    pub fn lend(&'static mut self) -> MotionMemory<N> {
        MotionMemory { blocks: &mut self.blocks, groups: &mut [], ring: &mut self.ring, scales: &mut [] }
    }
}

/// Allocates memory for a look-ahead of `blocks` blocks.
#[cfg(feature = "alloc")]
pub fn on_heap<const N: usize>(blocks: usize) -> MotionMemory<N> {
    MotionMemory {
        blocks: core::iter::repeat_n(Block::NONE, blocks).collect(),
        groups: Lent::new([Stretch::BLANK; GROUPS]),
        ring: Lent::new([InFlightSegment::NONE; RING]),
        scales: Lent::new(Chain::SCALES),
    }
}

/// Allocates memory for single moves, like that of `SingleMoveStorage`.
#[cfg(feature = "alloc")]
pub fn on_heap_for_single_moves<const N: usize>() -> MotionMemory<N> {
    MotionMemory {
        blocks: Lent::new([Block::NONE; SINGLE_MOVE_BLOCKS]),
        groups: Lent::new([]),
        ring: Lent::new([InFlightSegment::NONE; BEGUN]),
        scales: Lent::new([]),
    }
}

impl<const N: usize> Motion<N> {
    /// Creates a motion at rest at machine position 0.
    pub fn new(settings: MotionSettings<N>, room: MotionMemory<N>) -> Self {
        let mut motion = Self::unconfigured(settings.step_clock_hz, room);
        motion.configure(settings);
        motion
    }

    /// Creates a motion at rest at machine position 0. Call [`Motion::configure`] before the first move.
    pub fn unconfigured(step_clock_hz: u32, room: MotionMemory<N>) -> Self {
        Self {
            settings: MotionSettings {
                arrangement: Arrangement::Cartesian,
                steps_per_mm: PerAxis::all(StepsPerMm::ONE),
                backlash: PerAxis::all(0.0),
                max_rate: PerAxis::all(1.0),
                least_feed: 0.0,
                acceleration: PerAxis::all(1.0),
                jerk: PerAxis::all(0.0),
                junction_deviation: 0.0,
                curve_share: 1.0,
                arc_tolerance: 0.0,
                step_clock_hz,
            },
            source: SegmentSource::new(step_clock_hz, room.ring),
            queue: MoveQueue::new(room.blocks, room.groups, room.scales),
            step_idle: true,
            origin: PerAxis::all(0),
        }
    }

    /// Applies settings. Call only at rest with an empty queue. The machine position stays the same in steps.
    pub fn configure(&mut self, settings: MotionSettings<N>) {
        let before = self.prepared();
        self.settings = settings;
        self.source.configure(settings.step_clock_hz);
        self.queue.configure(&settings);
        let lead = self.queue.backlash.lead_within(before.lead);
        let motors = Motors { steps: before.tool().zip(&PerAxis(lead), i32::wrapping_add), lead };
        if lead != before.lead {
            // A smaller backlash setting limits the motors' lead. The tool's position must stay the same, so the origin
            // of the step counters moves instead.
            let moved = motors.steps.zip(&before.steps, i32::wrapping_sub);
            self.origin = self.origin.zip(&moved, i32::wrapping_add);
            self.source.in_flight.forget(motors.tool(), lead);
        }
        self.plan_from(motors);
    }

    /// Clears queue and running block; the next move begins at the steps of `motors`.
    fn plan_from(&mut self, motors: Motors<N>) {
        let motors = self.queue.restart(motors);
        self.source.restart(motors);
    }

    /// Queues a move. Returns `false`, with nothing done, if there is no room. A move too short for a step makes no
    /// block; its length is carried over to the next block.
    pub fn line(&mut self, m: &Move<N>) -> bool {
        self.queue.take(m)
    }

    /// Queues a chord of a curve in the same way as [`Motion::line`] queues a move. The chord is at most as fast as the
    /// curve allows. Its steps follow its exact ends instead of the full steps nearest to them.
    pub fn chord(&mut self, m: &Move<N>, curvature: Curvature) -> bool {
        self.queue.take_chord(m, curvature)
    }

    /// Returns `true` if the sum of the queued blocks and of the moves joined into them reaches the capacity of the
    /// look-ahead. In that case, motion should start although the queue still has room.
    pub fn has_joined_enough(&self) -> bool {
        self.queue.has_joined_enough()
    }

    /// Returns the capacity of the look-ahead, in blocks.
    pub fn blocks(&self) -> usize {
        self.queue.planner.capacity()
    }

    /// Returns how many more moves can be queued if each needs one block; 0 while a move of 2^26 steps or more is
    /// still being divided. Some blocks are reserved and not counted: for backlash compensation, and for moves held
    /// back so that their corners can be rounded (G64).
    pub fn free_blocks(&self) -> usize {
        self.queue.free_blocks()
    }

    /// Returns the number of queued blocks, the running one included.
    pub fn queued_blocks(&self) -> usize {
        self.queue.planner.len()
    }

    /// Returns the number of steps by which each motor leads the tool (backlash compensation), at the end of the last
    /// segment handed over.
    pub fn lead(&self) -> [i32; N] {
        self.prepared().lead
    }

    /// Makes the motors lead the tool by `lead` steps (backlash compensation) when all queued moves are complete. If no
    /// block is queued, starts to turn the motors at once.
    pub fn end_with_lead(&mut self, lead: [i32; N]) {
        self.queue.backlash.set_wanted(lead);
        if self.queue.planner.len() == 0 {
            self.queue.finish_taking_up(&self.prepared(), self.source.running.line_number);
            self.start();
        }
    }

    /// Takes over the position from another motion that has moved the machine. Call only at rest. Clears the queue.
    pub fn take_over_position(&mut self, other: &Self) {
        let motors = other.prepared();
        self.origin = other.origin;
        self.source.in_flight.forget(motors.tool(), motors.lead);
        self.plan_from(motors);
    }

    /// Exchanges the ring of segments in flight with that of another motion. The first call lends this motion's ring to
    /// the other one, the second call returns it. Call only while both are at rest.
    #[inline(never)]
    pub fn lend_ring(&mut self, other: &mut Self) {
        self.source.in_flight.exchange_ring(&mut other.source.in_flight);
    }

    /// Starts to execute the queue. If the queue has no block, first queues the moves held back for rounding of their
    /// corners (G64). Has no effect if there are no moves at all. Segments are handed over from this call on until the
    /// queue has run empty. After that, `start` must be called again.
    pub fn start(&mut self) {
        if self.queue.planner.len() == 0 {
            self.queue.release();
        }
        if self.queue.planner.len() > 0 {
            self.source.start();
        }
    }

    /// Returns the next message for the step task; `None` if there is nothing to do, motion is not started, or segments
    /// for enough time are queued already.
    pub fn next(&mut self, observed: &Observed) -> Option<ToStep> {
        self.observe(observed);
        self.next_message()
    }

    /// Like [`Motion::next`], but does not update the record of begun segments. The controller calls this function
    /// very often, and usually no message is due. So only the check whether one is due is inlined.
    #[inline]
    pub fn next_message(&mut self) -> Option<ToStep> {
        if self.source.wants_more() { self.wanted_message() } else { None }
    }

    #[inline(never)]
    fn wanted_message(&mut self) -> Option<ToStep> {
        if self.source.waits_for_rest() {
            return None;
        }
        self.queue.continue_long_move();
        self.queue.release_in_time();
        let message = self.source.next_message(&mut self.queue.planner, self.queue.overrides, &self.queue.backlash)?;
        if self.queue.is_empty() {
            self.run_out();
        }
        Some(message)
    }

    /// Call when the last block has been handed over completely. Queues a block for the rest of the backlash
    /// compensation. If nothing is left to compensate, no more segments are handed over until the next start.
    #[inline(never)]
    fn run_out(&mut self) {
        if self.queue.backlash.is_on() {
            self.queue.finish_taking_up(self.source.block_start(), self.source.running.line_number);
        }
        if self.queue.is_empty() {
            self.source.run_out();
        }
    }

    /// Returns the deceleration with which the machine brakes in the first block of the queue after a probe's contact,
    /// in units per squared step-clock tick; 0 if the queue is empty. A unit is 1/16 step of the block's dominant axis.
    pub fn braking(&self) -> f32 {
        let clock = self.source.step_clock_hz() as f32;
        self.queue.planner.first().map_or(0.0, |block| {
            let units_per_mm = (block.dominant() * UNITS_PER_STEP) as f32 / block.length;
            block.acceleration * units_per_mm / clock / clock
        })
    }

    /// Brakes to a stop, starting with the next segment handed over.
    pub fn hold(&mut self) {
        self.source.hold();
    }

    /// Ends a hold and continues, even if the machine has not come to a stop yet.
    pub fn resume(&mut self) {
        if self.queue.planner.raised {
            // The override was lowered while the machine was too fast for it, so some entry speeds were planned higher
            // than the override allows. The hold has slowed the machine down, so these speeds must be lowered.
            self.replan();
        }
        self.source.resume(!self.queue.is_empty());
    }

    /// Announces the running block to the step task again. That is needed after the step task has executed other
    /// moves, such as parking. The machine must be back at exactly the same position. Call only at rest.
    pub fn reenter(&mut self) {
        self.source.running.announce_again();
    }

    /// Returns the settings that [`Motion::configure`] has applied.
    pub fn settings(&self) -> MotionSettings<N> {
        self.settings
    }

    /// Returns whether a hold is in force and the last handed-over segment ends at rest.
    pub fn is_held(&self) -> bool {
        self.source.is_held()
    }

    /// Sets feed override and rapid override, as factors (1 = as programmed), limited to 0.001 to 100. They take effect
    /// with the next segment handed over.
    pub fn set_overrides(&mut self, feed: f32, rapid: f32) {
        let overrides = OverrideFactors {
            feed: bounded(feed, LEAST_OVERRIDE, GREATEST_OVERRIDE),
            rapid: bounded(rapid, LEAST_OVERRIDE, GREATEST_OVERRIDE),
        };
        if overrides == self.queue.overrides {
            return;
        }
        self.queue.overrides = overrides;
        self.replan();
        if self.source.running.is_active()
            && let Some(block) = self.queue.planner.first()
        {
            self.source.set_nominal(block.nominal(overrides));
        }
    }

    /// Replans the whole queue with the current overrides, from the machine's state of motion.
    #[inline(never)]
    fn replan(&mut self) {
        let (state, left) = self.source.path_state(self.queue.planner.first());
        self.queue.planner.replan(self.queue.overrides, state, left);
    }

    /// Discards all queued moves, and ends a hold. Has an effect only if the last handed-over segment ends at rest.
    pub fn discard(&mut self) {
        if !self.source.ends_at_rest() {
            return;
        }
        self.plan_from(self.prepared());
        self.source.stop();
    }

    /// Call after a stop or underrun of the step task. `position`: the step counters of the step task. Discards
    /// everything queued, ends a hold, and takes over the exact position. The caller must open the step task's gate
    /// (`ToStep::Resume`) before it sends messages of `next`.
    pub fn stopped(&mut self, position: &PerAxis<i32, N>) {
        let steps = position.zip(&self.origin, |count, origin| count.wrapping_add(origin));
        let before = self.source.in_flight.before();
        let motors = self.queue.backlash.followed(&Motors { steps: before.motors(), lead: before.lead }, steps);
        self.source.in_flight.forget(motors.tool(), motors.lead);
        self.plan_from(motors);
        self.source.stop();
    }

    /// Updates the record of the segments that have begun, from the progress of the step task.
    pub fn observe(&mut self, observed: &Observed) {
        self.step_idle = observed.step_idle;
        self.source.in_flight.observe(observed.segments_begun, observed.step_idle);
    }

    /// Returns `true` if the step task may soon run out of segments: a motion is in progress, and the segments that the
    /// step task has not begun yet take less than 8 ms (`segment_source::SHORT_MS`).
    #[inline]
    pub fn is_short_of_segments(&self) -> bool {
        self.source.is_short_of_segments()
    }

    /// Returns whether the step task is idle and gets no segments before the next call of `start` or `resume`.
    pub fn is_at_rest(&self) -> bool {
        self.source.in_flight.is_empty() && self.step_idle && self.source.ends_at_rest() && !self.source.is_on()
    }

    /// Returns whether the last handed-over segment ends at rest, so that there is no deadline for the next one.
    pub fn ends_at_rest(&self) -> bool {
        self.source.ends_at_rest()
    }

    /// Returns whether the machine is at rest and nothing is queued.
    pub fn is_idle(&self) -> bool {
        self.is_at_rest() && self.queue.is_empty()
    }

    /// Returns whether motion is started: segments are handed over as soon as there is room for them.
    pub fn hands_over(&self) -> bool {
        self.source.is_on()
    }

    /// Returns whether the segments that the step task has not begun yet take at least `us` microseconds (at most 1 s).
    #[inline]
    pub fn holds_time(&self, us: u32) -> bool {
        self.source.holds_time(us)
    }

    /// Returns the duration of the segments that the step task has not begun yet, in microseconds.
    pub fn queued_us(&self) -> u32 {
        self.source.queued_us()
    }

    /// Returns the machine position in steps at the end of the last segment begun.
    pub fn machine_steps(&self) -> PerAxis<i32, N> {
        self.source.in_flight.current().position
    }

    /// Returns the machine position at the end of the last segment begun.
    pub fn machine_position(&self) -> PerAxis<Coordinate, N> {
        self.queue.kinematics.place(&self.machine_steps())
    }

    /// Returns the step counters at the end of the last handed-over segment.
    pub fn step_counters(&self) -> PerAxis<i32, N> {
        self.prepared().steps.zip(&self.origin, i32::wrapping_sub)
    }

    /// Returns the programmed position and the step counters of an idle machine. Returns `None` in these cases: the
    /// machine is not idle, the motors are not on the steps nearest to that position, or they lead the tool because of
    /// backlash.
    pub fn standing(&self) -> Option<(PerAxis<Coordinate, N>, PerAxis<i32, N>)> {
        let (motors, place) = (self.prepared(), self.queue.planned_position());
        let stands =
            self.is_idle() && self.queue.kinematics.steps(&place) == motors.steps && motors.tool() == motors.steps;
        stands.then(|| (place, self.step_counters()))
    }

    /// Sets the machine position without moving. Call only at rest. Clears the queue.
    pub fn set_machine_position(&mut self, position: &PerAxis<Coordinate, N>) {
        let old = self.prepared();
        let new = self.queue.kinematics.steps(position);
        let moved = new.zip(&old.tool(), i32::wrapping_sub);
        self.origin = self.origin.zip(&moved, i32::wrapping_add);
        self.source.in_flight.forget(new, old.lead);
        self.plan_from(Motors { steps: old.steps.zip(&moved, i32::wrapping_add), lead: old.lead });
        // `plan_from` has set the end of the path to the position of the nearest full steps. The next move must be
        // measured from `position` itself.
        self.queue.set_position(position);
    }

    /// Returns the machine position for step counters that were read during the current move, a straight move from
    /// rest.
    pub fn position_of_counter(&self, counter: &PerAxis<i32, N>) -> PerAxis<Coordinate, N> {
        let steps = counter.zip(&self.origin, i32::wrapping_add);
        self.queue.kinematics.place(&self.queue.backlash.followed(self.source.last_rest(), steps).tool())
    }

    /// Returns the programmed end of the last queued move, where the next move begins.
    pub fn planned_position(&self) -> PerAxis<Coordinate, N> {
        self.queue.planned_position()
    }

    /// Returns the speed of the segment being executed, mm/s; 0 at rest.
    pub fn speed(&self) -> f32 {
        self.source.in_flight.current().speed
    }

    /// Returns the power of the segment being executed, 0 to 65535; 0 at rest.
    pub fn power(&self) -> u16 {
        self.source.in_flight.current().power
    }

    /// Returns `true` if [`Motion::set_mark`] may be called. Returns `false` while a long move is still being divided
    /// into blocks, because its remaining blocks would get the new mark.
    pub fn takes_mark(&self) -> bool {
        self.queue.long.is_none()
    }

    /// Sets the mark of all blocks queued from now on: a number from 0 to 31 that ties a change of outputs to a block.
    /// When a block has begun, [`Motion::begun_mark`] returns its mark. If the mark changes, first queues the moves
    /// held back for rounding of their corners, and stops joining moves to the last block.
    pub fn set_mark(&mut self, mark: u8) {
        let marked = mark << MARK_SHIFT;
        if marked != self.queue.marked {
            self.queue.release();
            self.queue.end_join();
            self.queue.marked = marked;
        }
    }

    /// Returns the mark of the last block begun ([`Motion::set_mark`]).
    pub fn begun_mark(&self) -> u8 {
        self.source.in_flight.current().mark
    }

    /// Returns the power of the move whose segments are being handed over to the step task, or of the next move. That
    /// move can be ahead of the machine, because the step task first executes the segments that it already has.
    /// Returns `None` without a move, and for a move that overrides have no effect on (jog, homing, probing).
    pub fn running_power(&self) -> Option<u16> {
        match self.queue.planner.first() {
            Some(block) => (block.flags & NO_OVERRIDE == 0).then_some(block.power),
            None => self.queue.blend.moves().next().map(|held| held.m.power),
        }
    }

    /// Returns the line number of the block being executed, 0 if none.
    pub fn line_number(&self) -> u32 {
        self.source.in_flight.current().line_number
    }

    /// Returns the line number of the last move that has been handed over, completely or in part; 0 if none. This move
    /// can be ahead of the machine, because the step task first executes the segments that it already has.
    pub fn running_line_number(&self) -> u32 {
        self.source.running.line_number
    }

    /// Returns [`Motion::running_line_number`], then the line numbers of all queued moves. A move that has been handed
    /// over only in part is still queued, so its number comes twice.
    pub fn queued_line_numbers(&self) -> impl Iterator<Item = u32> {
        let planner = &self.queue.planner;
        let queued = (0..planner.len()).filter_map(|place| planner.block(place)).map(|block| block.line_number);
        let held = self.queue.blend.moves().map(|held| held.number);
        core::iter::once(self.running_line_number()).chain(queued).chain(held)
    }

    /// Gives all moves queued from now on the line number `number` for reports, instead of their N words.
    pub fn number_moves(&mut self, number: u32) {
        self.queue.numbering = Numbering::Given(number);
    }

    /// Returns the position and lead of the motors at the end of the last handed-over segment.
    fn prepared(&self) -> Motors<N> {
        self.source.motors(&self.queue.backlash)
    }
}

#[cfg(test)]
mod tests;
