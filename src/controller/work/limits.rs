//! Finds reasons to refuse a line whose words are correct: settings that lock motion, a position that needs homing,
//! targets out of range, and soft limits. All kinds of motion are checked for points outside the travel. A jog can be
//! shortened to the travel instead.

use crate::axes::{Arrangement, Axis, PerAxis};
use crate::dispatch::Controller;
use crate::error::Error;
use crate::gcode::{self, ArcMove, Dialect, NurbsMove, SplineMove};
use crate::image::FULL_IMAGE;
use crate::motion::{ArcGeometry, NurbsGeometry, SplineGeometry, extent};
use crate::protocol::reply_texts;
use crate::settings::{AxisKey, Key};
use crate::units::Coordinate;

impl<const N: usize> Controller<N> {
    /// Returns an error if the machine must refuse the line although its words are correct: motion is locked, the line
    /// needs homing first, or it leaves the range in which the controller computes.
    pub(crate) fn refuse_line(&mut self) -> Option<Error> {
        if self.line.action.motion != gcode::MotionCommand::None
            && let Some(error) = self.motion_locked()
        {
            return Some(error);
        }
        if self.line.action.uses_machine_place && self.needs_homing() {
            self.say(|out| reply_texts::message(out, "Home first: the machine position is not known"));
            return Some(Error::Locked);
        }
        self.leaves_range().then_some(Error::InvalidTarget)
    }

    /// Returns whether the motion leaves the range in which the controller computes. An arc can bulge beyond its ends,
    /// and with belts (CoreXY) a motor moves by the sum of X and Y.
    fn leaves_range(&self) -> bool {
        // The target of a straight line has been checked before, and all points of the line lie between its ends.
        let is_plain =
            matches!(self.line.action.motion, gcode::MotionCommand::None | gcode::MotionCommand::Line { .. });
        !(is_plain && self.m.settings.arrangement() == Arrangement::Cartesian) && self.bulges_out()
    }

    #[inline(never)]
    fn bulges_out(&self) -> bool {
        let belts = self.m.settings.arrangement() == Arrangement::CoreXy;
        let outside = |position: &PerAxis<Coordinate, N>| {
            let sum = match position.0.as_slice() {
                [x, y, ..] if belts => x.0.saturating_abs().saturating_add(y.0.saturating_abs()),
                _ => 0,
            };
            sum > Coordinate::LIMIT.0 || !position.iter().all(|coordinate| coordinate.in_range())
        };
        match &self.line.action.motion {
            gcode::MotionCommand::Arc(arc) => {
                let wide = arc.i.0.unsigned_abs().max(arc.j.0.unsigned_abs()) > Coordinate::LIMIT.0.unsigned_abs() / 8;
                let near = |position: &PerAxis<Coordinate, N>| {
                    position
                        .iter()
                        .all(|coordinate| coordinate.0.unsigned_abs() < Coordinate::LIMIT.0.unsigned_abs() / 8)
                };
                if !wide && near(&arc.start) && near(&arc.target) {
                    return false;
                }
                let (least, greatest) = extent(&geometry(arc));
                let farthest = least.zip(&greatest, |a, b| Coordinate(a.0.saturating_abs().max(b.0.saturating_abs())));
                outside(&farthest)
            }
            gcode::MotionCommand::Line { via, target, .. } if belts => {
                via.as_ref().is_some_and(outside) || outside(target)
            }
            gcode::MotionCommand::Probe { target, .. } if belts => outside(target),
            // The curve lies within the polygon of its control points, so only these points are checked.
            gcode::MotionCommand::Spline(spline) if FULL_IMAGE && belts => spline.corners().iter().any(outside),
            gcode::MotionCommand::Nurbs(nurbs) if FULL_IMAGE && belts => self.nurbs_geometry(nurbs).leaves(outside),
            gcode::MotionCommand::Cycle(cycle) if belts => cycle.corners().iter().any(outside),
            _ => false,
        }
    }

    /// Shortens a jog so that it ends within the travel. An axis that is already outside does not move further out.
    pub(crate) fn clip_to_travel(&mut self) {
        if let gcode::MotionCommand::Line { target, .. } = &self.line.action.motion
            && self.limits_travel()
        {
            let here = self.m.interpreter.position();
            let mut end = *target;
            for (axis, end) in Axis::ALL.into_iter().zip(end.iter_mut()) {
                if let (Some(ends), Some(here)) = (self.m.settings.ends_of_travel(axis), here.get(axis)) {
                    let [least, greatest] = ends.map(Coordinate::from_mm_f32);
                    *end = (*end).clamp(here.min(least), here.max(greatest));
                }
            }
            self.line.action.redirect(end);
        }
    }

    /// Returns whether soft limits (`$20`) are in force: they are on, and the machine need not be homed first.
    pub(crate) fn limits_travel(&self) -> bool {
        self.m.settings.is_on(Key::SoftLimits) && !self.needs_homing()
    }

    /// Returns whether any part of the line's motion is outside the travel while soft limits (`$20`) are in force.
    pub(crate) fn violates_soft_limits(&self) -> bool {
        self.limits_travel() && self.leaves_travel()
    }

