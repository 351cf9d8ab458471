//! Runs a conversation with the real controller and the reference model side by side.

use super::action::{Action, PINS, Setup};
use super::reference::{MANY, Model};
use oxmill_simulator::{Options, Simulator};
use oxmill_test_support::numbers;
use std::cell::RefCell;
use std::collections::BTreeMap;
use std::fmt::Write;
use std::time::Duration;

thread_local! {
    /// Machines after their setup: copying one is cheaper than starting again.
    static STARTED: RefCell<Vec<(Setup, Talk)>> = const { RefCell::new(Vec::new()) };
}

/// The controller in the simulator, and the conversation so far in the format of `tests/conversations`.
#[derive(Clone)]
struct Talk {
    mill: Simulator,
    text: String,
}

/// What a host can observe of an action: the lines that the machine sends, its status report, and whether it makes
/// steps.
struct Seen {
    said: Vec<String>,
    report: String,
    stepped: bool,
}

impl Talk {
    fn started(setup: Setup) -> Talk {
        STARTED.with_borrow_mut(|started| {
            if let Some((_, talk)) = started.iter().find(|(known, _)| *known == setup) {
                return talk.clone();
            }
            let talk = Talk::new(setup);
            started.push((setup, talk.clone()));
            talk
        })
    }

    fn new(setup: Setup) -> Talk {
        let mill = Simulator::new(Options { keep_steps: true, ..Options::default() });
        let mut talk = Talk { mill, text: String::new() };
        let greeting = talk.mill.take_output();
        talk.note_answers(&greeting);
        assert_eq!(talk.mill.pin_line("at_speed 1"), "ok");
        talk.text.push_str("pin at_speed 1\n");
        for line in setup.settings() {
            writeln!(talk.text, "-> {line}").expect("text");
            talk.mill.send(format!("{line}\n"));
            let said = talk.mill.take_output();
            assert_eq!(said, "ok\r\n", "{line}");
            talk.note_answers(&said);
        }
        talk
    }

    fn note_answers(&mut self, said: &str) {
        for line in said.split_terminator("\r\n") {
            writeln!(self.text, "<- {line}").expect("text");
        }
    }

    fn act(&mut self, action: &Action) -> Seen {
        let before = self.mill.machine().pulses();
        match action {
            Action::Line(line) => self.mill.send(format!("{}\n", line.text())),
            Action::Byte(byte) => self.mill.send([*byte]),
            Action::Pin(pin, on) => {
                let line = format!("{} {}", PINS[pin.index()].2, u8::from(*on));
                assert_eq!(self.mill.pin_line(&line), "ok", "{line}");
            }
            Action::Pass(seconds) => self.mill.run_for(Duration::from_secs_f64(*seconds)),
            Action::Absent(seconds) => {
                self.mill.disconnect();
                self.mill.run_for(Duration::from_secs_f64(*seconds));
                self.mill.take_output();
                self.mill.connect();
            }
            Action::SlowSpindle(seconds) => {
                assert_eq!(self.mill.pin_line("at_speed 0"), "ok");
                self.mill.run_for(Duration::from_secs_f64(*seconds));
                assert_eq!(self.mill.pin_line("at_speed 1"), "ok");
            }
        }
        let said = self.mill.take_output();
        self.mill.send("?");
        let report = self.mill.take_output();
        Seen {
            said: said.split_terminator("\r\n").map(str::to_string).collect(),
            report: report.trim_end().to_string(),
            stepped: self.mill.machine().pulses() != before,
        }
    }
}

impl Seen {
    fn state(&self) -> &str {
        self.report.trim_matches(['<', '>']).split('|').next().unwrap_or_default()
    }

    /// Returns the reported machine position, mm.
    fn place(&self) -> [f64; 3] {
        numbers(&self.report, "MPos").unwrap_or_else(|| panic!("no MPos in {}", self.report))
    }

    fn field(&self, name: &str) -> Option<&str> {
        self.report.trim_matches(['<', '>']).split('|').find_map(|field| field.strip_prefix(name)?.strip_prefix(':'))
    }

