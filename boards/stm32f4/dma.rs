//! Access to DMA streams by their registers, shared by the step output (`chain`) and the UART.
//!
//! The registers are raw, because a transfer of the HAL owns its buffer until the transfer ends. The streams here are
//! circular, are read while they run, and restart with different lengths.
//!
//! Hardware constraints, checked by the models of `tests/virtual_board`: do not read the CR of a stream right after
//! setting EN, and do not switch on two streams back to back.

use super::registers::{read, write};

/// Offsets of a controller's registers: flags of streams 0 to 3 and 4 to 7, the registers that clear these flags, and
/// the registers of the first stream.
pub(super) const LISR: usize = 0x00;
pub(super) const HISR: usize = 0x04;
const LIFCR: usize = 0x08;
const HIFCR: usize = 0x0C;
const STREAMS: usize = 0x10;
const STREAM_SIZE: usize = 0x18;
/// Offsets of a stream's registers.
pub(super) const CR: usize = 0x00;
pub(super) const NDTR: usize = 0x04;
const PAR: usize = 0x08;
const M0AR: usize = 0x0C;
/// CR of a stream: enable; memory to peripheral; circular; increment the peripheral or the memory address; words of 32
/// bits in the peripheral and in memory; very high priority.
pub(super) const EN: u32 = 1;
pub(super) const TO_PERIPHERAL: u32 = 1 << 6;
pub(super) const CIRCULAR: u32 = 1 << 8;
pub(super) const PERIPHERAL_COUNTS: u32 = 1 << 9;
pub(super) const MEMORY_COUNTS: u32 = 1 << 10;
pub(super) const WORDS: u32 = 2 << 11 | 2 << 13;
pub(super) const VERY_HIGH: u32 = 3 << 16;
/// All flags of a stream, and two of them: transfer error and direct mode error.
const FLAGS: u32 = 0x3D;
const ERROR_FLAGS: u32 = 0b1100;

/// Returns the bit position of a stream's flags in its flag register.
const fn flags_at(stream: usize) -> u32 {
    [0, 6, 16, 22][stream % 4]
}

/// Returns the error flags of some streams that share a flag register.
pub(super) const fn errors(streams: &[usize]) -> u32 {
    let (mut flags, mut at) = (0, 0);
    while at < streams.len() {
        flags |= ERROR_FLAGS << flags_at(streams[at]);
        at += 1;
    }
    flags
}

/// Maximum time, in CPU cycles, from a DMA request to the last word that it transfers.
pub(super) const SERVED_CYCLES: u32 = 80;
/// Minimum number of CPU cycles between switching on two streams.
const APART_CYCLES: u32 = 12;

/// Returns the address of a stream's registers.
#[inline(always)]
pub(super) const fn stream(dma: usize, number: usize) -> usize {
    dma + STREAMS + STREAM_SIZE * number
}

/// Waits until a stream is off: EN stays set until the current transfer has ended (reference manual, "Stream
/// configuration procedure"). The wait is bounded, in case a transfer never ends.
#[inline(always)]
pub(super) fn await_off(stream: usize) {
    let mut looks = SERVED_CYCLES;
    while read(stream + CR) & EN != 0 && looks > 0 {
        looks -= 1;
    }
}

/// Clears all flags of a stream. Flags of an earlier use would prevent it from starting.
#[inline(always)]
pub(super) fn clear_flags(dma: usize, number: usize) {
    let clear = if number < 4 { LIFCR } else { HIFCR };
    write(dma + clear, FLAGS << flags_at(number));
}

/// Programs a disabled stream for `count` transfers. `peripheral` and `memory`: addresses at the two ports of the
/// stream, which have these names in the manual.
#[inline(always)]
pub(super) fn program(dma: usize, number: usize, peripheral: usize, memory: usize, count: usize) {
    let at = stream(dma, number);
    write(at + PAR, peripheral as u32);
    write(at + M0AR, memory as u32);
    write(at + NDTR, count as u32);
}

/// Programs a stream and switches it on. `how`: value of CR without EN. The stream runs in direct mode, the default
/// after a reset.
#[inline(never)]
pub(super) fn switch_on(dma: usize, number: usize, peripheral: usize, memory: usize, count: usize, how: u32) {
    let at = stream(dma, number);
    write(at + CR, 0);
    await_off(at);
    clear_flags(dma, number);
    program(dma, number, peripheral, memory, count);
    write(at + CR, how);
    write(at + CR, how | EN);
    cortex_m::asm::delay(APART_CYCLES);
}
