//! Boots the flight image on the emulator and prints its decoded log.
use crate::workspace::Workspace;
use anyhow::Result;
use clap::Args;
use std::path::PathBuf;
use xshell::cmd;

/// How the image is flown.
#[derive(Args, Clone, Copy)]
pub(crate) struct Options {
    /// How long, s of the board's time.
    #[arg(long, default_value_t = 3.0)]
    seconds: f64,
}

pub(crate) fn run(workspace: &Workspace, options: Options) -> Result<()> {
    let (emulator, image) = (build(workspace)?, workspace.build_image("firmware")?);
    let seconds = options.seconds.to_string();
    Ok(cmd!(workspace.shell, "{emulator} {image} --seconds {seconds}").run()?)
}

/// Builds the emulator; returns its executable.
///
/// It is spawned, never linked: its licence is not the workspace's.
pub(crate) fn build(workspace: &Workspace) -> Result<PathBuf> {
    workspace.cargo(&["build", "--package", "emulator", "--release"]).run()?;
    Ok(workspace.executable("emulator"))
}
