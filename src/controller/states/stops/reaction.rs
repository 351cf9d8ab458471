//! The reaction to each fault as set in `$924` to `$928`: how motion ends, and whether the spindle stays on.

use crate::error::Alarm;
use crate::settings::{Key, Settings};

/// How motion ends.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Braking {
    /// The machine stops at once, without braking. If it was moving at speed, the position is lost.
    AtOnce,
    /// The machine brakes along the path, within the accelerations. The position is kept.
    Controlled,
    /// As `Controlled`, then the tool is parked as by the safety door.
    Retract,
}

/// How motion and spindle react to a fault.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Reaction {
    /// How motion ends.
    pub braking: Braking,
    /// The spindle and the coolant stay on.
    pub spindle_on: bool,
}

impl Reaction {
    /// Returns the reaction to the fault of this alarm. Faults without a setting stop at once.
    pub fn to<const N: usize>(alarm: Alarm, settings: &Settings<N>) -> Reaction {
        let key = match alarm {
            Alarm::HardLimit => Key::LimitReaction,
            Alarm::EmergencyStop => Key::EmergencyReaction,
            Alarm::DriverFault => Key::DriverReaction,
            Alarm::SpindleSpeed => Key::SpindleReaction,
            _ => return Reaction { braking: Braking::AtOnce, spindle_on: false },
        };
        Reaction::of(key, settings)
    }

    /// Returns the reaction that the setting `key` selects. The values 0 to 2 switch the spindle off, 3 to 5 leave it
    /// on. A laser is switched off in any case.
    pub fn of<const N: usize>(key: Key, settings: &Settings<N>) -> Reaction {
        let value = settings.whole(key);
        let braking = match value % 3 {
            0 => Braking::AtOnce,
            1 => Braking::Controlled,
            _ => Braking::Retract,
        };
        Reaction { braking, spindle_on: value >= 3 && !settings.is_on(Key::Laser) }
    }

    /// Returns whether an input may stop the step task for this fault directly, without an order of the controller.
    pub fn is_at_once(self) -> bool {
        self.braking == Braking::AtOnce
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_are_reactions_and_the_defaults_are_safe() {
        let mut settings = Settings::<3>::default();
        let off = |braking| Reaction { braking, spindle_on: false };
        for (alarm, safe) in [
            (Alarm::HardLimit, Braking::AtOnce),
            (Alarm::EmergencyStop, Braking::AtOnce),
            (Alarm::DriverFault, Braking::AtOnce),
            (Alarm::SpindleSpeed, Braking::Controlled),
            (Alarm::Underrun, Braking::AtOnce),
        ] {
            assert_eq!(Reaction::to(alarm, &settings), off(safe), "{alarm:?}");
        }
        for (value, braking, spindle_on) in [
            (0.0, Braking::AtOnce, false),
            (1.0, Braking::Controlled, false),
            (2.0, Braking::Retract, false),
            (3.0, Braking::AtOnce, true),
            (4.0, Braking::Controlled, true),
            (5.0, Braking::Retract, true),
        ] {
            settings.restore(Key::LimitReaction.number(), value);
            assert_eq!(Reaction::to(Alarm::HardLimit, &settings), Reaction { braking, spindle_on });
        }
        settings.restore(Key::Laser.number(), 1.0);
        assert!(!Reaction::to(Alarm::HardLimit, &settings).spindle_on, "a beam on one point burns");
    }
}
