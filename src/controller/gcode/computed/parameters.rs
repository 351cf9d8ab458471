//! Parameters that a program sets, in a fixed number of bytes. The values in force come first. After them come the
//! values that the line being checked assigns; they take effect when the line is committed. A local parameter belongs
//! to a subroutine call and is forgotten when the call ends.
//!
//! ```text
//!  cells   | length of key | call level | key: a number in two bytes, or a name | mantissa, 8 bytes | exponent | ...
//!          |<--------- in force: CAPACITY at most ---------->|<-- set by the line being checked -->|
//! ```
//! A parameter with a number takes 13 bytes, a parameter with a name 11 bytes and the length of the name. A parameter
//! that has never been set takes no memory. Expressions use the values in force, without the assignments of their own
//! line. [`Parameters::commit`] puts the assignments into force; the check of the next line drops assignments that were
//! not committed.

use super::expression::ParameterReference;
use super::real::Real;
use crate::error::Error;
use crate::lent::Lent;

/// Maximum size of the parameters in force, in bytes: 315 numbered parameters, or 132 with names of twenty letters.
const CAPACITY: usize = 4096;
/// Maximum size of the parameters that one line may set, in bytes: 19 numbered parameters.
const OF_A_LINE: usize = 256;
/// Maximum length of a parameter's name, in bytes.
pub(super) const NAME_LENGTH: usize = 32;
/// Size in bytes of the two fields before the key of a cell: the length of the key, and the level of the call to which
/// the parameter belongs.
const HEAD: usize = 2;
/// Size of the part of a cell after its key, in bytes: the parameter's value (mantissa and exponent).
const TAIL: usize = 9;
/// Level stored in the cell of a global parameter. The cell of a local parameter has the level of its call.
const GLOBAL: u8 = u8::MAX;
/// Highest number of a local parameter.
const LOCAL_END: i64 = 30;

/// Highest number of a parameter.
const NUMBER_MAX: i64 = 5999;

/// The key of a parameter in its cell: two bytes of a number, or a name.
type Key = heapless::Vec<u8, NAME_LENGTH>;

/// Memory of all parameters: one cell for each value in force, then one for each value that the line being checked
/// assigns.
pub(super) type Cells = heapless::Vec<u8, { CAPACITY + OF_A_LINE }>;

/// The numbered and named parameters that programs have set. (Parameters that show the machine's state are in
/// `machine_values`.)
#[cfg_attr(feature = "alloc", derive(Clone))]
#[derive(Debug, PartialEq)]
pub(super) struct Parameters {
    cells: Lent<Cells>,
    /// Number of bytes of `cells` with values in force. The bytes after them hold the assignments of the line being
    /// checked.
    in_force: usize,
    /// Number of bytes by which `in_force` grows when the line is committed.
    growth: usize,
    /// Number of active calls.
    level: u8,
}

/// A parameter's value as stored in a cell, with the parameter's number or name (`key`) and the level of its call.
struct Cell<'a> {
    level: u8,
    key: &'a [u8],
    size: usize,
    value: Real,
}

impl<'a> Cell<'a> {
    /// Decodes the cell at the start of `cells`; `None` after the last cell.
    fn first(cells: &'a [u8]) -> Option<Cell<'a>> {
        let [length, level, rest @ ..] = cells else { return None };
        let (key, rest) = rest.split_at_checked(usize::from(*length))?;
        let (mantissa, rest) = rest.split_first_chunk::<8>()?;
        let exponent = *rest.first()? as i8;
        let value = Real::from_parts(i64::from_le_bytes(*mantissa), exponent);
        Some(Cell { level: *level, key, size: HEAD + key.len() + TAIL, value })
    }
}

impl Parameters {
    pub fn new(cells: Lent<Cells>) -> Self {
        Self { cells, in_force: 0, growth: 0, level: 0 }
    }

    /// Returns the value in force of a parameter; `None` if it is not set. Ignores assignments that are not committed
    /// yet.
    pub fn get(&self, reference: ParameterReference) -> Result<Option<Real>, Error> {
        let (key, level) = self.stored_as(reference)?;
        let at = find_cell(self.cells.get(..self.in_force).unwrap_or(&[]), &key, level);
        Ok(at.and_then(|at| Cell::first(self.cells.get(at..)?)).map(|cell| cell.value))
    }

    /// Returns the value that a parameter has after the commit of the line being checked; `None` if it is not set.
    pub fn get_staged(&self, reference: ParameterReference) -> Result<Option<Real>, Error> {
        let (key, level) = self.stored_as(reference)?;
        let mut latest = None;
        let mut at = 0;
        while let Some(cell) = self.cells.get(at..).and_then(Cell::first) {
            if cell.key == key && cell.level == level {
                latest = Some(cell.value);
            }
            at += cell.size;
        }
        Ok(latest)
    }

