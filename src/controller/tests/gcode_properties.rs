//! Tests of properties of every line: it is answered without a panic, checking it changes nothing, and positions are
//! exact.

use crate::program::{DIALECTS, Program};
use oxmill_controller::axes::PerAxis;
use oxmill_controller::gcode::{Action, CycleStep, Dialect, Feed, Flow, Interpreter, MotionCommand};
use oxmill_controller::units::Coordinate;
use proptest::prelude::*;

fn dialect() -> impl Strategy<Value = Dialect> {
    prop::sample::select(DIALECTS.to_vec())
}

/// Generates lines that are mostly made of words that exist.
fn line() -> impl Strategy<Value = Vec<u8>> {
    let number = prop_oneof![
        4 => (-20_i32..20).prop_map(|number| number.to_string()),
        2 => (-200_000_i64..200_000).prop_map(|number| format!("{}.{:03}", number / 1000, number.abs() % 1000)),
        1 => "[-+]?[0-9]{0,25}[.]?[0-9]{0,12}",
    ];
    let g = "(0|1|2|3|4|10|17|18|19|20|21|28|28.1|30|30.1|38.2|38.4|40|43.1|49|53|54|55|59|59.1|59.3|61|80|90|90.1|91\
             |91.1|92|92.1|93|94|73|81|82|83|85|86|88|89|98|99|43|43.2|50|52|61.1|64|92.2|92.3)";
    let word = prop_oneof![
        3 => g.prop_map(|number| format!("G{number}")),
        1 => "M(0|1|2|3|4|5|6|7|8|9|30|48|49|50|51|56|60|70|71|72)",
        8 => ("[FHIJKLNPQRSTXYZ]", number).prop_map(|(letter, number)| format!("{letter}{number}")),
    ];
    prop::collection::vec(word, 0..7).prop_map(|words| words.concat().into_bytes())
}

fn in_reach(place: &PerAxis<Coordinate, 3>) -> bool {
    place.iter().all(|coordinate| coordinate.in_range())
}

/// Checks an action: its feed is finite and above 0, its points are within 50 m, and its motion begins at the old
/// position and ends at the new one.
fn sound(before: &Interpreter<3>, checked: &Action<3>) -> Result<(), TestCaseError> {
    let feeds = |feed: Feed| match feed {
        Feed::Rapid => true,
        Feed::PerMinute(feed) | Feed::InverseTime(feed) => feed.is_finite() && feed > 0.0,
    };
    match checked.motion {
        MotionCommand::None => prop_assert_eq!(checked.position(), before.position()),
        MotionCommand::Line { via, target, feed } => {
            prop_assert!(via.is_none_or(|via| in_reach(&via)) && in_reach(&target) && feeds(feed));
            prop_assert_eq!(*checked.position(), target);
        }
        MotionCommand::Probe { target, feed, .. } => {
            prop_assert!(in_reach(&target) && feeds(feed));
            prop_assert_eq!(*checked.position(), target);
        }
        MotionCommand::Cycle(mut cycle) => {
            let corners = cycle.corners();
            for _ in 0..2000 {
                let place = match cycle.step(Coordinate(2_540_000)) {
                    None => {
                        break;
                    }
                    Some(CycleStep::Rapid(place)) => place,
                    Some(CycleStep::Feed(place, feed)) => {
                        prop_assert!(feeds(Feed::PerMinute(feed)));
                        place
                    }
                    Some(_) => continue,
                };
                prop_assert!(in_reach(&place));
                for axis in 0..3 {
                    let reach = corners.map(|corner| corner.0[axis]);
                    prop_assert!(
                        reach.iter().min() <= Some(&place.0[axis]) && reach.iter().max() >= Some(&place.0[axis])
                    );
                }
            }
        }
        MotionCommand::Nurbs(nurbs) => {
            prop_assert!(in_reach(&nurbs.target) && feeds(nurbs.feed) && (3..=8).contains(&nurbs.order));
            prop_assert_eq!((*checked.position(), *before.position()), (nurbs.target, nurbs.start));
            prop_assert!(before.control_points().len() >= usize::from(nurbs.order));
        }
        MotionCommand::Spline(spline) => {
            prop_assert!(spline.corners().iter().all(in_reach) && feeds(spline.feed));
            prop_assert_eq!((*checked.position(), *before.position()), (spline.target, spline.start));
            prop_assert_eq!(spline.start.0[2], spline.target.0[2]);
        }
        MotionCommand::Arc(arc) => {
            prop_assert!(in_reach(&arc.target) && feeds(arc.feed));
            prop_assert_eq!((*checked.position(), *before.position()), (arc.target, arc.start));
            let from_centre = |place: &PerAxis<Coordinate, 3>| {
                let along = |axis| (place.get(axis).unwrap() - arc.start.get(axis).unwrap()).0 as f64 / 1e7;
                let (first, second) = (arc.i.0 as f64 / 1e7, arc.j.0 as f64 / 1e7);
                (along(arc.axes.first) - first).hypot(along(arc.axes.second) - second)
            };
            let (start, end) = (from_centre(&arc.start), from_centre(&arc.target));
            prop_assert!(start > 0.0);
            prop_assert!((start - end).abs() <= 0.005_001_f64.max((0.001 * start + 1e-6).min(0.5)), "{start} {end}");
        }
    }
    prop_assert!(checked.speed.is_finite());
    Ok(())
}

