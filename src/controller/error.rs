//! What can go wrong, with the numbers that Grbl 1.1 gives it on the wire.

/// Why a line was refused; answered as `error:N`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
#[allow(missing_docs, reason = "each variant is described by Error::text")]
pub enum Error {
    ExpectedLetter = 1,
    BadNumber = 2,
    InvalidStatement = 3,
    NegativeValue = 4,
    HomingDisabled = 5,
    StepPulseTooShort = 6,
    StoreReadFailed = 7,
    NotIdle = 8,
    Locked = 9,
    SoftLimitNeedsHoming = 10,
    LineTooLong = 11,
    StepRateTooHigh = 12,
    DoorOpen = 13,
    JogOutsideTravel = 15,
    InvalidJog = 16,
    UnsupportedCommand = 20,
    ModalGroupViolation = 21,
    UndefinedFeed = 22,
    IntegerRequired = 23,
    TwoAxisCommands = 24,
    WordRepeated = 25,
    NoAxisWords = 26,
    InvalidLineNumber = 27,
    ValueWordMissing = 28,
    UnsupportedCoordinateSystem = 29,
    G53NeedsMotion = 30,
    AxisWordsUnused = 31,
    NoPlaneAxisForArc = 32,
    InvalidTarget = 33,
    ImpossibleRadius = 34,
    NoPlaneOffsets = 35,
    UnusedWords = 36,
    ToolLengthAxis = 37,
    ToolNumberTooHigh = 38,
    /// Not in Grbl; the number is grblHAL's, as the next one's.
    EmergencyStop = 50,
    DriverFault = 51,
}

impl Error {
    /// All of them, in the order of their numbers.
    pub const ALL: [Error; 36] = [
        Error::ExpectedLetter,
        Error::BadNumber,
        Error::InvalidStatement,
        Error::NegativeValue,
        Error::HomingDisabled,
        Error::StepPulseTooShort,
        Error::StoreReadFailed,
        Error::NotIdle,
        Error::Locked,
        Error::SoftLimitNeedsHoming,
        Error::LineTooLong,
        Error::StepRateTooHigh,
        Error::DoorOpen,
        Error::JogOutsideTravel,
        Error::InvalidJog,
        Error::UnsupportedCommand,
        Error::ModalGroupViolation,
        Error::UndefinedFeed,
        Error::IntegerRequired,
        Error::TwoAxisCommands,
        Error::WordRepeated,
        Error::NoAxisWords,
        Error::InvalidLineNumber,
        Error::ValueWordMissing,
        Error::UnsupportedCoordinateSystem,
        Error::G53NeedsMotion,
        Error::AxisWordsUnused,
        Error::NoPlaneAxisForArc,
        Error::InvalidTarget,
        Error::ImpossibleRadius,
        Error::NoPlaneOffsets,
        Error::UnusedWords,
        Error::ToolLengthAxis,
        Error::ToolNumberTooHigh,
        Error::EmergencyStop,
        Error::DriverFault,
    ];

    /// The number on the wire.
    pub const fn code(self) -> u8 {
        self as u8
    }