    #[inline(never)]
    fn leaves_travel(&self) -> bool {
        let outside = |position: &PerAxis<Coordinate, N>| self.is_outside_travel(position);
        match &self.line.action.motion {
            gcode::MotionCommand::None => false,
            gcode::MotionCommand::Line { via, target, .. } => via.as_ref().is_some_and(outside) || outside(target),
            gcode::MotionCommand::Arc(arc) => {
                let (least, greatest) = extent(&geometry(arc));
                outside(&least) || outside(&greatest)
            }
            gcode::MotionCommand::Spline(spline) if FULL_IMAGE => {
                let (least, greatest) = spline_geometry(spline).extent();
                outside(&least) || outside(&greatest)
            }
            gcode::MotionCommand::Nurbs(nurbs) if FULL_IMAGE => self.nurbs_geometry(nurbs).leaves(outside),
            gcode::MotionCommand::Spline(_) | gcode::MotionCommand::Nurbs(_) => false,
            gcode::MotionCommand::Probe { target, .. } => outside(target),
            gcode::MotionCommand::Cycle(cycle) => cycle.corners().iter().any(outside),
        }
    }

    /// Returns the curve of G5.3, with the control points that the interpreter has collected from G5.2.
    fn nurbs_geometry(&self, nurbs: &NurbsMove<N>) -> NurbsGeometry<'_, N> {
        NurbsGeometry { start: nurbs.start, points: self.m.interpreter.control_points(), order: nurbs.order }
    }

    /// Returns whether a position is outside the travel of an axis in use. Up to half a step beyond an end counts as
    /// inside (see `reach`), except at an end at 0.
    pub(crate) fn is_outside_travel(&self, position: &PerAxis<Coordinate, N>) -> bool {
        let axes = Axis::ALL.into_iter().take(self.m.settings.axes_in_use());
        axes.zip(position.iter()).any(|(axis, place)| {
            let Some([least, greatest]) = self.m.settings.ends_of_travel(axis) else { return false };
            let is_beyond = |place: Coordinate, end: f32| {
                let past = |end: f32| place > Coordinate::from_mm_f32(end);
                past(end) && (end == 0.0 || past(self.reach(axis, end)))
            };
            is_beyond(*place, greatest) || is_beyond(-*place, -least)
        })
    }

    /// Returns the coordinate (mm) up to which a position counts as within `travel`. If the travel is not a whole
    /// number of steps, an axis that was sent to its end can be up to half a step beyond it. A later line that moves
    /// only other axes must not be refused for that.
    #[inline(never)]
    fn reach(&self, axis: Axis, travel: f32) -> f32 {
        let resolution = self.m.settings.axes(AxisKey::Resolution).get(axis).unwrap_or(0.0);
        let steps = travel * resolution;
        // `steps` may be whole only because `f32` has rounded it. So even with whole steps, 0.02 steps beyond the
        // travel are allowed.
        let share = if steps as i32 as f32 == steps { 0.02 } else { 0.5 };
        travel + share / resolution
    }

    /// Returns the number (`$`) of the setting that locks all motion, if a setting does.
    pub(crate) fn locking_setting(&mut self) -> Option<u16> {
        self.m.settings_lock.setting(&self.m.settings)
    }

    /// Returns an error if all motion is locked: by a fault of the board, by damaged stored settings, or by a setting.
    /// Also tells the host about the damage, or (only once) which setting locks motion.
    pub(crate) fn motion_locked(&mut self) -> Option<Error> {
        if self.m.settings_lock.has_board_fault() {
            return Some(Error::Locked);
        }
        if self.m.records.are_damaged() {
            self.tell_damage();
            return Some(Error::StoreReadFailed);
        }
        self.locking_setting()?;
        if let Some(setting) = self.m.settings_lock.name_at_line() {
            self.name_locking(setting);
        }
        Some(Error::Locked)
    }

    /// Tells the host which setting locks motion. Called after the setting with the number `changed` has been changed.
    /// Grbl answers a change with only `ok`, so in its dialect the host is told at the first move.
    pub(crate) fn name_after_change(&mut self, changed: u16) {
        self.locking_setting();
        if let Some(setting) = self.m.settings_lock.name_after_change(changed)
            && self.dialect() != Dialect::Grbl
        {
            self.name_locking(setting);
        }
    }

    #[inline(never)]
    fn name_locking(&mut self, setting: u16) {
        self.say(|out| {
            reply_texts::message_number(out, "Motion is locked until you correct this setting: $", setting.into())
        });
    }

    /// Returns whether lines that use machine coordinates are refused until the machine is homed, because the position
    /// is not trusted.
    fn needs_homing(&self) -> bool {
        !self.m.reference.is_trusted()
            && self.dialect() != Dialect::Grbl
            && self.m.settings.is_on(Key::Homing)
            && self.m.settings.is_on(Key::TrustNeeded)
    }
}

pub(crate) fn geometry<const N: usize>(arc: &ArcMove<N>) -> ArcGeometry<N> {
    ArcGeometry {
        start: arc.start,
        target: arc.target,
        axis_0: arc.axes.first,
        axis_1: arc.axes.second,
        offset_0: arc.i,
        offset_1: arc.j,
        clockwise: arc.clockwise,
        turns: arc.turns,
    }
}

pub(crate) fn spline_geometry<const N: usize>(spline: &SplineMove<N>) -> SplineGeometry<N> {
    SplineGeometry { start: spline.start, target: spline.target, leaving: spline.leaving, arriving: spline.arriving }
}
