//! Jerk-limited ramps, checked segment by segment without the step task.

use super::super::on_heap;
use super::super::{Motion, MotionSettings, Move, Speed};
use super::rig::{settings, to};
use crate::axes::PerAxis;
use crate::messages::{Observed, Segment, ToStep};
use proptest::prelude::*;

/// Speed, acceleration and their limits at the end of a segment.
#[derive(Clone, Copy, Debug)]
struct Point {
    time: f64,
    seconds: f64,
    speed: f64,
    acceleration: f64,
    /// Limits of the block: `bound` is the acceleration, mm/s²; `jerk` is in mm/s³; `nominal` is the speed, mm/s.
    bound: f64,
    jerk: f64,
    nominal: f64,
    /// Step size, mm.
    pitch: f64,
    /// Maximum speed at the entry of the block, mm/s.
    corner: f64,
    block: usize,
    last: bool,
    /// Length of the segment, mm.
    way: f64,
}

struct Course<const B: usize> {
    motion: Motion<3>,
    moves: std::vec::IntoIter<Move<3>>,
    next: Option<Move<3>>,
    observed: Observed,
    points: Vec<Point>,
    time: f64,
    blocks: usize,
    pub entries: Vec<f64>,
    fills: u32,
}

impl<const B: usize> Course<B> {
    fn new(settings: MotionSettings<3>, moves: Vec<Move<3>>) -> Self {
        let mut motion = Motion::new(settings, on_heap(B));
        motion.start();
        let mut moves = moves.into_iter();
        let next = moves.next();
        Self {
            motion,
            moves,
            next,
            observed: Observed::default(),
            points: Vec::new(),
            time: 0.0,
            blocks: 0,
            entries: Vec::new(),
            fills: 0,
        }
    }

    /// Queues at most `most` further moves, as long as the queue has room.
    fn fill(&mut self, most: usize) {
        for _ in 0..most {
            let Some(m) = &self.next else { break };
            if !self.motion.line(m) {
                break;
            }
            self.next = self.moves.next();
        }
        self.fills += 1;
        if self.fills % 64 == 1 && self.motion.queue.planner.jerk_limited {
            self.motion.queue.planner.assert_consistent();
        }
        self.motion.start();
    }

    /// Processes one message; returns `false` if there is none.
    fn step(&mut self) -> bool {
        let Some(message) = self.motion.next(&self.observed) else { return false };
        let ToStep::Segment(segment) = message else {
            if let ToStep::Block { .. } = message {
                self.blocks += 1;
                self.entries.push(f64::from(self.motion.source.motion.pace.speed / self.motion.source.running.scale));
            }
            return true;
        };
        self.observed.segments_begun += 1;
        self.observed.step_idle = segment.flags & Segment::FLAG_LAST != 0;
        let ticks = f64::from(segment.ticks);
        let clocks = f64::from(segment.interval) * ticks + f64::from(segment.ramp) * ticks * (ticks - 1.0) / 2.0;
        let seconds = clocks / 4096.0 / f64::from(self.motion.source.step_clock_hz());
        self.time += seconds;
        let run = &self.motion.source.running;
        let scale = f64::from(run.scale);
        let speed = f64::from(self.motion.source.motion.pace.speed) / if run.is_active() { scale } else { 1.0 };
        let old = self.points.last().filter(|p| p.block == self.blocks).copied();
        let motion: &Motion<3> = &self.motion;
        let first = motion.queue.planner.first();
        let (jerk, corner) = match (old, first) {
            (Some(old), _) => (old.jerk, old.corner),
            (None, Some(block)) => (f64::from(block.jerk), f64::from(block.max_entry2).sqrt()),
            _ => (1.0e10, 0.0),
        };
        if segment.flags & Segment::FLAG_WAIT != 0 {
            if let Some(p) = self.points.last_mut() {
                p.time = self.time;
                p.seconds += seconds;
            }
            return true;
        }
        self.points.push(Point {
            time: self.time,
            seconds,
            speed,
            acceleration: f64::from(self.motion.source.motion.acceleration),
            bound: f64::from(run.acceleration) / scale,
            jerk,
            nominal: f64::from(run.nominal2).sqrt() / scale,
            pitch: 16.0 / scale,
            corner,
            block: self.blocks,
            last: segment.flags & Segment::FLAG_LAST != 0,
            way: ticks * f64::from(16 >> segment.level) / scale,
        });
        true
    }

    fn run(&mut self) {
        loop {
            self.fill(usize::MAX);
            if !self.step() {
                assert!(self.next.is_none() && self.motion.queued_blocks() == 0);
                return;
            }
        }
    }

