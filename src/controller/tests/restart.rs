//! Tests of the start after a failure (a crash, a watchdog, a fault of the board): the machine is locked. Each welcome
//! line reports the failure until the host has requested its record (`$RC`).

use crate::board::{NOW, PROFILE};
use oxmill_controller::Controller;
use oxmill_controller::gcode::LEAST_HELD;
use oxmill_controller::memory::Memory;
use oxmill_controller::messages::{
    Crash, CrashKind, Event, LineByte, Observed, Output, Realtime, ResetCause, Restart, Room, Sensed, Signals,
    StepEvent,
};

struct Board {
    controller: Box<Controller<3>>,
    stops: u16,
    epoch: u16,
}

impl Board {
    fn started(restart: Option<Restart>) -> (Board, String) {
        let mut controller = Box::new(Controller::new(PROFILE, Memory::on_heap(&PROFILE, 16, LEAST_HELD)));
        if let Some(restart) = restart {
            controller.restarted(restart);
        }
        controller.start(NOW);
        controller.event(NOW, Event::Signals(Sensed::default()));
        let mut board = Board { controller, stops: 0, epoch: 0 };
        let said = board.pump();
        (board, said)
    }

    fn pump(&mut self) -> String {
        self.pump_while(true)
    }

    fn pump_while(&mut self, step_idle: bool) -> String {
        let mut said = String::new();
        self.controller.observe(Observed { segments_begun: 0, step_idle, rx_free: 255, received: 0, activity: 0 });
        while let Some(output) = self.controller.output(NOW, Room { step: true, reply: true }) {
            if let Output::Reply(chunk) | Output::Answer(chunk) = output {
                said.push_str(&String::from_utf8_lossy(chunk.as_bytes()));
            }
        }
        said
    }

    fn line(&mut self, line: &str) -> String {
        for byte in line.bytes().chain([b'\n']) {
            self.controller.event(NOW, Event::Line(LineByte { byte, epoch: self.epoch, damaged: false }));
        }
        self.pump()
    }

    fn reset(&mut self) -> String {
        self.stops += 1;
        self.epoch += 1;
        self.controller.event(NOW, Event::Realtime(Realtime::Reset));
        let position = oxmill_controller::axes::PerAxis::all(0);
        let stopped = StepEvent::Stopped { stops: self.stops, moving: false, position };
        self.controller.event(NOW, Event::Step(stopped));
        self.pump()
    }
}

fn crash(kind: CrashKind, text: &[u8]) -> Option<Crash> {
    let text = heapless::Vec::from_slice(text).unwrap();
    Some(Crash { kind, text, place: [1_250, -3_000, 0], line: 12, moment: 0 })
}

#[test]
fn an_ordinary_start_says_nothing_of_it() {
    for cause in [ResetCause::Power, ResetCause::Pin, ResetCause::Software, ResetCause::Other] {
        let (mut board, said) = Board::started(Some(Restart { cause, crash: None, is_recorded: false }));
        assert_eq!(said, "\r\nGrbl 1.1h ['$' for help]\r\n");
        assert_eq!(board.line("G21"), "ok\r\n");
    }
    let (mut board, _) = Board::started(None);
    assert_eq!(board.line("$RC"), "[RESET:power]\r\nok\r\n");
}

#[test]
fn a_failure_locks_and_is_told_until_the_host_has_asked() {
    let message = "[MSG:Restarted after a failure (stuck task) at machine 1.250,-3.000,0.000, line 12, $RC tells more, \
         $REC what came in]\r\n";
    let restart =
        Restart { cause: ResetCause::Software, crash: crash(CrashKind::Stuck, b"control"), is_recorded: true };
    let (mut board, said) = Board::started(Some(restart));
    assert_eq!(said, format!("\r\nGrbl 1.1h ['$' for help]\r\n{message}[MSG:'$H'|'$X' to unlock]\r\n"));
    assert_eq!(board.line("G1X5F100"), "error:9\r\n", "a job that goes on streaming moves nothing");
    assert!(board.reset().contains(message));
    board.controller.event(NOW, Event::Connected);
    assert!(board.pump().contains(message));
    assert_eq!(
        board.line("$RC"),
        "[RESET:software]\r\n[CRASH:stuck task:control]\r\n[LAST:1.250,-3.000,0.000|Ln:12]\r\nok\r\n"
    );
    assert!(!board.reset().contains("failure"));
    assert_eq!(
        board.line("$RC"),
        "[RESET:software]\r\n[CRASH:stuck task:control]\r\n[LAST:1.250,-3.000,0.000|Ln:12]\r\nok\r\n"
    );
    assert!(board.line("$X").ends_with("ok\r\n"));
    assert_eq!(board.line("G21"), "ok\r\n");
}

