//! Motion: straight moves in, messages for the step task out.
//!
//! ```text
//!  Move ─ kinematics ─▶ block ─▶ planner (look-ahead) ─▶ segment ─▶ ToStep … the step task: stepper
//!  arc ─ chords ─┘                 entry speeds        cut from the profile of the running block
//! ```
//! It promises: steps add up exactly; no axis is asked for more than its rate and acceleration; whatever has been handed
//! over ends at rest; a hold begins to brake within the time queued ([`QUEUED_TIME_MS`]). It knows nothing of G-code, of
//! replies or of machine states; when to start is decided outside.

pub mod arc;
mod backlash;
mod block;
mod curvature;
mod extent;
mod flight;
mod handover;
mod intake;
mod jerk;
mod join;
mod kinematics;
mod measure;
mod planner;
mod profile;
mod segment;
mod smooth;
pub mod stepper;

pub use arc::{Arc, ArcGeometry};
pub use extent::extent;
pub use stepper::{Stepper, Tick};

use crate::axes::{Arrangement, PerAxis};
use crate::messages::{Leg, Observed, UNITS_PER_STEP};
use crate::units::{Coordinate, StepsPerMm};
use backlash::{Backlash, Lead};
use block::{Block, NO_OVERRIDE, Overrides};
use core::ops::{Deref, DerefMut};
use curvature::{Chain, TurnRule};
use flight::Flight;
pub use handover::QUEUED_TIME_MS;
use jerk::State;
use join::Join;
use kinematics::Kinematics;
use measure::{signed_add, steps_taken};
use planner::Planner;
use profile::{Pace, lesser, square_root};
use segment::{Cut, Pacer};

/// Most steps of slack that are compensated: a hundredth of an inch with 40,000 steps/mm.
const MOST_BACKLASH: i32 = 10_000;

/// With backlash: what is left of it before a plunge, a cut, the rest of the move.
const MOST_BLOCKS_OF_A_MOVE: usize = 3;

/// Least speed, mm/s: a step per minute with 40,000 steps/mm.
const LEAST_SPEED: f32 = 4.0e-7;
/// Greatest speed and acceleration, far beyond any machine: squares stay within `f32`.
const GREATEST_SPEED: f32 = 1.0e5;
const LEAST_ACCELERATION: f32 = 1.0e-3;
const GREATEST_ACCELERATION: f32 = 1.0e7;
/// Shares of the acceleration that curves may take.
const LEAST_CURVE_SHARE: f32 = 0.01;
const GREATEST_CURVE_SHARE: f32 = 100.0;
/// Jerk within what the settings allow, and what stands for none.
const LEAST_JERK: f32 = 1.0;
const GREATEST_JERK: f32 = 1.0e10;
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
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Hold {
    None,
    /// Braking to a stop.
    Ramp,
    /// Stopped, nothing more is handed over.
    Held,
}

/// A move with more steps than a block can have, cut into equal pieces as there is room.
#[derive(Clone, Copy, Debug)]
struct LongMove<const N: usize> {
    start: PerAxis<Coordinate, N>,
    whole: Move<N>,
    bend2: f32,
    pieces: u32,
    next: u32,
}

/// Motors, and how far each leads its tool because of backlash.
#[derive(Clone, Copy, Debug)]
struct Motors<const N: usize> {
    steps: PerAxis<i32, N>,
    lead: Lead<N>,
}

impl<const N: usize> Motors<N> {
    const ZERO: Self = Self { steps: PerAxis::all(0), lead: [0; N] };

    /// The step at which the tool is.
    fn tool(&self) -> PerAxis<i32, N> {
        self.steps.zip(&PerAxis(self.lead), i32::wrapping_sub)
    }
}

/// The block that is being cut into segments.
#[derive(Clone, Copy, Debug)]
struct Running<const N: usize> {
    active: bool,
    /// Messages of the block still to be sent before its first segment.
    announce: Announce,
    /// The next segment is the block's first.
    fresh: bool,
    legs: [Leg; N],
    directions: u8,
    flags: u8,
    power: u16,
    line_number: u32,
    /// See [`measure::Measure`].
    threshold: u32,
    rates: [u32; N],
    credits: [u32; N],
    /// Units of the whole block and those cut off so far.
    total: u32,
    done: u32,
    /// Units of a millimetre.
    scale: f32,
    /// In units/s², units²/s².
    acceleration: f32,
    nominal2: f32,
    /// mm/s before overrides.
    programmed: f32,
}

