//! A checked line of G-code is carried out, step by step: wait for the end of motion where the line needs it, outputs,
//! dwell, stored record, motion, program flow, answer. Each step is one short call; what waits is data in [`Task`].

use super::Controller;
use super::converse::Listing;
use super::cycles::{HomingWait, Probing};
use crate::axes::{Arrangement, PerAxis};
use crate::error::{Alarm, Error};
use crate::gcode::{self, ArcMove, Dialect, Feed, Flow};
use crate::machine::homing::Homing;
use crate::machine::realtime_override::Overrides;
use crate::machine::state::Mode;
use crate::messages::{Coolant, SpindleDirection};
use crate::motion::{Arc, ArcGeometry, Move, Speed, extent};
use crate::protocol::report;
use crate::settings::{AxisKey, Key};
use crate::units::{Coordinate, Duration, Instant};

/// What the controller is in the middle of. While there is one, no further line is taken.
#[derive(Debug)]
#[allow(clippy::large_enum_variant, reason = "there is one, in a static place; boxes do not exist here")]
#[derive(Clone)]
pub(super) enum Task<const N: usize> {
    /// Nothing: the next line may come.
    None,
    /// The startup line of this number is next; when all have been run, someone may get an answer.
    Startup(usize, Option<Answer>),
    /// An answer of many lines; the number is the next of them.
    Listing(Listing, usize),
    /// A record is being stored; then the answer is given.
    Storing(Answer),
    /// Motion has to end before the soft-limit alarm.
    SoftLimit,
    /// The homing cycle.
    Homing(Homing<N>, HomingWait),
    /// A jog whose text stands in the controller's line waits for the cancelled one before it to stop.
    JogWaits,
    /// A line of G-code, which stands in the controller's `checked`.
    Job(Job),
}

/// Who is waiting for `ok`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Answer {
    /// The host.
    Host,
    /// A startup line that is being run; `.1` says whether the host waits for the last of them.
    Startup(usize, bool),
    /// The host, for a startup line that is stored once it has been run without error; its text waits in the controller.
    Validation(usize),
    /// The host, for the setting of this number.
    Setting(u16),
    /// The host, and then the controller starts anew (`$RST`).
    Restart,
}

/// A line under way.
#[derive(Clone, Copy, Debug)]
pub(super) struct Job {
    answer: Answer,
    stage: Stage,
    jog: bool,
    /// How long the spindle takes to turn, or to stand, after this line has switched it.
    spindle_delay: Duration,
}

#[derive(Clone, Copy, Debug)]
#[repr(u8)]
enum Stage {
    /// Motion that was queued before has to end first.
    Drain,
    /// New modal state, spindle, coolant.
    Apply,
    /// A changed coordinate system is being stored.
    Storing,
    /// G4 until a moment.
    Dwell(Instant),
    /// Spindle on: it has turned long enough at this moment, and tells that it is up to speed.
    SpinningUp(Instant),
    /// G4 with this much left when the hold ends.
    DwellSuspended(Duration),
    /// G28, G30: the intermediate point.
    Via,
    /// The motion itself.
    Target,
    /// The probe moves.
    Probing,
    /// Chords of the controller's arc that are still to come, at this feed.
    Chords(f32),
    /// Motion has to end before the program pauses or ends.
    Flow,
    /// Paused: ends with `~`.
    Paused,
    /// To be answered.
    Done,
}

impl<const N: usize> Task<N> {
    pub(super) fn is_none(&self) -> bool {
        matches!(self, Task::None)
    }

    /// Whether a reset owes the host an `ok` for it.
    pub(super) fn answers_host(&self) -> bool {
        match self {
            Task::Job(Job { answer, .. }) | Task::Storing(answer) => !matches!(answer, Answer::Startup(_, false)),
            Task::Listing(..) | Task::SoftLimit | Task::Homing(..) | Task::JogWaits => true,
            Task::Startup(_, answer) => answer.is_some(),
            Task::None => false,
        }
    }

    /// `late`: when a spindle is too late that should have turned long enough at a moment.
    pub(super) fn wakeup(&self, late: impl Fn(Instant) -> Instant) -> Option<Instant> {
        match self {
            Task::Job(Job { stage: Stage::SpinningUp(until), .. }) => Some(late(*until)),
            Task::Job(Job { stage: Stage::Dwell(until), .. }) | Task::Homing(_, HomingWait::Until(until)) => {
                Some(*until)
            }
            _ => None,
        }
    }

