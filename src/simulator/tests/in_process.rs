//! The simulator as tests use it: everything happens in virtual time, and every run is identical.

use oxmill_controller::messages::Realtime;
use oxmill_simulator::{JobText, Options, Simulator, Store};
use std::time::Duration;

fn mill() -> Simulator {
    let mut mill = Simulator::new(Options { keep_steps: true, ..Options::default() });
    assert_eq!(mill.take_output(), "\r\nGrbl 1.1h ['$' for help]\r\n");
    mill
}

#[test]
fn a_move_is_answered_and_made() {
    let mut mill = mill();
    mill.send("G21 G91 G1 X1 Y-2 F100\n");
    assert_eq!(mill.take_output(), "ok\r\n");
    assert!(mill.run_until_idle());
    assert_eq!(mill.machine_position(), [1.0, -2.0, 0.0]);
    assert_eq!(mill.machine().position(), [250, -500, 0]);
    assert_eq!(mill.machine().pulses(), [250, 500, 0]);
    assert_eq!(mill.trace().kept().len() as u64, mill.trace().events());
    assert_eq!(mill.trace().kept().last().unwrap().position, [250, -500, 0]);
}

#[test]
fn the_same_bytes_at_the_same_times_give_the_same_steps() {
    let run = || {
        let mut mill = mill();
        mill.send("G21 G91\nG1 X5 F400\nG2 X2 Y2 I2 J0\n");
        mill.run_for(Duration::from_millis(700));
        mill.send("!");
        mill.run_for(Duration::from_millis(900));
        mill.send("~?");
        mill.run_until_idle();
        (*mill.trace().digest(), mill.busy_ticks(), mill.take_output())
    };
    assert_eq!(run(), run());
}

#[test]
fn a_hold_stops_and_a_start_goes_on() {
    let mut mill = mill();
    mill.send("G21 G91 G1 X5 F400\n");
    mill.run_for(Duration::from_millis(800));
    mill.send("!");
    assert!(!mill.run_until_idle(), "it waits for the host");
    assert!(mill.controller().is_paused());
    let there = mill.machine().position();
    mill.run_for(Duration::from_secs(60));
    assert_eq!(mill.machine().position(), there);
    mill.press(Realtime::CycleStart);
    assert!(mill.run_until_idle());
    assert_eq!(mill.machine_position(), [5.0, 0.0, 0.0]);
}

#[test]
fn a_reset_in_motion_stops_the_pulses_at_once() {
    let mut mill = mill();
    mill.send("G21 G91 G1 X5 F400\n");
    mill.run_for(Duration::from_millis(800));
    let before = mill.trace().events();
    mill.send([0x18]);
    mill.run_for(Duration::from_secs(1));
    assert_eq!(mill.trace().events(), before);
    assert!(mill.take_output().contains("ALARM:3"));
}

/// With M4, a laser is off as soon as its motion ends. It does not stay on until the motor drivers are switched off
/// (`$1`). With M3, the laser stays on.
#[test]
fn a_beam_with_scaled_power_ends_with_the_motion() {
    for (idle_delay, direction, stays) in [(25, "M4", false), (255, "M4", false), (255, "M3", true)] {
        let mut mill = mill();
        mill.send(format!("$1={idle_delay}\n$32=1\n{direction} S500 G91 F600 G1 X1\n"));
        mill.run_for(Duration::from_millis(300));
        assert!(mill.is_stepping() && mill.power() != 0, "{direction}");
        assert!(mill.run_until_idle());
        assert_eq!(mill.power() != 0, stays, "{direction} with $1={idle_delay}");
    }
}

/// During a tool change the drivers hold the axes, because the user pulls at the spindle. With any value of `$1`, the
/// drivers stay on until `~`, and after that for the delay of `$1`.
#[test]
fn the_drivers_are_on_while_a_tool_is_changed() {
    let mut mill = mill();
    mill.send("$1=25\n$918=1\nG91 F500 G1 X1\nT1 M6\n");
    mill.run_for(Duration::from_secs(3));
    assert!(mill.take_output().ends_with("[MSG:Tool change T1]\r\n"));
    assert!(mill.outputs().is_some_and(|outputs| outputs.drivers));
    mill.send("~");
    mill.run_for(Duration::from_millis(10));
    assert!(mill.outputs().is_some_and(|outputs| outputs.drivers));
    mill.run_for(Duration::from_millis(100));
    assert_eq!(mill.take_output(), "ok\r\n");
    assert!(mill.outputs().is_some_and(|outputs| !outputs.drivers));
}

