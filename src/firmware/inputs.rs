//! `Inputs` has the input pins sampled and filtered, and tells `control` what has been `Sensed`; an armed input asks
//! the step task for a stop from here. It gives pins their pull-ups (`set_pulls`), counts noise, asserts that
//! `input_bits` of the board are in the controller's order, and each sample also looks at the alarm clock of `control`
//! and at the `Supervisor`.
//!
//! Sampling instead of edge interrupts: no pins clash on an interrupt line, and a bouncing switch cannot flood the CPU.
//! A change passes after eight equal samples, 0.4 ms.

use crate::boards::{self, InputPins, input_bits};
use crate::clock;
use crate::shared::{self, INPUTS, Wake};
use crate::watchdog::Supervisor;
use core::sync::atomic::Ordering;
use oxmill_controller::machine::signals;
use oxmill_controller::messages::{SECOND_SWITCH, SIGNALS_DEPTH, Sensed, Wiring, input};
use rtic_sync::channel::{Receiver, Sender};

// A board's word of inputs is the controller's.
const _: () = assert!(
    input_bits::LIMITS == 0
        && 1 << input_bits::SECOND_LIMIT == SECOND_SWITCH
        && input_bits::PROBE == input::PROBE
        && input_bits::DOOR == input::DOOR
        && input_bits::HOLD == input::HOLD
        && input_bits::START == input::START
        && input_bits::RESET == input::RESET
        && input_bits::DRIVER_FAULT == input::DRIVER_FAULT
        && input_bits::AT_SPEED == input::AT_SPEED
        && input_bits::PROGRAM == input::PROGRAM
        && input_bits::SECOND_PROGRAM == input::SECOND_PROGRAM
);

/// Everything the task owns.
pub struct Inputs {
    pins: InputPins,
    inputs: signals::Inputs,
    wiring: Receiver<'static, Wiring, 2>,
    signals: Sender<'static, Sensed, SIGNALS_DEPTH>,
    sent: Option<Sensed>,
    wake: Wake,
    supervisor: Supervisor,
}

impl Inputs {
    /// Nothing is reported before `control` has told how the inputs are wired.
    pub fn new(
        pins: InputPins,
        wiring: Receiver<'static, Wiring, 2>,
        signals: Sender<'static, Sensed, SIGNALS_DEPTH>,
        wake: Wake,
        supervisor: Supervisor,
    ) -> Inputs {
        INPUTS.fitted.store(pins.fitted(), Ordering::Relaxed);
        Inputs { pins, inputs: signals::Inputs::new(), wiring, signals, sent: None, wake, supervisor }
    }

    /// One sample.
    pub fn sample(&mut self) {
        self.supervisor.sample(&mut self.wake);
        if clock::alarm() {
            self.wake.write(());
        }
        let low = self.pins.read();
        if self.inputs.sample(low) {
            shared::ask_for_stop();
            boards::call_step();
        }
        INPUTS.low.store(low, Ordering::Relaxed);
        self.count_noise();
        if self.inputs.is_untold() {
            self.tell();
        }
        boards::calls::call_if_due();
        if !self.wiring.is_empty()
            && let Ok(wiring) = self.wiring.try_recv()
        {
            self.inputs.wire(&wiring);
            self.pins.set_pulls(wiring.inputs.no_pull_up, wiring.inputs.pull_down);
        }
    }

    /// Levels and not edges cross: if the queue is full, the newest state is sent at a later sample.
    #[inline(never)]
    fn tell(&mut self) {
        let Some(sensed) = self.inputs.sensed() else { return };
        // What has been received by now belongs before it: the serial task passes it on before `control` hears of this.
        boards::call_serial();
        let is_known = self.sent == Some(sensed);
        if is_known || self.signals.try_send(sensed).is_ok() {
            self.inputs.told();
            self.sent = self.inputs.sensed();
            if !is_known {
                self.wake.write(());
            }
        }
    }

    fn count_noise(&mut self) {
        let mut rejected = self.inputs.rejected();
        while rejected != 0 {
            if let Some(count) = INPUTS.noise.get(rejected.trailing_zeros() as usize) {
                count.store(count.load(Ordering::Relaxed).saturating_add(1), Ordering::Relaxed);
            }
            rejected &= rejected - 1;
        }
    }
}
