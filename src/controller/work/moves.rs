//! Turns target positions into moves with speed, power and tolerance. Queues a move in the look-ahead when there is
//! room, and starts motion when the look-ahead is full. Begins arcs and other curves, and queues their chords (the
//! straight pieces that replace a curve).

use crate::axes::{LINEAR, PerAxis};
use crate::dispatch::Controller;
use crate::gcode::{ArcMove, Dialect, Feed, MotionCommand, NurbsMove, PathControl};
use crate::image::FULL_IMAGE;
use crate::machine::spindle::SpindleRange;
use crate::messages::SpindleDirection;
use crate::motion::{ArcGeometry, Move, NurbsGeometry, Speed, SplineGeometry, Tolerance};
use crate::settings::Key;
use crate::states::State;
use crate::units::Coordinate;
use crate::work::task::{Job, Stage};

impl<const N: usize> Controller<N> {
    /// Starts the queued motion if it is not running. Called when the look-ahead is full, or when a line has to wait
    /// for the end of motion.
    pub(crate) fn start_queued(&mut self) {
        if !self.m.step_supply.is_running() && !self.m.motion.is_idle() {
            self.start_motion();
        }
    }

    pub(crate) fn queue(&mut self, target: &PerAxis<Coordinate, N>, speed: Speed, job: &Job) -> bool {
        let mv = self.move_of(target, speed, job.jog);
        self.queue_move(&mv, job)
    }

    /// Queues a complete move. Returns whether there was room for it.
    pub(crate) fn queue_move(&mut self, mv: &Move<N>, job: &Job) -> bool {
        let taken = self.m.motion.line(mv);
        if !taken {
            self.start_queued();
        } else if job.jog {
            self.enter(State::Jog { cancelling: false });
            self.start_motion();
        } else if self.m.motion.has_joined_enough() {
            self.start_queued();
        }
        taken
    }

    pub(crate) fn move_of(&self, target: &PerAxis<Coordinate, N>, speed: Speed, jog: bool) -> Move<N> {
        let laser = self.m.settings.is_on(Key::Laser);
        // A laser burns only in feed motions, and in Grbl's dialect also in jogs.
        let dark = laser && (speed == Speed::Rapid || jog && self.dialect() != Dialect::Grbl);
        let power = if !self.m.accessories.is_on() || dark {
            0
        } else {
            // `outputs` applies the spindle override when the move is executed.
            SpindleRange::of(&self.m.settings).output(self.line.action.speed, 100).0
        };
        Move {
            target: *target,
            speed,
            power,
            // M4: the laser's power follows the speed.
            scale_power: laser && self.m.accessories.spindle() == SpindleDirection::CounterClockwise,
            line_number: self.line.action.line_number,
            no_feed_override: jog,
            digit: self.line.action.digit,
            tolerance: self.tolerance(target, speed),
        }
    }

    /// Returns how far a move may deviate from its path. The tolerance is 0 unless the move is a straight feed move
    /// under G64 P that turns no rotary axis. If a rotary axis turns, corners are not rounded, because F would not
    /// define the speed in a rounded corner where A reverses.
    fn tolerance(&self, target: &PerAxis<Coordinate, N>, speed: Speed) -> Tolerance {
        let within = match (speed, self.line.action.motion, self.m.interpreter.modal().path) {
            (Speed::Feed(_), MotionCommand::Line { .. }, PathControl::Within(tolerance)) => tolerance,
            _ => return Tolerance::EXACT,
        };
        if N > LINEAR && turns(&self.m.motion.planned_position(), target) {
            return Tolerance::EXACT;
        }
        let mm = |units: u32| Coordinate(i64::from(units)).to_mm();
        Tolerance { path: mm(within.path), merging: mm(within.merging) }
    }

