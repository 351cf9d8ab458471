//! Reads a board's file (`NAME.toml`) and checks it, above all which pin each function may have. Each rule has an error
//! message of its own, a [`Fault`] with the number of the line.

use super::{Board, CHIPS, Chip, Fault, Use, name_of, text_of};
use oxmill_boards::pin_table::{NAME_SIZE, Pin, Role};
use oxmill_boards::profiles::{self, IMAGES};
use std::collections::BTreeMap;
use toml::{Table, Value};

/// Oscillator frequencies that a board's file may name, MHz.
const OSCILLATORS: [u8; 9] = [4, 8, 10, 12, 16, 20, 24, 25, 26];
/// Names of the entries that a file may have at its top level.
const KEYS: [&str; 7] = ["name", "title", "image", "chip", "oscillator", "remarks", "pins"];
/// Functions that switch a device on with a high level. The chip pulls A15 and B4 up during a reset, so these
/// functions must not have these pins.
const ON_WHEN_HIGH: [Role; 7] = [
    Role::SpindleOn,
    Role::SpindlePwm,
    Role::Flood,
    Role::Mist,
    Role::ProgramOutput,
    Role::SecondProgramOutput,
    Role::MotorPower,
];
/// Pairs of functions: a board that has a pin for the first must also have one for the second.
const NEEDS: [(Role, Role); 14] = [
    (Role::StepX, Role::DirectionX),
    (Role::StepY, Role::DirectionY),
    (Role::StepZ, Role::DirectionZ),
    (Role::StepFourth, Role::DirectionFourth),
    (Role::DirectionX, Role::StepX),
    (Role::DirectionY, Role::StepY),
    (Role::DirectionZ, Role::StepZ),
    (Role::DirectionFourth, Role::StepFourth),
    (Role::LimitFourth, Role::StepFourth),
    (Role::SecondEnable, Role::Enable),
    (Role::ThirdEnable, Role::SecondEnable),
    (Role::FourthEnable, Role::ThirdEnable),
    (Role::SecondProgramOutput, Role::ProgramOutput),
    (Role::SecondProgramInput, Role::ProgramInput),
];

struct Checked<'a> {
    text: &'a str,
    faults: Vec<Fault>,
}

impl Checked<'_> {
    fn fault(&mut self, line: usize, text: String) {
        self.faults.push(Fault { line, text });
    }

    /// Returns the number of the line that sets the entry `key`, counted from 1; 0 if there is no such line. With
    /// `in_pins`, searches below the heading `[pins]`, otherwise above it.
    fn line_of(&self, key: &str, in_pins: bool) -> usize {
        let mut is_behind = false;
        for (at, line) in self.text.lines().enumerate() {
            let line = line.trim_start();
            is_behind |= line.starts_with("[pins]");
            let rest = line.strip_prefix(key).map(str::trim_start);
            if is_behind == in_pins && rest.is_some_and(|rest| rest.starts_with('=')) {
                return at + 1;
            }
        }
        0
    }

    /// Returns the text of the entry `key`. If the entry is missing or is no text, returns `None` and adds a fault,
    /// which proposes `example` as the value.
    fn required<'t>(&mut self, table: &'t Table, key: &str, example: &str) -> Option<&'t str> {
        match table.get(key) {
            Some(Value::String(text)) => return Some(text),
            Some(_) => {
                let line = self.line_of(key, false);
                self.fault(line, format!("{key} must be a text in quotes: {key} = \"{example}\""));
            }
            None => self.fault(0, format!("{key} is missing: write {key} = \"{example}\" above [pins]")),
        }
        None
    }
}

/// Reads and checks a board's file. If the file has faults, returns them in the order of their lines.
pub fn parse(text: &str) -> Result<Board, Vec<Fault>> {
    let mut checked = Checked { text, faults: Vec::new() };
    let table = match text.parse::<Table>() {
        Ok(table) => table,
        Err(error) => {
            let before = error.span().map_or("", |span| text.get(..span.start).unwrap_or_default());
            let line = before.matches('\n').count() + 1;
            checked.fault(line, format!("no TOML: {}", error.message().replace('\n', " ")));
            return Err(checked.faults);
        }
    };
    let board = read(&mut checked, &table);
    checked.faults.sort();
    match board {
        Some(board) if checked.faults.is_empty() => Ok(board),
        _ => Err(checked.faults),
    }
}

