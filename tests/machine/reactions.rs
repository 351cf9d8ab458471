//! Faults in every machine state, with every reaction that the settings offer: checks motion, spindle, messages, and
//! whether the position is still trusted.

use oxmill_controller::axes::Axis;
use oxmill_controller::messages::SpindleDirection;
use oxmill_simulator::{Options, Simulator};
use std::time::Duration;

const STEPS_PER_MM: f64 = 250.0;
/// Acceleration, mm/s2.
const ACCELERATION: f64 = 500.0;
/// Feed of the job, mm/s.
const FEED: f64 = 20.0;
const PARKED_Z: f64 = -5.0;
/// Distance, mm, that the machine still moves at full feed until the controller notices a fault: a filter delays the
/// pin, and the control task runs only at intervals.
const LATE: f64 = 0.1;
/// Host timeout, ms.
const SILENCE: u64 = 500;
/// Distance, mm, that the machine still moves at full feed before a hold acts. It is covered by the segments that are
/// already queued for the step task, which last 20 ms.
const QUEUED: f64 = 0.02 * FEED;

#[derive(Clone, Copy, Debug, PartialEq)]
enum Fault {
    Limit,
    Emergency,
    Driver,
    Spindle,
    Host,
    Silence,
}

impl Fault {
    const ALL: [Fault; 6] =
        [Fault::Limit, Fault::Emergency, Fault::Driver, Fault::Spindle, Fault::Host, Fault::Silence];

    fn setting(self) -> u16 {
        match self {
            Fault::Limit => 924,
            Fault::Emergency => 925,
            Fault::Driver => 926,
            Fault::Spindle => 927,
            Fault::Host | Fault::Silence => 928,
        }
    }

    fn reactions(self) -> std::ops::Range<u8> {
        if self == Fault::Emergency { 0..3 } else { 0..6 }
    }

    fn happen(self, mill: &mut Simulator) {
        match self {
            Fault::Limit => pin(mill, "limit y 1"),
            Fault::Emergency => pin(mill, "estop 1"),
            Fault::Driver => pin(mill, "fault 1"),
            Fault::Spindle => pin(mill, "at_speed 0"),
            Fault::Host => mill.disconnect(),
            // This fault happens by itself when the host sends nothing.
            Fault::Silence => {}
        }
    }

    /// Returns how long the cause of this fault must last until the controller treats it as a fault, ms.
    fn lasts(self) -> u64 {
        match self {
            Fault::Spindle => 51,
            // The host's last byte, a status request, arrived 3 ms ago.
            Fault::Silence => SILENCE - 3 + 1,
            _ => 0,
        }
    }

    fn is_of_host(self) -> bool {
        matches!(self, Fault::Host | Fault::Silence)
    }

    fn alarm(self) -> &'static str {
        match self {
            Fault::Limit => "ALARM:1\r",
            Fault::Emergency => "ALARM:101\r",
            Fault::Driver => "ALARM:102\r",
            Fault::Spindle => "ALARM:14\r",
            Fault::Host | Fault::Silence => "ALARM:3\r",
        }
    }
}

/// State of the machine when the fault occurs.
#[derive(Clone, Copy, Debug, PartialEq)]
enum State {
    Idle,
    Run,
    Dwell,
    Probe,
    Pause,
    ToolChange,
    SingleBlock,
    Jog,
    HoldBraking,
    HoldAtRest,
    Stopping,
    DoorBraking,
    DoorPullingOut,
    DoorParked,
    DoorReturning,
    Home,
    Alarm,
    Check,
    Sleep,
}

impl State {
    const ALL: [State; 19] = [
        State::Idle,
        State::Run,
        State::Dwell,
        State::Probe,
        State::Pause,
        State::ToolChange,
        State::SingleBlock,
        State::Jog,
        State::HoldBraking,
        State::HoldAtRest,
        State::Stopping,
        State::DoorBraking,
        State::DoorPullingOut,
        State::DoorParked,
        State::DoorReturning,
        State::Home,
        State::Alarm,
        State::Check,
        State::Sleep,
    ];

