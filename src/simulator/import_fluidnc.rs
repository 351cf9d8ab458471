//! Imports a configuration file of FluidNC. FluidNC reads only a part of YAML: lines `key: value`, with sections given
//! by the indentation. This module reads the same part. A tab in the indentation is an error, as in FluidNC.

use crate::import_list::{FileEntry, Import, decimal, number};
use oxmill_controller::axes::{Axis, LINEAR};
use oxmill_controller::settings::{AxisKey, Key};
use oxmill_controller::units::Decimal;

/// Why an entry about hardware is not taken: an Oxmill board has its own pins and parts.
const OF_THE_BOARD: &str = "pins and parts of another board";
/// FluidNC's configurations write this for a pin that is not connected.
const NO_PIN: &str = "NO_PIN";
/// FluidNC's types of spindles with a PWM or switched output.
const SPINDLES: [&str; 7] = ["PWM", "Laser", "10V", "BESC", "DAC", "Relay", "HBridge"];
/// FluidNC's types of spindles on a serial bus. Oxmill does not support them.
const BUS_SPINDLES: [&str; 9] =
    ["Huanyang", "HuanyangVFD", "H100", "H2A", "YL620", "NowForever", "DanfossVLT2800", "SiemensV20", "ModbusVFD"];
/// Letters of the axes in FluidNC, in the order of the axis numbers.
const LETTERS: &str = "xyzabc";

/// Returns whether the text has a section of axes, as each file of FluidNC does.
pub fn is_configuration(text: &str) -> bool {
    text.lines().any(|line| without_comment(line).trim() == "axes:")
}

/// Imports the text of a FluidNC configuration file.
///
/// # Errors
/// If a tab is in the indentation of a line. The text names the line.
pub fn import(text: &str) -> Result<Import, String> {
    let mut reader = Reader { import: Import::of("FluidNC"), machine: ConfiguredMachine::default() };
    let mut entries: Vec<(Vec<&str>, &str, FileEntry)> = Vec::new();
    let mut sections: Vec<(usize, &str)> = Vec::new();
    for (index, written) in text.lines().enumerate() {
        let line = without_comment(written).trim_end();
        let key_and_value = line.trim_start();
        let indent = line.len() - key_and_value.len();
        if key_and_value.is_empty() {
            continue;
        }
        if line.get(..indent).is_some_and(|blanks| blanks.contains('\t')) {
            return Err(format!("line {}: a tab is in the indentation, where FluidNC takes blanks only", index + 1));
        }
        let is_key = |key: &&str| key.bytes().all(|byte| byte.is_ascii_alphanumeric() || byte == b'_');
        let Some((key, value)) = key_and_value.split_once(':').map(|(key, value)| (key.trim_end(), value.trim()))
        else {
            reader.import.leave(&FileEntry::new(written, index + 1), "not of the form key: value");
            continue;
        };
        if !is_key(&key) {
            reader.import.leave(&FileEntry::new(written, index + 1), "not of the form key: value");
            continue;
        }
        while sections.last().is_some_and(|(outer, _)| *outer >= indent) {
            sections.pop();
        }
        sections.push((indent, key));
        let keys: Vec<&str> = sections.iter().map(|(_, key)| *key).collect();
        let value = value.trim_matches(['"', '\'']);
        let entry = FileEntry::new(&format!("{}: {value}", keys.join("/")), index + 1);
        entries.push((keys, value, entry));
    }
    // If a key occurs twice, the last value counts.
    for at in 0..entries.len() {
        let (keys, value, entry) = entries[at].clone();
        let is_repeated = |later: &(Vec<&str>, &str, FileEntry)| later.0 == keys && !later.1.is_empty();
        if !value.is_empty() && entries[at + 1..].iter().any(is_repeated) {
            reader.import.leave(&entry, "a later line has the same key");
        } else if !value.is_empty() {
            reader.value(&keys, value, entry);
        } else if let ["kinematics", kind] = keys[..] {
            reader.kinematics(kind, entry);
        }
    }
    Ok(reader.finish())
}

