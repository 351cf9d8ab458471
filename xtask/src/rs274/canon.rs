//! Runs `rs274` and reads its output: calls of canonical machining functions, such as `STRAIGHT_FEED(..)`, which are
//! LinuxCNC's elementary commands to a machine. Positions in them are in the unit of the program, without the offsets.

use super::{AXES, Event, NO_MOVE, Outcome};
use crate::Failure;
use std::path::Path;
use std::process::Command;

/// State while reading: active offsets and position, in mm and degrees.
#[derive(Default)]
struct Reader {
    inches: bool,
    /// Indices of the first, second and third axis of the plane.
    plane: [usize; 3],
    system: [f64; AXES],
    /// Rotation of the system, degrees.
    rotation: f64,
    g92: [f64; AXES],
    tool: [f64; AXES],
    /// Position in machine coordinates.
    machine: [f64; AXES],
    /// `true` after a spline: the position is unknown, because `rs274` prints only the spline's number of control
    /// points.
    is_place_unknown: bool,
    /// Feed rate, mm/min.
    rate: f64,
    /// `true` while G93 is active.
    is_inverse_time: bool,
    /// `true` if the most recent move or arc has produced an event; `false` if it was too short.
    has_moved: bool,
    events: Vec<Event>,
}

/// Limit for `timeout`, s: an endless program would fill the memory.
const LONGEST: &str = "20";

/// Settings of a run of `rs274`, and which events it returns.
pub struct Settings<'a> {
    /// Contents of the tool table of `rs274`, such as `T1 P1` (tool 1 in pocket 1); one line per tool.
    pub tools: &'a str,
    /// `true`: lines that start with a slash are skipped.
    pub deletes_blocks: bool,
    /// `true`: the events include messages, program stops and the rates of G93.
    pub reports_all: bool,
}

/// Runs a file through `rs274` and returns its events. Processes that run at the same time need different folders
/// `home`, because the tool table is written there.
pub fn interpret(home: &Path, file: &Path, settings: &Settings) -> Result<Outcome, Failure> {
    let home = std::path::absolute(home).map_err(|e| e.to_string())?;
    // Each tool in this table needs a pocket (`P1`): `rs274` rejects a tool without one.
    std::fs::write(home.join("tools.tbl"), settings.tools).map_err(|e| e.to_string())?;
    let output = Command::new("timeout")
        .args([LONGEST, "rs274"])
        .args(["-g", "-t", "tools.tbl"])
        .args(settings.deletes_blocks.then_some("-b"))
        .arg(std::path::absolute(file).map_err(|e| e.to_string())?)
        .env("HOME", &home)
        .current_dir(&home)
        .output()
        .map_err(|e| format!("rs274: {e}"))?;
    let mut reader = Reader { plane: [0, 1, 2], ..Reader::default() };
    for line in String::from_utf8_lossy(&output.stdout).lines() {
        // A line of the output has three parts: the number of the call, `N` with a line number of the program or with
        // dots, and the call.
        let Some((_, numbered)) = line.trim_start().split_once(" N") else {
            // A line without a call can be what `(PRINT, ...)` in the program outputs.
            if settings.reports_all && line.starts_with(super::STATE) {
                reader.events.push(Event::Message(line.into()));
            }
            continue;
        };
        if let Some((_, call)) = numbered.split_once(' ') {
            reader.call(call.trim()).ok_or_else(|| format!("not understood: {line}"))?;
            if settings.reports_all {
                reader.record_other(call.trim()).ok_or_else(|| format!("not understood: {line}"))?;
            }
        }
    }
    let errors = String::from_utf8_lossy(&output.stderr).into_owned();
    let mut refused: Vec<&str> = errors.lines().filter(|line| *line != "executing" && !line.is_empty()).collect();
    Ok(Outcome { events: reader.events, of: Vec::new(), refused: refused.pop().map(str::to_string) })
}

/// Converts the positions in a message from inches to mm; `None` if one of them is not a number.
fn in_mm(places: &str) -> Option<String> {
    let mut text = String::from(super::PLACES_MARK);
    for place in places.split_whitespace() {
        text += &format!(" {:.4}", place.parse::<f64>().ok()? * 25.4);
    }
    Some(text)
}

impl Reader {
    /// Returns the arguments of a call, converted to mm; `None` if one of them is not a number.
    fn lengths(&self, arguments: &str) -> Option<Vec<f64>> {
        let unit = if self.inches { 25.4 } else { 1.0 };
        arguments
            .split([',', ' '])
            .filter(|word| !word.is_empty())
            .map(|word| word.parse::<f64>().ok().map(|value| value * unit))
            .collect()
    }

