//! Builds an image and checks it: the linker also accepts an image without a vector table or without code.

use crate::elf::{Elf, Section, Segment, Symbol};
use crate::paths::cargo_for_boards;
use crate::reach::{self, Allowed};
use crate::{Failure, QEMU_BOARD, TARGET, dfuse, flashable, root, run, sizes, thumb};
use std::fmt;
use std::fs;
use std::ops::Range;
use std::path::{Path, PathBuf};

/// Minimum code size of a complete controller, bytes.
const LEAST_CODE: u32 = 16 * 1024;

/// Maximum size of memory initialised with values other than 0, bytes. A larger size means that memory lent to the
/// controller is not all zero, so its contents would fill flash.
const MOST_DATA: u32 = 2 * 1024;
/// Maximum number of code bytes within which a function allocates its stack frame.
const PROLOGUE: u32 = 32;

/// Returns the interrupt handler of the step task, as in `firmware!` of `src/firmware/main.rs`.
fn step_handler(board: &str) -> &'static str {
    if board == QEMU_BOARD { "TIMER0" } else { "TIM5" }
}

/// Calls through registers that the step interrupt may make: a queue or signal wakes `control`, and the waker pends the
/// interrupt of its dispatcher.
const STEP_CALLS: [Allowed; 6] = [
    Allowed { function: "step_timer::", targets: &["executor::waker_wake", "executor::waker_drop"] },
    Allowed { function: "channel::Receiver<", targets: &["executor::waker_wake", "executor::waker_drop"] },
    Allowed { function: "executor::waker_wake", targets: &["FnOnce"] },
    // The same in images built for size, where these functions are not inlined.
    Allowed { function: "wait_queue::DoublyLinkedList<", targets: &["executor::waker_wake", "executor::waker_drop"] },
    Allowed { function: "signal::SignalWriter<", targets: &["executor::waker_wake", "executor::waker_drop"] },
    Allowed {
        function: "CriticalSectionWakerRegistration",
        targets: &["executor::waker_wake", "executor::waker_drop"],
    },
];

/// A checked image.
pub struct Image {
    /// The ELF file.
    pub path: PathBuf,
    flash: (u32, u32),
    ram: (u32, u32),
    stack: u32,
    /// Files for flashing tools.
    pub files: Vec<PathBuf>,
    /// Message about its size.
    remark: Option<String>,
    /// Number of functions that the step interrupt can reach.
    reached: usize,
}

impl fmt::Display for Image {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (flash, of_flash) = self.flash;
        let (ram, of_ram) = self.ram;
        writeln!(f, "{}", self.path.display())?;
        writeln!(f, "flash  {flash:>7} bytes used, {:>7} left", of_flash - flash)?;
        writeln!(f, "RAM    {ram:>7} bytes used, {:>7} left, beside a stack of {}", of_ram - ram, self.stack)?;
        if let Some(remark) = &self.remark {
            writeln!(f, "{remark}")?;
        }
        for file in &self.files {
            writeln!(f, "{}", file.display())?;
        }
        write!(
            f,
            "step interrupt: {} functions in reach, none of them panics, divides or computes in software",
            self.reached
        )
    }
}

/// Builds the release firmware for a board.
pub fn build(board: &str) -> Result<Image, Failure> {
    let profile = crate::boards::profile(board);
    let mut build = cargo_for_boards("build", profile)?;
    run(build.args(["--locked", "--package", "oxmill-firmware", "--features", board]))?;
    let built = root().join("target").join(TARGET).join(profile).join("oxmill-firmware");
    // Every board links to the same file name; this copy survives the build for the next board.
    let folder = root().join("target/boards");
    let path = folder.join(format!("{board}.elf"));
    let copy = fs::create_dir_all(&folder).and_then(|()| fs::copy(&built, &path));
    copy.map_err(|error| format!("{}: {error}", built.display()))?;
    let bytes = fs::read(&path).map_err(|error| format!("{}: {error}", path.display()))?;
    let mut image = check(board, &bytes, path)?;
    if board != QEMU_BOARD {
        image.files = write(board, &bytes, &folder)?;
    }
    image.remark = sizes::judge(board, image.flash.0, image.ram.0)?;
    Ok(image)
}

