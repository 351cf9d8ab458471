//! [`Action`] is the result of checking a line: its effects, as plain data. The controller executes them (spindle,
//! coolant, tool, dwell, outputs, and the [`MotionCommand`] in machine coordinates), and the interpreter adopts the new
//! modal state when the line is committed. Checking itself changes nothing.

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

/// Effects of a line, in the order of execution. The private fields hold the state after the line.
/// `Interpreter::commit` makes it the state of the interpreter.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Action<const N: usize> {
    /// The line number (N), 0 to 10,000,000; 0 without an N.
    pub line_number: u32,
    /// The new state of the spindle, if the line changes it before the motion. (At the program's end the spindle stops:
    /// see [`Flow::End`].)
    pub spindle: Option<SpindleDirection>,
    /// Whether S differs from the speed in force before the line.
    pub speed_changed: bool,
    /// S in revolutions per minute, in force from this line on.
    pub speed: f32,
    /// The new state of the coolant, if the line changes it before the motion.
    pub coolant: Option<Coolant>,
    /// The line has an M6, and the selected tool differs from the one in the spindle.
    pub tool_change: bool,
    /// Duration of a dwell before the motion.
    pub dwell: Option<Duration>,
    /// The offset between machine and work positions changes, or another coordinate system becomes active.
    pub work_offset_changed: bool,
    /// The line goes to a machine position or stores one (G53, G28, G30, G28.1, G30.1), so it needs a valid machine
    /// position.
    pub uses_machine_place: bool,
    /// The stored position, coordinate system or tool that changes when the line is committed. A tool gets a new
    /// offset, or is removed from the table.
    pub store: Option<StoredOffset>,
    /// Motion of the line; [`MotionCommand::None`] if nothing moves.
    pub motion: MotionCommand<N>,
    /// Value of the last decimal place of the axis words, in mm: 0.001 for `X1.234`. From this value, `motion`
    /// estimates by how much the program has rounded its points. The value is at most 0.01 mm or 0.001 inch, before
    /// scaling by G51, because programs often omit trailing zeros. It is 0 for canned cycles and splines, whose points
    /// count as exact.
    pub digit: f32,
    /// What the program does after the motion.
    pub flow: Flow,
    pub(super) modal: Modal,
    pub(super) g92: PerAxis<Coordinate, N>,
    pub(super) tool_length: PerAxis<Coordinate, N>,
    pub(super) after: Afterwards,
    pub(super) stored: Option<PerAxis<Coordinate, N>>,
    pub(super) position: PerAxis<Coordinate, N>,
    pub(super) rotated: RotationChange,
    /// Letters of the words that no command uses, if the line was refused for this reason.
    pub(super) unused: [Letters; REASONS as usize],
}

/// Further parts of an `Action`, mostly for words that Grbl does not have.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Afterwards {
    pub(super) spindle_tool: u32,
    /// The line has M3, M4 or M5.
    pub(super) spindle_word: bool,
    /// See [`Action::is_tool_change_alone`]; valid only on a line with M6.
    pub(super) tool_alone: bool,
    /// See [`Action::moves_only`].
    pub(super) moves_only: bool,
    /// The G92 offset of this line is stored when the line is committed, so that G92.3 can restore it.
    pub(super) keeps_g92: bool,
    pub(super) g92_acts: bool,
    pub(super) keeping: Keeping,
    /// Outputs and inputs that the line uses.
    pub(super) pins: Option<ProgramPins>,
    pub(super) notice: Option<Notice>,
    /// `None` if the line has no D; `Some(true)` if D names the radius of a tool, `Some(false)` for D0.
    pub(super) names_radius: Option<bool>,
}

/// Message to the host about a word of a program, sent at most once in each program.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub enum Notice {
    /// G43 while no length of any tool is known: the offset is 0.
    NoTools,
    /// G103, G187, G8 P, G5.1 Q or G5 P, which have no effect.
    LookAhead,
    /// M29, which has no effect.
    RigidTapping,
    /// A comment contains parentheses.
    NestedComment,
    /// G54.1 P3, the system of the tool setter.
    SystemOfSetter,
    /// G12 or G13, whose I has another meaning on Haas.
    CircleOfMach,
}

