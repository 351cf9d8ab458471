//! `cargo xtask count`: the cost of each unit of work on a Cortex-M4F, in instructions and estimated cycles.
//!
//! QEMU executes the program `count` of `tests/on_target` and logs the address of each executed instruction. The number
//! of addresses is the instruction count. The cycles are estimated from the instructions at these addresses (see
//! `thumb.rs`). Nothing is timed, so the figures are the same on every machine.
//!
//! Each unit of work is a row of the printed table and has a limit. The command fails if a row exceeds its limit. When
//! a limit is set, it is the present cost plus about 2 %. The 2 % are allowed because the compiler arranges the same
//! code differently after changes elsewhere.

use crate::elf::{self, Function};
use crate::paths::cargo_for_boards;
use crate::reach::demangled;
use crate::thumb::{Instruction, Kind, Meter, decode};
use crate::{Failure, QEMU_BOARD, TARGET, boards, qemu, root, run};
use std::collections::HashMap;
use std::io::{BufRead, BufReader, Read};

/// Cost: instructions and estimated cycles.
type Cost = (u64, u64);

/// How the costs of a row's calls are reduced to one figure.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Figure {
    Mean,
    /// The highest instruction count of a call, and the highest cycle count of a call.
    Worst,
    /// Cost of one unit, such as one block. A call of this row handles N more units than a call of the named row. So
    /// the cost is (mean of this row - mean of the named row) / N.
    Per(u64, &'static str),
    /// Not printed. A row with [`Figure::Per`] subtracts the mean of this row.
    Base,
}

/// First: the costs of the calls of each row, by the row's key. Second: for one row that the caller chose, the total
/// cost of each instruction, by the instruction's address.
type Traced = (HashMap<String, Vec<Cost>>, HashMap<u32, Cost>);

/// A row of the table: a unit of work. `grbl` and `grbl_hal`: costs in other controllers, as text, for comparison.
/// `target`: the cost that was aimed at; it is printed, but a higher cost is no failure.
struct Row {
    key: &'static str,
    title: &'static str,
    figure: Figure,
    grbl: &'static str,
    grbl_hal: &'static str,
    target: Option<Cost>,
    /// Maximum cost. The command fails if the instructions or the cycles exceed it.
    limit: Cost,
}

const fn row(key: &'static str, title: &'static str, figure: Figure, target: Option<Cost>, limit: Cost) -> Row {
    Row { key, title, figure, grbl: "", grbl_hal: "", target, limit }
}

impl Row {
    const fn beside(self, grbl: &'static str, grbl_hal: &'static str) -> Row {
        Row { grbl, grbl_hal, ..self }
    }
}

/// No limit: for rows that only serve as the base of another row.
const UNBOUNDED: Cost = (u64::MAX, u64::MAX);

