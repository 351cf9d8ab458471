//! A `Motion` with the small memory for single moves sends the same messages as a `Motion` with its own look-ahead.

use super::super::{MotionSettings, Speed, on_heap, on_heap_for_single_moves};
use super::rig::{settings, to};
use crate::messages::{Observed, ToStep};
use crate::motion::Motion;
use proptest::prelude::*;

/// Simulated step task: begins the segments that it gets, one after the other.
struct Taker {
    observed: Observed,
    given: u32,
}

impl Taker {
    /// Runs a motion until it is at rest, with a hold after `hold_after` messages. Returns all messages.
    fn run(&mut self, motion: &mut Motion<3>, hold_after: Option<usize>) -> Vec<ToStep> {
        let mut messages = Vec::new();
        motion.start();
        loop {
            if hold_after == Some(messages.len()) {
                motion.hold();
            }
            if let Some(message) = motion.next(&self.observed) {
                self.given += u32::from(matches!(message, ToStep::Segment(_)));
                self.observed.step_idle = false;
                messages.push(message);
            } else if self.observed.segments_begun != self.given {
                self.observed.segments_begun += 1;
            } else {
                self.observed.step_idle = true;
                motion.observe(&self.observed);
                assert!(motion.is_at_rest());
                return messages;
            }
        }
    }
}

/// A move to a height (mm) at a feed (mm/s). If it is held after some messages, the rest of it is discarded.
#[derive(Clone, Debug)]
struct Single {
    z: f64,
    feed: f32,
    hold_after: Option<usize>,
}

fn single() -> impl Strategy<Value = Single> {
    let z = prop_oneof![-120.0..120.0, -5.0..5.0, -0.02..0.02];
    (z, 0.5_f32..80.0, prop::option::weighted(0.2, 1_usize..60)).prop_map(|(z, feed, hold_after)| Single {
        z,
        feed,
        hold_after,
    })
}

proptest! {
    #[test]
    fn single_moves_need_no_look_ahead(
        moves in prop::collection::vec(single(), 1..8),
        jerk in prop_oneof![Just(0.0_f32), 200.0_f32..20_000.0],
        backlash in prop_oneof![Just(0.0_f32), 0.01_f32..0.5],
    ) {
        let mut whole_settings: MotionSettings<3> = settings(250.0, 60.0, 300.0);
        whole_settings.jerk.0[2] = jerk;
        whole_settings.backlash.0[2] = backlash;
        let mut whole = Motion::<3>::new(whole_settings, on_heap(2));
        let mut small = Motion::<3>::new(whole_settings, on_heap_for_single_moves());
        let mut lender = Motion::<3>::new(whole_settings, on_heap(2));
        let mut takers = [0, 1].map(|_| Taker { observed: Observed { step_idle: true, ..Observed::default() }, given: 0 });
        lender.lend_ring(&mut small);
        for Single { z, feed, hold_after } in moves {
            let one = to([1.0, 2.0, z], Speed::Feed(feed));
            let [by_whole, by_small] = [(&mut whole, 0), (&mut small, 1)].map(|(motion, taker)| {
                assert!(motion.line(&one));
                let messages = takers[taker].run(motion, hold_after);
                motion.discard();
                (messages, motion.machine_steps(), motion.lead(), motion.planned_position())
            });
            prop_assert_eq!(by_whole, by_small);
        }
        // The second `lend_ring` gives the ring of segments in flight back to `lender`. Both motions must keep their
        // positions.
        let before = (lender.machine_steps(), small.machine_steps());
        lender.lend_ring(&mut small);
        prop_assert_eq!(before, (lender.machine_steps(), small.machine_steps()));
    }
}
