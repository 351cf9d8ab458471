//! The `$` table: a row for each `Key` and each `AxisKey` (homing, soft limits, parking, probing, door, control inputs
//! and their pull-ups) with number, name, unit, group, labels, kind, default and whether Grbl has it, as `Entry` and
//! `Description`. `Settings` holds the values as `scalars` and `per_axis`: it sets one after a check of its range
//! (`InvalidStatement`), restores stored ones, gives them as whole numbers, tenths, seconds, masks or `is_on`, counts a
//! `revision`, and says which setting makes the set unrunnable. Groups are `General`, `Steppers`, `Spindle`, `Limits`,
//! `Homing`, `GangedAxis`, `ControlInputs`, `Axes` and `Program`; kinds are `Switch`, `Real`, `Whole`, `Tenths` and
//! `Mask`. Names in words, such as "Maximum rate", with units such as mm or steps/mm, are in the rows. It also gives
//! `axes_in_use`, the `ganged_axis` and the `arrangement` (`core_xy`); `crawls` finds rates such as `HomingSeek` or
//! `HomingLocate` outside `RATES`.
//!
//! `$$`, the checks of `$n=v` and the documents come from this one table. A setting that is legal alone is stored, as
//! senders restore them one by one; whether the *set* can be run is asked by [`Settings::unrunnable`].

use crate::axes::{Arrangement, Axis, LINEAR, PerAxis};
use crate::error::{Error, codes};
use crate::step_rates::StepRates;
use crate::units::{DECIMAL_ONE, Decimal, Duration, StepsPerMm};

/// How a value is checked and printed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// Whole number from `.0` to `.1`; fractions are cut off.
    Whole(u32, u32),
    /// Tenths from `.0` to `.1`, printed with a decimal if there is one. In Grbl's dialect whole numbers, fractions cut off.
    Tenths(u32, u32),
    /// A sum of some of these bits; fractions are cut off.
    Mask(u32),
    /// 0 or 1; any other whole number up to 255 counts as 1.
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

impl Description {
    /// On a machine with so many axes.
    fn with_axes(self, axes: usize) -> Self {
        let labels = match axes {
            0..=LINEAR => AXIS_LABELS,
            4 => "X axis,Y axis,Z axis,A axis",
            5 => "X axis,Y axis,Z axis,A axis,B axis",
            _ => ALL_AXIS_LABELS,
        };
        if self.labels == AXIS_LABELS { Self { labels, ..self } } else { self }
    }

