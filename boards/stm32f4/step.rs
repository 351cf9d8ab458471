//! Step and direction outputs of an STM32F4, and the spindle's PWM: `StepPins`. Its tables hold the words that the
//! ports need for each combination of steps and for each combination of directions, at the present polarities.
//! `chain.rs` decides when the words are output; `chip.rs` sets up clocks, pins and timers.

use super::chain::Chain;
pub use super::chain::Rings;
use super::registers::{Map, read_idr, timer::*, write, write_bsrr};
use crate::AXES;
use crate::contract::{COMBINATIONS, Due, Free, SecondMotor, StepOutput, Undone};
use core::marker::PhantomData;
use core::sync::atomic::{AtomicU32, Ordering};

/// Number of ports that have pins in use, from A on.
pub const PORTS: usize = crate::PORTS;

/// PWM frequency of spindle and laser before the settings are loaded: the default of `$33`.
const DEFAULT_PWM_HZ: u32 = 5_000;

/// For each port, the BSRR word that makes all of its outputs safe, so that nothing moves, turns, burns or flows. The
/// words are in a static, not in the resource of a task, because a panic may occur in any task.
pub static SAFE: [AtomicU32; PORTS] = [const { AtomicU32::new(0) }; PORTS];

/// Records the level to which `safe_state` sets a pin.
pub fn note_safe_level(place: Place, high: bool) {
    if let Some(safe) = SAFE.get(place.port()) {
        let both = 0x1_0001 << place.pin();
        // Set-up and the step task are the only writers and never run at the same time.
        safe.store(safe.load(Ordering::Relaxed) & !both | bsrr(place.pin(), high), Ordering::Relaxed);
    }
}

/// A pin that exists: its port and its number in that port.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Place {
    /// 0 for port A.
    port: u8,
    /// 0 to 15.
    pin: u8,
}

impl Place {
    /// Creates a place. `port`: 0 for A, below [`PORTS`]. `pin`: 0 to 15. Panics if there is no such pin.
    pub const fn new(port: usize, pin: u32) -> Place {
        assert!(port < PORTS && pin < 16, "there is no such pin");
        Place { port: port as u8, pin: pin as u8 }
    }

    #[inline(always)]
    pub(super) fn port(self) -> usize {
        usize::from(self.port)
    }

    #[inline(always)]
    pub(super) fn pin(self) -> u32 {
        u32::from(self.pin)
    }
}

/// Returns the BSRR word that sets a pin to a level.
pub const fn bsrr(pin: u32, high: bool) -> u32 {
    if high { 1 << pin } else { 0x1_0000 << pin }
}

/// For each port, a table of BSRR words. Its index is a combination of axes (one bit per axis, bit 0 for X).
type Words<const P: usize> = [[u32; COMBINATIONS]; P];
/// The combination of all axes.
const ALL: u8 = (COMBINATIONS - 1) as u8;
/// The bit of axis A, whose motor is the fourth; 0 on a board with three axes.
const FOURTH_AXIS: u8 = ALL & 8;

/// Computes for each port the BSRR words of all combinations of axes. `places`: a pin for each motor, if there is one.
/// `driven`: for each pin, the axes that make it active. `invert`: a bit for each pin that is active low. `both`: what
/// to do with a pin if none of its axes is in the combination. `true`: the word makes the pin inactive. `false`: the
/// word leaves the pin unchanged.
fn fill<const P: usize>(
    ports: [usize; P],
    places: [Option<Place>; 4],
    driven: [u8; 4],
    invert: u8,
    both: bool,
) -> Words<P> {
    let mut tables = [[0; COMBINATIONS]; P];
    for (i, (place, driven)) in places.into_iter().zip(driven).enumerate() {
        let Some(place) = place else { continue };
        let active_low = invert >> i & 1 != 0;
        let set = bsrr(place.pin(), !active_low);
        let unset = if both { bsrr(place.pin(), active_low) } else { 0 };
        // Fill only the table of the first port that matches. If there are fewer ports than `P`, the spare entries of
        // `ports` repeat the first port, and their words must stay 0.
        if let Some((_, words)) = ports.iter().zip(&mut tables).find(|(port, _)| **port == place.port()) {
            for (bits, word) in words.iter_mut().enumerate() {
                *word |= if bits as u8 & driven != 0 { set } else { unset };
            }
        }
    }
    tables
}

