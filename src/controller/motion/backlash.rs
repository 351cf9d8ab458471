//! Backlash compensation: the slack that a motor must turn through after a reversal before the tool follows. Keeps how
//! far each motor leads the tool, and adds the missing steps to the moves that follow.
//!
//! ```text
//!   motor ──┐ slack ┌── tool        moving to positive: the slack is open on the motor's leading side, motor = tool + slack
//!           └───────┘               moving to negative: motor = tool
//! ```
//! The motor's extra steps ride with the moves after the reversal, spread over as much of the path as keeps the bend that
//! they make in the motors' path within what the corner rule takes at full speed. It promises that at rest all of them
//! have been taken, and that the place of the tool is known at any moment: the tool follows its motor as a carriage with
//! play does. Steps here are steps of motors.

use super::trapezoid::{lesser, square_root};
use crate::axes::PerAxis;

/// Least share of a move's length that is taken up in it, whatever the corner rule says: less would stretch the error over
/// a long way (and with a junction deviation of 0 for ever).
const LEAST_SHARE: f32 = 0.02;
/// Greatest share: more would let the motor run at twice the speed of the tool.
const GREATEST_SHARE: f32 = 1.0;

/// The slack of each motor's drive, and how much of it the queue takes up.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Backlash<const N: usize> {
    /// Steps of slack; 0 = none.
    slack: [i32; N],
    /// Whether any motor has slack.
    is_on: bool,
    /// How far the motor leads the tool at the end of the queue, 0 to `slack`.
    lead: [i32; N],
    /// How far it must lead after the last direction taken.
    wanted: [i32; N],
}

/// How far each motor leads its tool, in steps.
pub(super) type Lead<const N: usize> = [i32; N];

/// Motors, and how far each leads its tool because of backlash.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Motors<const N: usize> {
    pub steps: PerAxis<i32, N>,
    pub lead: Lead<N>,
}

impl<const N: usize> Motors<N> {
    pub(super) const ZERO: Self = Self { steps: PerAxis::all(0), lead: [0; N] };

    /// The step at which the tool is.
    pub(super) fn tool(&self) -> PerAxis<i32, N> {
        self.steps.zip(&PerAxis(self.lead), i32::wrapping_sub)
    }
}

impl<const N: usize> Backlash<N> {
    pub(super) const NONE: Self = Self { slack: [0; N], is_on: false, lead: [0; N], wanted: [0; N] };

    /// New slacks; a lead stays as far as it can.
    pub(super) fn configure(&mut self, slack: [i32; N]) {
        self.slack = slack;
        self.is_on = slack.iter().any(|slack| *slack != 0);
        self.rest(self.lead);
    }

    /// A lead as far as the slack allows it.
    pub(super) fn lead_within(&self, mut lead: Lead<N>) -> Lead<N> {
        for (lead, slack) in lead.iter_mut().zip(self.slack) {
            *lead = (*lead).clamp(0, slack);
        }
        lead
    }

    /// The queue is empty, and begins with this lead.
    pub(super) fn rest(&mut self, lead: Lead<N>) {
        self.lead = self.lead_within(lead);
        self.wanted = self.lead;
    }

    /// How far the motors lead at the end of the queue.
    pub(super) fn lead(&self) -> Lead<N> {
        self.lead
    }

    /// How far they have to lead when all has been taken up.
    pub(super) fn want(&mut self, lead: Lead<N>) {
        self.wanted = lead;
    }

    /// Whether any motor has slack.
    #[inline]
    pub(super) fn is_on(&self) -> bool {
        self.is_on
    }

    /// Takes over the directions of a move (in steps of the tool). Motors that do not move want what they wanted.
    pub(super) fn turn(&mut self, moved: &[i32; N]) {
        for ((wanted, moved), slack) in self.wanted.iter_mut().zip(moved).zip(self.slack) {
            match *moved {
                1.. => *wanted = slack,
                ..=-1 => *wanted = 0,
                0 => {}
            }
        }
    }

    /// Steps that still have to be taken up.
    pub(super) fn outstanding(&self) -> [i32; N] {
        let mut outstanding = self.wanted;
        for (steps, lead) in outstanding.iter_mut().zip(self.lead) {
            *steps -= lead;
        }
        outstanding
    }

    /// Whether something has to be taken up.
    #[inline]
    pub(super) fn is_outstanding(&self) -> bool {
        self.lead != self.wanted
    }

