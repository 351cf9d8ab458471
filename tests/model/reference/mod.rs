//! Reference model: a plain description of how a Grbl controller reacts to a host and an operator.
//!
//! The model was written from Grbl's interface and from the differences that Oxmill's book lists, not from the
//! controller. The word "Oxmill:" marks such a difference. The model has no steps: a motion is a period of time, and
//! at its end the machine is at a position.
//!
//! Rate and acceleration give the time of an event only roughly, as a [`Span`] from the earliest to the latest time.
//! If an action ends within this span, the event may or may not have happened. Then the model splits in two, one for
//! each outcome, and what the machine does next shows which one holds. Apart from these spans, the model leaves only
//! this open:
//! * how far an interrupted motion got: the position is taken from the report;
//! * whether a motion that has made no step so far counts as a motion at a reset, an emergency or a hold;
//! * the order of a host timeout and a waiting line that are due at the same time;
//! * whether a target is within the soft limits while the end position of a motion is unknown;
//! * numbers within messages and listings (`*`), and the number of lines of a listing ([`MANY`]).

mod commands;
mod faults;
mod homing;
mod lines;
mod stops;

use super::action::{self, Action, Line, PINS, Pin, Setup};
use homing::Homing;
use std::collections::VecDeque;

/// Pattern for any number of lines of a listing.
pub const MANY: &str = "[listing]";
/// Tolerance of all times, s. Motion goes on for some time after a stop, because the step task first completes the
/// segments that are already queued.
const SLACK: f64 = 0.035;
/// Delays after a door has closed and the job is resumed, s: from spindle on to coolant on, and from coolant on to
/// motion.
const RESTORE: [f64; 2] = [4.0, 1.0];

/// The earliest and the latest time of an event, s; also the minimum and maximum of a duration.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Span {
    pub from: f64,
    pub to: f64,
}

impl Span {
    fn at(moment: f64) -> Span {
        Span { from: moment, to: moment }
    }

    fn plus(self, length: Span) -> Span {
        Span { from: self.from + length.from, to: self.to + length.to }
    }

    /// Returns the span of a duration. The shortest duration is `seconds` minus 5 ms. The longest is the sum of
    /// `seconds`, `more` and [`SLACK`].
    fn length(seconds: f64, more: f64) -> Span {
        Span { from: (seconds - 0.005).max(0.0), to: seconds + more + SLACK }
    }
}

/// Positions in mm; `None` where unknown.
type Places = [Option<f64>; 3];

/// Moves that are queued or in progress.
#[derive(Clone, Debug, PartialEq)]
struct Motion {
    /// Time in s at which the motion ends. While the motion is interrupted (`held`), this is the remaining duration
    /// instead.
    time: Span,
    held: bool,
    target: Places,
    /// Maximum speed of the moves, mm/s.
    speed: f64,
    /// Whether a step has been seen since the motion started or was resumed.
    stepped: bool,
}

/// Activity of the line that is in progress and unanswered.
#[derive(Clone, Debug, PartialEq)]
enum Work {
    /// Waits for the end of the motion.
    Drain(Line),
    /// `time`: time in s at which the dwell ends. While the dwell is interrupted (`held`), this is the remaining
    /// duration instead.
    Dwell { time: Span, held: bool },
    /// M0, until the next cycle start.
    Pause,
    /// Oxmill: in single block, the motion of a line is in progress. The machine pauses when the motion ends.
    SingleBlock,
    /// Oxmill: M6 waits for the cycle start that confirms this tool. `spindle`: the same line then turns the spindle
    /// on.
    Tool { tool: u8, spindle: bool },
    /// A jog that arrived while the machine braked after the jog cancel 0x85. It starts when the machine is at rest.
    LaterJog(Line),
    /// The target of a move is forbidden. The machine locks when it has come to rest and any hold or door state has
    /// ended.
    Forbidden,
    /// `$H`.
    Homing,
    /// An alarm has ended the activity; the line is answered at the reset.
    Unanswered,
}

