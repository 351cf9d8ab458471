//! The path speed over time, column by column: feeds as a line with a band between minimum and maximum speed, rapids in
//! grey.

use super::scale::Scale;
use super::style::{Area, CURVE, Drawn, FAINT, FRAME, RAPID_CURVE, decimals, font, line_style, px, small, tidy};
use crate::path::{Column, Drawing};
use plotters::prelude::*;

/// Maximum number of spans of time in the drawn curve.
const CURVE_COLUMNS: usize = 1200;

/// Merges the columns of the drawing into at most `most` equal spans of time. Each span has the time of its first
/// column.
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

/// Cuts the curve where `value` returns `None`. Returns each part as a list of (time, value). A value holds until the
/// next span begins, so a part ends with its last value repeated at that time.
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

/// Returns the outline of the area under a curve.
fn under(curve: impl Iterator<Item = (f64, f64)>) -> Vec<(f64, f64)> {
    let mut area: Vec<(f64, f64)> = curve.collect();
    if let (Some(first), Some(last)) = (area.first().copied(), area.last().copied()) {
        area.push((last.0, 0.0));
        area.push((first.0, 0.0));
    }
    area
}

pub(super) fn speed_curve(area: &Area, drawing: &Drawing, scale: &Scale) -> Drawn {
    let seconds = drawing.seconds().max(0.001);
    let (unit, name) = match seconds {
        s if s >= 2.0 * 3600.0 => (3600.0, "Time, h"),
        s if s >= 300.0 => (60.0, "Time, min"),
        _ => (1.0, "Time, s"),
    };
    let per_minute = |mm_s: f32| f64::from(mm_s) * 60.0;
    let spans = spans(drawing, CURVE_COLUMNS);
    // If the job has feeds, the axis ends a little above their scale, and faster rapids are cut off there. Look for
    // feeds in the points of the path, because a span of time can contain both a rapid and a feed.
    let feeds = drawing.points().iter().skip(1).any(|point| !point.rapid && point.speed > 0.0);
    let rapids = spans.iter().filter_map(|span| span.1.rapid).map(per_minute).fold(0.0, f64::max);
    let top = if feeds { scale.high } else { rapids.max(1e-3) } * 1.1;
    let (left, margin) = (px(72), px(14));
    let caption = match rapids {
        r if r > top => format!("Path speed (rapids, in grey, reach {r:.0} mm/min)"),
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
        // If the speed changes within a span, draw both its minimum and its maximum. Where the speed changes often,
        // they appear as a band.
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
