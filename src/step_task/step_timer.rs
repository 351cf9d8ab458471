//! The step task. `Step` receives `segments` and `wiring` (each a `Receiver`), has the stepper make ticks ahead of
//! their `moment` (`make_batch`, `make_one`, `Made`; `SEGMENT_SHARE`, `LEAST_EVENTS`, `MOST_EVENTS`, `is_far_ahead`),
//! and commits them as events to the `StepPins`, its `output`, which calls it again (`call_at`, `next_call`,
//! `last_chance`, `sooner`, `later`, `joins_until`). Its `State` is Rest, Starting, Preparing, Running or Ending; it
//! can `put_off` a late event (`latest`, `soonest`, `free_from`), step `one_by_one`, `turn` directions, run dry
//! (`underrun`), `halt`, `take_back_segments` and the `net` steps `undone`, `break_off`, `give_up`, `stop`
//! (`stops_done`) or `resume`; `is_before_motion`, `come_to_rest` and `at_rest` tell of motion. `Begins` notes when
//! segments begin, `Beam` shows the laser's power at `marks`, `Unsent` keeps each `StepEvent`. `timing` (`StepTiming`)
//! is in ticks (`TICKS_PER_US`, `RUN_TICKS`).
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
//! Each run does, from top to bottom: take what it was called for, stop if asked, look at the probe, receive and make
//! events if it is time for them, say when to be called next, tell the other tasks.
//!
//! It promises: a stop that was asked for is obeyed before anything else in the same run, with an exact count; events that
//! come too late are put off, never lost, and those after them by as much, or motion ends with a report where motors would not
//! follow; a report to `control` is kept until it has been
//! sent. It leaves when and what to step to the stepper, and edges to the board.

use crate::boards::{
    AXES, COMBINATIONS, CORE_HZ, Due, Free, PROFILE, RUN_CYCLES, SecondMotor, StepOutput, StepPins, Undone,
};
use crate::shared::{self, Power, STEP, Wake};
use core::sync::atomic::Ordering;
use oxmill_controller::messages::{EVENTS_DEPTH, GangedMotors, SEGMENTS_DEPTH, StepEvent, ToStep, Wiring};
use oxmill_controller::{StepTiming, Stepper, later, sooner};
use rtic_sync::channel::{Receiver, Sender};

/// Step-clock ticks in a microsecond.
const TICKS_PER_US: u32 = PROFILE.step_clock_hz / 1_000_000;

/// Cycles of the core in step-clock ticks, rounded up.
const fn in_ticks(cycles: u32) -> u32 {
    cycles.div_ceil(CORE_HZ / 1_000_000 / TICKS_PER_US)
}

/// From the first segment after a rest to its first tick: the first segments of a hard start last some 50 us each, less than
/// it takes to prepare the next, so that some must be there before the first begins.
const START_TICKS: u32 = 2_000 * TICKS_PER_US;
/// How far ahead events are made, where there is room.
const HORIZON_TICKS: u32 = 300 * TICKS_PER_US;
/// How long before its first tick the events of a motion begin to be made: a hard start has so many segments that each of the
/// first runs begins one and makes few events.
const PREPARE_TICKS: u32 = 450 * TICKS_PER_US;
/// No fewer events than these are ahead, however long they last.
const LEAST_EVENTS: usize = 4;
/// Most events of a run: the longer it takes, the later everything else, a stop that comes by the serial line among it.
const MOST_EVENTS: usize = 32;
/// More than a run takes from its look at the time to its last event.
const RUN_TICKS: u32 = in_ticks(RUN_CYCLES);
/// More than it takes to begin.
const BEGIN_TICKS: u32 = in_ticks(1_500);
/// How long before the first moment events are begun at the latest: two more runs and what it takes.
const IN_TIME_TICKS: u32 = 2 * RUN_TICKS + BEGIN_TICKS + PAUSE_TICKS;
/// At the board's greatest rate half of a full ring is out before two runs are done.
const HALF_IS_SHORT: bool =
    PROFILE.step_clock_hz / PROFILE.rates.safe_hz * (StepPins::DEPTH as u32 / 2) < 2 * RUN_TICKS;
