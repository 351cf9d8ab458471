//! Homes a simulated machine before its job and sets its work zero (`--work-zero`), so that soft limits act during the
//! job. Adds the switches that the settings imply, and sends `$H` and G10 L2 like a host.

use crate::boards::AXES;
use crate::fittings::HomeSwitches;
use crate::power_up::{error_text, messages_of};
use crate::simulator::Simulator;
use oxmill_controller::axes::LINEAR;
use oxmill_controller::settings::{AxisKey, Key};
use std::time::Duration;

/// Time that the input filter needs to report new switches.
const SETTLING: Duration = Duration::from_millis(5);
/// Tolerance between the requested and the actual work zero, mm: more than the rounding to the six decimals in G10.
const ROUNDING_MM: f64 = 1e-3;

/// Homes an idle machine with the controller's own `$H`, and sets the work zero of G54 to `work_zero`, in mm of machine
/// coordinates. Afterwards the step counts correspond to machine coordinates.
/// A machine without switches gets a switch at the end of each axis, according to `$23` and `$130` to `$132`. The
/// machine then counts as powered up in the middle of its travel.
///
/// # Errors
/// A text for users: homing is off (`$22`) or has failed, or `work_zero` is out of range.
pub fn home(simulator: &mut Simulator, work_zero: [f64; LINEAR]) -> Result<(), String> {
    if !simulator.controller().settings().is_on(Key::Homing) {
        return Err("homing is needed ($22=1)".into());
    }
    let switches = switches_of(simulator);
    if simulator.world.fittings.fit_switches(&switches) {
        simulator.inputs.sample_at(simulator.clock.now());
        simulator.run_for(SETTLING);
    }
    say(simulator, "$H").map_err(|why| format!("homing {why}"))?;
    if !simulator.controller().is_trusted() {
        return Err("homing has left an axis out ($44 to $46)".into());
    }
    let [x, y, z] = work_zero;
    say(simulator, &format!("G10 L2 P1 X{x:.6} Y{y:.6} Z{z:.6}")).map_err(|why| format!("G10 {why}"))?;
    let (machine, work) = (simulator.machine_place(), simulator.work_place());
    if (0..LINEAR).any(|axis| (machine[axis] - work[axis] - work_zero[axis]).abs() > ROUNDING_MM) {
        return Err(
            "the work zero is elsewhere after homing: a stored offset ($#) or a start-up line ($N) moves it".into()
        );
    }
    name_steps(simulator, machine);
    Ok(())
}

/// Returns the switches that the settings imply.
fn switches_of(simulator: &Simulator) -> HomeSwitches {
    let settings = simulator.controller().settings();
    let to_negative = settings.whole(Key::HomingDirection);
    // For a rotary axis without travel limits, put the switch a quarter turn away.
    let half = settings.axes(AxisKey::Travel).0.map(|travel| if travel > 0.0 { f64::from(travel) / 2.0 } else { 90.0 });
    let homed = settings.homing_cycles().iter().fold(0, |all, cycle| all | cycle);
    HomeSwitches {
        steps_per_mm: settings.axes(AxisKey::Resolution).0.map(f64::from),
        arrangement: settings.arrangement(),
        at_mm: std::array::from_fn(|axis| if to_negative & 1 << axis != 0 { -half[axis] } else { half[axis] }),
        axes: (0..AXES).filter(|axis| *axis < LINEAR || homed >> axis & 1 != 0).collect(),
        second_motor: settings.ganged_axis().filter(|_| settings.is_on(Key::GangedSwitch)).map(|axis| axis.index()),
        opens: settings.is_on(Key::LimitInvert),
    }
}

