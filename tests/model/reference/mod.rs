//! The reference: a plain model of what a Grbl controller does with what a host and an operator do.
//!
//! Written from Grbl's interface and from what Oxmill's book says that it does otherwise, not from the controller; such a
//! place is marked "Oxmill:". It knows no steps: a motion is a stretch of time at whose end the machine is at a place.
//! Times are known to within a [`Span`], from what rate and acceleration allow. Where an instant decides and the span
//! covers it, the model becomes two, one for each outcome, and what the machine does next tells which of them holds. It is
//! open about nothing else but this:
//! * how far a motion got that was stopped: the place is taken from the report;
//! * whether a motion of which no step has been seen yet is one to a reset, an emergency and a hold;
//! * whether a silence of the host or a line that waits comes first, of two in the same moment;
//! * whether a target is within the soft limits while it is not known where a motion came to rest;
//! * numbers within messages and listings (`*`), and how many lines a listing has ([`MANY`]).

mod commands;
mod faults;
mod homing;
mod lines;
mod stops;

use super::action::{self, Action, Line, PINS, Pin, Setup};
use homing::Homing;
use std::collections::VecDeque;

/// In place of any number of lines of a listing.
pub const MANY: &str = "[listing]";
/// Slack of all times, s: what is queued for the step task, and the end of a segment.
const SLACK: f64 = 0.035;
/// Spindle on to coolant on, coolant on to motion after a door, s.
const RESTORE: [f64; 2] = [4.0, 1.0];

/// A stretch of time in which something happens, s; also a length of time that is not known exactly.
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

    /// A length of `seconds` that may take `more`.
    fn length(seconds: f64, more: f64) -> Span {
        Span { from: (seconds - 0.005).max(0.0), to: seconds + more + SLACK }
    }
}

/// mm, as far as it is known.
type Places = [Option<f64>; 3];

/// Moves that are queued or carried out.
#[derive(Clone, Debug, PartialEq)]
struct Motion {
    /// When it ends, or while it is held: how much is left.
    time: Span,
    held: bool,
    target: Places,
    /// Greatest speed of its moves, mm/s.
    speed: f64,
    /// A step has been seen since it began or was resumed.
    stepped: bool,
}

/// What the line is doing that is carried out and not answered.
#[derive(Clone, Debug, PartialEq)]
enum Work {
    /// Waits for the end of the motion.
    Drain(Line),
    /// Ends then; while held, the rest of the time.
    Dwell { time: Span, held: bool },
    /// M0, until the next cycle start.
    Pause,
    /// Oxmill: the motion of the line, behind which single block pauses.
    SingleBlock,
    /// Oxmill: M6 asks for this tool, until the next cycle start. `spindle`: its line turns the spindle on then.
    Tool { tool: u8, spindle: bool },
    /// A jog behind one that 0x85 has ended.
    LaterJog(Line),
    /// A target that is forbidden: locks where the machine has come to rest, and a hold or a door is over.
    Forbidden,
    /// `$H`.
    Homing,
    /// Cannot be ended: answered when a reset comes.
    Owed,
}

#[derive(Clone, Debug, PartialEq)]
enum Mode {
    /// Idle, or Run while there is a motion.
    Free,
    Jog,
    Hold,
    /// Oxmill: brakes for a fault, whose alarm follows at rest, and with it the name of another limit switch that closed `later`.
    Fault {
        alarm: u8,
        later: bool,
    },
    /// 0x19 brakes; then everything is forgotten. Oxmill: Grbl has no such command.
    Stop,
    Door {
        restoring: Option<Span>,
    },
    Home(Homing),
    Alarm,
    /// Only a reset is heard.
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
    /// When a motion that is being stopped rests.
    braking: Option<Span>,
    /// No host is there.
    absent: bool,
    /// When the host was heard last, or there was nothing yet to watch it for.
    heard: Span,
    /// Since when the spindle has been below its speed.
    slow: Option<Span>,
    /// The override of a spindle that turns, as it was looked at last while lines could be carried out, and until when
    /// that speed is given time.
    given: Option<(u32, Span)>,
    /// Oxmill: a door that stands for a host that has gone leaves the outputs on.
    keeps_outputs: bool,
    /// What it has not carried out at rest behind a door will not be carried out.
    forgets: bool,
    work: Option<Work>,
    /// Lines not looked at yet.
    waiting: VecDeque<Line>,
    /// How many of them came before a command that ends jogs.
    cancelled: usize,
    /// That command was 0x85: a jog behind it begins where the one before it comes to rest.
    keeps_later_jogs: bool,
    place: Places,
    /// Where the lines of check mode would have led.
    checked: Option<Places>,
    pins: [bool; PINS.len()],
    /// Whether the counters agree with the machine.
    trusted: bool,
    spindle: bool,
    /// The operator has stopped the spindle in a hold.
    spindle_stopped: bool,
    /// That has been asked for, and the hold still brakes.
    stops_at_rest: bool,
    flood: bool,
    /// Oxmill: 0x89, a pause behind each line that moves.
    single_block: bool,
    /// The tools of T and M6.
    selected: u8,
    tool: u8,
    /// Door, sleep and alarms switch both off.
    outputs_off: bool,
    /// Feed, rapid, spindle; percent.
    overrides: [u32; 3],
    /// What has been said since the last action, as patterns.
    pub said: Vec<String>,
    /// A step may come in this action.
    pub may_step: bool,
    /// Steps must come in this action.
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
            // Where there are switches, only they can tell.
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

