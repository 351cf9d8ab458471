//! Counts the stops of the step task, those expected and those reported, and keeps the most serious reason among them.
//! The controller sends `ToStep::Resume` to the step task only when all expected stops have happened.
//!
//! ```text
//!  order ──▶ Output::Stop ──▶ step task ──▶ StepEvent::Stopped ──▶ finish ──▶ ToStep::Resume
//!                                 ▲
//!  reset, armed input: these have already stopped the step task themselves, and are only counted
//! ```
//! The controller and the step task both count stops, so a stop that has happened is never mistaken for one requested
//! later.

use crate::error::Alarm;

/// Why the step task is stopped.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum StopReason {
    /// 0x18 or the reset button.
    Reset,
    /// An alarm follows.
    Alarm(Alarm),
    /// A homing switch.
    Switch,
    /// A contact of the probe. The step task has already braked by itself.
    Contact,
    /// An armed input has stopped the step task without the controller, but there is no reason to act. For instance,
    /// the machine was already locked.
    Nothing,
}

impl StopReason {
    /// Returns the more serious of two reasons, which is the one that will be reported.
    pub fn heavier(self, other: StopReason) -> StopReason {
        if other.weight() > self.weight() { other } else { self }
    }

    /// Returns the severity. A reset outranks everything. An alarm outranks a homing switch and a probe contact,
    /// because homing or probing must not continue after it.
    const fn weight(self) -> u8 {
        match self {
            StopReason::Nothing => 1,
            StopReason::Switch | StopReason::Contact => 2,
            // The least serious alarms, because a lost spindle speed and a lost host do not affect motors and position.
            StopReason::Alarm(Alarm::SpindleSpeed | Alarm::AbortInMotion) => 3,
            StopReason::Alarm(Alarm::DriverFault) => 5,
            StopReason::Alarm(Alarm::EmergencyStop) => 6,
            StopReason::Alarm(_) => 4,
            StopReason::Reset => 7,
        }
    }
}

/// A completed stop: all requested stops have happened.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Finished {
    /// Why the step task was stopped.
    pub reason: StopReason,
    /// `true` if the machine was stepping when it was stopped. Then steps may be lost.
    pub moving: bool,
    /// N word of the move in execution, 0 = none.
    pub line: u32,
}

/// Counts the expected stops and the stops that have happened, and holds the reason of the pending stop.
#[derive(Clone, Copy, Debug)]
pub struct Stops {
    awaited: Option<StopReason>,
    /// Number of stops that must have happened before the pending stop is complete (wrapping).
    expected: u16,
    /// Number of stops that have happened (wrapping).
    seen: u16,
    /// `true` if the machine was stepping at any stop since the last [`Stops::finish`].
    moving: bool,
    /// N word of the move in execution at the last stop reported to [`Stops::record_stop`], 0 = none.
    line: u32,
    /// A stop order has not been sent to the step task yet.
    ordered: bool,
    /// `ToStep::Resume`, which lets the step task run again, has not been sent yet.
    resume: bool,
}

impl Stops {
    /// The value at power-up: no stop is pending, and none has happened.
    pub const NONE: Stops =
        Stops { awaited: None, expected: 0, seen: 0, moving: false, line: 0, ordered: false, resume: false };

    /// Returns the reason of the pending stop; `None` if no stop is pending.
    pub fn awaited(&self) -> Option<StopReason> {
        self.awaited
    }

    /// Returns whether a stop is pending: it has a reason, and [`Stops::finish`] has not completed it yet.
    pub fn is_awaited(&self) -> bool {
        self.awaited.is_some()
    }

    /// Returns whether no stop is pending, and no stop order or `ToStep::Resume` waits to be sent to the step task.
    pub fn is_idle(&self) -> bool {
        self.awaited.is_none() && !self.ordered && !self.resume
    }