    /// Of a setting that exists once for each axis: those that turn have degrees.
    fn of_axis(self, axis: Axis) -> Self {
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

/// Bits of the control inputs, as in grblHAL's `$14` and `$17`.
const CONTROL: Kind = Kind::Mask(0b1_0100_1111);
/// Bits of the limit inputs: six axes, and the switch of a second motor.
const LIMITS: Kind = Kind::Mask(0x7F);
/// What a fault makes of motion and spindle: see `machine::reaction`.
const REACTIONS: &str =
    "Stop,Brake,Brake and retract,Stop (spindle on),Brake (spindle on),Brake and retract (spindle on)";
/// What the bits of the control inputs are.
const CONTROL_LABELS: &str = "Reset,Feed hold,Cycle start,Safety door,N/A,N/A,Emergency stop,N/A,Driver fault";
/// What the bits of the limit inputs are.
const LIMIT_LABELS: &str = "X axis,Y axis,Z axis,A axis,B axis,C axis,Second motor";
/// Axes by number or bit.
const AXIS_LABELS: &str = "X axis,Y axis,Z axis";
/// As far as any machine may have them.
const ALL_AXIS_LABELS: &str = "X axis,Y axis,Z axis,A axis,B axis,C axis";

table! {
    /// Settings that exist once.
    SCALARS;
    /// What is told of the rows of [`SCALARS`].
    SCALAR_DESCRIPTIONS;
    /// Names the rows of [`SCALARS`].
    Key {
        StepPulse: 0, "Step pulse", "us", Steppers, "", Kind::Tenths(5, 2550), 10.0, true;
        IdleDelay: 1, "Step idle delay", "ms", Steppers, "", Kind::Whole(0, 255), 25.0, true;
        StepInvert: 2, "Step invert", "mask", Steppers, AXIS_LABELS, Kind::Whole(0, 255), 0.0, true;
        DirectionInvert: 3, "Direction invert", "mask", Steppers, AXIS_LABELS, Kind::Whole(0, 255), 0.0, true;
        EnableInvert: 4, "Enable invert", "", Steppers, "", Kind::Switch, 0.0, true;
        LimitInvert: 5, "Limit invert", "", Limits, "", Kind::Switch, 0.0, true;
        ProbeInvert: 6, "Probe invert", "", Probing, "", Kind::Switch, 0.0, true;
        StatusReport: 10, "Status report", "mask", General, "Machine position,Buffer state", Kind::Whole(0, 255), 1.0, true;
        JunctionDeviation: 11, "Junction deviation", "mm", Motion, "", Kind::Real, 0.010, true;
        ArcTolerance: 12, "Arc tolerance", "mm", Motion, "", Kind::Real, 0.002, true;
        ReportInches: 13, "Report in inches", "", General, "", Kind::Switch, 0.0, true;
        ControlInvert: 14, "Control inputs invert", "mask", ControlInputs, CONTROL_LABELS, CONTROL, 0.0, false;
        ControlNoPullUp: 17, "Control inputs without pull-up", "mask", ControlInputs, CONTROL_LABELS, CONTROL, 0.0, false;
        LimitNoPullUp: 18, "Limit inputs without pull-up", "mask", Limits, LIMIT_LABELS, LIMITS, 0.0, false;
        ProbeNoPullUp: 19, "Probe input without pull-up", "", Probing, "", Kind::Switch, 0.0, false;
        SoftLimits: 20, "Soft limits", "", Limits, "", Kind::Switch, 0.0, true;
        HardLimits: 21, "Hard limits", "", Limits, "", Kind::Switch, 0.0, true;
        Homing: 22, "Homing", "", Homing, "", Kind::Switch, 0.0, true;
        HomingDirection: 23, "Homing direction", "mask", Homing, AXIS_LABELS, Kind::Whole(0, 255), 0.0, true;
        HomingLocate: 24, "Homing locate feed", "mm/min", Homing, "", Kind::Real, 25.0, true;
        HomingSeek: 25, "Homing seek rate", "mm/min", Homing, "", Kind::Real, 500.0, true;
        HomingDebounce: 26, "Homing debounce", "ms", Homing, "", Kind::Whole(0, 65_535), 250.0, true;
        HomingPullOff: 27, "Homing pull-off", "mm", Homing, "", Kind::Real, 1.0, true;
        DirectionSetup: 29, "Direction set-up", "us", Steppers, "", Kind::Whole(0, 255), 5.0, false;
        SpindleMaximum: 30, "Maximum spindle speed", "rpm", Spindle, "", Kind::Speed, 1000.0, true;
        SpindleMinimum: 31, "Minimum spindle speed", "rpm", Spindle, "", Kind::Speed, 0.0, true;
        Laser: 32, "Laser mode", "", Spindle, "", Kind::Switch, 0.0, true;
        SpindlePwm: 33, "Spindle PWM frequency", "Hz", Spindle, "", Kind::Whole(1, 100_000), 5000.0, false;
        JogClip: 40, "Jogs end at the soft limits", "", Limits, "", Kind::Switch, 0.0, false;
        Parking: 41, "Parking", "", Door, "", Kind::Switch, 0.0, false;
        ParkingAxis: 42, "Parking axis", "", Door, ALL_AXIS_LABELS, Kind::Whole(0, 5), 2.0, false;
        HomingPasses: 43, "Homing locate passes", "", Homing, "", Kind::Whole(1, 128), 1.0, false;
        ParkingPullOut: 56, "Parking pull-out", "mm", Door, "", Kind::Real, 5.0, false;
        ParkingPullOutRate: 57, "Parking pull-out rate", "mm/min", Door, "", Kind::Real, 100.0, false;
        ParkingTarget: 58, "Parking place", "mm", Door, "", Kind::Place, -5.0, false;
        ParkingFastRate: 59, "Parking fast rate", "mm/min", Door, "", Kind::Real, 500.0, false;
        ToolSetterDepth: 342, "Greatest way down to the tool setter", "mm", Program, "", Kind::Real, 30.0, false;
        ToolSetterLocate: 343, "Tool setter locate feed", "mm/min", Program, "", Kind::Real, 25.0, false;
        ToolSetterSeek: 344, "Tool setter seek rate", "mm/min", Program, "", Kind::Real, 200.0, false;
        SquaringShare: 347, "Squaring fails after (share of the travel)", "%", GangedAxis, "", Kind::Real, 5.0, false;
        SquaringLeast: 348, "Squaring fails after at least", "mm", GangedAxis, "", Kind::Real, 2.5, false;
        SquaringMost: 349, "Squaring fails after at most", "mm", GangedAxis, "", Kind::Real, 25.0, false;
        DoorSpindleDelay: 392, "Spindle on to coolant on, after a door", "s", Door, "", Kind::Real, 4.0, false;
        DoorCoolantDelay: 393, "Coolant on to motion, after a door", "s", Door, "", Kind::Real, 1.0, false;
        SpinUp: 394, "Spindle on to motion", "s", Spindle, "", Kind::Real, 0.0, false;
        SpinDown: 539, "Spindle off to motion", "s", Spindle, "", Kind::Real, 0.0, false;
        Dialect: 900, "Dialect", "", General, "Grbl,Oxmill,Seed document", Kind::Whole(0, 2), 1.0, false;
        StopOnError: 901, "An error stops the job", "", General, "", Kind::Switch, 0.0, false;
        TrustNeeded: 902, "Machine coordinates need a trusted position", "", General, "", Kind::Switch, 1.0, false;
        DoorFitted: 903, "Safety door fitted", "", Door, "", Kind::Switch, 1.0, false;
        Kinematics: 904, "Kinematics", "", Motion, "Cartesian,CoreXY", Kind::Whole(0, 1), 0.0, false;
        GangedAxis: 905, "Axis with two motors", "", GangedAxis, "None,X axis,Y axis,Z axis", Kind::Whole(0, 3), 0.0, false;
        GangedInvert: 906, "Second motor turns the other way", "", GangedAxis, "", Kind::Switch, 0.0, false;
        GangedSwitch: 907, "Second motor has its own limit switch", "", GangedAxis, "", Kind::Switch, 0.0, false;
        LimitInvertEach: 908, "Limit inputs of the other polarity than $5 says", "mask", Limits, LIMIT_LABELS, LIMITS, 0.0, false;
        ControlPullDown: 909, "Control inputs with a pull-down", "mask", ControlInputs, CONTROL_LABELS, CONTROL, 0.0, false;
        LimitPullDown: 910, "Limit inputs with a pull-down", "mask", Limits, LIMIT_LABELS, LIMITS, 0.0, false;
        ProbePullDown: 911, "Probe input with a pull-down", "", Probing, "", Kind::Switch, 0.0, false;
        ResetIsEmergencyStop: 912, "Reset input is an emergency stop", "", ControlInputs, "", Kind::Switch, 0.0, false;
        EmergencyDriversOff: 913, "Emergency stop and driver fault switch the drivers off", "", ControlInputs, "", Kind::Switch, 0.0, false;
        HoldWithoutHost: 914, "The host's going in mid-job is a fault", "", General, "", Kind::Switch, 1.0, false;
        AtSpeed: 915, "Spindle at-speed input", "", Spindle, "None,Low at speed,High at speed", Kind::Whole(0, 2), 0.0, false;
        AtSpeedWithin: 916, "Longest time from spindle on to at speed", "s", Spindle, "", Kind::Real, 10.0, false;
        CurveAcceleration: 917, "Acceleration in curves, share of $120 to $122", "%", Motion, "", Kind::Whole(10, 1000), 100.0, false;
        ToolChange: 918, "M6", "", Program, "Is ignored,Stops and asks for the tool,Stops and measures the tool", Kind::Whole(0, 2), 0.0, false;
        OptionalStop: 919, "M1 pauses", "", Program, "", Kind::Switch, 0.0, false;
        BlockDelete: 920, "Lines that begin with / are skipped", "", Program, "", Kind::Switch, 0.0, false;
        PeckClearance: 921, "Peck clearance (G73, G83)", "mm", Program, "", Kind::Real, 0.254, false;
        HostSilence: 922, "Longest silence of the host in mid-job", "s", General, "", Kind::Real, 0.0, false;
        JogSilence: 923, "Longest silence of the host during a jog", "s", General, "", Kind::Real, 0.0, false;
        LimitReaction: 924, "Reaction to a limit switch", "", Limits, REACTIONS, Kind::Whole(0, 5), 0.0, false;
        EmergencyReaction: 925, "Reaction to the emergency stop", "", ControlInputs, "Stop,Brake,Brake and retract", Kind::Whole(0, 2), 0.0, false;
        DriverReaction: 926, "Reaction to a driver fault", "", ControlInputs, REACTIONS, Kind::Whole(0, 5), 0.0, false;
        SpindleReaction: 927, "Reaction to a spindle that loses its speed", "", Spindle, REACTIONS, Kind::Whole(0, 5), 1.0, false;
        HostReaction: 928, "Reaction to a host that is silent or gone in mid-job", "", General, REACTIONS, Kind::Whole(0, 5), 4.0, false;
        SpeedLoss: 929, "Longest loss of spindle speed (0 = not watched)", "s", Spindle, "", Kind::Real, 1.0, false;
        Axes: 930, "Axes in use (4: with A, which turns)", "", General, "", Kind::Whole(3, 6), 3.0, false;
    }
}

impl Key {
    /// The number after `$`.
    #[allow(clippy::indexing_slicing, reason = "there is a row for each")]
    pub const fn number(self) -> u16 {
        SCALARS[self as usize].number
    }
}

table! {
    /// Settings that exist for each axis: the number of X; Y has the next one, and so on.
    PER_AXIS;
    /// What is told of the rows of [`PER_AXIS`].
    PER_AXIS_DESCRIPTIONS;
    /// Names the rows of [`PER_AXIS`].
    AxisKey {
        // The axes of the first homing cycle, the second, and so on: as many cycles as axes. The defaults are in
        // `homing_cycle`.
        HomingCycle: 44, "Axes homed in cycle", "mask", Homing, AXIS_LABELS, Kind::Axes, 0.0, false;
        Resolution: 100, "Resolution", "steps/mm", Axes, "", Kind::Real, 250.0, true;
        MaxRate: 110, "Maximum rate", "mm/min", Axes, "", Kind::Real, 500.0, true;
        Acceleration: 120, "Acceleration", "mm/s2", Axes, "", Kind::Real, 10.0, true;
        Travel: 130, "Maximum travel", "mm", Axes, "", Kind::Real, 200.0, true;
        Backlash: 160, "Backlash of the motor's drive", "mm", Axes, "", Kind::Real, 0.0, false;
        Jerk: 220, "Jerk (0 = not limited)", "mm/s3", Axes, "", Kind::Real, 0.0, false;
    }
}

impl AxisKey {
    /// The number after `$` for X; Y has the next one, and so on.
    #[allow(clippy::indexing_slicing, reason = "there is a row for each")]
    pub const fn number(self) -> u16 {
        PER_AXIS[self as usize].number
    }

    /// The axis that a number belongs to, if it is one of this setting.
    pub fn axis(self, number: u16) -> Option<Axis> {
        Axis::ALL.get(usize::from(number.checked_sub(self.number())?)).copied()
    }
}

/// The index of a setting.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Index {
    Scalar(usize),
    PerAxis(usize, Axis),
}

/// The values.
#[derive(Clone, Debug, PartialEq)]
pub struct Settings<const N: usize> {
    scalars: [f32; Key::COUNT],
    per_axis: [PerAxis<f32, N>; AxisKey::COUNT],
    /// Counts changes: what follows from the values need be computed once for each.
    revision: u32,
    /// Axes for which the board has motors, `N` at most.
    present: usize,
}

/// Axes of the `n`-th homing cycle of a new controller: Z first, out of the way, then X and Y together. Few rotary axes have a
/// switch.
pub const fn homing_cycle(n: usize) -> u8 {
    match n {
        0 => 0b100,
        1 => 0b011,
        _ => 0,
    }
}

/// So many axes, bit 0 for X.
const fn axes_mask(axes: usize) -> u8 {
    (1 << axes) - 1
}

/// How many rows `$$` has with so many axes in use.
pub const fn lines(axes: usize) -> usize {
    Key::COUNT + AxisKey::COUNT * axes
}

impl<const N: usize> Default for Settings<N> {
    fn default() -> Self {
        Self::new()
    }
}

impl<const N: usize> Settings<N> {
    /// The defaults.
    #[allow(clippy::indexing_slicing, reason = "both arrays have the length of their table")]
    pub const fn new() -> Self {
        let mut settings =
            Self { scalars: [0.0; Key::COUNT], per_axis: [PerAxis::all(0.0); AxisKey::COUNT], revision: 0, present: N };
        let mut i = 0;
        while i < Key::COUNT {
            settings.scalars[i] = SCALARS[i].default;
            i += 1;
        }
        i = 0;
        while i < AxisKey::COUNT {
            settings.per_axis[i] = PerAxis::all(PER_AXIS[i].default);
            i += 1;
        }
        i = 0;
        while i < N {
            settings.per_axis[AxisKey::HomingCycle as usize].0[i] = homing_cycle(i) as f32;
            if i >= LINEAR {
                // It turns without end.
                settings.per_axis[AxisKey::Travel as usize].0[i] = 0.0;
            }
            i += 1;
        }
        settings
    }

