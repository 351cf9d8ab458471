//! Explains what is wrong with a refused line, in a sentence that names the word: "Q is missing in G83". A refused line
//! has changed nothing. So this module reads the line again, word by word, in the state in which the line was refused.
//!
//! Guarantees:
//! * Accepted lines take no additional time.
//! * The sentence says what to change, so that the user need not consult a document.
//! * The sentence contains no brackets, because a bracket would end a `[MSG:...]`.
//! * Words are named as received: in capitals, without blanks. The wrong word comes before the first colon, advice
//!   after it.
//!
//! The error number does not change: it is the one that the check has returned. Nothing is inlined, because flash is
//! scarce and a refusal need not be fast. Boards without room for texts are built without the feature `reasons`, and so
//! without this folder.

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
    /// Writes to `out` what is wrong with a line that has just been refused. Writes nothing if the text of the error
    /// number says enough. `is_jog`: the line is a jog (`$J=`), without this prefix. `action`: what the failed check
    /// has filled in.
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
