//! Advice for each error and alarm, and replacements for words that the controller rejects (G33, G41, M97). The
//! controller's own texts name the fault; these texts say what the user can do about it.

use oxmill_controller::error::{Alarm, Error};

/// Advice for words of 3-D printers. The advice is about the whole program, not about the word.
pub const PRINTER: &str = "The program was made for a 3-D printer. Do not repair it: make the part's program with CAM software for mills, with a post-processor for Grbl.";

/// Words that the controller rejects, each with the advice what to write instead.
const INSTEAD: [(&[&str], &str); 11] = [
    (
        &["G33", "G33.1", "G74", "G76", "G84"],
        "The machine does not measure the spindle's rotation, so it cannot cut threads in step with it: drill the hole (G81), then mill the thread with G2 or G3 and Z, or tap by hand.",
    ),
    (&["G96"], "Write the speed of the spindle in revolutions per minute: G97 S1000."),
    (&["G7", "G8"], "Remove the word, and write X as a radius: there is no lathe mode."),
    (&["G16"], "Write X and Y; with expressions, X[#1*COS[#2]] Y[#1*SIN[#2]] is the point at radius #1 and angle #2."),
    (
        &["G41", "G41.1", "G42", "G42.1"],
        "Let the CAM program offset the path by the radius of the cutter, and remove the word.",
    ),
    (&["G51.1"], "Mirror with G51 and a negative I or J."),
    (
        &["G65", "G66", "M98", "M99"],
        "Write the word as a plain number at the beginning of a line, M99 without P: docs/gcode.md has more about subprograms. The Black Pill F401 has none.",
    ),
    (
        &["M97"],
        "Write the lines from N1000 on as a subprogram behind M30: O1000, the lines, M99. Call it with M98 P1000.",
    ),
    (&["G87"], "Write the back boring cycle as single moves."),
    (&["M82", "M83", "M84", "M104", "M106", "M107", "M109", "M117", "M140", "M190"], PRINTER),
    (&["M19"], "Remove the word: the spindle cannot be turned to an angle."),
];

/// Advice for a line of a job that is too long.
pub const LONG_LINE: &str =
    "Split the line: put M, S, T and F on a line above, and keep X, Y, Z, I, J, K and R together.";

/// Advice for a line that is too long because of the decimals of its numbers.
pub const LONG_NUMBERS: &str = "Write at most four decimals in each number: the machine cannot use more. Most post-processors have a setting for it.";

/// Advice for a line that is too long because of its expressions.
pub const LONG_EXPRESSION: &str = "Calculate a part of the expression on a line above: #<part>=[20/3+1.5], then use it as X[#<part>+4]. Divide the expression at a + or - that is outside its inner brackets.";

/// Advice for a word of the axis A on a machine without that axis.
const WORD_OF_A: &str =
    "Set $930=4 if the machine has a rotary axis A and the board has four axes; otherwise remove the word.";

/// Advice for a comment with nested parentheses, such as `(profile (outside)`.
const NESTED_COMMENT: &str =
    "Remove the inner parentheses of the comment: in Grbl's dialect a comment ends at the first closing parenthesis.";

/// Returns the advice for error `code`, which the controller has sent for the text `line`. If the line has a rejected
/// word with a replacement, the advice is that replacement. Otherwise it is the general advice for the error.
pub fn for_line(code: u8, line: &str) -> &'static str {
    let refused =
        [Error::NotSupported, Error::UnsupportedCommand, Error::CutterCompensation, Error::UnsupportedCoordinateSystem];
    if [Error::ExpectedLetter, Error::BadNumber].iter().any(|error| error.code() == code) && has_nested_comment(line) {
        return NESTED_COMMENT;
    }
    if !refused.iter().any(|error| error.code() == code) {
        return for_code(code);
    }
    let words = words(line);
    let plain: Vec<String> = words.iter().map(|word| plain(word)).collect();
    let instead = INSTEAD.iter().find(|(refused, _)| plain.iter().any(|word| refused.contains(&word.as_str())));
    match instead {
        Some((_, advice)) => advice,
        None if code == Error::UnsupportedCommand.code() && words.iter().any(|word| is_of(word, 'A')) => WORD_OF_A,
        None => for_code(code),
    }
}

