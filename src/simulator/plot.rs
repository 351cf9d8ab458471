//! The picture of a job as SVG or PNG: a heading, the tool path from above coloured by speed, the path at an angle
//! coloured by height if it is deep, and the speed over time.
//!
//! The drawing is made once, as SVG; a PNG is that SVG rendered with an embedded font, so both look the same on every
//! machine.
//!
//! Names: The picture of a job as SVG or PNG (`format_of`), in pixels (`px`, `SIZE`, `width`) with fonts, a
//! `line_style` and `RGBColor`: heading from the `summary`, the tool path from above (`plan`) coloured by speed, at an
//! angle (`angled`) and by height if it is `deep`, split into a drawing `Area` each, with a `caption`; colour `Scale`s
//! from low to high with `stops` to `mix`, tidy marks (`step`, `decimals`) and labels, and a `ChartBuilder` for the
//! speed `curve` over time, column by column, with its top. `project` turns points (`f64` mm) into pairs of pixels, by
//! their `Bounds` (`span`, `size`, `stretch`), with equal scale and a margin; `fine` divides long moves, `apart` leaves
//! out points that are near, lines go from `x0`, `y0` to `x1`, `y1`; rapids are dashes with a gap, feeds shades; lines
//! of a grid are `FAINT`.

use crate::files::Output;
use crate::path::{Column, Drawing, Point};
use crate::summary::{Summary, clock_time, counted};
use anyhow::{Context, Result, anyhow, bail};
use oxmill_controller::axes::LINEAR;
use plotters::coord::Shift;
use plotters::prelude::*;
use plotters::style::text_anchor::{HPos, Pos, VPos};
use plotters::style::{FontStyle, register_font};
use std::path::Path;

/// Size of the drawing.
const SIZE: (u32, u32) = (1400, 1040);
/// The plotting library puts everything on whole units: so many of them make a pixel of the drawing.
const FINE: i32 = 10;
/// Pixels of a PNG for a pixel of the drawing.
const PNG_SCALE: f32 = 1.5;
/// Width of a colour scale with its marks, in pixels.
const BAR: i32 = 95;
/// Space left free around the tool path, as a part of its size.
const MARGIN: f64 = 0.06;
/// A job is drawn at an angle too if its depth is at least this part of its width.
const DEPTH: f64 = 0.005;
/// Columns of the speed curve.
const CURVE_COLUMNS: usize = 1200;

/// Shades of a scale, less one.
const SHADES: f64 = 23.0;
/// Height of the view at an angle, as a part of its width and depth: Z is drawn as many times as high as comes below.
const HEIGHT: f64 = 0.4;
/// Directions from which that view is seen, in radians: from the right of the front, and from above.
const ASIDE: f64 = 0.52;
const ABOVE: f64 = 0.87;

const INK: RGBColor = RGBColor(38, 42, 48);
const FAINT: RGBColor = RGBColor(228, 231, 235);
const FRAME: RGBColor = RGBColor(150, 156, 164);
const RAPID: RGBColor = RGBColor(120, 126, 134);
const START: RGBColor = RGBColor(22, 150, 72);
const END: RGBColor = RGBColor(208, 40, 44);
const CURVE: RGBColor = RGBColor(44, 98, 168);
const RAPID_CURVE: RGBColor = RGBColor(150, 156, 164);

type Area<'a> = DrawingArea<SVGBackend<'a>, Shift>;

/// How a drawing is written.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Format {
    /// Lines and text.
    Svg,
    /// Pixels.
    Png,
}

/// The format that a file's name asks for.
pub fn format_of(path: &Path) -> Result<Format> {
    match path.extension().map(|e| e.to_ascii_lowercase()).as_deref().and_then(|e| e.to_str()) {
        Some("svg") => Ok(Format::Svg),
        Some("png") => Ok(Format::Png),
        _ => bail!("a drawing is a .svg or a .png file, which {} is not", path.display()),
    }
}

/// Draws a job into a file.
pub fn write(output: Output, drawing: &Drawing, summary: &Summary) -> Result<()> {
    let format = format_of(output.path())?;
    let draw = || {
        let svg = svg(drawing, summary)?;
        match format {
            Format::Svg => Ok(svg.into_bytes()),
            Format::Png => png(&svg),
        }
    };
    let bytes = draw().with_context(|| format!("cannot draw {}", output.path().display()))?;
    output.write(&bytes)
}

