//! `docs/boards.md`: the tables of boards and of pins are generated from the sources of the firmware.

use crate::{keep, read, root, with_table};
use oxmill_boards::profiles::{ALL, Board};
use oxmill_controller::StepRates;
use oxmill_images::BOARDS;
use std::collections::BTreeMap;
use std::fmt::Write;

/// Lengths of the step pulse (`$0`), tenths of a microsecond, for which the table lists maximum step rates.
const PULSES: [u16; 7] = [5, 10, 20, 25, 30, 50, 100];
/// What an image built for size lacks (the features of `FULL_IMAGE`).
const LEFT_OUT: &str = "expressions, parameters, O words; rotated and scaled coordinates; splines; rounded corners (`G64 P`); habits of CAM \
    programs (`G31`, `G70`, `G54.1`, D); outputs and inputs of programs; texts of settings and errors (`$ES`); recording (`$REC`)";

fn file(name: &str) -> String {
    read(&root().join(name))
}

/// Returns the boards that exist as hardware.
fn real() -> impl Iterator<Item = Board> {
    let built = BOARDS.into_iter().filter(|name| *name != "qemu_mps2");
    built.map(|name| ALL.into_iter().find(|board| board.name == name).expect("a profile"))
}

/// Returns the value of a linker-script symbol in KiB: 512 for `512K`.
fn kib(script: &str, symbol: &str) -> u32 {
    let value = script.split(&format!("{symbol} = ")).nth(1).and_then(|rest| rest.split_once("K;"));
    value.and_then(|(digits, _)| digits.parse().ok()).unwrap_or_else(|| panic!("no {symbol}"))
}

/// Returns the file with the pins of a board, without its comments.
fn wiring(board: &str) -> String {
    let set_up = file(&format!("boards/{board}.rs"));
    let name = ["blackpill", "nucleo64"].into_iter().find(|name| set_up.contains(&format!("crate::{name}")));
    code(name.expect("a wiring"))
}

fn code(wiring: &str) -> String {
    let text = file(&format!("boards/{wiring}.rs"));
    text.lines().filter(|line| !line.trim_start().starts_with("//")).map(|line| format!("{}\n", line.trim())).collect()
}

/// What the image of a board leaves out.
fn left_out(board: &str) -> &'static str {
    let manifest = file("src/firmware/Cargo.toml");
    let features = manifest.lines().find(|line| line.starts_with(&format!("{board} = "))).expect("a feature");
    if features.contains("\"oxmill-controller/full\"") { "nothing" } else { LEFT_OUT }
}

fn host(board: &str) -> &'static str {
    if wiring(board).contains("OTG_FS") { "USB, and a UART" } else { "the ST-LINK's USB port" }
}

fn boards_table() -> String {
    let mut table =
        "| board | chip | flash, RAM | processor | look-ahead | host | left out |\n|---|---|---|---|---|---|---|\n"
            .to_owned();
    for board in real() {
        let script = file(&format!("boards/images/chips/{}.x", board.name));
        let chip = script.trim_start_matches("/* ").split(':').next().expect("a chip").to_owned();
        let (flash, ram) = (kib(&script, "CHIP_FLASH_SIZE"), kib(&script, "CHIP_RAM_SIZE"));
        let (name, core, blocks) = (board.name, board.core_hz / 1_000_000, board.blocks);
        let _ = writeln!(
            table,
            "| `{name}` | {chip} | {flash} KiB, {ram} KiB | {core} MHz | {blocks} moves | {} | {} |",
            host(name),
            left_out(name)
        );
    }
    table
}

fn rates_table() -> String {
    let heads: String = PULSES.iter().map(|pulse| format!(" `$0={}` |", f32::from(*pulse) / 10.0)).collect();
    let mut table = format!("| steps/s of one axis at most |{heads}\n|---|{}\n", "---|".repeat(PULSES.len()));
    for board in real() {
        let rates = StepRates { safe_hz: board.safe_step_hz, least_pulse_tenths: board.least_pulse_tenths };
        let cell = |pulse: &u16| match *pulse < board.least_pulse_tenths {
            true => " no |".to_owned(),
            false => format!(" {:.0} |", rates.greatest_hz(*pulse).floor()),
        };
        let cells: String = PULSES.iter().map(cell).collect();
        let _ = writeln!(table, "| `{}` |{cells}", board.name);
    }
    table
}

/// Returns the pins in a piece of code, such as `a.pa10`, as `PA10`.
fn pins_in(code: &str) -> Vec<String> {
    let words = code.split(|c: char| !c.is_ascii_alphanumeric() && c != '.');
    let pins = words.filter_map(|word| word.split('.').nth(1).filter(|pin| pin.starts_with('p') && pin.len() > 2));
    pins.filter(|pin| pin[2..].bytes().all(|c| c.is_ascii_digit())).map(str::to_uppercase).collect()
}

/// Returns the pins between two pieces of code.
fn pins_between(code: &str, begin: &str, end: &str) -> Vec<String> {
    let piece = code.split_once(begin).and_then(|(_, rest)| rest.split_once(end)).map(|(piece, _)| piece);
    piece.map(pins_in).unwrap_or_default()
}

/// Returns the names of the inputs in the order of their pins in the boards.
fn inputs() -> Vec<String> {
    let chip = file("boards/stm32f4/chip.rs");
    let bits = chip.split_once("let bits = [").and_then(|(_, rest)| rest.split_once(']')).expect("the order").0;
    bits.split(", ").map(str::to_owned).collect()
}

