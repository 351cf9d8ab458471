//! The line protocol that moves input pins: `limit x 1`, `second_limit 1` (at the second motor of an axis), `probe 1`, `door 1`, `hold 1`, `start 1`, `reset 1`.
//!
//! A level stays until it is changed; 1 is active, whatever the polarity of the wiring.

use oxmill_controller::axes::Axis;
use oxmill_controller::messages::{SECOND_SWITCH, Signals};

/// The levels after a line of the protocol, or a sentence about what is wrong with it.
pub fn apply(signals: Signals, axes: usize, line: &str) -> Result<Signals, String> {
    let words: Vec<String> = line.split_whitespace().map(str::to_ascii_lowercase).collect();
    let words: Vec<&str> = words.iter().map(String::as_str).collect();
    let mut after = signals;
    match words.as_slice() {
        ["limit", axis, value] => {
            let bit = 1 << axis_index(axis, axes)?;
            if level(value)? { after.limits |= bit } else { after.limits &= !bit }
        }
        ["second_limit", value] => {
            if level(value)? {
                after.limits |= SECOND_SWITCH
            } else {
                after.limits &= !SECOND_SWITCH
            }
        }
        ["probe", value] => after.probe = level(value)?,
        ["door", value] => after.door = level(value)?,
        ["hold", value] => after.hold = level(value)?,
        ["start", value] => after.start = level(value)?,
        ["reset", value] => after.reset = level(value)?,
        _ => {
            return Err(format!(
                "`{}` is not understood; pins are set by `limit AXIS 0|1` and by `second_limit`, `probe`, `door`, `hold`, `start` or \
                 `reset` with 0 or 1",
                line.trim()
            ));
        }
    }
    Ok(after)
}

fn level(word: &str) -> Result<bool, String> {
    match word {
        "0" => Ok(false),
        "1" => Ok(true),
        _ => Err(format!("`{word}` is not a level; 1 is active, 0 is not")),
    }
}

fn axis_index(word: &str, axes: usize) -> Result<usize, String> {
    let letter = match word.as_bytes() {
        [letter] => Axis::from_letter(letter.to_ascii_uppercase()),
        _ => None,
    };
    letter
        .map(Axis::index)
        .filter(|index| *index < axes)
        .ok_or_else(|| format!("`{word}` is not an axis of this machine"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pins_move_one_at_a_time() {
        let mut signals = Signals::default();
        for line in ["limit x 1", "LIMIT Z 1", " probe  1 ", "door 1", "door 0", "hold 1", "start 1", "reset 1"] {
            signals = apply(signals, 3, line).unwrap();
        }
        assert_eq!(signals, Signals { limits: 0b101, probe: true, door: false, hold: true, start: true, reset: true });
        assert_eq!(apply(signals, 3, "limit x 0").unwrap().limits, 0b100);
    }

    #[test]
    fn mistakes_are_explained() {
        for line in ["", "limit 1", "limit a 1", "limit q 1", "probe 2", "probe", "lamp 1", "limit xy 1"] {
            assert!(apply(Signals::default(), 3, line).is_err(), "{line}");
        }
    }
}
