//! Actions of a host and an operator in a random conversation, and their text in the format of recorded conversations.

use proptest::prelude::*;

/// A line of a host. There is one variant for each kind of line that the protocol answers differently.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Line {
    Empty,
    /// Longer than Grbl's maximum of 79 characters. In Oxmill's dialect, which allows longer lines, the line is
    /// rejected because it repeats a word.
    TooLong,
    /// A straight move in absolute coordinates: axis and target in mm. `true`: at [`FEED`], else a rapid.
    Move(usize, i8, bool),
    /// A move to a position that soft limits forbid.
    Outside,
    /// Unknown or malformed G-code words, and their error number.
    Wrong(&'static str, u8),
    Dwell,
    Pause,
    ProgramEnd,
    Spindle(bool),
    Flood(bool),
    /// T alone: selects a tool for the next M6.
    Select(u8),
    /// Loads the selected tool into the spindle.
    Change,
    /// Selects a tool and loads it into the spindle. `true`: also turns the spindle on.
    Tool(u8, bool),
    /// A jog of an axis by a distance in mm.
    Jog(usize, i8),
    /// A jog to a position that soft limits forbid; without soft limits it is just a long jog.
    JogOutside,
    /// A jog with an invalid text, and its error number.
    WrongJog(&'static str, u8),
    Help,
    Listing,
    Parameters,
    ParserState,
    BuildInfo,
    StartupLines,
    ClearStartup,
    Setting,
    WrongSetting,
    Unlock,
    Home,
    Check,
    Sleep,
    Restore,
}

/// Feed of moves and jogs, mm/min.
pub const FEED: f64 = 600.0;
/// Time of the dwell, s.
pub const DWELL: f64 = 0.5;
/// Target of [`Line::Outside`], mm.
pub const OUTSIDE: f64 = 5.0;
/// Target of [`Line::JogOutside`], mm.
pub const JOG_OUTSIDE: f64 = 25.0;
/// Spindle speed of the lines that turn it on, rpm.
pub const SPINDLE: f64 = 500.0;
const LETTERS: [char; 3] = ['X', 'Y', 'Z'];

impl Line {
    pub fn text(self) -> String {
        match self {
            Line::Move(axis, to, true) => format!("G90 G1 {}{to} F{FEED}", LETTERS[axis]),
            Line::Move(axis, to, false) => format!("G90 G0 {}{to}", LETTERS[axis]),
            Line::Outside => format!("G90 G1 X{OUTSIDE} F{FEED}"),
            Line::Jog(axis, by) => format!("$J=G91 {}{by} F{FEED}", LETTERS[axis]),
            Line::JogOutside => format!("$J=G91 X{JOG_OUTSIDE} F{FEED}"),
            Line::Wrong(text, _) | Line::WrongJog(text, _) => text.into(),
            Line::TooLong => format!("G1{}", "X1".repeat(42)),
            Line::Dwell => format!("G4 P{DWELL}"),
            Line::Spindle(true) => format!("M3 S{SPINDLE}"),
            Line::Select(tool) => format!("T{tool}"),
            Line::Tool(tool, false) => format!("T{tool} M6"),
            Line::Tool(tool, true) => format!("T{tool} M6 M3 S{SPINDLE}"),
            Line::Change => "M6".into(),
            Line::Empty => String::new(),
            Line::Pause => "M0".into(),
            Line::ProgramEnd => "M2".into(),
            Line::Spindle(false) => "M5".into(),
            Line::Flood(true) => "M8".into(),
            Line::Flood(false) => "M9".into(),
            Line::Help => "$".into(),
            Line::Listing => "$$".into(),
            Line::Parameters => "$#".into(),
            Line::ParserState => "$G".into(),
            Line::BuildInfo => "$I".into(),
            Line::StartupLines => "$N".into(),
            Line::ClearStartup => "$N0=".into(),
            Line::Setting => "$1=25".into(),
            Line::WrongSetting => "$1=5x".into(),
            Line::Unlock => "$X".into(),
            Line::Home => "$H".into(),
            Line::Check => "$C".into(),
            Line::Sleep => "$SLP".into(),
            Line::Restore => "$RST=#".into(),
        }
    }
}

/// An input pin. [`PINS`] lists all of them with their names.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Pin {
    Limit(usize),
    Door,
    Reset,
    Hold,
    Start,
    EmergencyStop,
    DriverFault,
}

