//! Explains in a sentence or two what each setting does and when to change it. The controller's own table has number,
//! name, unit, range and default; the boards' firmware does not contain these sentences.

use oxmill_controller::settings::{AxisKey, Key};

/// Explanations of the settings that exist once, not per axis, in the order of the controller's table.
const ONCE: [(Key, &str); Key::COUNT] = [
    (
        Key::StepPulse,
        "Length of a step pulse. Use the value in the driver's data sheet: longer pulses lower the maximum step rate. Tenths are allowed; the minimum is 1 us, on a Nucleo F446RE 0.5.",
    ),
    (
        Key::IdleDelay,
        "How long the drivers stay enabled after a motion. With 255 they always stay enabled, so that no axis drops or loses its position.",
    ),
    (Key::StepInvert, "Inverts the step outputs of these axes, for drivers that step on a low pulse."),
    (Key::DirectionInvert, "Reverses the direction of these axes. Set it for an axis that jogs the wrong way."),
    (Key::EnableInvert, "Inverts the enable output. With 0, a low level enables the drivers."),
    (Key::LimitInvert, "Inverts all limit inputs, for switches that open when touched."),
    (Key::ProbeInvert, "Inverts the probe input, for a probe that opens on contact."),
    (
        Key::StatusReport,
        "What a status report contains: the machine position or the work position, and the free space in the buffers. Change it for a sender that needs it.",
    ),
    (
        Key::JunctionDeviation,
        "How fast corners are passed, given as the deviation of an imagined arc through the corner. The machine still follows the exact path. A larger value passes corners faster, with larger jumps of speed on the axes.",
    ),
    (
        Key::ArcTolerance,
        "How far the straight segments of an arc may deviate from it. A smaller value makes more segments.",
    ),
    (
        Key::ReportInches,
        "Reports positions and speeds in inches. The units of programs are set by their own G20 and G21.",
    ),
    (Key::ControlInvert, "Inverts these inputs, for switches that open when pressed."),
    (
        Key::ControlNoPullUp,
        "Turns off the internal pull-up of these inputs, for inputs with an external resistor or driven by an output.",
    ),
    (
        Key::LimitNoPullUp,
        "Turns off the internal pull-up of these inputs, for inputs with an external resistor or driven by an output.",
    ),
    (
        Key::ProbeNoPullUp,
        "Turns off the internal pull-up of the probe input, for an input with an external resistor or driven by an output.",
    ),
    (
        Key::SoftLimits,
        "Rejects a move beyond the travel before it starts; in a program this is ALARM:2. It needs homing ($22).",
    ),
    (
        Key::HardLimits,
        "A touched limit switch stops the machine with ALARM:1; $924 sets how it stops. Turn this on when all switches are connected.",
    ),
    (
        Key::Homing,
        "Enables homing: after each power-up or hardware reset the machine is locked until $H has found the switches, or $X. Soft limits and parking need it.",
    ),
    (
        Key::HomingDirection,
        "Axes that home toward the negative end. Set it for an axis that moves away from its switch in homing.",
    ),
    (Key::HomingLocate, "Speed of the second, precise touch of a switch. Slower is more precise."),
    (
        Key::HomingSeek,
        "Speed of the first search for a switch. A faster axis overshoots the switch further before it stops.",
    ),
    (
        Key::HomingDebounce,
        "How long homing waits at each switch for its contact to settle. Raise it for switches that bounce.",
    ),
    (
        Key::HomingPullOff,
        "How far an axis backs off its switch at the end of homing. It must be more than the switch needs to open.",
    ),
    (
        Key::DirectionSetup,
        "Minimum time between a change of direction and the next step pulse. Use the value in the driver's data sheet; it is never shorter than 2 us.",
    ),
    (Key::SpindleMaximum, "Speed of the spindle at full output. Measure it without a cutter."),
    (
        Key::SpindleMinimum,
        "Speed of the spindle at minimum output. Between this speed and the maximum ($30), the output rises evenly with S.",
    ),
    (
        Key::Laser,
        "For a laser instead of a spindle: no waiting for spindle speed, no beam in jogs, no parking. Leave it at 0 on a mill.",
    ),
    (
        Key::SpindlePwm,
        "PWM frequency of the spindle output. Use the value that the spindle's drive or converter needs.",
    ),
    (Key::JogClip, "A jog beyond the travel ends at the soft limits. With 0 it is rejected."),
    (
        Key::Parking,
        "Retracts and parks the tool when the safety door opens, if the machine is homed. There is no parking in laser mode.",
    ),
    (Key::ParkingAxis, "The axis that retracts and parks the tool: Z on most machines."),
    (
        Key::HomingPasses,
        "How many times homing touches each switch slowly. More passes help with switches that do not repeat well.",
    ),
    (
        Key::ParkingPullOut,
        "How far the tool is slowly retracted from the work, with the spindle on, before it is parked.",
    ),
    (Key::ParkingPullOutRate, "Speed of the slow retract, and of the return into the work."),
    (
        Key::ParkingTarget,
        "Position of the parking axis in machine coordinates. A tool already beyond it is not parked.",
    ),
    (Key::ParkingFastRate, "Speed between the end of the slow retract and the parking position, both ways."),
    (
        Key::ToolSetterDepth,
        "How far to search for the tool setter, down from the height of G30 ($918=2). If the tool touches nothing, ALARM:5.",
    ),
    (Key::ToolSetterLocate, "Speed of the second touch of the tool setter, which measures the tool."),
    (Key::ToolSetterSeek, "Speed of the first touch of the tool setter, all the way down from the height of G30."),
    (
        Key::SquaringShare,
        "How far one motor may move alone when homing squares an axis, in percent of the axis's travel. More is ALARM:10.",
    ),
    (Key::SquaringLeast, "How far one motor may move alone in squaring, even if the share of $347 is less."),
    (Key::SquaringMost, "How far one motor may move alone in squaring at most, even if the share of $347 is more."),
    (
        Key::DoorSpindleDelay,
        "How long to wait for the spindle after the door was closed, before the coolant is turned on. The spindle must reach its speed in this time.",
    ),
    (
        Key::DoorCoolantDelay,
        "How long to wait for the coolant after the door was closed, before the tool returns into the work.",
    ),
    (
        Key::SpinUp,
        "How long motion waits after the spindle was turned on or reversed. Set it to the time that the spindle needs to reach its speed.",
    ),
    (
        Key::SpinDown,
        "How long motion waits after the spindle was turned off. Set it to the time that the spindle needs to stop.",
    ),
    (
        Key::Dialect,
        "Which words, settings and answers are available. Choose Grbl for a sender that rejects everything that Grbl does not have, and grblHAL for gSender or ioSender, which then show more of the machine.",
    ),
    (
        Key::StopOnError,
        "A rejected line ends the job: the machine brakes, accepted moves that it has not made are dropped, and it is locked until $X. With 0 the next lines are executed, as with Grbl, unless the rejected line has M6 and $918 is not 0.",
    ),
    (
        Key::TrustNeeded,
        "With homing enabled, G53, G28 and G30 are rejected, and soft limits are inactive, until the machine position is known (home first). With 0 they use the position as it is.",
    ),
    (Key::DoorFitted, "Whether a safety door is connected. Set it to 0 on a machine without a door."),
    (Key::Kinematics, "How the motors move the axes. Choose CoreXY if two belts move X and Y together."),
    (
        Key::GangedAxis,
        "The axis that has a second motor with its own pins, such as a gantry with a motor on each side.",
    ),
    (Key::GangedInvert, "Reverses the second motor of the axis, if it is mounted as a mirror image of the first."),
    (Key::GangedSwitch, "The second motor has its own limit switch, so homing squares the axis."),
    (Key::LimitInvertEach, "Inverts single limit inputs in addition to $5, for machines with switches of both kinds."),
    (Key::ControlPullDown, "Uses pull-downs instead of pull-ups for these inputs, for switches to the supply voltage."),
    (Key::LimitPullDown, "Uses pull-downs instead of pull-ups for these inputs, for switches to the supply voltage."),
    (
        Key::ProbePullDown,
        "Uses a pull-down instead of the pull-up for the probe input, for a probe to the supply voltage.",
    ),
    (
        Key::ResetIsEmergencyStop,
        "The reset input is an emergency stop, which stays active until a reset. The button should also cut the power of the motors.",
    ),
    (
        Key::EmergencyDriversOff,
        "Disables the motors at an emergency stop or a driver fault. With 0 they hold, so that no axis drops.",
    ),
    (
        Key::HoldWithoutHost,
        "A connection that ends during a job is a fault; $928 sets the reaction. With 0 the lines already received are finished.",
    ),
    (Key::AtSpeed, "Which level of an input signals that the spindle has reached its speed. Cuts wait for it."),
    (
        Key::AtSpeedWithin,
        "How long the spindle may take to reach its speed, if there is an at-speed input ($915). After that, ALARM:14.",
    ),
    (
        Key::CurveAcceleration,
        "How much of the axes' acceleration may be used in curves. A value above 100 is faster in small arcs, as with Grbl, but motors may stall there; then use 100 or less.",
    ),
    (
        Key::ToolChange,
        "What M6 does: only note the tool, or stop and wait for a manual tool change. With 2 the machine also goes to G30 for the change and measures the tool at a tool setter at G59.3; it must be homed.",
    ),
    (Key::OptionalStop, "M1 pauses the job. With 0 it is ignored."),
    (
        Key::BlockDelete,
        "Lines that begin with a slash, also after a line number, are skipped. With 0 the slash is ignored.",
    ),
    (
        Key::PeckClearance,
        "G73: how far the drill retracts after each peck. G83: how far above the depth reached so far the rapid back into the hole ends.",
    ),
    (
        Key::HostSilence,
        "How long the host may be silent during a job before the reaction of $928, for connections that do not notice a pulled cable. 0 turns this off.",
    ),
    (Key::JogSilence, "How long the host may be silent during a jog before the jog ends. 0 turns this off."),
    (
        Key::LimitReaction,
        "How the machine stops at a limit switch. Braking keeps the position, but needs room behind the switch.",
    ),
    (
        Key::EmergencyReaction,
        "How the machine stops at an emergency stop. Leave it at 0 unless someone has assessed the safety of the whole machine.",
    ),
    (
        Key::DriverReaction,
        "How the machine stops at a driver fault. The position is not trusted afterwards in any case.",
    ),
    (Key::SpindleReaction, "How the machine stops if the spindle loses its speed."),
    (
        Key::HostReaction,
        "Reaction to a connection that ends ($914) or a host that is silent ($922) during a job. With 4 the machine holds with the spindle on, and ~ resumes.",
    ),
    (
        Key::SpeedLoss,
        "How long the spindle may be below its speed during a job before this is a fault, if there is an at-speed input ($915).",
    ),
    (
        Key::Axes,
        "Number of axes. With 4 there is a rotary axis A: its words and positions are in degrees, and its settings are listed. This needs a board with four axes.",
    ),
    (
        Key::Baud,
        "Baud rate of the board's UART after its next power-up or hardware reset; it does not matter over USB. If the hold and start inputs are both active at power-up, the rate is 115200.",
    ),
    (
        Key::ZeroAtPullOff,
        "Machine zero is the position where homing ends, at the pull-off ($27) from the switch, and not the position of the switch. Turn this on for jobs that go to machine zero, such as G28 G91 Z0. The coordinates of an axis that homes to its negative end are then positive.",
    ),
];

