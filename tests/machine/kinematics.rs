//! Machines other than three carriages with one motor each: belts that move two axes, and an axis with two motors.

use super::host::CARVER;
use oxmill_simulator::{Fittings, Options, Simulator};
use std::fmt::Write;

fn machine(description: &str, settings: &str) -> Simulator {
    let fittings = Fittings::parse(description).unwrap();
    let mut mill = Simulator::new(Options { keep_steps: true, fittings, ..Options::default() });
    for line in settings.lines() {
        mill.send(format!("{line}\n"));
        assert!(mill.run_until_idle());
    }
    assert!(!mill.take_output().contains("error"));
    mill
}

fn run(mill: &mut Simulator, text: &str) -> String {
    for line in text.lines() {
        mill.send(format!("{line}\n"));
        assert!(mill.run_until_idle(), "{line}");
    }
    mill.take_output()
}

/// Returns a program with a zigzag, a circle and a spiral of short chords.
fn job() -> String {
    let mut text = String::from("G21 G90 G17\nG1 X20 Y3 F3000\nX-4 Y7 Z-1\nG0 X10 Y0\nG2 X10 Y0 I-10 J0 F2400\n");
    for k in 0..200 {
        let turn = f64::from(k) * 0.11;
        let radius = 3.0 + 0.02 * f64::from(k);
        writeln!(text, "G1 X{:.3} Y{:.3}", radius * turn.cos(), radius * turn.sin()).unwrap();
    }
    text.push_str("G1 X1 Y-3\n");
    text
}

#[test]
fn belts_draw_the_same_picture() {
    let settings = format!("{CARVER}$120=300\n");
    let mut cartesian = machine("steps_per_mm = [80, 80, 80]", &settings);
    let mut belts = machine("steps_per_mm = [80, 80, 80]", &format!("{settings}$0=3\n$904=1\n"));
    assert!(!run(&mut cartesian, &job()).contains("error"));
    assert!(!run(&mut belts, &job()).contains("error"));
    assert_eq!(belts.machine_position(), cartesian.machine_position());
    let [x, y, z] = cartesian.machine().position();
    let [a, b, belt_z] = belts.machine().position();
    assert_eq!((a, b, belt_z), (x + y, x - y, z));
    // Every position of the machine with belts must lie on the path of the Cartesian one. The allowance of 1.5 steps
    // covers a step and the rounding on both machines.
    let path: Vec<[f64; 2]> =
        cartesian.trace().kept().iter().map(|r| [0, 1].map(|i| f64::from(r.position[i]))).collect();
    let mut near = 0_usize;
    for record in belts.trace().kept() {
        let [a, b] = [0, 1].map(|i| f64::from(record.position[i]));
        let place = [0.5 * (a + b), 0.5 * (a - b)];
        let off = |p: &[f64; 2]| (p[0] - place[0]).hypot(p[1] - place[1]);
        // Both machines pass the positions in the same order, so search near the previous match.
        let window = near.saturating_sub(200)..(near + 400).min(path.len());
        near = window.min_by(|i, k| off(&path[*i]).total_cmp(&off(&path[*k]))).unwrap();
        assert!(off(&path[near]) < 1.5, "{place:?} is off by {}", off(&path[near]));
    }
    assert!(near + 2 >= path.len(), "the whole path was followed");
    // The speed along the path is the same on both machines. So the times are the same, too. They differ only by the
    // rounding of corners to steps.
    let (one, other) = (cartesian.busy_ticks() as f64, belts.busy_ticks() as f64);
    assert!((one / other - 1.0).abs() < 0.01, "{one} {other}");
}

const BELTS: &str = r#"
    steps_per_mm = [80, 80, 80]
    kinematics = "corexy"
    [[switch]]
    axis = "x"
    at_mm = 3.0
    side = "positive"
    bounce_us = 700
    [[switch]]
    axis = "y"
    at_mm = 7.0
    side = "positive"
    bounce_us = 300
    [[switch]]
    axis = "z"
    at_mm = 1.5
    side = "positive"
"#;

#[test]
fn belts_find_home_one_axis_or_two_at_a_time() {
    for cycles in ["", "$45=1\n$46=2\n", "$44=2\n$45=1\n$46=4\n"] {
        let mut mill = machine(BELTS, &format!("{CARVER}$0=3\n$904=1\n$22=1\n$27=2\n{cycles}"));
        assert!(run(&mut mill, "$H").ends_with("ok\r\n"));
        assert_eq!(mill.machine_position(), [-2.0; 3]);
        let [a, b, z] = mill.machine().position();
        // After homing, each axis rests 2 mm from its switch. The rest position is off by the distance that the axis
        // covers until the filter reports the switch: the filter's delay times the locate speed.
        assert!((a + b - 2 * 80).abs() <= 2 && (a - b - 2 * 400).abs() <= 2 && (z + 40).abs() <= 1, "{a} {b} {z}");
        run(&mut mill, "G53 G0 X-10 Y-20");
        let [a2, b2, _] = mill.machine().position();
        assert_eq!(((a2 + b2) - (a + b), (a2 - b2) - (a - b)), (-2 * 8 * 80, -2 * 18 * 80));
    }
}

