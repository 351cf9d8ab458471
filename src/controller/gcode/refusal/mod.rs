//! What is wrong with a refused line, in a sentence that names the word: "Q is missing in G83". A line that was refused
//! has changed nothing, so it is read again here, word by word, and looked at in the state in which it was refused.
//!
//! Promises: accepted lines pay nothing for it; the sentence says what to change without a look into a document; it has
//! no brackets, which would end a `[MSG:...]`. Words are named as they were received: in capitals, without blanks. The
//! word that is wrong comes before the first colon, and what may help behind it. Leaves to others: the number of the
//! error, which is that of the check. Nothing is inlined: flash is scarcer than the time of a refusal. Boards without room for texts (feature `reasons`) have none of it.

mod meaning;
mod sentence;
mod words;

use super::action::Action;
use super::parse::Parsed;
use super::state::Interpreter;
use super::{Dialect, Reason};
use crate::error::Error;
use words::Text;

pub(super) use sentence::say;

impl<const N: usize> Interpreter<N> {
    /// What is wrong with a line that has just been refused, and has changed nothing; nothing if the number of the error says
    /// all there is. `action` is that of the check.
    #[cold]
    #[inline(never)]
    pub fn explain(
        &mut self,
        line: &[u8],
        dialect: Dialect,
        error: Error,
        is_jog: bool,
        action: &Action<N>,
        out: &mut Reason,
    ) {
        out.clear();
        if self.explain_flow(line, error, out) {
            return;
        }
        let mut parsed = Parsed::empty();
        match self.refused_word(line, dialect, &mut parsed) {
            Some(found) => self.explain_word(&Text { line, dialect }, found, error, out),
            None => self.explain_meaning(&Text { line, dialect }, &parsed, error, is_jog, action, out),
        }
        self.computed.begin();
    }
}
