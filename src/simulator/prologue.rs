//! Writes the prologue of `oxmill resume`: the lines that restore the machine's state before the rest of a job. They
//! restore modal state, tool and offsets, move to the position, and switch spindle and coolant on. Numbers are exact.
//!
//! The rest of the job can rely on an arc mode or a canned cycle of the lines before it. Then the words that are
//! missing in the rest are added to the first line that needs them.

use crate::boards::AXES;
use oxmill_controller::axes::{Axis, PerAxis};
use oxmill_controller::gcode::{
    ArcDistance, CycleKind, CycleWords, Dialect, Distance, FeedMode, Group, Interpreter, Modal, MotionMode,
    PathControl, Plane, SplineKind, Units, group_of,
};
use oxmill_controller::messages::SpindleDirection;
use oxmill_controller::units::{Coordinate, DECIMAL_ONE, Decimal};

/// How the tool moves to the position at which a job is resumed.
#[derive(Clone, Copy, Debug)]
pub struct Entry {
    /// The position in program coordinates.
    pub place: PerAxis<Coordinate, AXES>,
    /// Axes that the job has moved; the others keep their position.
    pub moved: PerAxis<bool, AXES>,
    /// Z at which the tool travels; `None` if the job has not moved Z.
    pub clearance: Option<Coordinate>,
    /// `true` if the job reached the Z of `place` by a rapid and made only rapids since. Then no material is in the
    /// way, and the tool moves down by a rapid, too.
    pub is_clear: bool,
    /// Feed rate of the move down to the position, in mm/min; `None` if it is not known.
    pub plunge: Option<Decimal>,
    /// Spin-up time of the spindle, seconds.
    pub spin_up: u16,
    /// `true` if the spindle is a laser ($32). A laser is switched on last, without a delay.
    pub is_laser: bool,
    /// `true` if a line of the rest has axis words but no motion word, so that it relies on the motion mode of the
    /// lines before the rest.
    pub carries: bool,
    /// Program-controlled outputs that are on; bit 0 is P0.
    pub outputs: u8,
}

/// The first line of the rest that uses or replaces the motion mode of the lines before the rest, and the words that
/// this line needs. The prologue cannot restore some modes, such as arcs and canned cycles, by a single word.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Mode {
    /// Index, in the rest, of the first line that moves in this mode or selects another motion mode.
    pub line: usize,
    /// The words to add to that line. `None` if the line selects another motion mode, or if G0, G1 or G80 is in force.
    pub words: Option<String>,
}

/// Formats a number in units of 1e-7 without rounding: 15,000,000 becomes `1.5`.
pub fn exact(number: i64) -> String {
    let (size, one) = (number.unsigned_abs(), DECIMAL_ONE.unsigned_abs());
    let sign = if number < 0 { "-" } else { "" };
    let text = format!("{sign}{}.{:07}", size / one, size % one);
    text.trim_end_matches('0').trim_end_matches('.').to_owned()
}

/// Returns the lines that restore a state and move the tool to the position.
///
/// # Errors
/// A text for users: a part of the state cannot be restored, or the feed rate of the move down is unknown.
pub fn prologue(state: &Interpreter<AXES>, entry: &Entry) -> Result<Vec<String>, String> {
    let modal = state.modal();
    if state.rotation().is_some() || state.scaling().is_some() {
        return Err("coordinates are rotated (G68) or scaled (G51) there".into());
    }
    if matches!(modal.motion, MotionMode::Probe(_)) && entry.carries {
        return Err("the next line would probe (G38)".into());
    }
    let mut lines = vec![format!("G21 G90 G94 G17 {}", modal.coordinate_system.word()), "M5 M9".into()];
    lines.extend(tool(state));
    lines.extend(offsets(state));
    lines.extend(way(state, entry)?);
    let is_fed = lines.iter().any(|line| line.contains('F'));
    lines.extend(modes(modal, is_fed));
    if entry.is_laser {
        // Switch a laser on last: as soon as M3 and G1 are in force, it burns even at rest.
        lines.extend(accessories(modal, entry));
    }
    Ok(lines)
}

/// Returns the lines for the tool in the spindle (M6) and its offset.
fn tool(state: &Interpreter<AXES>) -> Vec<String> {
    let (held, chosen) = (state.spindle_tool(), state.modal().tool);
    let mut lines = Vec::new();
    if held != 0 {
        lines.push(format!("T{held} M6"));
    }
    if chosen != held {
        lines.push(format!("T{chosen}"));
    }
    let offset = state.offsets().tool_length;
    if offset == PerAxis::all(Coordinate::ZERO) {
        return lines;
    }
    // If possible, select the offset by the tool's number, so that the machine uses its own tool table.
    let by_number = held != 0 && state.tools().offset(held) == Some(offset);
    lines.push(if by_number { format!("G43 H{held}") } else { format!("G43.1{}", words(&offset)) });
    lines
}

