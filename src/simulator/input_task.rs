//! The input task: samples the simulated pins through the boards' own filter. A pin is low if the user or a closed
//! contact pulls it low. The task reports changes to the controller. It stops the step task if an armed input
//! (`Wiring::armed`, such as a limit switch) becomes active.

use crate::clock::Clock;
use crate::fittings::Fittings;
use oxmill_controller::machine::signals::{Inputs, SETTLING};
use oxmill_controller::messages::{Sensed, Signals, Wiring, input};

/// State of the input task: the simulated pins and their filter.
#[derive(Clone)]
pub struct InputTask {
    /// Pins that the user pulls low.
    hand: Signals,
    /// State of the machine's contacts at the last sample.
    contacts: Signals,
    /// Number of samples in a row that showed the same state of the contacts.
    steady: u8,
    /// Time of the next sample, in ticks. `None` if no contact bounces and the filter has accepted the state of all
    /// contacts.
    sample_due: Option<u64>,
    inputs: Inputs,
    /// Per input: changes that the filter has rejected.
    noise: [u16; input::COUNT],
    /// The state of the inputs that was last reported to the controller.
    reported: Option<Sensed>,
}

impl Default for InputTask {
    fn default() -> Self {
        InputTask {
            hand: Signals::default(),
            contacts: Signals::default(),
            steady: 0,
            sample_due: None,
            inputs: Inputs::new(),
            noise: [0; input::COUNT],
            reported: None,
        }
    }
}

impl InputTask {
    /// Restarts the filter and the counts, as a restart of the board does. The levels of the pins stay.
    pub fn restart(&mut self) {
        *self = InputTask { hand: self.hand, contacts: self.contacts, ..InputTask::default() };
    }

    /// Pins that the user pulls low.
    pub fn hand(&self) -> Signals {
        self.hand
    }

    /// Sets the pins that the user pulls low. Returns whether they have changed.
    pub fn set_hand(&mut self, signals: Signals) -> bool {
        std::mem::replace(&mut self.hand, signals) != signals
    }

    /// Mask of the pins that are low, because the user or a closed contact pulls them low.
    pub fn low(&self) -> u32 {
        self.hand.word() | self.contacts.word()
    }

    /// Time of the next sample, in ticks; `None` if no sample is scheduled.
    pub fn sample_due(&self) -> Option<u64> {
        self.sample_due
    }

    /// Schedules a sample because a contact has moved, unless a sample is already scheduled.
    pub fn sample_at(&mut self, ticks: u64) {
        self.sample_due.get_or_insert(ticks);
    }

    /// Takes one sample with the machine's contacts as they are now. Returns whether the step task must be stopped.
    /// Schedules the next sample `period` ticks later, while a contact bounces or fewer than [`SETTLING`] samples in a
    /// row were equal.
    pub fn sample_contacts(&mut self, fittings: &mut Fittings, clock: &Clock, period: u64) -> bool {
        let now = clock.instant().ticks();
        let contacts = fittings.sample(now);
        self.steady = if contacts == self.contacts { self.steady.saturating_add(1) } else { 1 };
        self.contacts = contacts;
        let settled = self.steady >= SETTLING && !fittings.chatter(now);
        self.sample_due = (!settled).then(|| clock.now() + period);
        self.sample(self.low())
    }

    /// Takes a sample, and counts the changes that the filter rejects. `low`: mask of the low pins. Returns whether an
    /// armed input stops the step task.
    pub fn sample(&mut self, low: u32) -> bool {
        let stops = self.inputs.sample(low);
        let rejected = self.inputs.rejected();
        for (bit, count) in self.noise.iter_mut().enumerate() {
            *count = count.saturating_add((rejected >> bit & 1) as u16);
        }
        stops
    }

    /// Takes [`SETTLING`] samples at the same virtual time, so that the filter accepts the present levels. Returns how
    /// many of them stop the step task.
    /// Does nothing while contacts settle after power-up, because the first report to the controller must contain the
    /// settled contacts.
    pub fn settle(&mut self) -> usize {
        if self.inputs.sensed().is_none() && self.sample_due.is_some() {
            return 0;
        }
        (0..SETTLING).filter(|_| self.sample(self.low())).count()
    }

    /// Sets which inputs are inverted, and which of them stop the step task when they become active.
    pub fn wire(&mut self, wiring: &Wiring) {
        self.inputs.wire(wiring);
    }

    /// Returns the inputs if they have changed since the last report to the controller, and marks them as reported.
    pub fn next_change(&mut self) -> Option<Sensed> {
        let sensed = self.inputs.sensed().filter(|sensed| self.reported != Some(*sensed))?;
        self.inputs.mark_sent();
        self.reported = self.inputs.sensed();
        Some(sensed)
    }

    /// Per input: changes that the filter has rejected.
    pub fn noise(&self) -> [u16; input::COUNT] {
        self.noise
    }

    /// Resets the counts of [`InputTask::noise`].
    pub fn clear_noise(&mut self) {
        self.noise = [0; input::COUNT];
    }
}
