//! Settings, errors and alarms in words (`$ES`, `$ESG`, `$ESH`, `$EG`, `$EA`, `$EE`), in the formats of grblHAL, for
//! senders that show names instead of numbers.

use super::system::{Described, Format};
use super::text::{END, Text, filled, put, whole};
use crate::axes::Axis;
use crate::error::{Alarm, Error};
use crate::settings::{self, Description, Entry, GrblHalMask, Key, Kind, Row, SettingGroup, Settings};

/// How a sender shows a value; the numbers are grblHAL's.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum DataType {
    Switch = 0,
    Bits = 1,
    Choice = 3,
    Axes = 4,
    Integer = 5,
    Decimal = 6,
}

impl DataType {
    const fn word(self) -> &'static [u8] {
        match self {
            DataType::Switch => b"bool",
            DataType::Bits => b"bitfield",
            DataType::Choice => b"radiobuttons",
            DataType::Axes => b"axismask",
            DataType::Integer => b"integer",
            DataType::Decimal => b"float",
        }
    }

    fn of(entry: &Entry, description: &Description) -> Self {
        let labelled = !description.labels.is_empty();
        match entry.kind {
            Kind::Switch => DataType::Switch,
            Kind::Axes => DataType::Axes,
            Kind::Mask(_) => DataType::Bits,
            Kind::Whole(..) if labelled && description.unit == "mask" => DataType::Bits,
            Kind::Whole(..) if labelled => DataType::Choice,
            Kind::Whole(..) => DataType::Integer,
            Kind::Tenths(..) | Kind::Real | Kind::Speed | Kind::Place => DataType::Decimal,
        }
    }
}

/// Returns the line above the rows of `$ESG` or `$ESH`.
const fn header(format: Format) -> Option<&'static [u8]> {
    match format {
        Format::Fields => None,
        Format::Commas => Some(b"\"$-Code\",\" Setting\",\" Units\",\" Setting Description\""),
        Format::Tabs => Some(b"$-Code\tSetting\tUnits\tDatatype\tData format\tSetting Description\tMin\tMax"),
    }
}

/// Appends a row of `$ES`, `$ESG` or `$ESH`.
fn setting(out: &mut Text, row: &Row, format: Format) {
    match format {
        Format::Fields => return fields(out, row),
        Format::Commas => {
            put(out, b"\"");
            columns(out, row, b"\",\"");
            values(out, &row.entry, &row.description);
            put(out, b"\"");
        }
        Format::Tabs => {
            let data_type = DataType::of(&row.entry, &row.description);
            columns(out, row, b"\t");
            put(out, data_type.word());
            put(out, b"\t");
            put(out, data_format(row, data_type));
            put(out, b"\t");
            values(out, &row.entry, &row.description);
            put(out, b"\t");
            range(out, row, data_type, b"\t");
        }
    }
    put(out, END);
}

/// Appends number, name and unit, each followed by the separator.
fn columns(out: &mut Text, row: &Row, between: &[u8]) {
    whole(out, u64::from(row.number));
    put(out, between);
    name(out, row);
    put(out, between);
    put(out, row.description.unit.as_bytes());
    put(out, between);
}

/// Appends `[SETTING:number|group|name|unit|data type|format|minimum|maximum|needs a restart|may be empty]`.
fn fields(out: &mut Text, row: &Row) {
    let data_type = DataType::of(&row.entry, &row.description);
    put(out, b"[SETTING:");
    whole(out, u64::from(row.number));
    put(out, b"|");
    let axis = if row.description.group == SettingGroup::Axes {
        row.axis.map_or(0, |axis| axis.index() as u64 + 1)
    } else {
        0
    };
    whole(out, row.description.group as u64 + axis);
    put(out, b"|");
    name(out, row);
    put(out, b"|");
    put(out, row.description.unit.as_bytes());
    put(out, b"|");
    whole(out, data_type as u64);
    put(out, b"|");
    put(out, data_format(row, data_type));
    put(out, b"|");
    range(out, row, data_type, b"|");
    put(out, b"|0|0]");
    put(out, END);
}

