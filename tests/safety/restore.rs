//! Tests that a sender may restore a whole set of settings in any order. If the machine cannot run with the settings,
//! motion is locked, and a message names a wrong setting.

use super::bench::{Bench, locking};
use oxmill_controller::settings::{Kind, PER_AXIS, SCALARS};
use oxmill_test_support::Random;
use std::collections::BTreeMap;

/// Maps the number of each setting that `$$` lists to its value in thousandths.
type Set = BTreeMap<u16, i64>;

fn text(thousandths: i64) -> String {
    let sign = if thousandths < 0 { "-" } else { "" };
    format!("{sign}{}.{:03}", thousandths.abs() / 1000, thousandths.abs() % 1000)
}

/// Returns a random value that is valid for a kind of setting, in thousandths.
fn any_value(random: &mut Random, kind: Kind) -> i64 {
    match kind {
        Kind::Whole(least, greatest) => {
            1000 * (i64::from(least) + random.below(u64::from(greatest - least).min(300) + 1) as i64)
        }
        Kind::Tenths(least, greatest) => {
            100 * (i64::from(least) + random.below(u64::from(greatest - least).min(300) + 1) as i64)
        }
        Kind::Switch => 1000 * random.below(2) as i64,
        Kind::Mask(bits) => 1000 * (random.below(512) as i64 & i64::from(bits)),
        Kind::Speed => 1000 * random.below(30_000) as i64,
        Kind::Place => random.below(40_000) as i64 - 30_000,
        _ => random.below(20_000) as i64,
    }
}

/// Returns a set of settings in which every value is random. The machine can run with most such sets.
fn any_set(random: &mut Random, listed: &Set) -> Set {
    let mut set = listed.clone();
    for entry in SCALARS {
        // Keep the dialect (`$900`): Grbl's dialect accepts `$20=1` only after `$22=1`, as Grbl does. Keep `$14`
        // (inverted inputs) and `$903` (safety door): other values could make a control input or the door active all
        // the time.
        if ![14, 900, 903].contains(&entry.number) && set.contains_key(&entry.number) {
            set.insert(entry.number, any_value(random, entry.kind));
        }
    }
    for entry in PER_AXIS {
        for number in entry.number..entry.number + 3 {
            let value = match entry.number {
                100 => 1000 + random.below(400_000) as i64,
                110 => 1000 + random.below(9_000_000) as i64,
                120 => 1000 + random.below(3_000_000) as i64,
                130 => 1000 + random.below(900_000) as i64,
                _ => any_value(random, entry.kind) % 8000 / 1000 * 1000,
            };
            set.insert(number, value);
        }
    }
    // A pulse (`$0`) of 1 to 30.9 us, so that a usable step rate remains. No limit switches are wired, so limit inputs
    // are not inverted (`$5`) and hard limits are off (`$21`).
    set.insert(0, 100 * (10 + random.below(300) as i64));
    set.insert(5, 0);
    set.insert(21, 0);
    // At most four axes: no machine has more.
    set.insert(930, 1000 * (3 + random.below(2) as i64));
    set
}

fn listing(bench: &mut Bench) -> Vec<String> {
    let mut lines = bench.ask("$$");
    assert_eq!(lines.pop().as_deref(), Some("ok"));
    lines
}

fn read(listing: &[String]) -> Set {
    listing
        .iter()
        .map(|line| {
            let (number, value) = line.strip_prefix('$').and_then(|l| l.split_once('=')).expect("a setting");
            let value: f64 = value.parse().expect("a value");
            (number.parse().expect("a number"), (value * 1000.0).round() as i64)
        })
        .collect()
}

/// Sends settings one by one and checks the lock messages. A lock message must name another setting than the lock
/// message before, or else the setting that was just sent.
fn send_all(bench: &mut Bench, lines: &[String]) {
    let mut named = None;
    for line in lines {
        let locked = bench.set(line);
        let own = locked.as_ref().is_some_and(|name| line.starts_with(&format!("{name}=")));
        assert!(own || locked.is_none() || locked != named, "{line}: {locked:?} again");
        // A setting that affects the step rate can make the set usable for a while. If the set becomes unusable again,
        // the lock message may name the same setting as before.
        let number = line.trim_start_matches('$').split('=').next().and_then(|n| n.parse::<u32>().ok());
        let mends = matches!(number, Some(0 | 29 | 100..=102 | 110..=112 | 904 | 905));
        named = if mends { locked } else { locked.or(named) };
    }
}

