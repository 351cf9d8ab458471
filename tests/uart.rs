//! Tests the reader of a UART's received bytes, in memory and without hardware. Bytes keep their order, and lost bytes
//! are marked at their position. No line with a damaged byte is carried out, even if bytes arrive between any two
//! memory accesses of the reader.
//!
//! The receive buffer is a ring of slots, one per byte. A pass is one run of the reader over the received bytes. A lap
//! is an overrun: DMA has overtaken the reader by one round of the ring.

use oxmill_boards::calls::{Calls, REST, is_stop};
use oxmill_boards::uart_receiver::{Buffer, ByteSource, Look, MOST_WAITING, ReceivedBytes, SLOTS, UartReceiver};
use proptest::prelude::*;
use std::cell::{Cell, RefCell};
use std::collections::VecDeque;
use std::rc::Rc;
use std::sync::atomic::{AtomicU16, Ordering};

/// Stands in for DMA and the UART, or for the interrupt of a UART without DMA.
struct Wire {
    buffer: &'static Buffer,
    place: Cell<usize>,
    damaged: Cell<bool>,
    /// For each of the next calls of `place`: bytes that arrive right after the place has been read.
    at_place: RefCell<VecDeque<Vec<u8>>>,
    /// Bytes that arrive when the reader next clears the damage flag.
    at_clear: RefCell<Vec<u8>>,
    /// Bytes that arrive while the reader waits until DMA has both written and counted its newest byte (`settle`).
    at_settle: RefCell<Vec<u8>>,
    /// A byte that DMA has counted but not yet written, with its slot.
    unwritten: Cell<Option<(usize, u8)>>,
}

impl Wire {
    fn come(&self, byte: u8) {
        self.write();
        self.buffer[self.place.get()].store(byte.into(), Ordering::Relaxed);
        self.place.set((self.place.get() + 1) % SLOTS);
    }

    fn come_all(&self, bytes: &[u8]) {
        bytes.iter().for_each(|byte| self.come(*byte));
    }

    fn count(&self, byte: u8) {
        self.write();
        self.unwritten.set(Some((self.place.get(), byte)));
        self.place.set((self.place.get() + 1) % SLOTS);
    }

    fn write(&self) {
        if let Some((slot, byte)) = self.unwritten.take() {
            self.buffer[slot].store(byte.into(), Ordering::Relaxed);
        }
    }
}

#[derive(Clone)]
struct Dma(Rc<Wire>);

impl ByteSource for Dma {
    const IS_CIRCULAR: bool = true;

    fn place(&self) -> usize {
        let place = self.0.place.get();
        let bytes = self.0.at_place.borrow_mut().pop_front();
        self.0.come_all(&bytes.unwrap_or_default());
        place
    }

    fn is_damaged(&self) -> bool {
        self.0.damaged.get()
    }

    fn clear_damage(&mut self) {
        self.0.damaged.set(false);
        let bytes = self.0.at_clear.take();
        self.0.come_all(&bytes);
    }

    fn settle(&self) {
        let bytes = self.0.at_settle.take();
        self.0.come_all(&bytes);
    }
}

fn buffer() -> &'static Buffer {
    Box::leak(Box::new([const { AtomicU16::new(0) }; SLOTS]))
}

fn by_dma() -> (Rc<Wire>, UartReceiver<Dma>) {
    let wire = Rc::new(Wire {
        buffer: buffer(),
        place: Cell::new(0),
        damaged: Cell::new(false),
        at_place: RefCell::default(),
        at_clear: RefCell::default(),
        at_settle: RefCell::default(),
        unwritten: Cell::new(None),
    });
    (wire.clone(), UartReceiver::new(Dma(wire.clone()), wire.buffer))
}

/// Output of the reader: bytes, and `None` where bytes are missing.
#[derive(Default)]
struct Out(Vec<Option<u8>>);

impl Out {
    fn send(&mut self, room: &mut usize, message: ReceivedBytes) -> bool {
        if *room == 0 {
            return false;
        }
        *room -= 1;
        self.0.extend(message.is_behind_loss.then_some(None));
        assert!(!message.from(0).is_empty() && message.from(0).len() <= ReceivedBytes::MOST);
        self.0.extend(message.from(0).iter().copied().map(Some));
        true
    }

