//! Record of a failure, in RAM that the start-up code does not initialise (`.uninit`). Before a failure resets the
//! board, `keep` stores the reason, the machine position and the line number. After the reset, `take` reads the record,
//! for the welcome line and `$RC`. The pages of the recording (`$REC`) survive a reset in the same way.
//!
//! ```text
//!  failure ──keep──▶ .uninit ──reset──▶ take ──▶ controller ──▶ host
//! ```
//! RAM keeps its contents over a reset. After a power-off the checksum is wrong, and `take` finds no record. If the
//! supply voltage drops, the record survives as long as the voltage stays above about 1.7 V.
//!
//! A record has the position and the line of the moment at which the control task last ended a run. While the machine
//! moves, that was at most 2 ms before the failure.

use crate::boards;
use core::cell::Cell;
use core::fmt::Write;
use core::mem::MaybeUninit;
use core::ptr::addr_of_mut;
use core::sync::atomic::{AtomicBool, Ordering};
use critical_section::Mutex;
use oxmill_controller::messages::{Crash, CrashKind};
use oxmill_controller::recorder::Page;

const MARK: u32 = u32::from_le_bytes(*b"last");
const TEXT: usize = 120;

/// Machine position and line number at the end of the control task's most recent run.
#[derive(Clone, Copy)]
pub struct Whereabouts {
    /// Machine position, micrometres.
    pub place: [i32; 3],
    /// N word of the running line.
    pub line: u32,
    /// Start of the last round (pass of the control loop) in that run: microseconds since power-up (wrapping).
    pub moment: u32,
}

/// The latest values from [`note`]. A static and not the resource of a task, because a failure can happen in any task.
static LAST: Mutex<Cell<Whereabouts>> = Mutex::new(Cell::new(Whereabouts { place: [0; 3], line: 0, moment: 0 }));

/// Stores position and line number, for the record of a failure that may follow. The control task calls this at the end
/// of each run.
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
// unsafe because the linker does not check the section; safe because `.uninit` is the section of cortex-m-rt for RAM
// that is not initialised, and every bit pattern is a record.
static mut RECORD: MaybeUninit<Words> = MaybeUninit::uninit();

#[unsafe(link_section = ".uninit.RECORDING")]
// unsafe because the linker does not check the section; safe because `.uninit` is the section of cortex-m-rt for RAM
// that is not initialised, and every bit pattern is a `Page`.
static mut RECORDING: MaybeUninit<[Page; boards::RECORDING_PAGES]> = MaybeUninit::uninit();

/// The record as words. Volatile access to the struct would copy each byte of the text separately and take 2 KB of
/// code.
type Words = [u32; size_of::<Kept>() / size_of::<u32>()];

/// Returns the CRC-32 of all words except the last one, which holds the CRC. The CRC shows whether there is a record:
/// the random contents of RAM after power-up do not have the right one.
fn sum(words: &Words) -> u32 {
    let mut bytes = [0; size_of::<Words>() - size_of::<u32>()];
    for (to, word) in bytes.chunks_exact_mut(size_of::<u32>()).zip(words) {
        to.copy_from_slice(&word.to_le_bytes());
    }
    boards::checksum(&bytes)
}

/// Text of limited length. Characters other than printable ASCII become blanks, and square brackets become round ones,
/// because hosts parse square brackets.
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

/// Stores the record of a failure. Interrupts must be off.
pub fn keep(kind: CrashKind, why: core::fmt::Arguments<'_>) {
    let mut line = Line { text: [0; TEXT], length: 0 };
    // Excess text is cut off.
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
        // SAFETY: unsafe because a static is written; safe because interrupts are off and only the reset follows.
        unsafe { record.add(at).write_volatile(*word) }
    }
}

/// Returns the record of a failure from before the reset; `None` if there is none, and in all later calls. Not inlined,
/// so that the set-up does not need stack for this function as well.
#[inline(never)]
pub fn take() -> Option<Crash> {
    let record = addr_of_mut!(RECORD).cast::<u32>();
    // SAFETY: unsafe because memory is read that may never have been written; safe because it is read as plain numbers,
    // for which any bit pattern is valid, before the tasks run.
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

/// Returns the pages of the recording, with their contents from before the reset. Only the first caller gets them;
/// later callers get no pages.
pub fn pages() -> &'static mut [Page] {
    static LENT: AtomicBool = AtomicBool::new(false);
    if LENT.swap(true, Ordering::Relaxed) {
        return &mut [];
    }
    // The compiler sees no write to `RECORDING`, so it could treat the contents as undefined. `black_box` prevents
    // that.
    let pages = core::hint::black_box(addr_of_mut!(RECORDING)).cast::<[Page; boards::RECORDING_PAGES]>();
    // SAFETY: unsafe because memory is read that may never have been written, and a static is borrowed for ever; safe
    // because pages are plain numbers, for which any bit pattern is valid, and only the first call gets here.
    unsafe { &mut *pages }
}