/// Like [`for_line`], for a report that also shows `sentence`, the controller's own message about the line. If the
/// sentence already says what to write, general advice is left out and the result is empty.
pub fn beside(sentence: &str, code: u8, line: &str) -> &'static str {
    /// If a part of a sentence begins with one of these verbs, it says what to write.
    const IMPERATIVES: [&str; 15] = [
        "write", "set", "take", "correct", "choose", "add", "divide", "give", "name", "use", "split", "end", "remove",
        "put", "let",
    ];
    let advice = for_line(code, line);
    let says_what_to_write = sentence.split([':', '.', ',']).skip(1).any(|part| {
        let verb = part.split_whitespace().next().unwrap_or_default().to_lowercase();
        IMPERATIVES.contains(&verb.as_str())
    });
    let is_enough = says_what_to_write || sentence.contains("such as");
    if is_enough && advice == for_code(code) { "" } else { advice }
}

/// Returns how many words with this upper-case letter a line has, outside of comments. `G1 X1 x[2]` has two words with
/// `X`.
pub fn count(line: &str, letter: char) -> usize {
    words(line).iter().filter(|word| is_of(word, letter)).count()
}

/// Returns whether a comment of the line contains an opening parenthesis.
fn has_nested_comment(line: &str) -> bool {
    let mut within = false;
    for character in line.split(';').next().unwrap_or_default().chars() {
        match character {
            '(' if within => return true,
            '(' => within = true,
            ')' => within = false,
            _ => {}
        }
    }
    false
}

/// Returns whether `word` is this letter with its value: `A5` or `A[1]`, but not the first letter of a function such as
/// `ABS`.
fn is_of(word: &str, letter: char) -> bool {
    word.strip_prefix(letter)
        .is_some_and(|number| number.starts_with(|c: char| c.is_ascii_digit() || "+-.[#".contains(c)))
}

/// Returns the words of a line, without comments and parameter names. Each word begins with an upper-case letter: `g1
/// x[2] (a)` becomes `G1` and `X[2]`.
pub fn words(line: &str) -> Vec<String> {
    let mut words: Vec<String> = Vec::new();
    let mut depth = 0_usize;
    for character in line.split(';').next().unwrap_or_default().chars().filter(|c| !c.is_whitespace()) {
        match character {
            '(' | '<' => depth += 1,
            ')' | '>' => depth = depth.saturating_sub(1),
            _ if depth > 0 => {}
            letter if letter.is_ascii_alphabetic() => words.push(letter.to_ascii_uppercase().into()),
            _ => words.last_mut().into_iter().for_each(|word| word.push(character)),
        }
    }
    words
}

/// Returns a word without leading zeros in its number and trailing zeros in its fraction: `G081.0` becomes `G81`.
fn plain(word: &str) -> String {
    let (letter, number) = word.split_at(1);
    let (whole, fraction) = number.split_once('.').unwrap_or((number, ""));
    let (whole, fraction) = (whole.trim_start_matches('0'), fraction.trim_end_matches('0'));
    let point = if fraction.is_empty() { "" } else { "." };
    format!("{letter}{}{point}{fraction}", if whole.is_empty() { "0" } else { whole })
}

/// Returns the general advice for an error number, as in `error:20`; empty if the number does not exist.
pub fn for_code(code: u8) -> &'static str {
    Error::ALL.iter().find(|error| error.code() == code).map_or("", |error| for_error(*error))
}

