//! Set-up of the chip, shared by the STM32F4 boards: step pins and their timers, the microsecond clock, input pins,
//! slow outputs, the watchdog, monitoring of the oscillator, the cause of a reset, and the safe state of the outputs.
//!
//! Set-up goes through the HAL, whose types ensure that no pin is used twice. The part that the step interrupt uses is
//! in `step.rs` and `chain.rs`.

use core::sync::atomic::Ordering;
use oxmill_controller::ResetCause;
use stm32f4xx_hal::{
    gpio::{ErasedPin, Input, Output, PinExt, PinState},
    pac,
    prelude::*,
    rcc::{BusTimerClock, Enable, LPEnable, Rcc, Reset},
    timer::FTimerUs,
    watchdog::IndependentWatchdog,
};

use super::SettingsFlash;
use super::chain::{self, COMPARE_PULSE};
use super::registers::{Chip, Map, read_idr, timer, write, write_bsrr};
use super::step::{self, Clocks, Place, SAFE, note_safe_level};
use crate::{Due, Port, SlowLevels};

/// Writes a whole register as a number.
macro_rules! raw {
    ($register:expr, $bits:expr) => {{
        // SAFETY: unsafe because the device crate cannot know which numbers a register takes; safe because the macro
        // writes only timers, which reach no memory, and each value is explained where it is written.
        unsafe { $register.bits($bits) }
    }};
}

/// Sets step, spindle, coolant and program outputs to their safe levels and stops PWM and step timer. The driver enable
/// does not change, because an unpowered axis may drop.
pub fn safe_state() {
    // This comes first, because a pulse that DMA begins after the stores below would undo them.
    chain::cut::<Chip>();
    for (port, safe) in SAFE.iter().enumerate() {
        write_bsrr::<Chip>(port, safe.load(Ordering::Relaxed));
    }
    // Also force the PWM's output low: without preload the manual does not say when a compare value takes effect
    // (TIMx_CCMR1, OC1PE, note 2).
    // SAFETY: unsafe because the owners of the timers are by-passed; safe because an output that is low, a compare
    // value of 0 and a stopped counter are right whenever this function is called, and no code runs after it.
    unsafe {
        (*pac::TIM3::ptr()).ccmr1_output().write(|w| w.bits(0b100 << 12));
        (*pac::TIM3::ptr()).ccr2().write(|w| w.bits(0));
        (*pac::TIM5::ptr()).cr1().write(|w| w.bits(0));
    }
}

impl<MODE> From<&ErasedPin<MODE>> for Place {
    fn from(pin: &ErasedPin<MODE>) -> Self {
        Place::new(usize::from(pin.port_id()), u32::from(pin.pin_id()))
    }
}

/// Step and direction outputs on `P` ports, with the timers that they need.
pub type StepPins<const P: usize> = step::StepPins<Chip, P, (pac::TIM1, pac::TIM5, pac::TIM3, [ErasedPin<Output>; 8])>;

/// Calls the step task, from any task. The call is a pending flag of the step task's timer until `take` clears it.
#[inline]
pub fn call_step() {
    write(<Chip as Map>::TIM5 + timer::EGR, Due::CALLED.0);
}

/// Converts pins of several ports alike: `each!([a.pa1, b.pb2].into_pull_up_input())`.
macro_rules! each {
    ([$($pin:expr),+].$turn:ident $how:tt) => {
        [$($pin.$turn $how.erase()),+]
    };
    ([$($pin:expr),+].$turn:ident $how:tt.$then:ident $so:tt) => {
        [$($pin.$turn $how.$then $so.erase()),+]
    };
}
pub(crate) use each;