/// Returns the data format: the choices, the bits of a mask, or the digits.
fn data_format(row: &Row, data_type: DataType) -> &'static [u8] {
    match (data_type, row.entry.kind) {
        (DataType::Switch, _) => b"",
        (DataType::Bits | DataType::Choice, _) => row.description.labels.as_bytes(),
        (DataType::Axes, _) => b"axes",
        (DataType::Integer, _) | (DataType::Decimal, Kind::Speed) => b"#####0",
        (DataType::Decimal, Kind::Tenths(..)) => b"##0.0",
        (DataType::Decimal, Kind::Place) => b"-#####0.000",
        (DataType::Decimal, _) => b"#####0.000",
    }
}

/// Appends the minimum, the separator `between` and the maximum of a setting. A missing limit stays empty.
fn range(out: &mut Text, row: &Row, data_type: DataType, between: &[u8]) {
    match row.entry.kind {
        Kind::Whole(least, greatest) | Kind::Tenths(least, greatest)
            if matches!(data_type, DataType::Integer | DataType::Decimal) =>
        {
            bound(out, row.entry.kind, least);
            put(out, between);
            bound(out, row.entry.kind, greatest);
        }
        Kind::Real | Kind::Speed => {
            put(out, b"0");
            put(out, between);
        }
        _ => put(out, between),
    }
}

/// Appends a bound of a setting. A bound in tenths is printed with one decimal, or with none if that decimal is 0.
#[inline(never)]
fn bound(out: &mut Text, kind: Kind, value: u32) {
    let parts = if matches!(kind, Kind::Tenths(..)) { 10 } else { 1 };
    whole(out, u64::from(value / parts));
    if !value.is_multiple_of(parts) {
        put(out, &[b'.', b'0' + (value % parts) as u8]);
    }
}

/// Appends the name of a setting. The axis of a per-axis setting precedes the name (`Y-axis resolution`). The number of
/// a homing cycle follows the name (`Axes homed in cycle 2`).
#[inline(never)]
pub fn name(out: &mut Text, row: &Row) {
    let axis = row.axis.filter(|_| row.description.group == SettingGroup::Axes);
    if let Some(axis) = axis {
        put(out, &[axis.letter()]);
        put(out, b"-axis ");
        let mut bytes = row.description.name.bytes();
        // No name of a per-axis setting starts with an abbreviation, so its first letter can be made lower-case.
        put(out, &[bytes.next().unwrap_or_default().to_ascii_lowercase()]);
        put(out, row.description.name.as_bytes().get(1..).unwrap_or(&[]));
        return;
    }
    put(out, row.description.name.as_bytes());
    if let Some(cycle) = row.axis {
        put(out, b" ");
        whole(out, cycle.index() as u64 + 1);
    }
}

/// Appends the possible values in words, such as `0 or 1`, `0 to 255` or `0 Cartesian, 1 CoreXY`.
#[inline(never)]
pub fn values(out: &mut Text, entry: &Entry, description: &Description) {
    match (entry.kind, DataType::of(entry, description)) {
        (Kind::Switch, _) => put(out, b"0 or 1"),
        (Kind::Mask(bits), _) => sum_of(out, description.labels, bits),
        (Kind::Axes, _) | (_, DataType::Bits) => sum_of(out, description.labels, u32::MAX),
        (_, DataType::Choice) => {
            for (value, label) in description.labels.split(',').enumerate() {
                put(out, if value > 0 { b", " } else { b"" });
                whole(out, value as u64);
                put(out, b" ");
                put(out, label.as_bytes());
            }
        }
        (Kind::Whole(least, greatest) | Kind::Tenths(least, greatest), _) => {
            bound(out, entry.kind, least);
            put(out, b" to ");
            bound(out, entry.kind, greatest);
            put(out, if matches!(entry.kind, Kind::Tenths(..)) { b" in tenths" } else { b"" });
        }
        (Kind::Real | Kind::Speed, _) => put(out, b"0 and above"),
        (Kind::Place, _) => put(out, b"any"),
    }
}

/// Appends `[MSG:Values of $32: 0 or 1; ...]`. Some settings have more values in grblHAL. For these settings, the text
/// also tells what stands in place of those values here.
pub fn values_of(out: &mut Text, row: &Row) {
    put(out, b"[MSG:Values of $");
    whole(out, row.number.into());
    put(out, b": ");
    values(out, &row.entry, &row.description);
    if row.entry.kind == Kind::Switch {
        put(out, beyond_a_switch(row.number));
    }
    put(out, b"]");
    put(out, END);
}

