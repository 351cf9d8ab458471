//! Plays the files of `tests/conversations/` against the machine: what a host sends and the answers it must get.
//!
//! ```text
//! # a remark
//! -> G1 X10 F600      send this line and a line feed
//! => G1\x18\r\n       send these bytes and nothing else; \xNN, \r, \n and \\ stand for bytes
//! <- ok               the next line of the answer; virtual time passes until it comes
//! <- <Run|MPos:*      * stands for any text
//! <~ ok               skips all answers before one of this form
//! .. 0.5              half a second of virtual time passes
//! .. idle             time passes until nothing moves and no answer is pending
//! .. quiet            no answer is left unread, and none arrives within a tenth of a second
//! pin limit x 1       an input pin moves
//! host goes           the host closes the port; `host comes`: it opens it
//! power 0=1000 21=7   the power is cycled; meanwhile these settings are stored, valid or not
//! ```
//! Each file starts with a machine that has just been powered up, so its greeting comes first. At the end no answer may
//! be left unread.

use super::rig::Rig;
use std::path::{Path, PathBuf};

/// Virtual seconds to wait for an answer before the test fails.
const PATIENCE: f64 = 600.0;

/// A conversation in progress: the machine, and the part of its output that no step of the file has read.
struct Talk {
    rig: Rig,
    unread: String,
}

impl Talk {
    fn fetch(&mut self) {
        self.unread.push_str(&self.rig.take_output());
    }

    fn next_line(&mut self) -> Option<String> {
        self.fetch();
        if !self.unread.contains('\n') {
            let unread = &mut self.unread;
            self.rig.run_until(PATIENCE, |rig| {
                if rig.output_len() > 0 {
                    unread.push_str(&rig.take_output());
                }
                unread.contains('\n')
            });
        }
        let end = self.unread.find('\n')?;
        let line: String = self.unread.drain(..=end).collect();
        // Every answer ends in CR LF.
        Some(line.strip_suffix("\r\n").unwrap_or("an answer without CR LF").to_string())
    }

    fn play(&mut self, step: &str) -> Result<(), String> {
        let (word, rest) = step.split_once(' ').unwrap_or((step, ""));
        match word {
            "->" => self.rig.send(format!("{rest}\n").as_bytes()),
            "=>" => self.rig.send(&unescape(rest)?),
            "<-" => match self.next_line() {
                Some(line) if matches(rest, &line) => {}
                Some(line) => return Err(format!("expected {rest:?}, got {line:?}")),
                None => return Err(format!("expected {rest:?}, got nothing")),
            },
            "<~" => {
                while let Some(line) = self.next_line() {
                    if matches(rest, &line) {
                        return Ok(());
                    }
                }
                return Err(format!("expected {rest:?} among the answers, got none"));
            }
            ".." if rest == "idle" => {
                if !self.rig.run_until(PATIENCE, |rig| rig.is_idle()) {
                    return Err("never idle".into());
                }
            }
            ".." if rest == "quiet" => {
                self.rig.run_for(0.1);
                self.fetch();
                if !self.unread.is_empty() {
                    return Err(format!("unexpected {:?}", self.unread));
                }
            }
            ".." => self.rig.run_for(rest.parse().map_err(|_| format!("not a number of seconds: {rest:?}"))?),
            "pin" => self.rig.pin(rest),
            "power" => self.rig.power_cycle(&stored(rest).ok_or(format!("not values: {rest:?}"))?),
            "host" if rest == "comes" || rest == "goes" => self.rig.host(rest == "comes"),
            _ => return Err("not understood".into()),
        }
        Ok(())
    }
}

/// Returns whether a line matches a pattern in which `*` stands for any text.
fn matches(pattern: &str, line: &str) -> bool {
    let mut parts = pattern.split('*');
    let first = parts.next().unwrap_or_default();
    let Some(mut rest) = line.strip_prefix(first) else { return false };
    let mut ends_open = true;
    let parts: Vec<&str> = parts.collect();
    for (i, part) in parts.iter().enumerate() {
        if i + 1 == parts.len() {
            return rest.ends_with(part);
        }
        let Some(at) = rest.find(part) else { return false };
        rest = &rest[at + part.len()..];
        ends_open = false;
    }
    ends_open && rest.is_empty()
}

