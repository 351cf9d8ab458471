//! The order in which a platform drives the controller: observe, pass on events, pass on bytes of lines, then carry out
//! outputs until nothing is left. Firmware, simulator and the suites on the target implement [`Pump`], so the same
//! bytes make the same steps everywhere.
//!
//! ```text
//!  round ─▶ observe ─▶ events, source by source ─▶ bytes of lines ─▶ outputs ─┬─▶ none: the round ends
//!    ▲                                                                        │
//!    └── a segment for the step task, a line, a stop, a question to the store ◀┘
//! ```
//! Each segment for the step task and each line that has been carried out begins another round, so the look-ahead is as full as
//! the received bytes allow before each segment is cut, and the steps do not depend on the speed of the processor; unless it is
//! too slow for them: where the step task soon has no more segments of a motion, these come before lines. Whatever is answered by
//! an event (a stop, a stored record, the view of the pins) begins one too: the answer is told before another output is asked
//! for, and there is never more than one of a kind under way.

use crate::dispatch::Controller;
use crate::messages::{Event, LINES_DEPTH, LineByte, Observed, Output, REALTIME_DEPTH, Room};
use crate::units::Instant;

/// Where events come from.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Source {
    /// The step task: stopped, ran dry, touched.
    Step,
    /// The answer to [`Output::Store`].
    Store,
    /// Hosts that have gone and come.
    Hosts,
    /// Realtime commands, in the order of their coming.
    Commands,
    /// Levels of the inputs.
    Inputs,
    /// The answer to [`Output::ReadPins`].
    Pins,
}

/// Realtime commands between two looks at whether the step task is short of segments: a host that floods must not keep it waiting.
const COMMANDS_AT_ONCE: u32 = 16;
/// Most realtime commands of a round: more than can have waited when it began. These come before inputs and lines.
const MOST_COMMANDS: u32 = 2 * REALTIME_DEPTH as u32;

/// What carries a controller: it has the queues, the time and the outputs, and decides nothing.
pub trait Pump<const N: usize> {
    /// Whether something wakes the pump when more comes in or room is made while a round lasts. If not, a round in which
    /// anything was done is followed by another.
    const IS_WOKEN: bool;
    /// The controller that is carried.
    fn controller(&mut self) -> &mut Controller<N>;
    /// A round begins; gives the time for all of it. Of the line bytes only those that are queued now belong to the round:
    /// so a report asked for by `?` comes before the answer to a line that ends after it.
    fn begin(&mut self) -> Instant;
    /// How far the step task is, and what has been received and not yet taken.
    fn observed(&mut self) -> Observed;
    /// Takes the next event of a source.
    fn next_event(&mut self, source: Source) -> Option<Event<N>>;
    /// Takes the next byte of a line, if it may be taken now.
    fn next_line_byte(&mut self) -> Option<LineByte>;
    /// Takes the next byte of a line if that is one that the controller would drop.
    fn next_old_byte(&mut self) -> Option<LineByte> {
        None
    }
    /// Gives the controller text of a line that comes next and may be taken now, several bytes at a time. Only what
    /// [`Pump::next_line_byte`] would give can be text; what is not, that gives. It records what it gives, as [`Pump::record`]
    /// would. Whether there was any.
    #[inline(always)]
    fn give_text(&mut self, _now: Instant) -> bool {
        false
    }
    /// Events and lines have been taken: what has found no room in their queues may come now. `took`: there were any.
    /// Gives whether something has come.
    fn make_room(&mut self, took: bool) -> bool;
    /// What the queues of outputs can take.
    fn room(&mut self) -> Room;
    /// Carries an output to where it is done. There is room for it.
    fn carry(&mut self, output: Output);
    /// The controller is about to be told of an event: what came in can be recorded here.
    #[inline(always)]
    fn record(&mut self, _now: Instant, _event: &Event<N>) {}
    /// Behind the end of a line of which the controller has been told more bytes wait.
    #[inline(always)]
    fn record_more(&mut self) {}
}

/// One round; whether another one may find more to do.
#[inline]
pub fn round<const N: usize, P: Pump<N>>(pump: &mut P) -> bool {
    let now = pump.begin();
    observe(pump);
    // A command is told after the reports of the step task and the store of what came before it, and a host that has gone
    // before the commands of the next one. One after the other and not in a loop, which costs a third more: a round is made for each segment.
    let mut events = tell(pump, now, Source::Step);
    events |= tell(pump, now, Source::Store);
    events |= tell(pump, now, Source::Hosts);
    let mut again = false;
    let mut told = 0;
    while told < MOST_COMMANDS {
        let some = tell_some(pump, now, Source::Commands, COMMANDS_AT_ONCE);
        events |= some > 0;
        told += some;
        if some < COMMANDS_AT_ONCE {
            break;
        }
        if pump.controller().is_short_of_segments() {
            let goes_on = put_out(pump, now, &mut again);
            again |= goes_on;
        }
    }
    events |= tell(pump, now, Source::Inputs);
    events |= tell(pump, now, Source::Pins);
    again |= told >= MOST_COMMANDS || events && !P::IS_WOKEN;
    // A host that sends faster than lines are taken in must not starve the step task: segments first, then a line.
    if pump.controller().is_short_of_segments() {
        again |= pump.make_room(events);
        if put_out(pump, now, &mut again) {
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
        // A line may be long in coming to its end, or have none.
        if pump.controller().is_short_of_segments() {
            break;
        }
    }
    again |= pump.make_room(events || lines) || lines;
    let wanted = pump.controller().wants_line();
    // Answers that go out may make room for those of lines that wait.
    put_out(pump, now, &mut again) || again || !wanted && pump.controller().wants_line()
}

/// Drops what was received before a reset, though lines wait, behind an open door for instance, and where they wait for nothing
/// but a reset: it would take up the room of what comes behind it, and in the end of another reset. No more than are queued at
/// once: a host that floods must not keep that reset waiting. Whether there was any.
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

/// Carries outputs until there is none, or one that begins another round: then true. `again`: outputs make others possible.
#[inline(never)]
fn put_out<const N: usize, P: Pump<N>>(pump: &mut P, now: Instant, again: &mut bool) -> bool {
    loop {
        let room = pump.room();
        let Some(output) = pump.controller().output(now, room) else { return false };
        let begins_again = match output {
            // Events first: a long arc must not keep a stop waiting.
            Output::Worked => return true,
            // The next line comes before another segment is cut.
            Output::Answer(_) => true,
            // What announces a block is followed by its first segment.
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

/// The next byte that is not plain text. Text makes a line longer, and changes nothing of whether lines are wanted.
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

/// Tells the events of a source; whether there were any.
#[inline(always)]
fn tell<const N: usize>(pump: &mut impl Pump<N>, now: Instant, source: Source) -> bool {
    tell_some(pump, now, source, u32::MAX) > 0
}

/// Tells the events of a source, up to `most` of them; how many there were.
#[inline(always)]
fn tell_some<const N: usize>(pump: &mut impl Pump<N>, now: Instant, source: Source, most: u32) -> u32 {
    let mut told = 0;
    while told < most
        && let Some(event) = pump.next_event(source)
    {
        // What has been received before an event is taken, has come before it.
        observe(pump);
        pump.record(now, &event);
        pump.controller().event(now, event);
        told += 1;
    }
    told
}

#[inline]
fn observe<const N: usize>(pump: &mut impl Pump<N>) -> Observed {
    let observed = pump.observed();
    pump.controller().observe(observed);
    observed
}
