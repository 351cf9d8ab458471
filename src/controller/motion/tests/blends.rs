//! Moves with a tolerance (G64 P) are held back, so that the corner after them can be cut off. Checks which blocks
//! are queued for such moves, and when.

use super::super::{Move, Observed, Speed, Tolerance};
use super::rig::{Rig, settings, to};

fn within(path: f32, target: [f64; 3], speed: Speed) -> Move<3> {
    Move { tolerance: Tolerance { path, merging: path }, ..to(target, speed) }
}

const FEED: Speed = Speed::Feed(50.0);

/// Runs a job and returns the steps of its blocks.
fn blocks(moves: &[Move<3>]) -> Vec<[i64; 3]> {
    let mut rig = Rig::<3, 64>::new(settings(100.0, 100.0, 500.0));
    rig.moves.extend(moves);
    rig.run();
    assert_eq!(rig.motion.planned_position(), moves[moves.len() - 1].target);
    rig.blocks.iter().map(|block| block.steps.map(i64::from)).collect()
}

#[test]
fn a_square_corner_is_cut_off() {
    let job = |path| blocks(&[within(path, [10.0, 0.0, 0.0], FEED), within(path, [10.0, 10.0, 0.0], FEED)]);
    assert_eq!(job(0.0), [[1000, 0, 0], [0, 1000, 0]]);
    // A tolerance of 0.05 mm shortens either move by 0.0707 mm, which is seven steps.
    assert_eq!(job(0.05), [[993, 0, 0], [7, 7, 0], [0, 993, 0]]);
    // The corner is cut off only as far as the acceleration requires, not as far as the large tolerance permits. Four
    // vertices replace it.
    let far = job(1.0);
    assert!(far.len() == 5 && far[0][0] > 900, "{far:?}");
}

#[test]
fn what_is_not_alike_or_turns_back_keeps_its_corner() {
    let first = within(0.05, [10.0, 0.0, 0.0], FEED);
    let up = [10.0, 10.0, 0.0];
    let whole = |second: Move<3>| blocks(&[first, second])[0] == [1000, 0, 0];
    assert!(!whole(within(0.05, up, Speed::Feed(20.0))), "another feed");
    assert!(whole(within(0.05, up, Speed::Rapid)) && whole(within(0.0, up, FEED)));
    assert!(whole(Move { power: 1, ..within(0.05, up, FEED) }));
    assert!(whole(Move { no_feed_override: true, ..within(0.05, up, FEED) }));
    assert!(whole(within(0.05, [0.0, 0.0, 0.0], FEED)) && whole(within(0.05, [5.0, 3.0, 0.0], FEED)));
}

#[test]
fn chords_become_fewer_within_the_tolerance() {
    let wave = |k: i32| within(0.02, [0.1 * f64::from(k), 0.006 * f64::from(k % 2), 0.0], FEED);
    let points: Vec<Move<3>> = (1..=200).map(wave).collect();
    assert!(blocks(&points).len() < 10);
    let lines: Vec<Move<3>> = points.iter().enumerate().map(|(k, m)| Move { line_number: k as u32, ..*m }).collect();
    assert!(blocks(&lines).len() >= 200, "reports tell N words");
    let exact: Vec<Move<3>> =
        points.iter().map(|m| Move { tolerance: Tolerance { path: 0.02, merging: 0.0 }, ..*m }).collect();
    assert!(blocks(&exact).len() >= 200, "Q0");
}

/// Moves that are held back count as queued: they determine the planned position, and their line numbers and power
/// are reported.
#[test]
fn what_is_held_back_is_part_of_the_queue() {
    let mut rig = Rig::<3, 64>::new(settings(100.0, 100.0, 500.0));
    let motion = &mut rig.motion;
    for (number, target) in [(7, [10.0, 0.0, 0.0]), (8, [10.0, 10.0, 0.0])] {
        assert!(motion.line(&Move { line_number: number, ..within(0.05, target, FEED) }));
    }
    assert!(motion.queued_blocks() == 0 && !motion.is_idle() && motion.free_blocks() < 64);
    assert_eq!(motion.running_power(), Some(1000));
    assert_eq!(motion.queued_line_numbers().collect::<Vec<_>>(), [0, 7, 8]);
    assert_eq!(motion.planned_position(), to([10.0, 10.0, 0.0], FEED).target);
    motion.discard();
    assert!(motion.is_idle() && motion.free_blocks() == 64);
    assert_eq!(motion.planned_position(), to([0.0; 3], FEED).target);
}

/// Moves stay held back while the queue is long enough, so that the corner after them can still be cut off.
#[test]
fn what_is_held_back_waits_while_the_queue_is_long_enough() {
    let mut rig = Rig::<3, 64>::new(settings(100.0, 100.0, 500.0));
    let motion = &mut rig.motion;
    for number in 1..=5_u32 {
        let target = [10.0 * f64::from(number), 0.0, 0.0];
        assert!(motion.line(&Move { line_number: number, ..within(0.05, target, FEED) }));
    }
    let queued = motion.queued_blocks();
    assert!(queued > 1);
    motion.start();
    assert!(motion.next(&Observed::default()).is_some());
    assert_eq!(motion.queued_blocks(), queued);
}
