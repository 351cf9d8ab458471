//! Messages to the tasks that own output pins: levels of spindle, coolant and drivers, and the wiring (polarity, pulse
//! length, pull-ups, ganged motors) that follows from settings.

/// Direction of the spindle.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum SpindleDirection {
    /// M5.
    #[default]
    Off,
    /// M3.
    Clockwise,
    /// M4.
    CounterClockwise,
}

/// Coolant outputs; `true` is on.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Coolant {
    /// M8.
    pub flood: bool,
    /// M7.
    pub mist: bool,
}

/// Levels of the outputs that change slowly; `control` writes them.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SlowOutputs {
    /// Spindle enable and direction.
    pub spindle: SpindleDirection,
    /// Spindle power, 0 (off) to 65535 (full).
    pub power: u16,
    /// `true` in laser mode: while the step task is busy, the power comes from its segments
    /// ([`Segment::power`](super::Segment::power)), and `power` is not used.
    pub power_from_segments: bool,
    /// Coolant outputs for flood (M8) and mist (M7).
    pub coolant: Coolant,
    /// Motor drivers on.
    pub drivers: bool,
    /// Digital outputs of the program (M62 to M65), bit 0 for P0.
    pub digital: u8,
}

/// Wiring data from the settings, for the tasks that own the pins; sent at start and after each change.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Wiring {
    /// `$0`, length of a step pulse in tenths of a microsecond.
    pub pulse_tenths: u16,
    /// `$29`, time from a direction change to the next step in microseconds.
    pub direction_setup_us: u8,
    /// `$2`, bit set = step output active low.
    pub step_invert: u8,
    /// `$3`, bit set = direction output inverted.
    pub direction_invert: u8,
    /// `$4`, enable output inverted.
    pub enable_invert: bool,
    /// `$33`, frequency of the PWM for spindle or laser, 1 to 100,000 Hz.
    pub pwm_hz: u32,
    /// `$6`, probe input inverted. Used by the step task, which reads this pin itself.
    pub probe_invert: bool,
    /// Polarity and pull resistors of the inputs.
    pub inputs: InputWiring,
    /// Inputs ([`input`](super::input)) that stop the step task as soon as they become active, before `control` gets a
    /// message.
    pub armed: u32,
    /// `$905`, mask with one bit set: the axis whose steps also go to the second motor, bit 0 for X. 0 = no such axis.
    pub ganged: u8,
    /// `$906`, direction of the second motor inverted.
    pub ganged_invert: bool,
    /// Motors of the ganged axis that make steps. Changes only at rest.
    pub ganged_motors: GangedMotors,
}

/// Polarity and pull resistors of the inputs. Each field is a word with one bit per input, as in
/// [`input`](super::input).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct InputWiring {
    /// Inputs that are active while their pin is high. The others are active while it is low, as with a switch to
    /// ground and a pull-up.
    pub inverted: u32,
    /// Inputs without a pull-up.
    pub no_pull_up: u32,
    /// Inputs with a pull-down instead of a pull-up.
    pub pull_down: u32,
}

impl InputWiring {
    /// All inputs with pull-ups and active low.
    pub const PULL_UPS: InputWiring = InputWiring { inverted: 0, no_pull_up: 0, pull_down: 0 };
}

/// Which motors make steps on a ganged axis (an axis with two motors).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum GangedMotors {
    /// Both motors: always, except during squaring.
    #[default]
    Both,
    /// Only the motor on the axis' own pins, during squaring.
    First,
    /// Only the second motor, during squaring.
    Second,
}
