//! Tests of two links and their arbiter, with queues of a given depth.

use super::*;
use crate::messages::HOST_CHANGED;
use proptest::prelude::*;

/// Queues that take only a given number of commands and line bytes.
#[derive(Default)]
pub struct Depths {
    pub commands: Vec<Realtime>,
    pub lines: Vec<LineByte>,
    pub most_commands: usize,
    pub most_lines: usize,
    /// `true`: the link being read cannot make its host wait. Then a reset finds room even in a full queue, because
    /// the real serial task keeps such a reset until there is room.
    defers_resets: bool,
    pub free: bool,
    stops: usize,
    is_grbl: bool,
}

impl Queues for Depths {
    fn realtime(&mut self, command: Realtime) -> bool {
        let room = self.commands.len() < self.most_commands || self.defers_resets && command == Realtime::Reset;
        if room {
            self.commands.push(command);
        }
        room
    }

    fn line(&mut self, byte: LineByte) -> bool {
        let room = self.lines.len() < self.most_lines;
        if room {
            self.lines.push(byte);
        }
        room
    }

    fn waits(&self) -> bool {
        !self.defers_resets
    }

    fn is_free(&self) -> bool {
        self.free
    }

    fn stop(&mut self) {
        self.stops += 1;
    }

    fn reads_characters(&self) -> bool {
        !self.is_grbl
    }
}

/// Two links: `uart`, which holds one byte, and `usb`, which holds `HELD` bytes.
pub struct Both<const HELD: usize> {
    pub queues: Depths,
    pub arbiter: HostArbiter,
    pub uart: Link,
    pub usb: Link,
}

impl<const HELD: usize> Both<HELD> {
    pub fn new(most_commands: usize, most_lines: usize) -> Self {
        Both {
            queues: Depths { most_commands, most_lines, ..Depths::default() },
            arbiter: HostArbiter::new(),
            uart: Link::new(0, 1),
            usb: Link::new(1, HELD),
        }
    }

    pub fn usb(&mut self, text: &[u8]) {
        for byte in text {
            self.usb.take(*byte, &mut self.arbiter, &mut self.uart, &mut self.queues);
        }
    }

    pub fn uart(&mut self, text: &[u8]) {
        self.queues.defers_resets = true;
        for byte in text {
            self.uart.take(*byte, &mut self.arbiter, &mut self.usb, &mut self.queues);
        }
        self.queues.defers_resets = false;
    }

    pub fn pass_on(&mut self) -> bool {
        let uart = self.uart.pass_on(&mut self.arbiter, &mut self.queues);
        self.usb.pass_on(&mut self.arbiter, &mut self.queues) || uart
    }

    /// Returns the bytes in the line queue as text. A `|` stands for a [`HOST_CHANGED`], which voids the unfinished
    /// line before it. A [`HOST_CHANGED`] at the start of the queue voids nothing and is omitted.
    pub fn text(&self) -> String {
        let shown = |byte: &LineByte| if byte.byte == HOST_CHANGED { '|' } else { char::from(byte.byte) };
        self.queues.lines.iter().map(shown).collect::<String>().trim_start_matches('|').into()
    }

    /// Returns the epochs of the bytes in the line queue. Leaves out [`HOST_CHANGED`], because its `epoch` field counts
    /// disconnected hosts.
    pub fn epochs(&self) -> Vec<u16> {
        self.queues.lines.iter().filter(|byte| byte.byte != HOST_CHANGED).map(|byte| byte.epoch).collect()
    }

    /// Returns the number of refused lines that still have to be answered: first of `uart`, then of `usb`.
    pub fn refusals(&self) -> (u16, u16) {
        (self.uart.refusals, self.usb.refusals)
    }
}

const PACKET: usize = 64;
const HELD: usize = 192;

#[test]
fn a_link_that_cannot_wait_has_each_command_tried() {
    let mut both = Both::<16>::new(0, 8);
    both.uart(b"?\x18?");
    assert_eq!(both.queues.commands, [Realtime::Reset]);
    both.uart(b"G");
    assert!(both.queues.lines[0].damaged && !both.uart.is_waiting(), "the others are lost, and that is said");
}

