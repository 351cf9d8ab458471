//! The data of a drawing: the points of the tool path, and the speed curve in columns (spans of time). Both have a
//! maximum size, however long the job. Points are thinned within a tolerance (Douglas-Peucker), and neighbouring
//! columns are merged.

use crate::marks::Mark;
use oxmill_controller::axes::LINEAR;

/// Maximum number of points of the path.
const POINTS: usize = 300_000;
/// Maximum number of columns of the speed curve. When a job exceeds it, neighbouring columns are merged.
const COLUMNS: usize = 8_192;
/// Initial width of a column, in seconds: shorter than a segment.
const FIRST_WIDTH: f64 = 0.000_25;
/// Motions can be merged if their speeds differ by less than this fraction of the maximum speed, because such speeds
/// look the same in a drawing.
const SAME_SPEED: f32 = 0.02;

/// Initial tolerance of the path, in mm: removing points moves the path by at most this much. `thin_out` doubles the
/// tolerance when needed.
const FIRST_TOLERANCE: f32 = 0.000_5;
/// Maximum number of points that are thinned together.
const AT_A_TIME: usize = 512;

/// A piece of uniformly accelerated motion within a straight move: a segment of the step task.
#[derive(Clone, Copy, Debug)]
pub struct Sample {
    /// Start time, in seconds of virtual time.
    pub seconds: f64,
    /// Duration in seconds.
    pub time: f64,
    /// Mean path speed in mm/s.
    pub speed: f64,
    /// The time to which `speed` belongs, in seconds of virtual time: the middle of the window over which the speed was
    /// averaged.
    pub known_at: f64,
    /// Whether the move is a rapid.
    pub rapid: bool,
    /// Where the straight move started, in mm.
    pub from: [f64; LINEAR],
    /// Where the motion of this sample ended, in mm.
    pub to: [f64; LINEAR],
    /// Whether this is the first sample of its straight move.
    pub new_block: bool,
    /// The line and tool of the move, if `Simulator::mark_moves` was called.
    pub mark: Mark,
}

/// A point of the path, with the motion that led to it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Point {
    /// Position in mm.
    pub at: [f32; LINEAR],
    /// Mean path speed of the motion to this point, in mm/s.
    pub speed: f32,
    /// Whether the motion to this point is a rapid.
    pub rapid: bool,
    /// Start and end time of the motion to this point, in seconds from the start of the drawing.
    pub seconds: [f64; 2],
    /// The line and tool of the motion to this point, if `Simulator::mark_moves` was called. If several motions were
    /// merged, this is the mark of the last of them.
    pub mark: Mark,
}

impl Point {
    /// Returns the properties that must be equal for points to be merged: rapid, arc, tool and spindle speed.
    fn kind(&self) -> (bool, bool, u32, u32) {
        (self.rapid, self.mark.arc, self.mark.tool, self.mark.speed)
    }
}

/// Speeds within a span of time.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Column {
    /// Minimum and maximum speed of feeds in mm/s (0 at rest); `None` if neither a feed nor a rest was recorded in the
    /// span.
    pub feed: Option<(f32, f32)>,
    /// Maximum speed of rapids, in mm/s; `None` if there was no rapid.
    pub rapid: Option<f32>,
}

impl Column {
    pub(crate) fn merge(self, other: Column) -> Column {
        let feed = match (self.feed, other.feed) {
            (Some((low, high)), Some((l, h))) => Some((low.min(l), high.max(h))),
            (one, None) => one,
            (None, other) => other,
        };
        Column { feed, rapid: self.rapid.into_iter().chain(other.rapid).reduce(f32::max) }
    }

    /// Returns whether a feed, a rapid or a rest was recorded in the column's span of time. If not, the speed of the
    /// previous column still holds.
    fn is_known(&self) -> bool {
        self.feed.is_some() || self.rapid.is_some()
    }
}

