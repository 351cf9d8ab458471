//! Tests the order of the calls in one round of a pump, with a pump that logs each call.

use crate::board::{PROFILE, started};
use oxmill_controller::messages::{
    Event, HOST_CHANGED, LineByte, Observed, Output, PinView, Realtime, Room, SEGMENTS_DEPTH, Segment, Sensed,
    StepEvent, ToStep, input,
};
use oxmill_controller::pump::{Pump, Source, round};
use oxmill_controller::units::Instant;
use oxmill_controller::{Controller, Profile};
use std::collections::VecDeque;

struct Scribe<const WOKEN: bool> {
    controller: Controller<3>,
    log: Vec<String>,
    events: Vec<(Source, Event<3>)>,
    /// The events of the next store operation, including the answer of the store. If the list is empty, only
    /// `Event::Stored` arrives.
    with_store: Vec<(Source, Event<3>)>,
    lines: VecDeque<u8>,
    epoch: u16,
    /// Bytes that `make_room` adds to `lines`, once.
    late: VecDeque<u8>,
    said: String,
    /// Maximum spindle power among the outputs so far.
    power: u16,
    /// A realtime command that the host seems to send without end: the pump finds it each time it looks for commands.
    flood: Option<Realtime>,
    /// `true` if the pump reports no room for replies.
    mute: bool,
    /// Number of further replies for which the pump has room.
    pieces: u32,
}

impl<const WOKEN: bool> Scribe<WOKEN> {
    fn new() -> Self {
        let controller = *started(Profile { has_store: true, ..PROFILE }, 16);
        let none = VecDeque::new();
        let mut scribe = Self {
            controller,
            log: Vec::new(),
            events: Vec::new(),
            with_store: Vec::new(),
            lines: none.clone(),
            epoch: 0,
            late: none,
            said: String::new(),
            power: 0,
            flood: None,
            mute: false,
            pieces: u32::MAX,
        };
        while round(&mut scribe) {}
        scribe.log.clear();
        scribe.said.clear();
        scribe
    }

    fn send(&mut self, line: &str) {
        self.lines.extend(line.bytes());
    }

    /// Sends a line and calls `round` until it returns false. Returns the replies.
    fn answer_to(&mut self, line: &str) -> String {
        self.send(line);
        while round(self) {}
        std::mem::take(&mut self.said)
    }

    fn position(&self, entry: &str) -> usize {
        self.log.iter().position(|e| e == entry).unwrap_or_else(|| panic!("no {entry} in {:#?}", self.log))
    }
}

impl<const WOKEN: bool> Pump<3> for Scribe<WOKEN> {
    const IS_WOKEN: bool = WOKEN;

    fn controller(&mut self) -> &mut Controller<3> {
        &mut self.controller
    }

    fn begin(&mut self) -> Instant {
        self.log.push("begin".into());
        Instant::from_ticks(0)
    }

    fn observed(&mut self) -> Observed {
        self.log.push("observed".into());
        let received = self.lines.len() as u16;
        Observed { segments_begun: 0, step_idle: true, rx_free: 255 - received, received, activity: 0 }
    }

    fn next_event(&mut self, source: Source) -> Option<Event<3>> {
        let event = match (self.events.iter().position(|(s, _)| *s == source), self.flood) {
            (Some(at), _) => self.events.remove(at).1,
            (None, Some(command)) if source == Source::Commands => Event::Realtime(command),
            _ => return None,
        };
        self.log.push(format!("{source:?}"));
        Some(event)
    }

    fn next_line_byte(&mut self) -> Option<LineByte> {
        let byte = self.lines.pop_front()?;
        self.log.push("line".into());
        Some(LineByte { byte, epoch: self.epoch, damaged: false })
    }

    fn make_room(&mut self, took: bool) -> bool {
        self.log.push(format!("room {took}"));
        let late = std::mem::take(&mut self.late);
        self.lines.extend(&late);
        !late.is_empty()
    }

    fn room(&mut self) -> Room {
        Room { step: true, reply: !self.mute && self.pieces > 0 }
    }

