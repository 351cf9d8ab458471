//! `Inputs` has the input pins sampled and filtered, and tells `control` what has been `Sensed`; an armed input asks
//! the step task for a stop from here. It gives pins their pull-ups (`set_pulls`), counts noise, asserts that
//! `input_bits` of the board are in the controller's order, and each sample also looks at the alarm clock of `control`,
//! at the `Supervisor`, and at what the UART has received: it calls the serial task for it.
//!
//! Sampling instead of edge interrupts: no pins clash on an interrupt line, and a bouncing switch cannot flood the CPU.
//! A change passes after eight equal samples, 0.4 ms.

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
    alarm: Alarm,
    /// When the serial task may be called for what can wait, and whether it has left some of that unread.
    calls: Calls,
    left_unread: SignalReader<'static, ()>,
    supervisor: Supervisor,
}

impl Inputs {
    /// Nothing is reported before `control` has told how the inputs are wired.
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

    /// One sample.
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
        if self.inputs.is_untold() {
            self.tell(uart);
        }
        if !self.wiring.is_empty()
            && let Ok(wiring) = self.wiring.try_recv()
        {
            self.inputs.wire(&wiring);
            self.pins.set_pulls(wiring.inputs.no_pull_up, wiring.inputs.pull_down);
        }
    }

    /// Levels and not edges cross: if the queue is full, the newest state is sent at a later sample.
    #[inline(never)]
    fn tell(&mut self, uart: &mut UartInput) {
        let Some(sensed) = self.inputs.sensed() else { return };
        // What has been read of the UART by now belongs before it: the serial task passes it on before `control` hears of this. What still
        // waits in the buffer, as it does behind a flood, comes after it.
        uart.pass_on(true);
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
