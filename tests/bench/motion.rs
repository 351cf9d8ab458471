//! Durations of jobs, compared with those of other controllers for equivalent jobs: the table of `docs/motion.md`.
//!
//! `cargo xtask bench` prints the table. With file names as arguments, it prints the durations of these programs
//! instead. Time is counted in step-clock ticks, and the controller never waits for the bytes of a job. So the figures
//! are the same on every computer. Each job also runs with a look-ahead that holds the whole job.

#[path = "../../xtask/src/programs/mod.rs"]
#[allow(dead_code, unused_imports, reason = "only the benchmark's jobs are wanted here, and without their tests")]
mod programs;

use oxmill_controller::messages::{Event, LINES_DEPTH, LineByte, Observed, Output, Room, SEGMENTS_DEPTH, Sensed};
use oxmill_controller::units::Instant;
use oxmill_controller::{Controller, Profile, StepRates, Stepper};
use std::collections::VecDeque;
use std::process::ExitCode;

const AXES: usize = 3;
/// Look-ahead of the boards, in blocks (moves).
const BOARD: usize = oxmill_simulator::boards::BLOCKS;
/// Look-ahead that holds any whole job, in blocks.
const UNLIMITED: usize = 1 << 17;
const STEP_CLOCK_HZ: u32 = 96_000_000;
/// The machine: 80 steps/mm, 10,000 mm/min, 500 mm/s², junction deviation 0.010.
const MACHINE: &str = "$0=3\n$11=0.010\n$30=1000\n$100=80\n$101=80\n$102=80\n$110=10000\n$111=10000\n$112=10000\n\
    $120=500\n$121=500\n$122=500\n";

/// Motion of a program on the simulated machine. `net`: steps forward minus steps back; `lines_refused`: number of
/// `error:` answers.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Outcome {
    /// Time from the first to the last step, s.
    seconds: f64,
    net: [i32; AXES],
    lines_refused: u32,
}

/// Runs a program on a new controller with a look-ahead of `BLOCKS` moves.
fn simulate<const BLOCKS: usize>(settings: &str, program: &str) -> Outcome {
    let profile = Profile {
        name: "bench",
        step_clock_hz: STEP_CLOCK_HZ,
        rates: StepRates { safe_hz: 200_000, least_pulse_tenths: 10 },
        oscillator_mhz: 0,
        has_store: false,
        has_loader: false,
        axes: 3,
        has_second_motor: false,
        has_at_speed: true,
        program_pins: [0; 2],
        most_baud: 1_000_000,
    };
    let mut controller = Box::new(Controller::<AXES>::new(
        profile,
        oxmill_controller::memory::Memory::on_heap(&profile, BLOCKS, oxmill_controller::gcode::LEAST_HELD),
    ));
    controller.start(Instant::from_ticks(0));
    controller.event(Instant::from_ticks(0), Event::Signals(Sensed::default()));
    let mut stepper = Stepper::<AXES>::new();
    let mut queue = VecDeque::new();
    let mut bytes = settings.bytes().chain(program.bytes()).peekable();
    let (mut time, mut moving, mut directions) = (0_u64, false, 0_u8);
    let (mut first, mut last, mut net, mut answers) = (None, 0, [0; AXES], Vec::new());
    loop {
        let now = Instant::from_ticks(time * 1_000_000 / u64::from(STEP_CLOCK_HZ));
        controller.observe(Observed {
            segments_begun: stepper.segments_begun(),
            step_idle: !moving && stepper.is_idle() && queue.is_empty(),
            rx_free: if bytes.peek().is_some() { 0 } else { LINES_DEPTH as u16 },
            received: u16::from(bytes.peek().is_some()),
            activity: 0,
        });
        while controller.wants_line()
            && let Some(byte) = bytes.next()
        {
            controller.event(now, Event::Line(LineByte { byte, epoch: 0, damaged: false }));
        }
        match controller.output(now, Room { step: queue.len() < SEGMENTS_DEPTH, reply: true }) {
            Some(Output::Step(message)) => queue.push_back(message),
            Some(Output::Reply(chunk) | Output::Answer(chunk)) => answers.extend_from_slice(chunk.as_bytes()),
            Some(_) => {}
            None => {
                while stepper.has_room()
                    && let Some(message) = queue.pop_front()
                {
                    stepper.load(message);
                }
                if stepper.is_idle() {
                    moving = false;
                    if bytes.peek().is_none() && controller.is_idle() {
                        break;
                    }
                    // During a dwell or a wait, time jumps to its end.
                    if let Some(at) = controller.next_wakeup() {
                        time = time.max(at.ticks() * u64::from(STEP_CLOCK_HZ) / 1_000_000);
                    }
                    continue;
                }
                let tick = stepper.tick();
                assert!(!tick.underrun, "the queue ran dry");
                if tick.steps != 0 {
                    first.get_or_insert(time);
                    last = time;
                    for (axis, count) in net.iter_mut().enumerate() {
                        if tick.steps >> axis & 1 != 0 {
                            *count += if directions >> axis & 1 != 0 { -1 } else { 1 };
                        }
                    }
                }
                directions = tick.directions;
                time += u64::from(tick.interval);
                moving = tick.interval != 0;
            }
        }
    }
    let refused = answers.windows(6).filter(|text| text == b"error:").count();
    let seconds = (last - first.unwrap_or(last)) as f64 / f64::from(STEP_CLOCK_HZ);
    Outcome { seconds, net, lines_refused: refused as u32 }
}

