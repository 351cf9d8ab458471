//! `Simulator`: a board in virtual time, without hardware. Inputs are bytes, realtime commands and input pins; outputs
//! are replies, output pins, positions and the trace of all steps.
//!
//! All results depend only on the inputs and their virtual times, not on the speed of the host. The control task takes
//! no virtual time, so it is never late. Events at the same tick happen in this order:
//! 1. the step task's tick,
//! 2. bytes from the host, in the order sent, through the boards' own [`Link`](oxmill_controller::Link),
//! 3. changes of input pins, through the boards' own filter,
//! 4. a turn of the control task: as in the firmware, it repeats the round of [`oxmill_controller::pump`] until a round
//!    finds nothing to do.

use crate::boards::{self, AXES, BLOCKS, Board};
use crate::clock::Clock;
use crate::fittings::Fittings;
use crate::host_link::HostLink;
use crate::input_task::InputTask;
use crate::machine::{Machine, linear};
use crate::marks::{Mark, Marks};
use crate::meter::Meter;
use crate::step_task::{StepTask, World};
use crate::store::Store;
use crate::text::JobText;
use crate::trace::{Sole, Trace};
use oxmill_controller::axes::LINEAR;
use oxmill_controller::machine::filter::SAMPLE_HZ;
use oxmill_controller::memory::Memory;
use oxmill_controller::messages::{Realtime, ResetCause, Restart, Signals, SlowOutputs, Standing, Wiring};
use oxmill_controller::pump;
use oxmill_controller::recorder::{Page, Recorder};
use oxmill_controller::settings::{AxisKey, Key};
use oxmill_controller::units::Coordinate;
use oxmill_controller::{Controller, Profile, StepRates};
use std::time::Duration;

/// If the host has not fetched this many bytes of output, the controller holds back further replies.
pub(crate) const OUTGOING: usize = 1 << 16;

/// The parts of a new [`Simulator`]: board, flash contents and machine hardware.
#[derive(Debug)]
pub struct Options {
    /// Profile of the simulated board: step clock, step rates, pins, axes.
    pub board: Board,
    /// The flash image, from which the stored settings are restored.
    pub store: Store,
    /// Switches, probe plate and backlash of the machine.
    pub fittings: Fittings,
    /// `true`: all step events stay in memory, for [`Trace::kept`].
    pub keep_steps: bool,
}

impl Default for Options {
    fn default() -> Self {
        Self { board: boards::DESK, store: Store::in_memory(), fittings: Fittings::default(), keep_steps: false }
    }
}

/// A controller, a step task and a machine in virtual time. A clone continues like the original, but without its job
/// and its CSV file.
#[derive(Clone)]
pub struct Simulator {
    pub(crate) board: Board,
    pub(crate) clock: Clock,
    pub(crate) controller: Box<Controller<AXES>>,
    pub(crate) store: Store,
    pub(crate) host: HostLink,
    pub(crate) inputs: InputTask,
    pub(crate) step: StepTask,
    pub(crate) world: World,
    /// Result of the most recent change of the store (`true`: it succeeded), until the controller has received this
    /// result.
    pub(crate) stored: Option<bool>,
    /// `true` if the controller has requested the state of the inputs and has not received it yet.
    pub(crate) pins_asked: bool,
    pub(crate) outgoing: Vec<u8>,
    /// A loaded job. The controller reads its bytes instead of the host's lines, whenever it can execute more.
    pub(crate) job: Sole<JobText>,
    /// Number of bytes of `job` that the controller can read in the present round of [`oxmill_controller::pump`].
    pub(crate) job_ready: usize,
    pub(crate) wiring: Option<Wiring>,
    /// The recording that a board also makes, for `$REC`.
    pub(crate) recorder: Recorder<Box<[Page]>>,
    /// Maps moves to their line and tool, if [`Simulator::mark_moves`] was called.
    pub(crate) marks: Option<Marks>,
}

/// Starts a controller of this board with the stored settings and lets it greet the host. `restart`: what caused the
/// start.
fn started(board: &Board, store: &mut Store, clock: &Clock, restart: Restart) -> Box<Controller<AXES>> {
    let profile = Profile {
        name: board.name,
        step_clock_hz: board.step_clock_hz,
        rates: StepRates { safe_hz: board.safe_step_hz, least_pulse_tenths: board.least_pulse_tenths },
        axes: board.axes,
        has_second_motor: true,
        has_at_speed: board.has_at_speed,
        program_pins: board.program_pins,
        most_baud: board.most_baud,
        oscillator_mhz: 0,
        has_store: true,
        has_loader: false,
    };
    let mut controller = Box::new(Controller::new(profile, Memory::on_heap(&profile, BLOCKS, board.held_bytes)));
    controller.restarted(restart);
    for record in store.records() {
        controller.restore(&record);
    }
    controller.start(clock.instant());
    controller
}

