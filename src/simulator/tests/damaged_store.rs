//! A settings log with a wrong bit: all other settings keep their values, the host gets a message, and nothing moves
//! before a user has listed and confirmed the settings.

use oxmill_simulator::{Options, Simulator, Store};
use oxmill_test_support::Folder;
use std::fs;
use std::path::Path;
use std::time::Duration;

/// Message of the controller while its stored settings are damaged. It comes after the welcome line, and before the
/// error of a rejected `$X` or `$H`.
const DAMAGED: &str = "[MSG:Stored settings damaged, some may be lost: send $$, correct them, wait 2 s, send $X]\r\n";
const WELCOME: &str = "\r\nGrbl 1.1h ['$' for help]\r\n";

fn power_up(path: &Path) -> (Simulator, String) {
    let store = Store::open(path).unwrap();
    let mut mill = Simulator::new(Options { store, ..Options::default() });
    mill.run_until_idle();
    let said = mill.take_output();
    (mill, said)
}

fn say(mill: &mut Simulator, line: &str) -> String {
    mill.send(format!("{line}\n"));
    mill.run_until_idle();
    mill.take_output()
}

fn wait(mill: &mut Simulator, milliseconds: u64) {
    mill.run_for(Duration::from_millis(milliseconds));
}

/// Returns the image of a store after these lines have been executed.
fn stored(path: &Path, lines: &[&str]) -> Vec<u8> {
    let _ = fs::remove_file(path);
    let (mut mill, _) = power_up(path);
    for line in lines {
        let answer = say(&mut mill, line);
        assert!(answer.ends_with("ok\r\n"), "{line}: {answer}");
    }
    fs::read(path).unwrap()
}

/// Returns all stored settings, line by line.
fn listing(mill: &mut Simulator) -> Vec<String> {
    let mut lines = Vec::new();
    for list in ["$#", "$N", "$I", "$$"] {
        let text = say(mill, list).replace("[MSG:Compare with your notes, wait 2 s, then send $X]\r\n", "");
        let volatile = ["[G92", "[TLO", "[PRB", "[OPT", "ok"];
        lines.extend(text.lines().filter(|l| !volatile.iter().any(|v| l.starts_with(v))).map(str::to_owned));
    }
    lines
}

/// Any one bit of the records is wrong. Then at most one value changes, a message is sent, and motion is locked.
#[test]
fn a_wrong_bit_costs_one_value_at_most() {
    let folder = Folder::new();
    let path = folder.path().join("s");
    let lines = [
        "$100=80",
        "G28.1",
        "$22=1",
        "G10L2P1X1.5Y-2",
        "G10L2P9Z3",
        "$N0=G20",
        "$N1=(a remark)G17",
        "$I=mill 7",
        "$900=2",
        "$132=90",
    ];
    let image = stored(&path, &lines);
    let (mut whole, said) = power_up(&path);
    assert!(!said.contains("damaged"), "{said}");
    let before = listing(&mut whole);
    drop(whole);
    let end = image.len() / 2 - image[..image.len() / 2].iter().rev().take_while(|b| **b == 255).count();
    assert!(end > 200, "{end}");
    let mut changed = 0;
    for bit in 0..8 * end {
        let mut damaged = image.clone();
        damaged[bit / 8] ^= 1 << (bit % 8);
        fs::write(&path, damaged).unwrap();
        let (mut mill, said) = power_up(&path);
        assert!(said.ends_with(&format!("{WELCOME}{DAMAGED}")), "bit {bit}: {said}");
        let after = listing(&mut mill);
        assert_eq!(before.len(), after.len());
        let other: Vec<_> = before.iter().zip(&after).filter(|(a, b)| a != b).collect();
        assert!(other.len() <= 1, "bit {bit}: {other:?}");
        changed += other.len();
        assert_eq!(say(&mut mill, "G0X1"), "error:9\r\n");
    }
    assert!(changed > end, "{changed} of {end} bytes");
}