    fn enter(self, mill: &mut Simulator) {
        let run = "M3 S500\nG91 G1 X-20 F1200\n";
        let (lines, then) = match self {
            State::Idle => ("M3 S500\n", ""),
            State::Run => (run, ""),
            State::Dwell => ("M3 S500\nG4 P20\n", ""),
            State::Probe => ("M3 S500\nG91 G38.3 X-20 F1200\n", ""),
            State::Pause => ("M3 S500\nM0\n", ""),
            State::ToolChange => ("$900=1\n$918=1\nM3 S500\nT2 M6\n", ""),
            // The machine waits after the first move.
            State::SingleBlock => ("M3 S500\nG91 G1 X-1 F1200\nX-20\n", ""),
            State::Jog => ("M3 S500\n$J=G91 X-20 F1200\n", ""),
            State::HoldBraking => (run, "!"),
            State::HoldAtRest => (run, "! "),
            State::Stopping => (run, "\x19"),
            State::DoorBraking => (run, "\u{84}"),
            State::DoorPullingOut => (run, "\u{84} "),
            State::DoorParked => (run, "\u{84}       "),
            State::DoorReturning => (run, "\u{84}       ~"),
            State::Home => ("$H\n", ""),
            // A soft limit; after the reset the machine stays locked.
            State::Alarm => ("$20=1\nG90 G1 X5 F100\n", "\x18"),
            State::Check => ("$C\n", ""),
            State::Sleep => ("$SLP\n", "      "),
        };
        if self == State::SingleBlock {
            mill.send([0x89]);
        }
        mill.send(lines);
        mill.run_for(Duration::from_millis(300));
        for command in then.chars() {
            match command {
                // A space is no command. It only lets a second pass, so that the next phase begins.
                ' ' => mill.run_for(Duration::from_secs(1)),
                command => mill.send([command as u32 as u8]),
            }
        }
        mill.run_for(Duration::from_millis(10));
        let said = mill.take_output();
        let name = status(mill);
        let wanted = match self {
            State::Idle => "<Idle|",
            State::Run | State::Dwell | State::Probe => "<Run|",
            State::Pause | State::ToolChange | State::SingleBlock => "<Hold:0|",
            State::Jog => "<Jog|",
            State::HoldBraking | State::Stopping => "<Hold:1|",
            State::HoldAtRest => "<Hold:0|",
            State::DoorBraking | State::DoorPullingOut => "<Door:2|",
            State::DoorParked => "<Door:0|",
            State::DoorReturning => "<Door:3|",
            State::Home => "<Home|",
            State::Alarm => "<Alarm|",
            State::Check => "<Check|",
            State::Sleep => "<Sleep|",
        };
        assert!(name.contains(wanted) || self == State::Dwell && name.contains("<Idle|"), "{self:?}: {said}{name}");
    }

    /// Returns whether a job or jog moves in this state, so that the machine can brake for a fault.
    fn brakes(self) -> bool {
        matches!(
            self,
            State::Run | State::Probe | State::Jog | State::HoldBraking | State::Stopping | State::DoorBraking
        )
    }

    fn moves(self) -> bool {
        self.brakes() || matches!(self, State::DoorPullingOut | State::DoorReturning | State::Home)
    }

    fn spindle_turns(self) -> bool {
        !matches!(
            self,
            // M6 switches the spindle off.
            State::ToolChange
                | State::DoorBraking
                | State::DoorPullingOut
                | State::DoorParked
                | State::DoorReturning
                | State::Home
                | State::Alarm
                | State::Check
                | State::Sleep
        )
    }

    /// Returns whether the controller treats the cause of this fault as a fault in this state.
    fn heeds(self, fault: Fault) -> bool {
        match fault {
            Fault::Limit => !matches!(self, State::Home | State::Alarm),
            Fault::Emergency | Fault::Driver => true,
            Fault::Spindle => matches!(self, State::Run | State::Dwell | State::Probe),
            Fault::Host | Fault::Silence => matches!(self, State::Run | State::Dwell | State::Probe | State::Jog),
        }
    }
}

fn pin(mill: &mut Simulator, line: &str) {
    assert_eq!(mill.pin_line(line), "ok", "{line}");
}

