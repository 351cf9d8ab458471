//! Turns a move into a block at the end of the queue. Computes the block's steps of each motor, its length, speed,
//! acceleration and jerk, and the speed at the corner before it. Divides a move with too many steps for one block, and
//! adds steps for backlash compensation.

use super::arc::Curvature;
use super::axis_limits::{GREATEST_ACCELERATION, shares};
use super::backlash::{self, Motors};
use super::block::{Block, CurveLoad, MAX_STEPS, NO_OVERRIDE, RAPID, SCALE_POWER};
use super::carried_time::BlockWay;
use super::curvature::{EntryLimit, NOTICEABLE, PathPiece, Span};
use super::junction::UNLIMITED2;
use super::measure::{Measure, signed_add};
use super::path_end::way_mm;
use super::queue::{LongMove, MOST_BACKLASH, MOST_BLOCKS_OF_A_MOVE, MoveQueue};
use super::trapezoid::{greater, lesser, square_root};
use super::{Move, Speed};
use crate::axes::{Axis, PerAxis};
use crate::messages::AxisSteps;
use crate::units::Coordinate;

/// Maximum feed override for which bends are determined, as a factor. Realtime commands cannot exceed it.
const MOST_OVERRIDE: f32 = 2.0;

/// Returns the steps of a chord with its exact ends, which can lie between two steps. `ends`: offsets of the exact
/// start and end from the steps nearest to them, in sevenths of a step along the positive axes. A chord with more than
/// `Measure::MOST_STEPS` steps begins and ends on full steps, because parts of a step do not matter in it.
fn steps_with_ends<const N: usize>(steps: &[u32; N], directions: u8, ends: &[[i32; N]; 2]) -> [AxisSteps; N] {
    let mut steps_by_axis = steps.map(AxisSteps::on_steps);
    if steps.iter().all(|steps| *steps <= Measure::MOST_STEPS) {
        let [starts, ends] = ends;
        for (bit, (axis_steps, (start, end))) in steps_by_axis.iter_mut().zip(starts.iter().zip(ends)).enumerate() {
            let sign = if directions >> bit & 1 != 0 { -1 } else { 1 };
            *axis_steps = AxisSteps::with_ends(axis_steps.steps(), sign * start, sign * end);
        }
    }
    steps_by_axis
}

fn signed_steps<const N: usize>(steps: &[u32; N], directions: u8) -> [i32; N] {
    let mut signed = [0; N];
    for (bit, (signed, steps)) in signed.iter_mut().zip(steps).enumerate() {
        *signed = signed_add(0, *steps, directions >> bit & 1 != 0);
    }
    signed
}

fn unsigned_steps<const N: usize>(signed: &[i32; N]) -> ([u32; N], u8) {
    let mut directions = 0;
    for (bit, steps) in signed.iter().enumerate() {
        directions |= u8::from(*steps < 0) << bit;
    }
    (signed.map(i32::unsigned_abs), directions)
}

/// The path from the end of the last block to the target of a move.
struct Path<const N: usize> {
    /// Displacement of each axis, mm.
    way: PerAxis<f32, N>,
    /// Length of the straight line, mm.
    straight: f32,
    /// Length of the move alone, mm.
    own: f32,
    /// Length of the path, mm: `own`, plus the length of preceding moves that were too short for a step, minus the
    /// excess length of the last block. (A block is lengthened if its move is too short for its steps.)
    length: f32,
}

impl<const N: usize> Path<N> {
    /// Returns `true` if moves without a step have led away and back: the path is longer than the straight line by
    /// more than 10 %, and by more than two steps of `step_mm`, mm.
    #[inline]
    fn leads_nowhere(&self, step_mm: f32) -> bool {
        self.length > 1.1 * self.straight && self.length - self.straight > 2.0 * step_mm
    }
}

struct MotorSteps<const N: usize> {
    steps: [u32; N],
    /// One bit per motor, set for the negative direction.
    directions: u8,
}

#[derive(Clone, Copy)]
struct StepSizes {
    /// Number of steps of the dominant motor.
    dominant: u32,
    /// Minimum length of the block, mm. Each motor needs the distance of its steps, less half a step; the longest of
    /// these distances counts.
    least_mm: f32,
    /// Size of a step of the coarsest motor that moves, mm.
    coarsest_mm: f32,
}

