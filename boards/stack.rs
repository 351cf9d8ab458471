//! Measures how deep the stack has been. At the start, `paint` fills the free stack with the value `PAINT`, except for
//! `MARGIN` bytes below the stack pointer. Later, `used` searches for the deepest word that has been overwritten. The
//! stack grows down from `_stack_start` to `_stack_end`.

/// Fill value. It is unlikely on a used stack, as it is no address, no small number and no plausible float.
const PAINT: u32 = 0xA5C3_5A3C;
/// Bytes below the stack pointer that stay unpainted: the frame of `paint` itself.
const MARGIN: usize = 256;

unsafe extern "C" {
    static mut _stack_end: u32;
    static _stack_start: u32;
}

/// Returns the size of the stack in bytes.
pub fn size() -> u32 {
    &raw const _stack_start as u32 - &raw const _stack_end as u32
}

/// Fills the free part of the stack with `PAINT`. Call before the tasks run.
pub fn paint() {
    let mut at = &raw mut _stack_end;
    let until = cortex_m::register::msp::read() as usize - MARGIN;
    while (at as usize) < until {
        // SAFETY: unsafe because memory is written by its address; safe because it lies between the end of the stack
        // and the frame of this function, where no data is in use.
        unsafe {
            at.write_volatile(PAINT);
            at = at.add(1);
        }
    }
}

/// Returns the maximum stack use since [`paint`], in bytes.
pub fn used() -> u32 {
    let mut at = &raw const _stack_end;
    let start = &raw const _stack_start;
    // SAFETY: unsafe because memory is read by its address; safe because it lies within the stack, which is always
    // there.
    while at < start && unsafe { at.read_volatile() } == PAINT {
        at = at.wrapping_add(1);
    }
    start as u32 - at as u32
}
