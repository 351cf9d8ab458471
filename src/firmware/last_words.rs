//! What the program says before a failure resets the board, in RAM that the start-up code leaves alone (`.uninit`). `keep` writes what
//! failed, where the machine was and in which line; `take` reads it after the reset, for the welcome line and `$RC`. The pages of the
//! recording (`$REC`) are kept in the same way.
//!
//! ```text
//!  failure ──keep──▶ .uninit ──reset──▶ take ──▶ controller ──▶ host
//! ```
//! RAM keeps its contents over every reset but not without power: then the checksum does not fit, and nothing is found. So the
//! record of a sinking supply survives a dip that leaves RAM its 1.7 V or so, and not a power-off.
//!
//! Place and line are those of the last turn of the control task, 2 ms ago at most while something moves.

use crate::boards;
use core::cell::Cell;
use core::fmt::Write;
use core::mem::MaybeUninit;
use core::ptr::addr_of_mut;
use core::sync::atomic::{AtomicBool, Ordering};
use crc::{CRC_32_ISO_HDLC, Crc, NoTable};
use critical_section::Mutex;
use oxmill_controller::messages::{Crash, CrashKind};
use oxmill_controller::recorder::Page;

/// Bit by bit, without a table of 1 KiB.
const CRC: Crc<u32, NoTable> = Crc::<u32, NoTable>::new(&CRC_32_ISO_HDLC);
const MARK: u32 = u32::from_le_bytes(*b"last");
const TEXT: usize = 120;

/// Where the machine was when the control task last looked.
#[derive(Clone, Copy)]
pub struct Whereabouts {
    /// Machine position, micrometres.
    pub place: [i32; 3],
    /// N word of what was running.
    pub line: u32,
    /// When that was: microseconds (wrapping).
    pub moment: u32,
}

/// Kept here and not with a task, because a failure may come in any of them.
static LAST: Mutex<Cell<Whereabouts>> = Mutex::new(Cell::new(Whereabouts { place: [0; 3], line: 0, moment: 0 }));

/// For the control task, after each of its rounds.
pub fn note(last: Whereabouts) {
    critical_section::with(|cs| LAST.borrow(cs).set(last));
}

#[repr(C)]
#[derive(Clone, Copy)]
struct Kept {
    mark: u32,
    kind: u32,
    length: u32,
    text: [u8; TEXT],
    place: [i32; 3],
    line: u32,
    moment: u32,
    sum: u32,
}

#[unsafe(link_section = ".uninit.RECORD")]
// unsafe because the linker takes the section on trust; safe because the name is the one of cortex-m-rt for RAM that is
// not initialised, and every bit pattern is a record.
static mut RECORD: MaybeUninit<Words> = MaybeUninit::uninit();

#[unsafe(link_section = ".uninit.RECORDING")]
// unsafe because the linker takes the section on trust; safe because the name is the one of cortex-m-rt for RAM that is
// not initialised, and every bit pattern is a `Page`.
static mut RECORDING: MaybeUninit<[Page; boards::RECORDING_PAGES]> = MaybeUninit::uninit();

/// The record as words. A volatile access to the struct would be one for each byte of its text: 2 KB of code.
type Words = [u32; size_of::<Kept>() / size_of::<u32>()];

/// CRC-32 of all words but the last, which it is: RAM after power-up is not random enough to pass by accident.
fn sum(words: &Words) -> u32 {
    let mut digest = CRC.digest();
    for word in words.iter().take(words.len() - 1) {
        digest.update(&word.to_le_bytes());
    }
    digest.finalize()
}

/// Text of a bounded length; what is no printable ASCII becomes a blank, and brackets round ones, for the host's sake.
struct Line {
    text: [u8; TEXT],
    length: usize,
}

impl Write for Line {
    fn write_str(&mut self, text: &str) -> core::fmt::Result {
        for byte in text.bytes() {
            let Some(slot) = self.text.get_mut(self.length) else { return Err(core::fmt::Error) };
            *slot = match byte {
                b'[' => b'(',
                b']' => b')',
                b' '..=b'~' => byte,
                _ => b' ',
            };
            self.length += 1;
        }
        Ok(())
    }
}

/// Keeps what failed over the reset. Interrupts are off.
pub fn keep(kind: CrashKind, why: core::fmt::Arguments<'_>) {
    let mut line = Line { text: [0; TEXT], length: 0 };
    // What does not fit is cut off.
    let _ = line.write_fmt(why);
    let kind = CrashKind::ALL.iter().position(|k| *k == kind).unwrap_or(0) as u32;
    let (length, text) = (line.length as u32, line.text);
    let Whereabouts { place, line, moment } = critical_section::with(|cs| LAST.borrow(cs).get());
    let kept = Kept { mark: MARK, kind, length, text, place, line, moment, sum: 0 };
    // SAFETY: unsafe because a type is reinterpreted; safe because both are plain words of the same length.
    let mut words = unsafe { core::mem::transmute::<Kept, Words>(kept) };
    let sum = sum(&words);
    if let Some(last) = words.last_mut() {
        *last = sum;
    }
    let record = addr_of_mut!(RECORD).cast::<u32>();
    for (at, word) in words.iter().enumerate() {
        // SAFETY: unsafe because a static is written; safe because interrupts are off and nothing comes after.
        unsafe { record.add(at).write_volatile(*word) }
    }
}

/// The record of the program before this one, once. Not within the set-up, whose stack would have it as well.
#[inline(never)]
pub fn take() -> Option<Crash> {
    let record = addr_of_mut!(RECORD).cast::<u32>();
    // SAFETY: unsafe because memory is read that may never have been written; safe because it is read as plain numbers,
    // any of which is allowed, before the tasks run.
    let words: Words = core::array::from_fn(|at| unsafe { record.add(at).read_volatile() });
    // SAFETY: as in `keep`; no task runs yet.
    unsafe { record.write_volatile(0) };
    // SAFETY: as in `keep`.
    let kept = unsafe { core::mem::transmute::<Words, Kept>(words) };
    if kept.mark != MARK || kept.sum != sum(&words) {
        return None;
    }
    let text = kept.text.get(..kept.length as usize)?;
    let kind = *CrashKind::ALL.get(kept.kind as usize)?;
    Some(Crash {
        kind,
        text: heapless::Vec::from_slice(text).ok()?,
        place: kept.place,
        line: kept.line,
        moment: kept.moment,
    })
}

/// The pages for the recording, as they were before this start, for the first caller. Any other caller gets none.
pub fn pages() -> &'static mut [Page] {
    static LENT: AtomicBool = AtomicBool::new(false);
    if LENT.swap(true, Ordering::Relaxed) {
        return &mut [];
    }
    // What lies there is not known to the compiler, which must not take it for nothing.
    let pages = core::hint::black_box(addr_of_mut!(RECORDING)).cast::<[Page; boards::RECORDING_PAGES]>();
    // SAFETY: unsafe because memory is read that may never have been written, and a static is lent for ever; safe because pages
    // are plain numbers, any of which is allowed, and only the first call comes here.
    unsafe { &mut *pages }
}