/// A reset or a stop (0x19) ends a tool change, also after a hold (`!`) or a door command (0x84). The drivers then go
/// off after the delay of `$1`.
#[test]
fn the_drivers_go_off_when_a_tool_change_is_given_up() {
    for stop in [&b"\x18"[..], b"\x19", b"!\x18", b"\x84\x18", b"\x84\x19~"] {
        let mut mill = mill();
        mill.send("$1=25\n$918=1\nG91 F500 G1 X1\nT1 M6\n");
        mill.run_for(Duration::from_secs(3));
        assert!(mill.outputs().is_some_and(|outputs| outputs.drivers));
        for byte in stop {
            mill.send([*byte]);
            mill.run_for(Duration::from_millis(500));
        }
        assert!(mill.outputs().is_some_and(|outputs| !outputs.drivers), "{stop:?}: {}", mill.take_output());
    }
}

/// In sleep (`$SLP`) the drivers are off, as with Grbl, so that the axes can be moved by hand. Even `$1=255`, which
/// otherwise keeps the drivers on, does not change that.
#[test]
fn the_drivers_are_off_in_sleep() {
    for (idle_delay, after) in [(25, false), (255, true)] {
        let mut mill = mill();
        mill.send(format!("$1={idle_delay}\nG91 F500 G1 X1\n"));
        assert!(mill.run_until_idle());
        mill.send("$SLP\n");
        mill.run_for(Duration::from_millis(500));
        mill.send("?");
        assert!(mill.take_output().contains("<Sleep|"));
        assert!(mill.outputs().is_some_and(|outputs| !outputs.drivers), "$1={idle_delay}");
        mill.send("\x18");
        mill.run_for(Duration::from_millis(100));
        assert!(mill.outputs().is_some_and(|outputs| outputs.drivers == after), "$1={idle_delay}, awake");
    }
}

#[test]
fn pins_are_moved_by_lines() {
    let mut mill = mill();
    assert_eq!(mill.pin_line("limit x 1"), "ok");
    mill.send("?");
    assert!(mill.take_output().contains("Pn:X"));
    assert!(mill.pin_line("lamp 1").starts_with("error: "));
    assert!(mill.pin_line("steps").starts_with("steps 0 0 0 pulses 0 0 0 order "), "{}", mill.pin_line("steps"));
}

#[test]
fn settings_outlive_a_power_cycle() {
    let mut first = mill();
    first.send("$100=123.5\n");
    first.run_until_idle();
    assert_eq!(first.take_output(), "ok\r\n");
    let store: Store = first.store().clone();
    let mut second = Simulator::new(Options { store, ..Options::default() });
    second.run_until_idle();
    second.send("$$\n");
    second.run_until_idle();
    assert!(second.take_output().contains("$100=123.500\r\n"));
}

/// Tools 1 and 2 are removed, and tool 4 takes a freed entry. After a power cycle each tool must have its own values.
#[test]
fn a_tool_that_was_taken_out_stays_out() {
    let mut first = mill();
    first.send("G10 L1 P1 Z1\nG10 L1 P2 Z2\nG10 L1 P3 Z3\nG10 L1 P1\nG10 L1 P2\nG10 L1 P4 Z4\n");
    first.run_until_idle();
    assert_eq!(first.take_output(), "ok\r\n".repeat(6));
    let mut second = Simulator::new(Options { store: first.store().clone(), ..Options::default() });
    second.run_until_idle();
    second.take_output();
    second.send("$#\n");
    second.run_until_idle();
    let listing = second.take_output();
    let tools: Vec<&str> = listing.lines().filter(|line| line.starts_with("[T:")).collect();
    assert_eq!(tools, ["[T:4|0.000,0.000,4.000|0.000]", "[T:3|0.000,0.000,3.000|0.000]"]);
}