/// Returns the ports of some pins, in the order of the pins. Panics if there are more than `P`.
fn ports_of<const P: usize>(places: impl Iterator<Item = Place> + Clone) -> [usize; P] {
    let mut ports = [places.clone().next().map_or(0, Place::port); P];
    let mut used = 1;
    for place in places {
        if !ports[..used].contains(&place.port()) {
            // The index is valid: a pin table with more ports does not fit this image, so it is not used
            // (`pin_table`).
            ports[used] = place.port();
            used += 1;
        }
    }
    ports
}

/// The timer channel that makes the PWM of the spindle or laser.
#[derive(Clone, Copy, Debug)]
pub struct Pwm {
    /// Address of the timer's registers.
    pub(super) timer: usize,
    /// Address of the channel's compare register.
    pub(super) compare: usize,
    /// `true` if DMA1 can write the registers of this timer. It can for TIM3, but not for TIM1.
    pub(super) is_in_reach: bool,
}

impl Pwm {
    /// Returns the PWM of TIM3. `channel`: 0 to 3 for channels 1 to 4.
    pub const fn of_tim3<M: Map>(channel: usize) -> Pwm {
        Pwm { timer: M::TIM3, compare: M::TIM3 + CCR1 + (CCR2 - CCR1) * channel, is_in_reach: true }
    }

    /// Returns the PWM of TIM1. `channel`: 0 to 3 for channels 1 to 4.
    pub const fn of_tim1<M: Map>(channel: usize) -> Pwm {
        Pwm { timer: M::TIM1, compare: M::TIM1 + CCR1 + (CCR2 - CCR1) * channel, is_in_reach: false }
    }
}

/// Clocks of the output timers.
#[derive(Clone, Copy, Debug)]
pub struct Clocks {
    /// Clock of the pulses' timer, MHz.
    pub pulse_mhz: u32,
    /// Clock of the PWM's timer, Hz.
    pub pwm_hz: u32,
}

/// Step and direction outputs on `P` ports, of which the first `S` have step pins, and the spindle's PWM.
pub struct StepPins<M, const S: usize, const P: usize, O> {
    chain: Chain<M, S, P>,
    ports: [usize; P],
    step: [Option<Place>; 4],
    direction: [Option<Place>; 4],
    /// BSRR words of each combination of axes that step. They do not change the direction pins.
    steps: Words<P>,
    /// BSRR words of each combination of axes whose direction is negative.
    directions: Words<P>,
    /// The words of `steps`, each combined with the word for the present directions.
    both: Words<P>,
    /// What the slot of an event holds until the event is committed. The index is the combination of steps. With one
    /// port, the slot holds the port's word. With several ports, it holds the combination itself.
    table: [u32; COMBINATIONS],
    clocks: Clocks,
    pwm: Pwm,
    pwm_period: u32,
    /// The touch probe's pin, if there is one. The pin itself belongs to the inputs.
    probe: Option<Place>,
    /// Peripherals and pins that no other code may use.
    _owned: O,
    map: PhantomData<M>,
}