    /// A hold stops the clock of a dwell.
    pub(super) fn suspend(&mut self, now: Instant) {
        if let Task::Job(job) = self
            && let Stage::Dwell(until) = job.stage
        {
            let left = until.checked_duration_since(now).unwrap_or(Duration::from_ticks(0));
            job.stage = Stage::DwellSuspended(left);
        }
    }

    pub(super) fn resume(&mut self, now: Instant) {
        if let Task::Job(job) = self
            && let Stage::DwellSuspended(left) = job.stage
        {
            job.stage = Stage::Dwell(now + left);
        }
    }

    /// What was under way cannot be carried out any more. Whether the host waits for an answer.
    pub(super) fn abandon(&mut self) -> bool {
        let answers = self.answers_host();
        *self = Task::None;
        answers
    }

    /// A jog that waits for room is not carried out any more; its answer is still given.
    pub(super) fn forget_jog(&mut self) {
        if let Task::Job(job) = self
            && job.jog
        {
            job.stage = Stage::Done;
        }
    }
}

impl<const N: usize, const BLOCKS: usize> Controller<N, BLOCKS> {
    /// The checked line begins. Jogs have been allowed by the caller.
    pub(super) fn begin(&mut self, answer: Answer, jog: bool) {
        let checked = &self.checked;
        let checking = self.mode == Mode::Check;
        let drain = !checking
            && (checked.spindle.is_some()
                || checked.coolant.is_some()
                || checked.dwell.is_some()
                || checked.work_offset_changed
                || checked.store.is_some()
                || matches!(checked.motion, gcode::Motion::Probe { .. })
                || self.speed_needs_rest());
        let stage = if drain { Stage::Drain } else { Stage::Apply };
        self.task = Task::Job(Job { answer, stage, jog, spindle_delay: Duration::from_ticks(0) });
    }

    /// S rides with the motion. Only a laser without a motion to ride with changes its power at rest.
    fn speed_needs_rest(&self) -> bool {
        self.settings.is_on(Key::Laser) && self.shows_speed()
    }

    /// Whether the accessories are reported anew because of S.
    fn shows_speed(&self) -> bool {
        self.checked.speed_changed
            && self.spindle != SpindleDirection::Off
            && !(self.settings.is_on(Key::Laser) && self.checked.motion != gcode::Motion::None)
    }

    /// Does one bounded piece of the task. Whether something was done.
    #[inline(never)]
    pub(super) fn go_on(&mut self) -> bool {
        if self.task.is_none() || self.stop.awaited.is_some() {
            return false;
        }
        if let Task::Listing(listing, line) = self.task {
            return self.go_on_listing(listing, line);
        }
        if self.mode.is_suspended() {
            return false;
        }
        if let Task::Job(mut job) = self.task {
            self.task = Task::None;
            let progressed = self.go_on_job(&mut job);
            match job.stage {
                Stage::Done if progressed => self.finish(job.answer),
                _ => self.task = Task::Job(job),
            }
            return progressed;
        }
        match core::mem::replace(&mut self.task, Task::None) {
            Task::Startup(index, then) if self.has_sensed => {
                self.run_startup_line(index, then);
                true
            }
            Task::Homing(homing, wait) => self.go_on_homing(homing, wait),
            Task::JogWaits if self.mode != (Mode::Jog { cancelling: true }) => {
                self.begin_waiting_jog();
                true
            }
            Task::SoftLimit if self.motion.is_at_rest() => {
                self.motion.discard();
                self.interpreter.set_position(self.motion.machine_position());
                self.task = Task::SoftLimit;
                self.running = false;
                self.spindle = SpindleDirection::Off;
                self.coolant = Coolant::default();
                self.raise(Alarm::SoftLimit);
                self.say(|out| report::message(out, "Reset to continue"));
                self.mode = Mode::Critical;
                true
            }
            Task::Storing(answer) if self.unstored == 0 => {
                if core::mem::take(&mut self.store_failed) {
                    self.say(|out| report::message(out, "The setting holds but could not be stored"));
                }
                self.finish(answer);
                true
            }
            other => {
                self.task = other;
                false
            }
        }
    }

