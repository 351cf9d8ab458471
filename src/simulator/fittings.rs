//! What is fitted to the simulated machine: limit switches, with their bounce, and a probe plate. It knows where the
//! carriages are and nothing of the controller.

use crate::boards::AXES;
use anyhow::{Context, Result, ensure};
use oxmill_controller::axes::Axis;
use oxmill_controller::messages::Signals;
use serde::Deserialize;
use std::path::Path;

/// A machine as its file describes it (TOML).
///
/// ```toml
/// steps_per_mm = [250, 250, 250]   # of the machine itself
/// [[switch]]                       # closes at and beyond a place, in mm from where the machine stood at power-up
/// axis = "x"
/// at_mm = 2.0
/// side = "positive"                # the carriage closes it moving to positive
/// bounce_us = 900                  # how long it chatters when it closes or opens
/// [plate]                          # a probe plate
/// axis = "z"
/// at_mm = -12.5
/// side = "negative"
/// ```
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct Description {
    steps_per_mm: [f64; AXES],
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
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
enum Side {
    Positive,
    Negative,
}

/// One contact in steps.
#[derive(Clone, Debug)]
struct Fitted {
    axis: usize,
    at: i32,
    side: Side,
    bounce_us: u32,
    probe: bool,
    closed: bool,
    /// Microseconds of virtual time until which it chatters.
    chatters_until: u64,
}

/// All contacts of a machine.
#[derive(Clone, Debug, Default)]
pub struct Fittings {
    contacts: Vec<Fitted>,
}

impl Fittings {
    /// Reads a description.
    ///
    /// # Errors
    /// If it is not TOML of the form above or names an axis that does not exist.
    pub fn parse(text: &str) -> Result<Self> {
        let description: Description = toml::from_str(text)?;
        let mut contacts = Vec::new();
        let all = description.switch.iter().map(|c| (c, false)).chain(description.plate.iter().map(|c| (c, true)));
        for (contact, probe) in all {
            let letter = contact.axis.bytes().next().unwrap_or(b' ').to_ascii_uppercase();
            let axis =
                Axis::from_letter(letter).map(Axis::index).filter(|axis| *axis < AXES && contact.axis.len() == 1);
            let axis = axis.with_context(|| format!("`{}` is not an axis of this machine", contact.axis))?;
            let at = contact.at_mm * description.steps_per_mm[axis];
            ensure!(at.abs() < f64::from(i32::MAX), "{} mm is out of reach", contact.at_mm);
            contacts.push(Fitted {
                axis,
                at: at.round() as i32,
                side: contact.side,
                bounce_us: contact.bounce_us,
                probe,
                closed: false,
                chatters_until: 0,
            });
        }
        Ok(Self { contacts })
    }

    /// Reads a file.
    ///
    /// # Errors
    /// If it cannot be read or understood.
    pub fn read(path: &Path) -> Result<Self> {
        let text = std::fs::read_to_string(path).with_context(|| format!("cannot read {}", path.display()))?;
        Self::parse(&text).with_context(|| format!("{} does not describe a machine", path.display()))
    }

    /// Whether nothing is fitted.
    pub fn is_empty(&self) -> bool {
        self.contacts.is_empty()
    }

    /// The carriages stand here now. Whether a contact has changed.
    pub fn moved(&mut self, position: [i32; AXES], now_us: u64) -> bool {
        let mut changed = false;
        for contact in &mut self.contacts {
            let place = position[contact.axis];
            let closed = match contact.side {
                Side::Positive => place >= contact.at,
                Side::Negative => place <= contact.at,
            };
            if closed != contact.closed {
                contact.closed = closed;
                contact.chatters_until = now_us + u64::from(contact.bounce_us);
                changed = true;
            }
        }
        changed
    }

    /// Whether the plate is touched, as the step task sees it.
    pub fn touches(&self) -> bool {
        self.contacts.iter().any(|c| c.probe && c.closed)
    }

    /// What the pins show at a moment: a chattering contact shows its state in most samples and its contrary in some.
    pub fn sample(&self, now_us: u64) -> Signals {
        let mut signals = Signals::default();
        for contact in &self.contacts {
            let chatters = now_us < contact.chatters_until && (now_us / 50).wrapping_mul(0x9E37_79B9) >> 7 & 3 == 0;
            if contact.closed != chatters {
                if contact.probe {
                    signals.probe = true;
                } else {
                    signals.limits |= 1 << contact.axis;
                }
            }
        }
        signals
    }

    /// Whether a contact still chatters.
    pub fn chatter(&self, now_us: u64) -> bool {
        self.contacts.iter().any(|c| now_us < c.chatters_until)
    }
}

#[cfg(test)]
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

    #[test]
    fn contacts_close_at_their_place() {
        let mut mill = Fittings::parse(MILL).unwrap();
        assert!(!mill.moved([199, 0, -399], 0));
        assert!(mill.moved([200, 0, -400], 1000));
        assert!(mill.touches());
        assert_eq!(mill.sample(2000), Signals { limits: 1, probe: true, ..Signals::default() });
        assert!(mill.moved([0, 0, -600], 3000));
        assert_eq!(mill.sample(9000), Signals { limits: 4, probe: true, ..Signals::default() });
    }

    #[test]
    fn a_bouncing_switch_shows_both_levels_for_a_while() {
        let mut mill = Fittings::parse(MILL).unwrap();
        mill.moved([200, 0, 0], 1000);
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