fn read(checked: &mut Checked<'_>, table: &Table) -> Option<Board> {
    for key in table.keys().filter(|key| !KEYS.contains(&key.as_str())) {
        let line = checked.line_of(key, false);
        checked.fault(line, format!("unknown entry {key}: entries are {}", KEYS.join(", ")));
    }
    let name = checked.required(table, "name", "my_board").map(|name| (name, checked.line_of("name", false)));
    if let Some((name, line)) = name {
        check_name(checked, name, line);
    }
    let title = table.get("title").and_then(Value::as_str).or(name.map(|(name, _)| name)).unwrap_or_default();
    let image = checked.required(table, "image", "blackpill_f411").and_then(|image| image_named(checked, image));
    let chip = checked.required(table, "chip", "STM32F411CE").and_then(|chip| chip_named(checked, chip));
    let oscillator = checked.required(table, "oscillator", "measured");
    let oscillator = oscillator.and_then(|text| read_oscillator(checked, text));
    let pins = match table.get("pins") {
        Some(Value::Table(pins)) => read_pins(checked, pins),
        _ => {
            checked.fault(0, "the pins are missing: write [pins], and below it lines such as step_x = \"A1\"".into());
            return None;
        }
    };
    let (image, chip) = (image?, chip?);
    let family = |name: &str| name.rsplit('_').find_map(|part| part.strip_prefix('f')?.get(..3).map(str::to_owned));
    if family(image.name).is_some_and(|family| !chip.name.contains(&format!("F{family}"))) {
        let line = checked.line_of("chip", false);
        checked.fault(line, format!("the image {} does not run on {}", image.name, chip.name));
    } else if chip.name == "STM32F401CC" && image.name != "blackpill_f401" {
        let line = checked.line_of("chip", false);
        checked.fault(line, format!("{} has 256 KiB of flash, and the image {} needs 512", chip.name, image.name));
    }
    check_pins(checked, &image, chip, &pins);
    let (oscillator_mhz, is_external) = oscillator?;
    let remarks = table
        .get("remarks")
        .and_then(Value::as_array)
        .map_or(Vec::new(), |remarks| remarks.iter().filter_map(Value::as_str).map(str::to_owned).collect());
    let (name, title) = (name?.0.to_owned(), title.to_owned());
    Some(Board { name, title, image, chip, oscillator_mhz, is_external, remarks, pins })
}

fn check_name(checked: &mut Checked<'_>, name: &str, line: usize) {
    if name.is_empty() || name.len() > NAME_SIZE {
        checked.fault(line, format!("a name has 1 to {NAME_SIZE} characters, and this one {}", name.len()));
    }
    if let Some(wrong) = name.chars().find(|c| !matches!(c, 'a'..='z' | '0'..='9' | '_')) {
        checked.fault(line, format!("a name consists of a to z, 0 to 9 and _, and not of {wrong:?}"));
    }
}

fn image_named(checked: &mut Checked<'_>, name: &str) -> Option<profiles::Board> {
    let found = IMAGES.into_iter().find(|image| image.name == name);
    if found.is_none() {
        let names = IMAGES.map(|image| image.name).join(", ");
        let line = checked.line_of("image", false);
        checked.fault(line, format!("there is no image {name}; there are {names}"));
    }
    found
}

