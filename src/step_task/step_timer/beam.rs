//! `Beam`: the power of a laser, which changes with the step that begins its segment.

use super::begins::MARKS;
use crate::boards::{StepOutput, StepPins};
use crate::shared::Power;

/// The power of a laser, which changes with the segment that it belongs to.
pub struct Beam {
    /// Changes that are ahead: moment and power.
    marks: heapless::Deque<(u32, u16), MARKS>,
    /// Of the segment that is out, and of the one that was made last.
    power: u16,
    made: u16,
    shown: u16,
    /// The first of the changes comes by itself, at its moment.
    armed: bool,
}

impl Beam {
    pub fn new() -> Beam {
        Beam { marks: heapless::Deque::new(), power: 0, made: 0, shown: 0, armed: false }
    }

    /// A motion begins from rest.
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

    /// Power does, or may still, come from segments.
    pub fn is_on(&self) -> bool {
        Power::wanted().from_segments || self.armed
    }

    /// A segment of this power begins at this moment; whether it is the first change that is ahead.
    pub fn segment(&mut self, at: u32, power: u16) -> bool {
        if power == self.made {
            return false;
        }
        if self.marks.is_full() {
            // Without an event in between no power but the last would be seen.
            self.marks.pop_back();
        }
        let is_kept = self.marks.push_back((at, power)).is_ok();
        if is_kept {
            self.made = power;
        }
        is_kept && self.marks.len() == 1
    }

    /// Off until a motion that events came too late for is resumed.
    pub fn resume_at(&mut self, moment: u32) {
        self.power = 0;
        let _ = self.marks.push_back((moment, self.made));
    }

    pub fn put_off(&mut self, by: u32) {
        for (at, _) in self.marks.iter_mut() {
            *at = at.wrapping_add(by);
        }
    }

    /// The next change of power comes by itself; it is only noted at its moment if power does not come from segments. What may still
    /// be put off is not armed: it is not known yet when it comes.
    #[inline(never)]
    pub fn arm(&mut self, output: &mut StepPins) {
        if let Some((at, power)) = self.marks.front().copied() {
            self.armed = Power::wanted().from_segments;
            output.mark_at(at, self.armed.then_some(power));
        }
    }

    /// The moment of a change of power has come, and maybe that of others, which come late.
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
            // Once more what has come by itself: if it has not, for whatever reason, it comes now.
            self.set_power(output, self.power);
        }
        self.arm(output);
    }

    /// Shows the power that holds now, if it is another one: that of segments while something moves. Whether it was one.
    #[inline(always)]
    pub fn show(&mut self, output: &mut StepPins, is_at_rest: bool, is_dark: bool) -> bool {
        let power = Power::wanted();
        let level = match (power.from_segments, is_at_rest) {
            // After a stop or underrun the beam stays off, whatever was wanted before.
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

    /// No power from segments, at once and until the controller asks for some.
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

    /// Events do not come out any more, and no change with them.
    pub fn end_run(&mut self, output: &mut StepPins) {
        self.marks.clear();
        if self.armed {
            // Whether it has come is not known.
            self.set_power(output, 0);
        }
    }

    /// Power from now on to the next change, which is armed anew by the caller if one is ahead.
    #[inline(never)]
    fn set_power(&mut self, output: &mut StepPins, level: u16) {
        output.set_power(level);
        self.shown = level;
        self.armed = false;
    }
}
