//! The text of every reply that a host can get, except the status report: Grbl 1.1h's replies byte for byte, and
//! Oxmill's additions.
//!
//! Pure functions from data to text. Each public function for a reply makes whole lines ended by CR LF. The only
//! exception is `startup_echo`, whose line is ended by the answer that follows.

use super::text::{END, Text, filled, length, put, real, whole};
use crate::axes::{Axis, AxisMask, LINEAR, PerAxis};
use crate::image::FULL_IMAGE;
use crate::messages::{
    Coolant, CrashKind, InputWiring, PinView, ResetCause, Restart, Signals, SpindleDirection, input,
};
use crate::settings::{Entry, Kind};
use crate::units::{Coordinate, Decimal};

/// Version of the Grbl protocol that is implemented.
pub const GRBL_VERSION: &str = "1.1h";

/// A version and the day on which it was released.
pub struct Release {
    /// As in `Cargo.toml`.
    pub version: &'static str,
    /// Year, month and day in eight digits.
    pub date: &'static str,
}

/// Version and release date of this firmware. When you change the version, change the date, too.
pub const RELEASE: Release = Release { version: "0.2.0", date: "20261123" };

/// The answer to an accepted line.
pub const OK: &[u8] = b"ok\r\n";

/// Appends `error:N`, the answer to a refused line. `code`: the number N.
pub fn error(out: &mut Text, code: u8) {
    put(out, b"error:");
    whole(out, u64::from(code));
    put(out, END);
}

/// Appends `known`, the answer to a line with checksum (`$LC=ON`) that is empty, or that was received before and is not
/// executed again.
pub fn known(out: &mut Text) {
    put(out, b"known\r\n");
}

/// Returns whether a text is only for the host whose line caused it: an answer, or a row of a listing (`$0=10`,
/// `[G54:0.000,..]`).
pub fn is_of_one_host(text: &[u8]) -> bool {
    is_answer(text) || text.starts_with(b"$") || text.starts_with(b"[") && !text.starts_with(b"[MSG:")
}

/// Returns whether a text is the answer to a line. An answer with line number and checksum (`$LC=ON`) begins with a
/// colon.
pub fn is_answer(text: &[u8]) -> bool {
    matches!(text, b"ok\r\n" | b"known\r\n") || text.starts_with(b"error:") || text.starts_with(b":")
}

/// Appends `ALARM:N`. `code`: the number N.
pub fn alarm(out: &mut Text, code: u8) {
    put(out, b"ALARM:");
    whole(out, u64::from(code));
    put(out, END);
}

/// Appends Grbl's welcome line.
pub fn welcome(out: &mut Text) {
    put(out, b"\r\nGrbl ");
    put(out, GRBL_VERSION.as_bytes());
    put(out, b" ['$' for help]\r\n");
}

/// Appends `[MSG:text]`. `text` must be printable; for text from a program see [`program_message`].
pub fn message(out: &mut Text, text: &str) {
    put(out, b"[MSG:");
    put(out, text.as_bytes());
    put(out, b"]\r\n");
}

/// Appends `[MSG:text]` with a number directly after the text, such as `[MSG:Tool change T3]`.
pub fn message_number(out: &mut Text, text: &str, number: u32) {
    put(out, b"[MSG:");
    put(out, text.as_bytes());
    whole(out, u64::from(number));
    put(out, b"]\r\n");
}

/// Appends the message that M66 waits for input `number`, for at most `seconds` more seconds.
pub fn wait_for_input(out: &mut Text, number: u32, seconds: u32) {
    put(out, b"[MSG:Waits for input ");
    whole(out, u64::from(number));
    put(out, b", seconds left: ");
    whole(out, u64::from(seconds));
    put(out, b"]\r\n");
}

/// Appends `[MSG:...]` with text that comes from a program, such as a message in a comment. Only printable ASCII
/// characters are kept, and square brackets are left out.
pub fn program_message(out: &mut Text, text: &[u8]) {
    put(out, b"[MSG:");
    for byte in text.iter().filter(|byte| matches!(byte, b' '..=b'~') && !matches!(byte, b'[' | b']')) {
        put(out, &[*byte]);
    }
    put(out, b"]\r\n");
}

