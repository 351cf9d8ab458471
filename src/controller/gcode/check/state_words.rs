//! M48 to M53 enable and disable the operator's overrides; M70 to M73 save and restore the modal state. The changes act
//! when the line is committed.

use super::draft::Draft;
use crate::error::Error;
use crate::gcode::action::Keeping;
use crate::gcode::modal::{Modal, OverridesHeld};
use crate::gcode::offsets::TOOL_AXIS;
use crate::gcode::word::{Groups, Letters};
use crate::units::Decimal;

impl<const N: usize> Draft<'_, N> {
    /// Executes M48 to M53. M48 enables the feed and spindle overrides of the operator, M49 disables them. M50 applies
    /// to the feed override alone, M51 to the spindle override alone: P1 or no P enables it, P0 disables it.
    pub(super) fn overrides(&mut self) -> Result<(), Error> {
        let Some(word) = self.line.extended.overrides else { return Ok(()) };
        let takes_p = matches!(word, 50..=53);
        let on = match takes_p && self.take(b'P') {
            false => word != 49,
            true if self.line.value(b'P') == Decimal::ZERO => false,
            true if self.line.value(b'P') == Decimal::from_int(1) => true,
            true => return Err(Error::ValueOutOfRange),
        };
        let held = &mut self.action.modal.overrides_held;
        match word {
            48 | 49 => *held = OverridesHeld { feed: !on, spindle: !on },
            50 => held.feed = !on,
            51 => held.spindle = !on,
            // M52 P1 is refused, because there is no input for an adaptive feed. M53 P0 is refused, because the hold
            // button always acts.
            _ if on == (word == 52) => return Err(Error::NotSupported),
            _ => {}
        }
        Ok(())
    }

    /// Checks M70 to M73, which must be alone on their line, except for a line number (N).
    pub(super) fn keep_state(&mut self) -> Result<(), Error> {
        let Some(word) = self.line.extended.keep else { return Ok(()) };
        let mut others = self.line.values;
        others.remove(Letters::of(b"N"));
        if !(others.is_empty() && self.line.groups.within(Groups::KEEP)) {
            return Err(Error::ModalGroupViolation);
        }
        let level = self.state.computed.level();
        match word {
            70 | 73 if !self.state.saved.has_room(level) => return Err(Error::TooDeep),
            70 | 73 => self.action.after.keeping = Keeping::Save { until_return: word == 73 && level > 0 },
            71 => self.action.after.keeping = Keeping::Forget,
            _ => {
                let saved = *self.state.saved.of(level).ok_or(Error::NothingSaved)?;
                self.action.after.keeping = Keeping::Restore;
                let before = &self.state.modal;
                let action = &mut *self.action;
                action.modal =
                    Modal { motion: before.motion, straight: before.straight, tool: before.tool, ..saved.modal };
                if saved.spindle_tool == self.state.spindle_tool && !saved.is_measured_anew {
                    action.tool_length = saved.tool_length;
                } else if let Some(measured) = self.state.measured_offset(self.state.spindle_tool) {
                    action.tool_length.set(TOOL_AXIS, measured.get(TOOL_AXIS).unwrap_or_default());
                }
                // M72 does not restore the value of G92, only whether this offset acts: it suspends the offset like
                // G92.2, or restores it like G92.3.
                if action.after.g92_acts != saved.g92_acts {
                    self.let_offset_act(saved.g92_acts);
                }
            }
        }
        Ok(())
    }
}
