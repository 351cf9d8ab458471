//! Generates step events ahead of time ([`Maker`]): receives segments, lets the stepper execute ticks in batches or
//! singly, and commits the resulting events to the queue of the step outputs. Inserts changes of direction and of laser
//! power. A tick is one time at which the stepper decides which axes step; a tick without a step usually needs no
//! event. Computes when more events are needed.

use super::beam::Beam;
use super::begins::Begins;
use super::timing::{
    BEGIN_TICKS, HORIZON_TICKS, IN_TIME_TICKS, LEAST_EVENTS, MOST_EVENTS, OUT_TICKS, RUN_TICKS, TICKS_PER_US,
};
use crate::boards::{AXES, COMBINATIONS, Free, SecondMotor, StepOutput, StepPins};
use crate::shared::STEP;
use core::sync::atomic::Ordering;
use oxmill_controller::messages::{GangedMotors, SEGMENTS_DEPTH, ToStep, Wiring};
use oxmill_controller::{StepTiming, Stepper, later, sooner};
use rtic_sync::channel::Receiver;

/// An event or tick that is generated alone takes longer than one in a batch. It therefore counts as this many events
/// towards the limit of a run ([`MOST_EVENTS`]).
const SINGLE_SHARE: usize = 4;
/// The start of a segment includes the loading of messages. It therefore counts as this many events towards the limit
/// [`MOST_EVENTS`]. A run starts at most one segment.
const SEGMENT_SHARE: usize = 16;
/// Value of `directions` if the directions at the outputs are unknown. An event that writes the directions is then
/// inserted before the next tick.
const UNKNOWN: u8 = u8::MAX;

/// What one call of [`Maker::make_one`] has generated.
enum Made {
    /// No event or tick, because there was none to generate, or because there was no room.
    Nothing,
    /// An event, or a tick without one.
    One,
    /// The tick that begins a segment.
    Segment,
    /// The last tick of a motion, which ends by an underrun or as planned.
    Last { underrun: bool },
}

impl Made {
    fn one(is_made: bool) -> Made {
        if is_made { Made::One } else { Made::Nothing }
    }
}

/// Whether motion has ended within a call of [`Maker::make`].
#[derive(Clone, Copy, PartialEq, Eq)]
pub enum Ended {
    /// No: there is more to generate, now or later.
    No,
    /// The motion ended as planned.
    AtRest,
    /// The motion ended because a segment was missing. The queued events will still be output.
    Underrun,
}

/// State of the output when events are generated.
#[derive(Clone, Copy, PartialEq, Eq)]
pub enum Onset {
    /// A motion begins from rest, and its output has not started. The motion waits for missing segments, and can still
    /// be delayed.
    FromRest,
    /// After late events, a motion is to be resumed, and its output has not started again. The motion can still be
    /// delayed.
    Resumed,
    /// The output runs, and the generated events are appended to the queued ones.
    Joined,
}

/// Generates events ahead of time from segments.
pub struct Maker {
    pub stepper: Stepper<AXES>,
    pub output: StepPins,
    segments: Receiver<'static, ToStep, SEGMENTS_DEPTH>,
    timing: StepTiming,
    /// Whether all ticks of the running segment can be output as planned: each interval between them is long enough for
    /// a pulse and the pause after it, and so short that no event must be inserted. Only then can ticks be generated in
    /// batches.
    is_regular: bool,
    /// Whether events are output one by one, each by an interrupt of its own.
    pub one_by_one: bool,
    /// Time of the event committed most recently.
    last: u32,
    /// Earliest time of the next step: after the previous pulse and the pause that must follow it, and after the set-up
    /// time if the directions have changed.
    free_from: u32,
    directions: u8,
    pub begins: Begins,
    pub beam: Beam,
}

impl Maker {
    pub fn new(output: StepPins, segments: Receiver<'static, ToStep, SEGMENTS_DEPTH>) -> Maker {
        Maker {
            stepper: Stepper::new(),
            output,
            segments,
            timing: StepTiming::new(TICKS_PER_US, 100, 0),
            is_regular: false,
            one_by_one: false,
            last: 0,
            free_from: 0,
            directions: UNKNOWN,
            begins: Begins::new(),
            beam: Beam::new(),
        }
    }

