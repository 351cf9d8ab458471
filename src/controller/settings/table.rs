//! The table of all settings. To add a setting, add a row here.

use super::row::{ALL_AXIS_LABELS, AXIS_LABELS, Description, Entry, Kind, SettingGroup, table};
use crate::axes::Axis;
use crate::image::FULL_IMAGE;

/// Bits of the control inputs, as in grblHAL's `$14` and `$17`.
const CONTROL: Kind = Kind::Mask(0b1_0100_1111);
/// Bits of the limit inputs: six axes, and the switch of a second motor.
const LIMITS: Kind = Kind::Mask(0x7F);
/// Labels of the values 0 to 5 of a reaction to a fault, such as `$924`: see `states::stops::reaction`.
const REACTIONS: &str =
    "Stop,Brake,Brake and retract,Stop (spindle on),Brake (spindle on),Brake and retract (spindle on)";
const CONTROL_LABELS: &str = "Reset,Feed hold,Cycle start,Safety door,N/A,N/A,Emergency stop,N/A,Driver fault";
const LIMIT_LABELS: &str = "X axis,Y axis,Z axis,A axis,B axis,C axis,Second motor";

// Maximum value and labels of `$900`. The small image lacks the dialect of grblHAL.
const MOST_DIALECT: u32 = if FULL_IMAGE { GRBLHAL } else { 2 };
const DIALECT_LABELS: &str = if FULL_IMAGE { "Grbl,Oxmill,Seed document,grblHAL" } else { "Grbl,Oxmill,Seed document" };
/// Value of `$900` for the dialect in which hosts are answered like grblHAL.
pub(super) const GRBLHAL: u32 = 3;

