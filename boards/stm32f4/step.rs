//! `StepPins<M, P, O>`, the step and direction outputs of an STM32F4, and the spindle's PWM: tables with the port words
//! of each combination of steps and directions, with the polarities that are set. When the words come out is left to
//! `chain.rs`; setting clocks, pins and timers up to `chip.rs`.

use super::chain::Chain;
pub use super::chain::Rings;
use super::registers::{Map, read_idr, timer::*, write, write_bsrr};
use crate::AXES;
use crate::contract::{COMBINATIONS, Due, Free, SecondMotor, StepOutput, Undone};
use core::marker::PhantomData;
use core::sync::atomic::{AtomicU32, Ordering};

/// Ports A, B and C: all that these boards bring out.
pub const PORTS: usize = 3;

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

/// Place of a pin that exists: ports are reached by their number.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Place {
    /// 0 for port A.
    pub(super) port: usize,
    /// 0 to 15.
    pub(super) pin: u32,
}

impl Place {
    /// Port 0 to 2, for A to C, and pin 0 to 15. Panics with any other.
    pub const fn new(port: usize, pin: u32) -> Place {
        assert!(port < PORTS && pin < 16, "there is no such pin");
        Place { port, pin }
    }
}

/// BSRR word that gives a pin a level.
pub const fn bsrr(pin: u32, high: bool) -> u32 {
    if high { 1 << pin } else { 0x1_0000 << pin }
}

/// Words for each combination of a bit for each axis, for each port.
type Words<const P: usize> = [[u32; COMBINATIONS]; P];
/// All of the bits.
const ALL: u8 = (COMBINATIONS - 1) as u8;
/// The bit of A, whose motor is the fourth; on a board with three axes there is none.
const FOURTH_AXIS: u8 = ALL & 8;

/// Fills a table: which bits of a combination drive each pin, and a bit for each that is active low. `both` = a pin that is
/// not driven gets the opposite level; otherwise it is left alone.
fn fill<const P: usize>(ports: [usize; P], places: [Place; 4], driven: [u8; 4], invert: u8, both: bool) -> Words<P> {
    let mut tables = [[0; COMBINATIONS]; P];
    for (i, (place, driven)) in places.into_iter().zip(driven).enumerate() {
        let active_low = invert >> i & 1 != 0;
        let set = bsrr(place.pin, !active_low);
        let unset = if both { bsrr(place.pin, active_low) } else { 0 };
        for (_, words) in ports.iter().zip(&mut tables).filter(|(port, _)| **port == place.port) {
            for (bits, word) in words.iter_mut().enumerate() {
                *word |= if bits as u8 & driven != 0 { set } else { unset };
            }
        }
    }
    tables
}

/// The ports that pins lie on.
fn ports_of<const P: usize>(places: impl Iterator<Item = Place> + Clone) -> [usize; P] {
    let mut ports = [places.clone().next().map_or(0, |place| place.port); P];
    let mut used = 1;
    for place in places {
        if !ports[..used].contains(&place.port) {
            // A board that says how many ports its pins are on and is wrong does not start.
            ports[used] = place.port;
            used += 1;
        }
    }
    ports
}

/// Clocks that the outputs count with.
#[derive(Clone, Copy, Debug)]
pub struct Clocks {
    /// Of TIM1, MHz.
    pub pulse_mhz: u32,
    /// Of the PWM, Hz.
    pub pwm_hz: u32,
}

/// Step and direction outputs, all of them on `P` ports, and the spindle's PWM (channel 2 of TIM3).
pub struct StepPins<M, const P: usize, O> {
    chain: Chain<M, P>,
    ports: [usize; P],
    step: [Place; 4],
    direction: [Place; 4],
    steps: Words<P>,
    directions: Words<P>,
    /// Of the directions that hold: words for each combination of steps.
    both: Words<P>,
    /// What an event holds until it is committed: its word, or on several ports its steps.
    table: [u32; COMBINATIONS],
    clocks: Clocks,
    pwm_period: u32,
    /// Of the touch probe; the pin itself belongs to the inputs.
    probe: Place,
    /// Whatever must not be used by anybody else.
    _owned: O,
    map: PhantomData<M>,
}

