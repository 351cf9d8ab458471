//! Common part of the Nucleo-64 boards with an Arduino CNC shield v3: the pins, and `setup`, which sets the clocks,
//! assigns the pins of the header and of the Morpho connectors and returns the `Parts`. Unlike on a Black Pill, the
//! step pins are on two ports, the host is on `USART2` through the ST-LINK, and there are inputs for a spindle's
//! at-speed signal and for programs.
#![doc = include_str!("nucleo64.md")]

use stm32f4xx_hal::{
    gpio::{PinState, Pull, Speed},
    prelude::*,
    rcc::Config,
    serial,
};

pub use crate::stm32f4::{
    CLOCK_TICKS_PER_US, InputPins, SAMPLE_HZ, SettingsFlash, SlowPins, USUAL_BAUD, WATCHES_CLOCK, Watchdog, call_step,
    clock_ticks, idle, job_done, preloaded_job, reset_cause, restart, safe_state,
};
use crate::stm32f4::{each, step::Rings, usart_dma};
use crate::{AXES, NoPort, input_bits, stm32f4};
pub use stm32f4xx_hal::pac;

/// The interrupt vectors of the tasks. They are literals, because the macro of RTIC runs before constants and `cfg` are
/// evaluated.
#[macro_export]
macro_rules! vectors {
    ($app:ident) => {
        $app!(serial: DMA1_STREAM6, step: TIM5, dispatcher: SPI1);
    };
}

/// Calls the serial task, which uses the vector of the DMA stream that sends.
pub fn call_serial() {
    pac::NVIC::pend(pac::Interrupt::DMA1_STREAM6);
}

/// The UART's receiver, for the task of the inputs.
pub type UartInput = usart_dma::Input;
/// The link to the host.
pub type SerialPort = usart_dma::DmaPort;
/// No USB link: the board's USB socket belongs to the ST-LINK.
pub type UsbPort = NoPort;
/// Step and direction pins on two ports.
pub type StepPins = stm32f4::StepPins<2>;
/// What `setup` returns, one part for each task.
pub type Parts = stm32f4::Parts<UartInput, SerialPort, NoPort, 2>;

/// Sets up clocks, pins and timers; all outputs are off.
pub fn setup(device: pac::Peripherals, core_hz: u32, low_voltage: fn() -> !) -> Parts {
    stm32f4::begin_with_reset(&device.RCC, &device.SYSCFG);
    stm32f4::await_voltage(&device.PWR);
    #[cfg(feature = "stm32f411")]
    stm32f4::full_core_voltage(&device.PWR);
    let mut rcc = device.RCC.freeze(Config::hse(8.MHz()).bypass_hse_oscillator().sysclk(core_hz.Hz()));
    stm32f4::watch_clock();
    stm32f4::watch_voltage(&device.PWR, &device.EXTI, low_voltage);
    let a = device.GPIOA.split(&mut rcc);
    let b = device.GPIOB.split(&mut rcc);
    let c = device.GPIOC.split(&mut rcc);

    // The driver enable is active low: high is off.
    let [enable] = each!([a.pa9].into_push_pull_output_in_state(PinState::High));
    let [spindle, turn, flood, mist] =
        each!([c.pc2, a.pa5, b.pb0, c.pc1].into_push_pull_output_in_state(PinState::Low));
    let [first, second] = each!([c.pc8, c.pc9].into_push_pull_output_in_state(PinState::Low));
    let slow_pins = SlowPins::new([enable, spindle, turn, flood, mist, first, second]);
    let inputs = each!([c.pc7, b.pb6, a.pa6, c.pc0, c.pc3, a.pa1, a.pa4, a.pa0].into_pull_up_input());
    // The fault outputs of motor drivers are open-drain, so that several drivers can share this input.
    let inputs = InputPins::new(inputs)
        .with(input_bits::DRIVER_FAULT, c.pc10.into_pull_up_input().erase())
        .with(input_bits::AT_SPEED, c.pc11.into_pull_up_input().erase())
        .with(input_bits::PROGRAM, c.pc6.into_pull_up_input().erase())
        .with(input_bits::SECOND_PROGRAM, c.pc5.into_pull_up_input().erase())
        .with(input_bits::SECOND_LIMIT, b.pb15.into_pull_up_input().erase());
    let inputs = if AXES > 3 { inputs.also(input_bits::LIMITS + 3) } else { inputs };
    let _pwm = a.pa7.into_alternate::<2>();
    let steps = each!([a.pa10, b.pb3, b.pb5, b.pb13].into_push_pull_output().speed(Speed::Medium));
    let directions = each!([b.pb4, b.pb10, a.pa8, b.pb14].into_push_pull_output());
    let rings = cortex_m::singleton!(: Rings<2> = Rings::EMPTY);
    let timers = (device.TIM1, device.TIM5, device.TIM3);
    let step_pins = stm32f4::step_pins(steps, directions, &inputs, timers, rings, &mut rcc);
    let link = serial::Config::default().baudrate(stm32f4::USUAL_BAUD.bps());
    // If the ST-LINK does not drive this input (open solder bridges, no power), the pull-up keeps it high.
    let mut rx = a.pa3.into_alternate::<7>();
    rx.set_internal_resistor(Pull::Up);
    let Ok(usart) = serial::Serial::new(device.USART2, (a.pa2, rx), link, &mut rcc) else {
        // The set-up cannot fail: 42 to 50 MHz, the clock of the slower bus, give 115200 baud to within 0.2 %.
        unreachable!()
    };
    stm32f4::start_clock(device.TIM2, &mut rcc);
    let (uart_input, serial) = usart_dma::by_dma(usart.split(), &mut rcc);
    Parts {
        step_pins,
        uart_input,
        serial,
        usb: NoPort,
        inputs,
        slow_pins,
        // Nothing to prepare before a flash operation: DMA receives while the processor is stalled.
        settings_flash: SettingsFlash::new(device.FLASH, || {}, || {}),
        watchdog: stm32f4::Watchdog::new(device.IWDG, &device.DBGMCU),
    }
}
