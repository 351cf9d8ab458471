//! A machine whose carriages have play, and a controller that compensates for it. The tests compare where the
//! carriages are with where they should be.

use super::oracle::AXES;
use super::rig::HZ;
use oxmill_controller::messages::Realtime;
use oxmill_simulator::{Fittings, Options, Simulator};
use proptest::prelude::*;
use proptest::test_runner::RngSeed;
use std::collections::HashMap;
use std::fmt::Write;
use std::time::Duration;

const STEPS: f64 = 400.0;
/// Play of X, Y and Z, mm: 20, 12 and 0 steps.
const PLAY: [f64; AXES] = [0.05, 0.03, 0.0];
const RATE: [f64; AXES] = [6000.0, 5000.0, 3000.0];
const ACCELERATION: [f64; AXES] = [600.0, 500.0, 300.0];
/// Edge of the cubes in which nearby positions are looked up, mm. It is longer than the maximum distance of a carriage
/// from its path.
const CELL: f64 = 0.1;
const JUNCTION_DEVIATION: f64 = 0.01;

fn machine(more: &str) -> Simulator {
    let description = format!(
        "steps_per_mm = [{STEPS}, {STEPS}, {STEPS}]\nbacklash_mm = [{}, {}, {}]\n{more}",
        PLAY[0], PLAY[1], PLAY[2]
    );
    let fittings = Fittings::parse(&description).unwrap();
    Simulator::new(Options { keep_steps: true, fittings, ..Options::default() })
}

fn mill(settings: &str, more: &str) -> Simulator {
    let mut mill = machine(more);
    let mut text = String::from("$0=3\n");
    for axis in 0..AXES {
        writeln!(text, "$10{axis}={STEPS}\n$11{axis}={}\n$12{axis}={}", RATE[axis], ACCELERATION[axis]).unwrap();
    }
    run(&mut mill, &format!("{text}{settings}"));
    assert!(!mill.take_output().contains("error"));
    mill.trace_mut().restart();
    mill
}

fn compensated(more: &str) -> Simulator {
    mill("$160=0.05\n$161=0.03\n", more)
}

/// Sends line by line and runs each to its end.
fn run(mill: &mut Simulator, text: &str) {
    for line in text.lines() {
        mill.send(format!("{line}\n"));
        assert!(mill.run_until_idle(), "{line}");
    }
}

fn off(mill: &Simulator) -> f64 {
    let reported = mill.machine_position();
    let place = mill.fittings().driven_mm();
    (0..AXES).map(|a| (reported[a] - place[a]).abs()).fold(0.0, f64::max)
}

#[test]
fn without_compensation_the_play_is_lost() {
    let mut mill = mill("", "");
    run(&mut mill, "G1 X2 F1000\nX5");
    assert!(mill.machine_position()[0] == 5.0 && (off(&mill) - 0.05).abs() < 1e-9);
}

#[test]
fn a_carriage_stands_where_it_is_reported() {
    let mut mill = compensated("");
    for line in
        ["G1 X5 F1000", "X2", "X2.001", "X1.9", "Y1", "Y0.99 X2", "G2 X2 Y0.99 I3 J0", "G0 X-1 Y-1 Z-1", "X-0.9"]
    {
        run(&mut mill, line);
        assert!(off(&mill) < 1e-9, "{line}: {:?} {:?}", mill.machine_position(), mill.fittings().driven_mm());
    }
}

/// The move of X before the plunge leaves some backlash to be taken up. The controller must not take it up while the
/// drill plunges, because that would drag the drill sideways.
#[test]
fn a_plunge_drags_no_drill() {
    let mut mill = compensated("");
    mill.send("G0 X20\nG0 X19.5\nG1 Z-5 F300\nG1 X19 F1000\n");
    assert!(mill.run_until_idle());
    let steps: Vec<u8> = mill.trace().kept().iter().map(|r| r.steps).collect();
    let plunge = steps.iter().position(|s| s & 4 != 0).unwrap()..steps.iter().rposition(|s| s & 4 != 0).unwrap();
    assert_eq!(plunge.len(), 5 * 400 - 1);
    assert!(off(&mill) < 1e-9 && mill.machine_position() == [19.0, 0.0, -5.0]);
    let places = carriages(&mill);
    assert!((places[plunge.start][0] - 19.5).abs() < 1e-9, "{:?}", places[plunge.start]);
}

