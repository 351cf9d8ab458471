//! Addresses of the registers that the step interrupt uses, and volatile access to them. The addresses are constants,
//! because that interrupt must have as few instructions as possible.
//!
//! The base addresses are a type parameter, [`Map`], so that the benchmark can run this code on plain memory. Source of
//! addresses and bits: reference manual RM0383; those of RM0390 (F446) are the same.

/// Base addresses of the peripherals.
///
/// # Safety
///
/// Each constant must be the address of the peripheral that it names, whose clock must be on, or of memory that
/// nothing else uses. This module writes to these addresses without further checks.
pub unsafe trait Map {
    /// Port A; the other ports follow.
    const GPIO: usize;
    /// The step clock.
    const TIM5: usize;
    /// PWM of the spindle or laser.
    const TIM3: usize;
    /// Timer of the step pulses; with [`Map::TIM8_MAKES_PULSES`], PWM of the spindle or laser.
    const TIM1: usize;
    /// Timer of the ports with directions alone, or of the step pulses; used only on chips that have it.
    const TIM8: usize;
    /// Whether TIM8 makes the step pulses in place of TIM1.
    const TIM8_MAKES_PULSES: bool;
    /// DMA controller that loads event times and the laser's power.
    const DMA1: usize;
    /// DMA controller that writes the edges.
    const DMA2: usize;
    /// Reset and clock control.
    const RCC: usize;
}

/// The addresses of the STM32F4.
#[cfg(feature = "stm32f4")]
pub struct Chip;

// SAFETY: unsafe because this module writes to these addresses; safe because they are the addresses of the named
// peripherals in the memory maps of the reference manuals.
#[cfg(feature = "stm32f4")]
unsafe impl Map for Chip {
    const GPIO: usize = 0x4002_0000;
    const TIM5: usize = 0x4000_0C00;
    const TIM3: usize = 0x4000_0400;
    const TIM1: usize = 0x4001_0000;
    const TIM8: usize = 0x4001_0400;
    const TIM8_MAKES_PULSES: bool = crate::TIM8_MAKES_PULSES;
    const DMA1: usize = 0x4002_6000;
    const DMA2: usize = 0x4002_6400;
    const RCC: usize = 0x4002_3800;
}

/// Offsets of two registers of a port, and the distance from the registers of one port to those of the next.
const IDR: usize = 0x10;
const BSRR: usize = 0x18;
const PORT_SIZE: usize = 0x400;

/// Offsets of a timer's registers.
pub mod timer {
    #![allow(missing_docs, reason = "the manual's names")]
    pub const CR1: usize = 0x00;
    pub const SMCR: usize = 0x08;
    pub const DIER: usize = 0x0C;
    pub const SR: usize = 0x10;
    pub const EGR: usize = 0x14;
    pub const CNT: usize = 0x24;
    pub const PSC: usize = 0x28;
    pub const ARR: usize = 0x2C;
    pub const CCR1: usize = 0x34;
    pub const CCR2: usize = 0x38;
    pub const CCR3: usize = 0x3C;
    pub const CCR4: usize = 0x40;
}

#[inline(always)]
pub(super) fn write(address: usize, value: u32) {
    // SAFETY: unsafe because a raw address is written; safe because only the files of this folder call this function,
    // with addresses of registers whose clocks are on since `setup`: those of ports, timers, DMA controllers, RCC and
    // the USART. Each register has one owner, with two exceptions. A write to BSRR changes only the pins it names, and
    // a write to EGR is a request that any code may make. Only DMA streams reach memory. `chain` makes them read its
    // rings of events and write registers, `usart_dma` makes them read its send buffer and write its receive buffer,
    // and `usart_interrupt` makes them write its receive buffer. The slots of the receive buffers are atomic.
    unsafe { (address as *mut u32).write_volatile(value) }
}

#[inline(always)]
pub(super) fn read(address: usize) -> u32 {
    // SAFETY: unsafe because a raw address is read; safe because only the files of this folder call this function,
    // with addresses of registers. Most of these registers may be read at any time without effect. Those of the USART
    // are read only by the tasks at the priority of the inputs.
    unsafe { (address as *const u32).read_volatile() }
}

/// Returns the address of BSRR of a port. One store to this register sets the pins of its low half and resets the pins
/// of its high half.
#[inline(always)]
pub(super) const fn bsrr_of<M: Map>(port: usize) -> usize {
    M::GPIO + PORT_SIZE * port + BSRR
}

/// Sets the pins of the low half of `value` and resets the pins of its high half, with one store.
#[inline(always)]
pub(super) fn write_bsrr<M: Map>(port: usize, value: u32) {
    write(bsrr_of::<M>(port), value);
}

/// Returns the levels of the pins of a port.
#[inline(always)]
pub(super) fn read_idr<M: Map>(port: usize) -> u32 {
    read(M::GPIO + PORT_SIZE * port + IDR)
}
