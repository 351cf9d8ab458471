//! Probing against a simulated plate: the contact position comes from the trace, not from the controller's report.

use super::bench::{AXES, Bench, HZ, STEPS, assert_place};
use oxmill_test_support::numbers;

const SETTINGS: &str = "$110=2000 $111=2000 $112=2000";

struct Case {
    /// Target of the probing move, mm from the power-up position.
    way: [f64; AXES],
    /// Axis along which the tool meets the plate.
    axis: usize,
    /// Position of the plate, in steps.
    at: i32,
    /// Whether the plate's contact closes when the axis moves in negative direction.
    negative: bool,
}

const CASES: [Case; 6] = [
    Case { way: [0.0, 0.0, -9.0], axis: 2, at: -1003, negative: true },
    Case { way: [0.0, 0.0, 8.0], axis: 2, at: 750, negative: false },
    Case { way: [7.5, 0.0, 0.0], axis: 0, at: 777, negative: false },
    Case { way: [-3.0, -8.0, 0.0], axis: 1, at: -901, negative: true },
    Case { way: [5.0, -4.0, -7.0], axis: 2, at: -1111, negative: true },
    Case { way: [6.0, 2.0, 1.0], axis: 1, at: 301, negative: false },
];

fn machine(case: &Case) -> String {
    format!(
        "steps_per_mm = [{STEPS}, {STEPS}, {STEPS}]\n[plate]\naxis = \"{}\"\nat_mm = {}\nside = \"{}\"\n",
        ["x", "y", "z"][case.axis],
        f64::from(case.at) / STEPS,
        if case.negative { "negative" } else { "positive" },
    )
}

impl Case {
    fn touches(&self, place: &[i32; AXES]) -> bool {
        let place = place[self.axis];
        if self.negative { place <= self.at } else { place >= self.at }
    }
}

fn words(place: [f64; AXES]) -> String {
    format!("X{} Y{} Z{}", place[0], place[1], place[2])
}

/// Returns the length in mm of a displacement in steps.
fn length(from: &[i32; AXES], to: &[i32; AXES]) -> f64 {
    let square: f64 = from.iter().zip(to).map(|(a, b)| (f64::from(b - a) / STEPS).powi(2)).sum();
    square.sqrt()
}

/// Sends a probe line. Returns the answers, and the position where the plate's contact changed to `closed`, if it
/// did.
fn probe(bench: &mut Bench, case: &Case, line: &str, closed: bool) -> (Vec<String>, Option<[i32; AXES]>) {
    bench.mill.trace_mut().restart();
    let said = bench.ask(line);
    bench.settle();
    let contact = bench.mill.trace().kept().iter().map(|r| r.position).find(|place| case.touches(place) == closed);
    (said, contact)
}

#[track_caller]
fn assert_latched(bench: &mut Bench, said: &[String], contact: Option<[i32; AXES]>, what: &str) -> [i32; AXES] {
    let contact = contact.unwrap_or_else(|| panic!("{what}: the plate never changed"));
    let report = said.iter().find(|l| l.starts_with("[PRB:")).unwrap_or_else(|| panic!("{what}: {said:?}"));
    assert!(report.ends_with(":1]"), "{what}: {report}");
    assert_place(numbers(report, "PRB").unwrap().map(|mm| mm * STEPS), contact, what);
    let (place, reported) = (bench.place(), bench.reported());
    assert_place(reported, place, what);
    assert_eq!(bench.state(), "Idle", "{what}");
    contact
}

#[test]
fn the_step_of_contact_is_latched() {
    for (number, case) in CASES.iter().enumerate() {
        for feed in [10.0, 60.0, 250.0, 600.0, 1000.0] {
            for acceleration in [30.0, 200.0, 1000.0] {
                let what = format!("case {number}, F{feed}, {acceleration} mm/s2");
                let mut bench = Bench::new(&machine(case), SETTINGS);
                for axis in 0..AXES {
                    assert_eq!(bench.ask(&format!("$12{axis}={acceleration}")), ["ok"]);
                }
                let (said, contact) = probe(&mut bench, case, &format!("G38.2 {} F{feed}", words(case.way)), true);
                let contact = assert_latched(&mut bench, &said, contact, &what);
                // The maximum braking distance from speed v is v²/2a, plus a step: the axes can brake with at least
                // `acceleration` (a) along the path.
                let way = length(&contact, &bench.place());
                let step = 1.0 / STEPS * f64::from(AXES as u32).sqrt();
                let allowed = f64::powi(feed / 60.0, 2) / (2.0 * acceleration) + step;
                assert!(way <= allowed, "{what}: {way} mm beyond the contact, {allowed} allowed");

                // Move off the plate again, and check the step at which the contact opens.
                let (said, contact) = probe(&mut bench, case, "G38.4 X0 Y0 Z0", false);
                assert_latched(&mut bench, &said, contact, &what);
                bench.carry_out("G0 X1 Y1 Z1");
                assert_eq!(bench.place(), [250; AXES], "{what}");
            }
        }
    }
}

