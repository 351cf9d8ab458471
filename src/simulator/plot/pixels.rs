//! Renders the picture as pixels: paints the few kinds of elements in an SVG of [`super::svg`], antialiased, and packs
//! the pixels as PNG. An unknown element is an error, so other SVGs are not supported.
//!
//! To fill a shape, each pixel is mixed with the colour in proportion to the share of the pixel that the shape covers.
//! A line is filled like a shape: it consists of a bar for each straight piece, and of a mitre (a pointed tip) on the
//! outer side of each corner. The outlines of all bars and mitres have the same sense of rotation, so that overlapping
//! parts add up to one area.

use super::SIZE;
use super::style::FINE;
use ab_glyph::{Font, FontRef, OutlineCurve, Point, point};
use ab_glyph_rasterizer::Rasterizer;
use anyhow::{Context, Result, bail};
use std::f32::consts::TAU;

/// Pixels of the PNG per pixel of the drawing.
const DENSITY: f32 = 1.5;
/// Pixels of the PNG per unit of the drawing's SVG.
const SCALE: f32 = DENSITY / FINE as f32;

/// Number of corners of the polygon by which a circle is drawn.
const CORNERS: u8 = 48;

/// Height of a lower-case x as a fraction of the font size; the SVG uses it to centre text vertically.
const EX: f32 = 0.5;

/// Square of the mitre limit, which is 4 (SVG's default): a tip is at most 4 half widths of the line from the corner. A
/// longer tip is cut off.
const MITRE_LIMIT2: f32 = 16.0;

/// Renders an SVG of [`super::svg`] as PNG.
///
/// # Errors
/// If the SVG has an element or value that [`super::svg`] does not produce.
pub fn png(svg: &str) -> Result<Vec<u8>> {
    Ok(painted(svg)?.packed())
}

fn painted(svg: &str) -> Result<Canvas> {
    let font = FontRef::try_from_slice(dejavu::sans::regular()).context("the embedded font is damaged")?;
    let mut canvas = Canvas::new((SIZE.0 as f32 * DENSITY) as usize, (SIZE.1 as f32 * DENSITY) as usize);
    // Tags can be found by `<` and `>`, because these are escaped in texts and values.
    for element in svg.split('<').skip(1).filter(|element| !element.starts_with('/')) {
        let (tag, text) = element.split_once('>').context("a tag has no end")?;
        let element = Element { tag, text };
        element.paint(&mut canvas, &font).with_context(|| format!("cannot paint <{tag}>"))?;
    }
    Ok(canvas)
}

/// An element of the SVG. `tag`: the text between `<` and `>`; `text`: what follows, up to the next tag.
struct Element<'a> {
    tag: &'a str,
    text: &'a str,
}

