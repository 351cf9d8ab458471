//! `oxmill resume`: the rest of a job makes the steps that the whole job makes from that line on, and ends in the same
//! state, for each line of programs that use what G-code has; and what cannot be known is refused.

use oxmill_controller::gcode::Interpreter;
use oxmill_controller::units::{Coordinate, Decimal};
use oxmill_simulator::boards::AXES;
use oxmill_simulator::power_up::apply_setting;
use oxmill_simulator::resume::{Begin, Resumed, Wish, resume};
use oxmill_simulator::{Options, Simulator};

fn machine(settings: &[&str]) -> Simulator {
    let mut simulator = Simulator::new(Options { keep_steps: true, ..Options::default() });
    for setting in ["100=40", "101=40", "102=40"].iter().chain(settings) {
        apply_setting(&mut simulator, setting).unwrap();
    }
    simulator
}

fn wish(line: u64) -> Wish {
    Wish { begin: Begin::Line(line), clearance: None, plunge: None, spin_up: 3 }
}

fn resumed(settings: &[&str], job: &str, wish: &Wish) -> Result<Resumed, String> {
    resume(&machine(settings), "job.nc", job.as_bytes(), wish)
}

/// Steps, directions and place of each step event; and the state at the end.
type Ran = (Vec<(u8, u8, [i32; 3], i32)>, Interpreter<AXES>);

fn run(settings: &[&str], before: &str, program: &str) -> Ran {
    let mut simulator = machine(settings);
    for line in before.lines().chain(program.lines()).filter(|line| !line.starts_with('%')) {
        simulator.take_output();
        simulator.send(format!("{}\n", line.replace(['?', '!', '~'], " ")));
        while !simulator.run_until_idle() && simulator.controller().is_paused() {
            simulator.press(oxmill_controller::messages::Realtime::CycleStart);
        }
        let said = simulator.take_output();
        assert!(!said.contains("error") && !said.contains("ALARM"), "{line}: {said}\n{program}");
    }
    let kept = simulator.trace().kept().iter();
    let steps = kept.map(|step| (step.steps, step.directions, step.position, step.rotary[0])).collect();
    (steps, simulator.controller().interpreter().clone())
}

/// Each line of the program that may be one, and those that are refused:  the machine is at some other place then, and has forgotten all but its settings.
fn compare_all(settings: &[&str], program: &str, elsewhere: &str, other_way: &[usize]) -> Vec<(u64, String)> {
    let words: Vec<String> =
        "XYZA".chars().filter(|c| elsewhere.contains(*c)).map(|c| format!(" {c}").replace(" Z", "Z")).collect();
    let lines: Vec<&str> = program.lines().collect();
    let whole = run(settings, "", program);
    let mut refused = Vec::new();
    for line in 1..=lines.len() {
        let front = lines[..line - 1].join("\n");
        let rest = match resumed(settings, program, &wish(line as u64)) {
            Ok(resumed) => resumed,
            Err(why) => {
                refused.push((line as u64, why));
                continue;
            }
        };
        assert_eq!(rest.line, line as u64);
        let text = String::from_utf8(rest.program).unwrap();
        let way = rest.prologue.concat();
        // An axis that has not moved stays where it is.
        let elsewhere = if words.iter().all(|word| way.contains(word)) { elsewhere } else { "" };
        let (in_front, _) = run(settings, "", &front);
        let remaining = whole.0.len() - in_front.len();
        // What is stored was stored by the lines in front.
        let stored: String =
            lines[..line - 1].iter().filter(|line| line.contains("G10")).map(|l| format!("{l}\n")).collect();
        let (steps, state) = run(settings, &format!("{stored}{elsewhere}"), &text);
        assert!(steps.len() >= remaining, "line {line}: {} of {remaining} steps\n{text}", steps.len());
        assert!(
            other_way.contains(&line) || steps[steps.len() - remaining..] == whole.0[whole.0.len() - remaining..],
            "line {line}: other steps\n{text}"
        );
        assert_eq!(state.differs_from(&whole.1), None, "line {line}\n{text}");
    }
    refused
}