/// A reset drops all unfinished lines, also those that have lost bytes. So no line after the reset is refused for
/// these losses.
#[test]
fn bytes_lost_before_a_reset_refuse_no_line_behind_it() {
    for is_lost_behind in [false, true] {
        let mut both = Both::<16>::new(8, 4);
        both.uart(b"G1X10Y10\nG1X");
        both.queues.lines.clear();
        both.pass_on();
        both.uart(b"\x18");
        if is_lost_behind {
            both.uart.lose();
        }
        both.uart(b"$X\n");
        assert_eq!(both.queues.lines.iter().any(|byte| byte.damaged && byte.epoch > 0), is_lost_behind);
    }
}

#[test]
fn realtime_bytes_pass_lines_that_wait() {
    let mut both = Both::<16>::new(8, 5);
    both.usb(b"G1X10\n?Y2!\x18");
    assert_eq!(both.queues.commands, [Realtime::Status, Realtime::FeedHold, Realtime::Reset]);
    assert_eq!((both.text().as_str(), both.queues.stops), ("G1X1", 1));
    assert!(both.usb.is_waiting() && !both.usb.mid_line);
    both.queues.most_lines = 100;
    assert!(both.pass_on());
    assert_eq!(both.text(), "G1X10\nY2");
    assert!(!both.usb.is_waiting());
    assert!(both.queues.lines.iter().all(|byte| !byte.damaged));
}

/// A sender that does not count characters has to wait. As on the real port, a packet is fetched only if a whole packet
/// fits.
#[test]
fn a_flood_is_told_to_wait_and_nothing_is_lost() {
    let mut both = Both::<HELD>::new(64, 255);
    let flood: Vec<u8> = (0..5000_u32).map(|n| if n % 7 == 6 { b'\n' } else { b'A' + (n % 26) as u8 }).collect();
    let mut packets = flood.chunks(PACKET);
    let (mut taken, mut most_held, mut waits) = (String::new(), 0, 0);
    loop {
        if both.usb.room() >= PACKET {
            let Some(packet) = packets.next() else { break };
            both.usb(packet);
        } else {
            waits += 1;
            // The controller reads nine bytes, about one line.
            taken.extend(both.queues.lines.drain(..9).map(|byte| {
                assert!(!byte.damaged);
                char::from(byte.byte)
            }));
            both.pass_on();
        }
        most_held = most_held.max(both.usb.held());
    }
    taken.push_str(&both.text());
    both.queues.lines.clear();
    both.pass_on();
    taken.push_str(&both.text());
    assert_eq!(taken.trim_start_matches(char::from(HOST_CHANGED)).as_bytes(), flood);
    assert!(waits > 100 && most_held > HELD - PACKET, "{waits} {most_held}");
}

/// A sender that counts characters has at most 255 line bytes in transit. All of them fit into the line queue (256
/// bytes here), so the link holds no bytes. Commands between them pass while the command queue has room.
#[test]
fn a_counting_sender_never_waits() {
    let mut both = Both::<HELD>::new(1000, 256);
    for n in 0..255 {
        both.usb(if n % 20 == 19 { b"\n?" } else { b"X?" });
        assert_eq!(both.usb.room(), HELD);
    }
    assert_eq!(both.queues.commands.len(), 255);
}

#[test]
fn a_full_queue_of_commands_stops_the_link_without_a_loss() {
    let mut both = Both::<16>::new(2, 100);
    let mut bytes = b"??!~G".iter();
    while both.usb.room() > 0 {
        both.usb(&[*bytes.next().unwrap()]);
    }
    assert_eq!(bytes.as_slice(), b"~G");
    assert!(both.usb.is_waiting());
    both.queues.commands.clear();
    assert!(both.pass_on());
    assert_eq!(both.queues.commands, [Realtime::FeedHold]);
    assert_eq!(both.usb.room(), 16);
}

#[test]
fn a_link_that_cannot_wait_says_what_it_lost() {
    let mut both = Both::<16>::new(2, 3);
    both.uart(b"ABCDEFG");
    both.queues.most_lines = 100;
    both.pass_on();
    both.uart(b"H\n");
    assert_eq!(both.text(), "ABCDH\n");
    let damaged: Vec<bool> = both.queues.lines.iter().map(|byte| byte.damaged).collect();
    assert_eq!(damaged, [false, false, false, false, true, false]);
}