    /// Returns whether the step task takes messages: no stop is pending, and every stop that has been reported was also
    /// expected.
    pub fn is_open(&self) -> bool {
        self.awaited.is_none() && self.seen == self.expected
    }

    /// Adds the stops that armed inputs have made to the number of expected stops.
    pub fn add_expected(&mut self, stops: u8) {
        self.expected = self.expected.wrapping_add(u16::from(stops));
    }

    /// Makes a stop with this reason pending, without changing the number of expected stops. If a stop is already
    /// pending, keeps the more serious of the two reasons.
    pub fn wait_for(&mut self, reason: StopReason) {
        self.awaited = Some(self.awaited.map_or(reason, |awaited| awaited.heavier(reason)));
    }

    /// Makes a stop pending that needs no order, because its cause (a reset) has already stopped the step task. Adds it
    /// to the number of expected stops.
    pub fn begin(&mut self, reason: StopReason) {
        self.add_expected(1);
        self.wait_for(reason);
    }

    /// Orders a stop of the step task. If an earlier order has not been sent yet, both orders are one stop.
    pub fn order(&mut self, reason: StopReason) {
        if !self.ordered {
            self.add_expected(1);
        }
        self.ordered = true;
        self.wait_for(reason);
    }

    /// Returns whether a stop order has not been sent to the step task yet.
    pub fn has_order(&self) -> bool {
        self.ordered
    }

    /// Returns whether a stop order has to be sent to the step task, and marks it as sent.
    pub fn take_order(&mut self) -> bool {
        let ordered = self.ordered;
        if ordered {
            self.ordered = false;
        }
        ordered
    }

    /// Returns the number of stops that have happened, if it has to be sent in a `ToStep::Resume` now; otherwise
    /// `None`. Marks the `ToStep::Resume` as sent.
    pub fn take_resume(&mut self) -> Option<u16> {
        core::mem::take(&mut self.resume).then_some(self.seen)
    }

    /// Records the step task's report of a stop that a command, an input or the controller has caused. `stops` is the
    /// step task's count of stops, `line` the N word of the move in execution.
    pub fn record_stop(&mut self, stops: u16, moving: bool, line: u32) {
        self.seen = stops;
        self.moving |= moving;
        self.line = line;
    }

    /// Records the step task's report that it has stopped at speed by itself, because it had no segments or because its
    /// outputs have failed.
    pub fn record_failure(&mut self, stops: u16, alarm: Alarm) {
        self.add_expected(1);
        self.seen = stops;
        self.moving = true;
        if alarm == Alarm::Miscounted {
            // The position is unknown, so homing or a probe must not continue. If one of them waits for a stop, this
            // alarm takes the place of its reason.
            self.wait_for(StopReason::Alarm(alarm));
        } else {
            self.awaited.get_or_insert(StopReason::Alarm(alarm));
        }
    }

