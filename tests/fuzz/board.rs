//! A model of a board for the fuzz targets, without the simulator. It has a controller with its queues, the step
//! generator, a store and a clock. A fuzz target can delay events, hold them back, or send false ones.
//! [`oxmill_controller::pump`] moves events and outputs, as on every board.
//!
//! Invariants, for any input:
//! - A round (one pass of the pump) makes a bounded number of outputs.
//! - After a bounded number of rounds, a controller that accepts lines has nothing left to do.
//! - No wake-up is in the past.
//! - While the machine is locked, no motion is sent to the step task, and no step is made.
//! - Each line is answered once.

use super::work;
use oxmill_controller::memory::Memory;
use oxmill_controller::messages::{
    Event, HOST_CHANGED, LINES_DEPTH, LineByte, LineBytes, Observed, Output, PinView, REALTIME_DEPTH, REPLIES_DEPTH,
    Realtime, Record, Restart, Room, SEGMENTS_DEPTH, STORE_DAMAGED, Sensed, Signals, StepEvent, Store, ToStep, input,
};
use oxmill_controller::pump::{Pump, Source, round};
use oxmill_controller::recorder::{Page, Recorder};
use oxmill_controller::units::Instant;
use oxmill_controller::{Controller, Profile, StepRates, Stepper};
use std::collections::{BTreeMap, VecDeque};

pub const AXES: usize = 3;
const BLOCKS: usize = 16;
/// Maximum number of outputs in a round (one pass of the pump), not counting the [`REPLIES_DEPTH`] texts for the host.
/// Such an output changes, for example, a pin or the wiring of the pins.
const MOST_QUIET_OUTPUTS: usize = 8;
/// Maximum number of rounds without time passing. A program can loop for ever without a move, so the board runs no
/// more rounds than this.
const MOST_ROUNDS: usize = 3_000;
/// Maximum number of control-flow edges in a round; the highest count when this was chosen: 24,963.
const MOST_WORK: u64 = 100_000;
/// Maximum number of ticks and wake-ups in a session. After these, time no longer advances.
const MOST_MOMENTS: u32 = 60_000;

/// Bits of [`Board::late`], one for each source of events. While the bit of a source is set, its events do not reach
/// the controller.
pub mod late {
    pub const STEP: u8 = 1;
    pub const COMMANDS: u8 = 2;
    pub const STORE: u8 = 4;
    pub const INPUTS: u8 = 8;
    /// The host does not read the replies.
    pub const REPLIES: u8 = 16;
    pub const ALL: u8 = 31;
}

/// Returns whether to print what an input does (`OXMILL_FUZZ_SHOW`).
pub fn shows() -> bool {
    static SHOWS: std::sync::LazyLock<bool> =
        std::sync::LazyLock::new(|| std::env::var_os("OXMILL_FUZZ_SHOW").is_some());
    *SHOWS
}

/// A byte of a line, and `true` if the controller must answer that line. A line that the controller may have dropped,
/// for example at a reset, need not be answered.
type Queued = (LineByte, bool);

#[derive(Clone)]
pub struct Board {
    pub controller: Box<Controller<AXES>>,
    pub stepper: Box<Stepper<AXES>>,
    /// Time in microseconds, which are the ticks of the step clock.
    now: u64,
    queue: VecDeque<ToStep>,
    due: Option<u64>,
    directions: u8,
    /// Net steps of the motors.
    pub motors: [i32; AXES],
    pub reports: VecDeque<StepEvent<AXES>>,
    commands: VecDeque<Realtime>,
    lines: VecDeque<Queued>,
    levels: VecDeque<Sensed>,
    pub hosts: VecDeque<Event<AXES>>,
    pub answers: VecDeque<Event<AXES>>,
    pins_asked: bool,
    /// Records the events and lines that the controller receives. It has only four pages, so that short inputs also
    /// fill them.
    recorder: Recorder<Vec<Page>>,
    pub late: u8,
    epoch: u16,
    hosts_gone: u16,
    signals: Signals,
    sensed: Sensed,
    armed: u32,
    /// `true`: the store answers each change with [`Event::StoreFailed`] and stores nothing.
    pub store_fails: bool,
    pub records: BTreeMap<u16, Vec<u8>>,
    said: Vec<u8>,
    round_replies: usize,
    moments: u32,
    /// `true` if a real board could send all events of this session. If `false`, some events are false. Then the
    /// controller only has to survive, and invariants that rely on true events are not checked.
    pub is_true: bool,
    /// Minimum and maximum positions of the motors, in steps, while soft limits are on and the position is trusted.
    /// `None`: the positions are not checked.
    pub travel: Option<[(i32, i32); AXES]>,
    /// Maximum number of rounds without time passing.
    pub most_rounds: usize,
    /// Number of times that the controller still had work to do after `most_rounds` rounds.
    pub unended: usize,
    book: Book,
}

