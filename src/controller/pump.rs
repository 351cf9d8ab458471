//! The order in which a platform drives the controller: observe, pass on events, pass on bytes of lines, then carry out
//! outputs until nothing is left. The firmware, the simulator and the test suites that run on the target implement
//! [`Pump`], so the same bytes make the same steps everywhere.
//!
//! ```text
//!  round ─▶ observe ─▶ events, source by source ─▶ bytes of lines ─▶ outputs ─┬─▶ none: the round ends
//!    ▲                                                                        │
//!    └── a segment for the step task, a line, a stop, a change for the store ─◀┘
//! ```
//! Each segment for the step task and each executed line starts another round. So the look-ahead takes in all received
//! lines for which it has room before the next segment is cut, and the steps do not depend on the speed of the
//! processor. There is one exception: if the step task will soon run out of segments during a motion, segments come
//! before lines.
//!
//! Some outputs get their answer as an event: a stop, a stored record, the view of the pins. Such an output also
//! starts another round, which passes on the answer before the next output. So at most one output of each kind is
//! pending.

use crate::dispatch::Controller;
use crate::messages::{Event, LINES_DEPTH, LineByte, Observed, Output, REALTIME_DEPTH, Room};
use crate::units::Instant;

/// Sources of events.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Source {
    /// The step task: stops, underruns, probe contacts.
    Step,
    /// The answer to [`Output::Store`].
    Store,
    /// Hosts that have disconnected or connected.
    Hosts,
    /// Realtime commands, in order of arrival.
    Commands,
    /// Levels of the inputs.
    Inputs,
    /// The answer to [`Output::ReadPins`].
    Pins,
}

/// Maximum number of realtime commands between two checks whether the step task is short of segments. A flood of
/// commands must not starve the step task.
const COMMANDS_AT_ONCE: u32 = 16;
/// Maximum number of realtime commands in a round. The round takes commands before inputs and lines, so without this
/// limit a flood of commands would keep inputs and lines waiting. The limit is higher than the number of commands that
/// can wait at the start of a round.
const MOST_COMMANDS: u32 = 2 * REALTIME_DEPTH as u32;

/// The platform under a controller: provides queues, time and outputs, and makes no decisions.
pub trait Pump<const N: usize> {
    /// `true` (the firmware): input that arrives during a round wakes the pump again, and so does new room in a queue.
    /// `false`: a round in which anything was done is followed by another round.
    const IS_WOKEN: bool;
    /// Returns the controller that this pump drives.
    fn controller(&mut self) -> &mut Controller<N>;
    /// Begins a round (one call of [`round`]). Returns the time that counts for the whole round. The round reads only
    /// the line bytes that are queued now. So the report for a `?` comes before the answer to a line that ends after
    /// the `?`.
    fn begin(&mut self) -> Instant;
    /// Returns the progress of the step task and three counts of bytes: free bytes of the line queue, bytes received
    /// but not read yet, and bytes received since power-up.
    fn observed(&mut self) -> Observed;
    /// Removes and returns the oldest event of a source; `None` if none is waiting.
    fn next_event(&mut self, source: Source) -> Option<Event<N>>;
    /// Takes the next byte of a line; `None` if there is none that the controller accepts now.
    fn next_line_byte(&mut self) -> Option<LineByte>;
    /// Removes and returns the next line byte if the controller would drop it ([`Controller::is_old`]), for instance
    /// because a reset came after it. Otherwise returns `None` and leaves the byte in the queue.
    fn next_old_byte(&mut self) -> Option<LineByte> {
        None
    }
    /// Passes text to the controller, several bytes at a time. Text means bytes that only extend the current line.
    /// Takes only bytes that [`Pump::next_line_byte`] would return now, stops before the first byte that is not text,
    /// and records the bytes as [`Pump::record`] would. Returns whether it took any.
    #[inline(always)]
    fn give_text(&mut self, _now: Instant) -> bool {
        false
    }
    /// Queues input that found no room before. Called after the round has taken events and lines, because that can
    /// make room. `took`: `true` if the round has taken any. Returns whether anything was queued.
    fn make_room(&mut self, took: bool) -> bool;
    /// Returns which output queues have room.
    fn room(&mut self) -> Room;
    /// Passes an output to the task or driver that performs it. Replies and messages for the step task come only if
    /// [`Pump::room`] has reported room for them.
    fn carry(&mut self, output: Output);
    /// Records an event. Called just before the controller takes it.
    #[inline(always)]
    fn record(&mut self, _now: Instant, _event: &Event<N>) {}
    /// Records that more bytes wait after a line. Called when the controller has taken the end of that line.
    #[inline(always)]
    fn record_more(&mut self) {}
}

