//! The power of a laser ([`Beam`]). The power of a segment takes effect with the step that begins this segment.

use super::begins::MARKS;
use crate::boards::{StepOutput, StepPins};
use crate::shared::Power;

/// The laser power, and its changes "ahead": those of segments whose start has been generated but not output yet.
pub struct Beam {
    /// Changes ahead, in the order of their times: time and new power.
    marks: heapless::Deque<(u32, u16), MARKS>,
    /// Power of the segment that is being output.
    power: u16,
    /// Power of the segment whose start was generated last.
    made: u16,
    /// Power that the output has been set to.
    shown: u16,
    /// Whether hardware is set up to make the first change at its time.
    armed: bool,
}

impl Beam {
    pub fn new() -> Beam {
        Beam { marks: heapless::Deque::new(), power: 0, made: 0, shown: 0, armed: false }
    }

    /// Sets the power to 0 and discards all changes ahead. Call when a motion begins from rest.
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

    /// Returns whether power comes from segments, or hardware can still make a change that was armed.
    pub fn is_on(&self) -> bool {
        Power::wanted().from_segments || self.armed
    }

    /// Adds the power of a segment that begins at the time `at`. Returns whether this change is now the first one
    /// ahead.
    pub fn segment(&mut self, at: u32, power: u16) -> bool {
        if power == self.made {
            return false;
        }
        if self.marks.is_full() {
            // The new change replaces the newest stored one. No event lies between these two changes, so no step would
            // have had the power of the stored one.
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

    pub fn put_off(&mut self, by: u32) {
        for (at, _) in self.marks.iter_mut() {
            *at = at.wrapping_add(by);
        }
    }

    /// Arms the next change: hardware makes it at its time, and calls the step task. If power does not come from
    /// segments, hardware only calls the step task, which records the change. Do not call this function while the
    /// motion can still be delayed, because until then the time of the change is not final.
    #[inline(never)]
    pub fn arm(&mut self, output: &mut StepPins) {
        if let Some((at, power)) = self.marks.front().copied() {
            self.armed = Power::wanted().from_segments;
            output.mark_at(at, self.armed.then_some(power));
        }
    }

    /// Records all changes whose time has come, and arms the next one. Hardware makes only one change at its time; if
    /// others follow it shortly, this function makes them, perhaps late.
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
            // Sets the power that hardware should have set, in case it has not, and any later power that is due.
            self.set_power(output, self.power);
        }
        self.arm(output);
    }

    /// Sets the output if the wanted power differs from it. While the machine moves, the power of a laser is that of
    /// the segments. `is_dark`: keep a laser off. Returns whether the output was set.
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

    /// Switches off power from segments at once, until the controller sets it again.
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

    /// Discards all changes ahead. Call when the output of events has ended.
    pub fn end_run(&mut self, output: &mut StepPins) {
        self.marks.clear();
        if self.armed {
            // It is unknown whether hardware has made the armed change, so switch off.
            self.set_power(output, 0);
        }
    }

    /// Sets the output to `level` at once, and disarms hardware. If there is a change ahead, the caller must arm it
    /// again.
    #[inline(never)]
    fn set_power(&mut self, output: &mut StepPins, level: u16) {
        output.set_power(level);
        self.shown = level;
        self.armed = false;
    }
}
