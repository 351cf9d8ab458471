//! Compares the step generator, tick by tick, with the definition of steps in `measure`.

use super::*;
use crate::messages::UNITS_PER_STEP;
use crate::motion::measure::tests::{defined, steps_by_axis};
use crate::motion::measure::{Measure, signed_add};
use proptest::prelude::*;

fn enter(stepper: &mut Stepper<3>, steps_by_axis: [AxisSteps; 3], directions: u8, units: u32, ticks: u32, level: u8) {
    stepper.load(ToStep::Block { steps_by_axis, directions });
    if units != 0 {
        stepper.load(ToStep::Reenter { units });
    }
    let flags = Segment::FLAG_NEW_BLOCK;
    let ticks = ticks as u16;
    stepper.load(ToStep::Segment(Segment { interval: 1 << 20, ramp: 0, ticks, power: 0, level, flags }));
    assert_eq!(stepper.tick().steps, 0);
}

fn signed(taken: i128, directions: u8, axis: usize) -> i32 {
    signed_add(0, taken as u32, directions >> axis & 1 != 0)
}

/// Executes the plain ticks of a block of `total` units in batches, and compares them with the same ticks executed one
/// by one.
fn compare_batches<const N: usize, const WORDS: usize>(
    mut single: Stepper<N>,
    total: u32,
    (level, ramp, start): (u8, i32, u32),
    part: &[usize],
    table: &[u32; WORDS],
) -> Result<(), TestCaseError> {
    let ticks = (total >> (MAX_LEVEL - level)).clamp(1, 60_000) as u16;
    let flags = Segment::FLAG_NEW_BLOCK | Segment::FLAG_LAST;
    single.load(ToStep::Segment(Segment { interval: 1 << 21, ramp, ticks, power: 0, level, flags }));
    single.begin_at(start);
    single.tick();
    let mut batch = single.clone();
    for room in part {
        let (mut words, mut moments) = ([9; 70], [9; 70]);
        let made = batch.plain_ticks(table, &mut words[..*room], &mut moments[..*room]);
        prop_assert_eq!(made, (*room).min(single.piece.plain_ticks as usize));
        for (word, at) in words.into_iter().zip(moments).take(made) {
            prop_assert_eq!(at, single.moment());
            let (least, greatest) = single.intervals();
            let tick = single.tick();
            prop_assert_eq!(word, table[usize::from(tick.steps)]);
            prop_assert!((least..=greatest + 1).contains(&tick.interval));
        }
        prop_assert_eq!(format!("{single:?}"), format!("{batch:?}"));
    }
    Ok(())
}

