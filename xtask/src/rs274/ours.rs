//! What Oxmill's interpreter makes of a line.

use super::{AXES, Event, NO_MOVE};
use oxmill_controller::axes::PerAxis;
use oxmill_controller::error::Error;
use oxmill_controller::gcode::{Angle, CoordinateSystem, CycleStep, Dialect, Feed, Interpreter, Motion};
use oxmill_controller::units::Coordinate;

/// The clearance of a new controller, 0.01 inch.
const CLEARANCE: Coordinate = Coordinate(2_540_000);

/// A machine that is only thought.
#[derive(Clone)]
pub struct Mill {
    interpreter: Interpreter<AXES>,
    /// Where the last event has led, machine coordinates.
    place: [f64; AXES],
}

fn mm(place: &PerAxis<Coordinate, AXES>) -> [f64; AXES] {
    place.0.map(|coordinate| coordinate.0 as f64 / 1e7)
}

impl Mill {
    pub fn new() -> Mill {
        Mill { interpreter: Interpreter::new(), place: [0.0; AXES] }
    }

    /// Where the program is, in the active system, mm.
    pub fn work(&self) -> [f64; AXES] {
        mm(&self.interpreter.to_program(self.interpreter.position()))
    }

    /// Whether G92 or G52 shifts the coordinates.
    pub fn has_g92(&self) -> bool {
        self.interpreter.offsets().g92 != PerAxis::default()
    }

    /// Whether it does, and some system is rotated.
    pub fn is_rotated_under_g92(&self) -> bool {
        let offsets = self.interpreter.offsets();
        self.has_g92() && CoordinateSystem::ALL.into_iter().any(|system| offsets.angle(system) != Angle::ZERO)
    }

    /// Carries a line out, which has no blanks within words.
    pub fn run(&mut self, line: &str) -> Result<Vec<Event>, Error> {
        let text = line.replace(' ', "");
        let checked = self.interpreter.check(text.as_bytes(), Dialect::Oxmill)?;
        self.interpreter.commit(&checked);
        let mut events: Vec<Event> =
            checked.dwell.map(|time| Event::Dwell(time.to_micros() as f64 / 1e6)).into_iter().collect();
        match checked.motion {
            Motion::None => {}
            Motion::Line { via, target, feed } => {
                if let Some(via) = via {
                    self.go(&via, true, &mut events);
                }
                self.go(&target, feed == Feed::Rapid, &mut events);
            }
            Motion::Probe { target, .. } => self.go(&target, false, &mut events),
            Motion::Arc(arc) => {
                let mut centre = arc.start;
                for (axis, way) in [(arc.axes.first, arc.i), (arc.axes.second, arc.j)] {
                    centre.0[axis.index()] = centre.0[axis.index()] + way;
                }
                let (centre, end) = (self.relative(&centre), self.relative(&arc.target));
                let centre = [centre[arc.axes.first.index()], centre[arc.axes.second.index()]];
                let turns = i64::from(arc.turns) + 1;
                events.push(Event::Arc(end, centre, if arc.clockwise { -turns } else { turns }));
                self.place = mm(&arc.target);
            }
            Motion::Cycle(mut cycle) => {
                while let Some(step) = cycle.step(CLEARANCE) {
                    match step {
                        CycleStep::Rapid(place) => self.go(&place, true, &mut events),
                        CycleStep::Feed(place, _) => self.go(&place, false, &mut events),
                        CycleStep::Dwell(time) => events.push(Event::Dwell(time.to_micros() as f64 / 1e6)),
                        CycleStep::SpindleOff | CycleStep::SpindleOn(_) | CycleStep::Pause => {}
                    }
                }
            }
        }
        Ok(events)
    }

    fn relative(&self, place: &PerAxis<Coordinate, AXES>) -> [f64; AXES] {
        mm(&self.interpreter.to_program(place))
    }

    fn go(&mut self, to: &PerAxis<Coordinate, AXES>, rapid: bool, events: &mut Vec<Event>) {
        let machine = mm(to);
        if machine.iter().zip(self.place).any(|(a, b)| (a - b).abs() > NO_MOVE) {
            let work = self.relative(to);
            events.push(if rapid { Event::Rapid(work) } else { Event::Feed(work) });
        }
        self.place = machine;
    }
}