/// All inputs in the order in which a report names them: the letter in the report, and the name in the simulator's pin
/// protocol.
pub const PINS: [(Pin, char, &str); 9] = [
    (Pin::Limit(0), 'X', "limit x"),
    (Pin::Limit(1), 'Y', "limit y"),
    (Pin::Limit(2), 'Z', "limit z"),
    (Pin::Door, 'D', "door"),
    (Pin::Reset, 'R', "reset"),
    (Pin::Hold, 'H', "hold"),
    (Pin::Start, 'S', "start"),
    (Pin::EmergencyStop, 'E', "estop"),
    (Pin::DriverFault, 'F', "fault"),
];

impl Pin {
    /// Returns the index in [`PINS`].
    pub fn index(self) -> usize {
        PINS.iter().position(|(pin, ..)| *pin == self).expect("all pins are listed")
    }
}

#[derive(Clone, Debug, PartialEq)]
pub enum Action {
    Line(Line),
    /// A realtime command.
    Byte(u8),
    Pin(Pin, bool),
    /// Lets this much virtual time pass, s.
    Pass(f64),
    /// The host disconnects, and another connects after this time, s.
    Absent(f64),
    /// The spindle is below its speed for this time, s.
    SlowSpindle(f64),
}

pub const RESET: u8 = 0x18;
pub const STOP: u8 = 0x19;
pub const HOLD: u8 = b'!';
pub const START: u8 = b'~';
pub const DOOR: u8 = 0x84;
pub const JOG_CANCEL: u8 = 0x85;
pub const SINGLE_BLOCK: u8 = 0x89;
pub const FEED_100: u8 = 0x90;
pub const FEED_UP: u8 = 0x91;
pub const FEED_DOWN: u8 = 0x92;
pub const FEED_UP_FINE: u8 = 0x93;
pub const FEED_DOWN_FINE: u8 = 0x94;
pub const RAPID_100: u8 = 0x95;
pub const RAPID_50: u8 = 0x96;
pub const RAPID_25: u8 = 0x97;
pub const SPINDLE_100: u8 = 0x99;
pub const SPINDLE_UP: u8 = 0x9A;
pub const SPINDLE_DOWN: u8 = 0x9B;
pub const SPINDLE_UP_FINE: u8 = 0x9C;
pub const SPINDLE_DOWN_FINE: u8 = 0x9D;
pub const SPINDLE_STOP: u8 = 0x9E;
pub const FLOOD_TOGGLE: u8 = 0xA0;

impl Action {
    /// Returns the action as a line of `tests/conversations/`.
    pub fn text(&self) -> String {
        match self {
            Action::Line(line) => format!("-> {}", line.text()),
            Action::Byte(byte) if byte.is_ascii_graphic() => format!("=> {}", char::from(*byte)),
            Action::Byte(byte) => format!("=> \\x{byte:02x}"),
            Action::Pin(pin, on) => format!("pin {} {}", PINS[pin.index()].2, u8::from(*on)),
            Action::Pass(seconds) => format!(".. {seconds}"),
            Action::Absent(seconds) => format!("host goes\n.. {seconds}\nhost comes"),
            Action::SlowSpindle(seconds) => format!("pin at_speed 0\n.. {seconds}\npin at_speed 1"),
        }
    }
}

