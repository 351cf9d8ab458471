//! The reverse pass is put off until an entry is asked for that it could change: what is asked for is what it would be if all
//! were planned at once.

use super::super::block::{Block, CurveLoad, OverrideFactors};
use super::super::curvature::Bend;
use super::super::planner::Planner;
use proptest::prelude::*;

const AS_PROGRAMMED: OverrideFactors = OverrideFactors { feed: 1.0, rapid: 1.0 };

#[derive(Clone, Debug)]
enum Change {
    Append(Block<3>),
    /// A turn is found among the last blocks.
    Limit {
        nearest: usize,
        farthest: usize,
        speed2: f32,
        curve: CurveLoad,
    },
    /// The last block is replaced, as by a move that continues it.
    Replace(Block<3>),
    /// The first block has been run.
    Run,
    Overrides(f32),
}

/// What a path is made of.
#[derive(Clone, Copy, Debug)]
enum Path {
    Straight,
    /// Bends so gentle, of blocks so short, that none is steep.
    Gentle,
    Any,
}

fn bend(path: Path) -> BoxedStrategy<CurveLoad> {
    let bend = |speed2: std::ops::Range<f32>, across| {
        let bend = (speed2, across).prop_map(|(speed2, across)| CurveLoad::new(speed2, across));
        prop_oneof![Just(CurveLoad::NONE), bend].boxed()
    };
    match path {
        Path::Straight => Just(CurveLoad::NONE).boxed(),
        Path::Gentle => bend(500.0..4.0e3, 20.0_f32..500.0),
        Path::Any => bend(1.0..4.0e3, 20.0_f32..2000.0),
    }
}

fn block(path: Path) -> impl Strategy<Value = Block<3>> {
    let corner = prop_oneof![5 => Just(f32::INFINITY), 1 => Just(0.0), 2 => 0.0_f32..3000.0];
    let (length, acceleration, limit) = match path {
        Path::Any => (0.02_f32..2.0, 20.0_f32..2000.0, 5.0_f32..60.0),
        Path::Straight | Path::Gentle => (0.02_f32..0.12, 20.0_f32..500.0, 5.0_f32..14.0),
    };
    (length, acceleration, corner, limit, bend(path)).prop_map(|(length, acceleration, corner2, limit, curve)| Block {
        length,
        acceleration,
        programmed: 50.0,
        limit,
        corner2,
        curve,
        ..Block::EMPTY
    })
}

fn change(path: Path) -> impl Strategy<Value = Change> {
    let speed2 = prop_oneof![0.0_f32..100.0, 0.0_f32..3000.0];
    prop_oneof![
        8 => block(path).prop_map(Change::Append),
        6 => Just(Change::Run),
        2 => (0_usize..12, 0_usize..4, speed2, bend(path))
            .prop_map(|(nearest, more, speed2, curve)| Change::Limit { nearest, farthest: nearest + more, speed2, curve }),
        1 => block(path).prop_map(Change::Replace),
        1 => (0.5_f32..2.0).prop_map(Change::Overrides),
    ]
}

fn changes() -> impl Strategy<Value = Vec<Change>> {
    prop_oneof![Just(Path::Straight), Just(Path::Gentle), Just(Path::Any)]
        .prop_flat_map(|path| prop::collection::vec(change(path), 1..150))
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 3000, failure_persistence: None, ..ProptestConfig::default() })]
    #[test]
    fn what_is_asked_for_is_what_has_been_planned(changes in changes(), seldom in 1_usize..12) {
        let mut ring = Box::new(Planner::<3, [Block<3>; 24]>::new());
        let mut overrides = AS_PROGRAMMED;
        for (number, change) in changes.into_iter().enumerate() {
            let planner: &mut Planner<3, [Block<3>]> = &mut *ring;
            match change {
                Change::Append(block) => {
                    planner.push(block, overrides);
                    planner.plan();
                }
                Change::Limit { nearest, farthest, speed2, curve } => {
                    planner.limit(&Bend { nearest, farthest, speed2, curve, once: None });
                    planner.plan();
                }
                Change::Replace(block) if planner.len() > 1 => {
                    planner.take_back();
                    planner.push(block, overrides);
                    planner.plan();
                }
                Change::Replace(_) => {}
                Change::Run => {
                    planner.begin();
                    planner.settle();
                    planner.pop(true);
                }
                Change::Overrides(feed) => {
                    overrides = OverrideFactors { feed, rapid: 1.0 };
                    planner.replan(overrides, super::super::jerk::PathState { speed: 0.0, acceleration: 0.0 }, 0.0);
                }
            }
            // Not after each: the more has come since the last walk, the more it may have missed.
            if number % seldom == 0 {
                let planner: &mut Planner<3, [Block<3>]> = &mut *ring;
                planner.settle();
            }
            ring.assert_consistent();
        }
    }
}
