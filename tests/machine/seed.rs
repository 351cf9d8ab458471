//! The worked examples of S. Tajima's analysis of Grbl (2020), the document that this controller started from. Checks
//! by counted pulses which positions the machine passes through. Where the text omits a feed, one is added.

use super::host::{CARVER, CARVER_STEPS, assert_near};
use super::oracle::{AXES, Circle};
use super::rig::Rig;

/// Half a step of the machine, mm.
const HALF_STEP: f64 = 0.5 / CARVER_STEPS + 1e-9;

/// Carries out each line and compares the position of the machine at rest after it; `None`: not compared.
fn walk(rig: &mut Rig, steps: &[(&str, Option<[f64; AXES]>)]) {
    for (line, expected) in steps {
        rig.carry_out(line);
        if let Some(expected) = expected {
            println!("{line}");
            assert_near(rig.place_mm(CARVER_STEPS), *expected, HALF_STEP);
        }
    }
}

fn work(rig: &mut Rig) -> [f64; AXES] {
    rig.carry_out("$10=0");
    let place = rig.reported("WPos");
    rig.carry_out("$10=1");
    place
}

#[test]
fn chapter_2_2_1_the_motion_word_stays_in_force() {
    let mut rig = Rig::with(CARVER);
    walk(
        &mut rig,
        &[
            ("G1 X10 Y20 F50", Some([10.0, 20.0, 0.0])),
            ("X5 Y15", Some([5.0, 15.0, 0.0])),
            ("X15 Y-10", Some([15.0, -10.0, 0.0])),
            ("Z -10", Some([15.0, -10.0, -10.0])),
            ("G1 X20 Y0 F10", Some([20.0, 0.0, -10.0])),
            ("X40 Y10", Some([40.0, 10.0, -10.0])),
            ("X-20 Y0", Some([-20.0, 0.0, -10.0])),
            ("Z -10", Some([-20.0, 0.0, -10.0])),
            ("X50 Y30", Some([50.0, 30.0, -10.0])),
        ],
    );
}

/// After G55, `X5 Y15` moves in the coordinates of G55, with and without the motion word that the document recommends.
#[test]
fn chapter_2_2_1_another_system_between_moves() {
    for first in ["X5 Y15", "G1 X5 Y15"] {
        let mut rig = Rig::with(CARVER);
        walk(
            &mut rig,
            &[
                ("G10 L2 P2 X100 Y-50 Z5", None),
                ("G1 X10 Y20 F50", Some([10.0, 20.0, 0.0])),
                ("G55", Some([10.0, 20.0, 0.0])),
                (first, Some([105.0, -35.0, 0.0])),
                ("X15 Y-10", Some([115.0, -60.0, 0.0])),
                ("Z -10", Some([115.0, -60.0, -5.0])),
            ],
        );
    }
}

/// G10 L20 is not modal: it acts only in its own line, but the offset that it sets remains.
#[test]
fn chapter_2_2_1_g10_l20_is_of_its_line() {
    let mut rig = Rig::with(CARVER);
    walk(&mut rig, &[("G10 L20 P1 X10 Y0", Some([0.0; AXES]))]);
    assert_eq!(work(&mut rig), [10.0, 0.0, 0.0]);
    walk(&mut rig, &[("G1 X20 Y5 F600", Some([10.0, 5.0, 0.0])), ("X0 Y0", Some([-10.0, 0.0, 0.0]))]);
}

/// An arc without its radius is an error: the radius of the arc before it is not used again.
#[test]
fn chapter_2_2_1_an_arc_needs_its_radius() {
    let mut rig = Rig::with(CARVER);
    walk(&mut rig, &[("G1 F600", None), ("G2 X20 Y0 R30", Some([20.0, 0.0, 0.0]))]);
    assert_eq!(rig.ask("X40 Y10"), ["[MSG:I and J are missing in G2, or R: the plane is G17]", "error:35"]);
    assert_near(rig.place_mm(CARVER_STEPS), [20.0, 0.0, 0.0], HALF_STEP);
}

