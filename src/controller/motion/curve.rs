//! One interface for the curves that are divided into chords: arcs, splines and NURBS.

use super::arc::{Arc, Curvature};
use super::nurbs::Nurbs;
use super::spline::Spline;
use crate::axes::PerAxis;
use crate::units::{Coordinate, WeightedPoint};

/// A curve, and how far it has been divided into chords.
#[derive(Clone, Debug)]
pub enum Curve<const N: usize> {
    /// An arc or helix (G2, G3).
    Arc(Arc<N>),
    /// A Bezier curve of third degree (G5, G5.1).
    Spline(Spline<N>),
    /// A rational B-spline (G5.2, G5.3).
    Nurbs(Nurbs<N>),
}

impl<const N: usize> Curve<N> {
    /// Returns the end of the next chord; `None` after the last one. `points`: control points of a rational B-spline,
    /// otherwise unused.
    #[inline]
    pub fn next_chord(&mut self, points: &[WeightedPoint]) -> Option<PerAxis<Coordinate, N>> {
        match self {
            Curve::Arc(arc) => arc.next_chord(),
            Curve::Spline(spline) => spline.next_chord(),
            Curve::Nurbs(nurbs) => nurbs.next_chord(points),
        }
    }

    /// Returns the curvature along the chord that `next_chord` returned last.
    #[inline]
    pub fn curvature(&self) -> Curvature {
        match self {
            Curve::Arc(arc) => arc.curvature(),
            Curve::Spline(spline) => spline.curvature(),
            Curve::Nurbs(nurbs) => nurbs.curvature(),
        }
    }
}
