//! Words of a line. Reads letters and numbers one by one, and translates G and M numbers into their meaning, which
//! depends on the dialect and the build. Each G or M word has a modal group.

use super::Dialect;
use super::code::Code;
use super::modal::{
    ArcDistance, CoordinateSystem, CycleKind, Distance, FeedMode, MotionMode, PathControl, Plane, ProbeMode,
    SplineKind, Units,
};
use super::offsets::StoredOffset;
use super::state::Interpreter;
use crate::error::Error;
use crate::image::FULL_IMAGE;
use crate::messages::SpindleDirection;
use crate::number::{self, Digits, Number};
use crate::units::Decimal;

/// A letter and the number after it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Word {
    pub letter: u8,
    pub value: Decimal,
    /// Number of decimal places as written; for a computed value, the number of places that the value has.
    pub places: u8,
}

/// The letter under which `Words` returns an assignment to a parameter (`#1=5`). The other words of the line still see
/// the old value.
pub(super) const ASSIGNMENT: u8 = b'#';

/// Iterator over the words of a line; ends at the first error.
pub(super) struct Words<'a, const N: usize> {
    rest: &'a [u8],
    digits: Digits,
    /// The interpreter that computes values and stores the assigned parameters; `None` in Grbl's dialect, which has no
    /// parameters.
    state: Option<&'a mut Interpreter<N>>,
}

impl<'a, const N: usize> Words<'a, N> {
    pub fn of(line: &'a [u8], dialect: Dialect, state: &'a mut Interpreter<N>) -> Self {
        match dialect {
            Dialect::Grbl => Self { rest: line, digits: Digits::Eight, state: None },
            _ => Self { rest: line, digits: Digits::Exact, state: Some(state) },
        }
    }

    #[inline]
    fn read(&mut self, letter: u8, number: &'a [u8]) -> Result<(Word, &'a [u8]), Error> {
        if !letter.is_ascii_uppercase() {
            return self.assign(letter, number);
        }
        match number::read_here(number, self.digits) {
            Some(Number { value, used, places }) => {
                Ok((Word { letter, value, places }, number.get(used..).unwrap_or(&[])))
            }
            None => self.state.as_ref().ok_or(Error::BadNumber)?.compute(letter, number),
        }
    }

    fn assign(&mut self, letter: u8, text: &'a [u8]) -> Result<(Word, &'a [u8]), Error> {
        match &mut self.state {
            // In ISO code, a colon stands for the O of a program number.
            Some(_) if FULL_IMAGE && letter == b':' && text.first().is_some_and(u8::is_ascii_digit) => {
                self.read(b'O', text)
            }
            Some(state) if letter == ASSIGNMENT => {
                let rest = state.assign(text)?;
                Ok((Word { letter, value: Decimal::ZERO, places: 0 }, rest))
            }
            // Polar coordinates of LinuxCNC (`@` radius, `^` angle).
            Some(_) if matches!(letter, b'@' | b'^') => Err(Error::NotSupported),
            _ => Err(Error::ExpectedLetter),
        }
    }
}

impl<const N: usize> Iterator for Words<'_, N> {
    type Item = Result<Word, Error>;

    fn next(&mut self) -> Option<Self::Item> {
        let (&letter, number) = self.rest.split_first()?;
        let read = self.read(letter, number);
        self.rest = read.map_or(&[], |(_, rest)| rest);
        Some(read.map(|(word, _)| word))
    }
}

/// A set of capital letters, one bit for each.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Letters(u32);

impl Letters {
    /// Creates the set of the given capital letters.
    pub const fn of(letters: &[u8]) -> Letters {
        let mut set = 0;
        let mut rest = letters;
        while let [letter, tail @ ..] = rest {
            set |= Self::bit(*letter);
            rest = tail;
        }
        Letters(set)
    }

    const fn bit(letter: u8) -> u32 {
        1 << (letter.wrapping_sub(b'A') & 31)
    }

    pub const fn count(self) -> usize {
        self.0.count_ones() as usize
    }

    pub const fn has(self, letter: u8) -> bool {
        self.0 & Self::bit(letter) != 0
    }

    /// Returns whether the two sets have a letter in common.
    pub const fn has_any(self, others: Letters) -> bool {
        self.0 & others.0 != 0
    }