    /// The defaults of a board that has motors for so many axes.
    pub const fn of_board(axes: usize) -> Self {
        Self { present: if axes < N { axes } else { N }, ..Self::new() }
    }

    /// How many lines `$$` has with all axes in use.
    pub const LINES: usize = lines(N);

    /// How many axes the machine has (`$930`). To Grbl's dialect there are three.
    #[inline]
    pub fn axes_in_use(&self) -> usize {
        if N <= LINEAR || self.value(Key::Dialect) == 0.0 {
            return N.min(LINEAR);
        }
        (self.whole(Key::Axes) as usize).clamp(LINEAR, self.present.max(LINEAR))
    }

    /// How many axes have settings: those of A may come before `$930`, as a set is restored in any order.
    fn axes_to_set(&self) -> usize {
        if N <= LINEAR || self.value(Key::Dialect) == 0.0 { N.min(LINEAR) } else { self.present.max(LINEAR) }
    }

    /// A value of the first table.
    pub fn value(&self, key: Key) -> f32 {
        self.scalars.get(key as usize).copied().unwrap_or(0.0)
    }

    /// A value of the first table as a whole number.
    pub fn whole(&self, key: Key) -> u32 {
        self.value(key) as u32
    }

    /// The step pulse (`$0`), tenths of a microsecond.
    pub fn step_pulse_tenths(&self) -> u16 {
        (self.value(Key::StepPulse) * 10.0 + 0.5) as u16
    }

