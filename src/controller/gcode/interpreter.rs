//! Checks and commits lines. `check` turns a line into an [`Action`] and changes nothing; `commit` applies the changes
//! of the line: modal state, offsets, rotation, saved states. This file also has the reset, check mode, and the change
//! of the dialect.

use super::action::{Action, Flow, Keeping, MotionCommand};
use super::check::{self, Purpose};
use super::modal::{Modal, MotionMode, SplineKind};
use super::offsets::{StoredOffset, TOOL_AXIS};
use super::parse::Parsed;
use super::saved::Saved;
use super::scaling::NO_REST;
use super::state::{BeforeCheck, Interpreter, NO_TANGENT, ProgramPlace, Tangent};
use super::{Dialect, jog, tools};
use crate::axes::PerAxis;
use crate::error::Error;
use crate::image::FULL_IMAGE;
use crate::units::Coordinate;

impl<const N: usize> Interpreter<N> {
    /// Resets modal state, rotation, scaling, G92, tool length offset and parameters. Ends check mode; the next line
    /// begins a program. Keeps the stored offsets, the position, and the tool in the spindle with its measured length.
    /// Selects the tool in the spindle, so that M6 without T changes nothing.
    pub fn reset(&mut self) {
        self.modal = Modal::INITIAL;
        if let Some(before) = self.before_check.take() {
            self.spindle_tool = before.spindle_tool;
            self.offsets = before.offsets().unwrap_or(self.offsets);
            self.tools.end_check();
        }
        self.offsets.g92 = PerAxis::all(Coordinate::ZERO);
        self.offsets.g92_kept = PerAxis::all(Coordinate::ZERO);
        self.offsets.g92_acts = false;
        self.saved.clear();
        self.rotation = None;
        self.scaling = None;
        self.rest = NO_REST;
        self.tangent = NO_TANGENT;
        self.names_radius = false;
        self.begin_program();
        self.modal.tool = self.spindle_tool;
        self.offsets.tool_length = PerAxis::all(Coordinate::ZERO);
        self.measured.assumed = false;
        if let Some(length) = self.measured.offset() {
            self.offsets.tool_length.set(TOOL_AXIS, length);
        }
        self.computed.reset();
    }

    /// Starts check mode: programs are checked and not executed. M6 does not put a tool into the spindle, and the
    /// changes that programs make to tools, coordinate systems, stored positions and offsets are undone at the end of
    /// check mode. In Grbl's dialect, and in a build without expressions, only the changes to tools are undone.
    pub fn begin_check_mode(&mut self, dialect: Dialect) {
        self.before_check = Some(BeforeCheck {
            spindle_tool: self.spindle_tool,
            modal: self.modal,
            offsets: [(dialect != Dialect::Grbl).then_some(self.offsets); FULL_IMAGE as usize],
        });
    }

    /// Ends check mode: resets the interpreter, and then restores all offsets from before check mode, with G92 and the
    /// tool length offset. In Grbl's dialect and in a build without expressions, restores no offsets: G92 and the tool
    /// length offset are those of the reset, and the stored offsets stay as the checked programs have set them.
    pub fn end_check_mode(&mut self) {
        let before = self.before_check.as_ref().and_then(BeforeCheck::offsets);
        self.reset();
        self.offsets = before.unwrap_or(self.offsets);
    }

    /// Prepares for another dialect, which may lack the words that end some modal states of this dialect. Ends these
    /// modal states, abandons the present program, and drops saved states and the measured length of the tool.
    pub fn change_dialect(&mut self) {
        self.end_cycles();
        if matches!(self.modal.motion, MotionMode::Spline(_)) {
            self.modal.motion = MotionMode::Cancelled;
        }
        self.saved.clear();
        self.tangent = NO_TANGENT;
        self.modal.forget_extended();
        self.modal.tool = self.spindle_tool;
        self.measured.forget_tool();
        self.abandon_program();
        self.begin_program();
    }

    /// Checks a line of a program. `line` is filtered: capital letters, no blanks, no comments. Assignments to
    /// parameters are evaluated and then discarded; [`Self::commit`] does not make them.
    #[cfg(feature = "alloc")]
    pub fn check(&self, line: &[u8], dialect: Dialect) -> Result<Action<N>, Error> {
        let mut action = Action::NOTHING;
        self.clone().check_into(line, dialect, &mut action)?;
        Ok(action)
    }

    /// Checks a line like `check`, and writes the result to `action`, which is not valid after an error. Assignments to
    /// parameters take effect when the line is committed; without a commit, the next check discards them.
    #[inline]
    pub fn check_into(&mut self, line: &[u8], dialect: Dialect, action: &mut Action<N>) -> Result<(), Error> {
        let mut parsed = Parsed::empty();
        self.computed.begin();
        parsed.read(line, dialect, self)?;
        check::check(self, &parsed, dialect, Purpose::Program, action)
    }

