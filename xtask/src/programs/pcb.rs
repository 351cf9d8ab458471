//! Isolation of a printed circuit board: two passes around the outlines of traces and pads, then spotting of drill
//! holes and scoring of the edge. The cutting moves are short, and there are very many short rapids.

use super::writer::{Writer, square_root};
use std::io::{Result, Write};

// Heights and lengths are in µm, feeds in tenths of mm/min.
const CUT: i64 = -80;
const SPOT: i64 = -300;
const SCORE: i64 = -250;
const TRAVEL: i64 = 1_000;
const CLEAR: i64 = 10_000;
const FEED: i64 = 4_000;
const PLUNGE: i64 = 1_000;
/// Half of the V-bit's cutting width at the isolation depth.
const TOOL_RADIUS: i64 = 100;
/// Distance between the first and the second pass.
const PASS: i64 = 150;
const PASSES: i64 = 2;
const TRACE_HALF: i64 = 250;
const PAD_RADIUS: i64 = 800;
const BOARD: [i64; 2] = [60_000, 44_000];
/// Centre of the eight-way fan of traces.
const FAN_MIDDLE: [i64; 2] = [20_000, 22_000];
/// Pitch of the traces at the chip. `CHIP_ROW`: distance of each row of pins from the centre of the chip.
/// `TERMINAL_PITCH` and `TERMINAL_ROW`: the same for the terminals.
const CHIP_PITCH: i64 = 2_540;
const CHIP_ROW: i64 = 3_810;
const TERMINAL_PITCH: i64 = 4_445;
const TERMINAL_ROW: i64 = 16_000;
/// Columns and rows of the grid of single pads next to the fan.
const GRID: [i64; 2] = [7, 14];
const GRID_PITCH: i64 = 2_540;
const GRID_CORNER: [i64; 2] = [41_000, 5_500];

/// Writes the program: isolation, then spots for the drill, then the edge.
pub fn write(out: &mut dyn Write) -> Result<()> {
    let mut w = Writer::new(out, 3);
    w.comment("PCB isolation: breakout for a 16-pin chip, and a field of pads")?;
    w.comment("Tool: 30 degree V-bit, 0.2 mm wide at 0.08 mm depth")?;
    w.comment("Zero: lower left corner of the board, on the copper")?;
    w.comment("Written by: cargo xtask job pcb_isolation")?;
    w.text("G94")?;
    w.text("G21")?;
    w.text("G90")?;
    w.text("S20000 M3")?;
    w.line_to("G0", [None, None, Some(CLEAR)], None)?;
    w.text("G4 P2")?;

    let traces = traces();
    let grid = grid();
    w.comment("Isolation")?;
    for pass in 0..PASSES {
        let distance = TOOL_RADIUS + pass * PASS;
        for trace in &traces {
            isolate_trace(&mut w, trace, distance)?;
        }
        for pad in &grid {
            isolate_pad(&mut w, *pad, distance)?;
        }
    }
    w.comment("Spots for the drill")?;
    let holes = traces.iter().flat_map(|t| [t[0], t[3]]).chain(grid);
    for [x, y] in holes {
        w.line_to("G0", [Some(x), Some(y), None], None)?;
        w.line_to("G1", [None, None, Some(SPOT)], Some(PLUNGE))?;
        w.line_to("G0", [None, None, Some(TRAVEL)], None)?;
    }
    w.comment("Edge")?;
    let [right, top] = BOARD;
    w.line_to("G0", [Some(0), Some(0), None], None)?;
    w.line_to("G1", [None, None, Some(SCORE)], Some(PLUNGE))?;
    for [x, y] in [[right, 0], [right, top], [0, top], [0, 0]] {
        w.line_to("G1", [Some(x), Some(y), None], Some(FEED))?;
    }
    w.line_to("G0", [None, None, Some(CLEAR)], None)?;
    w.text("M5")?;
    w.text("M2")
}

/// The four points of a trace from a terminal to a pin of the chip: down, across, down.
type Trace = [[i64; 2]; 4];

/// Returns eight traces above the chip and their mirror images below. A trace left of the middle runs down from its
/// terminal, then to the right (the cross leg), then down to its pin. A cross leg must be lower than the cross leg of
/// its right neighbour. Otherwise the left one would cross the leg that comes down from the neighbour's terminal. The
/// traces right of the middle are the mirror image.
fn traces() -> Vec<Trace> {
    let mut all = Vec::new();
    for side in [1, -1] {
        for k in 0..8 {
            // Twice the distance from the middle in pitches: an odd number from -7 to 7.
            let odd = 2 * k - 7;
            let terminal = FAN_MIDDLE[0] + odd * TERMINAL_PITCH / 2;
            let pin = FAN_MIDDLE[0] + odd * CHIP_PITCH / 2;
            let track = 12_000 - (odd.abs() - 1) / 2 * 1_600;
            let y = |height: i64| FAN_MIDDLE[1] + side * height;
            all.push([[terminal, y(TERMINAL_ROW)], [terminal, y(track)], [pin, y(track)], [pin, y(CHIP_ROW)]]);
        }
    }
    all
}

/// Returns the pads of the grid, row by row, in alternating directions.
fn grid() -> Vec<[i64; 2]> {
    let mut all = Vec::new();
    for row in 0..GRID[1] {
        for column in 0..GRID[0] {
            let column = if row % 2 == 0 { column } else { GRID[0] - 1 - column };
            all.push([GRID_CORNER[0] + column * GRID_PITCH, GRID_CORNER[1] + row * GRID_PITCH]);
        }
    }
    all
}

