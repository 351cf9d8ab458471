//! Fuzz target: programs that open and close the USB port, with or without DTR. The cable is pulled, packets arrive
//! after their sender has closed the port, and the controller reads at any time. The target tests two parts: the code
//! with which the boards track the connected host (`boards/usb_host.rs`), and the link to the controller. Code that
//! uses registers or the driver library is tested on the virtual board.
//!
//! Invariants:
//! - A line that is read is a whole line of one host.
//! - Bytes that arrive from a host after it has closed the port are not read.
//! - At the end of the session, the lines of a host that opens the port are read.

use super::board::shows;
use super::hosts::MOST_WORK;
use super::work::at_most;
use arbitrary::{Arbitrary, Unstructured};
use oxmill_boards::usb_host::{LATE_BYTES_US, UsbHost};
use oxmill_controller::messages::{HOST_CHANGED, LINE_MESSAGES, LineByte, LineBytes, Realtime};
use oxmill_controller::{HostArbiter, LineReader, LineSender, Link, Queues};
use std::collections::VecDeque;

const PACKET: usize = 64;

#[derive(Arbitrary, Debug)]
enum Action {
    Open,
    Close,
    /// The connected host sends this many bytes. The flag: whether they end a line.
    Packet(u8, bool),
    /// This many bytes were in transit when the port was closed.
    LatePacket(u8),
    Plugged(bool),
    Time(u8),
    Read(u8),
    /// While the machine works, no other host becomes the active host.
    Busy(bool),
    Uart(u8, bool),
}

#[derive(Default)]
struct ToControl {
    line_sender: LineSender,
    messages: VecDeque<LineBytes>,
    line_reader: LineReader,
    busy: bool,
}

fn send(messages: &mut VecDeque<LineBytes>, message: LineBytes) -> bool {
    let room = messages.len() < LINE_MESSAGES;
    if room {
        messages.push_back(message);
    }
    room
}

impl ToControl {
    fn flush(&mut self) {
        let (is_empty, messages) = (self.messages.is_empty(), &mut self.messages);
        self.line_sender.flush(is_empty, |message| send(messages, message));
    }
}

impl Queues for ToControl {
    fn realtime(&mut self, _: Realtime) -> bool {
        true
    }

    fn line(&mut self, byte: LineByte) -> bool {
        self.line_sender.push(byte, |message| send(&mut self.messages, message))
    }

    fn text(&mut self, epoch: u16, bytes: &[u8]) -> usize {
        self.line_sender.extend(epoch, bytes, |message| send(&mut self.messages, message))
    }

    fn waits(&self) -> bool {
        true
    }

    fn is_free(&self) -> bool {
        !self.busy
    }

    fn stop(&mut self) {}

    fn reads_characters(&self) -> bool {
        true
    }
}

struct Bus {
    now: u32,
    dtr: bool,
    plugged: bool,
    /// Letter of which the lines of the current host consist. Each new host gets another letter. After a close the
    /// letter stays for a while, because late packets of the previous host can still arrive.
    letter: u8,
    closed_at: Option<u32>,
    /// Number of letters of this host's unfinished line.
    begun: usize,
    /// Packets that the host has sent and the serial task has not fetched.
    packets: VecDeque<Vec<u8>>,
}

impl Bus {
    fn next_host(&mut self) {
        self.begun = 0;
        self.letter = if self.letter == b'y' { b'b' } else { self.letter + 1 };
    }

    /// Returns whether arriving bytes still count as those of the host that has closed the port.
    fn is_late(&self) -> bool {
        self.closed_at.is_some_and(|at| self.now - at < LATE_BYTES_US)
    }
}

struct Board {
    bus: Bus,
    host: UsbHost,
    packet: VecDeque<u8>,
    is_open: bool,
    usb: Link,
    uart: Link,
    arbiter: HostArbiter,
    queues: ToControl,
    half: Vec<u8>,
    /// Complete lines that the controller has not read, each as the letter of its host and the number of letters.
    sent: VecDeque<(u8, usize)>,
    /// Complete lines that the controller has read.
    read: Vec<Vec<u8>>,
}

