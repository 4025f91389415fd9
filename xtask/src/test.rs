//! Everything CI checks. The README's test command.
use crate::workspace::Workspace;
use crate::{count, determinism, fw, lint, setup};
use anyhow::{Context, Result};
use std::time::Instant;

type Step = (&'static str, fn(&Workspace) -> Result<()>);

/// What fails most often and takes least comes first.
const STEPS: [Step; 6] = [
    ("setup", setup::run),
    ("lint", lint::run),
    ("tests", tests),
    ("fw", fw::run),
    ("count", count::run),
    ("determinism", determinism::run),
];

pub(crate) fn run(workspace: &Workspace) -> Result<()> {
    // Nothing is built twice here, and what it would take to do so faster is gigabytes.
    workspace.shell.set_var("CARGO_INCREMENTAL", "0");
    let started = Instant::now();
    for (name, step) in STEPS {
        let step_started = Instant::now();
        step(workspace).with_context(|| format!("{name} failed"))?;
        println!("== {name}: {:.1} s", step_started.elapsed().as_secs_f32());
    }
    println!("== all passed: {:.1} s", started.elapsed().as_secs_f32());
    Ok(())
}

fn tests(workspace: &Workspace) -> Result<()> {
    // All features: the image in the emulator is one.
    workspace.cargo(&["test", "--quiet", "--all-features"]).run()?;
    // Not a default member; what needs no hardware is tested on the host.
    workspace.cargo(&["test", "--quiet", "--package", "firmware", "--lib"]).run()?;
    // In release, for its other user, `fly-image`, builds Unicorn in release too.
    workspace.cargo(&["test", "--quiet", "--release", "--package", "emulator", "--lib"]).run()?;
    Ok(())
}
