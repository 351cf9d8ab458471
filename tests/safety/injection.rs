//! Three jobs, each interrupted in every segment (a piece of planned motion) of the step task. After an interruption,
//! the reported position must be the one that the pulses make, and the state must be the expected one. A job that may
//! continue must end at the same position by the same path.

use super::bench::{AXES, Bench, HZ, STEPS, assert_place};
use oxmill_controller::messages::SpindleDirection;

type Place = [i32; AXES];

struct Job {
    settings: &'static str,
    lines: &'static str,
}

/// Corners of all kinds, a reversal, a move of a step and one of half a step, spindle, coolant, and a dwell between two
/// moves.
const LINES: Job = Job {
    settings: "$110=6000 $111=5000 $112=3000 $120=1500 $121=1200 $122=900",
    lines: "G21 G90 M3 S600 M8\nG1 X1.5 Y0.4 F3000\nX2 Y1.5 Z-0.3\nX2.004\nX2.006 Y1.502\nX1 Y1.5 Z-0.5\nG4 P0.04\nG0 X0.5 Y0.5 \
            Z0\nX1.5\nG1 X0.5 F2400\nM5\n",
};

/// Arcs in both directions, a helix, a full circle; a laser whose power follows the speed.
const ARCS: Job = Job {
    settings: "$32=1 $110=6000 $111=5000 $112=3000 $120=1500 $121=1200 $122=900",
    lines: "G21 G90 M4 S700\nG1 X0.5 F2400\nG2 X1.5 Y1 I1 J0 S500\nG3 X1.5 Y1 I-0.4 J0 Z0.4\nG18 G2 X1 Z0.2 R0.4\nG0 X0 Y0\nG1 Y0.5 \
            M3 S300\nM5\n",
};

const JOGS: Job = Job {
    settings: "$110=6000 $111=5000 $112=3000 $120=1500 $121=1200 $122=900",
    lines: "$J=G91 X1 Y0.5 F3000\n$J=G91 X0.5 Z-0.4 F3000\n$J=G90 X0 Y1 F4000\n$J=G91 Y-0.5 F1200\n",
};

struct Run {
    bench: Bench,
    /// Virtual time when the job was sent, ticks.
    begin: u64,
}

impl Run {
    /// Returns a machine that has just been sent the job; hard limits are on.
    fn begin(job: &Job) -> Run {
        let mut bench = Bench::new("", job.settings);
        bench.ask("$21=1");
        bench.mill.trace_mut().restart();
        let begin = bench.mill.clock().now();
        bench.send(job.lines);
        Run { bench, begin }
    }

    fn at(job: &Job, moment: u64) -> Run {
        let mut run = Run::begin(job);
        run.bench.mill.advance_to(run.begin + moment);
        run
    }

    fn path(&self) -> Vec<Place> {
        self.bench.mill.trace().kept().iter().map(|r| r.position).collect()
    }
}

/// The undisturbed run of a job.
struct Reference {
    path: Vec<Place>,
    digest: u64,
    /// Times of interruption in ticks from the start: one within each segment, and one every 4 ms.
    moments: Vec<u64>,
}

fn reference(job: &Job) -> Reference {
    let mut run = Run::begin(job);
    run.bench.settle();
    let end = run.bench.mill.clock().now() - run.begin;
    let begins = run.bench.mill.trace().segments();
    let mut moments: Vec<u64> = (0..end / (HZ / 250)).map(|n| n * (HZ / 250)).collect();
    for (index, begin) in begins.iter().enumerate() {
        let next = begins.get(index + 1).copied().unwrap_or(begin + HZ / 10_000);
        // A time within the first millisecond of the segment, at a different fraction for each segment.
        let length = (next - begin).min(HZ / 1000);
        moments.push(begin - run.begin + length * (index as u64 * 37 % 100) / 100);
    }
    assert!(begins.len() > 300, "{} segments", begins.len());
    let said = run.bench.read();
    assert!(said.iter().all(|line| line == "ok"), "{said:?}");
    assert_eq!(said.len(), job.lines.lines().count());
    Reference { path: run.path(), digest: run.bench.mill.trace().digest().time_hash(), moments }
}

