//! G51 and G50: reads factors and centre of a scaling, and applies the scaling to the values of a line: positions,
//! distances, arc centres and radii. Refuses lines that cannot be scaled, such as an arc with unequal factors.

use super::draft::{CENTRE, Draft, Purpose};
use crate::axes::Axis;
use crate::error::Error;
use crate::gcode::arc::Vector;
use crate::gcode::modal::PlaneAxes;
use crate::gcode::scaling::{NO_REST, Rest, Scaling};
use crate::image::FULL_IMAGE;
use crate::units::{Coordinate, Decimal};

/// Maximum factor of G51.
const FACTOR_MAX: Decimal = Decimal::from_int(100);

impl<const N: usize> Draft<'_, N> {
    /// Executes G51 and G50: G51 starts a scaling, which replaces an earlier one, and G50 ends it. Other lines are
    /// scaled by the scaling in force.
    #[inline(never)]
    pub(super) fn scaling(&mut self) -> Result<(), Error> {
        match self.line.extended.scaling {
            Some(true) => {
                // If coordinates are rotated, factors and centre apply along the program's axes, not the machine's.
                let scaling = self.new_scaling()?;
                let acts = [Axis::X, Axis::Y, Axis::Z].into_iter().any(|axis| scaling.scales(axis));
                self.action.rotated.scaled.scaling = Some(acts.then_some(scaling));
                self.action.rotated.scaled.rest = Some(NO_REST);
            }
            Some(false) => {
                self.action.rotated.scaled.scaling = Some(None);
                self.action.rotated.scaled.rest = Some(NO_REST);
            }
            None => self.scaled = self.state.scaling.as_ref(),
        }
        Ok(())
    }

    /// Reads G51. Either P is the factor of X, Y and Z, or I, J and K are one factor each. A negative I or J mirrors.
    /// Along an axis that has no word, the centre is at the present position. The distance mode has no effect.
    fn new_scaling(&mut self) -> Result<Scaling, Error> {
        let named = self.line.axes;
        if Axis::of_machine::<N>().skip(3).any(|axis| named.has(axis)) {
            return Err(Error::AxisWordsUnused);
        }
        let one = Decimal::from_int(1);
        let factors = if self.take(b'P') {
            [self.line.value(b'P'); 3]
        } else if self.unused.has_any(CENTRE) {
            let line = self.line;
            [b'I', b'J', b'K'].map(|letter| if self.take(letter) { line.value(letter) } else { one })
        } else {
            return Err(Error::ValueWordMissing);
        };
        // A negative factor would mirror Z, so that a retract becomes a plunge.
        let [_, _, z] = factors;
        if factors.contains(&Decimal::ZERO) || z < Decimal::ZERO {
            return Err(Error::ValueOutOfRange);
        }
        // A factor above 100 is most likely written in thousandths, as some industrial controls expect it.
        if factors.iter().any(|factor| factor.0.unsigned_abs() > FACTOR_MAX.0.unsigned_abs()) {
            return Err(Error::ThousandfoldScaling);
        }
        let centre = [Axis::X, Axis::Y, Axis::Z]
            .map(|axis| if named.has(axis) { self.axis_length(axis) } else { self.program_coordinate(axis) });
        Ok(Scaling::new(factors, centre))
    }

    /// Returns the scaling that acts on the line. Incremental jogs are not scaled, because jog buttons refer to
    /// distances along the machine's axes.
    fn scaling_of(&self, incremental: bool) -> Option<&Scaling> {
        self.scaled.filter(|_| FULL_IMAGE && !(incremental && self.purpose == Purpose::Jog))
    }

    fn rest(&self, axis: Axis) -> i32 {
        self.state.rest.get(axis.index()).copied().unwrap_or(0)
    }

    #[inline(never)]
    fn scaled_word(&self, axis: Axis, value: Coordinate, incremental: bool) -> (Coordinate, i32) {
        match self.scaling_of(incremental) {
            Some(scaling) if scaling.scales(axis) && incremental => scaling.way(axis, value, self.rest(axis)),
            Some(scaling) if scaling.scales(axis) => scaling.place(axis, value),
            _ => (value, 0),
        }
    }

    /// Scales an axis word of a motion: a coordinate or a distance.
    pub(super) fn scaled_length(&self, axis: Axis, value: Coordinate, incremental: bool) -> Coordinate {
        self.scaled_word(axis, value, incremental).0
    }

    /// Stores for each scaled axis the remainder that rounding has cut off from its target. The next incremental line
    /// adds the remainder, so rounding errors do not add up.
    #[inline(never)]
    pub(super) fn keep_rest(&mut self, incremental: bool) {
        // A jog changes only the position, not the remainders that a program continues with.
        if self.scaling_of(incremental).is_none() || self.purpose == Purpose::Jog {
            return;
        }
        let mut rest: Rest = self.state.rest;
        for (axis, rest) in [Axis::X, Axis::Y, Axis::Z].into_iter().zip(&mut rest) {
            if self.line.axes.has(axis) {
                *rest = self.scaled_word(axis, self.axis_length(axis), incremental).1;
            }
        }
        self.action.rotated.scaled.rest = Some(rest);
    }

    /// Scales a vector that the program gives along two axes.
    #[inline(never)]
    pub(super) fn scaled_vector(&self, axes: [Axis; 2], vector: [Coordinate; 2]) -> [Coordinate; 2] {
        let Some(scaling) = self.scaling_of(false) else { return vector };
        let ([first, second], [along_first, along_second]) = (axes, vector);
        [scaling.way(first, along_first, 0).0, scaling.way(second, along_second, 0).0]
    }

    /// Scales a length without direction along an axis: R of an arc, Q of a cycle.
    #[inline(never)]
    pub(super) fn scaled_size(&self, axis: Axis, value: Coordinate) -> Coordinate {
        self.scaling_of(false).map_or(value, |scaling| scaling.size(axis, value))
    }

    /// Returns whether the scaling mirrors arcs in this plane. Returns an error if the factors of the two axes are
    /// unequal, because the arc would become an ellipse.
    #[inline(never)]
    pub(super) fn mirrors(&self, axes: PlaneAxes) -> Result<bool, Error> {
        let Some(scaling) = self.scaling_of(false) else { return Ok(false) };
        let (first, second) = (scaling.factor(axes.first), scaling.factor(axes.second));
        if first.0.unsigned_abs() != second.0.unsigned_abs() {
            return Err(Error::UnequalScaling);
        }
        Ok(first != second)
    }

    /// Converts a scaled vector in the plane of an arc back to the program's scale. Only the length of the result is
    /// correct: if the arc is mirrored, the direction can be wrong.
    #[inline(never)]
    pub(super) fn written_vector(&self, axes: PlaneAxes, vector: Vector) -> Vector {
        let Some(scaling) = self.scaling_of(false) else { return vector };
        // The factor of the first axis serves for both parts of the vector. The factor of the second axis is the same
        // or, if the arc is mirrored, the opposite, and the sign does not affect the length.
        let written = |way| scaling.written_way(axes.first, way);
        Vector { first: written(vector.first), second: written(vector.second) }
    }

    /// Refuses words that set the coordinates of the present position along axes that G51 has scaled.
    #[inline(never)]
    pub(super) fn needs_no_scaling(&self) -> Result<(), Error> {
        match self.scaling_of(false) {
            Some(scaling) if Axis::of_machine::<N>().any(|axis| self.line.axes.has(axis) && scaling.scales(axis)) => {
                Err(Error::ScalingActs)
            }
            _ => Ok(()),
        }
    }
}
