//! State from which a replay of a recording can begin: a machine at rest with nothing switched on and no override.
//! Reads this state from a controller, and puts another controller into it. Also sends the items of a recording while
//! `$REC` lists it.

use crate::axes::{Axis, PerAxis};
use crate::dispatch::Controller;
use crate::gcode::{Distance, FeedMode, Modal, MotionMode, Units};
use crate::machine::realtime_override::Overrides;
use crate::messages::{Recorded, Standing, input};
use crate::protocol::recording;
use crate::protocol::text::{Text, fixed, put, real};
use crate::states::State;
use crate::units::Coordinate;
use crate::work::task::{Ask, Listing, Task};

impl<const N: usize> Controller<N> {
    /// Returns the step counters: net steps of each motor since power-up. They equal those of the step task only while
    /// the machine is at rest.
    pub fn step_counters(&self) -> PerAxis<i32, N> {
        self.m.motion.step_counters()
    }

    /// Returns whether the machine is locked, so that lines of a program are refused.
    pub fn is_locked(&self) -> bool {
        self.state.is_alarm()
    }

    /// Returns the state of the machine if a replay can begin from it, otherwise `None`. The machine must be at rest,
    /// with all outputs off, no override, and no active input except the probe and the at-speed signal. No offset may
    /// be active except stored ones, and no subroutine, loop or condition may be open. [`Controller::stand`] can
    /// restore such a state on a machine with the same stored records.
    pub fn standing(&self) -> Option<Standing> {
        let locked = match self.state {
            State::Normal => false,
            State::Alarm(None) => true,
            _ => return None,
        };
        let (place, counters) = self.m.motion.standing()?;
        let rests = self.m.motion.is_idle()
            && self.m.parking.motion().is_idle()
            && self.task.is_none()
            && self.m.stops.is_idle();
        let plain = self.m.interpreter.is_plain(&place) && !self.line.is_single_block() && !self.m.lines.is_checking();
        // An active probe or at-speed input does no harm. Any other active input has caused a reaction, which
        // `Standing` cannot express.
        let active = self.m.inputs.pins().word();
        let quiet = active & !(1 << input::PROBE | 1 << input::AT_SPEED) == 0;
        let outputs_off = !self.m.accessories.is_on() && self.m.accessories.digital().levels() == 0;
        let off = quiet && outputs_off && self.m.accessories.overrides() == Overrides::NONE;
        let words = words(self.m.interpreter.modal()).filter(|_| rests && plain && off)?;
        Some(Standing {
            counters: counters.iter().copied().collect(),
            place: place.iter().copied().collect(),
            trusted: self.m.reference.is_trusted(),
            locked,
            inches: self.m.interpreter.modal().units == Units::Inch,
            tool: self.m.interpreter.spindle_tool(),
            active,
            words,
        })
    }

    /// Puts a machine that is at rest and unlocked into the state `standing`, for a replay. Restores its position, the
    /// tool in the spindle, and whether the position is trusted. The caller then restores the modal state: it sends the
    /// G-code line `standing.words`. `lock`: locks the machine.
    pub fn stand(&mut self, standing: &Standing, lock: bool) {
        let place =
            PerAxis::from_axis(|axis: Axis| standing.place.get(axis.index()).copied().unwrap_or(Coordinate::ZERO));
        self.m.motion.set_machine_position(&place);
        self.m.interpreter.set_position(place);
        self.m.interpreter.hold_tool(standing.tool);
        self.m.reference.assume(standing.trusted);
        self.enter(if lock { State::Alarm(None) } else { State::Normal });
        self.m.pins.disturb();
    }

    /// Sends an item of the `$REC` listing, which the pump has read from the recorder.
    pub fn recorded(&mut self, item: &Recorded) {
        let Task::Listing(Listing::Recording(Ask::Asked), line) = self.task else { return };
        let hz = self.m.motion.settings().step_clock_hz;
        self.say(|out| recording::item(out, hz, item));
        if *item == Recorded::End {
            self.task = Task::None;
            self.say_ok();
        } else {
            self.task = Task::Listing(Listing::Recording(Ask::Wanted), line + 1);
        }
        self.m.pins.disturb();
    }

    /// Returns `Some` if the next item of the recording must be requested; `Some(true)` requests the first item.
    pub(crate) fn take_ask(&mut self) -> Option<bool> {
        let Task::Listing(Listing::Recording(ask @ Ask::Due), line) = &mut self.task else { return None };
        *ask = Ask::Asked;
        Some(*line == 0)
    }
}

/// Returns the modal state as a line of G-code, in mm. Returns `None` if no line can express it, for example because
/// the motion mode is neither G0 nor G1.
fn words(modal: &Modal) -> Option<heapless::Vec<u8, 64>> {
    let said = Modal {
        motion: modal.motion,
        straight: modal.motion,
        coordinate_system: modal.coordinate_system,
        plane: modal.plane,
        units: modal.units,
        distance: modal.distance,
        feed_mode: FeedMode::PerMinute,
        tool: modal.tool,
        feed: modal.feed,
        speed: modal.speed,
        ..Modal::INITIAL
    };
    if said != *modal || !matches!(modal.motion, MotionMode::Rapid | MotionMode::Linear) {
        return None;
    }
    let distance: Distance = modal.distance;
    let mut out = Text::new();
    put(&mut out, b"G21");
    for word in [modal.motion.word(), modal.coordinate_system.word(), modal.plane.word(), distance.word()] {
        put(&mut out, word.as_bytes());
    }
    put(&mut out, b"F");
    fixed(&mut out, false, modal.feed.0.unsigned_abs(), 7);
    put(&mut out, b"S");
    real(&mut out, modal.speed, 3);
    heapless::Vec::from_slice(&out).ok()
}
