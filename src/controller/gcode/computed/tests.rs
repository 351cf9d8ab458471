//! Tests expressions against an independent evaluation in `f64`.

use super::expression::{self, ParameterReference};
use super::flow::KEYWORDS;
use super::real::Real;
use crate::error::Error;
use proptest::prelude::*;

fn no_parameters(_: ParameterReference) -> Result<Option<Real>, Error> {
    Ok(None)
}

fn compute(text: &str) -> Result<Real, Error> {
    let (value, used) = expression::value(text.as_bytes(), no_parameters)?;
    assert_eq!(used, text.len(), "{text}");
    Ok(value)
}

fn f64_of(value: Real) -> f64 {
    let (mantissa, exponent) = value.parts();
    // The standard library reads the text as the nearest `f64`.
    format!("{mantissa}e{exponent}").parse().unwrap()
}

fn number(text: &str) -> Real {
    let (value, used) = Real::read(text.as_bytes()).unwrap();
    assert_eq!(used, text.len());
    value
}

/// Asserts that the value of a text equals a number in all its digits.
#[track_caller]
fn exact(text: &str, expected: &str) {
    let wanted = match expected.strip_prefix('-') {
        Some(size) => number(size).neg(),
        None => number(expected),
    };
    assert_eq!(compute(text), Ok(wanted), "{text}");
}

#[test]
fn decimals_are_exact() {
    for (text, value) in [
        ("[10.1+0.2]", "10.3"),
        ("[0.1*3]", "0.3"),
        ("[1.1-1]", "0.1"),
        ("[25.4*0.0005]", "0.0127"),
        ("[1/8]", "0.125"),
        ("[10/2.5]", "4"),
        ("[123456789.123456789*10]", "1234567891.23456789"),
        ("[2**10]", "1024"),
        ("[1.5**2]", "2.25"),
        ("[2**-2]", "0.25"),
        ("SQRT[2.25]", "1.5"),
        ("SQRT[90000]", "300"),
        ("SIN[30]", "0.5"),
        ("COS[60]", "0.5"),
        ("COS[90]", "0"),
        ("SIN[-90]", "-1"),
        ("SIN[3600030]", "0.5"),
        ("TAN[45]", "1"),
        ("ATAN[1]/[1]", "45"),
        ("ATAN[-1]/[-1]", "-135"),
        ("ATAN[0]/[-1]", "180"),
        ("ATAN[0]/[0]", "0"),
        ("ACOS[0.5]", "60"),
        ("ASIN[-1]", "-90"),
        ("EXP[0]", "1"),
        ("LN[1]", "0"),
        ("[4**0.5]", "2"),
        ("[1/3]", "0.333333333333333333"),
        ("[2/3]", "0.666666666666666667"),
    ] {
        exact(text, value);
    }
}

/// Although quotients are rounded, comparisons and whole parts treat `1/3*3` as 1.
#[test]
fn parts_of_a_whole_make_the_whole() {
    for (text, value) in [
        ("[1/3+1/3+1/3LT1]", "0"),
        ("[1/3+1/3+1/3GE1]", "1"),
        ("[10/3*3GT10]", "0"),
        ("[20/3+10/3LT10]", "0"),
        ("[1/3*3-1]", "0"),
        ("FIX[1/3*3]", "1"),
        ("FUP[2/3*3]", "2"),
        ("FIX[0-1/3*3]", "-1"),
        ("[[1/3*3]MOD1]", "0"),
        ("[[2/3*3]MOD1]", "0"),
        ("[10MOD[10/3]]", "0"),
        ("SQRT[25-[5/3+5/3+5/3]*5]", "0"),
        ("[1000000.0000001-1000000]", "0.0000001"),
        ("[0.00000000000000000001GT0]", "1"),
        ("FIX[2.9999999999]", "2"),
        ("[2.9999999999LT3]", "1"),
        ("[7.9999999999MOD4]", "3.9999999999"),
    ] {
        exact(text, value);
    }
    for (depth, passes) in (1..=30).flat_map(|depth| (2..=12).map(move |passes| (depth, passes))) {
        let step = compute(&format!("[{depth}/{passes}]")).unwrap();
        let end = number(&depth.to_string());
        let (mut reached, mut count) = (Real::ZERO, 0);
        while reached.is_below(end) {
            reached = reached.add(step).unwrap();
            count += 1;
        }
        assert_eq!(count, passes, "{depth} in {passes} passes");
    }
}

