//! QEMU's `mps2-an386`: a Cortex-M4F with UARTs and timers and without GPIO. The whole firmware runs here; what it would
//! write to step pins goes into a digest instead.
//!
//! ```text
//!   ┌───────────────────────────────────────────────────┐
//!   │ UART0 ── the host (a TCP port of QEMU)            │
//!   │ UART1 ── test stand: any byte in, one report out; │
//!   │          `s`: the stack; `R` resets the machine;  │
//!   │          `P` `F` `C` `H`: panic, fault, control   │
//!   │          hangs, everything hangs                  │
//!   │ TIMER0 ─ next tick, end of pulse, settling        │
//!   │ TIMER1 ─ step clock and time, 25 MHz              │
//!   │ SysTick  sampling of inputs (there are none)      │
//!   │ SSRAM    in place of flash, settings sectors too  │
//!   │ PSRAM 0x2100_0000  "JOB!", length, text: optional │
//!   │                    "HOST", length, script         │
//!   │                    "BUSY": never asleep           │
//!   └───────────────────────────────────────────────────┘
//! ```
//! A job that QEMU's loader has put into PSRAM runs without the UART: its bytes are always there when the controller
//! wants one, so the step stream is the same in every run. At its end the report goes to UART1 and QEMU ends. A script
//! there takes the place of a host at UART0 (see `script`).
//!
//! With counted instructions (`-icount`), virtual time follows the host's clock only while the processor sleeps: if it
//! never does, whatever holds QEMU up, no time goes by without the instructions that belong to it.
//!
//! Everything with an address here is QEMU's: <https://www.qemu.org/docs/master/system/arm/mps2.html>, ARM DAI 0386.

use core::cell::RefCell;
use core::fmt::Write;
use core::sync::atomic::{AtomicBool, Ordering};
use cortex_m::peripheral::NVIC;
use critical_section::Mutex;
use mps2_pac::{Interrupt, Timer0, Timer1, Uart0, Uart1};
use oxmill_controller::{Profile, ResetCause, digest::Digest};

pub use mps2_pac as pac;

use crate::{Incoming, NoPort, Port, SecondMotor, SlowLevels, profiles, stack};

/// There is none.
pub type UsbPort = NoPort;

mod flash;
mod script;
pub use flash::SettingsFlash;

/// The row of this board.
pub const PROFILE: Profile = crate::profile(&profiles::QEMU_MPS2, false);
/// Axes that are counted.
pub const AXES: usize = profiles::QEMU_MPS2.axes;
/// Depth of the look-ahead.
pub const BLOCKS: usize = profiles::QEMU_MPS2.blocks;
/// The clock is the step clock.
pub const CLOCK_TICKS_PER_US: u32 = 25;
/// Clock of SysTick.
pub const CORE_HZ: u32 = 25_000_000;
/// Samples of the inputs in a second: there are none, only the alarm clock of `control`, and each costs the host time.
pub const SAMPLE_HZ: u32 = 2_000;

/// What `setup` deals out.
pub struct Parts {
    /// For `step`.
    pub step_timer: StepTimer,
    /// For `step`.
    pub step_pins: StepPins,
    /// For `serial`.
    pub serial: SerialPort,
    /// For `serial`.
    pub usb: NoPort,
    /// For `inputs`.
    pub inputs: InputPins,
    /// For `control`.
    pub slow_pins: SlowPins,
    /// For `control`.
    pub settings_flash: SettingsFlash,
    /// For `inputs`.
    pub watchdog: Watchdog,
}

/// The vectors of the tasks, as literals: RTIC reads them before any constant or `cfg` is known.
#[macro_export]
macro_rules! vectors {
    ($app:ident) => {
        $app!(serial: UART0_RX, step: TIMER0, dispatcher: SPI);
    };
}

/// Calls the serial task.
pub fn call_serial() {
    NVIC::pend(Interrupt::UART0_RX);
}

/// Starts timers and UARTs. There is no supply to watch.
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
        step_timer: StepTimer { timer: device.TIMER0, moments: [None; 3], next_tick: 0, pulse_end: 0 },
        step_pins: StepPins,
        serial: SerialPort(device.UART0),
        usb: NoPort,
        inputs: InputPins,
        slow_pins: SlowPins,
        settings_flash: SettingsFlash::new(),
        watchdog: Watchdog(device.WATCHDOG),
    }
}

/// The sender has become free. It has a vector of its own; the serial task lives in the receiver's.
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

/// Ticks of the step clock, wrapping.
#[inline(always)]
pub fn clock_ticks() -> u32 {
    // SAFETY: unsafe because the timer is read without owning it; safe because reading VALUE has no effect.
    u32::MAX - unsafe { pac::Peripherals::steal() }.TIMER1.value()
}

