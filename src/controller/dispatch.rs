//! [`Controller`] holds the state of the machine, the line being executed, and the machine's parts.
//! [`Controller::event`] takes an event, [`Controller::output`] returns the next thing to do, and
//! [`Controller::next_wakeup`] returns when the controller must be called again.
//!
//! Every call returns after a bounded piece of work: at most one line, one chord or one segment. Some work has to wait:
//! for room in the look-ahead, for the end of a motion or a dwell, for a record to be stored. Such work is kept as data
//! and continued in a later call, so it never delays `?`, `!` or a reset. [`Controller::event`] and
//! [`Controller::output`] get the current time as an argument.

use crate::image::FULL_IMAGE;
use crate::memory::Memory;
use crate::messages::{CrashKind, Event, LineByte, Observed, Output, Record, Restart, Room, Store, ToStep};
use crate::parts::Machine;
use crate::protocol::reply_texts;
use crate::settings::Key;
use crate::states::State;
use crate::states::door::DoorPhase;
use crate::step_rates::StepRates;
use crate::units::{Duration, Instant};
use crate::work::line::LineInWork;
use crate::work::task::Task;

/// Interval at which the controller checks whether a motion has started, while a change of an output (M62) waits for
/// this start. The change is late by at most this interval.
const OUTPUTS_LOOK: Duration = Duration::millis(1);

/// Properties of the board that the controller needs; constant while the firmware runs.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Profile {
    /// Name of the board, such as `blackpill_f411`.
    pub name: &'static str,
    /// Frequency of the step timer, in ticks per second.
    pub step_clock_hz: u32,
    /// Step rates that the step task can follow.
    pub rates: StepRates,
    /// Number of outputs (M62 to M65) and of inputs (M66) for programs, in this order.
    pub program_pins: [u8; 2],
    /// Number of axes with motors, at most `N` of the controller. A fourth motor drives A, or is the second motor of
    /// another axis.
    pub axes: usize,
    /// `true` if there are pins for a fourth motor besides those of X, Y and Z.
    pub has_second_motor: bool,
    /// `true` if there is an input for the spindle's at-speed signal.
    pub has_at_speed: bool,
    /// Maximum rate of the UART (`$931`), baud.
    pub most_baud: u32,
    /// Frequency of the board's oscillator in MHz, as found at start-up; 0 if the board has none.
    pub oscillator_mhz: u8,
    /// `true` if settings survive power-off; if `false`, the controller requests no store operations.
    pub has_store: bool,
    /// `true` if `$DFU` may restart the board into the chip's boot loader. This needs two things: hosts can reach the
    /// boot loader over USB, and the boot loader switches on nothing that is connected to the board.
    pub has_loader: bool,
}

/// The controller of a machine with `N` axes. It makes all decisions; drivers and tasks around it carry them out.
// Small fields come first: one load or store instruction reaches only the first 4 KiB of the structure.
#[cfg_attr(feature = "alloc", derive(Clone))]
#[repr(C)]
pub struct Controller<const N: usize> {
    pub(crate) state: State<N>,
    pub(crate) task: Task,
    pub(crate) line: LineInWork<N>,
    pub(crate) m: Machine<N>,
}

impl<const N: usize> Controller<N> {
    /// Returns a controller with default settings that works in `memory`. Call [`Controller::restore`] for each stored
    /// record, then [`Controller::start`].
    pub fn new(profile: Profile, memory: Memory<N>) -> Self {
        Self { state: State::Normal, task: Task::None, line: LineInWork::NONE, m: Machine::new(profile, memory) }
    }

    /// Takes the report of how the previous run of the firmware ended; call this before [`Controller::start`]. After a
    /// failure the machine is locked, because a host that has not noticed the restart may still send its job.
    pub fn restarted(&mut self, restart: Restart) {
        if restart.crash.as_ref().is_some_and(|crash| crash.kind == CrashKind::Board) {
            self.m.settings_lock.board_failed();
        }
        if restart.is_failure() {
            self.enter(State::Alarm(None));
            self.m.reference.lose();
        }
        self.m.replies.restarted(restart);
    }

    /// Completes power-up: greets the host, and runs the startup lines once the inputs are known.
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

    /// Passes the counters of the step task and of received line bytes to the parts that use them. Must be called
    /// before [`Controller::output`]. Must also be called before each event that separates earlier bytes from later
    /// ones: a realtime command, a change of signals, a disconnect.
    pub fn observe(&mut self, observed: Observed) {
        self.m.step_supply.observe(observed);
        self.m.lines.observe(observed.received, observed.activity);
        if observed.rx_free == 0 {
            // The queue is full, so bytes from the host may be waiting outside of the queue. Do not count the host as
            // silent.
            self.m.lines.heartbeat_mut().record_activity();
        }
        self.m.motion.observe(&observed);
        self.m.parking.observe(&observed);
    }

