//! The registers of QEMU's `mps2-an386` that the firmware uses: CMSDK UARTs, CMSDK timers, interrupt numbers.
//!
//! Written by hand from ARM's CMSDK technical reference manual (DDI 0479), as no crate describes this machine. Each
//! peripheral has one owner, and access to registers is volatile. The board decides which values to write.

#![no_std]

// Links cortex-m-rt into every program: its linker script places the vector table of this file.
extern crate cortex_m_rt as _;

pub use cortex_m::peripheral::Peripherals as CorePeripherals;

/// Number of priority bits of the interrupt controller: 8 levels.
pub const NVIC_PRIO_BITS: u8 = 3;

/// Interrupts of the FPGA image AN386.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u16)]
#[allow(non_camel_case_types, missing_docs, reason = "names of the application note")]
pub enum Interrupt {
    UART0_RX = 0,
    UART0_TX = 1,
    UART1_RX = 2,
    UART1_TX = 3,
    UART2_RX = 4,
    UART2_TX = 5,
    GPIO0 = 6,
    GPIO1 = 7,
    TIMER0 = 8,
    TIMER1 = 9,
    DUALTIMER = 10,
    SPI = 11,
    UART_OVF = 12,
    ETHERNET = 13,
    I2S = 14,
    TSC = 15,
    GPIO2 = 16,
    GPIO3 = 17,
    UART3_RX = 18,
    UART3_TX = 19,
    UART4_RX = 20,
    UART4_TX = 21,
}
/// The name that cortex-m-rt expects.
pub use Interrupt as interrupt;

// SAFETY: unsafe because a wrong number would reach a foreign vector; safe because the numbers are those of the table
// below and fixed by `repr(u16)`.
unsafe impl cortex_m::interrupt::InterruptNumber for Interrupt {
    fn number(self) -> u16 {
        self as u16
    }
}

mod vectors {
    unsafe extern "C" {
        fn UART0_RX();
        fn UART0_TX();
        fn UART1_RX();
        fn UART1_TX();
        fn UART2_RX();
        fn UART2_TX();
        fn GPIO0();
        fn GPIO1();
        fn TIMER0();
        fn TIMER1();
        fn DUALTIMER();
        fn SPI();
        fn UART_OVF();
        fn ETHERNET();
        fn I2S();
        fn TSC();
        fn GPIO2();
        fn GPIO3();
        fn UART3_RX();
        fn UART3_TX();
        fn UART4_RX();
        fn UART4_TX();
    }

    #[derive(Clone, Copy)]
    pub union Vector {
        handler: unsafe extern "C" fn(),
        reserved: u32,
    }

    // unsafe because the linker takes the section and the name on trust; safe because cortex-m-rt expects the table of
    // device vectors in this section under this name, and the order is that of `Interrupt`.
    #[unsafe(link_section = ".vector_table.interrupts")]
    #[unsafe(no_mangle)]
    pub static __INTERRUPTS: [Vector; 32] = [
        Vector { handler: UART0_RX },
        Vector { handler: UART0_TX },
        Vector { handler: UART1_RX },
        Vector { handler: UART1_TX },
        Vector { handler: UART2_RX },
        Vector { handler: UART2_TX },
        Vector { handler: GPIO0 },
        Vector { handler: GPIO1 },
        Vector { handler: TIMER0 },
        Vector { handler: TIMER1 },
        Vector { handler: DUALTIMER },
        Vector { handler: SPI },
        Vector { handler: UART_OVF },
        Vector { handler: ETHERNET },
        Vector { handler: I2S },
        Vector { handler: TSC },
        Vector { handler: GPIO2 },
        Vector { handler: GPIO3 },
        Vector { handler: UART3_RX },
        Vector { handler: UART3_TX },
        Vector { handler: UART4_RX },
        Vector { handler: UART4_TX },
        Vector { reserved: 0 },
        Vector { reserved: 0 },
        Vector { reserved: 0 },
        Vector { reserved: 0 },
        Vector { reserved: 0 },
        Vector { reserved: 0 },
        Vector { reserved: 0 },
        Vector { reserved: 0 },
        Vector { reserved: 0 },
        Vector { reserved: 0 },
    ];
}

struct Register(*mut u32);

impl Register {
    #[inline(always)]
    fn read(self) -> u32 {
        // SAFETY: unsafe because a raw address is read; safe because only this file makes registers, from the addresses
        // of the memory map, and reads of any of them have no effect on memory.
        unsafe { self.0.read_volatile() }
    }

    #[inline(always)]
    fn write(self, value: u32) {
        // SAFETY: unsafe because a raw address is written; safe because only this file makes registers, and none of
        // them makes the hardware touch memory.
        unsafe { self.0.write_volatile(value) }
    }
}

