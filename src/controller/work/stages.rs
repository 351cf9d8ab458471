//! Carries out a line of G-code in stages: wait until the machine is at rest if needed, apply modal state and outputs,
//! dwell, move, pause or end. Each call does one bounded piece and returns, so realtime commands are never late. The
//! last stage answers the host.

use crate::dispatch::Controller;
use crate::error::{Alarm, Error};
use crate::gcode::{self, Flow, Held, HeldLine, PathControl};
use crate::image::FULL_IMAGE;
use crate::machine::realtime_override::Overrides;
use crate::motion::Speed;
use crate::protocol::reply_texts;
use crate::settings::Key;
use crate::states::{Hold, State};
use crate::units::Duration;
use crate::view::dialect;
use crate::work::limits::{geometry, spline_geometry};
use crate::work::line::Message;
use crate::work::moves::speed;
use crate::work::task::{Answer, Caller, Job, Stage, Task};

impl<const N: usize> Controller<N> {
    /// Begins a checked line. For a jog, the caller must have checked that jogs are allowed now.
    ///
    /// Executes nothing yet: the line is kept as [`Task::Job`], and [`Controller::output`] calls
    /// [`Controller::advance`] when nothing more urgent is due.
    pub(crate) fn begin(&mut self, answer: Answer, jog: bool) {
        let action = &self.line.action;
        let checking = matches!(self.state, State::Check);
        let stops_before = !jog && self.m.interpreter.modal().path == PathControl::ExactStop && self.ends_line_before();
        let drain = !checking && (stops_before || !action.moves_only() && self.acts_at_rest());
        let stage = if drain { Stage::Drain } else { Stage::Apply };
        self.task = Task::Job(Job::new(answer, stage, jog));
    }

    /// Returns whether the machine has to come to rest before this line acts.
    fn acts_at_rest(&self) -> bool {
        let action = &self.line.action;
        action.spindle.is_some()
            || action.coolant.is_some()
            || action.dwell.is_some()
            || action.work_offset_changed
            || action.store.is_some()
            || action.tool_change && self.m.prompts_for_tools()
            || matches!(action.motion, gcode::MotionCommand::Probe { .. })
            || action.pins().is_some_and(|pins| pins.act_at_rest())
            || action.modal().overrides_held != self.m.interpreter.modal().overrides_held
            || self.speed_needs_rest()
            || self.starts_to_turn()
    }

    /// Returns whether the machine comes to rest before this line because G61.1 (exact stop) is in force from an
    /// earlier line. It does so if this line moves, or if this line ends G61.1.
    fn ends_line_before(&self) -> bool {
        let action = &self.line.action;
        action.motion != gcode::MotionCommand::None || action.modal().path != PathControl::ExactStop
    }

    /// Returns whether the machine has to be at rest when S takes effect. S normally takes effect with the line's
    /// motion. In a line without motion, S changes the power of a laser at rest.
    fn speed_needs_rest(&self) -> bool {
        self.m.settings.is_on(Key::Laser) && self.shows_speed()
    }

    /// Returns whether S starts a spindle that M3 or M4 has switched on with S0. Motion then has to wait for the
    /// spindle.
    fn starts_to_turn(&self) -> bool {
        let (action, settings) = (&self.line.action, &self.m.settings);
        action.speed_changed
            && action.spindle.is_none()
            && self.m.accessories.is_on_without_speed()
            && (settings.is_on(Key::SpinUp) || self.m.accessories.waits_for_speed(settings))
            && !settings.is_on(Key::Laser)
    }

    /// Returns whether the next report must show S: S changes a running spindle or, in a line that does not move, a
    /// laser that is on.
    fn shows_speed(&self) -> bool {
        self.line.action.speed_changed
            && self.m.accessories.is_on()
            && !(self.m.settings.is_on(Key::Laser) && self.line.action.motion != gcode::MotionCommand::None)
    }

    /// Returns whether there is a task that can advance. This check is cheap and runs before each segment, so that
    /// [`Controller::advance`] is called only when needed.
    pub(crate) fn may_advance(&self) -> bool {
        match &self.task {
            Task::None => matches!(self.state, State::Homing(_)),
            Task::Job(job) => !self.waits_for_room(job.stage),
            _ => true,
        }
    }