/// A profile in X and Z does not stop to take up backlash. So its circles take as long as without compensation.
#[test]
fn a_profile_is_not_interrupted() {
    let mut seconds = Vec::new();
    for backlash in ["", "$160=0.05\n$162=0.05\n"] {
        let mut mill = mill(backlash, "");
        let chords: String = (1..600)
            .map(|k| f64::from(k) * 0.05)
            .map(|a| format!("X{:.3} Z{:.3}\n", 5.0 * a.cos(), 5.0 * a.sin()))
            .collect();
        mill.send(format!("G0 X5\nG1 F2400\n{chords}G18 G3 X-5 Z0 I-5 K0\n"));
        assert!(mill.run_until_idle());
        let kept = mill.trace().kept();
        seconds.push((kept[kept.len() - 1].at - kept[0].at) as f64 / HZ as f64);
    }
    assert!(seconds[1] < 1.02 * seconds[0], "{seconds:?}");
}

/// Moves shorter than the backlash, back and forth, end at the same position as without compensation. This holds even
/// though the carriage has not reached the end of one move when the next one starts.
#[test]
fn short_moves_back_and_forth_end_in_the_right_place() {
    for line in
        ["G91 G1 X0.01 F200\nX-0.0025", "G91 G1 X-1 F500\nX0.02\nX-0.01", "G91 G1 X1 F500\nX-0.03\nX0.01\nX-0.005"]
    {
        let mut with = compensated("");
        let mut without = mill("", "");
        for mill in [&mut with, &mut without] {
            mill.send(format!("{line}\n"));
            assert!(mill.run_until_idle());
        }
        assert!(off(&with) < 1e-9);
        assert_eq!(with.machine_position(), without.machine_position(), "{line}");
    }
}

fn program() -> impl Strategy<Value = String> {
    let coordinate = -800..800_i32;
    let line = (0..6_u8, coordinate.clone(), coordinate, -200..200_i32, 200..6000_u32, 1..40_i32);
    prop::collection::vec(line, 4..30).prop_map(|lines| {
        let mut text = String::from("G21 G91\n");
        for (kind, x, y, z, feed, small) in lines {
            let [x, y, z] = [x, y, z].map(|v| f64::from(v) / 100.0);
            match kind {
                0 => writeln!(text, "G0 X{x} Y{y} Z{z}"),
                1 | 2 => writeln!(text, "G1 X{x} Y{y} F{feed}"),
                3 => writeln!(text, "G1 X{x} F{feed}\nX{}", -x / 3.0),
                4 => {
                    let mut chords = format!("G1 F{feed}");
                    for n in 0..small {
                        let angle = f64::from(n) * 0.15;
                        write!(chords, "\nX{:.3} Y{:.3}", 0.2 * angle.cos(), 0.2 * angle.sin()).unwrap();
                    }
                    writeln!(text, "{chords}")
                }
                _ => writeln!(text, "G3 X0 Y0 I{:.2} J0 F{feed}", f64::from(small) / 4.0),
            }
            .unwrap();
        }
        text
    })
}

/// Returns the positions of the carriages at each pulse, computed from the play of each drive.
fn carriages(mill: &Simulator) -> Vec<[f64; AXES]> {
    let mut places = Vec::new();
    let mut driven = [0.0; AXES];
    for record in mill.trace().kept() {
        for axis in 0..AXES {
            let turned = f64::from(record.position[axis]) / STEPS;
            driven[axis] = f64::clamp(driven[axis], turned - PLAY[axis], turned);
        }
        places.push(driven);
    }
    places
}

