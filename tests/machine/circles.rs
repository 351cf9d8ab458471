//! G12 and G13 make the same steps at the same times as their moves written out: a straight line from the centre, a
//! full circle, and a straight line back.

use oxmill_simulator::{JobText, Options, Simulator, boards};
use proptest::prelude::*;
use std::fmt::Write;
use std::io::Cursor;

/// A circle: radius in 0.01 mm, `true` for clockwise, and feed in mm/min. The radius has no more than two decimals,
/// because the controller derives the precision of a line from the decimals of its axis words. Up to two decimals give
/// a precision of 0.01 mm. G12 has no axis word, so its precision is also 0.01 mm. With more decimals, the written-out
/// line from the centre would count as more precise than G12.
type Circle = (u32, bool, u32);

/// Writes a program of circles, each at another place, with G12 and G13 or with the same moves written out.
fn program(circles: &[Circle], turned: i32, mirrored: bool, written_out: bool) -> String {
    let mut text = format!("G21 G90 G17 G64 P0.05\nG68 X0 Y0 R{turned}\nF600\n");
    if mirrored {
        text += "G51 X0 Y0 I-1 J1\n";
    }
    for (number, (radius, clockwise, feed)) in circles.iter().enumerate() {
        let r = f64::from(*radius) / 100.0;
        let _ = writeln!(text, "G0 X{} Y{}\nG1 Z-{number} F{feed}", 3 * number, number);
        let _ = match (written_out, clockwise) {
            (false, true) => writeln!(text, "G12 I{r:.2}"),
            (false, false) => writeln!(text, "G13 I{r:.2}"),
            (true, _) => {
                let arc = if *clockwise { "G2" } else { "G3" };
                writeln!(text, "G91 G61 G1 X{r:.2}\n{arc} I-{r:.2}\nG1 X-{r:.2}\nG90 G64 P0.05")
            }
        };
    }
    text
}

/// Runs a program. Returns the digest of its steps and their times, and the final position in steps.
fn run(text: &str) -> (u64, u64, [i64; 3]) {
    let mut mill = Simulator::new(Options { board: boards::QEMU_MPS2, ..Options::default() });
    for setting in ["$120=300\n", "$121=200\n", "$110=4000\n", "$111=5000\n"] {
        mill.send(setting);
        mill.run_until_idle();
    }
    mill.take_output();
    mill.begin_job();
    mill.load_job(JobText::new(Cursor::new(text.as_bytes().to_vec())));
    assert!(mill.run_until_idle());
    let answers = mill.take_output();
    assert!(!answers.contains("error:"), "{answers}\n{text}");
    let digest = mill.trace().digest();
    (digest.time_hash(), digest.order_hash(), mill.machine().position().map(i64::from))
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(24))]
    #[test]
    fn circles_are_their_moves_written_out(
        circles in proptest::collection::vec((1u32..900, any::<bool>(), 60u32..4000), 1..6),
        turned in prop_oneof![Just(0), -180i32..180],
        mirrored in any::<bool>(),
    ) {
        // With a rotation, the points of the written-out lines are rounded to 0.1 nm one after the other. So the
        // circles after the first one would begin elsewhere, and only one circle is compared.
        let circles = if turned == 0 { &circles[..] } else { &circles[..1] };
        let [short, long] = [false, true].map(|written_out| run(&program(circles, turned, mirrored, written_out)));
        prop_assert_eq!(short, long, "{}", program(circles, turned, mirrored, false));
    }
}

/// Scaling can make a radius smaller than the smallest length, 0.1 nm. Such a circle is no motion.
#[test]
fn a_circle_without_a_radius_is_over_at_once() {
    let (_, _, place) = run("G21 G90 F100\nG51 X0 Y0 I0.0001 J0.0001\nG12 I0.0001\nG50\nG1 X1\n");
    assert_eq!(place, run("F100\nG1 X1\n").2);
}
