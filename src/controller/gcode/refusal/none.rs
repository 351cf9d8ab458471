//! In place of `refusal`, on boards without room for texts: the number of the error is all that is said.

use super::action::Action;
use super::state::Interpreter;
use super::{Dialect, Reason};
use crate::error::Error;

impl<const N: usize> Interpreter<N> {
    /// Nothing is said.
    #[inline(always)]
    pub fn explain(&mut self, _: &[u8], _: Dialect, _: Error, _: bool, _: &Action<N>, _: &mut Reason) {}
}
