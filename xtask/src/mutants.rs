//! Mutation tests, `cargo xtask mutants [NAME..]`: puts one named fault after the other into a copy of the tree and
//! runs the tests there, which must fail. A fault that no test detects is a gap in the tests.
//!
//! The tests of motion must detect the faults of motion. Conversations with the simulator must detect the faults of the
//! host link and the input filter, because the simulator runs the boards' own code for both. If the text that a fault
//! replaces is no longer in its file, the fault must be rewritten. The run takes several minutes, so only `.ci/nightly`
//! includes it.

use crate::{Failure, root, tree};
use std::fs;
use std::path::Path;
use std::process::{Command, Stdio};

struct Edit {
    file: &'static str,
    find: &'static str,
    replace: &'static str,
}

impl Edit {
    /// Returns the file's text after the replacement. Fails unless the text to be replaced occurs exactly once.
    fn applied(&self, path: &Path) -> Result<String, Failure> {
        let text = fs::read_to_string(path).map_err(|error| format!("{}: {error}", path.display()))?;
        if text.matches(self.find).count() != 1 {
            return Err(format!("`{}` stands not exactly once in {}", self.find, self.file));
        }
        Ok(text.replace(self.find, self.replace))
    }
}

struct Mutant {
    name: &'static str,
    /// Edits that together make the fault.
    edits: &'static [Edit],
}

const AXIS_LIMITS: &str = "src/controller/motion/axis_limits.rs";
const QUEUE: &str = "src/controller/motion/queue.rs";
const RUNNING: &str = "src/controller/motion/running.rs";
const SEGMENT_FEED: &str = "src/controller/motion/segment_source.rs";
const PLANNER: &str = "src/controller/motion/planner.rs";
const REVERSE_PASS: &str = "src/controller/motion/reverse_pass.rs";
const CURVATURE: &str = "src/controller/motion/curvature.rs";
const STEPPER: &str = "src/controller/motion/stepper.rs";