macro_rules! registers {
    ($($(#[$doc:meta])* $read:ident $write:ident $offset:literal;)*) => { $(
        $(#[$doc])*
        #[inline(always)]
        pub fn $read(&self) -> u32 {
            Register((BASE + $offset) as *mut u32).read()
        }

        $(#[$doc])*
        #[inline(always)]
        pub fn $write(&mut self, value: u32) {
            Register((BASE + $offset) as *mut u32).write(value)
        }
    )* };
}

/// CMSDK APB UART.
pub struct Uart<const BASE: usize>(());

impl<const BASE: usize> Uart<BASE> {
    /// STATE: a byte waits to be sent.
    pub const TX_FULL: u32 = 1;
    /// STATE: a received byte waits to be read.
    pub const RX_FULL: u32 = 2;
    /// INTSTATUS: the sender has become free.
    pub const TX_INTERRUPT: u32 = 1;
    /// INTSTATUS: a byte has arrived.
    pub const RX_INTERRUPT: u32 = 2;
    /// CTRL: sender on.
    pub const TX_ENABLE: u32 = 1;
    /// CTRL: receiver on.
    pub const RX_ENABLE: u32 = 2;
    /// CTRL: interrupt when the sender becomes free.
    pub const TX_INTERRUPT_ENABLE: u32 = 4;
    /// CTRL: interrupt when a byte has arrived.
    pub const RX_INTERRUPT_ENABLE: u32 = 8;

    registers! {
        /// Data: a read takes the received byte, a write sends a byte.
        data set_data 0x0;
        /// State of sender and receiver: `TX_FULL`, `RX_FULL`.
        state set_state 0x4;
        /// Control: the `ENABLE` bits above.
        control set_control 0x8;
        /// Interrupt status; writing 1 clears the bit.
        interrupts clear_interrupts 0xC;
        /// Baud rate divider, at least 16.
        divider set_divider 0x10;
    }
}

/// CMSDK APB timer: counts down to 0, then reloads.
pub struct Timer<const BASE: usize>(());

impl<const BASE: usize> Timer<BASE> {
    /// CTRL: the timer counts.
    pub const ENABLE: u32 = 1;
    /// CTRL: interrupt at 0.
    pub const INTERRUPT_ENABLE: u32 = 8;

    registers! {
        /// Control: the `ENABLE` bits above.
        control set_control 0x0;
        /// Number of ticks left until 0.
        value set_value 0x4;
        /// Value that the timer is set to after it has reached 0.
        reload set_reload 0x8;
        /// Interrupt status; writing 1 clears the interrupt.
        interrupts clear_interrupts 0xC;
    }
}

/// CMSDK APB watchdog: counts down; at 0 an interrupt (the NMI), at the next 0 a reset.
pub struct WatchdogTimer<const BASE: usize>(());

impl<const BASE: usize> WatchdogTimer<BASE> {
    /// CONTROL: counting, and an interrupt at 0.
    pub const INTERRUPT_ENABLE: u32 = 1;
    /// CONTROL: reset at the next 0, if the interrupt has not been cleared by then.
    pub const RESET_ENABLE: u32 = 2;

    registers! {
        /// Start value of the count-down, in ticks; writing it restarts the count.
        reload set_reload 0x0;
        /// Control: the `ENABLE` bits above.
        control set_control 0x8;
        /// A write clears the interrupt and restarts the count.
        cleared clear 0xC;
    }
}

/// The watchdog; it counts at 25 MHz.
pub type Watchdog = WatchdogTimer<0x4000_8000>;

/// First UART: the host.
pub type Uart0 = Uart<0x4000_4000>;
/// Second UART: the test stand.
pub type Uart1 = Uart<0x4000_5000>;
/// First timer: calls the step task.
pub type Timer0 = Timer<0x4000_0000>;
/// Second timer: the step clock.
pub type Timer1 = Timer<0x4000_1000>;

/// The peripherals, each with one owner.
#[allow(non_snake_case, missing_docs, reason = "names of the memory map, as RTIC users expect them")]
pub struct Peripherals {
    pub UART0: Uart0,
    pub UART1: Uart1,
    pub TIMER0: Timer0,
    pub TIMER1: Timer1,
    pub WATCHDOG: Watchdog,
}

impl Peripherals {
    /// Returns all peripherals, even if they already have owners.
    ///
    /// # Safety
    /// The caller must ensure that two owners of the same peripheral do not disturb each other.
    pub unsafe fn steal() -> Self {
        Self { UART0: Uart(()), UART1: Uart(()), TIMER0: Timer(()), TIMER1: Timer(()), WATCHDOG: WatchdogTimer(()) }
    }
}
