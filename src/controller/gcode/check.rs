//! Second step: what the words of a line mean in the present state. One function for each step, in the order in which
//! Grbl looks; the first fault wins.

use super::Dialect;
use super::arc::{self, Vector};
use super::cycle::Cycle;
use super::interpreter::Interpreter;
use super::modal::{ArcDistance, CoordinateSystem, Distance, FeedMode, Modal, MotionMode, PlaneAxes, ProbeMode, Units};
use super::offsets::StoredOffset;
use super::parse::Parsed;
use super::state_words::Keeping;
use super::word::{Claim, Groups, Letters, MWord, NonModal};
use crate::axes::{Axis, PerAxis};
use crate::error::Error;
use crate::messages::{Coolant, SpindleDirection};
use crate::units::{Coordinate, DECIMAL_ONE, Decimal, Duration, per_second};

/// Greatest line number.
const LINE_NUMBER_MAX: i32 = 10_000_000;
/// Most turns that P may give an arc.
const TURNS_MAX: i32 = 1_000_000;

/// Letters of an arc's centre.
const CENTRE: Letters = Letters::of(b"IJK");

/// What a line asks for, in the order in which it is carried out. The last of it is the state afterwards, which
/// `Interpreter::commit` takes over.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Checked<const N: usize> {
    /// N; 0 if there is none.
    pub line_number: u32,
    /// The spindle's new state, if it changes before the motion. (At the program's end it stops: see [`Flow::End`].)
    pub spindle: Option<SpindleDirection>,
    /// Whether S differs from what was in force.
    pub speed_changed: bool,
    /// S in revolutions per minute, in force from here on.
    pub speed: f32,
    /// The coolant's new state, if it changes before the motion.
    pub coolant: Option<Coolant>,
    /// M6 asks for another tool than the spindle holds.
    pub tool_change: bool,
    /// How long to wait before the motion.
    pub dwell: Option<Duration>,
    /// Machine and work positions relate otherwise afterwards, or another coordinate system is active.
    pub work_offset_changed: bool,
    /// The line goes to a place of the machine or keeps one (G53, G28, G30, G28.1, G30.1), so it needs a machine position
    /// that is true.
    pub uses_machine_place: bool,
    /// The stored place that gets a new value at the commit, or the tool that loses its own.
    pub store: Option<StoredOffset>,
    /// The motion.
    pub motion: Motion<N>,
    /// The last digit of its words, mm: 0.01 mm or 0.001 inch at most, for trailing zeros are often left out.
    pub digit: f32,
    /// What follows the motion.
    pub flow: Flow,
    pub(super) modal: Modal,
    pub(super) g92: PerAxis<Coordinate, N>,
    pub(super) tool_length: PerAxis<Coordinate, N>,
    pub(super) after: Afterwards,
    pub(super) stored: Option<PerAxis<Coordinate, N>>,
    pub(super) position: PerAxis<Coordinate, N>,
}

/// What a line leaves behind that Grbl does not know.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Afterwards {
    pub(super) spindle_tool: u32,
    /// The line has M3, M4 or M5.
    pub(super) spindle_word: bool,
    /// What G92.3 brings back is the G92 of this line.
    pub(super) keeps_g92: bool,
    pub(super) g92_acts: bool,
    pub(super) keeping: Keeping,
}

impl<const N: usize> Checked<N> {
    /// The modal state afterwards.
    pub fn modal(&self) -> &Modal {
        &self.modal
    }

    /// Whether something other than a motion follows from the line: outputs, or a record to be stored.
    pub fn changes_outputs(&self) -> bool {
        self.spindle.is_some() || self.coolant.is_some() || self.speed_changed || self.store.is_some()
    }

    /// The spindle has been stopped for another tool: it turns again only if the line says so.
    pub fn spindle_stopped_for_tool(&mut self) {
        if !self.after.spindle_word {
            self.modal.spindle = SpindleDirection::Off;
        }
        self.spindle = (self.modal.spindle != SpindleDirection::Off).then_some(self.modal.spindle);
    }

    /// The tool that is taken out of the table.
    pub fn removes_tool(&self) -> Option<u32> {
        match (self.store, &self.stored) {
            (Some(StoredOffset::Tool(number)), None) => Some(number),
            _ => None,
        }
    }

