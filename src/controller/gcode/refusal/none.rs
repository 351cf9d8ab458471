//! Replaces `refusal` on boards without room for texts: a refusal has only its error number.

use super::action::Action;
use super::state::Interpreter;
use super::{Dialect, Reason};
use crate::error::Error;

impl<const N: usize> Interpreter<N> {
    /// Writes nothing, because this build has no explanations.
    #[inline(always)]
    pub fn explain(&mut self, _: &[u8], _: Dialect, _: Error, _: bool, _: &Action<N>, _: &mut Reason) {}
}
