//! Backlash compensation. After a reversal, a motor must turn through the backlash of its drive (in steps) before the
//! tool follows. This module tracks the *lead* of each motor: the number of steps by which the motor is ahead of the
//! tool. After a reversal, the module adds extra steps to the moves until the motor has turned through the backlash:
//! the motor *takes up* the backlash.
//!
//! ```text
//!   - ◀───▶ +    The motor M moves in a gap of the tool's drive. The gap is as wide as the backlash.
//!
//!   [M      ]    M moves to negative and pushes at the lower end of the gap: motor = tool
//!   [      M]    M moves to positive and pushes at the upper end of the gap: motor = tool + backlash
//! ```
//! The extra steps change the direction of the motors' path. They are spread over a part of the tool's path that is
//! long enough for the corner rule ([`super::junction`]) to allow this change of direction at full speed. In this file,
//! steps are motor steps.
//!
//! Guarantees:
//! * When the queue has run empty and the machine is at rest, all extra steps have been made.
//! * The position of the tool is known at any time, because it follows from that of the motors: the tool moves only
//!   while its motor pushes against one end of the gap.

use super::trapezoid::{lesser, square_root};
use crate::axes::PerAxis;

/// Minimum of [`share`], even if the corner rule allows less: a motor may always take up backlash of 2 % of the move's
/// length (2 mm in a move of 100 mm). With a smaller share, the tool would be off its position for a long distance (for
/// ever, if the junction deviation is 0).
const LEAST_SHARE: f32 = 0.02;
/// Maximum of [`share`]: the backlash that a motor takes up in a move is at most the length of the move. With more
/// backlash in a move, the motor would exceed twice the tool's speed.
const GREATEST_SHARE: f32 = 1.0;

/// The backlash of each motor's drive, and the state of its compensation at the end of the queue.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Backlash<const N: usize> {
    /// Backlash in steps; 0 = none.
    steps: [i32; N],
    /// Whether any motor has backlash.
    is_on: bool,
    /// Steps by which each motor leads the tool at the end of the queue, 0 to `steps`.
    lead: [i32; N],
    /// Lead that each motor must reach by extra steps. [`Backlash::turn`] sets it to 0 if the motor turns to negative,
    /// and to `steps` if it turns to positive. [`Backlash::set_wanted`] sets any lead.
    wanted: [i32; N],
}

/// Steps by which each motor leads the tool.
pub(super) type Lead<const N: usize> = [i32; N];

/// Position of the motors in steps, and the lead of each: the steps by which backlash puts it ahead of the tool.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Motors<const N: usize> {
    pub steps: PerAxis<i32, N>,
    pub lead: Lead<N>,
}

impl<const N: usize> Motors<N> {
    pub(super) const ZERO: Self = Self { steps: PerAxis::all(0), lead: [0; N] };

    /// Returns the position of the tool in motor steps: position minus lead.
    pub(super) fn tool(&self) -> PerAxis<i32, N> {
        self.steps.zip(&PerAxis(self.lead), i32::wrapping_sub)
    }
}

impl<const N: usize> Backlash<N> {
    pub(super) const NONE: Self = Self { steps: [0; N], is_on: false, lead: [0; N], wanted: [0; N] };

    /// Sets the backlash of each motor, and limits each lead to it.
    pub(super) fn configure(&mut self, steps: [i32; N]) {
        self.steps = steps;
        self.is_on = steps.iter().any(|steps| *steps != 0);
        self.rest(self.lead);
    }

    /// Returns `lead` with the steps of each motor limited to the range from 0 to its backlash.
    pub(super) fn lead_within(&self, mut lead: Lead<N>) -> Lead<N> {
        for (lead, backlash) in lead.iter_mut().zip(self.steps) {
            *lead = (*lead).clamp(0, backlash);
        }
        lead
    }

    /// Sets the lead of each motor while the queue is empty. After that, no steps remain to be taken up.
    pub(super) fn rest(&mut self, lead: Lead<N>) {
        self.lead = self.lead_within(lead);
        self.wanted = self.lead;
    }

    /// Returns the motors' lead at the end of the queue.
    pub(super) fn lead(&self) -> Lead<N> {
        self.lead
    }

    /// Sets the lead that each motor must reach by extra steps. The next move that turns a motor replaces its
    /// wanted lead.
    pub(super) fn set_wanted(&mut self, lead: Lead<N>) {
        self.wanted = lead;
    }

    /// Returns whether any motor has backlash.
    #[inline]
    pub(super) fn is_on(&self) -> bool {
        self.is_on
    }

