//! Two jogs are sent, and an event that ends jogs arrives after their first byte, their second byte, and so on. A jog
//! of which at least one byte arrived before the event must not move, every jog must be answered, and a jog sent later
//! must move.

use super::bench::Bench;
use oxmill_simulator::trace::Csv;
use oxmill_test_support::Random;
use std::cell::RefCell;
use std::io::{self, Write};
use std::rc::Rc;

/// What the machine does when the jogs arrive: a name, the bytes that make it do so, and the X position at the end in
/// steps (`None` if unknown).
const BEFORE: [(&str, &str, Option<i32>); 5] = [
    ("idle", "", Some(0)),
    ("dwell", "G4 P0.3\n", Some(0)),
    ("job", "G1 X-1 F600\nG4 P0.3\n", Some(-250)),
    ("hold", "!", Some(0)),
    ("jog", "$J=G91 X-1 F600\n", None),
];
const FIRST: &str = "$J=G91 Y-2 F3000\n";
const SECOND: &str = "$J=G91 Z-1 F900\n";

#[derive(Clone, Copy, Debug, PartialEq)]
enum End {
    /// A realtime byte, sent in the same packet as the jogs, after them.
    Byte(u8),
    Pin(&'static str),
    HostGoes,
}

const ENDS: [End; 6] =
    [End::Byte(b'!'), End::Byte(0x84), End::Byte(0x85), End::Pin("hold"), End::Pin("door"), End::HostGoes];

fn send_and_end(bench: &mut Bench, text: &str, end: End) {
    let mut packet = text.as_bytes().to_vec();
    packet.extend(if let End::Byte(byte) = end { Some(byte) } else { None });
    bench.send(packet);
    match end {
        End::Byte(_) => {}
        End::Pin(pin) => {
            bench.pin(&format!("{pin} 1"));
            bench.wait(0.002);
            bench.pin(&format!("{pin} 0"));
        }
        End::HostGoes => {
            bench.mill.disconnect();
            bench.mill.connect();
        }
    }
}

/// Sends `~` several times, which ends all holds and door states, and waits until the machine is idle.
fn go_on(bench: &mut Bench) {
    for _ in 0..4 {
        bench.wait(0.5);
        bench.send("~");
    }
    bench.settle();
}

#[test]
fn no_jog_moves_that_was_received_before_what_ends_jogs() {
    let machine = Bench::new("", "$110=3000 $111=3000 $112=3000 $120=500 $121=500 $122=500");
    let both = format!("{FIRST}{SECOND}");
    let mut cases = 0;
    for ((state, before, x), end) in BEFORE.into_iter().flat_map(|before| ENDS.map(|end| (before, end))) {
        for at in 1..=both.len() {
            let mut bench = machine.clone();
            bench.send(before);
            bench.wait(0.02);
            let waits = !bench.mill.controller().wants_line() || matches!(end, End::Byte(_));
            if !waits && at >= FIRST.len() {
                // The first jog has started and can have moved.
                continue;
            }
            let (received, rest) = both.split_at(at);
            send_and_end(&mut bench, received, end);
            bench.wait(0.5);
            // After a reconnection the rest is not sent, because the new host must not start with half a line.
            let rest = if end == End::HostGoes { "" } else { rest };
            bench.send(rest);
            go_on(&mut bench);
            let what = format!("{state}, {end:?} behind {received:?}");
            let z = if rest.ends_with(SECOND) { -250 } else { 0 };
            assert_eq!(bench.place()[1..], [0, z], "{what}");
            assert!(x.is_none_or(|x| bench.place()[0] == x), "{what}: {:?}", bench.place());
            let answers = bench.read().iter().filter(|line| *line == "ok").count();
            let lines = before.matches('\n').count() + 2;
            assert!(answers == lines || end == End::HostGoes, "{what}: {answers} of {lines} answers");
            cases += 1;
        }
    }
    assert!(cases > 500, "{cases}");
}

/// A file in memory whose contents can be read through a clone.
#[derive(Clone, Default)]
struct File(Rc<RefCell<Vec<u8>>>);

impl Write for File {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.0.borrow_mut().write(bytes)
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

/// Returns the number of X steps with the laser on, from a trace. Motion along Y comes only from jogs, in which the
/// laser must be off.
fn burnt(trace: &str, log: &str) -> usize {
    let (mut y, mut power, mut burnt) = ("0".to_string(), 0.0, 0);
    for row in trace.lines().skip(1) {
        let columns: Vec<&str> = row.split(',').collect();
        power = columns[5].parse().unwrap_or(power);
        let jogs = columns[2] != std::mem::replace(&mut y, columns[2].to_string());
        assert!(!jogs || power == 0.0, "power {power} in a jog: {row}, {log}");
        burnt += usize::from(!jogs && power != 0.0);
    }
    burnt
}

#[test]
fn a_laser_burns_in_no_jog_whatever_comes_before_and_meanwhile() {
    let laser = Bench::new("", "$32=1 $110=3000 $111=3000 $120=300 $121=300");
    let mut all = 0;
    for seed in 1..=40 {
        let random = &mut Random(seed * 0x9E37_79B9 + 1);
        let (mut bench, file, mut log) = (laser.clone(), File::default(), String::new());
        let csv = Csv::new(file.clone(), bench.mill.board().step_clock_hz, 0, 3).unwrap();
        bench.mill.trace_mut().write_csv(csv);
        for _ in 0..30 {
            let action = match random.below(14) {
                0 => "M3 S500\n",
                1 => "M4 S900\n",
                2 => random.of(&["S200\n", "M5\n", "G0 X0\n"]),
                3 | 4 => "G91 G1 X1 F1500\n",
                5 => "G91 G1 X-2 F900 S700\n",
                6..=8 => random.of(&["$J=G91 Y2 F1800\n", "$J=G91 Y-3 F600\n"]),
                9 => random.of(&["\u{85}", "\u{84}"]),
                10 => random.of(&["!", "\u{19}"]),
                11 | 12 => random.of(&["\u{9a}", "\u{9e}", "\u{90}"]),
                _ => "~",
            };
            // Each character is a byte.
            bench.send(action.chars().map(|c| c as u8).collect::<Vec<u8>>());
            log += &format!("{action:?} ");
            bench.wait(random.below(300) as f64 / 1000.0);
        }
        bench.mill.trace_mut().finish().unwrap();
        let trace = String::from_utf8(file.0.take()).unwrap();
        all += burnt(&trace, &log);
    }
    assert!(all > 10_000, "{all}");
}
