//! Properties of any job: limits are kept, the end is exact, the speed does not jump, and the path stays within its
//! bounds.

use super::estimator::{Limits, Line, check};
use super::examples::places;
use super::host::assert_near;
use super::oracle::{AXES, Circle};
use super::rig::{HZ, Rig};
use proptest::prelude::*;
use proptest::test_runner::RngSeed;
use std::fmt::Write;

/// A position or an offset in micrometres. Coordinates of the generated programs are whole thousandths of a
/// millimetre.
type Microns = [i64; AXES];

const DEFAULT_FEED: f64 = 600.0;

/// Generates one of three machines: a slow mill with fine screws and unequal axes, a router with coarse belts, and a
/// machine whose limits are far above what the moves reach.
fn machines() -> impl Strategy<Value = Limits> {
    prop_oneof![
        Just(Limits {
            steps_per_mm: [400.0, 320.0, 800.0],
            rate: [40.0, 60.0, 15.0],
            acceleration: [150.0, 250.0, 80.0],
            junction_deviation: 0.02,
        }),
        Just(Limits {
            steps_per_mm: [40.0, 40.0, 200.0],
            rate: [300.0, 250.0, 50.0],
            acceleration: [1500.0, 1200.0, 300.0],
            junction_deviation: 0.01,
        }),
        Just(Limits {
            steps_per_mm: [250.0, 250.0, 250.0],
            rate: [500.0, 500.0, 500.0],
            acceleration: [4000.0, 4000.0, 4000.0],
            junction_deviation: 0.05,
        }),
    ]
}

fn settings(limits: &Limits) -> String {
    // `$0=1` sets a pulse of 1 us, because some step rates here are too high for Grbl's 10 us.
    let mut text = format!("$0=1\n$11={}\n", limits.junction_deviation);
    for axis in 0..AXES {
        writeln!(text, "$10{axis}={}", limits.steps_per_mm[axis]).unwrap();
        writeln!(text, "$11{axis}={}", limits.rate[axis] * 60.0).unwrap();
        writeln!(text, "$12{axis}={}", limits.acceleration[axis]).unwrap();
    }
    text
}

/// A piece of a program, relative to the end of the previous piece.
#[derive(Clone, Debug)]
enum Piece {
    /// A straight move to this offset; rapid if the flag is set.
    Straight(Microns, bool),
    /// Back and forth between two positions.
    Zigzag { to: Microns, times: usize },
    /// Very many short moves on a growing circle.
    Spiral { chord: i64, growth: i64, count: usize },
    /// Short moves in one direction.
    Crumbs { step: Microns, count: usize },
    /// A new feed, mm/min.
    Feed(u32),
}

/// Realtime commands that affect running motion: feed overrides, rapid overrides, hold, start.
const TOUCHES: [u8; 10] = [0x90, 0x91, 0x91, 0x92, 0x92, 0x95, 0x97, b'!', b'!', b'~'];

fn pieces() -> impl Strategy<Value = Vec<Piece>> {
    prop::collection::vec(piece(), 1..12)
}

fn piece() -> impl Strategy<Value = Piece> {
    let far = || [-30_000_i64..30_000, -30_000_i64..30_000, -5_000_i64..5_000];
    let near = || [-2_000_i64..2_000, -2_000_i64..2_000, -500_i64..500];
    let one_axis = (0..AXES, -20_000_i64..20_000).prop_map(|(axis, by)| {
        let mut delta = [0; AXES];
        delta[axis] = by;
        delta
    });
    prop_oneof![
        4 => (far(), any::<bool>()).prop_map(|(d, rapid)| Piece::Straight(d, rapid)),
        4 => (near(), any::<bool>()).prop_map(|(d, rapid)| Piece::Straight(d, rapid)),
        2 => (one_axis, any::<bool>()).prop_map(|(d, rapid)| Piece::Straight(d, rapid)),
        2 => (near(), 2_usize..8).prop_map(|(to, times)| Piece::Zigzag { to, times }),
        2 => (20_i64..400, 1_i64..30, 20_usize..150)
            .prop_map(|(chord, growth, count)| Piece::Spiral { chord, growth, count }),
        2 => ([-40_i64..40, -40_i64..40, -3_i64..3], 5_usize..200)
            .prop_map(|(step, count)| Piece::Crumbs { step, count }),
        3 => (10_u32..12_000).prop_map(Piece::Feed),
    ]
}

