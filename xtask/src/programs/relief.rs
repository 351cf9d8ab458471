//! A finishing pass over a relief: a rosette on a domed medallion inside a raised frame, cut in rows 0.4 mm apart with
//! a point every 0.1 mm. Its tens of thousands of short moves need look-ahead.

use super::writer::Writer;
use std::io::{Result, Write};

/// Width of the plate along X, µm.
const WIDTH: i64 = 60_000;
/// Height of the plate along Y, µm.
const HEIGHT: i64 = 40_000;
/// Distance between points in a row, µm.
const POINT: i64 = 100;
/// Distance between rows, µm.
const ROW: i64 = 400;
/// Rapid height above the plate, µm.
const CLEAR: i64 = 3_000;
// Feeds, tenths of mm/min.
const FEED: i64 = 15_000;
const PLUNGE: i64 = 3_000;

/// nm per µm: heights are computed in nm and rounded to µm at the end.
const NM: i64 = 1_000;

/// Directions of the eight petals as (cos, sin) × 1000.
const PETALS: [(i64, i64); 8] =
    [(1000, 0), (707, 707), (0, 1000), (-707, 707), (-1000, 0), (-707, -707), (0, -1000), (707, -707)];

/// Writes the program: rows along X in alternating directions.
pub fn write(out: &mut dyn Write) -> Result<()> {
    let mut w = Writer::new(out, 3).compact();
    w.comment("Rosette medallion, 60 x 40 mm, finishing")?;
    w.comment("Tool: 3 mm ball nose. Zero: lower left corner, top of the stock")?;
    w.comment("Written by: cargo xtask job relief")?;
    w.text("G21 G90 G17 G94 G54")?;
    w.text("S10000 M3")?;
    w.line_to("G0", [None, None, Some(CLEAR)], None)?;
    w.line_to("G0", [Some(0), Some(0), None], None)?;
    w.line_to("G1", [None, None, Some(height(0, 0))], Some(PLUNGE))?;
    for row in 0..=HEIGHT / ROW {
        let y = row * ROW;
        let points = WIDTH / POINT;
        for point in 0..=points {
            let x = if row % 2 == 0 { point } else { points - point } * POINT;
            w.line_to("G1", [Some(x), Some(y), Some(height(x, y))], Some(FEED))?;
        }
    }
    w.line_to("G0", [None, None, Some(CLEAR)], None)?;
    w.line_to("G0", [Some(0), Some(0), None], None)?;
    w.text("M5")?;
    w.text("M30")
}

/// Returns the height of the surface at a point, µm: 0 at the top of the stock and negative below.
fn height(x: i64, y: i64) -> i64 {
    let (u, v) = (x - WIDTH / 2, y - HEIGHT / 2);
    let ground = -3_200 * NM;
    // A frame along the edge: level for 2 mm, at 1.2 mm below the top of the stock, then 2 mm of slope to the ground.
    let edge = x.min(WIDTH - x).min(y).min(HEIGHT - y);
    let frame = (2_000 * NM).min((4_000 - edge) * NM).max(0);
    // The dome is elliptic: its foot is 27 mm from the centre along X and 19 mm along Y.
    let dome = hill(u * 19 / 27, v, 19_000, 1_500 * NM);
    let mut flower = hill(u, v, 4_500, 1_300 * NM);
    for (cos, sin) in PETALS {
        // Coordinates along and across the petal; a petal is longer than wide.
        let along = (u * cos + v * sin) / 1_000 - 8_500;
        let across = (v * cos - u * sin) / 1_000;
        flower = flower.max(hill(along, across * 5 / 2, 5_500, 900 * NM));
    }
    let height = ground + frame.max(dome + flower);
    (height - NM / 2) / NM
}

/// Returns the height, nm, of a hill at the point (u, v), µm from its centre: `height` × (1 - d²/r²)². d is the
/// distance from the centre, and r is `radius`, both in µm. `height` is in nm. At d = r/2 this is 9/16 of `height`. The
/// surface is level at the top and at the foot.
fn hill(u: i64, v: i64, radius: i64, height: i64) -> i64 {
    let (square, limit) = (u * u + v * v, radius * radius);
    if square >= limit {
        return 0;
    }
    // 1 - d²/r² in units of 2^-20. No product here exceeds 2^49.
    let fall = ((limit - square) << 20) / limit;
    (((fall * fall) >> 20) * height) >> 20
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_surface_lies_within_the_stock_and_has_relief() {
        let heights: Vec<i64> =
            (0..=WIDTH / 500).flat_map(|i| (0..=HEIGHT / 500).map(move |j| height(i * 500, j * 500))).collect();
        assert!(heights.iter().all(|h| (-3_201..=0).contains(h)));
        assert!(heights.iter().max() > Some(&-600) && heights.iter().min() < Some(&-3_000));
    }
}
