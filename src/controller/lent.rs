//! Memory that a part uses and does not own: a reference on boards, a box on hosts.

/// Memory that is lent permanently. On boards it lies in `.bss`; hosts (feature `alloc`) take it from the heap.
#[cfg(feature = "alloc")]
pub type Lent<T> = alloc::boxed::Box<T>;
/// Memory that is lent permanently. On boards it lies in `.bss`; hosts (feature `alloc`) take it from the heap.
#[cfg(not(feature = "alloc"))]
pub type Lent<T> = &'static mut T;
