//! M6: the program waits until somebody has put the tool into the spindle.

use super::Controller;
use super::task::Stage;
use crate::gcode::EXTENDED;
use crate::machine::state::Mode;
use crate::messages::SpindleDirection;
use crate::protocol::report;
use crate::settings::Key;

impl<const N: usize, const BLOCKS: usize> Controller<N, BLOCKS> {
    /// Whether M6 stops (`$918`).
    pub(super) fn prompts_for_tools(&self) -> bool {
        EXTENDED && self.settings.whole(Key::ToolChange) == 1
    }

    /// At rest before the rest of the line: if it asks for another tool, the spindle stops and the program waits for `~`.
    #[inline(never)]
    pub(super) fn begin_tool_change(&mut self) -> Stage {
        if !(self.line.checked.tool_change && self.prompts_for_tools()) {
            return Stage::Apply;
        }
        self.line.checked.spindle_stopped_for_tool();
        self.accessories.stop_spindle();
        self.interpreter.set_accessories(SpindleDirection::Off, self.accessories.coolant());
        self.replies.overrides_changed();
        let tool = self.line.checked.spindle_tool();
        self.say(|out| report::message_number(out, "Tool change T", tool));
        self.mode = Mode::Hold;
        Stage::ToolChange
    }
}