    fn carry(&mut self, output: Output) {
        let name = match output {
            Output::Step(message) if message.announces_block() => "block",
            Output::Step(_) => "step",
            Output::Reply(chunk) | Output::Answer(chunk) => {
                self.said += std::str::from_utf8(chunk.as_bytes()).unwrap();
                self.pieces -= 1;
                "reply"
            }
            Output::Pins(pins) => {
                self.power = self.power.max(pins.power);
                "pins"
            }
            Output::Wiring(_) => "wiring",
            Output::Stop => "stop",
            Output::ReadPins { clear_noise } => {
                if !clear_noise {
                    let view = PinView { fitted: u32::MAX, low: 0, noise: [0; input::COUNT] };
                    self.events.push((Source::Pins, Event::Pins(view)));
                }
                "look"
            }
            Output::Store => {
                self.controller.next_store();
                match std::mem::take(&mut self.with_store) {
                    with if with.is_empty() => self.events.push((Source::Store, Event::Stored)),
                    mut with => self.events.append(&mut with),
                }
                "store"
            }
            Output::ReadRecording { .. } => "recording",
            Output::Worked => panic!("nothing to carry"),
        };
        self.log.push(name.into());
    }
}

#[test]
fn events_are_told_source_by_source_then_lines_then_outputs() {
    let mut scribe = Scribe::<false>::new();
    scribe.send("$G\n");
    let signals = Sensed::default();
    let stopped = StepEvent::Stopped { stops: 0, moving: false, position: Default::default() };
    // The events are not in the order in which the pump takes them.
    scribe.events = vec![
        (Source::Store, Event::Stored),
        (Source::Inputs, Event::Signals(signals)),
        (Source::Commands, Event::Realtime(Realtime::Status)),
        (Source::Hosts, Event::Connected),
        (Source::Step, Event::Step(stopped)),
    ];
    round(&mut scribe);
    let order = ["begin", "Step", "Store", "Hosts", "Commands", "Inputs", "line", "room true", "reply"];
    let found: Vec<usize> = order.iter().map(|entry| scribe.position(entry)).collect();
    assert!(found.is_sorted(), "{:?}", scribe.log);
    // The counters of the step task and the link are observed before the controller takes an event.
    for source in &order[1..6] {
        assert_eq!(scribe.log[scribe.position(source) + 1], "observed", "{source}: {:?}", scribe.log);
    }
}

#[test]
fn what_is_answered_by_an_event_is_answered_before_the_next_output() {
    let mut scribe = Scribe::<false>::new();
    // Each line stores a record and is answered `ok`.
    scribe.send("$100=81\n$101=82\nG10L2P1X1\n");
    while round(&mut scribe) {}
    assert_eq!(scribe.said, "ok\r\nok\r\nok\r\n");
    let stores = scribe.log.iter().filter(|entry| *entry == "store").count();
    assert!(stores >= 3, "{:?}", scribe.log);
    let outputs = ["block", "step", "reply", "pins", "wiring", "stop", "look", "store"];
    let mut entries = scribe.log.iter();
    while entries.by_ref().any(|entry| entry == "store") {
        let next = entries.clone().find(|e| *e == "Store" || outputs.contains(&e.as_str()));
        assert_eq!(next.map(String::as_str), Some("Store"), "{:?}", scribe.log);
    }
}

/// One call of the controller switches the outputs off and raises the alarm. The outputs are carried out first,
/// because the text of the alarm may have to wait for room in the reply queue.
#[test]
fn outputs_are_off_before_the_alarm_of_a_soft_limit_is_told() {
    let mut scribe = Scribe::<true>::new();
    for line in ["$22=1\n", "$20=1\n", "$902=0\n", "M8\n"] {
        assert_eq!(scribe.answer_to(line), "ok\r\n");
    }
    scribe.log.clear();
    let said = scribe.answer_to("G1X500F100\n");
    assert!(said.starts_with("ALARM:2\r\n"), "{said}");
    assert!(scribe.position("pins") < scribe.position("reply"), "{:?}", scribe.log);
}

#[test]
fn no_beam_goes_on_while_default_settings_are_being_stored() {
    let mut scribe = Scribe::<false>::new();
    scribe.answer_to("$32=1\n");
    scribe.answer_to("M3S700\n");
    assert!(scribe.answer_to("$RST=$\n").contains("Restoring defaults"));
    assert_eq!(scribe.power, 0);
    scribe.answer_to("M3S700\n");
    assert_ne!(scribe.power, 0);
}

#[test]
fn each_segment_for_the_step_task_begins_a_round() {
    let mut scribe = Scribe::<false>::new();
    scribe.send("G1X1F600\n");
    for _ in 0..20 {
        if !round(&mut scribe) {
            break;
        }
    }
    let steps: Vec<usize> = (0..scribe.log.len()).filter(|&k| scribe.log[k] == "step").collect();
    assert!(steps.len() > 3, "{:?}", scribe.log);
    for k in steps {
        assert_eq!(scribe.log.get(k + 1).map_or("begin", String::as_str), "begin");
    }
    // A message that announces a block does not begin a round, because a segment of that block must follow at once.
    let block = scribe.position("block");
    let next = scribe.log[block..].iter().find(|entry| matches!(entry.as_str(), "step" | "begin"));
    assert_eq!(next.map(String::as_str), Some("step"), "{:?}", scribe.log);
}