fn status(mill: &mut Simulator) -> String {
    mill.take_output();
    mill.send("?");
    mill.run_for(Duration::from_millis(3));
    mill.take_output()
}

/// Lets time pass while the host requests status reports.
fn run_polled(mill: &mut Simulator, seconds: u32) {
    for _ in 0..10 * seconds {
        mill.send("?");
        mill.run_for(Duration::from_millis(100));
    }
}

/// Returns a homed machine with parking, at rest above its work.
fn homed() -> Simulator {
    let mut mill = Simulator::new(Options::default());
    let settings = "$21=0\n$22=1\n$24=600\n$25=2000\n$26=50\n$41=1\n$110=3000\n$111=3000\n$112=3000\n$120=500\n$121=500\n\
                    $122=500\n$392=0\n$393=0\n$59=3000\n$915=1\n$929=0.05\n$916=0.05\n";
    for line in settings.lines() {
        mill.send(format!("{line}\n"));
        assert!(mill.run_until_idle(), "{line}");
    }
    pin(&mut mill, "at_speed 1");
    mill.send("$H\n");
    let touch = |mill: &mut Simulator, switches: &[&str]| {
        for _ in 0..2 {
            mill.run_for(Duration::from_millis(400));
            switches.iter().for_each(|switch| pin(mill, &format!("limit {switch} 1")));
            mill.run_for(Duration::from_millis(20));
            switches.iter().for_each(|switch| pin(mill, &format!("limit {switch} 0")));
        }
    };
    touch(&mut mill, &["z"]);
    touch(&mut mill, &["x", "y"]);
    mill.run_for(Duration::from_secs(2));
    mill.send("$21=1\nG53 G0 X-100 Y-100 Z-30\n");
    assert!(mill.run_until_idle(), "{}", mill.take_output());
    assert!(mill.controller().is_trusted(), "{}", mill.take_output());
    mill.take_output();
    mill
}

/// Returns the controller's machine position, mm.
fn position(mill: &Simulator) -> [f64; 3] {
    let position = mill.controller().machine_position();
    [Axis::X, Axis::Y, Axis::Z].map(|axis| position.get(axis).unwrap().to_mm().into())
}

/// Returns the distance moved on each axis, mm. `from`: the step counts at the start.
fn moved(mill: &Simulator, from: [i32; 3]) -> [f64; 3] {
    let now = mill.machine().position();
    std::array::from_fn(|i| f64::from(now[i] - from[i]) / STEPS_PER_MM)
}

fn turns(mill: &Simulator) -> bool {
    mill.outputs().is_some_and(|outputs| outputs.spindle != SpindleDirection::Off && outputs.power != 0)
}

/// One combination of fault, reaction and state, and the machine after it.
struct Case {
    fault: Fault,
    reaction: u8,
    state: State,
    mill: Simulator,
    /// Step counts of the motors, and the position in mm, right after homing.
    origin: ([i32; 3], [f64; 3]),
    at_fault: [f64; 3],
    trusted: bool,
    said: String,
}

impl Case {
    fn run(homed: &Simulator, fault: Fault, reaction: u8, state: State) -> Case {
        let mut mill = homed.clone();
        let origin = (mill.machine().position(), position(&mill));
        mill.send(format!("${}={reaction}\n", fault.setting()));
        if fault == Fault::Silence {
            let seconds = SILENCE as f64 / 1000.0;
            mill.send(format!("$922={seconds}\n$923={seconds}\n"));
        }
        assert!(mill.run_until_idle());
        state.enter(&mut mill);
        let trusted = mill.controller().is_trusted();
        mill.take_output();
        let at_fault = moved(&mill, origin.0);
        fault.happen(&mut mill);
        mill.run_for(Duration::from_millis(fault.lasts().max(3)));
        let at_fault = if fault.lasts() > 0 { moved(&mill, origin.0) } else { at_fault };
        mill.run_for(Duration::from_secs(12));
        let said = mill.take_output();
        Case { fault, reaction, state, mill, origin, at_fault, trusted, said }
    }

    fn name(&self) -> String {
        format!("{:?} with ${}={} in {:?}: {}", self.fault, self.fault.setting(), self.reaction, self.state, self.said)
    }