/// The path and the speed curve.
#[derive(Clone, Debug)]
pub struct Drawing {
    origin: f64,
    end: f64,
    limit: usize,
    points: Vec<Point>,
    tolerance: f32,
    width: f64,
    columns: Vec<Column>,
    top_speed: f32,
    /// `true` if the next sample of the same straight move can move the last point, instead of adding a point.
    extend: bool,
    /// Speed of the first sample that was merged into the last point, in mm/s. Further samples are merged only if
    /// their speeds differ little from this speed.
    first_speed: f32,
}

impl Drawing {
    /// Starts a drawing at a tool position in mm. `seconds`: the virtual time at which the drawing begins.
    pub fn new(start: [f64; LINEAR], seconds: f64) -> Self {
        Self::with_limit(start, seconds, POINTS)
    }

    fn with_limit(start: [f64; LINEAR], seconds: f64, limit: usize) -> Self {
        Self {
            origin: seconds,
            end: seconds,
            limit,
            points: vec![Point {
                at: start.map(|v| v as f32),
                speed: 0.0,
                rapid: true,
                seconds: [0.0; 2],
                mark: Mark::default(),
            }],
            tolerance: FIRST_TOLERANCE,
            width: FIRST_WIDTH,
            columns: Vec::new(),
            top_speed: 0.0,
            extend: false,
            first_speed: 0.0,
        }
    }

    /// Adds a sample to the path and to the speed curve.
    pub fn add(&mut self, sample: Sample) {
        let began = sample.seconds - self.origin;
        let point = Point {
            at: sample.to.map(|v| v as f32),
            speed: sample.speed as f32,
            rapid: sample.rapid,
            seconds: [began, began + sample.time],
            mark: sample.mark,
        };
        self.top_speed = self.top_speed.max(point.speed);
        let near = self.top_speed * SAME_SPEED;
        let first_speed = self.first_speed;
        let same = |last: &Point| last.rapid == point.rapid && (first_speed - point.speed).abs() <= near;
        match self.points.last_mut() {
            Some(last) if self.extend && !sample.new_block && same(last) => {
                last.speed = mean_speed(last, &point);
                last.at = point.at;
                last.seconds[1] = point.seconds[1];
            }
            _ => {
                self.first_speed = point.speed;
                self.points.push(point);
            }
        }
        self.extend = true;
        if self.points.len() >= self.limit {
            self.thin_out();
        }
        if self.columns.is_empty() || sample.seconds > self.end + self.width {
            self.mark(sample.seconds, Column { feed: Some((0.0, 0.0)), rapid: None });
        }
        let speed = point.speed;
        let column = match sample.rapid {
            true => Column { feed: None, rapid: Some(speed) },
            false => Column { feed: Some((speed, speed)), rapid: None },
        };
        self.mark(sample.known_at, column);
        self.end = self.end.max(sample.seconds + sample.time);
    }

    /// Records that the machine is at rest from `seconds` (virtual time) on.
    pub fn rest(&mut self, seconds: f64) {
        self.mark(seconds, Column { feed: Some((0.0, 0.0)), rapid: None });
        self.end = self.end.max(seconds);
        self.extend = false;
    }

    /// The points of the path, including its start.
    pub fn points(&self) -> &[Point] {
        &self.points
    }

    /// The columns in which a speed was recorded, as (middle in seconds from the start, column), in order of time.
    pub fn columns(&self) -> impl Iterator<Item = (f64, Column)> + '_ {
        let middle = |index: usize| (index as f64 + 0.5) * self.width;
        self.columns
            .iter()
            .enumerate()
            .filter(|(_, column)| column.is_known())
            .map(move |(i, column)| (middle(i), *column))
    }

    /// Duration of the drawing, in seconds.
    pub fn seconds(&self) -> f64 {
        self.end - self.origin
    }

    fn mark(&mut self, seconds: f64, column: Column) {
        let seconds = (seconds - self.origin).max(0.0);
        while seconds >= self.width * COLUMNS as f64 {
            self.columns = self
                .columns
                .chunks(2)
                .map(|pair| pair.iter().fold(Column::default(), |sum, column| sum.merge(*column)))
                .collect();
            self.width *= 2.0;
        }
        let index = (seconds / self.width) as usize;
        if self.columns.len() <= index {
            self.columns.resize(index + 1, Column::default());
        }
        self.columns[index] = self.columns[index].merge(column);
    }

    /// Removes points, the least visible ones first, until a quarter of the space is free again. Doubles the tolerance
    /// only as often as needed.
    fn thin_out(&mut self) {
        loop {
            let speed = self.top_speed * SAME_SPEED * 2.0 * (self.tolerance / FIRST_TOLERANCE);
            self.points = simplified(&self.points, self.tolerance, speed.max(f32::MIN_POSITIVE));
            if self.points.len() <= self.limit * 3 / 4 {
                break;
            }
            self.tolerance *= 2.0;
        }
        self.extend = false;
    }
}

