//! A controller on no board at all, for tests that call it themselves: its profile, and how it is powered up.
#![allow(dead_code, reason = "what a build leaves out uses a part of it")]

use oxmill_controller::memory::Memory;
use oxmill_controller::messages::{Event, Sensed};
use oxmill_controller::units::Instant;
use oxmill_controller::{Controller, Profile, StepRates};

/// Three axes, a step clock of a tick each microsecond, and no store.
pub const PROFILE: Profile = Profile {
    name: "test",
    step_clock_hz: 1_000_000,
    rates: StepRates { safe_hz: 100_000, least_pulse_tenths: 5 },
    axes: 3,
    has_second_motor: false,
    has_at_speed: true,
    program_pins: [0; 2],
    most_baud: 1_000_000,
    has_store: false,
};

/// The moment of the power-up.
pub const NOW: Instant = Instant::from_ticks(0);

/// Powered up, with no input active. What it says then has not been taken.
pub fn started(profile: Profile, blocks: usize) -> Box<Controller<3>> {
    let mut controller = Box::new(Controller::new(profile, Memory::on_heap(&profile, blocks)));
    controller.start(NOW);
    controller.event(NOW, Event::Signals(Sensed::default()));
    controller
}
