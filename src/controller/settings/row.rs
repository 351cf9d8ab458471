//! What a row of the table of settings says: number, default, kind of value, and whether Grbl has it; for people also
//! name, unit, group and labels. The macro here makes table, keys and descriptions from one list.

use crate::axes::{Axis, LINEAR};
use crate::error::codes;
use crate::units::DECIMAL_ONE;

/// How a value is checked and printed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// Whole number from `.0` to `.1`; fractions are cut off.
    Whole(u32, u32),
    /// Tenths from `.0` to `.1`, printed with a decimal if there is one. In Grbl's dialect whole numbers, fractions cut off.
    Tenths(u32, u32),
    /// A sum of some of these bits; fractions are cut off.
    Mask(u32),
    /// 0 or 1; in Grbl's dialect any other whole number up to 255 counts as 1.
    Switch,
    /// Not negative, printed with three decimals.
    Real,
    /// Not negative, printed without decimals.
    Speed,
    /// Any sign, printed with three decimals.
    Place,
    /// A set of axes of this machine, bit 0 for X.
    Axes,
}

/// Greatest size of a number: that of the greatest [`Decimal`](crate::units::Decimal).
const GREATEST: f32 = (i64::MAX / DECIMAL_ONE) as f32;

impl Kind {
    /// Whether a setting of this kind can have this value, on a machine with these axes.
    pub(super) fn can_be(self, value: f32, axes: u8) -> bool {
        let whole = value as u32;
        let only = |bits: u32| whole as f32 == value && whole & !bits == 0;
        match self {
            Self::Whole(least, greatest) => whole as f32 == value && (least..=greatest).contains(&whole),
            Self::Tenths(least, greatest) => {
                let tenths = (value * 10.0 + 0.5) as u32;
                tenths as f32 / 10.0 == value && (least..=greatest).contains(&tenths)
            }
            Self::Mask(bits) => only(bits),
            Self::Axes => only(u32::from(axes)),
            Self::Switch => only(1),
            Self::Real | Self::Speed => (0.0..=GREATEST).contains(&value),
            Self::Place => (-GREATEST..=GREATEST).contains(&value),
        }
    }
}

/// What the machine needs of a row of the table.
#[derive(Clone, Copy, Debug)]
pub struct Entry {
    /// The number after `$`. For a setting that exists per axis, the one of X.
    pub number: u16,
    /// How it is checked and printed.
    pub kind: Kind,
    /// Value of a new controller.
    pub default: f32,
    /// Whether Grbl 1.1h knows the number.
    pub grbl: bool,
}

/// What people and senders are told of a row. It is apart from what the machine needs, so that a board without room for it
/// links none of it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Description {
    /// What it is.
    pub name: &'static str,
    /// In which unit; empty for none.
    pub unit: &'static str,
    /// What it belongs to.
    pub group: SettingGroup,
    /// What the values 0, 1, 2 and so on choose, or what the bits of a mask mean, from the lowest; commas between. Empty
    /// for numbers that are quantities.
    pub labels: &'static str,
}

/// Axes by number or bit.
pub(super) const AXIS_LABELS: &str = "X axis,Y axis,Z axis";
/// As far as any machine may have them.
pub(super) const ALL_AXIS_LABELS: &str = "X axis,Y axis,Z axis,A axis,B axis,C axis";

impl Description {
    /// On a machine with so many axes.
    pub(super) fn with_axes(self, axes: usize) -> Self {
        let labels = match axes {
            0..=LINEAR => AXIS_LABELS,
            4 => "X axis,Y axis,Z axis,A axis",
            5 => "X axis,Y axis,Z axis,A axis,B axis",
            _ => ALL_AXIS_LABELS,
        };
        if self.labels == AXIS_LABELS { Self { labels, ..self } } else { self }
    }

    /// Of a setting that exists once for each axis: those that turn have degrees.
    pub(super) fn of_axis(self, axis: Axis) -> Self {
        let unit = match self.unit {
            unit if !axis.is_rotary() => unit,
            "mm" => "deg",
            "steps/mm" => "steps/deg",
            "mm/min" => "deg/min",
            "mm/s2" => "deg/s2",
            "mm/s3" => "deg/s3",
            unit => unit,
        };
        Self { unit, ..self }
    }
}

/// A row of `$$` as it is told to people and senders.
#[derive(Clone, Copy, Debug)]
pub struct Row {
    /// The number after `$`.
    pub number: u16,
    /// The axis, or of homing cycles the one whose place in the order is the number of the cycle.
    pub axis: Option<Axis>,
    /// What the machine needs of it.
    pub entry: Entry,
    /// What is told of it.
    pub description: Description,
}

codes! {
    /// What a setting belongs to, for senders that show settings in groups.
    SettingGroup;
    General = 1, "General";
    Steppers = 2, "Stepper motors";
    ControlInputs = 3, "Control inputs";
    Limits = 4, "Limits";
    Probing = 5, "Probing";
    Motion = 6, "Motion";
    Homing = 7, "Homing";
    Spindle = 8, "Spindle and laser";
    Door = 9, "Safety door and parking";
    GangedAxis = 10, "Axis with two motors";
    Program = 11, "Program";
    /// The groups of the axes, X to C, have the numbers that follow this one's.
    Axes = 12, "Axes";
}

/// A table of settings: each row has its key, and its number, name, unit, group, labels, check, default, and whether Grbl
/// has it.
macro_rules! table {
    (
        $(#[$rows_doc:meta])* $rows:ident;
        $(#[$descriptions_doc:meta])* $descriptions:ident;
        $(#[$keys_doc:meta])* $keys:ident {
            $($key:ident: $number:expr, $name:expr, $unit:expr, $group:ident, $labels:expr, $kind:expr, $default:expr, $grbl:expr;)*
        }
    ) => {
        $(#[$rows_doc])*
        pub const $rows: [Entry; $keys::COUNT] = [$(
            Entry { number: $number, kind: $kind, default: $default, grbl: $grbl },
        )*];

        $(#[$descriptions_doc])*
        pub const $descriptions: [Description; $keys::COUNT] = [$(
            Description { name: $name, unit: $unit, group: SettingGroup::$group, labels: $labels },
        )*];

        $(#[$keys_doc])*
        #[derive(Clone, Copy, Debug, PartialEq, Eq)]
        #[allow(missing_docs, reason = "the table says what each is")]
        pub enum $keys {
            $($key,)*
        }

        impl $keys {
            /// How many there are.
            pub const COUNT: usize = [$($keys::$key,)*].len();
        }
    };
}

pub(super) use table;
