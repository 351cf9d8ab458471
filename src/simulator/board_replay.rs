//! Plays a board's recording (`$REC`) into the simulator. Restores the recorded initial state, feeds in bytes and
//! inputs at their recorded times, and compares the step counters whenever the machine rests. Reports where the
//! simulator differs from the board, or why the recording cannot be played.
//!
//! A board reacts later than the simulator, by the run time of its processor. So when a reset or an input stops its
//! motors, they have moved further. The replay therefore stops the simulated motors at the recorded stop position, if
//! they pass it at about the recorded time. All other results must follow from the simulation: the rest positions of
//! the motors, the order of the stepped blocks, and the position and line of a failure.

use crate::recording::{BoardReport, Input, NOTHING_COMPARED, Recording};
use crate::simulator::Simulator;
use oxmill_controller::messages::{Noted, Signals, Standing, Stopping};
use oxmill_controller::protocol::realtime;

/// The same event may happen up to 1/20 s earlier or later in the simulator than on the board. This constant is the
/// denominator of that fraction.
const SLACK_PARTS: u64 = 20;
/// If the board read a line at most 1/1000 s after the previous line, both count as having waited in its receive queue
/// at the same time. This constant is the denominator of that fraction.
const AT_ONCE_PARTS: u64 = 1000;
/// A part of the G-code words of a recorded modal state: F0, directly before the S word. It means that no feed rate
/// was in force.
const NO_FEED: &str = "F0.0000000S";

/// Result of replaying a board's recording.
#[derive(Debug, Default)]
pub struct Arrival {
    /// Remarks for the user, such as where the replay begins.
    pub notes: Vec<String>,
    /// Where the simulator first differed from the board, or why the recording cannot be played; `None` if all agreed.
    pub parted: Option<String>,
}

/// Plays a recording on a machine that has the recorded settings and has just been powered up. `on_output`: receives
/// the output of the machine. `pass`: called again and again as time passes, with the ticks of the step clock since the
/// beginning.
pub fn play(
    recording: &Recording,
    simulator: &mut Simulator,
    on_output: impl FnMut(&str),
    pass: impl FnMut(u64),
) -> Arrival {
    let mut arrival = Arrival::default();
    if !recording.is_whole() {
        arrival.notes.push("the listing breaks off: what came later is not known".into());
    }
    let mut inputs = in_order(recording.inputs());
    let begin = match begin_of(&inputs) {
        Ok(begin) => begin,
        Err(why) => {
            arrival.parted = Some(why);
            return arrival;
        }
    };
    let at_once = u64::from(simulator.board().step_clock_hz) / AT_ONCE_PARTS;
    let inputs = at_once_together(inputs.split_off(begin), at_once);
    let mut replay = Playing { simulator, on_output, pass, begin: 0, shift: 0, offset: Vec::new(), cuts: 1, met: 0 };
    let played = replay.play(&inputs, begin, &mut arrival.notes);
    arrival.parted = played.err();
    if arrival.parted.is_none() {
        arrival.notes.push(match replay.met {
            0 => NOTHING_COMPARED.into(),
            1 => "the motors come to the one recorded place, by the same moves as on the board".into(),
            places => format!("the motors come to all {places} recorded places, by the same moves as on the board"),
        });
    }
    arrival
}

