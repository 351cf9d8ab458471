//! Imports the output of `$$` of Grbl, grblHAL or Oxmill. Most numbers have the same meaning. In a dump of grblHAL, the
//! bits of a mask become those settings of Oxmill that mean the same. Settings that only grblHAL has are listed as not
//! taken, each with a reason.

use crate::import_list::{FileEntry, Import, NO_SETTING, decimal, number, row, values_of, whole};
use oxmill_controller::axes::LINEAR;
use oxmill_controller::settings::{AxisKey, GrblHalMask, Key, Kind};
use oxmill_controller::units::Decimal;
use std::ops::RangeInclusive;

/// Settings with this number or a higher one are Oxmill's own.
const OWN: u32 = 900;
/// Numbers of Grbl's settings for each axis. Some builds of Grbl have more than three axes.
const PER_AXIS: RangeInclusive<u32> = 100..=139;
/// Value of `$900` for the dialect of grblHAL, in which `$$` lists masks as grblHAL does.
const GRBLHAL: Decimal = Decimal::from_int(3);
/// Value of `$930`, the number of axes, with which the axis A is in use.
const WITH_A: Decimal = Decimal::from_int(4);
/// Number of the setting for the fourth homing cycle, `$47`. A machine with three axes has only three.
const FOURTH_CYCLE: u16 = AxisKey::HomingCycle.number() + LINEAR as u16;
/// Number of the setting for the resolution of A, `$103`.
const RESOLUTION_OF_A: u16 = AxisKey::Resolution.number() + LINEAR as u16;
/// Number of grblHAL's setting for the retract of G73.
const HAL_PECK: u16 = 28;
/// Number of grblHAL's setting for tool changes.
const HAL_TOOL_CHANGE: u16 = 341;

/// Settings of grblHAL that Oxmill does not have, each with the reason why it is not taken. From `$220` on, Oxmill
/// uses the same numbers for other settings, such as the jerk.
const HAL_ONLY: &[(RangeInclusive<u16>, &str)] = &[
    (7..=7, "the PWM is off at S0"),
    (8..=8, "$906 inverts the second motor of the axis in $905"),
    (9..=9, "the PWM is in proportion to S"),
    (15..=16, "invert the output in hardware"),
    (34..=36, "the duties are 0, just above 0, and 100 %"),
    (37..=37, "another board's wiring; $1=255 keeps all motors on"),
    (39..=39, "?, ! and ~ are always commands"),
    (47..=49, "three axes have three homing cycles"),
    (50..=55, "the sender sets distances and rates of jogs"),
    (60..=65, "as in Grbl"),
    (80..=96, "no closed loops"),
    (140..=159, "set current and microsteps on the driver"),
    (170..=179, "no offset of a squared axis"),
    (180..=199, "$24 and $25 are for all axes"),
    (200..=299, "set the driver itself"),
    (300..=335, "no network"),
    (340..=340, "$915 and $916 wait for an input at speed"),
    (376..=376, "A always turns"),
    (384..=384, "a reset always forgets G92"),
    (398..=398, "the look-ahead of a board is fixed"),
    (481..=481, "a host sends ?"),
    (484..=484, "after an emergency stop reset, then $X or $H"),
    (800..=805, "see $220, in mm/s3"),
];

/// A line `$n=v`. `value`: `None` if it is not a number. `at`: number of the line, from 1.
struct Line<'a> {
    number: u32,
    value: Option<Decimal>,
    written: &'a str,
    at: usize,
}

