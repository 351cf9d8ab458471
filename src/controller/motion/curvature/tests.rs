//! Checks the shortcuts of `curvature`. The limits found must be those of the complete rule, without shortcuts. If
//! limits that the machine cannot exceed are left out, the speeds must hardly change.

use super::*;

/// Pseudo-random numbers (xorshift, Marsaglia 2003).
struct Random(u64);

impl Random {
    fn below(&mut self, end: u64) -> u64 {
        self.0 ^= self.0 << 13;
        self.0 ^= self.0 >> 7;
        self.0 ^= self.0 << 17;
        (self.0 >> 11) % end
    }

    /// Returns a number from 0 to 1.
    fn share(&mut self) -> f32 {
        self.below(1 << 24) as f32 / (1 << 24) as f32
    }

    /// Returns a number between two others, such that each order of magnitude is equally likely.
    fn size(&mut self, least: f32, greatest: f32) -> f32 {
        least * (greatest / least).powf(self.share())
    }

    fn sign(&mut self) -> f32 {
        if self.below(2) == 0 { 1.0 } else { -1.0 }
    }

    /// Returns a random rule from the whole range that the settings allow.
    fn rule<const N: usize>(&mut self) -> TurnRule<N> {
        let all = self.size(1.0e-3, 1.0e7);
        let acceleration = match self.below(3) {
            0 => [all; N],
            1 => [all; N].map(|all| (all * self.size(1.0e-3, 1.0)).max(1.0e-3)),
            _ => [0.0; N].map(|_| self.size(1.0e-3, 1.0e7)),
        };
        let deviation = if self.below(2) == 0 { 0.0 } else { self.size(1.0e-6, 1.0e3) };
        let curve_share = if self.below(2) == 0 { 1.0 } else { self.size(0.01, 100.0) };
        TurnRule::new(acceleration, deviation, curve_share)
    }

    /// Returns the unit vector of a displacement. At random, it is computed by divisions, as for single moves, or by
    /// multiplications with the inverse of the length, as for spans of several moves.
    fn unit<const N: usize>(&mut self, way: [f32; N]) -> [f32; N] {
        let length = square_root(way.iter().fold(0.0, |sum, part| sum + part * part));
        let shortness = 1.0 / length;
        if self.below(2) == 0 { way.map(|part| part / length) } else { way.map(|part| part * shortness) }
    }

    /// Returns a direction in which some axes do not move and some hardly move.
    fn direction<const N: usize>(&mut self) -> [f32; N] {
        let mut way = [0.0; N].map(|_| if self.below(2) == 0 { 0.0 } else { self.sign() * self.size(1.0e-7, 1.0) });
        way[self.below(N as u64) as usize] = self.sign();
        self.unit(way)
    }

    /// Returns a direction after `before`: slightly turned in some axes, reversed, or unrelated.
    fn turned<const N: usize>(&mut self, before: [f32; N], turn: f32) -> [f32; N] {
        let back = match self.below(12) {
            0 => return self.direction(),
            1 => -1.0,
            _ => 1.0,
        };
        let way = before.map(|part| {
            let aside = if self.below(3) == 0 { 0.0 } else { turn * (self.share() - 0.5) };
            back * part + aside
        });
        self.unit(way)
    }

    /// Returns a span of one to three pieces.
    fn span<const N: usize>(&mut self, direction: [f32; N], path: f32, turn: f32) -> Span<N> {
        Span {
            direction,
            noise: if self.below(2) == 0 { 0.0 } else { self.share() * turn },
            path,
            fast2: UNLIMITED2,
            attainable2: UNLIMITED2,
            blocks: 1 + self.below(3) as u16,
            straight: self.below(20) > 0,
            ..Span::NONE
        }
    }
}

/// Returns the limits (speed²) of the turns from the previous spans to a new one, by the complete rule without
/// shortcuts.
fn limits<const N: usize>(history: &History<N>, new: &Span<N>, rule: &TurnRule<N>) -> Vec<f32> {
    let (mut between, mut fast2, mut speeds2) = (0.0, new.attainable2, Vec::new());
    for (index, old) in history.iter().enumerate() {
        fast2 = greater(fast2, old.attainable2);
        let both_single = new.blocks == 1 && old.blocks == 1;
        if new.straight && old.straight && !(index == 0 && both_single) {
            let all2 = turn2(&old.direction, &new.direction);
            if let Some((turn2, half_cosine)) = certain(all2, old.noise + new.noise) {
                let radius = (between + old.half() + new.half()) * radius_of(turn2, half_cosine);
                let moving = rule.moving(&old.direction, &new.direction);
                let bend2 = rule.in_plane(&old.direction, &new.direction, all2, moving) * rule.curve_share * radius;
                let across = rule.across(&old.direction, &new.direction, square_root(all2));
                let junction2 = if turn2 > REVERSAL { 0.0 } else { rule.junction2(across, half_cosine, turn2) };
                let single2 = (0.5 * (square_root(junction2) + square_root(junction2 + 4.0 * bend2))).powi(2);
                let speed2 = if both_single { single2 } else { junction2 + bend2 };
                if speed2 < fast2 {
                    speeds2.push(speed2);
                }
            }
        }
        between += old.path;
    }
    speeds2
}

