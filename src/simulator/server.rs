//! `serve`: the simulator as a Grbl device for senders. Opens the link (TCP, a page, a pseudo terminal, or standard
//! input and output), and lets virtual time pass with the host's clock.
//!
//! Threads do nothing but wait for bytes and hand them to the one loop that owns the simulator. Virtual time follows the
//! host's clock times the speed; when the machine would fall behind, time slows down rather than pile up.
//!
//! One client is served at a time, as one program has a serial port open; on TCP another one is told so and turned away.
//! A client has gone when it closes its side. Then the port is closed (`$914` says what becomes of the job), and what it
//! sent and the board has no room for is thrown away. It is read ahead of the machine, so that its end is noticed.

use crate::clients::{
    ANSWERS, Client, Connection, ENDLESS, Happened, Inbox, Incoming, LONGEST_LINE, LOOK, PIECE, Writer, hung_up,
    pass_bytes, writer,
};
use crate::command_line::{Serve, Speed};
use crate::files::{Output, check_apart, remark};
use crate::job::{UNRECORDED, begin_recording, check_power, machine_roles, power_up_as_board};
use crate::no_browser::NoBrowser;
#[cfg(unix)]
use crate::pty_link;
use crate::recording::{Input, Recorder};
use crate::simulator::Simulator;
use crate::tcp_link::{self, listen, serve_pins, serve_tcp, set_up};
use crate::web_link::{self, Site};
use anyhow::{Context, Result, anyhow};
use std::collections::VecDeque;
use std::io::{self, Write};
use std::path::Path;
use std::sync::Arc;
use std::sync::mpsc::{Receiver, RecvTimeoutError, SyncSender, TrySendError, sync_channel};
use std::thread;
use std::time::{Duration, Instant};

/// Bytes of a client that wait in front of the board's link, as in a host's port.
const PORT: usize = 1 << 14;
/// How often the loop looks at the clock while the machine is busy.
const BUSY: Duration = Duration::from_millis(1);
/// How often it does while nothing can happen without the host.
const QUIET: Duration = Duration::from_millis(50);
/// What a second client is told.
const TURNED_AWAY: &[u8] = b"[MSG:Another host has the machine]\r\n";
/// Virtual time that is simulated in one go, between looks at the link.
const SLICE: Duration = Duration::from_millis(20);

/// Carries out `serve`. Returns when standard input ends; the other links never end.
pub fn serve(options: &Serve) -> Result<()> {
    check_apart(&machine_roles(&options.machine, options.record.as_deref()))?;
    let open =
        |path: &Path| Output::open(path).with_context(|| format!("cannot write the recording {}", path.display()));
    let record = options.record.as_deref().map(open).transpose()?;
    let (simulator, mut recorder) = power_up_as_board(&options.machine, record.is_some())?;
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
        {
            let port = pty_link::open(options.link.pty.as_ref().and_then(Option::as_deref), sender)?;
            announce(&format!("pty {}", port.path().display()))?;
            thread::spawn(move || port.serve());
        }
    }
    Ok(None)
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
                thread::spawn(move || turn_away(incoming));
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
                    pass_bytes(
                        &mut reader,
                        &inbox,
                        &sender,
                        || hung_up(&stream),
                        || tcp_link::turn_away(&stream, ENDLESS),
                    );
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

/// A client that comes while another one has the machine is told so.
fn turn_away(incoming: Incoming) {
    match incoming.link {
        Connection::Program(stream) => tcp_link::turn_away(&stream, TURNED_AWAY),
        Connection::Page(socket) => web_link::turn_away(*socket, TURNED_AWAY),
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
