//! `oxmill resume`: for each line of programs that use all of G-code, the rest of the job makes the same steps as the
//! whole job from that line on, and ends in the same state. Where that is impossible, the job is rejected.

use oxmill_controller::gcode::Interpreter;
use oxmill_controller::units::{Coordinate, Decimal};
use oxmill_simulator::boards::AXES;
use oxmill_simulator::power_up::apply_setting;
use oxmill_simulator::resume::{Begin, ResumeRequest, Resumed, resume};
use oxmill_simulator::{Options, Simulator};

fn machine(settings: &[&str]) -> Simulator {
    let mut simulator = Simulator::new(Options { keep_steps: true, ..Options::default() });
    for setting in ["100=40", "101=40", "102=40"].iter().chain(settings) {
        apply_setting(&mut simulator, setting).unwrap();
    }
    simulator
}

fn request(line: u64) -> ResumeRequest {
    ResumeRequest { begin: Begin::Line(line), clearance: None, plunge: None, spin_up: 3 }
}

fn resumed(settings: &[&str], job: &str, request: &ResumeRequest) -> Result<Resumed, String> {
    resume(&machine(settings), "job.nc", job.as_bytes(), request)
}

/// For each step event: the step bits, the direction bits, the step counters of X, Y and Z, and the step counter of A.
/// The last part is the final state.
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

