//! The pump: brings the controller what has happened, and carries away what it wants done.
//!
//! The order in which it does so is a rule, and the simulator follows the same one, so that both make the same steps of
//! the same bytes:
//! 1. what the step task has done; 2. everything that has happened; 3. bytes of lines, as many as the controller wants;
//! 4. what the controller puts out. After each message to the step task it begins again with 1, so the look-ahead is as
//!    full as the bytes allow before each segment, and the steps do not depend on the speed of the CPU.

use crate::boards::{self, AXES, BLOCKS};
use crate::clock::Clock;
use crate::crossing::{
    self, CONTROL_ASKED, HEARD, HOSTS_CAME, HOSTS_WENT, INPUTS_FITTED, INPUTS_LOW, LAST_LINE, LAST_PLACE,
    LINE_BYTES_IN, LINE_BYTES_RECEIVED, NOISE, Power, RX_HELD, SEGMENTS_BEGUN, STEP_AT_REST, STEP_WANTS,
};
use crate::flash::Settings;
use crate::outputs::Outputs;
use crate::{ask_step, pend_serial, pend_step};
use core::sync::atomic::Ordering;
use oxmill_controller::Controller;
use oxmill_controller::messages::{
    Chunk, EVENTS_DEPTH, Event, LINES_DEPTH, LineByte, Observed, Output, PinView, REALTIME_DEPTH, REPLIES_DEPTH,
    Realtime, Room, SEGMENTS_DEPTH, SIGNALS_DEPTH, Sensed, StepEvent, ToStep, Wiring, input,
};
use oxmill_controller::units::Duration;
use rtic_sync::channel::{Receiver, Sender};

/// While the queue to the step task is full, how soon to look again: short segments leave it faster than the controller's
/// own wake-up expects.
const FULL_QUEUE_WAKEUP: Duration = Duration::from_ticks(500);

/// The controller of this board.
pub type BoardController = Controller<AXES, BLOCKS>;

/// The ends of the channels that `control` holds.
pub struct Ends {
    /// From `serial`.
    pub realtime: Receiver<'static, Realtime, REALTIME_DEPTH>,
    /// From `serial`.
    pub lines: Receiver<'static, LineByte, LINES_DEPTH>,
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
    clock: Clock,
    /// Bytes taken out of the line queue since power-up (wrapping).
    line_bytes_out: u32,
    /// [`HOSTS_CAME`] and [`HOSTS_WENT`] as they were.
    hosts_came: u8,
    hosts_went: u16,
    job: Option<Job>,
    /// Wiring facts for which there was no room.
    unsent_wiring: Option<Wiring>,
}

/// A preloaded job and how far it has been read.
struct Job {
    text: &'static [u8],
    next: usize,
}

impl Control {
    /// Ready to start.
    pub fn new(controller: &'static mut BoardController, ends: Ends, outputs: Outputs, settings: Settings) -> Control {
        let job = boards::preloaded_job().map(|text| Job { text, next: 0 });
        Control {
            controller,
            ends,
            outputs,
            settings,
            clock: Clock::new(),
            line_bytes_out: 0,
            hosts_came: 0,
            hosts_went: 0,
            job,
            unsent_wiring: None,
        }
    }

    /// Power-up is complete.
    pub fn start(&mut self) {
        let now = self.clock.now();
        self.controller.start(now);
    }