/// The rows. `beside` gives the figures of Grbl 1.1h and grblHAL: their own code, compiled with
/// `arm-none-eabi-gcc -O2` for the same core and counted in the same way.
const ROWS: [Row; 23] = [
    row("batch_3", "32 events, 3 axes stepping", Figure::Mean, None, (1_125, 1_460))
        .beside("3360 / 4416", "4384 / 6240"),
    row("batch_1", "32 events, 1 axis stepping", Figure::Mean, None, (765, 1_070)).beside("2656 / 3808", "3520 / 5440"),
    // Flash wait states add a tenth, so 1.1 times this limit must not exceed `run_cycles` in boards/profiles.rs.
    row("segment", "longest run: another direction, other power, both messages", Figure::Worst, None, (2_500, 3_590)),
    row("single", "one event by itself, with a look at the probe", Figure::Mean, None, (512, 820)),
    row("stop", "stop with a full ring, 96 events undone, with its report", Figure::Worst, None, (4_710, 6_090)),
    row("masked", "longest time with interrupts masked (rtic-sync)", Figure::Worst, None, (20, 28)),
    row("prepare", "prepare one segment", Figure::Mean, Some((250, 380)), (578, 966)).beside("205 / 329", "196 / 313"),
    row("plan", "plan one block, nothing to replan", Figure::Mean, Some((600, 950)), (1_770, 2_860))
        .beside("723 / 1210", "727 / 1200"),
    row("walk_far", "replanning, per block walked", Figure::Per(80, "walk_near"), Some((35, 45)), (32, 45))
        .beside("56 / 72", "41 / 55"),
    row("jerk_prepare", "prepare one segment with a jerk limit", Figure::Mean, None, (1_060, 2_090)),
    row("jerk_plan", "plan one block with a jerk limit", Figure::Mean, None, (2_350, 3_810)),
    row("jerk_walk_far", "replanning with it, per block walked", Figure::Per(200, "jerk_walk_near"), None, (186, 250)),
    row("text", "`G1X12.345Y-6.789F1200`, text to action", Figure::Mean, Some((1100, 1600)), (1_385, 2_080))
        .beside("1092 / 1588", "1930 / 2868"),
    row("chord", "arc, per chord", Figure::Mean, Some((150, 220)), (194, 281)).beside("138 / 241", "644 / 919"),
    row("line", "short line, bytes in to segments out", Figure::Mean, Some((2600, 4000)), (5_940, 9_660))
        .beside("2800 / 4400", "4100 / 6500"),
    row("relief_line", "tight line: a relief of 0.1 mm at F2000", Figure::Mean, Some((5800, 9500)), (8_150, 13_200)),
    row("spiral_line", "tight line: a spiral of 0.1 mm at F9000", Figure::Mean, Some((5800, 9500)), (9_370, 15_200)),
    row(
        "uneven_line",
        "tight line: a relief in uneven chords at F3000",
        Figure::Mean,
        Some((5800, 9500)),
        (11_950, 19_640),
    ),
    row("recorded_line", "recording, a line of 15 bytes", Figure::Mean, None, (320, 510)),
    row("recorded_block", "recording, per message to the step task", Figure::Mean, None, (35, 52)),
    row("recorded_rest", "recording, a pass at rest", Figure::Mean, None, (8, 13)),
    row("jerk_walk_near", "", Figure::Base, None, UNBOUNDED),
    row("walk_near", "", Figure::Base, None, UNBOUNDED),
];

/// Names of the rows of the step task. The firmware compiles the step task's package for speed in every profile; the
/// benchmark program does not, so its figures for these rows hold only for the fast profile.
const OF_THE_STEP_TASK: [&str; 5] = ["batch_3", "batch_1", "segment", "single", "stop"];

/// `cargo xtask count`: prints the table and checks the limits.
///
/// If `profile` is the one built for size, the limits are not checked. The rows of the step task are then left out,
/// because the firmware compiles the step task for speed in both profiles.
pub fn count(profile: &str) -> Result<(), Failure> {
    let (calls, _) = traced(profile, "")?;
    let (table, faults) = table(&calls, profile != boards::FAST)?;
    print!("{table}");
    if faults.is_empty() || profile != boards::FAST { Ok(()) } else { Err(faults.join("\n")) }
}

/// `cargo xtask count profile ROW`: prints the instructions and cycles that each function takes in a call of a row, as
/// the mean of all calls. Also writes the cost of each instruction address to `target/count.addresses`, for tools that
/// know which source lines were inlined there.
pub fn profile(row: &str) -> Result<(), Failure> {
    let (calls, spent) = traced(boards::FAST, row)?;
    let calls = calls.get(row).ok_or_else(|| format!("there is no row {row}"))?.len() as u64;
    let path = root().join("target").join(TARGET).join(boards::FAST).join("count");
    let bytes = std::fs::read(&path).map_err(|error| format!("{}: {error}", path.display()))?;
    let mut symbols: Vec<Function> = elf::functions(&elf::parse(&bytes)?).collect();
    symbols.sort_by_key(|symbol| symbol.address);
    let mut functions: HashMap<String, Cost> = HashMap::new();
    let mut addresses = String::new();
    for (at, cost) in &spent {
        let place = symbols.partition_point(|symbol| symbol.address <= *at);
        let name = place.checked_sub(1).map_or_else(String::new, |place| demangled(symbols[place].name));
        let sum = functions.entry(name).or_default();
        *sum = (sum.0 + cost.0, sum.1 + cost.1);
        addresses += &format!("{at:#010x} {} {}\n", cost.0, cost.1);
    }
    std::fs::write(root().join("target/count.addresses"), addresses).map_err(|error| error.to_string())?;
    let mut functions: Vec<(String, Cost)> = functions.into_iter().collect();
    functions.sort_by_key(|(_, cost)| std::cmp::Reverse(cost.1));
    for (name, (instructions, cycles)) in functions {
        println!("{:7} / {:7}  {name}", (instructions + calls / 2) / calls, (cycles + calls / 2) / calls);
    }
    Ok(())
}

