//! The clients of `serve`, and the state that their threads share with the loop that owns the simulator. Each client
//! has two threads: one reads its bytes into an inbox, the other writes the replies. Events reach the loop through a
//! channel.

use crate::no_browser::is_realtime;
use std::collections::VecDeque;
use std::io::{self, Read, Write};
use std::net::{Shutdown, TcpStream};
use std::sync::mpsc::{Sender, SyncSender, TrySendError, sync_channel};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::thread;
use std::time::Duration;
use tungstenite::WebSocket;

/// Reading stops when this many bytes of a client wait in its inbox. TCP reports a disconnection only after the last
/// byte has been read. So where `hung_up` detects nothing, a disconnection is noticed only when there is room again.
const AHEAD: usize = (1 << 24) - PIECE;
/// Number of bytes without a line end after which a client is disconnected. A board rejects lines of over 255 bytes.
pub(crate) const LONGEST_LINE: usize = 1 << 16;
/// Maximum number of bytes in one read.
pub(crate) const PIECE: usize = 1024;
/// Maximum number of reply chunks that wait for a slow client.
pub(crate) const ANSWERS: usize = 64;
/// Interval at which a waiting thread checks whether its client is still connected. A reader waits for room in the
/// inbox, a writer for a client that does not read.
pub(crate) const LOOK: Duration = Duration::from_millis(20);
/// Pause before a write is tried again if the client does not read its replies.
const AGAIN: Duration = Duration::from_millis(1);
/// Message to a client whose line does not end, before its connection is closed.
pub(crate) const ENDLESS: &[u8] = b"[MSG:The line has no end]\r\n";
/// Maximum number of simultaneous connections; further ones are closed at once.
const CONNECTIONS: usize = 64;

/// Events that the threads send to the loop that owns the simulator.
pub(crate) enum Happened {
    /// A client is ready to be served.
    Connected(Client),
    /// A connection was accepted. If the loop serves it, the reader thread of the connection sends events through this
    /// sender.
    Connecting(Incoming, SyncSender<Happened>),
    /// The client has sent bytes or has disconnected: see its [`Inbox`].
    Heard,
    /// A line of the pin protocol, and the channel through which the reply returns to its client.
    Pins(String, Sender<String>),
}

/// An accepted connection, with the slot that it occupies.
pub(crate) struct Incoming {
    pub(crate) link: Connection,
    pub(crate) place: Taken,
}

/// The socket of a connection, and who is at its other end.
pub(crate) enum Connection {
    /// A program, at the port of `--tcp`.
    Program(TcpStream),
    /// A browser page, at the port of `--web`.
    Page(Box<WebSocket<TcpStream>>),
}

impl Incoming {
    pub(crate) fn stream(&self) -> &TcpStream {
        match &self.link {
            Connection::Program(stream) => stream,
            Connection::Page(socket) => socket.get_ref(),
        }
    }
}

/// The connection slots, at most `CONNECTIONS`. A thread that serves a connection keeps its slot until it ends.
#[derive(Clone, Default)]
pub(crate) struct Places(Arc<()>);

/// An occupied connection slot. It becomes free when this value is dropped.
pub(crate) struct Taken(#[allow(dead_code, reason = "it is counted")] Arc<()>);

impl Places {
    /// Takes a slot; `None` if all are occupied.
    pub(crate) fn take(&self) -> Option<Taken> {
        (Arc::strong_count(&self.0) <= CONNECTIONS).then(|| Taken(self.0.clone()))
    }
}

/// The bytes of a client that its reader thread has read and the loop has not taken yet.
#[derive(Default)]
pub(crate) struct Inbox {
    state: Mutex<InboxState>,
    changed: Condvar,
}

#[derive(Default)]
struct InboxState {
    bytes: VecDeque<u8>,
    /// Number of bytes since the last line end; realtime commands do not count.
    line: usize,
    /// `true` if no more bytes will come, because the client has disconnected or its input has ended.
    ended: bool,
    /// `true` if the loop has stopped serving the client.
    closed: bool,
    /// The error that ended reading.
    failure: Option<io::Error>,
}

impl Inbox {
    fn state(&self) -> MutexGuard<'_, InboxState> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    pub(crate) fn push(&self, bytes: &[u8]) {
        let mut state = self.state();
        state.bytes.extend(bytes);
        for byte in bytes {
            match byte {
                b'\n' | b'\r' => state.line = 0,
                byte if is_realtime(*byte) => {}
                _ => state.line += 1,
            }
        }
    }

    /// Returns whether the client's line is longer than any valid line.
    pub(crate) fn is_endless(&self) -> bool {
        self.state().line > LONGEST_LINE
    }

    /// Removes and returns up to `most` bytes. Wakes the reader thread if it waits for room.
    pub(crate) fn take(&self, most: usize) -> Vec<u8> {
        let mut state = self.state();
        let length = most.min(state.bytes.len());
        if length > 0 {
            self.changed.notify_all();
        }
        let taken = state.bytes.drain(..length).collect();
        if state.bytes.is_empty() {
            state.bytes = VecDeque::new();
        }
        taken
    }

    pub(crate) fn is_empty(&self) -> bool {
        self.state().bytes.is_empty()
    }

    pub(crate) fn end(&self) {
        self.state().ended = true;
    }

    pub(crate) fn has_ended(&self) -> bool {
        self.state().ended
    }

    pub(crate) fn close(&self) {
        self.state().closed = true;
        self.changed.notify_all();
    }

    fn is_closed(&self) -> bool {
        self.state().closed
    }

    pub(crate) fn fail(&self, why: io::Error) {
        self.state().failure = Some(why);
    }

    pub(crate) fn failure(&self) -> Option<io::Error> {
        self.state().failure.take()
    }

    /// Waits until the inbox has room for more bytes. Returns `false` if the client has disconnected meanwhile, is no
    /// longer served, or has sent a line that is too long.
    /// `hung_up`: returns whether the client has disconnected.
    pub(crate) fn wait_for_room(&self, hung_up: impl Fn() -> bool) -> bool {
        let mut state = self.state();
        while !state.closed && state.bytes.len() >= AHEAD {
            state = self.changed.wait_timeout(state, LOOK).unwrap_or_else(PoisonError::into_inner).0;
            if hung_up() {
                return false;
            }
        }
        !state.closed && state.line <= LONGEST_LINE
    }
}

