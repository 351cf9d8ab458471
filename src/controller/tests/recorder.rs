//! Tests of the ring of RAM pages in which the recorder keeps what came in. After a reset the ring can be complete,
//! wrapped around, cut short, or filled with noise.

#![cfg(feature = "full")]

use crate::board::{PROFILE, started};
use oxmill_controller::Controller;
use oxmill_controller::messages::{
    Crash, CrashKind, Event, LineByte, Noted, Realtime, Recorded, ResetCause, Restart, Room, Sensed, Signals,
};
use oxmill_controller::recorder::{Page, Recorder};
use oxmill_controller::units::Instant;
use proptest::prelude::*;

type Board = Controller<3>;
type Ring = Recorder<Vec<Page>>;

const SOFTWARE: Restart = Restart { cause: ResetCause::Software, crash: None, is_recorded: false };

fn board() -> Box<Board> {
    let mut board = started(PROFILE, 16);
    // Takes and drops the welcome line and the startup lines.
    while board.output(Instant::from_ticks(0), Room { step: true, reply: true }).is_some() {}
    board
}

fn line(ring: &mut Ring, board: &Board, time: u64, epoch: u16, text: &str) {
    for byte in text.bytes() {
        ring.record(Instant::from_ticks(time), &Event::<3>::Line(LineByte { byte, epoch, damaged: false }), board);
    }
}

/// Returns the entries that the listing (`$REC`) would show, each with its time in microseconds. Leaves out the other
/// parts, such as the board and the start time.
fn entries(ring: &mut Ring) -> Vec<(u64, Noted)> {
    let mut found = Vec::new();
    let mut more = true;
    let mut first = true;
    while more {
        ring.read(
            first,
            ("test", 1_000_000),
            |_| None,
            |piece| match piece {
                Recorded::Noted(time, entry) => found.push((*time, entry.clone())),
                Recorded::End => more = false,
                _ => {}
            },
        );
        first = false;
    }
    found
}

fn host(text: &str) -> Noted {
    Noted::Host(heapless::Vec::from_slice(text.as_bytes()).unwrap())
}

/// Returns a copy of the pages, as RAM keeps them over a reset, for the next recorder.
fn pages(ring: &Ring) -> Vec<Page> {
    ring.pages().to_vec()
}

fn of_bytes(bytes: &[u8]) -> Vec<Page> {
    bytes.chunks(256).map(|page| Page::of_bytes(page.try_into().unwrap()).unwrap()).collect()
}

#[test]
fn what_came_in_is_listed_with_its_time() {
    let board = board();
    let mut ring = Ring::begin(vec![Page::EMPTY; 4], &Restart::POWER);
    assert!(!ring.is_kept());
    line(&mut ring, &board, 10, 0, "G1X");
    ring.record(Instant::from_ticks(500), &Event::<3>::Realtime(Realtime::Status), &board);
    line(&mut ring, &board, 1_000, 0, "10\n");
    ring.more_waits();
    ring.record(Instant::from_ticks(70_000), &Event::<3>::Realtime(Realtime::FeedHold), &board);
    let door = Sensed { signals: Signals { door: true, ..Signals::NONE }, ..Sensed::default() };
    ring.record(Instant::from_ticks(70_000), &Event::<3>::Signals(door), &board);
    let inputs = Noted::Inputs { active: 1 << 9, tripped: 0 };
    let expected = [
        (0, Noted::PowerUp),
        (1_000, host("G1X10\n")),
        (1_000, Noted::More),
        (70_000, Noted::Command(b'!')),
        (70_000, inputs),
    ];
    assert_eq!(entries(&mut ring), expected);
}

#[test]
fn bytes_of_before_a_reset_are_left_out_and_those_behind_it_are_not() {
    let board = board();
    let mut ring = Ring::begin(vec![Page::EMPTY; 4], &Restart::POWER);
    // The first byte that was sent after the reset (epoch 1) arrives before the reset itself.
    line(&mut ring, &board, 10, 1, "Y");
    ring.record(Instant::from_ticks(20), &Event::<3>::Realtime(Realtime::Reset), &board);
    line(&mut ring, &board, 30, 0, "G1X10\n");
    line(&mut ring, &board, 40, 1, "2\n");
    assert_eq!(entries(&mut ring)[1..], [(20, Noted::Command(0x18)), (40, host("Y2\n"))]);
}

#[test]
fn a_ring_that_has_gone_round_begins_with_a_whole_entry() {
    let board = board();
    let mut ring = Ring::begin(vec![Page::EMPTY; 3], &Restart::POWER);
    let text = |n: u64| format!("G1X{n}Y-{n}F{n}\n");
    for n in 0..500 {
        line(&mut ring, &board, n * 2_000, 0, &text(n));
    }
    let found = entries(&mut ring);
    assert!((10..60).contains(&found.len()), "{}", found.len());
    // All entries are complete and have their time, except the first, whose beginning may have been overwritten.
    for (n, entry) in (0..500).rev().zip(found.iter().skip(1).rev()) {
        assert_eq!(*entry, (n * 2_000, host(&text(n))));
    }
}

