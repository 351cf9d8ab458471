//! The simulator's program: `main` hands over to `oxmill_simulator`, the controller on a desk.
fn main() -> std::process::ExitCode {
    oxmill_simulator::main()
}
