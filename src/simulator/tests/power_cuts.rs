//! The power is cut after every operation of the flash in a long series of commands that store something. After the
//! restart, the settings must be those before or those after the command that was interrupted.

use oxmill_simulator::{Options, Simulator, Store};

/// Size of a sector, in bytes: slightly more than all records together need, so that the log moves to the other sector
/// every few dozen commands.
const SECTOR: u32 = 1280;
const SESSIONS: usize = 50;
const COMMANDS: usize = 24;

/// Random numbers by Marsaglia's xorshift: the same start value gives the same series on every computer.
struct Dice(u32);

impl Dice {
    fn throw(&mut self, sides: u32) -> u32 {
        self.0 ^= self.0 << 13;
        self.0 ^= self.0 >> 17;
        self.0 ^= self.0 << 5;
        self.0 % sides
    }

    fn pick<'a>(&mut self, from: &[&'a str]) -> &'a str {
        from[self.throw(from.len() as u32) as usize]
    }

    fn command(&mut self) -> String {
        let value = self.throw(250) + 1;
        match self.throw(20) {
            0..=4 => format!("${}={value}", self.pick(&["0", "1", "2", "3", "10", "11", "12", "24", "26", "27", "30"])),
            5..=6 => format!("${}={value}.5", self.pick(&["100", "101", "102", "110", "112", "121", "132", "58"])),
            7..=9 => {
                let switches = ["20", "20", "21", "22", "22", "22", "13", "901", "901", "902"];
                format!("${}={}", self.pick(&switches), value % 2)
            }
            10 => format!("$N{}={}", value % 2, self.pick(&["", "G20", "G55G91", "(a remark)G17", "G21"])),
            11..=13 => format!("G10L2P{}X{value}Y-{}.25Z0.125", value % 9 + 1, self.throw(90)),
            14 => format!("G10L20P{}X{value}", value % 7),
            15 => self.pick(&["G28.1", "G30.1", "G21G91G1X0.1F500"]).into(),
            16 if value < 40 => format!("$900={}", value % 3),
            16 => format!("$I=mill {value}"),
            17 if value < 150 => self.pick(&["$RST=$", "$RST=$", "$RST=#", "$RST=*"]).into(),
            // While the spindle turns, the board does not erase the spare sector in advance.
            18 => self.pick(&["M3S200", "M5", "M5"]).into(),
            _ => "$X".into(),
        }
    }
}

fn power_up(store: Store) -> Simulator {
    let mut mill = Simulator::new(Options { store, ..Options::default() });
    mill.run_until_idle();
    mill.take_output();
    mill
}

fn say(mill: &mut Simulator, line: &str) -> String {
    mill.send(format!("{line}\n"));
    mill.run_until_idle();
    let answer = mill.take_output();
    if answer.contains("Reset to continue") {
        // A soft limit has locked the machine until a reset.
        mill.send([0x18]);
        mill.run_until_idle();
        mill.take_output();
    }
    answer
}

/// Returns everything that survives a power cycle, as the host sees it.
fn stored(mill: &mut Simulator) -> Vec<String> {
    let volatile = ["[G92", "[TLO", "[PRB", "[OPT", "[MSG:Compare"];
    let listings = ["$$", "$#", "$N", "$I"].map(|listing| say(mill, listing));
    let lines = listings.iter().flat_map(|text| text.lines());
    lines.filter(|line| !volatile.iter().any(|name| line.starts_with(name))).map(str::to_owned).collect()
}

fn difference(a: &[String], b: &[String]) -> String {
    a.iter().filter(|line| !b.contains(line)).chain(b.iter().filter(|line| !a.contains(line))).fold(
        String::new(),
        |mut text, line| {
            text.push_str(line);
            text.push('\n');
            text
        },
    )
}

