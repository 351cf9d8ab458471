//! `ActiveHost`: arbitrates between two hosts. One of them is the active host: its lines are read, and it gets the
//! replies. A host can claim this role, or take it over by a reset. It leaves the role when it disconnects. A `weak`
//! active host does not keep the other host out.

/// The active host: its lines are read, and it gets the replies. Realtime commands are accepted from any host.
#[derive(Clone, Debug)]
pub(super) struct ActiveHost {
    link: usize,
    /// The active host has disconnected or has only sent realtime commands, or no host has sent anything yet.
    weak: bool,
}

impl ActiveHost {
    /// Creates the state in which no host is active yet. Replies go to link 0, and the first claim succeeds.
    pub const fn new() -> Self {
        Self { link: 0, weak: true }
    }

    /// Returns the link that gets the replies.
    pub fn link(&self) -> usize {
        self.link
    }

    /// Returns whether the host of `link` is the active host and keeps the other host out.
    #[inline]
    pub fn is_held_by(&self, link: usize) -> bool {
        self.link == link && !self.weak
    }

    /// Claims the role of the active host for the host of `link`. Returns whether that host is the active one
    /// afterwards. `free`: the machine has nothing to do for the present active host. `firm`: `true` if the host
    /// opens its port or sends a line. `false` if it sends only a realtime command: then it gets the reply, but does
    /// not keep the other host out.
    pub fn claim(&mut self, link: usize, free: bool, firm: bool) -> bool {
        if self.weak || free {
            self.link = link;
            self.weak = !firm;
        }
        self.link == link
    }

    /// Makes the host of `link` the active host, because it has reset the machine and so cancelled all work of the
    /// other host. Always returns `true`: the claim succeeds.
    pub fn take_over(&mut self, link: usize) -> bool {
        self.link = link;
        self.weak = false;
        true
    }

    /// Records that the host of `link` has disconnected. If it is the active host, it no longer keeps the other host
    /// out.
    pub fn leave(&mut self, link: usize) {
        self.weak |= self.link == link;
    }
}

impl Default for ActiveHost {
    fn default() -> Self {
        Self::new()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_host_at_a_time_is_active() {
        let mut active = ActiveHost::new();
        assert_eq!(active.link(), 0);
        assert!(active.claim(1, false, true));
        assert!(!active.claim(0, false, true));
        assert_eq!(active.link(), 1);
        // While the machine is idle, any host can become the active one.
        assert!(active.claim(0, true, true));
        assert!(active.claim(0, false, true) && !active.claim(1, false, true));
        active.leave(1);
        assert!(!active.claim(1, false, true));
        active.leave(0);
        assert!(active.claim(1, false, true));
        active.take_over(0);
        assert!(!active.claim(1, false, true));
    }

    #[test]
    fn a_question_keeps_nobody_out() {
        let mut active = ActiveHost::new();
        assert!(active.claim(1, false, true));
        // A realtime command of the active host does not let the other host in.
        assert!(active.claim(1, false, false) && !active.claim(0, false, false));
        active.leave(1);
        assert!(active.claim(0, false, false));
        assert!(active.claim(1, false, true));
        assert!(!active.claim(0, false, true));
    }
}
