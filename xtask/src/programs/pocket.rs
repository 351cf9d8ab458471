//! Two pockets as CAM programs write them: one in millimetres with helical entry, one in inches with a zigzag ramp.
//! Each goes down level by level and clears a level from the middle outwards, in rounded rectangles. A last pass
//! finishes the wall; it begins and ends on a quarter circle.

use super::writer::Writer;
use std::io::{Result, Write};

/// A rounded-rectangle pocket. Lengths are in units of the last decimal place (µm or 0.0001 inch), feeds in tenths of
/// mm/min or inch/min.
struct Pocket {
    /// Half the size of the pocket along X and Y.
    half: [i64; 2],
    /// Radius of the corners of the finished wall.
    corner: i64,
    tool_radius: i64,
    /// Radius of the smallest inside corner of the tool's path.
    path_corner: i64,
    step_over: i64,
    step_down: i64,
    depth: i64,
    /// Thickness of the material that clearing leaves for the finishing pass.
    allowance: i64,
    clear: i64,
    feed: i64,
    plunge: i64,
    finish_feed: i64,
}

/// How the tool goes down to the next level.
enum Entry {
    /// Along a helix of this radius and pitch.
    Helix { radius: i64, pitch: i64 },
    /// Back and forth along X, by `reach` to each side of the middle, down by `fall` in each stroke.
    Zigzag { reach: i64, fall: i64 },
}

/// Writes an 80 x 50 x 6 mm pocket for a 6 mm end mill. Zero is the middle of the pocket, top of the stock.
pub fn millimetres(out: &mut dyn Write) -> Result<()> {
    let pocket = Pocket {
        half: [40_000, 25_000],
        corner: 6_000,
        tool_radius: 3_000,
        path_corner: 1_000,
        step_over: 2_400,
        step_down: 1_500,
        depth: 6_000,
        allowance: 200,
        clear: 5_000,
        feed: 12_000,
        plunge: 4_000,
        finish_feed: 8_000,
    };
    let mut w = Writer::new(out, 3);
    w.comment("POCKET_MM")?;
    w.comment("T1 D=6. CR=0. - ZMIN=-6. - flat end mill")?;
    w.comment("Stock: 100 x 70 x 12 aluminium. Zero: middle, top")?;
    w.comment("Written by: cargo xtask job pocket_mm")?;
    w.text("G90 G94")?;
    w.text("G17")?;
    w.text("G21")?;
    w.comment("2D pocket")?;
    w.text("T1")?;
    w.text("S12000 M3")?;
    w.text("G54")?;
    w.text("M8")?;
    pocket.write(&mut w, ["G0", "G1", "G2", "G3"], &Entry::Helix { radius: 2_000, pitch: 500 })?;
    w.text("M9")?;
    w.text("M5")?;
    w.text("M30")
}

/// Writes a 3 x 1.5 x 0.375 inch pocket for a quarter-inch end mill.
pub fn inches(out: &mut dyn Write) -> Result<()> {
    let pocket = Pocket {
        half: [15_000, 7_500],
        corner: 2_500,
        tool_radius: 1_250,
        path_corner: 313,
        step_over: 1_000,
        step_down: 625,
        depth: 3_750,
        allowance: 100,
        clear: 2_500,
        feed: 450,
        plunge: 150,
        finish_feed: 300,
    };
    let mut w = Writer::new(out, 4).numbered().compact();
    w.comment("Pocket 3.0 x 1.5 x 0.375 in")?;
    w.comment("Tool: End Mill 0.25 inch")?;
    w.comment("Zero: middle of the pocket, top of the material")?;
    w.comment("Written by: cargo xtask job pocket_inch")?;
    w.text("G20G17G90G40G80")?;
    w.text("G49")?;
    w.text("T1")?;
    w.text("S10000M03")?;
    w.text("G94")?;
    pocket.write(&mut w, ["G00", "G01", "G02", "G03"], &Entry::Zigzag { reach: 6_000, fall: 313 })?;
    w.text("M05")?;
    w.text("M30")
}

