//! The picture of a job as SVG or PNG. It has a heading, the tool path from above (coloured by speed), and the speed
//! over time. If the job has enough depth, the picture also has the path at an angle (coloured by height).
//!
//! The drawing is always made as SVG. A PNG is that SVG rendered with an embedded font, so a PNG looks the same on
//! every computer.

mod pixels;
mod scale;
mod speed_curve;
mod style;
mod views;

use crate::files::Output;
use crate::path::Drawing;
use crate::summary::{Summary, clock_time, counted};
use anyhow::{Context, Result, anyhow, bail};
pub use pixels::png;
use plotters::prelude::*;
use plotters::style::{FontStyle, register_font};
use scale::{Bounds, SPEEDS, Scale, colour, scale_bar};
use speed_curve::speed_curve;
use std::path::Path;
use style::{Area, Drawn, FINE, RAPID, START, font, line_style, px, small};
use views::{angled, cross, plan};

/// Size of the drawing, in pixels.
const SIZE: (u32, u32) = (1400, 1040);

/// Width of a colour scale with its marks, in pixels.
const BAR: i32 = 95;

/// A job is also drawn at an angle if its depth is at least this fraction of its width.
const DEPTH: f64 = 0.005;

/// File format of a drawing.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Format {
    /// SVG: lines and text.
    Svg,
    /// PNG: pixels.
    Png,
}

/// Returns the format according to a file's extension, `.svg` or `.png` in any case. Any other extension is an error.
pub fn format_of(path: &Path) -> Result<Format> {
    match path.extension().map(|e| e.to_ascii_lowercase()).as_deref().and_then(|e| e.to_str()) {
        Some("svg") => Ok(Format::Svg),
        Some("png") => Ok(Format::Png),
        _ => bail!("a drawing is a .svg or a .png file, which {} is not", path.display()),
    }
}

/// Draws a job into a file, in the format of the file's extension.
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

/// Draws a job and returns the picture as the text of an SVG file.
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
    // Up to here, the width and the height of the SVG are in fine units. Convert them to pixels, but leave the viewBox
    // in fine units.
    let fine = format!("<svg width=\"{}\" height=\"{}\"", SIZE.0 * FINE as u32, SIZE.1 * FINE as u32);
    Ok(svg.replacen(&fine, &format!("<svg width=\"{}\" height=\"{}\"", SIZE.0, SIZE.1), 1))
}

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

#[cfg(test)]
mod tests {
    use super::scale::tight;
    use super::style::tidy;
    use super::views::{by_height, stretch};
    use super::*;
    use crate::marks::Mark;
    use crate::path::{Point, Sample};
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
    fn whatever_the_svg_has_the_png_has() {
        assert!(png(&svg(&synthetic(), &example()).unwrap()).unwrap().starts_with(b"\x89PNG"));
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
        // Rapids at 3000 mm/min, feeds at 700.
        let svg = svg(&synthetic(), &example()).unwrap();
        assert!(svg.contains("reach 3000 mm/min"));
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