/// Returns the text about a setting that has more values in grblHAL and is only a switch here: what stands in place of
/// those values. Empty for any other setting.
const fn beyond_a_switch(number: u16) -> &'static [u8] {
    match number {
        ENABLE_INVERT => b", for all drivers",
        LIMIT_INVERT => b", for all limit inputs; single ones are turned round by $908",
        HARD_LIMITS => b"; grblHAL's bits 2 (strict mode): not supported; 4 (not for A): $133=0",
        HOMING => b"; grblHAL's bits 2, 4, 128: always on; 8: $932=1; 64: $X; 16, 32, 256, 512: not supported",
        LASER => b"; there is no lathe mode (2)",
        PARKING => b"; grblHAL's bits 2 (M56): always on; 4: not supported",
        _ => b"",
    }
}

const ENABLE_INVERT: u16 = Key::EnableInvert.number();
const LIMIT_INVERT: u16 = Key::LimitInvert.number();
const HARD_LIMITS: u16 = Key::HardLimits.number();
const HOMING: u16 = Key::Homing.number();
const LASER: u16 = Key::Laser.number();
const PARKING: u16 = Key::Parking.number();

fn sum_of(out: &mut Text, labels: &str, bits: u32) {
    put(out, b"sum of ");
    let mut first = true;
    for (bit, label) in labels.split(',').enumerate().filter(|(bit, _)| bits >> bit & 1 != 0) {
        put(out, if first { b"" } else { b", " });
        first = false;
        whole(out, 1 << bit);
        put(out, b" ");
        put(out, label.as_bytes());
    }
}

/// Returns the number of lines of a description, with `axes` axes in use. `grblhal`: `true` with `$900=3`; `$EA` then
/// lists one more alarm.
pub const fn lines(what: Described, axes: usize, grblhal: bool) -> usize {
    match what {
        Described::Settings(format) => settings::lines(axes) + header(format).is_some() as usize,
        Described::Groups => SettingGroup::ALL.len() + axes,
        Described::Errors => Error::ALL.len(),
        Described::ErrorTable => 1 + Error::ALL.len(),
        Described::Alarms => Alarm::ALL.len() + grblhal as usize,
        Described::AlarmTable => 2 + Alarm::ALL.len(),
    }
}

/// Limits of this board and dialect that narrow the range of a setting. The table of settings has the widest range of
/// all boards.
#[derive(Clone, Copy, Debug)]
pub struct Limits {
    /// Minimum length of a step pulse, in tenths of a microsecond.
    pub least_pulse_tenths: u16,
    /// Maximum baud rate of the UART.
    pub most_baud: u32,
    /// `true` if hosts are answered like grblHAL (`$900=3`). Some settings are then masks.
    pub grblhal: bool,
}

/// Returns the description of a setting with the range that the setting has on this board and in this dialect
/// (`limits`).
pub fn narrowed(mut row: Row, limits: Limits) -> Row {
    if limits.grblhal
        && let Some(mask) = GrblHalMask::of(row.number)
    {
        row.entry.kind = Kind::Mask(mask.bits());
        row.description.unit = "mask";
        row.description.labels = mask.labels;
    }
    match &mut row.entry.kind {
        Kind::Tenths(least, _) => *least = u32::from(limits.least_pulse_tenths),
        Kind::Whole(_, most) if row.number == Key::Baud.number() => *most = limits.most_baud,
        _ => {}
    }
    row
}

/// Appends `[SETTINGDESCR:number|text]`: the name of a setting and its values.
pub fn of_setting(out: &mut Text, row: &Row) {
    put(out, b"[SETTINGDESCR:");
    whole(out, row.number.into());
    put(out, b"|");
    name(out, row);
    put(out, b": ");
    values(out, &row.entry, &row.description);
    put(out, b"]");
    put(out, END);
}