    /// Returns whether the line has to wait for room: the look-ahead is full, and motion is already running.
    fn waits_for_room(&self, stage: Stage) -> bool {
        let moves = match stage {
            Stage::Target => matches!(self.line.action.motion, gcode::MotionCommand::Line { .. }),
            Stage::Chords | Stage::Back => true,
            _ => false,
        };
        moves
            && self.m.motion.free_blocks() == 0
            && self.m.step_supply.is_running()
            && !matches!(self.state, State::Check)
            && !self.m.stops.has_order()
    }

    /// Does one bounded piece of the current task. Returns whether something was done.
    #[inline(never)]
    pub(crate) fn advance(&mut self) -> bool {
        if let Task::Job(job) = self.task {
            return !self.m.stops.is_awaited() && !self.state.is_suspended() && self.advance_job(job);
        }
        let progressed = self.advance_task();
        if progressed {
            self.m.pins.disturb();
        }
        progressed
    }

    /// Advances a line of G-code. Returns whether something was done. A line that has only motion changes no outputs
    /// and no other pending work, so these are not checked again after it.
    fn advance_job(&mut self, mut job: Job) -> bool {
        self.task = Task::None;
        let progressed = self.advance_line(&mut job);
        let only_moved = self.line.action.moves_only()
            && !job.jog
            && matches!(self.state, State::Normal)
            && matches!(job.answer, Answer::Host | Answer::Held(_));
        // An ordered stop also counts as progress, because otherwise nothing would wake the pump to send the order.
        let ordered = self.m.stops.has_order();
        if ordered || progressed && !only_moved {
            self.m.pins.disturb();
        }
        match job.stage {
            Stage::Done if progressed => self.finish(job.answer),
            _ => self.task = Task::Job(job),
        }
        progressed || ordered
    }

    /// Advances homing, or a task other than a line of G-code. Returns whether something was done.
    #[inline(never)]
    fn advance_task(&mut self) -> bool {
        if self.m.stops.is_awaited() {
            return false;
        }
        match self.task {
            Task::None => {
                let State::Homing(homing) = &mut self.state else { return false };
                let next = homing.advance(&mut self.m);
                return self.follow(next);
            }
            Task::Listing(listing, line) => return self.advance_listing(listing, line),
            _ if self.state.is_suspended() => return false,
            Task::Startup(index, then) if self.m.inputs.are_known() => {
                self.task = Task::None;
                self.run_startup_line(index, then);
            }
            // Each stored line may send a reply, so it waits until there is room for one.
            Task::Held(caller) if self.m.replies.has_room() => {
                self.task = Task::None;
                self.run_held_line(caller);
            }
            Task::SoftLimit(_) if self.m.motion.is_at_rest() => self.alarm_at_soft_limit(),
            Task::Storing(answer) if self.m.records.are_stored() => self.finish(answer),
            Task::Startup(..)
            | Task::Held(_)
            | Task::SoftLimit(_)
            | Task::Storing(_)
            | Task::JogWaits
            | Task::Rebooting { .. }
            | Task::Job(_) => return false,
        }
        true
    }

    fn alarm_at_soft_limit(&mut self) {
        self.m.motion.discard();
        self.m.interpreter.set_position(self.m.motion.machine_position());
        self.m.step_supply.end();
        self.m.accessories.switch_off();
        self.tell_alarm(Alarm::SoftLimit);
        self.say(|out| reply_texts::message(out, "Reset to continue"));
        self.enter(State::Critical(Alarm::SoftLimit));
    }

    /// Advances the line until it has to wait, or until something must be output before it continues. Returns whether
    /// something was done.
    fn advance_line(&mut self, job: &mut Job) -> bool {
        let checking = matches!(self.state, State::Check);
        let mut progressed = false;
        loop {
            // The first arms are the stages of a line that only moves, as nearly all lines do. Between these stages,
            // such a line shows nothing to the host and does not wait.
            let next = match job.stage {
                // A line that only moves waits at this stage in a single case: a record of an earlier line is still
                // being stored.
                Stage::Apply if self.line.action.moves_only() && self.m.records.are_stored() => {
                    self.m.interpreter.commit(&self.line.action);
                    // Set even if S has not changed, because a stop may have set another speed.
                    self.m.accessories.set_speed(self.line.action.speed);
                    job.stage = Stage::Target;
                    progressed = true;
                    continue;
                }
                Stage::Target if !checking => self.begin_motion(job),
                Stage::Flow if self.line.action.flow == Flow::None && !self.line.is_single_block() => {
                    job.stage = Stage::Done;
                    return true;
                }
                Stage::Done => return true,
                _ => self.advance_stage(job, checking),
            };
            let Some(next) = next else { break };
            progressed = true;
            let shown_first = self.is_shown_before(job.stage, next);
            job.stage = next;
            if shown_first || self.state.is_suspended() || self.m.stops.is_awaited() {
                break;
            }
        }
        progressed
    }

