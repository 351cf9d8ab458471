//! Atomics that tasks share, grouped by the task that writes them. A channel or signal would not do for this data,
//! because a message could be out of date when it is read. The table in docs/how-it-works.md gives the reason for each.

use core::sync::atomic::{AtomicBool, AtomicU8, AtomicU16, AtomicU32, Ordering};
use oxmill_controller::DeferredCommands;
use oxmill_controller::messages::{Realtime, input};

/// The signal that wakes `control`; any task can set it.
pub type Wake = rtic_sync::signal::SignalWriter<'static, ()>;

/// Status that `step` publishes to the other tasks.
pub struct StepStatus {
    /// Segments begun since power-up (wrapping).
    pub segments_begun: AtomicU32,
    /// `true` while no motor turns and no message is loaded in the step task.
    pub at_rest: AtomicBool,
    /// Nonzero if `step` needs the next message at once. A task that queues a message must then pend the step vector.
    /// If the value is 0, the message can wait for the next scheduled run of `step`. Each run of `step` writes 0 or 1;
    /// the watchdog relies on that ([`STEP_ASKED`]).
    pub needs_message: AtomicU8,
}

/// Status of the step task. Only `step` writes it, except that the watchdog writes [`STEP_ASKED`] to `needs_message`.
pub static STEP: StepStatus =
    StepStatus { segments_begun: AtomicU32::new(0), at_rest: AtomicBool::new(true), needs_message: AtomicU8::new(1) };

/// Value that the watchdog (in `inputs`) writes into [`StepStatus::needs_message`] to check whether `step` runs. Each
/// run of `step` replaces the value. If the watchdog still finds it at its next check, `step` has not run. The value is
/// nonzero, so a task that queues a message in between still pends the step vector.
pub const STEP_ASKED: u8 = 2;

/// Status that `serial` publishes to the other tasks.
pub struct SerialStatus {
    /// Number of line bytes that `serial` has put into the queue to `control`, or gathered for its next message to
    /// `control`, since power-up (wrapping).
    pub bytes_queued: AtomicU32,
    /// Line bytes received since power-up (wrapping): `bytes_queued` plus the bytes that wait for room. A command that
    /// waits for room counts as one byte.
    pub bytes_received: AtomicU32,
    /// Number of bytes received that belong neither to lines nor to commands, since power-up (wrapping).
    pub bytes_ignored: AtomicU32,
    /// Number of received commands and queued line bytes since power-up (wrapping). A command that waits for room in
    /// the queue counts again at each attempt to queue it.
    pub activity: AtomicU32,
    /// Number of times that a host opened a port and became or remained the active host, since power-up (wrapping).
    pub hosts_came: AtomicU8,
    /// Number of times that the active host disconnected, since power-up (wrapping).
    pub hosts_went: AtomicU16,
    /// Commands for which the queue had no room and which must not be lost ([`DeferredCommands`]); `control` takes
    /// them.
    deferred: AtomicU32,
}

/// Status of the serial task. Only `serial` writes it, except that `control` clears the deferred commands
/// ([`take_deferred`]).
pub static SERIAL: SerialStatus = SerialStatus {
    bytes_queued: AtomicU32::new(0),
    bytes_received: AtomicU32::new(0),
    bytes_ignored: AtomicU32::new(0),
    activity: AtomicU32::new(0),
    hosts_came: AtomicU8::new(0),
    hosts_went: AtomicU16::new(0),
    deferred: AtomicU32::new(0),
};

/// Status that `inputs` publishes to the other tasks.
pub struct InputStatus {
    /// Mask of the input pins that are low, as read last and not filtered. Bit numbers: `input_bits` of the boards.
    pub low: AtomicU32,
    /// Number of changes of each input that the filter rejected. `control` resets the counts to 0 on request.
    pub noise: [AtomicU16; input::COUNT],
}

/// Status of the task `inputs`. Only `inputs` writes it, except that `control` clears `noise`.
pub static INPUTS: InputStatus =
    InputStatus { low: AtomicU32::new(0), noise: [const { AtomicU16::new(0) }; input::COUNT] };

/// Status that `control` publishes to the other tasks.
pub struct ControlStatus {
    /// If this equals [`SerialStatus::activity`], everything received has been executed and answered.
    free_at: AtomicU32,
    /// Whether UTF-8 characters in G-code comments are text. `false` until the first round of `control`. While it is
    /// `false`, each byte of such a character is a command or ignored, as in Grbl.
    pub reads_characters: AtomicBool,
    /// `true` if the controller replies as grblHAL does, and accepts grblHAL's additional realtime commands.
    pub speaks_grblhal: AtomicBool,
    /// The requested power of spindle or laser, encoded by [`Power::want`].
    power: AtomicU32,
}

