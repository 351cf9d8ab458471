//! The control task: passes the messages of other tasks to the controller, and carries out the controller's outputs. It
//! works in rounds; [`oxmill_controller::pump`] defines the order within a round.

use crate::BoardController;
use crate::boards::{self, AXES};
use crate::clock::Clock;
use crate::last_words::{self, Whereabouts};
use crate::outputs::Outputs;
use crate::settings_store::SettingsStore;
use crate::shared::{self, ASKED, CONTROL, INPUTS, Power, SERIAL, STEP};
use core::sync::atomic::Ordering;
use oxmill_controller::messages::{
    Chunk, EVENTS_DEPTH, Event, LINE_MESSAGES, LINES_DEPTH, LineByte, LineBytes, Observed, Output, PinView,
    REALTIME_DEPTH, REPLIES_DEPTH, Realtime, Room, SEGMENTS_DEPTH, SIGNALS_DEPTH, Sensed, StepEvent, ToStep, Wiring,
    input,
};
use oxmill_controller::pump::{Pump, Source, round};
use oxmill_controller::recorder::{Page, Recorder};
use oxmill_controller::units::{Duration, Instant};
use oxmill_controller::{Coalescing, DeferredCommands, LineReader};
use rtic_sync::channel::{Receiver, Sender};
use rtic_sync::signal::SignalWriter;

/// 500 us. `control` wakes at this interval while the queue to the step task is full, or while wiring data waits to be
/// sent. Then the wake-up time that the controller requests could be too late, because short segments leave the queue
/// earlier.
const FULL_QUEUE_WAKEUP: Duration = Duration::from_ticks(500);

/// The channel ends of `control`: receivers from other tasks, and senders to them.
pub struct Ends {
    /// From `serial`.
    pub realtime: Receiver<'static, Realtime, REALTIME_DEPTH>,
    /// From `serial`.
    pub lines: Receiver<'static, LineBytes, LINE_MESSAGES>,
    /// From `step`.
    pub events: Receiver<'static, StepEvent<AXES>, EVENTS_DEPTH>,
    /// From `inputs`.
    pub signals: Receiver<'static, Sensed, SIGNALS_DEPTH>,
    /// To `step`.
    pub segments: Sender<'static, ToStep, SEGMENTS_DEPTH>,
    /// To `serial`.
    pub replies: Sender<'static, Chunk, REPLIES_DEPTH>,
    /// To `step`.
    pub step_wiring: Sender<'static, Wiring, 2>,
    /// To `inputs`.
    pub input_wiring: Sender<'static, Wiring, 2>,
}

/// State of the control task.
pub struct Control {
    controller: &'static mut BoardController,
    ends: Ends,
    outputs: Outputs,
    settings: SettingsStore,
    recorder: Recorder<&'static mut [Page]>,
    clock: Clock,
    /// Start time of the present round.
    round_began: Instant,
    line_reader: LineReader,
    /// Line bytes passed to the controller since power-up (wrapping).
    line_bytes_out: u32,
    /// Value of `hosts_came` in [`SERIAL`] when it was last read.
    hosts_came: u8,
    /// Value of `hosts_went` in [`SERIAL`] when it was last read.
    hosts_went: u16,
    job: Option<Job>,
    /// Wiring data (polarity and similar settings of the pins) for which the queues had no room.
    unsent_wiring: Option<Wiring>,
    /// Value of `bytes_queued` in [`SERIAL`] when the present round of this task began. Line bytes queued after that
    /// belong to a later round.
    lines_in: u32,
    /// `true` if the serial task had deferred commands (commands that found no room in the queue) when the round began.
    has_deferred: bool,
    /// Deferred commands (see `has_deferred`) that were taken from the serial task but not yet passed to the
    /// controller.
    deferred: DeferredCommands,
    coalescing: Coalescing,
    /// Result of the last change of a setting: `true` if it was stored. `None` after the controller has got this
    /// result.
    stored: Option<bool>,
    /// Mask of the inputs that the board has.
    fitted: u32,
    /// `true` if the controller has requested the state of the input pins and has not got it yet.
    pins_asked: bool,
    /// `true` if the settings log in flash will soon be full without an erase. Updated only at the beginning of a
    /// round, so that it does not change within a round.
    wants_erase_soon: bool,
}