/// Returns `true` if an output line is the answer to a G-code line: `ok` or `error:`. While lines are checked
/// (`$LC=ON`), an answer begins with a colon, a line number and a checksum.
fn is_answer(line: &[u8]) -> bool {
    match line.strip_prefix(b":") {
        None => line == b"ok" || line.starts_with(b"error:"),
        Some(checked) => {
            checked.ends_with(b"ok") || checked.ends_with(b"known") || checked.windows(6).any(|part| part == b"error:")
        }
    }
}

/// Counts the answers to lines, and the minimum and maximum number of answers that the lines allow.
#[derive(Clone, Debug, Default)]
struct Book {
    /// `true` if the controller must answer the line that is being read. A line of which the controller may have
    /// dropped a part, for example at a reset, need not be answered.
    is_sure: bool,
    last_byte: u8,
    /// Minimum number of answers since the previous [`Book::settle`]: one for each line that has been read and must be
    /// answered.
    least: usize,
    /// Maximum number of answers since the previous [`Book::settle`]: one for each line end that has been read.
    most: usize,
    /// Number of answers that the controller has sent since the previous [`Book::settle`].
    come: usize,
    /// Output since the last line end.
    text: Vec<u8>,
    reports: usize,
}

impl Book {
    fn given(&mut self, byte: LineByte, sure: bool) {
        self.is_sure &= sure && !byte.damaged;
        match byte.byte {
            HOST_CHANGED => self.is_sure = true,
            b'\n' | b'\r' => {
                // After a CR, an LF is either the second half of the line end, or the end of an empty line. The
                // controller answers it only in the second case. The model accepts both, so this LF raises only `most`.
                let merged = byte.byte == b'\n' && self.last_byte == b'\r';
                self.most += 1;
                self.least += usize::from(self.is_sure && !merged);
                self.is_sure = true;
            }
            _ => {}
        }
        self.last_byte = byte.byte;
    }

    fn told(&mut self, bytes: &[u8]) {
        for byte in bytes {
            if *byte != b'\n' {
                self.text.push(*byte);
                continue;
            }
            let line = std::mem::take(&mut self.text);
            let line = line.strip_suffix(b"\r").unwrap_or(&line);
            assert!(line.is_ascii(), "{:?}", String::from_utf8_lossy(line));
            self.come += usize::from(is_answer(line));
            self.reports += usize::from(line.starts_with(b"<") && line.ends_with(b">"));
        }
    }

    /// Checks the number of answers after all lines have been carried out.
    fn settle(&mut self) {
        assert!(
            (self.least..=self.most).contains(&self.come),
            "{} answers to {} lines, {} of which count for sure",
            self.come,
            self.most,
            self.least
        );
        (self.least, self.most, self.come) = (0, 0, 0);
    }
}

