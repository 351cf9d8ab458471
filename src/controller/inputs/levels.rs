//! The inputs as the controller uses them. Receives the levels from the inputs task, ignores inputs that are not fitted
//! according to the settings, and records which input has tripped, for the alarm's message. Also decides which inputs
//! are armed to stop the step task directly. Polarity and filter are applied earlier, in `machine::signals`.
//!
//! ```text
//!  Sensed ──▶ levels ──▶ [fitted? reset button = emergency stop?] ──▶ signals
//!               │ $PINS                                                  │ reports, homing, door, hold, start
//! ```

use crate::axes::{Axis, AxisMask, LINEAR};
use crate::error::{Alarm, Error};
use crate::messages::{InputWiring, PinView, SECOND_SWITCH, Sensed, Signals, input};
use crate::settings::{AxisKey, Key, Settings};
use crate::states::stops::reaction::Reaction;

/// Levels of the inputs, and pending requests to the inputs task.
#[derive(Clone, Copy, Debug)]
pub struct InputLevels {
    /// Levels of all input pins, fitted or not, after polarity and filter.
    pins: Signals,
    /// Levels of the fitted inputs; all others are inactive.
    signals: Signals,
    /// The inputs task has sent levels since power-up; startup lines wait for this.
    known: bool,
    /// Inputs that have caused an alarm and have not been reported yet.
    tripped: Signals,
    /// [`Sensed::trips`] of the latest message: how often armed inputs (see [`armed`]) have stopped the step task
    /// (wrapping).
    trips: u8,
    /// Polarity and resistors according to the settings.
    wiring: InputWiring,
    /// Pending request to the inputs task: `Some(false)` views the pins (`$PINS`), `Some(true)` clears their noise
    /// counts.
    request: Option<bool>,
    /// Last view of the pins; cleared by the next request for a view.
    view: Option<PinView>,
    /// The control inputs and limit switches that became active most recently (`$LEV`).
    last_event: Signals,
}

/// Changes from one message of the inputs task to the next.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct InputChange {
    /// Number of times that armed inputs (see [`armed`]) have stopped the step task directly since the previous
    /// message.
    pub stops: u8,
    /// Inputs that have become active since the previous message, and inputs that have stopped the step task directly
    /// since then, even if they are inactive again.
    pub came: Signals,
}

impl InputLevels {
    /// The value at power-up: the inputs task has not sent any levels yet.
    pub const UNKNOWN: InputLevels = InputLevels {
        pins: Signals::NONE,
        signals: Signals::NONE,
        known: false,
        tripped: Signals::NONE,
        trips: 0,
        wiring: InputWiring::PULL_UPS,
        request: None,
        view: None,
        last_event: Signals::NONE,
    };

    /// Applies changed settings: which inputs are fitted, their polarity and their resistors.
    pub fn configure<const N: usize>(&mut self, settings: &Settings<N>) {
        self.signals = fitted(self.pins, settings);
        self.wiring = wiring_by(settings);
    }

    /// Stores the levels that the inputs task has sent. Returns which inputs have become active, and how often inputs
    /// have stopped the step task.
    pub fn take<const N: usize>(&mut self, sensed: &Sensed, settings: &Settings<N>) -> InputChange {
        let stops = sensed.trips.wrapping_sub(self.trips);
        self.trips = sensed.trips;
        self.known = true;
        self.pins = sensed.signals;
        let signals = fitted(self.pins, settings);
        let before = core::mem::replace(&mut self.signals, signals);
        // An input that has tripped can already be inactive again.
        let tripped = fitted(Signals::of_word(sensed.tripped), settings);
        let came = Signals::of_word(signals.word() & !before.word() | tripped.word());
        let event = Signals { probe: false, at_speed: false, program: 0, ..came };
        if event != Signals::NONE {
            self.last_event = event;
        }
        // Only armed inputs are reported as tripped. Any other input that was active only between two messages is
        // missed.
        InputChange { stops, came }
    }

