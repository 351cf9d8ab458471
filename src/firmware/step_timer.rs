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

use crate::boards::{AXES, Due, PROFILE, StepPins, StepTimer};
use crate::crossing::{self, Power, SEGMENTS_BEGUN, STEP_AT_REST, STEP_WANTS, Wake};
use core::sync::atomic::Ordering;
use oxmill_controller::messages::{EVENTS_DEPTH, SEGMENTS_DEPTH, StepEvent, ToStep, Wiring};
use oxmill_controller::{Stepper, Tick};
use rtic_sync::channel::{Receiver, Sender};

/// Step-clock ticks in a microsecond.
const TICKS_PER_US: u32 = PROFILE.step_clock_hz / 1_000_000;
/// Shortest time between the end of a pulse and the next one: the slowest of the common drivers (DRV8825) asks for
/// 1.9 us.
const LOW_TICKS: u32 = 2 * TICKS_PER_US;
/// A tick without a pulse sets the timer for no sooner than this: more than it takes to set it.
const SHORTEST_TICKS: u32 = TICKS_PER_US;

/// How soon to try again to report to `control`, when nothing else calls.
const RETRY_TICKS: u32 = 1_000 * TICKS_PER_US;

/// Everything the task owns.
pub struct Step {
    stepper: Stepper<AXES>,
    timer: StepTimer,
    pins: StepPins,
    pulse_ticks: u32,
    /// A pulse and the time after it.
    gap_ticks: u32,
    setup_ticks: u32,
    segments: Receiver<'static, ToStep, SEGMENTS_DEPTH>,
    wiring: Receiver<'static, Wiring, 2>,
    events: Sender<'static, StepEvent<AXES>, EVENTS_DEPTH>,
    /// An event that has not been sent yet.
    unsent: Option<StepEvent<AXES>>,
    wake: Wake,
    /// The probe has been seen; the report has not been made yet.
    touched: bool,
    /// Ticks are coming.
    running: bool,
    /// At rest: the last pulse has not ended yet.
    settling: bool,
    directions_shown: u8,
    segment_power: u16,
    power_shown: u16,
    /// The probe is active while its pin is high.
    probe_invert: bool,
    stops_done: u16,
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
            gap_ticks: 10 * TICKS_PER_US + LOW_TICKS,
            setup_ticks: LOW_TICKS,
            segments,
            wiring,
            events,
            unsent: None,
            wake,
            touched: false,
            running: false,
            settling: false,
            directions_shown: 0,
            segment_power: 0,
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
            if self.stepper.ends_segment() || self.stepper.is_watching() {
                self.rare_tick();
            } else {
                let tick = self.stepper.tick_within();
                self.show(&tick, true);
            }
        } else if due == Due::PULSE_END {
            self.end_pulse();
        } else {
            self.several(due);
        }
    }

    /// More than one thing at a time, or none of the two usual ones. A call may be one for a stop, so it comes first.
    #[inline(never)]
    fn several(&mut self, due: Due) {
        if due.has(Due::CALLED) && crossing::stops_asked() != self.stops_done {
            self.stop();
        }
        if due.has(Due::PULSE_END) {
            self.end_pulse();
        }
        if due.has(Due::SETTLED) {
            self.settle();
        }
        // The end of a pulse or a turn may have put the tick off.
        let still_due = self.timer.next_tick().wrapping_sub(self.timer.now()) as i32 <= 0;
        if due.has(Due::TICK) && still_due {
            self.rare_tick();
            if due.has(Due::CALLED) {
                // One thing at a time: what else the call was for comes after whatever the timer wants by then.
                StepTimer::call();
            }
        } else if due.has(Due::CALLED) {
            self.attend();
        }
    }

    /// Writes a tick to the pins, and sets the timer for the end of its pulse and for the next tick.
    ///
    /// A pulse must have ended, and the pin have been low for a while, before the next one begins: a tick that comes late
    /// puts the next one off, and those after it stay where they were.
    #[inline(always)]
    fn show(&mut self, tick: &Tick, goes_on: bool) {
        let mut least = SHORTEST_TICKS;
        if tick.steps != 0 {
            self.pins.raise(tick.steps);
            least = self.gap_ticks;
        }
        let now = self.timer.now();
        if tick.steps != 0 {
            self.timer.pulse_end_at(now.wrapping_add(self.pulse_ticks));
        }
        if !goes_on {
            return;
        }
        self.pins.pass(tick.interval);
        let due = self.stepper.moment();
        if due.wrapping_sub(now) as i32 >= least as i32 {
            self.timer.next_tick_at(due);
        } else {
            self.put_off(now.wrapping_add(least));
        }
    }

    /// A tick with more to do than to step: a segment ends, motion begins or ends, the probe is looked at.
    #[inline(never)]
    fn rare_tick(&mut self) {
        if !self.running {
            return;
        }
        // Segments of a tick or two may leave no time to fetch ahead.
        if self.stepper.ends_segment() {
            // Behind a shut gate the queue is only emptied, which has time.
            while self.stepper.wants() && !self.stepper.is_shut() && self.fetch() {}
        }
        let begun = self.stepper.segments_begun();
        let tick = self.stepper.tick();
        self.show(&tick, tick.interval != 0);
        if self.stepper.is_watching() && self.stepper.probe(self.pins.probe_low() != self.probe_invert) {
            self.touched = true;
            StepTimer::call();
        }
        if tick.interval == 0 {
            if tick.underrun {
                self.report(self.stepper.underrun_event());
            }
            self.rest(tick.steps != 0);
            return;
        }
        if self.stepper.segments_begun() != begun {
            SEGMENTS_BEGUN.store(self.stepper.segments_begun(), Ordering::Relaxed);
            self.segment_power = tick.power;
            self.show_power();
            if tick.directions != self.directions_shown {
                if tick.steps != 0 {
                    self.timer.settled_at(self.timer.now().wrapping_add(self.pulse_ticks));
                } else {
                    self.turn();
                }
            }
            // The next segment is fetched ahead of its time, and not in this tick, which is long enough.
            StepTimer::call();
        }
    }

    /// Ends the pulse, and sees to it that the next one comes late enough.
    #[inline(always)]
    fn end_pulse(&mut self) {
        self.pins.lower();
        let low = self.timer.next_tick().wrapping_sub(self.timer.now());
        if (low as i32) < LOW_TICKS as i32 {
            self.postpone(LOW_TICKS);
        }
    }

    /// The pulse before has ended: time for another direction.
    #[cold]
    fn settle(&mut self) {
        if self.running && self.stepper.directions() != self.directions_shown {
            self.turn();
        }
        if self.settling || self.unsent.is_some() {
            self.settling = false;
            StepTimer::call();
        }
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
        if self.running {
            let soonest = self.timer.now().wrapping_add(least);
            if (self.timer.next_tick().wrapping_sub(soonest) as i32) < 0 {
                self.timer.tick_at(soonest);
            }
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

    /// Fetches a message; `false` if there is none.
    #[inline(never)]
    fn fetch(&mut self) -> bool {
        let Ok(message) = self.segments.try_recv() else { return false };
        self.stepper.load(message);
        true
    }

    /// What is not as urgent as a tick, one message at a time.
    fn attend(&mut self) {
        if self.stepper.wants() && self.fetch() && self.stepper.wants() {
            StepTimer::call();
        }
        if !self.running && !self.settling {
            self.start();
        }
        self.show_power();
        let at_rest = !self.running && !self.settling;
        if at_rest && !STEP_AT_REST.load(Ordering::Relaxed) {
            self.wake.write(());
        }
        STEP_AT_REST.store(at_rest, Ordering::Relaxed);
        STEP_WANTS.store(u8::from(self.stepper.wants()), Ordering::Relaxed);
        if self.touched || self.unsent.is_some() {
            self.send_all();
            if self.unsent.is_some() && at_rest {
                self.timer.settled_at(self.timer.now().wrapping_add(RETRY_TICKS));
            }
        }
    }

    /// Nothing moves: time for new wiring, and for a start.
    #[cold]
    fn start(&mut self) {
        while let Ok(wiring) = self.wiring.try_recv() {
            self.pins.set_polarity(wiring.step_invert, wiring.direction_invert);
            self.directions_shown = self.stepper.directions();
            self.pins.direct(self.directions_shown);
            self.probe_invert = wiring.probe_invert;
            self.pulse_ticks = u32::from(wiring.pulse_us) * TICKS_PER_US;
            self.gap_ticks = self.pulse_ticks + LOW_TICKS;
            self.setup_ticks = (u32::from(wiring.direction_setup_us) * TICKS_PER_US).max(LOW_TICKS);
        }
        if !self.stepper.is_idle() {
            let now = self.timer.now();
            self.stepper.begin_at(now);
            self.running = true;
            self.timer.tick_at(now);
        }
    }

    /// Shows the power that holds now, if it is another one.
    #[inline]
    fn show_power(&mut self) {
        let power = Power::wanted();
        let level = match (power.from_segments, self.running) {
            (true, true) => self.segment_power,
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
        self.send_all();
        // A pulse that is out has been counted: it gets its full length, and its end comes by itself.
        self.timer.tick_off();
        self.running = false;
        self.settling = true;
        self.timer.settled_at(self.timer.now().wrapping_add(self.pulse_ticks));
        let power = Power::wanted();
        if power.from_segments {
            Power { level: 0, ..power }.want();
        }
        while crossing::stops_asked() != self.stops_done {
            self.stops_done = self.stops_done.wrapping_add(1);
            let mut event = self.stepper.stop();
            // The newest counts; that something was moving at an older one must not be forgotten.
            if let (StepEvent::Stopped { moving, .. }, Some(StepEvent::Stopped { moving: before, .. })) =
                (&mut event, self.unsent)
            {
                *moving |= before;
            }
            self.unsent = Some(event);
        }
        self.show_power();
    }

    /// Keeps an event until there is time to send it.
    #[cold]
    fn report(&mut self, event: StepEvent<AXES>) {
        self.send_all();
        self.unsent = Some(event);
        StepTimer::call();
    }

    /// Sends what there is to report, as far as there is room.
    #[inline(never)]
    fn send_all(&mut self) {
        self.send();
        if self.touched && self.unsent.is_none() {
            self.touched = false;
            self.unsent = Some(self.stepper.probed_event());
            self.send();
        }
    }

    #[inline(never)]
    fn send(&mut self) {
        if let Some(event) = self.unsent
            && self.events.try_send(event).is_ok()
        {
            self.unsent = None;
            self.wake.write(());
        }
    }
}