/// Returns the unit vector of direction `index` (in steps of 15 degrees), × 1000.
fn direction(index: i64) -> (i64, i64) {
    const QUARTER: [(i64, i64); 6] = [(1000, 0), (966, 259), (866, 500), (707, 707), (500, 866), (259, 966)];
    let (x, y) = QUARTER[index.rem_euclid(6) as usize];
    match index.div_euclid(6).rem_euclid(4) {
        0 => (x, y),
        1 => (-y, x),
        2 => (-x, -y),
        _ => (y, -x),
    }
}

/// A program under construction: its text, and its expected end and lines.
struct Job {
    text: String,
    at: Microns,
    feed: f64,
    lines: Vec<Line>,
}

fn mm(place: Microns) -> [f64; AXES] {
    place.map(|v| v as f64 / 1000.0)
}

impl Job {
    fn new() -> Job {
        Job {
            text: format!("G21 G90 G94 G17\nF{DEFAULT_FEED}\n"),
            at: [0; AXES],
            feed: DEFAULT_FEED,
            lines: Vec::new(),
        }
    }

    fn to(&mut self, place: Microns, rapid: bool) {
        let [x, y, z] = mm(place);
        let word = if rapid { "G0" } else { "G1" };
        writeln!(self.text, "{word} X{x:.3} Y{y:.3} Z{z:.3}").unwrap();
        self.lines.push(Line { from: mm(self.at), to: mm(place), feed: (!rapid).then_some(self.feed / 60.0) });
        self.at = place;
    }

    fn by(&mut self, delta: Microns, rapid: bool) {
        self.to(std::array::from_fn(|a| self.at[a] + delta[a]), rapid);
    }

    fn add(&mut self, piece: &Piece) {
        match *piece {
            Piece::Straight(delta, rapid) => self.by(delta, rapid),
            Piece::Zigzag { to, times } => {
                for _ in 0..times {
                    self.by(to, false);
                    self.by(to.map(|v| -v), false);
                }
            }
            Piece::Spiral { chord, growth, count } => {
                for i in 0..count as i64 {
                    let (x, y) = direction(i);
                    let length = chord + i * growth;
                    self.by([x * length / 1000, y * length / 1000, 0], false);
                }
            }
            Piece::Crumbs { step, count } => {
                for _ in 0..count {
                    self.by(step, false);
                }
            }
            Piece::Feed(feed) => {
                writeln!(self.text, "F{feed}").unwrap();
                self.feed = f64::from(feed);
            }
        }
    }
}

/// If there is a move shorter than 0.001 mm at a corner, the machine still brakes for the corner.
#[test]
fn a_remnant_hides_no_corner() {
    for job in ["X10.002 F500\nX10.0016\nX0", "X10.0018 F500\nX10.0022 Y0.0005\nY10"] {
        let mut rig = Rig::with("");
        rig.run_clean(&format!("G21 G90\nG1 {job}\n"));
        // The machine brakes at 10 mm/s². So the last 20 steps before a right angle take 80 ms, and those before a
        // reversal even longer. At full feed 20 steps would take only 10 ms.
        let corner = rig.trace.iter().rposition(|p| p.steps & 1 != 0 && p.directions & 1 == 0).unwrap();
        let at = |n: usize| rig.trace[n].at as f64 / HZ as f64;
        let time = at(corner) - at(corner - 20);
        assert!(time > 0.03, "{job:?}: twenty steps before the corner in {time} s");
    }
}