table! {
    /// Settings that exist once for the machine, not per axis.
    SCALARS;
    /// Descriptions of the rows of [`SCALARS`].
    SCALAR_DESCRIPTIONS;
    /// Names the rows of [`SCALARS`].
    Key {
        StepPulse: 0, "Step pulse", "us", Steppers, "", Kind::Tenths(5, 2550), 10.0, true;
        IdleDelay: 1, "Step idle delay", "ms", Steppers, "", Kind::Whole(0, 255), 25.0, true;
        StepInvert: 2, "Step invert", "mask", Steppers, AXIS_LABELS, Kind::Whole(0, 255), 0.0, true;
        DirectionInvert: 3, "Direction invert", "mask", Steppers, AXIS_LABELS, Kind::Whole(0, 255), 0.0, true;
        EnableInvert: 4, "Enable invert", "", Steppers, "", Kind::Switch, 0.0, true;
        LimitInvert: 5, "Limit invert", "", Limits, "", Kind::Switch, 0.0, true;
        ProbeInvert: 6, "Probe invert", "", Probing, "", Kind::Switch, 0.0, true;
        StatusReport: 10, "Status report", "mask", General, "Machine position,Buffer state", Kind::Whole(0, 255), 1.0, true;
        JunctionDeviation: 11, "Junction deviation", "mm", Motion, "", Kind::Real, 0.010, true;
        ArcTolerance: 12, "Arc tolerance", "mm", Motion, "", Kind::Real, 0.002, true;
        ReportInches: 13, "Report in inches", "", General, "", Kind::Switch, 0.0, true;
        ControlInvert: 14, "Control inputs invert", "mask", ControlInputs, CONTROL_LABELS, CONTROL, 0.0, false;
        ControlNoPullUp: 17, "Control inputs without pull-up", "mask", ControlInputs, CONTROL_LABELS, CONTROL, 0.0, false;
        LimitNoPullUp: 18, "Limit inputs without pull-up", "mask", Limits, LIMIT_LABELS, LIMITS, 0.0, false;
        ProbeNoPullUp: 19, "Probe input without pull-up", "", Probing, "", Kind::Switch, 0.0, false;
        SoftLimits: 20, "Soft limits", "", Limits, "", Kind::Switch, 0.0, true;
        HardLimits: 21, "Hard limits", "", Limits, "", Kind::Switch, 0.0, true;
        Homing: 22, "Homing", "", Homing, "", Kind::Switch, 0.0, true;
        HomingDirection: 23, "Homing direction", "mask", Homing, AXIS_LABELS, Kind::Whole(0, 255), 0.0, true;
        HomingLocate: 24, "Homing locate feed", "mm/min", Homing, "", Kind::Real, 25.0, true;
        HomingSeek: 25, "Homing seek rate", "mm/min", Homing, "", Kind::Real, 500.0, true;
        HomingDebounce: 26, "Homing debounce", "ms", Homing, "", Kind::Whole(0, 65_535), 250.0, true;
        HomingPullOff: 27, "Homing pull-off", "mm", Homing, "", Kind::Real, 1.0, true;
        DirectionSetup: 29, "Direction set-up", "us", Steppers, "", Kind::Whole(0, 255), 5.0, false;
        SpindleMaximum: 30, "Maximum spindle speed", "rpm", Spindle, "", Kind::Speed, 1000.0, true;
        SpindleMinimum: 31, "Minimum spindle speed", "rpm", Spindle, "", Kind::Speed, 0.0, true;
        Laser: 32, "Laser mode", "", Spindle, "", Kind::Switch, 0.0, true;
        SpindlePwm: 33, "Spindle PWM frequency", "Hz", Spindle, "", Kind::Whole(1, 100_000), 5000.0, false;
        JogClip: 40, "Jogs end at the soft limits", "", Limits, "", Kind::Switch, 0.0, false;
        Parking: 41, "Parking", "", Door, "", Kind::Switch, 0.0, false;
        ParkingAxis: 42, "Parking axis", "", Door, ALL_AXIS_LABELS, Kind::Whole(0, 5), 2.0, false;
        HomingPasses: 43, "Homing locate passes", "", Homing, "", Kind::Whole(1, 128), 1.0, false;
        ParkingPullOut: 56, "Parking pull-out", "mm", Door, "", Kind::Real, 5.0, false;
        ParkingPullOutRate: 57, "Parking pull-out rate", "mm/min", Door, "", Kind::Real, 100.0, false;
        ParkingTarget: 58, "Parking place", "mm", Door, "", Kind::Place, -5.0, false;
        ParkingFastRate: 59, "Parking fast rate", "mm/min", Door, "", Kind::Real, 500.0, false;
        ToolSetterDepth: 342, "Greatest way down to the tool setter", "mm", Program, "", Kind::Real, 30.0, false;
        ToolSetterLocate: 343, "Tool setter locate feed", "mm/min", Program, "", Kind::Real, 25.0, false;
        ToolSetterSeek: 344, "Tool setter seek rate", "mm/min", Program, "", Kind::Real, 200.0, false;
        SquaringShare: 347, "Squaring fails after (share of the travel)", "%", GangedAxis, "", Kind::Real, 5.0, false;
        SquaringLeast: 348, "Squaring fails after at least", "mm", GangedAxis, "", Kind::Real, 2.5, false;
        SquaringMost: 349, "Squaring fails after at most", "mm", GangedAxis, "", Kind::Real, 25.0, false;
        DoorSpindleDelay: 392, "Spindle on to coolant on, after a door", "s", Door, "", Kind::Real, 4.0, false;
        DoorCoolantDelay: 393, "Coolant on to motion, after a door", "s", Door, "", Kind::Real, 1.0, false;
        SpinUp: 394, "Spindle on to motion", "s", Spindle, "", Kind::Real, 0.0, false;
        SpinDown: 539, "Spindle off to motion", "s", Spindle, "", Kind::Real, 0.0, false;
        Dialect: 900, "Dialect", "", General, DIALECT_LABELS, Kind::Whole(0, MOST_DIALECT), 1.0, false;
        StopOnError: 901, "An error stops the job", "", General, "", Kind::Switch, 0.0, false;
        TrustNeeded: 902, "Machine coordinates need a trusted position", "", General, "", Kind::Switch, 1.0, false;
        DoorFitted: 903, "Safety door fitted", "", Door, "", Kind::Switch, 1.0, false;
        Kinematics: 904, "Kinematics", "", Motion, "Cartesian,CoreXY", Kind::Whole(0, 1), 0.0, false;
        GangedAxis: 905, "Axis with two motors", "", GangedAxis, "None,X axis,Y axis,Z axis", Kind::Whole(0, 3), 0.0, false;
        GangedInvert: 906, "Second motor turns the other way", "", GangedAxis, "", Kind::Switch, 0.0, false;
        GangedSwitch: 907, "Second motor has its own limit switch", "", GangedAxis, "", Kind::Switch, 0.0, false;
        LimitInvertEach: 908, "Limit inputs of the other polarity than $5 says", "mask", Limits, LIMIT_LABELS, LIMITS, 0.0, false;
        ControlPullDown: 909, "Control inputs with a pull-down", "mask", ControlInputs, CONTROL_LABELS, CONTROL, 0.0, false;
        LimitPullDown: 910, "Limit inputs with a pull-down", "mask", Limits, LIMIT_LABELS, LIMITS, 0.0, false;
        ProbePullDown: 911, "Probe input with a pull-down", "", Probing, "", Kind::Switch, 0.0, false;
        ResetIsEmergencyStop: 912, "Reset input is an emergency stop", "", ControlInputs, "", Kind::Switch, 0.0, false;
        EmergencyDriversOff: 913, "Emergency stop and driver fault switch the drivers off", "", ControlInputs, "", Kind::Switch, 0.0, false;
        HoldWithoutHost: 914, "The host's going in mid-job is a fault", "", General, "", Kind::Switch, 1.0, false;
        AtSpeed: 915, "Spindle at-speed input", "", Spindle, "None,Low at speed,High at speed", Kind::Whole(0, 2), 0.0, false;
        AtSpeedWithin: 916, "Longest time from spindle on to at speed", "s", Spindle, "", Kind::Real, 10.0, false;
        CurveAcceleration: 917, "Acceleration in curves, share of $120 to $122", "%", Motion, "", Kind::Whole(10, 1000), 100.0, false;
        ToolChange: 918, "M6", "", Program, "Is ignored,Stops and asks for the tool,Stops and measures the tool", Kind::Whole(0, 2), 0.0, false;
        OptionalStop: 919, "M1 pauses", "", Program, "", Kind::Switch, 0.0, false;
        BlockDelete: 920, "Lines that begin with / are skipped", "", Program, "", Kind::Switch, 0.0, false;
        PeckClearance: 921, "Peck clearance (G73, G83)", "mm", Program, "", Kind::Real, 0.254, false;
        HostSilence: 922, "Longest silence of the host in mid-job", "s", General, "", Kind::Real, 0.0, false;
        JogSilence: 923, "Longest silence of the host during a jog", "s", General, "", Kind::Real, 0.0, false;
        LimitReaction: 924, "Reaction to a limit switch", "", Limits, REACTIONS, Kind::Whole(0, 5), 0.0, false;
        EmergencyReaction: 925, "Reaction to the emergency stop", "", ControlInputs, "Stop,Brake,Brake and retract", Kind::Whole(0, 2), 0.0, false;
        DriverReaction: 926, "Reaction to a driver fault", "", ControlInputs, REACTIONS, Kind::Whole(0, 5), 0.0, false;
        SpindleReaction: 927, "Reaction to a spindle that loses its speed", "", Spindle, REACTIONS, Kind::Whole(0, 5), 1.0, false;
        HostReaction: 928, "Reaction to a host that is silent or gone in mid-job", "", General, REACTIONS, Kind::Whole(0, 5), 4.0, false;
        SpeedLoss: 929, "Longest loss of spindle speed (0 = not watched)", "s", Spindle, "", Kind::Real, 1.0, false;
        Axes: 930, "Axes in use (4 with A, which turns)", "", General, "", Kind::Whole(3, 6), 3.0, false;
        Baud: 931, "Baud rate of the serial port, from the next start on", "Bd", General, "", Kind::Whole(115_200, 1_000_000), 115_200.0, false;
        ZeroAtPullOff: 932, "Machine zero where homing ends", "", Homing, "", Kind::Switch, 0.0, false;
    }
}

