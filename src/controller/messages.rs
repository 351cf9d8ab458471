//! Every type that crosses between tasks, and the depth of every queue (`LINES_DEPTH`): `Realtime` commands, `LineByte`
//! and several of them (`LineBytes`, `LINE_MESSAGES`), `ToStep` with `AxisSteps` and `Segment`, `StepEvent`; the bits
//! of input pins (`input::PROBE`, `AT_SPEED`, `DRIVER_FAULT`) as `Signals`, `Sensed` and `PinView`; `Event` and
//! `Output` of the controller, `SlowOutputs`, and `Wiring` with its inverts and pull-ups; how a start came about
//! (`Restart`, `Crash`, `CrashKind`, `ResetCause`); `Record` of the store; and the entries of a recording (`Noted`,
//! `Standing`). Bits and depths are `STEP_BITS`, `PARTS`, `FARTHEST`, `FLAG_NEW_BLOCK`, `FLAG_LAST`, `FLAG_WAIT`,
//! `FLAG_RAPID`, `REALTIME_DEPTH`, `REPLIES_DEPTH`, `HOST_BYTES`; inputs also `EMERGENCY_STOP`, `SECOND_PROGRAM`,
//! `SECOND_SWITCH`, `HOLD`. `Observed`, `Room`, `Chunk`, `Coolant`, `SpindleDirection`, `InputWiring`, `GangedMotors`,
//! `Stopping` and `Recorded` too; `JogCancel` or a reset `opens_epoch`. Lists are of `heapless`.
//!
//! ```text
//!  serial ──realtime──▶ control ──segments──▶ step        stops: a sticky mark that `step` looks at first
//!  serial ──lines─────▶ control ◀──events──── step
//!  inputs ──signals───▶ control ──replies───▶ serial      (armed inputs raise it, too)
//! ```
//! What happens when a queue is full is written at its depth.

use crate::axes::PerAxis;
use crate::units::Coordinate;

/// Depth of serial -> control, realtime commands. `control` drains it in each turn, and 5 ms of nothing but commands at
/// 115200 baud fit. Full: the link waits where it can; on a plain UART resets, holds and the door are kept as marks
/// (`protocol::link::Owed`), other commands are reported as lost.
pub const REALTIME_DEPTH: usize = 64;
/// Bytes of lines that fit between serial and control; what `Bf:` counts. Full: receive is paused where the link has
/// back-pressure (USB, QEMU; see `protocol::link`); on a plain UART the byte is dropped and the next one says so ([`LineByte::damaged`]).
pub const LINES_DEPTH: usize = 255;
/// Depth of serial -> control, in messages of such bytes. They fit however they arrive (see `protocol::line_queue`), also with a
/// jog cancel behind each line: the shortest jog, `$J=X1F9` with its end, has 8 bytes. One more may be on its way out.
pub const LINE_MESSAGES: usize = LINES_DEPTH.div_ceil(8) + MOST_PARTIAL + 1;
/// So many messages are sent before they are full, since the queue was last seen empty, besides those that an epoch ends.
pub const MOST_PARTIAL: usize = 4;
/// Depth of control -> step. Full: `control` keeps the message for its next turn. Time, not this depth, is what
/// normally bounds it (see `QUEUED_TIME_MS` in `motion`).
pub const SEGMENTS_DEPTH: usize = 64;
/// Depth of step -> control. One entry for each stop, underrun or probe contact; `control` drains it in each turn. Full:
/// the step task keeps the event and sends it at its next entry.
pub const EVENTS_DEPTH: usize = 4;
/// Depth of control -> serial, in chunks. Full: `control` keeps its text; a slow host slows its own answers only.
pub const REPLIES_DEPTH: usize = 32;
/// Depth of inputs -> control. Full: the newest state replaces what could not be sent, as levels and not edges cross; the
/// stops that inputs have asked for are counted ([`Sensed::trips`]), so none of them is forgotten.
pub const SIGNALS_DEPTH: usize = 8;

