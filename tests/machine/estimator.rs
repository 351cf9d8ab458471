//! Measures speed and acceleration on a step trace, and compares them with the machine's limits.
//!
//! The paragraphs below explain how each limit is measured, and by how much a measured value may exceed it.
//!
//! **Speed.** The path speed comes from the intervals between steps of a block's dominant axis (the axis with the most
//! steps). Only intervals shorter than 1 ms count. A step time is rounded to a tick of the step clock, so each interval
//! can be off by one tick. In addition each limit may be exceeded by 1 % ([`TOLERANCE`]).
//!
//! **Slow steps.** Below 8000 steps/s the step generator works on a finer grid. There a step comes up to 7/16 of a step
//! earlier in the path than at higher rates. Where the grid changes, an interval is longer or shorter by up to this
//! share. So below this rate a speed is measured over 16 steps, and the length of these steps may be off by 7/16 of a
//! step.
//!
//! **Acceleration.** It is the change of speed between two intervals, divided by the time between their middles. Under
//! constant acceleration, the mean speed of an interval is the speed at its middle. Otherwise the quotient is a mean of
//! accelerations, and each of these must keep the limit. Each interval is compared with the intervals 1, 2, 4, 8, ...
//! later. So the test finds both a jump of speed and a small lasting excess. A change of acceleration shows only at the
//! next whole step of the dominant axis, and then in full. So an acceleration can seem to have acted for one step
//! longer than the time between two intervals.
//!
//! **Ends of a move.** They are rounded to steps. So the length of a move can be off by half a step, and its speeds by
//! the same share.
//!
//! **Very slow motion.** Below one step per millisecond a single interval says little. Only the mean speed of a whole
//! move is checked there, and the motion near rest, at the start and the end of the trace. Within a time t after its
//! first step, the machine moves by at most one step more than `v t + a t² / 2`. Here v is the speed that the
//! acceleration a reaches within one step: `v² = 2 a` × the length of a step.
//!
//! **Corners.** At a corner the junction rule bounds the path speed. It takes a circle that cuts the corner and passes
//! within the junction deviation of it. It allows the speed at which this circle needs the acceleration that the axes
//! allow across the path. The two intervals next to the corner may be faster by what the block's acceleration adds in
//! the time between them. That time is longer than the time from either interval to the corner.
//!
//! **Bends.** On a chain of moves without a sharp corner v² is at most a·R. Here R is the radius of the bend, and a the
//! acceleration that the axes allow towards its centre. R comes from three points: the corner and one point on each
//! side. The side points are the ends of the neighbouring moves, or points about one of [`REACHES`] away. Points that
//! far away are used only if the path turns by less than [`GENTLE`] between them. The junction deviation also grants a
//! jump for the whole turn. Every point of a bend can be half a digit off. The part of the turn that this can explain
//! is subtracted. A planner that uses other points can see a bend start half a reach later and still brake within the
//! bend. So v² may be larger by a·reach.
//!
//! **Joined lines.** The machine can have joined short lines that continue each other to one move ([`Joins`]). Then the
//! trace follows the straight line from the start of the first line to the end of the last one. All points between them
//! are within half a step of this line. The trace does not show which lines were joined. The machine can have driven
//! the last few lines as a separate move, half a step longer or shorter than these lines. So the speed of joined lines
//! is also measured over 16 steps, and their length may be off by half a step.
//!
//! **Straight lines.** Coordinates of programs are off by up to half a digit. So the path counts as straight if the
//! directions of two moves differ by no more than one digit over the length of the shorter move.

use super::oracle::{AXES, Place, Pulse, dominant, follow_line};
use std::collections::BTreeSet;

/// Share by which a limit may be exceeded.
pub const TOLERANCE: f64 = 0.01;
/// Resolution of the coordinates of the programs in these tests, mm.
pub const DIGIT: f64 = 0.001;

/// Distances along the path, mm. To measure how tight the bend at a corner is, a point about this far from the corner
/// is used on each side.
const REACHES: [f64; 6] = [0.25, 0.5, 1.0, 2.0, 4.0, 8.0];
/// Maximum turn of the path, rad, between the two points that are about one of [`REACHES`] away from the corner. If
/// the path turns more, they are not used.
const GENTLE: f64 = 0.35;
/// Maximum turn at a single point that still counts as a bend, rad.
const SHARP: f64 = 0.6;
/// Minimum ratio of a point's straight distance from a corner to its distance along the path. A point with a lower
/// ratio is not used to measure the bend.
const STRAIGHTNESS: f64 = 0.95;

