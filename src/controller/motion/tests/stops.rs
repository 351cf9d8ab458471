//! Holds, overrides, stops and an empty queue, each at any time.

use super::super::{QUEUED_TIME_MS, Speed};
use super::rig::{Rig, settings, to};
use crate::messages::{StepEvent, ToStep};
use proptest::prelude::*;

fn job<const B: usize>(accel: f32) -> Rig<3, B> {
    let mut rig = Rig::<3, B>::new(settings(80.0, 120.0, accel));
    for (k, corner) in
        [[6.0, 1.0, 0.0], [6.5, 5.0, 0.5], [6.51, 5.0, 0.5], [1.0, 5.1, 0.0], [0.0, 0.0, -2.0]].into_iter().enumerate()
    {
        rig.moves.push_back(to(corner, if k % 2 == 0 { Speed::Feed(40.0) } else { Speed::Rapid }));
    }
    // A curve of short straight moves.
    for k in 0..60 {
        let angle = f64::from(k) * 0.1;
        rig.moves.push_back(to([5.0 * angle.sin(), 5.0 - 5.0 * angle.cos(), -2.0], Speed::Feed(60.0)));
    }
    rig
}

#[test]
fn holds_at_every_segment_resume_to_the_same_step() {
    for accel in [50.0, 400.0, 5000.0] {
        let mut whole = job::<16>(accel);
        whole.run();
        whole.check_limits();
        let total = whole.segments;
        let stride = (total / 150).max(1);
        for at in (0..total).step_by(stride) {
            let mut rig = job::<16>(accel);
            rig.pump();
            rig.motion.start();
            while rig.stepper.segments_begun() < at as u32 {
                assert!(!rig.run_ticks(1));
            }
            rig.motion.hold();
            let called = rig.time;
            let from = rig.trace.len();
            assert!(rig.run_ticks(10_000_000));
            let observed = rig.observed();
            rig.motion.observe(&observed);
            assert!(rig.motion.is_at_rest() && rig.motion.is_held());
            // The machine stops after the queued segments, one more segment, and the braking ramp.
            let speed = rig.trace[from..].iter().map(|r| r.path / r.interval as f64).fold(0.0, f64::max);
            let ramp = speed * f64::from(rig.hz) / f64::from(accel) * 1.5;
            let took = (rig.time - called) as f64 / f64::from(rig.hz);
            assert!(took <= 0.025 + ramp, "held after {took} s, ramp {ramp} s");
            assert_eq!(rig.motion.machine_steps().0.map(i64::from), rig.position);
            rig.motion.resume();
            rig.run();
            rig.check_limits();
            assert_eq!(rig.position, whole.position);
            assert!(rig.events.is_empty());
        }
    }
}

#[test]
fn a_hold_begins_its_ramp_in_time() {
    let mut rig = Rig::<3, 16>::new(settings(80.0, 500.0, 100.0));
    rig.moves.push_back(to([400.0, 0.0, 0.0], Speed::Feed(100.0)));
    rig.pump();
    rig.motion.start();
    while rig.seconds() < 2.0 {
        rig.run_ticks(1);
    }
    rig.motion.hold();
    let called = rig.seconds();
    assert!(rig.run_ticks(10_000_000));
    let slower = rig
        .trace
        .iter()
        .find(|r| r.time as f64 / f64::from(rig.hz) > called && r.path / r.interval as f64 * f64::from(rig.hz) < 99.9)
        .unwrap();
    let latency = slower.time as f64 / f64::from(rig.hz) - called;
    assert!(latency <= 0.020 && latency > f64::from(QUEUED_TIME_MS) * 0.0005, "{latency}");
    rig.check_limits();
    // The machine comes to rest v²/2a = 50 mm after the braking began, not at the end of the move.
    let at = rig.position[0] as f64 / 80.0;
    let begun = slower.time as f64 / f64::from(rig.hz);
    let ideal = 50.0 + (begun - 1.0) * 100.0 + 50.0;
    assert!((at - ideal).abs() < 1.0, "{at} {ideal}");
    rig.motion.resume();
    rig.run();
    rig.check_limits();
    assert_eq!(rig.position, [32_000, 0, 0]);
}

#[test]
fn a_hold_acts_between_the_steps_of_a_crawl() {
    let mut rig = Rig::<3, 16>::new(settings(80.0, 500.0, 100.0));
    rig.moves.push_back(to([1.0, 0.0, 0.0], Speed::Feed(1.0 / 80.0 / 60.0)));
    rig.pump();
    rig.motion.start();
    while rig.seconds() < 100.0 {
        assert!(!rig.run_ticks(1));
    }
    rig.motion.hold();
    let called = rig.seconds();
    assert!(rig.run_ticks(100_000));
    assert!(rig.seconds() - called < 0.025, "{}", rig.seconds() - called);
    // At one step per minute, ticks of a sixteenth of a step are 3.75 s apart. So a tick is pending when the override
    // is set.
    rig.motion.resume();
    rig.run_ticks(10);
    rig.motion.set_overrides(100.0, 1.0);
    let called = rig.seconds();
    rig.run();
    assert_eq!(rig.position, [80, 0, 0]);
    let rest = 78.4 * 60.0 / 100.0;
    assert!((rig.seconds() - called - rest).abs() < 1.0, "{}", rig.seconds() - called);
}

