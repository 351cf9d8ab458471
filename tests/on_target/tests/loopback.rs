//! Measures the step pulses at the pins. Three wires lead them to inputs of the same board, which records them
//! (docs/bench.md).
//!
//! The firmware's own board set-up and step task run here; the interrupt of the step timer calls the step task. The
//! edges return over the wires, and hardware alone time-stamps them (`oxmill_on_target::capture`). No other tasks
//! run, so the figures exclude delays that other tasks would cause.
//!
//! Each figure is a row of a table in the log. A figure beyond its bound fails the test.
#![no_std]
#![no_main]
#![allow(missing_docs, reason = "code that defmt-test generates")]

use core::mem::MaybeUninit;
use core::ops::RangeInclusive;
use core::sync::atomic::Ordering;
use cortex_m::singleton;
use oxmill_boards::{
    self as boards,
    pac::{self, interrupt},
};
use oxmill_controller::messages::{
    AxisSteps, EVENTS_DEPTH, GangedMotors, INTERVAL_FRACTION_BITS, InputWiring, SEGMENTS_DEPTH, Segment, StepEvent,
    ToStep, Wiring,
};
use oxmill_firmware::shared;
use oxmill_firmware::step_timer::Step;
use oxmill_on_target::capture::{Capture, Edges};
use rtic_sync::channel::{Channel, Receiver, Sender};
use rtic_sync::signal::Signal;

/// The callback that `setup` requires for a low supply voltage.
fn low_voltage() -> ! {
    defmt::panic!("the supply is below 2.9 V")
}