    /// Handles the stages that `advance_line` does not handle itself. Returns the next stage; `None` if the line has to
    /// wait.
    // Not inlined, because otherwise every line that only moves would pay for the registers and the stack of these
    // stages.
    #[inline(never)]
    fn advance_stage(&mut self, job: &mut Job, checking: bool) -> Option<Stage> {
        match job.stage {
            Stage::Drain if self.m.motion.is_idle() => Some(self.begin_tool_change(job)),
            Stage::ToolChange => Some(Stage::Apply),
            Stage::SpinningDown => (self.m.now >= job.until).then(|| self.leave_for_tool()),
            Stage::Measuring => self.advance_tool_change(),
            Stage::Drain => {
                self.start_queued();
                None
            }
            Stage::Apply if !self.has_room_for_pins() => None,
            Stage::Apply => {
                job.spindle_delay = self.apply(checking, job.answer.is_of_program());
                Some(Stage::Storing)
            }
            Stage::Storing if !self.m.records.are_stored() => None,
            Stage::Storing => Some(self.begin_waiting(job, checking)),
            Stage::Input => self.has_read_input(job).then(|| self.begin_dwell(job, false)),
            Stage::Dwell => (self.m.now >= job.until).then_some(Stage::Via),
            Stage::SpinningUp => self.has_spun_up(job.until).then_some(Stage::Via),
            Stage::Via => match self.line.action.motion {
                gcode::MotionCommand::Line { via: Some(via), .. } if !checking => {
                    self.queue(&via, Speed::Rapid, job).then_some(Stage::Target)
                }
                _ => Some(Stage::Target),
            },
            Stage::Target => Some(self.check_target()),
            Stage::Chords => self.next_chord(job),
            Stage::Back => self.end_circle(job),
            Stage::Probing => {
                let must_touch = matches!(self.line.action.motion, gcode::MotionCommand::Probe { alarm: true, .. });
                // A failed probe has locked the machine. In that case skip `Flow`, because an M0 in the line would
                // unlock it.
                self.end_probe(must_touch).then_some(if self.state.is_alarm() { Stage::Done } else { Stage::Flow })
            }
            Stage::Flow => self.flow(job, checking),
            Stage::Paused => Some(Stage::Done),
            Stage::CyclePaused => Some(Stage::Target),
            Stage::DwellSuspended | Stage::InputSuspended => None,
            Stage::Done => Some(Stage::Done),
        }
    }

    /// Returns whether the effects of a stage must be output, and shown to the host, before the next stage begins.
    fn is_shown_before(&self, stage: Stage, next: Stage) -> bool {
        match stage {
            Stage::Apply => self.line.action.changes_outputs(),
            Stage::Via => matches!(self.line.action.motion, gcode::MotionCommand::Line { via: Some(_), .. }),
            Stage::Target => matches!(self.line.action.motion, gcode::MotionCommand::Cycle(_)),
            // Each call of `advance` queues only one chord, so that a call stays short.
            Stage::Chords => next == Stage::Chords,
            Stage::Drain | Stage::Probing | Stage::Measuring => true,
            _ => false,
        }
    }

    /// Replaces the motion of a line in check mode, in which nothing moves.
    fn check_target(&mut self) -> Stage {
        if matches!(self.line.action.motion, gcode::MotionCommand::Probe { .. }) {
            // Assume that the probe makes contact at its target.
            let target = *self.m.interpreter.position();
            self.m.interpreter.set_probed(&target, true);
        }
        Stage::Flow
    }

    /// Starts the wait of M66 if the line has an M66, otherwise the wait for G4 and the spindle
    /// ([`Controller::begin_dwell`]). Returns the stage that waits.
    fn begin_waiting(&self, job: &mut Job, checking: bool) -> Stage {
        let input = if checking { None } else { self.begin_wait(job) };
        input.unwrap_or_else(|| self.begin_dwell(job, checking))
    }

