//! Reads the boards' ELF files with the crate `object`, and adds the few functions that the crate lacks.

use crate::Failure;
use object::read::elf::{ElfFile32, ElfSection32, ProgramHeader, SectionHeader};
use object::{LittleEndian, Object, ObjectSection, ObjectSegment, ObjectSymbol, SymbolKind};
use std::ops::Range;

pub type Elf<'a> = ElfFile32<'a, LittleEndian>;

/// A function that the symbol table names.
#[derive(Clone, Copy)]
pub struct Function<'a> {
    /// Name in the symbol table, mangled.
    pub name: &'a str,
    /// Address, with bit 0 (the mark of Thumb code) cleared.
    pub address: u32,
    /// Size in bytes, 0 if unknown.
    pub size: u32,
}

/// Reads the headers of an ELF file. Fails if `bytes` are not a 32-bit ELF file.
pub fn parse(bytes: &[u8]) -> Result<Elf<'_>, Failure> {
    Elf::parse(bytes).map_err(|error| format!("this is no 32-bit ELF file: {error}"))
}

/// Returns what a flashing tool writes: the bytes of each segment, with the address at which they are stored in flash.
/// `None` if the file is truncated.
pub fn segments<'a>(elf: &Elf<'a>) -> Option<Vec<(u32, &'a [u8])>> {
    let all = elf.segments().map(|segment| {
        let stored = segment.elf_program_header().p_paddr(LittleEndian);
        Some((stored, segment.data().ok()?))
    });
    all.filter(|segment| segment.is_none_or(|(_, bytes)| !bytes.is_empty())).collect()
}

/// Returns the memory that a section occupies at run time; `None` if it occupies none. Debug information, for example,
/// occupies none.
pub fn memory(section: &ElfSection32<'_, '_, LittleEndian>) -> Option<Range<u32>> {
    let header = section.elf_section_header();
    let start = header.sh_addr(LittleEndian);
    let allocated = header.sh_flags(LittleEndian).contains(object::elf::SHF_ALLOC);
    allocated.then(|| start..start + header.sh_size(LittleEndian))
}

/// Returns the addresses at which the bytes of a section are stored; `None` if the file has no bytes for it. Data that
/// start-up code copies to RAM is stored in flash.
pub fn stored(elf: &Elf<'_>, section: &ElfSection32<'_, '_, LittleEndian>) -> Option<Range<u32>> {
    let memory = memory(section)?;
    section.file_range()?;
    let start = elf.segments().find_map(|segment| {
        let header = segment.elf_program_header();
        let (from, size) = (header.p_vaddr(LittleEndian), header.p_memsz(LittleEndian));
        (from..from + size).contains(&memory.start).then(|| header.p_paddr(LittleEndian) + (memory.start - from))
    });
    let start = start.unwrap_or(memory.start);
    Some(start..start + memory.len() as u32)
}

/// Returns the half word at a run-time address, if the file contains it.
pub fn half(elf: &Elf<'_>, address: u32) -> Option<u16> {
    let bytes = elf.segments().find_map(|segment| segment.data_range(address.into(), 2).ok()?)?;
    Some(u16::from_le_bytes(bytes.try_into().ok()?))
}

/// Returns all functions, in the order of the symbol table.
pub fn functions<'a>(elf: &Elf<'a>) -> impl Iterator<Item = Function<'a>> {
    let functions = elf.symbols().filter(|symbol| symbol.kind() == SymbolKind::Text);
    functions.filter_map(|symbol| {
        Some(Function { name: symbol.name().ok()?, address: symbol.address() as u32 & !1, size: symbol.size() as u32 })
    })
}

/// Returns a file with these segments, each stored at its run-time address, and symbols for these functions: name,
/// address and size.
#[cfg(test)]
pub fn file(segments: &[(u32, &[u8])], functions: &[(&str, u32, u32)]) -> Vec<u8> {
    const HEADER: usize = 52;
    const PROGRAM_HEADER: usize = 32;
    let words = |values: &[u32]| values.iter().flat_map(|v| v.to_le_bytes()).collect::<Vec<u8>>();
    let behind = HEADER + PROGRAM_HEADER * segments.len();
    let (mut programs, mut contents) = (Vec::new(), Vec::new());
    for (address, bytes) in segments {
        let (offset, size) = ((behind + contents.len()) as u32, bytes.len() as u32);
        programs.extend(words(&[1, offset, *address, *address, size, size, 5, 4]));
        contents.extend_from_slice(bytes);
    }
    let (mut names, mut symbols) = (vec![0], vec![0; 16]);
    for (name, address, size) in functions {
        symbols.extend(words(&[names.len() as u32, address | 1, *size, 0x0001_0012]));
        names.extend(name.bytes().chain([0]));
    }
    let table = (behind + contents.len()) as u32;
    let strings = table + symbols.len() as u32;
    let sections = strings + names.len() as u32;
    let mut file = b"\x7FELF\x01\x01\x01".to_vec();
    file.resize(28, 0);
    file.extend(words(&[HEADER as u32, sections, 0, 32 << 16 | 52, 40 << 16 | segments.len() as u32, 2 << 16 | 3]));
    file.extend([programs, contents, symbols.clone(), names.clone()].concat());
    file.extend([0; 40]);
    file.extend(words(&[0, 2, 0, 0, table, symbols.len() as u32, 2, 0, 4, 16]));
    file.extend(words(&[0, 3, 0, 0, strings, names.len() as u32, 0, 0, 1, 0]));
    file
}
