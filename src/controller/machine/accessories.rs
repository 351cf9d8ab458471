//! State of the accessories as the program and the operator have set them: spindle or laser, coolant, overrides and the
//! digital outputs of programs. Also records whether the spindle is suspended (in a hold or at an open door), is up to
//! speed, or has lost its speed during a job. This file only keeps the state; the module `outputs` sets the outputs
//! from it.
//!
//! ```text
//!  S, M3, M4, M5 ──▶ program ──▶ override ──▶ [suspended?] ──▶ power of the output
//!                                              0x9E in a hold, door, laser in a hold
//! ```
//! Spindle and coolant are off after a reset, an alarm and the end of the program.

use super::digital::DigitalOutputs;
use super::realtime_override::Overrides;
use super::spindle::SpindleRange;
use crate::messages::{Coolant, SpindleDirection};
use crate::settings::{Key, Settings};
use crate::units::{Duration, Instant};

/// Spindle or laser, coolant, overrides and digital outputs, as the program and the operator have set them.
#[derive(Clone, Copy, Debug)]
pub struct Accessories {
    overrides: Overrides,
    /// The overrides have changed, and motion does not use them yet.
    overrides_due: bool,
    direction: SpindleDirection,
    coolant: Coolant,
    /// The spindle is stopped although the program has it on.
    suspended: bool,
    /// The operator has requested a spindle stop in a hold that is still braking.
    stops_at_rest: bool,
    /// S of the line executed last, in rpm.
    speed: f32,
    watch: SpeedWatch,
    digital: DigitalOutputs,
}

/// Monitors the at-speed input of the spindle during a job.
#[derive(Clone, Copy, Debug)]
struct SpeedWatch {
    /// Direction and power at the previous check; `None` if the speed was not monitored then.
    given: Option<(SpindleDirection, u16)>,
    /// Time by which the spindle must have reached a new speed. Moved to the current time when the input reports that
    /// the speed has been reached.
    settled_at: Instant,
    /// The input has reported, since the speed was changed, that the spindle is not at speed.
    has_changed: bool,
    /// When the loss of speed becomes a fault; `None`: the speed is not lost.
    fault_at: Option<Instant>,
}

impl SpeedWatch {
    const NONE: SpeedWatch =
        SpeedWatch { given: None, settled_at: Instant::from_ticks(0), has_changed: false, fault_at: None };
}

/// Progress of a spindle that was switched on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SpinUp {
    /// Not up to speed yet.
    Waits,
    /// Up to speed.
    UpToSpeed,
    /// Not up to speed within the time of `$916`.
    Late,
}

impl Accessories {
    /// Spindle, coolant and outputs off, no overrides.
    pub const OFF: Accessories = Accessories {
        overrides: Overrides::NONE,
        overrides_due: false,
        direction: SpindleDirection::Off,
        coolant: Coolant { flood: false, mist: false },
        suspended: false,
        stops_at_rest: false,
        speed: 0.0,
        watch: SpeedWatch::NONE,
        digital: DigitalOutputs::OFF,
    };

    /// Sets everything to its state at power-up: off, and no overrides. `mark`: the mark of the block of motion that
    /// began last (see [`DigitalOutputs::forget_waiting`]).
    pub fn reset(&mut self, mark: u8) {
        let mut digital = self.digital;
        digital.switch_off(mark);
        *self = Accessories { digital, ..Accessories::OFF };
    }

    /// Returns the digital outputs of the program (M62 to M65), with the changes that wait for a motion.
    pub fn digital(&self) -> &DigitalOutputs {
        &self.digital
    }

    /// Returns the digital outputs of the program, for a change by M62 to M65 or at the beginning of a block.
    pub fn digital_mut(&mut self) -> &mut DigitalOutputs {
        &mut self.digital
    }

    /// Returns the overrides as the operator has set them, including those that the program has disabled.
    pub fn overrides(&self) -> Overrides {
        self.overrides
    }

