//! Picks the board that the firmware is built for: exactly one, by feature.
//!
//! Boards know pins, clocks and registers, and nothing of motion or of what a user types. Each provides these names:
//!
//! | name | is |
//! |---|---|
//! | `pac` | the device crate, for RTIC |
//! | `PROFILE`, `AXES`, `BLOCKS` | its row of `profiles.rs`, and the two numbers of it that are types |
//! | `CLOCK_TICKS_PER_US`, `clock_ticks()` | a free-running counter of 32 bits from which the firmware tells the time |
//! | `CORE_HZ`, `SAMPLE_HZ` | clock of SysTick, which samples the inputs, and how often it does |
//! | `setup(device) -> Parts` | everything below, set up once; outputs are off |
//! | `StepTimer`, `Due` | free-running counter at the step clock with three moments: next tick, end of pulse, some time after it |
//! | `call_step()` | calls the step task from any task, at once |
//! | `ask_step()` | the same for what is not urgent: not so shortly before an edge that the call delays it |
//! | `StepPins` | step and direction outputs and the spindle's PWM |
//! | `SerialPort` | the UART to the host, a [`Port`] |
//! | `UsbPort` | the USB link to the host, a [`Port`]; [`NoPort`] on a board without one |
//! | `InputPins` | limit switches, probe, buttons, as they are now; which of them exist; their pull resistors |
//! | `SlowPins` | driver enable, spindle, coolant |
//! | `SettingsFlash` | two sectors of flash for the settings; what the host sends while they are written is not lost |
//! | `safe_state()` | at any moment, from any context: no pulses, no beam, spindle and coolant off |
//! | `preloaded_job()` | a job that somebody put into RAM before the reset; no board but QEMU has one |
//! | `job_done()` | the end of a preloaded job |
//! | `idle()` | sleeps until the next interrupt |
//! | `Watchdog` | resets the processor if it has not been fed for some seconds |
//! | `reset_cause()` | why the processor began anew; asked once |
//! | `restart(why)` | the end after a failure: logs it and resets the processor; outputs are already safe |

#[allow(dead_code, reason = "the rows of the other boards")]
#[path = "profiles.rs"]
pub mod profiles;

#[cfg(any(feature = "blackpill_f411", feature = "blackpill_f401"))]
#[path = "blackpill.rs"]
mod blackpill;
#[cfg(any(feature = "nucleo_f446re", feature = "nucleo_f411re", feature = "nucleo_f401re"))]
#[path = "nucleo64.rs"]
mod nucleo64;
#[cfg(not(feature = "qemu_mps2"))]
#[path = "stm32f4.rs"]
mod stm32f4;
#[cfg(not(feature = "qemu_mps2"))]
#[path = "stm32f4_step.rs"]
mod stm32f4_step;

#[cfg(feature = "blackpill_f411")]
#[path = "blackpill_f411/mod.rs"]
mod chosen;
#[cfg(feature = "blackpill_f401")]
#[path = "blackpill_f401/mod.rs"]
mod chosen;
#[cfg(feature = "nucleo_f446re")]
#[path = "nucleo_f446re/mod.rs"]
mod chosen;
#[cfg(feature = "nucleo_f411re")]
#[path = "nucleo_f411re/mod.rs"]
mod chosen;
#[cfg(feature = "nucleo_f401re")]
#[path = "nucleo_f401re/mod.rs"]
mod chosen;
#[cfg(feature = "qemu_mps2")]
#[path = "qemu_mps2/mod.rs"]
mod chosen;

#[cfg(not(feature = "board"))]
compile_error!("choose a board: `cargo fw BOARD`, or one of the features of this package");

#[path = "second_motor.rs"]
mod second_motor;

pub use chosen::*;
pub use second_motor::SecondMotor;

use oxmill_controller::{Profile, StepRates};

/// What the controller must know of a board.
const fn profile(board: &profiles::Board, has_second_motor: bool) -> Profile {
    Profile {
        name: board.name,
        step_clock_hz: board.step_clock_hz,
        rates: StepRates { safe_hz: board.safe_step_hz, attention_ns: board.attention_ns },
        has_second_motor,
        has_store: true,
    }
}

/// Levels of the slow outputs as they appear on the pins.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct SlowLevels {
    /// The enable input of the motor drivers.
    pub drivers: bool,
    /// Spindle on.
    pub spindle: bool,
    /// Spindle turns counter-clockwise.
    pub spindle_reversed: bool,
    /// Flood coolant.
    pub flood: bool,
    /// Mist coolant.
    pub mist: bool,
}

/// A link to a host.
pub trait Port {
    /// Whether a byte that is not fetched waits (true) or is overwritten by the next (false).
    const WAITS: bool;

    /// Does what the link itself needs, and tells whether a host is there: a UART cannot know, and always says so.
    fn poll(&mut self) -> bool {
        true
    }
    /// The next byte, if one has come.
    fn receive(&mut self) -> Incoming;
    /// For so many bytes there is room; with too little the sender is to wait, if it can. Called after each round of
    /// [`Port::receive`].
    fn allow(&mut self, room: usize);
    /// Sends a byte, if there is room for it.
    fn send(&mut self, byte: u8) -> bool;
    /// What was sent goes out; and whether to be called when there is room for more.
    fn call_when_free(&mut self, wanted: bool);
}

/// A link that a board does not have: nobody ever comes.
#[allow(dead_code, reason = "some boards have both links")]
pub struct NoPort;

impl Port for NoPort {
    const WAITS: bool = true;

    fn poll(&mut self) -> bool {
        false
    }

    fn receive(&mut self) -> Incoming {
        Incoming::Nothing
    }

    fn allow(&mut self, _room: usize) {}

    fn send(&mut self, _byte: u8) -> bool {
        true
    }

    fn call_when_free(&mut self, _wanted: bool) {}
}

/// What `Port::receive` found.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Incoming {
    /// A byte.
    Byte(u8),
    /// One or more bytes came and are lost.
    #[allow(dead_code, reason = "not on links that wait")]
    Lost,
    /// Nothing new.
    Nothing,
}

/// Bits of the word that `InputPins::read` gives. A bit is set while its pin is low: the inputs have pull-ups, if no setting
/// says otherwise, and their switches close to ground. No board has a pin for an emergency stop besides that of the reset
/// button (`$912`).
pub mod input_bits {
    /// Limit switch of X; Y and Z follow.
    pub const LIMITS: u32 = 0;
    /// Limit switch of the second motor of an axis.
    pub const SECOND_LIMIT: u32 = 6;
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
    /// Fault output of the motor drivers.
    pub const DRIVER_FAULT: u32 = 14;
    /// Output of a spindle's drive: up to speed.
    pub const AT_SPEED: u32 = 15;
}
