//! Interface between a board and the program on it. A board provides step outputs (`StepOutput`), links to the host
//! (`Port`), inputs, slow outputs, flash and a watchdog. The first table lists all that a board provides. The module
//! `held` makes the compiler check that the chosen board provides it.
//!
//! A board consists of pins, clocks and registers. It contains nothing about motion, tasks or the protocol. It calls
//! the program only in the cases of the second table. The root of this crate re-exports the items of the chosen board.
//!
//! # What each board provides
//!
//! | name | is |
//! |---|---|
//! | `pac` | the device crate: registers and interrupt numbers, for RTIC |
//! | `vectors!(app)` | calls the macro `app` with the names of the interrupt vectors of the tasks; `serial` is the vector of an unused peripheral if there is a vector `uart` |
//! | `PROFILE` | the numbers of the image, from its entry of [`profiles`](crate::profiles) |
//! | `AXES`, `BLOCKS` | number of axes, and blocks of the look-ahead, from the same entry; used as const generics |
//! | `HELD_BYTES` | bytes of memory for subroutines, loops and macros, from the same entry |
//! | `profile()` | the profile of the board: `PROFILE` with the name and the pins of the [pin table](mod@crate::pin_table) |
//! | `PORTS` | number of GPIO ports that have pins in use |
//! | `RECORDING_PAGES` | pages of 256 bytes for the recording of inputs and received bytes; 0 = no recording |
//! | `CLOCK_TICKS_PER_US`, `clock_ticks()` | a free-running 32-bit counter, the program's clock |
//! | `CORE_HZ`, `SAMPLE_HZ` | clock of SysTick, and the rate at which SysTick samples the inputs |
//! | `RUN_CYCLES` | maximum duration, in CPU cycles, of a run of the step task that generates events |
//! | `WATCHES_CLOCK` | `true` if the non-maskable interrupt has only one cause: the processor's clock has failed |
//! | `setup(device, low_voltage) -> Parts` | sets up everything below, once; outputs are off |
//! | `USUAL_BAUD` | default baud rate of the UART |
//! | `UartInput` | receives from the UART and sends messages to the serial task; on a board with a vector `uart` it also has `on_interrupt` |
//! | `call_step()` | makes the interrupt of the step task pending, from any task |
//! | `call_serial()` | makes the interrupt of the serial task pending |
//! | `StepPins` | step and direction outputs, which output each event at its time, and the spindle's PWM: a [`StepOutput`] |
//! | `SerialPort` | the UART to the host, a [`Port`] |
//! | `UsbPort` | the USB link to the host, a [`Port`]; [`NoPort`] on a board without one |
//! | `InputPins` | present levels of limit switches, probe and buttons; which of them exist; their pull resistors |
//! | `SlowPins` | driver enable, spindle, coolant, outputs for programs |
//! | `SettingsFlash` | two sectors of flash for the settings; bytes that the host sends while a sector is written or erased are not lost |
//! | `safe_state()` | callable at any time, from any context: ends pulses; switches laser, spindle, coolant and the outputs for programs off |
//! | `preloaded_job()` | a job that was put into RAM before the reset; only the QEMU board has one |
//! | `job_done()` | called by the program when a preloaded job has ended |
//! | `idle()` | sleeps until the next interrupt |
//! | `Watchdog` | resets the processor if it has not been fed for some seconds |
//! | `reset_cause()` | returns and clears the cause of the last reset: call once |
//! | `restart(why)` | last call after a failure: logs it and resets the processor; outputs are already safe |
//! | `HAS_LOADER` | whether a host can load new firmware through a boot loader in the chip's ROM |
//! | `reboot(into_loader)` | at a host's request: makes outputs safe and resets; `into_loader`: into the boot loader |
//! | `enter_loader_if_requested()` | first call after a reset: enters the boot loader if `reboot` has requested it |
//! | [`stack`](crate::stack) | size and maximum depth of the stack that the linker script lays out |
//!
//! # What a board may call
//!
//! | when | call |
//! |---|---|
//! | the supply falls below the level at which the motor drivers read their inputs reliably | `low_voltage`, the function given to `setup`: highest priority, does not return |
//! | the clock of the processor fails, with `WATCHES_CLOCK` | the exception handler `NonMaskableInt`: the processor runs on a slower clock; the handler does not return |
//! | a vector of `vectors!` fires | the task bound to it |
//! | flash is written and stalls the processor | nothing: the board itself keeps the bytes that arrive (`SettingsFlash`) |

