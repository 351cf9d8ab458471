//! `oxmill settings import`: settings of Grbl, grblHAL and FluidNC.

use super::{file, json, oxmill, run, text};
use serde_json::Value;
use std::collections::BTreeMap;
use std::fs;
use std::io::Write;
use std::path::Path;
use std::process::Stdio;

/// A 3018 with Grbl 1.1, as copied from a terminal.
const GRBL: &str = "$$\r\n$0=10\r\n$1=25\r\n$5=1\r\n$10=3\r\n$11=0.010\r\n$13=0\r\n$20=1\r\n$22=1 (homing cycle)\r\n\
                    $23=3\r\n$26=250\r\n$30=10000\r\n$32=0\r\n$100=800.000\r\n$101=800.000\r\n$102=800.000\r\n\
                    $110=2000.000\r\n$120=50.000\r\n$130=290.000\r\nok\r\n<Idle|MPos:0.000,0.000,0.000|FS:0,0>\r\n";

/// A router with grblHAL.
const GRBLHAL: &str = "GrblHAL 1.1f ['$' or '$HELP' for help]\n$0=5.0\n$4=7\n$5=2\n$7=0\n$10=511\n$13=0\n$14=6\n$15=2\n\
                       $20=1\n$21=3\n$22=91\n$28=0.100\n$32=2\n$44=4\n$45=3\n$46=0\n$47=0\n$100=200.00000\n\
                       $160=0.02000\n$220=12\n$341=0\n$394=4.0\n$481=0\n";

/// A CoreXY machine whose Z has two motors.
const FLUIDNC: &str = "name: Made up\nboard: 6 Pack: v2\narc_tolerance_mm: 0.004\nstepping:\n  engine: RMT\n  \
                       idle_ms: 255\n  pulse_us: 4\nkinematics:\n  CoreXY:\naxes:\n  \
                       shared_stepper_disable_pin: gpio.13:low\n  x:\n    steps_per_mm: 80.000\n    \
                       max_rate_mm_per_min: 6000 # fast\n    soft_limits: true\n    homing:\n      cycle: 2\n      \
                       positive_direction: false\n      mpos_mm: 0\n      feed_mm_per_min: 150\n    motor0:\n      \
                       limit_neg_pin: gpio.36:low:pu\n      hard_limits: true\n      pulloff_mm: 2.5\n      \
                       stepstick:\n        step_pin: gpio.12\n        direction_pin: gpio.14:low\n  y:\n    \
                       steps_per_mm: 80.000\n    homing:\n      cycle: 2\n      mpos_mm: 0.000\n      \
                       feed_mm_per_min: 160\n    motor1:\n      null_motor:\n  z:\n    steps_per_mm: 400\n    \
                       homing:\n      cycle: 1\n    motor0:\n      stepstick:\n        direction_pin: i2so.4\n    \
                       motor1:\n      limit_pos_pin: gpio.35\n      stepstick:\n        step_pin: i2so.6\n        \
                       direction_pin: i2so.7:low\n        ms3_pin: NO_PIN\nPWM:\n  pwm_hz: 5000\n  spinup_ms: 1500\n  \
                       speed_map: 0=0.000% 24000=100.000%\nmacros:\n  macro0: G0 X0\n";

/// Result of an import: the imported values by setting, and the entries that were left out, each with the reason.
struct Imported {
    what: String,
    values: BTreeMap<u64, f64>,
    left: BTreeMap<String, String>,
    status: Option<i32>,
}

fn import(name: &str, said: &str) -> Imported {
    let output = run(&["settings", "import", text(&file(name, said)), "--json"]);
    let result = json(&output);
    let list = |key: &str| result[key].as_array().expect("a list").clone();
    let word = |value: &Value| value.as_str().expect("a text").to_owned();
    let values: BTreeMap<_, _> = list("taken")
        .iter()
        .map(|taken| (taken["number"].as_u64().expect("a number"), taken["value"].as_f64().expect("a value")))
        .collect();
    assert_eq!(values.len(), list("taken").len(), "each number once");
    let left = list("left").iter().map(|left| (word(&left["text"]), word(&left["why"]))).collect();
    Imported { what: word(&result["what"]), values, left, status: output.status.code() }
}