impl Notice {
    /// Returns the English text of the message; empty for a message that this build never sends.
    pub const fn text(self) -> &'static str {
        match self {
            Notice::NoTools => {
                "No tool is in the table: G43 uses length 0. Write G10 L1 P<tool> Z<length> above G43 for each tool"
            }
            // Only the full image sends the other messages.
            _ if !FULL_IMAGE => "",
            Notice::LookAhead => "Switches of the look-ahead (G5.1 Q, G8 P, G187) do nothing: G64 P sets a tolerance",
            Notice::RigidTapping => "M29 does nothing: there is no rigid tapping",
            Notice::NestedComment => {
                "Nested parentheses: the comment ends at the matching ) here, at the first ) in Grbl"
            }
            Notice::CircleOfMach => "G12, G13: I is the radius of the tool's path (Mach), not of the wall (Haas)",
            Notice::SystemOfSetter => "P3 is G59.3, where tool changes with $918=2 look for the tool setter",
        }
    }
}

impl<const N: usize> Action<N> {
    /// Returns whether the line only moves or changes modes of motions, as nearly all lines do. Such a line changes no
    /// outputs, offsets or stored records, and does not wait.
    #[inline]
    pub fn moves_only(&self) -> bool {
        self.after.moves_only
    }

    /// Returns the modal state after the line. If the line has M2 or M30, the modes are already reset.
    pub fn modal(&self) -> &Modal {
        &self.modal
    }

    /// Returns whether the line changes spindle, coolant or S, stores a position or a tool, or has one of the words
    /// M62 to M68.
    pub fn changes_outputs(&self) -> bool {
        self.spindle.is_some()
            || self.coolant.is_some()
            || self.speed_changed
            || self.store.is_some()
            || self.pins().is_some()
    }

    /// Adapts the action to a spindle that was stopped for the tool change of this line. The spindle restarts only if
    /// the line has M3 or M4.
    pub fn spindle_stopped_for_tool(&mut self) {
        if !self.after.spindle_word {
            self.modal.spindle = SpindleDirection::Off;
        }
        self.spindle = (self.modal.spindle != SpindleDirection::Off).then_some(self.modal.spindle);
    }

    /// Returns the tool length offset after the line, for each axis.
    pub fn tool_length(&self) -> PerAxis<Coordinate, N> {
        self.tool_length
    }

    /// Returns whether M6 is alone on its line: no other word of the line depends on the length of the tool. Valid
    /// only for a line with M6.
    pub fn is_tool_change_alone(&self) -> bool {
        self.after.tool_alone
    }

    /// Adapts the action of an M6 whose tool has been changed and measured. Spindle and coolant were off meanwhile.
    /// They are switched on again if they are on in the modal state. The tool moves to `via` by a rapid, and then to
    /// `target` with `feed`. `length`: the tool length offset after the line.
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

    /// Returns the number of the tool that the line removes from the tool table; `None` if it removes none.
    pub fn removes_tool(&self) -> Option<u32> {
        match (self.store, &self.stored) {
            (Some(StoredOffset::Tool(number)), None) => Some(number),
            _ => None,
        }
    }

    /// Returns what the line does with an output or input for programs; `None` if it has none of the words M62 to M68.
    #[inline]
    pub fn pins(&self) -> Option<ProgramPins> {
        if FULL_IMAGE { self.after.pins } else { None }
    }

    /// Returns the message to send to the host when the line is executed; `None` for nearly all lines.
    pub fn notice(&self) -> Option<Notice> {
        self.after.notice
    }

    /// Returns whether the machine can still refuse the line after this check, because the line changes the tool or
    /// uses pins.
    #[inline]
    pub fn needs_machine(&self) -> bool {
        self.tool_change || self.pins().is_some()
    }

    /// Returns the number of the tool in the spindle after the line; 0 if none is known.
    pub fn spindle_tool(&self) -> u32 {
        self.after.spindle_tool
    }

