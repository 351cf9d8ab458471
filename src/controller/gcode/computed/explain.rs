//! Explains what is wrong with a refused O word, and which parameter of an expression has not been set. This is the
//! part of [`refusal`](crate::gcode::refusal) that needs the parameters and the recorded lines of subroutines, loops
//! and macros.

use super::expression::{self, ParameterReference};
use super::flow::{FlowState, KEYWORDS, Keyword, OWord, digits, ends_program};
use super::m_words::has_m_word;
use super::subprograms::{is_jump, split_call};
use crate::error::Error;
use crate::gcode::Reason;
use crate::gcode::program_number::{behind_line_number, has_program_number};
use crate::gcode::refusal::say;
use crate::gcode::state::{Interpreter, ProgramPlace};
use crate::number::{Digits, read};
use core::fmt::Write;

impl<const N: usize> Interpreter<N> {
    /// Writes what is wrong with an O word, or with the block that a line belongs to. Writes nothing and returns
    /// `false` if the error has another cause.
    #[inline(never)]
    pub(in crate::gcode) fn explain_flow(&self, line: &[u8], error: Error, out: &mut Reason) -> bool {
        let behind_words = match error {
            Error::UnusedWords | Error::ValueWordMissing | Error::ValueOutOfRange => split_call(line),
            _ => None,
        };
        let order = OWord::of(behind_words.map_or(line, |(_, call)| call));
        let is_refused_block = matches!(self.computed.flow.state, FlowState::Recording(_, Some(of)) if of == error);
        match (order, error) {
            (_, Error::OutOfPlace) => self.explain_place(line, order, out),
            (_, Error::OutOfMemory) if self.place == ProgramPlace::Refused && self.computed.flow.missing > 0 => {
                self.say_missing("no room to hold the program up to O%: write O% SUB .. O% ENDSUB above its call", out);
            }
            (Some(order), _) if matches!(order.keyword, Keyword::CallMacroOfM | Keyword::Then | Keyword::GoTo) => {
                return self.explain_jump(line, &order, error, out);
            }
            (Some(order), _) if order.label.is_empty() => self.explain_call(line, &order, error, out),
            (Some(order), _) => self.explain_order(line, &order, error, out),
            (None, Error::OutOfMemory) => {
                say(out, "no room to hold this line: subroutines and loops are too long", &[])
            }
            (None, Error::NotSupported | Error::BadNumber) if is_jump(line) => {
                say(
                    out,
                    "% is not supported: write IF with THEN or GOTO, or WHILE with DO; put values in brackets",
                    &[line],
                );
            }
            (None, _) if is_refused_block => {
                say(out, "this line is in a refused sub or loop: correct the first refused line of that block", &[]);
            }
            (None, Error::FlowSyntax) => say(out, "a sub, loop or condition was not ended before this line", &[]),
            (None, _) => return false,
        }
        true
    }

    /// Explains [`Error::OutOfPlace`]: the line belongs neither to a program nor to a subprogram.
    #[inline(never)]
    fn explain_place(&self, line: &[u8], order: Option<OWord>, out: &mut Reason) {
        if let Some(excess) = self.computed.overflow.so_far() {
            say(out, "% does not fit either: ", &[line]);
            let _ = write!(out, "the program is {excess} bytes too long so far; send $X to drop it");
            return;
        }
        match order.map(|order| order.keyword) {
            _ if has_m_word(line, &[b"99"]) => say(
                out,
                "M99 without a call: lines above may have run. Write subprograms after M30; stop the sender, send $X",
                &[],
            ),
            Some(Keyword::CallProgram | Keyword::CallMacro | Keyword::BeginModalCall)
                if self.place == ProgramPlace::Program =>
            {
                self.say_missing("no subprogram O% above this line", out);
            }
            _ if line.first() == Some(&b'%') => self.say_missing("no subprogram O% above its call or behind M30", out),
            _ if has_program_number(line) => say(
                out,
                "% cannot start here: end the subprogram above with M99, use each number once, then send $X",
                &[line],
            ),
            None if ends_program(line) => {
                say(out, "% is no end of a subprogram: M99 is; for the next program send $X first", &[line])
            }
            _ => say(out, "% belongs to no program that can run: stop the sender, then send $X", &[line]),
        }
    }

    /// Writes why a line with M98, M99, G65 or G66 was refused.
    #[inline(never)]
    fn explain_call(&self, line: &[u8], order: &OWord, error: Error, out: &mut Reason) {
        let name: &[u8] = match order.keyword {
            Keyword::CallMacro => b"G65",
            Keyword::BeginModalCall => b"G66",
            Keyword::CallProgram => b"M98",
            _ => b"M99",
        };
        match error {
            Error::ValueWordMissing => say(out, "P is missing in %: the number of a subprogram", &[name]),
            Error::ValueOutOfRange => say(out, "P of % has up to 8 digits, and L is 1 to 9999", &[name]),
            Error::IntegerRequired => say(out, "P and L of % are whole numbers", &[name]),
            Error::BadNumber => say(out, "% has a letter without a number", &[name]),
            Error::NegativeValue => say(out, "P of % is negative", &[name]),
            Error::WordRepeated => say(out, "% has a letter twice", &[name]),
            Error::UnusedWords if order.keyword != Keyword::CallProgram => {
                say(out, "% takes P, L and arguments, which are letters except G, L, N, O and P", &[name]);
            }
            Error::UnusedWords => say(out, "% takes only P and L: write other words on a line of their own", &[name]),
            Error::NotSupported if order.keyword == Keyword::BeginModalCall => {
                say(out, "% takes plain numbers: each of its calls gets the same ones", &[name]);
            }
            Error::NotSupported => {
                say(out, "% must be alone in its line: it returns to the line after its call", &[name])
            }
            Error::TooDeep => say(out, "% is within too many others", &[name]),
            Error::EndlessLoop => say(out, "% came round 100,000 times", &[name]),
            Error::OutOfMemory => say(out, "no room to hold %: subroutines and loops are too long", &[name]),
            Error::InvalidArgument if self.unset_parameter(line).is_some() => {
                say(
                    out,
                    "% is not set above this line: set it, or correct the name",
                    &[self.unset_parameter(line).unwrap_or_default()],
                );
            }
            error => {
                say(out, "%: ", &[name]);
                let _ = out.extend_from_slice(error.text().as_bytes());
            }
        }
    }

