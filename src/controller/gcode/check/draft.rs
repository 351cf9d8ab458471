//! A line while it is checked: the words that no step has used yet, and the [`Action`] as far as it is known. The steps
//! of the check (the other files of this folder) are methods of [`Draft`]. This file has the helpers that several steps
//! share: lengths in the line's unit, axis words as a target, and the feed of a motion.

use crate::axes::{Axis, LINEAR, PerAxis};
use crate::error::Error;
use crate::gcode::Dialect;
use crate::gcode::action::{Action, Feed};
use crate::gcode::modal::{FeedMode, MotionMode, Units};
use crate::gcode::parse::Parsed;
use crate::gcode::rotation::RotatedPlane;
use crate::gcode::scaling::Scaling;
use crate::gcode::state::Interpreter;
use crate::gcode::values::{along, reachable};
use crate::gcode::word::{Claim, Groups, Letters};
use crate::image::FULL_IMAGE;
use crate::units::{Coordinate, Decimal, per_second};
use oxmill_sqrt::square_root;

/// Letters that give the centre of an arc.
pub(super) const CENTRE: Letters = Letters::of(b"IJK");

/// Origin of the line that is checked: a program, or a jog (`$J=`).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(in crate::gcode) enum Purpose {
    Program,
    Jog,
}

/// Returns two squared lengths of a straight move: along X, Y and Z in mm², and along the rotary axes in square
/// degrees.
fn squared_ways<const N: usize>(from: &PerAxis<Coordinate, N>, to: &PerAxis<Coordinate, N>) -> [f32; 2] {
    let mut squares = [0.0; 2];
    let [linear, rotary] = &mut squares;
    for (axis, (from, to)) in from.iter().zip(to.iter()).enumerate() {
        let way = (*to - *from).to_mm();
        *(if axis < LINEAR { &mut *linear } else { &mut *rotary }) += way * way;
    }
    squares
}

/// Returns the feed for F with G93, where F is the inverse of a duration in minutes: F2 is 30 s. Not inlined, so that
/// the code for other lines does not contain the division.
#[inline(never)]
fn inverse_time(feed: Decimal) -> Feed {
    Feed::InverseTime(60.0 / feed.to_f32())
}

/// A line while it is checked: its words, which of them are still unused, and the result so far.
pub(super) struct Draft<'a, const N: usize> {
    pub(super) state: &'a Interpreter<N>,
    pub(super) line: &'a Parsed<N>,
    pub(super) dialect: Dialect,
    pub(super) purpose: Purpose,
    /// Command that uses the axis words. If no command of the line uses them, they give a motion in the motion mode in
    /// force ([`Claim::Motion`]).
    pub(super) claim: Claim,
    /// Letters of the axis words and value words that no step has used yet.
    pub(super) unused: Letters,
    /// Rotation of the line's coordinates; `None` if they are not rotated.
    pub(super) rotated: Option<RotatedPlane>,
    /// Scaling of the line's coordinates, which is applied before the rotation.
    pub(super) scaled: Option<&'a Scaling>,
    /// The result so far; its modal state includes the line's own words.
    pub(super) action: &'a mut Action<N>,
}

impl<'a, const N: usize> Draft<'a, N> {
    /// Starts the check of a line: copies the modal state and applies the line's modal words. If no command of the
    /// line uses the axis words, they give a motion in the motion mode in force.
    pub(super) fn begin(
        state: &'a Interpreter<N>,
        line: &'a Parsed<N>,
        dialect: Dialect,
        purpose: Purpose,
        action: &'a mut Action<N>,
    ) -> Self {
        action.begin(state);
        let modal = &mut action.modal;
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
        if !line.groups.within(Groups::OF_MOTION) {
            line.modal.set_modes(modal);
        }
        // A full circle needs no axis word, only its centre.
        let is_circle = dialect != Dialect::Grbl
            && matches!(modal.motion, MotionMode::ArcClockwise | MotionMode::ArcCounterClockwise)
            && line.values.has_any(CENTRE);
        let claim = match line.claim {
            Claim::Nobody if !line.axes.is_empty() || is_circle => Claim::Motion,
            claim => claim,
        };
        Self { state, line, dialect, purpose, claim, unused: line.values, rotated: None, scaled: None, action }
    }