/// Maximum distance of a point from its intended position, mm: half a digit in two axes at once, rounded up.
const NOISE: f64 = 0.0008;

/// Step rate, steps/s, below which the controller places steps on a finer grid.
const SMOOTHED: f64 = 8000.0;
/// Maximum shift of a step by the finer grid, in steps.
const SHIFT: f64 = 7.0 / 16.0;
/// Maximum error of the length of a part of a joined move, in steps. The machine can have driven this part as a
/// separate move, and the ends of a move are rounded to steps.
const JOINED_SHIFT: f64 = 0.5;
/// Number of steps over which a speed is measured on the finer grid and in joined moves.
const WINDOW: usize = 16;

/// The limits of a machine: for each axis steps/mm, maximum rate (mm/s) and acceleration (mm/s²); junction deviation
/// (mm).
#[derive(Clone, Debug)]
pub struct Limits {
    pub steps_per_mm: [f64; AXES],
    pub rate: [f64; AXES],
    pub acceleration: [f64; AXES],
    pub junction_deviation: f64,
}

/// A straight move of a program.
#[derive(Clone, Copy, Debug)]
pub struct Line {
    /// Start, mm.
    pub from: [f64; AXES],
    /// End, mm.
    pub to: [f64; AXES],
    /// Programmed speed in mm/s; `None` for a rapid.
    pub feed: Option<f64>,
}

/// A move with its limits and its step times.
struct Move {
    from: [f64; AXES],
    to: [f64; AXES],
    unit: [f64; AXES],
    length: f64,
    speed: f64,
    acceleration: f64,
    /// mm of path for each step of the dominant axis.
    pitch: f64,
    /// Half a step, as a share of the length. The ends are rounded to steps, so the length can be off by this share.
    slack: f64,
    /// `true` if several lines of the program can have been joined to this move.
    is_joined: bool,
    /// Times of the steps of the dominant axis, ticks.
    times: Vec<u64>,
}

/// The mean speed between two dominant steps.
#[derive(Clone, Copy, Debug)]
struct Reading {
    /// Middle of the interval, s.
    at: f64,
    /// Length of the interval, s.
    span: f64,
    /// Mean time per step in the interval, s.
    step: f64,
    /// mm/s.
    speed: f64,
    /// Maximum error of `speed` due to the rounding to ticks and to step positions, mm/s.
    rounding: f64,
}

impl Reading {
    /// Returns the time, s, for which an acceleration can act between two readings. The two mean speeds can differ by
    /// at most the acceleration × this time. The time is a sum of three parts: the time between the middles of the
    /// intervals; a quarter of the difference of their lengths; and one step, because a change of acceleration can show
    /// one step late.
    fn apart(&self, other: &Reading) -> f64 {
        (self.at - other.at).abs() + (self.span - other.span).abs() / 4.0 + self.step.max(other.step)
    }
}

impl Limits {
    /// Returns the maximum speed or acceleration along a direction (`unit`) at which no axis exceeds its own value in
    /// `values`.
    fn along(&self, values: [f64; AXES], unit: [f64; AXES]) -> f64 {
        (0..AXES).filter(|&a| unit[a] != 0.0).map(|a| values[a] / unit[a].abs()).fold(f64::INFINITY, f64::min)
    }

    /// Returns the position in steps nearest to `mm`; a half is rounded away from zero. Steps are first rounded to
    /// 1e-6, because the binary value of a decimal such as 2.03 can be slightly too small.
    pub fn place(&self, mm: [f64; AXES]) -> Place {
        std::array::from_fn(|a| ((mm[a] * self.steps_per_mm[a] * 1e6).round() / 1e6).round() as i64)
    }

    /// Returns the maximum path speed at the corner between two directions.
    ///
    /// `noise`: angle by which rounding of the points can have changed the corner, rad.
    pub fn junction(&self, before: [f64; AXES], after: [f64; AXES], noise: f64) -> f64 {
        let turn: [f64; AXES] = std::array::from_fn(|a| after[a] - before[a]);
        let size = norm(turn);
        let angle = 2.0 * (size / 2.0).min(1.0).asin() - noise;
        if angle < 1e-4 {
            return f64::INFINITY;
        }
        // The cosine of half the turn: 1 straight on, 0 for a reversal.
        let half = (angle / 2.0).cos();
        let acceleration = self.along(self.acceleration, turn.map(|t| t / size));
        (acceleration * self.junction_deviation * half / (1.0 - half)).sqrt()
    }
}