    /// The tool that the spindle holds afterwards.
    pub fn spindle_tool(&self) -> u32 {
        self.after.spindle_tool
    }

    /// The machine position afterwards.
    pub fn position(&self) -> &PerAxis<Coordinate, N> {
        &self.position
    }

    /// A straight move that ends elsewhere: a jog cut short at the end of the travel.
    pub fn redirect(&mut self, place: PerAxis<Coordinate, N>) {
        if let Motion::Line { target, .. } = &mut self.motion {
            *target = place;
            self.position = place;
        }
    }

    /// What asks for nothing and knows no state.
    pub const NOTHING: Self = Self {
        line_number: 0,
        spindle: None,
        speed_changed: false,
        speed: 0.0,
        coolant: None,
        tool_change: false,
        dwell: None,
        work_offset_changed: false,
        uses_machine_place: false,
        store: None,
        motion: Motion::None,
        digit: 0.0,
        flow: Flow::None,
        modal: Modal::INITIAL,
        g92: PerAxis::all(Coordinate::ZERO),
        tool_length: PerAxis::all(Coordinate::ZERO),
        after: Afterwards {
            spindle_tool: 0,
            spindle_word: false,
            keeps_g92: false,
            g92_acts: false,
            keeping: Keeping::Leave,
        },
        stored: None,
        position: PerAxis::all(Coordinate::ZERO),
    };

    /// Becomes what leaves everything as it is. In its place: a new one would be copied there with room for an arc.
    pub(super) fn begin(&mut self, state: &Interpreter<N>) {
        self.line_number = 0;
        self.uses_machine_place = false;
        self.motion = Motion::None;
        self.position = state.position;
        self.only_moves(state);
    }

    /// Of the state nothing but the position is changed.
    pub(super) fn only_moves(&mut self, state: &Interpreter<N>) {
        self.spindle = None;
        self.speed_changed = false;
        self.speed = state.modal.speed;
        self.coolant = None;
        self.dwell = None;
        self.work_offset_changed = false;
        self.store = None;
        self.flow = Flow::None;
        self.modal = state.modal;
        self.g92 = state.offsets.g92;
        self.tool_length = state.offsets.tool_length;
        self.tool_change = false;
        self.after.keeps_g92 = false;
        self.after.g92_acts = state.offsets.g92_acts;
        self.after.keeping = Keeping::Leave;
        self.after.spindle_tool = state.spindle_tool;
        self.stored = None;
    }
}

/// The motion of a line, in machine coordinates. Every target is within [`Coordinate::LIMIT`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Motion<const N: usize> {
    /// Nothing moves.
    None,
    /// A straight move.
    Line {
        /// Where G28 and G30 pass through, with a rapid.
        via: Option<PerAxis<Coordinate, N>>,
        /// Where it ends.
        target: PerAxis<Coordinate, N>,
        /// How fast.
        feed: Feed,
    },
    /// An arc or helix.
    Arc(ArcMove<N>),
    /// A straight move until the probe changes.
    Probe {
        /// Where it ends if the probe does not change.
        target: PerAxis<Coordinate, N>,
        /// How fast.
        feed: Feed,
        /// Waits for the loss of contact instead of contact.
        away: bool,
        /// No change is an alarm.
        alarm: bool,
    },
    /// A canned cycle.
    Cycle(Cycle<N>),
}

/// An arc from `start` to `target` round a centre. The axes outside its plane move evenly meanwhile. Start and target
/// are as far from the centre within the tolerance of the check (0.005 mm or, below 0.5 mm, 0.1 % of the radius).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ArcMove<const N: usize> {
    /// Where it begins.
    pub start: PerAxis<Coordinate, N>,
    /// Where it ends. If it is the start (within the plane), the arc is a full circle.
    pub target: PerAxis<Coordinate, N>,
    /// The plane.
    pub axes: PlaneAxes,
    /// The centre along the first axis of the plane, from the start.
    pub i: Coordinate,
    /// The centre along the second axis of the plane, from the start.
    pub j: Coordinate,
    /// G2 instead of G3.
    pub clockwise: bool,
    /// Full turns before the arc.
    pub turns: u32,
    /// How fast.
    pub feed: Feed,
}