/// Returns a recorder with empty pages.
fn recorder(restart: &Restart) -> Recorder<Box<[Page]>> {
    Recorder::begin(vec![Page::EMPTY; boards::DESK.recording_pages].into(), restart)
}

impl Simulator {
    /// Powers the board up and lets the controller send its welcome message.
    pub fn new(options: Options) -> Self {
        let Options { board, mut store, fittings, keep_steps } = options;
        let clock = Clock::new(board.step_clock_hz);
        let controller = started(&board, &mut store, &clock, Restart::POWER);
        let mut trace = Trace::default();
        if keep_steps {
            trace.keep();
        }
        let mut simulator = Self {
            board,
            clock,
            controller,
            store,
            host: HostLink::default(),
            inputs: InputTask::default(),
            step: StepTask::default(),
            world: World { machine: Machine::default(), fittings, meter: Meter::new(board.step_clock_hz), trace },
            stored: None,
            pins_asked: false,
            outgoing: Vec::new(),
            job: Sole(None),
            job_ready: 0,
            wiring: None,
            recorder: recorder(&Restart::POWER),
            marks: None,
        };
        let World { fittings, machine, .. } = &mut simulator.world;
        if !fittings.is_empty() && fittings.moved(machine, 0) {
            // A contact is closed at power-up: schedule a sample, which reports it to the controller.
            simulator.inputs.sample_at(0);
        }
        simulator.turn();
        simulator
    }

    // Inputs: bytes of the host, its port, and the pins.

    /// Receives bytes from the host at the present virtual time. The board's queue has room for 255 line bytes, and
    /// the link for 192. While there is room, a realtime command acts immediately, so it overtakes line bytes that
    /// were sent earlier. Further bytes, and the commands after them, wait in the host's port: see
    /// [`Simulator::unread`].
    pub fn send(&mut self, bytes: impl AsRef<[u8]>) {
        self.host.send(bytes.as_ref());
        self.receive();
        self.turn();
    }

    /// For a replay: sends bytes like [`Simulator::send`], at the time at which the board read them. `more`: `true` if
    /// the board had further bytes waiting when it read these.
    pub fn send_followed(&mut self, bytes: impl AsRef<[u8]>, more: bool) {
        self.host.follow(more);
        self.send(bytes);
        // The board read the waiting bytes soon after these, so from now on none count as waiting. The replay may send
        // a waiting line only later, because the recording has only the time at which the line ended.
        self.host.follow(false);
    }

    /// For a replay: from here on, the host never counts as silent, because a recording does not contain the time of
    /// each byte.
    pub fn set_never_silent(&mut self) {
        self.host.set_never_silent();
    }

    /// Simulates the loss of bytes on their way from the host. The controller then rejects the line to which they
    /// belonged.
    pub fn lose_bytes(&mut self) {
        self.host.lose();
    }

    /// For a replay: puts the machine, which must be at rest, into a recorded state. If `lock` is `true`, also locks
    /// the machine. See `Controller::stand`.
    pub fn stand(&mut self, standing: &Standing, lock: bool) {
        self.controller.stand(standing, lock);
        self.turn();
    }

    /// Hash of all blocks that the step task has received since its last stop.
    pub fn recorded_blocks(&self) -> u32 {
        self.recorder.blocks()
    }

    /// For a replay: continues the block hash of [`Simulator::recorded_blocks`] from `blocks`.
    pub fn follow_blocks(&mut self, blocks: u32) {
        self.recorder.follow_blocks(blocks);
    }

    /// Executes a realtime command as from a button, without a byte on the link. A reset also stops the step task at
    /// once.
    pub fn press(&mut self, command: Realtime) {
        if command == Realtime::Reset {
            self.stop();
        }
        self.host.command(command);
        self.turn();
    }

    /// Simulates a host that opens the port.
    pub fn connect(&mut self) {
        self.host.connect();
        self.turn();
    }

