//! The line that is being executed: its action, its curve with the next chord to queue, its tool change, and the last
//! message of the program. One line is executed at a time, so its memory is reused.

use crate::axes::{LINEAR, PerAxis};
use crate::error::Error;
use crate::gcode::{Action, Dialect, Interpreter, Notice, REASONS, Reason};
use crate::image::FULL_IMAGE;
use crate::motion::{Arc, ArcGeometry, Curvature, Curve, Nurbs, NurbsGeometry, Spline, SplineGeometry};
use crate::protocol::line_filter::MESSAGE_LENGTH;
use crate::protocol::text::{Text, put, whole};
use crate::units::{Coordinate, WeightedPoint};
use crate::work::tool_change::plan::ToolChange;

/// Maximum length of a message of a program, in bytes, with the values of its parameters filled in.
const MESSAGE: usize = if FULL_IMAGE { 160 } else { MESSAGE_LENGTH };

/// A message of a program to its operator: the text of a comment in the program.
pub(crate) type Message = heapless::Vec<u8, MESSAGE>;

#[derive(Clone, Debug)]
pub(crate) struct LineInWork<const N: usize> {
    /// The line's action. Canned cycles and jogs change it during execution.
    pub(crate) action: Action<N>,
    curve: Option<Curve<N>>,
    single_block: bool,
    /// Notices already sent for this program, one bit each.
    sent_notices: u8,
    /// Progress of the line's tool change, if the new tool is measured.
    change: ToolChange<N>,
    /// The last message of the program, for a host that takes over. Takes no memory without `FULL_IMAGE`.
    message: [Message; FULL_IMAGE as usize],
    /// Why the last refused line was refused. Takes no memory without `REASONS`.
    refusal: [Refusal; REASONS as usize],
}

#[derive(Clone, Debug)]
struct Refusal {
    reason: Reason,
    /// `true` if the reason belongs to the line that is being refused now, and not to an earlier one.
    is_new: bool,
}

impl Refusal {
    const NONE: Self = Self { reason: Reason::new(), is_new: false };
}

impl<const N: usize> LineInWork<N> {
    /// The value at power-up, before any line has been executed.
    pub(crate) const NONE: Self = Self {
        action: Action::NOTHING,
        curve: None,
        single_block: false,
        sent_notices: 0,
        change: ToolChange::NONE,
        message: [const { Message::new() }; FULL_IMAGE as usize],
        refusal: [const { Refusal::NONE }; REASONS as usize],
    };

    /// Finds out what is wrong with a refused line, and stores the sentence for [`LineInWork::refused`]. The line may
    /// come from the host, or from the stored lines of a subroutine, loop or macro.
    #[cold]
    pub(crate) fn explain(
        &mut self,
        interpreter: &mut Interpreter<N>,
        text: &[u8],
        dialect: Dialect,
        error: Error,
        is_jog: bool,
    ) {
        if let Some(refusal) = self.refusal.first_mut() {
            interpreter.explain(text, dialect, error, is_jog, &self.action, &mut refusal.reason);
            refusal.is_new = !refusal.reason.is_empty();
        }
    }

    /// Puts the beginning of the wrong line `held` before the reason. `held` is a stored line of a subroutine, loop or
    /// macro. The host has sent only the line that called it, so the message has to show the wrong line itself.
    #[cold]
    pub(crate) fn explain_within(&mut self, held: &[u8]) {
        /// How many characters of `held` to show.
        const SHOWN: usize = 24;
        for refusal in self.refusal.iter_mut().filter(|refusal| refusal.is_new) {
            let found = core::mem::take(&mut refusal.reason);
            let _ = refusal.reason.extend_from_slice(b"in ");
            let _ = refusal.reason.extend_from_slice(held.get(..SHOWN).unwrap_or(held));
            for part in [b": ".as_slice(), &found] {
                let room = refusal.reason.capacity() - refusal.reason.len();
                let _ = refusal.reason.extend_from_slice(part.get(..room).unwrap_or(part));
            }
        }
    }

    /// Explains that the line is refused because it has `length` characters, more than the maximum `fit`.
    #[cold]
    pub(crate) fn explain_length(&mut self, length: usize, fit: usize) {
        if let Some(refusal) = self.refusal.first_mut() {
            let mut text = Text::new();
            put(&mut text, b"the line has ");
            whole(&mut text, length as u64);
            put(&mut text, b" characters without blanks and comments: ");
            whole(&mut text, fit as u64);
            put(&mut text, b" fit");
            refusal.reason.clear();
            let _ = refusal.reason.extend_from_slice(&text);
            refusal.is_new = true;
        }
    }

