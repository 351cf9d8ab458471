//! Carries out a probing move (G38): checks the input, queues the move, and lets the step task watch for the contact.
//! At rest the contact's position is reported. Without a contact the machine locks, if the G-code word requires one.

pub(crate) mod phases;

use crate::axes::PerAxis;
use crate::dispatch::Controller;
use crate::error::Alarm;
use crate::motion::{Move, Speed, Tolerance};
use crate::protocol::report;
use crate::states::stops::orders::StopReason;
use crate::units::Coordinate;

impl<const N: usize> Controller<N> {
    /// Begins a probing move, at rest. Returns whether there is one to wait for; if not, the line is to be answered.
    #[inline(never)]
    pub(crate) fn begin_probe(
        &mut self,
        target: &PerAxis<Coordinate, N>,
        speed: Speed,
        away: bool,
        line_number: u32,
    ) -> bool {
        if self.m.inputs.signals().probe != away {
            // The input already has the level for which the probe would wait.
            self.lock(Alarm::ProbeInitialState);
            self.m.interpreter.set_position(self.m.motion.machine_position());
            return false;
        }
        self.m.motion.line(&seek(*target, speed, line_number));
        self.m.probe.begin(away, self.m.motion.braking());
        self.start_motion();
        true
    }

    /// Once the step task has braked for a contact, orders a stop: the stop reports the position, and the step task is
    /// reopened after it.
    pub(crate) fn settle_probe(&mut self) {
        if self.m.probe.is_braking() && self.m.step_supply.observed().step_idle && !self.m.stops.is_awaited() {
            self.m.stops.order(StopReason::Contact);
        }
    }

    /// Returns whether the probe has touched, once it is over; `None` until then. Drops the rest of its move.
    #[inline(never)]
    pub(crate) fn take_probe(&mut self, must_touch: bool) -> Option<bool> {
        let touched = self.m.probe.outcome(self.m.motion.is_idle())?;
        self.m.motion.discard();
        self.m.step_supply.end();
        let here = self.m.motion.machine_position();
        self.m.interpreter.set_position(here);
        self.m.probe.finish(touched, must_touch, here);
        Some(touched)
    }

    /// Whether the probe is over. If so, reports its result.
    #[inline(never)]
    pub(crate) fn end_probe(&mut self, must_touch: bool) -> bool {
        let Some(touched) = self.take_probe(must_touch) else { return false };
        if !touched && must_touch {
            self.lock(Alarm::ProbeNoContact);
        }
        let ((position, _), form) = (self.m.probe.result(), self.place_form());
        self.m.interpreter.set_probed(&position, touched);
        self.say(|out| report::probe(out, &position, touched, form));
        true
    }
}

/// Returns a move that the operator's overrides do not change.
pub(crate) fn seek<const N: usize>(target: PerAxis<Coordinate, N>, speed: Speed, line_number: u32) -> Move<N> {
    Move {
        target,
        speed,
        power: 0,
        scale_power: false,
        line_number,
        no_feed_override: true,
        digit: 0.0,
        tolerance: Tolerance::EXACT,
    }
}
