//! While a subroutine, loop or condition is still open, the host that sends it stays the active one. If another host
//! became active, for example by `?`, the rest of the block would be executed as separate lines.

use oxmill_simulator::{Options, Simulator};

#[test]
fn no_other_host_takes_over_within_a_block() {
    let mut mill = Simulator::new(Options::default());
    let mut free_behind = |line: &str| {
        mill.send(format!("{line}\n"));
        mill.run_until_idle();
        mill.take_output();
        (mill.controller().is_idle(), mill.controller().is_free())
    };
    assert_eq!(free_behind("G21"), (true, true));
    assert_eq!(free_behind("o1 sub"), (true, false));
    assert_eq!(free_behind("G1 X1 F100"), (true, false));
    assert_eq!(free_behind("o1 endsub"), (true, true), "a subroutine that is kept is not open");
    assert_eq!(free_behind("o2 if [0]"), (true, false));
    assert_eq!(free_behind("M2"), (true, false), "it is left out like the lines before it");
    assert_eq!(free_behind("\x18"), (true, true), "a reset ends it");
    assert_eq!(free_behind("o3 if [1]"), (true, false));
    assert_eq!(free_behind("M2"), (true, true), "the end of the program ends it");
}
