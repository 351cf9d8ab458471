//! A whole session in the dialect of grblHAL (`$900=3`), read as the senders gSender and ioSender read it. Each line
//! of the machine must fit one of the patterns that these senders know. What they learn from the lines must be
//! complete and correct.
//!
//! The patterns are taken from the published source of the senders (2026). gSender tries its patterns in a fixed
//! order, and shows a line that fits none of them as text of a terminal. ioSender splits lines at `:` and `|`, and
//! can read only lines of this form.

use super::rig::Rig;
use std::collections::{BTreeMap, BTreeSet};

/// Number of characters that gSender keeps unanswered during a job.
const IN_FLIGHT: usize = 924;
/// Virtual seconds to wait for an answer.
const PATIENCE: f64 = 60.0;

/// What a sender knows about the machine.
#[derive(Default)]
struct Known {
    /// The name of the firmware as the machine sends it in three places: in the greeting, in `[FIRMWARE:..]`, and in a
    /// full status report.
    greeted: String,
    firmware: String,
    reported: String,
    build: u32,
    axes: String,
    /// Fields of `[OPT:..]`.
    options: Vec<String>,
    words: Vec<String>,
    /// `values`: the settings that `$$` lists. `rows`: the rows that `$ES` lists. `details`: numbers of the settings
    /// for which `$ESH` has a row.
    values: BTreeMap<u16, f64>,
    rows: BTreeMap<u16, Vec<String>>,
    details: BTreeSet<u16>,
    groups: BTreeSet<u8>,
    alarms: BTreeMap<u8, String>,
    errors: BTreeMap<u8, String>,
    spindles: Vec<Vec<String>>,
    tools: BTreeMap<u32, (Vec<f64>, f64)>,
    /// The latest value of each field of status reports, and all states that were reported.
    status: BTreeMap<String, String>,
    states: Vec<String>,
    oks: usize,
}

fn number(text: &str) -> Result<f64, String> {
    text.parse().map_err(|_| format!("not a number: {text:?}"))
}

fn numbers(text: &str) -> Result<Vec<f64>, String> {
    text.split(',').map(number).collect()
}

/// Returns whether a text is not empty and `may_be` accepts each of its characters.
fn is_of(text: &str, may_be: impl Fn(char) -> bool) -> bool {
    !text.is_empty() && text.chars().all(may_be)
}

impl Known {
    /// Reads a line from the machine as gSender does, and stores what it says.
    ///
    /// # Errors
    /// If the line fits no pattern, or if ioSender could not read it.
    fn hear(&mut self, line: &str) -> Result<(), String> {
        if let Some(report) = line.strip_prefix('<') {
            return self.hear_report(report.strip_suffix('>').ok_or("no end")?);
        }
        if line == "ok" {
            self.oks += 1;
            return Ok(());
        }
        if let Some(code) = line.strip_prefix("error:").or(line.strip_prefix("ALARM:")) {
            return number(code).map(|_| ());
        }
        if let Some(bracket) = line.strip_prefix('[') {
            return self.hear_bracket(bracket.strip_suffix(']').ok_or("no end")?);
        }
        if let Some(setting) = line.strip_prefix('$') {
            return self.hear_dollar(setting);
        }
        if let Some((number, row)) = line.split_once('\t') {
            // A row of `$ESH`. After the number it has name, unit, type, format, text, minimum and maximum.
            self.details.insert(number.parse().map_err(|_| "no number")?);
            return if row.split('\t').count() == 7 { Ok(()) } else { Err("not 8 columns".into()) };
        }
        // The greeting: `NAME 1.1f [..]`.
        let mut words = line.split_whitespace();
        let (name, version) = (words.next().unwrap_or_default(), words.next().unwrap_or_default());
        if is_of(name, |c| c.is_ascii_alphanumeric()) && version.starts_with("1.1") && line.contains('[') {
            self.greeted = name.to_lowercase();
            return Ok(());
        }
        if line.is_empty() { Ok(()) } else { Err("text of a terminal".into()) }
    }

