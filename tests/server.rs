//! Tests `serve` with its clients, by running the program: which clients are served, and what remains after one has
//! disconnected.

use std::io::{BufRead, BufReader, ErrorKind, Read, Write};
use std::net::{Shutdown, TcpStream};
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

/// Maximum time for an answer, even on a slow computer.
const PATIENCE: Duration = Duration::from_secs(20);
const WELCOME: &str = "Grbl 1.1h ['$' for help]";
const BUSY: &str = "[MSG:Another host has the machine]\r\n";

/// Requests the page of `serve --web` with handwritten HTTP. Some requests are those of a browser that shows this
/// page, others are requests that pages of other sites would make.
#[test]
fn a_page_is_served_to_this_computer_only() {
    let page = Path::new(env!("CARGO_TARGET_TMPDIR")).join("page.html");
    let html = "<meta charset=\"utf-8\"><meta content=\"connect-src 'none'\">";
    std::fs::write(&page, html).expect("a file can be written");
    let options = ["serve", "--web", "0", "--page", page.to_str().expect("a path")];
    let server = Server::started(&options, "web http://");
    let address = server.address.trim_end_matches('/');
    let port = address.strip_prefix("127.0.0.1:").expect("the loopback");
    let ask = |target: &str, host: &str, more: &str| {
        let mut stream = TcpStream::connect(address).expect("it listens");
        stream.set_read_timeout(Some(PATIENCE)).expect("a socket");
        write!(stream, "GET {target} HTTP/1.1\r\nHost: {host}\r\n{more}\r\n").expect("it reads");
        let mut answer = vec![0; 4096];
        let mut length = 0;
        while !answer[..length].windows(4).any(|end| end == b"\r\n\r\n") || more.is_empty() {
            match stream.read(&mut answer[length..]).expect("an answer") {
                0 => break,
                read => length += read,
            }
        }
        String::from_utf8_lossy(&answer[..length]).into_owned()
    };
    let served = ask("/", address, "");
    assert!(served.starts_with("HTTP/1.1 200 "), "{served}");
    assert!(served.contains(&format!("connect-src ws://{address} ws://localhost:{port}")), "{served}");
    assert!(served.contains("name=\"oxmill-machine\" content=\"/machine\""), "{served}");
    assert!(ask("/x", address, "").starts_with("HTTP/1.1 404 "));
    // Another program on this host can have set a cookie that is not UTF-8.
    let mut stream = TcpStream::connect(address).expect("it listens");
    stream.set_read_timeout(Some(PATIENCE)).expect("a socket");
    let request = [b"GET /x HTTP/1.1\r\nHost: ", address.as_bytes(), b"\r\nCookie: name=Andr\xE9\r\n\r\n"].concat();
    stream.write_all(&request).expect("it reads");
    let mut answer = Vec::new();
    stream.read_to_end(&mut answer).expect("an answer");
    assert!(answer.starts_with(b"HTTP/1.1 404 "), "{}", String::from_utf8_lossy(&answer));
    assert!(ask("/", "evil.example", "").starts_with("HTTP/1.1 403 "));
    let socket = |origin: &str| {
        let more = format!(
            "Connection: Upgrade\r\nUpgrade: websocket\r\nSec-WebSocket-Version: 13\r\n\
             Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\n{origin}"
        );
        ask("/machine", address, &more)
    };
    assert!(socket(&format!("Origin: http://{address}\r\n")).starts_with("HTTP/1.1 101 "));
    // A WebSocket handshake with the same cookie.
    let key = "Connection: Upgrade\r\nUpgrade: websocket\r\nSec-WebSocket-Version: 13\r\nSec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==";
    let head =
        format!("GET /machine HTTP/1.1\r\nHost: {address}\r\nOrigin: http://{address}\r\n{key}\r\nCookie: name=Andr");
    assert!(answer_to(address, &[head.as_bytes(), b"\xE9\r\n\r\n"].concat()).starts_with("HTTP/1.1 101 "));
    // A head that is too long, incomplete or malformed gets no answer or a 403.
    let long = format!("GET / HTTP/1.1\r\nHost: {address}\r\nX: {}", "x".repeat(1 << 15));
    for request in [long.as_bytes(), b"GET / HTTP/1.1\r\n", b"\r\n\r\n"] {
        let answer = answer_to(address, request);
        assert!(answer.is_empty() || answer.starts_with("HTTP/1.1 403 "), "{answer}");
    }
    for origin in ["", "Origin: null\r\n", "Origin: http://evil.example\r\n", &format!("Origin: https://{address}\r\n")]
    {
        assert!(socket(origin).starts_with("HTTP/1.1 403 "), "{origin}");
    }
}