/// Appends the line with index `line` of a description. `axes`: number of axes in use. `limits`: limits of this board
/// and dialect, which narrow the ranges of settings. An index beyond the last line of settings or errors appends
/// nothing.
pub fn line<const N: usize>(out: &mut Text, what: Described, line: usize, axes: usize, limits: Limits) {
    match what {
        Described::Settings(format) => match (header(format), line) {
            (Some(header), 0) => {
                put(out, header);
                put(out, END);
            }
            (header, line) => {
                if let Some(row) = Settings::<N>::described(line - usize::from(header.is_some()), axes) {
                    setting(out, &narrowed(row, limits), format);
                }
            }
        },
        Described::Groups => group(out, line),
        Described::Errors => error_line(out, Some(line), b"[ERRORCODE:#||%]\r\n"),
        Described::ErrorTable if line == 0 => put(out, ERRORS_HEAD),
        Described::ErrorTable => error_line(out, line.checked_sub(1), TABLE_ROW),
        Described::Alarms => alarm_line(out, Some(line), b"[ALARMCODE:#||%]\r\n"),
        Described::AlarmTable if line == 0 => put(out, ALARMS_HEAD),
        Described::AlarmTable => alarm_line(out, line.checked_sub(1), TABLE_ROW),
    }
}

// Lines above the rows of `$EEG` and `$EAG`, and the form of a row, in which `#` is replaced by the number and `%` by
// the text.
const ERRORS_HEAD: &[u8] = b"\"Error Code in v1.1+\",\"Error Message in v1.0-\",\"Error Description\"\r\n";
const ALARMS_HEAD: &[u8] = b"\"Alarm Code in v1.1+\",\" Alarm Message in v1.0-\",\" Alarm Description\"\r\n";
const TABLE_ROW: &[u8] = b"\"#\",\"N/A\",\"%\"\r\n";

/// Appends number and text of the error with index `line`, printed with `form` (see [`filled`]).
fn error_line(out: &mut Text, line: Option<usize>, form: &[u8]) {
    if let Some(error) = line.and_then(|line| Error::ALL.get(line)) {
        filled(out, form, &[error.text().as_bytes()], &[error.code().into()]);
    }
}

/// Appends number and text of the alarm with index `line`, printed with `form` (see [`filled`]). An index after the
/// last alarm stands for grblHAL's alarm 11, homing required. Only `$900=3` lists that alarm.
fn alarm_line(out: &mut Text, line: Option<usize>, form: &[u8]) {
    let (number, text) = line
        .and_then(|line| Alarm::ALL.get(line))
        .map_or((11, "the machine has to be homed ($H), or unlocked ($X)"), |alarm| (alarm.code(), alarm.text()));
    filled(out, form, &[text.as_bytes()], &[number.into()]);
}

/// Appends `[SETTINGGROUP:number|parent|name]`. The first lines are the groups of the table; after them each axis has a
/// group.
fn group(out: &mut Text, line: usize) {
    let group = SettingGroup::ALL.get(line);
    put(out, b"[SETTINGGROUP:");
    whole(out, line as u64 + 1);
    put(out, b"|");
    whole(out, if group.is_some() { 0 } else { SettingGroup::Axes as u64 });
    put(out, b"|");
    match (group, line.checked_sub(SettingGroup::ALL.len()).and_then(|axis| Axis::ALL.get(axis))) {
        (Some(group), _) => put(out, group.text().as_bytes()),
        (None, Some(axis)) => put(out, &[axis.letter(), b' ', b'a', b'x', b'i', b's']),
        (None, None) => {}
    }
    put(out, b"]");
    put(out, END);
}

#[cfg(test)]
mod tests {
    use super::*;

    const LIMITS: Limits = Limits { least_pulse_tenths: 10, most_baud: 1_000_000, grblhal: false };

    fn text(what: Described, wanted: usize) -> String {
        let mut out = Text::new();
        line::<3>(&mut out, what, wanted, 3, LIMITS);
        String::from_utf8(out.to_vec()).expect("text")
    }

    fn all(what: Described) -> Vec<String> {
        (0..lines(what, 3, false)).map(|wanted| text(what, wanted)).collect()
    }

    #[cfg(feature = "full")]
    /// Returns the line of a setting in one format.
    fn of(number: u16, format: Format) -> String {
        let found = (0..Settings::<3>::LINES)
            .find(|line| Settings::<3>::described(*line, 3).is_some_and(|row| row.number == number));
        text(Described::Settings(format), found.expect("a setting") + usize::from(format != Format::Fields))
    }

