//! Set-up of the firmware, from reset to running tasks. `start` sets up the board, builds the controller in its final
//! place in RAM, restores the settings, starts the sampling of inputs, and creates the tasks.

use crate::BoardController;
use crate::boards::{self, AXES};
use crate::clock::Alarm;
use crate::control::{Control, Ends};
use crate::failure;
use crate::inputs::Inputs;
use crate::last_words;
use crate::outputs::Outputs;
use crate::serial::Serial;
use crate::settings_store::SettingsStore;
use crate::shared::Wake;
use crate::step_timer::Step;
use crate::watchdog::Supervisor;
use core::mem::MaybeUninit;
use cortex_m::peripheral::{SYST, syst::SystClkSource};
use oxmill_controller::memory::Memory;
use oxmill_controller::messages::{
    Chunk, Crash, CrashKind, EVENTS_DEPTH, LINE_MESSAGES, LineBytes, REALTIME_DEPTH, REPLIES_DEPTH, Realtime, Restart,
    SEGMENTS_DEPTH, SIGNALS_DEPTH, Sensed, StepEvent, ToStep, Wiring,
};
use oxmill_controller::recorder::Recorder;
use oxmill_controller::settings::Key;
use oxmill_controller::{Controller, Profile};
use rtic_sync::channel::Channel;
use rtic_sync::signal::Signal;

/// The channels between the tasks, as declared in `main`.
#[allow(missing_docs, reason = "named and described in `main`")]
pub struct Channels {
    pub realtime: &'static mut Channel<Realtime, REALTIME_DEPTH>,
    pub lines: &'static mut Channel<LineBytes, LINE_MESSAGES>,
    pub replies: &'static mut Channel<Chunk, REPLIES_DEPTH>,
    pub segments: &'static mut Channel<ToStep, SEGMENTS_DEPTH>,
    pub events: &'static mut Channel<StepEvent<AXES>, EVENTS_DEPTH>,
    pub signals: &'static mut Channel<Sensed, SIGNALS_DEPTH>,
    pub step_wiring: &'static mut Channel<Wiring, 2>,
    pub input_wiring: &'static mut Channel<Wiring, 2>,
    pub wake: &'static Signal<()>,
    pub left_unread: &'static Signal<()>,
    pub alarm: &'static Signal<u32>,
}

/// The state of the tasks. `uart` is shared by `inputs` and the UART's interrupt, if the board has one.
#[allow(missing_docs, reason = "one for each task")]
pub struct Tasks {
    pub step: Step,
    pub uart: boards::UartInput,
    pub serial: Serial,
    pub inputs: Inputs,
    pub control: Control,
}

/// Returns the baud rate of the UART: `$931`, or `USUAL_BAUD` if the hold and start inputs are both active. So a host
/// that cannot use the rate of `$931` can still connect. `low`: mask of the pins that are low.
fn baud(controller: &BoardController, low: u32) -> u32 {
    let inverted = controller.settings().whole(Key::ControlInvert);
    let is_active = |pin: u32, bit: u32| (low >> pin ^ inverted >> bit) & 1 != 0;
    if is_active(boards::input_bits::HOLD, 1) && is_active(boards::input_bits::START, 2) {
        boards::USUAL_BAUD
    } else {
        // A rate above the board's maximum may have been stored before that maximum existed.
        controller.settings().whole(Key::Baud).min(boards::PROFILE.most_baud)
    }
}

/// Returns the report of a fault that the board has found during its set-up. With this report, the machine starts
/// locked.
fn fault_of_board(why: &str) -> Crash {
    let text = why.bytes().collect();
    Crash { kind: CrashKind::Board, text, place: [0; 3], line: 0, moment: 0 }
}

/// Sets up the board and creates the tasks. Called once. Inlined, because a call would need a second copy of the tasks
/// on the stack.
#[inline(always)]
pub fn start(
    device: boards::pac::Peripherals,
    mut sampling: SYST,
    channels: Channels,
    controller: &'static mut MaybeUninit<BoardController>,
    memory: Memory<AXES>,
) -> Tasks {
    let mut parts = boards::setup(device, failure::low_voltage);
    let profile = Profile { oscillator_mhz: parts.oscillator_mhz, ..boards::profile() };
    let controller = controller.write(Controller::new(profile, memory));
    let (realtime_in, realtime) = channels.realtime.split();
    let (lines_in, lines) = channels.lines.split();
    let (replies, replies_out) = channels.replies.split();
    let (segments, segments_out) = channels.segments.split();
    let (events_in, events) = channels.events.split();
    let (signals_in, signals) = channels.signals.split();
    let (step_wiring, step_wiring_out) = channels.step_wiring.split();
    let (input_wiring, input_wiring_out) = channels.input_wiring.split();
    let wake: Wake = channels.wake.writer();
    let (leaves_unread, left_unread) = channels.left_unread.split();
    let (alarm_in, alarm) = channels.alarm.split();

    let ends = Ends { realtime, lines, events, signals, segments, replies, step_wiring, input_wiring };
    let mut restart = Restart { cause: boards::reset_cause(), crash: last_words::take(), is_recorded: false };
    // A fault of the board replaces the record of an earlier failure, because the fault may have caused that failure.
    restart.crash = parts.fault.map(fault_of_board).or(restart.crash);
    let recorder = Recorder::begin(last_words::pages(), &restart);
    restart.is_recorded = recorder.is_kept();
    controller.restarted(restart);
    let settings = SettingsStore::open(parts.settings_flash, controller);
    parts.uart_input.start(baud(controller, parts.inputs.read()));
    let fitted = parts.inputs.fitted();
    let tasks = Tasks {
        step: Step::new(parts.step_pins, segments_out, step_wiring_out, events_in, wake.clone()),
        uart: parts.uart_input,
        serial: Serial::new(parts.serial, parts.usb, realtime_in, lines_in, replies_out, (wake.clone(), leaves_unread)),
        inputs: Inputs::new(
            parts.inputs,
            input_wiring_out,
            signals_in,
            wake,
            Alarm::new(alarm),
            left_unread,
            Supervisor::new(parts.watchdog),
        ),
        control: Control::new(controller, ends, Outputs::new(parts.slow_pins), settings, recorder, alarm_in, fitted),
    };
    sampling.set_clock_source(SystClkSource::Core);
    sampling.set_reload(boards::CORE_HZ / boards::SAMPLE_HZ - 1);
    sampling.clear_current();
    sampling.enable_counter();
    sampling.enable_interrupt();
    tasks
}
