//! The defmt-test suites of `tests/on_target`, on QEMU or on a board.

use crate::{Failure, QEMU_BOARD, TARGET, boards, cargo, exists, qemu, root, run};

/// Where a runner for the ARM target is configured.
const RUNNER: &str = "CARGO_TARGET_THUMBV7EM_NONE_EABIHF_RUNNER";

fn suites(board: &str, runner: &str) -> std::process::Command {
    let mut cargo = cargo();
    cargo.env(RUNNER, runner);
    cargo.args([
        "test",
        "--profile",
        boards::profile(board),
        "--package",
        "oxmill-on-target",
        "--target",
        TARGET,
        "--features",
        board,
    ]);
    cargo
}

/// All suites on QEMU.
pub fn on_qemu() -> Result<(), Failure> {
    require_qemu_tools()?;
    let runner = root().join(".cargo/qemu-runner.sh");
    run(suites(QEMU_BOARD, &runner.to_string_lossy()).args(["--tests", "--no-fail-fast"]))
}

/// The same suites on a board.
pub fn on_board(board: &str) -> Result<(), Failure> {
    if !exists("probe-rs") {
        return Err("probe-rs is missing: `cargo install --locked probe-rs-tools`".into());
    }
    let chip = match board {
        "blackpill_f411" => "STM32F411CEUx",
        "blackpill_f401" => return Err("the suites need a stack of 80 KiB, and blackpill_f401 has 64 of RAM".into()),
        "nucleo_f446re" => "STM32F446RETx",
        "nucleo_f411re" => "STM32F411RETx",
        "nucleo_f401re" => "STM32F401RETx",
        _ => return Err(format!("{board} has no probe")),
    };
    run(suites(board, &format!("probe-rs run --chip {chip}")).args(["--tests", "--no-fail-fast"]))
}

fn require_qemu_tools() -> Result<(), Failure> {
    qemu::require()?;
    if exists("defmt-print") {
        Ok(())
    } else {
        Err("defmt-print is missing: `cargo install --locked defmt-print`".into())
    }
}