    /// Reads a status report. Each field must have a known name and a colon, as ioSender expects. `FW:` must be the
    /// last field of a full report.
    fn hear_report(&mut self, report: &str) -> Result<(), String> {
        let mut fields = report.split('|');
        let state = fields.next().unwrap_or_default();
        let name = state.split(':').next().unwrap_or_default();
        let names = ["Idle", "Run", "Hold", "Jog", "Alarm", "Door", "Check", "Home", "Sleep", "Tool"];
        if !names.contains(&name) {
            return Err(format!("no state: {state}"));
        }
        self.states.push(state.into());
        for field in fields {
            let (name, value) = field.split_once(':').ok_or("a field without a colon")?;
            match name {
                "MPos" | "WPos" | "WCO" if numbers(value)?.len() == self.axes.len().max(3) => {}
                "FS" | "Bf" | "H" if numbers(value)?.len() == 2 => {}
                "Ov" if numbers(value)?.len() == 3 => {}
                "Ln" | "T" => drop(number(value)?),
                "MPG" | "TLR" if matches!(value, "0" | "1") => {}
                "A" if value.chars().all(|c| "SCFMT".contains(c)) => {}
                "Pn" if is_of(value, |c| "PXYZABCDRHSEF".contains(c)) => {}
                "WCS" if value.starts_with("G5") => {}
                "FW" => self.reported = value.into(),
                _ => return Err(format!("field {field}")),
            }
            self.status.insert(name.into(), value.into());
        }
        if report.contains("|FW:") && !report.ends_with("|FW:grblHAL") {
            return Err("FW is not the last field".into());
        }
        Ok(())
    }

    fn hear_bracket(&mut self, text: &str) -> Result<(), String> {
        let (name, value) = text.split_once(':').ok_or("no colon")?;
        let fields: Vec<String> = value.split('|').map(str::to_owned).collect();
        match name {
            "GC" => {
                let is_word = |word: &str| word.starts_with(|c: char| c.is_ascii_alphabetic());
                let words = value.split(' ').all(|word| is_word(word) && number(&word[1..]).is_ok());
                return if words { Ok(()) } else { Err("not words".into()) };
            }
            "PRB" => {
                let (place, success) = value.split_once(':').ok_or("no result")?;
                numbers(place).and(number(success)).map(drop)?;
            }
            "TLO" | "TLR" => drop(numbers(value)?),
            _ if name.starts_with('G') && number(&name[1..]).is_ok() => {
                if numbers(value)?.len() != self.axes.len() {
                    return Err("not as many axes".into());
                }
            }
            "VER" => {
                // The number after the last point decides which commands gSender sends.
                let build = value.split('.').next_back().unwrap_or_default().replace(':', "");
                self.build = build.parse().map_err(|_| "no build")?;
            }
            "OPT" => self.options = value.split(',').map(str::to_owned).collect(),
            "AXS" => {
                let (count, letters) = value.split_once(':').ok_or("no letters")?;
                self.axes = letters.into();
                return if number(count)? == letters.len() as f64 { Ok(()) } else { Err("another count".into()) };
            }
            "NEWOPT" => self.words = value.split(',').map(str::to_owned).collect(),
            "FIRMWARE" => self.firmware = value.into(),
            "SETTING" if fields.len() == 10 => drop(self.rows.insert(number(&fields[0])? as u16, fields)),
            "SETTINGGROUP" if fields.len() == 3 => drop(self.groups.insert(number(&fields[0])? as u8)),
            "ALARMCODE" if fields.len() == 3 => drop(self.alarms.insert(number(&fields[0])? as u8, fields[2].clone())),
            "ERRORCODE" if fields.len() == 3 => drop(self.errors.insert(number(&fields[0])? as u8, fields[2].clone())),
            "SETTINGDESCR" if fields.len() == 2 && !fields[1].is_empty() => {}
            "SPINDLE" if fields.len() == 6 => self.spindles.push(fields),
            "T" => {
                // `[T:n|x,y,z|r]`: without the radius gSender does not see the tool.
                let [tool, offset, radius] = &fields[..] else { return Err("not three fields".into()) };
                self.tools.insert(number(tool)? as u32, (numbers(offset)?, number(radius)?));
            }
            "MSG" | "HLP" | "PIN" => {}
            _ if is_of(name, |c| c.is_ascii_uppercase() || c == ' ') && !value.is_empty() && fields.len() == 1 => {}
            _ => return Err("not understood".into()),
        }
        Ok(())
    }

    fn hear_dollar(&mut self, text: &str) -> Result<(), String> {
        if text.starts_with("-Code\t") {
            return Ok(());
        }
        let (name, value) = text.split_once('=').ok_or("no value")?;
        if !name.starts_with('N') {
            self.values.insert(name.parse().map_err(|_| "no number")?, number(value)?);
        }
        Ok(())
    }

