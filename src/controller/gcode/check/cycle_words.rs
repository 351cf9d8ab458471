//! Canned cycles (G73 to G89): reads hole, levels, peck, dwell and repeats from a line. If the lines before have the
//! same cycle in the same plane, a word that the line lacks keeps its most recent value. The result is a
//! [`Cycle`](crate::gcode::Cycle) that the controller executes step by step.

use super::draft::Draft;
use crate::axes::{Axis, PerAxis};
use crate::error::Error;
use crate::gcode::action::MotionCommand;
use crate::gcode::cycle::{Cycle, CyclePhase, CycleWords};
use crate::gcode::modal::{CycleKind, Distance, FeedMode, MotionMode, PlaneAxes};
use crate::gcode::values::{along, reachable, seconds};
use crate::messages::SpindleDirection;
use crate::units::{Coordinate, Decimal};

/// Maximum number of holes that one line can request (L).
const REPEATS_MAX: i32 = 1_000_000;

impl<const N: usize> Draft<'_, N> {
    /// Checks a line of a canned cycle, and makes its words a [`MotionCommand::Cycle`].
    pub(super) fn cycle(&mut self, kind: CycleKind) -> Result<(), Error> {
        let modal = self.action.modal;
        if modal.feed_mode == FeedMode::InverseTime {
            return Err(Error::CycleNeedsPerMinute);
        }
        // An M6 on the line can stop the spindle, so a line with M6 needs its own M3 or M4.
        let stopped = self.action.tool_change && self.line.spindle.is_none();
        if kind.stops_spindle() && (stopped || modal.spindle == SpindleDirection::Off) {
            return Err(Error::SpindleNotTurning);
        }
        let axes = modal.plane.axes();
        if self.line.axes.is_empty() {
            return Err(Error::NoAxisWords);
        }
        if Axis::of_machine::<N>().skip(3).any(|axis| self.line.axes.has(axis)) {
            return Err(Error::AxisWordsUnused);
        }
        self.needs_plane(axes)?;
        let words = self.cycle_words(kind, axes)?;
        let place = self.state.position;
        let mut hole = self.target();
        hole.set(axes.linear, along(&place, axes.linear));
        let (pitch, [r, bottom], peck) = self.levels(&words, axes, &hole)?;
        if r < bottom {
            return Err(Error::RetractBelowBottom);
        }
        let clear = if modal.retract_to_r { r } else { self.level_of(&words, axes).max(r) };
        let cycle = Cycle {
            kind,
            axes,
            place,
            hole,
            pitch,
            left: self.repeats()?,
            r,
            bottom,
            clear,
            peck,
            reached: r,
            next: CyclePhase::Rise,
            feed: self.feed_per_second(),
            spindle: modal.spindle,
            words,
        };
        for corner in &cycle.corners() {
            reachable(corner)?;
        }
        self.action.position = cycle.at_depth(&cycle.hole_after(cycle.left - 1), clear);
        self.action.motion = MotionCommand::Cycle(cycle);
        Ok(())
    }

    /// Returns three scaled results: the vector from one hole to the next, the machine coordinates of R and of the
    /// bottom, and the depth of a peck.
    fn levels(
        &self,
        words: &CycleWords,
        axes: PlaneAxes,
        hole: &PerAxis<Coordinate, N>,
    ) -> Result<([Coordinate; 2], [Coordinate; 2], Coordinate), Error> {
        let incremental = self.action.modal.distance == Distance::Incremental;
        let [r, depth] = [words.r, words.depth].map(|word| self.scaled_length(axes.linear, word, incremental));
        let peck = self.scaled_size(axes.linear, words.peck);
        if words.peck > Coordinate::ZERO && peck <= Coordinate::ZERO {
            return Err(Error::ValueOutOfRange);
        }
        if incremental {
            let place = &self.state.position;
            let pitch = [axes.first, axes.second].map(|axis| along(hole, axis) - along(place, axis));
            let level = self.level_of(words, axes);
            Ok((pitch, [level + r, level + r + depth], peck))
        } else {
            let origin = self.work_offset(axes.linear);
            Ok(([Coordinate::ZERO; 2], [origin + r, origin + depth], peck))
        }
    }

    /// Reads the words of the cycle from the line. A word that the line lacks keeps the value in force.
    fn cycle_words(&mut self, kind: CycleKind, axes: PlaneAxes) -> Result<CycleWords, Error> {
        let (before, modal) = (&self.state.modal, self.action.modal);
        let series = matches!(before.motion, MotionMode::Cycle(_)) && self.state.cycle.plane == modal.plane;
        let sticky = series && before.motion == MotionMode::Cycle(kind);
        let mut words = if series {
            self.state.cycle
        } else {
            let level = along(&self.state.position, axes.linear) - self.tool_offset(axes.linear);
            CycleWords { plane: modal.plane, level, ..CycleWords::NONE }
        };
        let line = self.line;
        let unused = self.unused;
        let missing = |letter| !(sticky || unused.has(letter));
        let depth_missing = !(sticky || line.axes.has(axes.linear));
        if depth_missing || missing(b'R') || kind.pecks() && missing(b'Q') || kind.dwells() && missing(b'P') {
            return Err(Error::ValueWordMissing);
        }
        if line.axes.has(axes.linear) {
            words.depth = self.axis_length(axes.linear);
        }
        if self.take(b'R') {
            words.r = self.length(line.value(b'R'));
        }
        if kind.pecks() && self.take(b'Q') {
            words.peck = self.length(line.value(b'Q'));
            if words.peck <= Coordinate::ZERO {
                return Err(Error::ValueOutOfRange);
            }
        }
        if kind.dwells() && self.take(b'P') {
            words.dwell = seconds(line.value(b'P'));
        }
        Ok(words)
    }

    /// Returns the level at which the series of cycles began, as a machine coordinate along the axis of the holes.
    /// `words` hold this level without the tool length offset; the offset of the present line is added.
    fn level_of(&self, words: &CycleWords, axes: PlaneAxes) -> Coordinate {
        words.level + self.tool_offset(axes.linear)
    }

    /// Reads L, the number of holes. With G90, all holes are at the same position. With G91, they form a row.
    fn repeats(&mut self) -> Result<u32, Error> {
        if !self.take(b'L') {
            return Ok(1);
        }
        let count = self.line.value(b'L').truncate();
        if Decimal::from_int(count) != self.line.value(b'L') {
            return Err(Error::IntegerRequired);
        }
        if !(1..=REPEATS_MAX).contains(&count) {
            return Err(Error::ValueOutOfRange);
        }
        Ok(count.unsigned_abs())
    }
}
