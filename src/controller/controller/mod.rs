//! The dispatcher: events in, outputs out. The only room that knows all the others.
//!
//! It promises that every call returns after a bounded piece of work: at most one line, one chord or one segment. What
//! has to wait (room in the look-ahead, the end of a motion, a dwell, a stored record) is kept as data and gone on with
//! in a later call, so `?`, `!` and a reset are never late. Time is an argument.
//!
//! * this file: what comes in and what goes out
//! * [`realtime`]: commands that no line holds back
//! * [`inputs`]: buttons, switches, emergencies
//! * [`execute`]: a checked line of G-code is carried out, step by step
//! * [`stops`]: stops, alarms and resets
//! * [`outputs`]: pins, answers, reports
//! * [`cycles`]: homing and probing
//! * [`door`]: the safety door and parking
//! * [`converse`]: lines are dispatched and `$` commands answered
//! * [`settings_lock`]: settings that allow no motion, and what the host knows of it

mod converse;
mod cycles;
mod door;
mod execute;
mod inputs;
mod outputs;
mod realtime;
mod settings_lock;
mod stops;

use crate::axes::PerAxis;
use crate::error::Alarm;
use crate::gcode::{Checked, Dialect, Interpreter};
use crate::machine::drivers::Drivers;
use crate::machine::realtime_override::Overrides;
use crate::machine::reference::Reference;
use crate::machine::state::{Door, Mode};
use crate::messages::{
    Coolant, Event, GangedMotors, InputWiring, LINES_DEPTH, Observed, Output, PinView, Restart, Room, Signals,
    SlowOutputs, SpindleDirection, Store, ToStep, Wiring,
};
use crate::motion::{Arc, Motion, MotionSettings};
use crate::protocol::line_intake::LineIntake;
use crate::protocol::report::RareFields;
use crate::protocol::text::PIECE;
use crate::settings::{AxisKey, Key, Settings};
use crate::step_rates::StepRates;
use crate::units::{Coordinate, Duration, Instant, StepsPerMm, per_second};
use cycles::Probing;
use door::DoorState;
use execute::Task;
use settings_lock::SettingsLock;

/// Longest startup line and build info that is stored.
const STORED_TEXT: usize = 80;
/// Bytes of answers that wait for the serial task.
const REPLY_BYTES: usize = 1024;
/// Free bytes of answers that a listing, a status report or a line asks for before it begins.
const REPLY_RESERVE: usize = 2 * PIECE;
/// How often the controller wants to be called while something moves, to refill the step queue.
const MOVING_WAKEUP: Duration = Duration::from_ticks(2_000);
/// The same when the queue is full of very short pieces or runs out at the end of a motion.
const LEAST_WAKEUP: Duration = Duration::from_ticks(100);
/// Step time that counts as a well filled queue, and below which planning waits for refilling it.
const WELL_FILLED_US: u32 = 12_000;
const LOW_WATER_US: u32 = 6_000;

/// A person needs longer than this to read the settings: a program that lists and unlocks in one go has not looked.
const LOOKING: Duration = Duration::secs(2);
/// What the controller must know of the machine it runs on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Profile {
    /// Name of the board.
    pub name: &'static str,
    /// Ticks of the step timer in a second.
    pub step_clock_hz: u32,
    /// Step rates that the step task can follow.
    pub rates: StepRates,
    /// Whether there are pins for a motor more than there are axes.
    pub has_second_motor: bool,
    /// Whether settings outlive the power: if not, nothing is handed to a store.
    pub has_store: bool,
}