impl Board {
    /// Returns a board that has just been powered up. `records`: the contents of its store, as keys and values.
    pub fn new(records: BTreeMap<u16, Vec<u8>>) -> Board {
        let profile = Profile {
            name: "test",
            step_clock_hz: 1_000_000,
            rates: StepRates { safe_hz: 100_000, least_pulse_tenths: 5 },
            axes: AXES,
            has_second_motor: false,
            has_at_speed: true,
            program_pins: [0; 2],
            most_baud: 1_000_000,
            oscillator_mhz: 0,
            has_store: true,
            has_loader: false,
        };
        let mut controller =
            Box::new(Controller::new(profile, Memory::on_heap(&profile, BLOCKS, oxmill_controller::gcode::LEAST_HELD)));
        for (key, value) in &records {
            let value = heapless::Vec::from_slice(value).expect("a value that was stored");
            controller.restore(&oxmill_controller::messages::Record { key: *key, value });
        }
        controller.start(Instant::from_ticks(0));
        let mut board = Board {
            controller,
            stepper: Box::new(Stepper::new()),
            now: 0,
            queue: VecDeque::new(),
            due: None,
            directions: 0,
            motors: [0; AXES],
            reports: VecDeque::new(),
            commands: VecDeque::new(),
            lines: VecDeque::new(),
            levels: VecDeque::from([Sensed::default()]),
            hosts: VecDeque::new(),
            answers: VecDeque::new(),
            pins_asked: false,
            recorder: Recorder::begin(vec![Page::EMPTY; 4], &Restart::POWER),
            late: 0,
            epoch: 0,
            hosts_gone: 0,
            signals: Signals::NONE,
            sensed: Sensed::default(),
            armed: 0,
            store_fails: false,
            records,
            said: Vec::new(),
            round_replies: 0,
            moments: 0,
            is_true: true,
            travel: None,
            most_rounds: MOST_ROUNDS,
            unended: 0,
            book: Book { is_sure: true, ..Book::default() },
        };
        board.settle();
        board
    }

    // Input

    /// Returns whether there is room for a line of this length.
    pub fn has_room(&self, bytes: usize) -> bool {
        self.lines.len() + bytes <= LINES_DEPTH
    }

    /// Returns whether the controller has read all queued lines and accepts the next one.
    pub fn is_read(&self) -> bool {
        self.lines.is_empty() && self.controller.wants_line()
    }

    pub fn send(&mut self, bytes: &[u8]) {
        if self.has_room(bytes.len()) {
            // 0x18 cannot be part of a line, because the link takes it as a reset. In the queue it means
            // [`HOST_CHANGED`].
            let bytes = bytes.iter().filter(|byte| **byte != HOST_CHANGED);
            self.lines.extend(bytes.map(|byte| (LineByte { byte: *byte, epoch: self.epoch, damaged: false }, true)));
        }
    }

    /// Marks the most recently queued byte as damaged, as the link does after lost bytes.
    pub fn damage(&mut self) {
        if let Some((byte, _)) = self.lines.back_mut().filter(|(byte, _)| byte.byte != HOST_CHANGED) {
            byte.damaged = true;
        }
    }

    pub fn command(&mut self, command: Realtime) {
        if self.commands.len() >= REALTIME_DEPTH {
            return;
        }
        self.commands.push_back(command);
        if command.opens_epoch() {
            self.epoch = self.epoch.wrapping_add(1);
            self.forget_lines();
        }
        if command == Realtime::Reset {
            self.stop();
        }
    }

    /// Records that the queued lines and the line in progress need not be answered, because the controller can have
    /// dropped them.
    fn forget_lines(&mut self) {
        self.lines.iter_mut().for_each(|(_, sure)| *sure = false);
        self.book.is_sure = false;
    }

    /// Sets the levels of the inputs. If an armed input has just become active, stops the step task.
    pub fn inputs(&mut self, word: u32) {
        let risen = word & !self.signals.word();
        self.signals = Signals::of_word(word);
        let tripped = risen & self.armed;
        if tripped != 0 {
            self.sensed.trips = self.sensed.trips.wrapping_add(1);
            self.sensed.tripped |= tripped;
            self.stop();
        }
        self.sensed.signals = self.signals;
        self.levels.clear();
        self.levels.push_back(self.sensed);
    }

    /// Sends a false input report.
    pub fn pretend_inputs(&mut self, sensed: Sensed) {
        self.levels.push_back(sensed);
        self.forget_lines();
    }

    pub fn host_goes(&mut self) {
        self.hosts_gone = self.hosts_gone.wrapping_add(1);
        self.hosts.push_back(Event::Disconnected(self.hosts_gone));
        self.forget_lines();
        let cut = LineByte { byte: HOST_CHANGED, epoch: self.hosts_gone, damaged: false };
        self.lines.push_back((cut, false));
    }

    /// Stops the step task at once and queues its report for the controller.
    pub fn stop(&mut self) {
        let event = self.stepper.stop([0; AXES]);
        self.stopped(event);
    }

    fn stopped(&mut self, event: StepEvent<AXES>) {
        self.reports.push_back(event);
        self.due = None;
        self.load();
    }

