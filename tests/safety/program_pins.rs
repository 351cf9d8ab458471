//! Digital outputs of programs (M62 to M65): they change at the right time, and are off whenever the machine is locked.

use super::bench::Bench;

const SETTINGS: &str = "$110=3000 $111=3000 $112=3000 $120=200 $121=200 $122=200";
/// Maximum time from the start of a motion to the output change that belongs to the motion, s. The controller changes
/// outputs only at its checks. So the delay is at most the interval between two checks, plus the simulator's time for a
/// check.
const LATE: f64 = 0.0015;

fn outputs(bench: &Bench) -> u8 {
    bench.mill.outputs().expect("outputs").digital
}

fn bench() -> Bench {
    Bench::new("", SETTINGS)
}

/// Waits until the outputs have the value `wanted` (bit 0: P0), at most 60 s.
fn wait_for(bench: &mut Bench, wanted: u8) {
    let begin = bench.seconds();
    while outputs(bench) != wanted {
        assert!(bench.seconds() < begin + 60.0, "{:b} and not {wanted:b}", outputs(bench));
        bench.wait(0.000_5);
    }
}

#[test]
fn some_change_at_once_and_others_with_the_next_motion() {
    let mut bench = bench();
    assert_eq!(bench.ask("M64 P0"), ["ok"]);
    assert_eq!(outputs(&bench), 0b1);
    for line in ["M62 P1", "M62 P2", "M63 P0"] {
        assert_eq!(bench.ask(line), ["ok"]);
    }
    bench.wait(1.0);
    assert_eq!(outputs(&bench), 0b1, "nothing has moved");
    assert_eq!(bench.ask("G1 X10 F600"), ["ok"]);
    assert_eq!(bench.ask("M63 P1 G1 Y10"), ["ok"]);
    bench.send("M65 P2\n");
    wait_for(&mut bench, 0b110);
    wait_for(&mut bench, 0b100);
    assert_eq!(bench.state(), "Run", "P1 was on in the first move only");
    wait_for(&mut bench, 0);
    bench.settle();
}

#[test]
fn an_output_waits_for_the_motion_before_it() {
    let settings = format!("{SETTINGS} $100=250 $101=250 $102=250");
    for (word, [before, behind]) in [("M64P1", [0, 2]), ("M65P1", [2, 0])] {
        for lines in [format!("{word}\nG1X10\n"), format!("G1X10{word}\n"), format!("{word}G4\nG1X10\n")] {
            let mut bench = Bench::new("", &settings);
            assert_eq!(bench.ask(if before == 0 { "M65 P1" } else { "M64 P1" }), ["ok"]);
            let begin = bench.seconds();
            bench.send(format!("G21G91F600\nG1X50\n{lines}M2\n"));
            while outputs(&bench) == before {
                assert!(bench.seconds() < begin + 60.0);
                bench.wait(0.001);
            }
            let after = bench.seconds() - begin;
            assert_eq!((outputs(&bench), bench.place()[0]), (behind, 12_500), "{lines} after {after} s");
            assert!((4.9..5.1).contains(&after), "{lines} after {after} s");
            bench.settle();
            assert_eq!(bench.place()[0], 15_000);
        }
    }
}

#[test]
fn held_motion_holds_an_output_off() {
    let mut bench = bench();
    bench.send("G21G91F600\nG1X50\nM64P1\nG1X10\n");
    bench.wait(2.0);
    bench.send("!");
    bench.wait(10.0);
    assert_eq!((outputs(&bench), bench.state().as_str()), (0, "Hold:0"));
    bench.send("~");
    bench.wait(1.0);
    assert_eq!(outputs(&bench), 0);
    bench.settle();
    assert_eq!(outputs(&bench), 2);
}

#[test]
fn a_change_rides_with_its_motion() {
    // M62 must switch the output exactly where the next move starts, at a corner and on a straight line. Without the
    // M62 the controller would join the moves of the straight line.
    for (name, lines, at) in [
        ("corner", vec!["G1 X10 F600", "M62 P0", "G1 Y10"], [2500, 0]),
        ("straight", vec!["G1 X10 F600", "M62 P0", "G1 X20"], [2500, 0]),
        ("short", vec!["G1 X10 F600", "G1 X10.02", "G1 X10.04", "M62 P0 G1 X10.06", "G1 X10.08", "G1 X15"], [2510, 0]),
        ("after an arc", vec!["G1 X10 F600", "G2 X20 Y0 I5", "M62 P0", "G1 X30"], [5000, 0]),
    ] {
        let mut bench = bench();
        for line in lines {
            bench.send(format!("{line}\n"));
        }
        while outputs(&bench) == 0 {
            bench.wait(0.000_2);
        }
        let place = bench.place();
        // Steps that the machine makes during the maximum delay, at 10 mm/s and 250 steps/mm, plus two.
        let most = (LATE * 10.0 * 250.0) as i32 + 2;
        for axis in 0..2 {
            let off = place[axis] - at[axis];
            assert!((-1..=most).contains(&off), "{name}: {place:?} and not {at:?}");
        }
        bench.settle();
    }
}

