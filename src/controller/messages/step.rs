//! Messages between the control task and the step task: blocks and segments to the step task; stops, probe contacts and
//! underruns back.

use crate::axes::PerAxis;

/// control -> step. At most 16 bytes, so that a receive in the step interrupt stays cheap.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum ToStep {
    /// Steps of the axes A, B and C of the next block; sent before its [`ToStep::Block`] if any of them moves.
    BlockRest {
        /// Steps of A, B, C.
        steps_by_axis: [AxisSteps; 3],
    },
    /// A straight move. The segments that follow are its pieces. The step task begins the move with the first of these
    /// segments.
    Block {
        /// Steps of X, Y, Z.
        steps_by_axis: [AxisSteps; 3],
        /// Bit set = axis moves in negative direction; bit 0 is X.
        directions: u8,
    },
    /// Follows the [`ToStep::Block`] of a block that a detour (parking) has interrupted. The block goes on where it was
    /// interrupted, and not at its start.
    Reenter {
        /// Number of units of progress (see [`Segment`]) of the block that were done before the detour.
        units: u32,
    },
    /// A piece of the current block.
    Segment(Segment),
    /// Starts or ends a watch of the probe. During the watch, the step task reads the probe at each tick (see
    /// [`Segment`]). When the probe has the awaited level, the step task reports the position with
    /// [`StepEvent::Probed`], discards the queue and brakes on its own. It then takes no message until it has been
    /// stopped and resumed.
    Watch {
        /// Level of the probe input for which the step task waits: `Some(true)` for active, `Some(false)` for inactive.
        /// `None` ends the watch.
        probe: Option<bool>,
        /// Deceleration for braking, in units of progress (see [`Segment`]) per square of a step-clock tick.
        braking: f32,
    },
    /// Lets the step task run again after a stop. Everything queued before this message is discarded. If the step task
    /// has been stopped again in the meantime, its own count of stops differs from `stops`. The step task then stays
    /// stopped.
    Resume {
        /// Number of the latest stop known to `control`: [`StepEvent::Stopped::stops`].
        stops: u16,
    },
}

impl ToStep {
    /// Returns whether the message describes a block, so that a segment must follow.
    #[inline]
    pub fn announces_block(&self) -> bool {
        matches!(self, ToStep::BlockRest { .. } | ToStep::Block { .. } | ToStep::Reenter { .. })
    }
}

/// The steps of one axis in a block: their number, and how far the true start and end of the move are from whole steps.
///
/// A line begins and ends on whole steps. A chord of an arc does not, because rounding its ends to whole steps would
/// bend the arc. The distance of a true end from the rounded end is given in sevenths of a step, positive in the
/// direction of motion (for an axis without steps: in positive direction). Example: `with_ends(100, 2, 0)` has 100
/// steps, and the true start is 2/7 of a step beyond the whole step at which the axis starts.
///
/// Packed into one word: steps in the lower 26 bits, then three bits for each end.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[repr(transparent)]
pub struct AxisSteps(u32);

impl AxisSteps {
    /// The number of steps of an axis in a block is less than 2^26.
    pub const STEP_BITS: u32 = 26;
    /// Number of parts of a step, the unit of [`AxisSteps::start`] and [`AxisSteps::end`]. It is an odd number, so that
    /// the values from -3 to 3 have 0 in the middle.
    pub const PARTS: u32 = 7;
    /// Maximum distance of the true start or end of a move from a whole step, in sevenths of a step.
    pub const FARTHEST: i32 = 3;
    const STEPS: u32 = (1 << Self::STEP_BITS) - 1;

    /// Creates the steps of an axis that starts and ends on whole steps.
    #[inline]
    pub const fn on_steps(steps: u32) -> AxisSteps {
        AxisSteps(steps & Self::STEPS)
    }

    /// Creates the steps of an axis whose true start and end are not on whole steps. `start`, `end`: true position
    /// minus rounded position, in sevenths of a step, at most [`AxisSteps::FARTHEST`] in either direction.
    #[inline]
    pub const fn with_ends(steps: u32, start: i32, end: i32) -> AxisSteps {
        AxisSteps(steps & Self::STEPS | (start as u32 & 7) << Self::STEP_BITS | (end as u32) << (Self::STEP_BITS + 3))
    }