/// What the step task has been called for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Due(u8);

impl Due {
    /// The next tick.
    pub const TICK: Due = Due(1);
    /// The end of a pulse.
    pub const PULSE_END: Due = Due(2);
    /// Some time after the end of a pulse.
    pub const SETTLED: Due = Due(4);
    /// Another task has called.
    pub const CALLED: Due = Due(8);

    /// Whether `what` is among it.
    pub fn has(self, what: Due) -> bool {
        self.0 & what.0 != 0
    }
}

/// A call of the step task that waits.
static CALLED: AtomicBool = AtomicBool::new(false);

/// Calls the step task, from any task.
pub fn call_step() {
    StepTimer::call();
}

/// The same: here an edge is a number in a digest, which no call delays.
pub fn ask_step() {
    StepTimer::call();
}

/// Three moments on one timer: it is set for the nearest.
pub struct StepTimer {
    timer: Timer0,
    /// Of tick, end of pulse, settling.
    moments: [Option<u32>; 3],
    /// Moment of the next tick, and that of the end of the last pulse, also once they have come.
    next_tick: u32,
    pulse_end: u32,
}

impl StepTimer {
    const TICK: usize = 0;
    const PULSE_END: usize = 1;
    const SETTLED: usize = 2;

    /// The step clock.
    pub fn now(&self) -> u32 {
        clock_ticks()
    }

    /// What is due, once each.
    pub fn take(&mut self) -> Due {
        let now = self.now();
        let mut due = if CALLED.swap(false, Ordering::Relaxed) { Due::CALLED.0 } else { 0 };
        for (moment, flag) in self.moments.iter_mut().zip([Due::TICK, Due::PULSE_END, Due::SETTLED]) {
            if moment.is_some_and(|when| now.wrapping_sub(when) as i32 >= 0) {
                *moment = None;
                due |= flag.0;
            }
        }
        // After a tick comes the next one, which sets the timer again.
        if due & Due::TICK.0 == 0 {
            self.arm();
        }
        Due(due)
    }

    /// Whether something is due that has not been taken.
    pub fn is_due(&self, what: Due) -> bool {
        let now = self.now();
        let mut all = self.moments.iter().zip([Due::TICK, Due::PULSE_END, Due::SETTLED]);
        all.any(|(moment, flag)| flag == what && moment.is_some_and(|when| now.wrapping_sub(when) as i32 >= 0))
    }

    /// Calls the step task for a tick at a moment that lies ahead, after a tick has been taken.
    pub fn next_tick_at(&mut self, when: u32) {
        self.tick_at(when);
    }

    /// The moment of the next tick.
    pub fn next_tick(&self) -> u32 {
        self.next_tick
    }

    /// Calls the step task for a tick at a moment, instead of another one that may already have come.
    pub fn tick_at(&mut self, when: u32) {
        self.next_tick = when;
        self.set(Self::TICK, Some(when));
    }

    /// No more ticks.
    pub fn tick_off(&mut self) {
        self.set(Self::TICK, None);
    }

    /// Calls the step task at the end of a pulse.
    pub fn pulse_end_at(&mut self, when: u32) {
        self.pulse_end = when;
        self.set(Self::PULSE_END, Some(when));
    }

    /// The moment at which the last pulse ends or has ended.
    pub fn pulse_end(&self) -> u32 {
        self.pulse_end
    }

    /// Calls the step task at a moment, independent of ticks.
    pub fn settled_at(&mut self, when: u32) {
        self.set(Self::SETTLED, Some(when));
    }

    /// Whether that moment is this one, and still to come.
    pub fn settles_at(&self, when: u32, _now: u32) -> bool {
        self.moments[Self::SETTLED] == Some(when)
    }

    /// Calls the step task, from any task.
    pub fn call() {
        CALLED.store(true, Ordering::Relaxed);
        NVIC::pend(Interrupt::TIMER0);
    }

    fn set(&mut self, which: usize, moment: Option<u32>) {
        self.moments[which] = moment;
        self.arm();
    }

    fn arm(&mut self) {
        self.timer.set_control(0);
        self.timer.clear_interrupts(1);
        let now = self.now();
        let left = |moment: &Option<u32>| moment.map(|when| (when.wrapping_sub(now) as i32).max(0) as u32);
        let Some(nearest) = self.moments.iter().filter_map(left).min() else { return };
        if nearest == 0 {
            NVIC::pend(Interrupt::TIMER0);
            return;
        }
        // A reload value keeps the timer going, so that a moment missed by rounding is looked at again soon.
        self.timer.set_reload(CORE_HZ / 1_000);
        self.timer.set_value(nearest);
        self.timer.set_control(Timer0::ENABLE | Timer0::INTERRUPT_ENABLE);
    }
}

