//! `serve`: the simulator as a Grbl device on TCP, a pseudo terminal or standard input and output.
//!
//! Threads do nothing but wait for bytes and hand them to the one loop that owns the simulator. Virtual time follows the
//! host's clock times the speed; when the machine would fall behind, time slows down rather than pile up.

use crate::command_line::{Serve, Speed};
use crate::job::{check_power, power_up};
use crate::pump::Simulator;
use anyhow::{Context, Result, anyhow};
use std::io::{self, BufRead, BufReader, Read, Write};
use std::net::TcpListener;
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender, SyncSender, TrySendError, channel, sync_channel};
use std::thread;
use std::time::{Duration, Instant};

/// Bytes that are taken ahead of the controller. What is beyond waits in the link, as with flow control, and realtime
/// commands in it wait too: so this is generous, for senders that pour in a whole file and then want to hold it.
const UNREAD: usize = 1 << 24;
/// Bytes that are read at a time.
const PIECE: usize = 1024;
/// Pieces of answers that may wait for a slow client.
const ANSWERS: usize = 64;
/// How often the loop looks at the clock while the machine is busy.
const BUSY: Duration = Duration::from_millis(1);
/// How often it does while nothing can happen without the host.
const QUIET: Duration = Duration::from_millis(50);
/// Virtual time that is simulated in one go, between looks at the link.
const SLICE: Duration = Duration::from_millis(20);

/// What the threads tell the loop.
enum Happened {
    /// A client is there; answers go to the sender.
    Connected(SyncSender<Vec<u8>>),
    /// Bytes of the client.
    Bytes(Vec<u8>),
    /// The client sends nothing more; it may still read.
    Disconnected,
    /// The client has closed the port.
    Left,
    /// The link itself has come to its end.
    Ended,
    /// A line of the pin protocol; the answer goes to the sender.
    Pins(String, Sender<String>),
}

/// Carries out `serve`. Returns when standard input ends; the other links go on for ever.
pub fn serve(options: &Serve) -> Result<()> {
    let simulator = power_up(&options.machine)?;
    let (sender, receiver) = sync_channel(4);
    if let Some(address) = &options.pins {
        let listener = listen(address)?;
        // Standard output belongs to the client when it is the link.
        eprintln!("pins on {}", listener.local_addr()?);
        let sender = sender.clone();
        thread::spawn(move || serve_pins(&listener, &sender));
    }
    let device = Device::new(simulator, options.speed, options.reset_on_connect);
    let unread = device.unread.clone();
    if let Some(address) = &options.link.tcp {
        let listener = listen(address)?;
        println!("tcp {}", listener.local_addr()?);
        io::stdout().flush()?;
        thread::spawn(move || serve_tcp(&listener, &sender, &unread));
    } else if options.link.stdio {
        let (client, written) = writer(io::stdout());
        thread::spawn(move || serve_stdio(client, &sender, &unread));
        device.run(&receiver)?;
        // The device is gone, and so is who could give the writer more: what it still has goes out.
        return written.join().map_err(|_| anyhow!("the answers could not be written"));
    } else {
        #[cfg(unix)]
        pty::open(options.link.pty.as_ref().and_then(Option::as_deref), sender, unread)?;
    }
    device.run(&receiver)
}

fn listen(address: &str) -> Result<TcpListener> {
    TcpListener::bind(address).with_context(|| format!("cannot listen on {address}"))
}

/// The simulator, the clock it follows and the client it talks to.
struct Device {
    simulator: Simulator,
    speed: Speed,
    reset_on_connect: bool,
    /// A moment of the host's clock and the virtual time (in ticks) that belongs to it.
    anchor: (Instant, u64),
    client: Option<SyncSender<Vec<u8>>>,
    /// An answer that the client had no room for.
    kept: Option<Vec<u8>>,
    /// The client has said all it will; it may still read.
    leaving: bool,
    ended: bool,
    /// How many bytes wait for the controller, for those who read the link.
    unread: Gauge,
}

/// Bytes that wait for the controller.
type Gauge = Arc<AtomicUsize>;

impl Device {
    fn new(simulator: Simulator, speed: Speed, reset_on_connect: bool) -> Self {
        let anchor = (Instant::now(), simulator.clock().now());
        let unread = Gauge::default();
        Self {
            simulator,
            speed,
            reset_on_connect,
            anchor,
            client: None,
            kept: None,
            ended: false,
            leaving: false,
            unread,
        }
    }

