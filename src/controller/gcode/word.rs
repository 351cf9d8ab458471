//! Words: a letter and its number, and what the G and M words of a machine mean.

use super::Dialect;
use super::code::Code;
use super::modal::{ArcDistance, CoordinateSystem, Distance, FeedMode, MotionMode, Plane, ProbeMode, Units};
use super::offsets::StoredOffset;
use crate::error::Error;
use crate::messages::SpindleDirection;
use crate::number::{self, Digits, Number};
use crate::units::Decimal;

/// A letter and its number.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Word {
    pub letter: u8,
    pub value: Decimal,
    /// Digits behind the point.
    pub places: u8,
}

/// The words of a line, up to the first fault.
pub(super) struct Words<'a> {
    rest: &'a [u8],
    digits: Digits,
}

impl<'a> Words<'a> {
    pub fn of(line: &'a [u8], digits: Digits) -> Words<'a> {
        Words { rest: line, digits }
    }

    fn read(&self, letter: u8, number: &'a [u8]) -> Result<(Word, &'a [u8]), Error> {
        if !letter.is_ascii_uppercase() {
            return Err(Error::ExpectedLetter);
        }
        let Number { value, used, places } = number::read(number, self.digits).ok_or(Error::BadNumber)?;
        Ok((Word { letter, value, places }, number.get(used..).unwrap_or(&[])))
    }
}

impl Iterator for Words<'_> {
    type Item = Result<Word, Error>;

    fn next(&mut self) -> Option<Self::Item> {
        let (&letter, number) = self.rest.split_first()?;
        let read = self.read(letter, number);
        self.rest = read.map_or(&[], |(_, rest)| rest);
        Some(read.map(|(word, _)| word))
    }
}

/// A set of letters.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Letters(u32);

impl Letters {
    /// The set of the given capital letters.
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

    /// Whether the letter is in the set.
    pub const fn has(self, letter: u8) -> bool {
        self.0 & Self::bit(letter) != 0
    }

    /// Adds a letter.
    pub fn add(&mut self, letter: u8) {
        self.0 |= Self::bit(letter);
    }

    /// Takes the letters of another set out of this one.
    pub fn remove(&mut self, other: Letters) {
        self.0 &= !other.0;
    }

    /// Whether any letter is left.
    pub const fn is_empty(self) -> bool {
        self.0 == 0
    }
}

/// A modal group: of its words a line may have one.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub(super) enum Group {
    NonModal,
    Motion,
    Plane,
    Distance,
    ArcDistance,
    FeedMode,
    Units,
    CutterCompensation,
    ToolLength,
    CoordinateSystem,
    PathControl,
    Flow,
    Spindle,
    Coolant,
    Override,
}

/// A set of modal groups.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Groups(u16);

impl Groups {
    /// The groups whose words a jog may have.
    pub const OF_JOGS: Groups =
        Groups(1 << Group::NonModal as u16 | 1 << Group::Distance as u16 | 1 << Group::Units as u16);

    /// Adds a group; an error if it is there already.
    pub fn join(&mut self, group: Group) -> Result<(), Error> {
        if self.has(group) {
            return Err(Error::ModalGroupViolation);
        }
        self.0 |= 1 << group as u16;
        Ok(())
    }

    /// Whether a word of the group has been seen.
    pub const fn has(self, group: Group) -> bool {
        self.0 & (1 << group as u16) != 0
    }

    /// Whether every group of this set is in the other.
    pub const fn within(self, other: Groups) -> bool {
        self.0 & !other.0 == 0
    }
}

/// What a command does with the axis words of its line. Only one command may have them.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) enum Claim {
    /// Nothing asks for axis words.
    #[default]
    Nobody,
    /// G10, G28, G30, G92.
    NonModal,
    /// A motion word, or axis words alone.
    Motion,
    /// G43.1, G49.
    ToolLength,
}

/// The command that acts on its own line only.
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
}

/// Tool length offset.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum ToolLength {
    /// G49.
    Cancel,
    /// G43.1.
    Dynamic,
}

