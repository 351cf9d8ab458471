//! The fields that only status reports with `$900=3` have, as in grblHAL.

use crate::dispatch::Controller;
use crate::messages::SpindleDirection;
use crate::protocol::status_report::GrblHalFields;
use crate::settings::Key;
use crate::states::State;
use crate::work::task::{Stage, Task};

/// Number of grblHAL's alarm "homing required". Only reports with all fields (0x87) show the number of an alarm.
const HOMING_REQUIRED: u8 = 11;

impl<const N: usize> Controller<N> {
    /// Returns whether a tool change (M6) waits for the operator.
    pub(crate) fn waits_for_tool(&mut self) -> bool {
        let Task::Job(job) = self.task else { return false };
        matches!(self.state, State::Hold(_))
            && match job.stage {
                Stage::ToolChange => true,
                Stage::Measuring => self.line.change().waits_for().is_some(),
                _ => false,
            }
    }

    /// Returns the fields that only status reports with `$900=3` have. `full`: `true` if the host has requested all
    /// fields (0x87).
    pub(crate) fn grblhal_fields(&mut self, full: bool, spindle: SpindleDirection) -> GrblHalFields {
        let is_homing_on = self.m.settings.is_on(Key::Homing);
        let reference = self.m.reference;
        let alarm = match self.state {
            State::Alarm(None) if is_homing_on && !reference.is_trusted() => HOMING_REQUIRED,
            _ => self.state.alarm().map_or(0, |alarm| alarm.code()),
        };
        GrblHalFields {
            full,
            alarm,
            system: self.m.interpreter.modal().coordinate_system.word(),
            tool: self.m.interpreter.spindle_tool(),
            homed: is_homing_on.then_some((reference.is_trusted(), reference.homed_axes().0)),
            scaled: self.m.interpreter.scaling().is_some(),
            shows_scaling: false,
            has_reference: self.m.interpreter.tool_reference().is_some(),
            waits_for_tool: self.waits_for_tool(),
            spindle,
            coolant: self.m.accessories.coolant(),
        }
    }
}