    /// What it means, for people.
    pub const fn text(self) -> &'static str {
        match self {
            Error::ExpectedLetter => "a word must begin with a letter",
            Error::BadNumber => "the number of a word is missing or malformed, or the $ command is unknown",
            Error::InvalidStatement => "the $ statement was not understood",
            Error::NegativeValue => "the value must not be negative",
            Error::HomingDisabled => "homing is disabled by setting $22",
            Error::StepPulseTooShort => "the step pulse is shorter than the controller can make",
            Error::StoreReadFailed => "stored settings were damaged and have not been confirmed",
            Error::NotIdle => "the command works only while the machine is idle",
            Error::Locked => "G-code is locked out in the alarm or jog state",
            Error::SoftLimitNeedsHoming => "soft limits need homing to be enabled",
            Error::LineTooLong => "the line is too long; it was not executed",
            Error::StepRateTooHigh => "the setting exceeds the greatest step rate",
            Error::DoorOpen => "the safety door is open",
            Error::JogOutsideTravel => "the jog target lies outside the machine's travel",
            Error::InvalidJog => "a jog takes axis words, F, G20, G21, G90, G91 and G53 only",
            Error::UnsupportedCommand => "the command is unknown or not supported",
            Error::ModalGroupViolation => "two commands of one modal group stand in the line",
            Error::UndefinedFeed => "no feed rate has been set",
            Error::IntegerRequired => "the command needs a whole number",
            Error::TwoAxisCommands => "two commands that use axis words stand in the line",
            Error::WordRepeated => "a word is repeated in the line",
            Error::NoAxisWords => "the command needs axis words and has none",
            Error::InvalidLineNumber => "the line number is out of range",
            Error::ValueWordMissing => "the command lacks a P or L word",
            Error::UnsupportedCoordinateSystem => "the coordinate system does not exist",
            Error::G53NeedsMotion => "G53 needs G0 or G1 to be active",
            Error::AxisWordsUnused => "axis words stand in the line with no command to use them",
            Error::NoPlaneAxisForArc => "the arc has no axis word in the selected plane",
            Error::InvalidTarget => "the motion's target is invalid",
            Error::ImpossibleRadius => "no arc with this radius reaches the target",
            Error::NoPlaneOffsets => "the arc has no centre offset in the selected plane",
            Error::UnusedWords => "value words stand in the line that no command uses",
            Error::ToolLengthAxis => "the tool length offset is for the tool axis only",
            Error::ToolNumberTooHigh => "the tool number is out of range",
            Error::EmergencyStop => "the emergency stop is active",
            Error::DriverFault => "a motor driver reports a fault",
        }
    }
}

/// Why the machine locked itself; announced as `ALARM:N`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
#[allow(missing_docs, reason = "each variant is described by Alarm::text")]
pub enum Alarm {
    HardLimit = 1,
    SoftLimit = 2,
    AbortInMotion = 3,
    ProbeInitialState = 4,
    ProbeNoContact = 5,
    HomingReset = 6,
    HomingDoor = 7,
    HomingPullOff = 8,
    HomingNoSwitch = 9,
    HomingSquaring = 10,
    /// The spindle did not tell in time that it is up to speed (`$915`, `$916`). Not in Grbl; grblHAL's number.
    SpindleSpeed = 14,
    /// The step queue ran dry at speed. Grbl has no number for it (its machine would lose steps silently); numbers from
    /// 11 on are taken by other controllers, so one above theirs.
    Underrun = 100,
    /// Not in Grbl; grblHAL's 10 is taken here by Grbl's own squaring alarm.
    EmergencyStop = 101,
    DriverFault = 102,
}

impl Alarm {
    /// The number on the wire.
    pub const fn code(self) -> u8 {
        self as u8
    }

    /// What it means, for people.
    pub const fn text(self) -> &'static str {
        match self {
            Alarm::HardLimit => "a limit switch tripped; the position may be lost",
            Alarm::SoftLimit => "the target exceeds the machine's travel; the position is kept",
            Alarm::AbortInMotion => "a reset came in motion; the position may be lost",
            Alarm::ProbeInitialState => "the probe was not in the expected state before the cycle",
            Alarm::ProbeNoContact => "the probe made no contact within its travel",
            Alarm::HomingReset => "a reset came during homing",
            Alarm::HomingDoor => "the door opened during homing",
            Alarm::HomingPullOff => "homing could not clear the switch by pulling off",
            Alarm::HomingNoSwitch => "homing found no switch within its travel",
            Alarm::HomingSquaring => "squaring found only one of the two switches of an axis",
            Alarm::SpindleSpeed => "the spindle did not come up to speed in time; the position is kept",
            Alarm::Underrun => "motion data ran out at speed; the position may be lost",
            Alarm::EmergencyStop => "the emergency stop was pressed; the position may be lost if something moved",
            Alarm::DriverFault => "a motor driver reported a fault; the position may be lost",
        }
    }
}