impl<const N: usize> MoveQueue<N> {
    /// Queues a move. Returns `false`, with nothing done, if there is no room. A move too short for a step makes no
    /// block; its length is carried over to the next block.
    pub(super) fn line(&mut self, m: &Move<N>) -> bool {
        self.queue(m, UNLIMITED2, false)
    }

    /// Queues a chord of a curve in the same way as [`MoveQueue::line`] queues a move. The chord is at most as fast as
    /// the curve allows. Its steps follow its exact ends instead of the full steps nearest to them.
    pub(super) fn chord(&mut self, m: &Move<N>, curvature: Curvature) -> bool {
        let mut acceleration = GREATEST_ACCELERATION;
        for (axis, most) in Axis::of_machine::<N>().zip(self.limits.turns.acceleration) {
            if curvature.axes.contains(&axis) {
                acceleration = lesser(acceleration, most);
            }
        }
        acceleration *= self.limits.turns.curve_share;
        self.queue(m, acceleration * curvature.radius, true)
    }

    fn queue(&mut self, m: &Move<N>, curve_speed2: f32, chord: bool) -> bool {
        if self.free_blocks() == 0 {
            return false;
        }
        self.put(m, curve_speed2, chord);
        true
    }

    /// Queues a move; there must be room. `curve_speed2`: maximum speed² on the curve of a chord. `chord`: `true` for
    /// a chord whose steps follow its exact ends, `false` for a move that begins and ends on full steps.
    #[inline]
    pub(super) fn put(&mut self, m: &Move<N>, curve_speed2: f32, chord: bool) {
        if self.backlash.is_on()
            && let Speed::Duration(seconds) = m.speed
        {
            return self.put_timed(m, seconds, curve_speed2, chord);
        }
        // A probing move must not be divided, because it brakes within its own block. Probing moves ignore overrides,
        // so moves that ignore overrides are not divided.
        if self.backlash.is_on() && !m.no_feed_override {
            if !chord {
                self.take_up_before_plunge(m);
            }
            self.begin_taking_up(m, curve_speed2, chord);
        }
        let steps = self.kinematics.steps_from(&self.end.planned, &self.end.planned_steps, &m.target);
        let mut most = 0;
        for (new, old) in steps.iter().zip(self.end.planned_steps.iter()) {
            most = most.max(new.abs_diff(*old));
        }
        if most < MAX_STEPS {
            self.append(m, &steps, curve_speed2, chord);
            return;
        }
        let mut whole = *m;
        if let Speed::Duration(seconds) = m.speed {
            whole.speed = Speed::Feed(self.end.distance(&m.target) / seconds);
        }
        // The division rounds down, so one piece is added. Each piece then has fewer than half of the maximum number
        // of steps, apart from one step that rounding can add.
        let pieces = most / (MAX_STEPS / 2) + 1;
        self.long = Some(LongMove { start: self.end.planned, whole, curve_speed2, pieces, next: 1 });
        self.continue_long_move();
    }

    /// Queues a move with a duration as a feed move. Reason: the duration applies to the whole move, but backlash
    /// compensation can divide the move.
    // Not inlined, so that only a move with a duration is copied.
    #[inline(never)]
    fn put_timed(&mut self, m: &Move<N>, seconds: f32, curve_speed2: f32, chord: bool) {
        let speed = Speed::Feed(self.end.distance(&m.target) / seconds);
        self.queue(&Move { speed, ..*m }, curve_speed2, chord);
    }

    /// Returns whether the queue has a look-ahead. A queue for a few moves, each from rest to rest, needs neither the
    /// rule for turns nor joins.
    #[inline]
    fn looks_ahead(&self) -> bool {
        self.planner.capacity() > 2
    }

    #[inline]
    pub(super) fn continue_long_move(&mut self) {
        if self.long.is_some() {
            self.cut_long_move();
        }
    }

    #[inline(never)]
    fn cut_long_move(&mut self) {
        while let Some(mut long) = self.long {
            if self.planner.free() == 0 {
                return;
            }
            let mut piece = long.whole;
            if long.next < long.pieces {
                let (part, parts) = (i64::from(long.next), i64::from(long.pieces));
                piece.target = long.start.zip(&long.whole.target, |a, b| Coordinate(a.0 + (b.0 - a.0) * part / parts));
                long.next += 1;
                self.long = Some(long);
            } else {
                self.long = None;
            }
            let steps = self.kinematics.steps(&piece.target);
            // `false`, because a piece has too many steps for exact ends (`steps_with_ends`).
            self.append(&piece, &steps, long.curve_speed2, false);
        }
    }

