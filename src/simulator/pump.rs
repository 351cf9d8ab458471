//! The pump: carries events to the controller and its outputs to the step task and the machine, in virtual time.
//!
//! Everything is a function of what was sent and when in virtual time; the host's speed has no part in it. The control
//! task takes no time, so it is never late. What happens at the same tick happens in this order:
//! 1. the step task's tick,
//! 2. bytes from the host, in the order sent, through the boards' own [`Link`],
//! 3. changes of input pins, through the boards' own filter,
//! 4. a turn of the control task.
//!
//! A turn of the control task is the firmware's: observe; all events (step task, realtime, pins, store); line bytes as
//! long as the controller wants them; then outputs, beginning again after each one for the step task, and ending when a
//! whole round found nothing to do.
//!
//! The host is on a link like USB, which can wait: what has no room in the board's queues and in the link waits in the
//! host's port.

use crate::boards::{self, AXES, BLOCKS, Board};
use crate::clock::Clock;
use crate::fittings::Fittings;
use crate::machine::Machine;
use crate::meter::Meter;
use crate::store::Store;
use crate::text::JobText;
use crate::trace::{Sole, StepRecord, Trace};
use oxmill_controller::machine::filter::SAMPLE_HZ;
use oxmill_controller::machine::signals::{Inputs, SETTLING};
use oxmill_controller::messages::{
    Event, LINES_DEPTH, LineByte, Observed, Output, PinView, REALTIME_DEPTH, Realtime, Room, SECOND_SWITCH,
    SEGMENTS_DEPTH, Sensed, Signals, SlowOutputs, StepEvent, ToStep, Wiring, input,
};
use oxmill_controller::settings::AxisKey;
use oxmill_controller::units::Coordinate;
use oxmill_controller::{Controller, Entrance, Link, Profile, Queues, StepRates, Stepper};
use std::collections::VecDeque;
use std::time::Duration;

/// Outgoing bytes that may wait for the host before the controller is asked to keep its answers.
const OUTGOING: usize = 1 << 16;

/// Line bytes that the link keeps beyond the queue, as that of USB on the boards.
const HELD: usize = 3 * 64;
/// Number of the host's link, and of the one that nobody uses.
const HOST: usize = 0;
const UNUSED: usize = 1;

/// The queues from the link to the control task, as deep as the boards'.
#[derive(Clone, Default)]
struct ToControl {
    realtime: VecDeque<Realtime>,
    lines: VecDeque<LineByte>,
    /// All that any host has said is done and answered.
    free: bool,
    /// The step task has to be stopped.
    stop: bool,
}

impl Queues for ToControl {
    fn realtime(&mut self, command: Realtime) -> bool {
        let room = self.realtime.len() < REALTIME_DEPTH;
        if room {
            self.realtime.push_back(command);
        }
        room
    }

    fn line(&mut self, byte: LineByte) -> bool {
        let room = self.lines.len() < LINES_DEPTH;
        if room {
            self.lines.push_back(byte);
        }
        room
    }

    fn waits(&self) -> bool {
        true
    }

    fn is_free(&self) -> bool {
        self.free
    }

    fn stop(&mut self) {
        self.stop = true;
    }
}

/// What a simulator is made of.
#[derive(Debug)]
pub struct Options {
    /// The board it stands in for.
    pub board: Board,
    /// The flash image.
    pub store: Store,
    /// Switches and plate of the machine.
    pub fittings: Fittings,
    /// Whether all step events are kept in memory, for [`Trace::kept`].
    pub keep_steps: bool,
}

impl Default for Options {
    fn default() -> Self {
        Self { board: boards::DESK, store: Store::in_memory(), fittings: Fittings::default(), keep_steps: false }
    }
}

/// A controller, a step task and a machine in virtual time. A copy goes on as this one would, but without its job and its
/// CSV file.
#[derive(Clone)]
pub struct Simulator {
    board: Board,
    clock: Clock,
    controller: Box<Controller<AXES, BLOCKS>>,
    stepper: Box<Stepper<AXES>>,
    store: Store,

