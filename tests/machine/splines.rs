//! Tests splines (G5, G5.1, G5.2) from G-code words to step pulses. The tests compute the exact curve from the same
//! words and check that the steps lie on this curve, also with scaling (G51), rotation (G68) and offsets.

use super::examples::places;
use super::host::{CARVER, CARVER_STEPS, assert_near};
use super::oracle::AXES;
use super::rig::{HZ, Rig};
use oxmill_controller::messages::Realtime;
use proptest::prelude::*;
use proptest::test_runner::RngSeed;
use std::fmt::Write;

type Point = [f64; 2];

/// Maximum distance of the steps from the curve, mm. It is the sum of three parts: the default arc tolerance `$12`,
/// the rounding to steps (1/2 + 1/14 = 4/7 of a step on each axis, see `motion_properties.rs`), and the error of the
/// polygon by which the test approximates the curve.
const MOST_OFF: f64 = 0.002 + std::f64::consts::SQRT_2 * 4.0 / 7.0 / CARVER_STEPS + 5e-4;

/// The G-code words of one curve, in thousandths of a millimetre: `target` is X and Y, `leaving` is I and J,
/// `arriving` is P and Q. `leaving` is `None` if the curve shall continue the previous curve smoothly, without I and
/// J. `quadratic`: G5.1, otherwise G5.
#[derive(Clone, Debug)]
struct Words {
    target: [i32; 2],
    leaving: Option<[i32; 2]>,
    arriving: [i32; 2],
    quadratic: bool,
}

/// Transformations of a program's coordinates: G91 (`incremental`), the origin of G54 in thousandths of a millimetre,
/// the factors and the centre of G51, and the angle of G68 in degrees.
#[derive(Clone, Debug)]
struct Frame {
    incremental: bool,
    origin: [i32; 2],
    factors: [f64; 2],
    centre: [i32; 2],
    angle: f64,
}

fn mm(microns: [i32; 2]) -> Point {
    microns.map(|value| f64::from(value) / 1000.0)
}

impl Frame {
    fn scale(&self, way: Point) -> Point {
        [way[0] * self.factors[0], way[1] * self.factors[1]]
    }

    /// Transforms a distance from program to machine coordinates.
    fn way(&self, way: Point) -> Point {
        let ([x, y], (sine, cosine)) = (self.scale(way), self.angle.to_radians().sin_cos());
        [x * cosine - y * sine, x * sine + y * cosine]
    }

    /// Transforms a position to machine coordinates: scaled about the centre, rotated about the origin.
    fn place(&self, written: Point) -> Point {
        let (centre, origin) = (mm(self.centre), mm(self.origin));
        let (sine, cosine) = self.angle.to_radians().sin_cos();
        let from = self.scale([written[0] - centre[0], written[1] - centre[1]]);
        let (x, y) = (centre[0] + from[0], centre[1] + from[1]);
        [origin[0] + x * cosine - y * sine, origin[1] + x * sine + y * cosine]
    }

    fn setup(&self) -> String {
        let ([x, y], [cx, cy], [i, j]) = (mm(self.origin), mm(self.centre), self.factors);
        format!(
            "F3000\nG10 L2 P1 X{x} Y{y} Z0\nG68 X0 Y0 R{}\nG51 X{cx} Y{cy} I{i} J{j}\nG90 G0 X0 Y0\n{}\n",
            self.angle,
            if self.incremental { "G91" } else { "G90" }
        )
    }
}

/// Returns a program with these curves, and for each curve the four control points that it must have in machine
/// coordinates.
fn meant(frame: &Frame, curves: &[Words]) -> (String, Vec<[Point; 4]>) {
    let mut text = frame.setup();
    let mut chain: Vec<[Point; 4]> = Vec::new();
    let (mut written, mut smooth) = ([0.0; 2], false);
    for words in curves {
        let start = frame.place(written);
        let to = mm(words.target);
        written = if frame.incremental { [written[0] + to[0], written[1] + to[1]] } else { to };
        let end = frame.place(written);
        let plus = |a: Point, b: Point| [a[0] + b[0], a[1] + b[1]];
        write!(text, "{} X{} Y{}", if words.quadratic { "G5.1" } else { "G5" }, to[0], to[1]).unwrap();
        let before = chain.last().filter(|_| smooth && !words.quadratic && words.leaving.is_none());
        smooth = !words.quadratic;
        let leaving = match before {
            Some([.., third, last]) => [2.0 * last[0] - third[0], 2.0 * last[1] - third[1]],
            None => {
                let way = mm(words.leaving.unwrap_or(words.arriving));
                write!(text, " I{} J{}", way[0], way[1]).unwrap();
                plus(start, frame.way(way))
            }
        };
        chain.push(if words.quadratic {
            let thirds = |near: Point, far: Point| [(near[0] + 2.0 * far[0]) / 3.0, (near[1] + 2.0 * far[1]) / 3.0];
            [start, thirds(start, leaving), thirds(end, leaving), end]
        } else {
            let way = mm(words.arriving);
            write!(text, " P{} Q{}", way[0], way[1]).unwrap();
            [start, leaving, plus(end, frame.way(way)), end]
        });
        text.push('\n');
    }
    (text, chain)
}

