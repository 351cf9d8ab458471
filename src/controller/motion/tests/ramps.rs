//! Ramps with bounded jerk.

use super::super::Speed;
use super::rig::{Rig, settings, to};
use crate::axes::PerAxis;

fn machine<const B: usize>(jerk: f32) -> Rig<3, B> {
    let mut config = settings(80.0, 500.0, 500.0);
    config.jerk = PerAxis::all(jerk);
    Rig::new(config)
}

#[test]
fn dump() {
    let blocks: u32 = std::env::var("BLOCKS").ok().and_then(|b| b.parse().ok()).unwrap_or(1);
    let length: f64 = std::env::var("LENGTH").ok().and_then(|b| b.parse().ok()).unwrap_or(50.0);
    let jerk: f32 = std::env::var("JERK").ok().and_then(|b| b.parse().ok()).unwrap_or(10_000.0);
    let mut rig = machine::<512>(jerk);
    for k in 1..=blocks {
        rig.moves.push_back(to([length * f64::from(k) / f64::from(blocks), 0.0, 0.0], Speed::Feed(100.0)));
    }
    rig.motion.overrides.feed = 1.0;
    rig.pump();
    rig.motion.start();
    let mut last = 0;
    for _ in 0..100_000_000 {
        rig.pump();
        let more = rig.tick();
        if rig.segments != last && std::env::var("DUMP").is_ok() {
            last = rig.segments;
            println!("{:.6} v {:.4} a {:.3}", rig.seconds(), rig.motion.pace.speed / rig.motion.running.scale, rig.motion.pull);
        }
        if !more && rig.queue.is_empty() {
            break;
        }
    }
    println!("{blocks} blocks {} s {} segments, at {:?}", rig.seconds(), rig.segments, rig.position);
}
