//! Replaces the recorder in the small firmware image. It has the same functions, but they do nothing.

use crate::dispatch::Controller;
use crate::messages::{Event, Record, Recorded, Restart, ToStep};
use crate::units::Instant;

/// Placeholder for a page of the recorder's ring; takes no memory.
#[derive(Clone, Copy, Debug)]
pub struct Page;

impl Page {
    /// The only value of the placeholder.
    pub const EMPTY: Page = Page;
}

/// Stands in for the recorder of the full image, and takes no memory.
#[derive(Clone, Debug)]
pub struct Recorder<P>(core::marker::PhantomData<P>);

impl<P> Recorder<P> {
    /// Returns a recorder that keeps nothing.
    pub fn begin(_pages: P, _restart: &Restart) -> Self {
        Recorder(core::marker::PhantomData)
    }

    /// Always `false`: no recording can be kept, because nothing is recorded.
    pub fn is_kept(&self) -> bool {
        false
    }

    /// Ignores the event.
    #[inline(always)]
    pub fn record<const N: usize>(&mut self, _now: Instant, _event: &Event<N>, _controller: &Controller<N>) {}

    /// Ignores the text of a line.
    #[inline(always)]
    pub fn record_text<const N: usize>(
        &mut self,
        _now: Instant,
        _epoch: u16,
        _text: &[u8],
        _controller: &Controller<N>,
    ) {
    }

    /// Ignores that more bytes wait after a line.
    #[inline(always)]
    pub fn more_waits(&mut self) {}

    /// Ignores a message to the step task; no hash of blocks is computed.
    #[inline(always)]
    pub fn handed(&mut self, _message: &ToStep) {}

    /// Ignores that the machine has come to rest.
    #[inline(always)]
    pub fn at_rest<const N: usize>(&mut self, _now: Instant, _controller: &Controller<N>) {}

    /// Never calls `_tell`, because there is no recording to list.
    #[inline(always)]
    pub fn read(
        &mut self,
        _first: bool,
        _board: (&'static str, u32),
        _record: impl FnMut(u16) -> Option<Record>,
        _tell: impl FnOnce(&Recorded),
    ) {
    }
}
