//! A replayed recording makes the same steps in the same order at the same times.

use oxmill_simulator::recording::{Input, Recorder, Recording};
use oxmill_simulator::{Options, Simulator};
use proptest::prelude::*;
use std::io::{self, Write};
use std::sync::{Arc, Mutex};
use std::time::Duration;

/// A file in memory. Its clones share the contents, so a test can read what the recorder writes.
#[derive(Clone, Default)]
struct File(Arc<Mutex<Vec<u8>>>);

impl Write for File {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.0.lock().unwrap().write(bytes)
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

impl File {
    fn text(&self) -> String {
        String::from_utf8(self.0.lock().unwrap().clone()).unwrap()
    }
}

const MACHINE: &str =
    "steps_per_mm = [250, 250, 250]\n[[switch]]\naxis = \"x\"\nat_mm = 1.5\nside = \"positive\"\nbounce_us = 900\n";

/// Settings that make the machine act when the host falls silent during a job or a jog, so that pauses have effects.
const WATCHES: [&str; 6] = ["$922=0.1\n", "$922=0.5\n", "$923=0.1\n", "$928=1\n", "$915=1\n", "$929=0.1\n"];

/// Returns random inputs of a host and of the user, each with a pause from 0 to 300,000. The test chooses the unit of
/// the pause. `more`: further lines that the host sends.
fn inputs_with(more: &[&'static str]) -> impl Strategy<Value = (u32, Input)> + use<> {
    let mut lines = vec![
        "G1 X2 F600\n",
        "G1 X0 Y1\n",
        "G91 G1 X0.01\n",
        "G90 G0 Z-0.5\n",
        "G2 X1 Y1 I0.5\n",
        "$J=G91 X1 F300\n",
        "G4 P0.1\n",
        "?",
        "!",
        "~",
        "\x18",
        "\x19",
        "$X\n",
        "M3 S1000\n",
        "G1 X",
        "$120=50\n",
        "G38.3 Z-1 F60\n",
        "\u{7f}\n",
    ];
    lines.extend(more);
    let host = prop::sample::select(lines).prop_map(|line| Input::Host(line.as_bytes().to_vec()));
    let override_ =
        prop::sample::select(vec![0x91_u8, 0x92, 0x95, 0x96, 0x85]).prop_map(|byte| Input::Host(vec![byte]));
    let pins =
        ["door 1", "door 0", "hold 1", "hold 0", "limit y 1", "limit y 0", "probe 1", "probe 0", "noise limit x"];
    let pin = prop::sample::select(pins.to_vec()).prop_map(|line| Input::Pin(line.into()));
    let input =
        prop_oneof![12 => host, 3 => override_, 2 => pin, 1 => Just(Input::Connect), 1 => Just(Input::Disconnect)];
    (0..300_000_u32, input)
}

fn apply(mill: &mut Simulator, input: &Input) {
    match input {
        Input::Connect => mill.connect(),
        Input::Disconnect => mill.disconnect(),
        Input::Host(bytes) => mill.send(bytes),
        Input::Pin(line) => assert_eq!(mill.pin_line(line), "ok"),
        Input::At(_) | Input::Job | Input::Report(_) => {}
    }
}

fn digest(mill: &Simulator) -> (u64, u64, [i32; 3]) {
    let digest = mill.trace().digest();
    (digest.time_hash(), digest.order_hash(), mill.machine().position())
}

/// Returns a machine with a switch and non-default settings, its recorder since power-up, the recorded file, and the
/// output.
fn machine() -> (Simulator, Recorder, File, String) {
    let fittings = oxmill_simulator::Fittings::parse(MACHINE).unwrap();
    let mut mill = Simulator::new(Options { fittings, ..Options::default() });
    let file = File::default();
    let mut recorder = Recorder::begin(&mut mill, MACHINE);
    recorder.write_to(Box::new(file.clone())).unwrap();
    mill.run_until_idle();
    mill.take_output();
    let settings = b"$110=900\n$21=1\nG10 L2 P1 X1.5\n".to_vec();
    recorder.input(&mill, &Input::Host(settings.clone())).unwrap();
    mill.send(settings);
    mill.run_until_idle();
    let said = mill.take_output();
    (mill, recorder, file, said)
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 60, ..ProptestConfig::default() })]
    #[test]
    fn the_same_comes_out_again(script in prop::collection::vec(inputs_with(&WATCHES), 1..60), slices in prop::collection::vec(1..5000_u64, 20)) {
        let (mut mill, mut recorder, file, mut said) = machine();
        let mut slices = slices.into_iter().cycle();
        for (pause, input) in &script {
            // Divide time irregularly, as the clock of a host does.
            let until = mill.clock().now() + u64::from(*pause);
            while mill.clock().now() < until {
                mill.advance_to(until.min(mill.clock().now() + slices.next().unwrap()));
            }
            recorder.input(&mill, input).unwrap();
            apply(&mut mill, input);
            said.push_str(&mill.take_output());
        }
        mill.run_for(Duration::from_secs(5));
        recorder.look(&mill).unwrap();
        let recording = Recording::parse(&file.text()).unwrap();
        let mut again = recording.power_up().unwrap();
        let mut said_again = String::new();
        let played = recording.play(&mut again, |text| said_again.push_str(text), |_| {});
        prop_assert_eq!(played, Ok(()), "{}", file.text());
        prop_assert_eq!(digest(&again), digest(&mill), "{}", file.text());
        prop_assert!(said_again.starts_with(&said), "{}\n{}\n{}", file.text(), said, said_again);
    }
}