    /// A value of the first table, in seconds, as a time; a day at most.
    pub fn seconds(&self, key: Key) -> Duration {
        let seconds = self.value(key);
        let bounded = if seconds < 86_400.0 { seconds } else { 86_400.0 };
        Duration::from_ticks((bounded * 1.0e6) as u64)
    }

    /// A value of the first table as yes or no.
    pub fn is_on(&self, key: Key) -> bool {
        self.value(key) != 0.0
    }

    /// The values of a setting that exists per axis.
    pub fn axes(&self, key: AxisKey) -> PerAxis<f32, N> {
        self.per_axis.get(key as usize).copied().unwrap_or(PerAxis::all(0.0))
    }

    /// The axes of each homing cycle, bit 0 for X: those of the machine.
    pub fn homing_cycles(&self) -> PerAxis<u8, N> {
        let axes = axes_mask(self.axes_in_use());
        self.axes(AxisKey::HomingCycle).map(|cycle| cycle as u8 & axes)
    }

    fn find(number: u16) -> Option<Index> {
        if let Some(i) = SCALARS.iter().position(|e| e.number == number) {
            return Some(Index::Scalar(i));
        }
        PER_AXIS.iter().enumerate().find_map(|(i, e)| {
            let axis = Axis::ALL.get(usize::from(number.checked_sub(e.number)?)).copied()?;
            (axis.index() < N).then_some(Index::PerAxis(i, axis))
        })
    }

    /// The `line`-th row of `$$`: number, value, and how to print it.
    pub fn row(&self, line: usize) -> Option<(Entry, u16, f32)> {
        if let Some(entry) = SCALARS.get(line) {
            return Some((*entry, entry.number, self.scalars.get(line).copied()?));
        }
        let (line, axes) = (line.checked_sub(Key::COUNT)?, self.axes_in_use());
        let entry = PER_AXIS.get(line.checked_div(axes)?)?;
        let axis = Axis::ALL.get(line.checked_rem(axes)?)?;
        Some((*entry, entry.number + axis.index() as u16, self.per_axis.get(line.checked_div(axes)?)?.get(*axis)?))
    }

    /// What is told of the `line`-th row of `$$` with so many axes in use.
    pub fn described(line: usize, axes: usize) -> Option<Row> {
        if let (Some(entry), Some(description)) = (SCALARS.get(line), SCALAR_DESCRIPTIONS.get(line)) {
            return Some(Row {
                number: entry.number,
                axis: None,
                entry: *entry,
                description: description.with_axes(axes),
            });
        }
        let line = line.checked_sub(Key::COUNT)?;
        let row = line.checked_div(axes)?;
        let (entry, description) = (PER_AXIS.get(row)?, PER_AXIS_DESCRIPTIONS.get(row)?);
        let axis = *Axis::ALL.get(line.checked_rem(axes)?)?;
        let number = entry.number + axis.index() as u16;
        Some(Row { number, axis: Some(axis), entry: *entry, description: description.of_axis(axis).with_axes(axes) })
    }