    /// Simulates a host that closes the port or is unplugged. Bytes in its port and in the link are lost, even if they
    /// are the rest of a line. Lines in the board's queue are executed, but their `ok` or `error` is not sent.
    pub fn disconnect(&mut self) {
        self.host.disconnect();
        self.turn();
    }

    /// Removes and returns the controller's output since the last call of this function.
    pub fn take_output(&mut self) -> String {
        let taken = std::mem::take(&mut self.outgoing);
        if taken.len() >= OUTGOING {
            // The output was full, so the controller may have held back replies and the work after them: run the
            // controller again.
            self.turn();
        }
        String::from_utf8_lossy(&taken).into_owned()
    }

    /// Pins that the user pulls low. Such a pin has a 1 in the result; it is active unless a setting inverts the input.
    pub fn pins(&self) -> Signals {
        self.inputs.hand()
    }

    /// Sets the pins that the user pulls low.
    pub fn set_pins(&mut self, signals: Signals) {
        if self.inputs.set_hand(signals) {
            self.settle_inputs();
            self.turn();
        }
    }

    /// Executes a line of the pin protocol, such as `limit x 1`. Returns `ok`, or an error that says what is wrong.
    ///
    /// The line `steps` returns the state of the step outputs: motor positions, pulses of each motor, and the hash of
    /// all step events in order of time.
    pub fn pin_line(&mut self, line: &str) -> String {
        if line.trim() == "steps" {
            let axes = self.controller.settings().axes_in_use();
            let steps: String = self.machine().motors().iter().take(axes).map(|steps| format!(" {steps}")).collect();
            let pulses: String =
                self.machine().motor_pulses().iter().take(axes).map(|pulses| format!(" {pulses}")).collect();
            let order = self.trace().digest().order_hash();
            return format!("steps{steps} pulses{pulses} order {order:016x}");
        }
        match crate::pins::disturbed(self.board.axes, line) {
            Some(Ok(bit)) => {
                let low = self.inputs.low();
                for low in [low ^ 1 << bit, low] {
                    if self.inputs.sample(low) {
                        self.stop();
                    }
                }
                self.turn();
                return "ok".into();
            }
            Some(Err(text)) => return format!("error: {text}"),
            None => {}
        }
        match crate::pins::apply(self.inputs.hand(), self.board.axes, line) {
            Ok(signals) => {
                self.set_pins(signals);
                "ok".into()
            }
            Err(text) => format!("error: {text}"),
        }
    }

    /// Returns whether a line of the pin protocol is valid and sets a pin or puts a glitch on it. Recordings contain
    /// only such lines.
    pub fn moves_pin(&self, line: &str) -> bool {
        let axes = self.board.axes;
        match crate::pins::disturbed(axes, line) {
            Some(disturbed) => disturbed.is_ok(),
            None => crate::pins::apply(self.inputs.hand(), axes, line).is_ok(),
        }
    }

    /// Number of bytes sent and not yet read by the controller: in its queue, in the link, and in the host's port.
    pub fn unread(&self) -> usize {
        self.host.unread()
    }

    /// Number of bytes of output not yet fetched with [`Simulator::take_output`].
    pub fn unfetched(&self) -> usize {
        self.outgoing.len()
    }

    // Virtual time: advancing it, and what will happen in it.

    /// Advances virtual time by `time`.
    pub fn run_for(&mut self, time: Duration) {
        self.advance_to(self.clock.now().saturating_add(self.clock.ticks_in(time)));
    }

    /// Advances virtual time until nothing is moving, waiting or unanswered. Also stops when the machine waits for the
    /// host: in a hold, in an alarm with unread lines, or with 64 KiB of replies that were not fetched. Returns whether
    /// the controller is idle.
    pub fn run_until_idle(&mut self) -> bool {
        self.turn();
        while !self.is_idle() && self.advance_once(u64::MAX) {}
        self.is_idle()
    }

    /// Advances virtual time to a tick of the step clock. Does nothing if this tick has passed.
    pub fn advance_to(&mut self, ticks: u64) {
        while self.clock.now() < ticks {
            if !self.advance_once(ticks) {
                self.clock.advance_to(ticks);
                self.turn();
            }
        }
    }

    /// Lets the controller check the progress of the step task, as on a board when something wakes it. Each call can
    /// shift later wake-ups, so two runs that are compared must call this equally often.
    pub fn look(&mut self) {
        self.turn();
    }