    fn controlled(&self) -> bool {
        !self.reaction.is_multiple_of(3) && self.state.brakes()
    }

    fn retracts(&self) -> bool {
        // After a driver fault the position is not trusted, so the tool is not parked.
        self.reaction % 3 == 2 && self.state.brakes() && self.fault != Fault::Driver
    }

    /// Returns the distance along X and the displacement along Z since the fault, mm.
    fn after_fault(&self) -> (f64, f64) {
        let now = moved(&self.mill, self.origin.0);
        ((now[0] - self.at_fault[0]).abs(), now[2] - self.at_fault[2])
    }

    fn check_path(&self) {
        let (x, z) = self.after_fault();
        let braking = FEED * FEED / 2.0 / ACCELERATION;
        let name = self.name();
        if !self.controlled() {
            assert!(x <= LATE && z.abs() <= LATE, "it has moved by {x}, {z}: {name}");
            return;
        }
        assert!(x <= braking + QUEUED + LATE, "it has braked for {x} mm: {name}");
        let is_at_feed = matches!(self.state, State::Run | State::Jog);
        assert!(!is_at_feed || x >= braking * 0.9, "it has braked for {x} mm: {name}");
        let parked = self.origin.1[2] + moved(&self.mill, self.origin.0)[2];
        let wanted = if self.retracts() { PARKED_Z } else { self.origin.1[2] };
        assert!((parked - wanted).abs() < 0.01, "Z {parked}: {name}");
    }

    fn check_outcome(&self) {
        let name = self.name();
        let keeps_position = self.controlled() || !self.state.moves();
        let by_driver = self.fault == Fault::Driver;
        assert_eq!(self.mill.controller().is_trusted(), self.trusted && keeps_position && !by_driver, "{name}");
        let on = self.reaction >= 3 && self.state.spindle_turns();
        assert_eq!(turns(&self.mill), on, "{name}");
        assert_eq!(self.said.matches("ALARM:").count(), 1, "{name}");
        assert!(self.said.contains(self.fault.alarm()), "{name}");
        let told = position(&self.mill);
        let counted = moved(&self.mill, self.origin.0);
        for axis in 0..3 {
            let off = told[axis] - self.origin.1[axis] - counted[axis];
            assert!(off.abs() < 0.003, "axis {axis} is off by {off}: {name}");
        }
    }

    /// Checks that homing failed with the fault's alarm.
    fn check_homing(&self) {
        let name = self.name();
        assert!(self.said.contains(self.fault.alarm()), "{name}");
        assert!(!self.mill.controller().is_trusted() && !turns(&self.mill), "{name}");
    }

    /// Checks that a jog ended as if it had been cancelled, whatever reaction is set for jobs.
    fn check_jog(self) {
        let name = self.name();
        let (x, z) = self.after_fault();
        let braking = FEED * FEED / 2.0 / ACCELERATION;
        assert!(x >= braking * 0.9 && x <= braking + QUEUED + LATE && z.abs() <= LATE, "{x}, {z}: {name}");
        assert!(self.mill.is_idle() && self.mill.controller().is_trusted(), "{name}");
        assert_eq!(self.said.contains("The host is silent"), self.fault == Fault::Silence, "{name}");
        assert!(!self.said.contains("ALARM:"), "{name}");
    }

    /// Checks that a job that waits for its host can be resumed and ends at the right position.
    fn check_wait(self) {
        self.check_path();
        self.check_resumed();
    }

    fn check_resumed(mut self) {
        let name = self.name();
        assert!(self.mill.controller().is_trusted() && !self.said.contains("ALARM"), "{name}");
        assert_eq!(self.said.contains("The host is silent"), self.fault == Fault::Silence, "{name}");
        assert_eq!(turns(&self.mill), self.reaction >= 3, "{name}");
        self.mill.connect();
        self.mill.run_for(Duration::from_millis(10));
        let state = status(&mut self.mill);
        let wanted = if self.reaction == 4 { "<Hold:0|" } else { "<Door:0|" };
        assert!(state.contains(wanted), "{state} after {name}");
        self.mill.send("~");
        run_polled(&mut self.mill, 30);
        assert!(self.mill.is_idle() && turns(&self.mill), "{name}");
        let travelled = moved(&self.mill, self.origin.0)[0];
        let wanted = if self.state == State::Dwell { 0.0 } else { -20.0 };
        assert!((travelled - wanted).abs() < 0.003, "X has moved by {travelled}: {name}");
    }

