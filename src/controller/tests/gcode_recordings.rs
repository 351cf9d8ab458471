//! Compares the interpreter with conversations recorded from real Grbl 1.1h: the `ok` or `error:N` of each line, the
//! state that `$G` and `$#` print, and the position where motion came to rest.

use oxmill_controller::axes::{Axis, PerAxis};
use oxmill_controller::error::Error;
use oxmill_controller::gcode::{CoordinateSystem, Dialect, Flow, Interpreter, StoredOffset};
use oxmill_controller::messages::{Coolant, SpindleDirection};
use oxmill_controller::units::{Coordinate, DECIMAL_ONE};

const GRBL: Dialect = Dialect::Grbl;

/// Lines that get another answer than from Grbl, on purpose: the group, the line, and the answer here. Grbl accepts
/// targets a kilometre away; here the limit is 50 m.
const OTHERWISE: &[(&str, &str, &str)] = &[("09_arcs", "G2 X1000000 Y0 R500000.5", "error:33")];

/// Returns a line as the line filter passes it on: in capitals, without blanks and comments.
fn filtered(line: &str) -> Vec<u8> {
    let mut kept = Vec::new();
    let mut comment = false;
    for byte in line.bytes() {
        match byte {
            b';' if !comment => break,
            b'(' => comment = true,
            b')' if comment => comment = false,
            _ if comment => {}
            0..=b' ' | b'/' | b'!' | b'~' | b'?' | 0x80.. => {}
            _ => kept.push(byte.to_ascii_uppercase()),
        }
    }
    kept
}

fn answer(result: Result<(), Error>) -> String {
    match result {
        Ok(()) => "ok".to_string(),
        Err(error) => format!("error:{}", error.code()),
    }
}

fn modal_text(interpreter: &Interpreter<3>) -> String {
    let modal = interpreter.modal();
    let spindle = match modal.spindle {
        SpindleDirection::Off => "M5",
        SpindleDirection::Clockwise => "M3",
        SpindleDirection::CounterClockwise => "M4",
    };
    let coolant = match modal.coolant {
        Coolant { mist: false, flood: false } => "M9",
        Coolant { mist: true, flood: false } => "M7",
        Coolant { mist: false, flood: true } => "M8",
        Coolant { mist: true, flood: true } => "M7 M8",
    };
    let words = [
        modal.motion.word(),
        modal.coordinate_system.word(),
        modal.plane.word(),
        modal.units.word(),
        modal.distance.word(),
        modal.feed_mode.word(),
        spindle,
        coolant,
    ];
    let feed = (modal.feed.0 + DECIMAL_ONE / 2) / DECIMAL_ONE;
    let speed = (modal.speed + 0.5) as u32;
    format!("[GC:{} T{} F{feed} S{speed}]", words.join(" "), modal.tool)
}

/// Returns whether a number of the recording (three decimals) matches the coordinate, within 0.0005 mm. Grbl computes
/// in single precision and may round a half up or down. Numbers of 10^6 or more always match, because Grbl's digits
/// mean nothing there.
fn matches(text: &str, coordinate: Coordinate) -> bool {
    let printed: f64 = text.parse().unwrap();
    let exact = coordinate.0 as f64 / DECIMAL_ONE as f64;
    printed.abs() >= 1e6 || (printed - exact).abs() <= 0.000_501
}

fn check_parameters(interpreter: &Interpreter<3>, reply: &[&str], at: &str) {
    let offsets = interpreter.offsets();
    let mut seen = 0;
    for line in reply {
        let Some((name, values)) = line.trim_matches(['[', ']']).split_once(':') else { continue };
        let place = match name {
            "G28" => offsets.stored(StoredOffset::G28),
            "G30" => offsets.stored(StoredOffset::G30),
            "G92" => offsets.g92,
            "TLO" => {
                assert!(matches(values, offsets.tool_length.0[2]), "{at}: {line}");
                continue;
            }
            "PRB" => continue,
            name => {
                let system = CoordinateSystem::ALL.into_iter().find(|system| system.word() == name).unwrap();
                offsets.system(system)
            }
        };
        for (text, value) in values.split(',').zip(place.iter()) {
            assert!(matches(text, *value), "{at}: {line} is {place:?}");
        }
        seen += 1;
    }
    assert_eq!(seen, 9, "{at}");
}

/// Checks the position in a status report, which is rounded to whole steps of 1/250 mm.
fn check_position(interpreter: &Interpreter<3>, report: &str, at: &str) {
    let Some((_, rest)) = report.split_once("MPos:") else { return };
    let (position, _) = rest.split_once('|').unwrap();
    for (text, axis) in position.split(',').zip(Axis::of_machine::<3>()) {
        let printed: f64 = text.parse().unwrap();
        let exact = interpreter.position().get(axis).unwrap().0 as f64 / DECIMAL_ONE as f64;
        assert!((printed - exact).abs() <= 0.002_501, "{at}: {report} is {exact} along {axis:?}");
    }
}

