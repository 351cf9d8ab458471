//! A tool change with a tool setter (`$918=2`) as a sequence: retract, go to the change position, wait, measure,
//! return. This module moves nothing itself: it returns one order at a time. The caller carries out the order and then
//! asks for the next one.
//!
//! ```text
//!  height   retract ──▶ to G30 ──▶ prompt ~ ──▶ to the setter       lift ──▶ back ──▶ (spindle on)
//!              ▲                                   │ seek  ▲ pull off ▲         │
//!              │                                   ▼ ──────┘    │     │         ▼ to the same work position
//!  setter    left                                contact        └─ locate
//! ```
//! All moves between positions are at one height: the height of G30, or the height of the tool at the beginning if that
//! is higher. Until the tool has been measured, only probing moves go lower, and at most `$342` below G30. Without a
//! tool (T0) nothing is measured.
//! The first measured tool cannot be compared with an earlier tool, so the height of its tip above the work is not
//! known. That tool stays up, and the program waits for the operator.

use crate::axes::{Axis, PerAxis};
use crate::error::Alarm;
use crate::units::Coordinate;

/// The axis along which the tool moves to the setter, and whose coordinate is measured.
const ALONG: Axis = Axis::Z;
/// After the first contact, the tool is pulled off the setter by this distance, in mm. The second pass goes down to at
/// most this distance below the first contact. A setter can be pressed down further: by about 5 mm.
const PULL_OFF: i32 = 2;

/// Positions of a tool change, in machine coordinates, and its rates in mm/s.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ChangePlan<const N: usize> {
    /// Where the program was interrupted.
    pub left: PerAxis<Coordinate, N>,
    /// Where tools are changed (G30): X and Y, and the minimum height of the moves between positions.
    pub change: PerAxis<Coordinate, N>,
    /// Where the tool setter is (G59.3): X and Y.
    pub setter: PerAxis<Coordinate, N>,
    /// `$342`: how far below the height of G30 a probing move goes to find the setter.
    pub depth: Coordinate,
    /// Rate of the first, fast approach to the setter (`$344`), mm/s.
    pub seek_rate: f32,
    /// Rate of the second, slow approach to the setter (`$343`), mm/s.
    pub locate_rate: f32,
    /// `true` if a new tool is measured; `false` for T0 (no tool).
    pub measures: bool,
}

impl<const N: usize> ChangePlan<N> {
    /// The plan of [`ToolChange::NONE`]: all positions and rates are 0.
    pub const NONE: Self = Self {
        left: PerAxis::all(Coordinate::ZERO),
        change: PerAxis::all(Coordinate::ZERO),
        setter: PerAxis::all(Coordinate::ZERO),
        depth: Coordinate::ZERO,
        seek_rate: 0.0,
        locate_rate: 0.0,
        measures: false,
    };

    /// Returns whether G30 and G59.3 have been stored and `depth` is above 0. A G30 at machine zero counts as not
    /// stored. But it counts as stored with `zero_is_clear`, because homing then ends at machine zero (`$932=1`).
    pub fn is_set_up(&self, zero_is_clear: bool) -> bool {
        let nowhere = PerAxis::all(Coordinate::ZERO);
        (self.change != nowhere || zero_is_clear) && self.setter != nowhere && self.depth > Coordinate::ZERO
    }

    /// Returns the machine coordinate Z of all moves between the work, the change position and the setter.
    pub fn height(&self) -> Coordinate {
        along(&self.change).max(along(&self.left))
    }

    /// Returns the points between which the tool moves. If all of them are within the travel, so are all moves.
    pub fn corners(&self) -> [PerAxis<Coordinate, N>; 4] {
        let at_setter = self.over(&self.setter, self.height());
        let down = self.over(&self.setter, self.lowest());
        [self.over(&self.left, self.height()), self.over(&self.change, self.height()), at_setter, down]
    }

    /// Returns the machine coordinate Z of the lowest point of a probing move. The depth counts from G30, even if the
    /// move starts higher.
    fn lowest(&self) -> Coordinate {
        (along(&self.change) - self.depth).limited()
    }

    /// Returns the position with X and Y of `place`, Z at `height`, and the other axes as in `left`.
    fn over(&self, place: &PerAxis<Coordinate, N>, height: Coordinate) -> PerAxis<Coordinate, N> {
        let mut target = self.left;
        for axis in [Axis::X, Axis::Y] {
            if let Some(coordinate) = place.get(axis) {
                target.set(axis, coordinate);
            }
        }
        target.set(ALONG, height);
        target
    }

