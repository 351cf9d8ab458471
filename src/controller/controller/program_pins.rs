//! Outputs and inputs of programs (M62 to M68) are carried out.

use super::Controller;
use super::task::{Job, Stage};
use crate::gcode::ProgramPins;
use crate::machine::state::Mode;
use crate::units::Instant;

impl<const N: usize, const BLOCKS: usize> Controller<N, BLOCKS> {
    /// Whether the line asks for a pin that the board does not have. None has analog ones.
    pub(super) fn lacks_pin(&self) -> bool {
        let [outputs, inputs] = self.settings_lock.program_pins();
        match self.line.checked.pins {
            None => false,
            Some(ProgramPins::Digital { number, .. }) => number >= u32::from(outputs),
            Some(ProgramPins::Wait { number, .. }) => number >= u32::from(inputs),
            Some(ProgramPins::Analog { .. } | ProgramPins::ReadAnalog { .. }) => true,
        }
    }

    /// Whether the line can be carried out now: an output that changes with a motion may have to wait until those before it do.
    #[inline]
    pub(super) fn has_room_for_pins(&mut self) -> bool {
        match self.line.checked.pins {
            Some(ProgramPins::Digital { with_motion: true, .. }) => self.has_room_for_change(),
            _ => true,
        }
    }

    #[inline(never)]
    fn has_room_for_change(&mut self) -> bool {
        let idle = self.motion.is_idle();
        // The mark stays: whether it can be changed is asked.
        let can = self.accessories.digital().has_room(idle) && self.motion.takes_mark();
        if !can {
            self.start_queued();
        }
        can
    }

    /// M62 to M65.
    #[inline(never)]
    pub(super) fn change_output(&mut self) {
        if let Some(ProgramPins::Digital { number, on, with_motion }) = self.line.checked.pins {
            if with_motion {
                let idle = self.motion.is_idle();
                let mark = self.accessories.digital_mut().set_with_motion(number, on, idle);
                self.motion.set_mark(mark);
            } else {
                self.accessories.digital_mut().set(number, on);
            }
        }
    }

    /// Before the dwell of a line: M66.
    pub(super) fn begin_wait(&mut self, job: &Job, checking: bool) -> Stage {
        match self.line.checked.pins {
            Some(ProgramPins::Wait { longest, .. }) if !checking => {
                Stage::Input(self.now + longest, self.inputs.signals().program)
            }
            _ => self.begin_dwell(job.spindle_delay, checking),
        }
    }

    /// M66 waits for its input, which was `before` when it was looked at last. What follows; `None` if it still waits.
    #[inline(never)]
    pub(super) fn wait_for_input(&mut self, until: Instant, before: bool, job: &mut Job) -> Option<Stage> {
        let Some(ProgramPins::Wait { until: wait, .. }) = self.line.checked.pins else { return Some(Stage::Via) };
        let now = self.inputs.signals().program;
        if wait.is_over(before, now) {
            self.interpreter.set_input_read(Some(now));
        } else if self.now >= until {
            self.interpreter.set_input_read(None);
        } else {
            job.stage = Stage::Input(until, now);
            return None;
        }
        Some(self.begin_dwell(job.spindle_delay, false))
    }

    /// Outputs follow the motion that has begun; they are off where the machine is locked.
    #[inline]
    pub(super) fn settle_outputs(&mut self) {
        if self.accessories.digital().is_waiting() {
            let mark = self.motion.begun_mark();
            self.accessories.digital_mut().begun(mark);
        }
        if self.mode.is_alarm() || matches!(self.mode, Mode::Sleep(_)) {
            self.switch_outputs_off();
        }
    }

    fn switch_outputs_off(&mut self) {
        let mark = self.motion.begun_mark();
        self.accessories.digital_mut().switch_off(mark);
        self.motion.set_mark(mark);
    }

    /// The job is forgotten, or has come to its end: what waits for a motion is forgotten with it.
    pub(super) fn forget_waiting_outputs(&mut self) {
        let mark = self.motion.begun_mark();
        self.accessories.digital_mut().forget_waiting(mark);
        self.motion.set_mark(mark);
    }
}
