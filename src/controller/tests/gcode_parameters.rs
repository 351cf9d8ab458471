//! Tests of expressions and parameters in lines of a program. Where LinuxCNC's interpreter has the same words, the
//! expected values were checked with it.
#![cfg(feature = "full")]

use crate::program::{Program, target};
use oxmill_controller::axes::PerAxis;
use oxmill_controller::error::Error;
use oxmill_controller::gcode::{Action, Dialect};
use oxmill_controller::messages::SpindleDirection;
use oxmill_controller::units::Coordinate;
use proptest::prelude::*;

fn ready() -> Program {
    let mut program = Program::new(Dialect::Oxmill);
    program.run("G21 G90 F600");
    program
}

/// Returns the value of an expression, as the target X (machine coordinates, mm) of a rapid.
#[track_caller]
fn x(program: &Program, expression: &str) -> f64 {
    target(&program.check(&format!("G0 G90 G53 X {expression}")).unwrap())[0]
}

#[test]
fn words_take_computed_values() {
    let mut program = ready();
    program.run("#1=10.1");
    assert_eq!(target(&program.check("G1 X#1 Y[#1+0.2] Z-[#1*2]").unwrap()), [10.1, 10.3, -20.2]);
    assert_eq!(target(&program.check("G[2-1] X-#1 Y+SQRT[4] ZSIN[30] N[3+4]").unwrap()), [-10.1, 2.0, 0.5]);
    assert_eq!(program.check("N[3+4]").unwrap().line_number, 7);
    program.run("#2=59.2");
    program.run("G#2");
    assert_eq!(program.interpreter.modal().coordinate_system.word(), "G59.2");
    // Rounding can make a computed number slightly different from the number of a word. Such a number is accepted:
    // `3*[1/3]+2` selects M3.
    program.run("G[162/3]");
    assert_eq!(program.check("M[3*[1/3]+2]").unwrap().spindle, Some(SpindleDirection::Clockwise));
    assert_eq!(program.error("M[3.2]"), Error::IntegerRequired.code());
    for (line, code) in [
        ("X[1", 75),
        ("X[1/0]", 72),
        ("X FOO[1]", 2),
        ("X[FOO[1]]", 71),
        ("X#<UNSET>", 74),
        ("X#6000", 74),
        ("X#0", 74),
        ("X1+2", 1),
        ("X[1]+2", 1),
        ("X", 2),
        ("XY1", 2),
        ("#1", 75),
        ("#1=", 75),
        ("#1=1 X", 2),
        ("#[1/0]=1", 72),
        ("#<A>=[1+]", 75),
        ("#5220=2", 200),
        ("#<_X>=1", 200),
        ("#6000=1", 74),
    ] {
        assert_eq!(program.error(line), code, "{line}");
    }
}

#[test]
fn to_grbl_expressions_are_errors() {
    let program = Program::new(Dialect::Grbl);
    for (line, code) in [("#1=5", 1), ("X#1", 2), ("X[1]", 2), ("G0 X SIN[1]", 2), ("X1#1=5", 1)] {
        assert_eq!(program.error(line), code, "{line}");
    }
    assert!(program.interpreter.clone().check_jog(b"X[1]F1", Dialect::Grbl).is_err());
}

#[test]
fn a_line_reads_all_before_it_sets_any() {
    let mut program = ready();
    program.run("#1=1 #2=2 #<NAME>=3");
    program.run("#1=#2 #2=#1 #<NAME>=[#<NAME>+1] G0 X#1 Y#<NAME>");
    assert_eq!(program.machine(), [1.0, 3.0, 0.0]);
    assert_eq!([x(&program, "#1"), x(&program, "#2"), x(&program, "#<NAME>")], [2.0, 1.0, 4.0]);
    // Assignments are made from left to right, so the last one counts.
    program.run("#1=5 #1=6 #<NEW>=1 #<NEW>=2");
    assert_eq!([x(&program, "#1"), x(&program, "#<NEW>")], [6.0, 2.0]);
    program.run("#10=2");
    program.run("##10=30 #[5+6]=[7] #12=##10");
    assert_eq!(
        [x(&program, "#2"), x(&program, "#11"), x(&program, "##10"), x(&program, "#12")],
        [30.0, 7.0, 30.0, 1.0]
    );
}

#[test]
fn unset_parameters() {
    let program = ready();
    assert_eq!(x(&program, "#99"), 0.0);
    assert_eq!(x(&program, "#5999"), 0.0);
    assert_eq!(x(&program, "EXISTS[#<A>]"), 0.0);
    assert_eq!(x(&program, "EXISTS[#99]"), 1.0);
    assert_eq!(x(&program, "EXISTS[#6000]"), 0.0);
    assert_eq!(program.error("X#<A>"), 74);
}