impl<M: Map, const S: usize, const P: usize, O> StepPins<M, S, P, O> {
    /// Creates the outputs. The step and direction pins must be outputs already, the timers must run, and the pulse
    /// timers and both DMA controllers must have their clocks.
    pub fn at(
        step: [Option<Place>; 4],
        direction: [Option<Place>; 4],
        probe: Option<Place>,
        pwm: Pwm,
        clocks: Clocks,
        rings: &'static mut Rings<P>,
        owned: O,
    ) -> Self {
        let ports = ports_of(step.into_iter().chain(direction).flatten());
        let none = [[0; COMBINATIONS]; P];
        let mut pins = StepPins {
            chain: Chain::new(ports, pwm, rings),
            ports,
            step,
            direction,
            steps: none,
            directions: none,
            both: none,
            table: core::array::from_fn(|steps| steps as u32),
            clocks,
            pwm,
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

    /// Returns the PWM's compare value for a power.
    fn compare(&self, power: u16) -> u32 {
        // Full power, 65535, becomes 65536/65536: always on.
        let share = u32::from(power) + u32::from(power >> 15);
        (share * self.pwm_period) >> 16
    }

    fn write_ports(&self, words: [u32; P]) {
        for (port, word) in self.ports.into_iter().zip(words) {
            write_bsrr::<M>(port, word);
        }
    }
}

impl<M: Map, const S: usize, const P: usize, O> StepOutput<AXES> for StepPins<M, S, P, O> {
    const DEPTH: usize = super::chain::DEPTH;
    // In ticks. This is longer than the interrupt takes, so other tasks get much of the CPU time at any step rate.
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
        // Stop the output first, so that the computations below do not delay the stop.
        let (tail, fault) = self.chain.silence(dark);
        let mut net = [0; AXES];
        // For each axis and port, find two masks of bits of the port's word. The first mask shows a step of the axis.
        // It has all bits of the word in which only this axis steps. The second mask shows the negative direction. It
        // has the bits of the word in which only this axis is negative, without the bits of the word in which no axis
        // is negative.
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
        // The pins of the fourth motor get the polarities of the axis that has a second motor. If no axis has one, the
        // pins get the polarities of A.
        let axis = if second.axis == 0 { FOURTH_AXIS } else { second.axis };
        let fourth = |mask: u8, turn: bool| mask & 7 | u8::from((mask & axis != 0) != turn) << 3;
        let step_invert = fourth(step_invert, false);
        let direction_invert = fourth(direction_invert, second.inverted);
        let own = |no_steps: bool| [1, 2, 4].map(|axis| if no_steps && axis == second.axis { 0 } else { axis });
        let ([x, y, z], motor) = (own(second.first_gets_no_steps), if second.gets_no_steps { 0 } else { axis });
        self.steps = fill(self.ports, self.step, [x, y, z, motor], step_invert, false);
        self.directions = fill(self.ports, self.direction, [1, 2, 4, axis], direction_invert, true);
        let off = fill(self.ports, self.step, [ALL; 4], !step_invert, false).map(|words| words[COMBINATIONS - 1]);
        for (i, place) in self.step.iter().enumerate() {
            if let Some(place) = place {
                note_safe_level(*place, step_invert >> i & 1 != 0);
            }
        }
        self.chain.set_off(off);
        self.write_ports(off);
        self.direct(0);
        self.write_ports(self.directions.map(|words| words[0]));
    }

    /// Converts the length to ticks of the pulses' timer.
    fn set_pulse(&mut self, tenths: u16) {
        // Round up to a whole number of ticks: a pulse must never be shorter than the driver requires.
        self.chain.set_pulse((u32::from(tenths) * self.clocks.pulse_mhz).div_ceil(10));
    }

    fn set_pwm(&mut self, hz: u32, power: u16) {
        let counts = self.clocks.pwm_hz / hz.max(1);
        // The timer has 16 bits. The period is at most 65535 counts, because full power needs a compare value of one
        // whole period.
        let prescaler = (counts >> 16).min(0xFFFF);
        self.pwm_period = (counts / (prescaler + 1)).clamp(2, 0xFFFF);
        write(self.pwm.timer + PSC, prescaler);
        write(self.pwm.timer + ARR, self.pwm_period - 1);
        // DMA does not overwrite this value: it writes no power while the machine is at rest.
        write(self.pwm.compare, self.compare(power));
        // Restarts the counter. This loads the prescaler, and the counter cannot be beyond the end of the new period.
        write(self.pwm.timer + EGR, 1);
    }

    #[inline(never)]
    fn set_power(&mut self, power: u16) {
        self.chain.drop_power();
        write(self.pwm.compare, self.compare(power));
    }

    #[inline(always)]
    fn probe_low(&self) -> bool {
        self.probe.is_some_and(|probe| read_idr::<M>(probe.port()) >> probe.pin() & 1 == 0)
    }
}
