//! The style of the picture: units, colours, fonts and lines, and the formatting of numbers in labels.

use plotters::coord::Shift;
use plotters::prelude::*;

/// Fine units per pixel of the drawing. They are needed because the plotting library rounds coordinates to whole units.
pub(super) const FINE: i32 = 10;
const INK: RGBColor = RGBColor(38, 42, 48);
pub(super) const FAINT: RGBColor = RGBColor(228, 231, 235);
pub(super) const FRAME: RGBColor = RGBColor(150, 156, 164);
pub(super) const RAPID: RGBColor = RGBColor(120, 126, 134);
pub(super) const START: RGBColor = RGBColor(22, 150, 72);
pub(super) const END: RGBColor = RGBColor(208, 40, 44);
pub(super) const CURVE: RGBColor = RGBColor(44, 98, 168);
pub(super) const RAPID_CURVE: RGBColor = RGBColor(150, 156, 164);
pub(super) type Area<'a> = DrawingArea<SVGBackend<'a>, Shift>;

pub(super) fn px(pixels: i32) -> i32 {
    pixels * FINE
}

pub(super) fn font(size: i32) -> TextStyle<'static> {
    ("sans-serif", px(size)).into_font().color(&INK)
}

pub(super) fn small() -> TextStyle<'static> {
    font(13)
}

pub(super) fn line_style(color: RGBColor, tenths: i32) -> ShapeStyle {
    color.stroke_width((tenths * FINE / 10) as u32)
}

pub(super) type Drawn = std::result::Result<(), Box<dyn std::error::Error>>;

/// Returns the number of decimals for the labels of a range: 0 for a range of 50, 1 for 5, 2 for 0.5.
pub(super) fn decimals(range: f64) -> usize {
    (1.0 - (range / 5.0).max(1e-6).log10().floor()).clamp(0.0, 5.0) as usize
}

pub(super) fn tidy(value: f64, places: usize) -> String {
    let text = format!("{value:.places$}");
    let text = if text.contains('.') { text.trim_end_matches('0').trim_end_matches('.') } else { &text };
    if text == "-0" { "0".into() } else { text.replace('-', "\u{2212}") }
}
