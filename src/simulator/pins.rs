//! The line protocol that moves input pins by hand: `limit x 1`, `probe 1`, `door 1`, `estop 1`, `input 0 1` and so on.
//! `noise limit x` puts a glitch on a pin, too short to pass the input filter; `steps` queries the state of the step
//! outputs.
//!
//! A level stays until it is changed. 1 is a closed contact (a low pin): active, unless a setting inverts the input.

use oxmill_controller::axes::Axis;
use oxmill_controller::messages::{SECOND_SWITCH, Signals, input};

/// Executes a line of the protocol, such as `door 1`: returns `signals` with the new level of this pin. `axes`: number
/// of axes of the machine. The error is a sentence for the user.
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
        ["estop", value] => after.emergency_stop = level(value)?,
        ["fault", value] => after.driver_fault = level(value)?,
        ["at_speed", value] => after.at_speed = level(value)?,
        ["input", number @ ("0" | "1"), value] => {
            let bit = if *number == "0" { 1 } else { 2 };
            if level(value)? { after.program |= bit } else { after.program &= !bit }
        }
        _ => {
            return Err(format!(
                "`{}` is not understood; pins are set by `limit AXIS 0|1`, `input 0|1 0|1` and by `second_limit`, `probe`, `door`, `hold`, `start`, \
                 `reset`, `estop`, `fault` or `at_speed` with 0 or 1, and disturbed by `noise PIN`",
                line.trim()
            ));
        }
    }
    Ok(after)
}

/// Returns the bit number of the input on which a `noise` line puts a glitch; `None` for other lines. The error is a
/// sentence for the user.
pub fn disturbed(axes: usize, line: &str) -> Option<Result<u32, String>> {
    let words: Vec<String> = line.split_whitespace().map(str::to_ascii_lowercase).collect();
    let words: Vec<&str> = words.iter().map(String::as_str).collect();
    let ["noise", pin @ ..] = words.as_slice() else { return None };
    Some(match pin {
        ["limit", axis] => axis_index(axis, axes).map(|index| index as u32),
        ["second_limit"] => Ok(SECOND_SWITCH.trailing_zeros()),
        ["probe"] => Ok(input::PROBE),
        ["door"] => Ok(input::DOOR),
        ["hold"] => Ok(input::HOLD),
        ["start"] => Ok(input::START),
        ["reset"] => Ok(input::RESET),
        ["estop"] => Ok(input::EMERGENCY_STOP),
        ["fault"] => Ok(input::DRIVER_FAULT),
        ["at_speed"] => Ok(input::AT_SPEED),
        ["input", "0"] => Ok(input::PROGRAM),
        ["input", "1"] => Ok(input::SECOND_PROGRAM),
        _ => Err(format!("`{}` names no pin", line.trim())),
    })
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
        for line in
            ["limit x 1", "LIMIT Z 1", " probe  1 ", "door 1", "door 0", "hold 1", "start 1", "reset 1", "fault 1"]
        {
            signals = apply(signals, 3, line).unwrap();
        }
        let some = Signals { limits: 0b101, probe: true, hold: true, start: true, ..Signals::NONE };
        assert_eq!(signals, Signals { reset: true, driver_fault: true, ..some });
        assert_eq!(disturbed(3, "noise limit y"), Some(Ok(1)));
        assert!(disturbed(3, "limit y 1").is_none() && disturbed(3, "noise lamp").unwrap().is_err());
        assert_eq!(apply(signals, 3, "limit x 0").unwrap().limits, 0b100);
        let both = ["input 0 1", "input 1 1", "input 0 0"].map(|line| {
            signals = apply(signals, 3, line).unwrap();
            signals.program
        });
        assert_eq!(both, [1, 3, 2]);
        assert_eq!(disturbed(3, "noise input 1"), Some(Ok(input::SECOND_PROGRAM)));
    }

    #[test]
    fn mistakes_are_explained() {
        for line in ["", "limit 1", "limit a 1", "limit q 1", "probe 2", "probe", "lamp 1", "limit xy 1"] {
            assert!(apply(Signals::default(), 3, line).is_err(), "{line}");
        }
    }
}