    /// Refuses offsets outside the range of coordinates. Sums with such an offset would saturate, and a stored offset
    /// of this kind could not be read back. Grbl accepts any offset, so its dialect does, too.
    pub(super) fn allow_offset(&self, offset: &PerAxis<Coordinate, N>) -> Result<(), Error> {
        if self.dialect == Dialect::Grbl { Ok(()) } else { reachable(offset) }
    }

    /// Marks the word of this letter as used. Returns whether the line has the word and no step has used it before.
    pub(super) fn take(&mut self, letter: u8) -> bool {
        let has = self.unused.has(letter);
        self.unused.remove(Letters::of(&[letter]));
        has
    }

    /// Returns `others`, with a new value for each axis that has a word. `place(axis, value)` computes the new value
    /// from the value of the word.
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

    /// Converts a number of the line to a length; the number is in the line's unit.
    pub(super) fn length(&self, value: Decimal) -> Coordinate {
        match self.action.modal.units {
            Units::Mm => Coordinate::from_mm(value),
            Units::Inch => Coordinate::from_inches(value),
        }
    }

    /// Returns the value of an axis word: a length in the line's unit, or degrees for a rotary axis.
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

    /// Returns the present position along an axis in work coordinates, before G68 or an angle of the system rotates
    /// them. With G51 these are the scaled coordinates, not the ones that the program wrote.
    pub(super) fn program_coordinate(&self, axis: Axis) -> Coordinate {
        if FULL_IMAGE && let Some(rotated) = self.rotated {
            let [first, second] = self.state.in_program(rotated, rotated.part_of(&self.state.position));
            if axis == rotated.axes.first {
                return first;
            }
            if axis == rotated.axes.second {
                return second;
            }
        }
        self.position(axis) - self.work_offset(axis)
    }

    /// Returns machine coordinate minus work coordinate, with the coordinate system, tool length offset and G92 that
    /// are in force on this line.
    pub(super) fn work_offset(&self, axis: Axis) -> Coordinate {
        let offsets = &self.state.offsets;
        along(&offsets.system(self.action.modal.coordinate_system), axis)
            + along(&self.action.g92, axis)
            + self.tool_offset(axis)
    }

    pub(super) fn tool_offset(&self, axis: Axis) -> Coordinate {
        along(&self.action.tool_length, axis)
    }

    /// Returns the speed in mm/s that F means with G94 or G95.
    pub(super) fn feed_per_second(&self) -> f32 {
        let modal = &self.action.modal;
        if FULL_IMAGE && modal.feed_mode == FeedMode::PerRevolution {
            return modal.feed_per_second * modal.speed;
        }
        modal.feed_per_second
    }

    pub(super) fn feed_of_motion(&self) -> Feed {
        let modal = &self.action.modal;
        match modal.feed_mode {
            FeedMode::PerMinute => Feed::PerMinute(modal.feed_per_second),
            FeedMode::PerRevolution if FULL_IMAGE => Feed::PerMinute(self.feed_per_second()),
            _ => inverse_time(modal.feed),
        }
    }

    /// Returns the feed of a straight move as the speed along its path in all axes, rotary axes included. F itself is
    /// the speed along X, Y and Z alone; the rotary axes start and end together with X, Y and Z. Example: for 3 mm in
    /// X and 4 degrees in A the path is 5 long, so the result is 5/3 of F. If only rotary axes move, F is in degrees
    /// per minute (RS274NGC, 2.1.2.5).
    pub(super) fn feed_to(&self, target: &PerAxis<Coordinate, N>) -> Feed {
        match self.feed_of_motion() {
            Feed::PerMinute(feed) if N > LINEAR => {
                let [linear, rotary] = squared_ways(&self.state.position, target);
                Feed::PerMinute(if rotary == 0.0 {
                    feed
                } else if linear == 0.0 {
                    per_second(self.action.modal.rotary_feed())
                } else {
                    feed * square_root(1.0 + rotary / linear)
                })
            }
            feed => feed,
        }
    }
}
