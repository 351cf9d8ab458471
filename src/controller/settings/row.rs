//! The contents of a row of the settings table: number, default, kind of value, and whether Grbl has it. For people
//! there are also a name, a unit, a group and labels. The macro `table` makes table, keys and descriptions from one
//! list.

use crate::axes::{Axis, LINEAR};
use crate::error::codes;
use crate::units::DECIMAL_ONE;

/// How a value is checked and printed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// Whole number, with minimum and maximum. A fraction is refused; Grbl's dialect truncates it.
    Whole(u32, u32),
    /// A multiple of 0.1; both bounds, minimum and maximum, are in tenths. Printed with one decimal, or with none if
    /// that decimal is 0. In Grbl's dialect fractions are truncated.
    Tenths(u32, u32),
    /// A sum of some of these bits. A fraction is refused; Grbl's dialect truncates it.
    Mask(u32),
    /// 0 or 1; in Grbl's dialect any other whole number up to 255 counts as 1.
    Switch,
    /// Not negative; printed with three decimals.
    Real,
    /// Not negative; printed without decimals.
    Speed,
    /// Of either sign; printed with three decimals.
    Place,
    /// A set of axes of this machine; bit 0 is X.
    Axes,
}

/// Maximum magnitude of a value, about 9.2e11. A [`Decimal`](crate::units::Decimal) cannot be larger.
const GREATEST: f32 = (i64::MAX / DECIMAL_ONE) as f32;

impl Kind {
    /// Returns whether `value` is valid for a setting of this kind. `axes`: mask of the machine's axes, bit 0 for X.
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

/// The part of a row with which the machine finds, checks, prints and resets a value. (The texts are in
/// [`Description`].)
#[derive(Clone, Copy, Debug)]
pub struct Entry {
    /// The number after `$`. For a setting that exists per axis, the number for X.
    pub number: u16,
    /// How the value is checked and printed.
    pub kind: Kind,
    /// Default value, in the unit of the setting.
    pub default: f32,
    /// Whether Grbl 1.1h has a setting of this number.
    pub grbl: bool,
}

/// The description of a row for people and senders. Separate from [`Entry`], so that a board without enough flash does
/// not link the texts.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Description {
    /// Name of the setting, such as `Step pulse`.
    pub name: &'static str,
    /// Unit; empty for none.
    pub unit: &'static str,
    /// Group in which senders show the setting.
    pub group: SettingGroup,
    /// Meanings of the values 0, 1, 2 and so on, or of the bits of a mask from the lowest, separated by commas. Empty
    /// for quantities.
    pub labels: &'static str,
}

/// Labels of the axes, by number or bit. [`Description::with_axes`] extends them to all axes of the machine.
pub(super) const AXIS_LABELS: &str = "X axis,Y axis,Z axis";
/// Labels of all axes that any machine may have.
pub(super) const ALL_AXIS_LABELS: &str = "X axis,Y axis,Z axis,A axis,B axis,C axis";

impl Description {
    /// Returns the description for a machine with `axes` axes.
    pub(super) fn with_axes(self, axes: usize) -> Self {
        let labels = match axes {
            0..=LINEAR => AXIS_LABELS,
            4 => "X axis,Y axis,Z axis,A axis",
            5 => "X axis,Y axis,Z axis,A axis,B axis",
            _ => ALL_AXIS_LABELS,
        };
        if self.labels == AXIS_LABELS { Self { labels, ..self } } else { self }
    }

    /// Returns the description of a per-axis setting for `axis`. For a rotary axis, the unit has degrees in place of
    /// mm (`steps/deg`).
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

/// A row of `$$` with its description, for people and senders.
#[derive(Clone, Copy, Debug)]
pub struct Row {
    /// The number after `$`.
    pub number: u16,
    /// The axis of a per-axis setting; `None` for other settings. `$44` and the numbers after it stand for homing
    /// cycles, not for axes. There, X means the first cycle, Y the second, and so on.
    pub axis: Option<Axis>,
    /// Kind and default of the value, and whether Grbl 1.1h has the setting.
    pub entry: Entry,
    /// Name, unit, group and labels, for people and senders.
    pub description: Description,
}

codes! {
    /// Group of a setting, for senders that show settings in groups.
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
    /// The numbers after this one are the groups of the single axes: 13 for X, 14 for Y, and so on to C.
    Axes = 12, "Axes";
}

/// Defines a table of settings. Each row has key, number, name, unit, group, labels, kind, default, and whether Grbl
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
            /// Number of rows of the table.
            pub const COUNT: usize = [$($keys::$key,)*].len();
        }
    };
}

pub(super) use table;
