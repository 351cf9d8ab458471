//! The control task: carries to the controller what other tasks have queued for it, and carries out what the controller
//! decides, in the order of [`oxmill_controller::pump`].

use crate::boards::{self, AXES};
use crate::clock::Clock;
use crate::flash::Settings;
use crate::last_words::{self, Whereabouts};
use crate::outputs::Outputs;
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
use oxmill_controller::{Coalescing, Controller, LineReader, Owed};
use rtic_sync::channel::{Receiver, Sender};
use rtic_sync::signal::SignalWriter;

/// While the queue to the step task is full, how soon to look again: short segments leave it faster than the controller's
/// own wake-up expects.
const FULL_QUEUE_WAKEUP: Duration = Duration::from_ticks(500);

/// The controller of this board.
pub type BoardController = Controller<AXES>;

/// The ends of the channels that `control` holds.
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

/// Everything the task owns.
pub struct Control {
    controller: &'static mut BoardController,
    ends: Ends,
    outputs: Outputs,
    settings: Settings,
    recorder: Recorder<&'static mut [Page]>,
    clock: Clock,
    /// When the round began.
    round_began: Instant,
    line_reader: LineReader,
    /// Line bytes given to the controller since power-up (wrapping).
    line_bytes_out: u32,
    /// `hosts_came` and `hosts_went` of [`SERIAL`] as they were.
    hosts_came: u8,
    hosts_went: u16,
    job: Option<Job>,
    /// Wiring facts for which there was no room.
    unsent_wiring: Option<Wiring>,
    /// Line bytes queued when the round began: those after them belong to a later one.
    lines_in: u32,
    /// Commands were owed when the round began; taken, and still to be told.
    owes: bool,
    owed: Owed,
    coalescing: Coalescing,
    /// Whether the last record was stored, still to be told.
    stored: Option<bool>,
    /// Inputs that the board has; the controller has asked to see them.
    fitted: u32,
    pins_asked: bool,
    /// There will soon be no room for settings without an erase. Changes between rounds only.
    wants_erase_soon: bool,
}

/// A preloaded job and how far it has been read.
struct Job {
    text: &'static [u8],
    next: usize,
}