    fn call(&mut self, call: &str) -> Option<()> {
        let (name, arguments) = call.strip_suffix(')')?.split_once('(')?;
        // For a program in inches, `lengths` converts all numbers to mm. But A is in degrees, so its conversion is
        // undone.
        let unit = if self.inches { 25.4 } else { 1.0 };
        let place =
            |numbers: &[f64]| Some([*numbers.first()?, *numbers.get(1)?, *numbers.get(2)?, *numbers.get(3)? / unit]);
        match name {
            "USE_LENGTH_UNITS" => self.inches = arguments == "CANON_UNITS_INCHES",
            "SELECT_PLANE" => {
                self.plane = match arguments {
                    "CANON_PLANE_XZ" => [2, 0, 1],
                    "CANON_PLANE_YZ" => [1, 2, 0],
                    _ => [0, 1, 2],
                }
            }
            "SET_G5X_OFFSET" => self.system = place(self.lengths(arguments)?.get(1..)?)?,
            "SET_XY_ROTATION" => self.rotation = arguments.parse().ok()?,
            "SET_G92_OFFSET" => self.g92 = place(&self.lengths(arguments)?)?,
            "USE_TOOL_LENGTH_OFFSET" => self.tool = place(&self.lengths(arguments)?)?,
            "STRAIGHT_TRAVERSE" => {
                let to = place(&self.lengths(arguments)?)?;
                self.go(to, Event::Rapid(to));
            }
            "STRAIGHT_FEED" | "STRAIGHT_PROBE" => {
                let to = place(&self.lengths(arguments)?)?;
                self.go(to, Event::Feed(to));
            }
            "ARC_FEED" => self.arc(arguments)?,
            "SET_MOTION_OUTPUT_BIT" => self.events.push(Event::Output(false, arguments.parse().ok()?, 1.0, true)),
            "CLEAR_MOTION_OUTPUT_BIT" => self.events.push(Event::Output(false, arguments.parse().ok()?, 0.0, true)),
            "SET_AUX_OUTPUT_BIT" => self.events.push(Event::Output(false, arguments.parse().ok()?, 1.0, false)),
            "CLEAR_AUX_OUTPUT_BIT" => self.events.push(Event::Output(false, arguments.parse().ok()?, 0.0, false)),
            "SET_MOTION_OUTPUT_VALUE" | "SET_AUX_OUTPUT_VALUE" => {
                let (number, value) = arguments.split_once(',')?;
                let (number, value) = (number.trim().parse().ok()?, value.trim().parse().ok()?);
                self.events.push(Event::Output(true, number, value, name == "SET_MOTION_OUTPUT_VALUE"));
            }
            "NURBS_FEED" => {
                self.events.push(Event::Spline(arguments.split(',').next()?.parse().ok()?));
                self.is_place_unknown = true;
            }
            "DWELL" => self.events.push(Event::Dwell(arguments.parse().ok()?)),
            _ => {}
        }
        Some(())
    }

    /// Records the calls that [`Self::call`] ignores: messages, program stops and the rates of G93. It must run after
    /// `call` for the same line.
    fn record_other(&mut self, call: &str) -> Option<()> {
        let (name, arguments) = call.strip_suffix(')')?.split_once('(')?;
        match name {
            "COMMENT" if arguments.contains("feed mode set to") => self.is_inverse_time = arguments.contains("inverse"),
            "SET_FEED_RATE" => self.rate = *self.lengths(arguments)?.first()?,
            "STRAIGHT_FEED" | "ARC_FEED" if self.is_inverse_time && self.has_moved => {
                self.events.push(Event::Rate(self.rate));
            }
            "MESSAGE" => {
                let text = arguments.trim_matches('"').trim();
                let text = text.strip_prefix(super::PLACES_MARK).map_or(Some(text.to_owned()), in_mm)?;
                self.events.push(Event::Message(text));
            }
            "PROGRAM_STOP" => self.events.push(Event::Stop(false)),
            "OPTIONAL_PROGRAM_STOP" => self.events.push(Event::Stop(true)),
            _ => {}
        }
        Some(())
    }

    fn machine(&self, work: [f64; AXES]) -> [f64; AXES] {
        let [x, y, z, turn]: [f64; AXES] = std::array::from_fn(|axis| work[axis] + self.g92[axis]);
        let (sine, cosine) = self.rotation.to_radians().sin_cos();
        let turned = [x * cosine - y * sine, x * sine + y * cosine, z, turn];
        std::array::from_fn(|a| turned[a] + self.system[a] + self.tool[a])
    }

    fn go(&mut self, to: [f64; AXES], event: Event) {
        let machine = self.machine(to);
        let is_move = machine.iter().zip(self.machine).any(|(a, b)| (a - b).abs() > NO_MOVE);
        self.has_moved = is_move || self.is_place_unknown;
        if self.has_moved {
            self.events.push(event);
        }
        self.machine = machine;
        self.is_place_unknown = false;
    }

    fn arc(&mut self, arguments: &str) -> Option<()> {
        let numbers = self.lengths(arguments)?;
        let [first, second, centre_first, centre_second, _, third, turn, ..] = numbers[..] else { return None };
        let turns = arguments.split(',').nth(4)?.trim().parse().ok()?;
        let mut end = [0.0, 0.0, 0.0, if self.inches { turn / 25.4 } else { turn }];
        for (axis, value) in self.plane.into_iter().zip([first, second, third]) {
            end[axis] = value;
        }
        self.events.push(Event::Arc(end, [centre_first, centre_second], turns));
        self.has_moved = true;
        self.machine = self.machine(end);
        self.is_place_unknown = false;
        Some(())
    }
}
