//! Checks `docs/gcode.md`. Its table must have each word that the firmware accepts. Its list of rejected words must
//! have each word that the firmware rejects as not supported (error:121) or as cutter compensation.

use crate::{keep, read, root, with_table};
use oxmill_controller::error::Error;
use oxmill_controller::gcode::{Dialect, Group, group_of};
use oxmill_controller::units::{DECIMAL_ONE, Decimal};
use oxmill_simulator::{Options, Simulator};
use std::collections::{BTreeMap, BTreeSet};
use std::fmt::Write;

/// Words of each row, with their meaning. The firmware gives their groups and dialects.
const MEANINGS: &[(&str, &str)] = &[
    ("G0", "rapid"),
    ("G1", "line at the feed F"),
    ("G2 G3", "arc clockwise, counter-clockwise: centre by I, J, K, or radius by R; turns by P (not *grbl*)"),
    ("G5", "[spline](#splines) of third degree: control points by I, J and P, Q"),
    ("G5.1", "[spline](#splines) of second degree: control point by I, J"),
    ("G5.2 G5.3", "[control points](#control-points) of a curve, a line each; their end: along the curve"),
    ("G38.2 G38.3", "probe towards a contact, with and without an alarm if there is none"),
    ("G38.4 G38.5", "probe away from a contact, with and without an alarm if it stays closed"),
    ("G12 G13", "circle round the tool, clockwise or counter-clockwise ([habits](#habits-of-cam-programs))"),
    ("G31", "probe as G38.3, in its line only ([habits](#habits-of-cam-programs))"),
    ("G73 G81 G82 G83 G85 G86 G88 G89", "[canned cycles](#canned-cycles)"),
    ("G80", "no motion, ends a cycle"),
    ("G4", "dwell of P seconds"),
    ("G10", "offsets: L2 and L20 of coordinate systems; L1, L10 and L11 of [tools](#tools) (not *grbl*)"),
    ("G28 G30", "rapid to the first, second stored place, by way of a point"),
    ("G28.1 G30.1", "stores the place where the machine is"),
    ("G52", "local offset ([coordinates](#coordinates))"),
    ("G53", "this line's target is a place of the machine"),
    ("G92", "the tool's place has these coordinates"),
    ("G92.1", "takes the offset of G92 away"),
    ("G92.2 G92.3", "suspends, restores the offset of G92"),
    ("G17 G18 G19", "plane XY, ZX, YZ"),
    ("G20 G21", "inches, millimetres"),
    ("G70 G71", "inches, millimetres ([habits](#habits-of-cam-programs))"),
    ("G40", "no cutter compensation, which is so in any case"),
    ("G43 G43.2", "tool offset of the table, added to what is active ([tools](#tools))"),
    ("G43.1 G49", "tool offset by value, none"),
    ("G50", "no scaling"),
    ("G51", "[scaling](#scaling) about a point"),
    ("G54 G55 G56 G57 G58 G59", "coordinate system 1 to 6"),
    ("G59.1 G59.2 G59.3", "coordinate system 7 to 9"),
    ("G54.1 G154", "coordinate system 7 to 9 by P ([habits](#habits-of-cam-programs))"),
    ("G61", "exact path"),
    (
        "G61.1 G64",
        "rest at the end of each line ([state](#state-and-flow)); exact path again, or within P ([path tolerance](#path-tolerance))",
    ),
    ("G68 G69", "[rotation](#rotation) about a point, none"),
    ("G90 G91", "coordinates, distances"),
    ("G90.1", "centres of arcs are coordinates"),
    ("G91.1", "centres of arcs are distances from the start"),
    ("G93 G94", "F is 1 / minutes of the move, or mm/min (inch/min)"),
    ("G95", "F is mm (inches) per revolution at the programmed S ([habits](#habits-of-cam-programs))"),
    ("G15", "no polar coordinates, which is so in any case ([habits](#habits-of-cam-programs))"),
    ("G67", "no call behind each move (G66; [subprograms](#subprograms))"),
    ("G97", "S is in revolutions per minute, which is so in any case"),
    ("M29", "rigid tapping: does nothing ([habits](#habits-of-cam-programs))"),
    ("G8 G103 G187", "look-ahead: does nothing ([habits](#habits-of-cam-programs))"),
    ("G98 G99", "cycles retract to where they began, to R"),
    ("M0", "pause until `~`"),
    ("M1", "the same if `$919=1`"),
    ("M2 M30", "end of the program"),
    ("M60", "as M0"),
    ("M3 M4 M5", "spindle clockwise, counter-clockwise, off"),
    ("M6", "tool change ([tools](#tools))"),
    ("M61", "the tool in the spindle has number Q ([tools](#tools))"),
    ("M62 M63 M64 M65 M66 M67 M68", "[outputs and inputs](#outputs-and-inputs) of programs"),
    ("M7", "mist"),
    ("M8 M9", "flood; coolant off"),
    ("M48 M49 M50 M51 M52 M53", "which overrides act ([state](#state-and-flow))"),
    ("M56", "parking override, P0 or P1"),
    (
        "M70 M71 M72 M73",
        "keep, forget, restore the state, keep it until the subroutine ends ([state](#state-and-flow))",
    ),
];

