//! From reset to running tasks: `start` sets the board up, splits the channels, builds the controller in its place in
//! RAM, restores the settings, starts the sampling of inputs, and puts together what each task owns.

use crate::boards::{self, AXES, Port};
use crate::control::{BoardController, Control, Ends};
use crate::failure;
use crate::flash::Settings;
use crate::inputs::Inputs;
use crate::outputs::Outputs;
use crate::record;
use crate::serial::Serial;
use crate::shared::Wake;
use crate::step_timer::Step;
use crate::watchdog::Supervisor;
use core::mem::{ManuallyDrop, MaybeUninit};
use cortex_m::peripheral::{SYST, syst::SystClkSource};
use oxmill_controller::Controller;
use oxmill_controller::messages::{
    Chunk, EVENTS_DEPTH, LINE_MESSAGES, LineBytes, REALTIME_DEPTH, REPLIES_DEPTH, Realtime, Restart, SEGMENTS_DEPTH,
    SIGNALS_DEPTH, Sensed, StepEvent, ToStep, Wiring,
};
use oxmill_controller::recorder::Recorder;
use oxmill_controller::settings::Key;
use rtic_sync::channel::Channel;
use rtic_sync::signal::Signal;

/// The channels between the tasks, as `main` declares them.
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
}

/// What the tasks own.
#[allow(missing_docs, reason = "one for each task")]
pub struct Tasks {
    pub step: Step,
    pub serial: Serial,
    pub inputs: Inputs,
    pub control: Control,
}

/// A new controller but for its look-ahead.
type Head = Controller<AXES, 0>;
/// Where that begins in a whole one.
const LOOK_AHEAD_AT: usize = Head::LOOK_AHEAD_AT;

/// Stretches of a new controller that are not 0 throughout: from where, and how many bytes.
const WRITTEN: [(usize, usize); Head::ZEROS.len() + 1] = {
    let mut written = [(0, 0); Head::ZEROS.len() + 1];
    let (mut at, mut place) = (0, 0);
    while place < written.len() {
        // The zeros that come next; behind the last of them comes the look-ahead.
        let (mut next, mut other) = ((LOOK_AHEAD_AT, 0), 0);
        while other < Head::ZEROS.len() {
            let zeros = Head::ZEROS[other];
            if zeros.1 > 0 && zeros.0 >= at && zeros.0 < next.0 {
                next = zeros;
            }
            other += 1;
        }
        written[place] = (at, next.0 - at);
        at = next.0 + next.1;
        place += 1;
    }
    written
};

/// Bytes of a new controller, as they lie in flash; padding among them.
#[repr(C, align(4))]
struct Bytes<const LENGTH: usize>([MaybeUninit<u8>; LENGTH]);

const fn bytes_of_new<const LENGTH: usize>(from: usize) -> Bytes<LENGTH> {
    let new = ManuallyDrop::new(Head::new(boards::PROFILE));
    assert!(from + LENGTH <= size_of::<Head>());
    // SAFETY: unsafe because of a raw pointer; safe because what is read lies in `new`, and any bytes are valid ones. A controller
    // owns nothing that a copy of its bytes would double.
    unsafe { (&raw const new).cast::<u8>().add(from).cast::<Bytes<LENGTH>>().read_unaligned() }
}

/// The stretches of [`WRITTEN`] that are named, each in flash.
macro_rules! stretches {
    ($($place:literal)*) => {
        [$({
            static BYTES: Bytes<{ WRITTEN[$place].1 }> = bytes_of_new(WRITTEN[$place].0);
            (WRITTEN[$place].0, &BYTES.0 as &[MaybeUninit<u8>])
        }),*]
    };
}