#[test]
fn chapter_2_2_2_words_of_several_groups_share_a_line() {
    for lines in [["G55", "G1 X40 Y10 F600"], ["G1 F600", "G55 G1 X40 Y10"]] {
        let mut rig = Rig::with(CARVER);
        let [first, second] = lines;
        walk(&mut rig, &[("G10 L2 P2 X3 Y4", None), (first, Some([0.0; AXES])), (second, Some([43.0, 14.0, 0.0]))]);
        // One word per modal group is allowed; two motion words have an error of their own.
        let told = |pair: &str| format!("[MSG:{pair} in one line: write one of them, or two lines]");
        assert_eq!(rig.ask("G54 G55"), [told("G54 and G55").as_str(), "error:21"]);
        assert_eq!(rig.ask("G0 G1 X1"), [told("G0 and G1").as_str(), "error:24"]);
    }
}

#[test]
fn chapter_2_3_4_g91_1_beside_a_move() {
    let mut rig = Rig::with(CARVER);
    walk(&mut rig, &[("G91.1 G0 X5 Y10", Some([5.0, 10.0, 0.0]))]);
}

#[test]
fn chapter_2_2_3_example_1_g53_within_g91() {
    let mut rig = Rig::with(CARVER);
    walk(
        &mut rig,
        &[
            ("N1 G54", None),
            ("N10 G91", None),
            ("N11 G1 X10 Y20 F600", Some([10.0, 20.0, 0.0])),
            ("N12 G53 X0", Some([0.0, 20.0, 0.0])),
            ("N13 X30", Some([30.0, 20.0, 0.0])),
        ],
    );
}

#[test]
fn chapter_2_2_3_example_2_dwell_keeps_g0() {
    let mut rig = Rig::with(CARVER);
    walk(&mut rig, &[("N1 G90", None), ("N2 G54", None), ("N10 G0 X30 Y40", Some([30.0, 40.0, 0.0]))]);
    let before = rig.seconds();
    walk(&mut rig, &[("N20 G4 P2", Some([30.0, 40.0, 0.0]))]);
    let waited = rig.seconds() - before;
    // The controller's clock has a resolution of one microsecond.
    assert!((1.999_99..2.1).contains(&waited), "{waited}");
    walk(&mut rig, &[("N30 X20 Y50", Some([20.0, 50.0, 0.0]))]);
    assert!(rig.ask("$G").iter().any(|line| line.starts_with("[GC:G0 ")));
}

#[test]
fn chapter_2_2_3_example_3_g10_l20_then_incremental() {
    let mut rig = Rig::with(CARVER);
    walk(&mut rig, &[("N1 G54 G91", None), ("N2 G10 L20 P1 X-10 Y-8", Some([0.0, 0.0, 0.0]))]);
    assert_near(work(&mut rig), [-10.0, -8.0, 0.0], 0.0);
    walk(&mut rig, &[("N10 G0 X30 Y40", Some([30.0, 40.0, 0.0])), ("N20 G4 P2", None)]);
    assert_near(work(&mut rig), [20.0, 32.0, 0.0], 0.0);
    walk(&mut rig, &[("N30 X20 Y50", Some([50.0, 90.0, 0.0]))]);
    assert_near(work(&mut rig), [40.0, 82.0, 0.0], 0.0);
}

