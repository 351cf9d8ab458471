//! The boards: pins, clocks and registers behind one interface (`contract`). A cargo feature selects the board of an
//! image; the items of that board are re-exported here.
//!
//! Without a board feature (on a PC), the crate has only the modules that access no registers. One of them has the
//! numeric profiles of all boards ([`profiles`]), for the simulator.
#![no_std]

use crc::{CRC_32_ISO_HDLC, Crc, NoTable};

pub mod calls;
pub mod pin_table;
pub mod profiles;
// Host tests use this module, so it is compiled even without a board.
pub mod uart_receiver;
#[cfg(any(not(feature = "board"), feature = "usb"))]
pub mod usb_host;

#[cfg(feature = "board")]
pub mod contract;
#[cfg(feature = "board")]
pub mod stack;
#[cfg(feature = "board")]
pub mod stm32f4;

/// Returns the CRC-32 (ISO-HDLC) of some bytes. Computes it bit by bit, because a table would take 1 KiB.
#[inline(never)]
pub fn checksum(bytes: &[u8]) -> u32 {
    const SUM: Crc<u32, NoTable> = Crc::<u32, NoTable>::new(&CRC_32_ISO_HDLC);
    let mut digest = SUM.digest();
    // Update the digest byte by byte. The compiler would unroll an update with the whole slice to 700 bytes of code.
    for byte in bytes {
        digest.update(core::slice::from_ref(byte));
    }
    digest.finalize()
}

#[cfg(feature = "qemu_mps2")]
mod qemu_mps2;
#[cfg(feature = "qemu_mps2")]
pub use qemu_mps2::*;

/// Profile of the image that the cargo feature selects, for boards with hardware.
#[cfg(feature = "blackpill_f401")]
const IMAGE: profiles::Board = profiles::BLACKPILL_F401;
#[cfg(feature = "blackpill_f411")]
const IMAGE: profiles::Board = profiles::BLACKPILL_F411;
#[cfg(feature = "nucleo_f401re")]
const IMAGE: profiles::Board = profiles::NUCLEO_F401RE;
#[cfg(feature = "nucleo_f411re")]
const IMAGE: profiles::Board = profiles::NUCLEO_F411RE;
#[cfg(feature = "nucleo_f446re")]
const IMAGE: profiles::Board = profiles::NUCLEO_F446RE;
#[cfg(feature = "control_f407")]
const IMAGE: profiles::Board = profiles::CONTROL_F407;
#[cfg(feature = "control_f446")]
const IMAGE: profiles::Board = profiles::CONTROL_F446;
#[cfg(feature = "control_f412")]
const IMAGE: profiles::Board = profiles::CONTROL_F412;

#[cfg(feature = "stm32f4")]
mod chosen {
    use super::*;
    pub use crate::stm32f4::setup::{Parts, SerialPort, StepPins, UartInput, UsbPort, call_serial, setup};
    pub use crate::stm32f4::{
        CLOCK_TICKS_PER_US, HAS_LOADER, InputPins, SAMPLE_HZ, SettingsFlash, SlowPins, USUAL_BAUD, WATCHES_CLOCK,
        Watchdog, call_step, clock_ticks, enter_loader_if_requested, idle, job_done, preloaded_job, reboot,
        reset_cause, restart, safe_state,
    };
    pub use stm32f4xx_hal::pac;

    /// The profile of the image, with all values that its boards share. [`profile`] adds the name of the board and the
    /// values that depend on its pin table.
    pub const PROFILE: Profile = crate::profile_of(&IMAGE, true);
    /// Maximum number of axes. A board whose pin table has fewer motors has fewer axes ([`profile`]).
    pub const AXES: usize = IMAGE.axes;
    /// Depth of the look-ahead, in blocks.
    pub const BLOCKS: usize = IMAGE.blocks;
    /// Capacity of the memory for subroutines, loops and macros, bytes.
    pub const HELD_BYTES: usize = IMAGE.held_bytes;
    /// Pages of 256 bytes for the recording of inputs and received bytes.
    pub const RECORDING_PAGES: usize = IMAGE.recording_pages;
    /// Maximum duration of a run of the step task, in CPU cycles, if the run generates events.
    pub const RUN_CYCLES: u32 = IMAGE.run_cycles;
    /// Clock of the processor and of SysTick.
    pub const CORE_HZ: u32 = IMAGE.core_hz;
    /// Maximum number of ports that have step pins.
    pub const STEP_PORTS: usize = IMAGE.step_ports;
    /// Maximum number of ports that have step or direction pins.
    pub const MOTOR_PORTS: usize = IMAGE.step_ports + IMAGE.direction_ports;
    /// Whether TIM8 makes the step pulses in place of TIM1.
    pub const TIM8_MAKES_PULSES: bool = IMAGE.tim8_makes_pulses;
    /// Number of ports that have pins in use, from A on.
    pub const PORTS: usize = IMAGE.ports;

    /// A table without pins, used if the table in flash is unusable.
    const NONE: PinTable = PinTable::none(IMAGE.image);

    unsafe extern "C" {
        /// The pin table in flash. The linker script defines this symbol; the firmware provides the contents.
        static _pin_table: PinTable;
    }