    /// Returns the levels of the fitted inputs.
    pub fn signals(&self) -> &Signals {
        &self.signals
    }

    /// Returns the control inputs and limit switches that became active most recently (`$LEV`). All of them came in one
    /// message of the inputs task.
    pub fn last_event(&self) -> &Signals {
        &self.last_event
    }

    /// Returns the levels of all input pins, even of those that are not fitted according to the settings.
    pub fn pins(&self) -> &Signals {
        &self.pins
    }

    /// Returns whether the inputs task has sent levels since power-up.
    pub fn are_known(&self) -> bool {
        self.known
    }

    /// Returns polarity and resistors according to the settings.
    pub fn wiring(&self) -> InputWiring {
        self.wiring
    }

    /// Returns the emergency whose input is active now, if any.
    pub fn emergency(&self) -> Option<(Alarm, Error)> {
        if self.signals.emergency_stop {
            Some((Alarm::EmergencyStop, Error::EmergencyStop))
        } else if self.signals.driver_fault {
            Some((Alarm::DriverFault, Error::DriverFault))
        } else {
            None
        }
    }

    /// Returns the inputs that have caused an alarm and have not been reported yet, and marks them as reported.
    pub fn take_tripped(&mut self) -> Option<Signals> {
        let tripped = core::mem::replace(&mut self.tripped, Signals::NONE);
        (tripped != Signals::NONE).then_some(tripped)
    }

    /// Records emergency stop, driver fault or both as the cause of the alarm that follows.
    pub fn trip_emergency(&mut self, stop: bool, fault: bool) {
        self.tripped = Signals { emergency_stop: stop, driver_fault: fault, ..Signals::NONE };
    }

    /// Records limit switches as the cause of the alarm that follows. `awaited`: `true` if the machine is already
    /// stopping for a limit switch. In that case the switches are added to those recorded before.
    pub fn trip_limits(&mut self, switches: u8, awaited: bool) {
        let limits = if awaited { self.tripped.limits | switches } else { switches };
        self.tripped = Signals { limits, ..Signals::NONE };
    }

    /// Requests a view of the pins; with `clear_noise`, requests the clearing of their noise counts instead.
    pub fn ask_view(&mut self, clear_noise: bool) {
        if !clear_noise {
            self.view = None;
        }
        self.request = Some(clear_noise);
    }

    /// Returns the pending request and clears it; `Some(true)`: clear the noise counts.
    pub fn take_request(&mut self) -> Option<bool> {
        self.request.take()
    }

    /// Stores the requested view of the pins.
    pub fn viewed(&mut self, view: PinView) {
        self.view = Some(view);
    }

    /// Returns the view of the pins, once it has been received.
    pub fn view(&self) -> Option<PinView> {
        self.view
    }
}

/// Returns the bits of the limit switches of the axes in use, without the switch of a second motor.
fn limits_of<const N: usize>(settings: &Settings<N>) -> u8 {
    (1 << settings.axes_in_use()) - 1
}

/// Returns the bits of the switches that act as limits (`$21`). The switch of an axis that rotates without end is not
/// among them, because the axis passes it in each turn.
pub fn hard_limits<const N: usize>(settings: &Settings<N>) -> u8 {
    if !settings.is_on(Key::HardLimits) {
        return 0;
    }
    let travel = settings.axes(AxisKey::Travel);
    let has_ends = |axis: &Axis| N <= LINEAR || travel.get(*axis).is_some_and(|travel| axis.has_ends(travel));
    let with_ends = Axis::of_machine::<N>().filter(has_ends).fold(AxisMask::NONE, AxisMask::with);
    limits_of(settings) & with_ends.0 | second_switch(settings)
}

