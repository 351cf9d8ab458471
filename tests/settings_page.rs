//! `docs/settings.md` is generated from the table of settings; this test compares the two.

use oxmill_controller::protocol::descriptions;
use oxmill_controller::protocol::text::Text;
use oxmill_controller::settings::{
    Description, Entry, PER_AXIS, PER_AXIS_DESCRIPTIONS, SCALAR_DESCRIPTIONS, SCALARS, Settings,
};
use oxmill_simulator::explain;
use std::fmt::Write;

const HEAD: &str = "# Settings

After this page you know each setting, what it does, its unit, its range and its default, and when a set of them is refused. `$$` lists them, `$n=v` sets one. A setting that is legal alone is stored, as senders restore them one by one; if the *set* cannot be run, motion is locked until it is mended: a message after
the `ok` names the setting, and another one the first time that a line is refused for it with `error:9`. A door that opens then parks nothing (`$41`). No rate or acceleration is clamped silently. What cannot be run:

* steps/mm outside of 0.001 to 40,000; a rate outside of 0.00003 to 6,000,000 mm/min, that of homing (`$22=1`) and of parking (`$41=1` besides) among them; an acceleration outside of 0.001 to 10,000,000 mm/s²; a jerk between 0 and 1 or above 10,000,000,000
* a rate times steps/mm (with CoreXY the rates of X and Y added up) beyond the step rate that the board can keep with the pulse `$0` ([what it costs](cost.md#step-rates)), or a stored pulse shorter than the board makes
* a backlash of more than 10,000 steps, `$11` above 1000, `$12` below 0.0001
* soft limits (`$20`) without homing (`$22`); with parking a parking axis (`$42`) other than X, Y and Z; more axes (`$930`) than the board has
* a second motor (`$905`) that the board has no pins for, of X or Y with CoreXY, or beside the axis A; an at-speed input (`$915`) that the board has no pin for

Where only whole numbers count, a fraction is refused (`$1=25.5` is `error:52`); the dialect of Grbl cuts it off, as Grbl does. *0 or 1* takes nothing else; in the dialect of Grbl any number from 1 to 255 is 1. *Sum of*: `$2`, `$3`, `$10` and `$23` take
any sum up to 255, and bits that the table does not name do nothing; other masks refuse them, but for the axis A where there is one. A value below 0 is `error:4` (but for `$58`), another one out of the range `error:52` behind a message with the values (without it on the Black Pill F401; in the dialect of Grbl `error:3` alone), of `$0` `error:6` (`error:3` if it is no whole number of tenths).

After another `$3`, `$23`, `$100` to `$103`, `$904`, `$930` or `$932`, places have other names than homing gave them: with `$22=1` the machine is to be homed again. So it is after another travel (`$130` to `$133`) of an axis that `$23` names and, with `$932=1`, after another `$27`. Until then G53, G28 and G30 are
refused and soft limits do not act (`$902`).

When stored settings were damaged (flash that has lost a bit), the welcome line is followed by a message, and the machine is locked until they have been
listed with `$$` and, 2 s later or more, confirmed with `$X`: [the settings log](storage.md#the-settings-log). The same holds for a stored value out
of its range, as other firmware may have stored it: the setting has its default.

In the dialect of Grbl (`$900=0`) `$$` lists Grbl's 34 numbers only, and the answer to a setting is `ok` alone. Clients that refuse what Grbl does not
have need this dialect. With `$900=3` `$10` and `$22` are [masks of grblHAL](senders.md#gsender-and-iosender-with-9003).

Senders can ask for all of this: `$ES` lists the settings with group, name, unit, type, choices and range, `$EG` their groups, `$EE` and `$EA` the texts of
errors and alarms, in the formats of grblHAL; `$ESG` and `$ESH` are the settings as a table with commas or tabs; `$I+` adds the axes and what can be asked
for to `$I`. The Black Pill F401 has no room for the texts (`error:125`), and the dialect of Grbl knows none of these commands.

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
