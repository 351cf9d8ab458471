//! The step pulse (`$0`): which values a board accepts, stores and reports.

use oxmill_controller::messages::Wiring;
use oxmill_simulator::{Options, Simulator, Store, boards};

fn power_up(board: boards::Board, store: Store) -> Simulator {
    let mut mill = Simulator::new(Options { board, store, ..Options::default() });
    mill.take_output();
    mill
}

fn ask(mill: &mut Simulator, line: &str) -> String {
    mill.send(format!("{line}\n"));
    assert!(mill.run_until_idle(), "{line}");
    mill.take_output()
}

/// Returns the pulse length that was configured in the outputs, in tenths of a microsecond.
fn pulse_tenths(mill: &Simulator) -> u16 {
    mill.wiring().map_or(0, |Wiring { pulse_tenths, .. }| pulse_tenths)
}

fn in_us(tenths: u16) -> String {
    (f64::from(tenths) / 10.0).to_string()
}

#[test]
fn a_board_takes_its_least_pulse_and_none_below() {
    for board in boards::ALL {
        let least = board.least_pulse_tenths;
        let mut mill = power_up(board, Store::in_memory());
        assert_eq!(ask(&mut mill, &format!("$0={}", in_us(least - 1))), "error:6\r\n", "{board:?}");
        assert_eq!((ask(&mut mill, "$0=0").as_str(), ask(&mut mill, "$0=-1").as_str()), ("error:6\r\n", "error:4\r\n"));
        assert_eq!(pulse_tenths(&mill), 100, "the default is still in force");
        for tenths in [least, least + 1, 25] {
            let us = in_us(tenths);
            assert_eq!(ask(&mut mill, &format!("$0={us}")), "ok\r\n", "{board:?}");
            assert_eq!(pulse_tenths(&mill), tenths);
            assert!(ask(&mut mill, "$$").starts_with(&format!("$0={us}\r\n")), "{board:?} {us}");
        }
        assert_eq!(ask(&mut mill, "$0=2.55"), "error:3\r\n", "what is finer is not rounded");
        let wanted = format!("[SETTING:0|2|Step pulse|us|6|##0.0|{}|255|0|0]\r\n", in_us(least));
        assert!(ask(&mut mill, "$ES").starts_with(&wanted), "{board:?} {wanted}");
    }
}

#[test]
fn tenths_are_kept_over_a_power_cycle() {
    let mut mill = power_up(boards::NUCLEO_F446RE, Store::in_memory());
    assert_eq!(ask(&mut mill, "$0=0.5"), "ok\r\n");
    let mut mill = power_up(boards::NUCLEO_F446RE, mill.store().power_cycled().unwrap());
    assert!(ask(&mut mill, "$$").starts_with("$0=0.5\r\n"));
    assert_eq!(pulse_tenths(&mill), 5);
    // A board that cannot make the stored pulse reports this and does not move.
    let mut mill = power_up(boards::BLACKPILL_F411, mill.store().power_cycled().unwrap());
    let refused = "[MSG:Motion is locked until you correct this setting: $0]\r\nerror:9\r\n";
    assert_eq!(ask(&mut mill, "G91 G0 X1"), refused);
    assert_eq!((ask(&mut mill, "$0=1"), ask(&mut mill, "G91 G0 X1")), ("ok\r\n".into(), "ok\r\n".into()));
}