    /// Advances to the next event, at most to `limit`. Returns `false` if nothing will happen without further input.
    pub fn advance_once(&mut self, limit: u64) -> bool {
        if self.power_is_gone() {
            return false;
        }
        let wake = self.wake_due();
        let sample = self.inputs.sample_due();
        if wake.is_none() && self.step.due().is_none() && sample.is_none() {
            return false;
        }
        let until = wake.unwrap_or(u64::MAX).min(limit).min(sample.unwrap_or(u64::MAX));
        let began = self.clock.now();
        // If only `limit` is reached, the control task does not run. So the caller can choose any limits without
        // shifting the controller's wake-ups.
        let is_event = loop {
            match self.step.due() {
                Some(due) if due <= until => {
                    self.clock.advance_to(due);
                    if self.step.tick(&self.clock, &mut self.world, &mut self.inputs) {
                        break true;
                    }
                }
                // The next tick of the step timer, if any, is later than `until`.
                _ => {
                    self.clock.advance_to(until);
                    break wake == Some(until) || sample == Some(until);
                }
            }
        };
        self.count_wait(began);
        if !is_event {
            return true;
        }
        if self.inputs.sample_due().is_some_and(|due| due <= self.clock.now()) {
            self.sample_contacts();
        }
        self.turn();
        true
    }

    /// Returns the tick of the next wake-up of the controller; `None` if there is none or the clock never reaches it. A
    /// `!` in an unfinished comment also causes a wake-up: if no byte follows it in time, it becomes a feed hold.
    fn wake_due(&self) -> Option<u64> {
        let due = [self.controller.next_wakeup(), self.host.rest_due()].into_iter().flatten();
        let due = due.map(|instant| self.clock.ticks_at(instant)).min()?;
        (due <= self.clock.end()).then(|| due.max(self.clock.now() + 1))
    }

    /// Returns the number of ticks during which nothing will happen without further input, so that a caller can skip
    /// them. Returns 0 if nothing will happen at all.
    pub fn ticks_without_event(&self) -> u64 {
        let next = [self.wake_due(), self.step.due(), self.inputs.sample_due()].into_iter().flatten().min();
        next.map_or(0, |next| next.saturating_sub(self.clock.now() + 1))
    }

    /// Returns whether the controller waits for a time that the clock never reaches, such as the end of an extremely
    /// long dwell.
    pub fn waits_beyond_the_clock(&self) -> bool {
        self.controller.next_wakeup().is_some() && self.wake_due().is_none()
    }

    /// Returns whether nothing is queued, moving, waiting or unanswered.
    pub fn is_idle(&self) -> bool {
        self.controller.is_idle()
            && self.step.is_done()
            && self.unread() == 0
            && self.host.rest_due().is_none()
            && !self.power_is_gone()
            && self.job.0.as_ref().is_none_or(|job| job.is_used_up())
    }

    /// Returns whether the power cut of [`Store::cut_power_after`] has happened. From then on the simulator does
    /// nothing.
    pub fn power_is_gone(&self) -> bool {
        self.store.power_is_gone()
    }

    /// Returns whether something will happen without the host: a motion or a wait is in progress.
    pub fn is_active(&self) -> bool {
        !self.power_is_gone() && (self.step.due().is_some() || self.wake_due().is_some())
    }

    /// Returns whether the timer of the step task is running.
    pub fn is_stepping(&self) -> bool {
        self.step.due().is_some()
    }

    /// The virtual clock, which advances only through calls such as [`Simulator::run_for`].
    pub fn clock(&self) -> &Clock {
        &self.clock
    }

    // Access to the parts of the simulator, to their state and measurements.

    /// Profile of the simulated board.
    pub fn board(&self) -> &Board {
        &self.board
    }

    /// The controller, for reading its state.
    pub fn controller(&self) -> &Controller<AXES> {
        &self.controller
    }

    /// Trace of the step outputs.
    pub fn trace(&self) -> &Trace {
        &self.world.trace
    }

    /// Trace of the step outputs, for writing it to a file or keeping it in memory.
    pub fn trace_mut(&mut self) -> &mut Trace {
        &mut self.world.trace
    }