    /// Applies the settings for polarity, second motor, pulse length, PWM and direction set-up time. Call only at rest.
    pub fn wire(&mut self, wiring: &Wiring) {
        let second = SecondMotor {
            axis: wiring.ganged,
            inverted: wiring.ganged_invert,
            gets_no_steps: wiring.ganged_motors == GangedMotors::First,
            first_gets_no_steps: wiring.ganged_motors == GangedMotors::Second,
        };
        self.output.set_polarity(wiring.step_invert, wiring.direction_invert, second);
        self.output.set_pulse(wiring.pulse_tenths);
        self.output.set_pwm(wiring.pwm_hz, self.beam.shown());
        self.directions = UNKNOWN;
        self.timing = StepTiming::new(TICKS_PER_US, wiring.pulse_tenths, u32::from(wiring.direction_setup_us));
    }

    /// Loads queued messages while the stepper has room.
    #[inline(always)]
    pub fn receive(&mut self) {
        while self.stepper.has_room() && self.receive_one() {}
    }

    #[inline(never)]
    fn receive_one(&mut self) -> bool {
        let Ok(message) = self.segments.try_recv() else { return false };
        // `control` must not treat the machine as at rest while a message has left the queue but is not loaded yet.
        STEP.at_rest.store(false, Ordering::Relaxed);
        self.stepper.load(message);
        true
    }

    /// Sets the time of the next tick to `moment`. `from_rest`: `true` for a motion from rest; no step is then output
    /// before `moment`.
    pub fn prepare(&mut self, moment: u32, from_rest: bool) {
        if from_rest {
            self.free_from = moment;
        }
        self.stepper.begin_at(moment);
        self.last = moment.wrapping_sub(self.timing.gap);
        self.one_by_one = StepPins::DEPTH == 1 || self.stepper.is_watching();
    }

    /// Delays the motion by `by` ticks of the step clock: all ticks to come, and the start times and power changes of
    /// generated segments that have not begun. The events in the queue of the output keep their times.
    pub fn delay(&mut self, by: u32) {
        self.stepper.begin_at(self.stepper.moment().wrapping_add(by));
        self.last = self.last.wrapping_add(by);
        self.free_from = self.free_from.wrapping_add(by);
        self.begins.delay(by);
        self.beam.delay(by);
    }

    /// Corrects the stepper's count of begun segments after a stop: subtracts the generated segments whose start has
    /// not been output.
    pub fn take_back_segments(&mut self) {
        self.stepper.take_back_segments(self.begins.len());
        self.begins.clear();
    }

    /// Counts minimum times from now instead of from the most recent event, and makes the next step wait until the
    /// directions have been written again. Called when the output has been halted.
    pub fn break_off(&mut self) {
        self.last = self.output.now();
        self.directions = UNKNOWN;
    }

    /// Generates events until the queued ones last long enough beyond the time `from` ([`Maker::is_far_ahead`]), the
    /// limit of a run ([`MOST_EVENTS`]) is reached, or the motion ends.
    #[inline(never)]
    pub fn make(&mut self, from: u32, mut onset: Onset) -> Ended {
        // Ignore slots that become free during this call: they become free one at a time, which would make batches of
        // single events.
        let most = StepPins::DEPTH.saturating_sub(self.output.ahead()).min(MOST_EVENTS);
        let (mut room, mut has_begun, mut ended) = (most, false, Ended::No);
        while room > 0 && !self.is_far_ahead(from) {
            if self.stepper.has_plain() && self.is_regular && self.is_free() {
                room = room.saturating_sub(self.make_batch(room));
                continue;
            }
            let may_begin = !has_begun && (room >= SEGMENT_SHARE || room == most);
            let share = match self.make_one(may_begin, onset) {
                Made::Nothing => break,
                Made::One => SINGLE_SHARE,
                Made::Segment => {
                    has_begun = true;
                    SEGMENT_SHARE
                }
                Made::Last { underrun } => {
                    onset = Onset::Joined;
                    if ended != Ended::Underrun {
                        ended = if underrun { Ended::Underrun } else { Ended::AtRest };
                    }
                    SINGLE_SHARE
                }
            };
            room = room.saturating_sub(share);
            if self.one_by_one {
                break;
            }
        }
        ended
    }

    /// Returns whether enough events are queued: at least [`LEAST_EVENTS`], and so many that the next event can still
    /// be committed in time [`HORIZON_TICKS`] after the time `from`.
    #[inline(always)]
    pub fn is_far_ahead(&self, from: u32) -> bool {
        let until = self.output.joins_until(self.stepper.moment());
        !self.one_by_one
            && self.output.ahead() >= LEAST_EVENTS
            && until.wrapping_sub(from) as i32 >= HORIZON_TICKS as i32
    }