/// Records a host that sends `sent`, and the state a second later. Returns the text of the recording, and the machine.
fn recorded(sent: &str) -> (String, Simulator) {
    let (mut mill, mut recorder, file, _) = machine();
    recorder.input(&mill, &Input::Host(sent.as_bytes().to_vec())).unwrap();
    mill.send(sent);
    mill.run_for(Duration::from_secs(1));
    recorder.look(&mill).unwrap();
    (file.text(), mill)
}

/// Plays a recording on a machine that has just been powered up, and returns the result.
fn played(text: &str) -> Result<(), String> {
    let recording = Recording::parse(text).unwrap();
    recording.play(&mut recording.power_up().unwrap(), |_| {}, |_| {})
}

#[test]
fn another_machine_parts_from_it() {
    let (text, mill) = recorded("G1 X1 F600\n");
    assert_eq!(played(&text), Ok(()));
    let place = format!(" at {} ", mill.machine().position()[0]);
    for (from, to) in [("G1 X1 F600", "G1 Y1 F600"), (place.as_str(), " at 1 ")] {
        assert!(text.contains(from), "{text}");
        let why = played(&text.replace(from, to)).unwrap_err();
        assert!(why.starts_with("1.000000 s after its begin"), "{why}");
    }
}

/// An editor or a mail program may change the line ends of a recording, or put a byte order mark in front. The
/// recording is then read in the same way.
#[test]
fn line_ends_and_a_mark_in_front_are_no_difference() {
    let (text, _) = recorded("G1 X1 F600\n");
    let other = format!("\u{FEFF}{}", text.replace('\n', "\r\n"));
    assert_eq!(played(&other), Ok(()));
    let (text, other) = (Recording::parse(&text).unwrap(), Recording::parse(&other).unwrap());
    assert_eq!(text.inputs(), other.inputs());
}

#[test]
fn another_state_parts_from_it() {
    for (sent, state) in [
        ("$1=255\n", "alarm 0 trusted drivers"),
        ("G4 P9\n!", "alarm 0 trusted paused"),
        ("M3 S500\n", "alarm 0 trusted cw 32896"),
        ("M4 S500 M8\n", "alarm 0 trusted ccw 32896 flood"),
        ("M4 S600 M7\n", "alarm 0 trusted ccw 39423 mist"),
        ("$900=1\nM64 P1\nM65 P0\n", "alarm 0 trusted pins 02"),
        // X reaches the switch at 1.5 mm.
        ("G1 X9 F900\n", "alarm 1 drivers"),
        ("$SLP\n", "alarm 0"),
    ] {
        let (text, _) = recorded(sent);
        let (place, traced) = text.trim_end().rsplit_once(" traced ").unwrap();
        assert!(place.ends_with(&format!(" {state}")) && traced.len() == 16, "{sent:?} is {text}");
        assert_eq!(played(&text), Ok(()));
        // If any one word of the state is changed, the replay must report a difference.
        let words: Vec<&str> = state.split(' ').collect();
        for index in 0..words.len() {
            let changed = [&words[..index], &["other"], &words[index + 1..]].concat().join(" ");
            let why = played(&text.replace(state, &changed)).unwrap_err();
            assert!(why.contains("has the machine at "), "{sent:?} without {}: {why}", words[index]);
        }
    }
    // Recordings of an older version contain no outputs.
    let (text, _) = recorded("M4 S500 M8\n");
    let older: String = text.lines().map(|line| format!("{}\n", line.split(" alarm ").next().unwrap())).collect();
    assert_eq!(played(&older.replace(" M8", "")), Ok(()));
    assert!(played(&text.replace(" M8", "")).is_err());
    // Recordings of another older version contain no hash of the times of steps and outputs (`traced`).
    let older: String = text.lines().map(|line| format!("{}\n", line.split(" traced ").next().unwrap())).collect();
    assert_eq!(played(&older), Ok(()));
    assert!(played(&older.replace(" M8", "")).is_err());
}

