//! The same flight twice in a debug and twice in a release build: every log must have the same bytes.
use crate::workspace::{FLIGHT, Workspace};
use anyhow::{Context, Result, ensure};

/// The log a flight leaves in its folder.
const LOG: &str = "log.csv";
const SEED: &str = "7";

pub(crate) fn run(workspace: &Workspace) -> Result<()> {
    let folder = workspace.results("determinism")?;
    let mut logs = Vec::new();
    for (name, profile) in [("debug-1", "dev"), ("debug-2", "dev"), ("release-1", "release"), ("release-2", "release")]
    {
        let out = folder.join(name);
        let fly = ["run", "--quiet", "--package", "sim-host", "--profile", profile, "--", "fly", FLIGHT];
        workspace.cargo(&fly).args(["--controller", "lgs", "--seed", SEED, "--out"]).arg(&out).ignore_stdout().run()?;
        let log = workspace.shell.read_binary_file(out.join(LOG))?;
        println!("{name:<10} {} bytes, crc32 {:08x}", log.len(), crc32fast::hash(&log));
        logs.push((name, log));
    }
    let ((first, expected), others) = logs.split_first().context("nothing flew")?;
    ensure!(!expected.is_empty(), "{first} left an empty {LOG}");
    for (name, log) in others {
        ensure!(log == expected, "{LOG} of {name} and {first} differ, both are in {}", folder.display());
    }
    Ok(())
}
