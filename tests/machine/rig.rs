//! Test rig: runs the simulator in process and counts the pulses of its step outputs independently of the simulator's
//! own counters.

use super::oracle::{AXES, Place, Pulse};
use oxmill_controller::messages::{Realtime, Record, Store};
use oxmill_simulator::{Options, Simulator, boards};
use std::time::Duration;

/// Step clock of the rig, Hz.
pub const HZ: u64 = boards::DESK.step_clock_hz as u64;
/// When the simulator's trace has this many pulses, `run_until` counts and removes them.
const GATHER: usize = 4096;

pub struct Rig {
    mill: Simulator,
    /// All pulses since power-up or since a test last cleared them; empty while `keep_trace` is off.
    pub trace: Vec<Pulse>,
    pub keep_trace: bool,
    /// Position since power-up according to the counted pulses, in steps.
    pub place: Place,
}

impl Rig {
    /// Returns a machine that has just been powered up; its greeting is still unread in the output.
    pub fn new() -> Rig {
        let mill = Simulator::new(Options { keep_steps: true, ..Options::default() });
        Rig { mill, trace: Vec::new(), keep_trace: true, place: [0; AXES] }
    }

    /// Returns the virtual time since power-up, s.
    pub fn seconds(&self) -> f64 {
        self.mill.clock().now() as f64 / HZ as f64
    }

    /// Sends bytes from the host; they arrive as fast as the line queue accepts them.
    pub fn send(&mut self, bytes: &[u8]) {
        self.mill.send(bytes);
        self.count();
    }

    /// Sends a realtime command ahead of any bytes that the host has already sent.
    pub fn press(&mut self, command: Realtime) {
        self.mill.press(command);
        self.count();
    }

    /// Returns the output that has not been taken yet.
    pub fn take_output(&mut self) -> String {
        self.mill.take_output()
    }

    /// Opens (`there`) or closes the host's port.
    pub fn host(&mut self, there: bool) {
        if there {
            self.mill.connect();
        } else {
            self.mill.disconnect();
        }
        self.count();
    }

    /// Cycles the power; these (key, value) settings are written to the store while it is off.
    pub fn power_cycle(&mut self, values: &[(u16, f32)]) {
        self.count();
        let mut store = self.mill.store().power_cycled().expect("a store in memory");
        for (key, value) in values {
            let value = value.to_le_bytes().as_slice().try_into().expect("a short value");
            store.apply(&Store::Put(Record { key: *key, value })).expect("room in the store");
        }
        self.mill = Simulator::new(Options { store, keep_steps: true, ..Options::default() });
    }

    /// Sets an input pin by a line of the simulator's pin protocol.
    pub fn pin(&mut self, line: &str) {
        assert_eq!(self.mill.pin_line(line), "ok", "{line}");
        self.count();
    }

    /// Moves the pulses from the simulator's trace to `trace` and adds them to `place`.
    fn count(&mut self) {
        for record in self.mill.trace().kept() {
            let pulse = Pulse { at: record.at, steps: record.steps, directions: record.directions };
            self.place = pulse.moved(self.place);
            if self.keep_trace {
                self.trace.push(pulse);
            }
        }
        self.mill.trace_mut().restart();
    }

    /// Runs the machine for `seconds` of virtual time, and counts the pulses.
    pub fn run_for(&mut self, seconds: f64) {
        self.mill.run_for(Duration::from_secs_f64(seconds));
        self.count();
    }

    /// Runs virtual time until the condition holds; returns `false` if it does not hold within `seconds`.
    pub fn run_until(&mut self, seconds: f64, mut condition: impl FnMut(&mut Rig) -> bool) -> bool {
        let end = self.mill.clock().now() + (seconds * HZ as f64) as u64;
        loop {
            if condition(self) {
                self.count();
                return true;
            }
            let goes_on = self.mill.clock().now() < end && self.mill.advance_once(end);
            if self.mill.trace().kept().len() > GATHER || !goes_on {
                self.count();
            }
            if !goes_on {
                return condition(self);
            }
        }
    }

    /// Returns whether the machine is at rest with nothing queued, pending or unanswered.
    pub fn is_idle(&self) -> bool {
        self.mill.is_idle()
    }

    /// Returns the number of output bytes that have not been read.
    pub fn output_len(&self) -> usize {
        self.mill.unfetched()
    }

    /// Returns the number of host bytes that the controller has not yet read.
    pub fn waiting(&self) -> usize {
        self.mill.unread()
    }
}