/// For many turns, checks that the limits found are those of the complete rule, at speeds close to these limits.
/// Returns in how many cases a limit was found, and in how many `surely_allows` excluded all limits in advance.
fn check_turns<const N: usize>(random: &mut Random, count: u32) -> (u32, u32) {
    let (mut limited, mut left_out) = (0, 0);
    for _ in 0..count {
        let rule = random.rule::<N>();
        let (turn, path) = (random.size(1.0e-3, 3.0), random.size(1.0e-7, 1.0e5));
        let mut direction = random.direction();
        let mut spans = [(); HISTORY + 1].map(|()| {
            direction = random.turned(direction, turn);
            let path = path * random.size(0.1, 10.0);
            random.span(direction, path, turn)
        });
        let [fourth, third, second, first, new] = spans;
        let speeds2 = limits(&History { spans: [fourth, third, second, first], newest: HISTORY - 1 }, &new, &rule);
        if speeds2.is_empty() {
            continue;
        }
        let near2 = match random.below(3) {
            0 => speeds2[random.below(speeds2.len() as u64) as usize],
            _ => speeds2.iter().fold(UNLIMITED2, |least, speed2| lesser(*speed2, least)),
        };
        let near = if random.below(3) == 0 { random.size(1.0e-3, 1.0) } else { 0.9 + 0.15 * random.share() };
        // Clamped to the range of possible speeds.
        let fast2 = (near2 * near).clamp(1.6e-13, 1.0e10);
        let even = random.below(2) == 0;
        for span in &mut spans {
            span.fast2 = if even || random.below(2) == 0 { fast2 } else { fast2 * random.share() };
            span.attainable2 = span.fast2;
        }
        let [earlier @ .., mut new] = spans;
        let mut history = History::NONE;
        for mut span in earlier {
            history.take_span(
                &mut span,
                0,
                &mut Finder { rule: &rule, found: &mut |_| {}, attainable2: UNLIMITED2, newest: 0.0, since_steep: 0.0 },
            );
        }
        let (complete, mut found) = (limits(&history, &new, &rule), Vec::new());
        let before = history;
        let mut note = |bend: Bend| {
            if bend.curve.is_none() {
                found.push(bend.speed2);
            }
        };
        history.take_span(
            &mut new,
            0,
            &mut Finder { rule: &rule, found: &mut note, attainable2: UNLIMITED2, newest: 0.0, since_steep: 0.0 },
        );
        assert_eq!(found, complete, "{before:?} {new:?} {rule:?}");
        limited += u32::from(!found.is_empty());
        left_out += u32::from(before.surely_allows(&new));
    }
    (limited, left_out)
}

#[test]
fn no_turn_that_limits_is_left_out_in_advance() {
    let mut random = Random(0x2545_F491_4F6C_DD1D);
    for (limited, left_out) in [check_turns::<3>(&mut random, 60_000), check_turns::<6>(&mut random, 60_000)] {
        assert!(limited > 10_000 && (left_out > 1000 || !LEAVES_OUT), "{limited} {left_out}");
    }
}

/// Returns the ratio of path length to straight length for the piece with number `place`. Pieces with a ratio above 1
/// stand for blocks after moves without a step, because the path of such a block includes these moves.
fn winding(place: usize) -> f32 {
    if place % 50 < 15 { 1.0 + 0.3 * (place % 50) as f32 } else { 1.0 }
}

/// Returns the maximum acceleration along a piece at which neither axis exceeds its limit.
fn along(direction: &[f32; 2], place: usize, rule: &TurnRule<2>) -> f32 {
    let [x, y] = rule.acceleration;
    (x / direction[0].abs()).min(y / direction[1].abs()) * winding(place)
}

/// Returns the speed² at each point of a path with these entry limits, from rest at the start to rest at the end.
fn profile(points: &[[f32; 2]], limits2: &[f32], rule: &TurnRule<2>) -> Vec<f32> {
    let rises2: Vec<f32> = points
        .windows(2)
        .enumerate()
        .map(|(place, ends)| {
            let way = [ends[1][0] - ends[0][0], ends[1][1] - ends[0][1]];
            let length = way[0].hypot(way[1]);
            2.0 * along(&way.map(|part| part / length), place, rule) * length * winding(place)
        })
        .collect();
    let mut speeds2 = limits2.to_vec();
    speeds2[0] = 0.0;
    speeds2.push(0.0);
    for at in 0..rises2.len() {
        speeds2[at + 1] = speeds2[at + 1].min(speeds2[at] + rises2[at]);
    }
    for at in (0..rises2.len()).rev() {
        speeds2[at] = speeds2[at].min(speeds2[at + 1] + rises2[at]);
    }
    speeds2
}