    pub fn add(&mut self, letter: u8) {
        self.0 |= Self::bit(letter);
    }

    pub fn remove(&mut self, other: Letters) {
        self.0 &= !other.0;
    }

    /// Returns the letters that are also in the other set.
    pub const fn shared_with(self, others: Letters) -> Letters {
        Letters(self.0 & others.0)
    }

    pub const fn is_empty(self) -> bool {
        self.0 == 0
    }
}

/// Modal group. A line can have at most one word of each group.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub enum Group {
    /// G4, G10, G28, G53, G92 and the like, which act on their own line only.
    NonModal,
    /// G0 to G3, G5 to G5.3, G12, G13, G31, G38.2 to G38.5, G80 and the canned cycles.
    Motion,
    /// G17 to G19.
    Plane,
    /// G90, G91.
    Distance,
    /// G90.1, G91.1.
    ArcDistance,
    /// G93, G94, G95.
    FeedMode,
    /// G20, G21; also G70 and G71, as in Mach.
    Units,
    /// G98, G99.
    Retract,
    /// G40.
    CutterCompensation,
    /// G43, G43.1, G43.2, G49.
    ToolLength,
    /// G54 to G59.3, G54.1, G154.
    CoordinateSystem,
    /// G61, G61.1, G64.
    PathControl,
    /// M0, M1, M2, M30, M60.
    Flow,
    /// M3 to M5.
    Spindle,
    /// M7 to M9.
    Coolant,
    /// M56.
    Override,
    /// M6, M61.
    ToolChange,
    /// M48 to M53.
    OverridesHeld,
    /// M62 to M68.
    Pins,
    /// M70 to M73.
    Keep,
    /// G50, G51.
    Scaling,
    /// G68, G69.
    Rotation,
    /// G97, M29.
    SpindleMode,
    /// G8, G103, G187.
    LookAhead,
    /// G15.
    Polar,
    /// G67.
    ModalCall,
}

/// Returns the modal group of a G or M word, such as G54.1. `letter`: `G` or `M`.
///
/// # Errors
/// The error with which a line is refused because the dialect or the build lacks this word.
pub fn group_of(letter: u8, number: Decimal, dialect: Dialect) -> Result<Group, Error> {
    let code = Code::of(number);
    match letter {
        b'G' => GWord::of(code, dialect).map(GWord::group),
        b'M' => MWord::of(code, dialect).map(MWord::group),
        _ => Err(Error::UnsupportedCommand),
    }
}

/// A set of modal groups, one bit for each.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Groups(u32);

impl Groups {
    /// The groups whose words a jog may have.
    pub const OF_JOGS: Groups =
        Groups(1 << Group::NonModal as u32 | 1 << Group::Distance as u32 | 1 << Group::Units as u32);

    /// The group of motion words alone.
    pub const OF_MOTION: Groups = Groups(1 << Group::Motion as u32);

    /// The groups whose words affect only the motion of a line.
    pub const OF_MOVES: Groups = Groups(
        1 << Group::Motion as u32
            | 1 << Group::Plane as u32
            | 1 << Group::Distance as u32
            | 1 << Group::ArcDistance as u32
            | 1 << Group::FeedMode as u32
            | 1 << Group::Units as u32,
    );

    /// The group of M70 to M73.
    pub const KEEP: Groups = Groups(1 << Group::Keep as u32);

    /// Adds a group, or returns an error if the set has it already.
    pub fn join(&mut self, group: Group) -> Result<(), Error> {
        if self.has(group) {
            return Err(Error::ModalGroupViolation);
        }
        self.0 |= 1 << group as u32;
        Ok(())
    }

    pub const fn has(self, group: Group) -> bool {
        self.0 & (1 << group as u32) != 0
    }

    /// Returns whether every group of this set is in the other.
    pub const fn within(self, other: Groups) -> bool {
        self.0 & !other.0 == 0
    }
}

/// Command that uses the axis words of a line. A line can have at most one such command.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) enum Claim {
    /// No command uses axis words.
    #[default]
    Nobody,
    /// G10, G28, G30, G51, G52, G68, G92.
    NonModal,
    /// A motion word, or axis words without any command, which move in the motion mode in force.
    Motion,
    /// G43.1; in Grbl's dialect also G49.
    ToolLength,
}