/// A difference in outputs or times is found even if the motors make the same steps and the machine ends in the same
/// state.
#[test]
fn other_outputs_and_another_clock_part_from_it() {
    let (text, _) = recorded("M3 S500\nG1 X0.2 F600\nM5 M9\n");
    assert_eq!(played(&text), Ok(()));
    let differs = |changed: String| {
        let why = played(&changed).expect_err(&changed);
        assert!(
            why.contains("steps or outputs came at other times") || why.contains("has the machine at"),
            "{why}: {changed}"
        );
    };
    for (from, to) in [("M3 S500\\n", ""), ("M3 S500", "M3 S510"), ("M3 S500", "M4 S500"), ("M3 S500", "M3 S500 M8")] {
        assert!(text.contains(from));
        differs(text.replace(from, to));
    }
    // A change of any one bit of the step clock frequency or of a recorded time is found.
    let hz = "board desk 100000000\n";
    assert!(text.contains(hz), "{text}");
    for bit in 0..20 {
        differs(text.replace(hz, &format!("board desk {}\n", 100_000_000 ^ 1 << bit)));
    }
    let lines: Vec<&str> = text.lines().collect();
    let first = lines.iter().position(|line| line.contains("M3")).unwrap();
    for number in first..lines.len() {
        let (time, rest) = lines[number].split_once(' ').unwrap();
        let time: u64 = time.parse().unwrap();
        for bit in 0..24 {
            let changed = format!("{} {rest}", time ^ 1 << bit);
            let text = [&lines[..number], &[&changed], &lines[number + 1..]].concat().join("\n") + "\n";
            // `parse` already rejects a line whose time is earlier than the time of the line before it.
            if Recording::parse(&text).is_ok() {
                differs(text);
            }
        }
    }
    assert!(lines.len() > first + 1, "{text}");
}

#[test]
fn what_is_no_recording_is_refused() {
    for (text, why) in [
        ("", "line 1: this is no recording"),
        ("oxmill recording 1\nboard lathe 1000000\n", "line 2: the boards are"),
        ("oxmill recording 1\nrecord 100 0g\n", "line 2: `0g` is no value"),
        ("oxmill recording 1\nbegin 5\n4 host ?\n", "line 3: it is earlier"),
        ("oxmill recording 1\nbegin 5\n6 host \\x4\n", "line 3: `\\x` in"),
        ("oxmill recording 1\nbegin 5\n6 wave\n", "line 3: `6 wave` is not understood"),
        ("oxmill recording 1\n6 connect\n", "line 2: it comes before `begin`"),
        ("oxmill recording 1\nbegin 18446744073709551615\n", "line 2: `18446744073709551615` is later"),
        ("oxmill recording 1\nboard desk 0\n", "line 2: `0` is no step clock"),
        ("oxmill recording 1\nbegin 864000000000001\n", "line 2: `864000000000001` is later than 100 days"),
        ("oxmill recording 1\nbegin 0\n2000000000000000000 pin door 1\n", "line 3: `2000000000000000000` is later"),
    ] {
        let error = Recording::parse(text).unwrap_err();
        assert!(error.starts_with(why), "{error}");
    }
    // A last line without its end is ignored: the program was killed while it wrote the line.
    assert!(Recording::parse("oxmill recording 1\nbegin 5\n6 at 0 0").is_ok());
}

/// Returns whether an input makes motion brake.
fn brakes(input: &Input) -> bool {
    match input {
        Input::Host(bytes) => matches!(bytes[..], [b'!' | 0x19 | 0x85]),
        Input::Pin(line) => line == "hold 1" || line == "door 1",
        _ => false,
    }
}

