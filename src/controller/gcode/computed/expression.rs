//! Values of expressions: `[#1 + 2] * 3`, functions and operators of RS274NGC. A `Reader` reads one operand after
//! another, without recursion.
//!
//! ```text
//!  value     = number | [ sum ] | # value | #<name> | function[ sum ] | ATAN[ sum ]/[ sum ] | EXISTS[#...] | - value | + value
//!  levels    ** first, then * / MOD, then + -, then EQ NE GT GE LT LE, then AND OR XOR; each from left to right
//! ```
//! Operators, brackets and functions that wait for a value are kept in a list of bounded length, not on the
//! processor's stack. Every byte is read once. So time and memory are bounded. True is 1 and false is 0; every value
//! except 0 counts as true.

use super::real::Real;
use crate::error::Error;
use core::cmp::Ordering;

/// Maximum number of waiting brackets, functions, signs and left operands.
const DEPTH: usize = 32;

/// Parameter that `#` refers to. Names consist of capitals without blanks.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum ParameterReference<'a> {
    Number(i64),
    Name(&'a [u8]),
}

/// Result of looking up a parameter; `Ok(None)` if the parameter exists and is not set.
pub(super) type Found = Result<Option<Real>, Error>;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Function {
    Abs,
    Acos,
    Asin,
    Atan,
    Cos,
    Exp,
    Fix,
    Fup,
    Ln,
    Round,
    Sin,
    Sqrt,
    Tan,
}

const FUNCTIONS: [(&[u8], Function); 13] = [
    (b"ABS[", Function::Abs),
    (b"ACOS[", Function::Acos),
    (b"ASIN[", Function::Asin),
    (b"ATAN[", Function::Atan),
    (b"COS[", Function::Cos),
    (b"EXP[", Function::Exp),
    (b"FIX[", Function::Fix),
    (b"FUP[", Function::Fup),
    (b"LN[", Function::Ln),
    (b"ROUND[", Function::Round),
    (b"SIN[", Function::Sin),
    (b"SQRT[", Function::Sqrt),
    (b"TAN[", Function::Tan),
];

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Binary {
    Power,
    Times,
    Over,
    Modulo,
    Plus,
    Minus,
    Equal,
    NotEqual,
    Greater,
    GreaterEqual,
    Less,
    LessEqual,
    And,
    Or,
    Xor,
}

/// The operators. Of two operators that begin alike, the longer one comes first: `**` before `*`.
const BINARIES: [(&[u8], Binary); 15] = [
    (b"**", Binary::Power),
    (b"*", Binary::Times),
    (b"/", Binary::Over),
    (b"MOD", Binary::Modulo),
    (b"+", Binary::Plus),
    (b"-", Binary::Minus),
    (b"EQ", Binary::Equal),
    (b"NE", Binary::NotEqual),
    (b"GT", Binary::Greater),
    (b"GE", Binary::GreaterEqual),
    (b"LT", Binary::Less),
    (b"LE", Binary::LessEqual),
    (b"AND", Binary::And),
    (b"OR", Binary::Or),
    (b"XOR", Binary::Xor),
];

impl Binary {
    /// Returns the precedence of the operator: a higher one binds more closely (RS274NGC, 3.3.2.3).
    fn level(self) -> u8 {
        match self {
            Binary::Power => 5,
            Binary::Times | Binary::Over | Binary::Modulo => 4,
            Binary::Plus | Binary::Minus => 3,
            Binary::And | Binary::Or | Binary::Xor => 1,
            _ => 2,
        }
    }

    fn of(self, left: Real, right: Real) -> Result<Real, Error> {
        let order = || left.order(right);
        Ok(Real::truth(match self {
            Binary::Power => return left.power(right),
            Binary::Times => return left.mul(right),
            Binary::Over => return left.div(right),
            Binary::Modulo => return left.modulo(right),
            Binary::Plus => return left.add(right),
            Binary::Minus => return left.sub(right),
            Binary::Equal => left.is_near(right),
            Binary::NotEqual => !left.is_near(right),
            Binary::Greater => order() == Ordering::Greater,
            Binary::GreaterEqual => order() != Ordering::Less,
            Binary::Less => order() == Ordering::Less,
            Binary::LessEqual => order() != Ordering::Greater,
            Binary::And => !left.is_zero() && !right.is_zero(),
            Binary::Or => !left.is_zero() || !right.is_zero(),
            Binary::Xor => left.is_zero() != right.is_zero(),
        }))
    }
}

