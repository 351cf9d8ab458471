//! Motion: straight moves in, messages for the step task out. [`Motion`] queues moves, starts, holds and resumes them,
//! and reports position and speed. The controller has one for the job, and a small one for parking.
//!
//! ```text
//!  Move ─ kinematics ─▶ block ─▶ planner (look-ahead) ─▶ segment ─▶ ToStep … the step task: stepper
//!  curve ─ chords ┘                 entry speeds        cut from the trapezoid of the running block
//!  ╰────────────── queue ──────────────────────╯ ╰────────── segment_source ──────────╯
//! ```
//! `queue` owns the way in: the blocks and the end of the path, at which `enqueue` adds blocks (`short_moves` joins
//! short ones). `segment_source` owns the way out: the running block, the state of motion at the end of what has been handed
//! over, and the segments in flight. The first knows nothing of the second; here both are brought together.
//!
//! It promises: steps add up exactly; no axis is asked for more than its rate and acceleration; whatever has been handed
//! over ends at rest; a hold begins to brake within the time queued ([`QUEUED_TIME_MS`]). It knows nothing of G-code, of
//! replies or of machine states; when to start is decided outside.

pub mod arc;
mod axis_limits;
mod backlash;
mod blend;
mod block;
mod carried_time;
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
mod reverse_walk;
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

/// Overrides that make sense at all.
const LEAST_OVERRIDE: f32 = 0.001;
const GREATEST_OVERRIDE: f32 = 100.0;

/// What motion must know of the machine.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MotionSettings<const N: usize> {
    /// How the motors move the tool.
    pub arrangement: Arrangement,
    /// Motor steps of a millimetre.
    pub steps_per_mm: PerAxis<StepsPerMm, N>,
    /// Greatest speed of each axis, mm/s.
    pub max_rate: PerAxis<f32, N>,
    /// Least speed that a feed makes, before overrides, mm/s; 0 = none.
    pub least_feed: f32,
    /// Greatest acceleration of each axis, mm/s².
    pub acceleration: PerAxis<f32, N>,
    /// Greatest jerk of each axis, mm/s³; 0 = as great as may be. All 0: ramps of even acceleration.
    pub jerk: PerAxis<f32, N>,
    /// How far a corner may be cut in thought to find its speed, mm.
    pub junction_deviation: f32,
    /// Acceleration in curves as a share of `acceleration`; 1 = what the axes are set to.
    pub curve_share: f32,
    /// Slack of each motor's drive, mm; 0 = none.
    pub backlash: PerAxis<f32, N>,
    /// How far chords may leave an arc, mm.
    pub arc_tolerance: f32,
    /// Ticks per second of the step timer.
    pub step_clock_hz: u32,
}

/// How fast a move is meant to be.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Speed {
    /// As fast as the axes go.
    Rapid,
    /// Along the path, mm/s.
    Feed(f32),
    /// The whole move in this many seconds.
    Duration(f32),
}

/// A straight move to be queued.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Move<const N: usize> {
    /// Where it ends, machine coordinates within [`Coordinate::LIMIT`].
    pub target: PerAxis<Coordinate, N>,
    /// How fast.
    pub speed: Speed,
    /// Spindle or laser power, 0 to 65535; rides with the segments.
    pub power: u16,
    /// Power falls and rises with actual / programmed speed (M4 of a laser).
    pub scale_power: bool,
    /// N word for reports, 0 = none.
    pub line_number: u32,
    /// Overrides leave the move alone (jog, homing, probing).
    pub no_feed_override: bool,
    /// The last digit of the program's coordinates, mm: how far apart neighbouring points are that it can name; 0 = exact.
    pub digit: f32,
    /// How far the tool may be from the path.
    pub tolerance: Tolerance,
}

/// The facade of this room.
#[derive(Debug)]
#[cfg_attr(feature = "alloc", derive(Clone))]
#[repr(C)]
pub struct Motion<const N: usize> {
    step_idle: bool,
    /// Machine steps when the step counters are 0.
    origin: PerAxis<i32, N>,
    settings: MotionSettings<N>,
    source: SegmentSource<N>,
    queue: MoveQueue<N>,
}