/// Appends the message for an input that has stopped motion, such as `[MSG:Limit switch X at machine
/// 1.000,2.000,0.000, line 20]`. `line`: N word of the move; with 0 (none) that part is omitted.
pub fn trip<const N: usize>(
    out: &mut Text,
    tripped: &Signals,
    place: &PerAxis<Coordinate, N>,
    line: u32,
    form: PlaceForm,
) {
    put(out, b"[MSG:");
    if tripped.emergency_stop {
        put(out, b"Emergency stop");
    } else if tripped.driver_fault {
        put(out, b"Driver fault");
    } else {
        put(out, b"Limit switch ");
        for axis in Axis::ALL.into_iter().filter(|axis| tripped.limits & AxisMask::NONE.with(*axis).0 != 0) {
            put(out, &[axis.letter()]);
        }
    }
    put(out, b" at machine ");
    position(out, place, form);
    if line > 0 {
        put(out, b", line ");
        whole(out, u64::from(line));
    }
    put(out, b"]\r\n");
}

const fn cause_name(cause: ResetCause) -> &'static str {
    match cause {
        ResetCause::Power => "power",
        ResetCause::Pin => "reset pin",
        ResetCause::Software => "software",
        ResetCause::BrownOut => "brown-out",
        ResetCause::Watchdog => "watchdog",
        ResetCause::Other => "unknown",
    }
}

const fn crash_name(kind: CrashKind) -> &'static str {
    match kind {
        CrashKind::Panic => "panic",
        CrashKind::Fault => "fault",
        CrashKind::StackOverflow => "stack overflow",
        CrashKind::Stuck => "stuck task",
        CrashKind::Voltage => "low voltage",
        CrashKind::Clock => "clock failure",
        CrashKind::Board => "board",
    }
}

/// Appends the message that a failure stopped the machine. `grbl`: omits `$REC`, which Grbl's dialect does not have.
pub fn failure(out: &mut Text, restart: &Restart, grbl: bool) {
    if let Some(crash) = restart.crash.as_ref().filter(|crash| crash.kind == CrashKind::Board) {
        put(out, b"[MSG:Board: ");
        put(out, &crash.text);
        put(out, b"]\r\n");
        return;
    }
    put(out, b"[MSG:Restarted after a failure (");
    let name = restart.crash.as_ref().map_or(cause_name(restart.cause), |crash| crash_name(crash.kind));
    put(out, name.as_bytes());
    put(out, b")");
    if let Some(crash) = &restart.crash {
        put(out, b" at machine ");
        last_place(out, &crash.place);
        if crash.line > 0 {
            put(out, b", line ");
            whole(out, u64::from(crash.line));
        }
    }
    let both = restart.is_recorded && !grbl;
    put(out, if both { b", $RC tells more, $REC what came in]\r\n" } else { b", $RC tells more]\r\n" });
}

/// Appends `[RESET:cause]`, then `[CRASH:kind:text]` and `[LAST:position]` if the firmware crashed.
pub fn restart(out: &mut Text, restart: &Restart) {
    put(out, b"[RESET:");
    put(out, cause_name(restart.cause).as_bytes());
    put(out, b"]\r\n");
    if let Some(crash) = &restart.crash {
        put(out, b"[CRASH:");
        put(out, crash_name(crash.kind).as_bytes());
        put(out, b":");
        put(out, &crash.text);
        put(out, b"]\r\n[LAST:");
        last_place(out, &crash.place);
        put(out, b"|Ln:");
        whole(out, u64::from(crash.line));
        put(out, b"]\r\n");
    }
}

/// Appends a position, given in micrometres, in mm. The position is never in inches, because the host's unit is not
/// known yet.
fn last_place(out: &mut Text, place: &[i32; 3]) {
    for (i, micrometres) in place.iter().enumerate() {
        if i > 0 {
            put(out, b",");
        }
        length(out, Coordinate(i64::from(*micrometres) * 10_000), false);
    }
}

const fn input_name(bit: usize) -> &'static str {
    match bit as u32 {
        0 => "limit X",
        1 => "limit Y",
        2 => "limit Z",
        3 => "limit A",
        4 => "limit B",
        5 => "limit C",
        6 => "second limit",
        input::PROGRAM => "input 0",
        input::PROBE => "probe",
        input::DOOR => "door",
        input::HOLD => "hold",
        input::START => "start",
        input::RESET => "reset",
        input::EMERGENCY_STOP => "emergency stop",
        input::DRIVER_FAULT => "driver fault",
        input::AT_SPEED => "at speed",
        input::SECOND_PROGRAM => "input 1",
        _ => "unused",
    }
}