    /// Checks and takes over `$number=value`. Nothing is changed when it is refused.
    ///
    /// # Errors
    /// [`Error::NegativeValue`] below zero, [`Error::InvalidStatement`] for a number that does not exist or a value out
    /// of range, [`Error::StepPulseTooShort`] for a `$0` out of range, [`Error::SoftLimitNeedsHoming`] for `$20=1` without `$22` in Grbl's
    /// dialect.
    pub fn set(&mut self, number: u16, value: Decimal) -> Result<(), Error> {
        let negative = value < Decimal::ZERO;
        if negative && number != PARKING_PLACE {
            return Err(Error::NegativeValue);
        }
        let place = Self::find(number).ok_or(Error::InvalidStatement)?;
        if matches!(place, Index::PerAxis(_, axis) if axis.index() >= self.axes_to_set()) {
            return Err(Error::InvalidStatement);
        }
        let entry = match place {
            Index::Scalar(i) => SCALARS.get(i),
            Index::PerAxis(i, _) => PER_AXIS.get(i),
        }
        .ok_or(Error::InvalidStatement)?;
        let value = match entry.kind {
            Kind::Whole(least, greatest) => {
                let whole = value.truncate() as u32;
                if !(least..=greatest).contains(&whole) {
                    return Err(Error::InvalidStatement);
                }
                whole as f32
            }
            Kind::Tenths(least, greatest) => self.tenths(value, least, greatest)? as f32 / 10.0,
            Kind::Mask(bits) => match u32::try_from(value.truncate()) {
                Ok(mask) if mask & !bits == 0 => mask as f32,
                _ => return Err(Error::InvalidStatement),
            },
            Kind::Axes => match value.truncate() {
                mask @ 0..=255 if mask as u8 & !axes_mask(self.axes_to_set()) == 0 => mask as f32,
                _ => return Err(Error::InvalidStatement),
            },
            Kind::Switch => match value.truncate() {
                0 => 0.0,
                1..=255 => 1.0,
                _ => return Err(Error::InvalidStatement),
            },
            Kind::Real | Kind::Speed | Kind::Place => value.to_f32(),
        };
        // Other dialects take it, so that a set can be restored in any order, and lock motion until homing is on.
        let grbl = self.value(Key::Dialect) == 0.0;
        if number == SOFT_LIMITS && value != 0.0 && !self.is_on(Key::Homing) && grbl {
            return Err(Error::SoftLimitNeedsHoming);
        }
        self.put(place, value);
        if number == HOMING && value == 0.0 {
            // Soft limits mean nothing without a homed position.
            self.put(Index::Scalar(Key::SoftLimits as usize), 0.0);
        }
        Ok(())
    }

    /// The step pulse in tenths of a microsecond. In Grbl's dialect no fraction counts, and no pulse is shorter than 3 us; in others
    /// nothing is rounded: what is no whole number of tenths is refused.
    fn tenths(&self, value: Decimal, least: u32, greatest: u32) -> Result<u32, Error> {
        /// A tenth as a decimal; 2560 of them fit 32 bits.
        const TENTH: u32 = (DECIMAL_ONE / 10) as u32;
        let Ok(value) = u32::try_from(value.0) else { return Err(Error::StepPulseTooShort) };
        let (mut tenths, rest, mut least) = (value / TENTH, value % TENTH, least);
        let is_grbl = self.value(Key::Dialect) == 0.0;
        if is_grbl {
            tenths -= tenths % 10;
            least = 30;
        }
        if !(least..=greatest).contains(&tenths) {
            return Err(Error::StepPulseTooShort);
        }
        if rest != 0 && !is_grbl { Err(Error::InvalidStatement) } else { Ok(tenths) }
    }

    /// Takes over a value that was stored before; an unknown number or a value that is no number is ignored.
    pub fn restore(&mut self, number: u16, value: f32) {
        if let Some(place) = Self::find(number)
            && value.is_finite()
            && (value >= 0.0 || number == PARKING_PLACE)
        {
            self.put(place, value);
        }
    }

    /// All stored values have been taken over: soft limits that homing has taken along when it was switched off go.
    pub fn settle(&mut self) {
        let kept = self.value(Key::SoftLimits) == BEFORE_HOMING || self.is_on(Key::Homing);
        let on = kept && self.is_on(Key::SoftLimits);
        self.put(Index::Scalar(Key::SoftLimits as usize), if on { 1.0 } else { 0.0 });
    }

    /// The value of a setting by its number, for storing.
    pub fn by_number(&self, number: u16) -> Option<f32> {
        if number == SOFT_LIMITS && self.is_on(Key::SoftLimits) && !self.is_on(Key::Homing) {
            return Some(BEFORE_HOMING);
        }
        match Self::find(number)? {
            Index::Scalar(i) => self.scalars.get(i).copied(),
            Index::PerAxis(i, axis) => self.per_axis.get(i)?.get(axis),
        }
    }

    /// Changes with each change of a value.
    pub fn revision(&self) -> u32 {
        self.revision
    }

    /// Takes over all values of others.
    pub fn replace(&mut self, others: Self) {
        *self = Self { revision: self.revision.wrapping_add(1), present: self.present, ..others };
    }

    fn put(&mut self, place: Index, value: f32) {
        self.revision = self.revision.wrapping_add(1);
        match place {
            Index::Scalar(i) => {
                if let Some(slot) = self.scalars.get_mut(i) {
                    *slot = value;
                }
            }
            Index::PerAxis(i, axis) => {
                if let Some(slot) = self.per_axis.get_mut(i) {
                    slot.set(axis, value);
                }
            }
        }
    }

    /// How the motors move the tool (`$904`).
    pub fn arrangement(&self) -> Arrangement {
        if self.whole(Key::Kinematics) == 1 { Arrangement::CoreXy } else { Arrangement::Cartesian }
    }

    /// The axis that two motors move (`$905`).
    pub fn ganged_axis(&self) -> Option<Axis> {
        Axis::ALL.get((self.whole(Key::GangedAxis) as usize).checked_sub(1)?).copied()
    }

