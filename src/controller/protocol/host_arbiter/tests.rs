//! Two hosts that compete to be the active one, on the links and queues of the tests of `link`.

use crate::messages::{HOST_CHANGED, Realtime};
use crate::protocol::link::tests::Both;

#[test]
fn a_host_that_leaves_in_mid_line_leaves_no_half_line() {
    let mut both = Both::<16>::new(8, 100);
    both.usb(b"G0X1\nG1 X");
    assert!(!both.arbiter.is_host_change_due());
    assert!(both.usb.went(&mut both.arbiter));
    assert!(both.arbiter.is_host_change_due());
    both.usb(b"G4P0\n");
    assert!(!both.arbiter.is_host_change_due());
    assert_eq!((both.text().as_str(), both.refusals()), ("G0X1\nG1 X|G4P0\n", (0, 0)));
    // A cut (`HOST_CHANGED`) contains the number of hosts that have disconnected. The number shows whose lines
    // precede the cut.
    let cuts = |both: &Both<16>| {
        both.queues.lines.iter().filter(|b| b.byte == HOST_CHANGED).map(|b| b.epoch).collect::<Vec<_>>()
    };
    assert_eq!((cuts(&both), both.arbiter.gone()), (vec![0, 1], 1));
    // The next host can be on the other link.
    both.usb(b"G1 Y");
    both.usb.went(&mut both.arbiter);
    both.uart(b"G4\n");
    assert_eq!(both.text(), "G0X1\nG1 X|G4P0\nG1 Y|G4\n");
}

#[test]
fn a_cut_goes_before_the_first_line_of_each_host_that_comes() {
    let mut both = Both::<16>::new(8, 100);
    both.usb(b"G4P0\n");
    both.queues.free = true;
    for _ in 0..2 {
        assert!(both.usb.came(&mut both.arbiter, &mut both.uart, &both.queues));
        both.usb(b"?G0\n");
    }
    assert_eq!(both.text(), "G4P0\n|G0\n|G0\n");
}

/// When the host opens its port, the start of a line is already in the queue, and the rest waits in the link. The rest
/// is dropped, because it would be a line of its own after the [`HOST_CHANGED`].
#[test]
fn of_a_line_sent_before_the_port_is_opened_nothing_is_read() {
    let mut both = Both::<16>::new(8, 4);
    both.queues.free = true;
    both.usb(b"G53G0X1\n");
    assert_eq!(both.usb.held(), 5);
    assert!(both.usb.came(&mut both.arbiter, &mut both.uart, &both.queues));
    both.queues.most_lines = 100;
    both.usb(b"G4P0\n");
    assert_eq!(both.text(), "G53|G4P0\n");
}

#[test]
fn a_host_that_leaves_with_a_full_queue_makes_room_for_the_next() {
    let mut both = Both::<16>::new(8, 3);
    both.usb(b"G0\nG0\nG0\n!");
    assert_eq!(both.usb.held(), 7);
    both.usb.went(&mut both.arbiter);
    assert_eq!(both.usb.room(), 16);
    // A [`HOST_CHANGED`] precedes the first byte of the next host, whichever link that host uses. The byte waits until
    // the queue has room for both.
    both.uart(b"$");
    both.queues.most_lines = 100;
    both.pass_on();
    both.uart(b"I\n");
    assert_eq!(both.text(), "G0|$I\n");
    assert!(both.queues.lines.iter().all(|byte| !byte.damaged));
}

/// If the start of a line was refused, the rest of the line is refused, too, whichever host is the active one by then.
#[test]
fn the_rest_of_a_refused_line_is_no_line() {
    let mut both = Both::<16>::new(8, 100);
    both.usb(b"G0X1");
    both.uart(b"G1 Y5");
    both.usb(b"0\n");
    // The machine is idle, so any host can become the active one.
    both.queues.free = true;
    both.uart(b"0 Z-9\r\n");
    assert_eq!((both.text().as_str(), both.refusals()), ("G0X10\n", (1, 0)));
    both.uart(b"$I\r\n");
    assert_eq!((both.text().as_str(), both.refusals()), ("G0X10\n|$I\r\n", (1, 0)));
}

