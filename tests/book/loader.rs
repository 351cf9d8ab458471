//! The boot loader in the ROM of the chips: it switches a pull-up on at some outputs of a board, and may drive some
//! pins. Source: ST's AN2606, tables "configuration in system memory boot mode". The tables are those of the STM32F401,
//! F411, F446 and F40xxx, with the boot loaders V13, V13, V9 and V9.1. V3.1 of the F40xxx uses fewer pins than V9.1.
//! The table of the F412 was not available. So the F412 is assumed to use the pins of both the F411 and the F446.

use crate::wiring::{Way, Wire, groups};
use oxmill_tables::Board;

struct Loader {
    /// Pins on which the loader switches a pull-up on: those of its UARTs and of CAN.
    up: &'static [&'static str],
    /// Pins that the loader may drive: its outputs of SPI (MISO) and CAN (TX).
    driven: &'static [&'static str],
}

const F401_F411: Loader = Loader { up: &["D5", "D6"], driven: &["A6", "B14", "C11"] };
const F446: Loader = Loader { up: &["B5", "B10", "B11", "C10", "C11"], driven: &["A6", "B13", "B14", "E13"] };
const F407: Loader = Loader { up: &["B5", "B10", "B11", "C10", "C11"], driven: &["A6", "B13"] };
const F412: Loader =
    Loader { up: &["B5", "B10", "B11", "C10", "C11", "D5", "D6"], driven: &["A6", "B13", "B14", "C11", "E13"] };

fn loader(board: &Board) -> &'static Loader {
    match &board.chip.name["STM32".len().."STM32F411".len()] {
        "F401" | "F411" => &F401_F411,
        "F446" => &F446,
        "F407" => &F407,
        "F412" => &F412,
        other => panic!("no boot loader of {other}"),
    }
}

/// Returns the two cells of a board in the table of boot loaders. The first lists the outputs on which the boot loader
/// switches a pull-up on, the second the pins that it may drive.
pub fn cells(board: &Board) -> [String; 2] {
    let loader = loader(board);
    let groups = groups(board);
    let wires = || groups.iter().flat_map(|group| &group.wires).filter(|wire| !wire.key.is_empty());
    let listed = |chosen: &dyn Fn(&&Wire) -> bool| {
        let found: Vec<String> = wires().filter(chosen).map(|wire| format!("{} ({})", short(wire), wire.pin)).collect();
        if found.is_empty() { "none".to_owned() } else { found.join(", ") }
    };
    let is_pulled_up = |wire: &&Wire| wire.way == Way::Output && loader.up.contains(&wire.pin.as_str());
    [listed(&is_pulled_up), listed(&|wire| loader.driven.contains(&wire.pin.as_str()))]
}

/// Returns the function of a pin in words. The words are bold if a high level at the pin may start a spindle, coolant
/// or another load.
fn short(wire: &Wire) -> String {
    let text = wire.text.split(',').next().unwrap_or_default();
    let starts =
        ["spindle_on", "spindle_direction", "spindle_pwm", "flood", "mist", "program_output", "second_program_output"];
    if starts.contains(&wire.key) { format!("**{text}**") } else { text.to_owned() }
}
