//! Fuzz target: a machine in the simulator with all kinds of events. These are text, realtime commands, inputs, hosts
//! that connect and disconnect, power cuts while a record is written, and time.
//!
//! Invariants:
//! - `?` is always answered with a report.
//! - A reset ends every motion.
//! - If a power cut interrupts a line, either everything that the line stores is stored, or nothing.
//! - At the end, inputs are released, settings restored and a reset sent. Then the machine is idle, and a jog makes
//!   exactly its steps and changes the reported position by them.

use super::board::shows;
use arbitrary::{Arbitrary, Unstructured};
use oxmill_controller::messages::{Record, STORE_DAMAGED};
use oxmill_simulator::{Fittings, Options, Simulator, Store};
use oxmill_test_support::numbers;
use std::time::Duration;

/// Description of a machine with limit switches and a probe plate. They are only a few mm away, so that sessions are
/// short. At 250 steps/mm a step is 0.004 mm, so a report with three decimals shows each step exactly.
pub const MACHINE: &str = r#"
    steps_per_mm = [250, 250, 250]
    switch = [
        { axis = "x", at_mm = 2.0, side = "positive", bounce_us = 900 },
        { axis = "y", at_mm = 1.5, side = "positive", bounce_us = 300 },
        { axis = "z", at_mm = 1.0, side = "positive" },
    ]
    plate = { axis = "z", at_mm = -3.0, side = "negative", bounce_us = 200 }
"#;
/// Settings that a machine gets after start-up, separated by spaces: rates, accelerations, travel and homing.
pub const SETTINGS: &str =
    "$110=3000 $111=3000 $112=3000 $120=300 $121=300 $122=300 $130=12 $131=12 $132=12 $24=300 $25=2000 $26=20";
/// Names of the inputs in the simulator's pin protocol.
pub const PINS: [&str; 10] =
    ["door", "hold", "start", "reset", "limit x", "limit y", "limit z", "probe", "estop", "fault"];

thread_local! {
    /// A simulator after start-up: copying it is cheaper than starting again.
    static STARTED: Simulator = {
        let mut mill = power_up(Store::in_memory());
        ask_all(&mut mill, SETTINGS.split(' '));
        mill
    };
}

fn power_up(store: Store) -> Simulator {
    let fittings = Fittings::parse(MACHINE).expect("a machine");
    Simulator::new(Options { keep_steps: true, store, fittings, ..Options::default() })
}

#[derive(Arbitrary, Debug)]
enum Action<'a> {
    Text(&'a str),
    Line(Line),
    Command(u8),
    Pin(u8, bool),
    Wait(u8),
    Hosts(bool),
    /// Sends a line. The power fails after `after` words have been written to the flash, and then returns.
    PowerCut {
        line: Line,
        after: u8,
        torn: u32,
    },
}

/// Lines that random bytes would hardly ever produce.
#[derive(Arbitrary, Debug)]
enum Line {
    Move { motion: u8, axes: [i16; 3], feed: u8 },
    Jog { axes: [i8; 3], feed: u8 },
    Setting { number: u16, value: i16 },
    Command(u8),
}

const MOTIONS: [&str; 10] = ["G0", "G1", "G91G1", "G90G1", "G2", "G3", "G53G0", "G38.3", "G81R1", "G28"];
const COMMANDS: [&str; 21] = [
    "$H",
    "$X",
    "$C",
    "$$",
    "$#",
    "$G",
    "$I",
    "$N",
    "$SLP",
    "$REBOOT",
    "$RST=#",
    "$N0=G20",
    "M0",
    "M6T1",
    "G4P.01",
    "M3S500",
    "M30",
    "$M0=O1SUB",
    "$M1=G0X.1",
    "$M2=O1ENDSUB",
    "O1CALL",
];

/// Lines that set what the machine monitors and how it reacts to faults. A [`Line::Command`] with the number
/// [`WATCHES_FROM`] or a higher one sends one of them.
const WATCHES: [&str; 16] = [
    "$914=0", "$915=1", "$916=.02", "$918=1", "$922=.02", "$922=.1", "$923=.02", "$923=.1", "$924=1", "$924=5",
    "$925=2", "$926=4", "$927=0", "$928=0", "$928=1", "$928=5",
];
const WATCHES_FROM: u8 = 240;

impl Line {
    fn text(&self) -> String {
        match self {
            Line::Move { motion, axes: [x, y, z], feed } => {
                let mm = |value: &i16| f64::from(*value) / 4000.0;
                let motion = MOTIONS[usize::from(*motion) % MOTIONS.len()];
                format!("{motion}X{:.4}Y{:.4}Z{:.4}F{}\n", mm(x), mm(y), mm(z), 60 + u32::from(*feed) * 12)
            }
            Line::Jog { axes: [x, y, z], feed } => {
                let mm = |value: &i8| f64::from(*value) / 50.0;
                format!("$J=G91X{:.2}Y{:.2}Z{:.2}F{}\n", mm(x), mm(y), mm(z), 60 + u32::from(*feed) * 12)
            }
            // Settings of resolution, rates, accelerations and travel are not changed, because motions could then last
            // very long. An empty line is sent instead.
            Line::Setting { number, .. } if (100..=132).contains(number) => "\n".into(),
            Line::Setting { number, value } => format!("${}={value}\n", number % 950),
            Line::Command(which @ WATCHES_FROM..) => format!("{}\n", WATCHES[usize::from(which - WATCHES_FROM)]),
            Line::Command(which) => format!("{}\n", COMMANDS[usize::from(*which) % COMMANDS.len()]),
        }
    }
}