/// Settings of a machine. Conversations differ in these settings only.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Setup {
    /// `$900=0`, Grbl's dialect.
    pub grbl: bool,
    /// `$21`.
    pub hard_limits: bool,
    /// `$22`.
    pub homing: bool,
    /// `$20`, which needs `homing`. Because of `$902=0`, soft limits act even before the machine is homed.
    pub soft_limits: bool,
    /// `$918=1`.
    pub tool_changes: bool,
    /// `$922` and `$923`: the host timeouts during a job and during a jog.
    pub watch: bool,
    /// `$915`: the spindle has an at-speed signal.
    pub at_speed: bool,
    /// The reaction to each fault (`$924` to `$928`), 0 to 5; `None`: the defaults.
    pub reactions: Option<u8>,
}

/// Number of the alarm for a silent or disconnected host. In some states neither is a fault.
pub const HOST: u8 = 3;
/// Alarm for a spindle that has lost its speed.
pub const SLOW: u8 = 14;

impl Setup {
    pub fn settings(self) -> Vec<String> {
        let mut lines: Vec<String> = Vec::new();
        for axis in 0..3 {
            lines.push(format!("$11{axis}={RATE}"));
            lines.push(format!("$12{axis}={ACCELERATION}"));
            lines.push(format!("$13{axis}={TRAVEL}"));
        }
        lines.extend(["$24=600", "$25=2000", "$26=50"].map(str::to_string));
        lines.push("$902=0".into());
        let switches = [
            (self.homing, "$22=1"),
            (self.soft_limits, "$20=1"),
            (self.hard_limits, "$21=1"),
            (self.tool_changes, "$918=1"),
            (self.grbl, "$900=0"),
        ];
        if self.watch {
            lines.push(format!("$922={JOB_SILENCE}"));
            lines.push(format!("$923={JOG_SILENCE}"));
        }
        if self.at_speed {
            lines.push(format!("$916={SPIN_UP}"));
            lines.push(format!("$929={SLOW_FOR}"));
            lines.push("$915=1".into());
        }
        if self.reactions.is_some() {
            let numbers = [(924, 1), (925, 101), (926, 102), (927, SLOW), (928, HOST)];
            lines.extend(numbers.map(|(number, alarm)| format!("${number}={}", self.reaction(alarm))));
        }
        lines.extend(switches.iter().filter(|(on, _)| *on).map(|(_, line)| (*line).to_string()));
        lines
    }
}

impl Setup {
    /// Returns the reaction (as in `$924` to `$928`) to the fault of this alarm.
    pub fn reaction(self, alarm: u8) -> u8 {
        match (self.reactions, alarm) {
            (Some(reaction), 101) => reaction % 3,
            (Some(reaction), _) => reaction,
            (None, HOST) => 4,
            (None, SLOW) => 1,
            (None, _) => 0,
        }
    }
}

/// Host timeout during a job, s. The times of actions, dwells and delays never add up to this value. So the timeout
/// never expires together with one of them.
pub const JOB_SILENCE: f64 = 1.13;
/// Host timeout during a jog, s. Like [`JOB_SILENCE`], it never expires together with an action, dwell or delay.
pub const JOG_SILENCE: f64 = 0.31;
/// Time for which the spindle may be below its speed before this counts as a fault (`$929`), s.
pub const SLOW_FOR: f64 = 0.17;
/// Time that a spindle has to reach a new speed, s.
pub const SPIN_UP: f64 = 0.27;
/// Rate of all axes, mm/min.
pub const RATE: f64 = 6000.0;
/// Acceleration of all axes, mm/s².
pub const ACCELERATION: f64 = 500.0;
/// Travel of all axes, mm.
pub const TRAVEL: f64 = 20.0;