/// A command that acts at once, even in the middle of a line; one byte on the wire.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[allow(missing_docs, reason = "Grbl's own names; bytes in protocol::realtime")]
pub enum Realtime {
    /// 0x18. The sender has also raised the sticky stop of the step task.
    Reset,
    /// 0x19, as in grblHAL: brake, forget what is queued, keep position and modal state.
    Stop,
    Status,
    CycleStart,
    FeedHold,
    SafetyDoor,
    JogCancel,
    FeedReset,
    FeedUp10,
    FeedDown10,
    FeedUp1,
    FeedDown1,
    RapidFull,
    RapidHalf,
    RapidQuarter,
    SpindleReset,
    SpindleUp10,
    SpindleDown10,
    SpindleUp1,
    SpindleDown1,
    SpindleStop,
    FloodToggle,
    MistToggle,
    /// 0x89, as in grblHAL: the program pauses behind each line that moves, or no longer.
    SingleBlock,
}

impl Realtime {
    /// Whether it begins another epoch of line bytes: see [`LineByte`].
    pub fn opens_epoch(self) -> bool {
        matches!(self, Realtime::Reset | Realtime::Stop | Realtime::JogCancel)
    }
}

/// In place of a byte of a line: what has come of the line is void, for its host has gone or lost the floor. No host can
/// send it, as 0x18 is a command. In place of the epoch it has the number (wrapping) of hosts that have gone before it, as
/// [`Event::Disconnected`].
pub const HOST_CHANGED: u8 = 0x18;

/// A byte of a line and the epoch it came in: the number (wrapping) of resets, stops and jog cancels that had been handed
/// to `control` before it. So a byte sent before a reset is dropped and one sent after it never is, although the two queues to
/// `control` keep no order between them.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct LineByte {
    /// The byte.
    pub byte: u8,
    /// The epoch when it came.
    pub epoch: u16,
    /// Bytes before this one were lost: the line it belongs to is refused.
    pub damaged: bool,
}

/// serial -> control: bytes of lines that were received one after the other, all of one epoch. A message for each of them
/// would cost more than to read it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct LineBytes {
    epoch: u16,
    /// A bit for each byte: [`LineByte::damaged`].
    damaged: u16,
    len: u8,
    bytes: [u8; LineBytes::MOST],
}

impl LineBytes {
    /// So many fit.
    pub const MOST: usize = 15;
    /// None.
    pub const EMPTY: LineBytes = LineBytes { epoch: 0, damaged: 0, len: 0, bytes: [0; LineBytes::MOST] };

    /// How many there are.
    #[inline]
    pub fn len(&self) -> usize {
        self.len.into()
    }

    /// Whether there are none.
    #[inline]
    pub fn is_empty(&self) -> bool {
        self.len == 0
    }

    /// Adds one. `false`: there is no room, or it is of another epoch.
    #[inline]
    pub fn push(&mut self, byte: LineByte) -> bool {
        if self.len == 0 {
            (self.epoch, self.damaged) = (byte.epoch, 0);
        }
        let (same, place) = (self.epoch == byte.epoch, self.bytes.get_mut(usize::from(self.len)));
        let Some(place) = place.filter(|_| same) else { return false };
        *place = byte.byte;
        self.damaged |= u16::from(byte.damaged) << self.len;
        self.len += 1;
        true
    }

    /// Adds as many of some undamaged bytes as there is room for; none if they are of another epoch. Gives how many.
    #[inline]
    pub fn extend(&mut self, epoch: u16, bytes: &[u8]) -> usize {
        if self.len == 0 {
            (self.epoch, self.damaged) = (epoch, 0);
        }
        let room = self.bytes.get_mut(usize::from(self.len)..).filter(|_| self.epoch == epoch).unwrap_or_default();
        let count = room.len().min(bytes.len());
        for (place, byte) in room.iter_mut().zip(bytes) {
            *place = *byte;
        }
        self.len += count as u8;
        count
    }

    /// Their epoch and the bytes from a place on, if none of all is damaged.
    #[inline]
    pub fn undamaged(&self, from: usize) -> (u16, &[u8]) {
        let bytes = if self.damaged == 0 { self.bytes.get(from..self.len()) } else { None };
        (self.epoch, bytes.unwrap_or_default())
    }

    /// The byte at a place, from 0.
    #[inline]
    pub fn get(&self, place: usize) -> Option<LineByte> {
        let byte = *self.bytes.get(place).filter(|_| place < self.len())?;
        Some(LineByte { byte, epoch: self.epoch, damaged: self.damaged >> place & 1 != 0 })
    }
}

