//! Tests that each fault in a board's file gives its own message and line number, and that tables are written into
//! image files of all formats.

use super::*;
use crate::image_file::write;
use oxmill_boards::pin_table::SIZE;

/// A board's file without faults.
const GOOD: &str = r#"name = "mine"
image = "blackpill_f411"
chip = "STM32F411CE"
oscillator = "measured"
[pins]
step_x = "A1"
step_y = "A2 J3"
step_z = "PA3"
direction_x = "A4"
direction_y = "A5"
direction_z = "A6"
enable = "B0"
spindle_pwm = "A7"
probe = "B15"
"#;

/// Returns the faults of [`GOOD`] with `before` replaced by `after`, each as `line: text`.
fn faults(before: &str, after: &str) -> Vec<String> {
    assert!(GOOD.contains(before), "{before}");
    let parsed = Board::parse(&GOOD.replacen(before, after, 1));
    parsed.map_or_else(
        |faults| faults.iter().map(|fault| format!("{}: {}", fault.line, fault.text)).collect(),
        |_| vec![],
    )
}

/// Faults to make in [`GOOD`]: the text to replace, its replacement, and the beginning of the expected message.
const FAULTS: &[(&str, &str, &str)] = &[
    ("name = \"mine\"", "name = mine", "1: no TOML: "),
    ("step_x = \"A1\"", "step_x = \"A1\"\nstep_x = \"A8\"", "7: no TOML: duplicate key"),
    ("name = \"mine\"", "nome = \"mine\"", "0: name is missing: write name = \"my_board\" above [pins]"),
    ("name = \"mine\"", "name = \"mine\"\ncolour = 1", "2: unknown entry colour: entries are name, "),
    ("name = \"mine\"", "name = 1", "1: name must be a text in quotes: name = \"my_board\""),
    ("\"mine\"", "\"\"", "1: a name has 1 to 24 characters, and this one 0"),
    ("\"mine\"", "\"a_name_that_is_longer_than_any_table\"", "1: a name has 1 to 24 characters, and this one 36"),
    ("\"mine\"", "\"My board\"", "1: a name consists of a to z, 0 to 9 and _, and not of 'M'"),
    ("image = \"blackpill_f411\"\n", "", "0: image is missing: write image = "),
    ("\"blackpill_f411\"", "\"skr\"", "2: there is no image skr; there are blackpill_f411, "),
    ("chip = \"STM32F411CE\"\n", "", "0: chip is missing: write chip = "),
    ("\"STM32F411CE\"", "\"STM32F103\"", "3: unknown chip STM32F103; known are STM32F401CC, "),
    ("\"STM32F411CE\"", "\"STM32F446RE\"", "3: the image blackpill_f411 does not run on STM32F446RE"),
    ("oscillator = \"measured\"\n", "", "0: oscillator is missing: write oscillator = "),
    ("\"measured\"", "\"25\"", "4: oscillator \"25\": write \"measured\" or \"8 MHz\""),
    ("\"measured\"", "\"27 MHz\"", "4: oscillator \"27 MHz\": write"),
    ("[pins]", "[pin]", "0: the pins are missing: write [pins], and below it"),
    ("probe =", "prob =", "14: unknown function prob; functions are step_x, "),
    ("\"B15\"", "15", "14: probe: write the pin in quotes, such as probe = \"A1\""),
    ("\"B15\"", "\"B16\"", "14: probe: \"B16\" is no pin: write port and number"),
    ("\"B15\"", "\"15\"", "14: probe: \"15\" is no pin"),
    ("\"B15\"", "\"b15\"", "14: probe: \"b15\" is no pin"),
    ("\"B15\"", "\"B11\"", "14: probe: B11 is no pin of STM32F411CE"),
    ("\"B15\"", "\"D2\"", "14: probe: D2 is no pin of STM32F411CE"),
    ("\"B15\"", "\"A13\"", "14: probe: A13 is the debug port"),
    ("\"B15\"", "\"H0\"", "14: probe: H0 is the oscillator"),
    ("\"B15\"", "\"A12\"", "14: probe: A12 is USB"),
    ("\"B15\"", "\"A10\"", "14: probe: A10 is the UART to the host"),
    ("\"B15\"", "\"B0\"", "14: probe: B0 is also enable; a pin has one function"),
    ("step_z = \"PA3\"\n", "", "0: step_z is missing: X, Y and Z need a motor each"),
    ("step_z = \"PA3\"\n", "", "10: direction_z needs step_z, which is missing"),
    ("direction_x = \"A4\"\n", "", "6: step_x needs direction_x, which is missing"),
    ("probe = \"B15\"", "limit_fourth = \"B15\"", "14: limit_fourth needs step_fourth, which is missing"),
    ("enable = \"B0\"", "second_enable = \"B0\"", "12: second_enable needs enable, which is missing"),
    ("enable = \"B0\"", "second_program_output = \"B0\"", "12: second_program_output needs program_output"),
    ("enable = \"B0\"", "second_program_input = \"B0\"", "12: second_program_input needs program_input"),
    ("\"A7\"", "\"A8\"", "13: spindle_pwm: A8 has no channel of TIM3; A6, A7, B0, B1, B4, B5, C6, C7, C8, C9 have one"),
    ("enable = \"B0\"", "flood = \"A15\"", "12: flood: A15 is pulled up during a reset, which would switch flood on"),
    ("step_x = \"A1\"", "step_x = \"B1\"", "7: step_y: A2: steps are on the ports B, A, and blackpill_f411 allows 1"),
    (
        "direction_z = \"A6\"",
        "direction_z = \"B6\"",
        "11: direction_z: B6: steps and directions are on the ports A, B, and blackpill_f411 allows 1",
    ),
];

