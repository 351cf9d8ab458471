//! Set-up of the chip, shared by the STM32F4 boards: step pins and their timers, the microsecond clock, input pins,
//! slow outputs, the watchdog, monitoring of the oscillator, the cause of a reset, and the safe state of the outputs.
//!
//! The pin table of the image says which pins there are. The code that the step interrupt uses is not here, but in
//! `step.rs` and `chain.rs`.

use core::sync::atomic::Ordering;
use oxmill_controller::ResetCause;
use stm32f4xx_hal::{
    pac,
    prelude::*,
    rcc::{BusTimerClock, Enable, LPEnable, Rcc, Reset},
    timer::FTimerUs,
    watchdog::IndependentWatchdog,
};

use super::SettingsFlash;
use super::chain::{self, COMPARE_PULSE};
use super::pins;
use super::registers::{Chip, Map, read_idr, timer, write, write_bsrr};
use super::step::{self, Clocks, PORTS, Place, Pwm, SAFE, bsrr, note_safe_level};
use crate::pin_table::{Pin, PinTable, Role};
use crate::{Due, MOTOR_PORTS, Port, STEP_PORTS, SlowLevels, TIM8_MAKES_PULSES};

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
    chain::cut::<Chip, STEP_PORTS, MOTOR_PORTS>();
    for (port, safe) in SAFE.iter().enumerate() {
        write_bsrr::<Chip>(port, safe.load(Ordering::Relaxed));
    }
    // Also force the PWM's output low. Without preload, the manual does not guarantee when a compare value of 0 takes
    // effect (TIMx_CCMR1, OC1PE, note 2).
    // SAFETY: unsafe because the owners of the timers are by-passed; safe because outputs that are low and a stopped
    // counter are right whenever this function is called, and no code runs after it.
    unsafe {
        (*pac::TIM3::ptr()).ccmr1_output().write(|w| w.bits(FORCED_LOW));
        (*pac::TIM3::ptr()).ccmr2_output().write(|w| w.bits(FORCED_LOW));
        (*pac::TIM5::ptr()).cr1().write(|w| w.bits(0));
    }
    if TIM8_MAKES_PULSES {
        // SAFETY: as above.
        unsafe {
            (*pac::TIM1::ptr()).ccmr1_output().write(|w| w.bits(FORCED_LOW));
            (*pac::TIM1::ptr()).ccmr2_output().write(|w| w.bits(FORCED_LOW));
        }
    }
    for power in [timer::CCR1, timer::CCR2, timer::CCR3, timer::CCR4] {
        write(<Chip as Map>::TIM3 + power, 0);
        if TIM8_MAKES_PULSES {
            write(<Chip as Map>::TIM1 + power, 0);
        }
    }
}

/// CCMR1 and CCMR2 of the PWM's timer: both channels in PWM mode 1, without preload.
const PWM_MODE: u32 = 0b110 << 4 | 0b110 << 12;
/// CCMR1 and CCMR2 of the PWM's timer: both channels low.
const FORCED_LOW: u32 = 0b100 << 4 | 0b100 << 12;

/// Step and direction outputs, with the timers that they need.
pub type StepPins = step::StepPins<Chip, STEP_PORTS, MOTOR_PORTS, Timers>;
/// The rings of events, in RAM, that DMA reads.
pub type Rings = step::Rings<MOTOR_PORTS>;

/// The timers that the step output owns: TIM1 (pulses, or PWM if TIM8 makes the pulses), TIM5 (step clock) and TIM3
/// (PWM).
pub type Timers = (pac::TIM1, pac::TIM5, pac::TIM3);

/// Calls the step task; any task may do so. The call stays pending, as a flag of TIM5, until `take` clears the flag.
#[inline]
pub fn call_step() {
    write(<Chip as Map>::TIM5 + timer::EGR, Due::CALLED.0);
}

