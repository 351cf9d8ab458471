//! The step task: turns what the stepper says into edges on pins, at the moment it says.
//!
//! ```text
//!  step  ____┌──────┐_________________┌──────┐____
//!            │      │                 │
//!            │      ├ direction for the next step is written
//!            │      ├─────────────────┤ at least $29, or the shortest low time
//!            ├──────┤ $0, by the second compare moment of the same timer
//!            ├────── interval ────────┤ counted from the moment due, not from the moment done: no error adds up
//! ```
//! It promises: a stop that was asked for is obeyed before anything else in the same handler; ticks that come late do
//! not shift those after them; a report to `control` is kept until it has been sent. It leaves when and what to step to
//! the stepper.
//!
//! What is not urgent (messages, power, reports) comes while the next edge is far: during a long pulse, or after a short one.
//! Where ticks follow each other so closely that no edge is ever far, it waits for one tick and comes in or after the pulse
//! of that one, which is an ordinary one and leaves the most time: enough at all rates that the settings allow (see
//! `oxmill_controller::StepRates`). So that this is not long, a message is received in one entry and taken in in another.

use crate::boards::{AXES, CORE_HZ, Due, PROFILE, SecondMotor, StepPins, StepTimer};
use crate::shared::{self, Power, STEP, Wake};
use core::sync::atomic::Ordering;
use oxmill_controller::messages::{EVENTS_DEPTH, GangedMotors, SEGMENTS_DEPTH, StepEvent, ToStep, Wiring};
use oxmill_controller::{Stepper, Tick};
use rtic_sync::channel::{Receiver, Sender};

/// Step-clock ticks in a microsecond.
const TICKS_PER_US: u32 = PROFILE.step_clock_hz / 1_000_000;

/// Cycles of the core in step-clock ticks, rounded down.
const fn in_ticks(cycles: u32) -> u32 {
    cycles * (PROFILE.step_clock_hz / 1000) / (CORE_HZ / 1000)
}

/// Longest time that a driver needs between the end of a pulse and the next one: the slowest of the common drivers (DRV8825)
/// asks for 1.9 us, and for as much of the pulse itself. Drivers that take shorter pulses take shorter pauses: A4988 1 us of
/// both, TMC2209 0.1 us. So a pause need not be longer than the pulse.
const LOW_TICKS: u32 = 2 * TICKS_PER_US;
/// A tick without a pulse sets the timer for no sooner than this: more than it takes to set it.
const SHORTEST_TICKS: u32 = TICKS_PER_US;

/// What it takes to be called, up to the look at the time.
const AGAIN_CYCLES: u32 = 160;
/// What half a message takes, from the call on; a microsecond after the look on a board where edges cannot be late.
const ATTENTION_TICKS: u32 = match PROFILE.rates.attention_ns {
    0 => in_ticks(AGAIN_CYCLES) + TICKS_PER_US,
    ns => ns * TICKS_PER_US / 1000,
};
/// An edge is far if it leaves time for half a message.
const FAR_TICKS: u32 = ATTENTION_TICKS.saturating_sub(in_ticks(AGAIN_CYCLES));
/// More than it takes from the moment a tick is due to the edge that it makes.
const EDGE_CYCLES: u32 = 150;
const EDGE_TICKS: u32 = in_ticks(EDGE_CYCLES);
/// From a moment that may be near to one that surely lies ahead.
const BEHIND_TICKS: u32 = TICKS_PER_US / 2;
/// A part of the time from the moment a tick is due to its edge that it always takes: 6 cycles of an entry that follows
/// another, and 54 instructions. An output stays low for that much longer.
const LEAST_EDGE_CYCLES: u32 = 60;
const LEAST_EDGE_TICKS: u32 = in_ticks(LEAST_EDGE_CYCLES);
// With the shortest pulse something of the pause is left, where edges can be late.
const _: () = assert!(PROFILE.rates.attention_ns == 0 || LEAST_EDGE_TICKS < TICKS_PER_US);