    /// Simulates wrong pulses during motion: the motor of an axis makes `steps` steps too many, or too few if `steps`
    /// is negative. The step task then stops and reports the error. At rest, nothing happens.
    pub fn miscount(&mut self, axis: usize, steps: i32) {
        if self.due.is_some()
            && let StepEvent::Stopped { stops, position, .. } = self.stepper.stop([0; AXES])
        {
            self.motors[axis % AXES] += steps;
            self.stopped(StepEvent::Miscounted { stops, position });
        }
    }

    // Time

    /// Returns whether the clock may still advance: a session has at most [`MOST_MOMENTS`] ticks and wake-ups.
    pub fn has_time(&self) -> bool {
        self.moments < MOST_MOMENTS
    }

    pub fn now(&self) -> Instant {
        Instant::from_ticks(self.now)
    }

    fn load(&mut self) {
        while self.stepper.has_room()
            && let Some(message) = self.queue.pop_front()
        {
            self.stepper.load(message);
        }
        if self.due.is_none() && !self.stepper.is_idle() {
            self.due = Some(self.now);
        }
    }

    fn assert_may_move(&self, what: &str) {
        let Self { controller, .. } = self;
        assert!(!controller.is_locked() && controller.alarm().is_none(), "{what} in a lock, {:?}", controller.alarm());
    }

    /// Runs a tick of the step generator. Returns whether the controller should run, because motion has ended or there
    /// is a report.
    fn tick(&mut self) -> bool {
        let tick = self.stepper.tick();
        if tick.steps != 0 && self.is_true && self.reports.is_empty() {
            self.assert_may_move("a step");
        }
        for (axis, motor) in self.motors.iter_mut().enumerate() {
            if tick.steps >> axis & 1 != 0 {
                *motor += if self.directions >> axis & 1 != 0 { -1 } else { 1 };
            }
        }
        if let Some(travel) = self.travel.filter(|_| tick.steps != 0 && self.controller.is_trusted()) {
            let is_within = self.motors.iter().zip(travel).all(|(place, (least, most))| (least..=most).contains(place));
            assert!(is_within, "a step to {:?}, out of the travel {travel:?}", self.motors);
        }
        self.directions = tick.directions;
        self.due = (tick.interval != 0).then(|| self.now + u64::from(tick.interval));
        if self.stepper.is_watching() && self.stepper.probe(self.signals.probe) {
            self.reports.push_back(self.stepper.probed_event());
        }
        if tick.underrun {
            let event = self.stepper.underrun_event();
            self.stopped(event);
            return true;
        }
        self.load();
        self.due.is_none() || !self.reports.is_empty()
    }

    /// Lets time pass. The controller runs at its wake-ups, unless it is `stalled`.
    pub fn pass(&mut self, time: u64, stalled: bool) {
        let end = self.now.saturating_add(time);
        while self.has_time() {
            let wakeup = self.controller.next_wakeup().map(|at| at.ticks()).filter(|_| !stalled);
            let next = [self.due, wakeup].into_iter().flatten().min().filter(|next| *next < end);
            let Some(next) = next else { break };
            self.now = self.now.max(next);
            self.moments += 1;
            let look = self.due.is_some_and(|due| due <= self.now) && self.tick();
            if !stalled && (look || wakeup.is_some_and(|at| at <= self.now)) {
                self.settle();
            }
        }
        if self.has_time() {
            self.now = end;
        }
        self.settle();
    }

    /// If the machine is at rest, jumps ahead in time and skips the wake-ups in between.
    pub fn leap(&mut self, time: u64) {
        if self.due.is_none() {
            self.now += time;
            self.settle();
        }
    }

    // Controller

