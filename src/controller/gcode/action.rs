//! [`Action`] is the result of checking a line: what to do, as plain data. The controller carries it out (spindle,
//! coolant, tool, dwell, outputs, and the [`MotionCommand`] in machine coordinates), and the interpreter takes the new
//! modal state over when the line is committed. Checking has no other effect.

use super::REASONS;
use super::control_points::Addition;
use super::cycle::Cycle;
use super::modal::{Modal, PlaneAxes};
use super::offsets::StoredOffset;
use super::rotation::RotationChange;
use super::state::Interpreter;
use super::values::along;
use super::word::Letters;
use crate::axes::{Axis, PerAxis};
use crate::image::FULL_IMAGE;
use crate::messages::{Coolant, SpindleDirection};
use crate::units::{Coordinate, Decimal, Duration};

/// What a line asks for, in the order in which it is carried out. The last of it is the state afterwards, which
/// `Interpreter::commit` takes over.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Action<const N: usize> {
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
    pub motion: MotionCommand<N>,
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
    pub(super) rotated: RotationChange,
    /// Of a line that is refused for them: its words that nothing uses.
    pub(super) unused: [Letters; REASONS as usize],
}

/// What a line leaves behind that Grbl does not know.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Afterwards {
    pub(super) spindle_tool: u32,
    /// The line has M3, M4 or M5.
    pub(super) spindle_word: bool,
    /// M6 is without axis words and tool offsets.
    pub(super) tool_alone: bool,
    /// See [`Action::moves_only`].
    pub(super) moves_only: bool,
    /// What G92.3 brings back is the G92 of this line.
    pub(super) keeps_g92: bool,
    pub(super) g92_acts: bool,
    pub(super) keeping: Keeping,
    /// Outputs and inputs of the program.
    pub(super) pins: Option<ProgramPins>,
    pub(super) notice: Option<Notice>,
}

/// What a program is told once about a word of it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub enum Notice {
    /// G43 of a tool while the table has no entry.
    NoTools,
    /// G187, G8 P, G5.1 Q, G5 P.
    LookAhead,
    /// M29.
    RigidTapping,
    /// A remark has parentheses in it.
    NestedRemark,
}

impl Notice {
    /// Its text, for people.
    pub const fn text(self) -> &'static str {
        match self {
            Notice::NoTools => "No tool is in the table: G43 has length 0. G10 L1 P5 Z0 enters tool 5",
            Notice::LookAhead => "Switches of the look-ahead (G5.1 Q, G8 P, G187) do nothing: G64 P sets a tolerance",
            Notice::RigidTapping => "M29 does nothing: there is no rigid tapping",
            Notice::NestedRemark => "Parentheses within a remark are part of it; Grbl ends it at the first one",
        }
    }
}

impl<const N: usize> Action<N> {
    /// Whether the line is a motion, a change of how motions are meant, or nothing: neither outputs nor offsets nor records change by
    /// it, and nothing waits for it. Nearly all lines are like that.
    #[inline]
    pub fn moves_only(&self) -> bool {
        self.after.moves_only
    }

    /// The modal state afterwards.
    pub fn modal(&self) -> &Modal {
        &self.modal
    }

    /// Whether something other than a motion follows from the line: outputs, or a record to be stored.
    pub fn changes_outputs(&self) -> bool {
        self.spindle.is_some()
            || self.coolant.is_some()
            || self.speed_changed
            || self.store.is_some()
            || self.pins().is_some()
    }

    /// The spindle has been stopped for another tool: it turns again only if the line says so.
    pub fn spindle_stopped_for_tool(&mut self) {
        if !self.after.spindle_word {
            self.modal.spindle = SpindleDirection::Off;
        }
        self.spindle = (self.modal.spindle != SpindleDirection::Off).then_some(self.modal.spindle);
    }

    /// The tool length offset afterwards.
    pub fn tool_length(&self) -> PerAxis<Coordinate, N> {
        self.tool_length
    }

    /// Whether nothing in a line with M6 depends on the length of the tool.
    pub fn is_tool_change_alone(&self) -> bool {
        self.after.tool_alone
    }

