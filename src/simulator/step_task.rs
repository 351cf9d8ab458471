//! The step task of the simulator: the same stepper as on the boards, with a message queue and a timer in virtual time.
//! Each tick moves the motors, checks the probe and is recorded in the trace. The controller gets reports of stops and
//! underruns, as on a board.

use crate::boards::AXES;
use crate::clock::Clock;
use crate::fittings::Fittings;
use crate::input_task::InputTask;
use crate::machine::Machine;
use crate::marks::Mark;
use crate::meter::Meter;
use crate::trace::{StepRecord, Trace};
use oxmill_controller::Stepper;
use oxmill_controller::messages::{SEGMENTS_DEPTH, SlowOutputs, StepEvent, ToStep, Wiring};
use std::collections::VecDeque;

/// The simulated machine driven by the step pins, and the instruments that measure it.
#[derive(Clone)]
pub struct World {
    /// Motors and carriages.
    pub machine: Machine,
    /// Switches and probe plate.
    pub fittings: Fittings,
    /// Distances and speeds.
    pub meter: Meter,
    /// Trace of the step outputs.
    pub trace: Trace,
}

impl World {
    /// Restarts trace, extents and measurements from zero.
    pub fn restart(&mut self) {
        self.trace.restart();
        self.machine.restart();
        self.meter.restart();
    }
}

/// The stepper, its timer and its queue.
#[derive(Clone)]
pub struct StepTask {
    stepper: Box<Stepper<AXES>>,
    /// Messages that wait for the stepper, each with the line and tool of its move.
    segments: VecDeque<(ToStep, Mark)>,
    events: VecDeque<StepEvent<AXES>>,
    /// Next expiry of the step timer, in ticks; `None` while the timer is stopped.
    due: Option<u64>,
    /// Number of ticks during which the task was busy.
    busy: u64,
    directions: u8,
    begun: u32,
    /// After a stop: the number of this stop. The stepper discards messages until a `Resume` with this number, so the
    /// meter must not count them. `None` while the stepper accepts messages.
    shut: Option<u16>,
    power: u16,
    outputs: Option<SlowOutputs>,
    /// Whether the probe is active while its pin is high.
    probe_invert: bool,
}

impl Default for StepTask {
    fn default() -> Self {
        StepTask {
            stepper: Box::new(Stepper::new()),
            segments: VecDeque::with_capacity(SEGMENTS_DEPTH),
            events: VecDeque::new(),
            due: None,
            busy: 0,
            directions: 0,
            begun: 0,
            shut: None,
            power: 0,
            outputs: None,
            probe_invert: false,
        }
    }
}

impl StepTask {
    /// Next expiry of the step timer, in ticks; `None` while the timer is stopped.
    #[inline]
    pub fn due(&self) -> Option<u64> {
        self.due
    }

    /// Number of ticks during which the task was busy since [`StepTask::restart`]. The trace's digest uses it as the
    /// time of a step.
    pub fn busy(&self) -> u64 {
        self.busy
    }

    /// Resets [`StepTask::busy`], because a new trace begins.
    pub fn restart(&mut self) {
        self.busy = 0;
    }

    /// Number of waiting messages.
    pub fn queued(&self) -> usize {
        self.segments.len()
    }

    /// Returns whether the timer is stopped and no message waits.
    pub fn is_done(&self) -> bool {
        self.due.is_none() && self.segments.is_empty()
    }

    /// Returns whether the timer is stopped, no message waits and the stepper has nothing loaded.
    pub fn is_idle(&self) -> bool {
        self.is_done() && self.stepper.is_idle()
    }

    /// Number of segments started since power-up.
    pub fn segments_begun(&self) -> u32 {
        self.stepper.segments_begun()
    }

    /// The slow outputs (spindle, coolant and others that do not step) as last written.
    pub fn outputs(&self) -> Option<SlowOutputs> {
        self.outputs
    }

    /// The present spindle or laser power, 0 to 65535.
    pub fn power(&self) -> u16 {
        self.power
    }

    /// Removes and returns the next report to the control task.
    pub fn next_event(&mut self) -> Option<StepEvent<AXES>> {
        self.events.pop_front()
    }

    /// Applies the polarity of the probe pin. The rest of `wiring` does not concern this task.
    pub fn wire(&mut self, wiring: &Wiring) {
        self.probe_invert = wiring.probe_invert;
    }

    /// Sets the slow outputs. While the machine moves, the power of a laser stays as it is, because each segment sets
    /// it.
    pub fn show(&mut self, outputs: SlowOutputs, clock: &Clock, world: &mut World) {
        self.outputs = Some(outputs);
        if !outputs.power_from_segments || self.due.is_none() {
            self.power = outputs.power;
        }
        world.trace.outputs(clock.now(), &outputs, self.power);
    }

