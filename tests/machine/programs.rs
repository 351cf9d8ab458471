//! Plays `tests/programs/`: programs as CAM systems and hobby authors write them. Checks the positions that they
//! reach and the errors of unsupported words. `tests/programs/README.md` explains the format.

use super::rig::Rig;
use std::path::Path;

/// Virtual seconds to wait for an answer or the end of motion before the test fails.
const PATIENCE: f64 = 600.0;
/// Maximum number of lines with axis words between two checks of the position (lines that begin with `? `). Lines
/// within a block of O words, such as a loop, do not count.
const MOST_UNCHECKED: usize = 3;
/// Maximum position error, mm: a step plus the resolution of the report.
const TOLERANCE: f64 = 0.0011;
/// Settings of a machine with usual rates, steps of 0.001 mm, work positions in the reports (`$10=0`) and no spin-up
/// time.
const SETTINGS: [&str; 12] = [
    "$0=2",
    "$10=0",
    "$100=1000",
    "$101=1000",
    "$102=1000",
    "$110=5000",
    "$111=5000",
    "$112=3000",
    "$120=500",
    "$121=500",
    "$122=300",
    "$394=0",
];

/// A machine with [`SETTINGS`], and the part of its output that has not been compared yet.
struct Player {
    rig: Rig,
    unread: String,
}

impl Player {
    fn new(is_seed: bool) -> Player {
        let mut player = Player { rig: Rig::new(), unread: String::new() };
        player.rig.keep_trace = false;
        player.rig.run_until(PATIENCE, |rig| rig.is_idle());
        player.rig.take_output();
        for setting in SETTINGS.iter().chain(is_seed.then_some(&"$900=2")) {
            assert_eq!(player.ask(setting), "ok", "{setting}");
        }
        player
    }

    /// Sends a line and returns its answer; messages are skipped.
    fn ask(&mut self, line: &str) -> String {
        self.rig.send(format!("{line}\n").as_bytes());
        self.wait(is_answer)
    }

    /// Returns the first line for which the condition holds; skips the others.
    fn wait(&mut self, wanted: impl Fn(&str) -> bool) -> String {
        loop {
            while let Some(end) = self.unread.find('\n') {
                let line: String = self.unread.drain(..=end).collect();
                if wanted(line.trim_end()) {
                    return line.trim_end().to_owned();
                }
            }
            assert!(self.rig.run_until(PATIENCE, |rig| rig.output_len() > 0), "no answer");
            self.unread += &self.rig.take_output();
        }
    }

    /// Waits until nothing moves, and returns the work position, mm.
    fn position(&mut self) -> [f64; 3] {
        assert!(self.rig.run_until(PATIENCE, |rig| rig.is_idle()), "the machine moves for ever");
        self.rig.send(b"?");
        let report = self.wait(|text| text.starts_with('<'));
        oxmill_test_support::numbers(&report, "WPos").expect("a work position")
    }
}

fn is_answer(text: &str) -> bool {
    text == "ok" || text.starts_with("error:") || text.starts_with("ALARM:")
}

fn near(a: &[f64], b: &[f64]) -> bool {
    a.len() == b.len() && a.iter().zip(b).all(|(a, b)| (a - b).abs() < TOLERANCE)
}

/// Returns a line without its comments, in upper case.
fn bare(line: &str) -> String {
    let mut depth = 0;
    let shown = |c: &char| {
        depth += i32::from(*c == '(') - i32::from(*c == ')');
        depth == 0 && *c != ')'
    };
    line.split(';').next().unwrap_or_default().chars().filter(shown).collect::<String>().to_ascii_uppercase()
}

/// Returns whether a line has X, Y or Z words that cause motion. The axis words of G10, G51, G52, G68 and G92 cause
/// none.
fn moves(line: &str) -> bool {
    !line.starts_with('#')
        && line.contains(['X', 'Y', 'Z'])
        && !["G10", "G51", "G52", "G68", "G92"].iter().any(|word| line.contains(word))
}