/// Checks and executes one line. The state afterwards must be the one that the check has returned.
fn step(interpreter: &mut Interpreter<3>, line: &[u8], dialect: Dialect) -> Result<(), TestCaseError> {
    let before = interpreter.clone();
    let jog = interpreter.check_jog(line, dialect);
    let checked = interpreter.check(line, dialect);
    prop_assert!(*interpreter == before, "checking changes nothing");
    if let Ok(jog) = jog {
        sound(&before, &jog)?;
        let mut jogged = before.clone();
        jogged.commit(&jog);
        prop_assert_eq!(jogged.position(), jog.position());
        jogged.set_position(*before.position());
        prop_assert!(jogged == before, "a jog changes the position only");
    }
    let Ok(checked) = checked else { return Ok(()) };
    sound(&before, &checked)?;
    let offset = before.work_offset();
    interpreter.commit(&checked);
    prop_assert_eq!(interpreter.position(), checked.position());
    prop_assert_eq!(interpreter.modal(), checked.modal());
    prop_assert!(checked.work_offset_changed || interpreter.work_offset() == offset);
    let once = interpreter.clone();
    interpreter.commit(&checked);
    prop_assert!(*interpreter == once, "a second commit changes nothing more");
    Ok(())
}

proptest! {
    #[test]
    fn any_bytes(
        lines in prop::collection::vec(prop::collection::vec(any::<u8>(), 0..300), 1..8),
        dialect in dialect(),
    ) {
        let mut interpreter = Interpreter::default();
        for line in lines {
            step(&mut interpreter, &line, dialect)?;
        }
    }

    #[test]
    fn any_words(lines in prop::collection::vec(line(), 1..20), dialect in dialect()) {
        let mut interpreter = Interpreter::default();
        for line in lines {
            step(&mut interpreter, &line, dialect)?;
        }
    }

    /// After a move, the work coordinate reads exactly as it was programmed, whatever the offsets are.
    #[test]
    fn programmed_is_reached(
        offsets in prop::collection::vec(-1_000_000_000_i64..1_000_000_000, 4),
        to in -1_000_000_000_i64..1_000_000_000,
        inches: bool,
    ) {
        let text = |value: i64| {
            format!("{}{}.{:07}", if value < 0 { "-" } else { "" }, value.abs() / 10_000_000, value.abs() % 10_000_000)
        };
        let mut program = Program::new(Dialect::Oxmill);
        if inches {
            program.run("G20");
        }
        program.run(&format!("G10 L2 P2 Z{}", text(offsets[0])));
        program.run(&format!("G55 G0 Z{}", text(offsets[1])));
        program.run(&format!("G43.1 Z{}", text(offsets[2])));
        program.run(&format!("G92 Z{}", text(offsets[3])));
        let read = |program: &Program| {
            program.interpreter.position().0[2] - program.interpreter.work_offset().0[2]
        };
        let length = |value: i64| {
            let tenth = if value < 0 { -5 } else { 5 };
            Coordinate(if inches { (value * 254 + tenth) / 10 } else { value })
        };
        prop_assert_eq!(read(&program), length(offsets[3]));
        program.run(&format!("G0 Z{}", text(to)));
        prop_assert_eq!(read(&program), length(to));
        program.run(&format!("G10 L20 P2 Z{}", text(offsets[1])));
        prop_assert_eq!(read(&program), length(offsets[1]));
    }
}

