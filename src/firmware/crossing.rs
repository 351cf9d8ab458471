//! What crosses between tasks without a queue, because a message would lie or cost too much. Each name has one writer,
//! unless it says otherwise; all else goes through the channels that `main` declares.

use crate::boards::AXES;
use core::sync::atomic::{AtomicBool, AtomicI32, AtomicU8, AtomicU16, AtomicU32, Ordering};
use oxmill_controller::Owed;
use oxmill_controller::messages::{Realtime, input};

/// The flag that wakes `control`; anyone may raise it.
pub type Wake = rtic_sync::signal::SignalWriter<'static, ()>;

/// `step`: segments begun since power-up (wrapping).
pub static SEGMENTS_BEGUN: AtomicU32 = AtomicU32::new(0);
/// `step`: nothing moves and nothing is loaded.
pub static STEP_AT_REST: AtomicBool = AtomicBool::new(true);
/// `step`: there is room for a message ahead of its time; whoever queues one then pends the step vector, for the next tick
/// may be too late. Each run writes 0 or 1, so the watchdog's [`STEP_ASKED`] in it stays only if there was none.
pub static STEP_WANTS: AtomicU8 = AtomicU8::new(1);
/// `inputs`, in [`STEP_WANTS`]: no run since. Counts as a wish.
pub const STEP_ASKED: u8 = 2;
/// `inputs` sets it, each run of `serial` clears it.
pub static SERIAL_ASKED: AtomicBool = AtomicBool::new(false);
/// `inputs` sets it, each round of `control` clears it.
pub static CONTROL_ASKED: AtomicBool = AtomicBool::new(false);
/// `serial`: bytes put into the line queue since power-up (wrapping).
pub static LINE_BYTES_IN: AtomicU32 = AtomicU32::new(0);
/// `serial`: commands received and line bytes queued since power-up (wrapping).
pub static HEARD: AtomicU32 = AtomicU32::new(0);
/// `control`: the value of [`HEARD`] up to which everything has been done and answered.
static FREE_AT: AtomicU32 = AtomicU32::new(u32::MAX);
/// `serial`: how often a host that got the floor by it has opened a port since power-up (wrapping).
pub static HOSTS_CAME: AtomicU8 = AtomicU8::new(0);
/// `serial`: how often the host with the floor has gone since power-up (wrapping).
pub static HOSTS_WENT: AtomicU16 = AtomicU16::new(0);
/// `serial`: line bytes received since power-up (wrapping): those in the queue, and those that wait for room in it.
pub static LINE_BYTES_RECEIVED: AtomicU32 = AtomicU32::new(0);
/// `serial`: it holds a byte for which there was no room, and wants to be called when there is.
pub static RX_HELD: AtomicBool = AtomicBool::new(false);
/// `inputs`: pins that are low, and those that the board has.
pub static INPUTS_LOW: AtomicU16 = AtomicU16::new(0);
/// See [`INPUTS_LOW`].
pub static INPUTS_FITTED: AtomicU16 = AtomicU16::new(0);
/// `inputs`: changes of each input that the filter has rejected; `control`, which it preempts, sets them to 0.
pub static NOISE: [AtomicU16; input::COUNT] = [const { AtomicU16::new(0) }; input::COUNT];
/// `control`: machine position in micrometres after its last turn, for the record of a failure.
pub static LAST_PLACE: [AtomicI32; AXES] = [const { AtomicI32::new(0) }; AXES];
/// `control`: N word of what was running then.
pub static LAST_LINE: AtomicU32 = AtomicU32::new(0);
/// `serial`: commands for which there was no room, and which must not be lost; `control` takes them.
static OWED: AtomicU32 = AtomicU32::new(0);
/// `control`: see [`Power`].
static POWER: AtomicU32 = AtomicU32::new(0);
/// Stops asked for since power-up (wrapping). A count and not a flag, so that each is answered.
static STOPS_ASKED: AtomicU16 = AtomicU16::new(0);

/// Asks the step task to stop at once. The caller pends the step vector right after it; the mark stays until the step
/// task has obeyed, so it can neither be lost nor be overtaken by what is queued.
pub fn ask_for_stop() {
    STOPS_ASKED.fetch_add(1, Ordering::Relaxed);
}

/// For `serial`, which finds no room for a command: whether it will be obeyed all the same. What becomes a reset by it
/// stops the step task, too; the caller then pends its vector, as after [`ask_for_stop`].
pub fn owe(command: Realtime) -> bool {
    let Some(owed) = Owed(OWED.load(Ordering::Relaxed)).with(command) else { return false };
    if command.opens_epoch() && command != Realtime::Reset {
        ask_for_stop();
    }
    // `control`, which takes them, does not preempt.
    OWED.store(owed.0, Ordering::Relaxed);
    true
}

/// Whether any commands are owed: until they are taken, nothing is queued.
pub fn owes() -> bool {
    OWED.load(Ordering::Relaxed) != 0
}

/// For `control`, which has seen [`owes`] and then emptied the queue: what is owed came after all that was in it.
pub fn take_owed() -> Owed {
    Owed(OWED.swap(0, Ordering::Relaxed))
}

/// How many stops have been asked for.
#[inline(always)]
pub fn stops_asked() -> u16 {
    STOPS_ASKED.load(Ordering::Relaxed)
}

/// For `control`: whether all that was heard up to the count `heard` is done and answered.
pub fn set_free(heard: u32, free: bool) {
    FREE_AT.store(if free { heard } else { heard.wrapping_sub(1) }, Ordering::Relaxed);
}

/// For `serial`: whether nothing that any host has said is still to be done or answered.
pub fn is_free() -> bool {
    FREE_AT.load(Ordering::Relaxed) == HEARD.load(Ordering::Relaxed)
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
        let word = POWER.load(Ordering::Relaxed);
        Power { level: word as u16, from_segments: word >> 16 != 0 }
    }

    /// For `control`; and for `step`, which preempts it, to switch a beam off at a stop.
    pub fn want(self) {
        POWER.store(u32::from(self.level) | u32::from(self.from_segments) << 16, Ordering::Relaxed);
    }
}