/// Asserts that a path is that of the reference: each axis makes the same steps in the same order, and the machine is
/// never more than one step off the path. The order of steps of different axes can differ, because smoothing can place
/// the step of a slow axis between two steps of the fast one.
fn assert_same_path(found: &[Place], reference: &[Place], what: &str) {
    for axis in 0..AXES {
        let steps = |path: &[Place]| -> Vec<i32> {
            let mut places: Vec<i32> = path.iter().map(|place| place[axis]).collect();
            places.dedup();
            places
        };
        assert!(steps(found) == steps(reference), "{what}: axis {axis} takes other steps");
    }
    let mut way = reference.iter();
    let mut here: Place = [0; AXES];
    for place in found {
        while here.iter().zip(place).any(|(a, b)| a.abs_diff(*b) > 1) {
            here = *way.next().unwrap_or_else(|| panic!("{what}: {place:?} is not on the way"));
        }
    }
}

/// Asserts that the machine is at rest, stays so, and reports the position that the pulses make.
#[track_caller]
fn assert_true_and_at_rest(bench: &mut Bench, what: &str) {
    let counted = bench.mill.trace().kept().last().map_or([0; AXES], |record| record.position);
    let place = bench.place();
    assert_eq!(counted, place, "{what}");
    let reported = bench.reported();
    assert_place(reported, place, what);
    let reported = bench.mill.work_position().map(|mm| mm * STEPS);
    assert_place(reported, place, what);
    bench.wait(0.1);
    assert_eq!(bench.place(), place, "{what}: it moves");
}

/// Asserts that the machine can be used: a move and a jog reach their targets.
#[track_caller]
fn assert_usable(bench: &mut Bench, what: &str) {
    bench.read();
    bench.carry_out("G21 G90 G0 X0.1 Y-0.1 Z0.1");
    assert_eq!(bench.place(), [25, -25, 25], "{what}");
    bench.carry_out("$J=G91 X0.1 F1000");
    assert_eq!(bench.place(), [50, -25, 25], "{what}");
    let reported = bench.reported();
    assert_place(reported, [50, -25, 25], what);
    assert_eq!(bench.state(), "Idle", "{what}");
}

fn assert_dark(bench: &Bench, what: &str) {
    assert_eq!(bench.mill.power(), 0, "{what}");
    assert_eq!(bench.mill.outputs().map(|o| o.spindle), Some(SpindleDirection::Off), "{what}");
}

fn answers(said: &[String]) -> usize {
    said.iter().filter(|line| *line == "ok" || line.starts_with("error")).count()
}

/// Asserts that the machine has braked to rest: in its last 3 ms it moves no farther than its acceleration allows.
fn assert_braked(run: &Run, what: &str) {
    const SPAN: f64 = 0.003;
    // The acceleration of all axes together, mm/s². Two more steps of each axis are allowed for rounding.
    let greatest = f64::hypot(f64::hypot(1500.0, 1200.0), 900.0);
    let allowed = greatest * SPAN * SPAN / 2.0 + 2.0 * 3.0_f64.sqrt() / STEPS;
    let kept = run.bench.mill.trace().kept();
    let Some(last) = kept.last() else { return };
    let before = kept.iter().find(|r| r.at + (SPAN * HZ as f64) as u64 >= last.at).unwrap_or(last).position;
    let square: f64 = before.iter().zip(last.position).map(|(a, b)| (f64::from(a.abs_diff(b)) / STEPS).powi(2)).sum();
    assert!(square.sqrt() <= allowed, "{what}: {} mm in the last {SPAN} s", square.sqrt());
}

/// At every time of the reference, interrupts a new run of the job by `act` (bytes or a pin) and then calls `check`.
/// The third argument of `check` is `true` if the machine was moving when `act` was called.
fn at_every_moment(job: &Job, what: &str, act: fn(&mut Bench), check: impl Fn(&mut Run, &Reference, bool, &str)) {
    let reference = reference(job);
    for moment in &reference.moments {
        let mut run = Run::at(job, *moment);
        let what = format!("{what} after {:.3} ms", *moment as f64 * 1000.0 / HZ as f64);
        // The machine moves only if it has started a segment. Work that is merely queued does not count as motion.
        let stepping = run.bench.mill.is_stepping() && !run.bench.mill.trace().segments().is_empty();
        act(&mut run.bench);
        check(&mut run, &reference, stepping, &what);
    }
}