/// A preloaded job, and the index of its next byte.
struct Job {
    text: &'static [u8],
    next: usize,
}

impl Control {
    /// Creates the task. `fitted`: mask of the inputs that the board has.
    pub fn new(
        controller: &'static mut BoardController,
        ends: Ends,
        outputs: Outputs,
        settings: SettingsStore,
        recorder: Recorder<&'static mut [Page]>,
        alarm: SignalWriter<'static, u32>,
        fitted: u32,
    ) -> Control {
        let job = boards::preloaded_job().map(|text| Job { text, next: 0 });
        Control {
            controller,
            ends,
            outputs,
            settings,
            recorder,
            clock: Clock::new(alarm),
            round_began: Instant::from_ticks(0),
            line_reader: LineReader::default(),
            line_bytes_out: 0,
            hosts_came: 0,
            hosts_went: 0,
            job,
            unsent_wiring: None,
            lines_in: 0,
            has_deferred: false,
            deferred: DeferredCommands::default(),
            coalescing: Coalescing::default(),
            stored: None,
            fitted,
            pins_asked: false,
            wants_erase_soon: false,
        }
    }

    /// Starts the controller. Called once, before the first [`Control::turn`].
    pub fn start(&mut self) {
        let now = self.clock.now();
        self.controller.start(now);
    }

    /// Runs the task: carries out rounds until there is nothing to do, then sets the time of the next wake-up. Not
    /// inlined, so that the virtual board can replace it by an endless loop.
    #[inline(never)]
    pub fn turn(&mut self) {
        let activity = SERIAL.activity.load(Ordering::Relaxed);
        loop {
            while round(self) || self.release_answers() {}
            self.note_place();
            if !self.erase_ahead() {
                break;
            }
            // After the erase, go on with the lines that had to wait for it.
        }
        if let Some(into_loader) = self.controller.reboot_due() {
            boards::reboot(into_loader);
        }
        let observed = self.observe();
        if observed.step_idle && self.controller.is_idle() {
            self.recorder.at_rest(self.round_began, self.controller);
        }
        let nothing_waits = observed.received == 0 && self.ends.realtime.is_empty();
        // Replies that have not been sent yet do not count here, because the serial task itself checks them.
        shared::set_free(activity, nothing_waits && self.controller.is_free() && observed.step_idle);
        CONTROL.reads_characters.store(self.controller.reads_characters(), Ordering::Relaxed);
        CONTROL.speaks_grblhal.store(self.controller.speaks_grblhal(), Ordering::Relaxed);
        if self.job.as_ref().is_some_and(|job| job.next == job.text.len())
            && self.controller.is_idle()
            && self.observe().step_idle
        {
            boards::job_done();
        }
        let mut wakeup = self.controller.next_wakeup();
        if self.ends.segments.is_full() || self.unsent_wiring.is_some() {
            let soon = self.clock.now() + FULL_QUEUE_WAKEUP;
            wakeup = Some(wakeup.map_or(soon, |at| at.min(soon)));
        }
        self.clock.set_alarm(wakeup);
    }

    /// Returns whether there are line bytes that were queued before this round began and have not been read yet.
    #[inline(always)]
    fn lines_wait(&self) -> bool {
        self.line_bytes_out != self.lines_in
    }

    /// Releases the answers that `Coalescing` holds back so that several can be sent together. Call when there is
    /// nothing else to do. Returns whether there were any.
    #[inline(always)]
    fn release_answers(&mut self) -> bool {
        let are_held = self.coalescing.holds(self.lines_wait()) && self.controller.has_answers();
        if are_held {
            self.coalescing.release(self.round_began);
        }
        are_held
    }