    /// Returns the spindle speed during the motion, in revolutions per minute; 0 while the spindle is off.
    pub fn turning_speed(&self) -> f32 {
        if self.modal.spindle == SpindleDirection::Off { 0.0 } else { self.speed }
    }

    /// Returns the machine position after the line, as programmed. If nothing moves, this is the present position.
    pub fn position(&self) -> &PerAxis<Coordinate, N> {
        &self.position
    }

    /// Changes the end of a straight move to `place`. Used for a jog that is shortened to the end of the travel.
    pub fn redirect(&mut self, place: PerAxis<Coordinate, N>) {
        if let MotionCommand::Line { target, .. } = &mut self.motion {
            *target = place;
            self.position = place;
        }
    }

    /// An action without effects. Its modal state is the one that an interpreter has after power-up.
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
            names_radius: None,
        },
        stored: None,
        position: PerAxis::all(Coordinate::ZERO),
        rotated: RotationChange::NONE,
        unused: [Letters::of(b""); REASONS as usize],
    };

    /// Resets this action, so that it changes nothing of `state`. Works in place, because a returned action would be
    /// copied with all its bytes, even those that only an arc needs.
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

    /// Discards all changes of the state except the change of the position, so that the line only moves.
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

/// What a line does with an output or input of the program (M62 to M68).
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum ProgramPins {
    /// M62 to M65: switches a digital output.
    Digital {
        /// P: number of the output, from 0.
        number: u32,
        /// `true` for M62 and M64, which switch on; `false` for M63 and M65, which switch off.
        on: bool,
        /// `true` for M62 and M63, which act when the next motion begins; `false` for M64 and M65, which act at rest.
        with_motion: bool,
    },
    /// M67, M68: sets an analog output.
    Analog {
        /// E: number of the analog output.
        number: u32,
        /// Q: value of the output.
        value: Decimal,
        /// `true` for M67, which acts with the next motion; `false` for M68, which does not wait for one.
        with_motion: bool,
    },
    /// M66 P: waits for a digital input.
    Wait {
        /// P: number of the input, from 0.
        number: u32,
        /// L: the condition that ends the wait.
        until: InputWait,
        /// Q: maximum duration of the wait. May be 0 with L0.
        longest: Duration,
    },
    /// M66 E: reads an analog input.
    ReadAnalog {
        /// E: number of the analog input.
        number: u32,
    },
}

impl ProgramPins {
    /// Returns whether the line waits until the previous motion has ended. At the place where that motion ends, M64
    /// and M65 then switch the output, and M66 P reads the input.
    pub fn act_at_rest(self) -> bool {
        matches!(self, ProgramPins::Wait { .. } | ProgramPins::Digital { with_motion: false, .. })
    }
}

/// Condition that M66 waits for, selected by L.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum InputWait {
    /// L0: no condition; the input is read at once.
    Nothing,
    /// L1: the input becomes active.
    Rise,
    /// L2: the input becomes inactive.
    Fall,
    /// L3: the input is active.
    High,
    /// L4: the input is inactive.
    Low,
}

impl InputWait {
    /// Returns whether the wait ends. `before`: `true` if the input was active when it was read last. `now`: `true` if
    /// it is active at present.
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
    /// A straight move: G0, G1, and the moves of G28 and G30.
    Line {
        /// For G28 and G30: the intermediate point, reached by a rapid.
        via: Option<PerAxis<Coordinate, N>>,
        /// End point.
        target: PerAxis<Coordinate, N>,
        /// Speed of the move.
        feed: Feed,
    },
    /// An arc or helix: G2, G3, G12 and G13.
    Arc(ArcMove<N>),
    /// A Bezier curve in X and Y: G5 and G5.1.
    Spline(SplineMove<N>),
    /// A rational B-spline in X and Y: G5.3, with the control points of G5.2.
    Nurbs(NurbsMove<N>),
    /// A straight move until the probe makes contact, or loses it.
    Probe {
        /// The end position if the probe does not change.
        target: PerAxis<Coordinate, N>,
        /// Speed of the move.
        feed: Feed,
        /// `true` for G38.4 and G38.5, which end at the loss of contact; `false` for G38.2 and G38.3, which end at
        /// contact.
        away: bool,
        /// `true` for G38.2 and G38.4: an alarm follows if the probe has not changed before the target.
        alarm: bool,
    },
    /// A canned cycle: G73 to G89.
    Cycle(Cycle<N>),
}