#[test]
fn after_a_reset_it_is_kept_until_a_program_begins() {
    let mut board = board();
    let mut ring = Ring::begin(vec![Page::EMPTY; 4], &Restart::POWER);
    line(&mut ring, &board, 1_000_000_000_000, 0, "N7G1X10\n");
    let before = pages(&ring);
    let text = heapless::Vec::from_slice(b"x").unwrap();
    let moment = 1_000_000_004_321_u64 as u32;
    let crash = Crash { kind: CrashKind::Stuck, text, place: [1, -2, 3], line: 7, moment };
    let restart = Restart { crash: Some(crash), ..SOFTWARE };
    let mut ring = Ring::begin(before, &restart);
    assert!(ring.is_kept());
    let ended = Noted::Ended { crash: Some(CrashKind::Stuck), place: [1, -2, 3], line: 7 };
    let found = entries(&mut ring);
    assert_eq!(found[1..], [(1_000_000_000_000, host("N7G1X10\n")), (1_000_000_004_321, ended)]);
    // On a locked machine, the lines of a job are refused, so they do not overwrite the recording. `$` lines and
    // another reset do not overwrite it, either.
    board.restarted(restart);
    line(&mut ring, &board, 10, 0, "G1X5\n");
    let mut ring = Ring::begin(pages(&ring), &SOFTWARE);
    line(&mut ring, &board, 20, 0, "$X\n");
    assert_eq!(entries(&mut ring), found);
    let unlocked = self::board();
    line(&mut ring, &unlocked, 30, 0, "$$\n\n");
    assert_eq!(entries(&mut ring), found);
    line(&mut ring, &unlocked, 40, 0, "G4P1\n");
    assert!(!ring.is_kept());
    let found = entries(&mut ring);
    assert!(matches!(found[0], (40, Noted::Standing { .. })), "{found:?}");
    assert_eq!(found[1..], [(40, host("G4P1\n"))]);
}

/// A failure is stored with `moment`, the time of the last note of position and line by the control task. If the line
/// that caused the failure came later than `moment`, the failure is listed right after this line.
#[test]
fn a_failure_in_the_line_that_came_last_comes_right_behind_it() {
    let board = board();
    let ended_at = |time: u64, moment: u64| {
        let mut ring = Ring::begin(vec![Page::EMPTY; 4], &Restart::POWER);
        line(&mut ring, &board, time, 0, "G1X10\n");
        let text = heapless::Vec::from_slice(b"x").unwrap();
        let crash = Crash { kind: CrashKind::Panic, text, place: [0; 3], line: 0, moment: moment as u32 };
        let mut ring = Ring::begin(pages(&ring), &Restart { crash: Some(crash), ..SOFTWARE });
        let Some((at, Noted::Ended { .. })) = entries(&mut ring).pop() else { panic!("no end") };
        at
    };
    assert_eq!(ended_at(5_000_000, 4_900_000), 5_000_000);
    // Here the lower 32 bits of the time wrap between `moment` and the line. In the case below, the failure comes an
    // hour after the line.
    assert_eq!(ended_at((1 << 32) + 1_000, (1 << 32) - 1_000), (1 << 32) + 1_000);
    assert_eq!(ended_at(5_000_000, 3_605_000_000), 3_605_000_000);
}

#[test]
fn a_page_that_is_not_what_was_written_is_none() {
    let board = board();
    let mut ring = Ring::begin(vec![Page::EMPTY; 4], &Restart::POWER);
    for n in 0..30 {
        line(&mut ring, &board, n, 0, "G1X10Y20Z30F600\n");
    }
    let whole = entries(&mut ring).len();
    let mut bytes: Vec<u8> = Page::bytes_of(&pages(&ring)).collect();
    // Damage a byte of an entry in the first page.
    bytes[60] ^= 4;
    let mut ring = Ring::begin(of_bytes(&bytes), &SOFTWARE);
    let left = entries(&mut ring).len();
    assert!(ring.is_kept() && left > 0 && left < whole, "{left} of {whole}");
}

