//! `docs/boards.md`: its tables and the list of drawings are generated from the sources of the firmware.

use crate::{drawings, keep, loader, read, root, wiring, with_table};
use oxmill_boards::profiles::{ALL, Board};
use oxmill_controller::StepRates;
use oxmill_tables::{BOARDS, Board as Described};
use std::fmt::Write;

/// Lengths of the step pulse (`$0`) in the table of step rates, tenths of a microsecond.
const PULSES: [u16; 7] = [5, 10, 20, 25, 30, 50, 100];
/// What an image lacks if it is built for size, that is, without the features of `FULL_IMAGE`.
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

/// Returns the table cell for what the image of a board lacks.
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
    let mut rows: Vec<(Vec<String>, String)> = Vec::new();
    for board in real() {
        let rates = StepRates { safe_hz: board.safe_step_hz, least_pulse_tenths: board.least_pulse_tenths };
        let cell = |pulse: &u16| match *pulse < board.least_pulse_tenths {
            true => " no |".to_owned(),
            false => format!(" {:.0} |", rates.greatest_hz(*pulse).floor()),
        };
        let cells: String = PULSES.iter().map(cell).collect();
        let name = format!("`{}`", board.name);
        match rows.iter_mut().find(|(_, known)| *known == cells) {
            Some((names, _)) => names.push(name),
            None => rows.push((vec![name], cells)),
        }
    }
    // The row with the rates of most boards comes last, and is named "all others".
    rows.sort_by_key(|(names, _)| names.len());
    for (names, cells) in &rows {
        let is_rest = names.len() > BOARDS.len() / 2;
        let _ = writeln!(table, "| {} |{cells}", if is_rest { "all others".to_owned() } else { names.join(", ") });
    }
    table
}

/// The sections of the page: boards with the same pins share one.
pub const SECTIONS: [(&str, &[&str]); 11] = [
    ("WeAct Black Pill V2 and V3", &["blackpill_f411", "blackpill_f401"]),
    ("Black Pill on a carrier with grblHAL's pins", &["blackpill_f411_grblhal"]),
    ("ST Nucleo-64 with CNC shield v3", &["nucleo_f446re", "nucleo_f411re", "nucleo_f401re"]),
    ("BTT Octopus V1.0 and V1.1", &["octopus_f446"]),
    ("BTT Octopus Pro V1.0 and V1.1 with STM32F446", &["octopus_pro_f446"]),
    ("Fysetc Spider V1", &["spider_f446"]),
    ("BTT SKR 2 with STM32F407", &["skr2_f407"]),
    ("MKS Monster8 V1 and V2", &["monster8_f407"]),
    ("MKS Robin Nano V3 and V3.1, MKS Eagle", &["robin_nano_v3"]),
    ("JZ-F407VET6 industrial board", &["jz_f407"]),
    ("Sienci SuperLongBoard EXT", &["slb_ext"]),
];

/// Returns the boards of a section. Panics if their pins or remarks differ.
fn section(names: &[&str]) -> Vec<Described> {
    let boards: Vec<Described> = names.iter().map(|name| described(name)).collect();
    for board in &boards[1..] {
        let differs = |key: &&str| boards[0].pins[*key].pin != board.pins[*key].pin;
        assert_eq!(boards[0].pins.keys().collect::<Vec<_>>(), board.pins.keys().collect::<Vec<_>>(), "{}", board.name);
        assert_eq!(board.pins.keys().copied().find(|key| differs(key)), None, "{}", board.name);
        assert_eq!(boards[0].remarks, board.remarks, "{}", board.name);
    }
    boards
}

/// Returns drawing, table and remarks of the boards.
fn wiring_list() -> String {
    let mut text = String::new();
    for (title, names) in SECTIONS {
        let boards = section(names);
        let quoted: Vec<String> = names.iter().map(|name| format!("`{name}`")).collect();
        let file = drawings::path(names[0]);
        let _ = writeln!(text, "### {title}: {}\n", quoted.join(", "));
        let _ = writeln!(text, "![Wiring of the {title}]({})\n", file.trim_start_matches("docs/"));
        let _ = writeln!(text, "{}", wiring::table(&boards[0]));
        for remark in &boards[0].remarks {
            let _ = writeln!(text, "* {remark}");
        }
        text.push('\n');
    }
    text
}

