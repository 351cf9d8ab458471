//! Modules shared by the STM32F4 boards: the part that the step interrupt uses ([`step`], `chain`, `dma`, `registers`)
//! and the rest of the chip (`setup`, `clocks`, `pins`, `chip`, `flash`, `loader`, `supply`, `usart`, `usb`).

mod chain;
mod dma;
pub mod registers;
pub mod step;

#[cfg(feature = "stm32f4")]
mod chip;
#[cfg(feature = "stm32f4")]
mod clocks;
#[cfg(feature = "stm32f4")]
mod flash;
#[cfg(feature = "stm32f4")]
mod loader;
#[cfg(feature = "stm32f4")]
mod pins;
#[cfg(feature = "stm32f4")]
pub mod setup;
#[cfg(feature = "stm32f4")]
mod supply;
#[cfg(feature = "stm32f4")]
pub mod usart;
#[cfg(all(feature = "stm32f4", not(feature = "usb")))]
pub mod usart_dma;
#[cfg(feature = "usb")]
pub mod usart_interrupt;
#[cfg(feature = "usb")]
pub mod usb;

#[cfg(feature = "stm32f4")]
pub use chip::*;
#[cfg(feature = "stm32f4")]
pub use flash::SettingsFlash;
#[cfg(feature = "stm32f4")]
pub use loader::{HAS_LOADER, enter_loader_if_requested, reboot};
#[cfg(feature = "stm32f4")]
pub use supply::*;