fn exact(points: &[Point; 4], t: f64) -> Point {
    let s = 1.0 - t;
    let weights = [s * s * s, 3.0 * s * s * t, 3.0 * s * t * t, t * t * t];
    std::array::from_fn(|axis| weights.iter().zip(points).map(|(weight, point)| weight * point[axis]).sum())
}

fn from_piece(point: Point, a: Point, b: Point) -> f64 {
    let (way, to) = ([b[0] - a[0], b[1] - a[1]], [point[0] - a[0], point[1] - a[1]]);
    let square = way[0] * way[0] + way[1] * way[1];
    let share = if square > 0.0 { ((to[0] * way[0] + to[1] * way[1]) / square).clamp(0.0, 1.0) } else { 0.0 };
    (point[0] - a[0] - way[0] * share).hypot(point[1] - a[1] - way[1] * share)
}

/// Checks that each position of a trace is near the curve, and that the positions advance along the curve.
fn follows(places: &[[f64; AXES]], chain: &[[Point; 4]]) -> Result<(), String> {
    const PIECES: u32 = 600;
    let at = |k: u32, curve| exact(curve, f64::from(k) / f64::from(PIECES));
    let points: Vec<Point> = chain.iter().flat_map(|curve| (0..=PIECES).map(move |k| at(k, curve))).collect();
    let mut piece = 0;
    for place in places {
        let off = |k: usize| from_piece([place[0], place[1]], points[k], points[k + 1]);
        // Search forward for the first piece of the polygon that is near enough. The search starts 20 pieces (about a
        // step) before the piece found last.
        let first = piece - piece.min(20);
        match (first..points.len() - 1).find(|k| off(*k) <= MOST_OFF) {
            Some(found) => piece = piece.max(found),
            None => return Err(format!("{place:?} is off the curve behind {:?}", points[piece])),
        }
    }
    Ok(())
}

fn words() -> impl Strategy<Value = Words> {
    let way = || prop::array::uniform2(-15_000..15_000);
    (way(), prop::option::weighted(0.6, way()), way(), prop::bool::weighted(0.3))
        .prop_map(|(target, leaving, arriving, quadratic)| Words { target, leaving, arriving, quadratic })
}

fn frame() -> impl Strategy<Value = Frame> {
    let factor = || prop_oneof![Just(1.0), Just(-1.0), (20..200).prop_map(|percent| f64::from(percent) / 100.0)];
    let place = || prop::array::uniform2(-20_000..20_000);
    let angle = prop_oneof![Just(0.0), Just(90.0), (-180..180).prop_map(f64::from)];
    (any::<bool>(), place(), (factor(), factor()), place(), angle).prop_map(
        |(incremental, origin, (i, j), centre, angle)| Frame { incremental, origin, factors: [i, j], centre, angle },
    )
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 24, rng_seed: RngSeed::Fixed(24), ..ProptestConfig::default() })]

    /// The steps lie on the exact curves and stop at the end of the last curve, even if a feed hold and a feed
    /// override occur on the way.
    #[test]
    fn the_steps_of_splines_follow_the_exact_curves(
        frame in frame(), curves in prop::collection::vec(words(), 1..5), hold in 0.1_f64..2.0,
    ) {
        let (text, chain) = meant(&frame, &curves);
        let mut rig = Rig::with(CARVER);
        rig.run_clean(&frame.setup());
        let start = rig.place_mm(CARVER_STEPS);
        rig.trace.clear();
        let curves_only = &text[frame.setup().len()..];
        rig.send(curves_only.as_bytes());
        rig.run_for(hold);
        rig.press(Realtime::FeedHold);
        rig.run_for(0.4);
        rig.press(Realtime::FeedUp10);
        rig.press(Realtime::CycleStart);
        prop_assert!(rig.run_until(600.0, |rig| rig.is_idle()));
        prop_assert!(!rig.take_output().contains("error"), "{text}");
        let end = chain.last().map(|curve| curve[3]).unwrap();
        assert_near(rig.place_mm(CARVER_STEPS), [end[0], end[1], 0.0], 0.5 / CARVER_STEPS + 1e-6);
        let steps = places(&rig.trace, start, [CARVER_STEPS; AXES]);
        // `places` adds the steps to `start`. `start` is a whole number of steps, so it can be half a step away from
        // the exact start of the curve.
        if let Err(why) = follows(&steps, &chain) {
            prop_assert!(false, "{why}\n{text}");
        }
    }
}

