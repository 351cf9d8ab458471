//! Carries out a canned cycle, one step at a time: a move, a dwell, the spindle, a pause. A hold, a reset or a report
//! can come between any two steps. The steps come from `gcode::cycle`.

use crate::dispatch::Controller;
use crate::gcode::{CycleStep, MotionCommand};
use crate::messages::SpindleDirection;
use crate::motion::Speed;
use crate::protocol::reply_texts;
use crate::settings::Key;
use crate::states::{Hold, State};
use crate::units::{Coordinate, Duration};
use crate::work::task::{Job, Stage};

impl<const N: usize> Controller<N> {
    /// Does the next step of the line's cycle. Returns the next stage of the line; `None` if the line has to wait for
    /// room in the look-ahead or for the end of motion.
    #[inline(never)]
    pub(crate) fn go_on_cycle(&mut self, job: &mut Job) -> Option<Stage> {
        let clearance = Coordinate::from_mm_f32(self.m.settings.value(Key::PeckClearance));
        let MotionCommand::Cycle(cycle) = &mut self.line.action.motion else { return Some(Stage::Flow) };
        let ready = if cycle.next_rests() { self.m.motion.is_idle() } else { self.m.motion.free_blocks() > 0 };
        if !ready {
            self.start_queued();
            return None;
        }
        // There is room for a block, so `queue` takes the move.
        match cycle.step(clearance) {
            None => return Some(Stage::Flow),
            Some(CycleStep::Rapid(target)) => {
                self.queue(&target, Speed::Rapid, job);
            }
            Some(CycleStep::Feed(target, feed)) => {
                self.queue(&target, Speed::Feed(feed), job);
            }
            Some(CycleStep::Dwell(time)) => {
                job.spindle_delay = Duration::from_ticks(0);
                return Some(self.cycle_waits(time, job));
            }
            Some(CycleStep::SpindleOff) => return Some(self.cycle_switches_spindle(SpindleDirection::Off, job)),
            Some(CycleStep::SpindleOn(direction)) => return Some(self.cycle_switches_spindle(direction, job)),
            Some(CycleStep::Pause) => {
                self.say(|out| reply_texts::message(out, "Cycle paused, ~ draws the tool back"));
                self.enter(State::Hold(Hold::BEGUN));
                return Some(Stage::CyclePaused);
            }
        }
        Some(Stage::Target)
    }

    fn cycle_waits(&self, time: Duration, job: &mut Job) -> Stage {
        if time.is_zero() { Stage::Target } else { job.wait(Stage::Dwell, self.m.now + time) }
    }

    /// Switches the spindle within a cycle, with the delays of M3 to M5. Returns the stage that waits for them.
    fn cycle_switches_spindle(&mut self, direction: SpindleDirection, job: &mut Job) -> Stage {
        let delay = self.m.accessories.set_spindle(direction, &self.m.settings);
        job.spindle_delay = delay;
        self.m.interpreter.set_accessories(direction, self.m.accessories.coolant());
        self.m.replies.overrides_changed();
        if self.m.accessories.waits_for_speed(&self.m.settings) {
            job.wait(Stage::SpinningUp, self.m.now + delay)
        } else {
            self.cycle_waits(delay, job)
        }
    }
}
