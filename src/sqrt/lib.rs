//! The square root of an `f32`: the instruction `vsqrt` on the boards' processors, `libm` elsewhere. `target_arch`,
//! `target_os` and `target_abi` select the implementation.
//!
//! IEEE 754 requires correct rounding, so the instruction and the library give the same bits for every number, and
//! results do not depend on the machine. This is a separate crate because the instruction needs `unsafe`, which the
//! controller forbids.
#![no_std]

/// Returns the square root; NaN for negative numbers.
#[inline(always)]
#[cfg(all(target_arch = "arm", target_os = "none", target_abi = "eabihf"))]
pub fn square_root(value: f32) -> f32 {
    sqrtf(value)
}

/// Returns the square root; NaN for negative numbers.
#[inline]
#[cfg(not(all(target_arch = "arm", target_os = "none", target_abi = "eabihf")))]
pub fn square_root(value: f32) -> f32 {
    libm::sqrtf(value)
}

/// The square root under the C library's name. LLVM takes a function of this name for the square root, and detects that
/// it has no other effect. So LLVM replaces each call by the instruction `vsqrt`. Then no registers are saved around a
/// call, and code that does not use the result can run before the result is ready.
///
/// Inline assembly for this processor cannot have floating-point operands. So the code names the register `s0` itself,
/// and restores its value.
#[cfg(all(target_arch = "arm", target_os = "none", target_abi = "eabihf"))]
#[inline(never)]
// SAFETY: unsafe because of the exported name; safe because the function does the same as the C library's `sqrtf`.
#[unsafe(no_mangle)]
extern "C" fn sqrtf(value: f32) -> f32 {
    let mut bits = value.to_bits();
    // SAFETY: unsafe because it is assembly; safe because s0 is restored and no memory is accessed.
    unsafe {
        core::arch::asm!(
            "vmov {kept}, s0",
            "vmov s0, {bits}",
            "vsqrt.f32 s0, s0",
            "vmov {bits}, s0",
            "vmov s0, {kept}",
            bits = inout(reg) bits,
            kept = out(reg) _,
            options(pure, nomem, nostack),
        );
    }
    f32::from_bits(bits)
}
