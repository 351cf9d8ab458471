//! `serve`: the simulator as a Grbl device on TCP (`listen`, `TcpListener`, `address`), a pseudo terminal (`pty`, its
//! `master`) or standard input and output. Threads read a stream, a `PIECE` at a time, into the `Inbox` of each
//! `Client` (its `state`, `LONGEST_LINE`, `AHEAD`) and write its answers; what `happened` comes to the `Device` loop
//! through a channel (`sender`, `receiver`): an `Incoming` `Connection` (`Program`, or `Page` with its socket) to
//! admit, to turn away (`TURNED_AWAY`) or to keep waiting, of as many as there are `Places`, one that has `hung_up`,
//! `ended` or is `closed`, and lines that move pins (`PIN_LINE`, `PIN_BUFFER`). It records each `Input`, sends bytes to
//! the simulator, and lets virtual time pass in a `SLICE` from its `anchor`, at a `Speed`. Also `poll`, time-outs
//! (`Duration::from_secs`, `from_millis`, `UNREAD`), keep-alive (`target_os = "linux"`), and notice of what went
//! `UNRECORDED`.
//!
//! Threads do nothing but wait for bytes and hand them to the one loop that owns the simulator. Virtual time follows the
//! host's clock times the speed; when the machine would fall behind, time slows down rather than pile up.
//!
//! One client is served at a time, as one program has a serial port open; on TCP another one is told so and turned away.
//! A client has gone when it closes its side. Then the port is closed (`$914` says what becomes of the job), and what it
//! sent and the board has no room for is thrown away. It is read ahead of the machine, so that its end is noticed.

use crate::command_line::{Serve, Speed};
use crate::files::{Output, check_apart, remark};
use crate::job::{UNRECORDED, begin_recording, check_power, machine_roles, power_up};
use crate::no_browser::{NoBrowser, is_realtime};
use crate::recording::{Input, Recorder};
use crate::simulator::Simulator;
use crate::web_link::{self, Site};
use anyhow::{Context, Result, anyhow};
use socket2::{SockRef, TcpKeepalive};
use std::collections::VecDeque;
use std::io::{self, BufRead, BufReader, Read, Write};
use std::net::{Shutdown, TcpListener, TcpStream};
use std::path::Path;
use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender, SyncSender, TrySendError, channel, sync_channel};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::thread;
use std::time::{Duration, Instant};
use tungstenite::WebSocket;

/// Bytes of a client that wait in front of the board's link, as in a host's port.
const PORT: usize = 1 << 14;
/// Bytes of a client that are read ahead of that. With more the client is told to wait, and that it has gone is not seen before
/// there is room: TCP tells so behind the last of its bytes.
const AHEAD: usize = (1 << 24) - PIECE;
/// Bytes without a line end after which a client is served no more; a board refuses a line of over 255 in the end.
const LONGEST_LINE: usize = 1 << 16;
/// Bytes that are read at a time.
const PIECE: usize = 1024;
/// Pieces of answers that may wait for a slow client.
const ANSWERS: usize = 64;
/// How often the loop looks at the clock while the machine is busy.
const BUSY: Duration = Duration::from_millis(1);
/// How often it does while nothing can happen without the host.
const QUIET: Duration = Duration::from_millis(50);
/// How often a reader that waits for room, or a writer whose client does not read, looks whether the client is there.
const LOOK: Duration = Duration::from_millis(20);
/// Virtual time that is simulated in one go, between looks at the link.
const SLICE: Duration = Duration::from_millis(20);
/// What a second client is told, and for how long at most it is listened to, so that it can read that.
const TURNED_AWAY: &[u8] = b"[MSG:Another host has the machine]\r\n";
/// What is said to a client before it is closed because its line does not end, or because there is no place for it.
pub(crate) const ENDLESS: &[u8] = b"[MSG:The line has no end]\r\n";
const CROWDED: &[u8] = b"[MSG:Too many connections]\r\n";
const CLOSING_TIME: Duration = Duration::from_secs(1);

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

/// How long a client of another computer may be silent until its system is asked for a sign of life, and the time between
/// such questions: one whose cable has been pulled leaves the machine to others after a minute or two.
const SILENCE: Duration = Duration::from_secs(20);
const QUESTIONS: Duration = Duration::from_secs(5);
/// How long its system may leave an answer unacknowledged, or have no room for it.
#[cfg(target_os = "linux")]
const UNACKNOWLEDGED: Duration = Duration::from_secs(60);

