//! G64 P: rounded corners and merged moves. The distance between the tool and the programmed path is measured on the
//! steps, both ways: every step position must be near the path, and every point of the path near a step position.
//! Nothing here is taken from the planner.

use super::axis_speeds::{Course, greatest_change};
use super::estimator::Limits;
use super::examples;
use super::host::{CARVER, CARVER_STEPS};
use super::oracle::{AXES, Pulse};
use super::rig::{HZ, Rig};
use super::turns::{Style, program, run, seconds, settings};
use oxmill_controller::messages::Realtime;
use std::collections::HashMap;

type Point = [f64; AXES];

/// Maximum distance of step positions from the driven path, in steps of each motor. It has two parts: half a step, and
/// 1/14 of a step because the ends of the path are rounded (docs/motion.md). If the run without a tolerance is farther
/// off the path, its distance is allowed instead.
const STEP: f64 = 0.5 + 1.0 / 14.0;
/// Factor by which a tolerance may make a job longer. A longer job is a fault only if its additional time also exceeds
/// [`NOTICEABLE_S`].
const SLOWER: f64 = 1.005;
/// Difference of duration, s, that is ignored: it also occurs between runs of short jobs without a tolerance.
const NOTICEABLE_S: f64 = 0.012;
/// Maximum of the ratio that [`super::axis_speeds`] computes: a measured change of speed, divided by the change that is
/// allowed on the programmed path. It may be above 1, because the tool drives a rounded corner beside the programmed
/// one.
const CHANGE: f64 = 1.1;
/// Spacing of the path points that the tool must come near, mm.
const SPACING: f64 = 0.02;

fn limits(steps_per_mm: f64) -> Limits {
    Limits {
        steps_per_mm: [steps_per_mm; AXES],
        rate: [100.0; AXES],
        acceleration: [500.0; AXES],
        junction_deviation: 0.01,
    }
}

fn from_line(point: Point, [from, to]: [Point; 2]) -> f64 {
    let way: Point = std::array::from_fn(|axis| to[axis] - from[axis]);
    let off: Point = std::array::from_fn(|axis| point[axis] - from[axis]);
    let dot = |a: &Point, b: &Point| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
    let square = dot(&way, &way);
    let share = if square > 0.0 { (dot(&way, &off) / square).clamp(0.0, 1.0) } else { 0.0 };
    let rest: Point = std::array::from_fn(|axis| off[axis] - share * way[axis]);
    dot(&rest, &rest).sqrt()
}

/// Returns the maximum distance of the points from a polyline, mm.
fn farthest(points: &[Point], line: &[Point]) -> f64 {
    let pieces: Vec<[Point; 2]> = line.windows(2).map(|pair| [pair[0], pair[1]]).collect();
    let (mut nearest, mut most) = (0_usize, 0.0_f64);
    for point in points {
        // Search outward from the piece nearest to the previous point. Stop as soon as a piece is no farther away than
        // the maximum so far: then this point cannot raise the maximum.
        let (start, mut least) = (nearest, f64::INFINITY);
        let outward = (0..pieces.len()).flat_map(|away| [start.checked_add(away), start.checked_sub(away)]);
        for index in outward.flatten().filter(|index| *index < pieces.len()) {
            let distance = from_line(*point, pieces[index]);
            if distance < least {
                (least, nearest) = (distance, index);
            }
            if least <= most {
                break;
            }
        }
        most = most.max(least);
    }
    most
}

fn places(trace: &[Pulse], steps_per_mm: f64) -> Vec<Point> {
    let mut place = [0; AXES];
    let mut places = vec![[0.0; AXES]];
    for pulse in trace {
        place = pulse.moved(place);
        places.push(place.map(|steps| steps as f64 / steps_per_mm));
    }
    places
}

/// Returns points along a path, at most [`SPACING`] apart.
fn along(path: &[Point]) -> Vec<Point> {
    let mut points = Vec::new();
    for pair in path.windows(2) {
        let length = from_line(pair[1], [pair[0], pair[0]]);
        let pieces = (length / SPACING).ceil().max(1.0);
        points.extend((0..=pieces as u32).map(|k| -> Point {
            std::array::from_fn(|axis| pair[0][axis] + (pair[1][axis] - pair[0][axis]) * f64::from(k) / pieces)
        }));
    }
    points
}

