//! The `sim-host` command.
use std::process::ExitCode;

fn main() -> ExitCode {
    sim_host::cli::run()
}
