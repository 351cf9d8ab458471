//! Homing with switches that bounce, stick or are missing, and interruptions during homing.

use super::bench::{AXES, Bench, STEPS, assert_place};

/// Positions at which the switches close, in steps from the power-up position.
const AT: [i32; AXES] = [533, 1217, 841];
/// `$27` in steps.
const PULL_OFF: i32 = 375;
/// `$130` to `$132`, mm.
const TRAVEL: f64 = 12.0;

const SETTINGS: &str = "$22=1 $24=60 $25=480 $26=20 $27=1.5 $120=100 $121=100 $122=100 $130=12 $131=12 $132=12";

/// Returns the description of a machine with switches at [`AT`]. `to_negative`: mask of the axes that home in
/// negative direction. Their switches are at the mirrored (negative) positions.
fn machine(to_negative: u8, bounce_us: u32) -> String {
    let mut text = format!("steps_per_mm = [{STEPS}, {STEPS}, {STEPS}]\n");
    for (axis, letter) in ["x", "y", "z"].into_iter().enumerate() {
        let (sign, side) = if to_negative >> axis & 1 == 1 { (-1.0, "negative") } else { (1.0, "positive") };
        let at_mm = sign * f64::from(AT[axis]) / STEPS;
        text +=
            &format!("[[switch]]\naxis = \"{letter}\"\nat_mm = {at_mm}\nside = \"{side}\"\nbounce_us = {bounce_us}\n");
    }
    text
}

fn home(bench: &mut Bench) -> Vec<String> {
    bench.ask("$H")
}

/// Asserts that homing has ended at the switches, according to the steps and the report.
#[track_caller]
fn assert_homed(bench: &mut Bench, to_negative: u8, what: &str) {
    bench.settle();
    let sign = |axis: usize| if to_negative >> axis & 1 == 1 { -1 } else { 1 };
    assert_eq!(bench.place(), std::array::from_fn(|axis| sign(axis) * (AT[axis] - PULL_OFF)), "{what}");
    let pull_off = f64::from(PULL_OFF);
    let expected =
        std::array::from_fn(|axis| if sign(axis) < 0 { (pull_off - TRAVEL * STEPS) as i32 } else { -pull_off as i32 });
    let reported = bench.reported();
    assert_place(reported, expected, what);
    assert_eq!(bench.state(), "Idle", "{what}");
    assert!(bench.mill.controller().is_trusted(), "{what}");
}

#[test]
fn a_bouncing_switch_is_found_to_the_step() {
    for to_negative in [0, 7, 2] {
        // At the rate of `$24` a step takes 4 ms, longer than all these bounces.
        for bounce_us in [0, 50, 300, 1000, 2900] {
            let mut bench = Bench::new(&machine(to_negative, bounce_us), SETTINGS);
            assert_eq!(bench.ask(&format!("$23={to_negative}")), ["ok"]);
            assert_eq!(home(&mut bench), ["ok"]);
            let what = format!("mask {to_negative}, bounce {bounce_us} us");
            assert_homed(&mut bench, to_negative, &what);
            // Home again, first from the homed position and then from another one.
            assert_eq!(home(&mut bench), ["ok"]);
            assert_homed(&mut bench, to_negative, &what);
            bench.carry_out("G90 G53 G0 X-5 Y-6 Z-7");
            assert_eq!(home(&mut bench), ["ok"]);
            assert_homed(&mut bench, to_negative, &what);
        }
    }
}

#[test]
fn one_axis_alone_is_homed_alone() {
    let mut bench = Bench::new(&machine(0, 700), SETTINGS);
    assert_eq!(bench.ask("$HY"), ["ok"]);
    bench.settle();
    assert_eq!(bench.place(), [0, AT[1] - PULL_OFF, 0]);
    assert!(!bench.mill.controller().is_trusted(), "two axes are still where they were");
    for command in ["$HX", "$HZ"] {
        assert_eq!(bench.ask(command), ["ok"]);
        bench.settle();
    }
    assert!(bench.mill.controller().is_trusted(), "each axis has been homed");
}

