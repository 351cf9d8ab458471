//! Explains in a sentence or two what each setting does and when to change it. The controller's own table has number,
//! name, unit, range and default; the boards' firmware does not contain these sentences.

use oxmill_controller::settings::{AxisKey, Key};

/// Sentences for the settings that exist once, in the order of the controller's table.
const ONCE: [(Key, &str); Key::COUNT] = [
    (
        Key::StepPulse,
        "How long a step pulse is. Take what the data sheet of the driver asks for: a longer one lowers the greatest step rate. Tenths count; the least is 1 us, on a Nucleo F446RE 0.5.",
    ),
    (
        Key::IdleDelay,
        "How long the drivers stay on after a motion. With 255 they stay on, so that an axis does not drop or lose its place.",
    ),
    (
        Key::StepInvert,
        "Turns the level of the step outputs of these axes round, for drivers that step with a low pulse.",
    ),
    (Key::DirectionInvert, "Turns these axes round. Set it for an axis that jogs the wrong way."),
    (Key::EnableInvert, "Turns the level of the enable output round. With 0, low switches the drivers on."),
    (Key::LimitInvert, "Turns the level of all limit inputs round, for switches that open when they are touched."),
    (Key::ProbeInvert, "Turns the level of the probe input round, for a probe that opens when it touches."),
    (
        Key::StatusReport,
        "What a status report tells: the machine position or the work position, and the room in the buffers. Change it for a sender that asks for it.",
    ),
    (
        Key::JunctionDeviation,
        "How far an arc that the axes can follow might cut a corner; the path itself is kept. A larger value passes corners faster, and axes have a larger jump of speed there.",
    ),
    (Key::ArcTolerance, "How far the chords of an arc may be off it. A smaller value gives more chords."),
    (Key::ReportInches, "Reports places and speeds in inches. How a program is read is decided by its G20 and G21."),
    (Key::ControlInvert, "Turns the level of these inputs round, for switches that open when they are pressed."),
    (
        Key::ControlNoPullUp,
        "Switches the chip's own pull-up of these inputs off, where there is another resistor or an output drives them.",
    ),
    (
        Key::LimitNoPullUp,
        "Switches the chip's own pull-up of these inputs off, where there is another resistor or an output drives them.",
    ),
    (
        Key::ProbeNoPullUp,
        "Switches the chip's own pull-up of the probe off, where there is another resistor or an output drives it.",
    ),
    (
        Key::SoftLimits,
        "Refuses a move that would leave the travel before it begins: a program ends with ALARM:2. It needs homing ($22).",
    ),
    (
        Key::HardLimits,
        "A limit switch that is touched stops the machine with ALARM:1, in the way that $924 chooses. Switch it on when all switches are wired.",
    ),
    (
        Key::Homing,
        "Switches homing on: from its next start (power, NRST) on, the machine is locked until $H has found the switches, or $X. Soft limits and parking need it.",
    ),
    (
        Key::HomingDirection,
        "Axes that look for their switch at the negative end. Set it for an axis whose homing moves away from its switch.",
    ),
    (Key::HomingLocate, "Speed of the second, exact touch of a switch. Slower is more exact."),
    (
        Key::HomingSeek,
        "Speed of the first search for a switch. A faster axis goes further past the contact before it is at rest.",
    ),
    (
        Key::HomingDebounce,
        "How long homing waits at each switch until its contact is at rest. Raise it for switches that bounce.",
    ),
    (
        Key::HomingPullOff,
        "How far an axis backs off its switch at the end of homing. It has to be farther than the switch needs to open.",
    ),
    (
        Key::DirectionSetup,
        "Least time from a change of direction to the step pulse behind it. Take what the data sheet of the driver asks for; 2 us are kept in any case.",
    ),
    (Key::SpindleMaximum, "Speed of the spindle at full output. Measure it without a cutter."),
    (
        Key::SpindleMinimum,
        "Speed of the spindle at the least output. Between both ends the output is in proportion to the S word.",
    ),
    (
        Key::Laser,
        "For a laser in place of a spindle: there are no waits for its speed, jogs are dark, and nothing is parked. Leave it at 0 on a mill.",
    ),
    (
        Key::SpindlePwm,
        "Frequency of the output for the spindle's speed. Take what its drive or its converter asks for.",
    ),
    (Key::JogClip, "A jog that would leave the travel ends at the soft limits. With 0 it is refused."),
    (
        Key::Parking,
        "Pulls the tool out and parks it when the safety door opens, on a machine that is homed. Laser mode does not park.",
    ),
    (Key::ParkingAxis, "The axis that pulls the tool out and parks it: Z on most machines."),
    (
        Key::HomingPasses,
        "How many times homing touches each switch slowly. More passes help with switches that do not repeat well.",
    ),
    (
        Key::ParkingPullOut,
        "How far the tool is pulled out of the work slowly, with the spindle on, before it is parked.",
    ),
    (Key::ParkingPullOutRate, "Speed of the pull-out, and of the way back into the work."),
    (
        Key::ParkingTarget,
        "Where the parking axis goes, in machine coordinates. A tool that is beyond it is not parked.",
    ),
    (Key::ParkingFastRate, "Speed between the end of the pull-out and the parking place, both ways."),
    (
        Key::ToolSetterDepth,
        "How far below the height of G30 the tool setter may be ($918=2). A tool that does not touch it on that way ends with ALARM:5.",
    ),
    (Key::ToolSetterLocate, "Speed of the second touch of the tool setter, which is the one that counts."),
    (Key::ToolSetterSeek, "Speed of the first touch of the tool setter, all the way down from the height of G30."),
    (
        Key::SquaringShare,
        "How far one motor may go alone when homing squares an axis, as a share of its travel. More than that ends with ALARM:10.",
    ),
    (
        Key::SquaringLeast,
        "The least way that one motor may go alone when an axis is squared, where the share of its travel ($347) is smaller.",
    ),
    (
        Key::SquaringMost,
        "The longest way that one motor may go alone when an axis is squared, where the share of its travel ($347) is larger.",
    ),
    (
        Key::DoorSpindleDelay,
        "How long the spindle turns, after the door has been closed, before the coolant is switched on. It must be up to speed by then.",
    ),
    (
        Key::DoorCoolantDelay,
        "How long the coolant flows, after the door has been closed, before the tool goes back into the work.",
    ),
    (
        Key::SpinUp,
        "How long motion waits after the spindle was switched on or has another direction. Set it to the time that the spindle needs.",
    ),
    (
        Key::SpinDown,
        "How long motion waits after the spindle was switched off. Set it to the time that the spindle needs to come to rest.",
    ),
    (
        Key::Dialect,
        "Which words, settings and answers there are. Choose Grbl for a sender that refuses what Grbl does not have.",
    ),
    (
        Key::StopOnError,
        "A refused line ends the job: the machine brakes, moves that were accepted before it and have not been made are dropped, and it is locked until $X. With 0 the lines after it are carried out, as with Grbl, unless it has M6 and $918 is not 0.",
    ),
    (
        Key::TrustNeeded,
        "With homing on, G53, G28 and G30 are refused, and soft limits do not act, until the machine position is known. With 0 they take it as it is.",
    ),
    (Key::DoorFitted, "Whether the input of the safety door is looked at. Set it to 0 on a machine without a door."),
    (Key::Kinematics, "How motors move the axes. Choose CoreXY where two belts move X and Y together."),
    (Key::GangedAxis, "The axis that a second motor with pins of its own moves, such as both sides of a gantry."),
    (
        Key::GangedInvert,
        "Turns the second motor of the axis round, where it is mounted as a mirror image of the first.",
    ),
    (Key::GangedSwitch, "The second motor has a limit switch of its own: homing squares the axis with it."),
    (
        Key::LimitInvertEach,
        "Single limit inputs whose level is turned round against $5, where switches of both kinds are fitted.",
    ),
    (Key::ControlPullDown, "Gives these inputs a pull-down in place of the pull-up, for switches to the supply."),
    (Key::LimitPullDown, "Gives these inputs a pull-down in place of the pull-up, for switches to the supply."),
    (Key::ProbePullDown, "Gives the probe input a pull-down in place of the pull-up, for a probe to the supply."),
    (
        Key::ResetIsEmergencyStop,
        "The reset input is an emergency stop, which is latched until a reset. The button should cut the power of the motors, too.",
    ),
    (
        Key::EmergencyDriversOff,
        "Switches the motors off at an emergency stop or a driver fault. With 0 they hold, so that no axis drops.",
    ),
    (
        Key::HoldWithoutHost,
        "A link that ends in mid-job is a fault, and $928 says what is done. With 0 what was sent is finished.",
    ),
    (Key::AtSpeed, "An input tells that the spindle is up to speed, and at which level. Cuts wait for it."),
    (Key::AtSpeedWithin, "How long a spindle with an at-speed input ($915) may take. After that, ALARM:14."),
    (
        Key::CurveAcceleration,
        "How much of the acceleration of the axes a curve may take. Leave it at 100 if motors stall in small arcs; a higher value is faster there, as with Grbl.",
    ),
    (
        Key::ToolChange,
        "What M6 does: note which tool is in the spindle, or stop and wait until the tool is changed by hand. With 2 the tool goes to G30 for that, and is measured at a tool setter at G59.3; the machine has to be homed.",
    ),
    (Key::OptionalStop, "M1 pauses the job. With 0 it is passed over."),
    (
        Key::BlockDelete,
        "Lines that begin with a slash, or with their number and a slash, are skipped. With 0 they are carried out without it.",
    ),
    (Key::PeckClearance, "How far a drill goes back in G73, and how far above the ground its rapid ends in G83."),
    (
        Key::HostSilence,
        "How long the host may be silent in mid-job before $928 acts, for links on which a pulled cable is not seen. 0 does not watch it.",
    ),
    (Key::JogSilence, "How long the host may be silent during a jog before the jog ends. 0 does not watch it."),
    (
        Key::LimitReaction,
        "How the machine stops for a limit switch. Braking keeps the position, and needs room behind the switch.",
    ),
    (
        Key::EmergencyReaction,
        "How the machine stops for the emergency stop. Leave it at 0 unless the machine has been judged as a whole.",
    ),
    (
        Key::DriverReaction,
        "How the machine stops for a driver fault. The position is not trusted afterwards in any case.",
    ),
    (Key::SpindleReaction, "How the machine stops for a spindle that is not up to speed."),
    (
        Key::HostReaction,
        "What is done when the host is gone ($914) or silent ($922) in mid-job. 4 is a hold, with the spindle on, which ~ resumes.",
    ),
    (
        Key::SpeedLoss,
        "How long the spindle may be below its speed in mid-job before it is a fault, on a machine with an at-speed input ($915).",
    ),
    (
        Key::Axes,
        "How many axes the machine has. With 4 there is A, which turns: its words and places are degrees, and its settings are listed. It needs a board with four axes.",
    ),
    (
        Key::Baud,
        "At which rate the UART of a board listens from its next start (power, NRST) on; over USB it means nothing. With the hold and the start input both active at the start it is 115200.",
    ),
    (
        Key::ZeroAtPullOff,
        "Machine zero is where homing ends, the pull-off ($27) away from the switch, and not where the switch closes. Switch it on for jobs that go to machine zero, such as G28 G91 Z0. An axis homed to its negative end has positive coordinates then.",
    ),
];

