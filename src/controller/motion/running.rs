//! The block that is being cut into segments: its progress, its speed limits, and the messages to the step task that
//! must precede the next segment. Computes the speed curve of the rest of the block, also for braking in a hold. A unit
//! is 1/16 step of the axis with the most steps.

use super::block::{Block, MARK_SHIFT, OverrideFactors, RAPID, SCALE_POWER};
use super::measure::{Measure, signed_add, steps_taken};
use super::planner::Planner;
use super::trapezoid::{OFF_CURVE, Pace, Trapezoid, lesser};
use crate::axes::{LINEAR, PerAxis};
use crate::messages::{AxisSteps, ToStep};

/// Limit of slow motion in a hold: the time, s, for two units. The machine stops at once if it needs more time for two
/// units and could brake to rest within one unit.
const CRAWL_S: f32 = 0.001;

/// The next message about a block to the step task.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum BlockStage {
    /// No message, because no block is running.
    Nothing,
    /// The steps of the axes beyond the first three.
    UpperAxes,
    /// The steps of the first three axes, and directions.
    Block,
    /// Re-entry into the block, because the step task left it part-way to execute other moves.
    Reenter,
    /// The first segment after the announcement of the block.
    FirstSegment,
    /// Further segments.
    Segments,
}

/// State of motion at the end of the last handed-over segment.
#[derive(Clone, Copy, Debug)]
pub(super) struct PathMotion {
    /// Speed, in units/s of the running block; mm/s between blocks.
    pub pace: Pace,
    /// Acceleration along the path, mm/s²; only with a jerk limit.
    pub acceleration: f32,
    /// Lowest acceleration bound, mm/s², of the blocks that the machine would pass if it began to reduce its
    /// acceleration to 0 now; only with a jerk limit.
    pub ease_off_limit: f32,
}

impl PathMotion {
    pub(super) const REST: Self = Self { pace: Pace::REST, acceleration: 0.0, ease_off_limit: 0.0 };

    #[inline]
    pub(super) fn stop(&mut self) {
        self.pace = Pace::REST;
        self.acceleration = 0.0;
    }
}

/// The block that is being cut into segments, and how far it has been cut.
#[derive(Clone, Copy, Debug)]
pub(super) struct Running<const N: usize> {
    pub stage: BlockStage,
    steps_by_axis: [AxisSteps; N],
    directions: u8,
    flags: u8,
    power: u16,
    pub line_number: u32,
    /// Value of one step in the sums of `rates` and `credits`; see [`Measure`] for all three.
    threshold: u32,
    rates: [u32; N],
    credits: [u32; N],
    /// Length of the block in units.
    pub total: u32,
    /// Number of units that have been cut into segments so far.
    pub done: u32,
    /// Units per millimetre.
    pub scale: f32,
    /// Acceleration, units/s².
    pub acceleration: f32,
    /// Nominal speed², units²/s².
    pub nominal2: f32,
    /// Speed at which a laser with scaled power has the programmed power, mm/s. It is the programmed feed before
    /// overrides, or the speed limit of a rapid.
    programmed: f32,
}

impl<const N: usize> Running<N> {
    pub(super) const NONE: Self = Self {
        stage: BlockStage::Nothing,
        steps_by_axis: [AxisSteps::on_steps(0); N],
        directions: 0,
        flags: 0,
        power: 0,
        line_number: 0,
        threshold: 0,
        rates: [0; N],
        credits: [0; N],
        total: 0,
        done: 0,
        scale: 1.0,
        acceleration: 1.0,
        nominal2: 1.0,
        programmed: 1.0,
    };

    /// Creates the running block at its start.
    #[inline]
    pub(super) fn of(block: &Block<N>, overrides: OverrideFactors) -> Self {
        let measure = Measure::of(&block.steps_by_axis);
        let scale = measure.total as f32 / block.length;
        let nominal = block.nominal(overrides) * scale;
        Self {
            stage: Self::announcement(&block.steps_by_axis),
            steps_by_axis: block.steps_by_axis,
            directions: block.directions,
            flags: block.flags,
            power: block.power,
            line_number: block.line_number,
            threshold: measure.threshold,
            rates: block.steps_by_axis.map(|axis_steps| measure.rate(axis_steps)),
            credits: block.steps_by_axis.map(|axis_steps| measure.credit(axis_steps)),
            total: measure.total,
            done: 0,
            scale,
            acceleration: block.acceleration * scale,
            nominal2: nominal * nominal,
            programmed: if block.flags & RAPID != 0 { block.limit } else { block.programmed },
        }
    }

