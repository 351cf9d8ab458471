//! Allowed differences that are due to wall time: a recording was made in real time, by a host whose pauses are not
//! known to the millisecond.

/// Returns whether two answers are equal apart from timing. Each rule is for one kind of line and as narrow as
/// possible. `stopped`: `true` if the position depends on the moment at which the recording host stopped a move.
pub fn equal(stopped: bool, recorded: &[String], answered: &[String]) -> bool {
    if recorded.len() != answered.len() {
        return false;
    }
    recorded.iter().zip(answered).all(|(a, b)| a == b || build(a, b) || report(stopped, a, b) || touch(a, b))
}

/// Build information (`[VER:..]` and `[OPT:..]`): only the text that the user has stored must be equal; version and
/// buffer sizes differ between the controllers.
fn build(recorded: &str, answered: &str) -> bool {
    let user_text =
        |line: &str| line.strip_prefix("[VER:1.1h.").and_then(|l| l.split_once(':')).map(|(_, t)| t.to_string());
    match (user_text(recorded), user_text(answered)) {
        (Some(a), Some(b)) => a == b,
        _ => recorded.starts_with("[OPT:") && answered.starts_with("[OPT:"),
    }
}

/// The probe position depends on when the pin was moved by hand. A difference of half a millimetre is allowed, which is
/// half a second at the recordings' feed of 60 mm/min.
fn touch(recorded: &str, answered: &str) -> bool {
    match (places(recorded, "[PRB:"), places(answered, "[PRB:")) {
        (Some(a), Some(b)) => recorded.ends_with(":1]") == answered.ends_with(":1]") && near(&a, &b, 0.5),
        _ => false,
    }
}

/// Status reports: state and pins must be equal; buffer sizes differ between the controllers. Other fields:
/// * During motion, or after a stop by the host, positions may differ by a millimetre, and the feed may be anything
///   up to the 500 mm/min of the recorded machine.
/// * In Run, the spindle speed is not compared.
/// * Offset and overrides are compared only if both reports have them. They appear in every few reports, depending on
///   how often the host has polled.
fn report(stopped: bool, recorded: &str, answered: &str) -> bool {
    let (Some(a), Some(b)) = (Report::read(recorded), Report::read(answered)) else { return false };
    let moving = stopped || matches!(a.state.as_str(), "Run" | "Jog" | "Home" | "Hold:1" | "Door:2" | "Door:3");
    a.state == b.state
        && a.machine == b.machine
        && a.pins == b.pins
        && a.buffer.is_some() == b.buffer.is_some()
        && near(&a.place, &b.place, if moving { 1.0 } else { 0.0 })
        && (a.feed == b.feed || (moving && b.feed <= 500.0))
        && (a.speed == b.speed || moving && a.state == "Run")
        && (a.offset == b.offset || a.offset.is_none() || b.offset.is_none())
        && (a.overrides == b.overrides || a.overrides.is_none() || b.overrides.is_none())
}

struct Report {
    state: String,
    machine: bool,
    place: Vec<f64>,
    buffer: Option<String>,
    feed: f64,
    speed: f64,
    pins: String,
    offset: Option<String>,
    overrides: Option<String>,
}

impl Report {
    fn read(line: &str) -> Option<Report> {
        let inner = line.strip_prefix('<')?.strip_suffix('>')?;
        let mut fields = inner.split('|');
        let mut report = Report {
            state: fields.next()?.to_string(),
            machine: false,
            place: Vec::new(),
            buffer: None,
            feed: 0.0,
            speed: 0.0,
            pins: String::new(),
            offset: None,
            overrides: None,
        };
        for field in fields {
            let (name, value) = field.split_once(':')?;
            match name {
                "MPos" | "WPos" => {
                    report.machine = name == "MPos";
                    report.place = numbers(value)?;
                }
                "Bf" => report.buffer = Some(value.to_string()),
                "FS" => [report.feed, report.speed] = numbers(value)?.try_into().ok()?,
                "Pn" => report.pins = value.to_string(),
                "WCO" => report.offset = Some(value.to_string()),
                "Ov" => report.overrides = Some(value.to_string()),
                "A" => report.overrides = report.overrides.map(|o| o + "|" + value),
                _ => return None,
            }
        }
        Some(report)
    }
}

fn numbers(text: &str) -> Option<Vec<f64>> {
    text.split(',').map(|n| n.parse().ok()).collect()
}

fn places(line: &str, head: &str) -> Option<Vec<f64>> {
    let inner = line.strip_prefix(head)?;
    numbers(inner.split(':').next()?)
}

fn near(a: &[f64], b: &[f64], distance: f64) -> bool {
    a.len() == b.len() && a.iter().zip(b).all(|(a, b)| (a - b).abs() <= distance)
}

#[test]
fn rules_are_narrow() {
    let line = |text: &str| vec![text.to_string()];
    let idle = line("<Idle|MPos:1.000,0.000,0.000|FS:0,0>");
    assert!(equal(false, &idle, &line("<Idle|MPos:1.000,0.000,0.000|FS:0,0|WCO:0.000,0.000,0.000>")));
    assert!(!equal(false, &idle, &line("<Idle|MPos:1.001,0.000,0.000|FS:0,0>")));
    assert!(!equal(false, &idle, &line("<Run|MPos:1.000,0.000,0.000|FS:0,0>")));
    assert!(!equal(false, &idle, &line("<Idle|WPos:1.000,0.000,0.000|FS:0,0>")));
    assert!(!equal(false, &line("error:20"), &line("ok")));
    assert!(!equal(false, &line("[G54:0.000,0.000,0.000]"), &line("[G54:0.000,0.000,0.001]")));
    let run = line("<Run|MPos:1.000,0.000,0.000|FS:200,0|Pn:X>");
    assert!(equal(false, &run, &line("<Run|MPos:1.300,0.000,0.000|FS:300,0|Pn:X>")));
    assert!(!equal(false, &run, &line("<Run|MPos:1.300,0.000,0.000|FS:300,0>")));
    let held = line("<Hold:0|MPos:1.000,0.000,0.000|FS:0,0>");
    assert!(!equal(false, &held, &line("<Hold:0|MPos:1.001,0.000,0.000|FS:0,0>")));
    assert!(equal(true, &held, &line("<Hold:0|MPos:1.001,0.000,0.000|FS:0,0>")));
    assert!(!equal(true, &held, &line("<Hold:0|MPos:2.001,0.000,0.000|FS:0,0>")));
}