/// Speed of a motion.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Feed {
    /// As fast as the machine allows.
    Rapid,
    /// G94: along the path, in mm/s.
    PerMinute(f32),
    /// G93: seconds for the whole motion.
    InverseTime(f32),
}

/// What follows a line's motion.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Flow {
    /// The next line.
    #[default]
    None,
    /// M0.
    Pause,
    /// M1.
    OptionalPause,
    /// M2, M30: spindle and coolant stop, overrides go back to 100 %.
    End,
}

/// What a line is checked for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Purpose {
    Program,
    Jog,
}

/// Checks the words of a line.
pub(super) fn check<const N: usize>(
    state: &Interpreter<N>,
    line: &Parsed<N>,
    dialect: Dialect,
    purpose: Purpose,
    checked: &mut Checked<N>,
) -> Result<(), Error> {
    let mut check = Check::begin(state, line, dialect, purpose, checked);
    // Most lines have none of these, and every instruction counts.
    let is_extended = line.extended.any;
    if is_extended {
        check.keep_state()?;
    }
    check.line_number()?;
    check.feed()?;
    check.speed();
    check.tool()?;
    check.spindle_and_coolant();
    check.parking_override();
    if is_extended {
        check.overrides()?;
        check.path_control();
    }
    check.dwell()?;
    check.tool_length()?;
    check.non_modal()?;
    check.motion()?;
    check.unused_words()?;
    check.finish();
    Ok(())
}

/// A line half checked.
pub(super) struct Check<'a, const N: usize> {
    pub(super) state: &'a Interpreter<N>,
    pub(super) line: &'a Parsed<N>,
    pub(super) dialect: Dialect,
    purpose: Purpose,
    /// Who uses the axis words, the implied motion included.
    claim: Claim,
    /// Value words that no step has asked for yet.
    pub(super) unused: Letters,
    /// The result so far; its modal state is the one that the line's own words have set.
    pub(super) checked: &'a mut Checked<N>,
}

impl<'a, const N: usize> Check<'a, N> {
    /// The line's modal words over the modal state; axis words that no command asks for belong to the motion mode.
    fn begin(
        state: &'a Interpreter<N>,
        line: &'a Parsed<N>,
        dialect: Dialect,
        purpose: Purpose,
        checked: &'a mut Checked<N>,
    ) -> Self {
        checked.begin(state);
        let modal = &mut checked.modal;
        if purpose == Purpose::Jog {
            modal.motion = MotionMode::Linear;
            modal.feed_mode = FeedMode::PerMinute;
        }
        if let Some(motion) = line.modal.motion {
            modal.motion = motion;
        } else if dialect == Dialect::Seed
            && modal.motion == MotionMode::Cancelled
            && line.claim == Claim::Nobody
            && !line.axes.is_empty()
        {
            modal.motion = modal.straight;
        }
        if matches!(modal.motion, MotionMode::Rapid | MotionMode::Linear) {
            modal.straight = modal.motion;
        }
        modal.plane = line.modal.plane.unwrap_or(modal.plane);
        modal.distance = line.modal.distance.unwrap_or(modal.distance);
        modal.arc_distance = line.modal.arc_distance.unwrap_or(modal.arc_distance);
        modal.feed_mode = line.modal.feed_mode.unwrap_or(modal.feed_mode);
        modal.units = line.modal.units.unwrap_or(modal.units);
        modal.retract_to_r = line.modal.retract_to_r.unwrap_or(modal.retract_to_r);
        modal.coordinate_system = line.modal.coordinate_system.unwrap_or(modal.coordinate_system);
        // A full circle needs no axis word.
        let is_circle = dialect != Dialect::Grbl
            && matches!(modal.motion, MotionMode::ArcClockwise | MotionMode::ArcCounterClockwise)
            && line.values.has_any(CENTRE);
        let claim = match line.claim {
            Claim::Nobody if !line.axes.is_empty() || is_circle => Claim::Motion,
            claim => claim,
        };
        Self { state, line, dialect, purpose, claim, unused: line.values, checked }
    }

    fn line_number(&mut self) -> Result<(), Error> {
        let number = self.line.value.n.truncate();
        if number > LINE_NUMBER_MAX {
            return Err(Error::InvalidLineNumber);
        }
        self.checked.line_number = number.unsigned_abs();
        Ok(())
    }