/// Rows of the table for choosing a board. A row has a title, the boards, whom they suit, their drivers, and what they
/// lack. The numbers in the table come from the profiles.
const CHOICES: [(&str, &[&str], &str, &str, &str); 12] = [
    (
        "Black Pill, STM32F411",
        &["blackpill_f411"],
        "machines with external drivers; you wire each pin",
        "external, or modules that you wire",
        "axis A, at-speed input, outputs and inputs of programs",
    ),
    (
        "Black Pill, STM32F401",
        &["blackpill_f401"],
        "owners",
        "as above",
        "as above, and [expressions, splines, recording and more](limits.md#black-pill-f401)",
    ),
    (
        "Black Pill on a carrier with grblHAL's pins",
        &["blackpill_f411_grblhal"],
        "owners",
        "those of the carrier",
        "as the Black Pill F411; the carrier's PWM needs a wire to B5",
    ),
    (
        "Nucleo-64 F446RE",
        &["nucleo_f446re"],
        "small machines with little wiring: a CNC shield plugs in",
        "modules on the shield",
        "USB of its own: its link is a UART over the ST-LINK",
    ),
    (
        "Nucleo-64 F411RE, F401RE",
        &["nucleo_f411re", "nucleo_f401re"],
        "owners",
        "modules on the shield",
        "as above, and axis A",
    ),
    (
        "BTT Octopus, Octopus Pro, STM32F446",
        &["octopus_f446", "octopus_pro_f446"],
        "machines with small drivers and loads of 12 or 24 V; the Pro feeds drivers with up to 60 V",
        "modules in sockets",
        "drivers by UART or SPI, card, display; sockets 3, 5, 6 and 7",
    ),
    (
        "Fysetc Spider V1",
        &["spider_f446"],
        "owners of V1.0 or V1.1, not V2.2",
        "modules in sockets",
        "drivers by UART or SPI, card, display; sockets E0, E1, E3 and E4",
    ),
    (
        "BTT SKR 2 Rev B, STM32F407",
        &["skr2_f407"],
        "owners; not Rev A, not STM32F429",
        "modules in sockets",
        "drivers by UART or SPI, card, display; socket Z",
    ),
    (
        "MKS Monster8 V1, V2",
        &["monster8_f407"],
        "owners",
        "modules in sockets",
        "drivers by UART or SPI, card, display; sockets Driver0 to Driver3, connectors X- and X+",
    ),
    (
        "MKS Robin Nano V3, V3.1, Eagle",
        &["robin_nano_v3"],
        "owners",
        "modules in sockets; soldered on the Eagle",
        "drivers by UART or SPI, card, display; socket Z",
    ),
    (
        "JZ-F407VET6",
        &["jz_f407"],
        "owners who have the board's drawing: the map is preliminary",
        "external",
        "RS-485, Ethernet, card",
    ),
    (
        "Sienci SuperLongBoard EXT",
        &["slb_ext"],
        "owners; not the SuperLongBoard with drivers on the board",
        "external",
        "axis A, RS-485 (Modbus spindles), Ethernet, card, the tool setter's own input",
    ),
];

fn choice_table() -> String {
    let mut table = "| board | for | drivers | motors | axes | steps/s of an axis | what is missing |\n|---|---|---|---|---|---|---|\n".to_owned();
    let mut seen: Vec<&str> = Vec::new();
    for (title, names, whom, drivers, missing) in CHOICES {
        let numbers = |name: &&str| {
            let board = real().find(|board| board.name == *name).expect("a profile");
            let motors = described(name).pins.keys().filter(|key| key.starts_with("step_")).count();
            let axes = if board.axes > 3 { "X, Y, Z, A" } else { "X, Y, Z" };
            let rate = match board.safe_step_hz {
                1_000_000 => "1,000,000 (`$0=0.5`)".to_owned(),
                hz => format!("{},000", hz / 1000),
            };
            format!("{motors} | {axes} | {rate}")
        };
        let all: Vec<String> = names.iter().map(numbers).collect();
        assert!(all.iter().all(|own| *own == all[0]), "{names:?}: {all:?}");
        let quoted: Vec<String> = names.iter().map(|name| format!("`{name}`")).collect();
        let _ = writeln!(table, "| {title}: {} | {whom} | {drivers} | {} | {missing} |", quoted.join(", "), all[0]);
        seen.extend(names);
    }
    assert_eq!(seen.len(), BOARDS.len(), "each board has its row");
    table
}

/// Returns the table that shows, for each board, what the chip's boot loader does with the board's pins.
fn loader_table() -> String {
    let mut table = "| board | outputs with a pull-up | pins that it may drive |\n|---|---|---|\n".to_owned();
    let mut rows: Vec<(Vec<String>, [String; 2])> = Vec::new();
    for (name, _) in BOARDS {
        let cells = loader::cells(&described(name));
        match rows.iter_mut().find(|(_, known)| *known == cells) {
            Some((names, _)) => names.push(format!("`{name}`")),
            None => rows.push((vec![format!("`{name}`")], cells)),
        }
    }
    for (names, [up, driven]) in rows {
        let _ = writeln!(table, "| {} | {up} | {driven} |", names.join(", "));
    }
    table
}

#[test]
fn each_board_has_one_section() {
    let mut named: Vec<&str> = SECTIONS.iter().flat_map(|(_, names)| names.iter().copied()).collect();
    let mut known: Vec<&str> = BOARDS.iter().map(|(name, _)| *name).collect();
    named.sort_unstable();
    known.sort_unstable();
    assert_eq!(named, known);
}

#[test]
fn the_page_of_boards_has_the_boards() {
    let tables = [
        ("choice", choice_table()),
        ("boards", boards_table()),
        ("rates", rates_table()),
        ("wiring", wiring_list()),
        ("loader", loader_table()),
    ];
    keep(&root().join("docs/boards.md"), |text| {
        tables.iter().fold(text.to_owned(), |text, (name, table)| with_table(&text, name, table))
    });
}

#[test]
fn facts_of_the_page_of_boards_are_those_of_the_code() {
    let page = read(&root().join("docs/boards.md"));
    let pins = file("boards/stm32f4/pins.rs");
    assert!(pins.contains("set(place, PUPDR, 2, PULL_UP);"));
    let chip = file("boards/stm32f4/chip.rs");
    assert!(chip.contains("pub const SAMPLE_HZ: u32 = 20_000;") && page.contains("20,000 times a second"));
    assert!(chip.contains("pub const USUAL_BAUD: u32 = 115_200;") && page.contains("115200 baud"));
    assert!(chip.contains("self.0.start(2_000.millis());") && page.contains("2 s nominal"));
}