/// A client, with what the loop needs to serve it.
pub(crate) struct Client {
    pub(crate) inbox: Arc<Inbox>,
    pub(crate) answers: SyncSender<Vec<u8>>,
    /// The client's TCP connection, for checking whether the client is still connected; `None` for other links.
    pub(crate) stream: Option<TcpStream>,
    /// `true` if the client is standard input. All its lines are executed, even after the input has ended.
    pub(crate) is_program: bool,
}

impl Client {
    pub(crate) fn has_gone(&self) -> bool {
        self.inbox.has_ended() || self.stream.as_ref().is_some_and(hung_up)
    }

    pub(crate) fn close(self) {
        self.inbox.close();
        if let Some(stream) = self.stream {
            // End the client's reader thread, which may be waiting for bytes. Ignore the error of a closed connection.
            let _ = stream.shutdown(Shutdown::Read);
        }
    }
}

/// Returns whether the other side has closed the connection, even while some of its bytes are unread.
#[cfg(unix)]
pub(crate) fn hung_up(link: &impl std::os::fd::AsFd) -> bool {
    use nix::poll::{PollFd, PollFlags, PollTimeout, poll};
    #[cfg(target_os = "linux")]
    let closed = PollFlags::from_bits_retain(nix::libc::POLLRDHUP);
    #[cfg(not(target_os = "linux"))]
    let closed = PollFlags::empty();
    let mut look = [PollFd::new(link.as_fd(), closed)];
    // `poll` always reports errors and hang-ups, even if they are not requested.
    poll(&mut look, PollTimeout::ZERO).is_ok_and(|events| events > 0)
}

/// Returns `false`, because on this platform only reading to the end reveals a disconnection.
#[cfg(not(unix))]
pub(crate) fn hung_up<T>(_link: &T) -> bool {
    false
}

/// Reads the bytes of a client into its inbox. Ends if the input ends, if the client has disconnected or is no longer
/// served, or if a line is too long. Calls `tell_endless` only for a line that is too long.
pub(crate) fn pass_bytes(
    reader: &mut impl Read,
    inbox: &Inbox,
    sender: &SyncSender<Happened>,
    hung_up: impl Fn() -> bool,
    tell_endless: impl FnOnce(),
) {
    let mut buffer = [0; PIECE];
    while inbox.wait_for_room(&hung_up) {
        match reader.read(&mut buffer) {
            Ok(0) => break,
            Ok(length) => {
                inbox.push(&buffer[..length]);
                // If the queue is full, the event is not needed: the loop has other events to handle, and looks into
                // the inbox anyway.
                if let Err(TrySendError::Disconnected(_)) = sender.try_send(Happened::Heard) {
                    return;
                }
            }
            Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
            Err(error) => {
                inbox.fail(error);
                break;
            }
        }
    }
    // Tell the client before the call of `end`, after which the loop closes the connection.
    if inbox.is_endless() {
        tell_endless();
    }
    inbox.end();
    // Ignore the error: it occurs only if the loop that receives these events has ended.
    let _ = sender.send(Happened::Heard);
}

/// A thread that writes replies until its channel is closed or its client disconnects.
pub(crate) type Writer = thread::JoinHandle<io::Result<()>>;

pub(crate) fn writer(mut link: impl Write + Send + 'static, inbox: Arc<Inbox>) -> (SyncSender<Vec<u8>>, Writer) {
    let (sender, receiver) = sync_channel::<Vec<u8>>(ANSWERS);
    let handle = thread::spawn(move || {
        let written = receiver.iter().try_for_each(|bytes| write_out(&mut link, &bytes, &inbox));
        // Mark the client as gone. If the loop has no more replies to send, it notices the disconnection only by this
        // mark.
        inbox.end();
        written
    });
    (sender, handle)
}

/// Writes all bytes. While the client does not read, tries again until the loop closes the inbox. Fails if the loop
/// closes the inbox or the client disconnects.
fn write_out(link: &mut impl Write, mut bytes: &[u8], inbox: &Inbox) -> io::Result<()> {
    while !bytes.is_empty() {
        match link.write(bytes) {
            Ok(0) => return Err(io::ErrorKind::WriteZero.into()),
            Ok(written) => bytes = bytes.get(written..).unwrap_or_default(),
            Err(error) => match error.kind() {
                io::ErrorKind::Interrupted => {}
                io::ErrorKind::WouldBlock | io::ErrorKind::TimedOut if !inbox.is_closed() => thread::sleep(AGAIN),
                _ => return Err(error),
            },
        }
    }
    link.flush()
}
