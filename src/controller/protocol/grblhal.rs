//! What only hosts of `$900=3` get: the `$` commands and the texts that grblHAL has and Grbl lacks. gSender and ioSender
//! show more of a machine that answers like this.

use super::reply_texts::RELEASE;
use super::text::{END, Text, fixed, put, whole};
use crate::axes::Axis;
use crate::messages::{LINES_DEPTH, PinView, input};
use crate::number::{self, Digits};

/// The version of the protocol, in the greeting and in `$I`.
const VERSION: &[u8] = b"1.1f";

/// A `$` command that only hosts of `$900=3` have.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Command {
    /// `$SED=n`: describes one setting.
    Describe(u16),
    /// `$SPINDLES`, and `$SPINDLESH` for programs.
    Spindles {
        /// In fields for programs.
        in_fields: bool,
    },
    /// `$TLR`: the last contact of the probe is the reference of the tool setter.
    ToolReference,
    /// `$S`: switches single block on or off.
    SingleBlock,
    /// `$B`: switches block delete on or off.
    BlockDelete,
    /// `$O`: switches the pause at M1 on or off.
    OptionalStop,
    /// `$+`: lists all settings.
    Settings,
    /// `$HELP`
    Help,
}

/// Reads a `$` line (filtered). Returns `None` if Grbl or Oxmill may know it.
pub fn read(line: &[u8]) -> Option<Command> {
    Some(match line {
        b"$SPINDLES" => Command::Spindles { in_fields: false },
        b"$SPINDLESH" => Command::Spindles { in_fields: true },
        b"$TLR" => Command::ToolReference,
        b"$S" => Command::SingleBlock,
        b"$B" => Command::BlockDelete,
        b"$O" => Command::OptionalStop,
        b"$+" => Command::Settings,
        b"$HELP" => Command::Help,
        _ => {
            let text = line.strip_prefix(b"$SED=")?;
            let number = number::read(text, Digits::Exact).filter(|number| number.used == text.len())?.value;
            Command::Describe(u16::try_from(number.truncate()).ok()?)
        }
    })
}

/// The welcome line.
pub fn welcome(out: &mut Text) {
    put(out, b"\r\nGrblHAL ");
    put(out, VERSION);
    put(out, b" ['$' or '$HELP' for help]\r\n");
}

/// The commands that the answer to `$` lacks.
pub fn help(out: &mut Text) {
    put(out, b"[HLP:$HELP $+ $SED=n $SPINDLES $SPINDLESH $TLR $S $B $O 0x80-83 0x87 0x88 0xA3]\r\n");
}

/// What `$I` and `$I+` answer.
pub struct Identity<'a> {
    /// Text of the user (`$I=`).
    pub user: &'a [u8],
    /// Letters of `OPT`.
    pub letters: &'a [u8],
    /// Capacity of the look-ahead.
    pub blocks: usize,
    /// Axes in use.
    pub axes: usize,
    /// Capacity of the tool table.
    pub tools: usize,
    /// Homing is enabled.
    pub homing: bool,
    /// M6 stops the program for another tool.
    pub changes_tools: bool,
    /// The input pins of the board.
    pub pins: &'a PinView,
    /// Name of the board.
    pub board: &'static str,
    /// Settings survive power-off.
    pub has_store: bool,
    /// Highest step rate in Hz.
    pub step_rate: u32,
    /// Number of outputs and inputs for programs.
    pub program_pins: [u8; 2],
}

/// The letters of control inputs in `SIGNALS`, in grblHAL's order.
const SIGNALS: [(u32, u8); 6] = [
    (input::RESET, b'R'),
    (input::HOLD, b'H'),
    (input::START, b'S'),
    (input::DOOR, b'D'),
    (input::EMERGENCY_STOP, b'E'),
    (input::DRIVER_FAULT, b'F'),
];

