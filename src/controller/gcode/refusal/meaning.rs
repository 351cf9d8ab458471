//! Explains refused lines in which each word can be read, but the words do not fit together or do not fit the present
//! modal state. (`words` explains the other refusals.)

use super::sentence::{digits, millimetres, name, say};
use super::words::{Text, say_limit};
use crate::axes::{Axis, PerAxis};
use crate::error::Error;
use crate::gcode::action::{Action, ProgramPins};
use crate::gcode::modal::{
    ArcDistance, CoordinateSystem, Distance, FeedMode, Modal, MotionMode, PlaneAxes, SplineKind, Units,
};
use crate::gcode::parse::{Parsed, TOOL_MAX};
use crate::gcode::rotation::Angle;
use crate::gcode::state::Interpreter;
use crate::gcode::tools::entry_number;
use crate::gcode::values::{along, whole};
use crate::gcode::word::{Claim, NonModal, ToolLength};
use crate::gcode::{Dialect, Reason};
use crate::units::{Coordinate, DECIMAL_ONE, Decimal, integer_root};

/// The numbers of M62 to M68, in tenths: M62 is 620.
const PINS: [u16; 7] = [620, 630, 640, 650, 660, 670, 680];
/// The numbers of the G words that are allowed in a jog, in tenths: G20 is 200.
const OF_JOGS: [u16; 5] = [200, 210, 530, 900, 910];
/// Limit for the advice to correct I, J or K of an arc. The chord (the line from start to end) may be at most 50 times
/// as long as its part along the axis of the word; otherwise the suggested value would be far off. The constant is the
/// square of 50, because squares are compared.
const FLATTEST: f32 = 2500.0;

/// A refused line whose words could be read.
struct ReadableLine<'a, const N: usize> {
    text: &'a Text<'a>,
    parsed: &'a Parsed<N>,
    modal: &'a Modal,
    state: &'a Interpreter<N>,
    action: &'a Action<N>,
}