impl<const N: usize> Running<N> {
    const NONE: Self = Self {
        active: false,
        announce: Announce::Nothing,
        fresh: false,
        legs: [Leg::on_steps(0); N],
        directions: 0,
        flags: 0,
        power: 0,
        line_number: 0,
        threshold: 0,
        rates: [0; N],
        credits: [0; N],
        total: 0,
        done: 0,
        scale: 1.0,
        acceleration: 1.0,
        nominal2: 1.0,
        programmed: 1.0,
    };
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Announce {
    Rest,
    Block,
    /// The block was left in its midst for moves of another kind.
    Reenter,
    Nothing,
}

/// A single tick that is far away, and how much of its time is left (fixed point).
#[derive(Clone, Copy, Debug)]
struct Far {
    cut: Cut,
    time: u64,
}

/// The end of the queue, before which the last block ends.
#[derive(Clone, Copy, Debug)]
struct End<const N: usize> {
    /// As programmed, where the last block ended, and in steps.
    planned: PerAxis<Coordinate, N>,
    block_end: PerAxis<Coordinate, N>,
    planned_steps: PerAxis<i32, N>,
    /// Length of moves without a step since `block_end`; below 0: length that the last block was given too much.
    carried: f32,
    /// Unit vector of the last block.
    direction: [f32; N],
    /// The last block has waited for moves without a step that led nowhere.
    waited: bool,
    /// The last block moves motors and no tool: what follows begins at rest.
    tool_stands: bool,
}

impl<const N: usize> End<N> {
    const ZERO: Self = Self {
        planned: PerAxis::all(Coordinate::ZERO),
        block_end: PerAxis::all(Coordinate::ZERO),
        planned_steps: PerAxis::all(0),
        carried: 0.0,
        direction: [0.0; N],
        waited: false,
        tool_stands: false,
    };
}

/// The running block, and the end of what has been handed over to the segment buffer.
#[derive(Clone, Copy, Debug)]
struct Feed<const N: usize> {
    running: Running<N>,
    /// The motors at the start of the running block, and where they last stood still.
    start: Motors<N>,
    stood: Motors<N>,
    /// Speed at the end of what has been handed over: in units/s of the running block, mm/s between blocks.
    pace: Pace,
    /// Acceleration along the path there, mm/s², and the least bound on it as far as it takes to ease it off; with a jerk
    /// limit only.
    pull: f32,
    ahead: f32,
    far: Option<Far>,
    /// What has been handed over ends at rest.
    rest: bool,
    started: bool,
    hold: Hold,
}

impl<const N: usize> Feed<N> {
    const REST: Self = Self {
        running: Running::NONE,
        start: Motors::ZERO,
        stood: Motors::ZERO,
        pace: Pace::REST,
        pull: 0.0,
        ahead: 0.0,
        far: None,
        rest: true,
        started: false,
        hold: Hold::None,
    };
}

/// The facade of this room, with a look-ahead ring of so many blocks.
pub type Motion<const N: usize, const BLOCKS: usize> = MotionWith<N, [Block<N>; BLOCKS]>;

/// The same whatever the length of its ring: all that it does is in the program once, for the unsized ring.
pub type AnyMotion<const N: usize> = MotionWith<N, [Block<N>]>;

/// See [`Motion`].
// In this order, small things first: one instruction reaches 4 KiB from the base.
#[derive(Debug)]
#[repr(C)]
pub struct MotionWith<const N: usize, R: ?Sized> {
    kinematics: Kinematics<N>,
    backlash: Backlash<N>,
    max_rate: [f32; N],
    turns: TurnRule<N>,
    jerk: [f32; N],
    step_clock_hz: u32,
    pacer: Pacer,
    overrides: Overrides,

    end: End<N>,
    /// How far the end is beyond its steps, in sevenths of a step; known after a chord of an arc only.
    beyond: Option<[i32; N]>,
    long: Option<LongMove<N>>,

    feed: Feed<N>,
    step_idle: bool,
    /// Machine steps when the step counters are 0.
    origin: PerAxis<i32, N>,
    settings: MotionSettings<N>,
    /// The lines at the end of the queue, for their curvature. Broken by an arc, which knows its own.
    chain: Chain<N>,
    /// The last block, as far as short moves may continue it.
    join: Join<N>,

    flight: Flight<N>,
    planner: Planner<N, R>,
}

impl<const N: usize, const BLOCKS: usize> Deref for Motion<N, BLOCKS> {
    type Target = AnyMotion<N>;