    /// Makes one pass, with room for `room` messages.
    fn glance<S: ByteSource>(&mut self, receiver: &mut UartReceiver<S>, room: &mut usize) -> Look {
        receiver.look(|message| self.send(room, message))
    }

    fn pass_on<S: ByteSource>(&mut self, receiver: &mut UartReceiver<S>, room: &mut usize, calls: bool) {
        receiver.pass_on(calls, |message| self.send(room, message));
    }

    /// Makes passes until all bytes have been output: a single pass reads few bytes.
    fn look<S: ByteSource>(&mut self, receiver: &mut UartReceiver<S>) -> Look {
        let (mut room, mut found) = (usize::MAX, Look::default());
        loop {
            let before = self.0.len();
            let look = self.glance(receiver, &mut room);
            self.pass_on(receiver, &mut room, true);
            found =
                Look { stop: found.stop | look.stop, news: found.news | look.news, waits: found.waits | look.waits };
            if self.0.len() - before < AT_A_TIME / 2 {
                return found;
            }
        }
    }

    fn text(&self) -> String {
        self.0.iter().map(|byte| byte.map_or('#', char::from)).collect()
    }

    /// Returns the lines that would be carried out: those without missing bytes and without `@`, which replaces a
    /// damaged byte.
    fn lines(&self) -> Vec<String> {
        let (mut lines, mut line, mut is_whole) = (Vec::new(), String::new(), true);
        for byte in &self.0 {
            match byte {
                None => is_whole = false,
                Some(b'\n') => {
                    if is_whole && !line.is_empty() && !line.contains('@') {
                        lines.push(line.clone());
                    }
                    (line, is_whole) = (String::new(), true);
                }
                Some(byte) if is_stop(*byte) || *byte == b'?' => {}
                Some(byte) => line.push(char::from(*byte)),
            }
        }
        lines
    }
}

/// Maximum number of bytes of text that the reader reads in one pass. A byte that is not text counts double.
const AT_A_TIME: usize = 28;

#[derive(Clone, Debug)]
enum Step {
    /// This many bytes arrive.
    Come(usize),
    /// DMA counts a byte, and writes it into its slot a little later.
    Count,
    /// The reader runs once; this many messages can be sent.
    Look(usize),
}

fn step() -> impl Strategy<Value = Step> {
    prop_oneof![
        4 => (1_usize..40).prop_map(Step::Come),
        1 => Just(Step::Count),
        3 => (0_usize..6).prop_map(Step::Look),
        1 => Just(Step::Look(usize::MAX)),
    ]
}

