//! Benchmark program: `cargo xtask count` runs it in QEMU, traces each instruction, and prints a table. The
//! instructions from the entry to the return of a function `unit_*` are the cost of one call. This cost is added to the
//! row of the table that the most recent call of a function `row_*` has chosen.
//!
//! The step interrupt is the firmware's own code (`step_timer`). This machine lacks the STM32F4's registers, so plain
//! memory takes their place; the executed instructions are the same. Before each interrupt, the values that a row needs
//! are written into this memory, so that each row has the same input in every run.
#![no_std]
#![no_main]

use boards::Due;
use core::hint::black_box;
use core::mem::MaybeUninit;
use core::sync::atomic::Ordering;
use oxmill_boards::stm32f4::registers::Map;
use oxmill_boards::stm32f4::step::{Clocks, Place, Pwm, Rings};
use oxmill_controller::axes::{Arrangement, Axis, PerAxis};
use oxmill_controller::gcode::{Action, Dialect, Interpreter, ProgramStorage};
use oxmill_controller::memory::{Memory, Storage};
use oxmill_controller::messages::*;
use oxmill_controller::motion::{Arc, ArcGeometry, Motion, MotionSettings, MotionStorage, Move, Speed, Tolerance};
use oxmill_controller::recorder::{Page, Recorder};
use oxmill_controller::units::{Coordinate, Instant, StepsPerMm};
use oxmill_controller::{Controller, Profile, StepRates};
use oxmill_firmware as _;
use oxmill_on_target as _;
use rtic_sync::channel::{Channel, Sender};
use rtic_sync::signal::Signal;
use step_timer::Step;

// The step task is compiled once more, for the board below, because it takes the types of its timer and pins from
// `crate::boards`.
#[allow(dead_code, reason = "the benchmark calls the step task only")]
#[path = "../../../src/step_task/shared.rs"]
mod shared;
#[path = "../../../src/step_task/step_timer/mod.rs"]
mod step_timer;

/// The board for which the step task is built here: pins on one port and a step clock of 96 MHz, as on the Black Pill.
mod boards {
    use oxmill_boards::stm32f4::registers::Map;
    use oxmill_boards::stm32f4::step;
    pub use oxmill_boards::{COMBINATIONS, Due, Free, SecondMotor, StepOutput, Undone};
    use oxmill_controller::{Profile, StepRates};

    pub const CORE_HZ: u32 = 96_000_000;
    pub const RUN_CYCLES: u32 = 4_450;

    pub const AXES: usize = 3;
    pub const PROFILE: Profile = Profile {
        name: "count",
        step_clock_hz: 96_000_000,
        rates: StepRates { safe_hz: 490_000, least_pulse_tenths: 5 },
        axes: 3,
        has_second_motor: false,
        has_at_speed: true,
        program_pins: [0; 2],
        most_baud: 1_000_000,
        oscillator_mhz: 0,
        has_store: false,
        has_loader: false,
    };
    // Addresses of large objects in memory that nothing else uses.
    pub const FAR_PLANNER: usize = 0x2120_0000;
    pub const CONTROLLER: usize = 0x2130_0000;
    pub const FAR_RINGS: usize = 0x2140_0000;
    pub const RING: usize = 0x2150_0000;
    /// Replaces the addresses of the registers by memory of the emulated machine that nothing else uses.
    pub struct Memory;
    // SAFETY: unsafe because writes go there; safe because nothing else uses this memory.
    unsafe impl Map for Memory {
        const GPIO: usize = 0x2110_0000;
        const TIM5: usize = 0x2100_0000;
        const TIM3: usize = 0x2100_0400;
        const TIM1: usize = 0x2100_0800;
        const TIM8: usize = 0x2100_1800;
        const TIM8_MAKES_PULSES: bool = false;
        const DMA1: usize = 0x2100_0C00;
        const DMA2: usize = 0x2100_1000;
        const RCC: usize = 0x2100_1400;
    }
    pub type StepPins = step::StepPins<Memory, 1, 1, ()>;
}

/// Defines the functions `row_*`. After a call of one, all calls of `unit_*` count for its row of the table. After
/// `row_none` they count for no row.
macro_rules! rows {
    ($($row:ident)*) => { $(
        #[unsafe(no_mangle)]
        #[unsafe(naked)]
        // unsafe because an exported name can clash with another, and the compiler does not check a naked function;
        // safe because this name is unique, and the function only returns.
        extern "C" fn $row() {
            core::arch::naked_asm!("bx lr")
        }
    )* };
}

rows! {
    row_batch_3 row_batch_1 row_segment row_single row_stop row_none
    row_prepare row_plan row_walk_near row_walk_far row_text row_chord row_line
    row_relief_line row_spiral_line row_uneven_line
    row_jerk_prepare row_jerk_plan row_jerk_walk_near row_jerk_walk_far
    row_recorded_line row_recorded_block row_recorded_rest
}

