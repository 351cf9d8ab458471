//! The errors that refuse a line and the alarms that lock the machine, each with its number and English text. The
//! numbers are those of Grbl 1.1. If Grbl does not have an error or alarm, its number is mostly grblHAL's. If grblHAL
//! does not have it either, the number is Oxmill's own.

/// Declares an enum of codes. Each code has a name, the number that the host gets, and a text for people.
macro_rules! codes {
    ($(#[$doc:meta])* $codes:ident; $($(#[$attribute:meta])* $name:ident = $number:literal, $text:literal;)*) => {
        $(#[$doc])*
        #[derive(Clone, Copy, Debug, PartialEq, Eq)]
        #[repr(u8)]
        #[allow(missing_docs, reason = "each variant is described by its text")]
        pub enum $codes {
            $($(#[$attribute])* $name = $number,)*
        }

        impl $codes {
            /// All codes in the order of their numbers.
            pub const ALL: &'static [$codes] = &[$($codes::$name),*];

            /// Returns the number that the host gets, as 9 in `error:9`.
            pub const fn code(self) -> u8 {
                self as u8
            }

            /// Returns the English text that explains the code.
            pub const fn text(self) -> &'static str {
                match self {
                    $($codes::$name => $text,)*
                }
            }
        }
    };
}

pub(crate) use codes;

codes! {
    /// Why a line was refused; answered as `error:N`.
    Error;
    ExpectedLetter = 1, "a word must begin with a letter";
    BadNumber = 2, "the number of a word is missing or malformed, or the $ command is unknown";
    InvalidStatement = 3, "the $ statement was not understood";
    NegativeValue = 4, "the value must not be negative";
    HomingDisabled = 5, "homing is disabled by setting $22";
    StepPulseTooShort = 6, "the step pulse is shorter than the controller can make";
    StoreReadFailed = 7, "stored settings were damaged and have not been confirmed";
    NotIdle = 8, "the command works only while the machine is idle";
    Locked = 9, "G-code is locked out in the alarm or jog state";
    SoftLimitNeedsHoming = 10, "soft limits need homing to be enabled";
    LineTooLong = 11, "the line is too long; it was not executed";
    DoorOpen = 13, "the safety door is open";
    JogOutsideTravel = 15, "the jog target lies outside the machine's travel";
    InvalidJog = 16, "a jog takes axis words, F, G20, G21, G90, G91 and G53 only";
    UnsupportedCommand = 20, "the command is unknown or not supported";
    ModalGroupViolation = 21, "two commands of one modal group stand in the line";
    UndefinedFeed = 22, "no feed rate has been set";
    IntegerRequired = 23, "the command needs a whole number";
    TwoAxisCommands = 24, "two commands that use axis words stand in the line";
    WordRepeated = 25, "a word is repeated in the line";
    NoAxisWords = 26, "the command needs axis words and has none";
    InvalidLineNumber = 27, "the line number is out of range";
    ValueWordMissing = 28, "the command lacks a value word, such as P, L, Q or R";
    UnsupportedCoordinateSystem = 29, "the coordinate system does not exist";
    G53NeedsMotion = 30, "G53 needs G0 or G1 to be active";
    AxisWordsUnused = 31, "axis words stand in the line with no command to use them";
    NoPlaneAxisForArc = 32, "the arc has no axis word in the selected plane";
    InvalidTarget = 33, "the motion's target is invalid";
    ImpossibleRadius = 34, "no arc with this radius reaches the target";
    NoPlaneOffsets = 35, "the arc has no centre offset in the selected plane";
    UnusedWords = 36, "value words stand in the line that no command uses";
    ToolLengthAxis = 37, "the tool length offset is for the tool axis only";
    ToolNumberTooHigh = 38, "the tool number is out of range";
    /// Not in Grbl. From here to 54 the numbers are grblHAL's.
    ValueOutOfRange = 39, "the value of a word is out of range";
    SpindleNotTurning = 41, "the cycle stops the spindle, which does not turn";
    UnknownTool = 47, "the tool is not in the table, or the table is full";
    EmergencyStop = 50, "the emergency stop is active";
    DriverFault = 51, "a motor driver reports a fault";
    SettingOutOfRange = 52, "the setting does not take this value";
    RetractBelowBottom = 54, "R of the cycle lies below the bottom of the hole";
    /// From here to 83 the numbers are grblHAL's.
    UnknownOperation = 71, "the operator or function in the expression is unknown";
    DivisionByZero = 72, "the expression divides by zero";
    ArgumentOutOfRange = 73, "the argument is outside the range of the function or operator";
    InvalidArgument = 74, "the parameter does not exist or has not been set";
    ExpressionSyntax = 75, "the expression is malformed";
    InvalidResult = 76, "the result of the expression is too large";
    FlowSyntax = 81, "the O word is malformed or does not fit those before it";
    TooDeep = 82, "too much is nested";
    OutOfMemory = 83, "the memory for parameters and subroutines is full";
    /// Oxmill's own numbers, above those of other controllers.
    CycleNeedsPerMinute = 120, "a canned cycle, G12 or G13 does not go with G93";
    NotSupported = 121, "the word is known but not supported: docs/gcode.md lists the supported words";
    CutterCompensation = 122, "cutter compensation (G41, G42) is not supported: let the CAM program offset the path";
    NothingSaved = 123, "there is no state that M72 could restore: none was saved in this subroutine";
    DescriptionsLeftOut = 125, "this board has no room for the texts of settings, errors and alarms";
    NotInRotatedPlane = 126, "arcs, cycles and a second rotation must be in the plane of the rotation (G68)";
    RotationActs = 127, "coordinates cannot be set while G68 rotates them";
    RotationLeftOut = 128, "this board has no room for rotated coordinates";
    DamagedLine = 129, "line damaged, out of order or without checksum: send it again, or end line checks with $LC=OFF";
    ToolChangeNeedsHoming = 130, "a tool change with a tool setter ($918=2) needs a machine that is homed";
    ToolSetterNotSetUp = 131, "G30, G59.3 or $342 to $344 are not set for tool changes, or lead out of the machine's travel";
    ToolChangeNotAlone = 132, "with $918=2 the line of M6 takes no axis words and no tool offset: write them on the next line";
    NoSuchPin = 133, "this board has no such output or input for programs (M62 to M68)";
    BlendingLeftOut = 134, "this board has no room for rounded corners";
    RecorderLeftOut = 136, "this board has no room for a recording of what comes in";
    SplineOutsideXy = 140, "G12, G13 and splines (G5 to G5.3) need G17; splines move X and Y only";
    SplinesLeftOut = 141, "this board has no room for splines (G5 to G5.3)";
    UnequalScaling = 142, "the factors of G51 in the plane of the arc are not equal";
    ScalingActs = 143, "coordinates cannot be set while G51 scales them";
    ScalingLeftOut = 144, "this board has no room for scaled coordinates (G51)";
    ControlPointsNotBegun = 145, "control points have to begin with G5.2 where the tool is";
    ControlPointsNotEnded = 146, "control points (G5.2) come to their end with G5.3, or are given up with G80";
    TooFewControlPoints = 147, "a curve (G5.3) has as many control points as its order L at least, its start included";
    TooManyControlPoints = 148, "there is no room for more control points (G5.2)";
    NoParallelAxes = 149, "there are no axes U, V and W";
    OneRotaryAxis = 150, "A is the only axis that turns: there are no axes B and C";
    ThousandfoldScaling = 151, "a factor of G51 is beyond 100: P1 is the size as programmed, not P1000";
    ReadOnlyParameter = 200, "the parameter belongs to the machine and cannot be set";
    ExpressionsLeftOut = 201, "this board has no room for expressions, parameters and O words";
    EndlessLoop = 202, "the loop or call has not come to an end in 100,000 passes";
    OutOfPlace = 203, "a subprogram (O number, M98, M99, G65) is missing or out of place: the line is not run";
}

codes! {
    /// Why the machine locked itself; announced as `ALARM:N`.
    Alarm;
    HardLimit = 1, "a limit switch tripped; the position may be lost";
    SoftLimit = 2, "the target exceeds the machine's travel; the position is kept";
    AbortInMotion = 3, "reset during motion, or connection lost; the position may be lost";
    ProbeInitialState = 4, "the probe was not in the expected state before the cycle";
    ProbeNoContact = 5, "the probe made no contact within its travel";
    HomingReset = 6, "a reset came during homing";
    HomingDoor = 7, "the door opened during homing";
    HomingPullOff = 8, "homing could not clear the switch by pulling off";
    HomingNoSwitch = 9, "homing found no switch within its travel";
    HomingSquaring = 10, "squaring found only one of the two switches of an axis";
    /// The at-speed input did not report the speed in time (`$915`, `$916`), or the spindle lost it during a job
    /// (`$929`). Not in Grbl; the number is grblHAL's.
    SpindleSpeed = 14, "the spindle did not come up to speed in time, or lost it";
    /// The step queue became empty while the motors were moving fast. Grbl has no alarm for this: its machine loses
    /// steps unnoticed. Other controllers use numbers from 11 on, so this number is above theirs.
    Underrun = 100, "motion data ran out at speed; the position may be lost";
    /// Not in Grbl. grblHAL's number for it is 10, which Grbl and Oxmill use for the squaring alarm.
    EmergencyStop = 101, "the emergency stop was pressed; the position may be lost if something moved";
    DriverFault = 102, "a motor driver reported a fault; the position may be lost";
    /// The step outputs did not output the commanded steps. Other controllers cannot detect this.
    Miscounted = 103, "the step outputs and their count disagree; the position is lost";
}
