//! What a board and the program on it owe each other. A board provides step outputs (`StepOutput`), links to the host
//! (`Port`), inputs, slow outputs, flash and a watchdog; it may call one function of the program. The compiler checks
//! it in `held`.
//!
//! A board knows pins, clocks and registers. It knows nothing of motion, of tasks or of what a user types, and calls
//! no program above it. What it offers is re-exported at the root of this crate; the compiler compares it with the
//! signatures at the end of this file.
//!
//! # What each board provides
//!
//! | name | is |
//! |---|---|
//! | `pac` | the device crate: registers and interrupt numbers, for RTIC |
//! | `vectors!(app)` | calls the macro `app` with the names of the interrupt vectors of the tasks; `serial` is that of no peripheral if there is a `receive` |
//! | `PROFILE`, `AXES`, `BLOCKS` | its row of [`profiles`](crate::profiles), and the two numbers of it that are types |
//! | `RECORDING_PAGES` | pages of 256 bytes for the recording of what comes in; 0 = there is none |
//! | `CLOCK_TICKS_PER_US`, `clock_ticks()` | a free-running counter of 32 bits from which the program tells the time |
//! | `CORE_HZ`, `SAMPLE_HZ` | clock of SysTick, which samples the inputs, and how often it does |
//! | `RUN_CYCLES` | more cycles than the longest run of the step task takes that makes events |
//! | `WATCHES_CLOCK` | whether the non-maskable interrupt tells that the clock of the processor has failed, and nothing else |
//! | `setup(device, low_voltage) -> Parts` | everything below, set up once; outputs are off |
//! | `USUAL_BAUD` | the rate of the UART if no setting says another |
//! | `UartInput` | what the UART receives, up to the messages to the serial task; `on_interrupt` too, on a board with a vector `uart` |
//! | `call_step()` | makes the interrupt of the step task pending, from any task |
//! | `call_serial()` | makes the interrupt of the serial task pending |
//! | `StepPins` | step and direction outputs, which put out events at their moments, and the spindle's PWM: a [`StepOutput`] |
//! | `SerialPort` | the UART to the host, a [`Port`] |
//! | `UsbPort` | the USB link to the host, a [`Port`]; [`NoPort`] on a board without one |
//! | `InputPins` | limit switches, probe, buttons, as they are now; which of them exist; their pull resistors |
//! | `SlowPins` | driver enable, spindle, coolant, outputs of programs |
//! | `SettingsFlash` | two sectors of flash for the settings; what the host sends while they are written is not lost |
//! | `safe_state()` | at any moment, from any context: no pulses, no beam, spindle, coolant and outputs of programs off |
//! | `preloaded_job()` | a job that was put into RAM before the reset; no board but QEMU has one |
//! | `job_done()` | the end of a preloaded job |
//! | `idle()` | sleeps until the next interrupt |
//! | `Watchdog` | resets the processor if it has not been fed for some seconds |
//! | `reset_cause()` | the cause of the last reset; to be asked once |
//! | `restart(why)` | the end after a failure: logs it and resets the processor; outputs are already safe |
//! | [`stack`](crate::stack) | size and greatest depth of the stack that the linker script lays out |
//!
//! # What a board may ask of the program
//!
//! | when | call |
//! |---|---|
//! | the supply falls below the least that the drivers' inputs are sure of | `low_voltage`, the function given to `setup`: highest priority, does not return |
//! | the clock of the processor fails, with `WATCHES_CLOCK` | `NonMaskableInt`, the exception by its name: the processor continues by a slower clock, and the handler does not return |
//! | a vector of `vectors!` fires | the task bound to it |
//! | the processor stops while flash is written | nothing: see `SettingsFlash` |

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
    /// Outputs of programs (M62 to M65), bit 0 for P0.
    pub program: u8,
}

/// What the step task has been called for. The bits are those of the compare channels of an STM32F4's timer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Due(pub u32);

impl Due {
    /// An event is out: only while events are put out one by one.
    pub const OUT: Due = Due(2);
    /// The moment of [`StepOutput::call_at`].
    pub const MORE: Due = Due(4);
    /// The moment of [`StepOutput::mark_at`].
    pub const MARK: Due = Due(8);
    /// Another task has called.
    pub const CALLED: Due = Due(16);

    /// Whether `what` is among it.
    #[inline(always)]
    pub fn has(self, what: Due) -> bool {
        self.0 & what.0 != 0
    }
}