fn norm(v: [f64; AXES]) -> f64 {
    v.iter().map(|x| x * x).sum::<f64>().sqrt()
}

/// Maximum length of a line that can be joined with others, as the sum over its axes, mm.
const MOST_PIECE: f64 = 0.045 + 1e-9;
/// Maximum length of a joined move, mm.
const MOST_JOINED: f64 = 0.5 + 1e-6;

/// Returns whether a straight line passes a point within half a step of every axis.
fn passes(limits: &Limits, from: [f64; AXES], to: [f64; AXES], place: [f64; AXES]) -> bool {
    let (mut least, mut most) = (0.0_f64, 1.0_f64);
    for a in 0..AXES {
        let (way, part, half) = (to[a] - from[a], place[a] - from[a], 0.5 / limits.steps_per_mm[a] + 1e-7);
        if way != 0.0 {
            let (one, other) = ((part - half) / way, (part + half) / way);
            (least, most) = (least.max(one.min(other)), most.min(one.max(other)));
        } else if part.abs() > half {
            return false;
        }
    }
    least <= most
}

/// Finds the moves that the machine can have made by joining lines of a program.
struct Joins<'a> {
    lines: &'a [Line],
    limits: &'a Limits,
}

impl Joins<'_> {
    fn has_steps(&self, index: usize) -> bool {
        let line = &self.lines[index];
        dominant(self.limits.place(line.from), self.limits.place(line.to)).1 > 0
    }

    /// Returns the possible last lines of a move that starts with line `first`, as indexes, the shortest move first.
    /// If the last line is `first` itself, no lines have been joined.
    fn ends(&self, first: usize) -> Vec<usize> {
        let (start, mut ends) = (&self.lines[first], vec![first]);
        let is_short = |line: &Line| (0..AXES).map(|a| (line.to[a] - line.from[a]).abs()).sum::<f64>() <= MOST_PIECE;
        if !is_short(start) {
            return ends;
        }
        for (index, line) in self.lines.iter().enumerate().skip(first + 1) {
            let length = norm(std::array::from_fn(|a| line.to[a] - start.from[a]));
            if line.feed != start.feed || !is_short(line) || length > MOST_JOINED {
                break;
            }
            let mut between = self.lines[first..index].iter();
            let moved = dominant(self.limits.place(start.from), self.limits.place(line.to)).1 > 0;
            if moved && self.has_steps(index) && between.all(|l| passes(self.limits, start.from, line.to, l.to)) {
                ends.push(index);
            }
        }
        ends
    }

    /// Finds the moves that the trace follows from start to end. Returns for each its first line, its last line, and
    /// the times of its dominant steps. Tries the longest moves first, and backtracks.
    fn follow(&self, trace: &[Pulse]) -> Result<Vec<(usize, usize, Vec<u64>)>, String> {
        let mut found: Vec<(usize, usize, Vec<u64>)> = Vec::new();
        let mut open: Vec<(usize, &[Pulse], Vec<usize>)> = Vec::new();
        let (mut next, mut rest) = (0, trace);
        let mut seen = BTreeSet::new();
        let mut first_fault = None;
        loop {
            while next < self.lines.len() && !self.has_steps(next) {
                next += 1;
            }
            if next == self.lines.len() {
                if rest.is_empty() {
                    return Ok(found);
                }
                first_fault.get_or_insert(format!(
                    "{} pulses after the end of the last move, the first at {}",
                    rest.len(),
                    rest[0].at
                ));
            } else if seen.insert((next, rest.len())) {
                open.push((next, rest, self.ends(next)));
            }
            loop {
                let Some((first, before, ends)) = open.last_mut() else { return Err(first_fault.unwrap_or_default()) };
                let Some(last) = ends.pop() else {
                    open.pop();
                    found.pop();
                    continue;
                };
                let (from, to) = (self.limits.place(self.lines[*first].from), self.limits.place(self.lines[last].to));
                let mut after = *before;
                match follow_line(&mut after, from, to) {
                    Ok(times) => {
                        found.truncate(open.len() - 1);
                        found.push((open[open.len() - 1].0, last, times));
                        (next, rest) = (last + 1, after);
                        break;
                    }
                    Err(fault) if ends.is_empty() => {
                        first_fault.get_or_insert(fault);
                    }
                    Err(_) => {}
                }
            }
        }
    }
}