/// Levels of the slow outputs as they appear on the pins: true is high.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct SlowLevels {
    /// The enable input of the motor drivers.
    pub drivers: bool,
    /// Spindle on.
    pub spindle: bool,
    /// Spindle direction is counter-clockwise.
    pub spindle_reversed: bool,
    /// Flood coolant (M8).
    pub flood: bool,
    /// Mist coolant (M7).
    pub mist: bool,
    /// Outputs for programs (M62 to M65), bit 0 for P0.
    pub program: u8,
}

/// Reasons for a call of the step task, one bit each. An STM32F4 has the compare flags of its step timer (status
/// register) at the same bits.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Due(pub u32);

impl Due {
    /// An event has been output. This reason is set only while each event is output by an interrupt of its own.
    pub const OUT: Due = Due(2);
    /// The time set by [`StepOutput::call_at`] has come.
    pub const MORE: Due = Due(4);
    /// The time set by [`StepOutput::mark_at`] has come.
    pub const MARK: Due = Due(8);
    /// Another task has called the step task.
    pub const CALLED: Due = Due(16);

    /// Returns whether any reason of `what` is set.
    #[inline(always)]
    pub fn has(self, what: Due) -> bool {
        self.0 & what.0 != 0
    }
}

/// Number of combinations of axes that step together: 8 with three axes. A combination is a bit mask; bit 0 is X.
pub const COMBINATIONS: usize = 1 << crate::AXES;

/// Contiguous free slots of the queue for the next events. There are none if the queue is full. While events are
/// output one by one, there is at most one.
pub struct Free<'a> {
    /// Entries to write into `words`. The index is the combination of axes that step in the event. With one GPIO port,
    /// the entry is the word for that port, with the present directions. With several ports, it is a code that
    /// [`StepOutput::commit`] translates.
    pub table: &'a [u32; COMBINATIONS],
    /// Slots for the entries of `table`, one for each event.
    pub words: &'a mut [u32],
    /// Slots for the times of the events, in ticks of the step clock.
    pub moments: &'a mut [u32],
}

/// Events that [`StepOutput::halt`] cancelled.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Undone<const N: usize> {
    /// Number of cancelled events.
    pub events: usize,
    /// Net steps of the cancelled events, for each axis.
    pub net: [i32; N],
    /// `true` if the hardware's event counters disagree or the hardware reports an error. Then `net` and the machine
    /// position are unreliable.
    pub fault: bool,
}

/// Outputs events at given times. An event is a step pulse on some axes (or on none) at a time of the step clock. It
/// also sets the direction pins. The hardware ends each pulse.
///
/// ```text
///  step task   commit  commit  commit  call_at(t)   at t, called with MORE:  commit  commit ...
///                │       │       │                                             │       │
///  queue      ───▼───────▼───────▼─────────────────────────────────────────────▼───────▼──▶ each event at its time
/// ```
/// The step task commits events. Then it sets the time of its next call ([`StepOutput::call_at`]), which must come
/// before the queue is empty. At this time the board calls the step task with [`Due::MORE`], and the task commits more
/// events.
///
/// [`StepOutput::begin`] starts the output. From then on, the events are output without the CPU. Each event must be
/// committed in time ([`StepOutput::joins_until`]). If an event is committed too late, the output ends before this
/// event. Then the step task must call [`StepOutput::halt`], and `begin` again.
pub trait StepOutput<const N: usize> {
    /// Maximum number of committed events that have not been output. If the number is 1, each event is output by an
    /// interrupt of its own.
    const DEPTH: usize;
    /// Minimum time from the commit of an event to its output, in ticks of the step clock. It applies only while each
    /// event is output by an interrupt of its own.
    const SOON: u32;

