//! The entries of a recording: inputs with their times, and the machine states by which two runs are compared. Also the
//! entries that only a board writes.

use crate::boards::AXES;
use crate::simulator::Simulator;
use crate::trace::hash;
use oxmill_controller::axes::LINEAR;
use oxmill_controller::messages::{Noted, SpindleDirection};

/// First line of a recording.
pub(super) const TITLE: &str = "oxmill recording 1";

/// An input of the machine, or a state to compare.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Input {
    /// A host has opened the port.
    Connect,
    /// A host has closed the port.
    Disconnect,
    /// Bytes that the host has sent.
    Host(Vec<u8>),
    /// A line of the pin protocol.
    Pin(String),
    /// A state to compare: motor positions, hash of all steps, alarm, outputs, and hash of the times.
    At(String),
    /// A job starts.
    Job,
    /// An entry that only a board records.
    Report(BoardReport),
}

/// An entry that only a board records.
#[derive(Clone, Debug, PartialEq, Eq)]
#[allow(clippy::large_enum_variant, reason = "few of them, and read once")]
pub enum BoardReport {
    /// An entry of the board's ring buffer.
    Noted(Noted),
    /// How the recording ended.
    Ended {
        /// The entry's text, such as `panic N12 1.000 2.000 0.000` or `reset`.
        text: String,
        /// Whether a failure of the firmware ended the recording.
        crash: bool,
        /// Machine position at that failure, in micrometres.
        place: Vec<i64>,
        /// Line number (N word) of the line that was running at that failure; 0 for none.
        line: u32,
    },
}

/// Returns motor positions, a hash of all steps, and the state of a machine, as text to compare two runs.
pub(super) fn place(simulator: &Simulator) -> String {
    // A is omitted if it has never turned, so that recordings of three axes keep their form.
    let position = simulator.machine().motors();
    let axes = if simulator.machine().motor_pulses()[LINEAR..] == [0; AXES - LINEAR] { LINEAR } else { AXES };
    let places: String = position[..axes].iter().map(|steps| format!("{steps} ")).collect();
    format!("{places}{:016x} {}", simulator.trace().digest().order_hash(), state(simulator))
}

/// Returns the alarm, the outputs, and whether the position is trusted and the machine paused, as text to compare two
/// runs.
pub(super) fn state(simulator: &Simulator) -> String {
    let controller = simulator.controller();
    let mut words = format!("alarm {}", controller.alarm().map_or(0, |alarm| alarm.code()));
    let mut word = |of: &str, holds: bool| {
        if holds {
            words.push(' ');
            words.push_str(of);
        }
    };
    word("trusted", controller.is_trusted());
    word("paused", controller.is_paused());
    let Some(outputs) = simulator.outputs() else { return words };
    word("drivers", outputs.drivers);
    word(&format!("cw {}", outputs.power), outputs.spindle == SpindleDirection::Clockwise);
    word(&format!("ccw {}", outputs.power), outputs.spindle == SpindleDirection::CounterClockwise);
    word("flood", outputs.coolant.flood);
    word("mist", outputs.coolant.mist);
    word(&format!("pins {:02x}", outputs.digital), outputs.digital != 0);
    words
}

/// Text that separates two parts of a recorded state: the text of [`place`], and the hash of the clock and the times.
const TRACED: &str = " traced ";

/// Returns [`place`], followed by [`TRACED`] and a hash of the clock and of the times of all steps and output changes.
/// `begin`: the tick at which the recording began.
pub(super) fn traced(simulator: &Simulator, begin: u64) -> String {
    let (clock, trace) = (simulator.clock(), simulator.trace());
    let hz = u64::from(simulator.board().step_clock_hz);
    let hash = hash([hz, begin, clock.now(), trace.history()]);
    format!("{}{TRACED}{hash:016x}", place(simulator))
}

/// Compares two texts of [`traced`]: `recorded` from the recording, and `here` from the present machine. A text of an
/// older version can end after the step hash or after the outputs. Then only the parts that it has are compared.
///
/// # Errors
/// A text that says what differs.
pub(super) fn compare(recorded: &str, here: &str) -> Result<(), String> {
    let (here_at, _) = here.split_once(TRACED).unwrap_or((here, ""));
    let recorded_at = match recorded.split_once(TRACED) {
        Some((at, _)) => at,
        None if here_at.strip_prefix(recorded).is_some_and(|rest| rest.starts_with(" alarm ")) => here_at,
        None => recorded,
    };
    if recorded_at != here_at {
        return Err(format!("the recording has the machine at {recorded_at}; here it is at {here_at}"));
    }
    if recorded.contains(TRACED) && recorded != here {
        return Err(
            "the machine is where it was recorded, but not at the same time by the same clock, or steps or outputs \
             came at other times"
                .into(),
        );
    }
    Ok(())
}
