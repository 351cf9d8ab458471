//! The axes of the machine: their letters, sets of axes ([`AxisMask`]), and [`PerAxis`], which holds one value for each
//! axis. Also how the motors move the axes: Cartesian or CoreXY.
//!
//! The number of axes `N` (3 to 6) is a constant of the board and a const generic here. So a board with three axes
//! spends memory and time on three axes only. X, Y and Z always exist. A, B and C exist if `N` includes them and
//! `$930` puts them in use. An axis that is not in use never moves and appears in no report.
//!
//! X, Y and Z are lengths in millimetres; A, B and C are angles in degrees. Where a comment says millimetres, read
//! degrees for A, B and C.

/// An axis of the machine. Axes are ordered as in [`Axis::ALL`]: X, Y, Z, A, B, C.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Axis {
    /// First axis: linear, in millimetres.
    X,
    /// Second axis: linear, in millimetres.
    Y,
    /// Third axis: linear, in millimetres, along the spindle.
    Z,
    /// Fourth axis: rotary, in degrees.
    A,
    /// Fifth axis: rotary, in degrees.
    B,
    /// Sixth axis: rotary, in degrees.
    C,
}

impl Axis {
    /// All axes that a board can have, in order.
    pub const ALL: [Axis; 6] = [Axis::X, Axis::Y, Axis::Z, Axis::A, Axis::B, Axis::C];

    /// Returns the index of the axis in a [`PerAxis`], 0 for X.
    pub const fn index(self) -> usize {
        self as usize
    }

    /// Returns the upper-case letter that names the axis in a program.
    pub const fn letter(self) -> u8 {
        match self {
            Axis::X => b'X',
            Axis::Y => b'Y',
            Axis::Z => b'Z',
            Axis::A => b'A',
            Axis::B => b'B',
            Axis::C => b'C',
        }
    }

    /// Returns the axis that an upper-case letter names; `None` if the letter names no axis.
    pub const fn from_letter(letter: u8) -> Option<Axis> {
        match letter {
            b'X' => Some(Axis::X),
            b'Y' => Some(Axis::Y),
            b'Z' => Some(Axis::Z),
            b'A' => Some(Axis::A),
            b'B' => Some(Axis::B),
            b'C' => Some(Axis::C),
            _ => None,
        }
    }

    /// Returns whether the axis is rotary: its coordinates are degrees.
    pub const fn is_rotary(self) -> bool {
        self as usize >= LINEAR
    }

    /// Returns whether the travel of the axis is limited: always for X, Y and Z. A rotary axis turns without limit if
    /// its `travel`, in degrees, is 0.
    pub fn has_ends(self, travel: f32) -> bool {
        !self.is_rotary() || travel > 0.0
    }

    /// Returns the axes of a machine with `N` axes, in order.
    pub fn of_machine<const N: usize>() -> impl Iterator<Item = Axis> {
        Axis::ALL.into_iter().take(N)
    }
}

/// Number of linear axes: the first ones, X to Z.
pub const LINEAR: usize = 3;

/// How the motors move the tool.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Arrangement {
    /// Each motor moves one axis.
    #[default]
    Cartesian,
    /// The motor of X turns by the sum of the X and Y displacements of the tool, the motor of Y by X minus Y.
    CoreXy,
}

/// One value for each of the machine's `N` axes, X first.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PerAxis<T, const N: usize>(pub [T; N]);

impl<T: Copy, const N: usize> PerAxis<T, N> {
    /// Returns a `PerAxis` in which every axis has this value.
    pub const fn all(value: T) -> Self {
        Self([value; N])
    }

    /// Calls `make` for each axis, in order, to get its value.
    pub fn from_axis(mut make: impl FnMut(Axis) -> T) -> Self {
        Self(core::array::from_fn(|i| make(Axis::ALL.get(i).copied().unwrap_or(Axis::X))))
    }

    /// Returns the value of an axis; `None` if this machine does not have the axis.
    pub fn get(&self, axis: Axis) -> Option<T> {
        self.0.get(axis.index()).copied()
    }

    /// Replaces the value of an axis. An axis that this machine does not have is ignored.
    pub fn set(&mut self, axis: Axis, value: T) {
        if let Some(slot) = self.0.get_mut(axis.index()) {
            *slot = value;
        }
    }

    /// Returns `make(value)` for each axis.
    pub fn map<U: Copy>(&self, make: impl FnMut(T) -> U) -> PerAxis<U, N> {
        PerAxis(self.0.map(make))
    }

    /// Returns `make(own, other)` for each axis, from its values in `self` and in `other`.
    #[allow(clippy::indexing_slicing, reason = "from_fn calls with i < N, and both arrays have N values")]
    pub fn zip<U: Copy, V: Copy>(&self, other: &PerAxis<U, N>, mut make: impl FnMut(T, U) -> V) -> PerAxis<V, N> {
        PerAxis(core::array::from_fn(|i| make(self.0[i], other.0[i])))
    }

    /// Returns the values, X first.
    pub fn iter(&self) -> impl Iterator<Item = &T> {
        self.0.iter()
    }

    /// Returns the values, X first, so that the caller can change them.
    pub fn iter_mut(&mut self) -> impl Iterator<Item = &mut T> {
        self.0.iter_mut()
    }
}

impl<T: Copy + Default, const N: usize> Default for PerAxis<T, N> {
    fn default() -> Self {
        Self([T::default(); N])
    }
}

/// A set of axes, one bit for each: 1 for X, 2 for Y, 4 for Z, and so on.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct AxisMask(pub u8);

impl AxisMask {
    /// The empty set, as for a line without axis words.
    pub const NONE: AxisMask = AxisMask(0);

    /// Returns the set with `axis` added.
    pub const fn with(self, axis: Axis) -> AxisMask {
        AxisMask(self.0 | (1 << axis.index()))
    }

    /// Returns whether the axis is in the set.
    pub const fn has(self, axis: Axis) -> bool {
        self.0 & (1 << axis.index()) != 0
    }

    /// Returns whether the set is empty.
    pub const fn is_empty(self) -> bool {
        self.0 == 0
    }
}
