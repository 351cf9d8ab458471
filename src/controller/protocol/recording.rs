//! Prints a recording as text: the `[REC:...]` lines of `$REC`, which `oxmill replay` reads.

use super::text::{END, Text, length, put, whole};
use crate::messages::{CrashKind, Noted, Record, Recorded, Standing, Stopping};
use crate::units::Coordinate;

const MICROSECONDS: u64 = 1_000_000;

const BEGIN: &[u8] = b"[REC:";
const CLOSE: &[u8] = b"]";

/// Appends one item of the `$REC` listing. Times are printed in ticks of the step clock; `hz` is its frequency in ticks
/// per second.
pub fn item(out: &mut Text, hz: u32, item: &Recorded) {
    put(out, BEGIN);
    match item {
        Recorded::Board { name, step_clock_hz } => {
            put(out, b"oxmill recording 1]\r\n[REC:board ");
            put(out, name.as_bytes());
            put(out, b" ");
            number(out, *step_clock_hz);
        }
        Recorded::Record(record) => stored(out, record),
        Recorded::Begin(time) => {
            put(out, b"begin ");
            moment(out, hz, *time);
        }
        Recorded::Noted(time, noted) => {
            moment(out, hz, *time);
            put(out, b" ");
            entry(out, noted);
        }
        Recorded::End => put(out, b"end"),
    }
    put(out, CLOSE);
    put(out, END);
}

/// Appends a time, converted from microseconds to ticks of the step clock. Whole seconds are converted separately, so
/// that times of many days do not overflow.
#[inline(never)]
fn moment(out: &mut Text, hz: u32, time: u64) {
    let hz = u64::from(hz);
    put_count(out, time / MICROSECONDS * hz + time % MICROSECONDS * hz / MICROSECONDS);
}

fn stored(out: &mut Text, record: &Record) {
    put(out, b"record ");
    number(out, u32::from(record.key));
    put(out, b" ");
    for byte in &record.value {
        hex(out, *byte);
    }
}

// The following functions are not inlined, to save flash: they have many callers, and these callers rarely run.

#[inline(never)]
fn put_count(out: &mut Text, value: u64) {
    whole(out, value);
}

#[inline(never)]
fn number(out: &mut Text, value: u32) {
    put_count(out, u64::from(value));
}

#[inline(never)]
fn hex(out: &mut Text, byte: u8) {
    for digit in [byte >> 4, byte & 0xF] {
        put(out, &[if digit < 10 { b'0' + digit } else { b'a' - 10 + digit }]);
    }
}

/// Appends an input word in hexadecimal, with six digits: inputs use at most 24 bits.
#[inline(never)]
fn hex_word(out: &mut Text, word: u32) {
    let [_, bytes @ ..] = word.to_be_bytes();
    for byte in bytes {
        hex(out, byte);
    }
}

/// Appends bytes that a host has sent, with Rust's escapes. Square brackets are escaped too, because they enclose each
/// line of the listing.
fn escaped(out: &mut Text, bytes: &[u8]) {
    for byte in bytes {
        match byte {
            b'\n' => put(out, b"\\n"),
            b'\r' => put(out, b"\\r"),
            b'\\' => put(out, b"\\\\"),
            b'[' | b']' | 0..0x20 | 0x7F.. => {
                put(out, b"\\x");
                hex(out, *byte);
            }
            plain => put(out, &[*plain]),
        }
    }
}

/// Appends a blank and a number.
#[inline(never)]
fn integer(out: &mut Text, value: i64) {
    put(out, if value < 0 { b" -" } else { b" " });
    put_count(out, value.unsigned_abs());
}

#[inline(never)]
fn integers(out: &mut Text, values: &[i32]) {
    for value in values {
        integer(out, i64::from(*value));
    }
}

fn entry(out: &mut Text, entry: &Noted) {
    match entry {
        Noted::PowerUp => put(out, b"power"),
        Noted::Host(bytes) => {
            put(out, b"host ");
            escaped(out, bytes);
        }
        Noted::More => put(out, b"more"),
        Noted::Command(byte) => {
            put(out, b"host ");
            escaped(out, &[*byte]);
        }
        Noted::Inputs { active, tripped } => {
            put(out, b"inputs ");
            hex_word(out, *active);
            put(out, b" ");
            hex_word(out, *tripped);
        }
        Noted::Step(stopping, counters) => {
            put(out, stopping_name(*stopping));
            integers(out, counters);
        }
        Noted::Stored(true) => put(out, b"stored"),
        Noted::Stored(false) => put(out, b"unstored"),
        Noted::Connected => put(out, b"connect"),
        Noted::Disconnected => put(out, b"disconnect"),
        Noted::Damaged => put(out, b"damaged"),
        Noted::Cut => put(out, b"cut"),
        Noted::Rest { counters, blocks } => {
            put(out, b"rest ");
            number(out, *blocks);
            integers(out, counters);
        }
        Noted::Standing { standing, blocks } => put_standing(out, standing, *blocks),
        Noted::Ended { crash, place, line } => {
            put(out, b"ended ");
            put(out, crash.map_or(b"reset", crash_name));
            if crash.is_some() {
                put(out, b" N");
                number(out, *line);
                for axis in place {
                    put(out, b" ");
                    length(out, Coordinate(i64::from(*axis) * 10_000), false);
                }
            }
        }
    }
}

/// Appends a state from which a replay can begin. First come the flags (`t`: position trusted, `l`: locked, `i`:
/// inches), the hash of the blocks, the tool and the inputs. Then come the step counter and the position of each axis,
/// and last the modal state as words.
fn put_standing(out: &mut Text, standing: &Standing, blocks: u32) {
    put(out, b"state ");
    let letters = [(standing.trusted, b't'), (standing.locked, b'l'), (standing.inches, b'i')];
    for (_, letter) in letters.into_iter().filter(|(on, _)| *on) {
        put(out, &[letter]);
    }
    put(out, b". ");
    number(out, blocks);
    put(out, b" ");
    number(out, standing.tool);
    put(out, b" ");
    hex_word(out, standing.active);
    for (counter, place) in standing.counters.iter().zip(&standing.place) {
        integer(out, i64::from(*counter));
        integer(out, place.0);
    }
    put(out, b" ");
    put(out, &standing.words);
}

const fn stopping_name(stopping: Stopping) -> &'static [u8] {
    match stopping {
        Stopping::AtRest => b"stopped",
        Stopping::Moving => b"cut-off",
        Stopping::Probed => b"probed",
        Stopping::Underrun => b"underrun",
        Stopping::Miscounted => b"miscounted",
    }
}

const fn crash_name(kind: CrashKind) -> &'static [u8] {
    match kind {
        CrashKind::Panic => b"panic",
        CrashKind::Fault => b"fault",
        CrashKind::StackOverflow => b"stack",
        CrashKind::Stuck => b"stuck",
        CrashKind::Voltage => b"voltage",
        CrashKind::Clock => b"clock",
        CrashKind::Board => b"board",
    }
}
