//! The state of the [`Interpreter`]: modal state, offsets, tools, saved states and the position at the end of all
//! committed lines. Here are the ways in which the controller reads it and corrects it, for example after a stop or a
//! probe.

use super::Dialect;
use super::computed::Computed;
use super::control_points::ControlPoints;
use super::cycle::CycleWords;
use super::memory::ProgramMemory;
use super::modal::{CoordinateSystem, Modal, MotionMode};
use super::offsets::{Offsets, StoredOffset, TOOL_AXIS};
use super::rotation::{Angle, Reached, RotatedPlane, Rotation};
use super::saved::SavedStates;
use super::scaling::{NO_REST, Rest, Scaling};
use super::tools::{self, Measured, Tool, ToolTable};
use super::values::{along, in_xy};
use crate::axes::{LINEAR, PerAxis};
use crate::image::FULL_IMAGE;
use crate::lent::Lent;
use crate::messages::{Coolant, SpindleDirection};
use crate::units::{Coordinate, WeightedPoint};

/// Modal state, offsets and the position at the end of all lines that were committed.
#[cfg_attr(feature = "alloc", derive(Clone))]
#[derive(Debug, PartialEq)]
pub struct Interpreter<const N: usize> {
    pub(super) modal: Modal,
    pub(super) offsets: Offsets<N>,
    pub(super) position: PerAxis<Coordinate, N>,
    /// How many axes the machine has; `N` at most.
    axes: u8,
    /// Of the latest canned cycle.
    pub(super) cycle: CycleWords,
    pub(super) tools: Lent<ToolTable<N>>,
    /// What M6 has put there; 0 for none.
    pub(super) spindle_tool: u32,
    /// While a program is only checked: what the machine has meanwhile.
    pub(super) before_check: Option<BeforeCheck<N>>,
    pub(super) computed: Computed<N>,
    pub(super) measured: Measured,
    /// M70, M73.
    pub(super) saved: SavedStates<N>,
    /// G68.
    pub(super) rotation: Option<Rotation>,
    /// The last place that was given in rotated coordinates.
    pub(super) reached: Option<Reached>,
    /// G51.
    pub(super) scaling: Option<Scaling>,
    /// What the roundings of scaled coordinates have left of the position.
    pub(super) rest: Rest,
    /// G5.2; no memory where there are no splines.
    pub(super) control_points: [ControlPoints; FULL_IMAGE as usize],
    /// Of the last G5; no memory where there are no splines.
    pub(super) tangent: [Option<Tangent>; FULL_IMAGE as usize],
    /// Whether lines are behind M2 or M30.
    pub(super) place: ProgramPlace,
}

/// Where lines are.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum ProgramPlace {
    /// In a program.
    Program,
    /// Behind its end.
    End,
    /// Behind its end, in a subprogram.
    Subprogram,
}

/// How another G5 continues smoothly where the last one has ended, in X and Y of the machine.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Tangent {
    pub(super) place: [Coordinate; 2],
    /// To its first control point.
    pub(super) way: [Coordinate; 2],
}

impl Tangent {
    /// The last control point mirrored.
    pub(super) fn behind<const N: usize>(end: &PerAxis<Coordinate, N>, arriving: [Coordinate; 2]) -> Self {
        Self { place: in_xy(end), way: arriving.map(|part| -part) }
    }
}

/// Before the first G5.
pub(super) const NO_TANGENT: [Option<Tangent>; FULL_IMAGE as usize] = [None; FULL_IMAGE as usize];

/// What check mode leaves to the machine.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct BeforeCheck<const N: usize> {
    pub(super) spindle_tool: u32,
    pub(super) modal: Modal,
    /// In Grbl's dialect, and on a board without room for it, what is checked sets them.
    pub(super) offsets: [Option<Offsets<N>>; FULL_IMAGE as usize],
}

impl<const N: usize> BeforeCheck<N> {
    /// The offsets that come back at its end.
    pub(super) fn offsets(&self) -> Option<Offsets<N>> {
        self.offsets.first().copied().flatten()
    }
}

#[cfg(feature = "alloc")]
impl<const N: usize> Default for Interpreter<N> {
    fn default() -> Self {
        Self::new(ProgramMemory::on_heap())
    }
}

