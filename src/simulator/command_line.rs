//! The command line: commands, options and exit status. Help texts and manual pages are generated from the comments of
//! this file.

use crate::boards::{self, Board};
use crate::power_up::{Dialect, board_named};
use crate::resume::{SPIN_UP, number_of};
use clap::{Args, Parser, Subcommand};
use oxmill_controller::axes::LINEAR;
use std::path::PathBuf;

/// Text about the exit status of the program, shown after the help text.
pub const EXIT_STATUS: &str = "\
Exit status:
  0  all went well
  1  the job has refused lines, ended in an alarm, or was not taken to its end; `settings import`: an entry was not taken
  2  it could not be begun, or a file could not be read to its end or written
  3  `replay`: steps, outputs or times are not those of the recording, or cannot be compared with them";

/// Oxmill's simulator: runs G-code through the same controller as a board, or acts as a board on a port.
#[derive(Debug, Parser)]
#[command(name = "oxmill", version, after_help = EXIT_STATUS)]
pub struct CommandLine {
    /// The command.
    #[command(subcommand)]
    pub command: Command,
}

/// The commands of the program.
#[derive(Debug, Subcommand)]
pub enum Command {
    /// Runs a G-code file in simulated time and reports what the machine did.
    Run(Run),
    /// Checks a G-code file: whether the machine can run it, how long it takes and how far it moves.
    Check(CheckJob),
    /// Runs a G-code file and draws its tool path and its speed over time.
    Plot(PlotJob),
    /// Acts as a Grbl controller to which any sender can connect.
    Serve(Serve),
    /// Replays a recording, and reports what the machine did and whether it was the same.
    Replay(Replay),
    /// Writes the rest of a job, from one of its lines on, as a separate program: modal state, tool, offsets, the move to the
    /// position, spindle and coolant, and the lines.
    Resume(ResumeJob),
    /// Settings of a machine.
    #[command(subcommand)]
    Settings(SettingsCommand),
    /// Shows the pin table of a board, checks a table of your own, or writes it into an image of the firmware.
    #[command(subcommand)]
    Board(BoardCommand),
    /// Writes the completions for a shell to standard output.
    Completions {
        /// The shell.
        shell: clap_complete::Shell,
    },
    /// Writes the manual to standard output: one page for the program and one for each command.
    Man {
        /// Writes each page to a file in this folder instead: oxmill.1, oxmill-run.1 and so on.
        #[arg(long, value_name = "FOLDER")]
        out: Option<PathBuf>,
    },
}

/// The commands of `oxmill board`.
#[derive(Debug, Subcommand)]
pub enum BoardCommand {
    /// Lists the boards: name, chip and title.
    List,
    /// Writes the file of a board to standard output, to begin your own table with.
    Show {
        /// The name of the board.
        name: String,
    },
    /// Checks a table: which pin each function has, and whether the image allows it.
    Check {
        /// The table, a TOML file as `board show` writes it; `-` for standard input.
        table: PathBuf,
    },
    /// Writes a table into an image of the firmware. Without `-o`, the image itself is changed.
    Write {
        /// The image: .hex, .dfu, .elf or .bin.
        image: PathBuf,
        /// The table, a TOML file; `-` for standard input.
        table: PathBuf,
        /// The file for the changed image.
        #[arg(short, long, value_name = "FILE")]
        output: Option<PathBuf>,
    },
}

/// Arguments of `oxmill run`.
#[derive(Debug, Args)]
pub struct Run {
    /// The job: .nc .ngc .gcode .gc .tap .mpf .cnc .min or any other text file; `-` for standard input.
    pub job: PathBuf,
    /// Prints the summary as a JSON object.
    #[arg(long)]
    pub json: bool,
    /// Draws the tool path and its speed over time into this file. Can be repeated.
    #[arg(long, value_name = "FILE.svg|FILE.png")]
    pub plot: Vec<PathBuf>,
    /// Writes a row for each step event into this file.
    #[arg(long, value_name = "FILE.csv")]
    pub trace: Option<PathBuf>,
    /// Records all input into this file, for `replay`.
    #[arg(long, value_name = "FILE", conflicts_with = "work_zero")]
    pub record: Option<PathBuf>,
    /// Preparation of the machine before the job.
    #[command(flatten)]
    pub start: Start,
    /// The simulated machine: board, settings, hardware and store.
    #[command(flatten)]
    pub machine: MachineOptions,
}