/// Result of a job with a tolerance, compared with the programmed path and with a run without a tolerance.
#[derive(Debug)]
struct Outcome {
    /// Maximum distance of the steps from the programmed path, and of the programmed path from the steps, mm.
    steps: f64,
    path: f64,
    /// Duration, s, and its ratio to the duration without a tolerance.
    seconds: f64,
    share: f64,
    /// Largest change of an axis' speed, divided by the allowed change.
    change: f64,
}

/// One job, and the G-code words (`words`) that set its tolerance.
struct Job<'a> {
    points: &'a [Point],
    style: Style,
    feed: f64,
    steps_per_mm: f64,
    jerk: f64,
    words: &'a str,
    tolerance: f64,
}

impl Job<'_> {
    fn outcome(&self) -> Result<Outcome, String> {
        let limits = limits(self.steps_per_mm);
        let settings = settings(&limits, self.jerk);
        let (text, course): (String, Course) = program(self.points, self.style, self.feed);
        let exact = run(&settings, &text);
        let (first, rest) = text.split_once('\n').unwrap();
        let rig = run(&settings, &format!("{first}\n{}\n{rest}", self.words));
        if rig.place != exact.place {
            return Err(format!("ends at {:?} instead of {:?}", rig.place, exact.place));
        }
        let places = places(&rig.trace, self.steps_per_mm);
        let used = (0..AXES).filter(|axis| course.written.iter().any(|point| point[*axis] != 0.0)).count();
        let places_exact = self::places(&exact.trace, self.steps_per_mm);
        let of_exact = farthest(&places_exact, &course.written).max(farthest(&along(&course.written), &places_exact));
        let beside = (STEP / self.steps_per_mm * (used as f64).sqrt()).max(of_exact) + 1e-6;
        let outcome = Outcome {
            steps: farthest(&places, &course.written),
            path: farthest(&along(&course.written), &places),
            seconds: seconds(&rig),
            share: seconds(&rig) / seconds(&exact),
            change: if self.jerk == 0.0 {
                let of = |window| greatest_change(&rig.trace, HZ as f64, &course, &limits, window);
                let changes: Result<Vec<_>, String> = [0.005, 0.020].into_iter().map(of).collect();
                match changes {
                    Ok(changes) => changes.iter().map(|change| change.ratio).fold(0.0, f64::max),
                    // The tool does not pass the vertices that `greatest_change` needs. So compare with the exact run
                    // instead.
                    Err(_) => against(&rig, &exact, self.steps_per_mm),
                }
            } else {
                0.0
            },
        };
        let far = outcome.steps.max(outcome.path);
        if far > self.tolerance + beside {
            return Err(format!("{far} mm off, {} mm beside the steps' {beside}: {outcome:?}", far - beside));
        }
        if outcome.change > CHANGE {
            return Err(format!("too fast: {outcome:?}"));
        }
        if outcome.share > SLOWER && outcome.seconds > seconds(&exact) + NOTICEABLE_S {
            return Err(format!("slower: {outcome:?}"));
        }
        Ok(outcome)
    }
}

/// Runs a job on three machines, with two tolerances on each, and returns the faults.
fn check(name: &str, points: &[Point], style: Style) -> Vec<String> {
    let mut faults = Vec::new();
    for (steps_per_mm, feed, jerk) in [(80.0, 100.0, 0.0), (250.0, 33.0, 0.0), (250.0, 100.0, 20_000.0)] {
        for p in [0.02, 0.1] {
            let words = format!("G64 P{:.6}", p / style.unit());
            let job = Job { points, style, feed, steps_per_mm, jerk, words: &words, tolerance: p };
            let outcome = job.outcome();
            println!("{name}, {steps_per_mm} steps/mm, {feed} mm/s, jerk {jerk}, P{p}: {outcome:.4?}");
            if let Err(fault) = outcome {
                faults.push(format!("{name}, {steps_per_mm} steps/mm, {feed} mm/s, jerk {jerk}, P{p}: {fault}"));
            }
        }
    }
    faults
}

fn in_plane(points: &[[f64; 2]]) -> Vec<Point> {
    points.iter().map(|[x, y]| [*x, *y, 0.0]).collect()
}