    /// Clears the faults and resets. After that, the machine must be usable without homing if the controller trusts the
    /// position, and only then.
    fn check_reset(mut self) {
        let trusted = self.mill.controller().is_trusted();
        for line in ["limit y 0", "estop 0", "fault 0", "at_speed 1"] {
            pin(&mut self.mill, line);
        }
        self.mill.connect();
        self.mill.run_for(Duration::from_millis(10));
        self.mill.send("\x18");
        self.mill.run_for(Duration::from_millis(100));
        assert!(!turns(&self.mill), "{}", self.name());
        self.mill.send("$X\nG90 G53 G0 X-90 Y-90\n");
        run_polled(&mut self.mill, 5);
        let said = self.mill.take_output();
        assert!(self.mill.is_idle(), "{said} after {}", self.name());
        let there = position(&self.mill);
        let reached = (there[0] + 90.0).abs() < 0.003 && (there[1] + 90.0).abs() < 0.003;
        assert_eq!(reached, trusted, "{there:?} {said} after {}", self.name());
    }
}

#[test]
fn each_fault_in_each_state_has_the_reaction_that_is_set() {
    let homed = homed();
    let mut cases = 0;
    for fault in Fault::ALL {
        for reaction in fault.reactions() {
            for state in State::ALL.into_iter().filter(|state| state.heeds(fault)) {
                let case = Case::run(&homed, fault, reaction, state);
                cases += 1;
                if state == State::Jog && fault.is_of_host() {
                    case.check_jog();
                    continue;
                }
                if fault.is_of_host() && reaction % 3 != 0 {
                    case.check_wait();
                    continue;
                }
                case.check_path();
                if state == State::Home {
                    case.check_homing();
                } else {
                    case.check_outcome();
                    case.check_reset();
                }
            }
        }
    }
    let with_job = 3;
    assert_eq!(cases, 19 * (3 + 6) + 17 * 6 + with_job * (6 + 6 + 6) + 2 * 6, "states, reactions and faults");
}

/// Some causes are no fault in some states: a slow spindle or a missing host while no job runs, or a limit switch
/// during an alarm. Then the machine goes on as if nothing had happened.
#[test]
fn what_is_no_fault_in_a_state_changes_nothing() {
    let homed = homed();
    let mut cases = 0;
    for fault in Fault::ALL {
        // Leave out two kinds of cases that other tests cover. While the tool returns after a door, the controller
        // checks host and spindle only when the job continues. In a homing cycle, limit switches are expected to close.
        let is_later = |state: State| match fault {
            Fault::Limit => state == State::Home,
            _ => state == State::DoorReturning,
        };
        for state in State::ALL.into_iter().filter(|state| !state.heeds(fault) && !is_later(*state)) {
            let mut polled = homed.clone();
            state.enter(&mut polled);
            run_polled(&mut polled, 12);
            let wanted = status(&mut polled);
            for reaction in fault.reactions() {
                cases += 1;
                let mut case = Case::run(&homed, fault, reaction, state);
                let name = case.name();
                assert!(!case.said.contains("The host is silent"), "{name}");
                assert!(!case.said.contains(fault.alarm()), "{name}");
                if fault.is_of_host() {
                    case.mill.connect();
                }
                case.mill.run_for(Duration::from_millis(10));
                let there = status(&mut case.mill);
                assert_eq!(place_and_mode(&there), place_and_mode(&wanted), "{name}");
                assert_eq!(turns(&case.mill), turns(&polled), "{name}");
            }
        }
    }
    let (host, spindle, limit) = (14 * 6, 15 * 6, 6);
    assert_eq!(cases, 2 * host + spindle + limit, "states, reactions and faults");
}

