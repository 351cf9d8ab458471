//! `Begins`: the moments at which segments begin whose first events are ahead and not out yet. `push` keeps one,
//! `pass` lets go of those that have begun by `now`, `put_off` moves all when the motion begins later, `clear` forgets
//! them. The step task counts its begun segments without those (`len`), and makes no more when `is_full`.

/// Segments that can begin in events that are ahead, and changes of power.
pub const MARKS: usize = 32;

/// Moments at which segments begin that are not out yet. Those that are ahead when a motion is put out from rest are not among them:
/// they count as begun at once, so that `control` prepares what follows them in time. A plain ring: less code than a deque.
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

    /// What has begun by now is no longer ahead.
    #[inline(always)]
    pub fn pass(&mut self, now: u32) {
        while self.len > 0
            && self.moments.get(self.first % MARKS).is_some_and(|moment| moment.wrapping_sub(now) as i32 <= 0)
        {
            self.first = self.first.wrapping_add(1);
            self.len -= 1;
        }
    }

    pub fn put_off(&mut self, by: u32) {
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
