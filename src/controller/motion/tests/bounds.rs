//! Checks `Planner::bounds_within`, which returns the bounds for braking over a distance. Their acceleration must not
//! exceed that of any block within the distance.

use super::super::block::{Block, CurveLoad, OverrideFactors};
use super::super::planner::Planner;
use super::rig::planner;
use proptest::prelude::*;

/// Generates a block with a random length and acceleration, and with or without a bend.
fn block() -> impl Strategy<Value = Block<3>> {
    let bend = prop::option::of((1.0_f32..4.0e4, 20.0_f32..2000.0));
    (0.05_f32..3.0, 20.0_f32..2000.0, bend).prop_map(|(length, acceleration, bend)| Block {
        length,
        acceleration,
        programmed: 100.0,
        limit: 100.0,
        corner2: 1.0e4,
        jerk: 1.0e4,
        curve: bend.map_or(CurveLoad::NONE, |(speed2, across)| CurveLoad::new(speed2, across)),
        ..Block::EMPTY
    })
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 400, failure_persistence: None, ..ProptestConfig::default() })]
    /// The planner summarises the bounds of groups of blocks. With 64 slots a group has two blocks, so some bounds
    /// come from these summaries.
    #[test]
    fn no_block_on_the_way_leaves_less_than_the_bound(
        blocks in prop::collection::vec(block(), 2..64), begun in 0.0_f32..1.0, reach in 0.0_f32..1.2, speed2 in 0.0_f32..4.0e4,
    ) {
        let mut ring = planner(64);
        let planner: &mut Planner<3> = &mut ring;
        planner.jerk_limited = true;
        for block in &blocks {
            planner.push(*block, OverrideFactors { feed: 1.0, rapid: 1.0 });
        }
        planner.plan();
        let left = begun * blocks[0].length;
        let distance = reach * (left + blocks[1..].iter().map(|block| block.length).sum::<f32>());
        let bound = planner.bounds_within(distance, left, speed2).acceleration;
        let mut begins = left - blocks[0].length;
        for (place, block) in blocks.iter().enumerate() {
            if place > 0 && begins >= distance * 0.999 {
                break;
            }
            let own = block.acceleration_at(speed2);
            prop_assert!(bound <= own * 1.0001, "{bound} mm/s², but {own} in block {place} at speed² {speed2}: {block:?}");
            begins += block.length;
        }
    }
}

/// If a wide bend of a slow axis follows a narrow bend of a fast axis, `bounds_within` returns no more than the
/// acceleration limit of the slow axis.
#[test]
fn a_wider_bend_of_a_slower_axis_counts() {
    let mut ring = planner(64);
    let planner: &mut Planner<3> = &mut ring;
    planner.jerk_limited = true;
    for curve in [CurveLoad::new(100.0, 1024.0), CurveLoad::new(112.0, 64.0)] {
        let block = Block {
            length: 1.0,
            acceleration: 512.0,
            programmed: 10.0,
            limit: 10.0,
            corner2: 100.0,
            curve,
            ..Block::EMPTY
        };
        planner.push(block, OverrideFactors { feed: 1.0, rapid: 1.0 });
    }
    planner.plan();
    let bound = planner.bounds_within(1.5, 1.0, 100.0).acceleration;
    assert!(bound <= 64.0, "{bound} mm/s² where 64 can be had");
}