/// Builds the program, runs it, and returns its costs. `row`: the row for which the cost of each instruction is
/// returned; empty for none.
fn traced(profile: &str, row: &str) -> Result<Traced, Failure> {
    qemu::require()?;
    let mut build = cargo_for_boards("build", profile)?;
    run(build.args([
        "--quiet",
        "--locked",
        "--package",
        "oxmill-on-target",
        "--bin",
        "count",
        "--features",
        QEMU_BOARD,
    ]))?;
    let elf = root().join("target").join(TARGET).join(profile).join("count");
    let bytes = std::fs::read(&elf).map_err(|error| format!("{}: {error}", elf.display()))?;
    qemu::trace(&elf, |log| measure(&bytes, log, row))
}

/// Returns the address in a line of QEMU's log: `Trace 0: host address [flags/address/more] name`.
fn address(line: &str) -> Option<u32> {
    let inside = line.strip_prefix("Trace ")?.split_once('[')?.1;
    u32::from_str_radix(inside.split('/').nth(1)?, 16).ok()
}

/// Reads QEMU's log and returns the costs. The instructions from the call of a function `unit_*` to its return are one
/// call. The call belongs to the row whose function `row_*` was called last. `profiled`: the row for which the cost of
/// each instruction is returned.
fn measure(bytes: &[u8], log: impl Read, profiled: &str) -> Result<Traced, Failure> {
    let mut spent: HashMap<u32, Cost> = HashMap::new();
    let elf = elf::parse(bytes)?;
    let named = |prefix: &str| -> HashMap<u32, String> {
        let names = elf::functions(&elf).map(|s| (s.address, demangled(s.name)));
        names.filter_map(|(at, name)| Some((at, name.strip_prefix(prefix)?.to_owned()))).collect()
    };
    let (rows, units) = (named("row_"), named("unit_"));
    // Decoded instructions by address. Each has the two half words at the address.
    let mut known: HashMap<u32, ((u16, u16), Instruction)> = HashMap::new();
    let mut calls: HashMap<String, Vec<Cost>> = HashMap::new();
    let (mut row, mut open): (Option<&String>, Option<(u32, Meter)>) = (None, None);
    let mut before: Option<(u32, Kind)> = None;
    let mut masked: Option<Meter> = None;
    let mut last = 0;
    let mut reader = BufReader::new(log);
    let mut line = String::new();
    while reader.read_line(&mut line).map_err(|error| error.to_string())? > 0 {
        let Some(at) = address(&line) else {
            line.clear();
            continue;
        };
        line.clear();
        if let Some((behind, kind)) = before {
            let so_far = open.as_ref().map(|(_, meter)| (meter.instructions, meter.cycles));
            for meter in open.iter_mut().map(|(_, meter)| meter).chain(&mut masked) {
                meter.add(kind, at != behind);
            }
            if at != behind && matches!(kind, Kind::Plain | Kind::Float(_) | Kind::Store { .. } | Kind::Undefined) {
                return Err(format!("the instruction before {behind:#010x} leads to {at:#010x}: not understood"));
            }
            if let (Some(so_far), Some((_, meter))) = (so_far, &open)
                && row.is_some_and(|row| row == profiled)
            {
                let sum = spent.entry(last).or_default();
                *sum = (sum.0 + meter.instructions - so_far.0, sum.1 + meter.cycles - so_far.1);
            }
        }
        last = at;
        if let Some((end, meter)) = &open
            && *end == at
        {
            if let Some(row) = row {
                calls.entry(row.clone()).or_default().push((meter.instructions, meter.cycles));
            }
            open = None;
        }
        if let Some(name) = rows.get(&at) {
            row = Some(name);
        }
        if open.is_none()
            && let Some(unit) = units.get(&at)
        {
            let Some((end, Kind::Call(_))) = before else {
                return Err(format!("unit_{unit} is entered otherwise than by a call, at {at:#010x}: {before:x?}"));
            };
            open = Some((end, Meter::default()));
        }
        let (code, Instruction { size, kind }) = match known.get(&at) {
            Some(found) => *found,
            None => {
                let first = elf::half(&elf, at).ok_or_else(|| format!("no code at {at:#010x}"))?;
                let second = elf::half(&elf, at + 2).unwrap_or(0);
                *known.entry(at).or_insert(((first, second), decode(at, first, second)))
            }
        };
        // Counts the row `masked`: from `cpsid i`, which masks interrupts, to `msr primask`, which restores the
        // previous mask.
        match code {
            (0xB672, _) if masked.is_none() => masked = Some(Meter::default()),
            (0xF380..=0xF38F, 0x8810) if let Some(meter) = masked.take() => {
                calls.entry("masked".into()).or_default().push((meter.instructions, meter.cycles));
            }
            _ => {}
        }
        before = Some((at + size, kind));
    }
    Ok((calls, spent))
}

