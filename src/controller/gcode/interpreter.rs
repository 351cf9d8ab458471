//! The interpreter: what a program has set so far, against which each line is checked.

use super::check::{self, Checked, Flow, Motion, Purpose};
use super::computed::Computed;
use super::cycle::CycleWords;
use super::modal::{EXTENDED, Modal, MotionMode};
use super::offsets::{Offsets, StoredOffset};
use super::parse::Parsed;
use super::state_words::{Keeping, Saved};
use super::tools::{self, Tool, ToolTable};
use super::{Dialect, jog};
use crate::axes::PerAxis;
use crate::error::Error;
use crate::messages::{Coolant, SpindleDirection};
use crate::units::Coordinate;

/// Modal state, offsets and the position at the end of all lines that were committed.
#[derive(Clone, Debug, PartialEq)]
pub struct Interpreter<const N: usize> {
    pub(super) modal: Modal,
    pub(super) offsets: Offsets<N>,
    pub(super) position: PerAxis<Coordinate, N>,
    /// Of the latest canned cycle.
    pub(super) cycle: CycleWords,
    pub(super) tools: ToolTable<N>,
    /// What M6 has put there; 0 for none.
    pub(super) spindle_tool: u32,
    /// While a program is only checked: what the machine has meanwhile.
    before_check: Option<BeforeCheck>,
    pub(super) computed: Computed<N>,
    /// M70.
    pub(super) saved: Option<Saved<N>>,
}

/// What check mode leaves to the machine.
#[derive(Clone, Debug, PartialEq)]
struct BeforeCheck {
    spindle_tool: u32,
    modal: Modal,
}

impl<const N: usize> Default for Interpreter<N> {
    fn default() -> Self {
        Self::new()
    }
}

impl<const N: usize> Interpreter<N> {
    /// The state after power-up of a new machine.
    pub const fn new() -> Self {
        Self {
            modal: Modal::INITIAL,
            offsets: Offsets::new(),
            position: PerAxis::all(Coordinate::ZERO),
            cycle: CycleWords::NONE,
            tools: ToolTable::EMPTY,
            spindle_tool: 0,
            before_check: None,
            computed: Computed::new(),
            saved: None,
        }
    }

    /// What a reset forgets: modal state, G92, tool length offset and parameters. Stored offsets, the tool in the spindle and the
    /// position stay; that tool is the selected one, so that M6 without T changes nothing.
    pub fn reset(&mut self) {
        self.modal = Modal::INITIAL;
        self.offsets.g92 = PerAxis::all(Coordinate::ZERO);
        self.offsets.g92_kept = PerAxis::all(Coordinate::ZERO);
        self.offsets.g92_acts = false;
        self.saved = None;
        if let Some(before) = self.before_check.take() {
            self.spindle_tool = before.spindle_tool;
            self.tools.end_check();
        }
        self.modal.tool = self.spindle_tool;
        self.offsets.tool_length = PerAxis::all(Coordinate::ZERO);
        self.computed.reset();
    }

    /// From here to the next reset programs are only checked: a tool that M6 calls for does not come into the spindle, and
    /// what they set in the table of tools is forgotten.
    pub fn begin_check_mode(&mut self) {
        self.before_check = Some(BeforeCheck { spindle_tool: self.spindle_tool, modal: self.modal });
    }

    /// Whether programs are only checked.
    pub(super) fn is_checking(&self) -> bool {
        self.before_check.is_some()
    }

    /// Ends a series of canned cycles as G80 does: the machine has another position for the same place, and the level that
    /// G98 leads back to would be a wrong one.
    pub fn end_cycles(&mut self) {
        if EXTENDED && matches!(self.modal.motion, MotionMode::Cycle(_)) {
            self.modal.motion = MotionMode::Cancelled;
        }
    }

    /// Another dialect: what stays in force by words that it may not have, and so could not end, is ended.
    pub fn change_dialect(&mut self) {
        self.end_cycles();
        self.saved = None;
        self.modal.forget_extended();
        self.modal.tool = self.spindle_tool;
        self.abandon_program();
    }

    /// Checks a line of a program. `line` is filtered: capital letters, no blanks, no comments. Parameters that the line
    /// sets are read, and not kept for a commit.
    pub fn check(&self, line: &[u8], dialect: Dialect) -> Result<Checked<N>, Error> {
        let mut checked = Checked::NOTHING;
        self.clone().check_into(line, dialect, &mut checked)?;
        Ok(checked)
    }