/// Asserts that a job continues to its end after a hold or a door.
fn assert_goes_on(run: &mut Run, job: &Job, reference: &Reference, what: &str) {
    run.bench.send("~");
    run.bench.settle();
    assert_same_path(&run.path(), &reference.path, what);
    assert_eq!(run.bench.place(), *reference.path.last().unwrap(), "{what}");
    assert_true_and_at_rest(&mut run.bench, what);
    assert_eq!(run.bench.state(), "Idle", "{what}");
    assert!(run.bench.mill.controller().is_trusted(), "{what}");
    let said = run.bench.read();
    assert_eq!(answers(&said), job.lines.lines().count(), "{what}: {said:?}");
    assert!(!said.iter().any(|l| l.starts_with("ALARM") || l.starts_with("error")), "{what}: {said:?}");
}

fn hold(job: &Job) {
    let act: fn(&mut Bench) = |bench| bench.send("!");
    at_every_moment(job, "hold", act, |run, reference, _, what| {
        run.bench.wait(0.5);
        assert_braked(run, what);
        assert_eq!(run.bench.state(), "Hold:0", "{what}");
        assert_true_and_at_rest(&mut run.bench, what);
        if std::ptr::eq(job, &ARCS) {
            assert_dark(&run.bench, what);
        }
        assert_goes_on(run, job, reference, what);
    });
}

#[test]
fn lines_are_held() {
    hold(&LINES);
}

#[test]
fn arcs_are_held() {
    hold(&ARCS);
}

fn door(job: &Job, pin: bool) {
    let act: fn(&mut Bench) = if pin { |bench| bench.pin("door 1") } else { |bench| bench.send([0x84]) };
    at_every_moment(job, "door", act, |run, reference, _, what| {
        run.bench.wait(0.5);
        assert_braked(run, what);
        assert_eq!(run.bench.state(), if pin { "Door:1" } else { "Door:0" }, "{what}");
        assert_true_and_at_rest(&mut run.bench, what);
        assert_dark(&run.bench, what);
        assert!(!run.bench.mill.outputs().unwrap().coolant.flood, "{what}");
        if pin {
            // The machine does not resume while the door is open.
            run.bench.send("~");
            run.bench.wait(0.5);
            assert_eq!(run.bench.state(), "Door:1", "{what}");
            run.bench.pin("door 0");
            assert_eq!(run.bench.state(), "Door:0", "{what}");
        }
        assert_goes_on(run, job, reference, what);
    });
}

#[test]
fn a_door_opens_in_lines() {
    door(&LINES, false);
}

#[test]
fn a_door_opens_in_arcs() {
    door(&ARCS, true);
}

fn reset(job: &Job, pin: bool) {
    let act: fn(&mut Bench) = if pin {
        |bench| {
            bench.pin("reset 1");
            bench.pin("reset 0");
        }
    } else {
        |bench| bench.send([0x18])
    };
    at_every_moment(job, "reset", act, |run, _, stepping, what| {
        let place = run.bench.place();
        run.bench.wait(0.1);
        assert_eq!(run.bench.place(), place, "{what}: steps after a reset");
        let said = run.bench.read();
        assert_dark(&run.bench, what);
        assert_eq!(said.contains(&"ALARM:3".to_string()), stepping, "{what}: {said:?}");
        assert_eq!(run.bench.state(), if stepping { "Alarm" } else { "Idle" }, "{what}");
        assert_eq!(run.bench.mill.controller().is_trusted(), !stepping, "{what}");
        assert_true_and_at_rest(&mut run.bench, what);
        if stepping {
            assert_eq!(run.bench.ask("G0 X0"), ["error:9"], "{what}");
            assert_eq!(run.bench.ask("$X").last().unwrap(), "ok", "{what}");
        }
        assert_usable(&mut run.bench, what);
    });
}

#[test]
fn lines_are_reset() {
    reset(&LINES, false);
}

#[test]
fn arcs_are_reset_by_the_button() {
    reset(&ARCS, true);
}

#[test]
fn jogs_are_reset() {
    reset(&JOGS, false);
}

fn stop(job: &Job) {
    let act: fn(&mut Bench) = |bench| bench.send([0x19]);
    at_every_moment(job, "0x19", act, |run, reference, _, what| {
        run.bench.wait(0.3);
        assert_braked(run, what);
        assert_eq!(run.bench.state(), "Idle", "{what}");
        let said = run.bench.read();
        assert!(said.iter().all(|line| line == "ok"), "{what}: {said:?}");
        assert_true_and_at_rest(&mut run.bench, what);
        assert!(run.bench.mill.controller().is_trusted(), "{what}");
        // Up to the stop, the machine has followed the path of the reference.
        let path = run.path();
        if let Some(end) = path.last() {
            let same = reference.path.iter().any(|p| p.iter().zip(end).all(|(a, b)| a.abs_diff(*b) <= 1));
            assert!(same, "{what}: {end:?} is not on the way");
        }
        run.bench.ask("M5");
        assert_usable(&mut run.bench, what);
    });
}