    /// Starts the wait for G4 and for the spindle. Returns the stage that waits, or [`Stage::Via`] if there is nothing
    /// to wait for.
    fn begin_dwell(&self, job: &mut Job, checking: bool) -> Stage {
        let dwell = self.line.action.dwell.filter(|_| !checking).unwrap_or(Duration::from_ticks(0));
        let wait = dwell + job.spindle_delay;
        let switched = self.line.action.spindle.is_some() || !job.spindle_delay.is_zero();
        if switched && self.m.accessories.waits_for_speed(&self.m.settings) && !checking {
            job.wait(Stage::SpinningUp, self.m.now + wait)
        } else if wait.is_zero() {
            Stage::Via
        } else {
            job.wait(Stage::Dwell, self.m.now + wait)
        }
    }

    /// Starts the motion of the line. Returns the next stage; `None` if the line has to wait.
    fn begin_motion(&mut self, job: &mut Job) -> Option<Stage> {
        self.m.accessories.digital_mut().motion_follows();
        match self.line.action.motion {
            gcode::MotionCommand::Line { ref target, feed, .. } => {
                let mv = self.move_of(target, speed(feed), job.jog);
                self.queue_move(&mv, job).then_some(Stage::Flow)
            }
            _ => self.begin_other_motion(job),
        }
    }

    /// Starts an arc, a spline, a probing move or a canned cycle. Returns the next stage; `None` if the line has to
    /// wait.
    #[inline(never)]
    fn begin_other_motion(&mut self, job: &mut Job) -> Option<Stage> {
        match self.line.action.motion {
            gcode::MotionCommand::Arc(ref arc) => {
                let (geometry, feed, from_centre) = (geometry(arc), arc.feed, arc.from_centre);
                if FULL_IMAGE && from_centre {
                    return self.begin_circle(&geometry, feed, job);
                }
                Some(self.begin_arc(&geometry, feed, job))
            }
            gcode::MotionCommand::Spline(ref spline) if FULL_IMAGE => {
                let (geometry, feed) = (spline_geometry(spline), spline.feed);
                Some(self.begin_spline(&geometry, feed, job))
            }
            gcode::MotionCommand::Nurbs(nurbs) if FULL_IMAGE => Some(self.begin_nurbs(&nurbs, job)),
            gcode::MotionCommand::Probe { target, feed, away, .. } => {
                let begun = self.begin_probe(&target, speed(feed), away, self.line.action.line_number);
                Some(if begun { Stage::Probing } else { Stage::Done })
            }
            gcode::MotionCommand::Cycle(_) => self.go_on_cycle(job),
            gcode::MotionCommand::None
            | gcode::MotionCommand::Line { .. }
            | gcode::MotionCommand::Spline(_)
            | gcode::MotionCommand::Nurbs(_) => Some(Stage::Flow),
        }
    }

    /// Commits the line's modal state, and sets everything in the line that is not a motion. Returns how long the
    /// spindle takes to spin up or down. `of_program`: `true` for a line of the host's program, `false` for a startup
    /// line.
    fn apply(&mut self, checking: bool, of_program: bool) -> Duration {
        let dialect = self.dialect();
        let action = &self.line.action;
        let mut delay = Duration::from_ticks(0);
        let before = action.work_offset_changed.then(|| self.m.interpreter.work_zero(dialect));
        let held = self.m.interpreter.modal().overrides_held;
        let freed = action.removes_tool().and_then(|number| self.m.interpreter.tools().find(number));
        let place = self.m.interpreter.place();
        self.m.interpreter.commit(action);
        if !of_program {
            // A startup line with M2 must not end the host's program, so the place in that program is restored.
            self.m.interpreter.return_to(place);
        }
        if before.is_some_and(|before| self.m.interpreter.work_zero(dialect) != before) {
            self.m.replies.offset_changed();
        }
        match (action.store, freed) {
            // Grbl stores coordinate systems in check mode too.
            _ if checking && dialect != gcode::Dialect::Grbl => {}
            (_, Some(slot)) => self.m.records.remove_tool(slot),
            (Some(offset), None) => self.m.records.save_offset(offset, &self.m.interpreter),
            (None, None) => {}
        }
        if let Some(notice) = self.line.action.notice() {
            self.tell_notice(notice);
        }
        if checking {
            self.check_tool_change();
            return delay;
        }
        if self.line.action.pins().is_some() {
            self.change_output();
        }
        if self.m.interpreter.modal().overrides_held != held {
            self.apply_overrides();
        }
        if self.starts_to_turn() {
            // At least one tick, because a delay of 0 means that there is no spindle to wait for.
            delay = self.m.settings.seconds(Key::SpinUp).max(Duration::from_ticks(1));
        }
        self.m.accessories.set_speed(self.line.action.speed);
        if self.shows_speed() {
            self.m.replies.overrides_changed();
        }
        if let Some(spindle) = self.line.action.spindle {
            delay = self.m.accessories.set_spindle(spindle, &self.m.settings);
            self.m.replies.overrides_changed();
        }
        if let Some(coolant) = self.line.action.coolant {
            self.m.accessories.set_coolant(coolant);
            self.m.replies.overrides_changed();
        }
        delay
    }

