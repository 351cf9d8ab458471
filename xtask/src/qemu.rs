//! Runs programs in QEMU: with TCP connections to the firmware, with a preloaded job or script, or with a log of all
//! instructions.

use crate::{Failure, QEMU_BOARD, image};
use std::io::Read;
use std::net::{TcpListener, TcpStream};
use std::path::Path;
use std::process::{Child, ChildStdout, Command, Stdio};
use std::thread;
use std::time::{Duration, Instant};

const PROGRAM: &str = "qemu-system-arm";
/// Address of a preloaded job, as in boards/qemu_mps2.
const JOB: u32 = 0x2100_0000;

/// A running QEMU; it is killed on drop.
pub struct Qemu(Child);

impl Drop for Qemu {
    fn drop(&mut self) {
        // Ignored, because the call fails if QEMU has already ended.
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

/// Returns an error with advice if QEMU is missing.
pub fn require() -> Result<(), Failure> {
    if crate::exists(PROGRAM) {
        Ok(())
    } else {
        Err(format!("{PROGRAM} is missing: install it (Debian: `apt-get install qemu-system-arm`)"))
    }
}

/// Returns a QEMU command bound to one processor, if possible. With counted instructions (`-icount`), QEMU switches
/// between two threads at every timer. Switching takes half the time if both run on the same processor.
fn on_one_processor() -> Command {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let allowed = status.lines().find_map(|line| line.strip_prefix("Cpus_allowed_list:"));
    let last = allowed.and_then(|list| list.trim().rsplit([',', '-']).next());
    match last {
        Some(processor) if crate::exists("taskset") => {
            let mut command = Command::new("taskset");
            command.args(["-c", processor, PROGRAM]);
            command
        }
        _ => Command::new(PROGRAM),
    }
}

/// Returns the command line of all runs except [`trace`]. Each instruction takes 8 ns of virtual time, so virtual time
/// depends only on the instructions executed. `rest_is_skipped`: while the processor sleeps, virtual time jumps to the
/// next timer and does not follow real time.
fn machine(elf: &Path, rest_is_skipped: bool) -> Command {
    let mut qemu = on_one_processor();
    let sleep = if rest_is_skipped { "shift=3,sleep=off" } else { "shift=3,sleep=on" };
    qemu.args(["-M", "mps2-an386", "-display", "none", "-monitor", "none", "-icount", sleep]);
    qemu.args(["-semihosting-config", "enable=on,target=native"]).arg("-kernel").arg(elf);
    qemu.stdin(Stdio::null());
    qemu
}

/// Runs a program until it ends by itself. `read` gets the log, which has the address of each instruction. The log
/// comes through a pipe, because it is several gigabytes long.
pub fn trace<T>(elf: &Path, read: impl FnOnce(ChildStdout) -> Result<T, Failure>) -> Result<T, Failure> {
    require()?;
    let mut qemu = Command::new(PROGRAM);
    qemu.args(["-M", "mps2-an386", "-display", "none", "-monitor", "none", "-serial", "null"]);
    // One instruction per translation block, so that each instruction is logged. This option was renamed in version
    // 8.1.
    let help = Command::new(PROGRAM).arg("-help").output().map_err(|error| error.to_string())?;
    if String::from_utf8_lossy(&help.stdout).contains("one-insn-per-tb") {
        qemu.args(["-accel", "tcg,one-insn-per-tb=on"]);
    } else {
        qemu.arg("-singlestep");
    }
    qemu.args(["-semihosting-config", "enable=on,target=native", "-d", "exec,nochain", "-D", "/dev/stdout"]);
    qemu.arg("-kernel").arg(elf).stdin(Stdio::null()).stdout(Stdio::piped());
    let mut running = Qemu(qemu.spawn().map_err(|error| format!("{PROGRAM}: {error}"))?);
    let log = running.0.stdout.take().ok_or("no output of QEMU")?;
    let found = read(log)?;
    let status = running.0.wait().map_err(|error| error.to_string())?;
    if status.success() { Ok(found) } else { Err(format!("{PROGRAM}: {status}")) }
}

/// Returns two TCP ports that no program uses now. Another program can still take one before QEMU does.
fn free_ports() -> Result<(u16, u16), Failure> {
    let listen = || TcpListener::bind("127.0.0.1:0").map_err(|error| format!("no free TCP port: {error}"));
    let (a, b) = (listen()?, listen()?);
    let port = |l: &TcpListener| l.local_addr().map(|a| a.port()).map_err(|error| error.to_string());
    Ok((port(&a)?, port(&b)?))
}

fn on_tcp(qemu: &mut Command, port: u16) {
    qemu.args(["-serial", &format!("tcp:127.0.0.1:{port},server=on,wait=off,nodelay=on")]);
}

fn connect(port: u16) -> Result<TcpStream, Failure> {
    let begin = Instant::now();
    loop {
        match TcpStream::connect(("127.0.0.1", port)) {
            Ok(stream) => return Ok(stream),
            Err(error) if begin.elapsed() > Duration::from_secs(60) => {
                return Err(format!("QEMU does not listen: {error}"));
            }
            Err(_) => thread::sleep(Duration::from_millis(20)),
        }
    }
}

/// Starts the firmware with a connection to its host port and one to its test stand. Idle time is skipped, so the
/// machine finishes all its work before the host's next bytes arrive, and the look-ahead runs empty every time.
pub fn streamed(elf: &Path) -> Result<Running, Failure> {
    running(machine(elf, true))
}

/// Like [`streamed`], but the processor never sleeps, so that a host can intervene during a motion. Virtual time then
/// advances only with the instructions executed, about as fast as real time. While the PC gives QEMU no processor time,
/// virtual time stands still.
pub fn live(elf: &Path) -> Result<Running, Failure> {
    let mut qemu = machine(elf, true);
    let mark = u32::from_le_bytes(*b"BUSY");
    qemu.args(["-device", &format!("loader,addr={JOB:#x},data={mark:#x},data-len=4")]);
    running(qemu)
}

/// A running board, the connection to its host port, and the connection to its test stand.
pub type Running = (Qemu, TcpStream, TcpStream);

fn running(mut qemu: Command) -> Result<Running, Failure> {
    require()?;
    let (host, stand) = free_ports()?;
    on_tcp(&mut qemu, host);
    on_tcp(&mut qemu, stand);
    let qemu = Qemu(qemu.spawn().map_err(|error| error.to_string())?);
    Ok((qemu, connect(host)?, connect(stand)?))
}

/// What QEMU loads into RAM before the firmware starts. The data begins with four letters, `JOB!` or `HOST`, from which
/// the firmware recognises its kind. `boards/qemu_mps2` has the same letters.
#[derive(Clone, Copy)]
pub enum Preload {
    /// The G-code of a job, which the firmware runs as if a host had sent it.
    Job,
    /// A script for a host inside the machine, made with `script.rs`.
    Script,
}

/// Runs a job or a script from RAM to its end; returns the firmware's output and the test stand's report.
pub fn preloaded(elf: &Path, what: Preload, job: &Path, limit: Duration) -> Result<(String, String), Failure> {
    require()?;
    let (host, stand) = (job.with_extension("answers"), job.with_extension("report"));
    let mut qemu = machine(elf, true);
    let length = std::fs::metadata(job).map_err(|error| format!("{}: {error}", job.display()))?.len();
    let mark = match what {
        Preload::Job => *b"JOB!",
        Preload::Script => *b"HOST",
    };
    let header = u64::from(u32::from_le_bytes(mark)) | length << 32;
    qemu.args(["-device", &format!("loader,addr={JOB:#x},data={header:#x},data-len=8")]);
    qemu.args(["-device", &format!("loader,addr={:#x},file={},force-raw=on", JOB + 8, job.display())]);
    for file in [&host, &stand] {
        qemu.args(["-serial", &format!("file:{}", file.display())]);
    }
    let mut qemu = Qemu(qemu.stderr(Stdio::piped()).spawn().map_err(|error| error.to_string())?);
    let begin = Instant::now();
    loop {
        match qemu.0.try_wait() {
            Ok(Some(status)) if status.success() => break,
            Ok(Some(status)) => {
                let mut why = String::new();
                if let Some(mut errors) = qemu.0.stderr.take() {
                    let _ = errors.read_to_string(&mut why);
                }
                return Err(format!("the firmware ended with {status}: {why}"));
            }
            Ok(None) if begin.elapsed() > limit => {
                return Err(format!("{} did not end within {limit:?}", job.display()));
            }
            Ok(None) => thread::sleep(Duration::from_millis(5)),
            Err(error) => return Err(error.to_string()),
        }
    }
    let read = |path: &Path| std::fs::read_to_string(path).map_err(|error| format!("{}: {error}", path.display()));
    Ok((read(&host)?, read(&stand)?))
}

/// `cargo qemu`: runs the firmware with its serial line on a TCP port until it is interrupted.
pub fn serve() -> Result<(), Failure> {
    require()?;
    let image = image::build(QEMU_BOARD)?;
    let (host, stand) = free_ports()?;
    let mut qemu = machine(&image.path, false);
    on_tcp(&mut qemu, host);
    on_tcp(&mut qemu, stand);
    println!("serial line  127.0.0.1:{host}   (for example: nc 127.0.0.1 {host})");
    println!("test stand   127.0.0.1:{stand}   (any byte gives digests and steps)");
    crate::run(&mut qemu)
}
