//! The step task. Each run stops if that was asked for, looks at the probe, has the `Maker` make events ahead of their
//! moment, sets when to be called next, and reports to the other tasks.
//!
//! ```text
//!            a message            2 ms later, less 0.45       enough is ahead          nothing left to make
//!   ┌──────┐ ──────────▶ ┌──────────┐ ──────▶ ┌───────────┐ ──────────▶ ┌─────────┐ ──────────▶ ┌────────┐
//!   │ Rest │             │ Starting │         │ Preparing │             │ Running │             │ Ending │
//!   └──────┘             └──────────┘         └───────────┘             └─────────┘             └────────┘
//!      ▲                                            ▲                        │ too late for the      │ all is out
//!      │                                            │                        └─────── next ────────▶ │
//!      │                                            └───────── something is left to make ────────────┤
//!      └──────────────────────────────────── nothing is; a stop comes here from all others ──────────┘
//! ```
//! Each run does, from top to bottom: stop if asked, take what it was called for, look at the probe, receive and make
//! events if it is time for them, say when to be called next, tell the other tasks.
//!
//! It promises: a stop that was asked for is obeyed before anything else in the same run, with an exact count; events that
//! come too late are put off, never lost, and those after them by as much, or motion ends with a report where motors would not
//! follow; a report to `control` is kept until it has been
//! sent. It leaves when and what to step to the stepper, and edges to the board.

use crate::boards::{AXES, Due, StepOutput, StepPins, Undone};
use crate::shared::{self, STEP, Wake};
use core::sync::atomic::Ordering;
use maker::{Ended, Maker, Onset};
use oxmill_controller::later;
use oxmill_controller::messages::{EVENTS_DEPTH, SEGMENTS_DEPTH, StepEvent, ToStep, Wiring};
use reports::Reports;
use rtic_sync::channel::{Receiver, Sender};
use timing::{
    IN_TIME_TICKS, LEAST_EVENTS, MOST_LATE_STEPS, PAUSE_TICKS, PREPARE_TICKS, RETRY_TICKS, RUN_TICKS, SPARE_TICKS,
    START_TICKS,
};

mod beam;
mod begins;
mod maker;
mod reports;
mod timing;

#[derive(Clone, Copy, PartialEq, Eq)]
enum State {
    /// Nothing is put out.
    Rest,
    /// Messages gather, for a first tick at this moment.
    Starting(u32),
    /// The first events are made, from this moment on.
    Preparing(u32),
    /// Events are put out.
    Running,
    /// The last event that there is comes out: the motion ends, or it was too late for the next.
    Ending,
}

/// Everything the task owns.
pub struct Step {
    maker: Maker,
    state: State,
    /// The latest moment for the next tick of a motion whose events came too late; none: it begins at rest.
    latest: Option<u32>,
    /// The moment of the next call for more events.
    asked: u32,
    wiring: Receiver<'static, Wiring, 2>,
    reports: Reports,
    /// The probe is active while its pin is high.
    probe_invert: bool,
    stops_done: u16,
}

impl Step {
    /// At rest.
    pub fn new(
        output: StepPins,
        segments: Receiver<'static, ToStep, SEGMENTS_DEPTH>,
        wiring: Receiver<'static, Wiring, 2>,
        events: Sender<'static, StepEvent<AXES>, EVENTS_DEPTH>,
        wake: Wake,
    ) -> Step {
        Step {
            maker: Maker::new(output, segments),
            state: State::Rest,
            latest: None,
            asked: 0,
            wiring,
            reports: Reports::new(events, wake),
            probe_invert: false,
            stops_done: 0,
        }
    }

    /// Called when more events are wanted, when one is out, for a change of power, and by others: a stop asked for, a message
    /// queued, power changed.
    #[inline(never)]
    pub fn run(&mut self) {
        // First of all: each cycle before it is one in which an event may begin. Nobody who asks preempts this task.
        if shared::stops_asked() != self.stops_done {
            self.stop();
        }
        let due = self.maker.output.take();
        self.maker.begins.pass(self.maker.output.now());
        if due.has(Due::MARK) && !self.is_preparing() {
            self.maker.beam.mark(&mut self.maker.output);
        }
        if due.has(Due::OUT) {
            self.look_at_probe();
        }
        match self.state {
            // Called before the time for more events: the pause after the last run is kept.
            State::Running | State::Preparing(_) if !self.maker.one_by_one && !due.has(Due::MORE) => self.call_sooner(),
            State::Running => self.go_on(),
            State::Ending => self.end(),
            State::Preparing(moment) => self.begin(moment),
            State::Rest | State::Starting(_) => self.start(),
        }
        self.tell();
    }