    /// The same, with the result in its place; it is worth nothing after an error. Parameters that the line sets wait for
    /// its commit, or for the next check, which forgets them.
    pub fn check_into(&mut self, line: &[u8], dialect: Dialect, checked: &mut Checked<N>) -> Result<(), Error> {
        let mut parsed = Parsed::empty();
        self.computed.begin();
        parsed.read(line, dialect, self)?;
        check::check(self, &parsed, dialect, Purpose::Program, checked)
    }

    /// Checks what follows `$J=`. The motion of the result is a jog; of the state its commit changes the position
    /// only.
    pub fn check_jog(&self, line: &[u8], dialect: Dialect) -> Result<Checked<N>, Error> {
        let mut checked = Checked::NOTHING;
        self.clone().check_jog_into(line, dialect, &mut checked)?;
        Ok(checked)
    }

    /// The same, with the result in its place; it is worth nothing after an error.
    pub fn check_jog_into(&mut self, line: &[u8], dialect: Dialect, checked: &mut Checked<N>) -> Result<(), Error> {
        jog::check(self, line, dialect, checked)
    }

    /// Takes over what a line has changed. The position becomes the end of the line's motion; a probing move that ends
    /// elsewhere is followed by [`Interpreter::set_position`].
    pub fn commit(&mut self, checked: &Checked<N>) {
        // The operator may have switched the coolant since the line was checked.
        let coolant = self.modal.coolant;
        self.modal = checked.modal;
        if checked.coolant.is_none() && checked.flow != Flow::End {
            self.modal.coolant = coolant;
        }
        self.offsets.g92 = checked.g92;
        self.offsets.g92_acts = checked.after.g92_acts;
        if checked.after.keeps_g92 {
            self.offsets.g92_kept = checked.g92;
        }
        match checked.after.keeping {
            Keeping::Leave => {}
            Keeping::Save => self.saved = Some(Saved::of(checked.modal, checked.tool_length, checked.after.g92_acts)),
            Keeping::Forget => self.saved = None,
        }
        self.offsets.tool_length = checked.tool_length;
        if let (Some(which), Some(value)) = (checked.store, checked.stored) {
            self.set_stored(which, value);
        }
        if let Some(number) = checked.removes_tool() {
            self.tools.remove(tools::entry_number(number, self.is_checking()));
        }
        self.spindle_tool = checked.after.spindle_tool;
        self.position = checked.position;
        self.computed.commit();
        if checked.flow == Flow::End {
            self.saved = None;
            self.computed.end_program();
        }
        if let Motion::Cycle(cycle) = &checked.motion {
            self.cycle = cycle.words;
        }
    }

    /// A stored place or tool gets a value.
    pub fn set_stored(&mut self, which: StoredOffset, value: PerAxis<Coordinate, N>) {
        match which {
            StoredOffset::Tool(number) => {
                let number = tools::entry_number(number, self.is_checking());
                if let Some(slot) = self.tools.slot(number) {
                    self.tools.put(slot, Tool { number, offset: value });
                }
            }
            which => self.offsets.set_stored(which, value),
        }
    }

    /// Sets every stored place to zero, and forgets the tools.
    pub fn clear_stored(&mut self) {
        self.offsets.clear_stored();
        self.tools = ToolTable::EMPTY;
    }

    /// The table of tools.
    pub fn tools(&self) -> &ToolTable<N> {
        &self.tools
    }

    /// The table of tools, to restore it.
    pub fn tools_mut(&mut self) -> &mut ToolTable<N> {
        &mut self.tools
    }

    /// The machine position the program believes in.
    pub fn position(&self) -> &PerAxis<Coordinate, N> {
        &self.position
    }

    /// Corrects the machine position: after a reset, a probing move, a cancelled jog, homing.
    pub fn set_position(&mut self, position: PerAxis<Coordinate, N>) {
        self.position = position;
    }

    /// What stays in force.
    pub fn modal(&self) -> &Modal {
        &self.modal
    }

    /// What is in force for the machine: while programs are only checked, what was in force before.
    pub fn acting_modal(&self) -> &Modal {
        self.before_check.as_ref().map_or(&self.modal, |before| &before.modal)
    }

    /// Spindle and coolant as the machine has them, where not the program but the operator or a stop has switched them.
    pub fn set_accessories(&mut self, spindle: SpindleDirection, coolant: Coolant) {
        self.modal.spindle = spindle;
        self.modal.coolant = coolant;
    }

    /// All offsets.
    pub fn offsets(&self) -> &Offsets<N> {
        &self.offsets
    }

    /// What lies between machine and work position now: active coordinate system + G92 + tool length offset.
    pub fn work_offset(&self) -> PerAxis<Coordinate, N> {
        self.offsets.total(self.modal.coordinate_system)
    }
}