static mut STEP: MaybeUninit<Step> = MaybeUninit::uninit();

/// The interrupt handler as RTIC generates it: saves the priority threshold, runs the task and restores the threshold.
#[unsafe(no_mangle)]
#[inline(never)]
// unsafe because an exported name can clash with another; safe because this name is unique.
extern "C" fn unit_step() {
    let before = cortex_m::register::basepri::read();
    // SAFETY: unsafe because a static is changed; safe because `main` has initialized it and nothing interrupts.
    unsafe { (&raw mut STEP).cast::<Step>().as_mut_unchecked().run() };
    // SAFETY: unsafe because a critical section might end; safe because there is none.
    unsafe { cortex_m::register::basepri::write(before) };
}

fn register(address: usize) -> *mut u32 {
    address as *mut u32
}

/// The memory in place of registers, and an emulation of the hardware that outputs the step events.
struct Registers {
    /// Number of events that the emulated hardware has output, and the time of the most recent one.
    out: usize,
    last: u32,
}

impl Registers {
    const RING: usize = 128;
    const SR: usize = boards::Memory::TIM5 + 0x10;
    const CNT: usize = boards::Memory::TIM5 + 0x24;
    const CCR1: usize = boards::Memory::TIM5 + 0x34;
    const CCR2: usize = boards::Memory::TIM5 + 0x38;
    /// Transfers left (NDTR) of the DMA stream that starts the pulses.
    const EDGES_LEFT: usize = boards::Memory::DMA2 + 0x10 + 0x18 + 0x04;
    /// Transfers left (NDTR) of the DMA stream that ends the pulses.
    const ENDS_LEFT: usize = boards::Memory::DMA2 + 0x10 + 4 * 0x18 + 0x04;
    /// Transfers left (NDTR) and memory address (M0AR) of the DMA stream that loads the times of events.
    const MOMENTS_LEFT: usize = boards::Memory::DMA1 + 0x10 + 2 * 0x18 + 0x04;
    const MOMENTS_AT: usize = boards::Memory::DMA1 + 0x10 + 2 * 0x18 + 0x0C;

    fn read(&self, address: usize) -> u32 {
        // SAFETY: unsafe because of the raw address; safe because it is in the memory that only this type uses, or in
        // the ring whose address this memory holds.
        unsafe { register(address).read_volatile() }
    }

    fn write(&mut self, address: usize, value: u32) {
        // SAFETY: unsafe because of the raw address; safe because it is in the memory that only this type uses.
        unsafe { register(address).write_volatile(value) }
    }

    /// Calls the interrupt handler with these flags set, at time `now` of the step clock.
    fn interrupt(&mut self, flags: Due, now: u32) {
        self.write(Self::CNT, now);
        self.write(Self::SR, flags.0);
        unit_step();
        // Prevents a tail call: the trace needs a call and its return.
        cortex_m::asm::nop();
    }

    /// Returns the time of an event, in ticks of the step clock, from the ring of times that the step task fills.
    fn moment(&self, event: usize) -> u32 {
        self.read(self.read(Self::MOMENTS_AT) as usize + 4 * (event % Self::RING))
    }

    /// Returns how many events in the ring have not been output yet. The slot after the last event holds an earlier
    /// time, which marks the end.
    fn ahead(&self) -> usize {
        let mut last = self.last;
        (self.out..self.out + Self::RING)
            .take_while(|event| {
                let moment = self.moment(*event);
                let follows = moment.wrapping_sub(last) as i32 > 0;
                last = moment;
                follows
            })
            .count()
    }

    /// Emulates the output of queued events until only `left` of them have not been output.
    fn put_out(&mut self, left: usize) {
        for _ in left..self.ahead() {
            self.last = self.moment(self.out);
            self.out += 1;
        }
        self.write(Self::EDGES_LEFT, (Self::RING - self.out % Self::RING) as u32);
        self.write(Self::ENDS_LEFT, (Self::RING - self.out % Self::RING) as u32);
        self.write(Self::MOMENTS_LEFT, (Self::RING - (self.out + 1) % Self::RING) as u32);
    }

    /// Starts the step task from rest, and calls it until its first events are queued.
    fn start(&mut self) {
        self.interrupt(Due::CALLED, 0);
        // Until the output of events has started, the step task writes the time of its next call to CCR2. `MOMENTS_AT`
        // is cleared here; the step task sets it when it starts the output.
        self.write(Self::MOMENTS_AT, 0);
        let mut calls = 0;
        while self.read(Self::MOMENTS_AT) == 0 {
            // Give up if the task does not start, for example after an underrun. Otherwise the trace would fill the
            // disk.
            assert!(calls < 20, "the step task does not start");
            calls += 1;
            self.interrupt(Due::MORE, self.read(Self::CCR2));
        }
        (self.out, self.last) = (0, self.read(Self::CNT));
        self.put_out(Self::RING);
    }