/// The drawing as SVG.
pub fn svg(drawing: &Drawing, summary: &Summary) -> Result<String> {
    register_font("sans-serif", FontStyle::Normal, dejavu::sans::regular())
        .map_err(|_| anyhow!("the embedded font is damaged"))?;
    let mut svg = String::new();
    {
        let fine = FINE as u32;
        let root = SVGBackend::with_string(&mut svg, (SIZE.0 * fine, SIZE.1 * fine)).into_drawing_area();
        sheet(&root, drawing, summary).map_err(|error| anyhow!("{error}"))?;
        root.present().map_err(|error| anyhow!("{error}"))?;
    }
    // The size in pixels; the viewBox keeps the fine units.
    let fine = format!("<svg width=\"{}\" height=\"{}\"", SIZE.0 * FINE as u32, SIZE.1 * FINE as u32);
    Ok(svg.replacen(&fine, &format!("<svg width=\"{}\" height=\"{}\"", SIZE.0, SIZE.1), 1))
}

/// An SVG of [`svg`] as pixels.
pub fn png(svg: &str) -> Result<Vec<u8>> {
    use resvg::{tiny_skia, usvg};
    let mut options = usvg::Options::default();
    let fonts = options.fontdb_mut();
    fonts.load_font_data(dejavu::sans::regular().to_vec());
    fonts.set_sans_serif_family("DejaVu Sans");
    let tree = usvg::Tree::from_str(svg, &options)?;
    let (width, height) = (SIZE.0 as f32 * PNG_SCALE, SIZE.1 as f32 * PNG_SCALE);
    let mut pixels = tiny_skia::Pixmap::new(width as u32, height as u32).context("no memory for the picture")?;
    pixels.fill(tiny_skia::Color::WHITE);
    resvg::render(&tree, tiny_skia::Transform::from_scale(PNG_SCALE, PNG_SCALE), &mut pixels.as_mut());
    Ok(pixels.encode_png()?)
}

fn px(pixels: i32) -> i32 {
    pixels * FINE
}

fn font(size: i32) -> TextStyle<'static> {
    ("sans-serif", px(size)).into_font().color(&INK)
}

fn small() -> TextStyle<'static> {
    font(13)
}

fn line_style(color: RGBColor, tenths: i32) -> ShapeStyle {
    color.stroke_width((tenths * FINE / 10) as u32)
}

type Drawn = std::result::Result<(), Box<dyn std::error::Error>>;

fn sheet(root: &Area, drawing: &Drawing, summary: &Summary) -> Drawn {
    root.fill(&WHITE)?;
    let (head, rest) = root.split_vertically(px(84));
    let (views, curve) = rest.split_vertically(px(670));
    heading(&head, summary)?;

    let points = drawing.points();
    let speed = Scale::of_speed(points);
    let bounds = Bounds::of(points);
    let deep = bounds.size(2) >= DEPTH * bounds.size(0).max(bounds.size(1)) && bounds.size(2) > 0.0;
    let width = if deep { 610 } else { SIZE.0 as i32 - BAR };
    let (view, rest) = views.split_horizontally(px(width));
    let (bar, rest) = rest.split_horizontally(px(BAR));
    plan(&view, points, &bounds, &speed)?;
    scale_bar(&bar, ["Feed,", "mm/min"], &speed)?;
    if deep {
        let height = Scale::of_height(points, &bounds);
        let (view, bar) = rest.split_horizontally(px(SIZE.0 as i32 - width - 2 * BAR));
        angled(&view, points, &bounds, &height)?;
        scale_bar(&bar, ["Height Z,", "mm"], &height)?;
    }
    speed_curve(&curve, drawing, &speed)
}

