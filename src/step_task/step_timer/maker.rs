//! `Maker` makes events ahead of their moment: it receives segments, has ticks made in batches or one by one, and
//! commits them to the ring of the step outputs, with changes of direction and power. It says when it has to be called
//! again.

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

/// As many events of a batch take as long as an event, or a tick, that is made by itself.
const SINGLE_SHARE: usize = 4;
/// The same of a segment that begins, with both of its messages. A run begins one at most.
const SEGMENT_SHARE: usize = 16;
/// Directions that no output shows: the next tick writes them.
const UNKNOWN: u8 = u8::MAX;

/// What a call of [`Maker::make_one`] has made.
enum Made {
    /// There was nothing to make, or no room.
    Nothing,
    /// An event, or a tick without one.
    One,
    /// The tick that begins a segment.
    Segment,
    /// The last tick of a motion: an underrun, or as planned.
    Last { underrun: bool },
}

impl Made {
    fn one(is_made: bool) -> Made {
        if is_made { Made::One } else { Made::Nothing }
    }
}

/// How a call of [`Maker::make`] has ended.
#[derive(Clone, Copy, PartialEq, Eq)]
pub enum Ended {
    /// There is more to be made, at once or later.
    No,
    /// With the end of the motion.
    AtRest,
    /// With the end of the motion, for want of a segment; what is ahead comes out.
    Underrun,
}

/// What the events that are made come to.
#[derive(Clone, Copy, PartialEq, Eq)]
pub enum Onset {
    /// A motion from rest, which has not begun: it waits for what follows, and may be put off.
    FromRest,
    /// A motion that is resumed and has not begun: it may be put off.
    Resumed,
    /// They follow on events that are put out.
    Joined,
}

/// From segments to events that are ahead.
pub struct Maker {
    pub stepper: Stepper<AXES>,
    pub output: StepPins,
    segments: Receiver<'static, ToStep, SEGMENTS_DEPTH>,
    timing: StepTiming,
    /// Ticks of the segment that runs can be put out as they are.
    is_regular: bool,
    pub one_by_one: bool,
    /// Moment of the event committed last.
    last: u32,
    /// No step before this moment.
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

    /// At rest: polarity, second motor, pulse, PWM and set-up time of directions as the settings have them.
    pub fn wire(&mut self, wiring: &Wiring) {
        let second = SecondMotor {
            axis: wiring.ganged,
            inverted: wiring.ganged_invert,
            stands: wiring.ganged_motors == GangedMotors::First,
            first_stands: wiring.ganged_motors == GangedMotors::Second,
        };
        self.output.set_polarity(wiring.step_invert, wiring.direction_invert, second);
        self.output.set_pulse(wiring.pulse_tenths);
        self.output.set_pwm(wiring.pwm_hz, self.beam.shown());
        self.directions = UNKNOWN;
        self.timing = StepTiming::new(TICKS_PER_US, wiring.pulse_tenths, u32::from(wiring.direction_setup_us));
    }

    /// Takes in what is there, as far as the stepper has room.
    #[inline(always)]
    pub fn receive(&mut self) {
        while self.stepper.wants() && self.receive_one() {}
    }

    #[inline(never)]
    fn receive_one(&mut self) -> bool {
        let Ok(message) = self.segments.try_recv() else { return false };
        // What has left the queue is not at rest.
        STEP.at_rest.store(false, Ordering::Relaxed);
        self.stepper.load(message);
        true
    }

    /// The next tick is to come at this moment; from rest no step before it.
    pub fn prepare(&mut self, moment: u32, from_rest: bool) {
        if from_rest {
            self.free_from = moment;
        }
        self.stepper.begin_at(moment);
        self.last = moment.wrapping_sub(self.timing.gap);
        self.one_by_one = StepPins::DEPTH == 1 || self.stepper.is_watching();
    }

    /// All that has been made and has not begun comes later by so many ticks, and so does what follows.
    pub fn put_off(&mut self, by: u32) {
        self.stepper.begin_at(self.stepper.moment().wrapping_add(by));
        self.last = self.last.wrapping_add(by);
        self.free_from = self.free_from.wrapping_add(by);
        self.begins.put_off(by);
        self.beam.put_off(by);
    }

    /// After a stop: what is still ahead does not begin.
    pub fn take_back_segments(&mut self) {
        self.stepper.take_back_segments(self.begins.len());
        self.begins.clear();
    }

    /// No event follows on those before: neither their moment nor the directions count any more.
    pub fn break_off(&mut self) {
        self.last = self.output.now();
        self.directions = UNKNOWN;
    }

