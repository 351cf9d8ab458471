//! Lines: when they are read, how each is answered, and what it starts.

use super::super::action::{self, Line, Pin, TRAVEL};
use super::{MANY, Mode, Model, Motion, Places, SLACK, Span, Work};

impl Model {
    /// Reads the received lines up to the first one that has to wait.
    pub(super) fn read(&mut self, also: &mut Vec<Model>) {
        while self.reads() && !self.waiting.is_empty() {
            if self.next_silence().is_some_and(|span| span.from <= self.now.to) {
                // The controller can notice the host timeout before it reads this line.
                let mut silent = self.clone();
                silent.host_is_silent(also);
                silent.read(also);
                also.push(silent);
            }
            let Some(line) = self.waiting.pop_front() else { return };
            let is_jog = matches!(line, Line::Jog(..) | Line::JogOutside | Line::WrongJog(..));
            let is_before = self.cancelled > 0;
            let is_wrong = matches!(line, Line::WrongJog(..));
            let is_cancelled = is_jog && !is_wrong && (is_before || self.braking.is_some());
            self.cancelled = self.cancelled.saturating_sub(1);
            if self.braking.is_some() && is_jog && !is_before && self.keeps_later_jogs {
                self.work = Some(Work::LaterJog(line));
            } else if is_cancelled && (self.is_idle() || self.mode == Mode::Jog) {
                self.say("ok");
            } else {
                self.line(line, also);
            }
        }
    }

    pub(super) fn reads(&self) -> bool {
        let listens = matches!(self.mode, Mode::Free | Mode::Jog | Mode::Alarm | Mode::Check);
        listens && self.work.is_none()
    }

    pub(super) fn is_idle(&self) -> bool {
        self.mode == Mode::Free && self.motion.is_none()
    }

    pub(super) fn line(&mut self, line: Line, also: &mut Vec<Model>) {
        let idle = self.is_idle();
        let rests = idle || self.mode == Mode::Alarm;
        let runs = self.mode == Mode::Free && !idle;
        match line {
            Line::TooLong if self.setup.grbl => self.refuse(11),
            Line::Empty => self.say("ok"),
            Line::Help => self.answer(&["[HLP:*"]),
            Line::ParserState => self.tell_modal_state(),
            Line::Listing if runs => self.refuse(8),
            Line::Listing => self.answer(&[MANY]),
            Line::Unlock => self.unlock(),
            Line::Check if self.mode == Mode::Check => {
                self.answer(&["[MSG:Disabled]"]);
                self.initialise(false, also);
            }
            Line::Check if idle => {
                self.answer(&["[MSG:Enabled]"]);
                self.mode = Mode::Check;
            }
            Line::ClearStartup if idle => self.say("ok"),
            Line::Check | Line::ClearStartup => self.refuse(8),
            Line::Jog(axis, by) => self.jog(axis, f64::from(by), also),
            Line::JogOutside => self.jog(0, action::JOG_OUTSIDE, also),
            Line::WrongJog(_, error) => {
                let allowed = idle || self.mode == Mode::Jog;
                self.refuse(if allowed { error } else { 8 });
            }
            Line::Parameters
            | Line::BuildInfo
            | Line::StartupLines
            | Line::Setting
            | Line::WrongSetting
            | Line::Restore
            | Line::Sleep
            | Line::Home
                if !rests =>
            {
                self.refuse(8);
            }
            Line::Parameters | Line::BuildInfo => self.answer(&[MANY]),
            Line::StartupLines => self.answer(&["$N0=", "$N1="]),
            Line::Setting => self.say("ok"),
            Line::WrongSetting => self.refuse(3),
            Line::Restore => {
                self.answer(&["[MSG:Restoring defaults]"]);
                self.initialise(self.mode == Mode::Alarm, also);
            }
            Line::Sleep => {
                self.say("ok");
                self.say("[MSG:Sleeping]");
                self.mode = Mode::Sleep;
                self.switch_off();
                // The position is not trusted any more, because sleep switches the drivers off.
                self.trusted = false;
            }
            Line::Home => match self.forbids_unlocking() {
                _ if !self.setup.homing => self.refuse(5),
                Some(error) => self.refuse(error),
                None => self.begin_homing(),
            },
            _ if matches!(self.mode, Mode::Alarm | Mode::Jog) => self.refuse(9),
            Line::Wrong(_, error) => self.refuse(error),
            // In Oxmill's dialect the line is not too long, but it repeats the word X.
            Line::TooLong => self.refuse(25),
            Line::Move(axis, to, feed) => self.travel(axis, f64::from(to), feed, also),
            Line::Outside => self.travel(0, action::OUTSIDE, true, also),
            // Oxmill: M6 loads a tool. In Grbl's dialect M6 is unknown, and T has no effect.
            Line::Tool(..) | Line::Change if self.setup.grbl => self.refuse(20),
            Line::Select(tool) => {
                self.selected = tool;
                self.say("ok");
            }
            _ if self.mode == Mode::Check => self.check(line),
            _ if self.motion.is_some() && self.waits_for_rest(line) => self.work = Some(Work::Drain(line)),
            _ => self.carry_out(line),
        }
    }