    /// Takes an event that happened at `now`.
    ///
    /// The path of a line: its bytes arrive here and are collected by `LineIntake`. After the last byte,
    /// `host::dispatch_line` calls the interpreter, which checks the line, and `work::stages` keeps it as a task.
    /// [`Controller::output`] then executes the task.
    // Always inlined, so that a byte in the middle of a line costs no function call.
    #[inline(always)]
    pub fn event(&mut self, now: Instant, event: Event<N>) {
        match event {
            Event::Line(byte) if self.take_text_byte(byte) => {}
            Event::Line(byte) => self.line_byte(now, byte),
            event => self.take(now, event),
        }
    }

    /// Takes a byte that only extends the current line. Nearly all bytes do only this, and their time does not matter.
    /// Returns `false` if the byte has another effect. Then pass it to [`Controller::event`] as an [`Event::Line`].
    pub fn take_text_byte(&mut self, byte: LineByte) -> bool {
        self.m.lines.take_plain(byte)
    }

    /// Takes `bytes` from the front, as long as they only extend the current line. `epoch`: the epoch of all these
    /// bytes, the count of resets before them ([`LineByte`]). Returns how many bytes were taken.
    pub fn take_text(&mut self, epoch: u16, bytes: &[u8]) -> usize {
        self.m.lines.take_text(epoch, bytes)
    }

