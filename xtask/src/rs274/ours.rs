//! Runs lines through Oxmill's interpreter and returns their events: moves, arcs, dwells and outputs.

use super::{AXES, Event, NO_MOVE, TOLERANCE};
use oxmill_controller::axes::PerAxis;
use oxmill_controller::error::Error;
use oxmill_controller::gcode::{
    Action, Angle, CoordinateSystem, CycleStep, Dialect, Direction, Feed, Flow, Held, HeldLine, Interpreter,
    MotionCommand, MotionMode, ProgramPins, SplineKind, Units,
};
use oxmill_controller::units::Coordinate;
use std::f64::consts::TAU;

/// The clearance of peck cycles in a new controller, 0.01 inch.
const CLEARANCE: Coordinate = Coordinate(2_540_000);

/// An interpreter with a simulated position, without a machine.
#[derive(Clone)]
pub struct Mill {
    interpreter: Interpreter<AXES>,
    /// End position of the most recent event, machine coordinates.
    place: [f64; AXES],
    /// `true` after a spline: the event of a spline does not contain its end, which is `place`.
    is_place_unknown: bool,
    /// `true`: a move of the most recent line is so short that rounding decides whether it is a move at all.
    is_doubtful: bool,
}

fn mm(place: &PerAxis<Coordinate, AXES>) -> [f64; AXES] {
    place.0.map(|coordinate| coordinate.0 as f64 / 1e7)
}

fn distance(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| (a - b).powi(2)).sum::<f64>().sqrt()
}

impl Mill {
    pub fn new() -> Mill {
        Mill { interpreter: Interpreter::default(), place: [0.0; AXES], is_place_unknown: false, is_doubtful: false }
    }

    /// Returns `true` if a move of the most recent line is so short that rounding decides if it is a move at all.
    pub fn is_doubtful(&self) -> bool {
        self.is_doubtful
    }

    /// Returns the program's position in the active coordinate system, mm.
    pub fn work(&self) -> [f64; AXES] {
        mm(&self.interpreter.to_program(self.interpreter.position()))
    }

    /// Returns `true` if an offset of G92 or G52 is active.
    pub fn has_g92(&self) -> bool {
        self.interpreter.offsets().g92 != PerAxis::default()
    }

    /// Returns `true` if an offset of G92 or G52 is active while any coordinate system is rotated.
    pub fn is_rotated_under_g92(&self) -> bool {
        let offsets = self.interpreter.offsets();
        self.has_g92() && CoordinateSystem::ALL.into_iter().any(|system| offsets.angle(system) != Angle::ZERO)
    }

    /// Returns the interpreter, which holds the program's subroutines and loops.
    pub fn interpreter(&mut self) -> &mut Interpreter<AXES> {
        &mut self.interpreter
    }

    /// Carries out a line. If the line is a call or the end of a loop, also carries out the stored lines that it
    /// starts. Ignores blanks.
    pub fn run(&mut self, line: &str) -> Result<Vec<Event>, Error> {
        self.is_doubtful = false;
        match self.interpreter.direct(line.replace(' ', "").to_uppercase().as_bytes(), &[], 0)? {
            Direction::Check => self.carry_out(line).map(|(events, _)| events),
            Direction::Done | Direction::LeftOut => Ok(Vec::new()),
            Direction::Run | Direction::Call => {
                let mut events = Vec::new();
                let mut held = HeldLine::new();
                loop {
                    match self.interpreter.next_held(&mut held)? {
                        Held::Line => events.extend(self.carry_out(&String::from_utf8_lossy(&held))?.0),
                        Held::Again => {}
                        Held::End => return Ok(events),
                    }
                }
            }
        }
    }

    /// Carries out a line; also returns how the program continues.
    pub fn carry_out(&mut self, line: &str) -> Result<(Vec<Event>, Flow), Error> {
        let text = line.replace(' ', "");
        let mut checked = Action::NOTHING;
        self.interpreter.check_into(text.as_bytes(), Dialect::Oxmill, &mut checked)?;
        self.interpreter.commit(&checked);
        let output = match checked.pins() {
            Some(ProgramPins::Digital { number, on, with_motion }) => {
                Some(Event::Output(false, i64::from(number), f64::from(u8::from(on)), with_motion))
            }
            Some(ProgramPins::Analog { number, value, with_motion }) => {
                Some(Event::Output(true, i64::from(number), f64::from(value.to_f32()), with_motion))
            }
            _ => None,
        };
        let rate = self.inverse_time_rate(&checked.motion);
        let dwell = checked.dwell.map(|time| Event::Dwell(time.to_micros() as f64 / 1e6));
        let mut events: Vec<Event> = output.into_iter().chain(dwell).collect();
        match checked.motion {
            MotionCommand::None => {}
            MotionCommand::Line { via, target, feed } => {
                if let Some(via) = via {
                    self.go(&via, true, &mut events);
                }
                self.go(&target, feed == Feed::Rapid, &mut events);
            }
            MotionCommand::Probe { target, .. } => self.go(&target, false, &mut events),
            MotionCommand::Arc(arc) => {
                let mut centre = arc.start;
                for (axis, way) in [(arc.axes.first, arc.i), (arc.axes.second, arc.j)] {
                    centre.0[axis.index()] = centre.0[axis.index()] + way;
                }
                let (centre, end) = (self.relative(&centre), self.relative(&arc.target));
                let centre = [centre[arc.axes.first.index()], centre[arc.axes.second.index()]];
                let turns = i64::from(arc.turns) + 1;
                events.push(Event::Arc(end, centre, if arc.clockwise { -turns } else { turns }));
                self.place = mm(&arc.target);
                self.is_place_unknown = false;
            }
            MotionCommand::Spline(spline) => {
                let is_cubic = matches!(checked.modal().motion, MotionMode::Spline(SplineKind::Cubic));
                events.push(Event::Spline(if is_cubic { 4 } else { 3 }));
                // `rs274` does not print where the spline ends; the move after the spline shows it.
                self.place = mm(&spline.target);
                self.is_place_unknown = true;
            }
            MotionCommand::Nurbs(nurbs) => {
                events.push(Event::Spline(self.interpreter.control_points().len() as u8));
                self.place = mm(&nurbs.target);
                self.is_place_unknown = true;
            }
            MotionCommand::Cycle(mut cycle) => {
                let mut is_first = true;
                while let Some(step) = cycle.step(CLEARANCE) {
                    match step {
                        // A cycle starts with a rise to R. If the tool is already at R, the rise has no event, because
                        // `rs274` does not output it. If a spline came before, the next move shows where the spline
                        // ended.
                        CycleStep::Rapid(place) if std::mem::take(&mut is_first) && mm(&place) == self.place => {}
                        CycleStep::Rapid(place) => self.go(&place, true, &mut events),
                        CycleStep::Feed(place, _) => self.go(&place, false, &mut events),
                        CycleStep::Dwell(time) => events.push(Event::Dwell(time.to_micros() as f64 / 1e6)),
                        CycleStep::SpindleOff | CycleStep::SpindleOn(_) | CycleStep::Pause => {}
                    }
                }
            }
        }
        if matches!(events.last(), Some(Event::Feed(_) | Event::Arc(..))) {
            events.extend(rate.map(Event::Rate));
        }
        Ok((events, checked.flow))
    }