/// Decides everything. `N` axes, look-ahead of `BLOCKS` moves.
// In this order, small things first: one instruction reaches 4 KiB from the base.
#[derive(Clone)]
#[repr(C)]
pub struct Controller<const N: usize, const BLOCKS: usize> {
    profile: Profile,
    settings: Settings<N>,
    /// Hosts that have gone (wrapping).
    hosts_gone: u16,
    /// A startup line has been echoed: the answer to it follows on the same line.
    echoed: bool,
    mode: Mode,
    alarm: Option<Alarm>,
    reference: Reference,
    /// The step queue has held [`WELL_FILLED_US`] since motion began.
    well_filled: bool,
    /// Motion has been started and not come to its end.
    running: bool,
    input_ended: bool,
    task: Task<N>,
    overrides: Overrides,
    spindle: SpindleDirection,
    spindle_speed: f32,
    /// 0x9E in a hold, or a door: the spindle stands although the program has it on.
    spindle_stopped: bool,
    /// A hold is being left: motion goes on when the spindle turns (`$394`).
    spinning_up: Option<Instant>,
    coolant: Coolant,
    door: DoorState<N>,
    /// A jog was moving when the door opened: it is forgotten at rest.
    jog_interrupted: bool,
    probed: PerAxis<Coordinate, N>,
    probe_succeeded: bool,
    probing: Option<Probing>,
    /// `ToStep::Watch` that has to be given out.
    probe_watch: Option<ToStep>,
    /// Levels as the pins have them, and those that count.
    pins: Signals,
    signals: Signals,
    /// They have been told: startup lines wait for it.
    has_sensed: bool,
    /// Inputs that caused the last alarm of an input.
    tripped: Signals,
    /// Stops that inputs have asked for (wrapping).
    trips: u8,
    /// Polarity and resistors of the inputs by the settings.
    input_wiring: InputWiring,
    /// `Output::ReadPins` has to be given out, with this `clear_noise`.
    read_pins: Option<bool>,
    /// The answer, until it has been listed.
    pin_view: Option<PinView>,
    /// Motors of the ganged axis that take their steps: one alone in squaring.
    ganged_motors: GangedMotors,
    drivers: Drivers,
    observed: Observed,
    stop: StopState,
    rare_fields: RareFields,
    /// `?` has been asked and not yet answered.
    status_due: bool,
    pins_sent: Option<SlowOutputs>,
    wiring_sent: Option<Wiring>,
    /// What that was made of.
    wiring_source: Option<WiringSource>,
    settings_lock: SettingsLock,
    /// Stores that have not been answered yet.
    unstored: u8,
    store_failed: bool,
    damage: Damage,
    restart: Restart,
    /// The host knows of the failure before this start.
    restart_told: bool,
    now: Instant,
    lines: LineIntake,
    /// The line of G-code that the task carries out.
    checked: Checked<N>,
    interpreter: Interpreter<N>,
    replies: heapless::Deque<u8, REPLY_BYTES>,
    stores: heapless::Deque<Store, 4>,
    startup_lines: [heapless::Vec<u8, STORED_TEXT>; 2],
    /// A startup line that is run before it is stored.
    validated: heapless::Vec<u8, STORED_TEXT>,
    build_info: heapless::Vec<u8, STORED_TEXT>,
    /// The arc under way.
    arc: Option<Arc<N>>,
    /// Moves of its own while the job is held: parking.
    detour: Motion<N, 2>,
    motion: Motion<N, BLOCKS>,
}

/// What has become of damage that the store has told of ([`STORE_DAMAGED`]). Settings may be lost, and with them what keeps
/// the machine from harm, so it is locked until somebody has looked at them and confirms it.
///
/// [`STORE_DAMAGED`]: crate::messages::STORE_DAMAGED
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Damage {
    /// There is none.
    None,
    /// The settings have not been listed since the last welcome line.
    Untold,
    /// `$$` has been answered at this moment.
    Listed(Instant),
}

/// All that [`Wiring`] depends on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct WiringSource {
    settings: u32,
    inputs: InputWiring,
    homing: bool,
    ganged_motors: GangedMotors,
}

