//! Exhaustive search of the state machine: from power-up every event is tried in every state reached, and each
//! transition must be listed in [`TRANSITIONS`]. Every state has a way back to Idle, and every event is answered.
//!
//! States have the names of the status report, plus `Critical` for an Alarm that only a reset ends. A state can occur
//! in several situations, for example with and without motion; the search tells situations apart by their [`Key`]. All
//! situations of a state share a column of the table.

use super::bench::Bench;
use oxmill_controller::messages::SpindleDirection;
use std::collections::{BTreeMap, BTreeSet, HashMap, VecDeque};

/// Immediate effect of each event (row) in each state (column). `.` means unchanged; `/` separates alternatives that
/// depend on whether the machine moves, whether it parks, or whether a pin is active. `-` means impossible, for example
/// that a door opens while it is open.
///
/// The table is Grbl's, with four additions: 0x19 brakes and drops the job; a limit switch ends every state except Home
/// and alarms; an emergency stop and a driver fault end every state; `?` is always answered. Lines sent during a hold
/// wait, so they have no immediate effect.
const TRANSITIONS: &str = "
event        Idle            Run       Jog       Hold:0         Hold:1       Door:0      Door:1     Door:2      Door:3         Home        Alarm   Critical  Check       Sleep
?            .               .         .         .              .            .           .          .           .              .           .       .         .           .
!            Hold:0          Hold:1    .         .              .            .           .          .           .              .           .       .         .           .
hold_1       Hold:0          Hold:1    .         .              .            .           .          .           .              .           .       .         .           .
hold_0       .               .         .         .              .            .           .          .           .              .           .       .         .           .
~            .               .         .         Idle/Run       .            DoorGoesOn  .          .           .              .           .       .         .           .
start_1      .               .         .         Idle/Run       .            DoorGoesOn  .          .           .              .           .       .         .           .
start_0      .               .         .         .              .            .           .          .           .              .           .       .         .           .
0x84         Door:0/Door:2   Door:2    Door:2    Door:0/Door:2  Door:2       .           .          .           Door:0/Door:2  Alarm       .       .         .           .
door_1       Door:1/Door:2   Door:2    Door:2    Door:1/Door:2  Door:2       Door:1      -          .           Door:1/Door:2  Alarm       .       .         .           .
door_0       -               -         -         -              -            -           Door:0     .           -              -           .       .         .           .
0x85         .               .         .         .              .            .           .          .           .              .           .       .         .           .
0x19         .               Hold:1    Hold:1    Idle           .            .           .          .           .              Alarm       .       .         .           .
0x18         Reset           Reset     Reset     Reset          Reset        Reset       ResetDoor  ResetDoor   Reset          Alarm       .       Alarm     ResetDoor   Alarm
reset_1      Reset           Reset     Reset     Reset          Reset        Reset       ResetDoor  ResetDoor   Reset          Alarm       .       Alarm     ResetDoor   Alarm
reset_0      .               .         .         .              .            .           .          .           .              .           .       .         .           .
limit_1      Critical        Critical  Critical  Critical       Critical     Critical    Critical   Critical    Critical       .           .       .         Critical    Critical
limit_0      .               .         .         .              .            .           .          .           .              .           .       .         .           .
estop_1      Critical        Critical  Critical  Critical       Critical     Critical    Critical   Critical    Critical       Critical    Critical .      Critical    Critical
estop_0      -               -         -         -              -            -           -          -           -              -           .       .         -           .
fault_1      Critical        Critical  Critical  Critical       Critical     Critical    Critical   Critical    Critical       Critical    Critical .      Critical    Critical
fault_0      -               -         -         -              -            -           -          -           -              -           .       .         -           .
probe_1      .               .         .         .              .            .           .          .           .              .           .       .         .           .
probe_0      .               .         .         .              .            .           .          .           .              .           .       .         .           .
override     .               .         .         .              .            .           .          .           .              .           .       .         .           .
no_command   .               .         .         .              .            .           .          .           .              .           .       .         .           .
move         Run/.           .         .         .              .            .           .          .           .              .           .       .         .           .
far_move     Run/./Critical  .         .         .              .            .           .          .           .              .           .       .         ./Critical  .
arc          Run/.           .         .         .              .            .           .          .           .              .           .       .         .           .
dwell        .               .         .         .              .            .           .          .           .              .           .       .         .           .
M0           Hold:0/.        .         .         .              .            .           .          .           .              .           .       .         .           .
M2           .               .         .         .              .            .           .          .           .              .           .       .         .           .
spindle      .               .         .         .              .            .           .          .           .              .           .       .         .           .
probe        Run/./Alarm     .         .         .              .            .           .          .           .              .           .       .         .           .
jog          Jog/.           .         .         .              .            .           .          .           .              .           .       .         .           .
jog_nowhere  .               .         .         .              .            .           .          .           .              .           .       .         .           .
wrong        .               .         .         .              .            .           .          .           .              .           .       .         .           .
empty        .               .         .         .              .            .           .          .           .              .           .       .         .           .
too_long     .               .         .         .              .            .           .          .           .              .           .       .         .           .
$            .               .         .         .              .            .           .          .           .              .           .       .         .           .
$$           .               .         .         .              .            .           .          .           .              .           .       .         .           .
$#           .               .         .         .              .            .           .          .           .              .           .       .         .           .
$G           .               .         .         .              .            .           .          .           .              .           .       .         .           .
$I           .               .         .         .              .            .           .          .           .              .           .       .         .           .
$N           .               .         .         .              .            .           .          .           .              .           .       .         .           .
$N1=         .               .         .         .              .            .           .          .           .              .           .       .         .           .
$1=30        .               .         .         .              .            .           .          .           .              .           .       .         .           .
$X           .               .         .         .              .            .           .          .           .              .           Idle/.  .         .           .
$H           Home/.          .         .         .              .            .           .          .           .              .           Home/.  .         .           .
$C           Check/.         .         .         .              .            .           .          .           .              .           .       .         ResetDoor   .
$SLP         Sleep/Door:2/.  .         .         .              .            .           .          .           .              .           Sleep   .         .           .
$RST=#       Reset/.         .         .         .              .            .           .          .           .              .           .       .         .           .
20_ms        ./Run/Hold:0    Rests     ./Idle    .              Braked       .           .          BehindDoor  DoorEnds       ./Alarm     .       .         .           .
10_s         ./Run/Hold:0    Rests     Idle      .              Braked       .           .          BehindDoor  DoorEnds       Idle/Alarm  .       .         .           .
";