/// Returns the general advice for an error: what the user can do, in whole sentences.
pub fn for_error(error: Error) -> &'static str {
    match error {
        Error::ExpectedLetter
        | Error::BadNumber
        | Error::UnsupportedCommand
        | Error::NotSupported
        | Error::CutterCompensation => {
            "Choose a post-processor for Grbl in the CAM program, or correct the line; docs/gcode.md lists the supported words."
        }
        Error::InvalidStatement => "See docs/settings.md for the number, unit and range of the setting.",
        Error::SettingOutOfRange => {
            "See docs/settings.md for its values. Settings with 0 or 1 do not take grblHAL's bits, such as those of $21 and $22 (docs/coming-from.md)."
        }
        Error::NegativeValue => "Remove the minus sign: only positions, distances, angles and $58 may be negative.",
        Error::HomingDisabled => "Enable homing with $22=1, if the machine has limit switches.",
        Error::StepPulseTooShort => {
            "Set $0 to 1 us or more (0.5 on a Nucleo F446RE, 3 in Grbl's dialect), and at most 255 us."
        }
        Error::StoreReadFailed => {
            "Read the settings with $$, restore what is wrong, and confirm with $X two seconds later."
        }
        Error::NotIdle => {
            "Wait until the machine is idle, or stop it with a reset. In an alarm, unlock it with $X before a jog."
        }
        Error::Locked => {
            "Unlock with $X, or home with $H. A message before the error says which setting locks the motion, if one does."
        }
        Error::SoftLimitNeedsHoming => "Switch homing on ($22=1) before the soft limits ($20=1).",
        Error::LineTooLong => {
            "Split the line: put M, S, T, F and parts of long expressions (#<part>=[..]) on a line above, and keep X, Y, Z, I, J, K and R together. At most 256 characters fit; 79 in Grbl's dialect; 80 after the = of $I, $N and $M."
        }
        Error::DoorOpen => "Close the door; $903=0 if the machine has none.",
        Error::JogOutsideTravel => "Jog less far, or let jogs end at the soft limits with $40=1.",
        Error::InvalidJog => "Give a jog a feed rate, and axis words, G20, G21, G53, G90 and G91 only.",
        Error::ModalGroupViolation | Error::TwoAxisCommands | Error::WordRepeated => {
            "Put the second word on a line of its own."
        }
        Error::UndefinedFeed => "Put an F word in this line or before it. G93 needs one in each line.",
        Error::IntegerRequired => "Give the word a whole number.",
        Error::NoAxisWords => "Add the axis words that the command needs.",
        Error::InvalidLineNumber => "Write N with 10,000,000 at most, or leave it out.",
        Error::ValueWordMissing => "Add the missing word; docs/gcode.md has those of each command.",
        Error::UnsupportedCoordinateSystem => {
            "Use one of G54 to G59.3, which are P1 to P9 in G10; G54.1 P1 to P3 are G59.1 to G59.3. Grbl's dialect has only G54 to G59."
        }
        Error::G53NeedsMotion => "Put G0 or G1 in the line with G53.",
        Error::AxisWordsUnused => "Take the axis words out, or choose a motion mode instead of G80.",
        Error::NoPlaneAxisForArc | Error::NoPlaneOffsets => {
            "Give the arc a target or an offset in the plane: X, Y, I, J in G17; X, Z, I, K in G18; Y, Z, J, K in G19."
        }
        Error::InvalidTarget => {
            "Arc: its start and its end must be equally far from the centre (I, J, K); with R the end must not be the start. Probing: the target must not be where the tool is. Any move must stay within 50 m of machine zero. If an earlier line was refused, correct that one first: this move then starts at another point."
        }
        Error::ImpossibleRadius => "Give a radius of at least half the distance from start to end, or use I and J.",
        Error::UnusedWords => "Remove the words that no command of this line uses.",
        Error::ToolLengthAxis => "Give the tool length offset in Z.",
        Error::ToolNumberTooHigh | Error::ValueOutOfRange => "Use a value within the range that docs/gcode.md gives.",
        Error::SpindleNotTurning => "Start the spindle with M3 or M4 and an S word before the cycle.",
        Error::UnknownTool => {
            "Enter the tool with its length above this line: G10 L1 P5 Z12.5 is tool 5, 12.5 mm long. `$#` lists the tools of the table."
        }
        Error::EmergencyStop => "Release the emergency stop, then reset.",
        Error::DriverFault => "Find out why the motor driver reports a fault, then turn it off and on.",
        Error::RetractBelowBottom => "Give R above the bottom of the hole.",
        Error::UnknownOperation
        | Error::DivisionByZero
        | Error::ArgumentOutOfRange
        | Error::InvalidArgument
        | Error::ExpressionSyntax
        | Error::InvalidResult => {
            "Correct the expression; docs/expressions.md has operators, functions and parameters."
        }
        Error::FlowSyntax => {
            "Look for the missing start or end of this block: each O number needs a start and an end. Only a call may have an expression as its number."
        }
        Error::TooDeep => "Nest fewer brackets, calls or loops.",
        Error::OutOfMemory => "Use fewer or shorter subroutines and parameters.",
        Error::CycleNeedsPerMinute => "Write G94 and F before the line.",
        Error::NothingSaved => "Save the state with M70 or M73 before M72, in the same subroutine.",
        Error::NotInRotatedPlane => "Select the plane of the rotation, or end it: G69, or G10 L2 P0 R0.",
        Error::UnequalScaling => "Give both axes of the plane the same factor, or write the curve in short lines.",
        Error::ThousandfoldScaling => {
            "Write the factors of G51 as plain numbers: P1.5, not P1500 as for controls that count in thousandths."
        }
        Error::ScalingActs => "End the scaling with G50 before the line.",
        Error::RotationActs => "End the rotation with G69 before the line.",
        Error::RecorderLeftOut => {
            "This board has no recorder. Repeat the job in the simulator: oxmill serve --record FILE."
        }
        Error::DescriptionsLeftOut => "See docs/settings.md and docs/errors.md for the numbers.",
        Error::ControlPointsNotBegun => "Write G5.2 before the control points, and no other move before G5.3.",
        Error::ControlPointsNotEnded => "End the control points with G5.3 before other moves, or cancel them with G80.",
        Error::TooFewControlPoints => "Add control points before G5.3, or choose a lower order L.",
        Error::TooManyControlPoints => "Split the curve into several with fewer control points.",
        Error::OneRotaryAxis => "Use A as the rotary axis, or turn the part by hand between programs.",
        Error::SplineOutsideXy => "Select G17 before the line, and move Z and other axes in a separate line.",
        Error::ExpressionsLeftOut | Error::RotationLeftOut | Error::SplinesLeftOut | Error::ScalingLeftOut => {
            "Use a board with more flash, or a post-processor that writes plain moves."
        }
        Error::ToolChangeNeedsHoming => "Enable homing ($22=1), home with $H, and send the line again.",
        Error::ToolSetterNotSetUp => {
            "Jog to the position for tool changes and send G30.1; store the position of the tool setter with G10 L20 P9 X0 Y0; check $342 to $344."
        }
        Error::ToolChangeNotAlone => "Write T and M6 on one line, and G43, G49 or the move on the next.",
        Error::NoSuchPin => {
            "Remove the line, or use a number that the board has: P0 and P1 on a Nucleo. A Black Pill has none, and no board has analog outputs."
        }
        Error::BlendingLeftOut => "Write G64 without P, or use a board with more flash.",
        Error::NoParallelAxes => "Choose a post-processor for machines with the axes X, Y and Z.",
        Error::ReadOnlyParameter => "Use a parameter of your own, such as #100.",
        Error::DamagedLine => {
            "The sender should send the line again. If it knows nothing of line checks, turn them off with $LC=OFF."
        }
        Error::OutOfPlace => {
            "Write subprograms behind M30, each as O1001 .. M99 in the same file. For the next program send `%` or `$X` first, or \
             reset the machine."
        }
        Error::EndlessLoop => "Look for a condition that never becomes false, or a missing change of its parameter.",
    }
}

