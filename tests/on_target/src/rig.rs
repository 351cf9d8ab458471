//! A controller and a step generator in a loop, without tasks: as fast as the CPU goes, with time that jumps.

use oxmill_controller::axes::PerAxis;
use oxmill_controller::digest::Digest;
use oxmill_controller::messages::{Event, LINES_DEPTH, LineByte, Observed, Output, Room, Sensed};
use oxmill_controller::units::Instant;
use oxmill_controller::{Controller, Profile, StepRates, Stepper};

/// Axes.
pub const AXES: usize = 3;
/// A short look-ahead is enough here.
pub const BLOCKS: usize = 32;
/// Step clock.
const STEP_CLOCK_HZ: u32 = 25_000_000;

/// The pair, and what came out of it.
pub struct Rig {
    controller: Controller<AXES, BLOCKS>,
    stepper: Stepper<AXES>,
    /// Ticks for which the stepper was busy.
    busy: u64,
    moving: bool,
    directions: u8,
    /// Digest of the steps.
    pub digest: Digest,
    /// Steps counted at the outputs.
    pub net: [i32; AXES],
    /// `ok` and `error` seen.
    pub answers: (u32, u32),
    reply: heapless::Vec<u8, 300>,
}

impl Rig {
    /// After power-up.
    pub fn new() -> Rig {
        let profile = Profile {
            name: "rig",
            step_clock_hz: STEP_CLOCK_HZ,
            rates: StepRates { safe_hz: 200_000, attention_ns: 0 },
            has_second_motor: false,
            has_store: false,
        };
        let mut controller = Controller::new(profile);
        controller.start(Instant::from_ticks(0));
        controller.event(Instant::from_ticks(0), Event::Signals(Sensed::default()));
        Rig {
            controller,
            stepper: Stepper::new(),
            busy: 0,
            moving: false,
            directions: 0,
            digest: Digest::default(),
            net: [0; AXES],
            answers: (0, 0),
            reply: heapless::Vec::new(),
        }
    }

    /// Runs a program to its end; `each` sees every step event with the position after it.
    pub fn run(&mut self, program: &str, mut each: impl FnMut([i32; AXES])) {
        let mut bytes = program.bytes().peekable();
        loop {
            let now = Instant::from_ticks(self.busy * 1_000_000 / u64::from(STEP_CLOCK_HZ));
            let free = if bytes.peek().is_some() { 0 } else { LINES_DEPTH };
            self.controller.observe(Observed {
                segments_begun: self.stepper.segments_begun(),
                step_idle: !self.moving && self.stepper.is_idle(),
                rx_free: free as u16,
                received: u16::from(free == 0),
            });
            let mut took = false;
            while self.controller.wants_line()
                && let Some(byte) = bytes.next()
            {
                took = true;
                self.controller.event(now, Event::Line(LineByte { byte, epoch: 0, damaged: false }));
            }
            let again = self.outputs(now);
            if again || took {
                continue;
            }
            if !self.moving && self.stepper.is_idle() {
                if bytes.peek().is_none() && self.controller.is_idle() {
                    return;
                }
                continue;
            }
            self.moving = true;
            self.tick(&mut each);
        }
    }

    /// Pulls outputs until the stepper has what it wants; whether a message went there.
    fn outputs(&mut self, now: Instant) -> bool {
        loop {
            let room = Room { step: self.stepper.wants(), reply: true };
            match self.controller.output(now, room) {
                None => return false,
                Some(Output::Step(message)) => {
                    self.stepper.load(message);
                    return true;
                }
                Some(Output::Reply(chunk)) => {
                    for byte in chunk.as_bytes() {
                        if *byte == b'\n' {
                            if self.reply.starts_with(b"ok") {
                                self.answers.0 += 1;
                            } else if self.reply.starts_with(b"error") {
                                self.answers.1 += 1;
                            }
                            self.reply.clear();
                        } else {
                            self.reply.push(*byte).expect("no answer is that long");
                        }
                    }
                }
                Some(_) => {}
            }
        }
    }

    fn tick(&mut self, each: &mut impl FnMut([i32; AXES])) {
        let tick = self.stepper.tick();
        if tick.steps != 0 {
            self.digest.add(self.busy, tick.steps, self.directions);
            for (axis, net) in self.net.iter_mut().enumerate() {
                if tick.steps >> axis & 1 != 0 {
                    *net += if self.directions >> axis & 1 != 0 { -1 } else { 1 };
                }
            }
            each(self.net);
        }
        assert!(!tick.underrun, "the queue ran dry");
        self.directions = tick.directions;
        self.busy += u64::from(tick.interval);
        self.moving = tick.interval != 0;
    }

    /// The step generator's own count.
    pub fn position(&self) -> PerAxis<i32, AXES> {
        self.stepper.position()
    }
}

impl Default for Rig {
    fn default() -> Self {
        Self::new()
    }
}
