//! QEMU's `mps2-an386`: a Cortex-M4F with UARTs and timers, but without GPIO. Steps are not written to pins. They are
//! added to a digest (checksum), which a second UART reports. PSRAM can be preloaded with a job, or with a script that
//! acts as the host.
//!
//! ```text
//!   ┌───────────────────────────────────────────────────┐
//!   │ UART0 ── the host (a TCP port of QEMU)            │
//!   │ UART1 ── test stand: any byte in, one report out; │
//!   │          `s`: the stack; `R` resets the machine;  │
//!   │          `P` `F` `C` `H`: panic, fault, control   │
//!   │          hangs, everything hangs                  │
//!   │ TIMER0 ─ the next event, calls at a set time      │
//!   │ TIMER1 ─ step clock and time, 25 MHz              │
//!   │ SysTick  sampling of inputs (there are none)      │
//!   │ SSRAM    in place of flash, settings sectors too  │
//!   │ PSRAM 0x2100_0000, optional, one of:              │
//!   │                    "JOB!", length, text           │
//!   │                    "HOST", length, script         │
//!   │                    "BUSY": never asleep           │
//!   └───────────────────────────────────────────────────┘
//! ```
//! A job that QEMU's loader has put into PSRAM runs without the UART. Its bytes are available whenever the controller
//! reads one, so the step stream is the same in every run. At the end of the job, UART1 sends the report and QEMU
//! exits. A script in PSRAM replaces the host at UART0 (see `script`).
//!
//! With the option `-icount`, QEMU derives virtual time from the number of executed instructions. This does not hold
//! while the emulated processor sleeps: then virtual time follows the clock of the PC. With "BUSY" the processor never
//! sleeps, so virtual time depends on the instructions alone, even if the PC delays QEMU.
//!
//! Source of all addresses: <https://www.qemu.org/docs/master/system/arm/mps2.html>, ARM DAI 0386.

use core::cell::RefCell;
use core::fmt::Write;
use core::sync::atomic::{AtomicBool, Ordering};
use cortex_m::peripheral::NVIC;
use critical_section::Mutex;
use mps2_pac::{Interrupt, Timer0, Timer1, Uart0, Uart1};
use oxmill_controller::{Profile, ResetCause, digest::Digest};

pub use mps2_pac as pac;

use crate::uart_receiver::Look;
use crate::{Due, Free, Incoming, NoPort, Port, SecondMotor, SlowLevels, StepOutput, Undone, profiles, stack};

/// No USB link: the machine has no USB.
pub type UsbPort = NoPort;

mod flash;
mod script;
pub use flash::SettingsFlash;

/// The profile of this board. There is no pin table, so [`profile`] returns the same.
pub const PROFILE: Profile = crate::profile_of(&profiles::QEMU_MPS2, false);
/// Returns [`PROFILE`]: there is no pin table that could change a value.
pub fn profile() -> Profile {
    PROFILE
}

/// Number of GPIO ports. The machine itself has none. The number is only for `cargo xtask count`, which runs the step
/// output of the STM32 boards on plain memory, with all step and direction pins on one port.
pub const PORTS: usize = 3;
/// Number of axes.
pub const AXES: usize = profiles::QEMU_MPS2.axes;
/// Depth of the look-ahead, in blocks.
pub const BLOCKS: usize = profiles::QEMU_MPS2.blocks;
/// Capacity of the memory for subroutines, loops and macros, bytes.
pub const HELD_BYTES: usize = profiles::QEMU_MPS2.held_bytes;
/// Pages of 256 bytes for the recording of inputs and received bytes.
pub const RECORDING_PAGES: usize = profiles::QEMU_MPS2.recording_pages;
/// Maximum duration of a run of the step task, in CPU cycles, if the run generates events.
pub const RUN_CYCLES: u32 = profiles::QEMU_MPS2.run_cycles;
/// Ticks of [`clock_ticks`] in a microsecond. The clock is the step clock.
pub const CLOCK_TICKS_PER_US: u32 = 25;
/// Clock of SysTick, Hz.
pub const CORE_HZ: u32 = 25_000_000;
/// Samples per second. There are no inputs: the samples serve only the alarm clock of `control` and the watchdog. The
/// rate is low, because each sample takes time on the PC that runs QEMU.
pub const SAMPLE_HZ: u32 = 2_000;
/// False: on this board the non-maskable interrupt comes from the watchdog.
pub const WATCHES_CLOCK: bool = false;

