//! Instruction counts of the step task's work, as a program on QEMU.
//!
//! TIMER1 counts 25 MHz of virtual time; with `-icount shift=10` an instruction takes 1024 ns, 25.6 of its ticks, so the
//! difference of two readings is a number of instructions, and exact. Cycles are another matter: this says nothing of
//! flash wait states or pipeline. The table goes to standard error, as standard output carries the defmt log.
#![no_std]
#![no_main]

use core::hint::black_box;
use mps2_pac::Timer1;
use oxmill_controller::Stepper;
use oxmill_controller::messages::{SEGMENTS_DEPTH, Segment, ToStep};
use oxmill_on_target as _;
use rtic_sync::channel::{Channel, Receiver};

/// Time of an instruction under `-icount shift=10`, and of a tick of the timer.
const INSTRUCTION_NS: u32 = 1024;
const TICK_NS: u32 = 40;

struct Stopwatch {
    timer: Timer1,
    overhead: u32,
}

impl Stopwatch {
    fn count(&self, work: impl FnOnce()) -> u32 {
        let from = self.timer.value();
        work();
        let ticks = from.wrapping_sub(self.timer.value());
        ((ticks * TICK_NS + INSTRUCTION_NS / 2) / INSTRUCTION_NS).saturating_sub(self.overhead)
    }
}

/// What the step task does at a tick beside registers: the tick, and fetching up to two messages ahead.
#[inline(never)]
fn tick_and_fetch(stepper: &mut Stepper<3>, segments: &mut Receiver<'static, ToStep, SEGMENTS_DEPTH>) -> u8 {
    let tick = stepper.tick();
    black_box((tick.interval, tick.directions, tick.power));
    for _ in 0..2 {
        if !stepper.wants() {
            break;
        }
        let Ok(message) = segments.try_recv() else { break };
        stepper.load(message);
    }
    tick.steps
}

#[cortex_m_rt::entry]
fn main() -> ! {
    // SAFETY: unsafe because nobody guards the peripherals; safe because this program is alone.
    let mut device = unsafe { mps2_pac::Peripherals::steal() };
    device.TIMER1.set_reload(u32::MAX);
    device.TIMER1.set_value(u32::MAX);
    device.TIMER1.set_control(Timer1::ENABLE);
    let mut stopwatch = Stopwatch { timer: device.TIMER1, overhead: 0 };
    stopwatch.overhead = stopwatch.count(|| {});

    let (mut send, mut receive) =
        cortex_m::singleton!(: Channel<ToStep, SEGMENTS_DEPTH> = Channel::new()).expect("main runs once").split();
    semihosting::eprintln!("instructions of a tick with receive, release build");
    for (name, steps) in [("three axes", [1000, 1000, 1000]), ("one axis", [1000, 0, 0]), ("mixed", [1000, 333, 77])] {
        let mut stepper: Stepper<3> = Stepper::new();
        let (mut sum, mut ticks, mut worst, mut steady) = (0, 0, 0, u32::MAX);
        for segment in 0..12_u8 {
            // A new block with a reversal each time, as in the worst case.
            let block = ToStep::Block { steps, directions: segment & 1 };
            let flags = Segment::FLAG_NEW_BLOCK | if segment == 11 { Segment::FLAG_LAST } else { 0 };
            let body = Segment { interval: 1000 << 12, ramp: -77, ticks: 40, power: 5, level: 0, flags };
            let _ = send.try_send(block);
            let _ = send.try_send(ToStep::Segment(body));
        }
        while stepper.wants()
            && let Ok(message) = receive.try_recv()
        {
            stepper.load(message);
        }
        while !stepper.is_idle() {
            let n = stopwatch.count(|| {
                black_box(tick_and_fetch(black_box(&mut stepper), &mut receive));
            });
            sum += n;
            ticks += 1;
            worst = worst.max(n);
            steady = steady.min(n);
        }
        semihosting::eprintln!("{name:<12} least {steady:>4}  mean {:>4}  worst {worst:>4}", sum / ticks);
    }
    semihosting::process::exit(0)
}