    #[cfg(feature = "full")]
    #[test]
    fn settings_are_described_in_the_formats_of_grblhal() {
        for (number, expected) in [
            (0, "[SETTING:0|2|Step pulse|us|6|##0.0|1|255|0|0]\r\n"),
            (4, "[SETTING:4|2|Enable invert||0||||0|0]\r\n"),
            (10, "[SETTING:10|1|Status report|mask|1|Machine position,Buffer state|||0|0]\r\n"),
            (11, "[SETTING:11|6|Junction deviation|mm|6|#####0.000|0||0|0]\r\n"),
            (30, "[SETTING:30|8|Maximum spindle speed|rpm|6|#####0|0||0|0]\r\n"),
            (45, "[SETTING:45|7|Axes homed in cycle 2|mask|4|axes|||0|0]\r\n"),
            (58, "[SETTING:58|9|Parking place|mm|6|-#####0.000|||0|0]\r\n"),
            (112, "[SETTING:112|15|Z-axis maximum rate|mm/min|6|#####0.000|0||0|0]\r\n"),
            (900, "[SETTING:900|1|Dialect||3|Grbl,Oxmill,Seed document,grblHAL|||0|0]\r\n"),
        ] {
            assert_eq!(of(number, Format::Fields), expected);
        }
        assert_eq!(of(101, Format::Commas), "\"101\",\"Y-axis resolution\",\"steps/mm\",\"0 and above\"\r\n");
        assert_eq!(
            of(904, Format::Tabs),
            "904\tKinematics\t\tradiobuttons\tCartesian,CoreXY\t0 Cartesian, 1 CoreXY\t\t\r\n"
        );
        // A board with another minimum pulse shows its own range.
        let mut out = Text::new();
        let limits = Limits { least_pulse_tenths: 5, ..LIMITS };
        line::<3>(&mut out, Described::Settings(Format::Tabs), 1, 3, limits);
        assert_eq!(out, b"0\tStep pulse\tus\tfloat\t##0.0\t0.5 to 255 in tenths\t0.5\t255\r\n");
        assert_eq!(of(29, Format::Tabs), "29\tDirection set-up\tus\tinteger\t#####0\t0 to 255\t0\t255\r\n");
    }

    #[test]
    fn groups_errors_and_alarms_have_a_line_each() {
        let groups = all(Described::Groups);
        assert_eq!(groups[0], "[SETTINGGROUP:1|0|General]\r\n");
        assert_eq!(
            groups[11..],
            ["12|0|Axes", "13|12|X axis", "14|12|Y axis", "15|12|Z axis"]
                .map(|rest| format!("[SETTINGGROUP:{rest}]\r\n"))
        );
        assert_eq!(all(Described::Errors)[0], "[ERRORCODE:1||a word must begin with a letter]\r\n");
        assert!(
            all(Described::Alarms)
                .contains(&"[ALARMCODE:2||the target exceeds the machine's travel; the position is kept]\r\n".into())
        );
    }

    /// Checks the properties that programs need to parse these lines. Each line must be complete and contain separators
    /// only between its fields, the group of each setting must exist, and each label must belong to a bit or a choice.
    #[test]
    fn every_line_can_be_read_back() {
        for what in [Described::Groups, Described::Errors, Described::Alarms] {
            for line in all(what) {
                assert!(line.ends_with("]\r\n") && line.matches('|').count() == 2, "{line}");
            }
        }
        for (wanted, line) in all(Described::Settings(Format::Fields)).iter().enumerate() {
            let row = Settings::<3>::described(wanted, 3).expect("a row");
            let fields: Vec<&str> = line
                .strip_prefix("[SETTING:")
                .and_then(|l| l.strip_suffix("]\r\n"))
                .expect("a line")
                .split('|')
                .collect();
            assert_eq!((fields.len(), fields[0].parse()), (10, Ok(row.number)), "{line}");
            assert!((1..=15).contains(&fields[1].parse::<u8>().expect("a group")), "{line}");
            let labels = row.description.labels.split(',').count();
            match row.entry.kind {
                Kind::Mask(bits) => assert_eq!(1 << (labels - 1), (bits >> (labels - 1)) << (labels - 1), "{line}"),
                Kind::Whole(0, most) if DataType::of(&row.entry, &row.description) == DataType::Choice => {
                    assert_eq!(labels, most as usize + 1, "{line}");
                }
                _ => {}
            }
        }
        for line in all(Described::Settings(Format::Commas)) {
            assert_eq!(line.matches('"').count(), 8, "{line}");
        }
        for line in all(Described::Settings(Format::Tabs)) {
            assert_eq!(line.matches('\t').count(), 7, "{line}");
        }
    }
}