/// The parts of the board that `setup` returns. The comment of a part names the task that gets it.
pub struct Parts {
    /// Given to the task `step`.
    pub step_pins: StepPins,
    /// Given to the task `inputs`.
    pub uart_input: UartInput,
    /// Given to the task `serial`.
    pub serial: SerialPort,
    /// Given to the task `serial`.
    pub usb: NoPort,
    /// Given to the task `inputs`.
    pub inputs: InputPins,
    /// Given to the task `control`.
    pub slow_pins: SlowPins,
    /// Given to the task `control`.
    pub settings_flash: SettingsFlash,
    /// Given to the task `inputs`.
    pub watchdog: Watchdog,
    /// Always 0: the emulator has no oscillator.
    pub oscillator_mhz: u8,
    /// Always `None`: nothing of this board can be missing.
    pub fault: Option<&'static str>,
}

/// The interrupt vectors of the tasks. They are literals, because the macro of RTIC runs before constants and `cfg` are
/// evaluated.
#[macro_export]
macro_rules! vectors {
    ($app:ident) => {
        $app!(serial: UART0_RX, step: TIMER0, dispatcher: SPI);
    };
}

/// Makes the interrupt of the serial task pending.
pub fn call_serial() {
    NVIC::pend(Interrupt::UART0_RX);
}

/// The UART's receiver for the task `inputs`. It does nothing, because the serial task reads the UART itself.
pub struct UartInput;

impl UartInput {
    /// Does nothing: QEMU delivers bytes at any rate.
    pub fn start(&mut self, _baud: u32) {}

    /// Does nothing: the serial task reads the UART itself.
    pub fn look(&mut self) -> Look {
        Look::default()
    }

    /// Does nothing: the serial task reads the UART itself.
    pub fn pass_on(&mut self, _calls: bool) {}
}

/// Default baud rate, without effect in QEMU.
pub const USUAL_BAUD: u32 = 115_200;

/// Starts timers and UARTs. `_low_voltage` is never called: there is no supply to monitor.
pub fn setup(mut device: pac::Peripherals, _low_voltage: fn() -> !) -> Parts {
    device.UART0.set_divider(16);
    device
        .UART0
        .set_control(Uart0::TX_ENABLE | Uart0::RX_ENABLE | Uart0::TX_INTERRUPT_ENABLE | Uart0::RX_INTERRUPT_ENABLE);
    device.UART1.set_divider(16);
    device.UART1.set_control(Uart1::TX_ENABLE | Uart1::RX_ENABLE);
    device.TIMER1.set_reload(u32::MAX);
    device.TIMER1.set_value(u32::MAX);
    device.TIMER1.set_control(Timer1::ENABLE);
    critical_section::with(|cs| {
        REPORTER.borrow(cs).replace(Some(device.UART1));
        SCRIPT.borrow(cs).replace(preloaded(SCRIPT_MARK).map(script::Script::new));
    });
    // SAFETY: unsafe because an unmasked vector may break a critical section; safe because its handler below only pends
    // another vector.
    unsafe { NVIC::unmask(Interrupt::UART0_TX) };
    Parts {
        step_pins: StepPins::new(device.TIMER0),
        uart_input: UartInput,
        serial: SerialPort(device.UART0),
        usb: NoPort,
        inputs: InputPins,
        slow_pins: SlowPins,
        settings_flash: SettingsFlash::new(),
        watchdog: Watchdog(device.WATCHDOG),
        oscillator_mhz: 0,
        fault: None,
    }
}