/// From the first segment after a rest to its first tick: the first segments of a hard start last some 50 us each, less than
/// it takes to prepare the next, so that some must be there before the first begins.
const START_TICKS: u32 = 2_000 * TICKS_PER_US;

/// How soon to try again to report to `control`, when nothing else calls.
const RETRY_TICKS: u32 = 1_000 * TICKS_PER_US;

/// Everything the task owns.
pub struct Step {
    stepper: Stepper<AXES>,
    timer: StepTimer,
    pins: StepPins,
    pulse_ticks: u32,
    /// Shortest time between the end of a pulse and the moment that the next one is due.
    low_ticks: u32,
    /// A pulse and the time after it.
    gap_ticks: u32,
    setup_ticks: u32,
    /// From the moment a tick is due to one that leaves time for what is not urgent: in a long pulse, after a short one.
    after_ticks: u32,
    /// More than two such things take, and a pulse.
    much_ticks: i32,
    segments: Receiver<'static, ToStep, SEGMENTS_DEPTH>,
    wiring: Receiver<'static, Wiring, 2>,
    events: Sender<'static, StepEvent<AXES>, EVENTS_DEPTH>,
    unsent: Unsent,
    wake: Wake,
    /// Received and not taken in yet.
    held: Option<ToStep>,
    /// Ticks that what is not urgent has waited for.
    waited: u8,
    /// When it was last put off to.
    wait_until: u32,
    /// Something has happened since the other tasks were told.
    untold: bool,
    /// Ticks are coming.
    running: bool,
    /// At rest: the last pulse has not ended yet.
    settling: bool,
    directions_shown: u8,
    power_shown: u16,
    /// The probe is active while its pin is high.
    probe_invert: bool,
    stops_done: u16,
}

/// Events that have not been sent yet, in the order in which they happen. Each kind has a place of its own and cannot
/// happen twice before it has been sent: after a contact or an underrun nothing moves until `control` has answered, and
/// it answers what it has received; of several stops the newest count is what it has to answer.
struct Unsent {
    /// The probe has been seen.
    touched: bool,
    underrun: Option<StepEvent<AXES>>,
    stopped: Option<StepEvent<AXES>>,
}

impl Unsent {
    fn any(&self) -> bool {
        self.touched || self.underrun.is_some() || self.stopped.is_some()
    }
}

impl Step {
    /// At rest.
    pub fn new(
        timer: StepTimer,
        pins: StepPins,
        segments: Receiver<'static, ToStep, SEGMENTS_DEPTH>,
        wiring: Receiver<'static, Wiring, 2>,
        events: Sender<'static, StepEvent<AXES>, EVENTS_DEPTH>,
        wake: Wake,
    ) -> Step {
        let mut step = Step {
            stepper: Stepper::new(),
            timer,
            pins,
            pulse_ticks: 10 * TICKS_PER_US,
            low_ticks: LOW_TICKS.saturating_sub(LEAST_EDGE_TICKS),
            gap_ticks: 10 * TICKS_PER_US + LOW_TICKS.saturating_sub(LEAST_EDGE_TICKS),
            setup_ticks: LOW_TICKS,
            after_ticks: EDGE_TICKS,
            much_ticks: (10 * TICKS_PER_US + 2 * ATTENTION_TICKS) as i32,
            segments,
            wiring,
            events,
            unsent: Unsent { touched: false, underrun: None, stopped: None },
            wake,
            held: None,
            waited: 0,
            wait_until: 0,
            untold: false,
            running: false,
            settling: false,
            directions_shown: 0,
            power_shown: 0,
            probe_invert: false,
            stops_done: 0,
        };
        step.pins.direct(0);
        step
    }

    /// Called for a tick, for the end of a pulse, and by others: a stop asked for, a message queued, power changed.
    #[inline(always)]
    pub fn run(&mut self) {
        let due = self.timer.take();
        if due == Due::TICK {
            self.tick();
        } else if due == Due::PULSE_END {
            self.end_pulse();
        } else {
            self.others(due);
        }
    }