fn values<const N: usize>(pairs: [(u64, f64); N]) -> BTreeMap<u64, f64> {
    pairs.into()
}

#[test]
fn a_dump_of_grbl_is_taken_as_it_is() {
    let imported = import("import_grbl.txt", GRBL);
    assert_eq!((imported.what.as_str(), imported.status, imported.left.len()), ("Grbl", Some(0), 0));
    assert_eq!(imported.values.len(), 18);
    for (number, value) in [(5, 1.0), (10, 3.0), (11, 0.01), (22, 1.0), (23, 3.0), (100, 800.0)] {
        assert_eq!(imported.values[&number], value, "${number}");
    }
}

/// A mask of grblHAL becomes the Oxmill settings that have the meaning of its bits. Bits without such a setting are
/// listed as left out.
#[test]
fn masks_of_grblhal_come_apart() {
    let imported = import("import_grblhal.txt", GRBLHAL);
    assert_eq!((imported.what.as_str(), imported.status), ("grblHAL", Some(1)));
    let expected = [
        (0, 5.0),
        (4, 1.0),
        (5, 0.0),
        (10, 3.0),
        (13, 0.0),
        (14, 6.0),
        (20, 1.0),
        (21, 1.0),
        (22, 1.0),
        (44, 4.0),
        (45, 3.0),
        (46, 0.0),
        (100, 200.0),
        (160, 0.02),
        (394, 4.0),
        (908, 2.0),
        (918, 1.0),
        (921, 0.1),
        (932, 1.0),
    ];
    assert_eq!(imported.values, values(expected));
    for (entry, why) in [
        ("$7=0", "PWM is off at S0"),
        ("$15=2", "in hardware"),
        ("$21=3", "sum 2: "),
        ("$22=91", "sum 16: Oxmill has no function for them"),
        ("$32=2", "no lathe mode"),
        ("$47=0", "three homing cycles"),
        // `$220` is a jerk in Oxmill; in grblHAL it belongs to a motor driver.
        ("$220=12", "set the driver itself"),
        ("$481=0", "a host sends ?"),
    ] {
        let found = imported.left.get(entry).unwrap_or_else(|| panic!("{entry} is taken"));
        assert!(found.contains(why), "{entry}: {found}");
    }
    assert_eq!(imported.left.len(), 8);
    // If all limit inputs are inverted, `$5=1` is enough and the mask `$908` stays 0. Values for a fourth axis put this
    // axis in use (`$930=4`).
    let four = import("import_four.txt", "$5=15\n$22=0\n$7=0\n$47=8\n$341=3\n$100=1\n$101=1\n$102=1\n$103=2\n$104=3\n");
    let expected =
        [(5, 1.0), (22, 0.0), (47, 8.0), (100, 1.0), (101, 1.0), (102, 1.0), (103, 2.0), (908, 0.0), (930, 4.0)];
    assert_eq!(four.values, values(expected));
    assert!(four.left["$104=3"].contains("no axis B or C") && four.left["$341=3"].contains("at G30"));
}

/// The import takes the values of an Oxmill dump unchanged. Exception: with `$900=3` the dump has grblHAL's masks, and
/// the import converts these to Oxmill's values.
#[test]
fn a_dump_of_oxmill_is_restored() {
    let mask = import("import_own.txt", "$5=1\n$10=511\n$22=207\n$900=3\n$932=0\n");
    assert_eq!((mask.what.as_str(), mask.status), ("Oxmill", Some(0)));
    assert_eq!(mask.values, values([(5, 1.0), (10, 3.0), (22, 1.0), (900, 3.0), (932, 0.0)]));
    let said = run(&["settings", "import", text(&file("import_own.txt", "$22=207\n$900=1\n"))]);
    let said = String::from_utf8_lossy(&said.stdout).into_owned();
    assert!(said.starts_with("Oxmill: 1 setting, 1 entry is not taken\n") && said.contains("Values of $22"), "{said}");
}