/// So much earlier from rest, for interrupts may be masked meanwhile.
const SPARE_TICKS: u32 = 100 * TICKS_PER_US;
/// As many events of a batch take as long as an event, or a tick, that is made by itself.
const SINGLE_SHARE: usize = 4;
/// The same of a segment that begins, with both of its messages. A run begins one at most.
const SEGMENT_SHARE: usize = 16;
/// From the end of a run to the next that it asks for at least: time for other tasks, of which a byte of the UART waits for 87 us
/// at most.
const PAUSE_TICKS: u32 = RUN_TICKS / 4;
/// How soon to try again to report to `control`, when nothing else calls.
const RETRY_TICKS: u32 = 1_000 * TICKS_PER_US;
/// From the last event of a motion to where it is seen that it is out, beside its pulse.
const OUT_TICKS: u32 = 2 * TICKS_PER_US;
/// A motion whose events came too late is resumed if its next tick is put off by no more than the time of so many steps: motors run
/// on meanwhile, and with eight microsteps or more to a full step they are not a full step ahead of the field then.
const MOST_LATE_STEPS: u32 = 8;
/// Directions that no output shows: the next tick writes them.
const UNKNOWN: u8 = u8::MAX;
/// Segments that can begin in events that are ahead, and changes of power.
const MARKS: usize = 32;

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

/// What a call of [`Step::make_one`] has made.
enum Made {
    /// There was nothing to make, or no room.
    Nothing,
    /// An event, or a tick without one.
    One,
    /// The tick that begins a segment.
    Segment,
}

impl Made {
    fn one(is_made: bool) -> Made {
        if is_made { Made::One } else { Made::Nothing }
    }
}

/// Everything the task owns.
pub struct Step {
    stepper: Stepper<AXES>,
    output: StepPins,
    state: State,
    timing: StepTiming,
    /// Ticks of the segment that runs can be put out as they are.
    is_regular: bool,
    one_by_one: bool,
    /// Moment of the event committed last.
    last: u32,
    /// No step before this moment.
    free_from: u32,
    /// The latest moment for the next tick of a motion whose events came too late; none: it begins at rest.
    latest: Option<u32>,
    /// The moment of the next call for more events.
    asked: u32,
    directions: u8,
    segments: Receiver<'static, ToStep, SEGMENTS_DEPTH>,
    wiring: Receiver<'static, Wiring, 2>,
    events: Sender<'static, StepEvent<AXES>, EVENTS_DEPTH>,
    unsent: Unsent,
    wake: Wake,
    begins: Begins,
    beam: Beam,
    /// The probe is active while its pin is high.
    probe_invert: bool,
    stops_done: u16,
}

/// Moments at which segments begin that are not out yet. Those that a motion begins with count from the moment it is put out: what
/// comes later does not find it still to be filled. A plain ring: less code than a deque.
struct Begins {
    moments: [u32; MARKS],
    first: usize,
    len: usize,
}

impl Begins {
    fn push(&mut self, moment: u32) {
        if self.len < MARKS
            && let Some(place) = self.moments.get_mut(self.first.wrapping_add(self.len) % MARKS)
        {
            *place = moment;
            self.len += 1;
        }
    }

    /// What has begun by now is no longer ahead.
    #[inline(always)]
    fn pass(&mut self, now: u32) {
        while self.len > 0
            && self.moments.get(self.first % MARKS).is_some_and(|moment| moment.wrapping_sub(now) as i32 <= 0)
        {
            self.first = self.first.wrapping_add(1);
            self.len -= 1;
        }
    }

    fn put_off(&mut self, by: u32) {
        for moment in &mut self.moments {
            *moment = moment.wrapping_add(by);
        }
    }
}

/// The power of a laser, which changes with the segment that it belongs to.
struct Beam {
    /// Changes that are ahead: moment and power.
    marks: heapless::Deque<(u32, u16), MARKS>,
    /// Of the segment that is out, and of the one that was made last.
    power: u16,
    made: u16,
    shown: u16,
    /// The first of the changes comes by itself, at its moment.
    armed: bool,
}

