//! The state of the [`Interpreter`]: modal state, offsets, tools, saved states and the position at the end of all
//! committed lines. The controller reads it and corrects it here, for example after a stop or a probe.

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
    /// Number of axes of the machine; at most `N`.
    axes: u8,
    /// Words of the latest canned cycle.
    pub(super) cycle: CycleWords,
    pub(super) tools: Lent<ToolTable<N>>,
    /// Number of the tool in the spindle; 0 if none is known.
    pub(super) spindle_tool: u32,
    /// While check mode is active: the state from before check mode, which is still the state of the machine.
    pub(super) before_check: Option<BeforeCheck<N>>,
    pub(super) computed: Computed<N>,
    pub(super) measured: Measured,
    /// States saved by M70 and M73.
    pub(super) saved: SavedStates<N>,
    /// Rotation by G68.
    pub(super) rotation: Option<Rotation>,
    /// The target of the most recent move in rotated coordinates.
    pub(super) reached: Option<Reached>,
    /// Scaling by G51.
    pub(super) scaling: Option<Scaling>,
    /// Remainders from rounding the position in scaled coordinates.
    pub(super) rest: Rest,
    /// Control points of G5.2; takes no memory in a build without splines.
    pub(super) control_points: [ControlPoints; FULL_IMAGE as usize],
    /// Tangent at the end of the most recent G5; takes no memory in a build without splines.
    pub(super) tangent: [Option<Tangent>; FULL_IMAGE as usize],
    /// Whether the program has named the radius of a tool by D. If so, G12 and G13 are refused; D has no other effect.
    pub(super) names_radius: bool,
    /// Where the host's next line is relative to the end of a program (M2, M30).
    pub(super) place: ProgramPlace,
}

/// Position of a line relative to the end of a program.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ProgramPlace {
    /// In a program.
    Program,
    /// After the end of a program.
    End,
    /// After the end of a program, among its subprograms. In a build without subprograms, the place is `Refused`
    /// instead.
    #[cfg(feature = "full")]
    Subprogram,
    /// In lines that belong to no program. They are refused until another program begins.
    Refused,
}

/// End of the most recent G5, in X and Y of the machine. Another G5 can continue smoothly from there.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Tangent {
    pub(super) place: [Coordinate; 2],
    /// Vector from `place` to the first control point of the next curve.
    pub(super) way: [Coordinate; 2],
}

impl Tangent {
    /// Returns the tangent for a next curve that continues smoothly from `end`, the end of this one. `arriving` is the
    /// vector from `end` to the last control point of this curve. The tangent has the opposite direction and the same
    /// length.
    pub(super) fn behind<const N: usize>(end: &PerAxis<Coordinate, N>, arriving: [Coordinate; 2]) -> Self {
        Self { place: in_xy(end), way: arriving.map(|part| -part) }
    }
}

/// No tangent: no G5 has ended yet.
pub(super) const NO_TANGENT: [Option<Tangent>; FULL_IMAGE as usize] = [None; FULL_IMAGE as usize];

/// State from before check mode. It remains the state of the machine while programs are only checked.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct BeforeCheck<const N: usize> {
    pub(super) spindle_tool: u32,
    pub(super) modal: Modal,
    /// Empty in Grbl's dialect and in a build without expressions. There, changes that checked programs make to the
    /// offsets remain after check mode.
    pub(super) offsets: [Option<Offsets<N>>; FULL_IMAGE as usize],
}

impl<const N: usize> BeforeCheck<N> {
    /// Returns the offsets to restore at the end of check mode.
    pub(super) fn offsets(&self) -> Option<Offsets<N>> {
        self.offsets.first().copied().flatten()
    }
}

#[cfg(feature = "alloc")]
impl<const N: usize> Default for Interpreter<N> {
    fn default() -> Self {
        Self::new(ProgramMemory::on_heap(super::LEAST_HELD))
    }
}