#[test]
fn what_comes_when_room_is_made_is_taken_in_another_round() {
    let mut scribe = Scribe::<false>::new();
    scribe.send("G20\n");
    scribe.late.extend(b"G21\n");
    while round(&mut scribe) {}
    assert_eq!(scribe.said, "ok\r\nok\r\n");
    // A round that finds nothing to do is the last one.
    scribe.log.clear();
    assert!(!round(&mut scribe));
    assert_eq!(scribe.log, ["begin", "observed", "room false"]);
}

#[test]
fn a_pump_that_is_woken_makes_no_round_for_nothing() {
    let rounds = |again: bool, log: &[String]| (again, log.iter().filter(|entry| *entry == "begin").count());
    let mut woken = Scribe::<true>::new();
    woken.events.push((Source::Commands, Event::Realtime(Realtime::Status)));
    assert_eq!(rounds(round(&mut woken), &woken.log), (false, 1));
    assert!(woken.said.starts_with("<Idle|"), "{}", woken.said);
    // After a line, `round` returns true, because more lines can be waiting.
    woken.send("G20\n");
    assert!(round(&mut woken));
    let mut other = Scribe::<false>::new();
    other.events.push((Source::Commands, Event::Realtime(Realtime::Status)));
    assert_eq!(rounds(round(&mut other), &other.log), (true, 1));
}

/// During a flood of `?` over a fast link, the step task still gets its segments.
#[test]
fn segments_go_out_though_commands_do_not_end() {
    let mut scribe = Scribe::<true>::new();
    scribe.send("G1X1F600\n");
    while !scribe.log.iter().any(|entry| entry == "step") {
        assert!(round(&mut scribe));
    }
    scribe.log.clear();
    scribe.flood = Some(Realtime::Status);
    for _ in 0..20 {
        assert!(round(&mut scribe), "the commands have not ended");
    }
    assert!(scribe.log.iter().filter(|entry| *entry == "step").count() > 3, "{:?}", scribe.log);
    let before = scribe.log[..scribe.position("step")].iter().filter(|entry| *entry == "Commands").count();
    assert!(before < 40, "{before} commands before the first segment");
}

#[test]
fn inputs_and_lines_come_behind_all_commands_that_wait() {
    let mut scribe = Scribe::<true>::new();
    scribe.send("$G\n");
    scribe.events = vec![(Source::Inputs, Event::Signals(Sensed::default()))];
    scribe.events.extend((0..64).map(|_| (Source::Commands, Event::Realtime(Realtime::FeedUp1))));
    while round(&mut scribe) {}
    let last = scribe.log.iter().rposition(|entry| entry == "Commands").unwrap();
    assert!(last < scribe.position("Inputs") && last < scribe.position("line"), "{:?}", scribe.log);
}

/// When there is room for answers again, the waiting lines are read at once. They must not wait for another wake-up:
/// once all answers have been taken, nothing wakes the pump.
#[test]
fn lines_that_waited_for_room_for_answers_are_read() {
    let mut scribe = Scribe::<true>::new();
    scribe.mute = true;
    scribe.send(&"$G\n".repeat(30));
    while round(&mut scribe) {}
    assert!(!scribe.lines.is_empty() && scribe.said.is_empty());
    scribe.mute = false;
    while round(&mut scribe) {}
    assert_eq!((scribe.lines.len(), scribe.said.matches("ok").count()), (0, 30));
}

const NOT_STORED: &str = "[MSG:Change active but not stored: lost at power-off]\r\n";

#[test]
fn a_failure_to_store_is_told_with_the_command_that_it_belongs_to() {
    let mut scribe = Scribe::<false>::new();
    for line in ["$100=81\n", "G10L2P1X1\n", "$N0=G21\n", "$I=mill\n", "$RST=#\n"] {
        scribe.with_store.push((Source::Store, Event::StoreFailed));
        let said = scribe.answer_to(line);
        assert!(
            said.starts_with(&format!("{NOT_STORED}ok\r\n")) || said.contains(&format!("\r\n{NOT_STORED}ok\r\n")),
            "{line}: {said}"
        );
        assert_eq!(said.matches(NOT_STORED).count(), 1, "{line}: {said}");
        assert_eq!(scribe.answer_to("$101=82\n"), "ok\r\n", "after {line}");
    }
}

