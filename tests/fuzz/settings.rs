//! Fuzz target: `$` commands, and changes of settings, startup lines, macros and build info, in each dialect. The
//! store works or fails, and the power is cycled in between. The first byte chooses the dialect.
//!
//! Invariants:
//! - Each line is answered once.
//! - A rejected line leaves every listing unchanged.
//! - An accepted value is listed as it was set and changes nothing else.
//! - After a power-up, everything that the store has accepted is as before.

use super::board::{Board, shows};
use arbitrary::{Arbitrary, Unstructured};
use oxmill_controller::messages::Realtime;
use oxmill_controller::settings::Key;
use std::collections::BTreeMap;

#[derive(Arbitrary)]
enum Action<'a> {
    Set { number: Number, value: Value },
    Raw(u16, &'a str),
    Startup(u8, &'a str),
    Macro(u8, &'a str),
    MacroOf(u8, u8),
    Info(&'a str),
    Restore(u8),
    Command(u8),
    Text(&'a str),
    StoreFails(bool),
    PowerUp,
}

#[derive(Arbitrary)]
enum Number {
    /// An index into [`KNOWN`].
    Known(u8),
    Any(u16),
}

#[derive(Arbitrary)]
enum Value {
    Small(u8),
    Decimal(i32, u8),
    Text([u8; 4]),
}

/// Numbers of settings that have side effects, or that other settings depend on.
const KNOWN: [u16; 48] = [
    0, 1, 2, 3, 4, 5, 6, 10, 11, 12, 13, 20, 21, 22, 23, 24, 25, 26, 27, 29, 30, 31, 32, 33, 37, 40, 41, 43, 44, 56,
    57, 58, 59, 100, 101, 110, 112, 120, 122, 130, 132, 140, 900, 901, 904, 905, 924, 928,
];
const LINES: [&str; 10] =
    ["O1SUB", "O1ENDSUB", "G0X1", "O2IF[#1]", "O2ENDIF", "O1RETURN", "(a)", "G91", "#1=2", "O1CALL"];
const COMMANDS: [&str; 10] = ["$X", "$", "$G", "$I", "$C", "$RC", "$PINS", "$ES", "$EG", "$SLP"];
/// Commands that list everything that can be set.
const LISTINGS: [&str; 5] = ["$$", "$#", "$N", "$I", "$M"];
/// Beginnings of the lines of `$#` that a power-up resets.
const PASSING: [&str; 4] = ["[G92", "[TLO", "[TLR", "[PRB"];

impl Number {
    fn number(&self) -> u16 {
        match self {
            Number::Known(index) => KNOWN[usize::from(*index) % KNOWN.len()],
            Number::Any(number) => *number,
        }
    }
}

impl Value {
    fn text(&self) -> String {
        match self {
            Value::Small(value) => value.to_string(),
            Value::Decimal(value, places) => {
                let digits = format!("{:010}", value.unsigned_abs());
                let (whole, part) = digits.split_at(10 - usize::from(places % 10));
                format!("{}{}.{part}", if *value < 0 { "-" } else { "" }, whole.trim_start_matches('0'))
            }
            Value::Text(bytes) => {
                bytes.iter().map(|byte| char::from(b"0123456789.-+eE "[usize::from(byte % 16)])).collect()
            }
        }
    }
}

/// Output of the listings, line by line.
type Listed = Vec<String>;

#[derive(Clone)]
struct Machine {
    board: Board,
    listed: Listed,
    /// Whether all changes since the last power-up have been stored.
    is_stored: bool,
    /// Whether a startup line keeps the machine moving for long. If so, nothing more is sent.
    is_busy: bool,
}

/// Maximum number of actions of an input. It is small, because after each action everything is listed.
const MOST_ACTIONS: usize = 16;
/// Maximum number of times that a line is expected to wait for the operator.
const MOST_WAITS: usize = 4;

/// If the first byte of an input is at least this value, the input runs in the dialect of grblHAL (`$900=3`).
pub const OF_GRBLHAL: u8 = 0xF0;

thread_local! {
    /// Machines after start-up, one for each dialect.
    static STARTED: [Machine; 4] = ["$900=1", "$900=0", "$900=2", "$900=3"].map(|dialect| {
        let mut machine = Machine { board: Board::new(BTreeMap::new()), listed: Vec::new(), is_stored: true, is_busy: false };
        machine.board.ask(dialect);
        machine.listed = machine.list();
        machine
    });
}

/// Runs the target on one input; panics if an invariant is violated.
pub fn run(data: &[u8]) {
    let Some((first, data)) = data.split_first() else { return };
    let mut machine =
        STARTED.with(|machines| machines[if *first >= OF_GRBLHAL { 3 } else { usize::from(first % 3) }].clone());
    let mut input = Unstructured::new(data);
    for _ in 0..MOST_ACTIONS {
        if input.is_empty() || machine.is_busy {
            break;
        }
        let Ok(action) = input.arbitrary() else { break };
        machine.act(action);
    }
}

/// Returns a text as one line of at most 110 characters, without bytes that the link treats as commands.
fn one_line(text: &str) -> String {
    text.chars().filter(|c| c.is_ascii() && !c.is_ascii_control() && !matches!(c, '!' | '?' | '~')).take(110).collect()
}

/// Returns whether the controller keeps the text as it is: no blanks, no comments, upper case only.
fn is_plain(text: &str) -> bool {
    text.bytes().all(|byte| byte.is_ascii_graphic() && !byte.is_ascii_lowercase() && !b"();\\/\"%".contains(&byte))
}

/// Returns the lines of an output that are answers: `ok`, `error:`, or the answer to a checked line, which begins with
/// a colon.
fn answers(said: &str) -> Vec<&str> {
    said.lines().filter(|said| *said == "ok" || said.starts_with("error:") || said.starts_with(':')).collect()
}

impl Machine {
    fn act(&mut self, action: Action) {
        match action {
            Action::Set { number, value } => self.set(number.number(), &value.text()),
            Action::Raw(number, text) => self.set(number, &one_line(text)),
            Action::Startup(index, text) => self.text(&format!("$N{}=", index % 3), &one_line(text), "$N"),
            Action::Macro(index, text) => self.text(&format!("$M{}=", index % 66), &one_line(text), "$M"),
            Action::MacroOf(index, which) => {
                self.text(&format!("$M{}=", index % 8), LINES[usize::from(which) % LINES.len()], "$M");
            }
            Action::Info(text) => self.text("$I=", &one_line(text), "$I"),
            Action::Restore(which) => {
                let line = ["$RST=$", "$RST=#", "$RST=*", "$RST=&"][usize::from(which % 4)];
                let _ = self.line(line, |_| true);
            }
            Action::Command(which) => {
                let _ = self.line(COMMANDS[usize::from(which) % COMMANDS.len()], |_| false);
            }
            Action::Text(text) => {
                let _ = self.line(&one_line(text), |_| true);
            }
            Action::StoreFails(fails) => self.board.store_fails = fails,
            Action::PowerUp => self.power_up(),
        }
    }

    /// Sends a line and checks which lines of the listings it changes. A rejected line must change none. An accepted
    /// line may change only those for which `may` returns `true`. Returns `true` if the line was accepted.
    fn line(&mut self, line: &str, may: impl Fn(&str) -> bool) -> bool {
        let mut said = self.board.ask(line);
        // A line that waits for the operator is resumed with `~`.
        for _ in 0..MOST_WAITS {
            if !answers(&said).is_empty() {
                break;
            }
            self.go_on();
            said.push_str(&self.board.take_said());
        }
        if shows() {
            println!("{line:?} {said:?}");
        }
        self.is_stored &= !self.board.store_fails;
        if line.contains("$SLP") || said.contains("[MSG:Sleeping]") {
            self.reset();
        }
        let answers = answers(&said);
        // A dwell or move that takes too long is interrupted by the reset below, and not answered.
        let is_cut = answers.is_empty() && !self.board.controller.is_idle();
        assert!(answers.len() == 1 || is_cut, "{line:?}: {said}");
        // A reset ends a motion or an alarm that the line has started, and the mode of checked lines (`$LC=ON`).
        let begins = said.contains("[MSG:Enabled]") || said.starts_with(':');
        if !self.board.controller.is_idle() || self.board.controller.alarm().is_some() || begins {
            self.reset();
        }
        if self.is_busy {
            return false;
        }
        let listed = self.list();
        let accepted = answers == ["ok"];
        // With `$900=3`, `$B` switches block delete and `$O` switches optional stop, until power-off. They are not
        // stored.
        self.is_stored &= !["[MSG:Block delete", "[MSG:Optional stop"].iter().any(|toggled| said.contains(toggled));
        let gone = self.listed.iter().filter(|line| !listed.contains(line));
        let new = listed.iter().filter(|line| !self.listed.contains(line));
        for changed in gone.chain(new) {
            assert!((accepted || is_cut) && may(changed), "{line:?} {said:?} changes {changed}");
        }
        self.listed = listed;
        accepted
    }

    fn reset(&mut self) {
        self.board.command(Realtime::Reset);
        self.board.pass(300_000, false);
        // A startup line can be an M0, which waits for the operator.
        for _ in 0..MOST_WAITS {
            if self.board.controller.is_idle() {
                break;
            }
            self.go_on();
        }
        self.is_busy = !self.board.controller.is_idle();
        // The empty line ends an unfinished line. It also ends the mode of checked lines (`$LC=ON`): after a reset
        // this mode lasts until the next line end.
        self.board.ask("");
        self.board.ask("$X");
    }

    fn go_on(&mut self) {
        self.board.command(Realtime::CycleStart);
        self.board.pass(1_000_000, false);
    }

    /// Changes a setting. If the value is accepted, the listing must show it, to as many digits as the listing has.
    /// No other line of the listings may change, except lines that depend on this setting.
    fn set(&mut self, number: u16, text: &str) {
        let name = format!("${number}=");
        // Other lines can depend on the setting. Without homing there are no soft limits. Inches change the units of
        // listings. Another dialect has other listings.
        let is_grblhal = self.board.controller.speaks_grblhal();
        let follows = |line: &str| match number {
            22 => line.starts_with("$20=") || is_grblhal && line.starts_with("$932="),
            932 => is_grblhal && line.starts_with("$22="),
            13 => line.starts_with("[G") || line.starts_with("[T") || line.starts_with("[P"),
            900 => true,
            _ => false,
        };
        let accepted = self.line(&format!("{name}{text}"), |changed| changed.starts_with(&name) || follows(changed));
        if accepted && number != 900 {
            let Some(entry) = self.listed.iter().find_map(|line| line.strip_prefix(&name)) else {
                // Grbl's dialect accepts all settings but lists only its own.
                assert!(self.board.controller.settings().whole(Key::Dialect) == 0, "{name} is not listed");
                return;
            };
            let listed: f64 = entry.split(' ').next().unwrap_or_default().parse().expect("a number");
            let set: f64 = text.trim().parse().unwrap_or(f64::NAN);
            // How a value is listed: a whole number is truncated, a spindle speed has no decimals, a switch is 1 for
            // any value but 0, and all others have three decimals.
            let whole = !entry.contains('.');
            let switched = listed == 1.0 && set.trunc() != 0.0;
            if is_grblhal && matches!(number, 10 | 22) {
                // `$10` and `$22` are masks. Some of their bits are listed as set whatever is written. But while homing
                // is off (bit 0 of `$22` is 0), `$22` is listed without any bit.
                let written = if number == 22 && set as u32 & 1 == 0 { 0 } else { set as u32 };
                assert!(set.is_nan() || listed as u32 & written == written, "${number}={text} is {entry}");
                return;
            }
            let near = if whole {
                (set - listed).abs() <= 1.0 + set.abs() * 1e-6 || switched
            } else {
                (set - listed).abs() <= 0.0011 + set.abs() * 1e-6
            };
            assert!(near || set.is_nan(), "${number}={text} is {entry}");
        }
    }

    /// Sets a startup line, a macro or the build info. Checks that an accepted text is listed as it was set, and that
    /// nothing else in the listings changes.
    fn text(&mut self, name: &str, text: &str, listing: &str) {
        let number = name.trim_start_matches("$N").trim_start_matches("$M").trim_end_matches('=');
        let shown = format!("{}{number}=", if listing == "$I" { "[VER" } else { listing });
        let accepted = self.line(&format!("{name}{text}"), |changed| {
            // A startup line is carried out when it is set, so it can change the lines of `$#`, which begin with `[`.
            let carried_out = listing == "$N" && changed.starts_with('[');
            changed.starts_with(&shown) || listing == "$I" && changed.starts_with("[VER") || carried_out
        });
        if accepted && is_plain(text) && listing != "$I" && !text.is_empty() {
            let found = self.listed.iter().any(|line| line.starts_with(&shown) && line.ends_with(text));
            assert!(found, "{name}{text} is not in {:#?}", self.listed);
        }
    }

    fn list(&mut self) -> Listed {
        let mut listed = Vec::new();
        for listing in LISTINGS {
            let said = self.board.ask(listing);
            // These lines of `$I` depend on settings, so they may change.
            let depends = |line: &str| ["[OPT:", "[NEWOPT:", "[MAX STEP RATE:"].iter().any(|of| line.starts_with(of));
            let kept = said.lines().filter(|line| *line != "ok" && !depends(line));
            listed.extend(kept.map(str::to_owned));
        }
        listed
    }

    /// Cycles the power, after which the startup lines run. If the store has accepted all changes, the listings must
    /// then be the same as before, except for values that a power-up resets ([`PASSING`]).
    fn power_up(&mut self) {
        self.board = Board::new(std::mem::take(&mut self.board.records));
        self.board.pass(2_000_000, false);
        self.reset();
        if self.is_busy {
            return;
        }
        let listed = self.list();
        if self.is_stored {
            let kept = |listed: &Listed| -> Listed {
                let passes = |line: &String| PASSING.iter().any(|start| line.starts_with(start));
                listed.iter().filter(|line| !passes(line)).cloned().collect()
            };
            let (before, after) = (kept(&self.listed), kept(&listed));
            let differ = before.iter().zip(&after).find(|(before, after)| before != after);
            assert!(before == after, "after a power-up {differ:?}, {} and {} lines", before.len(), after.len());
        }
        self.listed = listed;
        self.is_stored = true;
    }
}
