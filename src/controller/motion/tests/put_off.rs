//! The reverse pass is put off until an entry is asked for that it could change: what is asked for is what it would be if all
//! were planned at once.

use super::super::block::{Block, CurveLoad, OverrideFactors};
use super::super::curvature::Bend;
use super::super::jerk::PathState;
use super::super::planner::Planner;
use super::rig::planner;
use proptest::prelude::*;

const AS_PROGRAMMED: OverrideFactors = OverrideFactors { feed: 1.0, rapid: 1.0 };

type Queue = Planner<3>;

#[derive(Clone, Debug)]
enum Change {
    /// So many alike.
    Append(Block<3>, usize),
    /// A turn is found among the last blocks.
    Limit {
        nearest: usize,
        farthest: usize,
        speed2: f32,
        curve: CurveLoad,
    },
    /// The last block is replaced, as by a move that continues it.
    Replace(Block<3>),
    /// Blocks are run, as long as there are so many.
    Run(usize),
    /// One is left whose end had been planned before what came last: its last tick was waited for meanwhile.
    Leave,
    /// At a speed of the machine.
    Overrides(f32, f32),
    Clear,
    /// With a jerk limit, or without one, from now on.
    Configure(bool),
}

/// What a path is made of.
#[derive(Clone, Copy, Debug)]
enum Path {
    Straight,
    /// Bends so gentle, of blocks so short, that none is steep.
    Gentle,
    /// Straight as long as no turn is found, then of the tightest bends.
    Turning,
    Any,
}

/// The bend of a block.
fn curve(path: Path) -> BoxedStrategy<CurveLoad> {
    if matches!(path, Path::Turning) { Just(CurveLoad::NONE).boxed() } else { bend(path) }
}

/// The bend of a turn that is found.
fn bend(path: Path) -> BoxedStrategy<CurveLoad> {
    let bend = |speed2: std::ops::Range<f32>, across| {
        let bend = (speed2, across).prop_map(|(speed2, across)| CurveLoad::new(speed2, across));
        prop_oneof![Just(CurveLoad::NONE), bend].boxed()
    };
    match path {
        Path::Straight => Just(CurveLoad::NONE).boxed(),
        Path::Gentle => bend(500.0..4.0e3, 20.0_f32..500.0),
        Path::Turning => bend(1.0..60.0, 1.0_f32..500.0),
        Path::Any => bend(1.0..4.0e3, 20.0_f32..2000.0),
    }
}

fn block(path: Path) -> impl Strategy<Value = Block<3>> {
    let corner = prop_oneof![5 => Just(f32::INFINITY), 1 => Just(0.0), 2 => 0.0_f32..3000.0];
    let (length, acceleration, limit) = match path {
        Path::Any => (0.02_f32..2.0, 20.0_f32..2000.0, 5.0_f32..60.0),
        Path::Straight | Path::Gentle | Path::Turning => (0.02_f32..0.12, 20.0_f32..500.0, 5.0_f32..14.0),
    };
    let length = prop_oneof![8 => length, 1 => 1.0e-6_f32..1.0e-3];
    (length, acceleration, corner, limit, curve(path)).prop_map(|(length, acceleration, corner2, limit, curve)| Block {
        length,
        acceleration,
        programmed: 50.0,
        jerk: 1000.0,
        limit,
        corner2,
        curve,
        ..Block::EMPTY
    })
}

fn change(path: Path) -> impl Strategy<Value = Change> {
    let speed2 = prop_oneof![0.0_f32..100.0, 0.0_f32..3000.0, Just(f32::INFINITY)];
    let times = prop_oneof![3 => Just(1), 1 => 2_usize..12];
    prop_oneof![
        40 => (block(path), times).prop_map(|(block, times)| Change::Append(block, times)),
        30 => (1_usize..4).prop_map(Change::Run),
        10 => Just(Change::Leave),
        20 => (0_usize..12, 0_usize..8, speed2, bend(path))
            .prop_map(|(nearest, more, speed2, curve)| Change::Limit { nearest, farthest: nearest + more, speed2, curve }),
        6 => block(path).prop_map(Change::Replace),
        4 => (0.5_f32..2.0, prop_oneof![Just(0.0), 0.0_f32..60.0])
            .prop_map(|(feed, speed)| Change::Overrides(feed, speed)),
        1 => Just(Change::Clear),
        2 => prop::bool::ANY.prop_map(Change::Configure),
    ]
}