    /// Returns whether the program pauses after the line. M0 pauses, and so does M1 if the settings enable it (not in
    /// Grbl's dialect). If single block is on, the program pauses after each line that moves, except startup lines and
    /// jogs.
    fn pauses_behind(&self, job: &Job) -> bool {
        let single_block = || {
            self.line.is_single_block()
                && !job.jog
                && matches!(job.answer, Answer::Host | Answer::Held(Caller::Host))
                && self.line.action.motion != gcode::MotionCommand::None
        };
        match self.line.action.flow {
            Flow::Pause => true,
            Flow::OptionalPause
                if self.m.settings.is_on(Key::OptionalStop) && self.dialect() != gcode::Dialect::Grbl =>
            {
                true
            }
            Flow::None | Flow::OptionalPause => single_block(),
            Flow::End => false,
        }
    }

    /// Pauses the program or ends it, as the line says, once motion has ended. Returns the next stage; `None` while
    /// the line has to wait.
    fn flow(&mut self, job: &Job, checking: bool) -> Option<Stage> {
        let pauses = self.pauses_behind(job);
        match self.line.action.flow {
            Flow::None | Flow::Pause | Flow::OptionalPause if !pauses || checking => Some(Stage::Done),
            _ if !self.m.motion.is_idle() => {
                self.start_queued();
                None
            }
            Flow::None | Flow::Pause | Flow::OptionalPause => {
                self.enter(State::Hold(Hold::BEGUN));
                self.darken_laser();
                Some(Stage::Paused)
            }
            Flow::End => {
                self.line.forget_notices();
                self.m.replies.offset_changed();
                if !checking {
                    self.forget_waiting_outputs();
                    // The line has switched spindle and coolant off, but the operator may have switched the coolant on
                    // since then.
                    self.switch_off();
                    self.m.accessories.set_overrides(Overrides::NONE);
                    self.m.motion.set_overrides(1.0, 1.0);
                    self.m.replies.overrides_changed();
                }
                self.say(|out| reply_texts::message(out, "Pgm End"));
                self.line.keep_message(Message::new());
                Some(Stage::Done)
            }
        }
    }

    /// Answers an executed line, or continues with what has to come before the answer, such as the next stored line of
    /// a subroutine.
    pub(crate) fn finish(&mut self, answer: Answer) {
        self.task = Task::None;
        match answer {
            Answer::Host => {
                self.m.last_line_at = self.m.now;
                self.say_ok();
            }
            Answer::Held(caller) => self.task = Task::Held(caller),
            Answer::Startup(index, host_waits) => {
                self.echo_startup_line(index);
                self.say_ok();
                self.begin_startup_line(index + 1, host_waits);
            }
            Answer::Validation(index) => {
                self.m.records.save_validated(index);
                self.task = Task::Storing(Answer::Host);
            }
            Answer::Setting(number) => {
                self.say_ok();
                self.name_after_change(number);
            }
            Answer::Restart => {
                self.say_ok();
                self.initialise();
            }
        }
    }

    pub(crate) fn gcode(&mut self, line: &[u8], answer: Answer) -> Result<(), Error> {
        self.m.interpreter.check_into(line, dialect(&self.m.settings), &mut self.line.action)?;
        self.begin_checked(answer)
    }

    /// Begins a checked line, unless the machine refuses it. If the line violates a soft limit, begins to brake
    /// instead; the alarm follows at rest.
    pub(crate) fn begin_checked(&mut self, answer: Answer) -> Result<(), Error> {
        if let Some(error) = self.refuse_line() {
            return Err(error);
        }
        if self.line.action.needs_machine() {
            self.allow_change_and_pins()?;
        }
        if self.violates_soft_limits() {
            self.m.motion.hold();
            self.task = Task::SoftLimit(answer);
        } else {
            self.begin(answer, false);
        }
        Ok(())
    }

