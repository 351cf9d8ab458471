//! All recorded exchanges that this controller answers differently, with the reasons.

/// A record to which this controller gives another answer than the recorded one. `group`: name of the recording's
/// file without its extension. `n`: number of the record in the file.
pub struct Difference {
    pub group: &'static str,
    pub n: u64,
    /// This controller's answers; `None` if they depend on timing and are not compared.
    pub answers: Option<&'static [&'static str]>,
    #[allow(dead_code, reason = "for the reader")]
    pub why: &'static str,
}

/// Returns the answer lines to `$#` of a machine on which only G92 has been set.
const fn parameters(g92: &'static str) -> [&'static str; 12] {
    [
        "[G54:0.000,0.000,0.000]",
        "[G55:0.000,0.000,0.000]",
        "[G56:0.000,0.000,0.000]",
        "[G57:0.000,0.000,0.000]",
        "[G58:0.000,0.000,0.000]",
        "[G59:0.000,0.000,0.000]",
        "[G28:0.000,0.000,0.000]",
        "[G30:0.000,0.000,0.000]",
        g92,
        "[TLO:0.000]",
        "[PRB:0.000,0.000,0.000:0]",
        "ok",
    ]
}

const fn differs(group: &'static str, n: u64, answers: &'static [&'static str], why: &'static str) -> Difference {
    Difference { group, n, answers: Some(answers), why }
}

const fn at_its_time(group: &'static str, n: u64, why: &'static str) -> Difference {
    Difference { group, n, answers: None, why }
}

const CHECKED: &str =
    "whole-number settings and line numbers of $N are checked; Grbl cuts them to 8 bits or writes beyond its area";
const PWM: &str = "$33, the frequency of the PWM, is a setting here and a constant in Grbl";
const NUMBER: &str = "a setting that Grbl does not have; the reset input is inverted and so active at once";
const HELD: &str =
    "the recording host's way out of a hold: the line is `!`, which holds here until the next `~` or reset";
const REACH: &str = "targets beyond 50 m are refused, so that all arithmetic stays exact";
const EXACT: &str = "coordinates are integers of 0.1 nm; Grbl's single precision prints an artefact";
const ALWAYS: &str = "`?` is answered always; Grbl is deaf in a critical alarm and while homing";
const AT_ONCE: &str = "Grbl waits half a second after `ALARM`, and the recording host had stopped listening";
const UNSTUCK: &str =
    "a build without single-axis homing gets stuck in Home at `$HX` until a reset; here it is refused and that is all";
const BY_HAND: &str =
    "when the hand moved the probe pin within the recording is not known: here it moved before the end of travel";
const TRUE_PLACE: &str = "Grbl counts from zero while homing; here the position stays true when homing is broken off";
const STOPPED: &str = "the machine was stopped by the hand, at a moment that is the recording host's";

/// Records whose position depends on the moment at which the recording host stopped a move.
const STANDS_WHERE_STOPPED: &[(&str, u64)] = &[
    ("15_jog", 55),
    ("15_jog", 60),
    ("15_jog", 66),
    ("15_jog", 73),
    ("17_hold_resume", 40),
    ("17_hold_resume", 47),
    ("18_door", 14),
    ("18_door", 16),
    ("18_door", 18),
    ("18_door", 33),
    ("18_door", 35),
    ("18_door", 37),
    ("18_door", 46),
    ("23_laser", 23),
    ("25_probe_contact", 14),
    ("25_probe_contact", 19),
    ("25_probe_contact", 27),
    ("25_probe_contact", 36),
    ("26_pins", 23),
];

/// Returns whether the position in a record depends on the moment at which the recording host stopped a move.
pub fn is_stopped(group: &str, n: u64) -> bool {
    STANDS_WHERE_STOPPED.contains(&(group, n))
}

pub const DIFFERENCES: &[Difference] = &[
    differs("02_settings", 10, &["error:3"], CHECKED),
    differs("02_settings", 89, &["ok", "Grbl 1.1h ['$' for help]"], NUMBER),
    differs("02_settings", 91, &["ok"], PWM),
    differs("03_startup_build", 9, &["error:3"], CHECKED),
    differs("03_startup_build", 11, &["error:3"], CHECKED),
    differs("07_modal_bad", 104, &[], HELD),
    differs("07_modal_bad", 105, &[], HELD),
    differs("07_modal_bad", 106, &[], HELD),
    differs("07_modal_bad", 107, &[], HELD),
    differs("07_modal_bad", 108, &[], HELD),
    differs("07_modal_bad", 109, &[], HELD),
    differs("09_arcs", 83, &["error:33"], REACH),
    differs("12_numbers", 25, &parameters("[G92:-123456780000.000,0.000,0.000]"), EXACT),
    differs("12_numbers", 27, &parameters("[G92:-99999999.000,0.000,0.000]"), EXACT),
    differs("12_numbers", 35, &parameters("[G92:-0.002,0.000,0.000]"), EXACT),
    differs("15_jog", 12, &["<Idle|MPos:0.256,0.000,0.000|FS:0,0>"], EXACT),
    at_its_time("15_jog", 68, STOPPED),
    at_its_time("15_jog", 75, STOPPED),
    at_its_time("16_soft_limits", 14, ALWAYS),
    at_its_time("17_hold_resume", 7, STOPPED),
    at_its_time("17_hold_resume", 10, STOPPED),
    at_its_time("25_probe_contact", 22, BY_HAND),
    at_its_time("25_probe_contact", 24, BY_HAND),
    at_its_time("25_probe_contact", 25, BY_HAND),
    differs("26_pins", 18, &["ALARM:1", "[MSG:Reset to continue]"], AT_ONCE),
    at_its_time("26_pins", 20, ALWAYS),
    differs("26_pins", 46, &["ALARM:3", "Grbl 1.1h ['$' for help]", "[MSG:'$H'|'$X' to unlock]"], AT_ONCE),
    at_its_time("26_pins", 48, AT_ONCE),
    at_its_time("26_pins", 53, STOPPED),
    differs("27_homing_ok", 37, &["<Idle|MPos:-1.000,-1.000,-1.000|FS:0,0|Ov:100,100,100>"], UNSTUCK),
    differs("27_homing_ok", 39, &[">G20:ok", "ok"], UNSTUCK),
    differs("27_homing_ok", 42, &["ALARM:3", "Grbl 1.1h ['$' for help]", "[MSG:'$H'|'$X' to unlock]"], UNSTUCK),
    differs("27_homing_ok", 43, &["<Alarm|MPos:-0.488,-1.000,-1.000|FS:0,0|WCO:0.000,0.000,0.000>"], UNSTUCK),
    differs("27_homing_ok", 45, &["<Idle|MPos:-0.488,-1.000,-1.000|FS:0,0|Ov:100,100,100>"], UNSTUCK),
    differs("27_homing_ok", 52, &["<Alarm|MPos:-0.488,-1.000,-1.000|FS:0,0|WCO:0.000,0.000,0.000>"], UNSTUCK),
    at_its_time("27_homing_ok", 47, ALWAYS),
    at_its_time("28_homing_fail", 14, ALWAYS),
    at_its_time("28_homing_fail", 21, TRUE_PLACE),
    differs(
        "29_laser_spindle_reports",
        18,
        &["<Idle|MPos:0.000,0.000,0.000|FS:0,1|WCO:0.000,0.000,0.000>"],
        "the speed is worked out of the finer power of 16 bits, not of 8",
    ),
    differs(
        "31_blank_eeprom",
        0,
        &["Grbl 1.1h ['$' for help]"],
        "a blank store is a new controller and no fault: settings are never lost to a checksum",
    ),
];