impl<const N: usize> Interpreter<N> {
    /// Explains why the words of a line do not fit each other or the present modal state. `action`: what the check had
    /// filled in before it failed.
    #[inline(never)]
    pub(super) fn explain_meaning(
        &self,
        text: &Text,
        parsed: &Parsed<N>,
        error: Error,
        is_jog: bool,
        action: &Action<N>,
        out: &mut Reason,
    ) {
        let line = ReadableLine { text, parsed, modal: &action.modal, state: self, action };
        match error {
            Error::UndefinedFeed => line.feed(is_jog, out),
            Error::InvalidJog => line.jog(out),
            Error::InvalidLineNumber => {
                say(out, "% is too high: line numbers go up to 10000000", &[line.word(b'N')]);
            }
            Error::NegativeValue => line.negative(out),
            Error::IntegerRequired => line.fraction(out),
            Error::NoAxisWords => line.no_axis(out),
            Error::ValueWordMissing => line.missing(out),
            Error::UnsupportedCoordinateSystem => line.system(out),
            Error::UnsupportedCommand => line.kind_of_offset(out),
            Error::NotSupported => line.not_supported(out),
            Error::ModalGroupViolation => {
                let keep = text.code(b'M', &[700, 710, 720, 730]).unwrap_or_default();
                say(out, "% has to be alone in its line", &[keep]);
            }
            Error::G53NeedsMotion => say(out, "G53 needs G0 or G1: % is active", &[line.motion()]),
            Error::AxisWordsUnused => line.axis_unused(out),
            Error::NoPlaneAxisForArc => {
                let [first, second] = line.plane_letters();
                say(out, "% or % is missing in %: ", &[&[first], &[second], line.motion()]);
                say(out, "the plane is %", &[line.modal.plane.word().as_bytes()]);
            }
            Error::InvalidTarget => line.target(out),
            Error::ImpossibleRadius => line.radius(out),
            Error::NoPlaneOffsets => line.no_centre(out),
            Error::UnusedWords => line.unused(is_jog, out),
            Error::ToolLengthAxis if parsed.axes.is_empty() => {
                say(out, "% is missing in G43.1: the length of the tool", &[b"Z"]);
            }
            Error::ToolLengthAxis => say(out, "G43.1 takes Z and no other axis in Grbl's dialect", &[]),
            Error::ToolNumberTooHigh => {
                let letter = if line.has_m61() { b'Q' } else { b'P' };
                say(out, "% is too high: tools go up to ", &[line.word(letter)]);
                digits(out, TOOL_MAX as u64, 1);
            }
            Error::ValueOutOfRange => line.out_of_range(out),
            Error::SpindleNotTurning => {
                say(out, "% stops the spindle, which is off: write M3 and S before it", &[line.motion()]);
            }
            Error::UnknownTool => line.tool(out),
            Error::RetractBelowBottom => {
                let axis = line.modal.plane.axes().linear.letter();
                say(out, "% lies below %, the bottom of the hole", &[line.word(b'R'), line.word(axis)]);
            }
            Error::CycleNeedsPerMinute => say(out, "% needs G94: G93 is active", &[line.motion()]),
            Error::NothingSaved => say(out, "M72 has nothing to restore: M70 or M73 keeps a state before it", &[]),
            Error::TooDeep => {
                let keep = text.code(b'M', &[700, 730]).unwrap_or_default();
                say(out, "no room for %: 8 levels of calls have already saved a state", &[keep]);
            }
            Error::SplineOutsideXy => {
                let aside = line.axes().find(|axis| axis.index() > 1);
                match aside {
                    Some(axis) => say(
                        out,
                        "% does not go with %: write it in a line of its own",
                        &[line.word(axis.letter()), line.motion()],
                    ),
                    None => {
                        say(out, "% needs G17: the plane is %", &[line.motion(), line.modal.plane.word().as_bytes()])
                    }
                }
            }
            Error::NotInRotatedPlane => {
                say(
                    out,
                    "% is not in the plane in which the coordinates are rotated: G69 ends the rotation",
                    &[line.command()],
                );
            }
            Error::RotationActs => say(out, "% does not go while G68 acts: write G69 before it", &[line.command()]),
            Error::ScalingActs => say(out, "% does not go while G51 acts: write G50 before it", &[line.command()]),
            Error::UnequalScaling => {
                say(out, "% would be an ellipse: the factors of G51 in its plane differ", &[line.motion()]);
            }
            Error::ThousandfoldScaling => {
                let word = [b'P', b'I', b'J', b'K']
                    .into_iter()
                    .find(|letter| parsed.value(*letter).0.unsigned_abs() > 100 * DECIMAL_ONE.unsigned_abs());
                say(out, "% is above 100 in G51: P1 is the size as programmed", &[line.word(word.unwrap_or(b'P'))]);
            }
            Error::ControlPointsNotBegun => {
                let word = text.code(b'G', &[52, 53]).unwrap_or(b"this line");
                say(out, "% has no G5.2 before it that begins where the tool is", &[word]);
            }
            Error::ControlPointsNotEnded => {
                say(out, "% comes before G5.3 has ended the control points", &[line.motion()])
            }
            Error::TooFewControlPoints => {
                say(out, "G5.3 needs at least L control points (order L), the start included", &[])
            }
            Error::TooManyControlPoints => say(out, "G5.2 finds no room: divide the curve", &[]),
            Error::NoParallelAxes => say(out, "U, V and W do not go with X, Y and Z in one line", &[]),
            Error::NoSuchPin => line.pin(out),
            Error::BlendingLeftOut => {
                say(out, "% in G64 is left out on this board: write G64 alone", &[line.word(b'P')])
            }
            Error::SplinesLeftOut => {
                say(out, "%: ", &[line.motion()]);
                let _ = out.extend_from_slice(error.text().as_bytes());
            }
            _ => {}
        }
    }
}

