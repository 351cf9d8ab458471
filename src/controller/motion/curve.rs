//! Curves that are cut into chords: what arcs and splines have in common.

use super::arc::Arc;
use super::spline::Spline;
use crate::axes::{Axis, PerAxis};
use crate::units::Coordinate;

/// Whether there are splines: the code of what is left out is not in the image.
pub(super) const SPLINES: bool = cfg!(feature = "splines");

/// How a curve bends.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Curvature {
    /// Radius of the curve in space, mm; infinite where it is straight or nothing is known.
    pub radius: f32,
    /// The axes that take part in the turn.
    pub axes: [Axis; 2],
}

/// A curve that has begun.
#[derive(Clone, Debug)]
pub enum Curve<const N: usize> {
    /// An arc or helix.
    Arc(Arc<N>),
    /// A Bezier curve.
    Spline(Spline<N>),
}

impl<const N: usize> Curve<N> {
    /// Where the next chord ends; `None` after the last.
    #[inline]
    pub fn next_chord(&mut self) -> Option<PerAxis<Coordinate, N>> {
        match self {
            Curve::Arc(arc) => arc.next_chord(),
            Curve::Spline(spline) => spline.next_chord(),
        }
    }

    /// How the curve bends along the last chord.
    #[inline]
    pub fn curvature(&self) -> Curvature {
        match self {
            Curve::Arc(arc) => arc.curvature(),
            Curve::Spline(spline) => spline.curvature(),
        }
    }
}
