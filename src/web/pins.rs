//! The pin tables of boards, for pages that load firmware: reads and checks a table, and writes it into an image.

use oxmill_tables::{BOARDS, Board, image_file};
use serde::Serialize;

/// A pin table without faults, as JSON for a page.
#[derive(Serialize)]
pub struct Table {
    /// The board's name, as in `$I`.
    name: String,
    /// Name of the firmware's image that the table is for.
    image: &'static str,
    /// Number of pins that have a function.
    pins: usize,
}

/// Returns the file with the pin table of a board of this project; empty if there is no such board.
pub fn file(name: &str) -> &'static str {
    BOARDS.iter().find(|(own, _)| *own == name).map_or("", |(_, text)| text)
}

/// Returns the name in the pin table of an image; empty if the image has no intact pin table.
pub fn name_in(image: &[u8]) -> String {
    image_file::table(image).map(|table| table.name().to_owned()).unwrap_or_default()
}

/// Checks a pin table.
///
/// # Errors
///
/// All faults of the table, a line each.
pub fn check(text: &str) -> Result<Table, String> {
    let board = parse(text)?;
    Ok(Table { name: board.name, image: board.image.name, pins: board.pins.len() })
}

/// Returns an image (`.dfu`, `.hex`, `.elf` or `.bin`) with its pin table replaced. `order` is the new table, a 0 byte
/// and the image.
///
/// # Errors
///
/// All faults of the table, a line each; or why the table does not fit the image, or that the image is damaged.
pub fn write(order: &[u8]) -> Result<Vec<u8>, String> {
    let end = order.iter().position(|byte| *byte == 0).ok_or("the table does not end in a 0 byte")?;
    let (text, image) = order.split_at(end);
    let text = std::str::from_utf8(text).map_err(|_| "the pin table is no text")?;
    image_file::write(image.get(1..).unwrap_or_default(), &parse(text)?.table())
}

fn parse(text: &str) -> Result<Board, String> {
    let text_of = |fault: oxmill_tables::Fault| {
        if fault.line > 0 { format!("line {}: {}", fault.line, fault.text) } else { fault.text }
    };
    Board::parse(text).map_err(|faults| faults.into_iter().map(text_of).collect::<Vec<_>>().join("\n"))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Bytes of a program with a pin table in them.
    fn image(board: &str) -> Vec<u8> {
        [&[0x55; 100][..], Board::named(board).unwrap().table().bytes(), &[0xaa; 100]].concat()
    }

    #[test]
    fn a_table_is_written_into_the_image_that_it_is_for() {
        let own = file("spider_f446");
        let mine = own.replacen("name = \"spider_f446\"", "name = \"mine\"", 1);
        assert_eq!(check(&mine).unwrap().name, "mine");
        let order = |table: &str, image: &[u8]| [table.as_bytes(), b"\0", image].concat();
        // The image may have the table of another board: the Spider and the Octopus share an image.
        let written = write(&order(&mine, &image("octopus_f446"))).unwrap();
        let wanted = Board::parse(&mine).unwrap().table();
        assert_eq!(written, [&[0x55; 100][..], wanted.bytes(), &[0xaa; 100]].concat());
        assert_eq!(
            [name_in(&image("octopus_f446")), name_in(&written), name_in(b"none")],
            ["octopus_f446", "mine", ""]
        );
        assert!(write(&order(&mine, &image("blackpill_f411"))).unwrap_err().contains("for another image"));
        assert!(write(&order(&mine, &[])).unwrap_err().contains("no intact pin table"));
        assert!(write(mine.as_bytes()).unwrap_err().contains("0 byte"));
    }

    #[test]
    fn each_fault_of_a_table_is_a_line() {
        let own = file("blackpill_f411");
        let wrong = own.replace("\"B15\"", "\"C20\"").replace("\"B9\"", "\"B8\"");
        let said = check(&wrong).err().unwrap();
        assert_eq!(said.lines().count(), 2, "{said}");
        assert!(said.lines().all(|line| line.starts_with("line ")), "{said}");
        assert_eq!(file("none"), "");
    }
}