    fn faults(&self, overridden: bool) -> Vec<String> {
        let mut faults = Vec::new();
        for pair in self.points.windows(2) {
            let [a, b] = pair else { continue };
            let jerk = a.jerk.max(b.jerk);
            // Below this speed the machine can stop within about a step. There, changes of speed need not be smooth,
            // because they have no effect on the motor.
            let crawl = (2.25 * jerk * b.pitch * b.pitch).cbrt() * 1.3;
            if b.last && !a.last && a.speed > crawl && a.speed > 1.1 * (4.5 * jerk * b.way.powi(2)).cbrt() {
                // The machine is too fast to come to rest in the last segment with the permitted jerk.
                faults.push(format!("end {a:?}\n  {b:?}"));
            }
            if a.last || b.last {
                continue;
            }
            if !overridden
                && a.block != b.block
                && a.speed.powi(2) > (b.corner * 1.01).powi(2) + 0.5 * a.bound * a.pitch
            {
                faults.push(format!("corner {a:?}\n  {b:?}"));
            }
            if b.acceleration.abs() > b.bound * 1.01 {
                faults.push(format!("acceleration {a:?}\n  {b:?}"));
            }
            if !overridden && b.speed > b.nominal * 1.005 && a.block == b.block {
                faults.push(format!("nominal {a:?}\n  {b:?}"));
            }
            let seen = (b.acceleration - a.acceleration).abs();
            if b.speed > crawl
                && seen
                    > jerk * b.seconds * 1.05
                        + 0.01 * b.bound
                        + if a.block == b.block { 0.0 } else { (a.bound - b.bound).abs() }
            {
                faults.push(format!("jerk {} {a:?}\n  {b:?}", seen / b.seconds));
            }
        }
        faults
    }
}

fn machine(jerk: f32) -> MotionSettings<3> {
    let mut config = settings(80.0, 500.0, 500.0);
    config.jerk = PerAxis::all(jerk);
    config
}

fn line(length: f64, blocks: u32, feed: f32) -> Vec<Move<3>> {
    (1..=blocks).map(|k| to([length * f64::from(k) / f64::from(blocks), 0.0, 0.0], Speed::Feed(feed))).collect()
}

#[test]
fn blocks_do_not_show_in_a_ramp() {
    // The move of 1 mm is too short to reach the maximum acceleration, so it has four phases of constant jerk.
    for (length, feed, ideal) in [(50.0, 100.0, 0.75), (10.0, 200.0, 0.337_08), (1.0, 100.0, (32.0e-4_f64).cbrt())] {
        for blocks in [1, 7, 80, 500] {
            if blocks > 80 && length < 10.0 {
                continue;
            }
            let mut course = Course::<512>::new(machine(1.0e4), line(length, blocks, feed));
            course.run();
            assert!(
                (course.time / ideal - 1.0).abs() < 0.005 + 0.015 / length,
                "{blocks}: {} of {ideal} s",
                course.time
            );
            assert!(course.faults(false).is_empty(), "{:?}", course.faults(false));
        }
    }
}

/// Two blocks of a chain also move the slow Z axis, so they allow only 94 % of the acceleration. One lies in the middle
/// of the ramp up, the other in the middle of the ramp down. The two blocks make the whole motion at most 5 % longer.
#[test]
fn a_slow_axis_in_one_block_does_not_spoil_the_ramp() {
    let mut config = machine(5.0e3);
    config.acceleration.0[2] = 0.25;
    let moves = (1..=200).map(|k| {
        let z = if (14..=190).contains(&k) { 0.0004 } else { 0.0 };
        to([0.75 * f64::from(k), 0.0, z], Speed::Feed(100.0))
    });
    let mut course = Course::<512>::new(config, moves.collect());
    course.run();
    assert!(course.points.iter().any(|p| p.bound < 490.0), "no block is slow");
    assert!(course.time < 1.8 * 1.05, "{} s of 1.8", course.time);
    assert!(course.faults(false).is_empty(), "{:?}", course.faults(false));
}

/// The second block moves an axis whose jerk limit is a hundredth of the others'. The machine enters this block so
/// slowly that it can still come to rest at the end of the block.
#[test]
fn a_crawl_knows_the_jerk_of_the_next_block() {
    let mut config = machine(1.0e4);
    config.acceleration.0[1] = 50.0;
    config.jerk.0[1] = 100.0;
    for feed in [0.8, 1.0] {
        let moves = vec![to([1.0, 0.0, 0.0], Speed::Feed(feed)), to([1.0, 0.05, 0.0], Speed::Feed(feed))];
        config.junction_deviation = 1.0;
        let mut course = Course::<8>::new(config, moves);
        course.run();
        // The maximum speed v from which the machine can stop within the block follows from v·√(v / J) = 0.05 mm,
        // with the jerk limit J = 100 mm/s³.
        let most = (0.05_f64.powi(2) * 100.0).cbrt();
        assert!(course.entries[1] < most * 1.02, "{} of {most} mm/s", course.entries[1]);
        assert!(course.faults(false).is_empty(), "{:?}", course.faults(false));
    }
}

