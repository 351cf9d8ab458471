//! Compares the steps that are made with figures computed by hand, and with Bresenham's line.

use super::super::Speed;
use super::super::measure::steps_taken;
use super::super::stepper::Stepper;
use super::rig::{Rig, mm, settings, to};
use crate::messages::{AxisSteps, Segment, ToStep};
use proptest::prelude::*;

/// Runs one block at one AMASS level. Returns the step bits of each tick.
fn bits_of(steps: [u32; 3], level: u8) -> Vec<u8> {
    let most = *steps.iter().max().unwrap();
    let mut stepper = Stepper::<3>::new();
    stepper.load(ToStep::Block { steps_by_axis: steps.map(AxisSteps::on_steps), directions: 0 });
    let flags = Segment::FLAG_NEW_BLOCK | Segment::FLAG_LAST;
    let ticks = (most << level) as u16;
    stepper.load(ToStep::Segment(Segment { interval: 100 << 12, ramp: 0, ticks, power: 7, level, flags }));
    assert_eq!(stepper.tick().steps, 0, "no step at the tick that starts");
    let mut bits = Vec::new();
    loop {
        let tick = stepper.tick();
        bits.push(tick.steps);
        if tick.interval == 0 {
            assert!(stepper.is_idle() && !tick.underrun);
            assert_eq!(stepper.position().0, steps.map(|s| s as i32));
            return bits;
        }
    }
}

fn ticks_of(bits: &[u8], axis: usize) -> Vec<usize> {
    bits.iter().enumerate().filter(|(_, b)| *b >> axis & 1 != 0).map(|(tick, _)| tick + 1).collect()
}

#[test]
fn ten_and_three_step_where_the_figure_says() {
    let bits = bits_of([10, 3, 0], 0);
    assert_eq!(ticks_of(&bits, 0), (1..=10).collect::<Vec<_>>());
    assert_eq!(ticks_of(&bits, 1), [2, 6, 9]);
    assert!(ticks_of(&bits, 2).is_empty());
}

#[test]
fn nine_and_three_step_as_bresenham_does() {
    let bits = bits_of([9, 3, 0], 0);
    assert_eq!(ticks_of(&bits, 0), (1..=9).collect::<Vec<_>>());
    assert_eq!(ticks_of(&bits, 1), [2, 5, 8]);
}

/// Returns the ticks at which Y steps in Bresenham's line, in integers. `error` starts at 2·`dy` - `dx`, and Y steps
/// when it is above 0.
fn bresenham(dx: i64, dy: i64) -> Vec<usize> {
    let mut error = 2 * dy - dx;
    let mut at = Vec::new();
    for x in 1..=dx {
        if error > 0 {
            at.push(x as usize);
            error -= 2 * dx;
        }
        error += 2 * dy;
    }
    at
}

proptest! {
    #[test]
    fn level_0_is_bresenhams_line(x in 0_u32..3000, y in 0_u32..3000, z in 0_u32..3000) {
        prop_assume!(x.max(y).max(z) > 0);
        let steps = [x, y, z];
        let most = i64::from(x.max(y).max(z));
        let bits = bits_of(steps, 0);
        for axis in 0..3 {
            prop_assert_eq!(ticks_of(&bits, axis), bresenham(most, i64::from(steps[axis])));
        }
    }

    #[test]
    fn every_level_stays_within_half_a_step(x in 0_u32..3000, y in 0_u32..3000, z in 0_u32..3000, level in 0_u8..=4) {
        prop_assume!(x.max(y).max(z) > 0);
        let steps = [x, y, z];
        let most = i64::from(x.max(y).max(z));
        let mut taken = [0_i64; 3];
        for (tick, bits) in bits_of(steps, level).into_iter().enumerate() {
            let done = (tick as i64 + 1) * (16 >> level);
            for axis in 0..3 {
                taken[axis] += i64::from(bits >> axis & 1);
                // Checks |taken - steps·done / (16·most)| <= 1/2 in integers.
                let off = taken[axis] * 16 * most - i64::from(steps[axis]) * done;
                prop_assert!(off.abs() <= 8 * most);
                let threshold = most as u32 * 16;
                let known = steps_taken(steps[axis], threshold / 2 - 1, threshold, done as u32);
                prop_assert_eq!(taken[axis], i64::from(known));
            }
        }
    }

    #[test]
    fn any_chain_of_lines_ends_on_its_step(
        points in prop::collection::vec((-400_000_000_i64..400_000_000, -90_000_i64..90_000, -20_000_i64..20_000), 1..12),
        spm in 1.0_f32..400.0,
        feed in 1.0_f32..400.0,
    ) {
        let mut config = settings(spm, 300.0, 3000.0);
        config.steps_per_mm.0[1] = crate::units::StepsPerMm::new(spm * 3.7).unwrap();
        let mut rig = Rig::<3, 8>::new(config);
        let mut last = [0; 3];
        for (x, y, z) in points {
            last = [x / 4, y, z];
            let mut m = to([0.0; 3], Speed::Feed(feed));
            m.target = crate::axes::PerAxis(last.map(crate::units::Coordinate));
            rig.moves.push_back(m);
        }
        rig.run();
        for axis in 0..3 {
            let step = config.steps_per_mm.0[axis].steps(crate::units::Coordinate(last[axis]));
            prop_assert_eq!(rig.position[axis], i64::from(step));
        }
        prop_assert_eq!(rig.motion.machine_steps().0.map(i64::from), rig.position);
        prop_assert!(rig.events.is_empty());
        rig.check_limits();
    }
}