/// A command that acts only on its own line.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum NonModal {
    /// G4.
    Dwell,
    /// G10.
    SetSystem,
    /// G28, G30.
    Go(StoredOffset),
    /// G28.1, G30.1.
    StorePosition(StoredOffset),
    /// G53.
    MachineCoordinates,
    /// G92.
    SetOffset,
    /// G92.1.
    ClearOffset,
    /// G92.2.
    SuspendOffset,
    /// G92.3.
    RestoreOffset,
    /// G52.
    LocalOffset,
}

/// A word that sets the tool length offset.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum ToolLength {
    /// G49: the offset becomes 0.
    Cancel,
    /// G43.1: the axis words give the offset.
    Dynamic,
    /// G43: the offset is that of tool H.
    FromTable,
    /// G43.2: the offset of tool H is added to the offset in force.
    Add,
}

/// The meaning of a G word. Different words can have the same meaning: G54.1 and G154, for example.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum GWord {
    NonModal(NonModal),
    Motion(MotionMode),
    Plane(Plane),
    Distance(Distance),
    ArcDistance(ArcDistance),
    FeedMode(FeedMode),
    Units(Units),
    /// G98 (`false`), G99 (`true`): whether cycles retract to R.
    Retract(bool),
    /// G40. Other words of cutter compensation are not supported.
    NoCutterCompensation,
    ToolLength(ToolLength),
    CoordinateSystem(CoordinateSystem),
    /// G61, G61.1, G64.
    Path(PathControl),
    /// G68 (`true`), G69 (`false`).
    Rotation(bool),
    /// G51 (`true`), G50 (`false`).
    Scaling(bool),
    /// G5.3.
    EndOfControlPoints,
    /// G31, a probing move. The word does not stay in force.
    ProbeOnce,
    /// G12 (`true`), G13 (`false`): a circle round the position of the tool, clockwise or counterclockwise. The word
    /// does not stay in force.
    Circle(bool),
    /// G54.1, G154: selects a coordinate system by P.
    SystemByNumber,
    /// G8, G103, G187, with the number of the word. On other controls these words switch the look-ahead.
    LookAhead(u8),
    /// A word that needs no action, with its group. G97 (S in revolutions per minute) and G15 (no polar coordinates)
    /// select the only mode that exists. G67 has already been executed, by `computed`.
    AsItIs(Group),
}

impl GWord {
    /// Returns the command by which a G code would use the axis words of its line. The code need not be a valid one.
    pub fn claim(code: Code, dialect: Dialect) -> Claim {
        match (code.whole, code.hundredths) {
            // G43, G43.2 and G49 use no axis words, so the same line can also move: many programs begin with `G0 G49
            // ...`.
            (43, 0 | 20) | (49, _) if dialect != Dialect::Grbl => Claim::Nobody,
            (0 | 1 | 2 | 3 | 38, _) => Claim::Motion,
            (12 | 13 | 31, 0) if FULL_IMAGE && dialect != Dialect::Grbl => Claim::Motion,
            (5, 0 | 10 | 20) if dialect != Dialect::Grbl => Claim::Motion,
            (10 | 28 | 30 | 92, 0) => Claim::NonModal,
            (51 | 52 | 68, 0) if dialect != Dialect::Grbl => Claim::NonModal,
            (43 | 49, _) => Claim::ToolLength,
            (73 | 81..=83 | 85 | 86 | 88 | 89, 0) if dialect != Dialect::Grbl => Claim::Motion,
            _ => Claim::Nobody,
        }
    }