fn gantry(racked_mm: f64, second_at_mm: f64) -> String {
    format!(
        r#"
        steps_per_mm = [80, 80, 80]
        racked_mm = {racked_mm}
        [[switch]]
        axis = "x"
        at_mm = 3.0
        side = "positive"
        bounce_us = 700
        [[switch]]
        axis = "y"
        at_mm = 7.0
        side = "positive"
        bounce_us = 300
        [[switch]]
        axis = "y"
        second_motor = true
        at_mm = {second_at_mm}
        side = "positive"
        bounce_us = 900
        [[switch]]
        axis = "z"
        at_mm = 1.5
        side = "positive"
    "#
    )
}

const SQUARED: &str = "$22=1\n$27=2\n$905=2\n$907=1\n$130=100\n$131=100\n";

#[test]
fn a_crooked_gantry_comes_home_square() {
    for racked in [-1.3, 0.0, 0.9] {
        let mut mill = machine(&gantry(racked, 7.0), &format!("{CARVER}{SQUARED}"));
        let said = run(&mut mill, "$H");
        assert!(said.ends_with("ok\r\n"), "{racked}: {said}");
        let (first, second) = (mill.machine().position()[1], mill.machine().second_motor());
        let crooked = f64::from(second - first) / 80.0 + racked;
        assert!(crooked.abs() <= 1.5 / 80.0, "{racked}: still {crooked} mm off");
        assert_eq!(mill.machine_position(), [-2.0; 3]);
        // After homing, the two motors of Y move together.
        run(&mut mill, "G53 G0 Y-20");
        assert_eq!(mill.machine().position()[1] - first, -18 * 80);
        assert_eq!(mill.machine().second_motor() - second, -18 * 80);
    }
}

#[test]
fn a_gantry_is_not_pulled_apart() {
    // One motor may move at most 5 % of the travel of 100 mm without the other, which is 5 mm.
    let mut mill = machine(&gantry(0.0, 30.0), &format!("{CARVER}{SQUARED}"));
    let said = run(&mut mill, "$H");
    assert!(said.contains("ALARM:10\r\n"), "{said}");
    let (first, second) = (mill.machine().position()[1], mill.machine().second_motor());
    assert!((second - first) as f64 <= 5.0 * 80.0 + 1.0, "{first} {second}");
    // After the alarm both motors follow the axis again.
    run(&mut mill, "$X\nG91 G0 Y-1");
    assert_eq!((mill.machine().position()[1], mill.machine().second_motor()), (first - 80, second - 80));
}

#[test]
fn a_second_switch_is_a_limit_of_its_axis() {
    let mut mill = machine("steps_per_mm = [80, 80, 80]", &format!("{CARVER}$21=1\n$905=1\n$907=1\n"));
    mill.send("G1 X20 F600\n");
    mill.run_for(std::time::Duration::from_millis(500));
    assert_eq!(mill.pin_line("second_limit 1"), "ok");
    mill.run_for(std::time::Duration::from_millis(10));
    assert!(mill.take_output().contains("ALARM:1\r\n"));
    mill.send("?");
    assert!(mill.take_output().contains("|Pn:X"));
}

/// A coordinate of 50 m is the maximum. It applies to every point of an arc, not only to its end. It also applies to
/// each motor: with belts, one motor moves by X + Y and the other by X - Y.
#[test]
fn what_leads_out_of_range_is_refused() {
    let settings = "$100=1\n$101=1\n$110=1000000\n$111=1000000\n$120=10000\n$121=10000\nG1 F6000000\n";
    for (arrangement, line, refused) in [
        (0, "G1 X30000 Y30000", false),
        (1, "G1 X30000 Y30000", true),
        (1, "G28 X30000 Y-30000", true),
        (1, "$J=X30000 Y-30000 F600000", true),
        (1, "G1 X20000 Y-29000", false),
        (0, "G2 X0 Y0 I40000", true),
        (0, "G2 X0 Y0 I20000", false),
        (0, "G2 X0 Y0 I0 J-20000 P2", false),
        (1, "G2 X0 Y0 I30000 J-20000", true),
        (1, "G2 X0 Y0 I1000 J-2000", false),
    ] {
        let mut mill = machine("steps_per_mm = [1, 1, 80]", &format!("$904={arrangement}\n{settings}"));
        let said = run(&mut mill, line);
        assert_eq!(said.contains("error:33"), refused, "{arrangement} {line}: {said}");
        assert_eq!(mill.machine_position() == [0.0; 3], refused || line.starts_with("G2"), "{line}");
    }
}
