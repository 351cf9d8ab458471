//! The first step of checking a line: sorts its words into modal words, M words, axis words and values. Refuses
//! repeated letters, two words of one group, and values out of range. Nothing here depends on the modal state.

use super::Dialect;
use super::code::Code;
use super::modal::{
    ArcDistance, CoordinateSystem, Distance, FeedMode, Modal, MotionMode, PathControl, Plane, ProbeMode, Units,
};
use super::state::Interpreter;
use super::word::{ASSIGNMENT, Claim, GWord, Groups, Letters, MWord, NonModal, ToolLength, Word, Words};
use crate::axes::{Axis, AxisMask, LINEAR, PerAxis};
use crate::error::Error;
use crate::image::FULL_IMAGE;
use crate::messages::SpindleDirection;
use crate::units::Decimal;

/// Maximum tool number in Grbl's dialect.
pub(super) const TOOL_MAX_OF_GRBL: i32 = 255;
/// Maximum tool number in all dialects except Grbl's.
pub(super) const TOOL_MAX: i32 = 99_999;
/// Letters of words other than axis, G and M words, in Grbl's dialect.
const VALUES_OF_GRBL: Letters = Letters::of(b"FIJKLNPRST");
/// Letters of words other than axis, G and M words, in all dialects except Grbl's.
const VALUES: Letters = Letters::of(if FULL_IMAGE { b"DEFHIJKLNOPQRST".as_slice() } else { b"EFHIJKLNOPQRST" });
/// Letters that Mach uses for the centre of a rotation.
const CENTRE_OF_MACH: Letters = Letters::of(if FULL_IMAGE { b"AB".as_slice() } else { b"" });
/// Letters of words whose value must not be negative.
const NOT_NEGATIVE: Letters = Letters::of(b"DEFHNPTS");

/// The words of a line that Grbl does not have.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Extended {
    /// Whether the line has a word of this struct, except G50, G51, G68, G69 and M6. If `false`, the check skips the
    /// steps for these words.
    pub any: bool,
    pub path: Option<PathControl>,
    /// Whether the path control word is G64, which can have tolerances (P and Q).
    pub is_path_tolerance: bool,
    /// G68 (`true`) or G69 (`false`).
    pub rotation: Option<bool>,
    /// G51 (`true`) or G50 (`false`).
    pub scaling: Option<bool>,
    /// Whether P is negative. Only G5 allows that.
    pub is_p_negative: bool,
    /// G5.3.
    pub ends_control_points: bool,
    /// M6.
    pub tool_change: bool,
    /// M61.
    pub tool_number: bool,
    /// M62 to M68, by number.
    pub pins: Option<u8>,
    /// M48 to M53, by number.
    pub overrides: Option<u8>,
    /// M70 to M73, by number.
    pub keep: Option<u8>,
    /// G31.
    pub probe_once: bool,
    /// G12 (`true`) or G13 (`false`).
    pub circle: Option<bool>,
    /// G54.1, G154.
    pub system_by_number: bool,
    /// G8, G103 or G187, by number.
    pub look_ahead: Option<u8>,
    /// M29.
    pub rigid_tapping: bool,
    /// With G28 and G30: the axes for which U, V or W gives a distance (U along X, V along Y, W along Z).
    pub distances: AxisMask,
}

/// The words of a line.
#[derive(Clone, Debug)]
pub(super) struct Parsed<const N: usize> {
    /// Modal groups of which the line has a word.
    pub groups: Groups,
    /// Command that uses the axis words.
    pub claim: Claim,
    pub non_modal: Option<NonModal>,
    pub modal: ModalWords,
    pub tool_length: Option<ToolLength>,
    /// M0, M1, M2, M30 or M60.
    pub flow: Option<MWord>,
    pub spindle: Option<SpindleDirection>,
    /// M7 to M9.
    pub coolant: Option<MWord>,
    /// M56.
    pub parking_override: bool,
    pub extended: Extended,
    /// Letters of the axis words, and of the words in `value_words`.
    pub values: Letters,
    /// Axes that have a word.
    pub axes: AxisMask,
    pub axis: PerAxis<Decimal, N>,
    /// The largest number of decimal places that an axis word of the line has.
    pub places: u8,
    value_words: ValueWords,
}