#[test]
fn a_refusal_is_sent_as_there_is_room() {
    let mut both = Both::<16>::new(8, 100);
    both.usb(b"G0\n");
    both.uart(b"G1\nG2\n");
    let mut sent = Vec::new();
    let mut rounds = 1;
    while !both.uart.refuse(|byte| {
        let room = sent.len() < rounds * 10;
        if room {
            sent.push(byte);
        }
        room
    }) {
        rounds += 1;
    }
    assert_eq!(sent, REFUSAL.repeat(2));
}

/// `Ä` is 0xC3 0x84, and `à` is 0xC3 0xA0. Outside of a comment, 0x84 opens the door and 0xA0 switches the coolant.
#[test]
fn characters_of_a_comment_are_no_commands() {
    let mut both = Both::<16>::new(8, 100);
    both.usb("(Äußere Kontur à)\nG1 ; Ä\n".as_bytes());
    assert_eq!((both.text().as_str(), both.queues.commands.len()), ("(uere Kontur )\nG1 ; \n", 0));
    both.usb("Ä(Ä\nÄ\n(\x18Ä(\x19Ä".as_bytes());
    use Realtime::{Reset, SafetyDoor, Stop};
    assert_eq!(both.queues.commands, [SafetyDoor, SafetyDoor, Reset, SafetyDoor, Stop, SafetyDoor]);
    let mut both = Both::<16>::new(8, 100);
    both.queues.is_grbl = true;
    both.usb("(Äußere Kontur)\n".as_bytes());
    assert_eq!((both.text().as_str(), &both.queues.commands[..]), ("(uere Kontur)\n", &[SafetyDoor][..]));
}

/// Returns the text, the commands that were queued at once, and the commands that were queued after a long pause.
fn received(bytes: &[u8], is_grbl: bool) -> (String, Vec<Realtime>, Vec<Realtime>) {
    let mut both = Both::<16>::new(8, 100);
    both.queues.is_grbl = is_grbl;
    both.usb(bytes);
    let at_once = core::mem::take(&mut both.queues.commands);
    both.usb.take_as_command();
    both.pass_on();
    (both.text(), at_once, both.queues.commands)
}

#[test]
fn a_hold_in_a_comment_is_text_if_the_line_goes_on() {
    use Realtime::{CycleStart, FeedHold, Reset, Status};
    for (bytes, text, at_once, later) in [
        (&b"(slow!)G1\n"[..], "(slow)G1\n", &[][..], &[][..]),
        (b"; slow!\n", "; slow\n", &[], &[]),
        (b"; slow!\r\n", "; slow\r\n", &[], &[]),
        (b"(5~10 mm, wow!!", "(510 mm, wow", &[], &[FeedHold]),
        (b"(a~", "(a", &[], &[]),
        (b"(a~!", "(a", &[], &[FeedHold]),
        (b"(a!~", "(a", &[], &[FeedHold]),
        (b"(a!?)", "(a)", &[Status], &[]),
        (b"(a!?", "(a", &[Status], &[FeedHold]),
        (b"(a!\xC3\x84", "(a", &[], &[]),
        (b"(a!\x18", "(a", &[Reset], &[]),
        (b"(a)!", "(a)", &[FeedHold], &[]),
        (b"G1!X~1\n", "G1X1\n", &[FeedHold, CycleStart], &[]),
    ] {
        let expected = (text.to_owned(), at_once.to_vec(), later.to_vec());
        assert_eq!(received(bytes, false), expected, "{}", bytes.escape_ascii());
    }
    assert_eq!(received(b"(slow!)~", true), ("(slow)".into(), vec![FeedHold, CycleStart], vec![]));
}

#[test]
fn a_hold_in_a_comment_is_a_hold_where_bytes_are_lost_or_the_host_goes() {
    for (byte, expected) in [(b'!', &[Realtime::FeedHold][..]), (b'~', &[])] {
        let mut both = Both::<16>::new(8, 100);
        both.uart(&[b'(', byte]);
        both.uart.lose();
        both.uart(b"a)\n");
        both.pass_on();
        assert_eq!(both.queues.commands, expected);
        let mut both = Both::<16>::new(8, 100);
        both.uart(&[b'(', byte]);
        both.uart.went(&mut both.arbiter);
        both.pass_on();
        assert_eq!(both.queues.commands, expected);
    }
}