    /// F holds on in G94 only: with G93 each motion needs its own, and a change of the mode leaves none.
    fn feed(&mut self) -> Result<(), Error> {
        if self.line.extended.keep.is_some() {
            // M72 restores F beside its mode.
            return Ok(());
        }
        let given = self.line.values.has(b'F');
        let modal = self.checked.modal;
        self.checked.modal.feed = match (modal.feed_mode, given) {
            (_, false) if self.purpose == Purpose::Jog => return Err(Error::UndefinedFeed),
            (FeedMode::InverseTime, true) => self.line.value.f,
            (FeedMode::InverseTime, false) => {
                let needed = !matches!(modal.motion, MotionMode::Rapid | MotionMode::Cancelled);
                if needed && self.claim == Claim::Motion {
                    return Err(Error::UndefinedFeed);
                }
                Decimal::ZERO
            }
            (FeedMode::PerMinute, true) => Decimal(self.length(self.line.value.f).0),
            (FeedMode::PerMinute, false) if self.state.modal.feed_mode == FeedMode::PerMinute => modal.feed,
            (FeedMode::PerMinute, false) => Decimal::ZERO,
        };
        Ok(())
    }

    fn speed(&mut self) {
        let (line, modal) = (self.line, &mut self.checked.modal);
        if line.values.has(b'S') {
            modal.speed = line.value.s.to_f32();
        }
        self.checked.speed = self.checked.modal.speed;
        self.checked.speed_changed = self.checked.speed != self.state.modal.speed;
    }

    fn spindle_and_coolant(&mut self) {
        let (line, modal) = (self.line, &mut self.checked.modal);
        modal.spindle = line.spindle.unwrap_or(modal.spindle);
        match line.coolant {
            Some(MWord::Mist) => modal.coolant.mist = true,
            Some(MWord::Flood) => modal.coolant.flood = true,
            Some(_) => modal.coolant = Coolant::default(),
            None => {}
        }
        let (before, modal) = (&self.state.modal, &self.checked.modal);
        self.checked.spindle = (modal.spindle != before.spindle).then_some(modal.spindle);
        self.checked.coolant = (modal.coolant != before.coolant).then_some(modal.coolant);
    }

    /// As in Grbl and grblHAL: M56 P0 holds parking off; M56 alone or with another P lets the tool park again.
    fn parking_override(&mut self) {
        if self.line.parking_override {
            self.checked.modal.no_parking = self.line.values.has(b'P') && self.line.value.p == Decimal::ZERO;
            self.unused.remove(Letters::of(b"P"));
        }
    }

    /// P and Q of G64 are how far a corner may be cut: an exact path cuts none.
    fn path_control(&mut self) {
        if let Some(path) = self.line.extended.path {
            self.checked.modal.path = path;
            if self.line.extended.is_path_tolerance {
                self.unused.remove(Letters::of(b"PQ"));
            }
        }
    }

    fn dwell(&mut self) -> Result<(), Error> {
        if self.line.non_modal != Some(NonModal::Dwell) {
            return Ok(());
        }
        if !self.unused.has(b'P') {
            return Err(Error::ValueWordMissing);
        }
        self.unused.remove(Letters::of(b"P"));
        self.checked.dwell = Some(seconds(self.line.value.p));
        Ok(())
    }

    fn non_modal(&mut self) -> Result<(), Error> {
        let Some(word) = self.line.non_modal else { return Ok(()) };
        self.non_modal_word(word)?;
        self.allow_offset(&self.checked.g92)?;
        self.checked.stored.map_or(Ok(()), |stored| self.allow_offset(&stored))
    }

    /// Of greater offsets sums would saturate, and one that was stored would not be read back. Grbl takes any.
    pub(super) fn allow_offset(&self, offset: &PerAxis<Coordinate, N>) -> Result<(), Error> {
        if self.dialect == Dialect::Grbl { Ok(()) } else { reachable(offset) }
    }

