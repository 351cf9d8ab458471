//! A machine to try: the controller and the step generator, pumped in virtual time, with a host at the other end of the
//! line.

use super::oracle::{AXES, Place, Pulse};
use oxmill_controller::messages::{Event, LINES_DEPTH, LineByte, Observed, Output, Realtime, Room, SEGMENTS_DEPTH};
use oxmill_controller::messages::{SlowOutputs, ToStep};
use oxmill_controller::units::Instant;
use oxmill_controller::{Controller, Profile, Received, Splitter, Stepper};
use std::collections::VecDeque;

/// Step clock of the rig.
pub const HZ: u64 = 84_000_000;
const BLOCKS: usize = 256;

pub struct Rig {
    controller: Box<Controller<AXES, BLOCKS>>,
    splitter: Splitter,
    stepper: Stepper<AXES>,
    host: VecDeque<u8>,
    realtime: VecDeque<Realtime>,
    lines: VecDeque<LineByte>,
    segments: VecDeque<ToStep>,
    events: VecDeque<Event<AXES>>,
    now: u64,
    next_tick: Option<u64>,
    directions: u8,
    output: Vec<u8>,
    pub trace: Vec<Pulse>,
    pub keep_trace: bool,
    pub place: Place,
    pub pins: Option<SlowOutputs>,
}

impl Rig {
    /// A new machine that has just been switched on; its greeting waits in the output.
    pub fn new() -> Rig {
        let profile = Profile { name: "rig", step_clock_hz: HZ as u32, safe_step_hz: 400_000, has_store: true };
        let mut rig = Rig {
            controller: Box::new(Controller::new(profile)),
            splitter: Splitter::new(),
            stepper: Stepper::new(),
            host: VecDeque::new(),
            realtime: VecDeque::new(),
            lines: VecDeque::new(),
            segments: VecDeque::new(),
            events: VecDeque::new(),
            now: 0,
            next_tick: None,
            directions: 0,
            output: Vec::new(),
            trace: Vec::new(),
            keep_trace: true,
            place: [0; AXES],
            pins: None,
        };
        rig.controller.start(rig.instant());
        rig.pump();
        rig
    }

    fn instant(&self) -> Instant {
        Instant::from_ticks(self.now / (HZ / 1_000_000))
    }

    /// Seconds since power-up.
    pub fn seconds(&self) -> f64 {
        self.now as f64 / HZ as f64
    }

    /// Bytes from the host; they arrive as fast as the line queue takes them.
    pub fn send(&mut self, bytes: &[u8]) {
        self.host.extend(bytes);
        self.pump();
    }

    /// What the machine has answered since the last call.
    pub fn take_output(&mut self) -> Vec<u8> {
        std::mem::take(&mut self.output)
    }

    fn receive(&mut self) {
        while self.lines.len() < LINES_DEPTH
            && let Some(byte) = self.host.pop_front()
        {
            match self.splitter.push(byte) {
                Received::Realtime(command) => {
                    if command == Realtime::Reset {
                        self.stop();
                    }
                    self.realtime.push_back(command);
                }
                Received::Line(byte) => self.lines.push_back(byte),
                Received::Nothing => {}
            }
        }
    }

    fn stop(&mut self) {
        let event = self.stepper.stop();
        self.events.push_back(Event::Step(event));
        self.next_tick = None;
    }

