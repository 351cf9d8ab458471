//! The simulator as a WebAssembly module. It needs no imports, so it runs in a page, in Node or in Python. It exports
//! `extern` functions (`oxmill_path`, `oxmill_stream_begin` and so on), and keeps all state in itself (`Instance`). For
//! two simulators, make two instances of the module. The work is done in `engine`.
//!
//! # How to call it
//!
//! Text and bytes are passed through an input buffer and an output buffer:
//! 1. `oxmill_input(n)` returns the address of `n` bytes in the module's memory: write the input there. The next call
//!    that takes an input consumes it. The address is valid until the next call of the module.
//! 2. Call a function. A function with a `status` returns 0, or 1 for a rejection: then the output is a text with the
//!    reason.
//! 3. `oxmill_output()` and `oxmill_output_len()` return address and length of the output, which is valid until the
//!    next call.
//!
//! | function | input | gives | output |
//! |---|---|---|---|
//! | `oxmill_abi()` | | number of this interface, [`ABI`] | |
//! | `oxmill_describe()` | | status | JSON: `version`, `boards`, `settings`, `errors`, `alarms` |
//! | `oxmill_check_begin()` | order, 0, job | status | `name` of the order |
//! | `oxmill_check_advance(rounds)` | | part of the job read, 0 to 1000, or [`DONE`] | |
//! | `oxmill_check_seconds()` | | machine time so far, in s | |
//! | `oxmill_check_summary()` | | status | JSON: what `oxmill run --json` prints; `host_s` is 0 |
//! | `oxmill_path()` | | rows of the path, for an order with `"path": true` | |
//! | `oxmill_path_rows()` | | address of 6 `f32` for each row: x, y, z in mm of machine coordinates, speed in mm/s, start and end in s | |
//! | `oxmill_path_lines()` | | address of a `u32` for each row: line of the file, bit 31 for a rapid, bit 30 for an arc | |
//! | `oxmill_path_tools()` | | address of a `u32` for each row: tool, 0 if no M6 has named one | |
//! | `oxmill_path_speeds()` | | address of a `u32` for each row: S, 0 while the spindle is off | |
//! | `oxmill_stream_begin()` | order with `baud`, 0, job | status | |
//! | `oxmill_stream_advance(ms)` | | as `oxmill_check_advance` | |
//! | `oxmill_stream_summary()` | | status | JSON: `baud`, `forecast_s`, `complete`, `errors`, `lost: [{line, seconds}]` |
//! | `oxmill_resume()` | order with `resume`, 0, job | status | JSON: `program`, `line`, `lines`, `prologue`: the rest of a job, as from `oxmill resume` |
//! | `oxmill_import()` | settings of another controller | status | JSON: what `oxmill settings import --json` prints |
//! | `oxmill_pins_file()` | name of a board | status | the board's pin table, as `oxmill board show` prints it; empty if there is no such board |
//! | `oxmill_pins_in()` | image | status | name in the pin table of the image; empty if it has none |
//! | `oxmill_pins_check()` | pin table | status | JSON: `name`, `image`, `pins` (their number); or the table's faults, a line each |
//! | `oxmill_pins_write()` | pin table, 0, image | status | the image with the table, as from `oxmill board write` |
//! | `oxmill_machine_begin()` | order | status | the machine's output at power-up |
//! | `oxmill_machine_turn(us)` | bytes of the host | status | the machine's output within the next `us` microseconds |
//! | `oxmill_machine_pin()` | a line such as `probe 1` | status | `ok`, or the fault |
//! | `oxmill_panic_len()`, `oxmill_panic()` | | length and address of the text of a panic | |
//! | `oxmill_fail()` | | does not return: panics, for testing how a panic is shown | |
//!
//! Each of the `settings` has `number`, `name`, `unit`, `kind`, `min`, `max`, `values` (its range or choices as text),
//! `default`, `grbl` (whether Grbl has it), `axis`, `title` (the name that all axes share), `group`, `labels` (names of
//! choices or bits, from 0 on), and `explanation`: what it does and when to change it.
//!
//! An order is a JSON object, and all its fields are optional: `{"name": "a.nc", "board": "blackpill_f411", "dialect":
//! "oxmill", "settings": {"110": 5000}, "path": true, "machine": {"steps_per_mm": [250, 250, 250]}, "work_zero":
//! [-150, -100, -30], "baud": 115200}`. `machine` has the fields of the file that `--machine` reads. `work_zero` is in
//! mm of machine coordinates. If it is given, the machine of a check or a stream is homed before the job, and G54 is
//! set there, as with `--work-zero`. `"resume": {"line": 1200, "clearance": 20, "plunge": 100, "spin_up": 5}` says
//! where the rest of a job begins; only `line` is required. `"stored": ["G10 L1 P1 Z12.5"]` are lines that the machine
//! of a check or a stream executes before the job, to set its offsets and tools. Settings are applied in the order of
//! their numbers, then the dialect. Settings that were rejected are tried again after the dialect, because the dialect
//! determines which values are accepted.
//!
//! A call that panics ends the instance with a trap. The text of the panic can still be fetched.

