//! When bytes are lost on the link, only the line to which they belong is refused.

use crate::board::{NOW, PROFILE, started};
use oxmill_controller::Controller;
use oxmill_controller::messages::{Event, LINES_DEPTH, LineByte, Observed, Output, Room};

fn answers(bytes: &[(u8, bool)]) -> String {
    let mut controller = started(PROFILE, 16);
    let mut text = String::new();
    let mut pull = |controller: &mut Controller<3>| {
        controller.observe(Observed {
            segments_begun: 0,
            step_idle: true,
            rx_free: LINES_DEPTH as u16 - 1,
            received: 1,
            activity: 0,
        });
        while let Some(output) = controller.output(NOW, Room { step: false, reply: true }) {
            if let Output::Reply(chunk) | Output::Answer(chunk) = output {
                text.push_str(std::str::from_utf8(chunk.as_bytes()).unwrap());
            }
        }
    };
    pull(&mut controller);
    for (byte, damaged) in bytes {
        assert!(controller.wants_line());
        controller.event(NOW, Event::Line(LineByte { byte: *byte, epoch: 0, damaged: *damaged }));
        pull(&mut controller);
    }
    text.split_once("help]\r\n").unwrap().1.to_string()
}

/// Sends lines to a new controller, and returns its replies after the welcome line. A `~` in `text` is not sent: it
/// stands for lost bytes, so the byte after it is marked as damaged.
fn with_gap(text: &str) -> String {
    let mut damaged = false;
    let mut bytes = Vec::new();
    for byte in text.bytes() {
        if byte == b'~' {
            damaged = true;
        } else {
            bytes.push((byte, std::mem::take(&mut damaged)));
        }
    }
    answers(&bytes)
}

#[test]
fn a_gap_in_a_line_refuses_that_line_only() {
    let lost = "[MSG:Received bytes lost]\r\n";
    assert_eq!(with_gap("G21\nG1 X1~.5 F100\nG90\n"), format!("ok\r\n{lost}error:11\r\nok\r\n"));
    // A line end was lost, so the two lines have become one line, which is refused.
    assert_eq!(with_gap("G21\nG1 X1~G90\nG94\n"), format!("ok\r\n{lost}error:11\r\nok\r\n"));
    // The lost bytes are at the beginning of a line, or just before its end.
    assert_eq!(with_gap("G21\n~X1\nG90\n"), format!("ok\r\n{lost}error:11\r\nok\r\n"));
    assert_eq!(with_gap("G21~\nG90\n"), format!("{lost}error:11\r\nok\r\n"));
    // Several losses of bytes within one line are reported once.
    assert_eq!(with_gap("G2~1 ~X~1\n~G9~0\n"), format!("{lost}error:11\r\n{lost}error:11\r\n"));
}

#[test]
fn a_gap_before_a_line_end_is_not_within_cr_lf() {
    assert_eq!(with_gap("G21\r~\nG90\n"), "ok\r\n[MSG:Received bytes lost]\r\nerror:11\r\nok\r\n");
}

#[test]
fn a_cut_forgets_what_has_come_of_a_line() {
    assert_eq!(with_gap("G21\nG99 X\x18G90\n"), "ok\r\nok\r\n");
    // The CR came from one host and the LF from the next (0x18 marks the change of hosts), so they are two line ends.
    assert_eq!(with_gap("G21\r\x18\nG90\n"), "ok\r\nok\r\nok\r\n");
}
