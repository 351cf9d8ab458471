//! Connects the controller to the simulated board: supplies events and carries out outputs. The module
//! [`oxmill_controller::pump`] determines the order, as on a board.

use crate::boards::AXES;
use crate::marks::Mark;
use crate::simulator::{OUTGOING, Simulator};
use oxmill_controller::Controller;
use oxmill_controller::messages::{
    Event, LineByte, Observed, Output, PinView, Room, SECOND_SWITCH, SEGMENTS_DEPTH, input,
};
use oxmill_controller::pump::{Pump, Source};
use oxmill_controller::units::Instant;

impl Pump<AXES> for Simulator {
    const IS_WOKEN: bool = false;

    fn controller(&mut self) -> &mut Controller<AXES> {
        &mut self.controller
    }

    fn begin(&mut self) -> Instant {
        // Make those bytes of the job ready that the controller may read in this round.
        self.read_job_ahead();
        self.clock.instant()
    }

    fn observed(&mut self) -> Observed {
        // A loaded job takes the place of the host: until its end, the next bytes are always ready.
        let has_job = self.job.0.is_some();
        let queued = if has_job { self.job_ready } else { self.host.queued() };
        let received = if has_job { self.job_ready } else { self.host.received() };
        Observed {
            segments_begun: self.step.segments_begun(),
            step_idle: self.step.is_idle(),
            rx_free: self.board.received_bytes.saturating_sub(queued) as u16,
            received: u16::try_from(received).unwrap_or(u16::MAX),
            // A loaded job has no host that could fall silent, so never count the host as silent.
            activity: self.host.update_activity(has_job),
        }
    }

    fn next_event(&mut self, source: Source) -> Option<Event<AXES>> {
        match source {
            Source::Step => self.step.next_event().map(Event::Step),
            Source::Hosts => self.host.next_event(),
            Source::Commands => self.host.next_command().map(Event::Realtime),
            Source::Inputs => self.inputs.next_change().map(Event::Signals),
            Source::Pins => std::mem::take(&mut self.pins_asked).then(|| Event::Pins(self.view_of_pins())),
            Source::Store => self.stored.take().map(|stored| if stored { Event::Stored } else { Event::StoreFailed }),
        }
    }

    fn next_line_byte(&mut self) -> Option<LineByte> {
        match &mut self.job.0 {
            Some(job) => job.next_byte().map(|byte| LineByte { byte, epoch: 0, damaged: false }),
            None => self.host.next_line_byte(),
        }
    }

    fn next_old_byte(&mut self) -> Option<LineByte> {
        let byte = if self.job.0.is_none() { self.host.line_byte_ahead()? } else { return None };
        if self.controller.is_old(byte) { self.host.next_line_byte() } else { None }
    }

    fn record(&mut self, now: Instant, event: &Event<AXES>) {
        self.recorder.record(now, event, &self.controller);
    }

    fn record_more(&mut self) {
        self.recorder.more_waits();
    }

    fn make_room(&mut self, _took: bool) -> bool {
        self.host.waits() && self.receive()
    }

    fn room(&mut self) -> Room {
        // `room` is called before each output, so also before the first output of a line. None of the line's moves is
        // queued at that time, so number the moves here.
        self.mark_line();
        Room { step: self.step.queued() < SEGMENTS_DEPTH, reply: self.outgoing.len() < OUTGOING }
    }

    fn carry(&mut self, output: Output) {
        match output {
            Output::Step(message) => {
                self.recorder.handed(&message);
                let number = self.controller.handed_line_number();
                let mark = self.marks.as_mut().map_or_else(Mark::default, |marks| marks.of(number));
                self.step.queue(message, mark, &self.clock, &mut self.world);
            }
            Output::Stop => self.stop(),
            Output::Reply(chunk) | Output::Answer(chunk) => {
                self.outgoing.extend_from_slice(chunk.as_bytes());
                if let Some(job) = &mut self.job.0 {
                    job.answered(chunk.as_bytes());
                }
            }
            Output::Pins(outputs) => self.step.show(outputs, &self.clock, &mut self.world),
            Output::Wiring(wiring) => {
                self.wiring = Some(wiring);
                self.world.machine.wire(&wiring);
                self.inputs.wire(&wiring);
                self.step.wire(&wiring);
                self.settle_inputs();
                self.learn_resolution();
            }
            Output::ReadPins { clear_noise: true } => self.inputs.clear_noise(),
            Output::ReadPins { clear_noise: false } => self.pins_asked = true,
            Output::ReadRecording { first } => self.read_recording(first),
            // If the store cannot be written, the controller reports it to the host.
            Output::Store => {
                let change = self.controller.next_store();
                self.stored = change.map(|change| self.store.apply(&change).is_ok());
            }
            Output::Worked => {}
        }
    }
}

impl Simulator {
    /// Carries out a part of `$REC`: passes the next part of the recording to the controller, in the same form as on a
    /// board. `first`: begin at the start of the recording.
    fn read_recording(&mut self, first: bool) {
        let Simulator { controller, recorder, store, board, .. } = self;
        let record = |number| store.records().into_iter().nth(usize::from(number));
        recorder.read(first, (board.name, board.step_clock_hz), record, |piece| controller.recorded(piece));
    }

    /// Returns the state of the input pins, and which of them this machine has. Limit switches, the inputs for programs
    /// (M66) and the at-speed input exist as in the profile of the board. All other inputs always exist.
    fn view_of_pins(&self) -> PinView {
        const { assert!(input::COUNT == 17) };
        let axes = (1 << self.board.axes) - 1;
        let others = 0x7F << input::PROBE | u32::from(self.board.has_at_speed) << input::AT_SPEED;
        let [_, inputs] = self.board.program_pins;
        let program = [input::PROGRAM, input::SECOND_PROGRAM].into_iter().take(usize::from(inputs));
        let fitted = program.fold(axes | u32::from(SECOND_SWITCH) | others, |word, bit| word | 1 << bit);
        PinView { fitted, low: self.inputs.low(), noise: self.inputs.noise() }
    }
}
