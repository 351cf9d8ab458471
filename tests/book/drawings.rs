//! Drawings of the boards' wiring (`docs/pictures/boards`), made from the boards' pin tables. A drawing shows the
//! pins, the names printed beside them, and their functions, in a colour for each kind.

use crate::boards::SECTIONS;
use crate::wiring::{Group, Kind, Way, Wire, groups};
use crate::{keep, root, writes};
use oxmill_tables::Board;
use std::collections::BTreeSet;
use std::fmt::{Display, Write};
use std::fs;

const FOLDER: &str = "docs/pictures/boards";
/// Maximum size of a drawing, bytes.
const MOST_BYTES: usize = 25_000;

/// For each kind of pin, its colour and its name in the legend. White text on each colour has a contrast ratio of 4.5
/// or more.
const COLOURS: [(Kind, &str, &str); 8] = [
    (Kind::Motors, "#1f6fb2", "motors"),
    (Kind::Spindle, "#7c3aed", "spindle, laser"),
    (Kind::Coolant, "#0f766e", "coolant"),
    (Kind::Outputs, "#4d7c0f", "outputs of programs"),
    (Kind::Switches, "#b45309", "switches, probe"),
    (Kind::Buttons, "#b91c1c", "buttons, safety"),
    (Kind::Inputs, "#9d174d", "inputs of programs"),
    (Kind::Host, "#374151", "host"),
];
const STYLE: &str = r##"<style>
text{font:13px system-ui,-apple-system,"Segoe UI",Roboto,"DejaVu Sans",sans-serif;fill:#1f2933}
.t{font-size:19px;font-weight:600}
.s{font-size:12px;fill:#52606d}
.h{font-size:12px;font-weight:600}
.p{font:600 12px ui-monospace,Menlo,Consolas,"DejaVu Sans Mono",monospace;fill:#fff;text-anchor:middle}
.l{font:12px ui-monospace,Menlo,Consolas,"DejaVu Sans Mono",monospace}
.u{font:12px ui-monospace,Menlo,Consolas,"DejaVu Sans Mono",monospace;fill:#7b8794}
.e{text-anchor:end}
.m{text-anchor:middle}
.b{fill:#e9f0ea;stroke:#5b7a67;stroke-width:1.5}
.w{fill:none;stroke-width:1.5}
</style>
"##;
const WIDTH: i32 = 940;

fn colour(kind: Kind) -> &'static str {
    COLOURS.iter().find(|(own, ..)| *own == kind).map_or("", |(_, colour, _)| colour)
}

/// Returns all pins, with the kinds of their groups.
fn all(groups: &[Group]) -> impl Iterator<Item = (Kind, &Wire)> {
    groups.iter().flat_map(|group| group.wires.iter().map(move |wire| (group.kind, wire)))
}

/// Side to which the line, the arrow and the text of a pin extend.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Side {
    Left,
    Right,
}

impl Side {
    /// Returns the x coordinate that lies `distance` beyond the edge `edge`, on this side.
    fn out(self, edge: i32, distance: i32) -> i32 {
        if self == Side::Left { edge - distance } else { edge + distance }
    }

    /// Returns the CSS class of a text on this side of the board. On the left, the class `e` (`text-anchor:end`) aligns
    /// the right end of the text with its coordinate.
    fn class(self) -> &'static str {
        if self == Side::Left { "e" } else { "" }
    }
}

#[derive(Default)]
struct Svg {
    body: String,
}

impl Svg {
    fn add(&mut self, element: impl Display) {
        let _ = writeln!(self.body, "{element}");
    }

    fn text(&mut self, (x, y): (i32, i32), class: &str, text: &str) {
        let text = text.replace('&', "&amp;").replace('<', "&lt;");
        let class = if class.is_empty() { String::new() } else { format!(" class=\"{class}\"") };
        self.add(format_args!("<text x=\"{x}\" y=\"{y}\"{class}>{text}</text>"));
    }

    fn rect(&mut self, (x, y): (i32, i32), (width, height): (i32, i32), rest: &str) {
        self.add(format_args!("<rect x=\"{x}\" y=\"{y}\" width=\"{width}\" height=\"{height}\" {rest}/>"));
    }

    fn line(&mut self, path: impl Display, colour: &str) {
        self.add(format_args!("<path class=\"w\" stroke=\"{colour}\" d=\"{path}\"/>"));
    }

    /// Draws the name of a pin on the colour of its kind, centred at `(x, y)`.
    fn chip(&mut self, (x, y): (i32, i32), kind: Kind, pin: &str) {
        self.rect((x - 21, y - 9), (42, 18), &format!("rx=\"4\" fill=\"{}\"", colour(kind)));
        self.text((x, y + 4), "p", pin);
    }

    /// Draws a triangle that points in the direction of the signal. The arrow of an output points to the side `out`,
    /// that of an input to the other side.
    fn arrow(&mut self, (x, y): (i32, i32), out: Side, wire: &Wire, kind: Kind) {
        let points_left = match wire.way {
            Way::Output => out == Side::Left,
            Way::Input | Way::Switch => out == Side::Right,
            Way::Both => return,
        };
        let (from, to) = if points_left { (4, -7) } else { (-4, 7) };
        let path = format!("M{} {}v10l{to} -5z", x + from, y - 5);
        self.add(format_args!("<path fill=\"{}\" d=\"{path}\"/>", colour(kind)));
    }

    /// Draws a switch to ground.
    fn switch(&mut self, (x, y): (i32, i32), kind: Kind) {
        self.line(format_args!("M{x} {y}h6l11 -7M{} {y}h6v4m-5 0h10m-8 3h6m-4 3h2", x + 17), colour(kind));
    }

    /// Draws the text of a pin's function at `place`, followed by MOSFET if the connector has one.
    fn function(&mut self, place: (i32, i32), class: &str, wire: &Wire) {
        let mosfet = if wire.has_mosfet() { " <tspan class=\"s\">MOSFET</tspan>" } else { "" };
        let class = if class.is_empty() { String::new() } else { format!(" class=\"{class}\"") };
        let (x, y) = place;
        self.add(format_args!("<text x=\"{x}\" y=\"{y}\"{class}>{}{mosfet}</text>", wire.text));
    }

    /// Draws the legend: the colours of the kinds of pins on this board, and below them `lines`, which explain the
    /// signs. Returns the y coordinate of the lower end of the legend.
    fn legend(&mut self, y: i32, groups: &[Group], lines: &[&str]) -> i32 {
        let mut x = 20;
        for (kind, colour, name) in COLOURS {
            if groups.iter().any(|group| group.kind == kind) {
                self.rect((x, y - 10), (12, 12), &format!("rx=\"2\" fill=\"{colour}\""));
                self.text((x + 17, y), "s", name);
                x += 32 + name.len() as i32 * 6;
            }
        }
        for (at, line) in lines.iter().enumerate() {
            self.text((20, y + 20 + 17 * at as i32), "s", line);
        }
        y + 20 + 17 * lines.len() as i32
    }

    /// Draws the heading. It shows the title, and the name and the chip of each board.
    fn heading(&mut self, title: &str, boards: &[Board]) {
        self.text((WIDTH / 2, 30), "t m", title);
        let names: Vec<String> = boards.iter().map(|board| format!("{} ({})", board.name, board.chip.name)).collect();
        self.text((WIDTH / 2, 50), "s m", &names.join(", "));
    }

    fn finished(self, title: &str, height: i32) -> String {
        let Svg { body } = self;
        format!(
            "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {WIDTH} {height}\" width=\"{WIDTH}\" height=\"{height}\" role=\"img\">\n\
             <title>Wiring: {title}</title>\n{STYLE}<rect width=\"{WIDTH}\" height=\"{height}\" rx=\"8\" fill=\"#fcfcfa\"/>\n{body}</svg>\n"
        )
    }
}

const ARROWS: &str = "Triangle away from the pin: output, 0 or 3.3 V. Triangle to the pin: input, at most 3.3 V; \
    a switch connects it to ground.";
const MOSFETS: &str = "MOSFET: while the output is on, the connector joins the load to ground; its other pin has the voltage of the supply \
    or of a jumper.";
const FOURTH: &str = "Fourth motor: the second motor of an axis ($905)";
const OR_A: &str = ", or axis A ($930=4)";

fn signs(boards: &[Board], groups: &[Group]) -> Vec<String> {
    let wires = || groups.iter().flat_map(|group| &group.wires);
    let mut signs = vec![ARROWS.to_owned()];
    if wires().any(Wire::has_mosfet) {
        signs.push(MOSFETS.to_owned());
    }
    let with_a: Vec<&str> =
        boards.iter().filter(|board| board.image.axes > 3).map(|board| board.name.as_str()).collect();
    let or_a = match with_a.len() {
        0 => String::new(),
        all if all == boards.len() => OR_A.to_owned(),
        _ => format!("{OR_A} of {}", with_a.join(", ")),
    };
    signs.push(format!("{FOURTH}{or_a}."));
    signs
}

/// Layout of a control board: `EDGES` are the x coordinates of its left and right edge. `CAPTION`, `ROW` and `GAP` are
/// the heights of a group's caption, of a pin's row and of the gap between groups. `TOP` is the y coordinate of the
/// first group.
const EDGES: (i32, i32) = (305, 635);
const CAPTION: i32 = 24;
const ROW: i32 = 22;
const GAP: i32 = 10;
const TOP: i32 = 96;

/// Draws groups along an edge of the board. Returns the y coordinate of their lower end.
fn beside(svg: &mut Svg, groups: &[&Group], side: Side) -> i32 {
    let edge = if side == Side::Left { EDGES.0 } else { EDGES.1 };
    let mut y = TOP;
    for group in groups {
        let tint = colour(group.kind);
        let height = CAPTION + ROW * group.wires.len() as i32 + 4;
        let x = if side == Side::Left { 14 } else { edge + 8 };
        let band = format!("rx=\"6\" fill=\"{tint}\" fill-opacity=\".09\"");
        svg.rect((x, y), (WIDTH - 22 - EDGES.1, height), &band);
        svg.text((x + 12, y + 17), "h", group.title);
        for (at, wire) in group.wires.iter().enumerate() {
            let middle = y + CAPTION + ROW * at as i32 + ROW / 2 - 2;
            svg.line(format_args!("M{edge} {middle}H{}", side.out(edge, 30)), tint);
            svg.rect((edge - 5, middle - 5), (10, 10), &format!("fill=\"{tint}\""));
            svg.arrow((side.out(edge, 17), middle), side, wire, group.kind);
            svg.chip((side.out(edge, 51), middle), group.kind, &wire.pin);
            svg.function((side.out(edge, 80), middle + 4), side.class(), wire);
            if wire.way == Way::Switch {
                svg.switch((WIDTH - 56, middle), group.kind);
            }
        }
        labels(svg, group, side, edge, y + CAPTION + ROW / 2 - 2);
        y += height + GAP;
    }
    y - GAP
}

/// Draws the names printed on the board beside the pins of a group. Neighbouring pins with the same name share one
/// text.
fn labels(svg: &mut Svg, group: &Group, side: Side, edge: i32, first: i32) {
    let mut at = 0;
    for same in group.wires.chunk_by(|one, other| one.label == other.label && !one.label.is_empty()) {
        let (begin, end) = (first + ROW * at, first + ROW * (at + same.len() as i32 - 1));
        let inside = if side == Side::Left { Side::Right } else { Side::Left };
        let mut x = inside.out(edge, 12);
        if same.len() > 1 {
            svg.line(format_args!("M{x} {}V{}", begin - 5, end + 5), colour(group.kind));
            x = inside.out(edge, 18);
        }
        let label = same.first().map_or("", |wire| wire.label.as_str());
        svg.text((x, (begin + end) / 2 + 4), if side == Side::Left { "l" } else { "l e" }, label);
        at += same.len() as i32;
    }
}

/// Draws a header with two rows of five pins. Most control boards have two such headers.
fn header(svg: &mut Svg, name: &str, x: i32, y: i32, groups: &[Group]) {
    svg.text((x, y - 6), "h", name);
    for number in 1..=10 {
        let (left, top) = (x + (number - 1) / 2 * 62, y + (number - 1) % 2 * 22);
        let label = format!("{name}-{number}");
        let used = all(groups).find(|(_, wire)| wire.label == label);
        let fixed = match (name, number) {
            (_, 9) => " GND",
            ("EXP1", 10) => " 5 V",
            ("EXP2", 8) => " RST",
            _ => "",
        };
        let (fill, class, text) = match used {
            Some((kind, wire)) => (colour(kind), "p", format!("{number} {}", wire.pin)),
            None => ("#fff", "u m", format!("{number}{fixed}")),
        };
        svg.rect((left, top), (60, 20), &format!("rx=\"3\" fill=\"{fill}\" stroke=\"#9aa5b1\" stroke-width=\".5\""));
        svg.text((left + 30, top + 14), class, &text);
    }
}

const HEADERS: &str = "Find 9 (ground) first: makers and maps number these headers in different ways. Pins without a function stay unconnected.";

/// Draws a board with connectors that have names.
fn control_board(title: &str, board: &Board) -> String {
    let groups = groups(board);
    let is_left = |group: &&Group| [Kind::Motors, Kind::Spindle, Kind::Coolant, Kind::Outputs].contains(&group.kind);
    let (left, right): (Vec<&Group>, Vec<&Group>) = groups.iter().partition(is_left);
    let mut svg = Svg::default();
    svg.heading(title, std::slice::from_ref(board));
    let mut inner = Svg::default();
    let lower = beside(&mut inner, &left, Side::Left).max(beside(&mut inner, &right, Side::Right));
    svg.rect((EDGES.0, TOP - 22), (EDGES.1 - EDGES.0, lower - TOP + 30), "rx=\"8\" class=\"b\"");
    let middle = WIDTH / 2;
    svg.rect((middle - 26, TOP - 30), (52, 20), "rx=\"3\" fill=\"#9aa5b1\"");
    svg.text((middle, TOP - 16), "h m", "USB");
    svg.body += &inner.body;
    let chip = (middle + 4, lower - 76);
    svg.rect(chip, (72, 72), "rx=\"4\" fill=\"#27323a\"");
    svg.text((chip.0 + 36, chip.1 + 33), "p", "STM32");
    svg.text((chip.0 + 36, chip.1 + 50), "p", board.chip.name.trim_start_matches("STM32"));
    let mut y = lower + 34;
    let has_headers = groups.iter().flat_map(|group| &group.wires).any(|wire| wire.label.starts_with("EXP"));
    if has_headers {
        header(&mut svg, "EXP1", 20, y + 4, &groups);
        header(&mut svg, "EXP2", WIDTH - 20 - 308, y + 4, &groups);
        svg.text((20, y + 66), "s", HEADERS);
        y += 96;
    }
    let signs = signs(std::slice::from_ref(board), &groups);
    let lines: Vec<&str> = signs.iter().map(String::as_str).collect();
    let height = svg.legend(y, &groups, &lines) + 4;
    svg.finished(title, height)
}

/// The pins of a Black Pill, from the USB socket down.
const BLACK_PILL: ([&str; 20], [&str; 20]) = (
    [
        "B12", "B13", "B14", "B15", "A8", "A9", "A10", "A11", "A12", "A15", "B3", "B4", "B5", "B6", "B7", "B8", "B9",
        "5V", "GND", "3V3",
    ],
    [
        "5V", "GND", "3V3", "B10", "B2", "B1", "B0", "A7", "A6", "A5", "A4", "A3", "A2", "A1", "A0", "RST", "C15",
        "C14", "C13", "VBAT",
    ],
);
/// Pins of a Black Pill to which parts on the board itself are connected. The second text names the part or the use.
const OWN_USES: [(&str, &str); 5] =
    [("B2", "BOOT1"), ("C13", "LED"), ("C14", "32 kHz crystal"), ("C15", "32 kHz crystal"), ("A0", "KEY")];

/// Draws a Black Pill with its two rows of pins.
fn black_pill(title: &str, boards: &[Board]) -> String {
    const EDGE: (i32, i32) = (385, 555);
    const PITCH: i32 = 25;
    let groups = groups(&boards[0]);
    let mut svg = Svg::default();
    svg.heading(title, boards);
    let (top, middle) = (92, WIDTH / 2);
    let bottom = top + 20 * PITCH;
    svg.rect((EDGE.0, top), (EDGE.1 - EDGE.0, bottom - top + 12), "rx=\"8\" class=\"b\"");
    svg.rect((middle - 30, top - 14), (60, 24), "rx=\"4\" fill=\"#9aa5b1\"");
    svg.text((middle, top + 2), "h m", "USB-C");
    svg.rect((middle - 32, bottom + 2), (64, 20), "rx=\"3\" fill=\"#9aa5b1\"");
    svg.text((middle, bottom + 16), "h m", "SWD");
    svg.rect((middle - 36, top + 212), (72, 72), "rx=\"4\" fill=\"#27323a\"");
    svg.text((middle, top + 244), "p", "STM32");
    let families: Vec<&str> = boards.iter().map(|board| &board.chip.name["STM32F".len().."STM32F411".len()]).collect();
    svg.text((middle, top + 262), "p", &format!("F{}", families.join("/")));
    let mut drawn = 0;
    for (side, edge, pins) in [(Side::Left, EDGE.0, BLACK_PILL.0), (Side::Right, EDGE.1, BLACK_PILL.1)] {
        for (row, pin) in pins.into_iter().enumerate() {
            let y = top + PITCH * row as i32 + 20;
            let used = all(&groups).find(|(_, wire)| wire.pin == pin);
            let own = OWN_USES.iter().find(|(own, _)| *own == pin).map_or("", |(_, what)| what);
            let print = (side.out(edge, -16), y + 4);
            svg.text(print, if side == Side::Left { "l" } else { "l e" }, pin);
            let Some((kind, wire)) = used else {
                svg.rect((edge - 5, y - 5), (10, 10), "rx=\"5\" fill=\"#fff\" stroke=\"#9aa5b1\"");
                svg.text((side.out(edge, 16), y + 4), &format!("s {}", side.class()), own);
                continue;
            };
            drawn += 1;
            let tint = colour(kind);
            svg.line(format_args!("M{edge} {y}H{}", side.out(edge, 34)), tint);
            svg.rect((edge - 5, y - 5), (10, 10), &format!("rx=\"5\" fill=\"{tint}\""));
            svg.arrow((side.out(edge, 19), y), side, wire, kind);
            let band = side.out(edge, 34) - if side == Side::Left { 316 } else { 0 };
            svg.rect((band, y - 10), (316, 20), &format!("rx=\"4\" fill=\"{tint}\" fill-opacity=\".12\""));
            let text = if own.is_empty() { wire.text.to_owned() } else { format!("{} ({own})", wire.text) };
            svg.text((side.out(edge, 44), y + 4), side.class(), &text);
            if wire.way == Way::Switch {
                svg.switch((if side == Side::Left { 44 } else { WIDTH - 74 }, y), kind);
            }
        }
    }
    assert_eq!(drawn, groups.iter().map(|group| group.wires.len()).sum::<usize>(), "{title}: each pin has its place");
    let signs = signs(boards, &groups);
    let lines: Vec<&str> = signs.iter().map(String::as_str).collect();
    let height = svg.legend(bottom + 50, &groups, &lines) + 4;
    svg.finished(title, height)
}

/// Pins of the Arduino headers of a Nucleo-64: the name printed on the board, and the row of the pin. Row 1 is the
/// first row of the connector beside it, CN7 on the left or CN10 on the right.
const ARDUINO_LEFT: [(&str, i32); 11] = [
    ("3V3", 8),
    ("5V", 9),
    ("GND", 10),
    ("GND", 11),
    ("VIN", 12),
    ("A0", 14),
    ("A1", 15),
    ("A2", 16),
    ("A3", 17),
    ("A4", 18),
    ("A5", 19),
];
const ARDUINO_RIGHT: [(&str, i32); 17] = [
    ("D15", 2),
    ("D14", 3),
    ("GND", 5),
    ("D13", 6),
    ("D12", 7),
    ("D11", 8),
    ("D10", 9),
    ("D9", 10),
    ("D8", 11),
    ("D7", 12),
    ("D6", 13),
    ("D5", 14),
    ("D4", 15),
    ("D3", 16),
    ("D2", 17),
    ("D1", 18),
    ("D0", 19),
];

/// Draws a Nucleo-64 with its headers.
fn nucleo(title: &str, boards: &[Board]) -> String {
    const PITCH: i32 = 25;
    /// x coordinates: of the board's left and right edge, then of the pin rows of its headers, from left to right.
    const EDGE: (i32, i32) = (187, 753);
    const CN7: (i32, i32) = (198, 216);
    const ARDUINO: (i32, i32) = (248, 692);
    const CN10: (i32, i32) = (724, 742);
    let groups = groups(&boards[0]);
    let all: Vec<(Kind, &Wire)> = all(&groups).collect();
    let links = groups.iter().find(|group| group.kind == Kind::Host);
    let mut svg = Svg::default();
    svg.heading(title, boards);
    let (top, middle) = (182, WIDTH / 2);
    let at = |row: i32| top + PITCH * (row - 1);
    svg.rect((EDGE.0, 70), (EDGE.1 - EDGE.0, at(19) + 22 - 70), "rx=\"8\" class=\"b\"");
    svg.rect((middle - 30, 62), (60, 20), "rx=\"3\" fill=\"#9aa5b1\"");
    svg.text((middle, 76), "h m", "USB");
    svg.text((middle, 98), "s m", "ST-LINK: its serial port is the link to the host, by the pins");
    for (x, wire) in [middle - 110, middle + 20].into_iter().zip(links.map(|group| &group.wires).into_iter().flatten())
    {
        svg.chip((x, 113), Kind::Host, &wire.pin);
        svg.text((x + 27, 117), "", wire.text);
    }
    svg.text((middle, 136), "s m", "which are not connected to D1 and D0");
    svg.rect(
        (ARDUINO.0 - 14, at(2) - 16),
        (ARDUINO.1 - ARDUINO.0 + 28, at(19) - at(2) + 32),
        "rx=\"6\" fill=\"#fff\" fill-opacity=\".6\" stroke=\"#5b7a67\" stroke-dasharray=\"5 4\"",
    );
    svg.text((middle, at(2) + 4), "s m", "CNC shield on the");
    svg.text((middle, at(3) - 4), "s m", "Arduino headers");
    let mut drawn = 2;
    for (name, (odd, even)) in [("CN7", CN7), ("CN10", CN10)] {
        svg.text(((odd + even) / 2, at(1) - 44), "h m", name);
        for number in 1..=38 {
            let (row, x) = ((number + 1) / 2, if number % 2 == 1 { odd } else { even });
            let label = format!("{name}-{number}");
            let used = all.iter().find(|(_, wire)| wire.label == label);
            let fill = used.map_or("#fff", |(kind, _)| colour(*kind));
            svg.rect((x - 4, at(row) - 4), (8, 8), &format!("fill=\"{fill}\" stroke=\"#9aa5b1\" stroke-width=\".5\""));
            let Some((kind, wire)) = used else { continue };
            drawn += 1;
            let (side, edge) = if name == "CN7" { (Side::Left, EDGE.0) } else { (Side::Right, EDGE.1) };
            // In the first row, the line of the inner pin would cover the line of the outer pin. So the line and the
            // text of the inner pin are 24 units higher.
            let is_inner = row == 1 && (x == CN7.1 || x == CN10.0);
            let y = if is_inner { at(1) - 24 } else { at(row) };
            let end = side.out(edge, 18);
            let path = match is_inner {
                true => format!("M{x} {}L{} {y}H{end}", at(row), side.out(x, 14)),
                false => format!("M{x} {y}H{end}"),
            };
            svg.line(path, colour(*kind));
            svg.arrow((side.out(edge, 10), y), side, wire, *kind);
            svg.chip((side.out(edge, 38), y), *kind, &wire.pin);
            svg.text((side.out(edge, 63), y + 4), side.class(), wire.text);
        }
    }
    for (side, x, pins) in [(Side::Right, ARDUINO.0, &ARDUINO_LEFT[..]), (Side::Left, ARDUINO.1, &ARDUINO_RIGHT[..])] {
        for (print, row) in pins {
            let y = at(*row);
            let used = all.iter().find(|(_, wire)| wire.label == *print);
            let fill = used.map_or("#fff", |(kind, _)| colour(*kind));
            svg.rect((x - 4, y - 4), (8, 8), &format!("fill=\"{fill}\" stroke=\"#9aa5b1\" stroke-width=\".5\""));
            let class = if side == Side::Left { "e" } else { "" };
            svg.text((side.out(x, 10), y + 4), &format!("{} {class}", if used.is_some() { "l" } else { "u" }), print);
            let Some((kind, wire)) = used else { continue };
            drawn += 1;
            svg.line(format_args!("M{} {y}H{}", side.out(x, 38), side.out(x, 62)), colour(*kind));
            // Outputs point away from the header, to the middle of the shield.
            svg.arrow((side.out(x, 49), y), side, wire, *kind);
            svg.chip((side.out(x, 80), y), *kind, &wire.pin);
            svg.text((side.out(x, 107), y + 4), class, wire.text);
        }
    }
    assert_eq!(drawn, all.len(), "{title}: each pin has its place, but for the two of the UART");
    let signs = signs(boards, &groups);
    let lines: Vec<&str> = signs.iter().map(String::as_str).collect();
    let height = svg.legend(at(19) + 54, &groups, &lines) + 4;
    svg.finished(title, height)
}

/// Returns the path of the drawing of a section, from the root of the tree. `first`: the first board of the section.
pub fn path(first: &str) -> String {
    format!("{FOLDER}/{first}.svg")
}

/// Returns the paths of all drawings.
pub fn paths() -> BTreeSet<String> {
    SECTIONS.iter().map(|(_, names)| path(names[0])).collect()
}

#[test]
fn drawings_of_boards_are_those_of_their_tables() {
    if writes() {
        fs::create_dir_all(root().join(FOLDER)).expect("a folder");
    }
    for (title, names) in SECTIONS {
        let boards: Vec<Board> = names.iter().map(|name| Board::named(name).expect("a board")).collect();
        let drawing = match names[0] {
            name if name.starts_with("blackpill") => black_pill(title, &boards),
            name if name.starts_with("nucleo") => nucleo(title, &boards),
            _ => control_board(title, &boards[0]),
        };
        assert!(drawing.len() < MOST_BYTES, "{title}: {} bytes", drawing.len());
        keep(&root().join(path(names[0])), |_| drawing);
    }
    let entries = fs::read_dir(root().join(FOLDER)).expect("a folder");
    let files: BTreeSet<String> =
        entries.map(|entry| format!("{FOLDER}/{}", entry.expect("an entry").file_name().display())).collect();
    assert_eq!(files, paths(), "drawings of boards");
}