#[test]
fn lines_stay_on_their_ideal_at_every_tick() {
    let mut rig = Rig::<3, 32>::new(settings(80.0, 100.0, 500.0));
    for corner in [[10.0, 3.3, -1.2], [4.0, 9.0, 2.0], [4.01, 9.0, 2.0], [-7.7, -8.8, 0.1], [0.0, 0.0, 0.0]] {
        rig.moves.push_back(to(corner, Speed::Feed(60.0)));
    }
    rig.run();
    rig.check_limits();
    let mut position = [0_i64; 3];
    let mut from = [0_i64; 3];
    let mut path = 0.0;
    let mut block = 0;
    for record in &rig.trace {
        if record.block != block {
            (from, path, block) = (position, 0.0, record.block);
        }
        path += record.path;
        let facts = rig.blocks[block];
        for axis in 0..3 {
            let sign = if record.directions >> axis & 1 != 0 { -1 } else { 1 };
            position[axis] += sign * i64::from(record.steps >> axis & 1);
            let ideal = f64::from(facts.steps[axis]) * path / facts.length;
            let taken = ((position[axis] - from[axis]) * sign) as f64;
            assert!((taken - ideal).abs() <= 0.5 + 1e-6, "{taken} {ideal} at {record:?}");
        }
    }
    assert_eq!(position, [0; 3]);
}

#[test]
fn directions_are_out_one_interval_before_the_step() {
    let mut rig = Rig::<3, 32>::new(settings(80.0, 100.0, 500.0));
    for k in 0..40 {
        let there = f64::from(k % 2);
        rig.moves.push_back(to([there * 3.0, 0.3 * f64::from(k), -there], Speed::Rapid));
    }
    rig.run();
    // The rig counts positions with the direction levels of the previous tick, and compares them with the stepper's
    // counters after each tick.
    assert_eq!(rig.position, [240, 936, -80]);
    rig.check_limits();
}

#[test]
fn tiny_increments_add_up() {
    let mut rig = Rig::<3, 64>::new(settings(80.0, 100.0, 500.0));
    for k in 1..=200_000 {
        let mut m = to([0.0; 3], Speed::Feed(10.0));
        m.target.0[0] = crate::units::Coordinate(k * 10_000);
        rig.moves.push_back(m);
    }
    rig.run();
    assert_eq!(rig.position, [16_000, 0, 0]);
    // The moves take 20 s (200 mm at 10 mm/s), plus v/a for the ramps. Each move is too short for a step. If its length
    // were not carried over to the next block, the time would be shorter.
    assert!((rig.seconds() - 20.02).abs() < 0.02, "{}", rig.seconds());
    rig.check_limits();
}