#[test]
fn homing_begins_on_a_switch_that_is_closed_already() {
    // The switch of X is at -1 mm, so it is already closed at power-up: the pull-off must open it.
    let text = machine(0, 700).replace(&format!("at_mm = {}", f64::from(AT[0]) / STEPS), "at_mm = -1.0");
    let mut bench = Bench::new(&text, SETTINGS);
    // The input filter delays by 0.4 ms.
    bench.wait(0.01);
    assert!(bench.status().contains("Pn:X"), "{}", bench.status());
    assert_eq!(home(&mut bench), ["ok"]);
    bench.settle();
    assert_eq!(bench.place()[0], -250 - PULL_OFF);
}

/// Asserts the state after a failed homing: the alarm was sent, the line was answered, the machine is locked and at
/// rest, and its position is not trusted. Then asserts that `$X` and `$H` work.
#[track_caller]
fn assert_failed(bench: &mut Bench, said: &[String], alarm: u8, what: &str) {
    let alarms: Vec<&String> = said.iter().filter(|l| l.starts_with("ALARM")).collect();
    assert_eq!(alarms, [&format!("ALARM:{alarm}")], "{what}: {said:?}");
    assert_eq!(said.iter().filter(|l| *l == "ok").count(), 1, "{what}: {said:?}");
    assert_eq!(bench.state(), "Alarm", "{what}");
    assert!(!bench.mill.controller().is_trusted(), "{what}");
    let place = bench.place();
    let reported = bench.reported();
    bench.wait(1.0);
    assert_eq!(bench.place(), place, "{what}: it goes on after the alarm");
    // If the homing cycle of an axis was complete, the position of this axis counts from its switch. Otherwise the
    // position counts from the power-up position.
    let place = std::array::from_fn(|axis| {
        let homed = place[axis] - AT[axis];
        if (reported[axis] - f64::from(homed)).abs() < 0.01 { homed } else { place[axis] }
    });
    assert_place(reported, place, what);
    assert_eq!(bench.ask("G0 X0"), ["error:9"], "{what}");
}

fn until_welcome(bench: &mut Bench, what: &str) -> Vec<String> {
    bench.read_until(what, |said| said.iter().any(|l| l.contains("to unlock]")))
}

#[test]
fn a_switch_that_never_closes_ends_in_an_alarm() {
    let mut bench = Bench::new("", SETTINGS);
    bench.send("$H\n");
    let said = until_welcome(&mut bench, "no switch");
    assert_failed(&mut bench, &said, 9, "no switch");
    assert_eq!(bench.place()[2], (1.5 * TRAVEL * STEPS) as i32, "as far as the longest axis and a half");
    assert_eq!(bench.ask("$X").last().unwrap(), "ok");
    bench.carry_out("G91 G1 X-1 F400");
}

#[test]
fn a_switch_that_is_not_found_again_ends_in_an_alarm() {
    let mut bench = Bench::new("", SETTINGS);
    bench.send("$H\n");
    bench.wait(0.5);
    bench.pin("limit z 1");
    bench.wait(0.01);
    bench.pin("limit z 0");
    let said = until_welcome(&mut bench, "not found again");
    assert_failed(&mut bench, &said, 9, "not found again");
}

#[test]
fn a_switch_that_does_not_open_again_ends_in_an_alarm() {
    let mut bench = Bench::new("", SETTINGS);
    bench.send("$H\n");
    bench.wait(0.5);
    bench.pin("limit z 1");
    let said = until_welcome(&mut bench, "stuck");
    assert_failed(&mut bench, &said, 8, "stuck");
    bench.pin("limit z 0");
}

type Act = fn(&mut Bench);