const MUTANTS: &[Mutant] = &[
    Mutant {
        name: "no-reverse-pass",
        edits: &[Edit {
            file: "src/controller/motion/block.rs",
            find: "exit2 + 2.0 * left * self.length",
            replace: "exit2 + left + f32::INFINITY",
        }],
    },
    Mutant {
        name: "settled-before-a-steep-bend",
        edits: &[Edit {
            file: REVERSE_PASS,
            find: "let is_steep = block.is_steep();",
            replace: "let is_steep = false;",
        }],
    },
    Mutant {
        name: "settled-while-lowered",
        edits: &[Edit {
            file: PLANNER,
            find: "self.lower_settled(first, planned_end);",
            replace: "let _ = (Self::lower_settled, first, planned_end);",
        }],
    },
    Mutant {
        name: "lowered-place-not-moved",
        edits: &[Edit { file: PLANNER, find: "self.lowered.pop();", replace: "let _ = Lowered::pop;" }],
    },
    Mutant {
        name: "settled-place-not-moved",
        edits: &[Edit { file: PLANNER, find: "self.settled = self.settled.saturating_sub(1);", replace: "" }],
    },
    Mutant {
        name: "settled-by-a-block-taken-back",
        edits: &[Edit {
            file: PLANNER,
            find: "if self.blocks.get(self.slot(self.len)).is_some_and(|block| block.entry2 > 0.0) {",
            replace: "if self.blocks.get(self.slot(self.len)).is_some_and(|block| block.entry2 < 0.0) {",
        }],
    },
    Mutant {
        name: "settled-by-rounding",
        edits: &[Edit {
            file: "src/controller/motion/block.rs",
            find: "CAP_MARGIN * reach2 >= self.max_entry2",
            replace: "CAP_MARGIN.max(1.0) * reach2 >= self.max_entry2",
        }],
    },
    Mutant {
        name: "walk-put-off-for-good",
        edits: &[Edit {
            file: PLANNER,
            find: "if self.settled == 0 || self.changed <= self.settled {",
            replace: "if self.settled == 0 {",
        }],
    },
    Mutant {
        name: "one-axis-ignored",
        edits: &[Edit {
            file: AXIS_LIMITS,
            find: "in shares.iter().zip(&self.turns.acceleration).zip(&self.max_rate) {",
            replace: "in shares.iter().zip(&self.turns.acceleration).zip(&self.max_rate).skip(1) {",
        }],
    },
    Mutant {
        name: "no-junction-rule",
        edits: &[Edit {
            file: CURVATURE,
            find: "        rule.junction2(across, half_cosine, turn2)\n    }",
            replace: "        1.0e9 * rule.junction2(across, half_cosine, turn2)\n    }",
        }],
    },
    Mutant {
        name: "no-rule-for-turns-of-several-moves",
        edits: &[Edit {
            file: CURVATURE,
            find: "(speed2 < fast2).then_some(Limit {",
            replace: "(speed2 < -fast2).then_some(Limit {",
        }],
    },
    Mutant {
        name: "no-limit-of-bends",
        edits: &[Edit {
            file: CURVATURE,
            find: "let speed2 = greater(bend.speed2(), square);",
            replace: "let speed2 = greater(UNLIMITED2, square);",
        }],
    },
    Mutant {
        name: "bends-leave-all-of-the-acceleration",
        edits: &[Edit {
            file: "src/controller/motion/block.rs",
            find: "if self.is_none() { along } else",
            replace: "if self.is_none() || speed2 >= 0.0 { along } else",
        }],
    },
    Mutant {
        name: "late-bend-leaves-too-little",
        edits: &[Edit {
            file: RUNNING,
            find: "if pace.speed2 <= (exit2 + planned * twice_left) * OFF_CURVE {",
            replace: "if planned > 0.0 {",
        }],
    },
    Mutant {
        name: "lower-override-asked-for-at-once",
        edits: &[Edit {
            file: PLANNER,
            find: "let fallen2 = lesser(fall.speed2, block.max_entry2);",
            replace: "let fallen2 = lesser(0.0, block.max_entry2);",
        }],
    },
    Mutant {
        name: "joined-without-bound",
        edits: &[Edit {
            file: "src/controller/motion/short_moves.rs",
            find: "if !self.pass_end() || !self.join.allows(&motors) {",
            replace: "if !self.pass_end() || self.join.along(&motors).is_none() {",
        }],
    },
    Mutant {
        name: "fraction-of-a-tick-dropped",
        edits: &[Edit {
            file: STEPPER,
            find: "self.moment = self.moment.wrapping_add(u64::from(interval) << FRACTION_SHIFT);",
            replace: "self.moment = self.moment.wrapping_add(u64::from(interval) << FRACTION_SHIFT >> 32 << 32);",
        }],
    },
    Mutant {
        name: "remainder-of-a-segment-dropped",
        edits: &[Edit {
            file: "src/controller/motion/segment.rs",
            find: "self.remainder = remainder;",
            replace: "self.remainder = remainder & 0;",
        }],
    },
    Mutant {
        name: "hold-without-ramp",
        edits: &[Edit {
            file: SEGMENT_FEED,
            find: "self.state = if self.rest { FeedState::Held } else { FeedState::Braking };",
            replace: "self.state = FeedState::Held;",
        }],
    },
    Mutant {
        name: "hold-twice-as-hard",
        edits: &[Edit {
            file: RUNNING,
            find: "let way = pace.speed2 / (2.0 * acceleration);",
            replace: "let way = pace.speed2 / (4.0 * acceleration);",
        }],
    },
    Mutant {
        name: "underrun-steps-on",
        edits: &[Edit {
            file: STEPPER,
            find: "        let underrun = self.run_out();\n",
            replace: "        if !self.piece.last {\n            self.piece.rare_ticks = 2;\n            return \
                self.set_out(steps);\n        }\n        let underrun = self.run_out();\n",
        }],
    },
    Mutant {
        name: "direction-one-tick-late",
        edits: &[Edit {
            file: STEPPER,
            find: "            self.begin_segment();\n            return Tick { begins: true, ..self.set_out(steps) };\n",
            replace: "            let directions = self.directions;\n            self.begin_segment();\n            return \
                Tick { begins: true, directions, ..self.set_out(steps) };\n",
        }],
    },
    Mutant {
        name: "override-in-one-jump",
        edits: &[Edit {
            file: SEGMENT_FEED,
            find: "        self.running.nominal2 = nominal2;\n",
            replace: "        self.running.nominal2 = nominal2;\n        self.motion.pace = Pace { speed: nominal, speed2: nominal2 };\n",
        }],
    },
    Mutant {
        name: "no-jerk-rule",
        edits: &[Edit {
            file: QUEUE,
            find: "self.planner.jerk_limited = self.limits.is_jerk_limited();",
            replace: "self.planner.jerk_limited = false;",
        }],
    },
    Mutant {
        name: "ramp-per-block",
        edits: &[Edit {
            file: PLANNER,
            find: "            if lesser(cap2, way.ceiling2) < reach2 {",
            replace: "            if reach2 > 0.0 {\n                way = Way::to(lesser(square_root(cap2), ramp_speed(way.speed, way.distance, way.bounds)));\n            } else if lesser(cap2, way.ceiling2) < reach2 {",
        }],
    },
    Mutant {
        name: "jerk-of-one-axis-ignored",
        edits: &[Edit {
            file: AXIS_LIMITS,
            find: "for (share, most) in shares.iter().zip(&self.jerk) {",
            replace: "for (share, most) in shares.iter().zip(&self.jerk).skip(1) {",
        }],
    },
];