/// Stops asked for and stops that have happened.
#[derive(Clone, Copy, Debug, Default)]
struct StopState {
    /// A stop is awaited, and why.
    awaited: Option<StopReason>,
    /// Stops that must have happened before it is over (wrapping).
    expected: u16,
    /// Stops that have happened (wrapping).
    seen: u16,
    /// The machine was stepping at one of them.
    moving: bool,
    /// N word of what was running at the last of them, 0 = none.
    line: u32,
    /// `Output::Stop` has to be given out.
    order: bool,
    /// `ToStep::Resume` has to be given out.
    resume: bool,
}

impl StopState {
    const NONE: StopState =
        StopState { awaited: None, expected: 0, seen: 0, moving: false, line: 0, order: false, resume: false };
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum StopReason {
    Reset,
    Alarm(Alarm),
    /// A homing switch.
    Switch,
    /// The probe: the step task has braked already.
    Contact,
    /// An armed input of a machine that was locked already.
    Nothing,
}

impl<const N: usize, const BLOCKS: usize> Controller<N, BLOCKS> {
    /// A controller with default settings. Stored records follow with [`Controller::restore`], then
    /// [`Controller::start`]. Can be computed by the compiler: tens of kilobytes need not pass over a stack.
    pub const fn new(profile: Profile) -> Self {
        Self {
            profile,
            settings: Settings::new(),
            startup_lines: [heapless::Vec::new(), heapless::Vec::new()],
            validated: heapless::Vec::new(),
            arc: None,
            build_info: heapless::Vec::new(),
            interpreter: Interpreter::new(),
            motion: Motion::unconfigured(profile.step_clock_hz),
            detour: Motion::unconfigured(profile.step_clock_hz),
            lines: LineIntake::new(),
            mode: Mode::Normal,
            alarm: None,
            reference: Reference::ASSUMED,
            running: false,
            hosts_gone: 0,
            echoed: false,
            well_filled: false,
            input_ended: false,
            task: Task::None,
            checked: Checked::NOTHING,
            overrides: Overrides::NONE,
            spindle: SpindleDirection::Off,
            spindle_speed: 0.0,
            spindle_stopped: false,
            spinning_up: None,
            coolant: Coolant { flood: false, mist: false },
            door: DoorState::CLOSED,
            jog_interrupted: false,
            probed: PerAxis::all(Coordinate::ZERO),
            probe_succeeded: false,
            probing: None,
            probe_watch: None,
            pins: Signals::NONE,
            signals: Signals::NONE,
            has_sensed: false,
            tripped: Signals::NONE,
            trips: 0,
            input_wiring: InputWiring::PULL_UPS,
            read_pins: None,
            pin_view: None,
            ganged_motors: GangedMotors::Both,
            drivers: Drivers::OFF,
            observed: Observed { segments_begun: 0, step_idle: true, rx_free: LINES_DEPTH as u16, received: 0 },
            stop: StopState::NONE,
            rare_fields: RareFields::DUE,
            status_due: false,
            replies: heapless::Deque::new(),
            pins_sent: None,
            wiring_sent: None,
            wiring_source: None,
            settings_lock: SettingsLock::UNKNOWN,
            stores: heapless::Deque::new(),
            unstored: 0,
            store_failed: false,
            damage: Damage::None,
            restart: Restart::POWER,
            restart_told: false,
            now: Instant::from_ticks(0),
        }
    }

    /// What is known of the end before this start; before [`Controller::start`]. After a failure the machine is locked, for a
    /// host that noticed nothing may still be sending its job.
    pub fn restarted(&mut self, restart: Restart) {
        if restart.is_failure() {
            self.mode = Mode::Alarm;
            self.reference.lose();
        }
        self.restart = restart;
    }

    /// Power-up is complete: greets the host, and runs the startup lines once the inputs are known.
    pub fn start(&mut self, now: Instant) {
        self.now = now;
        self.settings.settle();
        self.reconfigure();
        if self.settings.is_on(Key::Homing) {
            self.mode = Mode::Alarm;
            self.reference.lose();
        }
        if self.is_store_damaged() {
            self.mode = Mode::Alarm;
        }
        self.initialise();
    }