impl<'a, const N: usize> ReadableLine<'a, N> {
    /// Returns the word of a letter as it is written, or only the letter if the line has no such word.
    #[inline(never)]
    fn word(&self, letter: u8) -> &'a [u8] {
        const LETTERS: &[u8; 26] = b"ABCDEFGHIJKLMNOPQRSTUVWXYZ";
        let at = usize::from(letter.wrapping_sub(b'A'));
        self.text.word(letter).or_else(|| LETTERS.get(at..=at)).unwrap_or_default()
    }

    /// Returns the motion word in force.
    #[inline(never)]
    fn motion(&self) -> &'static [u8] {
        if self.parsed.extended.ends_control_points {
            return b"G5.3";
        }
        if let Some(clockwise) = self.parsed.extended.circle {
            return if clockwise { b"G12" } else { b"G13" };
        }
        self.modal.motion.word().as_bytes()
    }

    /// Returns the word that uses the axis words of the line: G10 or G28, for example, otherwise the motion word in
    /// force.
    #[inline(never)]
    fn command(&self) -> &'a [u8] {
        let numbers = [40, 100, 280, 281, 300, 301, 510, 520, 530, 680, 920, 921, 922, 923];
        self.text.code(b'G', &numbers).unwrap_or(self.motion())
    }

    fn axes(&self) -> impl Iterator<Item = Axis> {
        Axis::of_machine::<N>().filter(|axis| self.parsed.axes.has(*axis))
    }

    #[inline(never)]
    fn plane_letters(&self) -> [u8; 2] {
        let axes = self.modal.plane.axes();
        let mut letters = [axes.first.letter(), axes.second.letter()];
        letters.sort_unstable();
        letters
    }

    fn has_m61(&self) -> bool {
        self.parsed.extended.tool_number
    }

    #[inline(never)]
    fn value(&self, letter: u8) -> Decimal {
        self.parsed.value(letter)
    }

    #[inline(never)]
    fn feed(&self, is_jog: bool, out: &mut Reason) {
        if self.parsed.values.has(b'F') && self.value(b'F') == Decimal::ZERO {
            say(out, "% is no feed: it must be above 0", &[self.word(b'F')]);
        } else if is_jog {
            say(out, "F is missing: each jog needs its own", &[]);
        } else if self.modal.feed_mode == FeedMode::InverseTime {
            say(out, "F is missing: G93 needs one in each line that moves", &[]);
        } else if self.modal.feed_mode == FeedMode::PerRevolution && self.lacks_speed() {
            say(out, "S is missing: the feed of G95 is F times S", &[]);
        } else {
            say(out, "F is missing: no feed has been set for %", &[self.motion()]);
        }
    }

    /// Returns whether S is 0, which makes the feed of G95 undefined.
    fn lacks_speed(&self) -> bool {
        if self.parsed.values.has(b'S') { self.value(b'S') == Decimal::ZERO } else { self.state.modal.speed == 0.0 }
    }

    #[inline(never)]
    fn jog(&self, out: &mut Reason) {
        let is_strange = |word: &&[u8]| match word.first() {
            Some(b'G') => {
                super::words::tenths_of(word).is_none_or(|number| !OF_JOGS.iter().any(|of| i64::from(*of) == number))
            }
            Some(letter) => matches!(letter, b'M' | b'#'),
            None => false,
        };
        let word = self.text.words().find(is_strange).unwrap_or_default();
        say(out, "% is not for a jog: it takes axis words, F, G20, G21, G53, G90 and G91", &[word]);
    }

    #[inline(never)]
    fn negative(&self, out: &mut Reason) {
        let letter = [b'P', b'Q', b'E'].into_iter().find(|letter| self.value(*letter) < Decimal::ZERO);
        say(out, "% must not be negative", &[self.word(letter.unwrap_or(b'P'))]);
    }

    #[inline(never)]
    fn fraction(&self, out: &mut Reason) {
        let has_fraction = |letter: &u8| whole(self.value(*letter)).is_err();
        let letter = b"THLPQED".iter().copied().find(has_fraction);
        match letter {
            Some(letter) => say(out, "% has to be a whole number", &[self.word(letter)]),
            None => say(out, "% in % is the number of turns: 1 to 1000000", &[self.word(b'P'), self.motion()]),
        }
    }

    #[inline(never)]
    fn no_axis(&self, out: &mut Reason) {
        let command = self.command();
        match self.modal.motion {
            MotionMode::ArcClockwise | MotionMode::ArcCounterClockwise if command == self.motion() => {
                let [first, second] = self.plane_letters();
                say(out, "% and % are missing in %: where the arc ends", &[&[first], &[second], command]);
            }
            _ if self.text.word(b'E').is_some() => {
                say(out, "% is for the extruder of a 3-D printer: make the program for a mill", &[self.word(b'E')]);
            }
            _ => say(out, "no axis word in %: add X, Y or Z", &[command]),
        }
    }

    #[inline(never)]
    fn missing(&self, out: &mut Reason) {
        let has = |letter: u8| self.parsed.values.has(letter);
        let mut lacks = |letter: &str, command: &[u8], what: &str| {
            say(out, letter, &[]);
            say(out, " is missing in %", &[command]);
            say(out, what, &[]);
        };
        if self.parsed.extended.tool_number {
            return lacks("Q", b"M61", ": the number of the tool");
        }
        if let Some(word) = self.text.code(b'G', &[541, 1540])
            && !has(b'P')
        {
            return lacks("P", word, ": P1 to P3");
        }
        match self.parsed.non_modal {
            Some(NonModal::Dwell) if !has(b'P') => return lacks("P", b"G4", ": how many seconds"),
            Some(NonModal::SetSystem) if !has(b'L') && !has(b'P') => {
                return lacks("L", b"G10", ": L2 P1 sets the origin of G54, L20 P1 the place of the tool in it");
            }
            Some(NonModal::SetSystem) if !has(b'P') => return lacks("P", b"G10", ": the number of the tool"),
            Some(NonModal::SetSystem) => {
                return lacks("P", b"G10", ": this P belongs to another word, write two lines");
            }
            _ => {}
        }
        if self.parsed.tool_length == Some(ToolLength::Add) && !has(b'H') {
            return lacks("H", b"G43.2", ": the number of the tool");
        }
        if self.parsed.extended.scaling == Some(true) {
            return lacks("P", b"G51", ": the factor, or I, J and K");
        }
        if self.parsed.extended.rotation == Some(true) {
            return lacks("R", b"G68", ": the angle");
        }
        if let Some(word) = self.text.code(b'M', &PINS)
            && self.missing_of_pin(word, &mut lacks)
        {
            return;
        }
        let motion = self.motion();
        if self.parsed.extended.circle.is_some() {
            return lacks("I", motion, ": the radius of the circle");
        }
        match self.modal.motion {
            MotionMode::Cycle(kind) => {
                let depth = self.modal.plane.axes().linear;
                if !self.parsed.axes.has(depth) {
                    let text = match depth {
                        Axis::X => "X",
                        Axis::Y => "Y",
                        _ => "Z",
                    };
                    lacks(text, motion, ": the bottom of the hole");
                } else if !has(b'R') {
                    lacks("R", motion, ": where the feed begins");
                } else if kind.pecks() && !has(b'Q') {
                    lacks("Q", motion, ": the depth of each peck in program units, above 0, such as Q2");
                } else {
                    lacks("P", motion, ": how many seconds to wait");
                }
            }
            MotionMode::Spline(SplineKind::Nurbs) if !has(b'P') && self.parsed.axes.has(Axis::X) => {
                lacks("P", motion, ": the weight of the point");
            }
            MotionMode::Spline(SplineKind::Nurbs) => say(out, "X and Y are both needed in %", &[motion]),
            MotionMode::Spline(SplineKind::Cubic) if !(has(b'P') && has(b'Q')) => {
                say(out, "P and Q are both needed in %: to its last control point", &[motion]);
            }
            _ => say(out, "I and J are both needed in %: to its first control point", &[motion]),
        }
    }

    /// Explains which word is missing in M62 to M68. Returns `false` if none is missing.
    #[inline(never)]
    fn missing_of_pin(&self, word: &[u8], lacks: &mut impl FnMut(&str, &[u8], &str)) -> bool {
        let has = |letter: u8| self.parsed.values.has(letter);
        match self.parsed.extended.pins {
            Some(62..=65) if !has(b'P') => lacks("P", word, ": the number of the output"),
            Some(66) if !has(b'P') && !has(b'E') => lacks("P", word, ": the number of the input"),
            Some(66) => lacks("Q", word, ": how many seconds to wait at most"),
            Some(67 | 68) if !has(b'E') => lacks("E", word, ": the number of the output"),
            Some(67 | 68) if !has(b'Q') => lacks("Q", word, ": the value of the output"),
            _ => return false,
        }
        true
    }

    #[inline(never)]
    fn system(&self, out: &mut Reason) {
        let (word, last) = match self.text.code(b'G', &[541, 1540]) {
            Some(word) => (word, CoordinateSystem::ALL.len() - CoordinateSystem::OF_GRBL),
            None if self.text.dialect == Dialect::Grbl => (b"G10".as_slice(), CoordinateSystem::OF_GRBL),
            None => (b"G10".as_slice(), CoordinateSystem::ALL.len()),
        };
        say(out, "% in % is no coordinate system: P1 to P", &[self.word(b'P'), word]);
        digits(out, last as u64, 1);
    }

    /// Explains a G10 with an unknown or missing L.
    #[inline(never)]
    fn kind_of_offset(&self, out: &mut Reason) {
        let grbl = self.text.dialect == Dialect::Grbl;
        if !self.parsed.values.has(b'L') {
            say(out, "L is missing in G10: L2 sets the origin, L20 the place of the tool", &[]);
        } else if grbl && self.parsed.values.has(b'R') && self.value(b'L') == Decimal::from_int(2) {
            say(out, "% in G10 is not in Grbl's dialect: $900=1 has it", &[self.word(b'R')]);
        } else if grbl {
            say(out, "% in G10 is not known: Grbl's dialect has L2 and L20", &[self.word(b'L')]);
        } else {
            say(out, "% in G10 is not known: there are L1, L2, L10, L11 and L20", &[self.word(b'L')]);
        }
    }

    #[inline(never)]
    fn not_supported(&self, out: &mut Reason) {
        if self.parsed.extended.circle.is_some() {
            say(
                out,
                "% after a D word: I may be the wall's radius (Haas). If it is the tool path's, write D0 above",
                &[self.motion()],
            );
        } else if let Some(word) = self.text.code(b'M', &[520, 530]) {
            say(out, "% is not supported with this P: there is no adaptive feed, and feed hold stays on", &[word]);
        } else if let Some(word) = self.text.code(b'G', &[80]) {
            say(out, "% is not supported: there is no lathe mode, X is no diameter", &[word]);
        }
    }

    #[inline(never)]
    fn axis_unused(&self, out: &mut Reason) {
        let axis = self.axes().next().map_or(b'X', Axis::letter);
        let (word, extended) = (self.word(axis), &self.parsed.extended);
        if extended.ends_control_points {
            say(out, "% does not go with G5.3: the curve ends where its last G5.2 is", &[word]);
        } else if extended.rotation == Some(true) || extended.scaling == Some(true) {
            let axes = self.modal.plane.axes();
            let is_aside = |axis: &Axis| *axis != axes.first && *axis != axes.second;
            let axis = self.axes().find(is_aside).map_or(axis, Axis::letter);
            say(out, "% does not go with %: it has no such axis", &[self.word(axis), self.command()]);
        } else if matches!(self.modal.motion, MotionMode::Cycle(_)) {
            let axis = self.axes().find(|axis| axis.index() > 2).map_or(axis, Axis::letter);
            say(out, "% does not go with %: turn the part in a line before it", &[self.word(axis), self.motion()]);
        } else {
            say(out, "% has no motion: G80 is active, write G0 or G1", &[word]);
        }
    }

    #[inline(never)]
    fn no_centre(&self, out: &mut Reason) {
        let axes = self.modal.plane.axes();
        let mut letters = [axes.first, axes.second].map(centre_letter);
        letters.sort_unstable();
        let [first, second] = letters;
        if self.parsed.values.has(first) || self.parsed.values.has(second) {
            say(out, "% and % are both needed in %: G90.1 is active", &[&[first], &[second], self.motion()]);
        } else {
            say(out, "% and % are missing in %, or R: the plane is ", &[&[first], &[second], self.motion()]);
            name(out, self.modal.plane.word().as_bytes());
        }
    }

    #[inline(never)]
    fn out_of_range(&self, out: &mut Reason) {
        let value = |letter: u8| self.parsed.values.has(letter).then(|| self.value(letter));
        let extended = &self.parsed.extended;
        if let Some(word) = extended.overrides.and_then(|_| self.text.code(b'M', &[500, 510, 520, 530])) {
            return say(out, "% in % has to be P0 or P1", &[self.word(b'P'), word]);
        }
        if let Some(word) = self.text.code(b'M', &[660]) {
            let is_wait = value(b'L').is_none_or(|l| l <= Decimal::from_int(4));
            return match is_wait {
                true if self.parsed.values.has(b'E') => say(out, "% does not go with E in %", &[self.word(b'L'), word]),
                true => say(out, "% in % must be above 0: seconds to wait", &[self.word(b'Q'), word]),
                false => say(out, "% in % is not known: L0 to L4", &[self.word(b'L'), word]),
            };
        }
        if let Some(word) = self.text.code(b'G', &[300]) {
            return say(out, "% in % is not stored: there are G28 and G30, which is P2", &[self.word(b'P'), word]);
        }
        if extended.circle.is_some() {
            return say(out, "% in % must be above 0: the radius", &[self.word(b'I'), self.motion()]);
        }
        if extended.scaling == Some(true) {
            let z = value(b'K').filter(|factor| *factor < Decimal::ZERO);
            let zero = [b'P', b'I', b'J', b'K'].into_iter().find(|letter| value(*letter) == Some(Decimal::ZERO));
            return match (z, zero) {
                (Some(_), _) => say(out, "% in G51 must be above 0: Z cannot be mirrored", &[self.word(b'K')]),
                (None, zero) => say(out, "% in G51 must not be 0", &[self.word(zero.unwrap_or(b'P'))]),
            };
        }
        match self.modal.motion {
            MotionMode::Spline(_) if value(b'P').is_some_and(|weight| weight <= Decimal::ZERO) => {
                say(out, "% in % must be above 0: the weight", &[self.word(b'P'), self.motion()]);
            }
            MotionMode::Spline(_) => say(out, "% in % is no order that there is", &[self.word(b'L'), self.motion()]),
            _ if value(b'Q').is_some_and(|peck| peck <= Decimal::ZERO) => {
                say(out, "% in % must be above 0: the depth of each peck", &[self.word(b'Q'), self.motion()]);
            }
            _ => say(out, "% in % has to be 1 to 1000000: how many holes", &[self.word(b'L'), self.motion()]),
        }
    }

    #[inline(never)]
    fn tool(&self, out: &mut Reason) {
        let of_table = self.parsed.non_modal == Some(NonModal::SetSystem);
        let letter = if of_table { b'P' } else { b'H' };
        let named = self.value(letter).truncate().unsigned_abs();
        let number = if named == 0 && !of_table { self.action.after.spindle_tool } else { named };
        if of_table && number == 0 {
            say(out, "% is no tool of the table: they begin with P1", &[self.word(b'P')]);
        } else if of_table && !self.parsed.axes.is_empty() && self.has_no_room(number) {
            say(
                out,
                "% does not fit, the tool table is full: remove a tool with G10 L1 P<number> without axes",
                &[self.word(b'P')],
            );
        } else if number == 0 {
            say(out, "G43 has no tool: write H and its number, or M6 before it", &[]);
        } else {
            match self.text.word(letter).filter(|_| named > 0) {
                Some(word) => say(out, "%", &[word]),
                None => {
                    say(out, "T", &[]);
                    digits(out, number.into(), 1);
                    say(out, " in the spindle", &[]);
                }
            }
            say(out, " is not in the table of tools: G10 L1 P", &[]);
            digits(out, number.into(), 1);
            say(out, " Z<length> enters it", &[]);
        }
    }

    fn has_no_room(&self, number: u32) -> bool {
        self.state.tools.slot(entry_number(number, self.state.is_checking())).is_none()
    }

    #[inline(never)]
    fn pin(&self, out: &mut Reason) {
        let (kind, number): (&[u8], u32) = match self.action.pins() {
            Some(ProgramPins::Digital { number, .. }) => (b"output", number),
            Some(ProgramPins::Wait { number, .. }) => (b"input", number),
            Some(ProgramPins::Analog { number, .. }) => (b"analog output", number),
            Some(ProgramPins::ReadAnalog { number }) => (b"analog input", number),
            None => return,
        };
        say(out, "no % ", &[kind]);
        digits(out, number.into(), 1);
        say(out, " on this board", &[]);
    }

    /// Explains words that no command of the line uses.
    #[inline(never)]
    fn unused(&self, is_jog: bool, out: &mut Reason) {
        let unused = self.action.unused.first().copied().unwrap_or_default();
        let is_unused = |word: &&[u8]| word.first().is_some_and(|letter| unused.has(*letter));
        let word = self.text.words().find(is_unused).unwrap_or_default();
        let motion = self.motion();
        let before = self.text.words().take_while(|other| *other != word).last();
        let is_arc = matches!(self.modal.motion, MotionMode::ArcClockwise | MotionMode::ArcCounterClockwise);
        match (word.first(), before) {
            _ if is_jog => say(out, "% is not for a jog", &[word]),
            (Some(b'D' | b'K' | b'L' | b'Q' | b'Z'), _) if self.parsed.extended.circle.is_some() => {
                say(out, "% in % is a word of Haas, where I is the wall: let CAM write G2 and G3", &[word, motion]);
            }
            _ if self.parsed.extended.circle.is_some() => {
                say(out, "% does not go with %: its circle is round the tool", &[word, motion]);
            }
            (Some(b'O'), Some(before)) => say(out, "letter O in %%: write a 0", &[before, word]),
            (Some(b'O'), None) => say(out, "% has to be alone in its line", &[word]),
            (Some(b'I' | b'J' | b'K'), _) if is_arc && self.parsed.values.has(b'R') => {
                say(out, "% does not go with % in an arc: write one of them", &[word, self.word(b'R')]);
            }
            (Some(b'I' | b'J' | b'K'), _) if self.parsed.extended.scaling == Some(true) => {
                say(out, "% does not go with % in G51: write one of them", &[word, self.word(b'P')]);
            }
            (Some(b'E' | b'Q'), _) if self.parsed.extended.pins.is_some() => {
                say(out, "% is used by nothing in this line: take it out", &[word]);
            }
            (Some(b'I' | b'J' | b'K'), _) => {
                say(out, "% belongs to an arc, but % is active: write G2 or G3", &[word, motion]);
            }
            (Some(b'R'), _) if !is_arc => {
                say(out, "% belongs to an arc or a cycle, but % is active", &[word, motion]);
            }
            (Some(b'E'), _) => say(out, "% is for the extruder of a 3-D printer: make the program for a mill", &[word]),
            (Some(b'H'), _) => say(out, "% is used by nothing: G43 is missing", &[word]),
            (Some(b'D'), _) => say(out, "% is used by nothing: there is no cutter compensation", &[word]),
            (Some(letter @ (b'P' | b'Q')), _)
                if matches!(self.modal.motion, MotionMode::Cycle(_)) || *letter == b'Q' =>
            {
                say(out, "% is used by nothing: % takes no %", &[word, motion, &[*letter]]);
            }
            _ => say(out, "% is used by nothing in this line: take it out", &[word]),
        }
    }

    #[inline(never)]
    fn length(&self, value: Decimal) -> Coordinate {
        match self.modal.units {
            Units::Mm => Coordinate::from_mm(value),
            Units::Inch => Coordinate::from_inches(value),
        }
    }

    #[inline(never)]
    fn axis_length(&self, axis: Axis) -> Coordinate {
        let value = self.parsed.axis.get(axis).unwrap_or(Decimal::ZERO);
        if axis.index() < 3 { self.length(value) } else { Coordinate::from_mm(value) }
    }

    #[inline(never)]
    fn offset(&self, axis: Axis) -> Coordinate {
        let system = self.state.offsets.system(self.modal.coordinate_system);
        along(&system, axis) + along(&self.action.g92, axis) + along(&self.action.tool_length, axis)
    }

    /// Returns whether a rotation or scaling is in force. Then the program's coordinates differ from machine
    /// coordinates by more than an offset.
    #[inline(never)]
    fn is_turned(&self) -> bool {
        self.state.rotation.is_some()
            || self.state.scaling.is_some()
            || self.state.offsets.angle(self.modal.coordinate_system) != Angle::ZERO
    }

    /// Returns the target of the line in machine coordinates, without rotation and scaling.
    #[inline(never)]
    fn end(&self) -> PerAxis<Coordinate, N> {
        let machine = self.parsed.non_modal == Some(NonModal::MachineCoordinates);
        PerAxis::from_axis(|axis| {
            let position = along(&self.state.position, axis);
            match (self.parsed.axes.has(axis), self.modal.distance) {
                (false, _) => position,
                (true, _) if machine => self.axis_length(axis),
                (true, Distance::Incremental) => self.axis_length(axis) + position,
                (true, Distance::Absolute) => self.axis_length(axis) + self.offset(axis),
            }
        })
    }

    /// Returns the first axis whose word or target is beyond ±50 m, the range of coordinates; `None` if there is none.
    #[inline(never)]
    fn too_far(&self) -> Option<Axis> {
        let end = self.end();
        let mut axes = self.axes();
        axes.find(|axis| !self.axis_length(*axis).in_range() || !along(&end, *axis).in_range())
    }

    #[inline(never)]
    fn target(&self, out: &mut Reason) {
        let sets =
            matches!(self.parsed.non_modal, Some(NonModal::SetSystem | NonModal::SetOffset | NonModal::LocalOffset));
        let sets = sets || self.parsed.claim == Claim::ToolLength;
        if sets || self.parsed.tool_length.is_some() && self.too_far().is_none() {
            let axis = self.too_far().or_else(|| self.axes().next()).map_or(b'X', Axis::letter);
            return say(out, "the offset of % would be beyond 50 m", &[self.word(axis)]);
        }
        if let Some(axis) = self.too_far() {
            return say(out, "% is beyond 50 m from the origin of the machine", &[self.word(axis.letter())]);
        }
        match self.modal.motion {
            MotionMode::ArcClockwise | MotionMode::ArcCounterClockwise
                if !matches!(self.parsed.non_modal, Some(NonModal::Go(_))) =>
            {
                self.arc(out);
            }
            MotionMode::Probe(_) if self.end() == self.state.position => {
                say(out, "% ends where it begins: name a place to probe towards", &[self.motion()]);
            }
            MotionMode::Spline(_) => say(out, "a control point of % is beyond 50 m", &[self.motion()]),
            _ => {
                say(out, "% leads beyond ", &[self.command()]);
                say_limit(out, Coordinate::LIMIT.0);
            }
        }
    }

    /// Returns the vector from the start of the arc to its end, along the axes of its plane.
    #[inline(never)]
    fn chord(&self, axes: PlaneAxes) -> [i64; 2] {
        let end = self.end();
        [axes.first, axes.second].map(|axis| (along(&end, axis) - along(&self.state.position, axis)).0)
    }

    #[inline(never)]
    fn arc(&self, out: &mut Reason) {
        let axes = self.modal.plane.axes();
        let motion = self.motion();
        let too_far = [b'I', b'J', b'K', b'R'].into_iter().find(|letter| !self.length(self.value(*letter)).in_range());
        if let Some(letter) = too_far {
            return say(out, "% is beyond 50 m", &[self.word(letter)]);
        }
        let chord = self.chord(axes);
        if self.parsed.values.has(b'R') {
            return say(out, "% with R ends where it begins: write I and J for a full circle", &[motion]);
        }
        if self.is_turned() {
            return say(out, "the radii of % differ at its ends: correct its centre or its end", &[motion]);
        }
        let absolute = self.text.dialect != Dialect::Grbl && self.modal.arc_distance == ArcDistance::Absolute;
        let centre = [axes.first, axes.second].map(|axis| {
            let value = self.length(self.value(centre_letter(axis)));
            let here = along(&self.state.position, axis) - self.offset(axis);
            if absolute { (value - here).0 } else { value.0 }
        });
        let ([x, y], [i, j]) = (chord, centre);
        let (at_start, at_end) = (length([i, j]), length([x.saturating_sub(i), y.saturating_sub(j)]));
        say(out, "the radius of % is ", &[motion]);
        millimetres(out, at_start);
        say(out, " mm at its start, ", &[]);
        millimetres(out, at_end);
        say(out, " at its end. ", &[]);
        if absolute || self.modal.units == Units::Inch || [x, y] == [0, 0] {
            return say(out, "Correct I, J or the end", &[]);
        }
        // Usually either I or J is wrong. Suggest for each of the two a value that fits the other. With the chord (x,
        // y), a centre at (i, j) is equally far from both ends of the arc if x * i + y * j = (x² + y²) / 2.
        let [first, second] = [axes.first, axes.second].map(centre_letter);
        let square = x as f32 * x as f32 + y as f32 * y as f32;
        let other = |across: i64, along: i64, kept: i64| {
            let value = Coordinate(((square / 2.0 - along as f32 * kept as f32) / across as f32) as i64);
            // If the chord is nearly at right angles to the axis of this word, the suggested value would be far off.
            (across as f32 * across as f32 * FLATTEST >= square && value.in_range()).then_some(value.0)
        };
        let (other_i, other_j) = (other(x, y, j), other(y, x, i));
        let (slip_i, slip_j) = (other_i.filter(|other| is_slip(i, *other)), other_j.filter(|other| is_slip(j, *other)));
        // If only one of the two can be a slip, it is the wrong word.
        let (other_i, other_j) = match (slip_i, slip_j) {
            (Some(_), None) => (other_i, None),
            (None, Some(_)) => (None, other_j),
            _ => (other_i, other_j),
        };
        let centres = [other_j.map(|j| [i, j]), other_i.map(|i| [i, j])];
        let mut before = "Write ";
        for [i, j] in centres.into_iter().flatten() {
            let length = out.len();
            say(out, before, &[]);
            let _ = out.push(first);
            millimetres(out, i);
            say(out, " ", &[]);
            let _ = out.push(second);
            millimetres(out, j);
            // There is no room for the whole suggestion. Remove it, because a truncated number would be a wrong one.
            if out.is_full() {
                return out.truncate(length);
            }
            before = ", or ";
        }
    }

    #[inline(never)]
    fn radius(&self, out: &mut Reason) {
        say(out, "% is too small for %: ", &[self.word(b'R'), self.motion()]);
        if self.is_turned() {
            return say(out, "at least half the distance from start to end", &[]);
        }
        say(out, "at least ", &[]);
        millimetres(out, rounded_up(length(self.chord(self.modal.plane.axes())) / 2));
        say(out, " mm (half the chord)", &[]);
    }
}

