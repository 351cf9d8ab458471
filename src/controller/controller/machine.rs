//! `Machine`: all that states and lines work on, and what they ask of more than one part of it. It knows neither the state
//! that the machine is in nor the line that is carried out.

use super::Profile;
use super::pins::Pins;
use super::records::Records;
use super::settings_lock::SettingsLock;
use super::step_supply::StepSupply;
use crate::axes::AxisMask;
use crate::gcode::Interpreter;
use crate::machine::accessories::Accessories;
use crate::machine::door::SafetyDoor;
use crate::machine::drivers::Drivers;
use crate::machine::inputs::InputLevels;
use crate::machine::probe::Probe;
use crate::machine::reference::Reference;
use crate::machine::stops::Stops;
use crate::messages::SpindleDirection;
use crate::motion::Motion;
use crate::protocol::line_intake::LineIntake;
use crate::protocol::replies::Replies;
use crate::settings::{Key, Settings};
use crate::units::Instant;

// In this order, small things first: one instruction reaches 4 KiB from the base.
#[derive(Clone)]
#[repr(C)]
pub(super) struct Machine<const N: usize, const BLOCKS: usize> {
    pub settings: Settings<N>,
    pub reference: Reference,
    pub step_supply: StepSupply,
    pub accessories: Accessories,
    pub probe: Probe<N>,
    pub inputs: InputLevels,
    pub drivers: Drivers,
    pub stops: Stops,
    pub pins: Pins,
    pub settings_lock: SettingsLock,
    pub now: Instant,
    /// When a line of a program was answered last.
    pub answered_at: Instant,
    pub lines: LineIntake,
    pub interpreter: Interpreter<N>,
    pub replies: Replies,
    pub records: Records,
    pub door: SafetyDoor<N>,
    pub motion: Motion<N, BLOCKS>,
}

impl<const N: usize, const BLOCKS: usize> Machine<N, BLOCKS> {
    pub(super) const fn new(profile: Profile) -> Self {
        Self {
            settings: Settings::of_board(profile.axes),
            interpreter: Interpreter::new(),
            motion: Motion::unconfigured(profile.step_clock_hz),
            door: SafetyDoor::new(profile.step_clock_hz),
            lines: LineIntake::new(),
            reference: Reference::ASSUMED,
            step_supply: StepSupply::AT_REST,
            accessories: Accessories::OFF,
            probe: Probe::NONE,
            inputs: InputLevels::UNKNOWN,
            drivers: Drivers::OFF,
            stops: Stops::NONE,
            replies: Replies::new(),
            pins: Pins::UNKNOWN,
            settings_lock: SettingsLock::new(&profile),
            records: Records::new(profile.has_store),
            now: Instant::from_ticks(0),
            answered_at: Instant::from_ticks(0),
        }
    }

    /// What is queued moves from here on.
    pub(super) fn start_motion(&mut self) {
        self.step_supply.start();
        self.motion.start();
    }

    #[inline(never)]
    pub(super) fn start_idle_delay(&mut self) {
        self.drivers.motion_ended(self.now, self.settings.whole(Key::IdleDelay));
    }

    /// M5 without a word of the program, if the spindle is on: the next line inherits it.
    pub(super) fn stop_spindle(&mut self) {
        if self.accessories.is_on() {
            self.accessories.stop_spindle();
            self.interpreter.set_accessories(SpindleDirection::Off, self.accessories.coolant());
            self.replies.overrides_changed();
        }
    }

    pub(super) fn switches(&self) -> AxisMask {
        AxisMask(self.inputs.signals().limits)
    }
}