/// Returns the path without the points that matter little: their removal moves the path by at most `tolerance` (mm) and
/// changes the speed there by at most `speed` (mm/s). Uses Douglas-Peucker on at most `AT_A_TIME` points at once.
fn simplified(points: &[Point], tolerance: f32, speed: f32) -> Vec<Point> {
    // If the tolerance has grown beyond the size of any machine (10 m), merge points of different kinds, too. Otherwise
    // a job whose points all differ in kind would never shrink.
    let mixed = tolerance > 1e4;
    let mut kept = vec![false; points.len()];
    let mut start = 0;
    let mut open = Vec::new();
    while start + 1 < points.len() {
        let mut end = start + 1;
        while end + 1 < points.len()
            && end - start < AT_A_TIME
            && (mixed || points[end + 1].kind() == points[end].kind())
        {
            end += 1;
        }
        kept[start] = true;
        kept[end] = true;
        open.push((start, end));
        while let Some((from, to)) = open.pop() {
            let off = |i: usize| {
                let place = off_line(points[from].at, points[i].at, points[to].at) / tolerance;
                place.max((points[i].speed - points[to].speed).abs() / speed)
            };
            let worst = (from + 1..to).map(|i| (i, off(i))).max_by(|a, b| a.1.total_cmp(&b.1));
            if let Some((at, off)) = worst
                && off > 1.0
            {
                kept[at] = true;
                open.push((from, at));
                open.push((at, to));
            }
        }
        start = end;
    }
    let mut left_out: Option<Point> = None;
    let mut simple = Vec::new();
    for (point, kept) in points.iter().zip(kept) {
        let way = left_out.map_or(*point, |before| Point {
            speed: mean_speed(&before, point),
            seconds: [before.seconds[0], point.seconds[1]],
            ..*point
        });
        if kept {
            simple.push(way);
            left_out = None;
        } else {
            left_out = Some(way);
        }
    }
    simple
}

/// Returns the mean speed of two consecutive motions, in mm/s.
fn mean_speed(one: &Point, other: &Point) -> f32 {
    let [first, second] = [one, other].map(|point| (point.seconds[1] - point.seconds[0]).max(0.0));
    let whole = first + second;
    if whole == 0.0 {
        return other.speed;
    }
    ((f64::from(one.speed) * first + f64::from(other.speed) * second) / whole) as f32
}