/// Sends a line and runs until the machine is idle. Fails if the line ends in an alarm or is rejected. The error text
/// contains the alarm or error, with its messages.
fn say(simulator: &mut Simulator, line: &str) -> Result<(), String> {
    simulator.take_output();
    simulator.send(format!("{line}\n"));
    simulator.run_until_idle();
    let said = simulator.take_output();
    let messages = messages_of(&said);
    if let Some(alarm) = simulator.controller().alarm() {
        return Err(format!("ended in ALARM:{}: {}{messages}", alarm.code(), alarm.text()));
    }
    let error = said.lines().find_map(|answer| answer.strip_prefix("error:")?.parse().ok());
    error.map_or(Ok(()), |code| Err(format!("was refused with error:{code}: {}{messages}", error_text(code))))
}

/// Shifts the step counters of the motors, so that a counter of 0 is machine coordinate 0. Shifts the switches as well,
/// so that they stay where they are. `machine`: the present machine position, mm.
fn name_steps(simulator: &mut Simulator, machine: [f64; AXES]) {
    simulator.learn_resolution();
    let world = &mut simulator.world;
    let (named, counted) = (world.meter.steps_of(machine), world.machine.motors());
    let by = std::array::from_fn(|motor| named[motor].wrapping_sub(counted[motor]));
    world.machine.rename_place(by);
    world.fittings.rename_places(by);
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::check::Check;
    use crate::power_up::apply_setting;
    use crate::summary::Summary;
    use crate::{Fittings, JobText, Options};

    fn machine(settings: &[&str], fittings: Fittings) -> Simulator {
        let mut simulator = Simulator::new(Options { fittings, ..Options::default() });
        for setting in settings {
            apply_setting(&mut simulator, setting).unwrap();
        }
        simulator
    }

    fn run(mut simulator: Simulator, work_zero: Option<[f64; LINEAR]>, job: &'static str) -> Summary {
        if let Some(place) = work_zero {
            home(&mut simulator, place).unwrap();
        }
        let mut check = Check::new(simulator, JobText::new(job.as_bytes()));
        while !check.advance(1000) {}
        check.summary("a.nc", 0.0)
    }

    const SOFT: [&str; 5] = ["20=1", "22=1", "130=60", "131=50", "132=40"];
    const JOB: &str = "G21 G90\nG0 X0 Y0 Z0\nG0 X10\nG0 X31\nG0 X5\n";

    #[test]
    fn a_soft_limit_ends_a_job_of_a_homed_machine_with_its_line() {
        let bare = || machine(&SOFT, Fittings::default());
        let inside = run(bare(), Some([-40.0, -20.0, -10.0]), JOB);
        assert!(inside.is_good(), "{inside}");
        assert_eq!((inside.position_mm, inside.work_position_mm), (vec![-35.0, -20.0, -10.0], vec![5.0, 0.0, 0.0]));
        assert_eq!(inside.extents_mm.min, [-40.0, -20.0, -10.0]);
        let outside = run(bare(), Some([-30.0, -20.0, -10.0]), JOB);
        assert_eq!(outside.alarm.map(|alarm| (alarm.code, alarm.line)), Some((2, Some(4))));
        assert_eq!(
            run(bare(), None, "G21 G91\nG0 X99\n").alarm,
            None,
            "a machine that is not homed has no soft limits"
        );
    }

    /// With `$932=1`, machine zero is where homing ends: off the switch, at the end of each axis that `$23` names.
    #[test]
    fn the_report_has_the_ends_of_the_travel() {
        let travel =
            |more: &[&str]| run(machine(&[&SOFT, more].concat(), Fittings::default()), None, "G21\n").travel_mm;
        let ends = travel(&["23=1"]);
        assert_eq!((ends.min, ends.max), (vec![-60.0, -50.0, -40.0], vec![0.0; 3]));
        let ends = travel(&["23=1", "27=2", "932=1"]);
        assert_eq!((ends.min, ends.max), (vec![0.0, -48.0, -38.0], vec![58.0, 0.0, 0.0]));
    }

    /// The report of a job must not contain the homing.
    #[test]
    fn the_job_is_the_same_behind_a_homing() {
        let bare = || machine(&["22=1"], Fittings::default());
        let job = "G21 G91 G54\nG1 X3 Y-2 F600\nG2 X2 I1\nG0 Z-1\n";
        let [cold, homed] = [None, Some([0.0; LINEAR])].map(|zero| run(bare(), zero, job));
        assert!(homed.is_good(), "{homed}");
        assert!((cold.distance_mm - homed.distance_mm).abs() < 1e-9, "{homed}");
        // Homing takes many seconds, so nearly equal forecasts show that they do not contain it.
        assert!((cold.forecast_s - homed.forecast_s).abs() < 0.05, "{} {}", cold.forecast_s, homed.forecast_s);
        assert_eq!((cold.order_hash, cold.steps, cold.pulses), (homed.order_hash, homed.steps, homed.pulses));
        assert_eq!(homed.position_mm, [4.0, -3.0, -2.0], "from the pull-off at -1");
    }

    #[test]
    fn switches_are_where_the_settings_want_them() {
        for settings in [
            &["22=1", "23=5"][..],
            &["22=1", "5=1"],
            &["22=1", "904=1"],
            &["22=1", "23=2", "904=1", "5=1"],
            &["22=1", "905=2", "907=1"],
        ] {
            let mut simulator = machine(settings, Fittings::default());
            let to_negative = simulator.controller().settings().whole(Key::HomingDirection);
            home(&mut simulator, [-3.0, -4.0, -5.0]).unwrap_or_else(|why| panic!("{settings:?}: {why}"));
            let home: [f64; LINEAR] =
                std::array::from_fn(|axis| if to_negative & 1 << axis != 0 { -199.0 } else { -1.0 });
            for (here, counted) in
                [simulator.machine_place(), simulator.meter().millimetres(simulator.machine().motors())]
                    .iter()
                    .flat_map(|place| place.iter().zip(home))
            {
                assert!((here - counted).abs() < 0.01, "{settings:?}: {here} {counted}");
            }
        }
    }

    /// A machine with switches of its own keeps them. They still close at the same position after the step counts have
    /// been shifted.
    #[test]
    fn a_machine_has_its_own_switches() {
        let description = r#"{"steps_per_mm": [250, 250, 250], "switch": [
            {"axis": "x", "at_mm": 7, "side": "positive"}, {"axis": "y", "at_mm": 8, "side": "positive"},
            {"axis": "z", "at_mm": 9, "side": "positive"}], "plate": {"axis": "z", "at_mm": -3, "side": "negative"}}"#;
        let mill = Fittings::new(serde_json::from_str(description).unwrap()).unwrap();
        let found = run(machine(&["22=1"], mill.clone()), Some([0.0; LINEAR]), "G21 G90\nG38.2 Z-20 F300\n");
        assert!(found.is_good(), "{found}");
        assert_eq!(found.messages, ["[PRB:-1.000,-1.000,-12.000:1]"], "the plate is 12 mm below the switch");
        let found = run(machine(&["22=1", "21=1"], mill), Some([0.0; LINEAR]), "G21 G91\nG0 Y5\n");
        assert_eq!(found.alarm.map(|alarm| alarm.code), Some(1), "the switch of Y is 1 mm away");
    }

    #[test]
    fn what_hinders_homing_is_told() {
        let refused = |settings: &[&str], place| home(&mut machine(settings, Fittings::default()), place).unwrap_err();
        assert!(refused(&[], [0.0; LINEAR]).contains("$22=1"));
        let locked = refused(&["22=1", "110=1000000"], [0.0; LINEAR]);
        assert!(locked.contains("error:9") && locked.contains("correct this setting: $110"), "{locked}");
        assert!(refused(&["22=1"], [1e9, 0.0, 0.0]).contains("G10 was refused"));
        let plate = r#"{"steps_per_mm": [250, 250, 250], "switch": [{"axis": "x", "at_mm": 7, "side": "positive"}]}"#;
        let mill = Fittings::new(serde_json::from_str(plate).unwrap()).unwrap();
        assert!(home(&mut machine(&["22=1"], mill), [0.0; LINEAR]).unwrap_err().contains("ALARM:9"));
    }
}