fn unescape(text: &str) -> Result<Vec<u8>, String> {
    let mut bytes = Vec::new();
    let mut rest = text.bytes();
    while let Some(byte) = rest.next() {
        if byte != b'\\' {
            bytes.push(byte);
            continue;
        }
        bytes.push(match rest.next() {
            Some(b'n') => b'\n',
            Some(b'r') => b'\r',
            Some(b'\\') => b'\\',
            Some(b'x') => {
                let digits = [rest.next().unwrap_or(b'?'), rest.next().unwrap_or(b'?')];
                let digits = std::str::from_utf8(&digits).map_err(|e| e.to_string())?;
                u8::from_str_radix(digits, 16).map_err(|_| format!("not a byte: \\x{digits}"))?
            }
            other => return Err(format!("not an escape: {other:?}")),
        });
    }
    Ok(bytes)
}

/// Parses settings such as `0=1000 21=7` into keys and values.
fn stored(text: &str) -> Option<Vec<(u16, f32)>> {
    let of = |word: &str| word.split_once('=').and_then(|(key, value)| Some((key.parse().ok()?, value.parse().ok()?)));
    text.split_whitespace().map(of).collect()
}

/// Plays a conversation; returns the first failure with its line.
fn play(text: &str) -> Result<(), String> {
    let mut talk = Talk { rig: Rig::new(), unread: String::new() };
    for (number, step) in text.lines().enumerate() {
        if step.is_empty() || step.starts_with('#') {
            continue;
        }
        talk.play(step).map_err(|e| format!("line {}: {step}\n{e}", number + 1))?;
    }
    talk.fetch();
    if talk.unread.is_empty() { Ok(()) } else { Err(format!("left unread: {:?}", talk.unread)) }
}

fn files() -> Vec<PathBuf> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/conversations");
    let mut files: Vec<PathBuf> = std::fs::read_dir(&folder)
        .unwrap()
        .map(|entry| entry.unwrap().path())
        .filter(|path| path.extension().is_some_and(|e| e == "txt"))
        .collect();
    files.sort();
    files
}

#[test]
fn all_conversations() {
    let files = files();
    assert!(files.len() >= 10, "only {} conversations", files.len());
    let mut faults = Vec::new();
    for file in files {
        let text = std::fs::read_to_string(&file).unwrap();
        if let Err(fault) = play(&text) {
            faults.push(format!("{}: {fault}", file.display()));
        }
    }
    assert!(faults.is_empty(), "{}", faults.join("\n\n"));
}

#[test]
fn the_player_notices_what_is_wrong() {
    let greeting = "<- \n<- Grbl 1.1h ['$' for help]\n";
    play(greeting).unwrap();
    for (wrong, what) in [
        ("<- \n", "left unread"),
        ("<- \n<- Grbl 1.1g*\n", "expected"),
        ("<- \n<- Grbl 1.1h ['$' for help]\n<- ok\n", "got nothing"),
        ("<- \n<- Grbl 1.1h ['$' for help]\n-> G21\n", "left unread"),
        ("<- \n<- Grbl 1.1h ['$' for help]\n-> G21\n.. quiet\n", "unexpected"),
        ("<- \n<- Grbl 1.1h ['$' for help]\n-> G21\n<- error:1\n", "expected"),
        ("<~ Grbl 1.1g*\n", "got none"),
        ("<~ Grbl*\n-> $G\n<~ [GC:G1*\n", "got none"),
        ("say hello\n", "not understood"),
        ("=> \\xZZ\n", "not a byte"),
        ("power 0=\n", "not values"),
    ] {
        assert!(play(wrong).unwrap_err().contains(what), "{wrong}");
    }
}

#[test]
fn patterns() {
    for (pattern, line, expected) in [
        ("ok", "ok", true),
        ("ok", "ok ", false),
        ("ok", "o", false),
        ("<Run|*", "<Run|MPos:0.000", true),
        ("<Run|*", "<Idle|", false),
        ("<*|FS:0,0>", "<Idle|MPos:1|FS:0,0>", true),
        ("<*|FS:0,0>", "<Idle|MPos:1|FS:0,0|Pn:P>", false),
        ("<*|FS:*,0|*>", "<Run|MPos:1|FS:600,0|Ov:1>", true),
        ("<*|FS:*,0|*>", "<Run|MPos:1|FS:600,1>", false),
    ] {
        assert_eq!(matches(pattern, line), expected, "{pattern} {line}");
    }
}