/// Builds the controller in its place, of which all bytes are 0: it is too big for the stack, and tens of kilobytes of zeros would
/// be for flash.
///
/// # Safety
/// All bytes of `place` are 0: what is 0 in a new controller is not written.
pub unsafe fn build<const BLOCKS: usize>(
    place: &mut MaybeUninit<Controller<AXES, BLOCKS>>,
) -> &mut Controller<AXES, BLOCKS> {
    const { assert!(LOOK_AHEAD_AT == Controller::<AXES, BLOCKS>::LOOK_AHEAD_AT && LOOK_AHEAD_AT <= size_of::<Head>()) };
    let stretches: [_; WRITTEN.len()] = stretches!(0 1 2 3 4 5 6 7 8 9);
    // SAFETY: unsafe because a controller is taken to begin as one without look-ahead does, and its blocks and what is not written
    // to be valid when all bytes are 0; safe because fields have the order of C throughout and those before the look-ahead the
    // same types, blocks are plain numbers, and what is not written is 0 in a new one (a test on the target compares) as it is in
    // `place`.
    unsafe {
        for (at, bytes) in stretches {
            let to = place.as_mut_ptr().cast::<MaybeUninit<u8>>().add(at);
            core::ptr::copy_nonoverlapping(bytes.as_ptr(), to, bytes.len());
        }
        place.assume_init_mut()
    }
}

/// The rate of the UART: the usual one with hold and start both active, for a host that cannot have the chosen one.
fn baud(controller: &BoardController, low: u32) -> u32 {
    let inverted = controller.settings().whole(Key::ControlInvert);
    let is_active = |pin: u32, bit: u32| (low >> pin ^ inverted >> bit) & 1 != 0;
    if is_active(boards::input_bits::HOLD, 1) && is_active(boards::input_bits::START, 2) {
        boards::USUAL_BAUD
    } else {
        controller.settings().whole(Key::Baud)
    }
}

/// Sets the board up and deals everything out. Called once; in its place it needs one copy of the tasks less on the stack.
#[inline(always)]
pub fn start(
    device: boards::pac::Peripherals,
    mut sampling: SYST,
    channels: Channels,
    controller: &'static mut MaybeUninit<BoardController>,
) -> Tasks {
    // SAFETY: unsafe because `build` takes memory that is 0 for granted; safe because RTIC keeps this place in .bss, which the start-up
    // code has cleared, and gives it out once.
    let controller = unsafe { build(controller) };
    let mut parts = boards::setup(device, failure::low_voltage);
    let (realtime_in, realtime) = channels.realtime.split();
    let (lines_in, lines) = channels.lines.split();
    let (replies, replies_out) = channels.replies.split();
    let (segments, segments_out) = channels.segments.split();
    let (events_in, events) = channels.events.split();
    let (signals_in, signals) = channels.signals.split();
    let (step_wiring, step_wiring_out) = channels.step_wiring.split();
    let (input_wiring, input_wiring_out) = channels.input_wiring.split();
    let wake: Wake = channels.wake.writer();

    let ends = Ends { realtime, lines, events, signals, segments, replies, step_wiring, input_wiring };
    let mut restart = Restart { cause: boards::reset_cause(), crash: record::take(), is_recorded: false };
    let recorder = Recorder::begin(record::pages(), &restart);
    restart.is_recorded = recorder.is_kept();
    controller.restarted(restart);
    let settings = Settings::open(parts.settings_flash, controller);
    parts.serial.set_baud(baud(controller, parts.inputs.read()));
    let tasks = Tasks {
        step: Step::new(parts.step_pins, segments_out, step_wiring_out, events_in, wake.clone()),
        serial: Serial::new(parts.serial, parts.usb, realtime_in, lines_in, replies_out, wake.clone()),
        inputs: Inputs::new(parts.inputs, input_wiring_out, signals_in, wake, Supervisor::new(parts.watchdog)),
        control: Control::new(controller, ends, Outputs::new(parts.slow_pins), settings, recorder),
    };
    sampling.set_clock_source(SystClkSource::Core);
    sampling.set_reload(boards::CORE_HZ / boards::SAMPLE_HZ - 1);
    sampling.clear_current();
    sampling.enable_counter();
    sampling.enable_interrupt();
    tasks
}
