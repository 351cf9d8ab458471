//! Draws the tool path: from above (`plan`), coloured by speed, and at an angle (`angled`), coloured by height. Rapids
//! are dashed; points too close to be distinguished are omitted.

use super::scale::{Bounds, SHADES, Scale};
use super::style::{Area, Drawn, END, FAINT, FRAME, RAPID, START, decimals, font, line_style, px, small, tidy};
use crate::path::Point;
use plotters::prelude::*;
use plotters::style::text_anchor::{HPos, Pos, VPos};

/// Space left free around the tool path, as a fraction of its size.
const MARGIN: f64 = 0.06;
/// Maximum height of the job in the view at an angle, as a fraction of its larger size in X and Y. Shallow jobs are
/// stretched in Z up to this height.
const HEIGHT: f64 = 0.4;
/// Horizontal direction of the viewer in the view at an angle, in radians: 0 is in front of the job, and positive
/// angles are to the right of that.
const ASIDE: f64 = 0.52;
/// Vertical direction of the viewer in the view at an angle, in radians above the horizontal.
const ABOVE: f64 = 0.87;

pub(super) fn cross(area: &Area, (x, y): (i32, i32)) -> Drawn {
    let r = px(6);
    area.draw(&PathElement::new([(x - r, y - r), (x + r, y + r)], line_style(END, 25)))?;
    area.draw(&PathElement::new([(x - r, y + r), (x + r, y - r)], line_style(END, 25)))?;
    Ok(())
}

/// Draws the path as lines. A new line begins where the colour changes, or between a rapid and a feed. `project` maps a
/// point to the paper. `shade` selects the colour of the motion that ends at a point.
fn draw_path(
    area: &Area,
    points: &[Point],
    scale: &Scale,
    shade: impl Fn(&Point) -> u8,
    project: impl Fn(&Point) -> (i32, i32),
) -> Drawn {
    let style = |point: &Point| if point.rapid { None } else { Some(shade(point)) };
    // Draw rapids first, so that they never hide a cut.
    for rapids in [true, false] {
        let mut index = 1;
        while index < points.len() {
            let this = style(&points[index]);
            let mut end = index + 1;
            while end < points.len() && style(&points[end]) == this {
                end += 1;
            }
            if this.is_none() == rapids {
                let places = apart(points[index - 1..end].iter().map(&project));
                match this {
                    None => dashes(area, &places)?,
                    Some(_) if places.len() < 2 => {}
                    Some(shade) => {
                        area.draw(&PathElement::new(places, line_style(scale.colour(f64::from(shade) / SHADES), 15)))?;
                    }
                }
            }
            index = end;
        }
    }
    Ok(())
}

/// Returns the path with additional points on steep feeds, so that each piece has about one shade of the height scale.
pub(super) fn by_height(points: &[Point], scale: &Scale) -> Vec<Point> {
    let mut fine = Vec::with_capacity(points.len());
    fine.extend(points.first());
    for pair in points.windows(2) {
        let shades = pair.iter().map(|point| scale.shade(f64::from(point.at[2]))).collect::<Vec<_>>();
        let parts = if pair[1].rapid { 1 } else { shades[0].abs_diff(shades[1]).max(1) };
        for part in 1..=parts {
            let t = f32::from(part) / f32::from(parts);
            let at = std::array::from_fn(|axis| pair[0].at[axis] + (pair[1].at[axis] - pair[0].at[axis]) * t);
            fine.push(Point { at, ..pair[1] });
        }
    }
    fine
}

/// Removes positions that are too close to the previous one to be distinguished, but never the last position.
fn apart(all: impl Iterator<Item = (i32, i32)>) -> Vec<(i32, i32)> {
    let near = |a: (i32, i32), b: (i32, i32)| (a.0 - b.0).abs().max((a.1 - b.1).abs()) < px(1) / 2;
    let mut places: Vec<(i32, i32)> = Vec::new();
    let mut last = None;
    for place in all {
        if places.last().is_none_or(|before| !near(*before, place)) {
            places.push(place);
        }
        last = Some(place);
    }
    if last != places.last().copied() {
        places.extend(last);
    }
    places
}

