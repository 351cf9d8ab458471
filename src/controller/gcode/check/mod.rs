//! Checks the words of a parsed line: what they mean in the present modal state. The steps run in the order in which
//! Grbl checks, and the first error is returned. The interpreter calls [`check`] for lines of a program and for jogs.
//! Nothing changes before the line is committed. Short steps are in this file, the others in files of their own.

mod control_point_words;
mod cycle_words;
mod draft;
mod habits;
mod motion_words;
mod offset_words;
mod pin_words;
mod rotation_words;
mod scaling_words;
mod spline_words;
mod state_words;
mod targets;
mod tool_words;

use super::Dialect;
use super::action::{Action, Flow, Keeping, MotionCommand};
use super::modal::{FeedMode, MotionMode, PathControl, PathTolerance, Units};
use super::offsets::StoredOffset;
use super::parse::Parsed;
use super::state::Interpreter;
use super::values::seconds;
use super::word::{Claim, Groups, Letters, MWord, NonModal};
use crate::error::Error;
use crate::image::FULL_IMAGE;
use crate::messages::Coolant;
use crate::units::{Decimal, per_second};
use draft::Draft;
pub(super) use draft::Purpose;

/// Maximum line number (N).
const LINE_NUMBER_MAX: i32 = 10_000_000;

/// Checks the words of a line in the present modal state, and writes the result to `action`. If an error is returned,
/// `action` must not be used.
pub(super) fn check<const N: usize>(
    state: &Interpreter<N>,
    line: &Parsed<N>,
    dialect: Dialect,
    purpose: Purpose,
    action: &mut Action<N>,
) -> Result<(), Error> {
    let mut draft = Draft::begin(state, line, dialect, purpose, action);
    // Most lines have no extended words (words that Grbl does not have), and this function must be fast. So one test
    // skips all steps that only extended words need.
    let is_extended = line.extended.any;
    if is_extended {
        draft.sign_of_p()?;
        draft.keep_state()?;
        draft.habits()?;
    }
    draft.line_number()?;
    draft.feed()?;
    // In Grbl's dialect a line without T deselects the tool. So while a tool is selected, such a line does more than
    // move.
    let is_move = line.is_move() && (dialect != Dialect::Grbl || state.modal.tool == 0);
    if !is_move {
        draft.speed();
        draft.tool()?;
        draft.spindle_and_coolant();
        draft.parking_override();
    }
    if is_extended {
        draft.overrides()?;
        draft.path_control()?;
    }
    if !is_move {
        draft.dwell()?;
        draft.tool_length()?;
        if dialect != Dialect::Grbl {
            draft.offset_acts();
        }
    }
    draft.rotation()?;
    if !is_move {
        draft.non_modal()?;
    }
    draft.motion()?;
    if is_extended {
        draft.pins()?;
    }
    draft.unused_words()?;
    draft.precision();
    if is_move {
        let action = draft.action;
        action.after.moves_only = matches!(
            action.motion,
            MotionCommand::None | MotionCommand::Line { .. } | MotionCommand::Arc(_) | MotionCommand::Spline(_)
        ) && matches!(action.after.keeping, Keeping::Leave)
            && action.after.notice.is_none();
    } else {
        // Grbl computes the target of a line first, and then executes a G92.1 on the same line. So in Grbl's dialect
        // the offset changes only here, after the motion.
        if dialect == Dialect::Grbl {
            draft.offset_acts();
        }
        draft.finish();
    }
    Ok(())
}