/// Returns the moves that have steps, with their step times.
fn moves(trace: &[Pulse], lines: &[Line], limits: &Limits) -> Result<Vec<Move>, String> {
    let mut moves = Vec::new();
    let mut next = 0;
    for (first, last, times) in (Joins { lines, limits }).follow(trace)? {
        // The length of lines without a step is added to the next move.
        let skipped = &lines[next..first];
        let carried: f64 = skipped.iter().map(|line| norm(std::array::from_fn(|a| line.to[a] - line.from[a]))).sum();
        next = last + 1;
        let line = &Line { to: lines[last].to, ..lines[first] };
        let delta: [f64; AXES] = std::array::from_fn(|a| line.to[a] - line.from[a]);
        let length = norm(delta);
        let count = dominant(limits.place(line.from), limits.place(line.to)).1;
        let unit = delta.map(|d| d / length);
        let rate = limits.along(limits.rate, unit);
        moves.push(Move {
            from: line.from,
            to: line.to,
            unit,
            length,
            speed: line.feed.unwrap_or(rate).min(rate),
            acceleration: limits.along(limits.acceleration, unit),
            pitch: (length + carried) / count as f64,
            slack: 0.5 / count as f64,
            is_joined: last > first,
            times,
        });
    }
    Ok(moves)
}

/// Compares a trace of straight moves with the program and the limits. The path is compared step for step, speeds and
/// accelerations as described at the head of this file. The trace must start and end at rest.
///
/// # Errors
/// The first fault.
pub fn check(trace: &[Pulse], hz: f64, lines: &[Line], limits: &Limits) -> Result<(), String> {
    let moves = moves(trace, lines, limits)?;
    for (index, m) in moves.iter().enumerate() {
        check_move(m, hz).map_err(|e| format!("move {index}: {e}"))?;
    }
    for (index, pair) in moves.windows(2).enumerate() {
        check_corner(&pair[0], &pair[1], hz, limits).map_err(|e| format!("corner after move {index}: {e}"))?;
    }
    for corner in 1..moves.len() {
        check_bend(&moves, corner, hz, limits).map_err(|e| format!("bend after move {}: {e}", corner - 1))?;
    }
    if let Some(first) = moves.first() {
        check_rest(first, first.times.iter().map(|t| (t - first.times[0]) as f64 / hz))
            .map_err(|e| format!("start: {e}"))?;
    }
    if let Some(last) = moves.last() {
        let end = last.times[last.times.len() - 1];
        check_rest(last, last.times.iter().rev().map(|t| (end - t) as f64 / hz)).map_err(|e| format!("end: {e}"))?;
    }
    Ok(())
}

/// Returns the mean speed in each interval between two steps of the dominant axis; `None` for intervals longer than a
/// millisecond. In a joined move and at low step rates, the mean covers up to [`WINDOW`] intervals from this one on. It
/// ends before the first interval longer than a millisecond.
fn readings(m: &Move, hz: f64) -> Vec<Option<Reading>> {
    (1..m.times.len())
        .map(|i| {
            let interval = |i: usize| (m.times[i] - m.times[i - 1]) as f64;
            let (mut last, mut shift) = (i, 0.0);
            if m.is_joined || interval(i) > hz / SMOOTHED {
                shift = if m.is_joined { JOINED_SHIFT } else { SHIFT };
                let end = m.times.len().min(i + WINDOW);
                last = (i..end).take_while(|&k| interval(k) < hz / 1000.0).last()?;
            }
            let (from, to) = (m.times[i - 1], m.times[last]);
            let ticks = (to - from) as f64;
            let steps = (last + 1 - i) as f64;
            let speed = m.pitch * steps / (ticks / hz);
            let rounding = speed / (ticks - 1.0).max(1.0) + shift * m.pitch / (ticks / hz);
            let (at, span) = ((from + to) as f64 / 2.0 / hz, ticks / hz);
            (ticks > 0.0).then_some(Reading { at, span, step: span / steps, speed, rounding })
        })
        .collect()
}

