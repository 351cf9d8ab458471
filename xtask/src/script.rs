//! What a host inside a machine does, as its codes: `boards/qemu_mps2/script.rs` follows them in QEMU, and
//! `tests/virtual_board/soak.py` beside a virtual board.

/// A script.
#[derive(Default)]
pub struct Script(Vec<u8>);

impl Script {
    fn code(&mut self, code: u8, number: u32) {
        self.0.push(code);
        self.0.extend(number.to_le_bytes());
    }

    /// All of it.
    pub fn codes(&self) -> &[u8] {
        &self.0
    }

    /// Sends bytes at once.
    pub fn send(&mut self, bytes: &[u8]) {
        self.0.push(b'S');
        self.0.extend((bytes.len() as u16).to_le_bytes());
        self.0.extend(bytes);
    }

    /// Waits for so many answers since the last record.
    pub fn answers(&mut self, count: u32) {
        self.code(b'A', count);
    }

    /// Waits.
    pub fn wait(&mut self, ms: u32) {
        self.code(b'W', ms);
    }

    /// Asks with such pauses until the machine is idle.
    pub fn wait_for_idle(&mut self, pause_ms: u32) {
        self.code(b'I', pause_ms);
    }

    /// A record ends.
    pub fn end_record(&mut self) {
        self.0.push(b'R');
    }

    /// A record ends, and the test stand says all that it knows.
    pub fn note(&mut self) {
        self.0.push(b'N');
    }

    /// The script ends here if the machine has run for so long.
    pub fn end_after(&mut self, ms: u32) {
        self.code(b'E', ms);
    }

    /// The host closes its port, is away for so long, and opens it again. Only where there is one to be closed.
    pub fn reopen(&mut self, away_ms: u32) {
        self.code(b'H', away_ms);
    }
}
