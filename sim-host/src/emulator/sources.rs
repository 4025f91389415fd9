//! Which sources decide. The image is built anew whenever they have changed, `sim-host` only when somebody builds it: the
//! image's twin would then be another core, and part from it.
//!
//! Names and contents of all files, in the order of their names, by FNV-1a of 64 bits. Also the build script's, which is how
//! `sim-host` knows its own.
use std::path::Path;
use std::{fs, io};

/// What the twin is built of, in the workspace.
pub(crate) const SOURCES: [&str; 4] =
    ["control-core/src", "firmware/src/flight.rs", "firmware/src/icm42688.rs", "firmware/src/record.rs"];

/// Of the sources as they are on the disk now.
pub(crate) fn fingerprint(workspace: &Path) -> io::Result<u64> {
    SOURCES.iter().try_fold(0xcbf2_9ce4_8422_2325, |hash, source| add(hash, &workspace.join(source)))
}

/// With a file, or all that is in a directory.
fn add(hash: u64, path: &Path) -> io::Result<u64> {
    if path.is_dir() {
        let mut inside = fs::read_dir(path)?.map(|entry| Ok(entry?.path())).collect::<io::Result<Vec<_>>>()?;
        inside.sort();
        return inside.iter().try_fold(hash, |hash, path| add(hash, path));
    }
    let name = path.file_name().unwrap_or_default().as_encoded_bytes();
    let bytes = fs::read(path)?;
    Ok(name.iter().chain(&bytes).fold(hash, |hash, &byte| (hash ^ u64::from(byte)).wrapping_mul(0x0100_0000_01b3)))
}