/// control -> step. At most 16 bytes, so that a receive in the step interrupt stays cheap.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum ToStep {
    /// Steps of the axes A, B and C of the next block; sent before its [`ToStep::Block`] if any of them moves.
    BlockRest {
        /// The parts of A, B, C.
        steps_by_axis: [AxisSteps; 3],
    },
    /// The straight move that the following segments are pieces of. Takes effect with the first of them.
    Block {
        /// The parts of X, Y, Z.
        steps_by_axis: [AxisSteps; 3],
        /// Bit set = axis moves to negative; bit 0 is X.
        directions: u8,
    },
    /// The block just sent is entered at this many units and not at its start: it was left for a detour.
    Reenter {
        /// Units of the block that have been done.
        units: u32,
    },
    /// A piece of the current block.
    Segment(Segment),
    /// Looks for the probe at each tick from here on. Once it is active (`Some(true)`) or no longer active
    /// (`Some(false)`) the place is latched and reported with [`StepEvent::Probed`], what is queued is thrown away, and
    /// the step task brakes by itself; it takes nothing more until it has been stopped and resumed. `None` ends the watch.
    Watch {
        /// The awaited state of the probe.
        probe: Option<bool>,
        /// How hard to brake: the deceleration in units per square of a step-clock tick.
        braking: f32,
    },
    /// Opens the step task after a stop: everything queued before it is thrown away. `stops` is the count of stops that
    /// `control` knew of; the gate stays shut when there has been another one since.
    Resume {
        /// Value of [`StepEvent::Stopped::stops`] that this answers.
        stops: u16,
    },
}

/// The part of one axis in a block: its steps, and how far the true ends of the move are from the steps they are rounded
/// to.
///
/// A line begins and ends on steps. A chord of an arc does not, or rounding would bend the arc: it is stepped along its true
/// ends. How far they are is told in sevenths of a step, positive in the direction of motion (of an axis without steps: to
/// positive).
///
/// One word: steps in the lower 26 bits, then three bits of each end.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[repr(transparent)]
pub struct AxisSteps(u32);

impl AxisSteps {
    /// Less than 2 to the power of this are the steps of an axis in a block.
    pub const STEP_BITS: u32 = 26;
    /// Parts of a step in which the ends are told. Odd, so that there are as many on either side of zero.
    pub const PARTS: u32 = 7;
    /// The ends are this many parts from a step at most.
    pub const FARTHEST: i32 = 3;
    const STEPS: u32 = (1 << Self::STEP_BITS) - 1;

    /// From step to step.
    #[inline]
    pub const fn on_steps(steps: u32) -> AxisSteps {
        AxisSteps(steps & Self::STEPS)
    }

    /// With true ends, each within [`AxisSteps::FARTHEST`].
    #[inline]
    pub const fn with_ends(steps: u32, start: i32, end: i32) -> AxisSteps {
        AxisSteps(steps & Self::STEPS | (start as u32 & 7) << Self::STEP_BITS | (end as u32) << (Self::STEP_BITS + 3))
    }

    /// Unsigned steps.
    #[inline]
    pub const fn steps(self) -> u32 {
        self.0 & Self::STEPS
    }

    /// True start less rounded start, in sevenths of a step.
    #[inline]
    pub const fn start(self) -> i32 {
        (self.0 << 3) as i32 >> (Self::STEP_BITS + 3)
    }

    /// True end less rounded end, in sevenths of a step.
    #[inline]
    pub const fn end(self) -> i32 {
        self.0 as i32 >> (Self::STEP_BITS + 3)
    }

    /// All of it.
    #[inline]
    pub const fn word(self) -> u32 {
        self.0
    }

    /// Whether both ends are on steps.
    #[inline]
    pub const fn is_on_steps(self) -> bool {
        self.0 <= Self::STEPS
    }
}

