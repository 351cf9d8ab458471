//! Without a jerk limit, the reverse pass is postponed until the planner needs an entry speed that the pass could
//! change. These tests check that this speed is the same as if each block had been planned immediately.

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
    /// Appends this many equal blocks.
    Append(Block<3>, usize),
    /// Limits the last blocks from `nearest` to `farthest` (0: the newest), as if a new block had completed a bend.
    Limit {
        nearest: usize,
        farthest: usize,
        speed2: f32,
        curve: CurveLoad,
    },
    /// Replaces the last block, as happens when a move is joined to it.
    Replace(Block<3>),
    /// Removes this many blocks from the queue, one after the other, as if the machine ran them.
    Run(usize),
    /// Ends a block without running the postponed pass first. This happens if blocks are appended during the wait for
    /// its last tick.
    Leave,
    /// Sets a feed override (factor) while the machine moves at a speed (mm/s).
    Overrides(f32, f32),
    Clear,
    /// Switches the jerk limit on or off.
    Configure(bool),
}

/// The kind of bends in a generated path.
#[derive(Clone, Copy, Debug)]
enum Path {
    Straight,
    /// Gentle bends and short blocks, so that no block is steep (`Block::is_steep`): a higher exit speed never
    /// requires a lower entry speed.
    Gentle,
    /// Straight blocks when they are appended; `Change::Limit` then puts them on the tightest bends.
    Turning,
    Any,
}

/// Generates the bend on which an appended block lies.
fn curve(path: Path) -> BoxedStrategy<CurveLoad> {
    if matches!(path, Path::Turning) { Just(CurveLoad::NONE).boxed() } else { bend(path) }
}

/// Generates the bend of a `Change::Limit`.
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

/// Runs the postponed reverse pass. With a jerk limit no pass is postponed.
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
            // Run the postponed pass only after every few changes: the more changes a pass covers, the more errors it
            // can reveal.
            if number % seldom == 0 {
                settle(&mut ring);
            }
            ring.assert_consistent();
        }
    }
}

/// In a bend, rounding can lower the entry speed² by one bit when the exit speed² rises by one bit. Here the entry
/// speed² just reaches its cap. After such a rise of the exit speed², it would no longer reach the cap. So the entry
/// must not count as settled (final, whatever is appended).
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

/// Returns a straight block in which the machine can brake from `speed2` to rest.
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

/// A block lies in a tight bend, where a higher exit speed requires a lower entry speed. The bend is detected only
/// after the block was appended. The planned speeds must be the same whether or not a reverse pass processed the
/// block before that. They must not depend on the ring slot at which the queue begins.
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

/// A bend limits the entry speeds of the last two blocks. The entry of the last block is slow enough already, so only
/// the entry of the second-last block is lowered. An earlier entry, which counts as settled (final), depends on the
/// lowered one. So the earlier entry must be lowered, too.
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

/// Entries that were settled (final, whatever is appended) before the jerk limit was switched on have no effect
/// afterwards.
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

/// A bend limits the last blocks. Then a block leaves the queue before the next reverse pass. That pass must not
/// process the slots after the end of the queue: they hold old blocks, which would change the entries.
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
        // The speed² is the sum of 100 for the block itself and 197 for the two blocks in the bend.
        assert!((296.0..298.0).contains(&queue.exit2()), "{} from {begin}", queue.exit2());
        ring.assert_consistent();
    }
}