/// Where a motion works: memory that is lent to it.
#[derive(Debug)]
pub struct MotionMemory<const N: usize> {
    blocks: Lent<[Block<N>]>,
    groups: Lent<[Stretch]>,
    ring: Lent<[InFlightSegment<N>]>,
    scales: Lent<[Scale<N>]>,
}

/// That memory, to be lent: all 0, so that it needs no flash.
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
    /// Nothing in it counts.
    pub const EMPTY: Self = Self {
        blocks: [Block::NONE; BLOCKS],
        groups: [Stretch::BLANK; GROUPS],
        ring: [InFlightSegment::NONE; RING],
        scales: Chain::SCALES,
    };

    /// For good.
    pub fn lend(&'static mut self) -> MotionMemory<N> {
        MotionMemory {
            blocks: &mut self.blocks,
            groups: &mut self.groups,
            ring: &mut self.ring,
            scales: &mut self.scales,
        }
    }
}

/// Blocks of a motion for single moves: one for the move, and one to take up the slack.
const SINGLE_MOVE_BLOCKS: usize = 2;

/// Memory of a motion for single straight moves, each from rest to rest. Such a motion needs the ring of another one that
/// rests meanwhile ([`Motion::lend_ring`]).
#[derive(Debug)]
#[cfg(not(feature = "alloc"))]
pub struct SingleMoveStorage<const N: usize> {
    blocks: [Block<N>; SINGLE_MOVE_BLOCKS],
    ring: [InFlightSegment<N>; BEGUN],
}

#[cfg(not(feature = "alloc"))]
impl<const N: usize> SingleMoveStorage<N> {
    /// Nothing in it counts.
    pub const EMPTY: Self = Self { blocks: [Block::NONE; SINGLE_MOVE_BLOCKS], ring: [InFlightSegment::NONE; BEGUN] };

    /// For good.
    pub fn lend(&'static mut self) -> MotionMemory<N> {
        MotionMemory { blocks: &mut self.blocks, groups: &mut [], ring: &mut self.ring, scales: &mut [] }
    }
}

/// A workspace on the heap, with a look-ahead of so many blocks.
#[cfg(feature = "alloc")]
pub fn on_heap<const N: usize>(blocks: usize) -> MotionMemory<N> {
    MotionMemory {
        blocks: core::iter::repeat_n(Block::NONE, blocks).collect(),
        groups: Lent::new([Stretch::BLANK; GROUPS]),
        ring: Lent::new([InFlightSegment::NONE; RING]),
        scales: Lent::new(Chain::SCALES),
    }
}

