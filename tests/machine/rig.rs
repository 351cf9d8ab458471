//! A machine to try: the simulator in process, with the pulses of its step outputs counted apart from it.

use super::oracle::{AXES, Place, Pulse};
use oxmill_controller::messages::{Realtime, Record, Store};
use oxmill_simulator::{Options, Simulator, boards};
use std::time::Duration;

/// Step clock of the rig.
pub const HZ: u64 = boards::DESK.step_clock_hz as u64;
/// Pulses that the simulator may gather before they are counted.
const GATHER: usize = 4096;

pub struct Rig {
    mill: Simulator,
    /// All pulses, unless `keep_trace` is off or somebody cleared it.
    pub trace: Vec<Pulse>,
    pub keep_trace: bool,
    /// Where the counted pulses have brought the machine since power-up.
    pub place: Place,
}

impl Rig {
    /// A new machine that has just been switched on; its greeting waits in the output.
    pub fn new() -> Rig {
        let mill = Simulator::new(Options { keep_steps: true, ..Options::default() });
        Rig { mill, trace: Vec::new(), keep_trace: true, place: [0; AXES] }
    }

    /// Seconds since power-up.
    pub fn seconds(&self) -> f64 {
        self.mill.clock().now() as f64 / HZ as f64
    }

    /// Bytes from the host; they arrive as fast as the line queue takes them.
    pub fn send(&mut self, bytes: &[u8]) {
        self.mill.send(bytes);
        self.count();
    }

    /// A realtime command that does not wait behind what the host has sent.
    pub fn press(&mut self, command: Realtime) {
        self.mill.press(command);
        self.count();
    }

    /// What the machine has answered since the last call.
    pub fn take_output(&mut self) -> String {
        self.mill.take_output()
    }

    /// The host opens the port, or leaves it.
    pub fn host(&mut self, there: bool) {
        if there {
            self.mill.connect();
        } else {
            self.mill.disconnect();
        }
        self.count();
    }

    /// The power goes and comes back; meanwhile these values of settings have been stored.
    pub fn power_cycle(&mut self, values: &[(u16, f32)]) {
        self.count();
        let mut store = self.mill.store().power_cycled().expect("a store in memory");
        for (key, value) in values {
            let value = value.to_le_bytes().as_slice().try_into().expect("a short value");
            store.apply(&Store::Put(Record { key: *key, value })).expect("room in the store");
        }
        self.mill = Simulator::new(Options { store, keep_steps: true, ..Options::default() });
    }

    /// Moves an input pin, in the words of the simulator's pin protocol.
    pub fn pin(&mut self, line: &str) {
        assert_eq!(self.mill.pin_line(line), "ok", "{line}");
        self.count();
    }

    /// Counts the pulses of the simulator's trace and takes them out of it.
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

    /// Lets virtual time pass.
    pub fn run_for(&mut self, seconds: f64) {
        self.mill.run_for(Duration::from_secs_f64(seconds));
        self.count();
    }

    /// Lets virtual time pass until the condition holds; `false` if that does not happen in `seconds`.
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

    /// Whether nothing is queued, moving, waited for or unanswered.
    pub fn is_idle(&self) -> bool {
        self.mill.is_idle()
    }

    /// How many bytes the machine has answered that were not taken yet.
    pub fn output_len(&self) -> usize {
        self.mill.unfetched()
    }

    /// How many bytes of the host have not been taken by the controller.
    pub fn waiting(&self) -> usize {
        self.mill.unread()
    }
}
