//! The text of the status report (`<...>`), the answer to `?`: its fields, and which reports carry the rare ones.

use super::reply_texts::{PlaceForm, position, rate};
use super::text::{Text, filled, put, real, whole};
use crate::axes::PerAxis;
use crate::image::FULL_IMAGE;
use crate::messages::{Coolant, Signals, SpindleDirection};
use crate::units::Coordinate;

/// The contents of a status report; fields that are `None` are omitted.
#[derive(Clone, Copy, Debug)]
pub struct Status<const N: usize> {
    /// `Idle`, `Hold:1` and so on.
    pub state: &'static str,
    /// Machine position.
    pub machine: PerAxis<Coordinate, N>,
    /// Work offset: WCS + G92 + tool length.
    pub offset: PerAxis<Coordinate, N>,
    /// `$10` bit 0: `true` if the report shows the machine position, `false` if it shows the work position.
    pub show_machine: bool,
    /// Free blocks, and free bytes of the receive buffer.
    pub buffer: Option<(usize, u16)>,
    /// N word of the move being executed.
    pub line: Option<u32>,
    /// Actual speed in mm/min.
    pub feed: f32,
    /// Spindle speed in rpm.
    pub speed: f32,
    /// Active inputs.
    pub pins: Signals,
    /// `true` if this report has the field `WCO` (the work offset).
    pub show_offset: bool,
    /// Overrides in percent (feed, rapid, spindle), spindle direction and coolant, if this report carries them.
    pub overrides: Option<([u8; 3], SpindleDirection, Coolant)>,
    /// Further fields, with `$900=3`. Takes no memory in the small firmware image, which lacks them.
    pub of_grblhal: [Option<GrblHalFields>; FULL_IMAGE as usize],
}

/// Fields of a status report with `$900=3`, as grblHAL has them.
#[derive(Clone, Copy, Debug)]
pub struct GrblHalFields {
    /// Whether the host has requested all fields (0x87).
    pub full: bool,
    /// Number of the alarm that locks the machine; 0 for none.
    pub alarm: u8,
    /// The active coordinate system: `G54` and so on.
    pub system: &'static str,
    /// Number of the tool in the spindle.
    pub tool: u32,
    /// Whether the machine is homed, and a mask of the homed axes; `None` if homing is off.
    pub homed: Option<(bool, u8)>,
    /// Whether coordinates are scaled (G51).
    pub scaled: bool,
    /// Whether the report has the field `Sc`: coordinates are scaled, or were scaled at the previous report.
    pub shows_scaling: bool,
    /// Whether the tool setter has a reference.
    pub has_reference: bool,
    /// Whether M6 waits for a tool.
    pub waits_for_tool: bool,
    /// Direction of the spindle; off while it has no power.
    pub spindle: SpindleDirection,
    /// State of the coolant outputs.
    pub coolant: Coolant,
}

/// Appends the report `<...>`. With `$900=3` some fields differ from Grbl's, and others are added.
pub fn status<const N: usize>(out: &mut Text, status: &Status<N>, form: PlaceForm) {
    put(out, b"<");
    let more = status.of_grblhal.first().and_then(Option::as_ref);
    match more {
        Some(more) if more.waits_for_tool => put(out, b"Tool"),
        _ => put(out, status.state.as_bytes()),
    }
    if let Some(GrblHalFields { full: true, alarm: alarm @ 1.., .. }) = more {
        put(out, b":");
        whole(out, u64::from(*alarm));
    }
    if status.show_machine {
        put(out, b"|MPos:");
        position(out, &status.machine, form);
    } else {
        put(out, b"|WPos:");
        position(out, &status.machine.zip(&status.offset, |m, o| m - o), form);
    }
    if let Some((blocks, bytes)) = status.buffer {
        put(out, b"|Bf:");
        whole(out, blocks as u64);
        put(out, b",");
        whole(out, u64::from(bytes));
    }
    if let Some(line) = status.line {
        put(out, b"|Ln:");
        whole(out, u64::from(line));
    }
    put(out, b"|FS:");
    rate(out, status.feed, form.inches);
    put(out, b",");
    real(out, status.speed, 0);
    pins(out, &status.pins);
    if status.show_offset {
        put(out, b"|WCO:");
        position(out, &status.offset, form);
        if let Some(more) = more {
            put(out, b"|WCS:");
            put(out, more.system.as_bytes());
        }
    }
    if let Some(([feed, rapid, speed], spindle, coolant)) = status.overrides {
        put(out, b"|Ov:");
        whole(out, u64::from(feed));
        put(out, b",");
        whole(out, u64::from(rapid));
        put(out, b",");
        whole(out, u64::from(speed));
        if more.is_none() {
            accessories(out, spindle, coolant);
        }
    }
    if let Some(more) = more {
        fields_of_grblhal(out, more, status.show_offset, status.overrides.is_some());
    }
    put(out, b">\r\n");
}