/// Returns the first bytes of the answer; empty if the connection is closed without an answer.
fn answer_to(address: &str, request: &[u8]) -> String {
    let mut stream = TcpStream::connect(address).expect("it listens");
    stream.set_read_timeout(Some(PATIENCE)).expect("a socket");
    stream.write_all(request).expect("it reads");
    let mut answer = [0; 4096];
    // If the server closes a connection before it has read all bytes, the system resets the connection.
    let length = match stream.read(&mut answer) {
        Err(error) if error.kind() == ErrorKind::ConnectionReset => 0,
        read => read.expect("an answer, or an end, in time"),
    };
    String::from_utf8_lossy(&answer[..length]).into_owned()
}

/// Head of a request that any web page can make a browser send to a port of this computer. The tests append lines for
/// the machine as the body.
const REQUEST: &str = "POST / HTTP/1.1\r\nHost: 127.0.0.1\r\nContent-Type: text/plain\r\n\r\n";

#[test]
fn a_web_page_moves_nothing_on_a_port_of_lines() {
    let server = Server::new(&[]);
    for request in [
        format!("{REQUEST}G0 X9\n"),
        "OPTIONS / HTTP/1.1\r\n\r\nG0 X9\n".into(),
        "G0 / HTTP/1.1\r\n\r\nG0 X9\n".into(),
        "\x16\x03\x01\x02\nG0 X9\n".into(),
    ] {
        let mut browser = server.served();
        browser.send(&request);
        let mut said = String::new();
        match browser.lines.read_to_string(&mut said) {
            Err(error) => assert_eq!(error.kind(), ErrorKind::ConnectionReset),
            Ok(_) => assert_eq!(said, "", "nothing is answered"),
        }
        let mut host = server.served();
        assert!(host.wait_for("<Idle").contains("MPos:0.000,0.000,0.000"), "{request}");
    }
    // The first bytes of a line can also be those of an HTTP request. A line that arrives in two parts must still be
    // taken as a line.
    let mut host = server.served();
    host.send("G");
    std::thread::sleep(Duration::from_millis(50));
    host.send("0 X1\n");
    assert_eq!(host.line(), "ok");
    assert!(host.wait_for("<Idle").contains("MPos:1.000,0.000,0.000"));
}

#[test]
fn a_web_page_moves_no_pin() {
    let (_server, pins) = Server::with_pins();
    assert_eq!(answer_to(&pins, b"door 1\n"), "ok\n");
    assert_eq!(answer_to(&pins, format!("{REQUEST}door 0\n").as_bytes()), "");
}

/// A line that is never ended is refused and moves no pin, whether it follows complete lines or is the first line of a
/// client.
#[test]
fn a_line_without_an_end_moves_no_pin_and_is_refused() {
    let (_server, pins) = Server::with_pins();
    for before in ["", "door 1\n"] {
        let mut client = Client::of(&pins);
        client.send(before);
        client.send([b'x'; 257]);
        let answer = if before.is_empty() { String::new() } else { client.line() };
        assert_eq!(answer, before.replace("door 1\n", "ok"));
        let mut rest = String::new();
        client.lines.read_to_string(&mut rest).expect("it is closed");
        assert_eq!(rest, "[MSG:The line has no end]\r\n");
    }
    // The longest line that is accepted.
    let mut client = Client::of(&pins);
    assert_eq!(client.ask(&format!("{:255}", "door 1")), "ok");
}

#[test]
fn a_port_that_is_open_to_others_says_so() {
    let (_server, said) = Server::with_words(&["serve", "--tcp", "0.0.0.0:0", "--pins", "0.0.0.0:0"], 3);
    let warnings = said.iter().filter(|line| line.contains("is open to other computers")).count();
    assert_eq!(warnings, 2, "{said:?}");
}

/// Returns the numbers of threads and open files of a program.
#[cfg(target_os = "linux")]
fn held(program: &Child) -> [usize; 2] {
    let count = |of: &str| std::fs::read_dir(format!("/proc/{}/{of}", program.id())).map_or(0, Iterator::count);
    [count("task"), count("fd")]
}

/// Returns the numbers of the kernel timers that run for the server's side of a connection. `02` is the keep-alive
/// timer.
#[cfg(target_os = "linux")]
fn timers(client: &Client) -> Vec<String> {
    let port = |address: std::net::SocketAddr| format!(":{:04X}", address.port());
    let (here, there) = (client.stream.peer_addr().expect("a socket"), client.stream.local_addr().expect("a socket"));
    let sockets = std::fs::read_to_string("/proc/net/tcp").expect("Linux");
    // Columns of `/proc/net/tcp`: sl local_address rem_address st tx_queue:rx_queue tr:tm->when ..
    let mut timers: Vec<String> = sockets
        .lines()
        .map(|line| line.split_whitespace().collect::<Vec<_>>())
        .filter(|words| words.len() > 5 && words[1].ends_with(&port(here)) && words[2].ends_with(&port(there)))
        .map(|words| words[5].split(':').next().unwrap_or_default().to_owned())
        .collect();
    // If `/proc/net/tcp` changes while it is read, it can contain a line twice.
    timers.dedup();
    timers
}

