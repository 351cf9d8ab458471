//! Build script of the firmware. Passes the linker options of the image to the linker, and writes the pin table of a
//! board for `pin_table.rs`. The environment variable `OXMILL_BOARD` names the board. Without it, the script takes the
//! first board that uses this image.

use oxmill_tables::{BOARDS, Board, PinTable};
use std::path::Path;
use std::{env, fs};

const BOARD: &str = "OXMILL_BOARD";

fn main() {
    // 16 KiB of stack. The largest use in the QEMU sessions is 6.9 KiB (`cargo xtask converse`). The images `control_*`
    // get 20 KiB: they have four axes, and because they are built for size, less of their set-up is inlined. Both take
    // more stack.
    let is_control = oxmill_images::chosen().is_some_and(|image| image.starts_with("control_"));
    let stack_kib = if is_control { 20 } else { 16 };
    oxmill_images::link(&["bins"], stack_kib);
    println!("cargo:rerun-if-env-changed={BOARD}");
    let Some(image) = oxmill_images::chosen() else { return };
    let folder = env::var_os("OUT_DIR").expect("cargo sets OUT_DIR");
    let write = |table: PinTable| fs::write(Path::new(&folder).join("pin_table"), table.bytes());
    write(table_for(image)).expect("cargo's OUT_DIR can be written");
}

/// Returns the pin table for an image. QEMU's board has no pins, so its table is empty.
fn table_for(image: &str) -> PinTable {
    if image == "qemu_mps2" {
        return PinTable::none(0);
    }
    let mut boards = BOARDS.iter().filter_map(|(name, _)| Board::named(name));
    let board = match env::var(BOARD) {
        Ok(name) => boards.find(|board| board.name == name),
        Err(_) => boards.find(|board| board.image.name == image),
    };
    let board = board.unwrap_or_else(|| panic!("{BOARD} names no board of {image}"));
    assert_eq!(board.image.name, image, "{} has another image", board.name);
    board.table()
}