    /// Returns a new simulator with the same flash and hardware, just after power-up: idle, or locked if homing is on.
    ///
    /// # Errors
    /// If the file of its store cannot be written.
    pub fn powered_again(&self) -> anyhow::Result<Self> {
        let store = self.store().power_cycled()?;
        let (board, fittings) = (*self.board(), self.fittings().clone());
        let mut simulator = Self::new(Options { board, store, fittings, keep_steps: false });
        simulator.run_until_idle();
        Ok(simulator)
    }

    /// Switches, probe plate and backlash of the machine.
    pub fn fittings(&self) -> &Fittings {
        &self.world.fittings
    }

    /// Positions and pulse counts of the motors, and extents of the carriages.
    pub fn machine(&self) -> &Machine {
        &self.world.machine
    }

    /// The measured distances and speeds.
    pub fn meter(&self) -> &Meter {
        &self.world.meter
    }

    /// The measured distances and speeds, for starting a drawing or fetching it.
    pub fn meter_mut(&mut self) -> &mut Meter {
        &mut self.world.meter
    }

    /// The flash image; pass it to another simulator to simulate a power cycle.
    pub fn store(&self) -> &Store {
        &self.store
    }

    /// The flash image, for ordering a power cut.
    pub fn store_mut(&mut self) -> &mut Store {
        &mut self.store
    }

    /// Spindle, coolant and other outputs that change slowly; `None` before the controller has written them.
    pub fn outputs(&self) -> Option<SlowOutputs> {
        self.step.outputs()
    }

    /// The present spindle or laser power, 0 to 65535.
    pub fn power(&self) -> u16 {
        self.step.power()
    }

    /// The pin settings (polarity, armed inputs, ganged motors) last sent to the tasks; `None` before any were sent.
    pub fn wiring(&self) -> Option<Wiring> {
        self.wiring
    }

    /// Number of step-clock ticks during which the step task was busy since power-up or [`Simulator::begin_job`]. The
    /// trace's digest uses this number as the time of a step.
    pub fn busy_ticks(&self) -> u64 {
        self.step.busy()
    }

    /// Machine position in mm.
    pub fn machine_position(&self) -> [f64; LINEAR] {
        linear(self.machine_place())
    }

    /// Returns the machine position: X, Y and Z in mm, A in degrees.
    pub fn machine_place(&self) -> [f64; AXES] {
        self.controller.machine_position().0.map(millimetres)
    }

    /// Work position in mm.
    pub fn work_position(&self) -> [f64; LINEAR] {
        linear(self.work_place())
    }

    /// Returns the work position: X, Y and Z in mm, A in degrees.
    pub fn work_place(&self) -> [f64; AXES] {
        self.controller.work_position().0.map(millimetres)
    }

    /// Restarts digests, trace, extents and measurements, because a new job begins.
    pub fn begin_job(&mut self) {
        self.step.restart();
        self.world.restart();
        self.learn_resolution();
    }

    /// Numbers all moves from here on. Drawings and times use the numbers to find the line and tool of each move.
    /// Status reports then contain these numbers instead of N words.
    pub fn mark_moves(&mut self) {
        self.marks = Some(Marks::default());
    }

    /// Loads a job. Until its end, the controller reads the lines of the job instead of those of the host, whenever it
    /// can execute more.
    pub fn load_job(&mut self, mut job: JobText) {
        // In Grbl's dialect (0), a line `%` is no tape mark.
        let has_tape_marks = self.controller.settings().whole(Key::Dialect) != 0;
        job.begin(self.controller.lines_read(), self.board.has_all_words, has_tape_marks);
        self.job = Sole(Some(job));
        self.turn();
    }

    /// The job, if one was loaded.
    pub fn job(&self) -> Option<&JobText> {
        self.job.0.as_ref()
    }

    /// The job, if one was loaded, for fetching its replies or stopping it.
    pub fn job_mut(&mut self) -> Option<&mut JobText> {
        self.job.0.as_mut()
    }

    // The work of a board's tasks.

    /// Takes one sample of the machine's contacts as they are now.
    fn sample_contacts(&mut self) {
        let period = u64::from(self.board.step_clock_hz / SAMPLE_HZ);
        if self.inputs.sample_contacts(&mut self.world.fittings, &self.clock, period) {
            self.stop();
        }
    }

    /// Takes as many samples of the inputs as the filter needs to settle, all at the present virtual time. Call after a
    /// change by the user or by a setting: the delay of the filter does not matter for such slow changes.
    pub(crate) fn settle_inputs(&mut self) {
        for _ in 0..self.inputs.settle() {
            self.stop();
        }
    }