/// If a client's cable is pulled, a server that waits for the client's bytes does not notice. So the kernel must send
/// keep-alive probes.
#[cfg(target_os = "linux")]
#[test]
fn a_client_that_is_cut_off_is_asked_for_signs_of_life() {
    let server = Server::new(&[]);
    assert_eq!(timers(&server.served()), ["02"]);
    let (_server, pins) = Server::with_pins();
    let mut client = Client::of(&pins);
    assert_eq!(client.ask("door 1"), "ok");
    // Until the acknowledgement of the answer has arrived, the connection can have another timer.
    let end = Instant::now() + PATIENCE;
    while timers(&client) != ["02"] {
        assert!(Instant::now() < end, "{:?}", timers(&client));
        std::thread::sleep(Duration::from_millis(20));
    }
}

#[cfg(target_os = "linux")]
#[test]
fn thousands_of_connections_leave_nothing_behind() {
    let page = Path::new(env!("CARGO_TARGET_TMPDIR")).join("many.html");
    std::fs::write(&page, "<meta charset=\"utf-8\"><meta content=\"connect-src 'none'\">").expect("a file");
    let web = ["serve", "--web", "0", "--page", page.to_str().expect("a path")];
    let (tcp, page, (pinned, pins)) = (Server::new(&[]), Server::started(&web, "web http://"), Server::with_pins());
    let (tcp_address, page_address) = (tcp.address.clone(), page.address.trim_end_matches('/').to_owned());
    // The last two ports start a thread for each connection. That takes 10 ms, so these ports get fewer connections.
    let ports = [(tcp, tcp_address, "", 3000), (page, page_address, "", 1000), (pinned, pins, "steps\n", 1000)];
    for (server, address, line, many) in ports {
        let address = address.as_str();
        // At the first connection the server starts the rest of its own threads. So count its threads only after a
        // first connection.
        answer_to(address, b"GET / HTTP/1.0\r\n\r\n");
        std::thread::sleep(Duration::from_millis(500));
        let before = held(&server.program);
        // Opens more idle connections than the server serves at once (64), so the last ones are closed.
        let idle: Vec<TcpStream> = (0..100).map(|_| TcpStream::connect(address).expect("it listens")).collect();
        std::thread::sleep(Duration::from_millis(200));
        let during = held(&server.program);
        assert!(during[0] < before[0] + 64 + 8, "{before:?} {during:?}");
        drop(idle);
        let memory = resident(&server.program);
        for number in 0..many {
            let mut stream = TcpStream::connect(address).expect("it listens");
            // Some clients leave at once, some while their line is carried out. The server can already have closed a
            // connection for which it has no place.
            if number % 3 > 0 {
                let _ = stream.write_all(line.as_bytes());
            }
        }
        let end = Instant::now() + PATIENCE;
        while held(&server.program).iter().zip(&before).any(|(now, before)| now > before) {
            assert!(Instant::now() < end, "{before:?} {:?}", held(&server.program));
            std::thread::sleep(Duration::from_millis(50));
        }
        // Growth by 4 MiB is allowed, because stacks of ended threads use some memory. So the test detects a leak of 4
        // KiB per connection, or of 1.4 KiB on the first port, which gets 3000 connections.
        assert!(resident(&server.program) < memory + 4096, "{memory} {}", resident(&server.program));
    }
}

/// Some clients of the pin port never read their answers. The server disconnects such clients in favour of others.
/// Until then, the memory of the server does not grow.
#[cfg(target_os = "linux")]
#[test]
fn clients_that_do_not_read_hold_no_place() {
    let (server, pins) = Server::with_pins();
    let mut before = Client::of(&pins);
    assert_eq!(before.ask("door 0"), "ok");
    let memory = resident(&server.program);
    // The server rejects this line with a long text, which fills the buffers sooner than `ok` would.
    let question = b"lamp 1\n".repeat(10_000);
    let mut unread: Vec<TcpStream> = (0..63).map(|_| TcpStream::connect(&pins).expect("it listens")).collect();
    for stream in &mut unread {
        stream.set_nonblocking(true).expect("a socket");
    }
    // Each client sends as much as the server accepts. The server reads from a client until it cannot write any more
    // answers to it.
    let (mut is_full, end) = (false, Instant::now() + PATIENCE);
    loop {
        for stream in &mut unread {
            let _ = stream.write(&question);
        }
        // Meanwhile the server still answers a client that reads.
        assert_eq!(before.ask("door 0"), "ok");
        assert!(resident(&server.program) < memory + 8192, "{memory} {}", resident(&server.program));
        let mut new = Client::of(&pins);
        // This write may fail, because the server can already have closed the connection of a rejected client.
        let _ = new.stream.write_all(b"door 1\n");
        let mut said = String::new();
        match new.lines.read_line(&mut said) {
            Ok(_) if said == "ok\n" => break,
            Ok(_) => assert_eq!(said, "[MSG:Too many connections]\r\n"),
            Err(error) => assert_eq!(error.kind(), ErrorKind::ConnectionReset),
        }
        is_full = true;
        assert!(Instant::now() < end, "places are left");
        std::thread::sleep(Duration::from_millis(50));
    }
    assert!(is_full, "no place was left meanwhile");
}