#[test]
fn corners_are_rounded_within_the_tolerance() {
    let square = in_plane(&[[20.0, 0.0], [20.0, 20.0], [0.0, 20.0], [0.0, 0.0], [20.0, 0.0]]);
    let zigzag: Vec<[f64; 2]> = (1..20).map(|k| [f64::from(k), if k % 2 == 0 { 0.0 } else { 10.0 }]).collect();
    let rows: Vec<[f64; 2]> = (0..10)
        .flat_map(|k| {
            let (y, x) = (0.3 * f64::from(k), if k % 2 == 0 { 20.0 } else { 0.0 });
            [[x, y], [x, y + 0.3]]
        })
        .collect();
    let back = in_plane(&[[10.0, 0.0], [0.0, 0.0], [10.0, 0.0], [2.0, 0.0]]);
    let mut faults = check("square", &square, Style::mm(3));
    faults.extend(check("square in inches", &square, Style::inches(4)));
    faults.extend(check("zigzag", &in_plane(&zigzag), Style::mm(3)));
    faults.extend(check("rows", &in_plane(&rows), Style::mm(3)));
    faults.extend(check("back and forth", &back, Style::mm(3)));
    assert!(faults.is_empty(), "{}", faults.join("\n"));
}

#[test]
fn curves_in_chords_are_merged_within_the_tolerance() {
    let mut faults = Vec::new();
    for chord in [0.03, 0.1, 0.5] {
        let spiral: Vec<Point> = (1..(60.0 / chord) as u32)
            .scan(0.0_f64, |angle, _| {
                *angle += chord / (0.3 + 0.2 * *angle);
                let radius = 0.3 + 0.2 * *angle;
                Some([radius * angle.cos() - 0.3, radius * angle.sin(), 0.0])
            })
            .collect();
        faults.extend(check(&format!("spiral, {chord} mm"), &spiral, Style::mm(4)));
        faults.extend(check(&format!("spiral, {chord} mm, coarse"), &spiral, Style::mm(2)));
        let relief: Vec<Point> = (1..(60.0 / chord) as u32)
            .map(|k| {
                let x = chord * f64::from(k);
                [x, 0.0, 0.4 * (1.7 * x).sin() + 0.05 * (9.0 * x).sin().abs() + if x % 10.0 < 3.0 { 0.5 } else { 0.0 }]
            })
            .collect();
        faults.extend(check(&format!("relief, {chord} mm"), &relief, Style::mm(3)));
        faults.extend(check(&format!("relief, {chord} mm, inches"), &relief, Style::inches(4)));
    }
    assert!(faults.is_empty(), "{}", faults.join("\n"));
}

/// Pseudorandom numbers with a fixed sequence.
struct Random(u64);

impl Random {
    fn unit(&mut self) -> f64 {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 11) as f64 / (1_u64 << 53) as f64
    }

    fn within(&mut self, low: f64, high: f64) -> f64 {
        low * (high / low).powf(self.unit())
    }
}

/// Returns a random path: bends in chords, straight runs of chords, corners and reversals, in the plane or in space.
fn walk(random: &mut Random) -> Vec<Point> {
    let (mut at, mut heading, mut points) = ([0.0; AXES], random.unit() * 6.3, Vec::new());
    let (rise, chord) = (if random.unit() < 0.5 { 0.0 } else { random.unit() - 0.5 }, random.within(0.01, 2.0));
    while points.len() < 150 {
        let (turn, moves, length) = match (random.unit() * 5.0) as u32 {
            0 => (random.unit() * 6.0 - 3.0, 1, random.within(0.05, 10.0)),
            1 => (0.0, (random.unit() * 30.0) as u32, chord),
            2 => (random.unit() * 2.0 - 1.0, (random.unit() * 10.0) as u32, chord),
            _ => (chord / random.within(0.1, 30.0), (random.unit() * 60.0) as u32, chord),
        };
        for _ in 0..moves {
            heading += turn;
            at =
                [at[0] + length * heading.cos(), at[1] + length * heading.sin(), at[2] + rise * length * heading.sin()];
            points.push(at);
        }
    }
    points
}

