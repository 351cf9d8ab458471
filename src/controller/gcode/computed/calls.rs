//! Begins calls of subroutines and subprograms, and gives up what runs or is open.

use super::Computed;
use super::flow::{FrameKind, STREAM};
use super::real::Real;
use crate::error::Error;
use crate::gcode::state::{Interpreter, ProgramPlace};

impl<const N: usize> Interpreter<N> {
    /// Begins a call. `back`: the position after it, or [`STREAM`].
    pub(super) fn call(
        &mut self,
        kind: FrameKind,
        label: &[u8],
        back: u16,
        arguments: &[(u8, Real)],
    ) -> Result<(), Error> {
        let Computed { flow, parameters, .. } = &mut self.computed;
        let mut pushed = flow.push(kind, label, back);
        if kind.is_level() {
            pushed = pushed.and_then(|()| parameters.enter_call(arguments));
        }
        if pushed.is_err() && back == STREAM {
            self.abandon_held();
        }
        pushed
    }

    /// Stops the running text after one of its lines was refused.
    pub fn abandon_held(&mut self) {
        self.computed.flow.stop();
        self.computed.parameters.leave_calls();
        self.saved.abandon(0);
    }

    /// Abandons the program, because its rest will not run or another host has taken over. Forgets open conditions and
    /// loops, and all recorded lines except macros. Ends G68 and G51, because no other program expects them. If lines
    /// were held, those that follow are refused up to the next program.
    pub fn abandon_program(&mut self) {
        if self.is_held() {
            self.place = ProgramPlace::Refused;
        }
        self.rotation = None;
        self.scaling = None;
        self.computed.flow.reset();
        self.computed.parameters.leave_calls();
        self.saved.abandon(0);
    }
}
