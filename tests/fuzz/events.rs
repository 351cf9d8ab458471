//! Fuzz target: all events that a controller can receive, in any order. These are bytes of lines, realtime commands,
//! inputs, contacts, stops, late segments, miscounted steps, replies of a store that works or fails, hosts that
//! connect and disconnect, and jumps in time. Most sources of events can be delayed.
//!
//! The first byte of the input chooses whether there are also false events. One example is a stop that nobody
//! requested, with any number and position. Another is a reply of the store when nothing was requested.
//!
//! Invariants, in addition to those of `board.rs`:
//! - `?` is answered by one report.
//! - At rest, the controller's position agrees with the steps of the motors.
//! - After miscounted steps, the controller does not trust its position.
//! - After a reset with restored settings, the machine is idle, and a jog makes exactly its steps.

use super::board::{AXES, Board, late, shows};
use super::session::SETTINGS;
use arbitrary::{Arbitrary, Unstructured};
use oxmill_controller::axes::PerAxis;
use oxmill_controller::messages::{Event, PinView, Realtime, Sensed, Signals, StepEvent, input};
use oxmill_controller::protocol::realtime;
use std::collections::BTreeMap;

/// Steps/mm of each axis after [`RESOLUTION`].
const STEPS_PER_MM: i64 = 250;
const RESOLUTION: &str = "$100=250 $101=250 $102=250 $21=1";

thread_local! {
    /// A board after start-up: copying it is cheaper than starting again.
    static STARTED: Board = {
        let mut board = Board::new(BTreeMap::new());
        for line in RESOLUTION.split(' ').chain(SETTINGS.split(' ')) {
            let said = board.ask(line);
            assert!(said.ends_with("ok\r\n"), "{line}: {said}");
        }
        board
    };
}

#[derive(Arbitrary, Debug)]
enum Action<'a> {
    Text(&'a str),
    Line(Line),
    Damage,
    Command(u8),
    Inputs(u16),
    Pass(u8),
    Stall(u8),
    Leap(u32),
    /// Sets the sources of events that are late from now on: those whose bits (see [`late`]) are set.
    Late(u8),
    Miscount(u8, i8),
    StoreFails(bool),
    HostGoes,
    HostComes,
    Lie(Lie),
}

/// False events that no step task, store or input task would send.
#[derive(Arbitrary, Debug)]
enum Lie {
    Stopped { stops: u16, moving: bool, position: [i32; AXES] },
    Underrun { stops: u16, position: [i32; AXES] },
    Miscounted { stops: u16, position: [i32; AXES] },
    Probed { position: [i32; AXES] },
    Stored(bool),
    Pins(u16, u16),
    Trips { levels: u16, trips: u8, tripped: u16 },
}

/// Lines that random bytes would hardly ever produce.
#[derive(Arbitrary, Debug)]
enum Line {
    Move { motion: u8, axes: [i8; AXES], feed: u8 },
    Setting { number: u8, value: u8 },
    Of(u8),
}

const MOTIONS: [&str; 12] =
    ["G0", "G1", "G91G1", "G90G1", "G2R2", "G3R-3", "$J=G91", "$J=G90", "G38.2", "G38.5", "G81R1", "G53G0"];
const LINES: [&str; 33] = [
    "$H",
    "$X",
    "$C",
    "$$",
    "$#",
    "$N",
    "$SLP",
    "$RST=#",
    "$RST=*",
    "$N0=G20",
    "$N1=",
    "$M0=O1SUB",
    "$M1=G91G0X.1",
    "$M2=O1ENDSUB",
    "O1CALL",
    "M0",
    "M6T1",
    "G4P.05",
    "M3S500",
    "M5",
    "M8",
    "M30",
    "G28",
    "G92X1",
    "G10L2P1X1",
    "$LC=ON",
    "$PINS",
    "$RC",
    "$REC",
    "O2REPEAT[3]",
    "G91G1X.05F900",
    "O2ENDREPEAT",
    "$I=A",
];
/// Settings that change behaviour, but not how long a session takes.
const NUMBERS: [u16; 24] =
    [0, 1, 3, 5, 10, 13, 15, 20, 21, 22, 23, 27, 30, 32, 40, 56, 58, 900, 901, 902, 924, 925, 926, 928];