    /// Returns the first message with which a block is announced to the step task.
    #[inline]
    fn announcement(steps_by_axis: &[AxisSteps; N]) -> BlockStage {
        let rest = steps_by_axis.iter().skip(LINEAR);
        // If the axes beyond the first three have no steps, and no offsets at the ends of a chord, they need no
        // message. Offsets count, because the block's threshold depends on them.
        if N > LINEAR && rest.into_iter().any(|axis_steps| *axis_steps != AxisSteps::default()) {
            BlockStage::UpperAxes
        } else {
            BlockStage::Block
        }
    }

    /// Returns whether a block has begun and has not been cut into segments completely.
    #[inline]
    pub(super) fn is_active(&self) -> bool {
        self.stage != BlockStage::Nothing
    }

    /// Restarts the announcement of the block, because the step task has executed other moves meanwhile.
    pub(super) fn announce_again(&mut self) {
        if self.is_active() {
            self.stage = Self::announcement(&self.steps_by_axis);
        }
    }

    /// Returns the next message of the announcement; `None` if it is complete and a segment follows.
    #[inline]
    pub(super) fn announce(&mut self) -> Option<ToStep> {
        let mut steps_by_axis = [AxisSteps::default(); 3];
        match self.stage {
            BlockStage::UpperAxes => {
                self.stage = BlockStage::Block;
                for (out, own) in steps_by_axis.iter_mut().zip(self.steps_by_axis.iter().skip(LINEAR)) {
                    *out = *own;
                }
                Some(ToStep::BlockRest { steps_by_axis })
            }
            BlockStage::Block => {
                self.stage = if self.done > 0 { BlockStage::Reenter } else { BlockStage::FirstSegment };
                for (out, own) in steps_by_axis.iter_mut().zip(self.steps_by_axis.iter()) {
                    *out = *own;
                }
                Some(ToStep::Block { steps_by_axis, directions: self.directions })
            }
            BlockStage::Reenter => {
                self.stage = BlockStage::FirstSegment;
                Some(ToStep::Reenter { units: self.done })
            }
            BlockStage::Nothing | BlockStage::FirstSegment | BlockStage::Segments => None,
        }
    }

    /// Returns how many units of the block have not been cut into segments yet.
    #[inline]
    pub(super) fn left(&self) -> u32 {
        self.total - self.done
    }

    /// Returns whether the whole block has been cut into segments.
    #[inline]
    pub(super) fn is_done(&self) -> bool {
        self.done >= self.total
    }

    #[inline]
    pub(super) fn is_rapid(&self) -> bool {
        self.flags & RAPID != 0
    }

    /// Returns whether power is scaled with the speed (dynamic laser power).
    #[inline]
    pub(super) fn scales_power(&self) -> bool {
        self.flags & SCALE_POWER != 0
    }

    /// Returns the number that `Motion::set_mark` has set for the block.
    #[inline]
    pub(super) fn mark(&self) -> u8 {
        self.flags >> MARK_SHIFT
    }

    /// Returns spindle or laser power, 0 to 65535, at a speed (mm/s). The power depends on the speed only if
    /// [`Running::scales_power`] returns `true` (M4 in laser mode).
    #[inline]
    pub(super) fn power_at(&self, speed: f32) -> u16 {
        if !self.scales_power() {
            return self.power;
        }
        (f32::from(self.power) * (speed / self.programmed)) as u16
    }

    /// Returns the motors' steps after `done` units of the block, which began at `start`.
    #[inline(always)]
    pub(super) fn steps_from(&self, start: &PerAxis<i32, N>) -> PerAxis<i32, N> {
        let mut position = *start;
        let axes = self.steps_by_axis.iter().zip(self.rates.iter().zip(self.credits));
        for (bit, (value, (axis_steps, (rate, credit)))) in position.iter_mut().zip(axes).enumerate() {
            let taken = if self.done == self.total {
                axis_steps.steps()
            } else if *rate == 0 {
                // A rate of 0 means that the axis does not move. An axis with steps has a rate above 0, even if it
                // begins and ends between two steps.
                0
            } else {
                steps_taken(*rate, credit, self.threshold, self.done)
            };
            *value = signed_add(*value, taken, self.directions >> bit & 1 != 0);
        }
        position
    }

    /// Returns the speed curve of the rest of the block and its length in units; `None` for an immediate stop.
    #[inline(always)]
    pub(super) fn trapezoid(&self, pace: Pace, braking: bool, planner: &Planner<N>) -> Option<(Trapezoid, u32)> {
        let left = self.left();
        let planned2 = planner.exit2();
        let acceleration = self.acceleration_towards(planned2, pace, planner);
        if braking {
            return self.braking(pace, acceleration);
        }
        let exit2 = planned2 * (self.scale * self.scale);
        Some((Trapezoid { acceleration, nominal2: self.nominal2, exit2 }, left))
    }

