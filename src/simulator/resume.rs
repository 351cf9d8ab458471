//! `oxmill resume`: writes the rest of a job as a self-contained program, for a machine that has no memory of the job.
//!
//! The lines before the rest are run twice in a simulator, with different work zeros. If the resulting states differ,
//! the rest depends on where the machine was when the job began, and the job is rejected. Otherwise `prologue` writes
//! lines that restore the state.
//!
//! A third simulator checks the result: it runs the prologue and the first lines of the rest. The program is written
//! only if the state then equals that of the first run (`Interpreter::differs_from`).

use crate::boards::AXES;
use crate::power_up::{Dialect, apply_setting, error_text};
use crate::prologue::{Entry, exact, goes_on_from_curve, has_word, mode_of, prologue, put_in_front};
use crate::simulator::{Options, Simulator};
use crate::text::is_tape_mark;
use oxmill_controller::axes::{Axis, PerAxis};
use oxmill_controller::gcode::{self, CoordinateSystem, FeedMode, Interpreter, MotionMode};
use oxmill_controller::messages::Realtime;
use oxmill_controller::settings::Key;
use oxmill_controller::units::{Coordinate, DECIMAL_ONE, Decimal};

/// Position, in mm, at which a simulator begins a job or a program. A program is unlikely to contain these numbers. So
/// no axis begins at its target by chance, and each axis that the program names moves.
const START: [f64; AXES] = [-0.1357, -0.2473, -0.3791, -0.4919];

/// Shift of the second run, in mm for each axis. The second run begins this far from [`START`]. The zeros of its
/// coordinate systems are at 2, 3, 4 ... times this distance.
const ELSEWHERE: [f64; AXES] = [1.9, 3.1, -2.3, 4.7];

/// Default of [`ResumeRequest::spin_up`], in seconds.
pub const SPIN_UP: u16 = 5;

/// Minimum plunge feed in mm/min, as in Grbl. Simulating a slower plunge would take hours of machine time.
const SLOWEST: Decimal = Decimal::from_int(1);

/// Converts a length in mm or a feed rate in mm/min to units of 1e-7; `None` beyond the controller's range.
pub fn number_of(value: f64) -> Option<i64> {
    (value.abs() <= Coordinate::LIMIT.0 as f64 / DECIMAL_ONE as f64)
        .then(|| (value * DECIMAL_ONE as f64).round() as i64)
}

/// Where the user wants to resume a job.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Begin {
    /// At this line of the file, from 1.
    Line(u64),
    /// At the first line with this N word.
    Number(u32),
}

/// The user's options for resuming a job.
#[derive(Clone, Copy, Debug)]
pub struct ResumeRequest {
    /// Where to resume.
    pub begin: Begin,
    /// Z at which the tool travels to the position, in program coordinates. `None`: the highest Z of the job so far.
    /// That Z can be used only if each height at which the job has travelled is known in the present coordinate
    /// system, and does not depend on where the machine was before the job.
    pub clearance: Option<Coordinate>,
    /// Feed rate down to the position, in mm/min. `None`: the feed rate of the job's last plunge straight down.
    pub plunge: Option<Decimal>,
    /// Time for the spindle to spin up, in seconds.
    pub spin_up: u16,
}

/// A program that resumes a job: its text, and numbers for the message to the user.
#[derive(Clone, Debug, PartialEq)]
pub struct Resumed {
    /// The program; each line ends with LF.
    pub program: Vec<u8>,
    /// Line number in the file at which the rest of the job begins.
    pub line: u64,
    /// Number of lines of the job.
    pub lines: u64,
    /// The lines of `program` that restore the state, before the rest of the job.
    pub prologue: Vec<String>,
}

