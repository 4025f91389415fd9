//! Hands the linker its scripts, for the image only.
use std::path::{Path, PathBuf};
use std::process::Command;
use std::{env, fs, io};

fn main() -> io::Result<()> {
    let chosen = |feature: &str| env::var_os(format!("CARGO_FEATURE_{feature}")).is_some();
    let memory = if chosen("ORBIT_H743") {
        "memory_h743.x"
    } else if chosen("FOXEER_F722_V4") {
        "memory_f722.x"
    } else {
        "memory_f405.x"
    };
    println!("cargo:rerun-if-changed=build.rs");
    println!("cargo:rerun-if-changed={memory}");
    if env::var("CARGO_CFG_TARGET_OS").as_deref() != Ok("none") {
        return Ok(());
    }
    name_commit();
    let out = PathBuf::from(env::var_os("OUT_DIR").expect("cargo sets OUT_DIR"));
    // `link.x` includes `memory.x`, the one in the root whatever else is on the path, and that this.
    fs::copy(memory, out.join("board.x"))?;
    println!("cargo:rustc-link-search={}", out.display());
    // `--nmagic`: flash sections are not page-aligned. `link.x`: vector table. `defmt.x`: log strings.
    for argument in ["--nmagic", "-Tlink.x", "-Tdefmt.x"] {
        println!("cargo:rustc-link-arg-bins={argument}");
    }
    Ok(())
}

/// Tells the image the commit of its sources, for its flight logs; whatever else is in the work tree is not told.
fn name_commit() {
    let git = |arguments: &[&str]| {
        let output = Command::new("git").args(arguments).output().ok().filter(|output| output.status.success())?;
        Some(String::from_utf8(output.stdout).ok()?.trim().to_owned())
    };
    let commit = git(&["rev-parse", "--short=12", "HEAD"]).unwrap_or_else(|| "unknown".to_owned());
    println!("cargo:rustc-env=COMMIT={commit}");
    // Every commit and checkout is noted there.
    if let Some(log) = git(&["rev-parse", "--git-path", "logs/HEAD"]).filter(|log| Path::new(log).exists()) {
        println!("cargo:rerun-if-changed={log}");
    }
}
