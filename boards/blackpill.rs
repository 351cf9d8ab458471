//! Common part of the WeAct Black Pill boards V2/V3 with STM32F411CE or STM32F401CC: the pin table, and `setup`, which
//! derives the clocks from the 25 MHz crystal, assigns the pins and returns the `Parts`. Before wiring, compare the
//! drawing with the print on your board.
//!
//! ```text
//!                              ┌──[USB-C]──┐
//!            X limit    B12  ──┤           ├──  5V
//!            Y limit    B13  ──┤           ├──  GND
//!            Z limit    B14  ──┤           ├──  3V3
//!              probe    B15  ──┤           ├──  B10   spindle direction
//!   second motor step    A8  ──┤           ├──  B2    (BOOT1)
//!   TX to the host       A9  ──┤           ├──  B1    spindle on
//!   RX from the host    A10  ──┤           ├──  B0    driver enable
//!            (USB D-)   A11  ──┤  STM32F4  ├──  A7    spindle PWM / laser
//!            (USB D+)   A12  ──┤ 11CE/01CC ├──  A6    Z direction
//!     its direction     A15  ──┤           ├──  A5    Y direction
//!       driver fault      B3  ──┤           ├──  A4    X direction
//!      reset (abort)     B4  ──┤           ├──  A3    Z step
//!               hold     B5  ──┤           ├──  A2    Y step
//!     start (resume)     B6  ──┤           ├──  A1    X step
//!               door     B7  ──┤           ├──  A0    second motor limit (KEY)
//!              flood     B8  ──┤           ├──  RST
//!               mist     B9  ──┤           ├──  C15   (32 kHz crystal)
//!                        5V  ──┤           ├──  C14   (32 kHz crystal)
//!                       GND  ──┤           ├──  C13   (LED)
//!                       3V3  ──┤           ├──  VBAT
//!                              └─[SWD pins]┘
//! ```
//!
//! | function | pin | why there |
//! |---|---|---|
//! | step X Y Z | A1 A2 A3 | one port: one store writes all edges |
//! | direction X Y Z | A4 A5 A6 | the same port; shared with the unpopulated SPI flash on the back |
//! | spindle PWM / laser | A7 | TIM3 channel 2, the same timer as on the Nucleo |
//! | driver enable | B0 | |
//! | spindle on, direction | B1, B10 | |
//! | flood, mist | B8, B9 | |
//! | limits X Y Z, probe | B12 B13 B14, B15 | pull-ups; switches close to ground |
//! | reset, hold, start, door | B4, B5, B6, B7 | pull-ups; B4 is NJTRST after reset, whose pull-up fits an input |
//! | host, USB | A11 (D-), A12 (D+) | the only pins of OTG_FS, wired to the socket; a serial port (CDC-ACM) on the host |
//! | host, UART | A9 (TX), A10 (RX) | USART1, 115200 8N1 (`$931`), in use beside USB; the boot loader uses the same pins. A9 is also the VBUS sense pin; sensing is off: a board with its own supply detects an unplugged host by the idle bus |
//! | driver fault | B3 | pull-up; SWO after reset, which nothing here uses |
//! | second motor of an axis: step, direction | A8, A15 | the same port; `$905` names the axis. A15 is NJTDI after reset and pulled up until set-up |
//! | its limit switch | A0 | pull-up; the board's KEY is on the same pin and has no effect without `$907` |
//! | left alone | A13 A14, B2, C13-C15 | SWD, BOOT1, LED and crystal: no pin is left for a spindle's at-speed signal |
//!
//! All pins float during reset: spindle, laser and coolant need pull-down resistors, driver enable a pull-up.

use stm32f4xx_hal::{
    gpio::{PinState, Pull, Speed},
    prelude::*,
    rcc::Config,
    serial,
};

use crate::input_bits;
use crate::stm32f4::{self, each, step::Rings, usart_interrupt};
pub use crate::stm32f4::{
    CLOCK_TICKS_PER_US, InputPins, SAMPLE_HZ, SettingsFlash, SlowPins, USUAL_BAUD, WATCHES_CLOCK, Watchdog, call_step,
    clock_ticks, idle, job_done, preloaded_job, reset_cause, restart, safe_state,
};
pub use stm32f4xx_hal::pac;

/// The interrupt vectors of the tasks. They are literals, because the macro of RTIC runs before constants and `cfg` are
/// evaluated.
#[macro_export]
macro_rules! vectors {
    ($app:ident) => {
        $app!(serial: SPI2, uart: USART1, usb: OTG_FS, step: TIM5, dispatcher: SPI1);
    };
}