/// An operation whose value or right operand has not been read yet.
#[derive(Clone, Copy, Debug)]
enum Waiting {
    Negation,
    Parameter,
    Bracket,
    Function(Function),
    /// Arc tangent that waits for its second bracket, with the value of the first.
    AtanOver(Real),
    /// Operator that waits for its right operand, with the value of its left operand.
    Operator(Binary, Real),
}

/// Returns whether a text begins with an expression. Returns `false` for a plain number, and for a text that does not
/// begin with a value.
pub(super) fn begins(text: &[u8]) -> bool {
    let signs = text.iter().take_while(|byte| matches!(byte, b'-' | b'+')).count();
    let text = text.get(signs..).unwrap_or(&[]);
    matches!(text, [b'[' | b'#', ..])
        || signs > 1 && matches!(text, [b'0'..=b'9' | b'.', ..])
        || text.starts_with(b"EXISTS[")
        || FUNCTIONS.iter().any(|(name, _)| text.starts_with(name))
}

/// Reads the value at the start of a text. Returns the value and its length in bytes.
pub(super) fn value<F: Fn(ParameterReference<'_>) -> Found>(text: &[u8], lookup: F) -> Result<(Real, usize), Error> {
    let mut reader = Reader { rest: text, waiting: heapless::Vec::new(), lookup };
    loop {
        let value = reader.operand()?;
        if let Some(value) = reader.complete(value)? {
            return Ok((value, text.len() - reader.rest.len()));
        }
    }
}

/// Splits the text after `#<` at `>` into a name and the rest. An empty name is an error.
pub(super) fn name(text: &[u8]) -> Result<(&[u8], &[u8]), Error> {
    let end = text.iter().position(|byte| *byte == b'>').filter(|end| *end > 0).ok_or(Error::ExpressionSyntax)?;
    let (name, rest) = text.split_at_checked(end).ok_or(Error::ExpressionSyntax)?;
    Ok((name, rest.get(1..).unwrap_or(&[])))
}

struct Reader<'a, F> {
    rest: &'a [u8],
    waiting: heapless::Vec<Waiting, DEPTH>,
    lookup: F,
}