/// Appends the fields that follow `Ov` with `$900=3`. `rare`: the report has `WCO`; the other fields that change
/// rarely come with it. `accessories`: the report has `Ov`; the field `A` comes with it.
#[inline(never)]
fn fields_of_grblhal(out: &mut Text, more: &GrblHalFields, rare: bool, accessories: bool) {
    if accessories || more.waits_for_tool {
        // The field `A` is sent even without letters, because a host shows the letters of an earlier report until it
        // gets others.
        put(out, b"|A:");
        put(out, &accessory_letters(more.spindle, more.coolant));
        put(out, if more.waits_for_tool { b"T" } else { b"" });
    }
    let full = |text| if more.full { text } else { b"".as_slice() };
    put(out, full(b"|MPG:0"));
    if !rare {
        return;
    }
    if more.shows_scaling {
        put(out, b"|Sc:");
        put(out, if more.scaled { b"XYZ" } else { b"" });
    }
    if let Some((all, axes)) = more.homed {
        filled(out, b"|H:#,#", &[], &[all.into(), axes.into()]);
    }
    filled(out, b"|T:#|TLR:#%", &[full(b"|FW:grblHAL")], &[more.tool, more.has_reference.into()]);
}

fn pins(out: &mut Text, pins: &Signals) {
    let mut letters: heapless::Vec<u8, 13> = heapless::Vec::new();
    let active = [
        (pins.probe, b'P'),
        (pins.limits & 1 != 0, b'X'),
        (pins.limits & 2 != 0, b'Y'),
        (pins.limits & 4 != 0, b'Z'),
        (pins.limits & 8 != 0, b'A'),
        (pins.limits & 16 != 0, b'B'),
        (pins.limits & 32 != 0, b'C'),
        (pins.door, b'D'),
        (pins.reset, b'R'),
        (pins.hold, b'H'),
        (pins.start, b'S'),
        (pins.emergency_stop, b'E'),
        (pins.driver_fault, b'F'),
    ];
    letters.extend(active.iter().filter(|(on, _)| *on).map(|(_, letter)| *letter));
    if !letters.is_empty() {
        put(out, b"|Pn:");
        put(out, &letters);
    }
}

#[inline(never)]
fn accessory_letters(spindle: SpindleDirection, coolant: Coolant) -> heapless::Vec<u8, 3> {
    let mut letters: heapless::Vec<u8, 3> = heapless::Vec::new();
    letters.extend(match spindle {
        SpindleDirection::Off => None,
        SpindleDirection::Clockwise => Some(b'S'),
        SpindleDirection::CounterClockwise => Some(b'C'),
    });
    letters.extend(coolant.flood.then_some(b'F'));
    letters.extend(coolant.mist.then_some(b'M'));
    letters
}

fn accessories(out: &mut Text, spindle: SpindleDirection, coolant: Coolant) {
    let letters = accessory_letters(spindle, coolant);
    if !letters.is_empty() {
        put(out, b"|A:");
        put(out, &letters);
    }
}

/// Decides which reports have the fields `WCO` and `Ov`. Both change rarely, so most reports omit them.
///
/// `WCO` is in the first report and then in every 10th (every 30th while the machine is busy). `Ov` is in every 10th
/// (every 20th while busy). A change makes the field due earlier. If both fields are due, `Ov` waits for the report
/// after the one with `WCO`, because both are long.
#[derive(Clone, Copy, Debug, Default)]
pub struct RareFields {
    offset_in: u8,
    overrides_in: u8,
}

impl RareFields {
    /// `WCO` and `Ov` are due.
    pub const DUE: RareFields = RareFields { offset_in: 0, overrides_in: 0 };

    /// Makes `WCO` due after a change of the work offset.
    pub fn offset_changed(&mut self) {
        self.offset_in = 0;
    }

    /// Makes `Ov` due after a change of an override or an accessory.
    pub fn overrides_changed(&mut self) {
        self.overrides_in = 0;
    }

    /// Returns whether the next report has `WCO`, and whether it has `Ov`. Counts the report, so call this once for
    /// each.
    pub fn next(&mut self, busy: bool) -> (bool, bool) {
        let offset = self.offset_in == 0;
        if offset {
            self.offset_in = if busy { 29 } else { 9 };
            self.overrides_in = self.overrides_in.max(1);
        } else {
            self.offset_in -= 1;
        }
        let overrides = self.overrides_in == 0;
        if overrides {
            self.overrides_in = if busy { 19 } else { 9 };
        } else {
            self.overrides_in -= 1;
        }
        (offset, overrides)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rare_fields_take_turns() {
        let mut fields = RareFields::default();
        let idle: Vec<(bool, bool)> = (0..22).map(|_| fields.next(false)).collect();
        let at = |want: (bool, bool)| idle.iter().enumerate().filter(|(_, f)| **f == want).map(|(i, _)| i).collect();
        let offsets: Vec<usize> = at((true, false));
        let overrides: Vec<usize> = at((false, true));
        assert_eq!(offsets, [0, 10, 20]);
        assert_eq!(overrides, [1, 11, 21]);
        fields.overrides_changed();
        assert_eq!(fields.next(true), (false, true));
    }
}