/// Some ticks with evenly changing intervals. The unit of progress within a block is 1/16 of a step of its dominant axis
/// ([`UNITS_PER_STEP`]); a tick advances `UNITS_PER_STEP >> level` of them.
///
/// Packed, because padding to four bytes would make a [`ToStep`] of 20 bytes; the CPU loads unaligned words as fast.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(C, packed(2))]
pub struct Segment {
    /// Step-clock ticks before the first tick of the segment, in fixed point with [`INTERVAL_FRACTION_BITS`]; each
    /// further tick follows after `ramp` more.
    pub interval: u32,
    /// Change of the interval from tick to tick, same fixed point.
    pub ramp: i32,
    /// How many ticks, at least 1.
    pub ticks: u16,
    /// Spindle or laser power from the first tick on, 0 (off) to 65535 (full).
    pub power: u16,
    /// Smoothing: 2^level ticks make a step of the dominant axis; 0..=4.
    pub level: u8,
    /// See the `FLAG_` constants of [`Segment`].
    pub flags: u8,
}

impl Segment {
    /// The segment begins the block sent last.
    pub const FLAG_NEW_BLOCK: u8 = 1;
    /// Motion is at rest after this segment: an empty queue is no fault.
    pub const FLAG_LAST: u8 = 2;
    /// Time passes and nothing moves: the ticks advance no units (feeds slower than the timer's reach).
    pub const FLAG_WAIT: u8 = 4;
    /// The move is a rapid. The step task does not care; those who draw what it did do.
    pub const FLAG_RAPID: u8 = 8;
}

/// Fraction bits of [`Segment::interval`].
pub const INTERVAL_FRACTION_BITS: u32 = 12;
/// Units of progress in one step of the dominant axis.
pub const UNITS_PER_STEP: u32 = 16;

/// step -> control.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum StepEvent<const N: usize> {
    /// Pulses have stopped because someone asked (reset, limit).
    Stopped {
        /// How often this has happened since power-up (wrapping).
        stops: u16,
        /// Whether the machine was stepping when the stop came.
        moving: bool,
        /// Step counter of each axis: net steps since power-up (wrapping).
        position: PerAxis<i32, N>,
    },
    /// The probe has reached the awaited state; the step task brakes.
    Probed {
        /// Step counter of each axis at the tick that saw it.
        position: PerAxis<i32, N>,
    },
    /// The queue ran dry at speed. Pulses have stopped; counts as a stop.
    Underrun {
        /// As in [`StepEvent::Stopped`].
        stops: u16,
        /// As in [`StepEvent::Stopped`].
        position: PerAxis<i32, N>,
    },
    /// The outputs have not put out what they were told to: the position is not what the count says. Pulses have stopped;
    /// counts as a stop.
    Miscounted {
        /// As in [`StepEvent::Stopped`].
        stops: u16,
        /// As in [`StepEvent::Stopped`].
        position: PerAxis<i32, N>,
    },
}

/// Bit of [`Signals::limits`] for the switch at the second motor of an axis that has two.
pub const SECOND_SWITCH: u8 = 1 << 6;

/// Bits of a word of inputs; limit switches have those of [`Signals::limits`], from 0 on.
pub mod input {
    /// First input of the program (M66 P0).
    pub const PROGRAM: u32 = 7;
    /// Touch probe.
    pub const PROBE: u32 = 8;
    /// Safety door.
    pub const DOOR: u32 = 9;
    /// Feed-hold button.
    pub const HOLD: u32 = 10;
    /// Cycle-start (resume) button.
    pub const START: u32 = 11;
    /// Reset (abort) button.
    pub const RESET: u32 = 12;
    /// Emergency stop.
    pub const EMERGENCY_STOP: u32 = 13;
    /// Fault output of a motor driver.
    pub const DRIVER_FAULT: u32 = 14;
    /// The spindle is up to speed.
    pub const AT_SPEED: u32 = 15;
    /// Second input of the program (M66 P1).
    pub const SECOND_PROGRAM: u32 = 16;
    /// How many bits are in use.
    pub const COUNT: usize = 17;
}

/// Filtered levels of the input pins; a bit is set while the input is *active* (polarity already applied).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Signals {
    /// Limit switches, bit 0 for X; [`SECOND_SWITCH`] for the second motor of a ganged axis.
    pub limits: u8,
    /// Probe touches.
    pub probe: bool,
    /// Safety door open.
    pub door: bool,
    /// Feed-hold button.
    pub hold: bool,
    /// Cycle-start button.
    pub start: bool,
    /// Reset (abort) button.
    pub reset: bool,
    /// Emergency stop.
    pub emergency_stop: bool,
    /// A motor driver reports a fault.
    pub driver_fault: bool,
    /// The input for a spindle that tells its speed (`$915`).
    pub at_speed: bool,
    /// Inputs of the program (M66), bit 0 for P0.
    pub program: u8,
}

