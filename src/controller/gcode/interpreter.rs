//! The interpreter: what a program has set so far, against which each line is checked.

use super::check::{self, Checked, Purpose};
use super::modal::Modal;
use super::offsets::Offsets;
use super::parse::Parsed;
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
}

impl<const N: usize> Default for Interpreter<N> {
    fn default() -> Self {
        Self::new()
    }
}

impl<const N: usize> Interpreter<N> {
    /// The state after power-up of a new machine.
    pub const fn new() -> Self {
        Self { modal: Modal::INITIAL, offsets: Offsets::new(), position: PerAxis::all(Coordinate::ZERO) }
    }

    /// What a reset forgets: modal state, G92 and tool length offset. Stored offsets and the position stay.
    pub fn reset(&mut self) {
        self.modal = Modal::INITIAL;
        self.offsets.g92 = PerAxis::all(Coordinate::ZERO);
        self.offsets.tool_length = Coordinate::ZERO;
    }

    /// Checks a line of a program. `line` is filtered: capital letters, no blanks, no comments.
    pub fn check(&self, line: &[u8], dialect: Dialect) -> Result<Checked<N>, Error> {
        let mut checked = Checked::NOTHING;
        self.check_into(line, dialect, &mut checked)?;
        Ok(checked)
    }

    /// The same, with the result in its place; it is worth nothing after an error.
    pub fn check_into(&self, line: &[u8], dialect: Dialect, checked: &mut Checked<N>) -> Result<(), Error> {
        let mut parsed = Parsed::empty();
        parsed.read(line, dialect)?;
        check::check(self, &parsed, dialect, Purpose::Program, checked)
    }

    /// Checks what stands behind `$J=`. The motion of the result is a jog; of the state its commit changes the position
    /// only.
    pub fn check_jog(&self, line: &[u8], dialect: Dialect) -> Result<Checked<N>, Error> {
        let mut checked = Checked::NOTHING;
        self.check_jog_into(line, dialect, &mut checked)?;
        Ok(checked)
    }

    /// The same, with the result in its place; it is worth nothing after an error.
    pub fn check_jog_into(&self, line: &[u8], dialect: Dialect, checked: &mut Checked<N>) -> Result<(), Error> {
        jog::check(self, line, dialect, checked)
    }

    /// Takes over what a line has changed. The position becomes the end of the line's motion; a probing move that ends
    /// elsewhere is followed by [`Interpreter::set_position`].
    pub fn commit(&mut self, checked: &Checked<N>) {
        self.modal = checked.modal;
        self.offsets.g92 = checked.g92;
        self.offsets.tool_length = checked.tool_length;
        if let (Some(which), Some(value)) = (checked.store, checked.stored) {
            self.offsets.set_stored(which, value);
        }
        self.position = checked.position;
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

    /// Spindle and coolant as the machine has them, where not the program but the operator or a stop has switched them.
    pub fn set_accessories(&mut self, spindle: SpindleDirection, coolant: Coolant) {
        self.modal.spindle = spindle;
        self.modal.coolant = coolant;
    }

    /// All offsets.
    pub fn offsets(&self) -> &Offsets<N> {
        &self.offsets
    }

    /// All offsets, to restore stored ones and to clear them.
    pub fn offsets_mut(&mut self) -> &mut Offsets<N> {
        &mut self.offsets
    }

    /// What lies between machine and work position now: active coordinate system + G92 + tool length offset.
    pub fn work_offset(&self) -> PerAxis<Coordinate, N> {
        self.offsets.total(self.modal.coordinate_system)
    }
}