/// Runs the target on one input; panics if an invariant is violated.
pub fn run(data: &[u8]) {
    let mut mill = STARTED.with(Clone::clone);
    let mut input = Unstructured::new(data);
    for _ in 0..64 {
        if input.is_empty() {
            break;
        }
        let Ok(action) = input.arbitrary() else { break };
        act(&mut mill, &action);
        let report = status(&mut mill);
        if shows() {
            println!("{action:?}\n    {report}");
        }
    }
    back_to_idle(&mut mill, "");
}

fn act(mill: &mut Simulator, action: &Action) {
    match action {
        Action::Text(text) => send(mill, text.as_bytes()),
        Action::Line(line) => send(mill, line.text().as_bytes()),
        Action::Command(byte) => {
            let byte = if *byte < 0x40 {
                [0x18, 0x19, b'!', b'~', 0x84, 0x85, b'?', b'!'][usize::from(byte % 8)]
            } else {
                byte | 0x80
            };
            mill.send([byte]);
        }
        Action::Pin(which, active) => {
            let pin = PINS[usize::from(*which) % PINS.len()];
            let answer = mill.pin_line(&format!("{pin} {}", u8::from(*active)));
            assert_eq!(answer, "ok", "{pin}");
        }
        Action::Wait(time) => mill.run_for(Duration::from_micros(u64::from(*time) * 500)),
        Action::Hosts(true) => mill.connect(),
        Action::Hosts(false) => mill.disconnect(),
        Action::PowerCut { line, after, torn } => cut_power(mill, &line.text(), u32::from(after % 32), *torn),
    }
}

/// Sends bytes only if the machine has room for them, as a sender that counts characters does. So no line has to wait
/// for room, and no realtime command has to wait behind a line.
fn send(mill: &mut Simulator, bytes: &[u8]) {
    if mill.unread() + bytes.len() <= mill.board().received_bytes {
        mill.send(bytes);
    }
}

/// Requests a status report and returns it.
fn status(mill: &mut Simulator) -> String {
    mill.take_output();
    mill.send("?");
    let text = mill.take_output();
    let report = text.lines().find(|line| line.starts_with('<') && line.ends_with('>'));
    report.unwrap_or_else(|| panic!("no report but {text:?}")).to_owned()
}

fn cut_power(mill: &mut Simulator, line: &str, after: u32, torn: u32) {
    let wait = Duration::from_millis(200);
    mill.run_for(wait);
    let old = records(mill);
    let mut whole = mill.clone();
    send(&mut whole, line.as_bytes());
    whole.run_for(wait);
    mill.store_mut().cut_power_after(after, torn);
    send(mill, line.as_bytes());
    mill.run_for(wait);
    let found = records(mill);
    let is_whole = found == old || found == records(&whole);
    assert!(is_whole, "{line:?} after {after}: {found:?} of {old:?} and {:?}", records(&whole));
    *mill = power_up(mill.store().power_cycled().expect("memory that is written"));
}

/// Returns the records that a power cycle would leave.
fn records(mill: &Simulator) -> Vec<Record> {
    let mut records = mill.store().power_cycled().expect("memory that is written").records();
    records.retain(|record| record.key != STORE_DAMAGED);
    records.sort_by_key(|record| record.key);
    records
}

/// Sends lines one by one; each must be carried out.
fn ask_all<'a>(mill: &mut Simulator, lines: impl IntoIterator<Item = &'a str>) {
    for line in lines {
        mill.take_output();
        mill.send(format!("{line}\n"));
        mill.run_for(Duration::from_millis(300));
        let said = mill.take_output();
        assert!(said.lines().any(|said| said == "ok"), "{line}: {said:?} {}", status(mill));
    }
}

fn reset(mill: &mut Simulator) {
    mill.send([0x18]);
    mill.run_for(Duration::from_millis(200));
}

/// Brings the machine back to idle after any events: releases inputs, restores settings, and resets. Then checks that
/// a jog makes its steps. `history` is printed on failure.
pub fn back_to_idle(mill: &mut Simulator, history: &str) {
    mill.connect();
    for pin in PINS {
        mill.pin_line(&format!("{pin} 0"));
    }
    reset(mill);
    reset(mill);
    assert!(!mill.is_stepping(), "a reset ends every motion: {} {history}", status(mill));
    // The empty line ends a line whose start was cut off by a reset. After a power cut the store can look damaged.
    // Then the controller accepts `$X` only some time after the settings have been listed.
    mill.take_output();
    mill.send("\n$X\n");
    mill.run_for(Duration::from_millis(100));
    if mill.take_output().contains("settings damaged") {
        ask_all(mill, ["$$"]);
        mill.run_for(Duration::from_secs(3));
        ask_all(mill, ["$X"]);
    }
    mill.send("$RST=*\n");
    mill.run_for(Duration::from_secs(1));
    reset(mill);
    ask_all(mill, ["$X"].into_iter().chain(SETTINGS.split(' ')));
    let report = status(mill);
    assert!(report.starts_with("<Idle"), "{report} {history}");
    let (steps, before) = (mill.machine().position(), reported(mill));
    ask_all(mill, ["$J=G91 G21 X-0.1 Y0.2 F1000"]);
    let (moved, after) = (mill.machine().position(), reported(mill));
    for (axis, change) in [-25, 50, 0].into_iter().enumerate() {
        assert_eq!(moved[axis] - steps[axis], change, "steps of axis {axis} {history}");
        assert!(
            (after[axis] - before[axis] - f64::from(change) / 250.0).abs() < 0.0015,
            "{before:?} {after:?} {history}"
        );
    }
}

/// Returns the reported machine position, mm.
fn reported(mill: &mut Simulator) -> [f64; 3] {
    let report = status(mill);
    numbers(&report, "MPos").unwrap_or_else(|| panic!("no MPos in {report}"))
}
