//! Carries out the text of a program as a controller does: drops comments and blanks, follows O words, sends messages.

use super::Event;
use super::ours::Mill;
use oxmill_controller::error::Error;
use oxmill_controller::gcode::{AS_WRITTEN, Direction, Flow, Held, HeldLine, WITH_VALUES, split_comment};
use oxmill_controller::protocol::line_filter::{self, Line, LineRules, Pushed};

/// Runs programs one after the other on one machine.
#[derive(Clone)]
pub struct Runner {
    pub mill: Mill,
    /// `true`: lines that start with a slash are skipped.
    deletes_blocks: bool,
    lines: u32,
}

/// A rejected line, without blanks and comments, and the reason.
pub struct Refusal {
    pub line: String,
    pub error: Error,
}

impl Runner {
    pub fn new(deletes_blocks: bool) -> Runner {
        Runner { mill: Mill::new(), deletes_blocks, lines: 0 }
    }

    /// Carries out a line of the file, and the lines that it calls. If a line is rejected, `events` still gets the
    /// events before it.
    pub fn run(&mut self, text: &str, events: &mut Vec<Event>) -> Result<(), Refusal> {
        let block_delete = self.deletes_blocks;
        let rules = || LineRules {
            length: line_filter::LENGTH,
            merge_crlf: true,
            nested_comments: false,
            expressions: true,
            block_delete,
        };
        self.lines += 1;
        let mut line = Line::new();
        for byte in text.bytes().chain(*b"\n") {
            match line.push(byte, rules) {
                Pushed::More => {}
                Pushed::TooLong => return Err(Refusal { line: text.into(), error: Error::LineTooLong }),
                Pushed::Complete => break,
            }
        }
        let words = line.text().to_vec();
        let mut comment = Vec::new();
        if let Some((has_values, text)) = line.message() {
            comment.push(if has_values { WITH_VALUES } else { AS_WRITTEN });
            comment.extend_from_slice(text);
        }
        self.take(&words, &comment, events)
    }

    fn take(&mut self, words: &[u8], comment: &[u8], events: &mut Vec<Event>) -> Result<(), Refusal> {
        let refused = |error| Refusal { line: String::from_utf8_lossy(words).into_owned(), error };
        if words.first() == Some(&b'%') {
            return self.mill.interpreter().tape_mark().map_err(refused);
        }
        match self.mill.interpreter().direct(words, comment, self.lines).map_err(refused)? {
            Direction::Check => self.carry_out(words, comment, events),
            Direction::Run | Direction::Call => self.run_held(words, events),
            Direction::Done | Direction::LeftOut => Ok(()),
        }
    }

    fn run_held(&mut self, words: &[u8], events: &mut Vec<Event>) -> Result<(), Refusal> {
        let mut held = HeldLine::new();
        loop {
            let next = self.mill.interpreter().next_held(&mut held);
            let line = held.clone();
            let (text, comment) = split_comment(&line);
            let at = if text.is_empty() { words } else { text };
            match next {
                Ok(Held::Line) => self.carry_out(text, comment, events)?,
                Ok(Held::Again) => {}
                Ok(Held::End) => return Ok(()),
                Err(error) => return Err(Refusal { line: String::from_utf8_lossy(at).into_owned(), error }),
            }
        }
    }

    fn carry_out(&mut self, words: &[u8], comment: &[u8], events: &mut Vec<Event>) -> Result<(), Refusal> {
        if !words.is_empty() {
            let line = String::from_utf8_lossy(words).into_owned();
            let (made, flow) = self.mill.carry_out(&line).map_err(|error| Refusal { line, error })?;
            events.extend(made);
            match flow {
                Flow::Pause => events.push(Event::Stop(false)),
                Flow::OptionalPause => events.push(Event::Stop(true)),
                Flow::None | Flow::End => {}
            }
        }
        if let Some((mark, written)) = comment.split_first() {
            let mut told = HeldLine::new();
            if *mark == WITH_VALUES {
                self.mill.interpreter().expand(written, &mut told);
            } else {
                let _ = told.extend_from_slice(written);
            }
            events.push(Event::Message(String::from_utf8_lossy(&told).into_owned()));
        }
        Ok(())
    }
}