/// Appends one input of `$PINS`, such as `[PIN:hold,high,inactive,active low,pull-up,noise 0]`. The fields are: name,
/// present level of the pin, state of the filtered input, level that makes the input active, pull resistor, and number
/// of changes that the filter has rejected. `grblhal`: `true` puts the number of the input first (`[PIN:IN10,hold,..`).
/// In this place grblHAL has the pin of the chip.
pub fn pin(out: &mut Text, bit: usize, view: &PinView, active: bool, wiring: &InputWiring, grblhal: bool) {
    let has = |word: u32| word >> bit & 1 != 0;
    put(out, b"[PIN:");
    if FULL_IMAGE && grblhal {
        filled(out, b"IN#,", &[], &[bit as u32]);
    }
    put(out, input_name(bit).as_bytes());
    put(out, if has(view.low) { b",low" } else { b",high" });
    put(out, if active { b",active" } else { b",inactive" });
    put(out, if has(wiring.inverted) { b",active high" } else { b",active low" });
    put(
        out,
        match (has(wiring.pull_down), has(wiring.no_pull_up)) {
            (true, _) => b",pull-down".as_slice(),
            (false, true) => b",no pull",
            (false, false) => b",pull-up",
        },
    );
    put(out, b",noise ");
    whole(out, u64::from(view.noise.get(bit).copied().unwrap_or(0)));
    put(out, b"]\r\n");
}

/// Appends the answer to `$`. `grbl`: lists only the commands of Grbl's dialect.
pub fn help(out: &mut Text, grbl: bool) {
    put(out, b"[HLP:$$ $# $G $I $N $x=val $Nx=line $J=line $SLP $C $X $H ");
    if !grbl {
        put(out, if FULL_IMAGE { b"$HX $Mx=line $RST= $RC $REC " } else { b"$HX $Mx=line $RST= $RC " });
        put(out, b"$PINS ");
        if FULL_IMAGE {
            put(out, b"$E $ES $ESG $ESH $EG $EE $EA ");
        }
        put(out, b"$I+ $REBOOT $DFU ");
    }
    put(out, b"~ ! ? ctrl-x");
    if !grbl {
        put(out, b" 0x19");
    }
    put(out, b"]\r\n");
}

/// Appends one row of `$$`, such as `$100=250.000`. The kind of the setting determines the number of decimals.
pub fn setting(out: &mut Text, entry: &Entry, number: u16, value: f32) {
    put(out, b"$");
    whole(out, u64::from(number));
    put(out, b"=");
    if value < 0.0 {
        put(out, b"-");
    }
    let places = match entry.kind {
        Kind::Real | Kind::Place => 3,
        Kind::Tenths(..) if value != value as u32 as f32 => 1,
        _ => 0,
    };
    real(out, value.abs(), places);
    put(out, END);
}

/// Appends a stored line: `$N0=line` (startup line, `kind` is `N`) or `$M0=line` (macro, `kind` is `M`).
pub fn kept_line(out: &mut Text, kind: u8, index: usize, line: &[u8]) {
    put(out, &[b'$', kind]);
    whole(out, index as u64);
    put(out, b"=");
    put(out, line);
    put(out, END);
}

/// Appends `>line:`, which precedes the answer to a startup line that has been run.
pub fn startup_echo(out: &mut Text, line: &[u8]) {
    put(out, b">");
    put(out, line);
    put(out, b":");
}

/// Appends `[VER:...]` and `[OPT:...]`, the answer to `$I`. Senders read Grbl's version and a date in `VER`. `user`:
/// the text stored by `$I=`; `letters`: the options; `blocks`: capacity of the look-ahead; `rx_bytes`: size of the
/// receive buffer.
pub fn build_info(out: &mut Text, user: &[u8], letters: &[u8], blocks: usize, rx_bytes: usize) {
    put(out, b"[VER:");
    put(out, GRBL_VERSION.as_bytes());
    put(out, b".");
    put(out, RELEASE.date.as_bytes());
    put(out, b":");
    put(out, user);
    put(out, b"]\r\n[OPT:");
    put(out, letters);
    put(out, b",");
    whole(out, blocks as u64);
    put(out, b",");
    whole(out, rx_bytes as u64);
    put(out, b"]\r\n");
}

