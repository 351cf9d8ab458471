//! The UART of a board without its registers: out of the ring between its interrupt and the task that reads it nothing comes
//! out of order, and no byte is missing without a word at its place; and what is sent leaves the other ring as it was put in.

use oxmill_boards::calls::is_stop;
use oxmill_boards::received::{Call, FOR_STOPS, Next, ROOM, Received};
use oxmill_boards::sent::{self, Sent};
use proptest::prelude::*;
use std::collections::VecDeque;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread;

/// What happens to a ring.
#[derive(Clone, Debug)]
enum Step {
    /// So many bytes come.
    Come(usize),
    /// One is missing.
    Miss,
    /// The task takes so many, one by one.
    Take(usize),
    /// The task takes so many of those that are ready in a row.
    Pass(usize),
    /// The processor stands while so many come by DMA.
    Stand(u32),
}

fn step() -> impl Strategy<Value = Step> {
    prop_oneof![
        4 => (1_usize..40).prop_map(Step::Come),
        1 => (1_usize..600).prop_map(Step::Come),
        1 => Just(Step::Miss),
        4 => (1_usize..40).prop_map(Step::Take),
        2 => (1_usize..600).prop_map(Step::Pass),
        1 => (0_u32..600).prop_map(Step::Stand),
    ]
}

/// Bytes that count up, and how they come out.
struct Stream {
    ring: Received,
    sent: usize,
    /// What must come out: numbers of bytes, and `None` where some are missing.
    expected: VecDeque<Option<u8>>,
    /// All that comes is dropped until the ring is empty.
    drops: bool,
}

impl Stream {
    fn is_missing_something(&self) -> bool {
        self.expected.iter().any(Option::is_none)
    }

    fn miss(&mut self) {
        if self.is_missing_something() || self.drops {
            self.drops = true;
        } else {
            self.expected.push_back(None);
        }
    }

    fn come(&mut self, count: usize) {
        for _ in 0..count {
            let byte = self.sent as u8;
            self.sent += 1;
            let waiting = self.expected.iter().flatten().count();
            let kept = self.ring.keep(byte, false);
            assert_eq!(kept, (waiting < (ROOM - FOR_STOPS) as usize && !self.drops).then_some(waiting as u32));
            if kept.is_some() { self.expected.push_back(Some(byte)) } else { self.miss() }
        }
    }

    /// What is next, by the rules.
    fn next(&mut self) -> Option<Option<u8>> {
        let next = self.expected.pop_front();
        if next.is_none() && std::mem::take(&mut self.drops) { Some(None) } else { next }
    }

    fn take(&mut self) {
        let told = match self.ring.next() {
            Next::Byte(byte) => Some(Some(byte)),
            Next::Missing => Some(None),
            Next::Nothing => None,
        };
        assert_eq!(told, self.next());
    }

    fn pass(&mut self, most: usize) {
        let ready = self.ring.ready();
        let ready = ready[..most.min(ready.len())].to_vec();
        for byte in &ready {
            assert_eq!(self.next(), Some(Some(*byte)));
        }
        self.ring.pass(ready.len());
    }

    /// As `shelter` does: the bytes go where the ring says, without an interrupt.
    fn stand(&mut self, count: u32) {
        let waiting = self.expected.iter().flatten().count() as u32;
        let (address, room) = self.ring.place();
        assert!(room <= ROOM - waiting && (waiting > 64 || room == ROOM - waiting));
        let count = count.min(room);
        for k in 0..count as usize {
            // SAFETY: unsafe because of a raw address; safe because it is that of an atomic of the ring, which lies within
            // the room, and no reference to plain bytes of it is alive.
            unsafe { ((address + k) as *mut u8).write(self.sent as u8) };
            // What has been dropped so far has its place in front of them only if the ring was empty; else it is told late.
            self.expected.push_back(Some(self.sent as u8));
            self.sent += 1;
        }
        self.ring.placed(count);
    }
}

proptest! {
    #[test]
    fn bytes_come_out_as_they_went_in(steps in prop::collection::vec(step(), 1..60)) {
        let mut stream = Stream { ring: Received::new(), sent: 0, expected: VecDeque::new(), drops: false };
        for step in steps {
            match step {
                Step::Come(count) => stream.come(count),
                Step::Miss => {
                    stream.ring.miss();
                    stream.miss();
                }
                Step::Take(count) => (0..count).for_each(|_| stream.take()),
                Step::Pass(count) => stream.pass(count),
                Step::Stand(count) => stream.stand(count),
            }
        }
        // All of it, and the end.
        for _ in 0..ROOM + 3 {
            stream.take();
        }
        prop_assert_eq!(stream.ring.next(), Next::Nothing);
    }
}