impl<const N: usize> Interpreter<N> {
    /// The state after power-up of a new machine.
    pub fn new(memory: ProgramMemory<N>) -> Self {
        Self {
            modal: Modal::INITIAL,
            offsets: Offsets::new(),
            position: PerAxis::all(Coordinate::ZERO),
            axes: N as u8,
            cycle: CycleWords::NONE,
            tools: memory.tools,
            spindle_tool: 0,
            before_check: None,
            computed: Computed::new(memory.computed),
            measured: Measured::NOTHING,
            saved: SavedStates::new(memory.saved),
            rotation: None,
            reached: None,
            scaling: None,
            rest: NO_REST,
            control_points: memory.control_points.map(ControlPoints::new),
            tangent: NO_TANGENT,
            place: ProgramPlace::Program,
        }
    }

    /// How many axes the machine has: words of the others are unknown.
    #[inline]
    pub(super) fn axes(&self) -> usize {
        if N <= LINEAR { N } else { usize::from(self.axes) }
    }

    /// The machine has so many axes, X, Y, Z and so on.
    pub fn set_axes(&mut self, axes: usize) {
        self.axes = axes.min(N) as u8;
    }

    /// Whether programs are only checked.
    pub(super) fn is_checking(&self) -> bool {
        self.before_check.is_some()
    }

    /// Ends a series of canned cycles as G80 does: the machine has another position for the same place, and the level that
    /// G98 leads back to would be a wrong one.
    pub fn end_cycles(&mut self) {
        if matches!(self.modal.motion, MotionMode::Cycle(_)) {
            self.modal.motion = MotionMode::Cancelled;
        }
    }

    /// A stored place or tool gets a value.
    pub fn set_stored(&mut self, which: StoredOffset, value: PerAxis<Coordinate, N>) {
        match which {
            StoredOffset::Tool(number) => {
                let number = tools::entry_number(number, self.is_checking());
                if let Some(slot) = self.tools.slot(number) {
                    self.tools.put(slot, Tool { number, offset: value });
                }
            }
            which => self.offsets.set_stored(which, value),
        }
    }

    /// Sets every stored place to zero, and forgets the tools.
    pub fn clear_stored(&mut self) {
        self.offsets.clear_stored();
        *self.tools = ToolTable::EMPTY;
    }

    /// The tool that the spindle holds; 0 for none that M6 named.
    pub fn spindle_tool(&self) -> u32 {
        self.spindle_tool
    }

    /// Whoever changes tools may have taken it out: what is in the spindle is not known, and the next M6 asks for it.
    pub fn tool_removed(&mut self) {
        self.spindle_tool = 0;
        self.measured.forget_tool();
    }

    /// With this tool in the spindle the setter was touched at this place of the machine: its offset acts from here on.
    /// Whether it is the first tool that was measured.
    pub fn tool_measured(&mut self, number: u32, place: Coordinate) -> bool {
        let before = self.offsets.tool_length.get(TOOL_AXIS).unwrap_or(Coordinate::ZERO);
        let (offset, is_first) = self.measured.touched(place, before);
        self.spindle_tool = number;
        self.offsets.tool_length.set(TOOL_AXIS, offset);
        self.saved.tool_measured();
        is_first
    }

    /// In a program that is only checked: the tool would have been measured. The first one stays at the height of G30, if it is not
    /// above it.
    pub fn assume_measured(&mut self) {
        if !self.measured.assumed && self.measured.is_first() {
            let height = self.offsets.stored(StoredOffset::G30).get(TOOL_AXIS);
            self.position.set(TOOL_AXIS, height.max(self.position.get(TOOL_AXIS)).unwrap_or_default());
        }
        self.measured.assumed = true;
    }

    /// Of the tool in the spindle, the offset that was measured, with what the table has for the other axes.
    pub(super) fn measured_offset(&self, number: u32) -> Option<PerAxis<Coordinate, N>> {
        let active = self.offsets.tool_length.get(TOOL_AXIS).filter(|_| self.measured.assumed);
        let length = active.or(self.measured.offset()).filter(|_| number == self.spindle_tool && number != 0)?;
        let mut offset = self.tools.offset(number).unwrap_or(PerAxis::all(Coordinate::ZERO));
        offset.set(TOOL_AXIS, length);
        Some(offset)
    }

    /// Whether neither the table nor the setter nor G43.1 has given any tool a length.
    pub(super) fn knows_no_length(&self) -> bool {
        self.tools.is_empty()
            && self.measured == Measured::NOTHING
            && self.offsets.tool_length == PerAxis::all(Coordinate::ZERO)
    }