fn line() -> impl Strategy<Value = Line> {
    prop_oneof![
        8 => (0..3_usize, prop::sample::select(vec![0_i8, -2, -4, -15]), any::<bool>())
            .prop_map(|(axis, to, feed)| Line::Move(axis, to, feed)),
        4 => (0..3_usize, prop::sample::select(vec![-3_i8, -1, 1])).prop_map(|(axis, by)| Line::Jog(axis, by)),
        1 => Just(Line::Outside),
        1 => Just(Line::JogOutside),
        1 => prop::sample::select(vec![Line::Wrong("G999", 20), Line::Wrong("G1 X", 2), Line::Wrong("=1", 1),
            Line::Wrong("M3.5", 23), Line::Wrong("G1 G0", 24)]),
        1 => prop::sample::select(vec![Line::WrongJog("$J=X1", 22), Line::WrongJog("$J=G0 X1 F100", 16),
            Line::WrongJog("$J=X1 F100 S5", 36)]),
        2 => Just(Line::Dwell),
        2 => Just(Line::Pause),
        1 => Just(Line::ProgramEnd),
        2 => any::<bool>().prop_map(Line::Spindle),
        2 => any::<bool>().prop_map(Line::Flood),
        2 => (1..3_u8, any::<bool>()).prop_map(|(tool, spindle)| Line::Tool(tool, spindle)),
        1 => prop_oneof![Just(Line::Change), (0..3_u8).prop_map(Line::Select)],
        4 => Just(Line::Unlock),
        3 => Just(Line::Home),
        2 => Just(Line::Check),
        1 => Just(Line::Sleep),
        4 => prop::sample::select(vec![Line::Empty, Line::TooLong, Line::Help, Line::Listing, Line::Parameters,
            Line::ParserState, Line::BuildInfo, Line::StartupLines, Line::ClearStartup, Line::Setting,
            Line::WrongSetting, Line::Restore]),
    ]
}

fn one() -> impl Strategy<Value = Action> {
    let bytes = vec![
        FEED_100,
        FEED_UP,
        FEED_DOWN,
        FEED_UP_FINE,
        FEED_DOWN_FINE,
        RAPID_100,
        RAPID_50,
        RAPID_25,
        SPINDLE_100,
        SPINDLE_UP,
        SPINDLE_DOWN,
        SPINDLE_UP_FINE,
        SPINDLE_DOWN_FINE,
        FLOOD_TOGGLE,
        FLOOD_TOGGLE,
        SPINDLE_STOP,
        SPINDLE_STOP,
        JOG_CANCEL,
        JOG_CANCEL,
        STOP,
        SINGLE_BLOCK,
        SINGLE_BLOCK,
    ];
    let pins = PINS.map(|(pin, ..)| pin).to_vec();
    prop_oneof![
        12 => line().prop_map(Action::Line),
        3 => prop::sample::select(bytes).prop_map(Action::Byte),
        6 => prop::sample::select(vec![HOLD, START, START, DOOR, RESET]).prop_map(Action::Byte),
        4 => (prop::sample::select(pins), any::<bool>()).prop_map(|(pin, on)| Action::Pin(pin, on)),
        2 => any::<bool>().prop_map(|on| Action::Pin(Pin::Door, on)),
        8 => prop::sample::select(PASSES.to_vec()).prop_map(Action::Pass),
        2 => prop::sample::select(PASSES.to_vec()).prop_map(Action::Absent),
        1 => prop::sample::select(PASSES.to_vec()).prop_map(Action::SlowSpindle),
    ]
}

/// Durations of [`Action::Pass`], s. A few of them never add up to the duration of a dwell or a delay. So nothing ends
/// exactly at a report.
const PASSES: [f64; 6] = [0.0023, 0.0317, 0.2129, 0.6151, 2.0377, 7.1213];

/// Returns a homing cycle in which the test operates the switches. Each switch is touched twice: first Z, then X and
/// Y together.
fn homed_by_hand() -> Vec<Action> {
    let mut actions = vec![Action::Line(Line::Home), Action::Pass(0.2011)];
    for limits in [[2].as_slice(), &[2], &[0, 1], &[0, 1]] {
        actions.extend(limits.iter().map(|axis| Action::Pin(Pin::Limit(*axis), true)));
        actions.push(Action::Pass(0.0203));
        actions.extend(limits.iter().map(|axis| Action::Pin(Pin::Limit(*axis), false)));
        actions.push(Action::Pass(0.3517));
    }
    actions
}

