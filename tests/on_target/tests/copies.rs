//! Tests of the firmware's memory handling. Its own copy routine must copy each byte and change none outside the
//! target, at all lengths below 120 bytes and all alignments relative to 8 bytes. The memory for the recording must be
//! handed out only once.
#![no_std]
#![no_main]
#![allow(missing_docs, reason = "code that defmt-test generates")]

use oxmill_firmware as _;
use oxmill_on_target as _;

unsafe extern "C" {
    fn __aeabi_memcpy(to: *mut u8, from: *const u8, bytes: usize);
}

#[repr(align(8))]
struct Aligned([u8; 160]);

#[defmt_test::tests]
mod suite {
    use super::{__aeabi_memcpy, Aligned};

    #[test]
    fn what_is_copied_is_the_same_and_nothing_else_changes() {
        let mut source = Aligned([0; 160]);
        for (i, byte) in source.0.iter_mut().enumerate() {
            *byte = i as u8 | 0x80;
        }
        for length in 0..120 {
            for from in 0..8 {
                for to in 0..8 {
                    let mut target = Aligned([0x55; 160]);
                    // SAFETY: unsafe because of raw pointers; safe because both ranges end within their 160 bytes.
                    unsafe { __aeabi_memcpy(target.0.as_mut_ptr().add(8 + to), source.0.as_ptr().add(from), length) };
                    let (before, rest) = target.0.split_at(8 + to);
                    let (copied, after) = rest.split_at(length);
                    defmt::assert!(copied == &source.0[from..from + length], "{} from {} to {}", length, from, to);
                    defmt::assert!(before.iter().chain(after).all(|byte| *byte == 0x55));
                }
            }
        }
    }
    #[test]
    fn the_pages_for_the_recording_are_lent_once() {
        let first = oxmill_firmware::last_words::pages();
        defmt::assert!(first.len() == oxmill_boards::RECORDING_PAGES);
        defmt::assert!(oxmill_firmware::last_words::pages().is_empty(), "the same memory twice");
    }
}
