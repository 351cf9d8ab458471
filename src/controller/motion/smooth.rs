//! Cuts the next segment with bounded jerk: from the state that the machine is in, as fast as what is planned allows.
//!
//! Each segment chooses the greatest of these for its end: the acceleration that leads to the nominal speed soonest; the
//! one it has; or, if after either the machine could not meet the next anchors any more, that of a ramp down to them.
//! Nothing but speed and acceleration is carried from one segment to the next. So an override, a hold, a start after it
//! or moves that come late need no plan of their own: they change what is allowed, and the jerk stays bounded.

use super::block::Block;
use super::jerk::{Bounds, State, cube_root, landing, ramp_distance, ramp_speed};
use super::planner::Planner;
use super::profile::{Pace, greater, lesser, square_root};
use super::segment::{self, Cut, Piece};
use super::{AnyMotion, Hold};
use crate::messages::UNITS_PER_STEP;

/// Share by which a speed may be off the nominal one and count as it: some hundred roundings.
const SAME_SPEED: f32 = 1.0e-5;
/// Where the rest of a ease-off is less than this share of the speed, it is taken in one segment.
const SNAP: f32 = 1.0e-4;

/// A segment's time and the state at its end.
#[derive(Clone, Copy, Debug)]
struct Gone {
    seconds: f32,
    end: State,
}

impl<const N: usize> AnyMotion<N> {
    /// The next piece of the running block; `None` for a stop at this very place.
    #[inline(never)]
    pub(super) fn smooth_cut(&mut self) -> Option<Cut> {
        let run = &self.feed.running;
        let bounds = self.planner.first()?.bounds();
        let holds = self.feed.hold == Hold::Ramp;
        let millimetre = 1.0 / run.scale;
        let state = State { speed: self.feed.pace.speed * millimetre, acceleration: self.feed.pull };
        let nominal = if holds { 0.0 } else { square_root(run.nominal2) * millimetre };
        // Changes of speed within a step: the motor sees nothing of how they go.
        let fastest = greater(nominal, state.speed);
        if ramp_distance(fastest, 0.0, bounds) < UNITS_PER_STEP as f32 * millimetre {
            let (curve, left) = self.curve()?;
            return Some(segment::cut(&curve, self.feed.running.done, left, self.feed.pace));
        }
        let units = run.total - run.done;
        let left = units as f32 * millimetre;
        let piece = Piece::next(self.feed.pace, state.acceleration * run.scale, run.done, units);
        let way = (piece.grain * piece.ticks) as f32 * millimetre;
        let last = piece.grain * piece.ticks == units;

        let from_rest = start(way, bounds);
        let at_rest = state.speed <= 0.0 || piece.ticks == 1 && state.speed <= 0.25 * from_rest.end.speed;
        let gone = if at_rest {
            self.leave_rest(from_rest, way, left, nominal, bounds)
        } else {
            self.go_on(state, way, if last { way } else { left }, nominal, bounds)
        };
        let speed = gone.end.speed * self.feed.running.scale;
        let end = Pace { speed, speed2: speed * speed };
        let mut cut = piece.cut(self.feed.pace.speed, end, gone.seconds);
        cut.acceleration = gone.end.acceleration;
        Some(cut)
    }

    /// From rest with an even jerk; where that would be too fast already, as slowly as it must be.
    fn leave_rest(&mut self, free: Gone, way: f32, left: f32, nominal: f32, bounds: Bounds) -> Gone {
        let rest = left - way;
        if let Some(ahead) = self.planner.allows(free.end, rest, nominal) {
            self.feed.ahead = ahead;
            return free;
        }
        let target = self.planner.target(0, rest, bounds);
        let slow = lesser(lesser(ramp_speed(target.speed, target.distance, target.bounds), nominal), free.end.speed);
        if slow > 0.1 * free.end.speed {
            return Gone { seconds: 2.0 * way / slow, end: State { speed: slow, acceleration: 0.0 } };
        }
        // From rest to rest the jerk changes its sign at a quarter and three quarters of the time.
        Gone { seconds: cube_root(32.0 * way / bounds.jerk), end: State { speed: slow, acceleration: 0.0 } }
    }