/// Returns the listing of `$REC`, as a terminal would log it.
fn listing(mill: &mut Simulator) -> String {
    mill.take_output();
    mill.send("$REC\n");
    mill.run_for(Duration::from_millis(50));
    let mut log = mill.take_output();
    while mill.unfetched() > 0 {
        log.push_str(&mill.take_output());
    }
    log
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 60, ..ProptestConfig::default() })]
    /// A simulator acts as a board and lists its recording. Another simulator replays the listing: it must execute the
    /// same blocks and end at the same position.
    #[test]
    fn what_a_board_lists_is_played(script in prop::collection::vec(inputs_with(&[]), 1..60)) {
        let (mut mill, _, _, _) = machine();
        for (pause, input) in &script {
            mill.run_for(Duration::from_micros(u64::from(*pause)));
            apply(&mut mill, input);
        }
        mill.run_for(Duration::from_secs(3));
        for calm in ["door 0", "hold 0", "limit y 0", "probe 0"] {
            mill.pin_line(calm);
        }
        mill.send("\n\x18");
        mill.run_for(Duration::from_secs(1));
        mill.send("\x18$X\nG91 G1 F500 Z0.1\n");
        mill.run_for(Duration::from_secs(3));
        let before = mill.take_output();
        let log = listing(&mut mill);
        prop_assert!(log.ends_with("[REC:end]\r\nok\r\n"), "{}\n{}", before, log);
        let recording = Recording::parse(&log).unwrap();
        prop_assert!(recording.is_of_board() && recording.is_whole());
        let mut again = recording.power_up().unwrap();
        let arrival = oxmill_simulator::board_replay::play(&recording, &mut again, |_| {}, |_| {});
        if log.rfind(" stored]") > log.rfind(" state ") {
            // A replay can begin only at a recorded state after the last change of a setting. Here the last change came
            // while a switch was active, and no state was recorded after it.
            prop_assert!(arrival.parted.is_some_and(|why| why.starts_with("begins in the middle")), "{}", log);
            return Ok(());
        }
        // A recording leaves three facts open: the order of bytes that two hosts sent at the same time, whether `~`
        // arrived just before the machine came to rest in a hold, and the time at which a line arrived that had to
        // wait. The arrival of a line makes the controller run, so a later braking can end one segment later. In these
        // three cases the replay may differ from the recorded run, but must report the difference.
        let unclear = |input: &Input| match input {
            Input::Connect | Input::Disconnect => true,
            Input::Host(bytes) => bytes == b"~" || brakes(input),
            _ => brakes(input),
        };
        if arrival.parted.is_some() && script.iter().any(|(_, input)| unclear(input)) {
            return Ok(());
        }
        prop_assert_eq!(arrival.parted, None, "{}", log);
        prop_assert_eq!(again.recorded_blocks(), mill.recorded_blocks(), "{}", log);
        prop_assert_eq!(again.machine_position(), mill.machine_position(), "{}", log);
    }
}

/// Returns the listing of a board that has made two moves, each until rest.
fn two_moves() -> String {
    let (mut mill, _, _, _) = machine();
    for line in ["G91 G1 X-1 F600\n", "G1 X0.5\n"] {
        mill.send(line);
        mill.run_for(Duration::from_secs(3));
    }
    listing(&mut mill)
}

/// Plays a listing; `None` if it cannot be read.
fn arrival(log: &str) -> Option<oxmill_simulator::board_replay::Arrival> {
    let recording = Recording::parse(log).ok()?;
    let mut again = recording.power_up().ok()?;
    Some(oxmill_simulator::board_replay::play(&recording, &mut again, |_| {}, |_| {}))
}

#[test]
fn a_replay_says_how_much_it_has_compared() {
    let log = two_moves();
    let said = |log: &str| arrival(log).unwrap().notes.pop().unwrap();
    assert_eq!(said(&log), "the motors come to all 2 recorded places, by the same moves as on the board");
    let without = |word: &str| log.lines().filter(|line| !line.contains(word)).collect::<Vec<_>>().join("\n");
    assert!(said(&without(" rest ")).starts_with("nothing in it tells where"), "{log}");
    // If a line of the host is missing, the motors come to rest at another position than the recorded one.
    let parted = arrival(&without("host G1 X0.5")).unwrap();
    assert!(parted.parted.is_some_and(|why| why.contains("the recording has the motors at")), "{log}");
    assert!(parted.notes.iter().all(|note| !note.contains("the motors come")), "{:?}", parted.notes);
    // Of two listings in a log the last one counts, and a truncated listing is reported.
    let twice = format!("{}{log}", &log[..log.len() / 2]);
    assert_eq!(said(&twice), said(&log));
    let cut = log.rsplit_once("[REC:end]").unwrap().0;
    assert!(arrival(cut).unwrap().notes[0].starts_with("the listing breaks off"));
}

