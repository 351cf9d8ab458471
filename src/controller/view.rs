//! Read-only queries of the controller: whether it is idle or at rest, positions, line numbers, the alarm, and the
//! dialect in force.

use crate::axes::PerAxis;
use crate::dispatch::Controller;
use crate::error::Alarm;
use crate::gcode::{Dialect, Interpreter, MotionCommand};
use crate::settings::{Key, Settings};
use crate::states::State;
use crate::states::stops::orders::StopReason;
use crate::states::stops::reaction::Reaction;
use crate::units::{Coordinate, Instant};
use crate::work::task::{Stage, Task};

/// A time that is never reached. `u64::MAX` would not do, because times in the upper half of the range count as past.
const NEVER: Instant = Instant::from_ticks(u64::MAX / 4);

impl<const N: usize> Controller<N> {
    /// Returns whether nothing is queued or moving, the controller waits for nothing, and every line is answered.
    pub fn is_idle(&self) -> bool {
        self.has_nothing_to_do()
            && self.m.stops.is_idle()
            && self.m.motion.is_idle()
            && self.m.parking.motion().is_idle()
            && self.m.replies.is_idle()
            && self.m.records.are_stored()
    }

    /// Returns whether another host may take over: the controller is idle, and no subroutine, loop or condition is
    /// open. A change of hosts would drop an open one, and then run its remaining lines as if they were outside of it.
    pub fn is_free(&self) -> bool {
        self.is_idle() && !self.m.interpreter.is_within_block()
    }

    /// Returns whether UTF-8 characters in comments are text. In Grbl's dialect each of their bytes is a command or is
    /// ignored.
    pub fn reads_characters(&self) -> bool {
        self.dialect() != Dialect::Grbl
    }

    /// Returns whether answers wait for room in the output queue.
    pub fn has_answers(&self) -> bool {
        self.m.replies.are_waiting()
    }

    /// Returns whether a job is in progress. A laser that burns at rest counts as a job.
    pub(crate) fn is_at_work(&self) -> bool {
        let has_task = !matches!(self.task, Task::None | Task::Rebooting { .. });
        self.m.step_supply.is_running() || !self.m.motion.is_idle() || has_task || self.burns()
    }

    /// Returns whether the laser burns at rest.
    pub(crate) fn burns(&self) -> bool {
        self.m.settings.is_on(Key::Laser) && self.resting_power() != 0
    }

    /// Returns whether the spindle must be up to speed: program lines are being executed, and none of them is waiting
    /// for spin-up.
    pub(crate) fn needs_speed(&self) -> bool {
        let works = self.m.step_supply.is_running() || !self.m.motion.is_idle() || self.task.is_program();
        matches!(self.state, State::Normal) && works && !self.task.is_spinning_up()
    }

    /// Returns whether a turning spindle stays on at this alarm. The reaction that the settings give for the alarm
    /// must allow that. While the door is open, or while the spindle is stopped although the program has it on, the
    /// spindle does not stay on.
    pub(crate) fn keeps_spindle_on(&self, alarm: Alarm) -> bool {
        let reaction = match alarm {
            Alarm::AbortInMotion => Reaction::of(Key::HostReaction, &self.m.settings),
            alarm => Reaction::to(alarm, &self.m.settings),
        };
        let door_allows = !self.m.inputs.signals().door
            && match self.state {
                State::Door(door) => door.opening.alarm.is_some() && door.opening.spindle_on,
                _ => true,
            };
        reaction.spindle_on && door_allows && !self.m.accessories.is_suspended()
    }

    /// Returns why motion is stopping or braking. Of two reasons, returns the more serious one. Returns `None` if
    /// motion is doing neither, or if it will resume afterwards.
    pub(crate) fn stop_under_way(&self) -> Option<StopReason> {
        let alarm = match self.state {
            State::Braking { then } => then.alarm(),
            State::Door(door) => door.opening.alarm,
            _ => None,
        };
        let braking = alarm.map(StopReason::Alarm);
        self.m
            .stops
            .awaited()
            .map_or(braking, |awaited| Some(braking.map_or(awaited, |braking| awaited.heavier(braking))))
    }

    fn has_nothing_to_do(&self) -> bool {
        self.task.is_none() && !matches!(self.state, State::Homing(_))
    }

    /// Returns whether the controller is idle and spindle and laser are off. Only then may the pump stop for a second
    /// to erase flash.
    pub fn is_quiet(&self) -> bool {
        self.is_idle() && self.is_off()
    }

    /// Like [`Controller::is_quiet`], but answers, stops and records that are being stored may still be pending. So
    /// the controller will soon be quiet if no more lines come.
    pub fn is_nearly_quiet(&self) -> bool {
        self.has_nothing_to_do() && self.m.motion.is_idle() && self.m.parking.motion().is_idle() && self.is_off()
    }

    fn is_off(&self) -> bool {
        self.m.pins.are_off()
    }

    /// Returns the position of the tool in machine coordinates.
    pub fn machine_position(&self) -> PerAxis<Coordinate, N> {
        // While the tool is parked, its position is that of the parking moves.
        if self.m.parking.is_away() {
            self.m.parking.motion().machine_position()
        } else {
            self.m.motion.machine_position()
        }
    }

    /// Returns the position of the tool in the active coordinate system.
    pub fn work_position(&self) -> PerAxis<Coordinate, N> {
        self.machine_position().zip(&self.m.interpreter.work_zero(self.dialect()), |m, o| m - o)
    }