impl<M: Map, const P: usize, O> StepPins<M, P, O> {
    /// The pins X, Y, Z and those of a second motor are outputs already, the timers run, and TIM1 and both DMA controllers have
    /// their clocks.
    pub fn at(
        step: [Place; 4],
        direction: [Place; 4],
        probe: Place,
        clocks: Clocks,
        rings: &'static mut Rings<P>,
        owned: O,
    ) -> Self {
        let ports = ports_of(step.into_iter().chain(direction));
        let none = [[0; COMBINATIONS]; P];
        let mut pins = StepPins {
            chain: Chain::new(ports, rings),
            ports,
            step,
            direction,
            steps: none,
            directions: none,
            both: none,
            table: core::array::from_fn(|steps| steps as u32),
            clocks,
            pwm_period: 1,
            probe,
            _owned: owned,
            map: PhantomData,
        };
        write(M::TIM5 + DIER, super::chain::CALLS);
        pins.set_polarity(0, 0, SecondMotor::default());
        pins.set_pulse(100);
        pins.set_pwm(DEFAULT_PWM_HZ, 0);
        pins
    }

    /// The compare value of the PWM.
    fn compare(&self, power: u16) -> u32 {
        // 65535 becomes 65536/65536: fully on.
        let share = u32::from(power) + u32::from(power >> 15);
        (share * self.pwm_period) >> 16
    }

    fn write_ports(&self, words: [u32; P]) {
        for (port, word) in self.ports.into_iter().zip(words) {
            write_bsrr::<M>(port, word);
        }
    }
}

impl<M: Map, const P: usize, O> StepOutput<AXES> for StepPins<M, P, O> {
    const DEPTH: usize = super::chain::DEPTH;
    // A call takes less: much of the processor stays for other tasks, whatever the rate.
    const SOON: u32 = 800;

    #[inline(always)]
    fn now(&self) -> u32 {
        super::registers::read(M::TIM5 + CNT)
    }

    #[inline(always)]
    fn take(&mut self) -> Due {
        self.chain.take()
    }

    #[inline(always)]
    fn call_at(&mut self, moment: u32) {
        self.chain.call_at(moment);
    }

    #[inline(never)]
    fn mark_at(&mut self, moment: u32, power: Option<u16>) {
        self.chain.mark_at(moment, power.map(|power| self.compare(power)));
    }

    fn direct(&mut self, directions: u8) {
        let tables = self.both.iter_mut().zip(&self.steps).zip(&self.directions);
        for ((both, steps), directed) in tables {
            let directed = directed.get(usize::from(directions & ALL)).copied().unwrap_or(0);
            for (word, step) in both.iter_mut().zip(steps) {
                *word = step | directed;
            }
        }
        if let ([words], true) = (self.both.as_slice(), P == 1) {
            self.table = *words;
        }
    }