    fn go_on(&mut self, state: State, way: f32, left: f32, nominal: f32, bounds: Bounds) -> Gone {
        let State { speed, acceleration } = state;
        let rest = left - way;
        let time = way / speed;
        let guess = way / greater(speed + 0.5 * acceleration * time, 0.5 * speed);
        let change = bounds.jerk * guess;
        let within = |wanted: f32| greater(lesser(wanted, acceleration + change), acceleration - change);
        // The mean of both accelerations acts on the way, as if it were even: in a millisecond that is a hundredth of a
        // micrometre off.
        let to = |end: f32| -> Gone {
            let end2 = speed * speed + (acceleration + end) * way;
            if end2 <= 0.0 {
                return Self::come_to_rest(&self.planner, speed, way, left, bounds);
            }
            let last = square_root(end2);
            Gone { seconds: 2.0 * way / (speed + last), end: State { speed: last, acceleration: end } }
        };

        let mut allowed = Bounds { acceleration: lesser(bounds.acceleration, self.feed.ahead), ..bounds };
        let too_fast = speed > nominal * (1.0 + SNAP);
        if too_fast {
            // As far as the braking takes to be eased off, no block may mind it.
            let (_, ease) = state.valley(bounds.jerk);
            allowed = self.planner.bounds_within(ease, left, speed * speed);
        }
        let best = within(state.towards(nominal, guess, allowed));
        // A hold has no speed to come down to in time, but the corners on its way are those of the queue.
        let most = if self.feed.hold == Hold::Ramp { f32::INFINITY } else { nominal * (1.0 + SAME_SPEED) };
        let gone = to(best);
        if let Some(ahead) = self.planner.allows(gone.end, rest, most)
            && (gone.end.acceleration <= ahead || best < acceleration)
        {
            self.feed.ahead = ahead;
            let off = (gone.end.speed - nominal).abs();
            let slight = acceleration.abs() <= change && gone.end.acceleration.abs() <= 0.5 * change;
            if slight && off <= SNAP * nominal {
                return Gone {
                    seconds: 2.0 * way / (speed + nominal),
                    end: State { speed: nominal, acceleration: 0.0 },
                };
            }
            return gone;
        }
        if acceleration >= 0.0 && acceleration < best {
            let gone = to(acceleration);
            if let Some(ahead) = self.planner.allows(gone.end, rest, most)
                && gone.end.acceleration <= ahead
            {
                self.feed.ahead = ahead;
                return gone;
            }
        }
        let target = self.planner.target(0, left, bounds);
        self.feed.ahead = bounds.acceleration;
        let (aim, distance) = target.beyond(speed, way);
        if aim <= 0.0 && distance <= way {
            return Gone { seconds: 3.0 * time, end: State { speed: 0.0, acceleration: 0.0 } };
        }
        // The bounds of a block that lies ahead plan a ramp. Where the way is too short for it, the running block's own count,
        // or those of the blocks in which the braking for another reason would be eased off.
        let steepest = if too_fast { allowed.acceleration } else { bounds.acceleration };
        let planned = target.bounds.acceleration;
        // A raised override or a bend that is noticed late leaves less in a bend than was counted on: all of it is taken then.
        let all = self.planner.first().map_or(steepest, |block| greater(steepest, block.acceleration));
        let mut wanted = if target.is_met(state) { -planned } else { -greater(planned, all) };
        if acceleration <= 0.0 {
            let next = speed + acceleration * guess;
            let land = if next > aim { landing(next, aim, greater(distance - way, 0.0)) } else { 0.0 };
            wanted = greater(wanted, land);
        }
        let gone = to(lesser(within(wanted), best));
        // Where the ramp's last piece is coarse (a tick in which most of the speed goes), it ends as planned all the same.
        let even = (speed * speed - aim * aim) / (2.0 * way);
        if distance <= way && aim < 0.5 * speed && gone.end.speed > aim && even <= all {
            return Gone { seconds: 2.0 * way / (speed + aim), end: State { speed: aim, acceleration: 0.0 } };
        }
        gone
    }

    /// The end of a way on which the braking comes to rest: the block goes on to its end, which it leaves no faster than planned.
    #[inline(never)]
    fn come_to_rest(planner: &Planner<N, [Block<N>]>, speed: f32, way: f32, left: f32, bounds: Bounds) -> Gone {
        let exit = if left > way { speed } else { lesser(speed, planner.target(0, left, bounds).speed) };
        // To rest with an even jerk.
        let seconds = if exit > 0.0 { 2.0 * way / (speed + exit) } else { 3.0 * way / speed };
        Gone { seconds, end: State { speed: exit, acceleration: 0.0 } }
    }
}

/// The first way from rest: with an even jerk, which is lower than the bound if the acceleration would become too great.
fn start(way: f32, bounds: Bounds) -> Gone {
    let seconds = greater(cube_root(6.0 * way / bounds.jerk), square_root(6.0 * way / bounds.acceleration));
    Gone { seconds, end: State { speed: 3.0 * way / seconds, acceleration: 6.0 * way / (seconds * seconds) } }
}