fn check_move(m: &Move, hz: f64) -> Result<(), String> {
    let readings = readings(m, hz);
    for reading in readings.iter().flatten() {
        if reading.speed > m.speed * (1.0 + TOLERANCE + m.slack) + reading.rounding {
            return Err(format!("{} mm/s where {} are allowed, at {} s", reading.speed, m.speed, reading.at));
        }
    }
    // Feeds below one step per millisecond have no `readings`, so check the mean speed of the whole move, too.
    if let [first, .., last] = m.times[..] {
        let seconds = (last - first) as f64 / hz;
        let steps = (m.times.len() - 1) as f64;
        if (steps - SHIFT) * m.pitch > m.speed * (1.0 + TOLERANCE + m.slack) * seconds {
            return Err(format!("{steps} steps of {} mm in {seconds} s: faster than {} mm/s", m.pitch, m.speed));
        }
    }
    let mut distance = 1;
    while distance < readings.len() {
        for i in 0..readings.len() - distance {
            if let (Some(a), Some(b)) = (readings[i], readings[i + distance]) {
                let most = m.acceleration * (1.0 + TOLERANCE + m.slack);
                let allowed = most * a.apart(&b) + a.rounding + b.rounding;
                if (b.speed - a.speed).abs() > allowed {
                    return Err(format!(
                        "from {} to {} mm/s in {} s, at {} s: {} mm/s² are allowed",
                        a.speed,
                        b.speed,
                        a.apart(&b),
                        a.at,
                        m.acceleration
                    ));
                }
            }
        }
        distance *= 2;
    }
    Ok(())
}

fn check_corner(before: &Move, after: &Move, hz: f64, limits: &Limits) -> Result<(), String> {
    let (Some(Some(a)), Some(Some(b))) = (readings(before, hz).last().copied(), readings(after, hz).first().copied())
    else {
        return Ok(());
    };
    let time = a.apart(&b);
    let slack = before.slack + after.slack;
    let acceleration = before.acceleration.max(after.acceleration) * (1.0 + TOLERANCE + slack);
    let noise = DIGIT / before.length.min(after.length);
    let turned = 2.0 * NOISE * (1.0 / before.length + 1.0 / after.length);
    let straight = (0..AXES).all(|i| (after.unit[i] - before.unit[i]).abs() <= noise.max(1e-4));
    if straight {
        let allowed = acceleration * time + a.rounding + b.rounding + (noise + slack) * a.speed.max(b.speed);
        if (b.speed - a.speed).abs() > allowed {
            return Err(format!("straight on, but from {} to {} mm/s in {time} s", a.speed, b.speed));
        }
        return Ok(());
    }
    let junction = limits.junction(before.unit, after.unit, turned) * (1.0 + TOLERANCE + slack);
    for reading in [a, b] {
        if reading.speed > junction + acceleration * time + reading.rounding {
            return Err(format!("{} mm/s, {time} s round a corner for {junction} mm/s", reading.speed));
        }
    }
    Ok(())
}

/// Returns the maximum speed², (mm/s)², at a bend that is given by three points. It is a·R on the circle through them,
/// plus what the junction deviation allows. The part of the turn that noise can explain is subtracted first. Returns
/// infinity if nothing of the turn is left, or if the turn is at least `greatest_turn`.
fn bend(points: [[f64; AXES]; 3], greatest_turn: f64, limits: &Limits) -> f64 {
    let [a, b, c] = points;
    let first: [f64; AXES] = std::array::from_fn(|i| b[i] - a[i]);
    let second: [f64; AXES] = std::array::from_fn(|i| c[i] - b[i]);
    let (l1, l2) = (norm(first), norm(second));
    let turn: [f64; AXES] = std::array::from_fn(|i| second[i] / l2 - first[i] / l1);
    let noise = 2.0 * NOISE * (1.0 / l1 + 1.0 / l2);
    let sure = norm(turn) - noise;
    if !(sure > 0.0 && norm(turn) < greatest_turn) {
        return f64::INFINITY;
    }
    let junction = limits.junction(first.map(|x| x / l1), second.map(|x| x / l2), noise);
    limits.along(limits.acceleration, turn.map(|t| t / norm(turn))) * (l1 + l2) / 2.0 / sure + junction * junction
}