/// The document takes the second G92 for the inverse of the first. In Grbl, and here, the second G92 sets the position
/// to its own values, like the first. G92.1 undoes both.
#[test]
fn chapter_2_2_3_example_4_g92_sets_the_place() {
    let mut rig = Rig::with(CARVER);
    walk(&mut rig, &[("N1 G54 G91", None), ("N2 G92 X-10 Y-8", Some([0.0, 0.0, 0.0]))]);
    assert_near(work(&mut rig), [-10.0, -8.0, 0.0], 0.0);
    walk(&mut rig, &[("N10 G0 X30 Y40", Some([30.0, 40.0, 0.0]))]);
    assert_near(work(&mut rig), [20.0, 32.0, 0.0], 0.0);
    walk(&mut rig, &[("N20 G92 X10 Y8", Some([30.0, 40.0, 0.0]))]);
    assert_near(work(&mut rig), [10.0, 8.0, 0.0], 0.0);
    walk(&mut rig, &[("G92.1", Some([30.0, 40.0, 0.0]))]);
    assert_near(work(&mut rig), [30.0, 40.0, 0.0], 0.0);
}

#[test]
fn chapter_2_2_5_incremental_with_g53_between() {
    let mut rig = Rig::with(CARVER);
    walk(
        &mut rig,
        &[
            ("N1 G54 G91", None),
            ("N2 G1 X-10 Y-8 F50", Some([-10.0, -8.0, 0.0])),
            ("N10 G53 X0 Y0", Some([0.0, 0.0, 0.0])),
            ("N20 Z10", Some([0.0, 0.0, 10.0])),
            ("N30 X20 Y50", Some([20.0, 50.0, 10.0])),
        ],
    );
}

#[test]
fn chapter_2_2_5_the_house() {
    let mut rig = Rig::with(CARVER);
    walk(
        &mut rig,
        &[
            ("N1 G90", None),
            ("N2 G54", None),
            ("N10 G1 X20.0 Y20.0 Z0 F10", Some([20.0, 20.0, 0.0])),
            ("N11 X20 Y0.0 Z0", Some([20.0, 0.0, 0.0])),
            ("N12 X0 Y0", Some([0.0, 0.0, 0.0])),
            ("N13 X0.0 Y20 Z0", Some([0.0, 20.0, 0.0])),
            ("N14 X20 Y20.0 Z0 F20", Some([20.0, 20.0, 0.0])),
            ("N15 X10.0 Y25.0 Z0", Some([10.0, 25.0, 0.0])),
            ("N16 X0.0 Y20.0 Z0", Some([0.0, 20.0, 0.0])),
        ],
    );
}

#[test]
fn chapter_2_7_work_is_machine_less_system_less_g92() {
    let mut rig = Rig::with(CARVER);
    walk(&mut rig, &[("G10 L2 P1 X-100 Y-70", None), ("G53 G0 X-90 Y-60", Some([-90.0, -60.0, 0.0]))]);
    assert_near(work(&mut rig), [10.0, 10.0, 0.0], 0.0);
    // G92 adds an offset of (5, 5): the position that was reported as (10, 10) must then be reported as (5, 5).
    rig.carry_out("G92 X5 Y5");
    assert!(rig.ask("$#").contains(&"[G92:5.000,5.000,0.000]".to_string()));
    assert_near(work(&mut rig), [5.0, 5.0, 0.0], 0.0);
    walk(&mut rig, &[("G0 X0 Y0", Some([-95.0, -65.0, 0.0])), ("G92.1", None)]);

    rig.carry_out("G10 L2 P1 X3.5 Y17.2");
    walk(&mut rig, &[("G0 X0 Y0", Some([3.5, 17.2, 0.0]))]);
    rig.carry_out("G10 L2 P1 X0 Y0 Z0");
    assert_near(work(&mut rig), [3.5, 17.2, 0.0], 0.0);
    // Offset of the system = machine position - value of G10 L20 - offset of G92. Here 3.5 - 1.5 - 2 = 0.
    rig.carry_out("G92 X1.5");
    rig.carry_out("G10 L20 P1 X1.5");
    assert!(rig.ask("$#").contains(&"[G54:0.000,0.000,0.000]".to_string()));
    assert_near(work(&mut rig), [1.5, 17.2, 0.0], 0.0);
}