/// Resumes the program at each of its lines. Before that, the machine has only its settings, and runs the lines
/// `elsewhere`, which move it away. The rest must then make the same steps as the whole program, except at the lines in
/// `other_way`. Returns the lines at which the program cannot be resumed, with the reasons.
fn compare_all(settings: &[&str], program: &str, elsewhere: &str, other_way: &[usize]) -> Vec<(u64, String)> {
    let words: Vec<String> =
        "XYZA".chars().filter(|c| elsewhere.contains(*c)).map(|c| format!(" {c}").replace(" Z", "Z")).collect();
    let lines: Vec<&str> = program.lines().collect();
    let whole = run(settings, "", program);
    let mut refused = Vec::new();
    for line in 1..=lines.len() {
        let front = lines[..line - 1].join("\n");
        let rest = match resumed(settings, program, &request(line as u64)) {
            Ok(resumed) => resumed,
            Err(why) => {
                refused.push((line as u64, why));
                continue;
            }
        };
        assert_eq!(rest.line, line as u64);
        let text = String::from_utf8(rest.program).unwrap();
        let way = rest.prologue.concat();
        // The prologue moves only axes that the job has moved. So move the machine elsewhere only if the prologue moves
        // all axes that `elsewhere` names.
        let elsewhere = if words.iter().all(|word| way.contains(word)) { elsewhere } else { "" };
        let (in_front, _) = run(settings, "", &front);
        let remaining = whole.0.len() - in_front.len();
        // These lines store values permanently. A real machine has run them with the first part of the job.
        let stored: String =
            lines[..line - 1].iter().filter(|line| line.contains("G10")).map(|l| format!("{l}\n")).collect();
        let (steps, state) = run(settings, &format!("{stored}{elsewhere}"), &text);
        assert!(steps.len() >= remaining, "line {line}: {} of {remaining} steps\n{text}", steps.len());
        assert!(
            other_way.contains(&line) || steps[steps.len() - remaining..] == whole.0[whole.0.len() - remaining..],
            "line {line}: other steps\n{text}"
        );
        // The prologue restores neither parameters nor the state saved by M70.
        let differs = state.differs_from(&whole.1).filter(|part| !part.contains("parameter") && !part.contains("M70"));
        assert_eq!(differs, None, "line {line}\n{text}");
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
    // If the program is resumed at line 30 or 31, the steps differ from those of the whole program: G99 is in force at
    // these lines, but the prologue travels at the Z to which G98 would retract.
    let refused = compare_all(&["918=1"], program, "G91 G0 X1.7 Y-2.3 Z4.9\nG90", &[30, 31]);
    let lines: Vec<u64> = refused.iter().map(|(line, _)| *line).collect();
    // These lines follow G56. The positions of the job are known in G55 only, because the zeros of both systems are
    // unknown.
    assert_eq!(lines, [50, 51, 52, 53, 54, 55], "{refused:?}");
    assert!(refused.iter().all(|(_, why)| why.contains("at this line depends")), "{refused:?}");
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
    // Line 7: the job has travelled at Z5 without a tool offset. With the offset of T3, the spindle would be higher at
    // Z5 than it was in the job. Lines 23 and 24: after G55, the job's heights are known in G54 only.
    let lines: Vec<u64> = refused.iter().map(|(line, _)| *line).collect();
    assert_eq!(lines, [7, 23, 24], "{refused:?}");
    assert!(refused.iter().all(|(_, why)| why.contains("--clearance")), "{refused:?}");
}

#[test]
fn a_laser_is_off_until_it_is_there_and_z_stays_where_it_is() {
    let program = "G21 G90\nG0 X5 Y5\nM4 S300\nG1 X10 F900\nY10\nG1 X0 S0\nM5\nG0 X0 Y0\n";
    let rest = resumed(&["32=1"], program, &request(5)).unwrap();
    assert_eq!(rest.prologue, ["G21 G90 G94 G17 G54", "M5 M9", "G0 X10 Y5", "G1 F900", "M4 S300"]);
    assert!(compare_all(&["32=1"], program, "G91 G0 X1.7 Y-2.3\nG90", &[]).is_empty());
}

#[test]
fn a_rotary_axis_goes_on() {
    let program = "G21 G90\nG0 Z5\nG0 X1 A30\nG1 Z1 F100\nG20 G1 A45 F300\nA60\nG21 X2 A70\nG0 Z5\nM2";
    let refused = compare_all(&["930=4"], program, "G91 G0 X1.7 Z4.9 A-7\nG90", &[]);
    assert_eq!(refused, [], "{refused:?}");
}

/// G12 and G13 keep the motion mode in force. They contain no position, so an unknown X or Y stays unknown.
#[test]
fn circles_round_the_tool_go_on() {
    let program =
        "G21 G90\nG0 Z5\nG0 X3 Y4\nG1 Z-1 F100\nG13 I2 F300\nG2 X7 Y4 I2 J0\nG12 I1\nX3 Y4 I-2\nG0 Z5\nG12 I1\nM2";
    assert_eq!(compare_all(&[], program, "G91 G0 X1.7 Y-2.3 Z4.9\nG90", &[]), []);
    let bore = "G21 G90\nG0 Z5\nG1 Z-1 F100\nG12 I5 F300\nG1 Z-2\nG12 I5\n";
    let why = resumed(&[], bore, &request(5)).unwrap_err();
    assert!(why.contains("X at this line depends"), "{why}");
}

/// The spindle turns before the tool moves down, and the tool travels above the work.
#[test]
fn the_way_to_the_place_is_over_the_work() {
    let program = "G21 G90\nG0 Z5\nG0 X1 Y1\nM3 S1000\nG1 Z-2 F120\nX9 F800\nY9\nG0 Z5\nM2\n";
    let expected = ["G21 G90 G94 G17 G54", "M5 M9", "G0 Z5", "G0 X9 Y1", "M3 S1000", "G4 P3", "G1 Z-2 F120", "G1 F800"];
    assert_eq!(resumed(&[], program, &request(7)).unwrap().prologue, expected);
    let other =
        ResumeRequest { clearance: Some(Coordinate(75_000_000)), plunge: Some(Decimal(600_000_000)), ..request(7) };
    let prologue = resumed(&[], program, &other).unwrap().prologue;
    assert_eq!((prologue[2].as_str(), prologue[6].as_str()), ("G0 Z7.5", "G1 Z-2 F60"));
    assert_eq!(
        resumed(&[], program, &request(7)).unwrap().program,
        format!("(job.nc from line 7 on)\n{}\nY9\nG0 Z5\nM2\n", expected.join("\n")).into_bytes()
    );
}

#[test]
fn a_line_is_found_by_its_number() {
    let program = "G21 G90\r\nN5 G0 Z5\r\n/ n 10 X1\r\nN20 X2\r\n";
    let at = |number| {
        resumed(&[], program, &ResumeRequest { begin: Begin::Number(number), ..request(0) }).map(|rest| rest.line)
    };
    assert_eq!((at(10), at(20)), (Ok(3), Ok(4)));
    assert!(at(30).unwrap_err().contains("no line has N30"));
    assert!(resumed(&[], program, &request(0)).unwrap_err().contains("there is no line 0"));
    assert!(resumed(&[], program, &request(5)).unwrap_err().contains("the job has 4"));
}

#[test]
fn what_cannot_be_known_is_refused() {
    let refused = |program: &str, line, word: &str| {
        let why = resumed(&[], program, &request(line)).unwrap_err();
        assert!(why.contains(word), "{program}: {why}");
    };
    refused("G21 G91\nG0 X5\nX5\n", 3, "X at this line depends");
    refused("G21 G90\nG53 G0 Z-1\nG0 X1\nG0 Z2\n", 3, "Z at this line depends");
    refused("G21 G90\nG28 Z1\nX1\n", 3, "Z at this line depends");
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

/// The control points of a finished curve (G5.2 to G5.3) do not affect the lines after it. Directly after G5.2, only a
/// curve of the default order can be resumed.
#[test]
fn curves_of_control_points() {
    let job = |order: &str| {
        let curve = format!("G5.2 P1{order}\nX1 Y2 P1\nX3 Y4 P1\nX5 Y0 P1\nG5.3");
        format!("G21 G90 G0 X0 Y0 Z5\nG1 Z0 F100\n{curve}\nG1 X10\nX20\n")
    };
    let behind = resumed(&[], &job(" L4"), &request(9)).unwrap();
    assert_eq!(behind.prologue.last().map(String::as_str), Some("G1 F100"), "{behind:?}");
    let why = resumed(&[], &job(" L4"), &request(4)).unwrap_err();
    assert!(why.contains("control points are being read"), "{why}");
    let closed = "G21 G90 G0 X0 Y0 Z5\nG1 Z0 F100\nG5.2 P1 L3\nX1 Y2 P1\nX3 Y4 P1\nX0 Y0 P1\nG5.3\nG1 Z-1\nX20\n";
    assert!(resumed(&[], closed, &request(8)).is_ok(), "a curve that is done, in front of a line at its first point");
    // Order 3 (`L3`) is the default of G5.2, so the job can be resumed there.
    assert!(resumed(&[], &job(" L3"), &request(4)).is_ok());
}

/// Neither homing nor limits of travel prevent resuming.
#[test]
fn limits_of_travel_do_not_hinder_it() {
    let program = "G21 G90\nG0 Z5\nG0 X300 Y1\nG1 Z-2 F120\nX9 F800\nY9\n";
    let free = resumed(&[], program, &request(6)).unwrap();
    assert_eq!(resumed(&["22=1", "20=1", "21=1"], program, &request(6)).unwrap(), free);
}

/// `resume` does not change the store of the machine that it is given.
#[test]
fn the_machine_is_as_it_was() {
    let simulator = machine(&[]);
    let (image, program) = (simulator.store().image(), b"G10 L2 P1 X5\nG21 G90 G0 Z1\nX1\nX2\n");
    resume(&simulator, "a", program, &request(4)).unwrap();
    assert!(image == simulator.store().image());
}

/// Returns a random line of G-code. If `retracts` is `true`, the line can also be G98 or G99.
fn any_line(dice: &mut impl FnMut(usize) -> usize, retracts: bool) -> String {
    let mut length = |most: usize| format!("{:.2}", dice(most * 100) as f64 / 100.0 - most as f64 / 3.0);
    let [x, y, z, i, j] = [6, 6, 6, 2, 2].map(&mut length);
    let feed = 100 + dice(30) * 10;
    match dice(if retracts { 64 } else { 60 }) {
        0..6 => format!("G0 Z{z}"),
        6..9 => format!("G0 X{x} Y{y}"),
        9..12 => format!("G1 Z{z} F{feed}"),
        12..16 => format!("G1 X{x} Y{y} F{feed}"),
        16 => format!("X{x} Y{y}"),
        17 => format!("Y{y}"),
        18 => format!("X{x} Z{z}"),
        19 => "G90".into(),
        20 => "G91".into(),
        21 => "G20".into(),
        22 => "G21".into(),
        23 => format!("G2 X{x} Y{y} R{i}"),
        24 => format!("G3 I{i} J{j}"),
        25 => format!("G2 I{i} J{j} Z{z} F{feed}"),
        26 => ["G17", "G18", "G19"][dice(3)].into(),
        27 => format!("G52 X{x} Z{z}"),
        28 => "G52 X0 Y0 Z0".into(),
        29 => format!("G92 Y{y}"),
        30 => ["G92.1", "G92.2", "G92.3"][dice(3)].into(),
        31 => format!("G43.1 Z{z}"),
        32 => ["G49", "G43 H3", "G43 H4"][dice(3)].into(),
        33 => format!("G{}", 54 + dice(6)),
        34 => ["G59.1", "G59.2", "G59.3"][dice(3)].into(),
        35 => format!("G53 G0 X{x} Z{z}"),
        36 => ["G28", "G28 Z0", "G30 X1"][dice(3)].into(),
        37 if dice(2) == 0 => format!("G95 G1 X{x} F0.{}", 1 + dice(9)),
        37 => format!("G93 G1 X{x} F{}", 20 + dice(30)),
        38 => format!("X{x} F{}", 20 + dice(30)),
        39 => "G94".into(),
        40 => format!("F{feed}"),
        41 => ["G61", "G61.1", "G64", "G64 P0.05", "G64 P0.1 Q0.01"][dice(5)].into(),
        42 => format!("M{} S{}", 3 + dice(2), 100 * dice(9)),
        43 => ["M5", "M9", "M8", "M7", "M0"][dice(5)].into(),
        44 => format!("T{}", dice(5)),
        45 => format!("T{} M6", dice(5)),
        46 => "M61 Q3".into(),
        47 => ["M48", "M49", "M50 P0", "M51 P0", "M50 P1", "M56 P0"][dice(6)].into(),
        48 => ["G90.1", "G91.1"][dice(2)].into(),
        49 => format!(
            "G{} X{x} Y{y} Z{z} R{} Q0.7 P0.1 L{}",
            [81, 82, 83, 73, 85, 86, 89][dice(7)],
            1 + dice(6),
            1 + dice(2)
        ),
        50 => format!("G{} X{x} Z{z} R{} Q0.7 P0.1", [81, 82, 83, 73, 85, 86, 89][dice(7)], 1 + dice(6)),
        51 => "G80".into(),
        52 => format!("G5 X{x} Y{y} I{i} J{j} P{j} Q{i}"),
        53 => format!("G5 X{x} Y{y} P{j} Q{i}"),
        54 => format!("G5.1 X{x} Y{y} I{i} J{j}"),
        55 => format!("A{x}"),
        56 => format!("G1 A{x} Y{y} F{feed}"),
        57 => ["M64 P0", "M65 P0", "M62 P1", "M63 P1", "M65 P1"][dice(5)].into(),
        58 => ["M2", "M30", "M70", "M72", "G68 X1 Y1 R20", "G69", "G51 P2", "G50"][dice(8)].into(),
        59 => ["#1=2", "G0 X#1", "G21 G10 L1 P4 Z2", "G21 G10 L2 P2 X1 Z2", "G10 L2 P1 R10"][dice(5)].into(),
        60 => "G98".into(),
        _ => "G99".into(),
    }
}

/// Returns a random number generator that returns the same series for the same seed.
fn dice_of(seed: u64) -> impl FnMut(usize) -> usize {
    let mut state = seed.wrapping_mul(0x9E37_79B9_7F4A_7C15) | 1;
    move |sides| {
        state ^= state << 13;
        state ^= state >> 7;
        state ^= state << 17;
        (state >> 20) as usize % sides
    }
}

/// Returns a program of random lines ([`any_line`]). Lines that a machine with these settings rejects are left out.
fn any_program(settings: &[&str], seed: u64) -> String {
    let mut dice = dice_of(seed);
    let mut simulator = machine(settings);
    let table = if settings.contains(&"900=0") { "" } else { "G10 L1 P3 Z1.25\n" };
    let mut program = format!("{table}G21 G90\nG0 Z9\nG0 X1 Y1\nG1 Z5 F200");
    simulator.send(format!("{program}\n"));
    simulator.run_until_idle();
    let count = 5 + dice(25);
    for _ in 0..count {
        let line = any_line(&mut dice, seed % 2 == 1);
        simulator.take_output();
        simulator.send(format!("{line}\n"));
        while !simulator.run_until_idle() && simulator.controller().is_paused() {
            simulator.press(oxmill_controller::messages::Realtime::CycleStart);
        }
        if !simulator.take_output().contains("error") {
            program += &format!("\n{line}");
        }
    }
    program
}

#[test]
fn programs_at_random_go_on() {
    let count = |name: &str, or: u64| std::env::var(name).map_or(or, |text| text.parse().unwrap());
    let first = count("OXMILL_RESUME_FIRST", 1);
    for seed in first..first + count("OXMILL_RESUME", 6) {
        let settings: &[&str] = match seed % 5 {
            0 => &["918=1", "930=4"],
            1 => &["900=0"],
            2 => &["918=1", "32=1"],
            _ => &["918=1", "920=1"],
        };
        let program = any_program(settings, seed);
        let all: Vec<usize> = (0..100).filter(|_| seed % 2 == 1).collect();
        println!("seed {seed}\n{program}");
        let refused = compare_all(settings, &program, "G91 G0 X1.7 Y-2.3 Z4.9\nG90", &all);
        println!("{refused:#?}");
    }
}

/// If the job reached the position at feed, the tool must not move down by G0, even if the job reached that Z by G0.
#[test]
fn what_may_have_to_be_cut_is_not_reached_by_a_rapid() {
    let program = "G21 G90\nG0 Z5\nG0 X0 Y0\nM3 S1000\nG0 Z-5\nG1 X50 F800\nX100\nG0 Z5\n";
    let why = resumed(&[], program, &request(7)).unwrap_err();
    assert!(why.contains("--plunge"), "{why}");
    let slow = ResumeRequest { plunge: Some(Decimal(600_000_000)), ..request(7) };
    assert_eq!(resumed(&[], program, &slow).unwrap().prologue[6..], ["G1 Z-5 F60", "G1 F800"]);
    assert_eq!(resumed(&[], program, &request(6)).unwrap().prologue[6..], ["G0 Z-5", "G0"]);
}

/// The feed rate of a ramp is a cutting feed, not a plunge feed.
#[test]
fn a_plunge_is_a_move_straight_down() {
    let program = "G21 G90\nG0 Z5\nG0 X0 Y0\nG1 Z0 F100\nX50 Z-1 F3000\nX90 Z-2\nG0 Z5\n";
    assert_eq!(resumed(&[], program, &request(7)).unwrap().prologue[4..], ["G1 Z-2 F100", "G1 F3000"]);
    let ramps = program.replace("G1 Z0", "G1 X1 Z0");
    assert!(resumed(&[], &ramps, &request(7)).unwrap_err().contains("--plunge"));
}

/// The tool travels at the highest Z of the job. If the job has travelled at an unknown Z, the clearance must be given.
#[test]
fn the_clearance_is_the_highest_height_or_must_be_said() {
    let retract = "G21 G90\nG0 Z5\nG0 X1 Y1\nG1 Z-1 F100\nX5\nG1 Z20\nX9\nZ-1\nX12\n";
    assert_eq!(resumed(&[], retract, &request(8)).unwrap().prologue[2..4], ["G0 Z20", "G0 X9 Y1"]);
    assert_eq!(resumed(&[], retract, &request(9)).unwrap().prologue[2..4], ["G0 Z20", "G0 X9 Y1"]);
    let low = ResumeRequest { clearance: Some(Coordinate(100_000_000)), ..request(8) };
    assert!(resumed(&[], retract, &low).unwrap_err().contains("below the place"));
    for unknown in [
        "G21 G90\nG53 G0 Z-5\nG0 X1 Y1\nG0 Z2\nG1 Z-1 F100\nX5\nX6\n",
        "G21 G90\nG1 F100\nG28 G91 Z0\nG90 X1 Y1\nG0 Z2\nX2\nX3\n",
        "G21 G90\nG0 X1 Y1\nG0 Z2\nG1 Z-1 F100\nX5\nX6\n",
        "G21 G90\nG0 Z9\nX1 Y1\nG55 G0 Z2\nX3 Y3\nX6\n",
    ] {
        let line = unknown.lines().count() as u64;
        let why = resumed(&[], unknown, &request(line)).unwrap_err();
        assert!(why.contains("travels at a Z that is not known") && why.contains("Z2: give"), "{unknown}{why}");
        let high = ResumeRequest { clearance: Some(Coordinate(300_000_000)), ..request(line) };
        assert_eq!(resumed(&[], unknown, &high).unwrap().prologue[2], "G0 Z30");
    }
}

/// The tool must not travel at a Z that the job has reached only before its tool offset (G43.1). With the offset, that
/// Z needs a higher spindle position, which could exceed the travel.
#[test]
fn the_spindle_goes_no_higher_than_in_the_job() {
    let program = "G21 G90\nG0 Z100\nX1 Y1\nG43.1 Z60\nG0 Z15\nG1 Z-1 F100\nX5\nX6\n";
    assert!(resumed(&[], program, &request(8)).unwrap_err().contains("the spindle would be higher at Z100"));
    let said = ResumeRequest { clearance: Some(Coordinate(150_000_000)), ..request(8) };
    assert_eq!(resumed(&[], program, &said).unwrap().prologue[2..4], ["G43.1 Z60", "G0 Z15"]);
    let lower = program.replace("Z100", "Z14");
    assert_eq!(resumed(&[], &lower, &request(8)).unwrap().prologue[3], "G0 Z15");
}

/// G98 would retract to the Z at which the cycles began, and this Z is within the work.
#[test]
fn cycles_that_began_in_the_work_do_not_go_on() {
    let program = "G21 G90\nG0 Z5\nG0 X1\nG1 Z-3 F100\nG98 G81 X2 Z-5 R2\nX3\nX4\n";
    assert!(resumed(&[], program, &request(7)).unwrap_err().contains("below R"));
}

/// The results of probing moves and the states of inputs are unknown when a job is resumed. A job whose rest depends on
/// them is rejected.
#[test]
fn what_probes_and_inputs_tell_is_not_known() {
    let refused = |program: &str, word: &str| {
        let why = resumed(&[], program, &request(program.lines().count() as u64)).unwrap_err();
        assert!(why.contains(word), "{program}: {why}");
    };
    refused("G21 G90\nG0 Z5\nG38.3 Z-10 F100\nG92 Z0\nG0 Z5\nX5\nX6\n", "line 3 probes");
    refused("G21 G90\nG0 Z5\nG38.3 Z-10 F100\nG0 Z5\nG0 Z#5063\n", "line 3 probes");
    refused("G21 G90\nG0 Z5\nG0 X1\nM66 P0 L0\nG1 X2 F100\nX#5399\n", "M66");
    refused("G21 G90\nG43.1 Z[#5422+1]\nG0 Z5\nX1\nX2\n", "the tool length offset");
    refused("G21 G90\nF[#5420*10+100]\nG0 Z5\nX1\nX2\n", "a mode such as");
    refused("$C\nG21 G90\nG0 X1\nX2\n", "check mode");
    // Here, no later line uses the result of M66.
    assert!(resumed(&[], "G21 G90\nG0 Z5\nG0 X1\nM66 P0 L0\nX2\nX3\n", &request(6)).is_ok());
}

#[test]
fn outputs_of_the_program_are_on_again() {
    let program = "G21 G90\nG0 Z5\nG0 X1\nM62 P2\nM64 P3\nG1 X2 F100\nX3\n";
    assert!(resumed(&[], program, &request(6)).unwrap_err().contains("M62"));
    let prologue = resumed(&[], program, &request(7)).unwrap().prologue;
    assert_eq!(prologue[2..], ["G0 Z5", "G0 X2", "M64 P2", "M64 P3", "G1 F100"]);
}

/// A G5 without I and J continues the curve that ends where the G5 begins. If that curve is not part of the rest, a
/// machine that runs the rest would reject the G5, and cut the next line from the wrong position.
#[test]
fn a_curve_that_goes_on_from_one_in_front_is_refused() {
    let front = "G21 G90\nG0 Z5\nG0 X0 Y0\nG5 X2 Y2 I1 J0 P-1 Q0 F100\nG0 X9\nX8\n";
    for (rest, line) in [
        ("G0 X2 Y2\nG5 X4 Y0 P1 Q1\n", Some(8)),
        ("G0 X2 Y2\n(to the end)\nX2\nG5.0 P1 Q1 X4 Y0\nG0 X0\n", Some(10)),
        // It is not known whether a slash skips the line.
        ("/G5 X4 Y0 I1 J1 P1 Q1\nG0 X2 Y2\nG5 X4 Y0 P1 Q1\n", Some(9)),
        ("G5 X4 Y0 I1 J1 P1 Q1\nX8 P1 Q1\n", None),
        ("G5 X4 Y0 I1 J1 P1 Q1\nG0 X2 Y2\nX4 Y0\nG5 X8 P1 Q1\n", None),
        ("G5.1 X4 Y0 I1 J1\nG5.2 X1 Y1 P1 L3\nX4 P1\nX5 P2\nG5.3\n", None),
        ("G0 X4 (G5 X4)\nG4 P1\nM2\nG5 X8 P1 Q1\n", None),
    ] {
        let resumed = resumed(&[], &format!("{front}{rest}"), &request(6));
        let why = resumed.err();
        let word = line.map(|line| format!("line {line} (G5 without I and J)"));
        let is_right =
            why.as_ref().zip(word.as_ref()).map_or(why.is_none() == word.is_none(), |(why, word)| why.contains(word));
        assert!(is_right, "{rest}: {why:?}");
    }
    let mode = "G21 G90\nG0 Z5\nG0 X0 Y0\nG5 X2 Y2 I1 J0 P-1 Q0 F100\nX4 I1 J0 P1 Q1\nX9 P0 Q1\n";
    assert!(resumed(&[], mode, &request(5)).is_ok());
}

/// The plunge feed must be at least 1 mm/min. Simulating a slower plunge would take hours, and Grbl does not support it
/// either.
#[test]
fn a_plunge_is_not_slower_than_grbl_goes() {
    let program = "G21 G90\nG0 Z5\nG0 X1\nG1 Z-1 F100\nX5\nX6\n";
    let plunge = |feed| resumed(&[], program, &ResumeRequest { plunge: Some(Decimal(feed)), ..request(6) });
    for feed in [0, 1, 9_999_999] {
        assert!(plunge(feed).unwrap_err().contains("1 mm/min"));
    }
    assert!(plunge(10_000_000).is_ok());
}

/// Homing at the beginning of a job, M0 between arcs, and changes of the feed mode before an F do not prevent resuming.
/// A G5 without I and J continues an earlier curve. If that curve is not part of the rest, the job is rejected, even if
/// another move is between the curve and the G5.
#[test]
fn what_matters_not_does_not_hinder() {
    assert!(resumed(&[], "$H\nG21 G90\nG0 Z5\nX1\n", &request(4)).is_ok());
    assert!(resumed(&[], "G21 G90\nG0 Z5\n$H\nX1\n", &request(4)).is_err());
    let arc = "G21 G90\nG0 Z5\nG0 X0 Y0\nG2 X2 I1 F100\nM0\n/2 X4 I1\nX6 I1\n";
    let rest = resumed(&[], arc, &request(5)).unwrap();
    assert!(rest.program.ends_with(b"M0\n/2 G2 X4 I1\nX6 I1\n"), "{}", String::from_utf8_lossy(&rest.program));
    let feed = "G21 G90\nG0 Z5\nG0 X0 Y0\nG1 Z1 F300\nF100\nG93\nG94\nM8\nX3 F90\n";
    assert!(resumed(&[], feed, &request(8)).is_ok());
    let curve = "G21 G90\nG0 Z5\nG0 X0 Y0\nG5 X2 Y2 I1 J0 P-1 Q0 F100\nG2 I1\nG5 X4 Y0 P1 Q1\n";
    assert!(resumed(&[], curve, &request(5)).unwrap_err().contains("curve"));
}
