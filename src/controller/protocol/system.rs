//! Parses `$` lines: returns the command with its value, and the states in which the command is allowed. The commands
//! are executed in `host::commands`.

use super::line_checksum::is_session;
use crate::axes::Axis;
use crate::error::Error;
use crate::number::{self, Digits, Number};
use crate::units::Decimal;

/// A `$` command.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum System<'a> {
    /// `$`: lists the commands.
    Help,
    /// `$$`: lists the settings.
    Settings,
    /// `$#`: lists the coordinate systems, offsets and tools, and the result of the latest probing move.
    Parameters,
    /// `$G`: shows the modal state.
    ParserState,
    /// `$I`: shows the version and the enabled options.
    BuildInfo,
    /// `$I+`: as `$I`, and shows the axes, the options that a sender may use, and the board.
    MoreBuildInfo,
    /// `$ES`, `$ESG`, `$ESH`, `$EG`, `$EE`, `$EA`: describes settings, groups, errors or alarms.
    Describe(Described),
    /// `$E`: explains the most recently refused line.
    Refusal,
    /// `$I=text`: stores a text that `$I` shows.
    SetBuildInfo(&'a [u8]),
    /// `$N`: lists the startup lines.
    StartupLines,
    /// `$N0=line`, `$N1=line`: executes a startup line and, if it is valid, stores it.
    SetStartupLine(usize, &'a [u8]),
    /// `$M`: lists the macros.
    Macros,
    /// `$M0=line` to `$M63=line`: stores a line of the macros.
    SetMacro(usize, &'a [u8]),
    /// `$C`: switches check mode on or off.
    CheckMode,
    /// `$X`: unlocks the machine.
    Unlock,
    /// `$H`: homes the machine. `$HX` and so on: homes one axis.
    Home(Option<Axis>),
    /// `$J=...`: jogs. The text is what follows the `=`.
    Jog(&'a [u8]),
    /// `$RST=$`, `$RST=#`, `$RST=*`: restores defaults.
    Restore(Restore),
    /// `$RC`: shows why the machine was restarted.
    ResetCause,
    /// `$REC`: lists the recording.
    Recording,
    /// `$PINS`: lists the input pins.
    Pins,
    /// `$PINS=0`: clears the noise counters of the input pins.
    ClearNoise,
    /// `$LC=ON`: switches line checksums on. `Some` holds the letters after `ON`, which name the session; they can be
    /// empty. `$LC=OFF` (`None`): switches line checksums off.
    CheckLines(Option<&'a [u8]>),
    /// `$SLP`: puts the machine to sleep.
    Sleep,
    /// `$REBOOT`: restarts the board. `$DFU`: restarts it into the boot loader of the chip.
    Reboot {
        /// `true` for `$DFU`, `false` for `$REBOOT`.
        into_loader: bool,
    },
    /// `$n=v`: sets setting `n` to `v`.
    Set(u16, Decimal),
}

/// Format in which settings are described.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Format {
    /// `$ES`: fields between bars, for programs.
    Fields,
    /// `$ESG`: comma-separated values, like the tables of codes that come with Grbl.
    Commas,
    /// `$ESH`: tab-separated values.
    Tabs,
}

impl System<'_> {
    /// Checks that Grbl has this command. If Grbl does not know a letter after `$`, it tries to read a setting number
    /// there, and answers with an error. For a command that Grbl lacks, this function returns that error.
    ///
    /// # Errors
    /// [`Error::BadNumber`], [`Error::InvalidStatement`].
    pub fn known_to_grbl(&self) -> Result<(), Error> {
        match self {
            System::Pins
            | System::ClearNoise
            | System::Describe(_)
            | System::Refusal
            | System::CheckLines(_)
            | System::Macros
            | System::SetMacro(..)
            | System::Reboot { into_loader: true } => Err(Error::BadNumber),
            System::MoreBuildInfo | System::Recording | System::Reboot { into_loader: false } => {
                Err(Error::InvalidStatement)
            }
            _ => Ok(()),
        }
    }
}

/// What a command describes: `$ES`, `$ESG`, `$ESH`, `$EG`, `$EE` or `$EA`, or grblHAL's `$EEG` or `$EAG`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Described {
    /// All settings.
    Settings(Format),
    /// The groups of settings.
    Groups,
    /// The meanings of `error:N`.
    Errors,
    /// The meanings of `ALARM:N`.
    Alarms,
    /// `$EEG`, only with `$900=3`: the meanings of `error:N` as comma-separated values.
    ErrorTable,
    /// `$EAG`, only with `$900=3`: the meanings of `ALARM:N` as comma-separated values.
    AlarmTable,
}

/// What `$RST` resets to defaults.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Restore {
    /// The settings, except the dialect (`$900`).
    Settings,
    /// Coordinate systems, G28, G30 and the tool table.
    Coordinates,
    /// Settings except the dialect (`$900`), coordinate systems, G28, G30, tools, startup lines, macros and build info.
    All,
}