    /// Compares what the machine did with the model. At the first difference, returns what the model expects; `None` if
    /// both agree.
    fn differs(&self, model: &Model) -> Option<String> {
        if !is_said(&model.said, &self.said, !model.setup.grbl) {
            return Some(format!("the answers {:?}", model.said));
        }
        if self.state() != model.state() {
            return Some(format!("the state {}", model.state()));
        }
        if self.stepped && !model.may_step {
            return Some("no step".into());
        }
        if !self.stepped && model.must_step {
            return Some("steps".into());
        }
        let (pins, speed) = (model.reported_pins(), model.spindle_speed().to_string());
        if self.field("Pn").unwrap_or_default() != pins {
            return Some(format!("Pn:{pins}"));
        }
        if self.field("FS").and_then(|text| text.split(',').nth(1)) != Some(&speed) {
            return Some(format!("the spindle speed {speed}"));
        }
        if let Some(found) = self.field("Ov") {
            let overrides = model.overrides().map(|percent| percent.to_string()).join(",");
            if found != overrides || self.field("A").unwrap_or_default() != model.accessories() {
                return Some(format!("Ov:{overrides}|A:{}", model.accessories()));
            }
        }
        let found = self.place();
        let place = model.place()?;
        let rests = (0..3).all(|axis| place[axis].is_none_or(|mm| (mm - found[axis]).abs() < 0.0021));
        (!rests).then(|| format!("the place {place:?}"))
    }
}

/// Returns whether lines match a list of patterns. `*` stands for any text. [`MANY`] stands for any number of lines
/// that are not answers. `reasons`: `true` if a message with the reason may precede an error; this message has no
/// pattern.
fn is_said(patterns: &[String], lines: &[String], reasons: bool) -> bool {
    let Some((pattern, rest)) = patterns.split_first() else { return lines.is_empty() };
    if pattern == MANY {
        let end = lines.iter().position(|line| line == "ok" || line.starts_with("error:")).unwrap_or(lines.len());
        return is_said(rest, &lines[end..], reasons);
    }
    let Some((line, others)) = lines.split_first() else { return false };
    if reasons && pattern.starts_with("error:") && line.starts_with("[MSG:") {
        return others.first().is_some_and(|line| is_line(pattern, line)) && is_said(rest, &others[1..], reasons);
    }
    is_line(pattern, line) && is_said(rest, others, reasons)
}

fn is_line(pattern: &str, line: &str) -> bool {
    match pattern.split_once('*') {
        None => line == pattern,
        Some((head, rest)) => line.strip_prefix(head).is_some_and(|line| {
            line.char_indices().map(|(at, _)| at).chain([line.len()]).any(|at| is_line(rest, &line[at..]))
        }),
    }
}

/// Number of times that each state has been reported after an action.
pub type States = BTreeMap<String, u64>;

/// Plays a conversation with a machine of `setup` and with a reference model that is built for the setup `told`. The
/// two setups differ only where a test checks that a disagreement is found. Returns the states that were reported, or
/// the disagreement.
pub fn play(setup: Setup, told: Setup, actions: &[Action]) -> Result<States, String> {
    let mut talk = Talk::started(setup);
    let mut models = vec![Model::new(told)];
    let mut states = States::new();
    for action in actions {
        if !models.iter().all(|model| model.is_sensible(action)) {
            continue;
        }
        writeln!(talk.text, "{}", action.text()).expect("text");
        let seen = talk.act(action);
        let mut faults = Vec::new();
        let mut agree: Vec<Model> = Vec::new();
        for mut model in models.iter().flat_map(|model| model.act(action)) {
            if let Some(fault) = seen.differs(&model) {
                faults.push((fault, model));
                continue;
            }
            model.adopt(seen.place(), seen.stepped);
            if !agree.contains(&model) {
                agree.push(model);
            }
        }
        if agree.is_empty() {
            return Err(disagreement(&talk.text, &seen, &faults));
        }
        models = agree;
        *states.entry(seen.state().to_string()).or_default() += 1;
        talk.note_answers(&seen.said.join("\r\n"));
        writeln!(talk.text, "=> ?\n<- {}", seen.report).expect("text");
    }
    Ok(states)
}

/// Returns the conversation up to the disagreement, with what the model expects there.
fn disagreement(text: &str, seen: &Seen, faults: &[(String, Model)]) -> String {
    let stepped = if seen.stepped { "steps came" } else { "no step came" };
    let mut text = format!("# The controller and the reference of its protocol disagree.\n{text}");
    writeln!(text, "# It says {:?} and reports {}, {stepped}.", seen.said, seen.report).expect("text");
    for (fault, _) in faults {
        writeln!(text, "# The reference expects {fault}.").expect("text");
    }
    if let Some((_, model)) = faults.last() {
        for line in &model.said {
            writeln!(text, "<- {line}").expect("text");
        }
        writeln!(text, "=> ?\n<- <{}|*", model.state()).expect("text");
    }
    text
}
