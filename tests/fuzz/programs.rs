//! Fuzz target: programs on a homed machine with soft limits. Each line passes through the whole controller to the
//! pulses. The programs have lines, arcs, splines, cycles, expressions, loops, jogs and pauses. The first byte
//! chooses the dialect: Oxmill, Grbl or Seed.
//!
//! A realtime command within a line (hold, door, override, jog cancel, reset) is sent after the line. Its delay is
//! proportional to its position in the line.
//!
//! Invariants:
//! - While the position is trusted, no pulse leaves the travel, even with holds, overrides and resets.
//! - Each line is answered once, after a bounded number of rounds.
//! - Nothing moves in an alarm.
//! - At rest, the reported position agrees with the steps that were output.

use super::board::{AXES, Board, shows};
use oxmill_controller::messages::Realtime;
use oxmill_controller::protocol::realtime;
use std::collections::BTreeMap;

/// Steps/mm. The number is small, so that the simulation of a program is fast.
const STEPS_PER_MM: i64 = 4;
/// Travel, mm.
const TRAVEL: i32 = 60;
const SETTINGS: &str = "$100=4 $101=4 $102=4 $110=30000 $111=30000 $112=30000 $120=4000 $121=4000 $122=4000 $130=60 $131=60 \
    $132=60 $24=3000 $25=6000 $26=1 $27=1 $22=1 $20=1";
/// Position at which the limit switch of each axis closes, in steps of its motor from power-up.
const SWITCHES: i32 = 20;
/// Number of times that the target waits for an answer. Then it abandons the program, because a program can contain an
/// endless loop.
const MOST_WAITS: usize = 40;
/// Maximum number of rounds (passes of the pump) without time passing. A line that needs more counts as an endless
/// loop.
const MOST_ROUNDS: usize = 600;
/// Maximum number of endless loops (see [`MOST_ROUNDS`]) in one input. After more, the target abandons the input.
const MOST_UNENDED: usize = 2;
/// Maximum number of lines of an input.
const MOST_LINES: usize = 48;
/// Delay of a realtime command, us per byte of the line. The bytes are counted from the start of the line or from the
/// previous command.
const TIME_A_PLACE: u64 = 3_000;

thread_local! {
    /// Homed boards, one per dialect: copying is cheaper than homing again.
    static HOMED: [Board; 3] = ["$900=1", "$900=0", "$900=2"].map(homed);
}

fn homed(dialect: &str) -> Board {
    let mut board = Board::new(BTreeMap::new());
    for line in SETTINGS.split_ascii_whitespace().chain([dialect]) {
        let said = board.ask(line);
        assert!(said.ends_with("ok\r\n"), "{line}: {said}");
    }
    board.send(b"$H\n");
    for _ in 0..200_000 {
        let switches = board.motors.iter().enumerate().filter(|(_, place)| **place >= SWITCHES);
        let word = switches.map(|(axis, _)| 1 << axis).sum();
        board.inputs(word);
        board.pass(200, false);
        if board.controller.is_idle() && board.controller.is_trusted() {
            break;
        }
    }
    assert!(board.controller.is_trusted(), "homed: {} {:?}", board.take_said(), board.motors);
    let places = board.controller.machine_position();
    let mut zero = board.motors;
    for (zero, place) in zero.iter_mut().zip(places.iter()) {
        *zero -= (place.0 * STEPS_PER_MM / 10_000_000) as i32;
    }
    let travel = TRAVEL * STEPS_PER_MM as i32;
    board.travel = Some(zero.map(|zero| (zero - travel, zero)));
    board.inputs(0);
    board.settle();
    board.take_said();
    board.most_rounds = MOST_ROUNDS;
    board
}

/// Runs the target on one input; panics if an invariant is violated.
pub fn run(data: &[u8]) {
    let Some((first, text)) = data.split_first() else { return };
    let mut board = HOMED.with(|boards| boards[usize::from(*first % 3)].clone());
    for line in text.split(|byte| matches!(byte, b'\n' | b'\r')).take(MOST_LINES) {
        // Lines with `$` are skipped, because settings and commands can change the travel; jogs are allowed.
        let text: Vec<u8> = line.iter().copied().filter(|byte| !is_realtime(*byte)).collect();
        if text.contains(&b'$') && !text.starts_with(b"$J=") {
            continue;
        }
        if !board.has_time() || !carry_out(&mut board, &text, line) {
            break;
        }
    }
    end(board);
}

/// Returns whether the link treats the byte as a command of its own, not as part of a line.
fn is_realtime(byte: u8) -> bool {
    matches!(byte, b'!' | b'?' | b'~' | 0x18 | 0x80..)
}

/// Sends the realtime commands of a line, each after its delay.
fn interrupt(board: &mut Board, line: &[u8]) {
    let mut given = 0;
    for (place, byte) in line.iter().enumerate() {
        if let Some(command) = realtime::command(*byte).filter(|_| is_realtime(*byte)) {
            board.pass((place - given) as u64 * TIME_A_PLACE, false);
            given = place;
            board.command(command);
            board.settle();
        }
    }
}

/// Sends `text`, then the realtime commands within `line`, and waits until the controller has answered. `text` is
/// `line` without the realtime commands. Returns `false` if no answer arrives, as in an endless loop, or if the queue
/// has no room for the line.
fn carry_out(board: &mut Board, text: &[u8], line: &[u8]) -> bool {
    if !board.has_room(text.len() + 1) {
        return false;
    }
    board.send(text);
    board.send(b"\n");
    board.settle();
    interrupt(board, line);
    for wait in 0..MOST_WAITS {
        if board.is_read() {
            if shows() {
                println!("{:?} {:?} {:?}", line.escape_ascii().to_string(), board.take_said(), board.motors);
            }
            if board.controller.alarm().is_some() {
                // An alarm can have stopped the machine at speed. Then the position is not trusted, and soft limits do
                // not apply.
                board.ask("$X");
                if !board.controller.is_trusted() {
                    board.travel = None;
                }
            }
            return true;
        }
        if board.unended > MOST_UNENDED {
            return false;
        }
        board.pass(50_000 << (wait / 4).min(12), false);
        if wait % 4 == 3 {
            // M0, M6 and the like wait for the operator.
            board.command(Realtime::CycleStart);
            board.settle();
        }
    }
    false
}

/// Waits until motion has ended, and checks that the controller's position agrees with the steps that were output.
fn end(mut board: Board) {
    for _ in 0..MOST_WAITS {
        if board.controller.is_idle() || !board.has_time() || board.unended > MOST_UNENDED {
            break;
        }
        board.pass(200_000, false);
        // Resume, in case the machine is in a hold.
        board.command(Realtime::CycleStart);
    }
    let Some(travel) = board.travel.filter(|_| board.controller.is_idle()) else { return };
    let places = board.controller.machine_position();
    for (axis, place) in places.iter().enumerate().take(AXES) {
        let steps = i64::from(board.motors[axis] - travel[axis].1);
        // In 0.01 steps; `place.0` is in 0.1 nm.
        let apart = place.0 * STEPS_PER_MM / 100_000 - 100 * steps;
        assert!(apart.abs() <= 100, "axis {axis} is at {} of 0.1 nm, and has made {steps} steps", place.0);
    }
}