/// Appends `[FIRMWARE:...]`: name and version. Senders made for Grbl ignore this line, as they ignore grblHAL's.
pub fn firmware(out: &mut Text) {
    put(out, b"[FIRMWARE:Oxmill ");
    put(out, RELEASE.version.as_bytes());
    put(out, b"]\r\n");
}

/// Appends `[AXS:...]` and `[NEWOPT:...]` of `$I+`, in the format of grblHAL: the axes, and the options that a sender
/// may use.
pub fn more_options(out: &mut Text, axes: usize, options: &[&str]) {
    put(out, b"[AXS:");
    whole(out, axes as u64);
    put(out, b":");
    for axis in Axis::ALL.iter().take(axes) {
        put(out, &[axis.letter()]);
    }
    put(out, b"]\r\n[NEWOPT:");
    for (i, option) in options.iter().enumerate() {
        put(out, if i > 0 { b"," } else { b"" });
        put(out, option.as_bytes());
    }
    put(out, b"]\r\n");
}

/// Appends the lines `[BOARD:...]` and `[CRYSTAL:...]` of `$I+`. grblHAL has `BOARD` as well. `CRYSTAL` gives the
/// frequency of the oscillator as measured at the start; a board without one has no such line (`oscillator_mhz` is 0).
pub fn board(out: &mut Text, name: &str, oscillator_mhz: u8) {
    put(out, b"[BOARD:");
    put(out, name.as_bytes());
    if oscillator_mhz > 0 {
        put(out, b"]\r\n[CRYSTAL:");
        whole(out, oscillator_mhz.into());
        put(out, b" MHz");
    }
    put(out, b"]\r\n");
}

/// Format of printed positions: number of axes, and unit of lengths. Angles stay in degrees.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PlaceForm {
    /// Number of axes: X, Y, Z and so on.
    pub axes: usize,
    /// Lengths are in inches.
    pub inches: bool,
}

pub(super) fn position<const N: usize>(out: &mut Text, place: &PerAxis<Coordinate, N>, form: PlaceForm) {
    for (axis, value) in place.iter().take(form.axes).enumerate() {
        if axis > 0 {
            put(out, b",");
        }
        length(out, *value, form.inches && axis < LINEAR);
    }
}

/// Appends `[G54:x,y,z]`, a row of `$#`: a coordinate system, G28, G30 or G92.
pub fn parameter<const N: usize>(out: &mut Text, name: &str, place: &PerAxis<Coordinate, N>, form: PlaceForm) {
    put(out, b"[");
    put(out, name.as_bytes());
    put(out, b":");
    position(out, place, form);
    put(out, b"]\r\n");
}

/// Appends `[ROT:G54,30.000]`: the rotation of a coordinate system in degrees.
pub fn rotation(out: &mut Text, name: &str, degrees: Decimal) {
    put(out, b"[ROT:");
    put(out, name.as_bytes());
    put(out, b",");
    // Degrees are printed with 3 decimals, like millimetres.
    length(out, Coordinate::from_mm(degrees), false);
    put(out, b"]\r\n");
}

/// Appends `[TLO:z]`, or `[TLO:x,y,z]` if there is an offset along other axes.
pub fn tool_length<const N: usize>(out: &mut Text, offset: &PerAxis<Coordinate, N>, form: PlaceForm) {
    put(out, b"[TLO:");
    let along_z = offset.get(Axis::Z).unwrap_or(Coordinate::ZERO);
    let mut only_z = PerAxis::all(Coordinate::ZERO);
    only_z.set(Axis::Z, along_z);
    if *offset == only_z {
        length(out, along_z, form.inches);
    } else {
        position(out, offset, form);
    }
    put(out, b"]\r\n");
}

/// Appends `[T:number|x,y,z|radius]`, a row of the tool table. The table has no radius, so it is 0.
pub fn tool<const N: usize>(out: &mut Text, number: u32, offset: &PerAxis<Coordinate, N>, form: PlaceForm) {
    put(out, b"[T:");
    whole(out, u64::from(number));
    put(out, b"|");
    position(out, offset, form);
    put(out, b"|");
    length(out, Coordinate::ZERO, form.inches);
    put(out, b"]\r\n");
}

