//! `serve`: the simulator as a Grbl device for senders. Opens the link (TCP, a page, a pseudo terminal, or standard
//! input and output), and lets virtual time pass with the host's clock.
//!
//! Threads wait for bytes and hand them to one loop, which owns the simulator. Virtual time follows the host's clock
//! multiplied by the speed. If the simulation cannot keep up, virtual time runs slower and does not catch up later.
//!
//! One client is served at a time, like one program at a serial port. On TCP, a second client gets a message and is
//! disconnected. When a client disconnects, the simulated port is closed. `$914` then determines what becomes of the
//! job, and bytes for which the board has no room are discarded. A client's bytes are read before the machine needs
//! them, because a disconnection shows only when the last byte has been read.

use crate::clients::{
    ANSWERS, Client, Connection, ENDLESS, Happened, Inbox, Incoming, LONGEST_LINE, LOOK, PIECE, Writer, hung_up,
    pass_bytes, writer,
};
use crate::command_line::{Serve, Speed};
use crate::files::{Output, check_apart, eprint_line};
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

/// Maximum number of a client's bytes that the controller has not read yet, as in the buffer of a host's serial port.
const PORT: usize = 1 << 14;
/// Interval at which the loop checks the clock while the machine is busy.
const BUSY: Duration = Duration::from_millis(1);
/// Interval at which the loop checks the clock while the machine waits for the host.
const QUIET: Duration = Duration::from_millis(50);
/// Message to a client that connects while another one is served.
const TURNED_AWAY: &[u8] = b"[MSG:Another host has the machine]\r\n";
/// Maximum virtual time that is simulated between two checks of the link.
const SLICE: Duration = Duration::from_millis(20);

/// Runs `oxmill serve`. With standard input as the link, returns at its end. With the other links, returns only after
/// an error.
pub fn serve(options: &Serve) -> Result<()> {
    check_apart(&machine_roles(&options.machine, options.record.as_deref()))?;
    let open =
        |path: &Path| Output::open(path).with_context(|| format!("cannot write the recording {}", path.display()));
    let record = options.record.as_deref().map(open).transpose()?;
    let (simulator, mut recorder) = power_up_as_board(&options.machine, record.is_some())?;
    let (sender, receiver) = sync_channel(4);
    if let Some(address) = &options.pins {
        let listener = listen(address)?;
        // If the link is standard input and output, standard output belongs to the client. So print to standard error.
        eprint_line(&format!("pins on {}", listener.local_addr()?));
        let sender = sender.clone();
        thread::spawn(move || serve_pins(&listener, &sender));
    }
    let written = open_link(options, sender)?;
    begin_recording(&mut recorder, record)?;
    Device::new(simulator, options.speed, options.reset_on_connect, recorder).run(&receiver)?;
    // The loop has ended and has dropped its end of the reply queue. Wait until the writer of standard output has
    // written the rest of the queue.
    match written.map_or(Ok(Ok(())), Writer::join) {
        Ok(Err(error)) if error.kind() == io::ErrorKind::BrokenPipe => Ok(()),
        Ok(written) => written.context("cannot write the answers"),
        Err(_) => Err(anyhow!("the answers could not be written")),
    }
}

/// Prints the kind and the address of the link, such as `tcp 127.0.0.1:2323`, for a program that has started this one
/// and waits for the address.
fn announce(link: &str) -> Result<()> {
    let mut out = io::stdout();
    writeln!(out, "{link}").and_then(|()| out.flush()).context("cannot write to standard output where the link is")
}

/// Opens the link, which reports its clients to the loop through `sender`. If the link is standard input and output,
/// returns the writer of standard output.
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

/// The simulator, the clock that it follows, and its client.
struct Device {
    simulator: Simulator,
    speed: Speed,
    reset_on_connect: bool,
    /// Reference for [`Speed::Times`]: a time of the host's clock, and the virtual time at that moment in ticks.
    anchor: (Instant, u64),
    client: Option<Client>,
    /// TCP clients that connected while the previous client was about to disconnect.
    waiting: VecDeque<(Incoming, SyncSender<Happened>)>,
    /// A reply for which the client's queue had no room; it is sent before all others.
    kept: Option<Vec<u8>>,
    recorder: Option<Recorder>,
    /// The error that made the recording incomplete.
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

    /// Records an input before the simulator receives it.
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
            // Advance virtual time before fetching input, so that input gets the time at which it arrived.
            self.pass_time();
            self.fetch();
            if !self.answer() {
                let was_program = self.client.as_ref().is_some_and(|client| client.is_program);
                self.left();
                if was_program {
                    // Standard output is closed, and no other host can connect: end the loop. `serve` gets the error
                    // from the client's writer.
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
                // Standard input has ended. If lines are still unread, the machine waits for a realtime command, which
                // cannot come any more. The writer's queue loses its sender when this loop ends. The writer then ends
                // after the last reply.
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
                // Ignore the error of a client that has disconnected meanwhile.
                let _ = reply.send(answer);
            }
        }
    }

    /// Passes the client's bytes on, as far as the simulated port has room, and handles the client's disconnection.
    fn fetch(&mut self) {
        loop {
            let Some(client) = &self.client else { return };
            let ended = client.inbox.has_ended();
            let bytes = client.inbox.take(PORT.saturating_sub(self.simulator.unread()).min(PIECE));
            if !bytes.is_empty() {
                self.record(&Input::Host(bytes.clone()));
                self.simulator.send(bytes);
            } else if ended && !client.is_program {
                // The client can still read the replies made so far: send them.
                self.answer();
                return self.left();
            } else {
                return;
            }
        }
    }

    /// Returns whether standard input has ended and the simulator takes no more of it: all has been sent, or the port
    /// has no room for the rest.
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
            // The previous client has gone, and its reader thread is about to report that: keep the new one waiting.
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
        // Discard earlier replies: without a client they are lost, as on a port that is not open.
        self.simulator.take_output();
        self.record(&Input::Connect);
        self.simulator.connect();
        if self.reset_on_connect {
            // Discard the output up to now, so that the client gets only the welcome message of the reset.
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

    /// Sends replies to the client, as far as its queue has room. Returns `false` if the writer of the client has
    /// ended, so that no reply can reach the client any more.
    fn answer(&mut self) -> bool {
        let Some(client) = &self.client else {
            // Without a client, the output is discarded.
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

/// Tells a client that another client has the machine, and closes its connection.
fn turn_away(incoming: Incoming) {
    match incoming.link {
        Connection::Program(stream) => tcp_link::turn_away(&stream, TURNED_AWAY),
        Connection::Page(socket) => web_link::turn_away(*socket, TURNED_AWAY),
    }
}

fn serve_stdio(client: Client, sender: &SyncSender<Happened>) {
    let inbox = client.inbox.clone();
    // `|| false`: as long as bytes are left, never treat the client as disconnected. A pipe whose writing end is
    // closed can still contain a complete program.
    if sender.send(Happened::Connected(client)).is_ok() {
        let tell = || inbox.fail(io::Error::other(format!("a line has more than {LONGEST_LINE} characters")));
        pass_bytes(&mut io::stdin().lock(), &inbox, sender, || false, tell);
    }
}