    /// Nothing moves: time for new wiring, and for a start.
    #[inline(never)]
    fn start(&mut self) {
        self.maker.receive();
        let now = self.maker.output.now();
        match self.state {
            State::Starting(begin) if begin.wrapping_sub(now) as i32 <= PREPARE_TICKS as i32 => {
                self.latest = None;
                self.prepare(begin);
            }
            State::Starting(_) => self.call_again(),
            _ => {
                while let Ok(wiring) = self.wiring.try_recv() {
                    self.maker.wire(&wiring);
                    self.probe_invert = wiring.probe_invert;
                }
                if !self.maker.stepper.is_idle() {
                    let begin = now.wrapping_add(START_TICKS);
                    self.state = State::Starting(begin);
                    self.maker.beam.clear();
                    self.call_again();
                }
            }
        }
    }

    /// Makes the first events, the next tick at this moment.
    fn prepare(&mut self, moment: u32) {
        self.maker.prepare(moment, self.latest.is_none());
        self.state = State::Preparing(moment);
        self.begin(moment);
    }

    /// Makes more of the first events; has them put out when there are enough, or no more time.
    #[inline(never)]
    fn begin(&mut self, moment: u32) {
        let before = self.maker.output.ahead();
        if !self.maker.one_by_one || before == 0 {
            self.make(moment);
        }
        let (ahead, now) = (self.maker.output.ahead(), self.maker.output.now());
        // The first event may come long after the first tick: it is the next tick that must not be late as long as there is none.
        let left = if ahead > 0 { moment } else { self.maker.stepper.moment() }.wrapping_sub(now) as i32;
        let is_late = left <= IN_TIME_TICKS as i32;
        let is_time = left <= (IN_TIME_TICKS + SPARE_TICKS) as i32 && self.latest.is_none();
        let is_far = self.maker.is_far_ahead(moment);
        let is_all = self.state == State::Ending;
        let is_full = self.maker.output.free().words.is_empty();
        if ahead > 0 && (is_late || is_time || is_far || is_full || is_all || self.maker.one_by_one) {
            self.state = if is_all { State::Ending } else { State::Running };
            if self.latest.is_none() {
                self.maker.begins.clear();
            }
            let by = self.maker.output.begin(self.maker.one_by_one);
            self.put_off(moment, by);
            self.count_anew();
            self.maker.beam.arm(&mut self.maker.output);
        } else if is_late && !is_all {
            // Nothing is ahead yet: a little later there is, or once more segments have come.
            let waits = self.latest.is_none() && self.maker.stepper.lacks_segment();
            let by = if waits { START_TICKS } else { IN_TIME_TICKS };
            self.state = State::Preparing(moment.wrapping_add(by));
            self.put_off(moment, by);
        }
        self.call_again();
    }

    /// What has been made from this moment on comes later by so many ticks: so does all that follows. If that is too late for
    /// the motors, nothing follows.
    fn put_off(&mut self, moment: u32, by: u32) {
        if self.latest.is_some_and(|latest| (latest.wrapping_sub(moment.wrapping_add(by)) as i32) < 0) {
            self.ran_dry();
        } else if by != 0 {
            self.maker.put_off(by);
        }
    }

    /// Events came so late that the motors may not have followed: to the host the same as segments that come late.
    #[cold]
    fn ran_dry(&mut self) {
        let Undone { net, fault, .. } = self.halt();
        self.break_off(net, fault);
    }

    /// Makes more events, if they can follow on those that are ahead.
    #[inline(always)]
    fn go_on(&mut self) {
        if self.maker.output.fault() {
            let Undone { net, .. } = self.halt();
            self.break_off(net, true);
            return self.call_again();
        }
        let now = self.maker.output.now();
        let left = self.maker.output.joins_until(self.maker.stepper.moment()).wrapping_sub(now) as i32;
        if !self.maker.one_by_one && (left < RUN_TICKS as i32 || self.maker.stepper.is_watching()) {
            // Too late, or from here on to be put out one by one: what is ahead comes out first.
            self.state = State::Ending;
        } else {
            self.make(now);
            self.count_anew();
        }
        self.call_again_here();
    }

