//! What the STM32F4 boards share: the step timer, ports written as a whole, the spindle's PWM, the USART.
//!
//! Clocks, pins and other set-up go through the HAL, whose types see to it that no pin is used twice; what the step
//! interrupt touches is written as registers, because there each instruction counts.

use core::sync::atomic::{AtomicU32, Ordering};
use stm32f4xx_hal::{
    gpio::{ErasedPin, Input, Output, PinExt},
    nb, pac,
    prelude::*,
    rcc::{BusTimerClock, Enable, Rcc, Reset},
    serial::{Instance, Rx, RxListen, Tx, TxListen},
};

use super::{Incoming, SlowLevels};

#[path = "stm32f4_flash.rs"]
mod flash;
#[path = "stm32f4_shelter.rs"]
mod shelter;

pub use flash::SettingsFlash;
use shelter::{Sheltered, Taken, shelter};

/// A whole register as a number.
macro_rules! raw {
    ($register:expr, $bits:expr) => {{
        // SAFETY: unsafe because the device crate cannot know which numbers a register takes; safe because only timers
        // and the supply are written so: they reach no memory, and each value is explained where it is written.
        unsafe { $register.bits($bits) }
    }};
}

/// Lets the core's supply carry the full clock: an F411 wakes up at a scale for 84 MHz (reference manual, PWR_CR, VOS), and
/// the HAL leaves it there. The scale can be changed only while the PLL is off.
#[cfg(feature = "blackpill_f411")]
pub fn full_core_voltage(rcc: &pac::RCC, pwr: &pac::PWR) {
    rcc.apb1enr().modify(|_, w| w.pwren().set_bit());
    // An enabled clock takes two bus cycles to arrive; reading back waits for them.
    let _ = rcc.apb1enr().read();
    pwr.cr().modify(|r, w| raw!(w, r.bits() | 0b11 << 14));
}

/// Ports A, B and C: all that these boards bring out.
const PORTS: usize = 3;

/// Address of a register of a port (reference manual: ports lie 0x400 apart from 0x4002_0000).
const fn port_register(port: usize, offset: usize) -> usize {
    0x4002_0000 + 0x400 * port + offset
}

/// Sets and resets pins of a port at one moment: low half sets, high half resets.
#[inline(always)]
fn write_bsrr(port: usize, value: u32) {
    // SAFETY: unsafe because a raw address is written; safe because `port` counts ports A to C, whose clocks are on since
    // `setup`, and BSRR changes the named pins in one store without disturbing the other owners of the port.
    unsafe { (port_register(port, 0x18) as *mut u32).write_volatile(value) }
}

/// Levels of the pins of a port.
#[inline(always)]
fn read_idr(port: usize) -> u32 {
    // SAFETY: unsafe because a raw address is read; safe because `port` counts ports A to C and reading IDR has no effect.
    unsafe { (port_register(port, 0x10) as *const u32).read_volatile() }
}

/// What to write to each port so that nothing moves, turns, burns or flows. Kept here and not with a task, because a
/// panic may come in any of them.
static SAFE: [AtomicU32; PORTS] = [const { AtomicU32::new(0) }; PORTS];

/// Notes the level that makes a pin safe.
fn note_safe_level(port: usize, pin: u32, high: bool) {
    if let Some(safe) = SAFE.get(port) {
        let both = 0x1_0001 << pin;
        let one = if high { 1 << pin } else { 0x1_0000 << pin };
        // Set-up and the step task are the only writers and never run at the same time.
        safe.store(safe.load(Ordering::Relaxed) & !both | one, Ordering::Relaxed);
    }
}