/// Returns a program that continues `job`. `machine`: an idle simulator with the settings of the machine; it is not
/// changed. `name`: the job's name, for a comment in the program.
///
/// # Errors
/// A text for users: the line does not exist, a line before it is rejected, or a part of the state at the line is not
/// known.
pub fn resume(machine: &Simulator, name: &str, job: &[u8], request: &ResumeRequest) -> Result<Resumed, String> {
    if request.plunge.is_some_and(|feed| feed < SLOWEST) {
        return Err("the plunge feed is below 1 mm/min".into());
    }
    let lines = lines_of(job);
    let at = place_of(&lines, request.begin)?;
    let (front, rest) = (&lines[..at], &lines[at..]);
    let read_input = |line: &&&[u8]| spoken(line).contains("5399");
    if front.iter().any(|line| has_word(line, b'M', &[66])) && lines.iter().any(|line| read_input(&line)) {
        return Err("the job uses #5399, which an M66 before this line sets: its value is not known. Choose a line before that M66".into());
    }
    let mut walk = Walk::along(machine, front, false)?;
    let other = Walk::along(machine, front, true)?;
    if walk.simulator.controller().open_since().is_some() {
        return Err(format!("line {} is within a subroutine, a loop or a condition (O words)", at + 1));
    }
    let interpreter = walk.simulator.controller().interpreter();
    let mode = mode_of(interpreter, rest, dialect_of(&walk.simulator))?;
    let entry = walk.entry(&other, request, mode.words.is_some())?;
    let begin = prologue(interpreter, &entry)?;
    if let Some(line) = goes_on_from_curve(interpreter.modal().motion, rest, dialect_of(&walk.simulator)) {
        let line = at + line + 1;
        return Err(format!(
            "line {line} (G5 without I and J) goes on from a curve in front of this one: take another line"
        ));
    }
    let mut rest: Vec<Vec<u8>> = rest.iter().map(|line| line.to_vec()).collect();
    if let Some(words) = &mode.words {
        rest[mode.line] = put_in_front(&rest[mode.line], words);
    }
    walk.compare(&begin, &rest[..=mode.line], &lines[at..=at + mode.line])?;
    let has_mark = front.iter().any(|line| is_tape_mark(&spoken(line)));
    let comment: String = name.chars().filter(|c| c.is_ascii_alphanumeric() || " ._-".contains(*c)).collect();
    let mut program = Vec::new();
    let head = [format!("({comment} from line {} on)", at + 1)];
    let head = has_mark.then(|| "%".to_owned()).into_iter().chain(head);
    for line in head.chain(begin.iter().cloned()).map(String::into_bytes).chain(rest) {
        program.extend(line);
        program.push(b'\n');
    }
    Ok(Resumed { program, line: at as u64 + 1, lines: lines.len() as u64, prologue: begin })
}

/// Returns the dialect in which a machine interprets a program.
fn dialect_of(simulator: &Simulator) -> gcode::Dialect {
    match Dialect::of(simulator) {
        Some(Dialect::Grbl) => gcode::Dialect::Grbl,
        Some(Dialect::Seed) => gcode::Dialect::Seed,
        _ => gcode::Dialect::Oxmill,
    }
}

/// Splits a file at LF, CR LF or CR; the lines are without their ends.
fn lines_of(job: &[u8]) -> Vec<&[u8]> {
    let mut job = job.strip_prefix("\u{FEFF}".as_bytes()).unwrap_or(job);
    let mut lines = Vec::new();
    while !job.is_empty() {
        let end = job.iter().position(|byte| matches!(byte, b'\n' | b'\r')).unwrap_or(job.len());
        lines.push(&job[..end]);
        let both = job[end..].starts_with(b"\r\n");
        job = job.get(end + 1 + usize::from(both)..).unwrap_or_default();
    }
    lines
}

/// Returns a line as a sender transmits it: without realtime commands, which a comment can contain.
fn spoken(line: &[u8]) -> String {
    String::from_utf8_lossy(line).chars().filter(|c| matches!(c, ' '..='~' | '\t') && !"?!~".contains(*c)).collect()
}

/// Returns the index of the line at which the rest of a job begins.
fn place_of(lines: &[&[u8]], begin: Begin) -> Result<usize, String> {
    match begin {
        Begin::Line(line) if (1..=lines.len() as u64).contains(&line) => Ok(line as usize - 1),
        Begin::Line(line) => Err(format!("there is no line {line}: the job has {}", lines.len())),
        Begin::Number(number) => lines
            .iter()
            .position(|line| line_number_of(&spoken(line)) == Some(number))
            .ok_or_else(|| format!("no line has N{number}")),
    }
}

/// Returns the number of the N word at the beginning of a line, if there is one.
fn line_number_of(line: &str) -> Option<u32> {
    let line = line.trim_start().trim_start_matches('/').trim_start();
    let digits = line.strip_prefix(['N', 'n'])?.trim_start();
    digits.split(|c: char| !c.is_ascii_digit()).next()?.parse().ok()
}

/// The Z that a move of a job reached, and how the move got there.
#[derive(Clone, Copy, Debug, PartialEq)]
struct End {
    line: usize,
    system: CoordinateSystem,
    /// Z of the tool's tip at the end of the move, in `system` without G52 and G92.
    height: Coordinate,
    /// The tool length offset in Z.
    length: Coordinate,
    is_rapid: bool,
    /// `true` if the move also moved an axis other than Z.
    travels: bool,
}