    /// Returns the number of steps of this axis in the block.
    #[inline]
    pub const fn steps(self) -> u32 {
        self.0 & Self::STEPS
    }

    /// Returns the true start of the move minus the whole step at which this axis starts, in sevenths of a step.
    /// Positive is in the direction of motion.
    #[inline]
    pub const fn start(self) -> i32 {
        (self.0 << 3) as i32 >> (Self::STEP_BITS + 3)
    }

    /// Returns the true end of the move minus the whole step at which this axis ends, in sevenths of a step. Positive
    /// is in the direction of motion.
    #[inline]
    pub const fn end(self) -> i32 {
        self.0 as i32 >> (Self::STEP_BITS + 3)
    }

    /// Returns the packed word.
    #[inline]
    pub const fn word(self) -> u32 {
        self.0
    }

    /// Returns whether the move starts and ends on whole steps of this axis.
    #[inline]
    pub const fn is_on_steps(self) -> bool {
        self.0 <= Self::STEPS
    }
}

/// A sequence of ticks with evenly changing intervals. At each tick, axes can make a step. (The much shorter ticks of
/// the step clock only measure time.) Progress in a block is counted in units of 1/16 step of the dominant axis, the
/// axis with the most steps ([`UNITS_PER_STEP`]). A tick advances `UNITS_PER_STEP >> level` units: with `level` 2 that
/// is 4 units, so 4 ticks make a step.
///
/// Packed, because with padding to four bytes a [`ToStep`] would have 20 bytes. The CPU loads unaligned words as fast
/// as aligned ones.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(C, packed(2))]
pub struct Segment {
    /// Time from the previous tick to the first tick of the segment, in ticks of the step clock, in fixed point with
    /// [`INTERVAL_FRACTION_BITS`]. Each further interval is longer by `ramp`.
    pub interval: u32,
    /// Change of the interval from tick to tick, in the same fixed point.
    pub ramp: i32,
    /// Number of ticks, at least 1.
    pub ticks: u16,
    /// Spindle or laser power from the first tick on, 0 (off) to 65535 (full).
    pub power: u16,
    /// Smoothing: 2^level ticks make a step of the dominant axis; 0..=4.
    pub level: u8,
    /// See the `FLAG_` constants of [`Segment`].
    pub flags: u8,
}

impl Segment {
    /// This is the first segment of the block sent last.
    pub const FLAG_NEW_BLOCK: u8 = 1;
    /// Motion is at rest after this segment, so an empty queue is not an underrun.
    pub const FLAG_LAST: u8 = 2;
    /// The ticks let time pass without motion (for feeds that are too slow for the timer).
    pub const FLAG_WAIT: u8 = 4;
    /// The move is a rapid. Ignored by the step task; used by programs that draw the motion.
    pub const FLAG_RAPID: u8 = 8;
}

/// Fraction bits of [`Segment::interval`].
pub const INTERVAL_FRACTION_BITS: u32 = 12;
/// Number of units of progress in one step of the dominant axis.
pub const UNITS_PER_STEP: u32 = 16;

/// step -> control.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum StepEvent<const N: usize> {
    /// Pulses have stopped on request (reset, limit).
    Stopped {
        /// Number of stops since power-up (wrapping).
        stops: u16,
        /// Whether the machine was stepping at the stop.
        moving: bool,
        /// Step counter of each axis: net steps since power-up (wrapping).
        position: PerAxis<i32, N>,
    },
    /// The probe input has the level for which [`ToStep::Watch`] waits; the step task brakes.
    Probed {
        /// Step counter of each axis at the tick that detected the contact.
        position: PerAxis<i32, N>,
    },
    /// The step queue ran empty while the machine was moving. Pulses have stopped, and `stops` counts this as a stop.
    Underrun {
        /// As in [`StepEvent::Stopped`].
        stops: u16,
        /// As in [`StepEvent::Stopped`].
        position: PerAxis<i32, N>,
    },
    /// The outputs did not make the commanded pulses, so the machine is not where the step counters say. Pulses have
    /// stopped; this counts as a stop.
    Miscounted {
        /// As in [`StepEvent::Stopped`].
        stops: u16,
        /// As in [`StepEvent::Stopped`].
        position: PerAxis<i32, N>,
    },
}
