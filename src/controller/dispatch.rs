//! `Controller`: the state the machine is in, the line it carries out, and the machine's parts. [`Controller::event`] takes
//! in what has happened, [`Controller::output`] returns the next thing to do, and [`Controller::next_wakeup`] the time of the
//! next call.
//!
//! Every call returns after a bounded piece of work: at most one line, one chord or one segment. Work that has to wait (for
//! room in the look-ahead, the end of a motion, a dwell, a stored record) is kept as data and continued in a later call, so
//! `?`, `!` and a reset are never late. Time is an argument.
//!
//! A stop acts before the controller hears of it: the step task (`src/step_task/step_timer`) stops the pulses, and reports where as an event.
//!
//! Calls between the rooms go one way:
//!
//! ```text
//!  dispatch ──▶ inputs ──▶ host ──▶ work ──▶ states ──▶ outputs, answers ──▶ parts
//! ```
//! A test in `tests/architecture` checks that no two files call each other.

use crate::image::FULL_IMAGE;
use crate::memory::Memory;
use crate::messages::{Event, LineByte, Observed, Output, Record, Restart, Room, Store, ToStep};
use crate::parts::Machine;
use crate::protocol::report;
use crate::settings::Key;
use crate::states::State;
use crate::states::door::DoorPhase;
use crate::step_rates::StepRates;
use crate::units::{Duration, Instant};
use crate::work::line::LineInWork;
use crate::work::task::Task;

/// How often an output that changes with a motion (M62) looks whether that has begun: how late it may be.
const OUTPUTS_LOOK: Duration = Duration::millis(1);

/// What the controller must know of the machine it runs on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Profile {
    /// Name of the board.
    pub name: &'static str,
    /// Ticks of the step timer in a second.
    pub step_clock_hz: u32,
    /// Step rates that the step task can follow.
    pub rates: StepRates,
    /// Outputs and inputs for programs (M62 to M66).
    pub program_pins: [u8; 2],
    /// Axes that have motors, `N` of the controller at most; a fourth motor is that of A or the second one of another axis.
    pub axes: usize,
    /// Whether there are pins for a motor more than X, Y and Z.
    pub has_second_motor: bool,
    /// Whether there is a pin on which a spindle tells that it is up to speed.
    pub has_at_speed: bool,
    /// Greatest rate of the UART (`$931`), baud.
    pub most_baud: u32,
    /// Whether settings outlive the power: if not, nothing is handed to a store.
    pub has_store: bool,
}

/// Decides everything, for `N` axes.
// Fields are in this order, small ones first: one instruction reaches 4 KiB from the base.
#[cfg_attr(feature = "alloc", derive(Clone))]
#[repr(C)]
pub struct Controller<const N: usize> {
    pub(crate) state: State<N>,
    pub(crate) task: Task,
    pub(crate) line: LineInWork<N>,
    pub(crate) m: Machine<N>,
}

impl<const N: usize> Controller<N> {
    /// A controller with default settings, which works in the memory that it is lent. Stored records follow with
    /// [`Controller::restore`], then [`Controller::start`].
    pub fn new(profile: Profile, memory: Memory<N>) -> Self {
        Self { state: State::Normal, task: Task::None, line: LineInWork::NONE, m: Machine::new(profile, memory) }
    }

    /// What is known of the end before this start; before [`Controller::start`]. After a failure the machine is locked, for a
    /// host that noticed nothing may still be sending its job.
    pub fn restarted(&mut self, restart: Restart) {
        if restart.is_failure() {
            self.enter(State::Alarm(None));
            self.m.reference.lose();
        }
        self.m.replies.restarted(restart);
    }

    /// Power-up is complete: greets the host, and runs the startup lines once the inputs are known.
    pub fn start(&mut self, now: Instant) {
        self.m.now = now;
        self.m.pins.disturb();
        self.m.settings.settle();
        self.reconfigure();
        if self.m.settings.is_on(Key::Homing) {
            self.enter(State::Alarm(None));
            self.m.reference.lose();
        }
        if self.m.records.are_damaged() {
            self.enter(State::Alarm(None));
        }
        self.initialise();
    }