    #[inline(always)]
    fn free(&mut self) -> Free<'_> {
        self.chain.free(&self.table)
    }

    #[inline(always)]
    fn commit(&mut self, events: usize) -> u32 {
        if P > 1 {
            self.chain.translate(&self.both, events);
        }
        self.chain.commit(events)
    }

    #[inline(always)]
    fn pass(&mut self, _ticks: u32) {}

    #[inline(always)]
    fn ahead(&self) -> usize {
        self.chain.ahead()
    }

    #[inline(always)]
    fn moment_before(&self, left: usize) -> u32 {
        self.chain.moment_before(left)
    }

    #[inline(always)]
    fn joins_until(&self, next: u32) -> u32 {
        self.chain.joins_until(next)
    }

    #[inline(never)]
    fn begin(&mut self, one_by_one: bool) -> u32 {
        self.chain.begin(one_by_one)
    }

    #[inline(always)]
    fn fault(&self) -> bool {
        self.chain.fault()
    }

    #[inline(never)]
    fn halt(&mut self, dark: bool) -> Undone<AXES> {
        // First of all: what is computed from here on delays nothing.
        let (tail, fault) = self.chain.silence(dark);
        let mut net = [0; AXES];
        // The word of an axis alone has the bits of its pins, and of its directions one bit that no other one has.
        let of = |table: &[u32; COMBINATIONS], axis: usize| table.get(1 << axis).copied().unwrap_or(0);
        let mut masks = [[(0, 0); P]; AXES];
        for (axis, masks) in masks.iter_mut().enumerate() {
            for ((mask, steps), directions) in masks.iter_mut().zip(&self.steps).zip(&self.directions) {
                *mask = (of(steps, axis), of(directions, axis) & !directions[0]);
            }
        }
        let events = self.chain.undone(tail, |words| {
            for (net, masks) in net.iter_mut().zip(&masks) {
                let (mut stepped, mut negative) = (0, 0);
                for (word, (step, direction)) in words.iter().zip(masks) {
                    stepped |= word & step;
                    negative |= word & direction;
                }
                *net += i32::from(stepped != 0) * (1 - 2 * i32::from(negative != 0));
            }
        });
        Undone { events, net, fault }
    }

    fn set_polarity(&mut self, step_invert: u8, direction_invert: u8, second: SecondMotor) {
        // The fourth pin is driven as that of its axis is: as the second of another axis, or else as A.
        let axis = if second.axis == 0 { FOURTH_AXIS } else { second.axis };
        let fourth = |mask: u8, turn: bool| mask & 7 | u8::from((mask & axis != 0) != turn) << 3;
        let step_invert = fourth(step_invert, false);
        let direction_invert = fourth(direction_invert, second.inverted);
        let own = |stands: bool| [1, 2, 4].map(|axis| if stands && axis == second.axis { 0 } else { axis });
        let ([x, y, z], motor) = (own(second.first_stands), if second.stands { 0 } else { axis });
        self.steps = fill(self.ports, self.step, [x, y, z, motor], step_invert, false);
        self.directions = fill(self.ports, self.direction, [1, 2, 4, axis], direction_invert, true);
        let off = fill(self.ports, self.step, [ALL; 4], !step_invert, false).map(|words| words[COMBINATIONS - 1]);
        for (i, place) in self.step.iter().enumerate() {
            note_safe_level(*place, step_invert >> i & 1 != 0);
        }
        self.chain.set_off(off);
        self.write_ports(off);
        self.direct(0);
        self.write_ports(self.directions.map(|words| words[0]));
    }

    /// The length of the step pulse in ticks of the timer that makes it.
    fn set_pulse(&mut self, tenths: u16) {
        // What is no whole number of ticks is rounded up: a driver is never given less than it asks for.
        self.chain.set_pulse((u32::from(tenths) * self.clocks.pulse_mhz).div_ceil(10));
    }

    fn set_pwm(&mut self, hz: u32, power: u16) {
        let counts = self.clocks.pwm_hz / hz.max(1);
        // The timer has 16 bits; a period of 65536 would be one too many for `set_power`.
        let prescaler = (counts >> 16).min(0xFFFF);
        self.pwm_period = (counts / (prescaler + 1)).clamp(2, 0xFFFF);
        write(M::TIM3 + PSC, prescaler);
        write(M::TIM3 + ARR, self.pwm_period - 1);
        // At rest DMA has none to write.
        write(M::TIM3 + CCR2, self.compare(power));
        // Restarts the counter: the prescaler is taken over, and the counter cannot be beyond its end.
        write(M::TIM3 + EGR, 1);
    }

    #[inline(never)]
    fn set_power(&mut self, power: u16) {
        self.chain.keep_power();
        write(M::TIM3 + CCR2, self.compare(power));
    }

    #[inline(always)]
    fn probe_low(&self) -> bool {
        read_idr::<M>(self.probe.port) >> self.probe.pin & 1 == 0
    }
}