    /// Sets the overrides. Returns whether they have changed.
    pub fn set_overrides(&mut self, overrides: Overrides) -> bool {
        let differ = overrides != self.overrides;
        self.overrides = overrides;
        self.overrides_due |= differ;
        differ
    }

    /// Returns whether the overrides have changed since the previous call, so that motion must apply them. All changes
    /// between two calls count as one. Each time, motion plans the whole look-ahead again, which takes about a
    /// millisecond. If a burst of override commands were applied one by one, the step queue would run empty.
    pub fn take_overrides_due(&mut self) -> bool {
        core::mem::take(&mut self.overrides_due)
    }

    /// Returns the direction of the spindle as programmed.
    pub fn spindle(&self) -> SpindleDirection {
        self.direction
    }

    /// Returns whether the program has the spindle on.
    pub fn is_on(&self) -> bool {
        self.direction != SpindleDirection::Off
    }

    /// Returns whether the program has the spindle on, but with a speed of 0 (S0).
    pub fn is_on_without_speed(&self) -> bool {
        self.is_on() && self.speed == 0.0
    }

    /// Returns whether the spindle is suspended: stopped although the program has it on.
    pub fn is_suspended(&self) -> bool {
        self.suspended
    }

    /// Returns the direction of the spindle output: off while the spindle is suspended.
    pub fn spindle_output(&self) -> SpindleDirection {
        if self.suspended { SpindleDirection::Off } else { self.direction }
    }

    /// Returns which coolant outputs must be on now.
    pub fn coolant(&self) -> Coolant {
        self.coolant
    }

    /// Sets the speed in rpm (S of a line).
    pub fn set_speed(&mut self, rpm: f32) {
        self.speed = rpm;
    }

    /// Sets the direction (M3, M4, M5). Returns how long the spindle takes to spin up or down: 0 for a laser, and 0 if
    /// the direction does not change.
    pub fn set_spindle<const N: usize>(&mut self, direction: SpindleDirection, settings: &Settings<N>) -> Duration {
        let changed = direction != self.direction;
        self.direction = direction;
        if !changed || settings.is_on(Key::Laser) {
            return Duration::from_ticks(0);
        }
        settings.seconds(if direction == SpindleDirection::Off { Key::SpinDown } else { Key::SpinUp })
    }

    /// Sets the coolant (M7, M8, M9).
    pub fn set_coolant(&mut self, coolant: Coolant) {
        self.coolant = coolant;
    }

    /// Switches the spindle off (M5).
    pub fn stop_spindle(&mut self) {
        self.direction = SpindleDirection::Off;
    }

    /// Switches spindle and coolant off (M5 and M9).
    pub fn switch_off(&mut self) {
        self.stop_spindle();
        self.coolant = Coolant::default();
    }

    /// Stops the spindle until [`Accessories::restore`] is called. The program still has the spindle on.
    pub fn suspend(&mut self) {
        self.suspended = true;
    }

    /// Stops the spindle as [`Accessories::suspend`] does, but only once the machine is at rest.
    pub fn stop_at_rest(&mut self) {
        self.stops_at_rest = true;
    }

    /// Suspends the spindle if [`Accessories::stop_at_rest`] has requested it, and returns whether it has. Called when
    /// the machine has come to rest.
    pub fn apply_stop_at_rest(&mut self) -> bool {
        let stops = core::mem::take(&mut self.stops_at_rest);
        self.suspended |= stops;
        stops
    }

    /// Ends [`Accessories::suspend`], or cancels [`Accessories::stop_at_rest`]. Returns whether the spindle was
    /// suspended.
    pub fn restore(&mut self) -> bool {
        self.stops_at_rest = false;
        if self.suspended {
            self.forget_speed();
        }
        core::mem::take(&mut self.suspended)
    }

    /// Returns whether a cut has to wait for the spindle's at-speed input (`$915`).
    pub fn waits_for_speed<const N: usize>(&self, settings: &Settings<N>) -> bool {
        settings.whole(Key::AtSpeed) != 0 && !settings.is_on(Key::Laser) && self.is_on()
    }