    /// Returns the ends of the two moves back to the work: a rapid to `clear` above the work position, then a slow move
    /// to it. `longer`: length of the new tool minus length of the old tool. The second move ends where the new tip is
    /// at the same place as the old tip was.
    fn way_back(&self, longer: Coordinate, clear: Coordinate) -> [PerAxis<Coordinate, N>; 2] {
        let end = (along(&self.left) + longer).limited();
        let above = (end + clear).min(self.height()).max(end);
        [self.over(&self.left, above), self.over(&self.left, end)]
    }
}

fn along<const N: usize>(place: &PerAxis<Coordinate, N>) -> Coordinate {
    place.get(ALONG).unwrap_or(Coordinate::ZERO)
}

/// An action that the caller must carry out for the tool change.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum ChangeOrder<const N: usize> {
    /// A rapid to this machine position.
    Rapid(PerAxis<Coordinate, N>),
    /// A move at a rate in mm/s. Unlike [`ChangeOrder::Probe`], it always reaches its target.
    Move(PerAxis<Coordinate, N>, f32),
    /// A move at a rate in mm/s that ends when the tool touches the setter.
    Probe(PerAxis<Coordinate, N>, f32),
    /// The operator is to change the tool. Continues at the operator's command.
    Prompt,
    /// The new tool has touched the setter at this machine coordinate Z.
    Measured(Coordinate),
    /// The first measured tool is over the position where the program was interrupted. Continues at the operator's
    /// command.
    Confirm,
    /// The tool is above the position where the program was interrupted, and the tool change is complete.
    Done,
    /// The tool change failed, and the machine must be locked with this alarm.
    Failed(Alarm),
}

/// What the machine waits for the operator to do.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ToolWait {
    /// Put the new tool into the spindle.
    Change,
    /// Set the work zero with the new tool, because it is the first one that was measured.
    Confirm,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum ChangePhase {
    Retract,
    ToPlace,
    Prompt,
    ToSetter,
    Seek,
    PullOff,
    Locate,
    Measured,
    Lift,
    Back,
    Confirm,
}

/// A tool change under way.
#[derive(Clone, Copy, Debug)]
pub struct ToolChange<const N: usize> {
    plan: ChangePlan<N>,
    phase: ChangePhase,
    /// Machine coordinate Z at which the tool touched the setter in the first pass.
    touched: Coordinate,
    /// `true` if this tool is the first measured tool.
    is_first: bool,
}

impl<const N: usize> ToolChange<N> {
    /// The value while no tool has to be changed.
    pub const NONE: Self =
        Self { plan: ChangePlan::NONE, phase: ChangePhase::Back, touched: Coordinate::ZERO, is_first: false };

    /// Returns a tool change that has not started. [`ToolChange::begin`] returns its first order.
    pub fn new(plan: ChangePlan<N>) -> Self {
        Self { plan, ..Self::NONE }
    }

    /// Marks the tool as the first measured tool, which stays up and waits for the operator. Called after the order
    /// [`ChangeOrder::Measured`].
    pub fn mark_first_tool(&mut self) {
        self.is_first = true;
    }

    /// Returns the ends of the two moves down to the work (see `ChangePlan::way_back`). The first measured tool stays
    /// up, so for it both ends are at [`ChangePlan::height`].
    pub fn way_back(&self, longer: Coordinate, clear: Coordinate) -> [PerAxis<Coordinate, N>; 2] {
        match self.is_first {
            true => [self.plan.over(&self.plan.left, self.plan.height()); 2],
            false => self.plan.way_back(longer, clear),
        }
    }

    /// Starts the tool change. Returns the first order, which retracts the tool.
    pub fn begin(&mut self) -> ChangeOrder<N> {
        self.phase = ChangePhase::Retract;
        ChangeOrder::Rapid(self.plan.over(&self.plan.left, self.plan.height()))
    }

    /// Returns whether the last order was a probing move.
    pub fn is_probing(&self) -> bool {
        matches!(self.phase, ChangePhase::Seek | ChangePhase::Locate)
    }