/// The line's modal words by group; `None` if the line has no word of the group.
#[derive(Clone, Debug, Default)]
pub(super) struct ModalWords {
    pub motion: Option<MotionMode>,
    pub plane: Option<Plane>,
    pub distance: Option<Distance>,
    pub arc_distance: Option<ArcDistance>,
    pub feed_mode: Option<FeedMode>,
    pub units: Option<Units>,
    /// G98, G99.
    pub retract_to_r: Option<bool>,
    pub coordinate_system: Option<CoordinateSystem>,
}

impl ModalWords {
    /// Sets the modes in `modal`, except the motion mode.
    #[inline(never)]
    pub fn set_modes(&self, modal: &mut Modal) {
        modal.plane = self.plane.unwrap_or(modal.plane);
        modal.distance = self.distance.unwrap_or(modal.distance);
        modal.arc_distance = self.arc_distance.unwrap_or(modal.arc_distance);
        modal.feed_mode = self.feed_mode.unwrap_or(modal.feed_mode);
        modal.units = self.units.unwrap_or(modal.units);
        modal.retract_to_r = self.retract_to_r.unwrap_or(modal.retract_to_r);
        modal.coordinate_system = self.coordinate_system.unwrap_or(modal.coordinate_system);
    }
}

/// Words other than axis, G and M words, in the order of the line. Most lines have at most one such word, so a list is
/// faster than an array by letter, which would have to be cleared for each line.
type ValueWords = heapless::Vec<(u8, Decimal), { VALUES.count() + CENTRE_OF_MACH.count() }>;

impl<const N: usize> Parsed<N> {
    /// Creates the result of a line without words. [`Parsed::read`] adds the words.
    pub fn empty() -> Self {
        Self {
            groups: Groups::default(),
            claim: Claim::Nobody,
            non_modal: None,
            modal: ModalWords::default(),
            tool_length: None,
            flow: None,
            spindle: None,
            coolant: None,
            parking_override: false,
            extended: Extended::default(),
            values: Letters::default(),
            axes: AxisMask::NONE,
            axis: PerAxis::all(Decimal::ZERO),
            places: 0,
            value_words: ValueWords::new(),
        }
    }

    /// Adds the words of a line. Assignments to parameters are stored in `state` and take effect when the line is
    /// committed.
    pub fn read(&mut self, line: &[u8], dialect: Dialect, state: &mut Interpreter<N>) -> Result<(), Error> {
        let axes = state.axes();
        for word in Words::of(line, dialect, state) {
            let Word { letter, value, places } = word?;
            match letter {
                b'G' => self.take_g(Code::of(value), dialect)?,
                // The machine does not have the axis of this letter.
                _ if N > LINEAR && Axis::from_letter(letter).is_some_and(|axis| axis.index() >= axes) => {
                    if axes > LINEAR {
                        return Err(Error::OneRotaryAxis);
                    }
                    // With G68, A and B can give the centre of the rotation, as in Mach.
                    self.take_value(letter, value, dialect)?;
                }
                b'M' => self.take_m(Code::of(value), dialect)?,
                _ => match Axis::from_letter(letter).filter(|axis| axis.index() < N) {
                    Some(axis) => self.take_axis(axis, letter, value, places)?,
                    None => self.take_value(letter, value, dialect)?,
                },
            }
        }
        Ok(())
    }

    /// Does the same as `read`, for callers that are not time-critical. Not inlined, so that these callers share one
    /// copy of the code.
    #[inline(never)]
    pub fn read_apart(&mut self, line: &[u8], dialect: Dialect, state: &mut Interpreter<N>) -> Result<(), Error> {
        self.read(line, dialect, state)
    }

