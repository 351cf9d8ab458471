//! What Oxmill's interpreter makes of a line.

use super::{AXES, Event, NO_MOVE, TOLERANCE};
use oxmill_controller::axes::PerAxis;
use oxmill_controller::error::Error;
use oxmill_controller::gcode::{
    Angle, Checked, CoordinateSystem, CycleStep, Dialect, Direction, Feed, Flow, Held, HeldLine, Interpreter, Motion,
    MotionMode, ProgramPins, SplineKind,
};
use oxmill_controller::units::Coordinate;

/// The clearance of a new controller, 0.01 inch.
const CLEARANCE: Coordinate = Coordinate(2_540_000);

/// A machine that is only thought.
#[derive(Clone)]
pub struct Mill {
    interpreter: Interpreter<AXES>,
    /// Where the last event has led, machine coordinates.
    place: [f64; AXES],
    /// No event has told where the last one ended.
    is_place_untold: bool,
    /// Of the last line: a move is so short that rounding decides whether it is one.
    is_doubtful: bool,
}

fn mm(place: &PerAxis<Coordinate, AXES>) -> [f64; AXES] {
    place.0.map(|coordinate| coordinate.0 as f64 / 1e7)
}

impl Mill {
    pub fn new() -> Mill {
        Mill { interpreter: Interpreter::new(), place: [0.0; AXES], is_place_untold: false, is_doubtful: false }
    }

    /// Whether a move of the last line is one or none by rounding.
    pub fn is_doubtful(&self) -> bool {
        self.is_doubtful
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

    /// What holds the program's subroutines and loops.
    pub fn interpreter(&mut self) -> &mut Interpreter<AXES> {
        &mut self.interpreter
    }

    /// Carries a line out, which has no blanks within words; of a call the lines that it calls.
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

    /// The same; and how the program goes on.
    pub fn carry_out(&mut self, line: &str) -> Result<(Vec<Event>, Flow), Error> {
        let text = line.replace(' ', "");
        let mut checked = Checked::NOTHING;
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
        let dwell = checked.dwell.map(|time| Event::Dwell(time.to_micros() as f64 / 1e6));
        let mut events: Vec<Event> = output.into_iter().chain(dwell).collect();
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
                self.is_place_untold = false;
            }
            Motion::Spline(spline) => {
                let is_cubic = matches!(checked.modal().motion, MotionMode::Spline(SplineKind::Cubic));
                events.push(Event::Spline(if is_cubic { 4 } else { 3 }));
                // `rs274` does not print where it ends: the next move tells.
                self.place = mm(&spline.target);
                self.is_place_untold = true;
            }
            Motion::Nurbs(nurbs) => {
                events.push(Event::Spline(self.interpreter.control_points().len() as u8));
                self.place = mm(&nurbs.target);
                self.is_place_untold = true;
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
        Ok((events, checked.flow))
    }

    fn relative(&self, place: &PerAxis<Coordinate, AXES>) -> [f64; AXES] {
        mm(&self.interpreter.to_program(place))
    }

    fn go(&mut self, to: &PerAxis<Coordinate, AXES>, rapid: bool, events: &mut Vec<Event>) {
        let machine = mm(to);
        let way = machine.iter().zip(self.place).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
        let is_move = way > NO_MOVE;
        self.is_doubtful |= (way - NO_MOVE).abs() < TOLERANCE;
        if is_move || std::mem::take(&mut self.is_place_untold) {
            let work = self.relative(to);
            events.push(if rapid { Event::Rapid(work) } else { Event::Feed(work) });
        }
        self.place = machine;
        self.is_place_untold = false;
    }
}
