//! What the step interrupt touches on an STM32F4: the step timer, the ports of step and direction pins, the spindle's PWM.
//! Registers written as addresses, because there each instruction counts.
//!
//! Every type takes the addresses of its peripherals as constants, so that the benchmark can run this very code on
//! memory. Setting clocks, pins and timers up is left to `chip.rs`. Addresses and bits: reference manual RM0383,
//! the same in RM0390 for the F446.

use crate::SecondMotor;
use core::sync::atomic::{AtomicU32, Ordering};

/// The bus region with the ports, `TIM2` and `TIM3` of the STM32F4.
pub const GPIO: usize = 0x4002_0000;
/// Step timer.
pub const TIM2: usize = 0x4000_0000;
/// PWM of the spindle.
pub const TIM3: usize = 0x4000_0400;

/// Ports A, B and C: all that these boards bring out.
pub const PORTS: usize = 3;

/// Registers of a port, and the distance of two ports.
const IDR: usize = 0x10;
const BSRR: usize = 0x18;
const PORT_SIZE: usize = 0x400;

/// Registers of a timer.
const DIER: usize = 0x0C;
const SR: usize = 0x10;
const EGR: usize = 0x14;
const CNT: usize = 0x24;
const PSC: usize = 0x28;
const ARR: usize = 0x2C;
const CCR1: usize = 0x34;
const CCR2: usize = 0x38;
const CCR3: usize = 0x3C;

#[inline(always)]
fn write(address: usize, value: u32) {
    // SAFETY: unsafe because a raw address is written; safe because this file alone makes addresses, of registers of ports
    // and timers that reach no memory, whose clocks are on since `setup`, and that have one owner each (BSRR changes the
    // pins it names and no others, EGR is a request that whoever may make).
    unsafe { (address as *mut u32).write_volatile(value) }
}

#[inline(always)]
fn read(address: usize) -> u32 {
    // SAFETY: unsafe because a raw address is read; safe because this file alone makes addresses, of registers that may be
    // read at any time without effect.
    unsafe { (address as *const u32).read_volatile() }
}

/// Sets and resets pins of a port at one moment: low half sets, high half resets.
#[inline(always)]
pub fn write_bsrr(port: usize, value: u32) {
    write(GPIO + PORT_SIZE * port + BSRR, value);
}

/// Levels of the pins of a port.
#[inline(always)]
pub fn read_idr(port: usize) -> u32 {
    read(GPIO + PORT_SIZE * port + IDR)
}

/// PWM of spindle and laser before the settings are known: `$33` of a new controller.
const DEFAULT_PWM_HZ: u32 = 5_000;

/// What to write to each port so that nothing moves, turns, burns or flows. Kept here and not with a task, because a
/// panic may come in any of them.
pub static SAFE: [AtomicU32; PORTS] = [const { AtomicU32::new(0) }; PORTS];

/// Notes the level that makes a pin safe.
pub fn note_safe_level(place: Place, high: bool) {
    if let Some(safe) = SAFE.get(place.port) {
        let both = 0x1_0001 << place.pin;
        // Set-up and the step task are the only writers and never run at the same time.
        safe.store(safe.load(Ordering::Relaxed) & !both | bsrr(place.pin, high), Ordering::Relaxed);
    }
}

/// Place of a pin.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Place {
    /// 0 for port A.
    pub port: usize,
    /// 0 to 15.
    pub pin: u32,
}

/// BSRR word that gives a pin a level.
pub const fn bsrr(pin: u32, high: bool) -> u32 {
    if high { 1 << pin } else { 0x1_0000 << pin }
}

/// Pins of four motors on `P` ports, written by table: one store for each port.
struct Lines<const P: usize> {
    places: [Place; 4],
    /// Ports, and the addresses of their BSRR.
    ports: [usize; P],
    registers: [usize; P],
    /// BSRR words for each combination of bits, for each port.
    words: [[u32; 8]; P],
}

impl<const P: usize> Lines<P> {
    fn new(gpio: usize, places: [Place; 4]) -> Self {
        let mut ports = [places[0].port; P];
        let mut used = 1;
        for place in places {
            if !ports[..used].contains(&place.port) {
                // A board that says how many ports its pins are on and is wrong does not start.
                ports[used] = place.port;
                used += 1;
            }
        }
        Lines { places, ports, registers: ports.map(|port| gpio + PORT_SIZE * port + BSRR), words: [[0; 8]; P] }
    }