/// Returns the distance of `point` from the line segment between `a` and `b`.
fn off_line(a: [f32; LINEAR], point: [f32; LINEAR], b: [f32; LINEAR]) -> f32 {
    let line: [f32; LINEAR] = std::array::from_fn(|i| b[i] - a[i]);
    let to: [f32; LINEAR] = std::array::from_fn(|i| point[i] - a[i]);
    let dot = |u: &[f32; LINEAR], v: &[f32; LINEAR]| u.iter().zip(v).map(|(u, v)| u * v).sum::<f32>();
    let length2 = dot(&line, &line);
    let along = if length2 > 0.0 { (dot(&to, &line) / length2).clamp(0.0, 1.0) } else { 0.0 };
    let off: [f32; LINEAR] = std::array::from_fn(|i| to[i] - line[i] * along);
    dot(&off, &off).sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sample(index: usize, to: [f64; 3], speed: f64, new_block: bool) -> Sample {
        let seconds = index as f64 * 0.001;
        let known_at = seconds + 0.0005;
        Sample {
            seconds,
            time: 0.001,
            speed,
            known_at,
            rapid: false,
            from: [0.0; 3],
            to,
            new_block,
            mark: Mark { line: index as u32, ..Mark::default() },
        }
    }

    #[test]
    fn even_motion_is_one_line() {
        let mut drawing = Drawing::new([0.0; 3], 0.0);
        for i in 0..1000 {
            drawing.add(sample(i, [i as f64, 0.0, 0.0], 10.0, i == 0));
        }
        drawing.rest(1.0);
        assert_eq!(drawing.points().len(), 2);
        assert_eq!(drawing.points()[1].at, [999.0, 0.0, 0.0]);
        assert!((drawing.seconds() - 1.0).abs() < 1e-9);
    }

    #[test]
    fn a_line_of_several_pieces_has_their_mean_speed() {
        let speeds = [100.0, 99.0, 98.5, 98.25];
        let mut drawing = Drawing::new([0.0; 3], 0.0);
        for (i, speed) in speeds.into_iter().enumerate() {
            drawing.add(sample(i, [i as f64 + 1.0, 0.0, 0.0], speed, i == 0));
        }
        assert_eq!(drawing.points().len(), 2);
        assert!((drawing.points()[1].speed - 98.9375).abs() < 1e-3, "{:?}", drawing.points()[1]);
        // The mean speed is the same if the path has a point for each sample and `simplified` merges these points.
        let points: Vec<Point> = std::iter::once(drawing.points()[0])
            .chain(speeds.iter().enumerate().map(|(i, speed)| {
                let seconds = [i as f64, i as f64 + 1.0];
                Point { at: [i as f32 + 1.0, 0.0, 0.0], speed: *speed as f32, seconds, ..drawing.points()[1] }
            }))
            .collect();
        let simple = simplified(&points, 0.1, 10.0);
        assert_eq!(simple.len(), 2);
        assert!((simple[1].speed - 98.9375).abs() < 1e-3 && simple[1].seconds == [0.0, 4.0], "{:?}", simple[1]);
    }

    #[test]
    fn the_number_of_points_is_bounded_and_the_shape_stays() {
        let mut drawing = Drawing::with_limit([50.0, 0.0, 0.0], 0.0, 8000);
        for i in 1..100_000 {
            // The circle has 159 turns (1000 rad). If 8000 points remain, each turn has about 50. A turn looks round
            // with a dozen points already.
            let angle = i as f64 * 0.01;
            let to = [50.0 * angle.cos(), 50.0 * angle.sin(), 0.0];
            drawing.add(sample(i, to, 10.0, true));
            assert!(drawing.points().len() <= 8000);
        }
        for pair in drawing.points()[1..].windows(2) {
            let middle = [(pair[0].at[0] + pair[1].at[0]) / 2.0, (pair[0].at[1] + pair[1].at[1]) / 2.0];
            assert!(middle[0].hypot(middle[1]) > 45.0, "{pair:?} cuts the corner");
            let gap = pair[1].seconds[0] - pair[0].seconds[1];
            assert!(gap.abs() < 1e-9 && pair[1].mark.line > pair[0].mark.line, "{pair:?} leaves out a time");
        }
    }

    #[test]
    fn the_speed_curve_keeps_its_peaks() {
        let mut drawing = Drawing::new([0.0; 3], 100.0);
        for i in 0..100_000 {
            let mut s = sample(i, [i as f64, 0.0, 0.0], if i == 70_000 { 99.0 } else { 10.0 }, false);
            s.seconds += 100.0;
            s.known_at += 100.0;
            drawing.add(s);
        }
        let top = |column: &Column| column.feed.map_or(0.0, |feed| feed.1);
        let (at, peak) = drawing.columns().max_by(|a, b| top(&a.1).total_cmp(&top(&b.1))).unwrap();
        assert_eq!(top(&peak), 99.0);
        assert!((at - 70.0).abs() < 0.1);
        assert!(drawing.columns().count() <= COLUMNS);
    }
}