    /// The table of tools.
    pub fn tools(&self) -> &ToolTable<N> {
        &self.tools
    }

    /// The table of tools, to restore it.
    pub fn tools_mut(&mut self) -> &mut ToolTable<N> {
        &mut self.tools
    }

    /// The machine position the program believes in.
    pub fn position(&self) -> &PerAxis<Coordinate, N> {
        &self.position
    }

    /// For a replay: the tool is in the spindle.
    pub fn hold_tool(&mut self, tool: u32) {
        (self.spindle_tool, self.modal.tool) = (tool, tool);
    }

    /// Corrects the machine position: after a reset, a probing move, a cancelled jog, homing.
    pub fn set_position(&mut self, position: PerAxis<Coordinate, N>) {
        self.position = position;
    }

    /// The control points of G5.2, up to the last G5.3 or beyond it.
    pub fn control_points(&self) -> &[WeightedPoint] {
        self.control_points.first().map_or(&[], ControlPoints::all)
    }

    /// Of the latest canned cycle, what stays in force while its word does.
    pub fn cycle_words(&self) -> &CycleWords {
        &self.cycle
    }

    /// Machine coordinate that G98 leads back to in the series of canned cycles in force.
    pub fn cycle_level(&self) -> Coordinate {
        self.cycle.level + along(&self.offsets.tool_length, self.cycle.plane.axes().linear)
    }

    /// What stays in force.
    pub fn modal(&self) -> &Modal {
        &self.modal
    }

    /// What is in force for the machine: while programs are only checked, what was in force before.
    pub fn acting_modal(&self) -> &Modal {
        self.before_check.as_ref().map_or(&self.modal, |before| &before.modal)
    }

    /// Spindle and coolant as the machine has them, where not the program but the operator or a stop has switched them.
    pub fn set_accessories(&mut self, spindle: SpindleDirection, coolant: Coolant) {
        self.modal.spindle = spindle;
        self.modal.coolant = coolant;
    }

    /// All offsets.
    pub fn offsets(&self) -> &Offsets<N> {
        &self.offsets
    }

    /// What lies between machine and work position now: active coordinate system + G92 + tool length offset.
    pub fn work_offset(&self) -> PerAxis<Coordinate, N> {
        self.offsets.total(self.modal.coordinate_system)
    }
}

impl<const N: usize> Interpreter<N> {
    /// What reports take for the offset of the work coordinates: where their zero is in the machine, but for G68. A distance
    /// from there is along the axes of the machine. Rotations do not act in the dialect of Grbl.
    pub fn work_zero(&self, dialect: Dialect) -> PerAxis<Coordinate, N> {
        match dialect {
            Dialect::Grbl => self.work_offset(),
            _ => self.offsets.zero_of(self.modal.coordinate_system),
        }
    }

    /// The rotation by G68.
    pub fn rotation(&self) -> Option<&Rotation> {
        self.rotation.as_ref()
    }

    /// The scaling by G51.
    pub fn scaling(&self) -> Option<&Scaling> {
        self.scaling.as_ref()
    }

    /// A coordinate system is rotated.
    pub fn set_angle(&mut self, system: CoordinateSystem, angle: Angle) {
        self.offsets.set_angle(system, angle);
    }

    /// The coordinates that a program has for a place of the machine.
    pub fn to_program(&self, place: &PerAxis<Coordinate, N>) -> PerAxis<Coordinate, N> {
        let offsets = &self.offsets;
        let mut program = place.zip(&self.work_offset(), |place, offset| place - offset);
        let (g92, tool_length) = (&offsets.g92, &offsets.tool_length);
        let rotated = offsets.rotated_plane(self.modal.coordinate_system, g92, tool_length, self.rotation.as_ref());
        if let Ok(Some(rotated)) = rotated {
            rotated.put(&mut program, self.in_program(rotated, rotated.part_of(place)));
        }
        if FULL_IMAGE && let Some(scaling) = &self.scaling {
            scaling.written(&mut program, &self.rest);
        }
        program
    }

    /// The same in a rotated plane: as the program wrote it, if it is the place that it has reached.
    pub(super) fn in_program(&self, rotated: RotatedPlane, machine: [Coordinate; 2]) -> [Coordinate; 2] {
        match self.reached {
            Some(reached) if reached.rotated == rotated && reached.machine == machine => reached.program,
            _ => rotated.to_program(machine),
        }
    }
}