/// Sets up the step output: starts TIM5, and sets up TIM1, the DMA controllers and, for the PWM, TIM3. The pin of the
/// PWM must already be in its alternate function. Sets all step and direction pins to their levels at rest.
pub fn step_pins<const P: usize>(
    step: [ErasedPin<Output>; 4],
    direction: [ErasedPin<Output>; 4],
    probe: &InputPins,
    (pulse, clock, pwm): (pac::TIM1, pac::TIM5, pac::TIM3),
    rings: Option<&'static mut step::Rings<P>>,
    rcc: &mut Rcc,
) -> StepPins<P> {
    pac::TIM3::enable(rcc);
    pac::TIM3::reset(rcc);
    // PWM mode 1 without preload: a new value takes effect at once. This matters most for 0, which switches off.
    pwm.ccmr1_output().write(|w| raw!(w, 0b110 << 12));
    pwm.ccr2().write(|w| raw!(w, 0));
    pwm.ccer().write(|w| w.cc2e().set_bit());
    pwm.cr1().write(|w| w.cen().set_bit());
    // Enable the clock of the slave timer, TIM1, first (reference manual, timer synchronization).
    pac::TIM1::enable(rcc);
    // By the manuals of the F401 and F411 (RCC_APB2LPENR, reset value 0x0007 7930), TIM1 would otherwise stop while the
    // processor sleeps and ignore its trigger. All other peripherals in use keep their clock during sleep.
    pac::TIM1::enable_in_low_power(rcc);
    pac::TIM1::reset(rcc);
    pac::DMA1::enable(rcc);
    pac::DMA2::enable(rcc);
    pac::TIM5::enable(rcc);
    pac::TIM5::reset(rcc);
    // The HAL picks the nearest clock that it can make; a clock other than the planner's would falsify every speed.
    assert_eq!(pac::TIM5::timer_clock(&rcc.clocks).raw(), crate::PROFILE.step_clock_hz);
    clock.arr().write(|w| raw!(w, u32::MAX));
    clock.cr2().write(|w| raw!(w, COMPARE_PULSE));
    clock.cr1().write(|w| w.cen().set_bit());
    let clocks = Clocks {
        pulse_mhz: pac::TIM1::timer_clock(&rcc.clocks).raw() / 1_000_000,
        pwm_hz: pac::TIM3::timer_clock(&rcc.clocks).raw(),
    };
    let (at, turn_at) = (step.each_ref().map(Place::from), direction.each_ref().map(Place::from));
    let [a, b, c, d] = step;
    let [e, f, g, h] = direction;
    let Some(rings) = rings else {
        // Not reached: `setup` takes the peripherals, so it runs only once, and the memory of the rings is still free.
        unreachable!()
    };
    StepPins::at(at, turn_at, probe.probe(), clocks, rings, (pulse, clock, pwm, [a, b, c, d, e, f, g, h]))
}

/// Ticks of [`clock_ticks`] in a microsecond.
pub const CLOCK_TICKS_PER_US: u32 = 1;
/// Samples of the inputs in a second, by SysTick.
pub const SAMPLE_HZ: u32 = 20_000;
/// The clock security system watches the oscillator.
pub const WATCHES_CLOCK: bool = true;

/// Starts TIM2 as the clock: 1 MHz, free-running.
pub fn start_clock(timer: pac::TIM2, rcc: &mut Rcc) {
    // Releases the timer from the HAL, whose counters wrap at a limit. TIM2 counts through all 32 bits, as after a
    // reset.
    let timer = FTimerUs::new(timer, rcc).release();
    // An update event loads the prescaler.
    timer.egr().write(|w| w.ug().set_bit());
    timer.cr1().write(|w| w.cen().set_bit());
}

/// Resets the chip if its boot loader jumped into the program, as hosts can order (`:leave` of dfu-util). After such a
/// jump, system memory with its vector table is at address 0, and clocks and peripherals are as the loader left them.
/// Call first in the set-up.
pub fn begin_with_reset(rcc: &pac::RCC, syscfg: &pac::SYSCFG) {
    rcc.apb2enr().modify(|_, w| w.syscfgen().set_bit());
    // An enabled clock takes some cycles to arrive; reading back waits for them.
    let _ = rcc.apb2enr().read();
    // MEM_MODE: 0 = flash.
    if syscfg.memrmp().read().mem_mode().bits() != 0 {
        cortex_m::peripheral::SCB::sys_reset()
    }
}

/// Makes the chip monitor its oscillator (clock security system). If the oscillator fails, the processor continues on
/// its internal 16 MHz and takes the non-maskable interrupt, whose handler belongs to the program. Without monitoring
/// the processor would stop, and outputs would stay as they are until the watchdog resets. Call when the oscillator
/// runs.
pub fn watch_clock() {
    // SAFETY: unsafe because a bit of the clock control is set without owning it; safe because no task runs yet.
    unsafe { (*pac::RCC::ptr()).cr().modify(|_, w| w.csson().set_bit()) };
}

/// Returns the time in microseconds; it wraps after 2^32.
#[inline(always)]
pub fn clock_ticks() -> u32 {
    // SAFETY: unsafe because the register is read without owning the timer; safe because reading CNT has no effect.
    unsafe { (*pac::TIM2::ptr()).cnt().read().bits() }
}

/// Default baud rate of the link: the one that Grbl's senders expect.
pub const USUAL_BAUD: u32 = 115_200;

/// Maximum number of inputs.
const MOST_INPUTS: usize = crate::PROFILE.program_pins[1] as usize + if crate::AXES > 3 { 12 } else { 11 };