/// Puts step, spindle and coolant outputs into their safe levels and stops PWM and step timer. The motor drivers stay as
/// they are: an unpowered axis may drop.
pub fn safe_state() {
    for (port, safe) in SAFE.iter().enumerate() {
        write_bsrr(port, safe.load(Ordering::Relaxed));
    }
    // SAFETY: unsafe because the owners of the timers are by-passed; safe because a compare value of 0 and a stopped
    // counter are right at any moment that this function is called, and nothing runs after it.
    unsafe {
        (*pac::TIM3::ptr()).ccr2().write(|w| w.bits(0));
        (*pac::TIM2::ptr()).cr1().write(|w| w.bits(0));
    }
}

/// Place of a pin.
#[derive(Clone, Copy)]
struct Place {
    port: usize,
    pin: u32,
}

impl<MODE> From<&ErasedPin<MODE>> for Place {
    fn from(pin: &ErasedPin<MODE>) -> Self {
        Place { port: usize::from(pin.port_id()), pin: u32::from(pin.pin_id()) }
    }
}

/// BSRR word that gives a pin a level.
const fn bsrr(pin: u32, high: bool) -> u32 {
    if high { 1 << pin } else { 0x1_0000 << pin }
}

/// Three pins on at most two ports, written by table: one store for each port.
struct Lines {
    places: [Place; 3],
    ports: [usize; 2],
    /// Whether the second port is in use.
    two: bool,
    /// BSRR words for each combination of bits, for each port.
    words: [[u32; 8]; 2],
}

impl Lines {
    fn new(pins: &[ErasedPin<Output>; 3]) -> Lines {
        let places = pins.each_ref().map(Place::from);
        let first = places[0].port;
        let second = places.iter().map(|p| p.port).find(|port| *port != first).unwrap_or(first);
        Lines { places, ports: [first, second], two: second != first, words: [[0; 8]; 2] }
    }

    /// Fills the tables. `both` = a bit of 0 writes the opposite level; otherwise it leaves the pin alone.
    fn fill(&mut self, invert: u8, both: bool) {
        for (port, words) in self.ports.into_iter().zip(&mut self.words) {
            for (bits, word) in words.iter_mut().enumerate() {
                *word = 0;
                for (i, place) in self.places.iter().enumerate().filter(|(_, place)| place.port == port) {
                    let set = bits >> i & 1 != 0;
                    if set || both {
                        *word |= bsrr(place.pin, set != (invert >> i & 1 != 0));
                    }
                }
            }
        }
        if !self.two {
            self.words[1] = [0; 8];
        }
    }

    #[inline(always)]
    fn write(&self, bits: u8) {
        let bits = usize::from(bits & 7);
        write_bsrr(self.ports[0], self.words[0][bits]);
        if self.two {
            write_bsrr(self.ports[1], self.words[1][bits]);
        }
    }
}

/// Step and direction outputs and the spindle's PWM (TIM3 channel 2).
pub struct StepPins {
    raise: Lines,
    lower: Lines,
    direction: Lines,
    pwm: pac::TIM3,
    pwm_period: u32,
    /// Of the touch probe; the pin itself belongs to the inputs.
    probe: Place,
    /// Owned so that nobody else can get at the pins.
    _pins: [ErasedPin<Output>; 6],
}

/// PWM of spindle and laser: fast enough for a laser's supply, slow enough for an opto-coupler before a frequency
/// converter.
const PWM_HZ: u32 = 5_000;

impl StepPins {
    /// Sets up TIM3 and the tables. The PWM pin must already be in its alternate function.
    pub fn new(
        step: [ErasedPin<Output>; 3],
        direction: [ErasedPin<Output>; 3],
        probe: &InputPins,
        pwm: pac::TIM3,
        rcc: &mut Rcc,
    ) -> Self {
        pac::TIM3::enable(rcc);
        pac::TIM3::reset(rcc);
        let pwm_period = pac::TIM3::timer_clock(&rcc.clocks).raw() / PWM_HZ;
        pwm.arr().write(|w| raw!(w, pwm_period - 1));
        // PWM mode 1 without preload: a new value, above all 0, acts at once.
        pwm.ccmr1_output().write(|w| raw!(w, 0b110 << 12));
        pwm.ccr2().write(|w| raw!(w, 0));
        pwm.ccer().write(|w| w.cc2e().set_bit());
        pwm.cr1().write(|w| w.cen().set_bit());
        let (raise, lower) = (Lines::new(&step), Lines::new(&step));
        let dir = Lines::new(&direction);
        let [x, y, z] = step;
        let [u, v, w] = direction;
        let mut pins =
            StepPins { raise, lower, direction: dir, pwm, pwm_period, probe: probe.probe(), _pins: [x, y, z, u, v, w] };
        pins.set_polarity(0, 0);
        pins
    }