    /// Stores machine position and line number, for the report of a failure that may follow ([`last_words`]).
    fn note_place(&mut self) {
        let mut place = [0; 3];
        for (slot, at) in place.iter_mut().zip(self.controller.machine_position().iter()) {
            *slot = at.micrometres();
        }
        let (line, moment) = (self.controller.line_number(), self.round_began.ticks() as u32);
        last_words::note(Whereabouts { place, line, moment });
    }

    /// Erases the spare sector of the settings log if the erase is due and possible. Returns whether it erased. The
    /// erase is possible if the machine is at rest with its spindle off, and no command or line waits. If the log is
    /// nearly full, waiting lines do not prevent the erase.
    /// The erase stalls the processor for a quarter of a second. The board keeps the bytes that the host sends
    /// meanwhile.
    fn erase_ahead(&mut self) -> bool {
        let observed = self.observe();
        let nothing_waits =
            (observed.received == 0 || self.settings.wants_erase_soon()) && self.ends.realtime.is_empty();
        let erases = self.settings.wants_erase() && observed.step_idle && nothing_waits && self.controller.is_quiet();
        if erases {
            self.settings.erase();
        }
        erases
    }

    /// Sends the wiring data (polarity and similar settings of the pins) to the tasks `step` and `inputs`. If a queue
    /// is full, the data stays in `unsent_wiring` for a later call. At rest, both tasks empty their queue within a
    /// millisecond.
    fn send_wiring(&mut self) {
        if let Some(wiring) = self.unsent_wiring
            && !self.ends.step_wiring.is_full()
            && !self.ends.input_wiring.is_full()
        {
            let _ = self.ends.step_wiring.try_send(wiring);
            let _ = self.ends.input_wiring.try_send(wiring);
            self.unsent_wiring = None;
            boards::call_step();
        }
    }

    fn observe(&self) -> Observed {
        // Read the queue before `STEP`. The step task clears `at_rest` in the same run in which it takes a message out
        // of the queue. So if it has just emptied the queue, `at_rest` is already cleared.
        let queue_empty = self.ends.segments.is_empty();
        let step_idle = queue_empty && STEP.at_rest.load(Ordering::Relaxed);
        let used = SERIAL.bytes_queued.load(Ordering::Relaxed).wrapping_sub(self.line_bytes_out) as usize;
        // While bytes of a preloaded job are left, report the queue of received bytes as full: the next bytes of the
        // job are always ready.
        let arrived = SERIAL.bytes_received.load(Ordering::Relaxed);
        let activity = arrived.wrapping_add(SERIAL.bytes_ignored.load(Ordering::Relaxed));
        let received = arrived.wrapping_sub(self.line_bytes_out) as usize;
        let has_job = self.job.as_ref().is_some_and(|job| job.next < job.text.len());
        let (used, received) = if has_job { (LINES_DEPTH, LINES_DEPTH) } else { (used, received) };
        // Report no free space while received bytes wait for room in a queue.
        let rx_free = if self.has_no_room() { 0 } else { LINES_DEPTH.saturating_sub(used) as u16 };
        Observed {
            segments_begun: STEP.segments_begun.load(Ordering::Relaxed),
            step_idle,
            rx_free,
            received: received as u16,
            activity: activity as u16,
        }
    }

    /// Returns whether received bytes wait for room in a queue.
    fn has_no_room(&self) -> bool {
        SERIAL.bytes_received.load(Ordering::Relaxed) != SERIAL.bytes_queued.load(Ordering::Relaxed)
    }

    /// Returns whether the serial task must be called because it still has line bytes while the queue of lines is
    /// empty.
    fn are_gathered(&self) -> bool {
        SERIAL.bytes_queued.load(Ordering::Relaxed) != self.line_bytes_out
            && self.line_reader.ahead().1.is_empty()
            && self.ends.lines.is_empty()
    }