    /// Returns the time of the step clock in ticks; it wraps after 2^32.
    fn now(&self) -> u32;
    /// Returns the reasons for the present call of the step task, and clears them.
    fn take(&mut self) -> Due;
    /// Calls the step task with [`Due::MORE`] at `moment`, or at once if `moment` has passed. Cancels the call that an
    /// earlier `call_at` has scheduled.
    fn call_at(&mut self, moment: u32);
    /// Calls the step task with [`Due::MARK`] at `moment`, or at once if `moment` has passed. With `power` (0 to
    /// 65535), the power of the laser also changes at that time. The hardware changes it without the CPU; on a board
    /// that cannot do so, [`StepOutput::take`] changes it.
    ///
    /// Each `mark_at` cancels the call and the change of power of an earlier one. A [`StepOutput::set_power`] or
    /// [`StepOutput::halt`] before `moment` cancels the change of power, but not the call.
    fn mark_at(&mut self, moment: u32, power: Option<u16>);

    /// Sets the directions of all events committed from now on; a set bit means negative.
    fn direct(&mut self, directions: u8);
    /// Returns the free slots for the next events.
    fn free(&mut self) -> Free<'_>;
    /// Queues the events that were written into the first `events` free slots. While events are output one by one,
    /// returns the ticks by which a late event was delayed; otherwise 0.
    fn commit(&mut self, events: usize) -> u32;
    /// Notes a tick of the stepper. The step task calls this for each tick that it executes by itself, but not for the
    /// ticks of a batch. `ticks`: time from this tick to the next one, in ticks of the step clock. Only the QEMU board
    /// needs this, for its digest (checksum) of the steps.
    fn pass(&mut self, ticks: u32);
    /// Returns the number of committed events that have not been output. It can be too high, but never too low.
    fn ahead(&self) -> usize;
    /// Returns the time at which only `left` of the committed events remain to be output. If no more than `left`
    /// events remain already, returns a time that is not in the future.
    fn moment_before(&self, left: usize) -> u32;
    /// Returns the deadline for committing an event due at `next`. If the event is committed by this time, the output
    /// continues with it and need not be started again.
    fn joins_until(&self, next: u32) -> u32;
    /// Starts the output. With `one_by_one`, the step task is called with [`Due::OUT`] after each event and must not
    /// commit the next event before that call. If it is too late for the first event, delays all committed events and
    /// returns this delay in ticks; otherwise returns 0.
    fn begin(&mut self, one_by_one: bool) -> u32;
    /// Returns whether the output has failed: the hardware's event counters disagree, or the hardware reports an error.
    fn fault(&self) -> bool;
    /// Ends the output: after this, no event begins and no scheduled power change happens. With `dark`, also sets the
    /// power to 0 if output had started. A pulse that has begun gets its full length. The caller need not call
    /// [`StepOutput::take`] first.
    fn halt(&mut self, dark: bool) -> Undone<N>;

    /// Sets which outputs are inverted (one bit for each axis) and the role of the second motor. Call at rest.
    fn set_polarity(&mut self, step_invert: u8, direction_invert: u8, second: SecondMotor);
    /// Sets the minimum pulse length in tenths of a microsecond. The actual length can be longer, by less than a tick
    /// of the pulse timer. Call at rest.
    fn set_pulse(&mut self, tenths: u16);
    /// Sets the frequency of the spindle's PWM, Hz. `power`: the present power, 0 to 65535. The compare value of a
    /// power depends on the frequency, so this function writes the power again.
    fn set_pwm(&mut self, hz: u32, power: u16);
    /// Sets the power of spindle or laser at once, 0 to 65535.
    fn set_power(&mut self, power: u16);
    /// Returns whether the probe's pin is low at this moment, unfiltered.
    fn probe_low(&self) -> bool;
}

/// A link to a host.
pub trait Port {
    /// `true` if a received byte waits until it is fetched; `false` if the next byte can overwrite it.
    const WAITS: bool;