const HOST_ARBITER: &str = "src/controller/protocol/host_arbiter.rs";
const LINK: &str = "src/controller/protocol/link.rs";
const SIGNALS: &str = "src/controller/machine/signals.rs";

/// Faults in the code between the controller and a host or a switch.
const OUTSIDE: &[Mutant] = &[
    Mutant {
        name: "no-epochs",
        edits: &[Edit {
            file: HOST_ARBITER,
            find: "if queued && command.opens_epoch() {",
            replace: "if queued && command.opens_epoch() && self.gone == u16::MAX {",
        }],
    },
    Mutant {
        name: "bytes-of-a-gone-host",
        edits: &[Edit {
            file: LINK,
            find: "*self = Self { stuck, ..Self::new(self.number, self.may_hold) };",
            replace: "(self.stuck, self.refusing_line) = (stuck, false);",
        }],
    },
    Mutant {
        name: "waiting-bytes-damaged",
        edits: &[Edit {
            file: LINK,
            find: "let byte = LineByte { byte, epoch: arbiter.epoch(), damaged: self.lost };",
            replace: "let byte = LineByte { byte, epoch: arbiter.epoch(), damaged: !self.held.is_empty() };",
        }],
    },
    Mutant {
        name: "no-filter",
        edits: &[Edit {
            file: SIGNALS,
            find: "let active = self.filter.sample(low ^ wiring.inverted);",
            replace: "self.filter.sample(low ^ wiring.inverted);\n        let active = low ^ wiring.inverted;",
        }],
    },
    Mutant {
        name: "no-polarity",
        edits: &[Edit {
            file: SIGNALS,
            find: "let active = self.filter.sample(low ^ wiring.inverted);",
            replace: "let active = self.filter.sample(low);",
        }],
    },
];

/// Files and folders copied: everything that the tests are built from.
const COPIED: [&str; 9] =
    ["Cargo.toml", "Cargo.lock", "rust-toolchain.toml", "src", "boards", "tests", "xtask", "examples", ".cargo"];