    /// Takes over which outputs are inverted, and puts them to rest.
    pub fn set_polarity(&mut self, step_invert: u8, direction_invert: u8) {
        self.raise.fill(step_invert, false);
        self.lower.fill(!step_invert, false);
        self.direction.fill(direction_invert, true);
        for (i, place) in self.raise.places.iter().enumerate() {
            note_safe_level(place.port, place.pin, step_invert >> i & 1 != 0);
        }
        self.lower();
    }

    /// Begins a pulse on the axes of `steps`.
    #[inline(always)]
    pub fn raise(&mut self, steps: u8) {
        self.raise.write(steps);
    }

    /// Ends all pulses.
    #[inline(always)]
    pub fn lower(&mut self) {
        self.lower.write(7);
    }

    /// Sets the directions; a set bit means negative.
    #[inline(always)]
    pub fn direct(&mut self, directions: u8) {
        self.direction.write(directions);
    }

    /// Sets the power of spindle or laser, 0 to 65535.
    #[inline(always)]
    pub fn set_power(&mut self, power: u16) {
        // 65535 becomes 65536/65536: fully on.
        let share = u32::from(power) + u32::from(power >> 15);
        let compare = (share * self.pwm_period) >> 16;
        self.pwm.ccr2().write(|w| raw!(w, compare));
    }

    /// Whether the probe's pin is low, unfiltered.
    #[inline(always)]
    pub fn probe_low(&self) -> bool {
        read_idr(self.probe.port) >> self.probe.pin & 1 == 0
    }

    /// Time passes in which nothing is written.
    #[inline(always)]
    pub fn pass(&mut self, _ticks: u32) {}
}

/// TIM2 as a free-running counter; channel 1 is the next tick, channel 2 the end of the pulse.
pub struct StepTimer(pac::TIM2);

/// Flag and enable bit of channel 1 in SR, DIER and EGR; channel 2 is the next bit.
const CHANNEL_1: u32 = 2;
const CHANNEL_2: u32 = 4;

impl StepTimer {
    /// Starts the counter.
    pub fn new(timer: pac::TIM2, rcc: &mut Rcc) -> Self {
        pac::TIM2::enable(rcc);
        pac::TIM2::reset(rcc);
        // The HAL picks the nearest clock it can make; another one than the planner counts with would falsify every speed.
        assert_eq!(pac::TIM2::timer_clock(&rcc.clocks).raw(), super::PROFILE.step_clock_hz);
        timer.arr().write(|w| raw!(w, u32::MAX));
        timer.cr1().write(|w| w.cen().set_bit());
        StepTimer(timer)
    }

    /// The step clock.
    #[inline(always)]
    pub fn now(&self) -> u32 {
        self.0.cnt().read().bits()
    }

    /// Calls the step task at a moment; at once if the moment is over.
    #[inline(always)]
    pub fn tick_at(&mut self, when: u32) {
        self.0.ccr1().write(|w| raw!(w, when));
        self.0.sr().write(|w| raw!(w, !CHANNEL_1));
        self.0.dier().modify(|r, w| raw!(w, r.bits() | CHANNEL_1));
        if (self.now().wrapping_sub(when) as i32) >= 0 {
            self.0.egr().write(|w| raw!(w, CHANNEL_1));
        }
    }

