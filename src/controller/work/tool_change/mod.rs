//! Carries out M6 according to `$918`:
//! * 0: only the number of the tool changes, and nothing stops.
//! * 1: the spindle stops, a message names the tool to insert, and the program waits for `~`.
//! * 2: as 1. After that, a tool setter measures the new tool, and its length offset is set.

pub(crate) mod plan;

use crate::axes::Axis;
use crate::dispatch::Controller;
use crate::error::{Alarm, Error};
use crate::gcode::{CoordinateSystem, Feed, MotionCommand, StoredOffset};
use crate::messages::{Coolant, SpindleDirection};
use crate::motion::Speed;
use crate::settings::Key;
use crate::states::{Hold, State};
use crate::units::{Coordinate, per_second};
use crate::work::probe::seek;
use crate::work::task::{Job, Stage};
use crate::work::tool_change::plan::{ChangeOrder, ChangePlan, ToolChange};

impl<const N: usize> Controller<N> {
    /// Returns whether a tool setter measures each tool that M6 puts into the spindle (`$918=2`).
    pub(crate) fn measures_tools(&self) -> bool {
        self.m.settings.whole(Key::ToolChange) == 2
    }

    /// Begins the tool change if the line contains one: the spindle stops, and the program waits for `~`. Called at
    /// rest, before the rest of the line is executed.
    #[inline(never)]
    pub(crate) fn begin_tool_change(&mut self, job: &mut Job) -> Stage {
        if !(self.line.action.tool_change && self.m.prompts_for_tools()) {
            return Stage::Apply;
        }
        if self.measures_tools() {
            return self.stop_for_tool(job);
        }
        self.line.action.spindle_stopped_for_tool();
        self.m.accessories.stop_spindle();
        self.m.interpreter.set_accessories(SpindleDirection::Off, self.m.accessories.coolant());
        self.m.replies.overrides_changed();
        self.prompt();
        Stage::ToolChange
    }

    /// Applies a tool change to the state of the program in check mode (`$C`), where nothing moves. Called after the
    /// state of the line has been committed.
    pub(crate) fn check_tool_change(&mut self) {
        if !(self.line.action.tool_change && self.m.prompts_for_tools()) {
            return;
        }
        if self.measures_tools() {
            if self.line.action.spindle_tool() != 0 {
                self.m.interpreter.assume_measured();
            }
        } else {
            self.line.action.spindle_stopped_for_tool();
            let modal = *self.line.action.modal();
            self.m.interpreter.set_accessories(modal.spindle, modal.coolant);
        }
    }

    fn prompt(&mut self) {
        self.tell_tool();
        self.wait_for_operator();
    }

    /// Waits for `~`. The drivers are switched on, so that an operator who pulls at the spindle does not move the axes.
    fn wait_for_operator(&mut self) {
        self.m.drivers.switch_on();
        self.enter(State::Hold(Hold::BEGUN));
    }

    /// Returns an error if the tool cannot be changed and measured; `None` if it can. Called before anything moves.
    #[inline(never)]
    pub(crate) fn refuse_tool_change(&mut self) -> Option<Error> {
        if !self.line.action.is_tool_change_alone() || self.line.action.motion != MotionCommand::None {
            return Some(Error::ToolChangeNotAlone);
        }
        if !self.m.reference.is_trusted() || !self.m.settings.is_on(Key::Homing) {
            return Some(Error::ToolChangeNeedsHoming);
        }
        if let Some(error) = self.motion_locked() {
            return Some(error);
        }
        let plan = self.plan_tool_change();
        let outside = self.limits_travel() && plan.corners().iter().any(|corner| self.is_outside_travel(corner));
        let rates = [Key::ToolSetterSeek, Key::ToolSetterLocate, Key::ParkingPullOutRate];
        let is_rate_out_of_range = rates.iter().any(|rate| self.m.settings.is_rate_out_of_range(*rate));
        let is_set_up = plan.is_set_up(self.m.settings.is_on(Key::ZeroAtPullOff));
        (!is_set_up || outside || is_rate_out_of_range).then_some(Error::ToolSetterNotSetUp)
    }

    fn plan_tool_change(&self) -> ChangePlan<N> {
        let (offsets, settings) = (self.m.interpreter.offsets(), &self.m.settings);
        ChangePlan {
            left: *self.m.interpreter.position(),
            change: offsets.stored(StoredOffset::G30),
            setter: offsets.system(CoordinateSystem::G59_3),
            depth: Coordinate::from_mm_f32(settings.value(Key::ToolSetterDepth)),
            seek_rate: per_second(settings.value(Key::ToolSetterSeek)),
            locate_rate: per_second(settings.value(Key::ToolSetterLocate)),
            measures: self.line.action.spindle_tool() != 0,
        }
    }