/// Interrupt handler: the UART can send another byte. Calls the serial task, which is bound to the vector of the UART's
/// receiver.
#[allow(non_snake_case, reason = "the name of the vector")]
#[unsafe(no_mangle)]
// unsafe because the linker takes the name on trust; safe because it is the vector's, and the signature fits.
extern "C" fn UART0_TX() {
    // SAFETY: unsafe because the serial task owns the UART; safe because clearing this flag is one store that the owner
    // never makes.
    let mut device = unsafe { pac::Peripherals::steal() };
    device.UART0.clear_interrupts(Uart0::TX_INTERRUPT);
    NVIC::pend(Interrupt::UART0_RX);
}

/// Returns the time of the step clock, in ticks of 40 ns; it wraps after 2^32.
#[inline(always)]
pub fn clock_ticks() -> u32 {
    // SAFETY: unsafe because the timer is read without owning it; safe because reading VALUE has no effect.
    u32::MAX - unsafe { pac::Peripherals::steal() }.TIMER1.value()
}

/// Makes the interrupt of the step task pending. Any task may call this function.
pub fn call_step() {
    NVIC::pend(Interrupt::TIMER0);
}

/// Steps so far, for the report to the test stand.
struct Record {
    digest: Digest,
    /// How long the machine has been in motion, in step-clock ticks: the sum of the times between the stepper's ticks.
    busy: u64,
    net: [i32; AXES],
}

static RECORD: Mutex<RefCell<Record>> =
    Mutex::new(RefCell::new(Record { digest: Digest::new(), busy: 0, net: [0; AXES] }));

/// A committed event that has not been output. `steps` and `directions` have one bit for each axis; a set bit of
/// `directions` means negative. `moment`: its time on the step clock. `passes`: by how much the stepper has advanced
/// since this event, in ticks of the step clock.
#[derive(Clone, Copy)]
struct Pending {
    steps: u8,
    directions: u8,
    moment: u32,
    passes: u32,
}

/// Step and direction outputs. Each event is added to the [`Digest`], a checksum of the steps, at its time. One timer
/// serves three scheduled times: it is always set to the nearest of them.
pub struct StepPins {
    timer: Timer0,
    /// Scheduled times: of the event, and of the calls `MORE` and `MARK`.
    moments: [Option<u32>; 3],
    pending: Option<Pending>,
    begun: bool,
    directions: u8,
    /// Buffers for the next event: its word and its time.
    word: [u32; 1],
    moment: [u32; 1],
}

/// The table for [`Free`]: the word of an event is simply the combination of its steps.
const STEPS: [u32; crate::COMBINATIONS] = [0, 1, 2, 3, 4, 5, 6, 7];

impl StepPins {
    const EVENT: usize = 0;
    const MORE: usize = 1;
    const MARK: usize = 2;

    fn new(timer: Timer0) -> StepPins {
        StepPins { timer, moments: [None; 3], pending: None, begun: false, directions: 0, word: [0], moment: [0] }
    }

    fn set(&mut self, which: usize, moment: Option<u32>) {
        self.moments[which] = moment;
        self.arm();
    }

    fn arm(&mut self) {
        self.timer.set_control(0);
        self.timer.clear_interrupts(1);
        let now = clock_ticks();
        let left = |moment: &Option<u32>| moment.map(|when| (when.wrapping_sub(now) as i32).max(0) as u32);
        let Some(nearest) = self.moments.iter().filter_map(left).min() else { return };
        if nearest == 0 {
            NVIC::pend(Interrupt::TIMER0);
            return;
        }
        // Because of rounding, the timer may expire too early. Then it continues with the reload value, 1 ms, and the
        // next expiry checks the scheduled time again.
        self.timer.set_reload(CORE_HZ / 1_000);
        self.timer.set_value(nearest);
        self.timer.set_control(Timer0::ENABLE | Timer0::INTERRUPT_ENABLE);
    }