#[test]
fn each_fault_has_its_sentence() {
    assert!(Board::parse(GOOD).is_ok());
    for (before, after, wanted) in FAULTS {
        let found = faults(before, after);
        assert!(found.iter().any(|fault| fault.starts_with(wanted)), "{after}: {found:?}, and not {wanted}");
    }
}

/// A chip can have ports that the image does not use. Here the image of a Nucleo uses the ports A to C of a chip that
/// has A to H.
#[test]
fn a_port_that_the_image_does_not_use_is_refused() {
    let text = GOOD.replace("blackpill_f411", "nucleo_f446re").replace("STM32F411CE", "STM32F446ZE");
    let text = text.replace("\"A2 J3\"", "\"B2\"").replace("\"PA3\"", "\"B3\"").replace("\"B15\"", "\"F1\"");
    let found = Board::parse(&text).expect_err("a fault");
    assert_eq!(found[0].text, "probe: F1 is on a port that the image nucleo_f446re does not use: it uses A to C");
}

/// The image of a control board has DMA streams for two ports with step pins, and for two more ports with direction
/// pins alone.
#[test]
fn directions_of_a_control_board_may_be_on_ports_of_their_own() {
    let robin = include_str!("robin_nano_v3.toml");
    assert!(Board::parse(robin).is_ok());
    let faults = |before, after| Board::parse(&robin.replace(before, after)).expect_err("a fault");
    let found = faults("step_z = \"D6 E0\"", "step_z = \"B5 Z\"");
    assert_eq!(found[0].text, "step_z: B5: steps are on the ports D, E, B, and control_f407 allows 2");
    let found = faults("direction_z = \"D3 E0\"", "direction_z = \"C3\"");
    assert_eq!(
        found[0].text,
        "direction_z: C3: steps and directions are on the ports D, E, A, B, C, and control_f407 allows 4"
    );
}

/// In the image for the F412, TIM8 makes the pulses, so the spindle's PWM may be on a pin of TIM1.
#[test]
fn the_pwm_may_be_on_tim1_if_tim8_makes_the_pulses() {
    let slb = include_str!("slb_ext.toml");
    for pin in ["A8", "E14", "C6"] {
        assert!(Board::parse(&slb.replace("\"A8\"", &format!("\"{pin}\""))).is_ok(), "{pin}");
    }
    let found = Board::parse(&slb.replace("\"A8\"", "\"D15\"")).expect_err("a fault");
    assert!(
        found[0].text.starts_with("spindle_pwm: D15 has no channel of TIM1 or TIM3; A6, A7, A8, B0, "),
        "{found:?}"
    );
}