/// States in which a `$` command is allowed. The state is checked before the rest of the line is parsed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Allowed {
    /// Allowed in any state. (`$$` is checked once more when it is executed: it is refused while the machine moves.)
    Always,
    /// Allowed only in idle or alarm.
    AtRest,
    /// Allowed only in idle or during a jog.
    ForJog,
}

/// Returns the states in which a line is allowed, judged by its first letters. The line begins with `$`.
pub fn allowed(line: &[u8]) -> Allowed {
    match line.get(1) {
        None | Some(b'$' | b'G' | b'C' | b'X' | b'L') => Allowed::Always,
        Some(b'P') if line.starts_with(b"$PINS") => Allowed::Always,
        Some(b'E') if line.len() == 2 => Allowed::Always,
        Some(b'J') => Allowed::ForJog,
        Some(_) => Allowed::AtRest,
    }
}

/// Parses a `$` line (filtered; begins with `$`).
///
/// # Errors
/// [`Error::InvalidStatement`] for a known command with invalid text after it, [`Error::BadNumber`] for an unknown
/// command.
pub fn read(line: &[u8]) -> Result<System<'_>, Error> {
    let rest = line.get(2..).unwrap_or(&[]);
    let alone = |command| if rest.is_empty() { Ok(command) } else { Err(Error::InvalidStatement) };
    match line.get(1) {
        None => Ok(System::Help),
        Some(b'$') => alone(System::Settings),
        Some(b'G') => alone(System::ParserState),
        Some(b'C') => alone(System::CheckMode),
        Some(b'X') => alone(System::Unlock),
        Some(b'#') => alone(System::Parameters),
        Some(b'J') => rest.strip_prefix(b"=").map(System::Jog).ok_or(Error::InvalidStatement),
        Some(b'L') => match rest {
            b"C=OFF" => Ok(System::CheckLines(None)),
            _ => match rest.strip_prefix(b"C=ON") {
                Some(session) if is_session(session) => Ok(System::CheckLines(Some(session))),
                _ if rest.starts_with(b"C") => Err(Error::InvalidStatement),
                _ => Err(Error::BadNumber),
            },
        },
        Some(b'S') if rest == b"LP" => Ok(System::Sleep),
        Some(b'S') => Err(Error::InvalidStatement),
        Some(b'I') if rest.is_empty() => Ok(System::BuildInfo),
        Some(b'I') if rest == b"+" => Ok(System::MoreBuildInfo),
        Some(b'E') => describe(rest),
        Some(b'I') => rest.strip_prefix(b"=").map(System::SetBuildInfo).ok_or(Error::InvalidStatement),
        Some(b'H') => match rest {
            [] => Ok(System::Home(None)),
            [letter] => Axis::from_letter(*letter).map(|a| System::Home(Some(a))).ok_or(Error::InvalidStatement),
            _ => Err(Error::InvalidStatement),
        },
        Some(b'R') => match rest {
            b"ST=$" => Ok(System::Restore(Restore::Settings)),
            b"ST=#" => Ok(System::Restore(Restore::Coordinates)),
            b"ST=*" => Ok(System::Restore(Restore::All)),
            b"C" => Ok(System::ResetCause),
            b"EC" => Ok(System::Recording),
            b"EBOOT" => Ok(System::Reboot { into_loader: false }),
            _ => Err(Error::InvalidStatement),
        },
        Some(b'P') if rest == b"INS" => Ok(System::Pins),
        Some(b'P') if rest == b"INS=0" => Ok(System::ClearNoise),
        Some(b'P') if rest.starts_with(b"INS") => Err(Error::InvalidStatement),
        Some(b'D') if rest == b"FU" => Ok(System::Reboot { into_loader: true }),
        Some(b'N') if rest.is_empty() => Ok(System::StartupLines),
        Some(b'N') => {
            let (index, line) = numbered(rest)?;
            match index {
                0 | 1 => Ok(System::SetStartupLine(usize::from(index), line)),
                _ => Err(Error::InvalidStatement),
            }
        }
        Some(b'M') if rest.is_empty() => Ok(System::Macros),
        // Grbl has no `$M`, and answers `BadNumber` to an unknown letter. So any error in the number becomes
        // `BadNumber`.
        Some(b'M') => {
            let (index, line) = numbered(rest).map_err(|_| Error::BadNumber)?;
            Ok(System::SetMacro(usize::from(index), line))
        }
        Some(_) => {
            let (setting, text) = numbered(line.get(1..).unwrap_or(&[]))?;
            let Number { value, used, .. } = number::read(text, Digits::Exact).ok_or(Error::BadNumber)?;
            if used == text.len() { Ok(System::Set(setting, value)) } else { Err(Error::InvalidStatement) }
        }
    }
}

