//! Samples the input pins, filters them, and tells `control` what changed. Also looks at the alarm clock of `control`, and
//! whether all tasks are alive.
//!
//! Sampling instead of edge interrupts: no pins clash on an interrupt line, and a bouncing switch cannot flood the CPU.
//! A change passes after eight equal samples, 0.4 ms.

use crate::boards::{InputPins, input_bits};
use crate::clock;
use crate::crossing::Wake;
use crate::watchdog::Supervisor;
use oxmill_controller::machine::filter::Filter;
use oxmill_controller::messages::{SIGNALS_DEPTH, Signals, Wiring};
use rtic_sync::channel::{Receiver, Sender};

/// Everything the task owns.
pub struct Inputs {
    pins: InputPins,
    filter: Filter,
    /// Which inputs are active while their pin is high.
    inverted: u16,
    wiring: Receiver<'static, Wiring, 2>,
    signals: Sender<'static, Signals, SIGNALS_DEPTH>,
    sent: Signals,
    wake: Wake,
    supervisor: Supervisor,
}

impl Inputs {
    /// All inputs count as inactive until they have been sampled often enough.
    pub fn new(
        pins: InputPins,
        wiring: Receiver<'static, Wiring, 2>,
        signals: Sender<'static, Signals, SIGNALS_DEPTH>,
        wake: Wake,
        supervisor: Supervisor,
    ) -> Inputs {
        Inputs { pins, filter: Filter::new(), inverted: 0, wiring, signals, sent: Signals::default(), wake, supervisor }
    }

    /// One sample.
    pub fn sample(&mut self) {
        self.supervisor.sample(&mut self.wake);
        if clock::alarm() {
            self.wake.write(());
        }
        let active = self.filter.sample(self.pins.read() ^ self.inverted);
        let signals = signals(active);
        // Levels and not edges cross: if the queue is full, the newest state is sent at a later sample.
        if signals != self.sent && self.signals.try_send(signals).is_ok() {
            self.sent = signals;
            self.wake.write(());
        }
        if !self.wiring.is_empty()
            && let Ok(wiring) = self.wiring.try_recv()
        {
            let limits = if wiring.limit_invert { 0xFF << input_bits::LIMITS } else { 0 };
            let probe = u16::from(wiring.probe_invert) << input_bits::PROBE;
            let control = |bit: u8, input: u32| u16::from(wiring.control_invert >> bit & 1) << input;
            self.inverted = limits
                | probe
                | control(0, input_bits::RESET)
                | control(1, input_bits::HOLD)
                | control(2, input_bits::START)
                | control(3, input_bits::DOOR);
        }
    }
}

/// Bits to names.
fn signals(active: u16) -> Signals {
    let bit = |n: u32| active >> n & 1 != 0;
    Signals {
        limits: (active >> input_bits::LIMITS) as u8 & ((1 << crate::boards::AXES) - 1),
        probe: bit(input_bits::PROBE),
        door: bit(input_bits::DOOR),
        hold: bit(input_bits::HOLD),
        start: bit(input_bits::START),
        reset: bit(input_bits::RESET),
    }
}