#[test]
fn after_a_power_cut_all_settings_are_old_or_new() {
    let mut dice = Dice(2_463_534_242);
    let mut store = Store::with_sectors_of(SECTOR);
    let mut last = Vec::new();
    let (mut old, mut new, mut cuts, mut moves, mut reported) = (0, 0, 0, 0, 0);
    for session in 0..SESSIONS {
        let commands: Vec<String> = (0..COMMANDS).map(|_| dice.command()).collect();
        let begin = store.clone();
        let mut mill = power_up(begin.power_cycled().unwrap());
        let mut states = vec![stored(&mut mill)];
        assert!(session == 0 || states[0] == last, "after session {session}:\n{}", difference(&states[0], &last));
        for command in &commands {
            let operations = mill.store().operations();
            let answer = say(&mut mill, command);
            assert!(!answer.contains("not stored"), "{command}: {answer}");
            // The longest record has 27 words. So if a command took more than 40 operations, all records were moved to
            // the other sector.
            moves += u32::from(mill.store().operations() > operations + 40);
            states.push(stored(&mut mill));
        }
        let operations = mill.store().operations() - begin.operations();
        store = mill.store().clone();
        last = stored(&mut mill);

        for cut in 0..operations {
            let mut cut_store = begin.clone();
            cut_store.cut_power_after(cut, dice.throw(u32::MAX));
            // If this power-up writes to the flash, the power can already be cut here.
            let mut mill = power_up(cut_store);
            let mut under_way = 0;
            while !mill.power_is_gone() {
                say(&mut mill, &commands[under_way]);
                under_way += 1;
            }
            let (before, after) = (&states[under_way.saturating_sub(1)], &states[under_way]);
            let mut again = power_up(mill.store().power_cycled().unwrap());
            let found = stored(&mut again);
            assert!(
                found == *before || found == *after,
                "session {session}, cut {cut}, in `{}`, apart from the old:\n{}apart from the new:\n{}",
                under_way.checked_sub(1).map_or("power-up", |i| commands[i].as_str()),
                difference(&found, before),
                difference(&found, after),
            );
            cuts += 1;
            // The store reports an interrupted write as damage only in one case: bits of exactly one byte are missing
            // in the last word of a record. See the store's own tests.
            reported += u32::from(again.controller().is_store_damaged());
            if before != after {
                old += u32::from(found == *before);
                new += u32::from(found == *after);
            }
            // The store still works. A message about settings that cannot be run may follow the `ok`.
            assert!(say(&mut again, "$132=12.5").contains("ok\r\n"));
            let mut last = power_up(again.store().power_cycled().unwrap());
            assert!(say(&mut last, "$$").contains("$132=12.500\r\n"));
        }
    }
    println!("{cuts} cuts: {old} left the old, {new} the new; {moves} moves to the other sector");
    assert!(cuts > 1_000 && 500 * reported < cuts, "{reported} of {cuts} cuts are told as damage");
    assert!(old > 500 && new > 0 && moves > 5);
}

/// Records that this version does not know are kept: a newer firmware that is installed again finds its settings.
#[test]
fn records_of_other_versions_are_ignored_and_kept() {
    use oxmill_controller::messages::{Record, Store as Change};
    let mut store = Store::with_sectors_of(SECTOR);
    let foreign = [
        Record { key: 777, value: heapless::Vec::from_slice(&1.5_f32.to_le_bytes()).unwrap() },
        Record { key: 11, value: heapless::Vec::from_slice(&[1, 2, 3]).unwrap() },
        Record { key: 1099, value: heapless::Vec::from_slice(&[9; 24]).unwrap() },
        Record { key: 60_000, value: heapless::Vec::from_slice(b"of a later version").unwrap() },
    ];
    store.erase_ahead().unwrap();
    for record in foreign {
        store.apply(&Change::Put(record)).unwrap();
    }
    let defaults = stored(&mut power_up(Store::in_memory()));
    let mut mill = power_up(store);
    assert_eq!(stored(&mut mill), defaults);
    // These changes fill the sector more than once, so the unknown records are copied to the other sector.
    for value in 1..=200 {
        assert_eq!(say(&mut mill, &format!("$101={value}")), "ok\r\n");
    }
    let mut store = mill.store().power_cycled().unwrap();
    let mut keys: Vec<u16> = store.records().iter().map(|record| record.key).collect();
    keys.sort_unstable();
    assert_eq!(keys, [11, 101, 777, 1099, 60_000]);
}

/// Returns a job that moves, stores and ends, with values that depend on `value`.
fn job(value: usize) -> Vec<String> {
    let lines = ["G21G90", "G10L20P1X#", "G1X0.#F600", "G10L1P2Z-#.5", "G28.1", "G1X0", "G10L2P3Y7R#", "G30.1", "M30"];
    lines.iter().map(|line| line.replace('#', &value.to_string())).collect()
}

/// The lines of the job arrive at once, as from a sender that counts characters. What the answered lines store must be
/// found after the power cut. What later lines store may be found, too, but without gaps.
#[test]
fn a_job_whose_end_meets_a_power_cut_has_stored_what_it_has_answered() {
    let mut begin = Store::with_sectors_of(SECTOR);
    let mut dice = Dice(88_172_645);
    let (mut cuts, mut ahead) = (0, 0);
    for value in 1..=12 {
        let job = job(value);
        let mut mill = power_up(begin.clone());
        let mut states = vec![stored(&mut mill)];
        let operations = mill.store().operations();
        for line in &job {
            assert!(say(&mut mill, line).contains("ok\r\n"), "{line}");
            states.push(stored(&mut mill));
        }
        let done = mill.store().clone();
        for cut in 0..done.operations() - operations {
            let mut cut_store = begin.clone();
            cut_store.cut_power_after(operations - begin.operations() + cut, dice.throw(u32::MAX));
            let mut mill = power_up(cut_store);
            mill.send(job.iter().map(|line| format!("{line}\n")).collect::<String>());
            mill.run_until_idle();
            assert!(mill.power_is_gone(), "{value}, {cut}");
            let answered = mill.take_output().matches("ok\r\n").count();
            let found = stored(&mut power_up(mill.store().power_cycled().unwrap()));
            assert!(
                states[answered..].contains(&found),
                "{value}, {cut}: {answered} lines answered; apart from them:\n{}",
                difference(&found, &states[answered])
            );
            cuts += 1;
            ahead += u32::from(found != states[answered]);
        }
        // Continue with this store, so that some jobs have to move all records to the other sector.
        begin = done.power_cycled().unwrap();
    }
    println!("{cuts} cuts; {ahead} with a line stored that had not been answered");
    assert!(cuts > 500);
}