    /// Returns whether fewer than [`LEAST_EVENTS`] events are queued, or all of them will have been output within
    /// [`IN_TIME_TICKS`].
    #[inline(always)]
    fn is_short(&self) -> bool {
        self.output.ahead() < LEAST_EVENTS || self.last.wrapping_sub(self.output.now()) as i32 <= IN_TIME_TICKS as i32
    }

    /// Returns whether the next tick can be output at its planned time, and needs no change of directions before it.
    #[inline(always)]
    fn is_free(&self) -> bool {
        self.stepper.moment().wrapping_sub(self.free_from) as i32 >= 0 && self.directions == self.stepper.directions()
    }

    /// Generates up to `most` plain ticks (which do nothing but step) in a row, and returns their number. If there was
    /// no room for any, returns `most`, which ends the run.
    #[inline(always)]
    fn make_batch(&mut self, most: usize) -> usize {
        let Free { table, words, moments } = self.output.free();
        let room = words.len().min(most);
        let (Some(words), Some(moments)) = (words.get_mut(..room), moments.get_mut(..room)) else { return most };
        let made = self.stepper.plain_ticks(table, words, moments);
        let Some(last) = made.checked_sub(1).and_then(|last| moments.get(last)) else { return most };
        self.last = *last;
        self.free_from = self.last.wrapping_add(self.timing.gap);
        self.output.commit(made);
        made
    }

    /// Generates one event, or executes one tick without an event.
    #[inline(never)]
    fn make_one(&mut self, may_begin: bool, onset: Onset) -> Made {
        let moment = self.stepper.moment();
        if self.output.free().words.is_empty() || self.is_marked_full() && self.output.ahead() > 0 {
            return Made::Nothing;
        }
        if onset == Onset::FromRest && self.stepper.is_moving() {
            // Before a motion begins there is time: load the messages that have arrived, and wait until the next
            // segment is there.
            self.receive();
            if self.stepper.lacks_segment() {
                return Made::Nothing;
            }
        }
        if self.directions != self.stepper.directions() && self.stepper.is_moving() {
            return Made::one(self.turn());
        }
        if !self.one_by_one
            && !self.stepper.is_idle()
            && let Some(between) = self.timing.between(self.last, moment, self.is_short())
        {
            return Made::one(self.commit(0, between));
        }
        if self.stepper.ends_segment() && !may_begin {
            return Made::Nothing;
        }
        self.receive();
        if self.stepper.is_idle() || self.waits_for_segment(onset) {
            return Made::Nothing;
        }
        // Only a tick that is output as an event has to wait until the pause after the previous pulse is over. Any
        // other tick keeps its planned time.
        let is_edge = self.one_by_one || self.stepper.steps_next();
        let at = if is_edge { self.soonest(later(moment, self.free_from)) } else { moment };
        // If this tick is delayed, all later ones are delayed by the same time: to catch up would change the speed
        // abruptly.
        self.stepper.begin_at(at);
        let tick = self.stepper.tick();
        let is_out = (tick.steps != 0 || self.one_by_one) && self.commit(tick.steps, at);
        self.output.pass(tick.interval);
        if tick.begins {
            self.begin_segment(if is_out { self.last } else { at }, onset);
            return Made::Segment;
        }
        if tick.interval != 0 {
            return Made::One;
        }
        if tick.underrun {
            // Do not wait for the queued events: switch the laser off now.
            self.begins.clear();
            self.beam.switch_off(&mut self.output);
        }
        Made::Last { underrun: tick.underrun }
    }

    /// Generates an event that writes the directions of the next steps. It follows the previous pulse, and precedes the
    /// next step by the set-up time (`$29`). Returns whether there was room.
    fn turn(&mut self) -> bool {
        self.directions = self.stepper.directions();
        self.output.direct(self.directions);
        let at = self.soonest(self.last.wrapping_add(self.timing.gap));
        let is_made = self.commit(0, at);
        self.free_from = self.last.wrapping_add(self.timing.setup);
        is_made
    }

    /// Returns `moment`, or a later time if an interrupt outputs the event and cannot meet `moment`.
    fn soonest(&self, moment: u32) -> u32 {
        if self.one_by_one { later(moment, self.output.now().wrapping_add(StepPins::SOON)) } else { moment }
    }