    /// The number of the first setting that makes the set impossible to run; `None` when motion may run. It may be
    /// a step pulse (`$0`) shorter than the board makes, as one stored by the firmware of another; no steps/mm, rate or acceleration, or a jerk next to none; a step rate (rate × resolution) beyond what the board
    /// can keep with a step pulse of this length (`$0`): too many pulses a second; a second motor that the board does not have or that CoreXY leaves
    /// no place for, or A; more axes than the board has motors for.
    pub fn unrunnable(&self, rates: StepRates, has_second_motor: bool) -> Option<u16> {
        let pulse = self.step_pulse_tenths();
        if pulse < rates.least_pulse_tenths {
            return Some(STEP_PULSE);
        }
        let greatest_hz = rates.greatest_hz(pulse);
        let core_xy = self.arrangement() == Arrangement::CoreXy;
        let resolution = self.axes(AxisKey::Resolution);
        let rate = self.axes(AxisKey::MaxRate);
        let acceleration = self.axes(AxisKey::Acceleration);
        let in_use = self.axes_in_use();
        let of_axis = Axis::of_machine::<N>().take(in_use).find_map(|axis| {
            let offset = axis.index() as u16;
            let (r, v, a) = (resolution.get(axis)?, rate.get(axis)?, acceleration.get(axis)?);
            // Along the diagonal one motor of a CoreXY machine turns by both ways.
            let motor_rate = match axis {
                Axis::X | Axis::Y if core_xy => rate.get(Axis::X)? + rate.get(Axis::Y)?,
                _ => v,
            };
            if StepsPerMm::new(r).is_none() {
                Some(const { AxisKey::Resolution.number() } + offset)
            } else if !RATES.contains(&v) || r * motor_rate / 60.0 > greatest_hz {
                Some(const { AxisKey::MaxRate.number() } + offset)
            } else if !ACCELERATIONS.contains(&a) {
                Some(const { AxisKey::Acceleration.number() } + offset)
            } else if self.axes(AxisKey::Backlash).get(axis)? * r > MOST_BACKLASH {
                Some(const { AxisKey::Backlash.number() } + offset)
            } else if self.axes(AxisKey::Jerk).get(axis).is_some_and(|jerk| jerk != 0.0 && !JERKS.contains(&jerk)) {
                Some(const { AxisKey::Jerk.number() } + offset)
            } else {
                None
            }
        });
        // The second motor of an axis is the fourth of the board, and so is that of A.
        let cannot = |axis: &Axis| !has_second_motor || in_use > LINEAR || (core_xy && *axis != Axis::Z);
        let ganged = self.ganged_axis().filter(cannot).map(|_| GANGED_AXIS);
        of_axis.or(ganged).or_else(|| self.unrunnable_cycle())
    }

    /// The number of the first setting of a cycle that is switched on and could never come to its end, or of the path.
    fn unrunnable_cycle(&self) -> Option<u16> {
        let homing = self.is_on(Key::Homing);
        let parking = homing && self.is_on(Key::Parking);
        let crawls = |key| !RATES.contains(&self.value(key));
        if self.whole(Key::Axes) as usize > self.present.max(LINEAR) && self.value(Key::Dialect) != 0.0 {
            Some(const { Key::Axes.number() })
        } else if self.value(Key::JunctionDeviation) > GREATEST_DEVIATION {
            Some(const { Key::JunctionDeviation.number() })
        } else if self.value(Key::ArcTolerance) < LEAST_TOLERANCE {
            Some(const { Key::ArcTolerance.number() })
        } else if self.is_on(Key::SoftLimits) && !homing {
            Some(SOFT_LIMITS)
        } else if homing && crawls(Key::HomingLocate) {
            Some(const { Key::HomingLocate.number() })
        } else if homing && crawls(Key::HomingSeek) {
            Some(const { Key::HomingSeek.number() })
        } else if parking && self.whole(Key::ParkingAxis) as usize >= self.axes_in_use().min(LINEAR) {
            Some(const { Key::ParkingAxis.number() })
        } else if parking && crawls(Key::ParkingPullOutRate) {
            Some(const { Key::ParkingPullOutRate.number() })
        } else if parking && crawls(Key::ParkingFastRate) {
            Some(const { Key::ParkingFastRate.number() })
        } else {
            None
        }
    }
}

/// Rates (mm/min) and accelerations (mm/s²) that motion computes with; they reach far beyond any machine.
const RATES: core::ops::RangeInclusive<f32> = 3.0e-5..=6.0e6;
const ACCELERATIONS: core::ops::RangeInclusive<f32> = 1.0e-3..=1.0e7;
/// Jerk, mm/s³. With 1 a move of a millimetre takes three seconds: who sets less has mistaken the unit.
const JERKS: core::ops::RangeInclusive<f32> = 1.0..=1.0e10;
/// Most steps of slack that motion takes up.
const MOST_BACKLASH: f32 = 10_000.0;
/// Greatest junction deviation and least arc tolerance, mm.
const GREATEST_DEVIATION: f32 = 1.0e3;
const LEAST_TOLERANCE: f32 = 1.0e-4;
/// Number of the step pulse, for which Grbl has an error of its own.
const STEP_PULSE: u16 = Key::StepPulse.number();
/// Number of the setting that switches soft limits on.
const SOFT_LIMITS: u16 = Key::SoftLimits.number();
/// How `$20=1` is stored while homing is off. As 1 it counts only with homing on, so that the one record of `$22=0` switches
/// both off, whenever the power is cut.
const BEFORE_HOMING: f32 = 2.0;
/// Number of the setting that switches homing on.
const HOMING: u16 = Key::Homing.number();
/// Number of the one setting that may be negative.
const PARKING_PLACE: u16 = Key::ParkingTarget.number();
/// Number of the setting that names the axis with two motors.
const GANGED_AXIS: u16 = Key::GangedAxis.number();

#[cfg(test)]
mod tests {
    use super::*;

    fn rates(safe_hz: u32) -> StepRates {
        StepRates { safe_hz, least_pulse_tenths: 10 }
    }

    fn set(settings: &mut Settings<3>, number: u16, thousandths: i64) -> Result<(), Error> {
        settings.set(number, Decimal(thousandths * 10_000))
    }

    #[test]
    fn every_key_names_its_row() {
        for (key, number) in [
            (Key::StepPulse, 0),
            (Key::StatusReport, 10),
            (Key::ReportInches, 13),
            (Key::ControlInvert, 14),
            (Key::Homing, 22),
            (Key::HomingPullOff, 27),
            (Key::DirectionSetup, 29),
            (Key::SpindleMinimum, 31),
            (Key::Laser, 32),
            (Key::SpindlePwm, 33),
            (Key::JogClip, 40),
            (Key::HomingPasses, 43),
            (Key::ParkingTarget, 58),
            (Key::SquaringMost, 349),
            (Key::Dialect, 900),
            (Key::SpinDown, 539),
            (Key::TrustNeeded, 902),
            (Key::GangedSwitch, 907),
            (Key::ProbeNoPullUp, 19),
            (Key::EmergencyDriversOff, 913),
            (Key::HoldWithoutHost, 914),
            (Key::AtSpeedWithin, 916),
            (Key::CurveAcceleration, 917),
            (Key::JogSilence, 923),
        ] {
            assert_eq!(SCALARS[key as usize].number, number);
        }
        assert_eq!(PER_AXIS[AxisKey::Travel as usize].number, 130);
    }

