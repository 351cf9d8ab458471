//! Outputs and inputs of programs: M62 to M65 switch an output, M66 waits for an input or reads one, M67 and M68 set an
//! analog output. P or E is the number of the pin. Whether the board has this pin is checked when the line is executed.

use super::draft::Draft;
use crate::error::Error;
use crate::gcode::action::{InputWait, ProgramPins};
use crate::gcode::values::{seconds, whole};
use crate::gcode::word::Letters;
use crate::image::FULL_IMAGE;
use crate::units::{Decimal, Duration};

impl<const N: usize> Draft<'_, N> {
    /// Reads M62 to M68. If the line also has a dwell or an arc with P, both words use the same P, as in LinuxCNC.
    pub(super) fn pins(&mut self) -> Result<(), Error> {
        let Some(word) = self.line.extended.pins.filter(|_| FULL_IMAGE) else { return Ok(()) };
        let (has_p, has_e) = (self.line.values.has(b'P'), self.line.values.has(b'E'));
        self.action.after.pins = Some(match word {
            62..=65 => {
                let number = self.pin(b'P', self.line.value(b'P'))?;
                ProgramPins::Digital { number, on: word % 2 == 0, with_motion: word < 64 }
            }
            66 if has_p && has_e => return Err(Error::UnusedWords),
            66 if has_e => {
                if self.wait()? != InputWait::Nothing {
                    return Err(Error::ValueOutOfRange);
                }
                ProgramPins::ReadAnalog { number: self.pin(b'E', self.line.value(b'E'))? }
            }
            66 => {
                let number = self.pin(b'P', self.line.value(b'P'))?;
                let until = self.wait()?;
                let longest = match self.line.value(b'Q') {
                    q if q > Decimal::ZERO => seconds(q),
                    _ if until == InputWait::Nothing => Duration::from_ticks(0),
                    _ if self.line.values.has(b'Q') => return Err(Error::ValueOutOfRange),
                    _ => return Err(Error::ValueWordMissing),
                };
                ProgramPins::Wait { number, until, longest }
            }
            _ => {
                let number = self.pin(b'E', self.line.value(b'E'))?;
                if !self.line.values.has(b'Q') {
                    return Err(Error::ValueWordMissing);
                }
                ProgramPins::Analog { number, value: self.line.value(b'Q'), with_motion: word == 67 }
            }
        });
        self.unused.remove(match word {
            62..=65 => Letters::of(b"P"),
            66 => Letters::of(b"PELQ"),
            _ => Letters::of(b"EQ"),
        });
        Ok(())
    }

    fn pin(&self, letter: u8, value: Decimal) -> Result<u32, Error> {
        if !self.line.values.has(letter) {
            return Err(Error::ValueWordMissing);
        }
        // P can be negative here if a spline on the line also uses it.
        if value < Decimal::ZERO {
            return Err(Error::NegativeValue);
        }
        Ok(whole(value)?.unsigned_abs())
    }

    /// Reads L of M66, the condition to wait for; the default is L0.
    fn wait(&self) -> Result<InputWait, Error> {
        Ok(match whole(self.line.value(b'L'))? {
            0 => InputWait::Nothing,
            1 => InputWait::Rise,
            2 => InputWait::Fall,
            3 => InputWait::High,
            4 => InputWait::Low,
            _ => return Err(Error::ValueOutOfRange),
        })
    }
}