    /// No more ticks.
    #[inline(always)]
    pub fn tick_off(&mut self) {
        self.0.dier().modify(|r, w| raw!(w, r.bits() & !CHANNEL_1));
        self.0.sr().write(|w| raw!(w, !CHANNEL_1));
    }

    /// Whether the moment of [`StepTimer::tick_at`] has come; true once.
    #[inline(always)]
    pub fn take_tick(&mut self) -> bool {
        self.take(CHANNEL_1)
    }

    /// Calls the step task at the end of a pulse.
    #[inline(always)]
    pub fn pulse_end_at(&mut self, when: u32) {
        self.0.ccr2().write(|w| raw!(w, when));
        self.0.sr().write(|w| raw!(w, !CHANNEL_2));
        self.0.dier().modify(|r, w| raw!(w, r.bits() | CHANNEL_2));
        if (self.now().wrapping_sub(when) as i32) >= 0 {
            self.0.egr().write(|w| raw!(w, CHANNEL_2));
        }
    }

    /// Whether the moment of [`StepTimer::pulse_end_at`] has come; true once.
    #[inline(always)]
    pub fn take_pulse_end(&mut self) -> bool {
        let over = self.take(CHANNEL_2);
        if over {
            self.0.dier().modify(|r, w| raw!(w, r.bits() & !CHANNEL_2));
        }
        over
    }

    #[inline(always)]
    fn take(&mut self, channel: u32) -> bool {
        let due = self.0.sr().read().bits() & self.0.dier().read().bits() & channel != 0;
        if due {
            // Flags are cleared by writing 0; a 1 leaves them alone.
            self.0.sr().write(|w| raw!(w, !channel));
        }
        due
    }
}

/// Starts TIM5 as the clock: 1 MHz, free-running.
pub fn start_clock(timer: pac::TIM5, rcc: &mut Rcc) {
    pac::TIM5::enable(rcc);
    pac::TIM5::reset(rcc);
    let prescaler = pac::TIM5::timer_clock(&rcc.clocks).raw() / 1_000_000 - 1;
    timer.psc().write(|w| w.psc().set(prescaler as u16));
    timer.arr().write(|w| raw!(w, u32::MAX));
    // The prescaler is taken over by an update.
    timer.egr().write(|w| w.ug().set_bit());
    timer.cr1().write(|w| w.cen().set_bit());
}

/// Microseconds, wrapping.
#[inline(always)]
pub fn clock_ticks() -> u32 {
    // SAFETY: unsafe because the register is read without owning the timer; safe because reading CNT has no effect.
    unsafe { (*pac::TIM5::ptr()).cnt().read().bits() }
}

/// Baud rate of the link: what Grbl's senders expect.
pub const BAUD: u32 = 115_200;

/// A USART, both ways by interrupt.
pub struct Usart<U: Instance> {
    rx: Rx<U>,
    tx: Tx<U>,
    taken: Taken,
    /// The USART has lost a byte while older ones were taken; still to be told.
    lost: bool,
}

impl<U: Instance> Usart<U> {
    /// Begins to listen.
    pub fn new(tx: Tx<U>, mut rx: Rx<U>) -> Self {
        rx.listen();
        Usart { rx, tx, taken: Taken::default(), lost: false }
    }

    /// The next byte, if one has come.
    #[inline]
    pub fn receive(&mut self) -> Incoming {
        if let Some(byte) = self.taken.next() {
            // Taking them all lasts longer than a byte on the line: what comes meanwhile queues up behind them.
            if self.taken.has_room() {
                match self.rx.read() {
                    Ok(newer) => self.taken.append(newer),
                    Err(nb::Error::WouldBlock) => {}
                    Err(nb::Error::Other(_)) => self.lost = true,
                }
            }
            return Incoming::Byte(byte);
        }
        if core::mem::take(&mut self.lost) {
            return Incoming::Lost;
        }
        match self.rx.read() {
            Ok(byte) => Incoming::Byte(byte),
            Err(nb::Error::WouldBlock) => Incoming::Nothing,
            // Overrun, noise, framing: a byte is lost either way.
            Err(nb::Error::Other(_)) => Incoming::Lost,
        }
    }

