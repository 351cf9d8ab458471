//! Checks that `docs/settings.md` is what the table of settings generates. With `OXMILL_WRITE_DOCS=1` the test writes
//! the page.

use oxmill_controller::protocol::descriptions;
use oxmill_controller::protocol::text::Text;
use oxmill_controller::settings::{
    Description, Entry, PER_AXIS, PER_AXIS_DESCRIPTIONS, SCALAR_DESCRIPTIONS, SCALARS, Settings,
};
use oxmill_simulator::explain;
use std::fmt::Write;

const HEAD: &str = "# Settings

After this page you know each setting, its effect, unit, range and default, and which values lock motion. `$$` lists the settings, `$n=v` sets one. Senders restore settings one by one, so the firmware stores each value that is in range. If the machine cannot run with the stored values, motion is locked until you correct them. A message names the setting after
the `ok`, and again before the first `error:9` of a rejected line. While motion is locked, opening the door does not park the tool (`$41`). No rate or acceleration is clamped silently. These settings lock motion:

* steps/mm outside 0.001 to 40,000
* a rate outside 0.00003 to 6,000,000 mm/min, also a rate of homing (if `$22=1`) or of parking (if `$22=1` and `$41=1`)
* an acceleration outside 0.001 to 10,000,000 mm/s²
* a jerk between 0 and 1 or above 10,000,000,000 mm/s³
* a rate times steps/mm (with CoreXY the sum of the rates of X and Y) above the board's maximum step rate for the pulse `$0` ([what it costs](cost.md#step-rates))
* a stored pulse shorter than the board's minimum
* a backlash of more than 10,000 steps, `$11` above 1000, `$12` below 0.0001
* soft limits (`$20`) without homing (`$22`)
* with parking (`$22=1` and `$41=1`), a parking axis (`$42`) other than X, Y or Z
* more axes (`$930`) than the board has
* a second motor (`$905`) on a board without pins for this motor, for X or Y with CoreXY, or together with the axis A
* an at-speed input (`$915`) on a board without a pin for this input

A setting of whole numbers rejects a fraction (`$1=25.5` is `error:52`). In the dialect of Grbl the setting drops the fraction, as Grbl does. A setting with *0 or 1* in the table rejects all other numbers. In the dialect of Grbl any number from 1 to 255 means 1. A setting with *sum of* is a mask of bits. The masks `$2`, `$3`, `$10` and `$23` accept
any sum up to 255, and bits that the table does not name have no effect. All other masks reject bits that the table does not name, except the bit of the axis A on a board that has this axis.

A value below 0 is `error:4` (except for `$58`). Any other value out of range is `error:52`, after a message with the allowed values. The Black Pill F401 omits the message. The dialect of Grbl answers only `error:3`. A `$0` out of range is `error:6`. A `$0` that is no whole number of tenths is `error:3`.

After a change of one of the settings below, positions no longer match the homed coordinates. If `$22=1`, home again. Until you have homed, G53, G28 and G30 are rejected and soft limits do not act (`$902`):

* `$3`, `$23`, `$100` to `$103`, `$904`, `$930`, `$932`
* the travel (`$130` to `$133`) of an axis that `$23` names
* `$27`, if `$932=1`

If stored settings are damaged (for example flash has lost a bit), a message follows the welcome line, and the machine is locked. List the settings with `$$`,
and confirm them with `$X` at least 2 s later ([the settings log](storage.md#the-settings-log)). A stored value out of range, for example from other firmware, has the same
effects, and its setting then has the default.

In the dialect of Grbl (`$900=0`), `$$` lists only Grbl's 34 numbers, and the answer to a setting is `ok` without a message. Senders that reject numbers
unknown to Grbl need this dialect. With `$900=3`, `$10` and `$22` are [masks of grblHAL](senders.md#gsender-and-iosender-with-9003).

Senders can request lists in the formats of grblHAL. `$ES` lists the settings with group, name, unit, type, choices and range. `$EG` lists the groups of settings. `$EE` and `$EA` list the texts of
errors and alarms. `$ESG` lists the settings separated by commas, `$ESH` lists them separated by tabs. `$I+` adds the axes and the available
options to `$I`. The Black Pill F401 has no room for these lists (`error:125`), and the dialect of Grbl has none of these commands.

This page is made from the table in `src/controller/settings/table.rs` and the sentences in `src/simulator/explain.rs`.

| $ | setting | what it does | unit | values | default | Grbl 1.1 |
|---|---|---|---|---|---|---|
";

fn row(page: &mut String, number: &str, (entry, description): (&Entry, &Description), default: &str) {
    let mut values = Text::new();
    descriptions::values(&mut values, entry, description);
    let values = std::str::from_utf8(&values).expect("text");
    let known = if entry.grbl { "yes" } else { "" };
    let _ = writeln!(
        page,
        "| {number} | {} | {} | {} | {values} | {default} | {known} |",
        description.name,
        explain::setting(entry.number),
        description.unit
    );
}

#[test]
fn the_page_is_the_table() {
    let mut page = HEAD.to_string();
    for (entry, description) in SCALARS.iter().zip(&SCALAR_DESCRIPTIONS) {
        row(&mut page, &entry.number.to_string(), (entry, description), &entry.default.to_string());
    }
    for (entry, description) in PER_AXIS.iter().zip(&PER_AXIS_DESCRIPTIONS) {
        let numbers = [0, 1, 2].map(|axis| entry.number + axis);
        let mut defaults: Vec<String> =
            numbers.iter().map(|n| Settings::<3>::default().by_number(*n).unwrap_or(f32::NAN).to_string()).collect();
        defaults.dedup();
        row(&mut page, &numbers.map(|n| n.to_string()).join(", "), (entry, description), &defaults.join(", "));
    }
    let path = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("docs/settings.md");
    if std::env::var_os("OXMILL_WRITE_DOCS").is_some() {
        std::fs::write(&path, &page).expect("docs/settings.md is written");
    }
    let written = std::fs::read_to_string(&path).expect("docs/settings.md");
    assert!(written == page, "docs/settings.md is out of date: run this test with OXMILL_WRITE_DOCS=1");
}
