//! The square root of an `f32`: one instruction (`vsqrt`) on the processors of the boards, `libm`'s elsewhere. The
//! choice is by `target_arch = "arm"`, `target_abi = "eabihf"` and `target_os`.
//!
//! IEEE 754 rounds it correctly, so the instruction and the library give the same bits for every number and results do
//! not depend on the machine. It is a crate of its own because the instruction needs `unsafe`, which the controller
//! forbids.
#![no_std]

/// The square root; not a number below 0.
#[inline(always)]
#[cfg(all(target_arch = "arm", target_os = "none", target_abi = "eabihf"))]
pub fn square_root(value: f32) -> f32 {
    sqrtf(value)
}

/// The square root; not a number below 0.
#[inline]
#[cfg(not(all(target_arch = "arm", target_os = "none", target_abi = "eabihf")))]
pub fn square_root(value: f32) -> f32 {
    libm::sqrtf(value)
}

/// The C library's name for it: LLVM knows what a function of this name gives and, as this one is seen to do nothing else,
/// makes the instruction of each call. So nothing is saved around a call, and what follows need not wait for it.
///
/// Inline assembly knows no floating-point registers of this processor, so one is borrowed.
#[cfg(all(target_arch = "arm", target_os = "none", target_abi = "eabihf"))]
#[inline(never)]
// SAFETY: unsafe because of the name; safe because it does what the C library's function of that name does.
#[unsafe(no_mangle)]
extern "C" fn sqrtf(value: f32) -> f32 {
    let mut bits = value.to_bits();
    // SAFETY: unsafe because it is assembly; safe because s0 is put back, and no memory is used.
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