/// A simulated job, executed line by line.
struct Walk {
    simulator: Simulator,
    /// Axes that the job has moved.
    moved: PerAxis<bool, AXES>,
    ends: Vec<End>,
    /// Whether the job reached the present Z by a rapid and has made only rapids since.
    is_clear: bool,
    /// Feed rate of the last move straight down, in mm/min.
    plunge: Option<Decimal>,
    /// `true` if an output will change with the next motion (M62 or M63 without a motion since).
    waits_for_motion: bool,
}

impl Walk {
    /// Runs lines on a new simulator with the settings of `machine`. `elsewhere`: for the second run, with other work
    /// zeros and from another position.
    fn along(machine: &Simulator, lines: &[&[u8]], elsewhere: bool) -> Result<Self, String> {
        let mut simulator = powered_up_as(machine)?;
        if elsewhere {
            move_elsewhere(&mut simulator)?;
        }
        let mut walk = Self {
            simulator,
            moved: PerAxis::all(false),
            ends: Vec::new(),
            is_clear: true,
            plunge: None,
            waits_for_motion: false,
        };
        for (index, line) in lines.iter().enumerate() {
            walk.take(index, line).map_err(|why| format!("line {} {why}", index + 1))?;
        }
        settle(&mut walk.simulator)?;
        Ok(walk)
    }

    fn state(&self) -> &Interpreter<AXES> {
        self.simulator.controller().interpreter()
    }

    /// Returns the position in program coordinates.
    fn place(&self) -> PerAxis<Coordinate, AXES> {
        self.state().to_program(self.state().position())
    }

    /// Returns the shift of Z by G52 or G92.
    fn shift_of_z(&self) -> Coordinate {
        self.state().offsets().g92.get(Axis::Z).unwrap_or_default()
    }

    /// The tool length offset in Z.
    fn length(&self) -> Coordinate {
        self.state().offsets().tool_length.get(Axis::Z).unwrap_or_default()
    }

    /// Runs a line, and records the move that it makes. Fails if the line is rejected or probes.
    fn take(&mut self, index: usize, line: &[u8]) -> Result<(), String> {
        let line = spoken(line);
        let begins_homed = line.trim_start().to_ascii_uppercase().starts_with("$H") && !self.moved.0.contains(&true);
        if is_tape_mark(&line) || begins_homed {
            return Ok(());
        }
        let before = *self.state().position();
        say(&mut self.simulator, &line)?;
        let (after, modal) = (*self.state().position(), *self.state().modal());
        if matches!(modal.motion, MotionMode::Probe(_)) {
            return Err("probes (G38): what it finds is not known".into());
        }
        let mut is_other = before.zip(&after, |before, after| before != after);
        // G12 and G13 move X and Y, and end where they began.
        let circles = has_word(line.as_bytes(), b'G', &[12, 13]);
        if circles {
            is_other.set(Axis::X, true);
            is_other.set(Axis::Y, true);
        }
        let has_moved = is_other.0.contains(&true);
        self.moved = self.moved.zip(&is_other, |moved, other| moved || other);
        self.waits_for_motion = !has_moved && (self.waits_for_motion || has_word(line.as_bytes(), b'M', &[62, 63]));
        if !has_moved {
            return Ok(());
        }
        let moves_z = is_other.get(Axis::Z) == Some(true);
        let travels = Axis::of_machine::<AXES>().any(|axis| axis != Axis::Z && is_other.get(axis) == Some(true));
        let goes_there = has_word(line.as_bytes(), b'G', &[28, 30]);
        let is_cycle = matches!(modal.motion, MotionMode::Cycle(_));
        let is_rapid = !circles && (goes_there || is_cycle || modal.motion == MotionMode::Rapid);
        let height = self.place().get(Axis::Z).unwrap_or_default() + self.shift_of_z();
        self.ends.push(End {
            line: index,
            system: modal.coordinate_system,
            height,
            length: self.length(),
            is_rapid,
            travels,
        });
        if is_rapid {
            self.is_clear |= moves_z || is_cycle;
            return Ok(());
        }
        self.is_clear = false;
        let is_plunge = moves_z && !travels && before.get(Axis::Z) > after.get(Axis::Z);
        if is_plunge && modal.motion == MotionMode::Linear && modal.feed_mode == FeedMode::PerMinute {
            self.plunge = Some(modal.feed);
        }
        Ok(())
    }

