//! Hands the linker its scripts, for the image only.
use std::path::PathBuf;
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