    #[inline(always)]
    fn deref(&self) -> &AnyMotion<N> {
        self
    }
}

impl<const N: usize, const BLOCKS: usize> DerefMut for Motion<N, BLOCKS> {
    #[inline(always)]
    fn deref_mut(&mut self) -> &mut AnyMotion<N> {
        self
    }
}

// Not derived: what may be unsized cannot be cloned.
impl<const N: usize, const BLOCKS: usize> Clone for Motion<N, BLOCKS> {
    fn clone(&self) -> Self {
        Self {
            kinematics: self.kinematics,
            backlash: self.backlash,
            max_rate: self.max_rate,
            turns: self.turns,
            jerk: self.jerk,
            step_clock_hz: self.step_clock_hz,
            pacer: self.pacer,
            overrides: self.overrides,
            end: self.end,
            beyond: self.beyond,
            long: self.long,
            feed: self.feed,
            step_idle: self.step_idle,
            origin: self.origin,
            settings: self.settings,
            chain: self.chain.clone(),
            join: self.join.clone(),
            flight: self.flight.clone(),
            planner: self.planner.clone(),
        }
    }
}

/// `value` within bounds, the least one for a NaN.
fn bounded(value: f32, least: f32, greatest: f32) -> f32 {
    if value > least { lesser(value, greatest) } else { least }
}

/// Steps with their direction.
fn signed_steps<const N: usize>(steps: &[u32; N], directions: u8) -> [i32; N] {
    let mut signed = [0; N];
    for (bit, (signed, steps)) in signed.iter_mut().zip(steps).enumerate() {
        *signed = signed_add(0, *steps, directions >> bit & 1 != 0);
    }
    signed
}

fn unsigned_steps<const N: usize>(signed: &[i32; N]) -> ([u32; N], u8) {
    let mut directions = 0;
    for (bit, steps) in signed.iter().enumerate() {
        directions |= u8::from(*steps < 0) << bit;
    }
    (signed.map(i32::unsigned_abs), directions)
}

impl<const N: usize, const BLOCKS: usize> Motion<N, BLOCKS> {
    /// At rest at machine position 0.
    pub fn new(settings: MotionSettings<N>) -> Self {
        let mut motion = Self::unconfigured(settings.step_clock_hz);
        motion.configure(settings);
        motion
    }

    /// The same before [`Motion::configure`], which must come before the first move. Can be computed by the compiler, so
    /// that a static one needs no stack to be built on.
    pub const fn unconfigured(step_clock_hz: u32) -> Self {
        Self {
            settings: MotionSettings {
                arrangement: Arrangement::Cartesian,
                steps_per_mm: PerAxis::all(StepsPerMm::ONE),
                backlash: PerAxis::all(0.0),
                max_rate: PerAxis::all(1.0),
                acceleration: PerAxis::all(1.0),
                jerk: PerAxis::all(0.0),
                junction_deviation: 0.0,
                curve_share: 1.0,
                arc_tolerance: 0.0,
                step_clock_hz,
            },
            kinematics: Kinematics::ONE,
            backlash: Backlash::NONE,
            max_rate: [1.0; N],
            turns: TurnRule { acceleration: [1.0; N], deviation: 0.0, curve_share: 1.0 },
            jerk: [GREATEST_JERK; N],
            step_clock_hz,
            pacer: Pacer::new(step_clock_hz),
            planner: Planner::new(),
            overrides: Overrides { feed: 1.0, rapid: 1.0 },
            end: End::ZERO,
            beyond: None,
            long: None,
            feed: Feed::REST,
            chain: Chain::new(),
            join: Join::NONE,
            flight: Flight::new(PerAxis::all(0)),
            step_idle: true,
            origin: PerAxis::all(0),
        }
    }
}

impl<const N: usize> AnyMotion<N> {
    /// Takes over settings; at rest with an empty queue only. The machine position stays the same in steps.
    pub fn configure(&mut self, settings: MotionSettings<N>) {
        self.settings = settings;
        self.kinematics = Kinematics::new(settings.arrangement, settings.steps_per_mm);
        self.join.configure(&self.kinematics);
        self.max_rate = settings.max_rate.0.map(|rate| bounded(rate, LEAST_SPEED, GREATEST_SPEED));
        self.turns.acceleration =
            settings.acceleration.0.map(|a| bounded(a, LEAST_ACCELERATION, GREATEST_ACCELERATION));
        let jerk = |jerk| if jerk > 0.0 { bounded(jerk, LEAST_JERK, GREATEST_JERK) } else { GREATEST_JERK };
        self.jerk = settings.jerk.0.map(jerk);
        self.planner.jerk_limited = settings.jerk.iter().any(|jerk| *jerk > 0.0);
        self.turns.deviation = bounded(settings.junction_deviation, 0.0, 1.0e3);
        self.turns.curve_share = bounded(settings.curve_share, LEAST_CURVE_SHARE, GREATEST_CURVE_SHARE);
        self.step_clock_hz = settings.step_clock_hz.max(10_000);
        self.pacer = Pacer::new(self.step_clock_hz);
        let scales = settings.steps_per_mm;
        let slack = settings.backlash.zip(&scales, |mm, scale| (mm * scale.to_f32() + 0.5) as i32);
        let before = self.prepared();
        self.backlash.configure(slack.0.map(|steps| steps.clamp(0, MOST_BACKLASH)));
        let lead = self.backlash.lead_within(before.lead);
        let motors = Motors { steps: before.tool().zip(&PerAxis(lead), i32::wrapping_add), lead };
        if lead != before.lead {
            // With less slack the motors lead less; the tool stays where it is.
            let moved = motors.steps.zip(&before.steps, i32::wrapping_sub);
            self.origin = self.origin.zip(&moved, i32::wrapping_add);
            self.flight.forget(motors.tool(), lead);
        }
        self.plan_from(motors);
    }