proptest! {
    #![proptest_config(ProptestConfig {
        cases: 200, max_shrink_iters: 300, failure_persistence: None, rng_seed: RngSeed::Fixed(1), ..ProptestConfig::default()
    })]

    /// Jobs of straight moves follow their path and keep the limits. Every step and every interval between steps is
    /// checked.
    #[test]
    fn straight_moves_keep_path_and_limits(limits in machines(), pieces in pieces()) {
        let mut job = Job::new();
        for piece in &pieces {
            job.add(piece);
        }
        let mut rig = Rig::with(&settings(&limits));
        rig.run_clean(&job.text);
        prop_assert_eq!(rig.place, limits.place(mm(job.at)));
        if let Err(fault) = check(&rig.trace, HZ as f64, &job.lines, &limits) {
            return Err(TestCaseError::fail(format!("{fault}\n{}", job.text)));
        }
    }

    /// Overrides and holds at any time change neither the path nor the end of a job of straight moves. The limits are
    /// kept.
    #[test]
    fn overrides_and_holds_keep_path_and_limits(
        limits in machines(),
        pieces in prop::collection::vec(piece(), 1..6),
        touches in prop::collection::vec((1_u64..700, prop::sample::select(&TOUCHES[..])), 1..12),
    ) {
        let mut job = Job::new();
        for piece in &pieces {
            job.add(piece);
        }
        let mut rig = Rig::with(&settings(&limits));
        rig.send(job.text.as_bytes());
        let mut held = false;
        for (milliseconds, touch) in touches {
            rig.run_for(milliseconds as f64 / 1000.0);
            if touch == b'!' {
                held = true;
            } else if touch == b'~' {
                held = false;
            }
            rig.send(&[touch]);
            if held && touch == b'!' {
                // Any ramp of these machines ends within this time. So nothing moves afterwards until the cycle start.
                rig.run_for(1.2);
                let place = rig.place;
                rig.run_for(0.2);
                prop_assert_eq!(rig.place, place, "it moves in a hold");
            }
        }
        rig.send(b"~");
        rig.settle();
        let answers = rig.read_lines();
        prop_assert!(answers.iter().all(|answer| answer == "ok"), "{:?}", answers);
        prop_assert_eq!(answers.len(), job.text.lines().count());
        prop_assert_eq!(rig.place, limits.place(mm(job.at)));
        // Overrides allow up to twice the feed.
        for line in &mut job.lines {
            line.feed = line.feed.map(|feed| feed * 2.0);
        }
        if let Err(fault) = check(&rig.trace, HZ as f64, &job.lines, &limits) {
            return Err(TestCaseError::fail(format!("{fault}\n{}", job.text)));
        }
    }

    /// Arcs in three planes, plain and helical, partial and full. They stay on the circle, go in the right direction,
    /// reach the exact end, and are no faster than programmed.
    #[test]
    fn arcs_stay_on_their_circle(
        limits in machines(),
        plane in 0_usize..3,
        radius in 300_i64..40_000,
        start in 0_i64..24,
        turn in 0_i64..24,
        rise in prop_oneof![Just(0_i64), -3_000_i64..3_000],
        clockwise in any::<bool>(),
        feed in 60_u32..6_000,
    ) {
        let axes = [[0, 1, 2], [2, 0, 1], [1, 2, 0]][plane];
        let word = ["G17", "G18", "G19"][plane];
        let (from_x, from_y) = direction(start);
        let (to_x, to_y) = direction(start + turn);
        // The arc starts at the origin, so the centre is opposite to the start direction.
        let centre = [-from_x * radius / 1000, -from_y * radius / 1000];
        let mut to: Microns = [0; AXES];
        to[axes[0]] = centre[0] + to_x * radius / 1000;
        to[axes[1]] = centre[1] + to_y * radius / 1000;
        to[axes[2]] = rise;
        if turn == 0 {
            to[axes[0]] = 0;
            to[axes[1]] = 0;
        }
        let letters = ['I', 'J', 'K'];
        let [x, y, z] = mm(to);
        let text = format!(
            "G21 G90 {word}\n{} X{x:.3} Y{y:.3} Z{z:.3} {}{:.3} {}{:.3} F{feed}\n",
            if clockwise { "G2" } else { "G3" },
            letters[axes[0]],
            centre[0] as f64 / 1000.0,
            letters[axes[1]],
            centre[1] as f64 / 1000.0,
        );
        let mut rig = Rig::with(&settings(&limits));
        rig.run_clean(&text);
        prop_assert_eq!(rig.place, limits.place(mm(to)), "{}", text);

        let circle = Circle {
            axes,
            centre: centre.map(|v| v as f64 / 1000.0),
            from: [0.0; AXES],
            to: mm(to),
            clockwise,
        };
        let step = limits.steps_per_mm.iter().map(|s| 1.0 / s).fold(0.0, f64::max);
        let places = places(&rig.trace, [0.0; AXES], limits.steps_per_mm);
        // The radial allowance has three parts: the arc tolerance (0.002 mm), the steps, and the resolution of start
        // and end (0.001 mm). The second part: an axis is within half a step of its position on the chord. The ends of
        // the chord are rounded to 1/7 of a step, which adds 1/14 of a step. Half a step and 1/14 make 4/7 of a step.
        // Both axes can be off by this at once, so it is multiplied by √2.
        let radial = 0.002 + std::f64::consts::SQRT_2 * 4.0 / 7.0 * step + 0.001;
        if let Err(fault) = circle.follows(&places, radial, 2.0 * step + 0.002) {
            return Err(TestCaseError::fail(format!("{fault}\n{text}")));
        }
        if let (Some(first), Some(last)) = (rig.trace.first(), rig.trace.last()) {
            let seconds = (last.at - first.at) as f64 / HZ as f64;
            let length = (circle.angle() * radius as f64 / 1000.0).hypot(rise as f64 / 1000.0);
            let least = (length - 3.0 * step) / (f64::from(feed) / 60.0) / 1.01;
            prop_assert!(seconds >= least, "{length} mm in {seconds} s\n{text}");
        }
    }

    /// A single move takes at most 1 % and 2 ms longer than the ideal trapezoid (ramp up, constant speed, ramp down).
    #[test]
    fn a_single_move_takes_no_longer_than_it_must(
        limits in machines(),
        delta in [-30_000_i64..30_000, -30_000_i64..30_000, -5_000_i64..5_000],
        feed in 100_u32..12_000,
    ) {
        let mut job = Job::new();
        job.add(&Piece::Feed(feed));
        job.by(delta, false);
        let mut rig = Rig::with(&settings(&limits));
        rig.run_clean(&job.text);
        let line = job.lines[0];
        let length = (0..AXES).map(|a| (line.to[a] - line.from[a]).powi(2)).sum::<f64>().sqrt();
        prop_assume!(length > 0.1);
        let along = |values: [f64; AXES]| {
            (0..AXES).map(|a| values[a] * length / (line.to[a] - line.from[a]).abs()).fold(f64::INFINITY, f64::min)
        };
        let acceleration = along(limits.acceleration);
        let speed = along(limits.rate).min(f64::from(feed) / 60.0);
        let ramp = speed * speed / 2.0 / acceleration;
        let ideal = if 2.0 * ramp > length {
            2.0 * (length / acceleration).sqrt()
        } else {
            length / speed + speed / acceleration
        };
        let seconds = (rig.trace[rig.trace.len() - 1].at - rig.trace[0].at) as f64 / HZ as f64;
        prop_assert!(seconds <= ideal * 1.01 + 0.002, "{seconds} s instead of {ideal}\n{}", job.text);
    }

    /// Incremental moves add up without drift, whatever their digits.
    #[test]
    fn increments_add_up_exactly(step in [-9_999_i64..9_999, -9_999_i64..9_999, -99_i64..99], count in 1_i64..400) {
        // `step` is in units of 0.0001 mm.
        let [x, y, z] = step.map(|v| v as f64 / 10_000.0);
        let mut text = String::from("G21 G91\nF60000\n");
        for _ in 0..count {
            writeln!(text, "G1 X{x:.4} Y{y:.4} Z{z:.4}").unwrap();
        }
        let limits = Limits {
            steps_per_mm: [80.0, 250.0, 400.0],
            rate: [200.0; AXES],
            acceleration: [5000.0; AXES],
            junction_deviation: 0.01,
        };
        let mut rig = Rig::with(&settings(&limits));
        rig.run_clean(&text);
        let end: [f64; AXES] = step.map(|v| (v * count) as f64 / 10_000.0);
        let half = 1e-9;
        for (axis, end) in end.iter().enumerate() {
            let steps = end * limits.steps_per_mm[axis];
            prop_assert!((rig.place[axis] as f64 - steps).abs() <= 0.5 + half, "{:?}", rig.place);
        }
        assert_near(rig.place.map(|v| v as f64), rig.place_from_report(limits.steps_per_mm), 0.21);
    }
}