impl Beam {
    fn off(&mut self) {
        self.marks.clear();
        (self.power, self.made) = (0, 0);
    }
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
        output: StepPins,
        segments: Receiver<'static, ToStep, SEGMENTS_DEPTH>,
        wiring: Receiver<'static, Wiring, 2>,
        events: Sender<'static, StepEvent<AXES>, EVENTS_DEPTH>,
        wake: Wake,
    ) -> Step {
        Step {
            stepper: Stepper::new(),
            output,
            state: State::Rest,
            timing: StepTiming::new(TICKS_PER_US, 100, 0),
            is_regular: false,
            one_by_one: false,
            last: 0,
            free_from: 0,
            latest: None,
            asked: 0,
            directions: UNKNOWN,
            segments,
            wiring,
            events,
            unsent: Unsent { touched: false, underrun: None, stopped: None },
            wake,
            begins: Begins { moments: [0; MARKS], first: 0, len: 0 },
            beam: Beam { marks: heapless::Deque::new(), power: 0, made: 0, shown: 0, armed: false },
            probe_invert: false,
            stops_done: 0,
        }
    }

    /// Called when more events are wanted, when one is out, for a change of power, and by others: a stop asked for, a message
    /// queued, power changed.
    #[inline(never)]
    pub fn run(&mut self) {
        let due = self.output.take();
        self.begins.pass(self.output.now());
        if shared::stops_asked() != self.stops_done {
            self.stop();
        }
        if due.has(Due::MARK) && !matches!(self.state, State::Preparing(_)) {
            self.mark();
        }
        if due.has(Due::OUT) {
            self.look_at_probe();
        }
        match self.state {
            // Called before the time for more events: the pause after the last run is kept.
            State::Running | State::Preparing(_) if !self.one_by_one && !due.has(Due::MORE) => self.call_sooner(),
            State::Running => self.go_on(),
            State::Ending => self.end(),
            State::Preparing(moment) => self.begin(moment),
            State::Rest | State::Starting(_) => self.start(),
        }
        self.tell();
    }

    /// After a stop: what is still ahead does not begin.
    fn take_back_segments(&mut self) {
        self.stepper.take_back_segments(self.begins.len as u32);
        self.begins.len = 0;
    }

    /// Takes in what is there, as far as the stepper has room.
    #[inline(always)]
    fn receive(&mut self) {
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

    /// Nothing moves: time for new wiring, and for a start.
    #[inline(never)]
    fn start(&mut self) {
        self.receive();
        let now = self.output.now();
        match self.state {
            State::Starting(begin) if begin.wrapping_sub(now) as i32 <= PREPARE_TICKS as i32 => {
                self.free_from = begin;
                self.latest = None;
                self.prepare(begin);
            }
            State::Starting(_) => self.call_again(),
            _ => {
                while let Ok(wiring) = self.wiring.try_recv() {
                    self.wire(&wiring);
                }
                if !self.stepper.is_idle() {
                    let begin = now.wrapping_add(START_TICKS);
                    self.state = State::Starting(begin);
                    self.beam.off();
                    self.call_again();
                }
            }
        }
    }

    fn wire(&mut self, wiring: &Wiring) {
        let second = SecondMotor {
            axis: wiring.ganged,
            inverted: wiring.ganged_invert,
            stands: wiring.ganged_motors == GangedMotors::First,
            first_stands: wiring.ganged_motors == GangedMotors::Second,
        };
        self.output.set_polarity(wiring.step_invert, wiring.direction_invert, second);
        self.output.set_pulse(wiring.pulse_tenths);
        self.output.set_pwm(wiring.pwm_hz, self.beam.shown);
        self.directions = UNKNOWN;
        self.probe_invert = wiring.probe_invert;
        self.timing = StepTiming::new(TICKS_PER_US, wiring.pulse_tenths, u32::from(wiring.direction_setup_us));
    }

    /// Makes the first events, the next tick at this moment.
    fn prepare(&mut self, moment: u32) {
        self.stepper.begin_at(moment);
        self.last = moment.wrapping_sub(self.timing.gap);
        self.one_by_one = StepPins::DEPTH == 1 || self.stepper.is_watching();
        self.state = State::Preparing(moment);
        self.begin(moment);
    }

    /// Makes more of the first events; has them put out when there are enough, or no more time.
    #[inline(never)]
    fn begin(&mut self, moment: u32) {
        let before = self.output.ahead();
        if !self.one_by_one || before == 0 {
            self.make(moment);
        }
        let (ahead, now) = (self.output.ahead(), self.output.now());
        // The first event may come long after the first tick: it is the next tick that must not be late as long as there is none.
        let left = if ahead > 0 { moment } else { self.stepper.moment() }.wrapping_sub(now) as i32;
        let is_late = left <= IN_TIME_TICKS as i32;
        let is_time = left <= (IN_TIME_TICKS + SPARE_TICKS) as i32 && self.latest.is_none();
        let is_far = self.is_far_ahead(moment);
        let is_all = self.state == State::Ending;
        let is_full = self.output.free().words.is_empty();
        if ahead > 0 && (is_late || is_time || is_far || is_full || is_all || self.one_by_one) {
            self.state = if is_all { State::Ending } else { State::Running };
            if self.latest.is_none() {
                self.begins.len = 0;
            }
            let by = self.output.begin(self.one_by_one);
            self.put_off(moment, by);
            self.count_anew();
            self.arm();
        } else if is_late && !is_all {
            // Nothing is ahead yet: a little later there is, or once more segments have come.
            let waits = self.latest.is_none() && self.stepper.lacks_segment();
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
            return self.ran_dry();
        }
        if by == 0 {
            return;
        }
        self.stepper.begin_at(self.stepper.moment().wrapping_add(by));
        self.last = self.last.wrapping_add(by);
        self.free_from = self.free_from.wrapping_add(by);
        self.begins.put_off(by);
        for (at, _) in self.beam.marks.iter_mut() {
            *at = at.wrapping_add(by);
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
        if self.output.fault() {
            let Undone { net, .. } = self.halt();
            self.break_off(net, true);
            return self.call_again();
        }
        let now = self.output.now();
        let left = self.output.joins_until(self.stepper.moment()).wrapping_sub(now) as i32;
        if !self.one_by_one && (left < RUN_TICKS as i32 || self.stepper.is_watching()) {
            // Too late, or from here on to be put out one by one: what is ahead comes out first.
            self.state = State::Ending;
        } else {
            self.make(now);
            self.count_anew();
        }
        self.call_again();
    }

    /// Enough follows on what came too late: the next that does counts from there.
    #[inline(always)]
    fn count_anew(&mut self) {
        if self.output.ahead() >= LEAST_EVENTS {
            self.latest = None;
        }
    }

    /// No more events, and no beam.
    #[inline(always)]
    fn halt(&mut self) -> Undone<AXES> {
        self.output.halt(Power::wanted().from_segments || self.beam.armed)
    }

    /// In the middle of a motion: no more of it.
    #[cold]
    fn break_off(&mut self, undone: [i32; AXES], miscounted: bool) {
        self.give_up(undone, miscounted);
        self.last = self.output.now();
        self.state = State::Ending;
    }

    /// The motion is over: for want of events in time, or because what has come out is not what was made.
    #[cold]
    fn give_up(&mut self, undone: [i32; AXES], miscounted: bool) {
        self.take_back_segments();
        if self.unsent.underrun.is_some() {
            // What has not been told yet counts as one stop with it.
            self.stepper.take_back(undone);
        } else {
            let _ = self.stepper.stop(undone);
        }
        self.unsent.underrun = Some(match self.stepper.underrun_event() {
            StepEvent::Underrun { stops, position } if miscounted => StepEvent::Miscounted { stops, position },
            event => event,
        });
        self.directions = UNKNOWN;
        self.beam_off();
    }

    /// No power from segments, at once and until the controller asks for some.
    fn beam_off(&mut self) {
        self.beam.off();
        let power = Power::wanted();
        if power.from_segments {
            Power { level: 0, ..power }.want();
        }
        if power.from_segments || self.beam.armed {
            self.set_power(0);
        }
    }

    /// Power from now on to the next change, if one is ahead.
    #[inline(never)]
    fn set_power(&mut self, level: u16) {
        self.output.set_power(level);
        self.beam.shown = level;
        self.beam.armed = false;
        self.arm();
    }

    /// The next change of power comes by itself; it is only noted at its moment if power does not come from segments. What may still be
    /// put off waits until it is known when it comes.
    #[inline(never)]
    fn arm(&mut self) {
        if let Some((at, power)) = self.beam.marks.front().copied()
            && !matches!(self.state, State::Preparing(_))
        {
            self.beam.armed = Power::wanted().from_segments;
            self.output.mark_at(at, self.beam.armed.then_some(power));
        }
    }

    /// Makes events until enough of them are ahead of a moment.
    #[inline(never)]
    fn make(&mut self, from: u32) {
        // Not those places that become free meanwhile: they come one by one.
        let most = StepPins::DEPTH.saturating_sub(self.output.ahead()).min(MOST_EVENTS);
        let (mut room, mut has_begun) = (most, false);
        while room > 0 && !self.is_far_ahead(from) {
            if self.stepper.has_plain() && self.is_regular && self.is_free() {
                room = room.saturating_sub(self.make_batch(room));
                continue;
            }
            let may_begin = !has_begun && (room >= SEGMENT_SHARE || room == most);
            match self.make_one(may_begin) {
                Made::Nothing => return,
                Made::One => room = room.saturating_sub(SINGLE_SHARE),
                Made::Segment => {
                    room = room.saturating_sub(SEGMENT_SHARE);
                    has_begun = true;
                }
            }
            if self.one_by_one {
                return;
            }
        }
    }

    /// Whether what is ahead of a moment is enough: counted to where the next event must be there at the latest.
    #[inline(always)]
    fn is_far_ahead(&self, from: u32) -> bool {
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
    fn make_one(&mut self, may_begin: bool) -> Made {
        let moment = self.stepper.moment();
        if self.output.free().words.is_empty() || self.is_marked_full() && self.output.ahead() > 0 {
            return Made::Nothing;
        }
        if self.is_before_motion() && self.stepper.is_moving() {
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
        if self.stepper.is_idle() || self.waits_for_segment() {
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
            self.begin_segment(if is_out { self.last } else { at });
            return Made::Segment;
        }
        if tick.interval == 0 {
            self.come_to_rest(tick.underrun);
        }
        Made::One
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

    /// Nothing has come out of the motion yet, which begins at rest.
    fn is_before_motion(&self) -> bool {
        self.latest.is_none() && matches!(self.state, State::Starting(_) | State::Preparing(_))
    }

    /// Until when the next tick can wait for the segment that it needs.
    fn last_chance(&self) -> u32 {
        let margin = if self.one_by_one { StepPins::SOON + BEGIN_TICKS } else { 2 * RUN_TICKS };
        self.output.joins_until(self.stepper.moment()).wrapping_sub(margin)
    }

    /// The next tick would be an underrun, and there is still time to wait.
    fn waits_for_segment(&self) -> bool {
        let left = self.last_chance().wrapping_sub(self.output.now()) as i32;
        self.stepper.lacks_segment() && (left > 0 || self.is_before_motion())
    }

    /// A segment has begun with the event at this moment.
    fn begin_segment(&mut self, at: u32) {
        self.is_regular = !self.one_by_one && self.timing.is_regular(self.stepper.intervals());
        self.begins.push(at);
        let power = self.stepper.power();
        if power == self.beam.made {
            return;
        }
        if self.beam.marks.is_full() {
            // Without an event in between no power but the last would be seen.
            self.beam.marks.pop_back();
        }
        if self.beam.marks.push_back((at, power)).is_ok() {
            self.beam.made = power;
            if self.beam.marks.len() == 1 {
                self.arm();
            }
        }
    }

    /// The stepper has nothing more to do.
    fn come_to_rest(&mut self, underrun: bool) {
        if underrun {
            self.unsent.underrun = Some(self.stepper.underrun_event());
            // The place is that after what is ahead, which comes out.
            self.begins.len = 0;
            // The beam goes off at once.
            self.beam_off();
        }
        self.state = State::Ending;
    }

    /// Says when to be called next, if no other task calls before.
    #[inline(never)]
    fn call_again(&mut self) {
        if let Some(at) = self.next_call() {
            self.asked = at;
            self.output.call_at(at);
        }
    }

    /// The same, unless that is later than what has been asked for already.
    #[inline(never)]
    fn call_sooner(&mut self) {
        if let Some(at) = self.next_call()
            && (at.wrapping_sub(self.asked) as i32) < 0
        {
            self.asked = at;
            self.output.call_at(at);
        }
    }

    #[inline(always)]
    fn next_call(&self) -> Option<u32> {
        let ahead = self.output.ahead();
        let left = (ahead / 2).max(LEAST_EVENTS - 1);
        let now = self.output.now();
        let at = match self.state {
            // A run has been too short for what there is, as where segments are shorter than runs.
            State::Running if self.wants_more(now, ahead) => now,
            State::Running if !self.one_by_one && ahead > left => {
                let half = self.output.moment_before(left);
                let early = if HALF_IS_SHORT { sooner(half, self.before_two_runs()) } else { half };
                sooner(early, self.last_chance())
            }
            State::Running if self.one_by_one && ahead > 0 => return None,
            State::Running => self.last_chance(),
            State::Ending => self.out_at(),
            State::Preparing(moment) => moment.wrapping_sub(PREPARE_TICKS),
            State::Starting(begin) => begin.wrapping_sub(PREPARE_TICKS),
            State::Rest => return None,
        };
        Some(later(at, now.wrapping_add(PAUSE_TICKS)))
    }

    /// Two runs before the end of what is ahead, but no sooner than there is room for a batch.
    #[inline(never)]
    fn before_two_runs(&self) -> u32 {
        later(
            self.output.moment_before(StepPins::DEPTH.saturating_sub(MOST_EVENTS)),
            self.last.wrapping_sub(IN_TIME_TICKS),
        )
    }

    /// As many segments or changes of power are ahead as can be kept in mind.
    fn is_marked_full(&self) -> bool {
        self.begins.len == MARKS || self.beam.marks.is_full()
    }

    /// Less is ahead of a moment than there should be, and there is more to be made, and room for it.
    fn wants_more(&self, from: u32, ahead: usize) -> bool {
        let has_room = ahead + MOST_EVENTS <= StepPins::DEPTH;
        let is_stopped =
            self.one_by_one || self.stepper.lacks_segment() && self.segments.is_empty() || self.is_marked_full();
        has_room && !is_stopped && !self.is_far_ahead(from)
    }

    /// When the last event is out, with its pulse.
    fn out_at(&self) -> u32 {
        self.last.wrapping_add(self.timing.pulse + OUT_TICKS)
    }

    /// The last event is out: rest, or what was too late is begun again.
    #[inline(never)]
    fn end(&mut self) {
        if (self.out_at().wrapping_sub(self.output.now()) as i32) > 0 {
            self.output.call_at(self.out_at());
            return;
        }
        let Undone { events, net, fault } = self.output.halt(false);
        self.beam.marks.clear();
        if self.beam.armed {
            // Whether it has come is not known.
            self.set_power(0);
        }
        if events > 0 || fault {
            self.give_up(net, true);
        }
        self.receive();
        if self.stepper.is_moving() {
            self.resume();
        } else {
            self.state = State::Rest;
            self.begins.len = 0;
            self.start();
        }
    }

    /// What was too late to follow is begun again: not before its time, and no step before the set-up of its directions is over.
    #[cold]
    fn resume(&mut self) {
        let planned = self.stepper.moment();
        // If few events follow and the next are too late again, it all counts from here.
        let latest = planned.wrapping_add(MOST_LATE_STEPS.wrapping_mul(self.stepper.step_interval()));
        self.latest = Some(self.latest.unwrap_or(latest));
        // Time for one more run than it takes at least.
        let soon = IN_TIME_TICKS + RUN_TICKS + PAUSE_TICKS;
        let moment = later(planned, self.output.now().wrapping_add(soon));
        // The beam is off until then.
        self.beam.power = 0;
        let _ = self.beam.marks.push_back((moment, self.beam.made));
        self.prepare(moment);
    }

    /// No more pulses, beam off, everything queued is void.
    #[cold]
    fn stop(&mut self) {
        let undone = self.halt();
        let mut net = undone.net;
        // What has not come out at all has moved nothing.
        let is_still = self.is_before_motion() && !undone.fault;
        self.beam_off();
        if undone.fault {
            // Whatever the stop is for, the place is lost: a stop of its own, before it.
            self.give_up(core::mem::take(&mut net), true);
        }
        self.take_back_segments();
        while shared::stops_asked() != self.stops_done {
            self.stops_done = self.stops_done.wrapping_add(1);
            let mut event = self.stepper.stop(core::mem::take(&mut net));
            if let StepEvent::Stopped { moving, .. } = &mut event {
                // Without a count that can be trusted the place is as lost as in motion.
                *moving = !is_still && (*moving || undone.events > 0 || undone.fault);
                // The newest counts; that something was moving at an older one must not be forgotten.
                if let Some(StepEvent::Stopped { moving: before, .. }) = self.unsent.stopped {
                    *moving |= before;
                }
            }
            self.unsent.stopped = Some(event);
        }
        // A pulse that is out has been counted: it gets its full length.
        self.directions = UNKNOWN;
        self.last = self.output.now();
        self.state = State::Ending;
        self.call_again();
    }

    /// The moment of a change of power has come, and maybe that of others, which come late.
    #[inline(never)]
    fn mark(&mut self) {
        let before = self.beam.marks.len();
        while let Some((at, power)) = self.beam.marks.front().copied()
            && at.wrapping_sub(self.output.now()) as i32 <= 0
        {
            self.beam.power = power;
            self.beam.marks.pop_front();
        }
        if self.beam.marks.len() < before && Power::wanted().from_segments {
            // Once more what has come by itself: if it has not, for whatever reason, it comes now.
            self.set_power(self.beam.power);
        } else {
            self.arm();
        }
    }

    /// An event is out, one by one.
    #[inline(never)]
    fn look_at_probe(&mut self) {
        if self.stepper.is_watching() && self.stepper.probe(self.output.probe_low() != self.probe_invert) {
            self.unsent.touched = true;
        }
    }

    /// Lets the other tasks know how it goes.
    #[inline(always)]
    fn tell(&mut self) {
        let begun = self.stepper.segments_begun().wrapping_sub(self.begins.len as u32);
        STEP.segments_begun.store(begun, Ordering::Relaxed);
        STEP.wants.store(u8::from(self.stepper.wants()), Ordering::Relaxed);
        self.show_power();
        let at_rest = self.state == State::Rest;
        if at_rest != STEP.at_rest.load(Ordering::Relaxed) {
            self.tell_of_rest(at_rest);
        }
        if self.unsent.any() {
            self.send_all();
        }
    }

    #[inline(never)]
    fn tell_of_rest(&mut self, at_rest: bool) {
        STEP.at_rest.store(at_rest, Ordering::Relaxed);
        if at_rest {
            self.wake.write(());
        }
    }

    /// Shows the power that holds now, if it is another one.
    #[inline(always)]
    fn show_power(&mut self) {
        let power = Power::wanted();
        let level = match (power.from_segments, self.state) {
            // After a stop or underrun the beam stays off, whatever was wanted before.
            (true, State::Rest | State::Ending) if self.stepper.is_shut() => 0,
            (true, State::Rest) | (false, _) => power.level,
            _ => self.beam.power,
        };
        if level != self.beam.shown || self.beam.armed && !power.from_segments {
            self.set_power(level);
        }
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
        if self.unsent.any() && self.state == State::Rest {
            self.output.call_at(self.output.now().wrapping_add(RETRY_TICKS));
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