/// The document says that G10 L2 has no effect in G91. But in Grbl and in the NIST standard it has an effect.
#[test]
fn chapter_2_7_g10_l2_works_in_g91() {
    let mut rig = Rig::with(CARVER);
    walk(&mut rig, &[("G91", None), ("G10 L2 P1 X4", None), ("G90 G0 X1", Some([5.0, 0.0, 0.0]))]);
}

#[test]
fn chapter_2_3_14_after_g92_the_place_reads_its_values() {
    let mut rig = Rig::with(CARVER);
    rig.carry_out("G92 X10 Y25 Z0");
    assert_near(work(&mut rig), [10.0, 25.0, 0.0], 0.0);
    let told = "[MSG:G92 and G0 in one line: both want the axis words, write two lines]";
    assert_eq!(rig.ask("G92 G0 X0 Y0 Z0"), [told, "error:24"]);
}

/// First lines of the listing in 2.10.1, as printed, with comments in Japanese. `ONE_CIRCLE` has the lines for a
/// circle. Its feed is raised: the document has 1 mm/min.
const FIVE_CIRCLES: &str = "G10 L2 P1 X0 Y0 Z0 (座標 G54 の原点をマシン原点に設定)
G10 L2 P2 X10 (G55 を X=10mm オフセット)
G10 L2 P3 X-10 (G56 を X= -10mm オフセット)
G10 L2 P4 Y10 (G57 を Y=10mm オフセット)
G10 L2 P5 Y-10 (G58 を Y= -10mm オフセット)
";
const ONE_CIRCLE: &str = " G0 X-2.0 Y0 Z0
G1 F120 Z-1.00(Z 軸を下に 1mm 移動)
G3 X-10.0 Y0 I1.0 J0(座標 (-10, 0) の点に 1mm の深さで円を描画)
G0 Z0 (Z 軸を Z=0 に移動)
";

/// Centres of the five circles: each has a radius of 1 mm and starts at X-2 of its coordinate system.
pub const CENTRES: [[f64; 2]; 5] = [[-1.0, 0.0], [9.0, 0.0], [-11.0, 0.0], [-1.0, 10.0], [-1.0, -10.0]];

/// Removes all bytes beyond ASCII, as a file reader does. The document's listings are files, and their comments have
/// such bytes. On a serial line these bytes could be realtime commands.
fn as_file(text: &str) -> String {
    text.chars().filter(char::is_ascii).collect()
}

#[test]
fn chapter_2_10_1_five_circles_as_printed() {
    let mut rig = Rig::with(CARVER);
    rig.carry_out("$900=2");
    rig.run_clean(&as_file(FIVE_CIRCLES));
    for (system, centre) in ["G54", "G55", "G56", "G57", "G58"].iter().zip(CENTRES) {
        let text = as_file(&format!("{system}{ONE_CIRCLE}"));
        let mut lines = text.lines();
        for line in lines.by_ref().take(2) {
            rig.carry_out(line);
        }
        let from = rig.place_mm(CARVER_STEPS);
        assert_near(from, [centre[0] - 1.0, centre[1], -1.0], HALF_STEP);
        rig.trace.clear();
        rig.carry_out(lines.next().expect("the arc"));
        let places = super::examples::places(&rig.trace, from, [CARVER_STEPS; AXES]);
        Circle { axes: [0, 1, 2], centre, from, to: from, clockwise: false }
            .follows(&places, 0.002 + 1.25 / CARVER_STEPS, 3.0 / CARVER_STEPS)
            .unwrap();
        assert_near(rig.place_mm(CARVER_STEPS), from, 0.0);
        rig.carry_out(lines.next().expect("up"));
    }
    assert_eq!(rig.ask("M2"), ["[MSG:Pgm End]", "ok"]);
}