    /// What the pump sees of the step task and of received lines. To be called before outputs, and before each event that
    /// may tell what came before it from what comes after it: realtime commands, signals, the end of a host.
    pub fn observe(&mut self, observed: Observed) {
        self.observed = observed;
        self.lines.observe(observed.received);
        self.motion.observe(&observed);
        self.detour.observe(&observed);
    }

    /// Something happened at `now`.
    #[inline]
    pub fn event(&mut self, now: Instant, event: Event<N>) {
        self.now = now;
        match event {
            // Nearly all events.
            Event::Line(byte) if self.lines.take_plain(byte) => {}
            event => self.take(event),
        }
    }

    fn take(&mut self, event: Event<N>) {
        match event {
            Event::Realtime(command) => self.realtime(command),
            Event::Line(byte) => self.line_byte(byte),
            Event::Step(event) => self.step_event(&event),
            Event::Signals(sensed) => self.signals_changed(&sensed),
            Event::Pins(view) => self.pin_view = Some(view),
            Event::Stored => self.unstored = self.unstored.saturating_sub(1),
            Event::StoreFailed => {
                self.unstored = self.unstored.saturating_sub(1);
                self.store_failed = true;
            }
            Event::Connected => {
                self.greet();
                self.tell_lock();
            }
            Event::Disconnected(hosts_gone) => {
                self.hosts_gone = hosts_gone;
                self.host_left();
            }
        }
    }

    /// Whether a line byte may be given.
    pub fn wants_line(&self) -> bool {
        self.task.is_none()
            && !self.lines.holds()
            && self.stop.awaited.is_none()
            && !self.mode.is_suspended()
            && self.has_reply_room()
    }

    /// When the controller wants to be called although nothing happens.
    pub fn next_wakeup(&self) -> Option<Instant> {
        // What a completed hold or a parked door has interrupted goes on with an event, not by itself.
        let moving =
            !self.motion.is_at_rest() || !self.detour.is_at_rest() || self.running && !self.mode.is_suspended();
        let moving = moving.then(|| self.now + self.refill_delay());
        let door = match self.mode {
            Mode::Door(Door::SpindleRestoring(until)) => Some(self.next_look_at_spindle(until)),
            Mode::Door(Door::CoolantRestoring(until)) => Some(until),
            _ => None,
        };
        // Nor does a dwell that something has ended: its moment would be past for ever.
        let task =
            if self.mode.is_suspended() { None } else { self.task.wakeup(|until| self.next_look_at_spindle(until)) };
        let spinning_up = self.spinning_up.map(|until| self.next_look_at_spindle(until));
        [moving, door, task, self.drivers.off_at(), spinning_up].into_iter().flatten().min()
    }

    /// How long the step task can do without more. The depth of its queue counts messages, and blocks of a single step
    /// fill it with a millisecond or two of motion: half of that must not be slept through.
    fn refill_delay(&self) -> Duration {
        let queued = match (self.detour.queued_us(), self.motion.queued_us()) {
            (0, 0) => return MOVING_WAKEUP,
            (0, queued) | (queued, 0) => queued,
            (one, other) => one.min(other),
        };
        Duration::from_ticks(u64::from(queued / 2)).clamp(LEAST_WAKEUP, MOVING_WAKEUP)
    }

    /// Whether nothing is queued, moving, waited for or unanswered.
    pub fn is_idle(&self) -> bool {
        self.task.is_none()
            && self.stop.awaited.is_none()
            && !self.stop.order
            && !self.stop.resume
            && self.motion.is_idle()
            && self.detour.is_idle()
            && self.replies.is_empty()
            && self.unstored == 0
            && !self.status_due
    }

    /// Whether in addition nothing turns and nothing burns: the pump may be deaf for a second, to erase flash.
    pub fn is_quiet(&self) -> bool {
        self.is_idle() && self.is_off()
    }