#[test]
fn braking_after_a_contact_is_no_harder_than_the_axis_can() {
    let case = &CASES[0];
    let mut bench = Bench::new(&machine(case), SETTINGS);
    bench.ask("$122=100");
    let (_, contact) = probe(&mut bench, case, "G38.2 Z-9 F1000", true);
    let contact = contact.unwrap();
    // Braking from speed v takes v²/2a. The braking distance may be shorter by a step and by 2 %, because positions are
    // rounded to steps.
    let way = length(&contact, &bench.place());
    let needed = (1000.0_f64 / 60.0).powi(2) / 200.0;
    assert!(way >= needed * 0.98 - 1.0 / STEPS, "{way} mm of {needed}");
    let records = bench.mill.trace().kept();
    let braking = records.iter().position(|r| case.touches(&r.position)).unwrap();
    let times: Vec<u64> = records[braking..].iter().map(|r| r.at).collect();
    let speeds: Vec<f64> = times.windows(2).map(|w| HZ as f64 / (w[1] - w[0]) as f64 / STEPS).collect();
    assert!(speeds.len() > 100 && speeds.is_sorted_by(|a, b| a >= &(b * 0.999)), "{speeds:?}");
    // Compare speeds that are eight steps apart, because the times of single steps are rounded to ticks.
    for (index, ends) in speeds.windows(9).enumerate() {
        let deceleration = (ends[0] * ends[0] - ends[8] * ends[8]) / 16.0 * STEPS;
        assert!(deceleration <= 101.0, "step {index}: {deceleration} mm/s2");
    }
}

#[test]
fn the_four_words() {
    let case = &CASES[0];
    let far = "Z-9 F300";
    for (word, closed, reachable, alarm) in [
        ("G38.2", true, true, None),
        ("G38.3", true, true, None),
        ("G38.2", true, false, Some(5)),
        ("G38.3", true, false, None),
        ("G38.4", false, true, Some(4)),
        ("G38.5", false, true, Some(4)),
    ] {
        let mut bench = Bench::new(&machine(case), SETTINGS);
        let line = if reachable { format!("{word} {far}") } else { format!("{word} Z-4 F300") };
        let (said, contact) = probe(&mut bench, case, &line, closed);
        match alarm {
            None if reachable => {
                assert_latched(&mut bench, &said, contact, &line);
            }
            None => {
                assert_eq!(said, ["[PRB:0.000,0.000,-4.000:0]", "ok"], "{line}");
                assert_eq!((bench.place(), bench.state()), ([0, 0, -1000], "Idle".to_string()), "{line}");
            }
            Some(5) => assert_eq!(said, ["ALARM:5", "[PRB:0.000,0.000,0.000:0]", "ok"], "{line}"),
            Some(alarm) => assert_eq!(said, [format!("ALARM:{alarm}"), "ok".to_string()], "{line}"),
        }
        if alarm.is_some() {
            assert_eq!(bench.state(), "Alarm", "{line}");
            assert_eq!(bench.ask("$X"), ["[MSG:Caution: Unlocked]", "ok"], "{line}: the position is true");
            bench.carry_out("G0 Z0");
            assert_eq!(bench.place(), [0; AXES], "{line}");
        }
    }
    // The tool already touches the plate.
    for (line, said) in [("G38.2 Z-8", "ALARM:4"), ("G38.3 Z-8", "ALARM:4"), ("G38.4 Z-4.2", "ALARM:5")] {
        let mut bench = Bench::new(&machine(case), SETTINGS);
        bench.carry_out("G1 Z-5 F500");
        assert_eq!(bench.ask(line)[0], said, "{line}");
        bench.settle();
        assert_eq!(bench.state(), "Alarm", "{line}");
    }
}

