//! The modal state: one type for each modal group, the state after a reset, and what the end of a program resets.

use crate::axes::Axis;
use crate::image::FULL_IMAGE;
use crate::messages::{Coolant, SpindleDirection};
use crate::units::Decimal;

/// Motion mode, modal group 1.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum MotionMode {
    /// G0.
    #[default]
    Rapid,
    /// G1.
    Linear,
    /// G2.
    ArcClockwise,
    /// G3.
    ArcCounterClockwise,
    /// G5, G5.1, G5.2.
    Spline(SplineKind),
    /// G38.2 to G38.5.
    Probe(ProbeMode),
    /// G80.
    Cancelled,
    /// G73 to G89.
    Cycle(CycleKind),
}

impl MotionMode {
    /// Returns the word that selects the mode, such as `G38.2`, for the answer to `$G` and for messages.
    pub const fn word(self) -> &'static str {
        match self {
            MotionMode::Rapid => "G0",
            MotionMode::Linear => "G1",
            MotionMode::ArcClockwise => "G2",
            MotionMode::ArcCounterClockwise => "G3",
            MotionMode::Spline(SplineKind::Cubic) => "G5",
            MotionMode::Spline(SplineKind::Quadratic) => "G5.1",
            MotionMode::Spline(SplineKind::Nurbs) => "G5.2",
            MotionMode::Probe(ProbeMode { away: false, alarm: true }) => "G38.2",
            MotionMode::Probe(ProbeMode { away: false, alarm: false }) => "G38.3",
            MotionMode::Probe(ProbeMode { away: true, alarm: true }) => "G38.4",
            MotionMode::Probe(ProbeMode { away: true, alarm: false }) => "G38.5",
            MotionMode::Cancelled => "G80",
            MotionMode::Cycle(kind) => kind.word(),
        }
    }
}

/// Curve given by control points.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SplineKind {
    /// G5: two control points between the ends.
    Cubic,
    /// G5.1: one control point.
    Quadratic,
    /// G5.2: a rational B-spline, with a control point in each line up to G5.3.
    Nurbs,
}

/// Kind of canned cycle.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum CycleKind {
    /// G73: drills in pecks; the tool backs off a little after each peck.
    ChipBreak,
    /// G81: drills in one feed move.
    Drill,
    /// G82: as G81, with a dwell at the bottom.
    DrillDwell,
    /// G83: drills in pecks; the tool leaves the hole after each peck.
    Peck,
    /// G85: bores, and retracts at the feed rate.
    Bore,
    /// G86: bores, and retracts with the spindle stopped.
    BoreStop,
    /// G88: bores, stops the spindle at the bottom, and pauses the program before the retract.
    BoreManual,
    /// G89: as G85, with a dwell at the bottom.
    BoreDwell,
}

impl CycleKind {
    /// Returns the word that selects the cycle.
    pub const fn word(self) -> &'static str {
        match self {
            CycleKind::ChipBreak => "G73",
            CycleKind::Drill => "G81",
            CycleKind::DrillDwell => "G82",
            CycleKind::Peck => "G83",
            CycleKind::Bore => "G85",
            CycleKind::BoreStop => "G86",
            CycleKind::BoreManual => "G88",
            CycleKind::BoreDwell => "G89",
        }
    }
}

/// How a probing move ends: at contact or at the loss of contact. Also whether an alarm occurs if the move reaches its
/// target first.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ProbeMode {
    /// Whether the move ends at the loss of contact (G38.4, G38.5) instead of at contact.
    pub away: bool,
    /// Whether an alarm occurs if the move reaches its target and the contact has not changed (G38.2, G38.4).
    pub alarm: bool,
}

/// Plane of arcs, modal group 2.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Plane {
    /// G17.
    #[default]
    Xy,
    /// G18.
    Zx,
    /// G19.
    Yz,
}

/// The axes of a plane, in such an order that G3 turns from the first axis towards the second.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PlaneAxes {
    /// The axis from which G3 turns: X for G17.
    pub first: Axis,
    /// The axis towards which G3 turns: Y for G17.
    pub second: Axis,
    /// The axis normal to the plane, along which canned cycles drill: Z for G17.
    pub linear: Axis,
}

impl Plane {
    /// Returns the word that selects the plane, such as `G17`, for the answer to `$G` and for messages.
    pub const fn word(self) -> &'static str {
        match self {
            Plane::Xy => "G17",
            Plane::Zx => "G18",
            Plane::Yz => "G19",
        }
    }

    /// Returns the two axes of the plane, and the axis normal to it.
    pub const fn axes(self) -> PlaneAxes {
        match self {
            Plane::Xy => PlaneAxes { first: Axis::X, second: Axis::Y, linear: Axis::Z },
            Plane::Zx => PlaneAxes { first: Axis::Z, second: Axis::X, linear: Axis::Y },
            Plane::Yz => PlaneAxes { first: Axis::Y, second: Axis::Z, linear: Axis::X },
        }
    }
}

