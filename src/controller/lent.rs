//! `Lent`: memory that whoever makes a controller gives it for good. On boards it lies in `.bss`, next to the tasks; hosts
//! have a heap.

#[cfg(feature = "alloc")]
pub type Lent<T> = alloc::boxed::Box<T>;
#[cfg(not(feature = "alloc"))]
pub type Lent<T> = &'static mut T;
