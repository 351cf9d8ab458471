//! The wiring of a board, grouped by purpose: the pins of a motor, of the switches, of the spindle. The tables and the
//! drawings of `docs/boards.md` show these groups.

use oxmill_tables::{Board, text_of};
use std::fmt::Write;

/// What a group of pins is for. Each kind has its own colour in the drawings.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    Motors,
    Spindle,
    Coolant,
    Outputs,
    Switches,
    Buttons,
    Inputs,
    Host,
}

/// Direction of the signal at a pin, seen from the board.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Way {
    Output,
    Input,
    /// An input that a switch connects to ground.
    Switch,
    Both,
}

/// A pin and its function.
#[derive(Clone, Debug)]
pub struct Wire {
    /// Name of the function in the board's file. Empty for the links to the host: their pins are not in the file.
    pub key: &'static str,
    pub text: &'static str,
    pub way: Way,
    pub pin: String,
    /// The name printed beside the pin; empty if that is the pin's own name.
    pub label: String,
}

impl Wire {
    /// Returns `true` if the connector has a MOSFET that switches the ground of a load. On control boards, the name
    /// printed beside such an output begins with FAN, HE or HB, or it is E0 or E1. But the socket of a stepper driver
    /// may be called E0, too. So the outputs of motors never count.
    pub fn has_mosfet(&self) -> bool {
        let is_slow = !["step_", "direction_", "enable"].iter().any(|part| self.key.contains(part));
        let label = self.label.as_str();
        let is_load = ["FAN", "HE", "HB"].iter().any(|begin| label.starts_with(begin)) || ["E0", "E1"].contains(&label);
        self.way == Way::Output && is_slow && is_load
    }
}

/// Pins that belong together.
#[derive(Clone, Debug)]
pub struct Group {
    pub kind: Kind,
    pub title: &'static str,
    pub wires: Vec<Wire>,
}

/// A group of functions: its kind, title and signal direction. Each function has its name in the board's file, and its
/// text in drawings.
type Plan = (Kind, &'static str, Way, &'static [(&'static str, &'static str)]);

const PLANS: [Plan; 10] = [
    (
        Kind::Motors,
        "X motor",
        Way::Output,
        &[("step_x", "X step"), ("direction_x", "X direction"), ("enable", "X enable, low is on")],
    ),
    (
        Kind::Motors,
        "Y motor",
        Way::Output,
        &[("step_y", "Y step"), ("direction_y", "Y direction"), ("second_enable", "Y enable, low is on")],
    ),
    (
        Kind::Motors,
        "Z motor",
        Way::Output,
        &[("step_z", "Z step"), ("direction_z", "Z direction"), ("third_enable", "Z enable, low is on")],
    ),
    (
        Kind::Motors,
        "Fourth motor",
        Way::Output,
        &[
            ("step_fourth", "fourth step"),
            ("direction_fourth", "fourth direction"),
            ("fourth_enable", "fourth enable, low is on"),
        ],
    ),
    (
        Kind::Spindle,
        "Spindle or laser",
        Way::Output,
        &[
            ("spindle_pwm", "spindle PWM or laser"),
            ("spindle_on", "spindle on"),
            ("spindle_direction", "spindle direction"),
        ],
    ),
    (Kind::Coolant, "Coolant", Way::Output, &[("flood", "flood"), ("mist", "mist")]),
    (
        Kind::Outputs,
        "Outputs of programs",
        Way::Output,
        &[("program_output", "output P0"), ("second_program_output", "output P1")],
    ),
    (
        Kind::Switches,
        "Limit switches and probe",
        Way::Switch,
        &[
            ("limit_x", "X limit"),
            ("limit_y", "Y limit"),
            ("limit_z", "Z limit"),
            ("limit_fourth", "fourth limit"),
            ("probe", "probe"),
        ],
    ),
    (
        Kind::Buttons,
        "Buttons and safety",
        Way::Switch,
        &[
            ("reset", "reset, emergency stop"),
            ("hold", "hold"),
            ("start", "start"),
            ("door", "safety door"),
            ("driver_fault", "driver fault"),
            ("at_speed", "spindle at speed"),
        ],
    ),
    (
        Kind::Inputs,
        "Inputs of programs",
        Way::Switch,
        &[("program_input", "input P0"), ("second_program_input", "input P1")],
    ),
];

