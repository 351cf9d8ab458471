//! The clients of `serve`, and what their threads share with the loop that owns the simulator. A thread reads a
//! client's bytes into an inbox, another writes its replies; events go to the loop through a channel.

use crate::no_browser::is_realtime;
use std::collections::VecDeque;
use std::io::{self, Read, Write};
use std::net::{Shutdown, TcpStream};
use std::sync::mpsc::{Sender, SyncSender, TrySendError, sync_channel};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::thread;
use std::time::Duration;
use tungstenite::WebSocket;

/// Bytes of a client that are read ahead of that. With more the client is told to wait, and that it has gone is not seen before
/// there is room: TCP tells so behind the last of its bytes.
const AHEAD: usize = (1 << 24) - PIECE;
/// Bytes without a line end after which a client is served no more; a board refuses a line of over 255 in the end.
pub(crate) const LONGEST_LINE: usize = 1 << 16;
/// Bytes that are read at a time.
pub(crate) const PIECE: usize = 1024;
/// Pieces of answers that may wait for a slow client.
pub(crate) const ANSWERS: usize = 64;
/// How often a reader that waits for room, or a writer whose client does not read, looks whether the client is there.
pub(crate) const LOOK: Duration = Duration::from_millis(20);
/// How often a writer whose client does not read tries again.
const AGAIN: Duration = Duration::from_millis(1);
/// What is said to a client before it is closed because its line does not end.
pub(crate) const ENDLESS: &[u8] = b"[MSG:The line has no end]\r\n";
/// Connections that are looked after at a time; with more a new one is closed at once.
const CONNECTIONS: usize = 64;

/// What the threads tell the loop.
pub(crate) enum Happened {
    /// A client is there.
    Connected(Client),
    /// A connection has come in; the thread that reads from it needs the sender.
    Connecting(Incoming, SyncSender<Happened>),
    /// Bytes of the client have come, or it has gone: see its [`Inbox`].
    Heard,
    /// A line of the pin protocol; the answer goes to the sender.
    Pins(String, Sender<String>),
}

/// A connection that has come in.
pub(crate) struct Incoming {
    pub(crate) link: Connection,
    pub(crate) place: Taken,
}

/// How a client is connected.
pub(crate) enum Connection {
    /// To the port of `--tcp`.
    Program(TcpStream),
    /// To that of `--web`.
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

/// Places for connections. A thread that looks after one keeps its place until it ends.
#[derive(Clone, Default)]
pub(crate) struct Places(Arc<()>);

/// A place that is taken.
pub(crate) struct Taken(#[allow(dead_code, reason = "it is counted")] Arc<()>);

impl Places {
    /// `None` if there is none left.
    pub(crate) fn take(&self) -> Option<Taken> {
        (Arc::strong_count(&self.0) <= CONNECTIONS).then(|| Taken(self.0.clone()))
    }
}

/// Bytes of a client on their way from the thread that reads them to the loop.
#[derive(Default)]
pub(crate) struct Inbox {
    state: Mutex<InboxState>,
    changed: Condvar,
}

#[derive(Default)]
struct InboxState {
    bytes: VecDeque<u8>,
    /// Bytes since the last line end, without realtime commands.
    line: usize,
    /// The client sends nothing more.
    ended: bool,
    /// The client is served no more.
    closed: bool,
    /// Why it could not be read to its end.
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

    /// Whether the client's line is longer than any that may become one.
    pub(crate) fn is_endless(&self) -> bool {
        self.state().line > LONGEST_LINE
    }

    /// At most so many bytes.
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

    /// Waits until there is room for more. `false` if the client has gone meanwhile, or if its line does not end.
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

/// A client as the loop knows it.
pub(crate) struct Client {
    pub(crate) inbox: Arc<Inbox>,
    pub(crate) answers: SyncSender<Vec<u8>>,
    /// To see whether it is still there.
    pub(crate) stream: Option<TcpStream>,
    /// Standard input: all of it is carried out.
    pub(crate) is_program: bool,
}

impl Client {
    pub(crate) fn has_gone(&self) -> bool {
        self.inbox.has_ended() || self.stream.as_ref().is_some_and(hung_up)
    }

    pub(crate) fn close(self) {
        self.inbox.close();
        if let Some(stream) = self.stream {
            // Its reader wakes up. That of a client that has gone has ended.
            let _ = stream.shutdown(Shutdown::Read);
        }
    }
}

/// Whether the other side has closed its end, also while bytes of it are unread.
#[cfg(unix)]
pub(crate) fn hung_up(link: &impl std::os::fd::AsFd) -> bool {
    use nix::poll::{PollFd, PollFlags, PollTimeout, poll};
    #[cfg(target_os = "linux")]
    let closed = PollFlags::from_bits_retain(nix::libc::POLLRDHUP);
    #[cfg(not(target_os = "linux"))]
    let closed = PollFlags::empty();
    let mut look = [PollFd::new(link.as_fd(), closed)];
    // The call tells of an error and a hang-up unasked.
    poll(&mut look, PollTimeout::ZERO).is_ok_and(|events| events > 0)
}

/// Only reading to the end tells.
#[cfg(not(unix))]
pub(crate) fn hung_up<T>(_link: &T) -> bool {
    false
}

/// Reads until the other side is done or gone, is served no more, or has a line without an end, of which it is told.
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
                // A loop that has as much to do as this looks into the inbox as well.
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
    // Before the loop closes its side.
    if inbox.is_endless() {
        tell_endless();
    }
    inbox.end();
    // Without a loop there is no receiver.
    let _ = sender.send(Happened::Heard);
}

/// A thread that writes answers until its channel is closed or its client is gone.
pub(crate) type Writer = thread::JoinHandle<io::Result<()>>;

pub(crate) fn writer(mut link: impl Write + Send + 'static, inbox: Arc<Inbox>) -> (SyncSender<Vec<u8>>, Writer) {
    let (sender, receiver) = sync_channel::<Vec<u8>>(ANSWERS);
    let handle = thread::spawn(move || {
        let written = receiver.iter().try_for_each(|bytes| write_out(&mut link, &bytes, &inbox));
        // The loop may have nothing more to say, by which it would notice.
        inbox.end();
        written
    });
    (sender, handle)
}

/// Writes all of it, unless the client has gone, or is served no more and does not read.
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