    fn non_modal_word(&mut self, word: NonModal) -> Result<(), Error> {
        match word {
            NonModal::SetSystem => self.set_system(),
            NonModal::SetOffset => self.set_offset(),
            NonModal::Go(which) => self.go(which),
            NonModal::StorePosition(which) => {
                self.checked.store = Some(which);
                self.checked.stored = Some(self.state.position);
                Ok(())
            }
            NonModal::ClearOffset | NonModal::SuspendOffset => {
                self.checked.g92 = PerAxis::all(Coordinate::ZERO);
                self.checked.after.keeps_g92 = word == NonModal::ClearOffset;
                self.checked.after.g92_acts = false;
                Ok(())
            }
            NonModal::RestoreOffset => {
                self.checked.g92 = self.state.offsets.g92_kept;
                self.checked.after.g92_acts = true;
                Ok(())
            }
            NonModal::LocalOffset if self.line.axes.is_empty() => Err(Error::NoAxisWords),
            NonModal::LocalOffset => {
                self.checked.g92 = self.with_axis_words(self.state.offsets.g92, |_, value| value);
                self.checked.after.keeps_g92 = true;
                self.checked.after.g92_acts = true;
                Ok(())
            }
            NonModal::MachineCoordinates => match self.checked.modal.motion {
                MotionMode::Rapid | MotionMode::Linear => Ok(()),
                _ => Err(Error::G53NeedsMotion),
            },
            NonModal::Dwell => Ok(()),
        }
    }

    /// G10. L2 gives the system's origin in machine coordinates; L20 moves the origin so that the present position gets
    /// the given coordinates. Distance mode plays no part.
    fn set_system(&mut self) -> Result<(), Error> {
        let line = self.line;
        let of_tool = self.dialect != Dialect::Grbl && line.value.l == Decimal::from_int(1);
        if line.axes.is_empty() && !of_tool {
            return Err(Error::NoAxisWords);
        }
        if !line.values.has(b'P') && !line.values.has(b'L') {
            return Err(Error::ValueWordMissing);
        }
        // Grbl looks at P first, and so finds a system that does not exist before an L that it does not know.
        if self.dialect != Dialect::Grbl {
            // Its P belongs to another word of the line.
            if line.values.has(b'P') && !self.unused.has(b'P') {
                return Err(Error::ValueWordMissing);
            }
            match whole(line.value.l)? {
                2 if line.values.has(b'R') => return Err(Error::NotSupported),
                2 | 20 => {}
                l @ (1 | 10 | 11) => return self.set_tool(l),
                _ => return Err(Error::UnsupportedCommand),
            }
        }
        let system = self.system_of(line.value.p.truncate())?;
        if self.dialect != Dialect::Grbl {
            whole(line.value.p)?;
        }
        let from_position = match line.value.l.truncate() {
            2 if line.values.has(b'R') => return Err(Error::UnsupportedCommand),
            2 => false,
            20 => true,
            _ => return Err(Error::UnsupportedCommand),
        };
        self.unused.remove(Letters::of(b"LP"));
        let which = StoredOffset::System(system);
        let present = self.state.offsets.stored(which);
        self.checked.store = Some(which);
        self.checked.stored = Some(self.with_axis_words(present, |axis, value| {
            if from_position {
                self.position(axis) - along(&self.state.offsets.g92, axis) - self.tool_offset(axis) - value
            } else {
                value
            }
        }));
        Ok(())
    }

    /// The system of G10's P: 0 is the active one.
    fn system_of(&self, p: i32) -> Result<CoordinateSystem, Error> {
        let count = if self.dialect == Dialect::Grbl { CoordinateSystem::OF_GRBL } else { CoordinateSystem::ALL.len() };
        match usize::try_from(p) {
            Ok(0) => Ok(self.checked.modal.coordinate_system),
            Ok(p) => CoordinateSystem::ALL
                .get(..count)
                .and_then(|systems| systems.get(p - 1))
                .copied()
                .ok_or(Error::UnsupportedCoordinateSystem),
            Err(_) => Err(Error::UnsupportedCoordinateSystem),
        }
    }

    /// G92: the present position gets the given coordinates in whatever system is active.
    fn set_offset(&mut self) -> Result<(), Error> {
        if self.line.axes.is_empty() {
            return Err(Error::NoAxisWords);
        }
        let origin = self.state.offsets.system(self.checked.modal.coordinate_system);
        self.checked.g92 = self.with_axis_words(self.state.offsets.g92, |axis, value| {
            self.position(axis) - along(&origin, axis) - self.tool_offset(axis) - value
        });
        self.checked.after.keeps_g92 = true;
        self.checked.after.g92_acts = true;
        Ok(())
    }