/// A client that does not read holds its writer for that time at most.
fn set_up(stream: &TcpStream, unread: Duration) -> io::Result<()> {
    // Answers are short and each is waited for.
    stream.set_nodelay(true)?;
    stream.set_write_timeout(Some(unread))?;
    let socket = SockRef::from(stream);
    // While an answer is under way no sign of life is asked for, and the system would repeat it for a quarter of an hour.
    #[cfg(target_os = "linux")]
    socket.set_tcp_user_timeout(Some(UNACKNOWLEDGED))?;
    socket.set_tcp_keepalive(&TcpKeepalive::new().with_time(SILENCE).with_interval(QUESTIONS))
}

/// How a client is connected.
pub(crate) enum Connection {
    /// To the port of `--tcp`.
    Program(TcpStream),
    /// To that of `--web`.
    Page(Box<WebSocket<TcpStream>>),
}

impl Incoming {
    fn stream(&self) -> &TcpStream {
        match &self.link {
            Connection::Program(stream) => stream,
            Connection::Page(socket) => socket.get_ref(),
        }
    }

    /// Is told why it is not served.
    fn turn_away(self) {
        match self.link {
            Connection::Program(stream) => turn_away(&stream, TURNED_AWAY),
            Connection::Page(socket) => web_link::turn_away(*socket, TURNED_AWAY),
        }
    }
}

/// Connections that are looked after at a time; with more a new one is closed at once.
const CONNECTIONS: usize = 64;
/// Longest line of the pin protocol, bytes.
const PIN_LINE: u64 = 256;
/// How long a client of that protocol may take for its first line.
const FIRST_LINE: Duration = Duration::from_secs(60);
/// How long it may leave answers unread when there is no room for another one.
const UNREAD: Duration = Duration::from_secs(5);
/// Room of the system for the lines of such a client, and for its answers, bytes.
const PIN_BUFFER: usize = 1 << 14;

/// Carries out `serve`. Returns when standard input ends; the other links never end.
pub fn serve(options: &Serve) -> Result<()> {
    check_apart(&machine_roles(&options.machine, options.record.as_deref()))?;
    let open =
        |path: &Path| Output::open(path).with_context(|| format!("cannot write the recording {}", path.display()));
    let record = options.record.as_deref().map(open).transpose()?;
    let (simulator, mut recorder) = power_up(&options.machine, record.is_some())?;
    let (sender, receiver) = sync_channel(4);
    if let Some(address) = &options.pins {
        let listener = listen(address)?;
        // Standard output belongs to the client when it is the link.
        remark(&format!("pins on {}", listener.local_addr()?));
        let sender = sender.clone();
        thread::spawn(move || serve_pins(&listener, &sender));
    }
    let written = open_link(options, sender)?;
    begin_recording(&mut recorder, record)?;
    Device::new(simulator, options.speed, options.reset_on_connect, recorder).run(&receiver)?;
    // The device is gone, and so is who could give the writer more: what it still has goes out.
    match written.map_or(Ok(Ok(())), Writer::join) {
        Ok(Err(error)) if error.kind() == io::ErrorKind::BrokenPipe => Ok(()),
        Ok(written) => written.context("cannot write the answers"),
        Err(_) => Err(anyhow!("the answers could not be written")),
    }
}

/// Says where the link is. Whoever started the program may wait for that.
fn announce(link: &str) -> Result<()> {
    let mut out = io::stdout();
    writeln!(out, "{link}").and_then(|()| out.flush()).context("cannot write to standard output where the link is")
}

/// Opens the link, whose clients the sender tells of. The writer of standard output, if that is the link.
fn open_link(options: &Serve, sender: SyncSender<Happened>) -> Result<Option<Writer>> {
    if let Some(address) = &options.link.tcp {
        let listener = listen(address)?;
        announce(&format!("tcp {}", listener.local_addr()?))?;
        thread::spawn(move || serve_tcp(&listener, &sender));
    } else if let Some(port) = options.link.web {
        let (listener, site) = Site::open(port, options.page.as_deref())?;
        announce(&format!("web {}", site.address()))?;
        thread::spawn(move || web_link::serve_web(&listener, &Arc::new(site), &sender));
    } else if options.link.stdio {
        let inbox = Arc::new(Inbox::default());
        let (answers, written) = writer(io::stdout(), inbox.clone());
        thread::spawn(move || serve_stdio(Client { inbox, answers, stream: None, is_program: true }, &sender));
        return Ok(Some(written));
    } else {
        #[cfg(unix)]
        pty::open(options.link.pty.as_ref().and_then(Option::as_deref), sender)?;
    }
    Ok(None)
}

