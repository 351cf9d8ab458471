//! Start times of segments whose first events are generated but not output yet ([`Begins`]). The step task does not
//! count these segments as begun. While this ring is full, the step task generates no more events.

/// Capacity of the ring of segment starts, and of the queue of changes of power (`beam`).
pub const MARKS: usize = 32;

/// Ring of the start times of segments that have not begun. When the output starts from rest, the ring is emptied: the
/// segments generated until then count as begun at once, so that `control` prepares the next ones in time. A plain ring
/// needs less code than a deque.
pub struct Begins {
    moments: [u32; MARKS],
    first: usize,
    len: usize,
}

impl Begins {
    pub fn new() -> Begins {
        Begins { moments: [0; MARKS], first: 0, len: 0 }
    }

    pub fn push(&mut self, moment: u32) {
        if self.len < MARKS
            && let Some(place) = self.moments.get_mut(self.first.wrapping_add(self.len) % MARKS)
        {
            *place = moment;
            self.len += 1;
        }
    }

    /// Removes the segments that have begun by the time `now`.
    #[inline(always)]
    pub fn pass(&mut self, now: u32) {
        while self.len > 0
            && self.moments.get(self.first % MARKS).is_some_and(|moment| moment.wrapping_sub(now) as i32 <= 0)
        {
            self.first = self.first.wrapping_add(1);
            self.len -= 1;
        }
    }

    /// Delays all start times by `by` ticks.
    pub fn delay(&mut self, by: u32) {
        for moment in &mut self.moments {
            *moment = moment.wrapping_add(by);
        }
    }

    pub fn clear(&mut self) {
        self.len = 0;
    }

    #[inline(always)]
    pub fn len(&self) -> u32 {
        self.len as u32
    }

    pub fn is_full(&self) -> bool {
        self.len == MARKS
    }
}
