//! Builds an image and checks it: the linker also accepts an image without a vector table or without code.

use crate::elf::{self, Elf, Function};
use crate::paths::cargo_for_boards;
use crate::reach::{self, Allowed};
use crate::{Failure, QEMU_BOARD, TARGET, dfuse, flashable, root, run, sizes, thumb};
use object::{Object, ObjectSection};
use std::fmt;
use std::fs;
use std::ops::Range;
use std::path::{Path, PathBuf};

/// Minimum size of the code, bytes: an image with less cannot contain the controller.
const LEAST_CODE: u64 = 16 * 1024;

/// Maximum size of `.data` (statics that do not start as 0), bytes. If `.data` is larger, it contains some of the
/// controller's memory. It must not, because the initial values of `.data` take up flash. So the controller's memory
/// must start as all 0.
const MOST_DATA: u64 = 2 * 1024;
/// Number of bytes at the start of a function that are searched for the instructions that reserve its stack.
const PROLOGUE: u32 = 32;

/// Returns the interrupt handler of the step task, as in `firmware!` of `src/firmware/main.rs`.
fn step_handler(board: &str) -> &'static str {
    if board == QEMU_BOARD { "TIMER0" } else { "TIM5" }
}

/// Calls through a register that are allowed in the step interrupt. All of them wake the task `control`. A queue or
/// signal calls the waker of the task, and the waker sets the interrupt of the task's dispatcher pending.
const STEP_CALLS: [Allowed; 6] = [
    Allowed { function: "step_timer::", targets: &["executor::waker_wake", "executor::waker_drop"] },
    Allowed { function: "channel::Receiver<", targets: &["executor::waker_wake", "executor::waker_drop"] },
    Allowed { function: "executor::waker_wake", targets: &["FnOnce"] },
    // Images built for size make the same calls from these functions, which are not inlined there.
    Allowed { function: "wait_queue::DoublyLinkedList<", targets: &["executor::waker_wake", "executor::waker_drop"] },
    Allowed { function: "signal::SignalWriter<", targets: &["executor::waker_wake", "executor::waker_drop"] },
    Allowed {
        function: "CriticalSectionWakerRegistration",
        targets: &["executor::waker_wake", "executor::waker_drop"],
    },
];