#[test]
fn a_configuration_of_fluidnc_becomes_settings() {
    let imported = import("import.yaml", FLUIDNC);
    assert_eq!((imported.what.as_str(), imported.status), ("FluidNC", Some(1)));
    let expected = [
        (0, 4.0),
        (1, 255.0),
        (2, 0.0),
        (3, 1.0),
        (4, 1.0),
        (12, 0.004),
        (20, 1.0),
        (21, 1.0),
        (22, 1.0),
        (23, 1.0),
        (24, 150.0),
        (27, 2.5),
        (30, 24000.0),
        (31, 0.0),
        (33, 5000.0),
        (44, 4.0),
        (45, 3.0),
        (46, 0.0),
        (100, 80.0),
        (101, 80.0),
        (102, 400.0),
        (110, 6000.0),
        (394, 1.5),
        (904, 1.0),
        (905, 3.0),
        (906, 1.0),
        (907, 1.0),
        (932, 1.0),
    ];
    assert_eq!(imported.values, values(expected));
    for (entry, why) in [
        ("board: 6 Pack: v2", "a description"),
        ("stepping/engine: RMT", "timers"),
        ("axes/x/motor0/limit_neg_pin: gpio.36:low:pu", "$5 and $908"),
        ("axes/y/homing/feed_mm_per_min: 160", "$24 is that of the first"),
        ("macros/macro0: G0 X0", "$M0="),
    ] {
        let found = imported.left.get(entry).unwrap_or_else(|| panic!("{entry}: {:?}", imported.left.keys()));
        assert!(found.contains(why), "{entry}: {found}");
    }
}

/// If the configuration has two settings that exclude each other, the import leaves one out: with both, the board would
/// lock motion.
#[test]
fn a_gantry_of_fluidnc_needs_cartesian_axes() {
    let gantry = "axes:\n  y:\n    steps_per_mm: 80\n    soft_limits: true\n    motor1:\n      step_pin: gpio.1\n";
    let imported = import("import_gantry.yaml", gantry);
    assert_eq!(
        imported.values,
        values([(20, 0.0), (101, 80.0), (905, 2.0)]).into_iter().filter(|(n, _)| *n != 20).collect()
    );
    assert!(imported.left["axes/y/soft_limits: true"].contains("need homing"));
    let imported = import("import_core.yaml", &format!("{gantry}kinematics:\n  corexy:\n"));
    assert_eq!(imported.values, values([(101, 80.0), (904, 1.0)]));
    assert!(imported.left["axes/y/motor1/step_pin: gpio.1"].contains("CoreXY moves X and Y"));
}

#[test]
fn wrong_values_are_left_with_the_reason() {
    let imported = import(
        "import_wrong.txt",
        "$1=300\n$11=-1\n$100=80\n$100=80.0\n$110=500\n$110=600\n$111=1,5\n$112=\n$200=1e2\n$99999=1\n$N0=G54\n110=5\n",
    );
    assert_eq!((imported.status, imported.values), (Some(1), values([(100, 80.0), (110, 600.0)])));
    for (entry, why) in [
        ("$1=300", "0 to 255"),
        ("$11=-1", "must not be negative"),
        ("$110=500", "line 6 sets $110 again"),
        ("$111=1,5", "no number"),
        ("$112=", "no number"),
        ("$200=1e2", "no number"),
        ("$99999=1", "no such setting"),
        ("$N0=G54", "not of the form $n=v"),
        ("110=5", "not of the form $n=v"),
    ] {
        assert!(imported.left.get(entry).is_some_and(|found| found.contains(why)), "{entry}: {:?}", imported.left);
    }
    let imported =
        import("import_wrong.yaml", "axes:\n  x:\n    steps_per_mm: many\n    homing\n  b:\n    max_travel_mm: 3\n");
    assert_eq!(imported.left["axes/x/steps_per_mm: many"], "no number");
    assert_eq!(imported.left["homing"], "not of the form key: value");
    assert_eq!(imported.left["axes/b/max_travel_mm: 3"], "no axis B or C");
}

