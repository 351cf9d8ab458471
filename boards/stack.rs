//! How deep the stack has been: `paint` fills it with `PAINT` at the start, but for a `MARGIN` below the stack pointer,
//! and what is not painted any more has been `used`, of a `size` from `_stack_end` to `_stack_start`.

/// No address, no small number, no float of any sense.
const PAINT: u32 = 0xA5C3_5A3C;
/// Bytes below the stack pointer that are left alone: the frame of the painter itself.
const MARGIN: usize = 256;

unsafe extern "C" {
    static mut _stack_end: u32;
    static _stack_start: u32;
}

/// Bytes of the whole stack.
pub fn size() -> u32 {
    &raw const _stack_start as u32 - &raw const _stack_end as u32
}

/// Paints what is free of the stack. Before the tasks run.
pub fn paint() {
    let mut at = &raw mut _stack_end;
    let until = cortex_m::register::msp::read() as usize - MARGIN;
    while (at as usize) < until {
        // SAFETY: unsafe because memory is written by its address; safe because it lies between the end of the stack and
        // the frame of this function, where nothing is alive.
        unsafe {
            at.write_volatile(PAINT);
            at = at.add(1);
        }
    }
}

/// The most that has been used since then, in bytes.
pub fn used() -> u32 {
    let mut at = &raw const _stack_end;
    let start = &raw const _stack_start;
    // SAFETY: unsafe because memory is read by its address; safe because it lies within the stack, which is always there.
    while at < start && unsafe { at.read_volatile() } == PAINT {
        at = at.wrapping_add(1);
    }
    start as u32 - at as u32
}