    /// G28, G30: the named axes by way of the given point to the stored place; without axis words all, directly.
    fn go(&mut self, which: StoredOffset) -> Result<(), Error> {
        let stored = self.state.offsets.stored(which);
        let (via, target) = if self.line.axes.is_empty() {
            (None, stored)
        } else {
            let axes = self.line.axes;
            let target =
                PerAxis::from_axis(|axis| if axes.has(axis) { along(&stored, axis) } else { self.position(axis) });
            let via = self.target();
            reachable(&via)?;
            (Some(via), target)
        };
        reachable(&target)?;
        self.checked.motion = Motion::Line { via, target, feed: Feed::Rapid };
        self.checked.position = target;
        Ok(())
    }

    fn motion(&mut self) -> Result<(), Error> {
        let mode = self.checked.modal.motion;
        if mode == MotionMode::Cancelled {
            // To Grbl axis words are an error here even if another command uses them.
            let used = self.dialect != Dialect::Grbl && self.claim != Claim::Motion;
            return if self.line.axes.is_empty() || used { Ok(()) } else { Err(Error::AxisWordsUnused) };
        }
        if self.claim != Claim::Motion {
            return Ok(());
        }
        if mode != MotionMode::Rapid && self.checked.modal.feed == Decimal::ZERO {
            return Err(Error::UndefinedFeed);
        }
        match mode {
            MotionMode::Rapid | MotionMode::Linear => self.straight(mode),
            MotionMode::ArcClockwise => self.arc(true),
            MotionMode::ArcCounterClockwise => self.arc(false),
            MotionMode::Probe(probe) => self.probe(probe),
            MotionMode::Cycle(kind) => self.cycle(kind),
            MotionMode::Cancelled => Ok(()),
        }
    }

    fn straight(&mut self, mode: MotionMode) -> Result<(), Error> {
        if self.line.axes.is_empty() {
            return Ok(());
        }
        let target = self.target();
        reachable(&target)?;
        let feed = if mode == MotionMode::Rapid { Feed::Rapid } else { self.feed_of_motion() };
        self.checked.motion = Motion::Line { via: None, target, feed };
        self.checked.position = target;
        Ok(())
    }

    fn probe(&mut self, mode: ProbeMode) -> Result<(), Error> {
        if self.line.axes.is_empty() {
            return Err(Error::NoAxisWords);
        }
        let target = self.target();
        if target == self.state.position {
            return Err(Error::InvalidTarget);
        }
        reachable(&target)?;
        let feed = self.feed_of_motion();
        self.checked.motion = Motion::Probe { target, feed, away: mode.away, alarm: mode.alarm };
        self.checked.position = target;
        Ok(())
    }

    fn arc(&mut self, clockwise: bool) -> Result<(), Error> {
        let axes = self.checked.modal.plane.axes();
        let is_circle = self.dialect != Dialect::Grbl && self.line.values.has_any(CENTRE);
        if self.line.axes.is_empty() && !is_circle {
            return Err(Error::NoAxisWords);
        }
        if !self.line.axes.has(axes.first) && !self.line.axes.has(axes.second) && !is_circle {
            return Err(Error::NoPlaneAxisForArc);
        }
        let start = self.state.position;
        let mut target = self.target();
        let mut chord = Vector::new(
            along(&target, axes.first) - along(&start, axes.first),
            along(&target, axes.second) - along(&start, axes.second),
        );
        let centre = if self.line.values.has(b'R') {
            self.unused.remove(Letters::of(b"R"));
            arc::centre_by_radius(chord, self.length(self.line.value.r), clockwise)?
        } else {
            let centre = self.centre(axes)?;
            if !arc::radii_agree(chord, centre)? {
                if self.dialect != Dialect::Seed {
                    return Err(Error::InvalidTarget);
                }
                chord = arc::ray_crossing(chord, centre)?;
                target.set(axes.first, along(&start, axes.first) + Coordinate(chord.first));
                target.set(axes.second, along(&start, axes.second) + Coordinate(chord.second));
            }
            centre
        };
        reachable(&target)?;
        let turns = self.turns()?;
        let feed = self.feed_of_motion();
        let (i, j) = (Coordinate(centre.first), Coordinate(centre.second));
        // Without a radius there is nothing to go round; what is left is the way of the other axes.
        self.checked.motion = if arc::is_point(centre) {
            Motion::Line { via: None, target, feed }
        } else {
            Motion::Arc(ArcMove { start, target, axes, i, j, clockwise, turns, feed })
        };
        self.checked.position = target;
        Ok(())
    }