/// Combinations of steps of the axes of the board, bit 0 for X.
pub const COMBINATIONS: usize = 1 << crate::AXES;

/// Free places for events, in a row: none when there is no room, one while events are put out one by one.
pub struct Free<'a> {
    /// The words of all combinations of steps, with the directions that hold.
    pub table: &'a [u32; COMBINATIONS],
    /// For the word of each event.
    pub words: &'a mut [u32],
    /// For its moment.
    pub moments: &'a mut [u32],
}

/// What did not come out when outputs were halted.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Undone<const N: usize> {
    /// Events.
    pub events: usize,
    /// Net steps of them.
    pub net: [i32; N],
    /// The parts that count events disagree: no count of steps can be trusted any more.
    pub fault: bool,
}

/// Puts out events at their moments. An event is a pulse on some axes, or on none, and a moment of the step clock; it writes
/// the directions, too. A pulse ends by itself.
///
/// ```text
///  task    commit commit commit              call_at ──▶ MORE: commit ...
///            │      │      │                    ▲
///  ring    ──▼──────▼──────▼────────────────────┼──▶ an event at each moment, without the processor
/// ```
/// Events are begun with [`StepOutput::begin`] and follow each other by themselves as long as each is committed in time
/// ([`StepOutput::joins_until`]). If one is not, they come to an end; [`StepOutput::halt`] and another begin are needed then.
pub trait StepOutput<const N: usize> {
    /// Events that can be ahead. 1: each is put out by a call of its own.
    const DEPTH: usize;
    /// How far ahead of now, in ticks, the moment of an event must lie that is put out by a call of its own.
    const SOON: u32;

    /// The step clock.
    fn now(&self) -> u32;
    /// What the task has been called for, once each.
    fn take(&mut self) -> Due;
    /// Calls the task at a moment; at once if it has passed.
    fn call_at(&mut self, moment: u32);
    /// The same for [`Due::MARK`]; if a power is given, it changes at that very moment, whatever the processor is doing, or at once if the
    /// moment has passed. One such moment is kept, the last that was given. [`StepOutput::set_power`] and [`StepOutput::halt`] before it
    /// take the change back, and not the call.
    fn mark_at(&mut self, moment: u32, power: Option<u16>);

    /// Directions of the events that are committed from here on; a set bit means negative.
    fn direct(&mut self, directions: u8);
    /// Where the next events go.
    fn free(&mut self) -> Free<'_>;
    /// As many of the free places hold events now. Gives the ticks by which the event was put off that was too late while events are put
    /// out one by one.
    fn commit(&mut self, events: usize) -> u32;
    /// Time passes for the stepper: from the event committed last to its next tick.
    fn pass(&mut self, ticks: u32);
    /// Events that are committed and not out, never fewer than there are.
    fn ahead(&self) -> usize;
    /// The moment after which that many are left of those that are ahead; with too few ahead, one that has passed.
    fn moment_before(&self, left: usize) -> u32;
    /// Until when an event can be committed that is to follow on those before it by itself; `next` is its moment.
    fn joins_until(&self, next: u32) -> u32;
    /// Events are begun; `one_by_one`: each is to be followed by a call, and the next committed only then.
    /// Gives the ticks by which all that is committed was put off: 0, unless it was too late for the first event.
    fn begin(&mut self, one_by_one: bool) -> u32;
    /// Whether the parts that count events disagree, or have failed, while events are put out.
    fn fault(&self) -> bool;
    /// No event begins after this, and no change of power comes; `dark`: power is 0 right after it, if events had begun. A pulse that is out gets
    /// its full length. What the task has been called for need not have been taken before.
    fn halt(&mut self, dark: bool) -> Undone<N>;