/// Generates long and short moves, chains of blocks with gentle bends, and curves; some pieces move Z in all or a few
/// blocks.
fn job() -> impl Strategy<Value = Vec<Move<3>>> {
    let piece = prop_oneof![
        (0_u32..360, 1_u32..4000, 1_u32..60).prop_map(|(turn, length, count)| (f64::from(turn), length, count, 0.0)),
        (0_u32..40, 1_u32..400, 1_u32..60).prop_map(|(turn, length, count)| (
            f64::from(turn) * 0.1,
            length,
            count,
            0.0
        )),
        (0_u32..40, 1_u32..100, 10_u32..200).prop_map(|(bend, length, count)| (
            0.0,
            length,
            count,
            f64::from(bend) * 0.1 - 2.0
        )),
    ];
    let leaning = prop::option::weighted(0.4, (1_u32..60, 1_u32..40, -40_i32..40));
    prop::collection::vec((piece, 1.0_f32..200.0, leaning), 1..10).prop_map(|pieces| {
        let (mut at, mut angle, mut moves) = ([0.0, 0.0, 0.0], 0.0_f64, Vec::new());
        for ((turn, length, count, bend), feed, leaning) in pieces {
            let length = f64::from(length) * 0.01;
            angle += turn;
            for k in 0..count {
                angle += bend;
                at[0] += length * angle.to_radians().cos();
                at[1] += length * angle.to_radians().sin();
                if let Some((from, many, slope)) = leaning
                    && (from..from + many).contains(&k)
                {
                    at[2] += length * f64::from(slope) * 0.001;
                }
                moves.push(to(at, Speed::Feed(feed)));
            }
        }
        moves
    })
}

/// Returns settings with different limits for each axis. `share` (0.3 to 1) reduces the acceleration and changes the
/// jerk of Y. `slow` (up to 0.1) reduces both for Z.
fn unequal(jerk: f32, share: f32, slow: f32) -> MotionSettings<3> {
    let mut config = machine(jerk);
    config.acceleration.0[1] *= share;
    config.jerk.0[1] *= 1.3 - share;
    config.acceleration.0[2] *= slow;
    config.jerk.0[2] *= slow;
    config
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 40, max_shrink_iters: 60, failure_persistence: None, ..ProptestConfig::default() })]
    #[test]
    fn disturbed(
        moves in job(), jerk in prop::sample::select(vec![500.0_f32, 5.0e3, 3.0e4, 1.0e6]), share in 0.3_f32..1.0,
        slow in 0.001_f32..0.1,
        events in prop::collection::vec((1_usize..600, 0_u8..8, 0_usize..6), 1..30),
    ) {
        let mut course = Course::<600>::new(unequal(jerk, share, slow), moves);
        course.fill(3);
        for (messages, what, moves) in events {
            course.motion.start();
            for _ in 0..messages {
                course.step();
                if moves > 0 && course.blocks.is_multiple_of(3) { course.fill(1); }
            }
            match what {
                0 | 1 => course.motion.hold(),
                2 | 3 => course.motion.resume(),
                4 => course.motion.set_overrides(0.1, 1.0),
                5 => course.motion.set_overrides(2.0, 1.0),
                6 => course.motion.set_overrides(0.7, 1.0),
                _ => course.fill(moves),
            }
            course.motion.queue.planner.assert_consistent();
        }
        course.motion.resume();
        course.run();
        let faults = course.faults(true);
        prop_assert!(faults.is_empty(), "{} faults\n{}", faults.len(), faults.iter().take(3).cloned().collect::<Vec<_>>().join("\n"));
    }

    #[test]
    fn courses(moves in job(), jerk in prop::sample::select(vec![500.0_f32, 5.0e3, 3.0e4, 1.0e6]),
        share in 0.3_f32..1.0, slow in 0.001_f32..0.1,
    ) {
        let mut course = Course::<600>::new(unequal(jerk, share, slow), moves);
        course.run();
        let faults = course.faults(false);
        prop_assert!(faults.is_empty(), "{} faults\n{}", faults.len(), faults.iter().take(3).cloned().collect::<Vec<_>>().join("\n"));
    }
}