/// Returns the inputs that stop the step task directly: hard limits, reset, emergency stop and driver fault. Outside of
/// homing, an input is left out if the settings demand braking for it. During homing, only the limit switches are left
/// out.
pub fn armed<const N: usize>(settings: &Settings<N>, homing: bool) -> u32 {
    let at_once = |alarm| homing || Reaction::to(alarm, settings).is_at_once();
    let switches = if !homing && at_once(Alarm::HardLimit) { u32::from(hard_limits(settings)) } else { 0 };
    let emergency = at_once(Alarm::EmergencyStop);
    let reset = emergency || !settings.is_on(Key::ResetIsEmergencyStop);
    let fault = at_once(Alarm::DriverFault);
    switches
        | u32::from(reset) << input::RESET
        | u32::from(emergency) << input::EMERGENCY_STOP
        | u32::from(fault) << input::DRIVER_FAULT
}

/// Returns the axes of these limit switches as a mask, bit 0 for X. The switch of a second motor counts for the axis
/// that this motor drives.
pub fn axes_of_switches<const N: usize>(switches: u8, settings: &Settings<N>) -> u8 {
    match settings.ganged_axis() {
        Some(axis) if switches & SECOND_SWITCH != 0 => switches & !SECOND_SWITCH | AxisMask::NONE.with(axis).0,
        _ => switches & !SECOND_SWITCH,
    }
}

/// Returns the bit of the second motor's switch, if there are both motor and switch (`$905`, `$907`).
fn second_switch<const N: usize>(settings: &Settings<N>) -> u8 {
    if settings.is_on(Key::GangedSwitch) && settings.ganged_axis().is_some() { SECOND_SWITCH } else { 0 }
}

/// Returns the inputs as the settings define them: without inputs that are not fitted, and with the reset button as an
/// emergency stop if `$912` says so.
fn fitted<const N: usize>(pins: Signals, settings: &Settings<N>) -> Signals {
    let reset_stops = settings.is_on(Key::ResetIsEmergencyStop);
    Signals {
        limits: pins.limits & (limits_of(settings) | second_switch(settings)),
        door: pins.door && settings.is_on(Key::DoorFitted),
        reset: pins.reset && !reset_stops,
        emergency_stop: pins.emergency_stop || pins.reset && reset_stops,
        ..pins
    }
}

fn wiring_by<const N: usize>(s: &Settings<N>) -> InputWiring {
    let probe = |key| u32::from(s.is_on(key)) << input::PROBE;
    let all = u32::from(limits_of(s) | SECOND_SWITCH);
    let limits = |key| s.whole(key) & all;
    let control = |key| control_word(s.whole(key));
    let all_limits = if s.is_on(Key::LimitInvert) { all } else { 0 };
    InputWiring {
        inverted: all_limits ^ limits(Key::LimitInvertEach) | probe(Key::ProbeInvert) | control(Key::ControlInvert),
        no_pull_up: limits(Key::LimitNoPullUp) | probe(Key::ProbeNoPullUp) | control(Key::ControlNoPullUp),
        pull_down: limits(Key::LimitPullDown) | probe(Key::ProbePullDown) | control(Key::ControlPullDown),
    }
}