    pub(super) fn answer(&mut self, lines: &[&str]) {
        for line in lines {
            self.say(*line);
        }
        self.say("ok");
    }

    pub(super) fn refuse(&mut self, error: u8) {
        self.say(format!("error:{error}"));
    }

    /// Answers a valid line in check mode, in which nothing moves or is switched on.
    pub(super) fn check(&mut self, line: Line) {
        self.forget_selected();
        match line {
            Line::ProgramEnd => self.say("[MSG:Pgm End]"),
            Line::Tool(tool, _) => self.selected = tool,
            _ => {}
        }
        self.say("ok");
    }

    /// Returns whether a line waits until the preceding motion has ended. Lines for spindle, coolant or tool wait only
    /// if they change something; all other lines wait.
    pub(super) fn waits_for_rest(&self, line: Line) -> bool {
        match line {
            Line::Spindle(on) => self.spindle != on,
            Line::Flood(on) => self.flood != on,
            Line::Change => self.changes_tool(self.selected),
            Line::Tool(tool, spindle) => self.changes_tool(tool) || spindle && !self.spindle,
            _ => true,
        }
    }

    /// Returns whether the program waits until the operator has loaded this tool.
    pub(super) fn changes_tool(&self, tool: u8) -> bool {
        self.setup.tool_changes && tool != self.tool
    }

    /// Carries out T and M6 after the end of the preceding motion. `spindle`: M3 is in the same line.
    pub(super) fn change_tool(&mut self, tool: u8, spindle: bool) {
        if self.changes_tool(tool) {
            self.spindle = false;
            self.given = None;
            self.say(format!("[MSG:Tool change T{tool}]"));
            self.work = Some(Work::Tool { tool, spindle });
            self.mode = Mode::Hold;
        } else {
            (self.selected, self.tool) = (tool, tool);
            self.spindle |= spindle;
            self.say("ok");
        }
    }

    /// Forgets the selected tool in Grbl's dialect. There a line without T has the effect of T0.
    pub(super) fn forget_selected(&mut self) {
        if self.setup.grbl {
            self.selected = 0;
        }
    }

    /// Answers `$G`. In check mode the model does not predict the words of spindle and coolant, but it does predict the
    /// tool.
    pub(super) fn tell_modal_state(&mut self) {
        let words = format!("M{} M{} ", if self.spindle { 3 } else { 5 }, if self.flood { 8 } else { 9 });
        let words = if self.mode == Mode::Check { "*" } else { &words };
        self.answer(&[&format!("[GC:* {words}T{} *]", self.selected)]);
    }

    /// Carries out a line that needs the machine at rest. The caller makes sure that nothing moves.
    pub(super) fn carry_out(&mut self, line: Line) {
        self.forget_selected();
        match line {
            Line::Dwell => {
                let time = self.now.plus(Span::length(action::DWELL, 0.02));
                self.work = Some(Work::Dwell { time, held: false });
                return;
            }
            Line::Pause => {
                self.work = Some(Work::Pause);
                self.mode = Mode::Hold;
                return;
            }
            Line::ProgramEnd => {
                self.switch_off();
                self.overrides = [100; 3];
                self.say("[MSG:Pgm End]");
            }
            Line::Change => return self.change_tool(self.selected, false),
            Line::Tool(tool, spindle) => return self.change_tool(tool, spindle),
            Line::Spindle(on) => {
                self.spindle = on;
                self.given = self.given.filter(|_| on);
            }
            Line::Flood(on) => self.flood = on,
            _ => {}
        }
        self.say("ok");
    }

    pub(super) fn forbids_unlocking(&self) -> Option<u8> {
        let reasons = [(Pin::Door, 13), (Pin::EmergencyStop, 50), (Pin::DriverFault, 51)];
        reasons.into_iter().find(|(pin, _)| self.on(*pin)).map(|(_, error)| error)
    }

    pub(super) fn unlock(&mut self) {
        if self.mode == Mode::Alarm {
            if let Some(error) = self.forbids_unlocking() {
                return self.refuse(error);
            }
            self.mode = Mode::Free;
            self.say("[MSG:Caution: Unlocked]");
            // Oxmill: reports that the position can be lost; in Grbl the operator has to know.
            if !self.trusted && !self.setup.grbl {
                self.say("[MSG:The position may be lost*");
            }
        }
        self.say("ok");
    }