    /// The same but for answers that are still to be sent: it will be quiet soon if no more lines come.
    pub fn is_nearly_quiet(&self) -> bool {
        self.task.is_none() && self.motion.is_idle() && self.detour.is_idle() && self.is_off()
    }

    fn is_off(&self) -> bool {
        self.pins_sent.is_some_and(|pins| pins.spindle == SpindleDirection::Off && pins.power == 0)
    }

    /// No more bytes will come: what is queued is started.
    pub fn input_ended(&mut self) {
        self.input_ended = true;
    }

    /// Where the machine is.
    pub fn machine_position(&self) -> PerAxis<Coordinate, N> {
        // A parked machine is where the detour led.
        if self.door.is_parking() { self.detour.machine_position() } else { self.motion.machine_position() }
    }

    /// Where the machine is in the active coordinate system.
    pub fn work_position(&self) -> PerAxis<Coordinate, N> {
        self.machine_position().zip(&self.interpreter.work_offset(), |m, o| m - o)
    }

    /// N word of the move under way, 0 = none.
    pub fn line_number(&self) -> u32 {
        self.motion.line_number()
    }

    /// The alarm that holds, if any.
    pub fn alarm(&self) -> Option<Alarm> {
        self.alarm
    }

    /// Whether the machine is where the position says, as far as anybody can know: not after a stop at speed, an underrun,
    /// a power-up or a sleep with homing on, until it has been homed.
    pub fn is_trusted(&self) -> bool {
        self.reference.is_trusted()
    }

    /// Whether stored settings were damaged and have not been confirmed.
    pub fn is_store_damaged(&self) -> bool {
        self.damage != Damage::None
    }

    /// The settings that hold.
    pub fn settings(&self) -> &Settings<N> {
        &self.settings
    }

    /// Whether the program has paused (M0, or a feed hold) and waits for `~` at rest.
    pub fn is_paused(&self) -> bool {
        self.mode == Mode::Hold && self.motion.is_at_rest()
    }