/// A port alone, or with a colon before it, is one of the loopback. Says so if others than this computer can connect.
fn listen(address: &str) -> Result<TcpListener> {
    let port = address.strip_prefix(':').unwrap_or(address).parse::<u16>();
    let address = port.map_or_else(|_| address.to_owned(), |port| format!("127.0.0.1:{port}"));
    let listener = TcpListener::bind(&address).with_context(|| format!("cannot listen on {address}"))?;
    let address = listener.local_addr()?;
    if !address.ip().is_loopback() {
        remark(&format!("oxmill: {address} is open to other computers: whoever reaches it moves this machine"));
    }
    Ok(listener)
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
    fn take(&self, most: usize) -> Vec<u8> {
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

    fn is_empty(&self) -> bool {
        self.state().bytes.is_empty()
    }

    pub(crate) fn end(&self) {
        self.state().ended = true;
    }

    fn has_ended(&self) -> bool {
        self.state().ended
    }

    fn close(&self) {
        self.state().closed = true;
        self.changed.notify_all();
    }

    fn is_closed(&self) -> bool {
        self.state().closed
    }

    fn fail(&self, why: io::Error) {
        self.state().failure = Some(why);
    }

    fn failure(&self) -> Option<io::Error> {
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
    inbox: Arc<Inbox>,
    answers: SyncSender<Vec<u8>>,
    /// To see whether it is still there.
    stream: Option<TcpStream>,
    /// Standard input: all of it is carried out.
    is_program: bool,
}

impl Client {
    fn has_gone(&self) -> bool {
        self.inbox.has_ended() || self.stream.as_ref().is_some_and(hung_up)
    }

    fn close(self) {
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

/// The simulator, the clock it follows and the client it talks to.
struct Device {
    simulator: Simulator,
    speed: Speed,
    reset_on_connect: bool,
    /// A moment of the host's clock and the virtual time (in ticks) that belongs to it.
    anchor: (Instant, u64),
    client: Option<Client>,
    /// Clients on TCP that have come when the one before was about to go.
    waiting: VecDeque<(Incoming, SyncSender<Happened>)>,
    /// An answer that the client had no room for.
    kept: Option<Vec<u8>>,
    recorder: Option<Recorder>,
    /// Why the recording is not whole.
    unrecorded: Option<io::Error>,
}

impl Device {
    fn new(simulator: Simulator, speed: Speed, reset_on_connect: bool, recorder: Option<Recorder>) -> Self {
        Self {
            anchor: (Instant::now(), simulator.clock().now()),
            simulator,
            speed,
            reset_on_connect,
            client: None,
            waiting: VecDeque::new(),
            kept: None,
            recorder,
            unrecorded: None,
        }
    }

    /// Something is about to come in.
    fn record(&mut self, input: &Input) {
        if let Some(recorder) = &mut self.recorder
            && let Err(error) = recorder.input(&self.simulator, input)
        {
            self.unrecorded.get_or_insert(error);
        }
    }

    fn run(mut self, receiver: &Receiver<Happened>) -> Result<()> {
        let done = self.run_until_left(receiver);
        if let Some(recorder) = &mut self.recorder {
            recorder.end(&self.simulator).context(UNRECORDED)?;
        }
        done
    }

    fn run_until_left(&mut self, receiver: &Receiver<Happened>) -> Result<()> {
        loop {
            // What came is dated with the time at which it came.
            self.pass_time();
            self.fetch();
            if !self.answer() {
                let was_program = self.client.as_ref().is_some_and(|client| client.is_program);
                self.left();
                if was_program {
                    // Its writer knows why. No other host will come.
                    return Ok(());
                }
            }
            check_power(&self.simulator)?;
            if let Some(recorder) = &mut self.recorder {
                recorder.time_passed(&self.simulator).context(UNRECORDED)?;
            }
            if let Some(error) = self.unrecorded.take() {
                return Err(error).context(UNRECORDED);
            }
            let active = self.simulator.is_active();
            if self.is_done() && !active && self.simulator.unfetched() == 0 && self.kept.is_none() {
                // Lines that are unread now wait for a host that will not come. The writer ends when the last answer has
                // been written and its sender is gone.
                let failure = self.client.as_ref().and_then(|client| client.inbox.failure());
                return failure.map_or(Ok(()), Err).context("cannot read standard input to its end");
            }
            let mut happened = match self.speed {
                Speed::Max if active => receiver.try_recv().ok(),
                _ => match receiver.recv_timeout(if active || self.kept.is_some() { BUSY } else { QUIET }) {
                    Ok(happened) => Some(happened),
                    Err(RecvTimeoutError::Timeout) => None,
                    Err(RecvTimeoutError::Disconnected) if self.client.is_some() => {
                        thread::sleep(BUSY);
                        None
                    }
                    Err(RecvTimeoutError::Disconnected) => return Ok(()),
                },
            };
            self.pass_time();
            while let Some(one) = happened {
                self.take(one);
                happened = receiver.try_recv().ok();
            }
        }
    }

    fn take(&mut self, happened: Happened) {
        match happened {
            Happened::Connected(client) => self.connected(client),
            Happened::Connecting(incoming, sender) => self.connecting(incoming, sender),
            Happened::Heard => {}
            Happened::Pins(line, reply) => {
                if self.simulator.moves_pin(&line) {
                    self.record(&Input::Pin(line.clone()));
                }
                let answer = self.simulator.pin_line(&line);
                // A client that has gone in the meantime needs no answer.
                let _ = reply.send(answer);
            }
        }
    }

    /// Passes on what the client has sent, as far as its port has room, and notices its end.
    fn fetch(&mut self) {
        loop {
            let Some(client) = &self.client else { return };
            let ended = client.inbox.has_ended();
            let bytes = client.inbox.take(PORT.saturating_sub(self.simulator.unread()).min(PIECE));
            if !bytes.is_empty() {
                self.record(&Input::Host(bytes.clone()));
                self.simulator.send(bytes);
            } else if ended && !client.is_program {
                // What it has been told by now it may still read.
                self.answer();
                return self.left();
            } else {
                return;
            }
        }
    }

    /// Whether the program on standard input has been passed on, or waits for a machine that waits for a host.
    fn is_done(&self) -> bool {
        let has_room = self.simulator.unread() < PORT;
        self.client.as_ref().is_some_and(|client| {
            client.is_program && client.inbox.has_ended() && (client.inbox.is_empty() || !has_room)
        })
    }

    /// Serves a new connection, or turns it away.
    fn connecting(&mut self, incoming: Incoming, sender: SyncSender<Happened>) {
        match &self.client {
            None => self.admit(incoming, sender),
            // Its reader is about to tell so.
            Some(client) if client.has_gone() => self.waiting.push_back((incoming, sender)),
            Some(_) => {
                thread::spawn(move || incoming.turn_away());
            }
        }
    }

    fn admit(&mut self, incoming: Incoming, sender: SyncSender<Happened>) {
        let stream = incoming.stream();
        let set_up = set_up(stream, LOOK);
        let (Ok(()), Ok(back), Ok(watched)) = (set_up, stream.try_clone(), stream.try_clone()) else { return };
        let inbox = Arc::new(Inbox::default());
        let Incoming { link, place } = incoming;
        match link {
            Connection::Program(stream) => {
                let (answers, _) = writer(back, inbox.clone());
                self.connected(Client { inbox: inbox.clone(), answers, stream: Some(watched), is_program: false });
                thread::spawn(move || {
                    let mut reader = NoBrowser::new(&stream);
                    pass_bytes(&mut reader, &inbox, &sender, || hung_up(&stream), || turn_away(&stream, ENDLESS));
                    drop(place);
                });
            }
            Connection::Page(socket) => {
                let (answers, spoken) = sync_channel(ANSWERS);
                self.connected(Client { inbox: inbox.clone(), answers, stream: Some(watched), is_program: false });
                thread::spawn(move || {
                    web_link::pass_messages(*socket, &inbox, &spoken, &sender);
                    drop(place);
                });
            }
        }
    }

    fn connected(&mut self, client: Client) {
        self.client = Some(client);
        self.kept = None;
        // Without a client the answers are lost, as on a port that is not open.
        self.simulator.take_output();
        self.record(&Input::Connect);
        self.simulator.connect();
        if self.reset_on_connect {
            // It gets the welcome of the reset.
            self.simulator.take_output();
            self.record(&Input::Host(vec![0x18]));
            self.simulator.send([0x18]);
        }
    }

    fn left(&mut self) {
        if let Some(client) = self.client.take() {
            client.close();
            self.kept = None;
            self.record(&Input::Disconnect);
            self.simulator.disconnect();
        }
        for (incoming, sender) in std::mem::take(&mut self.waiting) {
            self.connecting(incoming, sender);
        }
    }

    fn pass_time(&mut self) {
        let clock = *self.simulator.clock();
        let slice = clock.ticks_in(SLICE);
        match self.speed {
            Speed::Max => {
                if self.simulator.is_active() {
                    let until = clock.now() + slice;
                    while self.simulator.clock().now() < until && self.simulator.advance_once(until) {}
                }
            }
            Speed::Times(times) => {
                let elapsed = self.anchor.0.elapsed();
                let target = self.anchor.1 + clock.ticks_in(elapsed.mul_f64(times));
                let most = clock.now() + slice.max(clock.ticks_in(BUSY.mul_f64(times)) * 2);
                if target > most && self.simulator.is_active() {
                    self.simulator.advance_to(most);
                    self.anchor = (Instant::now(), most);
                } else {
                    self.simulator.advance_to(target);
                }
            }
        }
    }

    /// Gives the client what was said, as far as it has room. `false` if it takes no answers any more.
    fn answer(&mut self) -> bool {
        let Some(client) = &self.client else {
            // No client is connected.
            self.simulator.take_output();
            return true;
        };
        loop {
            let answer = match self.kept.take() {
                Some(answer) => answer,
                None if self.simulator.unfetched() > 0 => self.simulator.take_output().into_bytes(),
                None => return true,
            };
            match client.answers.try_send(answer) {
                Ok(()) => {}
                Err(TrySendError::Full(answer)) => {
                    self.kept = Some(answer);
                    return true;
                }
                Err(TrySendError::Disconnected(_)) => return false,
            }
        }
    }
}

/// Reads until the other side is done or gone, is served no more, or has a line without an end, of which it is told.
fn pass_bytes(
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
type Writer = thread::JoinHandle<io::Result<()>>;

fn writer(mut link: impl Write + Send + 'static, inbox: Arc<Inbox>) -> (SyncSender<Vec<u8>>, Writer) {
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
                io::ErrorKind::WouldBlock | io::ErrorKind::TimedOut if !inbox.is_closed() => thread::sleep(BUSY),
                _ => return Err(error),
            },
        }
    }
    link.flush()
}

/// Tells a client why it is served no more, or never. Nothing of what it says then is looked at.
fn turn_away(mut stream: &TcpStream, why: &[u8]) {
    let end = Instant::now() + CLOSING_TIME;
    let _ = stream.set_write_timeout(Some(CLOSING_TIME));
    let _ = stream.set_read_timeout(Some(CLOSING_TIME));
    let told = stream.write_all(why).and_then(|()| stream.shutdown(Shutdown::Write));
    // A socket closed with unread bytes in it would take the line back.
    let mut thrown_away = [0; PIECE];
    while told.is_ok() && Instant::now() < end && stream.read(&mut thrown_away).is_ok_and(|length| length > 0) {}
}

/// Tells one for whom there is no place, without waiting for it.
pub(crate) fn refuse(mut stream: &TcpStream) {
    let told = stream.set_nonblocking(true).and_then(|()| stream.write_all(CROWDED));
    let told = told.and_then(|()| stream.shutdown(Shutdown::Write));
    // A socket closed with unread bytes in it would take the line back.
    let _ = told.and_then(|()| stream.read(&mut [0; PIECE]));
}

/// The connections that come in. A system that has no room for one says so again and again.
pub(crate) fn connections(listener: &TcpListener) -> impl Iterator<Item = TcpStream> {
    listener.incoming().filter_map(|stream| stream.inspect_err(|_| thread::sleep(LOOK)).ok())
}

fn serve_tcp(listener: &TcpListener, sender: &SyncSender<Happened>) {
    let places = Places::default();
    for stream in connections(listener) {
        let Some(place) = places.take() else {
            refuse(&stream);
            continue;
        };
        let incoming = Incoming { link: Connection::Program(stream), place };
        if sender.send(Happened::Connecting(incoming, sender.clone())).is_err() {
            return;
        }
    }
}

fn serve_stdio(client: Client, sender: &SyncSender<Happened>) {
    let inbox = client.inbox.clone();
    // A pipe that has ended is read to its end all the same: it is a program, and all of it is there.
    if sender.send(Happened::Connected(client)).is_ok() {
        let tell = || inbox.fail(io::Error::other(format!("a line has more than {LONGEST_LINE} characters")));
        pass_bytes(&mut io::stdin().lock(), &inbox, sender, || false, tell);
    }
}

fn serve_pins(listener: &TcpListener, sender: &SyncSender<Happened>) {
    let places = Places::default();
    for stream in connections(listener) {
        let Some(place) = places.take() else {
            refuse(&stream);
            continue;
        };
        let sender = sender.clone();
        thread::spawn(move || {
            // Whoever says something else than lines is closed.
            let _ = serve_pin_client(&stream, &sender);
            drop(place);
        });
    }
}

fn serve_pin_client(stream: &TcpStream, sender: &SyncSender<Happened>) -> io::Result<()> {
    // One whose cable has been pulled, or that does not read, holds its place for a short time only, and little memory.
    set_up(stream, UNREAD)?;
    let socket = SockRef::from(stream);
    socket.set_send_buffer_size(PIN_BUFFER)?;
    socket.set_recv_buffer_size(PIN_BUFFER)?;
    let mut back = stream;
    let (reply, answers) = channel();
    let mut reader = BufReader::new(NoBrowser::new(stream));
    // Whoever says nothing holds no place for long; after its first line a bench may be silent for hours.
    stream.set_read_timeout(Some(FIRST_LINE))?;
    loop {
        let mut line = String::new();
        reader.by_ref().take(PIN_LINE).read_line(&mut line)?;
        if !line.ends_with('\n') {
            if line.len() as u64 == PIN_LINE {
                turn_away(stream, ENDLESS);
            }
            return Ok(());
        }
        stream.set_read_timeout(None)?;
        if line.trim().is_empty() {
            continue;
        }
        if sender.send(Happened::Pins(line.trim_end().into(), reply.clone())).is_err() {
            return Ok(());
        }
        let Ok(answer) = answers.recv() else { return Ok(()) };
        back.write_all(format!("{answer}\n").as_bytes())?;
    }
}

#[cfg(unix)]
mod pty {
    //! A pseudo terminal that a sender opens like a serial port. Several programs that have it open are one client.

    use super::{Client, ENDLESS, Happened, Inbox, LOOK, PIECE, Writer, announce, hung_up, writer};
    use anyhow::{Context, Result, bail};
    use nix::fcntl::{FcntlArg, OFlag, fcntl};
    use nix::poll::{PollFd, PollFlags, PollTimeout, poll};
    use nix::pty::openpty;
    use nix::sys::termios::{FlushArg, SetArg, cfmakeraw, tcflush, tcgetattr, tcsetattr};
    use std::fs::{self, File, OpenOptions};
    use std::io::{Read, Write};
    use std::os::fd::AsFd;
    use std::os::unix::fs::OpenOptionsExt;
    use std::path::{Path, PathBuf};
    use std::sync::Arc;
    use std::sync::mpsc::SyncSender;
    use std::thread;
    use std::time::Duration;

    /// How often a port that is not open is polled.
    const CLOSED: Duration = Duration::from_millis(2);

    pub fn open(link: Option<&Path>, sender: SyncSender<Happened>) -> Result<()> {
        let ends = openpty(None, None).context("cannot make a pseudo terminal")?;
        let path = nix::unistd::ttyname(&ends.slave).context("the pseudo terminal has no name")?;
        let master = File::from(ends.master);
        make_raw(&master).context("cannot set up the pseudo terminal")?;
        // A client that does not read must not hold the writer for ever.
        fcntl(&master, FcntlArg::F_SETFL(OFlag::O_NONBLOCK)).context("cannot set up the pseudo terminal")?;
        // Once the other end is closed, the first client to open it can be noticed.
        drop(ends.slave);
        if let Some(link) = link {
            match fs::symlink_metadata(link) {
                // One that leads to a terminal, or nowhere any more, is that of a server before.
                Ok(old) if old.file_type().is_symlink() && !is_file_or_folder(link) => fs::remove_file(link)?,
                Ok(_) => bail!("{} is there already and does not lead to a terminal", link.display()),
                Err(_) => {}
            }
            std::os::unix::fs::symlink(&path, link)
                .with_context(|| format!("cannot make the link {}", link.display()))?;
        }
        announce(&format!("pty {}", path.display()))?;
        thread::spawn(move || Port { master, path, sender, client: None }.serve());
        Ok(())
    }

    fn is_file_or_folder(path: &Path) -> bool {
        fs::metadata(path).is_ok_and(|about| about.is_file() || about.is_dir())
    }

    /// No echo, no line editing, no translation: bytes as they are.
    fn make_raw(master: &File) -> nix::Result<()> {
        let mut terminal = tcgetattr(master)?;
        cfmakeraw(&mut terminal);
        tcsetattr(master, SetArg::TCSANOW, &terminal)
    }

    /// The client that has the port open.
    struct Open {
        inbox: Arc<Inbox>,
        writer: Writer,
    }

    struct Port {
        master: File,
        path: PathBuf,
        sender: SyncSender<Happened>,
        client: Option<Open>,
    }

    impl Port {
        /// `None` when the loop has ended.
        fn serve(mut self) -> Option<()> {
            loop {
                let (hung_up, readable) = self.look();
                if self.client.is_none() && (!hung_up || readable) {
                    self.opened()?;
                }
                let Some(client) = &self.client else {
                    thread::sleep(CLOSED);
                    continue;
                };
                if readable && client.inbox.wait_for_room(|| self::hung_up(&self.master)) {
                    let mut buffer = [0; PIECE];
                    if let Ok(length @ 1..) = (&self.master).read(&mut buffer) {
                        client.inbox.push(&buffer[..length]);
                        self.sender.send(Happened::Heard).ok()?;
                    }
                } else if hung_up || readable {
                    if client.inbox.is_endless() {
                        let _ = (&self.master).write(ENDLESS);
                    }
                    self.closed()?;
                }
            }
        }

        /// Whether no client has the port open, and whether there are bytes.
        fn look(&self) -> (bool, bool) {
            let mut look = [PollFd::new(self.master.as_fd(), PollFlags::POLLIN)];
            let timeout = PollTimeout::try_from(LOOK).unwrap_or(PollTimeout::ZERO);
            let seen = match poll(&mut look, timeout) {
                Ok(_) => look[0].revents().unwrap_or(PollFlags::empty()),
                Err(_) => PollFlags::empty(),
            };
            (seen.contains(PollFlags::POLLHUP), seen.contains(PollFlags::POLLIN))
        }

        fn opened(&mut self) -> Option<()> {
            let back = self.master.try_clone().ok()?;
            let _ = make_raw(&self.master);
            let inbox = Arc::new(Inbox::default());
            let (answers, writer) = writer(back, inbox.clone());
            let client = Client { inbox: inbox.clone(), answers, stream: None, is_program: false };
            self.sender.send(Happened::Connected(client)).ok()?;
            self.client = Some(Open { inbox, writer });
            Some(())
        }

        /// Bytes for which there was no room go with the client, and so do answers that it has not read: the terminal would
        /// keep them for the next one.
        fn closed(&mut self) -> Option<()> {
            if let Some(client) = self.client.take() {
                let mut rest = [0; PIECE];
                while (&self.master).read(&mut rest).is_ok_and(|length| length > 0) {}
                client.inbox.end();
                self.sender.send(Happened::Heard).ok()?;
                // The loop has let go of it then, and nothing is written any more.
                let _ = client.writer.join().ok()?;
                let flags = (OFlag::O_NOCTTY | OFlag::O_NONBLOCK).bits();
                if let Ok(end) = OpenOptions::new().read(true).write(true).custom_flags(flags).open(&self.path) {
                    let _ = tcflush(&end, FlushArg::TCIFLUSH);
                }
            }
            Some(())
        }
    }
}