/// Parses the part of a line after `$E`. Grbl has no such command and answers `BadNumber` to every `$E` line. This
/// function returns the same error if the part is unknown.
fn describe(rest: &[u8]) -> Result<System<'_>, Error> {
    Ok(System::Describe(match rest {
        b"" => return Ok(System::Refusal),
        b"S" => Described::Settings(Format::Fields),
        b"SG" => Described::Settings(Format::Commas),
        b"SH" => Described::Settings(Format::Tabs),
        b"G" => Described::Groups,
        b"E" => Described::Errors,
        b"A" => Described::Alarms,
        _ => return Err(Error::BadNumber),
    }))
}

/// Splits `n=text`. A fraction of `n` is truncated, as in Grbl. An `n` out of range becomes `u16::MAX`, which no
/// setting has.
fn numbered(text: &[u8]) -> Result<(u16, &[u8]), Error> {
    let Number { value: index, used, .. } = number::read(text, Digits::Exact).ok_or(Error::BadNumber)?;
    let rest = text.get(used..).and_then(|t| t.strip_prefix(b"=")).ok_or(Error::InvalidStatement)?;
    let index = if index < Decimal::ZERO { u16::MAX } else { u16::try_from(index.truncate()).unwrap_or(u16::MAX) };
    Ok((index, rest))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn commands_are_read() {
        assert_eq!(read(b"$"), Ok(System::Help));
        assert_eq!(read(b"$100=250.5"), Ok(System::Set(100, Decimal(2_505_000_000))));
        assert_eq!(read(b"$1.5=3"), Ok(System::Set(1, Decimal::from_int(3))));
        assert_eq!(read(b"$N1=G20"), Ok(System::SetStartupLine(1, b"G20")));
        assert_eq!(read(b"$M12=G0X1"), Ok(System::SetMacro(12, b"G0X1")));
        assert_eq!(read(b"$M"), Ok(System::Macros));
        assert_eq!(read(b"$HX"), Ok(System::Home(Some(Axis::X))));
        assert_eq!(read(b"$RST=*"), Ok(System::Restore(Restore::All)));
        assert_eq!(read(b"$I+"), Ok(System::MoreBuildInfo));
        assert_eq!(read(b"$ESH"), Ok(System::Describe(Described::Settings(Format::Tabs))));
        assert_eq!(read(b"$E"), Ok(System::Refusal));
        assert_eq!(read(b"$REC"), Ok(System::Recording));
        assert_eq!(read(b"$EA"), Ok(System::Describe(Described::Alarms)));
        assert_eq!(read(b"$REBOOT"), Ok(System::Reboot { into_loader: false }));
        assert_eq!(read(b"$DFU"), Ok(System::Reboot { into_loader: true }));
        assert_eq!(read(b"$I=ABC"), Ok(System::SetBuildInfo(b"ABC")));
    }

    #[test]
    fn refusals_have_grbls_numbers() {
        for line in [
            "$$X", "$GX", "$J", "$JX1", "$C1", "$SLPX", "$S", "$IX", "$I+1", "$RST", "$RST=X", "$N0", "$N2=G0",
            "$N-1=G0", "$REBOOT1", "$REBOO",
        ] {
            assert_eq!(read(line.as_bytes()), Err(Error::InvalidStatement), "{line}");
        }
        for line in ["$1", "$1=5X", "$1=25ABC", "$HQ"] {
            assert_eq!(read(line.as_bytes()), Err(Error::InvalidStatement), "{line}");
        }
        for line in
            ["$Z", "$ABC", "$DFUX", "$D", "$ESX", "$EGG", "$1=", "$=5", "$1=ABC", "$NX=G20", "$N=", "$M1", "$MX"]
        {
            assert_eq!(read(line.as_bytes()), Err(Error::BadNumber), "{line}");
        }
    }
}
