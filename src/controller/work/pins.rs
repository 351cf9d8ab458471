//! Carries out M62 to M68. An output is switched now or with the next motion. M66 waits for an input, up to a maximum
//! time. A pin that the board does not have is refused.

use crate::dispatch::Controller;
use crate::gcode::ProgramPins;
use crate::work::task::{Job, Stage};

impl<const N: usize> Controller<N> {
    /// Returns whether the line uses a pin that the board does not have. No board has analog pins.
    pub(crate) fn lacks_pin(&self) -> bool {
        let [outputs, inputs] = self.m.settings_lock.program_pins();
        match self.line.action.pins() {
            None => false,
            Some(ProgramPins::Digital { number, .. }) => number >= u32::from(outputs),
            Some(ProgramPins::Wait { number, .. }) => number >= u32::from(inputs),
            Some(ProgramPins::Analog { .. } | ProgramPins::ReadAnalog { .. }) => true,
        }
    }

    /// Returns whether the line can be executed now. An output that changes with a motion may have to wait until
    /// earlier changes have been made.
    pub(crate) fn has_room_for_pins(&mut self) -> bool {
        match self.line.action.pins() {
            Some(ProgramPins::Digital { with_motion: true, .. }) => self.has_room_for_change(),
            _ => true,
        }
    }

    #[inline(never)]
    fn has_room_for_change(&mut self) -> bool {
        let idle = self.m.motion.is_idle();
        // A mark ties the change to the next block. This function only checks that a mark can be given, and
        // `change_output` sets it.
        let can = self.m.accessories.digital().has_room(idle) && self.m.motion.takes_mark();
        if !can {
            self.start_queued();
        }
        can
    }

    /// Switches the output: for M64 and M65 now, for M62 and M63 when the next motion begins.
    #[inline(never)]
    pub(crate) fn change_output(&mut self) {
        if let Some(ProgramPins::Digital { number, on, with_motion }) = self.line.action.pins() {
            if with_motion {
                let idle = self.m.motion.is_idle();
                let mark = self.m.accessories.digital_mut().set_with_motion(number, on, idle);
                self.m.motion.set_mark(mark);
            } else {
                self.m.accessories.digital_mut().set(number, on);
            }
        }
    }

    /// Starts the wait of M66 and returns its stage; `None` if the line has no M66. The line's dwell comes after this
    /// wait.
    pub(crate) fn begin_wait(&self, job: &mut Job) -> Option<Stage> {
        match self.line.action.pins() {
            Some(ProgramPins::Wait { number, longest, .. }) => {
                job.input_before = self.reads_input(number);
                Some(job.wait(Stage::Input, self.m.now + longest))
            }
            _ => None,
        }
    }

    /// Returns whether a program input is active; false for one that the board does not have.
    fn reads_input(&self, number: u32) -> bool {
        u32::from(self.m.inputs.signals().program).checked_shr(number).is_some_and(|levels| levels & 1 != 0)
    }

    /// Returns whether the wait of M66 has ended. If so, stores its result for the program: the level that was read,
    /// or that the time ran out.
    #[inline(never)]
    pub(crate) fn has_read_input(&mut self, job: &mut Job) -> bool {
        let Some(ProgramPins::Wait { number, until: wait, .. }) = self.line.action.pins() else { return true };
        let now = self.reads_input(number);
        let is_over = wait.is_over(job.input_before, now);
        if !is_over && self.m.now < job.until {
            job.input_before = now;
            return false;
        }
        self.m.interpreter.set_input_read(is_over.then_some(now));
        true
    }
}
