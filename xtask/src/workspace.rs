//! Where the workspace is, and how its cargo is called.
use anyhow::{Context, Result};
use std::path::{Path, PathBuf};
use xshell::{Cmd, Shell, cmd};

/// The board's target triple.
pub(crate) const TARGET: &str = "thumbv7em-none-eabihf";
/// The profile of everything that runs on the board.
pub(crate) const PROFILE: &str = "image";
/// What is flown to count and to compare.
pub(crate) const FLIGHT: &str = "scenarios/flight.toml";

/// A shell in the root of the workspace.
pub(crate) struct Workspace {
    pub(crate) shell: Shell,
    target_dir: PathBuf,
}

impl Workspace {
    /// The workspace this program was built in.
    pub(crate) fn open() -> Result<Self> {
        let root = Path::new(env!("CARGO_MANIFEST_DIR")).parent().context("xtask lies in no workspace")?;
        let shell = Shell::new()?;
        shell.change_dir(root);
        Ok(Self { target_dir: root.join(shell.var_os("CARGO_TARGET_DIR").unwrap_or_else(|| "target".into())), shell })
    }

    /// `cargo` with these arguments; under rustup RUSTUP_TOOLCHAIN makes it the one that runs this program.
    pub(crate) fn cargo<'a>(&'a self, arguments: &[&str]) -> Cmd<'a> {
        cmd!(self.shell, "cargo {arguments...}")
    }

    /// Builds a package for the board; returns its ELF, which has the package's name.
    pub(crate) fn build_image(&self, package: &str) -> Result<PathBuf> {
        self.build_image_with(package, &[])
    }

    /// The same, with more arguments to cargo.
    pub(crate) fn build_image_with(&self, package: &str, arguments: &[&str]) -> Result<PathBuf> {
        self.cargo(&["build", "--package", package, "--profile", PROFILE, "--target", TARGET]).args(arguments).run()?;
        Ok(self.target_dir.join(TARGET).join(PROFILE).join(package))
    }

    /// Builds the simulator in one of cargo's own profiles; returns its executable.
    ///
    /// Built apart from flying, so that a source edited between two flights cannot tell them apart.
    pub(crate) fn build_simulator(&self, release: bool) -> Result<PathBuf> {
        let profile: &[&str] = if release { &["--release"] } else { &[] };
        self.cargo(&["build", "--package", "sim-host"]).args(profile).run()?;
        Ok(self.target_dir.join(if release { "release" } else { "debug" }).join("sim-host"))
    }

    /// Where the release build of a package's executable is.
    pub(crate) fn executable(&self, package: &str) -> PathBuf {
        self.target_dir.join("release").join(package)
    }

    /// A fresh folder for the results of a command.
    pub(crate) fn results(&self, command: &str) -> Result<PathBuf> {
        let folder = self.target_dir.join(command);
        self.shell.remove_path(&folder)?;
        Ok(self.shell.create_dir(folder)?)
    }
}