impl<const N: usize> Interpreter<N> {
    /// Creates the state after power-up of a new machine: the modal state is [`Modal::INITIAL`], all offsets and the
    /// position are 0, and the tool in the spindle is unknown.
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
            names_radius: false,
            place: ProgramPlace::Program,
        }
    }

    /// Returns the number of axes of the machine. Words of other axes are unknown words.
    #[inline]
    pub(super) fn axes(&self) -> usize {
        if N <= LINEAR { N } else { usize::from(self.axes) }
    }

    /// Sets the number of axes, in the order X, Y, Z, A, B, C; at most `N`.
    pub fn set_axes(&mut self, axes: usize) {
        self.axes = axes.min(N) as u8;
    }

    pub(super) fn is_checking(&self) -> bool {
        self.before_check.is_some()
    }

    /// Ends a series of canned cycles, as G80 does. Call this after homing or another change of the machine
    /// coordinates; otherwise G98 would return to a wrong level.
    pub fn end_cycles(&mut self) {
        if matches!(self.modal.motion, MotionMode::Cycle(_)) {
            self.modal.motion = MotionMode::Cancelled;
        }
    }

    /// Sets a stored position, or the offset of a tool. In check mode, the tool gets a second entry, which is used
    /// until check mode ends. If the tool table is full, the offset of a new tool is dropped.
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

    /// Sets all stored positions to zero, and empties the tool table.
    pub fn clear_stored(&mut self) {
        self.offsets.clear_stored();
        *self.tools = ToolTable::EMPTY;
    }

    /// Returns the number of the tool in the spindle; 0 if none is known.
    pub fn spindle_tool(&self) -> u32 {
        self.spindle_tool
    }

    /// Marks the tool in the spindle as unknown, because the operator may have removed it during a tool change. The
    /// next M6 asks for its tool again.
    pub fn tool_removed(&mut self) {
        self.spindle_tool = 0;
        self.measured.forget_tool();
    }

    /// Records that tool `number`, in the spindle, touched the setter at the machine coordinate `place`, and applies
    /// the resulting tool length offset. Returns whether this is the first measured tool.
    pub fn tool_measured(&mut self, number: u32, place: Coordinate) -> bool {
        let before = self.offsets.tool_length.get(TOOL_AXIS).unwrap_or(Coordinate::ZERO);
        let (offset, is_first) = self.measured.touched(place, before);
        self.spindle_tool = number;
        self.offsets.tool_length.set(TOOL_AXIS, offset);
        self.saved.tool_measured();
        is_first
    }

    /// Sets the reference of the tool setter: the tool in the spindle, with its offset in force, touched the setter at
    /// this machine position. `None` forgets the reference; the next measured tool then sets it.
    pub fn set_tool_reference(&mut self, place: Option<PerAxis<Coordinate, N>>) {
        let height = |of: &PerAxis<Coordinate, N>| of.get(TOOL_AXIS).unwrap_or(Coordinate::ZERO);
        self.measured.set_reference(place.map(|place| height(&place) - height(&self.offsets.tool_length)));
    }

    /// Returns the machine coordinate at which a tool with offset 0 touches the tool setter, if it is known.
    pub fn tool_reference(&self) -> Option<Coordinate> {
        self.measured.reference()
    }

    /// Assumes, in check mode, that M6 has measured the tool. If no tool was measured before, the function also moves
    /// the position in Z to the height of G30, unless it is already higher.
    pub fn assume_measured(&mut self) {
        if !self.measured.assumed && self.measured.is_first() {
            let height = self.offsets.stored(StoredOffset::G30).get(TOOL_AXIS);
            self.position.set(TOOL_AXIS, height.max(self.position.get(TOOL_AXIS)).unwrap_or_default());
        }
        self.measured.assumed = true;
    }

    /// Returns the measured offset of tool `number`; `None` if it is not in the spindle or not measured. The
    /// measurement gives only the offset along Z; the tool table gives the offsets along the other axes.
    pub(super) fn measured_offset(&self, number: u32) -> Option<PerAxis<Coordinate, N>> {
        let active = self.offsets.tool_length.get(TOOL_AXIS).filter(|_| self.measured.assumed);
        let length = active.or(self.measured.offset()).filter(|_| number == self.spindle_tool && number != 0)?;
        let mut offset = self.tools.offset(number).unwrap_or(PerAxis::all(Coordinate::ZERO));
        offset.set(TOOL_AXIS, length);
        Some(offset)
    }

    /// Returns whether no length of any tool is known: the tool table is empty, no tool has been measured, and the
    /// tool length offset is 0.
    pub(super) fn knows_no_length(&self) -> bool {
        self.tools.is_empty()
            && self.measured == Measured::NOTHING
            && self.offsets.tool_length == PerAxis::all(Coordinate::ZERO)
    }

    /// Returns the tool table, including entries that a program has set in check mode.
    pub fn tools(&self) -> &ToolTable<N> {
        &self.tools
    }

    /// Returns the tool table, for restoring stored entries at power-up.
    pub fn tools_mut(&mut self) -> &mut ToolTable<N> {
        &mut self.tools
    }

    /// Returns the machine position at the end of all committed lines.
    pub fn position(&self) -> &PerAxis<Coordinate, N> {
        &self.position
    }

    /// Sets the number of the tool in the spindle and selects this tool, at the start of a replay.
    pub fn hold_tool(&mut self, tool: u32) {
        (self.spindle_tool, self.modal.tool) = (tool, tool);
    }

    /// Sets the machine position. Called when the machine is not at the end of the last committed line: after a reset,
    /// a probing move, a cancelled jog or homing.
    pub fn set_position(&mut self, position: PerAxis<Coordinate, N>) {
        self.position = position;
    }

    /// Returns the control points of the latest G5.2 curve. They remain after G5.3 has ended the curve.
    pub fn control_points(&self) -> &[WeightedPoint] {
        self.control_points.first().map_or(&[], ControlPoints::all)
    }

    /// Returns the words of the latest canned cycle. They stay in force as long as the motion mode is this cycle.
    pub fn cycle_words(&self) -> &CycleWords {
        &self.cycle
    }

    /// Returns the machine coordinate to which G98 returns in the current series of canned cycles.
    pub fn cycle_level(&self) -> Coordinate {
        self.cycle.level + along(&self.offsets.tool_length, self.cycle.plane.axes().linear)
    }

    /// Returns the modal state at the end of all committed lines, even of lines that were only checked in check mode.
    pub fn modal(&self) -> &Modal {
        &self.modal
    }

    /// Returns the modal state that the machine has: in check mode, the one from before check mode.
    pub fn acting_modal(&self) -> &Modal {
        self.before_check.as_ref().map_or(&self.modal, |before| &before.modal)
    }

    /// Sets spindle and coolant to the machine's state after the operator or a stop has switched them.
    pub fn set_accessories(&mut self, spindle: SpindleDirection, coolant: Coolant) {
        self.modal.spindle = spindle;
        self.modal.coolant = coolant;
    }

    /// Returns coordinate systems, G92, tool length offset, and the positions of G28 and G30.
    pub fn offsets(&self) -> &Offsets<N> {
        &self.offsets
    }

    /// Returns machine position minus work position: active coordinate system + G92 + tool length offset.
    pub fn work_offset(&self) -> PerAxis<Coordinate, N> {
        self.offsets.total(self.modal.coordinate_system)
    }
}