    /// Runs rounds (passes of the pump) until there is nothing to do, at most `most_rounds` of them.
    pub fn settle(&mut self) {
        for _ in 0..self.most_rounds {
            self.round_replies = 0;
            let begun = self.stepper.segments_begun();
            if !work::at_most(MOST_WORK, || round(self)) {
                if self.controller.reboot_due().is_some() {
                    self.reboot();
                    return;
                }
                if self.controller.is_idle() && self.due.is_none() && self.queue.is_empty() && self.stepper.is_idle() {
                    self.recorder.at_rest(self.now(), &self.controller);
                }
                if self.late & late::REPLIES == 0 && self.controller.wants_line() {
                    self.book.settle();
                }
                let wakeup = self.controller.next_wakeup();
                // A wake-up may be in the past in two cases. First, while a stop is pending, because a real board would
                // receive it before the next instruction. Second, after false events, because the controller may wait
                // for a stop that never comes.
                let is_owed = !self.is_true || self.late & late::STEP != 0 && !self.reports.is_empty();
                assert!(is_owed || wakeup.is_none_or(|at| at > self.now()), "{wakeup:?} is past at {}", self.now);
                return;
            }
            assert_eq!(begun, self.stepper.segments_begun(), "time stands still in a round");
        }
        // The controller still has work after so many rounds. So it must be running a loop of a program: during a loop
        // it accepts no line.
        self.unended += 1;
        assert!(!self.controller.wants_line(), "rounds without end");
    }

    /// Restarts the board (`$REBOOT`) as after a power-up. Only the stored records, the clock, unread output, `unended`
    /// and the fields that the fuzz target sets are kept.
    fn reboot(&mut self) {
        let Board { now, late, travel, is_true, store_fails, most_rounds, unended, .. } = *self;
        let (said, records) = (std::mem::take(&mut self.said), std::mem::take(&mut self.records));
        *self = Board::new(records);
        self.said.splice(0..0, said);
        (self.now, self.late, self.travel, self.is_true) = (now, late, travel, is_true);
        (self.store_fails, self.most_rounds, self.unended) = (store_fails, most_rounds, unended);
    }

    /// Returns the controller's output since the previous call.
    pub fn take_said(&mut self) -> String {
        String::from_utf8(std::mem::take(&mut self.said)).expect("ASCII")
    }

    /// Sends a line and returns the output until the controller is idle, or for 1 s at most.
    pub fn ask(&mut self, line: &str) -> String {
        self.take_said();
        self.send(line.as_bytes());
        self.send(b"\n");
        self.settle();
        for _ in 0..40 {
            if self.controller.is_idle() && self.lines.is_empty() {
                break;
            }
            self.pass(25_000, false);
        }
        self.take_said()
    }

    /// Requests a status report and checks that exactly one arrives.
    pub fn look(&mut self) {
        self.settle();
        if self.late & (late::REPLIES | late::COMMANDS) == 0 && self.commands.is_empty() {
            self.book.reports = 0;
            self.command(Realtime::Status);
            self.settle();
            assert_eq!(self.book.reports, 1, "reports to a question");
        }
    }
}

impl Pump<AXES> for Board {
    const IS_WOKEN: bool = false;

    fn controller(&mut self) -> &mut Controller<AXES> {
        &mut self.controller
    }

    fn begin(&mut self) -> Instant {
        self.now()
    }

    fn observed(&mut self) -> Observed {
        let received = self.lines.len() as u16;
        Observed {
            segments_begun: self.stepper.segments_begun(),
            step_idle: self.due.is_none() && self.queue.is_empty() && self.stepper.is_idle(),
            rx_free: (LINES_DEPTH as u16).saturating_sub(received),
            received,
            activity: 0,
        }
    }

    fn next_event(&mut self, source: Source) -> Option<Event<AXES>> {
        let is_late = |bit| self.late & bit != 0;
        match source {
            Source::Step if !is_late(late::STEP) => self.reports.pop_front().map(Event::Step),
            Source::Commands if !is_late(late::COMMANDS) => self.commands.pop_front().map(Event::Realtime),
            Source::Store if !is_late(late::STORE) => self.answers.pop_front(),
            Source::Inputs if !is_late(late::INPUTS) => {
                let sensed = self.levels.pop_front()?;
                self.sensed.tripped = 0;
                if sensed.signals.reset || sensed.signals.emergency_stop || sensed.tripped != 0 {
                    // The controller drops all lines received so far.
                    self.forget_lines();
                    if self.commands.iter().any(|command| command.opens_epoch()) {
                        // A reset, stop or jog cancel is still queued. Until this command arrives, the controller may
                        // hold back a byte that it has read, such as a line end. The command may then drop this byte.
                        // So the lines read so far need not be answered any more.
                        self.book.least = self.book.come;
                    }
                }
                Some(Event::Signals(sensed))
            }
            Source::Hosts => {
                let event = self.hosts.pop_front()?;
                if matches!(event, Event::Disconnected(_)) {
                    self.forget_lines();
                    // A line that the controller has read but not answered need not be answered any more.
                    self.book.least = self.book.come;
                }
                Some(event)
            }
            Source::Pins => std::mem::take(&mut self.pins_asked).then_some(Event::Pins(PinView {
                fitted: u16::MAX.into(),
                low: 0,
                noise: [0; input::COUNT],
            })),
            _ => None,
        }
    }