/// Sends texts to a board, each with the milliseconds until the next. Returns the board's listing, and the result of
/// playing it.
fn played_of_board(sent: &[(u64, &str)]) -> (String, oxmill_simulator::board_replay::Arrival) {
    let (mut mill, _, _, _) = machine();
    for (milliseconds, text) in sent {
        mill.send(text);
        mill.run_for(Duration::from_millis(*milliseconds));
    }
    mill.run_for(Duration::from_secs(3));
    let log = listing(&mut mill);
    let arrival = arrival(&log).unwrap_or_else(|| panic!("{sent:?}: {log}"));
    (log, arrival)
}

/// M30 and a change of the feed mode can leave G1 in force without F. The replay begins in this state, because it must
/// begin after the last stored value (G10).
#[test]
fn a_replay_begins_in_g1_without_a_feed() {
    for end in ["M30\n", "G93 G1 Y0.1 F60\nG94\n", "G20 M30\n"] {
        let (log, arrival) = played_of_board(&[(1500, end), (100, "G10 L20 P1 X0\n"), (10, "G1 Y0.05 F500\nG0 Y0\n")]);
        assert!(log.contains("G1G54G17G90F0.0000000S"), "{log}");
        assert_eq!(arrival.parted, None, "{log}");
        assert!(arrival.notes.iter().any(|note| note.starts_with("the motors come to")), "{:?}", arrival.notes);
    }
}

#[test]
fn a_state_with_an_input_that_stops_the_machine_is_no_beginning() {
    let (log, _) = played_of_board(&[(1500, "M30\n"), (100, "G10 L20 P1 X0\n"), (10, "G1 Y0.05 F500\n")]);
    let tripped = log.replace(" 0 000000 0 0 0", " 0 000001 0 0 0");
    assert_ne!(tripped, log);
    let parted = arrival(&tripped).unwrap().parted;
    assert!(parted.as_ref().is_some_and(|why| why.contains("raise ALARM:1")), "{parted:?} {tripped}");
}

/// A corner is rounded only if its second move was known when its first move started. So the replay, too, must send
/// these lines together.
#[test]
fn lines_that_came_at_once_are_played_at_once() {
    let burst = "G64 P0.1\nG1 X1 F900\nY1\nX0\nY0\n";
    for pause in (400..520).step_by(7) {
        let script = [(652, "$J=G91 X1 F300\n"), (1121, "$RST=$\n"), (pause, "G0 X0.1\n"), (10, burst)];
        let (log, arrival) = played_of_board(&script);
        assert_eq!(arrival.parted, None, "{pause} ms, {log}");
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 300, ..ProptestConfig::default() })]
    /// A damaged listing is rejected or played; it must not cause a panic.
    #[test]
    fn a_damaged_listing_does_no_harm(damage in prop::collection::vec((any::<prop::sample::Index>(), 0..5_u8, any::<u8>()), 1..5), length in any::<prop::sample::Index>(), cut in any::<bool>()) {
        let mut log = two_moves().into_bytes();
        for (at, kind, byte) in damage {
            let at = at.index(log.len());
            match kind {
                0 => log[at] = byte,
                1 => log[at] ^= 1 << (byte & 7),
                2 => drop(log.remove(at)),
                3 => log.insert(at, b'0' + byte % 10),
                // Removes a line.
                _ => {
                    let end = log[at..].iter().position(|byte| *byte == b'\n').map_or(log.len(), |end| at + end + 1);
                    let begin = log[..at].iter().rposition(|byte| *byte == b'\n').map_or(0, |begin| begin + 1);
                    log.drain(begin..end);
                }
            }
            prop_assume!(!log.is_empty());
        }
        if cut {
            log.truncate(length.index(log.len()));
        }
        if let Some(arrival) = arrival(&String::from_utf8_lossy(&log)) {
            prop_assert!(arrival.parted.is_some() || !arrival.notes.is_empty());
        }
    }
}