    #[test]
    fn values_are_checked_before_they_are_taken() {
        let mut s = Settings::<3>::default();
        assert_eq!(set(&mut s, 0, 0), Err(Error::StepPulseTooShort));
        assert_eq!(set(&mut s, 0, 256_000), Err(Error::StepPulseTooShort));
        assert_eq!(set(&mut s, 1, 300_000), Err(Error::InvalidStatement));
        assert_eq!(set(&mut s, 103, 1_000), Err(Error::InvalidStatement));
        assert_eq!(set(&mut s, 7, 1_000), Err(Error::InvalidStatement));
        assert_eq!(set(&mut s, 11, -1), Err(Error::NegativeValue));
        assert_eq!(s, Settings::default());
        assert_eq!(set(&mut s, 102, 80_500), Ok(()));
        assert_eq!(s.axes(AxisKey::Resolution), PerAxis([250.0, 250.0, 80.5]));
        assert_eq!(s.by_number(102), Some(80.5));
    }

    /// `$0` is exact in tenths; what is not is refused, and so is what no board makes.
    #[test]
    fn a_step_pulse_is_taken_to_the_tenth_or_not_at_all() {
        let mut s = Settings::<3>::default();
        for tenths in 5..=2550_u16 {
            assert_eq!(set(&mut s, 0, i64::from(tenths) * 100), Ok(()));
            assert_eq!(s.step_pulse_tenths(), tenths);
            // As it is stored and found again.
            let mut other = Settings::<3>::default();
            other.restore(0, f32::from_le_bytes(s.by_number(0).unwrap().to_le_bytes()));
            assert_eq!(other.step_pulse_tenths(), tenths);
        }
        for (thousandths, error) in [
            (2_550, Error::InvalidStatement),
            (501, Error::InvalidStatement),
            (499, Error::StepPulseTooShort),
            (255_100, Error::StepPulseTooShort),
            (i64::MAX / 10_000, Error::StepPulseTooShort),
        ] {
            assert_eq!(set(&mut s, 0, thousandths), Err(error), "{thousandths}");
        }
        assert_eq!(s.step_pulse_tenths(), 2550);
        // Grbl's dialect has whole microseconds, and cuts off as Grbl does.
        set(&mut s, 900, 0).unwrap();
        for (thousandths, tenths) in
            [(3_000, Some(30)), (3_999, Some(30)), (255_900, Some(2550)), (2_999, None), (256_000, None)]
        {
            let taken = set(&mut s, 0, thousandths);
            assert_eq!(taken, tenths.map_or(Err(Error::StepPulseTooShort), |_| Ok(())), "{thousandths}");
            assert!(tenths.is_none_or(|tenths| s.step_pulse_tenths() == tenths), "{thousandths}");
        }
    }

    /// A record is the value in microseconds, as it was when only whole ones could be set: it is read as before.
    #[test]
    fn a_step_pulse_stored_in_whole_microseconds_is_read_as_it_was() {
        for (record, tenths) in
            [([0x00, 0x00, 0x80, 0x3f], 10), ([0x00, 0x00, 0x20, 0x41], 100), ([0x00, 0x00, 0x7f, 0x43], 2550)]
        {
            let mut s = Settings::<3>::default();
            set(&mut s, 0, 2_500).unwrap();
            s.restore(0, f32::from_le_bytes(record));
            assert_eq!(s.step_pulse_tenths(), tenths);
        }
    }

    #[test]
    fn a_pulse_that_the_board_does_not_make_locks_motion() {
        let mut s = Settings::<3>::default();
        set(&mut s, 0, 900).unwrap();
        assert_eq!(s.unrunnable(rates(490_000), true), Some(0));
        assert_eq!(s.unrunnable(StepRates { least_pulse_tenths: 9, ..rates(490_000) }, true), None);
    }

    #[test]
    fn masks_take_their_bits_only() {
        let mut s = Settings::<3>::default();
        for (number, mask, taken) in [(14, 256 + 64 + 8, true), (14, 16, false), (18, 127, true), (908, 128, false)] {
            assert_eq!(set(&mut s, number, mask * 1000).is_ok(), taken, "${number}={mask}");
        }
    }

    #[test]
    fn soft_limits_live_and_die_with_homing() {
        let mut s = Settings::<3>::default();
        set(&mut s, 900, 0).unwrap();
        assert_eq!(set(&mut s, 20, 1_000), Err(Error::SoftLimitNeedsHoming));
        set(&mut s, 22, 1_000).unwrap();
        set(&mut s, 20, 1_000).unwrap();
        set(&mut s, 22, 0).unwrap();
        assert!(!s.is_on(Key::SoftLimits));
    }

    #[test]
    fn a_set_that_cannot_run_names_its_setting() {
        let mut s = Settings::<3>::default();
        assert_eq!(s.unrunnable(rates(100_000), true), None);
        set(&mut s, 101, 0).unwrap();
        assert_eq!(s.unrunnable(rates(100_000), true), Some(101));
        set(&mut s, 101, 250_000).unwrap();
        set(&mut s, 112, 30_000_000).unwrap();
        assert_eq!(s.unrunnable(rates(100_000), true), Some(112));
        set(&mut s, 112, 500_000).unwrap();
        set(&mut s, 120, 0).unwrap();
        assert_eq!(s.unrunnable(rates(100_000), true), Some(120));
        set(&mut s, 120, 10_000).unwrap();
        set(&mut s, 222, 500).unwrap();
        assert_eq!(s.unrunnable(rates(100_000), true), Some(222));
        assert_eq!(set(&mut s, 222, -1), Err(Error::NegativeValue));
        set(&mut s, 222, 0).unwrap();
        assert_eq!(s.unrunnable(rates(100_000), true), None);
    }

