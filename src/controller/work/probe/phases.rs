//! The phases of a probing move, and the result of the last probing move.
//!
//! ```text
//!  begin ──▶ Seeking ──contact──▶ Braking ──stopped──▶ Touched ──▶ finish
//!               └──── end of the move without a contact ──────────▶ finish
//! ```
//! The step task checks the input at each tick. After the contact it brakes by itself, without an order of the
//! controller. Once the step task is at rest, the controller orders a stop, because the report of the stop gives the
//! position. Then the controller lets the step task run again.

use crate::axes::PerAxis;
use crate::messages::ToStep;
use crate::units::Coordinate;

/// What the step task looks for: the level of the input, and the deceleration with which it brakes when the input has
/// that level ([`ToStep::Watch`]).
#[derive(Clone, Copy, Debug, PartialEq)]
struct Watched {
    level: bool,
    braking: f32,
}

#[derive(Clone, Copy, Debug, PartialEq)]
enum Phase {
    /// Moving, no contact yet; holds what the step task looks for.
    Seeking(Watched),
    /// Contact has been made; the step task brakes.
    Braking,
    /// Contact has been made, and the machine is at rest.
    Touched,
}

/// The probing move in progress, and the result of the last probing move.
#[derive(Clone, Copy, Debug)]
pub struct Probe<const N: usize> {
    phase: Option<Phase>,
    /// Message that begins or ends the step task's watch of the probe, if it has not been sent yet.
    watch: Option<ToStep>,
    succeeded: bool,
    position: PerAxis<Coordinate, N>,
}

const WATCH_ENDS: ToStep = ToStep::Watch { probe: None, braking: 0.0 };

impl<const N: usize> Probe<N> {
    /// The state at power-up: no probing move has been made.
    pub const NONE: Self =
        Self { phase: None, watch: None, succeeded: false, position: PerAxis::all(Coordinate::ZERO) };

    /// Begins a probing move. The step task waits for the input to become active (inactive with `away`), and then
    /// brakes with the deceleration `braking` ([`ToStep::Watch`]).
    pub fn begin(&mut self, away: bool, braking: f32) {
        self.phase = Some(Phase::Seeking(Watched { level: !away, braking }));
        self.watch_again();
    }

    /// Makes the step task ignore the probe while the tool is parked, because contacts in that time do not count.
    pub fn look_away(&mut self) {
        if self.is_seeking() {
            self.watch = Some(WATCH_ENDS);
        }
    }

    /// Makes the step task watch the probe, at the start of the move and again after parking.
    pub fn watch_again(&mut self) {
        if let Some(Phase::Seeking(Watched { level, braking })) = self.phase {
            self.watch = Some(ToStep::Watch { probe: Some(level), braking });
        }
    }

    fn is_seeking(&self) -> bool {
        matches!(self.phase, Some(Phase::Seeking(_)))
    }

    /// Returns the message about the watch that is to be sent to the step task now, if any.
    pub fn take_watch(&mut self) -> Option<ToStep> {
        self.watch.take()
    }

    /// Records a contact that the step task has seen. `position` returns the position of the contact.
    pub fn contact(&mut self, position: impl FnOnce() -> PerAxis<Coordinate, N>) {
        if self.is_seeking() {
            self.phase = Some(Phase::Braking);
            self.position = position();
        }
    }

    /// Returns whether the step task is braking after a contact, or has braked and waits to be stopped. The step task
    /// takes no messages until it has been stopped.
    pub fn is_braking(&self) -> bool {
        self.phase == Some(Phase::Braking)
    }

    /// Returns whether no probing move is in progress and the step task has been told to end its watch of the input.
    pub fn is_over(&self) -> bool {
        self.phase.is_none() && self.watch.is_none()
    }

    /// Records that the step task has been stopped, for any reason. A stop also ends the step task's watch of the
    /// probe, so no message about the watch is sent after it.
    pub fn stopped(&mut self) {
        self.watch = None;
    }

    /// Records that the machine is at rest after the contact: the stop that was ordered for the contact is over.
    pub fn rests_after_contact(&mut self) {
        self.phase = Some(Phase::Touched);
    }

    /// Returns whether contact has been made, so that the rest of the move is void.
    pub fn has_touched(&self) -> bool {
        matches!(self.phase, Some(Phase::Braking | Phase::Touched))
    }

    /// Returns whether contact was made; `None` until that is certain. `idle`: nothing moves, and nothing is queued.
    pub fn outcome(&self, idle: bool) -> Option<bool> {
        match self.phase {
            Some(Phase::Touched) => Some(true),
            Some(Phase::Seeking(_)) if idle => Some(false),
            _ => None,
        }
    }

    /// Ends the probing move. If there was no contact and none was required (G38.3, G38.5), the result is the machine's
    /// position `here`.
    pub fn finish(&mut self, touched: bool, must_touch: bool, here: PerAxis<Coordinate, N>) {
        self.phase = None;
        self.watch = Some(WATCH_ENDS);
        self.succeeded = touched;
        if !touched && !must_touch {
            self.position = here;
        }
    }

    /// Ends the probing move without a result, after the step task has been stopped.
    pub fn forget_move(&mut self) {
        self.phase = None;
    }

    /// Ends the probing move without a result while the step task still watches the input, and requests the end of that
    /// watch.
    pub fn break_off(&mut self) {
        self.phase = None;
        self.watch = Some(WATCH_ENDS);
    }

    /// Returns the position (machine coordinates) of the last probing move, and whether that move made contact.
    pub fn result(&self) -> (PerAxis<Coordinate, N>, bool) {
        (self.position, self.succeeded)
    }

    /// Resets the result to that of power-up: position 0 and no success.
    pub fn forget_result(&mut self) {
        self.position = PerAxis::default();
        self.succeeded = false;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(mm: i32) -> PerAxis<Coordinate, 3> {
        PerAxis::all(Coordinate::mm(mm))
    }

    #[test]
    fn the_first_contact_counts() {
        let mut probe = Probe::<3>::NONE;
        probe.contact(|| at(9));
        assert_eq!((probe.result().0, probe.outcome(true)), (at(0), None), "no probe is under way");
        probe.begin(false, 2.0);
        assert_eq!(probe.take_watch(), Some(ToStep::Watch { probe: Some(true), braking: 2.0 }));
        assert_eq!((probe.take_watch(), probe.outcome(false)), (None, None));
        probe.contact(|| at(1));
        probe.contact(|| at(2));
        assert!(probe.is_braking() && probe.has_touched() && probe.outcome(true).is_none());
        probe.rests_after_contact();
        assert_eq!(probe.outcome(false), Some(true));
        probe.finish(true, true, at(3));
        assert_eq!(probe.result(), (at(1), true));
        assert_eq!(probe.take_watch(), Some(WATCH_ENDS));
        probe.forget_result();
        assert_eq!(probe.result(), (at(0), false));
    }

    #[test]
    fn without_a_contact_the_end_of_the_move_counts_if_none_was_required() {
        for (must_touch, result) in [(true, at(0)), (false, at(3))] {
            let mut probe = Probe::<3>::NONE;
            probe.begin(true, 2.0);
            assert_eq!(probe.outcome(true), Some(false));
            probe.finish(false, must_touch, at(3));
            assert_eq!(probe.result(), (result, false));
        }
    }
}
