//! `docs/boards.md`: the tables of boards and of pins are generated from the sources of the firmware.

use crate::{keep, read, root, with_table};
use oxmill_boards::profiles::{ALL, Board};
use oxmill_controller::StepRates;
use oxmill_tables::{BOARDS, Board as Described, Use, text_of};
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
    BOARDS.iter().map(|(name, _)| ALL.into_iter().find(|board| board.name == *name).expect("a profile"))
}

/// Returns the value of a linker-script symbol in KiB: 512 for `512K`.
fn kib(script: &str, symbol: &str) -> u32 {
    let value = script.split(&format!("{symbol} = ")).nth(1).and_then(|rest| rest.split_once("K;"));
    value.and_then(|(digits, _)| digits.parse().ok()).unwrap_or_else(|| panic!("no {symbol}"))
}

/// Returns the description of a board with hardware.
fn described(board: &str) -> Described {
    Described::named(board).expect("a board with a file")
}

/// What the image of a board leaves out.
fn left_out(board: &str) -> &'static str {
    let manifest = file("src/firmware/Cargo.toml");
    let image = described(board).image.name;
    let features = manifest.lines().find(|line| line.starts_with(&format!("{image} = "))).expect("a feature");
    if features.contains("\"oxmill-controller/full\"") { "nothing" } else { LEFT_OUT }
}

fn host(board: &str) -> &'static str {
    if described(board).image.has_usb { "USB, and a UART" } else { "the ST-LINK's USB port" }
}

fn boards_table() -> String {
    let mut table =
        "| board | chip | flash, RAM | processor | look-ahead | host | left out |\n|---|---|---|---|---|---|---|\n"
            .to_owned();
    for board in real() {
        let Described { chip, image, .. } = described(board.name);
        let (chip, script) = (chip.name, file(&format!("boards/images/chips/{}.x", image.name)));
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

/// The functions of pins, in the order of the page.
const FUNCTIONS: [(&str, &[&str]); 16] = [
    ("step X, Y, Z", &["step_x", "step_y", "step_z"]),
    ("direction X, Y, Z", &["direction_x", "direction_y", "direction_z"]),
    ("driver enable, low is on", &["enable", "second_enable", "third_enable", "fourth_enable"]),
    ("supply of the motors, high is on", &["motor_power"]),
    ("limit X, Y, Z", &["limit_x", "limit_y", "limit_z"]),
    ("probe", &["probe"]),
    ("reset or emergency stop, hold, start", &["reset", "hold", "start"]),
    ("safety door", &["door"]),
    ("driver fault", &["driver_fault"]),
    ("spindle at speed (`$915`)", &["at_speed"]),
    ("second motor of an axis (`$905`): step, direction, limit", &["step_fourth", "direction_fourth", "limit_fourth"]),
    ("spindle PWM or laser", &["spindle_pwm"]),
    ("spindle on, direction", &["spindle_on", "spindle_direction"]),
    ("flood, mist", &["flood", "mist"]),
    ("outputs of programs P0, P1", &["program_output", "second_program_output"]),
    ("inputs of programs P0, P1", &["program_input", "second_program_input"]),
];

/// The columns of the table of pins: boards whose pins differ.
const COLUMNS: [(&str, &str); 9] = [
    ("Black Pill F411, F401", "blackpill_f411"),
    ("Nucleo with CNC shield v3", "nucleo_f446re"),
    ("Octopus, Octopus Pro", "octopus_f446"),
    ("Spider", "spider_f446"),
    ("SKR 2", "skr2_f407"),
    ("Monster8", "monster8_f407"),
    ("Robin Nano V3", "robin_nano_v3"),
    ("JZ-F407", "jz_f407"),
    ("Black Pill with grblHAL's pins", "blackpill_f411_grblhal"),
];

fn pins_table() -> String {
    let boards = COLUMNS.map(|(_, name)| described(name));
    let heads = COLUMNS.map(|(head, _)| format!(" {head} |")).concat();
    let mut table = format!("| function |{heads}\n|---|{}\n", "---|".repeat(COLUMNS.len()));
    let mut seen = [0; COLUMNS.len()];
    let mut add_row = |function: &str, cells: Vec<String>| {
        let _ = writeln!(table, "| {function} | {} |", cells.join(" | "));
    };
    for (function, names) in FUNCTIONS {
        let cell = |(board, seen): (&Described, &mut usize)| {
            let pins: Vec<String> = names.iter().filter_map(|name| board.pins.get(name)).map(written).collect();
            *seen += pins.len();
            if pins.is_empty() { "none".to_owned() } else { pins.join(", ") }
        };
        let cells: Vec<String> = boards.iter().zip(&mut seen).map(cell).collect();
        if cells.iter().any(|cell| cell != "none") {
            add_row(function, cells);
        }
    }
    let uart = |board: &Described| if board.image.has_usb { "A9, A10" } else { "A2, A3" }.to_owned();
    let usb = |board: &Described| if board.image.has_usb { "A11, A12" } else { "none" }.to_owned();
    add_row("UART to the host: TX, RX", boards.iter().map(uart).collect());
    add_row("USB to the host: D-, D+", boards.iter().map(usb).collect());
    for (board, seen) in boards.iter().zip(seen) {
        assert_eq!(seen, board.pins.len(), "each pin of {} has its place in the table", board.name);
    }
    table
}

/// Returns a pin with its label, if the board has one: `F13 (MOTOR0)`.
fn written(pin: &Use) -> String {
    let text = text_of(pin.pin);
    if pin.label.is_empty() { text } else { format!("{text} ({})", pin.label) }
}

/// Returns titles, remarks and drawings of the boards.
fn wiring_list() -> String {
    let mut text = String::new();
    for board in real().map(|board| described(board.name)) {
        let _ = writeln!(text, "### {}: `{}`\n", board.title, board.name);
        for remark in &board.remarks {
            let _ = writeln!(text, "* {remark}");
        }
        if !board.drawing.is_empty() {
            let _ = writeln!(text, "\n```text\n{}\n```", board.drawing.trim_matches('\n'));
        }
        text.push('\n');
    }
    text
}

#[test]
fn the_page_of_boards_has_the_boards() {
    let tables =
        [("boards", boards_table()), ("rates", rates_table()), ("pins", pins_table()), ("wiring", wiring_list())];
    keep(&root().join("docs/boards.md"), |text| {
        tables.iter().fold(text.to_owned(), |text, (name, table)| with_table(&text, name, table))
    });
}

/// Facts about the boards in the page's text match the code.
#[test]
fn facts_of_the_page_of_boards_are_those_of_the_code() {
    let page = read(&root().join("docs/boards.md"));
    let pins = file("boards/stm32f4/pins.rs");
    assert!(pins.contains("set(place, PUPDR, 2, PULL_UP);"));
    let chip = file("boards/stm32f4/chip.rs");
    assert!(chip.contains("pub const SAMPLE_HZ: u32 = 20_000;") && page.contains("20,000 times a second"));
    assert!(chip.contains("pub const USUAL_BAUD: u32 = 115_200;") && page.contains("115200 baud"));
}