/// Checks that no motor exceeds its speed and acceleration. Steps are counted in windows of 10 ms, so one step more
/// or less is a difference of 0.25 mm/s.
fn within_limits(mill: &Simulator, acceleration: [f64; AXES]) -> Result<(), String> {
    let window = HZ / 100;
    let end = mill.trace().kept().last().map_or(0, |r| r.at);
    for axis in 0..AXES {
        let mut records = mill.trace().kept().iter().peekable();
        let mut place = 0;
        let mut places = vec![0];
        for index in 1..end / window + 2 {
            while let Some(record) = records.next_if(|record| record.at < index * window) {
                place = record.position[axis];
            }
            places.push(place);
        }
        let speeds: Vec<f64> = places.windows(2).map(|w| f64::from(w[1] - w[0]) / STEPS * 100.0).collect();
        let rate = RATE[axis] / 60.0;
        // The junction rule lets the speed of an axis jump by at most √(8 a d) at a corner. The test allows twice this
        // jump.
        let jump = 2.0 * (8.0 * acceleration[axis] * JUNCTION_DEVIATION).sqrt();
        let allowed = acceleration[axis] * 0.01 * 1.01 + jump + 0.5;
        for pair in speeds.windows(2) {
            if pair[0].abs() > 1.01 * rate + 0.5 || (pair[1] - pair[0]).abs() > allowed {
                return Err(format!("axis {axis}: {pair:?} mm/s, allowed {rate} and {allowed}"));
            }
        }
    }
    Ok(())
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 24, rng_seed: RngSeed::Fixed(160), ..ProptestConfig::default() })]

    #[test]
    fn carriages_go_the_programmed_way(text in program()) {
        let mut with = compensated("");
        let mut without = mill("", "");
        for mill in [&mut with, &mut without] {
            mill.send(&text);
            prop_assert!(mill.run_until_idle());
            prop_assert!(!mill.take_output().contains("error"));
        }
        prop_assert!(off(&with) < 1e-9);
        prop_assert_eq!(with.machine_position(), without.machine_position());
        // While a motor takes up its backlash, its carriage stands still, so the carriages leave their path by at most
        // the play.
        let allowed = f64::hypot(PLAY[0], PLAY[1]) + 2.0 / STEPS;
        let cell = |place: [f64; AXES]| place.map(|mm| (mm / CELL).floor() as i32);
        let mut way: HashMap<[i32; AXES], Vec<[f64; AXES]>> = HashMap::new();
        for record in without.trace().kept() {
            let place = record.position.map(|steps| f64::from(steps) / STEPS);
            way.entry(cell(place)).or_default().push(place);
        }
        for place in carriages(&with) {
            let at = cell(place);
            let near = (0..27).flat_map(|n| way.get(&[at[0] + n % 3 - 1, at[1] + n / 3 % 3 - 1, at[2] + n / 9 - 1]));
            let distance = |p: &[f64; AXES]| (0..AXES).map(|a| (p[a] - place[a]).powi(2)).sum::<f64>().sqrt();
            let off = near.flatten().map(distance).fold(f64::MAX, f64::min);
            prop_assert!(off <= allowed, "{} mm off at {:?}", off, place);
        }
    }

    #[test]
    fn motors_keep_their_limits(text in program()) {
        let mut mill = compensated("");
        mill.send(&text);
        prop_assert!(mill.run_until_idle());
        if let Err(fault) = within_limits(&mill, ACCELERATION) {
            prop_assert!(false, "{}", fault);
        }
    }

    #[test]
    fn what_is_reported_after_a_stop_is_true(text in program(), milliseconds in 5..4000_u64, reset in any::<bool>()) {
        let mut mill = compensated("");
        mill.send(&text);
        mill.run_for(Duration::from_millis(milliseconds));
        // `press` acts at once. As a byte of the serial line, the command would wait for the text before it.
        mill.press(if reset { Realtime::Reset } else { Realtime::FeedHold });
        mill.run_for(Duration::from_millis(500));
        prop_assert!(!mill.is_stepping());
        prop_assert!(off(&mill) < 1e-9, "{:?} {:?}", mill.machine_position(), mill.fittings().driven_mm());
        if reset {
            run(&mut mill, "$X\nG90 G0 X1 Y-1\nX0.5");
        } else {
            mill.press(Realtime::CycleStart);
            prop_assert!(mill.run_until_idle());
        }
        prop_assert!(off(&mill) < 1e-9, "{:?} {:?}", mill.machine_position(), mill.fittings().driven_mm());
    }
}

#[test]
fn a_motor_that_takes_up_backlash_is_not_too_fast() {
    // The axis reaches its rate of 20 mm/s within 0.04 mm of the reversal, when the backlash is not yet taken up. The
    // additional steps for the backlash must not make the motor faster than this rate.
    let mut mill = compensated("");
    run(&mut mill, "$110=1200\n$120=5000\nG0 X10");
    mill.trace_mut().restart();
    run(&mut mill, "G0 X0");
    let times: Vec<u64> = mill.trace().kept().iter().map(|r| r.at).collect();
    assert_eq!(times.len(), 10 * 400 + 20);
    // At the rate of 20 mm/s, ten steps take at least this many ticks.
    let least = HZ as f64 * 10.0 / (20.0 * STEPS);
    let fastest = times.windows(11).map(|w| w[10] - w[0]).min().unwrap() as f64;
    assert!(fastest > 0.99 * least, "{fastest} of {least}");
}