impl Element<'_> {
    fn find(&self, name: &str) -> Option<&str> {
        let (_, value) = self.tag.split_once(&format!(" {name}=\""))?;
        value.split('"').next()
    }

    fn value(&self, name: &str) -> Result<&str> {
        self.find(name).with_context(|| format!("no `{name}`"))
    }

    fn number(&self, name: &str) -> Result<f32> {
        let value = self.value(name)?;
        value.parse().with_context(|| format!("{name}=\"{value}\" is no number"))
    }

    fn place(&self, x: &str, y: &str) -> Result<Point> {
        Ok(point(self.number(x)? * SCALE, self.number(y)? * SCALE))
    }

    fn points(&self) -> Result<Vec<Point>> {
        let place = |pair: &str| {
            let (x, y) = pair.split_once(',')?;
            Some(point(x.parse::<f32>().ok()? * SCALE, y.parse::<f32>().ok()? * SCALE))
        };
        self.value("points")?
            .split_whitespace()
            .map(|pair| place(pair).with_context(|| format!("no place: {pair}")))
            .collect()
    }

    /// Returns the stroke width in pixels of the PNG. Default: one unit of the SVG.
    fn width(&self) -> Result<f32> {
        Ok(self.find("stroke-width").map_or(Ok(1.0), |_| self.number("stroke-width"))? * SCALE)
    }

    fn paint(&self, canvas: &mut Canvas, font: &FontRef) -> Result<()> {
        let mut shape = Shape::default();
        let mut paint = "fill";
        match self.tag.split(' ').next().unwrap_or_default() {
            "svg" => return Ok(()),
            "polygon" => shape.polygon(&self.points()?),
            "polyline" => {
                paint = "stroke";
                shape.line(&self.points()?, self.width()?);
            }
            "line" => {
                paint = "stroke";
                shape.line(&[self.place("x1", "y1")?, self.place("x2", "y2")?], self.width()?);
            }
            "rect" => {
                let (at, size) = (self.place("x", "y")?, self.place("width", "height")?);
                let wider = |by: f32| {
                    let (low, high) = (at - point(by, by), at + size + point(by, by));
                    [low, point(high.x, low.y), high, point(low.x, high.y)]
                };
                paint = self.closed(&mut shape, wider)?;
            }
            "circle" => {
                let (centre, radius) = (self.place("cx", "cy")?, self.number("r")? * SCALE);
                let wider = |by: f32| -> [Point; CORNERS as usize] {
                    std::array::from_fn(|corner| {
                        let (sine, cosine) = (corner as f32 / f32::from(CORNERS) * TAU).sin_cos();
                        centre + point(cosine * (radius + by), sine * (radius + by))
                    })
                };
                paint = self.closed(&mut shape, wider)?;
            }
            "text" => self.letters(&mut shape, font)?,
            _ => bail!("an element that no drawing has"),
        }
        canvas.fill(&shape, colour(self.value(paint)?)?, self.number("opacity")?);
        Ok(())
    }

    /// Adds a rectangle or a circle to `shape`. If the element has a stroke, only the edge is added, otherwise the
    /// area. `wider` returns the corners, moved outwards by a number of pixels. Returns the name of the attribute that
    /// has the colour.
    fn closed<const N: usize>(&self, shape: &mut Shape, wider: impl Fn(f32) -> [Point; N]) -> Result<&'static str> {
        if self.value("stroke")? == "none" {
            shape.polygon(&wider(0.0));
            return Ok("fill");
        }
        let half = self.width()? / 2.0;
        let mut inner = wider(-half);
        // The inner outline has the opposite sense of rotation, so that its area is subtracted.
        inner.reverse();
        shape.polygon(&wider(half));
        shape.polygon(&inner);
        Ok("stroke")
    }

    /// Adds the outlines of a text.
    fn letters(&self, shape: &mut Shape, font: &FontRef) -> Result<()> {
        let text = unescaped(self.text.trim());
        let size = self.number("font-size")? * SCALE;
        let unit = size / font.units_per_em().context("a font without a size")?;
        let down = match self.value("dy")?.split_once('e') {
            Some((times, "m")) => times.parse::<f32>()? * size,
            Some((times, "x")) => times.parse::<f32>()? * size * EX,
            _ => bail!("dy in em or ex is needed"),
        };
        let mut glyphs = Vec::new();
        let (mut width, mut before) = (0.0, None);
        for letter in text.chars() {
            let glyph = font.glyph_id(letter);
            width += before.map_or(0.0, |before| font.kern_unscaled(before, glyph)) * unit;
            glyphs.push((glyph, width));
            width += font.h_advance_unscaled(glyph) * unit;
            before = Some(glyph);
        }
        let left = match self.value("text-anchor")? {
            "start" => 0.0,
            "middle" => -width / 2.0,
            "end" => -width,
            other => bail!("no text-anchor: {other}"),
        };
        let origin = self.place("x", "y")?;
        let (sine, cosine) = match self.find("transform") {
            None => (0.0, 1.0),
            Some(turn) => {
                let degrees =
                    turn.strip_prefix("rotate(").and_then(|turn| turn.split(',').next()).context("no turn")?;
                degrees.parse::<f32>()?.to_radians().sin_cos()
            }
        };
        for (glyph, x) in glyphs {
            let place = |at: Point| {
                let (right, below) = (left + x + at.x * unit, down - at.y * unit);
                origin + point(right * cosine - below * sine, right * sine + below * cosine)
            };
            let curves = font.outline(glyph).map_or(Vec::new(), |outline| outline.curves);
            shape.0.extend(curves.into_iter().map(|curve| match curve {
                OutlineCurve::Line(a, b) => OutlineCurve::Line(place(a), place(b)),
                OutlineCurve::Quad(a, b, c) => OutlineCurve::Quad(place(a), place(b), place(c)),
                OutlineCurve::Cubic(a, b, c, d) => OutlineCurve::Cubic(place(a), place(b), place(c), place(d)),
            }));
        }
        Ok(())
    }
}