    /// Emulates the output of events up to the time at which the step task must be called next (in CCR2). Then calls
    /// the step task.
    fn called(&mut self) {
        let now = self.read(Self::CCR2);
        let ahead = self.ahead();
        let out = (0..ahead).take_while(|place| self.moment(self.out + place).wrapping_sub(now) as i32 <= 0).count();
        self.put_out(ahead - out);
        self.interrupt(Due::MORE, now);
    }

    /// Outputs events and calls the task until it is at rest.
    fn finish(&mut self) {
        while !shared::STEP.at_rest.load(Ordering::Relaxed) {
            self.called();
        }
    }
}

/// Returns the messages of a block and of its first segment.
fn block(steps: [u32; 3], directions: u8, ticks: u16, level: u8, flags: u8) -> [ToStep; 2] {
    let flags = flags | Segment::FLAG_NEW_BLOCK;
    let segment = Segment { interval: 200 << INTERVAL_FRACTION_BITS, ramp: 7, ticks, power: 500, level, flags };
    [ToStep::Block { steps_by_axis: steps.map(AxisSteps::on_steps), directions }, ToStep::Segment(segment)]
}

fn send(to: &mut Sender<'static, ToStep, SEGMENTS_DEPTH>, messages: &[ToStep]) {
    for message in messages {
        let _ = to.try_send(*message);
    }
}

fn step_task() {
    let segments = cortex_m::singleton!(: Channel<ToStep, SEGMENTS_DEPTH> = Channel::new()).expect("main runs once");
    let wiring = cortex_m::singleton!(: Channel<Wiring, 2> = Channel::new()).expect("main runs once");
    let events = cortex_m::singleton!(: Channel<StepEvent<3>, EVENTS_DEPTH> = Channel::new()).expect("main runs once");
    let wake = cortex_m::singleton!(: Signal<()> = Signal::new()).expect("main runs once");
    let (mut to_step, from_control) = segments.split();
    let (mut wiring_in, wiring_out) = wiring.split();
    let (events_in, mut events_out) = events.split();
    let pin = |pin| Some(Place::new(0, pin));
    // SAFETY: unsafe because of the raw address; safe because it is in memory that nothing else uses, and this runs
    // once.
    let rings = unsafe { (boards::FAR_RINGS as *mut MaybeUninit<Rings<1>>).as_mut_unchecked() }.write(Rings::EMPTY);
    let clocks = Clocks { pulse_mhz: 96, pwm_hz: 96_000_000 };
    let pins = boards::StepPins::at(
        [1, 2, 3, 8].map(pin),
        [4, 5, 6, 9].map(pin),
        pin(15),
        Pwm::of_tim3::<boards::Memory>(1),
        clocks,
        rings,
        (),
    );
    let step = Step::new(pins, from_control, wiring_out, events_in, wake.writer());
    // SAFETY: unsafe because a static is changed; safe because no other code uses it yet.
    unsafe { (&raw mut STEP).cast::<Step>().write(step) };
    let mut registers = Registers { out: 0, last: 0 };
    row_none();
    let _ = wiring_in.try_send(SHORT_PULSES);
    registers.interrupt(Due::CALLED, 0);
    shared::Power { level: 100, from_segments: true }.want();

    // In each run the step task generates 32 events while 31 earlier events still wait for their output. X steps at
    // each tick. If Y and Z move too, counters decide at which ticks these axes step.
    let rows: [(extern "C" fn(), [u32; 3]); 2] = [(row_batch_3, [900, 700, 500]), (row_batch_1, [900, 0, 0])];
    for (row, steps) in rows {
        send(&mut to_step, &block(steps, 0, 900, 0, Segment::FLAG_LAST));
        registers.start();
        registers.interrupt(Due::MORE, registers.last);
        for _ in 0..20 {
            registers.put_out(31);
            row();
            registers.interrupt(Due::MORE, registers.last);
            row_none();
        }
        registers.finish();
    }

    // The longest runs of the step task. In each run a block begins, with other directions and another power than the
    // block before. The task receives the messages of the block and of its segment, and generates as many events as
    // it can. Before each run, 28 to 50 events still wait for their output, and messages of several blocks are
    // queued.
    let mut turning = |turn: u8, last: u8| {
        let ticks = 17 + u16::from(turn) * 29 % 97;
        let [first, second] = block([ticks.into(), 15, 10], if turn & 1 == 0 { 0 } else { 7 }, ticks, 0, last);
        let ToStep::Segment(segment) = second else { return };
        send(&mut to_step, &[first, ToStep::Segment(Segment { power: 100 + u16::from(turn), ..segment })]);
    };
    let before = shared::STEP.segments_begun.load(Ordering::Relaxed);
    let mut sent = 4;
    (0..sent).for_each(|turn| turning(turn, 0));
    registers.start();
    for turn in 0..160_usize {
        let begun = shared::STEP.segments_begun.load(Ordering::Relaxed).wrapping_sub(before);
        if u32::from(sent) < begun + 10 {
            turning(sent, 0);
            sent += 1;
        }
        registers.put_out(28 + turn * 7 % 23);
        row_segment();
        registers.interrupt(Due::MORE, registers.last);
        row_none();
        registers.interrupt(Due::MARK, registers.last);
    }
    turning(sent, Segment::FLAG_LAST);
    registers.finish();

    // Here each event is output by a call of its own, because the probe is watched. The probe is not triggered.
    registers.write(boards::Memory::GPIO + 0x10, u32::MAX);
    send(&mut to_step, &[ToStep::Watch { probe: Some(true), braking: 1.0 }]);
    send(&mut to_step, &block([100; 3], 0, 100, 0, Segment::FLAG_LAST));
    registers.interrupt(Due::CALLED, 0);
    let (before, mut calls) = (registers.read(Registers::CCR1), 0);
    while registers.read(Registers::CCR1) == before {
        assert!(calls < 20, "the step task does not start");
        calls += 1;
        registers.interrupt(Due::MORE, registers.read(Registers::CCR2));
    }
    for event in 0..90 {
        if event > 3 {
            row_single();
        }
        registers.write(Registers::EDGES_LEFT, (Registers::RING - (event + 1) % Registers::RING) as u32);
        registers.interrupt(Due::OUT, registers.read(Registers::CCR1));
        row_none();
    }

    // Stops the step task at full speed, while its ring is full of events. The first stop, before the loop, only ends
    // the events above.
    shared::ask_for_stop();
    registers.interrupt(Due::CALLED, registers.last);
    for stops in 1..10 {
        registers.interrupt(Due::MORE, registers.read(Registers::CCR2));
        while events_out.try_recv().is_ok() {}
        send(&mut to_step, &[ToStep::Resume { stops }]);
        send(&mut to_step, &block([900, 700, 500], 7, 900, 0, 0));
        registers.start();
        for _ in 0..5 {
            registers.interrupt(Due::MORE, registers.last);
        }
        shared::ask_for_stop();
        row_stop();
        registers.interrupt(Due::CALLED, registers.last);
        row_none();
    }
}