#[test]
fn six_axes_step() {
    let three = settings(50.0, 100.0, 500.0);
    let config = super::super::MotionSettings::<6> {
        arrangement: three.arrangement,
        steps_per_mm: crate::axes::PerAxis::all(three.steps_per_mm.0[0]),
        max_rate: crate::axes::PerAxis::all(100.0),
        least_feed: 0.0,
        acceleration: crate::axes::PerAxis::all(500.0),
        jerk: crate::axes::PerAxis::all(0.0),
        backlash: crate::axes::PerAxis::all(0.0),
        junction_deviation: 0.01,
        curve_share: 1.0,
        arc_tolerance: 0.002,
        step_clock_hz: 84_000_000,
    };
    let mut rig = Rig::<6, 8>::new(config);
    rig.moves.push_back(to([1.0, -2.0, 3.0, -4.0, 5.0, -6.0], Speed::Rapid));
    rig.moves.push_back(to([1.0, -2.0, 3.0, -4.0, 5.0, 6.5], Speed::Rapid));
    rig.run();
    assert_eq!(rig.position, [50, -100, 150, -200, 250, 325]);
    assert_eq!(rig.motion.machine_position().0[5], mm(6.5));
}

#[test]
fn moves_beyond_a_block_are_cut() {
    // A move of 50 m at 10,000 steps/mm has 5·10^8 steps. That is too many to run here, so only the messages are
    // checked.
    let mut rig = Rig::<3, 4>::new(settings(10_000.0, 800.0, 5000.0));
    assert!(rig.motion.line(&to([-50_000.0, 1.0, 0.0], Speed::Rapid)));
    assert_eq!(rig.motion.free_blocks(), 0);
    assert!(!rig.motion.line(&to([0.0, 1.0, 0.0], Speed::Rapid)));
    assert_eq!(rig.motion.planned_position().0[0], mm(-50_000.0));
    rig.motion.start();
    let mut steps = [0_i64; 3];
    let mut observed = rig.observed();
    loop {
        match rig.motion.next(&observed) {
            None => break,
            Some(ToStep::Block { steps_by_axis, directions }) => {
                assert_eq!(directions & 1, 1);
                for axis in 0..3 {
                    assert!(steps_by_axis[axis].is_on_steps());
                    steps[axis] += i64::from(steps_by_axis[axis].steps());
                }
            }
            Some(ToStep::Segment(_)) => observed.segments_begun += 1,
            Some(_) => {}
        }
    }
    assert_eq!(steps, [500_000_000, 10_000, 0]);
    observed.step_idle = true;
    rig.motion.observe(&observed);
    assert!(rig.motion.is_idle());
    assert_eq!(rig.motion.machine_steps().0, [-500_000_000, 10_000, 0]);
}

#[test]
fn slow_feeds_are_exact() {
    for (spm, per_step) in [(80.0, 60.0), (1.0, 60.0), (10_000.0, 60.0), (250.0, 0.5), (250.0, 0.06), (250.0, 0.011)] {
        for hz in [25_000_000, 96_000_000] {
            let mut config = settings(spm, 800.0, 100.0);
            config.step_clock_hz = hz;
            let mut rig = Rig::<3, 4>::new(config);
            let length = 5.0 / f64::from(spm);
            rig.moves.push_back(to([length, 0.0, 0.0], Speed::Feed((1.0 / f64::from(spm) / per_step) as f32)));
            rig.run();
            assert_eq!(rig.position, [5, 0, 0]);
            let speed = length / (5.0 * per_step);
            let whole = 5.0 * per_step + speed / 100.0;
            assert!((rig.seconds() / whole - 1.0).abs() < 1e-5, "{} of {whole}", rig.seconds());
            rig.check_limits();
        }
    }
}

#[test]
fn a_step_that_rounding_makes_of_a_hairs_breadth_takes_its_time() {
    // The moves are 0.002 and 1.998 steps long in turn, and each makes one step. A step must not be made in the tiny
    // time that 0.002 steps take. All moves together must take the time for their total length.
    let mut rig = Rig::<3, 64>::new(settings(80.0, 100.0, 5000.0));
    for k in 0..800 {
        let x = f64::from(2 * k);
        rig.moves.push_back(to([(x + 0.499) / 80.0, 0.0, 0.0], Speed::Feed(10.0)));
        rig.moves.push_back(to([(x + 0.501) / 80.0, 0.0, 0.0], Speed::Feed(10.0)));
    }
    rig.run();
    assert_eq!(rig.position, [1599, 0, 0]);
    rig.check_limits();
    let whole = 1599.0 / 80.0 / 10.0;
    assert!((rig.seconds() / whole - 1.0).abs() < 0.005, "{} of {whole}", rig.seconds());
    let fastest = rig.trace.iter().map(|r| r.interval << r.level).min().unwrap();
    // At this feed a step takes 120,000 clock ticks on average; no step must take less than half of that.
    assert!(fastest >= 59_000, "{fastest}");
}