/// Returns the virtual seconds from the first to the last step of a program.
fn seconds(program: &str) -> f64 {
    let mut rig = Rig::with(CARVER);
    rig.run_clean(program);
    (rig.trace[rig.trace.len() - 1].at - rig.trace[0].at) as f64 / HZ as f64
}

/// A circle of four splines takes the time of an arc. With some radii and feeds the feed limits the speed, with
/// others the curvature.
#[test]
fn a_circle_of_splines_takes_the_time_of_an_arc() {
    for (radius, feed) in [(10.0, 1200), (10.0, 6000), (3.0, 6000), (30.0, 6000)] {
        let h = radius * 0.552_284_75;
        let splines = format!(
            "F{feed}\nG91\nG5 X-{radius} Y{radius} I0 J{h} P{h} Q0\nG5 X-{radius} Y-{radius} P0 Q{h}\nG5 X{radius} Y-{radius} P-{h} Q0\n\
             G5 X{radius} Y{radius} P0 Q-{h}\n"
        );
        let arc = seconds(&format!("F{feed}\nG3 I-{radius}\n"));
        let found = seconds(&splines);
        assert!((found / arc - 1.0).abs() < 0.02, "{found} s, the arc {arc} s, radius {radius} at F{feed}");
        let length = std::f64::consts::TAU * radius;
        assert!(found > length / (f64::from(feed) / 60.0) && found > length / (500.0 * radius).sqrt(), "{found} s");
    }
}

/// With G93 the whole curve takes the time given by F. The ramps at its ends add some time.
#[test]
fn inverse_time() {
    let found = seconds("G93\nG5 X30 Y0 I10 J20 P-10 Q20 F6\n");
    assert!((9.99..10.1).contains(&found), "{found} s");
}

/// A circle of four NURBS quarters (G5.2). The corner point of each quarter has the weight √(1/2). The steps lie on
/// the circle, end at its end, and take the time of an arc.
#[test]
fn a_circle_of_control_points_is_the_circle() {
    for (radius, feed) in [(10.0, 1200), (3.0, 6000), (30.0, 6000)] {
        let quarter = |[a, b]: Point, [c, d]: Point| format!("G5.2 P1 L3\nX{a} Y{b} P.7071068\nX{c} Y{d} P1\nG5.3\n");
        let r: f64 = radius;
        let circle = quarter([r, r], [0.0, r])
            + &quarter([-r, r], [-r, 0.0])
            + &quarter([-r, -r], [0.0, -r])
            + &quarter([r, -r], [r, 0.0]);
        let mut rig = Rig::with(CARVER);
        rig.run_clean(&format!("F{feed}\nG0 X{r}\n"));
        let start = rig.place_mm(CARVER_STEPS);
        rig.trace.clear();
        rig.send(circle.as_bytes());
        assert!(rig.run_until(600.0, |rig| rig.is_idle()));
        assert!(!rig.take_output().contains("error"));
        assert_near(rig.place_mm(CARVER_STEPS), [r, 0.0, 0.0], 0.5 / CARVER_STEPS + 1e-6);
        let found = (rig.trace[rig.trace.len() - 1].at - rig.trace[0].at) as f64 / HZ as f64;
        for [x, y, _] in places(&rig.trace, start, [CARVER_STEPS; AXES]) {
            assert!((x.hypot(y) - r).abs() < MOST_OFF, "{x} {y} on a circle of {r}");
        }
        let arc = seconds(&format!("F{feed}\nG3 I-{r}\n"));
        // The controller halves a curve until the chords are close enough to the curve. So the chords are less even
        // than the chords of an arc, and a small circle has few chords. Up to 6 % more time is allowed.
        assert!((0.99..1.06).contains(&(found / arc)), "{found} s, the arc {arc} s, radius {r} at F{feed}");
    }
}