    /// Checks that `$ES` and `$ESH` have a row for each setting. Senders show a setting by its row. So each value
    /// must fit the type, labels and bounds in the row.
    fn check_settings(&self) {
        let of = |map: &BTreeMap<u16, _>| map.keys().copied().collect::<BTreeSet<u16>>();
        let numbers: BTreeSet<u16> = self.rows.keys().copied().collect();
        assert_eq!(of(&self.values), numbers, "a row for each value");
        assert_eq!(self.details, numbers);
        for (setting, value) in &self.values {
            let row = &self.rows[setting];
            let (group, kind, format) = (&row[1], row[4].as_str(), &row[5]);
            assert!(self.groups.contains(&group.parse().unwrap()), "${setting}: no group {group}");
            let labels: Vec<&str> = format.split(',').collect();
            let whole = *value as u32;
            match kind {
                "0" => assert!(whole <= 1, "${setting}={value}"),
                "1" => {
                    let unknown = (0..32).find(|bit| {
                        whole >> bit & 1 != 0 && labels.get(*bit as usize).is_none_or(|label| *label == "N/A")
                    });
                    assert_eq!(unknown, None, "${setting}={value}: {format}");
                }
                "3" => assert!((whole as usize) < labels.len(), "${setting}={value}: {format}"),
                "4" => assert!(whole < 1 << self.axes.len(), "${setting}={value}"),
                "5" | "6" => {
                    let bound = |text: &str| text.parse::<f64>().ok();
                    assert!(bound(&row[6]).is_none_or(|least| *value >= least), "${setting}={value}");
                    assert!(bound(&row[7]).is_none_or(|most| *value <= most), "${setting}={value}");
                }
                _ => panic!("${setting} has the type {kind}"),
            }
        }
    }
}

/// A machine, and what a sender that is connected to it has learned from its output.
struct Session {
    rig: Rig,
    known: Known,
    unread: String,
}

impl Session {
    /// Connects to a machine that has just been switched on, with these stored settings in addition to `$900=3`.
    fn new(stored: &[(u16, f32)]) -> Session {
        let mut rig = Rig::new();
        rig.power_cycle(&[&[(2000, 3.0)], stored].concat());
        let mut session = Session { rig, known: Known::default(), unread: String::new() };
        session.pass(0.1);
        session
    }

    fn pass(&mut self, seconds: f64) {
        self.rig.run_for(seconds);
        self.hear();
    }

    fn hear(&mut self) {
        self.unread.push_str(&self.rig.take_output());
        while let Some((line, rest)) = self.unread.split_once("\r\n") {
            self.known.hear(line).unwrap_or_else(|why| panic!("{line}: {why}"));
            self.unread = rest.to_owned();
        }
    }

    /// Sends lines and waits until each of them is answered with `ok`.
    fn carry_out(&mut self, lines: &[&str]) {
        let wanted = self.known.oks + lines.len();
        for line in lines {
            self.rig.send(format!("{line}\n").as_bytes());
        }
        while self.known.oks < wanted {
            let before = self.known.oks;
            assert!(self.rig.run_until(PATIENCE, |rig| rig.output_len() > 0), "{lines:?}: no answer");
            self.hear();
            assert!(self.known.oks >= before);
        }
    }

    fn press(&mut self, byte: u8) {
        self.rig.send(&[byte]);
        self.pass(0.02);
    }

    /// Sends `asks`, a byte that requests a status report, and returns the state in this report.
    fn state(&mut self, asks: u8) -> String {
        let before = self.known.states.len();
        self.press(asks);
        assert_eq!(self.known.states.len(), before + 1, "one report");
        self.known.states[before].clone()
    }

    /// Streams a program with at most [`IN_FLIGHT`] unanswered characters, as gSender does. Calls `look` after each
    /// line sent, with the number of lines sent so far.
    fn stream(&mut self, program: &[String], mut look: impl FnMut(&mut Session, usize)) {
        let (first, mut sent) = (self.known.oks, 0);
        for line in program {
            let length = |from: usize| program[from..sent].iter().map(|line| line.len() + 1).sum::<usize>();
            while length(self.known.oks - first) + line.len() + 1 > IN_FLIGHT {
                assert!(self.rig.run_until(PATIENCE, |rig| rig.output_len() > 0), "no answer");
                self.hear();
            }
            self.rig.send(format!("{line}\n").as_bytes());
            sent += 1;
            look(self, sent);
        }
        let all = first + program.len();
        while self.known.oks < all {
            assert!(self.rig.run_until(PATIENCE, |rig| rig.output_len() > 0), "no answer");
            self.hear();
        }
    }
}

