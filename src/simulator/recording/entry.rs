//! The entries of a recording: inputs with their times, and the state of the machine by which two runs are compared.
//! Also the entries that only a board writes.

use crate::boards::AXES;
use crate::simulator::Simulator;
use crate::trace::hash;
use oxmill_controller::axes::LINEAR;
use oxmill_controller::messages::{Noted, SpindleDirection};

/// The first line.
pub(super) const TITLE: &str = "oxmill recording 1";

/// What comes in, or is to be compared.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Input {
    /// A host has opened the port.
    Connect,
    /// A host has closed the port.
    Disconnect,
    /// Bytes of the host.
    Host(Vec<u8>),
    /// A line of the pin protocol.
    Pin(String),
    /// Where the motors were, the hash of all steps, the alarm and the outputs.
    At(String),
    /// A job begins.
    Job,
    /// What only a board tells.
    Told(Told),
}

/// What only a board tells.
#[derive(Clone, Debug, PartialEq, Eq)]
#[allow(clippy::large_enum_variant, reason = "few of them, and read once")]
pub enum Told {
    /// An entry of its ring.
    Noted(Noted),
    /// How it ended.
    Ended {
        /// As it is written.
        text: String,
        /// In a failure.
        crash: bool,
        /// Machine position in micrometres.
        place: Vec<i64>,
        /// N word.
        line: u32,
    },
}

/// Where a machine is: what two runs are compared by.
pub(super) fn place(simulator: &Simulator) -> String {
    // A that has never turned is not told of, so that recordings of three axes stay what they are.
    let position = simulator.machine().motors();
    let axes = if simulator.machine().motor_pulses()[LINEAR..] == [0; AXES - LINEAR] { LINEAR } else { AXES };
    let places: String = position[..axes].iter().map(|steps| format!("{steps} ")).collect();
    format!("{places}{:016x} {}", simulator.trace().digest().order_hash(), state(simulator))
}

/// What else two runs are compared by: the alarm, what is known of the position, and the outputs.
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

/// In front of a hash of the clock, and of the times of all steps and of all changes of the outputs.
const TRACED: &str = " traced ";

/// The place with that hash, in a recording that began at a time of the virtual clock.
pub(super) fn traced(simulator: &Simulator, begin: u64) -> String {
    let (clock, trace) = (simulator.clock(), simulator.trace());
    let hz = u64::from(simulator.board().step_clock_hz);
    let hash = hash([hz, begin, clock.now(), trace.history()]);
    format!("{}{TRACED}{hash:016x}", place(simulator))
}

/// Compares where a machine is, and what it has done until then, with what was recorded. Recordings of older versions have no
/// more than the motors, or no hash behind the outputs.
///
/// # Errors
/// What differs.
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
