//! Recordings: the inputs of a simulated machine with their times, as text. `Recorder` writes the inputs, and the
//! state of the machine whenever it has changed. `Recording` reads the text, plays the inputs into another simulator
//! and compares the resulting states. It also reads the listing of a board's `$REC`.
//!
//! ```text
//! oxmill recording 1
//! board desk 1000000                      name, ticks of the step clock in a second
//! record 100 00007a43                     each stored record: key, value
//! machine [[switch]]                      each line of the machine's description, if it has one
//! begin 1500000                           virtual time, in ticks of the step clock, at which the recording begins
//! 1512000 connect                         a host has opened the port; `disconnect`: closed it
//! 1530000 host G1 X10 F600\n              bytes of the host, escaped as in Rust
//! 1600000 pin door 1                      a line of the pin protocol
//! 1600000 at 80 0 0 9d53b4ab5f4e1c2a alarm 0 trusted cw 32896 flood traced 41d0a3b5c7e9f012
//!                                         position of the motors, hash of all steps in their order; alarm and
//!                                         outputs, the spindle's power from 0 to 65535; hash of the clock, and of
//!                                         the times of all steps and changes of the outputs
//! 1700000 job                             a job begins that no host sends: the controller takes it as fast as it can
//! job G0 X1\n                             each line of it
//! ```
//! The command `$REC` lists the recording of a board, each line as `[REC:...]`. [`Recording::parse`] also reads the log
//! of a terminal: it ignores all other lines, and takes the last of several listings. A board writes further kinds of
//! lines, which `protocol::recording` of the controller formats and [`crate::board_replay`] plays.
//!
//! Each line after `begin` starts with its time, except the lines of a job.

mod entry;
mod reader;
mod writer;

pub use entry::{BoardReport, Input};
pub use reader::Recording;
pub use writer::{RecordedJob, Recorder};

use crate::fittings::Fittings;
use crate::simulator::{Options, Simulator};
use crate::store::Store;
use entry::{compare, traced};
use oxmill_controller::messages::Store as Change;

/// Message for a replay that found no difference because nothing could be compared.
pub(crate) const NOTHING_COMPARED: &str = "nothing in it tells where the motors were, so nothing has been compared";

impl Recording {
    /// The text of the recorded job, if there is one.
    pub fn job(&self) -> Option<&[u8]> {
        self.job.as_deref()
    }

    /// Returns whether a board made the recording.
    pub fn is_of_board(&self) -> bool {
        self.inputs.iter().any(|(_, input)| matches!(input, Input::Report(_)))
    }

    /// The inputs with their times, in ticks of the step clock.
    pub fn inputs(&self) -> &[(u64, Input)] {
        &self.inputs
    }

    /// Returns `false` if the recording is a board's listing without its `end` line: then the later part is missing.
    pub fn is_whole(&self) -> bool {
        !self.broken_off
    }

    /// Returns the duration up to the last input or recorded state, in ticks of the step clock.
    pub fn length(&self) -> u64 {
        self.inputs.last().map_or(0, |(time, _)| time.saturating_sub(self.begin.unwrap_or_default()))
    }

    /// Checks that the recording contains a state to compare.
    ///
    /// # Errors
    /// If it contains no such state, because it is incomplete.
    pub fn check_compared(&self) -> Result<(), String> {
        let compares = self.inputs.iter().any(|(_, input)| matches!(input, Input::At(_)));
        if compares { Ok(()) } else { Err(NOTHING_COMPARED.into()) }
    }

    /// Compares a machine that has finished the job with the end of the recording.
    ///
    /// # Errors
    /// A text that says what differs, or that the recording has no end.
    pub fn compare_end(&self, simulator: &Simulator) -> Result<(), String> {
        match self.inputs.last() {
            Some((time, Input::At(recorded))) => {
                compare(recorded, &traced(simulator, self.begin.unwrap_or_default()))
                    .map_err(|why| format!("at its end {why}"))?;
                let now = simulator.clock().now();
                let is_same = self.job().is_none() || *time == now;
                is_same
                    .then_some(())
                    .ok_or_else(|| format!("it ends at tick {time}, and here the job ends at tick {now}"))
            }
            _ => Err("the recording has no end: nothing can be compared".into()),
        }
    }

    /// Powers up a simulator with the recorded settings and hardware, and advances it to the tick at which the
    /// recording begins.
    ///
    /// # Errors
    /// If the recording does not describe a valid machine.
    pub fn power_up(&self) -> Result<Simulator, String> {
        let mut store = Store::in_memory();
        for record in &self.records {
            store.apply(&Change::Put(record.clone())).map_err(|error| error.to_string())?;
        }
        let fittings = match self.machine.as_str() {
            "" => Fittings::default(),
            text => Fittings::parse(text).map_err(|error| format!("{error:#}"))?,
        };
        let mut simulator = Simulator::new(Options { board: self.board, store, fittings, keep_steps: false });
        // The recorded machine had executed its startup lines before the first input: do the same here.
        simulator.run_until_idle();
        simulator.take_output();
        advance(&mut simulator, self.begin.ok_or("the recording has no `begin`")?, |_| {}, |_| {});
        Ok(simulator)
    }

    /// Plays the inputs into a machine that has just been powered up. If the recording has a job, stops at the start of
    /// the job, otherwise at the end of the recording. `on_output` receives the machine's output. `pass` is called as
    /// time passes, with the ticks of the step clock since the beginning.
    ///
    /// # Errors
    /// A text that says where the machine differs from the recording.
    pub fn play(
        &self,
        simulator: &mut Simulator,
        mut on_output: impl FnMut(&str),
        mut pass: impl FnMut(u64),
    ) -> Result<(), String> {
        let begin = self.begin.unwrap_or_default();
        for (time, input) in &self.inputs {
            advance(simulator, *time, &mut on_output, |now| pass(now.saturating_sub(begin)));
            match input {
                Input::Job => return Ok(()),
                Input::Report(_) => return Err("lines of a board and of a simulator are mixed".into()),
                Input::Connect => simulator.connect(),
                Input::Disconnect => simulator.disconnect(),
                Input::Host(bytes) => simulator.send(bytes),
                Input::Pin(line) => {
                    let answer = simulator.pin_line(line);
                    if answer.starts_with("error") {
                        return Err(answer);
                    }
                }
                Input::At(recorded) => {
                    let seconds = simulator.clock().seconds(time.saturating_sub(begin));
                    let same = compare(recorded, &traced(simulator, begin));
                    same.map_err(|why| format!("{seconds:.6} s after its begin {why}"))?;
                }
            }
            pass_output(simulator, &mut on_output);
        }
        Ok(())
    }
}

/// Advances time, and fetches the machine's output every 20 ms, as a host does.
fn advance(simulator: &mut Simulator, until: u64, mut on_output: impl FnMut(&str), mut pass: impl FnMut(u64)) {
    let slice = u64::from(simulator.board().step_clock_hz) / 50;
    while simulator.clock().now() < until {
        simulator.advance_to(until.min(simulator.clock().now() + slice));
        pass_output(simulator, &mut on_output);
        pass(simulator.clock().now());
    }
}

/// Passes all of the machine's output to `on_output`. Fetching output can let the controller send further replies that
/// it held back; they are passed, too.
fn pass_output(simulator: &mut Simulator, on_output: &mut impl FnMut(&str)) {
    while simulator.unfetched() > 0 {
        on_output(&simulator.take_output());
    }
}