/// Sets up the step output: starts TIM5, and sets up TIM1, TIM8 if it is needed, the DMA controllers and the PWM. Sets
/// all step and direction pins to their levels at rest.
pub fn step_pins(
    table: &PinTable,
    (tim1, clock, tim3): Timers,
    rings: Option<&'static mut Rings>,
    rcc: &mut Rcc,
) -> StepPins {
    // Enable the clocks of the slave timers, TIM1 and TIM8, first (reference manual, timer synchronization).
    pac::TIM1::enable(rcc);
    // Keep the clock of TIM1 on while the processor sleeps. Otherwise TIM1 would stop during sleep and would ignore
    // its trigger (manuals of the F401 and F411, RCC_APB2LPENR, reset value 0x0007 7930). All other peripherals in use
    // keep their clock during sleep.
    pac::TIM1::enable_in_low_power(rcc);
    pac::TIM1::reset(rcc);
    pac::TIM3::enable(rcc);
    pac::TIM3::reset(rcc);
    // Without preload, a new compare value (the power) takes effect at once. This matters most for 0, which switches
    // the spindle or the laser off. CCER has four bits for each channel, of which the first enables its output.
    let pwm_pin = table.pin(Role::SpindlePwm);
    let pwm = match pwm_pin.and_then(Pin::channel_of_tim1).filter(|_| TIM8_MAKES_PULSES) {
        Some(channel) => {
            tim1.ccmr1_output().write(|w| raw!(w, PWM_MODE));
            tim1.ccmr2_output().write(|w| raw!(w, PWM_MODE));
            tim1.ccer().write(|w| raw!(w, 1 << (4 * channel)));
            // The outputs of an advanced timer also need MOE.
            tim1.bdtr().write(|w| w.moe().set_bit());
            tim1.cr1().write(|w| w.cen().set_bit());
            Pwm::of_tim1::<Chip>(channel)
        }
        None => {
            let channel = pwm_pin.and_then(Pin::channel_of_tim3).unwrap_or(0);
            tim3.ccmr1_output().write(|w| raw!(w, PWM_MODE));
            tim3.ccmr2_output().write(|w| raw!(w, PWM_MODE));
            tim3.ccer().write(|w| raw!(w, 1 << (4 * channel)));
            tim3.cr1().write(|w| w.cen().set_bit());
            Pwm::of_tim3::<Chip>(channel)
        }
    };
    #[cfg(feature = "tim8")]
    {
        pac::TIM8::enable(rcc);
        pac::TIM8::enable_in_low_power(rcc);
        pac::TIM8::reset(rcc);
    }
    pac::DMA1::enable(rcc);
    pac::DMA2::enable(rcc);
    pac::TIM5::enable(rcc);
    pac::TIM5::reset(rcc);
    // The HAL picks the nearest clock that it can make. With a clock other than the one in the profile, every speed of
    // the machine would be wrong.
    assert_eq!(pac::TIM5::timer_clock(&rcc.clocks).raw(), crate::PROFILE.step_clock_hz);
    clock.arr().write(|w| raw!(w, u32::MAX));
    clock.cr2().write(|w| raw!(w, COMPARE_PULSE));
    clock.cr1().write(|w| w.cen().set_bit());
    let clocks = Clocks {
        pulse_mhz: pac::TIM1::timer_clock(&rcc.clocks).raw() / 1_000_000,
        pwm_hz: if pwm.is_in_reach { pac::TIM3::timer_clock(&rcc.clocks) } else { pac::TIM1::timer_clock(&rcc.clocks) }
            .raw(),
    };
    use Role::{DirectionFourth, DirectionX, DirectionY, DirectionZ, StepFourth, StepX, StepY, StepZ};
    let step = pins::places(table, &[StepX, StepY, StepZ, StepFourth]);
    let direction = pins::places(table, &[DirectionX, DirectionY, DirectionZ, DirectionFourth]);
    step.into_iter().flatten().for_each(pins::step_output);
    direction.into_iter().flatten().for_each(|place| pins::output(place, false));
    if let Some(place) = pins::place(table, Role::SpindlePwm) {
        pins::pwm(place, pwm);
    }
    let Some(rings) = rings else {
        // Not reached: `setup` takes the peripherals, so it runs only once, and the memory of the rings is still free.
        unreachable!()
    };
    StepPins::at(step, direction, pins::place(table, Role::Probe), pwm, clocks, rings, (tim1, clock, tim3))
}

/// Ticks of [`clock_ticks`] in a microsecond.
pub const CLOCK_TICKS_PER_US: u32 = 1;
/// Rate, in Hz, at which SysTick samples the inputs.
pub const SAMPLE_HZ: u32 = 20_000;
/// True: the clock security system watches the oscillator ([`watch_clock`]).
pub const WATCHES_CLOCK: bool = true;

/// Starts TIM2 as the clock: 1 MHz, free-running.
pub fn start_clock(timer: pac::TIM2, rcc: &mut Rcc) {
    // Let the HAL set the prescaler, and take the timer back. A counter of the HAL would wrap at a limit, but TIM2
    // must count through all 32 bits, as after a reset.
    let timer = FTimerUs::new(timer, rcc).release();
    // An update event loads the prescaler.
    timer.egr().write(|w| w.ug().set_bit());
    timer.cr1().write(|w| w.cen().set_bit());
}