#[test]
fn lines_are_stopped() {
    stop(&LINES);
}

#[test]
fn arcs_are_stopped() {
    stop(&ARCS);
}

#[test]
fn jogs_are_stopped() {
    stop(&JOGS);
}

fn limit(job: &Job) {
    let act: fn(&mut Bench) = |bench| bench.pin("limit y 1");
    at_every_moment(job, "limit", act, |run, _, stepping, what| {
        let place = run.bench.place();
        run.bench.wait(0.2);
        assert_eq!(run.bench.place(), place, "{what}: steps after a limit switch");
        let said = run.bench.read();
        let [.., alarm, which, reset] = said.as_slice() else { panic!("{what}: {said:?}") };
        assert_eq!((alarm.as_str(), reset.as_str()), ("ALARM:1", "[MSG:Reset to continue]"), "{what}");
        assert!(which.starts_with("[MSG:Limit switch Y at machine "), "{what}: {which}");
        assert_eq!(run.bench.state(), "Alarm", "{what}");
        assert_dark(&run.bench, what);
        assert_eq!(run.bench.mill.controller().is_trusted(), !stepping, "{what}");
        assert_true_and_at_rest(&mut run.bench, what);
        assert!(!run.bench.mill.is_active(), "{what}: something goes on");
        // Neither `$X` nor `~` has an effect, only a reset.
        run.bench.send("$X\n~");
        run.bench.wait(0.2);
        assert_eq!(run.bench.state(), "Alarm", "{what}");
        run.bench.send([0x18]);
        run.bench.wait(0.1);
        let said = run.bench.read();
        assert!(said.contains(&"[MSG:Check Limits]".to_string()), "{what}: {said:?}");
        run.bench.pin("limit y 0");
        assert_eq!(run.bench.ask("$X").last().unwrap(), "ok", "{what}");
        assert_usable(&mut run.bench, what);
    });
}

#[test]
fn a_limit_trips_in_lines() {
    limit(&LINES);
}

#[test]
fn a_limit_trips_in_arcs() {
    limit(&ARCS);
}

#[test]
fn a_limit_trips_in_jogs() {
    limit(&JOGS);
}

/// 0x85 cancels only jogs: a job runs as if the byte had not been sent.
#[test]
fn a_jog_cancel_leaves_a_job_alone() {
    let act: fn(&mut Bench) = |bench| bench.send([0x85]);
    for job in [&LINES, &ARCS] {
        at_every_moment(job, "0x85", act, |run, reference, _, what| {
            run.bench.settle();
            assert!(run.path() == reference.path, "{what}: other steps");
            assert_eq!(run.bench.mill.trace().digest().time_hash(), reference.digest, "{what}: other times");
        });
    }
}

fn cancel(what: &str, act: fn(&mut Bench)) {
    at_every_moment(&JOGS, what, act, |run, reference, _, what| {
        run.bench.wait(0.3);
        assert_braked(run, what);
        assert_eq!(run.bench.state(), "Idle", "{what}");
        assert_true_and_at_rest(&mut run.bench, what);
        assert!(run.bench.mill.controller().is_trusted(), "{what}");
        let said = run.bench.read();
        assert_eq!(answers(&said), JOGS.lines.lines().count(), "{what}: every line is answered: {said:?}");
        let path = run.path();
        assert!(path.len() <= reference.path.len(), "{what}");
        assert_usable(&mut run.bench, what);
    });
}

#[test]
fn jogs_are_cancelled() {
    cancel("0x85", |bench| bench.send([0x85]));
}

#[test]
fn a_door_ends_jogs() {
    let act: fn(&mut Bench) = |bench| bench.pin("door 1");
    at_every_moment(&JOGS, "door", act, |run, _, _, what| {
        run.bench.wait(0.3);
        assert_eq!(run.bench.state(), "Door:1", "{what}");
        assert_true_and_at_rest(&mut run.bench, what);
        let place = run.bench.place();
        run.bench.pin("door 0");
        run.bench.send("~");
        run.bench.wait(0.3);
        assert_eq!(run.bench.state(), "Idle", "{what}");
        assert_eq!(run.bench.place(), place, "{what}: the jog goes on");
        assert_usable(&mut run.bench, what);
    });
}
