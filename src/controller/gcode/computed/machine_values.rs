//! Numbered and named parameters that show the machine's state: positions, offsets, tool and modal state (#5061, #5400,
//! #<_metric>). This file also assigns parameters, and inserts values into `(DEBUG, ...)` and `(PRINT, ...)` messages.

use super::expression::{self, ParameterReference};
use super::parameters;
use super::real::Real;
use crate::axes::{Axis, PerAxis};
use crate::error::Error;
use crate::gcode::modal::{ArcDistance, CoordinateSystem, Distance, FeedMode, Units};
use crate::gcode::offsets::StoredOffset;
use crate::gcode::state::Interpreter;
use crate::gcode::word::Word;
use crate::messages::SpindleDirection;
use crate::number;
use crate::units::{Coordinate, DECIMAL_ONE, DECIMAL_PLACES, Decimal};

/// Letters of words whose value usually selects something, such as a G code, a tool or a line. Computed values of
/// these words are rounded (see `to_hundredths`).
const SELECTORS: &[u8] = b"DGHLMNOPT";

impl<const N: usize> Interpreter<N> {
    /// Stores what M66 has read, for #5399: 1 if the input is active, 0 if it is inactive, -1 after a timeout
    /// (`None`).
    pub fn set_input_read(&mut self, active: Option<bool>) {
        self.computed.input_read = active.map_or(-1, i8::from);
    }

    /// Stores the result of a probing move for #5061 to #5070. `place` is in machine coordinates, and the parameters
    /// show it in program coordinates. #5070 becomes 1 if `succeeded` is `true`, otherwise 0.
    pub fn set_probed(&mut self, place: &PerAxis<Coordinate, N>, succeeded: bool) {
        self.computed.probed = self.to_program(place);
        self.computed.probe_succeeded = succeeded;
    }

    /// Writes a message to `out` in which values replace the parameters (`#5`, `#<name>`), for `(DEBUG, ...)`. A name
    /// that is not set becomes `######`. Assignments of the line being checked are already in effect here. Text beyond
    /// the capacity of `out` is cut off.
    ///
    /// A value has six decimals. The formats `%d` (no decimals), `%f` (four) and `%.2f` (two) change this for all
    /// values after them, and are removed from the text.
    pub fn expand<const LENGTH: usize>(&self, comment: &[u8], out: &mut heapless::Vec<u8, LENGTH>) {
        let (mut rest, mut places) = (comment, 6);
        while let Some((byte, behind)) = rest.split_first() {
            if let (b'%', Some((wanted, after))) = (*byte, format(behind)) {
                (rest, places) = (after, wanted);
                continue;
            }
            let digits = behind.iter().take_while(|byte| byte.is_ascii_digit()).count();
            let (name, after) = match (behind.first(), digits) {
                (Some(b'<'), _) => expression::name(behind.get(1..).unwrap_or(&[])).unwrap_or_default(),
                _ => behind.split_at_checked(digits).unwrap_or_default(),
            };
            if *byte != b'#' || name.is_empty() {
                let _ = out.push(*byte);
                rest = behind;
                continue;
            }
            rest = after;
            let value = if digits > 0 {
                let number = Real::read(name).and_then(|(number, _)| number.whole()).unwrap_or(0);
                self.shown(ParameterReference::Number(number)).map(|value| value.unwrap_or(Real::ZERO))
            } else {
                let mut letters = heapless::Vec::<u8, { parameters::NAME_LENGTH }>::new();
                let capitals = name.iter().filter(|byte| **byte > b' ').map(u8::to_ascii_uppercase);
                letters.extend(capitals.take(parameters::NAME_LENGTH));
                self.shown(ParameterReference::Name(&letters)).and_then(|value| value.ok_or(Error::InvalidArgument))
            };
            write(value.ok(), places, out);
        }
    }

    fn shown(&self, reference: ParameterReference) -> Result<Option<Real>, Error> {
        match self.of_machine(reference)? {
            Some(value) => Ok(Some(value)),
            None => self.computed.parameters.get_staged(reference),
        }
    }