    /// Returns what the operator has to do; `None` if the tool change does not wait for the operator.
    pub fn waits_for(&self) -> Option<ToolWait> {
        match self.phase {
            ChangePhase::Prompt => Some(ToolWait::Change),
            ChangePhase::Confirm => Some(ToolWait::Confirm),
            _ => None,
        }
    }

    /// Returns the next order. Call it when the previous order has been carried out. `contact`: where a probing move
    /// touched the setter; `None` if it did not touch, or if the order was not a probing move.
    pub fn next(&mut self, contact: Option<PerAxis<Coordinate, N>>) -> ChangeOrder<N> {
        let plan = &self.plan;
        let height = plan.height();
        let (phase, order) = match (self.phase, contact) {
            (ChangePhase::Retract, _) => (ChangePhase::ToPlace, ChangeOrder::Rapid(plan.over(&plan.change, height))),
            (ChangePhase::ToPlace, _) => (ChangePhase::Prompt, ChangeOrder::Prompt),
            (ChangePhase::Prompt, _) if plan.measures => {
                (ChangePhase::ToSetter, ChangeOrder::Rapid(plan.over(&plan.setter, height)))
            }
            (ChangePhase::ToSetter, _) => {
                (ChangePhase::Seek, ChangeOrder::Probe(plan.over(&plan.setter, plan.lowest()), plan.seek_rate))
            }
            (ChangePhase::Seek | ChangePhase::Locate, None) => return ChangeOrder::Failed(Alarm::ProbeNoContact),
            (ChangePhase::Seek, Some(contact)) => {
                self.touched = along(&contact);
                let above = (self.touched + Coordinate::mm(PULL_OFF)).min(height);
                (ChangePhase::PullOff, ChangeOrder::Move(plan.over(&plan.setter, above), plan.seek_rate))
            }
            (ChangePhase::PullOff, _) => {
                let below = (self.touched - Coordinate::mm(PULL_OFF)).max(plan.lowest());
                (ChangePhase::Locate, ChangeOrder::Probe(plan.over(&plan.setter, below), plan.locate_rate))
            }
            (ChangePhase::Locate, Some(contact)) => (ChangePhase::Measured, ChangeOrder::Measured(along(&contact))),
            (ChangePhase::Measured, _) => (ChangePhase::Lift, ChangeOrder::Rapid(plan.over(&plan.setter, height))),
            (ChangePhase::Prompt | ChangePhase::Lift, _) => {
                (ChangePhase::Back, ChangeOrder::Rapid(plan.over(&plan.left, height)))
            }
            (ChangePhase::Back, _) if self.is_first => (ChangePhase::Confirm, ChangeOrder::Confirm),
            (ChangePhase::Back | ChangePhase::Confirm, _) => return ChangeOrder::Done,
        };
        self.phase = phase;
        order
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(x: i32, y: i32, z: i32) -> PerAxis<Coordinate, 3> {
        PerAxis([Coordinate::mm(x), Coordinate::mm(y), Coordinate::mm(z)])
    }

    fn plan() -> ChangePlan<3> {
        ChangePlan {
            left: at(-50, -60, -40),
            change: at(-1, -2, -10),
            setter: at(-7, -8, -99),
            depth: Coordinate::mm(30),
            seek_rate: 4.0,
            locate_rate: 0.5,
            measures: true,
        }
    }

    #[test]
    fn the_whole_change() {
        let mut change = ToolChange::new(plan());
        assert_eq!(change.begin(), ChangeOrder::Rapid(at(-50, -60, -10)));
        assert_eq!(change.next(None), ChangeOrder::Rapid(at(-1, -2, -10)));
        assert_eq!(change.next(None), ChangeOrder::Prompt);
        assert_eq!(change.next(None), ChangeOrder::Rapid(at(-7, -8, -10)));
        assert!(!change.is_probing());
        assert_eq!(change.next(None), ChangeOrder::Probe(at(-7, -8, -40), 4.0));
        assert!(change.is_probing());
        assert_eq!(change.next(Some(at(-7, -8, -35))), ChangeOrder::Move(at(-7, -8, -33), 4.0));
        assert_eq!(change.next(None), ChangeOrder::Probe(at(-7, -8, -37), 0.5));
        assert_eq!(change.next(Some(at(-7, -8, -36))), ChangeOrder::Measured(Coordinate::mm(-36)));
        assert_eq!(change.next(None), ChangeOrder::Rapid(at(-7, -8, -10)));
        assert_eq!(change.next(None), ChangeOrder::Rapid(at(-50, -60, -10)));
        assert_eq!(change.next(None), ChangeOrder::Done);
    }

    #[test]
    fn nothing_but_a_probing_move_goes_down_and_none_too_far() {
        let mut change = ToolChange::new(plan());
        let mut order = change.begin();
        // In this test, the tool touches the setter only at the end of the first pass.
        let lowest = Coordinate::mm(-40);
        while order != ChangeOrder::Done {
            match order {
                ChangeOrder::Rapid(target) => assert_eq!(along(&target), Coordinate::mm(-10)),
                ChangeOrder::Probe(target, _) => assert!(along(&target) >= lowest),
                ChangeOrder::Move(target, _) => assert!(along(&target) > lowest),
                _ => {}
            }
            let contact = change.is_probing().then(|| at(-7, -8, -40));
            order = change.next(contact);
        }
    }

    #[test]
    fn a_setter_that_is_not_there_fails_either_pass() {
        let mut change = ToolChange::new(plan());
        change.begin();
        (0..4).for_each(|_| assert!(!matches!(change.next(None), ChangeOrder::Failed(_))));
        let mut second = change;
        assert_eq!(change.next(None), ChangeOrder::Failed(Alarm::ProbeNoContact));
        second.next(Some(at(-7, -8, -35)));
        second.next(None);
        assert_eq!(second.next(None), ChangeOrder::Failed(Alarm::ProbeNoContact));
    }

    #[test]
    fn no_tool_is_not_measured() {
        let mut change = ToolChange::new(ChangePlan { measures: false, ..plan() });
        change.begin();
        change.next(None);
        assert_eq!(change.next(None), ChangeOrder::Prompt);
        assert_eq!(change.next(None), ChangeOrder::Rapid(at(-50, -60, -10)));
        assert_eq!(change.next(None), ChangeOrder::Done);
    }

    #[test]
    fn the_first_tool_stays_up_and_waits() {
        let mut change = ToolChange::new(plan());
        change.begin();
        while !matches!(change.next(Some(at(-7, -8, -35))), ChangeOrder::Measured(_)) {}
        change.mark_first_tool();
        change.next(None);
        change.next(None);
        assert_eq!(change.next(None), ChangeOrder::Confirm);
        assert_eq!(change.next(None), ChangeOrder::Done);
        assert_eq!(change.way_back(Coordinate::ZERO, Coordinate::mm(5)), [at(-50, -60, -10); 2]);
    }

    #[test]
    fn a_tool_above_the_height_stays_there() {
        let mut change = ToolChange::new(ChangePlan { left: at(-50, -60, -3), ..plan() });
        assert_eq!(change.begin(), ChangeOrder::Rapid(at(-50, -60, -3)));
        assert_eq!(change.next(None), ChangeOrder::Rapid(at(-1, -2, -3)));
        assert_eq!(change.plan.corners()[3], at(-7, -8, -40), "looked for as far down as by any other");
    }

    #[test]
    fn the_way_back_ends_slowly_and_at_the_same_work_place() {
        let back = |longer, clear| plan().way_back(Coordinate::mm(longer), Coordinate::mm(clear));
        assert_eq!(back(0, 5), [at(-50, -60, -35), at(-50, -60, -40)]);
        assert_eq!(back(7, 5), [at(-50, -60, -28), at(-50, -60, -33)], "a longer tool stays higher");
        assert_eq!(back(-7, 99), [at(-50, -60, -10), at(-50, -60, -47)]);
        assert_eq!(back(35, 5), [at(-50, -60, -5), at(-50, -60, -5)], "up, if it has to");
    }

    #[test]
    fn what_is_not_set_up_is_seen() {
        assert!(plan().is_set_up(false));
        assert!(ChangePlan { change: at(0, 0, 0), ..plan() }.is_set_up(true));
        assert!(!ChangePlan { setter: at(0, 0, 0), ..plan() }.is_set_up(true));
        for wrong in [
            ChangePlan { change: at(0, 0, 0), ..plan() },
            ChangePlan { setter: at(0, 0, 0), ..plan() },
            ChangePlan { depth: Coordinate::ZERO, ..plan() },
        ] {
            assert!(!wrong.is_set_up(false));
        }
    }
}
