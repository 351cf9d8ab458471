//! `docs/settings.md` is made from the table of settings; this holds the two together.

use oxmill_controller::settings::{Entry, Kind, PER_AXIS, SCALARS, Settings};
use std::fmt::Write;

const HEAD: &str = "# Settings

`$$` lists them, `$n=v` sets one. A setting that is legal alone is stored, as senders restore them one by one; if the *set* cannot be run
(no steps/mm, rate or acceleration; a jerk between 0 and 1; a rate times steps/mm beyond the step rate that the
board can keep with the pulse `$0`, see [what it costs](how-it-works.md#what-it-costs); a second motor that the board has no
pins for), motion is locked until it is mended: a message after the `ok` names the setting, and another one the first time that a line is refused
for it with `error:9`. Nothing is clamped silently.

When stored settings were damaged (flash that has lost a bit), the welcome line is followed by a message, and the machine is locked until they have been
listed with `$$` and, 2 s later or more, confirmed with `$X`: [the settings log](how-it-works.md#the-settings-log).

In the dialect of Grbl (`$900=0`) `$$` lists Grbl's 34 numbers only, and the answer to a setting is `ok` alone. Clients that refuse what Grbl does not
have need this dialect. This page is made from the table in `src/controller/settings.rs`.

| $ | setting | unit | values | default | Grbl 1.1 |
|---|---|---|---|---|---|
";

fn row(page: &mut String, number: &str, entry: &Entry, default: &str) {
    let values = match entry.kind {
        Kind::Whole(least, greatest) => format!("{least} to {greatest}"),
        Kind::Switch => "0 or 1".into(),
        Kind::Mask(bits) => {
            let bits = (0..32).filter(|bit| bits >> bit & 1 != 0).map(|bit| (1_u32 << bit).to_string());
            format!("sum of {}", bits.collect::<Vec<_>>().join(", "))
        }
        Kind::Real | Kind::Speed => "0 and above".into(),
        Kind::Place => "any".into(),
        Kind::Axes => "axes of the machine".into(),
    };
    let known = if entry.grbl { "yes" } else { "" };
    let _ = writeln!(page, "| {number} | {} | {} | {values} | {default} | {known} |", entry.name, entry.unit);
}

#[test]
fn the_page_is_the_table() {
    let mut page = HEAD.to_string();
    for entry in SCALARS {
        row(&mut page, &entry.number.to_string(), &entry, &entry.default.to_string());
    }
    for entry in PER_AXIS {
        let numbers = [0, 1, 2].map(|axis| entry.number + axis);
        let mut defaults: Vec<String> =
            numbers.iter().map(|n| Settings::<3>::default().by_number(*n).unwrap_or(f32::NAN).to_string()).collect();
        defaults.dedup();
        row(&mut page, &numbers.map(|n| n.to_string()).join(", "), &entry, &defaults.join(", "));
    }
    let path = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("docs/settings.md");
    if std::env::var_os("OXMILL_WRITE_DOCS").is_some() {
        std::fs::write(&path, &page).expect("docs/settings.md is written");
    }
    let written = std::fs::read_to_string(&path).expect("docs/settings.md");
    assert!(written == page, "docs/settings.md is out of date: run this test with OXMILL_WRITE_DOCS=1");
}