    /// Computes the value of a word from an expression. Also returns the text after the value.
    #[inline(never)]
    pub(in crate::gcode) fn compute<'t>(&self, letter: u8, text: &'t [u8]) -> Result<(Word, &'t [u8]), Error> {
        if !expression::begins(text) {
            return Err(Error::BadNumber);
        }
        let (value, rest) = self.value(text)?;
        let places = value.places();
        let value = if SELECTORS.contains(&letter) { to_hundredths(value.to_decimal()) } else { value.to_decimal() };
        Ok((Word { letter, value, places }, rest))
    }

    /// Assigns a parameter. The assignment takes effect when the line is committed. `text` is the text after `#`.
    /// Returns the text after the value.
    #[inline(never)]
    pub(in crate::gcode) fn assign<'t>(&mut self, text: &'t [u8]) -> Result<&'t [u8], Error> {
        let (target, rest) = match text.strip_prefix(b"<") {
            Some(text) => {
                let (name, rest) = expression::name(text)?;
                (ParameterReference::Name(name), rest)
            }
            None => {
                let (number, rest) = self.value(text)?;
                (ParameterReference::Number(number.whole().ok_or(Error::InvalidArgument)?), rest)
            }
        };
        let text = rest.strip_prefix(b"=").ok_or(Error::ExpressionSyntax)?;
        let (value, rest) = self.value(text)?;
        if self.of_machine(target)?.is_some() {
            return Err(Error::ReadOnlyParameter);
        }
        self.computed.parameters.stage(target, value)?;
        Ok(rest)
    }

    /// Returns whether the value of a text is not 0. The text must be one expression in brackets.
    pub(super) fn condition(&self, text: &[u8]) -> Result<bool, Error> {
        self.argument(text).map(|value| !value.is_zero())
    }

    /// Returns the value of a text, which must be one expression in brackets.
    pub(super) fn argument(&self, text: &[u8]) -> Result<Real, Error> {
        if text.first() != Some(&b'[') {
            return Err(Error::FlowSyntax);
        }
        let (value, rest) = self.value(text)?;
        if rest.is_empty() { Ok(value) } else { Err(Error::FlowSyntax) }
    }

    // Not inlined, so that the image contains this long code once.
    #[inline(never)]
    pub(super) fn value<'t>(&self, text: &'t [u8]) -> Result<(Real, &'t [u8]), Error> {
        let (value, used) = expression::value(text, |reference| self.parameter(reference))?;
        Ok((value, text.get(used..).unwrap_or(&[])))
    }

    /// Returns the value of a parameter; `None` if it is not set.
    pub(super) fn parameter(&self, reference: ParameterReference) -> Result<Option<Real>, Error> {
        match self.of_machine(reference)? {
            Some(value) => Ok(Some(value)),
            None => self.computed.parameters.get(reference),
        }
    }

    /// Returns the value of a parameter that shows the machine's state, such as #5420; `None` for all other
    /// parameters.
    fn of_machine(&self, reference: ParameterReference) -> Result<Option<Real>, Error> {
        match reference {
            ParameterReference::Number(number) => Ok(self.numbered(number)),
            ParameterReference::Name([b'_', name @ ..]) => self.named(name),
            ParameterReference::Name(_) => Ok(None),
        }
    }

    /// Returns a numbered parameter of the machine, from #5061. Stored positions are in millimetres, the machine's
    /// unit, as in LinuxCNC. The present and the probed position are in the program's unit.
    fn numbered(&self, number: i64) -> Option<Real> {
        let in_mm = |place: &PerAxis<Coordinate, N>, index: i64| self.length(place, index).map(Real::from_coordinate);
        Some(match number {
            5061..=5069 => self.in_units(&self.computed.probed, number - 5061),
            5070 => Real::truth(self.computed.probe_succeeded),
            5161..=5169 => in_mm(&self.offsets.stored(StoredOffset::G28), number - 5161).unwrap_or(Real::ZERO),
            5181..=5189 => in_mm(&self.offsets.stored(StoredOffset::G30), number - 5181).unwrap_or(Real::ZERO),
            5210 => Real::truth(self.offsets.g92_acts),
            5211..=5219 => in_mm(&self.offsets.g92_kept, number - 5211).unwrap_or(Real::ZERO),
            5220 => Real::from_decimal(Decimal::from_int(self.modal.coordinate_system as i32 + 1)),
            5221..=5390 => {
                let (system, index) = ((number - 5221) / 20, (number - 5221) % 20);
                let system = CoordinateSystem::ALL.get(usize::try_from(system).ok()?)?;
                match index {
                    9 => Real::from_decimal(self.offsets.angle(*system).degrees()),
                    _ => in_mm(&self.offsets.system(*system), index).unwrap_or(Real::ZERO),
                }
            }
            5399 => Real::from_decimal(Decimal::from_int(self.computed.input_read.into())),
            5400 => tool(self.spindle_tool),
            5401..=5409 => in_mm(&self.offsets.tool_length, number - 5401).unwrap_or(Real::ZERO),
            5420..=5428 => self.in_units(&self.work_position(), number - 5420),
            _ => return None,
        })
    }

    /// Returns a named parameter of the machine. `name` is the parameter's name without the leading `_`.
    fn named(&self, name: &[u8]) -> Result<Option<Real>, Error> {
        let modal = &self.modal;
        let truth = |holds| Ok(Some(Real::truth(holds)));
        match name {
            b"MOTION_MODE" => Ok(tenfold(modal.motion.word())),
            b"PLANE" => Ok(tenfold(modal.plane.word())),
            b"COORD_SYSTEM" => Ok(tenfold(modal.coordinate_system.word())),
            b"METRIC" => truth(modal.units == Units::Mm),
            b"IMPERIAL" => truth(modal.units == Units::Inch),
            b"ABSOLUTE" => truth(modal.distance == Distance::Absolute),
            b"INCREMENTAL" => truth(modal.distance == Distance::Incremental),
            b"IJK_ABSOLUTE_MODE" => truth(modal.arc_distance == ArcDistance::Absolute),
            b"INVERSE_TIME" => truth(modal.feed_mode == FeedMode::InverseTime),
            b"UNITS_PER_MINUTE" => truth(modal.feed_mode == FeedMode::PerMinute),
            b"UNITS_PER_REV" => truth(modal.feed_mode == FeedMode::PerRevolution),
            b"TOOL_OFFSET" => truth(self.offsets.tool_length != PerAxis::all(Coordinate::ZERO)),
            b"SPINDLE_ON" => truth(modal.spindle != SpindleDirection::Off),
            b"SPINDLE_CW" => truth(modal.spindle == SpindleDirection::Clockwise),
            b"MIST" => truth(modal.coolant.mist),
            b"FLOOD" => truth(modal.coolant.flood),
            b"RETRACT_R_PLANE" => truth(modal.retract_to_r),
            b"RETRACT_OLD_Z" => truth(!modal.retract_to_r),
            b"FEED_OVERRIDE" => truth(!modal.overrides_held.feed),
            b"SPEED_OVERRIDE" => truth(!modal.overrides_held.spindle),
            // These values are constant here. (In LinuxCNC, `#<_task>` is 0 while the preview is drawn.)
            b"TASK" | b"METRIC_MACHINE" | b"SPINDLE_RPM_MODE" | b"LATHE_RADIUS_MODE" | b"FEED_HOLD" => truth(true),
            b"SPINDLE_CSS_MODE" | b"LATHE_DIAMETER_MODE" | b"ADAPTIVE_FEED" => truth(false),
            // Returns 2.9, because LinuxCNC 2.9 has these parameters.
            b"VMAJOR" => Ok(Some(Real::from_decimal(Decimal(DECIMAL_ONE * 29 / 10)))),
            b"VMINOR" => Ok(Some(Real::ZERO)),
            b"FEED" => Ok(Some(self.feed())),
            b"RPM" => Ok(Some(Real::from_f32(modal.speed))),
            b"VALUE" => Ok(Some(self.computed.returned.unwrap_or(Real::ZERO))),
            b"VALUE_RETURNED" => truth(self.computed.returned.is_some()),
            b"CALL_LEVEL" => Ok(Some(Real::from_decimal(Decimal::from_int(self.computed.parameters.level().into())))),
            b"CURRENT_TOOL" => Ok(Some(tool(self.spindle_tool))),
            b"SELECTED_TOOL" => Ok(Some(tool(modal.tool))),
            [letter] => Ok(self.along(*letter, &self.work_position())),
            [b'A', b'B', b'S', b'_', letter] => Ok(self.along(*letter, &self.position)),
            _ => Ok(None),
        }
    }

    fn along(&self, letter: u8, place: &PerAxis<Coordinate, N>) -> Option<Real> {
        let axis = Axis::from_letter(letter).filter(|axis| axis.index() < self.axes())?;
        Some(self.in_units(place, axis.index() as i64))
    }

    fn work_position(&self) -> PerAxis<Coordinate, N> {
        self.to_program(&self.position)
    }

    /// Returns F in the program's unit.
    fn feed(&self) -> Real {
        let feed = Real::from_decimal(self.modal.feed);
        match self.modal.feed_mode {
            FeedMode::InverseTime => feed,
            _ if self.modal.units == Units::Inch => inches(feed),
            _ => feed,
        }
    }

    /// Returns a coordinate in the program's unit, or the degrees of a rotary axis; 0 for an axis that the machine
    /// lacks.
    fn in_units(&self, place: &PerAxis<Coordinate, N>, index: i64) -> Real {
        let value = self.length(place, index).map_or(Real::ZERO, Real::from_coordinate);
        let is_length = index <= Axis::Z.index() as i64;
        if is_length && self.modal.units == Units::Inch { inches(value) } else { value }
    }

    /// Returns a coordinate; `None` if the machine lacks the axis.
    fn length(&self, place: &PerAxis<Coordinate, N>, index: i64) -> Option<Coordinate> {
        let index = usize::try_from(index).ok().filter(|index| *index < self.axes())?;
        place.0.get(index).copied()
    }
}