fn heading(area: &Area, summary: &Summary) -> Drawn {
    area.draw_text(&shortened(&summary.job, 70), &font(24), (px(24), px(14)))?;
    let faults = match (&summary.alarm, summary.error_count()) {
        (Some(alarm), _) => format!(" · ALARM:{}", alarm.code),
        (None, 0) => String::new(),
        (None, errors) => format!(" · {}", counted(errors, "error")),
    };
    let text = format!(
        "{} · {} · {:.1} mm of path · board {}{faults}",
        counted(summary.lines, "line"),
        clock_time(summary.forecast_s),
        summary.distance_mm,
        summary.board
    );
    area.draw_text(&text, &font(15), (px(24), px(50)))?;

    // The legend is at the right, away from the path.
    let row = px(58);
    let mut x = px(SIZE.0 as i32 - 470);
    area.draw(&Circle::new((x, row), px(6), line_style(START, 25)))?;
    area.draw_text("start", &small(), (x + px(14), row - px(8)))?;
    x += px(90);
    cross(area, (x, row))?;
    area.draw_text("end", &small(), (x + px(14), row - px(8)))?;
    x += px(75);
    for dash in 0..4 {
        let from = x + px(dash * 12);
        area.draw(&PathElement::new([(from, row), (from + px(7), row)], line_style(RAPID, 12)))?;
    }
    area.draw_text("rapid", &small(), (x + px(54), row - px(8)))?;
    x += px(130);
    for part in 0..24 {
        let from = x + px(part * 2);
        let color = colour(&SPEEDS, f64::from(part) / 23.0);
        area.draw(&PathElement::new([(from, row), (from + px(2), row)], line_style(color, 30)))?;
    }
    area.draw_text("feed, by speed", &small(), (x + px(56), row - px(8)))?;
    Ok(())
}

fn shortened(text: &str, length: usize) -> String {
    if text.chars().count() <= length {
        return text.to_owned();
    }
    text.chars().take(length - 1).chain(['…']).collect()
}

fn cross(area: &Area, (x, y): (i32, i32)) -> Drawn {
    let r = px(6);
    area.draw(&PathElement::new([(x - r, y - r), (x + r, y + r)], line_style(END, 25)))?;
    area.draw(&PathElement::new([(x - r, y + r), (x + r, y - r)], line_style(END, 25)))?;
    Ok(())
}

/// Least and greatest place of each axis, in mm.
struct Bounds {
    low: [f64; LINEAR],
    high: [f64; LINEAR],
}

impl Bounds {
    fn of(points: &[Point]) -> Self {
        let mut bounds = Self { low: [f64::INFINITY; LINEAR], high: [f64::NEG_INFINITY; LINEAR] };
        for point in points {
            for axis in 0..LINEAR {
                bounds.low[axis] = bounds.low[axis].min(f64::from(point.at[axis]));
                bounds.high[axis] = bounds.high[axis].max(f64::from(point.at[axis]));
            }
        }
        bounds
    }

    fn size(&self, axis: usize) -> f64 {
        (self.high[axis] - self.low[axis]).max(0.0)
    }
}

/// Colours for the speeds or heights of feeds.
struct Scale {
    low: f64,
    high: f64,
    /// From mark to mark.
    step: f64,
    stops: &'static [(f64, f64, f64)],
}

impl Scale {
    /// From 0 to the greatest speed of a feed in mm/min.
    fn of_speed(points: &[Point]) -> Self {
        let top = points.iter().skip(1).filter(|p| !p.rapid).map(|p| f64::from(p.speed) * 60.0).fold(0.0, f64::max);
        let (high, step) = if top > 0.0 { tight(top) } else { (1.0, 1.0) };
        Self { low: 0.0, high, step, stops: &SPEEDS }
    }

    /// From the least to the greatest height of a feed in mm.
    fn of_height(points: &[Point], bounds: &Bounds) -> Self {
        let feeds = points.windows(2).filter(|pair| !pair[1].rapid).flatten().map(|point| f64::from(point.at[2]));
        let (low, high) = feeds.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), z| (low.min(z), high.max(z)));
        let (low, high) = if low < high { (low, high) } else { (bounds.low[2], bounds.high[2]) };
        let step = tight(high - low).1;
        Self { low, high, step, stops: &HEIGHTS }
    }

    /// Pieces of path whose shades differ less than the eye sees are drawn as one.
    fn shade(&self, value: f64) -> u8 {
        (((value - self.low) / (self.high - self.low)).clamp(0.0, 1.0) * SHADES).round() as u8
    }

    fn colour(&self, part: f64) -> RGBColor {
        colour(self.stops, part)
    }

    /// Places of the marks.
    fn marks(&self) -> impl Iterator<Item = f64> {
        let first = (self.low / self.step - 0.001).ceil();
        let count = ((self.high / self.step + 0.001).floor() - first).max(0.0) as usize;
        (0..=count).map(move |mark| (first + mark as f64) * self.step)
    }
}