/// Returns a line without its comment. A `#` begins a comment only at the beginning of the line or after a blank.
fn without_comment(line: &str) -> &str {
    let begin = line.match_indices('#').find(|(at, _)| line[..*at].ends_with([' ', '\t']) || *at == 0);
    begin.map_or(line, |(at, _)| &line[..at])
}

/// Values of the file that become settings only together with other values. Most of them are stored with the text and
/// the line from which they come.
#[derive(Default)]
struct ConfiguredMachine {
    core_xy: bool,
    /// Homing cycle of each axis.
    cycles: Vec<(Axis, i32, FileEntry)>,
    /// Axes that are homed in the negative direction.
    to_negative: Vec<(Axis, FileEntry)>,
    soft_limits: Vec<(bool, FileEntry)>,
    hard_limits: Vec<(bool, FileEntry)>,
    /// Machine coordinate of each axis after homing.
    place: Vec<(Decimal, FileEntry)>,
    /// Axis, and `true` if its step pin is active low.
    steps: Vec<(Axis, bool, FileEntry)>,
    /// Axis, number of the motor (0 or 1), and `true` if its direction pin is active low.
    directions: Vec<(Axis, usize, bool, FileEntry)>,
    /// Axes with a second motor.
    second_motors: Vec<(Axis, FileEntry)>,
    second_switches: Vec<(Axis, FileEntry)>,
    /// Name of the first spindle section in the file; entries of other spindles are not taken.
    spindle: Option<String>,
    a: Option<FileEntry>,
}

struct Reader {
    import: Import,
    machine: ConfiguredMachine,
}

impl Reader {
    /// Imports a value, or lists it as not taken with the reason. `keys`: the path to the value in the file, such as
    /// `axes`, `x`, `steps_per_mm`.
    fn value(&mut self, keys: &[&str], value: &str, entry: FileEntry) {
        match *keys {
            ["axes", axis, ref rest @ ..] if !rest.is_empty() => match LETTERS.find(axis).filter(|_| axis.len() == 1) {
                Some(index) if index <= LINEAR => self.of_axis(Axis::ALL[index], rest, value, entry),
                Some(_) => self.import.leave(&entry, "no axis B or C"),
                None => self.other(keys, value, entry),
            },
            ["axes", "homing_runs"] => self.take(Key::HomingPasses, value, entry),
            ["axes", "shared_stepper_disable_pin"] if is_low(value) => {
                self.import.take(Key::EnableInvert.number(), decimal(1), &entry);
            }
            ["junction_deviation_mm"] => self.take(Key::JunctionDeviation, value, entry),
            ["arc_tolerance_mm"] => self.take(Key::ArcTolerance, value, entry),
            ["report_inches"] => self.take_switch(Key::ReportInches, value, entry),
            ["stepping", "pulse_us"] => self.take(Key::StepPulse, value, entry),
            ["stepping", "dir_delay_us"] => self.take(Key::DirectionSetup, value, entry),
            ["stepping", "idle_ms"] => self.take(Key::IdleDelay, value, entry),
            ["kinematics", kind, ..] => self.kinematics(kind, entry),
            ["parking", key] => self.parking(key, value, entry),
            [spindle, key] if SPINDLES.iter().any(|name| name.eq_ignore_ascii_case(spindle)) => {
                self.spindle(spindle, key, value, entry);
            }
            _ => self.other(keys, value, entry),
        }
    }

    fn take(&mut self, key: Key, value: &str, entry: FileEntry) {
        self.take_number(key.number(), value, &entry);
    }

    fn take_number(&mut self, to: u16, value: &str, entry: &FileEntry) {
        match number(value) {
            Some(value) => self.import.take(to, value, entry),
            None => self.import.leave(entry, "no number"),
        }
    }

    fn take_switch(&mut self, key: Key, value: &str, entry: FileEntry) {
        match switch(value) {
            Some(on) => self.import.take(key.number(), decimal(on.into()), &entry),
            None => self.import.leave(&entry, "neither true nor false"),
        }
    }

