//! Converts axis words to a target in machine coordinates, through scaling, rotation and offsets, absolute or
//! incremental. Every move to a point uses this file; most moves need neither scaling nor rotation.

use super::draft::{Draft, Purpose};
use crate::axes::{Axis, PerAxis};
use crate::gcode::modal::Distance;
use crate::gcode::rotation::{Reached, RotatedPlane};
use crate::gcode::word::NonModal;
use crate::image::FULL_IMAGE;
use crate::units::Coordinate;

impl<const N: usize> Draft<'_, N> {
    /// Returns the target of the line's axis words, in machine coordinates.
    pub(super) fn target(&mut self) -> PerAxis<Coordinate, N> {
        let machine = self.line.non_modal == Some(NonModal::MachineCoordinates);
        if FULL_IMAGE && (self.rotated.is_some() || self.scaled.is_some()) && !machine {
            return self.transformed_target();
        }
        let incremental = self.action.modal.distance == Distance::Incremental;
        self.with_axis_words(self.state.position, |axis, value| {
            if machine {
                value
            } else if incremental {
                value + self.position(axis)
            } else {
                value + self.work_offset(axis)
            }
        })
    }

    /// Returns the target of a line that is scaled or rotated. An axis without a word keeps its program coordinate.
    /// Incremental jogs are neither scaled nor rotated, because jog buttons and position reports refer to the
    /// machine's axes.
    #[inline(never)]
    fn transformed_target(&mut self) -> PerAxis<Coordinate, N> {
        let incremental = self.action.modal.distance == Distance::Incremental;
        self.keep_rest(incremental);
        let target = self.with_axis_words(self.state.position, |axis, value| {
            let value = self.scaled_length(axis, value, incremental);
            if incremental { value + self.position(axis) } else { value + self.work_offset(axis) }
        });
        match self.rotated {
            Some(rotated) => self.rotated_target(rotated, target, incremental),
            None => target,
        }
    }

    /// Applies the rotation to `target`, which was computed without it. Also stores in the action the target's
    /// coordinates in the rotated plane: those of the program and those of the machine. The next line starts from
    /// them, so their rounding errors do not add up.
    fn rotated_target(
        &mut self,
        rotated: RotatedPlane,
        mut target: PerAxis<Coordinate, N>,
        incremental: bool,
    ) -> PerAxis<Coordinate, N> {
        let in_plane = |axis: Axis| axis == rotated.axes.first || axis == rotated.axes.second;
        let along_machine = incremental && self.purpose == Purpose::Jog;
        if along_machine || !Axis::of_machine::<N>().any(|axis| self.line.axes.has(axis) && in_plane(axis)) {
            return target;
        }
        let before = self.state.in_program(rotated, rotated.part_of(&self.state.position));
        let mut program = before;
        for (axis, coordinate) in [rotated.axes.first, rotated.axes.second].into_iter().zip(&mut program) {
            if self.line.axes.has(axis) {
                let value = self.scaled_length(axis, self.axis_length(axis), incremental);
                *coordinate = if incremental { *coordinate + value } else { value };
            }
        }
        // If the program's position does not change, take the machine's position as it is. Converting it again would
        // round it, and a full circle would not return to its start.
        let machine =
            if program == before { rotated.part_of(&self.state.position) } else { rotated.to_machine(program) };
        rotated.put(&mut target, machine);
        self.action.rotated.reached = Some(Reached { rotated, program, machine });
        target
    }

    /// Adjusts the target of a G28 or G30 that names only one axis of the rotated plane. Along the other axis, the
    /// target gets the program coordinate of the intermediate point `via`.
    pub(super) fn go_in_rotated_plane(
        &self,
        stored: &PerAxis<Coordinate, N>,
        via: &PerAxis<Coordinate, N>,
        target: &mut PerAxis<Coordinate, N>,
    ) {
        let Some(rotated) = self.rotated.filter(|_| FULL_IMAGE) else { return };
        let (has_first, has_second) = (self.line.axes.has(rotated.axes.first), self.line.axes.has(rotated.axes.second));
        if has_first == has_second {
            return;
        }
        let [stored_first, stored_second] = rotated.to_program(rotated.part_of(stored));
        let [first, second] = rotated.to_program(rotated.part_of(via));
        let place = if has_first { [stored_first, second] } else { [first, stored_second] };
        rotated.put(target, rotated.to_machine(place));
    }
}
