//! What the STM32F4 boards share in setting up the chip: step pins and their timers, the microsecond clock, input
//! pins, slow outputs, the watchdog, the settings flash, the watch on the clock, the cause of a reset, and
//! the safe state of the outputs.
//!
//! Clocks, pins and other set-up go through the HAL, whose types see to it that no pin is used twice; what the step
//! interrupt touches is in `step.rs` and `chain.rs`.

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

/// A whole register as a number.
macro_rules! raw {
    ($register:expr, $bits:expr) => {{
        // SAFETY: unsafe because the device crate cannot know which numbers a register takes; safe because only timers
        // are written so: they reach no memory, and each value is explained where it is written.
        unsafe { $register.bits($bits) }
    }};
}

/// Puts step, spindle and coolant outputs into their safe levels and stops PWM and step timer. The motor drivers stay as
/// they are: an unpowered axis may drop.
pub fn safe_state() {
    // A pulse that DMA begins after these stores would undo them.
    chain::cut::<Chip>();
    for (port, safe) in SAFE.iter().enumerate() {
        write_bsrr::<Chip>(port, safe.load(Ordering::Relaxed));
    }
    // The PWM's output is forced low, too: without preload the manual does not say when a compare value acts (TIMx_CCMR1, OC1PE, note 2).
    // SAFETY: unsafe because the owners of the timers are by-passed; safe because an output that is low, a compare value of 0 and a
    // stopped counter are right at any moment that this function is called, and nothing runs after it.
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

/// Calls the step task, from any task: the call waits as a flag of its timer until it is taken.
#[inline]
pub fn call_step() {
    write(<Chip as Map>::TIM5 + timer::EGR, Due::CALLED.0);
}

/// Pins of several ports, each turned into the same: `each!([a.pa1, b.pb2].into_pull_up_input())`.
macro_rules! each {
    ([$($pin:expr),+].$turn:ident $how:tt) => {
        [$($pin.$turn $how.erase()),+]
    };
    ([$($pin:expr),+].$turn:ident $how:tt.$then:ident $so:tt) => {
        [$($pin.$turn $how.$then $so.erase()),+]
    };
}
pub(crate) use each;

/// Sets up what puts out steps: TIM5, which starts to run, TIM1, the DMA controllers; and TIM3 for the PWM, whose pin must already
/// be in its alternate function. Puts the pins to rest.
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
    // PWM mode 1 without preload: a new value, above all 0, acts at once.
    pwm.ccmr1_output().write(|w| raw!(w, 0b110 << 12));
    pwm.ccr2().write(|w| raw!(w, 0));
    pwm.ccer().write(|w| w.cc2e().set_bit());
    pwm.cr1().write(|w| w.cen().set_bit());
    // The slave's clock comes first (reference manual, timer synchronization).
    pac::TIM1::enable(rcc);
    // By the manuals of the F401 and F411 (RCC_APB2LPENR, reset value 0x0007 7930) it would stand whenever the processor sleeps, and
    // ignore its trigger; all else that is used has its clock then.
    pac::TIM1::enable_in_low_power(rcc);
    pac::TIM1::reset(rcc);
    pac::DMA1::enable(rcc);
    pac::DMA2::enable(rcc);
    pac::TIM5::enable(rcc);
    pac::TIM5::reset(rcc);
    // The HAL picks the nearest clock it can make; another one than the planner counts with would falsify every speed.
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
        // The device's peripherals are there once.
        unreachable!()
    };
    StepPins::at(at, turn_at, probe.probe(), clocks, rings, (pulse, clock, pwm, [a, b, c, d, e, f, g, h]))
}

/// Ticks of the clock in a microsecond.
pub const CLOCK_TICKS_PER_US: u32 = 1;
/// Samples of the inputs in a second, by SysTick.
pub const SAMPLE_HZ: u32 = 20_000;
/// The clock security system watches the oscillator.
pub const WATCHES_CLOCK: bool = true;

/// Starts TIM2 as the clock: 1 MHz, free-running.
pub fn start_clock(timer: pac::TIM2, rcc: &mut Rcc) {
    // The HAL's counters have an end, and this one has none: all 32 bits, as after a reset.
    let timer = FTimerUs::new(timer, rcc).release();
    // The prescaler is taken over by an update.
    timer.egr().write(|w| w.ug().set_bit());
    timer.cr1().write(|w| w.cen().set_bit());
}

/// Resets the chip if its own boot loader has jumped into the program instead of a reset, as hosts may order it to (`:leave` of
/// dfu-util): system memory is at address 0 then, with it the table of the vectors, and clocks and peripherals are as the loader left
/// them. First of all in the set-up.
pub fn begin_with_reset(rcc: &pac::RCC, syscfg: &pac::SYSCFG) {
    rcc.apb2enr().modify(|_, w| w.syscfgen().set_bit());
    // An enabled clock takes some cycles to arrive; reading back waits for them.
    let _ = rcc.apb2enr().read();
    // MEM_MODE: 0 = flash.
    if syscfg.memrmp().read().mem_mode().bits() != 0 {
        cortex_m::peripheral::SCB::sys_reset()
    }
}

