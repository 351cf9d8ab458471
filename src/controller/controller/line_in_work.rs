//! The line of G-code that is carried out.

use crate::axes::PerAxis;
use crate::gcode::Checked;
use crate::machine::tool_change::ToolChange;
use crate::motion::{Arc, ArcGeometry};
use crate::units::Coordinate;

/// A checked line, and its arc once that has begun.
#[derive(Clone, Debug)]
pub(super) struct LineInWork<const N: usize> {
    /// The line. Canned cycles and jogs change it while they are carried out.
    pub(super) checked: Checked<N>,
    arc: Option<Arc<N>>,
    single_block: bool,
    /// The tool change of the line, if its tool is measured.
    pub(super) change: ToolChange<N>,
}

impl<const N: usize> LineInWork<N> {
    /// There is none.
    pub(super) const NONE: Self =
        Self { checked: Checked::NOTHING, arc: None, single_block: false, change: ToolChange::NONE };

    /// Single block: whether the program pauses behind each line that moves, until the operator continues it.
    pub(super) fn is_single_block(&self) -> bool {
        self.single_block
    }

    /// Switches single block on or off; whether it is on now.
    pub(super) fn toggle_single_block(&mut self) -> bool {
        self.single_block = !self.single_block;
        self.single_block
    }

    /// A reset ends single block.
    pub(super) fn end_single_block(&mut self) {
        self.single_block = false;
    }

    /// Its arc begins. The length of the chords, mm.
    pub(super) fn begin_arc(&mut self, geometry: &ArcGeometry<N>, tolerance: f32) -> f32 {
        self.arc.insert(Arc::new(geometry, tolerance)).length()
    }

    /// End of the next chord of the arc.
    pub(super) fn next_chord(&mut self) -> Option<PerAxis<Coordinate, N>> {
        self.arc.as_mut()?.next_chord()
    }

    /// The arc that has begun.
    pub(super) fn arc(&self) -> Option<&Arc<N>> {
        self.arc.as_ref()
    }
}