    /// Looks up a code among words that Grbl does not have: for canned cycles, the tool table and offsets.
    fn extended(code: Code) -> Option<GWord> {
        Some(match (code.whole, code.hundredths) {
            (43, 0) => GWord::ToolLength(ToolLength::FromTable),
            (43, 20) => GWord::ToolLength(ToolLength::Add),
            (52, 0) => GWord::NonModal(NonModal::LocalOffset),
            (73, 0) => GWord::Motion(MotionMode::Cycle(CycleKind::ChipBreak)),
            (81, 0) => GWord::Motion(MotionMode::Cycle(CycleKind::Drill)),
            (82, 0) => GWord::Motion(MotionMode::Cycle(CycleKind::DrillDwell)),
            (83, 0) => GWord::Motion(MotionMode::Cycle(CycleKind::Peck)),
            (85, 0) => GWord::Motion(MotionMode::Cycle(CycleKind::Bore)),
            (86, 0) => GWord::Motion(MotionMode::Cycle(CycleKind::BoreStop)),
            (88, 0) => GWord::Motion(MotionMode::Cycle(CycleKind::BoreManual)),
            (89, 0) => GWord::Motion(MotionMode::Cycle(CycleKind::BoreDwell)),
            (98, 0) => GWord::Retract(false),
            (99, 0) => GWord::Retract(true),
            (92, 20) => GWord::NonModal(NonModal::SuspendOffset),
            (92, 30) => GWord::NonModal(NonModal::RestoreOffset),
            _ => return None,
        })
    }

    /// Looks up a code among words that come from other controls and are common in CAM programs.
    fn of_cam(code: Code) -> Option<GWord> {
        Some(match (code.whole, code.hundredths) {
            (12 | 13, 0) => GWord::Circle(code.whole == 12),
            (31, 0) => GWord::ProbeOnce,
            // G70 selects inch and G71 mm, as in Mach.
            (70, 0) => GWord::Units(Units::Inch),
            (71, 0) => GWord::Units(Units::Mm),
            (54, 10) | (154, 0) => GWord::SystemByNumber,
            (8 | 103 | 187, 0) => GWord::LookAhead(code.whole),
            (95, 0) => GWord::FeedMode(FeedMode::PerRevolution),
            // G15 ends polar coordinates, which do not exist. G67 ends a modal call; `computed` has already done that.
            (15, 0) => GWord::AsItIs(Group::Polar),
            (67, 0) => GWord::AsItIs(Group::ModalCall),
            _ => return None,
        })
    }

    /// Looks up a code among the words that Grbl's dialect lacks (see `of_cam` and `extended`). Returns an error for a
    /// number that is not a code, and for cutter compensation.
    fn beyond_grbl(code: Code) -> Option<Result<GWord, Error>> {
        match (code.whole, code.hundredths) {
            (_, Code::NO_CODE) => return Some(Err(Error::UnsupportedCommand)),
            (41 | 42, 0 | 10) => return Some(Err(Error::CutterCompensation)),
            _ => {}
        }
        if FULL_IMAGE && let Some(word) = Self::of_cam(code) {
            return Some(Ok(word));
        }
        Self::extended(code).map(Ok)
    }

