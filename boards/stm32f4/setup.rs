//! Set-up of a board with an STM32F4: clocks, the pins of the pin table, timers, and the links to the hosts. An image
//! has one of two sets of links:
//!
//! | image | first link | second link |
//! |---|---|---|
//! | with the feature `usb` | USB, on A11 and A12 | `USART1`, on A9 and A10, by an interrupt |
//! | without | `USART2`, on A2 and A3, by DMA | none |

use super::clocks;
use super::{InputPins, SettingsFlash, SlowPins, pins};
use crate::{CORE_HZ, pin_table, stm32f4};
use stm32f4xx_hal::{gpio::Pull, pac, prelude::*, rcc::Config, serial};

#[cfg(not(feature = "usb"))]
use super::usart_dma as uart;
#[cfg(feature = "usb")]
use super::usart_interrupt as uart;

/// The interrupt vectors of the tasks. They are literals, because the macro of RTIC runs before constants and `cfg` are
/// evaluated.
#[cfg(feature = "usb")]
#[macro_export]
macro_rules! vectors {
    ($app:ident) => {
        $app!(serial: SPI2, uart: USART1, usb: OTG_FS, step: TIM5, dispatcher: SPI1);
    };
}

/// The interrupt vectors of the tasks. They are literals, because the macro of RTIC runs before constants and `cfg` are
/// evaluated.
#[cfg(not(feature = "usb"))]
#[macro_export]
macro_rules! vectors {
    ($app:ident) => {
        $app!(serial: DMA1_STREAM6, step: TIM5, dispatcher: SPI1);
    };
}

/// Vector of the serial task. With USB, it is the vector of SPI2, which is not used. Without USB, it is the vector of
/// the DMA stream that sends.
#[cfg(feature = "usb")]
const SERIAL: pac::Interrupt = pac::Interrupt::SPI2;
#[cfg(not(feature = "usb"))]
const SERIAL: pac::Interrupt = pac::Interrupt::DMA1_STREAM6;

/// Makes the interrupt of the serial task pending.
pub fn call_serial() {
    pac::NVIC::pend(SERIAL);
}

/// The UART's receiver, used by the task `inputs` and, if the UART has no DMA, also by the task `uart` of the same
/// priority.
pub type UartInput = uart::Input;
/// The UART to a host.
#[cfg(feature = "usb")]
pub type SerialPort = uart::InterruptPort;
/// The UART to a host.
#[cfg(not(feature = "usb"))]
pub type SerialPort = uart::DmaPort;
/// The USB link to a host.
#[cfg(feature = "usb")]
pub type UsbPort = stm32f4::usb::UsbPort;
/// No USB link: on a Nucleo, the board's USB socket belongs to the ST-LINK.
#[cfg(not(feature = "usb"))]
pub type UsbPort = crate::NoPort;
/// The step and direction outputs, and the PWM of the spindle.
pub type StepPins = stm32f4::StepPins;
/// The parts of the board that [`setup`] returns, each for one task.
pub type Parts = stm32f4::Parts<UartInput, SerialPort, UsbPort>;

/// Sets up clocks, pins, timers and links; all outputs are off. Call once. `low_voltage` is called at the highest
/// priority when the supply falls below 2.9 V.
pub fn setup(device: pac::Peripherals, low_voltage: fn() -> !) -> Parts {
    let table = pin_table();
    stm32f4::begin_with_reset(&device.RCC, &device.SYSCFG);
    stm32f4::await_voltage(&device.PWR);
    #[cfg(any(feature = "stm32f411", feature = "stm32f412"))]
    stm32f4::full_core_voltage(&device.PWR);
    let oscillator_mhz = clocks::find_oscillator(&device.RCC, table);
    let config = Config::hsi().sysclk(CORE_HZ.Hz());
    #[cfg(feature = "usb")]
    let config = config.require_pll48clk();
    let mut rcc = device.RCC.freeze(config);
    if let Some(mhz) = oscillator_mhz {
        clocks::change_source(&rcc, mhz);
        stm32f4::watch_clock();
    }
    stm32f4::watch_voltage(&device.PWR, &device.EXTI, low_voltage);
    // This resets port A, so it comes before the pins of the table are set up.
    let a = device.GPIOA.split(&mut rcc);
    pins::clock_ports(&mut rcc);
    pins::release_debug_pins(table);
    let slow_pins = SlowPins::new(table);
    let inputs = InputPins::new(table);
    let rings = cortex_m::singleton!(: stm32f4::Rings = stm32f4::Rings::EMPTY);
    let step_pins = stm32f4::step_pins(table, (device.TIM1, device.TIM5, device.TIM3), rings, &mut rcc);
    let link = serial::Config::default().baudrate(stm32f4::USUAL_BAUD.bps());
    #[cfg(feature = "usb")]
    let (tx, mut rx, usart) = (a.pa9, a.pa10.into_alternate::<7>(), device.USART1);
    #[cfg(not(feature = "usb"))]
    let (tx, mut rx, usart) = (a.pa2, a.pa3.into_alternate::<7>(), device.USART2);
    // If no host drives the input (no cable, an ST-LINK with open solder bridges or without power), the pull-up keeps
    // it high. Otherwise noise would be received as commands.
    rx.set_internal_resistor(Pull::Up);
    let Ok(usart) = serial::Serial::new(usart, (tx, rx), link, &mut rcc) else {
        // Not reached: the clocks of the USARTs, 42 to 96 MHz, give 115200 baud to within 0.2 %.
        unreachable!()
    };
    stm32f4::start_clock(device.TIM2, &mut rcc);
    let (uart_input, serial) = uart::start(usart.split(), &mut rcc);
    #[cfg(feature = "usb")]
    let usb = {
        let registers = (device.OTG_FS_GLOBAL, device.OTG_FS_DEVICE, device.OTG_FS_PWRCLK);
        UsbPort::new(registers, (a.pa11, a.pa12), &rcc.clocks)
    };
    #[cfg(not(feature = "usb"))]
    let usb = crate::NoPort;
    Parts {
        step_pins,
        uart_input,
        serial,
        usb,
        inputs,
        slow_pins,
        settings_flash: SettingsFlash::new(device.FLASH, uart::before_stall, uart::after_stall),
        watchdog: stm32f4::Watchdog::new(device.IWDG, &device.DBGMCU),
        oscillator_mhz: oscillator_mhz.unwrap_or(0) as u8,
        fault: match oscillator_mhz {
            _ if !table.is_intact() => Some("no pin table in this firmware, or a damaged one: load it again"),
            None if table.oscillator_mhz().is_some() => Some("no crystal with the frequency of the pin table"),
            None => Some("no crystal of 8, 12, 16 or 25 MHz found"),
            Some(_) => None,
        },
    }
}