fn shuffle<T>(random: &mut Random, items: &mut [T]) {
    for index in (1..items.len()).rev() {
        items.swap(index, random.below(index as u64 + 1) as usize);
    }
}

/// Returns the setting that locks motion, if any. The first move is refused with a message that names the setting,
/// later moves only with the error.
fn locked_by(bench: &mut Bench) -> Option<String> {
    let place = bench.place();
    let said = bench.ask("$J=G91 X0 F100");
    match said.as_slice() {
        [ok] if ok == "ok" => None,
        [message, error] if error == "error:9" => {
            assert_eq!(bench.ask("$J=G91 X0 F100"), ["error:9"]);
            assert_eq!(bench.place(), place);
            Some(locking(message))
        }
        _ => panic!("{said:?}"),
    }
}

#[test]
fn a_set_is_restored_in_any_order() {
    let mut random = Random(0x5E77_1265);
    let (mut valid, mut invalid) = (0, 0);
    while valid < 150 {
        let listed = read(&listing(&mut Bench::new("", "")));
        let mut target = Bench::new("", "");
        let set = any_set(&mut random, &listed);
        // First, restore the set in the order of `$$`.
        let mut lines: Vec<String> = set.iter().map(|(number, value)| format!("${number}={}", text(*value))).collect();
        send_all(&mut target, &lines);
        if locked_by(&mut target).is_some() {
            invalid += 1;
            continue;
        }
        valid += 1;
        let wanted = listing(&mut target);
        lines = wanted.clone();
        shuffle(&mut random, &mut lines);

        let mut machine = Bench::new("", "");
        let before: Vec<String> =
            any_set(&mut random, &listed).iter().map(|(number, value)| format!("${number}={}", text(*value))).collect();
        send_all(&mut machine, &before);
        send_all(&mut machine, &lines);
        assert_eq!(listing(&mut machine), wanted, "{lines:?} after {before:?}");
        assert_eq!(locked_by(&mut machine), None, "{lines:?} after {before:?}");
        assert_eq!(machine.state(), "Idle");
        // With the restored settings the machine must also move, here within its travel.
        let place = machine.place();
        let sign = if set[&932] != 0 && (set[&23] / 1000) & 1 != 0 { 1 } else { -1 };
        assert_eq!(machine.ask(&format!("$J=G91 G21 X{} F500", 0.9 * f64::from(sign))), ["ok"], "{lines:?}");
        machine.settle();
        assert!((machine.place()[0] - place[0]) * sign >= 0);
    }
    assert!(invalid < 3 * valid, "{invalid} sets of {valid} cannot be run");
}

