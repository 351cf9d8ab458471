//! Compares the protocol's state machine with a plain reference model, in random conversations. The test compares the
//! answers and error numbers, which lines wait, and the status report. It also checks that no step occurs where the
//! model forbids motion. A disagreement is shrunk to the shortest conversation and printed in the format of
//! `tests/conversations`.
//!
//! `OXMILL_MODEL=N` plays N conversations instead of the default number; `OXMILL_MODEL_SEED` sets the first seed.

mod action;
mod reference;
mod talk;

use action::Setup;
use proptest::test_runner::{Config, RngAlgorithm, TestCaseError, TestError, TestRng, TestRunner};
use std::cell::RefCell;
use talk::States;

/// All states that a report can show.
const STATES: [&str; 13] = [
    "Idle", "Run", "Jog", "Hold:0", "Hold:1", "Door:0", "Door:1", "Door:2", "Door:3", "Home", "Alarm", "Check", "Sleep",
];

fn number(name: &str, default: u64) -> u64 {
    std::env::var(name).map_or(default, |text| text.parse().unwrap_or_else(|_| panic!("{name} is a number")))
}

/// Plays conversations with a machine and with a reference model. `told` turns the setup of the machine into the
/// setup of the model. Some tests make the two setups differ on purpose. Returns how often each state was reported,
/// or the shortest conversation in which machine and model disagree.
fn search(count: u64, seed: u64, told: impl Fn(Setup) -> Setup) -> Result<States, String> {
    let config = Config {
        cases: u32::try_from(count).expect("a number of 32 bits"),
        max_shrink_iters: 20_000,
        failure_persistence: None,
        ..Config::default()
    };
    let mut bytes = [0; 32];
    bytes[..8].copy_from_slice(&seed.to_le_bytes());
    let rng = TestRng::from_seed(RngAlgorithm::ChaCha, &bytes);
    let all = RefCell::new(States::new());
    let found = TestRunner::new_with_rng(config, rng).run(&action::conversation(), |(setup, conversation)| {
        let states = talk::play(setup, told(setup), &conversation).map_err(TestCaseError::fail)?;
        for (state, count) in states {
            *all.borrow_mut().entry(state).or_default() += count;
        }
        Ok(())
    });
    match found {
        Ok(()) => Ok(all.into_inner()),
        Err(TestError::Fail(fault, _)) => Err(fault.message().to_string()),
        Err(TestError::Abort(reason)) => Err(reason.message().to_string()),
    }
}

#[test]
fn the_controller_answers_as_the_reference_does() {
    let (count, seed) = (number("OXMILL_MODEL", 4000), number("OXMILL_MODEL_SEED", 1));
    let states = search(count, seed, |setup| setup).unwrap_or_else(|fault| panic!("{fault}"));
    println!("{count} conversations of {} actions: {states:?}", states.values().sum::<u64>());
    let seldom: Vec<&str> = STATES.into_iter().filter(|state| states.get(*state).is_none_or(|n| *n < 20)).collect();
    assert!(count < 1000 || seldom.is_empty(), "hardly ever: {seldom:?}");
}

/// Returns the shortest conversation that shows a difference between a machine and a reference model with another
/// setup.
fn found(told: impl Fn(Setup) -> Setup) -> String {
    let fault = search(1000, 1, told).expect_err("a difference that shows");
    assert!(fault.matches("=> ?").count() <= 8, "not the shortest: {fault}");
    fault
}

#[test]
fn a_difference_is_found_and_shrunk() {
    let without_limits = found(|setup| Setup { hard_limits: false, ..setup });
    assert!(without_limits.contains("ALARM:1"), "{without_limits}");
    let without_soft_limits = found(|setup| Setup { soft_limits: false, ..setup });
    assert!(
        without_soft_limits.contains("ALARM:2") || without_soft_limits.contains("error:15"),
        "{without_soft_limits}"
    );
    let without_homing = found(|setup| Setup { homing: false, ..setup });
    assert!(without_homing.contains("error:5"), "{without_homing}");
    let without_tool_changes = found(|setup| Setup { tool_changes: false, ..setup });
    assert!(without_tool_changes.contains("[MSG:Tool change T"), "{without_tool_changes}");
    let without_watch = found(|setup| Setup { watch: false, ..setup });
    assert!(without_watch.contains("[MSG:The host is silent]"), "{without_watch}");
    let without_speed = found(|setup| Setup { at_speed: false, ..setup });
    assert!(without_speed.contains("[MSG:The spindle has lost its speed]"), "{without_speed}");
    let without_reactions = found(|setup| Setup { reactions: None, ..setup });
    let faults = ["pin limit", "pin estop", "pin fault", "host goes", "The host is silent"];
    assert!(faults.iter().any(|fault| without_reactions.contains(fault)), "{without_reactions}");
}