pub mod engine;
mod pins;

use engine::Order;
use oxmill_simulator::Simulator;
use oxmill_simulator::check::Check;
use oxmill_simulator::settings_import;
use oxmill_simulator::streaming::Streaming;
use std::cell::RefCell;
use std::sync::Once;

/// Version number of this interface. It changes with every change that breaks callers.
pub const ABI: u32 = 2;
/// Result of `oxmill_check_advance` and `oxmill_stream_advance` at the end of the job.
pub const DONE: u32 = 1001;
/// Progress is reported in thousandths of the job.
const PARTS: u64 = 1000;

/// The state of an instance of the module: input, output, and the check, the streams or the machine that it runs.
#[derive(Default)]
struct Instance {
    input: Vec<u8>,
    output: Vec<u8>,
    check: Option<Check>,
    job_length: u64,
    rows: Vec<f32>,
    lines: Vec<u32>,
    tools: Vec<u32>,
    speeds: Vec<u32>,
    streams: Option<[Streaming; 2]>,
    machine: Option<Simulator>,
}

thread_local! {
    static INSTANCE: RefCell<Instance> = RefCell::default();
    // `PANIC` is not part of `INSTANCE`, because a call that panics still has `INSTANCE` borrowed.
    static PANIC: RefCell<String> = const { RefCell::new(String::new()) };
}

/// Runs a call with the state of the instance. On the first call, installs a hook that keeps the text of a panic.
fn with<T>(call: impl FnOnce(&mut Instance) -> T) -> T {
    static HOOK: Once = Once::new();
    HOOK.call_once(|| std::panic::set_hook(Box::new(|panic| PANIC.with_borrow_mut(|text| *text = panic.to_string()))));
    INSTANCE.with_borrow_mut(call)
}

/// Runs a call that takes the input and can fail. The result or the error becomes the output.
fn answer(call: impl FnOnce(&mut Instance, &[u8]) -> Result<Vec<u8>, String>) -> u32 {
    with(|instance| {
        let input = std::mem::take(&mut instance.input);
        let result = call(instance, &input);
        let status = u32::from(result.is_err());
        instance.output = result.unwrap_or_else(String::into_bytes);
        status
    })
}

fn order(input: &[u8]) -> Result<(Order, &[u8]), String> {
    engine::parse(input)
}

fn json(value: &impl serde::Serialize) -> Result<Vec<u8>, String> {
    serde_json::to_vec(value).map_err(|error| error.to_string())
}

/// Returns [`ABI`], so that a caller can check that it fits this module.
// SAFETY of every `no_mangle` here: the attribute is unsafe because two functions with the same name would clash; all
// names here begin with the name of the project.
#[unsafe(no_mangle)]
pub extern "C" fn oxmill_abi() -> u32 {
    ABI
}

/// Makes room for an input of `length` bytes, which the next call takes. Returns its address.
#[unsafe(no_mangle)]
pub extern "C" fn oxmill_input(length: usize) -> *mut u8 {
    with(|instance| {
        instance.input.clear();
        instance.input.resize(length, 0);
        instance.input.as_mut_ptr()
    })
}

/// Returns the address of the output of the most recent call; it is valid until the next call.
#[unsafe(no_mangle)]
pub extern "C" fn oxmill_output() -> *const u8 {
    with(|instance| instance.output.as_ptr())
}