    /// Returns the N word of the move in execution, 0 = none.
    pub fn line_number(&self) -> u32 {
        self.m.motion.line_number()
    }

    /// Returns the N word of the move that was last handed to the step task. The step task may still execute an
    /// earlier one ([`Controller::line_number`]).
    pub fn handed_line_number(&self) -> u32 {
        self.m.motion.running_line_number()
    }

    /// Returns the N words of the move that was last handed to the step task, and of the moves queued after it.
    pub fn queued_line_numbers(&self) -> impl Iterator<Item = u32> {
        self.m.motion.queued_line_numbers()
    }

    /// Makes all moves that are queued from now on carry `number` instead of their N words. A simulator finds by this
    /// number to which line a move belongs. Motion does not depend on the number.
    pub fn number_moves(&mut self, number: u32) {
        self.m.motion.number_moves(number);
    }

    /// Returns the number of the tool in the spindle. While a line is being executed, this is the tool after the M6 of
    /// that line. 0 if no M6 has named a tool.
    pub fn tool_in_work(&self) -> u32 {
        match self.task {
            Task::Job(_) => self.line.action.spindle_tool(),
            _ => self.m.interpreter.spindle_tool(),
        }
    }

    /// Returns S of the line being executed, in revolutions per minute without overrides; 0 while the spindle is off
    /// or no line is being executed.
    pub fn speed_in_work(&self) -> f32 {
        if matches!(self.task, Task::Job(_)) { self.line.action.turning_speed() } else { 0.0 }
    }

    /// Returns whether the line being executed is an arc or a spline.
    pub fn is_arc_in_work(&self) -> bool {
        matches!(self.task, Task::Job(_))
            && matches!(
                self.line.action.motion,
                MotionCommand::Arc(_) | MotionCommand::Spline(_) | MotionCommand::Nurbs(_)
            )
    }

    /// Returns the time at which the line being executed ends its wait for the spindle and begins its own dwell (G4).
    /// The simulator counts the two waits apart. Returns 0 if the line waits only for its dwell, `NEVER` if the line
    /// has no dwell, and `None` if the line does not wait.
    pub fn waits_for_spindle_until(&self) -> Option<Instant> {
        let Task::Job(job) = &self.task else { return None };
        match (job.stage, self.line.action.dwell) {
            (Stage::Dwell, _) if job.spindle_delay.is_zero() => Some(Instant::from_ticks(0)),
            (Stage::Dwell | Stage::SpinningUp, Some(dwell)) => Some(job.until - dwell),
            (Stage::Dwell | Stage::SpinningUp, None) => Some(NEVER),
            _ => None,
        }
    }

    /// Returns the number of lines read since power-up (wrapping), accepted or not.
    pub fn lines_read(&self) -> u32 {
        self.m.lines.lines_read()
    }

    /// Returns the number of the line that began the outermost open subroutine, loop or condition. Lines are counted
    /// as in [`Controller::lines_read`]. If the program ended while such a block was open, returns the line that began
    /// that block. Returns `None` if no block was open.
    pub fn open_since(&self) -> Option<u32> {
        self.m.interpreter.open_since()
    }

    /// Returns by how many bytes a held program was too long for the memory; the true number can be higher. `None` if
    /// it was not too long. A program is held in memory if it calls a subprogram that is defined after it.
    pub fn excess_bytes(&self) -> Option<usize> {
        self.m.interpreter.excess_bytes()
    }

    /// Returns the active alarm, if any.
    pub fn alarm(&self) -> Option<Alarm> {
        self.state.alarm()
    }

    /// Returns whether the reported position is that of the machine, as far as the controller can detect. See
    /// [`Reference`](crate::machine::reference::Reference) for the events that make the position untrusted; homing
    /// makes it trusted again.
    pub fn is_trusted(&self) -> bool {
        self.m.reference.is_trusted()
    }

    /// Returns whether stored settings were damaged and have not been confirmed.
    pub fn is_store_damaged(&self) -> bool {
        self.m.records.are_damaged()
    }

    /// Returns the settings in force.
    pub fn settings(&self) -> &Settings<N> {
        &self.m.settings
    }

    /// Returns the interpreter, in its state after the last line that it has taken.
    pub fn interpreter(&self) -> &Interpreter<N> {
        &self.m.interpreter
    }

    /// Returns whether the program has paused (M0, or a feed hold) and waits for `~` at rest.
    pub fn is_paused(&self) -> bool {
        matches!(self.state, State::Hold(_)) && self.m.motion.is_at_rest()
    }

    /// Returns whether hosts are answered like grblHAL (`$900=3`). The words of a program are those of
    /// [`Dialect::Oxmill`].
    #[inline]
    pub fn speaks_grblhal(&self) -> bool {
        self.m.settings.speaks_grblhal()
    }

    pub(crate) fn dialect(&self) -> Dialect {
        dialect(&self.m.settings)
    }
}

/// Returns the dialect of lines and replies. See also [`Controller::speaks_grblhal`].
pub(crate) fn dialect<const N: usize>(settings: &Settings<N>) -> Dialect {
    match settings.whole(Key::Dialect) {
        0 => Dialect::Grbl,
        2 => Dialect::Seed,
        _ => Dialect::Oxmill,
    }
}