#[test]
fn whatever_the_job_it_stays_within_the_tolerance_and_is_no_slower() {
    let cases = std::env::var("OXMILL_BLENDED").ok().and_then(|cases| cases.parse().ok()).unwrap_or(25);
    let (mut random, mut faults, mut times) = (Random(7), Vec::new(), (0.0, 0.0));
    for case in 0..cases {
        let points = walk(&mut random);
        let p = random.within(0.004, 0.4);
        let style = [Style::mm(3), Style::mm(2), Style::mm(5), Style::inches(4)][(random.unit() * 4.0) as usize];
        let q = [None, Some(0.0), Some(random.within(0.001, 1.0))][(random.unit() * 3.0) as usize];
        let words = format!("G64 P{:.6}{}", p / style.unit(), q.map_or(String::new(), |q| format!(" Q{q:.4}")));
        let jerk = [0.0, 0.0, random.within(2000.0, 100_000.0)][(random.unit() * 3.0) as usize];
        let steps_per_mm = [80.0, 250.0, 640.0][(random.unit() * 3.0) as usize];
        let feed = random.within(2.0, 100.0);
        let job = Job { points: &points, style, feed, steps_per_mm, jerk, words: &words, tolerance: p };
        match job.outcome() {
            Ok(outcome) => {
                times = (times.0 + outcome.seconds / outcome.share, times.1 + outcome.seconds);
            }
            Err(fault) => {
                faults.push(format!("case {case}, {words}, {feed} mm/s, {steps_per_mm}, jerk {jerk}: {fault}"))
            }
        }
    }
    println!("{cases} jobs: {:.2} s, exact {:.2} s", times.1, times.0);
    assert!(faults.is_empty(), "{} of {cases}:\n{}", faults.len(), faults.join("\n"));
    assert!(times.1 < times.0, "{} s in all, {} s without a tolerance", times.1, times.0);
}

/// Holds, resumes and overrides during a job with a tolerance (G64 P) change neither the path nor its end. With
/// backlash compensation, the job ends at the same position with and without the tolerance.
#[test]
fn holds_overrides_and_backlash_leave_the_path_as_it_is() {
    let mut points = walk(&mut Random(11));
    points.iter_mut().for_each(|point| point[2] = 0.0);
    let limits = limits(250.0);
    let (text, course) = program(&points, Style::mm(3), 50.0);
    let blended = format!("G64 P0.05\n{text}");
    let exact = run(&settings(&limits, 0.0), &text);
    let mut rig = Rig::with(&settings(&limits, 0.0));
    rig.send(blended.as_bytes());
    let commands = [
        Realtime::FeedHold,
        Realtime::CycleStart,
        Realtime::FeedUp10,
        Realtime::FeedHold,
        Realtime::CycleStart,
        Realtime::FeedDown10,
    ];
    for command in commands.iter().cycle().take(60) {
        rig.run_for(0.09);
        rig.press(*command);
    }
    rig.press(Realtime::CycleStart);
    assert!(rig.run_until(600.0, |rig| rig.is_idle()));
    assert_eq!(rig.place, exact.place);
    let places = places(&rig.trace, 250.0);
    let off = farthest(&places, &course.written).max(farthest(&along(&course.written), &places));
    assert!(off <= 0.05 + 1.5 / 250.0 * 2.0_f64.sqrt(), "{off} mm");
    let backlash = format!("{}$160=0.05\n$161=0.03\n", settings(&limits, 0.0));
    assert_eq!(run(&backlash, &blended).place, run(&backlash, &text).place);
}

/// After a reset during a job with G64 P the reported position agrees with the steps made, and the next job starts
/// there. Moves that the controller has held back, to merge them or to round their corners, are dropped.
#[test]
fn after_a_reset_nothing_is_left_of_what_was_held_back() {
    let points = walk(&mut Random(5));
    let (text, _) = program(&points, Style::mm(3), 50.0);
    let mut rig = Rig::with(&settings(&limits(250.0), 0.0));
    rig.send(format!("G64 P0.05\n{text}").as_bytes());
    rig.run_for(0.3);
    rig.press(Realtime::FeedHold);
    rig.run_for(0.5);
    rig.press(Realtime::Reset);
    rig.run_for(0.5);
    let place = rig.place;
    rig.take_output();
    let reported = rig.reported("MPos");
    for axis in 0..AXES {
        assert!((reported[axis] - place[axis] as f64 / 250.0).abs() < 0.001, "{reported:?}, {place:?} steps");
    }
    rig.run_for(1.0);
    assert_eq!(rig.place, place);
    rig.run_clean("G91 G1 X1 F600\n");
    assert_eq!(rig.place[0] - place[0], 250);
}

/// Pieces of a long path. An index lists, for each cube of space, the pieces that pass through it. So the cost of a
/// lookup does not depend on the path's length.
struct Space {
    pieces: Vec<[Point; 2]>,
    cubes: HashMap<[i32; AXES], Vec<u32>>,
}

impl Space {
    /// Edge of the cubes into which [`Space`] divides space, mm. It is also the maximum distance that can be
    /// measured, because only a point's own cube and the adjacent ones are searched.
    const CUBE: f64 = 0.15;

