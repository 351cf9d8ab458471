//! Random sessions of everything a person can type, press and move: lines of every kind and garbage, settings,
//! realtime bytes at any position, pins, pauses. The machine must not panic or hang, and must answer every line once.
//! The reported position must be the position that the pulses make. The machine must always be able to return to
//! Idle.
//!
//! `OXMILL_FUZZ=N` plays N sessions instead of the default few; `OXMILL_FUZZ_SEED` sets the first seed.

use super::bench::Bench;
use oxmill_fuzz::session::{MACHINE, PINS, SETTINGS, back_to_idle};
use oxmill_test_support::Random;
use std::fmt::Write;

/// Number of actions per session.
const ACTIONS: u64 = 60;

fn number(random: &mut Random) -> String {
    let sign = random.of(&["", "", "-", "+"]);
    match random.below(8) {
        0 => format!("{sign}{}", random.below(3)),
        1..=3 => format!("{sign}{}.{:03}", random.below(4), random.below(1000)),
        4 => format!("{sign}.{}", random.below(100)),
        5 => format!("{sign}{}", random.below(1000)),
        6 => random.of(&["1e3", "..", "--1", "", "999999999999999", "0.00000001", "4294967296", "-0", "1.2.3"]).into(),
        _ => format!("{sign}{}.", random.below(100)),
    }
}

fn line(random: &mut Random) -> String {
    let mut line = String::new();
    match random.below(16) {
        0..=5 => {
            line += random.of(&[
                "G0", "G1", "G1", "G91G1", "G90G1", "G2", "G3", "G53G0", "G38.2", "G38.3", "G38.4", "G18G2", "G93G1",
            ]);
            for letter in ["X", "Y", "Z", "I", "J", "K", "R", "P"] {
                if random.below(3) == 0 {
                    let value = random.below(2400) as i64 - 1200;
                    write!(line, "{letter}{:.3}", value as f64 / 400.0).unwrap();
                }
            }
            if random.below(2) == 0 {
                write!(line, "F{}", 60 + random.below(4000)).unwrap();
            }
        }
        6 => {
            line += random.of(&[
                "G4P0.02",
                "M0",
                "M2",
                "M30",
                "M3S500",
                "M4S300",
                "M5",
                "M8",
                "M9",
                "M7",
                "M56",
                "M56P0",
                "G28",
                "G30",
                "G28.1",
                "G92X0Z1",
                "G92.1",
                "G10L2P1X0.5",
                "G10L20P0Z0",
                "G54",
                "G59",
                "G59.3",
                "G20",
                "G21",
                "G90",
                "G91",
                "G43.1Z0.2",
                "G49",
                "G80",
                "T2",
                "F1000",
                "S800",
                "%",
                "/G1X1",
                "(a remark",
                "; another",
            ]);
        }
        7 | 8 => {
            line += random.of(&[
                "$",
                "$$",
                "$#",
                "$G",
                "$I",
                "$N",
                "$X",
                "$X",
                "$X",
                "$C",
                "$H",
                "$HZ",
                "$SLP",
                "$RST=#",
                "$N0=G20",
                "$N1=",
                "$I=A",
                "$N0=G1X1F100",
                "$N0=",
            ]);
        }
        9 => {
            write!(
                line,
                "$J=G91{}{}F{}",
                random.of(&["X", "Y", "Z", "A", ""]),
                number(random),
                100 + random.below(3000)
            )
            .unwrap();
        }
        10 | 11 => {
            // No setting of resolution, rate or acceleration is among these, so that a session stays short.
            let setting = random.of(&[
                "0", "1", "2", "3", "4", "5", "6", "10", "11", "12", "13", "20", "21", "22", "23", "26", "27", "30",
                "31", "32", "40", "41", "42", "43", "44", "45", "46", "56", "58", "900", "901", "902", "903", "999",
            ]);
            write!(line, "${setting}={}", number(random)).unwrap();
        }
        12 => {
            for _ in 0..random.below(100) {
                line.push(char::from(b' ' + random.below(95) as u8));
            }
            // With a random setting, feed or dwell a session could take days. So remove the letters with which such
            // words begin.
            line.retain(|c| !matches!(c, '$' | 'F' | 'f' | 'P' | 'p' | 'Q'));
        }
        13 => line += &"G1X1".repeat(random.below(90) as usize),
        _ => {
            for _ in 0..1 + random.below(5) {
                line +=
                    random.of(&["G", "M", "X", "Y", "Z", "S", "L", "I", "J", "K", "N", "R", "T", "(", ")", "/", "*"]);
                line += &number(random);
            }
        }
    }
    line
}

fn session(seed: u64) {
    let mut random = Random(seed.wrapping_mul(0x9E37_79B9_7F4A_7C15) | 1);
    let mut bench = Bench::new(MACHINE, SETTINGS);
    let mut history = String::new();
    for _ in 0..ACTIONS {
        match random.below(12) {
            0..=6 => {
                let mut bytes = line(&mut random).into_bytes();
                bytes.extend(random.of(&["\n", "\n", "\r\n", "\r"]).bytes());
                if random.below(6) == 0 {
                    let at = random.below(bytes.len() as u64) as usize;
                    let byte = match random.below(4) {
                        0 => b'!',
                        1 => b'~',
                        _ => 0x80 + random.below(0x30) as u8,
                    };
                    bytes.insert(at, byte);
                }
                // Send the bytes only if they fit, as a sender that counts characters does. So no realtime command has
                // to wait behind a line that does not fit.
                if bench.mill.unread() + bytes.len() <= bench.mill.board().received_bytes {
                    write!(history, "{:?} ", String::from_utf8_lossy(&bytes)).unwrap();
                    bench.send(&bytes);
                }
            }
            7 | 8 => {
                let byte = match random.below(8) {
                    0 => 0x18,
                    1 => 0x19,
                    2 => b'!',
                    3 | 4 => b'~',
                    5 => 0x84,
                    6 => 0x85,
                    _ => 0x80 + random.below(0x30) as u8,
                };
                write!(history, "{byte:#x} ").unwrap();
                bench.send([byte]);
            }
            9 => {
                let pin = random.of(&PINS);
                let text = format!("{pin} {}", random.below(2));
                write!(history, "{text} ").unwrap();
                bench.pin(&text);
            }
            _ => {
                let time = [0.001, 0.01, 0.05, 0.3][random.below(4) as usize];
                write!(history, "..{time} ").unwrap();
                bench.wait(time);
            }
        }
        let status = bench.status();
        assert!(status.starts_with('<') && status.ends_with('>'), "{seed}: {status}\n{history}");
        bench.read();
    }
    back_to_idle(&mut bench.mill, &format!("session {seed}: {history}"));
}

#[test]
fn anything_may_happen() {
    let number = |name: &str, default: u64| {
        std::env::var(name).map_or(default, |text| text.parse().unwrap_or_else(|_| panic!("{name} is a number")))
    };
    let (sessions, first) = (number("OXMILL_FUZZ", 300), number("OXMILL_FUZZ_SEED", 1));
    for seed in first..first + sessions {
        session(seed);
    }
    println!("{sessions} sessions of {ACTIONS} actions");
}