fn offsets(state: &Interpreter<AXES>) -> Option<String> {
    let offset = state.offsets().g92;
    let words = words(&offset);
    // Restore even an offset of 0 if it is set, because #5210 reports whether an offset is in force.
    state.offsets().g92_acts.then(|| format!("G52{}", if words.is_empty() { " X0" } else { &words }))
}

/// Returns the words of the axes whose value is not 0, such as ` X1.5 Z-2`.
fn words(place: &PerAxis<Coordinate, AXES>) -> String {
    let axes = Axis::of_machine::<AXES>().zip(place.iter()).filter(|(_, value)| **value != Coordinate::ZERO);
    axes.map(|(axis, value)| format!(" {}{}", char::from(axis.letter()), exact(value.0))).collect()
}

/// Returns the moves to the position. A spindle starts before the move down. A laser does not start in these lines.
fn way(state: &Interpreter<AXES>, entry: &Entry) -> Result<Vec<String>, String> {
    let mut lines = Vec::new();
    if let Some(clearance) = entry.clearance {
        lines.push(format!("G0 Z{}", exact(clearance.0)));
    }
    let in_plane: String = Axis::of_machine::<AXES>()
        .filter(|axis| *axis != Axis::Z && entry.moved.get(*axis) == Some(true))
        .filter_map(|axis| Some(format!(" {}{}", char::from(axis.letter()), exact(entry.place.get(axis)?.0))))
        .collect();
    if !in_plane.is_empty() {
        lines.push(format!("G0{in_plane}"));
    }
    if !entry.is_laser {
        lines.extend(accessories(state.modal(), entry));
    }
    lines.extend(down(state, entry)?);
    Ok(lines)
}

/// Returns the move from the clearance down to the position.
fn down(state: &Interpreter<AXES>, entry: &Entry) -> Result<Vec<String>, String> {
    let Some(clearance) = entry.clearance else { return Ok(Vec::new()) };
    let cycle = matches!(state.modal().motion, MotionMode::Cycle(_)) && entry.carries;
    if cycle {
        let words = state.cycle_words();
        if words.plane != Plane::Xy {
            return Err("a canned cycle in another plane than G17 is in force there".into());
        }
        // Move to the Z at which the series of cycles began, because G98 retracts to it.
        let mut place = *state.position();
        place.set(Axis::Z, state.cycle_level());
        let level = state.to_program(&place).get(Axis::Z).unwrap_or(clearance);
        if entry.place.get(Axis::Z).is_some_and(|reached| level < reached) {
            return Err(
                "its canned cycle was begun with the tool below R: choose a line before the cycle, or after G80".into(),
            );
        }
        return Ok(if level == clearance { Vec::new() } else { vec![format!("G0 Z{}", exact(level.0))] });
    }
    let Some(depth) = entry.place.get(Axis::Z).filter(|depth| *depth != clearance) else { return Ok(Vec::new()) };
    if entry.is_clear {
        return Ok(vec![format!("G0 Z{}", exact(depth.0))]);
    }
    let feed = entry.plunge.ok_or("the feed down to the place is not known: give it (--plunge)")?;
    Ok(vec![format!("G1 Z{} F{}", exact(depth.0), exact(feed.0))])
}

fn accessories(modal: &Modal, entry: &Entry) -> Vec<String> {
    let mut lines = Vec::new();
    let speed = if modal.speed == 0.0 { String::new() } else { format!(" S{}", modal.speed) };
    let spindle = match modal.spindle {
        SpindleDirection::Off => speed.trim_start().to_owned(),
        SpindleDirection::Clockwise => format!("M3{speed}"),
        SpindleDirection::CounterClockwise => format!("M4{speed}"),
    };
    lines.extend((!spindle.is_empty()).then_some(spindle));
    if modal.spindle != SpindleDirection::Off && !entry.is_laser && entry.spin_up > 0 {
        lines.push(format!("G4 P{}", entry.spin_up));
    }
    let coolant = modal.coolant;
    lines.extend(coolant.mist.then(|| "M7".to_owned()));
    lines.extend(coolant.flood.then(|| "M8".to_owned()));
    lines.extend((0..u8::BITS).filter(|bit| entry.outputs >> bit & 1 == 1).map(|number| format!("M64 P{number}")));
    lines
}