/// Returns a program's resident memory, KiB.
#[cfg(target_os = "linux")]
fn resident(program: &Child) -> u64 {
    let status = std::fs::read_to_string(format!("/proc/{}/status", program.id())).expect("it runs");
    let line = status.lines().find_map(|line| line.strip_prefix("VmRSS:")).expect("its memory");
    line.trim().trim_end_matches(" kB").parse().expect("a number")
}

/// An endless line is rejected. Neither the line nor a client that does not read makes the program's memory grow.
#[cfg(target_os = "linux")]
#[test]
fn no_client_makes_the_server_grow() {
    let server = Server::new(&[]);
    let mut client = server.served();
    assert_eq!(client.ask("G0X1"), "ok");
    client.wait_for("<Idle");
    let before = resident(&server.program);
    // Polls (`?`) do not count as parts of a line, however many there are.
    for _ in 0..100 {
        client.send([b'?'; 1000]);
    }
    assert!(client.line().starts_with('<'));
    drop(client);
    let mut endless = server.served();
    assert_eq!(endless.ask("G21"), "ok");
    let piece = [b'X'; 1 << 14];
    endless.stream.set_write_timeout(Some(PATIENCE)).expect("a socket");
    let end = Instant::now() + PATIENCE;
    while endless.stream.write_all(&piece).is_ok() {
        assert!(Instant::now() < end, "it is closed");
    }
    assert!(resident(&server.program) < before + 8192, "{before} {}", resident(&server.program));
    // If a line is too long, the server sends a message before it closes the connection.
    let mut short = server.served();
    assert_eq!(short.ask("G21"), "ok");
    short.send([b'X'; (1 << 16) + 2000]);
    assert_eq!(short.line(), "[MSG:The line has no end]");
    // A line without an end is also rejected if it is the first line of a client. In a first line the server looks for
    // the HTTP request of a browser.
    let mut first = server.served();
    first.send([b'X'; (1 << 16) + 2000]);
    assert_eq!(first.line(), "[MSG:The line has no end]");
    let mut deaf = server.served();
    deaf.stream.set_write_timeout(Some(Duration::from_millis(500))).expect("a socket");
    let questions = b"$$\n".repeat(5000);
    for _ in 0..4000 {
        if deaf.stream.write_all(&questions).is_err() {
            break;
        }
    }
    assert!(resident(&server.program) < before + 40_000, "{before} {}", resident(&server.program));
    drop(deaf);
    // The next client does not get answers to the previous client's lines.
    server.served();
}

/// A recording lists a change of a pin before the immediate effects of this change, such as an alarm or the end of
/// motion. So a replay makes the same steps.
#[test]
fn a_recording_with_alarms_of_pins_is_played_again() {
    let folder = std::env::temp_dir().join(format!("oxmill-pins-{}", std::process::id()));
    std::fs::create_dir_all(&folder).expect("a folder");
    for pin in ["estop", "fault", "limit x"] {
        let file = folder.join("a.rec");
        let path = file.to_str().expect("a name");
        let options = ["serve", "--tcp", "127.0.0.1:0", "--pins", "127.0.0.1:0", "--set", "$21=1", "--record", path];
        let (server, words) = Server::with_words(&options, 1);
        let pins = words[0].strip_prefix("pins on ").expect("an address").to_owned();
        assert_eq!(answer_to(&pins, format!("{pin} 1\n").as_bytes()), "ok\n");
        assert!(answer_to(&pins, b"steps\n").starts_with("steps "));
        let end = Instant::now() + PATIENCE;
        // The server records the position when it next checks the machine.
        while !std::fs::read_to_string(&file).is_ok_and(|text| text.contains(" at ")) {
            assert!(Instant::now() < end, "{pin} is recorded");
            std::thread::sleep(Duration::from_millis(20));
        }
        drop(server);
        let replay = Command::new(env!("CARGO_BIN_EXE_oxmill")).args(["replay", path]).output().expect("it runs");
        let said = String::from_utf8_lossy(&replay.stderr).into_owned();
        // Status 0 and 1 mean that the replay has the same steps. With status 1 the replay ends with an alarm.
        assert!(
            matches!(replay.status.code(), Some(0 | 1)),
            "{pin}: {said}{}",
            std::fs::read_to_string(&file).unwrap()
        );
    }
    std::fs::remove_dir_all(&folder).expect("it is there");
}