/// Generates these actions in this order. Each action is left out with a probability of 1.5 %.
fn sequence(actions: Vec<Action>) -> impl Strategy<Value = Vec<Action>> {
    prop::collection::vec(prop::bool::weighted(0.985), actions.len()).prop_map(move |kept| {
        actions.iter().zip(kept).filter(|(_, kept)| *kept).map(|(action, _)| action.clone()).collect()
    })
}

/// Generates a first line (a jog, a move or a dwell) and then a command that ends jogs. Another jog may be sent
/// before the command, after it, or both.
fn ended_jog() -> impl Strategy<Value = Vec<Action>> {
    let first = prop::sample::select(vec![Line::JogOutside, Line::Jog(1, -3), Line::Dwell, Line::Move(2, -15, true)]);
    let ends = prop::sample::select(vec![HOLD, JOG_CANCEL, JOG_CANCEL, DOOR, STOP, RESET]);
    (first, any::<[bool; 3]>(), ends).prop_map(|(first, [waits, passes, follows], end)| {
        let jog = || Action::Line(Line::Jog(0, -1));
        let mut actions = vec![Action::Line(first)];
        actions.extend(waits.then(jog));
        actions.extend(passes.then_some(Action::Pass(PASSES[2])));
        actions.push(Action::Byte(end));
        actions.extend(follows.then(jog));
        actions.push(Action::Pass(PASSES[3]));
        actions
    })
}

/// Generates a job that is resumed after a door closes, and events while it is being resumed.
fn resumed_job() -> impl Strategy<Value = Vec<Action>> {
    let outputs = prop::sample::select(vec![Line::Spindle(true), Line::Flood(true)]);
    let passes = || prop::sample::select(PASSES[1..].to_vec());
    let meanwhile = prop_oneof![
        2 => passes().prop_map(Action::Absent),
        1 => prop::sample::select(vec![HOLD, START, DOOR, STOP, RESET]).prop_map(Action::Byte),
        1 => Just(Action::Pin(Pin::Door, true)),
    ];
    (outputs, passes(), meanwhile).prop_map(|(output, pass, meanwhile)| {
        let mut actions = vec![Action::Line(output), Action::Line(Line::Move(2, -15, true)), Action::Pass(PASSES[2])];
        actions.extend([
            Action::Byte(DOOR),
            Action::Pass(PASSES[3]),
            Action::Byte(START),
            Action::Pass(pass),
            meanwhile,
        ]);
        actions
    })
}

/// Generates a job, a fault while it runs, and another event while the machine brakes. Before the fault the job may
/// be in a hold, at a door or stopped, or the operator may have stopped the spindle.
fn job_with_a_fault() -> impl Strategy<Value = Vec<Action>> {
    let before = prop::sample::select(vec![
        vec![],
        vec![DOOR],
        vec![HOLD],
        vec![HOLD, SPINDLE_STOP],
        vec![HOLD, SPINDLE_STOP, START],
        vec![STOP],
    ]);
    let pin = || prop::sample::select(PINS.map(|(pin, ..)| pin).to_vec()).prop_map(|pin| Action::Pin(pin, true));
    let inputs = vec![Pin::Limit(0), Pin::Limit(1), Pin::EmergencyStop, Pin::DriverFault];
    let stop = prop_oneof![
        4 => prop::sample::select(inputs).prop_map(|pin| Action::Pin(pin, true)),
        1 => prop::sample::select(vec![0.1601, 0.1799]).prop_map(Action::SlowSpindle),
    ];
    let meanwhile = prop_oneof![
        3 => pin(),
        2 => prop::sample::select(vec![HOLD, START, DOOR, STOP, RESET, JOG_CANCEL]).prop_map(Action::Byte),
        1 => Just(Action::Absent(PASSES[1])),
        1 => prop::sample::select(PASSES[1..4].to_vec()).prop_map(Action::SlowSpindle),
        1 => Just(Action::Pass(PASSES[3])),
    ];
    let moves = prop::sample::select(vec![Line::Move(2, -15, true), Line::Move(0, -15, false), Line::Jog(1, -3)]);
    (moves, before, stop, meanwhile, any::<[bool; 2]>()).prop_map(|(line, before, stop, meanwhile, [rests, later])| {
        let mut actions = vec![Action::Line(Line::Spindle(true)), Action::Line(line), Action::Pass(PASSES[2])];
        for byte in before {
            actions.push(Action::Byte(byte));
            actions.extend(rests.then_some(Action::Pass(PASSES[2])));
        }
        actions.push(stop);
        actions.extend(later.then_some(Action::Pass(PASSES[0])));
        actions.extend([meanwhile, Action::Pass(PASSES[3])]);
        actions
    })
}