/// A G word.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum GWord {
    NonModal(NonModal),
    Motion(MotionMode),
    Plane(Plane),
    Distance(Distance),
    ArcDistance(ArcDistance),
    FeedMode(FeedMode),
    Units(Units),
    /// G40, the only cutter compensation there is.
    NoCutterCompensation,
    ToolLength(ToolLength),
    CoordinateSystem(CoordinateSystem),
    /// G61, the only path control there is.
    ExactPath,
}

impl GWord {
    /// The claim that a code lays on axis words. It is looked at before the code is known to be valid.
    pub fn claim(code: Code, dialect: Dialect) -> Claim {
        match (code.whole, code.hundredths) {
            // G49 needs no axis word, so a line may cancel the offset and move: `G0 G49 ...` opens many programs.
            (49, _) if dialect == Dialect::Seed => Claim::Nobody,
            (0 | 1 | 2 | 3 | 38, _) => Claim::Motion,
            (10 | 28 | 30 | 92, 0) => Claim::NonModal,
            (43 | 49, _) => Claim::ToolLength,
            _ => Claim::Nobody,
        }
    }

    /// The word of a code. A fraction that a command does not have is "not a whole number" where the command has none
    /// at all, and "unsupported" where it has others.
    pub fn of(code: Code, dialect: Dialect) -> Result<GWord, Error> {
        let more = dialect != Dialect::Grbl;
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
            (61, 0) => GWord::ExactPath,
            (80, 0) => GWord::Motion(MotionMode::Cancelled),
            (90, 0) => GWord::Distance(Distance::Absolute),
            (90, 10) if more => GWord::ArcDistance(ArcDistance::Absolute),
            (91, 0) => GWord::Distance(Distance::Incremental),
            (91, 10) => GWord::ArcDistance(ArcDistance::Incremental),
            (92, 0) => GWord::NonModal(NonModal::SetOffset),
            (92, 10) => GWord::NonModal(NonModal::ClearOffset),
            (93, 0) => GWord::FeedMode(FeedMode::InverseTime),
            (94, 0) => GWord::FeedMode(FeedMode::PerMinute),
            (0..=4 | 10 | 17..=21 | 40 | 49 | 53..=59 | 80 | 93 | 94, _) => return Err(Error::IntegerRequired),
            _ => return Err(Error::UnsupportedCommand),
        })
    }

    /// The modal group of the word.
    pub fn group(self) -> Group {
        match self {
            GWord::NonModal(_) => Group::NonModal,
            GWord::Motion(_) => Group::Motion,
            GWord::Plane(_) => Group::Plane,
            GWord::Distance(_) => Group::Distance,
            GWord::ArcDistance(_) => Group::ArcDistance,
            GWord::FeedMode(_) => Group::FeedMode,
            GWord::Units(_) => Group::Units,
            GWord::NoCutterCompensation => Group::CutterCompensation,
            GWord::ToolLength(_) => Group::ToolLength,
            GWord::CoordinateSystem(_) => Group::CoordinateSystem,
            GWord::ExactPath => Group::PathControl,
        }
    }
}

/// An M word.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum MWord {
    /// M0.
    Pause,
    /// M1.
    OptionalPause,
    /// M2, M30.
    End,
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
}

impl MWord {
    /// The word of a code.
    pub fn of(code: Code, dialect: Dialect) -> Result<MWord, Error> {
        let more = dialect != Dialect::Grbl;
        if code.hundredths != 0 {
            return Err(Error::IntegerRequired);
        }
        Ok(match code.whole {
            0 => MWord::Pause,
            1 => MWord::OptionalPause,
            2 | 30 => MWord::End,
            3 => MWord::Spindle(SpindleDirection::Clockwise),
            4 => MWord::Spindle(SpindleDirection::CounterClockwise),
            5 => MWord::Spindle(SpindleDirection::Off),
            7 if more => MWord::Mist,
            8 => MWord::Flood,
            9 => MWord::NoCoolant,
            56 if more => MWord::ParkingOverride,
            _ => return Err(Error::UnsupportedCommand),
        })
    }

    /// The modal group of the word.
    pub fn group(self) -> Group {
        match self {
            MWord::Pause | MWord::OptionalPause | MWord::End => Group::Flow,
            MWord::Spindle(_) => Group::Spindle,
            MWord::Mist | MWord::Flood | MWord::NoCoolant => Group::Coolant,
            MWord::ParkingOverride => Group::Override,
        }
    }
}
