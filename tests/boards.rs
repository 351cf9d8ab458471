//! Checks that no pin of a board has two uses, and that each used pin is in the pin table of its wiring.

use oxmill_controller::{StepRates, StepTiming};
use oxmill_images::{BOARDS, SMALL};
use oxmill_simulator::{Options, Simulator};
use std::collections::BTreeSet;
use std::fs;
use std::path::PathBuf;

fn board_file(name: &str) -> String {
    let path = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("boards").join(name);
    fs::read_to_string(&path).unwrap_or_else(|error| panic!("{}: {error}", path.display()))
}

/// Returns name, code and pin table of each wiring.
fn wirings() -> [(&'static str, String, String); 2] {
    let pill = board_file("blackpill.rs");
    [("blackpill", pill.clone(), pill), ("nucleo64", board_file("nucleo64.rs"), board_file("nucleo64.md"))]
}

/// Returns the pins that the code uses, such as `a.pa7`, in order.
fn pins_of(code: &str) -> Vec<String> {
    let code: String = code.lines().filter(|line| !line.trim_start().starts_with("//")).collect();
    let mut found = Vec::new();
    for port in ["a", "b", "c"] {
        for (at, prefix) in code.match_indices(&format!("{port}.p{port}")) {
            let number: String = code[at + prefix.len()..].chars().take_while(char::is_ascii_digit).collect();
            if !number.is_empty() && !code[..at].ends_with(|c: char| c.is_alphanumeric()) {
                found.push(format!("{}{number}", port.to_uppercase()));
            }
        }
    }
    found
}

/// Returns the pins in the second column of the pin table.
fn pins_of_table(text: &str) -> BTreeSet<String> {
    let rows = text.lines().map(|line| line.trim_start_matches("//!").trim()).filter(|line| line.starts_with('|'));
    let cells = rows.filter_map(|row| row.split('|').nth(2).map(str::to_owned));
    cells
        .flat_map(|cell| {
            let words = cell.split(|c: char| !c.is_ascii_alphanumeric()).map(str::to_owned).collect::<Vec<_>>();
            words.into_iter().map(|word| word.strip_prefix('P').map_or(word.clone(), str::to_owned))
        })
        .collect()
}

#[test]
fn no_pin_is_used_twice_and_each_stands_in_the_table() {
    for (name, code, table) in wirings() {
        let pins = pins_of(&code);
        // Step, direction and limit of three axes; the other inputs and outputs of a mill; the link.
        assert!(pins.len() >= 20, "{name}: {pins:?}");
        let once: BTreeSet<&String> = pins.iter().collect();
        assert_eq!(once.len(), pins.len(), "{name} uses a pin twice: {pins:?}");
        let listed = pins_of_table(&table);
        for pin in &pins {
            assert!(listed.contains(pin), "{name}: the table has no {pin}, but {listed:?}");
        }
    }
}

/// The owner of each timer peripheral is created in only one place.
#[test]
fn no_timer_has_two_uses() {
    for (name, code, _) in wirings() {
        let taken: Vec<&str> = code
            .match_indices("device.")
            .map(|(at, prefix)| &code[at + prefix.len()..])
            .map(|rest| &rest[..rest.find(|c: char| !c.is_ascii_alphanumeric() && c != '_').unwrap_or(rest.len())])
            .filter(|peripheral| ["TIM", "USART", "DMA", "OTG"].iter().any(|kind| peripheral.starts_with(kind)))
            .collect();
        let once: BTreeSet<&&str> = taken.iter().collect();
        assert!(once.contains(&&"TIM2") && once.contains(&&"TIM3") && once.contains(&&"TIM5"), "{name}: {taken:?}");
        assert_eq!(once.len(), taken.len(), "{name} takes a peripheral twice: {taken:?}");
    }
}

/// The step output and the UART use different DMA streams. A Nucleo's UART uses two streams of DMA1; a Black Pill's
/// UART uses one of DMA2 while flash is written.
#[test]
fn no_stream_has_two_uses() {
    let number = |file: &str, name: &str| -> usize {
        let text = board_file(&format!("stm32f4/{file}"));
        let value = text.split(&format!("const {name}: usize = ")).nth(1).and_then(|rest| rest.split(';').next());
        value.and_then(|value| value.parse().ok()).unwrap_or_else(|| panic!("{file} has no {name}"))
    };
    let dma1 =
        [("chain.rs", "MOMENTS"), ("chain.rs", "BEAM"), ("usart_dma.rs", "RECEIVER"), ("usart_dma.rs", "SENDER")];
    let streams = dma1.map(|(file, name)| number(file, name));
    assert_eq!(streams, [2, 0, 5, 6]);
    // If all step pins are on one port, S1 and S4 of DMA2 make the edges and the ends of the pulses.
    assert!(board_file("stm32f4/chain.rs").contains("(0, 1) => Streams { on: 1, off: 4,"));
    assert_eq!(number("usart_interrupt.rs", "STREAM"), 2);
}

/// The USB pins are fixed, and VBUS sensing, which would take A9 from the USART, is off in the driver.
#[test]
fn usb_has_its_pins_its_clock_and_its_vector() {
    let pill = board_file("blackpill.rs");
    let pins = pins_of(&pill);
    for pin in ["A11", "A12"] {
        assert!(pins.iter().any(|taken| taken == pin), "USB has no {pin}");
    }
    assert!(pill.contains("require_pll48clk()"));
    assert!(pill.contains("usb: OTG_FS"), "USB has no vector");
    let nucleo = board_file("nucleo64.rs");
    assert!(nucleo.contains("UsbPort = NoPort") && !nucleo.contains("OTG"));
}

/// Several files repeat the list of boards, and no compiler compares them.
#[test]
fn every_board_stands_in_every_list() {
    let ci = board_file("../.ci/run");
    for name in BOARDS {
        let manifests = ["Cargo.toml", "../src/firmware/Cargo.toml", "../tests/on_target/Cargo.toml"];
        for file in ["../.ci/run", "sizes.txt", "profiles.rs", "lib.rs"].into_iter().chain(manifests) {
            assert!(board_file(file).contains(name), "{file} has no {name}");
        }
        assert!(name == "qemu_mps2" || board_file("../README.md").contains(name), "README.md has no {name}");
        let case = ci.contains(&format!("{name}) echo firmware-small"));
        assert_eq!(case, SMALL.contains(&name), "the profile of {name} in .ci/run");
    }
}

#[test]
fn every_board_has_its_sizes_and_a_probe_profile() {
    let embed = board_file("../Embed.toml");
    for name in BOARDS {
        assert!(oxmill_images::chip(name).is_some(), "{name}");
        assert!(name == "qemu_mps2" || embed.contains(&format!("[{name}.general]")), "{name}");
    }
}

/// The rule of docs/cost.md, "Step rates". The step task generates events in batches and queues them in a ring. A full
/// ring lasts at least as long as two of the longest runs of the step task and half a batch. Batches for three axes
/// take at most half of the processor's time. After the shortest pulse, the pause is long enough for the pulse timer to
/// stop.
#[test]
fn step_rates_follow_the_rule() {
    const DEPTH: u64 = 96;
    const BATCH: u64 = 32;
    for board in oxmill_boards::profiles::ALL.iter().filter(|board| !["desk", "qemu_mps2"].contains(&board.name)) {
        let (hz, core_hz) = (u64::from(board.safe_step_hz), u64::from(board.core_hz));
        let runs = 2 * u64::from(board.run_cycles) * hz;
        assert!(runs <= (DEPTH - BATCH / 2) * core_hz, "{board:?}");
        // 1,582 cycles: 1.1 times what `cargo xtask count` reports for a batch with three axes, or slightly more.
        assert!(1_582 * hz / BATCH <= core_hz / 2, "{board:?}");
        let rates = StepRates { safe_hz: u32::MAX, least_pulse_tenths: board.least_pulse_tenths };
        assert!(rates.greatest_hz(board.least_pulse_tenths) >= hz as f32, "{board:?}");
        // The pause must have room for 7 ticks: 4 from the trigger to the first count, 1 to the edge, 1 after the
        // pulse, 1 to the stop. A tick of the pulse timer is not longer than a tick of the step clock.
        let timing = StepTiming::new(board.step_clock_hz / 1_000_000, board.least_pulse_tenths, 0);
        assert!(timing.gap > timing.pulse + 7, "{board:?}");
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

/// On a board without a pin for the at-speed signal, a setting that enables the signal would make every spindle count
/// as up to speed, or none at all.
#[test]
fn a_board_without_a_pin_for_the_speed_takes_no_setting_for_it() {
    for (wiring, code, _) in wirings() {
        let has_pin = code.contains("input_bits::AT_SPEED, ");
        let boards = oxmill_boards::profiles::ALL.into_iter().filter(|board| board.name.starts_with(&wiring[..6]));
        for board in boards {
            let lock = "[MSG:Motion is locked until this setting is mended: $915]";
            for value in [1, 2] {
                assert_eq!(said(board, &format!("$915={value}")).contains(lock), !has_pin, "{} {value}", board.name);
            }
            assert!(!said(board, "$915=0").contains(lock), "{}", board.name);
            assert_eq!(said(board, "$PINS").contains("[PIN:at speed,"), has_pin, "{}", board.name);
        }
    }
}

/// A Black Pill's UART has an interrupt for each byte, which has to wait while the step task runs. At rates above the
/// one in the board's table, bytes would be lost; the fast link of this board is USB.
#[test]
fn a_black_pill_takes_no_rate_of_its_uart_that_it_cannot_keep() {
    for board in oxmill_boards::profiles::ALL {
        let is_slow = board.name.starts_with("blackpill");
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
        // A byte takes ten bit times. The longest run of the step task, and half as much again for other code at the
        // interrupt's priority, must fit into this time.
        let byte = 10.0 / f64::from(board.most_baud);
        assert!(!is_slow || 1.5 * f64::from(board.run_cycles) / f64::from(board.core_hz) < byte, "{}", board.name);
    }
}

/// `oxmill check --board` reports the words that a board's image lacks. So `has_all_words` must match the features that
/// the image is built with.
#[test]
fn boards_have_the_words_of_their_images() {
    let manifest = include_str!("../src/firmware/Cargo.toml");
    for board in oxmill_boards::profiles::ALL.into_iter().filter(|board| board.name != "desk") {
        let features = manifest.lines().find(|line| line.starts_with(&format!("{} = [", board.name)));
        let features = features.unwrap_or_else(|| panic!("no features of {}", board.name));
        assert_eq!(features.contains("\"oxmill-controller/full\""), board.has_all_words, "{}", board.name);
    }
}