impl Key {
    /// Returns the number after `$`.
    #[allow(clippy::indexing_slicing, reason = "there is a row for each")]
    pub const fn number(self) -> u16 {
        SCALARS[self as usize].number
    }
}

table! {
    /// Settings that exist for each axis, with the number for X; Y has the next number, and so on.
    PER_AXIS;
    /// Descriptions of the rows of [`PER_AXIS`].
    PER_AXIS_DESCRIPTIONS;
    /// Names the rows of [`PER_AXIS`].
    AxisKey {
        // Here the numbers stand for homing cycles, not for axes: `$44` is the mask of the axes in the first cycle,
        // `$45` in the second. There are as many cycles as axes. Their defaults are in `homing_cycle`.
        HomingCycle: 44, "Axes homed in cycle", "mask", Homing, AXIS_LABELS, Kind::Axes, 0.0, false;
        Resolution: 100, "Resolution", "steps/mm", Axes, "", Kind::Real, 250.0, true;
        MaxRate: 110, "Maximum rate", "mm/min", Axes, "", Kind::Real, 500.0, true;
        Acceleration: 120, "Acceleration", "mm/s2", Axes, "", Kind::Real, 10.0, true;
        Travel: 130, "Maximum travel", "mm", Axes, "", Kind::Real, 200.0, true;
        Backlash: 160, "Backlash of the motor's drive", "mm", Axes, "", Kind::Real, 0.0, false;
        Jerk: 220, "Jerk (0 = not limited)", "mm/s3", Axes, "", Kind::Real, 0.0, false;
    }
}