/// Reads the format after a percent sign (`d`, `f` or `.2f`). Returns the number of decimals and the text after it;
/// `None` for other text.
fn format(text: &[u8]) -> Option<(u32, &[u8])> {
    match text {
        [b'd', rest @ ..] => Some((0, rest)),
        [b'f', rest @ ..] => Some((4, rest)),
        [b'.', places @ b'0'..=b'9', b'f', rest @ ..] => Some(((places - b'0').into(), rest)),
        _ => None,
    }
}

/// Writes a value with `places` decimals, at most seven, rounded half away from zero; `######` if there is no value or
/// it is too large.
fn write<const LENGTH: usize>(value: Option<Real>, places: u32, out: &mut heapless::Vec<u8, LENGTH>) {
    use core::fmt::Write;
    let Some(Decimal(value)) = value.filter(|value| value.fits_decimal()).map(Real::to_decimal) else {
        let _ = out.extend_from_slice(b"######");
        return;
    };
    let places = places.min(DECIMAL_PLACES);
    let (one, unit) = (10_u64.pow(places), 10_u64.pow(DECIMAL_PLACES - places));
    let size = (value.unsigned_abs() + unit / 2) / unit;
    let sign = if value < 0 && size > 0 { "-" } else { "" };
    let mut text = heapless::String::<24>::new();
    let _ = write!(text, "{sign}{}", size / one);
    if places > 0 {
        let _ = write!(text, ".{:0width$}", size % one, width = places as usize);
    }
    for byte in text.bytes() {
        let _ = out.push(byte);
    }
}

