//! Hands the linker its scripts, for the image only.
use std::path::PathBuf;
use std::{env, fs, io};

fn main() -> io::Result<()> {
    // The default board's is where people look for it.
    let memory = if env::var_os("CARGO_FEATURE_ORBIT_H743").is_some() { "memory_h743.x" } else { "../memory.x" };
    println!("cargo:rerun-if-changed=build.rs");
    println!("cargo:rerun-if-changed={memory}");
    if env::var("CARGO_CFG_TARGET_OS").as_deref() != Ok("none") {
        return Ok(());
    }
    let out = PathBuf::from(env::var_os("OUT_DIR").expect("cargo sets OUT_DIR"));
    fs::copy(memory, out.join("memory.x"))?;
    println!("cargo:rustc-link-search={}", out.display());
    // `--nmagic`: flash sections are not page-aligned. `link.x`: vector table. `defmt.x`: log strings.
    for argument in ["--nmagic", "-Tlink.x", "-Tdefmt.x"] {
        println!("cargo:rustc-link-arg-bins={argument}");
    }
    Ok(())
}