    #[inline(always)]
    fn tick(&mut self) {
        match self.stepper.plain_tick() {
            Some(tick) => {
                let edge = self.raise(tick.steps);
                let least = if tick.steps == 0 { SHORTEST_TICKS } else { self.gap_ticks };
                self.go_on(&tick, edge, least);
            }
            None => self.rare_tick(),
        }
    }

    /// None of the two usual things.
    #[inline(never)]
    fn others(&mut self, due: Due) {
        if due == Due::SETTLED {
            self.settle();
            self.attend();
        } else if due == Due::CALLED && shared::stops_asked() == self.stops_done {
            self.attend();
        } else {
            self.several(due);
        }
    }

    /// More than one thing at a time, or a stop. A call may be one for a stop, so it comes first.
    #[inline(never)]
    fn several(&mut self, due: Due) {
        if due.has(Due::CALLED) && shared::stops_asked() != self.stops_done {
            self.stop();
        }
        let tick_was_at = self.timer.next_tick();
        if due.has(Due::PULSE_END) {
            self.end_pulse();
        }
        let mut is_called = due.has(Due::CALLED);
        if due.has(Due::SETTLED) {
            self.settle();
            is_called = true;
        }
        // The end of a pulse or a turn may have put the tick off: then it calls again, even if its moment has come again.
        if due.has(Due::TICK) && self.timer.next_tick() == tick_was_at {
            self.tick();
            if is_called {
                // One thing at a time: what else the call was for comes after whatever the timer wants by then.
                StepTimer::call();
            }
        } else if is_called {
            self.attend();
        }
    }

    /// Writes the steps of a tick to the pins, and sets the timer for the end of their pulse: the moment of their edge, or
    /// now.
    #[inline(always)]
    fn raise(&mut self, steps: u8) -> u32 {
        if steps == 0 {
            return self.timer.now();
        }
        self.pins.raise(steps);
        let edge = self.timer.now();
        self.timer.pulse_end_at(edge.wrapping_add(self.pulse_ticks));
        edge
    }

    /// Sets the timer for the next tick, no sooner than `least` from `now`.
    ///
    /// A pulse must have ended, and the pin have been low for a while, before the next one begins: a tick that comes late
    /// puts the next one off, and those after it stay where they were.
    #[inline(always)]
    fn go_on(&mut self, tick: &Tick, now: u32, least: u32) {
        let due = self.stepper.moment();
        self.pins.pass(tick.interval);
        if due.wrapping_sub(now) as i32 >= least as i32 {
            self.timer.next_tick_at(due);
        } else {
            self.put_off(now.wrapping_add(least));
        }
    }

    /// A tick with more to do than to step: a segment ends, motion begins or ends, the probe is looked at. The edges come
    /// first, so that they are no later than those of other ticks.
    #[inline(never)]
    fn rare_tick(&mut self) {
        if !self.running {
            return;
        }
        let steps = self.stepper.rare_steps();
        let edge = self.raise(steps);
        // Segments of a tick or two may leave no time to fetch ahead.
        if self.stepper.wants() && self.stepper.ends_segment() {
            self.fetch_at_last();
        }
        let tick = self.stepper.rare_tick(steps);
        let pulse_end = edge.wrapping_add(self.pulse_ticks);
        if tick.interval != 0 {
            let now = self.timer.now();
            let gap = if steps == 0 { 0 } else { edge.wrapping_add(self.gap_ticks).wrapping_sub(now) as i32 };
            self.go_on(&tick, now, gap.max(SHORTEST_TICKS as i32) as u32);
        }
        if tick.begins {
            self.untold = true;
            // What else comes with a segment is not urgent, but a turn, which the end of the pulse is waited for with.
            if tick.steps == 0 {
                self.settle();
                StepTimer::call();
            } else if self.pulse_ticks < ATTENTION_TICKS || tick.directions != self.directions_shown {
                self.timer.settled_at(pulse_end);
            } else {
                StepTimer::call();
            }
        }
        if self.stepper.is_watching() && self.stepper.probe(self.pins.probe_low() != self.probe_invert) {
            self.unsent.touched = true;
            self.untold = true;
            StepTimer::call();
        }
        if tick.interval == 0 {
            if tick.underrun {
                self.unsent.underrun = Some(self.stepper.underrun_event());
                self.untold = true;
                // The beam goes off at once.
                self.show_power();
                StepTimer::call();
            }
            self.rest(tick.steps != 0);
        }
    }

