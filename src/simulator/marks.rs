//! Which line, and which tool, a move belongs to. The controller gives each move a number on its way through the look-ahead;
//! what the numbers mean is kept here, as long as moves of them may still come.

use std::collections::VecDeque;

/// Numbers that are kept: more than there are lines on their way.
const KEPT: usize = 1 << 16;

/// What a move belongs to.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Mark {
    /// The line, as the controller counts them.
    pub line: u32,
    /// The tool that the spindle holds; 0 for none that M6 named.
    pub tool: u32,
    /// Whether the line is an arc.
    pub arc: bool,
}

/// The marks of the lines that are on their way.
#[derive(Clone, Debug, Default)]
pub struct Marks {
    known: VecDeque<(u32, Mark)>,
    last: u32,
}

impl Marks {
    /// A line begins, or is still in work. The number of its moves, if it is another one than before.
    pub fn begin(&mut self, mark: Mark) -> Option<u32> {
        if self.known.back().is_some_and(|(_, last)| *last == mark) {
            return None;
        }
        self.last = self.last.wrapping_add(1);
        self.known.push_back((self.last, mark));
        if self.known.len() > KEPT {
            self.known.pop_front();
        }
        Some(self.last)
    }

    /// What a number means. Those before it will not be asked for again.
    pub fn of(&mut self, number: u32) -> Mark {
        let Some(at) = self.known.iter().position(|(known, _)| *known == number) else { return Mark::default() };
        self.known.drain(..at);
        self.known.front().map_or_else(Mark::default, |(_, mark)| *mark)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_number_means_its_line_until_a_later_one_comes() {
        let mut marks = Marks::default();
        let mark = |line| Mark { line, tool: 3, arc: false };
        assert_eq!((marks.begin(mark(5)), marks.begin(mark(5)), marks.begin(mark(6))), (Some(1), None, Some(2)));
        assert_eq!((marks.of(0), marks.of(1), marks.of(1), marks.of(2)), (Mark::default(), mark(5), mark(5), mark(6)));
        assert_eq!(marks.of(1), Mark::default());
        for line in 7..200_000 {
            marks.begin(mark(line));
        }
        assert_eq!(marks.known.len(), KEPT);
        assert_eq!(marks.of(marks.last), mark(199_999));
    }
}
