//! Fuzz target: bytes of two hosts, one on a UART and one on USB. Queues fill up, and hosts connect and disconnect.
//!
//! Invariants:
//! - A line that is read is a whole line of one host. The lines of a host are read in order.
//! - Only a line that is marked as damaged, or cut off by a reset, may be incomplete.
//! - Rejected bytes leave no trace.
//! - No command is invented or doubled.
//! - A waiting host gets room as soon as the queues have been read.

use super::work::at_most;
use arbitrary::{Arbitrary, Unstructured};
use oxmill_controller::messages::{HOST_CHANGED, LineByte, Realtime};
use oxmill_controller::{HostArbiter, Link, Queues, Received};
use std::collections::VecDeque;

struct Depths {
    commands: Vec<Realtime>,
    lines: Vec<LineByte>,
    cannot_wait: bool,
    free: bool,
}

const MOST_COMMANDS: usize = 4;
const MOST_LINES: usize = 24;

impl Queues for Depths {
    fn realtime(&mut self, command: Realtime) -> bool {
        let room = self.commands.len() < MOST_COMMANDS || self.cannot_wait && command == Realtime::Reset;
        if room {
            self.commands.push(command);
        }
        room
    }

    fn line(&mut self, byte: LineByte) -> bool {
        let room = self.lines.len() < MOST_LINES;
        if room {
            self.lines.push(byte);
        }
        room
    }

    fn waits(&self) -> bool {
        !self.cannot_wait
    }

    fn is_free(&self) -> bool {
        self.free
    }

    fn stop(&mut self) {}

    fn reads_characters(&self) -> bool {
        true
    }
}

#[derive(Arbitrary)]
enum Action {
    /// The host on the UART sends a line of this many `a`, with this byte in the middle.
    Uart(u8, u8),
    /// The host on USB sends a line of this many `b`, with this byte in the middle.
    Usb(u8, u8),
    UsbComes,
    UsbGoes,
    /// The controller reads at most this many bytes of lines.
    Read(u8),
    ReadCommands,
    Free(bool),
}

/// The controller's side: reads bytes and compares them with the expected ones.
#[derive(Default)]
struct Reader {
    half: Vec<LineByte>,
    epoch: u16,
    /// Lines that each host has sent and the controller has not read. A line is stored as two numbers of letters. The
    /// first is the number of letters in the whole line. The second counts only the letters after a reset, stop or jog
    /// cancel in the middle of the line. Without such a command both numbers are equal.
    sent: [VecDeque<[usize; 2]>; 2],
    /// Realtime commands that were sent and have not been read.
    commands: Vec<Realtime>,
}

/// Maximum number of control-flow edges while a link takes one byte; the highest count when this was chosen: 15.
pub const MOST_WORK: u64 = 64;

/// Runs the target on one input; panics if an invariant is violated.
pub fn run(data: &[u8]) {
    let _ = all(&mut Unstructured::new(data));
}

const LETTERS: [u8; 2] = [b'a', b'b'];

impl Reader {
    /// Returns the bytes of a line: the letter of the host, repeated `length` modulo 12 times, with `byte` in the
    /// middle. If `byte` is the letter of a host, it is left out. Also notes what the controller is expected to read.
    fn line(&mut self, host: usize, length: u8, byte: u8) -> Vec<u8> {
        let mut line = vec![LETTERS[host]; usize::from(length % 12)];
        let (whole, middle) = (line.len(), line.len() / 2);
        if !LETTERS.contains(&byte) {
            line.insert(middle, byte);
        }
        match byte {
            b'\n' | b'\r' => self.sent[host].extend([[middle; 2], [whole - middle; 2]]),
            0x18 | 0x19 | 0x85 => self.sent[host].push_back([whole, whole - middle]),
            _ => self.sent[host].push_back([whole; 2]),
        }
        if let Received::Realtime(command) = Received::of(byte) {
            self.commands.push(command);
        }
        line.push(b'\n');
        line
    }

    fn read_lines(&mut self, queues: &mut Depths, most: usize) {
        for byte in queues.lines.drain(..most.min(queues.lines.len())) {
            // Drop bytes from before a reset (an older epoch), as the controller does.
            if byte.byte != HOST_CHANGED && std::mem::replace(&mut self.epoch, byte.epoch) != byte.epoch {
                self.half.clear();
            }
            match byte.byte {
                HOST_CHANGED => self.half.clear(),
                b'\n' | b'\r' => {
                    let damaged = byte.damaged || self.half.iter().any(|byte| byte.damaged);
                    let letters = LETTERS.map(|letter| self.half.iter().filter(|byte| byte.byte == letter).count());
                    self.half.clear();
                    if !damaged {
                        self.whole_line(letters);
                    }
                }
                _ => self.half.push(byte),
            }
        }
    }

    fn whole_line(&mut self, letters: [usize; 2]) {
        assert!(letters.contains(&0), "a line of two hosts");
        for (sent, letters) in self.sent.iter_mut().zip(letters).filter(|(_, letters)| *letters > 0) {
            let at = sent.iter().position(|line| line.contains(&letters));
            let at = at.unwrap_or_else(|| panic!("{letters} letters are no line that was sent: {sent:?}"));
            sent.drain(..=at);
        }
    }

    fn read_commands(&mut self, queues: &mut Depths) {
        for command in queues.commands.drain(..) {
            let sent = self.commands.iter().position(|sent| *sent == command);
            self.commands.swap_remove(sent.unwrap_or_else(|| panic!("{command:?} is not one that was sent")));
        }
    }
}

fn all(input: &mut Unstructured) -> arbitrary::Result<()> {
    let mut queues = Depths { commands: Vec::new(), lines: Vec::new(), cannot_wait: false, free: false };
    let mut arbiter = HostArbiter::new();
    let (mut uart, mut usb) = (Link::new(0, 1), Link::new(1, 64));
    let mut reader = Reader::default();
    while !input.is_empty() {
        match input.arbitrary()? {
            Action::Uart(length, byte) => {
                queues.cannot_wait = true;
                for byte in reader.line(0, length, byte) {
                    at_most(MOST_WORK, || uart.take(byte, &mut arbiter, &mut usb, &mut queues));
                }
                queues.cannot_wait = false;
            }
            Action::Usb(length, byte) => {
                for byte in reader.line(1, length, byte) {
                    if usb.room() == 0 {
                        // The host has to wait until the controller has read.
                        reader.read_commands(&mut queues);
                        reader.read_lines(&mut queues, MOST_LINES);
                        usb.pass_on(&mut arbiter, &mut queues);
                        assert!(usb.room() > 0, "room once all has been read");
                    }
                    at_most(MOST_WORK, || usb.take(byte, &mut arbiter, &mut uart, &mut queues));
                }
            }
            Action::UsbComes => {
                usb.came(&mut arbiter, &mut uart, &queues);
            }
            Action::UsbGoes => {
                usb.went(&mut arbiter);
            }
            Action::Read(count) => reader.read_lines(&mut queues, count.into()),
            Action::ReadCommands => reader.read_commands(&mut queues),
            Action::Free(free) => queues.free = free,
        }
        uart.pass_on(&mut arbiter, &mut queues);
        usb.pass_on(&mut arbiter, &mut queues);
        uart.refuse(|_| true);
        usb.refuse(|_| true);
    }
    reader.read_commands(&mut queues);
    Ok(())
}