/// Checks the speeds just before and just after a corner. They must not exceed the maximum for the bend that the corner
/// and the moves around it form.
fn check_bend(moves: &[Move], corner: usize, hz: f64, limits: &Limits) -> Result<(), String> {
    let (before, after) = (&moves[corner - 1], &moves[corner]);
    let readings = [readings(before, hz).last().copied(), readings(after, hz).first().copied()];
    let here = after.from;
    let mut allowed2 = bend([before.from, here, after.to], SHARP, limits);
    for reach in REACHES {
        // Finds the first end of a move that is at least `reach` away from the corner, measured along the path. Returns
        // this end and its distance.
        let reached = |mut corners: Box<dyn Iterator<Item = usize> + '_>, far: fn(&Move) -> [f64; AXES]| {
            let mut path = 0.0;
            corners.find_map(|i| {
                path += moves[i].length;
                (path >= reach).then(|| (far(&moves[i]), path))
            })
        };
        let back = reached(Box::new((0..corner).rev()), |m| m.from);
        let ahead = reached(Box::new(corner..moves.len()), |m| m.to);
        let (Some((a, way_back)), Some((c, way_ahead))) = (back, ahead) else { break };
        let straight = |point: [f64; AXES], way: f64| {
            way < 1.5 * reach && norm(std::array::from_fn(|i| point[i] - here[i])) > STRAIGHTNESS * way
        };
        if straight(a, way_back) && straight(c, way_ahead) {
            let acceleration = before.acceleration.max(after.acceleration);
            allowed2 = allowed2.min(bend([a, here, c], GENTLE, limits) + acceleration * reach);
        }
    }
    let slack = TOLERANCE + before.slack + after.slack;
    for (reading, m) in readings.iter().flatten().flatten().zip([before, after]) {
        // The reading is a mean speed over its span. The corner lies at one end of the span. So the acceleration can
        // have changed the speed for half a span, and for one step more.
        let most = allowed2.sqrt() * (1.0 + slack) + m.acceleration * (reading.span / 2.0 + reading.step);
        if reading.speed > most + reading.rounding {
            return Err(format!("{} mm/s on a bend for {}", reading.speed, allowed2.sqrt()));
        }
    }
    Ok(())
}

/// Turn, rad, beyond which a corner is exempt from the jerk limit.
const CORNER: f64 = 0.05;
/// Uncertainty of a position on the path between two steps, in steps.
const UNCERTAIN: f64 = 0.5;

/// Compares the jerk along the path with the limits of the axes (mm/s³, infinite for none). Times at which a corner
/// of more than [`CORNER`] is passed are exempt.
///
/// The position on the path is read at four times, `h` seconds apart. Its third difference is the weighted mean jerk
/// times h³. A position between two steps is uncertain by half a step. The weights of the third difference, 1, 3, 3
/// and 1, add up to 8, so it is uncertain by 4 steps. The time h is so long that 4 steps are a quarter of the limit
/// times h³. Where directions change, the highest limit of the moves passed applies.
///
/// # Errors
/// The first excess.
pub fn check_jerk(trace: &[Pulse], hz: f64, lines: &[Line], limits: &Limits, jerk: [f64; AXES]) -> Result<(), String> {
    let moves = moves(trace, lines, limits)?;
    // For each dominant step: time (s), position on the path (mm), and index of the move. Outside these times the
    // machine is at rest.
    let mut places: Vec<(f64, f64, usize)> = Vec::new();
    let mut corners = Vec::new();
    let mut way = 0.0;
    for (index, m) in moves.iter().enumerate() {
        for (k, at) in m.times.iter().enumerate() {
            places.push((*at as f64 / hz, way + (k as f64 + 0.5) * m.pitch, index));
        }
        way += m.pitch * m.times.len() as f64;
        if let (Some(next), Some(last)) = (moves.get(index + 1), m.times.last()) {
            let turn: [f64; AXES] = std::array::from_fn(|a| next.unit[a] - m.unit[a]);
            if norm(turn) > CORNER {
                corners.push((*last as f64 / hz, next.times[0] as f64 / hz));
            }
        }
    }
    let (Some(first), Some(last)) = (places.first().copied(), places.last().copied()) else { return Ok(()) };
    let pitch = moves.iter().map(|m| m.pitch).fold(0.0, f64::max);
    let along: Vec<f64> = moves.iter().map(|m| limits.along(jerk, m.unit)).collect();
    let greatest = along.iter().copied().filter(|jerk| jerk.is_finite()).fold(0.0, f64::max);
    if greatest <= 0.0 {
        return Ok(());
    }
    let h = (16.0 * pitch / greatest).cbrt();
    let at = |time: f64| -> (f64, usize) {
        let next = places.partition_point(|p| p.0 <= time);
        match (next.checked_sub(1).and_then(|k| places.get(k)), places.get(next)) {
            (Some(a), Some(b)) => (a.1 + (b.1 - a.1) * (time - a.0) / (b.0 - a.0), a.2),
            (Some(a), None) => (a.1 + 0.5 * pitch, a.2),
            (None, _) => (first.1 - 0.5 * pitch, 0),
        }
    };
    let mut time = first.0 - 2.0 * h;
    while time < last.0 {
        let points = [0.0, 1.0, 2.0, 3.0].map(|k| at(time + k * h));
        let cornered = corners.iter().any(|c| c.1 > time && c.0 < time + 3.0 * h);
        if !cornered {
            let third = points[3].0 - 3.0 * points[2].0 + 3.0 * points[1].0 - points[0].0;
            let most = along[points[0].1..=points[3].1].iter().copied().fold(0.0, f64::max);
            let allowed = most * h.powi(3) * (1.0 + 3.0 * TOLERANCE) + 8.0 * UNCERTAIN * pitch;
            if third.abs() > allowed {
                let seen = third / h.powi(3);
                return Err(format!("{seen} mm/s³ at {time} s over {} s, {most} are allowed", 3.0 * h));
            }
        }
        time += h / 3.0;
    }
    Ok(())
}

