//! Messages between the controller and the pump, the loop that drives it (see `pump`): events in, outputs out, and the
//! state of the queues.

use super::host::{Chunk, LineByte, Realtime};
use super::inputs::{PinView, Sensed};
use super::outputs::{SlowOutputs, Wiring};
use super::step::{StepEvent, ToStep};

/// An event for the controller.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Event<const N: usize> {
    /// A realtime command from the host, such as 0x18 or `?`.
    Realtime(Realtime),
    /// A byte of a line. Must be passed only while `wants_line()` is true.
    Line(LineByte),
    /// A report of the step task.
    Step(StepEvent<N>),
    /// The inputs changed.
    Signals(Sensed),
    /// The answer to [`Output::ReadPins`].
    Pins(PinView),
    /// The change of the latest [`Output::Store`] is in flash.
    Stored,
    /// The change of the latest [`Output::Store`] could not be written.
    StoreFailed,
    /// A host has opened the port.
    Connected,
    /// The host whose lines are read has closed the port or is unplugged. Not every link can detect this. Carries the
    /// count (wrapping) of such events since power-up. Lines of this host that have not been read yet are not answered.
    /// They end at the [`HOST_CHANGED`](super::HOST_CHANGED) with the same count.
    Disconnected(u16),
}

/// Counters of the queues and of the step task. The pump, the loop that drives the controller, updates them before it
/// passes on events and takes outputs.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Observed {
    /// Segments started by the step task since power-up (wrapping). Segments that the step task has only computed ahead
    /// do not count.
    pub segments_begun: u32,
    /// The step task has nothing left to do.
    pub step_idle: bool,
    /// Free bytes of the line queue.
    pub rx_free: u16,
    /// Line bytes received and not yet read, including those for which the queue has no room.
    pub received: u16,
    /// Bytes received since power-up (wrapping), without commands. A change shows that the host is not silent.
    pub activity: u16,
}

/// Which of the queues to other tasks have room for an output of the controller.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Room {
    /// There is room for one [`Output::Step`].
    pub step: bool,
    /// There is room for one [`Output::Reply`] or [`Output::Answer`].
    pub reply: bool,
}

/// A request of the controller to the pump, the loop that drives it.
#[derive(Clone, Debug, PartialEq)]
// A tag of 32 bits makes the compiler copy a message word by word.
#[repr(u32)]
pub enum Output {
    /// A message for the step task. Needs [`Room::step`].
    Step(ToStep),
    /// Text for the host. Needs [`Room::reply`].
    Reply(Chunk),
    /// Text for the host, and there is more to do: [`Output::Reply`] and [`Output::Worked`] in one.
    Answer(Chunk),
    /// New levels for the slow pins.
    Pins(SlowOutputs),
    /// New wiring for the tasks that own the fast pins.
    Wiring(Wiring),
    /// Stops the step task at once, as for a reset: the pump sets the stop mark and pends the task. Answered by
    /// [`StepEvent::Stopped`].
    Stop,
    /// Reads the inputs; answered by [`Event::Pins`].
    ReadPins {
        /// `true`: clears the noise counters ([`PinView::noise`]) and sends no answer. `false`: reads the inputs.
        clear_noise: bool,
    },
    /// Requests the next item of the `$REC` listing. The pump passes the item to `Controller::recorded`.
    ReadRecording {
        /// `true`: starts again with the first item.
        first: bool,
    },
    /// A change of the settings store is ready; the pump gets it from `Controller::next_store`. Answered by
    /// [`Event::Stored`] or [`Event::StoreFailed`].
    Store,
    /// The controller has done a piece of its work and has more to do: call `output` again.
    Worked,
}
