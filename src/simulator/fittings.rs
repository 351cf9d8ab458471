//! The hardware of the simulated machine, as described in TOML: limit switches, probe plate, backlash, a racked gantry.
//! Follows the motors and computes which contacts are closed or still bouncing. It does not use the controller.

use crate::boards::AXES;
use crate::machine::Machine;
use anyhow::{Context, Result, ensure};
use oxmill_controller::axes::{Arrangement, Axis, LINEAR};
use oxmill_controller::messages::{SECOND_SWITCH, Signals};
use serde::Deserialize;

/// Description of a machine. A file has it in TOML; code can deserialize it from any format that serde supports.
///
/// ```toml
/// steps_per_mm = [250, 250, 250]   # of the machine itself
/// kinematics = "corexy"            # or "cartesian", the default
/// backlash_mm = [0.05, 0.03, 0]    # how far each motor turns before its carriage follows; each list may have A, in degrees
/// racked_mm = 0.4                  # how far the second motor of an axis is ahead of the first at power-up
/// [[switch]]                       # closes at and beyond a position, in mm from the position at power-up
/// axis = "x"
/// at_mm = 2.0
/// side = "positive"                # the carriage closes it moving to positive
/// bounce_us = 900                  # how long it chatters when it closes or opens
/// second_motor = true              # at the second motor of the axis
/// [plate]                          # a probe plate
/// axis = "z"
/// at_mm = -12.5
/// side = "negative"
/// ```
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Description {
    steps_per_mm: Vec<f64>,
    #[serde(default)]
    kinematics: Kinematics,
    #[serde(default)]
    backlash_mm: Vec<f64>,
    #[serde(default)]
    racked_mm: f64,
    #[serde(default)]
    switch: Vec<Contact>,
    plate: Option<Contact>,
}

#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct Contact {
    axis: String,
    at_mm: f64,
    side: Side,
    #[serde(default)]
    bounce_us: u32,
    #[serde(default)]
    second_motor: bool,
}

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
enum Kinematics {
    #[default]
    Cartesian,
    CoreXy,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
enum Side {
    Positive,
    Negative,
}

/// A limit switch or the probe plate. Positions are in mm from where the carriages were at power-up.
#[derive(Clone, Debug)]
struct Fitted {
    axis: usize,
    second_motor: bool,
    at_mm: f64,
    side: Side,
    bounce_us: u32,
    probe: bool,
    /// `true` if the switch is normally closed: its pin is high while the carriage presses it.
    opens: bool,
    closed: bool,
    /// Virtual time until which the contact bounces, in microseconds.
    chatters_until: u64,
}

/// Limit switches that match a controller's homing settings, one per axis.
#[derive(Clone, Debug)]
pub struct HomeSwitches {
    /// Steps per mm of each motor; used if there is no [`Description`] of the machine.
    pub steps_per_mm: [f64; AXES],
    /// How the motors move the carriages; used if there is no [`Description`] of the machine.
    pub arrangement: Arrangement,
    /// Switch positions in mm from the present positions of the carriages. A carriage closes its switch when it moves
    /// in the direction that the sign of the position shows.
    pub at_mm: [f64; AXES],
    /// The axes that have a switch.
    pub axes: Vec<usize>,
    /// The axis that has a second switch, at its second motor.
    pub second_motor: Option<usize>,
    /// `true` if the switches are normally closed (`$5`).
    pub opens: bool,
}

/// Tolerance for rounding, mm: less than any step.
const ROUNDING_TOLERANCE_MM: f64 = 1.0e-7;

/// The hardware of a machine according to its [`Description`], with the present state of its contacts.
#[derive(Clone, Debug, Default)]
pub struct Fittings {
    steps_per_mm: [f64; AXES],
    kinematics: Kinematics,
    backlash_mm: [f64; AXES],
    racked_mm: f64,
    contacts: Vec<Fitted>,
    /// Position of the part that each motor drives, mm. Because of backlash, it lies between the position of the motor
    /// minus the backlash and the position of the motor.
    driven_mm: [f64; AXES],
}

impl Fittings {
    /// Reads a machine description from TOML.
    ///
    /// # Errors
    /// If the text is not TOML of the form of [`Description`], or in the cases of [`Fittings::new`].
    #[cfg(feature = "program")]
    pub fn parse(text: &str) -> Result<Self> {
        Self::new(toml::from_str(text)?)
    }