    /// Returns the word of a code. The errors for an unknown fraction are those of Grbl: [`Error::UnsupportedCommand`]
    /// for G38.9, because other words of G38 have a fraction, and [`Error::IntegerRequired`] for G1.5.
    pub fn of(code: Code, dialect: Dialect) -> Result<GWord, Error> {
        let more = dialect != Dialect::Grbl;
        if more && let Some(word) = Self::beyond_grbl(code) {
            return word;
        }
        Ok(match (code.whole, code.hundredths) {
            (0, 0) => GWord::Motion(MotionMode::Rapid),
            (1, 0) => GWord::Motion(MotionMode::Linear),
            (2, 0) => GWord::Motion(MotionMode::ArcClockwise),
            (3, 0) => GWord::Motion(MotionMode::ArcCounterClockwise),
            (4, 0) => GWord::NonModal(NonModal::Dwell),
            (10, 0) => GWord::NonModal(NonModal::SetSystem),
            (17, 0) => GWord::Plane(Plane::Xy),
            (18, 0) => GWord::Plane(Plane::Zx),
            (19, 0) => GWord::Plane(Plane::Yz),
            (20, 0) => GWord::Units(Units::Inch),
            (21, 0) => GWord::Units(Units::Mm),
            (28, 0) => GWord::NonModal(NonModal::Go(StoredOffset::G28)),
            (28, 10) => GWord::NonModal(NonModal::StorePosition(StoredOffset::G28)),
            (30, 0) => GWord::NonModal(NonModal::Go(StoredOffset::G30)),
            (30, 10) => GWord::NonModal(NonModal::StorePosition(StoredOffset::G30)),
            (38, 20) => GWord::Motion(MotionMode::Probe(ProbeMode { away: false, alarm: true })),
            (38, 30) => GWord::Motion(MotionMode::Probe(ProbeMode { away: false, alarm: false })),
            (38, 40) => GWord::Motion(MotionMode::Probe(ProbeMode { away: true, alarm: true })),
            (38, 50) => GWord::Motion(MotionMode::Probe(ProbeMode { away: true, alarm: false })),
            (40, 0) => GWord::NoCutterCompensation,
            (43, 10) => GWord::ToolLength(ToolLength::Dynamic),
            (49, 0) => GWord::ToolLength(ToolLength::Cancel),
            (53, 0) => GWord::NonModal(NonModal::MachineCoordinates),
            (54, 0) => GWord::CoordinateSystem(CoordinateSystem::G54),
            (55, 0) => GWord::CoordinateSystem(CoordinateSystem::G55),
            (56, 0) => GWord::CoordinateSystem(CoordinateSystem::G56),
            (57, 0) => GWord::CoordinateSystem(CoordinateSystem::G57),
            (58, 0) => GWord::CoordinateSystem(CoordinateSystem::G58),
            (59, 0) => GWord::CoordinateSystem(CoordinateSystem::G59),
            (59, 10) if more => GWord::CoordinateSystem(CoordinateSystem::G59_1),
            (59, 20) if more => GWord::CoordinateSystem(CoordinateSystem::G59_2),
            (59, 30) if more => GWord::CoordinateSystem(CoordinateSystem::G59_3),
            (61, 0) => GWord::Path(PathControl::ExactPath),
            (61, 10) if more => GWord::Path(PathControl::ExactStop),
            (64, 0) if more => GWord::Path(PathControl::ExactPath),
            (5, 0 | 10 | 20 | 30) | (50 | 51 | 68 | 69, 0) if more => return Self::by_feature(code),
            (97, 0) if more => GWord::AsItIs(Group::SpindleMode),
            (80, 0) => GWord::Motion(MotionMode::Cancelled),
            (90, 0) => GWord::Distance(Distance::Absolute),
            (90, 10) if more => GWord::ArcDistance(ArcDistance::Absolute),
            (91, 0) => GWord::Distance(Distance::Incremental),
            (91, 10) => GWord::ArcDistance(ArcDistance::Incremental),
            (92, 0) => GWord::NonModal(NonModal::SetOffset),
            (92, 10) => GWord::NonModal(NonModal::ClearOffset),
            (93, 0) => GWord::FeedMode(FeedMode::InverseTime),
            (94, 0) => GWord::FeedMode(FeedMode::PerMinute),
            (8, 0) if more => return Err(Error::NotSupported),
            (7 | 12 | 13 | 16 | 31 | 33 | 51 | 65 | 66 | 68 | 74 | 76 | 84 | 87 | 96, _) if more => {
                return Err(Error::NotSupported);
            }
            (15 | 95, _) if more && !FULL_IMAGE => return Err(Error::NotSupported),
            (54 | 59, _) if more => return Err(Error::UnsupportedCoordinateSystem),
            (0..=4 | 10 | 17..=21 | 40 | 49 | 53..=59 | 80 | 93 | 94, _) => return Err(Error::IntegerRequired),
            _ => return Err(Error::UnsupportedCommand),
        })
    }

    /// Looks up a code among the words of splines, rotation and scaling. If this build lacks the feature that a word
    /// needs, the error names this feature. G50 and G69 are accepted in every build.
    fn by_feature(code: Code) -> Result<GWord, Error> {
        match (code.whole, code.hundredths) {
            (5, _) if !FULL_IMAGE => Err(Error::SplinesLeftOut),
            (5, 0) => Ok(GWord::Motion(MotionMode::Spline(SplineKind::Cubic))),
            (5, 10) => Ok(GWord::Motion(MotionMode::Spline(SplineKind::Quadratic))),
            (5, 20) => Ok(GWord::Motion(MotionMode::Spline(SplineKind::Nurbs))),
            (5, _) => Ok(GWord::EndOfControlPoints),
            (51, _) if !FULL_IMAGE => Err(Error::ScalingLeftOut),
            (68, _) if !FULL_IMAGE => Err(Error::RotationLeftOut),
            (50 | 51, _) => Ok(GWord::Scaling(code.whole == 51)),
            _ => Ok(GWord::Rotation(code.whole == 68)),
        }
    }

