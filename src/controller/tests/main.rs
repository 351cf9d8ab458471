//! Tests of the controller through its public interface. They are modules of one program, so that it is compiled and
//! linked only once.

mod board;
mod program;
#[cfg(feature = "full")]
mod subprogram_sender;

mod damaged_lines;
mod gcode_cycles;
mod gcode_document;
mod gcode_errors;
mod gcode_fanuc_macros;
mod gcode_flow;
mod gcode_habits;
mod gcode_left_out;
mod gcode_macros;
mod gcode_parameters;
mod gcode_pins;
mod gcode_properties;
mod gcode_reasons;
mod gcode_recordings;
mod gcode_rotary;
mod gcode_rotation;
mod gcode_scaling;
mod gcode_splines;
mod gcode_state;
mod gcode_subprograms;
mod gcode_tools;
mod gcode_written_out;
mod joined_start;
mod pump;
mod recorder;
mod restart;