    /// Returns whether the spindle is up to speed. Always true if no cut has to wait for the at-speed input. `input`:
    /// level of this input.
    pub fn is_at_speed<const N: usize>(&self, input: bool, settings: &Settings<N>) -> bool {
        !self.waits_for_speed(settings) || input == (settings.whole(Key::AtSpeed) == 1)
    }

    /// Returns how far a spindle that was switched on has come. `until`: when its spin-up time ends. From then on, the
    /// at-speed input must report the speed within the time of `$916`. `input`: level of this input.
    pub fn spun_up<const N: usize>(&self, until: Instant, now: Instant, input: bool, settings: &Settings<N>) -> SpinUp {
        if now < until {
            SpinUp::Waits
        } else if self.is_at_speed(input, settings) {
            SpinUp::UpToSpeed
        } else if now >= until + settings.seconds(Key::AtSpeedWithin) {
            SpinUp::Late
        } else {
            SpinUp::Waits
        }
    }

    /// Returns when [`Accessories::spun_up`] must be called again, if no input changes before.
    pub fn next_look<const N: usize>(until: Instant, now: Instant, settings: &Settings<N>) -> Instant {
        if now < until { until } else { until + settings.seconds(Key::AtSpeedWithin) }
    }

    /// Returns whether the spindle's speed is monitored during a job (`$915`, `$929`). If not, clears what the monitor
    /// has recorded.
    pub fn watches_speed<const N: usize>(&mut self, settings: &Settings<N>) -> bool {
        let watches = self.waits_for_speed(settings) && settings.is_on(Key::SpeedLoss) && !self.suspended;
        if !watches {
            self.forget_speed();
        }
        watches
    }

    /// Forgets what was observed of the speed, because the spindle has been off or was not monitored.
    fn forget_speed(&mut self) {
        self.watch = SpeedWatch::NONE;
    }

    /// Returns whether the spindle has been below its speed for longer than `$929`. `at_work`: `true` during a job;
    /// otherwise the result is always `false`. After a change of direction or `power`, the spindle first has the time
    /// of `$916` to reach its speed.
    pub fn has_lost_speed<const N: usize>(
        &mut self,
        at_work: bool,
        power: u16,
        input: bool,
        now: Instant,
        settings: &Settings<N>,
    ) -> bool {
        let given = self.watch.given.filter(|(direction, _)| *direction == self.direction);
        // For the same S, the power of a move and the power computed from a line can differ by 1, because they are
        // rounded differently.
        if given.is_none_or(|(_, before)| before.abs_diff(power) > 1) {
            let lost = self.watch.fault_at.filter(|_| given.is_some() && self.watch.settled_at <= now);
            let settled_at = now + settings.seconds(Key::AtSpeedWithin);
            self.watch =
                SpeedWatch { given: Some((self.direction, power)), settled_at, has_changed: false, fault_at: lost };
        }
        if power == 0 || self.is_at_speed(input, settings) {
            if self.watch.has_changed {
                self.watch.settled_at = now;
            }
            self.watch.fault_at = None;
            return false;
        }
        self.watch.has_changed = true;
        let fault_at = (now + settings.seconds(Key::SpeedLoss)).max(self.watch.settled_at);
        now >= *self.watch.fault_at.get_or_insert(fault_at) && at_work
    }

    /// Returns when the loss of the spindle's speed becomes a fault, if it lasts; `None` if the speed is not lost.
    pub fn speed_lost_at(&self) -> Option<Instant> {
        self.watch.fault_at
    }