    /// Outputs the pending event: adds it to `RECORD`, the steps to be reported to the test stand.
    fn put_out(&mut self) {
        let Some(Pending { steps, directions, passes, .. }) = self.pending.take() else { return };
        critical_section::with(|cs| {
            let record = &mut *RECORD.borrow_ref_mut(cs);
            if steps != 0 {
                record.digest.add(record.busy, steps, directions);
            }
            for (axis, net) in record.net.iter_mut().enumerate() {
                if steps >> axis & 1 != 0 {
                    *net += if directions >> axis & 1 != 0 { -1 } else { 1 };
                }
            }
            record.busy += u64::from(passes);
        });
    }
}

impl StepOutput<AXES> for StepPins {
    const DEPTH: usize = 1;
    const SOON: u32 = 0;

    fn now(&self) -> u32 {
        clock_ticks()
    }

    fn take(&mut self) -> Due {
        let now = self.now();
        let mut due = 0;
        for (moment, flag) in self.moments.iter_mut().zip([Due::OUT, Due::MORE, Due::MARK]) {
            if moment.is_some_and(|when| now.wrapping_sub(when) as i32 >= 0) {
                *moment = None;
                due |= flag.0;
            }
        }
        if Due(due).has(Due::OUT) {
            self.put_out();
        }
        self.arm();
        Due(due)
    }

    fn call_at(&mut self, moment: u32) {
        self.set(Self::MORE, Some(moment));
    }

    /// Schedules `MARK`; power is not recorded.
    fn mark_at(&mut self, moment: u32, _power: Option<u16>) {
        self.set(Self::MARK, Some(moment));
    }

    fn direct(&mut self, directions: u8) {
        self.directions = directions;
    }

    fn free(&mut self) -> Free<'_> {
        let room = usize::from(self.pending.is_none());
        Free {
            table: &STEPS,
            words: self.word.get_mut(..room).unwrap_or_default(),
            moments: self.moment.get_mut(..room).unwrap_or_default(),
        }
    }

    fn commit(&mut self, events: usize) -> u32 {
        if events > 0 {
            let [steps] = self.word.map(|word| word as u8);
            let [moment] = self.moment;
            self.pending = Some(Pending { steps, directions: self.directions, moment, passes: 0 });
            if self.begun {
                self.set(Self::EVENT, Some(moment));
            }
        }
        0
    }

    fn pass(&mut self, ticks: u32) {
        match &mut self.pending {
            Some(pending) => pending.passes += ticks,
            None => critical_section::with(|cs| RECORD.borrow_ref_mut(cs).busy += u64::from(ticks)),
        }
    }

    fn ahead(&self) -> usize {
        usize::from(self.pending.is_some())
    }

    fn moment_before(&self, _left: usize) -> u32 {
        self.pending.map_or(self.now(), |pending| pending.moment)
    }

    fn joins_until(&self, next: u32) -> u32 {
        next
    }

    fn begin(&mut self, _one_by_one: bool) -> u32 {
        self.begun = true;
        self.set(Self::EVENT, self.pending.map(|pending| pending.moment));
        0
    }

    fn fault(&self) -> bool {
        false
    }

    fn halt(&mut self, _dark: bool) -> Undone<AXES> {
        self.begun = false;
        self.set(Self::EVENT, None);
        let mut undone = Undone { events: 0, net: [0; AXES], fault: false };
        if let Some(Pending { steps, directions, .. }) = self.pending.take() {
            undone.events = 1;
            for (axis, net) in undone.net.iter_mut().enumerate() {
                *net = i32::from(steps >> axis & 1) * if directions >> axis & 1 != 0 { -1 } else { 1 };
            }
        }
        undone
    }

    /// Does nothing: there are no pins.
    fn set_polarity(&mut self, _step_invert: u8, _direction_invert: u8, _second: SecondMotor) {}

    /// Does nothing: there are no pins.
    fn set_pulse(&mut self, _tenths: u16) {}

    /// Does nothing: there is no PWM.
    fn set_pwm(&mut self, _hz: u32, _power: u16) {}

    /// Does nothing: power is not recorded.
    fn set_power(&mut self, _power: u16) {}

    /// Returns false: there is no probe.
    fn probe_low(&self) -> bool {
        false
    }
}

