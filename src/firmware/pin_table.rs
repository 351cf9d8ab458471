//! The pin table of the board that the image was built for. A tool may replace it in the finished image.

use crate::boards;

/// The table, in the section that the linker script reserves for it. The board reads the table from there.
#[used]
#[unsafe(link_section = ".pin_table")]
// unsafe because the linker does not check the section; safe because this is read-only data in flash.
static TABLE: boards::pin_table::PinTable =
    boards::pin_table::PinTable::from_bytes(*include_bytes!(concat!(env!("OUT_DIR"), "/pin_table")));