/// The end of a scale from 0 to at least `top`, and its steps: 3 to 8 of them, of 1, 2, 2.5 or 5 times a power of ten, that
/// reach the least beyond. A hundredth more than an end is the end: the feed itself, not more than it.
fn tight(top: f64) -> (f64, f64) {
    let power = 10_f64.powf(top.max(1e-9).log10().floor() - 1.0);
    let steps = [1.0, 2.0, 2.5, 5.0, 10.0, 20.0, 25.0, 50.0].map(|step| step * power);
    let end = |step: f64| (top * 0.99 / step).ceil().max(1.0) * step;
    let good =
        steps.into_iter().map(|step| (end(step), step)).filter(|(end, step)| end / step < 8.5 && end / step > 2.5);
    // Of two that end at the same place the one with fewer marks.
    good.min_by(|a, b| (a.0 - a.1 * 1e-6).total_cmp(&(b.0 - b.1 * 1e-6))).unwrap_or((top, top))
}

/// Dark blue through green to orange. All are dark enough for thin lines on white, and their lightness rises evenly, so
/// they keep their order in grey and for colour-blind eyes.
const SPEEDS: [(f64, f64, f64); 6] = [
    (48.0, 18.0, 110.0),
    (46.0, 76.0, 158.0),
    (24.0, 128.0, 150.0),
    (40.0, 166.0, 104.0),
    (160.0, 186.0, 36.0),
    (246.0, 170.0, 20.0),
];
/// The deeper the darker.
const HEIGHTS: [(f64, f64, f64); 4] =
    [(52.0, 16.0, 40.0), (132.0, 28.0, 62.0), (206.0, 92.0, 70.0), (240.0, 186.0, 130.0)];

/// A colour for 0..=1.
fn colour(stops: &[(f64, f64, f64)], part: f64) -> RGBColor {
    let at = part.clamp(0.0, 1.0) * (stops.len() - 1) as f64;
    let index = (at as usize).min(stops.len() - 2);
    let (a, b, t) = (stops[index], stops[index + 1], at - index as f64);
    let mix = |a: f64, b: f64| (a + (b - a) * t).round() as u8;
    RGBColor(mix(a.0, b.0), mix(a.1, b.1), mix(a.2, b.2))
}