/// UART0, the link to the host.
pub struct SerialPort(Uart0);

impl Port for SerialPort {
    /// QEMU delivers a byte only after the previous one has been fetched.
    const WAITS: bool = true;

    /// Fetches the next byte from the script or the UART, if any.
    fn receive(&mut self) -> Incoming {
        self.0.clear_interrupts(Uart0::RX_INTERRUPT);
        if let Some(byte) = script::receive() {
            return Incoming::Byte(byte);
        }
        if self.0.state() & Uart0::RX_FULL != 0 { Incoming::Byte(self.0.data() as u8) } else { Incoming::Nothing }
    }

    /// Clears the interrupt of a received byte if the program has no space for the byte, because the interrupt would
    /// recur forever. The byte stays in the data register, where [`SerialPort::receive`] later finds it without an
    /// interrupt.
    fn allow(&mut self, room: usize) {
        if room == 0 {
            self.0.clear_interrupts(Uart0::RX_INTERRUPT);
        }
    }

    /// Sends a byte if the data register is free.
    fn send(&mut self, byte: u8) -> bool {
        let free = self.0.state() & Uart0::TX_FULL == 0;
        if free {
            self.0.set_data(u32::from(byte));
            script::hear(byte);
        }
        free
    }

    /// Does nothing: the interrupt occurs after every byte sent, wanted or not.
    fn call_when_free(&mut self, _wanted: bool) {}
}

/// Input pins: there are none, so no input is active.
pub struct InputPins;

impl InputPins {
    /// Returns 0: no pin is low, because there are no pins.
    pub fn read(&mut self) -> u32 {
        0
    }

    /// Returns 0: there are no pins.
    pub fn fitted(&self) -> u32 {
        0
    }

    /// Does nothing: there are no resistors.
    pub fn set_pulls(&mut self, _none: u32, _down: u32) {}
}

/// Slow outputs: there are none.
pub struct SlowPins;

impl SlowPins {
    /// Does nothing: there are no outputs.
    pub fn write(&mut self, _levels: SlowLevels) {}
}

/// Does nothing: there are no pins to make safe.
pub fn safe_state() {}

/// Address of preloaded data in PSRAM: a mark of 4 bytes, a length of 4 bytes, and the text of a job or script.
const JOB: usize = 0x2100_0000;
const JOB_MARK: u32 = u32::from_le_bytes(*b"JOB!");
const SCRIPT_MARK: u32 = u32::from_le_bytes(*b"HOST");
const BUSY_MARK: u32 = u32::from_le_bytes(*b"BUSY");
/// Maximum length of the text, bytes: the rest of PSRAM after mark and length.
const JOB_MAXIMUM: usize = 16 * 1024 * 1024 - 8;

/// Returns the job in PSRAM, if there is one.
pub fn preloaded_job() -> Option<&'static [u8]> {
    preloaded(JOB_MARK)
}

/// Returns the text in PSRAM. Returns `None` if PSRAM does not begin with `mark`, or if the length is impossible.
fn preloaded(mark: u32) -> Option<&'static [u8]> {
    if !is_marked(mark) {
        return None;
    }
    // SAFETY: as in `is_marked`.
    unsafe {
        let length = (JOB as *const u32).add(1).read_volatile() as usize;
        (length <= JOB_MAXIMUM).then(|| core::slice::from_raw_parts((JOB + 8) as *const u8, length))
    }
}

/// Returns whether PSRAM begins with this mark.
fn is_marked(mark: u32) -> bool {
    // SAFETY: unsafe because raw memory is read; safe because PSRAM exists on this machine, is outside every section of
    // the program, and nothing writes to it after the reset.
    unsafe { (JOB as *const u32).read_volatile() == mark }
}

static REPORTER: Mutex<RefCell<Option<Uart1>>> = Mutex::new(RefCell::new(None));