    /// Makes a block of a move, which must have fewer than [`MAX_STEPS`] steps; there must be room. `curve_speed2`:
    /// maximum speed² on the curve of a chord.
    fn append(&mut self, m: &Move<N>, target_steps: &PerAxis<i32, N>, curve_speed2: f32, chord: bool) {
        let least_entry2 =
            if self.looks_ahead() { self.join(m, target_steps, curve_speed2 >= UNLIMITED2 && !chord) } else { 0.0 };
        let ends = self.true_ends(&m.target, target_steps, chord);
        let mut path = self.path_to(&m.target);
        self.end.planned = m.target;
        let (mut motors, sizes) = self.steps_to(target_steps);
        if sizes.dominant == 0 {
            self.carried_time.add(m.speed, path.own, self.end.length_carry);
            self.end.length_carry = path.length;
            self.end.is_past_block = true;
            return;
        }
        // Rounding can turn a move of 0.1 nm into a whole step. In the time for the programmed length, that step would
        // be far too fast. So this block counts as longer, and the next one as shorter by the same amount.
        let length = greater(path.length, sizes.least_mm);
        let speed = if path.own == length { m.speed } else { self.carry_over(m, &path, length, sizes.least_mm) };
        let start = core::mem::replace(&mut self.end.block_end, m.target);
        self.end.planned_steps = *target_steps;
        self.end.is_past_block = false;

        let unit = if path.straight > 0.0 { path.way.0.map(|part| part / path.straight) } else { self.end.direction };
        let line_number = self.number_of(m);
        let mut block = Block::<N> { length, line_number, power: m.power, ..Block::EMPTY };
        // If the block was made longer than its move (see above), its displacement is that of its steps, not the
        // programmed one.
        if path.length < length {
            path.way = self.way_of_steps(&motors, length, &path.way);
        }
        let is_straight = path.straight == length && path.length == length;
        let shares = if is_straight { unit.map(f32::abs) } else { shares(&path.way, length) };
        let rapid = self.set_speeds(&mut block, speed, &path, &shares, &mut motors, curve_speed2);
        block.flags = rapid
            | if m.no_feed_override { NO_OVERRIDE } else { 0 }
            | if m.scale_power { SCALE_POWER } else { 0 }
            | self.marked;
        block.directions = motors.directions;
        block.steps_by_axis = match ends {
            Some(ends) => steps_with_ends(&motors.steps, motors.directions, &ends),
            None => motors.steps.map(AxisSteps::on_steps),
        };
        let fastest = lesser(block.limit, block.programmed * MOST_OVERRIDE);
        let piece = PathPiece {
            start: &start,
            end: &m.target,
            direction: &unit,
            length: path.straight,
            path: length,
            fast2: fastest * fastest,
            digit: self.chain.last_digit(m.digit),
        };
        let span = Span::of(&piece);
        block.corner2 = greater(self.entry_corner2(&piece, &span, &path, sizes.coarsest_mm), least_entry2);
        self.end.direction = unit;
        if curve_speed2 < NOTICEABLE * piece.fast2 {
            block.curve = CurveLoad::new(curve_speed2, self.limits.least_acceleration(&shares));
        }
        self.push(block, &piece, span);
    }

    /// Returns the speed of a block whose `length`, mm, differs from the length of its move. If the block is longer,
    /// carries the excess over to the next block as a negative length, at most `most` mm.
    #[cold]
    #[inline(never)]
    fn carry_over(&mut self, m: &Move<N>, path: &Path<N>, length: f32, most: f32) -> Speed {
        let carried = core::mem::replace(&mut self.end.length_carry, greater(path.length - length, -most));
        let speed = self.carried_time.take(m.speed, BlockWay { own: path.own, carried, length });
        if speed != m.speed {
            self.join.close();
        }
        speed
    }