impl Signals {
    /// Nothing is active.
    pub const NONE: Signals = Signals {
        limits: 0,
        probe: false,
        door: false,
        hold: false,
        start: false,
        reset: false,
        emergency_stop: false,
        driver_fault: false,
        at_speed: false,
        program: 0,
    };

    /// The inputs of a word, see [`input`].
    pub fn of_word(word: u32) -> Signals {
        let bit = |n: u32| word >> n & 1 != 0;
        Signals {
            limits: word as u8 & 0x7F,
            probe: bit(input::PROBE),
            door: bit(input::DOOR),
            hold: bit(input::HOLD),
            start: bit(input::START),
            reset: bit(input::RESET),
            emergency_stop: bit(input::EMERGENCY_STOP),
            driver_fault: bit(input::DRIVER_FAULT),
            at_speed: bit(input::AT_SPEED),
            program: u8::from(bit(input::PROGRAM)) | u8::from(bit(input::SECOND_PROGRAM)) << 1,
        }
    }

    /// The word of these inputs, see [`input`].
    pub fn word(&self) -> u32 {
        let bit = |on: bool, n: u32| u32::from(on) << n;
        u32::from(self.limits)
            | bit(self.probe, input::PROBE)
            | bit(self.door, input::DOOR)
            | bit(self.hold, input::HOLD)
            | bit(self.start, input::START)
            | bit(self.reset, input::RESET)
            | bit(self.emergency_stop, input::EMERGENCY_STOP)
            | bit(self.driver_fault, input::DRIVER_FAULT)
            | bit(self.at_speed, input::AT_SPEED)
            | bit(self.program & 1 != 0, input::PROGRAM)
            | bit(self.program & 2 != 0, input::SECOND_PROGRAM)
    }
}

/// inputs -> control.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Sensed {
    /// The levels now.
    pub signals: Signals,
    /// How often armed inputs ([`Wiring::armed`]) have stopped the step task since power-up (wrapping).
    pub trips: u8,
    /// Which inputs did so since the message before: they may be inactive again.
    pub tripped: u32,
}

/// The inputs as they are at this moment, for `$PINS`; bits as in [`input`].
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct PinView {
    /// Inputs that have a pin.
    pub fitted: u32,
    /// Pins that are low, before polarity and filter.
    pub low: u32,
    /// Changes of each pin that the filter has rejected since power-up or the last clearing (saturating).
    pub noise: [u16; input::COUNT],
}

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
    /// Not every link can tell. Its lines, up to the [`HOST_CHANGED`] of this number, get no answers.
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
    /// One [`Output::Reply`].
    pub reply: bool,
}

/// A few bytes of answer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Chunk {
    /// How many of `bytes` count, 1..=15.
    pub len: u8,
    /// The text.
    pub bytes: [u8; 15],
}

impl Chunk {
    /// The bytes that count.
    pub fn as_bytes(&self) -> &[u8] {
        self.bytes.get(..usize::from(self.len)).unwrap_or(&[])
    }
}

/// Which way the spindle turns.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum SpindleDirection {
    /// M5.
    #[default]
    Off,
    /// M3.
    Clockwise,
    /// M4.
    CounterClockwise,
}

/// Coolant outputs.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Coolant {
    /// M8.
    pub flood: bool,
    /// M7.
    pub mist: bool,
}

/// Levels of the outputs that change slowly; `control` writes them.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SlowOutputs {
    /// Spindle enable and direction.
    pub spindle: SpindleDirection,
    /// Spindle power, 0 (off) to 65535 (full).
    pub power: u16,
    /// Laser: while the step task is busy the power of its segments ([`Segment::power`]) holds instead of `power`.
    pub power_from_segments: bool,
    /// Coolant.
    pub coolant: Coolant,
    /// Motor drivers on.
    pub drivers: bool,
    /// Digital outputs of the program (M62 to M65), bit 0 for P0.
    pub digital: u8,
}