/// The first lines of `$I`: `VER`, `OPT`, `AXS` and `NEWOPT`.
pub fn options(out: &mut Text, this: &Identity) {
    put(out, b"[VER:");
    put(out, VERSION);
    put(out, b".");
    put(out, RELEASE.date.as_bytes());
    put(out, b":");
    put(out, this.user);
    put(out, b"]\r\n[OPT:");
    put(out, this.letters);
    for number in [this.blocks, LINES_DEPTH, this.axes, this.tools] {
        put(out, b",");
        whole(out, number as u64);
    }
    put(out, b"]\r\n[AXS:");
    whole(out, this.axes as u64);
    put(out, b":");
    for axis in Axis::ALL.iter().take(this.axes) {
        put(out, &[axis.letter()]);
    }
    // `RT+`: the commands have their old bytes, such as `?`, too.
    put(out, b"]\r\n[NEWOPT:ENUMS,RT+");
    let has_stop = this.pins.fitted >> input::EMERGENCY_STOP & 1 != 0;
    for (has, word) in [(this.homing, ",HOME"), (has_stop, ",ES"), (true, ",EXPR"), (this.changes_tools, ",TC")] {
        put(out, if has { word.as_bytes() } else { b"" });
    }
    put(out, b",SED]\r\n");
}

/// The other lines of `$I`, from `FIRMWARE` on.
pub fn equipment(out: &mut Text, this: &Identity) {
    put(out, b"[FIRMWARE:grblHAL]\r\n[SIGNALS:");
    for (_, letter) in SIGNALS.iter().filter(|(bit, _)| this.pins.fitted >> bit & 1 != 0) {
        put(out, &[*letter]);
    }
    put(out, if this.has_store { b"]\r\n[NVS STORAGE:FLASH" } else { b"" });
    put(out, b"]\r\n[DRIVER:Oxmill]\r\n[DRIVER VERSION:");
    put(out, RELEASE.version.as_bytes());
    put(out, b"]\r\n[BOARD:");
    put(out, this.board.as_bytes());
    put(out, b"]\r\n[MAX STEP RATE:");
    whole(out, this.step_rate.into());
    put(out, b" Hz]\r\n");
    let [outputs, inputs] = this.program_pins.map(u64::from);
    if outputs + inputs > 0 {
        put(out, b"[AUX IO:");
        whole(out, inputs);
        put(out, b",");
        whole(out, outputs);
        put(out, b",0,0]\r\n");
    }
    put(out, b"[SPINDLE:PWM]\r\n");
}

/// The one spindle, as `$SPINDLES` or `$SPINDLESH` describes it.
pub fn spindle(out: &mut Text, in_fields: bool, reports_speed: bool, speeds: [f32; 2]) {
    // Turns both ways, can be a laser, has a variable speed.
    let abilities = if reports_speed { b"SDLV".as_slice() } else { b"DLV" };
    if !in_fields {
        put(out, b"0 - PWM, enabled as spindle 0, ");
        put(out, abilities);
        return put(out, b", active\r\n");
    }
    put(out, b"[SPINDLE:0|0|0|*");
    put(out, abilities);
    put(out, b"|PWM");
    for (speed, before) in speeds.iter().zip([b"|", b","]) {
        put(out, before);
        fixed(out, false, (*speed * 10.0 + 0.5) as u64, 1);
    }
    put(out, b"]");
    put(out, END);
}

/// The name of an input in `$PINS`.
pub const fn input_name(bit: usize) -> &'static str {
    match bit as u32 {
        0 => "X limit",
        1 => "Y limit",
        2 => "Z limit",
        3 => "A limit",
        4 => "B limit",
        5 => "C limit",
        6 => "Second limit",
        input::PROGRAM => "Aux in 0",
        input::PROBE => "Probe",
        input::DOOR => "Safety door",
        input::HOLD => "Feed hold",
        input::START => "Cycle start",
        input::RESET => "Reset",
        input::EMERGENCY_STOP => "Emergency stop",
        input::DRIVER_FAULT => "Motor fault",
        input::AT_SPEED => "At speed",
        _ => "Aux in 1",
    }
}

#[cfg(test)]
mod tests {
    use super::*;

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
        assert!(told.ends_with("[MAX STEP RATE:1000000 Hz]\r\n[AUX IO:2,2,0,0]\r\n[SPINDLE:PWM]\r\n"), "{told}");
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
