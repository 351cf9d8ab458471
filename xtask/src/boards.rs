//! Looks up the boards and their images in `boards/tables` and `boards/images`, by the name of a board.

use crate::QEMU_BOARD;
pub use oxmill_images::{FAST, IMAGES, SMALL};
use oxmill_tables::Board;

/// Returns the names of all boards. QEMU's board has no pins and no table.
pub fn names() -> impl Iterator<Item = &'static str> {
    with_hardware().chain([QEMU_BOARD])
}

/// Returns the names of all boards except QEMU's.
pub fn with_hardware() -> impl Iterator<Item = &'static str> {
    oxmill_tables::BOARDS.iter().map(|(name, _)| *name)
}

/// Returns the description of a board with hardware.
pub fn described(board: &str) -> Result<Board, crate::Failure> {
    Board::named(board).ok_or_else(|| format!("{board} has no pin table"))
}

/// Returns the image of a board, which is also the feature that the board is built with. `board` may also be the name
/// of an image: then that image is returned. For an unknown name it is QEMU's image.
pub fn image(board: &str) -> &'static str {
    let own = IMAGES.into_iter().find(|image| *image == board);
    own.or_else(|| Board::named(board).map(|board| board.image.name)).unwrap_or(QEMU_BOARD)
}

/// Returns the cargo profile of a board's image.
pub fn profile(board: &str) -> &'static str {
    oxmill_images::profile(image(board))
}