/// Imports the output of `$$`; `None` if the text has no line `$n=v`.
pub fn import(text: &str) -> Option<Import> {
    let (mut found, mut others) = (Vec::new(), Vec::new());
    for (index, written) in text.split('\n').enumerate() {
        let written = written.trim();
        match assignment(written, index + 1) {
            Some(line) => found.push(line),
            None if is_blank(written) || is_said_around_settings(written) => {}
            None => others.push(FileEntry::new(written, index + 1)),
        }
    }
    if found.is_empty() {
        return None;
    }
    let exists = |number: u32| u16::try_from(number).ok().and_then(row).is_some();
    let is_own = found.iter().any(|line| line.number >= OWN && exists(line.number));
    let is_unknown = |number: u32| number < OWN && !PER_AXIS.contains(&number) && !exists(number);
    let is_hal = !is_own && (says_grblhal(text) || found.iter().any(|line| is_unknown(line.number)));
    let mut import = Import::of(if is_own {
        "Oxmill"
    } else if is_hal {
        "grblHAL"
    } else {
        "Grbl"
    });
    let value_of = |number: u16| found.iter().rfind(|line| line.number == u32::from(number))?.value;
    let has_masks = is_hal || value_of(Key::Dialect.number()) == Some(GRBLHAL);
    for line in &found {
        let entry = FileEntry::new(line.written, line.at);
        let Some(value) = line.value else {
            import.leave(&entry, "no number");
            continue;
        };
        let Ok(number) = u16::try_from(line.number) else {
            import.leave(&entry, NO_SETTING);
            continue;
        };
        match GrblHalMask::of(number).zip(whole(value)).filter(|_| has_masks) {
            Some((mask, bits)) => take_mask(&mut import, number, mask, bits, &entry),
            None if is_hal => take_of_hal(&mut import, number, value, axes(&found), &entry),
            None => import.take(number, value, &entry),
        }
    }
    if !is_own {
        use_a(&mut import, &found);
    }
    others.iter().for_each(|entry| import.leave(entry, "not of the form $n=v"));
    Some(import.finish())
}

/// Returns whether a line is blank or has only a comment.
fn is_blank(line: &str) -> bool {
    line.split([';', '#', '(']).next().unwrap_or_default().trim().is_empty()
}

/// Returns whether a line is `$$` itself, or other output of a machine. Text copied from a terminal may contain both.
pub fn is_said_around_settings(line: &str) -> bool {
    let line = line.trim();
    matches!(line, "ok" | "$$") || ["Grbl ", "GrblHAL ", "[", "<"].iter().any(|begin| line.starts_with(begin))
}

/// Parses `$n=v`, after which a comment may follow. `at`: number of the line, from 1.
fn assignment(written: &str, at: usize) -> Option<Line<'_>> {
    let (name, value) = written.strip_prefix('$')?.split_once('=')?;
    let name = name.trim_end();
    let number_of_line = name.parse().ok().filter(|_| name.bytes().all(|byte| byte.is_ascii_digit()))?;
    let value = value.trim_start().split([' ', '\t', '(', ';']).next().unwrap_or_default();
    Some(Line { number: number_of_line, value: number(value), written, at })
}

/// Returns whether the text has a greeting or an answer to `$I` of grblHAL.
fn says_grblhal(text: &str) -> bool {
    text.lines().map(str::trim).any(|line| line.starts_with("GrblHAL ") || line == "[FIRMWARE:grblHAL]")
}

/// Returns the mask of the axes of the machine: X, Y, Z, and A if the dump has a resolution of A. Bit 0 is X.
fn axes(found: &[Line]) -> u32 {
    if found.iter().any(|line| line.number == u32::from(RESOLUTION_OF_A)) { 0b1111 } else { 0b111 }
}

/// Imports a mask of grblHAL in three parts. Bits that mean the same in Oxmill become the setting with this number. In
/// a dump of grblHAL, one bit of `$22` becomes `$932`. Bits without a function in Oxmill are listed as not taken.
fn take_mask(import: &mut Import, number: u16, mask: &GrblHalMask, bits: u32, entry: &FileEntry) {
    import.take(number, decimal(bits & mask.own), entry);
    if let Some(on) = mask.zero_at_pull_off(bits).filter(|_| import.what == "grblHAL") {
        import.take(Key::ZeroAtPullOff.number(), decimal(on.into()), entry);
    }
    leave_bits(import, bits & !mask.bits(), "Oxmill has no function for them", entry);
}

