//! The program: an RTIC app that binds the tasks of `oxmill_firmware` to interrupt vectors, and gives each its ends of
//! the channels. This file contains only the wiring between the tasks.
#![no_std]
#![no_main]
#![allow(unsafe_op_in_unsafe_fn, clippy::undocumented_unsafe_blocks, reason = "code that RTIC generates in this file")]

mod panic;

use defmt_rtt as _;

/// The app. RTIC takes vectors as literals and cannot select one by `cfg`, so the board calls this macro with its own
/// vectors.
// Without `skip`, rustfmt indents the list of channels further at each run.
#[rustfmt::skip]
macro_rules! firmware {
    (serial: $serial:ident $(, uart: $uart:ident)? $(, usb: $usb:ident)?, step: $step:ident, dispatcher: $dispatcher:ident) => {
        #[rtic::app(device = oxmill_boards::pac, peripherals = true, dispatchers = [$dispatcher])]
        mod app {
            use oxmill_boards::{self as boards, AXES, BLOCKS, HELD_BYTES};
            use oxmill_controller::messages::*;
            use oxmill_controller::memory::Storage;
            use core::mem::MaybeUninit;
            use oxmill_firmware::BoardController;
            use oxmill_firmware::control::Control;
            use oxmill_firmware::inputs::Inputs;
            use oxmill_firmware::serial::Serial;
            use oxmill_firmware::stack;
            use oxmill_firmware::startup::{self, Channels};
            use oxmill_firmware::step_timer::Step;
            use rtic_sync::channel::Channel;
            use rtic_sync::signal::{Signal, SignalReader};

            /// Each resource is shared only by tasks of one priority, so it needs no lock.
            #[shared]
            struct Shared {
                #[lock_free]
                uart: boards::UartInput,
                #[lock_free]
                serial: Serial,
            }

            #[local]
            struct Local {
                step: Step,
                inputs: Inputs,
                control: Control,
                woken: SignalReader<'static, ()>,
            }

            #[init(local = [
                realtime: Channel<Realtime, REALTIME_DEPTH> = Channel::new(),
                lines: Channel<LineBytes, LINE_MESSAGES> = Channel::new(),
                replies: Channel<Chunk, REPLIES_DEPTH> = Channel::new(),
                segments: Channel<ToStep, SEGMENTS_DEPTH> = Channel::new(),
                events: Channel<StepEvent<AXES>, EVENTS_DEPTH> = Channel::new(),
                signals: Channel<Sensed, SIGNALS_DEPTH> = Channel::new(),
                // Wiring after a change of settings. Room for two messages suffices, because the receiving tasks take
                // them within a millisecond.
                step_wiring: Channel<Wiring, 2> = Channel::new(),
                input_wiring: Channel<Wiring, 2> = Channel::new(),
                wake: Signal<()> = Signal::new(),
                // The serial task has left bytes unread and must be called again.
                left_unread: Signal<()> = Signal::new(),
                // Time of the next wake-up of the control task.
                alarm: Signal<u32> = Signal::new(),
                controller: MaybeUninit<BoardController> = MaybeUninit::uninit(),
                // Memory for the large parts of the controller: look-ahead, G-code interpreter, replies.
                storage: Storage<AXES, BLOCKS, HELD_BYTES> = Storage::EMPTY,
            ])]
            fn init(cx: init::Context) -> (Shared, Local) {
                boards::stack::paint();
                let local = cx.local;
                let channels = Channels {
                    realtime: local.realtime,
                    lines: local.lines,
                    replies: local.replies,
                    segments: local.segments,
                    events: local.events,
                    signals: local.signals,
                    step_wiring: local.step_wiring,
                    input_wiring: local.input_wiring,
                    wake: local.wake,
                    left_unread: local.left_unread,
                    alarm: local.alarm,
                };
                let tasks = startup::start(cx.device, cx.core.SYST, channels, local.controller, local.storage.lend(&boards::PROFILE));
                let woken = local.wake.take_reader();
                defmt::info!("{} is up", boards::profile().name);
                // Spawning cannot fail, because the task has not been spawned before.
                let _ = control::spawn();
                let startup::Tasks { step, uart, serial, inputs, control } = tasks;
                (Shared { uart, serial }, Local { step, inputs, control, woken })
            }

            #[task(binds = $step, priority = 4, local = [step])]
            fn step(cx: step::Context) {
                cx.local.step.run();
            }

            #[task(binds = SysTick, priority = 3, local = [inputs], shared = [uart])]
            fn inputs(cx: inputs::Context) {
                cx.local.inputs.sample(cx.shared.uart);
            }

            // Only for a UART without DMA.
            $(
                #[task(binds = $uart, priority = 3, shared = [uart])]
                fn uart(cx: uart::Context) {
                    cx.shared.uart.on_interrupt();
                }
            )?

            #[task(binds = $serial, priority = 2, shared = [serial])]
            fn serial(cx: serial::Context) {
                cx.shared.serial.run();
            }

            // The serial task again, for a second vector.
            $(
                #[task(binds = $usb, priority = 2, shared = [serial])]
                fn usb(cx: usb::Context) {
                    cx.shared.serial.run();
                }
            )?

            #[task(priority = 1, local = [control, woken])]
            async fn control(cx: control::Context) {
                cx.local.control.start();
                loop {
                    cx.local.control.turn();
                    cx.local.woken.wait().await;
                }
            }

            #[idle]
            fn idle(_: idle::Context) -> ! {
                let mut watch = stack::Watch::start();
                loop {
                    watch.look();
                    boards::idle();
                }
            }
        }
    };
}

oxmill_boards::vectors!(firmware);