    #[test]
    fn motors_that_pull_together_add_their_rates() {
        let mut s = Settings::<3>::default();
        for (number, value) in [(110, 12_000), (111, 9_000)] {
            set(&mut s, number, value * 1000).unwrap();
        }
        // 250 steps/mm: 50,000 and 37,500 steps/s, and along the diagonal of a CoreXY machine 87,500.
        assert_eq!(s.unrunnable(rates(83_000), true), None);
        set(&mut s, 904, 1000).unwrap();
        assert_eq!(s.unrunnable(rates(83_000), true), Some(110));
        set(&mut s, 0, 3000).unwrap();
        assert_eq!(s.unrunnable(rates(88_000), true), None);
    }

    #[test]
    fn a_second_motor_needs_its_pins() {
        let mut s = Settings::<3>::default();
        set(&mut s, 905, 2000).unwrap();
        assert_eq!(s.unrunnable(rates(100_000), true), None);
        assert_eq!(s.unrunnable(rates(100_000), false), Some(905));
        set(&mut s, 904, 1000).unwrap();
        assert_eq!(s.unrunnable(rates(100_000), true), Some(905));
    }

    #[test]
    fn homing_cycles_are_those_of_the_machine() {
        let cycles = |s: &Settings<3>| s.axes(AxisKey::HomingCycle).0;
        let mut s = Settings::<3>::default();
        assert_eq!(cycles(&s), [4.0, 3.0, 0.0]);
        assert_eq!(set(&mut s, 44, 8000), Err(Error::InvalidStatement));
        assert_eq!(set(&mut s, 47, 1000), Err(Error::InvalidStatement));
        set(&mut s, 44, 1000).unwrap();
        assert_eq!(cycles(&s), [1.0, 3.0, 0.0]);
        assert_eq!(Settings::<4>::default().axes(AxisKey::HomingCycle).0, [4.0, 3.0, 0.0, 0.0], "A has no switch");
    }

    #[test]
    fn axes_that_are_not_in_use_have_no_settings() {
        let mut s = Settings::<4>::default();
        let listed = |s: &Settings<4>| (0..).map_while(|line| s.row(line)).map(|row| row.1).collect::<Vec<_>>();
        let three = listed(&s);
        let of_three = Settings::<3>::default();
        assert_eq!(three, (0..Settings::<3>::LINES).map(|line| of_three.row(line).unwrap().1).collect::<Vec<_>>());
        // A set of settings may come in any order.
        s.set(103, Decimal::from_int(7)).unwrap();
        s.set(44, Decimal::from_int(12)).unwrap();
        assert_eq!((listed(&s), s.homing_cycles().0), (three.clone(), [4, 3, 0, 0]));
        s.set(930, Decimal::from_int(4)).unwrap();
        assert_eq!(s.homing_cycles().0, [12, 3, 0, 0]);
        assert_eq!((s.axes_in_use(), listed(&s).len()), (4, Settings::<4>::LINES));
        s.set(103, Decimal::from_int(10)).unwrap();
        s.set(44, Decimal::from_int(12)).unwrap();
        s.set(103, Decimal::ZERO).unwrap();
        assert_eq!(s.unrunnable(rates(100_000), true), Some(103));
        s.set(930, Decimal::from_int(3)).unwrap();
        assert_eq!((s.unrunnable(rates(100_000), true), s.homing_cycles().0), (None, [4, 3, 0, 0]));
        assert_eq!(listed(&s), three);
        s.set(930, Decimal::from_int(4)).unwrap();
        s.set(900, Decimal::ZERO).unwrap();
        assert_eq!((s.axes_in_use(), listed(&s)), (3, three), "to Grbl");
        assert_eq!(s.set(103, Decimal::from_int(10)), Err(Error::InvalidStatement));
        assert_eq!(s.set(44, Decimal::from_int(8)), Err(Error::InvalidStatement));
        assert_eq!(
            Settings::<4>::of_board(3).set(103, Decimal::from_int(10)),
            Err(Error::InvalidStatement),
            "no motor"
        );
        assert_eq!(Settings::<3>::default().set(103, Decimal::from_int(10)), Err(Error::InvalidStatement));
    }

    #[test]
    fn a_board_declines_axes_for_which_it_has_no_motors() {
        for mut s in [Settings::<4>::of_board(3), Settings::<4>::of_board(4)] {
            let has_four = s.present == 4;
            s.set(930, Decimal::from_int(4)).unwrap();
            assert_eq!(s.axes_in_use(), if has_four { 4 } else { 3 });
            assert_eq!(s.unrunnable(rates(100_000), true), (!has_four).then_some(930));
            s.set(905, Decimal::from_int(2)).unwrap();
            assert!(s.unrunnable(rates(100_000), true).is_some(), "one motor too few");
            s.set(930, Decimal::from_int(3)).unwrap();
            assert_eq!(s.unrunnable(rates(100_000), true), None);
        }
        let mut s = Settings::<3>::default();
        s.set(930, Decimal::from_int(4)).unwrap();
        assert_eq!((s.axes_in_use(), s.unrunnable(rates(100_000), true)), (3, Some(930)));
    }

    #[test]
    fn the_listing_has_every_row_once() {
        let s = Settings::<3>::default();
        let numbers: Vec<u16> = (0..Settings::<3>::LINES).map(|i| s.row(i).unwrap().1).collect();
        assert!(numbers.contains(&132) && numbers.contains(&900));
        let mut unique = numbers.clone();
        unique.sort_unstable();
        unique.dedup();
        assert_eq!(unique.len(), numbers.len());
        assert!(s.row(Settings::<3>::LINES).is_none());
    }
}