/// A command that stops the machine is kept where all else is dropped.
#[test]
fn a_stop_is_not_dropped() {
    let ring = Received::new();
    ring.miss();
    ring.miss();
    assert_eq!((ring.keep(b'X', false), ring.keep(b'!', true), ring.keep(b'X', false)), (None, Some(0), None));
    assert_eq!([0; 4].map(|_| ring.next()), [Next::Missing, Next::Byte(b'!'), Next::Missing, Next::Nothing]);
}

/// What was lost before a reset is void with all else.
#[test]
fn losses_before_a_reset_are_told_in_front_of_it() {
    let ring = Received::new();
    ring.miss();
    ring.miss();
    ring.forget_losses();
    assert_eq!((ring.keep(0x18, true), ring.keep(b'$', false)), (Some(0), Some(1)));
    let told = [Next::Missing, Next::Byte(0x18), Next::Byte(b'$'), Next::Nothing];
    assert_eq!([0; 4].map(|_| ring.next()), told);
}

/// A `?` or a stop that repeats the byte before is dropped as long as that waits. What has been lost waits for nobody: the same
/// again is kept.
#[test]
fn a_repetition_of_what_was_lost_is_kept() {
    for byte in [b'?', b'!', 0x18, 0x19, 0x84, 0x85] {
        let ring = Received::new();
        let room = if is_stop(byte) { ROOM } else { ROOM - FOR_STOPS };
        for _ in 0..room {
            // Each of them is kept, and none of them repeats one.
            assert!(ring.keep(b'~', true).is_some());
        }
        ring.hear(byte);
        ring.pass(1);
        assert_eq!(ring.hear(byte), if is_stop(byte) { Call::AtOnce } else { Call::Soon }, "{byte:#x} was lost");
        assert_eq!(ring.hear(byte), Call::NotYet, "{byte:#x} waits");
        let told: Vec<Next> = std::iter::repeat_with(|| ring.next()).take(ROOM as usize + 3).collect();
        let heard = told.iter().filter(|next| **next == Next::Byte(byte)).count();
        assert_eq!((heard, told.contains(&Next::Missing), told.last()), (1, true, Some(&Next::Nothing)), "{byte:#x}");
        // Nobody waits for it any more.
        assert_eq!(ring.hear(byte), Call::Soon, "{byte:#x} again");
        assert_eq!((ring.next(), ring.next()), (Next::Byte(byte), Next::Nothing), "{byte:#x} again");
    }
}

/// Behind a byte that is disturbed, or those that have come by DMA, nothing repeats what was before.
#[test]
fn what_is_missing_ends_a_row_of_repetitions() {
    let ring = Received::new();
    assert_eq!([0x18, 0x18].map(|byte| ring.hear(byte)), [Call::AtOnce, Call::NotYet]);
    ring.miss();
    ring.miss();
    // What was lost is void with this one, and the line behind it is whole.
    assert_eq!([0x18, b'$', b'\n'].map(|byte| ring.hear(byte)), [Call::AtOnce, Call::NotYet, Call::Soon]);
    let told = [Next::Byte(0x18), Next::Missing, Next::Byte(0x18), Next::Byte(b'$'), Next::Byte(b'\n'), Next::Nothing];
    assert_eq!([0; 6].map(|_| ring.next()), told);
    assert_eq!(ring.hear(b'!'), Call::AtOnce);
    let (address, _) = ring.place();
    // SAFETY: as in `Stream::stand`.
    unsafe { (address as *mut u8).write(b'~') };
    ring.placed(1);
    assert_eq!(ring.hear(b'!'), Call::AtOnce);
    assert_eq!([0; 3].map(|_| ring.next()), [b'!', b'~', b'!'].map(Next::Byte));
}

/// Nor is it by a flood that has filled the ring.
#[test]
fn a_stop_has_a_place_in_a_ring_that_is_full() {
    let ring = Received::new();
    let kept = (0..ROOM).take_while(|_| ring.keep(b'x', false).is_some()).count();
    assert!(!ring.has_stop());
    assert_eq!(ring.keep(0x18, true), Some(kept as u32));
    for _ in 0..kept {
        assert!(ring.has_stop());
        assert_eq!(ring.next(), Next::Byte(b'x'));
    }
    assert!(ring.has_stop());
    assert_eq!([0; 4].map(|_| ring.next()), [Next::Missing, Next::Byte(0x18), Next::Nothing, Next::Nothing]);
    assert!(!ring.has_stop());
}

