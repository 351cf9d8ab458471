//! How the large parts of the controller hold their memory: by a reference on boards, in a box in programs on a PC.

/// A `T` that its user keeps for good: in `.bss` on boards, on the heap in programs on a PC (feature `alloc`).
#[cfg(feature = "alloc")]
pub type Lent<T> = alloc::boxed::Box<T>;
/// A `T` that its user keeps for good: in `.bss` on boards, on the heap in programs on a PC (feature `alloc`).
#[cfg(not(feature = "alloc"))]
pub type Lent<T> = &'static mut T;