    /// Imports a value that FluidNC has for each axis, and Oxmill once for all axes. The first value in the file
    /// counts. A later value that differs from it is listed as not taken.
    fn take_for_all(&mut self, key: Key, value: &str, entry: FileEntry) {
        let taken = self.import.taken.iter().find(|taken| taken.number == key.number()).map(|taken| taken.value.0);
        if taken.is_none() || number(value).is_none() {
            self.take(key, value, entry);
        } else if taken != number(value) {
            self.import.leave(&entry, format!("one value for all axes: ${} is that of the first", key.number()));
        }
    }

    fn of_axis(&mut self, axis: Axis, keys: &[&str], value: &str, entry: FileEntry) {
        let number_of = |key: AxisKey| key.number() + axis.index() as u16;
        match *keys {
            ["steps_per_mm"] => {
                self.take_number(number_of(AxisKey::Resolution), value, &entry);
                if axis == Axis::A {
                    self.machine.a = Some(entry);
                }
            }
            ["max_rate_mm_per_min"] => self.take_number(number_of(AxisKey::MaxRate), value, &entry),
            ["acceleration_mm_per_sec2"] => self.take_number(number_of(AxisKey::Acceleration), value, &entry),
            ["max_travel_mm"] => self.take_number(number_of(AxisKey::Travel), value, &entry),
            ["soft_limits"] => match switch(value) {
                Some(on) => self.machine.soft_limits.push((on, entry)),
                None => self.import.leave(&entry, "neither true nor false"),
            },
            ["hard_limits"] | [_, "hard_limits"] => match switch(value) {
                Some(on) => self.machine.hard_limits.push((on, entry)),
                None => self.import.leave(&entry, "neither true nor false"),
            },
            ["homing", key] => self.homing(axis, key, value, entry),
            [_, "pulloff_mm"] => self.take_for_all(Key::HomingPullOff, value, entry),
            ["motor0", .., key] => self.motor(axis, 0, key, value, entry),
            ["motor1", .., key] => self.motor(axis, 1, key, value, entry),
            _ => self.import.leave(&entry, OF_THE_BOARD),
        }
    }

    fn homing(&mut self, axis: Axis, key: &str, value: &str, entry: FileEntry) {
        match key {
            "cycle" => match value.parse() {
                Ok(cycle) => self.machine.cycles.push((axis, cycle, entry)),
                Err(_) => self.import.leave(&entry, "no whole number"),
            },
            "positive_direction" => match switch(value) {
                Some(false) => self.machine.to_negative.push((axis, entry)),
                Some(true) => {}
                None => self.import.leave(&entry, "neither true nor false"),
            },
            "mpos_mm" => match number(value) {
                Some(place) => self.machine.place.push((place, entry)),
                None => self.import.leave(&entry, "no number"),
            },
            "feed_mm_per_min" => self.take_for_all(Key::HomingLocate, value, entry),
            "seek_mm_per_min" => self.take_for_all(Key::HomingSeek, value, entry),
            "settle_ms" => self.take_for_all(Key::HomingDebounce, value, entry),
            "allow_single_axis" => self.import.leave(&entry, "$HX and the like always work"),
            "seek_scaler" | "feed_scaler" => self.import.leave(&entry, "the search is 1.5 times the travel"),
            _ => self.import.leave(&entry, OF_THE_BOARD),
        }
    }

    fn motor(&mut self, axis: Axis, motor: usize, key: &str, value: &str, entry: FileEntry) {
        if value == NO_PIN {
            return;
        }
        let is_limit = key.starts_with("limit_") && key.ends_with("_pin");
        match (motor, key) {
            (0, "step_pin") => self.machine.steps.push((axis, is_low(value), entry)),
            (1, "step_pin") => self.machine.second_motors.push((axis, entry)),
            (_, "direction_pin") => self.machine.directions.push((axis, motor, is_low(value), entry)),
            (0, "disable_pin") if is_low(value) => {
                self.import.take(Key::EnableInvert.number(), decimal(1), &entry);
            }
            (1, _) if is_limit => self.machine.second_switches.push((axis, entry)),
            _ if is_limit => self.import.leave(&entry, "the board's pin; $5 and $908 invert it"),
            _ => self.import.leave(&entry, OF_THE_BOARD),
        }
    }