/// Arguments of `oxmill check`.
#[derive(Debug, Args)]
pub struct CheckJob {
    /// The job: any text file, or `-` for standard input.
    pub job: PathBuf,
    /// Prints the summary as a JSON object, in the same form as `run --json`.
    #[arg(long)]
    pub json: bool,
    /// Preparation of the machine before the job.
    #[command(flatten)]
    pub start: Start,
    /// The simulated machine: board, settings, hardware and store.
    #[command(flatten)]
    pub machine: MachineOptions,
}

/// Arguments of `oxmill plot`.
#[derive(Debug, Args)]
pub struct PlotJob {
    /// The job: any text file, or `-` for standard input.
    pub job: PathBuf,
    /// The file for the drawing. Can be repeated.
    #[arg(short, long, required = true, value_name = "FILE.svg|FILE.png")]
    pub output: Vec<PathBuf>,
    /// Preparation of the machine before the job.
    #[command(flatten)]
    pub start: Start,
    /// The simulated machine: board, settings, hardware and store.
    #[command(flatten)]
    pub machine: MachineOptions,
}

/// Options of `oxmill serve`.
#[derive(Debug, Args)]
pub struct Serve {
    /// The link over which clients connect.
    #[command(flatten)]
    pub link: Link,
    /// Speed relative to real time; `max` runs as fast as this computer can while the machine is busy.
    #[arg(long, default_value = "1", value_name = "N|max")]
    pub speed: Speed,
    /// Resets the controller at each new connection, as DTR does on an Arduino.
    #[arg(long)]
    pub reset_on_connect: bool,
    /// The file of the page that `--web` serves; the default is `oxmill.html` beside this program, or in `target/web`.
    // `requires = "web"` would not work. With another link, `--web` is a conflict, and clap does not require an option
    // that conflicts.
    #[arg(long, value_name = "FILE", conflicts_with_all = ["tcp", "stdio"])]
    #[cfg_attr(unix, arg(conflicts_with = "pty"))]
    pub page: Option<PathBuf>,
    /// Reads lines such as `limit x 1` or `door 0`, which set input pins.
    #[arg(long, value_name = "[ADDR:]PORT")]
    pub pins: Option<String>,
    /// Records all input into this file, for `replay`.
    #[arg(long, value_name = "FILE")]
    pub record: Option<PathBuf>,
    /// The simulated machine: board, settings, hardware and store.
    #[command(flatten)]
    pub machine: MachineOptions,
}

/// Arguments of `oxmill replay`.
#[derive(Debug, Args)]
pub struct Replay {
    /// The recording, made by `run --record` or `serve --record`.
    pub recording: PathBuf,
    /// Prints the summary as a JSON object, in the same form as `run --json`.
    #[arg(long)]
    pub json: bool,
    /// Writes a row for each step event into this file.
    #[arg(long, value_name = "FILE.csv")]
    pub trace: Option<PathBuf>,
}

/// Arguments of `oxmill resume`.
#[derive(Debug, Args)]
pub struct ResumeJob {
    /// The job: any text file.
    pub job: PathBuf,
    /// The place at which the job is resumed: a line of the file, or an N word.
    #[command(flatten)]
    pub begin: BeginOptions,
    /// Z of the move to the position, in mm in the program's coordinates. The default is the highest Z of the job so far, if all
    /// its heights are known.
    #[arg(long, value_name = "Z", allow_hyphen_values = true)]
    pub clearance: Option<Millimetres>,
    /// Feed of the move down from there, in mm/min, at least 1. The default is the feed of the job's last vertical plunge.
    #[arg(long, value_name = "FEED")]
    pub plunge: Option<Millimetres>,
    /// Time for the spindle to reach its speed.
    #[arg(long, value_name = "SECONDS", default_value_t = SPIN_UP, value_parser = clap::value_parser!(u16).range(0..=600))]
    pub spin_up: u16,
    /// The file for the program; the default is standard output.
    #[arg(short, long, value_name = "FILE")]
    pub output: Option<PathBuf>,
    /// The simulated machine: board, settings, hardware and store.
    #[command(flatten)]
    pub machine: MachineOptions,
}