#[test]
fn the_tool_table_outlives_a_power_cycle() {
    let mut first = mill();
    // These lines set an offset of each axis, change an offset, and use the highest tool number.
    first.send("G10 L1 P5 X1 Y-2 Z12.5\nG10 L1 P7 Z1\nG10 L1 P7 Z-0.001\nG20 G10 L1 P99999 Z1\nT5 M6\n");
    first.run_until_idle();
    assert_eq!(first.take_output(), "ok\r\n".repeat(5));
    let tools = |mill: &mut Simulator| -> Vec<String> {
        mill.send("$#\n");
        mill.run_until_idle();
        mill.take_output().lines().filter(|line| line.starts_with("[T:")).map(str::to_owned).collect()
    };
    let table = tools(&mut first);
    assert_eq!(
        table,
        ["[T:5|1.000,-2.000,12.500|0.000]", "[T:7|0.000,0.000,-0.001|0.000]", "[T:99999|0.000,0.000,25.400|0.000]"]
    );
    let store = first.store().power_cycled().unwrap();
    let mut second = Simulator::new(Options { store, ..Options::default() });
    second.run_until_idle();
    second.take_output();
    assert_eq!(tools(&mut second), table);
    // The offsets can be used, but the tool in the spindle is not known any more.
    second.send("G43 H99999\n");
    second.run_until_idle();
    assert_eq!(second.take_output(), "ok\r\n");
    second.send("?");
    assert!(second.take_output().contains("|WCO:0.000,0.000,25.400>"));
    second.send("$G\n");
    second.run_until_idle();
    assert!(second.take_output().contains(" T0 "));
    second.send("$RST=#\n");
    second.run_until_idle();
    let store = second.store().power_cycled().unwrap();
    let mut third = Simulator::new(Options { store, ..Options::default() });
    assert!(tools(&mut third).is_empty());
}

#[test]
fn macros_outlive_a_power_cycle() {
    let mut first = mill();
    // The macros are stored out of order. One is changed and one is removed.
    first.send("$M3=o<m> endsub\n$M1=G0 X1\n$M0=o<m> sub\n$M2=G0 X5\n$M1=G0 X[#1*2]\n$M2=\n");
    first.run_until_idle();
    assert_eq!(first.take_output(), "ok\r\n".repeat(6));
    let list = |mill: &mut Simulator| -> Vec<String> {
        mill.send("$M\n");
        mill.run_until_idle();
        mill.take_output().lines().filter(|line| line.starts_with("$M")).map(str::to_owned).collect()
    };
    let macros = list(&mut first);
    assert_eq!(macros, ["$M0=O<M>SUB", "$M1=G0X[#1*2]", "$M3=O<M>ENDSUB"]);
    let store = first.store().power_cycled().unwrap();
    let mut second = Simulator::new(Options { store, ..Options::default() });
    second.run_until_idle();
    second.take_output();
    assert_eq!(list(&mut second), macros);
    second.send("o<m> call [4]\n");
    second.run_until_idle();
    assert_eq!(second.take_output(), "ok\r\n");
    assert_eq!(second.machine().position()[0], 2000, "8 mm at 250 steps/mm");
    second.send("$RST=*\n");
    second.run_until_idle();
    let store = second.store().power_cycled().unwrap();
    let mut third = Simulator::new(Options { store, ..Options::default() });
    assert!(list(&mut third).is_empty());
}

#[test]
fn a_job_is_never_starved() {
    let mut mill = mill();
    let text: String = std::iter::once("G21 G91\n".to_owned())
        .chain((0..2000).map(|i| format!("G1 X0.1 Y{} F400\n", if i % 2 == 0 { 0.05 } else { -0.05 })))
        .collect();
    mill.load_job(JobText::new(std::io::Cursor::new(text.into_bytes())));
    assert!(mill.run_until_idle());
    assert_eq!(mill.job().unwrap().answers(), 2001);
    assert_eq!(mill.machine_position()[0], 200.0);
    assert_eq!(mill.controller().alarm(), None);
}

#[test]
fn more_answers_than_anyone_fetches_are_kept() {
    let mut mill = mill();
    mill.send("G999\n".repeat(20_000));
    let mut answers = 0;
    loop {
        mill.run_until_idle();
        let said = mill.take_output();
        if said.is_empty() {
            break;
        }
        answers += said.matches("error:20\r\n").count();
    }
    // `take_output` can return the two parts of a reply in different calls. Such a reply is not counted above.
    assert!((19_990..=20_000).contains(&answers), "{answers}");
    assert!(mill.is_idle());
}

#[test]
fn realtime_commands_overtake_lines_that_wait() {
    let mut mill = mill();
    mill.send("G21 G91 G1 X1 F400\n");
    mill.run_for(Duration::from_millis(100));
    mill.send("!");
    mill.send("G1 X1\n".repeat(70));
    assert!(mill.unread() > 255, "more than the queue takes");
    mill.run_until_idle();
    mill.take_output();
    mill.send("?");
    assert!(mill.take_output().contains("<Hold:0"));
    mill.send([0x18]);
    mill.run_until_idle();
    assert_eq!(mill.unread(), 0, "a reset drops what waited before it");
}

