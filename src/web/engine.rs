//! The functions of the WebAssembly module, with Rust types instead of pointers. Each works on an [`Order`], which the
//! caller sends as JSON. For example, `check` and `stream` run a job, and `turn` advances a machine by microseconds.

use oxmill_controller::axes::LINEAR;
use oxmill_controller::error::{Alarm, Error};
use oxmill_controller::protocol::descriptions;
use oxmill_controller::protocol::text::Text;
use oxmill_controller::settings::{Kind, Row, Settings, lines};
use oxmill_controller::units::{Coordinate, Decimal};
use oxmill_simulator::boards::{self, AXES, Board};
use oxmill_simulator::check::Check;
use oxmill_simulator::file_kind;
use oxmill_simulator::fittings::Description;
use oxmill_simulator::homed::home;
use oxmill_simulator::machine::linear;
use oxmill_simulator::path::{Drawing, Point};
use oxmill_simulator::power_up::{Dialect, apply_setting, board_named};
use oxmill_simulator::resume::{self, Begin, ResumeRequest, SPIN_UP, number_of};
use oxmill_simulator::streaming::Streaming;
use oxmill_simulator::{Fittings, JobText, Options, Simulator, Store, advice, explain};
use serde::Deserialize;
use serde_json::{Number, Value, json};
use std::collections::BTreeMap;
use std::io::Cursor;
use std::time::Duration;

/// A request for a simulation, which the module's caller sends as JSON.
#[derive(Debug, Default, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Order {
    /// Name of the job, for its summary.
    pub name: String,
    /// Name of the board; default: `desk`.
    pub board: Option<String>,
    /// Name of the dialect: `grbl`, `oxmill`, `seed` or `grblhal`. If it is missing, the setting keeps its value.
    pub dialect: Option<String>,
    /// Numbers of settings and their values.
    pub settings: BTreeMap<u16, Number>,
    /// `true` to record the path of the job, for [`rows`].
    pub path: bool,
    /// The machine's hardware, with the fields of a file for `--machine`.
    pub machine: Option<Description>,
    /// Work zero of G54 in mm of machine coordinates. If it is given, the machine is homed before its job; otherwise it
    /// is not homed. For [`check`] and [`stream`] only.
    pub work_zero: Option<[f64; LINEAR]>,
    /// Lines that the machine executes before its job, to set its offsets and tools, such as `G10 L1 P1 Z12.5`. For
    /// [`check`] and [`stream`] only.
    pub stored: Vec<String>,
    /// Where to resume an interrupted job. For [`resume()`] only.
    pub resume: Option<Resume>,
    /// Bits per second of the link over which a job is sent; 0 for an unlimited link. For [`stream`] only.
    pub baud: u32,
}

/// Where a job is resumed, like the options of `oxmill resume`.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Resume {
    /// The line of the file at which the job is resumed, from 1.
    pub line: u64,
    /// Z at which the tool travels to the position at which the job is resumed, in mm of program coordinates.
    pub clearance: Option<f64>,
    /// Feed rate of the move from this Z down to that position, in mm/min.
    pub plunge: Option<f64>,
    /// Spin-up time of the spindle, in seconds.
    #[serde(default = "spin_up")]
    pub spin_up: u16,
}

const fn spin_up() -> u16 {
    SPIN_UP
}

/// Splits an input at its first 0 byte into an [`Order`] in JSON and the job.
///
/// # Errors
/// If the order is not valid JSON of this form.
pub fn parse(input: &[u8]) -> Result<(Order, &[u8]), String> {
    let end = input.iter().position(|byte| *byte == 0).unwrap_or(input.len());
    let (order, job) = input.split_at(end);
    let order = serde_json::from_slice(order).map_err(|error| format!("the order is not understood: {error}"))?;
    Ok((order, job.get(1..).unwrap_or_default()))
}