/// The command is `$22=0`. It stores two records, because `$20` changes with it.
#[test]
fn two_failures_of_one_command_are_told_once() {
    let mut scribe = Scribe::<false>::new();
    assert_eq!(scribe.answer_to("$22=1\n"), "ok\r\n");
    assert_eq!(scribe.answer_to("$20=1\n"), "ok\r\n");
    scribe.with_store.push((Source::Store, Event::StoreFailed));
    assert_eq!(scribe.answer_to("$22=0\n"), format!("{NOT_STORED}ok\r\n"), "{:?}", scribe.log);
}

/// Writing flash stalls the processor, so events that occur meanwhile arrive together with the store's answer.
#[test]
fn a_reset_while_a_setting_is_stored_leaves_no_failure_behind() {
    let mut scribe = Scribe::<false>::new();
    let stopped = StepEvent::Stopped { stops: 1, moving: false, position: Default::default() };
    scribe.with_store = vec![
        (Source::Commands, Event::Realtime(Realtime::Reset)),
        (Source::Step, Event::Step(stopped)),
        (Source::Store, Event::StoreFailed),
    ];
    assert_eq!(scribe.answer_to("$100=81\n"), format!("{NOT_STORED}ok\r\n\r\nGrbl 1.1h ['$' for help]\r\n"));
    scribe.epoch += 1;
    assert_eq!(scribe.answer_to("$101=82\n"), "ok\r\n");
    assert_eq!(scribe.answer_to("G10L2P1X1\n"), "ok\r\n");
}

/// An epoch ends at each reset, stop and jog cancel. A byte of the next epoch can arrive before the command that ends
/// the epoch. The byte then waits for that command. Here `HOST_CHANGED`, the mark of a change of hosts, comes after
/// such a byte. While the door is open, the mark is usually taken at once. But here it must stay behind the byte.
#[test]
fn a_change_of_hosts_is_not_taken_in_front_of_a_byte_that_waits() {
    let mut controller = started(PROFILE, 16);
    let now = Instant::from_ticks(0);
    while controller.output(now, Room { step: true, reply: true }).is_some() {}
    controller.event(now, Event::Realtime(Realtime::SafetyDoor));
    while controller.output(now, Room { step: true, reply: true }).is_some() {}
    let change = LineByte { byte: HOST_CHANGED, epoch: 1, damaged: false };
    assert!(controller.is_old(change));
    controller.event(now, Event::Line(LineByte { byte: b'G', epoch: 1, damaged: false }));
    assert!(!controller.is_old(change));
}

/// A stop ends motion and programs. A store in progress continues, and the controller restarts after it.
#[test]
fn a_stop_while_defaults_are_stored_does_not_keep_them_from_acting() {
    for held in [&[][..], &[Realtime::FeedHold][..]] {
        let mut scribe = Scribe::<false>::new();
        assert_eq!(scribe.answer_to("$100=80\n"), "ok\r\n");
        let commands = held.iter().chain(&[Realtime::Stop]);
        scribe.with_store = commands.map(|command| (Source::Commands, Event::Realtime(*command))).collect();
        scribe.with_store.push((Source::Store, Event::Stored));
        let said = scribe.answer_to("$RST=$\n");
        assert_eq!(said, "[MSG:Restoring defaults]\r\nok\r\n\r\nGrbl 1.1h ['$' for help]\r\n", "{held:?}");
    }
}

/// A pump whose host sends comments without end. In the time of each comment, the step task executes one segment.
struct Flooded {
    controller: Controller<3>,
    text: VecDeque<u8>,
    sent: u32,
    begun: u32,
    lines: u32,
    /// `true` once the last segment of the motion has been handed to the step task.
    ended: bool,
    /// Minimum number of segments in the queue. It is counted at the end of each line, from the start of the first
    /// segment until the last one is queued.
    fewest: u32,
}

impl Pump<3> for Flooded {
    const IS_WOKEN: bool = true;

    fn controller(&mut self) -> &mut Controller<3> {
        &mut self.controller
    }

    fn begin(&mut self) -> Instant {
        Instant::from_ticks(0)
    }

    fn observed(&mut self) -> Observed {
        // Reports no waiting lines until motion has begun, because a motion does not begin while lines wait.
        let received = if self.sent == 0 { 0 } else { 255 };
        Observed { segments_begun: self.begun, step_idle: self.sent == 0, rx_free: 0, received, activity: 0 }
    }