/// RS274NGC's order of operators. LinuxCNC's interpreter gives the same values.
#[test]
fn order_of_operators() {
    for (text, value) in [
        ("[2**3**2]", "64"),
        ("[-2**2]", "4"),
        ("[1+2*3**2]", "19"),
        ("[2*3 MOD 4]", "2"),
        ("[10-4-3]", "3"),
        ("[16/4/2]", "2"),
        ("[1 EQ 1+1]", "0"),
        ("[1 AND 0 OR 1]", "1"),
        ("[1 OR 1 AND 0]", "0"),
        ("[1 XOR 1 XOR 1]", "1"),
        ("[1 LT 2 AND 3 GT 2]", "1"),
        ("[5 GT 3 EQ 1]", "1"),
        ("[-5 MOD 3]", "1"),
        ("[-5 MOD -3]", "1"),
        ("[5.5 MOD 2]", "1.5"),
        ("[1 EQ 1.00005]", "1"),
        ("[1 NE 1.0002]", "1"),
        ("[1 LT 1.00005]", "1"),
        ("[1 GE 1.00005]", "0"),
        ("[2 LE 2]", "1"),
        ("FIX[-1.5]", "-2"),
        ("FUP[-1.5]", "-1"),
        ("FIX[2.9]", "2"),
        ("FUP[2.1]", "3"),
        ("ROUND[2.5]", "3"),
        ("ROUND[-2.5]", "-3"),
        ("ABS[-[3-5]*2]", "4"),
        ("-[2]", "-2"),
        ("+-+5", "-5"),
        ("[3--2]", "5"),
        ("[[[1]]]", "1"),
        ("[+1]", "1"),
        ("SQRT[[3*3]+4*4]", "5"),
    ] {
        exact(&text.replace(' ', ""), value);
    }
}

#[test]
fn errors() {
    for (text, error) in [
        ("[1/0]", Error::DivisionByZero),
        ("[1MOD0]", Error::DivisionByZero),
        ("[0**-1]", Error::DivisionByZero),
        ("[0**-0.5]", Error::DivisionByZero),
        ("SQRT[-1]", Error::ArgumentOutOfRange),
        ("LN[0]", Error::ArgumentOutOfRange),
        ("ASIN[1.1]", Error::ArgumentOutOfRange),
        ("ACOS[-1.1]", Error::ArgumentOutOfRange),
        ("TAN[90]", Error::ArgumentOutOfRange),
        ("[-2**0.5]", Error::ArgumentOutOfRange),
        ("EXP[200]", Error::InvalidResult),
        ("[10**60]", Error::InvalidResult),
        // 0.1**200 underflows to 0, and its reciprocal is out of range.
        ("[0.1**-200]", Error::InvalidResult),
        ("[", Error::ExpressionSyntax),
        ("[]", Error::ExpressionSyntax),
        ("[1", Error::ExpressionSyntax),
        ("[1+]", Error::ExpressionSyntax),
        ("[*1]", Error::ExpressionSyntax),
        ("[1 2", Error::ExpressionSyntax),
        ("[1.2.3]", Error::ExpressionSyntax),
        ("ATAN[1]", Error::ExpressionSyntax),
        ("ATAN[1]/2", Error::ExpressionSyntax),
        ("[1ADD2]", Error::UnknownOperation),
        ("[FOO[1]]", Error::UnknownOperation),
        ("[SIN30]", Error::UnknownOperation),
        ("#0", Error::InvalidArgument),
        ("#1.5", Error::InvalidArgument),
        ("#<a", Error::ExpressionSyntax),
        ("#<>", Error::ExpressionSyntax),
        ("#<nothing>", Error::InvalidArgument),
        ("EXISTS[1]", Error::UnknownOperation),
        ("EXISTS[#<a>", Error::ExpressionSyntax),
        ("#", Error::ExpressionSyntax),
    ] {
        let lookup = |reference: ParameterReference| match reference {
            ParameterReference::Number(0) => Err(Error::InvalidArgument),
            _ => Ok(None),
        };
        let text = text.replace(' ', "");
        assert_eq!(expression::value(text.as_bytes(), lookup).err(), Some(error), "{text}");
    }
}