    /// Takes up at most `most` steps of each motor; which ones, with their direction.
    pub(super) fn take_up(&mut self, most: &[i32; N]) -> [i32; N] {
        let mut taken = self.outstanding();
        for ((steps, lead), most) in taken.iter_mut().zip(self.lead.iter_mut()).zip(most) {
            *steps = (*steps).clamp(-most, *most);
            *lead += *steps;
        }
        taken
    }

    /// Takes up all that is left when the tools are this far short of their places: which steps of each motor. A tool that is
    /// short has not followed a move that was turned back from before the slack was used up; it is brought there first.
    pub(super) fn finish(&mut self, short: &[i32; N]) -> [i32; N] {
        let mut taken = [0; N];
        let wanted = self.wanted.into_iter().zip(self.slack).zip(short);
        for ((taken, lead), ((wanted, slack), short)) in taken.iter_mut().zip(self.lead.iter_mut()).zip(wanted) {
            let aim = match *short {
                1.. => slack,
                ..=-1 => 0,
                0 => wanted,
            };
            *taken = aim - *lead;
            *lead = aim;
        }
        taken
    }

    /// The lead after motors have turned by so many steps, each in one direction.
    pub(super) fn follow(&self, lead: &Lead<N>, turned: &[i32; N]) -> Lead<N> {
        let mut after = *lead;
        for ((lead, turned), slack) in after.iter_mut().zip(turned).zip(self.slack) {
            *lead = lead.saturating_add(*turned).clamp(0, slack);
        }
        after
    }

    /// The motors after they have turned to other steps, each in one direction.
    pub(super) fn followed(&self, from: &Motors<N>, steps: PerAxis<i32, N>) -> Motors<N> {
        let turned = steps.zip(&from.steps, i32::wrapping_sub);
        Motors { steps, lead: self.follow(&from.lead, &turned.0) }
    }
}

/// The share of a move's length that a motor may take up in it: half of the bend in the motors' path that the corner rule
/// takes at `speed` (mm/s). The other half is for bends that the tool's path has already, as between chords of an arc. For
/// a small angle φ the rule is v² = 8·a·d/φ² (`TurnRule::junction2`).
pub(super) fn share(acceleration: f32, deviation: f32, speed: f32) -> f32 {
    let angle = 0.5 * square_root(8.0 * acceleration * deviation) / speed;
    // Not a number counts as none.
    if angle > LEAST_SHARE { lesser(angle, GREATEST_SHARE) } else { LEAST_SHARE }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn slack_is_taken_up_after_a_reversal() {
        let mut backlash = Backlash::<2>::NONE;
        backlash.configure([5, 3]);
        backlash.turn(&[1, -9]);
        assert_eq!(backlash.outstanding(), [5, 0]);
        assert_eq!(backlash.take_up(&[2, 2]), [2, 0]);
        // Turned back before all was taken: only that comes back.
        backlash.turn(&[-1, 0]);
        assert_eq!(backlash.outstanding(), [-2, 0]);
        backlash.turn(&[4, 4]);
        assert_eq!(backlash.take_up(&[9, 9]), [3, 3]);
        assert!(!backlash.is_outstanding());
    }

    #[test]
    fn a_tool_that_has_not_followed_is_brought_to_its_place() {
        let mut backlash = Backlash::<2>::NONE;
        backlash.configure([5, 3]);
        backlash.turn(&[1, 2]);
        assert_eq!(backlash.take_up(&[1, 3]), [1, 3]);
        backlash.turn(&[-1, -1]);
        assert_eq!(backlash.take_up(&[1, 3]), [-1, -3]);
        assert_eq!(backlash.finish(&[1, 0]), [5, 0]);
        assert_eq!(backlash.finish(&[0, 0]), [-5, 0]);
        assert_eq!(backlash.finish(&[0, 0]), [0, 0]);
    }

    #[test]
    fn a_tool_follows_when_the_slack_is_used_up() {
        let mut backlash = Backlash::<1>::NONE;
        backlash.configure([5]);
        assert_eq!(backlash.follow(&[0], &[3]), [3]);
        assert_eq!(backlash.follow(&[3], &[100]), [5]);
        assert_eq!(backlash.follow(&[5], &[-2]), [3]);
        assert_eq!(backlash.follow(&[3], &[-100]), [0]);
        let followed = backlash.followed(&Motors { steps: PerAxis([10]), lead: [3] }, PerAxis([14]));
        assert_eq!(followed, Motors { steps: PerAxis([14]), lead: [5] });
        assert_eq!(followed.tool(), PerAxis([9]));
    }
}
