//! The way of received bytes into the queues to `control`, and which of two hosts is listened to. Lives in the serial task.
//!
//! ```text
//!  link ──packet──▶ Splitter ──realtime────────────────────▶ queue     at once, past all lines
//!                       └─────line bytes──▶ Intake (held) ──▶ queue     in their order, when there is room
//!                                             │ too little room for another packet: the link is told to wait
//! ```
//! What is promised for a link that can wait (USB answers NAK): no byte is lost, and a realtime command acts at once as
//! long as the line bytes under way fit into the queue and [`Intake::room`]. A sender that counts characters, or obeys
//! `Bf:`, never has more of them under way than the queue alone takes, so for it that is always. A sender that pours a
//! whole file in without counting is told to wait, and then what it sends behind that waits too, commands as well.

use crate::messages::{LineByte, Realtime};
use crate::protocol::realtime::Received;

/// The queues to `control`. Each call gives whether there was room.
pub trait Queues {
    /// Queues a command.
    fn realtime(&mut self, command: Realtime) -> bool;
    /// Queues a byte of a line.
    fn line(&mut self, byte: LineByte) -> bool;
    /// Whether the link that is being read can wait. One that cannot loses a command that is refused, so each is tried.
    fn waits(&self) -> bool;
}

/// Received bytes of one link that have no room in the queue yet; at most `HELD`.
#[derive(Debug, Default)]
pub struct Intake<const HELD: usize> {
    held: heapless::Deque<LineByte, HELD>,
    /// A command for which there was no room: nothing more is taken, as it may not be overtaken by another.
    stuck: Option<Realtime>,
    /// Bytes were lost; the next byte of a line says so.
    lost: bool,
    /// A line has begun and not ended.
    mid_line: bool,
}

impl<const HELD: usize> Intake<HELD> {
    /// Nothing received.
    pub const fn new() -> Self {
        Self { held: heapless::Deque::new(), stuck: None, lost: false, mid_line: false }
    }

    /// How many bytes can be taken, whatever they are, with both queues full.
    pub fn room(&self) -> usize {
        if self.stuck.is_some() { 0 } else { HELD - self.held.len() }
    }

    /// Whether something waits for room in a queue.
    pub fn is_waiting(&self) -> bool {
        self.stuck.is_some() || !self.held.is_empty()
    }

    /// Whether the last line has come to its end.
    pub fn is_between_lines(&self) -> bool {
        !self.mid_line
    }

    /// Takes what was received. Without room it is lost, which the next byte of a line says: a link that can wait is not
    /// read then. Gives whether something was queued.
    pub fn take(&mut self, received: Received, queues: &mut impl Queues) -> bool {
        match received {
            Received::Nothing => false,
            Received::Realtime(command) => {
                let waits = queues.waits();
                let queued = (self.stuck.is_none() || !waits) && queues.realtime(command);
                if !queued {
                    self.lost |= !waits || self.stuck.replace(command).is_some();
                }
                queued
            }
            Received::Line(byte) => {
                let byte = LineByte { damaged: byte.damaged | self.lost, ..byte };
                let queued = self.held.is_empty() && queues.line(byte);
                self.lost = !queued && self.held.push_back(byte).is_err();
                if !self.lost {
                    self.mid_line = !matches!(byte.byte, b'\n' | b'\r');
                }
                queued
            }
        }
    }

    /// There may be room in the queues: what waits goes on. Gives whether something was queued.
    pub fn pass_on(&mut self, queues: &mut impl Queues) -> bool {
        let mut any = false;
        if let Some(command) = self.stuck
            && queues.realtime(command)
        {
            self.stuck = None;
            any = true;
        }
        while let Some(byte) = self.held.front()
            && queues.line(*byte)
        {
            self.held.pop_front();
            any = true;
        }
        any
    }

    /// A reset or stop has come, from here or elsewhere: the line that had begun is void, and the next byte begins another.
    pub fn begin_anew(&mut self) {
        self.mid_line = false;
    }

    /// Bytes were lost on the way here: the line that they belong to will be refused.
    pub fn lose(&mut self) {
        self.lost = true;
    }

    /// The host has gone. What has no place in the queue goes with it, and if a line or part of one is lost by that, the
    /// end of a damaged line says so; the next host begins at the start of a line.
    pub fn cut_off(&mut self, epoch: u16) {
        let lost = self.lost || self.mid_line || !self.held.is_empty();
        *self = Self { stuck: self.stuck, ..Self::new() };
        if lost {
            // CR ends a line in every dialect, also right after another one. The buffer is empty.
            let _ = self.held.push_back(LineByte { byte: b'\r', epoch, damaged: true });
        }
    }
}

/// Which of two hosts has the floor: whose lines are read, and who gets the answers. Realtime commands need no floor.
#[derive(Debug)]
pub struct Floor {
    holder: usize,
    /// The holder has gone or has only asked for a report; or nobody has said anything yet.
    weak: bool,
}

