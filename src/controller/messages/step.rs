//! Messages between the control task and the step task: blocks and segments in one direction, stops, contacts and
//! underruns in the other.

use crate::axes::PerAxis;

/// control -> step. At most 16 bytes, so that a receive in the step interrupt stays cheap.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum ToStep {
    /// Steps of the axes A, B and C of the next block; sent before its [`ToStep::Block`] if any of them moves.
    BlockRest {
        /// The parts of A, B, C.
        steps_by_axis: [AxisSteps; 3],
    },
    /// The straight move that the following segments are pieces of. Takes effect with the first of them.
    Block {
        /// The parts of X, Y, Z.
        steps_by_axis: [AxisSteps; 3],
        /// Bit set = axis moves to negative; bit 0 is X.
        directions: u8,
    },
    /// The block just sent is entered at this many units and not at its start: it was left for a detour.
    Reenter {
        /// Units of the block that have been done.
        units: u32,
    },
    /// A piece of the current block.
    Segment(Segment),
    /// Looks for the probe at each tick from here on. Once it is active (`Some(true)`) or no longer active
    /// (`Some(false)`) the place is latched and reported with [`StepEvent::Probed`], what is queued is thrown away, and
    /// the step task brakes by itself; it takes nothing more until it has been stopped and resumed. `None` ends the watch.
    Watch {
        /// The awaited state of the probe.
        probe: Option<bool>,
        /// How hard to brake: the deceleration in units per square of a step-clock tick.
        braking: f32,
    },
    /// Opens the step task after a stop: everything queued before it is thrown away. `stops` is the count of stops that
    /// `control` knew of; the gate stays shut when there has been another one since.
    Resume {
        /// Value of [`StepEvent::Stopped::stops`] that this answers.
        stops: u16,
    },
}

impl ToStep {
    /// Whether it says what a block is, of which a segment is to follow.
    #[inline]
    pub fn announces_block(&self) -> bool {
        matches!(self, ToStep::BlockRest { .. } | ToStep::Block { .. } | ToStep::Reenter { .. })
    }
}

/// The part of one axis in a block: its steps, and how far the true ends of the move are from the steps they are rounded
/// to.
///
/// A line begins and ends on steps. A chord of an arc does not, or rounding would bend the arc: it is stepped along its true
/// ends. How far they are is told in sevenths of a step, positive in the direction of motion (of an axis without steps: to
/// positive).
///
/// One word: steps in the lower 26 bits, then three bits of each end.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[repr(transparent)]
pub struct AxisSteps(u32);

impl AxisSteps {
    /// Less than 2 to the power of this are the steps of an axis in a block.
    pub const STEP_BITS: u32 = 26;
    /// Parts of a step in which the ends are told. Odd, so that there are as many on either side of zero.
    pub const PARTS: u32 = 7;
    /// The ends are this many parts from a step at most.
    pub const FARTHEST: i32 = 3;
    const STEPS: u32 = (1 << Self::STEP_BITS) - 1;

    /// From step to step.
    #[inline]
    pub const fn on_steps(steps: u32) -> AxisSteps {
        AxisSteps(steps & Self::STEPS)
    }

    /// With true ends, each within [`AxisSteps::FARTHEST`].
    #[inline]
    pub const fn with_ends(steps: u32, start: i32, end: i32) -> AxisSteps {
        AxisSteps(steps & Self::STEPS | (start as u32 & 7) << Self::STEP_BITS | (end as u32) << (Self::STEP_BITS + 3))
    }

    /// Unsigned steps.
    #[inline]
    pub const fn steps(self) -> u32 {
        self.0 & Self::STEPS
    }

    /// True start less rounded start, in sevenths of a step.
    #[inline]
    pub const fn start(self) -> i32 {
        (self.0 << 3) as i32 >> (Self::STEP_BITS + 3)
    }

    /// True end less rounded end, in sevenths of a step.
    #[inline]
    pub const fn end(self) -> i32 {
        self.0 as i32 >> (Self::STEP_BITS + 3)
    }

    /// All of it.
    #[inline]
    pub const fn word(self) -> u32 {
        self.0
    }

    /// Whether both ends are on steps.
    #[inline]
    pub const fn is_on_steps(self) -> bool {
        self.0 <= Self::STEPS
    }
}

/// Some ticks with evenly changing intervals. The unit of progress within a block is 1/16 of a step of its dominant axis
/// ([`UNITS_PER_STEP`]); a tick advances `UNITS_PER_STEP >> level` of them.
///
/// Packed, because padding to four bytes would make a [`ToStep`] of 20 bytes; the CPU loads unaligned words as fast.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(C, packed(2))]
pub struct Segment {
    /// Step-clock ticks before the first tick of the segment, in fixed point with [`INTERVAL_FRACTION_BITS`]; each
    /// further tick follows after `ramp` more.
    pub interval: u32,
    /// Change of the interval from tick to tick, same fixed point.
    pub ramp: i32,
    /// How many ticks, at least 1.
    pub ticks: u16,
    /// Spindle or laser power from the first tick on, 0 (off) to 65535 (full).
    pub power: u16,
    /// Smoothing: 2^level ticks make a step of the dominant axis; 0..=4.
    pub level: u8,
    /// See the `FLAG_` constants of [`Segment`].
    pub flags: u8,
}

impl Segment {
    /// The segment begins the block sent last.
    pub const FLAG_NEW_BLOCK: u8 = 1;
    /// Motion is at rest after this segment: an empty queue is no fault.
    pub const FLAG_LAST: u8 = 2;
    /// Time passes and nothing moves: the ticks advance no units (feeds slower than the timer's reach).
    pub const FLAG_WAIT: u8 = 4;
    /// The move is a rapid. The step task does not care; those who draw what it did do.
    pub const FLAG_RAPID: u8 = 8;
}

/// Fraction bits of [`Segment::interval`].
pub const INTERVAL_FRACTION_BITS: u32 = 12;
/// Units of progress in one step of the dominant axis.
pub const UNITS_PER_STEP: u32 = 16;

/// step -> control.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum StepEvent<const N: usize> {
    /// Pulses have stopped because someone asked (reset, limit).
    Stopped {
        /// How often this has happened since power-up (wrapping).
        stops: u16,
        /// Whether the machine was stepping when the stop came.
        moving: bool,
        /// Step counter of each axis: net steps since power-up (wrapping).
        position: PerAxis<i32, N>,
    },
    /// The probe has reached the awaited state; the step task brakes.
    Probed {
        /// Step counter of each axis at the tick that saw it.
        position: PerAxis<i32, N>,
    },
    /// The queue ran dry at speed. Pulses have stopped; counts as a stop.
    Underrun {
        /// As in [`StepEvent::Stopped`].
        stops: u16,
        /// As in [`StepEvent::Stopped`].
        position: PerAxis<i32, N>,
    },
    /// The outputs have not put out what they were told to: the position is not what the count says. Pulses have stopped;
    /// counts as a stop.
    Miscounted {
        /// As in [`StepEvent::Stopped`].
        stops: u16,
        /// As in [`StepEvent::Stopped`].
        position: PerAxis<i32, N>,
    },
}