#[test]
fn discarding_after_a_hold_keeps_the_position() {
    let mut rig = job::<16>(200.0);
    rig.pump();
    rig.motion.start();
    rig.run_ticks(3000);
    rig.motion.discard();
    assert!(rig.motion.queued_blocks() > 0, "ignored in motion");
    rig.motion.hold();
    assert!(rig.run_ticks(1_000_000));
    rig.moves.clear();
    rig.motion.discard();
    let observed = rig.observed();
    rig.motion.observe(&observed);
    assert!(rig.motion.is_idle());
    assert_eq!(rig.motion.machine_steps().0.map(i64::from), rig.position);
    assert_eq!(rig.motion.planned_position(), rig.motion.machine_position());
    rig.moves.push_back(to([2.0, 1.0, 3.0], Speed::Rapid));
    rig.run();
    assert_eq!(rig.position, [160, 80, 240]);
}

#[test]
fn a_hold_at_rest_waits_for_resume() {
    let mut rig = job::<16>(200.0);
    rig.pump();
    rig.motion.hold();
    rig.motion.start();
    assert!(rig.run_ticks(10));
    assert_eq!(rig.time, 0);
    rig.motion.resume();
    rig.run();
    assert!(rig.time > 0);
}

#[test]
fn an_empty_queue_stops_and_says_so() {
    for after in [1, 100, 1000, 3000, 7000] {
        let mut rig = job::<16>(200.0);
        rig.pump();
        rig.motion.start();
        assert!(!rig.run_ticks(after));
        rig.feeding = false;
        let begun = rig.seconds();
        let rested = rig.run_ticks(1_000_000);
        assert!(rested && rig.seconds() - begun < 0.03);
        let [event @ StepEvent::Underrun { stops: 1, position }] = rig.events[..] else { panic!("{:?}", rig.events) };
        assert_eq!(position.0.map(i64::from), rig.position);
        // No axis steps before the `Resume` that `handle_stop` sends: until then the stepper discards all messages.
        rig.feeding = true;
        let held = rig.position;
        assert!(rig.run_ticks(1000));
        assert_eq!(rig.position, held);
        rig.flush();
        rig.moves.clear();
        rig.handle_stop(event);
        assert_eq!(rig.motion.machine_steps().0.map(i64::from), held);
        rig.moves.push_back(to([1.0, 1.0, 1.0], Speed::Rapid));
        rig.run();
        assert_eq!(rig.position, [80; 3]);
    }
}

#[test]
fn a_second_stop_keeps_the_gate_shut_for_the_first_resume() {
    let mut rig = job::<16>(200.0);
    rig.pump();
    rig.motion.start();
    rig.run_ticks(2000);
    let first = rig.stop();
    let StepEvent::Stopped { stops: 1, moving: true, .. } = first else { panic!("{first:?}") };
    rig.flush();
    rig.handle_stop(first);
    // The second stop comes while the `Resume` that answers the first one is still queued, followed by a move.
    rig.moves.clear();
    rig.moves.push_back(to([1.0, 1.0, 1.0], Speed::Rapid));
    rig.pump();
    rig.motion.start();
    let second = rig.stop();
    let StepEvent::Stopped { stops: 2, moving: false, .. } = second else { panic!("{second:?}") };
    let held = rig.position;
    assert!(rig.run_ticks(1000));
    assert_eq!(rig.position, held);
    rig.flush();
    rig.handle_stop(second);
    assert_eq!(rig.motion.machine_steps().0.map(i64::from), held);
    rig.moves.push_back(to([1.0, 1.0, 1.0], Speed::Rapid));
    rig.run();
    assert_eq!(rig.position, [80; 3]);
    // A Resume that belongs to an earlier stop changes nothing while no stop is in force.
    rig.queue.push_back(ToStep::Resume { stops: 1 });
    rig.moves.push_back(to([0.0, 1.0, 1.0], Speed::Rapid));
    rig.run();
    assert_eq!(rig.position, [0, 80, 80]);
}

