//! Colour scales of the picture: the range of speeds or heights, round values for marks, and the bar beside a view
//! that explains the colours. Also defines the `Bounds` of a path.

use super::style::{Area, Drawn, FRAME, decimals, line_style, px, small, tidy};
use crate::path::Point;
use oxmill_controller::axes::LINEAR;
use plotters::prelude::*;
use plotters::style::text_anchor::{HPos, Pos, VPos};

/// Number of shades of a scale, minus one.
pub(super) const SHADES: f64 = 23.0;

/// Minimum and maximum position of each axis, in mm.
pub(super) struct Bounds {
    pub(super) low: [f64; LINEAR],
    pub(super) high: [f64; LINEAR],
}

impl Bounds {
    pub(super) fn of(points: &[Point]) -> Self {
        let mut bounds = Self { low: [f64::INFINITY; LINEAR], high: [f64::NEG_INFINITY; LINEAR] };
        for point in points {
            for axis in 0..LINEAR {
                bounds.low[axis] = bounds.low[axis].min(f64::from(point.at[axis]));
                bounds.high[axis] = bounds.high[axis].max(f64::from(point.at[axis]));
            }
        }
        bounds
    }

    pub(super) fn size(&self, axis: usize) -> f64 {
        (self.high[axis] - self.low[axis]).max(0.0)
    }
}

/// A colour scale for the speeds or the heights of feeds.
pub(super) struct Scale {
    pub(super) low: f64,
    pub(super) high: f64,
    /// Distance between two labelled values of the scale, in mm/min or mm.
    pub(super) step: f64,
    pub(super) stops: &'static [(f64, f64, f64)],
}

impl Scale {
    /// Makes a scale in mm/min, from 0 to the maximum speed of a feed.
    pub(super) fn of_speed(points: &[Point]) -> Self {
        let top = points.iter().skip(1).filter(|p| !p.rapid).map(|p| f64::from(p.speed) * 60.0).fold(0.0, f64::max);
        let (high, step) = if top > 0.0 { tight(top) } else { (1.0, 1.0) };
        Self { low: 0.0, high, step, stops: &SPEEDS }
    }

    /// Makes a scale in mm, from the minimum to the maximum height of a feed.
    pub(super) fn of_height(points: &[Point], bounds: &Bounds) -> Self {
        let feeds = points.windows(2).filter(|pair| !pair[1].rapid).flatten().map(|point| f64::from(point.at[2]));
        let (low, high) = feeds.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), z| (low.min(z), high.max(z)));
        let (low, high) = if low < high { (low, high) } else { (bounds.low[2], bounds.high[2]) };
        let step = tight(high - low).1;
        Self { low, high, step, stops: &HEIGHTS }
    }

    /// Returns the shade of a value, from 0 (low end) to 23 (high end). Consecutive pieces of the path with the same
    /// shade are drawn as one line.
    pub(super) fn shade(&self, value: f64) -> u8 {
        (((value - self.low) / (self.high - self.low)).clamp(0.0, 1.0) * SHADES).round() as u8
    }

    pub(super) fn colour(&self, part: f64) -> RGBColor {
        colour(self.stops, part)
    }

    /// Returns the values of the scale that get a mark with a label.
    pub(super) fn marks(&self) -> impl Iterator<Item = f64> {
        let first = (self.low / self.step - 0.001).ceil();
        let count = ((self.high / self.step + 0.001).floor() - first).max(0.0) as usize;
        (0..=count).map(move |mark| (first + mark as f64) * self.step)
    }
}

/// Chooses a scale for values from 0 to `top`. Returns the end of the scale and the distance between its marks. The
/// distance is 1, 2, 2.5 or 5 times a power of ten, and fits into the scale 3 to 8 times. Of all such scales, the one
/// with the lowest end is chosen.
///
/// The end can be up to 1 % below `top`. For example, a measured speed of 1503 mm/min gets a scale that ends at the
/// feed rate itself, 1500 mm/min.
pub(super) fn tight(top: f64) -> (f64, f64) {
    let power = 10_f64.powf(top.max(1e-9).log10().floor() - 1.0);
    let steps = [1.0, 2.0, 2.5, 5.0, 10.0, 20.0, 25.0, 50.0].map(|step| step * power);
    let end = |step: f64| (top * 0.99 / step).ceil().max(1.0) * step;
    let good =
        steps.into_iter().map(|step| (end(step), step)).filter(|(end, step)| end / step < 8.5 && end / step > 2.5);
    // Of two steps with the same end, choose the greater one, which has fewer marks.
    good.min_by(|a, b| (a.0 - a.1 * 1e-6).total_cmp(&(b.0 - b.1 * 1e-6))).unwrap_or((top, top))
}

/// Colours from the lowest speed to the highest: dark blue through green to orange. All are dark enough for thin lines
/// on white. Their lightness rises evenly, so their order is visible in greyscale and for colour-blind viewers.
pub(super) const SPEEDS: [(f64, f64, f64); 6] = [
    (48.0, 18.0, 110.0),
    (46.0, 76.0, 158.0),
    (24.0, 128.0, 150.0),
    (40.0, 166.0, 104.0),
    (160.0, 186.0, 36.0),
    (246.0, 170.0, 20.0),
];

/// Colours from the lowest height, which is the darkest, to the highest.
const HEIGHTS: [(f64, f64, f64); 4] =
    [(52.0, 16.0, 40.0), (132.0, 28.0, 62.0), (206.0, 92.0, 70.0), (240.0, 186.0, 130.0)];

/// Returns the colour at `part` of a scale, from 0 (low end) to 1 (high end).
pub(super) fn colour(stops: &[(f64, f64, f64)], part: f64) -> RGBColor {
    let at = part.clamp(0.0, 1.0) * (stops.len() - 1) as f64;
    let index = (at as usize).min(stops.len() - 2);
    let (a, b, t) = (stops[index], stops[index + 1], at - index as f64);
    let mix = |a: f64, b: f64| (a + (b - a) * t).round() as u8;
    RGBColor(mix(a.0, b.0), mix(a.1, b.1), mix(a.2, b.2))
}

pub(super) fn scale_bar(area: &Area, title: [&str; 2], scale: &Scale) -> Drawn {
    let (top, bottom, left, right) = (px(70), px(560), px(8), px(28));
    area.draw_text(title[0], &small(), (left, top - px(46)))?;
    area.draw_text(title[1], &small(), (left, top - px(28)))?;
    let parts = 98;
    // Each part reaches up to the top of the bar. The next part is drawn over it and leaves only its lower end
    // visible. So there are no seams between the parts.
    for part in 0..parts {
        let at = |part: i32| bottom - (bottom - top) * part / parts;
        let color = scale.colour(f64::from(part) / f64::from(parts - 1));
        area.draw(&Rectangle::new([(left, top), (right, at(part))], color.filled()))?;
    }
    area.draw(&Rectangle::new([(left, top), (right, bottom)], line_style(FRAME, 10)))?;
    let places = decimals(scale.high - scale.low);
    for mark in scale.marks() {
        let y = bottom - (f64::from(bottom - top) * (mark - scale.low) / (scale.high - scale.low)) as i32;
        area.draw(&PathElement::new([(right, y), (right + px(4), y)], line_style(FRAME, 10)))?;
        let style = small().pos(Pos::new(HPos::Left, VPos::Center));
        area.draw_text(&tidy(mark, places), &style, (right + px(8), y))?;
    }
    Ok(())
}
