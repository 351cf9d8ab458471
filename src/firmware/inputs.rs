//! Samples and filters the input pins, and reports changes to `control`. If an input that is armed to stop the machine
//! becomes active, requests a stop of the step task. Also counts, for each input, the changes that the filter rejects
//! as noise.
//!
//! At each sample, this task also runs the `Supervisor` of the watchdog and checks the alarm clock of `control`. It
//! reads the bytes received by the UART and calls the serial task for them.
//!
//! Inputs are sampled and have no edge interrupts. So two pins never compete for an interrupt line, and a bouncing
//! switch cannot flood the processor with interrupts. A changed level takes effect after eight equal samples (0.4 ms).

use crate::boards::calls::Calls;
use crate::boards::{self, InputPins, UartInput, input_bits};
use crate::clock::Alarm;
use crate::shared::{self, INPUTS, Wake};
use crate::watchdog::Supervisor;
use core::sync::atomic::Ordering;
use oxmill_controller::machine::signals;
use oxmill_controller::messages::{SECOND_SWITCH, SIGNALS_DEPTH, Sensed, Wiring, input};
use rtic_sync::channel::{Receiver, Sender};
use rtic_sync::signal::SignalReader;

// Each input must have the same bit number in the boards' code as in the controller.
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

/// State of the task `inputs`.
pub struct Inputs {
    pins: InputPins,
    inputs: signals::Inputs,
    wiring: Receiver<'static, Wiring, 2>,
    signals: Sender<'static, Sensed, SIGNALS_DEPTH>,
    sent: Option<Sensed>,
    wake: Wake,
    alarm: Alarm,
    /// Decides when the serial task may be called for bytes that can wait.
    calls: Calls,
    /// Signal from the serial task: it has left bytes unread and must be called again.
    left_unread: SignalReader<'static, ()>,
    supervisor: Supervisor,
}

impl Inputs {
    /// Creates the task. It reports nothing until `control` has sent the settings of the inputs (`Wiring`).
    pub fn new(
        pins: InputPins,
        wiring: Receiver<'static, Wiring, 2>,
        signals: Sender<'static, Sensed, SIGNALS_DEPTH>,
        wake: Wake,
        alarm: Alarm,
        left_unread: SignalReader<'static, ()>,
        supervisor: Supervisor,
    ) -> Inputs {
        let (inputs, calls) = (signals::Inputs::new(), Calls::new());
        Inputs { pins, inputs, wiring, signals, sent: None, wake, alarm, calls, left_unread, supervisor }
    }

    /// Runs the task. Called once per sample.
    pub fn sample(&mut self, uart: &mut UartInput) {
        self.supervisor.sample(&mut self.wake);
        if self.alarm.goes_off() {
            self.wake.write(());
        }
        let low = self.pins.read();
        if self.inputs.sample(low) {
            shared::ask_for_stop();
            boards::call_step();
        }
        INPUTS.low.store(low, Ordering::Relaxed);
        self.count_noise();
        let received = uart.look();
        let Inputs { calls, left_unread, .. } = self;
        let is_due = calls.sample(|| received.news || left_unread.try_read().is_some());
        let calls = is_due || received.stop;
        if calls || received.waits {
            uart.pass_on(calls);
        }
        if calls {
            boards::call_serial();
        }
        if self.inputs.has_changed() {
            self.send_levels(uart);
        }
        if !self.wiring.is_empty()
            && let Ok(wiring) = self.wiring.try_recv()
        {
            self.inputs.wire(&wiring);
            self.pins.set_pulls(wiring.inputs.no_pull_up, wiring.inputs.pull_down);
        }
    }

    /// Sends the input levels to `control`. If the queue is full, the newest levels are sent at a later sample.
    #[inline(never)]
    fn send_levels(&mut self, uart: &mut UartInput) {
        let Some(sensed) = self.inputs.sensed() else { return };
        // `control` must get the UART bytes read up to now before this message. So call the serial task first, which
        // passes them on. If more bytes arrived than one sample reads, the rest comes after the message.
        uart.pass_on(true);
        boards::call_serial();
        let is_known = self.sent == Some(sensed);
        if is_known || self.signals.try_send(sensed).is_ok() {
            self.inputs.mark_sent();
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
