//! The `$` commands and the texts that grblHAL has and Grbl lacks. They exist only with `$900=3`. gSender and ioSender
//! show more data of a machine that answers like grblHAL.

use super::reply_texts::RELEASE;
use super::system::Described;
use super::text::{Text, filled, length, put, real};
use crate::messages::{LINES_DEPTH, PinView, SECOND_SWITCH, Signals, input};
use crate::number::{self, Digits};
use crate::units::Coordinate;

const AXIS_LETTERS: &[u8] = b"XYZABC";

/// A `$` command that exists only with `$900=3`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Command {
    /// `$SED=n`: describes one setting.
    Describe(u16),
    /// `$SPINDLES`: describes the spindle in words. `$SPINDLESH`: describes it in fields, for senders that parse the
    /// answer.
    Spindles {
        /// `true` for `$SPINDLESH`, `false` for `$SPINDLES`.
        in_fields: bool,
    },
    /// `$TLR`: makes the position of the latest probe contact the reference of the tool setter.
    ToolReference,
    /// `$S`: switches single block on or off.
    SingleBlock,
    /// `$B`: switches block delete on or off.
    BlockDelete,
    /// `$O`: switches the pause at M1 on or off.
    OptionalStop,
    /// `$+`: lists all settings.
    Settings,
    /// `$HELP`: lists the commands.
    Help,
    /// `$EAG`, `$EEG`: the alarms or the errors as comma-separated values.
    Table(Described),
    /// `$LEV`: the inputs that became active most recently.
    LastEvent,
    /// `$LIM`: the limit switches that are active now.
    Limits,
    /// `$PINSTATE`: the inputs and outputs of programs.
    ProgramPins,
    /// `$PORTS`: the serial port.
    Ports,
}

/// The commands without a value.
const COMMANDS: [(&[u8], Command); 14] = [
    (b"$SPINDLES", Command::Spindles { in_fields: false }),
    (b"$SPINDLESH", Command::Spindles { in_fields: true }),
    (b"$TLR", Command::ToolReference),
    (b"$S", Command::SingleBlock),
    (b"$B", Command::BlockDelete),
    (b"$O", Command::OptionalStop),
    (b"$+", Command::Settings),
    (b"$HELP", Command::Help),
    (b"$EAG", Command::Table(Described::AlarmTable)),
    (b"$EEG", Command::Table(Described::ErrorTable)),
    (b"$LEV", Command::LastEvent),
    (b"$LIM", Command::Limits),
    (b"$PINSTATE", Command::ProgramPins),
    (b"$PORTS", Command::Ports),
];

/// Reads a `$` line, which has been filtered (capitals, no blanks). Returns `None` for any other line, which can
/// still be a command of Grbl or Oxmill.
#[inline(never)]
pub fn read(line: &[u8]) -> Option<Command> {
    let Some(text) = line.strip_prefix(b"$SED=") else {
        return COMMANDS.iter().find(|(name, _)| *name == line).map(|(_, command)| *command);
    };
    let number = number::read(text, Digits::Exact).filter(|number| number.used == text.len())?.value;
    Some(Command::Describe(u16::try_from(number.truncate()).ok()?))
}

/// Appends the welcome line of grblHAL.
pub fn welcome(out: &mut Text) {
    put(out, b"\r\nGrblHAL 1.1f ['$' or '$HELP' for help]\r\n");
}

/// Appends the line with grblHAL's commands, which the answer to `$` contains only with `$900=3`.
pub fn help(out: &mut Text) {
    put(
        out,
        b"[HLP:$HELP $+ $SED=n $SPINDLES $SPINDLESH $TLR $S $B $O $EAG $EEG $LEV $LIM $PINSTATE $PORTS 0x80-83 0x87 \
          0x88 0xA3]\r\n",
    );
}

/// Contents of the answers to `$I` and `$I+`.
pub struct Identity<'a> {
    /// Text that the user has stored by `$I=`.
    pub user: &'a [u8],
    /// Letters of the enabled options, for `OPT`.
    pub letters: &'a [u8],
    /// Capacity of the look-ahead, in blocks.
    pub blocks: usize,
    /// Number of axes in use.
    pub axes: usize,
    /// Capacity of the tool table, in tools.
    pub tools: usize,
    /// Homing is enabled, so `NEWOPT` contains `HOME`.
    pub homing: bool,
    /// M6 stops the program for another tool, so `NEWOPT` contains `TC`.
    pub changes_tools: bool,
    /// The input pins of the board.
    pub pins: &'a PinView,
    /// Name of the board, for the line `[BOARD:...]`.
    pub board: &'static str,
    /// Settings survive power-off, so a line `[NVS STORAGE:FLASH]` is sent.
    pub has_store: bool,
    /// Maximum step rate in Hz, for the line `[MAX STEP RATE:...]`.
    pub step_rate: u32,
    /// Number of outputs and number of inputs for programs (M62 to M66).
    pub program_pins: [u8; 2],
}