/// The commands of `oxmill settings`.
#[derive(Debug, Subcommand)]
pub enum SettingsCommand {
    /// Reads settings of another controller, and reports what each of them becomes and why others are not taken.
    Import(ImportSettings),
}

/// Arguments of `oxmill settings import`.
#[derive(Debug, Args)]
pub struct ImportSettings {
    /// The output of $$ of Grbl 1.1 or grblHAL, or a configuration file (YAML) of FluidNC; `-` for standard input.
    pub file: PathBuf,
    /// Prints the result as a JSON object.
    #[arg(long)]
    pub json: bool,
    /// Writes the settings into this file, as lines $n=v for `--settings` or a board.
    #[arg(short, long, value_name = "FILE")]
    pub output: Option<PathBuf>,
}

/// Where a job is resumed: exactly one of these options.
#[derive(Debug, Args)]
#[group(required = true, multiple = false)]
pub struct BeginOptions {
    /// Starts at this line of the file; the first line is 1.
    #[arg(long, value_name = "LINE")]
    pub line: Option<u64>,
    /// Starts at the first line with this N word, which status reports, alarms and $RC show.
    #[arg(long, value_name = "N")]
    pub number: Option<u32>,
}

/// A length or feed rate with up to seven decimals, in units of 1e-7.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Millimetres(pub i64);

impl std::str::FromStr for Millimetres {
    type Err = String;
    fn from_str(text: &str) -> Result<Self, String> {
        let number = text.parse().ok().and_then(number_of);
        number.map(Millimetres).ok_or_else(|| "a number up to 50000 is needed".into())
    }
}

/// The link over which clients connect: exactly one of these options.
#[derive(Debug, Args)]
#[group(required = true, multiple = false)]
pub struct Link {
    /// Listens for clients, one at a time. A port without an address listens on this computer only.
    #[arg(long, value_name = "[ADDR:]PORT")]
    pub tcp: Option<String>,
    /// Creates a pseudo terminal and prints its path; LINK becomes a symbolic link to it.
    #[cfg(unix)]
    #[arg(long, value_name = "LINK", num_args = 0..=1)]
    pub pty: Option<Option<PathBuf>>,
    /// Uses standard input and output.
    #[arg(long)]
    pub stdio: bool,
    /// Serves a page for the machine on this port, on this computer only; 0 for any free port.
    #[arg(long, value_name = "PORT")]
    pub web: Option<u16>,
}

/// Options that describe the simulated machine; most commands have them.
#[derive(Debug, Args)]
pub struct MachineOptions {
    /// The board whose step clock, step rates, pins and axes are used. Look-ahead and words are those of the largest board.
    #[arg(long, default_value = boards::DESK.name, value_parser = board_named, value_name = "NAME")]
    pub board: Board,
    /// Step clock frequency, in place of the board's.
    #[arg(long, value_name = "HZ", value_parser = clap::value_parser!(u32).range(100_000..=1_000_000_000))]
    pub step_clock: Option<u32>,
    /// Dialect of lines and answers.
    #[arg(long)]
    pub dialect: Option<Dialect>,
    /// A file with lines $n=v, which are applied first; `serve` starts like a board that has these settings stored.
    #[arg(long, value_name = "FILE")]
    pub settings: Option<PathBuf>,
    /// A setting, applied after those of the file. Can be repeated.
    #[arg(long, value_name = "N=V")]
    pub set: Vec<String>,
    /// A file that describes the machine: switches, a probe plate.
    #[arg(long, value_name = "FILE")]
    pub machine: Option<PathBuf>,
    /// A file that keeps the settings between runs, like a board's flash memory.
    #[arg(long, value_name = "FILE")]
    pub store: Option<PathBuf>,
    /// Cuts the power after this number of flash words written or sectors erased, and exits.
    #[arg(long, value_name = "OPERATIONS")]
    pub cut_power: Option<u32>,
}