/// Returns modal words, which move nothing. Words that change the meaning of lengths and feeds come last.
fn modes(modal: &Modal, is_fed: bool) -> Vec<String> {
    let mut words: Vec<String> = Vec::new();
    let mut add = |is_other: bool, word: &str| words.extend(is_other.then(|| word.to_owned()));
    add(modal.plane != Plane::Xy, modal.plane.word());
    add(modal.retract_to_r, "G99");
    add(modal.arc_distance == ArcDistance::Absolute, "G90.1");
    add(modal.overrides_held.feed && modal.overrides_held.spindle, "M49");
    add(modal.overrides_held.feed && !modal.overrides_held.spindle, "M50 P0");
    add(!modal.overrides_held.feed && modal.overrides_held.spindle, "M51 P0");
    add(modal.no_parking, "M56 P0");
    match modal.path {
        PathControl::ExactPath => {}
        PathControl::ExactStop => words.push("G61.1".into()),
        PathControl::Within(within) => {
            words.push(format!("G64 P{} Q{}", exact(within.path.into()), exact(within.merging.into())));
        }
    }
    words.extend(feed_and_motion(modal, is_fed));
    words.extend((modal.distance == Distance::Incremental).then(|| "G91".to_owned()));
    words.extend((modal.motion == MotionMode::Cancelled).then(|| "G80".to_owned()));
    words
}

/// Returns the words for the feed rate and its mode, the unit, and G0 or G1. `is_fed`: earlier lines of the prologue
/// have set a feed rate, which must be cleared if the state has none.
fn feed_and_motion(modal: &Modal, is_fed: bool) -> Vec<String> {
    let is_linear = modal.straight == MotionMode::Linear;
    let feed_in = |mode| (modal.feed_mode == mode).then_some(modal.feed).filter(|feed| *feed > Decimal::ZERO);
    let feed = feed_in(FeedMode::PerMinute);
    // G1 needs a feed rate. If the state has none, use 1, and clear it below.
    let needed = feed.or(is_linear.then_some(Decimal::from_int(1)));
    let mut words = vec![modal.straight.word().to_owned()];
    if let (Some(feed), Some(word)) = (needed, words.first_mut()) {
        word.push_str(&format!(" F{}", exact(feed.0)));
    }
    if feed.is_none() && (is_fed || is_linear) {
        // Changing the feed mode clears the feed rate.
        words.push("G93".into());
        words.push("G94".into());
    }
    let mut units = Units::Mm;
    if let Some(feed) = feed.filter(|_| modal.feed_in_inches) {
        // Give F in inches, as the job did. A rotary axis takes the number after F as degrees per minute, so it would
        // turn at another rate if F were given in millimetres.
        units = Units::Inch;
        words.push(format!("G20 F{}", exact(feed.0.saturating_mul(10) / 254)));
    }
    words.extend((modal.feed_mode != FeedMode::PerMinute).then(|| modal.feed_mode.word().to_owned()));
    if let Some(feed) = feed_in(FeedMode::PerRevolution) {
        units = if modal.feed_in_inches { Units::Inch } else { Units::Mm };
        words.push(match units {
            Units::Mm => format!("F{}", exact(feed.0)),
            Units::Inch => format!("G20 F{}", exact(feed.0.saturating_mul(10) / 254)),
        });
    }
    words.extend((modal.units != units).then(|| modal.units.word().to_owned()));
    words
}

/// Finds the first line of `rest` that moves in the motion mode of the lines before `rest`, or that selects another
/// motion mode. Also returns the words that this line needs. The mode does not matter after this line.
///
/// # Errors
/// A text for users: no line of the rest moves the machine.
pub fn mode_of(state: &Interpreter<AXES>, rest: &[&[u8]], dialect: Dialect) -> Result<Mode, String> {
    let modal = state.modal();
    if matches!(modal.motion, MotionMode::Rapid | MotionMode::Linear | MotionMode::Cancelled) {
        return Ok(Mode { line: 0, words: None });
    }
    for (line, text) in rest.iter().enumerate() {
        let found = words_of(text);
        let groups = found.iter().filter_map(|(letter, number)| group_of(*letter, *number, dialect).ok());
        // M2 and M30 select another motion mode, too; M0 does not.
        let mut selects = has_word(text, b'M', &[2, 30]);
        // G12 and G13 have the word I, but do not change the motion mode.
        let circles = has_word(text, b'G', &[12, 13]);
        let mut takes_axes = circles;
        for group in groups {
            selects |= group == Group::Motion && !circles;
            takes_axes |= matches!(group, Group::NonModal | Group::ToolLength);
        }
        if selects {
            return Ok(Mode { line, words: None });
        }
        let has = |letter: u8| found.iter().any(|(other, _)| *other == letter);
        if !takes_axes && b"XYZABCIJKR".iter().any(|letter| has(*letter)) {
            let mut words = modal.motion.word().to_owned();
            if let MotionMode::Cycle(kind) = modal.motion {
                words += &cycle(kind, state.cycle_words(), modal.units, has);
            }
            return Ok(Mode { line, words: Some(words) });
        }
    }
    Err("no line moves the machine from there on".into())
}

