//! Emergency stop and driver fault at any time during a job, and what must not happen afterwards.

use super::bench::{Bench, assert_place};
use oxmill_controller::messages::SpindleDirection;

const SETTINGS: &str = "$21=1 $110=3000 $111=3000 $112=3000 $120=200 $121=200 $122=200";
const JOB: &str = "M3 S500 M8\nN1 G1 X2 F1500\nN2 G2 X4 Y2 I2 J0\nN3 G4 P0.2\nN4 G0 X0 Y0\nM0\nG1 X1\n";

fn everything_off(bench: &Bench, drivers: bool, what: &str) {
    let outputs = bench.mill.outputs().expect("the outputs have been set");
    assert_eq!(outputs.spindle, SpindleDirection::Off, "{what}");
    assert!(outputs.power == 0 && !outputs.coolant.flood && !outputs.coolant.mist, "{what}");
    assert_eq!(outputs.drivers, drivers, "{what}");
    assert!(!bench.mill.is_stepping(), "{what}");
}

/// Activates the pin at `moment` (s) in the job. Checks that motion, spindle, power and coolant are off at once and
/// stay off, whatever a host or an operator does, and that the machine can be unlocked after the pin is released.
fn press(pin: &str, alarm: u8, error: u8, drivers_off: bool, moment: f64) {
    let mut bench = Bench::new("", SETTINGS);
    assert_eq!(bench.ask(&format!("$913={}", u8::from(drivers_off))), ["ok"]);
    bench.send(JOB);
    bench.wait(moment);
    let what = format!("{pin} at {moment} s, $913={drivers_off}");
    // If the machine was at rest, the idle delay (`$1`) can already have switched the drivers off. Then the pin must
    // not switch them on.
    let (moving, drivers) = (bench.mill.is_stepping(), bench.mill.outputs().is_some_and(|o| o.drivers));
    bench.read();
    bench.pin(&format!("{pin} 1"));
    let place = bench.place();
    everything_off(&bench, drivers && !drivers_off, &what);
    let said = bench.read();
    assert!(said.contains(&format!("ALARM:{alarm}")), "{what}: {said:?}");
    assert_place(bench.reported(), place, &what);
    let trusted = !moving && !drivers_off && pin != "fault";
    assert_eq!(bench.mill.controller().is_trusted(), trusted, "{what}");
    // While the input is active, nothing that a host or an operator does starts the machine again.
    for round in 0..2 {
        for bytes in ["~", "$X\n", "$H\n", "G1 X9 F500\n", "$J=G91 X1 F100\n", "M3 S100\n", "\u{a0}"] {
            bench.send(bytes);
        }
        for pin in ["start 1", "start 0", "door 1", "door 0", "hold 1", "hold 0"] {
            bench.pin(pin);
        }
        bench.wait(0.5);
        everything_off(&bench, drivers && !drivers_off, &what);
        assert_eq!(bench.place(), place, "{what}");
        let said = bench.read();
        assert_eq!(said.contains(&format!("error:{error}")), round == 1, "{what}: {said:?}");
        bench.send([0x18]);
        bench.wait(0.1);
        let said = bench.read();
        assert!(said.contains(&format!("ALARM:{alarm}")), "{what}: a reset says it again, {said:?}");
    }
    bench.pin(&format!("{pin} 0"));
    bench.wait(0.1);
    assert_eq!(bench.state(), "Alarm", "{what}: only `$X` ends it");
    let said = bench.ask("$X");
    assert_eq!(said.iter().any(|line| line.contains("may be lost")), !trusted, "{what}: {said:?}");
    bench.carry_out("G91 G1 X0.4 F1000");
    assert_eq!(bench.place()[0], place[0] + 100, "{what}");
}

#[test]
fn an_emergency_at_any_moment() {
    for step in 0..16 {
        let moment = 0.013 + 0.11 * f64::from(step);
        press("estop", 101, 50, false, moment);
        press("fault", 102, 51, step % 2 == 1, moment);
    }
    press("estop", 101, 50, true, 0.2);
}

/// A limit switch stops the machine only if the settings enable hard limits (`$21`).
#[test]
fn a_limit_switch_stops_only_where_hard_limits_are_on() {
    let mut bench = Bench::new("", "$120=200");
    bench.send("G1 X5 F1500\n");
    bench.wait(0.1);
    bench.pin("limit y 1");
    bench.wait(0.05);
    assert!(bench.mill.is_stepping());
    bench.pin("limit y 0");
    bench.settle();
    assert_eq!(bench.ask("$21=1"), ["ok", "ok"]);
    bench.send("N5 G1 X0 F1500\n");
    bench.wait(0.1);
    bench.pin("limit y 1");
    assert!(!bench.mill.is_stepping(), "in the same moment");
    let said = bench.read();
    assert!(
        said.iter().any(|line| line.starts_with("[MSG:Limit switch Y at") && line.ends_with("line 5]")),
        "{said:?}"
    );
}

/// A limit switch that closes during an alarm changes nothing, because the machine is already at rest: the alarm stays
/// the same, and `$X` still ends it.
#[test]
fn a_limit_switch_in_an_alarm_changes_nothing() {
    let mut bench = Bench::new("", "$21=1");
    bench.send("G1 X5 F400\n");
    bench.wait(0.2);
    bench.send([0x18]);
    bench.wait(0.1);
    bench.read();
    assert_eq!(bench.state(), "Alarm");
    bench.pin("limit x 1");
    bench.pin("limit x 0");
    bench.wait(0.1);
    assert_eq!(bench.read(), [""; 0]);
    assert_eq!(bench.state(), "Alarm");
    assert_eq!(bench.ask("$X").last().map(String::as_str), Some("ok"));
    let before = bench.place();
    bench.carry_out("G91 G1 X0.4 F1000");
    assert_eq!(bench.place()[0], before[0] + 100);
}

/// Several stops and the reset button overlap: afterwards the machine can be unlocked and moves again.
#[test]
fn stops_on_top_of_each_other() {
    let mut bench = Bench::new("", "$21=1 $120=200");
    bench.send("G1 X5 F1500\n");
    bench.wait(0.1);
    for line in [
        "limit x 1",
        "estop 1",
        "reset 1",
        "fault 1",
        "estop 0",
        "estop 1",
        "reset 0",
        "estop 0",
        "fault 0",
        "limit x 0",
    ] {
        bench.pin(line);
    }
    bench.send([0x18, 0x18]);
    bench.wait(0.1);
    bench.read();
    assert_eq!(bench.ask("$X").last().map(String::as_str), Some("ok"));
    let before = bench.place();
    bench.carry_out("G91 G1 X0.4 F1000");
    assert_eq!(bench.place()[0], before[0] + 100);
}