    fn kinematics(&mut self, kind: &str, entry: FileEntry) {
        if kind.eq_ignore_ascii_case("CoreXY") {
            self.machine.core_xy = true;
            self.import.take(Key::Kinematics.number(), decimal(1), &entry);
        } else if kind.eq_ignore_ascii_case("Cartesian") {
            self.import.take(Key::Kinematics.number(), decimal(0), &entry);
        } else {
            self.import.leave(&entry, "Cartesian and CoreXY only");
        }
    }

    fn parking(&mut self, key: &str, value: &str, entry: FileEntry) {
        match key {
            "enable" => self.take_switch(Key::Parking, value, entry),
            "axis" => match LETTERS.find(&value.to_ascii_lowercase()).filter(|_| value.len() == 1) {
                Some(axis) => self.import.take(Key::ParkingAxis.number(), decimal(axis as u32), &entry),
                None => self.import.leave(&entry, "no axis"),
            },
            "target_mpos_mm" => self.take(Key::ParkingTarget, value, entry),
            "rate_mm_per_min" => self.take(Key::ParkingFastRate, value, entry),
            "pullout_distance_mm" => self.take(Key::ParkingPullOut, value, entry),
            "pullout_rate_mm_per_min" => self.take(Key::ParkingPullOutRate, value, entry),
            _ => self.import.leave(&entry, OF_THE_BOARD),
        }
    }

    fn spindle(&mut self, section: &str, key: &str, value: &str, entry: FileEntry) {
        if self.machine.spindle.is_none() {
            self.machine.spindle = Some(section.to_owned());
            if section.eq_ignore_ascii_case("Laser") {
                self.import.take(Key::Laser.number(), decimal(1), &entry);
            }
        }
        if self.machine.spindle.as_deref() != Some(section) {
            return self.import.leave(&entry, "one spindle");
        }
        match key {
            "pwm_hz" => self.take(Key::SpindlePwm, value, entry),
            "spinup_ms" => self.take_seconds(Key::SpinUp, value, &entry),
            "spindown_ms" => self.take_seconds(Key::SpinDown, value, &entry),
            "speed_map" => self.speeds(value, &entry),
            "tool_num" | "off_on_alarm" | "disable_with_s0" | "s0_with_disable" => {
                self.import.leave(&entry, "the PWM is off at S0");
            }
            _ if value == NO_PIN => {}
            _ => self.import.leave(&entry, OF_THE_BOARD),
        }
    }

    fn take_seconds(&mut self, key: Key, milliseconds: &str, entry: &FileEntry) {
        match number(milliseconds) {
            Some(value) => self.import.take(key.number(), Decimal(value.0 / 1000), entry),
            None => self.import.leave(entry, "no number"),
        }
    }

    /// Imports the limits of the spindle speed from a speed map such as `0=0.000% 1000=100.000%`.
    fn speeds(&mut self, map: &str, entry: &FileEntry) {
        let point = |text: &str| {
            let (speed, part) = text.split_once('=')?;
            number(speed).zip(number(part.trim_end_matches('%')))
        };
        let points: Option<Vec<_>> = map.split([' ', ';']).filter(|text| !text.is_empty()).map(point).collect();
        // The speeds of a map may be in falling order.
        let by_speed = |points: &Vec<(Decimal, Decimal)>| {
            let least = points.iter().min_by_key(|(speed, _)| speed.0)?;
            Some((*least, *points.iter().max_by_key(|(speed, _)| speed.0)?))
        };
        let Some(((first, least), (last, most))) = points.as_ref().and_then(by_speed) else {
            return self.import.leave(entry, "not of the form speed=percent");
        };
        self.import.take(Key::SpindleMinimum.number(), first, entry);
        self.import.take(Key::SpindleMaximum.number(), last, entry);
        let is_line = points.is_some_and(|points| points.len() <= 2) && least == Decimal::ZERO;
        if !is_line || most != Decimal::from_int(100) {
            self.import.leave(entry, "only its least and greatest speed: the PWM is in proportion to S");
        }
    }

