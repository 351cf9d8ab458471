//! Finds the line and the tool of a move. The controller gives each move a number. The table in this file stores line
//! and tool for each number, as long as moves with that number can still come.

use std::collections::VecDeque;

/// If the table has more entries than this, entries without a queued move are removed. The look-ahead holds fewer
/// moves than this, so entries are rarely removed.
const KEPT: usize = 1 << 12;

/// The line, the tool and further properties of a move.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Mark {
    /// The line number, as the controller counts lines.
    pub line: u32,
    /// The tool in the spindle; 0 if no M6 has named one.
    pub tool: u32,
    /// Whether the line is an arc.
    pub arc: bool,
    /// The spindle speed S of the line, rounded; 0 while the spindle is off.
    pub speed: u32,
}

/// The table: a [`Mark`] for each move number that can still come.
#[derive(Clone, Debug, Default)]
pub struct Marks {
    known: VecDeque<(u32, Mark)>,
    last: u32,
}

impl Marks {
    /// Enters the `mark` of the line that the controller now executes. Returns the number for the moves of this line.
    /// Returns `None` if the mark equals the previous one, because the previous number then stays in use.
    ///
    /// `queued`: returns the numbers of the moves in the look-ahead. It is called if the table has more than `KEPT`
    /// entries, because lines without moves could fill the table without limit. Then only the entries of queued moves
    /// and the new entry stay.
    pub fn begin(&mut self, mark: Mark, queued: impl FnOnce() -> Vec<u32>) -> Option<u32> {
        if self.known.back().is_some_and(|(_, last)| *last == mark) {
            return None;
        }
        self.last = self.last.wrapping_add(1);
        self.known.push_back((self.last, mark));
        if self.known.len() > KEPT {
            let (queued, last) = (queued(), self.last);
            self.known.retain(|(number, _)| *number == last || queued.contains(number));
        }
        Some(self.last)
    }

    /// Returns the mark of the moves with this number; the default if the number is not in the table. Removes all
    /// earlier entries, because moves come in the order of their numbers.
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
        let mark = |line| Mark { line, tool: 3, arc: false, speed: 0 };
        let begin = |marks: &mut Marks, line| marks.begin(mark(line), || vec![2, 3]);
        let numbers = [5, 5, 6, 7].map(|line| begin(&mut marks, line));
        assert_eq!(numbers, [Some(1), None, Some(2), Some(3)]);
        assert_eq!([0, 1, 1, 2].map(|number| marks.of(number)), [Mark::default(), mark(5), mark(5), mark(6)]);
        assert_eq!(marks.of(1), Mark::default());
        for line in 8..200_000 {
            begin(&mut marks, line);
            assert!(marks.known.len() <= KEPT + 1);
        }
        assert_eq!([2, 3].map(|number| marks.of(number)), [mark(6), mark(7)], "those of queued moves");
        assert_eq!(marks.of(marks.last), mark(199_999));
    }
}