/// Returns the groups of a board, without the empty ones.
pub fn groups(board: &Board) -> Vec<Group> {
    let wire = |key, text, way| {
        let found = board.pins.get(key)?;
        Some(Wire { key, text, way, pin: text_of(found.pin), label: found.label.clone() })
    };
    let mut groups: Vec<Group> = Vec::new();
    let has_common_enable = board.pins.contains_key("enable") && !board.pins.contains_key("second_enable");
    for (kind, title, way, functions) in PLANS {
        let functions = functions.iter().filter(|(key, _)| *key != "enable" || !has_common_enable);
        let wires: Vec<Wire> = functions.filter_map(|(key, text)| wire(key, text, way)).collect();
        groups.push(Group { kind, title, wires });
    }
    let mut all_motors: Vec<Wire> = wire("motor_power", "supply, high is on", Way::Output).into_iter().collect();
    if has_common_enable {
        all_motors.extend(wire("enable", "enable of all drivers, low is on", Way::Output));
    }
    groups.insert(4, Group { kind: Kind::Motors, title: "All motors", wires: all_motors });
    groups.push(Group { kind: Kind::Host, title: "Host", wires: links(board) });
    groups.retain(|group| !group.wires.is_empty());
    let placed = groups.iter().flat_map(|group| &group.wires).filter(|wire| !wire.key.is_empty()).count();
    assert_eq!(placed, board.pins.len(), "each pin of {} has its place in a group", board.name);
    groups
}

/// Returns the pins that connect a board to a host: a UART and, if the image has USB, also USB. They are the same as
/// in `boards/stm32f4/setup.rs`.
fn links(board: &Board) -> Vec<Wire> {
    let link = |text, way, pin: &str| Wire { key: "", text, way, pin: pin.to_owned(), label: String::new() };
    let (tx, rx) = if board.image.has_usb { ("A9", "A10") } else { ("A2", "A3") };
    let mut links = vec![link("UART, TX", Way::Output, tx), link("UART, RX", Way::Input, rx)];
    if board.image.has_usb {
        links.extend([link("USB, D-", Way::Both, "A11"), link("USB, D+", Way::Both, "A12")]);
    }
    links
}

/// Rows of a board's table: the title of the row, and the functions that it shows together.
const ROWS: [(&str, &[&str]); 18] = [
    ("X motor: step, direction, enable", &["step_x", "direction_x", "enable"]),
    ("Y motor: step, direction, enable", &["step_y", "direction_y", "second_enable"]),
    ("Z motor: step, direction, enable", &["step_z", "direction_z", "third_enable"]),
    ("fourth motor: step, direction, enable", &["step_fourth", "direction_fourth", "fourth_enable"]),
    ("enable of all drivers, low is on", &["enable"]),
    ("supply of the motors, high is on", &["motor_power"]),
    ("spindle PWM or laser", &["spindle_pwm"]),
    ("spindle on, direction", &["spindle_on", "spindle_direction"]),
    ("flood, mist", &["flood", "mist"]),
    ("outputs of programs P0, P1", &["program_output", "second_program_output"]),
    ("limit X, Y, Z", &["limit_x", "limit_y", "limit_z"]),
    ("limit of the fourth motor", &["limit_fourth"]),
    ("probe", &["probe"]),
    ("reset or emergency stop, hold, start", &["reset", "hold", "start"]),
    ("safety door", &["door"]),
    ("driver fault", &["driver_fault"]),
    ("spindle at speed (`$915`)", &["at_speed"]),
    ("inputs of programs P0, P1", &["program_input", "second_program_input"]),
];

/// Returns the table of a board: function, pin and print.
pub fn table(board: &Board) -> String {
    let has_labels = board.pins.values().any(|pin| !pin.label.is_empty());
    let has_common_enable = !board.pins.contains_key("second_enable");
    let mut table =
        if has_labels { "| function | pin | print |\n|---|---|---|\n" } else { "| function | pin |\n|---|---|\n" }
            .to_owned();
    let mut seen = 0;
    let mut add = |function: &str, pins: &[String], labels: &[String]| {
        let mut prints = labels.to_vec();
        prints.dedup();
        let _ = write!(table, "| {function} | {} |", pins.join(", "));
        table.push_str(&if has_labels { format!(" {} |\n", prints.join(", ")) } else { "\n".to_owned() });
    };
    for (function, keys) in ROWS {
        let is_motor = keys.len() == 3 && keys[2].contains("enable");
        // If all drivers share one enable output, this output has a row of its own.
        let is_left_out = |key: &str| key == "enable" && is_motor == has_common_enable;
        let function = if is_motor && has_common_enable { function.trim_end_matches(", enable") } else { function };
        let found: Vec<_> =
            keys.iter().filter(|key| !is_left_out(key)).filter_map(|key| board.pins.get(*key)).collect();
        if !found.is_empty() {
            seen += found.len();
            let pins: Vec<String> = found.iter().map(|pin| text_of(pin.pin)).collect();
            let labels: Vec<String> = found.iter().map(|pin| pin.label.clone()).collect();
            add(function, &pins, &labels);
        }
    }
    assert_eq!(seen, board.pins.len(), "each pin of {} has its row", board.name);
    for (name, wires) in [("UART to the host: TX, RX", 0..2), ("USB to the host: D-, D+", 2..4)] {
        let pins: Vec<String> =
            links(board).get(wires).unwrap_or_default().iter().map(|wire| wire.pin.clone()).collect();
        if !pins.is_empty() {
            add(name, &pins, &[]);
        }
    }
    table
}