fn changes() -> impl Strategy<Value = Vec<Change>> {
    prop_oneof![Just(Path::Straight), Just(Path::Gentle), Just(Path::Turning), Just(Path::Any)]
        .prop_flat_map(|path| prop::collection::vec(change(path), 1..150))
}

/// With a jerk limit nothing is put off.
fn settle(queue: &mut Queue) {
    if !queue.jerk_limited {
        queue.settle();
    }
}

fn append(queue: &mut Queue, block: Block<3>, overrides: OverrideFactors) {
    queue.push(block, overrides);
    queue.plan();
}

fn limit(queue: &mut Queue, nearest: usize, farthest: usize, speed2: f32, curve: CurveLoad) {
    queue.limit(&Bend { nearest, farthest, speed2, curve, once: None });
    queue.plan();
}

fn run(queue: &mut Queue) {
    queue.begin();
    settle(queue);
    queue.pop(true);
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 3000, failure_persistence: None, ..ProptestConfig::default() })]
    #[test]
    fn what_is_asked_for_is_what_has_been_planned(changes in changes(), seldom in 1_usize..12) {
        let mut ring = planner(24);
        let mut overrides = AS_PROGRAMMED;
        for (number, change) in changes.into_iter().enumerate() {
            let queue: &mut Queue = &mut ring;
            match change {
                Change::Append(block, times) => (0..times).for_each(|_| append(queue, block, overrides)),
                Change::Limit { nearest, farthest, speed2, curve } => limit(queue, nearest, farthest, speed2, curve),
                Change::Replace(block) if queue.len() > 1 => {
                    queue.take_back();
                    append(queue, block, overrides);
                }
                Change::Replace(_) => {}
                Change::Run(times) => (0..times).for_each(|_| run(queue)),
                Change::Leave => {
                    queue.begin();
                    queue.pop(true);
                }
                Change::Overrides(feed, speed) => {
                    overrides = OverrideFactors { feed, rapid: 1.0 };
                    queue.replan(overrides, PathState { speed, acceleration: 0.0 }, 0.05);
                }
                Change::Clear => queue.clear(),
                Change::Configure(jerk_limited) => {
                    queue.jerk_limited = jerk_limited;
                    queue.clear();
                }
            }
            // Not after each: the more has come since the last walk, the more it may have missed.
            if number % seldom == 0 {
                settle(&mut ring);
            }
            ring.assert_consistent();
        }
    }
}

/// An entry at its cap by rounding only: in a bend, an exit that is a bit faster may leave an entry that is a bit slower.
#[test]
fn what_rounding_can_take_away_is_not_settled() {
    let bend = Block { length: 0.1, acceleration: 400.0, curve: CurveLoad::new(1000.0, 400.0), ..straight(1.0) };
    let up = |exit2: f32| f32::from_bits(exit2.to_bits() + 1);
    let mut exits = std::iter::successors(Some(1.0), |exit2| Some(up(*exit2)));
    let exit2 = exits.find(|exit2| bend.braking_entry2(up(*exit2)) < bend.braking_entry2(*exit2)).unwrap();
    let mut ring = planner(24);
    let queue: &mut Queue = &mut ring;
    append(queue, straight(1.0), AS_PROGRAMMED);
    append(queue, Block { corner2: bend.braking_entry2(exit2), ..bend }, AS_PROGRAMMED);
    append(queue, straight(exit2), AS_PROGRAMMED);
    queue.settle();
    append(queue, straight(up(exit2) - exit2), AS_PROGRAMMED);
    queue.settle();
    assert_eq!(queue.exit2(), bend.braking_entry2(up(exit2)));
}

/// A block that is braked in from a speed².
fn straight(speed2: f32) -> Block<3> {
    Block {
        length: 1.0,
        acceleration: speed2 / 2.0,
        programmed: 50.0,
        limit: 50.0,
        corner2: f32::INFINITY,
        ..Block::EMPTY
    }
}