/// Refused lines, lines that are only checked, and jogs set no parameter.
#[test]
fn a_refused_line_sets_nothing() {
    let mut program = ready();
    program.run("#1=1");
    let mut checked = Action::NOTHING;
    for line in ["#1=2X", "#1=2G0G1", "#1=2X1X2", "#1=2X[1/0]", "#1=2G2X1", "#1=2#5220=3"] {
        assert!(program.interpreter.check_into(line.as_bytes(), Dialect::Oxmill, &mut checked).is_err(), "{line}");
        assert_eq!(x(&program, "#1"), 1.0, "{line}");
        program.run("G0");
        assert_eq!(x(&program, "#1"), 1.0, "{line}");
    }
    program.interpreter.check_into(b"#1=2G0X5", Dialect::Oxmill, &mut checked).unwrap();
    program.run("G0");
    assert_eq!(x(&program, "#1"), 1.0, "found good, and refused later");
    assert_eq!(program.interpreter.check_jog(b"#1=2X1F10", Dialect::Oxmill), Err(Error::InvalidJog));
    assert_eq!(target(&program.interpreter.check_jog(b"X[#1/8]F10", Dialect::Oxmill).unwrap()), [0.125, 0.0, 0.0]);
    program.run("G0");
    assert_eq!(x(&program, "#1"), 1.0);
}

#[test]
fn what_is_forgotten() {
    let set = "#1=1 #30=2 #31=3 #5000=4 #<LOCAL>=5 #<_GLOBAL>=6";
    let mut program = ready();
    program.run(set);
    program.run("G92 X0");
    for end in ["M2", "#31=30 M30"] {
        program.run(end);
        assert_eq!([x(&program, "#1"), x(&program, "#30"), x(&program, "#5000")], [0.0, 0.0, 4.0], "{end}");
        assert_eq!((x(&program, "EXISTS[#<LOCAL>]"), x(&program, "#<_GLOBAL>")), (0.0, 6.0), "{end}");
    }
    assert_eq!(x(&program, "#31"), 30.0);
    program.run(set);
    program.interpreter.reset();
    assert_eq!([x(&program, "#1"), x(&program, "#31"), x(&program, "EXISTS[#<_GLOBAL>]")], [0.0; 3]);
}

/// There is room for 315 parameters, and for 19 assignments in a line. An existing parameter can always be set again.
#[test]
fn capacity() {
    let mut program = ready();
    for number in 100..415 {
        program.run(&format!("#{number}={number}"));
    }
    assert_eq!(program.error("#1=1"), 83);
    assert_eq!(program.error("#<A>=1"), 83);
    assert_eq!(program.error("#100=1 #1=1"), 83);
    program.run("#100=1 #256=2");
    assert_eq!([x(&program, "#100"), x(&program, "#101"), x(&program, "#256")], [1.0, 101.0, 2.0]);
    let many = |count: u32| (0..count).map(|number| format!("#{}=7", 100 + number)).collect::<String>();
    assert_eq!(program.error(&many(20)), 83);
    program.run(&many(19));
    assert_eq!([x(&program, "#118"), x(&program, "#119")], [7.0, 119.0]);
    program.interpreter.reset();
    program.run("#1=1");
    let name = "N".repeat(32);
    program.run(&format!("#<{name}>=1"));
    assert_eq!(program.error(&format!("#<{name}N>=1")), 74);
    assert_eq!(program.error(&format!("X#<{name}N>")), 74);
}

