//! A host that does not count characters can send more lines than the machine has room for. In a state that only a
//! reset ends, the reset must act all the same, however many lines the host has sent before.

use super::bench::Bench;
use oxmill_fuzz::session::{MACHINE, SETTINGS};

/// Lines that are sent so often that the machine's line queue and the buffers of the link cannot hold them all.
const LINES: &str = "G1 X1 F100\nG4 P0.1\nM3 S100\n(a remark that is rather long) $X\n";

/// Ways to a state that only a reset ends: name, settings, and lines that lead there.
const WAYS: [(&str, &str, &str); 5] = [
    ("soft limit", "$20=1 $22=1 $H", "G53 G0 X-500\n"),
    ("hard limit", "$21=1", "G91 G1 X-1000 F3000\n"),
    ("hard limit, lines in work", "$21=1", ""),
    ("emergency stop", "", "G91 G1 X-1 F600\n"),
    ("sleep", "", "$SLP\n"),
];

fn locked(way: usize) -> (Bench, String) {
    let (name, settings, lines) = WAYS[way];
    let mut bench = Bench::new(MACHINE, SETTINGS);
    for line in settings.split(' ').filter(|line| !line.is_empty()) {
        bench.ask(line);
        bench.settle();
    }
    bench.send(lines);
    bench.wait(0.2);
    match name {
        "hard limit" => bench.pin("limit x 1"),
        "hard limit, lines in work" => {
            // Motion, a dwell of 60 s and another move are in progress or queued.
            bench.send("G91 G1 X-1 F600\nG4 P60\nG1 X1\n");
            bench.wait(0.05);
            bench.pin("limit x 1");
        }
        "emergency stop" => bench.pin("estop 1"),
        _ => {}
    }
    bench.wait(1.0);
    (bench, name.into())
}

#[test]
fn a_reset_acts_behind_any_number_of_lines_where_it_is_all_that_helps() {
    for way in 0..WAYS.len() {
        for (lines, another_host, pieces) in [(20, false, 1 << 20), (1000, false, 7), (1000, true, 1 << 20)] {
            let (mut bench, name) = locked(way);
            let name = format!("{name}, {lines} lines, another host: {another_host}");
            let state = bench.state();
            assert!(["Alarm", "Sleep"].contains(&state.as_str()), "{name}: {state}");
            let before = bench.read();
            let text = [LINES.repeat(lines).as_bytes(), b"G1 X"].concat();
            let count = bench.place();
            for piece in text.chunks(pieces) {
                bench.send(piece);
                bench.wait(0.001);
            }
            if another_host {
                bench.mill.disconnect();
                bench.wait(0.1);
                bench.mill.connect();
                bench.send(&text);
                bench.wait(0.1);
            }
            bench.wait(0.1);
            assert_eq!(bench.state(), state, "{name}: asked behind them");
            bench.pin("limit x 0");
            bench.pin("estop 0");
            bench.wait(0.1);
            let said = bench.read();
            assert!(!said.iter().any(|line| line == "ok" || line.starts_with("error")), "{name}: {before:?} {said:?}");
            bench.send(b"\x182\n$X\n$G\n");
            bench.wait(0.5);
            let said = bench.read();
            let greeting = said
                .iter()
                .position(|line| line.starts_with("Grbl 1.1h"))
                .unwrap_or_else(|| panic!("{name}: {said:?}"));
            let answers: Vec<_> =
                said[greeting..].iter().filter(|line| *line == "ok" || line.starts_with("error")).collect();
            // The first line after the reset, `2`, is answered by `error:9`, because the machine is locked until `$X`.
            assert_eq!(answers, ["error:9", "ok", "ok"], "{name}: {said:?}");
            assert_eq!(bench.state(), "Idle", "{name}");
            assert_eq!(bench.place(), count, "{name}");
        }
    }
}

/// If lines wait for an operator or for the end of a motion, a reset sent after these lines does not act. Closing the
/// port helps: the machine holds its motion and drops unread lines, and the next host's reset acts.
#[test]
fn closing_the_port_makes_room_for_a_reset() {
    for (name, lines, byte) in [("moving", "", 0), ("held", "", b'!'), ("door open", "", 0x84), ("homing", "$H\n", 0)] {
        let mut bench = Bench::new(MACHINE, &format!("{SETTINGS} $22=1"));
        bench.ask("$X");
        bench.send(lines);
        bench.send("G91 G1 X-0.5 F10\n".repeat(600));
        bench.wait(0.5);
        if byte != 0 {
            bench = Bench::new(MACHINE, SETTINGS);
            bench.send("G91 G1 X-5 F10\n");
            bench.wait(0.5);
            bench.send([byte]);
            bench.send("G91 G1 X-0.5 F10\n".repeat(100));
            bench.wait(0.5);
        }
        bench.read();
        bench.send(b"\x18");
        bench.wait(0.5);
        assert!(!bench.read().iter().any(|line| line.starts_with("Grbl")), "{name}: it waits behind the lines");
        bench.mill.disconnect();
        bench.wait(0.1);
        bench.mill.connect();
        let state = bench.state();
        let wanted = match name {
            "door open" => "Door:",
            "homing" => "Home",
            _ => "Hold:",
        };
        assert!(state.starts_with(wanted), "{name}: {state}");
        bench.read();
        bench.send(b"\x18");
        bench.wait(0.5);
        assert!(bench.read().iter().any(|line| line.starts_with("Grbl 1.1h")), "{name}");
    }
}