    /// The queue begins anew with the motors here.
    fn plan_from(&mut self, motors: Motors<N>) {
        self.backlash.rest(motors.lead);
        let motors = Motors { lead: self.backlash.lead(), ..motors };
        let steps = motors.tool();
        self.planner.clear();
        self.join.forget();
        self.long = None;
        self.feed.running.active = false;
        self.feed.far = None;
        self.feed.pace = Pace::REST;
        self.feed.pull = 0.0;
        self.end.carried = 0.0;
        self.feed.rest = true;
        self.feed.start = motors;
        self.feed.stood = motors;
        self.end.planned_steps = steps;
        self.end.planned = self.kinematics.place(&steps);
        self.beyond = None;
        self.end.block_end = self.end.planned;
        self.end.tool_stands = false;
        self.end.waited = false;
        self.chain.restart(&self.end.planned);
    }

    /// Room for moves. None while a move of more than 2^26 steps is still being cut.
    pub fn free_blocks(&self) -> usize {
        let spare = if self.backlash.is_on() { MOST_BLOCKS_OF_A_MOVE.min(self.planner.capacity()) - 1 } else { 0 };
        if self.long.is_some() { 0 } else { self.planner.free().saturating_sub(spare) }
    }

    /// Moves queued, the running one included.
    pub fn queued_blocks(&self) -> usize {
        self.planner.len()
    }

    /// How far the motors lead the tool where the machine rests.
    pub fn lead(&self) -> [i32; N] {
        self.prepared().lead
    }

    /// The motors lead the tool by this much; at rest with an empty queue only.
    pub fn set_lead(&mut self, lead: [i32; N]) {
        self.plan_from(Motors { lead, ..self.prepared() });
    }

    /// After what is queued the motors lead the tool by this much.
    pub fn end_with_lead(&mut self, lead: [i32; N]) {
        self.backlash.want(lead);
        if self.planner.len() == 0 {
            self.finish_taking_up(&self.prepared());
            self.start();
        }
    }

    /// The machine is where another motion has brought it; at rest only. Forgets what is queued.
    pub fn stand_where(&mut self, other: &Self) {
        let motors = other.prepared();
        self.origin = other.origin;
        self.flight.forget(motors.tool(), motors.lead);
        self.plan_from(motors);
    }

    /// Begins to execute what is queued. Until then, and again after the queue has been emptied, nothing is handed over.
    pub fn start(&mut self) {
        if self.planner.len() > 0 {
            self.feed.started = true;
        }
    }

    /// The deceleration of the first move in the queue, in units per square of a step-clock tick.
    pub fn braking(&self) -> f32 {
        let clock = self.step_clock_hz as f32;
        self.planner.first().map_or(0.0, |block| {
            let units_per_mm = (block.dominant() * UNITS_PER_STEP) as f32 / block.length;
            block.acceleration * units_per_mm / clock / clock
        })
    }

