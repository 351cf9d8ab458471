//! `Floor`: which of two hosts has the machine, whose lines are read and who gets the answers. It is claimed (`firm` or
//! not), seized by a reset, and left; a `weak` holder keeps no other host out.

/// Which of two hosts has the floor: whose lines are read, and who gets the answers. Realtime commands need no floor.
#[derive(Clone, Debug)]
pub(super) struct Floor {
    holder: usize,
    /// The holder has gone or has only asked for a report; or no host has sent anything yet.
    weak: bool,
}

impl Floor {
    /// Answers go to link 0, and whoever speaks first has the floor.
    pub const fn new() -> Self {
        Self { holder: 0, weak: true }
    }

    /// Who gets the answers.
    pub fn holder(&self) -> usize {
        self.holder
    }

    /// The host of `link` has it, and more than asked for a report.
    #[inline]
    pub fn is_held_by(&self, link: usize) -> bool {
        self.holder == link && !self.weak
    }

    /// The host of `link` wants to say something: whether it may. `free`: the machine has nothing to do for the holder.
    /// `firm`: it opens its port or sends a line; a realtime command alone gets its answer, and keeps no other host out.
    pub fn claim(&mut self, link: usize, free: bool, firm: bool) -> bool {
        if self.weak || free {
            self.holder = link;
            self.weak = !firm;
        }
        self.holder == link
    }

    /// The host of `link` has reset the machine, and with it everything that another one wanted: it has the floor.
    pub fn seize(&mut self, link: usize) -> bool {
        self.holder = link;
        self.weak = false;
        true
    }

    /// The host of `link` has gone.
    pub fn leave(&mut self, link: usize) {
        self.weak |= self.holder == link;
    }
}

impl Default for Floor {
    fn default() -> Self {
        Self::new()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_host_at_a_time_has_the_floor() {
        let mut floor = Floor::new();
        assert_eq!(floor.holder(), 0);
        assert!(floor.claim(1, false, true));
        assert!(!floor.claim(0, false, true));
        assert_eq!(floor.holder(), 1);
        // Idle: whoever speaks.
        assert!(floor.claim(0, true, true));
        assert!(floor.claim(0, false, true) && !floor.claim(1, false, true));
        floor.leave(1);
        assert!(!floor.claim(1, false, true));
        floor.leave(0);
        assert!(floor.claim(1, false, true));
        floor.seize(0);
        assert!(!floor.claim(1, false, true));
    }

    #[test]
    fn a_question_keeps_nobody_out() {
        let mut floor = Floor::new();
        assert!(floor.claim(1, false, true));
        // The holder's own questions change nothing.
        assert!(floor.claim(1, false, false) && !floor.claim(0, false, false));
        floor.leave(1);
        assert!(floor.claim(0, false, false));
        assert!(floor.claim(1, false, true));
        assert!(!floor.claim(0, false, true));
    }
}