    /// Checks a jog: the text after `$J=`. Committing the result changes only the position.
    #[cfg(feature = "alloc")]
    pub fn check_jog(&self, line: &[u8], dialect: Dialect) -> Result<Action<N>, Error> {
        let mut action = Action::NOTHING;
        self.clone().check_jog_into(line, dialect, &mut action)?;
        Ok(action)
    }

    /// Checks a jog like `check_jog`, and writes the result to `action`, which is not valid after an error.
    pub fn check_jog_into(&mut self, line: &[u8], dialect: Dialect, action: &mut Action<N>) -> Result<(), Error> {
        jog::check(self, line, dialect, action)
    }

    /// Applies the changes of a checked line. The position becomes the end of the line's motion; if a probing move ends
    /// elsewhere, call [`Interpreter::set_position`] afterwards.
    pub fn commit(&mut self, action: &Action<N>) {
        // The operator can have switched the coolant since the line was checked. So the present state of the coolant
        // stays, unless the line changes it.
        let coolant = self.modal.coolant;
        self.modal = action.modal;
        if action.coolant.is_none() && action.flow != Flow::End {
            self.modal.coolant = coolant;
        }
        if !action.moves_only() {
            self.commit_beside_motion(action);
        }
        self.rest = action.rotated.scaled.rest.unwrap_or(self.rest);
        if action.rotated.reached.is_some() {
            self.reached = action.rotated.reached;
        }
        self.position = action.position;
        self.computed.commit();
        if action.flow == Flow::End {
            self.saved.clear();
            self.tangent = NO_TANGENT;
            self.names_radius = false;
            self.computed.end_program();
            if !FULL_IMAGE || self.place == ProgramPlace::Program {
                self.place = ProgramPlace::End;
            }
        }
        self.remember_motion(action);
    }

    /// Applies the line's changes to offsets, tools, rotation, scaling and saved states.
    #[inline(never)]
    fn commit_beside_motion(&mut self, action: &Action<N>) {
        self.offsets.g92 = action.g92;
        self.offsets.g92_acts = action.after.g92_acts;
        if action.after.keeps_g92 {
            self.offsets.g92_kept = action.g92;
        }
        if !matches!(action.after.keeping, Keeping::Leave) {
            self.keep_state(action);
        }
        self.offsets.tool_length = action.tool_length;
        if let (Some(which), Some(value)) = (action.store, action.stored) {
            self.set_stored(which, value);
        }
        if let (Some(StoredOffset::System(system)), Some(angle)) = (action.store, action.rotated.angle) {
            self.offsets.set_angle(system, angle);
        }
        if let Some(rotation) = action.rotated.rotation {
            self.rotation = rotation;
        }
        if let Some(scaling) = action.rotated.scaled.scaling {
            self.scaling = scaling;
        }
        if let Some(number) = action.removes_tool() {
            self.tools.remove(tools::entry_number(number, self.is_checking()));
        }
        if action.after.spindle_tool != self.spindle_tool && !self.is_checking() {
            self.measured.forget_tool();
        }
        self.spindle_tool = action.after.spindle_tool;
        self.names_radius = action.after.names_radius.unwrap_or(self.names_radius);
    }

    /// Executes M70 to M73, and adds the control points of G5.2.
    #[inline(never)]
    fn keep_state(&mut self, action: &Action<N>) {
        let level = self.computed.level();
        match action.after.keeping {
            Keeping::Leave => {}
            Keeping::Save { until_return } => self.saved.save(Saved {
                modal: action.modal,
                tool_length: action.tool_length,
                g92_acts: action.after.g92_acts,
                spindle_tool: self.spindle_tool,
                is_measured_anew: false,
                level,
                until_return,
                is_forgotten: false,
            }),
            Keeping::Forget => self.saved.forget(level),
            Keeping::Restore => self.saved.abandon(level),
            Keeping::Add(additions) => {
                self.control_points.iter_mut().zip(&additions).for_each(|(points, addition)| points.add(addition));
            }
        }
    }

    /// Stores what the next line may need: the tangent at the end of a spline, or the words of a cycle.
    #[inline]
    fn remember_motion(&mut self, action: &Action<N>) {
        match &action.motion {
            MotionCommand::Spline(spline)
                if FULL_IMAGE && action.modal.motion == MotionMode::Spline(SplineKind::Cubic) =>
            {
                self.tangent.fill(Some(Tangent::behind(&spline.target, spline.arriving)));
            }
            MotionCommand::Cycle(cycle) => self.cycle = cycle.words,
            _ => {}
        }
    }
}
