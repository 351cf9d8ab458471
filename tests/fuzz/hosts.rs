//! Bytes of two hosts, one on a UART and one on USB, with queues that fill up and hosts that come and go.
//!
//! Promises: a line that is read is a whole line of one host, or is told to be damaged, or a cut is in it; what is refused
//! leaves no byte behind; commands keep their order.

use arbitrary::{Arbitrary, Unstructured};
use oxmill_controller::messages::{CUT, LineByte, Realtime};
use oxmill_controller::{Entrance, Link, Queues};

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
}

#[derive(Arbitrary)]
enum Action {
    /// The host on the UART sends a line of this many `a`, with a byte in it.
    Uart(u8, u8),
    /// The host on USB sends a line of this many `b`, with a byte in it.
    Usb(u8, u8),
    UsbComes,
    UsbGoes,
    /// The controller reads some bytes.
    Read(u8),
    ReadCommands,
    Free(bool),
}

/// The target.
pub fn run(data: &[u8]) {
    let _ = all(&mut Unstructured::new(data));
}

/// A line of a host: its letter, and in the middle of it a byte that is no letter of the other host.
fn line(letter: u8, length: u8, byte: u8) -> Vec<u8> {
    let mut line = vec![letter; usize::from(length % 12)];
    let at = line.len() / 2;
    if !matches!(byte, b'a' | b'b') {
        line.insert(at, byte);
    }
    line.push(b'\n');
    line
}

fn all(input: &mut Unstructured) -> arbitrary::Result<()> {
    let mut queues = Depths { commands: Vec::new(), lines: Vec::new(), cannot_wait: false, free: false };
    let mut entrance = Entrance::new();
    let (mut uart, mut usb) = (Link::<1>::new(0), Link::<64>::new(1));
    let mut half: Vec<LineByte> = Vec::new();
    while !input.is_empty() {
        match input.arbitrary()? {
            Action::Uart(length, byte) => {
                queues.cannot_wait = true;
                for byte in line(b'a', length, byte) {
                    uart.take(byte, &mut entrance, &mut usb, &mut queues);
                }
                queues.cannot_wait = false;
            }
            Action::Usb(length, byte) => {
                for byte in line(b'b', length, byte) {
                    // A host on USB is told to wait.
                    if usb.room() > 0 {
                        usb.take(byte, &mut entrance, &mut uart, &mut queues);
                    }
                }
            }
            Action::UsbComes => {
                usb.came(&mut entrance, &mut uart, &queues);
            }
            Action::UsbGoes => {
                usb.went(&mut entrance);
            }
            Action::Read(count) => {
                let count = usize::from(count).min(queues.lines.len());
                for byte in queues.lines.drain(..count) {
                    read(&mut half, byte);
                }
            }
            Action::ReadCommands => queues.commands.clear(),
            Action::Free(free) => queues.free = free,
        }
        uart.pass_on(&mut entrance, &mut queues);
        usb.pass_on(&mut entrance, &mut queues);
        uart.refuse(|_| true);
        usb.refuse(|_| true);
    }
    Ok(())
}

fn read(half: &mut Vec<LineByte>, byte: LineByte) {
    match byte.byte {
        CUT => half.clear(),
        b'\n' | b'\r' => {
            half.push(byte);
            let damaged = half.iter().any(|byte| byte.damaged);
            let has = |letter| half.iter().any(|byte| byte.byte == letter);
            assert!(damaged || !(has(b'a') && has(b'b')), "a line of two hosts");
            half.clear();
        }
        _ => half.push(byte),
    }
}
