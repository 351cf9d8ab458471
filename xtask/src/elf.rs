//! Reads sections, load addresses and symbols of ELF files. Other modules interpret them for the firmware.

/// A segment that flashing tools write.
pub struct Segment {
    /// Load address.
    pub stored: u32,
    /// Size in bytes.
    pub size: u32,
    /// Offset of its bytes in the file.
    pub offset: u32,
}

/// A section of the file.
pub struct Section {
    /// Its name.
    pub name: String,
    /// Address at run time.
    pub address: u32,
    /// Load address in flash; differs from `address` for data that is copied to RAM at start-up.
    pub stored: u32,
    /// Offset of its bytes in the file.
    pub offset: u32,
    /// Size in bytes.
    pub size: u32,
    /// Whether it occupies memory of the target.
    pub allocated: bool,
    /// Whether it has bytes in the file.
    pub loaded: bool,
    kind: u32,
    link: u32,
}

/// A named address.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Symbol {
    /// Mangled name.
    pub name: String,
    /// Address without the Thumb bit.
    pub address: u32,
    /// Size in bytes, 0 if unknown.
    pub size: u32,
    /// Whether it is a function.
    pub function: bool,
}

/// Reader of a 32-bit little-endian ELF file, limited to section headers, load addresses and symbols.
pub struct Elf<'a> {
    /// The file.
    pub bytes: &'a [u8],
}

impl Elf<'_> {
    /// Returns the word at an offset in the file.
    pub fn word(&self, at: u32) -> Option<u32> {
        let at = at as usize;
        Some(u32::from_le_bytes(self.bytes.get(at..at + 4)?.try_into().ok()?))
    }

    /// Returns the half word at an offset in the file.
    pub fn half(&self, at: u32) -> Option<u32> {
        let at = at as usize;
        Some(u32::from(u16::from_le_bytes(self.bytes.get(at..at + 2)?.try_into().ok()?)))
    }

    /// Returns the loadable segments that are not empty.
    pub fn segments(&self) -> Option<Vec<Segment>> {
        let (programs, entry, count) = (self.word(28)?, self.half(42)?, self.half(44)?);
        let mut segments = Vec::new();
        for i in 0..count {
            let program = programs + i * entry;
            let (offset, stored, size) = (self.word(program + 4)?, self.word(program + 12)?, self.word(program + 16)?);
            let segment = Segment { stored, size, offset };
            if self.word(program)? == 1 && segment.size > 0 {
                segments.push(segment);
            }
        }
        Some(segments)
    }

    /// Returns all sections; `None` if this is not a 32-bit little-endian ELF file.
    pub fn sections(&self) -> Option<Vec<Section>> {
        if self.bytes.get(..6)? != b"\x7FELF\x01\x01" {
            return None;
        }
        let (programs, headers) = (self.word(28)?, self.word(32)?);
        let (program_size, program_count) = (self.half(42)?, self.half(44)?);
        let (size, count, names) = (self.half(46)?, self.half(48)?, self.half(50)?);
        let names = self.word(headers + names * size + 16)?;
        let mut sections = Vec::new();
        for i in 0..count {
            let header = headers + i * size;
            let name = self.bytes.get((names + self.word(header)?) as usize..)?;
            let name = String::from_utf8_lossy(name.split(|b| *b == 0).next()?).into_owned();
            let kind = self.word(header + 4)?;
            let address = self.word(header + 12)?;
            let mut stored = address;
            for p in 0..program_count {
                let program = programs + p * program_size;
                let (from, physical) = (self.word(program + 8)?, self.word(program + 12)?);
                if self.word(program)? == 1 && (from..from + self.word(program + 20)?).contains(&address) {
                    stored = address - from + physical;
                }
            }
            sections.push(Section {
                name,
                address,
                stored,
                offset: self.word(header + 16)?,
                size: self.word(header + 20)?,
                allocated: self.word(header + 8)? & 2 != 0,
                loaded: self.word(header + 8)? & 2 != 0 && kind != 8,
                kind,
                link: self.word(header + 24)?,
            });
        }
        Some(sections)
    }

    /// Returns the symbol table; empty if the file has none.
    pub fn symbols(&self) -> Option<Vec<Symbol>> {
        /// Section type of the symbol table.
        const SYMBOLS: u32 = 2;
        /// Size of a symbol table entry, bytes.
        const ENTRY: u32 = 16;
        let sections = self.sections()?;
        let mut symbols = Vec::new();
        for table in sections.iter().filter(|s| s.kind == SYMBOLS) {
            let names = sections.get(table.link as usize)?.offset;
            for at in (table.offset..table.offset + table.size).step_by(ENTRY as usize) {
                let name = self.bytes.get((names + self.word(at)?) as usize..)?;
                let kind = self.half(at + 12)? & 0xF;
                let value = self.word(at + 4)?;
                symbols.push(Symbol {
                    name: String::from_utf8_lossy(name.split(|b| *b == 0).next()?).into_owned(),
                    address: if kind == 2 { value & !1 } else { value },
                    size: self.word(at + 8)?,
                    function: kind == 2,
                });
            }
        }
        Some(symbols)
    }
}
