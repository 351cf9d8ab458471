//! `LineInWork`: the checked line of G-code that is carried out, with the `Curve` (arc, spline, nurbs) whose chords it
//! has begun, its tool change, whether single block is on, and the last message of the program.

use crate::axes::{LINEAR, PerAxis};
use crate::gcode::{Checked, EXPRESSIONS};
use crate::machine::tool_change::ToolChange;
use crate::motion::{Arc, ArcGeometry, Curvature, Curve, Nurbs, NurbsGeometry, Spline, SplineGeometry};
use crate::protocol::line::MESSAGE_LENGTH;
use crate::units::{Coordinate, WeightedPoint};

/// Longest message of a program, with the values of its parameters.
const MESSAGE: usize = if EXPRESSIONS { 160 } else { MESSAGE_LENGTH };

/// A message of a program.
pub(super) type Message = heapless::Vec<u8, MESSAGE>;

/// A checked line, and its curve once that has begun.
#[derive(Clone, Debug)]
pub(super) struct LineInWork<const N: usize> {
    /// The line. Canned cycles and jogs change it while they are carried out.
    pub(super) checked: Checked<N>,
    curve: Option<Curve<N>>,
    single_block: bool,
    /// The tool change of the line, if its tool is measured.
    change: ToolChange<N>,
    /// The last message of the program, for a host that takes over.
    message: Message,
}

impl<const N: usize> LineInWork<N> {
    /// There is none.
    pub(super) const NONE: Self = Self {
        checked: Checked::NOTHING,
        curve: None,
        single_block: false,
        change: ToolChange::NONE,
        message: Message::new(),
    };

    /// Single block: whether the program pauses behind each line that moves, until the operator continues it.
    pub(super) fn is_single_block(&self) -> bool {
        self.single_block
    }

    /// Switches single block on or off.
    pub(super) fn toggle_single_block(&mut self) {
        self.single_block = !self.single_block;
    }

    /// The last message of the program; empty if there was none.
    pub(super) fn message(&self) -> &Message {
        &self.message
    }

    /// A message of the program has been told. An empty one: the program has ended.
    pub(super) fn keep_message(&mut self, message: Message) {
        self.message = message;
    }

    /// A reset ends single block.
    pub(super) fn end_single_block(&mut self) {
        self.single_block = false;
    }

    /// Its tool is changed and measured; see [`LineInWork::change`].
    pub(super) fn begin_change(&mut self, change: ToolChange<N>) {
        self.change = change;
    }

    /// The tool change of the line.
    pub(super) fn change(&mut self) -> &mut ToolChange<N> {
        &mut self.change
    }

    /// Its arc begins. The length of the chords, mm, and how many times as long that is as their way along X, Y and Z.
    pub(super) fn begin_arc(&mut self, geometry: &ArcGeometry<N>, tolerance: f32) -> (f32, f32) {
        let arc = Arc::new(geometry, tolerance);
        let lengths = (arc.length(), if N > LINEAR { arc.rotary_stretch() } else { 1.0 });
        self.curve = Some(Curve::Arc(arc));
        lengths
    }

    /// Its spline begins.
    pub(super) fn begin_spline(&mut self, geometry: &SplineGeometry<N>, tolerance: f32) {
        self.curve = Some(Curve::Spline(Spline::new(geometry, tolerance)));
    }

    /// Its curve of control points begins.
    pub(super) fn begin_nurbs(&mut self, geometry: &NurbsGeometry<N>, tolerance: f32) {
        self.curve = Some(Curve::Nurbs(Nurbs::new(geometry, tolerance)));
    }

    /// End of the next chord of the curve, and how that bends.
    pub(super) fn next_chord(&mut self, points: &[WeightedPoint]) -> Option<(PerAxis<Coordinate, N>, Curvature)> {
        let curve = self.curve.as_mut()?;
        let end = curve.next_chord(points)?;
        Some((end, curve.curvature()))
    }
}