    /// Sent by the host and not yet fetched by the link, which has no room.
    port: VecDeque<u8>,
    link: Link<HELD>,
    unused_link: Link<1>,
    entrance: Entrance,
    received: ToControl,
    step_events: VecDeque<StepEvent<AXES>>,
    stored: VecDeque<bool>,
    /// Levels that a hand has put on the pins, and those of the machine's own contacts at the last sample.
    hand: Signals,
    contacts: Signals,
    /// Samples since the contacts last changed.
    steady: u8,
    /// When the inputs task samples next; `None` while nothing can change.
    sample_due: Option<u64>,
    inputs: Inputs,
    /// Changes of each input that the filter has rejected.
    noise: [u16; input::COUNT],
    /// What the controller was told of last.
    told: Option<Sensed>,
    /// The controller has asked to see the inputs.
    pins_asked: bool,
    connected: bool,
    disconnected: bool,
    outgoing: Vec<u8>,
    segments: VecDeque<ToStep>,
    /// A job whose lines are taken whenever the controller wants them, and how many bytes of it are ready.
    job: Sole<JobText>,
    job_ready: usize,

    /// When the step timer expires next; `None` while it is stopped.
    step_due: Option<u64>,
    /// Ticks for which the step task has been busy.
    busy: u64,
    directions: u8,
    begun: u32,
    /// Count of stops that the step task waits to hear of, while its gate is shut.
    shut: Option<u16>,
    power: u16,
    outputs: Option<SlowOutputs>,
    wiring: Option<Wiring>,

    machine: Machine,
    fittings: Fittings,
    meter: Meter,
    trace: Trace,
}

impl Simulator {
    /// Powers the board up and lets the controller say its welcome.
    pub fn new(options: Options) -> Self {
        let Options { board, mut store, fittings, keep_steps } = options;
        let mut controller = Box::new(Controller::new(Profile {
            name: board.name,
            step_clock_hz: board.step_clock_hz,
            rates: StepRates { safe_hz: board.safe_step_hz, attention_ns: board.attention_ns },
            has_second_motor: true,
            has_store: true,
        }));
        for record in store.records() {
            controller.restore(&record);
        }
        let clock = Clock::new(board.step_clock_hz);
        controller.start(clock.instant());
        let mut trace = Trace::default();
        if keep_steps {
            trace.keep();
        }
        let mut simulator = Self {
            board,
            clock,
            controller,
            stepper: Box::new(Stepper::new()),
            store,
            port: VecDeque::new(),
            link: Link::new(HOST),
            unused_link: Link::new(UNUSED),
            entrance: Entrance::new(),
            received: ToControl::default(),
            step_events: VecDeque::new(),
            stored: VecDeque::new(),
            hand: Signals::default(),
            contacts: Signals::default(),
            steady: 0,
            sample_due: None,
            inputs: Inputs::new(),
            noise: [0; input::COUNT],
            told: None,
            pins_asked: false,
            connected: false,
            disconnected: false,
            outgoing: Vec::new(),
            segments: VecDeque::with_capacity(SEGMENTS_DEPTH),
            job: Sole(None),
            job_ready: 0,
            step_due: None,
            busy: 0,
            directions: 0,
            begun: 0,
            shut: None,
            power: 0,
            outputs: None,
            wiring: None,
            machine: Machine::default(),
            fittings,
            meter: Meter::new(board.step_clock_hz),
            trace,
        };
        if !simulator.fittings.is_empty() && simulator.fittings.moved(&simulator.machine, 0) {
            // The machine was left on a switch.
            simulator.sample_due = Some(0);
        }
        simulator.turn();
        simulator
    }

    // The outside world

    /// Bytes from the host, at the present virtual time. Realtime commands act now, whatever line bytes stand before them,
    /// as long as these find room in the board's queue and the link (255 and 192 bytes); what is beyond, commands too,
    /// waits in the host's port: see [`Simulator::unread`].
    pub fn send(&mut self, bytes: impl AsRef<[u8]>) {
        self.port.extend(bytes.as_ref());
        self.receive();
        self.turn();
    }