#[test]
fn a_line_that_another_host_has_cut_is_refused_to_its_end() {
    let mut both = Both::<16>::new(8, 100);
    both.queues.free = true;
    both.uart(b"G1 X1");
    both.usb(b"G0 Y1\n");
    both.uart(b"0 Z-9\n");
    both.uart(b"G4\n");
    assert_eq!((both.text().as_str(), both.refusals()), ("G1 X1|G0 Y1\n|G4\n", (1, 0)));
    // On an idle machine, a `?` also makes its host the active one, but it does not cut a line.
    both.uart(b"G1 X1");
    both.usb(b"?");
    both.uart(b"0\nG5\n");
    assert_eq!((both.text().as_str(), both.refusals()), ("G1 X1|G0 Y1\n|G4\nG1 X10\nG5\n", (1, 0)));
    assert_eq!(both.arbiter.active_link(), 0);
    both.usb(b"?");
    assert_eq!(both.arbiter.active_link(), 1);
}

#[test]
fn a_line_in_which_another_host_resets_is_refused_to_its_end() {
    for command in [0x18, 0x19] {
        let mut both = Both::<16>::new(8, 100);
        both.uart(b"G1 X1");
        both.usb(&[command]);
        both.usb.went(&mut both.arbiter);
        both.uart(b"0 Z-9\nG4\n");
        assert_eq!((both.text().as_str(), both.refusals()), ("G1 X1|G4\n", (1, 0)), "{command:#x}");
        // After its own reset a host begins a new line.
        both.uart(b"G1 X1\x180\n");
        assert_eq!((both.text().as_str(), both.refusals()), ("G1 X1|G4\nG1 X10\n", (1, 0)));
        assert_eq!(both.epochs().last(), Some(&2));
    }
}

/// If the other host sends 0x19, the link must keep complete lines, even those that wait for room in the queue. Grbl's
/// dialect ignores 0x19, so these lines are still to be executed.
#[test]
fn a_stop_by_another_host_keeps_whole_lines() {
    let mut both = Both::<16>::new(8, 4);
    both.usb(b"G0X1\nG4\nG1 Y");
    both.uart(b"\x19");
    both.queues.most_lines = 100;
    both.pass_on();
    both.usb(b"5\nG4\n");
    assert_eq!((both.text().as_str(), both.refusals()), ("G0X1\nG4\nG4\n", (0, 1)));
}

#[test]
fn bytes_lost_before_another_host_speaks_refuse_their_own_line_only() {
    let mut both = Both::<16>::new(8, 100);
    both.queues.free = true;
    both.uart(b"G1 X1");
    both.uart.lose();
    both.usb(b"G0 Y1\n");
    both.uart(b"0 Z-9\nG4\n");
    assert_eq!((both.text().as_str(), both.refusals()), ("G1 X1|G0 Y1\n|G4\n", (1, 0)));
    assert!(both.queues.lines.iter().all(|byte| !byte.damaged));
    // The start of the line was lost.
    both.uart.lose();
    both.usb(b"$I\n");
    both.uart(b"X5\n");
    assert!(both.queues.lines.iter().any(|byte| byte.damaged && byte.byte == b'X'));
}

#[test]
fn cr_lf_is_refused_once() {
    let mut both = Both::<16>::new(8, 100);
    both.usb(b"G0\n");
    both.uart(b"G1\r\n\r\nG2\n\nG3\r");
    assert_eq!(both.refusals(), (6 - 1, 0), "two empty lines among them");
    // An LF after the CR that ended a line is not a line of its own, even if the active host has changed between the
    // two.
    both.queues.free = true;
    both.uart(b"\nG5\r");
    assert_eq!(both.text(), "G0\n|G5\r");
    both.usb(b"G6");
    both.uart(b"\n");
    assert_eq!((both.text().as_str(), both.refusals()), ("G0\n|G5\r|G6", (5, 0)));
}

/// A command that waits for room has not advanced the epoch yet, because a command of the other host can still be
/// queued before it.
#[test]
fn epochs_are_counted_in_the_order_of_the_queue() {
    let mut both = Both::<16>::new(1, 100);
    both.usb(b"A?\x85");
    assert_eq!(both.usb.room(), 0);
    both.uart(b"\x18B");
    assert_eq!(both.queues.commands, [Realtime::Status, Realtime::Reset]);
    both.queues.most_commands = 100;
    both.pass_on();
    both.uart(b"C");
    assert_eq!(both.queues.commands, [Realtime::Status, Realtime::Reset, Realtime::JogCancel]);
    assert_eq!((both.text().as_str(), both.epochs()), ("A|BC", vec![0, 1, 2]));
}