/// Returns the functions of a wiring in the order of the page, each with its pins.
fn functions(wiring: &str) -> Vec<(&'static str, Vec<String>)> {
    let code = code(wiring);
    let given = pins_between(&code, "let inputs = each!([", "]");
    let named: BTreeMap<String, String> = inputs().into_iter().zip(given).collect();
    let input = |names: &[&str]| names.iter().filter_map(|name| named.get(*name).cloned()).collect::<Vec<_>>();
    let more = |name: &str| pins_between(&code, &format!("input_bits::{name}, "), ".into");
    let slow = pins_between(&code, "let [spindle, turn, flood, mist] =", "]");
    let steps = pins_between(&code, "let steps = each!([", "]");
    let directions = pins_between(&code, "let directions = each!([", "]");
    let second = [&steps[3..], &directions[3..], &more("SECOND_LIMIT")].concat();
    let pwm = pins_between(&code, "let _pwm = ", ".into_alternate");
    let uart =
        [pins_between(&code, "Serial::new(device.", ", link"), pins_between(&code, "let mut rx = ", ";")].concat();
    vec![
        ("step X, Y, Z", steps[..3].to_vec()),
        ("direction X, Y, Z", directions[..3].to_vec()),
        ("driver enable, low is on", pins_between(&code, "let [enable] = each!([", "]")),
        ("limit X, Y, Z", input(&["LIMITS", "LIMITS + 1", "LIMITS + 2"])),
        ("probe", input(&["PROBE"])),
        ("reset or emergency stop, hold, start", input(&["RESET", "HOLD", "START"])),
        ("safety door", input(&["DOOR"])),
        ("driver fault", more("DRIVER_FAULT")),
        ("spindle at speed (`$915`)", more("AT_SPEED")),
        ("second motor of an axis (`$905`): step, direction, limit", second),
        ("spindle PWM or laser", pwm),
        ("spindle on, direction", slow[..2].to_vec()),
        ("flood, mist", slow[2..].to_vec()),
        ("outputs of programs P0, P1", pins_between(&code, "let [first, second] = each!([", "]")),
        ("inputs of programs P0, P1", [more("PROGRAM"), more("SECOND_PROGRAM")].concat()),
        ("UART to the host: TX, RX", uart),
        ("USB to the host: D-, D+", pins_between(&code, "device.OTG_FS_PWRCLK),", "),")),
    ]
}

/// Returns the labels printed beside the pins of a Nucleo, from the table of `boards/nucleo64.md`: `PA10 PB3 (D2 D3)`,
/// `PC2 (CN7 pin 35)`.
fn prints() -> BTreeMap<String, String> {
    let table = file("boards/nucleo64.md");
    let cells = table.lines().filter(|line| line.starts_with('|')).filter_map(|line| line.split('|').nth(2));
    let mut found = BTreeMap::new();
    for (pins, names) in cells.filter_map(|cell| cell.trim().trim_end_matches(')').split_once(" (")) {
        let connector = names.split_once(" pin").map(|(connector, _)| connector);
        let names = names.split_once(" pin").map_or(names, |(_, numbers)| numbers.trim_start_matches('s'));
        for (pin, name) in pins.split(' ').zip(names.split_whitespace()) {
            found.insert(pin.to_owned(), connector.map_or(name.to_owned(), |connector| format!("{connector}-{name}")));
        }
    }
    found
}

fn pins_table() -> String {
    let prints = prints();
    let mut table = "| function | Black Pill F411, F401 | Nucleo with CNC shield v3 | pins of the Nucleo's chip |\n|---|---|---|---|\n".to_owned();
    let of_nucleo = functions("nucleo64");
    let mut seen = 0;
    for ((function, pill), (_, nucleo)) in functions("blackpill").into_iter().zip(of_nucleo) {
        let on_pill: Vec<&str> = pill.iter().map(|pin| &pin[1..]).collect();
        let on_shield: Vec<&str> =
            nucleo.iter().map(|pin| prints.get(pin).map_or(pin.as_str(), String::as_str)).collect();
        let or_none = |pins: Vec<&str>| if pins.is_empty() { "none".to_owned() } else { pins.join(", ") };
        seen += on_pill.len() + nucleo.len();
        let _ = writeln!(
            table,
            "| {function} | {} | {} | {} |",
            or_none(on_pill),
            or_none(on_shield),
            or_none(nucleo.iter().map(String::as_str).collect())
        );
    }
    let of_code = |wiring| pins_in(&code(wiring)).len();
    assert_eq!(seen, of_code("blackpill") + of_code("nucleo64"), "each pin of the code has its place in the table");
    table
}

#[test]
fn the_page_of_boards_has_the_boards() {
    let (boards, rates, pins) = (boards_table(), rates_table(), pins_table());
    keep(&root().join("docs/boards.md"), |text| {
        with_table(&with_table(&with_table(text, "boards", &boards), "rates", &rates), "pins", &pins)
    });
}

/// Facts about the boards in the page's text match the code.
#[test]
fn facts_of_the_page_of_boards_are_those_of_the_code() {
    let page = read(&root().join("docs/boards.md"));
    for wiring in ["blackpill", "nucleo64"] {
        assert!(code(wiring).contains(".into_pull_up_input()") && code(wiring).contains("PinState::High"));
    }
    let chip = file("boards/stm32f4/chip.rs");
    assert!(chip.contains("pub const SAMPLE_HZ: u32 = 20_000;") && page.contains("20,000 times a second"));
    assert!(chip.contains("pub const USUAL_BAUD: u32 = 115_200;") && page.contains("115200 baud"));
}