impl<const N: usize> Interpreter<N> {
    /// Returns the machine position of the work zero, which reports use as the work offset: a reported work position is
    /// the distance of the tool from this point, along the machine's axes. The angle of the coordinate system is
    /// included, G68 is not. In Grbl's dialect there are no rotations.
    pub fn work_zero(&self, dialect: Dialect) -> PerAxis<Coordinate, N> {
        match dialect {
            Dialect::Grbl => self.work_offset(),
            _ => self.offsets.zero_of(self.modal.coordinate_system),
        }
    }

    /// Returns the rotation by G68; `None` if no G68 is in force.
    pub fn rotation(&self) -> Option<&Rotation> {
        self.rotation.as_ref()
    }

    /// Returns whether G66 is active.
    pub fn has_modal_call(&self) -> bool {
        self.computed.has_modal_call()
    }

    /// Returns the scaling by G51; `None` if no G51 is in force.
    pub fn scaling(&self) -> Option<&Scaling> {
        self.scaling.as_ref()
    }

    /// Sets the angle by which a coordinate system is rotated about its origin.
    pub fn set_angle(&mut self, system: CoordinateSystem, angle: Angle) {
        self.offsets.set_angle(system, angle);
    }

    /// Converts a machine position to the coordinates that the program would write for it, with rotation and scaling.
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

    /// Converts machine coordinates in a rotated plane to program coordinates. If `machine` is the most recent position
    /// that the program gave, returns the coordinates as written, without the rounding of the rotation.
    pub(super) fn in_program(&self, rotated: RotatedPlane, machine: [Coordinate; 2]) -> [Coordinate; 2] {
        match self.reached {
            Some(reached) if reached.rotated == rotated && reached.machine == machine => reached.program,
            _ => rotated.to_program(machine),
        }
    }
}