/// A wire: function of the output, name of the output's pin, name of the input's pin.
struct Wire(&'static str, &'static str, &'static str);

/// The wires in the order of the three lines that [`Capture`] records.
#[cfg(any(feature = "blackpill_f411", feature = "blackpill_f401"))]
const WIRES: [Wire; 3] = [Wire("STEP X", "A1", "B6"), Wire("DIR X", "A4", "B7"), Wire("STEP Y", "A2", "B8")];
#[cfg(not(any(feature = "blackpill_f411", feature = "blackpill_f401")))]
const WIRES: [Wire; 3] =
    [Wire("STEP X", "D2", "D10"), Wire("DIR X", "D5", "PB7 (CN7, pin 21)"), Wire("STEP Y", "D3", "D15")];
const STEP_X: usize = 0;
const DIR_X: usize = 1;
const STEP_Y: usize = 2;

const TICKS_PER_US: i32 = (boards::PROFILE.step_clock_hz / 1_000_000) as i32;

/// Maximum time by which a pulse can be longer than `$0`. A pulse can also be shorter than `$0`, by up to [`EDGE_NS`].
/// The reason is that DMA outputs the two edges and may have to wait for other transfers.
const LATEST_PULSE_END_US: i32 = 1;
/// Maximum delay of an edge, because its transfer may have to wait for other transfers, such as those of the recorder.
const EDGE_NS: i32 = 250;
/// Maximum error of the period between two pulses, because their edges can be delayed.
const PERIOD_ERROR_US: i32 = 1;
/// Maximum error of the time from the first pulse of a train (a series of evenly spaced pulses) to its last but one.
/// The bound is small, because errors must not accumulate.
const DRIFT_US: i32 = 1;
/// Maximum time between the pulses of one tick, because ports are written one after the other.
const SKEW_NS: i32 = 500;
/// Minimum set-up time of the direction, required by drivers even if `$29` is less.
const LEAST_SETUP_US: i32 = 2;

/// Number of ticks in a segment. Segments are short, so that the step task also receives messages between the pulses of
/// the fastest train.
const SEGMENT_TICKS: u32 = 50;
/// Pulses of the longest train. All segments of this train must fit into the queue before it starts, because no task
/// sends further segments later.
const LONGEST_TRAIN: u32 = 1_000;
const _: () = assert!(LONGEST_TRAIN / SEGMENT_TICKS + 2 < SEGMENTS_DEPTH as u32);

static mut STEP: MaybeUninit<Step> = MaybeUninit::uninit();

/// Calls the step task as RTIC does: saves the priority threshold before it and restores the threshold afterwards.
#[interrupt]
fn TIM5() {
    let before = cortex_m::register::basepri::read();
    // SAFETY: unsafe because a static is changed; safe because the task was stored there before its interrupt was
    // unmasked, no other code uses it, and the interrupt does not preempt itself.
    unsafe { (&raw mut STEP).cast::<Step>().as_mut_unchecked().run() };
    // SAFETY: unsafe because a critical section might end; safe because it restores the earlier value.
    unsafe { cortex_m::register::basepri::write(before) };
}

/// A straight piece of a move: axes that step (bit 0 for X), axes that move backwards, and the number of steps of each
/// stepping axis.
struct Piece {
    axes: u8,
    backwards: u8,
    steps: u32,
}

/// The queues to and from the step task, and the recorder of the edges.
struct Bench {
    segments: Sender<'static, ToStep, SEGMENTS_DEPTH>,
    wiring: Sender<'static, Wiring, 2>,
    events: Receiver<'static, StepEvent<{ boards::AXES }>, EVENTS_DEPTH>,
    capture: Capture,
    segments_sent: u32,
}

impl Bench {
    /// Sets `$0` and `$29` for the next moves.
    fn set(&mut self, pulse_us: u8, direction_setup_us: u8) {
        let wiring = Wiring {
            pulse_tenths: 10 * u16::from(pulse_us),
            direction_setup_us,
            step_invert: 0,
            direction_invert: 0,
            enable_invert: false,
            pwm_hz: 5_000,
            probe_invert: false,
            inputs: InputWiring::PULL_UPS,
            armed: 0,
            ganged: 0,
            ganged_invert: false,
            ganged_motors: GangedMotors::Both,
        };
        defmt::assert!(self.wiring.try_send(wiring).is_ok(), "the step task takes no settings");
    }

    fn send(&mut self, message: ToStep) {
        defmt::assert!(self.segments.try_send(message).is_ok(), "the queue to the step task is full");
    }

    /// Moves at a constant step rate, from rest to rest. `interval`: time between two steps, in fixed-point ticks.
    /// Returns the recorded edges.
    fn step(&mut self, interval: u32, pieces: &[Piece]) -> [Edges; 3] {
        self.capture.start();
        let mut ticks = 0;
        for (k, piece) in pieces.iter().enumerate() {
            let steps = core::array::from_fn(|axis| if piece.axes >> axis & 1 != 0 { piece.steps } else { 0 });
            self.send(ToStep::Block { steps_by_axis: steps.map(AxisSteps::on_steps), directions: piece.backwards });
            let mut left = piece.steps;
            while left > 0 {
                let now = left.min(SEGMENT_TICKS);
                let mut flags = if left == piece.steps { Segment::FLAG_NEW_BLOCK } else { 0 };
                left -= now;
                if left == 0 && k + 1 == pieces.len() {
                    flags |= Segment::FLAG_LAST;
                }
                self.send(ToStep::Segment(Segment { interval, ramp: 0, ticks: now as u16, power: 0, level: 0, flags }));
                self.segments_sent += 1;
                ticks += now;
            }
        }
        let begin = boards::clock_ticks();
        let longest_us = ticks * (interval >> INTERVAL_FRACTION_BITS) / TICKS_PER_US as u32 * 2 + 10_000;
        boards::call_step();
        while shared::STEP.segments_begun.load(Ordering::Relaxed) != self.segments_sent
            || !shared::STEP.at_rest.load(Ordering::Relaxed)
        {
            let waited = boards::clock_ticks().wrapping_sub(begin) / boards::CLOCK_TICKS_PER_US;
            defmt::assert!(waited < longest_us, "the step task is not done after {} us", waited);
        }
        // Waits for the last edges to pass through the wires.
        cortex_m::asm::delay(boards::CORE_HZ / 100_000);
        defmt::assert!(self.events.try_recv().is_err(), "the step task ran dry");
        let Some(edges) = self.capture.stop() else { defmt::panic!("more edges than the recorder takes: noise?") };
        edges
    }
}

/// A time in ticks of the step clock. It is printed in microseconds, with two decimals.
struct Us(i32);

impl defmt::Format for Us {
    fn format(&self, f: defmt::Formatter<'_>) {
        let sign = if self.0 < 0 { "-" } else { "" };
        let hundredths = (self.0.unsigned_abs() * 100 + TICKS_PER_US as u32 / 2) / TICKS_PER_US as u32;
        defmt::write!(f, "{=str}{}.{:02}", sign, hundredths / 100, hundredths % 100);
    }
}

/// Minimum and maximum of a measured quantity, in ticks.
#[derive(Clone, Copy)]
struct Seen {
    least: i32,
    most: i32,
}

impl Seen {
    const NOTHING: Seen = Seen { least: i32::MAX, most: i32::MIN };

    fn see(&mut self, ticks: i32) {
        self.least = self.least.min(ticks);
        self.most = self.most.max(ticks);
    }
}

/// Writes the rows of a table and records whether all figures were within their bounds.
struct Table {
    rate: u32,
    pulse_us: u8,
    setup_us: u8,
    good: bool,
}

impl Table {
    /// Writes a row; measured values and bounds are in ticks.
    fn row(&mut self, what: &'static str, seen: Seen, bounds: RangeInclusive<i32>) {
        let good = bounds.contains(&seen.least) && bounds.contains(&seen.most);
        self.good &= good;
        let Table { rate, pulse_us, setup_us, .. } = self;
        let verdict = if good { "ok" } else { "BEYOND" };
        let (least, most) = (Us(seen.least), Us(seen.most));
        if *bounds.end() == i32::MAX {
            defmt::info!(
                "| {} Hz, $0={}, $29={} | {=str} | {} to {} us | from {} us | {=str} |",
                rate,
                pulse_us,
                setup_us,
                what,
                least,
                most,
                Us(*bounds.start()),
                verdict
            );
        } else {
            defmt::info!(
                "| {} Hz, $0={}, $29={} | {=str} | {} to {} us | {} to {} us | {=str} |",
                rate,
                pulse_us,
                setup_us,
                what,
                least,
                most,
                Us(*bounds.start()),
                Us(*bounds.end()),
                verdict
            );
        }
    }

    fn judge(self) {
        defmt::assert!(self.good, "a figure is beyond its bound");
    }
}

/// Asserts that two edges were recorded for each pulse that was sent.
fn assert_pulses(wire: usize, edges: Edges, pulses: u32) {
    let Wire(output, from, to) = &WIRES[wire];
    let edges = edges.count() as u32;
    defmt::assert!(
        edges == 2 * pulses,
        "{=str}: {} edges for {} pulses; {=str} to {=str}",
        output,
        edges,
        pulses,
        from,
        to
    );
}

fn us(us: i32) -> i32 {
    us * TICKS_PER_US
}

/// Returns the time between two edges in ticks, negative if the second came first. It must be less than half a period
/// of the recorder's timer (320 us).
fn between(first: u16, second: u16) -> i32 {
    i32::from(second.wrapping_sub(first) as i16)
}

fn rise(edges: &Edges, pulse: u32) -> u16 {
    edges.at(2 * pulse as usize)
}

fn fall(edges: &Edges, pulse: u32) -> u16 {
    edges.at(2 * pulse as usize + 1)
}

/// Returns the time between two steps, in fixed-point ticks, for a step rate in Hz.
fn interval(rate: u32) -> u32 {
    ((u64::from(boards::PROFILE.step_clock_hz) << INTERVAL_FRACTION_BITS) / u64::from(rate)) as u32
}

/// Returns the minimum and maximum pulse width on a line, in ticks.
fn widths(edges: &Edges) -> Seen {
    let mut seen = Seen::NOTHING;
    for pulse in 0..edges.count() as u32 / 2 {
        seen.see(between(rise(edges, pulse), fall(edges, pulse)));
    }
    seen
}

/// Compares a train (a series of evenly spaced pulses) with `interval`. Returns the minimum and maximum error of its
/// periods, and the error of the time from its first pulse to its last but one. All errors are in ticks.
fn periods(edges: &Edges, interval: u32) -> (Seen, i32) {
    let whole = interval >> INTERVAL_FRACTION_BITS;
    let (mut errors, mut sum) = (Seen::NOTHING, 0);
    let pulses = edges.count() as u32 / 2;
    for pulse in 1..pulses {
        // The time between two pulses can be longer than a period of the recorder's 16-bit timer. The subtraction is
        // still right modulo 2^16, because the error is small.
        let period = rise(edges, pulse).wrapping_sub(rise(edges, pulse - 1));
        let error = i32::from(period.wrapping_sub(whole as u16) as i16);
        errors.see(error);
        if pulse + 1 < pulses {
            sum += error;
        }
    }
    let fraction = u64::from(interval & ((1 << INTERVAL_FRACTION_BITS) - 1));
    let fractions = ((fraction * u64::from(pulses.saturating_sub(2))) >> INTERVAL_FRACTION_BITS) as i32;
    (errors, sum - fractions)
}

/// Runs a train of evenly spaced pulses on X and Y together, and checks it.
fn train(bench: &mut Bench, rate: u32, pulses: u32, pulse_us: u8) {
    let setup_us = 10;
    bench.set(pulse_us, setup_us);
    let interval = interval(rate);
    let edges = bench.step(interval, &[Piece { axes: 0b011, backwards: 0, steps: pulses }]);
    assert_pulses(STEP_X, edges[STEP_X], pulses);
    assert_pulses(STEP_Y, edges[STEP_Y], pulses);
    assert_pulses(DIR_X, edges[DIR_X], 0);
    let (x, y) = (&edges[STEP_X], &edges[STEP_Y]);
    let mut skew = Seen::NOTHING;
    for pulse in 0..pulses {
        skew.see(between(rise(x, pulse), rise(y, pulse)));
    }
    let (errors, drift) = periods(x, interval);
    let width = us(pulse_us.into()) - us(EDGE_NS) / 1_000..=us(i32::from(pulse_us) + LATEST_PULSE_END_US);
    let mut table = Table { rate, pulse_us, setup_us, good: true };
    table.row("pulse of X", widths(x), width.clone());
    table.row("pulse of Y", widths(y), width);
    table.row("Y behind X", skew, -us(SKEW_NS) / 1_000..=us(SKEW_NS) / 1_000);
    table.row("period too long by", errors, -us(PERIOD_ERROR_US)..=us(PERIOD_ERROR_US));
    table.row("last pulse but one late by", Seen { least: drift, most: drift }, -us(DRIFT_US)..=us(DRIFT_US));
    table.judge();
}

/// Moves X back, forth, back and forth without a pause, and checks set-up and hold of the direction.
fn zigzag(bench: &mut Bench, rate: u32, pulse_us: u8, setup_us: u8) {
    const STEPS: u32 = 20;
    const PIECES: u32 = 4;
    bench.set(pulse_us, setup_us);
    let pieces: [Piece; PIECES as usize] =
        core::array::from_fn(|k| Piece { axes: 0b001, backwards: u8::from(k % 2 == 0), steps: STEPS });
    let [x, direction, y] = bench.step(interval(rate), &pieces);
    assert_pulses(STEP_X, x, STEPS * PIECES);
    assert_pulses(STEP_Y, y, 0);
    // The direction signal rises and falls twice.
    assert_pulses(DIR_X, direction, PIECES / 2);
    let (mut setup, mut hold) = (Seen::NOTHING, Seen::NOTHING);
    for piece in 0..PIECES {
        let turned = direction.at(piece as usize);
        setup.see(between(turned, rise(&x, piece * STEPS)));
        if piece > 0 {
            hold.see(between(fall(&x, piece * STEPS - 1), turned));
        }
    }
    let mut table = Table { rate, pulse_us, setup_us, good: true };
    let least = us(LEAST_SETUP_US.max(setup_us.into())) - us(EDGE_NS) / 1_000;
    table.row("direction before pulse", setup, least..=i32::MAX);
    table.row("direction after pulse", hold, 0..=i32::MAX);
    table.judge();
}

/// Asserts that all edges of a wire arrive at its own input and that no edge arrives at another input.
fn check_wire(wire: usize, edges: [Edges; 3], expected: u32) {
    let Wire(output, from, to) = &WIRES[wire];
    let seen = edges.map(|line| line.count() as u32);
    defmt::info!("{=str}: {} edges at the three inputs, {} at {=str} wanted", output, seen, expected, to);
    for (other, Wire(_, _, place)) in WIRES.iter().enumerate() {
        // The X axis steps while its direction is tested.
        let steps_too = wire == DIR_X && other == STEP_X;
        defmt::assert!(
            other == wire || steps_too || seen[other] == 0,
            "edges of {=str} come at {=str}: {=str} is to be wired to {=str}",
            output,
            place,
            from,
            to
        );
    }
    defmt::assert!(seen[wire] != 0, "no edge of {=str} at {=str}: is {=str} wired to {=str}?", output, to, from, to);
    defmt::assert!(
        seen[wire] == expected,
        "{=str}: {} edges instead of {}: a bad contact?",
        output,
        seen[wire],
        expected
    );
}

#[defmt_test::tests]
mod suite {
    use super::*;

    #[init]
    fn init() -> Bench {
        let Some(device) = pac::Peripherals::take() else { defmt::panic!("somebody else has the board") };
        let parts = boards::setup(device, low_voltage);
        // SAFETY: unsafe because the peripherals are taken a second time; safe because the board uses neither TIM4 nor,
        // in these tests, the recorder's streams of DMA1 (one of them would change the laser's power), and because only
        // the recorder's own pins of port B, timer and clocks are changed.
        let again = unsafe { pac::Peripherals::steal() };
        let capture = Capture::new(again.TIM4, again.DMA1, &again.GPIOB, &again.RCC);

        let segments = singleton!(: Channel<ToStep, SEGMENTS_DEPTH> = Channel::new()).expect("once");
        let wiring = singleton!(: Channel<Wiring, 2> = Channel::new()).expect("once");
        let events = singleton!(: Channel<StepEvent<{ boards::AXES }>, EVENTS_DEPTH> = Channel::new()).expect("once");
        let wake = singleton!(: Signal<()> = Signal::new()).expect("once");
        let (segments_in, segments_out) = segments.split();
        let (wiring_in, wiring_out) = wiring.split();
        let (events_in, events_out) = events.split();
        let step = Step::new(parts.step_pins, segments_out, wiring_out, events_in, wake.writer());
        // SAFETY: unsafe because a static is changed and an interrupt is unmasked; safe because the interrupt is masked
        // until the task is stored, and the tests share nothing with it but channels and atomics.
        unsafe {
            (&raw mut STEP).cast::<Step>().write(step);
            pac::NVIC::unmask(pac::Interrupt::TIM5);
        }
        Bench { segments: segments_in, wiring: wiring_in, events: events_out, capture, segments_sent: 0 }
    }

    #[test]
    fn each_output_is_wired_to_its_input(bench: &mut Bench) {
        bench.set(10, 10);
        let rate = interval(1_000);
        let edges = bench.step(rate, &[Piece { axes: 0b001, backwards: 0, steps: 4 }]);
        check_wire(STEP_X, edges, 8);
        let edges = bench.step(rate, &[Piece { axes: 0b010, backwards: 0, steps: 4 }]);
        check_wire(STEP_Y, edges, 8);
        let back = Piece { axes: 0b001, backwards: 0b001, steps: 4 };
        let forth = Piece { axes: 0b001, backwards: 0, steps: 4 };
        let edges = bench.step(rate, &[back, forth]);
        check_wire(DIR_X, edges, 2);
    }

    /// The figures are valid only if the recorder counts the clock of the step timer.
    #[test]
    fn the_recorder_counts_step_clock_ticks(bench: &mut Bench) {
        // SAFETY: unsafe because the register is read without owning the timer; safe because reading CNT has no effect.
        let step_clock = || unsafe { (*pac::TIM5::ptr()).cnt().read().bits() } as u16;
        let mut seen = Seen::NOTHING;
        let apart = || between(bench.capture.now(), step_clock());
        let first = apart();
        for _ in 0..100 {
            cortex_m::asm::delay(boards::CORE_HZ / 10_000);
            seen.see(apart() - first);
        }
        // The two counters are read one after the other over a bus, which takes a few ticks.
        defmt::assert!(seen.most - seen.least < 20, "{} to {} ticks apart", seen.least, seen.most);
    }

    #[test]
    fn slow_train(bench: &mut Bench) {
        train(bench, 1_000, 60, 10);
    }

    #[test]
    fn medium_train(bench: &mut Bench) {
        train(bench, 10_000, 400, 10);
    }

    #[test]
    fn fast_train(bench: &mut Bench) {
        train(bench, 50_000, LONGEST_TRAIN, 10);
    }

    #[test]
    fn train_at_the_safe_rate(bench: &mut Bench) {
        train(bench, boards::PROFILE.rates.greatest_hz(10) as u32, LONGEST_TRAIN, 1);
    }

    #[test]
    fn directions_change_between_pulses(bench: &mut Bench) {
        zigzag(bench, 5_000, 10, 10);
        // Here the direction set-up time is longer than the pause between two pulses, so the pulse after a change of
        // direction has to wait.
        zigzag(bench, 20_000, 10, 50);
        zigzag(bench, 50_000, 10, 10);
        zigzag(bench, 50_000, 10, 0);
    }
}
