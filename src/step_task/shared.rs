//! What tasks share without a channel or signal, because a message would be out of date when it is read: atomics, grouped by the
//! task that writes them. The table in docs/how-it-works.md has the reason of each.

use core::sync::atomic::{AtomicBool, AtomicU8, AtomicU16, AtomicU32, Ordering};
use oxmill_controller::Owed;
use oxmill_controller::messages::{Realtime, input};

/// The flag that wakes `control`; anyone may raise it.
pub type Wake = rtic_sync::signal::SignalWriter<'static, ()>;

/// Written by `step`.
pub struct StepStatus {
    /// Segments begun since power-up (wrapping).
    pub segments_begun: AtomicU32,
    /// Nothing moves and nothing is loaded.
    pub at_rest: AtomicBool,
    /// A message that is queued now must not wait for the next run; whoever queues one then pends the step vector. Each run writes 0 or 1, so the watchdog's [`STEP_ASKED`] in it stays only if there was none.
    pub wants: AtomicU8,
}

/// See [`StepStatus`].
pub static STEP: StepStatus =
    StepStatus { segments_begun: AtomicU32::new(0), at_rest: AtomicBool::new(true), wants: AtomicU8::new(1) };

/// `inputs`, in [`StepStatus::wants`]: no run since. Counts as a wish.
pub const STEP_ASKED: u8 = 2;

/// Written by `serial`.
pub struct SerialStatus {
    /// Line bytes put into the queue, or gathered for a message to it, since power-up (wrapping).
    pub bytes_queued: AtomicU32,
    /// Line bytes received since power-up (wrapping): those queued or gathered, and those that wait for room, as a command that does.
    pub bytes_received: AtomicU32,
    /// Bytes received that are neither of lines nor commands, since power-up (wrapping).
    pub bytes_ignored: AtomicU32,
    /// Commands received and line bytes queued since power-up (wrapping).
    pub heard: AtomicU32,
    /// How often a host that got the floor by it has opened a port since power-up (wrapping).
    pub hosts_came: AtomicU8,
    /// How often the host with the floor has gone since power-up (wrapping).
    pub hosts_went: AtomicU16,
    /// Commands for which there was no room, and which must not be lost; `control` takes them.
    owed: AtomicU32,
}

/// See [`SerialStatus`].
pub static SERIAL: SerialStatus = SerialStatus {
    bytes_queued: AtomicU32::new(0),
    bytes_received: AtomicU32::new(0),
    bytes_ignored: AtomicU32::new(0),
    heard: AtomicU32::new(0),
    hosts_came: AtomicU8::new(0),
    hosts_went: AtomicU16::new(0),
    owed: AtomicU32::new(0),
};

/// Written by `inputs`.
pub struct InputStatus {
    /// Pins that are low.
    pub low: AtomicU32,
    /// Changes of each input that the filter has rejected; `control`, which `inputs` preempts, sets them to 0.
    pub noise: [AtomicU16; input::COUNT],
}

/// See [`InputStatus`].
pub static INPUTS: InputStatus =
    InputStatus { low: AtomicU32::new(0), noise: [const { AtomicU16::new(0) }; input::COUNT] };

/// Written by `control`.
pub struct ControlStatus {
    /// The value of [`SerialStatus::heard`] up to which everything has been done and answered.
    free_at: AtomicU32,
    /// Whether characters of remarks are text. Not before its first turn: until then each byte is a command, as in Grbl.
    pub reads_characters: AtomicBool,
    /// See [`Power`].
    power: AtomicU32,
}

/// See [`ControlStatus`].
pub static CONTROL: ControlStatus = ControlStatus {
    free_at: AtomicU32::new(u32::MAX),
    reads_characters: AtomicBool::new(false),
    power: AtomicU32::new(0),
};

/// Marks of the watchdog: `inputs` sets them, each run of the task that is asked clears its own.
pub struct Asked {
    /// Cleared by each run of `serial`.
    pub serial: AtomicBool,
    /// Cleared by each round of `control`.
    pub control: AtomicBool,
}

/// See [`Asked`].
pub static ASKED: Asked = Asked { serial: AtomicBool::new(false), control: AtomicBool::new(false) };

/// Stops asked for since power-up (wrapping), by any task. A count and not a flag, so that each is answered.
static STOPS_ASKED: AtomicU16 = AtomicU16::new(0);

/// Asks the step task to stop at once. The caller pends the step vector right after it; the mark stays until the step
/// task has obeyed, so it can neither be lost nor be overtaken by what is queued.
pub fn ask_for_stop() {
    STOPS_ASKED.fetch_add(1, Ordering::Relaxed);
}

/// For `serial`, which finds no room for a command: whether it will be obeyed all the same. What becomes a reset by it
/// stops the step task, too; the caller then pends its vector, as after [`ask_for_stop`].
pub fn owe(command: Realtime) -> bool {
    let Some(owed) = Owed(SERIAL.owed.load(Ordering::Relaxed)).with(command) else { return false };
    if command.opens_epoch() && command != Realtime::Reset {
        ask_for_stop();
    }
    // `control`, which takes them, does not preempt.
    SERIAL.owed.store(owed.0, Ordering::Relaxed);
    true
}

/// Whether any commands are owed: until they are taken, nothing is queued.
pub fn owes() -> bool {
    SERIAL.owed.load(Ordering::Relaxed) != 0
}

/// For `control`, which has seen [`owes`] and then emptied the queue: what is owed came after all that was in it.
pub fn take_owed() -> Owed {
    Owed(SERIAL.owed.swap(0, Ordering::Relaxed))
}

/// How many stops have been asked for.
#[inline(always)]
pub fn stops_asked() -> u16 {
    STOPS_ASKED.load(Ordering::Relaxed)
}

/// For `control`: whether all that was heard up to the count `heard` is done and answered.
pub fn set_free(heard: u32, free: bool) {
    CONTROL.free_at.store(if free { heard } else { heard.wrapping_sub(1) }, Ordering::Relaxed);
}

/// For `serial`: whether nothing that any host has said is still to be done or answered.
pub fn is_free() -> bool {
    CONTROL.free_at.load(Ordering::Relaxed) == SERIAL.heard.load(Ordering::Relaxed)
}

/// What the spindle's PWM shows.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Power {
    /// The power itself.
    pub level: u16,
    /// Laser: while something moves, the segments carry the power.
    pub from_segments: bool,
}

impl Power {
    /// What `control` has set last.
    #[inline(always)]
    pub fn wanted() -> Power {
        let word = CONTROL.power.load(Ordering::Relaxed);
        Power { level: word as u16, from_segments: word >> 16 != 0 }
    }

    /// For `control`; and for `step`, which preempts it, to switch a beam off at a stop.
    pub fn want(self) {
        CONTROL.power.store(u32::from(self.level) | u32::from(self.from_segments) << 16, Ordering::Relaxed);
    }
}
