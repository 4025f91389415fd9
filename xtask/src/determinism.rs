//! The same flight twice in a debug and twice in a release build: every log must have the same bytes.
use crate::workspace::{FLIGHT, Workspace};
use anyhow::{Context, Result, ensure};
use xshell::cmd;

/// The log a flight leaves in its folder.
const LOG: &str = "log.csv";
const SEED: &str = "7";

pub(crate) fn run(workspace: &Workspace) -> Result<()> {
    let folder = workspace.results("determinism")?;
    let (debug, release) = (workspace.build_simulator(false)?, workspace.build_simulator(true)?);
    let mut logs = Vec::new();
    for (name, simulator) in
        [("debug-1", &debug), ("debug-2", &debug), ("release-1", &release), ("release-2", &release)]
    {
        let out = folder.join(name);
        let fly = cmd!(workspace.shell, "{simulator} fly {FLIGHT} --controller lgs --seed {SEED} --out {out}");
        fly.ignore_stdout().run()?;
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
