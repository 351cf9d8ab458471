//! Which firmware image this build makes: the full one, or the small one for boards with 256 KiB of flash.

/// Whether this is the full image. The small one lacks expressions, parameters and O words; rotated and scaled
/// coordinates; splines; rounded corners (G64 P); words that CAM programs write for other controls; outputs and inputs
/// of programs; texts of settings and errors; and the recorder.
pub const FULL_IMAGE: bool = cfg!(feature = "full");