/// The queue ends in a bend. The override is raised at any time, also while the machine brakes for the end. At the
/// higher speed the bend needs more of the acceleration, so less of it remains for braking. The machine must still
/// come to rest.
#[test]
fn an_override_raised_in_a_bend_leaves_the_braking() {
    for (jerk, share) in [(20_000.0, 0.5), (20_000.0, 0.7), (100_000.0, 0.7)] {
        let mut config = settings(80.0, 500.0, 500.0);
        config.jerk = PerAxis::all(jerk);
        let arc: Vec<Move<3>> = (1..=200)
            .map(|k| f64::from(k) * 0.005)
            .map(|t: f64| to([20.0 * t.sin(), 20.0 - 20.0 * t.cos(), 0.0], Speed::Feed(100.0)))
            .collect();
        for cut in (0..400).step_by(7) {
            let mut course = Course::<512>::new(config, arc.clone());
            course.fill(512);
            course.motion.set_overrides(share, 1.0);
            while course.points.len() < cut && course.step() {}
            course.motion.set_overrides(1.0, 1.0);
            while course.step() {}
            let [.., before, last] = &course.points[..] else { panic!("it moves") };
            assert!(last.last, "cut at {cut}: {last:?}");
            // The last segment of a ramp is one unit long. To come to rest in it at 500 mm/s², the machine must be
            // slower than 1 mm/s.
            assert!(before.speed < 1.0, "cut at {cut}, jerk {jerk}, override {share}: {before:?}, {last:?}");
        }
    }
}

/// A host sends the moves of a bend just in time, with only two decimals, and then stops sending. Because of the
/// rounding, the planner detects the bend late, over a long piece of the path. By then it has planned the stop at the
/// end of the queue with the full acceleration, although the bend needs a part of it. The machine must still stop
/// there.
#[test]
fn a_bend_that_is_seen_late_leaves_the_stop_at_the_end() {
    let rounded = |mm: f64| (mm * 100.0).round() / 100.0;
    let mut late = Vec::new();
    for (radius, chord) in [(2.0, 0.05), (5.0, 0.1), (20.0, 0.1)] {
        let whole = (radius / chord) as usize;
        for chords in (whole / 2..3 * whole).step_by(7) {
            for ahead in [whole / 4, whole / 3, whole / 2, whole * 3 / 4] {
                let mut moves = vec![to([20.0, 0.0, 0.0], Speed::Feed(100.0))];
                moves.extend((1..=chords).map(|k| k as f64 * chord / radius).map(|t: f64| {
                    let at = [20.0 + rounded(radius * t.sin()), rounded(radius * (1.0 - t.cos())), 0.0];
                    Move { digit: 0.01, ..to(at, Speed::Feed(100.0)) }
                }));
                let mut course = Course::<512>::new(settings(80.0, 500.0, 500.0), moves);
                course.fill(1);
                loop {
                    while course.motion.queued_blocks() < ahead && course.next.is_some() {
                        course.fill(1);
                    }
                    if !course.step() {
                        break;
                    }
                }
                let [.., before, last] = &course.points[..] else { panic!("it moves") };
                if before.speed * before.speed > 2.2 * before.bound * last.way {
                    late.push((radius, chords, ahead, before.speed));
                }
            }
        }
    }
    assert!(late.is_empty(), "{} of them at {late:?}", late.len());
}

/// A feed hold stops moves of decreasing feed, and the override is lowered while the machine brakes. The moves after
/// the stop must not exceed the new override.
#[test]
fn an_override_lowered_in_the_fall_of_a_hold_acts_on_what_follows() {
    let mut too_fast = Vec::new();
    for jerk in [0.0, 2.0e3, 5.0e3, 3.0e4] {
        for length in [0.5, 2.0, 6.0, 9.0, 14.0, 20.0] {
            for (late, hold_at) in (0..40).step_by(3).flat_map(|late| [0.3, 0.5, 0.6, 0.65, 0.7].map(|at| (late, at))) {
                let mut config = settings(80.0, 500.0, 500.0);
                config.jerk = PerAxis::all(jerk);
                let feeds = [100.0, 40.0, 20.0, 5.0];
                let mut at = 60.0 - length;
                let moves = feeds.map(|feed| {
                    at += length;
                    to([at, 0.0, 0.0], Speed::Feed(feed))
                });
                let mut course = Course::<16>::new(config, moves.to_vec());
                course.fill(16);
                while course.time < hold_at && course.step() {}
                course.motion.hold();
                for _ in 0..late {
                    course.step();
                }
                course.motion.set_overrides(0.5, 1.0);
                while course.step() {}
                let held = course.points.len();
                course.motion.resume();
                course.run();
                let fast =
                    course.points[held..].iter().filter(|p| p.speed > p.nominal * 1.005).map(|p| (p.speed, p.nominal));
                if let Some((speed, nominal)) = fast.max_by(|a, b| (a.0 / a.1).total_cmp(&(b.0 / b.1))) {
                    too_fast.push((jerk, length, hold_at, late, speed, nominal));
                }
            }
        }
    }
    assert!(too_fast.is_empty(), "{} of them, as {:?}", too_fast.len(), &too_fast[..too_fast.len().min(5)]);
}
