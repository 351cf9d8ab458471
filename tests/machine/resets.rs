//! A reset at any time during a job: the machine locks, can be unlocked, and moves.

use oxmill_simulator::{Options, Simulator};
use std::time::Duration;

#[test]
fn after_a_reset_at_any_moment_the_machine_moves() {
    for microseconds in (20_000_u64..50_000).step_by(250) {
        let mut mill = Simulator::new(Options::default());
        let settings =
            "$0=1\n$100=40\n$110=6000\n$120=1500\n$101=250\n$111=1000\n$121=1500\n$102=800\n$112=6000\n$122=500\n";
        for line in settings.lines() {
            mill.send(format!("{line}\n"));
            assert!(mill.run_until_idle());
        }
        mill.take_output();
        mill.send(
            "G90\nG1 Z-0.003 F100\nX-0.027\nG0 X-0.001 Y-0.000\nG1 Z-0.001 F6000\nG1 Z-0.012 F6000\nG1 Z0.161 F3000\n",
        );
        mill.run_for(Duration::from_micros(microseconds));
        mill.send("\x18");
        mill.run_for(Duration::from_millis(300));
        let said = mill.take_output();
        mill.send("$X\nG90 G0 X3\n");
        mill.run_for(Duration::from_secs(3));
        assert!(mill.is_idle(), "after {microseconds} us: {said}{}", mill.take_output());
        assert!(
            (mill.machine_position()[0] - 3.0).abs() < 1e-9,
            "after {microseconds} us: {said}{}",
            mill.take_output()
        );
    }
}