proptest! {
    /// As long as the buffer has room for the bytes that arrive, all of them are output in order, whenever the reader
    /// runs.
    #[test]
    fn bytes_come_out_as_they_came(steps in prop::collection::vec(step(), 1..60)) {
        let (wire, mut receiver) = by_dma();
        let (mut out, mut sent) = (Out::default(), Vec::new());
        for step in steps {
            let room = MOST_WAITING - (sent.len() - out.0.len()).min(MOST_WAITING);
            let next = |sent: &mut Vec<u8>| {
                // Neighbouring characters differ, so a lost or a doubled one is noticed.
                let byte = b'A' + (sent.len() % 50) as u8;
                sent.push(byte);
                byte
            };
            match step {
                Step::Come(count) => (0..count.min(room)).for_each(|_| wire.come(next(&mut sent))),
                Step::Count if room > 0 => wire.count(next(&mut sent)),
                Step::Count => {}
                Step::Look(mut room) => {
                    out.glance(&mut receiver, &mut room);
                    out.pass_on(&mut receiver, &mut room, true);
                    wire.write();
                }
            }
        }
        wire.write();
        out.look(&mut receiver);
        prop_assert_eq!(out.0, sent.into_iter().map(Some).collect::<Vec<_>>());
    }

    /// Some bytes are damaged and become other bytes, even line ends. The reader can run between the report of a damage
    /// and the damaged byte. Other bytes arrive while the reader clears the report. Each line that is carried out must
    /// have been sent, must be undamaged, and must not be carried out twice.
    #[test]
    fn no_damaged_line_is_carried_out(
        damaged in prop::collection::btree_map(
            0_usize..280,
            (prop_oneof![Just(b'\n'), Just(b'7'), Just(0xFF_u8)], any::<bool>()),
            1..5,
        ),
        looks in prop::collection::vec((1_usize..14, 1_usize..4), 20..60),
        during in prop::collection::vec(0_usize..3, 10),
    ) {
        let lines: Vec<String> = (0..40).map(|line| format!("X{:05}", 10_000 + line)).collect();
        let sent: Vec<u8> = lines.iter().flat_map(|line| format!("{line}\n").into_bytes()).collect();
        let (wire, mut receiver) = by_dma();
        let (mut out, mut at, mut during) = (Out::default(), 0, during.into_iter().cycle());
        for (count, times) in looks.into_iter().cycle() {
            let end = (at + count).min(sent.len());
            while at < end {
                if let Some((byte, is_looked_at)) = damaged.get(&at) {
                    wire.damaged.set(true);
                    if *is_looked_at {
                        out.look(&mut receiver);
                    }
                    wire.come(*byte);
                } else {
                    wire.come(sent[at]);
                }
                at += 1;
            }
            for _ in 0..times {
                // While the reader clears the damage flag, only undamaged bytes may arrive: a damaged one would set the
                // flag again.
                let more = during.next().unwrap().min(sent.len() - at);
                let more = (0..more).take_while(|k| !damaged.contains_key(&(at + k))).count();
                wire.at_clear.replace(sent[at..at + more].to_vec());
                out.look(&mut receiver);
                at += more - wire.at_clear.take().len();
            }
            if at == sent.len() {
                break;
            }
        }
        // Two good lines follow all damage. At least the second of them must be carried out.
        out.look(&mut receiver);
        wire.come_all(b"\nEND1\nEND2\n");
        out.look(&mut receiver);
        let carried_out = out.lines();
        let mut left = lines.iter().enumerate();
        for line in &carried_out[..carried_out.len() - 1] {
            if line == "END1" {
                continue;
            }
            let found = left.find(|(_, sent)| *sent == line);
            prop_assert!(found.is_some(), "{line} was not sent, or not in this order: {}", out.text());
            let (number, _) = found.unwrap();
            prop_assert!((number * 7..number * 7 + 7).all(|byte| !damaged.contains_key(&byte)), "{line} was damaged");
        }
        prop_assert_eq!(carried_out.last().map(String::as_str), Some("END2"));
    }
}

/// Damages each byte of three lines in turn: the byte becomes a digit or a line end. Varies how often the reader runs,
/// and whether it runs between the report of the damage and the byte. No part of the damaged line may be carried out.
#[test]
fn a_damaged_byte_at_each_place() {
    let sent = b"G1X11\nG1X12\nG1X13\n";
    let places = || (0..sent.len()).flat_map(|place| [b'7', b'\n'].map(|byte| (place, byte)));
    for (place, becomes) in places() {
        for (every, times, is_looked_at) in (1..7).flat_map(|every| {
            (1..4).flat_map(move |times| [false, true].map(|is_looked_at| (every, times, is_looked_at)))
        }) {
            let (wire, mut receiver) = by_dma();
            let mut out = Out::default();
            for (at, byte) in sent.iter().enumerate() {
                if at == place {
                    wire.damaged.set(true);
                    if is_looked_at {
                        out.look(&mut receiver);
                    }
                }
                wire.come(if at == place { becomes } else { *byte });
                if at % every == 0 {
                    (0..times).for_each(|_| _ = out.look(&mut receiver));
                }
            }
            (0..3).for_each(|_| _ = out.look(&mut receiver));
            wire.come_all(b"\nG1X14\n");
            out.look(&mut receiver);
            let (lines, text) = (out.lines(), out.text());
            let bad = format!("G1X1{}", place / 6 + 1);
            assert!(!lines.contains(&bad), "place {place}, every {every}, {times} times: {text:?}");
            let is_sent = |line: &String| line.len() == 5 && line.starts_with("G1X1");
            assert!(lines.iter().all(is_sent), "place {place}, every {every}, {times} times: {text:?}");
            assert_eq!(lines.last().map(String::as_str), Some("G1X14"));
            assert!(out.0.contains(&None), "a loss is told");
        }
    }
}

/// The reader drops no byte after damaged bytes, however many bytes its unfinished message already contains.
#[test]
fn nothing_is_dropped_behind_damaged_bytes() {
    for count in 1..3 * ReceivedBytes::MOST {
        let (wire, mut receiver) = by_dma();
        let mut out = Out::default();
        wire.damaged.set(true);
        wire.come_all(&vec![b'x'; count]);
        (0..3).for_each(|_| _ = out.glance(&mut receiver, &mut usize::MAX.clone()));
        wire.come_all(b"abc");
        out.look(&mut receiver);
        assert_eq!(out.text(), format!("#{}abc", "@".repeat(count + 1)));
    }
}