/// Nobody has looked at the bytes that came by DMA; and before they come all is taken.
#[test]
fn what_may_be_a_stop_is_read_like_one() {
    let ring = Received::new();
    assert_eq!([b'~', b'~'].map(|byte| ring.hear(byte)), [Call::Soon; 2]);
    assert!(!ring.has_stop());
    // Also what comes while the task reads what was there.
    ring.hurry();
    assert_eq!(ring.hear(b'~'), Call::Soon);
    for _ in 0..3 {
        assert!(ring.has_stop());
        assert_eq!(ring.next(), Next::Byte(b'~'));
    }
    ring.hurry();
    // A stop among them does not end the hurry.
    assert_eq!([b'!', b'~'].map(|byte| ring.hear(byte)), [Call::AtOnce, Call::Soon]);
    assert_eq!((ring.next(), ring.has_stop()), (Next::Byte(b'!'), true));
    assert_eq!(ring.next(), Next::Byte(b'~'));
    let (address, _) = ring.place();
    // SAFETY: as in `Stream::stand`.
    unsafe { (address as *mut u8).write(0x18) };
    ring.placed(1);
    assert!(ring.has_stop());
    assert_eq!((ring.next(), ring.has_stop()), (Next::Byte(0x18), false));
}

/// Which of the bytes that came by DMA was disturbed is not known.
#[test]
fn of_disturbed_bytes_each_becomes_one_that_is_refused() {
    let ring = Received::new();
    assert_eq!(ring.keep(b'a', false), Some(0));
    let (address, room) = ring.place();
    assert_eq!(room, ROOM - 1);
    for (k, byte) in b"b\nc!".iter().enumerate() {
        // SAFETY: as in `Stream::stand`.
        unsafe { ((address + k) as *mut u8).write(*byte) };
    }
    ring.placed_disturbed(4, |byte| if byte.is_ascii_alphabetic() { b'@' } else { byte });
    let bytes = [b'@', b'\n', b'@', b'!'].map(Next::Byte);
    assert_eq!([0; 2].map(|_| ring.next()), [Next::Byte(b'a'), Next::Missing]);
    assert_eq!([0; 4].map(|_| ring.next()), bytes);
    assert_eq!(ring.next(), Next::Nothing);
}

/// The interrupt comes between any two accesses of the task: here it is another thread.
#[test]
fn nothing_is_missing_without_a_word_whenever_it_comes() {
    const SENT: usize = 400_000;
    let ring = Received::new();
    let ended = AtomicBool::new(false);
    let (taken, gaps) = thread::scope(|scope| {
        scope.spawn(|| {
            for k in 0..SENT {
                if k % 97 == 50 {
                    ring.miss()
                } else {
                    let _ = ring.keep((k % 251) as u8, false);
                }
                if k % 64 == 0 {
                    thread::yield_now();
                }
                // The other thread has its share, however busy the machine is.
                while k % 2000 == 0 && ring.is_waiting() {
                    thread::yield_now();
                }
            }
            ended.store(true, Ordering::SeqCst);
        });
        let (mut last, mut taken, mut gaps, mut missing) = (None, 0_usize, 0_usize, false);
        let mut hear = |byte: u8, missing: &mut bool| {
            let follows = last.is_none_or(|last: u8| (last + 1) % 251 == byte);
            assert!(follows || *missing, "{byte} after {last:?}, and nothing was said");
            (last, *missing) = (Some(byte), false);
        };
        loop {
            let was_last = ended.load(Ordering::SeqCst);
            let ready = ring.ready();
            ready.iter().for_each(|byte| hear(*byte, &mut missing));
            taken += ready.len();
            ring.pass(ready.len());
            match ring.next() {
                Next::Byte(byte) => {
                    hear(byte, &mut missing);
                    taken += 1;
                }
                Next::Missing => (missing, gaps) = (true, gaps + 1),
                Next::Nothing if was_last => break (taken, gaps),
                Next::Nothing => thread::yield_now(),
            }
        }
    });
    assert!(taken > SENT / 10 && gaps > 10 && taken + gaps <= SENT, "{taken} bytes and {gaps} gaps");
}

/// The interrupt takes answers out between any two accesses of the task that puts them in: each byte once, in order.
#[test]
fn answers_go_out_as_they_were_put() {
    let ring = Sent::new();
    assert_eq!(ring.take(), None);
    let put = (0..=255).take_while(|byte| ring.put(*byte)).count();
    assert_eq!((put, ring.waiting()), (sent::ROOM as usize, sent::ROOM));
    for byte in 0..put as u8 {
        assert_eq!(ring.take(), Some(byte));
    }
    assert_eq!((ring.take(), ring.waiting()), (None, 0));
    const SENT: usize = 100_000;
    thread::scope(|scope| {
        scope.spawn(|| {
            for k in 0..SENT {
                while !ring.put((k % 251) as u8) {
                    thread::yield_now();
                }
            }
        });
        for k in 0..SENT {
            let byte = loop {
                match ring.take() {
                    Some(byte) => break byte,
                    None => thread::yield_now(),
                }
            };
            assert_eq!(byte, (k % 251) as u8);
        }
    });
}