/// Returns the length of the output of the most recent call, in bytes.
#[unsafe(no_mangle)]
pub extern "C" fn oxmill_output_len() -> usize {
    with(|instance| instance.output.len())
}

/// Outputs version, boards, settings, errors and alarms of the firmware, as JSON.
#[unsafe(no_mangle)]
pub extern "C" fn oxmill_describe() -> u32 {
    answer(|_, _| json(&engine::describe()))
}

/// Starts checking a job. The input is an order (JSON), a 0 byte and the job; the output is the `name` of the order.
#[unsafe(no_mangle)]
pub extern "C" fn oxmill_check_begin() -> u32 {
    answer(|instance, input| {
        let (order, job) = order(input)?;
        instance.check = None;
        instance.check = Some(engine::check(&order, job)?);
        instance.job_length = job.len() as u64;
        instance.output = order.name.into_bytes();
        Ok(std::mem::take(&mut instance.output))
    })
}

/// Advances the check by up to `rounds` rounds ([`Check::advance`]). Returns how much of the job has been read, in
/// thousandths, or [`DONE`].
#[unsafe(no_mangle)]
pub extern "C" fn oxmill_check_advance(rounds: u32) -> u32 {
    with(|instance| {
        let Some(check) = &mut instance.check else { return DONE };
        if check.advance(rounds) {
            return DONE;
        }
        part(check.consumed(), instance.job_length)
    })
}

fn part(done: u64, all: u64) -> u32 {
    (done.min(all) * PARTS / all.max(1)) as u32
}

/// Returns the machine time since power-up, in seconds; 0 if no check has begun.
#[unsafe(no_mangle)]
pub extern "C" fn oxmill_check_seconds() -> f64 {
    with(|instance| instance.check.as_ref().map_or(0.0, Check::seconds))
}

/// Outputs the summary of the job. The input is the name of the job.
#[unsafe(no_mangle)]
pub extern "C" fn oxmill_check_summary() -> u32 {
    answer(|instance, name| {
        let check = instance.check.as_ref().ok_or("no job has begun")?;
        json(&check.summary(&String::from_utf8_lossy(name), 0.0))
    })
}

/// Prepares the path of the job that [`oxmill_check_begin`] has begun, as rows of numbers, and returns the number of
/// rows; 0 if no path was kept.
#[unsafe(no_mangle)]
pub extern "C" fn oxmill_path() -> usize {
    with(|instance| {
        (instance.rows, instance.lines, instance.tools, instance.speeds) =
            instance.check.as_ref().map(engine::rows).unwrap_or_default();
        instance.lines.len()
    })
}

/// Returns the address of the rows that [`oxmill_path`] has prepared, [`engine::ROW`] numbers each.
#[unsafe(no_mangle)]
pub extern "C" fn oxmill_path_rows() -> *const f32 {
    with(|instance| instance.rows.as_ptr())
}

/// Returns the address of the file line of each row, with the bits [`engine::RAPID`] and [`engine::ARC`].
#[unsafe(no_mangle)]
pub extern "C" fn oxmill_path_lines() -> *const u32 {
    with(|instance| instance.lines.as_ptr())
}

/// Returns the address of the tool number of each row; 0 if no M6 has named a tool.
#[unsafe(no_mangle)]
pub extern "C" fn oxmill_path_tools() -> *const u32 {
    with(|instance| instance.tools.as_ptr())
}

/// Returns the address of the spindle speed (S) of each row; 0 while the spindle is off.
#[unsafe(no_mangle)]
pub extern "C" fn oxmill_path_speeds() -> *const u32 {
    with(|instance| instance.speeds.as_ptr())
}

/// Starts sending a job twice: over an unlimited link, and over a link with the order's `baud`.
#[unsafe(no_mangle)]
pub extern "C" fn oxmill_stream_begin() -> u32 {
    answer(|instance, input| {
        let (order, job) = order(input)?;
        instance.streams = Some(engine::stream(&order, job)?);
        Ok(Vec::new())
    })
}

/// Advances both machines (with the unlimited and with the limited link) by up to `milliseconds`. Returns how much of
/// the job the machine with the limited link has read, in thousandths, or [`DONE`].
#[unsafe(no_mangle)]
pub extern "C" fn oxmill_stream_advance(milliseconds: u32) -> u32 {
    with(|instance| {
        let Some([free, limited]) = &mut instance.streams else { return DONE };
        if free.advance(milliseconds) & limited.advance(milliseconds) {
            return DONE;
        }
        let (done, all) = limited.progress();
        part(done, all)
    })
}