impl Pocket {
    /// Writes the moves between spindle on and spindle off. `words` are the G words for rapid, feed move, clockwise arc
    /// and counter-clockwise arc.
    fn write(&self, w: &mut Writer, words: [&'static str; 4], entry: &Entry) -> Result<()> {
        let [rapid, line, _, _] = words;
        w.line_to(rapid, [None, None, Some(self.clear)], None)?;
        w.line_to(rapid, [Some(0), Some(0), None], None)?;
        let mut level = 0;
        while level > -self.depth {
            let next = (level - self.step_down).max(-self.depth);
            w.line_to(rapid, [None, None, Some(level + self.clear / 10)], None)?;
            self.enter(w, words, entry, level, next)?;
            self.clear_level(w, words)?;
            w.line_to(rapid, [None, None, Some(self.clear)], None)?;
            w.line_to(rapid, [Some(0), Some(0), None], None)?;
            level = next;
        }
        // Finishing: arrive on a quarter circle at the middle of the upper wall, go around counter-clockwise (climb
        // milling), and leave on another quarter circle.
        let [x, y] = self.half.map(|half| half - self.tool_radius);
        let radius = self.corner - self.tool_radius;
        let lead = self.tool_radius;
        w.line_to(rapid, [Some(lead), Some(y - lead), None], None)?;
        w.line_to(rapid, [None, None, Some(self.clear / 10 - self.depth + self.step_down)], None)?;
        w.line_to(line, [None, None, Some(-self.depth)], Some(self.plunge))?;
        w.arc_to(words[3], [Some(0), Some(y), None], [-lead, 0], Some(self.finish_feed))?;
        rounded_rectangle(w, words, [x, y], radius, Some(self.finish_feed))?;
        w.arc_to(words[3], [Some(-lead), Some(y - lead), None], [0, -lead], None)?;
        w.line_to(rapid, [None, None, Some(self.clear)], None)?;
        w.line_to(rapid, [Some(0), Some(0), None], None)
    }

    /// Writes the entry from `level` down to `next`; starts and ends in the middle.
    fn enter(&self, w: &mut Writer, words: [&'static str; 4], entry: &Entry, level: i64, next: i64) -> Result<()> {
        let [_, line, _, counter_clockwise] = words;
        w.line_to(line, [None, None, Some(level)], Some(self.plunge))?;
        match *entry {
            Entry::Helix { radius, pitch } => {
                w.line_to(line, [Some(radius), Some(0), None], Some(self.feed))?;
                let mut z = level;
                while z > next {
                    z = (z - pitch).max(next);
                    w.arc_to(counter_clockwise, [Some(radius), Some(0), Some(z)], [-radius, 0], Some(self.plunge))?;
                }
                // One turn at constant depth, because the helix leaves a sloping floor.
                w.arc_to(counter_clockwise, [Some(radius), Some(0), None], [-radius, 0], Some(self.feed))?;
            }
            Entry::Zigzag { reach, fall } => {
                let (mut z, mut side) = (level, 1);
                while z > next {
                    z = (z - fall).max(next);
                    w.line_to(line, [Some(reach * side), Some(0), Some(z)], Some(self.plunge))?;
                    side = -side;
                }
                w.line_to(line, [Some(reach * side), None, None], Some(self.feed))?;
            }
        }
        w.line_to(line, [Some(0), Some(0), None], Some(self.feed))
    }

    /// Clears one level: writes rounded rectangles from the middle outwards, up to the allowance for the finishing
    /// pass.
    fn clear_level(&self, w: &mut Writer, words: [&'static str; 4]) -> Result<()> {
        let last = self.half.map(|half| half - self.tool_radius - self.allowance);
        // From the wall, each rectangle lies one step-over farther in; the innermost rectangle is a slot at most two
        // step-overs high.
        let rings = (last[1] - 1) / self.step_over;
        for ring in (0..=rings).rev() {
            let size = last.map(|edge| edge - ring * self.step_over);
            let wall = self.corner - self.tool_radius - self.allowance;
            let radius = (wall - ring * self.step_over).max(self.path_corner).min(size[1]);
            w.line_to(words[1], [Some(0), Some(size[1]), None], Some(self.feed))?;
            rounded_rectangle(w, words, size, radius, Some(self.feed))?;
        }
        Ok(())
    }
}

/// Writes one rounded rectangle counter-clockwise, from and to the middle of the upper side.
fn rounded_rectangle(
    w: &mut Writer,
    words: [&'static str; 4],
    half: [i64; 2],
    radius: i64,
    feed: Option<i64>,
) -> Result<()> {
    let [_, line, _, arc] = words;
    let ([x, y], r) = (half, radius);
    // Each corner: start of its arc, end of its arc, and centre relative to the start.
    let corners = [
        ([r - x, y], [-x, y - r], [0, -r]),
        ([-x, r - y], [r - x, -y], [r, 0]),
        ([x - r, -y], [x, r - y], [0, r]),
        ([x, y - r], [x - r, y], [-r, 0]),
    ];
    for (from, to, centre) in corners {
        w.line_to(line, [Some(from[0]), Some(from[1]), None], feed)?;
        w.arc_to(arc, [Some(to[0]), Some(to[1]), None], centre, feed)?;
    }
    w.line_to(line, [Some(0), Some(y), None], feed)
}