    /// Returns the feed rate, mm/min, that G93 derives from the length and time of a motion.
    fn inverse_time_rate(&self, motion: &MotionCommand<AXES>) -> Option<f64> {
        let (length, feed) = match motion {
            MotionCommand::Line { target, feed, .. } => {
                let ([x, y, z, a], [from_x, from_y, from_z, from_a]) = (mm(target), self.place);
                let way = distance(&[x, y, z], &[from_x, from_y, from_z]);
                // The rate of a move of A alone is in degrees per minute, in either unit of length. But `rs274` takes
                // this rate for a length per minute, so in inches it is multiplied by 25.4.
                let unit = if self.interpreter.modal().units == Units::Inch { 25.4 } else { 1.0 };
                (if way > 0.0 { way } else { (a - from_a).abs() * unit }, feed)
            }
            MotionCommand::Arc(arc) => {
                let [i, j] = [arc.i, arc.j].map(|way| way.0 as f64 / 1e7);
                let (start, end) = (mm(&arc.start), mm(&arc.target));
                let [a, b, c] = [arc.axes.first, arc.axes.second, arc.axes.linear]
                    .map(|axis| end[axis.index()] - start[axis.index()]);
                let (from, to) = (f64::atan2(-j, -i), f64::atan2(b - j, a - i));
                let turned = if arc.clockwise { from - to } else { to - from }.rem_euclid(TAU);
                let turned = if a.hypot(b) < NO_MOVE { TAU } else { turned };
                ((i.hypot(j) * (turned + f64::from(arc.turns) * TAU)).hypot(c), &arc.feed)
            }
            _ => return None,
        };
        match feed {
            Feed::InverseTime(seconds) => Some(length * 60.0 / f64::from(*seconds)),
            _ => None,
        }
    }

    fn relative(&self, place: &PerAxis<Coordinate, AXES>) -> [f64; AXES] {
        mm(&self.interpreter.to_program(place))
    }

    fn go(&mut self, to: &PerAxis<Coordinate, AXES>, rapid: bool, events: &mut Vec<Event>) {
        let machine = mm(to);
        let way = machine.iter().zip(self.place).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
        let is_move = way > NO_MOVE;
        self.is_doubtful |= (way - NO_MOVE).abs() < TOLERANCE;
        if is_move || std::mem::take(&mut self.is_place_unknown) {
            let work = self.relative(to);
            events.push(if rapid { Event::Rapid(work) } else { Event::Feed(work) });
        }
        self.place = machine;
        self.is_place_unknown = false;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The output of `rs274` does not contain the end of a spline. If a spline ends at the height of R, a cycle there
    /// needs no rise to R, so there must be no event for a rise.
    #[test]
    fn a_cycle_behind_a_spline_has_no_rise_of_no_length() {
        for (spline, moves) in [("G5.1 X4 Y2 I1 J3", 1), ("G5 X4 Y2 I1 J1 P-1 Q1", 1), ("G1 X4 Y2", 1)] {
            let mut mill = Mill::new();
            let mut run = |line: &str| mill.run(line).unwrap_or_else(|error| panic!("{line}: {error:?}"));
            for line in ["G21 G90 G17 F300 S100 M3", "G0 Z5", "G91"] {
                run(line);
            }
            assert_eq!(run(spline).len(), moves);
            let way = |x: f64, z: f64| [x, 3.0, z, 0.0];
            let expected = [
                Event::Rapid(way(6.0, 5.0)),
                Event::Rapid(way(6.0, 4.0)),
                Event::Feed(way(6.0, 2.0)),
                Event::Dwell(0.5),
                Event::Rapid(way(6.0, 4.0)),
            ];
            let found = run("G99 G86 X2 Y1 Z-2 R-1 P0.5");
            assert!(found.len() == expected.len() && found.iter().zip(&expected).all(|(a, b)| a.is_as(b)), "{found:?}");
            // If the tool is not at R, the rise has an event. In G91, R counts from the height at which the series of
            // cycles started.
            let rises = run("G81 X1 Z-2 R3");
            assert!(rises[0].is_as(&Event::Rapid(way(6.0, 8.0))), "{rises:?}");
        }
    }
}
