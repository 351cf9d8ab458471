//! Tests when queued motion starts: as soon as the number of queued moves reaches the number of blocks of the
//! look-ahead. Each short move counts, even if several of them were joined into one block.

use crate::board::{NOW, PROFILE, started};
use oxmill_controller::messages::{Event, LineByte, Observed, Output, Room, ToStep};

const BLOCKS: usize = 16;

/// Returns how many moves along X are sent before the machine starts to move. `millimetres`: the length of each move.
/// The host always has more bytes waiting.
fn moves_before_the_start(millimetres: f64) -> usize {
    let mut controller = started(PROFILE, BLOCKS);
    for count in 0..1000 {
        let line = format!("G1 F600 X{:.3}\n", millimetres * f64::from(count + 1));
        for byte in line.bytes() {
            controller.event(NOW, Event::Line(LineByte { byte, epoch: 0, damaged: false }));
        }
        controller.observe(Observed { segments_begun: 0, step_idle: true, rx_free: 0, received: 100, activity: 0 });
        while let Some(output) = controller.output(NOW, Room { step: true, reply: true }) {
            if let Output::Step(ToStep::Segment(_)) = output {
                return count as usize + 1;
            }
        }
    }
    panic!("does not begin to move");
}

#[test]
fn joined_moves_do_not_put_off_the_start() {
    let separate = moves_before_the_start(1.0);
    assert!((BLOCKS..=BLOCKS + 1).contains(&separate));
    assert!(moves_before_the_start(0.02) <= separate);
}