/// If the spindle is below its speed while a job is being resumed after a door, the job does not continue: it ends with
/// an alarm.
#[test]
fn a_spindle_that_is_slow_on_the_way_back_stops_the_job_there() {
    let homed = homed();
    for reaction in Fault::Spindle.reactions() {
        let case = Case::run(&homed, Fault::Spindle, reaction, State::DoorReturning);
        let (x, _) = case.after_fault();
        let name = case.name();
        assert!(case.said.contains("ALARM:14") && x < 1.0, "X {x}: {name}");
        assert!(case.mill.controller().is_trusted(), "{name}");
        assert!(!turns(&case.mill), "{name}");
        case.check_reset();
    }
}

/// A job that is resumed after a door stops if its host disconnects or falls silent while the tool returns to the work.
#[test]
fn a_host_that_goes_or_is_silent_on_the_way_back_stops_the_job_there() {
    let homed = homed();
    for fault in [Fault::Host, Fault::Silence] {
        for reaction in fault.reactions() {
            let mut case = Case::run(&homed, fault, reaction, State::DoorReturning);
            // In this time the tool returns to the work, and retracts again.
            case.mill.run_for(Duration::from_secs(12));
            let name = case.name();
            let (x, _) = case.after_fault();
            let longest = if fault == Fault::Host { 1.0 } else { 1.0 + FEED * (SILENCE as f64 / 1000.0 + 0.1) };
            assert!(x < longest, "X {x}: {name}");
            if reaction % 3 == 0 {
                assert!(case.said.contains("ALARM:3"), "{name}");
                assert_eq!(turns(&case.mill), reaction == 3, "{name}");
            } else {
                case.check_resumed();
            }
        }
    }
}

/// Returns the first two fields of a status report: the state and the position.
fn place_and_mode(report: &str) -> Vec<&str> {
    let report = report.lines().find(|line| line.starts_with('<')).expect("a report");
    report.split('|').take(2).collect()
}

#[test]
fn a_host_that_goes_while_a_spindle_comes_up_again_leaves_the_job_held() {
    // `by_button`: the operator presses the start button, which can resume the job without a host.
    for by_button in [false, true] {
        let mut mill = milling("$916=10\n");
        for command in [b'!', 0x9e] {
            mill.send([command]);
            mill.run_for(Duration::from_secs(1));
        }
        pin(&mut mill, "at_speed 0");
        mill.send("~");
        mill.run_for(Duration::from_secs(1));
        let there = mill.machine().position();
        mill.disconnect();
        if by_button {
            pin(&mut mill, "start 1");
        }
        mill.run_for(Duration::from_secs(1));
        pin(&mut mill, "at_speed 1");
        mill.run_for(Duration::from_secs(5));
        let x = moved(&mill, there)[0].abs();
        assert!(if by_button { x > 5.0 } else { x < 0.5 }, "{by_button} {x}: {}", mill.take_output());
        mill.connect();
        assert!(by_button || status(&mut mill).contains("<Hold:0|"));
    }
}

#[test]
fn the_tool_is_not_parked_into_a_closed_switch() {
    let mut mill = homed();
    mill.send("$924=2\n");
    assert!(mill.run_until_idle());
    State::Run.enter(&mut mill);
    pin(&mut mill, "limit z 1");
    mill.run_for(Duration::from_secs(12));
    let said = mill.take_output();
    assert!(said.contains("ALARM:1\r") && mill.controller().is_trusted() && !turns(&mill), "{said}");
    assert!((position(&mill)[2] + 30.0).abs() < 0.003, "{:?} {said}", position(&mill));
}

#[test]
fn a_spindle_that_does_not_come_up_stays_on_only_if_that_is_set() {
    for (reaction, on) in [(0, false), (1, false), (2, false), (3, true), (4, true), (5, true)] {
        let mut mill = homed();
        pin(&mut mill, "at_speed 0");
        mill.send(format!("$927={reaction}\nM3 S500\n"));
        mill.run_for(Duration::from_secs(5));
        let said = mill.take_output();
        assert!(said.contains("ALARM:14\r") && mill.controller().is_trusted(), "{said}");
        assert_eq!(turns(&mill), on, "$927={reaction}: {said}");
        assert!((position(&mill)[2] + 30.0).abs() < 0.003, "{:?} {said}", position(&mill));
    }
}

