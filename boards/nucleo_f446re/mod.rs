//! ST Nucleo-64 with STM32F446RE and an Arduino CNC shield v3 on top. Compare with the user manual (UM1724) and with the
//! print on your shield before you switch the motors' supply on.
//!
//! ```text
//!                 ┌────────────[USB, ST-LINK]────────────┐
//!                 │                                      │
//!                 │  ┌──────────────────────────┐        │
//!                 │  │ CNC shield           D15 │  PB8   │
//!                 │  │                      D14 │  PB9   │
//!                 │  │                      GND │        │
//!      3V3        │  │ 3V3                  D13 │  PA5   │  spindle direction (LED LD2)
//!      5V         │  │ 5V                   D12 │  PA6   │  Z limit
//!      GND        │  │ GND                  D11 │  PA7   │  spindle PWM / laser
//!                 │  │                      D10 │  PB6   │  Y limit
//!  reset (abort)  │  │ A0  PA0              D9  │  PC7   │  X limit
//!  hold           │  │ A1  PA1              D8  │  PA9   │  driver enable
//!  start (resume) │  │ A2  PA4              D7  │  PA8   │  Z direction
//!  flood          │  │ A3  PB0              D6  │  PB10  │  Y direction
//!  mist           │  │ A4  PC1              D5  │  PB4   │  X direction
//!  probe          │  │ A5  PC0              D4  │  PB5   │  Z step
//!                 │  │                      D3  │  PB3   │  Y step
//!                 │  │                      D2  │  PA10  │  X step
//!                 │  │                      D1  │  PA2   │  (TX to the ST-LINK)
//!                 │  └──────────────────────D0──┘  PA3   │  (RX from the ST-LINK)
//!                 │  morpho CN7: PC2 spindle on, PC3 door│
//!                 └──────────────────────────────────────┘
//! ```
//!
//! | function | pin | why there |
//! |---|---|---|
//! | step X Y Z | PA10 PB3 PB5 (D2 D3 D4) | the shield; two ports, so two stores back to back |
//! | direction X Y Z | PB4 PB10 PA8 (D5 D6 D7) | the shield; PB4 is NJTRST after reset and pulled up until set-up |
//! | driver enable | PA9 (D8) | the shield |
//! | limits X Y Z | PC7 PB6 PA6 (D9 D10 D12) | the shield with variable spindle: Z limit on D12 (`SpnEn`) because ... |
//! | spindle PWM / laser | PA7 (D11) | ... only D11 (`Z+/Z-`) has a PWM: TIM3 channel 2 |
//! | spindle direction | PA5 (D13) | the shield |
//! | spindle on | PC2 (CN7 pin 35) | the shield has none left |
//! | reset, hold, start | PA0 PA1 PA4 (A0 A1 A2) | the shield |
//! | flood, mist | PB0 PC1 (A3 A4) | the shield |
//! | probe | PC0 (A5) | the shield |
//! | door | PC3 (CN7 pin 37) | the shield has none left |
//! | host | PA2 PA3 | USART2, the ST-LINK's virtual COM port, 115200 8N1 |
//! | left alone | PA13 PA14, PC13, PC14 PC15 | SWD, button, crystal; PB3 is the Y step, so there is no SWO |
//!
//! The clock comes from the ST-LINK (MCO, 8 MHz): bypass mode. 180 MHz core, 90 MHz step clock. In reset all pins float:
//! spindle, laser and coolant need pull-down resistors, driver enable a pull-up.

use oxmill_controller::Profile;
use stm32f4xx_hal::{
    gpio::{PinState, Speed},
    prelude::*,
    rcc::Config,
    serial,
};

pub use super::stm32f4::{
    InputPins, SettingsFlash, SlowPins, StepTimer, Watchdog, call_step, clock_ticks, idle, job_done, preloaded_job,
    reset_cause, restart, safe_state,
};
pub use super::stm32f4_step::Due;
use super::{profiles, stm32f4};
pub use stm32f4xx_hal::pac;