    /// What the pump sees of the step task and of received lines. To be called before outputs, and before each event that
    /// may tell what came before it from what comes after it: realtime commands, signals, the end of a host.
    pub fn observe(&mut self, observed: Observed) {
        self.m.step_supply.observe(observed);
        self.m.lines.observe(observed.received, observed.heard);
        if observed.rx_free == 0 {
            // More may wait unseen in front of a full queue.
            self.m.lines.heartbeat_mut().hear();
        }
        self.m.motion.observe(&observed);
        self.m.parking.observe(&observed);
    }

    /// Something happened at `now`.
    ///
    /// The path of a line: its bytes come in here and are collected by `LineIntake`. At the last one `host::dispatch_line` has
    /// the line checked and `work::stages` keeps it as a task. That is all an event does; what the line asks for is done by
    /// [`Controller::output`].
    // Always, so that the middle of a line costs no call.
    #[inline(always)]
    pub fn event(&mut self, now: Instant, event: Event<N>) {
        match event {
            Event::Line(byte) if self.take_text_byte(byte) => {}
            Event::Line(byte) => self.line_byte(now, byte),
            event => self.take(now, event),
        }
    }

    /// Takes a byte that makes a line longer and does nothing else, to which the time means nothing: nearly all events. What is
    /// no such byte is not taken, and is told as an [`Event::Line`].
    #[inline]
    pub fn take_text_byte(&mut self, byte: LineByte) -> bool {
        self.m.lines.take_plain(byte)
    }

    /// Takes the first of some bytes of an epoch as far as they are such bytes. Gives how many.
    #[inline]
    pub fn take_text(&mut self, epoch: u16, bytes: &[u8]) -> usize {
        self.m.lines.take_text(epoch, bytes)
    }

    /// All events but bytes of lines, for which there is [`Controller::line_byte`].
    #[inline(never)]
    fn take(&mut self, now: Instant, event: Event<N>) {
        self.m.now = now;
        self.m.pins.disturb();
        match event {
            Event::Realtime(command) => {
                self.m.lines.heartbeat_mut().hear();
                self.realtime(command);
            }
            Event::Line(byte) => self.line_byte(now, byte),
            Event::Step(event) => self.step_event(&event),
            Event::Signals(sensed) => self.signals_changed(&sensed),
            Event::Pins(view) => self.m.inputs.viewed(view),
            Event::Stored => self.stored(true),
            Event::StoreFailed => self.stored(false),
            Event::Connected => {
                self.m.lines.heartbeat_mut().set_gone(false);
                self.greet();
                self.tell_lock();
                self.tell_inherited();
            }
            Event::Disconnected(hosts_gone) => {
                self.m.replies.host_left(hosts_gone);
                self.host_left();
            }
        }
    }

    /// Whether a line byte may be given.
    pub fn wants_line(&self) -> bool {
        self.task.is_none()
            && !self.m.lines.holds()
            && !self.m.stops.is_awaited()
            && self.state.takes_lines()
            && self.m.replies.has_room()
    }

    /// Whether received lines wait for an operator or for the end of a motion, and bytes from before a reset with them.
    #[inline]
    pub fn lets_lines_wait(&self) -> bool {
        !self.state.takes_lines()
    }

    /// Whether the step task will soon have done all that it has been given of a motion that continues.
    #[inline]
    pub fn is_short_of_segments(&self) -> bool {
        self.m.motion.is_short_of_segments()
    }

    /// When the controller wants to be called although nothing happens.
    pub fn next_wakeup(&self) -> Option<Instant> {
        // What a completed hold or a parked door has interrupted continues with an event, not by itself.
        let moving = !self.m.motion.is_at_rest()
            || !self.m.parking.motion().is_at_rest()
            || self.m.step_supply.is_running() && !self.state.is_suspended();
        let moving = moving.then(|| {
            self.m.now
                + crate::machine::step_supply::refill_delay([
                    self.m.parking.motion().queued_us(),
                    self.m.motion.queued_us(),
                ])
        });
        let spindle = match self.state {
            State::Door(door) => match door.phase {
                DoorPhase::SpindleRestoring(until) => Some(self.next_look_at_spindle(until)),
                DoorPhase::CoolantRestoring(until) => Some(until),
                _ => None,
            },
            State::Hold(hold) => hold.ends_with_spindle().map(|until| self.next_look_at_spindle(until)),
            _ => None,
        };
        // Nor does a dwell that something has ended: its moment would be past for ever.
        let task = match &self.state {
            State::Homing(homing) => homing.wakeup(),
            state if state.is_suspended() => None,
            _ => self.task.wakeup(|until| self.next_look_at_spindle(until)),
        };
        let waits = self.m.accessories.digital().is_waiting() && !self.m.motion.is_at_rest();
        let outputs = waits.then(|| self.m.now + OUTPUTS_LOOK);
        let silent = self.m.lines.heartbeat().silent_at();
        let lost = if self.needs_speed() { self.m.accessories.speed_lost_at() } else { None };
        [moving, spindle, task, outputs, self.m.drivers.off_at(), silent, lost].into_iter().flatten().min()
    }

