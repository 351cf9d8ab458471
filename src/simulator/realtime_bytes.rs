//! Finds bytes in a job's line that a machine would execute as realtime commands if a sender sends them unchanged. The
//! warning says what they would do, and in which dialects.

use oxmill_controller::messages::Realtime;
use oxmill_controller::protocol::comment::CommentTracker;
use oxmill_controller::protocol::realtime::{command, command_of_grblhal};

/// Returns what a command does to a job; `None` if it has no noticeable effect.
fn effect(command: Realtime) -> Option<&'static str> {
    Some(match command {
        Realtime::Status | Realtime::FullStatus | Realtime::ParserState => return None,
        Realtime::Reset => "resets the machine",
        Realtime::Stop => "stops the machine and drops the lines behind",
        Realtime::CycleStart => "resumes the held machine",
        Realtime::FeedHold => "holds the machine",
        Realtime::SafetyDoor => "opens the safety door",
        Realtime::JogCancel => "ends a jog",
        Realtime::SingleBlock => "switches single block on or off",
        Realtime::OptionalStop => "switches the pause at M1 on or off",
        Realtime::ToolReady => "ends the wait for a tool",
        Realtime::FeedReset => "sets the feed to 100 %",
        Realtime::FeedUp10 => "raises the feed by 10 %",
        Realtime::FeedDown10 => "lowers the feed by 10 %",
        Realtime::FeedUp1 => "raises the feed by 1 %",
        Realtime::FeedDown1 => "lowers the feed by 1 %",
        Realtime::RapidFull => "sets rapids to 100 %",
        Realtime::RapidHalf => "sets rapids to 50 %",
        Realtime::RapidQuarter => "sets rapids to 25 %",
        Realtime::SpindleReset => "sets the spindle speed to 100 %",
        Realtime::SpindleUp10 => "raises the spindle speed by 10 %",
        Realtime::SpindleDown10 => "lowers the spindle speed by 10 %",
        Realtime::SpindleUp1 => "raises the spindle speed by 1 %",
        Realtime::SpindleDown1 => "lowers the spindle speed by 1 %",
        Realtime::SpindleStop => "stops the spindle of a held machine",
        Realtime::FloodToggle => "switches flood coolant on or off",
        Realtime::MistToggle => "switches mist coolant on or off",
    })
}

/// Returns a warning about the realtime commands that a line of the file (without its line end) contains, if any.
pub fn warning(line: &[u8]) -> Option<String> {
    let is_text = texts(line);
    // Four lists of effects: in all dialects, in grbl only, in all except grbl, and in grblhal only.
    let mut acts: [Vec<String>; 4] = Default::default();
    for (at, byte) in line.iter().enumerate() {
        let of_grblhal = command_of_grblhal(*byte);
        let Some(command) = command(*byte).or(of_grblhal) else { continue };
        let Some(effect) = effect(command) else { continue };
        let in_grbl = !matches!(command, Realtime::Stop | Realtime::SingleBlock | Realtime::MistToggle);
        let list = match (in_grbl, is_text[at]) {
            (_, false) if of_grblhal.is_some() => &mut acts[3],
            (_, true) if of_grblhal.is_some() => continue,
            (true, false) => &mut acts[0],
            (true, true) => &mut acts[1],
            (false, false) => &mut acts[2],
            (false, true) => continue,
        };
        let act = format!("{} {effect}", shown(line, at));
        if !list.contains(&act) {
            list.push(act);
        }
    }
    let places = ["in every dialect", "in dialect grbl", "in dialects oxmill, seed and grblhal", "in dialect grblhal"];
    let listed = acts.iter().zip(places).filter(|(acts, _)| !acts.is_empty());
    let listed: Vec<_> = listed.map(|(acts, place)| format!("{place}: {}", acts.join(", "))).collect();
    (!listed.is_empty()).then(|| format!("if sent unchanged {}", listed.join("; ")))
}

/// Returns for each byte whether it is text of a comment. Such a byte can be a command in dialect grbl only.
fn texts(line: &[u8]) -> Vec<bool> {
    let mut comment = CommentTracker::NONE;
    let mut is_text = vec![false; line.len()];
    let mut begun_at = 0;
    for (at, byte) in line.iter().enumerate() {
        comment.break_off(*byte);
        if !comment.has_begun_character() {
            begun_at = at;
        }
        if !comment.takes(*byte, || true) {
            // In a comment, `!`, `~` and the bytes that mean the same in dialect grblhal are text if another byte
            // follows. Here another byte always follows, at least the line end.
            is_text[at] = matches!(byte, b'!' | b'~' | 0x81 | 0x82 | 0xA3) && comment.is_inside();
            comment.follow(*byte, || true);
        } else if !comment.has_begun_character() {
            is_text[begun_at..=at].fill(true);
        }
    }
    is_text
}

/// Names a byte for a reader of the file: an ASCII character as such, other bytes together with their character, such
/// as "byte 0x84 of `Ä`".
fn shown(line: &[u8], at: usize) -> String {
    let byte = line[at];
    if byte.is_ascii_graphic() {
        return format!("`{}`", char::from(byte));
    }
    let mut end = 0;
    for chunk in line.utf8_chunks() {
        for character in chunk.valid().chars() {
            end += character.len_utf8();
            if (at + 1..at + 4).contains(&end) && end - character.len_utf8() < at {
                let is_seen = !character.is_control() && !character.is_whitespace();
                let name = if is_seen { format!("`{character}`") } else { format!("U+{:04X}", u32::from(character)) };
                return format!("byte 0x{byte:02X} of {name}");
            }
        }
        end += chunk.invalid().len();
    }
    format!("byte 0x{byte:02X}")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_a_line_would_do_is_told_by_dialect() {
        let warned = |line: &str| warning(line.as_bytes());
        assert_eq!(warned("G1 X1 (plain, really?) ; µm ° ß ü é 切"), None);
        assert_eq!(warned("(wow! good!)").unwrap(), "if sent unchanged in dialect grbl: `!` holds the machine");
        assert_eq!(warned("(wow) !").unwrap(), "if sent unchanged in every dialect: `!` holds the machine");
        assert_eq!(
            warned("(Äußere Kontur)").unwrap(),
            "if sent unchanged in dialect grbl: byte 0x84 of `Ä` opens the safety door"
        );
        assert_eq!(
            warned("G1 X1 ; à (Ö ~").unwrap(),
            "if sent unchanged in dialect grbl: byte 0xA0 of `à` switches flood coolant on or off, byte 0x96 of `Ö` sets rapids \
             to 50 %, `~` resumes the held machine"
        );
        assert_eq!(
            warned("Ä(20\u{A0}mm \u{1F604})").unwrap(),
            "if sent unchanged in every dialect: byte 0x84 of `Ä` opens the safety door, byte 0xA0 of U+00A0 switches flood \
             coolant on or off; in dialect grbl: byte 0x84 of `😄` opens the safety door"
        );
        assert_eq!(
            warned("É \u{A1}").unwrap(),
            "if sent unchanged in dialects oxmill, seed and grblhal: byte 0x89 of `É` switches single block on or off, byte 0xA1 of `¡` switches mist coolant on or off"
        );
        // The bytes are Windows-1252 text and a control character.
        assert_eq!(
            warning(b"(\x84a\x93\x18)").unwrap(),
            "if sent unchanged in every dialect: byte 0x84 opens the safety door, byte 0x93 raises the feed by 1 %, byte 0x18 \
             resets the machine"
        );
    }
}