/// DMA has counted a byte but not yet written it, so the reader leaves the byte for its next run. If damage was
/// reported before, the reader takes this byte as damaged, although it reads the byte only later.
#[test]
fn a_byte_that_is_counted_and_not_written() {
    let (wire, mut receiver) = by_dma();
    let mut out = Out::default();
    wire.come_all(b"ab");
    wire.count(b'c');
    out.look(&mut receiver);
    assert_eq!(out.text(), "ab");
    wire.write();
    out.look(&mut receiver);
    assert_eq!(out.text(), "abc");
    // Now the byte is damaged. DMA has not yet written it in two runs of the reader: the run that first sees the
    // damage flag, and the next run.
    wire.damaged.set(true);
    wire.count(b'1');
    out.look(&mut receiver);
    out.look(&mut receiver);
    wire.write();
    wire.come(b'2');
    out.look(&mut receiver);
    wire.come(b'\n');
    out.look(&mut receiver);
    assert_eq!(out.text(), "abc#@@@\n");
}

/// All slots but one can hold waiting bytes for any time. If one more byte arrives, all waiting bytes are lost, except
/// the last stop (a byte that stops the machine). The loss is reported once.
#[test]
fn a_full_buffer_and_a_lap() {
    for more in [0, 1, 2, SLOTS - 1, SLOTS, SLOTS + 1, 3 * SLOTS + 7] {
        for stop in [None, Some(0), Some(SLOTS / 2), Some(SLOTS - 3)] {
            for before in [0, 1, 100, SLOTS - 1] {
                let (wire, mut receiver) = by_dma();
                let mut out = Out::default();
                wire.come_all(&vec![b'a'; before]);
                out.look(&mut receiver);
                out.0.clear();
                let count = SLOTS - 1 + more;
                let mut bytes = vec![b'x'; count];
                // `stop` counts from the newest byte, because older bytes can have been overwritten.
                if let Some(stop) = stop {
                    bytes[count - 1 - stop] = b'!';
                }
                wire.come_all(&bytes);
                let look = out.look(&mut receiver);
                assert_eq!(look.stop, stop.is_some(), "{more} {stop:?} {before}");
                if more == 0 {
                    assert_eq!(out.0, bytes.iter().copied().map(Some).collect::<Vec<_>>());
                } else {
                    assert_eq!(out.text(), if stop.is_some() { "#!" } else { "" });
                }
                out.0.clear();
                wire.come_all(b"y\nz\n");
                out.look(&mut receiver);
                assert_eq!(out.text(), if more == 0 { "y\nz\n" } else { "#y\nz\n" });
                // The reader works as before.
                out.0.clear();
                wire.come_all(&vec![b'v'; SLOTS - 1]);
                out.look(&mut receiver);
                assert_eq!(out.text(), "v".repeat(SLOTS - 1));
            }
        }
    }
}

/// Nobody takes the reader's messages while bytes arrive without end. The oldest bytes are lost, except those that
/// stop the machine, and the loss is reported once. The reader moves bytes to make room. So DMA never overtakes the
/// reader by a round of the ring, and no pass has to empty all slots.
#[test]
fn the_oldest_bytes_are_lost_where_nobody_takes_them() {
    let (wire, mut receiver) = by_dma();
    let (mut out, mut sent) = (Out::default(), 0);
    let mut come = |count: usize| {
        let text: Vec<u8> = (sent..sent + count).map(|number| b'A' + (number % 50) as u8).collect();
        sent += count;
        wire.come_all(&text);
        text
    };
    let mut last = Vec::new();
    for _ in 0..300 {
        last.extend(come(5));
        out.glance(&mut receiver, &mut 0);
        out.pass_on(&mut receiver, &mut 0, true);
    }
    wire.come(b'!');
    last.extend(b"!");
    for _ in 0..300 {
        last.extend(come(1));
        assert!(out.glance(&mut receiver, &mut 0).news);
    }
    let look = out.look(&mut receiver);
    assert!(look.stop, "the stop has waited for room");
    // The output begins with the bytes of the message that could not be sent. Then comes the mark of the loss (`None`),
    // and then the newest bytes, without a gap.
    let (first, behind) = out.0.split_at(ReceivedBytes::MOST);
    assert_eq!(first, last[..ReceivedBytes::MOST].iter().copied().map(Some).collect::<Vec<_>>());
    assert_eq!(behind[0], None, "the loss is told");
    let behind: Vec<u8> = behind[1..].iter().map(|byte| byte.expect("it is told once")).collect();
    assert!(last.ends_with(&behind) && behind[0] == b'!' && behind.len() == 301, "{} behind the loss", behind.len());
}