fn leave_bits(import: &mut Import, bits: u32, why: &str, entry: &FileEntry) {
    if bits != 0 {
        import.leave(entry, format!("bits with the sum {bits}: {why}"));
    }
}

/// Imports a setting of grblHAL that `take_mask` does not handle, or lists it as not taken. `axes`: mask of the axes of
/// the machine, bit 0 is X.
fn take_of_hal(import: &mut Import, number: u16, value: Decimal, axes: u32, entry: &FileEntry) {
    const ENABLE_INVERT: u16 = Key::EnableInvert.number();
    const LIMIT_INVERT: u16 = Key::LimitInvert.number();
    const SINGLE_BITS: [u16; 3] = [Key::ProbeInvert.number(), Key::HardLimits.number(), Key::Parking.number()];
    const ANY_BIT: [u16; 2] = [Key::SoftLimits.number(), Key::JogClip.number()];
    let is_cycle_of_a = number == FOURTH_CYCLE && axes >> LINEAR != 0;
    let reason = HAL_ONLY.iter().find(|(numbers, _)| numbers.contains(&number)).filter(|_| !is_cycle_of_a);
    if let Some((_, why)) = reason {
        return import.leave(entry, *why);
    }
    let Some(row) = row(number) else { return take_of_hal_only(import, number, value, entry) };
    match (number, row.entry.kind, whole(value)) {
        (ENABLE_INVERT, _, Some(mask)) if mask & axes == axes => import.take(number, decimal(1), entry),
        (LIMIT_INVERT, _, Some(mask)) => {
            let is_all = mask & axes == axes;
            import.take(number, decimal(is_all.into()), entry);
            import.take(Key::LimitInvertEach.number(), decimal(if is_all { 0 } else { mask }), entry);
        }
        (_, Kind::Switch, Some(bits)) if SINGLE_BITS.contains(&number) => {
            import.take(number, decimal(bits & 1), entry);
            leave_bits(import, bits & !1, &values_of(&row), entry);
        }
        (_, Kind::Switch, Some(bits)) if ANY_BIT.contains(&number) => {
            import.take(number, decimal(bits.min(1)), entry);
        }
        (_, Kind::Mask(known), Some(bits)) => {
            import.take(number, decimal(bits & known), entry);
            leave_bits(import, bits & !known, &values_of(&row), entry);
        }
        _ => import.take(number, value, entry),
    }
}

/// Imports a setting whose number only grblHAL has, if Oxmill has that setting under another number. Otherwise lists it
/// as not taken.
fn take_of_hal_only(import: &mut Import, number: u16, value: Decimal, entry: &FileEntry) {
    match (number, whole(value)) {
        (HAL_PECK, _) => import.take(Key::PeckClearance.number(), value, entry),
        // In grblHAL, 0 means that M6 waits for the tool.
        (HAL_TOOL_CHANGE, Some(0)) => import.take(Key::ToolChange.number(), decimal(1), entry),
        // In grblHAL, 4 means that M6 is ignored.
        (HAL_TOOL_CHANGE, Some(4)) => import.take(Key::ToolChange.number(), decimal(0), entry),
        (HAL_TOOL_CHANGE, _) => {
            import.leave(entry, "see $918: with 2 the tool is changed at G30 and measured at G59.3")
        }
        _ if PER_AXIS.contains(&u32::from(number)) => import.leave(entry, "no axis B or C"),
        _ => import.leave(entry, "grblHAL's own: Oxmill has no such setting"),
    }
}

/// Sets `$930=4`, which puts the axis A in use, if the dump of another controller has a resolution of A.
fn use_a(import: &mut Import, found: &[Line]) {
    let line = found.iter().find(|line| line.number == u32::from(RESOLUTION_OF_A));
    if let Some(line) = line.filter(|_| import.has(RESOLUTION_OF_A)) {
        import.take(Key::Axes.number(), WITH_A, &FileEntry::new(line.written, line.at));
    }
}