    /// At rest: which outputs are inverted (bit set) and what the second motor does.
    fn set_polarity(&mut self, step_invert: u8, direction_invert: u8, second: SecondMotor);
    /// At rest: the length of a pulse, tenths of a microsecond. It is never shorter, and longer by less than a tick.
    fn set_pulse(&mut self, tenths: u16);
    /// The frequency of the spindle's PWM, and the power that stays in force.
    fn set_pwm(&mut self, hz: u32, power: u16);
    /// The power of spindle or laser, 0 to 65535, from now on.
    fn set_power(&mut self, power: u16);
    /// Whether the probe's pin is low, unfiltered.
    fn probe_low(&self) -> bool;
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
    /// The bytes that [`Port::receive`] would give next, as far as they have been fetched together.
    #[inline]
    fn fetched(&mut self) -> &[u8] {
        &[]
    }
    /// So many of these have been taken.
    #[inline]
    fn pass(&mut self, _count: usize) {}
    /// Whether a command that stops the machine is among what has come.
    #[inline]
    fn is_urgent(&mut self) -> bool {
        false
    }
    /// For so many bytes there is room; with too little the sender is to wait, if it can. Called after each round of
    /// [`Port::receive`].
    fn allow(&mut self, room: usize);
    /// Sends a byte, if there is room for it.
    fn send(&mut self, byte: u8) -> bool;
    /// Sends the first of some bytes, as far as there is room. Gives how many.
    #[inline]
    fn send_text(&mut self, bytes: &[u8]) -> usize {
        bytes.iter().take_while(|byte| self.send(**byte)).count()
    }
    /// What was sent goes out; and whether to be called when there is room for more.
    fn call_when_free(&mut self, wanted: bool);
}

/// A link that a board does not have: no byte ever comes.
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
    /// First input of programs (M66 P0).
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
    /// Fault output of the motor drivers.
    pub const DRIVER_FAULT: u32 = 14;
    /// Output of a spindle's drive: up to speed.
    pub const AT_SPEED: u32 = 15;
    /// Second input of programs (M66 P1).
    pub const SECOND_PROGRAM: u32 = 16;
}

/// How the pins of the fourth motor are driven: as the second motor of an axis, or not at all.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct SecondMotor {
    /// Its axis, bit 0 for X; 0 = there is none.
    pub axis: u8,
    /// It turns the other way.
    pub inverted: bool,
    /// It holds still while its axis moves.
    pub stands: bool,
    /// The axis' own motor holds still.
    pub first_stands: bool,
}

/// The compiler holds the chosen board to the tables above.
#[cfg(feature = "board")]
mod held {
    use super::{Port, SlowLevels, StepOutput};
    use crate as board;
    use crate::uart_receiver::Look;
    use core::fmt::Arguments;
    use oxmill_controller::{Profile, ResetCause};
    use oxmill_store::Flash;

    const _: &Profile = &board::PROFILE;
    const _: [usize; 3] = [board::AXES, board::BLOCKS, board::RECORDING_PAGES];
    const _: [u32; 4] = [board::CLOCK_TICKS_PER_US, board::CORE_HZ, board::SAMPLE_HZ, board::RUN_CYCLES];
    const _: bool = board::WATCHES_CLOCK;
    const _: fn(board::pac::Peripherals, fn() -> !) -> board::Parts = board::setup;
    const _: fn() -> u32 = board::clock_ticks;
    const _: [fn(); 5] = [board::call_step, board::call_serial, board::safe_state, board::job_done, board::idle];
    const _: u32 = board::USUAL_BAUD;
    const _: fn(&mut board::UartInput, u32) = board::UartInput::start;
    const _: fn(&mut board::UartInput) -> Look = board::UartInput::look;
    const _: fn(&mut board::UartInput, bool) = board::UartInput::pass_on;
    const _: fn() -> Option<&'static [u8]> = board::preloaded_job;
    const _: fn() -> ResetCause = board::reset_cause;
    const _: fn(Arguments<'_>) -> ! = board::restart;

    const fn is_port<P: Port>() {}
    const fn is_flash<F: Flash>() {}
    const fn is_output<O: StepOutput<{ board::AXES }>>() {}
    const _: () = (is_port::<board::SerialPort>(), is_port::<board::UsbPort>(), is_flash::<board::SettingsFlash>()).0;
    const _: () = is_output::<board::StepPins>();

    const _: fn(&board::Parts) = |parts| {
        let _: &board::StepPins = &parts.step_pins;
        let _: (&board::UartInput, &board::SerialPort, &board::UsbPort) =
            (&parts.uart_input, &parts.serial, &parts.usb);
        let _: (&board::InputPins, &board::SlowPins) = (&parts.inputs, &parts.slow_pins);
        let _: (&board::SettingsFlash, &board::Watchdog) = (&parts.settings_flash, &parts.watchdog);
    };

    const _: fn(&mut board::InputPins) -> u32 = board::InputPins::read;
    const _: fn(&board::InputPins) -> u32 = board::InputPins::fitted;
    const _: fn(&mut board::InputPins, u32, u32) = board::InputPins::set_pulls;
    const _: fn(&mut board::SlowPins, SlowLevels) = board::SlowPins::write;
    const _: [fn(&mut board::Watchdog); 2] = [board::Watchdog::start, board::Watchdog::feed];
}