/// Runs the target on one input; panics if an invariant is violated.
pub fn run(data: &[u8]) {
    let _ = all(&mut Unstructured::new(data));
}

fn all(input: &mut Unstructured) -> arbitrary::Result<()> {
    let bus = Bus {
        // Microseconds. A board's clock of this kind wraps after 71 minutes, which no session reaches.
        now: 0,
        dtr: false,
        plugged: true,
        letter: b'b',
        closed_at: None,
        begun: 0,
        packets: VecDeque::new(),
    };
    let mut board = Board {
        bus,
        host: UsbHost::new(),
        packet: VecDeque::new(),
        is_open: false,
        usb: Link::new(1, 3 * PACKET),
        uart: Link::new(0, 1),
        arbiter: HostArbiter::new(),
        queues: ToControl::default(),
        half: Vec::new(),
        sent: VecDeque::new(),
        read: Vec::new(),
    };
    board.task();
    while !input.is_empty() {
        let action = input.arbitrary()?;
        if shows() {
            println!("{action:?}");
        }
        board.act(&action);
        board.task();
    }
    board.queues.busy = false;
    for action in [Action::Plugged(true), Action::Close, Action::Time(255), Action::Read(255), Action::Open] {
        board.act(&action);
        board.task();
    }
    // Reads everything that earlier hosts have sent. These bytes are in the links and in the queue to the controller.
    // Three reads are enough to empty both.
    for _ in 0..3 {
        board.act(&Action::Read(255));
        board.task();
    }
    board.read.clear();
    board.act(&Action::Packet(3, true));
    board.task();
    board.act(&Action::Read(255));
    let wanted = [board.bus.letter; 3];
    assert!(board.read.iter().any(|line| *line == wanted), "a host that opens the port is not heard: {:?}", board.read);
    Ok(())
}

impl Board {
    fn act(&mut self, action: &Action) {
        let is_late = self.bus.is_late();
        let Bus { now, dtr, plugged, closed_at, packets, .. } = &mut self.bus;
        match *action {
            Action::Open if *plugged && !*dtr => {
                *dtr = true;
                *closed_at = None;
                // A host that opens the port counts as another host, even if one has sent without opening the port
                // before.
                self.bus.next_host();
            }
            Action::Close if *plugged && *dtr => {
                *dtr = false;
                *closed_at = Some(*now);
            }
            Action::Packet(bytes, end) if *plugged => {
                // Soon after a close, bytes without DTR count as late bytes of the previous host. So another host
                // that sends without opening the port starts only after this time.
                if !*dtr && is_late {
                    return;
                }
                if !*dtr && closed_at.take().is_some() {
                    self.bus.next_host();
                }
                self.send(bytes, end);
            }
            Action::LatePacket(bytes) if *plugged && !*dtr && is_late && packets.is_empty() => {
                self.bus.packets.push_back(vec![self.bus.letter; usize::from(bytes) % PACKET]);
            }
            Action::Plugged(now_plugged) if now_plugged != *plugged => {
                *plugged = now_plugged;
                if now_plugged {
                    // While the cable was unplugged, the driver has kept DTR set. The bus reset at plugging in clears
                    // DTR, as if the host had closed the port.
                    *closed_at = dtr.then_some(*now);
                    *dtr = false;
                } else {
                    *closed_at = None;
                    self.bus.packets.clear();
                    self.bus.next_host();
                }
            }
            Action::Time(ms) => *now += u32::from(ms) * 1000,
            Action::Read(bytes) => self.read(bytes.into()),
            Action::Busy(busy) => self.queues.busy = busy,
            Action::Uart(bytes, end) => {
                let mut line = vec![b'a'; usize::from(bytes % 8)];
                line.extend(end.then_some(b'\n'));
                for byte in line {
                    self.uart.take(byte, &mut self.arbiter, &mut self.usb, &mut self.queues);
                }
            }
            _ => {}
        }
    }