    /// Lists an entry without a counterpart in Oxmill as not taken, with the reason. Ignores a pin that is not
    /// connected.
    fn other(&mut self, keys: &[&str], value: &str, entry: FileEntry) {
        if value == NO_PIN {
            return;
        }
        let why = match *keys {
            ["name" | "board" | "meta" | "note"] => "a description",
            ["stepping", "disable_delay_us"] => "drivers stay on while motors move",
            ["stepping", ..] => "the board's own timers make the steps",
            ["start", "must_home"] => "with $22=1 a machine starts locked",
            ["probe", ..] => "the board's pin; $6 inverts it",
            ["control", ..] => "the board's pin; $14 inverts it",
            ["macros", name] if name.starts_with("startup_line") => "send it as $N0= or $N1=",
            ["macros", ..] => "send it as $M0= and on, in lines of G-code",
            [spindle, ..] if BUS_SPINDLES.iter().any(|name| name.eq_ignore_ascii_case(spindle)) => {
                "no spindle on a serial bus"
            }
            _ => OF_THE_BOARD,
        };
        self.import.leave(&entry, why);
    }

    /// Adds the settings that result from several entries together. Returns the complete import.
    fn finish(mut self) -> Import {
        let machine = std::mem::take(&mut self.machine);
        let is_homed = self.homing_cycles(&machine);
        self.limits(&machine.soft_limits, Key::SoftLimits, is_homed);
        self.limits(&machine.hard_limits, Key::HardLimits, true);
        self.second_motor(&machine);
        // A mask of 0 also becomes a setting, because the machine may have another mask stored.
        let of_first = machine.directions.iter().filter(|(_, motor, ..)| *motor == 0);
        let directions: Vec<_> = of_first.map(|(axis, _, is_low, entry)| (*axis, *is_low, entry)).collect();
        self.mask(Key::DirectionInvert, &directions);
        self.mask(
            Key::StepInvert,
            &machine.steps.iter().map(|(axis, low, entry)| (*axis, *low, entry)).collect::<Vec<_>>(),
        );
        if let Some(entry) = &machine.a {
            self.import.take(Key::Axes.number(), decimal(LINEAR as u32 + 1), entry);
        }
        self.import.finish()
    }

    /// Imports a mask. `axes`: the axes of the mask, each with `true` if its bit is set, and with its entry in the
    /// file. Does nothing if `axes` is empty. The report shows the mask with the entry of the first axis whose bit is
    /// set, or with the first entry if no bit is set.
    fn mask(&mut self, key: Key, axes: &[(Axis, bool, &FileEntry)]) {
        if let Some((_, _, entry)) = axes.iter().find(|(_, is_set, _)| *is_set).or(axes.first()) {
            let bits = axes.iter().filter(|(_, is_set, _)| *is_set).fold(0, |mask, (axis, ..)| mask | bit(*axis));
            self.import.take(key.number(), decimal(bits), entry);
        }
    }