/// A board whose pin table or clock cannot be used must not move anything, whatever the host sends.
#[test]
fn a_fault_of_the_board_locks_until_it_is_gone() {
    let fault = crash(CrashKind::Board, b"no crystal found");
    let restart = Restart { cause: ResetCause::Power, crash: fault, is_recorded: false };
    let (mut board, said) = Board::started(Some(restart));
    assert!(said.contains("[MSG:Board: no crystal found]\r\n"), "{said}");
    for _ in 0..2 {
        assert_eq!(board.line("$X"), "[MSG:The board cannot be used: $RC tells why]\r\nerror:9\r\n");
        for line in ["G1X5F100", "M3S100", "G38.2Z-1F10"] {
            assert_eq!(board.line(line), "error:9\r\n", "{line}");
        }
        assert_eq!(board.line("$J=G91X1F100"), "error:8\r\n");
        assert_eq!(board.line("$22=1"), "ok\r\n");
        assert_eq!(board.line("$H"), "error:9\r\n");
        assert!(board.line("$RC").contains("[CRASH:board:no crystal found]\r\n"));
        board.reset();
    }
}

#[test]
fn a_watchdog_without_a_record_is_told_too() {
    let (_, said) = Board::started(Some(Restart { cause: ResetCause::Watchdog, crash: None, is_recorded: false }));
    assert!(said.contains("(watchdog)") && said.contains("$X"), "{said}");
}

/// At 115,200 baud, 6000 resets arrive in half a second. A counter of 8 bits could not count them.
#[test]
fn many_resets_are_over_when_the_step_task_has_obeyed_them() {
    let (mut board, _) = Board::started(None);
    for _ in 0..6000 {
        board.controller.event(NOW, Event::Realtime(Realtime::Reset));
    }
    assert_eq!(board.pump(), "");
    let position = oxmill_controller::axes::PerAxis::all(0);
    board.controller.event(NOW, Event::Step(StepEvent::Stopped { stops: 6000, moving: false, position }));
    assert_eq!(board.pump().matches("Grbl 1.1h").count(), 1);
}

/// A press of the reset button drops the rest of the line that is being received. `HOST_CHANGED`, the byte at a change
/// of hosts, ends the dropping. So the line of the next host is executed.
#[test]
fn what_a_reset_button_drops_ends_with_a_cut() {
    let (mut board, _) = Board::started(None);
    board.controller.observe(Observed { segments_begun: 0, step_idle: true, rx_free: 251, received: 4, activity: 0 });
    let signals = Signals { reset: true, ..Signals::NONE };
    board.controller.event(NOW, Event::Signals(Sensed { signals, ..Sensed::default() }));
    let position = oxmill_controller::axes::PerAxis::all(0);
    board.controller.event(NOW, Event::Step(StepEvent::Stopped { stops: 1, moving: false, position }));
    assert_eq!(board.controller.output(NOW, Room::default()), Some(Output::Stop));
    board.controller.event(NOW, Event::Step(StepEvent::Stopped { stops: 1, moving: false, position }));
    let give = |board: &mut Board, text: &[u8]| {
        for byte in text {
            board.controller.event(NOW, Event::Line(LineByte { byte: *byte, epoch: 0, damaged: false }));
        }
    };
    give(&mut board, b"G0 X");
    board.pump();
    give(&mut board, b"\x18G21\n");
    assert_eq!(board.pump(), "ok\r\n");
}

/// A press of the reset button counts the received bytes, because as many bytes must be dropped. When the host that
/// sent them disconnects, the count is forgotten, so that no bytes of the next host are dropped.
#[test]
fn a_host_that_goes_takes_what_was_counted_with_it() {
    let (mut board, _) = Board::started(None);
    board.controller.observe(Observed { segments_begun: 0, step_idle: true, rx_free: 55, received: 200, activity: 0 });
    let signals = Signals { reset: true, ..Signals::NONE };
    board.controller.event(NOW, Event::Signals(Sensed { signals, ..Sensed::default() }));
    while board.controller.output(NOW, Room { step: false, reply: true }).is_some() {}
    let position = oxmill_controller::axes::PerAxis::all(0);
    board.controller.event(NOW, Event::Step(StepEvent::Stopped { stops: 1, moving: false, position }));
    assert!(board.pump().contains("Grbl"));
    assert_eq!(board.line("G21"), "ok\r\n");
}

#[test]
fn an_underrun_takes_a_waiting_jog_with_it() {
    let (mut board, _) = Board::started(None);
    let jog = |board: &mut Board| {
        for byte in b"$J=G91X10F600\n" {
            board.controller.event(NOW, Event::Line(LineByte { byte: *byte, epoch: board.epoch, damaged: false }));
        }
        board.pump_while(false)
    };
    assert_eq!(jog(&mut board), "ok\r\n");
    board.epoch += 1;
    board.controller.event(NOW, Event::Realtime(Realtime::JogCancel));
    assert_eq!(jog(&mut board), "", "it waits for the end of the one before");
    let position = oxmill_controller::axes::PerAxis::all(0);
    board.controller.event(NOW, Event::Step(StepEvent::Underrun { stops: 1, position }));
    assert_eq!(board.pump(), "ALARM:100\r\n[MSG:Motion data ran out]\r\nerror:9\r\n");
    let unlocked = board.line("$X");
    assert!(unlocked.starts_with("[MSG:Caution: Unlocked]\r\n") && unlocked.ends_with("\r\nok\r\n"), "{unlocked}");
}