/// Finds the line of `rest` that continues a curve (G5) of the lines before `rest`: a G5 without I and J. Returns its
/// index; `None` if there is no such line, or if another curve of `rest` comes first. Recognizes only words with
/// literal numbers. `mode`: the motion mode before `rest`.
pub fn goes_on_from_curve(mode: MotionMode, rest: &[&[u8]], dialect: Dialect) -> Option<usize> {
    let mut is_curve = mode == MotionMode::Spline(SplineKind::Cubic);
    for (line, text) in rest.iter().enumerate() {
        let found = words_of(text);
        let group = |(letter, number): &(u8, Decimal)| group_of(*letter, *number, dialect).ok();
        let is_group = |wanted: Group| found.iter().any(|word| group(word) == Some(wanted));
        if is_group(Group::Motion) && !has_word(text, b'G', &[12, 13]) {
            is_curve = has_word(text, b'G', &[5]);
        }
        let has = |letter: u8| found.iter().any(|(other, _)| *other == letter);
        if is_curve && (has(b'X') || has(b'Y')) && !is_group(Group::NonModal) {
            if !has(b'I') {
                return Some(line);
            }
            // This G5 has its own I. A later G5 would continue this curve, so the search ends here. But this line may
            // be skipped if it begins with `/`: then look further.
            if !text.trim_ascii_start().starts_with(b"/") {
                return None;
            }
        }
        if has_word(text, b'M', &[2, 30]) {
            return None;
        }
    }
    None
}

/// Returns the words of a canned cycle (R, Q, P and the depth) that a line lacks. `has` returns whether the line has a
/// word with this letter.
fn cycle(kind: CycleKind, words: &CycleWords, units: Units, has: impl Fn(u8) -> bool) -> String {
    let length = |length: Coordinate| match units {
        Units::Mm => exact(length.0),
        // This is exact if the job gives the length in inches with at most six decimals.
        Units::Inch => exact((length.0 * 10 + length.0.signum() * 127) / 254),
    };
    let depth = words.plane.axes().linear.letter();
    let seconds = words.dwell.ticks() as f64 / 1e6;
    [
        (depth, length(words.depth), true),
        (b'R', length(words.r), true),
        (b'Q', length(words.peck), kind.pecks()),
        (b'P', seconds.to_string(), kind.dwells()),
    ]
    .into_iter()
    .filter(|(letter, _, is_meant)| *is_meant && !has(*letter))
    .map(|(letter, value, _)| format!(" {}{value}", char::from(letter)))
    .collect()
}

/// Returns the words of a line as letter and literal number, without comments. A letter without a valid literal number
/// gets the number `i64::MAX`.
pub fn words_of(line: &[u8]) -> Vec<(u8, Decimal)> {
    let mut words = Vec::new();
    let mut bytes = line.iter().copied().filter(|byte| !matches!(byte, b' ' | b'\t')).peekable();
    while let Some(byte) = bytes.next() {
        match byte.to_ascii_uppercase() {
            b';' => break,
            b'(' => while bytes.next().is_some_and(|byte| byte != b')') {},
            letter @ b'A'..=b'Z' => {
                let mut number = String::new();
                while let Some(digit) = bytes.next_if(|byte| matches!(byte, b'0'..=b'9' | b'.' | b'-' | b'+')) {
                    number.push(char::from(digit));
                }
                let number = number
                    .parse::<f64>()
                    .map_or(Decimal(i64::MAX), |number| Decimal((number * DECIMAL_ONE as f64).round() as i64));
                words.push((letter, number));
            }
            _ => {}
        }
    }
    words
}

/// Returns whether a line has the word `letter` with one of the whole `numbers`.
pub fn has_word(line: &[u8], letter: u8, numbers: &[i32]) -> bool {
    words_of(line)
        .iter()
        .any(|(other, number)| *other == letter && numbers.iter().any(|wanted| *number == Decimal::from_int(*wanted)))
}

/// Inserts words at the beginning of a line, but after a slash and an N word, because these must come first.
pub fn put_in_front(line: &[u8], words: &str) -> Vec<u8> {
    let blank = |byte: &u8| matches!(byte, b' ' | b'\t');
    let skip = |at: usize, is: &dyn Fn(&u8) -> bool| at + line[at..].iter().take_while(|byte| is(byte)).count();
    let mut at = skip(0, &blank);
    if line.get(at) == Some(&b'/') {
        // A number can follow the slash of a line that can be skipped, as in `/1`.
        at = skip(at + 1, &|byte| byte.is_ascii_digit());
    }
    at = skip(at, &blank);
    if line.get(at).is_some_and(|byte| byte.eq_ignore_ascii_case(&b'N')) {
        at = skip(at + 1, &|byte| blank(byte) || byte.is_ascii_digit());
    }
    let (front, behind) = line.split_at(at);
    [front, words.as_bytes(), b" ", behind].concat()
}