    fn send(&mut self, bytes: u8, end: bool) {
        // The host has to wait while two packets are unread.
        if self.bus.packets.len() < 2 {
            let mut packet = vec![self.bus.letter; usize::from(bytes) % PACKET];
            self.bus.begun += packet.len();
            if end {
                packet.push(b'\n');
                self.sent.push_back((self.bus.letter, std::mem::take(&mut self.bus.begun)));
            }
            self.bus.packets.push_back(packet);
        }
    }

    /// Runs the serial task as `src/firmware/serial.rs` does, on a port like that of `boards/stm32f4/usb.rs`.
    fn task(&mut self) {
        // The task wakes itself when a host that has not opened the port starts to send.
        while self.run() {}
    }

    fn run(&mut self) -> bool {
        self.uart.pass_on(&mut self.arbiter, &mut self.queues);
        for _ in 0..2 {
            let now = self.bus.now;
            let look = self.host.look(self.bus.dtr, self.bus.plugged, || now);
            if look.gone {
                self.packet.clear();
                self.bus.packets.clear();
            }
            assert_eq!(look.there, self.bus.plugged && self.host.is_listening());
            if look.there == std::mem::replace(&mut self.is_open, look.there) {
                break;
            }
            if look.there {
                self.usb.came(&mut self.arbiter, &mut self.uart, &self.queues);
            } else {
                self.usb.went(&mut self.arbiter);
            }
        }
        self.usb.pass_on(&mut self.arbiter, &mut self.queues);
        while self.usb.room() > 0 {
            if self.packet.is_empty() {
                let Some(packet) = self.bus.packets.pop_front() else { break };
                let now = self.bus.now;
                let late = self.bus.is_late();
                if !packet.is_empty() {
                    let is_known = self.host.is_listening();
                    let counts = self.host.speaks(LATE_BYTES_US, || now);
                    assert_eq!(counts, !late, "bytes of a host that has gone");
                    if counts {
                        self.packet.extend(packet);
                    }
                    if counts && !is_known {
                        return true;
                    }
                }
                continue;
            }
            let text = self.usb.take_text(self.packet.make_contiguous(), &self.arbiter, &mut self.queues);
            self.packet.drain(..text);
            let Some(byte) = self.packet.pop_front() else { continue };
            at_most(MOST_WORK, || self.usb.take(byte, &mut self.arbiter, &mut self.uart, &mut self.queues));
        }
        self.queues.flush();
        self.usb.refuse(|_| true);
        self.uart.refuse(|_| true);
        false
    }

    fn read(&mut self, most: usize) {
        for _ in 0..most {
            let ToControl { messages, line_reader, .. } = &mut self.queues;
            let Some(byte) = line_reader.next(|| messages.pop_front()) else { break };
            if self.queues.messages.is_empty() && self.queues.line_sender.is_waiting() {
                self.task();
            }
            match byte.byte {
                HOST_CHANGED => self.half.clear(),
                b'\n' if !byte.damaged => {
                    let line = std::mem::take(&mut self.half);
                    let hosts = line.iter().filter(|letter| **letter != line[0]).count();
                    assert_eq!(hosts, 0, "a line of two hosts: {:?}", String::from_utf8_lossy(&line));
                    if let Some(letter) = line.first().filter(|letter| **letter != b'a') {
                        let at = self.sent.iter().position(|sent| *sent == (*letter, line.len()));
                        let at = at
                            .unwrap_or_else(|| panic!("{} letters of {line:?} are no line that was sent", line.len()));
                        self.sent.drain(..=at);
                    }
                    self.read.push(line);
                }
                b'\n' => self.half.clear(),
                letter => self.half.push(letter),
            }
        }
    }
}