#[test]
fn nothing_moves_before_somebody_has_looked_and_confirmed() {
    let folder = Folder::new();
    let path = folder.path().join("s");
    let mut image = stored(&path, &["$22=1", "$110=600", "$100=80"]);
    // `$22=1` has stored two records, which begin at these bytes of the log: `$20` at 12 and `$22` at 24.
    image[24] ^= 0x40;
    let homing = image.clone();
    image[12] ^= 0x40;
    for (image, homing) in [(homing, false), (image, false)] {
        fs::write(&path, image).unwrap();
        let (mut mill, said) = power_up(&path);
        assert_eq!(said, format!("{WELCOME}{DAMAGED}"));
        mill.send("?");
        assert!(mill.take_output().starts_with("<Alarm|"));
        // Programs that send jobs often begin with `$X` or `$H`. Neither may unlock motion here.
        let refused = format!("{DAMAGED}error:7\r\n");
        assert_eq!(say(&mut mill, "$X"), refused);
        assert_eq!(say(&mut mill, "$22=1"), "ok\r\n");
        assert_eq!(say(&mut mill, "$H"), refused, "{homing}");
        for line in ["G0X1", "M3S1000", "G4P0"] {
            assert_eq!(say(&mut mill, line), "error:9\r\n", "{line}");
        }
        assert_eq!(say(&mut mill, "$J=G91X1F100"), "error:8\r\n");
        assert_eq!(say(&mut mill, "$C"), "error:8\r\n");
        // `$X` less than 2 s after `$$` is rejected: it can come from a program, without a user who has read the list.
        let list = say(&mut mill, "$$");
        assert!(list.contains("$100=80.000\r\n") && list.contains("$110=600.000\r\n"), "{list}");
        assert!(list.ends_with("[MSG:Compare with your notes, wait 2 s, then send $X]\r\nok\r\n"), "{list}");
        wait(&mut mill, 1_900);
        assert_eq!(say(&mut mill, "$X"), refused);
        // A reset makes the list count as unread, because another user may be present who has not seen it.
        mill.send([0x18]);
        mill.run_until_idle();
        assert_eq!(mill.take_output(), format!("{WELCOME}{DAMAGED}"));
        wait(&mut mill, 5_000);
        assert_eq!(say(&mut mill, "$X"), refused);
        mill.connect();
        assert_eq!(mill.take_output(), format!("{WELCOME}{DAMAGED}"));
        assert_eq!(say(&mut mill, "$SLP"), "ok\r\n[MSG:Sleeping]\r\n");
        mill.send([0x18]);
        mill.run_until_idle();
        assert_eq!(mill.take_output(), format!("{WELCOME}{DAMAGED}"));
        assert_eq!(say(&mut mill, "$X"), refused);
        // Not even `$RST` clears the damage.
        assert!(say(&mut mill, "$RST=#").ends_with(&format!("{WELCOME}{DAMAGED}")));
        assert_eq!(mill.machine().pulses(), [0; 3]);
        // After a power cycle, the damage is reported again.
        drop(mill);
        let (mut mill, said) = power_up(&path);
        assert_eq!(said, format!("{WELCOME}{DAMAGED}"));
        say(&mut mill, "$$");
        wait(&mut mill, 2_000);
        let said = say(&mut mill, "$X");
        assert!(said.starts_with("[MSG:Caution: Unlocked]\r\n") && said.ends_with("ok\r\n"), "{said}");
        say(&mut mill, "$22=0");
        assert_eq!(say(&mut mill, "G0X1"), "ok\r\n");
        assert_eq!(mill.machine().position(), [80, 0, 0]);
        // After the confirmation, neither `$$` nor the next start reports the damage.
        assert!(!say(&mut mill, "$$").contains("MSG"));
        drop(mill);
        let (mut mill, said) = power_up(&path);
        assert_eq!(said, WELCOME);
        let list = say(&mut mill, "$$");
        assert!(list.contains("$100=80.000\r\n") && list.contains("$22=0\r\n"), "{list}");
    }
}

/// The settings can be corrected before they are confirmed; the corrections survive a power cycle.
#[test]
fn settings_are_mended_before_they_are_confirmed() {
    let folder = Folder::new();
    let path = folder.path().join("s");
    let mut image = stored(&path, &["$100=80", "$101=81"]);
    image[20] ^= 0x80;
    fs::write(&path, image).unwrap();
    let (mut mill, _) = power_up(&path);
    assert!(say(&mut mill, "$$").contains("$100=250.000\r\n"));
    assert_eq!(say(&mut mill, "$100=80"), "ok\r\n");
    drop(mill);
    let (mut mill, said) = power_up(&path);
    assert_eq!(said, format!("{WELCOME}{DAMAGED}"));
    let list = say(&mut mill, "$$");
    assert!(list.contains("$100=80.000\r\n") && list.contains("$101=81.000\r\n"), "{list}");
}

/// The power is cut at each flash operation while the user's confirmation (`$X`) is stored. Afterwards the damage is
/// reported again or is gone, and no setting is lost.
#[test]
fn a_power_cut_in_the_confirmation_is_no_harm() {
    let folder = Folder::new();
    let path = folder.path().join("s");
    let mut damaged = stored(&path, &["$100=80", "$101=81", "G10L2P1X1", "$N0=G21", "$22=1"]);
    damaged[13] ^= 2;
    let (mut reported, mut clean) = (0, 0);
    for operations in 0.. {
        fs::write(&path, &damaged).unwrap();
        let (mut mill, _) = power_up(&path);
        say(&mut mill, "$$");
        wait(&mut mill, 2_000);
        mill.store_mut().cut_power_after(operations, 0x00FF_F0F0);
        say(&mut mill, "$X");
        let cut = mill.power_is_gone();
        drop(mill);
        let (mut mill, said) = power_up(&path);
        let lock = "[MSG:'$H'|'$X' to unlock]\r\n";
        assert!(said == format!("{WELCOME}{lock}") || said == format!("{WELCOME}{DAMAGED}"), "{said}");
        if said.ends_with(lock) {
            clean += 1
        } else {
            reported += 1
        }
        let list = listing(&mut mill).join("\n");
        for line in ["$101=81.000", "[G54:1.000,0.000,0.000]", "$N0=G21", "$100=250.000"] {
            assert!(list.contains(line), "{operations}: {line} is not in\n{list}");
        }
        if !cut {
            break;
        }
    }
    assert!(reported > 10 && clean >= 1, "{reported} {clean}");
}