fn chip_named(checked: &mut Checked<'_>, name: &str) -> Option<&'static Chip> {
    let found = CHIPS.iter().find(|chip| chip.name == name);
    if found.is_none() {
        let names = CHIPS.each_ref().map(|chip| chip.name).join(", ");
        let line = checked.line_of("chip", false);
        checked.fault(line, format!("unknown chip {name}; known are {names}"));
    }
    found
}

/// Reads the entry `oscillator`, for example `8 MHz, external`. The first value returned is the frequency in MHz, or
/// `None` if the firmware measures it. The second one is `true` if an external clock drives the oscillator's input. If
/// the text has another form, adds a fault and returns `None`.
fn read_oscillator(checked: &mut Checked<'_>, text: &str) -> Option<(Option<u8>, bool)> {
    let (frequency, is_external) = match text.strip_suffix(", external") {
        Some(frequency) => (frequency, true),
        None => (text, false),
    };
    if frequency == "measured" {
        return Some((None, is_external));
    }
    let mhz = frequency.strip_suffix(" MHz").and_then(|mhz| mhz.parse().ok());
    if let Some(mhz) = mhz.filter(|mhz| OSCILLATORS.contains(mhz)) {
        return Some((Some(mhz), is_external));
    }
    let all = OSCILLATORS.map(|mhz| mhz.to_string()).join(", ");
    let line = checked.line_of("oscillator", false);
    let forms = "\"measured\" or \"8 MHz\", and behind it \", external\" if a clock drives the input";
    checked.fault(line, format!("oscillator {text:?}: write {forms}; there are {all} MHz"));
    None
}

fn read_pins(checked: &mut Checked<'_>, table: &Table) -> BTreeMap<&'static str, Use> {
    let mut pins = BTreeMap::new();
    for (key, value) in table {
        let line = checked.line_of(key, true);
        let Some(role) = Role::ALL.into_iter().find(|role| name_of(*role) == key) else {
            let names = Role::ALL.map(name_of).join(", ");
            checked.fault(line, format!("unknown function {key}; functions are {names}"));
            continue;
        };
        let Some(text) = value.as_str() else {
            checked.fault(line, format!("{key}: write the pin in quotes, such as {key} = \"A1\""));
            continue;
        };
        let (pin, label) = text.split_once(' ').unwrap_or((text, ""));
        match pin_named(pin) {
            Some(pin) => _ = pins.insert(name_of(role), Use { pin, label: label.trim().to_owned(), line }),
            None => checked.fault(line, format!("{key}: {pin:?} is no pin: write port and number, such as A1 or PB15")),
        }
    }
    pins
}

/// Reads the name of a pin, such as `A1` or `PA1`. Returns `None` for any other text.
fn pin_named(text: &str) -> Option<Pin> {
    let text = match text.as_bytes() {
        [b'P', b'A'..=b'H', ..] => &text[1..],
        _ => text,
    };
    let port = text.bytes().next().filter(|port| matches!(port, b'A'..=b'H'))? - b'A';
    let digits = text.get(1..).filter(|digits| digits.bytes().all(|digit| digit.is_ascii_digit()))?;
    let number = digits.parse().ok().filter(|number| *number < 16)?;
    Some(Pin { port, number })
}

fn check_pins(checked: &mut Checked<'_>, image: &profiles::Board, chip: &Chip, pins: &BTreeMap<&'static str, Use>) {
    let has = |role| pins.contains_key(name_of(role));
    for role in [Role::StepX, Role::StepY, Role::StepZ].into_iter().filter(|role| !has(*role)) {
        checked.fault(0, format!("{} is missing: X, Y and Z need a motor each", name_of(role)));
    }
    for (role, other) in NEEDS.into_iter().filter(|(role, other)| has(*role) && !has(*other)) {
        let line = pins[name_of(role)].line;
        checked.fault(line, format!("{} needs {}, which is missing", name_of(role), name_of(other)));
    }
    let mut taken: BTreeMap<Pin, &str> = BTreeMap::new();
    for (name, Use { pin, line, .. }) in pins {
        if let Some(why) = why_not(image, chip, *pin) {
            checked.fault(*line, format!("{name}: {} {why}", text_of(*pin)));
        } else if let Some(other) = taken.insert(*pin, name) {
            checked.fault(*line, format!("{name}: {} is also {other}; a pin has one function", text_of(*pin)));
        }
    }
    let has_pwm =
        |pin: &Pin| pin.channel_of_tim3().is_some() || image.tim8_makes_pulses && pin.channel_of_tim1().is_some();
    if let Some(Use { pin, line, .. }) = pins.get("spindle_pwm")
        && !has_pwm(pin)
    {
        let all = (0..5).flat_map(|port| (0..16).map(move |number| Pin { port, number }));
        let have: Vec<String> = all.filter(has_pwm).map(text_of).collect();
        let timers = if image.tim8_makes_pulses { "TIM1 or TIM3" } else { "TIM3" };
        let text = text_of(*pin);
        checked.fault(*line, format!("spindle_pwm: {text} has no channel of {timers}; {} have one", have.join(", ")));
    }
    for role in ON_WHEN_HIGH {
        if let Some(Use { pin, line, .. }) = pins.get(name_of(role))
            && ["A15", "B4"].contains(&text_of(*pin).as_str())
        {
            let (name, text) = (name_of(role), text_of(*pin));
            checked.fault(*line, format!("{name}: {text} is pulled up during a reset, which would switch {name} on"));
        }
    }
    check_ports(checked, image, pins);
}

/// Returns the reason why no function can have this pin, as the end of an error message: `is USB`. Returns `None` if
/// the pin can be used.
fn why_not(image: &profiles::Board, chip: &Chip, pin: Pin) -> Option<String> {
    let text = text_of(pin);
    let is = |pins: &[&str]| pins.contains(&text.as_str());
    let uart = if image.has_usb { ["A9", "A10"] } else { ["A2", "A3"] };
    if !chip.has(pin) {
        Some(format!("is no pin of {}", chip.name))
    } else if is(&["A13", "A14"]) {
        Some("is the debug port: without it a board can only be loaded over its boot loader".into())
    } else if is(&["H0", "H1"]) {
        Some("is the oscillator".into())
    } else if image.has_usb && is(&["A11", "A12"]) {
        Some("is USB".into())
    } else if is(&uart) {
        Some("is the UART to the host".into())
    } else if usize::from(pin.port) >= image.ports {
        let last = char::from(b'A' + image.ports as u8 - 1);
        Some(format!("is on a port that the image {} does not use: it uses A to {last}", image.name))
    } else {
        None
    }
}

/// Checks that the image has enough DMA streams for the ports of the step and direction pins. A port with steps needs
/// two streams, and a port with directions alone needs one.
fn check_ports(checked: &mut Checked<'_>, image: &profiles::Board, pins: &BTreeMap<&'static str, Use>) {
    let (steps, directions) = (image.step_ports, image.direction_ports);
    let mut ports: Vec<u8> = Vec::new();
    for (prefix, most, what) in [("step_", steps, "steps"), ("direction_", steps + directions, "steps and directions")]
    {
        for (name, Use { pin, line, .. }) in pins.iter().filter(|(name, _)| name.starts_with(prefix)) {
            if ports.contains(&pin.port) {
                continue;
            }
            ports.push(pin.port);
            if ports.len() > most {
                let letters: Vec<String> = ports.iter().map(|port| char::from(b'A' + port).to_string()).collect();
                let (text, all, image) = (text_of(*pin), letters.join(", "), image.name);
                checked
                    .fault(*line, format!("{name}: {text}: {what} are on the ports {all}, and {image} allows {most}"));
            }
        }
    }
}