    /// The tool has been changed and measured, with spindle and coolant off: they come back as the line or those before it have
    /// them, and then the tool goes to `target`, by a rapid to `via`.
    pub fn return_with_tool(
        &mut self,
        [via, target]: [PerAxis<Coordinate, N>; 2],
        feed: Feed,
        length: PerAxis<Coordinate, N>,
    ) {
        self.spindle = (self.modal.spindle != SpindleDirection::Off).then_some(self.modal.spindle);
        self.coolant = (self.modal.coolant != Coolant::default()).then_some(self.modal.coolant);
        self.motion = MotionCommand::Line { via: Some(via), target, feed };
        self.digit = 0.0;
        self.position = target;
        self.tool_length = length;
    }

    /// The tool that is taken out of the table.
    pub fn removes_tool(&self) -> Option<u32> {
        match (self.store, &self.stored) {
            (Some(StoredOffset::Tool(number)), None) => Some(number),
            _ => None,
        }
    }

    /// What it does with the outputs and inputs of programs (M62 to M68).
    #[inline]
    pub fn pins(&self) -> Option<ProgramPins> {
        if FULL_IMAGE { self.after.pins } else { None }
    }

    /// What is to be told about the line.
    pub fn notice(&self) -> Option<Notice> {
        self.after.notice
    }

    /// Whether the machine may have something against the line that programs cannot know.
    #[inline]
    pub fn needs_machine(&self) -> bool {
        self.tool_change || self.pins().is_some()
    }

    /// The tool that the spindle holds afterwards.
    pub fn spindle_tool(&self) -> u32 {
        self.after.spindle_tool
    }

    /// S of the motion, in revolutions per minute; 0 while the spindle is off.
    pub fn turning_speed(&self) -> f32 {
        if self.modal.spindle == SpindleDirection::Off { 0.0 } else { self.speed }
    }

    /// The machine position afterwards.
    pub fn position(&self) -> &PerAxis<Coordinate, N> {
        &self.position
    }

    /// A straight move that ends elsewhere: a jog cut short at the end of the travel.
    pub fn redirect(&mut self, place: PerAxis<Coordinate, N>) {
        if let MotionCommand::Line { target, .. } = &mut self.motion {
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
        motion: MotionCommand::None,
        digit: 0.0,
        flow: Flow::None,
        modal: Modal::INITIAL,
        g92: PerAxis::all(Coordinate::ZERO),
        tool_length: PerAxis::all(Coordinate::ZERO),
        after: Afterwards {
            spindle_tool: 0,
            spindle_word: false,
            tool_alone: false,
            moves_only: false,
            keeps_g92: false,
            g92_acts: false,
            keeping: Keeping::Leave,
            pins: None,
            notice: None,
        },
        stored: None,
        position: PerAxis::all(Coordinate::ZERO),
        rotated: RotationChange::NONE,
        unused: [Letters::of(b""); REASONS as usize],
    };

    /// Becomes what leaves everything as it is. In its place: a new one would be copied there with room for an arc.
    pub(super) fn begin(&mut self, state: &Interpreter<N>) {
        self.line_number = 0;
        self.uses_machine_place = false;
        self.after.moves_only = false;
        self.motion = MotionCommand::None;
        self.position = state.position;
        self.rotated.reached = None;
        self.rotated.scaled.rest = None;
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
        self.after.pins = None;
        self.after.notice = None;
        self.after.keeps_g92 = false;
        self.after.g92_acts = state.offsets.g92_acts;
        self.after.keeping = Keeping::Leave;
        self.after.spindle_tool = state.spindle_tool;
        self.stored = None;
        self.rotated.angle = None;
        self.rotated.rotation = None;
        self.rotated.scaled.scaling = None;
    }
}

/// What a line does with the outputs and inputs of programs.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum ProgramPins {
    /// M62 to M65.
    Digital {
        /// P.
        number: u32,
        /// M62, M64.
        on: bool,
        /// M62, M63: with the next motion.
        with_motion: bool,
    },
    /// M67, M68.
    Analog {
        /// E.
        number: u32,
        /// Q.
        value: Decimal,
        /// M67: with the next motion.
        with_motion: bool,
    },
    /// M66 P.
    Wait {
        /// P.
        number: u32,
        /// L.
        until: InputWait,
        /// Q.
        longest: Duration,
    },
    /// M66 E.
    ReadAnalog {
        /// E.
        number: u32,
    },
}