/// The row of this board.
pub const PROFILE: Profile = super::profile(&profiles::NUCLEO_F446RE);
/// Axes that have pins.
pub const AXES: usize = profiles::NUCLEO_F446RE.axes;
/// Depth of the look-ahead.
pub const BLOCKS: usize = profiles::NUCLEO_F446RE.blocks;
/// The clock counts microseconds.
pub const CLOCK_TICKS_PER_US: u32 = 1;
/// Clock of SysTick.
pub const CORE_HZ: u32 = 180_000_000;
/// Samples of the inputs in a second.
pub const SAMPLE_HZ: u32 = 20_000;
/// A UART overwrites what is not fetched.
pub const BACK_PRESSURE: bool = false;

/// The link to the host.
pub type SerialPort = stm32f4::Usart<pac::USART2>;
/// Step pins on two ports, direction pins too.
pub type StepPins = stm32f4::StepPins<2, 2>;
/// What [`setup`] deals out.
pub type Parts = stm32f4::Parts<pac::USART2, 2, 2>;

/// Clocks, pins and timers; outputs are off.
pub fn setup(device: pac::Peripherals) -> Parts {
    let mut rcc = device.RCC.freeze(Config::hse(8.MHz()).bypass_hse_oscillator().sysclk(CORE_HZ.Hz()));
    stm32f4::watch_voltage(&device.PWR, &device.EXTI);
    let a = device.GPIOA.split(&mut rcc);
    let b = device.GPIOB.split(&mut rcc);
    let c = device.GPIOC.split(&mut rcc);

    let slow_pins = SlowPins::new([
        a.pa9.into_push_pull_output_in_state(PinState::High).erase(),
        c.pc2.into_push_pull_output_in_state(PinState::Low).erase(),
        a.pa5.into_push_pull_output_in_state(PinState::Low).erase(),
        b.pb0.into_push_pull_output_in_state(PinState::Low).erase(),
        c.pc1.into_push_pull_output_in_state(PinState::Low).erase(),
    ]);
    let inputs = InputPins::new([
        c.pc7.into_pull_up_input().erase(),
        b.pb6.into_pull_up_input().erase(),
        a.pa6.into_pull_up_input().erase(),
        c.pc0.into_pull_up_input().erase(),
        c.pc3.into_pull_up_input().erase(),
        a.pa1.into_pull_up_input().erase(),
        a.pa4.into_pull_up_input().erase(),
        a.pa0.into_pull_up_input().erase(),
    ]);
    let _pwm = a.pa7.into_alternate::<2>();
    let step_pins = stm32f4::step_pins(
        [
            a.pa10.into_push_pull_output().speed(Speed::Medium).erase(),
            b.pb3.into_push_pull_output().speed(Speed::Medium).erase(),
            b.pb5.into_push_pull_output().speed(Speed::Medium).erase(),
        ],
        [
            b.pb4.into_push_pull_output().erase(),
            b.pb10.into_push_pull_output().erase(),
            a.pa8.into_push_pull_output().erase(),
        ],
        &inputs,
        device.TIM3,
        &mut rcc,
    );
    let link = serial::Config::default().baudrate(stm32f4::BAUD.bps());
    let Ok(usart) = serial::Serial::new(device.USART2, (a.pa2, a.pa3), link, &mut rcc) else {
        // 115200 divides 45 MHz to within 0.2 %.
        unreachable!()
    };
    let (tx, rx) = usart.split();
    stm32f4::start_clock(device.TIM5, &mut rcc);
    Parts {
        step_timer: stm32f4::step_timer(device.TIM2, &mut rcc),
        step_pins,
        serial: SerialPort::new(tx, rx),
        inputs,
        slow_pins,
        settings_flash: stm32f4::settings_flash::<pac::USART2>(device.FLASH, &mut rcc),
        watchdog: stm32f4::Watchdog::new(device.IWDG, &device.DBGMCU),
    }
}