/// Returns the advice for an alarm: what the user can do, in whole sentences.
pub fn for_alarm(alarm: Alarm) -> &'static str {
    match alarm {
        Alarm::HardLimit => {
            "Reset, find out which switch has tripped ($PINS), unlock with $X, move away from it, and home."
        }
        Alarm::SoftLimit => {
            "Compare the job's size and the work zero with the travel ($130 to $132); then reset, and $X."
        }
        Alarm::AbortInMotion => {
            "Home, or set the work zero again: the position may be lost. Hold before a reset keeps it."
        }
        Alarm::ProbeInitialState => {
            "Move the probe away from the contact before the cycle, or invert its input with $6."
        }
        Alarm::ProbeNoContact => "Start closer to the plate, or probe further; check the wire of the plate.",
        Alarm::HomingReset => "Home again.",
        Alarm::HomingDoor => "Close the door and home again.",
        Alarm::HomingPullOff => "Increase the pull-off ($27), and check that the switch opens.",
        Alarm::HomingNoSwitch => "Check direction ($23), travel ($130 to $132) and the switches ($PINS).",
        Alarm::HomingSquaring => {
            "Check both switches of the axis with two motors, and how far it may be out of square ($347 to $349)."
        }
        Alarm::SpindleSpeed => "Check the spindle and its at-speed signal ($915), or allow more time ($916).",
        Alarm::Underrun => "Home, and please report this: the controller should have stopped the machine in time.",
        Alarm::EmergencyStop => "Make the machine safe, release the stop, reset, and home.",
        Alarm::DriverFault => "Find out why the motor driver reports a fault, turn it off and on, reset, and home.",
        Alarm::Miscounted => "Home, and please report this: the chip counted one step pulse too few or too many.",
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use oxmill_controller::gcode::{Action, Dialect, Interpreter};

    #[test]
    fn words_that_are_refused_have_something_to_write_instead() {
        for (refused, advice) in INSTEAD {
            assert!(advice.ends_with('.') && !advice.contains("  "), "{advice}");
            for word in refused {
                let line = format!("{word} X1 I1");
                let mut checked = Action::NOTHING;
                let checked = Interpreter::<3>::default().check_into(
                    line.replace(' ', "").as_bytes(),
                    Dialect::Oxmill,
                    &mut checked,
                );
                let code = checked.expect_err(word).code();
                assert_eq!(for_line(code, &line), advice, "{word}");
            }
        }
        assert!(for_line(121, "n10 (G33) m098p1000 ; G31").contains("subprograms"));
        assert!(for_line(121, "G00 g84.0X1").contains("G81"));
        for line in ["G0 X1 A0.", "g1 a-5", "A[#1]"] {
            assert_eq!(for_line(20, line), WORD_OF_A, "{line}");
        }
        for (code, line) in [
            (20, "X[ABS[#<a1>]]"),
            (20, "(A0) D1"),
            (149, "A0"),
            (20, "G0 X84"),
            (20, "(G84) D1"),
            (36, "G84 X1"),
            (22, "M98"),
            (121, "@5"),
            (20, ""),
        ] {
            assert_eq!(for_line(code, line), for_code(code), "{line}");
        }
    }

    /// General advice is left out if the sentence of the controller says what to write. Advice for a word stays.
    #[test]
    fn a_sentence_that_says_what_to_write_needs_no_general_advice() {
        for sentence in [
            "#<DEPTH> is not set above this line: set it, or correct the name",
            "Q is missing in G83: the depth of each peck in program units, above 0, such as Q2",
            "the radius of G2 is 4.000 mm at its start, 6.000 at its end. Write I5.000 J0.000",
        ] {
            assert_eq!(beside(sentence, 33, "G2 X10 I4"), "", "{sentence}");
        }
        for sentence in
            ["R1 lies below Z5, the bottom of the hole", "X: used by nothing", "a value, settings of which end here"]
        {
            assert_eq!(beside(sentence, 33, "G2 X10 I4"), for_code(33), "{sentence}");
        }
        assert!(beside("G84 is not supported: choose another word", 121, "G84 X1").contains("G81"));
    }

    #[test]
    fn words_are_counted_outside_of_comments_and_functions() {
        assert_eq!(count("N1 (X2) G1 X1 x[2] X#<X> F5 ; X3", 'X'), 3);
        assert_eq!(count("(F5) FUP[2] G1 X1", 'F'), 0);
        assert_eq!(count("G1 F.5", 'F'), 1);
    }

    #[test]
    fn every_error_and_every_alarm_has_a_sentence() {
        for error in Error::ALL {
            let advice = for_code(error.code());
            assert!(advice.ends_with('.') && advice.len() > 15, "{error:?}: {advice}");
        }
        assert_eq!(for_code(255), "");
        assert!(Error::ALL.is_sorted_by_key(|error| error.code()) && Alarm::ALL.is_sorted_by_key(|alarm| alarm.code()));
        for alarm in Alarm::ALL {
            assert!(for_alarm(*alarm).ends_with('.'), "{alarm:?}");
        }
    }
}