    /// A realtime command that does not come over the wire.
    pub fn press(&mut self, command: Realtime) {
        if command == Realtime::Reset {
            self.stop();
        }
        // There is room: each turn empties the queue.
        self.entrance.command(command, &mut self.received);
        self.turn();
    }

    /// A host has opened the port.
    pub fn connect(&mut self) {
        self.connected |= self.link.came(&mut self.entrance, &mut self.unused_link, &self.received);
        self.turn();
    }

    /// The host has closed the port, or is unplugged. What its port and the link still hold goes with it, also the rest of
    /// a line; lines that the board's queue has are carried out and get no `ok` or `error`.
    pub fn disconnect(&mut self) {
        self.port.clear();
        self.disconnected |= self.link.went(&mut self.entrance);
        self.turn();
    }

    /// What the controller has said since the last call.
    pub fn take_output(&mut self) -> String {
        let taken = std::mem::take(&mut self.outgoing);
        if taken.len() >= OUTGOING {
            // The controller has held answers back, and what depends on them.
            self.turn();
        }
        String::from_utf8_lossy(&taken).into_owned()
    }

    /// Levels that a hand has put on the input pins. A pin at 1 is active unless a setting inverts it.
    pub fn pins(&self) -> Signals {
        self.hand
    }

    /// Moves input pins by hand.
    pub fn set_pins(&mut self, signals: Signals) {
        if signals != self.hand {
            self.hand = signals;
            self.settle_inputs();
            self.turn();
        }
    }

    /// A line of the pin protocol, such as `limit x 1`; the answer is `ok` or says what is wrong.
    pub fn pin_line(&mut self, line: &str) -> String {
        match crate::pins::disturbed(self.board.axes, line) {
            Some(Ok(bit)) => {
                let low = self.low();
                self.sample_inputs(low ^ 1 << bit);
                self.sample_inputs(low);
                self.turn();
                return "ok".into();
            }
            Some(Err(text)) => return format!("error: {text}"),
            None => {}
        }
        match crate::pins::apply(self.hand, self.board.axes, line) {
            Ok(signals) => {
                self.set_pins(signals);
                "ok".into()
            }
            Err(text) => format!("error: {text}"),
        }
    }

    /// Bytes sent and not yet taken by the controller: in its queue, in the link, and in the host's port.
    pub fn unread(&self) -> usize {
        self.port.len() + self.received_by_link()
    }

    /// Bytes of answers not yet fetched with [`Simulator::take_output`].
    pub fn unfetched(&self) -> usize {
        self.outgoing.len()
    }

    // Time

    /// Lets virtual time pass.
    pub fn run_for(&mut self, time: Duration) {
        self.advance_to(self.clock.now().saturating_add(self.clock.ticks_in(time)));
    }

    /// Lets virtual time pass until nothing is moving, waiting or unanswered, or the machine waits for the host (a hold,
    /// an alarm with unread lines, 64 KiB of answers that were not fetched). Gives whether the controller is idle.
    pub fn run_until_idle(&mut self) -> bool {
        self.turn();
        while !self.is_idle() && self.advance_once(u64::MAX) {}
        self.is_idle()
    }

    /// Lets virtual time pass up to a tick of the step clock.
    pub fn advance_to(&mut self, ticks: u64) {
        while self.clock.now() < ticks {
            if !self.advance_once(ticks) {
                self.clock.advance_to(ticks);
                self.turn();
            }
        }
    }

    /// Goes on to the next thing that happens, at most to `limit`. `false` if nothing will happen by itself.
    pub fn advance_once(&mut self, limit: u64) -> bool {
        if self.power_is_gone() {
            return false;
        }
        let wake = self.controller.next_wakeup().map(|at| self.clock.ticks_at(at).max(self.clock.now() + 1));
        if wake.is_none() && self.step_due.is_none() && self.sample_due.is_none() {
            return false;
        }
        let until = wake.unwrap_or(u64::MAX).min(limit).min(self.sample_due.unwrap_or(u64::MAX));
        loop {
            match self.step_due {
                Some(due) if due <= until => {
                    if self.step(due) {
                        break;
                    }
                }
                // The timer runs on and so does the wait for the wake-up.
                _ => {
                    self.clock.advance_to(until);
                    break;
                }
            }
        }
        if self.sample_due.is_some_and(|due| due <= self.clock.now()) {
            self.sample_contacts();
        }
        self.turn();
        true
    }

