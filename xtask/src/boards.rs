//! Looks up boards (`boards/tables`) and images (`boards/images`) by the name of a board. An image is one build of the
//! firmware. Boards that differ only in their pins share an image.

use crate::QEMU_BOARD;
pub use oxmill_images::{FAST, IMAGES, SMALL};
use oxmill_tables::Board;

/// Returns the names of all boards: the boards with a pin table, and QEMU's emulated board, which has no pins.
pub fn names() -> impl Iterator<Item = &'static str> {
    with_hardware().chain([QEMU_BOARD])
}

/// Returns the names of all boards except QEMU's.
pub fn with_hardware() -> impl Iterator<Item = &'static str> {
    oxmill_tables::BOARDS.iter().map(|(name, _)| *name)
}

/// Returns the description of a board from `boards/tables`: its chip, its pins and its image. Fails for QEMU's board
/// and for an unknown name.
pub fn described(board: &str) -> Result<Board, crate::Failure> {
    Board::named(board).ok_or_else(|| format!("{board} has no pin table"))
}

/// Returns the name of a board's image, such as `control_f407`. The cargo feature of the image has the same name. If
/// `board` is itself the name of an image, returns that image; for an unknown name, returns QEMU's image.
pub fn image(board: &str) -> &'static str {
    let own = IMAGES.into_iter().find(|image| *image == board);
    own.or_else(|| Board::named(board).map(|board| board.image.name)).unwrap_or(QEMU_BOARD)
}

/// Returns the cargo profile of a board's image: `firmware` (built for speed) or `firmware-small` (built for size).
pub fn profile(board: &str) -> &'static str {
    oxmill_images::profile(image(board))
}
