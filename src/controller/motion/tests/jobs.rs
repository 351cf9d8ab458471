//! Whole jobs: times, speeds, sums.

use super::super::Speed;
use super::rig::{Rig, mm, settings, to};

#[test]
fn a_trapezoid_takes_the_time_of_theory() {
    let mut rig = Rig::<3, 16>::new(settings(250.0, 500.0, 100.0));
    rig.moves.push_back(to([5.0, 0.0, 0.0], Speed::Feed(20.0)));
    rig.run();
    assert_eq!(rig.position, [1250, 0, 0]);
    assert!((rig.seconds() - 0.45).abs() < 0.45e-3, "{}", rig.seconds());
    rig.check_limits();
}