/// The reader sees a stop byte at once or within a few runs, even if no message can be sent and much text precedes the
/// stop. From then on each run requests an immediate call of the serial task, until the stop has been passed on.
#[test]
fn a_stop_is_seen_behind_text_that_has_no_room() {
    for stop in [b'!', 0x18, 0x19, 0x84, 0x85] {
        for text in [1, 13, 14, 15, 100, 250] {
            let (wire, mut receiver) = by_dma();
            let mut out = Out::default();
            wire.come_all(&vec![b'x'; text]);
            let see = |out: &mut Out, receiver: &mut UartReceiver<Dma>| {
                let look = out.glance(receiver, &mut 0);
                out.pass_on(receiver, &mut 0, look.stop);
                look.stop
            };
            assert!((0..20).all(|_| !see(&mut out, &mut receiver)), "{text}: no stop has come");
            wire.come(stop);
            let looks = (0..20).position(|_| see(&mut out, &mut receiver));
            assert!(looks.is_some_and(|looks| looks <= 10), "{text} bytes in front of {stop:#x}: {looks:?}");
            assert!((0..20).all(|_| see(&mut out, &mut receiver)), "{text}: it waits still");
            assert!(out.look(&mut receiver).stop);
            assert_eq!(out.0.last(), Some(&Some(stop)));
            assert!(!see(&mut out, &mut receiver), "{text}: it is passed on");
        }
    }
}

/// If the buffer seems full, the reader waits until DMA has written and counted its newest byte. A byte that arrives
/// during this wait does not hide an overrun.
#[test]
fn a_lap_is_seen_when_another_byte_comes_meanwhile() {
    let (wire, mut receiver) = by_dma();
    let mut out = Out::default();
    wire.come_all(&vec![b'x'; SLOTS + 5]);
    wire.at_settle.replace(b"5\n".to_vec());
    out.look(&mut receiver);
    wire.come_all(b"end\n");
    out.look(&mut receiver);
    assert_eq!(out.text(), "#end\n");
}

/// The step task can interrupt a pass anywhere, and bytes can arrive in that time. To the reader, a slot that such a
/// byte has filled must not look like an overrun.
#[test]
fn bytes_that_come_while_a_look_asks_where_it_is() {
    for counts in (0..81).map(|code| [code % 3, code / 3 % 3, code / 9 % 3, code / 27]) {
        let (wire, mut receiver) = by_dma();
        let mut out = Out::default();
        wire.come_all(b"<");
        wire.at_place.replace(counts.map(|count| vec![b'x'; count]).into());
        (0..6).for_each(|_| _ = out.look(&mut receiver));
        assert_eq!(out.text(), format!("<{}", "x".repeat(counts.iter().sum())), "{counts:?}");
    }
}

/// Of several stop bytes that are in the buffer when an overrun empties it, only the most severe one is kept.
#[test]
fn the_heaviest_stop_is_kept_behind_a_lap() {
    for (stops, kept) in [(&b"!\x85"[..], b'!'), (b"\x18!", 0x18), (b"!\x19\x84", 0x19), (b"\x85\x84!", 0x84)] {
        let (wire, mut receiver) = by_dma();
        let mut out = Out::default();
        wire.come_all(&vec![b'x'; SLOTS + 5]);
        wire.come_all(stops);
        assert!(out.look(&mut receiver).stop);
        assert_eq!(out.0, [None, Some(kept)], "{}", stops.escape_ascii());
    }
}

/// A byte of a UTF-8 character can have the value of the door or jog cancel command, and can occur twice in a row. No
/// such byte is dropped as a repeated command.
#[test]
fn characters_come_whole() {
    let text = "(1億 充 ㅅ Ä)\n".as_bytes();
    let (wire, mut receiver) = by_dma();
    let mut out = Out::default();
    wire.come_all(text);
    (0..3).for_each(|_| _ = out.look(&mut receiver));
    assert_eq!(out.0, text.iter().copied().map(Some).collect::<Vec<_>>());
}

