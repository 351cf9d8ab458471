//! The power of a laser ([`Beam`]). The power of a segment takes effect with the step that begins this segment.

use super::begins::MARKS;
use crate::boards::{StepOutput, StepPins};
use crate::shared::Power;

/// The laser power (0 to 65535), and a queue of its coming changes. Each change belongs to a generated segment whose
/// start has not been output yet.
pub struct Beam {
    /// The queued changes in the order of their times: time and new power.
    marks: heapless::Deque<(u32, u16), MARKS>,
    /// Power of the segment that is being output.
    power: u16,
    /// Power of the segment generated most recently.
    made: u16,
    /// Power that the output has been set to.
    shown: u16,
    /// Whether hardware is set up to make the first queued change at its time, without the CPU.
    armed: bool,
}

impl Beam {
    pub fn new() -> Beam {
        Beam { marks: heapless::Deque::new(), power: 0, made: 0, shown: 0, armed: false }
    }

    /// Sets the power to 0 and empties the queue of changes. Call when a motion begins from rest.
    pub fn clear(&mut self) {
        self.marks.clear();
        (self.power, self.made) = (0, 0);
    }

    pub fn shown(&self) -> u16 {
        self.shown
    }

    pub fn is_full(&self) -> bool {
        self.marks.is_full()
    }

    /// Returns whether the laser may be on: its power comes from the segments, or hardware is still set up to change
    /// it.
    pub fn is_on(&self) -> bool {
        Power::wanted().from_segments || self.armed
    }

    /// Queues a change to `power` at the time `at`, at which a segment begins. Queues nothing if the previous segment
    /// has the same power. Returns whether it is the only queued change, which the caller must arm once the output
    /// runs.
    pub fn segment(&mut self, at: u32, power: u16) -> bool {
        if power == self.made {
            return false;
        }
        if self.marks.is_full() {
            // Replace the newest queued change. No event lies between that change and the new one, so no step would
            // have had the power of the replaced change.
            self.marks.pop_back();
        }
        let is_kept = self.marks.push_back((at, power)).is_ok();
        if is_kept {
            self.made = power;
        }
        is_kept && self.marks.len() == 1
    }

    /// Keeps the laser off until `moment`, the time at which a motion with late events is resumed.
    pub fn resume_at(&mut self, moment: u32) {
        self.power = 0;
        let _ = self.marks.push_back((moment, self.made));
    }

    /// Delays all queued changes by `by` ticks.
    pub fn delay(&mut self, by: u32) {
        for (at, _) in self.marks.iter_mut() {
            *at = at.wrapping_add(by);
        }
    }

    /// Arms the first queued change: at its time, hardware changes the power and calls the step task ([`Beam::mark`]).
    /// If power does not come from segments, hardware only calls the step task. Do not call this function while the
    /// motion can still be delayed, because until then the time of the change is not final.
    #[inline(never)]
    pub fn arm(&mut self, output: &mut StepPins) {
        if let Some((at, power)) = self.marks.front().copied() {
            self.armed = Power::wanted().from_segments;
            output.mark_at(at, self.armed.then_some(power));
        }
    }

    /// Removes all changes that are due from the queue, sets the power of the last of them, and arms the next change.
    /// Called at the time of an armed change. Hardware makes only the armed change at its exact time. Changes that
    /// follow shortly after it are made here, perhaps late.
    #[inline(never)]
    pub fn mark(&mut self, output: &mut StepPins) {
        let before = self.marks.len();
        while let Some((at, power)) = self.marks.front().copied()
            && at.wrapping_sub(output.now()) as i32 <= 0
        {
            self.power = power;
            self.marks.pop_front();
        }
        if self.marks.len() < before && Power::wanted().from_segments {
            // Hardware should have set the power of the armed change, but may not have done so. If a later change is
            // due as well, its power counts.
            self.set_power(output, self.power);
        }
        self.arm(output);
    }

    /// Sets the output if its power must change. The power is the one that `control` has requested or, for a laser in
    /// motion, the power of the segment. `is_dark`: `true` to keep a laser off. Returns whether the output was set.
    #[inline(always)]
    pub fn show(&mut self, output: &mut StepPins, is_at_rest: bool, is_dark: bool) -> bool {
        let power = Power::wanted();
        let level = match (power.from_segments, is_at_rest) {
            // After a stop or underrun the laser stays off, whatever power was wanted before.
            (true, _) if is_dark => 0,
            (true, true) | (false, _) => power.level,
            _ => self.power,
        };
        let is_other = level != self.shown || self.armed && !power.from_segments;
        if is_other {
            self.set_power(output, level);
        }
        is_other
    }

    /// Switches off a laser whose power comes from segments: sets the requested power to 0 and empties the queue of
    /// changes.
    pub fn switch_off(&mut self, output: &mut StepPins) {
        self.clear();
        let power = Power::wanted();
        if power.from_segments {
            Power { level: 0, ..power }.want();
        }
        if power.from_segments || self.armed {
            self.set_power(output, 0);
        }
    }

    /// Empties the queue of changes when the output of events has ended. Switches a laser off if a change was armed.
    pub fn end_run(&mut self, output: &mut StepPins) {
        self.marks.clear();
        if self.armed {
            // It is unknown whether hardware has made the armed change, so switch off.
            self.set_power(output, 0);
        }
    }

    /// Sets the output to `level` at once. This cancels the change that hardware was set up to make. If changes are
    /// queued, the caller must arm the first one again.
    #[inline(never)]
    fn set_power(&mut self, output: &mut StepPins, level: u16) {
        output.set_power(level);
        self.shown = level;
        self.armed = false;
    }
}