/// If a port is given without an address, the server opens it on the loopback only. This also holds for the port of
/// the pins. If 64 connections are open, the next connection gets a message and is closed.
#[test]
fn a_port_alone_is_of_the_loopback() {
    for port in ["0", ":0"] {
        let server = Server::started(&["serve", "--tcp", port], "tcp ");
        assert!(server.address.starts_with("127.0.0.1:"), "{}", server.address);
    }
    let (server, words) = Server::with_words(&["serve", "--tcp", "127.0.0.1:0", "--pins", "0"], 1);
    let address = words[0].strip_prefix("pins on ").expect("an address");
    assert!(address.starts_with("127.0.0.1:"), "{address}");
    let places: Vec<TcpStream> = (0..64).map(|_| TcpStream::connect(address).expect("it listens")).collect();
    let mut crowded = String::new();
    let mut more = TcpStream::connect(address).expect("it listens");
    more.set_read_timeout(Some(PATIENCE)).expect("a socket");
    more.read_to_string(&mut crowded).expect("it is closed");
    assert_eq!(crowded, "[MSG:Too many connections]\r\n");
    drop((places, server));
}

/// A running `oxmill`; it is killed on drop.
struct Server {
    program: Child,
    address: String,
}

impl Server {
    /// Starts `serve --tcp` at 50 times real time. A move of a minute then takes about a second, long enough for a
    /// client to disconnect during it.
    fn new(options: &[&str]) -> Server {
        Server::started(&[&["serve", "--tcp", "127.0.0.1:0", "--speed", "50"], options].concat(), "tcp ")
    }

    /// Starts the program; returns it with the address that follows `word` in its output.
    fn started(options: &[&str], word: &str) -> Server {
        let mut program = Command::new(env!("CARGO_BIN_EXE_oxmill"))
            .args(options)
            .stdin(Stdio::null())
            .stdout(Stdio::piped())
            .spawn()
            .expect("the program starts");
        let mut line = String::new();
        BufReader::new(program.stdout.take().expect("a pipe")).read_line(&mut line).expect("it says where it listens");
        let address = line.trim().strip_prefix(word).expect("an address").to_owned();
        Server { program, address }
    }

    /// Starts the program; returns it with its first lines on standard error.
    fn with_words(options: &[&str], lines: usize) -> (Server, Vec<String>) {
        let mut program = Command::new(env!("CARGO_BIN_EXE_oxmill"))
            .args(options)
            .stdin(Stdio::null())
            .stdout(Stdio::null())
            .stderr(Stdio::piped())
            .spawn()
            .expect("the program starts");
        let stderr = BufReader::new(program.stderr.take().expect("a pipe"));
        let (sender, said) = std::sync::mpsc::channel();
        std::thread::spawn(move || stderr.lines().map_while(Result::ok).try_for_each(|line| sender.send(line)));
        let said = (0..lines).map(|_| said.recv_timeout(PATIENCE).unwrap_or_default()).collect();
        (Server { program, address: String::new() }, said)
    }

    /// Starts the program; returns it with the address of its pin port.
    fn with_pins() -> (Server, String) {
        let (server, said) = Server::with_words(&["serve", "--tcp", "127.0.0.1:0", "--pins", "127.0.0.1:0"], 1);
        let pins = said[0].strip_prefix("pins on ").expect("an address").to_owned();
        (server, pins)
    }

    fn connect(&self) -> Client {
        Client::of(&self.address)
    }

    /// Returns a client that has read the welcome message. Retries until the server has noticed that the previous
    /// client is gone. The previous client's bytes can still be in transit, and a busy system can report a new
    /// connection before the end of the previous one.
    fn served(&self) -> Client {
        let end = Instant::now() + PATIENCE;
        loop {
            let mut client = self.connect();
            let first = client.line();
            if first.is_empty() && client.line() == WELCOME {
                return client;
            }
            assert!(BUSY.starts_with(&first) && Instant::now() < end, "{first:?}");
            std::thread::sleep(Duration::from_millis(20));
        }
    }
}

impl Drop for Server {
    fn drop(&mut self) {
        let _ = self.program.kill();
        let _ = self.program.wait();
    }
}

struct Client {
    stream: TcpStream,
    lines: BufReader<TcpStream>,
}

impl Client {
    fn of(address: &str) -> Client {
        let stream = TcpStream::connect(address).expect("it listens");
        stream.set_read_timeout(Some(PATIENCE)).expect("a socket");
        Client { lines: BufReader::new(stream.try_clone().expect("a socket")), stream }
    }

    fn send(&mut self, bytes: impl AsRef<[u8]>) {
        self.stream.write_all(bytes.as_ref()).expect("it is read");
    }

    fn line(&mut self) -> String {
        let mut line = String::new();
        self.lines.read_line(&mut line).expect("an answer in time");
        line.trim_end().to_owned()
    }

    fn status(&mut self) -> String {
        self.send("?");
        self.line()
    }

    fn ask(&mut self, line: &str) -> String {
        self.send(format!("{line}\n"));
        self.line()
    }