/// What the step task has done, for the test stand.
struct Record {
    digest: Digest,
    /// Step-clock ticks for which the step task has been busy.
    busy: u64,
    directions: u8,
    net: [i32; AXES],
}

static RECORD: Mutex<RefCell<Record>> =
    Mutex::new(RefCell::new(Record { digest: Digest::new(), busy: 0, directions: 0, net: [0; AXES] }));

/// Step and direction outputs that end in the [`Digest`].
pub struct StepPins;

impl StepPins {
    /// Polarity is a matter of pins.
    pub fn set_polarity(&mut self, _step_invert: u8, _direction_invert: u8, _second: SecondMotor) {}

    /// A step of the axes of `steps`.
    pub fn raise(&mut self, steps: u8) {
        critical_section::with(|cs| {
            let record = &mut *RECORD.borrow_ref_mut(cs);
            record.digest.add(record.busy, steps, record.directions);
            for (axis, net) in record.net.iter_mut().enumerate() {
                if steps >> axis & 1 != 0 {
                    *net += if record.directions >> axis & 1 != 0 { -1 } else { 1 };
                }
            }
        });
    }

    /// End of the pulses.
    pub fn lower(&mut self) {}

    /// Directions from here on.
    pub fn direct(&mut self, directions: u8) {
        critical_section::with(|cs| RECORD.borrow_ref_mut(cs).directions = directions);
    }

    /// There is no PWM.
    pub fn set_pwm(&mut self, _hz: u32, _power: u16) {}

    /// Power of spindle or laser: not recorded.
    pub fn set_power(&mut self, _power: u16) {}

    /// There is no probe.
    pub fn probe_low(&self) -> bool {
        false
    }

    /// The step task is busy for this long until the next tick.
    pub fn pass(&mut self, ticks: u32) {
        critical_section::with(|cs| RECORD.borrow_ref_mut(cs).busy += u64::from(ticks));
    }
}

/// UART0.
pub struct SerialPort(Uart0);

impl Port for SerialPort {
    /// QEMU offers no byte before the last one has been fetched.
    const WAITS: bool = true;

    /// The next byte, if one has come.
    fn receive(&mut self) -> Incoming {
        self.0.clear_interrupts(Uart0::RX_INTERRUPT);
        if let Some(byte) = script::receive() {
            return Incoming::Byte(byte);
        }
        if self.0.state() & Uart0::RX_FULL != 0 { Incoming::Byte(self.0.data() as u8) } else { Incoming::Nothing }
    }

    /// A byte may wait unfetched: without this its interrupt would come again for ever. [`SerialPort::receive`] looks at
    /// the register itself and finds it later.
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

    /// The interrupt comes after every byte sent, wanted or not.
    fn call_when_free(&mut self, _wanted: bool) {}
}

/// No pins: nothing is active.
pub struct InputPins;

impl InputPins {
    /// Which pins are low: none.
    pub fn read(&self) -> u16 {
        0
    }

    /// Which pins there are: none.
    pub fn fitted(&self) -> u16 {
        0
    }

    /// There are no resistors.
    pub fn set_pulls(&mut self, _none: u16, _down: u16) {}
}

/// No pins.
pub struct SlowPins;

impl SlowPins {
    /// There is nothing to write to.
    pub fn write(&mut self, _levels: SlowLevels) {}
}

/// There are no pins to make safe.
pub fn safe_state() {}

/// Where a preloaded job lies: a mark, a length, and the text.
const JOB: usize = 0x2100_0000;
const JOB_MARK: u32 = u32::from_le_bytes(*b"JOB!");
const SCRIPT_MARK: u32 = u32::from_le_bytes(*b"HOST");
const BUSY_MARK: u32 = u32::from_le_bytes(*b"BUSY");
/// What PSRAM can hold behind the two words.
const JOB_MAXIMUM: usize = 16 * 1024 * 1024 - 8;

/// The job in PSRAM, if there is one.
pub fn preloaded_job() -> Option<&'static [u8]> {
    preloaded(JOB_MARK)
}

/// What lies in PSRAM with this mark.
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

/// Whether PSRAM begins with this mark.
fn is_marked(mark: u32) -> bool {
    // SAFETY: unsafe because raw memory is read; safe because PSRAM exists on this machine, is outside every section of
    // the program, and nothing writes to it after the reset.
    unsafe { (JOB as *const u32).read_volatile() == mark }
}

static REPORTER: Mutex<RefCell<Option<Uart1>>> = Mutex::new(RefCell::new(None));