    /// Brakes because of a target beyond the soft limits; alarm 2 follows when the machine is at rest.
    pub(super) fn forbid(&mut self) {
        self.checked = None;
        self.work = Some(Work::Forbidden);
        self.brake();
        if self.braking.is_none() {
            self.lock_for(2);
        }
    }

    /// Returns the position at which the queued moves end. In check mode: the position at which the lines checked so
    /// far would end.
    pub(super) fn target(&self) -> Places {
        self.checked.or(self.motion.as_ref().map(|motion| motion.target)).unwrap_or(self.place)
    }

    /// Returns whether soft limits forbid a target. If an interrupted motion has left the position unknown, both
    /// outcomes are possible. Then it returns `false`, and adds to `also` a model in which the target is forbidden.
    /// `refuse`: how this model reacts.
    pub(super) fn is_forbidden(&self, target: Places, also: &mut Vec<Model>, refuse: impl Fn(&mut Model)) -> bool {
        let outside = |mm: f64| !(-TRAVEL - 1e-6..=1e-6).contains(&mm);
        if !self.setup.soft_limits {
            return false;
        }
        let known = target.iter().flatten().any(|mm| outside(*mm));
        if !known && target.contains(&None) {
            let mut refused = self.clone();
            refuse(&mut refused);
            refused.read(also);
            also.push(refused);
        }
        known
    }

    pub(super) fn travel(&mut self, axis: usize, to: f64, feed: bool, also: &mut Vec<Model>) {
        let mut target = self.target();
        target[axis] = Some(to);
        if self.is_forbidden(target, also, |model| model.forbid()) {
            return self.forbid();
        }
        let rate = if feed {
            action::FEED * f64::from(self.overrides[0]) / 100.0
        } else {
            action::RATE * f64::from(self.overrides[1]) / 100.0
        };
        if self.mode == Mode::Check {
            self.checked.get_or_insert(self.place)[axis] = Some(to);
        } else {
            if self.motion.is_none() && self.place[axis].is_none() {
                // The previous motion can have come to rest exactly at this target, so that nothing moves now.
                let mut there = self.clone();
                there.place[axis] = Some(to);
                there.end_move();
                there.read(also);
                also.push(there);
            }
            self.queue(axis, Some(to), None, rate / 60.0);
            return self.end_move();
        }
        self.forget_selected();
        self.say("ok");
    }

    /// Answers a move that has been queued or that leads to the current position. Oxmill: in single block the machine
    /// pauses after the move, and the move is answered when the pause ends.
    pub(super) fn end_move(&mut self) {
        self.forget_selected();
        if !self.single_block {
            self.say("ok");
        } else if self.motion.is_some() {
            self.work = Some(Work::SingleBlock);
        } else {
            self.carry_out(Line::Pause);
        }
    }

    pub(super) fn jog(&mut self, axis: usize, by: f64, also: &mut Vec<Model>) {
        if !self.is_idle() && self.mode != Mode::Jog {
            return self.refuse(8);
        }
        let mut target = self.target();
        target[axis] = target[axis].map(|place| place + by);
        if self.is_forbidden(target, also, |model| model.refuse(15)) {
            return self.refuse(15);
        }
        self.mode = Mode::Jog;
        self.queue(axis, target[axis], Some(by.abs()), action::FEED / 60.0);
        self.say("ok");
    }

    /// Appends a move of one axis to the queue. `to`: its target, mm, if known. `distance`: its length, mm; if
    /// `None`, the length follows from the target. `speed`: mm/s.
    pub(super) fn queue(&mut self, axis: usize, to: Option<f64>, distance: Option<f64>, speed: f64) {
        let mut target = self.target();
        let length = distance.or_else(|| Some((to? - target[axis]?).abs()));
        target[axis] = to;
        let seconds = |mm: f64| {
            let a = action::ACCELERATION;
            if mm > speed * speed / a { mm / speed + speed / a } else { 2.0 * (mm / a).sqrt() }
        };
        let time = match length {
            Some(mm) if mm < 1e-9 => Span::at(0.0),
            Some(mm) => Span { from: (mm / speed - 0.005).max(0.001), to: seconds(mm) + SLACK },
            // The start is unknown, so the move can have any length up to twice the travel plus a jog. The latest end
            // is computed for 4 times the travel, which is more than that.
            None => Span { from: 0.0, to: seconds(4.0 * TRAVEL) + SLACK },
        };
        match &mut self.motion {
            Some(motion) => {
                motion.time = motion.time.plus(time);
                motion.target = target;
                motion.speed = motion.speed.max(speed);
            }
            None if time.to > 0.0 => {
                self.motion = Some(Motion { time: self.now.plus(time), held: false, target, speed, stepped: false });
            }
            None if self.mode == Mode::Jog => self.mode = Mode::Free,
            None => {}
        }
    }
}