/// Returns the inputs with each stop after its cause. In a recording, the report of a stop can precede the reset or
/// input that caused the stop, because the two pass through different queues.
fn in_order(inputs: &[(u64, Input)]) -> Vec<(u64, Input)> {
    let mut ordered = inputs.to_vec();
    // Number of resets and tripped inputs whose stop has not been reported yet.
    let mut ordered_stops = 0_u32;
    for at in 0..ordered.len() {
        if stops(&ordered[at].1) {
            ordered_stops += 1;
        } else if is_stop(&ordered[at].1) && ordered_stops > 0 {
            ordered_stops -= 1;
        } else if is_stop(&ordered[at].1)
            && let Some(behind) = (at + 1..ordered.len().min(at + 4)).find(|next| stops(&ordered[*next].1))
            // Move the report only if no other stop is reported before the reset or input. Otherwise the reset or input
            // has caused that other stop.
            && !ordered[at + 1..behind].iter().any(|(_, input)| is_stop(input))
        {
            ordered[at..=behind].rotate_left(1);
            // After the rotation, `ordered[at]` is an input that this loop has not counted yet.
            ordered_stops += u32::from(stops(&ordered[at].1));
            if let Some((time, _)) = ordered.get(behind - 1).cloned() {
                ordered[behind].0 = time;
            }
        }
    }
    // A `Cut` marks where the bytes of a former host end. Lines recorded between a connect or disconnect and the
    // following `Cut` are therefore from the former host: move them before the connect or disconnect.
    let mut since = 0;
    for cut in 0..ordered.len() {
        if !matches!(ordered[cut].1, Input::Report(BoardReport::Noted(Noted::Cut))) {
            continue;
        }
        let gone = (since..cut).find(|at| matches!(ordered[*at].1, Input::Connect | Input::Disconnect));
        if let Some(gone) = gone {
            let time = ordered[gone].0;
            let (mut before, behind): (Vec<_>, Vec<_>) =
                ordered.drain(gone..cut).partition(|(_, input)| is_of_line(input));
            before.iter_mut().for_each(|(of_line, _)| *of_line = time);
            before.extend(behind);
            ordered.splice(gone..gone, before);
        }
        since = cut + 1;
    }
    ordered
}

/// Merges lines into one input, if each of them already waited when the board read the previous line. Such lines must
/// be sent together, because the machine can treat a line differently if another line waits.
fn at_once_together(inputs: Vec<(u64, Input)>, at_once: u64) -> Vec<(u64, Input)> {
    let mut together: Vec<(u64, Input)> = Vec::new();
    // Time at which the board read the most recent line of the host.
    let mut last = 0;
    for (time, input) in inputs {
        if let Input::Host(more) = &input
            && let [.., (_, Input::Host(lines)), (_, Input::Report(BoardReport::Noted(Noted::More)))] =
                &mut together[..]
            && is_of_line(&input)
            && time <= last + at_once
        {
            lines.extend(more);
            together.pop();
            last = time;
            continue;
        }
        last = if matches!(input, Input::Host(_)) { time } else { last };
        together.push((time, input));
    }
    together
}

/// Returns whether an input belongs to a line of the host and is not a realtime command.
fn is_of_line(input: &Input) -> bool {
    match input {
        Input::Host(bytes) => {
            bytes.len() != 1 || realtime::command(bytes[0]).or(realtime::command_of_grblhal(bytes[0])).is_none()
        }
        Input::Report(BoardReport::Noted(Noted::More)) => true,
        _ => false,
    }
}

/// Returns whether an input is the beginning of a line, without the line end.
fn is_begin(input: &Input) -> bool {
    matches!(input, Input::Host(bytes) if is_of_line(input) && !bytes.ends_with(b"\n") && !bytes.ends_with(b"\r"))
}

/// Returns whether an input stops the step task: a reset, or an input pin that has tripped.
fn stops(input: &Input) -> bool {
    match input {
        Input::Host(bytes) => bytes[..] == [0x18],
        Input::Report(BoardReport::Noted(Noted::Inputs { tripped, .. })) => *tripped != 0,
        _ => false,
    }
}

/// Returns whether an input is the report that the step task was stopped.
fn is_stop(input: &Input) -> bool {
    matches!(input, Input::Report(BoardReport::Noted(Noted::Step(Stopping::AtRest | Stopping::Moving, _))))
}