    /// Builds the machine of a description.
    ///
    /// # Errors
    /// If the description names an axis that does not exist, or a number in it is out of range.
    pub fn new(description: Description) -> Result<Self> {
        let mut contacts = Vec::new();
        let all = description.switch.iter().map(|c| (c, false)).chain(description.plate.iter().map(|c| (c, true)));
        for (contact, probe) in all {
            let letter = contact.axis.bytes().next().unwrap_or(b' ').to_ascii_uppercase();
            let axis =
                Axis::from_letter(letter).map(Axis::index).filter(|axis| *axis < AXES && contact.axis.len() == 1);
            let axis = axis.with_context(|| format!("`{}` is not an axis of this machine", contact.axis))?;
            ensure!(contact.at_mm.abs() < 1.0e6, "{} mm is out of reach", contact.at_mm);
            contacts.push(Fitted {
                axis,
                second_motor: contact.second_motor,
                at_mm: contact.at_mm,
                side: contact.side,
                bounce_us: contact.bounce_us,
                probe,
                opens: false,
                closed: false,
                chatters_until: 0,
            });
        }
        let Description { steps_per_mm, kinematics, backlash_mm, racked_mm, .. } = description;
        let count = steps_per_mm.len();
        ensure!((LINEAR..=AXES).contains(&count), "steps_per_mm must have {LINEAR} to {AXES} numbers");
        ensure!(
            contacts.iter().all(|contact| contact.axis < count),
            "steps_per_mm must have a number for each axis with a switch or probe"
        );
        ensure!(backlash_mm.is_empty() || backlash_mm.len() == count, "backlash_mm must be as long as steps_per_mm");
        let of = |list: &[f64], other: f64| std::array::from_fn(|axis| list.get(axis).copied().unwrap_or(other));
        let (steps_per_mm, backlash_mm): ([f64; AXES], [f64; AXES]) = (of(&steps_per_mm, 1.0), of(&backlash_mm, 0.0));
        ensure!(backlash_mm.iter().all(|b| b.is_finite() && *b >= 0.0), "backlash_mm must not be negative");
        ensure!(steps_per_mm.iter().all(|s| s.is_finite() && *s > 0.0), "steps_per_mm must be above 0");
        Ok(Self { steps_per_mm, kinematics, backlash_mm, racked_mm, contacts, driven_mm: [0.0; AXES] })
    }

    /// Adds the switches if the machine has no limit switches yet. Returns whether they were added.
    pub fn fit_switches(&mut self, switches: &HomeSwitches) -> bool {
        if self.contacts.iter().any(|contact| !contact.probe) {
            return false;
        }
        if self.contacts.is_empty() {
            self.steps_per_mm = switches.steps_per_mm;
            self.kinematics = match switches.arrangement {
                Arrangement::Cartesian => Kinematics::Cartesian,
                Arrangement::CoreXy => Kinematics::CoreXy,
            };
        }
        let first = switches.axes.iter().map(|axis| (*axis, false));
        for (axis, second_motor) in first.chain(switches.second_motor.map(|axis| (axis, true))) {
            let at_mm = switches.at_mm[axis];
            self.contacts.push(Fitted {
                axis,
                second_motor,
                at_mm,
                side: if at_mm < 0.0 { Side::Negative } else { Side::Positive },
                bounce_us: 0,
                probe: false,
                opens: switches.opens,
                closed: false,
                chatters_until: 0,
            });
        }
        true
    }

    /// Adapts the positions of all contacts and driven parts when the present position gets other coordinates, as after
    /// homing. Nothing moves. `by`: steps added to the counter of each motor.
    pub fn rename_places(&mut self, by: [i32; AXES]) {
        if self.is_empty() {
            return;
        }
        let motors: [f64; AXES] = std::array::from_fn(|motor| f64::from(by[motor]) / self.steps_per_mm[motor]);
        let places = self.places(motors);
        for contact in &mut self.contacts {
            contact.at_mm += places[contact.axis];
        }
        for (driven, by) in self.driven_mm.iter_mut().zip(motors) {
            *driven += by;
        }
    }

    /// Converts the positions of the parts that the motors drive to positions of the carriages, mm. They are equal,
    /// except on a CoreXY machine: X = (A + B) / 2 and Y = (A - B) / 2.
    fn places(&self, motors: [f64; AXES]) -> [f64; AXES] {
        let mut places = motors;
        if self.kinematics == Kinematics::CoreXy {
            let [a, b, ..] = motors;
            (places[0], places[1]) = (0.5 * (a + b), 0.5 * (a - b));
        }
        places
    }

    /// Returns whether the machine has neither contacts nor backlash. Then nothing needs to follow the motors.
    pub fn is_empty(&self) -> bool {
        self.contacts.is_empty() && self.backlash_mm == [0.0; AXES]
    }