/// In a comment, the first bytes of a UTF-8 character wait for the rest of the character. If the rest does not come,
/// the waiting bytes are queued as commands, in order.
#[test]
fn a_character_that_is_broken_off_is_commands() {
    use Realtime::{FeedReset, JogCancel, SafetyDoor, Status};
    let mut both = Both::<16>::new(0, 100);
    both.usb(b"(\xF0\x90\x85?");
    assert_eq!((both.usb.room(), both.queues.commands.len()), (0, 0));
    both.queues.most_commands = 2;
    both.pass_on();
    assert_eq!(both.usb.room(), 0);
    both.queues.most_commands = 3;
    both.pass_on();
    assert_eq!(both.queues.commands, [FeedReset, JogCancel, Status]);
    assert_eq!(both.usb.room(), 16);
    // After a loss it is unknown whether a byte is in a comment or belongs to a character. So it counts as a command.
    let mut both = Both::<16>::new(8, 100);
    both.uart(b"(\xE3\x84");
    both.uart.lose();
    both.uart(b"\x84\xC3\x84");
    assert_eq!(both.queues.commands, [SafetyDoor; 3]);
}

/// Each refused line gets its answer, even if the host sends all its lines first and reads the answers later.
#[test]
fn each_refused_line_is_answered_however_late_the_host_reads() {
    let mut both = Both::<16>::new(8, 100);
    both.usb(b"G0\n");
    both.uart(&b"G1\n".repeat(1000));
    let mut sent = Vec::new();
    assert!(both.uart.refuse(|byte| {
        sent.push(byte);
        true
    }));
    assert_eq!(sent.len(), 1000 * REFUSAL.len());
}

#[derive(Clone, Debug)]
enum Event {
    /// Bytes on one of the links: text, commands, any line ends.
    Bytes {
        usb: bool,
        bytes: Vec<u8>,
    },
    /// The host on `usb` connects or disconnects, or bytes of it are lost.
    Came,
    Went,
    Lost,
    /// The queues get room for this many more line bytes and commands. `free`: the machine is idle.
    Room {
        lines: usize,
        commands: usize,
        free: bool,
    },
}

fn event() -> impl Strategy<Value = Event> {
    let byte = prop_oneof![
        8 => Just(b'X'), 3 => Just(b'\n'), 2 => Just(b'\r'), 1 => Just(b'?'), 1 => Just(0x18), 1 => Just(0x85), 1 => Just(9),
        4 => comment_byte()
    ];
    prop_oneof![
        12 => (any::<bool>(), proptest::collection::vec(byte, 1..20)).prop_map(|(usb, bytes)| Event::Bytes { usb, bytes }),
        1 => Just(Event::Came),
        1 => Just(Event::Went),
        1 => Just(Event::Lost),
        4 => (0_usize..30, 0_usize..4, any::<bool>())
            .prop_map(|(lines, commands, free)| Event::Room { lines, commands, free }),
    ]
}

/// Generates bytes that begin or end a comment, and single bytes of UTF-8 characters.
fn comment_byte() -> impl Strategy<Value = u8> {
    prop_oneof![
        4 => Just(b'('), 1 => Just(b')'), 1 => Just(b';'), 3 => Just(0xC3), 3 => Just(0xE3), 1 => Just(0xF0), 1 => Just(0xC2),
        8 => 0x80_u8..0xC0
    ]
}

/// Returns the commands that a link must find in `bytes`. Outside of comments, each command byte counts. In a comment,
/// bytes of UTF-8 characters (as the standard library decodes them), `!` and `~` are text.
fn commands_of(bytes: &[u8]) -> Vec<Realtime> {
    let mut commands = Vec::new();
    let mut give = |bytes: &[u8]| {
        let all = bytes.iter().map(|byte| Received::of(*byte));
        commands
            .extend(all.filter_map(|byte| if let Received::Realtime(command) = byte { Some(command) } else { None }));
    };
    let mut left = bytes;
    while let Some(begin) = left.iter().position(|byte| matches!(byte, b'(' | b';')) {
        let (before, comment) = left.split_at(begin);
        give(before);
        let mut depth = 0;
        let ends = |byte: &u8| {
            match byte {
                b'\n' | b'\r' | 0x18 | 0x19 => return true,
                b'(' => depth += 1,
                b')' => depth -= 1,
                _ => {}
            }
            comment[0] == b'(' && depth == 0
        };
        let end = comment.iter().position(ends).unwrap_or(comment.len());
        for chunk in comment[..end].utf8_chunks() {
            let acts = |character: &char| *character < '\u{C0}' && !matches!(*character, '!' | '~');
            let kept: String = chunk.valid().chars().filter(acts).collect();
            give(kept.as_bytes());
            give(chunk.invalid());
        }
        left = &comment[end..];
    }
    give(left);
    commands
}