/// Appends the first lines of `$I`: `VER`, `OPT`, `AXS` and `NEWOPT`. `RT+` means that the realtime commands also have
/// their old bytes, such as `?`.
pub fn options(out: &mut Text, this: &Identity) {
    let date = RELEASE.date.as_bytes();
    let axes = AXIS_LETTERS.get(..this.axes).unwrap_or_default();
    let stops = when(this.pins.fitted >> input::EMERGENCY_STOP & 1 != 0, b",ES");
    let (homes, changes) = (when(this.homing, b",HOME"), when(this.changes_tools, b",TC"));
    filled(
        out,
        b"[VER:1.1f.%:%]\r\n[OPT:%,#,#,#,#]\r\n[AXS:#:%]\r\n[NEWOPT:ENUMS,RT+%%,EXPR%,SED]\r\n",
        &[date, this.user, this.letters, axes, homes, stops, changes],
        &[this.blocks, LINES_DEPTH, this.axes, this.tools, this.axes].map(|number| number as u32),
    );
}

/// Appends the other lines of `$I`, from `FIRMWARE` on.
pub fn equipment(out: &mut Text, this: &Identity) {
    let has = |bit: u32, letter| when(this.pins.fitted >> bit & 1 != 0, letter);
    filled(
        out,
        b"[FIRMWARE:grblHAL]\r\n[SIGNALS:%%%%%%]\r\n%[DRIVER:Oxmill]\r\n[DRIVER VERSION:%]\r\n[BOARD:%]\r\n\
          [MAX STEP RATE:# Hz]\r\n",
        &[
            has(input::RESET, b"R"),
            has(input::HOLD, b"H"),
            has(input::START, b"S"),
            has(input::DOOR, b"D"),
            has(input::EMERGENCY_STOP, b"E"),
            has(input::DRIVER_FAULT, b"F"),
            when(this.has_store, b"[NVS STORAGE:FLASH]\r\n"),
            RELEASE.version.as_bytes(),
            this.board.as_bytes(),
        ],
        &[this.step_rate],
    );
    let [outputs, inputs] = this.program_pins.map(u32::from);
    if outputs + inputs > 0 {
        filled(out, b"[AUX IO:#,#,0,0]\r\n", &[], &[inputs, outputs]);
    }
}

fn when(has: bool, text: &[u8]) -> &[u8] {
    if has { text } else { b"" }
}

/// Appends `[TLR:z]`: the reference of the tool setter, in `$#`.
pub fn tool_reference(out: &mut Text, height: Coordinate, inches: bool) {
    put(out, b"[TLR:");
    length(out, height, inches);
    put(out, b"]\r\n");
}

/// Appends the line for the only spindle: the answer to `$SPINDLES` or, with `in_fields`, to `$SPINDLESH`. Letters of
/// the spindle: D: it turns both ways; L: it can be a laser; V: its speed is variable; S: it reports that it is up to
/// speed. `speeds`: minimum and maximum in rpm.
pub fn spindle(out: &mut Text, in_fields: bool, reports_speed: bool, speeds: [f32; 2]) {
    let reports = when(reports_speed, b"S");
    if !in_fields {
        return filled(out, b"0 - PWM, enabled as spindle 0, %DLV, active\r\n", &[reports], &[]);
    }
    put(out, b"[SPINDLE:0|0|0|*");
    put(out, reports);
    put(out, b"DLV|PWM");
    for (speed, before) in speeds.iter().zip([b"|", b","]) {
        put(out, before);
        real(out, *speed, 1);
    }
    put(out, b"]\r\n");
}

/// Appends `[LASTEVENTS:controls,switches,,second,]`: the answer to `$LEV`. An axis has one input for both of its
/// limit switches; this input is listed in the field for switches at the lower end. `ganged`: letter of the axis with
/// a second motor.
pub fn last_event(out: &mut Text, event: &Signals, ganged: &[u8]) {
    put(out, b"[LASTEVENTS:");
    for (active, letter) in [
        (event.reset, b"R"),
        (event.hold, b"H"),
        (event.start, b"S"),
        (event.door, b"D"),
        (event.emergency_stop, b"E"),
        (event.driver_fault, b"F"),
    ] {
        put(out, when(active, letter));
    }
    put(out, b",");
    switches(out, event, ganged);
}

/// Appends `[LIMITS:switches,,second,]`: the answer to `$LIM`. For the fields see [`last_event`].
pub fn limits(out: &mut Text, signals: &Signals, ganged: &[u8]) {
    put(out, b"[LIMITS:");
    switches(out, signals, ganged);
}

fn switches(out: &mut Text, signals: &Signals, ganged: &[u8]) {
    for (axis, letter) in AXIS_LETTERS.chunks(1).enumerate() {
        put(out, when(signals.limits >> axis & 1 != 0, letter));
    }
    put(out, b",,");
    put(out, when(signals.limits & SECOND_SWITCH != 0, ganged));
    put(out, b",]\r\n");
}

