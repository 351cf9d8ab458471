//! Tests of M62 to M68, with which a program switches outputs and waits for inputs.

#![cfg(feature = "full")]

use crate::program::{DIALECTS, Program};
use oxmill_controller::gcode::{Dialect, InputWait, ProgramPins};
use oxmill_controller::units::{Decimal, Duration};

const NEW: [Dialect; 2] = [Dialect::Oxmill, Dialect::Seed];

#[test]
fn what_the_words_ask_for() {
    for dialect in NEW {
        let program = Program::new(dialect);
        let pins = |line: &str| program.check(line).unwrap_or_else(|error| panic!("{line}: {error:?}")).pins();
        for (word, on, with_motion) in
            [("M62", true, true), ("M63", false, true), ("M64", true, false), ("M65", false, false)]
        {
            let expected = Some(ProgramPins::Digital { number: 3, on, with_motion });
            assert_eq!(pins(&format!("{word} P3")), expected);
            assert_eq!(pins(&format!("N5 G0 X1 {word} P3")), expected);
        }
        for (word, with_motion) in [("M67", true), ("M68", false)] {
            let value = Decimal::from_int(-2);
            assert_eq!(pins(&format!("{word} E1 Q-2")), Some(ProgramPins::Analog { number: 1, value, with_motion }));
        }
        for (l, until) in [(1, InputWait::Rise), (2, InputWait::Fall), (3, InputWait::High), (4, InputWait::Low)] {
            let expected = ProgramPins::Wait { number: 0, until, longest: Duration::millis(1500) };
            assert_eq!(pins(&format!("M66 P0 L{l} Q1.5")), Some(expected));
        }
        let now = ProgramPins::Wait { number: 2, until: InputWait::Nothing, longest: Duration::from_ticks(0) };
        assert_eq!([pins("M66 P2"), pins("M66 P2 L0"), pins("M66 P2 Q-1")], [Some(now); 3]);
        assert_eq!(pins("M66 E1"), Some(ProgramPins::ReadAnalog { number: 1 }));
        // G4 and M64 share one P.
        let both = program.check("G4 P1 M64").unwrap();
        assert_eq!((both.dwell, both.pins().is_some()), (Some(Duration::secs(1)), true));
        assert_eq!(pins("G0 X1"), None);
    }
}

#[test]
fn what_is_refused() {
    for dialect in NEW {
        let mut program = Program::new(dialect);
        program.run("F300");
        for (line, error) in [
            ("M62", 28),
            ("M65 P0.5", 23),
            ("M64 P-1", 4),
            ("M64 P1 M65", 21),
            ("M64 P1 Q1", 36),
            ("M64 P1 L1", 36),
            ("M62 P1 E1", 36),
            ("E1", 36),
            ("G1 X1 E1", 36),
            ("M67 Q1", 28),
            ("M67 E1", 28),
            ("M68 E-1 Q1", 4),
            ("M68 E1 Q1 P1", 36),
            ("M66", 28),
            ("M66 L3 Q1", 28),
            ("M66 P1 E1", 36),
            ("M66 P1 L3", 28),
            ("M66 P1 L1 Q0", 39),
            ("M66 P1 L2 Q-1", 39),
            ("M66 P1 L5 Q1", 39),
            ("M66 P1 L-1 Q1", 39),
            ("M66 P1 L1.5 Q1", 23),
            ("M66 E1 L1 Q1", 39),
        ] {
            assert_eq!(program.error(line), error, "{line}");
        }
    }
    let grbl = Program::new(Dialect::Grbl);
    assert_eq!(["M62 P0", "M66 P0", "M68 E0 Q1", "E1"].map(|line| grbl.error(line)), [20; 4]);
    assert_eq!(DIALECTS.len(), 3);
}

#[test]
fn an_input_ends_the_wait_as_its_mode_says() {
    let all = [(false, false), (false, true), (true, true), (true, false)];
    for (mode, over) in [
        (InputWait::Nothing, [true, true, true, true]),
        (InputWait::Rise, [false, true, false, false]),
        (InputWait::Fall, [false, false, false, true]),
        (InputWait::High, [false, true, true, false]),
        (InputWait::Low, [true, false, false, true]),
    ] {
        assert_eq!(all.map(|(before, now)| mode.is_over(before, now)), over, "{mode:?}");
    }
}
