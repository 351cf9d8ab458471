//! Messages between the pump and the controller: events in, outputs out, and what the pump observes of the queues.

use super::host::{Chunk, LineByte, Realtime};
use super::inputs::{PinView, Sensed};
use super::outputs::{SlowOutputs, Wiring};
use super::step::{StepEvent, ToStep};

/// Something that happened, told to the controller.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Event<const N: usize> {
    /// A realtime command.
    Realtime(Realtime),
    /// A byte of a line. To be given only while `wants_line()`.
    Line(LineByte),
    /// The step task reports.
    Step(StepEvent<N>),
    /// The inputs changed.
    Signals(Sensed),
    /// Answers [`Output::ReadPins`].
    Pins(PinView),
    /// The [`Output::Store`] given last is safe.
    Stored,
    /// The [`Output::Store`] given last could not be written.
    StoreFailed,
    /// A host has just opened the port.
    Connected,
    /// The host that was listened to has closed the port or is unplugged: the number (wrapping) of such hosts since power-up.
    /// Not every link can tell. Its lines, up to the [`HOST_CHANGED`](super::HOST_CHANGED) of this number, get no answers.
    Disconnected(u16),
}

/// What the pump knows and the controller does not; handed over before events and outputs.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Observed {
    /// Segments that the step task has begun since power-up (wrapping): not those that it has only made ahead of their time.
    pub segments_begun: u32,
    /// Whether the step task has nothing left to do.
    pub step_idle: bool,
    /// Free bytes of the line queue.
    pub rx_free: u16,
    /// Line bytes received and not yet given, also those that have no room in the queue.
    pub received: u16,
    /// Bytes received since power-up (wrapping), commands aside: while it changes, the host is heard.
    pub heard: u16,
}

/// Which queues of the pump can take something now.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Room {
    /// One [`Output::Step`].
    pub step: bool,
    /// One [`Output::Reply`] or [`Output::Answer`].
    pub reply: bool,
}

/// What the controller wants done.
#[derive(Clone, Debug, PartialEq)]
// A message is copied by words then.
#[repr(u32)]
pub enum Output {
    /// For the step task.
    Step(ToStep),
    /// For the host.
    Reply(Chunk),
    /// The same behind the piece of work that it answers, as [`Output::Worked`]: there is more.
    Answer(Chunk),
    /// For the slow pins.
    Pins(SlowOutputs),
    /// For the tasks that own the fast pins.
    Wiring(Wiring),
    /// Stop the step task at once, as a reset does: mark and pend it. Answered by [`StepEvent::Stopped`].
    Stop,
    /// Look at the inputs; answered by [`Event::Pins`].
    ReadPins {
        /// Forget the counts of noise instead, without an answer.
        clear_noise: bool,
    },
    /// The next piece of the recording, or the first: to be given with `Controller::recorded`.
    ReadRecording {
        /// The listing begins.
        first: bool,
    },
    /// A change for the settings store, which `Controller::next_store` gives; answered by [`Event::Stored`] or
    /// [`Event::StoreFailed`].
    Store,
    /// A piece of work was done inside and there is more: ask again.
    Worked,
}