    /// Returns whether all words of the line only determine where and how the line moves. Most lines of a program are
    /// of this kind. For such a line the check skips the steps that only other words need.
    #[inline]
    pub fn is_move(&self) -> bool {
        !self.extended.any && self.groups.within(Groups::OF_MOVES) && !self.values.has_any(Letters::of(b"DST"))
    }

    /// Returns the value of a letter other than an axis, G or M; 0 if the line lacks the word. [`Parsed::values`] tells
    /// a missing word from the value 0.
    pub fn value(&self, letter: u8) -> Decimal {
        let found = self.value_words.iter().find(|(of, _)| *of == letter);
        found.map_or(Decimal::ZERO, |(_, value)| *value)
    }

    fn take_g(&mut self, code: Code, dialect: Dialect) -> Result<(), Error> {
        let claim = GWord::claim(code, dialect);
        if claim != Claim::Nobody {
            if self.claim != Claim::Nobody {
                return Err(Error::TwoAxisCommands);
            }
            self.claim = claim;
        }
        let word = GWord::of(code, dialect)?;
        if dialect != Dialect::Grbl && self.cancels_only(word) {
            return Ok(());
        }
        self.groups.join(word.group())?;
        match word {
            GWord::NonModal(command) => self.non_modal = Some(command),
            GWord::Motion(motion) => self.modal.motion = Some(motion),
            GWord::Plane(plane) => self.modal.plane = Some(plane),
            GWord::Distance(distance) => self.modal.distance = Some(distance),
            GWord::ArcDistance(distance) => self.modal.arc_distance = Some(distance),
            GWord::FeedMode(mode) => self.modal.feed_mode = Some(mode),
            GWord::Units(units) => self.modal.units = Some(units),
            GWord::Retract(to_r) => self.modal.retract_to_r = Some(to_r),
            GWord::ToolLength(offset) => self.tool_length = Some(offset),
            GWord::CoordinateSystem(system) => self.modal.coordinate_system = Some(system),
            GWord::Path(path) => {
                self.extended.any = true;
                self.extended.path = Some(path);
                self.extended.is_path_tolerance = code.whole == 64;
            }
            GWord::Rotation(on) => self.extended.rotation = Some(on),
            GWord::EndOfControlPoints => {
                self.extended.any = true;
                self.extended.ends_control_points = true;
            }
            GWord::Scaling(on) => self.extended.scaling = Some(on),
            GWord::NoCutterCompensation | GWord::AsItIs(_) => {}
            GWord::ProbeOnce | GWord::Circle(_) | GWord::SystemByNumber | GWord::LookAhead(_) => self.take_habit(word),
        }
        Ok(())
    }

    #[inline(never)]
    fn take_habit(&mut self, word: GWord) {
        self.extended.any = true;
        match word {
            GWord::ProbeOnce => {
                self.modal.motion = Some(MotionMode::Probe(ProbeMode { away: false, alarm: false }));
                self.extended.probe_once = true;
            }
            GWord::Circle(clockwise) => self.extended.circle = Some(clockwise),
            GWord::SystemByNumber => self.extended.system_by_number = true,
            GWord::LookAhead(number) => self.extended.look_ahead = Some(number),
            _ => {}
        }
    }

    /// Handles G80 and another motion word on one line: in either order, the other word applies and G80 is ignored.
    /// Returns `true` if `word` needs no further processing.
    fn cancels_only(&mut self, word: GWord) -> bool {
        match (word, self.modal.motion) {
            (GWord::Motion(MotionMode::Cancelled), Some(other)) => other != MotionMode::Cancelled,
            (GWord::Motion(motion), Some(MotionMode::Cancelled)) => {
                self.modal.motion = Some(motion);
                motion != MotionMode::Cancelled
            }
            _ => false,
        }
    }