/// Sends text, waiting for each byte.
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

/// Tells the test stand what the step task has done so far.
fn send_record() {
    let (digest, busy, net) = critical_section::with(|cs| {
        let record = RECORD.borrow_ref(cs);
        (record.digest, record.busy, record.net)
    });
    let [x, y, z] = net;
    let (time, order) = (digest.time_hash(), digest.order_hash());
    send(format_args!("time={time:016x} order={order:016x} steps={x},{y},{z} busy={busy}\n"));
}

/// Sends text to the test stand.
fn send(text: core::fmt::Arguments<'_>) {
    let Some(uart) = critical_section::with(|cs| REPORTER.borrow_ref_mut(cs).take()) else { return };
    let mut reporter = Reporter(uart);
    // Writing to a UART cannot fail.
    let _ = reporter.write_fmt(text);
    critical_section::with(|cs| REPORTER.borrow(cs).replace(Some(reporter.0)));
}

static DONE: AtomicBool = AtomicBool::new(false);

/// The preloaded job has come to its end: `idle` sends the report and ends QEMU.
pub fn job_done() {
    DONE.store(true, Ordering::Relaxed);
}

/// The host inside the machine, for [`idle`] alone.
static SCRIPT: Mutex<RefCell<Option<script::Script>>> = Mutex::new(RefCell::new(None));

/// What to do while nothing else is to be done.
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

/// Lets the host inside the machine do what it can.
fn follow_script() {
    let Some(mut script) = critical_section::with(|cs| SCRIPT.borrow_ref_mut(cs).take()) else { return };
    loop {
        match script.go_on() {
            script::Wanted::Nothing => break,
            script::Wanted::Mark(bytes) => send(format_args!("{bytes}\n")),
            script::Wanted::End => {
                send_record();
                semihosting::process::exit(0);
            }
        }
    }
    critical_section::with(|cs| SCRIPT.borrow(cs).replace(Some(script)));
}

/// The watchdog of the CMSDK: its first expiry is an interrupt that cannot be masked, the second resets.
pub struct Watchdog(mps2_pac::Watchdog);

/// Ticks until it expires: 5 s. Virtual time may leap when the host holds QEMU up, so this is generous.
const WATCHDOG_TICKS: u32 = 5 * 25_000_000;

impl Watchdog {
    /// From here on it wants to be fed.
    pub fn start(&mut self) {
        self.0.set_reload(WATCHDOG_TICKS);
        self.0.set_control(mps2_pac::Watchdog::INTERRUPT_ENABLE | mps2_pac::Watchdog::RESET_ENABLE);
    }

    /// Feeds it.
    pub fn feed(&mut self) {
        self.0.clear(1);
    }
}

/// What QEMU does not say: a reset that no task asked for is the watchdog's. Start-up code leaves this word alone.
#[unsafe(link_section = ".uninit.ALIVE")]
// unsafe because the linker takes the section on trust; safe because every bit pattern is a number.
static mut ALIVE: core::mem::MaybeUninit<u32> = core::mem::MaybeUninit::uninit();
const RUNNING: u32 = u32::from_le_bytes(*b"runs");
const ASKED: u32 = u32::from_le_bytes(*b"soft");

fn set_alive(word: u32) {
    // SAFETY: unsafe because a static is written; safe because it is one store, and only a reset reads it.
    unsafe { (&raw mut ALIVE).cast::<u32>().write_volatile(word) }
}

/// Why the processor was reset.
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

fn reset() -> ! {
    set_alive(ASKED);
    cortex_m::peripheral::SCB::sys_reset()
}

/// The test stand has asked for a failure.
static WANTED: AtomicBool = AtomicBool::new(false);

/// The firmware has failed: says why and ends QEMU with a status of its own, unless the test stand wanted it so.
pub fn restart(why: core::fmt::Arguments<'_>) -> ! {
    if WANTED.load(Ordering::Relaxed) {
        reset()
    }
    semihosting::eprintln!("{why}");
    semihosting::process::exit(101)
}

/// Fails in one of the ways that firmware can fail in.
fn fail(way: u8) {
    WANTED.store(true, Ordering::Relaxed);
    match way {
        b'P' => panic!("wanted by the [test stand]"),
        b'F' => cortex_m::asm::udf(),
        b'C' => {
            // Nothing of the lowest priority runs any more; the others do.
            // SAFETY: unsafe because it may break critical sections; safe because the program is to end.
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

/// A priority of RTIC as the interrupt controller has it.
const fn hardware_priority(logical: u8) -> u8 {
    ((1 << pac::NVIC_PRIO_BITS) - logical) << (8 - pac::NVIC_PRIO_BITS)
}