/// Wiring facts that the pump's own tasks need, from the settings; sent at start and after each change.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Wiring {
    /// `$0`, length of a step pulse in tenths of a microsecond.
    pub pulse_tenths: u16,
    /// `$29`, time from a direction change to the next step in microseconds.
    pub direction_setup_us: u8,
    /// `$2`, bit set = step output active low.
    pub step_invert: u8,
    /// `$3`, bit set = direction output inverted.
    pub direction_invert: u8,
    /// `$4`, enable output inverted.
    pub enable_invert: bool,
    /// `$33`, frequency of the PWM for spindle or laser, 1 to 100,000 Hz.
    pub pwm_hz: u32,
    /// `$6`, probe input inverted: for the step task, which looks at the pin itself.
    pub probe_invert: bool,
    /// Polarity and pull resistors of the inputs.
    pub inputs: InputWiring,
    /// Inputs ([`input`]) that stop the step task as soon as they become active, before `control` hears of it.
    pub armed: u32,
    /// `$905`, the axis whose steps the second motor takes too, bit 0 for X; 0 = none.
    pub ganged: u8,
    /// `$906`, the second motor turns the other way.
    pub ganged_invert: bool,
    /// Which of the two motors take their steps. Changes at rest only.
    pub ganged_motors: GangedMotors,
}

/// Polarity and pull resistors of the inputs, words as in [`input`].
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct InputWiring {
    /// Active while the pin is high (else while it is low, as with a switch to ground and a pull-up).
    pub inverted: u32,
    /// No pull-up.
    pub no_pull_up: u32,
    /// A pull-down instead.
    pub pull_down: u32,
}

impl InputWiring {
    /// Pull-ups, and active low.
    pub const PULL_UPS: InputWiring = InputWiring { inverted: 0, no_pull_up: 0, pull_down: 0 };
}

/// The motors of a ganged axis that take part in a move.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum GangedMotors {
    /// Both, as always but in squaring.
    #[default]
    Both,
    /// The one on the axis' own pins.
    First,
    /// The other one.
    Second,
}

/// Why the processor was reset.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ResetCause {
    /// Power came on.
    Power,
    /// The reset pin.
    Pin,
    /// The program asked for it.
    Software,
    /// The supply sank and rose again.
    BrownOut,
    /// The watchdog was not fed: a task stood still.
    Watchdog,
    /// None of these.
    Other,
}

/// What brought the program before the reset to its end.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum CrashKind {
    /// A check in the program failed.
    Panic,
    /// The processor refused an instruction or an address.
    Fault,
    /// The stack ran out of its memory.
    StackOverflow,
    /// A task stood still.
    Stuck,
    /// The supply sank.
    Voltage,
}

impl CrashKind {
    /// All of them, in the order of their numbers in RAM that outlives a reset.
    pub const ALL: [CrashKind; 5] =
        [CrashKind::Panic, CrashKind::Fault, CrashKind::StackOverflow, CrashKind::Stuck, CrashKind::Voltage];
}

/// The last words of the program before the reset.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Crash {
    /// What happened.
    pub kind: CrashKind,
    /// Where, or which task; printable ASCII.
    pub text: heapless::Vec<u8, 120>,
    /// Machine position, micrometres, and N word (0 = none) of what was running, as the control task saw them last.
    pub place: [i32; 3],
    /// See `place`.
    pub line: u32,
    /// When that was: microseconds since power-up (wrapping).
    pub moment: u32,
}

/// How this start came about.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Restart {
    /// What the processor says.
    pub cause: ResetCause,
    /// What the program before it has left, if it came to a bad end.
    pub crash: Option<Crash>,
    /// There is a recording of what came in before it.
    pub is_recorded: bool,
}

impl Restart {
    /// Power came on, and nothing is known of before.
    pub const POWER: Restart = Restart { cause: ResetCause::Power, crash: None, is_recorded: false };

    /// Whether the machine was stopped by a failure and not by somebody.
    pub fn is_failure(&self) -> bool {
        self.crash.is_some() || matches!(self.cause, ResetCause::Watchdog | ResetCause::BrownOut)
    }
}

/// Key of the record by which a store tells that it has been damaged and has lost others. It is empty, and holds until it is
/// removed.
pub const STORE_DAMAGED: u16 = 65_534;

/// A record of the settings store: a key and up to 100 bytes.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Record {
    /// What is stored; the meaning belongs to the controller.
    pub key: u16,
    /// The value.
    pub value: heapless::Vec<u8, 100>,
}