/// Runs one round. Returns whether another round may find more to do.
pub fn round<const N: usize, P: Pump<N>>(pump: &mut P) -> bool {
    let now = pump.begin();
    observe(pump);
    // The order matters: a report of the step task or the store comes before later commands, and a disconnect before
    // the commands of the next host. The calls are written out, because a round runs for each segment, and a loop over
    // the sources would take a third more time.
    let mut events = pass_events(pump, now, Source::Step);
    events |= pass_events(pump, now, Source::Store);
    events |= pass_events(pump, now, Source::Hosts);
    let mut again = false;
    let mut passed = 0;
    while passed < MOST_COMMANDS {
        let some = pass_events_up_to(pump, now, Source::Commands, COMMANDS_AT_ONCE);
        events |= some > 0;
        passed += some;
        if some < COMMANDS_AT_ONCE {
            break;
        }
        if pump.controller().is_short_of_segments() {
            let goes_on = carry_outputs(pump, now, &mut again);
            again |= goes_on;
        }
    }
    events |= pass_events(pump, now, Source::Inputs);
    events |= pass_events(pump, now, Source::Pins);
    again |= passed >= MOST_COMMANDS || events && !P::IS_WOKEN;
    // A host that sends faster than the controller takes lines must not starve the step task, so segments come before
    // the next line.
    if pump.controller().is_short_of_segments() {
        again |= pump.make_room(events);
        if carry_outputs(pump, now, &mut again) {
            return true;
        }
    }
    let mut lines = pump.controller().lets_lines_wait() && drop_old_bytes(pump, now);
    while pump.controller().wants_line()
        && let Some(byte) = next_byte_past_text(pump, now, &mut lines)
    {
        pump.controller().event(now, Event::Line(byte));
        if observe(pump).received > 0 && matches!(byte.byte, b'\n' | b'\r') {
            pump.record_more();
        }
        // Do not wait for the end of the line: it can be far away or never come.
        if pump.controller().is_short_of_segments() {
            break;
        }
    }
    again |= pump.make_room(events || lines) || lines;
    let wanted = pump.controller().wants_line();
    // Sending replies can make room for further answers, so the controller may want a line that it did not want
    // before.
    carry_outputs(pump, now, &mut again) || again || !wanted && pump.controller().wants_line()
}

/// Drops bytes of waiting lines that a reset has made invalid. Lines wait, for example, at an open door. In a state
/// that only a reset ends, such as sleep, also drops the bytes received before that reset, because the reset will make
/// them invalid. If the bytes stayed, they would fill the queue, and in the end the next reset would not get through.
/// Drops at most as many bytes as the queue holds, so that a host that keeps sending cannot delay the round. Returns
/// whether any byte was dropped.
#[cold]
#[inline(never)]
fn drop_old_bytes<const N: usize>(pump: &mut impl Pump<N>, now: Instant) -> bool {
    for dropped in 0..LINES_DEPTH {
        let Some(byte) = pump.next_old_byte() else { return dropped > 0 };
        pump.record(now, &Event::Line(byte));
        pump.controller().drop_old(byte);
    }
    true
}

/// Carries out outputs until none is left (returns false) or until an output starts another round (returns true). Sets
/// `again` if an output may have made further outputs possible.
#[inline(never)]
fn carry_outputs<const N: usize, P: Pump<N>>(pump: &mut P, now: Instant, again: &mut bool) -> bool {
    loop {
        let room = pump.room();
        let Some(output) = pump.controller().output(now, room) else { return false };
        let begins_again = match output {
            // Take events before the next piece of work: a long arc must not delay a stop.
            Output::Worked => return true,
            // The next line comes before another segment is cut.
            Output::Answer(_) => true,
            // A message that announces a block does not begin a round, because the block's first segment must follow at
            // once.
            Output::Step(message) => !message.announces_block(),
            Output::Stop | Output::Store => true,
            Output::ReadPins { .. } | Output::ReadRecording { .. } => true,
            Output::Reply(_) | Output::Pins(_) | Output::Wiring(_) => false,
        };
        pump.carry(output);
        if begins_again {
            return true;
        }
        *again |= !P::IS_WOKEN;
    }
}

/// Passes text to the controller and returns the next byte that is not text. While only text comes, the caller need
/// not check again whether lines are wanted. Sets `took` if any byte was taken.
#[inline(always)]
fn next_byte_past_text<const N: usize>(pump: &mut impl Pump<N>, now: Instant, took: &mut bool) -> Option<LineByte> {
    loop {
        *took |= pump.give_text(now);
        let byte = pump.next_line_byte()?;
        *took = true;
        pump.record(now, &Event::Line(byte));
        if !pump.controller().take_text_byte(byte) {
            return Some(byte);
        }
    }
}

/// Passes all waiting events of a source to the controller. Returns whether there was an event.
#[inline(always)]
fn pass_events<const N: usize>(pump: &mut impl Pump<N>, now: Instant, source: Source) -> bool {
    pass_events_up_to(pump, now, source, u32::MAX) > 0
}

/// Passes up to `most` events of a source to the controller. Returns how many events were passed on.
#[inline(always)]
fn pass_events_up_to<const N: usize>(pump: &mut impl Pump<N>, now: Instant, source: Source, most: u32) -> u32 {
    let mut passed = 0;
    while passed < most
        && let Some(event) = pump.next_event(source)
    {
        // Observe first: the controller must count the bytes received up to here as earlier than the event.
        observe(pump);
        pump.record(now, &event);
        pump.controller().event(now, event);
        passed += 1;
    }
    passed
}

fn observe<const N: usize>(pump: &mut impl Pump<N>) -> Observed {
    let observed = pump.observed();
    pump.controller().observe(observed);
    observed
}