    /// Whether nothing is queued, moving, waited for or unanswered.
    pub fn is_idle(&self) -> bool {
        self.controller.is_idle()
            && self.step_due.is_none()
            && self.segments.is_empty()
            && self.unread() == 0
            && !self.power_is_gone()
            && self.job.0.as_ref().is_none_or(|job| job.is_used_up())
    }

    /// Whether an ordered power cut has come: nothing happens any more.
    pub fn power_is_gone(&self) -> bool {
        self.store.power_is_gone()
    }

    /// Whether something will happen without the host: a motion or a wait is going on.
    pub fn is_active(&self) -> bool {
        !self.power_is_gone() && (self.step_due.is_some() || self.controller.next_wakeup().is_some())
    }

    /// Whether the step task is busy.
    pub fn is_stepping(&self) -> bool {
        self.step_due.is_some()
    }

    /// The virtual clock.
    pub fn clock(&self) -> &Clock {
        &self.clock
    }

    // What can be seen

    /// The board.
    pub fn board(&self) -> &Board {
        &self.board
    }

    /// The controller.
    pub fn controller(&self) -> &Controller<AXES, BLOCKS> {
        &self.controller
    }

    /// Trace of the step outputs.
    pub fn trace(&self) -> &Trace {
        &self.trace
    }

    /// Trace of the step outputs, to be told what else to record.
    pub fn trace_mut(&mut self) -> &mut Trace {
        &mut self.trace
    }

    /// The machine.
    pub fn fittings(&self) -> &Fittings {
        &self.fittings
    }

    /// Motors and carriages.
    pub fn machine(&self) -> &Machine {
        &self.machine
    }

    /// Distances and speeds.
    pub fn meter(&self) -> &Meter {
        &self.meter
    }

    /// Distances and speeds, to be told what else to collect.
    pub fn meter_mut(&mut self) -> &mut Meter {
        &mut self.meter
    }

    /// The flash image; give it to another simulator to see what a power cycle leaves.
    pub fn store(&self) -> &Store {
        &self.store
    }

    /// The flash image, to have its power cut.
    pub fn store_mut(&mut self) -> &mut Store {
        &mut self.store
    }

    /// Slow outputs; `None` before the controller has written them.
    pub fn outputs(&self) -> Option<SlowOutputs> {
        self.outputs
    }

    /// Spindle or laser power now, 0 to 65535.
    pub fn power(&self) -> u16 {
        self.power
    }

    /// Facts for the pins' own tasks.
    pub fn wiring(&self) -> Option<Wiring> {
        self.wiring
    }

    /// Step-clock ticks for which the step task has been busy: the time of the digest.
    pub fn busy_ticks(&self) -> u64 {
        self.busy
    }

    /// Machine position in mm.
    pub fn machine_position(&self) -> [f64; AXES] {
        self.controller.machine_position().0.map(millimetres)
    }

    /// Work position in mm.
    pub fn work_position(&self) -> [f64; AXES] {
        self.controller.work_position().0.map(millimetres)
    }

    /// Digests, trace, extents and measurements begin anew: what follows is a job of its own.
    pub fn begin_job(&mut self) {
        self.busy = 0;
        self.trace.restart();
        self.machine.restart();
        self.meter.restart();
        self.learn_resolution();
    }

    /// Gives the controller a job, whose lines it takes whenever it wants one.
    pub fn load_job(&mut self, job: JobText) {
        self.job = Sole(Some(job));
        self.turn();
    }

    /// Takes the job away.
    pub fn unload_job(&mut self) -> Option<JobText> {
        self.job.0.take()
    }

    /// The job, if one was loaded.
    pub fn job(&self) -> Option<&JobText> {
        self.job.0.as_ref()
    }

    /// The job, if one was loaded.
    pub fn job_mut(&mut self) -> Option<&mut JobText> {
        self.job.0.as_mut()
    }