    /// Writes why a line with a call of an M macro, `IF [..] THEN` or GOTO was refused. If the M word has no macro,
    /// the error has another cause, so the function writes nothing and returns `false`.
    #[inline(never)]
    fn explain_jump(&self, line: &[u8], order: &OWord, error: Error, out: &mut Reason) -> bool {
        let name: &[u8] = match order.keyword {
            Keyword::CallMacroOfM => order.label,
            Keyword::Then => b"IF",
            _ => b"GOTO",
        };
        match (order.keyword, error) {
            (Keyword::CallMacroOfM, Error::UnusedWords) => {
                say(out, "M% takes P and Q, in this order: write other words on a line of their own", &[name]);
            }
            (Keyword::GoTo, Error::NotSupported) => {
                say(out, "GOTO is for subprograms and loops: the lines around this one are not held", &[]);
            }
            (Keyword::GoTo, Error::FlowSyntax) => {
                say(out, "no line N% in this subprogram, or in the held part of the program", &[order.label]);
            }
            (_, Error::InvalidArgument) if self.unset_parameter(line).is_some() => {
                say(
                    out,
                    "% is not set above this line: set it, or correct the name",
                    &[self.unset_parameter(line).unwrap_or_default()],
                );
            }
            (Keyword::CallMacroOfM, _) if self.computed.flow.find_macro(order.label).is_none() => return false,
            (_, error) => {
                say(out, "%: ", &[name]);
                let _ = out.extend_from_slice(error.text().as_bytes());
            }
        }
        true
    }

    /// Writes a sentence in which the number of the missing subprogram replaces each `%`.
    #[inline(never)]
    fn say_missing(&self, sentence: &str, out: &mut Reason) {
        let mut number = heapless::Vec::<u8, 10>::new();
        let _ = write!(number, "{}", self.computed.flow.missing);
        say(out, sentence, &[&number, &number, &number]);
    }

    #[inline(never)]
    fn explain_order(&self, line: &[u8], order: &OWord, error: Error, out: &mut Reason) {
        let mut name = heapless::Vec::<u8, 48>::new();
        let keyword = KEYWORDS.iter().find(|(_, keyword)| *keyword == order.keyword);
        let word = keyword.map_or(b"".as_slice(), |(word, _)| word);
        let parts: [&[u8]; 4] = match behind_line_number(line).first() {
            Some(b'O') => [b"O", order.label, b" ", word],
            // `WHILE [..] DO1`, the loop of Fanuc's macros.
            _ if order.keyword == Keyword::While => [b"WHILE", b" DO", order.label, b""],
            _ => [b"END", order.label, b"", b""],
        };
        for part in parts {
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
                say(
                    out,
                    "% is not set above this line: set it, or correct the name",
                    &[self.unset_parameter(within).unwrap_or_default()],
                );
            }
            error if error.code() < Error::UnknownOperation.code() && error != Error::NotIdle => {
                say(out, "% is part of a refused sub or loop: correct the first refused line of it", &[name]);
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
            Keyword::Call => return say(out, "% takes values: put each one in its own brackets", &[name]),
            Keyword::EndSub if order.arguments == b"]" => {
                return say(out, "O% SUB was refused where it is written: correct its first refused line", &[label]);
            }
            _ if order.has_computed_label() => return say(out, "only a call may have a computed number", &[]),
            Keyword::If | Keyword::While | Keyword::ElseIf | Keyword::Repeat if !order.is_well_formed() => {
                return say(out, "% lacks its value in brackets", &[name]);
            }
            _ if !order.is_well_formed() => return say(out, "nothing may come behind %", &[name]),
            Keyword::Sub => return say(out, "% is inside another subroutine: write it above that one", &[name]),
            Keyword::If | Keyword::While | Keyword::Do | Keyword::Repeat => {
                return say(out, "% is not ended", &[name]);
            }
            Keyword::ElseIf | Keyword::Else | Keyword::EndIf => b"IF",
            Keyword::EndSub | Keyword::Return => b"SUB",
            Keyword::EndWhile if name.first() == Some(&b'E') => {
                return say(out, "% has no WHILE .. DO% before it", &[name, label]);
            }
            Keyword::EndWhile => b"WHILE",
            Keyword::EndRepeat => b"REPEAT",
            Keyword::Break | Keyword::Continue => return say(out, "% is within no loop of this number", &[name]),
            Keyword::Program
            | Keyword::CallProgram
            | Keyword::CallMacro
            | Keyword::BeginModalCall
            | Keyword::CallMacroOfM
            | Keyword::Then
            | Keyword::GoTo
            | Keyword::Back => {
                return say(out, "a sub, loop or condition was not ended before this line", &[]);
            }
        };
        say(out, "% has no O% % before it", &[name, label, opening]);
    }

    /// Returns the first parameter in a text that cannot be read: a named one without a value, or a number for which no
    /// parameter exists. A numbered parameter without a value reads as 0, so it is not returned.
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
