//! Tools: T selects a tool, M6 changes the tool, and M61 names the tool that is in the spindle. G43 to G49 set the
//! tool length offset, from the tool table or from axis words. G10 L1, L10 and L11 set an entry of the table, or
//! remove one.

use super::draft::Draft;
use crate::axes::{AxisMask, PerAxis};
use crate::error::Error;
use crate::gcode::Dialect;
use crate::gcode::action::Notice;
use crate::gcode::modal::CoordinateSystem;
use crate::gcode::offsets::{StoredOffset, TOOL_AXIS};
use crate::gcode::parse::TOOL_MAX;
use crate::gcode::tools::entry_number;
use crate::gcode::values::{along, whole};
use crate::gcode::word::{Claim, Letters, NonModal, ToolLength};
use crate::units::{Coordinate, Decimal};

impl<const N: usize> Draft<'_, N> {
    /// Executes T, M6 and M61. T selects a tool, M6 puts the selected tool into the spindle.
    pub(super) fn tool(&mut self) -> Result<(), Error> {
        let modal = &mut self.action.modal;
        if self.line.values.has(b'T') {
            let number = match self.dialect {
                Dialect::Grbl => self.line.value(b'T').truncate(),
                _ => whole(self.line.value(b'T'))?,
            };
            modal.tool = number.unsigned_abs();
        } else if self.dialect == Dialect::Grbl {
            modal.tool = 0;
        }
        self.action.after.spindle_word = self.line.spindle.is_some();
        if self.line.extended.tool_change {
            self.action.tool_change = modal.tool != self.state.spindle_tool;
            self.action.after.spindle_tool = modal.tool;
            // G28.1 and G30.1 store the present position, but a tool change moves away from it. So an M6 with one of
            // them does not count as alone on its line.
            let stores = matches!(self.line.non_modal, Some(NonModal::StorePosition(_)));
            self.action.after.tool_alone = self.claim == Claim::Nobody && self.line.tool_length.is_none() && !stores;
        }
        if self.line.extended.tool_number {
            return self.name_tool();
        }
        Ok(())
    }

    /// Executes M61: Q is the number of the tool that is in the spindle. Without a T on the line, this tool is also
    /// the selected one.
    fn name_tool(&mut self) -> Result<(), Error> {
        if !self.take(b'Q') {
            return Err(Error::ValueWordMissing);
        }
        let number = self.line.value(b'Q');
        if number < Decimal::ZERO {
            return Err(Error::NegativeValue);
        }
        if number > Decimal::from_int(TOOL_MAX) {
            return Err(Error::ToolNumberTooHigh);
        }
        let number = whole(number)?.unsigned_abs();
        self.action.after.spindle_tool = number;
        if !self.line.values.has(b'T') {
            self.action.modal.tool = number;
        }
        Ok(())
    }

    /// Executes G43 to G49 (modal group 8): sets the tool length offset, which affects moves from this line on.
    pub(super) fn tool_length(&mut self) -> Result<(), Error> {
        let Some(word) = self.line.tool_length else { return Ok(()) };
        let offset = match word {
            ToolLength::Cancel => PerAxis::all(Coordinate::ZERO),
            ToolLength::Dynamic => {
                let along_tool = self.dialect != Dialect::Grbl || self.line.axes == AxisMask::NONE.with(TOOL_AXIS);
                if self.line.axes.is_empty() || !along_tool {
                    return Err(Error::ToolLengthAxis);
                }
                self.with_axis_words(self.action.tool_length, |_, value| value)
            }
            ToolLength::FromTable => self.tool_of_h()?,
            ToolLength::Add if !self.line.values.has(b'H') => return Err(Error::ValueWordMissing),
            ToolLength::Add => self.tool_of_h()?.zip(&self.action.tool_length, |more, present| more + present),
        };
        self.action.tool_length = offset;
        self.allow_offset(&offset)
    }

    /// Returns the offset of tool H. Without H or with H0, returns the offset of the tool in the spindle.
    fn tool_of_h(&mut self) -> Result<PerAxis<Coordinate, N>, Error> {
        let number = if self.take(b'H') { whole(self.line.value(b'H'))?.unsigned_abs() } else { 0 };
        let number = if number == 0 { self.action.after.spindle_tool } else { number };
        let measured = self.state.measured_offset(number);
        let known = measured.or_else(|| self.state.tools.offset(number));
        // If no length of any tool is known, the program does not use the tool table, and G43 sets the offset 0.
        if known.is_none() && self.state.knows_no_length() {
            self.action.after.notice = Some(Notice::NoTools);
            return Ok(PerAxis::all(Coordinate::ZERO));
        }
        known.ok_or(Error::UnknownTool)
    }

    /// Executes G10 L1, L10 and L11: sets the offset of tool P in the table, for the next G43. L1 without axis words
    /// removes the tool, unless the line has I, J, Q or R.
    pub(super) fn set_tool(&mut self, l: i32) -> Result<(), Error> {
        let number = whole(self.line.value(b'P'))?.unsigned_abs();
        if !self.line.values.has(b'P') {
            return Err(Error::ValueWordMissing);
        }
        if self.line.value(b'P') > Decimal::from_int(TOOL_MAX) {
            return Err(Error::ToolNumberTooHigh);
        }
        let known = self.state.tools.offset(number);
        let has_room = self.state.tools.slot(entry_number(number, self.state.is_checking())).is_some();
        // I, J, Q and R give angles, orientation and radius of the tool. The table has no room for them, unlike
        // LinuxCNC's, so these words are ignored.
        let unkept = Letters::of(b"IJQR");
        let describes = l == 1 && self.unused.has_any(unkept);
        if l == 1 {
            self.unused.remove(unkept);
        }
        let removes = self.line.axes.is_empty();
        if number == 0 || removes && known.is_none() || !removes && !has_room {
            return Err(Error::UnknownTool);
        }
        self.unused.remove(Letters::of(b"LP"));
        if removes && describes {
            return Ok(());
        }
        let offsets = &self.state.offsets;
        // The machine position at which the tip of the tool has the coordinate 0. For L10 this is the origin of the
        // active system with the G92 offset. For L11 it is the origin of G59.3, the system of a fixture, without G92.
        let origin = if l == 11 {
            offsets.system(CoordinateSystem::G59_3)
        } else {
            offsets.system(self.action.modal.coordinate_system).zip(&offsets.g92, |origin, g92| origin + g92)
        };
        self.action.store = Some(StoredOffset::Tool(number));
        if removes {
            return Ok(());
        }
        let present = known.unwrap_or(PerAxis::all(Coordinate::ZERO));
        if l != 1 {
            self.needs_no_scaling()?;
        }
        if l != 1 && self.sets_rotated_tool(l, &present)? {
            return Ok(());
        }
        self.action.stored = Some(self.with_axis_words(present, |axis, value| {
            if l == 1 { value } else { self.position(axis) - along(&origin, axis) - value }
        }));
        Ok(())
    }
}