/// Converts a mask of control inputs from grblHAL's order to a word of [`input`].
fn control_word(mask: u32) -> u32 {
    let bit = |from: u32, to: u32| (mask >> from & 1) << to;
    bit(0, input::RESET)
        | bit(1, input::HOLD)
        | bit(2, input::START)
        | bit(3, input::DOOR)
        | bit(6, input::EMERGENCY_STOP)
        | bit(8, input::DRIVER_FAULT)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn settings(values: &[(Key, f32)]) -> Settings<3> {
        let mut settings = Settings::default();
        assert!(values.iter().all(|(key, value)| settings.restore(key.number(), *value)));
        settings
    }

    fn sensed(word: u32, trips: u8, tripped: u32) -> Sensed {
        Sensed { signals: Signals::of_word(word), trips, tripped }
    }

    #[test]
    fn a_level_comes_once_and_a_trip_even_if_it_is_gone_again() {
        let mut inputs = InputLevels::UNKNOWN;
        let settings = settings(&[(Key::DoorFitted, 1.0)]);
        assert!(!inputs.are_known());
        let change = inputs.take(&sensed(1 << input::DOOR, 0, 0), &settings);
        assert_eq!(change, InputChange { stops: 0, came: Signals { door: true, ..Signals::NONE } });
        assert!(inputs.are_known());
        let change = inputs.take(&sensed(1 << input::DOOR, 2, 0b001), &settings);
        assert_eq!(change, InputChange { stops: 2, came: Signals { limits: 0b001, ..Signals::NONE } });
        assert_eq!(inputs.signals().limits, 0);
    }

    #[test]
    fn what_is_not_fitted_does_not_count() {
        let mut inputs = InputLevels::UNKNOWN;
        let word = 1 << input::DOOR | 1 << input::RESET | u32::from(SECOND_SWITCH);
        let change = inputs.take(&sensed(word, 0, 0), &settings(&[(Key::DoorFitted, 0.0)]));
        assert_eq!(change.came, Signals { reset: true, ..Signals::NONE });
        assert_eq!(inputs.pins().word(), word);
        // After a change of settings, the inputs count as fitted at once, without a new message of levels.
        inputs.configure(&settings(&[(Key::DoorFitted, 1.0), (Key::ResetIsEmergencyStop, 1.0)]));
        assert_eq!(*inputs.signals(), Signals { door: true, emergency_stop: true, ..Signals::NONE });
        assert_eq!(inputs.emergency().map(|(alarm, _)| alarm), Some(Alarm::EmergencyStop));
    }

    #[test]
    fn switches_of_one_alarm_add_up() {
        let mut inputs = InputLevels::UNKNOWN;
        inputs.trip_limits(0b001, false);
        inputs.trip_limits(0b010, true);
        assert_eq!(inputs.take_tripped().map(|tripped| tripped.limits), Some(0b011));
        assert_eq!(inputs.take_tripped(), None, "each is told once");
        inputs.trip_limits(0b010, false);
        inputs.trip_limits(0b100, false);
        assert_eq!(inputs.take_tripped().map(|tripped| tripped.limits), Some(0b100));
        inputs.trip_emergency(true, false);
        assert_eq!(inputs.take_tripped(), Some(Signals { emergency_stop: true, ..Signals::NONE }));
    }

    #[test]
    fn homing_disarms_the_limit_switches_and_nothing_else() {
        let settings = settings(&[(Key::HardLimits, 1.0)]);
        assert_eq!(armed(&settings, false) & !armed(&settings, true), 0b111);
        assert!(armed(&settings, true) & 1 << input::EMERGENCY_STOP != 0);
    }

    #[test]
    fn an_input_for_which_motion_brakes_does_not_stop_it_at_once() {
        let stops = 1 << input::RESET | 1 << input::EMERGENCY_STOP | 1 << input::DRIVER_FAULT;
        let all = [(Key::HardLimits, 1.0)];
        assert_eq!(armed(&settings(&all), false), 0b111 | stops);
        for (key, without) in [
            (Key::LimitReaction, 0b111),
            (Key::EmergencyReaction, 1 << input::EMERGENCY_STOP),
            (Key::DriverReaction, 1 << input::DRIVER_FAULT),
        ] {
            let braking = settings(&[all[0], (key, 1.0)]);
            assert_eq!(armed(&braking, false), (0b111 | stops) & !without);
            assert_eq!(armed(&braking, true), stops, "homing is short of travel to brake");
        }
        let button = settings(&[(Key::EmergencyReaction, 2.0), (Key::ResetIsEmergencyStop, 1.0)]);
        assert_eq!(armed(&button, false), 1 << input::DRIVER_FAULT);
    }

    #[test]
    fn a_view_is_asked_for_once() {
        let mut inputs = InputLevels::UNKNOWN;
        inputs.viewed(PinView::default());
        inputs.ask_view(true);
        assert_eq!((inputs.take_request(), inputs.take_request()), (Some(true), None));
        assert!(inputs.view().is_some(), "clearing the noise has no answer");
        inputs.ask_view(false);
        assert!(inputs.view().is_none(), "the old one is not listed");
    }
}