#[test]
fn an_image_that_does_not_fit_the_flash_is_refused() {
    let text = GOOD.replace("blackpill_f411", "nucleo_f401re").replace("STM32F411CE", "STM32F401CC");
    let text = text.replace("\"A2 J3\"", "\"B2\"").replace("\"PA3\"", "\"B3\"");
    let found = Board::parse(&text).expect_err("a fault");
    assert_eq!(found[0].text, "STM32F401CC has 256 KiB of flash, and the image nucleo_f401re needs 512");
}

#[test]
fn a_table_has_what_its_file_says() {
    let board = Board::parse(&GOOD.replace("\"measured\"", "\"8 MHz, external\"")).expect("no fault");
    assert_eq!(board.pins["step_y"].label, "J3");
    let table = board.table();
    assert!(table.is_intact() && table.is_external());
    assert_eq!((table.name(), table.oscillator_mhz(), table.image()), ("mine", Some(8), 1));
    assert_eq!(table.pin(Role::StepZ), Some(Pin { port: 0, number: 3 }));
    assert_eq!(table.pin(Role::Flood), None);
    for at in 0..SIZE {
        let mut bytes = *table.bytes();
        bytes[at] ^= 0x10;
        assert!(!PinTable::from_bytes(bytes).is_intact(), "byte {at}");
    }
}

#[test]
fn the_number_of_a_function_is_its_place_in_the_list() {
    for (place, role) in Role::ALL.into_iter().enumerate() {
        assert_eq!(role as usize, place, "{role:?}");
    }
    let names: std::collections::BTreeSet<&str> = Role::ALL.into_iter().map(name_of).collect();
    assert_eq!(names.len(), Role::ALL.len());
}

/// Returns the bytes of an invented image: 1000 bytes, the table, and 1000 bytes.
fn image(table: &PinTable) -> Vec<u8> {
    let before = (0..1000_u32).map(|n| (n * 7) as u8);
    before.clone().chain(*table.bytes()).chain(before).collect()
}

fn hex(bytes: &[u8]) -> Vec<u8> {
    let rows = bytes.chunks(16).enumerate();
    let rows = rows.map(|(n, row)| ihex::Record::Data { offset: (16 * n) as u16, value: row.to_vec() });
    let records: Vec<ihex::Record> = rows.chain([ihex::Record::EndOfFile]).collect();
    ihex::create_object_file_representation(&records).expect("records").into_bytes()
}

fn dfu(bytes: &[u8]) -> Vec<u8> {
    let mut file = [b"DfuSe".as_slice(), bytes, &[0; 12]].concat();
    let sum = crc::Crc::<u32>::new(&crc::CRC_32_JAMCRC).checksum(&file);
    file.extend(sum.to_le_bytes());
    file
}

#[test]
fn a_table_is_written_into_each_kind_of_image() {
    let (old, new) =
        (Board::named("blackpill_f411").expect("a board").table(), Board::parse(GOOD).expect("no fault").table());
    assert_eq!(write(&image(&old), &new), Ok(image(&new)));
    assert_eq!(write(&dfu(&image(&old)), &new), Ok(dfu(&image(&new))));
    let written = write(&hex(&image(&old)), &new).expect("an image");
    assert_eq!(
        String::from_utf8(written).unwrap().trim_end().as_bytes(),
        String::from_utf8(hex(&image(&new))).unwrap().trim_end().as_bytes()
    );
}

#[test]
fn an_image_that_cannot_take_the_table_is_refused() {
    let new = Board::parse(GOOD).expect("no fault").table();
    let no_table = Err("the file has no intact pin table: is it an undamaged image of Oxmill?".to_owned());
    assert_eq!(write(&[], &new), no_table);
    assert_eq!(write(b"some text that is no image", &new), no_table);
    let other = image(&Board::named("octopus_f446").expect("a board").table());
    let why = "the table is for another image: its entry `image` must name the image of the file";
    assert_eq!(write(&other, &new), Err(why.to_owned()));
    let mut damaged = dfu(&image(&new));
    damaged[100] ^= 1;
    assert_eq!(write(&damaged, &new), Err("the .dfu file is damaged: its checksum is wrong".to_owned()));
    let mut damaged = hex(&image(&new));
    damaged[20] = if damaged[20] == b'0' { b'1' } else { b'0' };
    assert!(write(&damaged, &new).is_err_and(|why| why.starts_with("the .hex file is damaged: ")));
}