/// Returns a homed machine with these settings that mills along X.
fn milling(settings: &str) -> Simulator {
    let mut mill = homed();
    mill.send(settings);
    assert!(mill.run_until_idle());
    State::Run.enter(&mut mill);
    mill
}

#[test]
fn no_beam_is_left_while_the_machine_brakes() {
    for (fault, settings) in [
        (Fault::Emergency, "$925=1\n"),
        (Fault::Limit, "$924=4\n"),
        (Fault::Driver, "$926=2\n"),
        (Fault::Host, "$928=5\n"),
    ] {
        for beam in ["M3", "M4"] {
            let mut mill = homed();
            mill.send(format!("$32=1\n{settings}{beam} S1000\nG91 G1 X-20 F1200\n"));
            mill.run_for(Duration::from_millis(300));
            assert!(mill.power() != 0 && mill.is_stepping(), "{}", mill.take_output());
            fault.happen(&mut mill);
            mill.run_for(Duration::from_millis(5));
            // The enable output is off at once. But the segments that are already queued for the step task still carry
            // their power. So the power is 0 only after these segments.
            mill.run_for(Duration::from_millis(25));
            assert!(mill.power() == 0 && mill.is_stepping(), "{fault:?} {beam}: {}", mill.take_output());
            mill.run_for(Duration::from_secs(2));
            assert_eq!(mill.power(), 0);
        }
    }
}

#[test]
fn at_an_open_door_no_spindle_turns() {
    let mut mill = milling("$928=5\n");
    mill.disconnect();
    mill.run_for(Duration::from_secs(12));
    assert!(turns(&mill), "{}", mill.take_output());
    pin(&mut mill, "door 1");
    mill.run_for(Duration::from_millis(10));
    assert!(!turns(&mill), "parked for a host that has gone");
    for milliseconds in [0, 2000] {
        let mut mill = milling("$924=4\n");
        pin(&mut mill, "limit y 1");
        mill.run_for(Duration::from_millis(3 + milliseconds));
        assert!(turns(&mill), "{}", mill.take_output());
        pin(&mut mill, "door 1");
        mill.run_for(Duration::from_millis(10));
        assert!(!turns(&mill), "{milliseconds} ms after the fault: {}", mill.take_output());
        assert!(mill.run_until_idle());
        assert!(!turns(&mill));
    }
}

#[test]
fn a_door_that_opens_on_the_way_back_stops_the_spindle_where_it_is() {
    let mut mill = milling("$928=5\n$57=100\n");
    mill.disconnect();
    mill.run_for(Duration::from_secs(12));
    mill.connect();
    mill.run_for(Duration::from_millis(10));
    mill.send("~");
    mill.run_for(Duration::from_millis(300));
    assert!(status(&mut mill).contains("<Door:3|") && turns(&mill));
    let deepest = position(&mill)[2];
    pin(&mut mill, "door 1");
    mill.run_for(Duration::from_millis(10));
    assert!(!turns(&mill), "{}", mill.take_output());
    mill.run_for(Duration::from_secs(12));
    assert!(position(&mill)[2] > deepest && status(&mut mill).contains("<Door:1|"), "{:?}", position(&mill));
}

#[test]
fn a_spindle_that_is_given_time_costs_no_time() {
    let mut mill = homed();
    pin(&mut mill, "at_speed 0");
    mill.send("$916=1\n$929=0.1\n$394=4\n");
    assert!(mill.run_until_idle());
    mill.take_output();
    // The at-speed check ends before the spin-up does. The simulator must jump to the next event in time: if it polled
    // until the spin-up ends, each poll would advance the clock by only one tick.
    mill.send("M3 S500\n");
    let begun = mill.clock().now();
    let mut looks = 0;
    while mill.clock().now() < begun + 6 * u64::from(mill.board().step_clock_hz) && mill.advance_once(u64::MAX / 4) {
        looks += 1;
    }
    let said = mill.take_output();
    assert!(looks < 10_000, "{looks} looks: {said}");
    assert!(said.contains("ALARM:14\r"), "{said}");
}

