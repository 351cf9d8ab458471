//! Jobs for comparing motion with other controllers; `docs/motion.md` has a table of them. Points of curves are
//! computed in `f64` with only + - * /, so every machine computes the same ones.

use std::io::{Result, Write};

/// The jobs that [`generate`] can write.
pub const NAMES: &[&str] = &[
    "circle_chords",
    "circle_arcs",
    "relief_rows",
    "zigzag",
    "raster",
    "look_ahead",
    "drift",
    "drift_inch",
    "tight_circle",
];

/// Writes one job. Returns `false`, without output, if there is no job of this name.
///
/// # Errors
/// Errors of `out`.
pub fn generate(name: &str, out: &mut dyn Write) -> Result<bool> {
    match name {
        "circle_chords" => circle(out, 10, 100, 10.0, 3000)?,
        "circle_arcs" => circle_arcs(out)?,
        "relief_rows" => relief_rows(out)?,
        "zigzag" => zigzag(out)?,
        "raster" => raster(out)?,
        "look_ahead" => look_ahead(out)?,
        "drift" => increments(out, "G21", "0.001", 200_000)?,
        "drift_inch" => increments(out, "G20", "0.0001", 100_000)?,
        // 0.1 mm chords of a 10 mm circle.
        "tight_circle" => circle(out, 5, 314, 5.0, 12_000)?,
        _ => return Ok(false),
    }
    Ok(true)
}

/// Returns sine and cosine of an angle in turns, with errors below 1e-14. The angle is split into a whole number of
/// quarter turns and a rest of at most an eighth of a turn. Power series give the sine and cosine of the rest.
pub fn sine_cosine(turns: f64) -> (f64, f64) {
    let turns = turns - turns.floor();
    let quarter = (turns * 4.0 + 0.5).floor();
    let angle = (turns - quarter / 4.0) * std::f64::consts::TAU;
    let (mut sine, mut cosine) = (0.0, 0.0);
    let (mut odd, mut even) = (angle, 1.0);
    for k in 0..12 {
        sine += odd;
        cosine += even;
        let n = f64::from(2 * k);
        odd *= -angle * angle / ((n + 2.0) * (n + 3.0));
        even *= -angle * angle / ((n + 1.0) * (n + 2.0));
    }
    match quarter as u32 % 4 {
        0 => (sine, cosine),
        1 => (cosine, -sine),
        2 => (-sine, -cosine),
        _ => (-cosine, sine),
    }
}

/// Writes a circle about the origin: `turns` turns, each of `chords` chords. It starts with a rapid to (radius, 0).
/// Units: mm and mm/min.
fn circle(out: &mut dyn Write, turns: u32, chords: u32, radius: f64, feed: u32) -> Result<()> {
    writeln!(out, "G21G90\nG0X{radius:.3}Y0\nF{feed}")?;
    for point in 1..=turns * chords {
        let (y, x) = sine_cosine(f64::from(point % chords) / f64::from(chords));
        writeln!(out, "G1X{:.3}Y{:.3}", radius * x, radius * y)?;
    }
    Ok(())
}

fn circle_arcs(out: &mut dyn Write) -> Result<()> {
    writeln!(out, "G21G90\nG0X10Y0\nF3000")?;
    for _ in 0..10 {
        writeln!(out, "G3X10Y0I-10J0")?;
    }
    Ok(())
}

/// Writes 41 rows of 40 mm, 1 mm apart, over a field of bumps, with a point every 0.1 mm: 16,441 segments.
fn relief_rows(out: &mut dyn Write) -> Result<()> {
    writeln!(out, "G21G90\nF2000")?;
    for row in 0..=40_u32 {
        for step in 0..=400_u32 {
            let x = f64::from(if row % 2 == 0 { step } else { 400 - step }) / 10.0;
            let y = f64::from(row);
            let along = sine_cosine(x / 8.0).0;
            let across = sine_cosine(y / 20.0).1;
            writeln!(out, "G1X{x:.3}Y{y:.3}Z{:.3}", 0.7 * along * across - 0.7)?;
        }
    }
    Ok(())
}

/// Writes 60 rows of 50 mm, 0.5 mm apart.
fn zigzag(out: &mut dyn Write) -> Result<()> {
    writeln!(out, "G21G90\nF3000")?;
    for row in 0..60_u32 {
        writeln!(out, "G1X{}\nY{:.3}", if row % 2 == 0 { 50 } else { 0 }, f64::from(row + 1) * 0.5)?;
    }
    Ok(())
}

/// Writes 140 rows of 50 mm, 0.1 mm apart, with a change of power every 0.5 mm.
fn raster(out: &mut dyn Write) -> Result<()> {
    writeln!(out, "G21G90\nM3S0\nF5000")?;
    for row in 0..140_u32 {
        for step in 1..=100_u32 {
            let x = f64::from(if row % 2 == 0 { step } else { 100 - step }) / 2.0;
            writeln!(out, "G1X{x}S{}", (step * 37 + row * 53) % 1000)?;
        }
        writeln!(out, "Y{:.1}S0", f64::from(row + 1) / 10.0)?;
    }
    Ok(())
}

/// Writes a sine curve with an amplitude of 10 mm and a wavelength of 200 mm: 6 passes between x = 0 and 190 mm in
/// alternating directions, in chords of 0.1 mm in x.
fn look_ahead(out: &mut dyn Write) -> Result<()> {
    writeln!(out, "G21G90\nF6000")?;
    for pass in 0..6_u32 {
        for step in 1..=1900_u32 {
            let x = f64::from(if pass % 2 == 0 { step } else { 1900 - step }) / 10.0;
            writeln!(out, "G1X{x:.3}Y{:.3}", 10.0 * sine_cosine(x / 200.0).0)?;
        }
    }
    Ok(())
}

fn increments(out: &mut dyn Write, unit: &str, step: &str, count: u32) -> Result<()> {
    writeln!(out, "{unit}G91\nF{}", if unit == "G20" { "100" } else { "2000" })?;
    for _ in 0..count {
        writeln!(out, "G1X{step}")?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_series_are_sine_and_cosine() {
        for k in -500..500 {
            let turns = f64::from(k) * 0.00713;
            let (sine, cosine) = sine_cosine(turns);
            assert!((sine - (turns * std::f64::consts::TAU).sin()).abs() < 1e-14);
            assert!((cosine - (turns * std::f64::consts::TAU).cos()).abs() < 1e-14);
        }
    }

    #[test]
    fn jobs_have_the_lines_that_they_promise() {
        let lines = |name: &str| {
            let mut text = Vec::new();
            assert!(generate(name, &mut text).unwrap());
            text.split(|b| *b == b'\n').filter(|line| line.starts_with(b"G1")).count()
        };
        assert_eq!(lines("relief_rows"), 16_441);
        assert_eq!(lines("look_ahead"), 11_400);
        assert_eq!(lines("drift"), 200_000);
        assert_eq!(lines("drift_inch"), 100_000);
        assert!(!generate("nothing", &mut Vec::new()).unwrap());
    }
}