/// Parses `#RRGGBB`.
fn colour(text: &str) -> Result<[u8; 3]> {
    let number = text.strip_prefix('#').and_then(|digits| u32::from_str_radix(digits, 16).ok());
    let [_, rgb @ ..] = number.with_context(|| format!("no colour: {text}"))?.to_be_bytes();
    Ok(rgb)
}

fn unescaped(text: &str) -> String {
    let signs = [("&lt;", "<"), ("&gt;", ">"), ("&quot;", "\""), ("&apos;", "'"), ("&amp;", "&")];
    signs.iter().fold(text.to_owned(), |text, (written, sign)| text.replace(written, sign))
}

/// The outlines of an area to be filled, in pixels.
#[derive(Default)]
struct Shape(Vec<OutlineCurve>);

impl Shape {
    fn polygon(&mut self, corners: &[Point]) {
        let next = corners.iter().cycle().skip(1);
        self.0.extend(corners.iter().zip(next).map(|(a, b)| OutlineCurve::Line(*a, *b)));
    }

    /// Adds the area of a line of this width through `points`.
    fn line(&mut self, points: &[Point], width: f32) {
        let half = width / 2.0;
        let mut before: Option<Point> = None;
        for pair in points.windows(2) {
            let way = pair[1] - pair[0];
            let length = way.x.hypot(way.y);
            if length == 0.0 {
                continue;
            }
            let side = point(-way.y / length * half, way.x / length * half);
            self.polygon(&[pair[0] - side, pair[1] - side, pair[1] + side, pair[0] + side]);
            if let Some(before) = before {
                let turn = before.x * side.y - before.y * side.x;
                let zero = point(0.0, 0.0);
                let (a, b) = if turn > 0.0 { (zero - before, zero - side) } else { (side, before) };
                // `a` and `b` lead from the corner to the outer edges of the two pieces of the line. (a + b) * `reach`
                // leads from the corner to the tip of the mitre.
                let open = half * half + a.x * b.x + a.y * b.y;
                let reach = half * half / open;
                let tip = pair[0] + point((a.x + b.x) * reach, (a.y + b.y) * reach);
                if 2.0 * half * half <= MITRE_LIMIT2 * open {
                    self.polygon(&[pair[0], pair[0] + a, tip, pair[0] + b]);
                } else {
                    self.polygon(&[pair[0], pair[0] + a, pair[0] + b]);
                }
            }
            before = Some(side);
        }
    }

    /// Returns all points of the outlines, including the control points of curves. All areas are inside the bounds of
    /// these points.
    fn points(&self) -> impl Iterator<Item = Point> {
        self.0.iter().flat_map(|curve| match *curve {
            OutlineCurve::Line(a, b) => [a, b, a, b],
            OutlineCurve::Quad(a, b, c) => [a, b, c, a],
            OutlineCurve::Cubic(a, b, c, d) => [a, b, c, d],
        })
    }
}

/// Pixels (red, green, blue) in rows from top to bottom, from left to right.
struct Canvas {
    width: usize,
    pixels: Vec<[u8; 3]>,
}

impl Canvas {
    /// Makes a white canvas.
    fn new(width: usize, height: usize) -> Self {
        Self { width, pixels: vec![[255; 3]; width * height] }
    }

    fn height(&self) -> usize {
        self.pixels.len() / self.width
    }

