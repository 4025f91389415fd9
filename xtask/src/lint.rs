//! Formatting, clippy and documentation, every warning an error.
//!
//! Warnings are denied after `--`, not in RUSTFLAGS, which would rebuild every dependency.
use crate::fw::{BOARDS, Board};
use crate::workspace::{PROFILE, TARGET, Workspace};
use anyhow::Result;

const DENY: [&str; 3] = ["--", "-D", "warnings"];
/// Packages that are not default members, because they are for the board.
const BOARD: [&str; 4] = ["--package", "firmware", "--package", "tick-bench"];

pub(crate) fn run(workspace: &Workspace) -> Result<()> {
    workspace.cargo(&["fmt", "--all", "--check"]).run()?;
    workspace.cargo(&["clippy", "--all-targets", "--all-features"]).args(DENY).run()?;
    // Not a default member, for it needs cmake and libclang; in release, as it is built and tested.
    workspace.cargo(&["clippy", "--release", "--all-targets", "--package", "emulator"]).args(DENY).run()?;
    // The board's packages twice: with their tests and stubs on the host, and as they are flashed, on every board.
    workspace.cargo(&["clippy", "--all-targets"]).args(BOARD).args(DENY).run()?;
    workspace
        .cargo(&["clippy", "--profile", PROFILE, "--target", TARGET, "--package", "tick-bench"])
        .args(DENY)
        .run()?;
    for Board { feature, .. } in &BOARDS {
        let board = ["--package", "firmware", "--no-default-features", "--features", feature];
        workspace.cargo(&["clippy", "--profile", PROFILE, "--target", TARGET]).args(board).args(DENY).run()?;
    }
    workspace.cargo(&["doc", "--no-deps", "--all-features"]).env("RUSTDOCFLAGS", "-Dwarnings").run()?;
    Ok(())
}