    /// Makes events until enough of them are ahead of a moment, or the motion ends.
    #[inline(always)]
    fn make(&mut self, from: u32) {
        let onset = match (self.is_preparing(), self.latest) {
            (true, None) => Onset::FromRest,
            (true, Some(_)) => Onset::Resumed,
            (false, _) => Onset::Joined,
        };
        let ended = self.maker.make(from, onset);
        if ended == Ended::Underrun {
            // The position is that after what is ahead, which comes out.
            self.reports.underrun = Some(self.maker.stepper.underrun_event());
        }
        if ended != Ended::No {
            self.state = State::Ending;
        }
    }

    /// Enough follows on what came too late: the next that does counts from there.
    #[inline(always)]
    fn count_anew(&mut self) {
        if self.maker.output.ahead() >= LEAST_EVENTS {
            self.latest = None;
        }
    }

    /// No more events, and no beam.
    #[inline(always)]
    fn halt(&mut self) -> Undone<AXES> {
        let is_on = self.maker.beam.is_on();
        self.maker.output.halt(is_on)
    }

    /// In the middle of a motion: no more of it.
    #[cold]
    fn break_off(&mut self, undone: [i32; AXES], miscounted: bool) {
        self.give_up(undone, miscounted);
        self.state = State::Ending;
    }

    /// The motion is over: for want of events in time, or because what has come out is not what was made.
    #[cold]
    fn give_up(&mut self, undone: [i32; AXES], miscounted: bool) {
        self.maker.take_back_segments();
        if self.reports.underrun.is_some() {
            // What has not been told yet counts as one stop with it.
            self.maker.stepper.take_back(undone);
        } else {
            let _ = self.maker.stepper.stop(undone);
        }
        self.reports.underrun = Some(match self.maker.stepper.underrun_event() {
            StepEvent::Underrun { stops, position } if miscounted => StepEvent::Miscounted { stops, position },
            event => event,
        });
        self.maker.break_off();
        self.maker.beam.switch_off(&mut self.maker.output);
    }

    /// The last event is out: rest, or what was too late is begun again.
    #[inline(never)]
    fn end(&mut self) {
        let out_at = self.maker.out_at();
        if (out_at.wrapping_sub(self.maker.output.now()) as i32) > 0 {
            self.maker.output.call_at(out_at);
            return;
        }
        let Undone { events, net, fault } = self.maker.output.halt(false);
        self.maker.beam.end_run(&mut self.maker.output);
        if events > 0 || fault {
            self.give_up(net, true);
        }
        self.maker.receive();
        if self.maker.stepper.is_moving() {
            self.resume();
        } else {
            self.state = State::Rest;
            self.maker.begins.clear();
            self.start();
        }
    }

    /// What was too late to follow is begun again: not before its time, and no step before the set-up of its directions is over.
    #[cold]
    fn resume(&mut self) {
        let planned = self.maker.stepper.moment();
        // If few events follow and the next are too late again, it all counts from here.
        let latest = planned.wrapping_add(MOST_LATE_STEPS.wrapping_mul(self.maker.stepper.step_interval()));
        self.latest = Some(self.latest.unwrap_or(latest));
        // Time for one more run than it takes at least.
        let soon = IN_TIME_TICKS + RUN_TICKS + PAUSE_TICKS;
        let moment = later(planned, self.maker.output.now().wrapping_add(soon));
        self.maker.beam.resume_at(moment);
        self.prepare(moment);
    }

    /// No more pulses, beam off, everything queued is void.
    #[cold]
    fn stop(&mut self) {
        let halted_at = self.maker.output.now();
        let undone = self.halt();
        let mut net = undone.net;
        self.maker.begins.pass(halted_at);
        // What has not come out at all has moved nothing.
        let is_still = self.is_before_motion() && !undone.fault;
        self.maker.beam.switch_off(&mut self.maker.output);
        if undone.fault {
            // Whatever the stop is for, the position is lost: a stop of its own, before it.
            self.give_up(core::mem::take(&mut net), true);
        }
        self.maker.take_back_segments();
        while shared::stops_asked() != self.stops_done {
            self.stops_done = self.stops_done.wrapping_add(1);
            let mut event = self.maker.stepper.stop(core::mem::take(&mut net));
            if let StepEvent::Stopped { moving, .. } = &mut event {
                // Without a count that can be trusted the position is as lost as in motion.
                *moving = !is_still && (*moving || undone.events > 0 || undone.fault);
                // The newest counts; that something was moving at an older one must not be forgotten.
                if let Some(StepEvent::Stopped { moving: before, .. }) = self.reports.stopped {
                    *moving |= before;
                }
            }
            self.reports.stopped = Some(event);
        }
        // A pulse that is out has been counted: it gets its full length.
        self.maker.break_off();
        self.state = State::Ending;
        self.call_again();
    }