/// Returns an idle simulator with the board, machine, settings and dialect of the order.
///
/// # Errors
/// If the board or dialect does not exist, if the description of the machine is invalid, or if a setting is rejected.
pub fn power_up(order: &Order) -> Result<Simulator, String> {
    let board: Board = order.board.as_deref().map_or(Ok(boards::DESK), board_named)?;
    let fittings = order.machine.clone().map_or_else(|| Ok(Fittings::default()), Fittings::new);
    let fittings = fittings.map_err(|error| format!("the machine is not understood: {error:#}"))?;
    let mut simulator = Simulator::new(Options { board, store: Store::in_memory(), fittings, keep_steps: false });
    simulator.run_until_idle();
    // The dialect determines which values other settings accept. So settings that are rejected before the dialect is
    // set are tried again afterwards.
    let mut refused = Vec::new();
    for (number, value) in &order.settings {
        let setting = format!("{number}={value}");
        if apply_setting(&mut simulator, &setting).is_err() {
            refused.push(setting);
        }
    }
    if let Some(name) = &order.dialect {
        let dialect = Dialect::by_name(name).ok_or_else(|| format!("there is no dialect `{name}`"))?;
        apply_setting(&mut simulator, &dialect.assignment()).map_err(|why| format!("the dialect {why}"))?;
    }
    for setting in refused {
        apply_setting(&mut simulator, &setting).map_err(|why| format!("${setting} {why}"))?;
    }
    Ok(simulator)
}

/// Like [`power_up`], but then homes the machine if the order has a work zero, and sends it the lines of `stored`.
fn power_up_for_job(order: &Order) -> Result<Simulator, String> {
    let mut simulator = power_up(order)?;
    if let Some(place) = order.work_zero {
        home(&mut simulator, place).map_err(|why| format!("the work zero: {why}"))?;
    }
    simulator.take_output();
    for line in &order.stored {
        simulator.send(format!("{line}\n"));
        simulator.run_until_idle();
        let output = simulator.take_output();
        if let Some(error) = output.lines().find(|answer| answer.starts_with("error:")) {
            return Err(format!("{line}: {error}"));
        }
    }
    Ok(simulator)
}

/// Prepares the check of a job.
///
/// # Errors
/// As [`power_up`], or if the job is not text, the machine cannot be homed for a work zero, or a line of `stored` is
/// rejected.
pub fn check(order: &Order, job: &[u8]) -> Result<Check, String> {
    file_kind::refuse(job, true).map_err(|why| format!("the job is not read: {why}"))?;
    let mut simulator = power_up_for_job(order)?;
    if order.path {
        let start = simulator.meter().millimetres(simulator.machine().motors());
        let seconds = simulator.clock().seconds(simulator.clock().now());
        simulator.meter_mut().draw(Drawing::new(linear(start), seconds));
    }
    Ok(Check::new(simulator, JobText::new(Cursor::new(job.to_vec()))))
}

/// Prepares sending a job twice: over an unlimited link, and over a link with the order's `baud`.
///
/// # Errors
/// As [`check`], but a job that is not text is accepted.
pub fn stream(order: &Order, job: &[u8]) -> Result<[Streaming; 2], String> {
    Ok([Streaming::new(power_up_for_job(order)?, job, 0), Streaming::new(power_up_for_job(order)?, job, order.baud)])
}

/// Returns the rest of a job as JSON: the program, the line number in the file at which the rest begins, the number of
/// lines of the file, and the prologue.
///
/// # Errors
/// As [`power_up`], or if the order does not say where to resume, or if the job cannot be resumed there.
pub fn resume(order: &Order, job: &[u8]) -> Result<Value, String> {
    file_kind::refuse(job, true).map_err(|why| format!("the job is not read: {why}"))?;
    let wanted = order.resume.as_ref().ok_or("the order does not say where the rest of the job begins")?;
    let number = |value: Option<f64>, what: &str| match value.map(number_of) {
        Some(None) => Err(format!("the {what} is not a number that the machine can have")),
        other => Ok(other.flatten()),
    };
    let plunge = number(wanted.plunge, "plunge feed")?;
    let clearance = number(wanted.clearance, "clearance")?.map(Coordinate);
    let begin = Begin::Line(wanted.line);
    let request = ResumeRequest { begin, clearance, plunge: plunge.map(Decimal), spin_up: wanted.spin_up };
    let rest = resume::resume(&power_up(order)?, &order.name, job, &request)?;
    let program = String::from_utf8_lossy(&rest.program);
    Ok(json!({ "program": program, "line": rest.line, "lines": rest.lines, "prologue": rest.prologue }))
}