impl Floor {
    /// Answers go to link 0, and whoever speaks first has the floor.
    pub const fn new() -> Self {
        Self { holder: 0, weak: true }
    }

    /// Who gets the answers.
    pub fn holder(&self) -> usize {
        self.holder
    }

    /// The host of `link` wants to say something: whether it may. `free`: the machine has nothing to do for the holder.
    /// `firm`: it opens its port or sends a line; a realtime command alone gets its answer, and keeps nobody out.
    pub fn claim(&mut self, link: usize, free: bool, firm: bool) -> bool {
        if self.weak || free {
            self.holder = link;
            self.weak = !firm;
        }
        self.holder == link
    }

    /// The host of `link` has reset the machine, and with it everything that another one wanted.
    pub fn seize(&mut self, link: usize) {
        self.holder = link;
        self.weak = false;
    }

    /// The host of `link` has gone.
    pub fn leave(&mut self, link: usize) {
        self.weak |= self.holder == link;
    }
}

impl Default for Floor {
    fn default() -> Self {
        Self::new()
    }
}

/// What a host without the floor is told for each of its lines: 8 is Grbl's "not idle".
pub const REFUSAL: &[u8] = b"[MSG:Another host has the machine]\r\nerror:8\r\n";

#[cfg(test)]
mod tests {
    use super::*;
    use crate::protocol::realtime::Splitter;

    /// Queues of a given depth.
    #[derive(Default)]
    struct Depths {
        commands: Vec<Realtime>,
        lines: Vec<LineByte>,
        most_commands: usize,
        most_lines: usize,
        owes_resets: bool,
    }

    impl Queues for Depths {
        fn realtime(&mut self, command: Realtime) -> bool {
            let room = self.commands.len() < self.most_commands || self.owes_resets && command == Realtime::Reset;
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
            !self.owes_resets
        }
    }

    fn depths(most_commands: usize, most_lines: usize) -> Depths {
        Depths { most_commands, most_lines, ..Depths::default() }
    }

    fn text(queues: &Depths) -> String {
        queues.lines.iter().map(|byte| char::from(byte.byte)).collect()
    }

    const PACKET: usize = 64;
    const HELD: usize = 192;

    #[test]
    fn a_link_that_cannot_wait_has_each_command_tried() {
        let (mut intake, mut splitter, mut queues) = (Intake::<1>::new(), Splitter::new(), depths(0, 8));
        queues.owes_resets = true;
        for byte in *b"?\x18?" {
            intake.take(splitter.push(byte), &mut queues);
        }
        assert_eq!(queues.commands, [Realtime::Reset]);
        intake.take(splitter.push(b'G'), &mut queues);
        assert!(queues.lines[0].damaged && !intake.is_waiting(), "the others are lost, and that is said");
    }

    #[test]
    fn realtime_bytes_pass_lines_that_wait() {
        let (mut intake, mut splitter, mut queues) = (Intake::<16>::new(), Splitter::new(), depths(8, 4));
        for byte in *b"G1X10\n?Y2!\x18" {
            intake.take(splitter.push(byte), &mut queues);
        }
        assert_eq!(queues.commands, [Realtime::Status, Realtime::FeedHold, Realtime::Reset]);
        assert_eq!(text(&queues), "G1X1");
        assert!(intake.is_waiting() && !intake.is_between_lines());
        queues.most_lines = 100;
        assert!(intake.pass_on(&mut queues));
        assert_eq!(text(&queues), "G1X10\nY2");
        assert!(!intake.is_waiting());
        assert!(queues.lines.iter().all(|byte| !byte.damaged));
    }

    /// A sender that does not count: as the port does it, a packet is fetched only while a whole one fits.
    #[test]
    fn a_flood_is_told_to_wait_and_nothing_is_lost() {
        let (mut intake, mut splitter, mut queues) = (Intake::<HELD>::new(), Splitter::new(), depths(64, 255));
        let flood: Vec<u8> = (0..5000_u32).map(|n| if n % 7 == 6 { b'\n' } else { b'A' + (n % 26) as u8 }).collect();
        let mut packets = flood.chunks(PACKET);
        let (mut taken, mut most_held, mut waits) = (String::new(), 0, 0);
        loop {
            if intake.room() >= PACKET {
                let Some(packet) = packets.next() else { break };
                for byte in packet {
                    intake.take(splitter.push(*byte), &mut queues);
                }
            } else {
                waits += 1;
                // The controller reads a line or so.
                taken.extend(queues.lines.drain(..9).map(|byte| {
                    assert!(!byte.damaged);
                    char::from(byte.byte)
                }));
                intake.pass_on(&mut queues);
            }
            most_held = most_held.max(HELD - intake.room());
        }
        taken.push_str(&text(&queues));
        queues = depths(64, HELD);
        intake.pass_on(&mut queues);
        taken.push_str(&text(&queues));
        assert_eq!(taken.as_bytes(), flood);
        assert!(waits > 100 && most_held > HELD - PACKET, "{waits} {most_held}");
    }

