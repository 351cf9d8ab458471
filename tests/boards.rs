//! Checks the files of the boards, and that lists of boards and images agree.

use oxmill_boards::profiles;
use oxmill_controller::{StepRates, StepTiming};
use oxmill_images::{IMAGES, SMALL};
use oxmill_simulator::{Options, Simulator};
use oxmill_tables::Board;
use std::fs;
use std::path::PathBuf;

fn board_file(name: &str) -> String {
    let path = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("boards").join(name);
    fs::read_to_string(&path).unwrap_or_else(|error| panic!("{}: {error}", path.display()))
}

/// Each board's file parses without faults and contains the board's name. The parser (`boards/tables/check.rs`)
/// reports, for example, pins with two functions, pins that the chip lacks, and functions on pins of the debug port,
/// the oscillator or the links to the host.
#[test]
fn the_file_of_each_board_is_without_faults() {
    for (name, text) in oxmill_tables::BOARDS {
        match Board::parse(text) {
            Ok(board) => assert_eq!(board.name, name),
            Err(faults) => panic!("{name}.toml: {faults:?}"),
        }
    }
}

/// The simulator uses the profile of a board. It must agree with the board's file.
#[test]
fn profiles_are_those_of_the_files() {
    for (name, _) in oxmill_tables::BOARDS {
        let board = Board::named(name).expect("a board");
        let profile = oxmill_boards::profiles::ALL.into_iter().find(|profile| profile.name == name);
        let profile = profile.unwrap_or_else(|| panic!("profiles.rs has no {name}"));
        let has = |function| board.pins.contains_key(function);
        let count = |first, second| u8::from(has(first)) + u8::from(has(second));
        assert_eq!(profile.has_at_speed, has("at_speed"), "{name}");
        let outputs = count("program_output", "second_program_output");
        assert_eq!(profile.program_pins, [outputs, count("program_input", "second_program_input")], "{name}");
        let of_image = |board: profiles::Board| {
            (board.image, board.step_clock_hz, board.core_hz, board.axes, board.blocks, board.most_baud)
        };
        assert_eq!(of_image(profile), of_image(board.image), "{name}");
    }
}

/// Returns a constant of a file in `boards/stm32f4`.
fn number(file: &str, name: &str) -> u32 {
    let text = board_file(&format!("stm32f4/{file}"));
    let values = ["usize", "u32"].map(|kind| text.split(&format!("const {name}: {kind} = ")).nth(1));
    let value = values.into_iter().flatten().next().and_then(|rest| rest.split(';').next());
    value.and_then(|value| value.parse().ok()).unwrap_or_else(|| panic!("{file} has no {name}"))
}

/// The step output and the UART use different DMA streams. A Nucleo's UART uses two streams of DMA1; a Black Pill's
/// UART uses one of DMA2 while flash is written.
#[test]
fn no_stream_has_two_uses() {
    let dma1 =
        [("chain.rs", "MOMENTS"), ("chain.rs", "BEAM"), ("usart_dma.rs", "RECEIVER"), ("usart_dma.rs", "SENDER")];
    let streams = dma1.map(|(file, name)| number(file, name));
    assert_eq!(streams, [2, 0, 5, 6]);
    // If all step pins are on one port, streams 1 and 4 of DMA2 start and end the pulses.
    assert!(board_file("stm32f4/chain.rs").contains("(0, 1) => Streams { on: 1, off: Some(4),"));
    assert_eq!(number("usart_interrupt.rs", "STREAM"), 5);
}

/// Each firmware image must be named in every file that lists the images. No compiler compares these lists.
#[test]
fn every_image_stands_in_every_list() {
    let ci = board_file("../.ci/run");
    for name in IMAGES {
        let manifests = ["Cargo.toml", "../src/firmware/Cargo.toml", "../tests/on_target/Cargo.toml"];
        for file in ["../.ci/run", "sizes.txt", "profiles.rs", "lib.rs"].into_iter().chain(manifests) {
            assert!(board_file(file).contains(name), "{file} has no {name}");
        }
        assert!(oxmill_images::chip(name).is_some(), "{name}");
        let case = ci.lines().find(|line| line.contains("echo firmware-small")).expect("the profiles");
        let is_small = case.split([' ', '|', ')']).any(|word| word == name);
        assert_eq!(is_small, SMALL.contains(&name), "the profile of {name} in .ci/run");
    }
}

#[test]
fn every_board_has_its_name_in_the_readme_and_a_probe_profile() {
    let embed = board_file("../Embed.toml");
    for (name, _) in oxmill_tables::BOARDS {
        assert!(embed.contains(&format!("[{name}.general]")), "{name}");
        assert!(board_file("../docs/boards.md").contains(name), "docs/boards.md has no {name}");
    }
}