/// Each jog cancel starts an epoch. The number of the epoch shows which line bytes were sent before the jog cancel,
/// and which after it. The number wraps, because a machine can be jogged for weeks without a reset.
#[test]
fn lines_behind_very_many_jog_cancels_are_recorded() {
    let board = board();
    let mut ring = Ring::begin(vec![Page::EMPTY; 4], &Restart::POWER);
    let mut epoch = 0_u16;
    for n in 0..200_000_u64 {
        ring.record(Instant::from_ticks(n), &Event::<3>::Realtime(Realtime::JogCancel), &board);
        epoch = epoch.wrapping_add(1);
        if n % 1_000 == 0 {
            line(&mut ring, &board, n, epoch, "G1X10\n");
            assert_eq!(entries(&mut ring).last(), Some(&(n, host("G1X10\n"))), "behind {n} jog cancels");
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 300, ..ProptestConfig::default() })]
    /// The listing contains all recorded input and nothing else. Text may be recorded in pieces or byte by byte, after
    /// pauses of any length.
    #[test]
    fn nothing_is_left_out(script in prop::collection::vec((prop_oneof![Just(0_u64), 1..200_u64, any::<u32>().prop_map(u64::from)], 0..6_u8, prop_oneof![0..20_usize, 60..70_usize, 120..140_usize, 0..260_usize], 1..40_usize), 1..40)) {
        let board = board();
        let mut ring = Ring::begin(vec![Page::EMPTY; 64], &Restart::POWER);
        let (mut now, mut expected) = (0, Vec::new());
        for (number, (pause, kind, length, piece)) in script.into_iter().enumerate() {
            now += pause;
            let text: Vec<u8> = (0..length).map(|at| b'A' + ((number + at) % 26) as u8).collect();
            match kind {
                0 => ring.record(Instant::from_ticks(now), &Event::<3>::Realtime(Realtime::FeedHold), &board),
                1 => line(&mut ring, &board, now, 0, std::str::from_utf8(&text).unwrap()),
                _ => text.chunks(piece).for_each(|piece| ring.record_text(Instant::from_ticks(now), 0, piece, &board)),
            }
            if kind == 0 {
                expected.push(b'!');
            } else {
                expected.extend(&text);
                line(&mut ring, &board, now, 0, "\n");
                expected.push(b'\n');
            }
        }
        let listed: Vec<u8> = entries(&mut ring).into_iter().flat_map(|(_, entry)| match entry {
            Noted::Host(bytes) => bytes.to_vec(),
            Noted::Command(byte) => vec![byte],
            _ => Vec::new(),
        }).collect();
        prop_assert_eq!(String::from_utf8(listed).unwrap(), String::from_utf8(expected).unwrap());
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 300, ..ProptestConfig::default() })]
    /// Any contents of RAM, such as those after power-up, are listed or discarded without a panic. The next recording
    /// overwrites them.
    #[test]
    fn any_bytes_are_listed(noise in prop::collection::vec(any::<u8>(), 4 * 256), damage in prop::collection::vec((0..1024_usize, any::<u8>()), 0..6), real in any::<bool>(), seal in any::<bool>()) {
        let board = board();
        let mut bytes = noise;
        if real {
            let mut ring = Ring::begin(vec![Page::EMPTY; 4], &Restart::POWER);
            for n in 0..200 {
                line(&mut ring, &board, n * 777, 0, "G1X10Y20Z30F600\n");
                ring.record(Instant::from_ticks(n * 777), &Event::<3>::Connected, &board);
            }
            bytes = Page::bytes_of(&pages(&ring)).collect();
        }
        for (at, byte) in damage {
            bytes[at] = byte;
        }
        let mut pages = of_bytes(&bytes);
        if seal {
            // Sealed pages have a valid mark, number and sum, so the recorder accepts them whatever bytes they hold.
            pages.iter_mut().enumerate().for_each(|(number, page)| page.seal(number as u32));
        }
        let mut ring = Ring::begin(pages, &SOFTWARE);
        prop_assert!(entries(&mut ring).len() < 2_000);
        prop_assert!(!seal || ring.is_kept());
        line(&mut ring, &board, 5, 0, "G1X10\n");
        let found = entries(&mut ring);
        prop_assert_eq!(found.last(), Some(&(5, host("G1X10\n"))));
    }

    /// After a reset at any time, the ring still has all complete lines that came before, apart from old ones that
    /// were overwritten.
    #[test]
    fn a_reset_at_any_moment_leaves_what_was_there(count in 1..2_000_usize) {
        let board = board();
        let mut ring = Ring::begin(vec![Page::EMPTY; 8], &Restart::POWER);
        let text = "G1X1.5F600\n".repeat(200);
        line(&mut ring, &board, 9, 0, &text[..count]);
        let mut ring = Ring::begin(pages(&ring), &SOFTWARE);
        let said: Vec<u8> = entries(&mut ring).iter().flat_map(|(_, entry)| match entry {
            Noted::Host(bytes) => bytes.to_vec(),
            _ => Vec::new(),
        }).collect();
        // An incomplete line is not listed, because it has had no effect yet.
        let ended = count - count % 11;
        prop_assert!(text.as_bytes()[..ended].ends_with(&said));
        prop_assert!(said.len() == ended || count > 1_500, "{} of {}", said.len(), count);
    }
}