/// An interruption at any time of the cycle raises the right alarm, and everything works afterwards.
#[test]
fn homing_is_broken_off_at_any_moment() {
    let mut whole = Bench::new(&machine(0, 900), SETTINGS);
    home(&mut whole);
    let cycle = whole.seconds();
    let breaks: [(u8, &str, Act); 5] = [
        (6, "0x18", |b| b.send([0x18])),
        (6, "reset pin", |b| {
            b.pin("reset 1");
            b.pin("reset 0");
        }),
        (6, "0x19", |b| b.send([0x19])),
        (7, "0x84", |b| b.send([0x84])),
        (7, "door pin", |b| b.pin("door 1")),
    ];
    for (number, (alarm, what, act)) in breaks.into_iter().enumerate() {
        // No phase lasts a multiple of the interval between the moments, so each phase is interrupted at different
        // points.
        let mut moment = 0.003 + number as f64 * 0.017;
        let mut moments = 0;
        while moment < cycle {
            let mut bench = Bench::new(&machine(0, 900), SETTINGS);
            bench.send("$H\n");
            bench.wait(moment);
            if bench.state() != "Home" {
                break;
            }
            act(&mut bench);
            let what = format!("{what} after {moment:.3} s");
            let said = until_welcome(&mut bench, &what);
            assert_failed(&mut bench, &said, alarm, &what);
            if alarm == 7 {
                assert_eq!(
                    bench.ask("$X"),
                    if what.starts_with("door") { vec!["error:13"] } else { unlocked() },
                    "{what}"
                );
                bench.pin("door 0");
            }
            if bench.state() == "Alarm" {
                assert_eq!(bench.ask("$X"), unlocked(), "{what}");
            }
            assert_eq!(home(&mut bench), ["ok"], "{what}");
            assert_homed(&mut bench, 0, &what);
            moment += 0.107;
            moments += 1;
        }
        assert!(moments > 30, "{what}: {moments} moments of {cycle} s");
    }
}

/// The laser stays off while homing waits for a switch to settle, and after the end of homing, until the program
/// switches it on again.
#[test]
fn no_beam_is_on_while_homing() {
    let mut bench = Bench::new(&machine(0, 900), SETTINGS);
    for line in ["$32=1", "$26=200", "$X", "G1 F500 M3 S1000"] {
        assert_eq!(bench.ask(line).last().unwrap(), "ok", "{line}");
    }
    assert_eq!(bench.mill.power(), u16::MAX);
    bench.send("$H\n");
    while bench.state() != "Idle" {
        assert_eq!(bench.mill.power(), 0, "{}", bench.status());
        bench.wait(0.005);
    }
    bench.wait(0.1);
    assert_homed(&mut bench, 0, "with a laser");
    assert_eq!(bench.mill.power(), 0);
    assert!(bench.ask("$G").iter().any(|said| said.contains(" M5 ")));
}

fn unlocked() -> Vec<&'static str> {
    vec!["[MSG:Caution: Unlocked]", "[MSG:The position may be lost: home before using machine coordinates]", "ok"]
}

/// Holds, cycle starts, jog cancels, status requests and lines have no effect on homing.
#[test]
fn nothing_else_disturbs_homing() {
    for bytes in ["!", "~", "\u{85}", "G0 X100\n", "$J=G91X1F100\n", "?????", "$X\n"] {
        let mut bench = Bench::new(&machine(0, 900), SETTINGS);
        assert_eq!(bench.ask("$21=1"), ["ok"]);
        let bytes: Vec<u8> = bytes.chars().map(|c| c as u8).collect();
        bench.send("$H\n");
        for _ in 0..100 {
            bench.wait(0.05);
            if bench.state() != "Home" {
                break;
            }
            bench.send(&bytes);
            // Lines wait until homing has ended, so one line is enough.
            if bytes.ends_with(b"\n") {
                break;
            }
        }
        bench.read_until("homed", |said| said.iter().any(|l| l == "ok"));
        if bytes.starts_with(b"G0") || bytes.starts_with(b"$J") {
            continue;
        }
        bench.settle();
        assert_homed(&mut bench, 0, &format!("{bytes:?}"));
    }
}

