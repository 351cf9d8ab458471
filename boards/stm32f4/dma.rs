//! DMA streams by their registers: what the chain of the steps and the UART share.
//!
//! Raw registers, because the HAL's transfers own their buffer up to the end: these go round, are looked at while they do, and begin
//! again with another length each time. Rules that the parts demand, held by the models of `tests/virtual_board`: CR of a stream is not
//! read right after EN was set, and streams are not switched on back to back.

use super::registers::{read, write};

/// Registers of a controller: the flags of streams 0 to 3 and 4 to 7, and where these are cleared; the first stream.
pub(super) const LISR: usize = 0x00;
pub(super) const HISR: usize = 0x04;
const LIFCR: usize = 0x08;
const HIFCR: usize = 0x0C;
const STREAMS: usize = 0x10;
const STREAM_SIZE: usize = 0x18;
/// Registers of a stream.
pub(super) const CR: usize = 0x00;
pub(super) const NDTR: usize = 0x04;
const PAR: usize = 0x08;
const M0AR: usize = 0x0C;
/// CR of a stream: on; memory is read; circular; either address counts up; words on both sides; very high priority.
pub(super) const EN: u32 = 1;
pub(super) const TO_PERIPHERAL: u32 = 1 << 6;
pub(super) const CIRCULAR: u32 = 1 << 8;
pub(super) const PERIPHERAL_COUNTS: u32 = 1 << 9;
pub(super) const MEMORY_COUNTS: u32 = 1 << 10;
pub(super) const WORDS: u32 = 2 << 11 | 2 << 13;
pub(super) const VERY_HIGH: u32 = 3 << 16;
/// Flags of a stream, six bits; transfer error and direct mode error among them.
const FLAGS: u32 = 0x3D;
const ERROR_FLAGS: u32 = 0b1100;

/// Where the flags of a stream stand.
const fn flags_at(stream: usize) -> u32 {
    [0, 6, 16, 22][stream % 4]
}

/// The error flags of some streams, which share a register.
pub(super) const fn errors(streams: &[usize]) -> u32 {
    let (mut flags, mut at) = (0, 0);
    while at < streams.len() {
        flags |= ERROR_FLAGS << flags_at(streams[at]);
        at += 1;
    }
    flags
}

/// More cycles than it takes from a request to the last word that comes of it.
pub(super) const SERVED_CYCLES: u32 = 80;
/// Between two streams that are switched on.
const APART_CYCLES: u32 = 12;

/// Address of a stream's registers.
#[inline(always)]
pub(super) const fn stream(dma: usize, number: usize) -> usize {
    dma + STREAMS + STREAM_SIZE * number
}

/// A transfer under way ends before a stream is off, which EN tells (reference manual, "Stream configuration procedure"). One that
/// never ends would be the last thing to wait for.
#[inline(always)]
pub(super) fn await_off(stream: usize) {
    let mut looks = SERVED_CYCLES;
    while read(stream + CR) & EN != 0 && looks > 0 {
        looks -= 1;
    }
}

/// Clears all flags of a stream. Those of an earlier use would keep it from starting.
#[inline(always)]
pub(super) fn clear_flags(dma: usize, number: usize) {
    let clear = if number < 4 { LIFCR } else { HIFCR };
    write(dma + clear, FLAGS << flags_at(number));
}

/// Programs a stream that is off for `count` transfers; `peripheral` and `memory` as the manual names the ports.
#[inline(always)]
pub(super) fn program(dma: usize, number: usize, peripheral: usize, memory: usize, count: usize) {
    let at = stream(dma, number);
    write(at + PAR, peripheral as u32);
    write(at + M0AR, memory as u32);
    write(at + NDTR, count as u32);
}

/// Programs a stream and switches it on, in direct mode as after a reset.
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