/// Letters of values, with their use.
const LETTERS: &[(&str, &str)] = &[
    ("D", "register of a radius, which nothing uses"),
    ("E", "analog output or input"),
    ("F", "feed"),
    ("H", "tool of G43"),
    ("I J K", "centre of an arc, first control point of a spline, factors of G51"),
    ("L", "kind of G10, repeats of a cycle, what M66 waits for"),
    ("N", "line number, told as `Ln:`; target of [GOTO](#subprograms)"),
    ("O", "[O words](expressions.md#o-words), number of a program"),
    (
        "P",
        "seconds, turns, tool, system, output or input, path tolerance, factor of G51; with Q the last control point of a spline; on other M words 0 or 1",
    ),
    ("Q", "peck, tolerance of merging, control point of a spline, seconds of M66, tool of M61"),
    ("R", "radius, plane of a cycle, angle"),
    ("S", "spindle speed, power of a laser"),
    ("T", "tool"),
    ("X Y Z", "target"),
];

const DIALECTS: [(Dialect, &str); 3] = [(Dialect::Grbl, "grbl"), (Dialect::Oxmill, "oxmill"), (Dialect::Seed, "seed")];

/// Formats a word: `G38.2` for the letter G and 3,820 hundredths.
fn written(letter: char, hundredths: u16) -> String {
    match (hundredths / 100, hundredths % 100) {
        (whole, 0) => format!("{letter}{whole}"),
        (whole, rest) if rest.is_multiple_of(10) => format!("{letter}{whole}.{}", rest / 10),
        (whole, rest) => format!("{letter}{whole}.{rest:02}"),
    }
}

/// Asks the firmware for the group of each G and M word from 0 to 255.99. Returns each word with its group, or with the
/// firmware's error.
fn asked(dialect: Dialect) -> impl Iterator<Item = (String, Result<Group, Error>)> {
    let all = ['G', 'M'].into_iter().flat_map(|letter| (0..25_600_u16).map(move |hundredths| (letter, hundredths)));
    all.map(move |(letter, hundredths)| {
        let number = Decimal(i64::from(hundredths) * (DECIMAL_ONE / 100));
        (written(letter, hundredths), group_of(letter as u8, number, dialect))
    })
}

/// Returns each word that any dialect has, with its group and its dialects.
fn words() -> BTreeMap<String, (String, Vec<&'static str>)> {
    let mut found: BTreeMap<String, (String, Vec<&str>)> = BTreeMap::new();
    for (dialect, name) in DIALECTS {
        for (word, group) in asked(dialect) {
            if let Ok(group) = group {
                let (its_group, its_dialects) = found.entry(word).or_default();
                *its_group = spaced(&format!("{group:?}"));
                its_dialects.push(name);
            }
        }
    }
    found
}

/// Formats `CoordinateSystem` as `coordinate system`.
fn spaced(name: &str) -> String {
    let parts = name.chars().flat_map(|c| c.is_uppercase().then_some(' ').into_iter().chain(c.to_lowercase()));
    parts.collect::<String>().trim().to_owned()
}

fn names(dialects: &[&str]) -> String {
    if dialects.len() == DIALECTS.len() { "all".into() } else { dialects.join(", ") }
}

/// Returns the table of the G and M words that the firmware accepts. Panics if [`MEANINGS`] lacks one of them or has
/// another word.
fn table() -> String {
    let mut words = words();
    let mut table = "| word | dialects | group | meaning |\n|---|---|---|---|\n".to_owned();
    for (row, meaning) in MEANINGS {
        let of: Vec<(String, Vec<&str>)> = row
            .split(' ')
            .map(|word| words.remove(word).unwrap_or_else(|| panic!("the firmware has no {word}")))
            .collect();
        let (group, dialects) = &of[0];
        assert!(of.iter().all(|other| other == &of[0]), "{row}: {of:?}");
        let _ = writeln!(table, "| `{row}` | {} | {group} | {meaning} |", names(dialects));
    }
    assert!(words.is_empty(), "words without a meaning in tests/book/words.rs: {words:?}");
    table
}