/// A job for the printed tables, with its settings and the results of other controllers.
struct Row {
    job: &'static str,
    what: &'static str,
    settings: &'static str,
    /// Results of the equivalent job with Grbl 1.1h and with grblHAL. A result is either a duration in seconds, or the
    /// text `N steps` with a number of steps. It is empty if there is no result.
    peers: [&'static str; 2],
}

impl Row {
    /// Returns the settings and the program of this job, as lines for the controller.
    fn job(&self) -> (String, String) {
        let mut text = Vec::new();
        let written = programs::bench::generate(self.job, &mut text);
        assert!(matches!(written, Ok(true)), "{}: {written:?}", self.job);
        ([MACHINE, self.settings].concat(), String::from_utf8(text).expect("programs are ASCII"))
    }
}

const ROWS: &[Row] = &[
    Row {
        job: "circle_chords",
        what: "10 turns of a 20 mm circle, 100 G1 chords a turn, F3000",
        settings: "",
        peers: ["12.936", "12.924"],
    },
    Row { job: "circle_arcs", what: "the same as G3", settings: "", peers: ["12.939", "12.928"] },
    Row {
        job: "relief_rows",
        what: "relief, 16,441 segments of 0.1 mm, 41 rows of 40 mm, F2000",
        settings: "",
        peers: ["58.58", "58.54"],
    },
    Row { job: "zigzag", what: "zigzag, 60 rows of 50 mm, F3000", settings: "", peers: ["68.05", "67.99"] },
    Row {
        job: "raster",
        what: "laser raster, another S every 0.5 mm, `$32=1`",
        settings: "$32=1\n",
        peers: ["111.20", "111.12"],
    },
    Row { job: "raster", what: "the same with `$32=0`", settings: "$32=0\n", peers: ["889.6", "639.9"] },
    Row {
        job: "look_ahead",
        what: "sine of amplitude 10 and wavelength 200 mm, 6 passes of 190 mm in chords of 0.1 mm, F6000, 200 mm/s²",
        settings: "$120=200\n$121=200\n$122=200\n",
        peers: ["49.0", "39.1"],
    },
    Row {
        job: "tight_circle",
        what: "5 turns of a 10 mm circle in chords of 0.1 mm, F12000",
        settings: "$110=20000\n$111=20000\n",
        peers: ["", ""],
    },
    Row {
        job: "drift",
        what: "200,000 × `G91 G1 X0.001` = 16,000 steps",
        settings: "",
        peers: ["16,036 steps", "16,036 steps"],
    },
    Row {
        job: "drift_inch",
        what: "100,000 × `G20 G91 G1 X0.0001` = 20,320 steps",
        settings: "",
        peers: ["20,294 steps", "20,294 steps"],
    },
];

fn table() {
    println!("| job | Grbl 1.1h | grblHAL | Oxmill | unlimited look-ahead |");
    println!("|---|---|---|---|---|");
    for row in ROWS {
        let (settings, program) = row.job();
        let ours = simulate::<BOARD>(&settings, &program);
        let unlimited = simulate::<UNLIMITED>(&settings, &program);
        assert_eq!((ours.lines_refused, unlimited.lines_refused), (0, 0), "{}", row.job);
        assert_eq!(ours.net, unlimited.net);
        let [grbl, hal] = row.peers.map(|peer| match peer {
            "" => "–".to_owned(),
            peer if peer.ends_with("steps") => peer.to_owned(),
            peer => format!("{peer} s"),
        });
        let [steps, ..] = ours.net;
        let mine = if row.job.starts_with("drift") {
            format!("{},{:03} steps, {:.2} s", steps / 1000, steps % 1000, ours.seconds)
        } else {
            format!("{:.3} s", ours.seconds)
        };
        println!("| {} | {grbl} | {hal} | {mine} | {:.3} s |", row.what, unlimited.seconds);
    }
}

/// Jerk of all axes in the second table, mm/s³: the acceleration of 500 mm/s² is reached after 50 ms.
const JERK: &str = "10000";

/// Prints how much longer jobs take with limited jerk.
fn table_of_jerk() {
    println!("\n| job | trapezoid | jerk of {JERK} mm/s³ | |\n|---|---|---|---|");
    for row in ROWS {
        let (settings, program) = row.job();
        let even = simulate::<BOARD>(&settings, &program);
        let smooth = simulate::<BOARD>(&format!("{settings}$220={JERK}\n$221={JERK}\n$222={JERK}\n"), &program);
        assert_eq!((smooth.lines_refused, smooth.net), (0, even.net), "{}", row.job);
        let more = (smooth.seconds / even.seconds - 1.0) * 100.0;
        println!("| {} | {:.3} s | {:.3} s | {more:+.1} % |", row.what, even.seconds, smooth.seconds);
    }
}

fn own(file: &str) -> Result<(), String> {
    let bytes = std::fs::read(file).map_err(|error| format!("{file}: {error}"))?;
    let text = String::from_utf8_lossy(&bytes);
    // Lines that start with `%` are tape marks.
    let program: String = text.lines().filter(|line| !line.starts_with('%')).flat_map(|line| [line, "\n"]).collect();
    let outcome = simulate::<BOARD>(MACHINE, &program);
    println!("{file}: {:.3} s, steps {:?}, {} lines refused", outcome.seconds, outcome.net, outcome.lines_refused);
    Ok(())
}

fn main() -> ExitCode {
    // `cargo bench` passes `--bench`.
    let files: Vec<String> = std::env::args().skip(1).filter(|argument| !argument.starts_with("--")).collect();
    let work = move || -> Result<(), String> {
        if files.is_empty() {
            table();
            table_of_jerk();
        }
        files.iter().try_for_each(|file| own(file))
    };
    // A controller with an unlimited look-ahead is built on the stack before it moves to the heap. So the thread needs
    // a large stack.
    let thread = std::thread::Builder::new().stack_size(256 << 20).spawn(work);
    match thread.map(std::thread::JoinHandle::join) {
        Ok(Ok(Ok(()))) => ExitCode::SUCCESS,
        Ok(Ok(Err(why))) => {
            eprintln!("{why}");
            ExitCode::FAILURE
        }
        _ => ExitCode::FAILURE,
    }
}