/// Returns the index of the input at which a replay can begin: the power-up, or the first recorded state at rest after
/// the last stored setting. The error tells the user why there is none.
fn begin_of(inputs: &[(u64, Input)]) -> Result<usize, String> {
    let reports = |wanted: fn(&BoardReport) -> bool| {
        move |(_, input): &(u64, Input)| match input {
            Input::Report(report) => wanted(report),
            _ => false,
        }
    };
    // The recording contains the settings as they are at its end. So a replay must begin after the last change of a
    // setting.
    let stored = inputs.iter().rposition(reports(|report| matches!(report, BoardReport::Noted(Noted::Stored(true)))));
    if stored.is_none() && matches!(inputs.first(), Some((_, Input::Report(BoardReport::Noted(Noted::PowerUp))))) {
        return Ok(0);
    }
    let from = stored.map_or(0, |at| at + 1);
    let state =
        inputs[from..].iter().position(reports(|report| matches!(report, BoardReport::Noted(Noted::Standing { .. }))));
    state.map(|at| from + at).ok_or_else(|| {
        let why = if stored.is_some() { "no state after the last change of a setting" } else { "no state at rest" };
        let last = inputs.iter().rev().find_map(|(_, input)| match input {
            Input::Report(BoardReport::Ended { text, .. }) => Some(format!("; its end: {text}")),
            _ => None,
        });
        let lines = inputs.iter().filter(|(_, input)| matches!(input, Input::Host(_))).count();
        format!(
            "begins in the middle: it has {why} from which to start, so its {lines} lines and commands cannot be played{}",
            last.unwrap_or_default()
        )
    })
}

struct Playing<'a, H, P> {
    simulator: &'a mut Simulator,
    on_output: H,
    pass: P,
    /// Simulator time at which the replay begins.
    begin: u64,
    /// Simulator time minus the time in the recording, in ticks of the step clock.
    shift: u64,
    /// Per motor: the board's step counter minus the simulator's.
    offset: Vec<i32>,
    /// Number of `Noted::Cut` entries that may still come: one for each connect or disconnect. A `Cut` marks the place
    /// where the bytes of a former host end.
    cuts: u32,
    /// Number of recorded motor positions that the simulator has matched.
    met: u32,
}