impl<const N: usize> Draft<'_, N> {
    fn line_number(&mut self) -> Result<(), Error> {
        if self.line.values.has(b'N') {
            let number = self.line.value(b'N').truncate();
            if number > LINE_NUMBER_MAX {
                return Err(Error::InvalidLineNumber);
            }
            self.action.line_number = number.unsigned_abs();
        }
        Ok(())
    }

    /// Reads F. With G94 and G95, F stays in force. With G93, each motion needs its own F. After a change of the feed
    /// mode, F is undefined.
    fn feed(&mut self) -> Result<(), Error> {
        if self.line.extended.keep.is_some() {
            // M72 on this line restores F together with the feed mode.
            return Ok(());
        }
        let given = self.line.values.has(b'F');
        let modal = self.action.modal;
        self.action.modal.feed = match (modal.feed_mode, given) {
            (_, false) if self.purpose == Purpose::Jog => return Err(Error::UndefinedFeed),
            (FeedMode::InverseTime, true) => self.line.value(b'F'),
            (FeedMode::InverseTime, false) => {
                let needed = !matches!(modal.motion, MotionMode::Rapid | MotionMode::Cancelled);
                if needed && self.claim == Claim::Motion {
                    return Err(Error::UndefinedFeed);
                }
                Decimal::ZERO
            }
            (mode, true) => {
                self.action.modal.feed_in_inches = modal.units == Units::Inch;
                let feed = Decimal(self.length(self.line.value(b'F')).0);
                self.action.modal.feed_per_second = per_second(feed.to_f32());
                if FULL_IMAGE && mode == FeedMode::PerRevolution {
                    self.needs_speed()?;
                }
                feed
            }
            (FeedMode::PerMinute, false) if self.state.modal.feed_mode == FeedMode::PerMinute => modal.feed,
            (FeedMode::PerRevolution, false) if FULL_IMAGE && self.state.modal.feed_mode == FeedMode::PerRevolution => {
                self.needs_speed()?;
                modal.feed
            }
            (_, false) => Decimal::ZERO,
        };
        Ok(())
    }

    /// Refuses a motion with G95 while S is 0: F is the distance per revolution, so the speed would be 0.
    #[inline(never)]
    fn needs_speed(&self) -> Result<(), Error> {
        let line = self.line;
        let is_zero = match line.values.has(b'S') {
            true => line.value(b'S') == Decimal::ZERO,
            false => self.state.modal.speed == 0.0,
        };
        let is_fed = !matches!(self.action.modal.motion, MotionMode::Rapid | MotionMode::Cancelled)
            || self.line.extended.circle.is_some();
        if is_zero && is_fed && self.claim == Claim::Motion {
            return Err(Error::UndefinedFeed);
        }
        Ok(())
    }

    fn speed(&mut self) {
        let (line, modal) = (self.line, &mut self.action.modal);
        if line.values.has(b'S') {
            modal.speed = line.value(b'S').to_f32();
        }
        self.action.speed = self.action.modal.speed;
        self.action.speed_changed = self.action.speed != self.state.modal.speed;
    }

    fn spindle_and_coolant(&mut self) {
        let (line, modal) = (self.line, &mut self.action.modal);
        modal.spindle = line.spindle.unwrap_or(modal.spindle);
        match line.coolant {
            Some(MWord::Mist) => modal.coolant.mist = true,
            Some(MWord::Flood) => modal.coolant.flood = true,
            Some(_) => modal.coolant = Coolant::default(),
            None => {}
        }
        let (before, modal) = (&self.state.modal, &self.action.modal);
        self.action.spindle = (modal.spindle != before.spindle).then_some(modal.spindle);
        self.action.coolant = (modal.coolant != before.coolant).then_some(modal.coolant);
    }

    /// Executes M56 as Grbl and grblHAL do: P0 disables parking; another P or none enables it.
    fn parking_override(&mut self) {
        if self.line.parking_override {
            self.action.modal.no_parking = self.line.values.has(b'P') && self.line.value(b'P') == Decimal::ZERO;
            self.unused.remove(Letters::of(b"P"));
        }
    }

    /// Reads G61, G61.1, and G64 with its tolerances P and Q. G64 without P, or with P0, keeps the path exact. Q is P
    /// if the line has no Q.
    fn path_control(&mut self) -> Result<(), Error> {
        let Some(path) = self.line.extended.path else { return Ok(()) };
        self.action.modal.path = path;
        if !self.line.extended.is_path_tolerance {
            return Ok(());
        }
        self.unused.remove(Letters::of(b"PQ"));
        let values = &self.line.values;
        let (path, merging) = (self.line.value(b'P'), self.line.value(b'Q'));
        if values.has(b'Q') && merging < Decimal::ZERO {
            return Err(Error::NegativeValue);
        }
        let within = |value| u32::try_from(self.length(value).0).unwrap_or(u32::MAX);
        let path = if values.has(b'P') { within(path) } else { 0 };
        if path > 0 {
            if !FULL_IMAGE {
                return Err(Error::BlendingLeftOut);
            }
            let merging = if values.has(b'Q') { within(merging) } else { path };
            self.action.modal.path = PathControl::Within(PathTolerance { path, merging });
        }
        Ok(())
    }

    fn dwell(&mut self) -> Result<(), Error> {
        if self.line.non_modal != Some(NonModal::Dwell) {
            return Ok(());
        }
        if !self.unused.has(b'P') {
            return Err(Error::ValueWordMissing);
        }
        self.unused.remove(Letters::of(b"P"));
        self.action.dwell = Some(seconds(self.line.value(b'P')));
        Ok(())
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
        if self.unused.is_empty() || FULL_IMAGE && self.take_radius_register()? {
            return Ok(());
        }
        self.action.unused.fill(self.unused);
        Err(Error::UnusedWords)
    }

    /// Returns whether the line consists of an O number alone, or of a line number (N) and an O number.
    fn is_program_number(&self) -> bool {
        let mut others = self.unused;
        others.remove(Letters::of(b"N"));
        others == Letters::of(b"O") && self.line.groups == Groups::default() && !self.state.computed.assigns()
    }

    /// Sets [`Action::digit`], the value of the last decimal place of the axis words.
    #[inline(always)]
    fn precision(&mut self) {
        let action = &mut *self.action;
        // The points of a cycle and the curve of a spline count as exact, not as rounded to the last decimal place.
        let exact =
            matches!(action.motion, MotionCommand::Cycle(_) | MotionCommand::Spline(_) | MotionCommand::Nurbs(_));
        action.digit = if exact { 0.0 } else { last_digit(action.modal.units, self.line.places) };
        if FULL_IMAGE && let Some(scaling) = self.scaled {
            action.digit *= scaling.least();
        }
    }

    /// Completes the action: sets `flow`, `uses_machine_place` and `work_offset_changed`. M2 and M30 also reset modal
    /// state, rotation and scaling.
    fn finish(self) {
        let action = self.action;
        action.flow = match self.line.flow {
            Some(MWord::Pause) => Flow::Pause,
            Some(MWord::OptionalPause) => Flow::OptionalPause,
            Some(MWord::End) => Flow::End,
            _ => Flow::None,
        };
        action.uses_machine_place = matches!(
            self.line.non_modal,
            Some(NonModal::MachineCoordinates | NonModal::Go(_) | NonModal::StorePosition(_))
        );
        if action.flow == Flow::End {
            action.modal.end_program();
            action.rotated.rotation = Some(None);
            action.rotated.scaled.scaling = Some(None);
        }
        let (before, after) = (self.state.modal.coordinate_system, action.modal.coordinate_system);
        let system_changed = match (action.store, &action.stored) {
            (Some(StoredOffset::System(system)), Some(value)) if system == after => {
                let angle = self.state.offsets.angle(system);
                *value != self.state.offsets.system(system) || action.rotated.angle.is_some_and(|new| new != angle)
            }
            _ => false,
        };
        action.work_offset_changed = system_changed
            || before != after
            || action.g92 != self.state.offsets.g92
            || action.tool_length != self.state.offsets.tool_length;
    }
}

/// Returns the value in mm of the last of `places` decimal places: 0.001 for three places in mm. The limits of
/// [`Action::digit`] apply.
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