fn isolate_pad(w: &mut Writer, [x, y]: [i64; 2], distance: i64) -> Result<()> {
    let r = PAD_RADIUS + distance;
    down_at(w, [x - r, y])?;
    // Two half circles, because start and end of a full circle would have to agree to the last digit.
    w.arc_to("G2", [Some(x + r), Some(y), None], [r, 0], Some(FEED))?;
    w.arc_to("G2", [Some(x - r), Some(y), None], [-r, 0], None)?;
    up(w)
}

/// Cuts around a trace with a pad at both ends, with the copper always on the right.
fn isolate_trace(w: &mut Writer, trace: &Trace, distance: i64) -> Result<()> {
    let half = TRACE_HALF + distance;
    let r = PAD_RADIUS + distance;
    // Distance, along the trace, from the centre of the pad to the point at which the outlines of pad and trace meet.
    let meet = square_root(r * r - half * half);
    let [first, second, third, last] = *trace;
    let out = direction(first, second);
    let across = direction(second, third);
    let back = direction(last, third);
    let left = |d: [i64; 2]| [-d[1], d[0]];
    let at = |p: [i64; 2], d: [i64; 2], along: i64, side: i64| {
        let n = left(d);
        [p[0] + d[0] * along + n[0] * side, p[1] + d[1] * along + n[1] * side]
    };
    // Returns the corner of the outline beside the trace corner `p`, between segments with the directions `d` and `e`.
    // Each segment is shifted by `side` to the left of its direction.
    let corner = |p: [i64; 2], d: [i64; 2], e: [i64; 2], side: i64| {
        let (n, m) = (left(d), left(e));
        [p[0] + (n[0] + m[0]) * side, p[1] + (n[1] + m[1]) * side]
    };
    let opposite = |d: [i64; 2]| [-d[0], -d[1]];

    let start = at(first, out, meet, half);
    down_at(w, start)?;
    let line = |w: &mut Writer, [x, y]: [i64; 2]| w.line_to("G1", [Some(x), Some(y), None], Some(FEED));
    line(w, corner(second, out, across, half))?;
    line(w, corner(third, across, opposite(back), half))?;
    // `back` points from the last pad back along the trace, against the direction of this cut. So the left side of the
    // cut is the right side of `back`, and `side` is negative.
    let arrive = at(last, back, meet, -half);
    line(w, arrive)?;
    let leave = at(last, back, meet, half);
    round_pad(w, last, arrive, leave)?;
    line(w, corner(third, across, opposite(back), -half))?;
    line(w, corner(second, out, across, -half))?;
    let arrive = at(first, out, meet, -half);
    line(w, arrive)?;
    round_pad(w, first, arrive, start)?;
    up(w)
}

/// Cuts clockwise around a pad, the long way.
fn round_pad(w: &mut Writer, pad: [i64; 2], from: [i64; 2], to: [i64; 2]) -> Result<()> {
    let centre = [pad[0] - from[0], pad[1] - from[1]];
    w.arc_to("G2", [Some(to[0]), Some(to[1]), None], centre, Some(FEED))
}

/// Returns the unit vector from one point to another on the same grid line.
fn direction(from: [i64; 2], to: [i64; 2]) -> [i64; 2] {
    [(to[0] - from[0]).signum(), (to[1] - from[1]).signum()]
}

fn down_at(w: &mut Writer, [x, y]: [i64; 2]) -> Result<()> {
    w.line_to("G0", [None, None, Some(TRAVEL)], None)?;
    w.line_to("G0", [Some(x), Some(y), None], None)?;
    w.line_to("G1", [None, None, Some(CUT)], Some(PLUNGE))
}

fn up(w: &mut Writer) -> Result<()> {
    w.line_to("G0", [None, None, Some(TRAVEL)], None)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Returns the squared distance of two line segments, each parallel to an axis.
    fn gap(a: [[i64; 2]; 2], b: [[i64; 2]; 2]) -> i64 {
        (0..2)
            .map(|i| {
                let (a_low, a_high) = (a[0][i].min(a[1][i]), a[0][i].max(a[1][i]));
                let (b_low, b_high) = (b[0][i].min(b[1][i]), b[0][i].max(b[1][i]));
                (a_low - b_high).max(b_low - a_high).max(0).pow(2)
            })
            .sum()
    }

    #[test]
    fn no_cut_goes_through_another_trace() {
        let traces = traces();
        let reach = TRACE_HALF + TOOL_RADIUS + (PASSES - 1) * PASS + TOOL_RADIUS;
        for (i, a) in traces.iter().enumerate() {
            for b in &traces[..i] {
                for leg_a in a.windows(2) {
                    for leg_b in b.windows(2) {
                        let distance = gap([leg_a[0], leg_a[1]], [leg_b[0], leg_b[1]]);
                        assert!(distance >= (reach + TRACE_HALF).pow(2), "{leg_a:?} {leg_b:?}");
                    }
                }
                for pad_a in [a[0], a[3]] {
                    for pad_b in [b[0], b[3]] {
                        assert!(gap([pad_a, pad_a], [pad_b, pad_b]) >= (2 * PAD_RADIUS + 2 * TOOL_RADIUS).pow(2));
                    }
                }
            }
        }
    }
}
