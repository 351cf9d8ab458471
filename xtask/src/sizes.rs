//! Compares the flash and RAM sizes of each image with `boards/sizes.txt`, so that growth is noticed early, and not
//! only when the flash is full. The file has one row per image; several boards can share an image.

use crate::{Failure, root};
use std::fs;

/// Tolerated growth, percent.
const TOLERANCE: u64 = 2;
/// Environment variable: `check` rejects images that have grown, `accept` records the new sizes. Without it, growth
/// only causes a message.
const MODE: &str = "OXMILL_SIZES";

/// Compares the flash and RAM bytes of an image with the expected ones, or records them, depending on [`MODE`].
/// Returns a message for the user if there is one.
pub fn judge(image: &str, flash: u32, ram: u32) -> Result<Option<String>, Failure> {
    let path = root().join("boards/sizes.txt");
    let text = fs::read_to_string(&path).map_err(|error| format!("{}: {error}", path.display()))?;
    let mode = std::env::var_os(MODE).map(|mode| mode.to_string_lossy().into_owned());
    match mode.as_deref() {
        Some("accept") => {
            fs::write(&path, accepted(&text, image, flash, ram)).map_err(|e| format!("{}: {e}", path.display()))?;
            Ok(Some("accepted as the expected size".into()))
        }
        Some("check") => compare(&text, image, flash, ram).map_or(Ok(None), Err),
        None => Ok(compare(&text, image, flash, ram)),
        Some(other) => Err(format!("{MODE} is `check` or `accept`, not `{other}`")),
    }
}

/// Returns the flash and RAM bytes that `text`, the contents of `boards/sizes.txt`, has for an image; `None` if it has
/// no row for the image.
fn expected(text: &str, image: &str) -> Option<(u32, u32)> {
    let mut words = text.lines().find(|line| line.split_whitespace().next() == Some(image))?.split_whitespace().skip(1);
    Some((words.next()?.parse().ok()?, words.next()?.parse().ok()?))
}

/// Returns a message if flash or RAM have grown by more than [`TOLERANCE`], or if the file has no row for the image.
fn compare(text: &str, image: &str, flash: u32, ram: u32) -> Option<String> {
    let accept = format!("if that is right: {MODE}=accept cargo fw {image}");
    let Some((flash_before, ram_before)) = expected(text, image) else {
        return Some(format!("boards/sizes.txt has no {image}; {accept}"));
    };
    let grown = |what: &str, before: u32, now: u32| {
        let most = u64::from(before) * (100 + TOLERANCE) / 100;
        (u64::from(now) > most).then(|| format!("{what} has grown from {before} to {now} bytes"))
    };
    let grown: Vec<String> =
        [grown("flash", flash_before, flash), grown("RAM", ram_before, ram)].into_iter().flatten().collect();
    (!grown.is_empty()).then(|| format!("{image}: {}, by more than {TOLERANCE} %; {accept}", grown.join(", ")))
}

/// Returns the text of the file with the new sizes of an image.
fn accepted(text: &str, image: &str, flash: u32, ram: u32) -> String {
    let row = format!("{image:<16} {flash:>7} {ram:>6}");
    let mut rows: Vec<String> = text.lines().map(str::to_owned).collect();
    match rows.iter_mut().find(|line| line.split_whitespace().next() == Some(image)) {
        Some(old) => *old = row,
        None => rows.push(row),
    }
    rows.join("\n") + "\n"
}

#[cfg(test)]
mod tests {
    use super::*;

    const TEXT: &str = "# board flash RAM\nsmall 1000 500\nlarge 200000 40000\n";

    #[test]
    fn growth_beyond_the_tolerance_is_told_with_the_way_to_accept_it() {
        assert_eq!(compare(TEXT, "small", 1020, 510), None);
        assert_eq!(compare(TEXT, "small", 10, 10), None);
        let why = compare(TEXT, "small", 1021, 510).unwrap();
        assert!(why.contains("flash") && !why.contains("RAM") && why.contains("OXMILL_SIZES=accept cargo fw small"));
        assert!(compare(TEXT, "large", 200_000, 41_000).unwrap().contains("RAM"));
        assert!(compare(TEXT, "new", 1, 1).is_some());
    }

    #[test]
    fn an_accepted_size_is_the_expected_one() {
        let text = accepted(&accepted(TEXT, "small", 7, 8), "new", 9, 10);
        assert_eq!(expected(&text, "small"), Some((7, 8)));
        assert_eq!(expected(&text, "large"), Some((200_000, 40_000)));
        assert_eq!(expected(&text, "new"), Some((9, 10)));
        assert!(text.starts_with("# board flash RAM\n"));
    }

    #[test]
    fn every_board_has_a_row() {
        let text = fs::read_to_string(root().join("boards/sizes.txt")).unwrap();
        for image in crate::boards::IMAGES {
            assert!(expected(&text, image).is_some(), "{image}");
        }
    }
}