/// Blocks, walked over or not, turn out to be in so tight a bend that a faster exit leaves less to brake with. Wherever
/// the ring begins.
#[test]
fn what_is_before_a_bend_that_gets_steep_is_not_settled() {
    for (begin, walked_over) in (0..48).map(|case| (case / 2, case % 2 == 0)) {
        let mut ring = planner(24);
        let queue: &mut Queue = &mut ring;
        for _ in 0..begin {
            append(queue, straight(1.0), AS_PROGRAMMED);
            run(queue);
        }
        append(queue, straight(100.0), AS_PROGRAMMED);
        append(queue, Block { corner2: 110.0, ..straight(50.0) }, AS_PROGRAMMED);
        append(queue, straight(100.0), AS_PROGRAMMED);
        if walked_over {
            queue.settle();
            assert_eq!(queue.exit2(), 110.0);
        }
        limit(queue, 0, 0, f32::INFINITY, CurveLoad::new(16.0, 1.0));
        queue.settle();
        assert_eq!(queue.exit2(), 110.0);
        append(queue, straight(16.0), AS_PROGRAMMED);
        queue.settle();
        assert_eq!(queue.exit2(), 66.5);
    }
}

/// Of the entries that a turn lowers the last one stays as it is, and what is settled counts on the one before it.
#[test]
fn what_counts_on_a_lowered_entry_is_lowered() {
    let mut ring = planner(24);
    let queue: &mut Queue = &mut ring;
    append(queue, straight(100.0), AS_PROGRAMMED);
    append(queue, Block { corner2: 110.0, ..straight(50.0) }, AS_PROGRAMMED);
    append(queue, straight(60.0), AS_PROGRAMMED);
    append(queue, straight(20.0), AS_PROGRAMMED);
    queue.settle();
    assert_eq!(queue.exit2(), 110.0);
    limit(queue, 0, 1, 30.0, CurveLoad::NONE);
    queue.settle();
    assert_eq!(queue.exit2(), 80.0);
}

/// What was settled before a jerk limit came is nothing to it.
#[test]
fn with_a_jerk_limit_nothing_is_settled() {
    let mut ring = planner(24);
    let queue: &mut Queue = &mut ring;
    append(queue, straight(100.0), AS_PROGRAMMED);
    append(queue, Block { corner2: 50.0, ..straight(100.0) }, AS_PROGRAMMED);
    append(queue, straight(100.0), AS_PROGRAMMED);
    queue.settle();
    queue.jerk_limited = true;
    queue.clear();
    let blocks = [(1.0, 0.0), (0.45, 400.0), (0.45, 49.0), (0.13, 42.25), (0.4, 400.0), (0.5, 1.0)];
    for (length, corner2) in blocks {
        append(queue, Block { length, corner2, acceleration: 1000.0, jerk: 1000.0, ..straight(1.0) }, AS_PROGRAMMED);
    }
    limit(queue, 1, 1, 36.0, CurveLoad::NONE);
    ring.assert_consistent();
    let queue: &Queue = &ring;
    assert_eq!(queue.block(1).unwrap().entry2, 49.0);
}

/// A block leaves between the turn that lowers the last ones and the walk for it: nothing behind the queue is walked over, where
/// blocks lie that have gone. What is left would seem to be braked for by them.
#[test]
fn what_has_been_lowered_moves_up_with_the_queue() {
    for begin in 0..24 {
        let mut ring = planner(24);
        let queue: &mut Queue = &mut ring;
        for _ in 0..24 + begin {
            append(queue, straight(1000.0), AS_PROGRAMMED);
            append(queue, straight(1000.0), AS_PROGRAMMED);
            run(queue);
            run(queue);
        }
        for corner2 in [f32::INFINITY, f32::INFINITY, 299.0, f32::INFINITY, f32::INFINITY] {
            append(queue, Block { corner2, ..straight(100.0) }, AS_PROGRAMMED);
        }
        queue.settle();
        limit(queue, 0, 1, f32::INFINITY, CurveLoad::new(410.0, 50.0));
        queue.begin();
        queue.pop(true);
        queue.settle();
        // Its own 100, and 197 of the two in the bend.
        assert!((296.0..298.0).contains(&queue.exit2()), "{} from {begin}", queue.exit2());
        ring.assert_consistent();
    }
}