    /// Goes on until something has to be waited for or put out first.
    fn go_on_job(&mut self, job: &mut Job) -> bool {
        let checking = self.mode == Mode::Check;
        let mut progressed = false;
        loop {
            let next = match job.stage {
                Stage::Drain if self.motion.is_idle() => Some(Stage::Apply),
                Stage::Drain => {
                    self.start_queued();
                    None
                }
                Stage::Apply => {
                    job.spindle_delay = self.apply(checking);
                    Some(Stage::Storing)
                }
                Stage::Storing if self.unstored > 0 => None,
                Stage::Storing => {
                    let dwell = self.checked.dwell.filter(|_| !checking).unwrap_or(Duration::from_ticks(0));
                    let wait = dwell + job.spindle_delay;
                    Some(if self.must_tell_speed() && self.checked.spindle.is_some() && !checking {
                        Stage::SpinningUp(self.now + wait)
                    } else if wait.is_zero() {
                        Stage::Via
                    } else {
                        Stage::Dwell(self.now + wait)
                    })
                }
                Stage::Dwell(until) => (self.now >= until).then_some(Stage::Via),
                Stage::SpinningUp(until) => self.has_spun_up(until).then_some(Stage::Via),
                Stage::Via => match self.checked.motion {
                    gcode::Motion::Line { via: Some(via), .. } if !checking => {
                        self.queue(&via, Speed::Rapid, job).then_some(Stage::Target)
                    }
                    _ => Some(Stage::Target),
                },
                Stage::Target if checking => Some(Stage::Flow),
                Stage::Target => match self.checked.motion {
                    gcode::Motion::Line { target, feed, .. } => {
                        self.queue(&target, speed(feed), job).then_some(Stage::Flow)
                    }
                    gcode::Motion::Arc(ref arc) => {
                        let (geometry, feed) = (geometry(arc), arc.feed);
                        Some(self.begin_arc(&geometry, feed))
                    }
                    gcode::Motion::Probe { target, feed, away, .. } => {
                        if self.begin_probe(&target, speed(feed), away, self.checked.line_number) {
                            self.probing = Some(Probing::Seeking);
                            Some(Stage::Probing)
                        } else {
                            Some(Stage::Done)
                        }
                    }
                    gcode::Motion::None => Some(Stage::Flow),
                },
                Stage::Chords(_) if self.motion.free_blocks() == 0 => {
                    self.start_queued();
                    None
                }
                Stage::Chords(feed) => match self.arc.as_mut().and_then(Arc::next_chord) {
                    Some(target) => {
                        let mv = self.move_of(&target, Speed::Feed(feed), job.jog);
                        if let Some(arc) = &self.arc {
                            // There is room for a block, so the move is taken.
                            self.motion.chord(&mv, arc);
                        }
                        return true;
                    }
                    None => Some(Stage::Flow),
                },
                Stage::Probing => {
                    let must_touch = matches!(self.checked.motion, gcode::Motion::Probe { alarm: true, .. });
                    // A failed probe has locked the machine: no M0 may open it again.
                    self.end_probe(must_touch).then_some(if self.mode.is_alarm() { Stage::Done } else { Stage::Flow })
                }
                Stage::Flow => self.flow(checking),
                Stage::Paused => Some(Stage::Done),
                Stage::DwellSuspended(_) => None,
                Stage::Done => return true,
            };
            let Some(next) = next else { break };
            progressed = true;
            let shown_first = match job.stage {
                Stage::Apply => self.checked.changes_outputs(),
                Stage::Via => matches!(self.checked.motion, gcode::Motion::Line { via: Some(_), .. }),
                Stage::Drain | Stage::Probing => true,
                _ => false,
            };
            job.stage = next;
            if shown_first || self.mode.is_suspended() || self.stop.awaited.is_some() {
                break;
            }
        }
        progressed
    }

    /// Takes the line's modal state over and sets what does not move. How long the spindle then takes.
    fn apply(&mut self, checking: bool) -> Duration {
        let checked = &self.checked;
        let mut delay = Duration::from_ticks(0);
        let before = checked.work_offset_changed.then(|| self.interpreter.work_offset());
        self.interpreter.commit(checked);
        if before.is_some_and(|before| self.interpreter.work_offset() != before) {
            self.rare_fields.offset_changed();
        }
        if let Some(offset) = checked.store {
            self.store_offset(offset);
        }
        if checking {
            return delay;
        }
        self.spindle_speed = self.checked.speed;
        if self.shows_speed() {
            self.rare_fields.overrides_changed();
        }
        if let Some(spindle) = self.checked.spindle {
            if spindle != self.spindle && !self.settings.is_on(Key::Laser) {
                let off = spindle == SpindleDirection::Off;
                delay = self.settings.seconds(if off { Key::SpinDown } else { Key::SpinUp });
            }
            self.spindle = spindle;
            self.rare_fields.overrides_changed();
        }
        if let Some(coolant) = self.checked.coolant {
            self.coolant = coolant;
            self.rare_fields.overrides_changed();
        }
        delay
    }