    /// Brakes to a stop, beginning with the next segment handed over.
    pub fn hold(&mut self) {
        if self.feed.hold == Hold::None {
            self.feed.hold = if self.feed.rest { Hold::Held } else { Hold::Ramp };
        }
    }

    /// Goes on after a hold, also before it has come to a stop.
    pub fn resume(&mut self) {
        self.feed.hold = Hold::None;
        if self.planner.raised {
            // The hold has brought the machine below what was raised for its fall.
            self.replan();
        }
        self.start();
    }

    /// The step task has done something else meanwhile, and the machine is back at the very place: the running block is
    /// announced anew. At rest only.
    pub fn reenter(&mut self) {
        if self.feed.running.active {
            self.feed.running.announce = if N > 3 { Announce::Rest } else { Announce::Block };
            self.feed.running.fresh = true;
        }
    }

    /// The settings in force.
    pub fn settings(&self) -> MotionSettings<N> {
        self.settings
    }

    /// Whether a hold is in force and what was handed over ends at rest.
    pub fn is_held(&self) -> bool {
        self.feed.hold == Hold::Held
    }

    /// Factors on feeds and rapids, 1 = as programmed; they act with the next segment handed over.
    pub fn set_overrides(&mut self, feed: f32, rapid: f32) {
        let overrides = Overrides {
            feed: bounded(feed, LEAST_OVERRIDE, GREATEST_OVERRIDE),
            rapid: bounded(rapid, LEAST_OVERRIDE, GREATEST_OVERRIDE),
        };
        if overrides == self.overrides {
            return;
        }
        self.overrides = overrides;
        self.replan();
        self.hurry_tick();
    }

    /// Plans the whole queue under the overrides, from the state of the machine.
    #[inline(never)]
    fn replan(&mut self) {
        let millimetre = if self.feed.running.active { 1.0 / self.feed.running.scale } else { 1.0 };
        let left = match self.planner.first() {
            Some(first) if !self.feed.running.active => first.length,
            _ => (self.feed.running.total - self.feed.running.done) as f32 * millimetre,
        };
        let state = State { speed: self.feed.pace.speed * millimetre, acceleration: self.feed.pull };
        self.planner.replan(self.overrides, state, left);
    }

    /// The running block gets the speed of the overrides, and a tick that is waited for comes sooner or later.
    fn hurry_tick(&mut self) {
        if !self.feed.running.active {
            return;
        }
        let Some(block) = self.planner.first() else { return };
        let nominal = block.nominal(self.overrides) * self.feed.running.scale;
        let nominal2 = nominal * nominal;
        if nominal2 == self.feed.running.nominal2 {
            return;
        }
        self.feed.running.nominal2 = nominal2;
        // A tick on a ramp with bounded jerk is not hurried.
        if let Some(far) = &mut self.feed.far
            && far.cut.acceleration == 0.0
        {
            // The tick that is waited for comes sooner or later in proportion, as if the speed had changed at once: it is
            // a sixteenth of a step.
            let speed = far.cut.units as f32 / far.cut.seconds;
            let changed = square_root(nominal2.min(speed * speed + 2.0 * self.feed.running.acceleration));
            far.time = (far.time as f32 * (speed / changed)) as u64;
            far.cut.seconds = far.cut.units as f32 / changed;
            if far.cut.end.speed2 > nominal2 {
                far.cut.end = Pace { speed: nominal, speed2: nominal2 };
            }
        }
    }

    /// Forgets all queued moves. At rest, or once a hold has been handed over to its end; ignored in motion.
    pub fn discard(&mut self) {
        if !self.feed.rest {
            return;
        }
        self.plan_from(self.prepared());
        self.feed.started = false;
        self.feed.hold = Hold::None;
    }

    /// After a stop or underrun of the step task, with its step counters: everything queued is forgotten and the position
    /// is exact. The gate of the step task is opened by the caller (`ToStep::Resume`) before anything of `next` reaches it.
    pub fn stopped(&mut self, position: &PerAxis<i32, N>) {
        let steps = position.zip(&self.origin, |count, origin| count.wrapping_add(origin));
        let before = self.flight.before();
        let motors = self.followed(&Motors { steps: before.motors(), lead: before.lead }, steps);
        self.flight.forget(motors.tool(), motors.lead);
        self.plan_from(motors);
        self.feed.started = false;
        self.feed.hold = Hold::None;
    }

    /// Takes over how far the step task is.
    pub fn observe(&mut self, observed: &Observed) {
        self.step_idle = observed.step_idle;
        self.flight.observe(observed.segments_begun, observed.step_idle);
    }