    fn next_event(&mut self, _: Source) -> Option<Event<3>> {
        None
    }

    fn next_line_byte(&mut self) -> Option<LineByte> {
        let byte = self.text.pop_front().unwrap_or_else(|| {
            self.text.extend(b"a)\n");
            b'('
        });
        if byte == b'\n' {
            self.lines += 1;
            // Like the step task, take the first segment only when some segments are queued.
            if self.begun > 0 || self.sent >= 8 {
                self.begun = self.sent.min(self.begun + 1);
                if !self.ended {
                    self.fewest = self.fewest.min(self.sent - self.begun);
                }
            }
        }
        Some(LineByte { byte, epoch: 0, damaged: false })
    }

    fn make_room(&mut self, _: bool) -> bool {
        false
    }

    fn room(&mut self) -> Room {
        Room { step: self.sent - self.begun < SEGMENTS_DEPTH as u32, reply: true }
    }

    fn carry(&mut self, output: Output) {
        if let Output::Step(ToStep::Segment(segment)) = output {
            self.sent += 1;
            self.ended |= segment.flags & Segment::FLAG_LAST != 0;
        }
    }
}

#[test]
fn a_host_that_floods_does_not_starve_the_step_task() {
    let mut scribe = Scribe::<true>::new();
    for setting in ["$110=10000\n", "$120=5000\n"] {
        assert_eq!(scribe.answer_to(setting), "ok\r\n");
    }
    let Scribe { controller, .. } = scribe;
    let text = b"G1X40F9000\n".iter().copied().collect();
    let mut pump = Flooded { controller, text, sent: 0, begun: 0, lines: 0, ended: false, fewest: u32::MAX };
    for _ in 0..20_000 {
        round(&mut pump);
        if pump.ended && pump.begun == pump.sent {
            break;
        }
    }
    assert!(pump.ended && pump.sent > 200, "{} segments, {} lines", pump.sent, pump.lines);
    // The pump takes a line before it sends a segment only while at least 8 ms of motion are queued. These are at
    // least four segments, because a segment lasts at most 2 ms.
    assert!((2..=6).contains(&pump.fewest), "{} segments were left", pump.fewest);
    assert!(pump.lines > 200, "{} lines were read meanwhile", pump.lines);
}

/// A host may request more reports than its link can carry. Between the reports, its lines are still answered and its
/// listings continue.
#[test]
fn a_host_that_floods_does_not_starve_its_own_lines() {
    for most in [1, 4, 20] {
        let mut scribe = Scribe::<true>::new();
        for turn in 0..3000 / most {
            if turn == 300 / most {
                scribe.send("G21\n$G\n$$\nG4P0\n");
            }
            scribe.events.extend(vec![(Source::Commands, Event::Realtime(Realtime::Status)); 10]);
            scribe.pieces = most;
            while round(&mut scribe) {}
        }
        let (answers, reports) = (scribe.said.matches("ok\r\n").count(), scribe.said.matches('<').count());
        assert_eq!((answers, scribe.lines.len()), (4, 0), "{most}: {reports} reports");
        assert!(reports > 100 && scribe.said.contains("$132=200.000\r\n"), "{most}: {reports} reports");
    }
}

/// A jog does not begin if its host has gone. The value of `$914` (a lost host is a fault) does not matter, because
/// that setting is for jobs only.
#[test]
fn a_jog_that_was_read_as_its_host_went_does_not_begin() {
    for (setting, host_goes) in [("$914=0\n", false), ("$914=0\n", true), ("$914=1\n", true)] {
        let (mut controller, now) = (started(PROFILE, 16), Instant::from_ticks(0));
        let room = Room { step: true, reply: true };
        controller.observe(Observed { step_idle: true, rx_free: 255, ..Observed::default() });
        for line in [setting, "$J=G91X1F500\n"] {
            while controller.output(now, room).is_some() {}
            for byte in line.bytes() {
                controller.event(now, Event::Line(LineByte { byte, epoch: 0, damaged: false }));
            }
        }
        if host_goes {
            controller.event(now, Event::Disconnected(1));
        }
        let outputs: Vec<Output> = std::iter::from_fn(|| controller.output(now, room)).take(100).collect();
        let moves = outputs.iter().any(|output| matches!(output, Output::Step(ToStep::Segment(_))));
        assert_eq!(moves, !host_goes, "{setting}{outputs:?}");
    }
}