    // The inputs task

    /// One sample with the machine's contacts as they are now; the next follows while the filter or a contact has not
    /// settled.
    fn sample_contacts(&mut self) {
        let now = self.clock.instant().ticks();
        let contacts = self.fittings.sample(now);
        self.steady = if contacts == self.contacts { self.steady.saturating_add(1) } else { 1 };
        self.contacts = contacts;
        let settled = self.steady >= SETTLING && !self.fittings.chatter(now);
        let period = u64::from(self.board.step_clock_hz / SAMPLE_HZ);
        self.sample_due = (!settled).then(|| self.clock.now() + period);
        self.sample_inputs(self.low());
    }

    /// Pins that are low: those that a hand has put to 1, and closed contacts.
    fn low(&self) -> u16 {
        self.hand.word() | self.contacts.word()
    }

    /// A sample of the inputs task; an armed input stops the step task here and now.
    fn sample_inputs(&mut self, low: u16) {
        if self.inputs.sample(low) {
            self.stop();
        }
        self.count_noise(self.inputs.rejected());
    }

    /// A hand, or the host with a setting, takes its time: the task has taken as many samples as its filter wants. Not while
    /// contacts have not settled at power-up, for the first that the controller hears of the inputs has them in it.
    fn settle_inputs(&mut self) {
        if self.inputs.sensed().is_none() && self.sample_due.is_some() {
            return;
        }
        for _ in 0..SETTLING {
            self.sample_inputs(self.low());
        }
    }

    fn count_noise(&mut self, rejected: u16) {
        for (bit, count) in self.noise.iter_mut().enumerate() {
            *count = count.saturating_add(rejected >> bit & 1);
        }
    }

    /// The inputs that this machine has: those of its axes, a second switch, and all others.
    fn view_of_pins(&self) -> PinView {
        let axes = (1 << self.board.axes) - 1;
        let others = !u16::from(u8::MAX);
        PinView { fitted: axes | u16::from(SECOND_SWITCH) | others, low: self.low(), noise: self.noise }
    }

    // The control task

    /// One turn of the control task at the present time: see the head of this file.
    fn turn(&mut self) {
        loop {
            if self.power_is_gone() {
                return;
            }
            let now = self.clock.instant();
            self.read_job_ahead();
            let (queued, received) = (self.queued_bytes(), self.received_bytes());
            self.controller.observe(Observed {
                segments_begun: self.stepper.segments_begun(),
                step_idle: self.step_due.is_none() && self.segments.is_empty() && self.stepper.is_idle(),
                rx_free: self.board.received_bytes.saturating_sub(queued) as u16,
                received: u16::try_from(received).unwrap_or(u16::MAX),
            });
            let mut busy = self.deliver_events();
            while self.controller.wants_line()
                && let Some(byte) = self.next_line_byte()
            {
                self.controller.event(now, Event::Line(byte));
                busy = true;
            }
            // There may be room now for what waits.
            busy |= (!self.port.is_empty() || self.link.is_waiting()) && self.receive();
            if self.deliver_outputs() || busy || self.events_wait() {
                continue;
            }
            self.erase_ahead();
            return;
        }
    }

    /// Erases flash while the machine is quiet, so that no write has to wait for it.
    fn erase_ahead(&mut self) {
        if self.store.needs_erase() && self.step_due.is_none() && self.controller.is_quiet() {
            // A file that cannot be written shows at the next write.
            let _ = self.store.erase_ahead();
        }
    }

    fn events_wait(&self) -> bool {
        !self.step_events.is_empty()
            || !self.received.realtime.is_empty()
            || !self.stored.is_empty()
            || self.pins_asked
            || self.inputs.sensed() != self.told
    }

