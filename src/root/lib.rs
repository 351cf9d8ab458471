//! The square root of an `f32`: 7 instructions on the processors of the boards, some 70 elsewhere.
//!
//! IEEE 754 rounds it correctly, so the instruction and the library give the same bits for every number and results do
//! not depend on the machine. It is a crate of its own because the instruction needs `unsafe`, which the controller
//! forbids.
#![no_std]

/// The square root; not a number below 0.
#[inline(always)]
#[cfg(all(target_arch = "arm", target_os = "none", target_abi = "eabihf"))]
pub fn square_root(value: f32) -> f32 {
    // SAFETY: unsafe because a naked function is called; safe because it keeps to the calling convention: argument and
    // result are in s0, and nothing else changes.
    unsafe { vsqrt(value) }
}

/// The square root; not a number below 0.
#[inline]
#[cfg(not(all(target_arch = "arm", target_os = "none", target_abi = "eabihf")))]
pub fn square_root(value: f32) -> f32 {
    libm::sqrtf(value)
}

/// Inline assembly knows no floating-point registers of this processor, hence a function.
#[cfg(all(target_arch = "arm", target_os = "none", target_abi = "eabihf"))]
#[unsafe(naked)]
unsafe extern "C" fn vsqrt(value: f32) -> f32 {
    core::arch::naked_asm!(".fpu fpv4-sp-d16", "vsqrt.f32 s0, s0", "bx lr")
}
