//! Curves that are cut into chords: what arcs and splines have in common.

use super::arc::{Arc, Curvature};
use super::spline::Spline;
use crate::axes::PerAxis;
use crate::units::Coordinate;

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
