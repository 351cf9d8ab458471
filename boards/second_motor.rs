//! What step and direction pins must know of a second motor of an axis.

/// How the pins of the fourth motor are driven: as the second motor of an axis, or not at all.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct SecondMotor {
    /// Its axis, bit 0 for X; 0 = there is none.
    pub axis: u8,
    /// It turns the other way.
    pub inverted: bool,
    /// It stands still while its axis moves.
    pub stands: bool,
    /// The axis' own motor stands still.
    pub first_stands: bool,
}