/// Calls the serial task, which uses the vector of an unused peripheral.
pub fn call_serial() {
    pac::NVIC::pend(pac::Interrupt::SPI2);
}

/// The UART's receiver, for `inputs` and `uart`, two tasks of the same priority.
pub type UartInput = usart_interrupt::Input;
/// The second link to a host, by UART.
pub type SerialPort = usart_interrupt::InterruptPort;
/// The first link to a host, by USB.
pub type UsbPort = stm32f4::usb::UsbPort;
/// Step and direction pins on one port.
pub type StepPins = stm32f4::StepPins<1>;
/// What `setup` returns, one part for each task.
pub type Parts = stm32f4::Parts<UartInput, SerialPort, UsbPort, 1>;

/// Sets up clocks, pins and timers; all outputs are off.
pub fn setup(device: pac::Peripherals, core_hz: u32, low_voltage: fn() -> !) -> Parts {
    stm32f4::begin_with_reset(&device.RCC, &device.SYSCFG);
    stm32f4::await_voltage(&device.PWR);
    #[cfg(feature = "stm32f411")]
    stm32f4::full_core_voltage(&device.PWR);
    let mut rcc = device.RCC.freeze(Config::hse(25.MHz()).sysclk(core_hz.Hz()).require_pll48clk());
    stm32f4::watch_clock();
    stm32f4::watch_voltage(&device.PWR, &device.EXTI, low_voltage);
    let a = device.GPIOA.split(&mut rcc);
    let b = device.GPIOB.split(&mut rcc);
    // Port C needs its clock although none of its pins is used: `InputPins::read` and `safe_state` access ports A to C.
    let _c = device.GPIOC.split(&mut rcc);

    // The driver enable is active low: high is off.
    let [enable] = each!([b.pb0].into_push_pull_output_in_state(PinState::High));
    let [spindle, turn, flood, mist] =
        each!([b.pb1, b.pb10, b.pb8, b.pb9].into_push_pull_output_in_state(PinState::Low));
    let slow_pins = SlowPins::new([enable, spindle, turn, flood, mist]);
    let inputs = each!([b.pb12, b.pb13, b.pb14, b.pb15, b.pb7, b.pb5, b.pb6, b.pb4].into_pull_up_input());
    // The fault outputs of motor drivers are open-drain, so that several drivers can share this input.
    let inputs = InputPins::new(inputs)
        .with(input_bits::DRIVER_FAULT, b.pb3.into_pull_up_input().erase())
        .with(input_bits::SECOND_LIMIT, a.pa0.into_pull_up_input().erase());
    let _pwm = a.pa7.into_alternate::<2>();
    let steps = each!([a.pa1, a.pa2, a.pa3, a.pa8].into_push_pull_output().speed(Speed::Medium));
    let directions = each!([a.pa4, a.pa5, a.pa6, a.pa15].into_push_pull_output());
    let rings = cortex_m::singleton!(: Rings<1> = Rings::EMPTY);
    let timers = (device.TIM1, device.TIM5, device.TIM3);
    let step_pins = stm32f4::step_pins(steps, directions, &inputs, timers, rings, &mut rcc);
    let link = serial::Config::default().baudrate(stm32f4::USUAL_BAUD.bps());
    // If no host drives the UART's input, the pull-up keeps it high. Otherwise noise would be received as commands.
    let mut rx = a.pa10.into_alternate::<7>();
    rx.set_internal_resistor(Pull::Up);
    let Ok(usart) = serial::Serial::new(device.USART1, (a.pa9, rx), link, &mut rcc) else {
        // The set-up cannot fail: 84 and 96 MHz, divided by whole numbers, give 115200 baud to within 0.1 %.
        unreachable!()
    };
    stm32f4::start_clock(device.TIM2, &mut rcc);
    let (uart_input, serial) = usart_interrupt::by_interrupt(usart.split(), &mut rcc);
    Parts {
        step_pins,
        uart_input,
        serial,
        usb: UsbPort::new(
            (device.OTG_FS_GLOBAL, device.OTG_FS_DEVICE, device.OTG_FS_PWRCLK),
            (a.pa11, a.pa12),
            &rcc.clocks,
        ),
        inputs,
        slow_pins,
        settings_flash: SettingsFlash::new(
            device.FLASH,
            usart_interrupt::receive_by_dma,
            usart_interrupt::end_of_stall,
        ),
        watchdog: stm32f4::Watchdog::new(device.IWDG, &device.DBGMCU),
    }
}