/// The tool follows a relief (a curved surface): X moves fast, and the slow Z reverses while X moves. No axis may
/// exceed its limits while Z takes up its backlash.
#[test]
fn a_slow_axis_takes_up_its_backlash_no_faster_than_its_own_corners() {
    let acceleration = [2000.0, 500.0, 20.0];
    for relief in ["X30 Z0.5 F6000\nX30 Z-0.5\nX30 Z0.5\nX30 Z-0.5\n", "G18 G2 X60 I30 K-30 F6000\nG3 X-60 I-30 K-30\n"]
    {
        let mut mill = mill("$162=0.3\n$120=2000\n$122=20\n", "");
        mill.send(format!("G91 G1 {relief}"));
        assert!(mill.run_until_idle());
        within_limits(&mill, acceleration).unwrap_or_else(|fault| panic!("{relief}: {fault}"));
    }
}

#[test]
fn what_follows_the_last_of_the_backlash_begins_at_rest() {
    // The second move reverses X, but it is too short to take up all of the backlash. So the motor takes up the rest
    // after this move, while the other axes stand still. The third move is sent after various delays. With some of them
    // it arrives while the motor takes up that rest.
    let mut found = 0;
    for milliseconds in (70..190).step_by(2) {
        let mut mill = mill("$160=0.3\n", "");
        mill.send("G1 X1 F3000\nX0.998 Y0.01\n");
        mill.run_for(Duration::from_millis(milliseconds));
        found += usize::from(mill.is_stepping());
        mill.send("Y9 F6000\n");
        assert!(mill.run_until_idle());
        // Y starts from rest after the last step of X. At 500 mm/s² its first ten intervals take 8 ms.
        let turned = mill.trace().kept().iter().rposition(|r| r.steps & 1 != 0).unwrap();
        let steps = &mill.trace().kept()[turned + 1..];
        let time = (steps[10].at - steps[0].at) as f64 / HZ as f64;
        assert!(time > 0.004, "{milliseconds}: ten steps in {time} s");
    }
    assert!(found > 5 && found < 60, "{found}");
}

#[test]
fn inverse_time_holds_for_the_whole_move() {
    let mut times = Vec::new();
    for mut mill in [compensated(""), mill("", "")] {
        run(&mut mill, "G1 X10 F3000");
        let begin = mill.busy_ticks();
        run(&mut mill, "G93 G1 X5 F20");
        times.push((mill.busy_ticks() - begin) as f64 / HZ as f64);
    }
    assert!((times[0] - times[1]).abs() < 0.02, "{times:?}");
}

#[test]
fn less_backlash_moves_nothing() {
    let mut mill = compensated("");
    run(&mut mill, "G1 X5 F3000\n$160=0");
    let x = mill.machine().position()[0];
    run(&mut mill, "G1 Y5");
    assert_eq!(mill.machine().position()[0], x);
    assert_eq!(mill.machine_position(), [5.0, 5.0, 0.0]);
}

#[test]
fn a_reset_after_parking_finds_the_tool_where_it_is() {
    let mut switches = String::new();
    for axis in ["x", "y", "z"] {
        write!(switches, "[[switch]]\naxis = \"{axis}\"\nat_mm = 4.0\nside = \"positive\"\n").unwrap();
    }
    for (pull_out, go_on) in [(5, false), (5, true), (0, true)] {
        let settings = format!("$160=0.05\n$161=0.03\n$22=1\n$41=1\n$42=0\n$27=2\n$58=-2\n$392=2\n$56={pull_out}\n");
        let mut mill = mill(&settings, &switches);
        run(&mut mill, "$H\nM3 S100\nG53 G0 Z-15\nG53 G0 X-10\nG53 G0 X-9");
        mill.send([0x84]);
        mill.run_for(Duration::from_secs(20));
        mill.send("~");
        if go_on {
            mill.run_for(Duration::from_secs(30));
            assert!(mill.run_until_idle());
            run(&mut mill, "G53 G0 Z-10\nG53 G0 X-8");
        } else {
            mill.run_for(Duration::from_secs(2));
            let before = mill.machine_position();
            mill.send("\x18");
            mill.run_for(Duration::from_millis(100));
            assert_eq!(mill.machine_position(), before);
        }
        // The switches are 4 mm from the position at power-up. Machine zero must still be at the switches.
        let reported = mill.machine_position();
        let place = mill.fittings().driven_mm();
        let home = [2.0 + 2.0; AXES];
        for axis in 0..AXES {
            assert!((reported[axis] - (place[axis] - home[axis])).abs() < 0.011, "{reported:?} {place:?}");
        }
    }
}

