//! Messages of the inputs task: the bit of each input, the levels of all inputs, and which of them have stopped the
//! step task.

/// Bit of [`Signals::limits`] for the limit switch at the second motor of a ganged axis (an axis with two motors).
pub const SECOND_SWITCH: u8 = 1 << 6;

/// Number of each input's bit in a word of inputs. Limit switches have bits 0 to 6, as in [`Signals::limits`].
pub mod input {
    /// First input of the program (M66 P0).
    pub const PROGRAM: u32 = 7;
    /// Touch probe.
    pub const PROBE: u32 = 8;
    /// Safety door.
    pub const DOOR: u32 = 9;
    /// Feed-hold button.
    pub const HOLD: u32 = 10;
    /// Cycle-start (resume) button.
    pub const START: u32 = 11;
    /// Reset (abort) button.
    pub const RESET: u32 = 12;
    /// Emergency stop.
    pub const EMERGENCY_STOP: u32 = 13;
    /// Fault output of a motor driver.
    pub const DRIVER_FAULT: u32 = 14;
    /// The spindle is up to speed.
    pub const AT_SPEED: u32 = 15;
    /// Second input of the program (M66 P1).
    pub const SECOND_PROGRAM: u32 = 16;
    /// Number of bits in use.
    pub const COUNT: usize = 17;
}

/// Filtered levels of the input pins; a bit is set while the input is *active* (polarity already applied).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Signals {
    /// Limit switches, bit 0 for X; [`SECOND_SWITCH`] for the second motor of a ganged axis.
    pub limits: u8,
    /// Probe contact.
    pub probe: bool,
    /// Safety door open.
    pub door: bool,
    /// Feed-hold button.
    pub hold: bool,
    /// Cycle-start button.
    pub start: bool,
    /// Reset (abort) button.
    pub reset: bool,
    /// Emergency stop.
    pub emergency_stop: bool,
    /// A motor driver reports a fault.
    pub driver_fault: bool,
    /// At-speed input of the spindle (`$915`).
    pub at_speed: bool,
    /// Inputs of the program (M66), bit 0 for P0.
    pub program: u8,
}

impl Signals {
    /// No input is active.
    pub const NONE: Signals = Signals {
        limits: 0,
        probe: false,
        door: false,
        hold: false,
        start: false,
        reset: false,
        emergency_stop: false,
        driver_fault: false,
        at_speed: false,
        program: 0,
    };

    /// Returns the inputs of a word, see [`input`].
    pub fn of_word(word: u32) -> Signals {
        let bit = |n: u32| word >> n & 1 != 0;
        Signals {
            limits: word as u8 & 0x7F,
            probe: bit(input::PROBE),
            door: bit(input::DOOR),
            hold: bit(input::HOLD),
            start: bit(input::START),
            reset: bit(input::RESET),
            emergency_stop: bit(input::EMERGENCY_STOP),
            driver_fault: bit(input::DRIVER_FAULT),
            at_speed: bit(input::AT_SPEED),
            program: u8::from(bit(input::PROGRAM)) | u8::from(bit(input::SECOND_PROGRAM)) << 1,
        }
    }

    /// Returns the word of these inputs, see [`input`].
    pub fn word(&self) -> u32 {
        let bit = |on: bool, n: u32| u32::from(on) << n;
        u32::from(self.limits)
            | bit(self.probe, input::PROBE)
            | bit(self.door, input::DOOR)
            | bit(self.hold, input::HOLD)
            | bit(self.start, input::START)
            | bit(self.reset, input::RESET)
            | bit(self.emergency_stop, input::EMERGENCY_STOP)
            | bit(self.driver_fault, input::DRIVER_FAULT)
            | bit(self.at_speed, input::AT_SPEED)
            | bit(self.program & 1 != 0, input::PROGRAM)
            | bit(self.program & 2 != 0, input::SECOND_PROGRAM)
    }
}

/// inputs -> control: levels, and stops caused by armed inputs.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Sensed {
    /// The filtered levels when the message was sent.
    pub signals: Signals,
    /// Number of stops of the step task (wrapping) that armed inputs ([`Wiring::armed`](super::Wiring::armed)) have
    /// caused since power-up.
    pub trips: u8,
    /// Inputs that have stopped the step task since the previous message, bits as in [`input`]. They may be inactive
    /// again.
    pub tripped: u32,
}

/// The state of the input pins now, for `$PINS`; bits as in [`input`].
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct PinView {
    /// Inputs that have a pin.
    pub fitted: u32,
    /// Pins that are low, before polarity and filter.
    pub low: u32,
    /// For each pin, the number of changes that the filter has rejected since power-up or the last clearing
    /// (saturating).
    pub noise: [u16; input::COUNT],
}
