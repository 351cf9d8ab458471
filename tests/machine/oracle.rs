//! Computes the expected step outputs independently of the controller: lines by Bresenham's error term in integers,
//! arcs by the exact circle.

/// Number of axes of the machines in these tests.
pub const AXES: usize = 3;

/// A position in motor steps.
pub type Place = [i64; AXES];

/// One step event of a trace: the step outputs that rose together.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Pulse {
    /// Time in ticks of the step clock.
    pub at: u64,
    /// Axes that stepped, bit 0 for X.
    pub steps: u8,
    /// Axes that move in negative direction, bit 0 for X.
    pub directions: u8,
}

impl Pulse {
    /// Returns the position after this event. `place`: the position before it.
    pub fn moved(&self, mut place: Place) -> Place {
        for (axis, value) in place.iter_mut().enumerate() {
            if self.steps >> axis & 1 == 1 {
                *value += if self.directions >> axis & 1 == 1 { -1 } else { 1 };
            }
        }
        place
    }
}

/// Returns the axis with the most steps (the first if equal), and its number of steps.
pub fn dominant(from: Place, to: Place) -> (usize, u64) {
    let mut best = (0, 0);
    for axis in 0..AXES {
        let steps = to[axis].abs_diff(from[axis]);
        if steps > best.1 {
            best = (axis, steps);
        }
    }
    best
}

/// Returns the positions of a straight move after each step of its dominant axis.
///
/// Each axis follows Bresenham's algorithm: it has an error term, in which 2 × the dominant steps stand for one step.
/// With each dominant step the error grows by 2 × the steps of the axis. When the error is above zero, the axis
/// steps, and the error falls by 2 × the dominant steps. The error starts at minus half a step, so an axis steps half
/// way between two positions. At exactly half a step it waits for the next dominant step.
pub fn line(from: Place, to: Place) -> Vec<Place> {
    let (_, count) = dominant(from, to);
    let count = count as i64;
    let mut place = from;
    let mut error = [-count; AXES];
    let mut places = Vec::new();
    for _ in 0..count {
        for axis in 0..AXES {
            error[axis] += 2 * (to[axis] - from[axis]).abs();
            if error[axis] > 0 {
                error[axis] -= 2 * count;
                place[axis] += (to[axis] - from[axis]).signum();
            }
        }
        places.push(place);
    }
    places
}

/// Number of grid positions per step of the dominant axis. At low step rates the step generator smooths motion: it
/// steps the axes at these positions. So a slow axis can step between two dominant steps.
pub const FINE: i64 = 16;

/// Takes the pulses of one straight move off a trace and compares them with Bresenham's positions on a grid. The grid
/// is [`FINE`] times as fine as the dominant steps, because a slow axis can step between the steps of the dominant
/// one. After each event the machine must be at one of these positions, beyond the previous one. The last event must
/// reach the end. So each axis is always within half a step of the straight line. Returns the times of the dominant
/// steps.
///
/// # Errors
/// The first difference.
pub fn follow_line(trace: &mut &[Pulse], from: Place, to: Place) -> Result<Vec<u64>, String> {
    let (axis, count) = dominant(from, to);
    let threshold = count as i64 * FINE;
    let mut expected = from;
    let mut error = [-threshold; AXES];
    let mut place = from;
    let mut times = Vec::new();
    let mut grid = 0..threshold;
    while place != to {
        let Some((pulse, rest)) = trace.split_first() else {
            return Err(format!("the trace ends at {place:?}, on the way from {from:?} to {to:?}"));
        };
        *trace = rest;
        if pulse.steps == 0 {
            return Err(format!("an event without a step at {place:?}"));
        }
        place = pulse.moved(place);
        if pulse.steps >> axis & 1 == 1 {
            times.push(pulse.at);
        }
        while place != expected {
            if grid.next().is_none() {
                return Err(format!("{place:?} is not on the way from {from:?} to {to:?}"));
            }
            for a in 0..AXES {
                error[a] += 2 * (to[a] - from[a]).abs();
                if error[a] > 0 {
                    error[a] -= 2 * threshold;
                    expected[a] += (to[a] - from[a]).signum();
                }
            }
        }
    }
    Ok(times)
}

/// An arc in the plane of the first two of `axes`, while the third moves evenly.
#[derive(Clone, Debug)]
pub struct Circle {
    /// Indexes of three axes. The first two span the plane: the angle grows from the first towards the second. The
    /// third is perpendicular to the plane.
    pub axes: [usize; 3],
    /// Centre in the plane, mm.
    pub centre: [f64; 2],
    /// Start, all axes, mm.
    pub from: [f64; AXES],
    /// End, all axes, mm.
    pub to: [f64; AXES],
    /// `true` if the angle decreases during the arc.
    pub clockwise: bool,
}

