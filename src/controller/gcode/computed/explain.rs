//! Explains what is wrong with a refused O word, and which parameter of an expression has not been set: the part of
//! [`refusal`](crate::gcode::refusal) that needs the parameters and the recorded lines of subroutines, loops and
//! macros.

use super::expression::{self, ParameterReference};
use super::flow::{FlowState, KEYWORDS, Keyword, OWord, digits};
use crate::error::Error;
use crate::gcode::Reason;
use crate::gcode::refusal::say;
use crate::gcode::state::Interpreter;
use crate::number::{Digits, read};

impl<const N: usize> Interpreter<N> {
    /// Writes what is wrong with an O word, or with the block that a line belongs to. Returns `false` if the error has
    /// another cause.
    #[inline(never)]
    pub(in crate::gcode) fn explain_flow(&self, line: &[u8], error: Error, out: &mut Reason) -> bool {
        let order = OWord::of(line);
        let is_refused_block = matches!(self.computed.flow.state, FlowState::Recording(_, Some(of)) if of == error);
        match (order, error) {
            (_, Error::BehindEnd) => {
                say(
                    out,
                    "% stands behind the end of the program: a subprogram comes before M2 or M30; $X ends this",
                    &[line],
                );
            }
            (Some(order), _) => self.explain_order(line, &order, error, out),
            (None, Error::OutOfMemory) => {
                say(out, "no room to hold this line: subroutines and loops are too long", &[])
            }
            (None, _) if is_refused_block => {
                say(out, "the sub or loop of this line is refused as a whole: correct its first refused line", &[]);
            }
            (None, Error::FlowSyntax) => say(out, "a sub, loop or condition was not ended before this line", &[]),
            (None, _) => return false,
        }
        true
    }

    #[inline(never)]
    fn explain_order(&self, line: &[u8], order: &OWord, error: Error, out: &mut Reason) {
        let mut name = heapless::Vec::<u8, 48>::new();
        let keyword = KEYWORDS.iter().find(|(_, keyword)| *keyword == order.keyword);
        for part in [b"O".as_slice(), order.label, b" ", keyword.map_or(b"", |(word, _)| word)] {
            let _ = name.extend_from_slice(part.get(..24).unwrap_or(part));
        }
        let name = name.trim_ascii_end();
        let within = line.iter().position(|byte| *byte == b'[').and_then(|at| line.get(at..)).unwrap_or_default();
        match error {
            Error::FlowSyntax => self.explain_syntax(name, order, out),
            Error::TooDeep => say(out, "% is within too many others", &[name]),
            Error::OutOfMemory => say(out, "no room to hold %: subroutines and loops are too long", &[name]),
            Error::EndlessLoop if order.keyword == Keyword::Repeat => {
                say(out, "% has more than 100,000 passes", &[name])
            }
            Error::EndlessLoop => say(out, "% came round 100,000 times: its condition never becomes false", &[name]),
            Error::InvalidArgument if self.unset_parameter(within).is_some() => {
                say(out, "% is not set above this line", &[self.unset_parameter(within).unwrap_or_default()]);
            }
            error if error.code() < Error::UnknownOperation.code() && error != Error::NotIdle => {
                say(out, "% belongs to what is refused as a whole: correct its first refused line", &[name]);
            }
            error => {
                say(out, "%: ", &[name]);
                let _ = out.extend_from_slice(error.text().as_bytes());
            }
        }
    }

    #[inline(never)]
    fn explain_syntax(&self, name: &[u8], order: &OWord, out: &mut Reason) {
        let label = order.label;
        let opening: &[u8] = match order.keyword {
            Keyword::Unknown => {
                let letters = order.arguments.iter().take_while(|byte| byte.is_ascii_uppercase()).count();
                let word = order.arguments.get(..letters).unwrap_or_default();
                return say(out, "% is no word of O%: write sub, call, if, while, do or repeat", &[word, label]);
            }
            Keyword::Call if order.has_computed_label() => {
                return say(out, "no subroutine above this line has the number of this call", &[]);
            }
            Keyword::Call if self.computed.flow.find(label).is_none() => {
                return say(out, "no subroutine % above this line", &[label]);
            }
            Keyword::Call => return say(out, "% takes values in brackets, one behind the other", &[name]),
            Keyword::EndSub if order.arguments == b"]" => {
                return say(out, "O% SUB was refused where it is written: correct its first refused line", &[label]);
            }
            _ if order.has_computed_label() => return say(out, "only a call may have a computed number", &[]),
            Keyword::If | Keyword::While | Keyword::ElseIf | Keyword::Repeat if !order.is_well_formed() => {
                return say(out, "% lacks its value in brackets", &[name]);
            }
            _ if !order.is_well_formed() => return say(out, "nothing may come behind %", &[name]),
            Keyword::Sub => return say(out, "% is within another one: write it in front", &[name]),
            Keyword::If | Keyword::While | Keyword::Do | Keyword::Repeat => {
                return say(out, "% is not ended", &[name]);
            }
            Keyword::ElseIf | Keyword::Else | Keyword::EndIf => b"IF",
            Keyword::EndSub | Keyword::Return => b"SUB",
            Keyword::EndWhile => b"WHILE",
            Keyword::EndRepeat => b"REPEAT",
            Keyword::Break | Keyword::Continue => return say(out, "% is within no loop of this number", &[name]),
        };
        say(out, "% has no O% % before it", &[name, label, opening]);
    }

    /// Returns the first parameter in a text that has no value or does not exist.
    #[inline(never)]
    pub(in crate::gcode) fn unset_parameter<'t>(&self, text: &'t [u8]) -> Option<&'t [u8]> {
        (0..text.len()).find_map(|at| {
            let found = text.get(at..)?.strip_prefix(b"#")?;
            let (reference, length) = match found.strip_prefix(b"<") {
                Some(behind) => {
                    let (name, _) = expression::name(behind).ok()?;
                    (ParameterReference::Name(name), name.len() + 3)
                }
                None => {
                    let length = digits(found);
                    let number = read(found, Digits::Exact).filter(|_| length > 0)?.value.truncate();
                    (ParameterReference::Number(number.into()), length + 1)
                }
            };
            let is_name = matches!(reference, ParameterReference::Name(_));
            match self.parameter(reference) {
                Ok(Some(_)) => None,
                Ok(None) if !is_name => None,
                _ => text.get(at..at + length),
            }
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_keyword_has_its_sentence() {
        let interpreter = Interpreter::<3>::default();
        for (word, _) in KEYWORDS {
            let line = [b"O7", word].concat();
            let mut reason = Reason::new();
            assert!(interpreter.explain_flow(&line, Error::FlowSyntax, &mut reason));
            assert!(!reason.is_empty(), "{word:?}");
        }
    }
}
