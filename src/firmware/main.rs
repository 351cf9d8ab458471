//! The firmware: the controller of `oxmill-controller`, pumped by tasks of RTIC.
//!
//! ```text
//!  priority 4  step     step timer     ◀─segments─┬─▶ events       pulses, directions, beam
//!  priority 3  serial   UART           ─realtime, lines─▶ ◀─replies─  bytes in and out
//!  priority 2  inputs   SysTick        ─signals─▶                  switches and their stops, alarm clock of `control`
//!  priority 1  control  software task  everything is decided here, by the controller
//!  priority 0  idle                    sleeps
//! ```
//! This file is the wiring diagram and nothing else. Nothing shares the priority of `step`. Each channel has one sender
//! and one receiver; what happens when one is full stands with its depth in `oxmill_controller::messages`. A channel
//! call takes 50 to 130 instructions and masks interrupts for 25 cycles of them at most (`cargo xtask count`).
#![no_std]
#![no_main]
#![allow(unsafe_op_in_unsafe_fn, clippy::undocumented_unsafe_blocks, reason = "code that RTIC generates in this file")]

#[path = "../../boards/mod.rs"]
mod boards;
mod clock;
mod control;
mod copy;
mod crossing;
mod flash;
mod inputs;
mod outputs;
mod panic;
mod record;
mod serial;
mod stack;
mod startup;
mod step_timer;
mod watchdog;

use defmt_rtt as _;

/// The app. RTIC takes vectors as literals and cannot choose one by `cfg`, so each board instantiates it with its own.
// Without `skip` rustfmt indents the list of channels further at each run.
#[rustfmt::skip]
macro_rules! firmware {
    (device: $pac:path, serial: $serial:ident $(, usb: $usb:ident)?, step: $step:ident, dispatcher: $dispatcher:ident) => {
        /// Calls the step task.
        pub fn pend_step() {
            boards::call_step();
        }

        /// Calls the step task for what is not urgent, when no edge is near.
        pub fn ask_step() {
            boards::ask_step();
        }

        /// Calls the serial task.
        pub fn pend_serial() {
            rtic::pend(boards::pac::Interrupt::$serial);
        }

        #[rtic::app(device = $pac, peripherals = true, dispatchers = [$dispatcher])]
        mod app {
            use crate::boards::{self, AXES};
            use crate::control::{BoardController, Control};
            use crate::inputs::Inputs;
            use crate::serial::Serial;
            use crate::startup::{self, Channels};
            use crate::step_timer::Step;
            use oxmill_controller::messages::*;
            use rtic_sync::channel::Channel;
            use rtic_sync::signal::{Signal, SignalReader};

            #[shared]
            struct Shared {
                /// Only of tasks of one priority.
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
                lines: Channel<LineByte, LINES_DEPTH> = Channel::new(),
                replies: Channel<Chunk, REPLIES_DEPTH> = Channel::new(),
                segments: Channel<ToStep, SEGMENTS_DEPTH> = Channel::new(),
                events: Channel<StepEvent<AXES>, EVENTS_DEPTH> = Channel::new(),
                signals: Channel<Sensed, SIGNALS_DEPTH> = Channel::new(),
                // Changed settings; two of them always fit, as the receivers take them within a millisecond.
                step_wiring: Channel<Wiring, 2> = Channel::new(),
                input_wiring: Channel<Wiring, 2> = Channel::new(),
                wake: Signal<()> = Signal::new(),
                // Computed by the compiler and copied to its place with the other data: it is too big for the stack.
                controller: BoardController = BoardController::new(boards::PROFILE),
            ])]
            fn init(cx: init::Context) -> (Shared, Local) {
                crate::stack::paint();
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
                };
                let tasks = startup::start(cx.device, cx.core.SYST, channels, local.controller);
                let woken = local.wake.take_reader();
                defmt::info!("{} is up", boards::PROFILE.name);
                // Cannot fail: it has not been spawned before.
                let _ = control::spawn();
                let startup::Tasks { step, serial, inputs, control } = tasks;
                (Shared { serial }, Local { step, inputs, control, woken })
            }

            #[task(binds = $step, priority = 4, local = [step])]
            fn step(cx: step::Context) {
                cx.local.step.run();
            }

            #[task(binds = $serial, priority = 3, shared = [serial])]
            fn serial(cx: serial::Context) {
                cx.shared.serial.run();
            }

            // The same work for another vector.
            $(
                #[task(binds = $usb, priority = 3, shared = [serial])]
                fn usb(cx: usb::Context) {
                    cx.shared.serial.run();
                }
            )?

            #[task(binds = SysTick, priority = 2, local = [inputs])]
            fn inputs(cx: inputs::Context) {
                cx.local.inputs.sample();
            }

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
                let mut watch = crate::stack::Watch::new();
                loop {
                    watch.look();
                    boards::idle();
                }
            }
        }
    };
}

#[cfg(any(feature = "blackpill_f411", feature = "blackpill_f401"))]
firmware!(device: stm32f4xx_hal::pac, serial: USART1, usb: OTG_FS, step: TIM2, dispatcher: SPI1);
#[cfg(any(feature = "nucleo_f446re", feature = "nucleo_f411re", feature = "nucleo_f401re"))]
firmware!(device: stm32f4xx_hal::pac, serial: USART2, step: TIM2, dispatcher: SPI1);
#[cfg(feature = "qemu_mps2")]
firmware!(device: mps2_pac, serial: UART0_RX, step: TIMER0, dispatcher: SPI);