    /// Queues a message. `mark` is the line and tool of its move, if `Simulator::mark_moves` was called.
    pub fn queue(&mut self, message: ToStep, mark: Mark, clock: &Clock, world: &mut World) {
        self.segments.push_back((message, mark));
        self.load(clock, world);
    }

    /// Fills the stepper from the queue, and starts the timer when the stepper has work.
    fn load(&mut self, clock: &Clock, world: &mut World) {
        while self.stepper.has_room()
            && let Some((message, mark)) = self.segments.pop_front()
        {
            match message {
                ToStep::Resume { stops } if self.shut == Some(stops) => self.shut = None,
                _ if self.shut.is_some() => {}
                _ => world.meter.loaded(&message, mark),
            }
            self.stepper.load(message);
        }
        if self.due.is_none() && !self.stepper.is_idle() {
            self.due = Some(clock.now());
        }
    }

    /// Handles the expiry of the step timer. Returns `true` if the control task must run at the same tick.
    #[inline]
    pub fn tick(&mut self, clock: &Clock, world: &mut World, inputs: &mut InputTask) -> bool {
        let due = clock.now();
        let tick = self.stepper.tick();
        let mut contact = false;
        if tick.steps != 0 {
            world.machine.step(tick.steps, self.directions);
            if world.fittings.moved(&world.machine, clock.instant().ticks()) {
                inputs.sample_at(due);
                contact = true;
            }
            let [.., a] = world.machine.motors();
            world.trace.step(StepRecord {
                at: due,
                busy: self.busy,
                steps: tick.steps,
                directions: self.directions,
                position: world.machine.position(),
                rotary: [a],
            });
        }
        self.directions = tick.directions;
        self.busy += u64::from(tick.interval);
        self.due = (tick.interval != 0).then(|| due + u64::from(tick.interval));
        let begun = self.stepper.segments_begun();
        if begun != self.begun {
            self.begun = begun;
            world.trace.segment(due);
            world.meter.begin(clock.seconds(due), world.machine.motors());
            self.carry_power(due, self.stepper.power(), world);
        }
        let probed = self.stepper.is_watching() && self.look_at_probe(world, inputs);
        if tick.underrun {
            let event = self.stepper.underrun_event();
            self.stopped(event, clock, world);
            return true;
        }
        if !self.segments.is_empty() {
            self.load(clock, world);
        }
        if self.due.is_none() {
            // At standstill the power comes from `outputs` and not from a segment. For a laser in M4 it is 0, because
            // its power is scaled with the speed.
            self.carry_power(due, self.outputs.map_or(0, |outputs| outputs.power), world);
            world.meter.at_rest(clock.seconds(due));
            return true;
        }
        // If a contact has changed or the probe has touched, the caller samples the inputs and runs the control task
        // now.
        probed || contact
    }

    /// Sets the laser power, if the laser is in a mode in which segments determine it.
    fn carry_power(&mut self, at: u64, power: u16, world: &mut World) {
        if let Some(outputs) = self.outputs
            && outputs.power_from_segments
            && power != self.power
        {
            self.power = power;
            world.trace.outputs(at, &outputs, power);
        }
    }

    fn look_at_probe(&mut self, world: &World, inputs: &InputTask) -> bool {
        // The step task reads the pin directly, without the filter.
        let touched = (inputs.hand().probe || world.fittings.touches()) != self.probe_invert;
        let first = self.stepper.probe(touched);
        if first {
            self.events.push_back(self.stepper.probed_event());
        }
        first
    }

    /// Stops immediately and drops all waiting messages. Switches off a laser if its power comes from the segments.
    /// Reports the stop to the controller.
    pub fn stop(&mut self, clock: &Clock, world: &mut World) {
        let event = self.stepper.stop([0; AXES]);
        self.stopped(event, clock, world);
        // After a stop the stepper discards all messages up to `Resume`. Let it do so now, because a full queue would
        // have no room for `Resume`.
        self.load(clock, world);
    }

    fn stopped(&mut self, event: StepEvent<AXES>, clock: &Clock, world: &mut World) {
        if let StepEvent::Stopped { stops, .. } | StepEvent::Underrun { stops, .. } = event {
            self.shut = Some(stops);
        }
        self.events.push_back(event);
        self.due = None;
        self.carry_power(clock.now(), 0, world);
        world.meter.stopped(clock.seconds(clock.now()));
    }
}