#[test]
fn chapter_2_10_1_five_circles_as_printed_are_refused_by_the_other_dialects() {
    for dialect in ["$900=0", "$900=1"] {
        let mut rig = Rig::with(CARVER);
        rig.carry_out(dialect);
        // Leave out the comments, because they contain nested parentheses.
        let text: String = format!("{FIVE_CIRCLES}G54{ONE_CIRCLE}")
            .lines()
            .map(|line| line.split('(').next().unwrap_or_default().to_string() + "\n")
            .collect();
        let answers = rig.run_program(&text);
        let errors: Vec<_> = answers.iter().filter(|a| a.starts_with("error:")).collect();
        assert_eq!(errors, ["error:33"], "{dialect}");
        assert_eq!(rig.place, [-160, 0, 0]);
    }
}

/// Section 2.3.4 (2): the given end point is off the circle. In the dialect `$900=2` the arc ends where the line from
/// its centre to the given point crosses the circle. The default dialect rejects the line.
#[test]
fn chapter_2_3_4_an_arc_to_a_point_off_the_circle() {
    let line = "G02 X-30 Y-40 I-10 J-15 F500";
    let mut rig = Rig::with(CARVER);
    let told = "[MSG:the radius of G2 is 18.028 mm at its start, 32.016 at its end. Write I-10.000 J-23.750, or I-21.667 J-15.000]";
    assert_eq!(rig.ask(line), [told, "error:33"]);
    rig.carry_out("$900=2");
    rig.carry_out(line);
    let radius = 325.0_f64.sqrt();
    let ray = [-20.0, -25.0];
    let length = 1025.0_f64.sqrt();
    let end = [-10.0 + ray[0] / length * radius, -15.0 + ray[1] / length * radius, 0.0];
    assert_near(rig.place_mm(CARVER_STEPS), end, HALF_STEP + 0.001);
    let places = super::examples::places(&rig.trace, [0.0; AXES], [CARVER_STEPS; AXES]);
    Circle { axes: [0, 1, 2], centre: [-10.0, -15.0], from: [0.0; AXES], to: end, clockwise: true }
        .follows(&places, 0.002 + 1.25 / CARVER_STEPS, 3.0 / CARVER_STEPS)
        .unwrap();
}

/// Figure 6.2 and the example of 7.1, on the step outputs of a machine with one step per millimetre. The controller
/// smooths the steps of so slow an axis: a step of Y comes at the next sixteenth of a step of X. This is within the
/// tick (step of X) that the figure shows.
#[test]
fn chapters_6_and_7_the_steps_of_the_minor_axis() {
    // Step m of Y is due when X has made (m - 1/2) × X / Y steps, where X and Y are the lengths of the line in steps.
    // If that is exactly a sixteenth of a step of X, Y steps at the next sixteenth.
    for (line, ticks, sixteenths) in
        [("G1 X10 Y3 F600", [2, 6, 9], [27, 81, 134]), ("G1 X9 Y3 F600", [2, 5, 8], [25, 73, 121])]
    {
        let mut rig = Rig::with("$100=1\n$101=1\n$102=1\n$110=6000\n$111=6000\n$120=1000000\n$121=1000000\n");
        rig.carry_out(line);
        let times = |bit: u8| -> Vec<f64> {
            let stepping = rig.trace.iter().filter(|p| p.steps & bit != 0);
            stepping.map(|p| p.at as f64).collect()
        };
        let (x, y) = (times(1), times(2));
        // X itself steps one sixteenth after it is half way to its next step: at 9, 25, 41 sixteenths and so on.
        let step = (x[7] - x[1]) / 6.0;
        let places: Vec<f64> = y.iter().map(|t| (t - x[1]) / step * 16.0 + 25.0).collect();
        for ((place, sixteenth), tick) in places.iter().zip(sixteenths).zip(ticks) {
            assert!((place - f64::from(sixteenth)).abs() < 0.1, "{line}: {places:?}");
            assert_eq!((place / 16.0 - 0.01).ceil() as i32, tick, "{line}: {places:?}");
        }
        assert_eq!(y.len(), 3);
    }
}