/// Distance mode, modal group 3.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Distance {
    /// G90: axis words are coordinates.
    #[default]
    Absolute,
    /// G91: axis words are distances from the present position.
    Incremental,
}

impl Distance {
    /// Returns the word that selects the mode, such as `G90`, for the answer to `$G` and for messages.
    pub const fn word(self) -> &'static str {
        match self {
            Distance::Absolute => "G90",
            Distance::Incremental => "G91",
        }
    }
}

/// Distance mode of arc centres, modal group 4.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum ArcDistance {
    /// G90.1: I, J and K are the centre's coordinates.
    Absolute,
    /// G91.1: I, J and K are distances from the arc's start.
    #[default]
    Incremental,
}

/// Meaning of F, modal group 5.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum FeedMode {
    /// G94: F is a speed.
    #[default]
    PerMinute,
    /// G93: F is 1 divided by the duration of the move in minutes.
    InverseTime,
    /// G95: F is the distance per revolution of the spindle at the programmed S.
    PerRevolution,
}

impl FeedMode {
    /// Returns the word that selects the mode, such as `G94`, for the answer to `$G` and for messages.
    pub const fn word(self) -> &'static str {
        match self {
            FeedMode::PerRevolution if FULL_IMAGE => "G95",
            FeedMode::InverseTime => "G93",
            _ => "G94",
        }
    }
}

/// Unit of lengths, modal group 6.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Units {
    /// G21.
    #[default]
    Mm,
    /// G20.
    Inch,
}

impl Units {
    /// Returns the word that selects the unit, such as `G21`, for the answer to `$G` and for messages.
    pub const fn word(self) -> &'static str {
        match self {
            Units::Mm => "G21",
            Units::Inch => "G20",
        }
    }
}

/// Path control, modal group 13.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum PathControl {
    /// G61: the path passes through all programmed points. G64 without a tolerance has the same effect.
    #[default]
    ExactPath,
    /// G61.1: the path passes through all programmed points and stops at each (exact stop).
    ExactStop,
    /// G64 P: the path passes near the programmed points, within this tolerance.
    Within(PathTolerance),
}

/// Maximum distance between the tool and the programmed path, in units of 0.1 nm, from G64 P. Greater values are
/// limited to the maximum of the type, about 0.43 m.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PathTolerance {
    /// P of G64, greater than 0: the maximum distance. Merging of moves may use the part `merging` of this distance;
    /// the rounding of corners uses the rest.
    pub path: u32,
    /// Q of G64: the part of `path` for merging. If several moves are merged into one, each programmed point is at most
    /// this far from the merged move.
    pub merging: u32,
}

impl PathControl {
    /// Returns the tolerance; `None` if the path is exact.
    pub fn tolerance(self) -> Option<PathTolerance> {
        match self {
            PathControl::Within(tolerance) => Some(tolerance),
            PathControl::ExactPath | PathControl::ExactStop => None,
        }
    }
}

/// Which of the operator's overrides the program has disabled, modal group 9.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct OverridesHeld {
    /// Whether the feed override is disabled (M49, M50 P0).
    pub feed: bool,
    /// Whether the spindle override is disabled (M49, M51 P0).
    pub spindle: bool,
}

/// Work coordinate system, modal group 12.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[repr(u8)]
#[allow(missing_docs, reason = "the names are the words")]
pub enum CoordinateSystem {
    #[default]
    G54,
    G55,
    G56,
    G57,
    G58,
    G59,
    G59_1,
    G59_2,
    G59_3,
}

impl CoordinateSystem {
    /// All systems, in the order of G10's P: P1 is G54, P9 is G59.3.
    pub const ALL: [CoordinateSystem; 9] = [
        CoordinateSystem::G54,
        CoordinateSystem::G55,
        CoordinateSystem::G56,
        CoordinateSystem::G57,
        CoordinateSystem::G58,
        CoordinateSystem::G59,
        CoordinateSystem::G59_1,
        CoordinateSystem::G59_2,
        CoordinateSystem::G59_3,
    ];
    /// Number of systems in Grbl's dialect, G54 to G59: the first ones of `ALL`.
    pub const OF_GRBL: usize = 6;

    /// Returns the word that selects the system, such as `G54`, for the answer to `$G` and for messages.
    pub const fn word(self) -> &'static str {
        match self {
            CoordinateSystem::G54 => "G54",
            CoordinateSystem::G55 => "G55",
            CoordinateSystem::G56 => "G56",
            CoordinateSystem::G57 => "G57",
            CoordinateSystem::G58 => "G58",
            CoordinateSystem::G59 => "G59",
            CoordinateSystem::G59_1 => "G59.1",
            CoordinateSystem::G59_2 => "G59.2",
            CoordinateSystem::G59_3 => "G59.3",
        }
    }
}