    /// Switches spindle and coolant off. The program switches them on again when the new tool is over the work.
    fn stop_for_tool(&mut self, job: &mut Job) -> Stage {
        let delay = self.m.accessories.set_spindle(SpindleDirection::Off, &self.m.settings);
        self.m.accessories.switch_off();
        self.m.interpreter.set_accessories(SpindleDirection::Off, Coolant::default());
        self.m.replies.overrides_changed();
        job.wait(Stage::SpinningDown, self.m.now + delay)
    }

    /// Moves the tool away from the work. Called when the spindle has come to rest.
    pub(crate) fn leave_for_tool(&mut self) -> Stage {
        self.line.begin_change(ToolChange::new(self.plan_tool_change()));
        let order = self.line.change().begin();
        self.carry_out_change(order)
    }

    /// Carries out the next step of the tool change. Returns the next stage of the line; `None` while the previous step
    /// is still going on.
    #[inline(never)]
    pub(crate) fn advance_tool_change(&mut self) -> Option<Stage> {
        let touched = match self.line.change().is_probing() {
            true => self.take_probe(true)?,
            false if !self.m.motion.is_idle() => {
                self.start_queued();
                return None;
            }
            false => false,
        };
        let place = touched.then(|| self.m.probe.result().0);
        let order = self.line.change().next(place);
        Some(self.carry_out_change(order))
    }

    fn carry_out_change(&mut self, order: ChangeOrder<N>) -> Stage {
        match order {
            ChangeOrder::Rapid(target) => {
                self.m.motion.line(&seek(target, Speed::Rapid, self.line.action.line_number));
                self.start_motion();
            }
            ChangeOrder::Move(target, rate) => {
                self.m.motion.line(&seek(target, Speed::Feed(rate), self.line.action.line_number));
                self.start_motion();
            }
            ChangeOrder::Probe(target, rate) => {
                if !self.begin_probe(&target, Speed::Feed(rate), false, self.line.action.line_number) {
                    return Stage::Done;
                }
            }
            ChangeOrder::Prompt => {
                self.m.interpreter.tool_removed();
                self.prompt();
            }
            ChangeOrder::Measured(place) => {
                if self.m.interpreter.tool_measured(self.line.action.spindle_tool(), place) {
                    self.line.change().mark_first_tool();
                }
                self.m.replies.offset_changed();
            }
            ChangeOrder::Confirm => {
                self.tell_first_tool();
                self.wait_for_operator();
            }
            ChangeOrder::Done => return self.return_to_work(),
            ChangeOrder::Failed(alarm) => return self.fail_tool_change(alarm),
        }
        Stage::Measuring
    }

    /// Prepares the rest of the line, which switches spindle and coolant on again and then moves the tool down. Called
    /// when the new tool is above the work.
    fn return_to_work(&mut self) -> Stage {
        let length = self.m.interpreter.offsets().tool_length;
        let longer = length.zip(&self.line.action.tool_length(), |new, old| new - old);
        let longer = longer.get(Axis::Z).unwrap_or(Coordinate::ZERO);
        let clear = Coordinate::from_mm_f32(self.m.settings.value(Key::ParkingPullOut));
        let way = self.line.change().way_back(longer, clear);
        let outside = way.iter().any(|place| !place.iter().all(|coordinate| coordinate.in_range()));
        if outside || self.limits_travel() && way.iter().any(|place| self.is_outside_travel(place)) {
            return self.fail_tool_change(Alarm::SoftLimit);
        }
        // In laser mode, the move down is a rapid, because in a feed move of this line the laser would be on.
        let rate = per_second(self.m.settings.value(Key::ParkingPullOutRate));
        let feed = if self.m.settings.is_on(Key::Laser) { Feed::Rapid } else { Feed::PerMinute(rate) };
        self.line.action.return_with_tool(way, feed, length);
        Stage::Apply
    }

    /// Locks the machine with an alarm, without a further move. The position stays trusted.
    fn fail_tool_change(&mut self, alarm: Alarm) -> Stage {
        self.m.interpreter.set_position(self.m.motion.machine_position());
        self.lock(alarm);
        Stage::Done
    }
}
