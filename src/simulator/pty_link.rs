//! `serve --pty`: a pseudo terminal that a sender opens like a serial port, by its name or a symbolic link. When the
//! client closes the terminal, unread output is discarded. Several programs that have the terminal open count as one
//! client.

use crate::clients::{Client, ENDLESS, Happened, Inbox, LOOK, PIECE, Writer, hung_up, writer};
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

/// Interval at which a port without a client is polled.
const CLOSED: Duration = Duration::from_millis(2);

/// Makes a pseudo terminal, and a symbolic link to it if `link` is given.
pub(crate) fn open(link: Option<&Path>, sender: SyncSender<Happened>) -> Result<Port> {
    let ends = openpty(None, None).context("cannot make a pseudo terminal")?;
    let path = nix::unistd::ttyname(&ends.slave).context("the pseudo terminal has no name")?;
    let master = File::from(ends.master);
    make_raw(&master).context("cannot set up the pseudo terminal")?;
    // The write side must not block forever if a client does not read.
    fcntl(&master, FcntlArg::F_SETFL(OFlag::O_NONBLOCK)).context("cannot set up the pseudo terminal")?;
    // Close the clients' end. As long as no client has this end open, `poll` reports a hang-up. When the hang-up ends,
    // the first client has opened the terminal.
    drop(ends.slave);
    if let Some(link) = link {
        match fs::symlink_metadata(link) {
            // A link to a terminal, or a dangling link, is left over from a previous server.
            Ok(old) if old.file_type().is_symlink() && !is_file_or_folder(link) => fs::remove_file(link)?,
            Ok(_) => bail!("{} is there already and does not lead to a terminal", link.display()),
            Err(_) => {}
        }
        std::os::unix::fs::symlink(&path, link).with_context(|| format!("cannot make the link {}", link.display()))?;
    }
    Ok(Port { master, path, sender, client: None })
}

fn is_file_or_folder(path: &Path) -> bool {
    fs::metadata(path).is_ok_and(|about| about.is_file() || about.is_dir())
}

/// Switches echo, line editing and translation off, so that bytes pass unchanged.
fn make_raw(master: &File) -> nix::Result<()> {
    let mut terminal = tcgetattr(master)?;
    cfmakeraw(&mut terminal);
    tcsetattr(master, SetArg::TCSANOW, &terminal)
}

/// The inbox and the writer of the client that has the port open.
struct Open {
    inbox: Arc<Inbox>,
    writer: Writer,
}

/// A pseudo terminal and the client that has it open.
pub(crate) struct Port {
    master: File,
    path: PathBuf,
    sender: SyncSender<Happened>,
    client: Option<Open>,
}

impl Port {
    pub(crate) fn path(&self) -> &Path {
        &self.path
    }

    /// Serves the clients one after the other. Returns `None` when the loop that owns the simulator has ended.
    pub(crate) fn serve(mut self) -> Option<()> {
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

    /// Waits a short time for something to happen. Returns whether no client has the port open, and whether bytes can
    /// be read.
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

    /// Discards the unread input of the client that has closed the port, and the replies that the client has not read.
    /// Otherwise the terminal would keep the replies for the next client.
    fn closed(&mut self) -> Option<()> {
        if let Some(client) = self.client.take() {
            let mut rest = [0; PIECE];
            while (&self.master).read(&mut rest).is_ok_and(|length| length > 0) {}
            client.inbox.end();
            self.sender.send(Happened::Heard).ok()?;
            // Wait until the loop that owns the simulator has released the client, and the client's writer has ended.
            // After that, no further reply comes.
            let _ = client.writer.join().ok()?;
            let flags = (OFlag::O_NOCTTY | OFlag::O_NONBLOCK).bits();
            if let Ok(end) = OpenOptions::new().read(true).write(true).custom_flags(flags).open(&self.path) {
                let _ = tcflush(&end, FlushArg::TCIFLUSH);
            }
        }
        Some(())
    }
}
