//! Writes the outputs that change slowly: driver enable with its polarity, spindle, coolant, and the outputs for
//! programs (M62 to M65).

use crate::boards::{SlowLevels, SlowPins};
use oxmill_controller::messages::{SlowOutputs, SpindleDirection};

/// The slow outputs, with the levels that `control` has last requested.
pub struct Outputs {
    pins: SlowPins,
    wanted: Option<SlowOutputs>,
    enable_invert: bool,
}

impl Outputs {
    /// Starts with all outputs off, as the board's set-up leaves them.
    pub fn new(pins: SlowPins) -> Outputs {
        Outputs { pins, wanted: None, enable_invert: false }
    }

    /// Sets the outputs to the levels `wanted`. Called by `control` for each change.
    pub fn show(&mut self, wanted: SlowOutputs) {
        self.wanted = Some(wanted);
        self.write();
    }

    /// Sets the polarity of the enable output (`$4`). `invert`: `true` if a high level switches the drivers on.
    pub fn set_enable_invert(&mut self, invert: bool) {
        self.enable_invert = invert;
        self.write();
    }

    fn write(&mut self) {
        let Some(wanted) = self.wanted else { return };
        self.pins.write(SlowLevels {
            // Without `enable_invert` the enable output is active low, as step-stick drivers need it.
            drivers: wanted.drivers == self.enable_invert,
            spindle: wanted.spindle != SpindleDirection::Off,
            spindle_reversed: wanted.spindle == SpindleDirection::CounterClockwise,
            flood: wanted.coolant.flood,
            mist: wanted.coolant.mist,
            program: wanted.digital,
        });
    }
}
