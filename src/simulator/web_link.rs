//! `serve --web`: serves the page over HTTP and carries the machine's bytes over a WebSocket, on the loopback only.
//!
//! Any web site that the user visits can send requests to ports of this computer. Two headers distinguish these
//! requests from those of the served page, because a browser sets the headers truthfully and lets no page change them.
//! A request is answered only if `Host` names the loopback, because the name of another site may resolve to this
//! computer. The machine is connected only if `Origin` is the served page.

use crate::clients::{Connection, ENDLESS, Happened, Inbox, Incoming, Places, Taken, hung_up};
use crate::tcp_link::connections;
use anyhow::{Context, Result, ensure};
use std::io::{self, ErrorKind, Read, Write};
use std::net::{Ipv4Addr, TcpListener, TcpStream};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::mpsc::{Receiver, SyncSender, TryRecvError};
use std::thread;
use std::time::{Duration, Instant};
use tungstenite::handshake::server::{Request, Response};
use tungstenite::protocol::WebSocketConfig;
use tungstenite::{Message, WebSocket};

/// Maximum time for a request to arrive.
const REQUEST_TIME: Duration = Duration::from_secs(5);
/// Maximum size of a request's head, in bytes.
const REQUEST: usize = 1 << 14;
/// Interval at which the thread checks for replies while the page sends nothing.
const LOOK: Duration = Duration::from_millis(3);
/// Maximum time for which a thread waits for a page that does not read.
const PATIENCE: Duration = Duration::from_secs(5);
/// Maximum length of a message of the page, in bytes; the page sends a line at a time.
const MESSAGE: usize = 1 << 16;
/// Path of the machine's WebSocket.
const DEVICE: &str = "/machine";
/// Text in the built page: the part of the content security policy that forbids all connections. In the served page, a
/// part that allows the WebSocket replaces it.
const POLICY: &str = "connect-src 'none'";
/// Text in the built page. In the served page, a `meta` element with the path of the machine's WebSocket follows it.
const MARK: &str = "<meta charset=\"utf-8\">";

/// The page that is served.
pub struct Site {
    html: Vec<u8>,
    /// Accepted values of `Host`: `127.0.0.1` and `localhost`, each with the port. If the port is 80, the names
    /// without the port are accepted, too, because browsers omit this port.
    hosts: Vec<String>,
}

impl Site {
    /// Opens the port on the loopback and reads the page from the file `page`. Without `page`, reads `oxmill.html`
    /// beside this program, or else the file that `cargo xtask web` has written.
    pub fn open(port: u16, page: Option<&Path>) -> Result<(TcpListener, Self)> {
        let path = page.map_or_else(usual_page, |path| Ok(path.to_owned()))?;
        let text =
            std::fs::read_to_string(&path).with_context(|| format!("cannot read the page {}", path.display()))?;
        ensure!(text.contains(POLICY) && text.contains(MARK), "{} is not the page of Oxmill", path.display());
        let listener = TcpListener::bind((Ipv4Addr::LOCALHOST, port))
            .with_context(|| format!("cannot listen on port {port} of the loopback"))?;
        let port = listener.local_addr()?.port();
        let hosts = names(port);
        let policy: String = hosts.iter().map(|host| format!(" ws://{host}")).collect();
        let mark = format!("{MARK}<meta name=\"oxmill-machine\" content=\"{DEVICE}\">");
        let html = text.replacen(POLICY, &format!("connect-src{policy}"), 1).replacen(MARK, &mark, 1).into_bytes();
        Ok((listener, Self { html, hosts }))
    }

    /// Returns the URL of the page, such as `http://127.0.0.1:8080/`.
    pub fn address(&self) -> String {
        format!("http://{}/", self.hosts[0])
    }

    fn is_here(&self, host: Option<&str>) -> bool {
        host.is_some_and(|host| self.hosts.iter().any(|known| known == host))
    }

    fn is_own(&self, origin: Option<&str>) -> bool {
        self.is_here(origin.and_then(|origin| origin.strip_prefix("http://")))
    }
}

/// Returns the names of this computer that a browser sends if the page is at `port`: in `Host`, and after `http://` in
/// `Origin`.
fn names(port: u16) -> Vec<String> {
    const NAMES: [&str; 2] = ["127.0.0.1", "localhost"];
    let bare = NAMES.iter().filter(|_| port == 80).map(|name| (*name).to_owned());
    NAMES.iter().map(|name| format!("{name}:{port}")).chain(bare).collect()
}

fn usual_page() -> Result<PathBuf> {
    const NAME: &str = "oxmill.html";
    let beside = std::env::current_exe().ok().and_then(|program| Some(program.parent()?.join(NAME)));
    let built = Path::new("target/web").join(NAME);
    let found = beside.into_iter().chain([built]).find(|path| path.is_file());
    found.context(
        "there is no page: put oxmill.html, which each release has, beside this program, or name it with --page FILE; \
         from the sources `cargo xtask web` makes it",
    )
}

/// Serves browsers, each in a thread of its own.
pub fn serve_web(listener: &TcpListener, site: &Arc<Site>, sender: &SyncSender<Happened>) {
    let places = Places::default();
    for stream in connections(listener) {
        let Some(place) = places.take() else { continue };
        let (site, sender) = (site.clone(), sender.clone());
        // Ignore the error: a browser with an invalid request gets no reply, and nothing else depends on it.
        thread::spawn(move || answer(stream, place, &site, &sender));
    }
}