#[test]
fn the_machine_shows_its_state() {
    let mut program = ready();
    program.run("G10 L2 P1 X10 Y20 Z30");
    program.run("G10 L2 P9 X1");
    program.run("G0 G53 X1 Y2 Z3");
    program.run("G28.1");
    program.run("G30.1 F254 S1000 M3 M8 T7 M6");
    program.run("T8");
    let is = |program: &Program, text: &str| x(program, text);
    for (parameter, value) in [
        ("#5161", 1.0),
        ("#5163", 3.0),
        ("#5164", 0.0),
        ("#5182", 2.0),
        ("#5210", 0.0),
        ("#5220", 1.0),
        ("#5221", 10.0),
        ("#5223", 30.0),
        ("#5381", 1.0),
        ("#5400", 7.0),
        ("#5420", -9.0),
        ("#5422", -27.0),
        ("#<_X>", -9.0),
        ("#<_ABS_Y>", 2.0),
        ("#<_FEED>", 254.0),
        ("#<_RPM>", 1000.0),
        ("#<_METRIC>", 1.0),
        ("#<_IMPERIAL>", 0.0),
        ("#<_ABSOLUTE>", 1.0),
        ("#<_INCREMENTAL>", 0.0),
        ("#<_MOTION_MODE>", 0.0),
        ("#<_PLANE>", 170.0),
        ("#<_COORD_SYSTEM>", 540.0),
        ("#<_SPINDLE_ON>", 1.0),
        ("#<_SPINDLE_CW>", 1.0),
        ("#<_FLOOD>", 1.0),
        ("#<_MIST>", 0.0),
        ("#<_UNITS_PER_MINUTE>", 1.0),
        ("#<_INVERSE_TIME>", 0.0),
        ("#<_IJK_ABSOLUTE_MODE>", 0.0),
        ("#<_TOOL_OFFSET>", 0.0),
        ("#<_CURRENT_TOOL>", 7.0),
        ("#<_SELECTED_TOOL>", 8.0),
    ] {
        assert_eq!(is(&program, parameter), value, "{parameter}");
        assert_eq!(program.error(&format!("{parameter}=1")), 200, "{parameter}");
    }
    program.run("G43.1 Z2");
    program.run("G59.3 G92 X5");
    program.run("G20 G91");
    for (parameter, inches) in [("#5420", 5.0), ("#<_X>", 5.0), ("#<_FEED>", 254.0), ("#5211", -5.0), ("#5403", 2.0)] {
        let units = if ["#5211", "#5403"].contains(&parameter) { 25.4 } else { 1.0 };
        let value = is(&program, parameter) / units;
        assert!((value - inches).abs() < 2e-6, "{parameter}: {value}");
    }
    for (parameter, value) in [("#5210", 1.0), ("#5220", 9.0), ("#<_IMPERIAL>", 1.0), ("#<_COORD_SYSTEM>", 593.0)] {
        assert!((is(&program, parameter) / 25.4 - value).abs() < 2e-6, "{parameter}");
    }
}

/// With three axes, `#<_A>` and `#<_ABS_A>` (also of B and C) are free names, which programs may set. The numbers of
/// these parameters, such as #5423, stay reserved: they read 0 and cannot be set.
#[test]
fn names_of_axes_that_the_machine_lacks() {
    for letter in ["A", "B", "C"] {
        let mut program = ready();
        for name in [format!("#<_{letter}>"), format!("#<_ABS_{letter}>")] {
            assert_eq!(program.error(&format!("X{name}")), 74);
            program.run(&format!("{name}=3"));
            assert_eq!(x(&program, &name), 3.0, "{name}");
        }
    }
    let program = ready();
    for number in ["#5423", "#5425", "#5164", "#5224", "#5404"] {
        assert_eq!((x(&program, number), program.error(&format!("{number}=1"))), (0.0, 200), "{number}");
    }
    assert_eq!(["#<_Z>=1", "#<_ABS_Z>=1"].map(|line| program.error(line)), [200; 2]);
}

/// #5210 is 1 while the offset of G92 is in force. #5211 is the X of that offset, and keeps its value while G92.2
/// suspends the offset.
#[test]
fn the_offset_of_g92() {
    let mut program = ready();
    for (line, acts, offset) in [
        ("G4 P0", 0.0, 0.0),
        ("G92 X0", 1.0, 0.0),
        ("G92 X-5", 1.0, 5.0),
        ("G92.2", 0.0, 5.0),
        ("G92.3", 1.0, 5.0),
        ("M70", 1.0, 5.0),
        ("G92.2", 0.0, 5.0),
        ("M72", 1.0, 5.0),
        ("G52 X2", 1.0, 2.0),
        ("M2", 1.0, 2.0),
        ("G92.1", 0.0, 0.0),
        ("G92.3", 1.0, 0.0),
    ] {
        program.run(line);
        assert_eq!((x(&program, "#5210"), x(&program, "#5211")), (acts, offset), "{line}");
    }
}