/// The settings `$0` = 1 (us) and `$29` = 0.
const SHORT_PULSES: Wiring = Wiring {
    pulse_tenths: 10,
    direction_setup_us: 0,
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

/// 80 steps/mm, 10 m/min and 500 mm/s^2, because published figures of comparable controllers were measured with these
/// settings.
fn motion_settings() -> MotionSettings<3> {
    MotionSettings {
        steps_per_mm: PerAxis::all(StepsPerMm::new(80.0).expect("in range")),
        max_rate: PerAxis::all(10_000.0 / 60.0),
        least_feed: 0.0,
        acceleration: PerAxis::all(500.0),
        jerk: PerAxis::all(0.0),
        junction_deviation: 0.01,
        curve_share: 1.0,
        arc_tolerance: 0.002,
        step_clock_hz: boards::PROFILE.step_clock_hz,
        arrangement: Arrangement::Cartesian,
        backlash: PerAxis::all(0.0),
    }
}

type Planner = Motion<3>;

#[unsafe(no_mangle)]
#[inline(never)]
// unsafe because an exported name can clash with another; safe because this name is unique.
fn unit_plan(motion: &mut Planner, line: &Move<3>) -> bool {
    motion.line(line)
}

#[unsafe(no_mangle)]
#[inline(never)]
// unsafe because an exported name can clash with another; safe because this name is unique.
fn unit_prepare(motion: &mut Planner, observed: &Observed) -> Option<ToStep> {
    motion.next(observed)
}

fn micrometres(x: i64, y: i64) -> PerAxis<Coordinate, 3> {
    PerAxis([Coordinate(x * 10_000), Coordinate(y * 10_000), Coordinate::ZERO])
}

fn line_to(x: i64, y: i64, speed: f32) -> Move<3> {
    let target = micrometres(x, y);
    let speed = Speed::Feed(speed);
    Move {
        target,
        speed,
        power: 0,
        scale_power: false,
        line_number: 0,
        no_feed_override: false,
        digit: 0.001,
        tolerance: Tolerance::EXACT,
    }
}

fn planning(motion: &mut Planner) {
    // Each block is so long that the machine could stop within it. So a new block changes no entry speed of the blocks
    // before it.
    for k in 0..40 {
        let line = line_to(10_000 * (k + 1), if k & 1 == 0 { 3_000 } else { 0 }, 60.0);
        if k == 4 {
            row_plan();
        }
        black_box(unit_plan(motion, black_box(&line)));
    }
    row_none();
    motion.start();
    let mut observed = Observed::default();
    let mut handed = 0;
    while let Some(message) = unit_prepare(motion, black_box(&observed)) {
        // The planner's first message of a block is the block itself; the following ones are its segments. The calls
        // after the first such message count for `row_prepare`.
        match message {
            ToStep::Segment(_) => {
                handed += 1;
                observed.segments_begun += 1;
            }
            _ => row_prepare(),
        }
        if handed == 400 {
            break;
        }
    }
    row_none();
    run_out(motion, &mut observed);

    // These blocks are so short that each new block changes the entry speeds of all blocks before it. So the first
    // segment waits until the planner has walked over all of them.
    for (from, blocks, row) in [(400_000, 40, row_walk_near as extern "C" fn()), (500_000, 120, row_walk_far)] {
        motion.line(&line_to(from, 0, 160.0));
        motion.start();
        run_out(motion, &mut observed);
        for k in 0..blocks {
            motion.line(&line_to(from + 100 * (k + 1), 0, 160.0));
        }
        motion.start();
        // Takes the message of the block itself, so that the measured call returns the first segment.
        motion.next(&observed);
        row();
        let segment = unit_prepare(motion, black_box(&observed));
        row_none();
        observed.segments_begun += u32::from(segment.is_some());
        run_out(motion, &mut observed);
    }
}

/// Takes all messages of the queued blocks from the planner, then reports to it that the step task is idle.
fn run_out(motion: &mut Planner, observed: &mut Observed) {
    while let Some(message) = motion.next(observed) {
        observed.segments_begun += u32::from(matches!(message, ToStep::Segment(_)));
    }
    observed.step_idle = true;
    motion.observe(observed);
    observed.step_idle = false;
}

/// A planner with the look-ahead of the large boards, 512 blocks.
type FarPlanner = Motion<3>;

#[unsafe(no_mangle)]
#[inline(never)]
// unsafe because an exported name can clash with another; safe because this name is unique.
fn unit_plan_far(motion: &mut FarPlanner, line: &Move<3>) -> bool {
    motion.line(line)
}

#[unsafe(no_mangle)]
#[inline(never)]
// unsafe because an exported name can clash with another; safe because this name is unique.
fn unit_prepare_far(motion: &mut FarPlanner, observed: &Observed) -> Option<ToStep> {
    motion.next(observed)
}

/// The same as [`planning`], but with jerk limits that differ between the axes.
fn planning_with_jerk(motion: &mut FarPlanner) {
    // The blocks are shorter than those in [`planning`] and so have fewer segments, because QEMU logs every
    // instruction.
    for k in 0..40 {
        let line = line_to(2_000 * (k + 1), if k & 1 == 0 { 600 } else { 0 }, 60.0);
        if k == 4 {
            row_jerk_plan();
        }
        black_box(unit_plan_far(motion, black_box(&line)));
    }
    row_jerk_prepare();
    motion.start();
    let mut observed = Observed::default();
    for _ in 0..400 {
        let message = unit_prepare_far(motion, black_box(&observed));
        observed.segments_begun += u32::from(matches!(message, Some(ToStep::Segment(_))));
    }
    row_none();
    while let Some(message) = motion.next(&observed) {
        observed.segments_begun += u32::from(matches!(message, ToStep::Segment(_)));
    }
    observed.step_idle = true;
    motion.observe(&observed);

    // Blocks of four steps on a curve so wide that no corner limits the speed. So the speed changes in one ramp that
    // extends over all queued blocks.
    let far = 400_000;
    let mut next = 0;
    let mut line = || {
        next += 1;
        line_to(far + 50 * next, next * next / 400, 160.0)
    };
    for k in 0..256 {
        match k {
            40 => row_jerk_walk_near(),
            41 => row_none(),
            240 => row_jerk_walk_far(),
            241 => row_none(),
            _ => {}
        }
        black_box(unit_plan_far(motion, black_box(&line())));
    }
}

#[unsafe(no_mangle)]
#[inline(never)]
// unsafe because an exported name can clash with another; safe because this name is unique.
fn unit_text(interpreter: &mut Interpreter<3>, line: &[u8], checked: &mut Action<3>) {
    if interpreter.check_into(line, Dialect::Oxmill, checked).is_ok() {
        interpreter.commit(black_box(checked));
    }
}

#[unsafe(no_mangle)]
#[inline(never)]
// unsafe because an exported name can clash with another; safe because this name is unique.
fn unit_chord(arc: &mut Arc<3>) -> Option<PerAxis<Coordinate, 3>> {
    arc.next_chord()
}

fn text_and_arcs() {
    let memory = cortex_m::singleton!(: MaybeUninit<ProgramStorage<3, 6144>> = MaybeUninit::uninit())
        .expect("main runs once")
        .write(ProgramStorage::EMPTY)
        .lend();
    let mut interpreter = Interpreter::<3>::new(memory);
    let mut checked = Action::NOTHING;
    row_text();
    for _ in 0..4 {
        unit_text(black_box(&mut interpreter), black_box(b"G1X12.345Y-6.789F1200"), black_box(&mut checked));
    }
    row_none();
    let mut geometry = ArcGeometry {
        start: micrometres(0, 0),
        target: micrometres(20_000, 0),
        axis_0: Axis::X,
        axis_1: Axis::Y,
        offset_0: Coordinate::mm(10),
        offset_1: Coordinate::ZERO,
        clockwise: true,
        turns: 0,
    };
    for depth in [0, -1] {
        geometry.target.set(Axis::Z, Coordinate::mm(depth));
        let mut arc = Arc::new(&geometry, 0.002);
        row_chord();
        while arc.chords_left() > 1 {
            black_box(unit_chord(black_box(&mut arc)));
        }
        row_none();
    }
}

/// A controller with the look-ahead of the smallest board, 256 blocks.
type Whole = Controller<3>;

/// The lines whose segments wait in the step task, oldest first. `lines`: for each line its number of segments and
/// their duration in ticks of the step clock. `clocks`: sum of these durations. `begun`: number of segments that have
/// begun so far.
#[derive(Default)]
struct Waiting {
    lines: heapless::Deque<(u32, u32), 64>,
    clocks: u32,
    begun: u32,
}

impl Waiting {
    /// Adds the segments of a line. Removes the oldest lines until the waiting lines last at most `most_ms` in total. A
    /// machine that keeps up with its sender would have started these oldest lines.
    fn add(&mut self, segments: u32, clocks: u32, most_ms: u32) {
        self.clocks += clocks;
        self.lines.push_back((segments, clocks)).expect("lines of 12 ms");
        while self.clocks > boards::PROFILE.step_clock_hz / 1000 * most_ms {
            let (segments, clocks) = self.lines.pop_front().expect("the lines last so long");
            self.clocks -= clocks;
            self.begun += segments;
        }
    }
}

/// Results of a line: number of segments and their ticks of the step clock, whether the line was answered, and whether
/// a block was sent.
#[derive(Default)]
struct Outcome {
    segments: u32,
    clocks: u32,
    answered: bool,
    block: bool,
}

/// Feeds the bytes of a line to the controller. Then takes outputs until one of them is a block for the step task, or
/// until no output is left.
#[unsafe(no_mangle)]
#[inline(never)]
// unsafe because an exported name can clash with another; safe because this name is unique.
fn unit_line(controller: &mut Whole, line: &[u8], segments_begun: u32) -> Outcome {
    let now = Instant::from_ticks(0);
    let mut outcome = Outcome::default();
    let mut left = line;
    while let Some(byte) = left.first() {
        let ahead = left.get(..LineBytes::MOST).unwrap_or(left);
        match controller.take_text(0, ahead) {
            0 => {
                controller.event(now, Event::Line(LineByte { byte: *byte, epoch: 0, damaged: false }));
                left = &left[1..];
            }
            taken => left = &left[taken..],
        }
    }
    loop {
        let observed = Observed { segments_begun, step_idle: false, rx_free: 0, received: 1, activity: 0 };
        controller.observe(observed);
        match &controller.output(now, Room { step: true, reply: true }) {
            Some(Output::Step(ToStep::Block { .. })) => {
                outcome.block = true;
                return outcome;
            }
            Some(Output::Step(ToStep::Segment(segment))) => {
                outcome.segments += 1;
                outcome.clocks += (segment.interval >> INTERVAL_FRACTION_BITS) * u32::from(segment.ticks);
            }
            Some(Output::Reply(_) | Output::Answer(_)) => outcome.answered = true,
            Some(other) => _ = black_box(other),
            None => return outcome,
        }
    }
}

/// A controller that receives lines, and an account of the lines whose segments wait for the step task.
struct Streaming {
    controller: &'static mut Whole,
    waiting: Waiting,
    /// Maximum total duration of the lines that wait in the step task, ms.
    most_ms: u32,
    text: heapless::String<48>,
}

impl Streaming {
    const NOW: Instant = Instant::from_ticks(0);

    /// Starts a controller with 500 mm/s^2 and 10 m/min, like [`motion_settings`].
    fn start(place: &'static mut MaybeUninit<Whole>, memory: Memory<3>) -> Self {
        const PROFILE: Profile =
            Profile { rates: StepRates { safe_hz: 1_000_000, ..boards::PROFILE.rates }, ..boards::PROFILE };
        let controller = place.write(Controller::new(PROFILE, memory));
        controller.start(Self::NOW);
        controller.event(Self::NOW, Event::Signals(Sensed::default()));
        let mut streaming =
            Self { controller, waiting: Waiting::default(), most_ms: 12, text: heapless::String::new() };
        for axis in 0..3 {
            streaming.queue(format_args!("$12{axis}=500\n"));
            streaming.queue(format_args!("$11{axis}=10000\n"));
        }
        streaming
    }

    fn write(&mut self, line: core::fmt::Arguments) {
        self.text.clear();
        core::fmt::write(&mut self.text, line).expect("a short line");
    }

    /// Sends a line while the queue to the step task has no room, so that no message goes there.
    fn queue(&mut self, line: core::fmt::Arguments) {
        self.write(line);
        for byte in self.text.bytes() {
            self.controller.event(Self::NOW, Event::Line(LineByte { byte, epoch: 0, damaged: false }));
        }
        while let Some(output) = self.controller.output(Self::NOW, Room { step: false, reply: true }) {
            black_box(output);
        }
    }

    /// Sends a line, takes its messages to the step task, and adds its segments to those that wait there.
    fn line(&mut self, line: core::fmt::Arguments) -> Outcome {
        self.write(line);
        let outcome = unit_line(self.controller, black_box(self.text.as_bytes()), self.waiting.begun);
        self.waiting.add(outcome.segments, outcome.clocks, self.most_ms);
        outcome
    }

    /// Sends the lines of a curve, with points of three decimals, as post-processors write them. The look-ahead is
    /// full, so that one block goes to the step task for each line that arrives. The last 200 lines count for the row.
    fn curve(&mut self, row: extern "C" fn(), lines: u32, mut point: impl FnMut(u32) -> [i32; 3]) {
        const COUNTED: u32 = 200;
        let (mut answered, mut blocks) = (0, 0);
        for k in 1..=lines {
            if k == lines - COUNTED {
                row();
                (answered, blocks) = (0, 0);
            }
            let [x, y, z] = point(k).map(Thousandths);
            let outcome = self.line(format_args!("X{x}Y{y}Z{z}\n"));
            answered += u32::from(outcome.answered);
            blocks += u32::from(outcome.block);
        }
        row_none();
        assert!(answered.abs_diff(COUNTED) < 10 && blocks.abs_diff(COUNTED) < 10, "{answered} {blocks}");
    }
}

/// A number of thousandths, written with three decimals.
struct Thousandths(i32);

impl core::fmt::Display for Thousandths {
    fn fmt(&self, f: &mut core::fmt::Formatter) -> core::fmt::Result {
        let sign = if self.0 < 0 { "-" } else { "" };
        let of = self.0.unsigned_abs();
        write!(f, "{sign}{}.{:03}", of / 1000, of % 1000)
    }
}

/// Runs lines of about 0.1 mm at 100 mm/s on a curve so gentle that no turn limits the speed.
fn gentle_line(streaming: &mut Streaming) {
    streaming.queue(format_args!("G1F6000\n"));
    for k in 1..=600_u32 {
        let (x, y) = (k * 98, k * k / 10);
        let (x, y) = (Thousandths(x as i32), Thousandths(y as i32));
        if k < 200 {
            streaming.queue(format_args!("X{x}Y{y}\n"));
            continue;
        }
        if k == 300 {
            row_line();
        }
        let outcome = streaming.line(format_args!("X{x}Y{y}\n"));
        let settled = outcome.answered && outcome.block;
        assert!(settled || k < 300, "line {k} was not answered, or no block has gone for it");
    }
    row_none();
}

/// Runs the lines of reliefs and of a spiral, whose turns are so tight that they can limit the speed. Each curve begins
/// where the one before it ends.
fn tight_lines(streaming: &mut Streaming) {
    // At most 10 ms of motion may wait here, because a line lasts longer than a line of [`gentle_line`]. With less,
    // the controller would make segments before it takes the next line. With more, it would not send the next block
    // yet.
    streaming.most_ms = 10;
    let micrometres = |mm: f32| libm::roundf(mm * 1000.0) as i32;
    let (x, y) = (600 * 98, 600 * 600 / 10);
    // A row over a field of bumps, 0.7 mm high and 4 mm wide, with a point every 0.1 mm.
    let bump = |x: f32| 0.7 * libm::sinf(core::f32::consts::TAU / 8.0 * x);
    streaming.line(format_args!("F2000\n"));
    streaming.curve(row_relief_line, 600, |k| [x + 100 * k as i32, y, micrometres(bump(0.1 * k as f32))]);
    let (x, z) = (x + 100 * 600, micrometres(bump(60.0)));
    // A spiral with a pitch of 0.2 mm, from a radius of 2 mm outwards.
    streaming.line(format_args!("F9000\n"));
    let mut angle = 0.0_f32;
    let mut end = [x, y, z];
    streaming.curve(row_spiral_line, 600, |_| {
        let radius = 2.0 + 0.2 / core::f32::consts::TAU * angle;
        angle += 0.1 / radius;
        let (sine, cosine) = (libm::sinf(angle), libm::cosf(angle));
        end = [x + micrometres(radius * sine), y + micrometres(2.0 - radius * cosine), z];
        end
    });
    // A row over a relief at an angle to X and Y, with chords of 0.05 to 0.25 mm, as a CAM program divides a curve for
    // a tolerance.
    streaming.line(format_args!("F3000\n"));
    let ([x, y, z], mut along) = (end, 0.0_f32);
    streaming.curve(row_uneven_line, 600, |k| {
        along += 0.05 + 0.2 * ((k * 7919 % 64) as f32 / 64.0);
        let height = 0.5 * libm::sinf(along / 1.7) + 0.2 * libm::sinf(along / 0.6);
        [x + micrometres(0.8 * along), y + micrometres(0.6 * along), z + micrometres(height)]
    });
}

type Ring = Recorder<&'static mut [Page]>;

/// Records a received line as the control task does: first its text, then its line end, then the fact that more bytes
/// wait.
#[unsafe(no_mangle)]
#[inline(never)]
// unsafe because an exported name can clash with another; safe because this name is unique.
fn unit_recorded_line(recorder: &mut Ring, now: Instant, text: &[u8], controller: &Whole) {
    recorder.record_text(now, 0, text, controller);
    recorder.record(now, &Event::Line(LineByte { byte: b'\n', epoch: 0, damaged: false }), controller);
    recorder.more_waits();
}

/// Records a message to the step task.
#[unsafe(no_mangle)]
#[inline(never)]
// unsafe because an exported name can clash with another; safe because this name is unique.
fn unit_recorded_block(recorder: &mut Ring, message: &ToStep) {
    recorder.handed(message);
}

/// Records that the control task has run while the machine is at rest.
#[unsafe(no_mangle)]
#[inline(never)]
// unsafe because an exported name can clash with another; safe because this name is unique.
fn unit_recorded_rest(recorder: &mut Ring, now: Instant, controller: &Whole) {
    recorder.at_rest(now, controller);
}

/// Counts the cost of recording. There are so many lines, each at a different time, that they fill all pages and
/// overwrite the oldest lines. So some of them start a new page.
fn recording(controller: &Whole) {
    // SAFETY: unsafe because of the raw address; safe because it is in memory that nothing else uses, and pages are
    // plain numbers.
    let pages = unsafe { (boards::RING as *mut [Page; 8]).as_mut_unchecked() };
    let mut recorder = Recorder::begin(pages.as_mut_slice(), &Restart::POWER);
    row_recorded_line();
    for k in 0..400_u64 {
        unit_recorded_line(&mut recorder, Instant::from_ticks(k * 1_000), black_box(b"X12.345Y-6.789"), controller);
    }
    row_none();
    row_recorded_block();
    let block = ToStep::Block { steps_by_axis: [AxisSteps::default(); 3], directions: 0 };
    for _ in 0..10 {
        unit_recorded_block(&mut recorder, black_box(&block));
    }
    row_none();
    let now = Instant::from_ticks(1_000_000);
    recorder.at_rest(now, controller);
    row_recorded_rest();
    for _ in 0..10 {
        unit_recorded_rest(&mut recorder, now, controller);
    }
    row_none();
}

#[cortex_m_rt::entry]
fn main() -> ! {
    step_task();
    let motion = cortex_m::singleton!(: MaybeUninit<Planner> = MaybeUninit::uninit()).expect("main runs once");
    let blocks = cortex_m::singleton!(: MaybeUninit<MotionStorage<3, 150>> = MaybeUninit::uninit())
        .expect("main runs once")
        .write(MotionStorage::EMPTY)
        .lend();
    planning(motion.write(Motion::new(motion_settings(), blocks)));
    // SAFETY: unsafe because of the raw address; safe because it is in memory that nothing else uses.
    let far = unsafe {
        (boards::FAR_PLANNER as *mut (MaybeUninit<FarPlanner>, MaybeUninit<MotionStorage<3, 512>>)).as_mut_unchecked()
    };
    let (far, blocks) = (&mut far.0, far.1.write(MotionStorage::EMPTY).lend());
    let far = far.write(Motion::unconfigured(boards::PROFILE.step_clock_hz, blocks));
    far.configure(MotionSettings { jerk: PerAxis([10_000.0, 8_000.0, 10_000.0]), ..motion_settings() });
    planning_with_jerk(far);
    text_and_arcs();
    // SAFETY: unsafe because of the raw address; safe because it is in memory that nothing else uses.
    let place = unsafe {
        (boards::CONTROLLER as *mut (MaybeUninit<Whole>, MaybeUninit<Storage<3, 256, 6144>>)).as_mut_unchecked()
    };
    let (place, memory) = (&mut place.0, place.1.write(Storage::EMPTY).lend(&boards::PROFILE));
    let mut streaming = Streaming::start(place, memory);
    gentle_line(&mut streaming);
    tight_lines(&mut streaming);
    recording(streaming.controller);
    semihosting::process::exit(0)
}