/// An arc from `start` to `target` round a centre. The axes outside its plane move at constant speed during the arc.
/// The radii at start and target may differ by the greatest of these tolerances: 0.005 mm, 0.1 % of the radius (0.5 mm
/// at most), and the rounding of the words (see `arc`).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ArcMove<const N: usize> {
    /// Start point.
    pub start: PerAxis<Coordinate, N>,
    /// End point. If it equals `start` in the plane, the arc is a full circle.
    pub target: PerAxis<Coordinate, N>,
    /// Axes of the arc's plane, and the axis normal to it.
    pub axes: PlaneAxes,
    /// Distance from the start to the centre, along the first axis of the plane.
    pub i: Coordinate,
    /// Distance from the start to the centre, along the second axis of the plane.
    pub j: Coordinate,
    /// `true`: clockwise in its plane, as G2. `false`: counter-clockwise, as G3.
    pub clockwise: bool,
    /// Number of full turns before the arc from start to target: 1 for `P2`.
    pub turns: u32,
    /// Speed along the arc, from F.
    pub feed: Feed,
    /// `true` for G12 and G13. Before the line, the tool is at the centre. It feeds straight to `start`, follows the
    /// circle, and returns straight to the centre.
    pub from_centre: bool,
}

/// A cubic Bezier curve in X and Y; the other axes stay at their positions. All its control points are within
/// [`Coordinate::LIMIT`], and so is the curve.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SplineMove<const N: usize> {
    /// Start point.
    pub start: PerAxis<Coordinate, N>,
    /// End point.
    pub target: PerAxis<Coordinate, N>,
    /// Vector in X and Y from the start to the first control point.
    pub leaving: [Coordinate; 2],
    /// Vector in X and Y from the target to the last control point.
    pub arriving: [Coordinate; 2],
    /// Speed along the curve.
    pub feed: Feed,
}

impl<const N: usize> SplineMove<N> {
    /// Returns the control points, including the ends. The curve lies within the polygon of these points.
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

/// A rational B-spline in X and Y; the other axes stay at their positions. The interpreter keeps the control points
/// until the next G5.2.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct NurbsMove<const N: usize> {
    /// Start point.
    pub start: PerAxis<Coordinate, N>,
    /// End point.
    pub target: PerAxis<Coordinate, N>,
    /// Order of the curve: its degree plus one.
    pub order: u8,
    /// Speed along the curve.
    pub feed: Feed,
}

/// Speed of a motion.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Feed {
    /// As fast as the machine allows.
    Rapid,
    /// G94 and G95: speed in mm/s. For arcs and cycles, this is the speed along the path of X, Y and Z. For straight
    /// moves, it is the speed along the path of all axes, in which a degree counts as a millimetre.
    PerMinute(f32),
    /// G93: duration of the whole motion, in seconds.
    InverseTime(f32),
}

/// What the program does after the motion of a line.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Flow {
    /// Continue with the next line.
    #[default]
    None,
    /// M0, M60: the program pauses.
    Pause,
    /// M1: the program pauses if the settings enable the optional stop.
    OptionalPause,
    /// M2, M30: spindle and coolant stop, overrides return to 100 %.
    End,
}

/// What the line does with saved modal states (M70 to M73) or with control points (G5.2).
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Keeping {
    /// The line has none of the words M70 to M73 and G5.2.
    Leave,
    /// M70, M73: saves the state.
    Save {
        /// M73: the state is restored when the current call returns.
        until_return: bool,
    },
    /// M71: discards the saved state of the current call level.
    Forget,
    /// M72: restores a saved state, and drops the states of deeper call levels.
    Restore,
    /// G5.2: adds control points.
    Add([Addition; FULL_IMAGE as usize]),
}