    fn of(path: &[Point]) -> Space {
        let mut space = Space { pieces: Vec::new(), cubes: HashMap::new() };
        for pair in path.windows(2) {
            let index = space.pieces.len() as u32;
            space.pieces.push([pair[0], pair[1]]);
            for point in along(pair) {
                let cube = space.cubes.entry(Self::cube(&point)).or_default();
                if cube.last() != Some(&index) {
                    cube.push(index);
                }
            }
        }
        space
    }

    fn cube(point: &Point) -> [i32; AXES] {
        point.map(|mm| (mm / Self::CUBE).floor() as i32)
    }

    /// Returns the maximum distance of the points from the path, mm, but at most [`Space::CUBE`].
    fn farthest(&self, points: &[Point]) -> f64 {
        let mut most = 0.0_f64;
        for point in points {
            let [x, y, z] = Self::cube(point);
            // If a piece in the point's own cube is nearer than the maximum found so far, the point cannot raise the
            // maximum, and the neighbouring cubes need no search. This is so for most points.
            let nearest = |cube: [i32; AXES]| {
                let pieces = self.cubes.get(&cube).map_or(&[][..], Vec::as_slice);
                pieces.iter().map(|piece| from_line(*point, self.pieces[*piece as usize])).fold(Self::CUBE, f64::min)
            };
            if nearest([x, y, z]) <= most {
                continue;
            }
            let beside = (0..27).map(|k| [x + k % 3 - 1, y + k / 3 % 3 - 1, z + k / 9 - 1]);
            most = most.max(beside.map(nearest).fold(Self::CUBE, f64::min));
        }
        most
    }
}

/// Returns the end points of a program of G0 and G1 in absolute millimetres, starting with the origin.
fn points_of(text: &str) -> Vec<Point> {
    let mut points = vec![[0.0; AXES]];
    for line in text.lines().filter(|line| !line.starts_with('(')) {
        let mut point = points[points.len() - 1];
        for (axis, letter) in ['X', 'Y', 'Z'].into_iter().enumerate() {
            if let Some((_, rest)) = line.split_once(letter) {
                let number = rest.split(|c: char| c.is_ascii_alphabetic()).next().unwrap_or_default();
                point[axis] = number.parse().unwrap_or_else(|error| panic!("{line}: {error}"));
            }
        }
        points.push(point);
    }
    points
}

/// A whole long finishing job: with G64 P it takes less time, no step is farther than P from the path, and no point of
/// the path is farther than P from the steps.
#[test]
fn the_relief_of_the_examples_takes_less_time_and_stays_within_the_tolerance() {
    const P: f64 = 0.05;
    let text = examples::program("relief");
    let path = points_of(&text);
    let run = |words: &str| run(CARVER, &format!("{words}\n{text}"));
    let measure = |rig: &Rig| {
        let places = places(&rig.trace, CARVER_STEPS);
        let (of_path, of_places) = (Space::of(&path), Space::of(&places));
        (of_path.farthest(&places), of_places.farthest(&along(&path)))
    };
    let (exact, blended) = (run("G61"), run(&format!("G64 P{P}")));
    assert_eq!(blended.place, exact.place);
    let ((steps_exact, path_exact), (steps, path_off)) = (measure(&exact), measure(&blended));
    println!(
        "G61: {:.3} s, steps {steps_exact:.4} mm from the path, path {path_exact:.4} mm from the steps; G64 P{P}: {:.3} s, {steps:.4} and {path_off:.4} mm",
        seconds(&exact),
        seconds(&blended)
    );
    assert!(steps_exact.max(path_exact) <= 1.5 / CARVER_STEPS * 2.0_f64.sqrt(), "exact: {steps_exact} {path_exact}");
    // The rounding to steps is not added to P here, because moves this short never use all of P.
    assert!(steps.max(path_off) <= P, "{steps} and {path_off} mm, allowed {P}");
    assert!(seconds(&blended) < 0.99 * seconds(&exact), "{} s, exact {} s", seconds(&blended), seconds(&exact));
}

/// Runs a program line by line over a link that takes `line_s` seconds per line.
fn run_late(settings: &str, text: &str, line_s: f64) -> Rig {
    let mut rig = Rig::with(settings);
    for line in text.lines() {
        rig.send(format!("{line}\n").as_bytes());
        rig.run_for(line_s);
    }
    assert!(rig.run_until(1000.0, |rig| rig.is_idle()));
    rig
}