/// Plays the first `end` records of a group (a file of recordings), and compares answers, states and positions.
fn replay(group: &str, end: usize) {
    let path = format!("{}/../../tests/transcripts/{group}.jsonl", env!("CARGO_MANIFEST_DIR"));
    let text = std::fs::read_to_string(&path).unwrap();
    let mut interpreter = Interpreter::<3>::default();
    let mut played = 0;
    for record in text.lines().take(end) {
        let record: serde_json::Value = serde_json::from_str(record).unwrap();
        let send = record["send"].as_str().unwrap();
        let at = format!("{group} {}: {send:?}", record["n"]);
        let reply: Vec<&str> = record["reply"].as_array().unwrap().iter().map(|line| line.as_str().unwrap()).collect();
        match record["kind"].as_str().unwrap() {
            "line" => {}
            "idle" => {
                check_position(&interpreter, reply.last().unwrap_or(&""), &at);
                continue;
            }
            "rt" if send == "\u{18}" => {
                interpreter.reset();
                continue;
            }
            _ => continue,
        }
        let line = filtered(send);
        let recorded = reply.iter().find(|line| **line == "ok" || line.starts_with("error:")).unwrap();
        let expected = OTHERWISE
            .iter()
            .find(|(other, line, _)| *other == group && *line == send)
            .map_or(*recorded, |(_, _, answer)| answer);
        match line.as_slice() {
            b"$G" => assert_eq!(modal_text(&interpreter), reply[0], "{at}"),
            b"$#" => check_parameters(&interpreter, &reply, &at),
            b"$C" | b"$J" => {}
            [b'$', b'J', b'=', jog @ ..] => {
                let modal = *interpreter.modal();
                let checked = interpreter.check_jog(jog, GRBL);
                assert_eq!(answer(checked.map(|_| ())), expected, "{at}");
                if let Ok(checked) = checked {
                    interpreter.commit(&checked);
                }
                assert_eq!(*interpreter.modal(), modal, "{at}");
            }
            line => {
                assert_ne!(line.first(), Some(&b'$'), "{at}");
                let before = interpreter.clone();
                let checked = interpreter.check(line, GRBL);
                assert!(before == interpreter, "{at}");
                assert_eq!(answer(checked.map(|_| ())), expected, "{at}");
                if let Ok(checked) = checked {
                    assert_eq!(checked.flow == Flow::End, reply.contains(&"[MSG:Pgm End]"), "{at}");
                    interpreter.commit(&checked);
                }
            }
        }
        played += 1;
    }
    assert!(played > 20, "{group}: only {played} lines");
}

#[test]
fn modal_words() {
    replay("06_modal_ok", usize::MAX);
}

#[test]
fn unknown_words() {
    replay("07_modal_bad", usize::MAX);
}

#[test]
fn errors() {
    replay("08_errors_check", usize::MAX);
}

#[test]
fn arcs() {
    replay("09_arcs", usize::MAX);
}

#[test]
fn offsets() {
    replay("10_offsets", usize::MAX);
}

#[test]
fn feed_modes() {
    replay("11_feedmodes", usize::MAX);
}

#[test]
fn numbers() {
    replay("12_numbers", usize::MAX);
}

/// Replays up to the jogs that are interrupted during a move.
#[test]
fn jogs() {
    replay("15_jog", 45);
}

#[test]
fn a_reset_keeps_stored_offsets_and_position() {
    let mut interpreter = Interpreter::<3>::default();
    for line in
        ["G10L2P1X1Y2Z3", "G10L2P6X7", "G0X10Y10Z10", "G28.1", "G92X5", "G43.1Z4", "G91G20G18G59M3S5M8T9F100G93"]
    {
        let checked = interpreter.check(line.as_bytes(), GRBL).unwrap();
        interpreter.commit(&checked);
    }
    interpreter.reset();
    let mm = |x, y, z| PerAxis([Coordinate::mm(x), Coordinate::mm(y), Coordinate::mm(z)]);
    assert_eq!(*interpreter.position(), mm(11, 12, 13));
    assert_eq!(interpreter.offsets().system(CoordinateSystem::G54), mm(1, 2, 3));
    assert_eq!(interpreter.offsets().system(CoordinateSystem::G59), mm(7, 0, 0));
    assert_eq!(interpreter.offsets().stored(StoredOffset::G28), mm(11, 12, 13));
    assert_eq!(interpreter.offsets().g92, mm(0, 0, 0));
    assert_eq!(interpreter.offsets().tool_length.0, [Coordinate::ZERO; 3]);
    assert_eq!(interpreter.work_offset(), mm(1, 2, 3));
    assert_eq!(modal_text(&interpreter), "[GC:G0 G54 G17 G21 G90 G94 M5 M9 T0 F0 S0]");
}
