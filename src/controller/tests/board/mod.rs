//! A controller without a board, for tests that call it directly: its profile and its power-up.
#![allow(dead_code, reason = "what a build leaves out uses a part of it")]

use oxmill_controller::gcode::LEAST_HELD;
use oxmill_controller::memory::Memory;
use oxmill_controller::messages::{Event, Sensed};
use oxmill_controller::units::Instant;
use oxmill_controller::{Controller, Profile, StepRates};

/// The board of the tests: three axes, a step clock of 1 MHz, and no store for settings.
pub const PROFILE: Profile = Profile {
    name: "test",
    step_clock_hz: 1_000_000,
    rates: StepRates { safe_hz: 100_000, least_pulse_tenths: 5 },
    axes: 3,
    has_second_motor: false,
    has_at_speed: true,
    program_pins: [0; 2],
    most_baud: 1_000_000,
    oscillator_mhz: 0,
    has_store: false,
    has_loader: false,
};

/// The time of power-up, 0 µs. Most tests pass this time in every call, as if no time went by.
pub const NOW: Instant = Instant::from_ticks(0);

/// Returns a powered-up controller with no input active. `blocks`: the capacity of the look-ahead. The caller still
/// has to take the outputs of the power-up, such as the welcome line.
pub fn started(profile: Profile, blocks: usize) -> Box<Controller<3>> {
    let mut controller = Box::new(Controller::new(profile, Memory::on_heap(&profile, blocks, LEAST_HELD)));
    controller.start(NOW);
    controller.event(NOW, Event::Signals(Sensed::default()));
    controller
}