#[derive(Clone, Debug, PartialEq)]
enum Mode {
    /// Idle, or Run while there is a motion.
    Free,
    Jog,
    Hold,
    /// Oxmill: brakes for a fault. The alarm follows when the machine is at rest. `later`: another limit switch closed
    /// while the machine braked; this is reported after the alarm.
    Fault {
        alarm: u8,
        later: bool,
    },
    /// 0x19 brakes, then drops everything. Oxmill: Grbl has no such command.
    Stop,
    Door {
        restoring: Option<Span>,
    },
    Home(Homing),
    Alarm,
    /// Only a reset is accepted.
    Critical,
    Check,
    Sleep,
}

#[derive(Clone, Debug, PartialEq)]
pub struct Model {
    pub setup: Setup,
    now: Span,
    mode: Mode,
    motion: Option<Motion>,
    /// Time at which a motion that is being stopped comes to rest; `None` if the machine does not brake.
    braking: Option<Span>,
    /// Whether the host has disconnected while a job was being resumed after a door. The fault then takes effect when
    /// the motion continues.
    absent: bool,
    /// Time from which the host timeout counts: the host's most recent byte, or the start of the state in which the
    /// timeout applies, whichever is later.
    heard: Span,
    /// Time at which the spindle fell below its speed; `None` if it is at speed.
    slow: Option<Span>,
    /// The latest spindle override (percent), and the time by which the spindle must have reached its speed with this
    /// override. `None` if the spindle is off. A change of the override counts only in states that carry out lines.
    given: Option<(u32, Span)>,
    /// Oxmill: whether spindle and coolant stay on while a job waits in a door state for its host (`$928=5`).
    keeps_outputs: bool,
    /// Whether the motion is dropped as soon as the machine comes to rest in a door state. This happens to jogs, and
    /// to jobs stopped by 0x19.
    forgets: bool,
    work: Option<Work>,
    /// Lines that have arrived and that the controller has not yet read.
    waiting: VecDeque<Line>,
    /// Number of lines in `waiting` that arrived before a command that ends jogs.
    cancelled: usize,
    /// Whether the command that ends jogs was 0x85. If so, a jog that arrives later starts where the previous one comes
    /// to rest.
    keeps_later_jogs: bool,
    place: Places,
    /// In check mode: the position at which the lines checked so far would have ended. `None` before the first line
    /// that moves.
    checked: Option<Places>,
    pins: [bool; PINS.len()],
    /// Whether the counted position agrees with the machine.
    trusted: bool,
    spindle: bool,
    /// Whether the operator has stopped the spindle in a hold.
    spindle_stopped: bool,
    /// Whether the operator has requested to stop the spindle while the hold was still braking.
    stops_at_rest: bool,
    flood: bool,
    /// Oxmill: whether single block (0x89) is on, in which the machine pauses after each line that moves.
    single_block: bool,
    /// Tool selected by T.
    selected: u8,
    /// Tool loaded by M6.
    tool: u8,
    /// Whether a door, sleep or an alarm has switched spindle and coolant off.
    outputs_off: bool,
    /// Feed, rapid, spindle overrides; percent.
    overrides: [u32; 3],
    /// Expected output since the last action, as patterns.
    pub said: Vec<String>,
    /// `false`: a step during this action is a fault.
    pub may_step: bool,
    /// Whether the machine must make at least one step during this action.
    pub must_step: bool,
}