/// Stops of all kinds while the probe seeks and while it brakes: the position stays the one that the pulses make, and
/// the probe can be repeated.
#[test]
fn a_probe_is_broken_off_at_any_moment() {
    let case = &CASES[4];
    let line = format!("G38.2 {} F1000", words(case.way));
    let settings = format!("{SETTINGS} $120=60 $121=60 $122=60");
    let whole = {
        let mut bench = Bench::new(&machine(case), &settings);
        let begin = bench.seconds();
        probe(&mut bench, case, &line, true);
        bench.seconds() - begin
    };
    for (what, bytes) in [("hold", b'!'), ("door", 0x84), ("stop", 0x19), ("reset", 0x18)] {
        for part in 1..60 {
            let mut bench = Bench::new(&machine(case), &settings);
            bench.send(format!("{line}\n"));
            bench.wait(whole * f64::from(part) / 60.0);
            let what = format!("{what} at {part}/60");
            let touched = case.touches(&bench.place());
            bench.send([bytes]);
            bench.wait(3.0);
            let (place, reported) = (bench.place(), bench.reported());
            assert_place(reported, place, &what);
            match bytes {
                b'!' | 0x84 => {
                    let state = bench.state();
                    assert!(state == "Hold:0" || state == "Door:0", "{what}: {state}");
                    let before = bench.read();
                    assert!(!before.iter().any(|l| l.starts_with("[PRB")), "{what}: {before:?}");
                    bench.send("~");
                    let said = bench.read_until(&what, |said| said.iter().any(|l| l == "ok"));
                    bench.settle();
                    let records: Vec<_> = bench.mill.trace().kept().iter().map(|r| r.position).collect();
                    let contact = records.into_iter().find(|place| case.touches(place));
                    assert_latched(&mut bench, &said, contact, &what);
                }
                0x19 => {
                    assert_eq!(bench.state(), "Idle", "{what}");
                    assert!(bench.mill.controller().is_trusted(), "{what}");
                }
                _ => {
                    assert_eq!(bench.state(), "Alarm", "{what}");
                    assert!(!bench.mill.controller().is_trusted(), "{what}");
                    bench.ask("$X");
                }
            }
            bench.read();
            bench.carry_out("G90 G0 X0 Y0 Z1");
            assert_eq!(bench.place(), [0, 0, 250], "{what}, touched {touched}");
            let (said, contact) = probe(&mut bench, case, &line, true);
            assert_latched(&mut bench, &said, contact, &what);
        }
    }
}

/// The door opens during a probe and the tool is parked ($41). A contact while the tool retracts, is parked or returns
/// must not count, because the controller would report the position of this contact as the position of the plate.
#[test]
fn a_parked_tool_makes_no_contact() {
    let switches: String =
        ["x", "y", "z"].map(|axis| format!("[[switch]]\naxis = \"{axis}\"\nat_mm = 2\nside = \"positive\"\n")).concat();
    let settings = format!(
        "{SETTINGS} $22=1 $24=300 $25=1500 $26=10 $130=60 $131=60 $132=60 $41=1 $56=0.5 $57=120 $58=-3 $59=600 $392=0.1 $122=200"
    );
    let mut homed = Bench::new(&format!("steps_per_mm = [{STEPS}, {STEPS}, {STEPS}]\n{switches}"), &settings);
    homed.carry_out("$H");
    homed.carry_out("G53 G0 X-5 Y-5 Z-5");
    let zero = homed.reported()[2] - f64::from(homed.place()[2]);
    for (word, before) in [("G38.2", 0), ("G38.5", 1)] {
        let touch = |bench: &mut Bench, closed: i32| bench.pin(&format!("probe {closed}"));
        for moment in 1..30 {
            let what = format!("{word}, moment {moment}");
            let mut bench = homed.clone();
            touch(&mut bench, before);
            bench.send(format!("{word} Z-9 F120\n"));
            bench.wait(0.5);
            bench.send([0x84]);
            for part in 0..40 {
                if part == moment {
                    touch(&mut bench, 1 - before);
                } else if part == moment + 1 {
                    touch(&mut bench, before);
                }
                if part == 20 {
                    bench.send("~");
                }
                bench.wait(0.05);
            }
            assert!(!bench.read().iter().any(|line| line.starts_with("[PRB")), "{what}");
            assert_eq!(bench.state(), "Run", "{what}");
            touch(&mut bench, 1 - before);
            let contact = f64::from(bench.place()[2]) + zero;
            bench.settle();
            let said = bench.read();
            let report =
                said.iter().find(|line| line.starts_with("[PRB:")).unwrap_or_else(|| panic!("{what}: {said:?}"));
            let latched = numbers::<AXES>(report, "PRB").unwrap()[2] * STEPS;
            assert!((latched - contact).abs() < 1.5, "{what}: {report}, closed at {contact} steps");
            assert!((bench.reported()[2] - f64::from(bench.place()[2]) - zero).abs() < 0.01, "{what}");
        }
    }
}