    pub(crate) fn begin_arc(&mut self, geometry: &ArcGeometry<N>, feed: Feed, job: &mut Job) -> Stage {
        let (length, stretch) = self.line.begin_arc(geometry, self.m.settings.value(Key::ArcTolerance));
        job.chord_feed = match feed {
            // F is the speed along X, Y and Z only, so the speed along all axes is higher.
            Feed::PerMinute(feed) if N > LINEAR => feed * stretch,
            Feed::PerMinute(feed) => feed,
            Feed::InverseTime(seconds) => length / seconds,
            Feed::Rapid => f32::MAX,
        };
        Stage::Chords
    }

    #[inline(never)]
    pub(crate) fn begin_spline(&mut self, geometry: &SplineGeometry<N>, feed: Feed, job: &mut Job) -> Stage {
        self.line.begin_spline(geometry, self.m.settings.value(Key::ArcTolerance));
        job.chord_feed = match feed {
            Feed::PerMinute(feed) => feed,
            Feed::InverseTime(seconds) => geometry.length() / seconds,
            Feed::Rapid => f32::MAX,
        };
        Stage::Chords
    }

    #[inline(never)]
    pub(crate) fn begin_nurbs(&mut self, nurbs: &NurbsMove<N>, job: &mut Job) -> Stage {
        let geometry =
            NurbsGeometry { start: nurbs.start, points: self.m.interpreter.control_points(), order: nurbs.order };
        self.line.begin_nurbs(&geometry, self.m.settings.value(Key::ArcTolerance));
        job.chord_feed = match nurbs.feed {
            Feed::PerMinute(feed) => feed,
            Feed::InverseTime(seconds) => geometry.length() / seconds,
            Feed::Rapid => f32::MAX,
        };
        Stage::Chords
    }

    /// Begins the circle of G12 or G13: queues the straight move from the centre to its start. Returns the next stage;
    /// `None` if there is no room for a block.
    #[inline(never)]
    pub(crate) fn begin_circle(&mut self, geometry: &ArcGeometry<N>, feed: Feed, job: &mut Job) -> Option<Stage> {
        if self.m.motion.free_blocks() == 0 {
            self.start_queued();
            return None;
        }
        let next = self.begin_arc(geometry, feed, job);
        self.queue(&geometry.start, Speed::Feed(job.chord_feed), job).then_some(next)
    }

    /// Ends G12 or G13: queues the straight move back to the centre. Returns the next stage; `None` if there is no
    /// room for a block.
    #[inline(never)]
    pub(crate) fn end_circle(&mut self, job: &Job) -> Option<Stage> {
        let centre = *self.m.interpreter.position();
        self.queue(&centre, Speed::Feed(job.chord_feed), job).then_some(Stage::Flow)
    }

    /// Queues the next chord of the line's curve. Returns the next stage; `None` if there is no room for a chord.
    pub(crate) fn next_chord(&mut self, job: &Job) -> Option<Stage> {
        if self.m.motion.free_blocks() == 0 {
            self.start_queued();
            return None;
        }
        let Some((end, curvature)) = self.line.next_chord(self.m.interpreter.control_points()) else {
            let from_centre = matches!(self.line.action.motion, MotionCommand::Arc(ArcMove { from_centre: true, .. }));
            return Some(if FULL_IMAGE && from_centre { Stage::Back } else { Stage::Flow });
        };
        let mv = self.move_of(&end, Speed::Feed(job.chord_feed), job.jog);
        // There is room for a block, so `chord` takes the move.
        self.m.motion.chord(&mv, curvature);
        Some(Stage::Chords)
    }
}

/// Returns whether a rotary axis moves between two positions.
fn turns<const N: usize>(from: &PerAxis<Coordinate, N>, to: &PerAxis<Coordinate, N>) -> bool {
    from.iter().zip(to.iter()).skip(LINEAR).any(|(from, to)| from != to)
}

pub(crate) fn speed(feed: Feed) -> Speed {
    match feed {
        Feed::Rapid => Speed::Rapid,
        Feed::PerMinute(speed) => Speed::Feed(speed),
        Feed::InverseTime(seconds) => Speed::Duration(seconds),
    }
}
