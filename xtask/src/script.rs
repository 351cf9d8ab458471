//! Script of what a host does, as byte codes: `boards/qemu_mps2/script.rs` executes them inside the machine in QEMU,
//! and `tests/virtual_board/soak.py` beside a virtual board.

/// A script: commands for a host, each a letter and its operands. Each method except `codes` appends one command.
#[derive(Default)]
pub struct Script(Vec<u8>);

impl Script {
    fn code(&mut self, code: u8, number: u32) {
        self.0.push(code);
        self.0.extend(number.to_le_bytes());
    }

    /// Returns the script in the form in which it is written to a file.
    pub fn codes(&self) -> &[u8] {
        &self.0
    }

    /// Sends these bytes, at most 65,535, without waiting between them.
    pub fn send(&mut self, bytes: &[u8]) {
        self.0.push(b'S');
        self.0.extend((bytes.len() as u16).to_le_bytes());
        self.0.extend(bytes);
    }

    /// Waits until this many answers (`ok` or `error:`) have arrived since the end of the previous record (section of
    /// the script).
    pub fn answers(&mut self, count: u32) {
        self.code(b'A', count);
    }

    pub fn wait(&mut self, ms: u32) {
        self.code(b'W', ms);
    }

    /// Polls at this interval in ms until the machine is idle.
    pub fn wait_for_idle(&mut self, pause_ms: u32) {
        self.code(b'I', pause_ms);
    }

    /// Ends a record (a section of the script). The test stand then reports how many bytes the firmware has sent in
    /// total.
    pub fn end_record(&mut self) {
        self.0.push(b'R');
    }

    /// Ends a record (a section of the script). The test stand then reports the number of bytes sent, the machine time,
    /// the motors' steps and the stack use.
    pub fn note(&mut self) {
        self.0.push(b'N');
    }

    /// Ends the script here if the machine has run for this many ms.
    pub fn end_after(&mut self, ms: u32) {
        self.code(b'E', ms);
    }

    /// Closes the host's port for a time in ms and reopens it. Only for boards whose port can be closed.
    pub fn reopen(&mut self, away_ms: u32) {
        self.code(b'H', away_ms);
    }
}