    /// The next thing to be done, at `now`, as far as the pump has room for it. Called until it gives `None`.
    pub fn output(&mut self, now: Instant, room: Room) -> Option<Output> {
        self.now = now;
        let wanted = self.wants_line();
        self.settle();
        if !wanted && self.wants_line() {
            // Bytes that have waited may come now, and nothing else would wake the pump for them.
            return Some(Output::Worked);
        }
        if self.stop.order {
            self.stop.order = false;
            return Some(Output::Stop);
        }
        // The polarity of the drivers' enable output comes before its level.
        if let Some(wiring) = self.changed_wiring() {
            return Some(Output::Wiring(wiring));
        }
        if let Some(pins) = self.changed_pins() {
            return Some(Output::Pins(pins));
        }
        if let Some(store) = self.stores.pop_front() {
            return Some(Output::Store(store));
        }
        if let Some(clear_noise) = self.read_pins.take() {
            return Some(Output::ReadPins { clear_noise });
        }
        // The step queue never runs dry while something moves: at a start it is filled first, and then topped up. With a
        // control task that is not late it is never so low here after that.
        let queued = self.motion.queued_us();
        self.well_filled = (self.well_filled || queued >= WELL_FILLED_US) && self.running;
        let urgent = !self.motion.ends_at_rest() && (!self.well_filled || queued < LOW_WATER_US);
        if urgent
            && room.step
            && let Some(message) = self.step_message()
        {
            return Some(Output::Step(message));
        }
        self.answer_status();
        if room.reply
            && let Some(chunk) = self.reply_chunk()
        {
            return Some(Output::Reply(chunk));
        }
        if self.go_on() {
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

    fn step_message(&mut self) -> Option<ToStep> {
        // A stop may have happened of which only the step task has told yet: its gate is shut.
        if self.stop.awaited.is_some() || self.stop.seen != self.stop.expected {
            return None;
        }
        if self.stop.resume {
            self.stop.resume = false;
            return Some(ToStep::Resume { stops: self.stop.seen });
        }
        if self.mode.is_alarm() || self.mode == Mode::Sleep || self.probing == Some(Probing::Braking) {
            return None;
        }
        if let Some(watch) = self.probe_watch.take() {
            return Some(watch);
        }
        let mut message = self.detour.next_message().or_else(|| self.motion.next_message());
        if let Some(ToStep::Segment(segment)) = &mut message {
            segment.power = self.overridden_power(segment.power);
        }
        if message.is_some() {
            self.drivers.switch_on();
        }
        message
    }

    /// Follows what has come to an end since the last call: motion, a hold's ramp, a jog, a door's delays.
    fn settle(&mut self) {
        self.settle_probe();
        if self.stop.awaited.is_some() {
            return;
        }
        if self.running && self.motion.is_idle() {
            self.running = false;
            // Between the moves of homing the drivers stay on.
            if self.mode != Mode::Home {
                self.start_idle_delay();
            }
        }
        match self.mode {
            Mode::Jog { cancelling }
                if self.motion.is_at_rest() && (cancelling || (self.motion.is_idle() && self.task.is_none())) =>
            {
                self.end_jog();
            }
            Mode::Stopping { locked } if self.motion.is_at_rest() => self.end_soft_stop(locked),
            Mode::Door(door) => self.settle_door(door),
            Mode::Hold => {
                if let Some(until) = self.spinning_up
                    && self.has_spun_up(until)
                {
                    self.spinning_up = None;
                    self.leave_hold();
                }
            }
            _ => {}
        }
        self.drivers.look(self.now);
    }

    /// With homing on, what goes to a place of the machine waits for a position that is true.
    fn must_home_first(&self) -> bool {
        !self.reference.is_trusted()
            && self.dialect() != Dialect::Grbl
            && self.settings.is_on(Key::Homing)
            && self.settings.is_on(Key::TrustNeeded)
    }

    #[inline(never)]
    fn start_idle_delay(&mut self) {
        self.drivers.motion_ended(self.now, self.settings.whole(Key::IdleDelay));
    }

    /// Starts queued motion when there is no reason to wait for more of it.
    fn auto_start(&mut self) {
        // A move queued while the last piece of the one before was already on its way to the motors belongs to the same
        // run: without a start of its own it would never begin.
        if self.running && matches!(self.mode, Mode::Normal | Mode::Jog { cancelling: false }) {
            self.motion.start();
            return;
        }
        let no_more = self.input_ended || self.observed.received == 0;
        if self.mode == Mode::Normal && !self.motion.is_idle() && self.task.is_none() && no_more {
            self.start_motion();
        }
    }

    fn start_motion(&mut self) {
        if matches!(self.mode, Mode::Normal | Mode::Jog { .. } | Mode::Home) {
            self.running = true;
            self.motion.start();
        }
    }
}

/// The settings as motion wants them. A resolution that cannot be used stands as 1: motion is locked until
/// it is mended (`Settings::unrunnable`).
fn motion_settings<const N: usize>(settings: &Settings<N>, profile: &Profile) -> MotionSettings<N> {
    MotionSettings {
        arrangement: settings.arrangement(),
        steps_per_mm: settings.axes(AxisKey::Resolution).map(|v| StepsPerMm::new(v).unwrap_or(StepsPerMm::ONE)),
        max_rate: settings.axes(AxisKey::MaxRate).map(per_second),
        acceleration: settings.axes(AxisKey::Acceleration),
        jerk: settings.axes(AxisKey::Jerk),
        backlash: settings.axes(AxisKey::Backlash),
        junction_deviation: settings.value(Key::JunctionDeviation),
        curve_share: settings.value(Key::CurveAcceleration) * 0.01,
        arc_tolerance: settings.value(Key::ArcTolerance),
        step_clock_hz: profile.step_clock_hz,
    }
}