/// Writes the files for flashing tools and reads them back.
fn write(board: &str, bytes: &[u8], folder: &Path) -> Result<Vec<PathBuf>, Failure> {
    let chip = Chip::read(board)?;
    let stretches = flashable::stretches(&Elf { bytes }, &chip.settings_sectors())
        .ok_or_else(|| format!("the image of {board} has segments that overlap"))?;
    let files = [
        (".hex", flashable::hex(&stretches).into_bytes()),
        (".dfu", dfuse::file(&format!("Oxmill for {board}"), &stretches)),
    ];
    let paths = files.each_ref().map(|(ending, _)| folder.join(format!("{board}{ending}")));
    for (path, (_, contents)) in paths.iter().zip(&files) {
        fs::write(path, contents).map_err(|error| format!("{}: {error}", path.display()))?;
    }
    let read = |path: &PathBuf| fs::read(path).map_err(|error| format!("{}: {error}", path.display()));
    let [hex, dfu] = [read(&paths[0])?, read(&paths[1])?];
    flashable::check(&String::from_utf8_lossy(&hex), &stretches, &chip.settings_sectors())?;
    dfuse::check(&dfu, &stretches, chip.flash)?;
    Ok(paths.into())
}

fn check(board: &str, bytes: &[u8], path: PathBuf) -> Result<Image, Failure> {
    let chip = Chip::read(board)?;
    let elf = Elf { bytes };
    let sections = elf.sections().ok_or("the image is no 32-bit ELF file")?;
    let section = |name: &str| sections.iter().find(|s| s.name == name);
    let fail = |why: &str| Err(format!("the image of {board} {why}"));

    let Some(vectors) = section(".vector_table") else { return fail("has no vector table") };
    if vectors.address != chip.flash {
        return fail("does not have its vector table at the start of flash");
    }
    let stack_pointer = elf.word(vectors.offset).ok_or("the vector table is cut off")?;
    if !(chip.ram..=chip.ram + chip.ram_size).contains(&stack_pointer) {
        return fail("starts with a stack outside RAM");
    }
    match section(".text") {
        Some(text) if text.size >= LEAST_CODE && text.address == chip.code => {}
        Some(_) => return fail("has too little code, or it is not where the plan wants it"),
        None => return fail("has no code"),
    }
    let segments = elf.segments().ok_or("the program headers are cut off")?;
    if segments.iter().any(|s| chip.is_in_settings(s)) {
        return fail("has a segment that reaches into the settings sectors: flashing it would erase them");
    }
    let in_flash =
        |s: &&Section| s.loaded && s.size > 0 && (chip.flash..chip.flash + chip.flash_size).contains(&s.stored);
    let flash: u32 = sections.iter().filter(in_flash).map(|s| s.size).sum();
    if section(".data").is_some_and(|data| data.size > MOST_DATA) {
        return fail("has memory that begins with other bytes than 0 and fills flash: what is lent must be all 0");
    }
    let stack = stack_pointer - chip.ram;
    if let Some((name, frame)) = largest_frame(&elf, &sections).filter(|(_, frame)| *frame > stack / 8 * 5) {
        return fail(&format!("has a function that takes {frame} of the {stack} bytes of stack: {name}"));
    }
    // Free flash starts after the last section; the rest of the vector table's sector is available only to sections
    // that the linker script names.
    let top = sections.iter().filter(in_flash).map(|s| s.stored + s.size).max().unwrap_or(chip.code);
    let in_ram = |s: &&Section| s.allocated && (chip.ram..chip.ram + chip.ram_size).contains(&s.address);
    // The stack grows down out of RAM, not into the data: nothing may lie below its start.
    if sections.iter().filter(in_ram).any(|s| s.size > 0 && s.address < stack_pointer) {
        return fail("has data below its stack, where an overflow would eat it");
    }
    let ram = sections.iter().filter(in_ram).map(|s| s.size).sum();
    let reached = reach::check(bytes, step_handler(board), &STEP_CALLS)?.len();
    let left = chip.flash + chip.flash_size - top;
    let (flash, ram) = ((flash, flash + left), (ram, chip.ram_size - stack));
    Ok(Image { path, flash, ram, stack, files: Vec::new(), remark: None, reached })
}

/// Returns the function with the largest stack frame, and its bytes, according to the first instructions of each
/// function, where the compiler allocates the frame.
fn largest_frame(elf: &Elf, sections: &[Section]) -> Option<(String, u32)> {
    let frame = |function: &Symbol| {
        let start = function.address & !1;
        let home = sections.iter().find(|s| s.allocated && (s.address..s.address + s.size).contains(&start))?;
        let half = |at: u32| Some(elf.half(home.offset + at - home.address)? as u16);
        let end = start + function.size.min(PROLOGUE);
        Some((start..end).step_by(2).filter_map(|at| thumb::frame(half(at)?, half(at + 2)?)).sum())
    };
    let frames = elf.symbols()?.into_iter().filter(|symbol| symbol.function);
    frames.filter_map(|function| Some((function.name.clone(), frame(&function)?))).max_by_key(|(_, frame)| *frame)
}