/// Generates a job whose spindle loses its speed twice. An event or a pause precedes each loss. After some of these
/// events the controller gives the spindle time to reach its speed.
fn job_with_a_slow_spindle() -> impl Strategy<Value = Vec<Action>> {
    let slow =
        || prop::sample::select(vec![0.0317, 0.1601, 0.1799, 0.2601, 0.2901, 2.0377]).prop_map(Action::SlowSpindle);
    let between = || {
        prop_oneof![
            2 => prop::sample::select(vec![SPINDLE_UP, SPINDLE_DOWN, FEED_UP, HOLD]).prop_map(Action::Byte),
            1 => prop::sample::select(PASSES[..4].to_vec()).prop_map(Action::Pass),
        ]
    };
    (between(), slow(), between(), slow()).prop_map(|(before, first, between, second)| {
        let mut actions = vec![Action::Line(Line::Spindle(true)), Action::Pass(PASSES[3])];
        actions.extend([Action::Line(Line::Move(2, -15, true)), before, first, between, second]);
        actions.push(Action::Pass(PASSES[2]));
        actions
    })
}

/// Generates actions that select tools, load them or not, and query the tool by `$G`.
fn tools() -> impl Strategy<Value = Vec<Action>> {
    let tool = || {
        prop_oneof![
            (0..3_u8).prop_map(Line::Select),
            (1..3_u8, any::<bool>()).prop_map(|(tool, spindle)| Line::Tool(tool, spindle)),
            Just(Line::Change),
        ]
    };
    let ends = prop_oneof![
        3 => prop::sample::select(vec![START, START, RESET, STOP, DOOR]).prop_map(Action::Byte),
        1 => any::<bool>().prop_map(|on| Action::Line(Line::Spindle(on))),
    ];
    (tool(), ends, tool()).prop_map(|(first, end, second)| {
        let told = Action::Line(Line::ParserState);
        vec![Action::Line(first), end, told.clone(), Action::Line(second), Action::Byte(START), told]
    })
}

fn some() -> impl Strategy<Value = Vec<Action>> {
    prop_oneof![
        40 => one().prop_map(|action| vec![action]),
        2 => sequence(vec![Action::Byte(RESET), Action::Line(Line::Unlock)]),
        1 => sequence(homed_by_hand()),
        3 => ended_jog().prop_flat_map(sequence),
        1 => resumed_job().prop_flat_map(sequence),
        1 => job_with_a_fault().prop_flat_map(sequence),
        1 => tools().prop_flat_map(sequence),
        1 => job_with_a_slow_spindle().prop_flat_map(sequence),
        // A homing cycle by hand that is not completed.
        1 => (0..18_usize).prop_map(|count| homed_by_hand().into_iter().take(count).collect()),
    ]
}

/// Generates a conversation: the setup of a machine and the actions.
pub fn conversation() -> impl Strategy<Value = (Setup, Vec<Action>)> {
    let reactions = prop_oneof![3 => Just(None), 4 => (0..6_u8).prop_map(Some)];
    let setup = (any::<[bool; 7]>(), reactions).prop_map(|(switches, reactions)| {
        let [grbl, hard_limits, homing, soft_limits, tool_changes, watch, at_speed] = switches;
        Setup {
            grbl,
            hard_limits,
            homing,
            soft_limits: soft_limits && homing,
            tool_changes,
            watch,
            at_speed,
            reactions,
        }
    });
    let actions = prop::collection::vec(some(), 1..30).prop_map(|parts| parts.concat());
    (setup, actions)
}