/// Resets the chip if its boot loader has jumped into the program, which a host can request (`:leave` of dfu-util).
/// After such a jump, address 0 shows the vector table of the boot loader instead of the flash, and clocks and
/// peripherals are as the boot loader left them. Call first in the set-up.
pub fn begin_with_reset(rcc: &pac::RCC, syscfg: &pac::SYSCFG) {
    rcc.apb2enr().modify(|_, w| w.syscfgen().set_bit());
    // An enabled clock takes some cycles to arrive; reading back waits for them.
    let _ = rcc.apb2enr().read();
    // MEM_MODE: 0 = flash.
    if syscfg.memrmp().read().mem_mode().bits() != 0 {
        cortex_m::peripheral::SCB::sys_reset()
    }
}

/// Makes the chip monitor its oscillator (clock security system). Call when the oscillator runs. If it fails later,
/// the processor continues on its internal 16 MHz and takes the non-maskable interrupt, whose handler belongs to the
/// program. Without monitoring, the processor would stop, and the outputs would stay as they are until the watchdog
/// resets.
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

/// The functions of the pin table that are inputs.
const INPUTS: [Role; 13] = [
    Role::LimitX,
    Role::LimitY,
    Role::LimitZ,
    Role::LimitFourth,
    Role::Probe,
    Role::Door,
    Role::Hold,
    Role::Start,
    Role::Reset,
    Role::DriverFault,
    Role::AtSpeed,
    Role::ProgramInput,
    Role::SecondProgramInput,
];
/// For each of [`INPUTS`], the number of its bit in the word of [`InputPins::read`].
const BITS: [u8; INPUTS.len()] = {
    use crate::input_bits::*;
    let bits = [
        LIMITS,
        LIMITS + 1,
        LIMITS + 2,
        SECOND_LIMIT,
        PROBE,
        DOOR,
        HOLD,
        START,
        RESET,
        DRIVER_FAULT,
        AT_SPEED,
        PROGRAM,
        SECOND_PROGRAM,
    ];
    let (mut short, mut at) = ([0; INPUTS.len()], 0);
    while at < INPUTS.len() {
        short[at] = bits[at] as u8;
        at += 1;
    }
    short
};

/// Input pins. They have pull-ups unless settings choose otherwise.
pub struct InputPins {
    /// For each function of [`INPUTS`]: its pin, if the board has one.
    places: [Option<Place>; INPUTS.len()],
    /// Masks of the pins that are inputs, for each port.
    used: [u16; PORTS],
    /// Masks of the input pins that were high at the last reading. `word` is computed again only if these masks change,
    /// which is rare.
    high: [u16; PORTS],
    /// The result of the last reading.
    word: u32,
}

impl InputPins {
    /// Makes a pin an input with a pull-up if the table gives it the function of an input.
    pub fn new(table: &PinTable) -> Self {
        let places = pins::places(table, &INPUTS);
        let mut used = [0; PORTS];
        for place in places.into_iter().flatten() {
            pins::input(place);
            if let Some(used) = used.get_mut(place.port()) {
                *used |= 1 << place.pin();
            }
        }
        let high = [0; PORTS];
        InputPins { places, used, high, word: low_of(&places, &high) }
    }

    /// Reads the input pins. Returns a bit of `input_bits` for each pin that is low.
    #[inline]
    pub fn read(&mut self) -> u32 {
        let mut high = [0; PORTS];
        for (port, (high, used)) in high.iter_mut().zip(self.used).enumerate() {
            *high = read_idr::<Chip>(port) as u16 & used;
        }
        if high != self.high {
            self.high = high;
            self.word = low_of(&self.places, &high);
        }
        self.word
    }

    /// Returns a bit of `input_bits` for each input that has a pin on this board.
    pub fn fitted(&self) -> u32 {
        low_of(&self.places, &[0; PORTS])
    }

    /// Sets the pull resistors of the inputs. `none` and `down` are masks of `input_bits`. An input in `down` gets a
    /// pull-down, any other input in `none` gets no resistor, and the rest get pull-ups.
    pub fn set_pulls(&mut self, none: u32, down: u32) {
        for (place, bit) in self.places.iter().zip(&BITS) {
            let Some(place) = place else { continue };
            let bits = bits_of(*bit);
            // PUPDR: 1 pulls up, 2 down.
            let pull = match (down & bits != 0, none & bits != 0) {
                (true, _) => 2,
                (_, true) => 0,
                _ => 1,
            };
            pins::set_pull(*place, pull);
        }
    }
}

/// Returns the `input_bits` of the pins that are low, from the levels of all ports.
#[inline(never)]
fn low_of(places: &[Option<Place>], high: &[u16]) -> u32 {
    let low = places.iter().zip(&BITS).filter(|(place, _)| place.is_some_and(|place| is_low(place, high)));
    low.fold(0, |word, (_, bit)| word | bits_of(*bit))
}

