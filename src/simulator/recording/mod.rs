//! What came into a simulated machine, with its time, as text: `Recorder` writes it and, at each rest, where the
//! machine is; `Recording` reads it back, plays it into another simulator, and compares where that arrives. It also
//! reads what a board has listed by `$REC`.
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
//! 1700000 job                             a job begins that no host sends: it is taken as fast as the controller likes
//! job G0 X1\n                             each line of it
//! ```
//! A board lists what it has recorded by `$REC`, each line as `[REC:...]`; in a log of a terminal all other lines are left out, and of several
//! listings the last one counts. It has other lines besides, which `protocol::recording` of the controller writes and [`crate::board_replay`] plays.
//!
//! Lines begin with their time but for those in front of `begin` and those of a job.

mod entry;
mod reader;
mod writer;

pub use entry::{Input, Told};
pub use reader::Recording;
pub use writer::{RecordedJob, Recorder};

use crate::fittings::Fittings;
use crate::simulator::{Options, Simulator};
use crate::store::Store;
use entry::{compare, traced};
use oxmill_controller::messages::Store as Change;

/// Why a replay that has not parted from its recording is not told to be the same.
pub(crate) const NOTHING_COMPARED: &str = "nothing in it tells where the motors were, so nothing has been compared";

impl Recording {
    /// The text of its job, if it is of one.
    pub fn job(&self) -> Option<&[u8]> {
        self.job.as_deref()
    }

    /// Whether it is of a board.
    pub fn is_of_board(&self) -> bool {
        self.inputs.iter().any(|(_, input)| matches!(input, Input::Told(_)))
    }

    /// What came in, and when.
    pub fn inputs(&self) -> &[(u64, Input)] {
        &self.inputs
    }

    /// Whether it has its end.
    pub fn is_whole(&self) -> bool {
        !self.broken_off
    }

    /// How long it is as far as its last input, or its job: ticks of the step clock.
    pub fn length(&self) -> u64 {
        self.inputs.last().map_or(0, |(time, _)| time.saturating_sub(self.begin.unwrap_or_default()))
    }

    /// Whether there was anything by which two machines are compared.
    ///
    /// # Errors
    /// Nothing tells where the machine was: the recording is not whole.
    pub fn check_compared(&self) -> Result<(), String> {
        let compares = self.inputs.iter().any(|(_, input)| matches!(input, Input::At(_)));
        if compares { Ok(()) } else { Err(NOTHING_COMPARED.into()) }
    }

    /// Whether a machine that has come to the end of the job is where it was in the recording.
    ///
    /// # Errors
    /// Where it is instead.
    pub fn compare_end(&self, simulator: &Simulator) -> Result<(), String> {
        match self.inputs.last() {
            Some((_, Input::At(recorded))) => compare(recorded, &traced(simulator, self.begin.unwrap_or_default()))
                .map_err(|why| format!("at its end {why}")),
            _ => Err("the recording has no end: nothing can be compared".into()),
        }
    }

    /// The machine as it was when the recording began.
    ///
    /// # Errors
    /// Why there can be no such machine.
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
        // As whoever records does before anything comes in: startup lines are carried out.
        simulator.run_until_idle();
        simulator.take_output();
        advance(&mut simulator, self.begin.ok_or("the recording has no `begin`")?, |_| {}, |_| {});
        Ok(simulator)
    }

    /// Plays what came in to a machine that has just been powered up, as far as its job, if it has one; `hear` gets what it says,
    /// and `pass` now and then the time since the begin, ticks of the step clock. Then it is where that begins, or where the recording ends.
    ///
    /// # Errors
    /// Where the machine parts from the recording.
    pub fn play(
        &self,
        simulator: &mut Simulator,
        mut hear: impl FnMut(&str),
        mut pass: impl FnMut(u64),
    ) -> Result<(), String> {
        let begin = self.begin.unwrap_or_default();
        for (time, input) in &self.inputs {
            advance(simulator, *time, &mut hear, |now| pass(now.saturating_sub(begin)));
            match input {
                Input::Job => return Ok(()),
                Input::Told(_) => return Err("lines of a board and of a simulator are mixed".into()),
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
            hear_all(simulator, &mut hear);
        }
        Ok(())
    }
}

/// Lets time pass; what the machine says is taken now and then, as by a host.
fn advance(simulator: &mut Simulator, until: u64, mut hear: impl FnMut(&str), mut pass: impl FnMut(u64)) {
    let slice = u64::from(simulator.board().step_clock_hz) / 50;
    while simulator.clock().now() < until {
        simulator.advance_to(until.min(simulator.clock().now() + slice));
        hear_all(simulator, &mut hear);
        pass(simulator.clock().now());
    }
}

/// Takes all that the machine has to say: what it holds back for want of room comes with what is taken.
fn hear_all(simulator: &mut Simulator, hear: &mut impl FnMut(&str)) {
    while simulator.unfetched() > 0 {
        hear(&simulator.take_output());
    }
}