impl Model {
    pub fn new(setup: Setup) -> Model {
        Model {
            setup,
            now: Span::at(0.0),
            mode: Mode::Free,
            motion: None,
            braking: None,
            absent: false,
            heard: Span::at(0.0),
            slow: None,
            given: None,
            keeps_outputs: false,
            forgets: false,
            work: None,
            waiting: VecDeque::new(),
            cancelled: 0,
            keeps_later_jogs: false,
            place: [Some(0.0); 3],
            checked: None,
            pins: [false; PINS.len()],
            // If homing is enabled, the position is trusted only after a homing cycle.
            trusted: !setup.homing,
            spindle: false,
            spindle_stopped: false,
            stops_at_rest: false,
            flood: false,
            single_block: false,
            selected: 0,
            tool: 0,
            outputs_off: false,
            overrides: [100; 3],
            said: Vec::new(),
            may_step: false,
            must_step: false,
        }
    }

    // Visible behaviour

    /// Returns the state, the first field of a status report.
    pub fn state(&self) -> &'static str {
        let braking = self.braking.is_some();
        match &self.mode {
            // Oxmill reports Run even while the machine brakes before a forbidden target. Grbl reports a hold there.
            Mode::Free if self.motion.is_some() => "Run",
            Mode::Free => "Idle",
            Mode::Jog => "Jog",
            Mode::Hold if braking => "Hold:1",
            Mode::Hold => "Hold:0",
            Mode::Stop | Mode::Fault { .. } => "Hold:1",
            Mode::Door { restoring: Some(_) } => "Door:3",
            Mode::Door { .. } if braking => "Door:2",
            Mode::Door { .. } if self.on(Pin::Door) => "Door:1",
            Mode::Door { .. } => "Door:0",
            Mode::Home(_) => "Home",
            Mode::Alarm | Mode::Critical => "Alarm",
            Mode::Check => "Check",
            Mode::Sleep => "Sleep",
        }
    }

    /// Returns the letters of the active pins, as in a report.
    pub fn reported_pins(&self) -> String {
        let letter = |(index, on): (usize, &bool)| on.then_some(PINS[index].1);
        self.pins.iter().enumerate().filter_map(letter).collect()
    }

    pub fn overrides(&self) -> [u32; 3] {
        self.overrides
    }

    /// Returns the spindle speed, rpm.
    pub fn spindle_speed(&self) -> u32 {
        if self.turns() { (action::SPINDLE * f64::from(self.overrides[2]) / 100.0) as u32 } else { 0 }
    }

    /// Returns the letters of spindle and flood coolant, as in a report.
    pub fn accessories(&self) -> String {
        let flood = self.flood && !self.outputs_off && (self.keeps_outputs || !self.restores_spindle());
        [(self.turns(), 'S'), (flood, 'F')].into_iter().filter(|(on, _)| *on).map(|(_, letter)| letter).collect()
    }

    /// Returns the position at rest; `None` while the machine moves.
    pub fn place(&self) -> Option<[Option<f64>; 3]> {
        (!self.moves()).then_some(self.place)
    }

    /// Copies two facts from the machine that the model cannot predict: the position at which the machine came to rest,
    /// and whether a step occurred.
    pub fn adopt(&mut self, place: [f64; 3], stepped: bool) {
        if let Some(motion) = &mut self.motion {
            motion.stepped |= stepped && !motion.held;
        }
        if !self.moves() {
            self.place = place.map(Some);
        }
    }

    fn turns(&self) -> bool {
        self.spindle && !self.spindle_stopped && !self.outputs_off
    }

    /// Returns whether the machine is in the first delay after a door: the spindle spins up, and the coolant is still
    /// off.
    fn restores_spindle(&self) -> bool {
        let Mode::Door { restoring: Some(end) } = self.mode else { return false };
        self.spindle && end.from - self.now.to > RESTORE[1]
    }

    fn moves(&self) -> bool {
        self.braking.is_some()
            || matches!(self.mode, Mode::Home(_))
            || self.motion.as_ref().is_some_and(|motion| !motion.held)
    }

    fn on(&self, pin: Pin) -> bool {
        self.pins[pin.index()]
    }

    fn say(&mut self, text: impl Into<String>) {
        self.said.push(text.into());
    }

    // Actions and time

    /// Returns whether the action is realistic: a host that counts characters would send this line, or an operator
    /// would press this button.
    pub fn is_sensible(&self, action: &Action) -> bool {
        match action {
            Action::Line(_) => self.waiting.len() < 4,
            Action::Pin(pin, on) => {
                let stops = [Pin::EmergencyStop, Pin::DriverFault];
                let other = stops.iter().any(|stop| stop != pin && self.on(*stop));
                self.on(*pin) != *on && !(*on && stops.contains(pin) && other)
            }
            Action::Byte(_) | Action::Pass(_) => true,
            // While the spindle is slow, no line that turns it on and no delay after a door may occur: they would wait
            // for the at-speed signal.
            Action::SlowSpindle(_) => {
                let waits = !self.waiting.is_empty() || !matches!(self.work, None | Some(Work::SingleBlock));
                self.mode == Mode::Free && self.motion.is_some() && !waits
            }
            // With no host connected, nobody would receive the answers.
            Action::Absent(_) => self.waiting.is_empty() && self.work.is_none(),
        }
    }

    /// Returns the models that are possible after an action, at least one.
    pub fn act(&self, action: &Action) -> Vec<Model> {
        let mut model =
            Model { said: Vec::new(), may_step: self.moves(), must_step: false, heard: self.now, ..self.clone() };
        let mut also = Vec::new();
        let mut end = self.now.from;
        match action {
            Action::Line(line) => {
                model.waiting.push_back(*line);
                model.read(&mut also);
            }
            Action::Byte(byte) => model.command(*byte, &mut also),
            Action::Pin(pin, on) => model.pin(*pin, *on, &mut also),
            Action::Pass(seconds) => {
                end += seconds;
                model.must_step =
                    *seconds >= 0.1 && model.motion.as_ref().is_some_and(|m| !m.held && m.time.from > end);
            }
            Action::Absent(seconds) => {
                end += seconds;
                model.host_goes(&mut also);
            }
            Action::SlowSpindle(seconds) => {
                end += seconds;
                model.slow = Some(self.now);
            }
        }
        also.push(model);
        let mut all = Vec::new();
        for mut model in also {
            model.look_at_spindle();
            model.advance(end, &mut all);
        }
        if matches!(action, Action::Absent(_)) {
            all.iter_mut().for_each(Model::host_comes);
        }
        for model in &mut all {
            if model.slow.take().is_some()
                && let Some((_, given)) = &mut model.given
            {
                // The spindle has signalled that it is at speed.
                *given = model.now;
            }
        }
        all
    }

    /// Advances to the time `end`, s, and handles all events until then. Each model that is possible at that time is
    /// appended to `all`.
    fn advance(mut self, end: f64, all: &mut Vec<Model>) {
        self.may_step |= self.moves();
        let ends = [self.next_end(), self.next_silence(), self.next_slowness()];
        let last = ends.iter().flatten().fold(end, |last, span| last.min(span.to)).max(self.now.from);
        if ends.iter().flatten().all(|span| span.to > end) {
            let mut later = self.clone();
            later.end_no_sooner(end);
            later.now = Span::at(end);
            all.push(later);
        }
        for (index, span) in ends.into_iter().enumerate() {
            let Some(span) = span.filter(|span| span.from <= last) else { continue };
            let mut model = self.clone();
            model.now = Span { from: span.from.max(self.now.from), to: last };
            model.end_no_sooner(model.now.from);
            let watched = model.watched().is_some();
            let mut also = Vec::new();
            match index {
                0 => model.happen(&mut also),
                1 => model.host_is_silent(&mut also),
                _ => model.spindle_is_slow(&mut also),
            }
            also.push(model);
            for mut model in also {
                if !watched {
                    model.heard = model.now;
                }
                model.look_at_spindle();
                model.advance(end, all);
            }
        }
    }

    /// Returns the end time of the activity that ends by itself, without an event from outside. There is never more
    /// than one such activity.
    fn timer(&mut self) -> Option<&mut Span> {
        if let Some(span) = &mut self.braking {
            return Some(span);
        }
        match (&mut self.mode, &mut self.motion, &mut self.work) {
            (Mode::Door { restoring: Some(span) }, ..) => Some(span),
            (Mode::Home(homing), ..) => Some(&mut homing.time),
            (_, Some(Motion { time, held: false, .. }), _) => Some(time),
            (_, _, Some(Work::Dwell { time, held: false })) => Some(time),
            _ => None,
        }
    }

    fn next_end(&mut self) -> Option<Span> {
        self.timer().map(|span| *span)
    }

    /// Oxmill: returns the host timeout that applies now, s. It differs between a job and a jog; `None` in other
    /// states.
    fn watched(&self) -> Option<f64> {
        match self.mode {
            Mode::Free if self.setup.watch && self.is_at_work() => Some(action::JOB_SILENCE),
            Mode::Jog if self.setup.watch && self.braking.is_none() => Some(action::JOG_SILENCE),
            _ => None,
        }
    }

    /// Oxmill: allows the spindle time to reach its speed after it was turned on or its override changed.
    fn look_at_spindle(&mut self) {
        if !self.turns() {
            self.given = None;
        } else if self.mode == Mode::Free && self.given.is_none_or(|(percent, _)| percent != self.overrides[2]) {
            self.given =
                Some((self.overrides[2], self.now.plus(Span { from: action::SPIN_UP, to: action::SPIN_UP + 0.003 })));
        }
    }

    fn is_at_work(&self) -> bool {
        self.motion.is_some() || self.work.is_some()
    }

    /// Oxmill: returns the time at which the controller stops the job because the spindle has been below its speed
    /// for too long. `None` if the spindle is at speed, or if no job needs the spindle.
    fn next_slowness(&self) -> Option<Span> {
        let needs_speed = self.mode == Mode::Free && self.is_at_work() && self.turns() && self.setup.at_speed;
        let slow = self.slow.filter(|_| needs_speed)?;
        let (_, given) = self.given?;
        let slow = slow.plus(Span::at(action::SLOW_FOR));
        Some(Span { from: slow.from.max(given.from), to: slow.to.max(given.to) + 0.003 })
    }

    fn next_silence(&self) -> Option<Span> {
        self.watched().map(|longest| self.heard.plus(Span { from: longest, to: longest + 0.003 }))
    }

    fn end_no_sooner(&mut self, than: f64) {
        if let Some(span) = self.timer() {
            span.from = span.from.max(than);
        }
        if let Some(slow) = &mut self.slow {
            slow.from = slow.from.max(than - action::SLOW_FOR - 0.003);
        }
        if let Some(longest) = self.watched() {
            self.heard.from = self.heard.from.max(than - longest - 0.003);
        }
    }

    /// Carries out a line that was waiting for the end of the motion.
    fn motion_has_ended(&mut self) {
        match self.work.take() {
            Some(Work::Drain(line)) => self.carry_out(line),
            Some(Work::SingleBlock) => self.carry_out(Line::Pause),
            _ => {}
        }
    }

    /// Handles the end of the activity whose end time [`Model::timer`] returned.
    fn happen(&mut self, also: &mut Vec<Model>) {
        if self.braking.take().is_some() {
            self.rest(also);
        } else if let Mode::Door { restoring: Some(_) } = self.mode {
            self.go_on(also);
        } else if matches!(self.mode, Mode::Home(_)) {
            self.homing_phase_ends(also);
        } else if let Some(motion) = self.motion.take() {
            self.place = motion.target;
            if self.mode == Mode::Jog {
                self.mode = Mode::Free;
            }
            self.motion_has_ended();
            self.read(also);
        } else if let Some(Work::Dwell { .. }) = self.work.take() {
            self.say("ok");
            self.read(also);
        }
    }
}