    /// No more bytes will come: what is queued is started.
    pub fn input_ended(&mut self) {
        self.m.step_supply.end_input();
    }

    /// Works, and gives the next thing to be done, at `now`, as far as the pump has room for it. Called until it gives `None`.
    ///
    /// No getter: this is what drives everything that takes longer than an event. In the order of urgency it follows what has
    /// ended, gives out stops, pins and records, keeps the step queue filled, answers, and then does one bounded piece of the
    /// task in hand ([`Output::Worked`] or [`Output::Answer`]: there is more). So the path of a line goes through here at least
    /// three times: carried out and answered, begun, and handed to the step task segment by segment.
    pub fn output(&mut self, now: Instant, room: Room) -> Option<Output> {
        self.m.now = now;
        if self.may_have_changed()
            && let Some(output) = self.look_round()
        {
            return Some(output);
        }
        let short = self.m.step_supply.is_short(|us| self.m.motion.holds_time(us));
        let urgent = short && !self.m.motion.ends_at_rest();
        if urgent
            && room.step
            && let Some(message) = self.urgent_message()
        {
            return Some(Output::Step(message));
        }
        self.answer_status();
        if room.reply
            && let Some(chunk) = self.m.replies.next_chunk()
        {
            return Some(Output::Reply(chunk));
        }
        if self.may_advance() && self.advance() {
            // The answer to a line that only moves goes out at once; after anything else what that has changed comes first.
            let answer = if room.reply && self.m.pins.are_calm() { self.m.replies.next_chunk() } else { None };
            return Some(answer.map_or(Output::Worked, Output::Answer));
        }
        if matches!(self.task, Task::JogWaits) && self.begin_waiting_jog() {
            self.m.pins.disturb();
            return Some(Output::Worked);
        }
        self.auto_start();
        if room.step
            && let Some(message) = self.step_message()
        {
            return Some(Output::Step(message));
        }
        None
    }

    /// Whether anything that [`Controller::look_round`] looks at may be other than at the last time.
    #[inline]
    fn may_have_changed(&self) -> bool {
        !self.m.pins.are_calm() || self.m.step_supply.is_running() && self.m.motion.is_idle()
    }

    /// Whether nothing is under way but motion: then time and the step task change nothing but that it ends.
    fn only_moves(&self) -> bool {
        matches!(self.state, State::Normal)
            && self.m.probe.is_over()
            && self.m.stops.is_idle()
            && self.m.stops.is_open()
            && !self.m.parking.motion().hands_over()
            && self.m.drivers.off_at().is_none()
            && !self.m.accessories.is_on()
            && !self.m.accessories.digital().is_waiting()
            // A silence begins with what is at work, in the moment at which that begins.
            && !self.m.settings.is_on(Key::HostSilence)
            && !self.m.settings.is_on(Key::JogSilence)
    }

    /// The change that is to be made for an [`Output::Store`].
    pub fn next_store(&mut self) -> Option<Store> {
        self.m.records.next_store()
    }

    /// What goes before segments and answers: the end of what was under way, stops, wiring, pins, records.
    #[inline(never)]
    fn look_round(&mut self) -> Option<Output> {
        // What follows may end motion and begin a delay.
        self.m.pins.disturb();
        let wanted = self.wants_line();
        self.settle();
        if !wanted && self.wants_line() {
            // Bytes that have waited may come now, and nothing else would wake the pump for them.
            return Some(Output::Worked);
        }
        if self.m.stops.take_order() {
            return Some(Output::Stop);
        }
        // The polarity of the drivers' enable output comes before its level.
        if let Some(wiring) = self.changed_wiring() {
            return Some(Output::Wiring(wiring));
        }
        if let Some(pins) = self.changed_pins() {
            return Some(Output::Pins(pins));
        }
        if self.m.records.has_next() {
            return Some(Output::Store);
        }
        if let Some(clear_noise) = self.m.inputs.take_look() {
            return Some(Output::ReadPins { clear_noise });
        }
        if FULL_IMAGE && let Some(first) = self.take_ask() {
            return Some(Output::ReadRecording { first });
        }
        if self.only_moves() {
            self.m.pins.calm_down();
        }
        None
    }