    /// Sets programmed speed, speed limit, acceleration and jerk of a block. `moved`: displacement of each axis as a
    /// share of the block's length. With backlash compensation, can add steps to `motors`. Returns the flag `RAPID`
    /// for a rapid, otherwise 0.
    #[inline]
    fn set_speeds(
        &mut self,
        block: &mut Block<N>,
        speed: Speed,
        path: &Path<N>,
        moved: &[f32; N],
        motors: &mut MotorSteps<N>,
        curve_speed2: f32,
    ) -> u8 {
        let length = block.length;
        let (mut acceleration, mut limit) = self.limits.along_shares(moved);
        block.jerk = self.limits.jerk_along(moved, acceleration);
        let (programmed, rapid) = match speed {
            Speed::Rapid => (limit, RAPID),
            Speed::Feed(feed) => (feed, 0),
            Speed::Duration(seconds) => (length / seconds, 0),
        };
        if self.backlash.is_on() {
            let speed = lesser(programmed, limit);
            if let Some(way) = self.take_up(motors, &path.way, length, acceleration, speed) {
                let moved = shares(&way, length);
                (acceleration, limit) = self.limits.along_shares(&moved);
                block.jerk = self.limits.jerk_along(&moved, acceleration);
                self.join.close();
            }
        }
        block.acceleration = acceleration;
        block.programmed = self.limits.feed(programmed);
        block.limit = if curve_speed2 < limit * limit { square_root(curve_speed2) } else { limit };
        rapid
    }

    /// Returns the maximum speed² at the corner before a piece of the path. `coarsest_mm`: step size of the coarsest
    /// motor, mm. Moves without a step can go to and fro before a block ([`Path::leads_nowhere`]). The block then
    /// includes their time, and the corners before and after it are at most as fast as a square corner.
    #[inline]
    fn entry_corner2(&mut self, piece: &PathPiece<'_, N>, span: &Span<N>, path: &Path<N>, coarsest_mm: f32) -> f32 {
        if self.end.motors_only {
            self.chain.restart(piece.start);
        }
        let mut corner2 = self.chain.corner2(span, &self.limits.turns);
        let waits = path.leads_nowhere(coarsest_mm);
        if waits || self.end.had_stepless_moves {
            corner2 = lesser(corner2, self.limits.turns.square_corner2());
            self.join.close();
        }
        self.end.had_stepless_moves = waits;
        if core::mem::take(&mut self.end.motors_only) { 0.0 } else { corner2 }
    }

    /// Queues a block, limits the blocks on any bend that its piece of the path completes, and plans.
    #[inline]
    fn push(&mut self, block: Block<N>, piece: &PathPiece<'_, N>, span: Span<N>) {
        self.planner.push(block, self.overrides);
        if self.looks_ahead() && !self.join.keeps(piece) {
            let planner = &mut self.planner;
            let limit = EntryLimit::of(planner.last());
            self.chain.extend(piece, limit, span, &self.limits.turns, &mut |bend| planner.limit(&bend));
        }
        self.planner.plan();
    }

    /// Returns displacements and lengths of the path from the end of the last block to a target.
    #[inline]
    fn path_to(&self, target: &PerAxis<Coordinate, N>) -> Path<N> {
        let way = target.zip(&self.end.block_end, way_mm);
        let mut square = 0.0;
        for part in way.iter() {
            square += part * part;
        }
        let straight = square_root(square);
        let own = if self.end.is_past_block { self.end.distance(target) } else { straight };
        Path { way, straight, own, length: own + self.end.length_carry }
    }

    /// Returns the steps that the motors must make from the end of the last block to `target_steps`. Also returns the
    /// sizes that follow from these steps.
    #[inline]
    fn steps_to(&self, target_steps: &PerAxis<i32, N>) -> (MotorSteps<N>, StepSizes) {
        let mut motors = MotorSteps { steps: [0; N], directions: 0 };
        let mut sizes = StepSizes { dominant: 0, least_mm: 0.0, coarsest_mm: 0.0 };
        let places = target_steps.iter().zip(self.end.planned_steps.iter());
        let axes = motors.steps.iter_mut().zip(&self.kinematics.least_mm);
        for (bit, ((to, from), (steps, mm))) in places.zip(axes).enumerate() {
            *steps = to.abs_diff(*from);
            if to < from {
                motors.directions |= 1 << bit;
            }
            if *steps > 0 {
                sizes.least_mm = greater((*steps as f32 - 0.5) * mm, sizes.least_mm);
                sizes.coarsest_mm = greater(*mm, sizes.coarsest_mm);
            }
            sizes.dominant = sizes.dominant.max(*steps);
        }
        (motors, sizes)
    }