/// The modal state: the mode of each group, and T, F and S in force.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Modal {
    /// Motion mode in force; G0 after a reset.
    pub motion: MotionMode,
    /// The mode of the latest straight move, [`MotionMode::Rapid`] or [`MotionMode::Linear`]. G31 returns to this mode
    /// after its line. In dialect seed, axis words after G80 move in this mode.
    pub straight: MotionMode,
    /// Active work coordinate system (G54 to G59.3).
    pub coordinate_system: CoordinateSystem,
    /// Plane of arcs and canned cycles (G17 to G19).
    pub plane: Plane,
    /// Unit of lengths (G20, G21).
    pub units: Units,
    /// Whether G99 is in force: canned cycles end at R. With G98 (`false`) they end at the level where their series
    /// began, or at R if R is higher.
    pub retract_to_r: bool,
    /// Distance mode (G90, G91).
    pub distance: Distance,
    /// Distance mode of arc centres (G90.1, G91.1).
    pub arc_distance: ArcDistance,
    /// Meaning of F (G93 to G95).
    pub feed_mode: FeedMode,
    /// Direction of the spindle (M3, M4), or off (M5).
    pub spindle: SpindleDirection,
    /// Coolant outputs that are on (M7 to M9).
    pub coolant: Coolant,
    /// Whether parking is disabled (M56 P0).
    pub no_parking: bool,
    /// Path control (G61, G61.1, G64).
    pub path: PathControl,
    /// Overrides that the program has disabled (M48 to M51).
    pub overrides_held: OverridesHeld,
    /// T: the number of the selected tool.
    pub tool: u32,
    /// F, exact: mm/min with G94, moves per minute with G93, mm per revolution with G95; 0 while undefined.
    pub feed: Decimal,
    /// F converted for the moves. With G94: in mm/s. With G95: in mm per revolution divided by 60; each move multiplies
    /// it by S. Stored, so that a line without F need not convert it again.
    pub feed_per_second: f32,
    /// Whether F was written in inches (G20), so that `feed` is the written number times 25.4. A move of rotary axes
    /// alone needs the written number, because it takes F in degrees.
    pub feed_in_inches: bool,
    /// S, in revolutions per minute.
    pub speed: f32,
}

impl Modal {
    /// The modal state after power-up and, except for the tool, after a reset.
    pub const INITIAL: Modal = Modal {
        motion: MotionMode::Rapid,
        straight: MotionMode::Rapid,
        coordinate_system: CoordinateSystem::G54,
        plane: Plane::Xy,
        units: Units::Mm,
        retract_to_r: false,
        distance: Distance::Absolute,
        arc_distance: ArcDistance::Incremental,
        feed_mode: FeedMode::PerMinute,
        spindle: SpindleDirection::Off,
        coolant: Coolant { flood: false, mist: false },
        no_parking: false,
        path: PathControl::ExactPath,
        overrides_held: OverridesHeld { feed: false, spindle: false },
        tool: 0,
        feed: Decimal::ZERO,
        feed_per_second: 0.0,
        feed_in_inches: false,
        speed: 0.0,
    };
}

impl Modal {
    /// Returns F for a move of rotary axes alone, in degrees per minute.
    pub(super) fn rotary_feed(&self) -> f32 {
        let feed = if self.feed_in_inches { Decimal(self.feed.0.saturating_mul(10) / 254) } else { self.feed };
        if FULL_IMAGE && self.feed_mode == FeedMode::PerRevolution {
            return feed.to_f32() * self.speed;
        }
        feed.to_f32()
    }

    /// Resets all modes that only words outside Grbl's dialect can set: G99, G90.1, G61.1, G64, G95, G59.1 to G59.3,
    /// M49 to M51.
    pub(super) fn forget_extended(&mut self) {
        self.retract_to_r = false;
        self.arc_distance = ArcDistance::default();
        self.path = PathControl::default();
        self.overrides_held = OverridesHeld::default();
        if FULL_IMAGE && self.feed_mode == FeedMode::PerRevolution {
            self.feed_mode = FeedMode::default();
            self.feed = Decimal::ZERO;
        }
        if self.coordinate_system as u8 > CoordinateSystem::G59 as u8 {
            self.coordinate_system = CoordinateSystem::default();
        }
    }

    /// Resets the modes that M2 and M30 reset. G98 and G99 stay in force, as in LinuxCNC.
    pub(super) fn end_program(&mut self) {
        self.motion = MotionMode::Linear;
        self.straight = MotionMode::Linear;
        self.coordinate_system = CoordinateSystem::default();
        self.plane = Plane::default();
        self.distance = Distance::default();
        self.arc_distance = ArcDistance::default();
        if self.feed_mode == FeedMode::InverseTime || FULL_IMAGE && self.feed_mode == FeedMode::PerRevolution {
            // F of G93 is a number of moves per minute, F of G95 a distance per revolution. With G94, F is a speed, so
            // F becomes undefined.
            self.feed = Decimal::ZERO;
        }
        self.feed_mode = FeedMode::default();
        self.overrides_held = OverridesHeld::default();
        self.spindle = SpindleDirection::default();
        self.coolant = Coolant::default();
    }
}