/// Sends text on UART1, waiting for each byte.
struct Reporter(Uart1);

impl Write for Reporter {
    fn write_str(&mut self, text: &str) -> core::fmt::Result {
        for byte in text.bytes() {
            while self.0.state() & Uart1::TX_FULL != 0 {}
            self.0.set_data(u32::from(byte));
        }
        Ok(())
    }
}

/// Sends the report of the steps so far to the test stand.
fn send_record() {
    let (digest, busy, net) = critical_section::with(|cs| {
        let record = RECORD.borrow_ref(cs);
        (record.digest, record.busy, record.net)
    });
    let [x, y, z] = net;
    let (time, order) = (digest.time_hash(), digest.order_hash());
    send(format_args!("time={time:016x} order={order:016x} steps={x},{y},{z} busy={busy}\n"));
}

/// Sends text to the test stand; sends nothing before the set-up.
fn send(text: core::fmt::Arguments<'_>) {
    let Some(uart) = critical_section::with(|cs| REPORTER.borrow_ref_mut(cs).take()) else { return };
    let mut reporter = Reporter(uart);
    // Writing to a UART cannot fail.
    let _ = reporter.write_fmt(text);
    critical_section::with(|cs| REPORTER.borrow(cs).replace(Some(reporter.0)));
}

/// Whether the preloaded job has ended.
static DONE: AtomicBool = AtomicBool::new(false);

/// Records that the preloaded job has ended. Then [`idle`] sends the report and exits QEMU.
pub fn job_done() {
    DONE.store(true, Ordering::Relaxed);
}

/// The script that acts as the host. After the set-up only [`idle`] uses it.
static SCRIPT: Mutex<RefCell<Option<script::Script>>> = Mutex::new(RefCell::new(None));

/// Advances the script, ends QEMU after a preloaded job, answers the test stand, and sleeps until the next interrupt.
/// Called again and again while no task runs.
pub fn idle() {
    follow_script();
    if DONE.load(Ordering::Relaxed) {
        send_record();
        semihosting::process::exit(0);
    }
    let asked = critical_section::with(|cs| {
        let reporter = REPORTER.borrow_ref(cs);
        reporter.as_ref().filter(|uart| uart.state() & Uart1::RX_FULL != 0).map(|uart| uart.data() as u8)
    });
    match asked {
        Some(b's') => send(format_args!("stack={} of {}\n", stack::used(), stack::size())),
        Some(b'R') => reset(),
        Some(way @ (b'P' | b'F' | b'C' | b'H')) => fail(way),
        Some(_) => send_record(),
        None => {}
    }
    if !is_marked(BUSY_MARK) {
        cortex_m::asm::wfi();
    }
}

/// Advances the script as far as possible and sends the reports that it requests to the test stand.
fn follow_script() {
    let Some(mut script) = critical_section::with(|cs| SCRIPT.borrow_ref_mut(cs).take()) else { return };
    loop {
        match script.go_on() {
            script::Wanted::Nothing => break,
            script::Wanted::Mark(bytes) => send(format_args!("{bytes}\n")),
            script::Wanted::Note(bytes, ms) => {
                let [x, y, z] = critical_section::with(|cs| RECORD.borrow_ref(cs).net);
                let (used, size) = (stack::used(), stack::size());
                send(format_args!("note bytes={bytes} at={ms} steps={x},{y},{z} stack={used} of {size}\n"));
            }
            script::Wanted::End => {
                send_record();
                semihosting::process::exit(0);
            }
        }
    }
    critical_section::with(|cs| SCRIPT.borrow(cs).replace(Some(script)));
}

/// The CMSDK watchdog: its first expiry raises the non-maskable interrupt, the second resets.
pub struct Watchdog(mps2_pac::Watchdog);

/// Ticks until the watchdog expires: 5 s. Generous, because virtual time may jump when the PC delays QEMU.
const WATCHDOG_TICKS: u32 = 5 * 25_000_000;

