//! A machine in the simulator and all that can happen to it: text, realtime commands, inputs, hosts that come and go, power
//! cuts while a setting is written, and time.
//!
//! Promises: it always answers `?` with a report; a reset ends every motion; the position is that of the pulses; after
//! the inputs are released and a reset it is told of its way back to idle.

use arbitrary::{Arbitrary, Unstructured};
use oxmill_simulator::{Fittings, Options, Simulator};
use std::time::Duration;

/// A machine with switches and a plate, quick enough that a session is short.
const MACHINE: &str = r#"
    steps_per_mm = [250, 250, 250]
    switch = [
        { axis = "x", at_mm = 2.0, side = "positive", bounce_us = 900 },
        { axis = "y", at_mm = 1.5, side = "positive", bounce_us = 300 },
        { axis = "z", at_mm = 1.0, side = "positive" },
    ]
    plate = { axis = "z", at_mm = -3.0, side = "negative", bounce_us = 200 }
"#;
const SETTINGS: &str = "$110=3000\n$111=3000\n$112=3000\n$120=300\n$121=300\n$122=300\n$130=12\n$131=12\n$132=12\n\
    $24=300\n$25=2000\n$26=20\n";

thread_local! {
    /// As it is after a start: a copy is cheaper than another start.
    static STARTED: Simulator = {
        let fittings = Fittings::parse(MACHINE).expect("a machine");
        let mut mill = Simulator::new(Options { keep_steps: true, fittings, ..Options::default() });
        mill.send(SETTINGS);
        mill.run_for(Duration::from_secs(2));
        mill.take_output();
        mill
    };
}

#[derive(Arbitrary)]
enum Action<'a> {
    Text(&'a str),
    Line(Line),
    Command(u8),
    Pin(u8, bool),
    Wait(u8),
    Hosts(bool),
}

/// Lines that chance does not find soon.
#[derive(Arbitrary)]
enum Line {
    Move { motion: u8, axes: [i16; 3], feed: u8 },
    Jog { axes: [i8; 3], feed: u8 },
    Setting { number: u16, value: i16 },
    Command(u8),
}

const MOTIONS: [&str; 10] = ["G0", "G1", "G91G1", "G90G1", "G2", "G3", "G53G0", "G38.3", "G81R1", "G28"];
const COMMANDS: [&str; 16] = [
    "$H", "$X", "$C", "$$", "$#", "$G", "$I", "$N", "$SLP", "$RST=#", "$N0=G20", "M0", "M6T1", "G4P.01", "M3S500",
    "M30",
];
const PINS: [&str; 10] = ["door", "hold", "start", "reset", "limit x", "limit y", "limit z", "probe", "estop", "fault"];

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
            // Resolution, rates and accelerations stay what a session has time for.
            Line::Setting { number, .. } if (100..=132).contains(number) => "\n".into(),
            Line::Setting { number, value } => format!("${}={value}\n", number % 930),
            Line::Command(which) => format!("{}\n", COMMANDS[usize::from(*which) % COMMANDS.len()]),
        }
    }
}

/// The target.
pub fn run(data: &[u8]) {
    let mut mill = STARTED.with(Clone::clone);
    let mut input = Unstructured::new(data);
    for _ in 0..64 {
        if input.is_empty() {
            break;
        }
        let Ok(action) = input.arbitrary() else { break };
        act(&mut mill, &action);
        status(&mut mill);
    }
    way_back(&mut mill);
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
    }
}

/// As a sender that counts characters: commands do not wait behind lines for which there is no room.
fn send(mill: &mut Simulator, bytes: &[u8]) {
    if mill.unread() + bytes.len() <= mill.board().received_bytes {
        mill.send(bytes);
    }
}

/// The report that answers a `?`.
fn status(mill: &mut Simulator) -> String {
    mill.take_output();
    mill.send("?");
    let text = mill.take_output();
    let report = text.lines().find(|line| line.starts_with('<') && line.ends_with('>'));
    report.unwrap_or_else(|| panic!("no report but {text:?}")).to_owned()
}

/// Inputs released, what may keep it still put back, and reset.
fn way_back(mill: &mut Simulator) {
    mill.connect();
    for pin in PINS {
        mill.pin_line(&format!("{pin} 0"));
    }
    for _ in 0..2 {
        mill.send([0x18]);
        mill.run_for(Duration::from_millis(200));
    }
    assert!(!mill.is_stepping(), "a reset ends every motion: {}", status(mill));
    mill.send(
        "\n$5=0\n$6=0\n$21=0\n$22=0\n$20=0\n$13=0\n$10=1\n$900=1\n$903=1\n$14=0\n$908=0\n$912=0\n$913=0\n$N0=\n$N1=\n",
    );
    mill.run_for(Duration::from_secs(1));
    mill.send([0x18]);
    mill.run_for(Duration::from_millis(200));
    mill.take_output();
    mill.send("$X\n");
    mill.run_for(Duration::from_millis(50));
    let said = mill.take_output();
    assert!(said.lines().any(|line| line == "ok"), "{said:?} {}", status(mill));
    let report = status(mill);
    assert!(report.starts_with("<Idle"), "{report}");
    let steps = mill.trace().kept().last().map_or([0; 3], |record| record.position);
    assert_eq!(steps, mill.machine().position(), "the position is that of the pulses");
}
