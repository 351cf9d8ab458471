//! Short moves that continue a line.

use super::super::Speed;
use super::rig::{Rig, settings, to};

/// Ends of moves along a straight line, rounded to a digit.
fn chords(length: f64, angle: f64, chord: f64, digit: f64) -> impl Iterator<Item = [f64; 3]> {
    let (y, x) = angle.to_radians().sin_cos();
    let count = (length / chord).round();
    (1..=count as u32).map(move |k| {
        let along = length * f64::from(k) / count;
        [x * along, y * along, 0.0].map(|v| (v / digit).round() * digit)
    })
}

#[test]
fn debug_case() {
    let mut rig = Rig::<3, 512>::new(settings(80.0, 100.0, 500.0));
    for p in chords(20.0, 33.0, 0.005, 0.001) {
        rig.moves.push_back(to(p, Speed::Feed(100.0)));
    }
    rig.run();
    println!("{} s, {} blocks", rig.seconds(), rig.blocks.len());
    let lengths: Vec<f64> = rig.blocks.iter().map(|b| (b.length * 1e4).round() / 1e4).collect();
    println!("{lengths:?}");
}