/// DMA overtakes the reader just after the reader has checked for an overrun, so the reader takes the newest byte for
/// the oldest. The reader must detect the overrun later, and then read new bytes correctly.
#[test]
fn a_lap_within_a_look_leaves_no_reader_waiting() {
    for late in 1..6 {
        let (wire, mut receiver) = by_dma();
        let mut out = Out::default();
        wire.come_all(&vec![b'x'; SLOTS - 1]);
        wire.damaged.set(true);
        wire.at_clear.replace(vec![b'y'; late]);
        (0..40).for_each(|_| _ = out.look(&mut receiver));
        // From the next bytes the reader detects that DMA has overtaken it. These bytes are lost, together with the
        // waiting ones.
        wire.come_all(b"\n\n");
        out.look(&mut receiver);
        wire.come_all(b"end\n");
        (0..3).for_each(|_| _ = out.look(&mut receiver));
        assert!(out.text().ends_with("end\n"), "{late}: {}", out.text());
    }
}

/// After an overrun the reader empties all slots. Bytes that arrive while it does so are lost, too, except a stop byte.
/// Bytes that arrive after the last slot has been emptied are read normally.
#[test]
fn bytes_that_come_while_the_slots_are_emptied() {
    for (first, last, expected) in [
        (b"12345".as_slice(), b"".as_slice(), "#end\n"),
        (b"12!45", b"", "#!#end\n"),
        (b"12345", b"678", "#end\n"),
        (b"", b"6!8", "#6!8end\n"),
        (b"", b"!", "#!end\n"),
        (b"1", b"!", "#!#end\n"),
    ] {
        let (wire, mut receiver) = by_dma();
        let mut out = Out::default();
        wire.come_all(&vec![b'x'; SLOTS + 5]);
        // The reader calls `place` five times: at the start of its run, twice after it has waited for DMA to complete
        // the newest byte, once before it empties the first slot, and once after it has emptied the last slot.
        wire.at_place.replace([b"", b"", b"", first, last].map(Vec::from).into());
        out.look(&mut receiver);
        wire.come_all(b"end\n");
        out.look(&mut receiver);
        assert_eq!(out.text(), expected);
    }
}

/// DMA has written the newest byte but not yet counted it. So the slot for the next byte seems to be in use, as after
/// an overrun, and still nothing is lost.
#[test]
fn a_byte_that_is_about_to_be_counted() {
    let (wire, mut receiver) = by_dma();
    let mut out = Out::default();
    let place = wire.place.get();
    wire.buffer[place].store(u16::from(b'a'), Ordering::Relaxed);
    // DMA counts the byte while the reader waits for it.
    wire.at_settle.replace(b"a".to_vec());
    out.glance(&mut receiver, &mut 0);
    out.look(&mut receiver);
    assert_eq!(out.text(), "a");
}