#[test]
fn the_rest_of_a_job_makes_the_steps_of_the_job() {
    let program = "\
%
(a ? job!)
G21 G90 G40 G49 G94
G55 G0 Z12
G0 X3 Y4
T2 M6
M3 S8000
M8
N100 G1 Z-0.5 F150
N110 X10 F600
N120 X10 Y9
G2 X12 Y11 I2 J0
X14 Y9 I0 J-2
G3 X16 Y7 R2
G1 G91 X1.5
X0.25 Y-0.125
G90 G20
X0.6 Y0.3 F20
G2 X0.7 Y0.4 I0.1
G1 G21 X17
G0 Z12
G52 X1 Y2 Z0.5
X3 G1
G0 Z10
G98 G81 X4 Y5 Z-2 R1 F100
X6

N300 X7 Y6
G99 X8
X9
G98 X10
G83 X11 Z-3 R2 Q0.75
X12
G80
G52 X0 Y0 Z0
G18 G2 X15 Z11.5 I1 K0.5
G17 G1 X15 F400
G93 G1 X16 F30
X17 F20
G94 F300 G1 X18
G61.1
G1 X19
M49
G64 P0.02 Q0.01
X20 Y1
X21 Y2
M48
G61 X22
G56
G0 Z7
G0 X1
M4 S500.5
M5 M9
G1 X3
M30";
    // With G99 the level of G98 is restored by a travel at that level.
    let refused = compare_all(&["918=1"], program, "G91 G0 X1.7 Y-2.3 Z4.9\nG90", &[30, 31]);
    let lines: Vec<u64> = refused.iter().map(|(line, _)| *line).collect();
    // Behind G56, where nothing is known but in G55.
    assert_eq!(lines, [50, 51, 52, 53, 54, 55], "{refused:?}");
    assert!(refused.iter().all(|(_, why)| why.starts_with("where ")), "{refused:?}");
}

#[test]
fn an_incremental_series_of_cycles_and_tools_go_on() {
    let program = "\
G10 L1 P3 Z1.25
G21 G90 G17
G0 Z5
G0 X1 Y1
T3 M6
G43 H3
G0 Z8
M3 S100
G1 Z1 F90
X5
G0 Z9
G91
G81 X1 Y0.5 Z-3 R-4 F50 L3
X2 Y2
G90 G80
G43.1 Z0.75
G0 Z6
X9
G49
G0 Z6 X8
G10 L2 P2 X1 Y1 Z1
G55 G0 X2 Y3 Z5
G1 X4
M2";
    let refused = compare_all(&["918=1"], program, "G91 G0 X1.7 Y-2.3 Z4.9\nG90", &[]);
    assert_eq!(refused, [], "{refused:?}");
}

#[test]
fn a_laser_is_off_until_it_is_there_and_z_stays_where_it_is() {
    let program = "G21 G90\nG0 X5 Y5\nM4 S300\nG1 X10 F900\nY10\nG1 X0 S0\nM5\nG0 X0 Y0\n";
    let rest = resumed(&["32=1"], program, &wish(5)).unwrap();
    assert_eq!(rest.prologue, ["G21 G90 G94 G17 G54", "M5 M9", "G0 X10 Y5", "M4 S300", "G1 F900"]);
    assert!(compare_all(&["32=1"], program, "G91 G0 X1.7 Y-2.3\nG90", &[]).is_empty());
}

#[test]
fn a_rotary_axis_goes_on() {
    let program = "G21 G90\nG0 Z5\nG0 X1 A30\nG1 Z1 F100\nG20 G1 A45 F300\nA60\nG21 X2 A70\nG0 Z5\nM2";
    let refused = compare_all(&["930=4"], program, "G91 G0 X1.7 Z4.9 A-7\nG90", &[]);
    assert_eq!(refused, [], "{refused:?}");
}

