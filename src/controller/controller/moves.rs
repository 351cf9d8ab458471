//! A target becomes a move in the look-ahead.

use super::Controller;
use super::task::{Job, Stage};
use crate::axes::{LINEAR, PerAxis};
use crate::gcode::Feed;
use crate::machine::spindle::SpindleRange;
use crate::machine::state::Mode;
use crate::messages::SpindleDirection;
use crate::motion::{Arc, ArcGeometry, Move, Speed};
use crate::settings::Key;
use crate::units::Coordinate;

impl<const N: usize, const BLOCKS: usize> Controller<N, BLOCKS> {
    /// The look-ahead is full, or the line has to wait for its end: what is queued must move.
    pub(super) fn start_queued(&mut self) {
        if !self.step_supply.is_running() && !self.motion.is_idle() {
            self.start_motion();
        }
    }

    pub(super) fn queue(&mut self, target: &PerAxis<Coordinate, N>, speed: Speed, job: &Job) -> bool {
        let mv = self.move_of(target, speed, job.jog);
        let taken = self.motion.line(&mv);
        if !taken {
            self.start_queued();
        } else if job.jog {
            self.mode = Mode::Jog { cancelling: false };
            self.start_motion();
        } else if self.motion.has_joined_enough() {
            self.start_queued();
        }
        taken
    }

    pub(super) fn move_of(&self, target: &PerAxis<Coordinate, N>, speed: Speed, jog: bool) -> Move<N> {
        let laser = self.settings.is_on(Key::Laser);
        // A laser burns in feed motions only.
        let dark = laser && speed == Speed::Rapid;
        let power = if !self.accessories.is_on() || dark {
            0
        } else {
            // The override is applied when its turn comes (`outputs`).
            SpindleRange::of(&self.settings).output(self.line.checked.speed, 100).0
        };
        Move {
            target: *target,
            speed,
            power,
            // M4: the laser's power follows the speed.
            scale_power: laser && self.accessories.spindle() == SpindleDirection::CounterClockwise,
            line_number: self.line.checked.line_number,
            no_feed_override: jog,
            digit: self.line.checked.digit,
        }
    }

    pub(super) fn begin_arc(&mut self, geometry: &ArcGeometry<N>, feed: Feed) -> Stage {
        let length = self.line.begin_arc(geometry, self.settings.value(Key::ArcTolerance));
        let feed = match feed {
            Feed::PerMinute(feed) if N > LINEAR => feed * self.line.arc().map_or(1.0, Arc::rotary_stretch),
            Feed::PerMinute(feed) => feed,
            Feed::InverseTime(seconds) => length / seconds,
            Feed::Rapid => f32::MAX,
        };
        Stage::Chords(feed)
    }

    /// The next chord of the arc under way. What follows; `None` if there is no room for it.
    pub(super) fn next_chord(&mut self, feed: f32, job: &Job) -> Option<Stage> {
        if self.motion.free_blocks() == 0 {
            self.start_queued();
            return None;
        }
        let Some(end) = self.line.next_chord() else { return Some(Stage::Flow) };
        let mv = self.move_of(&end, Speed::Feed(feed), job.jog);
        if let Some(arc) = self.line.arc() {
            // There is room for a block, so the move is taken.
            self.motion.chord(&mv, arc);
        }
        Some(Stage::Chords(feed))
    }
}

/// The speed that a feed asks for.
pub(super) fn speed(feed: Feed) -> Speed {
    match feed {
        Feed::Rapid => Speed::Rapid,
        Feed::PerMinute(speed) => Speed::Feed(speed),
        Feed::InverseTime(seconds) => Speed::Duration(seconds),
    }
}