/// Input pins; with pull-ups, unless settings choose otherwise.
pub struct InputPins {
    /// The pins and their [`input_bits`](crate::input_bits).
    places: [(Place, u32); MOST_INPUTS],
    /// The number of entries in use.
    count: usize,
    probe: Place,
    /// Masks of the pins that are inputs, of ports A, B and C.
    used: [u16; 3],
    /// Masks of the input pins that were high at the last reading. `word` is computed again only if these masks change,
    /// which is rare.
    high: [u16; 3],
    /// The result of the last reading.
    word: u32,
    _pins: [Option<ErasedPin<Input>>; MOST_INPUTS],
}

impl InputPins {
    /// Takes the pins in this order: limit X, Y, Z, probe, door, hold, start, reset.
    pub fn new(pins: [ErasedPin<Input>; 8]) -> Self {
        use crate::input_bits::{DOOR, HOLD, LIMITS, PROBE, RESET, START};
        let nowhere = Place::new(0, 0);
        let [_, _, _, probe, ..] = pins.each_ref().map(Place::from);
        let inputs = InputPins {
            places: [(nowhere, 0); MOST_INPUTS],
            count: 0,
            probe,
            used: [0; 3],
            high: [0; 3],
            word: 0,
            _pins: [const { None }; MOST_INPUTS],
        };
        let bits = [LIMITS, LIMITS + 1, LIMITS + 2, PROBE, DOOR, HOLD, START, RESET];
        pins.into_iter().zip(bits).fold(inputs, |inputs, (pin, bit)| inputs.with(bit, pin))
    }

    /// Adds an input pin and its bit, one of [`input_bits`](crate::input_bits).
    pub fn with(mut self, bit: u32, pin: ErasedPin<Input>) -> Self {
        self._pins[self.count] = Some(pin);
        let place = self._pins[self.count].as_ref().map(Place::from);
        self.note(bit, place)
    }

    /// Assigns a second of the [`input_bits`](crate::input_bits) to the pin added last; settings choose which of the
    /// two is used.
    pub fn also(self, bit: u32) -> Self {
        let place = self.places.get(self.count.wrapping_sub(1)).map(|(place, _)| *place);
        self.note(bit, place)
    }

    fn note(mut self, bit: u32, place: Option<Place>) -> Self {
        if let (Some(slot), Some(place)) = (self.places.get_mut(self.count), place) {
            *slot = (place, bit);
            self.count += 1;
            if let Some(used) = self.used.get_mut(place.port) {
                *used |= 1 << place.pin;
            }
            self.word = self.word_of_pins();
        }
        self
    }

    fn probe(&self) -> Place {
        self.probe
    }

    /// Reads the pins. Returns which are low, as `input_bits`.
    #[inline]
    pub fn read(&mut self) -> u32 {
        let [a, b, c] = self.used;
        let high = [read_idr::<Chip>(0) as u16 & a, read_idr::<Chip>(1) as u16 & b, read_idr::<Chip>(2) as u16 & c];
        if high != self.high {
            self.high = high;
            self.word = self.word_of_pins();
        }
        self.word
    }

    /// Computes the `input_bits` of the low pins from `high`.
    #[inline(never)]
    fn word_of_pins(&self) -> u32 {
        self.places.iter().take(self.count).fold(0, |word, (place, bit)| {
            let high = self.high.get(place.port).copied().unwrap_or(u16::MAX) >> place.pin & 1;
            word | u32::from(high ^ 1) << bit
        })
    }

    /// Returns which pins exist, as `input_bits`.
    pub fn fitted(&self) -> u32 {
        self.places.iter().take(self.count).fold(0, |word, (_, bit)| word | 1 << bit)
    }

    /// Sets the pull resistors: none for the inputs in `none`, pull-downs for those in `down`, pull-ups for all others.
    pub fn set_pulls(&mut self, none: u32, down: u32) {
        let places = self.places.get(..self.count).unwrap_or_default();
        for (place, _) in places {
            // A pin can have two bits (see `also`): a setting for either bit counts.
            let bits = places.iter().filter(|(other, _)| other == place).fold(0, |bits, (_, bit)| bits | 1 << bit);
            // PUPDR: 1 pulls up, 2 down.
            let pull = match (down & bits != 0, none & bits != 0) {
                (true, _) => 2,
                (_, true) => 0,
                _ => 1,
            };
            set_pull(*place, pull);
        }
    }
}