    fn run(mut self, receiver: &Receiver<Happened>) -> Result<()> {
        loop {
            self.pass_time();
            self.answer();
            check_power(&self.simulator)?;
            let active = self.simulator.is_active();
            if self.ended && !active && self.simulator.unread() == 0 && self.kept.is_none() {
                // The writer ends when the last answer has been written and its sender is gone.
                return Ok(());
            }
            self.unread.store(self.simulator.unread(), Ordering::Relaxed);
            let happened = match self.speed {
                Speed::Max if active => receiver.try_recv().ok(),
                _ => match receiver.recv_timeout(if active || self.kept.is_some() { BUSY } else { QUIET }) {
                    Ok(happened) => Some(happened),
                    Err(RecvTimeoutError::Timeout) => None,
                    Err(RecvTimeoutError::Disconnected) if self.ended => {
                        thread::sleep(BUSY);
                        None
                    }
                    Err(RecvTimeoutError::Disconnected) => return Ok(()),
                },
            };
            // What came is dated with the time at which it came.
            self.pass_time();
            match happened {
                None => {}
                Some(Happened::Connected(client)) => self.connected(client),
                Some(Happened::Bytes(bytes)) => self.simulator.send(bytes),
                Some(Happened::Disconnected) => self.leaving = true,
                Some(Happened::Left) => self.left(),
                Some(Happened::Ended) => self.ended = true,
                Some(Happened::Pins(line, reply)) => {
                    let answer = self.simulator.pin_line(&line);
                    // A client that has gone in the meantime needs no answer.
                    let _ = reply.send(answer);
                }
            }
        }
    }

    fn connected(&mut self, client: SyncSender<Vec<u8>>) {
        self.client = Some(client);
        self.kept = None;
        self.leaving = false;
        // What was said to nobody is lost, as on a port that nobody has open.
        self.simulator.take_output();
        if self.reset_on_connect {
            self.simulator.send([0x18]);
        } else {
            self.simulator.connect();
        }
    }

    fn left(&mut self) {
        self.client = None;
        self.kept = None;
        self.leaving = false;
        self.simulator.disconnect();
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

    fn answer(&mut self) {
        let Some(client) = &self.client else {
            // Nobody listens.
            self.simulator.take_output();
            return;
        };
        loop {
            let answer = match self.kept.take() {
                Some(answer) => answer,
                None if self.simulator.unfetched() > 0 => self.simulator.take_output().into_bytes(),
                None => break,
            };
            match client.try_send(answer) {
                Ok(()) => {}
                Err(TrySendError::Full(answer)) => {
                    self.kept = Some(answer);
                    return;
                }
                // It takes no answers any more.
                Err(TrySendError::Disconnected(_)) => return self.left(),
            }
        }
        if self.leaving && !self.simulator.is_active() && self.simulator.unread() == 0 {
            self.client = None;
        }
    }
}

fn wait_for_room(unread: &Gauge) {
    while unread.load(Ordering::Relaxed) >= UNREAD {
        thread::sleep(BUSY);
    }
}

/// Reads until the other side is done or gone. `false` if the loop has ended.
fn pass_bytes(reader: &mut impl Read, sender: &SyncSender<Happened>, unread: &Gauge) -> bool {
    let mut buffer = [0; PIECE];
    loop {
        wait_for_room(unread);
        match reader.read(&mut buffer) {
            Ok(0) => return true,
            Ok(length) => {
                if sender.send(Happened::Bytes(buffer[..length].to_vec())).is_err() {
                    return false;
                }
            }
            Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
            Err(_) => return true,
        }
    }
}

/// A thread that writes answers until nobody can give it any, or nobody takes them.
fn writer(mut link: impl Write + Send + 'static) -> (SyncSender<Vec<u8>>, thread::JoinHandle<()>) {
    let (sender, receiver) = sync_channel::<Vec<u8>>(ANSWERS);
    let handle = thread::spawn(move || {
        while let Ok(bytes) = receiver.recv() {
            if link.write_all(&bytes).and_then(|()| link.flush()).is_err() {
                return;
            }
        }
    });
    (sender, handle)
}

fn serve_tcp(listener: &TcpListener, sender: &SyncSender<Happened>, unread: &Gauge) {
    for stream in listener.incoming() {
        let Ok(mut stream) = stream else { continue };
        // Answers are short and each is waited for.
        let _ = stream.set_nodelay(true);
        let Ok(back) = stream.try_clone() else { continue };
        let (client, _) = writer(back);
        if sender.send(Happened::Connected(client)).is_err() || !pass_bytes(&mut stream, sender, unread) {
            return;
        }
        // It may have closed its side only and still wait for answers; the next client does not wait for that.
        if sender.send(Happened::Disconnected).is_err() {
            return;
        }
    }
}

fn serve_stdio(client: SyncSender<Vec<u8>>, sender: &SyncSender<Happened>, unread: &Gauge) {
    if sender.send(Happened::Connected(client)).is_ok() && pass_bytes(&mut io::stdin().lock(), sender, unread) {
        let _ = sender.send(Happened::Ended);
    }
}

fn serve_pins(listener: &TcpListener, sender: &SyncSender<Happened>) {
    for stream in listener.incoming() {
        let Ok(stream) = stream else { continue };
        let sender = sender.clone();
        thread::spawn(move || serve_pin_client(&stream, &sender));
    }
}

fn serve_pin_client(stream: &std::net::TcpStream, sender: &SyncSender<Happened>) {
    let mut back = stream;
    let (reply, answers) = channel();
    for line in BufReader::new(stream).lines() {
        let Ok(line) = line else { return };
        if line.trim().is_empty() {
            continue;
        }
        if sender.send(Happened::Pins(line, reply.clone())).is_err() {
            return;
        }
        let Ok(answer) = answers.recv() else { return };
        if back.write_all(format!("{answer}\n").as_bytes()).is_err() {
            return;
        }
    }
}

#[cfg(unix)]
mod pty {
    //! A pseudo terminal that a sender opens like a serial port.