#[test]
fn what_is_to_be_called_for() {
    let (wire, mut receiver) = by_dma();
    let (mut out, mut room) = (Out::default(), usize::MAX);
    assert_eq!(out.glance(&mut receiver, &mut room), Look::default());
    // If text has no line end, the reader waits for a few runs in case the end follows, and then asks to send the text
    // (`waits`).
    wire.come_all(b"G1X1");
    for _ in 1..4 {
        assert_eq!(out.glance(&mut receiver, &mut room), Look::default());
    }
    assert_eq!(out.glance(&mut receiver, &mut room), Look { waits: true, ..Look::default() });
    out.pass_on(&mut receiver, &mut room, true);
    assert_eq!((out.glance(&mut receiver, &mut room), out.text().as_str()), (Look::default(), "G1X1"));
    for (bytes, look) in [
        (b"\n".as_slice(), Look { news: true, ..Look::default() }),
        (b"?", Look { news: true, ..Look::default() }),
        (b"01234567890123456789012345678901", Look { news: true, ..Look::default() }),
        (b"!", Look { news: true, stop: true, ..Look::default() }),
        (b"\x18", Look { news: true, stop: true, ..Look::default() }),
        // A reset that repeats the one just before it does not count as a new stop.
        (b"\x18", Look { news: true, ..Look::default() }),
    ] {
        wire.come_all(bytes);
        assert_eq!(out.look(&mut receiver), look, "{bytes:?}");
        assert_eq!(out.glance(&mut receiver, &mut room), Look::default());
    }
    // If no message can be sent, the bytes stay in the buffer, and the reader requests a call of the serial task for
    // them. If a stop is among the bytes, the reader requests an immediate call.
    out.0.clear();
    wire.come_all(b"?G1X1\n!\n");
    out.glance(&mut receiver, &mut 0);
    out.pass_on(&mut receiver, &mut 0, true);
    assert_eq!(out.glance(&mut receiver, &mut 0), Look { news: true, stop: true, waits: true });
    out.pass_on(&mut receiver, &mut room, true);
    assert_eq!((out.glance(&mut receiver, &mut room), out.text().as_str()), (Look::default(), "?G1X1\n!\n"));
    // Between two calls of the serial task, only the first of equal commands is passed on, however often `pass_on`
    // runs.
    out.0.clear();
    for calls in [false, false, true, false, true] {
        wire.come_all(&[b'?'; AT_A_TIME / 2]);
        out.glance(&mut receiver, &mut room);
        out.pass_on(&mut receiver, &mut room, calls);
    }
    assert_eq!(out.text(), "??");
    // The reader reads only a few bytes at a time, and requests another call of the serial task for the remaining ones.
    out.0.clear();
    wire.come_all(&[b'x'; 100]);
    out.glance(&mut receiver, &mut room);
    out.pass_on(&mut receiver, &mut room, true);
    assert_eq!(out.0.len(), AT_A_TIME);
    assert!(out.glance(&mut receiver, &mut room).news);
}

/// A UART without DMA: its interrupt writes received bytes into the slots, as long as slots are free.
struct Interrupt(Cell<usize>);

impl ByteSource for Interrupt {
    const IS_CIRCULAR: bool = false;

    fn place(&self) -> usize {
        self.0.get()
    }

    fn is_damaged(&self) -> bool {
        false
    }

    fn clear_damage(&mut self) {}

    fn begin_anew(&mut self) -> bool {
        self.0.set(0);
        true
    }
}

#[test]
fn an_interrupt_fills_the_slots() {
    let mut receiver = UartReceiver::new(Interrupt(Cell::new(0)), buffer());
    let (mut out, mut is_missing) = (Out::default(), false);
    let mut put = |receiver: &mut UartReceiver<Interrupt>, byte: u8| {
        let place = receiver.source().0.get();
        is_missing = !receiver.put(byte, place, is_missing);
        receiver.source().0.set(place + usize::from(!is_missing));
        !is_missing
    };
    for round in 0..3 {
        for byte in b"G1X1\n" {
            assert!(put(&mut receiver, *byte));
        }
        assert!(out.look(&mut receiver).news, "{round}");
        assert_eq!((out.text().as_str(), receiver.source().0.get()), ("G1X1\n", 0), "it begins anew");
        out.0.clear();
    }
    // While nobody reads the bytes, the buffer soon refuses text, but still accepts a stop. The next accepted byte
    // carries the mark that bytes are missing before it.
    let kept = (0..2 * SLOTS).filter(|_| put(&mut receiver, b'x')).count();
    assert!(put(&mut receiver, b'!'));
    assert!(!put(&mut receiver, b'y') && kept < SLOTS);
    // Without DMA the reader reads fewer bytes at a time, so it empties the slots in several runs.
    let looks = (0..SLOTS).filter(|_| out.look(&mut receiver).stop).count();
    assert!(looks > 0);
    assert_eq!(out.text(), format!("{}#!", "x".repeat(kept)));
    out.0.clear();
    assert!(put(&mut receiver, b'z'));
    out.look(&mut receiver);
    assert_eq!(out.text(), "#z");
}

/// At first, the serial task may be called at once. After each call, the next one is allowed only 500 us later
/// ([`REST`] samples of the inputs).
#[test]
fn the_serial_task_is_called_in_time_and_not_too_often() {
    let mut calls = Calls::new();
    assert!(!calls.sample(|| false));
    assert!(calls.sample(|| true));
    for _ in 1..REST {
        assert!(!calls.sample(|| true));
    }
    assert!(calls.sample(|| true));
    for _ in 1..REST {
        assert!(!calls.sample(|| unreachable!("it is not time")));
    }
    assert!(!calls.sample(|| false));
    assert!(calls.sample(|| true));
}
