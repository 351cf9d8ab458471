//! The step task: generates step events ahead of time (`Maker`) and feeds them to the outputs of the board. An event is
//! queued ("ahead") from its generation until it is output.
//!
//! ```text
//!            a message            after 1.55 ms          enough events ahead      nothing more to make
//!   ┌──────┐ ──────────▶ ┌──────────┐ ──────▶ ┌───────────┐ ──────────▶ ┌─────────┐ ──────────▶ ┌────────┐
//!   │ Rest │             │ Starting │         │ Preparing │             │ Running │             │ Ending │
//!   └──────┘             └──────────┘         └───────────┘             └─────────┘             └────────┘
//!      ▲                                            ▲                        │ next event            │
//!      │                                            │                        └─ is too late ───────▶ │
//!      │                                            └──────────── all output, motion continues ──────┤
//!      └───────────────── all output, motion has ended; a stop: from any state through Ending ───────┘
//! ```
//! Each run, in this order:
//! 1. stop, if requested;
//! 2. read the reasons for the call (`Due`);
//! 3. check the probe;
//! 4. receive messages and generate events, if it is time;
//! 5. schedule the next run;
//! 6. report to the other tasks.
//!
//! Guarantees:
//! * A requested stop takes effect before anything else in the same run, with an exact step count.
//! * Late events are delayed, never lost, and all events after them are delayed by the same time. If the delay is so
//!   long that the motors could not follow, motion ends with a report.
//! * A report to `control` is kept until it has been sent.
//!
//! The stepper computes the ticks (the times at which axes may step) and which axes step at each tick. The board
//! generates the edges.

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
    /// Nothing is output.
    Rest,
    /// The first messages of a motion from rest have arrived, but no event is generated yet. Contains the time of the
    /// motion's first tick.
    Starting(u32),
    /// The first events are being generated, but their output has not started. The motion begins from rest or is
    /// resumed. Contains the time of the first tick.
    Preparing(u32),
    /// Events are output, and more are generated.
    Running,
    /// The queued events are still output, but no more are generated. Afterwards the motion ends or is resumed. A
    /// motion is resumed if its next event was too late, or if events must be output one by one from there on.
    Ending,
}

/// State of the step task.
pub struct Step {
    maker: Maker,
    state: State,
    /// Deadline of a motion that is resumed, for example after late events. If its next tick cannot be output by this
    /// time, the motion is aborted. `None` for a motion that begins from rest.
    latest: Option<u32>,
    /// Time of the next scheduled run of this task.
    asked: u32,
    wiring: Receiver<'static, Wiring, 2>,
    reports: Reports,
    /// Whether the probe is active while its pin is high.
    probe_invert: bool,
    /// Number of requested stops that have been executed, since power-up (wrapping).
    stops_done: u16,
}

impl Step {
    /// Creates the task at rest.
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

