//! `serve --tcp` and `--pins`: accepts TCP connections, serves one client of the machine and some pin clients, and
//! turns the others away. Time-outs and keep-alive end connections of clients that are gone or do not read.

use crate::clients::{Connection, ENDLESS, Happened, Incoming, LOOK, PIECE, Places};
use crate::files::remark;
use crate::no_browser::NoBrowser;
use anyhow::{Context, Result};
use socket2::{SockRef, TcpKeepalive};
use std::io::{self, BufRead, BufReader, Read, Write};
use std::net::{Shutdown, TcpListener, TcpStream};
use std::sync::mpsc::{SyncSender, channel};
use std::thread;
use std::time::{Duration, Instant};

/// What is said to a client for whom there is no place, and how long one that is turned away is listened to at most, so that it can read why.
const CROWDED: &[u8] = b"[MSG:Too many connections]\r\n";
const CLOSING_TIME: Duration = Duration::from_secs(1);
/// How long a client of another computer may be silent until its system is asked for a sign of life, and the time between
/// such questions: one whose cable has been pulled leaves the machine to others after a minute or two.
const SILENCE: Duration = Duration::from_secs(20);
const QUESTIONS: Duration = Duration::from_secs(5);
/// How long its system may leave an answer unacknowledged, or have no room for it.
#[cfg(target_os = "linux")]
const UNACKNOWLEDGED: Duration = Duration::from_secs(60);

/// A client that does not read holds its writer for that time at most.
pub(crate) fn set_up(stream: &TcpStream, unread: Duration) -> io::Result<()> {
    // Answers are short and each is waited for.
    stream.set_nodelay(true)?;
    stream.set_write_timeout(Some(unread))?;
    let socket = SockRef::from(stream);
    // While an answer is under way no sign of life is asked for, and the system would repeat it for a quarter of an hour.
    #[cfg(target_os = "linux")]
    socket.set_tcp_user_timeout(Some(UNACKNOWLEDGED))?;
    socket.set_tcp_keepalive(&TcpKeepalive::new().with_time(SILENCE).with_interval(QUESTIONS))
}

/// Longest line of the pin protocol, bytes.
const PIN_LINE: u64 = 256;
/// How long a client of that protocol may take for its first line.
const FIRST_LINE: Duration = Duration::from_secs(60);
/// How long it may leave answers unread when there is no room for another one.
const UNREAD: Duration = Duration::from_secs(5);
/// Room of the system for the lines of such a client, and for its answers, bytes.
const PIN_BUFFER: usize = 1 << 14;

/// A port alone, or with a colon before it, is one of the loopback. Says so if others than this computer can connect.
pub(crate) fn listen(address: &str) -> Result<TcpListener> {
    let port = address.strip_prefix(':').unwrap_or(address).parse::<u16>();
    let address = port.map_or_else(|_| address.to_owned(), |port| format!("127.0.0.1:{port}"));
    let listener = TcpListener::bind(&address).with_context(|| format!("cannot listen on {address}"))?;
    let address = listener.local_addr()?;
    if !address.ip().is_loopback() {
        remark(&format!("oxmill: {address} is open to other computers: whoever reaches it moves this machine"));
    }
    Ok(listener)
}

/// Tells a client why it is served no more, or never. Nothing of what it says then is looked at.
pub(crate) fn turn_away(mut stream: &TcpStream, why: &[u8]) {
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

pub(crate) fn serve_tcp(listener: &TcpListener, sender: &SyncSender<Happened>) {
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

pub(crate) fn serve_pins(listener: &TcpListener, sender: &SyncSender<Happened>) {
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