impl Control {
    /// Ready to start.
    pub fn new(
        controller: &'static mut BoardController,
        ends: Ends,
        outputs: Outputs,
        settings: Settings,
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
            owes: false,
            owed: Owed::default(),
            coalescing: Coalescing::default(),
            stored: None,
            fitted,
            pins_asked: false,
            wants_erase_soon: false,
        }
    }

    /// Power-up is complete.
    pub fn start(&mut self) {
        let now = self.clock.now();
        self.controller.start(now);
    }

    /// Pumps until there is nothing to do, and sets the alarm for the next time. A function of its own, so that the virtual
    /// board can put an endless loop in its place.
    #[inline(never)]
    pub fn turn(&mut self) {
        let heard = SERIAL.heard.load(Ordering::Relaxed);
        loop {
            while round(self) || self.release_answers() {}
            self.note_place();
            if !self.erase_ahead() {
                break;
            }
            // Lines had to wait for it.
        }
        let observed = self.observe();
        if observed.step_idle && self.controller.is_idle() {
            self.recorder.at_rest(self.round_began, self.controller);
        }
        let nothing_waits = observed.received == 0 && self.ends.realtime.is_empty();
        // Whether the answers have gone out, too, the serial task knows.
        shared::set_free(heard, nothing_waits && self.controller.is_free() && observed.step_idle);
        CONTROL.reads_characters.store(self.controller.reads_characters(), Ordering::Relaxed);
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

    /// Whether bytes of lines wait that this round may take.
    #[inline(always)]
    fn lines_wait(&self) -> bool {
        self.line_bytes_out != self.lines_in
    }

    /// Nothing is left to be done for now: answers are not held any longer. Whether there are any.
    #[inline(always)]
    fn release_answers(&mut self) -> bool {
        let are_held = self.coalescing.holds(self.lines_wait()) && self.controller.has_answers();
        if are_held {
            self.coalescing.release(self.round_began);
        }
        are_held
    }

    /// Leaves place and line where a handler that ends the program finds them.
    fn note_place(&mut self) {
        let mut place = [0; 3];
        for (slot, at) in place.iter_mut().zip(self.controller.machine_position().iter()) {
            *slot = at.micrometres();
        }
        let (line, moment) = (self.controller.line_number(), self.round_began.ticks() as u32);
        last_words::note(Whereabouts { place, line, moment });
    }

    /// Erases flash when nothing moves, turns or waits: the processor is stalled for a quarter of a second. What the host
    /// sends in that time is kept (see the board).
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

    /// Hands the wiring facts to the tasks that own the pins; both queues are emptied within a millisecond at rest.
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
        // The order matters: what leaves the queue shows up in the step task in the same handler.
        let queue_empty = self.ends.segments.is_empty();
        let step_idle = queue_empty && STEP.at_rest.load(Ordering::Relaxed);
        let used = SERIAL.bytes_queued.load(Ordering::Relaxed).wrapping_sub(self.line_bytes_out) as usize;
        // A job has its next bytes ready until its end.
        let arrived = SERIAL.bytes_received.load(Ordering::Relaxed);
        let heard = arrived.wrapping_add(SERIAL.bytes_ignored.load(Ordering::Relaxed));
        let received = arrived.wrapping_sub(self.line_bytes_out) as usize;
        let has_job = self.job.as_ref().is_some_and(|job| job.next < job.text.len());
        let (used, received) = if has_job { (LINES_DEPTH, LINES_DEPTH) } else { (used, received) };
        // What has found no room waits in front of a queue that is full, of whatever messages.
        let rx_free = if self.has_no_room() { 0 } else { LINES_DEPTH.saturating_sub(used) as u16 };
        Observed {
            segments_begun: STEP.segments_begun.load(Ordering::Relaxed),
            step_idle,
            rx_free,
            received: received as u16,
            heard: heard as u16,
        }
    }

    /// Something that was received waits for room in a queue.
    fn has_no_room(&self) -> bool {
        SERIAL.bytes_received.load(Ordering::Relaxed) != SERIAL.bytes_queued.load(Ordering::Relaxed)
    }

    /// Bytes of lines are with the serial task, which gathers them for a message until the queue is empty, and it is.
    fn are_gathered(&self) -> bool {
        SERIAL.bytes_queued.load(Ordering::Relaxed) != self.line_bytes_out
            && self.line_reader.ahead().1.is_empty()
            && self.ends.lines.is_empty()
    }

    /// A host that has gone or come since the last call.
    fn next_of_hosts(&mut self) -> Option<Event<AXES>> {
        // In this order, for one may go and another come between the two: then it comes with the next round.
        let (came, went) = (SERIAL.hosts_came.load(Ordering::Relaxed), SERIAL.hosts_went.load(Ordering::Relaxed));
        if went != self.hosts_went {
            self.hosts_went = went;
            return Some(Event::Disconnected(went));
        }
        (came != core::mem::replace(&mut self.hosts_came, came)).then_some(Event::Connected)
    }

    /// The next command: of those queued, then of those that were owed for want of room when the round began. What is
    /// queued once these have been taken comes after them.
    fn next_command(&mut self) -> Option<Realtime> {
        if let Some(command) = self.owed.pop() {
            return Some(command);
        }
        if !self.ends.realtime.is_empty()
            && let Ok(command) = self.ends.realtime.try_recv()
        {
            return Some(command);
        }
        if core::mem::take(&mut self.owes) {
            self.owed = shared::take_owed();
        }
        self.owed.pop()
    }

    /// A host that sends one setting after the other is made to wait before there is no room for them.
    #[inline(always)]
    fn waits_for_erase(&self) -> bool {
        self.wants_erase_soon && self.controller.is_nearly_quiet()
    }

    /// The next piece of the recording.
    #[inline(never)]
    fn read_recording(&mut self, first: bool) {
        let Control { controller, recorder, settings, .. } = self;
        let board = (boards::PROFILE.name, boards::PROFILE.step_clock_hz);
        recorder.read(first, board, |number| settings.record(number), |piece| controller.recorded(piece));
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
        self.owes = shared::owes();
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
        // To see that a queue is empty takes half as long as to see that nothing can be received.
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
        // Behind all that this round has taken: the serial task may have found the last message still on its way.
        if took && (self.has_no_room() || self.are_gathered()) {
            boards::call_serial();
        }
        self.send_wiring();
        // What comes wakes this task.
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
                // There is room, and no other task sends.
                let _ = self.ends.segments.try_send(message);
                if STEP.wants.load(Ordering::Relaxed) != 0 {
                    boards::call_step();
                }
            }
            Output::Reply(chunk) | Output::Answer(chunk) => {
                let _ = self.ends.replies.try_send(chunk);
                self.coalescing.sent(self.round_began);
                // What follows comes with the same run.
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