/// With `$932` machine zero is the position where homing ends, clear of the switch, and the travel extends away from
/// the switch.
#[test]
fn with_zero_at_the_pull_off_nothing_that_goes_to_zero_meets_a_switch() {
    for to_negative in 0..8 {
        let mut bench = Bench::new(&machine(to_negative, 300), SETTINGS);
        for setting in [&format!("$23={to_negative}"), "$21=1", "$932=1", "$20=1"] {
            assert_eq!(bench.ask(setting), ["ok"]);
        }
        assert_eq!(home(&mut bench), ["ok"]);
        bench.settle();
        let home = bench.place();
        let sign = [0, 1, 2].map(|axis| if to_negative >> axis & 1 == 1 { -1 } else { 1 });
        let what = format!("mask {to_negative}");
        assert_eq!(home, std::array::from_fn(|axis| sign[axis] * (AT[axis] - PULL_OFF)), "{what}");
        assert_place(bench.reported(), [0; AXES], &what);
        // Post-processors write these lines at the beginning and the end of a program. They lead axes to zero from
        // another position, and no switch may close on the way.
        for line in ["G28 G91 Z0", "G28 G91 X0 Y0", "G30", "G90 G53 G0 X0 Y0 Z0"] {
            let [x, y, z] = sign.map(|sign| -5 * sign);
            bench.carry_out(&format!("G90 G53 G0 X{x} Y{y} Z{z}"));
            bench.carry_out(line);
        }
        assert_eq!(bench.place(), home, "{what}");
        // `$932` does not move the far end of the travel: this end is as far from the position at which the switch
        // closes as the travel is long.
        for axis in 0..AXES {
            let letter = ["X", "Y", "Z"][axis];
            let end = -sign[axis] as f64 * (TRAVEL - 1.5);
            bench.carry_out(&format!("G53 G0 {letter}{end}"));
            let from_switch = (bench.place()[axis] - sign[axis] * AT[axis]) * -sign[axis];
            assert_eq!(from_switch, (TRAVEL * STEPS) as i32, "{what} {letter}");
            bench.carry_out(&format!("G53 G0 {letter}0"));
            for beyond in [end - 0.02 * sign[axis] as f64, 0.02 * sign[axis] as f64] {
                let mut bench = bench.clone();
                bench.send(format!("G53 G0 {letter}{beyond}\n"));
                let said = bench.read_until(&what, |said| said.iter().any(|line| line.starts_with("ALARM")));
                assert!(said.iter().any(|line| line == "ALARM:2"), "{what} {letter}{beyond}: {said:?}");
            }
            // With `$40` a jog past the far end of the travel stops at that end, and a jog past zero stops at zero.
            let mut bench = bench.clone();
            assert_eq!(bench.ask("$40=1"), ["ok"]);
            for (by, place) in [(-20 * sign[axis], end), (40 * sign[axis], 0.0)] {
                assert_eq!(bench.ask(&format!("$J=G91 {letter}{by} F2000")), ["ok"]);
                bench.settle();
                assert!((bench.reported()[axis] - place * STEPS).abs() < 0.01, "{what} {letter}{by}");
            }
        }
        assert_eq!(bench.state(), "Idle");
    }
}

/// After a change that moves machine zero the homed coordinates are wrong, so the machine must be homed again.
#[test]
fn another_machine_zero_has_to_be_homed() {
    for (settings, renames, keeps) in [
        (vec![], vec!["$932=1", "$23=1"], vec!["$27=1", "$130=20"]),
        (vec!["$932=1"], vec!["$932=0", "$27=1", "$23=1"], vec!["$130=20", "$932=1", "$27=1.5"]),
        (vec!["$23=1"], vec!["$932=1", "$130=20"], vec!["$27=1"]),
        (vec!["$23=1", "$932=1"], vec!["$27=1"], vec!["$130=20"]),
    ] {
        let to_negative = u8::from(settings.contains(&"$23=1"));
        let mut bench = Bench::new(&machine(to_negative, 300), SETTINGS);
        for setting in &settings {
            assert_eq!(bench.ask(setting), ["ok"]);
        }
        assert_eq!(home(&mut bench), ["ok"]);
        bench.settle();
        for (changes, is_trusted) in [(renames, false), (keeps, true)] {
            for change in changes {
                let mut bench = bench.clone();
                assert_eq!(bench.ask(change), ["ok"]);
                assert_eq!(bench.mill.controller().is_trusted(), is_trusted, "{settings:?}, then {change}");
            }
        }
    }
}
