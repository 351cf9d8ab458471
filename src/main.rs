//! The program `oxmill`: calls [`oxmill_simulator::main`], which runs the controller on a desktop computer.
fn main() -> std::process::ExitCode {
    oxmill_simulator::main()
}