    /// Paints an area with a colour. Parts outside the canvas are ignored.
    fn fill(&mut self, shape: &Shape, colour: [u8; 3], opacity: f32) {
        let edge = point(self.width as f32, self.height() as f32);
        let inside = |at: Point| point(at.x.clamp(0.0, edge.x), at.y.clamp(0.0, edge.y));
        let (mut low, mut high) = (edge, point(0.0, 0.0));
        for at in shape.points().map(inside) {
            low = point(low.x.min(at.x.floor()), low.y.min(at.y.floor()));
            high = point(high.x.max(at.x.ceil()), high.y.max(at.y.ceil()));
        }
        if low.x >= high.x || low.y >= high.y {
            return;
        }
        // For an edge in the last column, the rasterizer also writes into the column to the right of it. So add a
        // column.
        let (width, height) = ((high.x - low.x) as usize + 1, (high.y - low.y) as usize);
        let mut covered = Rasterizer::new(width, height);
        let place = |at: Point| inside(at) - low;
        for curve in &shape.0 {
            match *curve {
                OutlineCurve::Line(a, b) => covered.draw_line(place(a), place(b)),
                OutlineCurve::Quad(a, b, c) => covered.draw_quad(place(a), place(b), place(c)),
                OutlineCurve::Cubic(a, b, c, d) => covered.draw_cubic(place(a), place(b), place(c), place(d)),
            }
        }
        let (left, top) = (low.x as usize, low.y as usize);
        covered.for_each_pixel(|index, share| {
            let (x, y) = (left + index % width, top + index / width);
            let share = share.min(1.0) * opacity;
            if share > 0.0 && x < self.width {
                let pixel = &mut self.pixels[y * self.width + x];
                for (old, new) in pixel.iter_mut().zip(colour) {
                    *old = (f32::from(*old) + (f32::from(new) - f32::from(*old)) * share).round() as u8;
                }
            }
        });
    }

    /// Returns the PNG file: eight bits each of red, green and blue, rows unfiltered, deflated.
    fn packed(&self) -> Vec<u8> {
        let mut rows = Vec::with_capacity(self.pixels.len() * 3 + self.height());
        for row in self.pixels.chunks(self.width) {
            rows.push(0);
            rows.extend(row.iter().flatten());
        }
        let size = [self.width as u32, self.height() as u32].map(u32::to_be_bytes);
        let mut file = b"\x89PNG\r\n\x1a\n".to_vec();
        chunk(&mut file, b"IHDR", &[size.as_flattened(), &[8, 2, 0, 0, 0]].concat());
        chunk(&mut file, b"IDAT", &miniz_oxide::deflate::compress_to_vec_zlib(&rows, 6));
        chunk(&mut file, b"IEND", &[]);
        file
    }
}