/// Status of the control task. Only `control` writes it, except that `step` switches a laser off at a stop or underrun.
pub static CONTROL: ControlStatus = ControlStatus {
    free_at: AtomicU32::new(u32::MAX),
    reads_characters: AtomicBool::new(false),
    speaks_grblhal: AtomicBool::new(false),
    power: AtomicU32::new(0),
};

/// Flags of the watchdog. `inputs` sets them; each run of a task clears its own.
pub struct Asked {
    /// Cleared by each run of `serial`.
    pub serial: AtomicBool,
    /// Cleared by each round of `control`.
    pub control: AtomicBool,
}

/// The flags by which the watchdog finds out whether `serial` and `control` still run.
pub static ASKED: Asked = Asked { serial: AtomicBool::new(false), control: AtomicBool::new(false) };

/// Number of stops that any task has requested since power-up (wrapping). It is a count and not a flag, so that each
/// request is executed and counted.
static STOPS_ASKED: AtomicU16 = AtomicU16::new(0);

/// Requests an immediate stop of the step task. The caller must pend the step vector right afterwards. The request
/// remains until the step task has executed it, so it cannot be lost, and queued messages cannot overtake it.
pub fn ask_for_stop() {
    STOPS_ASKED.fetch_add(1, Ordering::Relaxed);
}

/// For `serial`: keeps a command for which the queue had no room, until `control` takes it. Returns `false` and keeps
/// nothing if the loss of the command does no harm.
///
/// A stop (0x19) and a jog cancel are kept as resets, and each reset needs a stop of the step task. This function
/// requests that stop for 0x19 and a jog cancel. For a reset, `serial` has already requested it. The caller must pend
/// the step vector afterwards, as for [`ask_for_stop`].
pub fn defer(command: Realtime) -> bool {
    let Some(deferred) = DeferredCommands(SERIAL.deferred.load(Ordering::Relaxed)).with(command) else { return false };
    if command.opens_epoch() && command != Realtime::Reset {
        ask_for_stop();
    }
    // A load and a separate store suffice: only `control` could change the value in between, and `control` does not
    // preempt `serial`.
    SERIAL.deferred.store(deferred.0, Ordering::Relaxed);
    true
}

/// Returns whether the serial task has commands for which the queue had no room (deferred commands). The serial task
/// queues no further command until `control` has taken these, so that commands keep their order.
pub fn has_deferred() -> bool {
    SERIAL.deferred.load(Ordering::Relaxed) != 0
}

/// For `control`: takes the deferred commands. They arrived after all commands in the queue. So `control` first checks
/// [`has_deferred`], then empties the queue, and only then calls this function.
pub fn take_deferred() -> DeferredCommands {
    DeferredCommands(SERIAL.deferred.swap(0, Ordering::Relaxed))
}

/// Returns how many stops have been requested since power-up (wrapping).
#[inline(always)]
pub fn stops_asked() -> u16 {
    STOPS_ASKED.load(Ordering::Relaxed)
}

/// For `control`: publishes whether everything received so far has been executed and answered (`free`). `activity`:
/// value of [`SerialStatus::activity`] that `control` read before it determined `free`. If more has arrived since,
/// [`is_free`] returns `false`.
pub fn set_free(activity: u32, free: bool) {
    CONTROL.free_at.store(if free { activity } else { activity.wrapping_sub(1) }, Ordering::Relaxed);
}

/// For `serial`: returns whether everything received from any host has been executed and answered.
pub fn is_free() -> bool {
    CONTROL.free_at.load(Ordering::Relaxed) == SERIAL.activity.load(Ordering::Relaxed)
}

/// Power to be output by the spindle's PWM.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Power {
    /// Power level, 0 to 65535 (full power).
    pub level: u16,
    /// Laser: while the machine moves, the power comes from the segments instead of `level`.
    pub from_segments: bool,
}

impl Power {
    /// Returns the power that [`Power::want`] has set most recently.
    #[inline(always)]
    pub fn wanted() -> Power {
        let word = CONTROL.power.load(Ordering::Relaxed);
        Power { level: word as u16, from_segments: word >> 16 != 0 }
    }

    /// Sets the power. Called by `control`, and by `step` to switch off a laser at a stop.
    pub fn want(self) {
        CONTROL.power.store(u32::from(self.level) | u32::from(self.from_segments) << 16, Ordering::Relaxed);
    }
}