/// Appends `[PINSTATE:DIN|Pn|n|mode|capabilities|value]`: an input of programs, in the answer to `$PINSTATE`. The
/// letters in `mode` and in `capabilities` stand for polarity, resistor, edge and filter. No setting changes these
/// inputs: they are active while their pin is low (I), have pull-ups (U), and are filtered (D).
pub fn program_input(out: &mut Text, number: u32, active: bool) {
    filled(out, b"[PINSTATE:DIN|P#|#|IU-D|-U-D|#]\r\n", &[], &[number, number, u32::from(active)]);
}

/// Appends `[PINSTATE:DOUT|Pn|n|mode|capabilities|value]`: an output of programs. No setting inverts it.
pub fn program_output(out: &mut Text, number: u32, on: bool) {
    filled(out, b"[PINSTATE:DOUT|P#|#|N|-|#]\r\n", &[], &[number, number, u32::from(on)]);
}

/// Appends `[PORT:0|UART|||rate,8,N,1|C]`: the answer to `$PORTS`. C means that the port is in use. The fields for the
/// pins RX and TX are empty.
pub fn port(out: &mut Text, baud: u32) {
    filled(out, b"[PORT:0|UART|||#,8,N,1|C]\r\n", &[], &[baud]);
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pins_of_programs_are_listed() {
        assert_eq!(text(|out| program_input(out, 1, true)), "[PINSTATE:DIN|P1|1|IU-D|-U-D|1]\r\n");
        assert_eq!(text(|out| program_output(out, 3, true)), "[PINSTATE:DOUT|P3|3|N|-|1]\r\n");
        assert_eq!(text(|out| port(out, 1_000_000)), "[PORT:0|UART|||1000000,8,N,1|C]\r\n");
    }

    #[test]
    fn inputs_have_their_letters() {
        let all = Signals { limits: 0b100_1111, driver_fault: true, ..Signals::of_word(u32::MAX) };
        assert_eq!(text(|out| last_event(out, &all, b"Y")), "[LASTEVENTS:RHSDEF,XYZA,,Y,]\r\n");
        assert_eq!(text(|out| last_event(out, &Signals::NONE, b"")), "[LASTEVENTS:,,,,]\r\n");
        assert_eq!(text(|out| limits(out, &Signals { limits: 0b101, ..Signals::NONE }, b"")), "[LIMITS:XZ,,,]\r\n");
    }

    fn text(make: impl FnOnce(&mut Text)) -> String {
        let mut out = Text::new();
        make(&mut out);
        assert!(out.len() < out.capacity(), "nothing is cut off");
        String::from_utf8(out.to_vec()).unwrap()
    }

    #[test]
    fn commands_are_read() {
        assert_eq!(read(b"$SED=120"), Some(Command::Describe(120)));
        assert_eq!(read(b"$SPINDLESH"), Some(Command::Spindles { in_fields: true }));
        assert_eq!(read(b"$S"), Some(Command::SingleBlock));
        for other in [b"$SED=".as_slice(), b"$SED=X", b"$SED=1X", b"$SED=-1", b"$SED=70000", b"$SLP", b"$$", b"$BX"] {
            assert_eq!(read(other), None);
        }
    }

    #[test]
    fn the_longest_identity_fits() {
        let pins = PinView { fitted: u32::MAX, ..PinView::default() };
        let this = Identity {
            user: &[b'X'; 80],
            letters: b"VNMCPHR+2",
            blocks: 512,
            axes: 4,
            tools: 32,
            homing: true,
            changes_tools: true,
            pins: &pins,
            board: "nucleo_f446re",
            has_store: true,
            step_rate: 1_000_000,
            program_pins: [2, 2],
        };
        let told = text(|out| options(out, &this));
        assert!(
            told.ends_with(",512,255,4,32]\r\n[AXS:4:XYZA]\r\n[NEWOPT:ENUMS,RT+,HOME,ES,EXPR,TC,SED]\r\n"),
            "{told}"
        );
        let told = text(|out| equipment(out, &this));
        assert!(told.starts_with("[FIRMWARE:grblHAL]\r\n[SIGNALS:RHSDEF]\r\n[NVS STORAGE:FLASH]\r\n"), "{told}");
        assert!(told.ends_with("[MAX STEP RATE:1000000 Hz]\r\n[AUX IO:2,2,0,0]\r\n"), "{told}");
    }

    #[test]
    fn a_spindle_has_its_range() {
        assert_eq!(text(|out| spindle(out, true, false, [0.0, 24_000.0])), "[SPINDLE:0|0|0|*DLV|PWM|0.0,24000.0]\r\n");
        assert_eq!(
            text(|out| spindle(out, false, true, [0.0, 1.0])),
            "0 - PWM, enabled as spindle 0, SDLV, active\r\n"
        );
    }
}