/// A hold ends the present jog and drops all jogs received so far, even those for which the queue had no room.
#[test]
fn a_hold_forgets_all_jogs_that_have_been_received() {
    let mut mill = mill();
    mill.send("$J=G91 X5 F100\n");
    mill.run_for(Duration::from_millis(100));
    // Send more jogs than fit into the look-ahead and the queue.
    let mut jogs = 1;
    while mill.unread() < 400 {
        mill.send("$J=G91 Y1 F1000\n");
        jogs += 1;
    }
    mill.send("!");
    assert!(mill.run_until_idle());
    assert_eq!(mill.machine_position()[1], 0.0);
    assert_eq!(mill.take_output(), "ok\r\n".repeat(jogs));
    mill.send("$J=G91 Y1 F1000\n");
    assert!(mill.run_until_idle());
    assert_eq!(mill.machine_position()[1], 1.0);
}

/// A reset button drops all received lines. Bytes that the link has not fetched do not count as received.
#[test]
fn a_reset_button_drops_all_lines_that_have_been_received() {
    let mut mill = mill();
    mill.send("G4 P1\n");
    mill.send("G0 Y1\n".repeat(70));
    assert_eq!(mill.pin_line("reset 1"), "ok");
    assert_eq!(mill.pin_line("reset 0"), "ok");
    mill.send("G0 Z1\n");
    assert!(mill.run_until_idle());
    assert_eq!(mill.machine_position(), [0.0, 0.0, 1.0]);
}

/// Nothing moves before the controller knows the state of the inputs. Here, a limit switch is active from the
/// beginning.
#[test]
fn a_startup_line_waits_for_the_inputs() {
    let mut first = mill();
    for line in ["$21=1\n", "$N0=G0 X1\n", "$5=1\n"] {
        first.send(line);
        first.run_until_idle();
    }
    let store: Store = first.store().clone();
    let mut second = Simulator::new(Options { store, ..Options::default() });
    second.run_until_idle();
    let said = second.take_output();
    assert!(said.contains("ALARM:1\r\n") && !said.contains(">G0X1"), "{said}");
    assert_eq!(second.machine().pulses(), [0, 0, 0]);
}

#[test]
fn a_flood_of_resets_tears_no_welcome() {
    let mut mill = mill();
    mill.send([0x18; 500]);
    let said = mill.take_output();
    let count = said.matches("\r\nGrbl 1.1h ['$' for help]\r\n").count();
    assert!(count > 30);
    assert_eq!(said, "\r\nGrbl 1.1h ['$' for help]\r\n".repeat(count));
    mill.send("G21\n");
    assert_eq!(mill.take_output(), "ok\r\n");
}

/// A command such as `?` is executed before the lines that still wait, if the board has received the command. The board
/// receives only as many bytes as fit into its queue (255) and its link (192).
#[test]
fn what_finds_no_room_waits_in_the_port() {
    for (lines, passes) in [(80, true), (100, false)] {
        let mut mill = mill();
        // The dwell (five bytes) is in progress, so the controller reads no later line.
        mill.send("G4P9\n");
        mill.send("G21F\n".repeat(lines));
        mill.send("?");
        assert_eq!(mill.take_output().contains("<Idle"), passes, "{lines}");
        assert_eq!(mill.unread(), 5 * lines + usize::from(!passes));
        mill.disconnect();
        assert_eq!(mill.unread(), 255);
    }
}

/// While the queue is full, further bytes of the host do not reach the machine. The host must still not count as
/// silent (`$922`).
#[test]
fn a_host_that_waits_for_room_is_not_silent() {
    let mut mill = Simulator::new(Options::default());
    mill.send("$922=0.5\n");
    mill.run_until_idle();
    mill.take_output();
    mill.send("G4 P1\n".repeat(120));
    let mut output_after = |seconds| {
        mill.run_for(Duration::from_secs(seconds));
        mill.take_output()
    };
    let (waits, alone) = (output_after(60), output_after(120));
    assert!(waits.matches("ok").count() > 55 && !waits.contains("silent"), "{waits}");
    assert!(alone.contains("[MSG:The host is silent]"), "{alone}");
}