    pub fn group(self) -> Group {
        match self {
            GWord::NonModal(_) => Group::NonModal,
            GWord::Motion(_) => Group::Motion,
            GWord::Plane(_) => Group::Plane,
            GWord::Distance(_) => Group::Distance,
            GWord::ArcDistance(_) => Group::ArcDistance,
            GWord::FeedMode(_) => Group::FeedMode,
            GWord::Units(_) => Group::Units,
            GWord::Retract(_) => Group::Retract,
            GWord::NoCutterCompensation => Group::CutterCompensation,
            GWord::ToolLength(_) => Group::ToolLength,
            GWord::CoordinateSystem(_) => Group::CoordinateSystem,
            GWord::Path(_) => Group::PathControl,
            GWord::Rotation(_) => Group::Rotation,
            GWord::Scaling(_) => Group::Scaling,
            GWord::EndOfControlPoints | GWord::ProbeOnce | GWord::Circle(_) => Group::Motion,
            GWord::SystemByNumber => Group::CoordinateSystem,
            GWord::LookAhead(_) => Group::LookAhead,
            GWord::AsItIs(group) => group,
        }
    }
}

/// The meaning of an M word. M0 and M60 have the same meaning, and so have M2 and M30.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum MWord {
    /// M0, M60.
    Pause,
    /// M1.
    OptionalPause,
    /// M2, M30.
    End,
    /// M6.
    ToolChange,
    /// M61.
    ToolNumber,
    /// M62 to M68, by number.
    Pins(u8),
    /// M3, M4, M5.
    Spindle(SpindleDirection),
    /// M7.
    Mist,
    /// M8.
    Flood,
    /// M9.
    NoCoolant,
    /// M56.
    ParkingOverride,
    /// M48 to M53, by number.
    Overrides(u8),
    /// M70 to M73, by number.
    Keep(u8),
    /// M29.
    RigidTapping,
}

impl MWord {
    /// Returns the meaning of an M word in the dialect; an error if the dialect or the build lacks the word.
    pub fn of(code: Code, dialect: Dialect) -> Result<MWord, Error> {
        let more = dialect != Dialect::Grbl;
        match code.hundredths {
            0 => {}
            Code::NO_CODE if more => return Err(Error::UnsupportedCommand),
            _ => return Err(Error::IntegerRequired),
        }
        Ok(match code.whole {
            0 => MWord::Pause,
            1 => MWord::OptionalPause,
            2 | 30 => MWord::End,
            3 => MWord::Spindle(SpindleDirection::Clockwise),
            4 => MWord::Spindle(SpindleDirection::CounterClockwise),
            5 => MWord::Spindle(SpindleDirection::Off),
            6 if more => MWord::ToolChange,
            7 if more => MWord::Mist,
            8 => MWord::Flood,
            9 => MWord::NoCoolant,
            29 if more && FULL_IMAGE => MWord::RigidTapping,
            48..=53 if more => MWord::Overrides(code.whole),
            56 if more => MWord::ParkingOverride,
            60 if more => MWord::Pause,
            61 if more => MWord::ToolNumber,
            62..=68 if more && !FULL_IMAGE => return Err(Error::NoSuchPin),
            62..=68 if more => MWord::Pins(code.whole),
            73 if more && !FULL_IMAGE => return Err(Error::ExpressionsLeftOut),
            70..=73 if more => MWord::Keep(code.whole),
            19 | 97..=99 if more => return Err(Error::NotSupported),
            _ => return Err(Error::UnsupportedCommand),
        })
    }

    pub fn group(self) -> Group {
        match self {
            MWord::Pause | MWord::OptionalPause | MWord::End => Group::Flow,
            MWord::ToolChange | MWord::ToolNumber => Group::ToolChange,
            MWord::Pins(_) => Group::Pins,
            MWord::Spindle(_) => Group::Spindle,
            MWord::Mist | MWord::Flood | MWord::NoCoolant => Group::Coolant,
            MWord::ParkingOverride => Group::Override,
            MWord::Overrides(_) => Group::OverridesHeld,
            MWord::Keep(_) => Group::Keep,
            MWord::RigidTapping => Group::SpindleMode,
        }
    }
}