    use super::{Gauge, Happened, PIECE, wait_for_room, writer};
    use anyhow::{Context, Result, bail};
    use nix::poll::{PollFd, PollFlags, PollTimeout, poll};
    use nix::pty::openpty;
    use nix::sys::termios::{SetArg, cfmakeraw, tcgetattr, tcsetattr};
    use std::fs::{self, File};
    use std::io::{self, Read, Write};
    use std::os::fd::AsFd;
    use std::path::Path;
    use std::sync::mpsc::SyncSender;
    use std::thread;
    use std::time::Duration;

    /// How often a port that nobody has open is looked at.
    const CLOSED: Duration = Duration::from_millis(2);

    pub fn open(link: Option<&Path>, sender: SyncSender<Happened>, unread: Gauge) -> Result<()> {
        let ends = openpty(None, None).context("cannot make a pseudo terminal")?;
        let path = nix::unistd::ttyname(&ends.slave).context("the pseudo terminal has no name")?;
        let master = File::from(ends.master);
        make_raw(&master).context("cannot set up the pseudo terminal")?;
        // Once nobody has the other end open, the first client to open it can be noticed.
        drop(ends.slave);
        if let Some(link) = link {
            match fs::symlink_metadata(link) {
                Ok(old) if old.file_type().is_symlink() => fs::remove_file(link)?,
                Ok(_) => bail!("{} is there already and is no symbolic link", link.display()),
                Err(_) => {}
            }
            std::os::unix::fs::symlink(&path, link)
                .with_context(|| format!("cannot make the link {}", link.display()))?;
        }
        println!("pty {}", path.display());
        io::stdout().flush()?;
        thread::spawn(move || serve(&master, &sender, &unread));
        Ok(())
    }

    /// No echo, no line editing, no translation: bytes as they are.
    fn make_raw(master: &File) -> nix::Result<()> {
        let mut terminal = tcgetattr(master)?;
        cfmakeraw(&mut terminal);
        tcsetattr(master, SetArg::TCSANOW, &terminal)
    }

    fn serve(mut master: &File, sender: &SyncSender<Happened>, unread: &Gauge) {
        let mut buffer = [0; PIECE];
        let mut open = false;
        loop {
            let mut look = [PollFd::new(master.as_fd(), PollFlags::POLLIN)];
            let timeout = PollTimeout::from(50_u8);
            let seen = match poll(&mut look, timeout) {
                Ok(_) => look[0].revents().unwrap_or(PollFlags::empty()),
                Err(_) => PollFlags::empty(),
            };
            let hung_up = seen.contains(PollFlags::POLLHUP);
            if !hung_up && !open {
                open = true;
                let Ok(back) = master.try_clone() else { return };
                let _ = make_raw(master);
                if sender.send(Happened::Connected(writer(back).0)).is_err() {
                    return;
                }
            }
            if seen.contains(PollFlags::POLLIN) {
                wait_for_room(unread);
                if let Ok(length @ 1..) = master.read(&mut buffer)
                    && sender.send(Happened::Bytes(buffer[..length].to_vec())).is_err()
                {
                    return;
                }
            } else if hung_up {
                if open && sender.send(Happened::Left).is_err() {
                    return;
                }
                open = false;
                thread::sleep(CLOSED);
            }
        }
    }
}