    /// Commits an event at the time `at`, a pulse on the axes in the mask `steps` (0: no pulse). If the board delays
    /// the event, delays all later ticks by the same time. Returns whether there was room.
    fn commit(&mut self, steps: u8, at: u32) -> bool {
        let Free { table, words, moments } = self.output.free();
        let (Some(word), Some(moment)) = (words.first_mut(), moments.first_mut()) else { return false };
        *word = table.get(usize::from(steps) % COMBINATIONS).copied().unwrap_or(0);
        *moment = at;
        let by = self.output.commit(1);
        if by != 0 {
            self.stepper.begin_at(self.stepper.moment().wrapping_add(by));
        }
        self.last = at.wrapping_add(by);
        self.free_from = later(self.free_from, self.last.wrapping_add(self.timing.gap));
        true
    }

    /// Records that a segment begins with the event at the time `at`. Notes this time, queues the segment's laser
    /// power, and checks whether its ticks can be generated in batches.
    fn begin_segment(&mut self, at: u32, onset: Onset) {
        self.is_regular = !self.one_by_one && self.timing.is_regular(self.stepper.intervals());
        self.begins.push(at);
        if self.beam.segment(at, self.stepper.power()) && onset == Onset::Joined {
            self.beam.arm(&mut self.output);
        }
    }

    /// Returns the latest time at which a run of the task can receive the segment of the next tick and still generate
    /// the event of this tick in time. If the segment comes later, the tick becomes an underrun.
    fn last_chance(&self) -> u32 {
        let margin = if self.one_by_one { StepPins::SOON + BEGIN_TICKS } else { 2 * RUN_TICKS };
        self.output.joins_until(self.stepper.moment()).wrapping_sub(margin)
    }

    /// Returns whether to wait for a segment. `true` if the next tick would be an underrun without this segment, and
    /// the segment can still arrive in time.
    fn waits_for_segment(&self, onset: Onset) -> bool {
        let left = self.last_chance().wrapping_sub(self.output.now()) as i32;
        self.stepper.lacks_segment() && (left > 0 || onset == Onset::FromRest)
    }

    /// Returns whether the next tick needs a segment and none is queued.
    #[inline(always)]
    pub fn is_out_of_segments(&self) -> bool {
        self.stepper.lacks_segment() && self.segments.is_empty()
    }

    /// Returns whether no more segment starts or changes of power can be stored.
    fn is_marked_full(&self) -> bool {
        self.begins.is_full() || self.beam.is_full()
    }

    /// Returns whether to generate more events now: those queued do not last long enough beyond the time `from`
    /// ([`Maker::is_far_ahead`]), there are more to generate, and the queue has room for [`MOST_EVENTS`].
    #[inline(always)]
    fn wants_more(&self, from: u32, ahead: usize) -> bool {
        let has_room = ahead + MOST_EVENTS <= StepPins::DEPTH;
        let is_stopped = self.one_by_one || self.is_out_of_segments() || self.is_marked_full();
        has_room && !is_stopped && !self.is_far_ahead(from)
    }

    /// Returns when to call the task to generate more events, while events are output. Returns `None` if the interrupt
    /// after a single event will call the task.
    #[inline(always)]
    pub fn moment_for_more(&self, now: u32) -> Option<u32> {
        let ahead = self.output.ahead();
        let left = (ahead / 2).max(LEAST_EVENTS - 1);
        if self.wants_more(now, ahead) {
            // The present run could not generate enough events, for example because segments are shorter than runs:
            // call the task again at once.
            return Some(now);
        }
        if self.one_by_one {
            return (ahead == 0).then(|| self.last_chance());
        }
        if ahead <= left {
            return Some(self.last_chance());
        }
        // Call the task when half of the queued events are left, or at `before_two_runs` if that is earlier: a run
        // that begins a segment and changes directions generates fewer events than are output meanwhile.
        let early = sooner(self.output.moment_before(left), self.before_two_runs());
        Some(sooner(early, self.last_chance()))
    }

    /// Returns the later of two times. One is `IN_TIME_TICKS` before the last queued event: enough for two runs, a
    /// pause and the start of the output. At the other, the queue will have room for [`MOST_EVENTS`] more events.
    #[inline(never)]
    fn before_two_runs(&self) -> u32 {
        later(
            self.output.moment_before(StepPins::DEPTH.saturating_sub(MOST_EVENTS)),
            self.last.wrapping_sub(IN_TIME_TICKS),
        )
    }

    /// Returns the time at which the event committed most recently and its pulse are complete.
    pub fn out_at(&self) -> u32 {
        self.last.wrapping_add(self.timing.pulse + OUT_TICKS)
    }
}