    /// Returns the speed curve for a feed hold and its length in units; `None` for an immediate stop. On this curve
    /// the machine brakes to a stop as soon as possible.
    #[inline]
    fn braking(&self, pace: Pace, acceleration: f32) -> Option<(Trapezoid, u32)> {
        let left = self.left();
        if pace.speed2 <= 0.0 {
            return None;
        }
        let way = pace.speed2 / (2.0 * acceleration);
        if way < 1.0 && pace.speed * CRAWL_S < 2.0 {
            return None;
        }
        if way >= left as f32 {
            // The machine brakes over the whole block, and enters the next one with the remaining speed.
            let exit2 = (pace.speed2 - 2.0 * acceleration * left as f32).max(0.0);
            return Some((Trapezoid { acceleration, nominal2: pace.speed2, exit2 }, left));
        }
        // Stop at the next whole unit, with a slightly lower deceleration.
        let mut stop = way as u32;
        if (stop as f32) < way {
            stop += 1;
        }
        let stop = stop.clamp(1, left);
        let acceleration = pace.speed2 / (2.0 * stop as f32);
        Some((Trapezoid { acceleration, nominal2: pace.speed2, exit2: 0.0 }, stop))
    }

    /// Returns the acceleration for the rest of the block, units/s². `exit2`: planned exit speed², mm²/s². In a bend,
    /// the acceleration is what the bend leaves at the present speed or the exit speed, whichever is lower. The
    /// reverse pass assumes the same.
    ///
    /// A bend can be found late, after the blocks behind it were planned with all of the acceleration. The machine can
    /// then be too fast for the exit. In that case it brakes as hard as necessary, at most with all of the block's
    /// acceleration.
    #[inline]
    fn acceleration_towards(&self, exit2: f32, pace: Pace, planner: &Planner<N>) -> f32 {
        match planner.first() {
            Some(block) if !block.curve.is_none() => {
                let speed2 = pace.speed2 / (self.scale * self.scale);
                // `left_of` is inlined, because a call would make this function save registers for every segment.
                let planned = block.curve.left_of(block.acceleration, lesser(speed2, exit2)) * self.scale;
                let (exit2, twice_left) = (exit2 * self.scale * self.scale, 2.0 * self.left() as f32);
                if pace.speed2 <= (exit2 + planned * twice_left) * OFF_CURVE {
                    return planned;
                }
                lesser((pace.speed2 - exit2) / twice_left, self.acceleration)
            }
            _ => self.acceleration,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn stages<const N: usize>(run: &mut Running<N>) -> Vec<BlockStage> {
        let mut stages = vec![run.stage];
        while run.announce().is_some() {
            stages.push(run.stage);
        }
        stages
    }

    fn block<const N: usize>() -> Block<N> {
        Block {
            steps_by_axis: [AxisSteps::on_steps(10); N],
            length: 1.0,
            programmed: 10.0,
            limit: 10.0,
            ..Block::EMPTY
        }
    }

    #[test]
    fn a_block_is_announced_before_its_first_segment() {
        let mut run = Running::of(&block::<3>(), OverrideFactors::NONE);
        assert_eq!(stages(&mut run), [BlockStage::Block, BlockStage::FirstSegment]);
        let mut run = Running::of(&block::<6>(), OverrideFactors::NONE);
        assert_eq!(stages(&mut run), [BlockStage::UpperAxes, BlockStage::Block, BlockStage::FirstSegment]);
    }

    #[test]
    fn a_block_that_was_left_part_way_is_entered_there() {
        let mut run = Running::of(&block::<3>(), OverrideFactors::NONE);
        run.announce();
        run.done = 32;
        run.announce_again();
        assert_eq!(stages(&mut run), [BlockStage::Block, BlockStage::Reenter, BlockStage::FirstSegment]);
        let mut none = Running::<3>::NONE;
        none.announce_again();
        assert!(!none.is_active() && none.announce().is_none());
    }

    #[test]
    fn the_motors_are_where_the_units_have_brought_them() {
        let mut run = Running::of(&Block { directions: 0b10, ..block::<2>() }, OverrideFactors::NONE);
        run.done = run.total / 2;
        assert_eq!(run.steps_from(&PerAxis([100, 100])), PerAxis([105, 95]));
        run.done = run.total;
        assert_eq!(run.steps_from(&PerAxis([100, 100])), PerAxis([110, 90]));
        assert!(run.is_done() && run.left() == 0);
    }

    #[test]
    fn power_follows_the_speed_only_if_it_is_asked_to() {
        let whole = Block { power: 1000, ..block::<3>() };
        assert_eq!(Running::of(&whole, OverrideFactors::NONE).power_at(5.0), 1000);
        let scaled = Block { flags: SCALE_POWER, ..whole };
        assert_eq!(Running::of(&scaled, OverrideFactors::NONE).power_at(5.0), 500);
    }
}