fn dashes(area: &Area, places: &[(i32, i32)]) -> Drawn {
    let (dash, gap) = (f64::from(px(6)), f64::from(px(5)));
    let mut phase = 0.0;
    for pair in places.windows(2) {
        let ((x0, y0), (x1, y1)) = (pair[0], pair[1]);
        let length = f64::from(x1 - x0).hypot(f64::from(y1 - y0));
        let place = |at: f64| {
            let part = at / length;
            ((f64::from(x0) + part * f64::from(x1 - x0)) as i32, (f64::from(y0) + part * f64::from(y1 - y0)) as i32)
        };
        let mut at = -phase;
        while at < length {
            if at + dash > 0.0 {
                let ends = [place(at.max(0.0)), place((at + dash).min(length))];
                area.draw(&PathElement::new(ends, line_style(RAPID, 10)))?;
            }
            at += dash + gap;
        }
        phase = (phase + length) % (dash + gap);
    }
    Ok(())
}

fn start_and_end(area: &Area, points: &[Point], project: impl Fn(&Point) -> (i32, i32)) -> Drawn {
    if let (Some(first), Some(last)) = (points.first(), points.last()) {
        area.draw(&Circle::new(project(first), px(6), line_style(START, 25)))?;
        cross(area, project(last))?;
    }
    Ok(())
}

/// Widens the ranges `low` to `high` of both axes (mm), so that both have the same scale on an area of `pixels`, and
/// adds a margin.
fn equal_scale(low: [f64; 2], high: [f64; 2], pixels: [f64; 2]) -> ([f64; 2], [f64; 2]) {
    let size = [high[0] - low[0], high[1] - low[1]];
    let least = size[0].max(size[1]).max(0.01) * 0.01;
    let per_pixel = (0..2).map(|i| size[i].max(least) * (1.0 + 2.0 * MARGIN) / pixels[i]).fold(0.0, f64::max);
    let middle = [(low[0] + high[0]) / 2.0, (low[1] + high[1]) / 2.0];
    let half = [pixels[0] * per_pixel / 2.0, pixels[1] * per_pixel / 2.0];
    ([middle[0] - half[0], middle[1] - half[1]], [middle[0] + half[0], middle[1] + half[1]])
}

pub(super) fn plan(area: &Area, points: &[Point], bounds: &Bounds, scale: &Scale) -> Drawn {
    let (width, height) = area.dim_in_pixel();
    let (left, bottom, margin) = (px(72), px(52), px(14));
    let caption = px(30);
    let pixels =
        [f64::from(width as i32 - left - 2 * margin), f64::from(height as i32 - bottom - caption - 2 * margin)];
    let (low, high) = equal_scale([bounds.low[0], bounds.low[1]], [bounds.high[0], bounds.high[1]], pixels);
    area.draw_text("From above", &font(15), (left + margin, px(10)))?;
    let (_, below) = area.split_vertically(caption);
    let mut chart = ChartBuilder::on(&below)
        .margin(margin)
        .x_label_area_size(bottom)
        .y_label_area_size(left)
        .build_cartesian_2d(low[0]..high[0], low[1]..high[1])?;
    let places = decimals(high[0] - low[0]);
    chart
        .configure_mesh()
        .x_desc("X, mm")
        .y_desc("Y, mm")
        .x_labels(9)
        .y_labels(9)
        .max_light_lines(0)
        .bold_line_style(line_style(FAINT, 10))
        .axis_style(line_style(FRAME, 10))
        .label_style(small())
        .axis_desc_style(font(14))
        .set_all_tick_mark_size(px(4))
        .x_label_formatter(&|v| tidy(*v, places))
        .y_label_formatter(&|v| tidy(*v, places))
        .draw()?;
    let whole = chart.plotting_area().strip_coord_spec();
    let (width, height) = whole.dim_in_pixel();
    let per_mm = f64::from(width) / (high[0] - low[0]);
    let project = |point: &Point| {
        let x = (f64::from(point.at[0]) - low[0]) * per_mm;
        (x as i32, ((high[1] - f64::from(point.at[1])) / (high[1] - low[1]) * f64::from(height)) as i32)
    };
    draw_path(&whole, points, scale, |point| scale.shade(f64::from(point.speed) * 60.0), project)?;
    start_and_end(&whole, points, project)
}

