//! The phases of a probing move, and the result of the last one.
//!
//! ```text
//!  begin ──▶ Seeking ──contact──▶ Braking ──stopped──▶ Touched ──▶ finish
//!               └──── end of the move without a contact ──────────▶ finish
//! ```
//! The step task looks for the contact at each tick and brakes by itself. At rest it is stopped, asked for the position and
//! opened again.

use crate::axes::PerAxis;
use crate::messages::ToStep;
use crate::units::Coordinate;

/// A level of the input, and how hard the step task brakes when it sees it.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Watched {
    level: bool,
    braking: f32,
}

/// How far a probe is.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Phase {
    /// Moving, no contact yet. What the step task has been told to look for.
    Seeking(Watched),
    /// Contact has been made; the step task brakes.
    Braking,
    /// Contact has been made, and the machine is at rest.
    Touched,
}

/// The probe move under way, and the result of the last one.
#[derive(Clone, Copy, Debug)]
pub struct Probe<const N: usize> {
    phase: Option<Phase>,
    /// What the step task has to be told.
    watch: Option<ToStep>,
    succeeded: bool,
    position: PerAxis<Coordinate, N>,
}

/// The probe is of no interest any more.
const WATCH_ENDS: ToStep = ToStep::Watch { probe: None, braking: 0.0 };

impl<const N: usize> Probe<N> {
    /// None has been made.
    pub const NONE: Self =
        Self { phase: None, watch: None, succeeded: false, position: PerAxis::all(Coordinate::ZERO) };

    /// A probe move begins. The step task waits for the input to become active (inactive with `away`), and then brakes so
    /// hard ([`ToStep::Watch`]).
    pub fn begin(&mut self, away: bool, braking: f32) {
        self.phase = Some(Phase::Seeking(Watched { level: !away, braking }));
        self.watch_again();
    }

    /// The tool is parked: what touches it meanwhile is no contact.
    pub fn look_away(&mut self) {
        if self.is_seeking() {
            self.watch = Some(WATCH_ENDS);
        }
    }

    /// The tool is back, and seeks on.
    pub fn watch_again(&mut self) {
        if let Some(Phase::Seeking(Watched { level, braking })) = self.phase {
            self.watch = Some(ToStep::Watch { probe: Some(level), braking });
        }
    }

    fn is_seeking(&self) -> bool {
        matches!(self.phase, Some(Phase::Seeking(_)))
    }

    /// What the step task has to be told now.
    #[inline]
    pub fn take_watch(&mut self) -> Option<ToStep> {
        self.watch.take()
    }

    /// The step task has seen the contact, at this position.
    pub fn contact(&mut self, position: impl FnOnce() -> PerAxis<Coordinate, N>) {
        if self.is_seeking() {
            self.phase = Some(Phase::Braking);
            self.position = position();
        }
    }

    /// Whether the step task brakes after a contact: it takes nothing more until it has been stopped.
    #[inline]
    pub fn is_braking(&self) -> bool {
        self.phase == Some(Phase::Braking)
    }

    /// Whether there is none under way, and the step task knows of it.
    #[inline]
    pub fn is_over(&self) -> bool {
        self.phase.is_none() && self.watch.is_none()
    }

    /// The step task has been stopped, for whatever reason: it has forgotten the watch.
    pub fn stopped(&mut self) {
        self.watch = None;
    }

    /// It was stopped because of the contact.
    pub fn rests_after_contact(&mut self) {
        self.phase = Some(Phase::Touched);
    }

    /// Whether contact has been made: the rest of the move is of no interest.
    pub fn has_touched(&self) -> bool {
        matches!(self.phase, Some(Phase::Braking | Phase::Touched))
    }

    /// Whether the probe is over, and whether it touched. `idle`: nothing moves, and nothing is queued.
    pub fn outcome(&self, idle: bool) -> Option<bool> {
        match self.phase {
            Some(Phase::Touched) => Some(true),
            Some(Phase::Seeking(_)) if idle => Some(false),
            _ => None,
        }
    }

    /// The probe is over. Without a contact that was not required (G38.3, G38.5) its result is where the machine is.
    pub fn finish(&mut self, touched: bool, must_touch: bool, here: PerAxis<Coordinate, N>) {
        self.phase = None;
        self.watch = Some(WATCH_ENDS);
        self.succeeded = touched;
        if !touched && !must_touch {
            self.position = here;
        }
    }

    /// Something else has ended it, and the step task has been stopped.
    pub fn forget_move(&mut self) {
        self.phase = None;
    }

    /// Something else has ended it, and the step task still looks for the contact.
    pub fn break_off(&mut self) {
        self.phase = None;
        self.watch = Some(WATCH_ENDS);
    }

    /// Position and success of the last one.
    pub fn result(&self) -> (PerAxis<Coordinate, N>, bool) {
        (self.position, self.succeeded)
    }

    /// As if none had been made.
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