/// Returns whether the two values have the same digits but for zeros, in any order. Then one is probably a slip of the
/// other: a lost zero, a shifted point, two swapped digits or a wrong sign. Digits beyond 1 um do not count.
#[inline(never)]
fn is_slip(written: i64, meant: i64) -> bool {
    const MICROMETRE: i64 = DECIMAL_ONE / 1000;
    let digits = |value: i64| {
        let mut rest = (value.unsigned_abs() + MICROMETRE.unsigned_abs() / 2) / MICROMETRE.unsigned_abs();
        let mut counts = [0_u8; 10];
        while rest > 0 {
            if let Some(count) = counts.get_mut((rest % 10) as usize) {
                *count += 1;
            }
            rest /= 10;
        }
        counts[0] = 0;
        counts
    };
    digits(written) == digits(meant)
}

#[inline(never)]
fn length([x, y]: [i64; 2]) -> i64 {
    let square = |part: i64| u128::from(part.unsigned_abs()) * u128::from(part.unsigned_abs());
    i64::try_from(integer_root(square(x).saturating_add(square(y)))).unwrap_or(i64::MAX)
}

/// Rounds a length up to whole micrometres, because a message prints no smaller digits.
#[inline(never)]
fn rounded_up(length: i64) -> i64 {
    const MICROMETRE: i64 = DECIMAL_ONE / 1000;
    (length + MICROMETRE - 1) / MICROMETRE * MICROMETRE
}

/// Returns the letter of the arc centre along an axis.
#[inline(never)]
fn centre_letter(axis: Axis) -> u8 {
    match axis {
        Axis::X => b'I',
        Axis::Y => b'J',
        _ => b'K',
    }
}
