//! Links for QEMU's mps2-an386.
use std::env;

fn main() -> Result<(), env::VarError> {
    const SCRIPT: &str = "mps2-an386.x";
    println!("cargo:rerun-if-changed={SCRIPT}");
    if env::var("CARGO_CFG_TARGET_OS")? == "none" {
        let folder = env::var("CARGO_MANIFEST_DIR")?;
        println!("cargo:rustc-link-arg-bins=--nmagic");
        println!("cargo:rustc-link-arg-bins=-T{folder}/{SCRIPT}");
    }
    Ok(())
}