#[inline(never)]
fn is_low(place: Place, high: &[u16]) -> bool {
    high.get(place.port()).copied().unwrap_or(u16::MAX) >> place.pin() & 1 == 0
}

/// Returns the mask for an input with this bit number. On a board with four axes, the limit switch of the fourth motor
/// has two bits: settings decide whether it is the switch of a second motor or of axis A.
fn bits_of(bit: u8) -> u32 {
    use crate::input_bits::{LIMITS, SECOND_LIMIT};
    let is_of_fourth_axis = crate::AXES > 3 && u32::from(bit) == SECOND_LIMIT;
    1 << bit | if is_of_fourth_axis { 1 << (LIMITS + 3) } else { 0 }
}

/// Number of enable outputs, which come first in [`SLOW_OUTPUTS`]. The set-up makes them high and the other slow
/// outputs low, which switches everything off.
const ENABLES: usize = 4;
/// The functions that are slow outputs, in the order of the bits that [`SlowPins::write`] composes.
const SLOW_OUTPUTS: [Role; 10] = [
    Role::Enable,
    Role::SecondEnable,
    Role::ThirdEnable,
    Role::FourthEnable,
    Role::SpindleOn,
    Role::SpindleDirection,
    Role::Flood,
    Role::Mist,
    Role::ProgramOutput,
    Role::SecondProgramOutput,
];

/// Outputs that change slowly: driver enables, spindle, coolant, outputs for programs.
pub struct SlowPins([Option<Place>; SLOW_OUTPUTS.len()]);

impl SlowPins {
    /// Makes the pins of the slow outputs output pins, at levels that switch off everything except the motors' supply.
    /// The drivers are off at a high level.
    pub fn new(table: &PinTable) -> Self {
        let places = pins::places(table, &SLOW_OUTPUTS);
        let (enables, others) = places.split_at(ENABLES);
        for place in enables.iter().flatten() {
            pins::output(*place, true);
        }
        for place in others.iter().flatten() {
            pins::output(*place, false);
            note_safe_level(*place, false);
        }
        if let Some(place) = pins::place(table, Role::MotorPower) {
            // The supply of the motors stays on, also in the safe state, because an unpowered axis may drop.
            pins::output(place, true);
        }
        SlowPins(places)
    }

    /// Writes the levels of all slow outputs; ignores outputs that have no pin on this board.
    pub fn write(&mut self, levels: SlowLevels) {
        let SlowLevels { drivers, spindle, spindle_reversed, flood, mist, program } = levels;
        let enables = if drivers { (1 << ENABLES) - 1 } else { 0 };
        let others = [spindle, spindle_reversed, flood, mist, program & 1 != 0, program & 2 != 0];
        let others = others.into_iter().rev().fold(0, |bits, high| bits << 1 | u32::from(high));
        let levels = enables | others << ENABLES;
        for (at, place) in self.0.iter().enumerate() {
            write_level(*place, levels >> at & 1 != 0);
        }
    }
}

#[inline(never)]
fn write_level(place: Option<Place>, high: bool) {
    if let Some(place) = place {
        write_bsrr::<Chip>(place.port(), bsrr(place.pin(), high));
    }
}

/// The parts of the board that `setup` returns. The comment of a part names the task that gets it.
pub struct Parts<I, S: Port, L: Port> {
    /// Given to the task `step`.
    pub step_pins: StepPins,
    /// Given to the task `inputs`; with USB, the interrupt of the UART (task `uart`) uses it, too.
    pub uart_input: I,
    /// Given to the task `serial`.
    pub serial: S,
    /// Given to the task `serial`.
    pub usb: L,
    /// Given to the task `inputs`.
    pub inputs: InputPins,
    /// Given to the task `control`.
    pub slow_pins: SlowPins,
    /// Given to the task `control`.
    pub settings_flash: SettingsFlash,
    /// Given to the task `inputs`.
    pub watchdog: Watchdog,
    /// Frequency of the external oscillator, MHz; 0 if the chip runs on its internal one.
    pub oscillator_mhz: u8,
    /// Why the machine must stay locked, if the set-up has found a reason.
    pub fault: Option<&'static str>,
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

/// The independent watchdog. It has a clock of its own: 32 kHz nominal, 17 to 47 kHz by the data sheet. So its timeout
/// is 2 s nominal and at least 1.3 s, which is more than a flash erase takes.
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

    /// Starts the watchdog: from now on it must be fed at least once per 1.3 s.
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
