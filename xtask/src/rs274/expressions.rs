//! Random expressions of RS274NGC that have the same value in both interpreters.
//!
//! The value of `FIX`, `MOD`, `ROUND` and of comparisons jumps at some arguments. Rounding must not decide on which
//! side of a jump an argument lies: LinuxCNC computes with binary numbers, in which `0.29 * 100` is below 29. So the
//! expressions follow these rules:
//!
//! * A number is an integer, a half, or has five random decimals, of which the last is odd. Sums and products of such
//!   numbers do not fall on a jump by chance.
//! * An angle is never an integer. Sine, cosine and tangent of some integers are exactly 0, 0.5 or 1, and LinuxCNC's
//!   result can be slightly different.
//! * The `y` of `ATAN` is never 0. Binary numbers have a -0, for which `ATAN` returns -180 instead of 180 degrees.
//! * Arguments are within the range of their function.
//! * Powers and exponents are small. Only Oxmill rejects a result that is too large, and large binary numbers have no
//!   digits after the point.

use oxmill_test_support::Random;

/// Parameters that every program sets to numbers.
pub const NUMBERED: [&str; 10] = ["#1", "#2", "#3", "#4", "#5", "#31", "#32", "#33", "#34", "#35"];
/// Named parameters that every program and every call sets; the last two are global.
pub const NAMED: [&str; 4] = ["#<u>", "#<v>", "#<_g>", "#<_h k>"];
/// A parameter whose value is the number of another parameter.
pub const POINTER: &str = "#40";

/// Parameters that show the machine's state and do not depend on the unit of time. Stored positions, from #5161 on, are
/// excluded: they are in the unit of the machine, which is the inch in `rs274`. `#<_rpm>` is excluded, too, because it
/// has seven digits in Oxmill.
const SHOWN: [&str; 9] =
    ["#5420", "#5421", "#5422", "#5220", "#<_x>", "#<_y>", "#<_z>", "#<_metric>", "#<_call_level>"];

/// Returns a positive number of the size of a typical tool movement.
pub fn plain(random: &mut Random) -> String {
    format!("{}.{:04}{}", random.below(30), random.below(10_000), 1 + 2 * random.below(5))
}

fn number(random: &mut Random) -> String {
    match random.below(12) {
        0..=4 => format!("{}.{:04}{}", random.below(10), random.below(10_000), 1 + 2 * random.below(5)),
        5 => format!(".{:04}{}", random.below(10_000), 1 + 2 * random.below(5)),
        6..=7 => format!("{}", random.below(10)),
        8 => format!("{}.5", random.below(10)),
        9 => format!("+0{}.", random.below(10)),
        _ => format!("-{}.{:04}{}", random.below(10), random.below(10_000), 1 + 2 * random.below(5)),
    }
}

fn parameter(random: &mut Random) -> String {
    match random.below(20) {
        0..=7 => random.of(&NUMBERED).into(),
        8..=12 => random.of(&NAMED).into(),
        13 => format!("#{POINTER}"),
        14 => format!("#[{POINTER}]"),
        15 => format!("#[{}{}]", 30 + random.below(3), random.of(&["+1", " + 2", "*1", "+3-1"])),
        _ => random.of(&SHOWN).into(),
    }
}

/// Returns an operand: a number, a parameter, a bracket or a function, some of them with a sign.
fn operand(random: &mut Random, depth: u32) -> String {
    let sign = random.of(&["", "", "", "", "-", "+"]);
    match random.below(if depth == 0 { 6 } else { 12 }) {
        0..=2 => number(random),
        3..=5 => format!("{sign}{}", parameter(random)),
        6..=8 => format!("{sign}[{}]", chain(random, depth - 1)),
        _ => format!("{sign}{}", function(random, depth - 1)),
    }
}

fn function(random: &mut Random, depth: u32) -> String {
    let inner = chain(random, depth);
    match random.below(24) {
        0..=1 => format!("ABS[{inner}]"),
        2..=3 => format!("FIX[{inner}]"),
        4..=5 => format!("FUP[{inner}]"),
        6..=7 => format!("ROUND[{inner}]"),
        8..=9 => format!("SIN[{inner} + 0.01357]"),
        10..=11 => format!("cos[{inner} - 0.02461]"),
        12..=13 => format!("TAN[[{inner}] MOD 67 + 0.01357]"),
        14 => format!("ASIN[0.71213 * SIN[{inner} + 0.01357]]"),
        15 => format!("ACOS[0.71213 * COS[{inner} + 0.01357]]"),
        16..=17 => format!("SQRT[ABS[{inner}] + 0.13571]"),
        18 => format!("LN[ABS[{inner}] + 0.13571]"),
        19 => format!("EXP[[{inner}] MOD 3]"),
        20..=22 => format!("ATAN[ABS[{inner}] + 0.13571]/[{}]", operand(random, 0)),
        _ => format!("EXISTS[{}]", random.of(&["#<u>", "#<_h k>", "#<nobody>", "#<_no body>"])),
    }
}