/// A spindle turns before the tool goes down, and the way is above the work.
#[test]
fn the_way_to_the_place_is_over_the_work() {
    let program = "G21 G90\nG0 Z5\nG0 X1 Y1\nM3 S1000\nG1 Z-2 F120\nX9 F800\nY9\nG0 Z5\nM2\n";
    let expected = ["G21 G90 G94 G17 G54", "M5 M9", "G0 Z5", "G0 X9 Y1", "M3 S1000", "G4 P3", "G1 Z-2 F120", "G1 F800"];
    assert_eq!(resumed(&[], program, &wish(7)).unwrap().prologue, expected);
    let other = Wish { clearance: Some(Coordinate(75_000_000)), plunge: Some(Decimal(600_000_000)), ..wish(7) };
    let prologue = resumed(&[], program, &other).unwrap().prologue;
    assert_eq!((prologue[2].as_str(), prologue[6].as_str()), ("G0 Z7.5", "G1 Z-2 F60"));
    assert_eq!(
        resumed(&[], program, &wish(7)).unwrap().program,
        format!("(job.nc from line 7 on)\n{}\nY9\nG0 Z5\nM2\n", expected.join("\n")).into_bytes()
    );
}

#[test]
fn a_line_is_found_by_its_number() {
    let program = "G21 G90\r\nN5 G0 Z5\r\n/ n 10 X1\r\nN20 X2\r\n";
    let at = |number| resumed(&[], program, &Wish { begin: Begin::Number(number), ..wish(0) }).map(|rest| rest.line);
    assert_eq!((at(10), at(20)), (Ok(3), Ok(4)));
    assert!(at(30).unwrap_err().contains("no line has N30"));
    assert!(resumed(&[], program, &wish(0)).unwrap_err().contains("there is no line 0"));
    assert!(resumed(&[], program, &wish(5)).unwrap_err().contains("the job has 4"));
}

#[test]
fn what_cannot_be_known_is_refused() {
    let refused = |program: &str, line, word: &str| {
        let why = resumed(&[], program, &wish(line)).unwrap_err();
        assert!(why.contains(word), "{program}: {why}");
    };
    refused("G21 G91\nG0 X5\nX5\n", 3, "where X is");
    refused("G21 G90\nG53 G0 Z-1\nG0 X1\nG0 Z2\n", 3, "where Z is");
    refused("G21 G90\nG28 Z1\nX1\n", 3, "where Z is");
    refused("G92 X0 Y0\nG21 G90 G0 Z2 X1\nX2\n", 3, "G92");
    refused("G21 G90\nG1 X1 Z2 F100\nX2\n", 3, "--clearance");
    refused("G21 G90 G0 Z5\nG93 G1 X1 Z2 F9\nG94\n", 3, "--plunge");
    refused("G21 G90\nG0 Z5\nG1 X1\n", 4, "there is no line 4");
    refused("G21 G90\nG1 X1\nX2\n", 3, "line 2 is refused with error:22");
    refused("#5=1\nG21 G90 G0 Z#5\nX2\n", 3, "a parameter");
    refused("o1 sub\nG0 X1\no1 endsub\n", 2, "O words");
    refused("G21 G90 G0 X0 Y0 Z1\nG68 X0 Y0 R30\nX1\nX2\n", 4, "G68");
    refused("G21 G90 G0 X0 Y0 Z1\nG51 P2\nX1\nX2\n", 4, "G51");
    refused("G21 G90 G0 X0 Y0 Z1 F100\nG5.2 X1 Y2 P1\nX3 Y4 P1\nG5.3\n", 3, "cannot be restored");
    refused("G21 G90 G0 Z1\nG38.3 Z-1 F100\n", 3, "there is no line");
    refused("G21 G90 G0 X0 Y0 Z1\nG2 X2 I1 F100\nG17\n", 3, "no line moves");
}

/// Neither homing nor limits of travel hinder it.
#[test]
fn limits_of_travel_do_not_hinder_it() {
    let program = "G21 G90\nG0 Z5\nG0 X300 Y1\nG1 Z-2 F120\nX9 F800\nY9\n";
    let free = resumed(&[], program, &wish(6)).unwrap();
    assert_eq!(resumed(&["22=1", "20=1", "21=1"], program, &wish(6)).unwrap(), free);
}

/// Nothing of a store that is kept in a file changes.
#[test]
fn the_machine_is_as_it_was() {
    let simulator = machine(&[]);
    let (image, program) = (simulator.store().image(), b"G10 L2 P1 X5\nG21 G90 G0 Z1\nX1\nX2\n");
    resume(&simulator, "a", program, &wish(4)).unwrap();
    assert!(image == simulator.store().image());
}