    /// Returns the pin table of this image. If the table in flash is damaged, is for another image, or uses ports that
    /// this image does not support, returns a table without pins.
    pub fn pin_table() -> &'static PinTable {
        // SAFETY: unsafe because the linker takes the name on trust; safe because the linker script reserves as many
        // bytes of flash as a table has, any bytes are a table, and nothing writes there.
        let table = unsafe { &_pin_table };
        if table.is_intact() && table.image() == IMAGE.image && fits(table) { table } else { &NONE }
    }

    /// Returns true if this image supports the ports of the table. Three things are limited: the last port with a pin
    /// in use, the number of ports with step pins, and the number of ports with step or direction pins. Tools that
    /// make tables check the same limits.
    fn fits(table: &PinTable) -> bool {
        use Role::{DirectionFourth, DirectionX, DirectionY, DirectionZ, StepFourth, StepX, StepY, StepZ};
        let ports = |roles: &[Role]| {
            roles.iter().filter_map(|role| table.pin(*role)).fold(0_u32, |ports, pin| ports | 1 << pin.port)
        };
        let steps = ports(&[StepX, StepY, StepZ, StepFourth]);
        let motors = steps | ports(&[DirectionX, DirectionY, DirectionZ, DirectionFourth]);
        ports(&Role::ALL) >> PORTS == 0
            && steps.count_ones() as usize <= STEP_PORTS
            && motors.count_ones() as usize <= MOTOR_PORTS
    }

    /// Returns the profile of the board: the values of the image, with the name and the pins of the pin table.
    #[inline(never)]
    pub fn profile() -> Profile {
        let table = pin_table();
        let has = |role| table.pin(role).is_some();
        let count = |first, second| u8::from(has(first)) + u8::from(has(second));
        let motors = if has(Role::StepFourth) { 4 } else { 3 };
        Profile {
            name: if table.is_intact() { table.name() } else { "no pin table" },
            axes: AXES.min(motors),
            has_second_motor: motors > 3,
            has_at_speed: has(Role::AtSpeed),
            program_pins: [
                count(Role::ProgramOutput, Role::SecondProgramOutput),
                count(Role::ProgramInput, Role::SecondProgramInput),
            ],
            has_loader: HAS_LOADER && !starts_in_loader(table),
            ..PROFILE
        }
    }

    /// Returns whether the boot loader could switch on a device of this board, such as the spindle or the coolant. The
    /// boot loader enables pull-ups at the pins of its UARTs and of CAN, and may drive its outputs of SPI (AN2606).
    fn starts_in_loader(table: &PinTable) -> bool {
        /// `true` if the boot loader enables pull-ups at pins that a board may use. The boot loaders of the F401 and
        /// F411 do not: they have no CAN, and their pulled-up UART pins are not on a Black Pill.
        const HAS_PULL_UPS: bool = cfg!(any(feature = "stm32f407", feature = "stm32f412", feature = "stm32f446"));
        /// Pins that the boot loader pulls up, as port (0 for A) and bit mask: B5, B10, B11, B13, C10 and C11; on an
        /// F412 also D5 and D6.
        const PULLED_UP: [(u8, u16); 3] =
            [(1, 0x2C20), (2, 0x0C00), (3, if cfg!(feature = "stm32f412") { 0x0060 } else { 0 })];
        /// Pins that the boot loader may drive as SPI outputs, as port (0 for A) and bit mask: A6, B14, C11 and E13.
        /// It drives such a pin if the pin that selects its SPI is low.
        const DRIVEN: [(u8, u16); 4] = [(0, 0x0040), (1, 0x4000), (2, 0x0800), (4, 0x2000)];
        use Role::{
            Flood, Mist, MotorPower, ProgramOutput, SecondProgramOutput, SpindleDirection, SpindleOn, SpindlePwm,
        };
        let loads =
            [SpindleOn, SpindleDirection, SpindlePwm, Flood, Mist, ProgramOutput, SecondProgramOutput, MotorPower];
        let is_in = |pins: &[(u8, u16)], pin: Pin| {
            pins.iter().any(|(port, pins)| pin.port == *port && pins >> pin.number & 1 != 0)
        };
        let may_be_high = |pin| is_in(&DRIVEN, pin) || HAS_PULL_UPS && is_in(&PULLED_UP, pin);
        loads.into_iter().filter_map(|role| table.pin(role)).any(may_be_high)
    }
}
#[cfg(feature = "stm32f4")]
pub use chosen::*;
#[cfg(feature = "stm32f4")]
use {
    oxmill_controller::Profile,
    pin_table::{Pin, PinTable, Role},
};

#[cfg(feature = "board")]
pub use contract::{
    COMBINATIONS, Due, Free, Incoming, NoPort, Port, SecondMotor, SlowLevels, StepOutput, Undone, input_bits,
};

#[cfg(all(target_os = "none", not(feature = "board")))]
compile_error!("choose a board: `cargo fw BOARD`, or one of the features of this package");

/// Converts a board's table of numbers to the profile that the controller uses.
#[cfg(feature = "board")]
const fn profile_of(board: &profiles::Board, has_second_motor: bool) -> oxmill_controller::Profile {
    oxmill_controller::Profile {
        name: board.name,
        step_clock_hz: board.step_clock_hz,
        rates: oxmill_controller::StepRates {
            safe_hz: board.safe_step_hz,
            least_pulse_tenths: board.least_pulse_tenths,
        },
        axes: board.axes,
        has_second_motor,
        has_at_speed: board.has_at_speed,
        program_pins: board.program_pins,
        most_baud: board.most_baud,
        oscillator_mhz: 0,
        has_store: true,
        has_loader: false,
    }
}