impl ProgramPins {
    /// Whether they wait for the motion before them: M64 and M65 switch where the program has come to, M66 looks there.
    pub fn act_at_rest(self) -> bool {
        matches!(self, ProgramPins::Wait { .. } | ProgramPins::Digital { with_motion: false, .. })
    }
}

/// What M66 waits for, by its L.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum InputWait {
    /// L0: nothing.
    Nothing,
    /// L1: the input becomes active.
    Rise,
    /// L2: it ceases to be.
    Fall,
    /// L3: it is active.
    High,
    /// L4: it is not.
    Low,
}

impl InputWait {
    /// Whether an input is as it should be that was `before` when it was looked at last.
    pub fn is_over(self, before: bool, now: bool) -> bool {
        match self {
            InputWait::Nothing => true,
            InputWait::Rise => now && !before,
            InputWait::Fall => before && !now,
            InputWait::High => now,
            InputWait::Low => !now,
        }
    }
}

/// The motion of a line, in machine coordinates. Every target is within [`Coordinate::LIMIT`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum MotionCommand<const N: usize> {
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
    /// A Bezier curve in X and Y.
    Spline(SplineMove<N>),
    /// A rational B-spline in X and Y.
    Nurbs(NurbsMove<N>),
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

/// A Bezier curve of third degree in X and Y; the other axes stay where they are. All its control points are within
/// [`Coordinate::LIMIT`], and so is the curve.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SplineMove<const N: usize> {
    /// Where it begins.
    pub start: PerAxis<Coordinate, N>,
    /// Where it ends.
    pub target: PerAxis<Coordinate, N>,
    /// In X and Y from the start to the control point that the curve heads for.
    pub leaving: [Coordinate; 2],
    /// In X and Y from the target to the control point that the curve comes from.
    pub arriving: [Coordinate; 2],
    /// How fast.
    pub feed: Feed,
}

impl<const N: usize> SplineMove<N> {
    /// The control points: the curve lies within the polygon that they span.
    #[inline(never)]
    pub fn corners(&self) -> [PerAxis<Coordinate, N>; 4] {
        let beside = |place: &PerAxis<Coordinate, N>, way: [Coordinate; 2]| {
            let mut place = *place;
            for (axis, way) in [Axis::X, Axis::Y].into_iter().zip(way) {
                place.set(axis, along(&place, axis) + way);
            }
            place
        };
        let (start, target) = (&self.start, &self.target);
        [*start, beside(start, self.leaving), beside(target, self.arriving), *target]
    }
}

/// A rational B-spline in X and Y, whose control points the interpreter keeps until the next G5.2. The other axes stay where
/// they are.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct NurbsMove<const N: usize> {
    /// Where it begins.
    pub start: PerAxis<Coordinate, N>,
    /// Where it ends.
    pub target: PerAxis<Coordinate, N>,
    /// The degree and one more.
    pub order: u8,
    /// How fast.
    pub feed: Feed,
}

/// Speed of a motion.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Feed {
    /// As fast as the machine allows.
    Rapid,
    /// G94: in mm/s. Of straight moves along the path of all axes, in which a degree counts as a millimetre; of arcs and
    /// cycles along that of X, Y and Z.
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

/// What a line does with the states that M70 and M73 keep, or with the control points of G5.2.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Keeping {
    /// Nothing.
    Leave,
    /// M70, M73.
    Save {
        /// M73.
        until_return: bool,
    },
    /// M71.
    Forget,
    /// M72.
    Restore,
    /// G5.2.
    Add([Addition; FULL_IMAGE as usize]),
}