/// Returns a machine with the settings of the order. First stores the settings, switches the machine off and on, and
/// connects a host.
///
/// # Errors
/// As [`power_up`].
pub fn machine(order: &Order) -> Result<Simulator, String> {
    let mut simulator = power_up(order)?.powered_again().map_err(|error| format!("{error:#}"))?;
    simulator.take_output();
    simulator.connect();
    Ok(simulator)
}

/// Sends bytes to a machine, advances time by microseconds, and returns the machine's output.
pub fn turn(machine: &mut Simulator, bytes: &[u8], microseconds: u32) -> String {
    if !bytes.is_empty() {
        machine.send(bytes);
    }
    machine.run_for(Duration::from_micros(u64::from(microseconds)));
    machine.take_output()
}

/// Number of values per row of the path: x, y, z in mm of machine coordinates, speed in mm/s, start and end in seconds
/// from the start of the job.
pub const ROW: usize = 6;
/// The bit of a row's line number that marks a rapid.
pub const RAPID: u32 = 1 << 31;
/// The bit of a row's line number that marks an arc.
pub const ARC: u32 = 1 << 30;

/// Returns the path of a job as rows of [`ROW`] numbers, and for each row: its line of the file with [`RAPID`] and
/// [`ARC`], its tool, and its S (0 while the spindle is off). The first row is the start.
pub fn rows(check: &Check) -> (Vec<f32>, Vec<u32>, Vec<u32>, Vec<u32>) {
    let simulator = check.simulator();
    let points = simulator.meter().drawing().map_or(&[][..], Drawing::points);
    // The points of the path are relative to the position at power-up. If the machine was homed, the machine
    // coordinates of that position are not 0, so add them.
    let here = simulator.machine_place();
    let counted = simulator.meter().millimetres(simulator.machine().motors());
    let row = |point: &Point| {
        let [x, y, z]: [f32; LINEAR] = std::array::from_fn(|axis| point.at[axis] + (here[axis] - counted[axis]) as f32);
        [x, y, z, point.speed, point.seconds[0] as f32, point.seconds[1] as f32]
    };
    let line = |point: &Point| {
        let line = simulator.job().map_or(0, |job| job.file_line(point.mark.line));
        let kind = if point.rapid {
            RAPID
        } else if point.mark.arc {
            ARC
        } else {
            0
        };
        u32::try_from(line).unwrap_or(0) & (ARC - 1) | kind
    };
    let tools = points.iter().map(|point| point.mark.tool).collect();
    let speeds = points.iter().map(|point| point.mark.speed).collect();
    (points.iter().flat_map(row).collect(), points.iter().map(line).collect(), tools, speeds)
}

/// Returns everything that a user interface needs about the firmware: boards, settings, errors and alarms.
pub fn describe() -> Value {
    let board = |board: &Board| {
        json!({ "name": board.name, "step_clock_hz": board.step_clock_hz, "safe_step_hz": board.safe_step_hz,
            "blocks": board.blocks, "received_bytes": board.received_bytes })
    };
    let errors: Vec<Value> = Error::ALL
        .iter()
        .map(|e| json!({ "code": e.code(), "text": e.text(), "advice": advice::for_error(*e) }))
        .collect();
    let alarms: Vec<Value> = Alarm::ALL
        .iter()
        .map(|a| json!({ "code": a.code(), "text": a.text(), "advice": advice::for_alarm(*a) }))
        .collect();
    let settings = Settings::<AXES>::default();
    let rows: Vec<Value> = (0..lines(AXES))
        .filter_map(|line| Settings::<AXES>::described(line, AXES))
        .map(|row| setting(&row, &settings))
        .collect();
    json!({ "version": env!("CARGO_PKG_VERSION"), "boards": boards::ALL.iter().map(board).collect::<Vec<_>>(),
        "settings": rows, "errors": errors, "alarms": alarms })
}

