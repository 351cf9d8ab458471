//! The program `oxmill`: calls [`oxmill_simulator::main`], the controller on a desk.
fn main() -> std::process::ExitCode {
    oxmill_simulator::main()
}
