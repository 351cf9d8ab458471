//! A controller and a step generator in a loop, without tasks. The loop runs as fast as the CPU can; simulated time
//! jumps from tick to tick of the step generator.

use core::sync::atomic::{AtomicBool, Ordering};
use oxmill_controller::axes::PerAxis;
use oxmill_controller::digest::Digest;
use oxmill_controller::memory::Storage;
use oxmill_controller::messages::{Event, LINES_DEPTH, LineByte, LineBytes, Observed, Output, Room, Sensed};
use oxmill_controller::pump::{Pump, Source, round};
use oxmill_controller::units::Instant;
use oxmill_controller::{Controller, Profile, StepRates, Stepper};

/// Number of axes of this machine: X, Y and Z.
pub const AXES: usize = 3;
/// Capacity of the memory for subroutines, loops and macros, bytes.
const HELD_BYTES: usize = 6144;
/// Depth of the look-ahead; the programs here need only a short one.
pub const BLOCKS: usize = 32;
const STEP_CLOCK_HZ: u32 = 25_000_000;

/// A controller and a step generator, and what they have done: steps and answers.
pub struct Rig {
    controller: Controller<AXES>,
    stepper: Stepper<AXES>,
    /// Time during which the step generator was busy, in ticks of the step clock. It is also the controller's clock.
    busy: u64,
    moving: bool,
    directions: u8,
    /// Digest of the steps, with their times and directions.
    pub digest: Digest,
    /// Steps forward minus steps backward of each axis, counted at the outputs.
    pub net: [i32; AXES],
    /// Numbers of `ok` and of `error` replies.
    pub answers: (u32, u32),
    reply: heapless::Vec<u8, 300>,
    /// The part of the program that has not been read yet.
    program: &'static [u8],
}

/// Whether a rig exists. There is storage for only one.
static LIVES: AtomicBool = AtomicBool::new(false);

impl Drop for Rig {
    fn drop(&mut self) {
        LIVES.store(false, Ordering::Relaxed);
    }
}

impl Rig {
    /// Creates a machine after power-up.
    pub fn new() -> Rig {
        let profile = Profile {
            name: "rig",
            step_clock_hz: STEP_CLOCK_HZ,
            rates: StepRates { safe_hz: 200_000, least_pulse_tenths: 10 },
            axes: 3,
            has_second_motor: false,
            has_at_speed: true,
            program_pins: [0; 2],
            most_baud: 115_200,
            oscillator_mhz: 0,
            has_store: false,
            has_loader: false,
        };
        static mut STORAGE: Storage<AXES, BLOCKS, HELD_BYTES> = Storage::EMPTY;
        assert!(!LIVES.swap(true, Ordering::Relaxed), "one rig at a time");
        // SAFETY: unsafe because the storage is borrowed again for each rig; safe because the flag is cleared only when
        // a rig is dropped, and with it its controller, which holds the borrow.
        let storage = unsafe { (&raw mut STORAGE).as_mut_unchecked() };
        *storage = Storage::EMPTY;
        let mut controller = Controller::new(profile, storage.lend(&profile));
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
            program: &[],
        }
    }

    /// Runs a program on a new machine. Returns the net steps of each axis, the hash of all steps with their times,
    /// and the numbers of `ok` and of `error` replies.
    #[inline(never)]
    pub fn outcome(program: &'static str) -> ([i32; AXES], u64, (u32, u32)) {
        let mut rig = Rig::new();
        rig.run(program, |_| {});
        (rig.net, rig.digest.time_hash(), rig.answers)
    }

    /// Runs a program to its end; calls `each` at every step event with the position after it.
    pub fn run(&mut self, program: &'static str, mut each: impl FnMut([i32; AXES])) {
        self.program = program.as_bytes();
        loop {
            while round(self) {}
            if self.is_idle() {
                if self.program.is_empty() && self.controller.is_idle() {
                    return;
                }
                continue;
            }
            self.moving = true;
            self.tick(&mut each);
        }
    }

    fn is_idle(&self) -> bool {
        !self.moving && self.stepper.is_idle()
    }

    /// Counts the lines `ok` and `error` in the controller's output.
    fn hear(&mut self, bytes: &[u8]) {
        for byte in bytes {
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

    /// Returns the position counted by the step generator itself.
    pub fn position(&self) -> PerAxis<i32, AXES> {
        self.stepper.position()
    }
}

impl Pump<AXES> for Rig {
    const IS_WOKEN: bool = false;

    fn controller(&mut self) -> &mut Controller<AXES> {
        &mut self.controller
    }

    fn begin(&mut self) -> Instant {
        Instant::from_ticks(self.busy * 1_000_000 / u64::from(STEP_CLOCK_HZ))
    }

    fn observed(&mut self) -> Observed {
        let free = if self.program.is_empty() { LINES_DEPTH } else { 0 };
        Observed {
            segments_begun: self.stepper.segments_begun(),
            step_idle: self.is_idle(),
            rx_free: free as u16,
            received: u16::from(free == 0),
            activity: 0,
        }
    }

    /// Returns no event, because there are no stops, inputs or stored settings.
    fn next_event(&mut self, _source: Source) -> Option<Event<AXES>> {
        None
    }

    fn next_line_byte(&mut self) -> Option<LineByte> {
        let (byte, left) = self.program.split_first()?;
        self.program = left;
        Some(LineByte { byte: *byte, epoch: 0, damaged: false })
    }

    /// Passes text to the controller, at most [`LineBytes::MOST`] bytes: as many as one message between the
    /// firmware's tasks holds.
    fn give_text(&mut self, _now: Instant) -> bool {
        let ahead = self.program.get(..LineBytes::MOST).unwrap_or(self.program);
        let taken = self.controller.take_text(0, ahead);
        self.program = self.program.get(taken..).unwrap_or_default();
        taken > 0
    }

    fn make_room(&mut self, _took: bool) -> bool {
        false
    }

    fn room(&mut self) -> Room {
        Room { step: self.stepper.has_room(), reply: true }
    }

    fn carry(&mut self, output: Output) {
        match output {
            Output::Step(message) => self.stepper.load(message),
            Output::Reply(chunk) | Output::Answer(chunk) => self.hear(chunk.as_bytes()),
            Output::Pins(_) | Output::Wiring(_) | Output::Worked => {}
            Output::Stop | Output::Store | Output::ReadPins { .. } | Output::ReadRecording { .. } => {
                panic!("nothing here answers that")
            }
        }
    }
}

impl Default for Rig {
    fn default() -> Self {
        Self::new()
    }
}