    /// Polls until a report starts with `state`, and returns that report. Until then, only reports may arrive.
    fn wait_for(&mut self, state: &str) -> String {
        let end = Instant::now() + PATIENCE;
        loop {
            let status = self.status();
            assert!(status.starts_with('<') && Instant::now() < end, "{status:?} instead of {state}");
            if status.starts_with(state) {
                return status;
            }
            std::thread::sleep(Duration::from_millis(10));
        }
    }

    /// Sends lines until no more are accepted, at most 12 MB.
    fn pour(&mut self) {
        let piece = b"G1 X1 F100\nG1 X0\n".repeat(1000);
        self.stream.set_write_timeout(Some(Duration::from_millis(500))).expect("a socket");
        for _ in 0..12_000_000 / piece.len() {
            match self.stream.write_all(&piece) {
                Ok(()) => {}
                Err(error) if matches!(error.kind(), ErrorKind::WouldBlock | ErrorKind::TimedOut) => return,
                Err(error) => panic!("{error}"),
            }
        }
    }
}

#[test]
fn a_flood_from_a_client_that_leaves_does_not_lock_the_server() {
    let server = Server::new(&[]);
    let mut first = server.served();
    first.send("!");
    first.pour();
    drop(first);
    let mut second = server.served();
    second.send("!");
    second.pour();
    // This client closes only its sending side, as if it still waited for answers. It must not lock the server either.
    second.stream.shutdown(Shutdown::Write).expect("a socket");
    let mut third = server.served();
    assert!(third.status().starts_with("<Hold:0|"));
    third.send([0x18]);
    assert_eq!([third.line(), third.line()], ["", WELCOME]);
    assert_eq!(third.ask("G21"), "ok");
}

#[test]
fn the_half_line_of_a_client_that_left_is_cut() {
    let server = Server::new(&[]);
    server.served().send("G0X");
    let mut next = server.served();
    assert_eq!([next.ask("5"), next.line()], ["[MSG:no letter in front of 5]", "error:1"]);
    assert!(next.wait_for("<Idle").contains("MPos:0.000,0.000,0.000"));
}

/// A client disconnects during its job. With `$914=1` the machine holds; with `$914=0` it finishes the received lines.
/// With `pending`, answers are still due: `G4` waits for the end of the motion, and the next line waits for `G4`.
#[test]
fn a_client_that_leaves_in_mid_job_is_one_that_closes_its_port() {
    for (hold, pending) in [(1, true), (1, false), (0, true), (0, false)] {
        let server = Server::new(&["--set", &format!("914={hold}")]);
        let mut first = server.served();
        // The move is so long that the server notices the closed port before the move ends, even on a busy host.
        let to = if hold == 1 { 300 } else { 60 };
        assert_eq!(first.ask(&format!("G1 X{to} F60")), "ok");
        if pending {
            first.send(format!("G4 P0\nG1 X{}\n", to + 1));
        }
        drop(first);
        let mut next = server.served();
        if hold == 1 {
            let report = next.wait_for("<Hold:0");
            assert!(!report.contains("MPos:300."), "{report}");
            next.send("~");
        }
        // The new client gets an answer to its own request only.
        let end = next.wait_for("<Idle");
        let place = format!("MPos:{}.000", to + i32::from(pending));
        assert!(end.contains(&place), "$914={hold}, {pending}: {end}");
        assert_eq!(next.ask("G21"), "ok");
        assert!(next.status().starts_with("<Idle"));
    }
}

#[test]
fn a_second_client_is_told_so_and_nothing_of_it_acts() {
    let server = Server::new(&[]);
    let mut first = server.served();
    assert_eq!(first.ask("G1 X60 F60"), "ok");
    let mut second = server.connect();
    second.send("!G0 Y9\n\x18");
    let mut said = String::new();
    second.lines.read_to_string(&mut said).expect("it is closed");
    assert_eq!(said, BUSY);
    assert!(first.wait_for("<Idle").contains("MPos:60.000,0.000,0.000"));
    drop(first);
    let mut third = server.served();
    assert!(third.wait_for("<Idle").contains("MPos:60.000,0.000,0.000"));
    assert_eq!(third.ask("G21"), "ok");
}

#[test]
fn a_reset_on_connection_gives_one_welcome() {
    let server = Server::new(&["--reset-on-connect"]);
    server.served().send("G4 P60\n$$\n");
    let mut next = server.served();
    assert_eq!(next.ask("G21"), "ok");
}

/// Asserts that a second server rejects a file that another server is writing.
fn is_refused_to_another(option: &str, file: &str) {
    let second = Command::new(env!("CARGO_BIN_EXE_oxmill"))
        .args(["serve", "--stdio", option, file])
        .stdin(Stdio::null())
        .output()
        .expect("it ends by itself");
    assert_eq!(second.status.code(), Some(2));
    let reason = String::from_utf8_lossy(&second.stderr);
    assert!(reason.contains(file) && reason.contains("in use by another oxmill"), "{reason}");
}