/// Appends `[PRB:x,y,z:ok]`, sent after a probing move and by `$#`; `ok` is 1 if the probe made contact, otherwise 0.
pub fn probe<const N: usize>(out: &mut Text, place: &PerAxis<Coordinate, N>, success: bool, form: PlaceForm) {
    put(out, b"[PRB:");
    position(out, place, form);
    put(out, if success { b":1]\r\n" } else { b":0]\r\n" });
}

/// The modal state, as `$G` shows it.
#[derive(Clone, Copy, Debug)]
pub struct ParserState {
    /// The words for motion, coordinate system, G92, plane, units, distance mode, feed mode and tool length; empty
    /// words are omitted.
    pub words: [&'static str; 8],
    /// Scaling is active (G51).
    pub scaling: bool,
    /// Rotation is active (G68).
    pub rotation: bool,
    /// A modal call is active (G66): each line with a move is followed by a call of a subprogram.
    pub calls: bool,
    /// Path blending is active (G64 P).
    pub blends: bool,
    /// Direction of the spindle (M3, M4, M5).
    pub spindle: SpindleDirection,
    /// Coolant (M7, M8, M9).
    pub coolant: Coolant,
    /// Parking is enabled (M56).
    pub parking: bool,
    /// Number of the tool (T).
    pub tool: u32,
    /// F in mm/min (or as it was written in inverse-time mode).
    pub feed: f32,
    /// F is in mm per revolution (G95).
    pub per_revolution: bool,
    /// S in rpm.
    pub speed: f32,
}

/// Appends `[GC:...]`, the answer to `$G`.
pub fn parser_state(out: &mut Text, state: &ParserState, inches: bool) {
    put(out, b"[GC:");
    for (i, word) in state.words.iter().filter(|word| !word.is_empty()).enumerate() {
        if i > 0 {
            put(out, b" ");
        }
        put(out, word.as_bytes());
    }
    if state.scaling {
        put(out, b" G51");
    }
    if state.rotation {
        put(out, b" G68");
    }
    if state.calls {
        put(out, b" G66");
    }
    if state.blends {
        put(out, b" G64");
    }
    put(
        out,
        match state.spindle {
            SpindleDirection::Off => b" M5",
            SpindleDirection::Clockwise => b" M3",
            SpindleDirection::CounterClockwise => b" M4",
        },
    );
    if state.coolant.mist {
        put(out, b" M7");
    }
    if state.coolant.flood {
        put(out, b" M8");
    }
    if !state.coolant.mist && !state.coolant.flood {
        put(out, b" M9");
    }
    if state.parking {
        put(out, b" M56");
    }
    put(out, b" T");
    whole(out, u64::from(state.tool));
    put(out, b" F");
    if FULL_IMAGE && state.per_revolution {
        real(out, if inches { state.feed / 25.4 } else { state.feed }, 4);
    } else {
        rate(out, state.feed, inches);
    }
    put(out, b" S");
    real(out, state.speed, 0);
    put(out, b"]\r\n");
}

/// Appends a speed: in mm/min without decimals, or in inches per minute with one decimal.
pub(super) fn rate(out: &mut Text, mm_per_minute: f32, inches: bool) {
    if inches { real(out, mm_per_minute / 25.4, 1) } else { real(out, mm_per_minute, 0) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_release_is_this_version_and_a_day() {
        assert_eq!(RELEASE.version, env!("CARGO_PKG_VERSION"), "a new version: set its date, too");
        let digits = |from: usize, to: usize| RELEASE.date.get(from..to).and_then(|text| text.parse::<u32>().ok());
        assert_eq!(RELEASE.date.len(), 8);
        assert!(digits(0, 4).is_some_and(|year| (2025..2100).contains(&year)), "{}", RELEASE.date);
        assert!(digits(4, 6).is_some_and(|month| (1..=12).contains(&month)), "{}", RELEASE.date);
        assert!(digits(6, 8).is_some_and(|day| (1..=31).contains(&day)), "{}", RELEASE.date);
    }
}