/// Returns the entry limits (speed²) of a path's pieces, and how many bends have been found. `attainable`: `true` to
/// leave out limits that the machine cannot exceed anyway.
fn entry_limits(points: &[[f32; 2]], fast2: f32, rule: &TurnRule<2>, attainable: bool) -> (Vec<f32>, usize) {
    let place = |point: &[f32; 2]| PerAxis(point.map(|mm| Coordinate((f64::from(mm) * 1.0e7) as i64)));
    let mut chain = Chain::new(Lent::new(Chain::<2>::SCALES));
    chain.restart(&place(&points[0]));
    let (mut limits2, mut bends): (Vec<f32>, usize) = (Vec::new(), 0);
    let mut rises2 = Vec::new();
    for (index, ends) in points.windows(2).enumerate() {
        let (start, end) = (place(&ends[0]), place(&ends[1]));
        let way = end.zip(&start, way_mm);
        let length = way.0[0].hypot(way.0[1]);
        let direction = way.0.map(|part| part / length);
        let piece = PathPiece {
            start: &start,
            end: &end,
            direction: &direction,
            length,
            path: length * winding(index),
            fast2,
            digit: 1.0e-5,
        };
        let span = Span::of(&piece);
        let corner2 = chain.corner2(&span, rule);
        limits2.push(corner2.min(fast2));
        if !attainable {
            chain.attainable2 = UNLIMITED2;
        }
        let acceleration = along(&direction, index, rule);
        let block = EntryLimit { corner2, acceleration };
        chain.extend(&piece, block, span, rule, &mut |bend| {
            bends += 1;
            let newest = limits2.len() - 1;
            let places = newest.saturating_sub(bend.farthest)..=newest - bend.nearest;
            if let Some((nearest, farthest)) = bend.once {
                let mut turn = newest.saturating_sub(farthest)..=newest - nearest;
                if turn.any(|place| limits2[place] <= bend.speed2) {
                    return;
                }
            }
            for limit2 in &mut limits2[places] {
                *limit2 = limit2.min(bend.speed2);
            }
        });
        // `attainable2` must be an upper bound of the speed² of a machine that speeds up from rest as far as the limits
        // allow.
        let mut speed2 = 0.0_f32;
        rises2.push(2.0 * acceleration * piece.path);
        for (limit2, rise2) in limits2.iter().zip(&rises2) {
            speed2 = (speed2.min(*limit2) + rise2).min(fast2);
        }
        assert!(speed2 <= chain.attainable2 * 1.0001, "{index}: {speed2}, {} at most", chain.attainable2);
    }
    (limits2, bends)
}

#[test]
fn only_limits_that_the_machine_cannot_exceed_are_left_out() {
    let mut random = Random(0x9E37_79B9_7F4A_7C15);
    let (mut places, mut slower, mut of_all, mut of_attainable) = (0, 0, 0, 0);
    for _ in 0..300 {
        let rule = TurnRule::new([0.0; 2].map(|_| random.size(50.0, 5000.0)), random.size(1.0e-3, 0.1), 1.0);
        let fast2 = random.size(1.0, 300.0).powi(2);
        let (length, bend, rough) = (random.size(0.02, 2.0), random.size(1.0e-3, 0.5), random.size(1.0e-3, 0.5));
        let (mut angle, mut points) = (random.share() * 6.0, vec![[0.0_f32; 2]]);
        let (mut turn, mut at) = (0.0, [0.0_f32; 2]);
        for point in 0..200 {
            if point % 20 == 0 {
                turn = bend * (2.0 * random.share() - 1.0);
            }
            angle += turn + rough * (random.share() - 0.5);
            let chord = length * random.size(0.3, 3.0);
            at = [at[0] + chord * angle.cos(), at[1] + chord * angle.sin()];
            points.push(at);
        }
        let [(all, more), (attainable, fewer)] =
            [false, true].map(|attainable| entry_limits(&points, fast2, &rule, attainable));
        (of_all, of_attainable) = (of_all + more, of_attainable + fewer);
        let (all, attainable) = (profile(&points, &all, &rule), profile(&points, &attainable, &rule));
        for (place, (all, attainable)) in all.iter().zip(&attainable).enumerate() {
            assert!(*attainable <= all * 1.0001 + 1.0e-6, "{place}: {attainable}, not {all}, {rule:?} {points:?}");
            places += 1;
            slower += usize::from(*attainable < all * 0.999);
        }
    }
    // A limit with `Bend::once` does not apply if an entry in its range is already slow. The limit that makes this
    // entry slow can have been left out. Then the limit with `Bend::once` applies, and the machine can be slower. That
    // must be rare.
    assert!(slower < places / 200, "{slower} of {places}");
    assert!(of_attainable < of_all * 4 / 5 || !LEAVES_OUT, "{of_attainable} bends instead of {of_all}");
}