#[test]
fn more_changes_than_can_wait_come_in_their_order() {
    let mut bench = bench();
    let mut wanted = Vec::new();
    for number in 0..40 {
        let on = number % 2 == 0;
        bench.send(format!("M{} P1 G1 X{} F3000\n", if on { 62 } else { 63 }, number + 1));
        wanted.push(on);
    }
    let mut seen = Vec::new();
    for _ in 0..200_000 {
        bench.wait(0.000_5);
        let on = outputs(&bench) & 2 != 0;
        if seen.last() != Some(&on) && (on || !seen.is_empty()) {
            seen.push(on);
        }
        if seen.len() == wanted.len() {
            break;
        }
    }
    assert_eq!(seen, wanted);
    bench.settle();
}

#[test]
fn moves_that_lead_nowhere_stop_nothing() {
    let mut bench = bench();
    for _ in 0..30 {
        assert_eq!(bench.ask("M62 P0 G1 X0 F600"), ["ok"]);
        assert_eq!(bench.ask("M63 P0"), ["ok"]);
    }
    assert_eq!(bench.ask("M62 P3"), ["ok"]);
    bench.carry_out("G1 X1");
    assert_eq!(outputs(&bench), 0b1000);
}

#[test]
fn they_are_off_where_the_machine_is_locked() {
    for (what, end) in [
        ("reset", &[b"\x18".as_slice()][..]),
        ("emergency stop", &[]),
        ("sleep", &[b"$SLP\n"]),
        ("probe", &[b"G38.2 Z-1 F100\n"]),
    ] {
        let mut bench = bench();
        for line in ["M64 P0", "M64 P3", "M62 P1"] {
            assert_eq!(bench.ask(line), ["ok"]);
        }
        bench.wait(0.1);
        assert_eq!(outputs(&bench), 0b1001);
        if end.is_empty() {
            bench.pin("estop 1");
        }
        end.iter().for_each(|bytes| bench.send(bytes));
        bench.wait(3.0);
        assert_eq!(outputs(&bench), 0, "{what}: {}", bench.status());
        // The M62 that waited for a motion must have been dropped: the next motion must not switch P1 on.
        bench.pin("estop 0");
        bench.send("\x18");
        bench.wait(0.1);
        bench.send("$X\n");
        bench.wait(0.1);
        bench.read();
        bench.carry_out("G1 X1 F600");
        assert_eq!(outputs(&bench), 0, "{what}");
    }
}

#[test]
fn what_waits_is_forgotten_with_the_job() {
    let mut bench = bench();
    assert_eq!(bench.ask("M64 P2"), ["ok"]);
    for round in 0..50 {
        bench.send("G91 G1 X1 F600\nM62 P0\nG1 X1\nM62 P1\nG1 X1\n");
        bench.wait(0.01 + 0.01 * f64::from(round));
        bench.send("\x19");
        bench.settle();
        bench.read();
        let on = outputs(&bench);
        assert_eq!(on & 4, 4, "a soft stop leaves outputs as they are");
        bench.carry_out("G1 X1");
        assert_eq!(outputs(&bench), on, "round {round}");
        for line in ["M65 P0", "M65 P1"] {
            assert_eq!(bench.ask(line), ["ok"]);
        }
    }
    // The end of a program leaves the outputs as they are, and drops changes that are still waiting.
    assert_eq!(bench.ask("M62 P3"), ["ok"]);
    assert_eq!(bench.ask("M2").last().unwrap(), "ok");
    bench.carry_out("G1 X100 F600");
    assert_eq!(outputs(&bench), 0b100);
}

#[test]
fn a_hold_leaves_them_and_a_check_changes_none() {
    let mut bench = bench();
    assert_eq!(bench.ask("M64 P0"), ["ok"]);
    bench.send("G1 X10 F600\nM62 P1\nG1 X20\n");
    bench.wait(0.3);
    bench.send("!");
    bench.wait(2.0);
    assert_eq!(outputs(&bench), 0b1);
    bench.send("~");
    bench.settle();
    assert_eq!(outputs(&bench), 0b11);
    bench.read();
    assert_eq!(bench.ask("$C").last().unwrap(), "ok");
    for line in ["M65 P0", "M62 P2", "G1 X1", "M66 P0 L3 Q1"] {
        assert_eq!(bench.ask(line), ["ok"]);
    }
    assert_eq!(outputs(&bench), 0b11);
}