/// Beginning of a line that sets the direction mask. Of [`NUMBERS`], only this setting changes how positions are
/// computed from the motors' step counts.
const RENAMING: &str = "$3=";
/// A [`Line::Setting`] with this number or a higher one changes one of [`WATCHES`].
const WATCHES_FROM: u8 = 240;
/// Settings of what the machine monitors, and of its reactions to faults. None of them changes how positions are
/// computed from the motors' step counts.
const WATCHES: [u16; 11] = [914, 915, 916, 918, 922, 923, 924, 926, 927, 928, 929];
/// Settings of [`WATCHES`] that are times in seconds. A [`Line::Setting`] sets them to multiples of 0.05 s.
const TIMES: [u16; 4] = [916, 922, 923, 929];

impl Line {
    fn text(&self) -> String {
        match self {
            Line::Move { motion, axes: [x, y, z], feed } => {
                let mm = |value: &i8| f64::from(*value) / 50.0;
                let motion = MOTIONS[usize::from(*motion) % MOTIONS.len()];
                format!("{motion}X{:.3}Y{:.3}Z{:.3}F{}\n", mm(x), mm(y), mm(z), 60 + u32::from(*feed) * 12)
            }
            Line::Setting { number: which @ WATCHES_FROM.., value } => {
                let number = WATCHES[usize::from(which - WATCHES_FROM) % WATCHES.len()];
                let unit = if TIMES.contains(&number) { 0.05 } else { 1.0 };
                format!("${number}={:.2}\n", f64::from(value % 12) * unit)
            }
            Line::Setting { number, value } => {
                format!("${}={}\n", NUMBERS[usize::from(*number) % NUMBERS.len()], value % 12)
            }
            Line::Of(which) => format!("{}\n", LINES[usize::from(*which) % LINES.len()]),
        }
    }
}

/// Runs the target on one input; panics if an invariant is violated.
pub fn run(data: &[u8]) {
    let Some((first, data)) = data.split_first() else { return };
    let mut board = STARTED.with(Clone::clone);
    board.is_true = first & 1 == 0;
    let mut account = Account::default();
    let mut input = Unstructured::new(data);
    for _ in 0..96 {
        if input.is_empty() {
            break;
        }
        let Ok(action) = input.arbitrary() else { break };
        let shown = shows().then(|| format!("{action:?}"));
        if let Some(shown) = &shown {
            println!("{shown}");
        }
        account.before(&action);
        act(&mut board, action);
        board.look();
        if shown.is_some() {
            let said = board.take_said();
            println!("    {:?} {said:?}", board.motors);
        }
        account.check(&board);
    }
    if board.has_time() {
        back_to_idle(board);
    }
}

fn act(board: &mut Board, action: Action) {
    match action {
        Action::Text(text) => board.send(text.as_bytes()),
        Action::Line(line) => board.send(line.text().as_bytes()),
        Action::Damage => board.damage(),
        Action::Command(byte) => {
            let byte = match byte {
                0..64 => [0x18, 0x19, b'!', b'~', 0x84, 0x85, b'~', b'!'][usize::from(byte % 8)],
                byte => byte | 0x80,
            };
            if let Some(command) = realtime::command(byte) {
                board.command(command);
            }
        }
        Action::Inputs(word) => board.inputs(word.into()),
        Action::Pass(time) => board.pass(u64::from(time) * 500, false),
        Action::Stall(time) => board.pass(u64::from(time) * 200, true),
        Action::Leap(time) => board.leap(u64::from(time) << (time & 15)),
        Action::Late(sources) => board.late = sources & late::ALL,
        Action::Miscount(axis, steps) => board.miscount(axis.into(), steps.into()),
        Action::StoreFails(fails) => board.store_fails = fails,
        Action::HostGoes => board.host_goes(),
        Action::HostComes => board.hosts.push_back(Event::Connected),
        Action::Lie(lie) if !board.is_true => tell(board, &lie),
        Action::Lie(_) => {}
    }
}