/// Checks a start from rest, with an allowance of one step. `times`: seconds from the first step to each step. To
/// check a stop, the caller counts `times` back from the last step.
fn check_rest(m: &Move, times: impl Iterator<Item = f64>) -> Result<(), String> {
    let acceleration = m.acceleration * (1.0 + TOLERANCE);
    let first = (2.0 * acceleration * m.pitch).sqrt();
    for (steps, seconds) in times.enumerate() {
        let made = steps as f64 * m.pitch;
        if made > first * seconds + acceleration * seconds * seconds / 2.0 + m.pitch {
            return Err(format!("{made} mm within {seconds} s of rest"));
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::super::oracle;
    use super::*;

    const HZ: f64 = 1e8;

    fn limits() -> Limits {
        Limits {
            steps_per_mm: [800.0, 640.0, 1600.0],
            rate: [100.0, 100.0, 20.0],
            acceleration: [500.0, 400.0, 100.0],
            junction_deviation: 0.01,
        }
    }

    /// Returns the trace of a straight move that reaches each share of its path at `when(share)` seconds after `start`.
    fn trace(line: &Line, limits: &Limits, start: f64, when: impl Fn(f64) -> f64) -> Vec<Pulse> {
        let (from, to) = (limits.place(line.from), limits.place(line.to));
        let places = oracle::line(from, to);
        let count = places.len() as f64;
        let mut before = from;
        places
            .iter()
            .enumerate()
            .map(|(i, place)| {
                let at = start + when((i as f64 + 1.0) / count);
                let mut pulse = Pulse { at: (at * HZ).round() as u64, steps: 0, directions: 0 };
                for a in 0..AXES {
                    pulse.steps |= u8::from(place[a] != before[a]) << a;
                    pulse.directions |= u8::from(to[a] < from[a]) << a;
                }
                before = *place;
                pulse
            })
            .collect()
    }

    /// Returns the time at which a trapezoid from rest to rest has covered a share of `length`.
    fn trapezoid(length: f64, speed: f64, acceleration: f64) -> impl Fn(f64) -> f64 {
        let ramp = (speed * speed / 2.0 / acceleration).min(length / 2.0);
        let top = (2.0 * acceleration * ramp).sqrt();
        let total = 2.0 * top / acceleration + (length - 2.0 * ramp) / top;
        move |share| {
            let s = share * length;
            if s <= ramp {
                (2.0 * s / acceleration).sqrt()
            } else if s <= length - ramp {
                top / acceleration + (s - ramp) / top
            } else {
                total - (2.0 * (length - s).max(0.0) / acceleration).sqrt()
            }
        }
    }

    const STRAIGHT: Line = Line { from: [0.0; 3], to: [30.0, 12.0, 0.0], feed: Some(50.0) };
    const LENGTH: f64 = 32.310_988_842_807_02;

    #[test]
    fn an_ideal_move_passes_and_faster_ones_do_not() {
        let limits = limits();
        // X limits the acceleration along the path: 500 / (30 / length).
        let a = 500.0 * LENGTH / 30.0;
        let run = |speed, acceleration| {
            let t = trace(&STRAIGHT, &limits, 1.0, trapezoid(LENGTH, speed, acceleration));
            check(&t, HZ, &[STRAIGHT], &limits)
        };
        run(50.0, a).unwrap();
        run(10.0, a / 3.0).unwrap();
        assert!(run(51.0, a).unwrap_err().contains("are allowed"));
        assert!(run(50.0, a * 1.03).unwrap_err().contains("mm/s²"));
    }

    /// Thirty lines of 14 um that the machine can join to one move. The check accepts this move, and rejects it if it
    /// is too fast. The machine can also have driven a few lines in the middle as a separate move, which rounding has
    /// made longer. The check accepts this, too.
    #[test]
    fn joined_lines_are_measured_over_several_steps() {
        let limits = Limits { steps_per_mm: [250.0; 3], acceleration: [9000.0; 3], ..limits() };
        let at = |k: usize| [0.014 * k as f64, 0.0, 0.0];
        let lines: Vec<Line> = (0..30).map(|k| Line { from: at(k), to: at(k + 1), feed: Some(40.0) }).collect();
        let whole = Line { to: at(30), ..lines[0] };
        let run = |speed| {
            let t = trace(&whole, &limits, 0.0, trapezoid(0.42, speed, 9000.0));
            check(&t, HZ, &lines, &limits)
        };
        run(40.0).unwrap();
        assert!(run(43.0).unwrap_err().contains("are allowed"));
        // In the middle of the move, at constant speed, make four steps in the time of three and a half.
        let even = trapezoid(0.42, 40.0, 9000.0);
        let (first, last) = (50.0 / 105.0, 54.0 / 105.0);
        let rounded = |share: f64| {
            let within = ((share - first) / (last - first)).clamp(0.0, 1.0);
            even(share) - if share < last + 1e-9 { within * 0.5 * 0.004 / 40.0 } else { 0.5 * 0.004 / 40.0 }
        };
        check(&trace(&whole, &limits, 0.0, rounded), HZ, &lines, &limits).unwrap();
    }

    #[test]
    fn a_jump_of_speed_is_seen() {
        let limits = limits();
        let smooth = trapezoid(LENGTH, 50.0, 400.0);
        // From half of the path on, all steps come 9 us later. So one interval of 22 us becomes too long.
        let t = trace(&STRAIGHT, &limits, 0.0, |s| smooth(s) + if s > 0.5 { 9e-6 } else { 0.0 });
        assert!(check(&t, HZ, &[STRAIGHT], &limits).is_err());
        // Full speed from the first step on.
        let t = trace(&STRAIGHT, &limits, 0.0, |s| s * LENGTH / 50.0);
        assert!(check(&t, HZ, &[STRAIGHT], &limits).unwrap_err().contains("of rest"));
    }

    #[test]
    fn slow_feeds_are_measured_over_the_move() {
        let limits = Limits { steps_per_mm: [100.0, 80.0, 160.0], ..limits() };
        let slow = Line { feed: Some(1.0), ..STRAIGHT };
        let t = trace(&slow, &limits, 0.0, trapezoid(LENGTH, 1.0, 100.0));
        check(&t, HZ, &[slow], &limits).unwrap();
        let t = trace(&slow, &limits, 0.0, trapezoid(LENGTH, 1.05, 100.0));
        assert!(check(&t, HZ, &[slow], &limits).is_err());
    }

    #[test]
    fn a_corner_has_its_own_limit() {
        let limits = limits();
        let first = Line { from: [0.0; 3], to: [20.0, 0.0, 0.0], feed: Some(50.0) };
        let second = Line { from: [20.0, 0.0, 0.0], to: [20.0, 20.0, 0.0], feed: Some(50.0) };
        // Passes the corner at `corner` mm/s: a ramp up, a ramp down to that speed, then the mirror image.
        let run = |corner: f64| {
            let a = 400.0;
            let down_length = corner * corner / 2.0 / a;
            let down = trapezoid(20.0 + down_length, 50.0, a);
            let entry = down(1.0) - corner / a;
            let mut t = trace(&first, &limits, 0.0, |s| down(s * 20.0 / (20.0 + down_length)));
            let second_start = entry - corner / a;
            t.extend(trace(&second, &limits, second_start, |s| down((s * 20.0 + down_length) / (20.0 + down_length))));
            check(&t, HZ, &[first, second], &limits)
        };
        let allowed = limits.junction([1.0, 0.0, 0.0], [0.0, 1.0, 0.0], 0.0);
        assert!((allowed - 3.6).abs() < 0.5, "{allowed}");
        run(allowed).unwrap();
        assert!(run(allowed * 4.0).unwrap_err().contains("corner"));
    }

    #[test]
    fn extra_and_missing_pulses_are_seen() {
        let limits = limits();
        let mut t = trace(&STRAIGHT, &limits, 0.0, trapezoid(LENGTH, 50.0, 400.0));
        let last = t[t.len() - 1];
        t.push(Pulse { at: last.at + 5000, ..last });
        assert!(check(&t, HZ, &[STRAIGHT], &limits).unwrap_err().contains("after the end"));
        t.truncate(t.len() - 2);
        assert!(check(&t, HZ, &[STRAIGHT], &limits).unwrap_err().contains("ends at"));
    }
}