/// Returns the dialects that accept this letter with a value.
fn dialects_of_letter(letter: char) -> Vec<&'static str> {
    let mut found = Vec::new();
    for (number, (_, name)) in DIALECTS.into_iter().enumerate() {
        let mut mill = Simulator::new(Options::default());
        mill.send(format!("$900={number}\nG1 F100\n"));
        mill.run_until_idle();
        mill.take_output();
        mill.send(format!("{letter}1\n"));
        mill.run_until_idle();
        let output = mill.take_output();
        let unknown = [Error::UnsupportedCommand, Error::NoParallelAxes];
        if !unknown.iter().any(|error| output.contains(&format!("error:{}", error.code()))) {
            found.push(name);
        }
    }
    found
}

/// Returns the table of the letters, other than G and M, that the firmware accepts with a value. Panics if [`LETTERS`]
/// lacks one of them or has another letter.
fn letters() -> String {
    let mut known: BTreeMap<String, Vec<&str>> = ('A'..='Z')
        .filter(|letter| !"GM".contains(*letter))
        .map(|letter| (letter.to_string(), dialects_of_letter(letter)))
        .filter(|(_, dialects)| !dialects.is_empty())
        .collect();
    let mut table = "| letter | dialects | what for |\n|---|---|---|\n".to_owned();
    for (row, meaning) in LETTERS {
        let of: Vec<Vec<&str>> =
            row.split(' ').map(|letter| known.remove(letter).unwrap_or_else(|| panic!("no letter {letter}"))).collect();
        assert!(of.iter().all(|other| other == &of[0]), "{row}: {of:?}");
        let _ = writeln!(table, "| `{row}` | {} | {meaning} |", names(&of[0]));
    }
    assert!(known.is_empty(), "letters without a meaning in tests/book/words.rs: {known:?}");
    table
}

#[test]
fn the_page_of_words_has_those_of_the_firmware() {
    let (table, letters) = (table(), letters());
    keep(&root().join("docs/gcode.md"), |text| with_table(&with_table(text, "words", &table), "letters", &letters));
}

/// Returns the words that the page lists for an error in its section of unsupported words.
fn refused_on_the_page(text: &str, error: Error) -> BTreeSet<String> {
    let section = text.split("## Not supported").nth(1).expect("a section");
    let list = section.split(&format!("`error:{}` for `", error.code())).nth(1).expect("a list").split('`').next();
    let words: Vec<&str> = list.unwrap_or_default().split_whitespace().collect();
    // The page also lists `M52 P1` and `M53 P0`: these M words are rejected only with this value. Drop the P words.
    words
        .windows(2)
        .map(|pair| pair[0])
        .chain(words.last().copied())
        .filter(|w| !w.starts_with('P'))
        .map(str::to_owned)
        .collect()
}

/// Returns the words without their fractions: G38 for G38.2.
fn wholes(words: impl Iterator<Item = String>) -> BTreeSet<String> {
    words.map(|word| word.split('.').next().unwrap_or_default().to_owned()).collect()
}

#[test]
fn what_the_page_says_is_refused_is_what_the_firmware_refuses() {
    let page = read(&root().join("docs/gcode.md"));
    let refused =
        |error: Error| asked(Dialect::Oxmill).filter(move |(_, said)| *said == Err(error)).map(|(word, _)| word);
    assert_eq!(refused_on_the_page(&page, Error::CutterCompensation), refused(Error::CutterCompensation).collect());
    let mut named = refused_on_the_page(&page, Error::NotSupported);
    for known in ["M52", "M53"] {
        assert!(named.remove(known), "{known}");
    }
    let mut every: BTreeSet<String> = refused(Error::NotSupported).collect();
    // `group_of` rejects the words of subprograms. The firmware accepts them in lines that call or end a subprogram.
    every.retain(|word| !["G65", "G66", "M98", "M99"].iter().any(|known| word.starts_with(known)));
    for word in &named {
        assert!(every.contains(word), "the firmware does not refuse {word} by error:121");
    }
    assert_eq!(wholes(named.into_iter()), wholes(every.into_iter()));
}