    // What is seen from outside

    /// The first field of a report.
    pub fn state(&self) -> &'static str {
        let braking = self.braking.is_some();
        match &self.mode {
            // Oxmill: also while it brakes before a forbidden target, where Grbl shows a hold.
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

    /// The active pins, as a report has them.
    pub fn reported_pins(&self) -> String {
        let letter = |(index, on): (usize, &bool)| on.then_some(PINS[index].1);
        self.pins.iter().enumerate().filter_map(letter).collect()
    }

    pub fn overrides(&self) -> [u32; 3] {
        self.overrides
    }

    /// Spindle speed, rpm.
    pub fn spindle_speed(&self) -> u32 {
        if self.turns() { (action::SPINDLE * f64::from(self.overrides[2]) / 100.0) as u32 } else { 0 }
    }

    /// Spindle and flood coolant, as a report has them.
    pub fn accessories(&self) -> String {
        let flood = self.flood && !self.outputs_off && (self.keeps_outputs || !self.restores_spindle());
        [(self.turns(), 'S'), (flood, 'F')].into_iter().filter(|(on, _)| *on).map(|(_, letter)| letter).collect()
    }

    /// Where it rests; `None` while it moves.
    pub fn place(&self) -> Option<[Option<f64>; 3]> {
        (!self.moves()).then_some(self.place)
    }

    /// Where it came to rest and whether a step came, of which only the machine knows.
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

    /// The spindle gets up to speed behind a door, and the coolant is still off.
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

    /// Whether a host that counts characters would send this now, and hands press one button at a time.
    pub fn is_sensible(&self, action: &Action) -> bool {
        match action {
            Action::Line(_) => self.waiting.len() < 4,
            Action::Pin(pin, on) => {
                let stops = [Pin::EmergencyStop, Pin::DriverFault];
                let other = stops.iter().any(|stop| stop != pin && self.on(*stop));
                self.on(*pin) != *on && !(*on && stops.contains(pin) && other)
            }
            Action::Byte(_) | Action::Pass(_) => true,
            // Lines that turn it on, and delays of doors, would wait for it.
            Action::SlowSpindle(_) => {
                let waits = !self.waiting.is_empty() || !matches!(self.work, None | Some(Work::SingleBlock));
                self.mode == Mode::Free && self.motion.is_some() && !waits
            }
            // What would be answered meanwhile is answered to nobody.
            Action::Absent(_) => self.waiting.is_empty() && self.work.is_none(),
        }
    }

    /// What may come of an action.
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
                // It has told that it is up to speed.
                *given = model.now;
            }
        }
        all
    }

    /// Whatever happens until then.
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

    /// When something ends by itself; there is never more than one such thing.
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

    /// Oxmill: how long the host may be silent now, s: in mid-job and during a jog.
    fn watched(&self) -> Option<f64> {
        match self.mode {
            Mode::Free if self.setup.watch && self.is_at_work() => Some(action::JOB_SILENCE),
            Mode::Jog if self.setup.watch && self.braking.is_none() => Some(action::JOG_SILENCE),
            _ => None,
        }
    }

    /// Oxmill: after another direction or override a spindle has some time to come up to speed.
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

    /// Oxmill: a spindle may be below its speed for so long in mid-job.
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

    /// A line that waits for that is carried out.
    fn motion_has_ended(&mut self) {
        match self.work.take() {
            Some(Work::Drain(line)) => self.carry_out(line),
            Some(Work::SingleBlock) => self.carry_out(Line::Pause),
            _ => {}
        }
    }

    /// What [`Model::timer`] tells has ended.
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