    /// The centre of an arc in centre format, from its start.
    fn centre(&mut self, axes: PlaneAxes) -> Result<Vector, Error> {
        let (first, second) = (centre_letter(axes.first), centre_letter(axes.second));
        let (has_first, has_second) = (self.line.values.has(first), self.line.values.has(second));
        let absolute = self.dialect != Dialect::Grbl && self.checked.modal.arc_distance == ArcDistance::Absolute;
        // As distances each is 0 unless given; of coordinates none can be guessed.
        if !(has_first || has_second) || absolute && !(has_first && has_second) {
            return Err(Error::NoPlaneOffsets);
        }
        self.unused.remove(CENTRE);
        let centre_along = |axis: Axis| {
            let value = self.length(match axis {
                Axis::X => self.line.value.i,
                Axis::Y => self.line.value.j,
                _ => self.line.value.k,
            });
            if absolute { value + self.work_offset(axis) - self.position(axis) } else { value }
        };
        Vector::new(centre_along(axes.first), centre_along(axes.second)).checked()
    }

    /// P of an arc: how many turns it takes, the last of them up to the target.
    fn turns(&mut self) -> Result<u32, Error> {
        if self.dialect == Dialect::Grbl || !self.unused.has(b'P') {
            return Ok(0);
        }
        self.unused.remove(Letters::of(b"P"));
        let turns = whole(self.line.value.p)?;
        if !(1..=TURNS_MAX).contains(&turns) {
            return Err(Error::IntegerRequired);
        }
        Ok(turns.unsigned_abs() - 1)
    }

    fn unused_words(&mut self) -> Result<(), Error> {
        if self.is_program_number() {
            return Ok(());
        }
        self.unused.remove(match self.purpose {
            Purpose::Program => Letters::of(b"FNST"),
            Purpose::Jog => Letters::of(b"FN"),
        });
        if self.claim != Claim::Nobody {
            self.unused.remove(Letters::of(b"XYZABC"));
        }
        if self.unused.is_empty() { Ok(()) } else { Err(Error::UnusedWords) }
    }

    /// O and a number, which are alone in their line but for its own number.
    fn is_program_number(&self) -> bool {
        let mut others = self.unused;
        others.remove(Letters::of(b"N"));
        others == Letters::of(b"O") && self.line.groups == Groups::default() && !self.state.computed.assigns()
    }

    fn finish(self) {
        let checked = self.checked;
        checked.flow = match self.line.flow {
            Some(MWord::Pause) => Flow::Pause,
            Some(MWord::OptionalPause) => Flow::OptionalPause,
            Some(MWord::End) => Flow::End,
            _ => Flow::None,
        };
        // A cycle goes through its points exactly.
        let exact = matches!(checked.motion, Motion::Cycle(_));
        checked.digit = if exact { 0.0 } else { last_digit(checked.modal.units, self.line.places) };
        checked.uses_machine_place = matches!(
            self.line.non_modal,
            Some(NonModal::MachineCoordinates | NonModal::Go(_) | NonModal::StorePosition(_))
        );
        if checked.flow == Flow::End {
            checked.modal.end_program();
        }
        let (before, after) = (self.state.modal.coordinate_system, checked.modal.coordinate_system);
        let system_changed = match (checked.store, &checked.stored) {
            (Some(StoredOffset::System(system)), Some(value)) if system == after => {
                *value != self.state.offsets.system(system)
            }
            _ => false,
        };
        checked.work_offset_changed = system_changed
            || before != after
            || checked.g92 != self.state.offsets.g92
            || checked.tool_length != self.state.offsets.tool_length;
    }

    /// Where the line's axis words lead to, in machine coordinates.
    pub(super) fn target(&self) -> PerAxis<Coordinate, N> {
        let machine = self.line.non_modal == Some(NonModal::MachineCoordinates);
        let incremental = self.checked.modal.distance == Distance::Incremental;
        self.with_axis_words(self.state.position, |axis, value| {
            if machine {
                value
            } else if incremental {
                value + self.position(axis)
            } else {
                value + self.work_offset(axis)
            }
        })
    }