/// Returns a row of the table of settings as JSON, with the default of a new controller.
fn setting(row: &Row, settings: &Settings<AXES>) -> Value {
    let (kind, min, max) = match row.entry.kind {
        Kind::Whole(min, max) => ("whole", Some(json!(min)), Some(json!(max))),
        Kind::Tenths(min, max) => ("tenths", Some(json!(f64::from(min) / 10.0)), Some(json!(f64::from(max) / 10.0))),
        Kind::Mask(bits) => ("mask", Some(json!(0)), Some(json!(bits))),
        Kind::Switch => ("switch", Some(json!(0)), Some(json!(1))),
        Kind::Axes => ("axes", Some(json!(0)), Some(json!((1 << AXES) - 1))),
        Kind::Real | Kind::Speed => ("real", Some(json!(0)), None),
        Kind::Place => ("place", None, None),
    };
    let (mut name, mut values) = (Text::new(), Text::new());
    descriptions::name(&mut name, row);
    descriptions::values(&mut values, &row.entry, &row.description);
    let default = settings.by_number(row.number).unwrap_or_default();
    json!({ "number": row.number, "name": String::from_utf8_lossy(&name), "unit": row.description.unit, "kind": kind,
        "min": min, "max": max, "values": String::from_utf8_lossy(&values),
        // Convert the `f32` to text and then to `f64`. A direct conversion would show the `f32` 0.01 as
        // 0.00999999977...
        "default": default.to_string().parse::<f64>().unwrap_or_default(), "grbl": row.entry.grbl,
        "explanation": explain::setting(row.number), "title": row.description.name, "group": row.description.group.text(),
        "labels": row.description.labels.split(',').filter(|label| !label.is_empty()).collect::<Vec<_>>(),
        "axis": row.axis.map(|axis| format!("{axis:?}")) })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_order_and_its_job_come_apart() {
        let (order, job) = parse(b"{\"board\":\"desk\",\"settings\":{\"110\":5000,\"11\":0.02}}\0G0 X1\n").unwrap();
        assert_eq!((order.board.as_deref(), job), (Some("desk"), &b"G0 X1\n"[..]));
        assert_eq!(order.settings[&11].to_string(), "0.02");
        assert!(parse(b"{\"bored\":1}").is_err());
        assert_eq!(parse(b"{}").unwrap().1, b"");
    }

    #[test]
    fn refusals_say_why() {
        let refused = |text: &str| power_up(&parse(text.as_bytes()).unwrap().0).err().unwrap();
        assert!(refused(r#"{"board":"toaster"}"#).contains("blackpill_f411"));
        assert!(refused(r#"{"settings":{"7":1}}"#).starts_with("$7=1 was refused with error:3"));
        assert!(refused(r#"{"dialect":"x"}"#).contains("no dialect"));
        let plate = r#"{"machine":{"steps_per_mm":[1,1,1],"plate":{"axis":"q","at_mm":1,"side":"negative"}}}"#;
        assert!(refused(plate).contains("not an axis"));
    }

    #[test]
    fn a_machine_with_homing_is_locked_until_it_is_unlocked() {
        let mut machine = machine(&parse(br#"{"settings":{"22":1,"100":80}}"#).unwrap().0).unwrap();
        assert_eq!(machine.take_output(), "\r\nGrbl 1.1h ['$' for help]\r\n[MSG:'$H'|'$X' to unlock]\r\n");
        assert!(turn(&mut machine, b"?", 100_000).starts_with("<Alarm|"));
        assert!(turn(&mut machine, b"$X\n", 100_000).ends_with("ok\r\n"));
        assert!(turn(&mut machine, b"?", 100_000).starts_with("<Idle|"));
    }

    #[test]
    fn rows_have_lines_and_times() {
        let (order, job) = parse(b"{\"path\":true}\0%\nG21 G91 F600\n\nG0 X1\nG4 P1\nG2 X2 I1\n").unwrap();
        let mut check = check(&order, job).unwrap();
        while !check.advance(1000) {}
        let (rows, lines, tools, speeds) = rows(&check);
        let rows = rows.as_chunks::<ROW>().0;
        assert_eq!(rows.len(), lines.len());
        assert_eq!(rows[0][..3], [0.0; 3]);
        assert!(speeds.iter().all(|speed| *speed == 0));
        assert!(lines[1..].iter().all(|line| [4 | RAPID, 6 | ARC].contains(line)), "{lines:?}");
        assert!(lines.contains(&(4 | RAPID)) && lines.contains(&(6 | ARC)) && tools.iter().all(|tool| *tool == 0));
        assert!(rows.windows(2).all(|pair| pair[1][4] >= pair[0][5] - 1e-5 && pair[1][5] > pair[1][4]));
        let arc = lines.iter().position(|line| *line == 6 | ARC).unwrap();
        assert!(rows[arc][4] > rows[arc - 1][5] + 0.9, "the dwell lies between");
        let last = rows[rows.len() - 1];
        assert!((last[0] - 3.0).abs() < 1e-3 && last[1].abs() < 1e-3, "{last:?}");
        let seconds = check.summary("", 0.0).forecast_s;
        assert!((f64::from(last[5]) - seconds).abs() < 0.01, "{last:?} {seconds}");
    }

    #[test]
    fn rows_have_the_speed_of_the_spindle() {
        let (order, job) =
            parse(b"{\"path\":true}\0G21 G91 F600\nG1 X1\nM3 S500\nG1 X1\nS250\nG1 X1\nM5\nG1 X1\n").unwrap();
        let mut check = check(&order, job).unwrap();
        while !check.advance(1000) {}
        let (_, lines, _, speeds) = rows(&check);
        for (line, speed) in lines.iter().zip(&speeds).skip(1) {
            assert_eq!(*speed, [0, 500, 250, 0][(*line as usize - 2) / 2], "line {line}");
        }
    }

    #[test]
    fn a_job_finds_the_tools_of_the_machine() {
        let errors = |stored: &str| {
            let input = format!("{{\"stored\":[{stored}]}}\0G21 G90\nG43 H5\nG0 Z1\n");
            let (order, job) = parse(input.as_bytes()).unwrap();
            let mut check = check(&order, job)?;
            while !check.advance(1000) {}
            Ok::<_, String>(check.summary("", 0.0).errors.len())
        };
        assert_eq!(errors("\"G10 L1 P4 Z12.5\""), Ok(1));
        assert_eq!(errors("\"G10 L1 P5 Z12.5\""), Ok(0));
        assert_eq!(errors("\"G999\""), Err("G999: error:20".into()));
    }

    /// The firmware merges short moves of several lines, unless the lines have different N words. To record the path,
    /// each move gets the number of its line. This must not change which moves are merged.
    #[test]
    fn a_path_changes_nothing_of_the_job() {
        let short: String = (1..400).map(|i| format!("G1 X{}\n", f64::from(i) * 0.003)).collect();
        let numbered: String = (1..400).map(|i| format!("N{i} G1 X{}\n", f64::from(i) * 0.003)).collect();
        for text in [short, numbered] {
            let hash = |path: bool| {
                let order = Order { path, ..Order::default() };
                let mut check = check(&order, format!("G21 F300\n{text}").as_bytes()).unwrap();
                while !check.advance(1000) {}
                check.summary("", 0.0)
            };
            assert_eq!(hash(true), hash(false));
            assert!(hash(true).is_good());
        }
    }

    #[test]
    fn the_description_has_every_setting_with_its_axis() {
        let description = describe();
        let settings = description["settings"].as_array().unwrap();
        let row = |number: u16| settings.iter().find(|row| row["number"] == number).unwrap();
        assert_eq!(row(121)["axis"], "Y");
        assert_eq!((&row(11)["unit"], &row(11)["default"]), (&json!("mm"), &json!(0.01)));
        assert!(row(11)["axis"].is_null());
        assert_eq!(
            (&row(120)["title"], &row(121)["title"], &row(121)["group"]),
            (&json!("Acceleration"), &json!("Acceleration"), &json!("Axes"))
        );
        assert_eq!(row(900)["labels"][1], "Oxmill");
        assert_eq!(settings.len(), lines(AXES));
        assert!(description["errors"].as_array().unwrap().len() > 50);
    }
}