    /// Makes events until enough of them are ahead of a moment, or the motion ends.
    #[inline(never)]
    pub fn make(&mut self, from: u32, mut onset: Onset) -> Ended {
        // Not those places that become free meanwhile: they come one by one.
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

    /// Whether what is ahead of a moment is enough: counted to where the next event must be there at the latest.
    #[inline(always)]
    pub fn is_far_ahead(&self, from: u32) -> bool {
        let until = self.output.joins_until(self.stepper.moment());
        !self.one_by_one
            && self.output.ahead() >= LEAST_EVENTS
            && until.wrapping_sub(from) as i32 >= HORIZON_TICKS as i32
    }

    /// Few events are ahead, or all of them are out before two more runs could follow.
    #[inline(always)]
    fn is_short(&self) -> bool {
        self.output.ahead() < LEAST_EVENTS || self.last.wrapping_sub(self.output.now()) as i32 <= IN_TIME_TICKS as i32
    }

    /// Whether the next tick may be put out at its moment, and needs no other directions before it.
    #[inline(always)]
    fn is_free(&self) -> bool {
        self.stepper.moment().wrapping_sub(self.free_from) as i32 >= 0 && self.directions == self.stepper.directions()
    }

    /// Plain ticks in a row; how many. None: there is no room.
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

    /// One event, or one tick without any.
    #[inline(never)]
    fn make_one(&mut self, may_begin: bool, onset: Onset) -> Made {
        let moment = self.stepper.moment();
        if self.output.free().words.is_empty() || self.is_marked_full() && self.output.ahead() > 0 {
            return Made::Nothing;
        }
        if onset == Onset::FromRest && self.stepper.is_moving() {
            // Nothing is put out before what follows has come: at rest there is time.
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
        // A tick without a step is no edge: it has its moment, whatever was before.
        let is_edge = self.one_by_one || self.stepper.steps_next();
        let at = if is_edge { self.soonest(later(moment, self.free_from)) } else { moment };
        // Put off, those after it come later by as much: were they to catch up, speeds would change at a stroke.
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
            // The beam goes off at once.
            self.begins.clear();
            self.beam.switch_off(&mut self.output);
        }
        Made::Last { underrun: tick.underrun }
    }

    /// The directions of the next steps, as an event of its own: after the pulse before, `$29` before the step.
    fn turn(&mut self) -> bool {
        self.directions = self.stepper.directions();
        self.output.direct(self.directions);
        let at = self.soonest(self.last.wrapping_add(self.timing.gap));
        let is_made = self.commit(0, at);
        self.free_from = self.last.wrapping_add(self.timing.setup);
        is_made
    }

    /// This moment, or the first that an event of its own can still have.
    fn soonest(&self, moment: u32) -> u32 {
        if self.one_by_one { later(moment, self.output.now().wrapping_add(StepPins::SOON)) } else { moment }
    }

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

    /// A segment has begun with the event at this moment.
    fn begin_segment(&mut self, at: u32, onset: Onset) {
        self.is_regular = !self.one_by_one && self.timing.is_regular(self.stepper.intervals());
        self.begins.push(at);
        if self.beam.segment(at, self.stepper.power()) && onset == Onset::Joined {
            self.beam.arm(&mut self.output);
        }
    }

    /// Until when the next tick can wait for the segment that it needs.
    fn last_chance(&self) -> u32 {
        let margin = if self.one_by_one { StepPins::SOON + BEGIN_TICKS } else { 2 * RUN_TICKS };
        self.output.joins_until(self.stepper.moment()).wrapping_sub(margin)
    }

    /// The next tick would be an underrun, and there is still time to wait.
    fn waits_for_segment(&self, onset: Onset) -> bool {
        let left = self.last_chance().wrapping_sub(self.output.now()) as i32;
        self.stepper.lacks_segment() && (left > 0 || onset == Onset::FromRest)
    }

    /// The next tick waits for a segment, and none has come.
    #[inline(always)]
    pub fn is_out_of_segments(&self) -> bool {
        self.stepper.lacks_segment() && self.segments.is_empty()
    }

    /// As many segments or changes of power are ahead as can be kept.
    fn is_marked_full(&self) -> bool {
        self.begins.is_full() || self.beam.is_full()
    }

    /// Less is ahead of a moment than there should be, and there is more to be made, and room for it.
    #[inline(always)]
    fn wants_more(&self, from: u32, ahead: usize) -> bool {
        let has_room = ahead + MOST_EVENTS <= StepPins::DEPTH;
        let is_stopped = self.one_by_one || self.is_out_of_segments() || self.is_marked_full();
        has_room && !is_stopped && !self.is_far_ahead(from)
    }

    /// While events are put out: when more are to be made. None: one is out by itself, which calls.
    #[inline(always)]
    pub fn moment_for_more(&self, now: u32) -> Option<u32> {
        let ahead = self.output.ahead();
        let left = (ahead / 2).max(LEAST_EVENTS - 1);
        if self.wants_more(now, ahead) {
            // A run has been too short for what there is, as where segments are shorter than runs.
            return Some(now);
        }
        if self.one_by_one {
            return (ahead == 0).then(|| self.last_chance());
        }
        if ahead <= left {
            return Some(self.last_chance());
        }
        // A run that begins a segment and turns makes fewer events than come out meanwhile: half of a ring may last too short.
        let early = sooner(self.output.moment_before(left), self.before_two_runs());
        Some(sooner(early, self.last_chance()))
    }

    /// Two runs and a pause before the end of what is ahead, but no sooner than there is room for a batch.
    #[inline(never)]
    fn before_two_runs(&self) -> u32 {
        later(
            self.output.moment_before(StepPins::DEPTH.saturating_sub(MOST_EVENTS)),
            self.last.wrapping_sub(IN_TIME_TICKS),
        )
    }

    /// When the last event is out, with its pulse.
    pub fn out_at(&self) -> u32 {
        self.last.wrapping_add(self.timing.pulse + OUT_TICKS)
    }
}