    /// Returns how the tool moves to the position that the job has reached. `other`: the second run. Fails if the two
    /// runs differ, because the state then depends on where the job began.
    fn entry(&self, other: &Walk, request: &ResumeRequest, carries: bool) -> Result<Entry, String> {
        let moved = self.moved.zip(&other.moved, |here, there| here || there);
        let (place, there) = (self.place(), other.place());
        for axis in Axis::of_machine::<AXES>().filter(|axis| moved.get(*axis) == Some(true)) {
            if place.get(axis) != there.get(axis) {
                let letter = char::from(axis.letter());
                return Err(format!(
                    "{letter} at this line depends on where the machine stood when the job started: choose a line after \
                     one that has {letter} with G90"
                ));
            }
        }
        let offsets = |walk: &Walk| (walk.state().offsets().g92, walk.state().offsets().tool_length);
        let meaning = |walk: &Walk| *walk.state().modal();
        for (differs, what) in [
            (offsets(self).0 != offsets(other).0, "the offset of G52 or G92"),
            (offsets(self).1 != offsets(other).1, "the tool length offset"),
            (meaning(self) != meaning(other), "a mode such as G20, G54, G91 or the feed"),
        ] {
            if differs {
                return Err(format!(
                    "at this line {what} depends on where the machine stood when the job started: choose another line"
                ));
            }
        }
        if self.waits_for_motion {
            return Err(
                "an M62 or M63 before this line waits for the next motion: choose the line after that motion".into()
            );
        }
        let moves_z = moved.get(Axis::Z) == Some(true);
        let clearance = if moves_z { Some(request.clearance.map_or_else(|| self.clearance(other), Ok)?) } else { None };
        let height = place.get(Axis::Z).unwrap_or_default();
        if clearance.is_some_and(|clearance| clearance < height) {
            return Err(format!("--clearance is below the place itself, Z{}", exact(height.0)));
        }
        Ok(Entry {
            place,
            moved,
            clearance,
            is_clear: self.is_clear && other.is_clear,
            plunge: request.plunge.or(self.plunge).or(other.plunge),
            spin_up: request.spin_up,
            is_laser: self.simulator.controller().settings().is_on(Key::Laser),
            carries,
            outputs: outputs_of(&self.simulator),
        })
    }

    /// Returns the highest known Z of the job so far, at which the tool can travel. Fails if the job has travelled at
    /// a height that is not known in the present coordinate system. Also fails if the spindle, with the present tool
    /// offset, would be higher at this Z than it was in the job.
    fn clearance(&self, other: &Walk) -> Result<Coordinate, String> {
        const WISH: &str = "give a safe height to travel at (--clearance)";
        let system = self.state().modal().coordinate_system;
        let is_known = |end: &&End| {
            let there = other.ends.binary_search_by_key(&end.line, |there| there.line);
            end.system == system && there.is_ok_and(|there| other.ends[there].height == end.height)
        };
        let known = || self.ends.iter().filter(is_known);
        if !known().any(|end| end.is_rapid) {
            return Err(format!("no Z of a G0 in front of this line is known: {WISH}"));
        }
        let highest = known().map(|end| end.height - self.shift_of_z()).max().unwrap_or_default();
        let highest = highest.max(self.place().get(Axis::Z).unwrap_or_default());
        if let Some(end) = self.ends.iter().find(|end| end.travels && !is_known(end)) {
            return Err(format!(
                "line {} travels at a Z that is not known in {} (relative to the start, by G53 or G28, or in another coordinate \
                 system) and may exceed the highest known, Z{}: {WISH}",
                end.line + 1,
                system.word(),
                exact(highest.0)
            ));
        }
        let spindle = known().map(|end| end.height - self.shift_of_z() + end.length).max().unwrap_or_default();
        if highest + self.length() > spindle {
            let highest = exact(highest.0);
            return Err(format!(
                "with this tool offset the spindle would be higher at Z{highest} than in the job: {WISH}"
            ));
        }
        Ok(highest)
    }