fn tell(board: &mut Board, lie: &Lie) {
    let place = |[x, y, z]: [i32; AXES]| PerAxis([x, y, z]);
    match *lie {
        Lie::Stopped { stops, moving, position } => {
            board.reports.push_back(StepEvent::Stopped { stops, moving, position: place(position) });
        }
        Lie::Underrun { stops, position } => {
            board.reports.push_back(StepEvent::Underrun { stops, position: place(position) });
        }
        Lie::Miscounted { stops, position } => {
            board.reports.push_back(StepEvent::Miscounted { stops, position: place(position) });
        }
        Lie::Probed { position } => board.reports.push_back(StepEvent::Probed { position: place(position) }),
        Lie::Stored(done) => board.answers.push_back(if done { Event::Stored } else { Event::StoreFailed }),
        Lie::Pins(fitted, low) => board.hosts.push_back(Event::Pins(PinView {
            fitted: fitted.into(),
            low: low.into(),
            noise: [low; input::COUNT],
        })),
        Lie::Trips { levels, trips, tripped } => {
            board.pretend_inputs(Sensed { signals: Signals::of_word(levels.into()), trips, tripped: tripped.into() });
        }
    }
}

/// Compares the controller's position with the steps of the motors. The difference of the two (`apart`, in 0.01
/// steps) must be the same whenever the machine is idle, until an action redefines the position.
#[derive(Default)]
struct Account {
    apart: Option<[i64; AXES]>,
    unchecked: bool,
}

impl Account {
    fn before(&mut self, action: &Action) {
        let renames = match action {
            Action::Text(text) => text.contains('$'),
            Action::Line(line @ Line::Setting { .. }) => line.text().starts_with(RENAMING),
            Action::Line(line) => matches!(line.text().as_str(), "$H\n" | "$RST=*\n"),
            Action::Lie(_) => true,
            _ => false,
        };
        if renames {
            // From now on the position is not checked, because the action can change the position, the step length or
            // the backlash.
            self.unchecked = true;
        }
    }

    fn check(&mut self, board: &Board) {
        if !board.controller.is_idle() || !board.is_true || self.unchecked || board.late != 0 {
            return;
        }
        if !board.controller.is_trusted() {
            self.apart = None;
            return;
        }
        let places = board.controller.machine_position();
        let mut apart = [0; AXES];
        for (apart, (place, motor)) in apart.iter_mut().zip(places.iter().zip(board.motors)) {
            // In 0.01 steps; `place.0` is in 0.1 nm.
            *apart = place.0 * STEPS_PER_MM / 100_000 - 100 * i64::from(motor);
        }
        let known = *self.apart.get_or_insert(apart);
        for (now, before) in apart.iter().zip(known) {
            assert!(now.abs_diff(before) <= 100, "the position has left the motors: {known:?} {apart:?}");
        }
    }
}

/// Ends a session: delivers late events, releases inputs, restores settings, and checks that a jog makes its steps.
/// After false events, nothing is checked.
fn back_to_idle(mut board: Board) {
    board.late = 0;
    board.store_fails = false;
    if !board.is_true {
        return;
    }
    board.inputs(0);
    // A reset runs the startup lines. One of them can start a long motion, at once or after a dwell. So a second reset
    // follows: a reset during motion locks the machine, and then the startup lines do not run.
    let is_restored = (0..4).any(|_| {
        for time in [20_000, 200_000] {
            board.command(Realtime::Reset);
            board.pass(time, false);
        }
        // The empty line ends an unfinished line.
        board.ask("");
        board.ask("$RST=*").lines().any(|said| said == "ok")
    });
    assert!(is_restored || !board.has_time(), "settings cannot be restored");
    board.command(Realtime::Reset);
    board.pass(200_000, false);
    board.ask("$X");
    for line in RESOLUTION.split(' ').chain(SETTINGS.split(' ')).filter(|line| *line != "$21=1") {
        let said = board.ask(line);
        assert!(said.ends_with("ok\r\n"), "{line}: {said}");
    }
    let before = board.motors;
    let said = board.ask("$J=G91G21X-0.1Y0.2F1000");
    if !board.has_time() {
        return;
    }
    assert_eq!(said, "ok\r\n");
    for (axis, change) in [-25, 50, 0].into_iter().enumerate() {
        assert_eq!(board.motors[axis] - before[axis], change, "steps of axis {axis}");
    }
}