#[test]
fn depth_is_bounded() {
    let nested = |depth: usize| format!("{}1{}", "[".repeat(depth), "]".repeat(depth));
    assert_eq!(compute(&nested(32)), Ok(Real::ONE));
    assert_eq!(compute(&nested(33)), Err(Error::TooDeep));
    assert_eq!(compute(&("-".repeat(33) + "1")), Err(Error::TooDeep));
    // A left operand waits only until the next operator has been read. So a sum of a hundred terms does not fill the
    // waiting list.
    assert_eq!(compute(&format!("[1{}]", "+1".repeat(100))), Ok(number("101")));
}

#[test]
fn numbers_of_programs() {
    for (text, value, places) in [("10.1", 101_000_000, 1), ("0.12345678", 1_234_568, 7), ("1000", 10_000_000_000, 0)] {
        let read = number(text);
        assert_eq!((read.to_decimal().0, read.places()), (value, places), "{text}");
    }
    assert_eq!(number("99999999999999999999").neg().to_decimal().0, -i64::MAX);
    assert_eq!(number("0.00000000000000000000001").to_decimal().0, 0);
    assert_eq!(Real::read(b"."), None);
    assert_eq!(Real::read(b"-1"), None);
}

/// An expression as a tree, which can also be evaluated in `f64`.
#[derive(Clone, Debug)]
enum Tree {
    Number(i64, u32),
    Negative(Box<Tree>),
    Binary(&'static str, Box<Tree>, Box<Tree>),
    Function(&'static str, Box<Tree>),
    Atan(Box<Tree>, Box<Tree>),
}

/// A value and its maximum error: the sum of what all operations so far can have added by rounding.
#[derive(Clone, Copy, Debug)]
struct Estimate {
    value: f64,
    error: f64,
}

const ROUNDING: f64 = 2e-15;

impl Estimate {
    /// Returns `None` if the result is not a number, or if its error is too large for a comparison.
    fn new(value: f64, error: f64) -> Option<Estimate> {
        let error = error + ROUNDING * value.abs();
        // `Real` turns values far below this range into 0, and values far above it are an error.
        let in_range = value == 0.0 || (1e-25..1e30).contains(&value.abs());
        (in_range && error < 1e-3 * value.abs().max(1e-6)).then_some(Estimate { value, error })
    }
}

impl Tree {
    fn text(&self) -> String {
        match self {
            Tree::Number(digits, places) => {
                let one = 10_i64.pow(*places);
                format!("{}.{:0width$}", digits / one, digits % one, width = *places as usize)
            }
            Tree::Negative(of) => format!("-{}", of.text()),
            Tree::Binary(operator, a, b) => format!("[{}{operator}{}]", a.text(), b.text()),
            Tree::Function(name, of) => format!("{name}[{}]", of.text()),
            Tree::Atan(y, x) => format!("ATAN[{}]/[{}]", y.text(), x.text()),
        }
    }

    fn estimate(&self) -> Option<Estimate> {
        match self {
            Tree::Number(digits, places) => Estimate::new(*digits as f64 / 10_f64.powi(*places as i32), 0.0),
            Tree::Negative(of) => {
                let of = of.estimate()?;
                Some(Estimate { value: -of.value, ..of })
            }
            Tree::Binary(operator, a, b) => {
                let (a, b) = (a.estimate()?, b.estimate()?);
                match *operator {
                    "+" => Estimate::new(a.value + b.value, a.error + b.error),
                    "-" => Estimate::new(a.value - b.value, a.error + b.error),
                    "*" => Estimate::new(a.value * b.value, a.error * b.value.abs() + b.error * a.value.abs()),
                    "/" => {
                        let value = a.value / b.value;
                        Estimate::new(value, (a.error + value.abs() * b.error) / b.value.abs())
                    }
                    // With so large an exponent, only a base of 0 or near 1 gives a result in range. Such powers are
                    // not tested.
                    "**" if b.value.abs() > 1e9 => None,
                    "**" => {
                        let value = a.value.powf(b.value);
                        let relative = (b.value * a.error / a.value).abs() + b.error * a.value.abs().ln().abs();
                        let of_function = 1e-13 + 1e-15 * (b.value * a.value.abs().ln()).abs();
                        Estimate::new(value, value.abs() * (relative + of_function))
                    }
                    _ => unreachable!(),
                }
            }
            Tree::Function(name, of) => {
                let Estimate { value: x, error } = of.estimate()?;
                let radians = x.to_radians();
                let per_degree = 1_f64.to_radians();
                // The maximum error of the angle in radians. The second part is the error of `f64`, which grows with
                // the angle.
                let turned = error * per_degree + radians.abs() * 3e-16;
                // `Real` rounds an angle to a multiple of 90 degrees if the two differ by less than 360 × 10⁻¹⁴
                // degrees. So a result near 0 can be wrong by this difference, in radians.
                let rounding = |value: f64| if value.abs() < 1e-10 { 360e-14 * per_degree } else { ROUNDING };
                match *name {
                    "SIN" => Estimate::new(radians.sin(), turned + rounding(radians.sin())),
                    "COS" => Estimate::new(radians.cos(), turned + rounding(radians.cos())),
                    "TAN" => {
                        let slope = 1.0 + radians.tan().powi(2);
                        Estimate::new(radians.tan(), (turned + rounding(radians.tan())) * slope)
                    }
                    "ASIN" => Estimate::new(x.asin().to_degrees(), error / (1.0 - x * x).sqrt() / per_degree + 1e-13),
                    "ACOS" => Estimate::new(x.acos().to_degrees(), error / (1.0 - x * x).sqrt() / per_degree + 1e-13),
                    "ABS" => Estimate::new(x.abs(), error),
                    "SQRT" => Estimate::new(x.sqrt(), error / (2.0 * x.sqrt())),
                    "LN" => Estimate::new(x.ln(), error / x + ROUNDING),
                    "EXP" => Estimate::new(x.exp(), x.exp() * (error + 1e-13)),
                    _ => unreachable!(),
                }
            }
            Tree::Atan(y, x) => {
                let (y, x) = (y.estimate()?, x.estimate()?);
                // If y is near 0, the result can be near -180 or near 180 degrees. Such a result is not compared.
                if y.value.abs() <= 2.0 * y.error && x.value < 0.0 {
                    return None;
                }
                let size = x.value.hypot(y.value);
                Estimate::new(y.value.atan2(x.value).to_degrees(), (x.error + y.error) / size * 60.0 + 1e-13)
            }
        }
    }
}

fn tree() -> impl Strategy<Value = Tree> {
    let number = prop_oneof![
        3 => (0_i64..100_000, 0_u32..4),
        1 => (0_i64..1_000_000_000_000, 0_u32..10),
    ];
    number.prop_map(|(digits, places)| Tree::Number(digits, places)).prop_recursive(5, 24, 3, |inner| {
        let function = prop::sample::select(vec!["SIN", "COS", "TAN", "ASIN", "ACOS", "ABS", "SQRT", "LN", "EXP"]);
        let operator = prop::sample::select(vec!["+", "-", "*", "/", "**"]);
        prop_oneof![
            1 => inner.clone().prop_map(|of| Tree::Negative(Box::new(of))),
            5 => (operator, inner.clone(), inner.clone())
                .prop_map(|(operator, a, b)| Tree::Binary(operator, Box::new(a), Box::new(b))),
            3 => (function, inner.clone()).prop_map(|(name, of)| Tree::Function(name, Box::new(of))),
            1 => (inner.clone(), inner).prop_map(|(y, x)| Tree::Atan(Box::new(y), Box::new(x))),
        ]
    })
}

/// Random tests have found these cases. Differences were rounded by more than `Estimate` had allowed.
#[test]
fn nearly_no_angle_is_none() {
    exact("[TAN[[SIN[83702]/96956509885]]]", "0");
    exact("[SIN[180.0000000000001]]", "0");
    exact("[COS[90.0000000000001]]", "0");
    exact("[ATAN[COS[40770]]/[-1]]", "180");
}

#[test]
fn too_small_a_result_is_zero() {
    for text in ["[EXP[-95]]", "[EXP[-100]]", "[EXP[-120]]", "[EXP[-121]]", "[10**-50.5]", "[0.1**45.5]"] {
        exact(text, "0");
    }
    for (text, value) in [("[EXP[-73]]", (-73_f64).exp()), ("[10**-31.5]", 10_f64.powf(-31.5))] {
        let ratio = f64_of(compute(text).unwrap()) / value;
        assert!((ratio - 1.0).abs() < 1e-12, "{text}: {ratio}");
    }
}

#[test]
fn too_great_a_result() {
    for text in ["[EXP[94]]", "[10**40*9.99]", "[0-10**40]", "[10**40]"] {
        assert!(compute(text).is_ok(), "{text}");
    }
    for text in ["[EXP[95]]", "[EXP[100]]", "[10**41]", "[0-10**41]", "[10**40*10]", "[11**40]", "[1.23456789**600]"] {
        assert_eq!(compute(text), Err(Error::InvalidResult), "{text}");
    }
}

/// The two lists of keywords are equal: `O_WORDS` examines lines after the end of a program, `KEYWORDS` executes lines.
#[test]
fn keywords_are_the_o_words() {
    assert_eq!(KEYWORDS.map(|(name, _)| name), crate::gcode::program_number::O_WORDS);
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(4000))]

