//! Tells `sim-host` which sources it decides by.
use std::io;
use std::path::Path;

#[path = "src/emulator/sources.rs"]
mod sources;

fn main() -> io::Result<()> {
    let workspace = Path::new("..");
    println!("cargo::rerun-if-changed=build.rs");
    println!("cargo::rerun-if-changed=src/emulator/sources.rs");
    for source in sources::SOURCES {
        println!("cargo::rerun-if-changed={}", workspace.join(source).display());
    }
    println!("cargo::rustc-env=DECIDES_BY={:016x}", sources::fingerprint(workspace)?);
    Ok(())
}