    /// Records that the line is refused. Returns the reason that `explain` has found, so that the caller can send it
    /// to the host. If `explain` has found none, returns `None`, and from then on [`LineInWork::refusal`] returns the
    /// text of the error.
    #[cold]
    pub(crate) fn refused(&mut self, error: Error) -> Option<Reason> {
        let refusal = self.refusal.first_mut()?;
        if core::mem::replace(&mut refusal.is_new, false) {
            return Some(refusal.reason.clone());
        }
        refusal.reason.clear();
        let text = error.text().as_bytes();
        let _ = refusal.reason.extend_from_slice(text.get(..refusal.reason.capacity()).unwrap_or(text));
        None
    }

    /// Returns why the last refused line was refused: a sentence, or the text of its error. Empty without `REASONS`.
    pub(crate) fn refusal(&self) -> &[u8] {
        self.refusal.first().map_or(&[], |refusal| &refusal.reason)
    }

    /// Returns whether single block is on: the program pauses after each line that moves, until the operator continues
    /// it.
    pub(crate) fn is_single_block(&self) -> bool {
        self.single_block
    }

    pub(crate) fn toggle_single_block(&mut self) {
        self.single_block = !self.single_block;
    }

    /// Returns the last message of the program; empty if there was none.
    pub(crate) fn message(&self) -> Message {
        self.message.first().cloned().unwrap_or_default()
    }

    /// Keeps a message of the program as the last one. An empty message means that the program has ended.
    pub(crate) fn keep_message(&mut self, message: Message) {
        if let Some(kept) = self.message.first_mut() {
            *kept = message;
        }
    }

    /// Returns whether this notice has not been sent for the program yet, and marks it as sent.
    pub(crate) fn take_unsent(&mut self, notice: Notice) -> bool {
        let bit = 1 << notice as u8;
        let is_unsent = self.sent_notices & bit == 0;
        self.sent_notices |= bit;
        is_unsent
    }

    /// Marks all notices as not sent, for another program.
    pub(crate) fn forget_notices(&mut self) {
        self.sent_notices = 0;
    }

    /// At a reset, switches single block off, and marks all notices as not sent, for the next program.
    pub(crate) fn reset(&mut self) {
        self.single_block = false;
        self.forget_notices();
    }

    /// Starts a tool change that measures the tool. [`LineInWork::change`] gives access to its progress.
    pub(crate) fn begin_change(&mut self, change: ToolChange<N>) {
        self.change = change;
    }

    /// Returns the tool change of the line, so that the caller can advance it.
    pub(crate) fn change(&mut self) -> &mut ToolChange<N> {
        &mut self.change
    }

    /// Starts the line's arc. Returns the total length of its chords (mm, all axes), and the ratio of this length to
    /// the length along X, Y and Z only (1 without a rotary axis). `tolerance`: how far a chord may be off the arc,
    /// mm.
    pub(crate) fn begin_arc(&mut self, geometry: &ArcGeometry<N>, tolerance: f32) -> (f32, f32) {
        let arc = Arc::new(geometry, tolerance);
        let lengths = (arc.length(), if N > LINEAR { arc.rotary_stretch() } else { 1.0 });
        self.curve = Some(Curve::Arc(arc));
        lengths
    }

    pub(crate) fn begin_spline(&mut self, geometry: &SplineGeometry<N>, tolerance: f32) {
        self.curve = Some(Curve::Spline(Spline::new(geometry, tolerance)));
    }

    /// Starts the line's curve of control points (G5.3).
    pub(crate) fn begin_nurbs(&mut self, geometry: &NurbsGeometry<N>, tolerance: f32) {
        self.curve = Some(Curve::Nurbs(Nurbs::new(geometry, tolerance)));
    }

    /// Returns the end of the next chord of the curve, and the curvature of the curve there; `None` after the last
    /// chord. `points`: the control points of G5.2, for a curve that has them.
    pub(crate) fn next_chord(&mut self, points: &[WeightedPoint]) -> Option<(PerAxis<Coordinate, N>, Curvature)> {
        let curve = self.curve.as_mut()?;
        let end = curve.next_chord(points)?;
        Some((end, curve.curvature()))
    }
}