    #[test]
    fn as_f64_computes(tree in tree()) {
        if let Some(Estimate { value, error }) = tree.estimate() {
            let text = tree.text();
            let computed = compute(&text);
            prop_assert!(computed.is_ok(), "{text} is {value}: {computed:?}");
            let off = (f64_of(computed.unwrap()) - value).abs();
            prop_assert!(off <= 2.0 * error + 1e-40, "{text} is {value}, off by {off} with {error} allowed");
        }
    }

    #[test]
    fn functions_keep_their_accuracy(digits in 0..1_000_000_000_i64, places in 0_u32..10) {
        let x = digits as f64 / 10_f64.powi(places as i32);
        let text = Tree::Number(digits, places).text();
        let is = |name: &str| f64_of(compute(&format!("{name}[{text}]")).unwrap());
        // Uses the angle within one turn, because `f64` loses digits of larger angles.
        let turn = (x % 360.0).to_radians();
        let lost = x * 1e-17;
        prop_assert!((is("SIN") - turn.sin()).abs() < 2e-15 + lost, "{text}");
        prop_assert!((is("COS") - turn.cos()).abs() < 2e-15 + lost, "{text}");
        prop_assert!((is("SQRT") / x.max(1e-300).sqrt() - 1.0).abs() < 4e-16 || x == 0.0);
        if x > 0.0 {
            prop_assert!((is("LN") - x.ln()).abs() < 1e-15 + x.ln().abs() * 3e-16, "{text}");
        }
        if x < 90.0 {
            prop_assert!((is("EXP") / x.exp() - 1.0).abs() < 6e-14, "{text}");
        }
    }