/// Memory map of a board's chip, as given to the linker.
struct Chip {
    flash: u32,
    flash_size: u32,
    settings: u32,
    code: u32,
    ram: u32,
    ram_size: u32,
}

impl Chip {
    fn read(board: &str) -> Result<Chip, Failure> {
        let text = crate::boards::chip(board).ok_or_else(|| format!("there is no board `{board}`"))?;
        let value = |name: &str| {
            text.lines()
                .find_map(|line| line.strip_prefix(name)?.trim_start().strip_prefix('=')?.split(';').next())
                .and_then(|value| number(value.trim()))
                .ok_or_else(|| format!("the chip of {board} does not say {name}"))
        };
        Ok(Chip {
            flash: value("CHIP_FLASH")?,
            flash_size: value("CHIP_FLASH_SIZE")?,
            settings: value("CHIP_SETTINGS")?,
            code: value("CHIP_CODE")?,
            ram: value("CHIP_RAM")?,
            ram_size: value("CHIP_RAM_SIZE")?,
        })
    }
}

impl Chip {
    /// Returns the range of the two settings sectors and everything else before the program.
    fn settings_sectors(&self) -> Range<u32> {
        self.settings..self.code
    }

    /// Returns whether loading a segment would write to the settings sectors.
    fn is_in_settings(&self, segment: &Segment) -> bool {
        segment.stored < self.code && segment.stored + segment.size > self.settings
    }
}

/// Parses a number in the linker's syntax.
fn number(text: &str) -> Option<u32> {
    if let Some(hex) = text.strip_prefix("0x") {
        u32::from_str_radix(hex, 16).ok()
    } else if let Some(k) = text.strip_suffix('K') {
        Some(k.parse::<u32>().ok()? * 1024)
    } else if let Some(m) = text.strip_suffix('M') {
        Some(m.parse::<u32>().ok()? * 1024 * 1024)
    } else {
        text.parse().ok()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_of_linker_scripts() {
        assert_eq!(number("0x08010000"), Some(0x0801_0000));
        assert_eq!(number("512K"), Some(512 * 1024));
        assert_eq!(number("4M"), Some(4 * 1024 * 1024));
        assert_eq!(number("four"), None);
    }

    #[test]
    fn every_board_says_its_sizes() {
        for board in crate::boards::BOARDS {
            let chip = Chip::read(board).unwrap();
            assert!(chip.flash < chip.settings && chip.settings < chip.code, "{board}");
        }
    }

    /// Returns a file with one loadable program header.
    fn elf_with_segment(stored: u32, size: u32) -> Vec<u8> {
        let mut bytes = vec![0_u8; 52 + 32];
        bytes[..6].copy_from_slice(b"\x7FELF\x01\x01");
        let mut put = |at: usize, word: u32| bytes[at..at + 4].copy_from_slice(&word.to_le_bytes());
        put(28, 52);
        put(42, 32 | 1 << 16);
        for (at, word) in [(0, 1), (8, stored), (12, stored), (16, size), (20, size)] {
            put(52 + at, word);
        }
        bytes
    }

    #[test]
    fn a_segment_in_the_settings_sectors_is_seen() {
        for board in crate::boards::BOARDS {
            let chip = Chip::read(board).unwrap();
            for (from, until, touches) in [
                (chip.flash, chip.settings, false),
                (chip.flash, chip.settings + 4, true),
                (chip.settings + 0x100, chip.settings + 0x200, true),
                (chip.code - 4, chip.code + 0x1000, true),
                (chip.code, chip.code + 0x1000, false),
                (chip.flash, chip.code + 0x1000, true),
            ] {
                let bytes = elf_with_segment(from, until - from);
                let segments = Elf { bytes: &bytes }.segments().unwrap();
                assert_eq!(segments.len(), 1);
                assert_eq!(chip.is_in_settings(&segments[0]), touches, "{board}: {from:#x}..{until:#x}");
            }
        }
    }

    #[test]
    fn an_image_without_code_is_refused() {
        assert!(check("qemu_mps2", b"\x7FELF\x01\x01", PathBuf::new()).is_err());
        assert!(check("qemu_mps2", &[], PathBuf::new()).is_err());
    }
}