#[test]
fn a_recording_is_of_one_server() {
    let path = Path::new(env!("CARGO_TARGET_TMPDIR")).join("one_server.rec");
    std::fs::write(&path, []).expect("an empty file");
    let text = path.to_str().expect("a path in UTF-8");
    let first = Server::new(&["--record", text]);
    let mut client = first.served();
    assert_eq!(client.ask("G0 X1"), "ok");
    is_refused_to_another("--record", text);
    assert_eq!(client.ask("G0 X2"), "ok");
    drop(first);
    let recorded = std::fs::read_to_string(&path).expect("a recording");
    assert!(recorded.starts_with("oxmill recording") && recorded.contains("X1"), "{recorded}");
    Server::new(&["--record", text]);
}

/// Settings given as options are active at power-up, as on a board. If they enable homing, the machine starts locked.
/// If they contain a startup line, the machine carries it out.
#[test]
fn a_server_has_its_settings_at_power_up() {
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR"));
    let [settings, recording] =
        ["homing.txt", "homing.rec"].map(|name| folder.join(name).to_str().expect("a path").to_owned());
    std::fs::write(&settings, "$22=1\n").expect("a file can be written");
    for options in [&["--set", "22=1", "--record", &recording][..], &["--settings", &settings]] {
        let server = Server::new(options);
        let mut client = server.served();
        assert_eq!(client.line(), "[MSG:'$H'|'$X' to unlock]", "{options:?}");
        assert!(client.status().starts_with("<Alarm"), "{options:?}");
        assert_eq!(client.ask("G0 X1"), "error:9");
        assert_eq!(client.ask("$X"), "[MSG:Caution: Unlocked]");
        while client.line() != "ok" {}
        assert_eq!(client.ask("G0 X1"), "ok");
        client.wait_for("<Idle");
    }
    let replayed = Command::new(env!("CARGO_BIN_EXE_oxmill")).args(["replay", &recording]).output().expect("it plays");
    let said = String::from_utf8_lossy(&replayed.stdout);
    assert!(
        replayed.stderr.is_empty() && said.contains("error:9"),
        "{said}{}",
        String::from_utf8_lossy(&replayed.stderr)
    );
    let server = Server::new(&["--set", "N0=G91 X3"]);
    assert!(server.served().wait_for("<Idle").contains("MPos:3.000"));
    let store = folder.join("homed.img");
    std::fs::write(&store, []).expect("an empty file");
    let stored = ["--store", store.to_str().expect("a path")];
    drop(Server::new(&[&stored[..], &["--set", "22=1"]].concat()));
    assert_eq!(Server::new(&stored).served().line(), "[MSG:'$H'|'$X' to unlock]");
    assert!(Server::new(&[&stored[..], &["--set", "22=0"]].concat()).served().status().starts_with("<Idle"));
}

#[test]
fn a_store_is_of_one_server() {
    let store = Path::new(env!("CARGO_TARGET_TMPDIR")).join("one_server.img");
    std::fs::write(&store, []).expect("an empty file");
    let store = store.to_str().expect("a path in UTF-8");
    let first = Server::new(&["--store", store]);
    is_refused_to_another("--store", store);
    assert_eq!(first.served().ask("$100=80"), "ok");
    drop(first);
    let again = Server::new(&["--store", store]);
    let mut client = again.served();
    client.send("$$\n");
    let said: Vec<String> =
        std::iter::from_fn(|| Some(client.line())).take_while(|line| !line.starts_with("$101=")).collect();
    assert!(said.iter().any(|line| line.starts_with("$100=80")), "{said:?}");
}

/// Standard input ends while the machine is held and takes no lines. The program must still end, because no other host
/// can connect.
#[test]
fn standard_input_that_ends_in_a_hold_ends_the_program() {
    let mut program = Command::new(env!("CARGO_BIN_EXE_oxmill"))
        .args(["serve", "--stdio", "--speed", "max"])
        .stdin(Stdio::piped())
        .stdout(Stdio::null())
        .spawn()
        .expect("the program starts");
    program.stdin.take().expect("a pipe").write_all(b"!\nG1 X1 F100\n").expect("it reads");
    let end = Instant::now() + PATIENCE;
    while program.try_wait().expect("a program").is_none() {
        if Instant::now() > end {
            let _ = program.kill();
            panic!("it does not end");
        }
        std::thread::sleep(Duration::from_millis(20));
    }
}

