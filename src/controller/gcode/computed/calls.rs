//! Begins calls of subroutines and subprograms. Also stops the execution of held text (recorded lines), and abandons a
//! program with its open blocks.

use super::Computed;
use super::flow::{FlowState, FrameKind, Keyword, OWord, STREAM};
use super::real::Real;
use crate::error::Error;
use crate::gcode::state::{Interpreter, ProgramPlace};

impl<const N: usize> Interpreter<N> {
    /// Begins a call. `back`: position in the held text (recorded lines) to which the call returns, or [`STREAM`] for
    /// a call in a line of the host. With [`STREAM`], the caller has already started the text of the subroutine
    /// (`FlowControl::run`), so this function stops the text again if the call fails.
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

    /// Stops executing the held text (recorded lines) after one of its lines was refused. Also ends the modal call
    /// (G66).
    pub fn abandon_held(&mut self) {
        self.computed.flow.modal.end();
        self.stop_held();
    }

    /// Stops executing the held text (recorded lines) and ends its calls. Drops the modal states that M70 and M73 have
    /// saved in these calls.
    pub(super) fn stop_held(&mut self) {
        self.computed.flow.stop();
        self.computed.parameters.leave_calls();
        self.saved.abandon(0);
    }

    /// Abandons the program: forgets its open conditions and loops, and all recorded lines except macros. Ends G68 and
    /// G51, because no other program expects them. Call this when the program's remaining lines will not run, or when
    /// another host has taken over.
    ///
    /// The lines that follow can still belong to the abandoned program: it may wait for a subprogram, or the host may
    /// be sending subprograms. In both cases the lines are refused until another program begins.
    pub fn abandon_program(&mut self) {
        if self.is_held() || self.place == ProgramPlace::Subprogram {
            self.place = ProgramPlace::Refused;
        }
        self.rotation = None;
        self.scaling = None;
        self.computed.flow.reset();
        self.computed.parameters.leave_calls();
        self.saved.abandon(0);
    }

    /// Abandons the program and its subprograms, and refuses all lines that follow until another program begins.
    /// Returns the error for the present line.
    #[cold]
    #[inline(never)]
    pub(in crate::gcode) fn refuse_rest(&mut self) -> Error {
        self.abandon_program();
        self.place = ProgramPlace::Refused;
        Error::OutOfPlace
    }

    /// Returns whether a program waits for a subprogram that it has called, or a subprogram is being recorded.
    pub fn is_held(&self) -> bool {
        let flow = &self.computed.flow;
        match flow.state {
            FlowState::Holding | FlowState::Waiting => true,
            FlowState::Recording(from, _) => {
                flow.line(from).and_then(OWord::of).is_some_and(|opening| opening.keyword == Keyword::Program)
            }
            FlowState::Streaming | FlowState::Running(_) => false,
        }
    }
}