/// Each of these settings locks motion. The message names the setting until the setting is corrected.
#[test]
fn what_cannot_be_run_is_named() {
    let cases: &[(&str, &str, &str)] = &[
        ("$100=0", "$100", "$100=250"),
        ("$101=0", "$101", "$101=250"),
        ("$102=0.0001", "$102", "$102=250"),
        ("$101=50000", "$101", "$101=250"),
        ("$110=0", "$110", "$110=500"),
        ("$112=0", "$112", "$112=500"),
        ("$112=0.00001", "$112", "$112=500"),
        ("$111=20200", "$111", "$111=500"),
        ("$120=0", "$120", "$120=10"),
        ("$122=0", "$122", "$122=10"),
        ("$121=0.0005", "$121", "$121=10"),
        ("$121=20000000", "$121", "$121=10"),
        ("$11=2000", "$11", "$11=0.01"),
        ("$12=0", "$12", "$12=0.002"),
        ("$20=1", "$20", "$22=1"),
        ("$20=1", "$20", "$20=0"),
        ("$22=1 $24=0", "$24", "$24=25"),
        ("$22=1 $25=0", "$25", "$22=0"),
        ("$22=1 $41=1 $57=0", "$57", "$57=100"),
        ("$22=1 $41=1 $59=0", "$59", "$41=0"),
        // 5000 mm/min and 1100 steps/mm give a step every 10.9 us, which is too fast for pulses of 10 us.
        ("$111=5000 $101=1100 $0=10", "$111", "$0=5"),
    ];
    for (wrong, name, mended) in cases {
        let mut bench = Bench::new("", "");
        let named = wrong.split_whitespace().filter_map(|line| bench.set(line)).last();
        assert_eq!(named.as_deref(), Some(*name), "{wrong}: after the ok");
        let before = listing(&mut bench);
        assert_eq!(locked_by(&mut bench).as_deref(), Some(*name), "{wrong}");
        for line in ["G0 X1", "G1 X1 F100", "G2 X1 R1 F100", "$J=G91 X1 F100", "G38.2 X1 F100", "G28", "G53 G0 Z-1"] {
            assert_eq!(bench.ask(line), ["error:9"], "{wrong}: {line}");
        }
        if wrong.contains("$22=1") {
            assert_eq!(bench.ask("$H"), ["error:9"], "{wrong}");
        }
        // Everything other than motion works, and no setting has been changed implicitly.
        assert_eq!(bench.ask("G4 P0.01"), ["ok"], "{wrong}");
        assert_eq!(bench.ask("M3 S100"), ["ok"], "{wrong}");
        assert_eq!(bench.ask("M5"), ["ok"], "{wrong}");
        assert_eq!(listing(&mut bench), before, "{wrong}");
        assert_eq!((bench.place(), bench.state()), ([0; 3], "Idle".to_string()), "{wrong}");
        assert_eq!(bench.ask(mended), ["ok"]);
        assert_eq!(locked_by(&mut bench), None, "{wrong} {mended}");
        assert_eq!(bench.ask("G91 G1 X-0.02 F400"), ["ok"], "{wrong} {mended}");
        bench.settle();
        assert_eq!(bench.place()[0], -5, "{wrong} {mended}");
    }
}

/// Three settings are wrong. The message names one of them; after its correction, the message names the next.
#[test]
fn the_next_fault_is_named_when_the_first_is_mended() {
    let mut bench = Bench::new("", "$122=0 $100=0 $111=0");
    let mut names = Vec::new();
    let mut after_ok = Vec::new();
    for mended in ["$100=250", "$111=500", "$122=10"] {
        names.push(locked_by(&mut bench).expect("locked"));
        after_ok.push(bench.set(mended));
    }
    assert_eq!(names, ["$100", "$111", "$122"]);
    assert_eq!(after_ok, [Some("$111".to_string()), Some("$122".to_string()), None]);
    assert_eq!(locked_by(&mut bench), None);
}

/// A startup line that would move is rejected with a message, and the settings can be corrected.
#[test]
fn a_startup_line_does_not_move_a_locked_machine() {
    let mut bench = Bench::new("", "");
    assert_eq!(bench.ask("$N0=G91 G1 X1 F100"), ["ok"]);
    bench.settle();
    assert_eq!(bench.place()[0], 250);
    bench.ask("$110=0");
    bench.send([0x18]);
    bench.wait(0.5);
    let said = bench.read();
    assert!(
        said.iter().any(|l| l.ends_with("correct this setting: $110]"))
            && said.contains(&">G91G1X1F100:error:9".to_string()),
        "{said:?}"
    );
    assert_eq!(bench.place()[0], 250);
    assert_eq!(bench.ask("$110=500"), ["ok"]);
    bench.carry_out("G91 G1 X-1 F100");
    assert_eq!(bench.place()[0], 0);
}

/// In Grbl's dialect `$20=1` (soft limits) is refused before `$22=1` (homing), as in Grbl.
#[test]
fn grbls_dialect_refuses_soft_limits_before_homing() {
    let mut bench = Bench::new("", "$900=0");
    assert_eq!(bench.ask("$20=1"), ["error:10"]);
    assert_eq!(bench.ask("$22=1"), ["ok"]);
    assert_eq!(bench.ask("$20=1"), ["ok"]);
    assert_eq!(locked_by(&mut bench), None);
    assert_eq!(bench.ask("$22=0"), ["ok"]);
    assert!(listing(&mut bench).contains(&"$20=0".to_string()));
}