    /// Checks the program before it is written. This simulator runs the next lines of the job (`job`). A new simulator
    /// runs the prologue, and then the same lines in the form that the program has (`written`). Fails if the resulting
    /// states differ.
    fn compare(&mut self, prologue: &[String], written: &[Vec<u8>], job: &[&[u8]]) -> Result<(), String> {
        let mut anew = powered_up_as(&self.simulator)?;
        let taken = prologue.iter().map(|line| line.clone().into_bytes()).chain(written.iter().cloned());
        for line in taken.map(|line| spoken(&line)).filter(|line| !is_tape_mark(line)) {
            say(&mut anew, &line).map_err(|why| format!("the line {line} of the program to be written {why}"))?;
        }
        settle(&mut anew)?;
        for line in job.iter().map(|line| spoken(line)).filter(|line| !is_tape_mark(line)) {
            say(&mut self.simulator, &line).map_err(|why| format!("the line {line} {why}"))?;
        }
        settle(&mut self.simulator)?;
        let differs = self.state().differs_from(anew.controller().interpreter());
        let differs =
            differs.or((outputs_of(&self.simulator) != outputs_of(&anew)).then_some("an output (M62 to M65)"));
        differs.map_or(Ok(()), |part| Err(format!("{part} cannot be restored: take another line")))
    }
}

/// Returns the program-controlled outputs that are on; bit 0 is P0.
fn outputs_of(simulator: &Simulator) -> u8 {
    simulator.outputs().map_or(0, |outputs| outputs.digital)
}

/// Powers up a new simulator with the same settings, offsets and hardware as `machine`. Limits and homing are switched
/// off, because the new simulator is not homed and its positions may exceed the limits.
fn powered_up_as(machine: &Simulator) -> Result<Simulator, String> {
    let store = machine.store().apart().map_err(|why| why.to_string())?;
    let (board, fittings) = (*machine.board(), machine.fittings().clone());
    let mut simulator = Simulator::new(Options { board, store, fittings, keep_steps: false });
    for setting in [Key::SoftLimits, Key::HardLimits, Key::Homing] {
        apply_setting(&mut simulator, &format!("{}=0", setting.number())).map_err(|why| why.to_string())?;
    }
    simulator.send("$X\n");
    settle(&mut simulator)?;
    jog(&mut simulator, START)?;
    Ok(simulator)
}

/// Gives the simulator of the second run other work zeros and another machine position.
fn move_elsewhere(simulator: &mut Simulator) -> Result<(), String> {
    let axes = simulator.controller().settings().axes_in_use();
    let words = |times: usize| -> String {
        let axes = Axis::ALL.into_iter().zip(ELSEWHERE).take(axes);
        axes.map(|(axis, by)| format!(" {}{:.1}", char::from(axis.letter()), by * times as f64)).collect()
    };
    let is_grbl = Dialect::of(simulator) == Some(Dialect::Grbl);
    let systems = if is_grbl { CoordinateSystem::OF_GRBL } else { CoordinateSystem::ALL.len() };
    for system in 1..=systems {
        say(simulator, &format!("G10 L2 P{system}{}", words(system + 1)))?;
    }
    jog(simulator, ELSEWHERE)
}

fn jog(simulator: &mut Simulator, by: [f64; AXES]) -> Result<(), String> {
    let axes = Axis::ALL.into_iter().zip(by).take(simulator.controller().settings().axes_in_use());
    let words: String = axes.map(|(axis, by)| format!(" {}{by:.4}", char::from(axis.letter()))).collect();
    say(simulator, &format!("$J=G21 G91{words} F1000"))?;
    settle(simulator)
}

/// Sends a line and runs the simulator until the line is answered. Presses cycle start where the program pauses. Fails
/// if the answer is an error, if an alarm occurs, or if no answer will come.
fn say(simulator: &mut Simulator, line: &str) -> Result<(), String> {
    simulator.take_output();
    simulator.send(format!("{line}\n"));
    loop {
        let said = simulator.take_output();
        if let Some(alarm) = simulator.controller().alarm() {
            return Err(format!("ends in ALARM:{}: {}", alarm.code(), alarm.text()));
        }
        if let Some(code) = said.lines().find_map(|line| line.strip_prefix("error:")?.parse().ok()) {
            return Err(format!("is refused with error:{code}: {}", error_text(code)));
        }
        if said.lines().any(|line| line == "ok") {
            return Ok(());
        }
        if simulator.controller().is_paused() {
            simulator.press(Realtime::CycleStart);
        } else if !simulator.advance_once(u64::MAX) && simulator.unfetched() == 0 {
            return Err("waits for an input or a command that the simulator never gets".into());
        }
    }
}

/// Runs the simulator until all motion has ended. Presses cycle start where the program pauses. Fails if the machine
/// does not come to rest.
fn settle(simulator: &mut Simulator) -> Result<(), String> {
    while !simulator.run_until_idle() {
        if !simulator.controller().is_paused() {
            return Err("the machine does not come to rest".into());
        }
        simulator.press(Realtime::CycleStart);
    }
    Ok(())
}