    /// Events are made, and not put out yet.
    fn is_preparing(&self) -> bool {
        matches!(self.state, State::Preparing(_))
    }

    /// Nothing has come out of the motion yet, which begins at rest.
    fn is_before_motion(&self) -> bool {
        self.latest.is_none() && matches!(self.state, State::Starting(_) | State::Preparing(_))
    }

    /// Says when to be called next, if no other task calls before.
    #[inline(never)]
    fn call_again(&mut self) {
        self.call_again_here();
    }

    /// The same without a call, for runs that make events.
    #[inline(always)]
    fn call_again_here(&mut self) {
        if let Some(at) = self.next_call() {
            self.asked = at;
            self.maker.output.call_at(at);
        }
    }

    /// The same, unless that is later than what has been asked for already.
    #[inline(never)]
    fn call_sooner(&mut self) {
        if let Some(at) = self.next_call()
            && (at.wrapping_sub(self.asked) as i32) < 0
        {
            self.asked = at;
            self.maker.output.call_at(at);
        }
    }

    #[inline(always)]
    fn next_call(&self) -> Option<u32> {
        let now = self.maker.output.now();
        let at = match self.state {
            State::Running => self.maker.moment_for_more(now)?,
            State::Ending => self.maker.out_at(),
            State::Preparing(moment) => moment.wrapping_sub(PREPARE_TICKS),
            State::Starting(begin) => begin.wrapping_sub(PREPARE_TICKS),
            State::Rest => return None,
        };
        Some(later(at, now.wrapping_add(PAUSE_TICKS)))
    }

    /// An event is out, one by one.
    #[inline(never)]
    fn look_at_probe(&mut self) {
        let Maker { stepper, output, .. } = &mut self.maker;
        if stepper.is_watching() && stepper.probe(output.probe_low() != self.probe_invert) {
            self.reports.touched = true;
        }
    }

    /// Whether a message that is queued now must not wait for the next call: events put out, the moment of that call
    /// counts with what is in the queue, and only one that finds it empty where a segment is needed makes it sooner.
    #[inline(always)]
    fn wants_message(&self) -> bool {
        let Maker { stepper, one_by_one, .. } = &self.maker;
        match self.state {
            State::Running | State::Preparing(_) if !one_by_one => self.maker.is_out_of_segments(),
            _ => stepper.wants(),
        }
    }

    /// Lets the other tasks know how it goes.
    #[inline(always)]
    fn tell(&mut self) {
        let (is_preparing, wants) = (self.is_preparing(), self.wants_message());
        let Maker { stepper, output, begins, beam, .. } = &mut self.maker;
        STEP.segments_begun.store(stepper.segments_begun().wrapping_sub(begins.len()), Ordering::Relaxed);
        STEP.wants.store(u8::from(wants), Ordering::Relaxed);
        let (is_rest, is_ending) = (self.state == State::Rest, self.state == State::Ending);
        let is_dark = (is_rest || is_ending) && stepper.is_shut();
        if beam.show(output, is_rest, is_dark) && !is_preparing {
            beam.arm(output);
        }
        if is_rest != STEP.at_rest.load(Ordering::Relaxed) {
            self.tell_of_rest(is_rest);
        }
        if self.reports.any() {
            self.reports.send_all(|| self.maker.stepper.probed_event());
            if self.reports.any() && is_rest {
                self.maker.output.call_at(self.maker.output.now().wrapping_add(RETRY_TICKS));
            }
        }
    }

    #[inline(never)]
    fn tell_of_rest(&mut self, at_rest: bool) {
        STEP.at_rest.store(at_rest, Ordering::Relaxed);
        if at_rest {
            self.reports.wake();
        }
    }
}
