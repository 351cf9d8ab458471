//! How the large parts of the controller hold their memory: by a reference on boards, in a box in programs on a PC.

/// Access to a `T` stored outside the controller: in programs on a PC (feature `alloc`), a box on the heap.
#[cfg(feature = "alloc")]
pub type Lent<T> = alloc::boxed::Box<T>;
/// Access to a `T` stored outside the controller: on boards, a reference to static memory (`.bss`).
#[cfg(not(feature = "alloc"))]
pub type Lent<T> = &'static mut T;