    /// Returns the power of the output, 0 to 65535, while no segment sets it. A laser with constant power (M3) stays on
    /// between feed motions if `burns_at_rest` returns `true`. With scaled power (M4), it is off at zero speed.
    /// `percent`: the spindle override. `running`: returns the power of the move that is being handed to the step task,
    /// or else of the next move; `None` without a move.
    pub fn resting_power<const N: usize>(
        &self,
        settings: &Settings<N>,
        percent: u8,
        burns_at_rest: impl FnOnce() -> bool,
        running: impl FnOnce() -> Option<u16>,
    ) -> u16 {
        let range = SpindleRange::of(settings);
        let speed = if settings.is_on(Key::Laser) {
            if self.direction != SpindleDirection::Clockwise || !burns_at_rest() {
                return 0;
            }
            // This power applies only between moves. During a move the segments carry the laser's power.
            self.speed
        } else {
            // During a move, use the S that belongs to the power from `running`. Otherwise use the S of the line
            // executed last.
            match running() {
                Some(power) if power != range.output(self.speed, 100).0 => range.speed_of(power),
                _ => self.speed,
            }
        };
        range.output(speed, percent).0
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn settings(values: &[(u16, f32)]) -> Settings<3> {
        let mut settings = Settings::default();
        assert!(values.iter().all(|(number, value)| settings.restore(*number, *value)));
        settings
    }

    const SPIN_UP: u16 = Key::SpinUp.number();
    const AT_SPEED: u16 = Key::AtSpeed.number();
    const WITHIN: u16 = Key::AtSpeedWithin.number();
    const LASER: u16 = Key::Laser.number();

    fn at(seconds: u64) -> Instant {
        Instant::from_ticks(0) + Duration::secs(seconds)
    }

    #[test]
    fn a_spindle_takes_its_time_and_a_laser_none() {
        let spindle = settings(&[(SPIN_UP, 4.0)]);
        let mut off = Accessories::OFF;
        assert_eq!(off.set_spindle(SpindleDirection::Clockwise, &spindle), Duration::secs(4));
        assert_eq!(off.set_spindle(SpindleDirection::Clockwise, &spindle), Duration::secs(0), "it turns already");
        let laser = settings(&[(SPIN_UP, 4.0), (LASER, 1.0)]);
        let mut off = Accessories::OFF;
        assert_eq!(off.set_spindle(SpindleDirection::Clockwise, &laser), Duration::secs(0));
    }

    #[test]
    fn a_spindle_that_tells_its_speed_is_waited_for_and_late_at_last() {
        let settings = settings(&[(AT_SPEED, 1.0), (WITHIN, 5.0)]);
        let mut on = Accessories::OFF;
        on.set_spindle(SpindleDirection::Clockwise, &settings);
        let spun_up = |now, input| on.spun_up(at(4), at(now), input, &settings);
        assert_eq!((spun_up(3, true), spun_up(4, true)), (SpinUp::Waits, SpinUp::UpToSpeed));
        assert_eq!(
            (spun_up(4, false), spun_up(8, false), spun_up(9, false)),
            (SpinUp::Waits, SpinUp::Waits, SpinUp::Late)
        );
        assert_eq!(Accessories::OFF.spun_up(at(4), at(4), false, &settings), SpinUp::UpToSpeed, "nothing turns");
    }

    #[test]
    fn a_speed_that_is_lost_for_too_long_is_a_fault() {
        let loss = Key::SpeedLoss.number();
        let settings = settings(&[(AT_SPEED, 1.0), (WITHIN, 5.0), (loss, 2.0)]);
        let mut on = Accessories::OFF;
        assert!(!on.watches_speed(&settings), "it is off");
        on.set_spindle(SpindleDirection::Clockwise, &settings);
        assert!(on.watches_speed(&settings));
        let mut lost = |at_work, power, input, now| on.has_lost_speed(at_work, power, input, at(now), &settings);
        // The spindle reaches its speed before the time of `$916` has passed. From then on only the time of `$929`
        // counts.
        assert!(!lost(false, 100, false, 6) && !lost(false, 100, true, 7));
        assert!(!lost(true, 100, false, 8) && !lost(true, 100, false, 9) && lost(true, 100, false, 10));
        assert!(!lost(true, 100, true, 11) && !lost(true, 100, false, 12), "it had come back");
        assert!(!lost(false, 100, false, 14) && lost(true, 100, false, 15), "a job that begins meets it as it is");
        // After a new speed the spindle has the time of `$916` again, whether the speed is set during a job or before
        // it.
        assert!(!lost(false, 200, true, 20) && !lost(true, 200, false, 21) && !lost(true, 200, false, 24));
        assert!(lost(true, 200, false, 25));
        assert!(
            !lost(true, 200, true, 30) && !lost(true, 200, false, 31) && lost(true, 300, false, 33),
            "no new time for what is lost"
        );
        assert!(!lost(true, 0, false, 40), "S0");
        assert!(!lost(true, 300, false, 41) && !lost(true, 300, false, 45));
        assert_eq!(on.speed_lost_at(), Some(at(46)));
        on.suspend();
        assert!(!on.watches_speed(&settings));
        assert_eq!(on.speed_lost_at(), None);
    }

    #[test]
    fn a_suspended_spindle_is_off_and_comes_back() {
        let mut on = Accessories::OFF;
        on.set_spindle(SpindleDirection::CounterClockwise, &settings(&[]));
        on.suspend();
        assert_eq!((on.spindle_output(), on.is_on()), (SpindleDirection::Off, true));
        assert!(on.restore() && !on.restore());
        assert_eq!(on.spindle_output(), SpindleDirection::CounterClockwise);
    }

    #[test]
    fn a_spindle_that_stops_at_rest_turns_until_then() {
        let mut on = Accessories::OFF;
        on.set_spindle(SpindleDirection::Clockwise, &settings(&[]));
        on.stop_at_rest();
        on.stop_at_rest();
        assert_eq!(on.spindle_output(), SpindleDirection::Clockwise);
        assert!(on.apply_stop_at_rest() && !on.apply_stop_at_rest());
        assert_eq!(on.spindle_output(), SpindleDirection::Off);
        assert!(on.restore());
        on.stop_at_rest();
        assert!(!on.restore() && !on.apply_stop_at_rest(), "called off");
    }

    #[test]
    fn at_rest_a_laser_burns_with_constant_power_only() {
        let laser = settings(&[(LASER, 1.0)]);
        let power = |direction, burns_at_rest: bool| {
            let mut on = Accessories::OFF;
            on.set_speed(1000.0);
            on.set_spindle(direction, &laser);
            on.resting_power(&laser, 100, || burns_at_rest, || Some(7))
        };
        assert_eq!(power(SpindleDirection::Clockwise, true), u16::MAX);
        assert_eq!(power(SpindleDirection::Clockwise, false), 0);
        assert_eq!(power(SpindleDirection::CounterClockwise, true), 0);
    }

    #[test]
    fn the_override_acts_on_the_move_under_way() {
        let settings = settings(&[]);
        let mut on = Accessories::OFF;
        on.set_speed(1000.0);
        on.set_spindle(SpindleDirection::Clockwise, &settings);
        let range = SpindleRange::of(&settings);
        let (slow, half) = (range.output(400.0, 100).0, range.output(200.0, 100).0);
        let power = |running| on.resting_power(&settings, 50, || false, || running);
        assert!(power(Some(slow)).abs_diff(half) <= 1);
        assert_eq!(power(Some(slow)), range.overridden(slow, 50));
        assert_eq!(power(None), range.output(500.0, 100).0);
    }

    #[test]
    fn other_overrides_differ() {
        let mut on = Accessories::OFF;
        let half = Overrides { spindle: 50, ..Overrides::NONE };
        assert!(on.set_overrides(half));
        assert!(!on.set_overrides(half));
        assert_eq!(on.overrides(), half);
    }

    #[test]
    fn many_presses_are_one_change_for_motion() {
        let mut on = Accessories::OFF;
        assert!(!on.take_overrides_due());
        for feed in [110, 120, 130] {
            on.set_overrides(Overrides { feed, ..Overrides::NONE });
        }
        assert!(on.take_overrides_due());
        assert!(!on.take_overrides_due());
    }
}