/// Named sets of states that occur more than once in the table.
const SETS: [(&str, &[&str]); 7] = [
    // A resume at a door first restores the outputs that the door has switched off (`Door:3`). If none was on, the job
    // continues at once.
    ("DoorGoesOn", &["Door:3", "Idle", "Run"]),
    ("DoorEnds", &[".", "Idle", "Run"]),
    ("BehindDoor", &[".", "Door:0", "Door:1", "Sleep"]),
    // After a reset: Alarm (locked) if the machine was moving or is on a limit switch, otherwise Idle.
    ("Reset", &["Idle", "Alarm"]),
    // A reset while the door is open leads to Idle or Alarm, like any reset, or to a door state, if the controller has
    // already detected the door again.
    ("ResetDoor", &["Idle", "Alarm", "Door:1", "Door:2"]),
    // A braking machine after some time: it still brakes (`.`), is held, or, after a stop, is idle or runs the next
    // line.
    ("Braked", &[".", "Hold:0", "Idle", "Run"]),
    // A running machine after some time: it still runs (`.`), has made all its moves (Idle), pauses at an M0 (Hold:0),
    // has failed to probe (Alarm), or has stopped before a move beyond the soft limits (Critical).
    ("Rests", &[".", "Idle", "Hold:0", "Alarm", "Critical"]),
];