impl AxisKey {
    /// Returns the number after `$` for X; Y has the next number, and so on.
    #[allow(clippy::indexing_slicing, reason = "there is a row for each")]
    pub const fn number(self) -> u16 {
        PER_AXIS[self as usize].number
    }

    /// Returns the axis to which `number` belongs, for example Y for 101 of `Resolution`; `None` if this setting does
    /// not have that number.
    pub fn axis(self, number: u16) -> Option<Axis> {
        Axis::ALL.get(usize::from(number.checked_sub(self.number())?)).copied()
    }
}

/// Returns the default axes of the `n`-th homing cycle: first Z, to clear the work, then X and Y together. Rotary axes
/// are in no cycle, because few of them have a switch.
pub(super) const fn homing_cycle(n: usize) -> u8 {
    match n {
        0 => 0b100,
        1 => 0b011,
        _ => 0,
    }
}

pub(super) const SOFT_LIMITS: u16 = Key::SoftLimits.number();
/// Number of the only setting that may be negative.
pub(super) const PARKING_PLACE: u16 = Key::ParkingTarget.number();

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_key_names_its_row() {
        for (key, number) in [
            (Key::StepPulse, 0),
            (Key::StatusReport, 10),
            (Key::ReportInches, 13),
            (Key::ControlInvert, 14),
            (Key::Homing, 22),
            (Key::HomingPullOff, 27),
            (Key::DirectionSetup, 29),
            (Key::SpindleMinimum, 31),
            (Key::Laser, 32),
            (Key::SpindlePwm, 33),
            (Key::JogClip, 40),
            (Key::HomingPasses, 43),
            (Key::ParkingTarget, 58),
            (Key::SquaringMost, 349),
            (Key::Dialect, 900),
            (Key::SpinDown, 539),
            (Key::TrustNeeded, 902),
            (Key::GangedSwitch, 907),
            (Key::ProbeNoPullUp, 19),
            (Key::EmergencyDriversOff, 913),
            (Key::HoldWithoutHost, 914),
            (Key::AtSpeedWithin, 916),
            (Key::CurveAcceleration, 917),
            (Key::JogSilence, 923),
        ] {
            assert_eq!(SCALARS[key as usize].number, number);
        }
        assert_eq!(PER_AXIS[AxisKey::Travel as usize].number, 130);
    }
}
