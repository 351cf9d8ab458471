//! Checks a jog (`$J=`). A jog has axis words and F, and can have N. G20, G21, G90, G91 and G53 are allowed and act on
//! this line only. Everything else is refused.

use super::Dialect;
use super::action::Action;
use super::check::{self, Purpose};
use super::parse::Parsed;
use super::state::Interpreter;
use super::word::{Groups, NonModal};
use crate::error::Error;

/// Checks a jog. A jog is a G1 with G94, whatever modes the program has set. A line can have both a word that jogs do
/// not allow and an error that it would also have in a program. In this case the error of the program is returned.
pub(super) fn check<const N: usize>(
    state: &mut Interpreter<N>,
    line: &[u8],
    dialect: Dialect,
    action: &mut Action<N>,
) -> Result<(), Error> {
    let mut parsed = Parsed::empty();
    state.computed.begin();
    parsed.read_apart(line, dialect, state)?;
    check::check(state, &parsed, dialect, Purpose::Jog, action)?;
    if state.computed.assigns() || !parsed.groups.within(Groups::OF_JOGS) {
        return Err(Error::InvalidJog);
    }
    match parsed.non_modal {
        None | Some(NonModal::MachineCoordinates) => {}
        Some(_) => return Err(Error::InvalidJog),
    }
    action.only_moves(state);
    Ok(())
}