/// Returns the factor by which Z is stretched in the view at an angle, so that a shallow job does not look flat.
pub(super) fn stretch(bounds: &Bounds) -> f64 {
    let most = HEIGHT * bounds.size(0).max(bounds.size(1)) / bounds.size(2);
    [50.0, 20.0, 10.0, 5.0, 2.0].into_iter().find(|times| *times <= most).unwrap_or(1.0)
}

/// Draws the view at an angle: a parallel (axonometric) projection of the path, from the front right and above, in a
/// box with the limits of each axis.
pub(super) fn angled(area: &Area, points: &[Point], bounds: &Bounds, scale: &Scale) -> Drawn {
    let stretch = stretch(bounds);
    let flat = |x: f64, y: f64, z: f64| {
        let back = y * ASIDE.cos() - x * ASIDE.sin();
        [x * ASIDE.cos() + y * ASIDE.sin(), back * ABOVE.sin() + z * stretch * ABOVE.cos()]
    };
    let (width, height) = area.dim_in_pixel();
    let caption = px(30);
    let label = |axis: usize| {
        let places = decimals(bounds.size(axis));
        let (low, high) = (tidy(bounds.low[axis], places), tidy(bounds.high[axis], places));
        format!("{} {low} to {high} mm", ['X', 'Y', 'Z'][axis])
    };
    let times = if stretch > 1.0 { format!(", drawn {stretch} times as high") } else { String::new() };
    area.draw_text(&format!("At an angle: {}{times}", label(2)), &font(15), (px(24), px(10)))?;
    let (_, below) = area.split_vertically(caption);
    // Leave room for the labels around the box.
    let (side, foot) = (px(16), px(46));
    let pixels = [f64::from(width as i32 - 2 * side), f64::from(height as i32 - caption - 2 * foot)];
    let (low_at, high_at) = (bounds.low, bounds.high);
    let corner = |bits: usize| {
        let pick = |axis: usize| if bits & (1 << axis) != 0 { high_at[axis] } else { low_at[axis] };
        flat(pick(0), pick(1), pick(2))
    };
    let (mut low, mut high) = ([f64::INFINITY; 2], [f64::NEG_INFINITY; 2]);
    for at in (0..8).map(corner) {
        for i in 0..2 {
            low[i] = low[i].min(at[i]);
            high[i] = high[i].max(at[i]);
        }
    }
    let (low, high) = equal_scale(low, high, pixels);
    let per_mm = pixels[0] / (high[0] - low[0]);
    let paper = |at: [f64; 2]| (side + ((at[0] - low[0]) * per_mm) as i32, foot + ((high[1] - at[1]) * per_mm) as i32);
    for (from, axis) in [(0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 0), (2, 2), (3, 2), (4, 0), (4, 1), (5, 1), (6, 0)]
    {
        let ends = [paper(corner(from)), paper(corner(from | (1 << axis)))];
        below.draw(&PathElement::new(ends, line_style(if from & 4 == 0 && axis != 2 { FRAME } else { FAINT }, 10)))?;
    }
    let project = |point: &Point| paper(flat(f64::from(point.at[0]), f64::from(point.at[1]), f64::from(point.at[2])));
    let fine = by_height(points, scale);
    draw_path(&below, &fine, scale, |point| scale.shade(f64::from(point.at[2])), project)?;
    start_and_end(&below, points, project)?;

    let between = |a: usize, b: usize, part: f64| {
        let (a, b) = (paper(corner(a)), paper(corner(b)));
        let place = |a: i32, b: i32| a + (f64::from(b - a) * part) as i32;
        (place(a.0, b.0), place(a.1, b.1))
    };
    let bottom = height as i32 - caption - px(24);
    let anchored = |h| small().pos(Pos::new(h, VPos::Top));
    let (x, y) = between(0, 1, 0.4);
    below.draw_text(&label(0), &anchored(HPos::Right), (x.max(px(130)), (y + px(14)).min(bottom)))?;
    let (x, y) = between(1, 3, 0.25);
    let (free, edge) = (x + px(16), width as i32 - px(134));
    // If there is no room beside a short edge, the label goes below it.
    let y = if free <= edge { y } else { paper(corner(1)).1 };
    below.draw_text(&label(1), &anchored(HPos::Left), (free.min(edge), (y + px(10)).min(bottom)))?;
    Ok(())
}