/// A workspace on the heap as the one of `SingleMoveStorage`.
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
    /// At rest at machine position 0.
    pub fn new(settings: MotionSettings<N>, room: MotionMemory<N>) -> Self {
        let mut motion = Self::unconfigured(settings.step_clock_hz, room);
        motion.configure(settings);
        motion
    }

    /// The same before [`Motion::configure`], which must come before the first move.
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

    /// Takes over settings; at rest with an empty queue only. The machine position stays the same in steps.
    pub fn configure(&mut self, settings: MotionSettings<N>) {
        let before = self.prepared();
        self.settings = settings;
        self.source.configure(settings.step_clock_hz);
        self.queue.configure(&settings);
        let lead = self.queue.backlash.lead_within(before.lead);
        let motors = Motors { steps: before.tool().zip(&PerAxis(lead), i32::wrapping_add), lead };
        if lead != before.lead {
            // With less slack the motors lead less; the tool stays where it is.
            let moved = motors.steps.zip(&before.steps, i32::wrapping_sub);
            self.origin = self.origin.zip(&moved, i32::wrapping_add);
            self.source.in_flight.forget(motors.tool(), lead);
        }
        self.plan_from(motors);
    }

    /// The queue begins once more with the motors here.
    fn plan_from(&mut self, motors: Motors<N>) {
        let motors = self.queue.restart(motors);
        self.source.restart(motors);
    }

    /// Queues a move. `false`: no room, nothing done. A move without a step makes no block; its length goes to the next.
    pub fn line(&mut self, m: &Move<N>) -> bool {
        self.queue.take(m)
    }

    /// Queues a chord of a curve: [`Motion::line`], not faster than the curve allows, and stepped along its true ends
    /// instead of the steps next to them.
    pub fn chord(&mut self, m: &Move<N>, curvature: Curvature) -> bool {
        self.queue.take_chord(m, curvature)
    }

    /// Whether as many moves have been queued from rest as there are blocks, although some of them have been joined and the
    /// queue has room: reason enough to start.
    pub fn has_joined_enough(&self) -> bool {
        self.queue.has_joined_enough()
    }

    /// Blocks that the look-ahead has in all.
    pub fn blocks(&self) -> usize {
        self.queue.planner.capacity()
    }

    /// Room for moves. None while a move of more than 2^26 steps is still being cut.
    pub fn free_blocks(&self) -> usize {
        self.queue.free_blocks()
    }

    /// Moves queued, the running one included.
    pub fn queued_blocks(&self) -> usize {
        self.queue.planner.len()
    }

    /// How far the motors lead the tool where the machine rests.
    pub fn lead(&self) -> [i32; N] {
        self.prepared().lead
    }

    /// After what is queued the motors lead the tool by this much.
    pub fn end_with_lead(&mut self, lead: [i32; N]) {
        self.queue.backlash.want(lead);
        if self.queue.planner.len() == 0 {
            self.queue.finish_taking_up(&self.prepared(), self.source.running.line_number);
            self.start();
        }
    }

    /// The machine is where another motion has brought it; at rest only. Forgets what is queued.
    pub fn stand_where(&mut self, other: &Self) {
        let motors = other.prepared();
        self.origin = other.origin;
        self.source.in_flight.forget(motors.tool(), motors.lead);
        self.plan_from(motors);
    }

    /// Another motion takes over while this one rests, or gives back what it was lent: the two exchange their rings of
    /// segments in flight.
    #[inline(never)]
    pub fn lend_ring(&mut self, other: &mut Self) {
        self.source.in_flight.exchange_ring(&mut other.source.in_flight);
    }

    /// Begins to execute what is queued. Until then, and again after the queue has been emptied, nothing is handed over.
    pub fn start(&mut self) {
        if self.queue.planner.len() == 0 {
            self.queue.release();
        }
        if self.queue.planner.len() > 0 {
            self.source.start();
        }
    }

    /// The next message for the step task. `None`: nothing to do, not started, or enough time is queued.
    pub fn next(&mut self, observed: &Observed) -> Option<ToStep> {
        self.observe(observed);
        self.next_message()
    }

    /// The same without a new observation. Asked before each output: no call for nothing.
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

    /// The last block has been handed over. What is left of the slack is taken up.
    #[inline(never)]
    fn run_out(&mut self) {
        if self.queue.backlash.is_on() {
            self.queue.finish_taking_up(self.source.block_start(), self.source.running.line_number);
        }
        if self.queue.is_empty() {
            self.source.run_out();
        }
    }

    /// The deceleration of the first move in the queue, in units per square of a step-clock tick.
    pub fn braking(&self) -> f32 {
        let clock = self.source.step_clock_hz() as f32;
        self.queue.planner.first().map_or(0.0, |block| {
            let units_per_mm = (block.dominant() * UNITS_PER_STEP) as f32 / block.length;
            block.acceleration * units_per_mm / clock / clock
        })
    }

    /// Brakes to a stop, beginning with the next segment handed over.
    pub fn hold(&mut self) {
        self.source.hold();
    }

    /// Resumes after a hold, also before it has come to a stop.
    pub fn resume(&mut self) {
        if self.queue.planner.raised {
            // The hold has brought the machine below what was raised for its fall.
            self.replan();
        }
        self.source.resume(!self.queue.is_empty());
    }

    /// The step task has done something else meanwhile, and the machine is back at the very same position: the running
    /// block is announced once more. At rest only.
    pub fn reenter(&mut self) {
        self.source.running.announce_again();
    }

    /// The settings in force.
    pub fn settings(&self) -> MotionSettings<N> {
        self.settings
    }

    /// Whether a hold is in force and what was handed over ends at rest.
    pub fn is_held(&self) -> bool {
        self.source.is_held()
    }

    /// Feed override and rapid override as factors, 1 = as programmed; they act with the next segment handed over.
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

    /// Plans the whole queue under the overrides, from the state of the machine.
    #[inline(never)]
    fn replan(&mut self) {
        let (state, left) = self.source.path_state(self.queue.planner.first());
        self.queue.planner.replan(self.queue.overrides, state, left);
    }

    /// Forgets all queued moves. At rest, or once a hold has been handed over to its end; ignored in motion.
    pub fn discard(&mut self) {
        if !self.source.ends_at_rest() {
            return;
        }
        self.plan_from(self.prepared());
        self.source.stop();
    }

    /// After a stop or underrun of the step task, with its step counters: everything queued is forgotten and the position
    /// is exact. The gate of the step task is opened by the caller (`ToStep::Resume`) before anything of `next` reaches it.
    pub fn stopped(&mut self, position: &PerAxis<i32, N>) {
        let steps = position.zip(&self.origin, |count, origin| count.wrapping_add(origin));
        let before = self.source.in_flight.before();
        let motors = self.queue.backlash.followed(&Motors { steps: before.motors(), lead: before.lead }, steps);
        self.source.in_flight.forget(motors.tool(), motors.lead);
        self.plan_from(motors);
        self.source.stop();
    }

    /// Takes over how far the step task is.
    pub fn observe(&mut self, observed: &Observed) {
        self.step_idle = observed.step_idle;
        self.source.in_flight.observe(observed.segments_begun, observed.step_idle);
    }

    /// Whether a motion continues for which little time has been handed over.
    #[inline]
    pub fn is_short_of_segments(&self) -> bool {
        self.source.is_short_of_segments()
    }

    /// Whether nothing is in the step task and nothing will come before `start` or `resume`.
    pub fn is_at_rest(&self) -> bool {
        self.source.in_flight.is_empty() && self.step_idle && self.source.ends_at_rest() && !self.source.is_on()
    }

    /// Whether what has been handed over ends at rest, so that nothing need follow in time.
    pub fn ends_at_rest(&self) -> bool {
        self.source.ends_at_rest()
    }

    /// Whether the machine is at rest and nothing is queued.
    pub fn is_idle(&self) -> bool {
        self.is_at_rest() && self.queue.is_empty()
    }

    /// Whether segments are handed over as soon as there is room for them.
    pub fn hands_over(&self) -> bool {
        self.source.is_on()
    }

    /// Whether at least so many microseconds, a second at most, have been handed over and not begun.
    #[inline]
    pub fn holds_time(&self, us: u32) -> bool {
        self.source.holds_time(us)
    }

    /// Time of what has been handed over and not begun, in microseconds.
    pub fn queued_us(&self) -> u32 {
        self.source.queued_us()
    }

    /// Machine position in steps at the end of the segment begun last.
    pub fn machine_steps(&self) -> PerAxis<i32, N> {
        self.source.in_flight.current().position
    }

    /// Machine position at the end of the segment begun last.
    pub fn machine_position(&self) -> PerAxis<Coordinate, N> {
        self.queue.kinematics.place(&self.machine_steps())
    }

    /// Step counters, at rest.
    pub fn step_counters(&self) -> PerAxis<i32, N> {
        self.prepared().steps.zip(&self.origin, i32::wrapping_sub)
    }

    /// At rest: the position as programmed, and the step counters; nothing where the motors do not stand on the steps next to
    /// it, or lead their tool because of backlash.
    pub fn standing(&self) -> Option<(PerAxis<Coordinate, N>, PerAxis<i32, N>)> {
        let (motors, place) = (self.prepared(), self.queue.planned_position());
        let stands =
            self.is_idle() && self.queue.kinematics.steps(&place) == motors.steps && motors.tool() == motors.steps;
        stands.then(|| (place, self.step_counters()))
    }

    /// Declares where the machine is; at rest only. Forgets what is queued.
    pub fn set_machine_position(&mut self, position: &PerAxis<Coordinate, N>) {
        let old = self.prepared();
        let new = self.queue.kinematics.steps(position);
        let moved = new.zip(&old.tool(), i32::wrapping_sub);
        self.origin = self.origin.zip(&moved, i32::wrapping_add);
        self.source.in_flight.forget(new, old.lead);
        self.plan_from(Motors { steps: old.steps.zip(&moved, i32::wrapping_add), lead: old.lead });
        // The programmed position, not the nearest step: what follows is measured from it.
        self.queue.set_position(position);
    }

    /// The machine position at a reading of the step counters in the present straight move from rest.
    pub fn position_of_counter(&self, counter: &PerAxis<i32, N>) -> PerAxis<Coordinate, N> {
        let steps = counter.zip(&self.origin, i32::wrapping_add);
        self.queue.kinematics.place(&self.queue.backlash.followed(self.source.last_rest(), steps).tool())
    }

    /// End of the queue, as programmed.
    pub fn planned_position(&self) -> PerAxis<Coordinate, N> {
        self.queue.planned_position()
    }

    /// Speed of the segment being executed, mm/s; 0 at rest.
    pub fn speed(&self) -> f32 {
        self.source.in_flight.current().speed
    }

    /// Power of the segment being executed; 0 at rest.
    pub fn power(&self) -> u16 {
        self.source.in_flight.current().power
    }

    /// Whether blocks from here on can have another mark: not while a long move is still being cut.
    pub fn takes_mark(&self) -> bool {
        self.queue.long.is_none()
    }

    /// Blocks from here on have this mark, by which their begin is known.
    pub fn set_mark(&mut self, mark: u8) {
        let marked = mark << MARK_SHIFT;
        if marked != self.queue.marked {
            self.queue.release();
            self.queue.end_join();
            self.queue.marked = marked;
        }
    }

    /// The mark of the block begun last.
    pub fn begun_mark(&self) -> u8 {
        self.source.in_flight.current().mark
    }

    /// Power of the move that is handed over now, or next; `None` for a move that has no say in it (jog, homing, probing),
    /// or without one. It is ahead of the step task by the time queued there.
    pub fn running_power(&self) -> Option<u16> {
        match self.queue.planner.first() {
            Some(block) => (block.flags & NO_OVERRIDE == 0).then_some(block.power),
            None => self.queue.blend.moves().next().map(|held| held.m.power),
        }
    }

    /// N word of the block being executed, 0 if none.
    pub fn line_number(&self) -> u32 {
        self.source.in_flight.current().line_number
    }

    /// N word of the move that is handed over now or was last, 0 if none. It is ahead of the step task by the time queued there.
    pub fn running_line_number(&self) -> u32 {
        self.source.running.line_number
    }

    /// N words of the move that is handed over now or was last, and of those queued behind it.
    pub fn queued_line_numbers(&self) -> impl Iterator<Item = u32> {
        let planner = &self.queue.planner;
        let queued = (0..planner.len()).filter_map(|place| planner.block(place)).map(|block| block.line_number);
        let held = self.queue.blend.moves().map(|held| held.number);
        core::iter::once(self.running_line_number()).chain(queued).chain(held)
    }

    /// Moves have this number from here on, instead of their N words.
    pub fn number_moves(&mut self, number: u32) {
        self.queue.numbering = Numbering::Given(number);
    }

    /// The motors at the end of what has been handed over.
    fn prepared(&self) -> Motors<N> {
        self.source.motors(&self.queue.backlash)
    }
}

#[cfg(test)]
mod tests;
