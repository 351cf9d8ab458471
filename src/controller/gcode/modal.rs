//! Modal state: what stays in force from line to line.

use crate::axes::Axis;
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
    /// G38.2 to G38.5.
    Probe(ProbeMode),
    /// G80.
    Cancelled,
}

impl MotionMode {
    /// The word that selects the mode.
    pub const fn word(self) -> &'static str {
        match self {
            MotionMode::Rapid => "G0",
            MotionMode::Linear => "G1",
            MotionMode::ArcClockwise => "G2",
            MotionMode::ArcCounterClockwise => "G3",
            MotionMode::Probe(ProbeMode { away: false, alarm: true }) => "G38.2",
            MotionMode::Probe(ProbeMode { away: false, alarm: false }) => "G38.3",
            MotionMode::Probe(ProbeMode { away: true, alarm: true }) => "G38.4",
            MotionMode::Probe(ProbeMode { away: true, alarm: false }) => "G38.5",
            MotionMode::Cancelled => "G80",
        }
    }
}

/// What a probing move waits for, and what it is if that does not come.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ProbeMode {
    /// Ends at the loss of contact (G38.4, G38.5) instead of at contact.
    pub away: bool,
    /// No change of contact is an alarm (G38.2, G38.4).
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

/// The axes of a plane, in the order that makes G3 turn from the first to the second.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PlaneAxes {
    /// First axis of the plane.
    pub first: Axis,
    /// Second axis of the plane.
    pub second: Axis,
    /// The axis that stands on the plane.
    pub linear: Axis,
}

impl Plane {
    /// The word that selects the plane.
    pub const fn word(self) -> &'static str {
        match self {
            Plane::Xy => "G17",
            Plane::Zx => "G18",
            Plane::Yz => "G19",
        }
    }

    /// The axes of the plane.
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
    /// The word that selects the mode.
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
    /// G93: F says how often the move fits into a minute.
    InverseTime,
}

impl FeedMode {
    /// The word that selects the mode.
    pub const fn word(self) -> &'static str {
        match self {
            FeedMode::PerMinute => "G94",
            FeedMode::InverseTime => "G93",
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
    /// The word that selects the unit.
    pub const fn word(self) -> &'static str {
        match self {
            Units::Mm => "G21",
            Units::Inch => "G20",
        }
    }
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
    /// All systems, in the order of G10's P.
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
    /// How many of them Grbl has.
    pub const OF_GRBL: usize = 6;

    /// The word that selects the system.
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

/// All that stays in force.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Modal {
    /// Motion mode.
    pub motion: MotionMode,
    /// The mode of the latest straight move, [`MotionMode::Rapid`] or [`MotionMode::Linear`]: what axis words fall back
    /// to after G80 where the dialect says so.
    pub straight: MotionMode,
    /// Work coordinate system.
    pub coordinate_system: CoordinateSystem,
    /// Plane of arcs.
    pub plane: Plane,
    /// Unit of lengths.
    pub units: Units,
    /// Distance mode.
    pub distance: Distance,
    /// Distance mode of arc centres.
    pub arc_distance: ArcDistance,
    /// Meaning of F.
    pub feed_mode: FeedMode,
    /// Spindle.
    pub spindle: SpindleDirection,
    /// Coolant.
    pub coolant: Coolant,
    /// M56 P0: the tool does not park.
    pub no_parking: bool,
    /// T.
    pub tool: u8,
    /// F, exact: mm/min with G94, moves per minute with G93; 0 while undefined.
    pub feed: Decimal,
    /// S, in revolutions per minute.
    pub speed: f32,
}

impl Modal {
    /// The state after power-up.
    pub const INITIAL: Modal = Modal {
        motion: MotionMode::Rapid,
        straight: MotionMode::Rapid,
        coordinate_system: CoordinateSystem::G54,
        plane: Plane::Xy,
        units: Units::Mm,
        distance: Distance::Absolute,
        arc_distance: ArcDistance::Incremental,
        feed_mode: FeedMode::PerMinute,
        spindle: SpindleDirection::Off,
        coolant: Coolant { flood: false, mist: false },
        no_parking: false,
        tool: 0,
        feed: Decimal::ZERO,
        speed: 0.0,
    };
}

impl Modal {
    /// What M2 and M30 set back.
    pub(super) fn end_program(&mut self) {
        self.motion = MotionMode::Linear;
        self.straight = MotionMode::Linear;
        self.coordinate_system = CoordinateSystem::default();
        self.plane = Plane::default();
        self.distance = Distance::default();
        self.arc_distance = ArcDistance::default();
        if self.feed_mode == FeedMode::InverseTime {
            // Moves per minute are no speed.
            self.feed = Decimal::ZERO;
        }
        self.feed_mode = FeedMode::default();
        self.spindle = SpindleDirection::default();
        self.coolant = Coolant::default();
    }
}