/// 20,000 steps at constant speed take exactly their time, to the tick of the step clock. This holds even if the time
/// of one step is no whole number of ticks.
#[test]
fn fractions_of_a_tick_add_up() {
    for feed in [3210.7, 5999.3, 7411.0] {
        let mut rig = Rig::with("$0=1\n$100=1000\n$110=9000\n$120=20000\n");
        rig.run_clean(&format!("G21 G91\nG1 X24 F{feed}\n"));
        let (from, to) = (rig.trace[2_000].at, rig.trace[22_000].at);
        let expected = 20_000.0 * HZ as f64 * 60.0 / feed / 1000.0;
        // The controller computes the speed as an f32 with 24 significant bits, so a relative error of 3e-7 is allowed.
        let off = (to - from) as f64 - expected;
        assert!(off.abs() < expected * 3e-7 + 2.0, "{off} of {expected} ticks at F{feed}");
    }
}

/// A circle of R = 5 mm in chords of 0.1 mm at F12000. A planner that sees only corners runs the circle at 200 mm/s,
/// but v² = a·R allows 50 mm/s. The machine must not be slower than 50 mm/s, either.
#[test]
fn a_circle_of_short_chords_is_a_circle() {
    let limits = Limits {
        steps_per_mm: [80.0; AXES],
        rate: [250.0; AXES],
        acceleration: [500.0; AXES],
        junction_deviation: 0.01,
    };
    let mut job = Job::new();
    job.add(&Piece::Feed(12_000));
    let point = |k: i64| {
        let angle = k as f64 * 0.02;
        [5.0 * angle.cos() - 5.0, 5.0 * angle.sin(), 0.0].map(|v| (v * 1000.0).round() as i64)
    };
    // The approach enters the circle along its tangent.
    job.to([0, -40_000, 0], true);
    for k in 0..=628 {
        job.to(point(k), false);
    }
    let mut rig = Rig::with(&settings(&limits));
    rig.run_clean(&job.text);
    check(&rig.trace, HZ as f64, &job.lines, &limits).unwrap();
    let seconds = (rig.trace[rig.trace.len() - 1].at - rig.trace[0].at) as f64 / HZ as f64;
    // The ideal time is the sum of four parts. Out: a ramp up and a ramp down. Back: a ramp up, then down to 50 mm/s.
    // Then two turns of the circle, and half of a ramp for the final stop.
    let (a, v, way) = (500.0_f64, 50.0_f64, 40.0_f64);
    let peak = (a * way + v * v / 2.0).sqrt();
    let ideal = 2.0 * (way / a).sqrt() + (2.0 * peak - v) / a + 62.8 / v + v / a / 2.0;
    assert!(seconds < ideal * 1.01, "{seconds} of {ideal} s");
}

impl Rig {
    /// Returns the machine position of the status report in steps, to the precision of its three decimals.
    fn place_from_report(&mut self, steps_per_mm: [f64; AXES]) -> [f64; AXES] {
        let place = self.reported("MPos");
        std::array::from_fn(|a| place[a] * steps_per_mm[a])
    }
}