    /// The same before all else. By itself, so that a motion under way costs no call.
    #[cold]
    #[inline(never)]
    fn urgent_message(&mut self) -> Option<ToStep> {
        self.step_message()
    }

    #[inline(always)]
    fn step_message(&mut self) -> Option<ToStep> {
        let mut message = if self.m.pins.are_calm() { self.m.motion.next_message() } else { self.message_in_turn() };
        if let Some(ToStep::Segment(segment)) = &mut message {
            segment.power = self.overridden_power(segment.power);
        }
        // What opens the step task again or watches the probe moves nothing.
        let moves = !matches!(message, None | Some(ToStep::Resume { .. } | ToStep::Watch { .. }));
        if moves && self.m.drivers.switch_on() {
            self.m.pins.disturb();
        }
        message
    }

    /// What comes before the motion of a job.
    #[inline(never)]
    fn message_in_turn(&mut self) -> Option<ToStep> {
        if !self.m.stops.is_open() {
            return None;
        }
        if let Some(stops) = self.m.stops.take_resume() {
            return Some(ToStep::Resume { stops });
        }
        if self.state.is_alarm() || matches!(self.state, State::Sleep(_)) || self.m.probe.is_braking() {
            return None;
        }
        if let Some(watch) = self.m.probe.take_watch() {
            return Some(watch);
        }
        self.m.parking.next_message().or_else(|| self.m.motion.next_message())
    }

    /// Follows what has come to an end since the last call: motion, a hold's ramp, a jog, a door's delays.
    fn settle(&mut self) {
        if self.m.accessories.take_overrides_due() {
            self.apply_overrides();
        }
        self.settle_probe();
        self.settle_outputs();
        if self.m.stops.is_awaited() {
            return;
        }
        if self.m.step_supply.is_running() && self.m.motion.is_idle() {
            self.m.step_supply.end();
            // Between the moves of homing the drivers stay on.
            if !matches!(self.state, State::Homing(_)) {
                self.m.start_idle_delay();
            }
        }
        if self.m.motion.is_at_rest() && self.m.accessories.rests() {
            self.m.replies.overrides_changed();
        }
        match self.state {
            State::Jog { cancelling }
                if self.m.motion.is_at_rest() && (cancelling || (self.m.motion.is_idle() && self.task.is_none())) =>
            {
                self.end_jog(cancelling);
            }
            State::Braking { then } if self.m.motion.is_at_rest() => self.settle_braking(then),
            State::Normal => self.look_for_spindle(),
            State::Hold(hold) => {
                if let Some(until) = hold.ends_with_spindle()
                    && self.has_spun_up(until)
                {
                    self.leave_hold();
                }
            }
            _ => {}
        }
        // It may have been opened just now.
        if let State::Door(door) = self.state {
            self.settle_phases(door.phase);
        }
        self.m.drivers.look(self.m.now);
        self.look_for_host();
    }

    /// Starts queued motion when there is no reason to wait for more of it.
    fn auto_start(&mut self) {
        // A move queued while the last piece of the one before was already in the step queue belongs to the same
        // run: without a start of its own it would never begin.
        if self.m.step_supply.is_running() && matches!(self.state, State::Normal | State::Jog { cancelling: false }) {
            self.m.motion.start();
            return;
        }
        if matches!(self.state, State::Normal)
            && !self.m.motion.is_idle()
            && self.task.is_none()
            && self.m.step_supply.has_no_more()
        {
            self.start_motion();
        }
    }

    /// The store has answered a change: told at once, as the command may have been ended by a reset meanwhile.
    fn stored(&mut self, done: bool) {
        if self.m.records.answered(done) {
            self.say(|out| report::message(out, "The setting holds but could not be stored"));
        }
    }

    /// Takes a stored record at power-up. Records that make no sense are ignored.
    pub fn restore(&mut self, record: &Record) {
        self.m.pins.disturb();
        self.m.records.restore(record, &mut self.m.settings, &mut self.m.interpreter);
    }
}