impl<H: FnMut(&str), P: FnMut(u64)> Playing<'_, H, P> {
    fn play(&mut self, inputs: &[(u64, Input)], left_out: usize, notes: &mut Vec<String>) -> Result<(), String> {
        self.simulator.set_never_silent();
        self.start(inputs, left_out, notes)?;
        for (at, (time, input)) in inputs.iter().enumerate().skip(1) {
            // A line is recorded in parts if another input, such as a realtime command, came before its end. The first
            // part then has the time of that other input. A `More` before the first part means that its bytes had
            // already arrived when the board read the previous line. In that case, send them now.
            let waited =
                at > 0 && matches!(inputs[at - 1].1, Input::Report(BoardReport::Noted(Noted::More))) && is_begin(input);
            let time = if waited { self.simulator.clock().now() } else { time + self.shift };
            let later = inputs.get(at + 1..).unwrap_or_default();
            match input {
                Input::Host(bytes) => self.host(time, bytes, later),
                Input::Connect | Input::Disconnect => {
                    self.advance(time);
                    self.cuts += 1;
                    if *input == Input::Connect { self.simulator.connect() } else { self.simulator.disconnect() }
                }
                Input::Report(report) => self.report(time, report, later, notes)?,
                Input::Pin(_) | Input::At(_) | Input::Job => {
                    return Err("lines of a board and of a simulator are mixed".into());
                }
            }
            self.pass_output();
        }
        Ok(())
    }

    /// Puts the simulator into the state at which the replay begins. `left_out`: number of inputs of the recording
    /// before that state.
    fn start(&mut self, inputs: &[(u64, Input)], left_out: usize, notes: &mut Vec<String>) -> Result<(), String> {
        let Some((time, input)) = inputs.first() else { return Err("nothing is recorded".into()) };
        let mut counters = Vec::new();
        if let Input::Report(BoardReport::Noted(Noted::Standing { standing, blocks })) = input {
            if left_out > 0 {
                notes.push(format!(
                    "begins at a state at rest; {left_out} lines of the recording before it are left out"
                ));
            }
            self.stand(standing)?;
            self.simulator.follow_blocks(*blocks);
            counters = standing.counters.to_vec();
        } else {
            notes.push("begins at power-up".into());
        }
        let now = self.simulator.clock().now();
        self.shift = now.saturating_sub(*time);
        self.advance(time + self.shift);
        self.begin = self.simulator.clock().now();
        let here = self.counters();
        counters.resize(here.len(), 0);
        self.offset = counters.iter().zip(&here).map(|(board, here)| board.wrapping_sub(*here)).collect();
        Ok(())
    }

    fn stand(&mut self, standing: &Standing) -> Result<(), String> {
        let inverted = self.simulator.wiring().map_or(0, |wiring| wiring.inputs.inverted);
        self.simulator.set_pins(Signals::of_word(standing.active ^ inverted));
        // A board records a state at rest only while no input stops the machine. So no input may stop the simulator
        // here.
        if let Some(alarm) = self.simulator.controller().alarm() {
            return Err(format!(
                "the inputs of its first state raise ALARM:{}: the recording is damaged",
                alarm.code()
            ));
        }
        self.simulator.stand(standing, false);
        self.simulator.take_output();
        let mut words = String::from_utf8_lossy(&standing.words).into_owned() + "\n";
        if words.contains(NO_FEED) {
            // After M30 or G94, G1 can be in force without a feed rate. No single line sets that state: G1 needs an F,
            // and F0 then clears it.
            words = words.replace(NO_FEED, "F1S") + "F0\n";
        }
        if standing.inches {
            words.push_str("G20\n");
        }
        self.simulator.send(&words);
        self.simulator.run_until_idle();
        let said = self.simulator.take_output();
        if said.contains("error") || said.contains("ALARM") {
            return Err(format!("the state cannot be brought about: {}", said.trim()));
        }
        self.simulator.stand(standing, standing.locked);
        Ok(())
    }

    fn pass_output(&mut self) {
        while self.simulator.unfetched() > 0 {
            (self.on_output)(&self.simulator.take_output());
        }
    }

    fn advance(&mut self, until: u64) {
        let slice = self.hz() / 50;
        while self.simulator.clock().now() < until {
            self.simulator.advance_to(until.min(self.simulator.clock().now() + slice));
            self.pass_output();
            (self.pass)(self.simulator.clock().now().saturating_sub(self.begin));
        }
    }

    fn hz(&self) -> u64 {
        u64::from(self.simulator.board().step_clock_hz)
    }

    /// Advances time in steps of `step` ticks until `holds` returns true. Begins a little before `time` and gives up a
    /// little after it (see `SLACK_PARTS`). Returns whether `holds` returned true.
    fn meet(&mut self, time: u64, step: u64, holds: impl Fn(&mut Simulator) -> bool) -> bool {
        let slack = self.hz() / SLACK_PARTS;
        self.advance(time.saturating_sub(slack));
        while !holds(self.simulator) {
            let now = self.simulator.clock().now();
            if now >= time + slack {
                return false;
            }
            self.simulator.advance_to(now + step.max(1));
            self.pass_output();
        }
        true
    }

    fn seconds(&self, time: u64) -> String {
        let clock = self.simulator.clock();
        format!("{:.6} s after its begin", clock.seconds(time.saturating_sub(self.begin)))
    }

    fn counters(&self) -> Vec<i32> {
        self.simulator.machine().position().to_vec()
    }

    /// Returns the simulator's step counters, converted to those of the board (see `offset`).
    fn as_on_board(&self) -> Vec<i32> {
        self.counters().iter().zip(&self.offset).map(|(here, offset)| here.wrapping_add(*offset)).collect()
    }

    /// Advances until the motors are at the position at which the board was stopped. Returns whether they got there.
    fn meet_place(&mut self, time: u64, counters: &[i32]) -> bool {
        let wanted: Vec<i32> =
            counters.iter().zip(&self.offset).map(|(board, offset)| board.wrapping_sub(*offset)).collect();
        let step = self.hz() / 1_000_000;
        let is_there =
            |simulator: &mut Simulator| simulator.machine().position().get(..wanted.len()) == Some(&wanted[..]);
        // The motors can rest at this position for long before and after `time`. If they are there at `time`, advance
        // exactly to `time`.
        let mut ahead = self.simulator.clone();
        ahead.advance_to(time);
        if is_there(&mut ahead) {
            self.advance(time);
            return true;
        }
        self.meet(time, step, is_there)
    }

    fn host(&mut self, time: u64, bytes: &[u8], later: &[(u64, Input)]) {
        match (bytes, cut_off(later)) {
            // Send the reset when the simulated motors are where the board's motors stopped.
            ([0x18], Some(counters)) => {
                self.meet_place(time, counters);
            }
            (b"~", _) => self.resume(time),
            _ => self.advance(time),
        }
        let more = matches!(later.first(), Some((_, Input::Report(BoardReport::Noted(Noted::More)))));
        self.simulator.send_followed(bytes, more);
    }

    /// Advances until the machine rests in a hold, so that a `~` can resume it. The host sent `~` when the board was at
    /// rest; the simulator may come to rest a little later.
    fn resume(&mut self, time: u64) {
        self.advance(time);
        let mut ahead = self.simulator.clone();
        let step = self.hz() / 10_000;
        while ahead.clock().now() < time + self.hz() / SLACK_PARTS {
            if ahead.controller().is_paused() {
                return self.advance(ahead.clock().now());
            }
            ahead.advance_to(ahead.clock().now() + step);
        }
    }

    fn report(
        &mut self,
        time: u64,
        report: &BoardReport,
        later: &[(u64, Input)],
        notes: &mut Vec<String>,
    ) -> Result<(), String> {
        let entry = match report {
            BoardReport::Noted(entry) => entry,
            BoardReport::Ended { crash: false, text, .. } => {
                self.advance(time);
                notes.push(format!("ends as the recording: {text}"));
                return Ok(());
            }
            BoardReport::Ended { text, place, line, .. } => return self.ended(time, text, place, *line, notes),
        };
        match entry {
            Noted::Inputs { active, tripped } => self.inputs(time, *active, *tripped, later),
            Noted::Step(stopping, counters) => self.stopped(time, *stopping, counters, later),
            Noted::Rest { counters, blocks } => self.compare_rest(time, counters, *blocks),
            Noted::Standing { standing, .. } => self.compare_state(time, standing),
            Noted::Stored(true) | Noted::More => Ok(()),
            Noted::Stored(false) => Err(format!("{}: the board could not store a setting", self.seconds(time))),
            Noted::Damaged => {
                self.advance(time);
                self.simulator.lose_bytes();
                Ok(())
            }
            Noted::Cut => {
                let known = self.cuts > 0;
                self.cuts = self.cuts.saturating_sub(1);
                if known {
                    return Ok(());
                }
                Err(format!("{}: another host has taken over, which is not recorded", self.seconds(time)))
            }
            _ => Err(format!("{}: the board was powered up again", self.seconds(time))),
        }
    }

    fn inputs(&mut self, time: u64, active: u32, tripped: u32, later: &[(u64, Input)]) -> Result<(), String> {
        match cut_off(later) {
            Some(counters) if tripped != 0 => {
                self.meet_place(time, counters);
            }
            _ => self.advance(time),
        }
        let inverted = self.simulator.wiring().map_or(0, |wiring| wiring.inputs.inverted);
        for active in [active | tripped, active] {
            self.simulator.set_pins(Signals::of_word(active ^ inverted));
        }
        Ok(())
    }

    fn stopped(
        &mut self,
        time: u64,
        stopping: Stopping,
        counters: &[i32],
        later: &[(u64, Input)],
    ) -> Result<(), String> {
        match stopping {
            Stopping::Probed => {
                if self.meet_place(time, counters) {
                    // The step task reads the probe pin without the filter. So the recording has the changed input only
                    // in a later entry. Set the pin now to the level of that entry.
                    let mut pins = self.simulator.pins();
                    let inverted = self.simulator.wiring().map_or(0, |wiring| wiring.inputs.inverted);
                    let probed = later.iter().find_map(|(time, input)| match input {
                        Input::Report(BoardReport::Noted(Noted::Inputs { active, .. })) => {
                            Some((time + self.shift, Signals::of_word(active ^ inverted).probe))
                        }
                        _ => None,
                    });
                    pins.probe = match probed {
                        Some((at, level)) if at <= time + self.hz() / SLACK_PARTS => level,
                        // The next recorded change of an input is much later. So this contact has changed no recorded
                        // level, and the pin keeps its level.
                        Some(_) => pins.probe,
                        None => !pins.probe,
                    };
                    self.simulator.set_pins(pins);
                    return Ok(());
                }
            }
            Stopping::Underrun => return Err(format!("{}: the board's step queue ran dry", self.seconds(time))),
            Stopping::Miscounted => return Err(format!("{}: the board's outputs miscounted", self.seconds(time))),
            Stopping::Moving => self.advance(time),
            // The board may have begun to brake a tick or two of the step clock later than the simulator.
            Stopping::AtRest => {
                self.meet_place(time, counters);
            }
        }
        self.compare(time, counters)
    }

    fn compare(&mut self, time: u64, counters: &[i32]) -> Result<(), String> {
        let here = self.as_on_board();
        // Board and simulator can have different numbers of axes. Axes that only one of them has must not have moved.
        let common = here.len().min(counters.len());
        let others = here.iter().skip(common).chain(counters.iter().skip(common));
        if here[..common] == counters[..common] && others.into_iter().all(|axis| *axis == 0) {
            self.met += 1;
            return Ok(());
        }
        Err(format!("{} the recording has the motors at {counters:?}; here they are at {here:?}", self.seconds(time)))
    }

    fn compare_rest(&mut self, time: u64, counters: &[i32], blocks: u32) -> Result<(), String> {
        self.meet(time, self.hz() / 10_000, |simulator| simulator.is_idle());
        self.advance(time);
        self.compare(time, counters)?;
        if self.simulator.recorded_blocks() == blocks {
            return Ok(());
        }
        Err(format!(
            "{} the motors stopped at the recorded place, but came there by other moves than on the board",
            self.seconds(time)
        ))
    }

    fn compare_state(&mut self, time: u64, standing: &Standing) -> Result<(), String> {
        self.meet(time, self.hz() / 10_000, |simulator| simulator.is_idle());
        self.advance(time);
        let Some(mut here) = self.simulator.controller().standing() else {
            return Err(format!(
                "{} the board was at rest with outputs off and no G92, G68 or override; here the simulator is not",
                self.seconds(time)
            ));
        };
        here.counters = standing.counters.clone();
        here.place.truncate(standing.place.len());
        if here == *standing {
            return Ok(());
        }
        Err(format!("{} the recording has the state {standing:?}; here it is {here:?}", self.seconds(time)))
    }

    /// Plays the end of a recording that ended with a failure. At about the recorded time, the simulator must reach the
    /// recorded position at the recorded line.
    fn ended(
        &mut self,
        time: u64,
        text: &str,
        place: &[i64],
        line: u32,
        notes: &mut Vec<String>,
    ) -> Result<(), String> {
        let is_there = |simulator: &mut Simulator| {
            // The recorded position is the end of a segment. The simulator's controller would update its position only
            // at its next wake-up, so wake it now. This can shift later wake-ups, but not what the step task receives.
            simulator.look();
            let controller = simulator.controller();
            let here = controller.machine_position();
            // The board stores whole micrometres, rounded towards zero.
            controller.line_number() == line
                && here.iter().zip(place).all(|(here, there)| i64::from(here.micrometres()) == *there)
        };
        if self.meet(time, self.hz() / 100_000, is_there) {
            let late = self.simulator.clock().now() as f64 - time as f64;
            let milliseconds = late / self.hz() as f64 * 1e3;
            notes.push(format!(
                "arrives at the place and line of the failure ({text}), {milliseconds:+.1} ms from its time"
            ));
            return Ok(());
        }
        let here = self.simulator.machine_position();
        let number = self.simulator.controller().line_number();
        Err(format!("{}: the board ended so: {text}; here N{number} is at {here:?}", self.seconds(time)))
    }
}

/// Returns the step counters at which the board was stopped in motion, if one of the next three inputs reports such a
/// stop.
fn cut_off(later: &[(u64, Input)]) -> Option<&[i32]> {
    later.iter().take(3).find_map(|(_, input)| match input {
        Input::Report(BoardReport::Noted(Noted::Step(Stopping::Moving, counters))) => Some(counters.as_slice()),
        _ => None,
    })
}