impl MachineOptions {
    /// Returns the board of `--board`, with the step clock of `--step-clock` if that is given.
    pub fn board(&self) -> Board {
        Board { step_clock_hz: self.step_clock.unwrap_or(self.board.step_clock_hz), ..self.board }
    }
}

/// Options for preparing the machine before a job.
#[derive(Clone, Copy, Debug, Default, Args)]
pub struct Start {
    /// Homes the machine before the job (needs $22=1), and sets the work zero of G54 to this position, in mm in machine
    /// coordinates, so that soft limits ($20=1) are active. Without switches in --machine, $23 and $130 to $132 place them.
    #[arg(long, value_name = "X,Y,Z", allow_hyphen_values = true)]
    pub work_zero: Option<WorkZero>,
}

/// A position in mm of machine coordinates.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct WorkZero(pub [f64; LINEAR]);

impl std::str::FromStr for WorkZero {
    type Err = String;
    fn from_str(text: &str) -> Result<Self, String> {
        let numbers: Result<Vec<f64>, _> = text.split(',').map(|number| number.trim().parse()).collect();
        let place = numbers.ok().and_then(|numbers| numbers.try_into().ok());
        place.map(WorkZero).ok_or_else(|| "three numbers with commas between are needed".into())
    }
}

/// Ratio of virtual time to real time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Speed {
    /// Virtual seconds per real second.
    Times(f64),
    /// Runs as fast as possible while the machine is busy.
    Max,
}

/// Maximum virtual seconds per second. It is more than any computer reaches, and low enough for the ticks of weeks to
/// fit into a `u64`.
const FASTEST: f64 = 10_000.0;