    /// Fills the tables: which bits of a combination drive each pin, and a bit for each that is active low. `both` = a pin
    /// that is not driven gets the opposite level; otherwise it is left alone.
    fn fill(&mut self, driven: [u8; 4], invert: u8, both: bool) {
        for (port, words) in self.ports.into_iter().zip(&mut self.words) {
            for (bits, word) in words.iter_mut().enumerate() {
                *word = 0;
                let pins = self.places.iter().zip(driven).enumerate();
                for (i, (place, driven)) in pins.filter(|(_, (place, _))| place.port == port) {
                    let set = bits as u8 & driven != 0;
                    if set || both {
                        *word |= bsrr(place.pin, set != (invert >> i & 1 != 0));
                    }
                }
            }
        }
    }

    #[inline(always)]
    fn write(&self, bits: u8) {
        for (register, words) in self.registers.into_iter().zip(&self.words) {
            write(register, words[usize::from(bits & 7)]);
        }
    }
}

/// Step and direction outputs and the spindle's PWM (channel 2 of the timer at `PWM`). Step pins lie on `S` ports,
/// direction pins on `D`.
pub struct StepPins<const GPIO: usize, const PWM: usize, const S: usize, const D: usize, O> {
    raise: Lines<S>,
    lower: Lines<S>,
    direction: Lines<D>,
    pwm_clock_hz: u32,
    pwm_period: u32,
    /// Of the touch probe; the pin itself belongs to the inputs.
    probe: Place,
    /// Whatever must not be used by anybody else.
    _owned: O,
}

impl<const GPIO: usize, const PWM: usize, const S: usize, const D: usize, O> StepPins<GPIO, PWM, S, D, O> {
    /// The pins X, Y, Z and those of a second motor are outputs already, and the timer of the PWM counts at `pwm_clock_hz`.
    pub fn at(step: [Place; 4], direction: [Place; 4], probe: Place, pwm_clock_hz: u32, owned: O) -> Self {
        let (raise, lower, direction) = (Lines::new(GPIO, step), Lines::new(GPIO, step), Lines::new(GPIO, direction));
        let mut pins = StepPins { raise, lower, direction, pwm_clock_hz, pwm_period: 1, probe, _owned: owned };
        pins.set_polarity(0, 0, SecondMotor::default());
        pins.set_pwm(DEFAULT_PWM_HZ, 0);
        pins
    }