impl Both<40> {
    /// Plays an event as the serial task does. `by_run`: consecutive bytes of text are passed in one call, not one by
    /// one.
    fn play(&mut self, event: &Event, by_run: bool) {
        let Both { queues, arbiter, uart, usb } = self;
        match event {
            Event::Bytes { usb: is_usb, bytes } => {
                queues.defers_resets = !is_usb;
                let mut left = bytes.as_slice();
                while let Some((first, behind)) = left.split_first() {
                    let run = match (by_run, is_usb) {
                        (false, _) => 0,
                        (_, true) => usb.take_text(left, arbiter, queues),
                        (_, false) => uart.take_text(left, arbiter, queues),
                    };
                    left = if run > 0 { left.split_at(run).1 } else { behind };
                    match is_usb {
                        _ if run > 0 => {}
                        true => _ = usb.take_any(*first, arbiter, uart, queues),
                        false => _ = uart.take_any(*first, arbiter, usb, queues),
                    }
                }
            }
            Event::Came => _ = usb.came(arbiter, uart, queues),
            Event::Went => _ = usb.went(arbiter),
            Event::Lost => usb.lose(),
            Event::Room { lines, commands, free } => {
                queues.most_lines = queues.lines.len() + lines;
                queues.most_commands = queues.commands.len() + commands;
                queues.free = *free;
                self.pass_on();
            }
        }
    }
}

proptest! {
    /// All commands outside of comments arrive, and no others. This must hold for any bytes, in pieces of any length,
    /// with any room in the queue.
    #[test]
    fn a_stop_byte_is_never_lost(
        mut bytes in proptest::collection::vec(
            prop_oneof![8 => comment_byte(), 3 => Just(b'X'), 1 => Just(b'\n'), 1 => Just(b'!'), 1 => Just(0x18), 1 => Just(0x19),
                1 => Just(0x84), 1 => any::<u8>()],
            0..200),
        mut pieces in proptest::collection::vec((1_usize..9, 0_usize..3), 1..40),
    ) {
        // The line end ends an incomplete character.
        bytes.push(b'\n');
        pieces.push((1, 1));
        let (mut both, mut left, mut commands) = (Both::<40>::new(0, 1000), bytes.as_slice(), Vec::new());
        for (length, room) in pieces.iter().cycle() {
            both.queues.most_commands = *room;
            both.pass_on();
            for _ in 0..*length {
                let Some((byte, behind)) = left.split_first().filter(|_| both.usb.room() > 0) else { break };
                both.usb(&[*byte]);
                left = behind;
            }
            commands.append(&mut both.queues.commands);
            both.queues.lines.clear();
            if left.is_empty() && !both.usb.is_waiting() {
                break;
            }
        }
        prop_assert_eq!(commands, commands_of(&bytes));
    }

    /// Text and line ends passed as a whole have the same effect as each byte passed separately.
    #[test]
    fn a_run_is_taken_as_its_bytes(events in proptest::collection::vec(event(), 1..80)) {
        let [mut by_run, mut by_byte] = [0; 2].map(|_| Both::<40>::new(8, 100));
        for event in &events {
            by_run.play(event, true);
            by_byte.play(event, false);
            prop_assert_eq!(&by_run.queues.lines, &by_byte.queues.lines);
            prop_assert_eq!(&by_run.queues.commands, &by_byte.queues.commands);
            for (run, byte) in [
                (format!("{:?}", by_run.usb), format!("{:?}", by_byte.usb)),
                (format!("{:?}", by_run.uart), format!("{:?}", by_byte.uart)),
                (format!("{:?}", by_run.arbiter), format!("{:?}", by_byte.arbiter)),
            ] {
                prop_assert_eq!(run, byte);
            }
        }
    }
}