    /// Returns an event if a host has disconnected or connected since the last call.
    fn next_of_hosts(&mut self) -> Option<Event<AXES>> {
        // Read `hosts_came` first. One host may disconnect and another may connect between the two reads. This round
        // then reports the disconnection, and the next round the new host.
        let (came, went) = (SERIAL.hosts_came.load(Ordering::Relaxed), SERIAL.hosts_went.load(Ordering::Relaxed));
        if went != self.hosts_went {
            self.hosts_went = went;
            return Some(Event::Disconnected(went));
        }
        (came != core::mem::replace(&mut self.hosts_came, came)).then_some(Event::Connected)
    }

    /// Returns the next command. The order of arrival is: deferred commands taken over earlier, queued commands, new
    /// deferred commands. (A deferred command is one that found no room in the queue.) New deferred commands are taken
    /// over only if there were any when the round began. While the serial task has some, it queues no further command,
    /// so the order is kept.
    fn next_command(&mut self) -> Option<Realtime> {
        if let Some(command) = self.deferred.pop() {
            return Some(command);
        }
        if !self.ends.realtime.is_empty()
            && let Ok(command) = self.ends.realtime.try_recv()
        {
            return Some(command);
        }
        if core::mem::take(&mut self.has_deferred) {
            self.deferred = shared::take_deferred();
        }
        self.deferred.pop()
    }

    /// Returns whether lines must wait for an erase. Because of this wait, a host that sends many settings cannot fill
    /// the settings log before the erase.
    #[inline(always)]
    fn waits_for_erase(&self) -> bool {
        self.wants_erase_soon && self.controller.is_nearly_quiet()
    }

    /// Passes the next item of the recording (`$REC`) to the controller. `first`: begins again at the first item.
    #[inline(never)]
    fn read_recording(&mut self, first: bool) {
        let Control { controller, recorder, settings, .. } = self;
        let board = (boards::profile().name, boards::PROFILE.step_clock_hz);
        recorder.read(first, board, |number| settings.record(number), |item| controller.recorded(item));
    }

    fn view_of_pins(&self) -> PinView {
        PinView {
            fitted: self.fitted,
            low: INPUTS.low.load(Ordering::Relaxed),
            noise: core::array::from_fn::<_, { input::COUNT }, _>(|bit| {
                INPUTS.noise.get(bit).map_or(0, |count| count.load(Ordering::Relaxed))
            }),
        }
    }
}

impl Pump<AXES> for Control {
    const IS_WOKEN: bool = true;

    #[inline(always)]
    fn controller(&mut self) -> &mut BoardController {
        self.controller
    }

    #[inline(always)]
    fn begin(&mut self) -> Instant {
        ASKED.control.store(false, Ordering::Relaxed);
        self.lines_in = SERIAL.bytes_queued.load(Ordering::Relaxed);
        self.has_deferred = shared::has_deferred();
        self.wants_erase_soon = self.settings.wants_erase_soon();
        self.round_began = self.clock.now();
        self.coalescing.begin(self.round_began);
        self.round_began
    }

    #[inline]
    fn observed(&mut self) -> Observed {
        self.observe()
    }

    #[inline(always)]
    fn next_event(&mut self, source: Source) -> Option<Event<AXES>> {
        // Check for an empty queue first: that takes half as long as a failed receive.
        match source {
            Source::Step if self.ends.events.is_empty() => None,
            Source::Step => self.ends.events.try_recv().ok().map(Event::Step),
            Source::Hosts => self.next_of_hosts(),
            Source::Commands => self.next_command().map(Event::Realtime),
            Source::Inputs if self.ends.signals.is_empty() => None,
            Source::Inputs => self.ends.signals.try_recv().ok().map(Event::Signals),
            Source::Pins => core::mem::take(&mut self.pins_asked).then(|| Event::Pins(self.view_of_pins())),
            Source::Store => self.stored.take().map(|stored| if stored { Event::Stored } else { Event::StoreFailed }),
        }
    }

    #[inline(always)]
    fn give_text(&mut self, now: Instant) -> bool {
        if self.waits_for_erase() {
            return false;
        }
        let Control { controller, recorder, line_reader, .. } = self;
        let (epoch, bytes) = line_reader.ahead();
        let most = self.lines_in.wrapping_sub(self.line_bytes_out) as usize;
        let text = bytes.get(..most).unwrap_or(bytes);
        let taken = controller.take_text(epoch, text);
        recorder.record_text(now, epoch, text.get(..taken).unwrap_or_default(), controller);
        line_reader.pass(taken);
        self.line_bytes_out = self.line_bytes_out.wrapping_add(taken as u32);
        taken > 0
    }