    fn take_m(&mut self, code: Code, dialect: Dialect) -> Result<(), Error> {
        let word = MWord::of(code, dialect)?;
        self.groups.join(word.group())?;
        match word {
            MWord::Pause | MWord::OptionalPause | MWord::End => self.flow = Some(word),
            MWord::Spindle(direction) => self.spindle = Some(direction),
            MWord::Mist | MWord::Flood | MWord::NoCoolant => self.coolant = Some(word),
            MWord::ParkingOverride => self.parking_override = true,
            MWord::ToolChange => self.extended.tool_change = true,
            MWord::ToolNumber => self.extended = Extended { any: true, tool_number: true, ..self.extended },
            MWord::Pins(number) => self.extended = Extended { any: true, pins: Some(number), ..self.extended },
            MWord::Overrides(number) => {
                self.extended = Extended { any: true, overrides: Some(number), ..self.extended }
            }
            MWord::RigidTapping => self.extended = Extended { any: true, rigid_tapping: true, ..self.extended },
            MWord::Keep(number) => self.extended = Extended { any: true, keep: Some(number), ..self.extended },
        }
        Ok(())
    }

    #[inline]
    fn take_axis(&mut self, axis: Axis, letter: u8, value: Decimal, places: u8) -> Result<(), Error> {
        if self.values.has(letter) {
            return Err(Error::WordRepeated);
        }
        self.values.add(letter);
        self.axis.set(axis, value);
        self.axes = self.axes.with(axis);
        self.places = self.places.max(places);
        Ok(())
    }

    #[inline(never)]
    fn take_value(&mut self, letter: u8, value: Decimal, dialect: Dialect) -> Result<(), Error> {
        let (values, tool_max) = match dialect {
            Dialect::Grbl => (VALUES_OF_GRBL, TOOL_MAX_OF_GRBL),
            _ => (VALUES, TOOL_MAX),
        };
        if !values.has(letter) {
            return match letter {
                ASSIGNMENT => Ok(()),
                // The dialect cannot be Grbl's, because in Grbl's dialect G68 is an unknown word.
                b'A' | b'B' if FULL_IMAGE && self.extended.rotation == Some(true) => {
                    if self.values.has(letter) {
                        return Err(Error::WordRepeated);
                    }
                    self.values.add(letter);
                    let _ = self.value_words.push((letter, value));
                    Ok(())
                }
                b'U'..=b'W'
                    if FULL_IMAGE && dialect != Dialect::Grbl && matches!(self.non_modal, Some(NonModal::Go(_))) =>
                {
                    let axis = [Axis::X, Axis::Y, Axis::Z].into_iter().zip(b'U'..).find(|(_, other)| *other == letter);
                    let Some((axis, _)) = axis else { return Err(Error::NoParallelAxes) };
                    self.extended.any = true;
                    self.extended.distances = self.extended.distances.with(axis);
                    self.take_axis(axis, axis.letter(), value, 0)
                }
                b'U'..=b'W' if dialect != Dialect::Grbl => Err(Error::NoParallelAxes),
                _ => Err(Error::UnsupportedCommand),
            };
        }
        if letter == b'T' && value > Decimal::from_int(tool_max) {
            return Err(Error::ToolNumberTooHigh);
        }
        if self.values.has(letter) {
            return Err(Error::WordRepeated);
        }
        if NOT_NEGATIVE.has(letter) && value < Decimal::ZERO {
            if !FULL_IMAGE || letter != b'P' || dialect == Dialect::Grbl {
                return Err(Error::NegativeValue);
            }
            // The check (`sign_of_p`) decides whether this P belongs to a G5.
            self.extended = Extended { any: true, is_p_negative: true, ..self.extended };
        }
        self.values.add(letter);
        // The push succeeds, because there is room for each letter once.
        let _ = self.value_words.push((letter, value));
        Ok(())
    }
}
