//! What CI and people run: `cargo xtask`, one module a command.
mod count;
mod determinism;
mod emulate;
mod fw;
mod lint;
mod panics;
mod setup;
mod test;
mod workspace;

use clap::{Parser, Subcommand};
use std::process::ExitCode;
use workspace::Workspace;

/// Builds, measures and tests the workspace.
#[derive(Parser)]
#[command(name = "cargo xtask", bin_name = "cargo xtask")]
struct Cli {
    #[command(subcommand)]
    command: Command,
}

#[derive(Clone, Copy, Subcommand)]
enum Command {
    /// Everything CI checks, in an order that fails fast.
    Test,
    /// Install what the other commands need and this machine lacks.
    Setup,
    /// Formatting, clippy for host and board, documentation.
    Lint,
    /// Build the flight image and hold its flash and RAM against their budgets.
    Fw,
    /// Boot the flight image on the emulator and print its decoded log.
    FlyImage(emulate::Options),
    /// Count the instructions of a control tick on an emulated Cortex-M4F.
    Count,
    /// Fly the same flight in debug and release builds; every log must have the same bytes.
    Determinism,
}

fn main() -> ExitCode {
    let command = Cli::parse().command;
    let result = Workspace::open().and_then(|workspace| match command {
        Command::Test => test::run(&workspace),
        Command::Setup => setup::run(&workspace),
        Command::Lint => lint::run(&workspace),
        Command::Fw => fw::run(&workspace),
        Command::FlyImage(options) => emulate::run(&workspace, options),
        Command::Count => count::run(&workspace),
        Command::Determinism => determinism::run(&workspace),
    });
    match result {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("xtask: {error:#}");
            ExitCode::FAILURE
        }
    }
}