/// `cargo xtask mutants [NAME..]`: tries the faults with these names, or all. Fails if the tests miss one of them.
pub fn run(names: &[&str]) -> Result<(), Failure> {
    for name in names {
        if !all().any(|(mutant, _)| mutant.name == *name) {
            let all: Vec<&str> = all().map(|(mutant, _)| mutant.name).collect();
            return Err(format!("there is no mutant `{name}`; there are {}", all.join(", ")));
        }
    }
    let tree = root().join("target/mutants/tree");
    let mut survivors = Vec::new();
    copy_all(&tree)?;
    let chosen: Vec<_> = all().filter(|(mutant, _)| names.is_empty() || names.contains(&mutant.name)).collect();
    for suite in [motion as Suite, conversations] {
        let wanted = chosen.iter().any(|(_, other)| std::ptr::fn_addr_eq(*other, suite));
        if wanted && !suite(&tree)? {
            return Err("the tests fail without a fault".into());
        }
    }
    for (mutant, suite) in chosen {
        copy_all(&tree)?;
        for edit in mutant.edits {
            let path = tree.join(edit.file);
            let text = edit.applied(&path).map_err(|why| format!("{}: {why}", mutant.name))?;
            fs::write(&path, text).map_err(|error| error.to_string())?;
        }
        // If the fault did not compile, the tests would fail as well, and the fault would count as detected.
        if !tests(&tree, &["--no-run"])? {
            return Err(format!("{} does not compile", mutant.name));
        }
        let seen = !suite(&tree)?;
        println!("mutant {} ... {}", mutant.name, if seen { "seen" } else { "NOT SEEN" });
        if !seen {
            survivors.push(mutant.name);
        }
    }
    if survivors.is_empty() { Ok(()) } else { Err(format!("the tests do not see {}", survivors.join(", "))) }
}

/// Updates the copy, touching only files that differ, so that the rest is not rebuilt.
fn copy_all(tree: &Path) -> Result<(), Failure> {
    fs::create_dir_all(tree).map_err(|error| error.to_string())?;
    COPIED.iter().try_for_each(|name| tree::copy(&root().join(name), &tree.join(name)))
}

/// A function that runs tests in the copy of the tree at this path; it returns whether they pass.
type Suite = fn(&Path) -> Result<bool, Failure>;

/// Returns all faults, each with the tests that must detect it.
fn all() -> impl Iterator<Item = (&'static Mutant, Suite)> {
    let (motion, conversations): (Suite, Suite) = (motion, conversations);
    MUTANTS.iter().map(move |mutant| (mutant, motion)).chain(OUTSIDE.iter().map(move |mutant| (mutant, conversations)))
}

fn conversations(tree: &Path) -> Result<bool, Failure> {
    tests(tree, &["--test", "machine", "--", "conversations"])
}

/// Runs the tests of motion, starting with the step traces of whole jobs.
fn motion(tree: &Path) -> Result<bool, Failure> {
    Ok(tests(tree, &["--test", "machine", "--", "motion_properties", "jerk", "turns::", "curves::"])?
        && tests(
            tree,
            &[
                "--package",
                "oxmill-controller",
                "--lib",
                "--",
                "motion::tests::deferred_pass",
                "motion::tests::joins",
                "motion::tests::stops",
                "motion::tests::ramps",
                "motion::segment",
            ],
        )?)
}

fn tests(tree: &Path, arguments: &[&str]) -> Result<bool, Failure> {
    let mut cargo = Command::new(std::env::var_os("CARGO").unwrap_or_else(|| "cargo".into()));
    cargo.current_dir(tree).env("CARGO_TARGET_DIR", root().join("target/mutants/build")).args(["test", "--quiet"]);
    let all: &[&str] = &["--package", "oxmill", "--package", "oxmill-controller", "--test", "machine", "--lib"];
    cargo.args(if arguments == ["--no-run"] { all } else { &[] }).args(arguments);
    let status = cargo.stdout(Stdio::null()).stderr(Stdio::null()).status().map_err(|error| error.to_string())?;
    Ok(status.success())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_fault_finds_its_place() {
        let mut lost = Vec::new();
        for (mutant, _) in all() {
            for edit in mutant.edits {
                if let Err(why) = edit.applied(&root().join(edit.file)) {
                    lost.push(format!("{}: {why}", mutant.name));
                }
            }
        }
        assert!(lost.is_empty(), "{}", lost.join("\n"));
    }
}
