//! Carries out a probing move (G38): checks the input, queues the move, and lets the step task watch for the contact.
//! Once the machine is at rest, the position of the contact is reported. If the G-code word requires a contact and
//! there was none, the machine locks.

pub(crate) mod phases;

use crate::axes::PerAxis;
use crate::dispatch::Controller;
use crate::error::Alarm;
use crate::motion::{Move, Speed, Tolerance};
use crate::protocol::reply_texts;
use crate::states::stops::orders::StopReason;
use crate::units::Coordinate;

impl<const N: usize> Controller<N> {
    /// Begins a probing move; the machine is at rest. Returns false if the move was not started, because the input
    /// already has the level to wait for. In that case the line is answered now.
    #[inline(never)]
    pub(crate) fn begin_probe(
        &mut self,
        target: &PerAxis<Coordinate, N>,
        speed: Speed,
        away: bool,
        line_number: u32,
    ) -> bool {
        if self.m.inputs.signals().probe != away {
            self.lock(Alarm::ProbeInitialState);
            self.m.interpreter.set_position(self.m.motion.machine_position());
            return false;
        }
        self.m.motion.line(&seek(*target, speed, line_number));
        self.m.probe.begin(away, self.m.motion.braking());
        self.start_motion();
        true
    }

    /// Orders a stop once the step task has braked for a contact. The report of that stop contains the position at
    /// which the machine rests. Until the stop, the step task takes no messages.
    pub(crate) fn settle_probe(&mut self) {
        if self.m.probe.is_braking() && self.m.step_supply.observed().step_idle && !self.m.stops.is_awaited() {
            self.m.stops.order(StopReason::Contact);
        }
    }

    /// Returns the outcome of the probing move: `true` if it has made contact. Returns `None` until the move is over.
    /// Once the move is over, drops the rest of it.
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

    /// Returns whether the probing move is over. If so, reports its result to the host.
    #[inline(never)]
    pub(crate) fn end_probe(&mut self, must_touch: bool) -> bool {
        let Some(touched) = self.take_probe(must_touch) else { return false };
        if !touched && must_touch {
            self.lock(Alarm::ProbeNoContact);
        }
        let ((position, _), form) = (self.m.probe.result(), self.place_form());
        self.m.interpreter.set_probed(&position, touched);
        self.say(|out| reply_texts::probe(out, &position, touched, form));
        true
    }
}

/// Returns a straight move to `target` that follows its path exactly and has no spindle power. The operator's overrides
/// do not change it.
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