    /// Control's turn: events in, outputs out, until there is nothing more.
    fn pump(&mut self) {
        'turn: loop {
            self.receive();
            self.controller.observe(Observed {
                segments_begun: self.stepper.segments_begun(),
                step_idle: self.stepper.is_idle() && self.segments.is_empty(),
                rx_free: (LINES_DEPTH - self.lines.len()) as u16,
            });
            let now = self.instant();
            while let Some(event) = self.events.pop_front() {
                self.controller.event(now, event);
            }
            while let Some(command) = self.realtime.pop_front() {
                self.controller.event(now, Event::Realtime(command));
            }
            while self.controller.wants_line()
                && let Some(byte) = self.lines.pop_front()
            {
                self.controller.event(now, Event::Line(byte));
            }
            loop {
                let room = Room { step: self.segments.len() < SEGMENTS_DEPTH, reply: true };
                match self.controller.output(now, room) {
                    None => break,
                    Some(Output::Step(message)) => {
                        self.segments.push_back(message);
                        self.load();
                        if self.next_tick.is_none() && !self.stepper.is_idle() {
                            self.tick();
                        }
                        continue 'turn;
                    }
                    Some(Output::Reply(chunk)) => self.output.extend_from_slice(chunk.as_bytes()),
                    Some(Output::Pins(pins)) => self.pins = Some(pins),
                    Some(Output::Stop) => {
                        self.stop();
                        continue 'turn;
                    }
                    Some(Output::Store(_)) => {
                        self.events.push_back(Event::Stored);
                        continue 'turn;
                    }
                    Some(Output::Wiring(_) | Output::Worked) => {}
                }
            }
            let more_lines = self.controller.wants_line() && !self.lines.is_empty();
            if self.events.is_empty() && self.realtime.is_empty() && !more_lines {
                return;
            }
        }
    }

    fn load(&mut self) {
        while self.stepper.wants()
            && let Some(message) = self.segments.pop_front()
        {
            self.stepper.load(message);
        }
    }

    fn tick(&mut self) {
        self.load();
        let before = self.directions;
        let tick = self.stepper.tick();
        self.directions = tick.directions;
        if tick.steps != 0 {
            let pulse = Pulse { at: self.now, steps: tick.steps, directions: before };
            self.place = pulse.moved(self.place);
            if self.keep_trace {
                self.trace.push(pulse);
            }
        }
        self.next_tick = (tick.interval != 0).then(|| self.now + u64::from(tick.interval));
        if tick.underrun {
            self.events.push_back(Event::Step(self.stepper.underrun_event()));
        }
        self.load();
        // More has come since the generator fell asleep at the end of a motion.
        if self.next_tick.is_none() && !self.stepper.is_idle() {
            self.next_tick = Some(self.now);
        }
    }

    /// The next moment at which something happens by itself.
    fn next(&self) -> Option<u64> {
        let wakeup = self.controller.next_wakeup().map(|at| (at.ticks() * (HZ / 1_000_000)).max(self.now + 1));
        self.next_tick.into_iter().chain(wakeup).min()
    }

    /// Goes on to the next moment, but not beyond `end`. `false`: nothing happens until then.
    fn advance(&mut self, end: u64) -> bool {
        let Some(next) = self.next().filter(|&next| next <= end) else {
            self.now = self.now.max(end);
            self.pump();
            return false;
        };
        self.now = self.now.max(next);
        let begun = self.stepper.segments_begun();
        if self.next_tick == Some(next) {
            self.tick();
        }
        let woken = self.controller.next_wakeup().is_some_and(|at| at <= self.instant());
        if woken || begun != self.stepper.segments_begun() || self.next_tick.is_none() || !self.events.is_empty() {
            self.pump();
        }
        true
    }

    /// Lets virtual time pass.
    pub fn run_for(&mut self, seconds: f64) {
        let end = self.now + (seconds * HZ as f64) as u64;
        while self.advance(end) {}
    }

    /// Lets virtual time pass until the condition holds; `false` if that does not happen in `seconds`.
    pub fn run_until(&mut self, seconds: f64, mut condition: impl FnMut(&mut Rig) -> bool) -> bool {
        let end = self.now + (seconds * HZ as f64) as u64;
        self.pump();
        loop {
            if condition(self) {
                return true;
            }
            if !self.advance(end) {
                return condition(self);
            }
        }
    }

    /// Whether nothing is queued, moving, waited for or unanswered.
    pub fn is_idle(&self) -> bool {
        self.host.is_empty()
            && self.lines.is_empty()
            && self.controller.is_idle()
            && self.stepper.is_idle()
            && self.next_tick.is_none()
    }

    /// How many bytes the machine has answered that were not taken yet.
    pub fn output_len(&self) -> usize {
        self.output.len()
    }

    /// How many bytes of the host have not been taken by the controller.
    pub fn waiting(&self) -> usize {
        self.host.len() + self.lines.len()
    }
}