fn tool(number: u32) -> Real {
    Real::from_decimal(Decimal(i64::from(number) * DECIMAL_ONE))
}

fn inches(mm: Real) -> Real {
    // 25.4 is not zero, so the division succeeds.
    Real::new(254, -1).and_then(|inch| mm.div(inch)).unwrap_or(Real::ZERO)
}

/// Returns the number of a word times ten, as in LinuxCNC: 10 for G1, 382 for G38.2.
fn tenfold(word: &str) -> Option<Real> {
    let number = number::read(word.as_bytes().get(1..)?, number::Digits::Exact)?;
    Some(Real::from_decimal(Decimal(number.value.0 * 10)))
}

/// Rounds to the nearest hundredth if that changes the value by at most 0.0001, as LinuxCNC does with computed numbers
/// that select something. Values below 0.5 are not rounded, because P can be a short time or a small tolerance.
fn to_hundredths(value: Decimal) -> Decimal {
    const HUNDREDTH: i64 = DECIMAL_ONE / 100;
    const NEAR: i64 = DECIMAL_ONE / 10_000;
    let off = value.0.rem_euclid(HUNDREDTH);
    if value.0.abs() < DECIMAL_ONE / 2 {
        value
    } else if off <= NEAR {
        Decimal(value.0.saturating_sub(off))
    } else if off >= HUNDREDTH - NEAR {
        Decimal(value.0.saturating_add(HUNDREDTH - off))
    } else {
        value
    }
}