/// The steps add up exactly. Grbl, which computes in single precision, ends at about 1000.04 mm instead of 1000 mm.
#[test]
fn a_million_small_steps() {
    let dialect = Dialect::default();
    let mut interpreter = Interpreter::<3>::default();
    for line in [&b"G91G1F100"[..], b"G20"] {
        let checked = interpreter.check(line, dialect).unwrap();
        interpreter.commit(&checked);
    }
    for _ in 0..100_000 {
        for line in [&b"X0.0001"[..], b"Y-0.00001"] {
            let checked = interpreter.check(line, dialect).unwrap();
            interpreter.commit(&checked);
        }
    }
    assert_eq!(*interpreter.position(), PerAxis([Coordinate::mm(254), Coordinate(-254_000_000), Coordinate::ZERO]));
    let mut interpreter = Interpreter::<3>::default();
    for _ in 0..1_000_000 {
        let checked = interpreter.check(b"G91G0X0.001", dialect).unwrap();
        interpreter.commit(&checked);
    }
    assert_eq!(*interpreter.position(), PerAxis([Coordinate::mm(1000), Coordinate::ZERO, Coordinate::ZERO]));
}

#[test]
fn very_long_lines() {
    for dialect in DIALECTS {
        let program = Program::new(dialect);
        assert_eq!(program.error(&"G4".repeat(5000)), 21);
        assert_eq!(program.error(&"X1".repeat(5000)), 25);
        assert_eq!(program.error(&format!("X{}", "1".repeat(100_000))), 33);
        assert_eq!(program.error(&format!("X.{}", "1".repeat(100_000))), 0);
        assert_eq!(program.error(&format!("X{}1", "0".repeat(100_000))), 0);
    }
}

/// If `moves_only` is true for a line, the controller skips its checks for other effects. So such a line must have no
/// other effect.
#[test]
fn a_line_that_only_moves_changes_nothing_else() {
    for dialect in DIALECTS {
        let mut program = Program::new(dialect);
        program.run_all("G21 F300 T7\nG0 X1 Y2 Z3");
        // In Grbl's dialect, a line without T deselects the tool. The second setup line has done that, so none of
        // these lines changes the tool.
        for line in
            ["X2", "G1 X3 F20", "N7 G3 X4 I0.5", "G20 G91 G17", "G80", "G90 G21", "G0 X0 Z1", "G93 G1 X1 F2", "G94"]
        {
            let before = (program.interpreter.clone(), *program.interpreter.modal());
            let checked = program.run(line);
            assert!(checked.moves_only(), "{line}");
            assert!(!checked.changes_outputs() && !checked.needs_machine() && !checked.work_offset_changed, "{line}");
            assert!(checked.dwell.is_none() && !checked.uses_machine_place && checked.flow == Flow::None, "{line}");
            let (old, modal) = (before.0, program.interpreter.modal());
            assert_eq!(
                (modal.tool, modal.speed, modal.spindle),
                (before.1.tool, before.1.speed, before.1.spindle),
                "{line}"
            );
            assert_eq!(old.work_offset(), program.interpreter.work_offset(), "{line}");
        }
        program.run("G21 G90 G94 F300 G0");
        for line in
            ["S9", "M3", "M8", "G4 P1", "G10 L20 P1 X0", "G43.1 Z1", "G49", "G92 X0", "G55", "T2", "M0", "M2", "G53 X0"]
        {
            assert!(!program.check(line).unwrap().moves_only(), "{line} in {dialect:?}");
        }
        for line in ["G28", "G28.1", "G30 Z0", "G92.1", "G38.2 Z-9 F9", "G61", "M30"] {
            assert!(!program.check(line).unwrap().moves_only(), "{line} in {dialect:?}");
        }
    }
}