#[cfg(unix)]
#[test]
fn a_pseudo_terminal_keeps_nothing_for_the_next_client() {
    let link = Path::new(env!("CARGO_TARGET_TMPDIR")).join("pty");
    let mut program = Command::new(env!("CARGO_BIN_EXE_oxmill"))
        .args(["serve", "--speed", "50", "--pty"])
        .arg(&link)
        .stdin(Stdio::null())
        .stdout(Stdio::piped())
        .spawn()
        .expect("the program starts");
    let mut line = String::new();
    BufReader::new(program.stdout.take().expect("a pipe")).read_line(&mut line).expect("it says where it is");
    // This thread kills the program at the end of the test, or after `PATIENCE`, so that no read below waits forever.
    let (done, waits) = std::sync::mpsc::channel::<()>();
    let watch = std::thread::spawn(move || {
        let _ = waits.recv_timeout(PATIENCE);
        let _ = program.kill();
        program.wait()
    });
    let open = || std::fs::OpenOptions::new().read(true).write(true).open(&link).expect("a terminal");
    let mut first = open();
    first.write_all(b"$$\nG0X").expect("it reads");
    let mut lines = BufReader::new(first.try_clone().expect("a file")).lines();
    assert!(lines.any(|line| line.expect("text").starts_with("$0=")));
    drop((first, lines));
    std::thread::sleep(Duration::from_millis(500));
    let mut second = open();
    let mut lines = BufReader::new(second.try_clone().expect("a file")).lines().map(|line| line.expect("text"));
    assert_eq!([lines.next(), lines.next()].map(Option::unwrap_or_default), ["", WELCOME]);
    second.write_all(b"5\n").expect("it reads");
    let answer = [lines.next(), lines.next()].map(Option::unwrap_or_default);
    assert_eq!(answer, ["[MSG:no letter in front of 5]", "error:1"]);
    second.write_all(b"?").expect("it reads");
    assert!(lines.next().is_some_and(|line| line.contains("MPos:0.000")));
    drop(done);
    watch.join().expect("no panic").expect("a program");
}

/// The server does not replace a symbolic link that leads to a file. It replaces a dangling link, because an earlier
/// run can have left it behind.
#[cfg(unix)]
#[test]
fn no_link_to_a_file_is_taken_for_a_pseudo_terminal() {
    use std::os::unix::fs::symlink;
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join("links");
    let _ = std::fs::remove_dir_all(&folder);
    std::fs::create_dir_all(&folder).expect("a folder");
    let [job, to_job, to_nothing] = ["job.nc", "to_job", "to_nothing"].map(|name| folder.join(name));
    std::fs::write(&job, "G0 X1\n").expect("a file");
    symlink(&job, &to_job).expect("a link");
    symlink("/dev/pts/4000000", &to_nothing).expect("a link");
    let taken = Server::started(&["serve", "--pty", to_nothing.to_str().expect("text")], "pty ");
    assert_eq!(std::fs::read_link(&to_nothing).expect("a link"), Path::new(&taken.address));
    let mut program = Command::new(env!("CARGO_BIN_EXE_oxmill"));
    program.args(["serve", "--pty"]).arg(&to_job).stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::piped());
    let mut program = program.spawn().expect("the program starts");
    let mut said = String::new();
    BufReader::new(program.stdout.take().expect("a pipe")).read_line(&mut said).expect("text");
    let _ = program.kill();
    let said = said + &String::from_utf8_lossy(&program.wait_with_output().expect("it ends").stderr);
    assert!(said.contains("to_job is there already"), "{said}");
    assert_eq!(std::fs::read_link(&to_job).expect("a link"), job);
}

/// If no file descriptor is left for another connection, the system keeps reporting that a connection waits. The server
/// must not use processor time for these reports.
#[cfg(target_os = "linux")]
#[test]
fn a_server_without_room_for_files_is_quiet() {
    let mut program = Command::new("sh")
        .args(["-c", "ulimit -n 20 && exec \"$0\" serve --tcp 0 --pins 0", env!("CARGO_BIN_EXE_oxmill")])
        .stdin(Stdio::null())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .expect("the program starts");
    let first = |said: Box<dyn std::io::Read>| {
        let mut line = String::new();
        BufReader::new(said).read_line(&mut line).expect("it says where it listens");
        line.trim().rsplit(' ').next().unwrap_or_default().to_owned()
    };
    let tcp = first(Box::new(program.stdout.take().expect("a pipe")));
    let pins = first(Box::new(program.stderr.take().expect("a pipe")));
    let server = Server { program, address: tcp };
    let clients: Vec<_> = (0..30).filter_map(|_| TcpStream::connect(&pins).ok()).collect();
    std::thread::sleep(Duration::from_millis(200));
    let before = processor_time(&server.program);
    std::thread::sleep(Duration::from_secs(1));
    let used = processor_time(&server.program) - before;
    assert!(used < 10, "{used} hundredths of a second");
    drop(clients);
    assert_eq!(server.served().ask("G21"), "ok");
}

/// Returns the processor time of a program, in hundredths of a second.
#[cfg(target_os = "linux")]
fn processor_time(program: &Child) -> u64 {
    let line = std::fs::read_to_string(format!("/proc/{}/stat", program.id())).expect("a process");
    line.split(' ').skip(13).take(2).filter_map(|ticks| ticks.parse::<u64>().ok()).sum()
}
