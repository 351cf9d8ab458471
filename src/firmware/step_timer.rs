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

use crate::boards::{AXES, PROFILE, StepPins, StepTimer};
use crate::crossing::{self, Power, SEGMENTS_BEGUN, STEP_AT_REST, STEP_WANTS, Wake};
use core::sync::atomic::Ordering;
use oxmill_controller::Stepper;
use oxmill_controller::messages::{EVENTS_DEPTH, SEGMENTS_DEPTH, StepEvent, ToStep, Wiring};
use rtic_sync::channel::{Receiver, Sender};

/// Step-clock ticks in a microsecond.
const TICKS_PER_US: u32 = PROFILE.step_clock_hz / 1_000_000;
/// Shortest time between the end of a pulse and the next one: the slowest of the common drivers (DRV8825) asks for
/// 1.9 us.
const LOW_TICKS: u32 = 2 * TICKS_PER_US;
/// Messages fetched at a tick: those of a new block. More are left for the next one, so the worst tick is bounded.
const FETCHED_PER_TICK: usize = 2;

/// Everything the task owns.
pub struct Step {
    timer: StepTimer,
    pins: StepPins,
    stepper: Stepper<AXES>,
    segments: Receiver<'static, ToStep, SEGMENTS_DEPTH>,
    wiring: Receiver<'static, Wiring, 2>,
    events: Sender<'static, StepEvent<AXES>, EVENTS_DEPTH>,
    /// An event for which there was no room.
    unsent: Option<StepEvent<AXES>>,
    wake: Wake,
    /// Ticks are coming.
    running: bool,
    /// Moment of the tick to come.
    due: u32,
    /// A pulse is out and `directions` is to be written at its end.
    pulse: bool,
    directions: u8,
    directions_shown: u8,
    segment_power: u16,
    power_shown: u16,
    pulse_ticks: u32,
    setup_ticks: u32,
    /// The probe is active while its pin is high.
    probe_invert: bool,
    stops_done: u8,
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
            timer,
            pins,
            stepper: Stepper::new(),
            segments,
            wiring,
            events,
            unsent: None,
            wake,
            running: false,
            due: 0,
            pulse: false,
            directions: 0,
            directions_shown: 0,
            segment_power: 0,
            power_shown: 0,
            pulse_ticks: 10 * TICKS_PER_US,
            setup_ticks: LOW_TICKS,
            probe_invert: false,
            stops_done: 0,
        };
        step.pins.direct(0);
        step
    }

    /// Called for a tick, for the end of a pulse, and by others: a stop asked for, a message queued, power changed.
    #[inline]
    pub fn run(&mut self) {
        if crossing::stops_asked() != self.stops_done {
            self.stop();
        }
        if self.timer.take_pulse_end() {
            self.end_pulse();
        }
        if self.running && self.timer.take_tick() {
            self.tick();
        }
        self.fetch();
        if !self.running {
            self.rest();
        }
        let power = Power::wanted();
        let level = match (power.from_segments, self.running) {
            (true, true) => self.segment_power,
            // After a stop or underrun the beam stays off, whatever was wanted before.
            (true, false) if self.stepper.is_shut() => 0,
            _ => power.level,
        };
        if level != self.power_shown {
            self.show_power(level);
        }
        SEGMENTS_BEGUN.store(self.stepper.segments_begun(), Ordering::Relaxed);
        STEP_AT_REST.store(!self.running, Ordering::Relaxed);
        STEP_WANTS.store(u8::from(self.stepper.wants()), Ordering::Relaxed);
        if self.unsent.is_some() {
            self.send();
        }
    }

    #[inline(always)]
    fn tick(&mut self) {
        let tick = self.stepper.tick();
        // A pulse must have ended, and the pin have been low for a while, before the next one begins.
        let mut soonest = None;
        if tick.steps != 0 {
            self.pins.raise(tick.steps);
            self.pulse = true;
            let end = self.timer.now().wrapping_add(self.pulse_ticks);
            self.timer.pulse_end_at(end);
            soonest = Some(end.wrapping_add(LOW_TICKS));
        }
        self.directions = tick.directions;
        self.segment_power = tick.power;
        if self.stepper.is_watching()
            && let Some(event) = self.stepper.probe(self.pins.probe_low() != self.probe_invert)
        {
            self.unsent = Some(event);
        }
        if tick.underrun {
            self.unsent = Some(self.stepper.underrun_event());
        }
        if tick.interval == 0 {
            self.running = false;
            self.timer.tick_off();
            self.wake.write(());
        } else {
            self.pins.pass(tick.interval);
            self.due = self.due.wrapping_add(tick.interval);
            match soonest {
                Some(soonest) if (self.due.wrapping_sub(soonest) as i32) < 0 => self.timer.tick_at(soonest),
                _ => self.timer.tick_at(self.due),
            }
        }
        if !self.pulse && self.directions != self.directions_shown {
            self.turn(self.setup_ticks);
        }
    }

    /// Ends the pulse, and sees to it that the next one comes late enough.
    #[inline(always)]
    fn end_pulse(&mut self) {
        self.pins.lower();
        self.pulse = false;
        if self.directions != self.directions_shown {
            self.turn(self.setup_ticks);
        } else {
            self.postpone(LOW_TICKS);
        }
    }

    /// Writes the directions of the next step.
    fn turn(&mut self, setup: u32) {
        self.pins.direct(self.directions);
        self.directions_shown = self.directions;
        self.postpone(setup);
    }

    /// Lets the next tick come no sooner than `least` from now. The ticks after it stay where they were.
    #[inline(always)]
    fn postpone(&mut self, least: u32) {
        if self.running {
            let soonest = self.timer.now().wrapping_add(least);
            if (self.due.wrapping_sub(soonest) as i32) < 0 {
                self.timer.tick_at(soonest);
            }
        }
    }

    /// Fetches the next segment ahead of its time.
    #[inline(always)]
    fn fetch(&mut self) {
        let most = if self.running { FETCHED_PER_TICK } else { SEGMENTS_DEPTH };
        for _ in 0..most {
            if !self.stepper.wants() {
                return;
            }
            let Ok(message) = self.segments.try_recv() else { return };
            self.stepper.load(message);
        }
    }

    /// Nothing moves: time for what would cost a tick too much, and for a start.
    fn rest(&mut self) {
        if self.pulse {
            // Its end calls again.
            return;
        }
        while let Ok(wiring) = self.wiring.try_recv() {
            self.pins.set_polarity(wiring.step_invert, wiring.direction_invert);
            self.pins.direct(self.directions);
            self.directions_shown = self.directions;
            self.probe_invert = wiring.probe_invert;
            self.pulse_ticks = u32::from(wiring.pulse_us) * TICKS_PER_US;
            self.setup_ticks = (u32::from(wiring.direction_setup_us) * TICKS_PER_US).max(LOW_TICKS);
        }
        if !self.stepper.is_idle() {
            self.running = true;
            self.due = self.timer.now();
            self.tick();
            self.fetch();
        }
    }

    fn show_power(&mut self, power: u16) {
        self.pins.set_power(power);
        self.power_shown = power;
    }

    /// No more pulses, beam off, everything queued is void.
    #[cold]
    fn stop(&mut self) {
        // A pulse that is out has been counted: it gets its full length, and its end comes by itself.
        self.timer.tick_off();
        self.running = false;
        let power = Power::wanted();
        if power.from_segments {
            Power { level: 0, ..power }.want();
            self.show_power(0);
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
    }

    #[cold]
    fn send(&mut self) {
        if let Some(event) = self.unsent
            && self.events.try_send(event).is_ok()
        {
            self.unsent = None;
            self.wake.write(());
        }
    }
}
