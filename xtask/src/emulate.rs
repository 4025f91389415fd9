//! Boots the flight image on the emulator and prints its decoded log.
use crate::workspace::Workspace;
use anyhow::Result;
use clap::Args;
use std::path::PathBuf;
use xshell::cmd;

/// How the image is flown.
#[derive(Args, Clone, Copy)]
pub(crate) struct Options {
    /// How long, s of the board's time; 3, or with a station until interrupted.
    #[arg(long)]
    seconds: Option<f64>,
    /// Serve the station's line at this port of this computer, as fast as time passes: for `sim-host station`.
    #[arg(long, value_name = "PORT")]
    station: Option<u16>,
}

pub(crate) fn run(workspace: &Workspace, options: Options) -> Result<()> {
    let (emulator, image) = (build(workspace)?, workspace.build_image("firmware")?);
    let seconds = options.seconds.iter().flat_map(|seconds| ["--seconds".to_owned(), seconds.to_string()]);
    let station = options.station.iter().flat_map(|port| ["--station".to_owned(), port.to_string()]);
    Ok(cmd!(workspace.shell, "{emulator} {image}").args(seconds).args(station).run()?)
}

/// Builds the emulator; returns its executable.
///
/// It is spawned, never linked: its licence is not the workspace's.
pub(crate) fn build(workspace: &Workspace) -> Result<PathBuf> {
    workspace.cargo(&["build", "--package", "emulator", "--release"]).run()?;
    Ok(workspace.executable("emulator"))
}