/// A change of the settings store.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Store {
    /// Write a record, replacing the one with its key.
    Put(Record),
    /// Remove all records with keys from `from` to `until - 1`.
    Remove {
        /// First key.
        from: u16,
        /// First key that stays.
        until: u16,
    },
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

/// The state of a machine at rest from which what follows can be played again: nothing is open in the program, nothing is
/// switched on, no offset holds but those that are stored, and no override.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Standing {
    /// Step counter of each axis: net steps since power-up (wrapping).
    pub counters: heapless::Vec<i32, { Standing::AXES }>,
    /// The machine position, as programmed.
    pub place: heapless::Vec<Coordinate, { Standing::AXES }>,
    /// Whether that is true, as far as can be known.
    pub trusted: bool,
    /// Locked without an alarm, as after power-up with homing.
    pub locked: bool,
    /// G20; the words are in millimetres.
    pub inches: bool,
    /// The tool in the spindle.
    pub tool: u32,
    /// Inputs that are active, as in [`input`].
    pub active: u32,
    /// What stays in force, as a line of G-code.
    pub words: heapless::Vec<u8, 64>,
}

impl Standing {
    /// Axes that a machine can have.
    pub const AXES: usize = 6;
}

/// What the step task has reported, as it is recorded.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[allow(missing_docs, reason = "see `StepEvent`")]
pub enum Stopping {
    AtRest,
    Moving,
    Probed,
    Underrun,
    Miscounted,
}

impl Stopping {
    /// All of them, in the order of their numbers.
    pub const ALL: [Stopping; 5] =
        [Stopping::AtRest, Stopping::Moving, Stopping::Probed, Stopping::Underrun, Stopping::Miscounted];
}

/// An entry of a recording.
#[derive(Clone, Debug, PartialEq, Eq)]
#[allow(clippy::large_enum_variant, reason = "one at a time, on the stack")]
pub enum Noted {
    /// Power came on.
    PowerUp,
    /// Bytes of lines, at the end of the last of them.
    Host(heapless::Vec<u8, { Noted::HOST_BYTES }>),
    /// More bytes waited behind the line before.
    More,
    /// A realtime command, by its byte.
    Command(u8),
    /// Inputs that are active, and those that have stopped motion meanwhile; words as in [`input`].
    Inputs {
        /// Active.
        active: u32,
        /// Were active for a moment at least.
        tripped: u32,
    },
    /// The step task has reported, with its counters.
    Step(Stopping, heapless::Vec<i32, { Standing::AXES }>),
    /// The store has answered.
    Stored(bool),
    /// A host has opened the port.
    Connected,
    /// A host has gone.
    Disconnected,
    /// Bytes were lost here.
    Damaged,
    /// The rest of a line is void: see [`HOST_CHANGED`].
    Cut,
    /// The machine has come to rest.
    Rest {
        /// Step counters.
        counters: heapless::Vec<i32, { Standing::AXES }>,
        /// Hash of all blocks since the last stop.
        blocks: u32,
    },
    /// A state from which a replay can begin.
    Standing {
        /// The state.
        standing: Standing,
        /// As in [`Noted::Rest`].
        blocks: u32,
    },
    /// The program has ended.
    Ended {
        /// How; nothing if that is not known.
        crash: Option<CrashKind>,
        /// See [`Crash::place`].
        place: [i32; 3],
        /// See [`Crash::place`].
        line: u32,
    },
}

impl Noted {
    /// Bytes of the host in an entry. A longer line has several.
    pub const HOST_BYTES: usize = 60;
    /// In place of the number of a [`CrashKind`].
    pub const NO_CRASH: u8 = u8::MAX;
}

/// A piece of a recording that is listed.
#[derive(Clone, Debug, PartialEq, Eq)]
#[allow(clippy::large_enum_variant, reason = "one at a time, on the stack")]
pub enum Recorded {
    /// What comes first.
    Board {
        /// Name.
        name: &'static str,
        /// Ticks of the step clock in a second.
        step_clock_hz: u32,
    },
    /// A stored record.
    Record(Record),
    /// Where it begins, microseconds since power-up.
    Begin(u64),
    /// An entry and its time.
    Noted(u64, Noted),
    /// There is no more.
    End,
}