#[test]
fn an_arc_turns_its_axes_without_slowing_down() {
    let text = "G21 G90 F3000\nG2 X0 Y0 I10 J0\nG2 X0 Y0 I10 J0\n";
    let mut times = Vec::new();
    for mut mill in [compensated(""), mill("", "")] {
        mill.send(text);
        assert!(mill.run_until_idle());
        times.push(mill.busy_ticks() as f64 / HZ as f64);
    }
    assert!(times[0] < times[1] * 1.01, "{times:?}");
}

#[test]
fn a_probe_touches_where_it_says() {
    let plate = "[plate]\naxis = \"x\"\nat_mm = 3.0\nside = \"positive\"\n";
    let mut mill = compensated(plate);
    for approach in ["G0 X-1", "G0 X1\nG0 X0", "G0 X2\nG0 X2.5"] {
        run(&mut mill, approach);
        mill.take_output();
        run(&mut mill, "G38.2 X10 F300");
        let said = mill.take_output();
        let touched: f64 = said.split("[PRB:").nth(1).and_then(|t| t.split(',').next()).unwrap().parse().unwrap();
        assert!((touched - 3.0).abs() <= 1.0 / STEPS + 0.0005, "{approach}: {said}");
        assert!(off(&mill) < 1e-9, "{approach}");
    }
}

#[test]
fn home_is_true_and_parking_comes_back() {
    let mut switches = String::new();
    for axis in ["x", "y", "z"] {
        write!(switches, "[[switch]]\naxis = \"{axis}\"\nat_mm = 4.0\nside = \"positive\"\nbounce_us = 300\n").unwrap();
    }
    for retreat in ["Z-30", "Z-34\nG53 G0 Z-30"] {
        let mut mill =
            mill("$160=0.05\n$161=0.03\n$162=0.02\n$22=1\n$41=1\n$27=2\n", &switches.replace("backlash", ""));
        run(&mut mill, "$H");
        assert_eq!(mill.machine_position(), [-2.0; AXES]);
        let home = mill.fittings().driven_mm();
        run(&mut mill, &format!("G53 G0 X-20\nG53 G0 {retreat}"));
        let before = mill.fittings().driven_mm();
        assert!((before[0] - home[0] + 18.0).abs() < 1e-9, "{before:?} {home:?}");
        // The door opens during this move: the tool goes away from the work and back.
        mill.send("G91 G1 X-3 Z-0.5 F600\n");
        mill.run_for(Duration::from_millis(150));
        mill.send([0x84]);
        mill.run_for(Duration::from_secs(20));
        mill.send("~");
        mill.run_for(Duration::from_secs(60));
        assert!(mill.run_until_idle());
        let after = mill.fittings().driven_mm();
        assert!((after[0] - before[0] + 3.0).abs() < 1e-9, "{after:?} {before:?}");
        assert!((after[2] - before[2] + 0.5).abs() < 0.0201, "{after:?} {before:?}");
        assert_eq!(mill.machine_position()[2], -30.5);
    }
}

/// On a CoreXY machine, a belt that takes up its backlash during Y's homing cycle also moves X. So after that cycle,
/// the reported X must include this movement.
#[test]
fn home_is_true_with_belts_that_have_backlash() {
    const AT: [f64; AXES] = [4.0, 5.0, 3.0];
    let mut switches = String::from("kinematics = \"corexy\"\n");
    for (axis, at) in ["x", "y", "z"].into_iter().zip(AT) {
        write!(switches, "[[switch]]\naxis = \"{axis}\"\nat_mm = {at}\nside = \"positive\"\n").unwrap();
    }
    for (cycles, commands) in [("$44=4\n$45=3\n", "$H"), ("$44=4\n$45=1\n$46=2\n", "$H"), ("", "$HX\n$HY\n$HZ")] {
        for from in ["", "$X\nG91 G0 X-3 Y-7", "$X\nG91 G0 X3 Y-7\nG0 X-2"] {
            let settings = format!("$904=1\n$160=0.05\n$161=0.03\n$22=1\n$27=2\n$24=60\n{cycles}");
            let mut mill = mill(&settings, &switches);
            run(&mut mill, from);
            run(&mut mill, commands);
            let [a, b, z, ..] = mill.fittings().driven_mm();
            let tool = [0.5 * (a + b), 0.5 * (a - b), z];
            let reported = mill.machine_position();
            for axis in 0..AXES {
                let off = reported[axis] - (tool[axis] - AT[axis]);
                // A step of one motor moves the tool by half a step in X and in Y. So a switch can close half way
                // between two steps.
                assert!(off.abs() < 1.6 / STEPS, "{cycles:?} {commands:?} {from:?}: {reported:?} is {tool:?}");
            }
        }
    }
}
