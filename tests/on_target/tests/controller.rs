//! Tests that the controller gives the same answers and steps on the target as on a host.
#![no_std]
#![no_main]
#![allow(missing_docs, reason = "code that defmt-test generates")]

use oxmill_on_target as _;

#[defmt_test::tests]
mod suite {
    use oxmill_controller::Received;
    use oxmill_controller::messages::Realtime;
    use oxmill_controller::units::{Coordinate, Decimal, StepsPerMm};
    use oxmill_on_target::rig::Rig;

    #[test]
    fn realtime_commands_are_split_from_lines() {
        let mut line: heapless::Vec<u8, 16> = heapless::Vec::new();
        let mut holds = 0;
        for byte in b"G1!X\x852\n" {
            match Received::of(*byte) {
                Received::Line(b) => line.push(b).unwrap(),
                Received::Realtime(Realtime::FeedHold) => holds += 1,
                _ => {}
            }
        }
        defmt::assert_eq!(line.as_slice(), b"G1X2\n");
        defmt::assert_eq!(holds, 1);
    }

    #[test]
    fn millimetres_become_steps_by_integer_arithmetic() {
        // The target divides 64-bit numbers in software. The results must be exact.
        for (per_mm, tenth_nm, steps) in [
            (250.0, 10_000_000_i64, 250),
            (80.0, 62_500, 1),
            (80.0, 62_499, 0),
            (80.0, -62_500, -1),
            (314.961, 254_000_000, 8_000),
            (40_000.0, 500_000_000_000 - 1, 2_000_000_000),
        ] {
            let scale = StepsPerMm::new(per_mm).unwrap();
            defmt::assert_eq!(scale.steps(Coordinate(tenth_nm)), steps);
        }
        defmt::assert_eq!(Coordinate::from_inches(Decimal(10_000_000)).0, 254_000_000);
    }

    /// Each axis must stay within half a step of its position on the straight line. For a line to (dx, dy) it follows
    /// that |x dy - y dx| <= (|dx| + |dy|) / 2 at each position (x, y). The test uses the bound max(|dx|, |dy|), which
    /// is at least as large and a whole number.
    #[test]
    fn a_line_stays_within_half_a_step_of_itself() {
        for (program, dx, dy) in [
            ("G91G1X1Y0.5F600\n", 250_i64, 125_i64),
            ("G91G1X0.7Y-1.3F900\n", 175, -325),
            ("G91G1X-0.02Y3F900\n", -5, 750),
        ] {
            let mut rig = Rig::new();
            let mut worst = 0;
            rig.run(program, |[x, y, z]| {
                worst = worst.max((i64::from(x) * dy - i64::from(y) * dx).abs());
                defmt::assert_eq!(z, 0);
            });
            defmt::assert_eq!(rig.net, [dx as i32, dy as i32, 0]);
            defmt::assert_eq!(rig.position().0, rig.net);
            defmt::assert_eq!(rig.answers, (1, 0));
            defmt::assert!(worst <= dx.abs().max(dy.abs()), "{} of {}", worst, dx.abs().max(dy.abs()));
        }
    }

    #[test]
    fn a_job_with_arcs_comes_back_and_repeats_bit_for_bit() {
        let job = "G21G91F800\nG1X2\nG2X1Y1I1J0\nG3X-1Y-1I0J-1\nG1X-2Z0.5\nZ-0.5\n";
        // One run after the other, because there is storage for only one controller.
        let first = Rig::outcome(job);
        let second = Rig::outcome(job);
        let (net, _, answers) = first;
        defmt::assert_eq!(net, [0, 0, 0]);
        defmt::assert_eq!(first, second);
        defmt::assert_eq!(answers, (6, 0));
    }

    #[test]
    fn increments_do_not_drift() {
        let mut rig = Rig::new();
        for _ in 0..100 {
            rig.run(
                "G91G1X0.001F600\nX0.001\nX0.001\nX0.001\nX0.001\nX0.001\nX0.001\nX0.001\nX0.001\nX0.001\n",
                |_| {},
            );
        }
        defmt::assert_eq!(rig.net, [250, 0, 0]);
    }

    #[test]
    fn a_bad_line_is_refused_and_moves_nothing() {
        let mut rig = Rig::new();
        rig.run("G1X1\nG1X1F1X2\nG999\nX\n", |_| {});
        defmt::assert_eq!(rig.net, [0, 0, 0]);
        defmt::assert_eq!(rig.answers, (0, 4));
    }
}