    /// Runs the task. The board calls it when more events are needed, at a change of laser power, and after each event
    /// while events are output one by one. Other tasks call it after they requested a stop, queued a message or changed
    /// the power.
    #[inline(never)]
    pub fn run(&mut self) {
        // A stop comes before everything else, because events are still output until it takes effect. No task that
        // requests stops can preempt this task, so one check per run suffices.
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
            // The task was called before the scheduled time. Generate no events, so that other tasks get CPU time in
            // the pause after the previous run.
            State::Running | State::Preparing(_) if !self.maker.one_by_one && !due.has(Due::MORE) => self.call_sooner(),
            State::Running => self.go_on(),
            State::Ending => self.end(),
            State::Preparing(moment) => self.begin(moment),
            State::Rest | State::Starting(_) => self.start(),
        }
        self.tell();
    }

    /// Runs the task while nothing is output. At rest, applies new pin settings (`Wiring`), and plans the first tick of
    /// a motion when its first message has arrived. `PREPARE_TICKS` before this tick, begins to generate events.
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

    /// Starts to generate the first events, with the next tick at `moment`.
    fn prepare(&mut self, moment: u32) {
        self.maker.prepare(moment, self.latest.is_none());
        self.state = State::Preparing(moment);
        self.begin(moment);
    }

    /// Generates events in the state `Preparing`. Starts their output when there are enough of them, or no time is
    /// left. `moment`: time of the first tick.
    #[inline(never)]
    fn begin(&mut self, moment: u32) {
        let before = self.maker.output.ahead();
        if !self.maker.one_by_one || before == 0 {
            self.make(moment);
        }
        let (ahead, now) = (self.maker.output.ahead(), self.maker.output.now());
        // Time left until the first tick. If no event is queued, the ticks so far had no step and needed no event: then
        // the next tick counts.
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
            self.delay(moment, by);
            self.clear_deadline_when_ahead();
            self.maker.beam.arm(&mut self.maker.output);
        } else if is_late && !is_all {
            // No event is queued yet. Delay the motion, so that the next run can generate an event, or more segments
            // can arrive.
            let waits = self.latest.is_none() && self.maker.stepper.lacks_segment();
            let by = if waits { START_TICKS } else { IN_TIME_TICKS };
            self.state = State::Preparing(moment.wrapping_add(by));
            self.delay(moment, by);
        }
        self.call_again();
    }

    /// Delays the motion by `by` ticks of the step clock: all steps to come, and the start times of segments that have
    /// not begun. [`StepOutput::begin`] has already delayed the queued events. `moment`: planned time of the next
    /// tick. If the delayed tick would miss the deadline `self.latest`, the motors may lose steps. In this case,
    /// aborts the motion instead.
    fn delay(&mut self, moment: u32, by: u32) {
        if self.latest.is_some_and(|latest| (latest.wrapping_sub(moment.wrapping_add(by)) as i32) < 0) {
            self.ran_dry();
        } else if by != 0 {
            self.maker.delay(by);
        }
    }

    /// Aborts motion because events were so late that it is uncertain whether the motors have followed. The host gets
    /// the same report as for late segments.
    #[cold]
    fn ran_dry(&mut self) {
        let Undone { net, fault, .. } = self.halt();
        self.break_off(net, fault);
    }

    /// Generates more events, if there is time to append them to the queued ones.
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
            // It is too late to append events, or from here on events must be output one by one. In both cases,
            // generate no more until the queued events have been output.
            self.state = State::Ending;
        } else {
            self.make(now);
            self.clear_deadline_when_ahead();
        }
        self.call_again_here();
    }

    /// Generates events until the queued ones last long enough beyond the time `from`, or the limit of a run is
    /// reached. If the motion ends with them, changes to the state `Ending`.
    #[inline(always)]
    fn make(&mut self, from: u32) {
        let onset = match (self.is_preparing(), self.latest) {
            (true, None) => Onset::FromRest,
            (true, Some(_)) => Onset::Resumed,
            (false, _) => Onset::Joined,
        };
        let ended = self.maker.make(from, onset);
        if ended == Ended::Underrun {
            // Report the position after the queued events, because these will still be output.
            self.reports.underrun = Some(self.maker.stepper.underrun_event());
        }
        if ended != Ended::No {
            self.state = State::Ending;
        }
    }

    /// Clears `latest`, the deadline of a resumed motion, once enough events are queued again. So the next late event
    /// gets a deadline of its own.
    #[inline(always)]
    fn clear_deadline_when_ahead(&mut self) {
        if self.maker.output.ahead() >= LEAST_EVENTS {
            self.latest = None;
        }
    }

    /// Halts the output, and switches off the laser if it is in use. Returns the cancelled events and steps.
    #[inline(always)]
    fn halt(&mut self) -> Undone<AXES> {
        let is_on = self.maker.beam.is_on();
        self.maker.output.halt(is_on)
    }

    /// Aborts a running motion by [`Step::give_up`], and continues in the state `Ending`, so that a pulse that has
    /// begun gets its full length.
    #[cold]
    fn break_off(&mut self, undone: [i32; AXES], miscounted: bool) {
        self.give_up(undone, miscounted);
        self.state = State::Ending;
    }

    /// Stops the stepper and reports an underrun, because events were not ready in time. If `miscounted` is `true`,
    /// reports a miscount instead: the hardware did not output the generated events. `undone`: net steps that were not
    /// output.
    #[cold]
    fn give_up(&mut self, undone: [i32; AXES], miscounted: bool) {
        self.maker.take_back_segments();
        if self.reports.underrun.is_some() {
            // An earlier underrun, not reported yet, has already stopped the stepper. Only correct the position, so
            // that both underruns are reported as one stop.
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

    /// Runs the task in the state `Ending`. Waits until all queued events have been output. Then goes to rest if the
    /// motion has ended; otherwise resumes the motion.
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

    /// Resumes a motion whose queued events have all been output. Its next tick comes at the planned time or later. The
    /// next step also keeps the minimum times after the previous pulse and after a change of directions.
    #[cold]
    fn resume(&mut self) {
        let planned = self.maker.stepper.moment();
        // If the motion was resumed before, it keeps its earlier deadline, unless enough events were queued in the
        // meantime ([`Step::clear_deadline_when_ahead`]).
        let latest = planned.wrapping_add(MOST_LATE_STEPS.wrapping_mul(self.maker.stepper.step_interval()));
        self.latest = Some(self.latest.unwrap_or(latest));
        // The start of the output needs `IN_TIME_TICKS`. Add the time for one more run of this task and the pause after
        // it.
        let soon = IN_TIME_TICKS + RUN_TICKS + PAUSE_TICKS;
        let moment = later(planned, self.maker.output.now().wrapping_add(soon));
        self.maker.beam.resume_at(moment);
        self.prepare(moment);
    }

    /// Executes the requested stops: halts the output, switches off the laser, and stops the stepper, which then
    /// discards messages until `control` lets it resume.
    #[cold]
    fn stop(&mut self) {
        let halted_at = self.maker.output.now();
        let undone = self.halt();
        let mut net = undone.net;
        self.maker.begins.pass(halted_at);
        // If no event of a motion was output, no motor has moved.
        let is_still = self.is_before_motion() && !undone.fault;
        self.maker.beam.switch_off(&mut self.maker.output);
        if undone.fault {
            // The counters of the output hardware disagree, so the position is lost. Report this first, as a stop of
            // its own, whatever the reason of the requested stop.
            self.give_up(core::mem::take(&mut net), true);
        }
        self.maker.take_back_segments();
        while shared::stops_asked() != self.stops_done {
            self.stops_done = self.stops_done.wrapping_add(1);
            let mut event = self.maker.stepper.stop(core::mem::take(&mut net));
            if let StepEvent::Stopped { moving, .. } = &mut event {
                // `moving` tells that the position may be lost. So it must also be `true` if the step count is
                // unreliable.
                *moving = !is_still && (*moving || undone.events > 0 || undone.fault);
                // Only the newest stop is reported. So its report must also say that the machine was moving at an older
                // stop.
                if let Some(StepEvent::Stopped { moving: before, .. }) = self.reports.stopped {
                    *moving |= before;
                }
            }
            self.reports.stopped = Some(event);
        }
        // A pulse that has begun counts as a step, so wait in `Ending` until it has its full length.
        self.maker.break_off();
        self.state = State::Ending;
        self.call_again();
    }

    /// Returns whether the first events of a motion (from rest or resumed) are being generated and their output has not
    /// started.
    fn is_preparing(&self) -> bool {
        matches!(self.state, State::Preparing(_))
    }

    /// Returns whether a motion from rest is being started and nothing of it has been output yet.
    fn is_before_motion(&self) -> bool {
        self.latest.is_none() && matches!(self.state, State::Starting(_) | State::Preparing(_))
    }

    /// Schedules the next run of the task, at the time that its state requires. At rest, schedules none.
    #[inline(never)]
    fn call_again(&mut self) {
        self.call_again_here();
    }

    /// Like [`Step::call_again`], but inlined, for runs that generate events.
    #[inline(always)]
    fn call_again_here(&mut self) {
        if let Some(at) = self.next_call() {
            self.asked = at;
            self.maker.output.call_at(at);
        }
    }

    /// Like [`Step::call_again`], unless the next run is already scheduled for an earlier time.
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

    /// Reads the touch probe after an event, if a probing motion watches it, and notes its contact. Called only while
    /// events are output one by one.
    #[inline(never)]
    fn look_at_probe(&mut self) {
        let Maker { stepper, output, .. } = &mut self.maker;
        if stepper.is_watching() && stepper.probe(output.probe_low() != self.probe_invert) {
            self.reports.touched = true;
        }
    }

    /// Returns whether a message queued now must not wait for the next scheduled run. While events are output, the time
    /// of that run already takes queued segments into account. So a message is urgent only if a segment is needed and
    /// none is queued.
    #[inline(always)]
    fn needs_message(&self) -> bool {
        let Maker { stepper, one_by_one, .. } = &self.maker;
        match self.state {
            State::Running | State::Preparing(_) if !one_by_one => self.maker.is_out_of_segments(),
            _ => stepper.has_room(),
        }
    }

    /// Publishes the state to the other tasks, updates the laser power, and sends reports.
    #[inline(always)]
    fn tell(&mut self) {
        let (is_preparing, needs_message) = (self.is_preparing(), self.needs_message());
        let Maker { stepper, output, begins, beam, .. } = &mut self.maker;
        STEP.segments_begun.store(stepper.segments_begun().wrapping_sub(begins.len()), Ordering::Relaxed);
        STEP.needs_message.store(u8::from(needs_message), Ordering::Relaxed);
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