    /// Services the link and returns whether a host is connected. A UART cannot detect a host and always returns true.
    fn poll(&mut self) -> bool {
        true
    }
    /// Fetches the next received byte, if any.
    fn receive(&mut self) -> Incoming;
    /// Returns the next received bytes without consuming them. These are only the bytes of one contiguous buffer, so
    /// more bytes may be waiting.
    #[inline]
    fn fetched(&mut self) -> &[u8] {
        &[]
    }
    /// Consumes the first `count` bytes of [`Port::fetched`].
    #[inline]
    fn pass(&mut self, _count: usize) {}
    /// Returns whether a command that stops the machine is among the received bytes.
    #[inline]
    fn is_urgent(&mut self) -> bool {
        false
    }
    /// Tells the link that the program has space for `room` bytes. If the link can make its sender wait, the sender
    /// waits while `room` is too small (on USB: less than a packet of 64 bytes). Called whenever the program has
    /// finished a series of calls of [`Port::receive`].
    fn allow(&mut self, room: usize);
    /// Queues a byte for sending. Returns false if the queue is full.
    fn send(&mut self, byte: u8) -> bool;
    /// Queues as many of the bytes as fit. Returns their number.
    #[inline]
    fn send_text(&mut self, bytes: &[u8]) -> usize {
        bytes.iter().take_while(|byte| self.send(**byte)).count()
    }
    /// Starts sending the queued bytes. With `wanted`, the serial task is called when there is space for more.
    fn call_when_free(&mut self, wanted: bool);
}

/// Placeholder for a link that a board does not have: it receives nothing, and drops all bytes sent.
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

/// Result of `Port::receive`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Incoming {
    /// The oldest byte that has not been fetched yet.
    Byte(u8),
    /// One or more bytes were lost before the next one.
    Lost,
    /// No byte has arrived.
    Nothing,
}

/// Bit numbers of the word that `InputPins::read` returns. A bit is set while its pin is low: by default an input has a
/// pull-up, and an active switch connects it to ground. An emergency stop uses the pin of the reset button (`$912`).
pub mod input_bits {
    /// Limit switch of X; the other axes follow in order.
    pub const LIMITS: u32 = 0;
    /// Limit switch of the second motor of an axis.
    pub const SECOND_LIMIT: u32 = 6;
    /// First input for programs (M66 P0).
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
    /// At-speed output of a spindle drive: the spindle has reached its speed.
    pub const AT_SPEED: u32 = 15;
    /// Second input for programs (M66 P1).
    pub const SECOND_PROGRAM: u32 = 16;
}

/// Use of the pins of the fourth motor. They can drive a second motor of an axis, such as Y of a gantry. Otherwise
/// they drive axis A on a board with four axes, and nothing on a board with three.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct SecondMotor {
    /// The axis that has a second motor, as a bit mask (bit 0 for X); 0 = no second motor.
    pub axis: u8,
    /// The second motor's direction is inverted.
    pub inverted: bool,
    /// The second motor gets no steps, so that the first motor of the axis moves alone (to square the axis).
    pub gets_no_steps: bool,
    /// The first motor of the axis gets no steps, so that the second motor moves alone (to square the axis).
    pub first_gets_no_steps: bool,
}

/// Makes the compiler check that the chosen board provides the items in the first table of this file, with these types.
#[cfg(feature = "board")]
mod held {
    use super::{Port, SlowLevels, StepOutput};
    use crate as board;
    use crate::uart_receiver::Look;
    use core::fmt::Arguments;
    use oxmill_controller::{Profile, ResetCause};
    use oxmill_store::Flash;

    const _: &Profile = &board::PROFILE;
    const _: fn() -> Profile = board::profile;
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
    const _: bool = board::HAS_LOADER;
    const _: (fn(bool) -> !, fn()) = (board::reboot, board::enter_loader_if_requested);

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
        let _: &Option<&'static str> = &parts.fault;
    };

    const _: fn(&mut board::InputPins) -> u32 = board::InputPins::read;
    const _: fn(&board::InputPins) -> u32 = board::InputPins::fitted;
    const _: fn(&mut board::InputPins, u32, u32) = board::InputPins::set_pulls;
    const _: fn(&mut board::SlowPins, SlowLevels) = board::SlowPins::write;
    const _: [fn(&mut board::Watchdog); 2] = [board::Watchdog::start, board::Watchdog::feed];
}