    /// Pumps until there is nothing to do, and sets the alarm for the next time.
    pub fn turn(&mut self) {
        let heard = HEARD.load(Ordering::Relaxed);
        while self.pass() {}
        self.note_place();
        if self.erase_ahead() {
            // Lines that had to wait for it.
            while self.pass() {}
        }
        let observed = self.observed();
        let nothing_waits = observed.received == 0 && self.ends.realtime.is_empty();
        let answered = self.controller.is_idle() && self.ends.replies.is_empty();
        crossing::set_free(heard, nothing_waits && answered && observed.step_idle);
        if self.job.as_ref().is_some_and(|job| job.next == job.text.len())
            && self.controller.is_idle()
            && self.observed().step_idle
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

    /// One round of the rule; whether another may find more to do.
    fn pass(&mut self) -> bool {
        CONTROL_ASKED.store(false, Ordering::Relaxed);
        let now = self.clock.now();
        self.observe();
        while let Ok(event) = self.ends.events.try_recv() {
            // A segment may have begun before what it tells of.
            self.observe();
            self.controller.event(now, Event::Step(event));
        }
        // Of the line bytes only those that are in their queue now are taken below: hosts and commands that came before them have
        // been taken by then, so a report that was asked for before a line comes before its answer.
        let lines_in = LINE_BYTES_IN.load(Ordering::Relaxed);
        let (came, went) = (HOSTS_CAME.load(Ordering::Relaxed), HOSTS_WENT.load(Ordering::Relaxed));
        if went != self.hosts_went {
            self.observe();
            self.hosts_went = went;
            self.controller.event(now, Event::Disconnected(went));
        }
        if came != self.hosts_came {
            self.hosts_came = came;
            self.controller.event(now, Event::Connected);
        }
        let (mut made_room, owes) = (false, crossing::owes());
        while let Ok(command) = self.ends.realtime.try_recv() {
            made_room = true;
            self.observe();
            self.controller.event(now, Event::Realtime(command));
        }
        if owes {
            made_room = true;
            self.observe();
            for command in crossing::take_owed().commands() {
                self.controller.event(now, Event::Realtime(command));
            }
        }
        while let Ok(sensed) = self.ends.signals.try_recv() {
            self.observe();
            self.controller.event(now, Event::Signals(sensed));
        }
        let mut took = false;
        // A host that sends one setting after the other is made to wait before there is no room for them.
        while self.controller.wants_line()
            && !(self.settings.wants_erase_soon() && self.controller.is_nearly_quiet())
            && let Some(byte) = self.next_byte(lines_in)
        {
            took = true;
            self.controller.event(now, Event::Line(byte));
        }
        if (made_room || took) && RX_HELD.load(Ordering::Relaxed) {
            pend_serial();
        }
        self.send_wiring();
        loop {
            let room = Room { step: !self.ends.segments.is_full(), reply: !self.ends.replies.is_full() };
            let Some(output) = self.controller.output(now, room) else { return took };
            match output {
                Output::Step(message) => {
                    // There is room, and nobody else sends.
                    let _ = self.ends.segments.try_send(message);
                    if STEP_WANTS.load(Ordering::Relaxed) != 0 {
                        ask_step();
                    }
                    return true;
                }
                Output::Reply(chunk) => {
                    let _ = self.ends.replies.try_send(chunk);
                    pend_serial();
                }
                Output::Pins(levels) => {
                    self.outputs.show(levels);
                    Power { level: levels.power, from_segments: levels.power_from_segments }.want();
                    ask_step();
                }
                Output::Wiring(wiring) => {
                    self.outputs.set_enable_invert(wiring.enable_invert);
                    self.unsent_wiring = Some(wiring);
                    self.send_wiring();
                }
                Output::Stop => {
                    crossing::ask_for_stop();
                    pend_step();
                }
                Output::ReadPins { clear_noise: true } => {
                    for count in &NOISE {
                        count.store(0, Ordering::Relaxed);
                    }
                }
                Output::ReadPins { clear_noise: false } => {
                    let view = PinView {
                        fitted: INPUTS_FITTED.load(Ordering::Relaxed),
                        low: INPUTS_LOW.load(Ordering::Relaxed),
                        noise: core::array::from_fn::<_, { input::COUNT }, _>(|bit| {
                            NOISE.get(bit).map_or(0, |count| count.load(Ordering::Relaxed))
                        }),
                    };
                    self.controller.event(now, Event::Pins(view));
                }
                Output::Store(change) => {
                    let event = self.settings.store(&change);
                    // Bytes may have come while the processor stood.
                    pend_serial();
                    self.controller.event(now, event);
                }
                // Events first: a long arc must not keep a stop waiting.
                Output::Worked => return true,
            }
        }
    }

    /// Leaves place and line where a handler that ends the program finds them.
    fn note_place(&mut self) {
        // 0.1 nm to micrometres: targets lie within 50 m.
        for (slot, place) in LAST_PLACE.iter().zip(self.controller.machine_position().iter()) {
            slot.store((place.0 / 10_000) as i32, Ordering::Relaxed);
        }
        LAST_LINE.store(self.controller.line_number(), Ordering::Relaxed);
    }

    /// Erases flash when nothing moves, turns or waits: the processor stands for a quarter of a second. What the host
    /// sends in that time is kept (see the board).
    fn erase_ahead(&mut self) -> bool {
        let observed = self.observed();
        let nothing_waits =
            (observed.received == 0 || self.settings.wants_erase_soon()) && self.ends.realtime.is_empty();
        let erases = self.settings.wants_erase() && observed.step_idle && nothing_waits && self.controller.is_quiet();
        if erases {
            self.settings.erase();
            pend_serial();
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
            ask_step();
        }
    }

    /// What has been received before an event is taken out of its queue, has been received now.
    fn observe(&mut self) {
        let observed = self.observed();
        self.controller.observe(observed);
    }

    fn observed(&self) -> Observed {
        // The order matters: what leaves the queue shows up in the step task in the same handler.
        let queue_empty = self.ends.segments.is_empty();
        let step_idle = queue_empty && STEP_AT_REST.load(Ordering::Relaxed);
        let used = LINE_BYTES_IN.load(Ordering::Relaxed).wrapping_sub(self.line_bytes_out) as usize;
        // A job has its next bytes ready until its end.
        let received = LINE_BYTES_RECEIVED.load(Ordering::Relaxed).wrapping_sub(self.line_bytes_out) as usize;
        let has_job = self.job.as_ref().is_some_and(|job| job.next < job.text.len());
        let (used, received) = if has_job { (LINES_DEPTH, LINES_DEPTH) } else { (used, received) };
        Observed {
            segments_begun: SEGMENTS_BEGUN.load(Ordering::Relaxed),
            step_idle,
            rx_free: LINES_DEPTH.saturating_sub(used) as u16,
            received: received as u16,
        }
    }

    /// The next byte of a line, of the first `lines_in` that were queued.
    fn next_byte(&mut self, lines_in: u32) -> Option<LineByte> {
        if let Some(job) = &mut self.job {
            let byte = *job.text.get(job.next)?;
            job.next += 1;
            if job.next == job.text.len() {
                self.controller.input_ended();
            }
            return Some(LineByte { byte, epoch: 0, damaged: false });
        }
        if self.line_bytes_out == lines_in {
            return None;
        }
        let byte = self.ends.lines.try_recv().ok()?;
        self.line_bytes_out = self.line_bytes_out.wrapping_add(1);
        Some(byte)
    }
}