/// Acts as gSender: starts up, writes a machine profile, and streams a job with a hold and a tool change.
#[test]
fn gsender_drives_a_machine_of_dialect_grblhal() {
    let mut session = Session::new(&[(22, 1.0)]);
    assert_eq!(session.known.greeted, "grblhal", "so it takes its class for grblHAL");
    assert_eq!(session.state(0x87), "Alarm:11");
    session.carry_out(&["$I"]);
    assert!(session.known.build >= 20_231_210, "so it asks by $spindlesh");
    session.carry_out(&["$$", "$ES", "$ESH", "$EG", "$EA", "$EE", "$#", "$spindlesh"]);
    let known = &session.known;
    assert_eq!((known.axes.as_str(), known.firmware.as_str(), known.reported.as_str()), ("XYZ", "grblHAL", "grblHAL"));
    assert!(known.alarms.contains_key(&11) && known.alarms.contains_key(&1) && known.errors.contains_key(&9));
    let [spindle] = &known.spindles[..] else { panic!("{:?}", known.spindles) };
    assert!(spindle[3].starts_with('*') && spindle[3].contains('V'), "{spindle:?}");
    assert_eq!(numbers(&spindle[5]).unwrap(), [known.values[&31], known.values[&30]]);
    known.check_settings();

    session.carry_out(&["$X", "$22=79", "$21=1", "$10=511", "$918=1", "G10 L1 P2 Z-3.5", "$$", "$#"]);
    session.known.check_settings();
    assert_eq!(session.known.tools[&2], (vec![0.0, 0.0, -3.5], 0.0));
    assert_eq!(session.known.values[&10], 511.0);

    let mut program: Vec<String> = vec!["G21 G90 F1200".into(), "M3 S500".into()];
    program.extend((0..200).map(|i| format!("G1 X{}.25 Y{}.5", i % 7, i % 5)));
    program.push("T2 M6".into());
    program.extend((0..50).map(|i| format!("G1 X{} Y{}", i % 7, i % 5)));
    let tool_change = 203;
    session.stream(&program, |session, sent| {
        if sent == 120 {
            session.press(b'!');
            session.pass(2.0);
            assert_eq!(session.state(b'?'), "Hold:0");
            session.press(b'~');
        } else if sent == tool_change {
            assert!(session.rig.run_until(PATIENCE, |rig| rig.waiting() == 0 && rig.output_len() > 0));
            while session.state(b'?') != "Tool" {
                session.pass(0.2);
            }
            assert_eq!(session.known.status["A"], "T");
            session.press(0xA3);
        }
    });
    assert!(session.rig.run_until(20.0 * PATIENCE, |rig| rig.is_idle()));
    session.hear();
    assert_eq!(session.state(0x87), "Idle");
    assert_eq!((&*session.known.status["T"], &*session.known.status["H"]), ("2", "0,0"));
    session.rig.pin("limit x 1");
    session.pass(0.5);
    session.press(0x18);
    session.pass(0.5);
    assert!(session.state(0x87).starts_with("Alarm"));
}

/// Acts as ioSender: starts up by 0x87 and `$I+`, reads what its pages show, and drives the machine by realtime
/// commands from 0x80 on.
#[test]
fn iosender_drives_a_machine_of_dialect_grblhal() {
    let mut session = Session::new(&[]);
    assert_eq!(session.state(0x87), "Idle");
    assert_eq!(session.known.reported, "grblHAL");
    session.carry_out(&["$I+", "$+", "$EG", "$ES", "$ESH", "$EA", "$EE", "$SED=22", "$SPINDLESH", "$#", "$G", "$N"]);
    let known = &session.known;
    assert_eq!(known.firmware, "grblHAL");
    let options: Vec<usize> = known.options[1..].iter().map(|field| field.parse().unwrap()).collect();
    assert_eq!(options, [512, 255, 3, 32], "look-ahead, receive buffer, axes, tools");
    assert!(["ENUMS", "RT+", "EXPR", "SED"].iter().all(|word| known.words.iter().any(|known| known == word)));
    // Words for features that the machine does not have.
    for word in ["SD", "RTC", "MPG", "ATC", "LATHE", "REBOOT", "BD", "OS", "YM", "FTP", "HOME", "TC"] {
        assert!(!known.words.iter().any(|known| known == word), "{word}");
    }
    known.check_settings();

    session.carry_out(&["G91 G1 X20 F600"]);
    session.pass(0.5);
    assert_eq!(session.state(0x80), "Run");
    session.press(0x82);
    session.pass(1.0);
    assert_eq!(session.state(0x80), "Hold:0");
    session.press(0x81);
    session.pass(5.0);
    assert_eq!(session.state(0x80), "Idle");
    session.carry_out(&["$J=G91 G21 X1 F600"]);
    session.press(0x83);
    session.pass(1.0);
    assert_eq!(session.state(0x87), "Idle");
    assert_eq!(session.known.status["MPG"], "0");
}