    /// `others`, with the axes that have a word replaced by what `place` makes of it.
    pub(super) fn with_axis_words(
        &self,
        others: PerAxis<Coordinate, N>,
        place: impl Fn(Axis, Coordinate) -> Coordinate,
    ) -> PerAxis<Coordinate, N> {
        let mut result = others;
        for axis in Axis::of_machine::<N>() {
            if self.line.axes.has(axis) {
                result.set(axis, place(axis, self.axis_length(axis)));
            }
        }
        result
    }

    /// A length in the line's unit.
    pub(super) fn length(&self, value: Decimal) -> Coordinate {
        match self.checked.modal.units {
            Units::Mm => Coordinate::from_mm(value),
            Units::Inch => Coordinate::from_inches(value),
        }
    }

    /// The value of an axis word. Degrees stay degrees whatever the unit of lengths.
    pub(super) fn axis_length(&self, axis: Axis) -> Coordinate {
        let value = self.line.axis.get(axis).unwrap_or(Decimal::ZERO);
        match axis {
            Axis::X | Axis::Y | Axis::Z => self.length(value),
            Axis::A | Axis::B | Axis::C => Coordinate::from_mm(value),
        }
    }

    pub(super) fn position(&self, axis: Axis) -> Coordinate {
        along(&self.state.position, axis)
    }

    /// What lies between machine and work coordinates for this line: its own coordinate system and tool length offset,
    /// and the G92 from before it.
    pub(super) fn work_offset(&self, axis: Axis) -> Coordinate {
        let offsets = &self.state.offsets;
        along(&offsets.system(self.checked.modal.coordinate_system), axis)
            + along(&offsets.g92, axis)
            + self.tool_offset(axis)
    }

    fn tool_offset(&self, axis: Axis) -> Coordinate {
        along(&self.checked.tool_length, axis)
    }

    fn feed_of_motion(&self) -> Feed {
        let feed = self.checked.modal.feed.to_f32();
        match self.checked.modal.feed_mode {
            FeedMode::PerMinute => Feed::PerMinute(per_second(feed)),
            FeedMode::InverseTime => Feed::InverseTime(60.0 / feed),
        }
    }
}

/// A number that selects something, which has no fraction.
pub(super) fn whole(value: Decimal) -> Result<i32, Error> {
    let number = value.truncate();
    if Decimal::from_int(number) == value { Ok(number) } else { Err(Error::IntegerRequired) }
}

/// A time that a program gives in seconds.
pub(super) fn seconds(value: Decimal) -> Duration {
    /// Units of a [`Decimal`] of seconds in a microsecond.
    const MICROSECOND: u64 = DECIMAL_ONE as u64 / 1_000_000;
    Duration::micros((value.0.unsigned_abs() + MICROSECOND / 2) / MICROSECOND)
}

/// The last of so many digits behind the point, mm.
fn last_digit(units: Units, places: u8) -> f32 {
    match units {
        Units::Mm => match places {
            0..=2 => 1.0e-2,
            3 => 1.0e-3,
            4 => 1.0e-4,
            5 => 1.0e-5,
            _ => 1.0e-6,
        },
        Units::Inch => match places {
            0..=3 => 2.54e-2,
            4 => 2.54e-3,
            5 => 2.54e-4,
            _ => 2.54e-5,
        },
    }
}

/// The letter of an arc's centre along an axis.
fn centre_letter(axis: Axis) -> u8 {
    match axis {
        Axis::X => b'I',
        Axis::Y => b'J',
        _ => b'K',
    }
}

pub(super) fn along<const N: usize>(place: &PerAxis<Coordinate, N>, axis: Axis) -> Coordinate {
    place.get(axis).unwrap_or(Coordinate::ZERO)
}

/// An error unless the controller may compute with the place.
pub(super) fn reachable<const N: usize>(place: &PerAxis<Coordinate, N>) -> Result<(), Error> {
    if place.iter().all(|coordinate| coordinate.in_range()) { Ok(()) } else { Err(Error::InvalidTarget) }
}