    fn next_line_byte(&mut self) -> Option<LineByte> {
        let (byte, sure) = self.lines.pop_front()?;
        self.book.given(byte, sure);
        Some(byte)
    }

    fn next_old_byte(&mut self) -> Option<LineByte> {
        let (byte, _) = *self.lines.front()?;
        if !self.controller.is_old(byte) {
            return None;
        }
        self.lines.pop_front();
        // The byte is from before a reset, a stop or a jog cancel: the controller drops its line without an answer.
        self.book.given(byte, false);
        Some(byte)
    }

    /// Passes the next bytes of lines to the controller. At most [`LineBytes::MOST`] bytes are passed at once,
    /// because a message between the firmware's tasks holds no more.
    fn give_text(&mut self, now: Instant) -> bool {
        let Some((LineByte { epoch, .. }, _)) = self.lines.front().copied() else { return false };
        let alike = self.lines.iter().take_while(|(byte, _)| byte.epoch == epoch && !byte.damaged);
        let ahead: heapless::Vec<u8, { LineBytes::MOST }> =
            alike.map(|(byte, _)| byte.byte).take(LineBytes::MOST).collect();
        let taken = self.controller.take_text(epoch, &ahead);
        self.recorder.record_text(now, epoch, &ahead[..taken], &self.controller);
        for _ in 0..taken {
            self.next_line_byte();
        }
        taken > 0
    }

    fn record(&mut self, now: Instant, event: &Event<AXES>) {
        self.recorder.record(now, event, &self.controller);
    }

    fn record_more(&mut self) {
        self.recorder.more_waits();
    }

    fn make_room(&mut self, _took: bool) -> bool {
        false
    }

    fn room(&mut self) -> Room {
        Room {
            step: self.queue.len() < SEGMENTS_DEPTH,
            reply: self.late & late::REPLIES == 0 && self.round_replies < REPLIES_DEPTH,
        }
    }

    fn carry(&mut self, output: Output) {
        self.round_replies += 1;
        assert!(self.round_replies <= REPLIES_DEPTH + MOST_QUIET_OUTPUTS, "outputs of a round");
        match output {
            Output::Step(message) => {
                if matches!(message, ToStep::Segment(_)) {
                    self.assert_may_move("a segment");
                }
                self.recorder.handed(&message);
                self.queue.push_back(message);
                self.load();
            }
            Output::Reply(chunk) | Output::Answer(chunk) => {
                self.said.extend_from_slice(chunk.as_bytes());
                self.book.told(chunk.as_bytes());
            }
            Output::Stop => self.stop(),
            Output::Wiring(wiring) => self.armed = wiring.armed,
            Output::ReadPins { clear_noise } => self.pins_asked |= !clear_noise,
            Output::Store => {
                if let Some(change) = self.controller.next_store() {
                    let answer = self.store(&change);
                    self.answers.push_back(answer);
                }
            }
            Output::ReadRecording { first } => {
                let Board { controller, recorder, records, .. } = self;
                let record = |at: u16| {
                    let (key, value) = records.iter().nth(at.into())?;
                    Some(Record { key: *key, value: heapless::Vec::from_slice(value).ok()? })
                };
                recorder.read(first, ("fuzz", 1_000_000), record, |item| controller.recorded(item));
            }
            Output::Pins(_) | Output::Worked => {}
        }
    }
}

impl Board {
    fn store(&mut self, change: &Store) -> Event<AXES> {
        if self.store_fails {
            return Event::StoreFailed;
        }
        match change {
            Store::Put(record) => {
                assert_ne!(record.key, STORE_DAMAGED, "only a store tells of damage");
                self.records.insert(record.key, record.value.to_vec());
            }
            Store::Remove { from, until } => self.records.retain(|key, _| !(*from..*until).contains(key)),
        }
        Event::Stored
    }
}