    /// Fetches what the tick that is due needs.
    #[cold]
    fn fetch_at_last(&mut self) {
        // Behind a shut gate the queue is only emptied, which has time.
        while self.stepper.wants() && !self.stepper.is_shut() {
            if let Some(message) = self.held.take() {
                self.stepper.load(message);
            } else if !self.receive() {
                return;
            }
        }
    }

    /// Ends the pulse, and sees to it that the next one comes late enough.
    #[inline(always)]
    fn end_pulse(&mut self) {
        self.pins.lower();
        let soonest = self.timer.now().wrapping_add(self.low_ticks);
        if (self.timer.next_tick().wrapping_sub(soonest) as i32) < 0 {
            self.delay_until(soonest);
        }
    }

    /// The pulse before has ended: time for another direction. Or it has not, for the moment was set for something else and
    /// has passed before it was set again.
    #[inline(always)]
    fn settle(&mut self) {
        let turns = self.running && self.stepper.directions() != self.directions_shown;
        if turns || self.settling {
            self.settle_now(turns);
        }
    }

    #[cold]
    fn settle_now(&mut self, turns: bool) {
        let (now, end) = (self.timer.now(), self.timer.pulse_end());
        let to_end = end.wrapping_sub(now);
        if to_end.wrapping_sub(1) < self.pulse_ticks {
            self.timer.settled_at(end);
            return;
        }
        if self.ends_now(to_end) {
            self.timer.settled_at(now.wrapping_add(BEHIND_TICKS));
            return;
        }
        if turns {
            self.turn();
        }
        self.settling = false;
    }

    /// Whether a pulse has ended since this entry began, a moment ago, and is still out.
    #[inline]
    fn ends_now(&self, to_end: u32) -> bool {
        to_end.wrapping_neg() < FAR_TICKS && self.timer.is_due(Due::PULSE_END)
    }

    /// Writes the directions of the next step.
    fn turn(&mut self) {
        self.directions_shown = self.stepper.directions();
        self.pins.direct(self.directions_shown);
        self.postpone(self.setup_ticks);
    }

    /// Lets the next tick come no sooner than `least` from now. The ticks after it stay where they were.
    #[cold]
    fn postpone(&mut self, least: u32) {
        let soonest = self.timer.now().wrapping_add(least);
        if (self.timer.next_tick().wrapping_sub(soonest) as i32) < 0 {
            self.delay_until(soonest);
        }
    }

    #[cold]
    fn delay_until(&mut self, soonest: u32) {
        if self.running {
            self.timer.tick_at(soonest);
        }
    }

    #[cold]
    fn put_off(&mut self, until: u32) {
        self.timer.tick_at(until);
    }

    /// No more ticks; after the last pulse there is time for what would cost a tick too much.
    fn rest(&mut self, pulse: bool) {
        self.timer.tick_off();
        self.running = false;
        self.settling = pulse;
        if pulse {
            self.timer.settled_at(self.timer.now().wrapping_add(self.pulse_ticks));
        } else {
            StepTimer::call();
        }
    }

    /// Receives a message, which waits for being taken in; `false` if there is none.
    #[inline(never)]
    fn receive(&mut self) -> bool {
        self.held = self.segments.try_recv().ok();
        self.held.is_some()
    }