    fn deliver_events(&mut self) -> bool {
        let now = self.clock.instant();
        let mut busy = false;
        let (pins_asked, view) = (std::mem::take(&mut self.pins_asked), self.view_of_pins());
        let mut give = |controller: &mut Controller<AXES, BLOCKS>, event| {
            controller.event(now, event);
            busy = true;
        };
        while let Some(event) = self.step_events.pop_front() {
            give(&mut self.controller, Event::Step(event));
        }
        if std::mem::take(&mut self.disconnected) {
            give(&mut self.controller, Event::Disconnected(self.entrance.gone()));
        }
        if std::mem::take(&mut self.connected) {
            give(&mut self.controller, Event::Connected);
        }
        while let Some(command) = self.received.realtime.pop_front() {
            give(&mut self.controller, Event::Realtime(command));
        }
        let sensed = self.inputs.sensed();
        if sensed != self.told
            && let Some(sensed) = sensed
        {
            self.inputs.told();
            self.told = self.inputs.sensed();
            give(&mut self.controller, Event::Signals(sensed));
        }
        if pins_asked {
            give(&mut self.controller, Event::Pins(view));
        }
        while let Some(stored) = self.stored.pop_front() {
            give(&mut self.controller, if stored { Event::Stored } else { Event::StoreFailed });
        }
        busy
    }

    /// Pulls outputs until there are none or one asks for a new round. Gives whether there were any.
    fn deliver_outputs(&mut self) -> bool {
        let now = self.clock.instant();
        let mut any = false;
        loop {
            let room = Room { step: self.segments.len() < SEGMENTS_DEPTH, reply: self.outgoing.len() < OUTGOING };
            match self.controller.output(now, room) {
                None => return any,
                Some(Output::Step(message)) => {
                    self.segments.push_back(message);
                    self.load();
                    return true;
                }
                Some(Output::Stop) => {
                    self.stop();
                    return true;
                }
                Some(Output::Reply(chunk)) => {
                    self.outgoing.extend_from_slice(chunk.as_bytes());
                    if let Some(job) = &mut self.job.0 {
                        job.answered(chunk.as_bytes());
                    }
                }
                Some(Output::Pins(outputs)) => {
                    self.outputs = Some(outputs);
                    if !outputs.power_from_segments || self.step_due.is_none() {
                        self.power = outputs.power;
                    }
                    self.trace.outputs(&outputs, self.power);
                }
                Some(Output::Wiring(wiring)) => {
                    self.wiring = Some(wiring);
                    self.machine.wire(&wiring);
                    self.inputs.wire(&wiring);
                    self.settle_inputs();
                    self.learn_resolution();
                }
                Some(Output::ReadPins { clear_noise: true }) => self.noise = [0; input::COUNT],
                Some(Output::ReadPins { clear_noise: false }) => self.pins_asked = true,
                Some(Output::Store(change)) => {
                    // A store that cannot be written is the host's fault; the controller tells the host.
                    let stored = self.store.apply(&change);
                    if self.power_is_gone() {
                        return false;
                    }
                    self.stored.push_back(stored.is_ok());
                }
                Some(Output::Worked) => return true,
            }
            any = true;
        }
    }

    fn learn_resolution(&mut self) {
        let settings = self.controller.settings();
        let (steps_per_mm, arrangement) = (settings.axes(AxisKey::Resolution), settings.arrangement());
        self.meter.set_resolution(steps_per_mm.0.map(f64::from), arrangement);
        self.machine.arrange(arrangement);
    }

    // The serial task

    /// Fetches what the host has sent, as far as there is room. Whether anything was queued.
    fn receive(&mut self) -> bool {
        let mut any = self.link.pass_on(&mut self.entrance, &mut self.received);
        while self.link.room() > 0
            && let Some(byte) = self.port.pop_front()
        {
            self.received.free = self.received.lines.is_empty() && self.controller.is_idle();
            any |= self.link.take(byte, &mut self.entrance, &mut self.unused_link, &mut self.received);
            if std::mem::take(&mut self.received.stop) {
                self.stop();
            }
        }
        any
    }

    fn next_line_byte(&mut self) -> Option<LineByte> {
        if let Some(job) = &mut self.job.0 {
            return job.next_byte().map(|byte| LineByte { byte, epoch: 0, damaged: false });
        }
        self.received.lines.pop_front()
    }