#[derive(Clone, Copy)]
enum Act {
    Bytes(&'static [u8]),
    Line(&'static str),
    Pin(&'static str),
    Pass(f64),
}

#[derive(Clone, Copy)]
struct Event {
    /// Name of the event's row in [`TRANSITIONS`].
    row: &'static str,
    act: Act,
}

const fn bytes(row: &'static str, bytes: &'static [u8]) -> Event {
    Event { row, act: Act::Bytes(bytes) }
}
const fn line(row: &'static str, text: &'static str) -> Event {
    Event { row, act: Act::Line(text) }
}
const fn pin(row: &'static str, text: &'static str) -> Event {
    Event { row, act: Act::Pin(text) }
}

const EVENTS: &[Event] = &[
    bytes("?", b"?"),
    bytes("!", b"!"),
    bytes("~", b"~"),
    bytes("0x84", &[0x84]),
    bytes("0x85", &[0x85]),
    bytes("0x18", &[0x18]),
    bytes("0x19", &[0x19]),
    bytes("override", &[0x90]),
    bytes("override", &[0x91]),
    bytes("override", &[0x92]),
    bytes("override", &[0x93]),
    bytes("override", &[0x94]),
    bytes("override", &[0x95]),
    bytes("override", &[0x96]),
    bytes("override", &[0x97]),
    bytes("override", &[0x99]),
    bytes("override", &[0x9A]),
    bytes("override", &[0x9B]),
    bytes("override", &[0x9C]),
    bytes("override", &[0x9D]),
    bytes("override", &[0x9E]),
    bytes("override", &[0xA0]),
    bytes("override", &[0xA1]),
    bytes("override", &[0x89]),
    bytes("no_command", NO_COMMANDS),
    pin("hold_1", "hold 1"),
    pin("hold_0", "hold 0"),
    pin("start_1", "start 1"),
    pin("start_0", "start 0"),
    pin("door_1", "door 1"),
    pin("door_0", "door 0"),
    pin("reset_1", "reset 1"),
    pin("reset_0", "reset 0"),
    pin("limit_1", "limit x 1"),
    pin("limit_0", "limit x 0"),
    pin("estop_1", "estop 1"),
    pin("estop_0", "estop 0"),
    pin("fault_1", "fault 1"),
    pin("fault_0", "fault 0"),
    pin("probe_1", "probe 1"),
    pin("probe_0", "probe 0"),
    line("move", "G91 G1 X-0.4 Z-0.3 F200"),
    line("far_move", "G91 G1 X-30 F2000"),
    line("arc", "G91 G2 X-0.4 R0.2 F200"),
    line("dwell", "G4 P0.05"),
    line("M0", "M0"),
    line("M2", "M2"),
    line("spindle", "M3 S500 M8"),
    line("probe", "G91 G38.2 Z-0.4 F200"),
    line("jog", "$J=G91 X-0.3 F200"),
    line("jog_nowhere", "$J=G91 X0 F200"),
    line("wrong", "G999"),
    line("empty", ""),
    line("too_long", TOO_LONG),
    line("$", "$"),
    line("$$", "$$"),
    line("$#", "$#"),
    line("$G", "$G"),
    line("$I", "$I"),
    line("$N", "$N"),
    line("$N1=", "$N1="),
    line("$1=30", "$1=30"),
    line("$X", "$X"),
    line("$H", "$H"),
    line("$C", "$C"),
    line("$SLP", "$SLP"),
    line("$RST=#", "$RST=#"),
    Event { row: "20_ms", act: Act::Pass(0.02) },
    Event { row: "10_s", act: Act::Pass(10.0) },
];

/// The bytes from 0x80 on that are no realtime commands. Each byte that is a command is replaced by 0x80, which only
/// requests a status report.
const NO_COMMANDS: &[u8] = &{
    let mut bytes = [0; 128];
    let mut n = 0;
    while n < 128 {
        let byte = 0x80 + n as u8;
        bytes[n] = if oxmill_controller::protocol::realtime::command(byte).is_none() { byte } else { 0x80 };
        n += 1;
    }
    bytes
};

const TOO_LONG: &str = "X1X1X1X1X1X1X1X1X1X1X1X1X1X1X1X1X1X1X1X1X1X1X1X1X1X1X1X1X1X1X1X1X1X1X1X1X1X1X1X1X1X1X1X1X1X1X1X1X1X1X1X1X1\
                        X1X1X1X1X1X1X1X1X1X1X1X1X1X1X1X1X1X1X1X1X1X1X1X1X1X1X1X1X1X1X1X1X1X1X1X1X1X1X1X1X1X1X1X1X1X1X1X1X1X1X1X1X1X1\
                        X1X1X1X1X1X1X1X1X1X1X1X1X1X1X1X1X1X1X1X1X1X1X1X1X1X1X1X1";

/// Everything by which the search tells two situations apart.
#[derive(Clone, PartialEq, Eq, PartialOrd, Ord, Hash, Debug)]
struct Key {
    state: String,
    moving: bool,
    /// In this order: door, hold, start, reset, limit, probe, emergency stop, driver fault.
    pins: [bool; 8],
    trusted: bool,
    spindle: bool,
    /// `true` if the program has switched the spindle on, even if the machine keeps the output (`spindle`) off now.
    turned_on: bool,
    flood: bool,
    waiting: bool,
    busy: bool,
    /// Last request for a stop (`0x19`), a sleep (`$SLP`) or a pause (`M0`). Becomes empty as soon as the machine is
    /// idle.
    mark: &'static str,
}

#[derive(Clone)]
struct Machine {
    bench: Bench,
    turned_on: bool,
    mark: &'static str,
    /// Number of lines that must still be answered.
    lines: usize,
    /// `true` after an event that drops lines. Then the number of answers is not checked.
    dropped: bool,
}

/// A machine without options, and one with homing, limits and parking.
const MACHINES: [(&str, &str); 2] = [
    ("", "$21=1 $120=50 $121=50 $122=50"),
    (
        r#"
        steps_per_mm = [250, 250, 250]
        switch = [
            { axis = "x", at_mm = 0.7, side = "positive", bounce_us = 700 },
            { axis = "y", at_mm = 0.5, side = "positive", bounce_us = 700 },
            { axis = "z", at_mm = 0.6, side = "positive", bounce_us = 700 },
        ]
        "#,
        "$20=0 $22=1 $20=1 $21=1 $24=300 $25=2000 $26=5 $110=2000 $111=2000 $112=2000 $120=200 $121=200 $122=200 $130=9 $131=9 \
         $132=9 $41=1 $56=0.2 $58=-0.5",
    ),
];

impl Machine {
    fn new(kind: usize) -> Machine {
        let (machine, settings) = MACHINES[kind];
        let bench = Bench::new(machine, settings);
        Machine { bench, turned_on: false, mark: "", lines: 0, dropped: false }
    }

    fn key(&mut self) -> Key {
        let status = self.bench.status();
        let mut state = status.trim_start_matches('<').split(['|', '>']).next().expect("a state").to_string();
        let mill = &self.bench.mill;
        // `Critical` leaves lines unread; any other alarm rejects them.
        if state == "Alarm" && !mill.controller().wants_line() {
            state = "Critical".into();
        }
        let pins = mill.pins();
        let outputs = mill.outputs().expect("the outputs have been set");
        let suspended = matches!(state.split(':').next(), Some("Hold" | "Door" | "Sleep" | "Critical"));
        let busy = !mill.controller().wants_line() && !suspended;
        if state == "Idle" && !busy {
            self.mark = "";
        }
        Key {
            moving: mill.is_stepping() && !status.contains("|FS:0,"),
            pins: [
                pins.door,
                pins.hold,
                pins.start,
                pins.reset,
                pins.limits != 0,
                pins.probe,
                pins.emergency_stop,
                pins.driver_fault,
            ],
            trusted: mill.controller().is_trusted(),
            spindle: outputs.spindle != SpindleDirection::Off,
            turned_on: self.turned_on,
            flood: outputs.coolant.flood,
            waiting: mill.unread() > 0,
            busy,
            mark: self.mark,
            state,
        }
    }

    fn act(&mut self, event: &Event) {
        match event.row {
            "spindle" => self.turned_on |= self.bench.mill.controller().wants_line(),
            "0x18" | "reset_1" | "estop_1" | "fault_1" => self.turned_on = false,
            _ => {}
        }
        match event.act {
            Act::Bytes(bytes) => self.bench.send(bytes),
            Act::Pin(text) => self.bench.pin(text),
            Act::Pass(seconds) => self.bench.wait(seconds),
            Act::Line(text) => {
                self.bench.send(text);
                self.bench.send("\n");
                self.lines += 1;
            }
        }
        if ["0x19", "$SLP", "M0"].contains(&event.row) {
            self.mark = event.row;
        }
        if ["0x18", "0x19", "reset_1", "limit_1", "estop_1", "fault_1", "$SLP", "far_move"].contains(&event.row) {
            self.dropped = true;
        }
    }

    /// Returns to Idle as an operator would: releases the pins, sends `~`, then `$X` or `$C`. Sends a reset only in the
    /// two states that nothing else ends (`Critical` and `Sleep`).
    fn way_to_idle(&mut self, what: &str) {
        for text in ["door 0", "hold 0", "start 0", "reset 0", "limit x 0", "probe 0", "estop 0", "fault 0"] {
            self.bench.pin(text);
        }
        let mut tried = Vec::new();
        for _ in 0..12 {
            self.bench.wait(12.0);
            let key = self.key();
            tried.push(key.state.clone());
            match key.state.as_str() {
                "Idle" if !key.busy && !key.waiting => break,
                "Hold:0" | "Door:0" => self.bench.send("~"),
                "Alarm" => {
                    self.lines += 1;
                    self.bench.send("$X\n");
                }
                "Check" => {
                    self.lines += 1;
                    self.bench.send("$C\n");
                }
                "Critical" | "Sleep" => {
                    self.dropped = true;
                    self.bench.send([0x18]);
                }
                "Idle" => {}
                other => panic!("{what}: {other} does not end by itself: {tried:?}"),
            }
        }
        let said = self.bench.read();
        if !self.dropped {
            let answers = said.iter().filter(|l| *l == "ok" || l.starts_with("error:")).count();
            assert_eq!(answers, self.lines, "{what}: {tried:?} {said:?}");
        }
        let state = self.bench.state();
        assert_eq!(state, "Idle", "{what}: {tried:?}");
        let before = self.bench.place();
        assert_eq!(self.bench.ask("$J=G91 X-0.1 F1000"), ["ok"], "{what}: {tried:?}");
        self.bench.settle();
        assert_eq!(self.bench.place()[0], before[0] - 25, "{what}: {tried:?}");
    }
}

type Table = HashMap<(String, String), BTreeSet<String>>;

fn table() -> Table {
    let mut rows = TRANSITIONS.trim().lines();
    let columns: Vec<String> = rows.next().unwrap().split_whitespace().skip(1).map(str::to_string).collect();
    let mut table = Table::new();
    for row in rows {
        let mut cells = row.split_whitespace();
        let event = cells.next().unwrap();
        let cells: Vec<&str> = cells.collect();
        assert_eq!(cells.len(), columns.len(), "{row}");
        for (state, cell) in columns.iter().zip(cells) {
            let mut allowed = BTreeSet::new();
            for word in cell.split('/').filter(|word| *word != "-") {
                let set = SETS.iter().find(|(name, _)| *name == word).map_or(vec![word], |(_, set)| set.to_vec());
                allowed.extend(set.into_iter().map(|s| if s == "." { state.clone() } else { s.to_string() }));
            }
            assert!(table.insert((state.clone(), event.to_string()), allowed).is_none(), "{event} twice");
        }
    }
    table
}

/// Returns whether an event makes sense: no pin is activated twice, and at most one pin besides the door is active.
fn sensible(key: &Key, event: &Event) -> bool {
    let Act::Pin(text) = event.act else { return true };
    let names = ["door", "hold", "start", "reset", "limit", "probe", "estop", "fault"];
    let index = names.iter().position(|name| text.starts_with(name)).unwrap();
    let press = text.ends_with('1');
    let others = key.pins.iter().enumerate().skip(1).any(|(i, on)| *on && i != index);
    key.pins[index] != press && !(press && index > 0 && others)
}

/// Results of a search. `reached`: for each pair of a state and an event, the states that followed.
#[derive(Default)]
struct Found {
    reached: BTreeMap<(String, String), BTreeSet<String>>,
    /// Transitions missing from the table, each with a path to it.
    faults: BTreeMap<(String, String, String), String>,
    situations: u32,
    transitions: u32,
}

#[test]
fn every_transition_is_one_of_the_table() {
    let table = table();
    let mut all = Found::default();
    std::thread::scope(|scope| {
        let searches: Vec<_> = (0..MACHINES.len())
            .map(|kind| {
                scope.spawn({
                    let table = &table;
                    move || search(kind, table)
                })
            })
            .collect();
        for found in searches.into_iter().map(|search| search.join().unwrap()) {
            for (pair, states) in found.reached {
                all.reached.entry(pair).or_default().extend(states);
            }
            all.faults.extend(found.faults);
            all.situations += found.situations;
            all.transitions += found.transitions;
        }
    });
    let Found { reached, faults, situations, transitions } = all;
    println!("{situations} situations, {transitions} transitions, {} of {} pairs", reached.len(), table.len());
    let faults: Vec<String> = faults.iter().map(|((a, e, b), by)| format!("{a} --{e}--> {b}   by {by}")).collect();
    assert!(faults.is_empty(), "{}", faults.join("\n"));
    let missed: Vec<String> = table
        .iter()
        .filter(|(pair, allowed)| reached.contains_key(pair) == allowed.is_empty())
        .map(|((state, event), _)| format!("{state} {event}"))
        .collect();
    assert!(missed.is_empty(), "never tried, or cannot be: {missed:?}");
}

/// Tries every event in every situation of this machine.
fn search(kind: usize, table: &Table) -> Found {
    let mut found = Found::default();
    let mut known: BTreeSet<Key> = BTreeSet::new();
    let mut queue: VecDeque<(Vec<usize>, Key, Machine)> = VecDeque::new();
    let mut machine = Machine::new(kind);
    let first = machine.key();
    known.insert(first.clone());
    queue.push_back((Vec::new(), first, machine));
    while let Some((history, from, there)) = queue.pop_front() {
        found.situations += 1;
        let names = |last: &str| {
            let mut names: Vec<&str> = history.iter().map(|i| EVENTS[*i].row).collect();
            names.push(last);
            format!("machine {kind}: {}", names.join(", "))
        };
        there.clone().way_to_idle(&names("and back"));
        for (index, event) in EVENTS.iter().enumerate() {
            if !sensible(&from, event) {
                continue;
            }
            let mut machine = there.clone();
            let is_line = matches!(event.act, Act::Line(_));
            let read = !is_line || machine.bench.mill.controller().wants_line();
            machine.act(event);
            let to = machine.key();
            found.transitions += 1;
            let pair = (from.state.clone(), event.row.to_string());
            let allowed = &table[&pair];
            found.reached.entry(pair).or_default().insert(to.state.clone());
            if !allowed.contains(&to.state) {
                found
                    .faults
                    .entry((from.state.clone(), event.row.to_string(), to.state.clone()))
                    .or_insert_with(|| names(event.row));
            }
            if is_line && !read {
                // The machine has not taken the line yet, or has dropped it in a state that only a reset ends. To limit
                // the search, continue only if the line waits and is a move.
                let is_dropped = machine.bench.mill.unread() == 0;
                assert!(!is_dropped || ["Critical", "Sleep"].contains(&to.state.as_str()), "{}", names(event.row));
                if is_dropped || event.row != "move" {
                    continue;
                }
            }
            if known.insert(to.clone()) {
                let mut longer = history.clone();
                longer.push(index);
                queue.push_back((longer, to, machine));
            }
        }
    }
    found
}