#[test]
fn values_in_comments() {
    let mut program = ready();
    program.run("#1=10.1 #<A_B>=[-1/3] #2=-0.0000001 #20=-2.456 #21=7 #22=2.5");
    let expand = |comment: &str| {
        let mut out = heapless::Vec::<u8, 64>::new();
        program.interpreter.expand(comment.as_bytes(), &mut out);
        String::from_utf8(out.to_vec()).unwrap()
    };
    assert_eq!(expand(" v=#1, w=[#1+0.2]"), " v=10.100000, w=[10.100000+0.2]");
    assert_eq!(expand("#<a _b>#99 #2"), "-0.3333330.000000 0.000000");
    // Numbers are written as by LinuxCNC's interpreter, except that LinuxCNC rounds 2.5 to 2 and drops the characters
    // `%.` if no f follows.
    assert_eq!(expand("a %d #20 b %.2f #20 c %f #20 d %lf #20 %.0f#20"), "a  -2 b  -2.46 c  -2.4560 d %lf -2.4560 -2");
    assert_eq!(expand("#20 %d #20 #21 %.3f#20 %.9f#20"), "-2.456000  -2 7 -2.456 -2.4560000");
    assert_eq!(expand("100% #21 %x %.12f %F %% %.f %"), "100% 7.000000 %x %.12f %F %% %.f %");
    assert_eq!(expand("%.1f#22 %d#22 #<nothing>"), "2.5 3 ######");
    assert_eq!(expand("#<nothing> #0 # #<> #< 5#"), "###### ###### # #<> #< 5#");
    assert_eq!(expand(&"#1".repeat(40)).len(), 64);
    // The comment of a line can show a parameter that the same line sets.
    let mut program = program.clone();
    let mut checked = Action::NOTHING;
    let check = program.interpreter.check_into(b"#1=3#1=4", Dialect::Oxmill, &mut checked);
    let mut out = heapless::Vec::<u8, 64>::new();
    program.interpreter.expand(b"#1 #2", &mut out);
    assert_eq!((check, out.as_slice()), (Ok(()), &b"4.000000 0.000000"[..]));
    assert_eq!(expand(&format!("#<{}>", "n".repeat(200))), "######");
}

#[test]
fn what_the_probe_found() {
    let mut program = ready();
    program.run("G10 L2 P1 Z30");
    let place = PerAxis([Coordinate::mm(1), Coordinate::mm(2), Coordinate::mm(3)]);
    program.interpreter.set_probed(&place, true);
    program.run("G10 L2 P1 Z0");
    assert_eq!([x(&program, "#5061"), x(&program, "#5063"), x(&program, "#5070")], [1.0, -27.0, 1.0]);
    program.interpreter.reset();
    assert_eq!([x(&program, "#5061"), x(&program, "#5070")], [0.0, 0.0]);
}

/// `digit` is the value of a coordinate's last decimal: 0.001 mm for 11.125. A computed coordinate has the same
/// `digit` as a coordinate that is written as a number.
#[test]
fn digits_of_computed_values() {
    let mut program = ready();
    program.run("#1=10.125");
    let digit = |line: &str| program.check(line).unwrap().digit;
    assert_eq!(digit("X10.125"), digit("X#1"));
    assert_eq!(digit("X[#1+1]"), 1.0e-3);
    assert_eq!(digit("X[#1*2]"), 1.0e-2);
    assert_eq!(digit("X[10*SIN[31]]"), 1.0e-6);
}

proptest! {
    /// The sum of two numbers of four decimals, as programs write them, is exact.
    #[test]
    fn sums_are_exact(a in -99_999_999_i64..99_999_999, b in -99_999_999_i64..99_999_999) {
        let mut program = ready();
        let text = |value: i64| {
            let size = value.abs();
            format!("{}{}.{:04}", if value < 0 { "-" } else { "" }, size / 10_000, size % 10_000)
        };
        program.run(&format!("#1={} #<B>={}", text(a), text(b)));
        program.run("G0 G53 X#1 Y#<B> Z[#1+#<B>]");
        let place = program.interpreter.position().0;
        prop_assert_eq!(place, [Coordinate(a * 1000), Coordinate(b * 1000), Coordinate((a + b) * 1000)]);
    }

    /// Parameters that are set in any order read as a map would. M2 forgets #1 to #30 and the local names.
    #[test]
    fn parameters_are_kept(steps in prop::collection::vec((0_usize..40, 0_i32..1000, 0_u8..20), 1..120)) {
        let mut program = ready();
        let mut map = std::collections::BTreeMap::new();
        let name = |index: usize| match index {
            0..20 => format!("#{}", index * 7 + 1),
            20..30 => format!("#<LOCAL{index}>"),
            _ => format!("#<_G{index}>"),
        };
        for (index, value, event) in steps {
            program.run(&format!("{}={value}", name(index)));
            map.insert(index, value);
            if event == 0 {
                program.run("M2");
                map.retain(|index, _| (5..20).contains(index) || *index >= 30);
            }
        }
        for (index, value) in &map {
            prop_assert_eq!(x(&program, &name(*index)), f64::from(*value));
        }
        for index in (20..40).filter(|index| !map.contains_key(index)) {
            prop_assert_eq!(program.error(&format!("X{}", name(index))), 74);
        }
    }
}