    /// Makes the next bytes of a job ready; at its end the controller is told that no more will come.
    fn read_job_ahead(&mut self) {
        if let Some(job) = &mut self.job.0 {
            self.job_ready = job.waiting();
            if self.job_ready == 0 {
                self.controller.input_ended();
            }
        }
    }

    /// Line bytes in the queue.
    fn queued_bytes(&self) -> usize {
        if self.job.0.is_some() { self.job_ready } else { self.received.lines.len() }
    }

    /// Line bytes received and not yet taken.
    fn received_bytes(&self) -> usize {
        if self.job.0.is_some() { self.job_ready } else { self.received_by_link() }
    }

    /// Those in the queue, those that wait for room in it, and the cut that goes before these.
    fn received_by_link(&self) -> usize {
        let held = self.link.held();
        self.received.lines.len() + held + usize::from(held > 0 && self.entrance.owes_cut())
    }

    // The step task

    /// Fills the step task from its queue and starts its timer when it has work.
    fn load(&mut self) {
        while self.stepper.wants()
            && let Some(message) = self.segments.pop_front()
        {
            match message {
                ToStep::Resume { stops } if self.shut == Some(stops) => self.shut = None,
                _ if self.shut.is_some() => {}
                _ => self.meter.loaded(&message),
            }
            self.stepper.load(message);
        }
        if self.step_due.is_none() && !self.stepper.is_idle() {
            self.step_due = Some(self.clock.now());
        }
    }

    /// The step timer expires. `true` if the control task should look at once.
    #[inline]
    fn step(&mut self, due: u64) -> bool {
        self.clock.advance_to(due);
        let tick = self.stepper.tick();
        if tick.steps != 0 {
            self.machine.step(tick.steps, self.directions);
            if self.fittings.moved(&self.machine, self.clock.instant().ticks()) {
                self.sample_due.get_or_insert(due);
            }
            self.trace.step(StepRecord {
                at: due,
                busy: self.busy,
                steps: tick.steps,
                directions: self.directions,
                position: self.machine.position(),
            });
        }
        self.directions = tick.directions;
        self.busy += u64::from(tick.interval);
        self.step_due = (tick.interval != 0).then(|| due + u64::from(tick.interval));
        let begun = self.stepper.segments_begun();
        if begun != self.begun {
            self.begun = begun;
            self.trace.segment(due);
            self.meter.begin(self.clock.seconds(due), self.machine.position());
            self.segment_power(self.stepper.power());
        }
        let probed = self.stepper.is_watching() && self.look_at_probe();
        if tick.underrun {
            let event = self.stepper.underrun_event();
            self.stopped(event);
            return true;
        }
        if !self.segments.is_empty() {
            self.load();
        }
        if self.step_due.is_none() {
            self.meter.at_rest(self.clock.seconds(due));
            return true;
        }
        probed
    }

    fn segment_power(&mut self, power: u16) {
        if let Some(outputs) = self.outputs
            && outputs.power_from_segments
            && power != self.power
        {
            self.power = power;
            self.trace.outputs(&outputs, power);
        }
    }

    fn look_at_probe(&mut self) -> bool {
        // The step task looks at the pin itself and not at what the filter has let pass.
        let touched = (self.hand.probe || self.fittings.touches()) != self.wiring.is_some_and(|w| w.probe_invert);
        let first = self.stepper.probe(touched);
        if first {
            self.step_events.extend([self.stepper.probed_event()]);
        }
        first
    }

    /// Stops the step task at once.
    fn stop(&mut self) {
        let event = self.stepper.stop();
        self.stopped(event);
        // What is queued is void, and a full queue would have no room for the word to go on.
        self.load();
    }

    fn stopped(&mut self, event: StepEvent<AXES>) {
        if let StepEvent::Stopped { stops, .. } | StepEvent::Underrun { stops, .. } = event {
            self.shut = Some(stops);
        }
        self.step_events.push_back(event);
        self.step_due = None;
        self.meter.stopped(self.clock.seconds(self.clock.now()));
    }
}

fn millimetres(coordinate: Coordinate) -> f64 {
    coordinate.0 as f64 / Coordinate::mm(1).0 as f64
}