impl<F: Fn(ParameterReference<'_>) -> Found> Reader<'_, F> {
    /// Consumes `text` if it comes next. Returns whether it came next.
    fn takes(&mut self, text: &[u8]) -> bool {
        match self.rest.strip_prefix(text) {
            Some(rest) => {
                self.rest = rest;
                true
            }
            None => false,
        }
    }

    fn wait(&mut self, waiting: Waiting) -> Result<(), Error> {
        self.waiting.push(waiting).map_err(|_| Error::TooDeep)
    }

    /// Reads the next operand and returns its value. Adds the signs, brackets and functions before it to the waiting
    /// list.
    fn operand(&mut self) -> Result<Real, Error> {
        loop {
            if let Some((value, used)) = Real::read(self.rest) {
                self.rest = self.rest.get(used..).unwrap_or(&[]);
                return Ok(value);
            }
            if self.takes(b"#<") {
                let (name, rest) = name(self.rest)?;
                self.rest = rest;
                return (self.lookup)(ParameterReference::Name(name))?.ok_or(Error::InvalidArgument);
            }
            if self.takes(b"EXISTS[#") {
                return self.exists();
            }
            if self.takes(b"+") {
                continue;
            }
            let waiting = match self.rest.first() {
                Some(b'-') => Waiting::Negation,
                Some(b'#') => Waiting::Parameter,
                Some(b'[') => Waiting::Bracket,
                Some(b'A'..=b'Z') => {
                    let known = FUNCTIONS.iter().find(|(name, _)| self.rest.starts_with(name));
                    let (name, function) = known.ok_or(Error::UnknownOperation)?;
                    self.rest = self.rest.get(name.len() - 1..).unwrap_or(&[]);
                    Waiting::Function(*function)
                }
                _ => return Err(Error::ExpressionSyntax),
            };
            self.rest = self.rest.get(1..).unwrap_or(&[]);
            self.wait(waiting)?;
        }
    }

    /// Reads the text after `EXISTS[#`, including the closing bracket. For a name, returns 1 if the parameter is set.
    /// For a number, returns 1 if a parameter can have this number. Otherwise returns 0.
    fn exists(&mut self) -> Result<Real, Error> {
        let found = if self.takes(b"<") {
            let (name, rest) = name(self.rest)?;
            self.rest = rest;
            (self.lookup)(ParameterReference::Name(name))?.is_some()
        } else {
            let (number, used) = Real::read(self.rest).ok_or(Error::ExpressionSyntax)?;
            self.rest = self.rest.get(used..).unwrap_or(&[]);
            number.whole().is_some_and(|number| (self.lookup)(ParameterReference::Number(number)).is_ok())
        };
        if self.takes(b"]") { Ok(Real::truth(found)) } else { Err(Error::ExpressionSyntax) }
    }

    /// Gives a value to the operations that wait for it. Returns the value of the whole expression, or `None` if
    /// another operand has to be read first.
    fn complete(&mut self, value: Real) -> Result<Option<Real>, Error> {
        let mut value = value;
        loop {
            match self.waiting.last().copied() {
                None => return Ok(Some(value)),
                Some(Waiting::Negation) => value = value.neg(),
                Some(Waiting::Parameter) => value = self.parameter(value)?,
                Some(_) if self.takes(b"]") => match self.close(value)? {
                    Some(closed) => {
                        value = closed;
                        continue;
                    }
                    None => return Ok(None),
                },
                Some(_) => {
                    self.operator(value)?;
                    return Ok(None);
                }
            }
            self.waiting.pop();
        }
    }

    fn parameter(&self, number: Real) -> Result<Real, Error> {
        let number = number.whole().ok_or(Error::InvalidArgument)?;
        Ok((self.lookup)(ParameterReference::Number(number))?.unwrap_or(Real::ZERO))
    }

    /// Closes a bracket: computes the operators within it, then the function before it. Returns `None` if this was the
    /// first bracket of an arc tangent, so that the second one follows.
    fn close(&mut self, value: Real) -> Result<Option<Real>, Error> {
        let value = self.left_sides(value, 0)?;
        match self.waiting.pop() {
            Some(Waiting::Function(Function::Atan)) => {
                if !self.takes(b"/[") {
                    return Err(Error::ExpressionSyntax);
                }
                self.wait(Waiting::AtanOver(value))?;
                Ok(None)
            }
            Some(Waiting::Function(function)) => function.of(value).map(Some),
            Some(Waiting::AtanOver(first)) => first.atan(value).map(Some),
            _ => Ok(Some(value)),
        }
    }

    /// Reads the operator after a value, and adds it to the waiting list. First computes waiting operators of the same
    /// level or a higher one.
    fn operator(&mut self, value: Real) -> Result<(), Error> {
        let known = BINARIES.iter().find(|(name, _)| self.rest.starts_with(name));
        let (name, operator) = match (known, self.rest.first()) {
            (Some(known), _) => known,
            (None, Some(b'A'..=b'Z')) => return Err(Error::UnknownOperation),
            (None, _) => return Err(Error::ExpressionSyntax),
        };
        self.rest = self.rest.get(name.len()..).unwrap_or(&[]);
        let left = self.left_sides(value, operator.level())?;
        self.wait(Waiting::Operator(*operator, left))
    }

    /// Computes the waiting operators whose precedence is `level` or higher, the most recent one first, and returns
    /// the result. `value` is the right operand of the most recent one. Example: at the minus in `1 + 2 * 3 - 4`,
    /// `value` is 3, and the result is 7.
    fn left_sides(&mut self, value: Real, level: u8) -> Result<Real, Error> {
        let mut value = value;
        while let Some(Waiting::Operator(operator, left)) = self.waiting.last().copied() {
            if operator.level() < level {
                break;
            }
            value = operator.of(left, value)?;
            self.waiting.pop();
        }
        Ok(value)
    }
}

impl Function {
    fn of(self, value: Real) -> Result<Real, Error> {
        match self {
            Function::Abs => Ok(value.abs()),
            Function::Acos => value.acos(),
            Function::Asin => value.asin(),
            Function::Atan => value.atan(Real::ONE),
            Function::Cos => value.cos(),
            Function::Exp => value.exp(),
            Function::Fix => Ok(value.floor()),
            Function::Fup => Ok(value.ceiling()),
            Function::Ln => value.ln(),
            Function::Round => Ok(value.round()),
            Function::Sin => value.sin(),
            Function::Sqrt => value.sqrt(),
            Function::Tan => value.tan(),
        }
    }
}