/// Sentences for the settings that exist per axis, in the order of the controller's table.
const PER_AXIS: [(AxisKey, &str); AxisKey::COUNT] = [
    (
        AxisKey::HomingCycle,
        "Which axes home together in this cycle; then the next cycle follows. With 0 the cycle is left out.",
    ),
    (
        AxisKey::Resolution,
        "Steps of the motor for a millimetre: steps of a turn, times microsteps, by the way of a turn. Measure a long way to correct it.",
    ),
    (
        AxisKey::MaxRate,
        "The greatest speed of the axis, which is that of its rapids. Lower it if the motor stalls at speed.",
    ),
    (
        AxisKey::Acceleration,
        "How fast the axis gains and loses speed. Lower it if the motor stalls in starts and stops; a higher value shortens jobs.",
    ),
    (
        AxisKey::Travel,
        "How far the axis can go, from where its switch closes to the other end. Homing and soft limits use it.",
    ),
    (
        AxisKey::Backlash,
        "How far the motor turns after a reversal before the tool follows. Measure it with an indicator; 0 does not correct it.",
    ),
    (
        AxisKey::Jerk,
        "How fast the acceleration may change. A limit makes starts and stops softer and longer; 0 is none.",
    ),
];

/// Returns the sentence for a setting number; empty if the number does not exist.
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