/// Length of a window, s. `greatest_jump` compares the mean speeds of two such windows. It replaces [`greatest_change`]
/// if the tool does not pass the vertices.
const WINDOW: f64 = 0.02;

/// Returns the largest change of an axis' mean speed from one window to the next, mm/s.
fn greatest_jump(trace: &[Pulse], steps_per_mm: f64) -> f64 {
    let mut most = 0.0_f64;
    for axis in 0..AXES {
        let mut place = [0; AXES];
        let mut steps = Vec::new();
        for pulse in trace {
            place = pulse.moved(place);
            if pulse.steps >> axis & 1 != 0 {
                steps.push((pulse.at as f64 / HZ as f64, place[axis] as f64 / steps_per_mm));
            }
        }
        let at = |time: f64| {
            let next = steps.partition_point(|(at, _)| *at <= time);
            match (next.checked_sub(1).map(|before| steps[before]), steps.get(next)) {
                (Some((t0, p0)), Some((t1, p1))) => p0 + (p1 - p0) * (time - t0) / (t1 - t0),
                (Some((_, place)), None) => place,
                (None, _) => 0.0,
            }
        };
        let end = trace.last().map_or(0.0, |pulse| pulse.at as f64 / HZ as f64);
        let mut time = trace.first().map_or(0.0, |pulse| pulse.at as f64 / HZ as f64);
        while time + 2.0 * WINDOW < end {
            let second = at(time + 2.0 * WINDOW) - 2.0 * at(time + WINDOW) + at(time);
            most = most.max(second.abs() / WINDOW);
            time += WINDOW / 4.0;
        }
    }
    most
}

/// Compares a run with a tolerance (`rig`) and a run without one (`exact`). Returns the ratio of the largest changes of
/// an axis' mean speed. Two steps per window are added to the divisor, because a step can fall into either of two
/// windows.
fn against(rig: &Rig, exact: &Rig, steps_per_mm: f64) -> f64 {
    greatest_jump(&rig.trace, steps_per_mm) / (greatest_jump(&exact.trace, steps_per_mm) + 2.0 / steps_per_mm / WINDOW)
}

/// The machine brakes for a bend even if the bend's lines arrive late. Without a tolerance no axis changes its speed by
/// more than allowed. With a tolerance the tool misses the vertices that `greatest_change` needs. So this run is
/// compared with the run without a tolerance over the same link.
#[test]
fn over_a_late_link_no_axis_changes_its_speed_faster() {
    let cases = std::env::var("OXMILL_BLENDED").ok().and_then(|cases| cases.parse().ok()).unwrap_or(25);
    let (mut random, mut greatest, mut faults) = (Random(23), [0.0_f64; 2], Vec::new());
    for case in 0..cases {
        let points = walk(&mut random);
        let (feed, p) = (random.within(20.0, 100.0), random.within(0.01, 0.2));
        let limits = limits(80.0);
        let settings = settings(&limits, 0.0);
        let (text, course) = program(&points, Style::mm(4), feed);
        let mean = points.windows(2).map(between).sum::<f64>() / points.len() as f64;
        let line_s = random.within(0.05, 2.0) * mean / feed;
        let (first, rest) = text.split_once('\n').unwrap();
        let run = |words: &str| run_late(&settings, &format!("{first}\n{words}\n{rest}"), line_s);
        let (exact, blended) = (run("G61"), run(&format!("G64 P{p:.4}")));
        let change = greatest_change(&exact.trace, HZ as f64, &course, &limits, 0.005);
        let change = change.unwrap_or_else(|error| panic!("case {case}: {error}")).ratio;
        let share = against(&blended, &exact, 80.0);
        greatest = [greatest[0].max(change), greatest[1].max(share)];
        if change > CHANGE || share > CHANGE {
            faults.push(format!(
                "case {case}, P{p}, {feed} mm/s, {line_s} s a line: {change}, with the tolerance {share}"
            ));
        }
    }
    println!("{cases} jobs: greatest change {:.3}, with a tolerance {:.3} of that", greatest[0], greatest[1]);
    assert!(faults.is_empty(), "{} of {cases}:\n{}", faults.len(), faults.join("\n"));
}

fn between(ends: &[Point]) -> f64 {
    (0..AXES).map(|axis| (ends[1][axis] - ends[0][axis]).powi(2)).sum::<f64>().sqrt()
}