    /// Imports the homing settings: on or off (`$22`), the axes of each cycle, and the directions. Returns whether any
    /// axis is homed.
    fn homing_cycles(&mut self, machine: &ConfiguredMachine) -> bool {
        let Some((_, _, first)) = machine.cycles.first() else { return false };
        let mut order: Vec<i32> =
            machine.cycles.iter().map(|(_, cycle, _)| *cycle).filter(|cycle| *cycle > 0).collect();
        order.sort_unstable();
        order.dedup();
        self.import.take(Key::Homing.number(), decimal((!order.is_empty()).into()), first);
        if order.is_empty() {
            return false;
        }
        for index in 0..order.len().max(LINEAR) {
            let in_cycle = |(_, cycle, _): &&(Axis, i32, FileEntry)| order.get(index) == Some(cycle);
            let axes: Vec<_> = machine.cycles.iter().filter(in_cycle).collect();
            let mask = axes.iter().fold(0, |mask, (axis, ..)| mask | bit(*axis));
            let entry = axes.first().map_or(first, |(.., entry)| entry);
            self.import.take(AxisKey::HomingCycle.number() + index as u16, decimal(mask), entry);
        }
        let to_negative: Vec<_> = machine.to_negative.iter().map(|(axis, entry)| (*axis, true, entry)).collect();
        self.mask(Key::HomingDirection, &to_negative);
        if to_negative.is_empty() {
            self.import.take(Key::HomingDirection.number(), decimal(0), first);
        }
        let at_zero = machine.place.iter().all(|(place, _)| *place == Decimal::ZERO);
        for (index, (place, entry)) in machine.place.iter().enumerate() {
            if at_zero && index == 0 {
                self.import.take(Key::ZeroAtPullOff.number(), decimal(1), entry);
            } else if *place != Decimal::ZERO {
                self.import.leave(entry, "after homing an axis is at its end, or at 0 with $932=1");
            } else if !at_zero {
                self.import.leave(entry, "$932=1 would be for all axes");
            }
        }
        true
    }

    /// Imports soft or hard limits. FluidNC enables them for each axis, Oxmill by one setting for all axes.
    /// `is_possible`: `false` for soft limits without homing. Limits that are on in the file are then listed as not
    /// taken.
    fn limits(&mut self, axes: &[(bool, FileEntry)], key: Key, is_possible: bool) {
        let is_on = is_possible && axes.iter().any(|(on, _)| *on);
        for (index, (on, entry)) in axes.iter().enumerate() {
            if !is_possible && *on {
                self.import.leave(entry, "soft limits need homing");
            } else if index == 0 {
                self.import.take(key.number(), decimal(is_on.into()), entry);
            }
            if is_on && !on {
                self.import.leave(entry, format!("one switch for all axes: ${}=1", key.number()));
            }
        }
    }

    /// Imports the second motor of an axis: which axis has one, whether its direction is inverted, and whether it has
    /// its own switch. Second motors of further axes are listed as not taken.
    fn second_motor(&mut self, machine: &ConfiguredMachine) {
        let mut ganged = None;
        for (axis, entry) in &machine.second_motors {
            match axis {
                Axis::X | Axis::Y if machine.core_xy => {
                    self.import.leave(entry, "CoreXY moves X and Y with one motor each");
                }
                _ if machine.a.is_some() || axis.is_rotary() => {
                    self.import.leave(entry, "A has the fourth driver");
                }
                _ if ganged.is_some() => self.import.leave(entry, "one axis has a second motor"),
                _ => {
                    ganged = Some(*axis);
                    self.import.take(Key::GangedAxis.number(), decimal(axis.index() as u32 + 1), entry);
                }
            }
        }
        let is_low = |axis: &Axis, of: usize| {
            let found = machine.directions.iter().find(|(other, motor, ..)| other == axis && *motor == of);
            found.is_some_and(|(_, _, is_low, _)| *is_low)
        };
        for (axis, motor, _, entry) in machine.directions.iter().filter(|(_, motor, ..)| *motor == 1) {
            if ganged == Some(*axis) {
                let is_inverted = is_low(axis, *motor) != is_low(axis, 0);
                self.import.take(Key::GangedInvert.number(), decimal(is_inverted.into()), entry);
            } else {
                self.import.leave(entry, OF_THE_BOARD);
            }
        }
        for (axis, entry) in &machine.second_switches {
            if ganged == Some(*axis) {
                self.import.take(Key::GangedSwitch.number(), decimal(1), entry);
            } else {
                self.import.leave(entry, OF_THE_BOARD);
            }
        }
    }
}

fn bit(axis: Axis) -> u32 {
    1 << axis.index()
}

/// Returns whether a pin is active when low.
fn is_low(pin: &str) -> bool {
    pin.split(':').any(|part| part.eq_ignore_ascii_case("low"))
}

fn switch(value: &str) -> Option<bool> {
    match value {
        _ if value.eq_ignore_ascii_case("true") => Some(true),
        _ if value.eq_ignore_ascii_case("false") => Some(false),
        _ => None,
    }
}