    /// Program pause and end: both wait for the end of motion.
    fn flow(&mut self, checking: bool) -> Option<Stage> {
        match self.checked.flow {
            Flow::None | Flow::OptionalPause => Some(Stage::Done),
            Flow::Pause if checking => Some(Stage::Done),
            Flow::Pause | Flow::End if !self.motion.is_idle() => {
                self.start_queued();
                None
            }
            Flow::Pause => {
                self.mode = Mode::Hold;
                self.darken_laser();
                Some(Stage::Paused)
            }
            Flow::End => {
                self.rare_fields.offset_changed();
                if !checking {
                    self.spindle = SpindleDirection::Off;
                    self.coolant = Coolant::default();
                    self.overrides = Overrides::default();
                    self.motion.set_overrides(1.0, 1.0);
                    self.rare_fields.overrides_changed();
                }
                self.say(|out| report::message(out, "Pgm End"));
                Some(Stage::Done)
            }
        }
    }

    /// The look-ahead is full, or the line has to wait for its end: what is queued must move.
    fn start_queued(&mut self) {
        if !self.running && !self.motion.is_idle() {
            self.start_motion();
        }
    }

    fn queue(&mut self, target: &PerAxis<Coordinate, N>, speed: Speed, job: &Job) -> bool {
        let mv = self.move_of(target, speed, job.jog);
        let taken = self.motion.line(&mv);
        if !taken {
            self.start_queued();
        } else if job.jog {
            self.mode = Mode::Jog { cancelling: false };
            self.start_motion();
        } else if self.motion.has_joined_enough() {
            self.start_queued();
        }
        taken
    }

    fn move_of(&self, target: &PerAxis<Coordinate, N>, speed: Speed, jog: bool) -> Move<N> {
        let laser = self.settings.is_on(Key::Laser);
        // A laser burns in feed motions only.
        let dark = laser && speed == Speed::Rapid;
        let power = if self.spindle == SpindleDirection::Off || dark {
            0
        } else {
            // The override is applied when its turn comes (`outputs`).
            self.spindle_range().output(self.checked.speed, 100).0
        };
        Move {
            target: *target,
            speed,
            power,
            scale_power: laser && self.spindle == SpindleDirection::CounterClockwise,
            line_number: self.checked.line_number,
            no_feed_override: jog,
            digit: self.checked.digit,
        }
    }

    fn begin_arc(&mut self, geometry: &ArcGeometry<N>, feed: Feed) -> Stage {
        let chords = Arc::new(geometry, self.settings.value(Key::ArcTolerance));
        let feed = match feed {
            Feed::PerMinute(feed) => feed,
            Feed::InverseTime(seconds) => chords.length() / seconds,
            Feed::Rapid => f32::MAX,
        };
        self.arc = Some(chords);
        Stage::Chords(feed)
    }

    /// Why the line may not be carried out though it is correct, if so.
    pub(super) fn refuse_line(&mut self) -> Option<Error> {
        if self.checked.motion != gcode::Motion::None
            && let Some(error) = self.motion_locked()
        {
            return Some(error);
        }
        if self.checked.uses_machine_place && self.must_home_first() {
            self.say(|out| report::message(out, "Home first: the machine position is not known"));
            return Some(Error::Locked);
        }
        self.leaves_range().then_some(Error::InvalidTarget)
    }

    /// Whether the motion leads where the controller does not compute any more: an arc bulges beyond its ends, and with
    /// belts (CoreXY) X and Y together are the way of a motor.
    #[inline(never)]
    fn leaves_range(&self) -> bool {
        let belts = self.settings.arrangement() == Arrangement::CoreXy;
        let outside = |place: &PerAxis<Coordinate, N>| {
            let sum = match place.0.as_slice() {
                [x, y, ..] if belts => x.0.saturating_abs().saturating_add(y.0.saturating_abs()),
                _ => 0,
            };
            sum > Coordinate::LIMIT.0 || !place.iter().all(|coordinate| coordinate.in_range())
        };
        match &self.checked.motion {
            gcode::Motion::Arc(arc) => {
                let wide = arc.i.0.unsigned_abs().max(arc.j.0.unsigned_abs()) > Coordinate::LIMIT.0.unsigned_abs() / 8;
                let near = |place: &PerAxis<Coordinate, N>| {
                    place.iter().all(|coordinate| coordinate.0.unsigned_abs() < Coordinate::LIMIT.0.unsigned_abs() / 8)
                };
                if !wide && near(&arc.start) && near(&arc.target) {
                    return false;
                }
                let (least, greatest) = extent(&geometry(arc));
                let farthest = least.zip(&greatest, |a, b| Coordinate(a.0.saturating_abs().max(b.0.saturating_abs())));
                outside(&farthest)
            }
            gcode::Motion::Line { via, target, .. } if belts => via.as_ref().is_some_and(outside) || outside(target),
            gcode::Motion::Probe { target, .. } if belts => outside(target),
            _ => false,
        }
    }