    #[inline(always)]
    fn next_line_byte(&mut self) -> Option<LineByte> {
        if self.waits_for_erase() {
            return None;
        }
        if let Some(job) = &mut self.job {
            let byte = *job.text.get(job.next)?;
            job.next += 1;
            if job.next == job.text.len() {
                self.controller.input_ended();
            }
            return Some(LineByte { byte, epoch: 0, damaged: false });
        }
        if !self.lines_wait() {
            return None;
        }
        let byte = self.line_reader.next(|| self.ends.lines.try_recv().ok())?;
        self.line_bytes_out = self.line_bytes_out.wrapping_add(1);
        Some(byte)
    }

    fn next_old_byte(&mut self) -> Option<LineByte> {
        if self.job.is_some() || !self.lines_wait() {
            return None;
        }
        let byte = self.line_reader.peek(|| self.ends.lines.try_recv().ok())?;
        if !self.controller.is_old(byte) {
            return None;
        }
        self.line_reader.pass(1);
        self.line_bytes_out = self.line_bytes_out.wrapping_add(1);
        Some(byte)
    }

    #[inline(always)]
    fn record(&mut self, now: Instant, event: &Event<AXES>) {
        self.recorder.record(now, event, self.controller);
    }

    #[inline(always)]
    fn record_more(&mut self) {
        self.recorder.more_waits();
    }

    #[inline(always)]
    fn make_room(&mut self, took: bool) -> bool {
        // Call the serial task only here, when the round has emptied the queue. Earlier, the serial task could still
        // find the last message in the queue, and would leave its own bytes unqueued.
        if took && (self.has_no_room() || self.are_gathered()) {
            boards::call_serial();
        }
        self.send_wiring();
        // `false`, because this function itself queues nothing for the controller. The serial task queues the waiting
        // bytes and then wakes this task.
        false
    }

    #[inline(always)]
    fn room(&mut self) -> Room {
        let reply = !self.coalescing.holds(self.lines_wait()) && !self.ends.replies.is_full();
        Room { step: !self.ends.segments.is_full(), reply }
    }

    #[inline(always)]
    fn carry(&mut self, output: Output) {
        match output {
            Output::Step(message) => {
                self.recorder.handed(&message);
                // This cannot fail: there is room, and only this task sends.
                let _ = self.ends.segments.try_send(message);
                if STEP.needs_message.load(Ordering::Relaxed) != 0 {
                    boards::call_step();
                }
            }
            Output::Reply(chunk) | Output::Answer(chunk) => {
                let _ = self.ends.replies.try_send(chunk);
                self.coalescing.sent(self.round_began);
                // Call the serial task only after the last reply, so that one run sends all of them.
                if !self.controller.has_answers() || self.ends.replies.is_full() {
                    boards::call_serial();
                }
            }
            Output::Pins(levels) => {
                self.outputs.show(levels);
                Power { level: levels.power, from_segments: levels.power_from_segments }.want();
                boards::call_step();
            }
            Output::Wiring(wiring) => {
                self.outputs.set_enable_invert(wiring.enable_invert);
                self.unsent_wiring = Some(wiring);
                self.send_wiring();
            }
            Output::Stop => {
                shared::ask_for_stop();
                boards::call_step();
            }
            Output::ReadPins { clear_noise: true } => {
                for count in &INPUTS.noise {
                    count.store(0, Ordering::Relaxed);
                }
            }
            Output::ReadPins { clear_noise: false } => self.pins_asked = true,
            Output::ReadRecording { first } => self.read_recording(first),
            Output::Store => {
                self.stored = self.controller.next_store().map(|change| self.settings.store(&change));
            }
            Output::Worked => {}
        }
    }
}