/// The path as lines of one style each: `project` puts a point on the paper, `shade` chooses the colour of the way to it.
fn draw_path(
    area: &Area,
    points: &[Point],
    scale: &Scale,
    shade: impl Fn(&Point) -> u8,
    project: impl Fn(&Point) -> (i32, i32),
) -> Drawn {
    let style = |point: &Point| if point.rapid { None } else { Some(shade(point)) };
    // Rapids first, so that they never hide a cut.
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

/// The path with points between those of a steep way, so that each piece has about one height.
fn by_height(points: &[Point], scale: &Scale) -> Vec<Point> {
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

/// Leaves out places nearer to the one before than the eye sees, but never the last.
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

/// Both ranges widened to one scale, in mm per pixel, and a margin.
fn equal_scale(low: [f64; 2], high: [f64; 2], pixels: [f64; 2]) -> ([f64; 2], [f64; 2]) {
    let size = [high[0] - low[0], high[1] - low[1]];
    let least = size[0].max(size[1]).max(0.01) * 0.01;
    let per_pixel = (0..2).map(|i| size[i].max(least) * (1.0 + 2.0 * MARGIN) / pixels[i]).fold(0.0, f64::max);
    let middle = [(low[0] + high[0]) / 2.0, (low[1] + high[1]) / 2.0];
    let half = [pixels[0] * per_pixel / 2.0, pixels[1] * per_pixel / 2.0];
    ([middle[0] - half[0], middle[1] - half[1]], [middle[0] + half[0], middle[1] + half[1]])
}

fn plan(area: &Area, points: &[Point], bounds: &Bounds, scale: &Scale) -> Drawn {
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

/// Digits after the point that labels over a range need.
fn decimals(range: f64) -> usize {
    (1.0 - (range / 5.0).max(1e-6).log10().floor()).clamp(0.0, 5.0) as usize
}

fn tidy(value: f64, places: usize) -> String {
    let text = format!("{value:.places$}");
    let text = if text.contains('.') { text.trim_end_matches('0').trim_end_matches('.') } else { &text };
    if text == "-0" { "0".into() } else { text.replace('-', "\u{2212}") }
}

/// How many times as high as it is Z is drawn at an angle, so that a shallow job is no flat sheet.
fn stretch(bounds: &Bounds) -> f64 {
    let most = HEIGHT * bounds.size(0).max(bounds.size(1)) / bounds.size(2);
    [50.0, 20.0, 10.0, 5.0, 2.0].into_iter().find(|times| *times <= most).unwrap_or(1.0)
}

/// The 3D view: a parallel (axonometric) projection of the path, from the front right and above.
fn angled(area: &Area, points: &[Point], bounds: &Bounds, scale: &Scale) -> Drawn {
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
    // Room for the labels around the box.
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
    // Without room beside a short edge it comes below.
    let y = if free <= edge { y } else { paper(corner(1)).1 };
    below.draw_text(&label(1), &anchored(HPos::Left), (free.min(edge), (y + px(10)).min(bottom)))?;
    Ok(())
}

fn scale_bar(area: &Area, title: [&str; 2], scale: &Scale) -> Drawn {
    let (top, bottom, left, right) = (px(70), px(560), px(8), px(28));
    area.draw_text(title[0], &small(), (left, top - px(46)))?;
    area.draw_text(title[1], &small(), (left, top - px(28)))?;
    let parts = 98;
    // Each reaches to the top and the next covers it, so that no seams show between them.
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

/// The speeds of at most so many spans of time, each with its beginning.
fn spans(drawing: &Drawing, most: usize) -> Vec<(f64, Column)> {
    let width = drawing.seconds() / most as f64;
    let mut spans: Vec<(f64, Column)> = Vec::new();
    let mut current = usize::MAX;
    for (at, column) in drawing.columns() {
        let index = if width > 0.0 { (at / width) as usize } else { 0 };
        match spans.last_mut() {
            Some(last) if index == current => last.1 = last.1.merge(column),
            _ => spans.push((at, column)),
        }
        current = index;
    }
    spans
}

/// Neighbours that have a value, with their places. Each value holds until the next span begins.
fn stretches<T: Copy>(spans: &[(f64, Column)], value: impl Fn(&Column) -> Option<T>) -> Vec<Vec<(f64, T)>> {
    let mut parts: Vec<Vec<(f64, T)>> = Vec::new();
    let mut open = false;
    for (at, column) in spans {
        let value = value(column);
        if open && let Some(part) = parts.last_mut() {
            part.extend(value.or_else(|| part.last().map(|last| last.1)).map(|value| (*at, value)));
        } else if let Some(value) = value {
            parts.push(vec![(*at, value)]);
        }
        open = value.is_some();
    }
    parts
}

/// The area under a curve.
fn under(curve: impl Iterator<Item = (f64, f64)>) -> Vec<(f64, f64)> {
    let mut area: Vec<(f64, f64)> = curve.collect();
    if let (Some(first), Some(last)) = (area.first().copied(), area.last().copied()) {
        area.push((last.0, 0.0));
        area.push((first.0, 0.0));
    }
    area
}

fn speed_curve(area: &Area, drawing: &Drawing, scale: &Scale) -> Drawn {
    let seconds = drawing.seconds().max(0.001);
    let (unit, name) = match seconds {
        s if s >= 2.0 * 3600.0 => (3600.0, "Time, h"),
        s if s >= 300.0 => (60.0, "Time, min"),
        _ => (1.0, "Time, s"),
    };
    let per_minute = |mm_s: f32| f64::from(mm_s) * 60.0;
    let spans = spans(drawing, CURVE_COLUMNS);
    // A rapid and what follows it may be one span, so the top is that of the path's points and not of the spans.
    let feeds = drawing.points().iter().skip(1).any(|point| !point.rapid && point.speed > 0.0);
    let rapids = spans.iter().filter_map(|span| span.1.rapid).map(per_minute).fold(0.0, f64::max);
    let top = if feeds { scale.high } else { rapids.max(1e-3) } * 1.1;
    let (left, margin) = (px(72), px(14));
    let caption = match rapids {
        r if r > top => format!("Path speed (rapids, in grey, go on to {r:.0} mm/min)"),
        r if r > 0.0 => "Path speed (rapids in grey)".into(),
        _ => "Path speed".into(),
    };
    area.draw_text(&caption, &font(15), (left + margin, px(2)))?;
    let (_, below) = area.split_vertically(px(22));
    let mut chart = ChartBuilder::on(&below)
        .margin_left(margin)
        .margin_right(px(30))
        .margin_top(px(4))
        .margin_bottom(px(10))
        .x_label_area_size(px(50))
        .y_label_area_size(left)
        .build_cartesian_2d(0.0..seconds / unit * 1.005, 0.0..top)?;
    let (x_places, y_places) = (decimals(seconds / unit), decimals(top));
    chart
        .configure_mesh()
        .x_desc(name)
        .y_desc("mm/min")
        .x_labels(14)
        .y_labels(6)
        .max_light_lines(0)
        .bold_line_style(line_style(FAINT, 10))
        .axis_style(line_style(FRAME, 10))
        .label_style(small())
        .axis_desc_style(font(14))
        .set_all_tick_mark_size(px(4))
        .x_label_formatter(&|v| tidy(*v, x_places))
        .y_label_formatter(&|v| tidy(*v, y_places))
        .draw()?;
    for rapid in stretches(&spans, |column| column.rapid) {
        let curve = rapid.iter().map(|(at, speed)| (at / unit, per_minute(*speed).min(top)));
        chart.draw_series([Polygon::new(under(curve.clone()), RAPID_CURVE.mix(0.25))])?;
        chart.draw_series([PathElement::new(curve.collect::<Vec<_>>(), line_style(RAPID_CURVE, 10))])?;
    }
    for feed in stretches(&spans, |column| column.feed) {
        let high = feed.iter().map(|(at, (_, high))| (at / unit, per_minute(*high).min(top)));
        chart.draw_series([Polygon::new(under(high), CURVE.mix(0.14))])?;
        // Where many changes fall into a span, its least and greatest speed show as a band.
        let mut curve: Vec<(f64, f64)> = Vec::with_capacity(feed.len() * 2);
        for (at, (low, high)) in feed {
            let (low, high) = (per_minute(low).min(top), per_minute(high).min(top));
            let rising = curve.last().is_none_or(|last| (last.1 - low).abs() <= (last.1 - high).abs());
            let (first, second) = if rising { (low, high) } else { (high, low) };
            curve.push((at / unit, first));
            if first != second {
                curve.push((at / unit, second));
            }
        }
        chart.draw_series([PathElement::new(curve, line_style(CURVE, 12))])?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::marks::Mark;
    use crate::path::Sample;
    use crate::summary::tests::example;

    /// A square spiral with plunges between rapids.
    fn synthetic() -> Drawing {
        let mut drawing = Drawing::new([0.0; 3], 0.0);
        let mut seconds = 0.0;
        let mut at = [0.0; 3];
        for i in 0..40 {
            let size = 60.0 - i as f64;
            let to = match i % 4 {
                0 => [size, 60.0 - size, -0.2 * i as f64],
                1 => [size, size, -0.2 * i as f64],
                2 => [60.0 - size, size, -0.2 * i as f64],
                _ => [60.0 - size, 60.0 - size, -0.2 * i as f64],
            };
            let speed = if i % 10 == 0 { 50.0 } else { 2.0 + f64::from(i) / 4.0 };
            let rapid = i % 10 == 0;
            let known_at = seconds + 0.25;
            drawing.add(Sample {
                seconds,
                time: 0.5,
                speed,
                known_at,
                rapid,
                from: at,
                to,
                new_block: true,
                mark: Mark::default(),
            });
            seconds += 0.5;
            at = to;
        }
        drawing.rest(seconds);
        drawing
    }

    #[test]
    fn the_svg_is_labelled_and_bounded_by_its_sheet() {
        let svg = svg(&synthetic(), &example()).unwrap();
        for text in ["X, mm", "Y, mm", "mm/min", "Time, s", "start", "end", "rapid", "a.nc", "Path speed"] {
            assert!(svg.contains(text), "{text}");
        }
        assert!(svg.starts_with("<svg width=\"1400\" height=\"1040\" viewBox=\"0 0 14000 10400\""));
    }

    #[test]
    fn the_png_has_text_without_fonts_of_the_machine() {
        let svg = svg(&synthetic(), &example()).unwrap();
        let with = png(&svg).unwrap();
        assert!(with.starts_with(b"\x89PNG"));
        let without: String = svg.replace("<text", "<g").replace("</text", "</g");
        assert_ne!(with, png(&without).unwrap(), "the text leaves pixels");
    }

    #[test]
    fn a_job_without_motion_can_be_drawn() {
        let drawing = Drawing::new([1.0, 2.0, 3.0], 5.0);
        assert!(svg(&drawing, &example()).is_ok());
    }

    #[test]
    fn scales_read_well() {
        assert_eq!(tight(1500.0), (1500.0, 500.0));
        assert_eq!(tight(1503.0), (1500.0, 500.0), "rounding is no speed");
        assert_eq!(tight(60.0), (60.0, 20.0));
        assert_eq!(tight(100.0), (100.0, 25.0));
        for top in [0.013, 7.0, 130.0, 333.0, 707.0, 920.0, 1640.0, 25_000.0] {
            let (end, step) = tight(top);
            assert!(end >= top * 0.99 && end <= top * 1.15, "{top} has a scale to {end}");
            assert!((2.9..8.1).contains(&(end / step)), "{top} has marks each {step}");
        }
        assert_eq!(tidy(-0.0001, 2), "0");
        assert_eq!(tidy(2.50, 2), "2.5");
        assert_eq!(tidy(100.0, 0), "100");
    }

    #[test]
    fn the_speed_chart_is_scaled_to_feeds() {
        // Rapids of 3000 mm/min, feeds of 700.
        let svg = svg(&synthetic(), &example()).unwrap();
        assert!(svg.contains("go on to 3000 mm/min"));
        assert!(!svg.contains(">\n1500\n<") && svg.contains(">\n600\n<"), "marks above the feeds, or none");
    }

    #[test]
    fn height_is_shown_by_shade_and_stretched() {
        let drawing = synthetic();
        let bounds = Bounds::of(drawing.points());
        assert_eq!((bounds.size(2) as f32, stretch(&bounds)), (7.8, 2.0));
        let scale = Scale::of_height(drawing.points(), &bounds);
        assert!(scale.shade(-7.8) == 0 && scale.shade(0.0) > 20);
        let svg = svg(&drawing, &example()).unwrap();
        for text in ["Height Z,", "drawn 2 times as high", "3 lines", "1 error"] {
            assert!(svg.contains(text), "{text}");
        }
        let mut one = example();
        one.lines = 1;
        assert!(super::svg(&drawing, &one).unwrap().contains("1 line ·"));
    }

    #[test]
    fn a_plunge_has_all_its_heights() {
        let down =
            |z: f32| Point { at: [0.0, 0.0, z], speed: 1.0, rapid: false, seconds: [0.0; 2], mark: Mark::default() };
        let points = [down(0.0), down(-5.0)];
        let scale = Scale::of_height(&points, &Bounds::of(&points));
        assert_eq!(by_height(&points, &scale).len(), 24);
    }

    #[test]
    fn names_choose_the_format() {
        assert_eq!(format_of(Path::new("a.SVG")).unwrap(), Format::Svg);
        assert_eq!(format_of(Path::new("a.png")).unwrap(), Format::Png);
        assert!(format_of(Path::new("a.pdf")).is_err());
        assert!(format_of(Path::new("svg")).is_err());
    }
}