/// Outputs how long the job takes over the limited link, and the lines at which it lost time, as JSON.
#[unsafe(no_mangle)]
pub extern "C" fn oxmill_stream_summary() -> u32 {
    answer(|instance, _| {
        let [free, limited] = instance.streams.as_ref().ok_or("no job is being sent")?;
        json(&limited.summary(free))
    })
}

/// Outputs the rest of a job as a program, in JSON. The order gives the line at which the rest begins.
#[unsafe(no_mangle)]
pub extern "C" fn oxmill_resume() -> u32 {
    answer(|_, input| {
        let (order, job) = order(input)?;
        json(&engine::resume(&order, job)?)
    })
}

/// Converts the settings of another controller, which are the input. Outputs JSON: the resulting settings of this
/// firmware, and the entries of the input that do not become settings.
#[unsafe(no_mangle)]
pub extern "C" fn oxmill_import() -> u32 {
    answer(|_, text| json(&settings_import::import(&String::from_utf8_lossy(text))?))
}

/// Outputs the pin table of a board, whose name is the input. Outputs nothing if there is no such board.
#[unsafe(no_mangle)]
pub extern "C" fn oxmill_pins_file() -> u32 {
    answer(|_, name| Ok(pins::file(&String::from_utf8_lossy(name)).into()))
}

/// Outputs the name in the pin table of a firmware image, which is the input. Outputs nothing if the image has no pin
/// table.
#[unsafe(no_mangle)]
pub extern "C" fn oxmill_pins_in() -> u32 {
    answer(|_, image| Ok(pins::name_in(image).into_bytes()))
}

/// Checks the pin table in the input. Outputs its `name`, `image` and number of `pins` as JSON, or its faults.
#[unsafe(no_mangle)]
pub extern "C" fn oxmill_pins_check() -> u32 {
    answer(|_, text| json(&pins::check(&String::from_utf8_lossy(text))?))
}

/// Writes a pin table into an image: the input is the table, a 0 byte and the image.
#[unsafe(no_mangle)]
pub extern "C" fn oxmill_pins_write() -> u32 {
    answer(|_, order| pins::write(order))
}

/// Powers a machine up as the order in the input says, and connects a host to it. Outputs what the machine has sent.
#[unsafe(no_mangle)]
pub extern "C" fn oxmill_machine_begin() -> u32 {
    answer(|instance, input| {
        let machine = instance.machine.insert(engine::machine(&order(input)?.0)?);
        Ok(machine.take_output().into_bytes())
    })
}

/// Sends the input to the machine, advances time by `microseconds`, and outputs what the machine has sent.
#[unsafe(no_mangle)]
pub extern "C" fn oxmill_machine_turn(microseconds: u32) -> u32 {
    answer(|instance, input| {
        let machine = instance.machine.as_mut().ok_or("no machine is powered")?;
        Ok(engine::turn(machine, input, microseconds).into_bytes())
    })
}

/// Executes a line of the pin protocol, such as `probe 1`, and outputs `ok` or the fault.
#[unsafe(no_mangle)]
pub extern "C" fn oxmill_machine_pin() -> u32 {
    answer(|instance, input| {
        let machine = instance.machine.as_mut().ok_or("no machine is powered")?;
        Ok(machine.pin_line(&String::from_utf8_lossy(input)).into_bytes())
    })
}

/// Returns the length of the text of a panic, in bytes; 0 if there was none.
#[unsafe(no_mangle)]
pub extern "C" fn oxmill_panic_len() -> usize {
    PANIC.with_borrow(String::len)
}

/// Returns the address of the text of the panic; its length is [`oxmill_panic_len`].
#[unsafe(no_mangle)]
pub extern "C" fn oxmill_panic() -> *const u8 {
    PANIC.with_borrow(|text| text.as_ptr())
}

/// Panics, for testing how a panic is shown.
#[unsafe(no_mangle)]
pub extern "C" fn oxmill_fail() {
    with(|_| panic!("oxmill_fail was called"))
}