/// Returns the table in Markdown, as in `docs/cost.md`, and a message for each row that exceeds its limit. `is_small`:
/// `true` if the program was built for size.
fn table(calls: &HashMap<String, Vec<Cost>>, is_small: bool) -> Result<(String, Vec<String>), Failure> {
    let of =
        |key: &str| calls.get(key).filter(|all| !all.is_empty()).ok_or_else(|| format!("row {key} was not counted"));
    let mean = |all: &[Cost]| {
        let n = all.len() as u64;
        let part = |sum: u64| (sum + n / 2) / n;
        (part(all.iter().map(|c| c.0).sum()), part(all.iter().map(|c| c.1).sum()))
    };
    let mut text = String::from(
        "| unit of work (instructions / cycles) | Grbl | grblHAL | Oxmill | target | |\n|---|---|---|---|---|---|\n",
    );
    let mut faults = Vec::new();
    let is_shown = |row: &&Row| row.figure != Figure::Base && !(is_small && OF_THE_STEP_TASK.contains(&row.key));
    for row in ROWS.iter().filter(is_shown) {
        let all = of(row.key)?;
        let cost = match row.figure {
            Figure::Mean | Figure::Base => mean(all),
            Figure::Worst => (all.iter().map(|c| c.0).max().unwrap_or(0), all.iter().map(|c| c.1).max().unwrap_or(0)),
            Figure::Per(units, other) => {
                let (more, less) = (mean(all), mean(of(other)?));
                (more.0.saturating_sub(less.0).div_ceil(units), more.1.saturating_sub(less.1).div_ceil(units))
            }
        };
        let target = row.target.map_or(String::new(), |(i, c)| format!("{i} / {c}"));
        let met = match row.target {
            Some(target) if cost.0 <= target.0 && cost.1 <= target.1 => "met",
            Some(_) => "missed",
            None => "",
        };
        text += &format!(
            "| {} | {} | {} | {} / {} | {target} | {met} |\n",
            row.title, row.grbl, row.grbl_hal, cost.0, cost.1
        );
        if cost.0 > row.limit.0 || cost.1 > row.limit.1 {
            let (i, c) = row.limit;
            faults.push(format!("{}: {} / {} exceeds its limit of {i} / {c}", row.title, cost.0, cost.1));
        }
    }
    Ok((text, faults))
}