    /// Whether nothing is in the step task and nothing will come before `start` or `resume`.
    pub fn is_at_rest(&self) -> bool {
        self.flight.is_empty()
            && self.step_idle
            && self.feed.rest
            && (!self.feed.started || self.feed.hold == Hold::Held)
    }

    /// Whether what has been handed over ends at rest, so that nothing need follow in time.
    pub fn ends_at_rest(&self) -> bool {
        self.feed.rest
    }

    /// Whether the machine is at rest and nothing is queued.
    pub fn is_idle(&self) -> bool {
        self.is_at_rest() && self.planner.len() == 0 && self.long.is_none()
    }

    /// Time of what has been handed over and not begun, in microseconds.
    pub fn queued_us(&self) -> u32 {
        self.flight.queued() / (self.step_clock_hz / 1_000_000).max(1)
    }

    /// Machine position in steps at the end of the segment begun last.
    pub fn machine_steps(&self) -> PerAxis<i32, N> {
        self.flight.current().position
    }

    /// Machine position at the end of the segment begun last.
    pub fn machine_position(&self) -> PerAxis<Coordinate, N> {
        self.kinematics.place(&self.machine_steps())
    }

    /// Declares where the machine is; at rest only. Forgets what is queued.
    pub fn set_machine_position(&mut self, position: &PerAxis<Coordinate, N>) {
        let old = self.prepared();
        let new = self.kinematics.steps(position);
        let moved = new.zip(&old.tool(), i32::wrapping_sub);
        self.origin = self.origin.zip(&moved, i32::wrapping_add);
        self.flight.forget(new, old.lead);
        self.plan_from(Motors { steps: old.steps.zip(&moved, i32::wrapping_add), lead: old.lead });
        // The programmed place, not the nearest step: what follows is measured from it.
        self.end.planned = *position;
        self.end.block_end = *position;
        self.chain.restart(position);
    }

    /// The machine position at a reading of the step counters in the present straight move from rest.
    pub fn position_of_counter(&self, counter: &PerAxis<i32, N>) -> PerAxis<Coordinate, N> {
        let steps = counter.zip(&self.origin, i32::wrapping_add);
        self.kinematics.place(&self.followed(&self.feed.stood, steps).tool())
    }

    /// The motors after they have turned to other steps, each in one direction.
    fn followed(&self, from: &Motors<N>, steps: PerAxis<i32, N>) -> Motors<N> {
        let turned = steps.zip(&from.steps, i32::wrapping_sub);
        Motors { steps, lead: self.backlash.follow(&from.lead, &turned.0) }
    }

    /// End of the queue, as programmed.
    pub fn planned_position(&self) -> PerAxis<Coordinate, N> {
        self.long.map_or(self.end.planned, |long| long.whole.target)
    }

    /// Speed of the segment being executed, mm/s; 0 at rest.
    pub fn speed(&self) -> f32 {
        self.flight.current().speed
    }

    /// Power of the segment being executed; 0 at rest.
    pub fn power(&self) -> u16 {
        self.flight.current().power
    }

    /// Power of the move that is handed over now, or next; `None` for a move that has no say in it (jog, homing, probing),
    /// or without one. It is ahead of the step task by the time queued there.
    pub fn running_power(&self) -> Option<u16> {
        let block = self.planner.first()?;
        (block.flags & NO_OVERRIDE == 0).then_some(block.power)
    }

    /// N word of the block being executed, 0 if none.
    pub fn line_number(&self) -> u32 {
        self.flight.current().line_number
    }

    /// The motors at the end of what has been handed over.
    fn prepared(&self) -> Motors<N> {
        let run = &self.feed.running;
        if !run.active {
            return self.feed.start;
        }
        let mut position = self.feed.start.steps;
        let axes = run.legs.iter().zip(run.rates.iter().zip(run.credits));
        for (bit, (value, (leg, (rate, credit)))) in position.iter_mut().zip(axes).enumerate() {
            let taken =
                if run.done == run.total { leg.steps() } else { steps_taken(*rate, credit, run.threshold, run.done) };
            *value = signed_add(*value, taken, run.directions >> bit & 1 != 0);
        }
        if self.backlash.is_on() {
            return self.followed(&self.feed.start, position);
        }
        Motors { steps: position, lead: self.feed.start.lead }
    }
}

#[cfg(test)]
mod tests;