fn answer(stream: TcpStream, place: Taken, site: &Site, sender: &SyncSender<Happened>) -> io::Result<()> {
    stream.set_read_timeout(Some(REQUEST_TIME))?;
    stream.set_write_timeout(Some(REQUEST_TIME))?;
    let request = look_at_request(&stream)?;
    let header = |name: &str| {
        let mut lines = request.lines().skip(1).filter_map(|line| line.split_once(':'));
        lines.find(|(key, _)| key.eq_ignore_ascii_case(name)).map(|(_, value)| value.trim())
    };
    let target = request.split(' ').nth(1).unwrap_or_default();
    let wants_socket = header("upgrade").is_some_and(|value| value.eq_ignore_ascii_case("websocket"));
    let allowed = site.is_here(header("host")) && (!wants_socket || site.is_own(header("origin")));
    if !allowed {
        return reply(stream, &request, "403 Forbidden", b"Another page may not drive this machine.\n");
    }
    match (target, wants_socket) {
        (DEVICE, true) => {
            #[allow(clippy::result_large_err, reason = "what the library wants")]
            let accept = |_: &Request, response: Response| Ok(response);
            let bounds = WebSocketConfig::default().max_message_size(Some(MESSAGE)).max_frame_size(Some(MESSAGE));
            if let Ok(socket) = tungstenite::accept_hdr_with_config(stream, accept, Some(bounds)) {
                let incoming = Incoming { link: Connection::Page(Box::new(socket)), place };
                let _ = sender.send(Happened::Connecting(incoming, sender.clone()));
            }
            Ok(())
        }
        ("/", false) if request.starts_with("GET ") => reply(stream, &request, "200 OK", &site.html),
        _ => reply(stream, &request, "404 Not Found", b"There is nothing here.\n"),
    }
}

/// Returns the head of a request without consuming it. Each byte becomes a character, because other programs on this
/// host can have set cookies in any encoding.
fn look_at_request(stream: &TcpStream) -> io::Result<String> {
    let end = Instant::now() + REQUEST_TIME;
    let mut buffer = vec![0; REQUEST];
    loop {
        let length = stream.peek(&mut buffer)?;
        let text: String = buffer[..length].iter().copied().map(char::from).collect();
        if let Some((head, _)) = text.split_once("\r\n\r\n") {
            return Ok(head.to_owned());
        }
        if length == 0 || length == REQUEST || Instant::now() > end {
            return Err(ErrorKind::InvalidData.into());
        }
        thread::sleep(LOOK);
    }
}

fn reply(mut stream: TcpStream, request: &str, status: &str, body: &[u8]) -> io::Result<()> {
    // Read the request first: closing a socket with unread bytes in it would discard the reply.
    stream.read_exact(&mut vec![0; request.chars().count() + 4])?;
    let kind = if status.starts_with("200") { "text/html" } else { "text/plain" };
    let head = format!(
        "HTTP/1.1 {status}\r\nContent-Type: {kind}; charset=utf-8\r\nContent-Length: {}\r\nCache-Control: no-store\r\n\
         X-Content-Type-Options: nosniff\r\nX-Frame-Options: DENY\r\nConnection: close\r\n\r\n",
        body.len()
    );
    stream.write_all(head.as_bytes())?;
    stream.write_all(body)
}

/// Carries bytes between a page and the loop that runs the simulator, until one of them has ended.
pub fn pass_messages(
    mut socket: WebSocket<TcpStream>,
    inbox: &Inbox,
    answers: &Receiver<Vec<u8>>,
    sender: &SyncSender<Happened>,
) {
    let _ = carry(&mut socket, inbox, answers, sender);
    inbox.end();
    // Ignore the error: it occurs only if the loop that receives these events has ended.
    let _ = sender.send(Happened::Heard);
    if inbox.is_endless() {
        let _ = socket.send(Message::binary(ENDLESS.to_vec()));
    }
    let _ = socket.close(None);
    let _ = socket.flush();
}

fn carry(
    socket: &mut WebSocket<TcpStream>,
    inbox: &Inbox,
    answers: &Receiver<Vec<u8>>,
    sender: &SyncSender<Happened>,
) -> tungstenite::Result<()> {
    socket.get_ref().set_read_timeout(Some(LOOK))?;
    socket.get_ref().set_write_timeout(Some(PATIENCE))?;
    loop {
        loop {
            match answers.try_recv() {
                Ok(bytes) => socket.write(Message::binary(bytes))?,
                Err(TryRecvError::Empty) => break,
                Err(TryRecvError::Disconnected) => return socket.flush(),
            }
        }
        socket.flush()?;
        if !inbox.wait_for_room(|| hung_up(socket.get_ref())) {
            return Ok(());
        }
        match socket.read() {
            Ok(Message::Binary(bytes)) => {
                inbox.push(&bytes);
                // If the loop's channel is full, the loop has work to do and looks into the inbox anyway.
                let _ = sender.try_send(Happened::Heard);
            }
            Ok(Message::Close(_)) => return Ok(()),
            Ok(_) => {}
            Err(tungstenite::Error::Io(error))
                if matches!(error.kind(), ErrorKind::WouldBlock | ErrorKind::TimedOut) => {}
            Err(error) => return Err(error),
        }
    }
}

/// Tells a second page why it is not served.
pub fn turn_away(mut socket: WebSocket<TcpStream>, why: &[u8]) {
    let _ = socket.get_ref().set_write_timeout(Some(PATIENCE));
    let _ = socket.send(Message::binary(why.to_vec()));
    let _ = socket.close(None);
    // Wait until the browser has closed its side, at most `PATIENCE`.
    let end = Instant::now() + PATIENCE;
    while Instant::now() < end && socket.read().is_ok() {}
}

#[cfg(test)]
mod tests {
    use super::names;

    #[test]
    fn browsers_leave_port_80_out() {
        assert_eq!(names(8080), ["127.0.0.1:8080", "localhost:8080"]);
        assert_eq!(names(80), ["127.0.0.1:80", "localhost:80", "127.0.0.1", "localhost"]);
    }
}