    /// Checks whether the board has the pins that the line uses, and whether the machine is ready for the tool change
    /// of the line.
    #[inline(never)]
    fn allow_change_and_pins(&mut self) -> Result<(), Error> {
        if self.lacks_pin() {
            return Err(Error::NoSuchPin);
        }
        let refused = self.line.action.tool_change && self.measures_tools();
        refused.then(|| self.refuse_tool_change()).flatten().map_or(Ok(()), Err)
    }

    pub(crate) fn jog(&mut self, line: &[u8]) -> Result<(), Error> {
        self.m.interpreter.check_jog_into(line, dialect(&self.m.settings), &mut self.line.action)?;
        let is_over = self.m.lines.is_jog_stale() || self.m.replies.has_host_left(self.m.lines.hosts_cut());
        if is_over || matches!(self.state, State::Jog { cancelling: true }) {
            // The jog was sent before a jog cancel, or by a host that has disconnected since. It is answered without a
            // move.
            self.say_ok();
            return Ok(());
        }
        let clipped = self.m.settings.is_on(Key::JogClip);
        if clipped {
            self.clip_to_travel();
        }
        if let Some(error) = self.refuse_line() {
            return Err(error);
        }
        if !clipped && self.violates_soft_limits() {
            return Err(Error::JogOutsideTravel);
        }
        self.begin(Answer::Host, true);
        Ok(())
    }

    /// Runs the next stored line of a subroutine, loop or macro. An error ends all open calls and loops, and is the
    /// answer to the line that called them.
    #[inline(never)]
    fn run_held_line(&mut self, caller: Caller) {
        let mut line = HeldLine::new();
        let next = self.m.interpreter.next_held(&mut line);
        let (words, comment) = gcode::split_comment(&line);
        let carried_out = match next {
            Ok(Held::Line) if !words.is_empty() => self.gcode(words, Answer::Held(caller)),
            Ok(Held::Line | Held::Again) => {
                self.task = Task::Held(caller);
                Ok(())
            }
            Ok(Held::End) => Ok(()),
            Err(error) => Err(error),
        };
        match carried_out {
            Ok(()) => self.send_comment(comment),
            Err(error) => {
                if gcode::REASONS {
                    let dialect = self.dialect();
                    self.line.explain(&mut self.m.interpreter, words, dialect, error, false);
                    self.line.explain_within(words);
                }
                self.m.interpreter.abandon_held();
                if let Caller::Startup(index, _) = caller {
                    self.echo_startup_line(index);
                }
                self.refuse(error);
                match caller {
                    Caller::Host => {
                        self.m.interpreter.refused_in_run(words);
                        self.m.last_line_at = self.m.now;
                        self.stop_at_error(gcode::asks_for_tool(Some(words)));
                    }
                    Caller::Startup(index, host_waits) => self.begin_startup_line(index + 1, host_waits),
                    Caller::Validation(_) => {}
                }
            }
        }
        if next == Ok(Held::End) {
            self.tell_awaited();
            self.finish(caller.answer());
        }
    }

    fn begin_startup_line(&mut self, index: usize, host_waits: bool) {
        self.task = Task::Startup(index, host_waits.then_some(Answer::Host));
    }

    /// Begins a startup line. If the line calls a subroutine, its answer follows when the subroutine has ended.
    pub(crate) fn startup_line(&mut self, line: &[u8], caller: Caller) -> Result<(), Error> {
        if self.dialect() != gcode::Dialect::Grbl && self.m.interpreter.begin_call(line)? {
            self.task = Task::Held(caller);
            return Ok(());
        }
        self.gcode(line, caller.answer())
    }

    #[inline(never)]
    fn run_startup_line(&mut self, index: usize, then: Option<Answer>) {
        let line = if self.state.is_alarm() { None } else { self.m.records.startup_line(index).cloned() };
        let Some(line) = line else {
            if let Some(answer) = then {
                self.finish(answer);
            }
            return;
        };
        if !line.is_empty() {
            match self.startup_line(&line, Caller::Startup(index, then.is_some())) {
                Ok(()) => return,
                Err(error) => {
                    self.echo_startup_line(index);
                    self.refuse(error);
                }
            }
        }
        self.task = Task::Startup(index + 1, then);
    }

    /// Sends the text of a startup line, directly before its answer. The output of the startup line, and the reports
    /// made while it ran, have already been sent on lines of their own.
    fn echo_startup_line(&mut self, index: usize) {
        if let Some(line) = self.m.records.startup_line(index).cloned() {
            self.say(|out| reply_texts::startup_echo(out, &line));
        }
    }
}