    /// Updates driven parts and contacts to the motor positions of `machine`. Returns whether a contact has opened or
    /// closed.
    pub fn moved(&mut self, machine: &Machine, now_us: u64) -> bool {
        if self.is_empty() {
            return false;
        }
        let motors = machine.motors();
        for (motor, driven) in self.driven_mm.iter_mut().enumerate() {
            let turned = f64::from(motors[motor]) / self.steps_per_mm[motor];
            *driven = driven.clamp(turned - self.backlash_mm[motor], turned);
        }
        let places = self.places(self.driven_mm);
        let mut changed = false;
        for contact in &mut self.contacts {
            let place = if contact.second_motor {
                self.racked_mm + f64::from(machine.second_motor()) / self.steps_per_mm[contact.axis]
            } else {
                places[contact.axis]
            };
            // A contact located exactly at a step must close at that step, in spite of rounding.
            let beyond = match contact.side {
                Side::Positive => place - contact.at_mm,
                Side::Negative => contact.at_mm - place,
            };
            let closed = beyond > -ROUNDING_TOLERANCE_MM;
            if closed != contact.closed {
                contact.closed = closed;
                contact.chatters_until = now_us + u64::from(contact.bounce_us);
                changed = true;
            }
        }
        changed
    }

    /// Position of the part that each motor drives, mm from power-up.
    pub fn driven_mm(&self) -> [f64; AXES] {
        self.driven_mm
    }

    /// Returns whether the tool touches the probe plate. The bounce of the contact is left out. The step task reads
    /// this value.
    pub fn touches(&self) -> bool {
        self.contacts.iter().any(|c| c.probe && c.closed)
    }

    /// Returns the levels of the pins at the time `now_us`. While a contact bounces, about one sample in four shows the
    /// opposite of its state.
    pub fn sample(&self, now_us: u64) -> Signals {
        let mut signals = Signals::default();
        for contact in &self.contacts {
            let chatters = now_us < contact.chatters_until && (now_us / 50).wrapping_mul(0x9E37_79B9) >> 7 & 3 == 0;
            if (contact.closed != chatters) != contact.opens {
                if contact.probe {
                    signals.probe = true;
                } else if contact.second_motor {
                    signals.limits |= SECOND_SWITCH;
                } else {
                    signals.limits |= 1 << contact.axis;
                }
            }
        }
        signals
    }

    /// Returns whether a contact is still bouncing.
    pub fn chatter(&self, now_us: u64) -> bool {
        self.contacts.iter().any(|c| now_us < c.chatters_until)
    }
}

#[cfg(all(test, feature = "program"))]
mod tests {
    use super::*;

    const MILL: &str = r#"
        steps_per_mm = [100, 100, 400]
        [[switch]]
        axis = "x"
        at_mm = 2.0
        side = "positive"
        bounce_us = 500
        [[switch]]
        axis = "Z"
        at_mm = -1.5
        side = "negative"
        [plate]
        axis = "z"
        at_mm = -1.0
        side = "negative"
    "#;

    fn run(machine: &mut Machine, to: [i32; LINEAR]) {
        while machine.position() != to {
            let here = machine.position();
            let off = |axis: usize| u8::from(here[axis] != to[axis]) << axis;
            let negative = |axis: usize| u8::from(here[axis] > to[axis]) << axis;
            machine.step(off(0) | off(1) | off(2), negative(0) | negative(1) | negative(2));
        }
    }

    #[test]
    fn contacts_close_at_their_place() {
        let mut mill = Fittings::parse(MILL).unwrap();
        let mut machine = Machine::default();
        run(&mut machine, [199, 0, -399]);
        assert!(!mill.moved(&machine, 0));
        run(&mut machine, [200, 0, -400]);
        assert!(mill.moved(&machine, 1000));
        assert!(mill.touches());
        assert_eq!(mill.sample(2000), Signals { limits: 1, probe: true, ..Signals::default() });
        run(&mut machine, [0, 0, -600]);
        assert!(mill.moved(&machine, 3000));
        assert_eq!(mill.sample(9000), Signals { limits: 4, probe: true, ..Signals::default() });
    }

    #[test]
    fn a_bouncing_switch_shows_both_levels_for_a_while() {
        let mut mill = Fittings::parse(MILL).unwrap();
        let mut machine = Machine::default();
        run(&mut machine, [200, 0, 0]);
        mill.moved(&machine, 1000);
        let shown: Vec<u8> = (0..10).map(|n| mill.sample(1000 + n * 50).limits).collect();
        assert!(shown.contains(&0) && shown.contains(&1), "{shown:?}");
        assert!(mill.chatter(1499) && !mill.chatter(1500));
        assert_eq!(mill.sample(1500).limits, 1);
    }

    #[test]
    fn nonsense_is_refused() {
        for text in ["", "steps_per_mm = [1, 2]", &MILL.replace("\"x\"", "\"q\""), &MILL.replace("bounce_us", "bonce")]
        {
            assert!(Fittings::parse(text).is_err(), "{text}");
        }
    }
}