    /// Completes the pending stop and returns it, once all expected stops have happened. After that the step task has
    /// to be sent `ToStep::Resume` ([`Stops::take_resume`]).
    pub fn finish(&mut self) -> Option<Finished> {
        let reason = self.awaited?;
        // A stop order that has not been sent yet cannot have been executed, even if other stops have made the counts
        // equal meanwhile.
        if self.ordered || (self.seen.wrapping_sub(self.expected) as i16) < 0 {
            return None;
        }
        let finished = Finished { reason, moving: self.moving, line: self.line };
        // If a stop has happened that is not counted as expected yet, the step task takes no messages until it is
        // counted: see `is_open`.
        *self = Stops { expected: self.expected, seen: self.seen, resume: true, ..Stops::NONE };
        Some(finished)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_order_ends_when_it_has_been_obeyed() {
        let mut stops = Stops::NONE;
        stops.order(StopReason::Switch);
        stops.record_stop(0, false, 0);
        assert!(stops.finish().is_none(), "it is not out yet");
        assert!(stops.take_order() && !stops.take_order());
        assert!(stops.finish().is_none() && !stops.is_open());
        stops.record_stop(1, true, 7);
        assert_eq!(stops.finish(), Some(Finished { reason: StopReason::Switch, moving: true, line: 7 }));
        assert!(!stops.is_idle() && stops.is_open());
        assert_eq!((stops.take_resume(), stops.take_resume()), (Some(1), None));
        assert!(stops.is_idle() && stops.finish().is_none());
    }

    #[test]
    fn what_had_to_stop_does_not_continue_where_steps_were_miscounted() {
        for (reason, wanted) in [
            (StopReason::Switch, StopReason::Alarm(Alarm::Miscounted)),
            (StopReason::Contact, StopReason::Alarm(Alarm::Miscounted)),
            (StopReason::Alarm(Alarm::HardLimit), StopReason::Alarm(Alarm::HardLimit)),
            (StopReason::Reset, StopReason::Reset),
        ] {
            let mut stops = Stops::NONE;
            stops.order(reason);
            assert!(stops.take_order());
            stops.record_failure(1, Alarm::Miscounted);
            assert!(stops.finish().is_none(), "{reason:?}: the stop that was asked for comes after it");
            stops.record_stop(2, false, 0);
            assert_eq!(stops.finish(), Some(Finished { reason: wanted, moving: true, line: 0 }));
            assert!(stops.is_open());
        }
    }

    #[test]
    fn two_orders_before_one_is_out_are_one_stop() {
        let mut stops = Stops::NONE;
        stops.order(StopReason::Switch);
        stops.order(StopReason::Alarm(Alarm::HardLimit));
        assert!(stops.take_order());
        stops.record_stop(1, false, 0);
        assert_eq!(stops.finish().map(|f| f.reason), Some(StopReason::Alarm(Alarm::HardLimit)));
    }

    #[test]
    fn the_weightier_reason_wins_whichever_comes_first() {
        let rising = [
            StopReason::Nothing,
            StopReason::Contact,
            StopReason::Alarm(Alarm::SpindleSpeed),
            StopReason::Alarm(Alarm::HardLimit),
            StopReason::Alarm(Alarm::DriverFault),
            StopReason::Alarm(Alarm::EmergencyStop),
            StopReason::Reset,
        ];
        for (i, low) in rising.iter().enumerate() {
            for high in rising.iter().skip(i) {
                for pair in [[*low, *high], [*high, *low]] {
                    let mut stops = Stops::NONE;
                    pair.into_iter().for_each(|reason| stops.wait_for(reason));
                    assert_eq!(stops.awaited(), Some(*high));
                }
            }
        }
    }

    #[test]
    fn a_stop_that_happened_before_its_reason_was_known_is_over_at_once() {
        let mut stops = Stops::NONE;
        // The report of the step task arrives before the reset that stopped it, because the two come through different
        // queues.
        stops.record_stop(1, true, 0);
        assert!(stops.finish().is_none() && !stops.is_open());
        stops.begin(StopReason::Reset);
        assert_eq!(stops.finish().map(|f| f.moving), Some(true));
        // The counts can wrap from 65,535 to 0 between the request and the stop.
        let mut stops = Stops { expected: u16::MAX, seen: u16::MAX, ..Stops::NONE };
        stops.begin(StopReason::Reset);
        assert!(stops.finish().is_none());
        stops.record_stop(0, false, 0);
        assert!(stops.finish().is_some());
    }

    #[test]
    fn an_underrun_counts_itself_and_yields_to_what_is_awaited() {
        let mut stops = Stops::NONE;
        stops.record_failure(1, Alarm::Underrun);
        let reason = StopReason::Alarm(Alarm::Underrun);
        assert_eq!(stops.finish(), Some(Finished { reason, moving: true, line: 0 }));
        stops.begin(StopReason::Nothing);
        stops.record_failure(3, Alarm::Underrun);
        assert_eq!(stops.finish().map(|f| f.reason), Some(StopReason::Nothing));
    }
}