/// Returns the first line at which more than [`MOST_UNCHECKED`] moves have passed since the last check of the position.
fn unchecked<'a>(lines: &[(usize, &'a str)]) -> Option<(usize, &'a str)> {
    let (mut since, mut depth) = (0, 0);
    for (i, (number, line)) in lines.iter().enumerate() {
        let refused = lines.get(i + 1).is_some_and(|(_, next)| next.starts_with("! "));
        let text = bare(line);
        if line.starts_with("? ") {
            since = 0;
        } else if text.trim_start().starts_with('O') && text.contains(' ') {
            let ends = text.contains("END");
            let begins = ["SUB", "WHILE", "REPEAT", "IF"].iter().any(|word| text.contains(word));
            depth += i32::from(begins && !ends) - i32::from(ends);
        } else if depth == 0 && !refused && !line.starts_with('!') && moves(&text) {
            since += 1;
            if since > MOST_UNCHECKED {
                return Some((*number, line));
            }
        }
    }
    None
}

/// Plays one program; returns the first failure with its line.
fn play(reason: &str, lines: &[(usize, &str)]) -> Result<(), String> {
    let mut player = Player::new(reason.starts_with("seed: "));
    let mut checks = 0;
    for (i, (number, line)) in lines.iter().enumerate() {
        let fail = |what: String| Err(format!("{number}: {line}: {what}"));
        if let Some(expected) = line.strip_prefix("? ") {
            let expected: Vec<f64> = expected.split(' ').map(|value| value.parse().expect("a number")).collect();
            let found = player.position();
            if !near(&expected, &found) {
                return fail(format!("the position is {found:?}"));
            }
            checks += 1;
        } else if *line == "~" {
            player.rig.send(b"~");
            if player.wait(is_answer) != "ok" {
                return fail("the program does not continue".into());
            }
        } else if !line.starts_with("! ") {
            let refused = lines.get(i + 1).and_then(|(_, next)| next.strip_prefix("! "));
            let waits = lines.get(i + 1).is_some_and(|(_, next)| *next == "~");
            let before = refused.map(|_| player.position());
            if waits {
                // The line that pauses the program is answered only when the pause ends.
                player.rig.send(format!("{line}\n").as_bytes());
                player.rig.run_for(5.0);
                player.unread += &player.rig.take_output();
                if player.unread.lines().any(is_answer) {
                    return fail("it does not wait".into());
                }
                continue;
            }
            let answer = player.ask(line);
            let expected = refused.map_or("ok".to_owned(), |code| format!("error:{code}"));
            if answer != expected {
                return fail(format!("{answer} instead of {expected}"));
            }
            if before.is_some_and(|before| !near(&before, &player.position())) {
                return fail("refused, and yet something moved".into());
            }
        }
    }
    player.position();
    player.rig.run_for(0.1);
    player.unread += &player.rig.take_output();
    if player.unread.lines().any(is_answer) {
        return Err(format!("at the end: {}", player.unread));
    }
    if checks == 0 { Err("no position is checked".into()) } else { Ok(()) }
}

#[test]
fn programs_of_many_authors_go_where_they_should() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/programs");
    let mut files: Vec<_> = std::fs::read_dir(&folder)
        .expect("the programs")
        .map(|entry| entry.expect("a file").path())
        .filter(|path| path.extension().is_some_and(|extension| extension == "txt"))
        .collect();
    files.sort();
    let (mut programs, mut faults) = (0, String::new());
    for path in files {
        let text = std::fs::read_to_string(&path).expect("a text");
        let lines: Vec<(usize, &str)> = text.lines().enumerate().map(|(i, line)| (i + 1, line)).collect();
        for program in lines.split(|(_, line)| line.starts_with("== ")).skip(1) {
            let head = program.first().map_or(lines.len(), |(number, _)| number - 1);
            let reason = lines[head - 1].1.trim_start_matches("== ");
            programs += 1;
            if let Some((number, line)) = unchecked(program) {
                faults +=
                    &format!("{reason}: {number}: {line}: more than {MOST_UNCHECKED} moves since the last check\n");
            }
            if let Err(fault) = play(reason, program) {
                faults += &format!("{}: {reason}: {fault}\n", path.file_name().expect("a name").to_string_lossy());
            }
        }
    }
    assert!(faults.is_empty(), "{faults}");
    assert_eq!(programs, 175);
}