    /// Sets the wanted lead of each motor for a move of the tool. The wanted lead is the backlash if the move turns the
    /// motor to positive, and 0 if it turns the motor to negative. A motor that does not turn keeps its wanted lead.
    /// `moved`: signed steps of the move.
    pub(super) fn turn(&mut self, moved: &[i32; N]) {
        for ((wanted, moved), backlash) in self.wanted.iter_mut().zip(moved).zip(self.steps) {
            match *moved {
                1.. => *wanted = backlash,
                ..=-1 => *wanted = 0,
                0 => {}
            }
        }
    }

    /// Returns the signed steps that each motor has yet to take up: its wanted lead minus its lead.
    pub(super) fn outstanding(&self) -> [i32; N] {
        let mut outstanding = self.wanted;
        for (steps, lead) in outstanding.iter_mut().zip(self.lead) {
            *steps -= lead;
        }
        outstanding
    }

    /// Returns whether any motor has yet to take up steps.
    #[inline]
    pub(super) fn is_outstanding(&self) -> bool {
        self.lead != self.wanted
    }

    /// Takes up at most `most` steps of each motor. Returns the steps taken up, signed.
    pub(super) fn take_up(&mut self, most: &[i32; N]) -> [i32; N] {
        let mut taken = self.outstanding();
        for ((steps, lead), most) in taken.iter_mut().zip(self.lead.iter_mut()).zip(most) {
            *steps = (*steps).clamp(-most, *most);
            *lead += *steps;
        }
        taken
    }

    /// Returns the signed steps that each motor must still make at the end of the queue, and counts them as made.
    /// `short`: for each motor, the signed steps from the tool's position to its programmed position. The tool has not
    /// reached its programmed position if a move after a reversal ended before the motor had turned through the
    /// backlash. The returned steps then move the tool to that position.
    pub(super) fn finish(&mut self, short: &[i32; N]) -> [i32; N] {
        let mut taken = [0; N];
        let wanted = self.wanted.into_iter().zip(self.steps).zip(short);
        for ((taken, lead), ((wanted, backlash), short)) in taken.iter_mut().zip(self.lead.iter_mut()).zip(wanted) {
            let aim = match *short {
                1.. => backlash,
                ..=-1 => 0,
                0 => wanted,
            };
            *taken = aim - *lead;
            *lead = aim;
        }
        taken
    }

    /// Returns the lead of the motors after they have turned by `turned` signed steps, each in one direction. `lead`:
    /// their lead before that.
    pub(super) fn follow(&self, lead: &Lead<N>, turned: &[i32; N]) -> Lead<N> {
        let mut after = *lead;
        for ((lead, turned), backlash) in after.iter_mut().zip(turned).zip(self.steps) {
            *lead = lead.saturating_add(*turned).clamp(0, backlash);
        }
        after
    }

    /// Returns the position and lead of the motors after they have turned from `from` to the position `steps`, each in
    /// one direction.
    pub(super) fn followed(&self, from: &Motors<N>, steps: PerAxis<i32, N>) -> Motors<N> {
        let turned = steps.zip(&from.steps, i32::wrapping_sub);
        Motors { steps, lead: self.follow(&from.lead, &turned.0) }
    }
}

/// Returns how much of its backlash a motor can take up in a move, as a share of the move's length. The extra steps
/// change the direction of the path by an angle (rad) that equals this share. The share is half of the angle that the
/// corner rule allows at `speed` (mm/s). The other half is left for changes of direction in the tool's path, as between
/// the chords of an arc.
///
/// For a small angle φ, the corner rule is v² = 8·a·d/φ² (`TurnRule::junction2`), with the speed v, the acceleration a
/// (mm/s²) and the junction deviation d (mm). Example: with 500 mm/s², 0.01 mm and 50 mm/s, φ is 0.126 rad, so the
/// share is 0.063.
pub(super) fn share(acceleration: f32, deviation: f32, speed: f32) -> f32 {
    let angle = 0.5 * square_root(8.0 * acceleration * deviation) / speed;
    // If `angle` is NaN, the comparison is false, and the share is the minimum.
    if angle > LEAST_SHARE { lesser(angle, GREATEST_SHARE) } else { LEAST_SHARE }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn backlash_is_taken_up_after_a_reversal() {
        let mut backlash = Backlash::<2>::NONE;
        backlash.configure([5, 3]);
        backlash.turn(&[1, -9]);
        assert_eq!(backlash.outstanding(), [5, 0]);
        assert_eq!(backlash.take_up(&[2, 2]), [2, 0]);
        // The direction reverses before all steps were taken up: only the steps taken up so far must be undone.
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
    fn a_tool_follows_when_the_backlash_is_used_up() {
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