/// Returns an expression without the brackets around it: operands with operators between them, nested at most `depth`
/// deep.
pub fn chain(random: &mut Random, depth: u32) -> String {
    let mut text = operand(random, depth);
    for _ in 0..random.below(4) {
        match random.below(20) {
            0..=3 => text += &format!(" + {}", operand(random, depth)),
            4..=6 => text += &format!("-{}", operand(random, depth)),
            7..=8 => text += &format!(" * {}", number(random)),
            9 => text += &format!(" * -[{} MOD 3.71317]", parameter(random)),
            10..=11 => text += &format!(" / [ABS[{}] + 0.71213]", operand(random, depth)),
            12..=13 => text += &format!(" MOD [ABS[{}] + 1.37131]", operand(random, depth)),
            14 => text += &format!(" MOD {}", 1 + random.below(9)),
            15 => {
                let exponents = ["2", "0.5", "-1", "-0.73137", "1.37131", "2**0.5", "0"];
                text += &format!(" + [ABS[{}] + 0.31713]**{}", operand(random, depth), random.of(&exponents));
            }
            16 => {
                text += &format!(" + -{}**{}", number(random).replace(['-', '+'], ""), random.of(&["2", "3", "2**2"]))
            }
            17..=18 => {
                let word = random.of(&[" EQ ", " NE ", "GT", " ge ", "LT", " LE "]);
                text += &format!("{word}{}", operand(random, depth));
            }
            _ => text += &format!("{}{}", random.of(&[" AND ", " OR ", "XOR"]), operand(random, depth)),
        }
    }
    text
}

/// Returns a value from -20 to 20: 20 times the sine or cosine of any expression. A fraction is added to the
/// expression, because its value can be an integer, and the cosine of an integer can be slightly off in LinuxCNC.
fn bounded(random: &mut Random) -> String {
    format!("[20 * {}[[{}] + 0.01357]]", random.of(&["SIN", "COS"]), chain(random, 1))
}

/// Returns the value of an axis word, a length from -50 to 50. It is not an integer, because `rs274` loses some
/// precision of integers when the unit changes.
pub fn length(random: &mut Random) -> String {
    match random.below(20) {
        0..=7 => plain(random),
        8..=9 => format!("-{}", plain(random)),
        10..=12 => format!("[{} - {}]", plain(random), plain(random)),
        13 => format!("-[{} / {}]", plain(random), 1 + random.below(9)),
        14..=16 => format!("[{} MOD 31.71317 - 9.00713]", parameter(random)),
        _ => bounded(random),
    }
}

/// Returns the right-hand side of an assignment to a parameter.
pub fn value(random: &mut Random) -> String {
    match random.below(20) {
        0..=6 => bounded(random),
        7..=8 => number(random),
        9 => format!("[{}]", random.below(20)),
        10 => format!("[[{}] MOD 13.71317]", chain(random, 2)),
        11 => format!("FIX[10 * SIN[{} + 0.01357]]", chain(random, 1)),
        // `FIX` truncates the value to millionths, because a loop would amplify rounding errors. `ROUND` is not used,
        // because LinuxCNC limits it to 2^31.
        _ => format!("[FIX[[{}] * 1000000 + 0.31713] / 1000000 MOD 913.31713 - {}]", chain(random, 2), plain(random)),
    }
}

/// Returns a condition in brackets, as `if`, `elseif` and `while` need it.
pub fn condition(random: &mut Random) -> String {
    match random.below(10) {
        0 => format!("[{}]", random.below(2)),
        1..=3 => {
            let word = random.of(&["GT", "LT", "GE", "LE", "EQ", "NE"]);
            format!("[{} {word} {}]", parameter(random), number(random))
        }
        4 => format!("[[{}] AND [{}]]", chain(random, 1), chain(random, 1)),
        _ => format!("[{}]", chain(random, 1)),
    }
}