    /// Returns the displacement of each axis, mm. It is computed from the motors' steps, and scaled so that the path
    /// has the length `length`. If an axis' programmed displacement (`way`) is larger, it is returned for this axis.
    #[cold]
    fn way_of_steps(&self, motors: &MotorSteps<N>, length: f32, way: &PerAxis<f32, N>) -> PerAxis<f32, N> {
        let stepped = self.kinematics.way_of_axes(&signed_steps(&motors.steps, motors.directions));
        let share = length / square_root(stepped.iter().fold(0.0, |sum, part| sum + part * part));
        way.zip(
            &PerAxis(stepped),
            |way, stepped| if way.abs() > (stepped * share).abs() { way } else { stepped * share },
        )
    }

    /// For a chord, returns how far its exact start and end are from the steps nearest to them, in sevenths of a step.
    /// Returns `None` for other moves, which begin and end on full steps.
    #[inline]
    fn true_ends(
        &mut self,
        target: &PerAxis<Coordinate, N>,
        target_steps: &PerAxis<i32, N>,
        chord: bool,
    ) -> Option<[[i32; N]; 2]> {
        let start = self.substep_offset.take();
        if !chord {
            return None;
        }
        let start =
            start.unwrap_or_else(|| self.kinematics.sevenths_beyond(&self.end.planned, &self.end.planned_steps));
        let end = self.kinematics.sevenths_beyond(target, target_steps);
        self.substep_offset = Some(end);
        Some([start, end])
    }

    /// Divides a move that reverses a motor, if backlash compensation needs less than two thirds of the move. Queues
    /// the part that compensation needs as a block of its own; the caller queues the rest of the move.
    #[inline(never)]
    fn begin_taking_up(&mut self, m: &Move<N>, curve_speed2: f32, chord: bool) {
        let steps = self.kinematics.steps(&m.target);
        let moved = steps.zip(&self.end.planned_steps, i32::wrapping_sub);
        let mut after = self.backlash;
        after.turn(&moved.0);
        if !after.is_outstanding() || moved.iter().all(|steps| *steps == 0) {
            return;
        }
        let distance = self.end.distance(&m.target);
        let way = m.target.zip(&self.end.planned, |to, from| (to - from).to_mm());
        let (acceleration, limit) = self.limits.along(&way, distance);
        let feed = match m.speed {
            Speed::Rapid => limit,
            Speed::Feed(feed) => feed,
            Speed::Duration(seconds) => distance / seconds,
        };
        let rooms = self.rooms_for_backlash(distance, acceleration, lesser(feed, limit));
        let mut needed = 0.0;
        for (steps, room) in after.outstanding().iter().zip(rooms) {
            needed = greater(needed, steps.unsigned_abs() as f32 / room * distance);
        }
        if needed * 1.5 < distance {
            let part = (needed / distance * 65_536.0) as i64 + 1;
            let speed = if m.speed == Speed::Rapid { m.speed } else { Speed::Feed(feed) };
            let target = self.end.planned.zip(&m.target, |a, b| Coordinate(a.0 + (b.0 - a.0) * part / 65_536));
            let steps = self.kinematics.steps(&target);
            let most = steps.iter().zip(self.end.planned_steps.iter()).map(|(to, from)| to.abs_diff(*from)).max();
            if most.is_some_and(|most| most < MAX_STEPS) {
                self.append(&Move { target, speed, ..*m }, &steps, curve_speed2, chord);
            }
        }
    }

    /// Returns how many steps of backlash compensation each motor can make in addition to the steps of a move. This
    /// number follows from the corner rule ([`backlash::share`]). The rule uses the lower one of two accelerations:
    /// `acceleration`, and the acceleration along the direction in which the motor moves the tool.
    fn rooms_for_backlash(&self, length: f32, acceleration: f32, speed: f32) -> [f32; N] {
        let mut rooms = self.kinematics.least_mm;
        for (motor, room) in rooms.iter_mut().enumerate() {
            let mut one = [0; N];
            one.iter_mut().skip(motor).take(1).for_each(|step| *step = 1);
            let (own, _) = self.limits.along(&PerAxis(self.kinematics.way_of_axes(&one)), *room);
            *room = backlash::share(lesser(own, acceleration), self.limits.turns.deviation, speed) * length / *room;
        }
        rooms
    }