/// Has the chip watch its oscillator (clock security system). If that fails, the processor continues at 16 MHz of its own and takes
/// the non-maskable interrupt, whose handler is the program's. Unwatched, the processor would stand still, and outputs stay as they
/// are until the watchdog resets. To be called when the oscillator runs.
pub fn watch_clock() {
    // SAFETY: unsafe because a bit of the clock control is set without owning it; safe because no task runs yet.
    unsafe { (*pac::RCC::ptr()).cr().modify(|_, w| w.csson().set_bit()) };
}

/// Microseconds, wrapping.
#[inline(always)]
pub fn clock_ticks() -> u32 {
    // SAFETY: unsafe because the register is read without owning the timer; safe because reading CNT has no effect.
    unsafe { (*pac::TIM2::ptr()).cnt().read().bits() }
}

/// Baud rate of the link, if no setting says another: what Grbl's senders expect.
pub const USUAL_BAUD: u32 = 115_200;

/// Inputs at most.
const MOST_INPUTS: usize = crate::PROFILE.program_pins[1] as usize + if crate::AXES > 3 { 12 } else { 11 };

/// Inputs, with pull-ups until a setting wants something else.
pub struct InputPins {
    /// Where they are, and their bits.
    places: [(Place, u32); MOST_INPUTS],
    /// How many of them there are.
    count: usize,
    probe: Place,
    /// Pins of ports A, B and C that are inputs, those that were high at the last reading, and the word of it: they change seldom.
    used: [u16; 3],
    high: [u16; 3],
    word: u32,
    _pins: [Option<ErasedPin<Input>>; MOST_INPUTS],
}

impl InputPins {
    /// The pins in this order: limit X, Y, Z, probe, door, hold, start, reset.
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

    /// And a pin for one more of [`input_bits`](crate::input_bits).
    pub fn with(mut self, bit: u32, pin: ErasedPin<Input>) -> Self {
        self._pins[self.count] = Some(pin);
        let place = self._pins[self.count].as_ref().map(Place::from);
        self.note(bit, place)
    }

    /// The last pin is this one of [`input_bits`](crate::input_bits), too: settings say as which it is used.
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

    /// Which pins are low, as `input_bits`.
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

    /// The word of the pins that are high.
    #[inline(never)]
    fn word_of_pins(&self) -> u32 {
        self.places.iter().take(self.count).fold(0, |word, (place, bit)| {
            let high = self.high.get(place.port).copied().unwrap_or(u16::MAX) >> place.pin & 1;
            word | u32::from(high ^ 1) << bit
        })
    }

    /// Which pins there are.
    pub fn fitted(&self) -> u32 {
        self.places.iter().take(self.count).fold(0, |word, (_, bit)| word | 1 << bit)
    }

    /// Pull-ups, but nothing for the inputs of one word, and pull-downs for those of the other.
    pub fn set_pulls(&mut self, none: u32, down: u32) {
        let places = self.places.get(..self.count).unwrap_or_default();
        for (place, _) in places {
            // A pin may have two bits.
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

/// Chooses the pull resistor of an input (PUPDR). The HAL does so for pins whose number is part of their type only.
fn set_pull(place: Place, pull: u32) {
    const PORT_SIZE: usize = 0x400;
    const PUPDR: usize = 0x0C;
    let register = (<Chip as Map>::GPIO + PORT_SIZE * place.port + PUPDR) as *mut u32;
    // SAFETY: unsafe because the register is reached by its address and shared by the pins of a port; safe because the port
    // is one that has been set up, and after the set-up nothing else writes it.
    unsafe {
        let others = register.read_volatile() & !(0b11 << (2 * place.pin));
        register.write_volatile(others | pull << (2 * place.pin));
    }
}

/// Outputs that change slowly, those of programs among them.
const SLOW_OUTPUTS: usize = 5 + crate::PROFILE.program_pins[0] as usize;

/// Outputs that change slowly.
pub struct SlowPins([ErasedPin<Output>; SLOW_OUTPUTS]);

impl SlowPins {
    /// The pins in this order: driver enable, spindle on, spindle reversed, flood, mist, and those of programs.
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

/// What `setup` deals out.
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

/// No debugger puts a job into the RAM of a board.
pub fn preloaded_job() -> Option<&'static [u8]> {
    None
}

/// Without a preloaded job there is no end of it.
pub fn job_done() {}

/// Sleeps until the next interrupt.
#[inline(always)]
pub fn idle() {
    cortex_m::asm::wfi();
}

/// The independent watchdog: it runs on a clock of its own (32 kHz nominal, 17 to 47 by the data sheet), so its time is
/// 2 s nominal and at least 1.3 s: more than an erase of flash takes.
pub struct Watchdog(IndependentWatchdog);

impl Watchdog {
    /// Not started yet. It holds while a debug probe has halted the processor.
    pub fn new(device: pac::IWDG, debug: &pac::DBGMCU) -> Watchdog {
        let watchdog = IndependentWatchdog::new(device);
        watchdog.stop_on_debug(debug, true);
        // So does the step clock: none begins while the processor cannot add to them, and a pulse that is out ends. The beam
        // stays as it is.
        debug.apb1_fz().modify(|_, w| w.dbg_tim5_stop().set_bit());
        Watchdog(watchdog)
    }

    /// From here on it wants to be fed.
    pub fn start(&mut self) {
        self.0.start(2_000.millis());
    }

    /// Feeds it.
    #[inline]
    pub fn feed(&mut self) {
        self.0.feed();
    }
}

/// Why the processor was reset (RCC_CSR), and clears it. Every reset also pulls the reset pin, so the pin comes last.
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