#[test]
fn the_heavier_of_two_faults_is_told_and_acts() {
    // An emergency stop outranks a driver fault that comes while the machine brakes for the emergency stop.
    let mut mill = milling("$925=1\n$926=1\n");
    pin(&mut mill, "estop 1");
    mill.run_for(Duration::from_millis(5));
    pin(&mut mill, "fault 1");
    mill.run_for(Duration::from_secs(2));
    let said = mill.take_output();
    assert!(said.contains("ALARM:101\r") && !said.contains("ALARM:102"), "{said}");
    assert!(!mill.controller().is_trusted(), "a driver may have lost steps: {said}");
    // The machine brakes because the spindle is too slow, and the spindle may stay on. A limit switch, which stops the
    // machine at once, must still act while the machine brakes.
    let mut mill = milling("$927=4\n");
    pin(&mut mill, "at_speed 0");
    mill.run_for(Duration::from_millis(55));
    pin(&mut mill, "limit y 1");
    mill.run_for(Duration::from_secs(2));
    let said = mill.take_output();
    assert!(said.contains("lost its speed") && said.contains("[MSG:Limit switch Y"), "{said}");
    assert!(said.contains("ALARM:1\r") && !said.contains("ALARM:14"), "{said}");
    assert!(!turns(&mill) && !mill.controller().is_trusted(), "{said}");
}

#[test]
fn a_switch_that_bounces_does_not_end_its_own_parking_move() {
    let mut mill = milling("$924=2\n");
    for level in ["limit y 1", "limit y 0", "limit y 1", "limit y 0"] {
        pin(&mut mill, level);
        mill.run_for(Duration::from_secs(1));
    }
    mill.run_for(Duration::from_secs(10));
    let said = mill.take_output();
    assert!(mill.controller().is_trusted() && said.contains("ALARM:1\r"), "{said}");
    assert!((position(&mill)[2] - PARKED_Z).abs() < 0.01, "{:?} {said}", position(&mill));
}

#[test]
fn a_spindle_that_stays_on_keeps_its_speed() {
    for reaction in [3, 4, 5] {
        let mut mill = homed();
        mill.send(format!("$924={reaction}\nM3 S300\nG91 G1 X-10 F1200 S300\nG1 X-10 S1000\n"));
        mill.run_for(Duration::from_millis(300));
        let power = mill.power();
        pin(&mut mill, "limit y 1");
        mill.run_for(Duration::from_secs(12));
        assert!(turns(&mill), "{}", mill.take_output());
        assert!(power != 0 && mill.power().abs_diff(power) <= 1, "{} instead of {power}", mill.power());
    }
}

/// After a reset, startup lines run although the host has left: they are not part of the job that the host was running.
#[test]
fn a_reset_on_the_way_back_from_a_door_forgets_that_the_host_has_gone() {
    let mut mill = homed();
    mill.send("$392=4\n$N0=G4P2\n");
    assert!(mill.run_until_idle());
    State::DoorParked.enter(&mut mill);
    mill.send("~");
    mill.run_for(Duration::from_secs(3));
    // The spindle is spinning up.
    assert!(status(&mut mill).contains("<Door:3|") && turns(&mill) && !mill.is_stepping());
    mill.disconnect();
    pin(&mut mill, "reset 1");
    mill.run_for(Duration::from_secs(1));
    pin(&mut mill, "reset 0");
    mill.run_for(Duration::from_secs(3));
    assert!(status(&mut mill).contains("<Idle|"), "{}", mill.take_output());
}

/// The drivers must be on while a door parks the tool of an idle machine. When the tool has returned, they are
/// switched off after the idle delay (`$1`).
#[test]
fn the_drivers_go_off_behind_a_door_that_parked_the_tool() {
    let mut mill = homed();
    mill.run_for(Duration::from_millis(100));
    let drivers = |mill: &Simulator| mill.outputs().is_some_and(|outputs| outputs.drivers);
    assert!(!drivers(&mill));
    mill.send([0x84]);
    mill.run_for(Duration::from_secs(10));
    assert!(drivers(&mill) && status(&mut mill).starts_with("<Door:0"));
    mill.send("~");
    mill.run_for(Duration::from_secs(10));
    assert!(!drivers(&mill), "{}", status(&mut mill));
    assert!(status(&mut mill).starts_with("<Idle"));
}