impl std::str::FromStr for Speed {
    type Err = String;
    fn from_str(text: &str) -> Result<Self, String> {
        match text.parse::<f64>() {
            _ if text == "max" => Ok(Speed::Max),
            Ok(times) if times > 0.0 && times <= FASTEST => Ok(Speed::Times(times)),
            _ => Err(format!("a number above 0 and up to {FASTEST}, or `max`, is needed")),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::CommandFactory;

    fn parse(words: &str) -> Result<Command, clap::Error> {
        CommandLine::try_parse_from(words.split(' ')).map(|line| line.command)
    }

    #[test]
    fn the_definition_is_sound() {
        CommandLine::command().debug_assert();
    }

    #[test]
    fn run_takes_the_promised_words() {
        let words = "oxmill run a.nc --json --plot a.svg --plot a.png --trace a.csv --board qemu_mps2 --dialect grbl \
                     --settings s.txt --set $100=80 --set 101=80 --store f";
        let Command::Run(run) = parse(words).unwrap() else { panic!() };
        assert!(run.json);
        assert_eq!(run.plot.len(), 2);
        assert_eq!(run.machine.board().step_clock_hz, 25_000_000);
        assert_eq!(run.machine.dialect, Some(Dialect::Grbl));
        assert_eq!(run.machine.set, ["$100=80", "101=80"]);
        let Command::Run(run) = parse("oxmill run - --step-clock 1000000").unwrap() else { panic!() };
        assert_eq!(run.job, PathBuf::from("-"));
        assert_eq!(run.machine.board(), Board { step_clock_hz: 1_000_000, ..boards::DESK });
    }

    #[test]
    fn serve_wants_exactly_one_link() {
        let Command::Serve(serve) = parse("oxmill serve --tcp 127.0.0.1:0 --speed max --pins 127.0.0.1:0").unwrap()
        else {
            panic!()
        };
        assert_eq!(serve.speed, Speed::Max);
        #[cfg(unix)]
        {
            let Command::Serve(serve) = parse("oxmill serve --pty --speed 2.5").unwrap() else { panic!() };
            assert_eq!((serve.link.pty, serve.speed), (Some(None), Speed::Times(2.5)));
            let Command::Serve(serve) = parse("oxmill serve --pty /tmp/mill").unwrap() else { panic!() };
            assert_eq!(serve.link.pty, Some(Some(PathBuf::from("/tmp/mill"))));
        }
        let Command::Serve(serve) = parse("oxmill serve --web 0 --page p.html").unwrap() else { panic!() };
        assert_eq!((serve.link.web, serve.page), (Some(0), Some(PathBuf::from("p.html"))));
        for link in ["--stdio", "--tcp 127.0.0.1:0"] {
            assert!(parse(&format!("oxmill serve {link} --page p.html")).is_err());
        }
        #[cfg(unix)]
        assert!(parse("oxmill serve --page p.html --pty").is_err());
        assert!(parse("oxmill serve --web 1 --tcp 127.0.0.1:0").is_err());
        assert!(parse("oxmill serve").is_err());
        assert!(parse("oxmill serve --stdio --tcp 127.0.0.1:0").is_err());
        for speed in ["0", "-1", "1e20", "inf", "nan"] {
            assert!(parse(&format!("oxmill serve --stdio --speed={speed}")).is_err(), "{speed}");
        }
        assert!(parse("oxmill serve --stdio --board toaster").is_err());
    }

    #[test]
    fn recordings_are_written_and_played() {
        let Command::Run(run) = parse("oxmill run a.nc --record a.rec").unwrap() else { panic!() };
        assert_eq!(run.record, Some(PathBuf::from("a.rec")));
        let Command::Serve(serve) = parse("oxmill serve --stdio --record a.rec").unwrap() else { panic!() };
        assert_eq!(serve.record, Some(PathBuf::from("a.rec")));
        let Command::Replay(replay) = parse("oxmill replay a.rec --json --trace a.csv").unwrap() else { panic!() };
        assert_eq!((replay.recording, replay.json), (PathBuf::from("a.rec"), true));
        assert_eq!(replay.trace, Some(PathBuf::from("a.csv")));
    }

    #[test]
    fn check_takes_the_words_of_run() {
        let Command::Check(check) = parse("oxmill check a.nc --json --board qemu_mps2 --set 110=1").unwrap() else {
            panic!()
        };
        assert!(check.json && check.machine.set == ["110=1"] && check.job == *"a.nc");
    }

    #[test]
    fn a_work_zero_has_three_numbers() {
        let Command::Check(check) = parse("oxmill check a.nc --work-zero -150,-100.5,-30").unwrap() else { panic!() };
        assert_eq!(check.start.work_zero, Some(WorkZero([-150.0, -100.5, -30.0])));
        for wrong in ["1,2", "1,2,3,4", "1,2,x", "1;2;3"] {
            assert!(parse(&format!("oxmill run a.nc --work-zero {wrong}")).is_err(), "{wrong}");
        }
        assert!(parse("oxmill run a.nc --work-zero 0,0,0 --record a.rec").is_err());
        assert!(parse("oxmill plot a.nc -o a.svg --work-zero 0,0,0").is_ok());
    }

    #[test]
    fn plot_wants_a_file() {
        let Command::Plot(plot) = parse("oxmill plot a.nc -o a.svg --output a.png --set 110=1").unwrap() else {
            panic!()
        };
        assert_eq!(plot.output, ["a.svg", "a.png"].map(PathBuf::from));
        assert!(parse("oxmill plot a.nc").is_err());
    }

    #[test]
    fn usage_mistakes_exit_with_2() {
        assert_eq!(parse("oxmill run").unwrap_err().exit_code(), 2);
        assert_eq!(parse("oxmill run a.nc --speeed").unwrap_err().exit_code(), 2);
    }
}