#[test]
fn overrides_slow_down_and_speed_up_within_a_block() {
    let mut rig = Rig::<3, 16>::new(settings(80.0, 500.0, 200.0));
    rig.moves.push_back(to([400.0, 0.0, 0.0], Speed::Feed(50.0)));
    rig.pump();
    rig.motion.start();
    for (at, factor, speed) in [(1.0, 0.1, 5.0), (2.0, 2.0, 100.0), (3.0, 1.0, 50.0), (4.0, 0.5, 25.0)] {
        while rig.seconds() < at {
            rig.run_ticks(1);
        }
        rig.motion.set_overrides(factor, 1.0);
        // Waits until the queued segments have run (20 ms) and the speed has changed (at most 0.48 s at 200 mm/s²).
        while rig.seconds() < at + 0.6 {
            rig.run_ticks(1);
        }
        let last = rig.trace.last().unwrap();
        let seen = last.path / last.interval as f64 * f64::from(rig.hz);
        assert!((seen / speed - 1.0).abs() < 0.01, "{seen} instead of {speed}");
    }
    rig.run();
    rig.check_acceleration(false);
    assert_eq!(rig.position, [32_000, 0, 0]);
}

#[test]
fn overrides_reach_the_queued_blocks() {
    let mut rig = Rig::<3, 16>::new(settings(80.0, 500.0, 200.0));
    rig.motion.set_overrides(0.2, 1.0);
    rig.moves.push_back(to([20.0, 0.0, 0.0], Speed::Feed(50.0)));
    rig.moves.push_back(to([40.0, 0.0, 0.0], Speed::Feed(50.0)));
    rig.pump();
    rig.motion.set_overrides(1.0, 1.0);
    rig.run();
    let whole = 40.0 / 50.0 + 50.0 / 200.0;
    assert!((rig.seconds() / whole - 1.0).abs() < 1e-3, "{} of {whole}", rig.seconds());
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(150))]
    #[test]
    fn anything_may_come_at_any_time(
        events in prop::collection::vec((1_usize..3000, 0_u8..30), 1..40),
        accel in prop::sample::select(vec![20.0_f32, 200.0, 5000.0]),
    ) {
        let mut rig = job::<16>(accel);
        let mut whole = true;
        let mut ramped = true;
        rig.pump();
        rig.motion.start();
        for (ticks, what) in events {
            rig.run_ticks(ticks);
            match what {
                0 | 8..=13 => rig.motion.hold(),
                1 | 2 | 14..=20 => rig.motion.resume(),
                3 | 21..=23 => rig.motion.set_overrides(0.1, 0.25),
                4 | 24..=26 => rig.motion.set_overrides(2.0, 1.0),
                5 | 27..=29 => rig.motion.set_overrides(0.73, 0.5),
                6 => {
                    let event = rig.stop();
                    rig.flush();
                    rig.handle_stop(event);
                    whole = false;
                    ramped = false;
                }
                _ => {
                    whole &= rig.motion.queued_blocks() == 0;
                    rig.motion.discard();
                }
            }
            rig.motion.start();
        }
        rig.motion.resume();
        rig.motion.set_overrides(1.0, 1.0);
        rig.run();
        let events: Vec<_> = rig.events.iter().filter(|e| matches!(e, StepEvent::Underrun { .. })).collect();
        prop_assert!(events.is_empty());
        prop_assert_eq!(rig.motion.machine_steps().0.map(i64::from), rig.position);
        if ramped {
            rig.check_acceleration(true);
        }
        if whole {
            let mut undisturbed = job::<16>(accel);
            undisturbed.run();
            prop_assert_eq!(rig.position, undisturbed.position);
        }
    }
}

/// Runs a first move until no more than `milliseconds` of it are queued, then queues a second move. Returns whether the
/// second move followed without a rest.
fn second_move_when_left(milliseconds: f64) -> (Rig<3, 16>, bool) {
    let mut rig = Rig::<3, 16>::new(settings(2000.0, 500.0, 4000.0));
    rig.moves.push_back(to([1.0, 0.0, 0.0], Speed::Feed(50.0)));
    rig.pump();
    rig.motion.start();
    rig.pump();
    while f64::from(rig.motion.queued_us()) > milliseconds * 1000.0 {
        assert!(!rig.run_ticks(1));
        let observed = rig.observed();
        rig.motion.observe(&observed);
    }
    assert!(rig.motion.ends_at_rest() && !rig.observed().step_idle);
    rig.moves.push_back(to([2.0, 1.0, 0.0], Speed::Feed(50.0)));
    rig.pump();
    rig.motion.start();
    rig.pump();
    let follows = !rig.motion.ends_at_rest();
    (rig, follows)
}

#[test]
fn what_follows_a_rest_with_little_queued_waits_for_it() {
    for (left, wanted) in [(10.0, true), (3.0, true), (1.0, false), (0.5, false)] {
        let (mut rig, follows) = second_move_when_left(left);
        assert_eq!(follows, wanted, "{left} ms");
        let mut waits = !wanted;
        while waits {
            rig.tick();
            let observed = rig.observed();
            let message = rig.motion.next(&observed);
            assert_eq!(message.is_some(), observed.step_idle, "a message comes once the step task is at rest");
            waits = message.is_none();
            rig.queue.extend(message);
        }
        rig.run();
        assert_eq!(rig.position, [4000, 2000, 0]);
        assert!(rig.events.is_empty());
        rig.check_limits();
    }
}