    /// Tests operators and discontinuous functions with numbers for which both evaluations are exact.
    #[test]
    fn whole_numbers_as_integers(a in -100_000_i64..100_000, b in -1000_i64..1000) {
        let is = |text: &str| compute(text).map(f64_of);
        prop_assert_eq!(is(&format!("[[{a}]*[{b}]]")), Ok((a * b) as f64));
        if b != 0 {
            prop_assert_eq!(is(&format!("[{a}MOD{b}]")), Ok(a.rem_euclid(b) as f64));
            let quotient = format!("{}.0", a);
            prop_assert_eq!(is(&format!("FIX[{quotient}/{b}]")), Ok((a as f64 / b as f64).floor()));
            prop_assert_eq!(is(&format!("FUP[{quotient}/{b}]")), Ok((a as f64 / b as f64).ceil()));
        }
        for (operator, truth) in [
            ("EQ", a == b), ("NE", a != b), ("GT", a > b), ("GE", a >= b), ("LT", a < b), ("LE", a <= b),
            ("AND", a != 0 && b != 0), ("OR", a != 0 || b != 0), ("XOR", (a != 0) != (b != 0)),
        ] {
            prop_assert_eq!(is(&format!("[{a}{operator}{b}]")), Ok(f64::from(u8::from(truth))));
        }
    }

    /// The upper limit of the range is the same, however many digits a number has.
    #[test]
    fn the_greatest_numbers(digits in 1..1_000_000_000_000_000_000_i64) {
        let scale = digits.ilog10();
        for (power, fits) in [(40, true), (41, false)] {
            let text = format!("[{digits}*10**{}]", power - scale);
            prop_assert_eq!(compute(&text).is_ok(), fits, "{}", text);
            prop_assert_eq!(compute(&format!("[-{}]", text)).is_ok(), fits, "{}", text);
        }
    }

    /// Every text gives a value or an error, and a value never uses more bytes than the text has.
    #[test]
    fn any_text_has_an_answer(text in "([-+*/#<>=.0-9\\[\\]A-Z]|SIN\\[|ATAN\\[|\\]/\\[|\\*\\*|EXISTS\\[#|MOD|[0-9]{1,20}){0,60}") {
        if let Ok((_, used)) = expression::value(text.as_bytes(), no_parameters) {
            prop_assert!(used > 0 && used <= text.len());
        }
    }
}