    /// Stops the step task immediately.
    pub(crate) fn stop(&mut self) {
        self.step.stop(&self.clock, &mut self.world);
    }

    /// Lets the link fetch the host's bytes, as far as there is room. Returns whether anything was queued for the
    /// controller.
    pub(crate) fn receive(&mut self) -> bool {
        let mut any = self.host.pass_on();
        while let Some(queued) = self.host.fetch(&self.controller) {
            any |= queued;
            if self.host.wants_stop() {
                self.stop();
            }
        }
        any | self.host.await_rest(self.clock.instant())
    }

    /// Restarts the board (`$REBOOT`): the controller starts again with the stored settings, and bytes that the old one
    /// has not read are lost. The machine, its switches and the host stay as they are.
    fn reboot(&mut self) {
        let restart = Restart { cause: ResetCause::Software, crash: None, is_recorded: false };
        self.recorder = recorder(&restart);
        self.controller = started(&self.board, &mut self.store, &self.clock, restart);
        self.host = HostLink::default();
        self.step = StepTask::default();
        self.inputs.restart();
        self.inputs.sample_at(self.clock.now());
        (self.stored, self.pins_asked, self.wiring) = (None, false, None);
        // End the job, because a sender also stops at a greeting. Besides, the new controller counts lines from 0
        // again.
        if let Some(job) = &mut self.job.0 {
            job.end_by_restart();
        }
    }

    /// Lets the control task work at the present time until it finds nothing more to do.
    fn turn(&mut self) {
        while !self.power_is_gone() {
            if !pump::round(self) {
                if self.controller.reboot_due().is_some() {
                    self.reboot();
                    continue;
                }
                self.erase_ahead();
                if self.controller.is_idle() && self.step.is_idle() {
                    self.recorder.at_rest(self.clock.instant(), &self.controller);
                }
                return;
            }
        }
    }

    /// If the line in progress waits in a dwell or for the spindle, counts the time since the tick `began` as dwell or
    /// as spin-up.
    fn count_wait(&mut self, began: u64) {
        let Some(spindle_until) = self.controller.waits_for_spindle_until() else { return };
        let now = self.clock.now();
        let turns = spindle_until >= self.clock.instant();
        let turning = if turns { now } else { self.clock.ticks_at(spindle_until).clamp(began, now) };
        let times = self.world.meter.times_mut().of(self.controller.tool_in_work());
        times.spin_up_s += self.clock.seconds(turning - began);
        times.dwell_s += self.clock.seconds(now - turning);
        let seconds = self.clock.seconds(now - began);
        self.world.meter.times_mut().add_to_line(self.controller.lines_read(), seconds);
    }

    /// Assigns a number to the moves of the line in progress, by which `marks` later finds their line and tool.
    pub(crate) fn mark_line(&mut self) {
        if let Some(marks) = &mut self.marks {
            let controller = &mut self.controller;
            let (line, tool, arc) = (controller.lines_read(), controller.tool_in_work(), controller.is_arc_in_work());
            let speed = controller.speed_in_work().round() as u32;
            if let Some(number) =
                marks.begin(Mark { line, tool, arc, speed }, || controller.queued_line_numbers().collect())
            {
                controller.number_moves(number);
            }
        }
    }

    /// Erases flash while the machine is quiet, so that no write has to wait for an erase.
    fn erase_ahead(&mut self) {
        if self.store.needs_erase() && self.step.due().is_none() && self.controller.is_quiet() {
            // If the file cannot be written, the next write will report it.
            let _ = self.store.erase_ahead();
        }
    }

    pub(crate) fn learn_resolution(&mut self) {
        let settings = self.controller.settings();
        let (steps_per_mm, arrangement) = (settings.axes(AxisKey::Resolution), settings.arrangement());
        self.world.meter.set_resolution(steps_per_mm.0.map(f64::from), arrangement);
        self.world.machine.arrange(arrangement);
    }

    /// Makes the next bytes of a job ready; at its end, notifies the controller that no more input will come.
    pub(crate) fn read_job_ahead(&mut self) {
        if let Some(job) = &mut self.job.0 {
            self.job_ready = job.waiting();
            if self.job_ready == 0 {
                self.controller.input_ended();
            }
        }
    }
}

fn millimetres(coordinate: Coordinate) -> f64 {
    coordinate.0 as f64 / Coordinate::mm(1).0 as f64
}