    /// Handles all events except the line bytes that [`Controller::take_text_byte`] has taken.
    #[inline(never)]
    fn take(&mut self, now: Instant, event: Event<N>) {
        self.m.now = now;
        self.m.pins.disturb();
        match event {
            Event::Realtime(command) => {
                self.m.lines.heartbeat_mut().record_activity();
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

    /// Returns whether the controller accepts a byte of a line now. The controller accepts none while a task is in
    /// work, while the machine stops or waits, or while replies have no room.
    pub fn wants_line(&self) -> bool {
        self.task.is_none()
            && !self.m.lines.holds()
            && !self.m.stops.is_awaited()
            && self.state.takes_lines()
            && self.m.replies.has_room()
    }

    /// Returns whether received lines stay in the queue, because the machine waits for the operator, homes or brakes.
    /// Bytes that a later reset has made invalid stay there, too; [`Controller::drop_old`] drops them.
    pub fn lets_lines_wait(&self) -> bool {
        !self.state.takes_lines()
    }

    /// Returns whether the step task will soon run out of segments although the motion continues.
    pub fn is_short_of_segments(&self) -> bool {
        self.m.motion.is_short_of_segments()
    }

    /// Returns when the controller must be called again if nothing happens before; `None` if it need not be called.
    pub fn next_wakeup(&self) -> Option<Instant> {
        // Motion that a hold or a door has interrupted continues only after an event. It needs no wake-up while it is
        // at rest.
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
        // A suspended dwell gets no wake-up, because its end may already be past. A wake-up in the past would call the
        // controller again and again.
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

    /// Returns `Some` if the board must restart now: `Some(false)` for `$REBOOT`, `Some(true)` for `$DFU` (into the
    /// chip's boot loader). The platform asks when it has no more work to do, so the answer to the command has been
    /// sent by then.
    pub fn reboot_due(&self) -> Option<bool> {
        // Nothing moves here: any change of the state (`Controller::enter`) cancels the restart.
        match self.task {
            Task::Rebooting { into_loader, at } if self.m.now >= at => Some(into_loader),
            _ => None,
        }
    }

    /// Notes that no more bytes will come. Queued motion then starts without waiting for further moves.
    pub fn input_ended(&mut self) {
        self.m.step_supply.end_input();
    }

    /// Does a bounded piece of work at `now`. Returns the next output for which the pump (the loop that calls the
    /// controller) has `room`. Call this until it returns `None`.
    ///
    /// Everything that takes longer than handling an event happens here, in order of urgency:
    /// 1. handle ended motions and delays;
    /// 2. output stops, pins and records;
    /// 3. fill the step queue if it is short;
    /// 4. send replies;
    /// 5. do one bounded piece of the current task;
    /// 6. hand further segments to the step task.
    ///
    /// After a piece of a task the result is [`Output::Worked`] or [`Output::Answer`], and there may be more to do. A
    /// line that moves takes at least three calls: one executes and answers it, one starts its motion, and each
    /// further call hands over one segment.
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
            // The answer to a line that only moves is sent at once. After any other line, changed outputs come before
            // the answer.
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

    /// Returns whether anything that [`Controller::look_round`] checks may have changed since it was last called.
    fn may_have_changed(&self) -> bool {
        !self.m.pins.are_calm() || self.m.step_supply.is_running() && self.m.motion.is_idle()
    }

    /// Returns whether only motion is in progress. If so, nothing that [`Controller::look_round`] checks changes
    /// before the motion ends.
    fn only_moves(&self) -> bool {
        matches!(self.state, State::Normal)
            && self.m.probe.is_over()
            && self.m.stops.is_idle()
            && self.m.stops.is_open()
            && !self.m.parking.motion().hands_over()
            && self.m.drivers.off_at().is_none()
            && !self.m.accessories.is_on()
            && !self.m.accessories.digital().is_waiting()
            // Only `look_round` calls `look_for_host`, which starts to time the host's silence when work begins. So
            // while one of these two limits is set, `look_round` must not be skipped.
            && !self.m.settings.is_on(Key::HostSilence)
            && !self.m.settings.is_on(Key::JogSilence)
    }

    /// Returns the change to store. The pump calls this after an [`Output::Store`].
    pub fn next_store(&mut self) -> Option<Store> {
        self.m.records.next_store()
    }

    /// Handles what comes before segments and answers: ended motions and delays, stops, wiring, pins, records.
    #[inline(never)]
    fn look_round(&mut self) -> Option<Output> {
        // From here on the outputs can change, because `settle` can end a motion or start a delay.
        self.m.pins.disturb();
        let wanted = self.wants_line();
        self.settle();
        if !wanted && self.wants_line() {
            // Waiting bytes may be taken from here on. Without this output, nothing would wake the pump (the calling
            // loop) for them.
            return Some(Output::Worked);
        }
        if self.m.stops.take_order() {
            return Some(Output::Stop);
        }
        // Wiring (polarities, step timing) is sent before levels of pins, because the drivers' enable output needs its
        // polarity before its level.
        if let Some(wiring) = self.changed_wiring() {
            return Some(Output::Wiring(wiring));
        }
        if let Some(pins) = self.changed_pins() {
            return Some(Output::Pins(pins));
        }
        if self.m.records.has_next() {
            return Some(Output::Store);
        }
        if let Some(clear_noise) = self.m.inputs.take_request() {
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

    /// Calls [`Controller::step_message`] when segments are urgent. Not inlined, so that `step_message` is inlined only
    /// where [`Controller::output`] calls it most often.
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
        // `Resume` lets the step task run again, and `Watch` watches the probe. Both move nothing, so the drivers may
        // be off.
        let moves = !matches!(message, None | Some(ToStep::Resume { .. } | ToStep::Watch { .. }));
        if moves && self.m.drivers.switch_on() {
            self.m.pins.disturb();
        }
        message
    }

    /// Returns the next message for the step task, in this order: [`ToStep::Resume`], which lets the step task run
    /// again after a stop; the start or end of watching the probe; parking moves; motion of the job.
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

    /// Handles what has ended since the last call: a motion, the braking of a hold, a jog, the delays of a door.
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
            // The drivers stay on between the moves of homing.
            if !matches!(self.state, State::Homing(_)) {
                self.m.start_idle_delay();
            }
        }
        if self.m.motion.is_at_rest() && self.m.accessories.apply_stop_at_rest() {
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
        // The code above may have entered `State::Door`.
        if let State::Door(door) = self.state {
            self.settle_phases(door.phase);
        }
        self.m.drivers.look(self.m.now);
        self.look_for_host();
    }

    /// Starts queued motion when there is no reason to wait for further moves.
    fn auto_start(&mut self) {
        // Motion is still running, but its last segment may already be in the step queue. A move that was queued after
        // that would never begin without this start.
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

    /// Records the store's answer to a change. `done`: `true` if the change was stored. A failure is reported in a
    /// message of its own when all changes have been answered, because a reset may have ended the command that made
    /// the change.
    fn stored(&mut self, done: bool) {
        if self.m.records.answered(done) {
            self.say(|out| reply_texts::message(out, "Change active but not stored: lost at power-off"));
        }
    }

    /// Applies a stored record (a setting, an offset and the like) at power-up. Invalid records are ignored.
    pub fn restore(&mut self, record: &Record) {
        self.m.pins.disturb();
        self.m.records.restore(record, &mut self.m.settings, &mut self.m.interpreter);
    }
}