/// Sets the pull resistor of an input (PUPDR). The HAL supports this only for pins whose number is part of their type.
fn set_pull(place: Place, pull: u32) {
    const PORT_SIZE: usize = 0x400;
    const PUPDR: usize = 0x0C;
    let register = (<Chip as Map>::GPIO + PORT_SIZE * place.port + PUPDR) as *mut u32;
    // SAFETY: unsafe because the register is reached by its address and shared by the pins of a port; safe because the
    // port is one that has been set up, and after the set-up nothing else writes it.
    unsafe {
        let others = register.read_volatile() & !(0b11 << (2 * place.pin));
        register.write_volatile(others | pull << (2 * place.pin));
    }
}

/// Number of slow outputs, including those for programs.
const SLOW_OUTPUTS: usize = 5 + crate::PROFILE.program_pins[0] as usize;

/// Outputs that change slowly.
pub struct SlowPins([ErasedPin<Output>; SLOW_OUTPUTS]);

impl SlowPins {
    /// Takes the pins in this order: driver enable, spindle on, spindle reversed, flood, mist, outputs for programs.
    pub fn new(pins: [ErasedPin<Output>; SLOW_OUTPUTS]) -> Self {
        for pin in pins.iter().skip(1) {
            note_safe_level(Place::from(pin), false);
        }
        SlowPins(pins)
    }

    /// Writes all levels.
    pub fn write(&mut self, levels: SlowLevels) {
        let program = (0..u8::BITS).map(|bit| levels.program >> bit & 1 != 0);
        let levels = [levels.drivers, levels.spindle, levels.spindle_reversed, levels.flood, levels.mist];
        for (pin, high) in self.0.iter_mut().zip(levels.into_iter().chain(program)) {
            pin.set_state(PinState::from(high));
        }
    }
}

/// What `setup` returns, one part for each task.
pub struct Parts<I, S: Port, L: Port, const P: usize> {
    /// For `step`.
    pub step_pins: StepPins<P>,
    /// For `inputs`, and for the interrupt of the UART on a board that has one.
    pub uart_input: I,
    /// For `serial`.
    pub serial: S,
    /// For `serial`.
    pub usb: L,
    /// For `inputs`.
    pub inputs: InputPins,
    /// For `control`.
    pub slow_pins: SlowPins,
    /// For `control`.
    pub settings_flash: SettingsFlash,
    /// For `inputs`.
    pub watchdog: Watchdog,
}

/// Returns `None`: no job is ever put into the RAM of this board.
pub fn preloaded_job() -> Option<&'static [u8]> {
    None
}

/// Does nothing: there is no preloaded job.
pub fn job_done() {}

/// Sleeps until the next interrupt.
#[inline(always)]
pub fn idle() {
    cortex_m::asm::wfi();
}

/// The independent watchdog. It runs on its own clock (32 kHz nominal, 17 to 47 by the data sheet), so its timeout is 2
/// s nominal and at least 1.3 s: more than a flash erase takes.
pub struct Watchdog(IndependentWatchdog);

impl Watchdog {
    /// Creates the watchdog, not started yet. It pauses while a debug probe has halted the processor.
    pub fn new(device: pac::IWDG, debug: &pac::DBGMCU) -> Watchdog {
        let watchdog = IndependentWatchdog::new(device);
        watchdog.stop_on_debug(debug, true);
        // The step clock pauses, too, so that no step begins while the halted processor cannot commit more events. A
        // pulse in progress ends. The laser's power does not change.
        debug.apb1_fz().modify(|_, w| w.dbg_tim5_stop().set_bit());
        Watchdog(watchdog)
    }

    /// Starts the watchdog: from now on it must be fed.
    pub fn start(&mut self) {
        self.0.start(2_000.millis());
    }

    /// Restarts the timeout.
    #[inline]
    pub fn feed(&mut self) {
        self.0.feed();
    }
}

/// Returns the cause of the last reset (RCC_CSR) and clears it. Every reset also pulls the reset pin, so the flag of
/// that pin is checked after the others.
pub fn reset_cause() -> ResetCause {
    // SAFETY: unsafe because the clock control is by-passed; safe because nothing else uses this register.
    let csr = unsafe { (*pac::RCC::ptr()).csr() };
    let flags = csr.read();
    csr.modify(|_, w| w.rmvf().set_bit());
    let flag = |bit: u32| flags.bits() >> bit & 1 != 0;
    if flag(29) || flag(30) {
        ResetCause::Watchdog
    } else if flag(28) {
        ResetCause::Software
    } else if flag(27) {
        ResetCause::Power
    } else if flag(25) {
        ResetCause::BrownOut
    } else if flag(26) {
        ResetCause::Pin
    } else {
        ResetCause::Other
    }
}
