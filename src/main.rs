//! The simulator's program: the controller on a desk.
fn main() -> std::process::ExitCode {
    oxmill_simulator::main()
}