proptest! {
    /// Runs consecutive blocks. At every tick, each axis makes at most one step, and its countdown is in range. The
    /// position equals the definition and the sum of the pulses.
    #[test]
    fn ticks_step_along_true_chords(
        chords in prop::collection::vec((steps_by_axis(300), 0_u8..8), 1..4), level in 0_u8..=4,
    ) {
        let mut stepper: Stepper<3> = Stepper::new();
        let load = |stepper: &mut Stepper<3>, steps_by_axis: [AxisSteps; 3], directions| {
            stepper.load(ToStep::Block { steps_by_axis, directions });
            let ticks = (Measure::of(&steps_by_axis).total >> (MAX_LEVEL - level)) as u16;
            let flags = Segment::FLAG_NEW_BLOCK | Segment::FLAG_LAST;
            stepper.load(ToStep::Segment(Segment { interval: 1 << 20, ramp: 0, ticks, power: 0, level, flags }));
        };
        load(&mut stepper, chords[0].0, chords[0].1);
        prop_assert_eq!(stepper.tick().steps, 0);
        let (mut base, mut counted) = ([0; 3], [0; 3]);
        for (at, (steps_by_axis, directions)) in chords.iter().enumerate() {
            let total = Measure::of(steps_by_axis).total;
            let units_per_tick = 1 << (MAX_LEVEL - level);
            for units in (units_per_tick..=total).step_by(units_per_tick as usize) {
                if let (true, Some((next, directions))) = (units == total, chords.get(at + 1)) {
                    load(&mut stepper, *next, *directions);
                }
                let steps = stepper.tick().steps;
                for axis in 0..3 {
                    prop_assert!(stepper.left[axis] < stepper.threshold);
                    counted[axis] += signed(i128::from(steps >> axis & 1), *directions, axis);
                    let taken = defined(steps_by_axis[axis], total, units);
                    prop_assert_eq!(counted[axis], base[axis] + signed(taken, *directions, axis));
                }
                prop_assert_eq!(stepper.position().0, counted);
                if units % UNITS_PER_STEP == 0 {
                    prop_assert_eq!(defined(steps_by_axis[0], total, units), i128::from(units / UNITS_PER_STEP));
                }
            }
            for (axis, base) in base.iter_mut().enumerate() {
                *base += signed(i128::from(steps_by_axis[axis].steps()), *directions, axis);
            }
            prop_assert_eq!(counted, base);
        }
    }

    /// A batch equals its ticks executed one by one: the same steps, the same times, and the same state afterwards.
    #[test]
    fn a_batch_equals_its_ticks(
        steps_by_axis in steps_by_axis(3000), level in 0_u8..=4, ramp in -300_i32..300, part in prop::collection::vec(0_usize..70, 1..12),
        table in prop::array::uniform8(any::<u32>()), start in any::<u32>(),
    ) {
        let mut single: Stepper<3> = Stepper::new();
        single.load(ToStep::Block { steps_by_axis, directions: 5 });
        compare_batches(single, Measure::of(&steps_by_axis).total, (level, ramp, start), &part, &table)?;
    }

    /// Like `a_batch_equals_its_ticks`, with a fourth axis.
    #[test]
    fn a_batch_of_four_axes_equals_its_ticks(
        steps_by_axis in steps_by_axis(3000), rest in steps_by_axis(3000), level in 0_u8..=4, ramp in -300_i32..300,
        part in prop::collection::vec(0_usize..70, 1..12), table in prop::array::uniform16(any::<u32>()), start in any::<u32>(),
    ) {
        let ([x, y, z], [a, ..]) = (steps_by_axis, rest);
        let mut single: Stepper<4> = Stepper::new();
        single.load(ToStep::BlockRest { steps_by_axis: [a, AxisSteps::default(), AxisSteps::default()] });
        single.load(ToStep::Block { steps_by_axis, directions: 13 });
        compare_batches(single, Measure::of(&[x, y, z, a]).total, (level, ramp, start), &part, &table)?;
    }

    /// After a stop while ticks are generated ahead, the position includes only the ticks that were output.
    #[test]
    fn what_is_undone_is_not_counted(
        chords in prop::collection::vec((steps_by_axis(60), 0_u8..8), 1..4), done in 0_usize..300, ahead in 0_usize..80,
    ) {
        let mut stepper: Stepper<3> = Stepper::new();
        let mut waiting = chords.iter().peekable();
        let (mut out, mut undone, mut directions) = ([0; 3], [0; 3], 0);
        for at in 0..done + ahead {
            if stepper.has_room() && let Some((steps_by_axis, directions)) = waiting.next() {
                stepper.load(ToStep::Block { steps_by_axis: *steps_by_axis, directions: *directions });
                let ticks = (Measure::of(steps_by_axis).total >> MAX_LEVEL).max(1) as u16;
                let flags = Segment::FLAG_NEW_BLOCK | if waiting.peek().is_none() { Segment::FLAG_LAST } else { 0 };
                stepper.load(ToStep::Segment(Segment { interval: 1 << 20, ramp: 0, ticks, power: 0, level: 0, flags }));
            }
            let tick = stepper.tick();
            let net = if at < done { &mut out } else { &mut undone };
            for (axis, net) in net.iter_mut().enumerate() {
                *net += signed(i128::from(tick.steps >> axis & 1), directions, axis);
            }
            directions = tick.directions;
        }
        let StepEvent::Stopped { position, .. } = stepper.stop(undone) else { unreachable!() };
        prop_assert_eq!(position.0, out);
        prop_assert_eq!(stepper.position().0, out);
        // The next block begins at that position.
        stepper.load(ToStep::Resume { stops: 1 });
        enter(&mut stepper, [AxisSteps::on_steps(5); 3], 0, 0, 5, 0);
        for _ in 0..4 { stepper.tick(); }
        prop_assert_eq!(stepper.position().0, out.map(|place| place + 4));
    }

    /// If a block is re-entered part-way, the position counts only the steps after that point.
    #[test]
    fn the_position_needs_no_division(
        steps_by_axis in steps_by_axis(Measure::MOST_STEPS), line in any::<bool>(), way in 0.0..1.0_f64, back in 0_u8..8,
    ) {
        let steps_by_axis = if line { steps_by_axis.map(|axis_steps| AxisSteps::on_steps(axis_steps.steps() * 7)) } else { steps_by_axis };
        let total = Measure::of(&steps_by_axis).total;
        let units = (f64::from(total) * way) as u32;
        let mut stepper: Stepper<3> = Stepper::new();
        enter(&mut stepper, steps_by_axis, back, units, 9, 4);
        prop_assert_eq!(stepper.position(), PerAxis([0; 3]));
        stepper.tick();
        for (axis, axis_steps) in steps_by_axis.into_iter().enumerate() {
            let (before, after) = (defined(axis_steps, total, units), defined(axis_steps, total, units + 1));
            prop_assert_eq!(stepper.position().0[axis], signed(after - before, back, axis));
            let course = stepper.course(false);
            prop_assert_eq!(course.base[axis], -signed(before, back, axis));
            prop_assert_eq!(course.end[axis], signed(i128::from(axis_steps.steps()) - before, back, axis));
        }
    }

    /// A block is left part-way, another block is executed, and the first one is re-entered. The position at the end is
    /// the sum of both blocks' steps.
    #[test]
    fn a_detour_leads_back(steps_by_axis in steps_by_axis(300), way in 0.0..1.0_f64, back in 0_u8..8, detour in steps_by_axis(20)) {
        let total = Measure::of(&steps_by_axis).total;
        let units = ((f64::from(total) * way) as u32).max(1);
        let there = Measure::of(&detour).total;
        let mut stepper: Stepper<3> = Stepper::new();
        enter(&mut stepper, steps_by_axis, back, 0, units, 4);
        // Blocks are loaded ahead: the last tick of each one begins the next.
        let run_to_end = |stepper: &mut Stepper<3>| while stepper.piece.ticks() > 1 { stepper.tick(); };
        run_to_end(&mut stepper);
        stepper.load(ToStep::Block { steps_by_axis: detour, directions: 0 });
        let flags = Segment::FLAG_NEW_BLOCK;
        let segment = |units: u32| Segment { interval: 1 << 20, ramp: 0, ticks: units as u16, power: 0, level: 4, flags };
        stepper.load(ToStep::Segment(segment(there)));
        stepper.tick();
        let left: [i32; 3] = std::array::from_fn(|axis| signed(defined(steps_by_axis[axis], total, units), back, axis));
        prop_assert_eq!(stepper.position().0, left);
        run_to_end(&mut stepper);
        stepper.load(ToStep::Block { steps_by_axis, directions: back });
        stepper.load(ToStep::Reenter { units });
        stepper.load(ToStep::Segment(segment((total - units).max(1))));
        stepper.tick();
        run_to_end(&mut stepper);
        stepper.tick();
        for axis in 0..3 {
            let whole = signed(i128::from(steps_by_axis[axis].steps()), back, axis) + detour[axis].steps() as i32;
            prop_assert_eq!(stepper.position().0[axis], whole);
        }
    }
}
