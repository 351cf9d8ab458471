//! How the machine stops for a fault (`$924` to `$928`): at once, or by braking along the path, with or without
//! retracting the tool. The alarm follows when the machine is at rest. Faults are limit switches, emergency stop,
//! driver faults, a lost spindle speed, and a host that has disconnected or is silent. A lost host raises an alarm only
//! if the machine stops at once.
//!
//! ```text
//!  switch, driver, spindle ──▶ fault ──┬── at once ───────────────────────────▶ stop ──▶ alarm
//!                                      └── controlled ──▶ brake ──▶ [park] ─────┘
//! ```
//! Homing and parking moves stop at once, whatever the settings are, because they have no room to brake.

use crate::axes::Axis;
use crate::dispatch::Controller;
use crate::error::Alarm;
use crate::inputs::levels;
use crate::protocol::reply_texts;
use crate::settings::Key;
use crate::states::door::{DoorPhase, Opening};
use crate::states::stops::Stopped;
use crate::states::stops::orders::StopReason;
use crate::states::stops::reaction::{Braking, Reaction};
use crate::states::{AfterBraking, State};

impl<const N: usize> Controller<N> {
    /// Stops for a fault in the way that the setting for that fault selects. The alarm follows when the machine is at
    /// rest.
    pub(crate) fn fault(&mut self, alarm: Alarm, stopped: &mut Stopped) {
        let under_way = self.stop_under_way();
        let reason = under_way.map_or(StopReason::Alarm(alarm), |other| other.heavier(StopReason::Alarm(alarm)));
        let braking = Reaction::to(alarm, &self.m.settings).braking;
        if self.is_bounce(alarm) {
            return;
        }
        self.keep_speed();
        if braking == Braking::AtOnce || stopped.already || self.m.stops.is_awaited() || !self.can_brake() {
            self.stop_for(reason, stopped);
        } else if under_way != Some(reason) {
            self.brake_for(alarm, braking);
        }
    }

    /// Returns whether this is a limit switch that bounces: the tool is already being parked because of a limit
    /// switch. A closed switch of the parking axis is not taken for bouncing.
    fn is_bounce(&self, alarm: Alarm) -> bool {
        matches!(self.state, State::Door(door) if door.opening.alarm == Some(alarm))
            && alarm == Alarm::HardLimit
            && !self.m.stops.is_awaited()
            && !self.is_parking_blocked()
    }

    fn can_brake(&self) -> bool {
        match self.state {
            State::Normal | State::Jog { .. } | State::Hold(_) | State::Braking { .. } => true,
            State::Door(door) => door.phase == DoorPhase::Braking,
            _ => false,
        }
    }

    fn brake_for(&mut self, alarm: Alarm, braking: Braking) {
        // A machine that is at rest when the fault occurs must not start to move.
        let retract = braking == Braking::Retract && !self.m.motion.is_at_rest() && !self.is_parking_blocked();
        if self.m.settings.is_on(Key::Laser) || matches!(self.state, State::Door(_)) {
            // Suspend a laser, which would otherwise stay on in the segments that are left for braking. Suspend a
            // spindle too if the door is open, because it must not turn then.
            self.m.accessories.suspend();
        }
        self.tell_trip(self.m.motion.line_number());
        self.task.forget_jog();
        self.m.motion.hold();
        let then = if retract { AfterBraking::Retract(alarm) } else { AfterBraking::Alarm(alarm) };
        self.enter(State::Braking { then });
    }

    /// Carries out what follows a controlled stop: ends the soft stop, raises the alarm (by an order to stop the step
    /// task), or retracts the tool. Called when the machine is at rest.
    pub(crate) fn settle_braking(&mut self, then: AfterBraking) {
        match then {
            AfterBraking::Continue => self.finish_soft_stop(false),
            AfterBraking::Lock => self.finish_soft_stop(true),
            AfterBraking::Alarm(alarm) => self.m.stops.order(StopReason::Alarm(alarm)),
            AfterBraking::Retract(alarm) => {
                let spindle_on = self.keeps_spindle_on(alarm);
                self.retract_for(Opening { retract: !self.is_parking_blocked(), spindle_on, alarm: Some(alarm) });
            }
        }
    }

    /// Returns whether a limit switch of the parking axis is closed. Then the tool must not move along that axis.
    fn is_parking_blocked(&self) -> bool {
        let closed = levels::axes_of_switches(self.m.inputs.signals().limits, &self.m.settings);
        let axis = Axis::ALL.get(self.m.settings.whole(Key::ParkingAxis) as usize);
        axis.is_none_or(|axis| closed & 1 << axis.index() != 0)
    }

    /// Reacts to a host that is silent or has disconnected during a job (`$928`). Unless the reaction is to stop at
    /// once, the work is suspended and can be resumed.
    pub(crate) fn host_fault(&mut self) {
        self.forget_received_jogs();
        let Reaction { braking, spindle_on } = Reaction::of(Key::HostReaction, &self.m.settings);
        match braking {
            Braking::AtOnce => self.m.stops.order(StopReason::Alarm(Alarm::AbortInMotion)),
            Braking::Controlled if spindle_on || self.m.settings.is_on(Key::Laser) => self.feed_hold(),
            _ => {
                let retract = braking == Braking::Retract && !self.m.motion.is_at_rest();
                self.darken_laser();
                self.brake_for_door(Opening { retract, spindle_on, alarm: None });
            }
        }
    }

    /// Raises a fault if a spindle with an at-speed input (`$915`) has lost its speed during a job (`$929`).
    pub(crate) fn look_for_spindle(&mut self) {
        if !self.m.accessories.watches_speed(&self.m.settings) {
            return;
        }
        let at_work = self.needs_speed();
        let (power, input) = (self.resting_power(), self.m.inputs.signals().at_speed);
        if self.m.accessories.has_lost_speed(at_work, power, input, self.m.now, &self.m.settings) {
            self.say(|out| reply_texts::message(out, "The spindle has lost its speed"));
            self.fault(Alarm::SpindleSpeed, &mut Stopped { already: false, answered: false });
        }
    }
}