fn chunk(file: &mut Vec<u8>, kind: &[u8; 4], data: &[u8]) {
    let named = [kind, data].concat();
    file.extend((data.len() as u32).to_be_bytes());
    file.extend(&named);
    // PNG uses the CRC-32 of ISO 3309.
    file.extend(crc::Crc::<u32>::new(&crc::CRC_32_ISO_HDLC).checksum(&named).to_be_bytes());
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Paints `elements`, in which all numbers are in pixels of the PNG. Returns a function that gives the darkness of
    /// a pixel, from 0 to 1.
    fn darkness(elements: &str) -> impl Fn(usize, usize) -> f32 + use<> {
        let scaled = |part: &str| match part.parse::<f32>() {
            Ok(number) => (number / SCALE).to_string(),
            Err(_) => part.to_owned(),
        };
        let mut svg = String::new();
        // Numbers are delimited by quotes, commas and spaces.
        for part in elements.split_inclusive(['"', ',', ' ']) {
            let number = part.trim_end_matches(['"', ',', ' ']);
            svg += &scaled(number);
            svg += &part[number.len()..];
        }
        let canvas = painted(&svg.replace("SOLID", "opacity=\"1\"")).unwrap();
        move |x, y| 1.0 - f32::from(canvas.pixels[y * canvas.width + x][0]) / 255.0
    }

    /// Returns the sum of the darkness of all pixels in a square at the origin, whose sides are `side` pixels long.
    fn area(darkness: impl Fn(usize, usize) -> f32, side: usize) -> f32 {
        (0..side * side).map(|index| darkness(index % side, index / side)).sum()
    }

    fn near(a: f32, b: f32, within: f32) {
        assert!((a - b).abs() <= within, "{a} instead of {b}");
    }

    #[test]
    fn an_area_covers_its_share_of_each_pixel() {
        let dark = darkness(r##"<rect x="10" y="20.25" width="5.5" height="3" SOLID fill="#000000" stroke="none"/>"##);
        for (x, y, share) in [
            (9, 21, 0.0),
            (10, 21, 1.0),
            (14, 22, 1.0),
            (15, 22, 0.5),
            (16, 22, 0.0),
            (12, 19, 0.0),
            (12, 20, 0.75),
            (12, 23, 0.25),
            (15, 23, 0.125),
        ] {
            near(dark(x, y), share, 0.003);
        }
        let dark = darkness(r##"<polygon SOLID fill="#000000" points="10,10 50,10 10,30 "/>"##);
        near(area(dark, 60), 400.0, 1.0);
    }

    #[test]
    fn colours_are_mixed_by_opacity() {
        let rect = r##"x="0" y="0" width="5000" height="5000" stroke="none""##;
        let canvas = painted(&format!(
            r##"<rect {rect} opacity="1" fill="#FF8000"/><rect {rect} opacity="0.25" fill="#0000FF"/>"##
        ));
        assert_eq!(canvas.unwrap().pixels[0], [191, 96, 64]);
    }

    #[test]
    fn lines_are_as_wide_as_they_should_and_corners_are_whole() {
        let dark = darkness(r##"<line SOLID stroke="#000000" stroke-width="3" x1="10" y1="20.5" x2="40" y2="20.5"/>"##);
        assert_eq!([18, 19, 20, 21, 22].map(|y| dark(25, y)), [0.0, 1.0, 1.0, 1.0, 0.0]);
        assert_eq!([9, 10, 39, 40].map(|x| dark(x, 20)), [0.0, 1.0, 1.0, 0.0]);
        // These lines have turns to the left and to the right, and a piece of length 0.
        for points in ["10,10 40,10 40,40", "40,40 40,10 10,10", "10,40 10,10 40,10", "40,10 10,10 10,10 10,40"] {
            let dark = darkness(&format!(
                r##"<polyline fill="none" SOLID stroke="#000000" stroke-width="4" points="{points} "/>"##
            ));
            near(area(&dark, 60), 4.0 * 60.0, 0.5);
            let corner = if points.contains("40,10 40,40") || points.contains("40,40 40,10") { 41 } else { 8 };
            assert_eq!(dark(corner, 8), 1.0, "{points}");
        }
        // A line that turns back at a sharp angle gets no tip, because the tip would be too long.
        let dark = darkness(r##"<polyline SOLID stroke="#000000" stroke-width="4" points="10,10 40,10 12,10.5 "/>"##);
        assert_eq!((44..60).map(|x| dark(x, 10)).sum::<f32>(), 0.0);
    }

    #[test]
    fn edges_of_closed_shapes_leave_the_inside_free() {
        let dark =
            darkness(r##"<circle cx="30" cy="30" r="9" SOLID fill="none" stroke="#000000" stroke-width="3.75"/>"##);
        near(area(&dark, 60), TAU * 9.0 * 3.75, 1.0);
        assert_eq!((dark(30, 30), dark(38, 30), dark(30, 21)), (0.0, 1.0, 1.0));
        let dark = darkness(
            r##"<rect x="10" y="10" width="20" height="10" SOLID fill="none" stroke="#000000" stroke-width="2"/>"##,
        );
        near(area(&dark, 60), 22.0 * 12.0 - 18.0 * 8.0, 0.5);
        assert_eq!((dark(9, 9), dark(20, 15), dark(30, 20)), (1.0, 0.0, 1.0));
    }

    /// Minimum and maximum column and row that a text darkens.
    fn extent(words: &str, text: &str) -> [usize; 4] {
        let words = format!(r##"font-family="sans-serif" font-size="40" SOLID fill="#000000" {words}"##);
        let dark = darkness(&format!("<text x=\"200\" y=\"300\" {words}>\n{text}\n</text>"));
        let inked = (0..600 * 600).map(|index| (index % 600, index / 600)).filter(|(x, y)| dark(*x, *y) > 0.5);
        inked.fold([usize::MAX, 0, usize::MAX, 0], |[a, b, c, d], (x, y)| [a.min(x), b.max(x), c.min(y), d.max(y)])
    }

    #[test]
    fn text_stands_where_the_svg_says() {
        // A capital letter of this font has a height of 0.729 times the font size: 29 pixels at the size 40.
        let [left, right, top, bottom] = extent(r#"dy="0.76em" text-anchor="start""#, "HHHH");
        assert_eq!((left, bottom), (204, 329), "a letter begins a tenth of the size beside its place");
        assert!(right.abs_diff(200 + 116) <= 1 && top.abs_diff(301) <= 1, "{right} {top}");
        let [left, right, ..] = extent(r#"dy="0.76em" text-anchor="middle""#, "HHHH");
        assert!((left + right).abs_diff(399) <= 1, "{left} {right}");
        let [_, right, top, bottom] = extent(r#"dy="0.5ex" text-anchor="end""#, "HHHH");
        assert_eq!((right, bottom), (195, 309));
        assert!(top.abs_diff(281) <= 1);
        // The text runs upwards; the tops of its letters are at the left.
        let turned = r#"dy="0.76em" text-anchor="start" transform="rotate(270, 200, 300)""#;
        let [left, right, top, bottom] = extent(turned, "HHHH");
        assert_eq!((right, bottom), (229, 295));
        assert!(left.abs_diff(201) <= 1 && top.abs_diff(184) <= 1, "{left} {top}");
        assert_eq!(unescaped("&lt;&amp;lt;&quot;"), "<&lt;\"");
    }

    #[test]
    fn what_is_beside_the_sheet_is_left_out() {
        let dark = darkness(
            r##"<polyline SOLID stroke="#000000" stroke-width="2" points="-50,1 5000,1 5000,5000 -50,5000 "/>"##,
        );
        assert_eq!((dark(0, 0), dark(2099, 1), dark(2099, 2), dark(0, 1559)), (1.0, 1.0, 0.0, 0.0));
    }

    #[test]
    fn an_element_that_no_drawing_has_is_an_error() {
        let error = png("<svg width=\"1\"><ellipse rx=\"1\"/></svg>").unwrap_err();
        assert_eq!(format!("{error:#}"), "cannot paint <ellipse rx=\"1\"/>: an element that no drawing has");
    }

    #[test]
    fn the_file_is_a_png() {
        let file = png(r##"<rect x="0" y="0" width="10" height="10" opacity="1" fill="#010203" stroke="none"/>"##);
        let file = file.unwrap();
        let mut rest = file.strip_prefix(b"\x89PNG\r\n\x1a\n").unwrap();
        let mut chunks = Vec::new();
        while let Some((length, after)) = rest.split_first_chunk() {
            let (named, after) = after.split_at(u32::from_be_bytes(*length) as usize + 4);
            let (sum, after) = after.split_first_chunk().unwrap();
            assert_eq!(crc::Crc::<u32>::new(&crc::CRC_32_ISO_HDLC).checksum(named), u32::from_be_bytes(*sum));
            chunks.push(named.split_at(4));
            rest = after;
        }
        let [(b"IHDR", head), (b"IDAT", data), (b"IEND", [])] = chunks[..] else { panic!("other chunks") };
        assert_eq!(
            head,
            [0, 0, 8, 52, 0, 0, 6, 24, 8, 2, 0, 0, 0],
            "2100 by 1560, eight bits each of red, green, blue"
        );
        assert!(file.ends_with(&[0xAE, 0x42, 0x60, 0x82]), "the sum that each PNG ends with");
        let rows = miniz_oxide::inflate::decompress_to_vec_zlib(data).unwrap();
        assert_eq!((rows.len(), &rows[..8]), (1560 * (2100 * 3 + 1), &[0, 1, 2, 3, 128, 129, 129, 255][..]));
    }
}