/// The written file is accepted by `--settings`, in each dialect, and read back as the same settings.
#[test]
fn the_settings_are_written_for_a_board() {
    let job = file("import_job.nc", "G21\n");
    for (name, said, dialects) in [
        ("grbl", GRBL, &["grbl", "oxmill", "grblhal"][..]),
        ("grblhal", GRBLHAL, &["oxmill", "grblhal"]),
        ("fluidnc", FLUIDNC, &["oxmill", "grblhal"]),
    ] {
        let out = file(&format!("import_{name}_out.txt"), "an older file, which is longer than the settings\n");
        let input = file(&format!("import_{name}_in.txt"), said);
        run(&["settings", "import", text(&input), "-o", text(&out)]);
        let written = fs::read_to_string(&out).expect("the settings");
        assert!(written.lines().all(|line| line.starts_with('$')), "{written}");
        let place = |line: &str| written.lines().position(|other| other == line);
        assert!(place("$22=1") < place("$20=1"), "{written}");
        for dialect in dialects {
            let output = run(&["check", text(&job), "--dialect", dialect, "--settings", text(&out)]);
            // Status 2 means that a setting was rejected. Any other status is allowed, because the job can end with an
            // alarm: in the simulator an inverted switch that is not wired counts as active.
            let refused = String::from_utf8_lossy(&output.stderr);
            assert!(output.status.code() != Some(2) && refused.is_empty(), "{name} {dialect}: {refused}");
        }
    }
    // The import does not overwrite its input. If it finds no setting that it can use, it writes no file.
    let input = file("import_same.txt", GRBL);
    assert_eq!(run(&["settings", "import", text(&input), "-o", text(&input)]).status.code(), Some(2));
    assert_eq!(fs::read_to_string(&input).expect("the dump"), GRBL);
    let (input, out) = (file("import_none.txt", "$99999=1\n"), file("import_kept.txt", "kept"));
    assert_eq!(run(&["settings", "import", text(&input), "-o", text(&out)]).status.code(), Some(1));
    assert_eq!(fs::read_to_string(&out).expect("a file"), "kept");
}

#[test]
fn what_is_no_set_of_settings_is_refused() {
    let smoothie = "default_feed_rate 4000 # mm/min\nalpha_steps_per_mm 80\n";
    for (name, said, why) in [
        ("empty", "", "it is empty"),
        ("binary", "\0\u{1}\u{2}$100=80\n", "it is a binary file"),
        ("marlin", "M92 X80.00 Y80.00\nM203 X500.00\n", "neither the output of $$"),
        ("smoothie", smoothie, "neither the output of $$"),
        ("job", "G21 G90\nG1 X1 F100\n", "neither the output of $$"),
        ("tab", "axes:\n\tx:\n\t\tsteps_per_mm: 80\n", "line 2: a tab"),
    ] {
        let output = run(&["settings", "import", text(&file(&format!("import_not_{name}"), said)), "--json"]);
        let error = String::from_utf8_lossy(&output.stderr);
        assert!(output.status.code() == Some(2) && output.stdout.is_empty() && error.contains(why), "{name}: {error}");
    }
    assert_eq!(run(&["settings", "import", "no/such/file"]).status.code(), Some(2));
    assert_eq!(run(&["settings"]).status.code(), Some(2));
}

#[test]
fn a_dump_may_come_by_standard_input() {
    let mut child = oxmill(&["settings", "import", "-"]).stdin(Stdio::piped()).spawn().expect("a start");
    child.stdin.take().expect("a pipe").write_all(b"\xEF\xBB\xBF$100=80.500\r\r\n$102=\x1B[31m\n").expect("a listener");
    let output = child.wait_with_output().expect("an end");
    let said = String::from_utf8_lossy(&output.stdout);
    assert_eq!(output.status.code(), Some(1));
    assert!(said.contains("  $100=80.500  $100=80.5") && said.contains("X-axis resolution, steps/mm"), "{said}");
    assert!(!said.contains('\u{1B}') && said.contains("$102=?[31m"), "{said}");
}

#[test]
fn the_page_shows_what_is_printed() {
    let page = fs::read_to_string(Path::new(env!("CARGO_MANIFEST_DIR")).join("docs/coming-from.md")).expect("the page");
    let shown = page.split("```text\n").nth(1).and_then(|rest| rest.split("```").next()).expect("an example");
    let mut entries: Vec<&str> = shown.lines().skip(1).filter_map(|line| line.split_whitespace().next()).collect();
    entries.dedup();
    let dump = format!("GrblHAL 1.1f ['$' or '$HELP' for help]\n{}\n", entries.join("\n"));
    let printed = run(&["settings", "import", text(&file("import_page.txt", &dump))]);
    assert_eq!(String::from_utf8_lossy(&printed.stdout), shown);
}