    /// Adds backlash compensation to a block's steps. Returns the displacement of the motors with these steps,
    /// converted to axes, mm; `None` if no steps were to be added.
    #[inline(never)]
    fn take_up(
        &mut self,
        motors: &mut MotorSteps<N>,
        way: &PerAxis<f32, N>,
        length: f32,
        acceleration: f32,
        speed: f32,
    ) -> Option<PerAxis<f32, N>> {
        let mut moved = signed_steps(&motors.steps, motors.directions);
        self.backlash.turn(&moved);
        if !self.backlash.is_outstanding() {
            return None;
        }
        let rooms = self.rooms_for_backlash(length, acceleration, speed);
        let mut most = rooms.map(|room| (room as i32).clamp(1, MOST_BACKLASH));
        for (most, moved) in most.iter_mut().zip(moved) {
            *most = (*most).min(MAX_STEPS as i32 - 1 - moved.abs()).max(0);
        }
        let taken = self.backlash.take_up(&most);
        for (moved, taken) in moved.iter_mut().zip(taken) {
            *moved += taken;
        }
        (motors.steps, motors.directions) = unsigned_steps(&moved);
        let extra = self.kinematics.way_of_axes(&taken);
        Some(way.zip(&PerAxis(extra), |way, extra| way + extra))
    }

    /// Completes the backlash compensation at the end of the queue. `motors`: position of the motors there. If the
    /// last moves were too short for all the extra steps, queues the remaining ones as a separate block from rest to
    /// rest. This block moves the tool only if the tool has not reached its programmed position yet.
    #[inline(never)]
    pub(super) fn finish_taking_up(&mut self, motors: &Motors<N>, line_number: u32) {
        let taken = self.backlash.finish(&self.end.planned_steps.zip(&motors.tool(), i32::wrapping_sub).0);
        self.turn_motors(&taken, line_number);
    }

    /// Takes up the remaining backlash of the first two motors before a move without X and Y, such as a plunge. If the
    /// backlash were taken up during the plunge, the drill would be dragged sideways.
    #[inline(never)]
    fn take_up_before_plunge(&mut self, m: &Move<N>) {
        // Does this only after a move mainly in X and Y, because the machine is slow at the corner to Z anyway, so the
        // additional stop costs little. Consecutive moves in Z must not be interrupted.
        let across2 = self.end.direction.iter().take(2).fold(0.0, |sum, part| sum + part * part);
        if self.planner.capacity() < MOST_BLOCKS_OF_A_MOVE || across2 < 0.5 {
            return;
        }
        let moved = self.kinematics.steps(&m.target).zip(&self.end.planned_steps, i32::wrapping_sub);
        let aside = moved.iter().take(2).any(|steps| *steps != 0);
        if !aside && moved.iter().any(|steps| *steps != 0) {
            let mut most = [0; N];
            most.iter_mut().take(2).for_each(|most| *most = MOST_BACKLASH);
            let taken = self.backlash.take_up(&most);
            self.turn_motors(&taken, m.line_number);
        }
    }

    /// Queues a block in which motors turn without a move of the program, from rest to rest.
    fn turn_motors(&mut self, taken: &[i32; N], line_number: u32) {
        if *taken == [0; N] {
            return;
        }
        let way = PerAxis(self.kinematics.way_of_axes(taken));
        let length = square_root(way.iter().fold(0.0, |sum, part| sum + part * part));
        let mut block = Block::<N>::EMPTY;
        let steps;
        (steps, block.directions) = unsigned_steps(taken);
        block.steps_by_axis = steps.map(AxisSteps::on_steps);
        block.line_number = line_number;
        block.length = length;
        let shares = shares(&way, length);
        (block.acceleration, block.limit) = self.limits.along_shares(&shares);
        block.jerk = self.limits.jerk_along(&shares, block.acceleration);
        block.programmed = block.limit;
        block.flags = NO_OVERRIDE | self.marked;
        // The tool does not move in this block, so a laser would burn a hole.
        block.power = 0;
        self.end.motors_only = true;
        self.end_join();
        self.planner.push(block, self.overrides);
        self.planner.plan();
    }
}
