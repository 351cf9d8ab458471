//! TCP connections of `oxmill serve`: programs that control the machine (`--tcp`) and clients that set its input pins
//! (`--pins`). Time-outs and keep-alive end the connections of clients that have vanished or do not read.

use crate::clients::{Connection, ENDLESS, Happened, Incoming, LOOK, PIECE, Places};
use crate::files::eprint_line;
use crate::no_browser::NoBrowser;
use anyhow::{Context, Result};
use socket2::{SockRef, TcpKeepalive};
use std::io::{self, BufRead, BufReader, Read, Write};
use std::net::{Shutdown, TcpListener, TcpStream};
use std::sync::mpsc::{SyncSender, channel};
use std::thread;
use std::time::{Duration, Instant};

/// Sent to a client if all connections are in use.
const CROWDED: &[u8] = b"[MSG:Too many connections]\r\n";
/// Maximum time for which the bytes of a rejected client are read and discarded. If the socket were closed with unread
/// bytes in it, the client might not get the reason.
const CLOSING_TIME: Duration = Duration::from_secs(1);
/// Idle time after which TCP starts to probe whether the client still exists (keep-alive). With the interval
/// [`QUESTIONS`], a client whose cable was pulled releases the machine after a minute or two.
const SILENCE: Duration = Duration::from_secs(20);
/// Time between keep-alive probes.
const QUESTIONS: Duration = Duration::from_secs(5);
/// Time after which a connection is closed if the client's system does not acknowledge a reply or has no room for it.
#[cfg(target_os = "linux")]
const UNACKNOWLEDGED: Duration = Duration::from_secs(60);

/// Sets the time-outs and keep-alive of a client's connection. `unread`: maximum time for which a write blocks if the
/// client does not read.
pub(crate) fn set_up(stream: &TcpStream, unread: Duration) -> io::Result<()> {
    // Send small packets at once: replies are short, and the client waits for each.
    stream.set_nodelay(true)?;
    stream.set_write_timeout(Some(unread))?;
    let socket = SockRef::from(stream);
    // While a reply is unacknowledged, TCP sends no keep-alive probes. It would retransmit the reply for a quarter of
    // an hour instead. So limit this time.
    #[cfg(target_os = "linux")]
    socket.set_tcp_user_timeout(Some(UNACKNOWLEDGED))?;
    socket.set_tcp_keepalive(&TcpKeepalive::new().with_time(SILENCE).with_interval(QUESTIONS))
}

/// Maximum length of a line of the pin protocol, in bytes.
const PIN_LINE: u64 = 256;
/// Maximum time until a pin client has sent its first line.
const FIRST_LINE: Duration = Duration::from_secs(60);
/// Maximum time for which writing a reply blocks if a pin client does not read and its buffers are full.
const UNREAD: Duration = Duration::from_secs(5);
/// Socket buffer sizes for the lines and the replies of a pin client, in bytes.
const PIN_BUFFER: usize = 1 << 14;

/// Listens on an address such as `192.168.1.5:7000`. A port alone (`7000` or `:7000`) means the loopback, which only
/// programs on this computer can reach. Warns if other computers can connect.
pub(crate) fn listen(address: &str) -> Result<TcpListener> {
    let port = address.strip_prefix(':').unwrap_or(address).parse::<u16>();
    let address = port.map_or_else(|_| address.to_owned(), |port| format!("127.0.0.1:{port}"));
    let listener = TcpListener::bind(&address).with_context(|| format!("cannot listen on {address}"))?;
    let address = listener.local_addr()?;
    if !address.ip().is_loopback() {
        eprint_line(&format!("oxmill: {address} is open to other computers: whoever reaches it moves this machine"));
    }
    Ok(listener)
}

/// Tells a client why it is not served, or not served any more. Discards its input.
pub(crate) fn turn_away(mut stream: &TcpStream, why: &[u8]) {
    let end = Instant::now() + CLOSING_TIME;
    let _ = stream.set_write_timeout(Some(CLOSING_TIME));
    let _ = stream.set_read_timeout(Some(CLOSING_TIME));
    let sent = stream.write_all(why).and_then(|()| stream.shutdown(Shutdown::Write));
    // Closing a socket with unread bytes in it would discard the message, so read them first.
    let mut thrown_away = [0; PIECE];
    while sent.is_ok() && Instant::now() < end && stream.read(&mut thrown_away).is_ok_and(|length| length > 0) {}
}

/// Tells a client that all connections are in use, without waiting for it.
pub(crate) fn refuse(mut stream: &TcpStream) {
    let sent = stream.set_nonblocking(true).and_then(|()| stream.write_all(CROWDED));
    let sent = sent.and_then(|()| stream.shutdown(Shutdown::Write));
    // Closing a socket with unread bytes in it would discard the message, so read them first.
    let _ = sent.and_then(|()| stream.read(&mut [0; PIECE]));
}

/// Returns incoming connections. Retries after a pause if the system cannot accept one.
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
            // Ignore the error: it only ends the connection of this client.
            let _ = serve_pin_client(&stream, &sender);
            drop(place);
        });
    }
}

fn serve_pin_client(stream: &TcpStream, sender: &SyncSender<Happened>) -> io::Result<()> {
    // A client that has vanished or does not read occupies a slot and memory: limit the time and the buffers.
    set_up(stream, UNREAD)?;
    let socket = SockRef::from(stream);
    socket.set_send_buffer_size(PIN_BUFFER)?;
    socket.set_recv_buffer_size(PIN_BUFFER)?;
    let mut back = stream;
    let (reply, answers) = channel();
    let mut reader = BufReader::new(NoBrowser::new(stream));
    // The first line must come soon, so that a client that sends nothing does not occupy a slot. After that, there is
    // no limit, because a test bench can be silent for hours.
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