impl Watchdog {
    /// Starts the watchdog: from now on it must be fed at least every 5 s.
    pub fn start(&mut self) {
        self.0.set_reload(WATCHDOG_TICKS);
        self.0.set_control(mps2_pac::Watchdog::INTERRUPT_ENABLE | mps2_pac::Watchdog::RESET_ENABLE);
    }

    /// Restarts the timeout.
    pub fn feed(&mut self) {
        self.0.clear(1);
    }
}

/// Tells the program after a reset what caused the reset, because QEMU does not report the cause. The word keeps its
/// value in a reset: the start-up code does not initialize it. `ASKED`: the program requested the reset. `RUNNING`:
/// the program did not request it, so the watchdog caused the reset. Any other value: power-up.
#[unsafe(link_section = ".uninit.ALIVE")]
// unsafe because the linker takes the section on trust; safe because every bit pattern is a number.
static mut ALIVE: core::mem::MaybeUninit<u32> = core::mem::MaybeUninit::uninit();
const RUNNING: u32 = u32::from_le_bytes(*b"runs");
const ASKED: u32 = u32::from_le_bytes(*b"soft");

fn set_alive(word: u32) {
    // SAFETY: unsafe because a static is written; safe because it is one store, and `reset_cause` reads the word before
    // any task runs.
    unsafe { (&raw mut ALIVE).cast::<u32>().write_volatile(word) }
}

/// Returns the cause of the last reset, and marks the program as running.
pub fn reset_cause() -> ResetCause {
    // SAFETY: unsafe because memory is read that may never have been written; safe because it is read as a number.
    let word = unsafe { (&raw const ALIVE).cast::<u32>().read_volatile() };
    set_alive(RUNNING);
    match word {
        RUNNING => ResetCause::Watchdog,
        ASKED => ResetCause::Software,
        _ => ResetCause::Power,
    }
}

/// QEMU's board has no boot loader.
pub const HAS_LOADER: bool = false;

/// Restarts the program; `_into_loader` has no effect, because there is no boot loader.
pub fn reboot(_into_loader: bool) -> ! {
    cortex_m::interrupt::disable();
    reset()
}

/// Does nothing: there is no boot loader.
pub fn enter_loader_if_requested() {}

fn reset() -> ! {
    set_alive(ASKED);
    cortex_m::peripheral::SCB::sys_reset()
}

/// `true` if the test stand has requested a failure. Then [`restart`] resets the machine instead of ending QEMU.
static WANTED: AtomicBool = AtomicBool::new(false);

/// Ends the program after a failure: prints `why` and exits QEMU with status 101. Resets instead if the test stand
/// requested the failure.
pub fn restart(why: core::fmt::Arguments<'_>) -> ! {
    if WANTED.load(Ordering::Relaxed) {
        reset()
    }
    semihosting::eprintln!("{why}");
    semihosting::process::exit(101)
}

/// Makes the firmware fail in one of four ways: `P` panic, `F` fault, `C` the control task hangs, `H` everything hangs.
fn fail(way: u8) {
    WANTED.store(true, Ordering::Relaxed);
    match way {
        b'P' => panic!("wanted by the [test stand]"),
        b'F' => cortex_m::asm::udf(),
        b'C' => {
            // Masks the interrupts of the lowest priority, that of `control`; the other tasks continue.
            // SAFETY: unsafe because a write to BASEPRI can break critical sections; safe because the program ends
            // here.
            unsafe { cortex_m::register::basepri::write(hardware_priority(1)) };
            loop {
                cortex_m::asm::nop();
            }
        }
        _ => {
            cortex_m::interrupt::disable();
            loop {
                cortex_m::asm::nop();
            }
        }
    }
}

/// Converts a priority of RTIC (1 is the lowest) to a value of the interrupt controller (0 is the highest). Only the
/// upper bits of that value count.
const fn hardware_priority(logical: u8) -> u8 {
    ((1 << pac::NVIC_PRIO_BITS) - logical) << (8 - pac::NVIC_PRIO_BITS)
}