/// Explanations of the settings that exist per axis, in the order of the controller's table.
const PER_AXIS: [(AxisKey, &str); AxisKey::COUNT] = [
    (
        AxisKey::HomingCycle,
        "Which axes home together in this cycle; after it comes the next cycle. A cycle with 0 is skipped.",
    ),
    (
        AxisKey::Resolution,
        "Steps per millimetre: steps per revolution, times microsteps, divided by the travel per revolution. Measure a long move to correct it.",
    ),
    (
        AxisKey::MaxRate,
        "Maximum speed of the axis, also the speed of its rapids. Lower it if the motor stalls at high speed.",
    ),
    (
        AxisKey::Acceleration,
        "Acceleration of the axis. Lower it if the motor stalls when it starts or stops; a higher value shortens jobs.",
    ),
    (AxisKey::Travel, "Travel of the axis, from its switch to the other end. Homing and soft limits use it."),
    (
        AxisKey::Backlash,
        "How far the motor turns after a reversal before the tool follows. Measure it with a dial indicator; 0 turns the correction off.",
    ),
    (
        AxisKey::Jerk,
        "How fast the acceleration may change. A limit makes starts and stops softer and longer; 0 means no limit.",
    ),
];

/// Returns the explanation of the setting with this number; empty if the number does not exist.
pub fn setting(number: u16) -> &'static str {
    let once = ONCE.iter().find(|(key, _)| key.number() == number).map(|(_, sentence)| *sentence);
    let per_axis = || PER_AXIS.iter().find(|(key, _)| key.axis(number).is_some()).map(|(_, sentence)| *sentence);
    once.or_else(per_axis).unwrap_or_default()
}

#[cfg(test)]
mod tests {
    use super::*;
    use oxmill_controller::settings::Settings;

    #[test]
    fn every_setting_has_its_sentence() {
        let rows = (0..Settings::<6>::LINES).filter_map(|line| Settings::<6>::described(line, 6));
        let mut numbers = 0;
        for row in rows {
            let sentence = setting(row.number);
            assert!(sentence.ends_with('.') && sentence.len() > 25, "${}: {sentence}", row.number);
            numbers += 1;
        }
        assert_eq!(numbers, Settings::<6>::LINES);
        for (index, (key, _)) in ONCE.iter().enumerate() {
            assert_eq!(*key as usize, index, "{key:?} is in the order of the table");
        }
        for (index, (key, _)) in PER_AXIS.iter().enumerate() {
            assert_eq!(*key as usize, index, "{key:?} is in the order of the table");
        }
        assert_eq!(setting(8), "");
        assert_eq!(setting(9999), "");
    }
}