    /// Stores an assignment, which takes effect when the line is committed.
    pub fn stage(&mut self, reference: ParameterReference, value: Real) -> Result<(), Error> {
        let (key, level) = self.stored_as(reference)?;
        let size = HEAD + key.len() + TAIL;
        if find_cell(&self.cells, &key, level).is_none() {
            self.growth += size;
        }
        if self.in_force + self.growth > CAPACITY || self.cells.len() + size > self.in_force + OF_A_LINE {
            return Err(Error::OutOfMemory);
        }
        let (mantissa, exponent) = value.parts();
        let parts: [&[u8]; 4] = [&[key.len() as u8, level], &key, &mantissa.to_le_bytes(), &exponent.to_le_bytes()];
        for part in parts {
            self.cells.extend_from_slice(part).map_err(|_| Error::OutOfMemory)?;
        }
        Ok(())
    }

    /// Returns whether the line being checked assigns a parameter.
    pub fn has_staged(&self) -> bool {
        self.cells.len() > self.in_force
    }

    /// Drops the assignments of a line that was not committed.
    pub fn drop_staged(&mut self) {
        self.cells.truncate(self.in_force);
        self.growth = 0;
    }

    /// Puts the assignments of the line being checked into force, from left to right.
    #[inline]
    pub fn commit(&mut self) {
        if self.has_staged() {
            self.commit_staged();
        }
        self.growth = 0;
    }

    #[inline(never)]
    fn commit_staged(&mut self) {
        while let Some((in_force, staged)) = self.cells.split_at_mut_checked(self.in_force)
            && let Some(cell) = Cell::first(staged)
        {
            let size = cell.size;
            match find_cell(in_force, cell.key, cell.level) {
                Some(at) => {
                    if let (Some(old), Some(new)) = (in_force.get_mut(at..at + size), staged.get(..size)) {
                        old.copy_from_slice(new);
                    }
                    self.cut_cell(self.in_force, size);
                }
                None => self.in_force += size,
            }
        }
    }

    pub fn is_empty(&self) -> bool {
        self.in_force == 0
    }

    pub fn reset(&mut self) {
        self.cells.clear();
        (self.in_force, self.growth, self.level) = (0, 0, 0);
    }

    /// Ends the program: forgets its local parameters. #31 and above, and names that begin with `_`, remain.
    pub fn end_program(&mut self) {
        self.drop_staged();
        self.level = 0;
        self.forget_locals();
    }

    /// Begins a call. `arguments`: number and value of each local parameter that is set at the start of the call.
    pub fn enter_call(&mut self, arguments: &[(u8, Real)]) -> Result<(), Error> {
        self.level += 1;
        for (number, value) in arguments {
            self.drop_staged();
            self.stage(ParameterReference::Number((*number).into()), *value)?;
            self.commit();
        }
        Ok(())
    }

    /// Ends the innermost call: forgets its local parameters.
    pub fn leave_call(&mut self) {
        self.drop_staged();
        self.forget_locals();
        self.level = self.level.saturating_sub(1);
    }

    pub fn leave_calls(&mut self) {
        while self.level > 0 {
            self.leave_call();
        }
    }

    /// Returns the number of active calls.
    pub fn level(&self) -> u8 {
        self.level
    }

    /// Forgets the local parameters of the present call, and of deeper calls.
    fn forget_locals(&mut self) {
        let mut at = 0;
        while let Some(cell) = self.cells.get(at..).and_then(Cell::first) {
            let (level, size) = (cell.level, cell.size);
            if level != GLOBAL && level >= self.level {
                self.cut_cell(at, size);
            } else {
                at += size;
            }
        }
        self.in_force = self.cells.len();
    }

    fn cut_cell(&mut self, at: usize, size: usize) {
        let length = self.cells.len();
        if at + size <= length {
            self.cells.copy_within(at + size.., at);
            self.cells.truncate(length - size);
        }
    }

    /// Returns the key and the level under which a parameter is stored, or an error for an invalid number or name.
    fn stored_as(&self, reference: ParameterReference) -> Result<(Key, u8), Error> {
        match reference {
            ParameterReference::Number(number) if (1..=NUMBER_MAX).contains(&number) => {
                // The first byte of a number's key is at most 23. Names begin with a printable character, so no name
                // has the same key.
                let key = Key::from_slice(&(number as u16).to_be_bytes()).unwrap_or_default();
                Ok((key, if number <= LOCAL_END { self.level } else { GLOBAL }))
            }
            ParameterReference::Number(_) => Err(Error::InvalidArgument),
            ParameterReference::Name(name) => {
                let key = Key::from_slice(name).map_err(|_| Error::InvalidArgument)?;
                Ok((key, if name.starts_with(b"_") { GLOBAL } else { self.level }))
            }
        }
    }
}

fn find_cell(cells: &[u8], key: &[u8], level: u8) -> Option<usize> {
    let mut at = 0;
    while let Some(cell) = cells.get(at..).and_then(Cell::first) {
        if cell.key == key && cell.level == level {
            return Some(at);
        }
        at += cell.size;
    }
    None
}