impl Circle {
    fn seen(&self, place: [f64; AXES]) -> (f64, f64) {
        let u = place[self.axes[0]] - self.centre[0];
        let v = place[self.axes[1]] - self.centre[1];
        (u.hypot(v), v.atan2(u))
    }

    /// Returns the angle of a position, rad, from the start in the direction of travel: 0 to 2π.
    fn progress(&self, place: [f64; AXES]) -> f64 {
        let turn = std::f64::consts::TAU;
        let difference = self.seen(place).1 - self.seen(self.from).1;
        (if self.clockwise { -difference } else { difference }).rem_euclid(turn)
    }

    /// Returns the angle of the whole arc, rad; a full turn if start and end coincide.
    pub fn angle(&self) -> f64 {
        let angle = self.progress(self.to);
        let turn = std::f64::consts::TAU;
        if (1e-6..=turn - 1e-6).contains(&angle) { angle } else { turn }
    }

    /// Compares the positions of a trace (mm) with the arc.
    ///
    /// `radial`: maximum distance from the circle, mm. `lag`: maximum distance from the expected position, along the
    /// circle or along the third axis, mm. A usual `lag` is one or two steps, because the machine moves in whole steps.
    ///
    /// # Errors
    /// The first difference.
    pub fn follows(&self, places: &[[f64; AXES]], radial: f64, lag: f64) -> Result<(), String> {
        let whole = self.angle();
        let (start_radius, end_radius) = (self.seen(self.from).0, self.seen(self.to).0);
        let slack = lag / start_radius.min(end_radius);
        let mut farthest = 0.0_f64;
        for &place in places {
            let mut angle = self.progress(place);
            // A position just before the start has nearly a full turn as its angle, so subtract a turn. A position just
            // past the end of a full turn has nearly 0, so add a turn.
            if angle > whole + slack && angle > std::f64::consts::TAU - slack {
                angle -= std::f64::consts::TAU;
            } else if angle < slack && farthest > std::f64::consts::TAU - 2.0 * slack {
                angle += std::f64::consts::TAU;
            }
            if angle > whole + slack {
                return Err(format!("{place:?} lies beyond the end of the arc: {angle} of {whole} rad"));
            }
            if angle < farthest - 2.0 * slack {
                return Err(format!("{place:?} goes back: {angle} after {farthest} rad"));
            }
            farthest = farthest.max(angle);
            let share = (angle / whole).clamp(0.0, 1.0);
            let radius = start_radius + (end_radius - start_radius) * share;
            let off = self.seen(place).0 - radius;
            if off.abs() > radial {
                return Err(format!("{place:?} lies {off} mm off the circle, {radial} allowed"));
            }
            let across = self.axes[2];
            let even = self.from[across] + (self.to[across] - self.from[across]) * share;
            let slope = (self.to[across] - self.from[across]).abs() / (whole * start_radius);
            if (place[across] - even).abs() > lag * (1.0 + slope) {
                return Err(format!("{place:?}: the third axis should be at {even}"));
            }
        }
        if farthest < whole - slack {
            return Err(format!("only {farthest} of {whole} rad"));
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn pulses(places: &[Place], from: Place) -> Vec<Pulse> {
        let mut before = from;
        places
            .iter()
            .enumerate()
            .map(|(i, &place)| {
                let mut pulse = Pulse { at: i as u64 * 100, steps: 0, directions: 0 };
                for axis in 0..AXES {
                    pulse.steps |= u8::from(place[axis] != before[axis]) << axis;
                    pulse.directions |= u8::from(place[axis] < before[axis]) << axis;
                }
                before = place;
                pulse
            })
            .collect()
    }

    #[test]
    fn ten_by_three_steps_its_minor_axis_at_2_6_and_9() {
        let places = line([0, 0, 0], [10, 3, 0]);
        let steps: Vec<usize> =
            (0..10).filter(|&i| places[i][1] != if i == 0 { 0 } else { places[i - 1][1] }).map(|i| i + 1).collect();
        assert_eq!(steps, [2, 6, 9]);
        assert_eq!(places[9], [10, 3, 0]);
    }

    #[test]
    fn a_line_stays_within_half_a_step_and_ends_where_it_should() {
        for to in [[7, -3, 2], [-1, 0, 0], [5, 5, -5], [1, 12, 11], [0, 0, 0]] {
            let (axis, count) = dominant([0, 0, 0], to);
            let places = line([0, 0, 0], to);
            assert_eq!(places.len() as u64, count);
            for (i, place) in places.iter().enumerate() {
                for a in 0..AXES {
                    // Each axis is within half a step of its exact position, to × (i + 1) / count. Both sides are
                    // multiplied by 2 × count, so that all numbers are whole.
                    assert!((2 * (place[a] * count as i64 - to[a] * (i as i64 + 1))).abs() <= count as i64);
                }
                assert_eq!(place[axis].unsigned_abs(), i as u64 + 1);
            }
            assert_eq!(places.last().copied().unwrap_or([0, 0, 0]), to);
        }
    }

    #[test]
    fn following_a_line_accepts_it_smoothed_and_refuses_changes() {
        let (from, to) = ([3, 3, 3], [13, 0, 5]);
        let places = line(from, to);
        let good = pulses(&places, from);
        assert_eq!(follow_line(&mut &good[..], from, to).unwrap().len(), 10);

        // The same line with smoothed steps: each axis steps at the first position of the fine grid after it is half
        // way to its next step. X makes ten steps, so it steps at the grid positions 9, 25, 41 and so on.
        let fine = |tick: i64, steps: i64| (2 * tick * steps + 10 * FINE - 1) / (2 * 10 * FINE);
        let mut before = from;
        let mut smoothed = Vec::new();
        for tick in 1..=10 * FINE {
            let place = [from[0] + fine(tick, 10), from[1] - fine(tick, 3), from[2] + fine(tick, 2)];
            if place != before {
                smoothed.extend(pulses(&[place], before).iter().map(|p| Pulse { at: tick as u64, ..*p }));
                before = place;
            }
        }
        assert!(smoothed.len() > good.len());
        assert_eq!(follow_line(&mut &smoothed[..], from, to).unwrap(), Vec::from_iter((0..10).map(|i| 16 * i + 9)));

        let mut late = good.clone();
        let both = late.iter().position(|p| p.steps & 2 != 0).unwrap();
        late[both].steps &= !2;
        late[both + 1].steps |= 2;
        assert!(follow_line(&mut &late[..], from, to).is_err());
        let mut wrong_way = good.clone();
        wrong_way[4].directions ^= 1;
        assert!(follow_line(&mut &wrong_way[..], from, to).is_err());
        assert!(follow_line(&mut &good[..9], from, to).is_err());
    }

    fn quarter() -> (Circle, Vec<[f64; AXES]>) {
        let circle = Circle {
            axes: [0, 1, 2],
            centre: [0.0, 0.0],
            from: [10.0, 0.0, 0.0],
            to: [0.0, 10.0, 1.0],
            clockwise: false,
        };
        let places = (0..=1000)
            .map(|i| {
                let share = f64::from(i) / 1000.0;
                let angle = share * std::f64::consts::FRAC_PI_2;
                [10.0 * angle.cos(), 10.0 * angle.sin(), share]
            })
            .collect();
        (circle, places)
    }

    #[test]
    fn a_circle_accepts_itself_and_refuses_changes() {
        let (circle, places) = quarter();
        circle.follows(&places, 1e-6, 0.02).unwrap();
        let bulge: Vec<_> = places.iter().map(|p| [p[0] * 1.001, p[1] * 1.001, p[2]]).collect();
        assert!(circle.follows(&bulge, 0.005, 0.02).is_err());
        let flat: Vec<_> = places.iter().map(|p| [p[0], p[1], 0.0]).collect();
        assert!(circle.follows(&flat, 1e-6, 0.02).is_err());
        assert!(circle.follows(&places[..900], 1e-6, 0.02).is_err());
        let mut back = places.clone();
        back.extend(places[500..].iter().rev());
        assert!(circle.follows(&back, 1e-6, 0.02).is_err());
        let other_way = Circle { clockwise: true, ..circle };
        assert!(other_way.follows(&places, 1e-6, 0.02).is_err());
    }

    #[test]
    fn a_full_circle_needs_its_whole_turn() {
        let circle = Circle { from: [10.0, 0.0, 0.0], to: [10.0, 0.0, 0.0], ..quarter().0 };
        let turn: Vec<[f64; AXES]> = (0..=1000)
            .map(|i| {
                let angle = f64::from(i) / 1000.0 * std::f64::consts::TAU;
                [10.0 * angle.cos(), 10.0 * angle.sin(), 0.0]
            })
            .collect();
        circle.follows(&turn, 1e-6, 0.05).unwrap();
        assert!(circle.follows(&turn[..980], 1e-6, 0.05).is_err());
        assert!(circle.follows(&[], 1e-6, 0.05).is_err());
    }
}