    /// What is not as urgent as a tick, one thing at a time: what has happened is told, half a message, and the rest once
    /// there are no more.
    #[inline(never)]
    fn attend(&mut self) {
        if self.running && self.wait() {
            return;
        }
        self.waited = 0;
        let tells_first = core::mem::take(&mut self.untold);
        if tells_first {
            self.tell();
        }
        if self.stepper.wants() && (tells_first || self.half_a_message()) {
            self.again();
        } else if !tells_first {
            self.tell();
        }
    }

    /// Takes a message in or receives one; `false` if there is none.
    #[inline(always)]
    fn half_a_message(&mut self) -> bool {
        if let Some(message) = self.held.take() {
            self.stepper.load(message);
            return true;
        }
        let received = self.receive();
        if received {
            // What has left the queue is not at rest.
            STEP.at_rest.store(false, Ordering::Relaxed);
        }
        received
    }

    /// Begins to move if there is what to do, and lets the other tasks know how it goes.
    #[inline(never)]
    fn tell(&mut self) {
        if !self.running && !self.settling {
            self.start();
        }
        STEP.segments_begun.store(self.stepper.segments_begun(), Ordering::Relaxed);
        self.show_power();
        let at_rest = !self.running && !self.settling && self.held.is_none();
        if at_rest && !STEP.at_rest.load(Ordering::Relaxed) {
            self.wake.write(());
        }
        STEP.at_rest.store(at_rest, Ordering::Relaxed);
        STEP.wants.store(u8::from(self.stepper.wants()), Ordering::Relaxed);
        if self.unsent.any() {
            self.send_all();
            if self.unsent.any() && at_rest {
                self.timer.settled_at(self.timer.now().wrapping_add(RETRY_TICKS));
            }
        }
    }

    /// Calls for what else there is to do: at once, or, for to be called only to wait takes time, where it will be time.
    #[inline(always)]
    fn again(&mut self) {
        let next_tick = self.timer.next_tick();
        let to_tick = next_tick.wrapping_sub(self.timer.now()) as i32;
        if !self.running || to_tick >= self.much_ticks || self.stepper.directions() != self.directions_shown {
            StepTimer::call();
            return;
        }
        self.waited = 1;
        self.wait_until = next_tick.wrapping_add(self.after_ticks);
        self.timer.settled_at(self.wait_until);
    }

    /// If the next edge is near, calls again where there is time: after the end of this pulse, or after the next tick.
    #[inline(always)]
    fn wait(&mut self) -> bool {
        let now = self.timer.now();
        // Another call meanwhile is for the same.
        if self.waited > 0 && self.timer.settles_at(self.wait_until, now) {
            return true;
        }
        let to_tick = self.timer.next_tick().wrapping_sub(now) as i32;
        let to_end = self.timer.pulse_end().wrapping_sub(now);
        if self.ends_now(to_end) {
            StepTimer::call();
            return true;
        }
        let in_pulse = to_end.wrapping_sub(1) < self.pulse_ticks;
        if in_pulse && to_end >= FAR_TICKS {
            return false;
        }
        let (low, least) =
            if in_pulse { (to_tick.wrapping_sub(to_end as i32), ATTENTION_TICKS) } else { (to_tick, FAR_TICKS) };
        // A long pulse leaves time while it is out, if its tick was not late.
        let most_ticks = if self.pulse_ticks < ATTENTION_TICKS { 1 } else { 3 };
        let until = if self.waited < most_ticks && low < least as i32 {
            self.waited = self.waited.wrapping_add(1);
            to_tick.max(0) as u32 + self.after_ticks
        } else if in_pulse {
            to_end + BEHIND_TICKS
        } else {
            return false;
        };
        // A turn that is still to come calls at its end.
        if self.stepper.directions() == self.directions_shown {
            self.wait_until = now.wrapping_add(until);
            self.timer.settled_at(self.wait_until);
        }
        true
    }