    /// Takes over which outputs are inverted and what the second motor does, and puts the step outputs to rest.
    pub fn set_polarity(&mut self, step_invert: u8, direction_invert: u8, second: SecondMotor) {
        // The fourth pin is driven as that of its axis is.
        let fourth = |mask: u8, turn: bool| mask & 7 | u8::from((mask & second.axis != 0) != turn) << 3;
        let step_invert = fourth(step_invert, false);
        let direction_invert = fourth(direction_invert, second.inverted);
        let own = |stands: bool| [1, 2, 4].map(|axis| if stands && axis == second.axis { 0 } else { axis });
        let ([x, y, z], motor) = (own(second.first_stands), if second.stands { 0 } else { second.axis });
        self.raise.fill([x, y, z, motor], step_invert, false);
        self.lower.fill([7; 4], !step_invert, false);
        self.direction.fill([1, 2, 4, second.axis], direction_invert, true);
        for (i, place) in self.raise.places.iter().enumerate() {
            note_safe_level(*place, step_invert >> i & 1 != 0);
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

    /// Sets the frequency of the PWM, 1 Hz and more, and the power that stays in force.
    pub fn set_pwm(&mut self, hz: u32, power: u16) {
        let counts = self.pwm_clock_hz / hz.max(1);
        // The timer has 16 bits; a period of 65536 would be one too many for `set_power`.
        let prescaler = (counts >> 16).min(0xFFFF);
        self.pwm_period = (counts / (prescaler + 1)).clamp(2, 0xFFFF);
        write(PWM + PSC, prescaler);
        write(PWM + ARR, self.pwm_period - 1);
        self.set_power(power);
        // Restarts the counter: the prescaler is taken over, and the counter cannot be beyond its end.
        write(PWM + EGR, 1);
    }

    /// Sets the power of spindle or laser, 0 to 65535.
    #[inline(always)]
    pub fn set_power(&mut self, power: u16) {
        // 65535 becomes 65536/65536: fully on.
        let share = u32::from(power) + u32::from(power >> 15);
        write(PWM + CCR2, (share * self.pwm_period) >> 16);
    }

    /// Whether the probe's pin is low, unfiltered.
    #[inline(always)]
    pub fn probe_low(&self) -> bool {
        read(GPIO + PORT_SIZE * self.probe.port + IDR) >> self.probe.pin & 1 == 0
    }

    /// Time passes in which nothing is written.
    #[inline(always)]
    pub fn pass(&mut self, _ticks: u32) {}
}

/// What the step task has been called for: flags of SR, whose places are those in DIER and EGR too.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Due(u32);

impl Due {
    /// The next tick: channel 1.
    pub const TICK: Due = Due(2);
    /// The end of a pulse: channel 2.
    pub const PULSE_END: Due = Due(4);
    /// Some time after the end of a pulse: channel 3.
    pub const SETTLED: Due = Due(8);
    /// Another task has called: channel 4, whose event is generated by software only.
    pub const CALLED: Due = Due(16);

    /// Whether `what` is among it.
    #[inline(always)]
    pub fn has(self, what: Due) -> bool {
        self.0 & what.0 != 0
    }
}

/// A 32-bit timer at `AT` as a free-running counter with three moments.
///
/// Flags that come from a moment long past (the counter comes round after 2^32 ticks) are harmless except for ticks,
/// which are switched off at rest.
pub struct StepTimer<const AT: usize, O>(O);

impl<const AT: usize, O> StepTimer<AT, O> {
    /// The timer runs already.
    pub fn at(owned: O) -> Self {
        let timer = StepTimer(owned);
        write(AT + DIER, Due::PULSE_END.0 | Due::SETTLED.0 | Due::CALLED.0);
        timer
    }

    /// The step clock.
    #[inline(always)]
    pub fn now(&self) -> u32 {
        read(AT + CNT)
    }

    /// What is due, once each.
    #[inline(always)]
    pub fn take(&mut self) -> Due {
        let due = read(AT + SR);
        // Flags are cleared by writing 0; a 1 leaves them alone.
        write(AT + SR, !due);
        Due(due)
    }

    /// Whether something is due that has not been taken.
    #[inline(always)]
    pub fn is_due(&self, what: Due) -> bool {
        Due(read(AT + SR)).has(what)
    }

    /// Calls the step task for a tick at a moment that lies ahead, after a tick has been taken.
    #[inline(always)]
    pub fn next_tick_at(&mut self, when: u32) {
        write(AT + CCR1, when);
    }

    /// The moment of the next tick.
    #[inline(always)]
    pub fn next_tick(&self) -> u32 {
        read(AT + CCR1)
    }

    /// Calls the step task for a tick at a moment, instead of another one that may already have come.
    pub fn tick_at(&mut self, when: u32) {
        write(AT + CCR1, when);
        write(AT + SR, !Due::TICK.0);
        write(AT + DIER, read(AT + DIER) | Due::TICK.0);
        if self.now().wrapping_sub(when) as i32 >= 0 {
            write(AT + EGR, Due::TICK.0);
        }
    }

    /// No more ticks.
    pub fn tick_off(&mut self) {
        write(AT + DIER, read(AT + DIER) & !Due::TICK.0);
        write(AT + SR, !Due::TICK.0);
    }

    /// Calls the step task at the end of a pulse, which lies ahead.
    #[inline(always)]
    pub fn pulse_end_at(&mut self, when: u32) {
        write(AT + CCR2, when);
    }

    /// The moment at which the last pulse ends or has ended.
    #[inline(always)]
    pub fn pulse_end(&self) -> u32 {
        read(AT + CCR2)
    }

    /// Calls the step task at a moment, independent of ticks; at once if it has passed.
    #[inline(always)]
    pub fn settled_at(&mut self, when: u32) {
        write(AT + CCR3, when);
        if self.now().wrapping_sub(when) as i32 >= 0 {
            write(AT + EGR, Due::SETTLED.0);
        }
    }

    /// Whether the moment that [`StepTimer::settled_at`] was last given is this one, and still lies ahead.
    #[inline(always)]
    pub fn settles_at(&self, when: u32, now: u32) -> bool {
        read(AT + CCR3) == when && when.wrapping_sub(now) as i32 > 0
    }

    /// Calls the step task, from any task: the call waits as a flag of the timer until it is taken.
    #[inline(always)]
    pub fn call() {
        write(AT + EGR, Due::CALLED.0);
    }

    /// Whether no tick is closer than `near`, nor the end of a pulse, so that a call now is not in their way.
    pub fn is_far(near: u32) -> bool {
        let now = read(AT + CNT);
        read(AT + DIER) & Due::TICK.0 == 0
            || (read(AT + CCR1).wrapping_sub(now) as i32 >= near as i32 && read(AT + CCR2).wrapping_sub(now) >= near)
    }
}