    /// Character counting keeps at most 255 line bytes under way: with the queue full of them any number of commands
    /// still passes, and there is always room for a packet.
    #[test]
    fn a_counting_sender_never_waits() {
        let (mut intake, mut splitter, mut queues) = (Intake::<HELD>::new(), Splitter::new(), depths(1000, 255));
        for n in 0..255 {
            intake.take(splitter.push(if n % 20 == 19 { b'\n' } else { b'X' }), &mut queues);
            intake.take(splitter.push(b'?'), &mut queues);
            assert_eq!(intake.room(), HELD);
        }
        assert_eq!(queues.commands.len(), 255);
    }

    #[test]
    fn a_full_queue_of_commands_stops_the_link_without_a_loss() {
        let (mut intake, mut splitter, mut queues) = (Intake::<16>::new(), Splitter::new(), depths(2, 100));
        let mut bytes = b"??!~G".iter();
        while intake.room() > 0 {
            intake.take(splitter.push(*bytes.next().unwrap()), &mut queues);
        }
        assert_eq!(bytes.as_slice(), b"~G");
        assert!(intake.is_waiting());
        queues.commands.clear();
        assert!(intake.pass_on(&mut queues));
        assert_eq!(queues.commands, [Realtime::FeedHold]);
        assert_eq!(intake.room(), 16);
    }

    #[test]
    fn a_link_that_cannot_wait_says_what_it_lost() {
        let (mut intake, mut splitter, mut queues) = (Intake::<2>::new(), Splitter::new(), depths(2, 3));
        for byte in *b"ABCDEFG" {
            intake.take(splitter.push(byte), &mut queues);
        }
        queues.most_lines = 100;
        intake.pass_on(&mut queues);
        intake.take(splitter.push(b'H'), &mut queues);
        intake.take(splitter.push(b'\n'), &mut queues);
        assert_eq!(text(&queues), "ABCDEH\n");
        assert_eq!(
            queues.lines.iter().map(|b| b.damaged).collect::<Vec<_>>(),
            [false, false, false, false, false, true, false]
        );
    }

    #[test]
    fn a_host_that_leaves_in_mid_line_leaves_no_half_line() {
        let (mut intake, mut splitter, mut queues) = (Intake::<16>::new(), Splitter::new(), depths(8, 100));
        for byte in *b"G0X1\nG1 X" {
            intake.take(splitter.push(byte), &mut queues);
        }
        intake.cut_off(0);
        intake.pass_on(&mut queues);
        assert_eq!(text(&queues), "G0X1\nG1 X\r");
        assert!(queues.lines.last().unwrap().damaged);
        // Between lines nothing is added; a reset has ended the line as well.
        for byte in *b"G4\x18" {
            intake.take(splitter.push(byte), &mut queues);
        }
        intake.begin_anew();
        let before = queues.lines.len();
        intake.cut_off(0);
        intake.pass_on(&mut queues);
        assert_eq!(queues.lines.len(), before);
    }

    #[test]
    fn a_host_that_leaves_with_a_full_queue_makes_room_for_the_next() {
        let (mut intake, mut splitter, mut queues) = (Intake::<16>::new(), Splitter::new(), depths(8, 2));
        for byte in *b"G0\nG0\nG0\n" {
            intake.take(splitter.push(byte), &mut queues);
        }
        intake.cut_off(3);
        assert_eq!(intake.room(), 15);
        queues.most_lines = 100;
        intake.pass_on(&mut queues);
        assert_eq!(text(&queues), "G0\r");
        assert_eq!(queues.lines.last(), Some(&LineByte { byte: b'\r', epoch: 3, damaged: true }));
    }

    #[test]
    fn one_host_at_a_time_has_the_floor() {
        let mut floor = Floor::new();
        assert_eq!(floor.holder(), 0);
        assert!(floor.claim(1, false, true));
        assert!(!floor.claim(0, false, true));
        assert_eq!(floor.holder(), 1);
        // Idle: whoever speaks.
        assert!(floor.claim(0, true, true));
        assert!(floor.claim(0, false, true) && !floor.claim(1, false, true));
        floor.leave(1);
        assert!(!floor.claim(1, false, true));
        floor.leave(0);
        assert!(floor.claim(1, false, true));
        floor.seize(0);
        assert!(!floor.claim(1, false, true));
    }

    #[test]
    fn a_question_keeps_nobody_out() {
        let mut floor = Floor::new();
        assert!(floor.claim(1, false, true));
        // The holder's own questions change nothing.
        assert!(floor.claim(1, false, false) && !floor.claim(0, false, false));
        floor.leave(1);
        assert!(floor.claim(0, false, false));
        assert!(floor.claim(1, false, true));
        assert!(!floor.claim(0, false, true));
    }
}