    /// Nothing moves: time for new wiring, and for a start.
    #[cold]
    fn start(&mut self) {
        while let Ok(wiring) = self.wiring.try_recv() {
            let second = SecondMotor {
                axis: wiring.ganged,
                inverted: wiring.ganged_invert,
                stands: wiring.ganged_motors == GangedMotors::First,
                first_stands: wiring.ganged_motors == GangedMotors::Second,
            };
            self.pins.set_polarity(wiring.step_invert, wiring.direction_invert, second);
            self.directions_shown = self.stepper.directions();
            self.pins.direct(self.directions_shown);
            self.probe_invert = wiring.probe_invert;
            self.pins.set_pwm(wiring.pwm_hz, self.power_shown);
            self.pulse_ticks = u32::from(wiring.pulse_us) * TICKS_PER_US;
            self.low_ticks = self.pulse_ticks.min(LOW_TICKS).saturating_sub(LEAST_EDGE_TICKS);
            self.gap_ticks = self.pulse_ticks + self.low_ticks;
            let short = if self.pulse_ticks < ATTENTION_TICKS { self.pulse_ticks } else { 0 };
            self.after_ticks = short + EDGE_TICKS;
            self.much_ticks = (self.pulse_ticks + 2 * ATTENTION_TICKS) as i32;
            self.setup_ticks = (u32::from(wiring.direction_setup_us) * TICKS_PER_US).max(LOW_TICKS);
        }
        if !self.stepper.is_idle() {
            let begin = self.timer.now().wrapping_add(START_TICKS);
            self.stepper.begin_at(begin);
            self.running = true;
            self.timer.tick_at(begin);
        }
    }

    /// Shows the power that holds now, if it is another one.
    #[inline]
    fn show_power(&mut self) {
        let power = Power::wanted();
        let level = match (power.from_segments, self.running) {
            (true, true) => self.stepper.power(),
            // After a stop or underrun the beam stays off, whatever was wanted before.
            (true, false) if self.stepper.is_shut() => 0,
            _ => power.level,
        };
        if level != self.power_shown {
            self.pins.set_power(level);
            self.power_shown = level;
        }
    }

    /// No more pulses, beam off, everything queued is void.
    #[cold]
    fn stop(&mut self) {
        // A pulse that is out has been counted: it gets its full length, and its end comes by itself.
        self.timer.tick_off();
        self.running = false;
        self.settling = true;
        self.timer.settled_at(self.timer.now().wrapping_add(self.pulse_ticks));
        let power = Power::wanted();
        if power.from_segments {
            Power { level: 0, ..power }.want();
        }
        while shared::stops_asked() != self.stops_done {
            self.stops_done = self.stops_done.wrapping_add(1);
            let mut event = self.stepper.stop([0; AXES]);
            // The newest counts; that something was moving at an older one must not be forgotten.
            if let (StepEvent::Stopped { moving, .. }, Some(StepEvent::Stopped { moving: before, .. })) =
                (&mut event, self.unsent.stopped)
            {
                *moving |= before;
            }
            self.unsent.stopped = Some(event);
        }
        self.show_power();
        self.untold = true;
    }

    /// Sends what there is to report, as far as there is room.
    #[inline(never)]
    fn send_all(&mut self) {
        if self.unsent.touched {
            let event = self.stepper.probed_event();
            self.unsent.touched = !self.send(event);
        }
        // No event overtakes another.
        if !self.unsent.touched
            && let Some(event) = self.unsent.underrun
            && self.send(event)
        {
            self.unsent.underrun = None;
        }
        if !self.unsent.touched
            && self.unsent.underrun.is_none()
            && let Some(event) = self.unsent.stopped
            && self.send(event)
        {
            self.unsent.stopped = None;
        }
    }

    #[inline(never)]
    fn send(&mut self, event: StepEvent<AXES>) -> bool {
        let sent = self.events.try_send(event).is_ok();
        if sent {
            self.wake.write(());
        }
        sent
    }
}