/// Each board's safe step rate follows three rules of docs/cost.md, "Step rates".
/// - Ring: the step task fills a ring of 96 events in batches of 32. The output of 96 events must take longer than two
///   of the task's longest runs and the output of half a batch together.
/// - CPU: batches for three axes take at most half of the processor's time.
/// - Pulse: the pause after the shortest pulse is long enough for the pulse timer to stop.
#[test]
fn step_rates_follow_the_rule() {
    const DEPTH: u64 = 96;
    const BATCH: u64 = 32;
    for board in oxmill_boards::profiles::ALL.iter().filter(|board| !["desk", "qemu_mps2"].contains(&board.name)) {
        let (hz, core_hz) = (u64::from(board.safe_step_hz), u64::from(board.core_hz));
        let runs = 2 * u64::from(board.run_cycles) * hz;
        assert!(runs <= (DEPTH - BATCH / 2) * core_hz, "{board:?}");
        // 1,582 cycles for a batch with three axes: the result of `cargo xtask count`, plus at least 10 %.
        assert!(1_582 * hz / BATCH <= core_hz / 2, "{board:?}");
        let rates = StepRates { safe_hz: u32::MAX, least_pulse_tenths: board.least_pulse_tenths };
        assert!(rates.greatest_hz(board.least_pulse_tenths) >= hz as f32, "{board:?}");
        // The pulse timer must stop before the next event triggers it. So the pause after a pulse must be longer than 7
        // ticks of the pulse timer: 4 from the trigger to its first count, 1 to the leading edge, 1 after the trailing
        // edge, 1 to the stop. If a port has direction pins and no step pins, the leading edge comes `DIRECTION_LEAD`
        // ticks later. A tick of the pulse timer is at most a step-clock tick.
        let timing = StepTiming::new(board.step_clock_hz / 1_000_000, board.least_pulse_tenths, 0);
        let lead = if board.direction_ports > 0 { number("chain.rs", "DIRECTION_LEAD") } else { 0 };
        assert!(timing.gap > timing.pulse + 7 + lead, "{board:?}");
    }
}

/// Returns a board's answer to a line.
fn said(board: oxmill_boards::profiles::Board, line: &str) -> String {
    let mut mill = Simulator::new(Options { board, ..Options::default() });
    mill.run_until_idle();
    mill.take_output();
    mill.send(format!("{line}\n"));
    mill.run_until_idle();
    mill.take_output()
}

/// `$915` enables the spindle's at-speed signal. On a board without a pin for this signal, its level would be fixed:
/// every spindle would count as up to speed, or no spindle would. So `$915` locks motion on this board.
#[test]
fn a_board_without_a_pin_for_the_speed_takes_no_setting_for_it() {
    for board in profiles::ALL {
        let lock = "[MSG:Motion is locked until you correct this setting: $915]";
        for value in [1, 2] {
            let is_locked = said(board, &format!("$915={value}")).contains(lock);
            assert_eq!(is_locked, !board.has_at_speed, "{} {value}", board.name);
        }
        assert!(!said(board, "$915=0").contains(lock), "{}", board.name);
        assert_eq!(said(board, "$PINS").contains("[PIN:at speed,"), board.has_at_speed, "{}", board.name);
    }
}

/// On a board with USB, the UART causes an interrupt for each byte, and this interrupt waits while the step task runs.
/// So bytes would be lost at rates above the board's `most_baud`. Hosts that need a faster link use USB.
#[test]
fn a_uart_beside_usb_takes_no_rate_of_its_uart_that_it_cannot_keep() {
    for board in oxmill_boards::profiles::ALL {
        let is_slow = board.has_usb;
        for rate in [230_400, 1_000_000] {
            let answer = said(board, &format!("$931={rate}"));
            assert_eq!(
                answer,
                if is_slow { "[MSG:Values of $931: 115200 to 115200]\r\nerror:52\r\n" } else { "ok\r\n" },
                "{} {rate}",
                board.name
            );
        }
        assert_eq!(said(board, "$931=115200"), "ok\r\n");
        let most = if is_slow { "115200" } else { "1000000" };
        let described = said(board, "$ES");
        let row = described.lines().find(|line| line.starts_with("[SETTING:931|")).expect("a row");
        assert!(row.contains(&format!("|115200|{most}|")), "{}: {row}", board.name);
        // A byte takes ten bit times. This must be at least 1.5 times the longest run of the step task: the additional
        // half is for other code at the interrupt's priority.
        let byte = 10.0 / f64::from(board.most_baud);
        assert!(!is_slow || 1.5 * f64::from(board.run_cycles) / f64::from(board.core_hz) < byte, "{}", board.name);
    }
}

/// `oxmill check --board` reports the words that a board's image lacks. So `has_all_words` must match the features that
/// the image is built with.
#[test]
fn boards_have_the_words_of_their_images() {
    let manifest = include_str!("../src/firmware/Cargo.toml");
    for board in profiles::IMAGES {
        let features = manifest.lines().find(|line| line.starts_with(&format!("{} = [", board.name)));
        let features = features.unwrap_or_else(|| panic!("no features of {}", board.name));
        assert_eq!(features.contains("\"oxmill-controller/full\""), board.has_all_words, "{}", board.name);
    }
}
