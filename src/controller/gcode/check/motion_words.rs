//! Moves of a line: straight lines, arcs by radius or centre, and probing moves. Splines and canned cycles have files
//! of their own. Targets are in machine coordinates, after scaling, rotation and offsets.

use super::draft::{CENTRE, Draft};
use crate::axes::Axis;
use crate::error::Error;
use crate::gcode::Dialect;
use crate::gcode::action::{ArcMove, Feed, MotionCommand, Notice};
use crate::gcode::arc::{self, Vector};
use crate::gcode::modal::{ArcDistance, FeedMode, MotionMode, Plane, PlaneAxes, ProbeMode, SplineKind, Units};
use crate::gcode::values::{along, reachable, whole};
use crate::gcode::word::{Claim, Letters, NonModal};
use crate::image::FULL_IMAGE;
use crate::units::{Coordinate, DECIMAL_ONE, Decimal};

/// Maximum number of turns of an arc (P of G2 and G3).
const TURNS_MAX: i32 = 1_000_000;

impl<const N: usize> Draft<'_, N> {
    pub(super) fn motion(&mut self) -> Result<(), Error> {
        if FULL_IMAGE && self.line.extended.any {
            if self.line.extended.ends_control_points {
                return self.nurbs();
            }
            if let Some(clockwise) = self.line.extended.circle {
                return self.circle(clockwise);
            }
        }
        let mode = self.action.modal.motion;
        if FULL_IMAGE && self.line.modal.motion.is_some() {
            self.leaves_control_points(mode)?;
        }
        if mode == MotionMode::Cancelled {
            // In Grbl, a line with axis words in the mode G80 is an error, even if another command of the line uses
            // the words.
            let used = self.dialect != Dialect::Grbl && self.claim != Claim::Motion;
            return if self.line.axes.is_empty() || used { Ok(()) } else { Err(Error::AxisWordsUnused) };
        }
        if self.claim != Claim::Motion {
            return Ok(());
        }
        if mode != MotionMode::Rapid && self.action.modal.feed == Decimal::ZERO {
            return if self.is_look_ahead() { self.switch_look_ahead() } else { Err(Error::UndefinedFeed) };
        }
        match mode {
            MotionMode::Rapid | MotionMode::Linear => self.straight(mode),
            MotionMode::ArcClockwise => self.arc(true),
            MotionMode::ArcCounterClockwise => self.arc(false),
            MotionMode::Spline(SplineKind::Nurbs) => self.control_point(),
            MotionMode::Spline(_) if self.is_look_ahead() => self.switch_look_ahead(),
            MotionMode::Spline(kind) => self.spline(kind),
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
        let feed = if mode == MotionMode::Rapid { Feed::Rapid } else { self.feed_to(&target) };
        self.action.motion = MotionCommand::Line { via: None, target, feed };
        self.action.position = target;
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
        let feed = self.feed_to(&target);
        self.action.motion = MotionCommand::Probe { target, feed, away: mode.away, alarm: mode.alarm };
        if FULL_IMAGE && self.line.extended.probe_once {
            self.action.modal.motion = self.action.modal.straight;
        }
        self.action.position = target;
        Ok(())
    }

    fn arc(&mut self, clockwise: bool) -> Result<(), Error> {
        let axes = self.action.modal.plane.axes();
        let is_circle = self.dialect != Dialect::Grbl && self.line.values.has_any(CENTRE);
        if self.line.axes.is_empty() && !is_circle {
            return Err(Error::NoAxisWords);
        }
        if !self.line.axes.has(axes.first) && !self.line.axes.has(axes.second) && !is_circle {
            return Err(Error::NoPlaneAxisForArc);
        }
        self.needs_plane(axes)?;
        let clockwise = clockwise != self.mirrors(axes)?;
        let start = self.state.position;
        let mut target = self.target();
        let mut chord = Vector::new(
            along(&target, axes.first) - along(&start, axes.first),
            along(&target, axes.second) - along(&start, axes.second),
        );
        let centre = if self.line.values.has(b'R') {
            self.unused.remove(Letters::of(b"R"));
            let radius = self.scaled_size(axes.first, self.length(self.line.value(b'R')));
            match arc::centre_by_radius(chord, radius, clockwise, arc::DIAMETER_TOLERANCE) {
                Err(Error::ImpossibleRadius) if self.dialect != Dialect::Grbl => {
                    let rounding = self.scaled_size(axes.first, arc::rounding_of_diameter(self.digit_of_arc(axes)));
                    arc::centre_by_radius(chord, radius, clockwise, rounding)?
                }
                centre => centre?,
            }
        } else {
            let centre = self.centre(axes)?;
            let (way, middle) = (self.written_vector(axes, chord), self.written_vector(axes, centre));
            if !arc::radii_agree(way, middle, arc::RADIUS_TOLERANCE)? {
                match self.dialect {
                    Dialect::Seed => {
                        chord = arc::ray_crossing(chord, centre)?;
                        target.set(axes.first, along(&start, axes.first) + Coordinate(chord.first));
                        target.set(axes.second, along(&start, axes.second) + Coordinate(chord.second));
                    }
                    Dialect::Oxmill
                        if arc::radii_agree(way, middle, arc::rounding_of_radii(self.digit_of_arc(axes)))? => {}
                    _ => return Err(Error::InvalidTarget),
                }
            }
            centre
        };
        reachable(&target)?;
        let turns = self.turns()?;
        let feed = self.feed_of_motion();
        let (i, j) = (Coordinate(centre.first), Coordinate(centre.second));
        // If the radius of an arc is 0, the line is a straight move of the axes outside the plane.
        self.action.motion = if arc::is_point(centre) {
            MotionCommand::Line { via: None, target, feed: self.feed_to(&target) }
        } else {
            MotionCommand::Arc(ArcMove { start, target, axes, i, j, clockwise, turns, feed, from_centre: false })
        };
        self.action.position = target;
        Ok(())
    }

    /// Checks G12 and G13, which act as on Mach: the tool feeds along X by I, moves in a full circle round its
    /// starting position, and feeds back to that position. I is the radius of the tool's path.
    ///
    /// On Haas, I is the radius of the wall. If D has named the radius of a tool, Haas subtracts it from I. So two
    /// kinds of lines are refused, because they look like a program for Haas: a line with D, K, L, Q or Z, and a line
    /// after a D other than D0.
    #[inline(never)]
    fn circle(&mut self, clockwise: bool) -> Result<(), Error> {
        let axes = Plane::Xy.axes();
        if self.line.non_modal == Some(NonModal::MachineCoordinates) {
            return Err(Error::G53NeedsMotion);
        }
        if self.action.modal.plane != Plane::Xy {
            return Err(Error::SplineOutsideXy);
        }
        if self.state.names_radius {
            return Err(Error::NotSupported);
        }
        self.leaves_control_points(MotionMode::Linear)?;
        self.needs_plane(axes)?;
        if self.action.modal.feed_mode == FeedMode::InverseTime {
            return Err(Error::CycleNeedsPerMinute);
        }
        if self.action.modal.feed == Decimal::ZERO {
            return Err(Error::UndefinedFeed);
        }
        if !self.take(b'I') {
            return Err(Error::ValueWordMissing);
        }
        if self.line.value(b'I') <= Decimal::ZERO {
            return Err(Error::ValueOutOfRange);
        }
        if !self.line.axes.is_empty() {
            self.action.unused.fill(self.line.values.shared_with(Letters::of(b"XYZABC")));
            return Err(Error::UnusedWords);
        }
        let clockwise = clockwise != self.mirrors(axes)?;
        let radius = self.scaled_length(axes.first, self.length(self.line.value(b'I')), true);
        let [out_x, out_y] = match self.rotated {
            Some(rotated) => rotated.angle.turn([radius, Coordinate::ZERO]),
            None => [radius, Coordinate::ZERO],
        };
        let mut start = self.state.position;
        start.set(axes.first, along(&start, axes.first) + out_x);
        start.set(axes.second, along(&start, axes.second) + out_y);
        reachable(&start)?;
        let feed = self.feed_of_motion();
        let (i, j) = (-out_x, -out_y);
        self.action.motion = MotionCommand::Arc(ArcMove {
            start,
            target: start,
            axes,
            i,
            j,
            clockwise,
            turns: 0,
            feed,
            from_centre: true,
        });
        self.action.after.notice.get_or_insert(Notice::CircleOfMach);
        Ok(())
    }

    /// Returns the vector from the start to the centre of an arc, from the words I, J and K.
    fn centre(&mut self, axes: PlaneAxes) -> Result<Vector, Error> {
        let (first, second) = (centre_letter(axes.first), centre_letter(axes.second));
        let (has_first, has_second) = (self.line.values.has(first), self.line.values.has(second));
        let absolute = self.dialect != Dialect::Grbl && self.action.modal.arc_distance == ArcDistance::Absolute;
        // Two of the words I, J and K belong to the plane. As distances (G91.1), one of the two may be missing and is
        // then 0. As coordinates (G90.1), both are required.
        if !(has_first || has_second) || absolute && !(has_first && has_second) {
            return Err(Error::NoPlaneOffsets);
        }
        self.unused.remove(CENTRE);
        let centre_along = |axis: Axis| {
            let value = self.length(match axis {
                Axis::X => self.line.value(b'I'),
                Axis::Y => self.line.value(b'J'),
                _ => self.line.value(b'K'),
            });
            if absolute {
                self.scaled_length(axis, value, false) - self.program_coordinate(axis)
            } else {
                self.scaled_length(axis, value, true)
            }
        };
        if FULL_IMAGE && let Some(rotated) = self.rotated {
            let [first, second] = rotated.angle.turn([centre_along(axes.first), centre_along(axes.second)]);
            return Vector::new(first, second).checked();
        }
        Vector::new(centre_along(axes.first), centre_along(axes.second)).checked()
    }

    /// Returns the value of the last decimal place in the words of an arc. It is at most 0.01 mm or 0.001 inch, because
    /// programs often omit trailing zeros.
    #[inline(never)]
    fn digit_of_arc(&self, axes: PlaneAxes) -> Coordinate {
        let line = self.line;
        let ends = [axes.first, axes.second].map(|axis| line.axis.get(axis).unwrap_or(Decimal::ZERO));
        let others = [b'I', b'J', b'K', b'R'].map(|letter| line.value(letter));
        let mut digit = DECIMAL_ONE / if self.action.modal.units == Units::Mm { 100 } else { 1000 };
        for value in ends.into_iter().chain(others) {
            while value.0 % digit != 0 {
                digit /= 10;
            }
        }
        self.length(Decimal(digit))
    }

    /// Reads P of an arc: the number of turns, including the last one, which ends at the target. Returns the number of
    /// full turns before the last one: 0 for P1 or no P.
    fn turns(&mut self) -> Result<u32, Error> {
        if self.dialect == Dialect::Grbl || !self.unused.has(b'P') {
            return Ok(0);
        }
        self.unused.remove(Letters::of(b"P"));
        let turns = whole(self.line.value(b'P'))?;
        if !(1..=TURNS_MAX).contains(&turns) {
            return Err(Error::IntegerRequired);
        }
        Ok(turns.unsigned_abs() - 1)
    }
}

fn centre_letter(axis: Axis) -> u8 {
    match axis {
        Axis::X => b'I',
        Axis::Y => b'J',
        _ => b'K',
    }
}