/// An image that has passed all checks.
pub struct Image {
    /// Path of the ELF file, `target/boards/BOARD.elf`.
    pub path: PathBuf,
    flash: (u32, u32),
    ram: (u32, u32),
    stack: u32,
    /// Files for flashing tools, `.hex` and `.dfu`; empty for QEMU's board.
    pub files: Vec<PathBuf>,
    /// Message of [`sizes::judge`], such as that the image has grown; `None` if there is nothing to report.
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

/// Builds and checks the image of a board. Writes the ELF file, and the files for flashing tools, to `target/boards`.
pub fn build(board: &str) -> Result<Image, Failure> {
    let profile = crate::boards::profile(board);
    let mut build = cargo_for_boards("build", profile)?;
    let image = crate::boards::image(board);
    // All boards with the same image share one build. The build contains the pin table of the first of these boards.
    // Below, the table of `board` replaces it in the copy.
    run(build.env_remove(crate::BOARD).args(["--locked", "--package", "oxmill-firmware", "--features", image]))?;
    let built = root().join("target").join(TARGET).join(profile).join("oxmill-firmware");
    // Every board links to the same file name; this copy survives the build for the next board.
    let folder = root().join("target/boards");
    let path = folder.join(format!("{board}.elf"));
    let bytes = fs::read(&built).map_err(|error| format!("{}: {error}", built.display()))?;
    let bytes = if board == QEMU_BOARD {
        bytes
    } else {
        oxmill_tables::image_file::write(&bytes, &crate::boards::described(board)?.table())?
    };
    let copy = fs::create_dir_all(&folder).and_then(|()| fs::write(&path, &bytes));
    copy.map_err(|error| format!("{}: {error}", path.display()))?;
    let mut checked = check(board, &bytes, path)?;
    if board != QEMU_BOARD {
        checked.files = write(board, &bytes, &folder)?;
    }
    checked.remark = sizes::judge(image, checked.flash.0, checked.ram.0)?;
    Ok(checked)
}

/// Writes the files for flashing tools, then reads them back and checks their contents.
fn write(board: &str, bytes: &[u8], folder: &Path) -> Result<Vec<PathBuf>, Failure> {
    let chip = Chip::read(board)?;
    let stretches = flashable::stretches(&elf::parse(bytes)?, &chip.settings_sectors())
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
    let elf = elf::parse(bytes)?;
    let section = |name| elf.section_by_name(name);
    let fail = |why: &str| Err(format!("the image of {board} {why}"));

    let Some(vectors) = section(".vector_table") else { return fail("has no vector table") };
    if vectors.address() != u64::from(chip.flash) {
        return fail("does not have its vector table at the start of flash");
    }
    let first = vectors.data().ok().and_then(|data| data.first_chunk());
    let stack_pointer = u32::from_le_bytes(*first.ok_or("the vector table is cut off")?);
    if !(chip.ram..=chip.ram + chip.ram_size).contains(&stack_pointer) {
        return fail("starts with a stack outside RAM");
    }
    match section(".text") {
        Some(text) if text.size() >= LEAST_CODE && text.address() == u64::from(chip.code) => {}
        Some(_) => return fail("has too little code, or it is not where the plan wants it"),
        None => return fail("has no code"),
    }
    let segments = elf::segments(&elf).ok_or("a segment is cut off")?;
    if segments.iter().any(|(stored, bytes)| chip.is_in_settings(*stored, bytes.len() as u32)) {
        return fail("has a segment that reaches into the settings sectors: flashing it would erase them");
    }
    let stored = elf.sections().filter_map(|section| elf::stored(&elf, &section));
    let is_flash = |s: &Range<u32>| !s.is_empty() && (chip.flash..chip.flash + chip.flash_size).contains(&s.start);
    let in_flash: Vec<Range<u32>> = stored.filter(is_flash).collect();
    let flash: u32 = in_flash.iter().map(|s| s.end - s.start).sum();
    if section(".data").is_some_and(|data| data.size() > MOST_DATA) {
        return fail("has memory that begins with other bytes than 0 and fills flash: what is lent must be all 0");
    }
    let stack = stack_pointer - chip.ram;
    if let Some((name, frame)) = largest_frame(&elf).filter(|(_, frame)| *frame > stack / 8 * 5) {
        return fail(&format!("has a function that takes {frame} of the {stack} bytes of stack: {name}"));
    }
    // Only the flash after the last section counts as free. The rest of the vector table's sector does not count: the
    // linker puts only those sections there that its script assigns to this sector.
    let top = in_flash.iter().map(|s| s.end).max().unwrap_or(chip.code);
    let memory = elf.sections().filter_map(|section| elf::memory(&section));
    let in_ram: Vec<Range<u32>> = memory.filter(|s| (chip.ram..chip.ram + chip.ram_size).contains(&s.start)).collect();
    // The stack is below all data, so that an overflow leaves RAM instead of overwriting data.
    if in_ram.iter().any(|s| !s.is_empty() && s.start < stack_pointer) {
        return fail("has data below its stack, where an overflow would eat it");
    }
    let ram = in_ram.iter().map(|s| s.end - s.start).sum();
    let reached = reach::check(&elf, step_handler(board), &STEP_CALLS)?.len();
    let left = chip.flash + chip.flash_size - top;
    let (flash, ram) = ((flash, flash + left), (ram, chip.ram_size - stack));
    Ok(Image { path, flash, ram, stack, files: Vec::new(), remark: None, reached })
}

/// Returns the function with the largest stack frame, and the frame's size in bytes, as read from the first
/// instructions of each function.
fn largest_frame<'a>(elf: &Elf<'a>) -> Option<(&'a str, u32)> {
    let half = |at| elf::half(elf, at);
    let frame = |function: &Function<'_>| {
        let prologue = function.address..function.address + function.size.min(PROLOGUE);
        prologue.step_by(2).filter_map(|at| thumb::frame(half(at)?, half(at + 2)?)).sum()
    };
    elf::functions(elf).map(|function| (function.name, frame(&function))).max_by_key(|(_, frame)| *frame)
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
        let text =
            oxmill_images::chip(crate::boards::image(board)).ok_or_else(|| format!("there is no board `{board}`"))?;
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
    /// Returns the range from the start of the settings sectors to the start of the program.
    fn settings_sectors(&self) -> Range<u32> {
        self.settings..self.code
    }

    /// Returns `true` if a segment of `size` bytes at the address `stored` overlaps the settings sectors. A tool that
    /// loads this segment would overwrite settings.
    fn is_in_settings(&self, stored: u32, size: u32) -> bool {
        stored < self.code && stored + size > self.settings
    }
}

/// Parses a number in the linker's syntax: `0x08010000`, `512K`, `4M` or `1024`.
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
        for board in crate::boards::names() {
            let chip = Chip::read(board).unwrap();
            assert!(chip.flash < chip.settings && chip.settings < chip.code, "{board}");
        }
    }

    #[test]
    fn a_segment_in_the_settings_sectors_is_seen() {
        for board in crate::boards::names() {
            let chip = Chip::read(board).unwrap();
            for (from, until, touches) in [
                (chip.flash, chip.settings, false),
                (chip.flash, chip.settings + 4, true),
                (chip.settings + 0x100, chip.settings + 0x200, true),
                (chip.code - 4, chip.code + 0x1000, true),
                (chip.code, chip.code + 0x1000, false),
                (chip.flash, chip.code + 0x1000, true),
            ] {
                assert_eq!(chip.is_in_settings(from, until - from), touches, "{board}: {from:#x}..{until:#x}");
            }
        }
    }

    #[test]
    fn an_image_without_code_is_refused() {
        assert!(check("qemu_mps2", b"\x7FELF\x01\x01", PathBuf::new()).is_err());
        assert!(check("qemu_mps2", &[], PathBuf::new()).is_err());
    }
}