    /// For links with back-pressure; here every byte is fetched at once.
    #[inline]
    pub fn quiet(&mut self) {}

    /// Sends a byte if the data register is free.
    #[inline]
    pub fn send(&mut self, byte: u8) -> bool {
        self.tx.write(byte).is_ok()
    }

    /// Whether to be called when the data register becomes free.
    #[inline]
    pub fn call_when_free(&mut self, wanted: bool) {
        if wanted { self.tx.listen() } else { self.tx.unlisten() }
    }
}

/// Inputs with pull-ups. At most 13, in the order of `input_bits`.
pub struct InputPins {
    places: [(Place, u32); 8],
    _pins: [ErasedPin<Input>; 8],
}

impl InputPins {
    /// The pins in this order: limit X, Y, Z, probe, door, hold, start, reset.
    pub fn new(pins: [ErasedPin<Input>; 8]) -> Self {
        use super::input_bits::{DOOR, HOLD, LIMITS, PROBE, RESET, START};
        let bits = [LIMITS, LIMITS + 1, LIMITS + 2, PROBE, DOOR, HOLD, START, RESET];
        let mut places = pins.each_ref().map(|pin| (Place::from(pin), 0));
        for (place, bit) in places.iter_mut().zip(bits) {
            place.1 = bit;
        }
        InputPins { places, _pins: pins }
    }

    fn probe(&self) -> Place {
        let [_, _, _, (probe, _), ..] = self.places;
        probe
    }

    /// Which pins are low, as `input_bits`.
    #[inline]
    pub fn read(&self) -> u16 {
        let ports = [read_idr(0), read_idr(1), read_idr(2)];
        let mut word = 0;
        for (place, bit) in &self.places {
            let level = ports.get(place.port).copied().unwrap_or(u32::MAX) >> place.pin & 1;
            word |= (level ^ 1) << bit;
        }
        word as u16
    }
}

/// Outputs that change slowly.
pub struct SlowPins {
    places: [Place; 5],
    _pins: [ErasedPin<Output>; 5],
}

impl SlowPins {
    /// The pins in this order: driver enable, spindle on, spindle reversed, flood, mist.
    pub fn new(pins: [ErasedPin<Output>; 5]) -> Self {
        let places = pins.each_ref().map(Place::from);
        for place in places.iter().skip(1) {
            note_safe_level(place.port, place.pin, false);
        }
        SlowPins { places, _pins: pins }
    }

    /// Writes all levels.
    pub fn write(&mut self, levels: SlowLevels) {
        let levels = [levels.drivers, levels.spindle, levels.spindle_reversed, levels.flood, levels.mist];
        for (place, high) in self.places.iter().zip(levels) {
            write_bsrr(place.port, bsrr(place.pin, high));
        }
    }
}

/// What `setup` deals out.
pub struct Parts<U: Instance> {
    /// For `step`.
    pub step_timer: StepTimer,
    /// For `step`.
    pub step_pins: StepPins,
    /// For `serial`.
    pub serial: Usart<U>,
    /// For `inputs`.
    pub inputs: InputPins,
    /// For `control`.
    pub slow_pins: SlowPins,
    /// For `control`.
    pub settings_flash: SettingsFlash,
}

/// The settings sectors, with a shelter for what the USART receives meanwhile.
pub fn settings_flash<U: Sheltered>(flash: pac::FLASH, rcc: &mut Rcc) -> SettingsFlash {
    U::switch_on(rcc);
    SettingsFlash::new(flash, shelter::<U>)
}

/// Nobody puts a job into the RAM of a board.
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

/// The firmware has failed: logs why and stays where it is.
pub fn halt(why: core::fmt::Arguments<'_>) -> ! {
    defmt::error!("{}", defmt::Display2Format(&why));
    loop {
        cortex_m::asm::wfi();
    }
}