    /// Lets a jog end where the travel does. An axis that is outside already goes no further out.
    pub(super) fn clip_to_travel(&mut self) {
        if let gcode::Motion::Line { target, .. } = &self.checked.motion
            && self.limits_travel()
        {
            let travel = self.settings.axes(AxisKey::Travel).0.map(|mm| -Coordinate::from_mm_f32(mm));
            let ends = self.interpreter.position().zip(&PerAxis(travel), |here, end| (here.min(end), here));
            let within = |place: Coordinate, (least, here): (Coordinate, Coordinate)| {
                place.clamp(least, here.max(Coordinate::ZERO))
            };
            let end = target.zip(&ends, within);
            self.checked.redirect(end);
        }
    }

    /// Whether soft limits are in force. Without a true position there is nothing to compare with.
    fn limits_travel(&self) -> bool {
        self.settings.is_on(Key::SoftLimits) && !self.must_home_first()
    }

    /// The setting that allows no motion at all.
    #[inline]
    fn locking_setting(&mut self) -> Option<u16> {
        let (settings, profile) = (&self.settings, &self.profile);
        let unrunnable = || settings.unrunnable(profile.rates, profile.has_second_motor);
        self.settings_lock.setting(settings.revision(), unrunnable)
    }

    /// Whether the settings, or what has become of them, allow no motion at all; then the host has been told why.
    pub(super) fn motion_locked(&mut self) -> Option<Error> {
        if self.is_store_damaged() {
            self.tell_damage();
            return Some(Error::StoreReadFailed);
        }
        self.locking_setting()?;
        if let Some(setting) = self.settings_lock.name_at_line() {
            self.name_locking(setting);
        }
        Some(Error::Locked)
    }

    /// Grbl answers a change with `ok` and nothing else: in its dialect the setting is named at the first move.
    fn name_after_change(&mut self, changed: u16) {
        self.locking_setting();
        if let Some(setting) = self.settings_lock.name_after_change(changed)
            && self.dialect() != Dialect::Grbl
        {
            self.name_locking(setting);
        }
    }

    #[inline(never)]
    fn name_locking(&mut self, setting: u16) {
        self.say(|out| report::message_number(out, "Motion is locked until this setting is mended: $", setting.into()));
    }

    /// Whether any part of the line's motion lies outside of the travel, with soft limits on.
    pub(super) fn leaves_travel(&self) -> bool {
        if !self.limits_travel() {
            return false;
        }
        let travel = self.settings.axes(AxisKey::Travel);
        let outside = |place: &PerAxis<Coordinate, N>| {
            place
                .zip(&travel, |p, t| p > Coordinate::ZERO || p < -Coordinate::from_mm_f32(t))
                .iter()
                .any(|outside| *outside)
        };
        match &self.checked.motion {
            gcode::Motion::None => false,
            gcode::Motion::Line { via, target, .. } => via.as_ref().is_some_and(outside) || outside(target),
            gcode::Motion::Arc(arc) => {
                let (least, greatest) = extent(&geometry(arc));
                outside(&least) || outside(&greatest)
            }
            gcode::Motion::Probe { target, .. } => outside(target),
        }
    }

    /// Answers a line that has been carried out.
    pub(super) fn finish(&mut self, answer: Answer) {
        self.task = Task::None;
        match answer {
            Answer::Host => self.say(report::ok),
            Answer::Startup(index, host_waits) => {
                self.say(report::ok);
                self.task = Task::Startup(index + 1, host_waits.then_some(Answer::Host));
            }
            Answer::Validation(index) => {
                let line = self.validated.clone();
                self.store_startup_line(index, line);
            }
            Answer::Setting(number) => {
                self.say(report::ok);
                self.name_after_change(number);
            }
            Answer::Restart => {
                self.say(report::ok);
                self.initialise();
            }
        }
    }
}

fn geometry<const N: usize>(arc: &ArcMove<N>) -> ArcGeometry<N> {
    ArcGeometry {
        start: arc.start,
        target: arc.target,
        axis_0: arc.axes.first,
        axis_1: arc.axes.second,
        offset_0: arc.i,
        offset_1: arc.j,
        clockwise: arc.clockwise,
        turns: arc.turns,
    }
}

fn speed(feed: Feed) -> Speed {
    match feed {
        Feed::Rapid => Speed::Rapid,
        Feed::PerMinute(speed) => Speed::Feed(speed),
        Feed::InverseTime(seconds) => Speed::Duration(seconds),
    }
}
